"""One declaration of what a caller may state, and the kinds of values that there are.

An option stands once, as the field of the dataclass that holds it: ``u: float = option(0.0,
kind="angle", help="...")``. The schema of recipes, ``metrosep ops``, the command line, the forms of
the workbench and the error for a wrong value are made from it. A kind stands once, in `KINDS`: what
is taken, how it is written in a recipe and after ``--set``, and what it measures.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, dataclass, field as new_field
from typing import Any, Literal

from metrosep.core.errors import InvalidSamplesError, OptionError, UnitError
from metrosep.core.limits import FROM_FIT, Limit, parse_limit
from metrosep.core.numbers import steps_of
from metrosep.core.readable import did_you_mean, said_value
from metrosep.core.units import TYPICAL, Pixels, parse_lateral, parse_quantity, unit_dimension

Written = Literal["text", "plain", "list", "plain list", "pairs", "plain pairs"]
"""How TOML writes what is typed: in quotes, as it stands, with brackets, with brackets in brackets."""


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of values."""

    words: str  # what a value looks like
    # ``check(value, name, bare)``: the value in SI; `bare`: whether a number in SI will do where a
    # quantity is needed, as in Python, or its text with the unit only, as in a recipe
    check: Callable[[Any, str, bool], Any]
    dimension: str | None = None  # what it measures, if it is a quantity or a list of them
    example: str = "..."  # as it is typed after ``--set``
    written: Written = "text"

    @property
    def is_list(self) -> bool:
        """Whether a value is a list."""
        return self.written not in ("text", "plain")


@dataclass(frozen=True, slots=True)
class Option:
    """One option: key of a recipe, argument of ``--set``, line of a form."""

    kind: str  # one of `KINDS`
    required: bool = False  # whether it must be there
    choices: tuple[str | int, ...] = ()  # allowed values; any if empty
    help: str = ""  # one sentence: what it does
    default: Any = None  # what counts where it is left out; None where nothing does
    # mapping of str to Option: keys of a table
    inner: Mapping[str, Option] = new_field(default_factory=dict)
    low: float | None = None  # least value in SI
    high: float | None = None  # greatest
    of: tuple[str, ...] = ()  # methods of a step that know it; empty for all

    @property
    def about(self) -> str:
        """What it does, and for which methods of its step."""
        return f"{' and '.join(self.of)} only: {self.help}" if self.of else self.help


def option(
    default: Any = MISSING,
    *,
    kind: str,
    help: str,  # noqa: A002
    choices: tuple[str | int, ...] = (),
    required: bool | None = None,
    typed: Any = None,
    inner: Mapping[str, Option] | None = None,
    low: float | None = None,
    high: float | None = None,
    of: tuple[str, ...] = (),
) -> Any:
    """Return the field of a dataclass that is an option; `typed` is its default as a person writes it."""
    declared = Option(
        kind,
        default is MISSING if required is None else required,
        choices,
        help,
        typed if typed is not None or default is MISSING or default == () else default,
        inner or {},
        low,
        high,
        of,
    )
    return new_field(default=default, metadata={"option": declared})


def options_of(cls: type) -> dict[str, Option]:
    """Return the options of a dataclass, in the order of its fields.

    Examples
    --------
    >>> @dataclass
    ... class Turn:
    ...     u: float = option(0.0, kind="angle", help="standard uncertainty of the turn")
    >>> options_of(Turn)["u"].kind
    'angle'
    """
    if not dataclasses.is_dataclass(cls):
        return {}
    return {
        f.name: f.metadata["option"] for f in dataclasses.fields(cls) if "option" in f.metadata
    }


def checked(declared: Option, value: Any, name: str, *, bare: bool = True) -> Any:
    """Return the value of an option in SI, or refuse it.

    Examples
    --------
    >>> checked(Option("size"), "0.5 mm", "radius"), checked(Option("size"), 5e-4, "radius")
    (0.0005, 0.0005)
    """
    known = declared.choices
    if known and (
        isinstance(value, bool) or not isinstance(value, str | int) or value not in known
    ):
        raise OptionError(not_one_of(name, value, known))
    try:
        found = KINDS[declared.kind].check(value, name, bare)
    except (OptionError, UnitError) as exc:
        if name == "value" or str(exc).startswith(name):
            raise
        raise type(exc)(f"{name} = {said_value(value)}: {exc}") from None
    low, high = declared.low, declared.high
    if (low is not None and found < low) or (high is not None and found > high):
        ends = [f"from {low:g}"] if low is not None else []
        ends += [f"{'at most' if low is None else 'to'} {high:g}"] if high is not None else []
        raise InvalidSamplesError(f"{name} must be {' '.join(ends)}, got {value!r}")
    return found


def not_one_of(name: str, value: Any, known: Iterable[Any]) -> str:
    """Return why a value will not do, with the nearest one that would."""
    if isinstance(value, int) and value.bit_length() > _BITS:
        value = "a number beyond all measure"
    texts = [str(c) for c in known]
    return f"{name} = {said_value(value)} is not one of {', '.join(texts)}.{did_you_mean(value, texts)}"


_BITS = 64
"""Larger whole numbers are not printed."""


# ---- the kinds ---------------------------------------------------------------------------------

Check = Callable[[Any, str, bool], Any]


def _typed(kind: type, what: str) -> Check:
    """Return the check of what is of one type as it stands."""

    def check(value: Any, name: str, bare: bool) -> Any:
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            if bare and kind is not dict:
                raise OptionError(f"{name} must be {what}, got {value!r}")
            raise OptionError(f"{what} is needed here")
        return value

    return check


def _quantity(dimension: str, rule: str = "quantity") -> Check:
    """Return the check of a quantity; `rule` is a function of `metrosep.core.numbers`."""

    def check(value: Any, name: str, bare: bool) -> float:
        from metrosep.core import numbers

        if not bare and not isinstance(value, str):
            raise OptionError(
                f"{'an' if dimension == 'angle' else 'a'} {dimension} is written with its unit in "
                f'quotes, such as "{TYPICAL[dimension]}"'
            )
        if isinstance(value, str):
            value = parse_quantity(value, dimension=dimension, name=name)
        owner = "it" if name == "value" else name
        found: float = getattr(numbers, rule)(value, owner, dimension=dimension)
        return found

    return check


def _lateral(rule: str = "quantity") -> Check:
    """Return the check of a place or size on a map: a length, or pixels."""
    length = _quantity("length", rule)

    def check(value: Any, name: str, bare: bool) -> float:
        from metrosep.core import numbers

        found = parse_lateral(value, name=name) if isinstance(value, str) else value
        if not isinstance(found, Pixels):
            return float(length(value, name, bare))
        if rule == "positive":
            numbers.positive(found, "it" if name == "value" else name)
        return found

    return check


def _number(value: Any, name: str, bare: bool) -> float:
    from metrosep.core import numbers

    if not numbers.is_real(value):
        _typed(float, "a number")(value, name, bare)
    try:
        return numbers.real(value, name)
    except InvalidSamplesError:
        raise OptionError("a finite number is needed here") from None


def _integer(value: Any, name: str, bare: bool) -> int:
    import operator

    try:
        return operator.index(_typed(object, "a whole number")(value, name, bare))
    except TypeError:
        return int(_typed(int, "a whole number")(value, name, bare))


def _items(value: Any, bare: bool) -> list[Any] | None:
    """Return the items of a list; in Python of any sequence, too; None where it is none."""
    if isinstance(value, list):
        return value
    if bare and not isinstance(value, str | bytes | Mapping) and hasattr(value, "__len__"):
        return list(value)
    return None


def _list_of(one: Check, example: str) -> Check:
    def check(value: Any, name: str, bare: bool) -> tuple[Any, ...]:
        items = [value] if bare and isinstance(value, str) else _items(value, bare)
        if not items:
            raise OptionError(f"a list is needed here, such as {example}")
        return tuple(one(item, name, bare) for item in items)

    return check


def _texts(value: Any, name: str, bare: bool) -> list[str]:
    items = [value] if isinstance(value, str) else _items(value, bare)
    if items is None or not all(isinstance(i, str) for i in items):
        raise OptionError("a text or a list of texts is needed here")
    return items


def _column(value: Any, name: str, bare: bool) -> Any:
    if isinstance(value, str):
        return value
    known = {"column", "unit", "scale"}
    if isinstance(value, dict) and set(value) <= known and "column" in value:
        if all(isinstance(v, str) for v in value.values()):
            return value
        raise OptionError("column, unit and scale are texts, in quotes")
    if isinstance(value, dict):
        for key in (k for k in value if k not in known):
            hint = did_you_mean(key, sorted(known))
            raise OptionError(f'unknown key "{key}"; known: column, unit, scale.{hint}')
    raise OptionError(
        f'a column is given by its name, or as {{ column = "X", unit = "mm" }}; got {value!r}'
    )


def _lag(value: Any, name: str, bare: bool) -> Any:
    return value if value in ("auto", "fit") else _quantity("time")(value, name, bare)


def _degree(value: Any, name: str, bare: bool) -> Any:
    if value in ("aicc", "f-test", "auto"):
        return "aicc" if value == "auto" else value
    if isinstance(value, bool) or not isinstance(value, int):
        raise OptionError('a whole number, "auto", "aicc" or "f-test" is needed here')
    return value


def _spacing(value: Any, name: str, bare: bool) -> Any:
    if isinstance(value, int) and not isinstance(value, bool):
        if value < 2:
            raise OptionError("a table needs at least 2 points")
        return value
    if isinstance(value, str):
        angle = unit_dimension(value) == "angle"
        _quantity("angle" if angle else "length", "positive")(value, name, bare)
        return value
    raise OptionError('a spacing such as "1 mm" or a number of points is needed here')


def _position(value: Any, name: str, bare: bool) -> Limit:
    """Return a position of an axis that moves along or turns, which knows what it is."""
    angle = isinstance(value, str) and unit_dimension(value) == "angle"
    number = _quantity("angle" if angle else "length")(value, name, bare)
    return Limit(number, "rad" if angle else "m")


def _limit(value: Any, name: str, bare: bool) -> Limit:
    """Return a limit of any dimension: a length or an angle with its unit, or a plain number."""
    return parse_limit(value if isinstance(value, str) else _number(value, name, bare))


def _expanded(value: Any, name: str, bare: bool) -> Limit | str:
    """Return an expanded uncertainty, or the word that asks for that of the fit."""
    return FROM_FIT if value == FROM_FIT else _limit(value, name, bare)


def _windows(value: Any, name: str, bare: bool) -> tuple[tuple[float, ...], ...]:
    example = '[["0 min", "60 min"], ["180 min", "240 min"]]'
    items = _items(value, bare)
    if not items:
        raise OptionError(f"a list of windows of time is needed here, such as {example}")
    pairs = [_items(item, bare) for item in items]
    if any(pair is None or len(pair) != 2 for pair in pairs):
        raise OptionError(f"each window has a start and an end, such as {example}")
    time = _quantity("time")
    return tuple(tuple(time(t, name, bare) for t in pair or ()) for pair in pairs)


def _places(one: Check) -> Check:
    """Return the check of positions along a line, or of x and y of each."""

    def check(value: Any, name: str, bare: bool) -> tuple[Any, ...]:
        example = '[["0 mm", "0 mm"], ["10 mm", "0 mm"]], or ["0 mm", "10 mm"] along a line'
        items = _items(value, bare)
        if not items:
            raise OptionError(f"a list of positions is needed here: {example}")
        pairs = [_items(_parts(item), bare) for item in items]
        if not any(pair is not None for pair in pairs):
            return tuple(one(item, name, bare) for item in items)
        if any(pair is None or len(pair) != 2 for pair in pairs):
            raise OptionError(f"each position has x and y: {example}")
        return tuple(tuple(one(v, name, bare) for v in pair or ()) for pair in pairs)

    return check


def _parts(value: Any) -> Any:
    """Return x and y of a text that holds both; anything else as it is."""
    is_both = isinstance(value, str) and "," in value
    return [part.strip() for part in value.split(",")] if is_both else value


def _steps(value: Any, name: str, bare: bool) -> Any:
    """Return one lateral step, or dx and dy."""
    items, size = steps_of(value), _quantity("length", "positive")
    if len(items) > 2:
        raise OptionError('one step or two are needed here, "3 um" or "2 um, 3 um" (dx, dy)')
    found = tuple(size(item, name, bare) for item in items)
    return found if len(found) == 2 else found[0]


def _point(value: Any, name: str, bare: bool) -> tuple[float, float]:
    """Return x and y of a point."""
    pair, length = _items(_parts(value), bare), _lateral()
    if pair is None or len(pair) != 2:
        raise OptionError('a point has x and y, "1.2 mm, 0.3 mm" or "120 px, 30 px"')
    return length(pair[0], name, bare), length(pair[1], name, bare)


def _pairs(value: Any, name: str, bare: bool) -> tuple[tuple[int, ...], ...]:
    items = _items(value, bare)
    pairs = [None] if items is None else [_items(item, bare) for item in items]
    if any(pair is None or len(pair) != 2 for pair in pairs):
        raise OptionError("pairs of whole numbers are needed here, such as [[0, 0], [1, 0]]")
    return tuple(tuple(_integer(v, name, bare) for v in pair or ()) for pair in pairs)


def _range(value: Any, name: str, bare: bool) -> tuple[float, ...] | dict[str, float]:
    """Return wavelengths: a list of them, or a table with the shortest and the longest."""
    size = _quantity("length", "positive")
    if isinstance(value, dict):
        if set(value) != {"shortest", "longest"}:
            raise OptionError('a range is written { shortest = "2 mm", longest = "20 mm" }')
        return {k: size(v, name, bare) for k, v in value.items()}
    found: tuple[float, ...] = _list_of(size, '["10 mm", "5 mm"]')(value, name, bare)
    return found


def _waves(value: Any, name: str, bare: bool) -> Any:
    """Return how many of the strongest wavelengths, or which."""
    if isinstance(value, int) and not isinstance(value, bool):
        return value
    size = _quantity("length", "positive")
    return _list_of(size, '["10 mm"], or a number of them')(value, name, bare)


def _lines(value: Any, name: str, bare: bool) -> Any:
    if isinstance(value, str) and value == "auto":
        return value
    if isinstance(value, str):
        raise OptionError(
            f'"auto", or a list of frequencies such as ["50 Hz"], is needed here, got {value!r}'
        )
    return _list_of(_quantity("frequency"), '["50 Hz"]')(value, name, bare)


def _date(value: Any, name: str, bare: bool) -> str:
    """Return a date of TOML, or a text, as ISO 8601; an empty one stays empty."""
    import datetime as dt

    if isinstance(value, dt.date):  # a datetime is one, too
        return value.isoformat()
    text = value.strip() if isinstance(value, str) else None
    if text == "":
        return ""
    try:
        if text is not None and "T" in text:
            return dt.datetime.fromisoformat(text).isoformat()
        return dt.date.fromisoformat(text or "?").isoformat()
    except ValueError:
        raise OptionError("a date is written as year-month-day, 2026-03-05") from None


def _dates(value: Any, name: str, bare: bool) -> str:
    """Return a date, or the first and the last one with a slash between (ISO 8601)."""
    if isinstance(value, str):
        value = value.split("/")
    given = value if isinstance(value, list | tuple) else [value]
    if len(given) > 2:
        raise OptionError(
            f"one date, or the first and the last one, is needed here, got {len(given)}"
        )
    dates = [_date(v, name, bare) for v in given]
    if dates != sorted(dates):
        raise OptionError(f"the first date {dates[0]} lies behind the last one {dates[-1]}")
    return "/".join(dict.fromkeys(dates))


def _quantities(dimension: str, example: str) -> Check:
    return _list_of(_quantity(dimension), example)


KINDS: Mapping[str, Kind] = {
    "text": Kind("a text", _typed(str, "a text")),
    "flag": Kind("true or false", _typed(bool, "true or false"), None, "true", "plain"),
    "number": Kind("a number", _number, None, "1", "plain"),
    "integer": Kind("a whole number", _integer, None, "30", "plain"),
    "length": Kind(
        'a length with its unit, "-5 mm"', _quantity("length"), "length", "1 mm"
    ),
    "size": Kind(
        'a length above zero with its unit, "25 mm"',
        _quantity("length", "positive"), "length", "25 mm",
    ),
    "steps": Kind(
        'a length above zero with its unit, "3 um", or two, "2 um, 3 um" (dx, dy)',
        _steps, "length", "3 um",
    ),
    "uncertainty": Kind(
        'a length from zero with its unit, "2 nm"',
        _quantity("length", "not_negative"), "length", "2 nm",
    ),
    "time": Kind('a time with its unit, "2 ms"', _quantity("time"), "time", "2 s"),
    "frequency": Kind(
        'a frequency with its unit, "1 kHz"', _quantity("frequency"), "frequency", "1 kHz"
    ),
    "speed": Kind(
        'a feedrate with its unit, "4800 mm/min"', _quantity("speed"), "speed", "4800 mm/min"
    ),
    "angle": Kind('an angle with its unit, "0.1 deg"', _quantity("angle"), "angle", "1 deg"),
    "temperature": Kind(
        'a temperature with its unit, "20.3 degC"', _quantity("temperature"), "temperature", "20.3 degC"
    ),
    "temperature difference": Kind(
        'a difference of temperatures with its unit, "0.1 K"',
        _quantity("temperature difference", "not_negative"), "temperature difference", "0.1 K",
    ),
    "pressure": Kind(
        'a pressure with its unit, "1013 hPa"', _quantity("pressure", "not_negative"), "pressure", "1013 hPa"
    ),
    "share": Kind(
        'a share with its unit, "45 %" or "450 ppm"', _quantity("share", "not_negative"), "share", "45 %"
    ),
    "expansion": Kind(
        'a coefficient of expansion with its unit, "11.5 ppm/K"',
        _quantity("coefficient of expansion"), "coefficient of expansion", "11.5 ppm/K",
    ),
    "column": Kind(
        'a column: its name, "name:unit", or { column = "X", unit = "mm" }', _column
    ),
    "texts": Kind("texts, first,second", _texts, written="list"),
    "any": Kind("numbers", lambda value, _name, _bare: value),
    "table": Kind("a table, A=1, B=2", _typed(dict, "a table")),
    "file": Kind("a file", _typed(str, "the name of a file")),
    "date": Kind("a date, 2026-03-05", _date, None, "2026-03-05"),
    "dates": Kind(
        "a date, or first and last one, 2026-03-04/2026-03-05", _dates, None, "2026-03-04"
    ),
    "lag": Kind('a time with its unit, "1 ms", auto or fit', _lag, "time", "2 ms"),
    "degree": Kind("a whole number, or auto", _degree, None, "2"),
    "spacing": Kind(
        'a length with its unit, "1 mm" ("5 deg" where the axis turns), or a number of points', _spacing,
        "length", "1 mm",
    ),
    "position": Kind(
        'a length with its unit, "20 mm"; an angle where the axis turns', _position, "length", "20 mm"
    ),
    "limit": Kind(
        "a length or an angle with its unit, or a plain number", _limit, None, "2 nm"
    ),
    "expanded": Kind(
        'as a limit, or "from fit" for a parameter of a fitted form', _expanded, None, "2 nm"
    ),
    "angles": Kind(
        'angles with their units, "0 deg, 45 deg"',
        _quantities("angle", '["0 deg", "45 deg"]'), "angle", "0 deg,30 deg,75 deg", "list",
    ),
    "lengths": Kind(
        'lengths with their units, "0 mm, 10 mm"',
        _quantities("length", '["0 mm", "10 mm"]'), "length", "10 mm", "list",
    ),
    "times": Kind(
        'times with their units, "0 s, 30 s"',
        _quantities("time", '["0 s", "30 s"]'), "time", "0 s,30 s", "list",
    ),
    "speeds": Kind(
        'feedrates with their units, "4800 mm/min, 7200 mm/min"',
        _quantities("speed", '["4800 mm/min", "7200 mm/min"]'), "speed", "4800 mm/min", "list",
    ),
    "frequencies": Kind(
        'auto, or frequencies with their units, "50 Hz, 100 Hz"', _lines, "frequency", "50 Hz",
        "list",
    ),
    "numbers": Kind(
        "numbers, 1,2.5", _list_of(_number, "[1.0, 2.0]"), None, "1,2", "plain list"
    ),
    "integers": Kind(
        "whole numbers, 8,7", _list_of(_integer, "[8, 7]"), None, "8,7", "plain list"
    ),
    "range": Kind('lengths with their units, "10 mm, 5 mm"', _range, "length", "10 mm,5 mm", "list"),
    "waves": Kind(
        'a number of waves, or their lengths with units, "10 mm"', _waves, "length", "3", "list"
    ),
    "windows": Kind(
        'windows of time, "0 min..60 min, 180 min..240 min"', _windows, "time",
        "0 min..60 min", "pairs",
    ),
    "places": Kind(
        'positions along a line, "0 mm, 10 mm", or in a plane, "0 mm..0 mm, 10 mm..0 mm"',
        _places(_quantity("length")), "length", "0 mm..0 mm,4 mm..0 mm,0 mm..4 mm", "pairs",
    ),
    "point": Kind(
        'a point of a map, x and y, "1.2 mm, 0.3 mm" or "120 px, 30 px"', _point, "length", "1.2 mm, 0.3 mm"
    ),
    "corners": Kind(
        'points of a map, "1.2 mm, 0.3 mm" or "120 px, 30 px"', _places(_lateral()), "length",
        "0 mm..0 mm,4 mm..0 mm,0 mm..4 mm", "pairs",
    ),
    "lateral": Kind(
        'a length with its unit, "-5 mm", or pixels of the map, "120 px"', _lateral(), "length", "1 mm"
    ),
    "extent": Kind(
        'a length above zero with its unit, "25 mm", or pixels of the map, "120 px"',
        _lateral("positive"), "length", "25 mm",
    ),
    "pairs": Kind(
        "pairs of whole numbers, 0..0,1..0", _pairs, None, "0..0,1..0", "plain pairs"
    ),
}  # fmt: skip
