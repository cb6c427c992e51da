"""The middle of what was measured: where the axis of a part is taken if a map declares no origin."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.surface import Surface
from metrosep.core.units import format_length

__all__ = ["Axis", "assumed_axis", "measured_middle"]

Positions = NDArray[np.floating[Any]]

_CENTRED = 1e-3
"""Of the extent of a map: a middle of the measured part so close to that of the map is the same."""


def measured_middle(z: FloatArray, x: Positions, y: Positions) -> tuple[float, float]:
    """Return the middle of the measured part of a map.

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


class Axis(NamedTuple):
    """Where the axis of a part is taken."""

    position: tuple[float, float]  # of (float, float), m: in the coordinates of the map
    # what the caller should be told: where it was taken, if nothing but the data says so
    notes: tuple[str, ...] = ()


def assumed_axis(surface: Surface) -> Axis:
    """Return the axis of a part whose centre was not given."""
    if surface.origin != (0.0, 0.0):
        return Axis((0.0, 0.0))
    rows, columns = surface.shape
    x, y = (surface.dx or 0.0) * np.arange(columns), (surface.dy or 0.0) * np.arange(rows)
    middle = measured_middle(surface.z, x, y)
    off = max(
        abs(m - 0.5 * float(p[-1])) / float(p[-1] or 1.0)
        for m, p in zip(middle, (x, y), strict=True)
    )
    if off < _CENTRED:
        return Axis(middle)
    x0, y0 = (format_length(m) for m in middle)
    note = (
        "the map declares no origin, so its axis is taken in the middle of what was measured, "
        f"x = {x0}, y = {y0}; give centre= if it lies elsewhere"
    )
    return Axis(middle, (note,))


def _of_chords(valid: NDArray[np.bool_], at: Positions) -> float:
    rows = valid[valid.any(axis=1)]
    first = np.argmax(rows, axis=1)
    last = rows.shape[1] - 1 - np.argmax(rows[:, ::-1], axis=1)
    return float(np.median(0.5 * (at[first] + at[last])))
