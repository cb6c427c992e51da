"""Least squares of all overlaps at once: freedoms of each sub-aperture, their covariance, the mean.

A reading is ``m_i = s + F_i theta + noise``. The surface s has one unknown in each pixel; it is
eliminated there (weighted mean), which leaves small normal equations, summed over the overlaps.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import DegenerateFitError, NotConvergedError
from metrosep.separation.maps._stitch_grid import Layout, Overlap, Placed

_NULL = 1e-11
"""Eigenvalue of the scaled normal matrix, relative to the largest, below which it is zero."""


@dataclass(frozen=True, slots=True)
class Problem:
    """The design of a stitching: columns of each sub-aperture, and behind them those that all share."""

    layout: Layout  # sub-apertures on the grid
    overlaps: tuple[Overlap, ...]  # pairs
    terms: Terms  # the columns of each sub-aperture, its own and the shared ones
    n_shared: int = 0
    columns: list[NDArray[np.int64]] = field(init=False)  # where they stand among all unknowns
    n_columns: int = field(init=False)  # number of unknowns
    weight: FloatArray = field(init=False)  # shape (grid): sum of the weights at each pixel
    inverse_weight: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        n, each = len(self.layout.placed), self.terms.count - self.n_shared
        shared = n * each + np.arange(self.n_shared)
        weight = self.layout.weights()
        for name, value in (
            ("columns", [np.append(k * each + np.arange(each), shared) for k in range(n)]),
            ("n_columns", n * each + self.n_shared),
            ("weight", weight),
            ("inverse_weight", np.divide(1, weight, out=np.zeros_like(weight), where=weight > 0)),
        ):
            object.__setattr__(self, name, value)

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
    """Return the columns of the freedoms, about the centre of each sub-aperture and scaled."""
    halves = [half_size(p) for p in layout.placed]

    def make(k: int, x: FloatArray, y: FloatArray) -> FloatArray:
        return freedom_maps(x / halves[k], y / halves[k], freedoms, line=line)

    return PolynomialTerms(layout, make, 2 if "power" in freedoms else 1)


def freedom_maps(
    u: FloatArray, v: FloatArray, freedoms: tuple[str, ...], *, line: bool
) -> FloatArray:
    """Return 1, the tilts and the power at scaled positions, as far as they are freedoms."""
    out = [np.ones_like(u)] if "piston" in freedoms else []
    if "tilt" in freedoms:
        out += [u] if line else [u, v]
    if "power" in freedoms:
        out.append(u**2 if line else u**2 + v**2)
    return np.stack(out)


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


def fitted_to(
    problem: Problem, inverse: Inverse, values: list[FloatArray]
) -> tuple[FloatArray, list[FloatArray], FloatArray]:
    """Return the freedoms, the windows without them, and the mean of these windows."""
    theta = inverse.matrix @ right_side(problem, values, mean_of(problem, values))
    fitted = [
        v - problem.terms.combine(k, theta[columns][None])[0]
        for k, (v, columns) in enumerate(zip(values, problem.columns, strict=True))
    ]
    return theta, fitted, mean_of(problem, fitted)


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


# ---- columns of a stitching's design: polynomials as products of two axes, or any windows ------
# A polynomial of x and y, turned or not, is a short sum of products of Legendre polynomials along the
# columns and along the rows of a window. Sums over its pixels then need one product of small matrices
# with the window of weights, and no column is ever written out. Nothing is approximated by this.

Box = tuple[slice, slice]
Make = Callable[[int, FloatArray, FloatArray], FloatArray]
"""Index of a sub-aperture, x and y in its instrument's frame -> (n_columns, ...)."""

WHOLE: Box = (slice(None), slice(None))


class Terms:
    """The columns of each sub-aperture, by what is done with them; here they are given as windows."""

    def __init__(self, make: Callable[[int, Box], FloatArray]) -> None:
        self._windows = make

    @property
    def count(self) -> int:
        """Number of columns of each sub-aperture."""
        return int(self.values(0, (slice(0, 1), slice(0, 1))).shape[0])

    def values(self, k: int, box: Box = WHOLE) -> FloatArray:
        """Return the columns in a part of a window, shape (n, rows, columns)."""
        return self._windows(k, box)

    def gram(self, i: int, in_i: Box, j: int, in_j: Box, weight: FloatArray) -> FloatArray:
        """Return ``sum of f_i weight f_j`` over a common part, shape (n_i, n_j)."""
        f_i = _flat(self.values(i, in_i))
        f_j = f_i if i == j and in_i == in_j else _flat(self.values(j, in_j))
        return np.asarray((f_i * weight.ravel()) @ f_j.T)

    def project(self, k: int, window: FloatArray, box: Box = WHOLE) -> FloatArray:
        """Return ``sum of f_k window`` over a part, shape (n,)."""
        return np.asarray(_flat(self.values(k, box)) @ window.ravel())

    def combine(self, k: int, factors: FloatArray, box: Box = WHOLE) -> FloatArray:
        """Return ``factors @ f_k`` for factors of shape (m, n): shape (m, rows, columns)."""
        return np.asarray(np.tensordot(factors, self.values(k, box), axes=1))

    def quadratic(self, i: int, in_i: Box, j: int, in_j: Box, block: FloatArray) -> FloatArray:
        """Return ``f_i block f_j`` at each pixel of a common part."""
        f_i, f_j = self.values(i, in_i), self.values(j, in_j)
        return np.asarray((np.tensordot(block.T, f_i, axes=1) * f_j).sum(axis=0))


@dataclass(frozen=True, slots=True)
class _Table:
    """One sub-aperture: columns ``f = sum of factor[f, b, a] along_y[b] along_x[a]``."""

    factor: FloatArray
    along_y: FloatArray
    along_x: FloatArray


class PolynomialTerms(Terms):
    """Columns that are polynomials of x and y: no window of them is ever written out."""

    def __init__(self, layout: Layout, make: Make, degree: int) -> None:
        self.layout, self.make, self.degree = layout, make, degree
        self._tables: dict[int, _Table] = {}

    def _table(self, k: int) -> _Table:
        if k not in self._tables:
            self._tables[k] = self._made(k, self.layout.placed[k])
        return self._tables[k]

    def _made(self, k: int, piece: Placed) -> _Table:
        n_y, n_x = piece.valid.shape
        nodes_y, along_y, from_y = _axis(n_y, self.degree)
        nodes_x, along_x, from_x = _axis(n_x, self.degree)
        x, y = (_affine(c, piece.valid.shape, nodes_x, nodes_y) for c in (piece.x, piece.y))
        values = self.make(k, x, y)
        return _Table(np.asarray(from_y @ values @ from_x.T), along_y, along_x)

    def values(self, k: int, box: Box = WHOLE) -> FloatArray:
        """Return the columns in a part of a window."""
        t = self._table(k)
        return np.asarray(t.along_y[:, box[0]].T @ t.factor @ t.along_x[:, box[1]])

    def gram(self, i: int, in_i: Box, j: int, in_j: Box, weight: FloatArray) -> FloatArray:
        """Return the weighted sums of products."""
        first, second = self._table(i), self._table(j)
        base_y, pair_y = _products(first.along_y[:, in_i[0]], second.along_y[:, in_j[0]])
        base_x, pair_x = _products(first.along_x[:, in_i[1]], second.along_x[:, in_j[1]])
        sums = (base_y.T @ weight) @ base_x
        moments = np.tensordot(pair_y @ sums, pair_x, axes=([2], [2]))  # b, d, a, c
        half = np.tensordot(first.factor, moments, axes=([1, 2], [0, 2]))
        return np.asarray(np.tensordot(half, second.factor, axes=([1, 2], [1, 2])))

    def project(self, k: int, window: FloatArray, box: Box = WHOLE) -> FloatArray:
        """Return the sums of products with a window."""
        t = self._table(k)
        sums = (t.along_y[:, box[0]] @ window) @ t.along_x[:, box[1]].T
        return np.asarray(np.tensordot(t.factor, sums, axes=2))

    def combine(self, k: int, factors: FloatArray, box: Box = WHOLE) -> FloatArray:
        """Return sums of columns."""
        t = self._table(k)
        inner = np.tensordot(factors, t.factor, axes=1)
        return np.asarray(t.along_y[:, box[0]].T @ (inner @ t.along_x[:, box[1]]))

    def quadratic(self, i: int, in_i: Box, j: int, in_j: Box, block: FloatArray) -> FloatArray:
        """Return a bilinear form at each pixel."""
        first, second = self._table(i), self._table(j)
        base_y, pair_y = _products(first.along_y[:, in_i[0]], second.along_y[:, in_j[0]])
        base_x, pair_x = _products(first.along_x[:, in_i[1]], second.along_x[:, in_j[1]])
        form = np.tensordot(
            np.tensordot(first.factor, block, axes=([0], [0])), second.factor, axes=1
        )  # b, a, d, c
        inner = np.tensordot(form, pair_y, axes=([0, 2], [0, 1]))  # a, c, r
        inner = np.tensordot(inner, pair_x, axes=([0, 1], [0, 1]))  # r, q
        return np.asarray((base_y @ inner) @ base_x.T)


def _axis(n: int, degree: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return nodes, Legendre polynomials at the pixels, and what turns node values to factors."""
    from numpy.polynomial.legendre import leggauss, legvander

    pixels = np.linspace(-1.0, 1.0, n) if n > 1 else np.zeros(1)
    top = min(degree, n - 1)
    nodes = pixels if n <= degree + 1 else leggauss(degree + 1)[0]
    from_nodes = np.asarray(np.linalg.inv(legvander(nodes, top)), dtype=np.float64)
    along = np.asarray(legvander(pixels, top).T, dtype=np.float64)
    return np.asarray(nodes, dtype=np.float64), along, from_nodes


def _affine(
    c: FloatArray, shape: tuple[int, ...], nodes_x: FloatArray, nodes_y: FloatArray
) -> FloatArray:
    """Return a coordinate, linear over a window, at nodes of -1 ... 1 along both sides."""
    full = np.broadcast_to(c, shape)
    along_x, along_y = (full[0, -1] - full[0, 0]) / 2.0, (full[-1, 0] - full[0, 0]) / 2.0
    middle = full[0, 0] + along_x + along_y
    return np.asarray(middle + along_x * nodes_x + along_y * nodes_y[:, None])


def _products(first: FloatArray, second: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return an orthonormal basis of all products of two axes' polynomials, and their factors."""
    base = _orthonormal(first.shape[1], first.shape[0] + second.shape[0] - 2)
    return base, np.asarray((first[:, None, :] * second) @ base)


@lru_cache(maxsize=256)
def _orthonormal(n: int, degree: int) -> FloatArray:
    from numpy.polynomial.legendre import legvander

    pixels = np.linspace(-1.0, 1.0, n) if n > 1 else np.zeros(1)
    base = np.asarray(np.linalg.qr(legvander(pixels, min(degree, n - 1)))[0], dtype=np.float64)
    base.setflags(write=False)
    return base


def _flat(values: FloatArray) -> FloatArray:
    return values.reshape(values.shape[0], -1)


# ---- the normal equations of a reference's pixels, applied and solved by conjugate gradients ----
# Surface and freedoms are eliminated: what is left acts on the pixels of the instrument alone. A step
# costs a few passes over the readings; the freedoms enter by a matrix that is made once. Pixels that
# interpolation reaches with small weights only, most of them at the rim, tie to their neighbours more
# than to themselves; their own block is solved by elimination in the preconditioner.

_MOST_STEPS, _FEWEST_STEPS = 6000, 300
_MOST_WORK = 3e9
"""Steps times pixels of all sub-apertures, some minutes, after which the iteration gives up."""

_MOST_KEPT = 30_000_000
"""Numbers of the freedoms' matrix (240 MB) up to which it is made; beyond, it is applied piece by piece."""

_FREE = 1e-9
_WEAK = 0.6
"""Share of the median of the diagonal below which a pixel counts as weakly tied."""

_MOST_WEAK = 100_000

_EXACT, _INTERPOLATED = 1e-9, 1e-6
"""Residual, relative to the right side, at which the iteration ends.

Between pixels a few patterns at the rim are nearly free and would take a thousand steps more; their
pixels are not given anyway.
"""

_PROBES = 2
_OF_PROBES = 1e-7


class ReferenceSystem:
    """What neither surface nor freedoms explain of a reference, as equations for its pixels."""

    def __init__(self, problem: Problem, inverse: Inverse, shape: tuple[int, int]) -> None:
        self.problem, self.inverse, self.shape = problem, inverse, shape
        self.placed = problem.layout.placed
        self.weights = [p.weight * p.valid for p in self.placed]
        self.diagonal = information(problem, shape)
        largest = max(float(self.diagonal.max()), np.finfo(float).tiny)
        self.free = self.diagonal > _FREE * largest
        small = problem.n_columns * self.free.size <= _MOST_KEPT
        with one_blas_thread():
            self.coupling = self._coupling() if small else None
        # on its own pixels, all that are free measured: zeros elsewhere, or cut off at the end
        self.plain = [
            not p.operator and p.weight == 1.0 and bool(p.valid[self.free].all())
            for p in self.placed
        ]
        self.interpolated = any(p.operator for p in self.placed)
        median = float(np.median(self.diagonal[self.free])) if self.free.any() else 0.0
        self.weak: NDArray[np.bool_] = (
            self.free & (self.diagonal < _WEAK * median) & self.interpolated
        )
        self.relax = self._preconditioner()
        self.steps = 0

    def left(self, windows: list[FloatArray]) -> FloatArray:
        """Return what readings say of the free pixels: the right side of the equations."""
        clean = [np.where(p.valid, w, 0.0) for p, w in zip(self.placed, windows, strict=True)]
        rests = self._without_mean(clean)
        right = np.zeros(self.problem.n_columns)
        for k, rest in enumerate(rests):
            right[self.problem.columns[k]] += self.problem.terms.project(k, rest)
        return self._spread(rests) - self._freedoms(self.inverse.matrix @ right)

    def apply(self, reference: FloatArray) -> FloatArray:
        """Return the equations' left side for a reference that is zero where not free."""
        windows = [p.forward(reference) for p in self.placed]
        if self.coupling is None:
            return self.left(windows)
        out = self._own(reference, windows)
        with one_blas_thread():
            right = self.coupling @ reference.ravel()
            out -= ((self.inverse.matrix @ right) @ self.coupling).reshape(self.shape)
        return out

    def solve(self, right: FloatArray, tolerance: float | None = None) -> FloatArray:
        """Return the reference, by conjugate gradients."""
        found, rest = np.zeros(self.shape), right.copy()
        if tolerance is None:
            tolerance = _INTERPOLATED if self.interpolated else _EXACT
        goal = tolerance * float(np.linalg.norm(rest))
        if goal == 0.0:
            return found
        z = self.relax(rest)
        way, old = z.copy(), float(np.vdot(rest, z))
        work = sum(p.valid.size for p in self.placed)
        n_steps = int(min(_MOST_STEPS, max(_FEWEST_STEPS, _MOST_WORK / work)))
        for count in range(n_steps):
            step = self.apply(way)
            length = old / float(np.vdot(way, step))
            found += length * way
            rest -= length * step
            if float(np.linalg.norm(rest)) <= goal:
                self.steps = max(self.steps, count + 1)
                return found
            z = self.relax(rest)
            new = float(np.vdot(rest, z))
            way *= new / old
            way += z
            old = new
        raise NotConvergedError(
            f"stitch: the reference map did not settle in {n_steps} steps: these shifts hardly determine it "
            "pixel by pixel. Shift more often, by different amounts below half of the aperture, bin the "
            "maps, or fit a polynomial (reference_degree=6)"
        )

    def probes(self) -> Iterator[tuple[list[FloatArray], FloatArray, FloatArray]]:
        """Yield readings of random references without noise, the references, what comes back.

        At the rim of an interpolated map there are more pixels than readings: what a reading lacks
        is taken by pixels that only outer lobes of the interpolation reach.
        """
        rng = np.random.default_rng(1)
        for _ in range(_PROBES if self.interpolated else 0):
            truth = rng.standard_normal(self.shape)
            readings = [p.forward(truth) for p in self.placed]
            yield readings, truth, self.solve(self.left(readings), _OF_PROBES)

    def _own(self, reference: FloatArray, windows: list[FloatArray]) -> FloatArray:
        """Return the equations without freedoms; unweighted windows are added as they are."""
        mean, out = np.zeros(self.problem.weight.shape), np.zeros(self.shape)
        for p, w, v, plain in zip(self.placed, self.weights, windows, self.plain, strict=True):
            mean[p.rows, p.columns] += v if plain else w * v
        mean *= self.problem.inverse_weight
        for p, w, v, plain in zip(self.placed, self.weights, windows, self.plain, strict=True):
            if plain:
                out -= mean[p.rows, p.columns]
                continue
            rest = v - mean[p.rows, p.columns]
            rest *= w
            out += p.adjoint(rest, self.shape)
        if any(self.plain):
            out += sum(self.plain) * reference
        out *= self.free
        return out

    def _without_mean(self, windows: list[FloatArray]) -> list[FloatArray]:
        """Return weight times what is left of windows, finite ones, after their mean."""
        mean = np.zeros(self.problem.weight.shape)
        for p, w, v in zip(self.placed, self.weights, windows, strict=True):
            mean[p.rows, p.columns] += w * v
        mean *= self.problem.inverse_weight
        out = []
        for p, w, v in zip(self.placed, self.weights, windows, strict=True):
            rest = v - mean[p.rows, p.columns]
            rest *= w
            out.append(rest)
        return out

    def _spread(self, windows: list[FloatArray]) -> FloatArray:
        """Return windows put back on the pixels of the instrument."""
        out = np.zeros(self.shape)
        for p, w in zip(self.placed, windows, strict=True):
            out += p.adjoint(w, self.shape)
        out *= self.free
        return out

    def _freedoms(self, theta: FloatArray) -> FloatArray:
        if self.coupling is not None:
            return np.asarray((theta @ self.coupling).reshape(self.shape))
        columns, terms = self.problem.columns, self.problem.terms
        windows = [terms.combine(k, theta[c][None])[0] for k, c in enumerate(columns)]
        return self._spread(self._without_mean(windows))

    def _coupling(self) -> FloatArray:
        """Return what each freedom does to the free pixels, shape (n_columns, pixels)."""
        problem = self.problem
        out = np.zeros((problem.n_columns, *self.shape))
        for i, j, in_i, in_j, in_all in problem.pairs():
            both = problem.both(i, j, in_i, in_j, in_all)
            for k, box_k, other, box in ((i, in_i, j, in_j), (j, in_j, i, in_i))[: 1 + (i != j)]:
                share = both * (self.placed[k].weight * self.placed[other].weight)
                window = np.zeros(self.placed[other].valid.shape)
                for c, f in zip(problem.columns[k], problem.terms.values(k, box_k), strict=True):
                    window[box] = -share * f
                    if i == j:
                        window += self.weights[i] * f
                    out[c] += self.placed[other].adjoint(window, self.shape)
        out *= self.free
        return out.reshape(problem.n_columns, -1)

    def _preconditioner(self) -> Callable[[FloatArray], FloatArray]:
        scale = np.where(self.free, 1.0 / np.where(self.free, self.diagonal, 1.0), 0.0)
        weak, chosen = self.weak, np.flatnonzero(self.weak)
        if chosen.size == 0 or chosen.size > _MOST_WEAK:
            return lambda rest: scale * rest
        from scipy.sparse.linalg import splu

        factors = splu(self._block(chosen).tocsc())
        scale[weak] = 0.0

        def relax(rest: FloatArray) -> FloatArray:
            out = scale * rest
            out[weak] = factors.solve(rest[weak])
            return out

        return relax

    def _block(self, chosen: NDArray[np.intp]) -> Any:
        """Return the equations among some pixels, as far as each reading by itself gives them."""
        from scipy import sparse

        out = sparse.csr_matrix((chosen.size, chosen.size))
        for k, p in enumerate(self.placed):
            own = np.sqrt(np.maximum(p.weight * (p.valid - self.problem.share(k)), 0.0)).ravel()
            matrix = sparse.diags(own) @ _columns(p, chosen, self.shape)
            out = out + matrix.T @ matrix
        return out


def information(problem: Problem, shape: tuple[int, int]) -> FloatArray:
    """Return how often each pixel of the instrument is compared, a reading of it counting one."""
    out = np.zeros(shape)
    for k, p in enumerate(problem.layout.placed):
        squared = replace(p, operator=tuple(m.multiply(m).tocsr() for m in p.operator))
        out += squared.adjoint(p.weight * (p.valid - problem.share(k)), shape)
    return out


def _columns(piece: Placed, chosen: NDArray[np.intp], shape: tuple[int, int]) -> Any:
    """Return the interpolation of a few pixels, shape (window, k)."""
    from scipy import sparse

    if not piece.operator:
        return sparse.identity(shape[0] * shape[1], format="csc")[:, chosen]
    if len(piece.operator) == 1:
        return piece.operator[0].tocsc()[:, chosen]
    along_y, along_x = (m.tocsc() for m in piece.operator)
    rows, columns = np.divmod(chosen, shape[1])
    in_y, in_x = along_y[:, rows], along_x[:, columns]  # a column is the outer product of theirs
    width = piece.valid.shape[1]
    index, values, ends = [], [], [0]
    for k in range(chosen.size):
        a, b = in_y.indptr[k : k + 2]
        c, d = in_x.indptr[k : k + 2]
        index.append((in_y.indices[a:b, None] * width + in_x.indices[c:d]).ravel())
        values.append((in_y.data[a:b, None] * in_x.data[c:d]).ravel())
        ends.append(ends[-1] + index[-1].size)
    size = (piece.valid.size, chosen.size)
    return sparse.csc_matrix((np.concatenate(values), np.concatenate(index), ends), shape=size)
