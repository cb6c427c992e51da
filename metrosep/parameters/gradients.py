"""Hybrid parameters of a map: root mean square gradient Sdq and developed area ratio Sdr.

Both come from the same two slopes at each pixel. A slope is taken from the widest symmetric
stencil whose pixels are all valid: seven points, else five, else three; at an edge or beside a
hole it is one-sided with three points, else two. All but the last are exact for parabolas. A
pixel that was not measured, or has no valid neighbour in x and in y, has no slope and is left out,
so a hole adds no slope of its own.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray, frozen_float
from metrosep.core.errors import InvalidSamplesError, TooFewSamplesError

__all__ = ["GradientStatistics", "gradient_statistics", "surface_slopes"]


_REACH = 3
"""Half-width of the widest stencil, in pixels."""

_BLOCK = 32_768
"""Pixels a block, so that the slopes of a block stay in the cache."""

_LADDER: tuple[tuple[tuple[int, float], ...], ...] = (
    ((2, -1 / 12), (1, 8 / 12), (-1, -8 / 12), (-2, 1 / 12)),
    ((1, 0.5), (-1, -0.5)),
    ((0, -1.5), (1, 2.0), (2, -0.5)),
    ((0, 1.5), (-1, -2.0), (-2, 0.5)),
    ((0, -1.0), (1, 1.0)),
    ((0, 1.0), (-1, -1.0)),
)
"""Stencils (offset, weight) in the order of preference where seven points are not there."""


@dataclass(frozen=True, slots=True)
class GradientStatistics:
    """Mean slopes of a map."""

    n_used: int  # measured pixels that have a slope in x and in y
    Sdq: float  # root mean square gradient, dimensionless (tangent of an angle)
    Sdr: float  # developed area over projected area, less one; a ratio, not per cent


def gradient_statistics(z: ArrayLike, dx: float, dy: float) -> GradientStatistics:
    """Return the root mean square gradient and the developed area ratio.

    Notes
    -----
    Sdq^2 = mean(zx^2 + zy^2), Sdr = mean(sqrt(1 + zx^2 + zy^2) - 1) over the pixels that have
    both slopes. Each pixel stands for the area dx dy around it. The standard leaves the numerical
    derivative open; see the page on Sdq for what other choices give.

    References
    ----------
    .. [1] ISO 25178-2:2021, hybrid parameters (clause 4.4; number recalled, not checked).

    Examples
    --------
    >>> g = gradient_statistics([[0.0, 3e-6], [4e-6, 7e-6]], dx=1e-6, dy=1e-6)
    >>> f"{g.Sdq:.3f}"
    '5.000'
    """
    count, squares, excess = 0, [], []
    for slope_x, slope_y in _slope_blocks(_checked(z, dx, dy), dx, dy):
        s2 = slope_x * slope_x
        s2 += slope_y * slope_y
        used = s2 == s2
        if not used.all():
            s2 = s2[used]
        count += s2.size
        squares.append(float(np.add.reduce(s2, axis=None)))
        # sqrt(1 + s) - 1 without cancellation for slopes of 1e-9.
        s2 /= 1.0 + np.sqrt(1.0 + s2)
        excess.append(float(np.add.reduce(s2, axis=None)))
    if count == 0:
        raise InvalidSamplesError(
            "no pixel has a valid neighbour in x and in y: slopes cannot be formed; the map is too "
            "sparse for Sdq and Sdr"
        )
    return GradientStatistics(
        count, math.sqrt(math.fsum(squares) / count), math.fsum(excess) / count
    )


def surface_slopes(z: ArrayLike, dx: float, dy: float) -> tuple[FloatArray, FloatArray]:
    """Return the slopes dz/dx and dz/dy at the pixels."""
    blocks = list(_slope_blocks(_checked(z, dx, dy), dx, dy))
    return np.concatenate([b[0] for b in blocks]), np.concatenate([b[1] for b in blocks])


def _checked(z: ArrayLike, dx: float, dy: float) -> FloatArray:
    for name, step in (("dx", dx), ("dy", dy)):
        if not (math.isfinite(step) and step > 0.0):
            raise InvalidSamplesError(f"{name} is {step} m; a lateral step must be positive")
    heights = frozen_float(z, name="z", ndim=2)
    if min(heights.shape) < 2:
        raise TooFewSamplesError(
            f"a slope needs at least 2 x 2 pixels, got {heights.shape[0]} x {heights.shape[1]}"
        )
    return heights


def _slope_blocks(z: FloatArray, dx: float, dy: float) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Give the slopes of some rows at a time; beyond the map stands NaN, like a hole."""
    n_y, n_x = z.shape
    rows = max(1, _BLOCK // n_x)
    for start in range(0, n_y, rows):
        stop = min(start + rows, n_y)
        first, last = max(start - _REACH, 0), min(stop + _REACH, n_y)
        tile = np.full((stop - start + 2 * _REACH, n_x + 2 * _REACH), np.nan)
        row = first - (start - _REACH)
        tile[row : row + last - first, _REACH:-_REACH] = z[first:last]
        yield _slope(tile, 1, dx), _slope(tile, 0, dy)


def _slope(tile: FloatArray, axis: int, step: float) -> FloatArray:
    """Return the slope along an axis at the inner pixels of a padded tile."""
    inner = slice(_REACH, -_REACH)

    def shifted(offset: int) -> FloatArray:
        along = slice(_REACH + offset, tile.shape[axis] - _REACH + offset)
        part: FloatArray = tile[(along, inner) if axis == 0 else (inner, along)]
        return part

    slope = shifted(1) - shifted(-1)
    slope *= 45.0
    wider = shifted(2) - shifted(-2)
    wider *= 9.0
    slope -= wider
    slope += shifted(3)
    slope -= shifted(-3)
    slope /= 60.0
    _fill_from_ladder(slope, tile, tile.strides[axis] // tile.itemsize)
    slope /= step
    return slope


def _fill_from_ladder(slope: FloatArray, tile: FloatArray, stride: int) -> None:
    """Replace, in place, slopes that seven points could not give."""
    width = tile.shape[1]
    inner = slice(_REACH, -_REACH)
    # Seven points do not use the pixel itself, which may be the one that was not measured.
    np.copyto(slope, np.nan, where=np.isnan(tile[inner, inner]))
    missing_y, missing_x = np.nonzero(np.isnan(slope))
    index = (missing_y + _REACH) * width + missing_x + _REACH
    heights = tile.reshape(-1)
    measured = ~np.isnan(heights[index])
    index, missing_y, missing_x = index[measured], missing_y[measured], missing_x[measured]
    for stencil in _LADDER:
        if index.size == 0:
            return
        value = np.zeros(index.size)
        for offset, weight in stencil:
            value += weight * heights[index + offset * stride]
        found = ~np.isnan(value)
        slope[missing_y[found], missing_x[found]] = value[found]
        index, missing_y, missing_x = index[~found], missing_y[~found], missing_x[~found]
