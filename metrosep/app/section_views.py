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

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.surface import Surface

__all__ = ["SectionView", "section_profile", "section_view"]

Reading = Literal["lanczos", "bilinear", "nearest"]

_ON_PIXEL = 1e-8
"""Part of a pixel below which a point lies on the pixel's centre line."""

_REACH = np.arange(-3, 5)
"""Neighbours on each axis of a point between pixel 0 and pixel 1: eight."""

_AT_ONCE = 20_000
"""Samples whose neighbours are held at a time: 10 MB."""

_MOST_SAMPLES = 10_000_000
"""Largest number of samples of a section; a line that needs more is a slip of the unit."""


@dataclass(frozen=True, slots=True, eq=False)
class SectionView:
    """A section as the screen shows it, with the numbers of its full resolution."""

    distance: FloatArray  # shape (n,), m: from a, middle of the samples of each pixel column
    # shape (n,), m: least and greatest height of each column; NaN where no sample of it is valid
    low: FloatArray
    high: FloatArray
    length: float  # m: from a to b
    # m: greatest less least valid height of all samples, nothing removed; NaN if none is valid
    pv: float
    sq: float  # m: RMS of the valid samples about their mean; NaN if none is valid
    share_valid: float  # dimensionless: valid samples over all samples
    n_samples: int  # samples that were read
    method: str  # ``"lanczos"``, ``"bilinear"`` or ``"nearest"``
    unit: str  # of distance and length: ``"m"``, or ``"px"`` for a map without lateral calibration


def section_view(
    surface: Surface,
    a: Sequence[float],
    b: Sequence[float],
    *,
    columns: int = 1000,
    method: Reading = "lanczos",
) -> SectionView:
    """Return a section for the screen.

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
    distance, z, length, _ = _read(surface, a, b, method)
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
    method: Reading = "lanczos",
) -> Profile:
    """Return the heights of a map along the line from a to b.

    Notes
    -----
    On a slanting line ``"lanczos"`` (a plane with twist through the 64 pixels, and what it leaves by
    a windowed sinc) keeps the RMS of waves from 3 pixels on within 1 %. ``"bilinear"`` averages, and
    keeps 84 % at 4.3 pixels, two thirds of noise: prefer it on steps, where the other overshoots by
    a tenth of their height. ``"nearest"`` keeps the RMS, and repeats pixels. None
    fills a gap. Along pixel centres each gives the pixels themselves. The history says which
    share was read bilinearly.

    Examples
    --------
    >>> plane = Surface([[0.0, 1.0], [2.0, 3.0]], dx=1.0, dy=1.0)
    >>> section_profile(plane, (0, 0), (0.6, 0.8)).z.round(12).tolist()
    [0.0, 2.2]
    """
    distance, z, _, share = _read(surface, a, b, method)
    unit = "m" if _is_calibrated(surface) else "px"
    ends = {f"from_{unit}": [float(v) for v in a], f"to_{unit}": [float(v) for v in b]}
    step = Step("section", {**ends, "reading": method, "bilinear_share": share})
    return Profile(distance, z, metadata=surface.metadata, history=(*surface.history, step))


def _read(
    surface: Surface, a: Sequence[float], b: Sequence[float], method: str
) -> tuple[FloatArray, FloatArray, float, float]:
    """Return distances, heights, length, and the share of heights that were read bilinearly."""
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
    share = 1.0 if method == "bilinear" else 0.0
    if method in ("lanczos", "bilinear"):
        z = _bilinear(surface.z, row, column)
        if method == "lanczos":
            share = _refined(surface.z, row, column, z)
    elif method == "nearest":
        z = _nearest(surface.z, row, column)
    else:
        raise DataError(f'method must be "lanczos", "bilinear" or "nearest", got {method!r}')
    return part * length, z, length, share


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


def _refined(z: FloatArray, row: FloatArray, column: FloatArray, heights: FloatArray) -> float:
    """Put better heights in place of bilinear ones; return the share that had no 64 neighbours."""
    (i, v), (j, u) = _split(row), _split(column)
    between = ~np.isnan(heights) & ((u > 0.0) | (v > 0.0))
    low, high = _REACH[0], _REACH[-1]
    inside = (i + low >= 0) & (i + high < z.shape[0]) & (j + low >= 0) & (j + high < z.shape[1])
    which = np.flatnonzero(between & inside)
    done = 0
    for k in np.array_split(which, max(1, -(-which.size // _AT_ONCE))):
        patch = z[i[k, None, None] + _REACH[:, None], j[k, None, None] + _REACH]
        whole = ~np.isnan(patch).any(axis=(1, 2))
        some, patch = k[whole], patch[whole]
        heights[some] = _lanczos(patch, v[some], u[some])
        done += some.size
    n = int(np.count_nonzero(between))
    return (n - done) / n if n else 0.0


def _lanczos(patch: FloatArray, v: FloatArray, u: FloatArray) -> FloatArray:
    """Return heights within 8 x 8 pixels: of their fitted plane, and by Lanczos-4 of what it leaves."""
    # p = m + r y + c x + s x y about the middle; weights a, b with sum 1 of rows and columns:
    # z(v, u) = sum a b (z - p) + p(v, u), and m drops out
    t = _REACH.astype(np.float64) - 0.5
    y, x = v - 0.5, u - 0.5
    a, b = (w / w.sum(axis=1, keepdims=True) for w in (_sinc4(y, t), _sinc4(x, t)))
    squares = float(t @ t)
    r = np.einsum("nij,i->n", patch, t) / (t.size * squares)
    c = np.einsum("nij,j->n", patch, t) / (t.size * squares)
    s = np.einsum("nij,i,j->n", patch, t, t) / squares**2
    weighted = np.einsum("nij,ni,nj->n", patch, a, b)
    ya, xb = a @ t, b @ t
    return np.asarray(weighted + r * (y - ya) + c * (x - xb) + s * (y * x - ya * xb))


def _sinc4(place: FloatArray, t: FloatArray) -> FloatArray:
    d = place[:, None] - t
    return np.asarray(np.sinc(d) * np.sinc(d / 4.0))


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
