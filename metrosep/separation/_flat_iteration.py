"""Three flats by iterated Zernike terms: simulate the readings, compare, share the difference.

Each reading is compared on its own measured pixels, so a gap in one of them costs nothing in the
others. The steps are those of conjugate gradients on the pixels' least squares: the published
iteration goes the same way with fixed steps and needs hundreds of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DegenerateFitError
from metrosep.separation._flat_zernike import DiscBasis, FlatZernikeSolver

MOST_STEPS = 500
"""Steps after which an iteration ends and says that it did not settle."""

_SETTLED = 1e-13
_RANK_TOLERANCE = 1e-9
_LEAST_INFORMATION = 1e-6


@dataclass(frozen=True, slots=True)
class Iterated:
    """Coefficients found by iteration."""

    # shape (3 p,): of A, B, C, one after the other; the share that nothing shows is zero
    coefficients: FloatArray
    # size of the normal equations' residual at each step, relative to the start
    left: tuple[float, ...]
    settled: bool  # whether the last one is round-off


class OwnMasks:
    """Least squares of all measured pixels of all readings over the terms of A, B, C."""

    def __init__(
        self,
        basis: DiscBasis,
        solver: FlatZernikeSolver,
        measured: NDArray[np.bool_],
        aligned: Sequence[tuple[int, int]],
    ) -> None:
        self.basis, self.solver = basis, solver
        self.measured = measured[:, basis.mask]
        p, s = len(basis.nm), measured.shape[0]
        free = np.array([nm not in aligned for nm in basis.nm])
        self.free, self.rigid = np.flatnonzero(free), np.flatnonzero(~free)
        self.grams = np.repeat(basis.normal[None], s, axis=0)
        for block, piece in basis.blocks():
            for k in range(s):
                gap = block[:, ~self.measured[k, piece]]
                if gap.size:
                    self.grams[k] -= gap @ gap.T
        self.designs = [solver.model[k * p : (k + 1) * p][self.free] for k in range(s)]
        try:
            self.reduced = [self._without_rigid(g) for g in self.grams]
        except np.linalg.LinAlgError:
            raise DegenerateFitError(_TOO_FEW) from None
        self.normal = sum(
            (d.T @ g @ d for d, g in zip(self.designs, self.reduced, strict=True)),
            np.zeros((3 * p, 3 * p)),
        )
        self.inverse, self.rank = self._inverse()

    def _without_rigid(self, gram: FloatArray) -> FloatArray:
        own = gram[np.ix_(self.free, self.free)]
        if self.rigid.size == 0:
            return own
        shared = gram[np.ix_(self.free, self.rigid)]
        return own - shared @ np.linalg.solve(gram[np.ix_(self.rigid, self.rigid)], shared.T)

    def _inverse(self) -> tuple[FloatArray, int]:
        """Return the pseudo-inverse on what the set-ups show, and how much this is."""
        design = np.concatenate(self.designs)
        _, size, rows = np.linalg.svd(design, full_matrices=False)
        rank = int((size > _RANK_TOLERANCE * size[0]).sum())
        shown = rows[:rank].T
        here = shown.T @ self.normal @ shown
        whole = self._without_rigid(self.basis.normal)
        full = sum((d @ shown).T @ whole @ (d @ shown) for d in self.designs)
        root = np.linalg.inv(np.linalg.cholesky(full))
        if np.linalg.eigvalsh(root @ here @ root.T)[0] < _LEAST_INFORMATION:
            raise DegenerateFitError(_TOO_FEW)
        return shown @ np.linalg.inv(here) @ shown.T, rank

    def right_side(self, stack: FloatArray) -> FloatArray:
        """Return what the readings say of each coefficient, alignment taken out."""
        z = np.where(self.measured, stack[:, self.basis.mask], 0.0)
        sums = np.zeros((len(self.designs), len(self.basis.nm)))
        for block, piece in self.basis.blocks():
            sums += z[:, piece] @ block.T
        out = np.zeros(self.normal.shape[0])
        for design, gram, row in zip(self.designs, self.grams, sums, strict=True):
            own = row[self.free]
            if self.rigid.size:
                shared = gram[np.ix_(self.free, self.rigid)]
                fitted = np.linalg.solve(gram[np.ix_(self.rigid, self.rigid)], row[self.rigid])
                own = own - shared @ fitted
            out += design.T @ own
        return out

    def iterate(self, right: FloatArray) -> Iterated:
        """Return the coefficients, step by step from zero."""
        found, rest = np.zeros_like(right), right.copy()
        start = float(np.sqrt(rest @ rest))
        left: list[float] = []
        along, size = rest.copy(), float(rest @ rest)
        while size > 0.0 and len(left) < MOST_STEPS:
            ahead = self.normal @ along
            step = size / float(along @ ahead)
            found, rest = found + step * along, rest - step * ahead
            new = float(rest @ rest)
            left.append(np.sqrt(new) / start)
            if left[-1] <= _SETTLED:
                break
            along, size = rest + new / size * along, new
        return Iterated(found, tuple(left), not left or left[-1] <= _SETTLED)

    def residual(self, stack: FloatArray, coefficients: FloatArray) -> FloatArray:
        """Return what the model leaves of each reading on its own pixels, alignment taken out."""
        terms = (self.solver.model @ coefficients).reshape(len(self.designs), -1).copy()
        terms[:, self.rigid] = 0.0
        rest = np.where(self.measured, stack[:, self.basis.mask] - self._values(terms), 0.0)
        sums = np.zeros_like(terms)
        for block, piece in self.basis.blocks():
            sums += rest[:, piece] @ block.T
        planes = np.zeros_like(terms)
        for k, gram in enumerate(self.grams):
            if self.rigid.size:
                own = gram[np.ix_(self.rigid, self.rigid)]
                planes[k, self.rigid] = np.linalg.solve(own, sums[k, self.rigid])
        out = np.full(stack.shape, np.nan)
        out[:, self.basis.mask] = np.where(self.measured, rest - self._values(planes), np.nan)
        return out

    def _values(self, coefficients: FloatArray) -> FloatArray:
        return np.asarray(self.basis.maps(coefficients)[:, self.basis.mask])


_TOO_FEW = (
    "the pixels that the readings have do not determine the Zernike terms of three flats; use fewer "
    "terms, or readings with smaller gaps"
)
