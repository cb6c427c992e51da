"""Monte Carlo of error terms: Sq of each draw from the Gram matrix, P-V from its map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import TooFewSamplesError

__all__ = ["MonteCarloResult", "correlated_draws", "drawn_maps"]


_DRAWS, _POINTS = 256, 1024
"""Of a block: its products stay in the cache until their extremes are taken."""


@dataclass(frozen=True, slots=True, eq=False)
class MonteCarloResult:
    """Drawn errors and what they do.

    Parameters
    ----------
    amounts : ndarray, shape (n, m)
        Drawn amounts of the terms.
    sq : ndarray, shape (n,), m
        Sq of each draw after alignment.
    pv : ndarray, shape (n,) or None, m
        P-V of each draw, if maps were made.
    mean_square, u_mean_square : float, m^2
        Mean of Sq^2 and its standard uncertainty from the number of draws.
    expected : float, m^2
        ``tr(G S) + mu' G mu``.
    """

    amounts: FloatArray
    sq: FloatArray
    pv: FloatArray | None
    mean_square: float
    u_mean_square: float
    expected: float

    def quantile(self, p: float) -> float:
        """Return the Sq that a share p of the parts stays below.

        Parameters
        ----------
        p : float
            Between 0 and 1.

        Returns
        -------
        float
            In m.
        """
        return float(np.quantile(self.sq, p))


def correlated_draws(n: int, covariance: FloatArray, mean: FloatArray, seed: int) -> FloatArray:
    """Return normal draws with a covariance that may be singular, shape (n, m)."""
    size = np.sqrt(np.diag(covariance))
    safe = np.where(size > 0.0, size, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(safe, safe))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    unit = np.random.default_rng(seed).standard_normal((n, mean.size))
    return np.asarray(mean + (unit @ root.T) * size)


def drawn_maps(
    gram: FloatArray, amounts: FloatArray, expected: float, maps: FloatArray | None
) -> MonteCarloResult:
    """Return Sq of each draw, and P-V if unit maps (n_points, m) are given."""
    n = amounts.shape[0]
    if n < 2:
        raise TooFewSamplesError(f"a Monte Carlo needs at least 2 draws, got {n}")
    square = np.maximum(np.sum((amounts @ gram) * amounts, axis=1), 0.0)
    sq = np.sqrt(square)
    pv = None if maps is None else peak_to_valleys(maps, amounts)
    for array in (amounts, sq, pv):
        if array is not None:
            array.setflags(write=False)
    spread = float(square.std(ddof=1) / np.sqrt(n))
    return MonteCarloResult(amounts, sq, pv, float(square.mean()), spread, expected)


def peak_to_valleys(maps: FloatArray, amounts: FloatArray) -> FloatArray:
    """Return the P-V of every ``maps @ amounts``; blocked, one thread.

    In single precision, each map scaled to its amounts: 1e-6 of the P-V, in half the time. The
    mean square needs no maps: the Gram matrix holds it to rounding.
    """
    size = np.abs(amounts).max(axis=0)
    unit = np.divide(amounts, size, out=np.zeros_like(amounts), where=size > 0.0)
    scaled = maps * size
    top = float(np.abs(scaled).max(initial=0.0)) or 1.0
    turned = np.ascontiguousarray((scaled / top).T, dtype=np.float32)
    factors = unit.astype(np.float32)
    n = amounts.shape[0]
    low, high = np.full(n, np.inf), np.full(n, -np.inf)
    block = np.empty((_DRAWS, _POINTS), dtype=np.float32)
    with one_blas_thread():
        for i in range(0, n, _DRAWS):
            q = factors[i : i + _DRAWS]
            rows = slice(i, i + q.shape[0])
            for j in range(0, turned.shape[1], _POINTS):
                points = turned[:, j : j + _POINTS]
                drawn = block[: q.shape[0], : points.shape[1]]
                np.matmul(q, points, out=drawn)
                np.minimum(low[rows], drawn.min(axis=1), out=low[rows])
                np.maximum(high[rows], drawn.max(axis=1), out=high[rows])
    result: FloatArray = (high - low) * top
    return result
