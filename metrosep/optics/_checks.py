"""Private checks on what a caller gives: numbers, pairs and arrays of real numbers."""

from __future__ import annotations

from operator import index
from typing import Any, TypeGuard

import numpy as np

from metrosep.core._arrays import FloatArray, as_float
from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.core.numbers import real

WAVELENGTHS = (1e-8, 1e-2)
"""m: from the extreme ultraviolet to microwaves; beyond lie nanometres or micrometres taken as m."""


def real_number(value: object, name: str, unit: str = "m") -> float:
    """Return a finite float."""
    return real(value, name, what=f"a finite number, in {unit}")


def positive(value: object, name: str, unit: str = "m") -> float:
    """Return a finite float above zero."""
    number = real_number(value, name, unit)
    if number <= 0.0:
        raise DataError(f"{name} must be positive, in {unit}, got {value!r}")
    return number


def wavelength_of(value: object) -> float:
    """Return a wavelength of light in m."""
    number = positive(value, "wavelength")
    low, high = WAVELENGTHS
    if not low <= number <= high:
        raise DataError(
            f"wavelength is in m, from {low:g} to {high:g}, got {value!r}; 633 nm is 633e-9"
        )
    return number


def whole_number(value: object, name: str, least: int) -> int:
    """Return an int from `least` on; numbers that only look whole are taken, truth values not."""
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    try:
        number = index(value)  # type: ignore[arg-type]
    except TypeError:
        number = least - 1
    if number < least or isinstance(value, bool | np.bool_):
        raise DataError(f"{name} must be a whole number from {least} on, got {value!r}")
    return number


def pair_of(value: object, name: str) -> tuple[float, float]:
    """Return two finite floats in m."""
    try:
        both = () if isinstance(value, str | bytes) else tuple(value)  # type: ignore[arg-type]
    except TypeError:
        both = ()
    if len(both) != 2:
        raise DataError(f"{name} must be two numbers (x, y), in m, got {value!r}")
    return real_number(both[0], f"x of {name}"), real_number(both[1], f"y of {name}")


def real_array(values: Any, name: str, unit: str = "m") -> FloatArray:
    """Return a float64 copy; NaN and masked are kept as NaN, anything but real numbers is refused."""
    try:
        kind = np.asanyarray(values).dtype
        array = as_float(values) if kind.kind in "iuf" else None
    except (TypeError, ValueError):  # rows of unequal length
        kind, array = np.dtype(object), None
    if array is None:
        raise InvalidSamplesError(
            f"{name} must hold real numbers in {unit}, NaN where nothing is known; got "
            f"{type(values).__name__} of {kind}"
        )
    if np.isinf(array).any():
        raise InvalidSamplesError(
            f"{name} is infinite at index {tuple(int(i) for i in np.argwhere(np.isinf(array))[0])}; "
            "write NaN where nothing is known"
        )
    return array


def frozen(values: Any, name: str) -> FloatArray:
    """Return `real_array` that cannot be written to; one that nobody can write to is taken as it is."""
    if _is_own(values) and not np.isinf(values).any():
        return values
    array: FloatArray = np.ascontiguousarray(real_array(values, name))
    array.setflags(write=False)
    return array


def _is_own(values: Any) -> TypeGuard[FloatArray]:
    if type(values) is not np.ndarray or values.dtype != np.float64:
        return False
    return values.base is None and values.flags.c_contiguous and not values.flags.writeable
