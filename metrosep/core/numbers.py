"""The one check of what a caller gives for a number, a choice or a truth value.

Truth values, None, complex numbers, arrays, dates and texts without a unit are refused in one way:
`OptionError`, which is a `DataError` and a TypeError, with the name of the argument and what was
given. What is a number but cannot be used (NaN, infinite, zero, negative) is an `OptionRangeError`.
Where `dimension` is named, a text with a unit of it is a number, too: ``"0.5 mm"``.
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Iterable
from typing import Any

import numpy as np

from metrosep.core.errors import OptionError, OptionRangeError, UnitError
from metrosep.core.units import parse_quantity

_UNITS = {
    "length": "m", "angle": "rad", "time": "s", "frequency": "Hz", "speed": "m/s", "voltage": "V",
    "acceleration": "m/s2", "torque": "N m", "number": "1", "temperature": "K", "temperature difference": "K",
    "pressure": "Pa", "share": "1", "coefficient of expansion": "1/K",
}  # fmt: skip
_PINT = {
    "number": "", "share": "", "acceleration": "m/s**2", "torque": "newton * m",
    "temperature difference": "delta_degC",
}  # fmt: skip
"""SI units as pint writes them, where that is another way."""
_LONGEST = 80
"""Characters of a value in a message."""


LEAST = 1e-60
"""m: heights below it are nothing, as what a form leaves of zeros (1e-120)."""
_ROUNDING = 32.0 * np.finfo(np.float64).eps
"""Of a size: what a sum or two of floats of that size lose, which would be read as digits."""


def without_rounding(value: float, size: float) -> float:
    """Return a value, 0 where it is no more than the rounding of floats of a size.

    Examples
    --------
    >>> without_rounding(0.3 - 0.1 * 3, 0.3), without_rounding(1e-9, 0.3)
    (0.0, 1e-09)
    """
    return 0.0 if abs(value) <= _ROUNDING * size else value


def unit_of(dimension: str | None) -> str:
    """Return the SI unit of a dimension that has a name; nothing for a plain number."""
    return _UNITS.get(dimension or "", "").removeprefix("1")


def is_real(value: object) -> bool:
    """Return whether a value is one real number: no truth value, text, date, complex number or array.

    An array without dimensions is the number that it holds.
    """
    if isinstance(value, bool | np.bool_ | str | bytes | complex | np.complexfloating):
        return False
    if isinstance(value, np.ndarray):
        return value.ndim == 0 and value.dtype.kind in "iuf" and not np.ma.is_masked(value)
    if isinstance(value, np.generic):
        return value.dtype.kind in "iuf"
    # fractions, decimals and quantities of other packages say themselves what they are as a number
    return hasattr(value, "__float__") or hasattr(value, "__index__")


def real(
    value: Any,
    name: str,
    *,
    dimension: str | None = None,
    what: str = "a number",
    finite: bool = True,
) -> float:
    """Return one real number in SI; NaN and infinities only where `finite` is False."""
    if isinstance(value, str) and dimension is not None:
        return parse_quantity(value, dimension=dimension, name=name)
    if not isinstance(value, int | float):
        value = _with_unit(value, name, dimension)
    if not is_real(value):
        raise OptionError(f"{name} must be {what}{_in(dimension)}, got {_shown(value)}")
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        raise OptionError(f"{name} must be {what}{_in(dimension)}, got {value!r}") from None
    if finite and not math.isfinite(number):
        unit = f" in {_UNITS[dimension]}" if dimension else ""
        plain = what.replace("a number", "a finite number")
        raise OptionRangeError(f"{name} must be {plain}{unit}, got {number}")
    return number


def _with_unit(value: Any, name: str, dimension: str | None) -> Any:
    """Return what holds a number with its unit (a `Quantity`, or one of pint) as a number in SI."""
    own = getattr(value, "unit", None)
    if dimension is not None and isinstance(own, str) and own != _UNITS.get(dimension, own):
        raise UnitError(
            f"{name} must be a number{_in(dimension)}, got a quantity in {own}: {value}"
        )
    if not hasattr(value, "m_as"):
        return value
    try:
        return value.m_as("" if dimension is None else _PINT.get(dimension, _UNITS[dimension]))
    except Exception as exc:  # of a package that is not imported here
        raise UnitError(f"{name} must be a number{_in(dimension)}, got {value} ({exc})") from None


def _shown(value: Any) -> str:
    """Return what was given in one line of a message."""
    text = " ".join(repr(value).split())
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]} ..."


def quantity(value: Any, name: str, dimension: str) -> float:
    """Return a finite number in SI, of a number in SI or of a text with a unit of the dimension."""
    return real(value, name, dimension=dimension)


def positive(value: Any, name: str, *, dimension: str | None = None, why: str = "") -> float:
    """Return a finite number above zero; `why` ends the message of one that is not."""
    number = real(value, name, dimension=dimension, finite=False)
    if not (math.isfinite(number) and number > 0.0):
        raise _outside(name, "positive and finite", number, dimension, why)
    return number


def not_negative(value: Any, name: str, *, dimension: str | None = None, why: str = "") -> float:
    """Return a finite number from zero on, such as a standard uncertainty."""
    number = real(value, name, dimension=dimension, finite=False)
    if not (math.isfinite(number) and number >= 0.0):
        raise _outside(name, "zero or more and finite", number, dimension, why)
    return number


def between(
    value: Any, name: str, low: float, high: float, *, dimension: str | None = None, why: str = ""
) -> float:
    """Return a number from `low` to `high`, both included."""
    number = real(value, name, dimension=dimension, finite=False)
    if not low <= number <= high:
        raise _outside(name, f"between {low:g} and {high:g}", number, dimension, why)
    return number


def count(value: Any, name: str, *, least: int = 1, most: int | None = None) -> int:
    """Return a whole number from `least` to `most`; a float is none, also where it looks whole."""
    upper = "" if most is None else f" to {most}"
    message = f"{name} must be a whole number from {least}{upper}, got {value!r}"
    if isinstance(value, bool | np.bool_):
        raise OptionError(message)
    try:
        number = operator.index(value)
    except TypeError:
        raise OptionError(message) from None
    if number < least or (most is not None and number > most):
        raise OptionRangeError(message)
    return number


def flag(value: Any, name: str) -> bool:
    """Return a truth value; numbers and texts are none."""
    if not isinstance(value, bool | np.bool_):
        raise OptionError(f"{name} is True or False, got {value!r}")
    return bool(value)


def choice(value: Any, name: str, known: Iterable[str]) -> str:
    """Return one of the known texts."""
    texts = tuple(known)
    if not isinstance(value, str) or value not in texts:
        raise OptionError(f"{name} is one of {', '.join(texts)}, got {value!r}")
    return value


def _outside(
    name: str, range_: str, number: float, dimension: str | None, why: str
) -> OptionRangeError:
    """Return the error of a number out of its range."""
    unit = f" {_UNITS[dimension]}" if dimension in _UNITS else ""
    return OptionRangeError(f"{name} must be {range_}, got {number}{unit}{why and f'; {why}'}")


def _in(dimension: str | None) -> str:
    """Return what a message says about the unit of an argument."""
    return "" if dimension is None else f" in {_UNITS[dimension]}, or a text with its unit"


_NEXT_STEP = re.compile(r"(?<=[a-zA-Z\u00b5\u03bc])\s*[,;]\s*|\s+x\s+|\s*\u00d7\s*")
"""Between two steps: "2 um, 3 um", "2 um x 3 um"; a decimal comma stands behind a digit."""


def steps_of(value: Any) -> list[Any]:
    """Return one lateral step, or dx and dy, as they were typed.

    Examples
    --------
    >>> steps_of("2 um x 3 um"), steps_of("3 um"), steps_of((1e-6, "2 um"))
    (['2 um', '3 um'], ['3 um'], [1e-06, '2 um'])
    """
    if isinstance(value, str):
        return _NEXT_STEP.split(value.strip())
    return list(value) if isinstance(value, list | tuple) else [value]
