"""A list of points x, y, z on a regular grid becomes a surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import FormatMismatchError, UnsupportedFeatureError
from metrosep.io.source import MAX_PIXELS, RawFile

__all__ = ["to_grid"]

_STEP_RTOL = 1e-3
"""Largest deviation of a position from the grid, relative to the step (digits of a text file)."""

_NOISE = 1e-12
"""Positions closer than this, relative to the span, are one position."""

_SPARSE = 64
"""Pixels per point beyond which points are scattered and no map."""

_SMALL = 4096
"""Pixels that a map may have whatever its points."""


def to_grid(
    file: RawFile, x: FloatArray, y: FloatArray, z: FloatArray
) -> tuple[FloatArray, tuple[float, float], tuple[float, float]]:
    """Return points in any order as a map."""
    columns, dx = _indices(file, x, "x")
    rows, dy = _indices(file, y, "y")
    shape = (int(rows.max()) + 1, int(columns.max()) + 1)
    pixels = shape[0] * shape[1]
    if pixels > MAX_PIXELS:
        raise UnsupportedFeatureError(
            f"{file.path}: the points span {shape[1]} x {shape[0]} steps, more than {MAX_PIXELS} pixels"
        )
    if pixels > max(_SPARSE * x.size, _SMALL):
        raise UnsupportedFeatureError(
            f"{file.path}: {x.size} points are scattered over a grid of {shape[1]} x {shape[0]}; resample "
            "them to a map first"
        )
    places = rows * shape[1] + columns
    if np.unique(places).size != places.size:
        raise FormatMismatchError(
            f"{file.path}: two points of the list lie at the same place; remove the repeats"
        )
    heights = np.full(shape[0] * shape[1], np.nan)
    heights[places] = z
    return heights.reshape(shape), (dx, dy), (float(x.min()), float(y.min()))


def _indices(file: RawFile, values: FloatArray, name: str) -> tuple[NDArray[np.int64], float]:
    if np.isnan(values).any():
        raise FormatMismatchError(f"{file.path}: a point has no position {name}; remove its row")
    levels = np.unique(values)
    if levels.size < 2:
        raise FormatMismatchError(
            f"{file.path}: all points have the same {name}, so there is no grid; read a profile with x= "
            "and z="
        )
    steps = np.diff(levels)
    span = float(levels[-1] - levels[0])
    steps = steps[steps > _NOISE * span]
    for guess in (
        float(np.median(steps)),
        float(steps.min()),
    ):  # the smallest where rows are missing
        step = span / max(round(span / guess), 1)
        index = np.rint((values - levels[0]) / step)
        fits = np.abs(values - levels[0] - index * step).max() <= _STEP_RTOL * step
        if fits and np.unique(index).size == steps.size + 1:
            return index.astype(np.int64), step
    raise FormatMismatchError(
        f"{file.path}: the positions {name} do not lie on a regular grid (step near "
        f"{float(np.median(steps)):.6g} m); resample the points first"
    )
