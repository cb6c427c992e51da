"""Private: results as plain values for JSON: None where nothing is known."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from metrosep.core.quantity import Quantity


def known(value: float | None) -> float | None:
    """Return a number, None where it is NaN: an audit holds no NaN."""
    return None if value is None or math.isnan(value) else float(value)


def plain(value: Any) -> Any:
    """Return lists, dicts, numbers and texts; NaN and infinity become None."""
    if isinstance(value, Quantity):
        return plain(value.to_dict())
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value
