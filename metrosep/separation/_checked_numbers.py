"""Settings of the standard tests as plain numbers."""

from __future__ import annotations

import math
import numbers
from typing import Any

import numpy as np

from metrosep.core.errors import DataError

__all__ = ["checked_count", "checked_number", "checked_sd", "checked_seed"]


def checked_number(value: Any, name: str, what: str = "a number") -> float:
    """Return a finite number."""
    single = isinstance(value, numbers.Real) or (
        isinstance(value, np.ndarray) and value.ndim == 0 and value.dtype.kind in "iuf"
    )
    if not single or isinstance(value, (bool, np.bool_)) or not math.isfinite(float(value)):
        raise DataError(f"{name} must be {what}, got {value!r}")
    return float(value)


def checked_sd(value: Any, unit: str = "") -> float | None:
    """Return the standard deviation of one reading, or None."""
    if value is None:
        return None
    tail = f", in {unit}" if unit else ""
    sd = checked_number(value, "sd", f"a number{tail}")
    if sd < 0.0:
        raise DataError(f"sd must be zero or positive{tail}, got {value}")
    return sd


def checked_count(value: Any, name: str, *, low: int = 0) -> int:
    """Return a whole number."""
    what = f"a whole number of {low} or more"
    found = checked_number(value, name, what)
    if found != int(found) or found < low:
        raise DataError(f"{name} must be {what}, got {value!r}")
    return int(found)


def checked_seed(value: Any) -> int:
    """Return the seed of a simulation."""
    return checked_count(value, "seed")
