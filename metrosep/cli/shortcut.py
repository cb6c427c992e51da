"""The recipe that a call of ``metrosep separate`` stands for."""

from __future__ import annotations

import re
from collections.abc import Collection, Container, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from metrosep.cli.errors import bare_options, flags_of
from metrosep.cli.options import key_values, name_values, whole
from metrosep.core.readable import did_you_mean
from metrosep.core.text_options import TEXT_OPTIONS

if TYPE_CHECKING:
    from metrosep.core.errors import RecipeError
    from metrosep.core.options import Option
    from metrosep.recipe.recipe import Recipe

RUN_INPUT = ("x", "z", "feed", "run", "direction", "time", "sampling_rate", "scale", *TEXT_OPTIONS)

PARTS_AND_REPORT = (
    "", "[[output]]", 'kind = "parts"', "", "[[output]]", 'kind = "report"', 'formats = ["html"]',
)  # fmt: skip


def of_table() -> dict[str, str]:
    """Return the options of a table by the names behind ``--table``; others are facts of its machine."""
    from metrosep.core.options import options_of
    from metrosep.separation.positions.expansion import Expansion

    return {**_OF_TABLE, **{k: k for k in options_of(Expansion)}}


_OF_TABLE = {
    "axis": "axis",
    "compensates": "compensates",
    "spacing": "spacing",
    "reference": "reference",
    "reference_direction": "reference_direction",
    "active": "active",
    "direction": "table_direction",
    "table_direction": "table_direction",
    "degree": "degree",
    "waive": "waive",
    "sign_confirmed": "sign_confirmed",
}
"""Those that do not come from `Expansion`."""


def named_tables(
    texts: Iterable[str], options: Mapping[str, Any], *, inside: bool
) -> list[dict[str, Any]]:
    """Return the options of each ``--table "FORMAT=FILE; NAME=VALUE; ..."``: its own, then those of the call.

    A comma before the next NAME= separates, too.
    """
    found: list[dict[str, Any]] = []
    for text in texts:
        first, *own = re.split(r"[,;](?=\s*[A-Za-z][\w.-]*\s*=)", text)
        controller, _, path = (part.strip() for part in first.partition("="))
        if not controller or not path:
            raise click.UsageError(
                f'--table is written FORMAT=FILE or "FORMAT=FILE; NAME=VALUE; ...", found {text!r}: such as '
                '"linuxcnc=x.comp; spacing=2 mm"'
            )
        made = _with_own(f"--table {controller}={path}", controller, own, options)
        name = Path(path).name
        if any(o["path"] == name and o["target"] != path for o in found):
            name = f"{len(found) + 1}-{name}"  # in another folder
        found.append({**made, "target": path, "path": path if inside else name})
    return found


def _with_own(
    label: str, controller: str, texts: Iterable[str], options: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the options of one table."""
    from metrosep.cli.options import USUAL_SPACING, USUAL_TURN, lacking_facts
    from metrosep.compensation.area_errors import is_rotary
    from metrosep.controllers.registry import find, names
    from metrosep.recipe.preflight import which_axis

    known = of_table()
    made: dict[str, Any] = {k: options.get(k) for k in dict.fromkeys(known.values())}
    machine: dict[str, Any] = {**key_values(options.get("machine") or (), "--machine")}
    if options.get("cross_axis") is not None:
        machine["cross_axis"] = options["cross_axis"]
    waive = [*(options.get("waive") or ())]
    facts = known_facts(find(controller)) if controller in names() else None
    stated: list[str] = []
    for text in texts:
        name, _, value = (part.strip() for part in text.partition("="))
        key = name.replace("-", "_")
        fact = key.removeprefix("machine.")
        if not value:
            raise click.UsageError(f"{label}: {name} has no value")
        if key in stated and key != "waive":
            raise click.UsageError(f"{label}: {name} is given twice")
        if facts is not None and key not in known and fact not in facts:
            hint = did_you_mean(key, [*known, *facts])
            raise click.UsageError(
                f"{label}: there is no option {name!r}.{hint} A table has {', '.join(known)}; "
                f"{controller} {', '.join(facts)}"
            )
        stated.append(key)
        if key == "waive":
            waive.append(value)
        elif key in known:
            made[known[key]] = value
        else:
            machine[fact] = value
    column = options.get("x")
    made["axis"] = made["axis"] or axis_of_columns([str(column)] if column else [])
    turns = is_rotary(made["axis"])
    made["spacing"] = made["spacing"] or (USUAL_TURN if turns else USUAL_SPACING)
    if made["compensates"] is None:
        known_now = [f"{k}={v}" for k, v in machine.items()]
        lacking = lacking_facts(controller, known_now) if facts is not None else {}
        more = "".join(f"; '--{k}' is missing, too ({v})" for k, v in lacking.items())
        raise click.UsageError(f"{label}: {which_axis(made['axis'], '--compensates ')}{more}")
    return {
        **made, "label": label, "controller": controller, "machine": machine, "waive": waive,
        "own": stated,
    }  # fmt: skip


def axis_of_columns(columns: Iterable[str]) -> str:
    """Return the axis that columns of positions are called after, and say so: y_mm is Y; else X."""
    from metrosep.cli.options import say

    known = list(dict.fromkeys(columns))
    found = (re.match(r"([xyzuvw]\d?)(?![a-z0-9])", c, flags=re.IGNORECASE) for c in known)
    letters = list(dict.fromkeys(m[1].upper() for m in found if m))
    named = ", ".join(known)
    if len(letters) > 1:
        raise click.UsageError(
            f"the positions are of columns {named}: say which axis was travelled with --axis"
        )
    if not letters and known:
        say(
            f"note: axis X, the usual one: column {named} does not name its axis; else give --axis"
        )
    elif letters and letters != ["X"]:
        say(f"note: axis {letters[0]}, as column {named} is called; else give --axis")
    return letters[0] if letters else "X"


def known_facts(dialect: Any) -> tuple[str, ...]:
    """Return the names of the options and limits that a dialect takes."""
    from metrosep.controllers.options import LIMIT_NAMES

    own = tuple(o.name for o in dialect.options)
    return (*own, *(n for n in LIMIT_NAMES if n not in own))


def _table_lines(made: Mapping[str, Any]) -> list[str]:
    """Return a table as an output of a recipe."""
    lines = ["", "[[output]]", 'kind = "table"', f"controller = {quoted(made['controller'])}"]
    lines.append(f"axis = {quoted(made['axis'] or 'X')}")
    written = ("axis", "degree", "waive", "sign_confirmed", "table_direction")
    keys = {k: v for k, v in of_table().items() if k not in written}
    for key, name in keys.items():
        value = made.get(name)
        if value not in (None, False):
            lines.append(f"{key} = {'true' if value in (True, 'true') else quoted(value)}")
    if made.get("degree") not in (None, "auto"):
        degree = str(made["degree"])
        lines.append(f"degree = {whole(degree) or quoted(degree)}")
    lines.append(f"path = {quoted(made['path'])}")
    if made["machine"]:
        pairs = ", ".join(f"{name} = {quoted(value)}" for name, value in made["machine"].items())
        lines.append(f"machine = {{ {pairs} }}")
    if made["waive"]:
        lines.append(f"waive = {list_of(made['waive'])}")
    confirmed = made.get("sign_confirmed")
    if confirmed:
        word = "true" if confirmed is True else confirmed
        lines.append(f"sign_confirmed = {word if word in ('true', 'false') else quoted(word)}")
    return lines


def recipe_text(
    options: dict[str, Any], *, tables: Iterable[Mapping[str, Any]], report: bool
) -> str:
    """Return the recipe of a call as TOML."""
    from metrosep.recipe.steps import STEPS

    lines = ["metrosep = 1", "", "[input]"]
    lines += input_lines(options, RUN_INPUT)
    lines += ["", "[[step]]", 'op = "separate"']
    fields = STEPS["separate"]
    own = {k: options.get(k) for k in fields if k not in RUN_INPUT}  # --feed names a column
    stated = {k: v for k, v in own.items() if v is not None and v is not False}
    given = {k: "true" if v is True else str(v) for k, v in stated.items()}
    for key, value in name_values(tuple(options.get("settings") or ()), "--set"):
        if key in given:
            raise click.UsageError(
                f"{key} is given twice, with --{key.replace('_', '-')} and --set"
            )
        given[key] = value
    lines += [f"{key} = {typed(key, value, fields)}" for key, value in given.items()]
    if options.get("poly") is not None:
        degree = str(options["poly"])
        lines += ["", "[[step]]", 'op = "polynomial"', 'quantity = "error"']
        lines.append(f"degree = {whole(degree) or quoted(degree)}")
    for made in tables:
        lines += _table_lines(made)
    if report:
        lines += ["", "[[output]]", 'kind = "report"', 'formats = ["html"]']
    return "\n".join(lines) + "\n"


def own_recipe(
    context: click.Context, lines: Iterable[str], *, report: bool, print_recipe: bool
) -> Recipe | None:
    """Return the recipe of a call from its lines, with its outputs; None where it was only printed."""
    from metrosep.core.errors import RecipeError
    from metrosep.recipe.recipe import Recipe

    text = "\n".join([*lines, *(PARTS_AND_REPORT if report else ())]) + "\n"
    if print_recipe:
        click.echo(text, nl=False)
        return None
    try:
        return Recipe.parse(text, name="command line", folder=Path.cwd())
    except RecipeError as error:
        raise click.UsageError(option_error(error), ctx=context) from None


def of_reader(
    settings: Iterable[tuple[str, str]], known: Container[str], fields: Container[str]
) -> tuple[dict[str, str], list[tuple[str, str]]]:
    """Return what ``--set`` says of the reading of a map, which belongs to ``[input]``, and the rest."""
    pairs = list(settings)
    own = {k: v for k, v in pairs if k == "row_order" and k in known and k not in fields}
    return own, [(k, v) for k, v in pairs if k not in own]


def input_lines(given: Mapping[str, Any], keys: Iterable[str]) -> list[str]:
    """Return the lines of ``[input]`` for the options that were given; a count is not a text."""
    return [
        f"{k} = {(whole(str(given[k])) if k == 'skip_rows' else None) or quoted(given[k])}"
        for k in keys
        if given.get(k) is not None
    ]


def option_error(
    error: RecipeError,
    *,
    settings: Collection[str] = (),
    columns: Collection[str] = (),
    text: str = "",
    tables: Sequence[Mapping[str, Any]] = (),
) -> str:
    """Return the message of an error in the recipe of a call, in terms of the options given.

    Of an output that is one of `tables`, in the `text` of the recipe, it names the table.
    """
    number = text.splitlines()[: error.line or 0].count("[[output]]") - 1
    if 0 <= number < len(tables):
        made = tables[number]
        said = option_error(error)
        if error.key in (*made["own"], "controller", "path", "machine"):
            said = re.sub(r"^--[\w-]+ ", f"{error.key} ", re.sub(r"^--[\w-]+: ", "", said))
        said = re.sub(
            r": write machine = .*",
            "; add NAME=VALUE behind the file, or --machine NAME=VALUE",
            said,
        )
        return f"{made['label']}: {said}"
    message = re.sub(r"^(command line(:\d+)?: )?(step \d+ \([\w-]+\): )?", "", str(error))
    key = "" if error.key == "op" else error.key or ""  # the command is its operation
    options = {"degree": "poly", "controller": "table", "path": "table", "machine": "machine"}
    option = "--" + options.get(key, key).replace("_", "-")
    if key in settings:
        option = f"--set {key}"
    elif key in columns:
        option = f"--column {key}"
    context = click.get_current_context(silent=True)
    if message.startswith((f"{key} = ", f"{key} ")):
        message = f"{option} {message.removeprefix(key).removeprefix(' =').lstrip()}"
        key = ""
    if context is not None:
        message = bare_options(message, flags_of(context.command))
    return f"{option}: {message}" if key else message


def quoted(value: object) -> str:
    """Return a value as TOML writes a text."""
    import json

    return json.dumps(str(value), ensure_ascii=False).replace("\x7f", "\\u007f")


def typed(key: str, value: str, fields: Mapping[str, Option]) -> str:
    """Return a value as TOML writes it, after the kind of its key."""
    from metrosep.core.options import KINDS

    field = fields.get(key)
    kind = KINDS["text" if field is None else field.kind]
    if kind is KINDS["table"]:
        return _table(key, value)
    if (kind is KINDS["frequencies"] and value == "auto") or kind.written == "text":
        number = (
            whole(value) if field is not None and field.kind in ("degree", "spacing") else None
        )
        return number or quoted(value)
    if kind.written == "plain" or (kind is KINDS["waves"] and whole(value)):
        return _plain(key, value)
    if kind.written == "plain list":
        return "[" + ", ".join(_plain(key, v.strip()) for v in value.split(",")) + "]"
    if kind.written in ("pairs", "plain pairs"):
        return _nested(value, numbers=kind.written == "plain pairs")
    return listed(value)


def _plain(key: str, value: str) -> str:
    """Return a number or true or false as it is; refuse what TOML does not know as one."""
    import tomllib

    value = whole(value) or value
    try:
        tomllib.loads(f"v = {value}")
    except tomllib.TOMLDecodeError:
        raise click.UsageError(
            f"--set {key}: a number, true or false is needed, found {value!r}"
        ) from None
    return value


def _table(key: str, value: str) -> str:
    """Return ``{ EZX = 6, EZC = "auto" }`` as it is, and ``EZX=6, EZC=auto`` as such a table."""
    import tomllib

    if value.lstrip().startswith("{"):
        try:
            tomllib.loads(f"v = {value}")
        except tomllib.TOMLDecodeError:
            raise click.UsageError(
                f"--set {key}: {value!r} is not a table of TOML; texts in it stand in quotes, or type NAME=VALUE, "
                "NAME=VALUE"
            ) from None
        return value
    pairs = name_values(tuple(value.split(",")), f"--set {key}")
    return "{ " + ", ".join(f"{quoted(k)} = {whole(v) or quoted(v)}" for k, v in pairs) + " }"


def _nested(value: str, *, numbers: bool) -> str:
    """Return ``a..b, c..d`` as pairs, and a plain list as it is."""
    items = [item.strip() for item in value.split(",")]
    if not any(".." in item for item in items):
        return f"[{value}]" if numbers else listed(value)
    pairs = []
    for item in items:
        pair = [p.strip() for p in item.split("..")]
        pairs.append("[" + ", ".join(p if numbers else quoted(p) for p in pair) + "]")
    return "[" + ", ".join(pairs) + "]"


def listed(texts: str) -> str:
    """Return texts with commas between them as a list of TOML; what is empty is omitted."""
    return list_of(t.strip() for t in texts.split(",") if t.strip())


def list_of(texts: Iterable[str]) -> str:
    """Return texts as a list of TOML."""
    return f"[{', '.join(map(quoted, texts))}]"
