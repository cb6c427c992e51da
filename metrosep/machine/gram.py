"""The Gram matrix of unit maps: mean square of any mixture of error terms without the maps.

With the maps m_i of unit errors, aligned, and area weights that sum to 1, ``G_ij = <m_i, m_j>``.
For amounts q the mean square deviation is ``q' G q``; for random amounts with mean mu and
covariance S its expectation is ``tr(G S) + mu' G mu``, whatever their distribution. Terms whose
maps are alike (``|r|`` near 1) cannot be distinguished on one part: they are ranked as a group.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.docs import described_by
from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.machine.alignment import Alignment

_BLOCK = 2048

NOTHING_LEFT = 1e-9
"""A map of which an alignment leaves less than this share is the alignment: rounding is left."""


@dataclass(frozen=True, slots=True, eq=False)
class AlignedGram:
    """Gram matrices and extremes of unit maps, before and after alignment."""

    raw: FloatArray  # shape (m, m): before and after alignment, zero in rows that it takes whole
    matrix: FloatArray
    lowest_raw: FloatArray  # shape (m,): extremes of each unit map
    highest_raw: FloatArray
    lowest: FloatArray
    highest: FloatArray
    amounts: FloatArray  # shape (k, m): what is taken out of each unit map, per used freedom
    is_removed: NDArray[np.bool_]  # shape (m,): the whole map is taken, or it is zero


def aligned_gram(maps: ArrayLike, space: Alignment) -> AlignedGram:
    """Return Gram matrices and extremes of maps in two passes, block by block.

    Parameters
    ----------
    maps : array_like, shape (n, m), m per unit
        One column per error term.
    space : Alignment
        Freedoms to remove, with the weights.

    Returns
    -------
    AlignedGram
        Matrices are symmetric.

    Raises
    ------
    InvalidSamplesError
        If the number of points differs or a value is not finite.

    Notes
    -----
    The maps are projected, not the matrix: the difference of two nearly equal matrices would leave
    1e-8 of a map that is a pure piston. What is left of such a map (< 1e-9) is set to zero. The
    matrix before alignment is the sum of squares of both parts. O(n m^2); nothing of the size of
    the maps is allocated.
    """
    values = np.asarray(maps, dtype=np.float64)
    if values.ndim != 2 or values.shape[0] != space.weights.size:
        raise InvalidSamplesError(
            f"maps must have one row for each of {space.weights.size} points and one column per "
            f"term, got shape {values.shape}"
        )
    n, m = values.shape
    basis = space.basis
    weighted = np.ascontiguousarray((basis * space.weights[:, None]).T)
    root = np.sqrt(space.weights)[:, None]
    matrix = np.zeros((m, m))
    parts = np.zeros((basis.shape[1], m))
    before_removal, after_removal = _Extremes(m), _Extremes(m)
    with one_blas_thread():
        for i in range(0, n, _BLOCK):
            before_removal.take(values[i : i + _BLOCK])
            low, high = before_removal.low, before_removal.high
            if not (np.isfinite(low).all() and np.isfinite(high).all()):
                raise InvalidSamplesError(
                    f"maps hold NaN or infinity in rows {i} to {min(i + _BLOCK, n) - 1}; leave such "
                    "points out of the mesh"
                )
            parts += weighted[:, i : i + _BLOCK] @ values[i : i + _BLOCK]
        for i in range(0, n, _BLOCK):
            left = values[i : i + _BLOCK] - basis[i : i + _BLOCK] @ parts
            after_removal.take(left)
            left *= root[i : i + _BLOCK]
            matrix += left.T @ left
    low, high = before_removal.low, before_removal.high
    raw = matrix + parts.T @ parts
    lowest, highest = after_removal.low, after_removal.high
    before, after = np.sqrt(np.diag(raw)), np.sqrt(np.diag(matrix))
    gone = after <= NOTHING_LEFT * before
    matrix[gone, :] = 0.0
    matrix[:, gone] = 0.0
    lowest[gone] = highest[gone] = 0.0
    amounts = np.asarray(
        np.linalg.solve(space.mixing, parts) if parts.size else parts, dtype=float
    )
    result = AlignedGram(raw, matrix, low, high, lowest, highest, amounts, gone)
    for array in (raw, matrix, low, high, lowest, highest, amounts, gone):
        array.setflags(write=False)
    return result


class _Extremes:
    """Lowest and highest value of each column, block by block."""

    def __init__(self, n: int) -> None:
        self.low = np.full(n, np.inf)
        self.high = np.full(n, -np.inf)

    def take(self, block: FloatArray) -> None:
        """Look at some rows; the copy makes each column contiguous, which halves the time."""
        turned = np.ascontiguousarray(block.T)
        np.minimum(self.low, turned.min(axis=1), out=self.low)
        np.maximum(self.high, turned.max(axis=1), out=self.high)


def expected_mean_square(
    matrix: ArrayLike, covariance: ArrayLike, mean: ArrayLike | None = None
) -> float:
    """Return the expected mean square deviation, ``tr(G S) + mu' G mu``.

    Parameters
    ----------
    matrix : array_like, shape (m, m), m^2 per unit^2
        Gram matrix.
    covariance : array_like, shape (m, m)
        Of the amounts of the terms, in their units; or (m,), their variances.
    mean : array_like, shape (m,), optional
        Known amounts; zero if omitted.

    Returns
    -------
    float
        In m^2.

    Raises
    ------
    InvalidSamplesError
        If shapes do not fit, a value is not finite or the Gram matrix is not symmetric.

    Examples
    --------
    >>> expected_mean_square([[4.0, 0.0], [0.0, 1.0]], [0.25, 1.0], [0.0, 3.0])
    11.0
    """
    G = check_gram(matrix)
    S = check_covariance(covariance, G.shape[0])
    total = float(np.sum(G * S))
    if mean is not None:
        mu = np.asarray(mean, dtype=np.float64)
        if mu.shape != (G.shape[0],) or not np.isfinite(mu).all():
            raise InvalidSamplesError(
                f"mean must hold {G.shape[0]} finite amounts, got shape {mu.shape}"
            )
        total += float(mu @ G @ mu)
    return total


@described_by(expected_mean_square, errors=False)
def shares(matrix: ArrayLike, covariance: ArrayLike) -> FloatArray:
    """Return each term's share of the expected mean square, ``(G S)_ii / tr(G S)``.

    Returns
    -------
    ndarray, shape (m,)
        Sum 1; NaN where the expectation is zero. With correlated amounts a share can be negative.

    Raises
    ------
    InvalidSamplesError
        As of `expected_mean_square`.

    Examples
    --------
    >>> shares([[4.0, 0.0], [0.0, 1.0]], [0.25, 1.0]).tolist()
    [0.5, 0.5]
    """
    G = check_gram(matrix)
    each = np.sum(G * check_covariance(covariance, G.shape[0]), axis=1)
    total = each.sum()
    return np.asarray(each / total) if total > 0.0 else np.full(each.size, np.nan)


def correlations(matrix: ArrayLike) -> FloatArray:
    """Return how alike the maps of each pair of terms are, -1 to 1.

    Parameters
    ----------
    matrix : array_like, shape (m, m)
        Gram matrix.

    Returns
    -------
    ndarray, shape (m, m)
        ``G_ij / sqrt(G_ii G_jj)``; NaN in rows of terms without a map.

    Raises
    ------
    InvalidSamplesError
        If the matrix is not square, symmetric and finite.
    """
    G = check_gram(matrix)
    size = np.sqrt(np.diag(G))
    size = np.where(size > 0.0, size, np.nan)
    return np.asarray(np.clip(G / np.outer(size, size), -1.0, 1.0), dtype=np.float64)


def groups_alike(
    matrix: ArrayLike, names: Sequence[str], *, threshold: float = 0.9
) -> tuple[tuple[str, ...], ...]:
    """Return the groups of terms whose maps cannot be distinguished, ``|r|`` above a threshold.

    Parameters
    ----------
    matrix : array_like, shape (m, m)
        Gram matrix after alignment.
    names : sequence of str
        Of the terms.
    threshold : float, optional
        Between 0 and 1.

    Returns
    -------
    tuple of tuple of str
        Groups of two and more, in the order of `names`. A chain makes one group: a alike b and b
        alike c, even where a and c are less alike.

    Raises
    ------
    DataError
        If the threshold is not between 0 and 1 or the number of names is wrong.
    InvalidSamplesError
        If the matrix is not square, symmetric and finite.

    Examples
    --------
    >>> groups_alike([[1.0, 0.95, 0.0], [0.95, 1.0, 0.0], [0.0, 0.0, 1.0]], ["a", "b", "c"])
    (('a', 'b'),)
    """
    check_threshold(threshold)
    r = correlations(matrix)
    if len(names) != r.shape[0]:
        raise DataError(f"{len(names)} names for a Gram matrix of {r.shape[0]} terms")
    alike = np.abs(np.nan_to_num(r)) > threshold
    return tuple(tuple(names[i] for i in group) for group in together(alike))


def together(alike: NDArray[np.bool_]) -> list[tuple[int, ...]]:
    """Return the groups of two and more that a symmetric relation (m, m) joins, in their order."""
    label = list(range(len(alike)))
    for i, j in np.argwhere(np.triu(alike, 1)).tolist():
        low, high = sorted((label[i], label[j]))
        label = [low if k == high else k for k in label]
    groups = [tuple(i for i, k in enumerate(label) if k == first) for first in sorted(set(label))]
    return [g for g in groups if len(g) > 1]


def check_threshold(threshold: float) -> float:
    """Return the |r| from which on terms are alike, above 0 and below 1."""
    if not 0.0 < numbers.between(threshold, "the threshold of |r|", 0.0, 1.0) < 1.0:
        raise InvalidSamplesError(f"the threshold of |r| must be between 0 and 1, got {threshold}")
    return threshold


def check_gram(matrix: ArrayLike) -> FloatArray:
    """Return a Gram matrix as float64."""
    G = np.asarray(matrix, dtype=np.float64)
    if G.ndim != 2 or G.shape[0] != G.shape[1] or not np.isfinite(G).all():
        raise InvalidSamplesError(f"a Gram matrix is square and finite, got shape {G.shape}")
    if np.abs(G - G.T).max(initial=0.0) > 1e-9 * np.abs(G).max(initial=0.0):
        raise InvalidSamplesError("a Gram matrix is symmetric; this one is not")
    return G


def check_covariance(covariance: ArrayLike, n: int) -> FloatArray:
    """Return a covariance matrix; variances become its diagonal."""
    S = np.asarray(covariance, dtype=np.float64)
    if S.ndim == 1:
        S = np.diag(S)
    if S.shape != (n, n) or not np.isfinite(S).all():
        raise InvalidSamplesError(
            f"covariance must hold {n} finite variances or be {n} x {n}, got shape {S.shape}"
        )
    if (np.diag(S) < 0.0).any():
        raise InvalidSamplesError(f"a variance is {np.diag(S).min()}, below zero")
    size = np.sqrt(np.diag(S))
    safe = np.where(size > 0.0, size, 1.0)
    r = S / np.outer(safe, safe)
    if np.abs(r - r.T).max(initial=0.0) > 1e-9 or (
        n > 0 and float(np.linalg.eigvalsh((r + r.T) / 2.0).min()) < -1e-9 * n
    ):
        raise InvalidSamplesError(
            "the covariance is not symmetric or has a negative eigenvalue: no random errors have it"
        )
    return np.asarray(S, dtype=np.float64)
