"""Models behind the bidirectional repeatability: spreads alike or not, reversal errors of a kind."""

from __future__ import annotations

import math

import numpy as np

from metrosep.core._arrays import FloatArray

__all__ = ["NOT_NEEDED", "N_DRAWS", "bootstrap", "models_that_fit", "needed"]


N_DRAWS = 4000
"""Of a simulation."""

_POSSIBLE = 0.01
"""A simpler model is believed possible above this probability."""

NOT_NEEDED = 0.4
"""A richer model is left out above this probability."""

_ALIKE = 1.5
"""Reversal errors within so many standard deviations of their difference may be the same."""

_OUTLYING = 0.5
"""A reversal error stands out below this probability (Bonferroni): it is not drawn to the others."""


def needed(p: float) -> float:
    """Return the weight of the richer model where the simpler one has the probability p.

    One up to `_POSSIBLE`, zero from `NOT_NEEDED`. The cube keeps the average small, 5 %, where the
    simpler model is right: its estimate is then hardly lifted.
    """
    if p <= _POSSIBLE:
        return 1.0
    share = max(math.log(NOT_NEEDED / p), 0.0) / math.log(NOT_NEEDED / _POSSIBLE)
    return float(share**3)


def models_that_fit(
    spread: tuple[float, float],
    nu: tuple[float, float],
    weights: tuple[float, ...],
    reversal: FloatArray,
) -> dict[tuple[bool, str], float]:
    """Return the models to simulate, with weights.

    A model is (one spread for both directions, reversal error none, one, tied, each or own).
    """
    from scipy.stats import f as fisher, t as student

    f, b = spread
    if min(f, b) <= 0.0:
        p_spread = 1.0 if f == b else 0.0
    else:
        p_spread = 2.0 * min(float(fisher.sf(f / b, *nu)), float(fisher.cdf(f / b, *nu)))
    noise = f * weights[0] + b * weights[1]
    m = reversal.size
    if m < 2:
        p_level = 1.0
    elif noise <= 0.0:
        p_level = 1.0 if float(np.ptp(reversal)) == 0.0 else 0.0
    else:
        p_level = float(fisher.sf(reversal.var(ddof=1) / noise, m - 1, sum(nu)))
    pools = {}
    if p_spread > _POSSIBLE:
        pools[True] = 1.0 - needed(p_spread)
    if p_spread < NOT_NEEDED:
        pools[False] = needed(p_spread)
    levels: dict[str, float] = {}
    if p_level > _POSSIBLE:
        p_none = 0.0
        if noise > 0.0:
            ratio = abs(float(reversal.mean())) / math.sqrt(noise / m)
            p_none = 2.0 * float(student.sf(ratio, sum(nu)))
        same = 1.0 - needed(p_level)
        if p_none > _POSSIBLE:
            levels["none"] = same * (1.0 - needed(p_none))
        levels["one"] = same * needed(p_none)
    if p_level < NOT_NEEDED:
        levels |= dict.fromkeys(("tied", "each"), needed(p_level) / 2.0)
    if m > 2 and noise > 0.0:
        furthest = float(np.abs(reversal - reversal.mean()).max())
        ratio = furthest / math.sqrt(noise * (m - 1) / m)
        if 2.0 * m * float(student.sf(ratio, sum(nu))) < _OUTLYING:
            levels["own"] = 0.0  # for the interval alone
    return {(pool, level): a * b for pool, a in pools.items() for level, b in levels.items()}


def bootstrap(
    spread: tuple[float, float],
    nu: tuple[float, float],
    weights: tuple[float, ...],
    reversal: FloatArray,
    model: tuple[bool, str],
    confidence: float,
    rng: np.random.Generator,
) -> tuple[float, float, float, float]:
    """Return value without bias, standard uncertainty and interval under one model."""
    observed = (np.array(spread[0]), np.array(spread[1]))
    value, f, b, beta, noise = _plug_in(*observed, reversal, nu, weights, model)
    t0 = float(value)
    truth = t0
    if model[1] == "tied":
        beta = _tied(beta, float(noise))
        truth = float(_of_parts(f, b, beta))
    if t0 <= 0.0:
        return 0.0, 0.0, 0.0, 0.0
    draws = (
        f * rng.chisquare(nu[0], N_DRAWS) / nu[0],
        b * rng.chisquare(nu[1], N_DRAWS) / nu[1],
    )
    moved = beta + np.sqrt(noise) * rng.standard_normal((N_DRAWS, reversal.size))
    ratio = np.log(_plug_in(*draws, moved, nu, weights, model)[0] / truth)
    tail = (1.0 - confidence) / 2.0
    high, low = np.quantile(ratio, [tail, 1.0 - tail])
    centre = t0 * math.exp(-float(ratio.mean()))
    return centre, centre * float(ratio.std()), t0 * math.exp(-low), t0 * math.exp(-high)


def _plug_in(
    forward: FloatArray,
    backward: FloatArray,
    reversal: FloatArray,
    nu: tuple[float, float],
    weights: tuple[float, ...],
    model: tuple[bool, str],
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return R of variances (...) and reversal errors (..., m), and what the model made of them."""
    one_spread, levels = model
    if one_spread:
        forward = backward = (nu[0] * forward + nu[1] * backward) / (nu[0] + nu[1])
    noise = np.asarray(forward * weights[0] + backward * weights[1])
    level = reversal.mean(axis=-1)
    if levels == "none":
        beta = np.zeros_like(reversal)
    elif levels == "one":
        beta = np.broadcast_to(level[..., None], reversal.shape)
    elif levels == "own":
        beta = reversal
    else:
        scatter = np.maximum(reversal.var(axis=-1, ddof=1), np.finfo(float).tiny)
        kept = np.sqrt(np.clip(1.0 - noise / scatter, 0.0, 1.0))
        beta = level[..., None] + kept[..., None] * (reversal - level[..., None])
    return _of_parts(forward, backward, beta), forward, backward, beta, noise


def _of_parts(forward: FloatArray, backward: FloatArray, beta: FloatArray) -> FloatArray:
    sf, sb = np.sqrt(forward), np.sqrt(backward)
    both = 2.0 * sf + 2.0 * sb + np.abs(beta).max(axis=-1)
    return np.asarray(np.maximum(np.maximum(4.0 * sf, 4.0 * sb), both))


def _tied(beta: FloatArray, noise: float) -> FloatArray:
    """Return reversal errors whose largest are one: noise may have told them apart.

    The largest of several that are alike lies furthest above what it stands for.
    """
    size = np.abs(beta)
    top = size >= size.max() - _ALIKE * math.sqrt(2.0 * noise)
    return np.where(top, np.copysign(size[top].mean(), beta), beta)
