"""`MapPyramid`: means of a map over ever larger cells, for pictures at every zoom.

A cell is the mean of its *valid* pixels, with their number. A cell with less than half of its
pixels valid counts as not measured in pictures: else every level would grow the measured region
by a rim. Nothing is filled. Cells of odd maps end with the map, and so do their coordinates.

Rows are y and columns x, as in `Surface`; where a lateral step is not calibrated, both axes count
pixels (step 1, `unit` "px"): square pixels in m are never assumed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.core.surface import Surface

Number = TypeVar("Number", np.float64, np.int32)

_LEAST_COVERAGE = 0.5
"""Share of valid pixels from which a cell is shown."""

_ROWS_AT_ONCE = 64
"""Rows of the map folded in one piece, so that its temporaries stay in the cache."""

_RANGE_PIXELS = 512 * 512
"""The robust range is read from this many pixels, drawn at random with a fixed seed."""

_ROBUST_SHARE = 0.002
"""Share of the pixels left outside at each end of the robust range."""


@dataclass(frozen=True, slots=True, eq=False)
class PyramidLevel:
    """One level: means over cells of ``factor`` pixels.

    Parameters
    ----------
    z : ndarray, shape (n_y, n_x), m
        Mean of the valid pixels of each cell; NaN only where none is valid.
    count : ndarray of int, shape (n_y, n_x), or None
        Number of valid pixels; None at level 0, where NaN says it.
    factor : tuple of (int, int)
        Pixels of a cell along y and x, powers of two.
    pixels_y, pixels_x : ndarray of int, shapes (n_y,) and (n_x,)
        Pixels of each row and column of cells; the last may have fewer.
    y, x : ndarray, shapes (n_y,) and (n_x,), m
        Centres of the cells: the mean position of the pixels they hold.
    """

    z: FloatArray
    count: NDArray[np.int32] | None
    factor: tuple[int, int]
    pixels_y: NDArray[np.int32]
    pixels_x: NDArray[np.int32]
    y: FloatArray
    x: FloatArray

    def coverage(self) -> FloatArray:
        """Return the valid share of each cell."""
        if self.count is None:
            return np.asarray((~np.isnan(self.z)).astype(np.float64))
        return np.asarray(self.count / np.multiply.outer(self.pixels_y, self.pixels_x))

    def shown(self, rows: ArrayLike | None = None, columns: ArrayLike | None = None) -> FloatArray:
        """Return the means as a picture shows them."""
        i = np.arange(self.z.shape[0]) if rows is None else np.asarray(rows, dtype=np.intp)
        j = np.arange(self.z.shape[1]) if columns is None else np.asarray(columns, dtype=np.intp)
        z = self.z.take(i, axis=0).take(j, axis=1)
        if self.count is not None:
            count = self.count.take(i, axis=0).take(j, axis=1)
            least = _LEAST_COVERAGE * np.multiply.outer(self.pixels_y[i], self.pixels_x[j])
            z[count < least] = np.nan
        return np.asarray(z)


@dataclass(frozen=True, slots=True, eq=False)
class MapPyramid:
    """A map and its means at powers of two; made by `build_pyramid`.

    Parameters
    ----------
    levels : tuple of PyramidLevel
        From the map itself to a single cell.
    step : tuple of (float, float), m
        Lateral steps of the map along y and x; 1 where not calibrated.
    origin : tuple of (float, float), m
        x and y of the centre of the first pixel; 0 where not calibrated.
    unit : str
        Of the lateral coordinates: ``"m"`` or ``"px"``.
    extremes : tuple of (float, float) or None, m
        Least and greatest valid height of all pixels; None where nothing was measured.
    robust_range : tuple of (float, float) or None, m
        Heights that leave out the lowest and highest 0.2 % of the valid pixels; `extremes` where
        that leaves a single height.
    n_invalid : int
        Pixels that were not measured.
    """

    levels: tuple[PyramidLevel, ...]
    step: tuple[float, float]
    origin: tuple[float, float]
    unit: str
    extremes: tuple[float, float] | None
    robust_range: tuple[float, float] | None
    n_invalid: int

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the map."""
        return (int(self.levels[0].z.shape[0]), int(self.levels[0].z.shape[1]))

    @property
    def window(self) -> tuple[float, float, float, float]:
        """Outline ``(x0, y0, x1, y1)`` in m: the outer edges of the outermost pixels."""
        (ny, nx), (dy, dx), (x, y) = self.shape, self.step, self.origin
        return (x - dx / 2, y - dy / 2, x + (nx - 0.5) * dx, y + (ny - 0.5) * dy)

    def level_for(self, scale: float) -> int:
        """Return the level whose cells come nearest in size to a screen pixel.

        Notes
        -----
        Nearest by ratio, of the smaller side of the cells (of an axis with more than one cell):
        cells are 0.7 to 1.4 screen pixels wide. At a tie the finer one.
        """
        if not (math.isfinite(scale) and scale > 0.0):
            raise DataError(f"the scale of a picture must be positive and finite, got {scale} m")
        sizes = [_cell_size(v, self.step) for v in self.levels]
        return int(np.argmin(np.abs(np.log2(np.asarray(sizes) / scale))))


def build_pyramid(surface: Surface) -> MapPyramid:
    """Return the mean pyramid of a map.

    Notes
    -----
    The robust range of a large map is read from 262 144 pixels drawn at random (fixed seed).
    Each level sums the valid heights and their number over two cells along y and x, so every cell
    is the mean of its valid *pixels*, not a mean of means. Where the pixels are not square, only
    the finer axis is halved until they nearly are.

    Examples
    --------
    >>> from metrosep.core.surface import Surface
    >>> nan = float("nan")
    >>> pyramid = build_pyramid(Surface([[1.0, 3.0, 5.0], [nan, 2.0, nan]], dx=1.0, dy=1.0))
    >>> pyramid.levels[1].z.tolist(), pyramid.levels[1].coverage().tolist()
    ([[2.0, 5.0]], [[0.75, 0.5]])
    >>> pyramid.levels[1].x.tolist()
    [0.5, 2.0]
    """
    if not isinstance(surface, Surface):
        raise DataError(f"a pyramid is built of a Surface, got {type(surface).__name__}")
    calibrated = surface.dx is not None and surface.dy is not None
    step = (surface.dy or 1.0, surface.dx or 1.0) if calibrated else (1.0, 1.0)
    origin = surface.origin if calibrated else (0.0, 0.0)
    levels = _levels(surface.z, step, origin)
    z, top = surface.z, levels[-1].count
    n_valid = int(top.sum()) if top is not None else int(np.count_nonzero(~np.isnan(z)))
    extremes = None if n_valid == 0 else (float(np.fmin.reduce(z, axis=None)), _highest(z))
    return MapPyramid(
        levels=levels,
        step=step,
        origin=origin,
        unit="m" if calibrated else "px",
        extremes=extremes,
        robust_range=None if extremes is None else _robust_range(z),
        n_invalid=z.size - n_valid,
    )


def _cell_size(level: PyramidLevel, step: tuple[float, float]) -> float:
    """Return the smaller side of the cells; an axis with a single cell says nothing."""
    sides = [s * f for s, f in zip(step, level.factor, strict=True)]
    several = [side for side, n in zip(sides, level.z.shape, strict=True) if n > 1]
    return min(several) if several else max(sides)


def _highest(z: FloatArray) -> float:
    return float(np.fmax.reduce(z, axis=None))


def _levels(
    z: FloatArray, step: tuple[float, float], origin: tuple[float, float]
) -> tuple[PyramidLevel, ...]:
    levels = [_level(z, None, (1, 1), z.shape, step, origin)]
    factor, total, count = (1, 1), z, np.zeros((0, 0), dtype=np.int32)
    while total.size > 1:
        halved = _axes_to_halve(total.shape, factor, step)
        if len(levels) == 1:
            total, count = _folded_map(z, halved)
        else:
            total, count = _folded(total, halved), _folded(count, halved)
        factor = (factor[0] * (1 + halved[0]), factor[1] * (1 + halved[1]))
        mean = np.full(total.shape, np.nan)
        np.divide(total, count, out=mean, where=count > 0)
        levels.append(_level(mean, count, factor, z.shape, step, origin))
    return tuple(levels)


def _level(
    mean: FloatArray,
    count: NDArray[np.int32] | None,
    factor: tuple[int, int],
    shape: tuple[int, ...],
    step: tuple[float, float],
    origin: tuple[float, float],
) -> PyramidLevel:
    pixels, centres = [], []
    for n, f, d, first in zip(shape, factor, step, origin[::-1], strict=True):
        start = np.arange(0, n, f)
        stop = np.minimum(start + f, n)
        pixels.append((stop - start).astype(np.int32))
        centres.append(np.asarray(first + d * (start + stop - 1) / 2.0, dtype=np.float64))
    for array in (mean, *pixels, *centres, *(() if count is None else (count,))):
        array.setflags(write=False)
    return PyramidLevel(mean, count, factor, pixels[0], pixels[1], centres[0], centres[1])


def _axes_to_halve(
    shape: tuple[int, ...], factor: tuple[int, int], step: tuple[float, float]
) -> tuple[bool, bool]:
    """Along which axes the next level halves: those whose cell is not already the much longer."""
    cell = (factor[0] * step[0], factor[1] * step[1])
    halve_y = shape[0] > 1 and (cell[0] < math.sqrt(2.0) * cell[1] or shape[1] == 1)
    halve_x = shape[1] > 1 and (cell[1] < math.sqrt(2.0) * cell[0] or shape[0] == 1)
    return (halve_y, halve_x)


def _folded(values: NDArray[Number], halved: tuple[bool, bool]) -> NDArray[Number]:
    """Add two neighbours along the halved axes; the odd last one stays alone."""
    if halved[0]:
        even = values[: values.shape[0] // 2 * 2]
        pairs = even[0::2] + even[1::2]
        values = pairs if len(even) == len(values) else np.concatenate([pairs, values[-1:]])
    if halved[1]:
        n = values.shape[1] // 2 * 2
        pairs = values[:, 0:n:2] + values[:, 1:n:2]
        odd = n < values.shape[1]
        values = np.concatenate([pairs, values[:, -1:]], axis=1) if odd else pairs
    return values


def _folded_map(z: FloatArray, halved: tuple[bool, bool]) -> tuple[FloatArray, NDArray[np.int32]]:
    """Add up and count the valid pixels of the first level of cells, some rows at a time."""
    sums, counts = [], []
    for start in range(0, z.shape[0], _ROWS_AT_ONCE):
        rows = z[start : start + _ROWS_AT_ONCE]
        total = _folded(rows, halved)
        if np.isnan(total).any():
            valid = ~np.isnan(rows)
            total = _folded(np.where(valid, rows, 0.0), halved)
            counts.append(_folded(valid.astype(np.int32), halved))
        else:
            counts.append(_folded(np.ones(rows.shape, dtype=np.int32), halved))
        sums.append(total)
    return np.concatenate(sums), np.concatenate(counts)


def _robust_range(z: FloatArray) -> tuple[float, float]:
    """Return quantiles of pixels, not of means: means would clip a rough map."""
    heights = z.ravel()
    if z.size > _RANGE_PIXELS:
        heights = heights[np.random.default_rng(0).integers(z.size, size=_RANGE_PIXELS)]
    valid = heights[~np.isnan(heights)]
    if valid.size == 0:  # a handful of valid pixels in a large map
        valid = z[~np.isnan(z)]
    low, high = np.quantile(valid, [_ROBUST_SHARE, 1.0 - _ROBUST_SHARE])
    if low == high:  # level but for a few pixels, and these are what is looked for
        low, high = np.fmin.reduce(z, axis=None), np.fmax.reduce(z, axis=None)
    return (float(low), float(high))
