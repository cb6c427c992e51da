"""Sobol indices of the RMS deviation: which error term's spread drives the spread of Sq.

``Sq = sqrt(q' G q)`` needs no maps. The first-order index of a term is the share of the variance
of Sq that knowing the term alone would take away, the total index the share that stays while only
it is unknown. A norm is far from additive: the totals add up to much more than 1. For ranking,
shares of the expected square (`metrosep.machine.gram.shares`) are the better number.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import InvalidSamplesError, TooFewSamplesError
from metrosep.machine.gram import check_gram

DISTRIBUTIONS = {"normal": 1.0, "uniform": 1.0 / np.sqrt(3.0)}
"""Standard deviation of each distribution in parts of its magnitude: standard uncertainty of the
normal one, half-width of the uniform one."""

_REPEATS = 8


@dataclass(frozen=True, slots=True, eq=False)
class SobolIndices:
    """Sobol indices with the standard uncertainty of their simulation."""

    first: FloatArray  # shape (m,): first-order index; NaN where the RMS does not vary
    total: FloatArray
    u_first: FloatArray  # standard uncertainty, from independent repeats
    u_total: FloatArray
    n: int  # draws of all repeats together, per term


def sobol_indices(
    matrix: ArrayLike,
    magnitudes: ArrayLike,
    *,
    mean: ArrayLike | None = None,
    distribution: str = "uniform",
    n: int = 65536,
    seed: int = 0,
) -> SobolIndices:
    """Return the Sobol indices of ``sqrt(q' G q)`` for independent amounts q.

    Parameters
    ----------
    matrix : array_like, shape (m, m), m^2 per unit^2
        Gram matrix.
    magnitudes : array_like, shape (m,)
        Half-width of each term if uniform, standard uncertainty if normal; >= 0.
    mean : array_like, shape (m,), optional
        Middle of each term; zero if omitted.
    distribution : {"uniform", "normal"}, optional
        Of all terms.
    n : int, optional
        Draws per term, at least 64.
    seed : int, optional
        Of the generator.

    Returns
    -------
    SobolIndices
        In the order of the terms.

    Raises
    ------
    DataError
        If the distribution is unknown.
    InvalidSamplesError
        If shapes do not fit or a value is not finite or negative.
    TooFewSamplesError
        If n is below 64.

    Notes
    -----
    Eight scrambled Sobol sequences; first order after Saltelli 2010 [1]_ (table 2b), total after
    Jansen [1]_ (table 2f). One term of ``q' G q`` changes by ``2 d (Gq)_i + d^2 G_ii``, so all m
    terms cost as much as one more product: O(n m^2).

    References
    ----------
    .. [1] Saltelli et al., Comput. Phys. Commun. 181, 259 (2010), table 2.

    Examples
    --------
    >>> sobol_indices(np.diag([1.0, 0.0]), [2.0, 5.0]).total.round(6).tolist()
    [1.0, 0.0]
    """
    G = check_gram(matrix)
    m = G.shape[0]
    numbers.choice(distribution, "distribution", DISTRIBUTIONS)
    size = np.asarray(magnitudes, dtype=np.float64)
    middle = np.zeros(m) if mean is None else np.asarray(mean, dtype=np.float64)
    if size.shape != (m,) or not np.isfinite(size).all() or (size < 0.0).any():
        raise InvalidSamplesError(
            f"magnitudes must be {m} finite numbers, not negative, got {size}"
        )
    if middle.shape != (m,) or not np.isfinite(middle).all():
        raise InvalidSamplesError(f"mean must hold {m} finite amounts, got shape {middle.shape}")
    if numbers.count(n, "n") < 8 * _REPEATS:
        raise TooFewSamplesError(f"Sobol indices need at least {8 * _REPEATS} draws, got {n}")
    scale = float(np.sqrt(np.max(np.diag(G) * (size**2 + middle**2), initial=0.0)))
    G = G / (scale**2 or 1.0)
    power = max(3, int(np.ceil(np.log2(n / _REPEATS))))
    results = [
        _once(G, *_two_samples(m, power, size, middle, distribution, seed + k))
        for k in range(_REPEATS)
    ]
    found = np.array(results)
    value = found.mean(axis=0)
    spread = found.std(axis=0, ddof=1) / np.sqrt(_REPEATS)
    for array in (value, spread):
        array.setflags(write=False)
    return SobolIndices(value[0], value[1], spread[0], spread[1], _REPEATS * 2**power)


def draws(
    n: int, magnitudes: FloatArray, mean: FloatArray, distribution: str, seed: int
) -> FloatArray:
    """Return independent random amounts."""
    rng = np.random.default_rng(seed)
    shape = (n, magnitudes.size)
    unit = (
        rng.uniform(-1.0, 1.0, shape) if distribution == "uniform" else rng.standard_normal(shape)
    )
    return np.asarray(mean + unit * magnitudes)


def _two_samples(
    m: int, power: int, size: FloatArray, middle: FloatArray, distribution: str, seed: int
) -> tuple[FloatArray, FloatArray]:
    """Return two independent samples, shape (2^power, m) each."""
    from scipy.stats import qmc

    unit = qmc.Sobol(2 * m, rng=np.random.default_rng(seed)).random_base2(power)
    if distribution == "uniform":
        spread = 2.0 * unit - 1.0
    else:
        from scipy.special import ndtri

        tiny = 2.0**-40  # the sequence can hold an exact zero
        spread = ndtri(np.clip(unit, tiny, 1.0 - tiny))
    return middle + spread[:, :m] * size, middle + spread[:, m:] * size


def _once(G: FloatArray, A: FloatArray, B: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return first-order and total indices of one pair of samples."""
    GA = A @ G
    square_a = np.maximum(np.sum(GA * A, axis=1), 0.0)
    sq_a = np.sqrt(square_a)
    sq_b = np.sqrt(np.maximum(np.sum((B @ G) * B, axis=1), 0.0))
    step = B - A
    changed = np.sqrt(np.maximum(square_a[:, None] + step * (2.0 * GA + step * np.diag(G)), 0.0))
    both = np.concatenate((sq_a, sq_b))
    variance = float(both.var())
    if variance <= 1e-24 * max(float(np.mean(both**2)), 1e-300):
        nothing = np.full(G.shape[0], np.nan)
        return nothing, nothing
    centred = sq_b - both.mean()
    first = np.mean(centred[:, None] * (changed - sq_a[:, None]), axis=0) / variance
    total = 0.5 * np.mean((sq_a[:, None] - changed) ** 2, axis=0) / variance
    return first, total
