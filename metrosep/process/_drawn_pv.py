"""Private: peak to valley of a map whose modes are drawn, exactly, without looking at every point.

A draw d is ``base + xi_d @ modes``. Its largest point is sought among those that can be largest for
some draw near d: with j the largest point at the centre c of a box of draws of half widths h, no
draw of the box prefers a point i with ``v_i - v_j + h @ |modes_i - modes_j| < 0``, v the values at
c. The box is halved and the points that are left are handed down. Nothing is approximated.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread

__all__ = ["drawn_pv", "square_root"]

_FEW_DRAWS = 6
"""So many draws are looked at in full: halving on costs more."""
_FEW_POINTS = 256
_BLOCK = 1 << 20
"""Values of draws times points worked on at once."""


def drawn_pv(base: FloatArray, modes: FloatArray, xi: FloatArray) -> FloatArray:
    """Return the P-V of ``base + xi @ modes`` for each draw."""
    if not modes.shape[0]:
        return np.full(xi.shape[0], float(np.ptp(base)))
    maps = np.concatenate([base[None, :], modes])
    maps -= maps.mean(axis=1, keepdims=True)
    sizes = np.abs(maps).max(axis=1)
    used = sizes > 0.0
    factors = np.column_stack([np.ones(xi.shape[0]), xi])[:, used] * sizes[used]
    maps = maps[used] / sizes[used, None]
    length = np.sqrt(np.square(factors).sum(axis=1))
    length[length == 0.0] = 1.0
    factors /= length[:, None]  # which point is largest depends on the direction only
    high, low = np.zeros(xi.shape[0]), np.zeros(xi.shape[0])
    everything = np.arange(xi.shape[0])
    if maps.shape[0]:
        with one_blas_thread():
            _largest(maps, factors, everything, high)
            _largest(-maps, factors, everything, low)
    out: FloatArray = (high + low) * length
    return out


def _largest(
    maps: FloatArray, factors: FloatArray, draws: NDArray[np.intp], out: FloatArray
) -> None:
    """Fill in the largest point of some draws; only points that can be it are handed down."""
    if draws.size <= _FEW_DRAWS or maps.shape[1] <= _FEW_POINTS:
        rows = max(1, _BLOCK // maps.shape[1])
        for first in range(0, draws.size, rows):
            some = draws[first : first + rows]
            out[some] = (factors[some] @ maps).max(axis=1)
        return
    low, high = factors[draws].min(axis=0), factors[draws].max(axis=0)
    centre, half = 0.5 * (low + high), 0.5 * (high - low)
    bound = centre @ maps
    best = int(np.argmax(bound))
    bound -= bound[best]
    for k, width in enumerate(half.tolist()):
        bound += width * np.abs(maps[k] - maps[k, best])
    maps = maps[:, bound >= 0.0]
    order = draws[np.argsort(factors[draws, int(np.argmax(half))], kind="stable")]
    middle = order.size // 2
    _largest(maps, factors, order[:middle], out)
    _largest(maps, factors, order[middle:], out)


def square_root(cov: FloatArray) -> FloatArray:
    """Return L with ``L L^T = cov`` for a covariance that may be singular."""
    size = np.sqrt(np.diag(cov))
    scale = np.where(size > 0.0, size, 1.0)
    values, vectors = np.linalg.eigh(cov / np.outer(scale, scale))
    kept = values > 1e-12 * max(float(values.max()), 0.0)
    out: FloatArray = (scale[:, None] * vectors[:, kept]) * np.sqrt(values[kept])
    return out
