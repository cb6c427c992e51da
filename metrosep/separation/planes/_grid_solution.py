"""Private helper: least squares of a map and of the lays of its lines, with its null space.

A lay is one set of lines of one direction that were put down once: all repeats if the straightedge
stayed, one repeat if it was laid anew. Each lay has line terms of its own. Repeats that were laid
anew and measured the same points are one lay of their mean: what they differ by tells their own
terms and noise, and nothing of the map.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import BoolArray, FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError, NotSeparableError, NotUniformError
from metrosep.core.methods import RoleColumns
from metrosep.core.numbers import choice
from metrosep.core.quantity import Quantity

Slopes = Literal["free", "common", "none"]
Repeats = Literal["relaid", "passes"]

_SPREAD = 5.0
"""Standard deviations of a ratio of variances beyond which it is not a chance."""

_MOST_TERMS = 4000
"""Line terms that are solved in half a minute."""

_RANK = 1e-9
"""Eigenvalues below this share of the largest one belong to the null space."""

TERMS = {
    "free": ("piston", "tilt x", "tilt y", "twist xy"),
    "common": ("piston", "tilt x", "tilt y"),
    "none": ("piston",),
}


@dataclass(frozen=True, slots=True, eq=False)
class Lay:
    """Lines of one direction (0 along x, 1 along y) that share their line terms.

    ``values`` (repeats, n_y, n_x); ``moved`` says that repeats differ by line terms of their own.
    """

    direction: int
    values: FloatArray
    moved: bool

    @property
    def count(self) -> NDArray[np.int64]:
        """Number of readings of each point."""
        n: NDArray[np.int64] = (~np.isnan(self.values)).sum(axis=0)
        return n


def refuse_unknown(slopes: str, repeats: str) -> None:
    """Refuse what is not a kind of slopes or repeats."""
    choice(slopes, "slopes", TERMS)
    choice(repeats, "repeats", get_args(Repeats))


def noise_of(squares: float, dof: int, u_reading: float | None, source: str) -> Quantity:
    """Return the noise of a reading from what the model leaves; as stated without redundancy."""
    text = "standard deviation of one reading"
    if dof > 0:
        s = math.sqrt(squares / dof)
        u = s / math.sqrt(2.0 * dof)
        return Quantity(s, "m", f"{text}, from the {source}", u=u, symbol="s")
    if u_reading is None:
        return Quantity(math.nan, "m", f"{text}; not known", symbol="s")
    return Quantity(u_reading, "m", f"{text}, as stated", symbol="s")


def moved_between(squares: float, dof: int, share: float, share_dof: int) -> bool:
    """Return whether passes differ by set-up terms by more than the rest of the noise lets them."""
    left, rest = squares - share, dof - share_dof
    if share_dof < 1 or rest < 1:
        return False
    limit = 1.0 + _SPREAD * math.sqrt(2.0 / share_dof + 2.0 / rest)
    return share / share_dof > limit * left / rest


def lays_of(sets: list[FloatArray], relaid: bool) -> list[Lay]:
    """Return the lays of both directions; repeats laid anew are grouped by the points they read."""
    if not relaid:
        return [Lay(way, values, False) for way, values in enumerate(sets)]
    return [Lay(way, z, True) for way, values in enumerate(sets) for z in same_points(values)]


def same_points(values: FloatArray) -> list[FloatArray]:
    """Return repeats by groups that read the same points; those that read none are omitted."""
    groups: dict[bytes, list[int]] = {}
    for i, z in enumerate(values):
        if not np.isnan(z).all():
            groups.setdefault(np.isnan(z).tobytes(), []).append(i)
    return [values[rows] for rows in groups.values()]


class Joined:
    """Least-squares map over the points that the crossings determine."""

    def __init__(self, lays: list[Lay], x: FloatArray, y: FloatArray, slopes: str) -> None:
        counts = np.stack([sum(lay.count for lay in lays if lay.direction == s) for s in (0, 1)])
        used: BoolArray = np.asarray(counts.any(axis=0))
        for _ in range(counts.shape[1] + counts.shape[2]):
            joined = (counts.min(axis=0) > 0) & used
            if joined.any(axis=1).sum() < 2 or joined.any(axis=0).sum() < 2:
                break
            lost = self._solve(lays, counts, used, x, y, slopes)
            if not lost.any():
                return
            used = np.asarray(used & ~lost)
        raise NotSeparableError(
            "the crossings do not join the lines: at least two lines along x must cross the same "
            "two lines along y; measure longer lines or more of them"
        )

    def _solve(
        self,
        lays: list[Lay],
        counts: NDArray[np.int64],
        used: BoolArray,
        x: FloatArray,
        y: FloatArray,
        slopes: str,
    ) -> BoolArray:
        rows, columns = np.nonzero(used)
        u, v = _unit(x)[columns], _unit(y)[rows]
        basis = (_line_basis(rows, u, y.size, slopes), _line_basis(columns, v, x.size, slopes))
        weights = [lay.count[used].astype(np.float64) for lay in lays]
        means = [_mean(lay.values[:, used], w) for lay, w in zip(lays, weights, strict=True)]
        total = np.sum(weights, axis=0)
        mean = sum(w * m for w, m in zip(weights, means, strict=True)) / total
        schur, right, coupling = _without_map(lays, basis, weights, means, total, np.asarray(mean))
        values, vectors = np.linalg.eigh(schur)
        null = values < _RANK * values[-1]
        inverse = (vectors[:, ~null] / values[~null]) @ vectors[:, ~null].T
        lines = inverse @ right
        error = mean - coupling @ lines
        regular = np.column_stack([np.ones(u.size), u, v, u * v][: len(TERMS[slopes])])
        orthonormal = np.linalg.qr(regular)[0]
        shapes = coupling @ vectors[:, null]
        extra = shapes - orthonormal @ (orthonormal.T @ shapes)
        lost = np.zeros(used.shape, dtype=bool)
        lost[rows, columns] = np.abs(extra).max(axis=1, initial=0.0) > 1e-6
        if lost.any():  # what only one set of lines sees goes first
            single = lost & (counts.min(axis=0) == 0)
            return single if single.any() else lost & used
        self.used = used
        self.error = error - orthonormal @ (orthonormal.T @ error)
        self.variance = _variance(total, coupling, inverse, orthonormal)
        self.n_null = int(null.sum())
        left = [m - error for m in means]
        self._score(lays, basis, weights, left, lines, int((~null).sum()), used)
        return lost

    def _score(
        self,
        lays: list[Lay],
        basis: tuple[FloatArray, FloatArray],
        weights: list[FloatArray],
        left: list[FloatArray],
        lines: FloatArray,
        rank: int,
        used: BoolArray,
    ) -> None:
        """Residuals of the means, of the passes about them, and of line terms moved between."""
        start, squares, freedom = 0, 0.0, -self.error.size - rank
        n, moved = 0, [0.0, 0]
        for lay, w, rest in zip(lays, weights, left, strict=True):
            own = basis[lay.direction]
            terms = lines[start : start + own.shape[1]]
            start += own.shape[1]
            squares += float(w @ np.where(w > 0, rest - own @ terms, 0.0) ** 2)
            readings = lay.values[:, used]
            n += int(w.sum())
            about = readings - _mean(readings, w)
            straight, share, dof = shares_of_passes(about, own)
            if lay.moved:
                squares += float(np.nansum((about - straight) ** 2))
                freedom -= dof
            else:
                squares += float(np.nansum(about**2))
                moved = [moved[0] + share, moved[1] + dof]
        self.n_readings = n
        self.dof = freedom + n
        self.squares = squares
        self.residual_rms = math.sqrt(squares / n)
        self.moved = (float(moved[0]), int(moved[1]))


def _mean(values: FloatArray, weight: FloatArray) -> FloatArray:
    total = np.nansum(values, axis=0)
    out: FloatArray = np.divide(total, weight, out=np.zeros(weight.size), where=weight > 0)
    return out


def shares_of_passes(about: FloatArray, basis: FloatArray) -> tuple[FloatArray, float, int]:
    """Return what terms of each pass make of the scatter about the mean, its squares and rank."""
    out = np.zeros_like(about)
    if about.shape[0] < 2:
        return out, 0.0, 0
    squares, ranks = 0.0, []
    for i, row in enumerate(about):
        seen = ~np.isnan(row)
        line, (size, at) = basis[seen], np.linalg.eigh(basis[seen].T @ basis[seen])
        kept = at[:, size > _RANK * max(float(size[-1]), 1e-300)]
        ranks.append(kept.shape[1])
        terms = kept @ ((kept.T @ (line.T @ row[seen])) / size[-kept.shape[1] :])
        out[i, seen] = line @ terms
        squares += float(np.sum(out[i, seen] ** 2))
    return out, squares, sum(ranks) - max(ranks, default=0)


def _without_map(
    lays: list[Lay],
    basis: tuple[FloatArray, FloatArray],
    weights: list[FloatArray],
    means: list[FloatArray],
    total: FloatArray,
    mean: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the normal equations of the line terms, and what these terms do to the map."""
    own = [basis[lay.direction] for lay in lays]
    ends = np.cumsum([0, *(b.shape[1] for b in own)])
    if ends[-1] > _MOST_TERMS:
        raise DataError(
            f"{len(lays)} lays of lines with other points missing in each have {ends[-1]} offsets and "
            f"slopes, more than {_MOST_TERMS}: set a point NaN in all repeats if one lacks it"
        )
    schur = np.zeros((int(ends[-1]), int(ends[-1])))
    for i, (b, w) in enumerate(zip(own, weights, strict=True)):
        here = slice(ends[i], ends[i + 1])
        for j in range(i + 1):
            pair = w * (total - w) / total if i == j else -w * weights[j] / total
            block = b.T @ (pair[:, np.newaxis] * own[j])
            there = slice(ends[j], ends[j + 1])
            schur[here, there] = block
            schur[there, here] = block.T
    right = np.concatenate(
        [b.T @ (w * (m - mean)) for b, w, m in zip(own, weights, means, strict=True)]
    )
    coupling = np.hstack(
        [b * (w / total)[:, np.newaxis] for b, w in zip(own, weights, strict=True)]
    )
    return schur, right, coupling


def _variance(
    total: FloatArray, coupling: FloatArray, inverse: FloatArray, q: FloatArray
) -> FloatArray:
    """Diagonal of P (D^-1 + W S^-1 W') P' for unit noise, P without the null space."""
    own = 1.0 / total
    inner = q.T @ (own[:, np.newaxis] * q)
    direct = own - 2.0 * own * (q**2).sum(axis=1) + np.einsum("ij,jk,ik->i", q, inner, q)
    rest = coupling - q @ (q.T @ coupling)
    total_variance = direct + np.einsum("ij,jk,ik->i", rest, inverse, rest, optimize=True)
    return np.asarray(np.maximum(total_variance, 0.0), dtype=np.float64)


def _line_basis(line: NDArray[np.intp], along: FloatArray, n: int, slopes: str) -> FloatArray:
    offsets = np.zeros((line.size, n))
    offsets[np.arange(line.size), line] = 1.0
    if slopes == "none":
        return offsets
    if slopes == "common":
        return np.hstack([offsets, along[:, np.newaxis]])
    return np.hstack([offsets, offsets * along[:, np.newaxis]])


def _unit(positions: FloatArray) -> FloatArray:
    middle = 0.5 * (positions[0] + positions[-1])
    scaled: FloatArray = (positions - middle) / max(positions[-1] - middle, 1e-300)
    return scaled


# ---- the regular grid on which the rows of a table lie: a row holds x, y and what was read there ----

PLACE = {"x": "length", "y": "length"}
"""Columns of every such table."""

_SAME = 1e-3
"""Positions of one grid line may differ by this share of the step: rounding of text."""


def _axis(values: FloatArray, name: str) -> tuple[FloatArray, NDArray[np.intp], float]:
    """Return the grid lines of a column of positions, the line of each row, and the step."""
    if np.isnan(values).any():
        raise InvalidSamplesError(f"a row has no {name}; drop it")
    rising = np.sort(values)
    gaps = np.diff(rising)
    largest = float(gaps.max()) if gaps.size else 0.0
    starts = np.concatenate([[True], gaps > 0.5 * largest])
    lines = rising[starts]
    if largest == 0.0 or lines.size < 2:
        raise InvalidSamplesError(f"all rows have the same {name}; a plane needs several")
    step = float(lines[-1] - lines[0]) / (lines.size - 1)
    index = np.rint((values - lines[0]) / step).astype(np.intp)
    if float(np.abs(lines[0] + step * index - values).max()) > _SAME * step:
        raise NotUniformError(
            f"the values of {name} do not lie on equal steps of {step * 1e3:.6g} mm; measure on a "
            "regular grid"
        )
    return lines[0] + step * np.arange(lines.size), index, step


class TableGrid:
    """The regular grid on which the rows of a table lie."""

    def __init__(self, data: RoleColumns) -> None:
        self.x, self.column, self.dx = _axis(data.values["x"], "x")
        self.y, self.row, self.dy = _axis(data.values["y"], "y")

    @property
    def steps(self) -> dict[str, Any]:
        return {"dx": self.dx, "dy": self.dy}

    def filled(self, values: FloatArray, rows: NDArray[np.bool_], what: str) -> FloatArray:
        """Return (n_y, n_x), NaN where no row stands."""
        row, column = self.row[rows], self.column[rows]
        flat = row * self.x.size + column
        if np.unique(flat).size != flat.size:
            raise InvalidSamplesError(
                f"{what}: a point occurs twice; name the column that numbers repeats, "
                'repeat = "repeat"'
            )
        out = np.full((self.y.size, self.x.size), np.nan)
        out[row, column] = values[rows]
        return out


def repeats_of(data: RoleColumns) -> list[tuple[str, NDArray[np.bool_]]]:
    marks = data.values.get("repeat")
    if marks is None:
        return [("the table", np.ones(data.values["x"].size, dtype=bool))]
    return [(f"repeat {m}", marks == m) for m in dict.fromkeys(marks.tolist())]
