"""Least squares of all overlaps at once: freedoms of each sub-aperture, their covariance, the mean.

A reading is ``m_i = s + F_i theta + noise``. The surface s has one unknown in each pixel; it is
eliminated there (weighted mean), which leaves small normal equations, summed over the overlaps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import DegenerateFitError
from metrosep.separation._overlaps import Overlap
from metrosep.separation._stitch_grid import Layout, Placed
from metrosep.separation._stitch_terms import WHOLE, Box, PolynomialTerms, Terms

_NULL = 1e-11
"""Eigenvalue of the scaled normal matrix, relative to the largest, below which it is zero."""


@dataclass(frozen=True, slots=True)
class Problem:
    """The design of a stitching."""

    layout: Layout  # sub-apertures on the grid
    overlaps: tuple[Overlap, ...]  # pairs
    terms: Terms  # the columns of each sub-aperture
    columns: list[NDArray[np.int64]]  # of ndarray of int: where they stand among all unknowns
    n_columns: int  # number of unknowns
    weight: FloatArray  # shape (grid): sum of the weights at each pixel
    inverse_weight: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        out = np.zeros(self.weight.shape)
        np.divide(1.0, self.weight, out=out, where=self.weight > 0.0)
        object.__setattr__(self, "inverse_weight", out)

    def share(self, k: int) -> FloatArray:
        """Return the share ``w_i / sum w`` of a sub-aperture in the mean; 0 where not measured."""
        p = self.layout.placed[k]
        return np.asarray(self.inverse_weight[p.rows, p.columns] * p.weight * p.valid)

    def both(self, i: int, j: int, in_i: Box, in_j: Box, in_all: Box) -> FloatArray:
        """Return ``1 / sum w`` where two sub-apertures have measured, 0 elsewhere."""
        a, b = self.layout.placed[i], self.layout.placed[j]
        return np.asarray(self.inverse_weight[in_all] * (a.valid[in_i] & b.valid[in_j]))

    def pairs(self) -> list[tuple[int, int, Box, Box, Box]]:
        """Return each ordered pair once, with i = j, and its windows."""
        own = [(k, k, WHOLE, WHOLE, (p.rows, p.columns)) for k, p in enumerate(self.layout.placed)]
        return own + [(o.i, o.j, o.in_i, o.in_j, o.in_all) for o in self.overlaps]


def freedom_terms(layout: Layout, freedoms: tuple[str, ...], *, line: bool) -> PolynomialTerms:
    """Return the columns of the freedoms: 1, tilts, power, each about the centre and scaled."""
    halves = [half_size(p) for p in layout.placed]

    def make(k: int, x: FloatArray, y: FloatArray) -> FloatArray:
        u, v = x / halves[k], y / halves[k]
        out = []
        if "piston" in freedoms:
            out.append(np.ones_like(u))
        if "tilt" in freedoms:
            out += [u] if line else [u, v]
        if "power" in freedoms:
            out.append(u**2 if line else u**2 + v**2)
        return np.stack(out)

    return PolynomialTerms(layout, make, 2 if "power" in freedoms else 1)


def half_size(piece: Placed) -> float:
    """Return half the longer side of a sub-aperture, the scale of its coordinates."""
    return max(float(np.abs(piece.x).max()), float(np.abs(piece.y).max()))


def mean_of(problem: Problem, values: list[FloatArray]) -> FloatArray:
    """Return the weighted mean of windows at each pixel; NaN where nothing was measured."""
    summed = np.zeros(problem.weight.shape)
    for p, v in zip(problem.layout.placed, values, strict=True):
        window = summed[p.rows, p.columns]
        np.add(window, v if p.weight == 1.0 else p.weight * v, out=window, where=p.valid)
    summed *= problem.inverse_weight
    summed[problem.weight <= 0.0] = np.nan
    return summed


def normal_matrix(problem: Problem) -> FloatArray:
    """Return the normal equations of the freedoms, the surface eliminated."""
    matrix = np.zeros((problem.n_columns, problem.n_columns))
    placed = problem.layout.placed
    with one_blas_thread():
        for i, j, in_i, in_j, in_all in problem.pairs():
            both = problem.both(i, j, in_i, in_j, in_all)
            if i == j:
                w = placed[i].weight
                own = w * (placed[i].valid - w * both)
                block = problem.terms.gram(i, WHOLE, i, WHOLE, own)
                matrix[np.ix_(problem.columns[i], problem.columns[i])] += block
                continue
            both *= placed[i].weight * placed[j].weight
            block = problem.terms.gram(i, in_i, j, in_j, both)
            matrix[np.ix_(problem.columns[i], problem.columns[j])] -= block
            matrix[np.ix_(problem.columns[j], problem.columns[i])] -= block.T
    return matrix


def right_side(problem: Problem, values: list[FloatArray], mean: FloatArray) -> FloatArray:
    """Return the other side of the normal equations for given windows and their mean."""
    out = np.zeros(problem.n_columns)
    for k, (p, v) in enumerate(zip(problem.layout.placed, values, strict=True)):
        d = np.zeros(v.shape)
        np.subtract(v, mean[p.rows, p.columns], out=d, where=p.valid)
        out[problem.columns[k]] += p.weight * problem.terms.project(k, d)
    return out


@dataclass(frozen=True, slots=True)
class Inverse:
    """The inverse of a normal matrix on what it determines."""

    matrix: FloatArray  # shape (n, n): pseudo-inverse: covariance for noise of one
    null: FloatArray  # shape (n, m): what is not determined, as columns

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
    """Refuse overlaps that leave more open than the position of the whole."""
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
        v - problem.terms.combine(k, theta[problem.columns[k]][None])[0]
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
        d = np.zeros(both.shape)
        np.subtract(fitted[o.i][o.in_i], fitted[o.j][o.in_j], out=d, where=both)
        own = problem.terms.project(o.i, d, o.in_i)
        n_own = min(own.size, max(o.n - 1, 0))
        gram = problem.terms.gram(o.i, o.in_i, o.i, o.in_i, both.astype(np.float64))
        found = np.zeros(own.size)
        found[:n_own] = np.linalg.lstsq(gram[:n_own, :n_own], own[:n_own], rcond=1e-12)[0]
        rest = d - problem.terms.combine(o.i, found[None], o.in_i)[0] * both
        share = (1.0 / a.weight + 1.0 / b.weight) * max(o.n - n_own, 1)
        out.append(math.sqrt(float(np.vdot(rest, rest)) / share))
    return np.array(out)


def noise_of(
    problem: Problem, fitted: list[FloatArray], mean: FloatArray, rank: int
) -> tuple[float, float]:
    """Return the standard deviation of a reading from the overlaps, and its degrees of freedom."""
    squares, count = 0.0, 0.0
    for p, f in zip(problem.layout.placed, fitted, strict=True):
        d = np.zeros(f.shape)
        np.subtract(f, mean[p.rows, p.columns], out=d, where=p.valid)
        squares += p.weight * float(np.vdot(d, d))
        count += float(p.valid.sum())
    freedom = count - float((problem.weight > 0).sum()) - rank
    return (math.sqrt(squares / freedom) if freedom >= 1.0 else math.nan), freedom


def variance_map(problem: Problem, covariance: FloatArray, basis: FloatArray) -> FloatArray:
    """Return the variance of the stitched surface for noise of one, a basis removed from it."""
    measured = problem.weight > 0.0
    own = problem.inverse_weight
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
            mixed = problem.terms.combine(k, cross[:, problem.columns[k]])
            mixed = (mixed * basis[:, p.rows, p.columns]).sum(axis=0)
            out[p.rows, p.columns] -= 2.0 * problem.share(k) * mixed
    return np.where(measured, np.maximum(out, 0.0), np.nan)


def _basis_of_freedoms(problem: Problem, basis: FloatArray) -> FloatArray:
    out = np.zeros((basis.shape[0], problem.n_columns))
    for k, p in enumerate(problem.layout.placed):
        share = problem.share(k)
        for row, b in zip(out, basis, strict=True):
            row[problem.columns[k]] += problem.terms.project(k, b[p.rows, p.columns] * share)
    return out


def _quadratic(problem: Problem, covariance: FloatArray) -> FloatArray:
    """Return the variance that the freedoms bring to the mean, before anything is removed."""
    out = np.zeros(problem.weight.shape)
    placed = problem.layout.placed
    for i, j, in_i, in_j, in_all in problem.pairs():
        block = covariance[np.ix_(problem.columns[i], problem.columns[j])]
        term = problem.terms.quadratic(i, in_i, j, in_j, block)
        term *= problem.both(i, j, in_i, in_j, in_all) * problem.inverse_weight[in_all]
        term *= (1.0 if i == j else 2.0) * placed[i].weight * placed[j].weight
        out[in_all] += term
    return out
