"""The middle of what was measured: where the axis of a part is taken if a map declares no origin."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray

__all__ = ["measured_middle"]

Positions = NDArray[np.floating[Any]]


def measured_middle(z: FloatArray, x: Positions, y: Positions) -> tuple[float, float]:
    """Return the middle of the measured part of a map.

    Parameters
    ----------
    z : ndarray, shape (n_y, n_x)
        Heights; NaN where not measured.
    x : ndarray, shape (n_x,), m
        Positions of the columns.
    y : ndarray, shape (n_y,), m
        Positions of the rows.

    Returns
    -------
    tuple of (float, float), m
        Median over the rows of the middle between first and last measured point, and over the
        columns likewise; the middle of the axes where nothing was measured.

    Notes
    -----
    All chords of a disc, a ring or a rectangle have their middle on its axis. The median forgives
    stray points, dropouts and a rim that is cut off on one side over less than half of the rows.
    A margin that was not measured changes nothing.

    Examples
    --------
    >>> z = np.full((3, 5), np.nan)
    >>> z[:, 3:] = 0.0
    >>> measured_middle(z, np.arange(5.0), np.arange(3.0))
    (3.5, 1.0)
    """
    valid = ~np.isnan(z)
    if valid.all() or not valid.any():
        return 0.5 * float(x[0] + x[-1]), 0.5 * float(y[0] + y[-1])
    return _of_chords(valid, x), _of_chords(valid.T, y)


def _of_chords(valid: NDArray[np.bool_], at: Positions) -> float:
    rows = valid[valid.any(axis=1)]
    first = np.argmax(rows, axis=1)
    last = rows.shape[1] - 1 - np.argmax(rows[:, ::-1], axis=1)
    return float(np.median(0.5 * (at[first] + at[last])))
