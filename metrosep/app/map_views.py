"""`MapView`: the picture of a map in a window, as indices into a table of colours.

The picture is seen from above with x to the right and **y up**: row 0 is the *largest* y, as a
canvas draws it. Screen pixels are square in m. Index 0 is not measured, 1 to 255 are heights from
the low to the high end of the range.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from metrosep.app.pyramid import MapPyramid, PyramidLevel
from metrosep.core._arrays import ByteArray, FloatArray
from metrosep.core.errors import DataError

__all__ = ["MapView", "map_view"]

Detail = Literal["drag", "idle", "full"]

_LONGEST_SIDE = {"drag": 512, "idle": 1024, "full": 4096}
"""Most screen pixels along a side at each level of the preview ladder."""

_STEPS = 254
"""Index 1 is the low end of the range, 255 the high end."""

_LIGHT = np.array([-0.5, 0.5, math.sqrt(0.5)])
"""Towards the light: from the upper left of the picture (x, y up), 45 degrees above it."""

_SHADED_SLOPE = 0.5
"""What the RMS slope of the picture is scaled to before it is shaded."""

_FLAT = 128
"""Brightness of a level pixel; 255 faces the light, 1 is turned away."""


@dataclass(frozen=True, slots=True, eq=False)
class MapView:
    """A picture of a map.

    Parameters
    ----------
    index : ndarray of uint8, shape (h, w)
        0 not measured or outside the map; 1 to 255 the height over `range`, clipped at its ends.
        Row 0 is the largest y.
    shade : ndarray of uint8, shape (h, w), or None
        Brightness 1 to 255, 128 where level; 0 where the slope is not known. None unless asked.
    range : tuple of (float, float) or None, m
        Heights of index 1 and 255; None where nothing was measured.
    window : tuple of (float, float, float, float), m
        Outer edges ``(x0, y0, x1, y1)`` of the picture.
    scale : float, m
        Side of a screen pixel.
    level : int
        Level of the pyramid that was drawn; 0 is the map itself.
    is_preview : bool
        Whether pixels of the map were averaged or left out: not each one is on the screen.
    coverage : float, dimensionless
        Valid share of the pixels of the map in the window; 0 where the window misses the map.
    unit : str
        Of window and scale: ``"m"``, or ``"px"`` for a map without lateral calibration.
    """

    index: ByteArray
    shade: ByteArray | None
    range: tuple[float, float] | None
    window: tuple[float, float, float, float]
    scale: float
    level: int
    is_preview: bool
    coverage: float
    unit: str


def map_view(
    pyramid: MapPyramid,
    *,
    window: Sequence[float] | None = None,
    pixels: Sequence[int] = (512, 512),
    level: Detail = "idle",
    limits: Sequence[float] | None = None,
    shade: bool = False,
) -> MapView:
    """Return the picture of a window.

    Parameters
    ----------
    pyramid : MapPyramid
        Of the map.
    window : sequence of 4 floats, m, optional
        ``(x0, y0, x1, y1)`` to be seen, ``x0 < x1``, ``y0 < y1``; the whole map if omitted. It is
        widened about its centre on one axis so that screen pixels are square.
    pixels : sequence of 2 ints, optional
        Width and height of the canvas, 1 to 16384 each.
    level : {"drag", "idle", "full"}, optional
        The longer side is cut to 512, 1024 or 4096 screen pixels; the canvas stretches the rest.
    limits : sequence of 2 floats, m, optional
        Heights of index 1 and 255; the robust range of the whole map if omitted, so that colours
        stay when the window moves.
    shade : bool, optional
        Also compute the hill-shade.

    Returns
    -------
    MapView
        Index picture with its window, range and scale.

    Raises
    ------
    DataError
        If window, pixels, limits or level are not as above.

    Notes
    -----
    Each screen pixel shows the cell of the nearest pyramid level in which its centre lies; nothing
    is interpolated, so a step stays a step and a gap a gap. Cells with less than half of their
    pixels valid are not measured. The hill-shade is the cosine between the light, from the upper
    left at 45 degrees, and the normal of the surface, whose slopes are scaled to an RMS of 0.5 in
    the picture: it shows shape, not slope in rad.

    Examples
    --------
    >>> import numpy as np
    >>> from metrosep.app.pyramid import build_pyramid
    >>> from metrosep.core.surface import Surface
    >>> pyramid = build_pyramid(Surface([[0.0, 1.0], [np.nan, 2.0]], dx=1e-3, dy=1e-3))
    >>> map_view(pyramid, pixels=(2, 2), limits=(0.0, 2.0)).index.tolist()
    [[0, 255], [1, 128]]
    """
    width, height = _screen(pixels, level)
    box = pyramid.window if window is None else _checked_window(window)
    box, scale = _squared(box, width, height)
    chosen = pyramid.level_for(scale)
    cells = pyramid.levels[chosen]
    rows, columns = _cells_under(box, (height, width), pyramid, cells)
    z = _heights(cells, rows, columns)[::-1]
    heights = _checked_limits(limits) if limits is not None else pyramid.robust_range
    return MapView(
        index=_frozen(_indices(z, heights)),
        shade=_frozen(_shaded(cells, rows, columns)) if shade else None,
        range=heights,
        window=box,
        scale=scale,
        level=chosen,
        is_preview=scale > min(pyramid.step) * (1.0 + 1e-9),
        coverage=_coverage(cells, rows, columns),
        unit=pyramid.unit,
    )


def _screen(pixels: Sequence[int], level: str) -> tuple[int, int]:
    if level not in _LONGEST_SIDE:
        raise DataError(f'level must be "drag", "idle" or "full", got {level!r}')
    sides: list[Any] = list(pixels)
    whole = [isinstance(n, int | np.integer) and not isinstance(n, bool) for n in sides]
    if len(sides) != 2 or not all(whole) or not all(1 <= n <= 16384 for n in sides):
        raise DataError(f"pixels must be two whole numbers from 1 to 16384, got {pixels!r}")
    shrink = min(1.0, _LONGEST_SIDE[level] / max(sides))
    width, height = (max(1, round(int(n) * shrink)) for n in sides)
    return width, height


def _numbers(values: Sequence[float], n: int, what: str) -> list[float]:
    try:
        numbers = [float(v) for v in values]
    except (TypeError, ValueError):
        numbers = []
    if len(numbers) != n or not all(math.isfinite(v) for v in numbers):
        raise DataError(f"{what} must be {n} finite numbers in m, got {values!r}")
    return numbers


def _checked_window(window: Sequence[float]) -> tuple[float, float, float, float]:
    x0, y0, x1, y1 = _numbers(window, 4, "window")
    if not (x0 < x1 and y0 < y1):
        raise DataError(
            f"window is (x0, y0, x1, y1) with x0 < x1 and y0 < y1, got {(x0, y0, x1, y1)} m"
        )
    return x0, y0, x1, y1


def _checked_limits(limits: Sequence[float]) -> tuple[float, float]:
    low, high = _numbers(limits, 2, "limits")
    if not (low < high and math.isfinite(high - low)):
        raise DataError(f"limits run from the lower to the higher height, got {low} m to {high} m")
    return low, high


def _squared(
    box: tuple[float, float, float, float], width: int, height: int
) -> tuple[tuple[float, float, float, float], float]:
    """Widen a window about its centre to the shape of the screen."""
    x0, y0, x1, y1 = box
    scale = max((x1 - x0) / width, (y1 - y0) / height)
    x, y, half = (x0 + x1) / 2.0, (y0 + y1) / 2.0, scale / 2.0
    wide = (x - width * half, y - height * half, x + width * half, y + height * half)
    if not (scale > 0.0 and all(math.isfinite(v) for v in (scale, *wide))):
        raise DataError(f"window {box} m is too large or too small to be drawn")
    return wide, scale


def _cells_under(
    box: tuple[float, float, float, float],
    screen: tuple[int, int],
    pyramid: MapPyramid,
    cells: PyramidLevel,
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Row of cells under each screen row (bottom first) and column; -1 outside the map."""
    found = []
    outline = pyramid.window
    for axis in (0, 1):
        low, high = box[1 - axis], box[3 - axis]
        n, size, step = screen[axis], pyramid.shape[axis], pyramid.step[axis]
        centre = low + (np.arange(n) + 0.5) * ((high - low) / n)
        pixel = np.floor((centre - outline[1 - axis]) / step)
        inside = (pixel >= 0) & (pixel < size)
        cell = np.where(inside, pixel, 0.0).astype(np.intp) // cells.factor[axis]
        found.append(np.where(inside, cell, -1))
    return found[0], found[1]


def _heights(cells: PyramidLevel, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> FloatArray:
    z = cells.shown(np.maximum(rows, 0), np.maximum(columns, 0))
    z[rows < 0, :] = np.nan
    z[:, columns < 0] = np.nan
    return z


def _indices(z: FloatArray, heights: tuple[float, float] | None) -> ByteArray:
    """Return 1 + 254 (z - low) / (high - low), rounded and clipped; 0 for NaN."""
    valid = ~np.isnan(z)
    if heights is None:
        return np.zeros(z.shape, dtype=np.uint8)
    low, high = heights
    part = np.full(z.shape, 0.5)
    if high > low:  # a level map has no range: all of it gets the middle index
        part = np.clip((np.where(valid, z, low) - low) / (high - low), 0.0, 1.0)
    return np.where(valid, np.rint(1.0 + _STEPS * part), 0.0).astype(np.uint8)


def _shaded(cells: PyramidLevel, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> ByteArray:
    """Return the brightness of a picture: that of the cells under it, not of its own pixels.

    Pixels that show one cell twice would have no slope there: a grid that is not on the part.
    """
    inside_y, inside_x = rows[rows >= 0], columns[columns >= 0]
    out = np.zeros((rows.size, columns.size), dtype=np.uint8)
    if inside_y.size == 0 or inside_x.size == 0:
        return out
    first_y, first_x = max(int(inside_y[0]) - 1, 0), max(int(inside_x[0]) - 1, 0)
    last_y = min(int(inside_y[-1]) + 2, cells.y.size)
    last_x = min(int(inside_x[-1]) + 2, cells.x.size)
    z = cells.shown(np.arange(first_y, last_y), np.arange(first_x, last_x))
    lit = _hill_shade(z[::-1])[::-1]
    picked = lit[np.maximum(rows - first_y, 0)][:, np.maximum(columns - first_x, 0)]
    shown = np.outer(rows >= 0, columns >= 0)
    return np.where(shown, picked, 0).astype(np.uint8)[::-1]


def _hill_shade(z: FloatArray) -> ByteArray:
    """Return the brightness of a picture whose row 0 is up; slopes by central differences."""
    slope_x, slope_y = np.full(z.shape, np.nan), np.full(z.shape, np.nan)
    slope_x[:, 1:-1] = (z[:, 2:] - z[:, :-2]) / 2.0
    slope_y[1:-1, :] = (z[:-2, :] - z[2:, :]) / 2.0
    known = ~(np.isnan(slope_x) | np.isnan(slope_y) | np.isnan(z))
    brightness = np.zeros(z.shape, dtype=np.uint8)
    if not known.any():
        return brightness
    sx, sy = slope_x[known], slope_y[known]
    top = max(float(np.abs(sx).max()), float(np.abs(sy).max()))
    if top > 0.0:
        sx, sy = sx / top, sy / top
        gain = _SHADED_SLOPE / math.sqrt(float(np.mean(sx * sx + sy * sy)))
        sx, sy = sx * gain, sy * gain
    cosine = (_LIGHT[2] - _LIGHT[0] * sx - _LIGHT[1] * sy) / np.sqrt(1.0 + sx * sx + sy * sy)
    level = _LIGHT[2]
    lit = np.where(
        cosine > level,
        _FLAT + (255 - _FLAT) * (cosine - level) / (1.0 - level),
        _FLAT * cosine / level,
    )
    brightness[known] = np.clip(np.rint(lit), 1.0, 255.0).astype(np.uint8)
    return brightness


def _coverage(cells: PyramidLevel, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> float:
    """Return the valid share of the pixels in the block of cells that the picture touches."""
    rows, columns = rows[rows >= 0], columns[columns >= 0]
    if rows.size == 0 or columns.size == 0:
        return 0.0
    block = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    if cells.count is None:
        z = cells.z[block]
        return float(np.count_nonzero(~np.isnan(z)) / z.size)
    n = int(cells.pixels_y[block[0]].sum()) * int(cells.pixels_x[block[1]].sum())
    return float(cells.count[block].sum() / n)


def _frozen(picture: ByteArray) -> ByteArray:
    picture.setflags(write=False)
    return picture
