"""Private: generalised least squares of readings taken one after another, with drift learnt from them.

Covariance of one stream of readings at indices i (gaps where readings were left out), times s^2:

    V = I + a^2 K,    K_ij = exp(-|i - j| / tau)

K is that of a Markov process, so its inverse Q is tridiagonal and ``V^-1 = (Q + a^2 I)^-1 Q``:
everything is linear in the number of readings. (a, tau) are common to all sets and maximise the
restricted likelihood (machines.md, eq. 17); s is that of each group of streams (a set, or one channel of it).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray

_WHITE = (0.0, 10.0)
_GRID_A = (0.5, 1.5, 4.0, 10.0)
_GRID_TAU = (10.0, 30.0, 90.0)
_ALL_A = tuple(np.geomspace(0.1, 60.0, 9).tolist())
_ALL_TAU = tuple(np.geomspace(2.0, 2000.0, 9).tolist())
_FEWEST = 30
"""Readings of a set below which its correlation cannot be judged."""
_WORTH = 3.0
"""By how much twice the log likelihood must rise before drift is taken for real (two parameters)."""
_ROUNDS = 3
_NODES = ((-math.sqrt(3.0), 1.0 / 6.0), (0.0, 2.0 / 3.0), (math.sqrt(3.0), 1.0 / 6.0))
"""Of Gauss-Hermite quadrature for a normal distribution."""
_ASIDE, _WIDEST = 0.3, 2.0
"""Of log a and log tau: steps of a second difference, and the standard deviation above which nothing is known."""
_FAR = 3.0
"""Standard deviations within which the nodes stand for all drifts."""
_NOTHING = 1e-18  # m or rad: noise of readings that are all zero
_ROUNDING = 1e-14
LARGEST_DRIFT = 60.0
"""Times the white noise, that is looked for: a larger one is what the model lacks."""
_LIMITS = ((0.1, LARGEST_DRIFT), (2.0, 2000.0))


@dataclass(frozen=True, slots=True, eq=False)
class Stream:
    """One series of readings in order of time: rows of the design, their index in time, their set.

    Streams of one group have one scale of noise; a set is one group unless another is given.
    """

    rows: NDArray[np.intp]
    index: FloatArray
    which: int
    group: int = -1

    def __post_init__(self) -> None:
        if self.group < 0:
            object.__setattr__(self, "group", self.which)


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """What generalised least squares found."""

    beta: FloatArray
    cov: FloatArray
    a: float
    tau: float
    scales: FloatArray  # s of each group
    judged: bool  # whether any series was long enough to judge the correlation

    @property
    def white(self) -> bool:
        """Whether no drift was found."""
        return self.a == 0.0


class Gls:
    """The linear problem ``y = X b + noise``, for any drift (a, tau) and scale of each group."""

    def __init__(
        self,
        X: FloatArray,
        y: FloatArray,
        streams: Sequence[Stream],
        stated: Sequence[float | None],
    ) -> None:
        self.X, self.y = X, y
        self.streams = [s for s in streams if s.rows.size]
        self.stated = list(stated)
        self.rows_of_group = [
            np.concatenate(
                [np.zeros(0, dtype=int), *(s.rows for s in self.streams if s.group == k)]
            )
            for k in range(len(self.stated))
        ]
        # the sum of squares is a difference of large numbers: below this it is their rounding
        self.floor = max(_ROUNDING * float(np.mean(y**2)), _NOTHING**2)
        self.judged = any(s.rows.size >= _FEWEST for s in self.streams)

    def best(self) -> Fit:
        """Return the fit with the drift that the readings show."""
        white = self._at(*_WHITE)
        if not self.judged or np.all(white[3] ** 2 <= 4.0 * self.floor):
            return self._fit(white, 0.0, 0.0)
        found = {(a, tau): self._at(a, tau)[0] for a in _GRID_A for tau in _GRID_TAU}
        start = min(found, key=found.__getitem__)
        from scipy.optimize import minimize

        def value(logs: FloatArray) -> float:
            a, tau = (
                float(np.clip(math.exp(v), *limit)) for v, limit in zip(logs, _LIMITS, strict=True)
            )
            return self._at(a, tau)[0]

        polished = minimize(
            value,
            np.log(start),
            method="Nelder-Mead",
            options={"maxfev": 40, "xatol": 0.05, "fatol": 0.02},
        )
        if polished.fun > white[0] - _WORTH:
            return self._fit(white, 0.0, 0.0)
        a, tau = (
            float(np.clip(math.exp(v), *limit))
            for v, limit in zip(polished.x, _LIMITS, strict=True)
        )
        return self._fit(self._at(a, tau), a, tau)

    def plain(self) -> Fit:
        """Return the fit without drift."""
        return self._fit(self._at(*_WHITE), 0.0, 0.0)

    def spread(self, beta: FloatArray) -> FloatArray:
        """Return the covariance about an estimate, over all drifts by their restricted likelihood.

        A record holds few lengths of its drift, so (a, tau) are hardly known: the covariance at the
        best of them is too small. White noise and drift are alike likely before, and so are all a
        and tau on a logarithmic scale.
        """
        drifts = [(a, tau) for a in _ALL_A for tau in _ALL_TAU]
        at = [self._at(*_WHITE), *(self._at(*d) for d in drifts)]
        prior = np.full(len(at), 0.5 / len(drifts))
        prior[0] = 0.5
        value = np.array([v[0] for v in at])
        weight = prior * np.exp(-0.5 * (value - value.min()))
        weight /= weight.sum()
        cov = np.zeros((beta.size, beta.size))
        for w, (_, b, own, _) in zip(weight, at, strict=True):
            cov += w * (own + np.outer(b - beta, b - beta))
        return cov

    def likely(
        self, a: float, tau: float, others: Sequence[tuple[float, float]]
    ) -> list[tuple[float, float, float]]:
        """Return drifts about the best one, those of others that are far from it, and how much each stands for.

        A record holds few lengths of its drift, so (a, tau) are hardly known. All are alike likely before on
        logarithmic scales: the others share the whole area; about the best one the nodes are those of
        Gauss-Hermite quadrature along the axes of its likelihood (Naylor and Smith, Appl. Stat. 31 (1982) 214).
        """
        at, e = np.log([a, tau]), _ASIDE * np.eye(2)

        def value(off: FloatArray) -> float:
            return 0.5 * self._at(*np.exp(at + off).tolist())[0]

        here = value(np.zeros(2))
        H = np.array(
            [
                [value(u + v) - value(u) - value(v) + here if i != j else value(u) - 2.0 * here + value(-u)
                 for j, v in enumerate(e)]
                for i, u in enumerate(e)
            ]
        ) / _ASIDE**2  # fmt: skip
        values, vectors = np.linalg.eigh(0.5 * (H + H.T))
        T = vectors / np.sqrt(np.maximum(values, _WIDEST**-2))
        area = math.prod(math.log(high / low) for low, high in _LIMITS)
        found = []
        for (z1, w1), (z2, w2) in product(_NODES, repeat=2):
            z = np.array([z1, z2])
            volume = w1 * w2 * 2.0 * math.pi * math.exp(0.5 * float(z @ z))
            volume *= abs(float(np.linalg.det(T)))
            found.append((*np.exp(at + T @ z).tolist(), volume / area))
        far = [v for v in others if np.linalg.norm(np.linalg.solve(T, np.log(v) - at)) > _FAR]
        return found + [(*other, 1.0 / len(others)) for other in far]

    def _fit(
        self, at: tuple[float, FloatArray, FloatArray, FloatArray], a: float, tau: float
    ) -> Fit:
        _, beta, cov, scales = at
        return Fit(beta, cov, a, tau, scales, self.judged)

    def _at(self, a: float, tau: float) -> tuple[float, FloatArray, FloatArray, FloatArray]:
        """Return -2 log restricted likelihood (but for a constant), estimate, covariance, scales."""
        n, p = self.X.shape
        data = np.column_stack([self.X, self.y])
        whole, logdet = np.empty_like(data), 0.0
        for stream in self.streams:
            solved, added = inverse_times(data[stream.rows], stream.index, a, tau)
            whole[stream.rows] = solved
            logdet += added
        normal = np.stack([data[r].T @ whole[r] for r in self.rows_of_group])
        variances = np.array([1.0 if u is None else u**2 for u in self.stated])
        free = np.array([u is None for u in self.stated])
        beta, inverse = np.zeros(p), np.zeros((p, p))
        for _ in range(_ROUNDS if len(self.stated) > 1 else 1):
            total = np.einsum("k,kij->ij", 1.0 / variances, normal)
            inverse = np.linalg.inv(total[:p, :p])
            beta = inverse @ total[:p, p]
            step = np.append(-beta, 1.0)
            squares = np.einsum("i,kij,j->k", step, normal, step)
            used = np.einsum("ij,kji->k", inverse, normal[:, :p, :p]) / variances
            counts = np.array([r.size for r in self.rows_of_group]) - used
            new = np.where(free, squares / np.maximum(counts, 1.0), variances)
            variances = np.maximum(new, self.floor)
        total = np.einsum("k,kij->ij", 1.0 / variances, normal)
        sign, of_design = np.linalg.slogdet(total[:p, :p])
        inverse = np.linalg.inv(total[:p, :p])
        beta = inverse @ total[:p, p]
        step = np.append(-beta, 1.0)
        chi2 = float(np.einsum("k,i,kij,j->", 1.0 / variances, step, normal, step))
        sizes = np.array([r.size for r in self.rows_of_group])
        value = logdet + float(sizes @ np.log(variances)) + (of_design if sign > 0 else math.inf)
        # one common scale left over, which the rounds above did not bring to 1
        if free.all():
            left = max(chi2 / (n - p), self.floor / float(variances.max()))
            value += (n - p) * math.log(left)
            variances, inverse = variances * left, inverse * left
        else:
            value += chi2
        return value, beta, inverse, np.sqrt(variances)


def rounding_covariance(
    Z: FloatArray,
    streams: Sequence[Stream],
    fit: Fit,
    steps: FloatArray,
    alike: Sequence[NDArray[np.intp]],
) -> FloatArray:
    """Return what the digits of displays add to the covariance of the estimate (rows by stream).

    A digit of step q has the variance q^2/12, in which the scatter s^2 is contained where it is larger;
    readings that are `alike` (one place, one value) have one rounding error and average nothing out.
    """
    added = np.zeros_like(fit.cov)
    for stream, group in zip(streams, alike, strict=True):
        digit, s = float(steps[stream.which]) ** 2 / 12.0, float(fit.scales[stream.group])
        if digit == 0.0 or not stream.rows.size:
            continue
        solved, _ = inverse_times(Z[stream.rows], stream.index, fit.a, fit.tau)
        G = solved @ fit.cov / s**2  # by how much each reading moves the estimate, (n, r)
        sums = np.zeros((int(group.max()) + 1, G.shape[1]))
        np.add.at(sums, group, G)
        own = max(digit - s**2, 0.0) - digit
        added += digit * (sums.T @ sums) + own * (G.T @ G)
    return added


def degrees_of(
    Z: FloatArray, streams: Sequence[Stream], fit: Fit, stated: Sequence[float | None]
) -> FloatArray:
    """Return how many readings of each group are left over to know its scale, infinite where it is stated."""
    return _degrees(_informed(Z, streams, fit), fit, stated)


def _informed(
    Z: FloatArray, streams: Sequence[Stream], fit: Fit
) -> list[tuple[int, int, FloatArray]]:
    """Return of each stream its group, how many readings it has, and ``Z^T V^-1 Z`` over the scale squared."""
    found = []
    for stream in streams:
        if stream.rows.size:
            solved, _ = inverse_times(Z[stream.rows], stream.index, fit.a, fit.tau)
            own = Z[stream.rows].T @ solved / fit.scales[stream.group] ** 2
            found.append((stream.group, stream.rows.size, own))
    return found


def _degrees(
    informed: Sequence[tuple[int, int, FloatArray]], fit: Fit, stated: Sequence[float | None]
) -> FloatArray:
    found = np.zeros(len(stated))
    for k, n, own in informed:
        found[k] += n - np.sum(fit.cov * own)
    return np.where([u is None for u in stated], found, math.inf)


def few_readings_covariance(
    Z: FloatArray, streams: Sequence[Stream], fit: Fit, stated: Sequence[float | None]
) -> FloatArray:
    """Return what is added to the covariance as the scale of each group is known by few readings only.

    Twice the standard deviation is to hold 95.45 %, as of a normal distribution: the part of a group is
    that of Student's t of its degrees, so times (t / 2)^2.
    """
    from scipy.stats import t as student

    informed = _informed(Z, streams, fit)
    degrees = np.maximum(_degrees(informed, fit, stated), 1.0)  # of fewer none is defined
    twice = np.asarray(student.isf(0.5 * math.erfc(math.sqrt(2.0)), degrees))
    raised = (twice / 2.0) ** 2 - 1.0
    added = np.zeros_like(fit.cov)
    for k, _, own in informed:
        if stated[k] is None:
            added += raised[k] * own
    return fit.cov @ added @ fit.cov


def inverse_times(
    columns: FloatArray, index: FloatArray, a: float, tau: float
) -> tuple[FloatArray, float]:
    """Return ``V^-1`` times columns, and log det V, for readings at the given indices."""
    if a == 0.0 or index.size < 2:
        size = 1.0 + (a**2 if index.size else 0.0)
        return columns / size, index.size * math.log(size)
    from scipy.linalg import cholesky_banded, solveh_banded

    diagonal, beside, left = _precision(index, tau)
    # V = K (Q + a^2 I): columns Q, then the solve
    product = diagonal[:, None] * columns
    product[1:] += beside[:, None] * columns[:-1]
    product[:-1] += beside[:, None] * columns[1:]
    band = np.zeros((2, index.size))
    band[0] = diagonal + a**2
    band[1, :-1] = beside
    factor = cholesky_banded(band, lower=True)
    logdet = 2.0 * float(np.log(factor[0]).sum()) + float(np.log(left).sum())
    return np.asarray(solveh_banded(band, product, lower=True)), logdet


def diagonal_of_inverse(index: FloatArray, a: float, tau: float) -> FloatArray:
    """Return the diagonal of ``V^-1``; of a tridiagonal T that of its inverse needs two sweeps."""
    if a == 0.0 or index.size < 2:
        return np.full(index.size, 1.0 / (1.0 + (a**2 if index.size else 0.0)))
    diagonal, beside, _ = _precision(index, tau)
    d = diagonal + a**2
    down, up = d.copy(), d.copy()
    for i in range(1, d.size):
        down[i] -= beside[i - 1] ** 2 / down[i - 1]
        up[-i - 1] -= beside[-i] ** 2 / up[-i]
    return np.asarray(1.0 - a**2 / (down + up - d))


def _precision(index: FloatArray, tau: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return diagonal and side of ``K^-1``, and the innovations 1 - phi^2 (their product is det K)."""
    phi = np.exp(-np.diff(index) / tau)
    left = 1.0 - phi**2
    diagonal = np.ones(index.size)
    diagonal[1:] += phi**2 / left
    diagonal[:-1] += phi**2 / left
    return diagonal, -phi / left, left
