"""The grammar of recipes: which keys exist, of which kind, and where a wrong one stands.

TOML, ``metrosep = 1``. Quantities are strings with units; an unknown key names its line, what is
known there and the nearest spelling.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from metrosep.core.errors import DataError, RecipeError
from metrosep.core.methods import Method
from metrosep.core.options import KINDS, Option, checked, not_one_of
from metrosep.core.readable import did_you_mean, digits_of, said_value, typed_number
from metrosep.core.text_options import ROW_ORDERS, TEXT_OPTIONS
from metrosep.core.units import SURROUNDINGS, TYPICAL

COMMAND = "command line"
"""Name of a recipe that a command makes: its lines mean nothing to who typed the command."""


@dataclass(frozen=True, slots=True)
class Place:
    """Where a table stands in a recipe, for messages.

    Parameters
    ----------
    file : str
        Name of the recipe.
    text : str
        Its whole text.
    header : str
        Header such as ``[input]`` or ``[[step]]``; empty for the top.
    number : int
        Which of the equal headers, from 0.
    """

    file: str
    text: str
    header: str = ""
    number: int = 0

    def line_of(self, key: str | None) -> int | None:
        """Return the line of a key of this table, or of its header, from 1."""
        lines = blanked_texts(self.text).splitlines()
        first, header = self._first_line(lines)
        if first is None:
            return None
        for i in range(first, len(lines)) if key is not None else ():
            stripped = lines[i].strip()
            if i >= first + header and stripped.startswith("["):
                break
            if re.match(rf"[\"']?{re.escape(str(key))}[\"']?\s*[=.]", stripped):
                return i + 1
        return first + 1 if header else None

    def _first_line(self, lines: list[str]) -> tuple[int | None, int]:
        """Index of the first line of this table, and 1 if that line is its header."""
        if not self.header:
            return 0, 0
        count = -1
        for i, line in enumerate(lines):
            if "".join(line.split("#")[0].split()) == self.header:
                count += 1
                if count == self.number:
                    return i, 1
        return None, 0

    def error(self, problem: str, key: str | None = None) -> RecipeError:
        """Return the error for a problem at a key, with file and line.

        Parameters
        ----------
        problem : str
            What is wrong and what would be right.
        key : str, optional
            The key.

        Returns
        -------
        RecipeError
            To be raised.
        """
        line = self.line_of(key)
        where = self.file if line is None else f"{self.file}:{line}"
        table = (self.header, self.number)
        return RecipeError(f"{where}: {problem}", key=key, line=line, table=table)


Field = Option
"""One key of a table."""

LAYOUT = {n: Field("integer" if n == "skip_rows" else "text") for n in TEXT_OPTIONS}
"""Keys of ``[input]`` that say how a text is written."""


def checked_table(
    data: Mapping[str, Any], fields: Mapping[str, Field], place: Place, *, what: str
) -> dict[str, Any]:
    """Return a table with its values in SI, or refuse it."""
    for key in data:
        if key not in fields:
            hint = did_you_mean(key, fields)
            raise place.error(
                f'unknown key "{key}" in {what}; known: {", ".join(fields)}.{hint}', key
            )
    for key, field in fields.items():
        if field.required and key not in data:
            raise place.error(f'{what} needs the key "{key}"')
    return {key: _value(value, fields[key], place, key) for key, value in data.items()}


def _value(value: Any, field: Field, place: Place, key: str) -> Any:
    if field.choices and (value not in field.choices or isinstance(value, bool)):
        raise place.error(not_one_of(key, value, field.choices), key)
    try:
        return checked(field, value, "value", bare=False)
    except (DataError, OverflowError) as exc:
        raise place.error(f"{key} = {said_value(value)}: {exc}", key) from None


def blanked_texts(text: str) -> str:
    """Return TOML with its texts of several lines blanked, line by line, so that no key hides there."""
    return re.sub(
        r'"""[\s\S]*?"""|\'\'\'[\s\S]*?\'\'\'',
        lambda found: '""' + "\n" * found.group().count("\n"),
        text,
    )


# ---- the table ``[batch]`` of a recipe: which files are units, what they are called, what is listed ----

BATCH = {
    "each": Field("text", choices=("file", "folder")),
    "pattern": Field("text"),
    "key": Field("texts"),
    "on_error": Field("text", choices=("continue", "stop")),
    "index": Field("texts"),
    "trend": Field("texts"),
    "order": Field("text"),
}

COLUMNS = (
    "file", "key", "characteristic", "metric", "value", "unit", "lower", "upper", "U", "verdict",
    "status", "reason", "result", "hash",
)  # fmt: skip
"""Columns of the index; a group of the pattern may not take their names."""

INDEX_FORMATS = ("csv", "html")
"""Of the index of a batch that names none."""

ORDERS = ("name", "time", "file_time")
"""Orders of the parts beside the groups: by name, measuring date, time of change of the file."""


def batch_table(data: Mapping[str, Any], place: Place) -> dict[str, Any]:
    """Return the table ``[batch]`` checked, with its defaults.

    Examples
    --------
    >>> place = Place("r.toml", "")
    >>> batch_table({"pattern": r"(?P<part>[A-Z]+)_(?P<serial>[0-9]+)[.]x3p"}, place)["key"]
    ('part', 'serial')
    """
    table = checked_table(data, BATCH, place, what="[batch]")
    pattern = table.get("pattern")
    groups = _groups(pattern, place)
    key = tuple(table.get("key", groups))
    if "key" in table and pattern is None:
        raise place.error(
            "key names groups of a pattern, and there is none: add "
            "pattern = '(?P<part>[A-Z]+)_(?P<serial>[0-9]+)[.]x3p'",
            "key",
        )
    for name in key:
        if name not in groups:
            known = ", ".join(groups) or "none"
            raise place.error(f'key: the pattern has no group "{name}"; it has {known}', "key")
    for name in ("key", "index", "trend"):
        _once(table.get(name, ()), name, place)
    order = table.get("order", "name")
    _require_order(order, groups, place)
    return {
        "each": table.get("each"),
        "pattern": pattern,
        "key": key,
        "groups": (*key, *(g for g in groups if g not in key)),
        "on_error": table.get("on_error", "continue"),
        "index": tuple(table.get("index", INDEX_FORMATS)),
        "trend": tuple(table.get("trend", ())),
        "order": order,
    }


def _groups(pattern: str | None, place: Place) -> tuple[str, ...]:
    if pattern is None:
        return ()
    try:
        groups = tuple(re.compile(pattern).groupindex)
    except re.error as exc:
        at = "" if exc.pos is None else f" at character {exc.pos + 1}"
        raise place.error(
            f"pattern is not a regular expression: {exc.msg}{at}; write it in single quotes, so that "
            "backslashes stay",
            "pattern",
        ) from None
    for name in groups:
        if name in COLUMNS:
            raise place.error(
                f'pattern: the group "{name}" has the name of a column of the index; give it another '
                f"one, such as (?P<part_{name}>...)",
                "pattern",
            )
    return groups


def _require_order(order: str, groups: tuple[str, ...], place: Place) -> None:
    """Refuse an order that is nothing, or two things at once."""
    if order in ORDERS and order in groups:
        raise place.error(
            f'order = "{order}" is the group "{order}" of the pattern and an order of its own; give '
            f"the group another name, such as (?P<part_{order}>...)",
            "order",
        )
    if order not in ORDERS and order not in groups:
        known = [*ORDERS, *groups]
        hint = did_you_mean(order, known)
        raise place.error(
            f'order = "{order}" is not one of {", ".join(known)} (the last are groups of the pattern)'
            f".{hint}"
            if groups
            else f'order = "{order}" is not one of {", ".join(known)}; an order by a part of the name '
            f"needs a pattern with that group.{hint}",
            "order",
        )


def _once(items: Any, name: str, place: Place) -> None:
    """Refuse an empty list that was written out, and a name that occurs twice."""
    if name == "key" and isinstance(items, list) and not items:
        raise place.error("key is empty: name groups of the pattern, or leave it out", name)
    for i, item in enumerate(items):
        if not item:
            raise place.error(f"{name} holds an empty text", name)
        if item in items[:i]:
            raise place.error(f'{name} names "{item}" twice', name)


# ---- what ``[input]`` of a recipe tells the readers --------------------------------------------

_COLUMNS = ("x", "z", "feed", "time")


def reading_options(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options of a reader for the keys of ``[input]``.

    Examples
    --------
    >>> reading_options({"files": ["a.csv"], "x": {"column": "X", "unit": "mm"}, "z": "z_um"})
    {'x': ('X', 'mm'), 'z': 'z_um'}
    """
    options = {k: v for k, v in given.items() if k != "files"}
    for key in _COLUMNS:
        value = options.get(key)
        if isinstance(value, Mapping):
            if "scale" in value:
                options["scale"] = value["scale"]
            options[key] = (value["column"], value["unit"]) if "unit" in value else value["column"]
    return options


_TABLE_FILE = re.compile(r"table\s+(\S.*)")


def file_of_curve(value: Any) -> str | None:
    """Return the file that holds the curve of a term: of ``table slide.csv``; None of other values."""
    found = _TABLE_FILE.fullmatch(value.strip()) if isinstance(value, str) else None
    return None if found is None else found.group(1)


def named_in(step: Mapping[str, Any], fields: Mapping[str, Field]) -> list[tuple[str, str]]:
    """Return key and name of each file that a step names, in a key of its own or in a table."""
    found = []
    for key, known in fields.items():
        if key not in step:
            continue
        if known.kind == "file":
            found.append((key, str(step[key])))
        elif known.kind == "table" and isinstance(step[key], Mapping):
            curves = (file_of_curve(v) for v in step[key].values())
            found += [(key, f) for f in curves if f is not None]
    return found


# ---- the keys of ``[input]`` for each method that has a name -----------------------------------

CURVES = {
    "files": Field("texts"),
    "readings": Field("texts", required=True),
    "x": Field("text"),
    "angle": Field("text"),
    "repeat": Field("text"),
    "scale": Field("text"),
    **LAYOUT,
}
MAPS = {
    "files": Field("texts"),
    "channel": Field("text"),
    "unit": Field("text"),
    "lateral_step": Field("steps"),
    "row_order": Field("text", choices=ROW_ORDERS),
}
TABLE = {"files": Field("texts"), **LAYOUT}


def input_fields(method: type[Method]) -> Mapping[str, Field]:
    """Return the keys of ``[input]`` for a method."""
    if method.reads == "maps":
        return MAPS
    if method.reads == "results":
        return {"files": Field("texts")}
    if method.reads == "nothing":
        return {}
    roles = {
        name: Field("texts" if "*" in kind else "text", required="?" not in kind)
        for name, kind in method.roles.items()
    }
    if method.reads == "curves":
        other = {"x": "angle", "angle": "x"}.get(method.over)
        return {k: f for k, f in {**CURVES, **roles}.items() if k != other}
    if method.reads == "files" and not roles:
        return {"files": Field("texts")}
    return {**TABLE, **roles}


# ---- values of the keys of a step as a person writes them: with unit, four digits, from SI -----
# The kind of a key (`metrosep.recipe.schema.Field`) tells its dimension, so that what is stored in SI
# is printed as ``20 mm``, ``0.1 deg`` or ``4800 mm/min``, and an example of a key bears its unit.

DIMENSIONS: Mapping[str, str] = {
    name: kind.dimension for name, kind in KINDS.items() if kind.dimension is not None
}
"""What the kinds of keys measure; kinds without a dimension are left out."""


def shown(value: Any, field: Field, *, unit: str = "") -> str:
    """Return the value of a key as a person reads it.

    Examples
    --------
    >>> shown([0.02], Field("lengths")), shown(0.0349, Field("angle")), shown(True, Field("flag"))
    ('20 mm', '2 deg', 'yes')
    """
    if value is None:
        return "–"
    if isinstance(value, Mapping):
        return ", ".join(f"{k} {shown(v, field, unit=unit)}" for k, v in value.items())
    if isinstance(value, list | tuple):
        inner = [shown(v, field, unit=unit) for v in value]
        nested = any(isinstance(v, list | tuple) for v in value)
        return ", ".join(f"({i})" if nested else i for i in inner)
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int | float) and not (field.kind == "waves" and isinstance(value, int)):
        dimension = {"m": "length", "rad": "angle"}.get(unit) or DIMENSIONS.get(field.kind)
        if dimension == "length" and value == 0.0 and field.kind != "uncertainty":
            return "0 mm"
        if dimension is not None:
            return typed_number(float(value), dimension)
        return str(value) if isinstance(value, int) else digits_of(value)
    return str(value)


def placeholder(key: str, field: Field) -> str:
    """Return what stands for the value of a key in an advice: dots, and the unit that it takes.

    Examples
    --------
    >>> placeholder("u_reading", Field("uncertainty")), placeholder("angles", Field("angles"))
    ('... nm', '... deg, ... deg')
    """
    units = {"length": "mm", "angle": "deg", "time": "s", "speed": "mm/min", "frequency": "Hz"}
    small = {"length": "nm", "angle": "urad"}
    dimension = DIMENSIONS.get(field.kind)
    if field.kind == "uncertainty" or (key.startswith(("u_", "zero", "sd"))):
        unit = small.get(str(dimension), units.get(str(dimension), ""))
    else:
        unit = units.get(str(dimension), "")
    if dimension in SURROUNDINGS:
        unit = TYPICAL[dimension].split()[-1]
    one = f"... {unit}".strip()
    if field.kind == "flag":
        return "true"
    return (
        f"{one}, {one}"
        if KINDS[field.kind].is_list and field.kind != "waves" and dimension is not None
        else one
    )
