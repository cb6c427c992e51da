"""Private helper: refuse complex numbers, text and rows of unequal length before they are used."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core.errors import InvalidSamplesError

__all__ = ["real_numbers"]


def real_numbers(values: Any, name: str) -> NDArray[Any]:
    """Return an array of real numbers of any kind; what is no such array is refused by name."""
    try:
        array = np.asarray(values)
        is_complex = np.iscomplexobj(array)
        if not is_complex and array.dtype.kind not in "fiub":
            array = array.astype(np.float64)
    except (TypeError, ValueError) as exc:
        raise InvalidSamplesError(
            f"{name} must be real numbers in rows of equal length, in SI: {exc}"
        ) from None
    if is_complex:
        raise InvalidSamplesError(f"{name} must be real, got complex: give X and Y as two rows")
    return array
