"""The recipe that a call of ``metrosep separate`` stands for."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping
from typing import TYPE_CHECKING, Any

from metrosep.core.text_options import TEXT_OPTIONS

if TYPE_CHECKING:
    from metrosep.core.errors import RecipeError

__all__ = ["input_lines", "option_error", "quoted", "recipe_text"]

_INPUT = ("x", "z", "feed", "run", "direction", "time", "sampling_rate", "scale", *TEXT_OPTIONS)
_SEPARATE = ("method", "start", "length", "shortest", "lag")


def recipe_text(options: dict[str, Any], *, table: tuple[str, str] | None, report: bool) -> str:
    """Return the recipe of a call as TOML."""
    lines = ["metrosep = 1", "", "[input]"]
    lines += input_lines(options, _INPUT)
    lines += ["", "[[step]]", 'op = "separate"']
    lines += [f"{k} = {quoted(options[k])}" for k in _SEPARATE if options.get(k) is not None]
    for key in ("exclude", "accept"):
        if options.get(key) is not None:
            names = (name.strip() for name in str(options[key]).split(","))
            lines.append(f"{key} = [{', '.join(quoted(name) for name in names if name)}]")
    for key in ("min_feeds", "drift"):
        if options.get(key) is not None:
            lines.append(f"{key} = {options[key]}")
    if options.get("lines") is not None:
        asked = str(options["lines"])
        each = ", ".join(quoted(f.strip()) for f in asked.split(","))
        lines.append(f"lines = {quoted(asked) if asked == 'auto' else f'[{each}]'}")
    if options.get("robust"):
        lines.append("robust = true")
    if options.get("poly") is not None:
        degree = str(options["poly"])
        lines += ["", "[[step]]", 'op = "polynomial"', 'quantity = "error"']
        lines.append(f"degree = {degree if degree.isdecimal() else quoted(degree)}")
    if table is not None:
        lines += ["", "[[output]]", 'kind = "table"', f"controller = {quoted(table[0])}"]
        options = {**options, "axis": options.get("axis") or "X"}
        lines += [
            f"{k} = {quoted(options[k])}"
            for k in ("axis", "compensates", "spacing", "reference")
            if options.get(k) is not None
        ]
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
