"""What keeps outliers from pulling a fit: a trimmed start, then Tukey's or Huber's weights.

An MM-estimate: least trimmed squares of a sample (up to half of the points may be wrong) gives the
place and the spread of the good points; with that spread held, weighted least squares is repeated
until it settles. Sources: Rousseeuw and Van Driessen 2006 (FAST-LTS); Yohai 1987; Huber 1981, 7.6.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Literal, TypeVar

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, NotConvergedError

__all__ = [
    "Robust",
    "robust_fit",
    "robust_variance",
    "robust_weights",
    "spread",
    "trimmed_start",
    "winsorised",
]

Robust = Literal["tukey", "huber"]
Weigh = Callable[[FloatArray], FloatArray]
"""From the deviation of each point to its weight; 0 where the deviation is NaN."""
Fitted = TypeVar("Fitted")

_TUNING = {"tukey": 4.685, "huber": 1.345}
"""95 % efficiency for Gaussian noise (Holland and Welsch 1977)."""

_TRIM_POINTS, _TRIM_STARTS = 1000, 300
"""Of the sample; 300 subsets of 7 points hold one without outlier even where 40 % are wrong."""

_ROUNDS = 300
"""Of weights: they settle linearly."""

_SETTLED = 1e-6
"""Of the spread: a round that moves the heights by less changes nothing that matters."""

_EXACT = 1e-15
"""Of the largest height: a spread below it is rounding, and the good points fit exactly."""

_NORMAL_MAD = 1.4826
"""Standard deviation of Gaussian noise over its median absolute deviation."""


def spread(deviation: FloatArray) -> float:
    """Return the standard deviation that Gaussian noise of this median magnitude has."""
    valid = np.abs(deviation[~np.isnan(deviation)])
    return _NORMAL_MAD * float(np.median(valid)) if valid.size else 0.0


def robust_weights(deviation: FloatArray, scale: float, rule: Robust) -> FloatArray:
    """Return the weight of each point, 0 to 1."""
    if rule not in _TUNING:
        raise DataError(f"robust must be one of {', '.join(_TUNING)}, got {rule!r}")
    limit = _TUNING[rule] * scale
    magnitude = np.abs(deviation)
    if limit == 0.0:
        return np.where(np.isnan(deviation), np.nan, (magnitude == 0.0).astype(np.float64))
    if rule == "tukey":
        inside = 1.0 - np.minimum(magnitude / limit, 1.0) ** 2
        return inside * inside
    return np.minimum(1.0, limit / np.maximum(magnitude, limit))


def robust_variance(deviation: FloatArray, scale: float, rule: Robust, p: int) -> float:
    """Return the factor of ``(J'J)^-1`` in the covariance of a robust fit.

    References
    ----------
    .. [1] Huber 1981, Robust Statistics, Eq. (6.5).
    """
    r = deviation[~np.isnan(deviation)]
    if r.size <= p:
        return float("nan")
    limit = _TUNING[rule] * scale
    if limit == 0.0:
        return 0.0
    psi, mean_slope = _psi(r, limit, rule)
    return float(psi @ psi) / (r.size - p) / mean_slope**2 if mean_slope > 0.0 else float("nan")


def winsorised(deviation: FloatArray, rule: Robust) -> FloatArray:
    """Return the deviations that the covariance of a robust fit is made of."""
    good = ~np.isnan(deviation)
    limit = _TUNING[rule] * spread(deviation)
    if limit == 0.0:
        return np.where(good, 0.0, np.nan)
    psi, slope = _psi(deviation[good], limit, rule)
    out = np.full(deviation.shape, np.nan)
    out[good] = psi / slope if slope > 0.0 else np.nan
    return out


def _psi(r: FloatArray, limit: float, rule: Robust) -> tuple[FloatArray, float]:
    """Return psi(r) = w r, and the mean of its slope."""
    psi = robust_weights(r, limit / _TUNING[rule], rule) * r
    inside = np.abs(r) < limit
    if rule == "tukey":
        square = np.where(inside, (r / limit) ** 2, 1.0)
        return psi, float(((1.0 - square) * (1.0 - 5.0 * square)).mean())
    return psi, float(inside.mean())


def robust_fit(
    start: Fitted,
    spread_of: Callable[[Fitted], float],
    refit: Callable[[Fitted, Weigh], tuple[Fitted, float]],
    rule: Robust,
    *,
    largest: float,
    name: str,
) -> tuple[Fitted, float]:
    """Return the fit at which the weights have settled: the spread held, twice."""
    fitted, scale = start, 0.0
    for _ in range(2):
        scale = spread_of(fitted)
        if scale <= _EXACT * largest:
            scale = 0.0
        fitted = _with_scale(fitted, scale, refit, rule, name)
        if scale == 0.0:
            break
    return fitted, scale


def _with_scale(
    fitted: Fitted,
    scale: float,
    refit: Callable[[Fitted, Weigh], tuple[Fitted, float]],
    rule: Robust,
    name: str,
) -> Fitted:
    def weigh(deviation: FloatArray) -> FloatArray:
        return np.nan_to_num(robust_weights(deviation, scale, rule))

    for _ in range(_ROUNDS):
        fitted, moved = refit(fitted, weigh)
        if scale == 0.0 or moved <= _SETTLED * scale:
            return fitted
    raise NotConvergedError(
        f"the robust weights of the {name} did not settle in {_ROUNDS} rounds: there is no clear "
        "majority of good points; mask the bad ones, or fit without robust="
    )


def trimmed_start(jacobian: FloatArray, deviation: FloatArray) -> FloatArray:
    """Return the change of the parameters that the better half of the points asks for."""
    p, n = jacobian.shape
    thin = max(1, n // _TRIM_POINTS)
    J, r = jacobian[:, ::thin], deviation[::thin]
    n = r.size
    length = np.sqrt((J * J).sum(axis=1) / max(n, 1))
    if p == 0 or n < 3 * p + 3 or not (length > 0.0).all():
        return np.zeros(p)
    J = J / length[:, None]
    half = (n + p + 1) // 2
    rng = np.random.default_rng(19840101)
    starts = [np.zeros(p)]
    for _ in range(_TRIM_STARTS):
        some = rng.choice(n, size=p, replace=False)
        with suppress(np.linalg.LinAlgError):
            starts.append(np.linalg.solve(J[:, some].T, r[some]))
    tried = sorted((_concentrate(J, r, a, half, 2) for a in starts), key=lambda t: t[0])
    best = min((_concentrate(J, r, a, half, 30) for _, a in tried[:5]), key=lambda t: t[0])
    return np.asarray(best[1] / length)


def _concentrate(
    J: FloatArray, r: FloatArray, a: FloatArray, half: int, steps: int
) -> tuple[float, FloatArray]:
    """Return the sum of the smaller squares, and the parameters, after steps that lower it."""
    left = np.square(r - a @ J)
    squares = float(np.partition(left, half - 1)[:half].sum())
    for _ in range(steps):
        near = np.argpartition(left, half - 1)[:half]
        part = J[:, near]
        try:
            solved = np.linalg.solve(part @ part.T, part @ r[near])
        except np.linalg.LinAlgError:
            break
        trial = np.asarray(solved, dtype=np.float64)
        fresh = np.square(r - trial @ J)
        total = float(np.partition(fresh, half - 1)[:half].sum())
        if not total < squares:
            break
        a, left, squares = trial, fresh, total
    return squares, a
