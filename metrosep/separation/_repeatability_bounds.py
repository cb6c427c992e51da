"""Bounds of the repeatability that hold whatever the spread of each target is.

R stands for the largest of the targets' spreads. Its upper bound must hold where one target alone
has it and hides among the others; the largest of the targets' own bounds does, since the target that
matters is one of them. The lower bound fails most often where all targets are alike: it is the
larger of a pooled one and of the targets' own ones, each by its share of the probability. All of the
probability of an error is spent on both: where one bound fails, the other one hardly ever does.
"""

from __future__ import annotations

import math

import numpy as np

from metrosep.core._arrays import FloatArray

__all__ = ["bounds_of_both", "bounds_of_one"]


_POOLED = 0.8
"""Share of the lower bound's probability of an error that the pooled bound takes."""

_DRAWS = 20_000

_ALIKE = 0.001
"""The directions are simulated as one unless their mean variances differ as much with less probability."""

_SURE = 2.0
"""Standard deviations of the mean reversal error that may be noise."""


def bounds_of_one(
    variance: FloatArray, freedom: FloatArray, confidence: float
) -> tuple[float, float]:
    """Return bounds of the largest ``4 sigma_i`` of one direction.

    Notes
    -----
    For sigma_i <= theta, any statistic that grows with each s_i exceeds a multiple of theta most
    often where all sigma_i = theta, and falls below one most often where one alone is theta. So
    ``max 4 s_i sqrt(nu_i / chi2(alpha, nu_i))`` lies below the truth with the probability alpha at
    most, and ``4 s_p sqrt(nu / chi2(1 - alpha', nu))`` above it with alpha' at most.
    """
    from scipy.stats import chi2

    alpha, m = 1.0 - confidence, variance.size
    own = freedom * variance
    high = math.sqrt(float((own / chi2.ppf(alpha, freedom)).max()))
    if m == 1:
        tail = alpha / 2.0
        return tuple(  # type: ignore[return-value]
            4.0 * math.sqrt(float(own[0] / chi2.ppf(q, freedom[0]))) for q in (1.0 - tail, tail)
        )
    pooled = float(own.sum() / chi2.ppf(1.0 - _POOLED * alpha, freedom.sum()))
    rare = 1.0 - (1.0 - (1.0 - _POOLED) * alpha) ** (1.0 / m)
    single = float((own / chi2.ppf(1.0 - rare, freedom)).max())
    return 4.0 * math.sqrt(max(pooled, single)), 4.0 * high


def bounds_of_both(
    variances: tuple[FloatArray, FloatArray],
    freedoms: list[FloatArray],
    reversal: FloatArray,
    confidence: float,
    rng: np.random.Generator,
) -> tuple[float, float]:
    """Return bounds of the largest R_i of both directions.

    Notes
    -----
    Each target: quantiles of ``max(2 sf + 2 sb + |beta|, 4 sf, 4 sb)`` with ``sf**2 = nu s**2 / chi2``
    and beta about B_i (fiducial); below, of each of the three by itself. Pooled: mean spreads and
    the mean reversal error.
    """
    alpha, m = 1.0 - confidence, reversal.size
    own, pooled = (0.5 * alpha, 0.0) if m == 1 else ((1.0 - _POOLED) * alpha / m, _POOLED * alpha)
    low, high = _own(variances, freedoms, reversal, own, alpha if m > 1 else 0.5 * alpha, rng)
    if m > 1:
        low = max(low, _pooled(variances, freedoms, reversal, pooled, rng))
    return low, high


def _own(
    variances: tuple[FloatArray, FloatArray],
    freedoms: list[FloatArray],
    reversal: FloatArray,
    below: float,
    above: float,
    rng: np.random.Generator,
) -> tuple[float, float]:
    """Return the largest of the targets' own bounds, lower and upper, for given probabilities."""
    from scipy.stats import chi2

    low = 0.0
    for v, nu in zip(variances, freedoms, strict=True):
        alone = nu * v / chi2.ppf(1.0 - below / 3.0, nu)
        low = max(low, 4.0 * math.sqrt(float(alone.max())))
    f, b = (
        nu * v / rng.chisquare(nu, (_DRAWS, nu.size))
        for v, nu in zip(variances, freedoms, strict=True)
    )
    noise = np.sqrt(f / (freedoms[0] + 1.0) + b / (freedoms[1] + 1.0))
    beta = np.abs(reversal) + noise * rng.standard_normal(noise.shape)
    spread = 2.0 * np.sqrt(f) + 2.0 * np.sqrt(b)
    low = max(low, float(np.quantile(spread + beta, below / 3.0, axis=0).max()))
    largest = np.maximum(spread + np.abs(beta), 4.0 * np.sqrt(np.maximum(f, b)))
    return low, float(np.quantile(largest, 1.0 - above, axis=0).max())


def _pooled(
    variances: tuple[FloatArray, FloatArray],
    freedoms: list[FloatArray],
    reversal: FloatArray,
    level: float,
    rng: np.random.Generator,
) -> float:
    """Return the lower bound of R by mean spreads: of each direction, of both with the mean reversal.

    No target's R_i need reach any of the three, but the largest does. Where they are close together
    each gets a part of the probability, so that all three fail with `level`.
    """
    from scipy.stats import chi2, f as fisher

    m, trials = reversal.size, _DRAWS // 2
    spread = [float(nu @ v / nu.sum()) for v, nu in zip(variances, freedoms, strict=True)]
    total = [float(nu.sum()) for nu in freedoms]
    each = [float(np.sum(1.0 / (nu + 1.0))) / m**2 for nu in freedoms]
    noise = math.sqrt(spread[0] * each[0] + spread[1] * each[1])
    beta = abs(float(reversal.mean()))
    if max(spread) <= 0.0:
        return beta
    # what the three do on an axis whose directions are alike, unless they clearly are not
    common = sum(v * n for v, n in zip(spread, total, strict=True)) / sum(total)
    order = np.argsort(spread)[::-1]
    limit = float(fisher.ppf(1.0 - _ALIKE, total[order[0]], total[order[1]]))
    alike = max(spread) < limit * min(spread)
    plug = [common, common] if alike else spread
    drawn = [v * rng.chisquare(n, trials) / n for v, n in zip(plug, total, strict=True)]
    middle = noise * rng.standard_normal(trials)
    both = 2.0 * (np.sqrt(drawn[0]) + np.sqrt(drawn[1]))
    least = max(beta - _SURE * noise, 0.0)
    sums = both + np.abs(middle + least)
    truth = 2.0 * (math.sqrt(plug[0]) + math.sqrt(plug[1])) + least
    largest = max(truth, 4.0 * math.sqrt(max(plug)))
    rare = [chi2.cdf(16.0 * n * d / largest**2, n) for d, n in zip(drawn, total, strict=True)]
    rare.append(np.argsort(np.argsort(sums)) / trials * (truth >= largest))
    level_each = float(np.quantile(1.0 - np.max(rare, axis=0), level))
    level_each = min(max(level_each, level / 3.0), level)
    found = max(
        4.0 * math.sqrt(v * n / float(chi2.ppf(1.0 - level_each, n)))
        for v, n in zip(spread, total, strict=True)
    )
    over = max(
        float(np.quantile(both + np.abs(middle + x) - x, 1.0 - level_each)) for x in (least, beta)
    )
    width = 2.0 * (math.sqrt(plug[0]) + math.sqrt(plug[1]))
    read = 2.0 * (math.sqrt(spread[0]) + math.sqrt(spread[1]))
    return max(found, read * width / over + beta)
