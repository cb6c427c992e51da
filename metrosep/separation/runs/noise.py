"""Private to separation: noise of the runs in time, an autoregression that whitens every sample.

``sum_m a_m n_{i-m} = e_i`` with a_0 = 1 and white e of variance E_p; one model for the runs of one
sampling interval and probe. A row of the filter needs the p samples before it; the first rows of
a stretch have fewer and take the predictor of the lower order from the same recursion, so nothing
of a fast run is lost (separation-2, eq. 4). NaN marks samples that were not measured.

Sources: Burg's recursion, pooled over sequences; Levinson 1947; AICc of Hurvich and Tsai 1989.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from metrosep.core._arrays import FloatArray

__all__ = ["LEAST", "MAD", "NoiseModel", "burg", "exact_rows", "fit_noise"]

MAD = 1.482602218505602
"""Standard deviation of a Gaussian over its median absolute deviation."""

_MOST = 48
"""Highest order of the noise model."""

LEAST = 1e-8
"""Variance of white noise that every model holds, heights over their RMS: a ten-thousandth of the
error, which is what the basis leaves of it. A line without any noise would otherwise be predicted
without end, and the error with it."""

_BLOCK = 128
"""Rows that one banded product whitens."""


@dataclass(frozen=True, slots=True, eq=False)
class NoiseModel:
    """Predictors of every order up to p, with the variance each leaves."""

    filters: tuple[FloatArray, ...]  # of order 0 ... p: 1, a_1 ... a_q
    variances: FloatArray  # shape (p + 1,)
    time_step: float  # s

    @property
    def order(self) -> int:
        """Order p of the model."""
        return len(self.filters) - 1

    @property
    def coefficients(self) -> FloatArray:
        """Coefficients of the prediction of a sample from the p before it."""
        return np.asarray(-self.filters[-1][1:])

    @property
    def variance(self) -> float:
        """Variance of the innovation."""
        return float(self.variances[-1])


def white(variance: float, time_step: float) -> NoiseModel:
    """Return noise without memory."""
    return NoiseModel((np.ones(1),), np.array([variance]), time_step)


def burg(sequences: Sequence[FloatArray], order: int) -> tuple[tuple[FloatArray, ...], FloatArray]:
    """Return filters and variances of order 0 ... `order`, pooled over unbroken sequences."""
    forward = [np.asarray(s, dtype=np.float64) for s in sequences]
    backward = list(forward)
    size = sum(s.size for s in sequences)
    variance = sum(float(s @ s) for s in sequences) / max(size, 1)
    filters, variances = [np.ones(1)], [max(variance, 1e-300)]
    for _ in range(order):
        f = [s[1:] for s in forward]
        b = [s[:-1] for s in backward]
        top = sum(float(p @ q) for p, q in zip(f, b, strict=True))
        bottom = sum(float(p @ p + q @ q) for p, q in zip(f, b, strict=True))
        k = -2.0 * top / bottom if bottom > 0.0 else 0.0
        forward = [p + k * q for p, q in zip(f, b, strict=True)]
        backward = [q + k * p for p, q in zip(f, b, strict=True)]
        last = np.append(filters[-1], 0.0)
        filters.append(last + k * last[::-1])
        variances.append(max(variances[-1] * (1.0 - k * k), 1e-300))
    return tuple(filters), np.array(variances)


def stretches(z: FloatArray) -> list[slice]:
    """Return the unbroken stretches of a record."""
    valid = ~np.isnan(z)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], valid.astype(np.int8), [0]])))
    return [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def fit_noise(
    draws: Sequence[FloatArray], *, time_step: float, most: int = _MOST, n_share: float = 1.0
) -> NoiseModel:
    """Return the model of least AICc; `draws` has one row per sample and one column per draw."""
    draws = [
        d + math.sqrt(LEAST) * np.random.default_rng(1).standard_normal(d.shape) for d in draws
    ]
    pieces = [d[part] for d in draws for part in stretches(d[:, 0])]
    n = sum(p.shape[0] for p in pieces)
    longest = max((p.shape[0] for p in pieces), default=0)
    most = max(0, min(most, longest - 2, int(min(d.shape[0] for d in draws) / 5)))
    sequences = [np.ascontiguousarray(p[:, s]) for p in pieces for s in range(p.shape[1])]
    sequences = [s for s in sequences if s.size > 1]
    # A short stretch cannot feed a high order; it counts for the orders that it can feed.
    filters, variances = burg([s for s in sequences if s.size > most + 1] or sequences, most)
    orders = np.arange(variances.size) + 1.0
    count = max(n * n_share, 8.0)
    room = count - orders - 1.0
    criterion = count * np.log(variances) + 2.0 * orders * (1.0 + (orders + 1.0) / room)
    criterion[room < 2.0] = math.inf
    best = int(np.argmin(criterion)) if np.isfinite(criterion).any() else 0
    return NoiseModel(filters[: best + 1], variances[: best + 1], time_step)


def exact_rows(table: FloatArray, model: NoiseModel, parts: Sequence[slice]) -> FloatArray:
    """Return the whitened rows of unbroken stretches of a table, unit variance (eq. 4)."""
    p = model.order
    out = np.empty((sum(part.stop - part.start for part in parts), table.shape[1]))
    at = 0
    full = model.filters[-1][::-1] / math.sqrt(model.variance)
    band = np.zeros((_BLOCK, _BLOCK + p))
    for row in range(_BLOCK):
        band[row, row : row + p + 1] = full
    for part in parts:
        piece = table[part]
        n = piece.shape[0]
        head = min(p, n)
        lower = np.zeros((head, head))
        for i in range(head):
            lower[i, : i + 1] = model.filters[i][::-1] / math.sqrt(model.variances[i])
        out[at : at + head] = lower @ piece[:head]
        for first in range(p, n, _BLOCK):
            size = min(_BLOCK, n - first)
            np.matmul(
                band[:size, : size + p],
                piece[first - p : first + size],
                out=out[at + first : at + first + size],
            )
        at += n
    return out
