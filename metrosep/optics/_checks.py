"""Private checks on what a caller gives: numbers, pairs and arrays of real numbers."""

from __future__ import annotations

from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray, as_float, is_frozen
from metrosep.core.errors import InvalidSamplesError
from metrosep.core.numbers import between

WAVELENGTHS = (1e-8, 1e-2)
"""m: from the extreme ultraviolet to microwaves; beyond lie nanometres or micrometres taken as m."""


def wavelength_of(value: object) -> float:
    """Return a wavelength of light in m."""
    why = "633 nm is 633e-9"
    return between(value, "wavelength", *WAVELENGTHS, dimension="length", why=why)


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


def freeze_fields(obj: object, *names: str) -> None:
    """Make fields arrays that cannot be written to; one that nobody can write to is taken as it is."""
    for name in names:
        values = getattr(obj, name)
        if not (is_frozen(values) and type(values) is np.ndarray) or np.isinf(values).any():
            values = np.ascontiguousarray(real_array(values, name))
            values.setflags(write=False)
        object.__setattr__(obj, name, values)
