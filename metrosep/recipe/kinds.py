"""Kinds of values in recipes: each checks what TOML holds and returns it in SI."""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable
from typing import Any

from metrosep.core.units import parse_quantity
from metrosep.recipe.limits import FROM_FIT, Limit, parse_limit

__all__ = ["KINDS"]


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
    return value if value in ("auto", "fit") else _quantity("time")(value)


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


def _limit(value: Any) -> Limit:
    """Return a limit of any dimension: a length or an angle with its unit, or a plain number."""
    return parse_limit(value if isinstance(value, str) else _number(value))


def _expanded(value: Any) -> Limit | str:
    """Return an expanded uncertainty, or the word that asks for that of the fit."""
    return FROM_FIT if value == FROM_FIT else _limit(value)


def _list_of(check: Callable[[Any], float], example: str) -> Callable[[Any], tuple[float, ...]]:
    def checked(value: Any) -> tuple[float, ...]:
        if not isinstance(value, list) or not value:
            raise TypeError(f"a list is needed here, such as {example}")
        return tuple(check(item) for item in value)

    return checked


def _windows(value: Any) -> tuple[tuple[float, float], ...]:
    example = '[["0 min", "60 min"], ["180 min", "240 min"]]'
    if not isinstance(value, list) or not value:
        raise TypeError(f"a list of windows of time is needed here, such as {example}")
    found = []
    for item in value:
        if not isinstance(item, list) or len(item) != 2:
            raise TypeError(f"each window has a start and an end, such as {example}")
        start, stop = (_quantity("time")(t) for t in item)
        found.append((start, stop))
    return tuple(found)


def _places(value: Any) -> tuple[float, ...] | tuple[tuple[float, ...], ...]:
    """Return positions along a line, or x and y of each."""
    example = '[["0 mm", "0 mm"], ["10 mm", "0 mm"]], or ["0 mm", "10 mm"] along a line'
    if not isinstance(value, list) or not value:
        raise TypeError(f"a list of positions is needed here: {example}")
    if not any(isinstance(item, list) for item in value):
        return tuple(_quantity("length")(item) for item in value)
    if not all(isinstance(item, list) and len(item) == 2 for item in value):
        raise TypeError(f"each position has x and y: {example}")
    return tuple(tuple(_quantity("length")(v) for v in item) for item in value)


def _pairs(value: Any) -> tuple[tuple[int, ...], ...]:
    whole = _typed(int, "a whole number")
    if not isinstance(value, list) or not all(isinstance(i, list) and len(i) == 2 for i in value):
        raise TypeError("pairs of whole numbers are needed here, such as [[0, 0], [1, 0]]")
    return tuple(tuple(whole(v) for v in item) for item in value)


def _range(value: Any) -> tuple[float, ...] | dict[str, float]:
    """Return wavelengths: a list of them, or a table with the shortest and the longest."""
    size = _bounded("length", zero=False)
    if isinstance(value, dict):
        if set(value) != {"shortest", "longest"}:
            raise TypeError('a range is written { shortest = "2 mm", longest = "20 mm" }')
        return {k: size(v) for k, v in value.items()}
    return _list_of(size, '["10 mm", "5 mm"]')(value)


def _waves(value: Any) -> int | tuple[float, ...]:
    """Return how many of the strongest wavelengths, or which."""
    if isinstance(value, int) and not isinstance(value, bool):
        return value
    return _list_of(_bounded("length", zero=False), '["10 mm"], or a number of them')(value)


def _lines(value: Any) -> str | tuple[float, ...]:
    return "auto" if value == "auto" else _list_of(_quantity("frequency"), '["50 Hz"]')(value)


KINDS: dict[str, Callable[[Any], Any]] = {
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
    "expanded": _expanded,
    "numbers": _list_of(_number, "[1.0, 2.0]"),
    "integers": _list_of(_typed(int, "a whole number"), "[8, 7]"),
    "times": _list_of(_quantity("time"), '["0 s", "30 s"]'),
    "speeds": _list_of(_quantity("speed"), '["4800 mm/min", "7200 mm/min"]'),
    "windows": _windows,
    "frequencies": _lines,
    "range": _range,
    "places": _places,
    "pairs": _pairs,
    "waves": _waves,
    "file": _typed(str, "the name of a file"),
}
