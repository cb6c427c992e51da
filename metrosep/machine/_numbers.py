"""Private helper: numbers that a person typed or measured; texts, truth values and dates are none.

numpy takes True for 1, "0.01" for 0.01 and None for NaN. Of a position or an error of a machine
each of these is a slip that no result would show.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray, as_float, frozen_float
from metrosep.core.errors import InvalidSamplesError, UnitError

__all__ = [
    "TrialAmounts",
    "check_amount",
    "finite_number",
    "finite_vector",
    "is_angle",
    "is_real",
    "positions_array",
    "real_array",
    "standard_uncertainty",
]

LARGEST = {"m": 1.0, "rad": 1.0}
"""Amounts of error terms above these are other units: um as m, degrees as rad. Units themselves pass."""

_HINTS = {
    "m": "lengths are in m, 5 um are 5e-6",
    "rad": "angles are in rad, 0.5 degrees are 0.00873 and 1 arc second 4.85e-6",
}


class TrialAmounts(dict[str, float]):
    """Amounts that a fit tries, by term: on its way they may be larger than those of a machine."""


def is_real(value: object) -> bool:
    """Return whether a value is one real number: not a truth value, a text, a date, an array."""
    if isinstance(value, np.ndarray):
        return value.ndim == 0 and value.dtype.kind in "iuf" and not np.ma.is_masked(value)
    return isinstance(value, int | float | np.integer | np.floating) and not isinstance(
        value, bool
    )


def finite_number(value: Any, name: str) -> float:
    """Return a finite real number as a float."""
    if np.iscomplexobj(value):
        raise InvalidSamplesError(f"{name} must be real, got {value!r}")
    if not is_real(value):
        raise InvalidSamplesError(
            f"{name} must be a number in SI, got {value!r} of type {type(value).__name__}"
        )
    number = float(value)
    if not math.isfinite(number):
        raise InvalidSamplesError(f"{name} is {number}; leave out a term that was not measured")
    return number


def standard_uncertainty(value: Any) -> float:
    """Return a standard uncertainty as a float, refusing negative ones."""
    number = finite_number(value, "standard uncertainty of a term")
    if number < 0.0:
        raise InvalidSamplesError(f"standard uncertainty of a term is {number}; it must be >= 0")
    return number


def real_array(values: Any, name: str) -> FloatArray:
    """Return real numbers as a new float64 array, NaN and infinities kept."""
    _refuse_no_numbers(values, name)
    try:
        array = as_float(values)
    except (TypeError, ValueError) as exc:
        raise InvalidSamplesError(f"{name} must be real numbers in SI: {exc}") from None
    return array


def positions_array(values: Any, name: str) -> FloatArray:
    """Return real numbers as a new float64 array, NaN kept; infinities are refused."""
    array = real_array(values, name)
    if np.isinf(array).any():
        first = tuple(int(i) for i in np.argwhere(np.isinf(array))[0])
        where = f" at index {first}" if first else ""
        raise InvalidSamplesError(f"{name} is infinite{where}")
    return array


def finite_vector(values: Sequence[float], name: str) -> tuple[float, ...]:
    """Return finite real numbers of one dimension as a tuple."""
    _refuse_no_numbers(values, name)
    array = frozen_float(values, name=name, ndim=1)
    if np.isnan(array).any():
        raise InvalidSamplesError(
            f"{name} hold NaN at index {int(np.argmax(np.isnan(array)))}; leave out what was not "
            "measured"
        )
    return tuple(array.tolist())


def is_angle(term: str) -> bool:
    """Return whether the ISO 230-1 name is that of an angle: EAX, ECC, B0Z."""
    return term.removeprefix("E")[:1] in ("A", "B", "C")


def check_amount(term: str, values: FloatArray, what: str) -> None:
    """Refuse amounts of a term that only another unit explains."""
    unit = "rad" if is_angle(term) else "m"
    largest = float(np.abs(values).max(initial=0.0))
    if largest > LARGEST[unit]:
        raise UnitError(
            f"{what} is {largest:.6g} {unit}; above {LARGEST[unit]:g} {unit} it is no error of a "
            f"machine: {_HINTS[unit]}"
        )


def _refuse_no_numbers(values: Any, name: str) -> None:
    """Refuse what numpy would take for numbers; complex ones are left to `as_float`."""
    try:
        kind = np.asarray(values).dtype.kind
    except ValueError as exc:
        raise InvalidSamplesError(f"{name} must be real numbers in SI: {exc}") from None
    mixed = isinstance(values, list | tuple) and any(
        isinstance(v, bool | np.bool_) for v in values
    )
    if kind not in "iufc" or mixed:
        raise InvalidSamplesError(
            f"{name} must be real numbers in SI, got {str(values)[:40]!r} of type "
            f"{type(values).__name__}; write NaN where nothing was measured"
        )
