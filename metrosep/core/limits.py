"""Limits of checks: numbers in SI that know their dimension, held against the unit of a value."""

from __future__ import annotations

import re
from typing import Any

from metrosep.core.errors import UnitError
from metrosep.core.readable import digits_of, readable_unit
from metrosep.core.units import PIXEL, parse_quantity, parse_unit

STATUS_OF_VERDICT = {
    "accept": "accepted",
    "reject": "rejected",
    "inconclusive": "inconclusive",
}
"""What becomes of a unit by its verdict, as lists of units name it."""

FORM_OF_SYMBOL = {"STR": "straightness", "FLT": "flatness", "RON": "roundness"}
"""By the first letters of their symbols; every value of theirs is a length."""

RULES = ("max", "16%", "median")
"""Rules over several values of one parameter."""

COVERAGE = 0.954499736
"""Coverage probability of every expanded uncertainty that the program makes: k = 2 for a normal one."""

FROM_FIT = "from fit"
"""As U of a check: the uncertainty that the fit itself gives, asked for by name."""

_BASES: dict[str, dict[str, int]] = {
    "length": {"m": 1},
    "angle": {"rad": 1},
    "time": {"s": 1},
    "speed": {"m": 1, "s": -1},
    "acceleration": {"m": 1, "s": -2},
    "voltage": {"V": 1},
    "frequency": {"s": -1},
    "number": {},
}
_PRODUCT = re.compile(r"([^\s^/\d*-]+?)\^?([+-]?\d+)?")
_AMOUNT = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(\S.*?)\s*")
_WORDS = {"": "a pure number", "m": "a length", "rad": "an angle", "s": "a time", PIXEL: "in px"}
_EXAMPLES = {PIXEL: "120 px", "m": "120 nm", "rad": "0.5 urad", "s": "2 ms"}


class Limit(float):
    """A number in SI with its dimension; everywhere else it is a float.

    Examples
    --------
    >>> parse_limit("120 nm").dimension, parse_limit(0.3).dimension, parse_limit("2 1/mm^2") * 1.0
    ('m', '', 2000000.0)
    """

    __slots__ = ("dimension",)

    dimension: str  # powers of SI units, such as ``m``, ``rad``, ``m^-2``; empty for a pure number

    def __new__(cls, value: float, dimension: str = "") -> Limit:
        """Return the number with its dimension."""
        made = super().__new__(cls, value)
        made.dimension = dimension
        return made

    @property
    def text(self) -> str:
        """For a message: with a readable unit, where it is a length, an angle or a time."""
        name, factor = readable_unit([self], self.dimension)
        return f"{digits_of(self / factor, 6)} {name}".rstrip()

    def __repr__(self) -> str:
        """Return it as any float is written: documents and hashes do not see the dimension."""
        return float.__repr__(self)


def _factors(unit: str) -> tuple[float, str]:
    """Return the factor to SI and the dimension of a unit such as ``mm^2`` or ``nm/s``."""
    powers: dict[str, int] = {}
    factor = 1.0
    for k, side in enumerate(unit.split("/")):
        name = side.strip()
        if name == "1" and k == 0:
            continue
        match = _PRODUCT.fullmatch(name)
        if match is None or k > 1:
            raise UnitError(f"unknown unit {unit!r}; write it such as nm, urad, mm^2, 1/mm, nm/s")
        if name == PIXEL:
            powers[PIXEL] = powers.get(PIXEL, 0) + (-1 if k else 1)
            continue
        known = parse_unit(match[1])
        power = int(match[2] or 1) * (-1 if k else 1)
        if known.dimension not in _BASES:
            raise UnitError(f"unit {unit!r} is not one that a limit can have")
        factor *= known.factor**power
        for base, n in _BASES[known.dimension].items():
            powers[base] = powers.get(base, 0) + n * power
    shown = [b if n == 1 else f"{b}^{n}" for b, n in sorted(powers.items()) if n]
    return factor, " ".join(shown)


def dimension_of(unit: str) -> str | None:
    """Return the dimension of a unit.

    Examples
    --------
    >>> dimension_of("m^3/m^2"), dimension_of("1/m^2"), dimension_of("1"), dimension_of("thing")
    ('m', 'm^-2', '', None)
    """
    try:
        return _factors(unit)[1]
    except UnitError:
        return None


def parse_limit(value: Any) -> Limit:
    """Return a limit from what a recipe holds."""
    if not isinstance(value, str):
        return Limit(float(value))
    match = _AMOUNT.fullmatch(value)
    if match is not None and match[2] == "%":
        return Limit(float(match[1]) / 100.0)
    dimension = None if match is None else dimension_of(match[2])
    if match is None or not dimension:
        raise UnitError(
            f"{value!r} is not a limit: a length or an angle with its unit is needed here, such as "
            '"120 nm" or "0.5 urad"; a pure number is written without quotes, a share as "1 %"'
        )
    simple = {"m": "length", "rad": "angle"}.get(dimension)
    if simple is not None and "/" not in match[2] and "^" not in match[2]:
        return Limit(parse_quantity(value, dimension=simple), dimension)
    number = float(match[1]) * _factors(match[2])[0]
    if not abs(number) < float("inf"):
        raise UnitError(f"{value!r} is not finite")
    return Limit(number, dimension)


def limit_problem(name: str, limit: float, of: str, unit: str) -> str | None:
    """Return why a limit does not belong to a value, or None where it does.

    Examples
    --------
    >>> limit_problem("upper", parse_limit("10 urad"), "Sa", "m")
    'upper is an angle, but Sa is a length; write it with its unit, such as upper = "120 nm"'
    >>> limit_problem("upper", parse_limit("10 nm"), "Sa", "m") is None
    True
    """
    given = limit.dimension if isinstance(limit, Limit) else ""
    needed = dimension_of(unit) or ""
    if given == needed or (limit == 0.0 and not given):
        return None
    if not needed:
        right = f"write it without a unit, such as {name} = 0.5"
        if dimension_of(unit) is None:
            right = f"its unit is {unit!r}, so write the number without one"
    else:
        right = f'write it with its unit, such as {name} = "{limit_example(unit)}"'
    return f"{name} is {_word(given)}, but {of} is {_word(needed, unit)}; {right}"


def limit_example(unit: str) -> str | None:
    """Return how a limit of a value of this SI unit is written; None of a pure number.

    Examples
    --------
    >>> limit_example("m"), limit_example("1")
    ('120 nm', None)
    """
    needed = dimension_of(unit)
    return _EXAMPLES.get(needed, f"2 {unit}") if needed else None


def order_problem(lower: float | None, upper: float | None) -> str | None:
    """Return why two limits cannot be put in order, or None where they can.

    Examples
    --------
    >>> order_problem(parse_limit(1), parse_limit("3 nm"))
    'lower is a pure number, but upper is a length; both limits of a check are of one kind'
    """
    known = [v for v in (lower, upper) if v is not None]
    kinds = [v.dimension if isinstance(v, Limit) else "" for v in known]
    if len(set(kinds)) < 2 or any(v == 0.0 and not k for v, k in zip(known, kinds, strict=True)):
        return None
    low, high = (_word(k, k) for k in kinds)
    return f"lower is {low}, but upper is {high}; both limits of a check are of one kind"


def _word(dimension: str, unit: str | None = None) -> str:
    return _WORDS.get(dimension) or f"in {unit or dimension}"
