"""What the keys of steps are and do, in plain words, and what counts where they are left out."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from metrosep.core.errors import MetrosepError
from metrosep.core.methods import METHODS
from metrosep.core.options import KINDS
from metrosep.core.readable import NUMBER, readable_text, typed_number
from metrosep.core.text_options import TEXT_OPTIONS
from metrosep.recipe.pipeline import schema
from metrosep.recipe.schema import DIMENSIONS, Field, placeholder
from metrosep.recipe.steps import ALL_STEPS, STEPS, WHAT

if TYPE_CHECKING:
    from metrosep.recipe.recipe import Recipe


def kind_words(kind: str) -> str:
    """Return what a value of a kind looks like.

    Examples
    --------
    >>> kind_words("size")
    'a length above zero with its unit, "25 mm"'
    """
    return KINDS[kind].words


def key_words(op: str, key: str) -> str:
    """Return what a key of a step does."""
    declared = ALL_STEPS[op].get(key) if op in ALL_STEPS else None
    return "" if declared is None else declared.about


# ---- messages of the library in the words of who typed a recipe or a command -------------------
# The library names its arguments: ``pass zero=0.0``. Who wrote a recipe has keys with units,
# ``zero = "0 nm"``; who typed a command has ``--set zero="0 nm"``. What an argument is follows from
# the keys of the step alone (`Method.fields`, `input_fields`), never from a list of texts.

_COMMAND_COLUMNS = ("x", "z", "angle", "time", "repeat", "feed", "run", "direction", "readings")
"""Columns that the command has an option for; the others are given with ``--column``."""
_COMMAND_INPUT = ("scale", *TEXT_OPTIONS, "unit", "channel", "lateral_step")
_DIGITS = 6
"""Kept of a number that the library proposes."""
_OTHER_NAMES = {"dx": "lateral_step", "dy": "lateral_step"}
"""Arguments of the library that a file of maps has under another name."""

_VALUE = rf"'[^']*'|\"[^\"]*\"|\([^()]*\)|\[[^\[\]]*\]|{NUMBER}(?![\w.])|\.\.\.|[A-Za-z]\w*"
_PYTHON = rf"(?<![\w.\-\"'])([a-z_]\w*)=(?!=)({_VALUE})?( (?:nm|um|mm|m|rad|s)\b)?"
_ASKED = (
    r"\b((?:(?:give|pass|state) (?=[a-z])|(?:set|lower|needs?|without|unless|name|say|with|or)"
    r" (?=[a-z]+_)))([a-z]\w*)\b(?! =|[=(\w])"
)
_TOML = (
    r"(?<![\w.\-])([a-z_]\w*) = (\"[^\"]*\"|\[[^\[\]]*\](?!\])|true|false|-?\d+)"
    r"(?: in \[input\])?"
)
_NAMED = re.compile(f"{_PYTHON}|{_ASKED}|{_TOML}")
"""An argument as Python writes it, one that is asked for by its name alone, one as a recipe has it."""
_OTHER_ARGUMENT = re.compile(r",? or (?:give |tell it with )?([a-z_]\w*)=(?=[;.,]|$)")
"""A last way out by an argument, which falls away where the step has no such key."""
_ALL_THE_SAME = re.compile(r" \(([a-z_]\w*)=\w+ in Python does it all the same\)")
"""A way out that only a step with such a key has."""
_SENSITIVITY = re.compile(r"give the sensitivity of the sensor, such as scale='[^']*'")
_MULTIPLY = (
    "multiply it by the sensitivity of the sensor, and let the header name the unit of length"
)
_DEGREES = re.compile(
    r"degrees(?:, rad are needed|; give radians \(np\.deg2rad of it\)|: give numpy\.deg2rad\(\w+\))"
)
_ARRAY = re.compile(r"(?<=\))(,) or give an array \([^()]*\)|or give an array \([^()]*\)")
_SPLIT = "split the run at its turning points or "
_SI_AFTER = re.compile(r",? in (?:m|rad|s)\b(?= as well|[;.]|$)")


@dataclass(frozen=True, slots=True)
class StepKeys:
    """The keys that a step and its input have."""

    step: Mapping[str, Field]  # mapping of str to Field: keys of the step
    source: Mapping[str, Field]  # mapping of str to Field: keys of ``[input]``
    columns: frozenset[str] = frozenset()  # collection of str: which of the latter name columns


def keys_of_step(op: str) -> StepKeys | None:
    """Return the keys of a step."""
    from metrosep.core.methods import METHODS
    from metrosep.recipe.pipeline import MEASURING
    from metrosep.recipe.schema import input_fields
    from metrosep.recipe.steps import INPUT, MEASURING_INPUT, STEPS

    if op in STEPS:
        columns = frozenset({"x", "z", "feed", "run", "direction", "time"})
        return StepKeys(STEPS[op], MEASURING_INPUT if op in MEASURING else INPUT, columns)
    if op not in METHODS:
        return None
    method = METHODS[op]
    source = input_fields(method)
    places = {"x", "angle", "repeat", "readings"} if method.reads == "curves" else set()
    return StepKeys(method.fields, source, frozenset({*method.roles, *places} & set(source)))


def step_words(message: str, op: str, *, command: bool = False) -> str:
    """Return a message of the library with its arguments as keys of a step.

    Notes
    -----
    Numbers of keys with a dimension are SI in the library and get their unit here. A key without
    its value gets dots and the unit that it takes. Words that are not keys of the step stay.

    Examples
    --------
    >>> step_words("pass zero=0.0 to keep it", "three_point")
    'pass zero = "0 nm" to keep it'
    >>> step_words("pass zero=0.0 to keep it", "three_point", command=True)
    'pass --set zero="0 nm" to keep it'
    >>> step_words("one reading and no sd=", "abba", command=True)
    'one reading and no --set sd="... nm"'
    """
    keys = keys_of_step(op)
    return readable_text(message) if keys is None else in_words(message, keys, command=command)


def in_words(message: str, keys: StepKeys, *, command: bool = False) -> str:
    """Return a message of the library with its arguments as these keys."""

    def words(found: re.Match[str]) -> str:
        name, value, unit, verb, asked, key, typed = found.groups()
        text: str | None = None
        if key is not None:
            text = _typed(key, typed, keys) if command else None
        elif asked is not None:
            if asked in keys.step:
                text = verb + _set_or_key(asked, None, "", keys.step[asked], command=command)
        else:
            before = found.string[: found.start()]
            option = command and not before.endswith("got ")
            if not re.search(r"\w\([^()]*$", before):  # no call of Python
                text = _worded(name, value, unit or "", keys, command=option)
        return found.group() if text is None else text

    message = _of_columns(message if command else waived(message), keys)
    changed = _NAMED.sub(words, message)
    if changed != message:
        changed = re.sub(r"\bset --set ", "give --set ", _SI_AFTER.sub("", changed))
    return readable_text(changed)


def _of_columns(message: str, keys: StepKeys) -> str:
    """Return a message without what only a call of Python has: arrays, radians, other arguments."""

    def known(found: re.Match[str]) -> str:
        return found.group() if found.group(1) in {**keys.step, **keys.source} else ""

    message = _OTHER_ARGUMENT.sub(known, message)
    message = _ALL_THE_SAME.sub(
        lambda found: known(found).replace(" in Python does", " does"), message
    )
    if "scale" not in keys.source and "scale" not in keys.step:
        message = _SENSITIVITY.sub(_MULTIPLY, message)
    if "angle" in keys.source:
        message = _DEGREES.sub("degrees: rename the column so that it ends in _deg", message)
    if "repeat" in keys.source:
        message = _ARRAY.sub(lambda found: "" if found.group(1) else "and repeat=", message)
        message = message.replace("(repeat, a column", "(repeat=, a column")
        message = message.replace("add the channel 'angle' in rad and", "name angle= and")
        message = message.replace(
            _SPLIT, "number the runs in a column and name it with repeat=, or "
        )
    return message


def _typed(name: str, value: str, keys: StepKeys) -> str | None:
    """Return a key that a message writes as a recipe has it, as an option."""
    text = re.sub(r'"|^\[|\]$', "", value)
    if name in keys.step:
        return _set(name, text)
    return _source(name, text, keys, command=True) if name in keys.source else None


def _worded(
    name: str, value: str | None, unit: str, keys: StepKeys, *, command: bool
) -> str | None:
    """Return one argument as a key; None where it is none of this step."""
    parts = re.findall(r"\w+", value) if value is not None and value.startswith("(") else []
    if name not in keys.step and len(parts) > 1 and all(p in keys.step for p in parts):
        each = [_worded(p, None, "", keys, command=command) or p for p in parts]
        return ", ".join(each[:-1]) + f" and {each[-1]}"
    if name in keys.step and _fits(value, keys.step[name]):
        return _set_or_key(name, value, unit, keys.step[name], command=command)
    name = _OTHER_NAMES.get(name, name)
    if name not in keys.source or (name in keys.columns and re.fullmatch(NUMBER, value or "")):
        return None
    return _source(name, value, keys, command=command)


def _set_or_key(name: str, value: str | None, unit: str, field: Field, *, command: bool) -> str:
    """Return a key of the step with its value, or with what the value looks like."""
    if value is None or _is_open(value):
        text = placeholder(name, field)
        n = len(re.findall(r"[A-Za-z]\w*", value or ""))
        if n and ", " in text:
            text = ", ".join([text.split(", ")[0]] * n)
    else:
        text = _converted(value, unit, field)
    return _set(name, text) if command else _key(name, text, field)


def _source(name: str, value: str | None, keys: StepKeys, *, command: bool) -> str:
    """Return a key of ``[input]``, or the option that gives it."""
    if name in keys.columns:
        pair = re.fullmatch(r"\(\s*'([^']*)',\s*'([^']*)'\s*\)", value or "")
        value = ":".join(pair.groups()) if pair else value
        column = "COLUMN" if value is None or _is_open(value) else value.strip("'\"")
        column = re.sub(r",\s+", ",", column)
        if not command:
            return f'{name} = "{column}" in [input]'
        return f"--{name} {column}" if name in _COMMAND_COLUMNS else f"--column {name}={column}"
    field = keys.source[name]
    text = placeholder(name, field) if _is_open(value) else _converted(value, "", field)
    if name == "lateral_step":
        text = text.replace("... mm", "... um")
    if command and name in _COMMAND_INPUT:
        option = name.replace("_", "-")
        return f"--{option} {_shell(text)}"
    return f"{_key(name, text, field)} in [input]"


def _is_open(value: str | None) -> bool:
    """Whether no value is named: nothing, dots, or letters that stand for values."""
    return value is None or "..." in value or bool(re.fullmatch(r"[(\[][A-Za-z_, ]+[)\]]", value))


def _fits(value: str | None, field: Field) -> bool:
    """Whether a key could hold the value: one of its choices, where it has any."""
    if value is None or not field.choices or _is_open(value):
        return True
    return value.strip("'\"") in {str(c) for c in field.choices}


def _converted(value: str | None, unit: str, field: Field) -> str:
    """Return a value as it is typed: numbers in SI with the unit of the key."""
    text = (value or "").strip("'\"")
    if value != text:  # a text has its unit
        return text
    if text in ("True", "False"):
        return text.lower()
    if unit and unit.strip() not in ("m", "rad", "s"):
        return text + unit
    dimension = DIMENSIONS.get(field.kind)
    if dimension is None or field.kind == "waves":
        return text.strip("()[]")

    def with_unit(number: re.Match[str]) -> str:
        return typed_number(float(number.group()), dimension, digits=_DIGITS)

    return re.sub(NUMBER, with_unit, text.strip("()[]"))


def _key(name: str, text: str, field: Field) -> str:
    written = KINDS[field.kind].written
    if written.startswith("plain") or (
        field.kind in ("degree", "waves") and re.fullmatch(r"[\d.]+", text)
    ):
        return f"{name} = [{text}]" if "list" in written else f"{name} = {text}"
    if KINDS[field.kind].is_list:
        return f"{name} = [" + ", ".join(f'"{t.strip()}"' for t in text.split(",")) + "]"
    return f'{name} = "{text}"'


def _set(name: str, text: str) -> str:
    return f"--set {name}={_shell(text)}"


def _shell(text: str) -> str:
    return text if re.fullmatch(r"[\w.+-]+", text) else f'"{text}"'


# ---- what readers and separations say, in the words of a recipe: their arguments are its keys ----

_OF_READERS = frozenset(
    {
        *TEXT_OPTIONS, "group", "max_pixels", "names", "numbered", "overhang", "radius",
        "sampling_rate", "segment", "servo_period", "slope", "time",
    }
)  # fmt: skip
"""Arguments of readers that ``metrosep convert`` takes with ``--set``."""
_READ_RUNS = re.compile(
    r",? or read repeated runs with metrosep\.read_runs\([^()]*\) or metrosep separate [^;]*"
)
"""A way out that is a call of Python; a recipe of another step does it."""
_CONVERT = (
    "; what --set names is not a key of [input]: metrosep convert takes it, then run the recipe on the "
    "file that it writes"
)


def reading_words(message: str, op: str) -> str:
    """Return a message of a reader with its arguments as keys of ``[input]``.

    Examples
    --------
    >>> reading_words("give unit='nm'", "parameters")
    'give unit = "nm" in [input]'
    """
    from metrosep.recipe.written.overrides import input_fields_of

    keys, fields = keys_of_step(op), input_fields_of(op)
    if fields is None:
        return readable_text(message)
    if keys is None or keys.source != fields:  # a step that measures: readers of single files
        columns = frozenset(k for k, f in fields.items() if f.kind == "column")
        keys = StepKeys({}, fields, columns)
    message = in_words(_READ_RUNS.sub("", message), keys, command=False)

    def option(found: re.Match[str]) -> str:
        name, value = found.group(1), found.group(2)
        if name not in _OF_READERS or name in keys.source or name in keys.step:
            return found.group()
        text = "..." if value is None else value.strip("'\"")
        return f'--set "{name}={text}"'

    changed = ARGUMENT.sub(option, message)
    return changed if changed == message else changed.rstrip(".") + _CONVERT


def recipe_words(recipe: Recipe, message: str) -> str:
    """Return a message of the library with its arguments as keys of a recipe."""
    if not message.startswith(f"{recipe.name}:"):  # of a line of the recipe, or already so
        message = reading_words(message, recipe.steps[0]["op"])
    for step in recipe.steps:
        message = step_words(message, step["op"])
    return message


@contextmanager
def in_recipe_words(recipe: Recipe) -> Iterator[None]:
    """Let errors name keys of the recipe that is run, as the command ``run`` prints them."""
    try:
        yield
    except MetrosepError as exc:
        exc.args = (recipe_words(recipe, str(exc)), *exc.args[1:])
        raise


# ---- everything from which a form for the steps of any recipe can be made ----------------------

_OF_RUNS = ("separate", "polynomial", "plan_feedrates")


def described_steps() -> dict[str, Any]:
    """Return the steps of all recipes with their keys.

    Examples
    --------
    >>> [s["op"] for s in described_steps()["steps"] if "runs" in s["applies"]]
    ['separate', 'polynomial', 'plan_feedrates']
    """
    steps = list(schema()["steps"])
    steps += [_described(op, WHAT[op], STEPS[op], "runs") for op in _OF_RUNS]
    steps += [
        _described(op, method.what, method.fields, "method") for op, method in METHODS.items()
    ]
    return {"steps": steps}


def _described(op: str, what: str, fields: Mapping[str, Field], applies: str) -> dict[str, Any]:
    return {
        "op": op,
        "what": what,
        "applies": [applies],
        "keys": [
            {
                "name": name,
                "kind": field.kind,
                "required": field.required,
                "choices": list(field.choices),
                "default": field.default,
                "dimension": DIMENSIONS.get(field.kind),
                "help": field.about or kind_words(field.kind),
                "keys": [],
            }
            for name, field in fields.items()
            if name != "op"
        ],
    }


# ---- what a table and its controller say, in the words of a recipe ------------------------------

ARGUMENT = re.compile(r"(?<![\w.\-\"'])([a-z_]+)=(?!=)('[^']*'|\"[^\"]*\"|[-+]?[\w.]*\w)?")

_WAIVED = re.compile(r"say waive='([^']*)'")
"""A way out that is a key of the output whose file was refused."""


def waived(message: str) -> str:
    """Return a message with the waiver that it asks for as the key of an output."""

    def listed(found: re.Match[str]) -> str:
        return "write waive = [" + ", ".join(f'"{c}"' for c in found[1].split(", ")) + "] there"

    return _WAIVED.sub(listed, message)


def table_words(message: str, controller: str) -> str:
    """Return a message about a table with its arguments as keys of the output and of its machine.

    Examples
    --------
    >>> table_words("use direction='both', or give capacity=300", "isg-plane")
    'use direction = "both", or give capacity = 300 in machine'
    """
    from metrosep.controllers.options import LIMIT_NAMES
    from metrosep.controllers.registry import find

    facts = {*LIMIT_NAMES, *(o.name for o in find(controller).options)}

    def key(found: re.Match[str]) -> str:
        name, value = found.groups()
        if re.search(r"\w\([^()]*$", found.string[: found.start()]):  # a call of Python
            return found.group()
        if value is None:
            return name
        typed = value.strip("'\"")
        typed = typed.lower() if typed in ("True", "False") else typed
        plain = re.fullmatch(rf"true|false|{NUMBER}", typed) and typed == value.lower()
        where = " in machine" if name in facts else ""
        return f"{name} = {typed}{where}" if plain else f'{name} = "{typed}"{where}'

    return ARGUMENT.sub(key, waived(message))


@contextmanager
def in_table_words(controller: str) -> Iterator[None]:
    """Let errors about a table name keys of its output."""
    try:
        yield
    except MetrosepError as exc:
        exc.args = (table_words(str(exc), controller), *exc.args[1:])
        raise
