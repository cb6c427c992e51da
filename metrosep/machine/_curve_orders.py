"""Private: how many orders the curves of turned parts need, and which curves would be taken for them.

Orders are chosen by how well the rest of a map foretells what was left out of it: blocks that lie
everywhere in radius and azimuth, six times another sixth. What is foretold is the density of the bins
that were left out, given the others and their noise, which is alike over a length: a curve gains
nothing by following that noise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.machine._reading_problem import NULL

if TYPE_CHECKING:
    from metrosep.machine._bases import Basis

_FOLDS, _BANDS = 6, 4
_SMALLEST = 1e-15
"""m: a smaller noise of a pixel makes no density."""
_SEEN = 5.0
"""Standard deviations by which the residual must hold a curve before a score test sees it (1 in 1e4 of four orders)."""
_SHIFTED = 3.0


def fold_of(
    ring: NDArray[np.intp], sector: NDArray[np.intp], rings: int, sectors: int
) -> NDArray[np.intp]:
    """Return the part of the map that each bin is omitted with: one block in each band of radius."""
    band, block = ring * _BANDS // rings, sector * _FOLDS // sectors
    return np.asarray((block + 2 * band) % _FOLDS)


@dataclass(frozen=True, slots=True)
class _Fold:
    """Whitened rows of the bins that were kept (their triangle), and of those left out given them."""

    R: FloatArray  # (P + 1, P + 1), the reading last
    square: FloatArray  # (P + 1, P + 1)


def _folded(whole: Sequence[tuple[FloatArray, FloatArray, NDArray[np.intp]]]) -> list[_Fold]:
    """Return the folds of parts, each with covariance, rows (columns, then the reading) and fold of its bins."""
    from scipy.linalg import cholesky, solve_triangular

    found = []
    for fold in range(_FOLDS):
        kept, left = [], []
        for V, rows, of in whole:
            order = np.argsort(of == fold, kind="stable")
            n = int(np.count_nonzero(of != fold))
            L = cholesky(V[np.ix_(order, order)], lower=True, check_finite=False)
            white = solve_triangular(L, rows[order], lower=True, check_finite=False)
            kept.append(white[:n])
            left.append(white[n:])
        W = np.concatenate(left)
        found.append(_Fold(np.asarray(np.linalg.qr(np.concatenate(kept), mode="r")), W.T @ W))
    return found


def _score(folds: Sequence[_Fold], columns: Sequence[int]) -> float:
    """Return the logarithm of the density of what was left out, but for a constant."""
    total = 0.0
    chosen = [*columns]
    for fold in folds:
        A, y = fold.R[:, chosen], fold.R[:, -1]
        size = np.linalg.norm(A, axis=0)
        size = np.where(size > 0.0, size, 1.0)
        U, singular, Vt = np.linalg.svd(A / size, full_matrices=False)
        good = singular > NULL * singular[0]
        B = (Vt[good].T / singular[good]) / size[:, None]  # covariance of the coefficients is B B'
        beta = B @ (U[:, good].T @ y)
        AA, Ay = fold.square[np.ix_(chosen, chosen)], fold.square[chosen, -1]
        rest = fold.square[-1, -1] - 2.0 * float(beta @ Ay) + float(beta @ AA @ beta)
        inner = np.eye(B.shape[1]) + B.T @ AA @ B
        across = B.T @ (Ay - AA @ beta)
        _, logdet = np.linalg.slogdet(inner)
        total -= 0.5 * (float(logdet) + rest - float(across @ np.linalg.solve(inner, across)))
    return total


def chosen_orders(
    bases: Mapping[str, Basis],
    free: Sequence[str],
    whole: Sequence[tuple[FloatArray, FloatArray, NDArray[np.intp]]],
    n_own: int,
) -> tuple[dict[str, int], int]:
    """Return the highest order of each free curve, and how many models were compared.

    A model must be likelier by more than the number of those it was picked from, or the luckiest of
    many would be taken.
    """
    folds = _folded(whole)
    at, begin = {}, 0
    for name, basis in bases.items():
        at[name] = begin
        begin += len(basis.labels)
    p = begin

    def columns(orders: Mapping[str, int]) -> list[int]:
        found = [*range(p, p + n_own)]
        for name, basis in bases.items():
            per = len(basis.labels) // len(basis.orders)
            used = [k for k, n in enumerate(basis.orders) if n <= orders.get(name, n)]
            found += [at[name] + per * k + i for k in used for i in range(per)]
        return found

    orders = {n: 0 for n in free if n in bases}
    best, tried = _score(folds, columns(orders)), 1
    while True:
        trials = [
            {**orders, name: order}
            for name in orders
            for order in bases[name].orders
            if order > orders[name]
        ]
        if not trials:
            break
        scores = [_score(folds, columns(t)) for t in trials]
        tried += len(trials)
        k = int(np.argmax(scores))
        if scores[k] <= best + math.log(len(trials) + 1.0):
            break
        orders, best = trials[k], scores[k]
    for name in orders:
        for order in bases[name].orders:
            if order >= orders[name]:
                break
            tried += 1
            if _score(folds, columns({**orders, name: order})) >= best:
                orders[name] = order
                break
    return {n: max(order, bases[n].orders[0]) for n, order in orders.items()}, tried


def covered(V: FloatArray, scale: float) -> FloatArray:
    """Return a covariance in m^2 that has a factor even where the map has no noise."""
    return V * max(scale, _SMALLEST) ** 2


def taken_for(
    further: Mapping[str, Basis],
    asked: Sequence[str],
    more: FloatArray,
    left: FloatArray,
    shifts: FloatArray,
    u: FloatArray,
    names: Sequence[str],
    largest: Mapping[str, float],
) -> dict[str, tuple[str, ...]]:
    """Return curves that were not asked for, with the terms that they shift by 3 u before they are seen.

    `more` are whitened columns, `left` what the model leaves of them, `shifts` by how much each moves the
    coefficients. Over all v with ``|left v| <= 5`` and no coefficient above what a machine has, the
    largest shift of a coefficient is ``5 sqrt(g M^-1 g')``, M = left'left + 25 / largest^2.
    """
    found, begin = {}, 0
    known = u > 0.0
    for name, basis in further.items():
        mine = slice(begin, begin + len(basis.labels))
        begin = mine.stop
        if name in asked or not np.linalg.norm(more[:, mine]) > 0.0:
            continue
        own = left[:, mine]
        M = own.T @ own + np.eye(own.shape[1]) * (_SEEN / largest[name]) ** 2
        g = shifts[:, mine]
        size = _SEEN * np.sqrt(np.maximum(np.einsum("ij,ji->i", g, np.linalg.solve(M, g.T)), 0.0))
        moved = known & (size > _SHIFTED * u)
        if moved.any():
            found[name] = tuple(
                dict.fromkeys(names[i].split(" ")[0] for i in np.flatnonzero(moved).tolist())
            )
    return found
