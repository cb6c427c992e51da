"""Least squares of terms and freedoms at points: what is determined, alone or together."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.machine.alignment import Alignment
from metrosep.machine.gram import AlignedGram, groups_alike

__all__ = ["OWN", "Solution", "Solver", "common_map", "span_of", "unit_columns"]


_DETERMINED = 1e-7
"""Of the largest singular value: below, a direction is rounding."""

OWN = 1e-6
"""Of the size of a column: what others leave of it is rounding."""

_PART = 1e-3
"""Of a direction that is not determined: a term with less in it is told apart."""


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Amounts of visible terms, scaled to the size of their maps (m), and of used freedoms."""

    names: tuple[str, ...]
    sizes: FloatArray
    scaled: FloatArray
    amounts: FloatArray
    scaled_covariance: FloatArray
    rank: int

    def errors(self) -> dict[str, float]:
        """Return the terms' amounts by name."""
        return dict(zip(self.names, (self.scaled / self.sizes).tolist(), strict=True))

    def freedoms(self, solver: Solver) -> dict[str, float]:
        """Return the freedoms' amounts by name."""
        return dict(zip(solver.space.used, self.amounts.tolist(), strict=True))

    def plus(self, step: Solution) -> Solution:
        """Return the sum of two solutions."""
        return Solution(
            self.names,
            self.sizes,
            self.scaled + step.scaled,
            self.amounts + step.amounts,
            step.scaled_covariance,
            step.rank,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Solver:
    """The linear problem: unit maps (n, m) and freedoms (n, k), and which terms go together."""

    names: tuple[str, ...]
    maps: FloatArray
    columns: FloatArray
    space: Alignment
    gram: AlignedGram
    threshold: float
    units: tuple[str, ...] = ()
    visible: tuple[int, ...] = field(init=False)
    sizes: FloatArray = field(init=False)
    correlation: FloatArray = field(init=False)
    groups: tuple[tuple[int, ...], ...] = field(init=False)
    design: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        visible = tuple(int(i) for i in np.flatnonzero(~self.gram.is_removed))
        matrix = self.gram.matrix[np.ix_(visible, visible)]
        sizes = np.sqrt(np.diag(matrix))
        aligned = self.space.remove(self.maps[:, visible]) / sizes
        _, singular, directions = np.linalg.svd(np.linalg.qr(aligned, mode="r"))
        blind = directions[singular <= _DETERMINED * singular[0]]
        set_ = object.__setattr__
        set_(self, "visible", visible)
        set_(self, "sizes", sizes)
        set_(self, "correlation", matrix / np.outer(sizes, sizes))
        set_(self, "design", aligned)
        set_(self, "groups", self._together(matrix, visible, blind))

    def _together(
        self, matrix: FloatArray, visible: tuple[int, ...], blind: FloatArray
    ) -> tuple[tuple[int, ...], ...]:
        """Return groups of terms that are alike, joined with those that share a blind direction."""
        text = [str(i) for i in visible]
        sets = [{int(i) for i in g} for g in groups_alike(matrix, text, threshold=self.threshold)]
        shared = (
            np.abs(blind.T @ blind) > _PART**2
        )  # a projector: free of the choice of directions
        sets += [{visible[j] for j in np.flatnonzero(row)} for row in shared if row.any()]
        joined: list[set[int]] = []
        for s in sets:
            touching = [j for j in joined if j & s]
            joined = [j for j in joined if not j & s] + [s.union(*touching)]
        return tuple(tuple(sorted(j)) for j in sorted(joined, key=min) if len(j) > 1)

    def solve(self, heights: FloatArray, used: NDArray[np.bool_]) -> Solution:
        """Return the amounts that explain heights at the used points; the smallest if not unique."""
        columns = self.used_freedoms()
        if used.all():
            design, freed = self.design, self.space.remove(heights)
        else:  # the aligned maps are aligned no more: align on the points that are left
            basis = np.linalg.qr(columns[used])[0]
            design = self.design[used] - basis @ (basis.T @ self.design[used])
            freed = heights[used] - basis @ (basis.T @ heights[used])
        U, singular, directions = np.linalg.svd(design, full_matrices=False)
        good = singular > _DETERMINED * singular[0]
        inverse = directions[good].T / singular[good]
        scaled = inverse @ (U[:, good].T @ freed)
        rest = heights[used] - self.maps[used][:, self.visible] @ (scaled / self.sizes)
        amounts = np.linalg.lstsq(*_scaled_columns(columns[used], rest), rcond=None)[0]
        amounts = amounts / _column_sizes(columns[used])
        names = tuple(self.names[i] for i in self.visible)
        return Solution(
            names, self.sizes, scaled, amounts, inverse @ inverse.T, int(np.count_nonzero(good))
        )

    def effect(self, solution: Solution) -> FloatArray:
        """Return the linear effect of a solution at the points, m."""
        terms = self.maps[:, self.visible] @ (solution.scaled / self.sizes)
        return np.asarray(terms + self.used_freedoms() @ solution.amounts)

    def size_of(self, step: Solution) -> float:
        """Return how much a step moves the surface, RMS m."""
        moved = self.effect(step)
        return float(np.sqrt(np.mean(moved**2)))

    def estimator(self, used: NDArray[np.bool_]) -> tuple[FloatArray, FloatArray]:
        """Return what makes terms and freedoms of heights at the used points, and the basis.

        The first (n, p + k) gives scaled amounts and freedoms as ``rows.T @ heights``; the second
        (n, rank + k) is an orthonormal basis of all that the fit can follow.
        """
        columns = self.used_freedoms()[used]
        sizes = _column_sizes(columns)
        basis = np.linalg.qr(columns)[0]
        design = self.design[used]
        if not used.all():
            design = design - basis @ (basis.T @ design)
        U, singular, directions = np.linalg.svd(design, full_matrices=False)
        good = singular > _DETERMINED * singular[0]
        terms = U[:, good] @ (directions[good] / singular[good][:, None])
        inverse = np.linalg.pinv(columns / sizes).T / sizes
        maps = self.maps[used][:, self.visible] / self.sizes
        freedoms = inverse - terms @ (maps.T @ inverse)
        return np.hstack([terms, freedoms]), np.hstack([U[:, good], basis])

    def used_freedoms(self) -> FloatArray:
        """Return the maps of the freedoms that move the surface in a way of their own, (n, k)."""
        return self.columns[:, [self.space.names.index(n) for n in self.space.used]]


def common_map(correlation: FloatArray) -> tuple[FloatArray, float]:
    """Return the strongest direction of maps of unit size, and its square strength."""
    values, vectors = np.linalg.eigh(correlation)
    vector = vectors[:, -1]
    return vector * np.sign(vector[np.argmax(np.abs(vector))]), float(values[-1])


def _column_sizes(columns: FloatArray) -> FloatArray:
    sizes = np.sqrt(np.sum(columns**2, axis=0))
    return np.asarray(np.where(sizes > 0.0, sizes, 1.0))


def _scaled_columns(columns: FloatArray, right: FloatArray) -> tuple[FloatArray, FloatArray]:
    return columns / _column_sizes(columns), right


def unit_columns(columns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return columns of unit size, zeros left as they are, and the sizes."""
    sizes = np.sqrt(np.sum(columns**2, axis=0))
    return columns / np.where(sizes > 0.0, sizes, 1.0), sizes


def span_of(columns: FloatArray) -> FloatArray:
    """Return an orthonormal basis of columns that were of unit size before they were freed of others."""
    U, singular, _ = np.linalg.svd(columns, full_matrices=False)
    return U[:, singular > OWN]
