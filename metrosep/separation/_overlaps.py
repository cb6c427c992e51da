"""Overlaps of sub-apertures: which exist, whether they connect all, what does not fit in them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import NotSeparableError
from metrosep.separation._stitch_grid import Layout, Placed
from metrosep.separation._stitch_input import Pieces

OUTLIER_RATIO = 3.0
"""A mismatch this many times the median of all pairs is named."""

_MIRRORS = {
    "mirrored in x": np.s_[:, ::-1],
    "mirrored in y": np.s_[::-1, :],
    "turned by half a turn": np.s_[::-1, ::-1],
}


@dataclass(frozen=True, slots=True)
class Overlap:
    """Pixels that two sub-apertures share."""

    i: int  # which, ``i < j``
    j: int
    # of slice: the common window in the window of i, of j, and in the stitched grid
    in_i: tuple[slice, slice]
    in_j: tuple[slice, slice]
    in_all: tuple[slice, slice]
    n: int  # pixels measured in both


def overlaps_of(layout: Layout) -> tuple[Overlap, ...]:
    """Return every pair of sub-apertures with common pixels."""
    found = []
    for i, a in enumerate(layout.placed):
        for j in range(i + 1, len(layout.placed)):
            b = layout.placed[j]
            rows, columns = _common(a.rows, b.rows), _common(a.columns, b.columns)
            if rows is None or columns is None:
                continue
            in_i, in_j = _inside(a, rows, columns), _inside(b, rows, columns)
            n = int(np.count_nonzero(a.valid[in_i] & b.valid[in_j]))
            if n:
                found.append(Overlap(i, j, in_i, in_j, (rows, columns), n))
    return tuple(found)


def require_connection(overlaps: tuple[Overlap, ...], n: int, least: int) -> None:
    """Refuse sub-apertures that no chain of overlaps connects."""
    group = list(range(n))
    for o in overlaps:
        if o.n >= least and group[o.i] != group[o.j]:
            old, new = group[o.j], group[o.i]
            group = [new if g == old else g for g in group]
    islands = [[k + 1 for k in range(n) if group[k] == g] for g in sorted(set(group))]
    if len(islands) == 1:
        return
    thin = [f"{o.i + 1} and {o.j + 1} ({o.n})" for o in overlaps if o.n < least]
    note = f"; too few common samples: {', '.join(thin[:6])}" if thin else ""
    named = " | ".join(_listed(island) for island in islands)
    raise NotSeparableError(
        f"stitch: the sub-apertures fall into {len(islands)} groups that do not overlap: {named}; "
        f"at least {least} common measured samples are needed{note}. Check the positions (m, not "
        "mm) and the masks, or measure sub-apertures between the groups"
    )


def pair_residuals(
    layout: Layout, overlaps: tuple[Overlap, ...], fitted: list[FloatArray]
) -> FloatArray:
    """Return the RMS of the difference in each overlap, per reading."""
    out = []
    for o in overlaps:
        d = fitted[o.i][o.in_i] - fitted[o.j][o.in_j]
        d = d[np.isfinite(d)]
        share = 1.0 / layout.placed[o.i].weight + 1.0 / layout.placed[o.j].weight
        out.append(math.sqrt(float(np.mean(d**2)) / share))
    return np.array(out)


def outlying_pairs(residuals: FloatArray, floor: float, u_reading: float | None) -> list[int]:
    """Return the pairs whose mismatch is far above that of the others, or above the stated noise."""
    limit = OUTLIER_RATIO * max(float(np.median(residuals)), floor, u_reading or 0.0)
    return [int(k) for k in np.flatnonzero(residuals > limit)]


def mirrored_piece(
    pieces: Pieces, layout: Layout, overlaps: tuple[Overlap, ...], suspects: set[int]
) -> tuple[int, str] | None:
    """Return the sub-aperture that fits its neighbours only when mirrored.

    Notes
    -----
    Each overlap is judged by itself, after a plane of its own: a wrong neighbour does not count
    against a right one. Named is what lowers the mismatch to less than half, and most of all.
    """
    best: tuple[float, int, str] = (0.5, -1, "")
    for k in sorted(suspects):
        near = [o for o in overlaps if k in (o.i, o.j) and o.n >= 8]
        if not near:
            continue
        piece = layout.placed[k]
        as_given = _mismatch(layout, near, k, piece.values)
        for how, turn in _MIRRORS.items():
            if pieces.line and how != "mirrored in x":
                continue
            z = pieces.values[k][turn]
            hole = np.isnan(z)
            moved = piece.forward(np.where(hole, 0.0, z))
            bad = np.abs(piece.forward(hole.astype(np.float64))) > 1e-12
            moved = np.where(bad | ~piece.valid, np.nan, moved)
            ratio = _mismatch(layout, near, k, moved) / max(as_given, np.finfo(float).tiny)
            if ratio < best[0]:
                best = (ratio, k, how)
    return (best[1], best[2]) if best[1] >= 0 else None


def _mismatch(layout: Layout, near: list[Overlap], k: int, values: FloatArray) -> float:
    total, count = 0.0, 0
    for o in near:
        mine, other = (o.in_i, o.in_j) if o.i == k else (o.in_j, o.in_i)
        partner = layout.placed[o.j if o.i == k else o.i]
        d = values[mine] - partner.values[other]
        good = np.isfinite(d)
        n = int(np.count_nonzero(good))
        if n < 8:
            continue
        rest = without_own_plane(d, good)
        total, count = total + float(np.vdot(rest, rest)), count + n
    return math.sqrt(total / count) if count else math.inf


def without_own_plane(z: FloatArray, known: NDArray[np.bool_]) -> FloatArray:
    """Return a window without its least-squares plane."""
    n_rows, n_columns = known.shape
    r = (np.arange(n_rows) - (n_rows - 1) / 2) / max(n_rows, n_columns)
    c = (np.arange(n_columns) - (n_columns - 1) / 2) / max(n_rows, n_columns)
    count = max(int(np.count_nonzero(known)), 1)
    rest = np.where(known, z, 0.0)
    rest -= rest.sum() / count * known
    in_rows, in_columns = known.sum(axis=1), known.sum(axis=0)
    cross = float(r @ (known @ c))
    normal = np.array(
        [
            [float(count), in_columns @ c, in_rows @ r],
            [in_columns @ c, in_columns @ c**2, cross],
            [in_rows @ r, cross, in_rows @ r**2],
        ]
    )
    right = np.array([rest.sum(), rest.sum(axis=0) @ c, rest.sum(axis=1) @ r])
    a, b, e = np.linalg.lstsq(normal, right, rcond=1e-12)[0]
    rest -= (a + b * c + (e * r)[:, None]) * known
    return np.asarray(rest)


def _common(a: slice, b: slice) -> slice | None:
    start, stop = max(a.start, b.start), min(a.stop, b.stop)
    return slice(start, stop) if start < stop else None


def _inside(piece: Placed, rows: slice, columns: slice) -> tuple[slice, slice]:
    r, c = piece.rows.start, piece.columns.start
    return slice(rows.start - r, rows.stop - r), slice(columns.start - c, columns.stop - c)


def _listed(island: list[int]) -> str:
    shown = ", ".join(str(k) for k in island[:8])
    return shown + (f", ... ({len(island)})" if len(island) > 8 else "")
