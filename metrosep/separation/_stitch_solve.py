"""Least squares of all overlaps at once: freedoms of each sub-aperture, their covariance, the mean.

A reading is ``m_i = s + F_i theta + noise``. The surface s has one unknown in each pixel; it is
eliminated there (weighted mean), which leaves small normal equations, summed over the overlaps.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import DegenerateFitError
from metrosep.separation._overlaps import Overlap
from metrosep.separation._stitch_grid import Layout, Placed

FloatArray = NDArray[np.float64]
Box = tuple[slice, slice]
Features = Callable[[int, Box], FloatArray]
"""Index of a sub-aperture and window in it -> (n_columns, rows, columns)."""

_NULL = 1e-11
"""Eigenvalue of the scaled normal matrix, relative to the largest, below which it is zero."""

_WHOLE: Box = (slice(None), slice(None))

_MOST_KEPT = 10_000_000
"""Pixels of all sub-apertures up to which their columns are kept (240 MB), not made again."""


@dataclass(frozen=True, slots=True)
class Problem:
    """The design of a stitching.

    Parameters
    ----------
    layout : Layout
        Sub-apertures on the grid.
    overlaps : tuple of Overlap
        Pairs.
    features : callable
        The columns of each sub-aperture.
    columns : list of ndarray of int
        Where they stand among all unknowns.
    n_columns : int
        Number of unknowns.
    weight : ndarray, shape (grid)
        Sum of the weights at each pixel.
    """

    layout: Layout
    overlaps: tuple[Overlap, ...]
    features: Features
    columns: list[NDArray[np.int64]]
    n_columns: int
    weight: FloatArray

    def share(self, k: int, box: Box = _WHOLE) -> FloatArray:
        """Return the share ``w_i / sum w`` of a sub-aperture in the mean; 0 where not measured."""
        p = self.layout.placed[k]
        total = self.weight[p.rows, p.columns][box]
        out = np.zeros(total.shape)
        np.divide(p.weight, total, out=out, where=p.valid[box])
        return out

    def pairs(self) -> list[tuple[int, int, Box, Box, Box]]:
        """Return each ordered pair once, with i = j, and its windows."""
        own = [
            (k, k, _WHOLE, _WHOLE, (p.rows, p.columns)) for k, p in enumerate(self.layout.placed)
        ]
        return own + [(o.i, o.j, o.in_i, o.in_j, o.in_all) for o in self.overlaps]


def freedom_features(layout: Layout, freedoms: tuple[str, ...], *, line: bool) -> Features:
    """Return the columns of the freedoms: 1, tilts, power, each about the centre and scaled.

    Parameters
    ----------
    layout : Layout
        Sub-apertures.
    freedoms : tuple of str
        ``piston``, ``tilt``, ``power``.
    line : bool
        Whether there is only x.

    Returns
    -------
    callable
        Features of a sub-aperture in a window.
    """
    halves = [half_size(p) for p in layout.placed]
    kept: dict[int, FloatArray] = {}
    small = sum(p.valid.size for p in layout.placed) <= _MOST_KEPT

    def features(k: int, box: Box) -> FloatArray:
        if box != _WHOLE or not small:
            return make(k, box)
        if k not in kept:
            kept[k] = make(k, box)
        return kept[k]

    def make(k: int, box: Box) -> FloatArray:
        p, h = layout.placed[k], halves[k]
        u, v = (c / h for c in np.broadcast_arrays(*p.position(box)))
        out = []
        if "piston" in freedoms:
            out.append(np.ones_like(u))
        if "tilt" in freedoms:
            out += [u] if line else [u, v]
        if "power" in freedoms:
            out.append(u**2 if line else u**2 + v**2)
        return np.stack(out)

    return features


def half_size(piece: Placed) -> float:
    """Return half the longer side of a sub-aperture, the scale of its coordinates."""
    return max(float(np.abs(piece.x).max()), float(np.abs(piece.y).max()))


def mean_of(problem: Problem, values: list[FloatArray]) -> FloatArray:
    """Return the weighted mean of windows at each pixel; NaN where nothing was measured."""
    placed = problem.layout.placed
    summed = problem.layout.total(
        [p.weight * np.where(p.valid, v, 0.0) for p, v in zip(placed, values, strict=True)]
    )
    out = np.full(summed.shape, np.nan)
    np.divide(summed, problem.weight, out=out, where=problem.weight > 0.0)
    return out


def normal_matrix(problem: Problem) -> FloatArray:
    """Return the normal equations of the freedoms, the surface eliminated."""
    matrix = np.zeros((problem.n_columns, problem.n_columns))
    with one_blas_thread():
        for i, j, box_i, box_j, _ in problem.pairs():
            weight = problem.layout.placed[i].weight
            share = weight * problem.share(j, box_j) * problem.layout.placed[i].valid[box_i]
            f_i = _flat(problem.features(i, box_i))
            if i == j:
                own = weight * problem.layout.placed[i].valid - share
                block = (f_i * own.ravel()) @ f_i.T
                matrix[np.ix_(problem.columns[i], problem.columns[i])] += block
                continue
            f_j = _flat(problem.features(j, box_j))
            block = (f_i * share.ravel()) @ f_j.T
            matrix[np.ix_(problem.columns[i], problem.columns[j])] -= block
            matrix[np.ix_(problem.columns[j], problem.columns[i])] -= block.T
    return matrix


def right_side(problem: Problem, values: list[FloatArray], mean: FloatArray) -> FloatArray:
    """Return the other side of the normal equations for given windows and their mean."""
    out = np.zeros(problem.n_columns)
    for k, (p, v) in enumerate(zip(problem.layout.placed, values, strict=True)):
        d = p.weight * np.where(p.valid, v - mean[p.rows, p.columns], 0.0)
        out[problem.columns[k]] += _flat(problem.features(k, _WHOLE)) @ d.ravel()
    return out


@dataclass(frozen=True, slots=True)
class Inverse:
    """The inverse of a normal matrix on what it determines.

    Parameters
    ----------
    matrix : ndarray, shape (n, n)
        Pseudo-inverse: covariance for noise of one.
    null : ndarray, shape (n, m)
        What is not determined, as columns.
    """

    matrix: FloatArray
    null: FloatArray

    @property
    def rank(self) -> int:
        """Number of determined combinations."""
        return int(self.matrix.shape[0] - self.null.shape[1])


def inverse_of(matrix: FloatArray) -> Inverse:
    """Return the pseudo-inverse of a normal matrix with its columns scaled to one."""
    size = np.diag(matrix)
    scale = np.sqrt(np.where(size > 1e-12 * size.max(), size, size.max()))
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    good = values > _NULL * values[-1]
    kept = vectors[:, good] / scale[:, None]
    return Inverse((kept / values[good]) @ kept.T, vectors[:, ~good] / scale[:, None])


def require_rank(inverse: Inverse, problem: Problem, expected: int) -> None:
    """Refuse overlaps that leave more open than the position of the whole.

    Parameters
    ----------
    inverse : Inverse
        Of the freedoms.
    problem : Problem
        The design.
    expected : int
        How many combinations are always open.

    Raises
    ------
    DegenerateFitError
        If more are; the sub-aperture concerned is named.
    """
    extra = inverse.null.shape[1] - expected
    if extra <= 0:
        return
    counts = np.zeros(len(problem.columns))
    for o in problem.overlaps:
        counts[[o.i, o.j]] += o.n
    worst = int(np.argmin(counts))
    raise DegenerateFitError(
        f"stitch: the overlaps leave {extra} freedoms undetermined (sub-aperture {worst + 1} shares "
        f"the fewest samples, {int(counts[worst])}): an overlap of one row of pixels fixes no tilt. "
        "Overlap more, or allow fewer freedoms"
    )


def fitted_pieces(
    problem: Problem, values: list[FloatArray], theta: FloatArray
) -> list[FloatArray]:
    """Return windows without their freedoms."""
    return [
        v - np.tensordot(theta[problem.columns[k]], problem.features(k, _WHOLE), axes=1)
        for k, v in enumerate(values)
    ]


def own_residuals(problem: Problem, fitted: list[FloatArray]) -> FloatArray:
    """Return the RMS of each overlap's difference after freedoms of its own, per reading.

    A wrong sub-aperture spreads over its neighbours in the common solution; here it does not.
    """
    out = []
    for o in problem.overlaps:
        a, b = problem.layout.placed[o.i], problem.layout.placed[o.j]
        both = a.valid[o.in_i] & b.valid[o.in_j]
        d = (fitted[o.i][o.in_i] - fitted[o.j][o.in_j])[both]
        f = problem.features(o.i, o.in_i)[:, both]
        n_own = min(f.shape[0], max(d.size - 1, 0))
        f = f[:n_own]
        rest = d - np.linalg.lstsq(f @ f.T, f @ d, rcond=1e-12)[0] @ f if n_own else d
        share = (1.0 / a.weight + 1.0 / b.weight) * max(d.size - n_own, 1)
        out.append(math.sqrt(float(rest @ rest) / share))
    return np.array(out)


def noise_of(
    problem: Problem, fitted: list[FloatArray], mean: FloatArray, rank: int
) -> tuple[float, float]:
    """Return the standard deviation of a reading from the overlaps, and its degrees of freedom."""
    squares, count = 0.0, 0.0
    for p, f in zip(problem.layout.placed, fitted, strict=True):
        d = np.where(p.valid, f - mean[p.rows, p.columns], 0.0)
        squares += p.weight * float(np.vdot(d, d))
        count += float(p.valid.sum())
    freedom = count - float((problem.weight > 0).sum()) - rank
    return (math.sqrt(squares / freedom) if freedom >= 1.0 else math.nan), freedom


def variance_map(problem: Problem, covariance: FloatArray, basis: FloatArray) -> FloatArray:
    """Return the variance of the stitched surface for noise of one, a basis removed from it.

    Parameters
    ----------
    problem : Problem
        The design.
    covariance : ndarray, shape (n_columns, n_columns)
        Of the freedoms.
    basis : ndarray, shape (n_basis, grid)
        What is removed by least squares over the measured pixels.

    Returns
    -------
    ndarray, shape (grid)
        NaN where nothing was measured.
    """
    measured = problem.weight > 0.0
    own = np.zeros(problem.weight.shape)
    np.divide(1.0, problem.weight, out=own, where=measured)
    with one_blas_thread():
        b = basis[:, measured]
        gram = np.linalg.pinv(b @ b.T)
        leak = gram @ _basis_of_freedoms(problem, basis)
        middle = gram @ ((b * own[measured]) @ b.T) @ gram + leak @ covariance @ leak.T
        out = own + _quadratic(problem, covariance)
        out[measured] += np.einsum("ip,ij,jp->p", b, middle, b, optimize=True)
        out[measured] -= 2.0 * own[measured] * np.einsum("ip,ij,jp->p", b, gram, b, optimize=True)
        cross = leak @ covariance
        for k, p in enumerate(problem.layout.placed):
            mixed = np.tensordot(cross[:, problem.columns[k]], problem.features(k, _WHOLE), axes=1)
            mixed = (mixed * basis[:, p.rows, p.columns]).sum(axis=0)
            out[p.rows, p.columns] -= 2.0 * problem.share(k) * mixed
    return np.where(measured, np.maximum(out, 0.0), np.nan)


def _basis_of_freedoms(problem: Problem, basis: FloatArray) -> FloatArray:
    out = np.zeros((basis.shape[0], problem.n_columns))
    for k, p in enumerate(problem.layout.placed):
        weighted = _flat(basis[:, p.rows, p.columns] * problem.share(k))
        out[:, problem.columns[k]] += weighted @ _flat(problem.features(k, _WHOLE)).T
    return out


def _quadratic(problem: Problem, covariance: FloatArray) -> FloatArray:
    """Return the variance that the freedoms bring to the mean, before anything is removed."""
    out = np.zeros(problem.weight.shape)
    for i, j, box_i, box_j, box in problem.pairs():
        block = covariance[np.ix_(problem.columns[i], problem.columns[j])]
        f_i, f_j = problem.features(i, box_i), problem.features(j, box_j)
        term = (np.tensordot(block.T, f_i, axes=1) * f_j).sum(axis=0)
        term *= problem.share(i, box_i) * problem.share(j, box_j)
        out[box] += term if i == j else 2.0 * term
    return out


def _flat(values: FloatArray) -> FloatArray:
    return values.reshape(values.shape[0], -1)
