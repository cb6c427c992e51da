"""The one check of what a caller gives for a number: real, positive, count, choice, quantity.

Truth values, None, complex numbers, arrays, dates and texts without a unit are refused in one way:
`OptionError`, which is a `DataError` and a TypeError, with the name of the argument and what was
given. What is a number but cannot be used (NaN, infinite, zero, negative) is an `InvalidSamplesError`.
Where `dimension` is named, a text with a unit of it is a number, too: ``"0.5 mm"``.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Iterable
from typing import Any

import numpy as np

from metrosep.core.errors import InvalidSamplesError, OptionError
from metrosep.core.units import parse_quantity

__all__ = ["choice", "count", "is_real", "positive", "quantity", "real"]

_UNITS = {"length": "m", "angle": "rad", "time": "s", "frequency": "Hz", "speed": "m/s"}


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
    if not is_real(value):
        raise OptionError(f"{name} must be {what}{_in(dimension)}, got {value!r}")
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        raise OptionError(f"{name} must be {what}{_in(dimension)}, got {value!r}") from None
    if finite and not math.isfinite(number):
        unit = f" in {_UNITS[dimension]}" if dimension else ""
        plain = what.replace("a number", "a finite number")
        raise InvalidSamplesError(f"{name} must be {plain}{unit}, got {number}")
    return number


def quantity(value: Any, name: str, dimension: str) -> float:
    """Return a finite number in SI, of a number in SI or of a text with a unit of the dimension."""
    return real(value, name, dimension=dimension)


def positive(value: Any, name: str, *, dimension: str | None = None, why: str = "") -> float:
    """Return a finite number above zero; `why` ends the message of one that is not."""
    number = real(value, name, dimension=dimension, finite=False)
    if not (math.isfinite(number) and number > 0.0):
        unit = f" {_UNITS[dimension]}" if dimension in _UNITS else ""
        raise InvalidSamplesError(
            f"{name} must be positive and finite, got {number}{unit}{why and f'; {why}'}"
        )
    return number


def count(value: Any, name: str, *, least: int = 1) -> int:
    """Return a whole number from `least` on; a float is none, also where it looks whole."""
    message = f"{name} must be a whole number from {least}, got {value!r}"
    if isinstance(value, bool | np.bool_):
        raise OptionError(message)
    try:
        number = operator.index(value)
    except TypeError:
        raise OptionError(message) from None
    if number < least:
        raise InvalidSamplesError(message)
    return number


def choice(value: Any, name: str, known: Iterable[str]) -> str:
    """Return one of the known texts."""
    texts = tuple(known)
    if not isinstance(value, str) or value not in texts:
        raise OptionError(f"{name} is one of {', '.join(texts)}, got {value!r}")
    return value


def _in(dimension: str | None) -> str:
    """Return what a message says about the unit of an argument."""
    return "" if dimension is None else f" in {_UNITS[dimension]}, or a text with its unit"
