"""`SectionView`: heights of a map along a straight line, at full resolution.

The section is read from the map itself, never from its means: a line costs a millisecond even on
4096 x 4096 pixels, so what follows the pointer is already the truth.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from metrosep.core.errors import DataError
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.surface import Surface

__all__ = ["SectionView", "section_profile", "section_view"]

FloatArray = NDArray[np.float64]
Reading = Literal["bilinear", "nearest"]

_ON_PIXEL = 1e-8
"""Part of a pixel below which a point lies on the pixel's centre line."""

_MOST_SAMPLES = 10_000_000
"""Largest number of samples of a section; a line that needs more is a slip of the unit."""


@dataclass(frozen=True, slots=True, eq=False)
class SectionView:
    """A section as the screen shows it, with the numbers of its full resolution.

    Parameters
    ----------
    distance : ndarray, shape (n,), m
        From a, middle of the samples of each pixel column.
    low, high : ndarray, shape (n,), m
        Least and greatest height of each column; NaN where no sample of it is valid.
    length : float, m
        From a to b.
    pv : float, m
        Greatest less least valid height of all samples, nothing removed; NaN if none is valid.
    sq : float, m
        RMS of the valid samples about their mean; NaN if none is valid.
    share_valid : float, dimensionless
        Valid samples over all samples.
    n_samples : int
        Samples that were read.
    method : str
        ``"bilinear"`` or ``"nearest"``.
    unit : str
        Of distance and length: ``"m"``, or ``"px"`` for a map without lateral calibration.
    """

    distance: FloatArray
    low: FloatArray
    high: FloatArray
    length: float
    pv: float
    sq: float
    share_valid: float
    n_samples: int
    method: str
    unit: str


def section_view(
    surface: Surface,
    a: Sequence[float],
    b: Sequence[float],
    *,
    columns: int = 1000,
    method: Reading = "bilinear",
) -> SectionView:
    """Return a section for the screen.

    Parameters
    ----------
    surface : Surface
        The map, at full resolution.
    a, b : sequence of 2 floats, m
        Ends (x, y); also outside the map, where nothing is measured. Pixels from the first one
        where the map is not calibrated.
    columns : int, optional
        Pixel columns of the screen, >= 1. Fewer come back where there are fewer samples.
    method : {"bilinear", "nearest"}, optional
        How heights between pixels are read, see `section_profile`.

    Returns
    -------
    SectionView
        Extremes of each column, length, P-V, Sq, and the share of valid samples.

    Raises
    ------
    DataError
        If the ends are equal or not finite, or an option is wrong.

    Examples
    --------
    >>> surface = Surface([[0.0, 1.0, 2.0, 9.0]] * 2, dx=1.0, dy=1.0)
    >>> view = section_view(surface, (0.0, 0.5), (3.0, 0.5), columns=2)
    >>> view.low.tolist(), view.high.tolist(), view.pv
    ([0.0, 2.0], [1.0, 9.0], 9.0)
    """
    wide: Any = columns
    if isinstance(wide, bool) or not isinstance(wide, int | np.integer) or wide < 1:
        raise DataError(f"columns must be a whole number from 1, got {columns!r}")
    distance, z, length = _read(surface, a, b, method)
    n = z.size
    wide = min(n, int(wide))
    first = np.arange(wide) * n // wide
    last = np.append(first[1:], n) - 1
    valid = z[~np.isnan(z)]
    return SectionView(
        distance=_frozen((distance[first] + distance[last]) / 2.0),
        low=_frozen(np.fmin.reduceat(z, first)),
        high=_frozen(np.fmax.reduceat(z, first)),
        length=length,
        pv=float(np.ptp(valid)) if valid.size else math.nan,
        sq=float(valid.std()) if valid.size else math.nan,
        share_valid=valid.size / n,
        n_samples=n,
        method=method,
        unit="m" if _is_calibrated(surface) else "px",
    )


def section_profile(
    surface: Surface,
    a: Sequence[float],
    b: Sequence[float],
    *,
    method: Reading = "bilinear",
) -> Profile:
    """Return the heights of a map along the line from a to b.

    Parameters
    ----------
    surface : Surface
        The map.
    a, b : sequence of 2 floats, m
        Ends (x, y). Pixels from the first one where the map is not calibrated.
    method : {"bilinear", "nearest"}, optional
        ``"bilinear"``: from the four neighbours; NaN unless all of those that carry weight are
        valid, and beyond the centres of the outermost pixels. ``"nearest"``: the pixel in which
        the point lies, up to the rim.

    Returns
    -------
    Profile
        Over the distance from a: samples at even steps, no longer than the smaller lateral step,
        both ends included.

    Raises
    ------
    DataError
        If it is no Surface, the ends are equal, not finite or too far apart, or the method is
        unknown.

    Notes
    -----
    Bilinear reading averages: of uncorrelated noise on the pixels it leaves two thirds of the RMS
    on a slanting line, all of it along a row. `nearest` keeps it, and repeats pixels. Neither
    fills a gap.

    Examples
    --------
    >>> plane = Surface([[0.0, 1.0], [2.0, 3.0]], dx=1.0, dy=1.0)
    >>> section_profile(plane, (0, 0), (0.6, 0.8)).z.round(12).tolist()
    [0.0, 2.2]
    """
    distance, z, _ = _read(surface, a, b, method)
    unit = "m" if _is_calibrated(surface) else "px"
    ends = {f"from_{unit}": [float(v) for v in a], f"to_{unit}": [float(v) for v in b]}
    step = Step("section", {**ends, "reading": method})
    return Profile(distance, z, metadata=surface.metadata, history=(*surface.history, step))


def _read(
    surface: Surface, a: Sequence[float], b: Sequence[float], method: str
) -> tuple[FloatArray, FloatArray, float]:
    if not isinstance(surface, Surface):
        raise DataError(f"a section is cut through a Surface, got {type(surface).__name__}")
    (ax, ay), (bx, by) = _point(a, "a"), _point(b, "b")
    calibrated = _is_calibrated(surface)
    dx, dy = (surface.dx or 1.0, surface.dy or 1.0) if calibrated else (1.0, 1.0)
    x0, y0 = surface.origin if calibrated else (0.0, 0.0)
    length = math.hypot(bx - ax, by - ay)
    if not 0.0 < length < _MOST_SAMPLES * min(dx, dy):
        raise DataError(
            f"the section runs from ({ax:.9g}, {ay:.9g}) to ({bx:.9g}, {by:.9g}): its ends must "
            f"differ, by less than {_MOST_SAMPLES} pixels; are they in m?"
        )
    # a step that divides the length up to rounding must not be cut in two
    n = max(2, math.ceil(length / min(dx, dy) * (1.0 - 1e-9)) + 1)
    part = np.linspace(0.0, 1.0, n)
    column = (ax - x0) / dx + part * ((bx - ax) / dx)
    row = (ay - y0) / dy + part * ((by - ay) / dy)
    if method == "bilinear":
        z = _bilinear(surface.z, row, column)
    elif method == "nearest":
        z = _nearest(surface.z, row, column)
    else:
        raise DataError(f'method must be "bilinear" or "nearest", got {method!r}')
    return part * length, z, length


def _point(point: Sequence[float], name: str) -> tuple[float, float]:
    try:
        x, y = (float(v) for v in point)
    except (TypeError, ValueError):
        x = y = math.nan
    if not (math.isfinite(x) and math.isfinite(y)):
        raise DataError(f"{name} must be two finite numbers (x, y) in m, got {point!r}")
    return x, y


def _is_calibrated(surface: Surface) -> bool:
    return surface.dx is not None and surface.dy is not None


def _bilinear(z: FloatArray, row: FloatArray, column: FloatArray) -> FloatArray:
    """Return heights at fractional indices; a neighbour without weight need not be valid."""
    (i, v), (j, u) = _split(row), _split(column)
    total = np.zeros(row.size)
    for di, wi in ((0, 1.0 - v), (1, v)):
        for dj, wj in ((0, 1.0 - u), (1, u)):
            weight = wi * wj
            carries = weight > 0.0
            height = _at(z, i[carries] + di, j[carries] + dj)
            total[carries] += weight[carries] * height
    return total


def _split(index: FloatArray) -> tuple[NDArray[np.intp], FloatArray]:
    """Return whole and fractional part; what lies on a pixel within rounding lies on it."""
    whole = np.floor(index + _ON_PIXEL)
    part = index - whole
    return whole.astype(np.intp), np.where(part > _ON_PIXEL, part, 0.0)


def _nearest(z: FloatArray, row: FloatArray, column: FloatArray) -> FloatArray:
    near = [np.floor(v + 0.5 + _ON_PIXEL).astype(np.intp) for v in (row, column)]
    for k, (v, n) in enumerate(zip((row, column), z.shape, strict=True)):
        at_rim = np.abs(v - (n - 0.5)) <= _ON_PIXEL  # the far rim belongs to the last pixel
        near[k] = np.where(at_rim, n - 1, near[k])
    return _at(z, near[0], near[1])


def _at(z: FloatArray, row: NDArray[np.intp], column: NDArray[np.intp]) -> FloatArray:
    """Return heights at whole indices, NaN outside the map."""
    ny, nx = z.shape
    inside = (row >= 0) & (row < ny) & (column >= 0) & (column < nx)
    height = np.full(row.size, np.nan)
    height[inside] = z[row[inside], column[inside]]
    return height


def _frozen(array: FloatArray) -> FloatArray:
    array.setflags(write=False)
    return array
