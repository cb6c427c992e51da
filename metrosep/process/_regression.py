"""Private: linear regression whose residuals are not independent, with honest uncertainty."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DegenerateFitError, TooFewSamplesError

_CONDITION = 1e-9
"""Smallest singular value of the scaled design, relative, below which terms are one."""


@dataclass(frozen=True, slots=True)
class Regression:
    """Coefficients, covariance, residual and over how many samples the residual is correlated."""

    coefficients: FloatArray
    cov: FloatArray
    residual: FloatArray
    bandwidth: int
    inflation: float


def regress(
    basis: FloatArray,
    y: FloatArray,
    segments: NDArray[np.intp],
    *,
    at: NDArray[np.intp] | None = None,
) -> Regression:
    """Return least squares with a covariance that knows how the residuals hang together.

    `segments` numbers the stretches without a gap, `at` places the samples on the time grid; a
    gap counts as one sample where that is not known. Residuals that look less than independent are
    not believed, and noise that is larger where a term is large widens that term.
    """
    n, k = basis.shape
    if n < 2 * k + 4:
        raise TooFewSamplesError(f"{k} terms need at least {2 * k + 4} samples, got {n}")
    scale = np.linalg.norm(basis, axis=0)
    if (scale == 0.0).any():
        raise DegenerateFitError("a term of the regression is zero throughout; the axis stands")
    design = basis / scale
    u, s, vt = np.linalg.svd(design, full_matrices=False)
    if s[-1] < _CONDITION * s[0]:
        raise DegenerateFitError(
            "the terms of the regression cannot be told apart in this motion; leave one out or "
            "log a motion of more than one frequency"
        )
    back = vt.T / s
    coefficients = back @ (u.T @ y)
    residual = y - design @ coefficients
    place = np.arange(n) + segments if at is None else at
    found = long_run(u, residual, place)
    cov = back @ found.cov @ back.T
    power = float(residual @ residual) / (n - k)
    white = back @ back.T * power
    inflation = 1.0
    if power > 0.0:
        scores = u * residual[:, None]
        uneven = back @ (scores.T @ scores) @ back.T / power
        least = np.diag(white)
        wider = np.sqrt(np.maximum(np.diag(uneven) / np.diag(back @ back.T), 1.0))
        wider = wider * np.sqrt(np.maximum(least / np.maximum(np.diag(cov), 1e-300), 1.0))
        cov = cov * np.outer(wider, wider)
        inflation = float(np.sqrt(np.max(np.diag(cov) / least)))
    return Regression(
        coefficients / scale,
        cov / np.outer(scale, scale),
        residual,
        math.ceil(found.samples),
        inflation,
    )


# ---- private: the covariance of sums over a residual that is not white, from models of its spectrum ----
# The noise is taken as stationary and independent of the motion. Autoregressive models are fitted
# to the residual (Burg, order by AIC) and to its means over blocks, which see slow noise below white
# noise; for each sum the largest variance counts.

_BLOCKS = (1, 4, 16, 64)
"""Samples of a block."""

_FEWEST = 60
"""Blocks that a model of them needs."""

_KEPT = 0.9
"""Of the square of every column: less of it left in the means of blocks, and these say nothing."""

_PATIENCE = 16
"""Orders without a better AIC after which the search ends."""

_NEAR_ONE = 1.0 - 1e-9
"""Largest reflection coefficient: the model stays stable."""


@dataclass(frozen=True, slots=True)
class LongRun:
    """Covariance of the sums Q'e of orthonormal columns, and how long the residual is correlated."""

    cov: FloatArray
    samples: float


def long_run(columns: FloatArray, residual: FloatArray, at: NDArray[np.intp]) -> LongRun:
    """Return the covariance of ``columns.T @ noise`` from the residual of a fit on these columns.

    `columns` (n, k) are orthonormal, `at` (n,) is the place of each sample on the even time grid.
    """
    k = columns.shape[1]
    power = float(residual @ residual)
    if power <= 0.0:
        return LongRun(np.zeros((k, k)), 1.0)
    size = int(at[-1] - at[0]) + 1
    place = at - at[0]
    total: FloatArray = np.zeros((k, k))
    slowest = 0.0
    for block in _BLOCKS:
        blocks = -(-size // block)
        q, r, count = _means(columns, residual, place, block, blocks)
        pieces = _pieces(r, count >= 0.5 * block)
        usable = sum(p.size for p in pieces)
        if block > 1 and (usable < _FEWEST or np.linalg.svd(q, compute_uv=False)[-1] ** 2 < _KEPT):
            break
        model = _burg(pieces, usable)
        cov, at_zero = _sums(q, *model)
        # the fit took its part of the noise away
        own = sum(float(p @ p) for p in pieces)
        expected = usable * _power(*model, 2 * blocks) - float(np.trace(cov))
        share = max(own / max(expected, 0.1 * own), 1.0)
        cov, slowest = cov * share, max(slowest, at_zero * share)
        if block == _BLOCKS[0]:
            total = cov
        else:
            wider = np.sqrt(np.maximum(np.diag(cov) / np.diag(total), 1.0))
            total = total * np.outer(wider, wider)
    return LongRun(total, max(slowest * residual.size / power, 1.0))


def _means(
    columns: FloatArray, residual: FloatArray, place: NDArray[np.intp], block: int, blocks: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return sums of columns and mean residual of blocks, scaled so that white noise stays."""
    if block == 1 and place.size == blocks:
        return columns, residual, np.ones(blocks)
    which = place // block
    count = np.bincount(which, minlength=blocks).astype(float)
    root = math.sqrt(block)
    q = np.column_stack([np.bincount(which, weights=c, minlength=blocks) for c in columns.T])
    r = np.bincount(which, weights=residual, minlength=blocks) / np.maximum(count, 1.0)
    return q / root, r * root, count


def _pieces(r: FloatArray, used: NDArray[np.bool_]) -> list[FloatArray]:
    """Return the stretches of blocks that were used."""
    edges = np.diff(np.concatenate([[0], used.astype(int), [0]]))
    return [
        r[a:b]
        for a, b in zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1), strict=True)
    ]


def _burg(pieces: list[FloatArray], n: int) -> tuple[FloatArray, float]:
    """Return coefficients (1, a1, a2 ...) and innovation variance of the order of least AIC."""
    forward, backward = [p.copy() for p in pieces], [p.copy() for p in pieces]
    variance = sum(float(p @ p) for p in pieces) / n
    a = np.array([1.0])
    best = (a, variance)
    least, order = n * math.log(max(variance, 1e-300)), 0
    for m in range(1, max(min(int(15.0 * math.log10(n)), n // 10), 0) + 1):
        forward, backward = [f[1:] for f in forward], [b[:-1] for b in backward]
        if sum(f.size for f in forward) < 0.5 * n:
            break
        both = list(zip(forward, backward, strict=True))
        below = sum(float(f @ f) + float(b @ b) for f, b in both)
        if below <= 0.0:
            break
        k = -2.0 * sum(float(f @ b) for f, b in both) / below
        k = min(max(k, -_NEAR_ONE), _NEAR_ONE)
        forward, backward = [f + k * b for f, b in both], [b + k * f for f, b in both]
        longer = np.append(a, 0.0)
        a = longer + k * longer[::-1]
        variance *= 1.0 - k * k
        score = n * math.log(max(variance, 1e-300)) + 2.0 * m
        if score < least:
            best, least, order = (a, variance), score, m
        elif m - order >= _PATIENCE:
            break
    return best


def _spectrum(a: FloatArray, variance: float, n: int) -> tuple[FloatArray, FloatArray]:
    """Return the two-sided density at the frequencies of rfft, and how often each one counts."""
    density = variance / np.maximum(np.abs(np.fft.rfft(a, n)) ** 2, 1e-300)
    weight = np.full(density.size, 2.0)
    weight[0] = 1.0
    if n % 2 == 0:
        weight[-1] = 1.0
    return density, weight


def _power(a: FloatArray, variance: float, n: int) -> float:
    """Return the variance of a model."""
    density, weight = _spectrum(a, variance, max(n, 8 * a.size))
    return float(density @ weight) / max(n, 8 * a.size)


def _sums(q: FloatArray, a: FloatArray, variance: float) -> tuple[FloatArray, float]:
    """Return Q' Gamma Q of a model, and the density at frequency zero."""
    from scipy.fft import next_fast_len

    n = next_fast_len(2 * q.shape[0], real=True)
    density, weight = _spectrum(a, variance, n)
    waves = np.fft.rfft(q, n, axis=0)
    cov = np.real((waves.conj().T * (density * weight)) @ waves) / n
    return np.asarray(0.5 * (cov + cov.T)), float(density[0])
