"""The grammar of recipes: which keys exist, of which kind, and where a wrong one stands.

TOML, ``metrosep = 1``. Quantities are strings with units; an unknown key names its line, what is
known there and the nearest spelling.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from metrosep.core.errors import RecipeError, UnitError
from metrosep.core.units import parse_quantity

__all__ = ["Field", "Place", "checked_table"]

Kind = Literal[
    "text",
    "flag",
    "number",
    "integer",
    "length",
    "size",
    "uncertainty",
    "time",
    "frequency",
    "speed",
    "column",
    "texts",
    "any",
    "lag",
    "degree",
    "spacing",
    "table",
    "angle",
    "angles",
    "lengths",
    "numbers",
    "limit",
]


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
        """Return the line of a key of this table, or of its header, from 1.

        Parameters
        ----------
        key : str or None
            The key; the header if None or not found.

        Returns
        -------
        int or None
            Line number.
        """
        lines = _without_texts(self.text).splitlines()
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
        return RecipeError(f"{where}: {problem}", key=key, line=line)


@dataclass(frozen=True, slots=True)
class Field:
    """One key of a table.

    Parameters
    ----------
    kind : str
        Kind of value.
    required : bool
        Whether it must be there.
    choices : tuple of str
        Allowed texts; any if empty.
    """

    kind: Kind
    required: bool = False
    choices: tuple[str, ...] = ()


def checked_table(
    data: Mapping[str, Any], fields: Mapping[str, Field], place: Place, *, what: str
) -> dict[str, Any]:
    """Return a table with its values in SI, or refuse it.

    Parameters
    ----------
    data : mapping
        What TOML holds.
    fields : mapping of str to Field
        What is allowed.
    place : Place
        Where it stands.
    what : str
        Name of the table for messages, such as ``step 1 (separate)``.

    Returns
    -------
    dict
        Same keys, converted values.

    Raises
    ------
    RecipeError
        If a key is unknown, missing or of the wrong kind.
    """
    for key in data:
        if key not in fields:
            near = difflib.get_close_matches(key, list(fields), n=1)
            hint = f' Did you mean "{near[0]}"?' if near else ""
            raise place.error(
                f'unknown key "{key}" in {what}; known: {", ".join(fields)}.{hint}', key
            )
    for key, field in fields.items():
        if field.required and key not in data:
            raise place.error(f'{what} needs the key "{key}"')
    return {key: _value(value, fields[key], place, key) for key, value in data.items()}


def _value(value: Any, field: Field, place: Place, key: str) -> Any:
    if field.choices and value not in field.choices:
        near = difflib.get_close_matches(str(value), field.choices, n=1)
        hint = f' Did you mean "{near[0]}"?' if near else ""
        known = ", ".join(field.choices)
        raise place.error(f"{key} = {value!r} is not one of {known}.{hint}", key)
    try:
        return _KINDS[field.kind](value)
    except (TypeError, ValueError, UnitError) as exc:
        raise place.error(f"{key} = {value!r}: {exc}", key) from None


def _without_texts(text: str) -> str:
    """Return TOML with its texts of several lines blanked, line by line, so that no key hides there."""
    return re.sub(
        r'"""[\s\S]*?"""|\'\'\'[\s\S]*?\'\'\'',
        lambda found: '""' + "\n" * found.group().count("\n"),
        text,
    )


def _typed(kind: type | tuple[type, ...], name: str) -> Callable[[Any], Any]:
    def check(value: Any) -> Any:
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise TypeError(f"{name} is needed here")
        return value

    return check


def _quantity(dimension: str) -> Callable[[Any], float]:
    def check(value: Any) -> float:
        if not isinstance(value, str):
            raise TypeError(f'a {dimension} is written with its unit in quotes, such as "1.2 mm"')
        return parse_quantity(value, dimension=dimension)

    return check


def _number(value: Any) -> float:
    number = _typed((int, float), "a number")(value)
    if not math.isfinite(number):
        raise ValueError("a finite number is needed here")
    return float(number)


def _bounded(dimension: str, *, zero: bool) -> Callable[[Any], float]:
    def check(value: Any) -> float:
        found = _quantity(dimension)(value)
        if found < 0.0 or (found == 0.0 and not zero):
            raise ValueError(f"it must be {'zero or more' if zero else 'more than zero'}")
        return found

    return check


def _column(value: Any) -> Any:
    if isinstance(value, str):
        return value
    known = {"column", "unit", "scale"}
    if isinstance(value, dict) and set(value) <= known and "column" in value:
        if all(isinstance(v, str) for v in value.values()):
            return value
        raise TypeError("column, unit and scale are texts, in quotes")
    if isinstance(value, dict):
        for key in (k for k in value if k not in known):
            near = difflib.get_close_matches(key, sorted(known), n=1)
            hint = f' Did you mean "{near[0]}"?' if near else ""
            raise TypeError(f'unknown key "{key}"; known: column, unit, scale.{hint}')
    raise TypeError('a column is its name, or { column = "X", unit = "mm" }')


def _texts(value: Any) -> list[str]:
    items = [value] if isinstance(value, str) else value
    if not isinstance(items, list) or not all(isinstance(i, str) for i in items):
        raise TypeError("a text or a list of texts is needed here")
    return items


def _lag(value: Any) -> Any:
    return value if value == "fit" else _quantity("time")(value)


def _degree(value: Any) -> Any:
    if value in ("aicc", "f-test", "auto"):
        return "aicc" if value == "auto" else value
    if isinstance(value, bool) or not isinstance(value, int):
        raise TypeError('a whole number, "auto", "aicc" or "f-test" is needed here')
    return value


def _spacing(value: Any) -> Any:
    if isinstance(value, int) and not isinstance(value, bool):
        if value < 2:
            raise ValueError("a table needs at least 2 points")
        return value
    if isinstance(value, str):
        _bounded("length", zero=False)(value)
        return value
    raise TypeError('a spacing such as "1 mm" or a number of points is needed here')


def _limit(value: Any) -> float:
    """Return a limit of any dimension: a length or an angle with its unit, or a plain number."""
    if not isinstance(value, str):
        return _number(value)
    try:
        return parse_quantity(value, dimension="length")
    except UnitError:
        return parse_quantity(value, dimension="angle")


def _list_of(check: Callable[[Any], float], example: str) -> Callable[[Any], tuple[float, ...]]:
    def checked(value: Any) -> tuple[float, ...]:
        if not isinstance(value, list) or not value:
            raise TypeError(f"a list is needed here, such as {example}")
        return tuple(check(item) for item in value)

    return checked


_KINDS: dict[str, Callable[[Any], Any]] = {
    "text": _typed(str, "a text"),
    "flag": _typed(bool, "true or false"),
    "number": _number,
    "integer": _typed(int, "a whole number"),
    "length": _quantity("length"),
    "size": _bounded("length", zero=False),
    "uncertainty": _bounded("length", zero=True),
    "time": _quantity("time"),
    "frequency": _quantity("frequency"),
    "speed": _quantity("speed"),
    "column": _column,
    "texts": _texts,
    "any": lambda value: value,
    "lag": _lag,
    "degree": _degree,
    "spacing": _spacing,
    "table": _typed(dict, "a table"),
    "angle": _quantity("angle"),
    "angles": _list_of(_quantity("angle"), '["0 deg", "45 deg"]'),
    "lengths": _list_of(_quantity("length"), '["0 mm", "10 mm"]'),
    "limit": _limit,
    "numbers": _list_of(_number, "[1.0, 2.0]"),
}
