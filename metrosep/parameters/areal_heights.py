"""Height parameters of a map: Sa, Sq, Ssk, Sku, Sp, Sv, Sz about the mean of the valid pixels.

The heights are read twice, block by block in the cache: once for the mean and the extremes, once
for the moments. Powers are products (``d**3`` costs eighteen times as much), sums of a block are
dot products, and the sums of the blocks are added exactly. What the mean lost to rounding is taken
off the second time, so an offset of 10^6 heights costs no digit that is in the data.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray, frozen_float
from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import InvalidSamplesError
from metrosep.core.numbers import without_rounding
from metrosep.core.surface import Surface
from metrosep.parameters.table import LARGEST, check_range

_LINE = 64
"""Bytes of a line of the cache."""

_BLOCK = 32_768
"""Heights a block: 256 KiB, so that block and scratch stay in the second-level cache."""

_MEAN_REST = 1e-13
"""Rest of the mean over Sa above which the heights are centred once more."""


@dataclass(frozen=True, slots=True)
class HeightStatistics:
    """Moments and extremes of heights about their mean."""

    n_valid: int  # pixels that were measured
    mean: float  # m: of the heights as given
    Sa: float  # m: mean absolute and root mean square height
    Sq: float
    # skewness and kurtosis (3 for Gaussian heights, not the excess); None where Sq is zero
    Ssk: float | None
    Sku: float | None
    # m: highest peak and deepest pit, both counted positive from the mean, and their sum
    Sp: float
    Sv: float
    Sz: float


def height_statistics(z: ArrayLike) -> HeightStatistics:
    """Return the height parameters of the valid pixels about their mean.

    With d = z - mean(z) over the n valid pixels: Sa = sum|d| / n, Sq^2 = sum d^2 / n,
    Ssk = sum d^3 / (n Sq^3), Sku = sum d^4 / (n Sq^4), Sp = max d, Sv = -min d, Sz = Sp + Sv.
    Every pixel has the same weight. NaN is omitted. Nothing but the mean is removed.

    Source: ISO 25178-2:2021, height parameters (clause 4.2; number recalled, not checked).

    Examples
    --------
    >>> s = height_statistics([[1e-9, -1e-9], [np.nan, 3e-9]])
    >>> s.n_valid, f"{s.mean:.3g} {s.Sz:.3g}"
    (3, '1e-09 4e-09')
    """
    heights = np.ascontiguousarray(_as_map(z)).reshape(-1)
    with np.errstate(invalid="ignore", over="ignore"):
        total = float(np.add.reduce(heights))
        complete = not math.isnan(total)
        n = heights.size if complete else int(np.count_nonzero(heights == heights))
        if n == 0:
            raise InvalidSamplesError(
                f"none of the {heights.size} pixels is valid: there is nothing to evaluate; check "
                "the mask or the measurement"
            )
        with one_blas_thread():
            if not complete:
                total = _sum_of_valid(heights)
            centre = total / n
            sums = _central_sums(heights, complete, centre, 0.0)
            rest = sums.first / n
            if abs(rest) > _MEAN_REST * sums.absolute / n:
                sums = _central_sums(heights, complete, centre, rest)
    check_range(sums.low, sums.high)
    return _statistics(sums, n, centre, rest)


def _as_map(z: ArrayLike) -> FloatArray:
    """Return a map of heights; one that is already frozen is neither copied nor scanned."""
    if isinstance(z, np.ndarray) and z.dtype == np.float64 and z.ndim == 2 and z.size:
        return z
    return frozen_float(z, name="z", ndim=2)


@dataclass(frozen=True, slots=True)
class _Sums:
    """Sums over d, the heights less their mean, and the extremes of the heights."""

    first: float
    absolute: float
    second: float
    third: float
    fourth: float
    low: float
    high: float


def _statistics(sums: _Sums, n: int, centre: float, rest: float) -> HeightStatistics:
    """Return the parameters from the sums; a map that is constant within rounding has exact zeros."""
    low, high = sums.low, sums.high
    if without_rounding(high - low, max(abs(low), abs(high))) == 0.0:
        return HeightStatistics(n, low, 0.0, 0.0, None, None, 0.0, 0.0, 0.0)
    root = math.sqrt(sums.second / n)
    kurtosis = sums.fourth / n / root**4
    return HeightStatistics(
        n_valid=n,
        mean=centre + rest,
        Sa=sums.absolute / n,
        Sq=root,
        # the sum of |d|^3 is at most n Sq^3 Sku^(3/4)
        Ssk=without_rounding(sums.third / n / root**3, kurtosis**0.75),
        Sku=kurtosis,
        Sp=(high - centre) - rest,
        Sv=(centre - low) + rest,
        Sz=high - low,
    )


def _sum_of_valid(heights: FloatArray) -> float:
    """Return the sum of the heights that were measured."""
    scratch = np.empty(_BLOCK)
    parts: list[float] = []
    for start in range(0, heights.size, _BLOCK):
        block = heights[start : start + _BLOCK]
        measured = scratch[: block.size]
        np.copyto(measured, block)
        np.copyto(measured, 0.0, where=block != block)
        parts.append(float(np.add.reduce(measured)))
    try:
        return math.fsum(parts)
    except (OverflowError, ValueError):
        return math.inf  # heights beyond any range, which are refused where they are seen


def _aligned(n: int) -> FloatArray:
    """Return an array at a full line of the cache: BLAS sums in another order elsewhere.

    So the same map gives the same last digit, wherever its memory happens to lie.
    """
    room = np.empty(n + _LINE // 8)
    first = (-room.ctypes.data % _LINE) // 8
    return room[first : first + n]


def _central_sums(heights: FloatArray, complete: bool, centre: float, rest: float) -> _Sums:
    """Return the sums over d = (z - centre) - rest, and the extremes of z.

    A pixel that is not measured is a zero in the scratch array: it adds nothing to any sum.
    """
    from scipy.linalg.blas import dasum

    scratch, squares = _aligned(_BLOCK), _aligned(_BLOCK)
    smallest, largest = (np.minimum, np.maximum) if complete else (np.fmin, np.fmax)
    parts: list[tuple[float, float, float, float, float]] = []
    low, high = math.inf, -math.inf
    for start in range(0, heights.size, _BLOCK):
        block = heights[start : start + _BLOCK]
        d, d2 = scratch[: block.size], squares[: block.size]
        np.subtract(block, centre, out=d)
        if rest:
            d -= rest
        if not complete:
            np.copyto(d, 0.0, where=d != d)
        np.multiply(d, d, out=d2)
        first, second = float(np.add.reduce(d)), float(d.dot(d))
        third, fourth = float(d.dot(d2)), float(d2.dot(d2))
        parts.append((first, float(dasum(d)), second, third, fourth))
        lowest, highest = float(smallest.reduce(block)), float(largest.reduce(block))
        low = min(low, lowest)
        high = max(high, highest)
        if max(-low, high) > LARGEST:
            check_range(low, high)
    totals = [math.fsum(column) for column in zip(*parts, strict=True)]
    return _Sums(totals[0], totals[1], totals[2], totals[3], totals[4], low, high)


def flat_within_rounding(surface: Surface) -> Surface:
    """Return a map of zeros where all heights are the same within rounding: its texture would be digits."""
    low, high = (float(of.reduce(surface.z, axis=None)) for of in (np.fmin, np.fmax))
    if without_rounding(high - low, max(abs(low), abs(high))) != 0.0:
        return surface
    z = np.where(np.isnan(surface.z), np.nan, 0.0)
    return Surface(
        z,
        surface.dx,
        surface.dy,
        origin=surface.origin,
        metadata=surface.metadata,
        history=surface.history,
    )
