"""The recipe that a call of ``metrosep separate`` stands for."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping
from typing import TYPE_CHECKING, Any

import click

from metrosep.core.text_options import TEXT_OPTIONS

if TYPE_CHECKING:
    from metrosep.core.errors import RecipeError
    from metrosep.core.options import Option

__all__ = ["input_lines", "listed", "option_error", "quoted", "recipe_text", "typed"]

_INPUT = ("x", "z", "feed", "run", "direction", "time", "sampling_rate", "scale", *TEXT_OPTIONS)


def recipe_text(options: dict[str, Any], *, table: tuple[str, str] | None, report: bool) -> str:
    """Return the recipe of a call as TOML."""
    from metrosep.cli.options import USUAL_SPACING, name_values
    from metrosep.core.options import options_of
    from metrosep.recipe.steps import STEPS
    from metrosep.separation.positions.expansion import Expansion

    lines = ["metrosep = 1", "", "[input]"]
    lines += input_lines(options, _INPUT)
    lines += ["", "[[step]]", 'op = "separate"']
    fields = STEPS["separate"]
    own = {k: options.get(k) for k in fields if k not in _INPUT}  # --feed names a column
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
        lines.append(f"degree = {degree if degree.isdecimal() else quoted(degree)}")
    if table is not None:
        lines += ["", "[[output]]", 'kind = "table"', f"controller = {quoted(table[0])}"]
        options = {**options, "axis": options.get("axis") or "X"}
        options["spacing"] = options.get("spacing") or USUAL_SPACING
        keys = (
            "axis", "compensates", "spacing", "reference", "reference_direction",
            "active",
            *options_of(Expansion),
        )  # fmt: skip
        shape: dict[str, Any] = {
            k: options[k] for k in keys if options.get(k) not in (None, False)
        }
        lines += [f"{k} = {'true' if v is True else quoted(v)}" for k, v in shape.items()]
        if options.get("table_direction") is not None:
            lines.append(f"direction = {quoted(options['table_direction'])}")
        lines.append(f"path = {quoted(table[1])}")
        lines += _machine_lines(options)
    if report:
        lines += ["", "[[output]]", 'kind = "report"', 'formats = ["html"]']
    return "\n".join(lines) + "\n"


def input_lines(given: Mapping[str, Any], keys: Iterable[str]) -> list[str]:
    """Return the lines of ``[input]`` for the options that were given; a count is not a text."""
    return [
        f"{k} = {given[k] if k == 'skip_rows' and str(given[k]).isdecimal() else quoted(given[k])}"
        for k in keys
        if given.get(k) is not None
    ]


def _machine_lines(options: dict[str, Any]) -> list[str]:
    """Return the keys of a table that are facts about the machine, and what was waived."""
    from metrosep.cli.options import name_values

    given = name_values(tuple(options.get("machine") or ()), "--machine")
    if options.get("cross_axis") is not None:
        given.append(("cross_axis", options["cross_axis"]))
    lines = []
    if given:
        pairs = ", ".join(f"{name.replace('-', '_')} = {quoted(value)}" for name, value in given)
        lines.append(f"machine = {{ {pairs} }}")
    if options.get("waive"):
        lines.append(f"waive = [{', '.join(map(quoted, options['waive']))}]")
    if options.get("sign_confirmed"):
        lines.append("sign_confirmed = true")
    return lines


def option_error(
    error: RecipeError, *, settings: Collection[str] = (), columns: Collection[str] = ()
) -> str:
    """Return the message of an error in the recipe of a call, in terms of the options given."""
    message = re.sub(r"^command line(:\d+)?: ", "", str(error))
    key = error.key or ""
    options = {"degree": "poly", "controller": "table", "path": "table", "machine": "machine"}
    option = "--" + options.get(key, key).replace("_", "-")
    if key in settings:
        option = f"--set {key}"
    elif key in columns:
        option = f"--column {key}"
    if message.startswith(f"{key} = "):
        return f"{option} {message.removeprefix(f'{key} = ')}"
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
    if (kind is KINDS["frequencies"] and value == "auto") or kind.written == "text":
        number = field is not None and field.kind in ("degree", "spacing") and value.isdecimal()
        return value if number else quoted(value)
    if kind.written == "plain" or (kind is KINDS["waves"] and value.isdecimal()):
        return _plain(key, value)
    if kind.written == "plain list":
        return "[" + ", ".join(_plain(key, v.strip()) for v in value.split(",")) + "]"
    if kind.written in ("pairs", "plain pairs"):
        return _nested(value, numbers=kind.written == "plain pairs")
    return listed(value)


def _plain(key: str, value: str) -> str:
    """Return a number or true or false as it is; refuse what TOML does not know as one."""
    import tomllib

    try:
        tomllib.loads(f"v = {value}")
    except tomllib.TOMLDecodeError:
        raise click.UsageError(
            f"--set {key}: a number, true or false is needed, found {value!r}"
        ) from None
    return value


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
    """Return texts with commas between them as a list of TOML; what is empty is left out."""
    return "[" + ", ".join(quoted(t.strip()) for t in texts.split(",") if t.strip()) + "]"
