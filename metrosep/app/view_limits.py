"""What a picture of a line is asked for: its part, and its pixel columns."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from metrosep.core.errors import DataError

__all__ = ["checked_columns", "checked_window"]

_MOST_COLUMNS = 100_000


def checked_window(
    window: Sequence[float] | None, whole: tuple[float, float]
) -> tuple[float, float]:
    """Return the part of a line that is looked at."""
    if window is None:
        return whole
    try:
        x0, x1 = (float(v) for v in window)
    except (TypeError, ValueError):
        x0 = x1 = math.nan
    if not (math.isfinite(x0) and math.isfinite(x1) and x0 < x1):
        raise DataError(f"window must be two positions x0 < x1 in m, got {window!r}")
    return x0, x1


def checked_columns(columns: Any) -> int:
    """Return the number of pixel columns of a picture."""
    is_whole = isinstance(columns, int | np.integer) and not isinstance(columns, bool)
    if not is_whole or not 1 <= columns <= _MOST_COLUMNS:
        raise DataError(f"columns must be a whole number from 1 to 100 000, got {columns!r}")
    return int(columns)
