"""Private to separation: noise of the runs in time, an autoregression that whitens every sample.

``sum_m a_m n_{i-m} = e_i`` with a_0 = 1 and white e of variance E_p; one model for the runs of one
sampling interval and probe. A row of the filter needs the p samples before it; the first rows of
a stretch have fewer and take the predictor of the lower order from the same recursion, so nothing
of a fast run is lost (separation-2, eq. 4). NaN marks samples that were not measured.

Sources: Burg's recursion, pooled over sequences; Levinson 1947.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from metrosep.core._arrays import BoolArray, FloatArray

MAD = 1.482602218505602
"""Standard deviation of a Gaussian over its median absolute deviation."""

MOST = 256
"""Highest order of the noise model, for cost alone: beyond it whitening a run takes longer than its
equations. A memory that is short beside a run leaves 0.2 of noise of 2 Hz and spreads a tone."""

WITNESS = 2.0
"""Degrees of freedom that the autoregression counts for the level of one octave: ln of the level
known to 1, so a factor of e."""

LEAST = 1e-8
"""Variance of white noise that every model holds, heights over their RMS: a ten-thousandth of the
error, which is what the basis leaves of it. A line without any noise would otherwise be predicted
without end, and the error with it."""

_BLOCK = 64
"""Rows that one banded product whitens."""


@dataclass(frozen=True, slots=True, eq=False)
class NoiseModel:
    """Predictors of every order up to p, with the variance each leaves."""

    filters: tuple[FloatArray, ...]  # of order 0 ... p: 1, a_1 ... a_q
    variances: FloatArray  # shape (p + 1,)
    time_step: float  # s
    degrees: float = math.inf  # of freedom that its density rests on: samples over order

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

    def density(self, frequency: FloatArray) -> FloatArray:
        """Return the power density at frequencies in Hz, but for a constant."""
        turns = np.outer(frequency * self.time_step, np.arange(self.order + 1))
        return np.asarray(
            self.variance / np.abs(np.exp(-2j * np.pi * turns) @ self.filters[-1]) ** 2
        )


def white(variance: float, time_step: float) -> NoiseModel:
    """Return noise without memory."""
    return NoiseModel((np.ones(1),), np.array([variance]), time_step)


def burg(sequences: Sequence[FloatArray], order: int) -> tuple[tuple[FloatArray, ...], FloatArray]:
    """Return filters and variances of order 0 ... `order`, pooled over sequences or columns of them."""
    sizes = np.array([len(s) for s in sequences])
    starts = np.cumsum(sizes) - sizes
    forward = np.concatenate([np.asarray(s, dtype=np.float64) for s in sequences])
    backward = forward.copy()
    variance = float(np.vdot(forward, forward)) / max(forward.size, 1)
    filters, variances = [np.ones(1)], [max(variance, 1e-300)]
    for i in range(order):
        # Row j of both is sample j + i + 1 of all; what a sequence would take from the one before is 0.
        f, b = forward[i + 1 :], backward[: len(backward) - i - 1]
        f[starts[(starts > 0) & (sizes > i)] - 1] = 0.0
        b[starts[starts > i] - i - 1] = 0.0
        top = float(np.vdot(f, b))
        bottom = float(np.vdot(f, f) + np.vdot(b, b))
        k = -2.0 * top / bottom if bottom > 0.0 else 0.0
        more = k * f
        f += k * b
        b += more
        last = np.append(filters[-1], 0.0)
        filters.append(last + k * last[::-1])
        variances.append(max(variances[-1] * (1.0 - k * k), 1e-300))
    return tuple(filters), np.array(variances)


def stretches(z: FloatArray) -> list[slice]:
    """Return the unbroken stretches of a record."""
    valid = ~np.isnan(z)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], valid.astype(np.int8), [0]])))
    return [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def fit_noise(draws: Sequence[FloatArray], *, time_step: float, most: int = MOST) -> NoiseModel:
    """Return the model of the highest order that the runs can feed; one column per draw.

    A criterion as AICc would choose the order by the prediction of the next sample. What matters
    here is the density at the few hertz at which geometry is seen: a low order leaves 0.3 of it
    where the noise is slow (four runs, 3 Hz), and a band that is too narrow; a high one costs 1 %.
    """
    draws = [
        d + math.sqrt(LEAST) * np.random.default_rng(1).standard_normal(d.shape) for d in draws
    ]
    pieces = [d[part] for d in draws for part in stretches(d[:, 0])]
    n = sum(p.shape[0] for p in pieces)
    longest = max((p.shape[0] for p in pieces), default=0)
    order = max(0, min(most, longest - 2, int(min(d.shape[0] for d in draws) / 5)))
    sequences = [p for p in pieces if p.shape[0] > 1]
    # A short stretch cannot feed a high order; it counts for the orders that it can feed.
    long = [p for p in sequences if p.shape[0] > order + 1]
    filters, variances = burg(long or sequences, order)
    # Each coefficient takes one of n degrees of freedom out of the innovations.
    taken = np.minimum(np.arange(order + 1) / max(n, 1), 0.5)
    return NoiseModel(filters, variances / (1.0 - taken), time_step, n / max(order, 1))


def level_spread(cycles: FloatArray, n_runs: int) -> FloatArray:
    """Return by how much variances grow because the level of the noise is learnt, octave by octave.

    `cycles` of a wave are in the octave about it sqrt(2) `cycles` degrees of freedom, less what the
    geometry takes. The autoregression is one witness more. With the scaled inverse chi-square of
    nu + 2 degrees of freedom the mean variance is (nu + 2)/nu times what was found.
    """
    degrees = math.sqrt(2.0) * cycles * max(n_runs - 1, 1) / n_runs
    return np.asarray(1.0 + WITNESS / np.maximum(degrees, 1e-9))


def exact_rows(
    tables: Sequence[FloatArray], model: NoiseModel, parts: Sequence[slice]
) -> FloatArray:
    """Return the whitened rows of unbroken stretches of tables side by side, unit variance (eq. 4)."""
    p = model.order
    widths = np.cumsum([0, *(t.shape[1] for t in tables)])
    out = np.empty((sum(part.stop - part.start for part in parts), widths[-1]))
    full = model.filters[-1][::-1] / math.sqrt(model.variance)
    band = np.zeros((_BLOCK, _BLOCK + p))
    for row in range(_BLOCK):
        band[row, row : row + p + 1] = full
    by_lag = _predictors(model)
    lower = np.zeros((p, p))
    for i in range(p):
        lower[i, : i + 1] = by_lag[i, i::-1]
    for table, left, right in zip(tables, widths[:-1], widths[1:], strict=True):
        rows, at = out[:, left:right], 0
        for part in parts:
            piece = table[part]
            n = piece.shape[0]
            head = min(p, n)
            rows[at : at + head] = lower[:head, :head] @ piece[:head]
            for first in range(p, n, _BLOCK):
                last = min(first + _BLOCK, n)
                size = last - first
                np.matmul(
                    band[:size, : size + p],
                    piece[first - p : last],
                    out=rows[at + first : at + last],
                )
            at += n
    return out


def _predictors(model: NoiseModel) -> FloatArray:
    """Return the filters of unit variance: row of the order, column of the lag."""
    out = np.zeros((model.order + 1, model.order + 1))
    for i, (own, variance) in enumerate(zip(model.filters, model.variances, strict=True)):
        out[i, : i + 1] = own / math.sqrt(variance)
    return out


class MissingSamples:
    """Samples of a record that are not known, each an unknown of its own: its whitened column.

    With E the whitening and U its columns at the unknown samples, G = U'U. What the known samples
    say of the unknown ones is ``-G^-1 U'E z`` with covariance G^-1; rows less ``U G^-1 U'`` of them
    are the equations of the known samples alone, whatever the noise: both exact. G has the band of
    the filter.
    """

    def __init__(
        self,
        unknown: BoolArray,
        model: NoiseModel,
        parts: Sequence[slice],
        *,
        weight: FloatArray | None = None,
    ) -> None:
        from scipy import linalg, sparse

        self.at = np.flatnonzero(unknown)
        starts, stops = (np.array([getattr(p, e) for p in parts]) for e in ("start", "stop"))
        part = np.searchsorted(starts, self.at, side="right") - 1
        lag = np.arange(model.order + 1)
        place = self.at[:, None] + lag  # of the row in the record
        seen = place < stops[part][:, None]
        order = np.minimum(place - starts[part][:, None], model.order)
        before = np.cumsum(stops - starts) - (stops - starts)  # rows of the parts before
        row = place + (before - starts)[part][:, None]
        column = np.broadcast_to(np.arange(self.at.size)[:, None], row.shape)
        shape = int(np.sum(stops - starts)), self.at.size
        values = _predictors(model)[order, np.broadcast_to(lag, order.shape)]
        if weight is not None:
            values = values * weight[np.where(seen, row, 0)]
        self.columns = sparse.csc_array((values[seen], (row[seen], column[seen])), shape=shape)
        gram = sparse.coo_array(self.columns.T @ self.columns)
        i, j = gram.coords
        width = int((j - i).max(initial=0))
        upper = j >= i
        band = np.zeros((width + 1, self.at.size))
        band[(width + i - j)[upper], j[upper]] = gram.data[upper]
        self._root = linalg.cholesky_banded(band, check_finite=False)

    def expected(self, rows: FloatArray) -> FloatArray:
        """Return what whitened rows, zero where unknown, say of the unknown samples."""
        from scipy.linalg import cho_solve_banded

        solved = cho_solve_banded((self._root, False), self.columns.T @ rows)
        return np.asarray(-solved)

    def take_out(self, rows: FloatArray) -> None:
        """Leave of whitened rows what does not depend on the unknown samples, in place."""
        rows += self.columns @ self.expected(rows)

    def drawn(self, rng: np.random.Generator, n: int) -> FloatArray:
        """Return draws of mean 0 with the covariance of the unknown samples, shape (unknown, n)."""
        from scipy.linalg import solve_banded

        free = rng.standard_normal((self.at.size, n))
        return np.asarray(solve_banded((0, len(self._root) - 1), self._root, free))
