"""Private helper: least squares of stage, plate and placements on a lattice, with its null space."""

from __future__ import annotations

import math

import numpy as np

from metrosep.core._arrays import BoolArray, FloatArray
from metrosep.core.errors import DataError, NotSeparableError
from metrosep.separation._lattice_views import GridView
from metrosep.separation.null_space import Unobservable

__all__ = ["Lattice", "better_turns"]


_RANK = 1e-10
"""Eigenvalues of the normal matrix below this share of the largest are null."""

_SUSPECT = 0.02
"""Residual over readings from which another sense of the turns is tried."""

_BETTER = 0.5
"""Residual with the other sense over the residual as stated, below which it is told."""


class Lattice:
    """Joint least squares; unknowns: stage (site, component), plate (mark, component), placements."""

    def __init__(
        self, views: list[tuple[GridView, FloatArray]], size: tuple[int, int], relaid: bool = False
    ) -> None:
        self.size = size
        n = size[0] * size[1]
        lays = [(i, v, z) for i, (v, r) in enumerate(views) for z in _lays(r, relaid)]
        blocks = [_rows(i, k, v, r, size, len(lays)) for k, (i, v, r) in enumerate(lays)]
        design = np.concatenate([b[0] for b in blocks])
        mean = np.concatenate([b[1] for b in blocks])
        weight = np.concatenate([b[2] for b in blocks])
        owner = np.repeat(np.arange(len(lays)), [b[1].size for b in blocks])
        about = [b[3] for b in blocks]
        keep = np.ones(4 * n, dtype=bool)
        while True:
            seen = np.abs(design[:, : 4 * n]).sum(axis=0) > 0
            keep &= seen
            use = np.abs(design[:, : 4 * n][:, ~keep]).sum(axis=1) == 0
            columns = np.concatenate([keep, np.ones(3 * len(lays), dtype=bool)])
            a = design[np.ix_(use, columns)]
            inverse, null, values = _pseudo_inverse(a, weight[use])
            functions = _removed(size, keep)
            stray = _stray(null[: int(keep.sum())], functions)
            if not stray.any():
                break
            if stray.mean() > 0.25 or keep.mean() < 0.5:
                raise NotSeparableError(
                    f"these views leave {null.shape[1]} patterns undetermined, not only "
                    "translation, rotation and scale: a view turned by 90 degrees and one shifted "
                    "by one pitch, both with most marks read, are needed"
                )
            keep[np.flatnonzero(keep)[stray]] = False
            about = [rows[use[owner == k]] for k, rows in enumerate(about)]
            design, mean, weight, owner = design[use], mean[use], weight[use], owner[use]
        placed = [design[use & (owner == k)][:, 4 * n + 3 * k :][:, :3] for k in range(len(lays))]
        about = [rows[use[owner == k]] for k, rows in enumerate(about)]
        pairs = [_rigid_share(r, p) for r, p in zip(about, placed, strict=True)]
        total = sum(float(np.nansum(rows**2)) for rows in about)
        share, rank = sum(p[0] for p in pairs), sum(p[1] for p in pairs)
        pure = total - share if relaid else total
        self._finish(a, mean[use], weight[use], inverse, functions, keep, max(pure, 0.0))
        self.n_readings = int(weight[use].sum())
        self.rank = int(values.size) + (rank if relaid else 0)
        self.moved = (0.0, 0) if relaid else (share, rank)
        self.null_dimension = int(null.shape[1])

    def _finish(
        self,
        a: FloatArray,
        mean: FloatArray,
        weight: FloatArray,
        inverse: FloatArray,
        functions: list[FloatArray],
        keep: BoolArray,
        pure: float,
    ) -> None:
        n = self.size[0] * self.size[1]
        solution = inverse @ (a.T @ (weight * mean))
        solution = solution + inverse @ (a.T @ (weight * (mean - a @ solution)))
        left = mean - a @ solution
        self.squares = float(weight @ left**2) + pure
        self.parts: list[FloatArray] = []
        self.u: list[FloatArray] = []
        self.lost: list[int] = []
        self.sum_of_scales = 0.0
        start = 0
        for part, q in enumerate(functions):
            own = keep[2 * n * part : 2 * n * (part + 1)]
            stop = start + int(own.sum())
            values = solution[start:stop]
            covariance = inverse[start:stop, start:stop]
            half = covariance - q @ (q.T @ covariance)
            variance = np.diag(half) - np.einsum("ij,ij->i", half @ q, q)
            full, u = np.full(2 * n, np.nan), np.full(2 * n, np.nan)
            full[own] = values - q @ (q.T @ values)
            u[own] = np.sqrt(np.maximum(variance, 0.0))
            scale = _radial(self.size)[own]
            other = np.column_stack([_rigid(self.size)[own], scale])
            self.sum_of_scales += float(np.linalg.lstsq(other, values, rcond=None)[0][3])
            shape = (*self.size, 2)
            self.parts.append(full.reshape(shape))
            self.u.append(u.reshape(shape))
            self.lost.append(int(np.isnan(full.reshape(shape)).any(axis=-1).sum()))
            start = stop

    @property
    def sigma(self) -> float:
        """Standard deviation of one reading from the residuals; NaN without redundancy."""
        dof = self.n_readings - self.rank
        return math.sqrt(self.squares / dof) if dof > 0 else math.nan

    def uncertainty(self, part: int, sigma: float) -> FloatArray:
        """Return the standard uncertainty of the stage (0) or the plate (1)."""
        return np.asarray(sigma * self.u[part], dtype=np.float64)

    def unseen(self) -> tuple[Unobservable, ...]:
        """Return sites and marks that are not determined."""
        names = ("stage", "plate")
        return tuple(
            Unobservable(part, "samples", (lost,), "not read in enough views: NaN")
            for part, lost in zip(names, self.lost, strict=True)
            if lost
        )


def _lays(readings: FloatArray, relaid: bool) -> list[FloatArray]:
    """Return what shares a placement; repeats placed anew that read the same marks go together."""
    if not relaid:
        return [readings]
    groups: dict[bytes, list[int]] = {}
    for i, z in enumerate(readings):
        if not np.isnan(z).all():
            groups.setdefault(np.isnan(z).tobytes(), []).append(i)
    return [readings[rows] for rows in groups.values()] or [readings]


def _rigid_share(about: FloatArray, placed: FloatArray) -> tuple[float, int]:
    """Return squares and rank of what placements of each repeat make of the scatter (n, repeats)."""
    share, ranks = 0.0, []
    for repeat in about.T:
        seen = ~np.isnan(repeat)
        left, size, _ = np.linalg.svd(placed[seen], full_matrices=False)
        kept = left[:, size > 1e-9 * size.max(initial=1e-300)]
        share += float(np.sum((kept.T @ repeat[seen]) ** 2))
        ranks.append(kept.shape[1])
    return share, sum(ranks) - max(ranks, default=0)


def _rows(
    number: int,
    index: int,
    view: GridView,
    readings: FloatArray,
    size: tuple[int, int],
    n_views: int,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Design rows, mean readings, counts and the repeats about their mean of one placement."""
    n_y, n_x = size
    n = n_y * n_x
    count = (~np.isnan(readings)).sum(axis=0)
    cos, sin = ((1, 0), (0, 1), (-1, 0), (0, -1))[view.turns % 4]
    turn = np.array([[cos, -sin], [sin, cos]])
    rows, values, weights, about = [], [], [], []
    for j, i in np.ndindex(n_y, n_x):
        site = np.array([i - (n_x - 1) / 2, j - (n_y - 1) / 2])
        mark = turn.T @ (site - np.array(view.shift))
        column, row = mark[0] + (n_x - 1) / 2, mark[1] + (n_y - 1) / 2
        on_plate = -0.1 < column < n_x - 0.9 and -0.1 < row < n_y - 0.9
        for c in range(2):
            if not count[j, i, c]:
                continue
            if not on_plate:
                raise DataError(
                    f"view {number + 1} has a reading at row {j}, column {i}, where its turn "
                    f"({view.turns}) and shift {view.shift} put no mark; write NaN there, or "
                    "check the sign of the shift"
                )
            line = np.zeros(4 * n + 3 * n_views)
            line[2 * (j * n_x + i) + c] = 1.0
            first = 2 * n + 2 * (round(row) * n_x + round(column))
            line[first : first + 2] = turn[c]
            line[4 * n + 3 * index + c] = 1.0
            line[4 * n + 3 * index + 2] = (-site[1], site[0])[c] / max(size)
            got = readings[:, j, i, c]
            values.append(float(np.nanmean(got)))
            weights.append(float(count[j, i, c]))
            about.append(got - values[-1])
            rows.append(line)
    if not rows:
        raise DataError(f"view {number + 1} holds no readings")
    return np.array(rows), np.array(values), np.array(weights), np.array(about)


def _pseudo_inverse(
    a: FloatArray, weight: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    values, vectors = np.linalg.eigh(a.T @ (weight[:, np.newaxis] * a))
    null = values < _RANK * values[-1]
    kept = vectors[:, ~null]
    return (kept / values[~null]) @ kept.T, vectors[:, null], values[~null]


def _radial(size: tuple[int, int]) -> FloatArray:
    n_y, n_x = size
    j, i = np.mgrid[:n_y, :n_x]
    return np.stack([i - (n_x - 1) / 2, j - (n_y - 1) / 2], axis=-1).reshape(-1).astype(np.float64)


def _rigid(size: tuple[int, int]) -> FloatArray:
    site = _radial(size).reshape(-1, 2)
    turned = np.stack([-site[:, 1], site[:, 0]], axis=-1).reshape(-1)
    along_x = np.tile([1.0, 0.0], site.shape[0])
    return np.asarray(np.column_stack([along_x, 1.0 - along_x, turned]), dtype=np.float64)


def _removed(size: tuple[int, int], keep: BoolArray) -> list[FloatArray]:
    """Orthonormal translation, rotation and scale of stage and plate on what is determined."""
    n = size[0] * size[1]
    basis = np.column_stack([_rigid(size), _radial(size)])
    return [np.linalg.qr(basis[keep[2 * n * k : 2 * n * (k + 1)]])[0] for k in range(2)]


def _stray(null: FloatArray, functions: list[FloatArray]) -> BoolArray:
    """Which unknowns a null vector moves by more than translation, rotation and scale."""
    split = functions[0].shape[0]
    rest = [
        part - q @ (q.T @ part)
        for part, q in zip((null[:split], null[split:]), functions, strict=True)
    ]
    moved: BoolArray = np.abs(np.concatenate(rest)).max(axis=1, initial=0.0) > 1e-5
    return moved


def better_turns(
    views: list[tuple[GridView, FloatArray]],
    size: tuple[int, int],
    sigma: float,
    relaid: bool = False,
) -> tuple[list[int], float] | None:
    """Return numbers of the views that fit clearly better turned the other way, and the residual.

    None where the residuals are small against the readings, or no other sense fits better.
    """
    odd = [i for i, (v, _) in enumerate(views) if v.turns % 2]
    size_of_readings = max(float(np.nanstd(r)) for _, r in views)
    if not sigma > _SUSPECT * size_of_readings:
        return None
    best: tuple[list[int], float] | None = None
    for other in [odd, *([i] for i in odd if len(odd) > 1)]:
        turned = [
            (GridView(v.readings, -v.turns, v.shift), r) if i in other else (v, r)
            for i, (v, r) in enumerate(views)
        ]
        try:
            found = Lattice(turned, size, relaid).sigma
        except (DataError, NotSeparableError):
            continue
        if found < _BETTER * sigma and (best is None or found < best[1]):
            best = ([i + 1 for i in other], found)
    return best
