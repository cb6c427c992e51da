"""Index positions of `multistep`, from numbers of steps or from angles."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.separation._circle import check_whole

__all__ = ["index_positions"]


def index_positions(steps: Any, angles: ArrayLike | None, rows: int) -> ArrayLike:
    """Return the index positions in rad of rows of readings."""
    if angles is not None:
        if steps is not None:
            raise DataError("give steps or angles, not both")
        if np.shape(angles) != (rows,):
            raise DataError(f"{np.shape(angles)} angles do not fit {rows} rows of readings")
        return angles
    if steps is None and rows < 2:
        raise TooFewSamplesError(
            f"multistep: at least 2 positions are needed, one row of readings each, got {rows}"
        )
    whole = (Sequence, np.ndarray)
    given = (
        [rows]
        if steps is None
        else list(steps)
        if isinstance(steps, whole) and np.ndim(steps)
        else [steps]
    )
    counts = [check_whole(n, "steps", least=2) for n in given]
    if sum(counts) != rows:
        raise DataError(
            f"steps = {steps} needs {sum(counts)} rows of readings, one each, got {rows}"
        )
    return np.concatenate([2.0 * np.pi * np.arange(n) / n for n in counts])
