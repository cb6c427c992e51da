"""The normal equations of a reference's pixels, applied and solved by conjugate gradients.

Surface and freedoms are eliminated: what is left acts on the pixels of the instrument alone. A step
costs a few passes over the readings; the freedoms enter by a matrix that is made once. Pixels that
interpolation reaches with small weights only, most of them at the rim, tie to their neighbours more
than to themselves; their own block is solved by elimination in the preconditioner.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import NotConvergedError
from metrosep.separation._stitch_grid import Placed
from metrosep.separation._stitch_solve import Inverse, Problem, mean_of

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

    def __init__(
        self,
        problem: Problem,
        inverse: Inverse,
        shape: tuple[int, int],
    ) -> None:
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
        mean = mean_of(self.problem, windows)
        rests: list[FloatArray] = [
            np.asarray(w * np.where(p.valid, v - mean[p.rows, p.columns], 0.0), dtype=np.float64)
            for p, w, v in zip(self.placed, self.weights, windows, strict=True)
        ]
        return self._spread(rests)

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
    in_y, in_x = (
        along_y[:, rows],
        along_x[:, columns],
    )  # a column of the product is their outer one
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
