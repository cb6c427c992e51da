"""Overlaps that disagree by more than noise: is it shown, and which other set-up would fit."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import MetrosepError
from metrosep.separation._overlaps import overlaps_of, require_connection, without_own_plane
from metrosep.separation._stitch_grid import layout_of
from metrosep.separation._stitch_input import Pieces
from metrosep.separation._stitch_models import n_rigid, plain_problem
from metrosep.separation._stitch_solve import (
    Problem,
    fitted_pieces,
    inverse_of,
    mean_of,
    noise_of,
    normal_matrix,
    require_rank,
    right_side,
)

_ALIKE = 0.6
"""Correlation of neighbouring mismatches; white noise has 0, interpolated noise up to 0.4."""

_ALIKE_ON_PIXELS = 0.3
"""The same where nothing was interpolated; instruments that smooth have up to about this."""

_LEAST_OF_ONE = 200
"""Pairs of neighbours for which a single overlap is judged: 0.6 is then 8 standard deviations."""

_CHANCE = 4.0
"""Standard deviations of the correlation of white noise that are no evidence."""

_LEAST_SHARE = 0.02
"""Of the structure in the overlaps: what interpolation of a rough part leaves is less."""

_LEAST_SAMPLES = 30
_BETTER = 0.5
_COARSE = 48
"""Pixels along the longer side on which other set-ups are tried."""

_TURNS = {
    "with the sign of x of the positions reversed": ((-1, 0), (0, 1)),
    "with the sign of y of the positions reversed (or the rows of each map in the other order)": (
        (1, 0),
        (0, -1),
    ),
    "with the signs of x and y of the positions reversed": ((-1, 0), (0, -1)),
    "with x and y of the positions exchanged": ((0, 1), (1, 0)),
    "with x and y of the positions exchanged and the sign of the new y reversed": (
        (0, 1),
        (-1, 0),
    ),
    "with x and y of the positions exchanged and the sign of the new x reversed": (
        (0, -1),
        (1, 0),
    ),
    "with x and y of the positions exchanged and both signs reversed": ((0, -1), (-1, 0)),
}


def setup_doubts(
    pieces: Pieces,
    problem: Problem,
    fitted: list[FloatArray],
    freedoms: tuple[str, ...],
    *,
    beyond_stated: bool,
    named: bool,
) -> list[str]:
    """Return what is to be said where the overlaps disagree by more than noise."""
    alike, share = likeness(problem, fitted)
    structured = alike > _ALIKE and share > _LEAST_SHARE
    if not (beyond_stated or structured):
        return []
    found = better_setup(pieces, freedoms)
    if found is not None:
        how, ratio = found
        times = f"{1 / ratio:.2g}" if ratio > 0.01 else "over 100"
        text = (
            f"the overlaps disagree by more than noise, and fit {times} times better {how}: the "
            "set-up is likely wrong, and u does not cover it"
        )
        return [text]
    if named or not structured:
        return []
    text = (
        "the overlaps disagree by more than noise (neighbouring mismatches are alike): positions, "
        "signs, rotations, drift or the instrument's reference do not fit, and u does not cover it"
    )
    return [text]


def likeness(problem: Problem, fitted: list[FloatArray]) -> tuple[float, float]:
    """Return the correlation of neighbouring mismatches, and their RMS over that of the surface.

    The correlation is that of all overlaps, or of the worst one; on pixels, where noise has none,
    it is scaled so that one limit serves.
    """
    product, size, squares, structure, n, worst = 0.0, 0.0, 0.0, 0.0, 0, 0.0
    for o in problem.overlaps:
        a, b = problem.layout.placed[o.i], problem.layout.placed[o.j]
        both = a.valid[o.in_i] & b.valid[o.in_j]
        z = np.where(both, fitted[o.i][o.in_i], 0.0)
        d = np.where(both, z - fitted[o.j][o.in_j], 0.0)
        squares, structure = squares + float(np.vdot(d, d)), structure + _rough(z, both)
        own_product, own_size, own_n = 0.0, 0.0, 0
        d2 = d * d
        for first, second in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
            own_product += float(np.vdot(d[first], d[second]))  # zero where not both measured
            own_size += 0.5 * float(
                (d2[first] * both[second]).sum() + (d2[second] * both[first]).sum()
            )
            own_n += int(np.count_nonzero(both[first] & both[second]))
        product, size, n = product + own_product, size + own_size, n + own_n
        if own_n >= _LEAST_OF_ONE and own_size > 0.0:
            worst = max(worst, own_product / own_size)
    if n < _LEAST_SAMPLES or size <= 0.0 or structure <= 0.0:
        return 0.0, 0.0
    alike = max(product / size - _CHANCE / math.sqrt(n), 0.0)
    if not any(p.operator for p in problem.layout.placed):
        alike = min(alike * _ALIKE / _ALIKE_ON_PIXELS, 1.0)
    return max(alike, worst), math.sqrt(squares / structure)


def _rough(z: FloatArray, both: NDArray[np.bool_]) -> float:
    """Return the sum of squares about a plane: the whole may lie in space as it likes."""
    rest = without_own_plane(z, both)
    return float(np.vdot(rest, rest))


def better_setup(pieces: Pieces, freedoms: tuple[str, ...]) -> tuple[str, float] | None:
    """Return the other set-up that fits best, if it fits at least twice as well."""
    coarse = _coarse(pieces)
    given = _mismatch(coarse, freedoms)
    if given is None or given[0] <= 0.0:
        return None
    best: tuple[str, float] | None = None
    for how, other in _others(coarse):
        found = _mismatch(other, freedoms)
        if found is None or found[1] < 0.3 * given[1]:
            continue
        ratio = max(found[0] / given[0], 1e-9)
        if ratio < _BETTER and (best is None or ratio < best[1]):
            best = (how, ratio)
    return best


def _others(pieces: Pieces) -> Iterator[tuple[str, Pieces]]:
    origin = pieces.corners[0]
    for how, turn in _TURNS.items():
        if pieces.line and "sign of x of" not in how:
            continue
        corners = origin + (pieces.corners - origin) @ np.array(turn, dtype=np.float64).T
        if not np.array_equal(corners, pieces.corners):
            yield how, replace(pieces, corners=corners)
    if np.any(pieces.turns != 0.0):
        yield "with the sign of the rotations reversed", replace(pieces, turns=-pieces.turns)
    if pieces.known is not None:
        values = tuple(v + 2.0 * pieces.known for v in pieces.values)
        yield "with the sign of the known reference reversed", replace(pieces, values=values)


def _coarse(pieces: Pieces) -> Pieces:
    """Return every q-th pixel, q odd, of windows about the same centres."""
    longest = max(max(v.shape) for v in pieces.values)
    shortest = longest if pieces.line else min(min(v.shape) for v in pieces.values)
    q = 2 * (min(longest // _COARSE, shortest // 8) // 2) + 1
    if q == 1:
        return pieces
    values, corners = [], pieces.corners.copy()
    known = pieces.known
    for k, v in enumerate(pieces.values):
        rows = np.s_[0:1] if pieces.line else _every(v.shape[0], q)
        columns = _every(v.shape[1], q)
        values.append(v[rows, columns])
        corners[k] += [columns.start * pieces.dx, rows.start * pieces.dy]
        if k == 0 and known is not None:
            known = known[rows, columns]
    dy = pieces.dy if pieces.line else q * pieces.dy
    return replace(
        pieces, values=tuple(values), corners=corners, dx=q * pieces.dx, dy=dy, known=known
    )


def _every(n: int, q: int) -> slice:
    cut = next(j for j in range(q) if (n - 1 - 2 * j) % q == 0)
    return slice(cut, n - cut, q)


def _mismatch(pieces: Pieces, freedoms: tuple[str, ...]) -> tuple[float, float] | None:
    """Return the noise that the overlaps show, and its degrees of freedom."""
    try:
        layout = layout_of(pieces)
        overlaps = overlaps_of(layout)
        problem = plain_problem(layout, overlaps, freedoms, line=pieces.line)
        require_connection(overlaps, len(pieces), least=problem.columns[0].size + 1)
        inverse = inverse_of(normal_matrix(problem))
        require_rank(inverse, problem, n_rigid(freedoms, line=pieces.line))
    except MetrosepError:
        return None
    values = [p.values for p in layout.placed]
    theta = inverse.matrix @ right_side(problem, values, mean_of(problem, values))
    fitted = fitted_pieces(problem, values, theta)
    noise, freedom = noise_of(problem, fitted, mean_of(problem, fitted), inverse.rank)
    return (noise, freedom) if freedom >= _LEAST_SAMPLES else None
