"""Sub-apertures on the pixels of one stitched grid: interpolation, its adjoint, masks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import BoolArray, FloatArray
from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotSeparableError,
    TooFewSamplesError,
)
from metrosep.core.numbers import positive
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.surface import Surface
from metrosep.separation._readings import as_numbers

_ON_PIXEL = 1e-6
"""Positions closer to a pixel than this share of a step count as on it."""


@dataclass(frozen=True, slots=True)
class Placed:
    """One sub-aperture on its window of the stitched grid."""

    rows: slice  # slice: window
    columns: slice
    # shape (window), m: readings at the pixels of the stitched grid; NaN where not determined
    values: FloatArray
    valid: BoolArray  # shape (window): where they are
    weight: float  # inverse of the noise variance that interpolation leaves, relative to a reading
    # broadcast to the window, m: position in the frame of the instrument, from its centre
    x: FloatArray
    y: FloatArray
    # interpolation: ``(along_y, along_x)`` matrices, one matrix where the map is turned, nothing
    # where its pixels are those of the grid
    operator: tuple[Any, ...]

    def position(self, box: tuple[slice, slice]) -> tuple[FloatArray, FloatArray]:
        """Return x and y in a part of the window, ready to be broadcast."""
        if self.x.shape[0] == 1 and self.y.shape[1] == 1:
            return self.x[:, box[1]], self.y[box[0], :]
        return self.x[box], self.y[box]

    def forward(self, instrument: FloatArray) -> FloatArray:
        """Return a map of the instrument frame, interpolated to the window."""
        if not self.operator:
            return instrument
        if len(self.operator) == 2:
            along_y, along_x = self.operator
            return np.asarray((along_x @ (along_y @ instrument).T).T)
        return np.asarray((self.operator[0] @ instrument.ravel()).reshape(self.valid.shape))

    def adjoint(self, window: FloatArray, shape: tuple[int, int]) -> FloatArray:
        """Return the transpose of `forward`, applied to a window."""
        if not self.operator:
            return window
        if len(self.operator) == 2:
            along_y, along_x = self.operator
            return np.asarray((along_x.T @ (along_y.T @ window).T).T)
        return np.asarray((self.operator[0].T @ window.ravel()).reshape(shape))


@dataclass(frozen=True, slots=True)
class Layout:
    """All sub-apertures on the stitched grid."""

    placed: tuple[Placed, ...]  # one for each
    shape: tuple[int, int]  # of the stitched grid
    x: FloatArray  # m: columns and rows of the stitched grid
    y: FloatArray

    def total(self, items: list[Any]) -> FloatArray:
        """Return the sum over the sub-apertures of windows on the stitched grid."""
        out = np.zeros(self.shape)
        for piece, item in zip(self.placed, items, strict=True):
            out[piece.rows, piece.columns] += item
        return out

    def weights(self) -> FloatArray:
        """Return the sum of the weights at each pixel, 0 where nothing was measured."""
        return self.total([p.weight * p.valid for p in self.placed])


def layout_of(pieces: Pieces) -> Layout:
    """Return sub-apertures on one grid: pixels of the first, extended over all."""
    corners = np.array([_extent(pieces, k) for k in range(len(pieces))])
    anchor = pieces.corners[0] if pieces.turns[0] == 0.0 else corners[0, :2]
    steps = np.array([pieces.dx, pieces.dy])
    low = np.floor((corners[:, :2] - anchor) / steps + _ON_PIXEL).astype(int)
    high = np.ceil((corners[:, 2:] - anchor) / steps - _ON_PIXEL).astype(int)
    first, last = low.min(axis=0), high.max(axis=0)
    shape = (int(last[1] - first[1] + 1), int(last[0] - first[0] + 1))
    x = anchor[0] + pieces.dx * np.arange(first[0], last[0] + 1)
    y = anchor[1] + pieces.dy * np.arange(first[1], last[1] + 1)
    placed = []
    for k in range(len(pieces)):
        columns = slice(int(low[k, 0] - first[0]), int(high[k, 0] - first[0] + 1))
        rows = slice(int(low[k, 1] - first[1]), int(high[k, 1] - first[1] + 1))
        placed.append(_place(pieces, k, rows, columns, x[columns], y[rows]))
    return Layout(tuple(placed), shape, x, y)


def centre_of(pieces: Pieces, k: int) -> tuple[float, float]:
    """Return the position on the part of the middle of a sub-aperture."""
    n_y, n_x = pieces.values[k].shape
    cx, cy = pieces.corners[k]
    return float(cx + (n_x - 1) / 2 * pieces.dx), float(cy + (n_y - 1) / 2 * pieces.dy)


def _extent(pieces: Pieces, k: int) -> FloatArray:
    n_y, n_x = pieces.values[k].shape
    half = np.array([(n_x - 1) / 2 * pieces.dx, (n_y - 1) / 2 * pieces.dy])
    centre = np.array(centre_of(pieces, k))
    if pieces.turns[k] != 0.0:
        c, s = abs(np.cos(pieces.turns[k])), abs(np.sin(pieces.turns[k]))
        half = np.array([c * half[0] + s * half[1], s * half[0] + c * half[1]])
    return np.concatenate([centre - half, centre + half])


def _place(
    pieces: Pieces, k: int, rows: slice, columns: slice, x: FloatArray, y: FloatArray
) -> Placed:
    z = pieces.values[k]
    (cx, cy), turn = centre_of(pieces, k), pieces.turns[k]
    n_y, n_x = z.shape
    if turn == 0.0:
        along_x, gain_x = _kernel((x - cx) / pieces.dx + (n_x - 1) / 2, n_x)
        along_y, gain_y = _kernel((y - cy) / pieces.dy + (n_y - 1) / 2, n_y)
        on_pixels = along_y.nnz == n_y == y.size and along_x.nnz == n_x == x.size
        operator: tuple[Any, ...] = () if on_pixels else (along_y, along_x)
        inside = np.outer(gain_y > 0, gain_x > 0)
        weight = 1.0 / (
            float(np.median(gain_y[gain_y > 0])) * float(np.median(gain_x[gain_x > 0]))
        )
        u, v = (x - cx)[None, :], (y - cy)[:, None]
    else:
        c, s = np.cos(turn), np.sin(turn)
        gx, gy = x[None, :] - cx, y[:, None] - cy
        u, v = c * gx + s * gy, -s * gx + c * gy
        matrix, gain = _turned(
            u / pieces.dx + (n_x - 1) / 2, v / pieces.dy + (n_y - 1) / 2, z.shape
        )
        operator, inside = (matrix,), (gain > 0).reshape(y.size, x.size)
        weight = 1.0 / float(np.median(gain[gain > 0]))
    hole = np.isnan(z)
    shell = Placed(rows, columns, z, inside, weight, u, v, operator)
    known = shell.forward(np.where(hole, 0.0, z))
    if hole.any():
        touched = Placed(rows, columns, z, inside, weight, u, v, tuple(abs(m) for m in operator))
        inside = inside & (touched.forward(hole.astype(np.float64)) < 1e-12)
    return Placed(rows, columns, np.where(inside, known, np.nan), inside, weight, u, v, operator)


def _cubic(t: FloatArray) -> list[NDArray[Any]]:
    """Return Keys' four weights at a fraction t of the step; exact for parabolas."""
    return [
        ((-0.5 * t + 1.0) * t - 0.5) * t,
        (1.5 * t - 2.5) * t * t + 1.0,
        ((-1.5 * t + 2.0) * t + 0.5) * t,
        (0.5 * t - 0.5) * t * t,
    ]


def _taps(at: FloatArray, n: int) -> tuple[NDArray[np.int64], FloatArray, BoolArray]:
    """Return the pixels (4, ...) each position needs, their weights, and whether all exist."""
    near = np.rint(at)
    on = np.abs(at - near) < _ON_PIXEL
    base = np.where(on, near, np.floor(at)).astype(np.int64)
    weights = np.stack(_cubic(np.where(on, 0.0, at - base)))
    index = np.stack([base - 1, base, base + 1, base + 2])
    weights[np.abs(weights) < 1e-15] = 0.0
    inside = np.all((weights == 0.0) | ((index >= 0) & (index < n)), axis=0)
    return np.clip(index, 0, n - 1), np.where(inside, weights, 0.0), inside


def _kernel(at: FloatArray, n: int) -> tuple[Any, FloatArray]:
    """Return the interpolation matrix of one axis, and its noise gain; 0 outside."""
    from scipy import sparse

    index, weights, inside = _taps(at, n)
    row = np.broadcast_to(np.arange(at.size), index.shape)
    keep = weights != 0.0
    matrix = sparse.csr_matrix((weights[keep], (row[keep], index[keep])), shape=(at.size, n))
    return matrix, np.where(inside, (weights**2).sum(axis=0), 0.0)


def _turned(u: FloatArray, v: FloatArray, shape: tuple[int, int]) -> tuple[Any, FloatArray]:
    from scipy import sparse

    iu, wu, in_u = _taps(u.ravel(), shape[1])
    iv, wv, in_v = _taps(v.ravel(), shape[0])
    inside = in_u & in_v
    weights = np.where(inside, wv[:, None, :] * wu[None, :, :], 0.0)
    index = iv[:, None, :] * shape[1] + iu[None, :, :]
    row = np.broadcast_to(np.arange(u.size), weights.shape)
    keep = weights != 0.0
    matrix = sparse.csr_matrix(
        (weights[keep], (row[keep], index[keep])), shape=(u.size, shape[0] * shape[1])
    )
    gain = np.where(inside, (weights**2).sum(axis=(0, 1)), 0.0)
    return matrix, gain


# ---- sub-apertures as callers give them: maps or profiles with positions, brought to one grid ----

MOST_PIXELS = 60_000_000
"""Largest stitched map; beyond it a position is more likely wrong than the part that large."""

_LARGEST_STEP = 0.1
"""In m: a coarser pixel is more likely in another unit."""

_LARGEST_SPAN = 1e-3
"""In m: no interferometer measures more in one sub-aperture."""


@dataclass(frozen=True, slots=True)
class Pieces:
    """Sub-apertures with their positions, in one lateral scale."""

    # of ndarray, shape (n_y, n_x), m: readings; profiles have one row
    values: tuple[FloatArray, ...]
    # shape (n, 2), m: position (x, y) of the first pixel of each, as if it were not turned
    corners: FloatArray
    # shape (n,), rad: by which each lies turned on the part, counter-clockwise about its centre
    turns: FloatArray
    dx: float  # m: lateral steps
    dy: float
    line: bool  # whether they are profiles
    history: tuple[Step, ...] = ()  # of all of them
    calibrated: bool = True  # whether steps and positions are in m
    warnings: tuple[str, ...] = ()  # units that look wrong
    known: FloatArray | None = None  # shape (n_y, n_x), m: reference that was subtracted

    def __len__(self) -> int:
        return len(self.values)

    @property
    def kind(self) -> str:
        """What a sub-aperture is called in messages."""
        return "profile" if self.line else "map"


def pieces_of(
    maps: Sequence[ArrayLike | Surface | Profile],
    positions: ArrayLike | None,
    rotations: ArrayLike | None,
    dx: float | None,
    dy: float | None,
) -> Pieces:
    """Return sub-apertures of any accepted kind, checked."""
    items: list[Any] = _input_listed(maps)
    kinds = {type(i) if isinstance(i, Surface | Profile) else np.ndarray for i in items}
    if len(kinds) > 1:
        raise DataError(
            "stitch: give all sub-apertures as surfaces, profiles or arrays, not mixed"
        )
    kind = kinds.pop()
    own_steps = kind in (Surface, Profile)
    if own_steps and (dx is not None or dy is not None):
        raise DataError("stitch: surfaces and profiles carry their own step; leave out dx and dy")
    arrays = [_array(i.z if own_steps else i, k) for k, i in enumerate(items)]
    line = arrays[0].ndim == 1
    if any(a.ndim != arrays[0].ndim for a in arrays) or arrays[0].ndim not in (1, 2):
        shapes = ", ".join(str(a.shape) for a in arrays)
        raise InvalidSamplesError(
            f"stitch needs maps (2-D) or profiles (1-D), got shapes {shapes}"
        )
    step_x, step_y, calibrated = _steps(items, kind, dx, dy, line)
    corners = _corners(items, kind, positions, line)
    turns = _turns(rotations, len(items), line)
    _sane(corners, turns, arrays, step_x, step_y, calibrated=calibrated)
    history = tuple(s for i in items if own_steps for s in i.history)
    values = tuple(np.atleast_2d(a) for a in arrays)
    warnings = _unit_warnings(values, step_x, step_y) if calibrated else ()
    return Pieces(values, corners, turns, step_x, step_y, line, history, calibrated, warnings)


def _input_listed(maps: Any) -> list[Any]:
    if isinstance(maps, Surface | Profile) or (isinstance(maps, np.ndarray) and maps.ndim < 2):
        raise InvalidSamplesError("stitch needs several sub-apertures: a list of maps or profiles")
    try:
        items = list(maps)
    except TypeError:
        raise InvalidSamplesError(f"stitch needs a list, got {type(maps).__name__}") from None
    if len(items) < 2:
        raise TooFewSamplesError(f"stitch needs at least 2 sub-apertures, got {len(items)}")
    return items


def _array(item: Any, k: int) -> FloatArray:
    z = as_numbers(item, f"stitch: sub-aperture {k + 1} must hold numbers in m")
    if np.isinf(z).any():
        raise InvalidSamplesError(
            f"stitch: sub-aperture {k + 1} is infinite somewhere; mark what was not measured as NaN"
        )
    if np.count_nonzero(~np.isnan(z)) < 4:
        raise InvalidSamplesError(
            f"stitch: sub-aperture {k + 1} has fewer than 4 measured samples"
        )
    return z


def _steps(
    items: list[Any], kind: type, dx: float | None, dy: float | None, line: bool
) -> tuple[float, float, bool]:
    if kind is Profile:
        steps = [(p.dx, p.dx) for p in items]
    elif kind is Surface:
        if any(s.dx is None or s.dy is None for s in items):
            raise DataError("stitch: a surface has no lateral step; positions need dx and dy in m")
        steps = [(s.dx, s.dy) for s in items]
    else:
        if dx is None and dy is not None:
            raise DataError("stitch: dy is given without dx; give dx, or both, in m")
        first = 1.0 if dx is None else positive(dx, "stitch: dx", dimension="length")
        second = first if dy is None else positive(dy, "stitch: dy", dimension="length")
        return first, second, dx is not None
    for k, (sx, sy) in enumerate(steps[1:], start=2):
        for name, value, first in (("dx", sx, steps[0][0]), ("dy", sy, steps[0][1])):
            if abs(value - first) > 1e-6 * first and not (line and name == "dy"):
                raise DataError(
                    f"stitch: {name} of sub-aperture {k} is {value:.9g} m, of the first "
                    f"{first:.9g} m; resample them to one lateral step"
                )
    return steps[0][0], steps[0][1], True


def _corners(items: list[Any], kind: type, positions: ArrayLike | None, line: bool) -> FloatArray:
    n = len(items)
    if positions is None:
        if kind is Profile:
            return np.array([(p.x[0], 0.0) for p in items])
        if kind is Surface:
            return np.array([s.origin for s in items], dtype=np.float64)
        raise DataError("stitch: arrays need positions: where the first sample of each lies, in m")
    found = as_numbers(positions, "stitch: positions must be numbers in m")
    if line and found.shape == (n,):
        found = np.column_stack([found, np.zeros(n)])
    if found.shape != (n, 2):
        want = f"({n},)" if line else f"({n}, 2), x and y of the first pixel of each map"
        raise DataError(f"stitch: positions have the shape {found.shape}, needed is {want}")
    if not np.isfinite(found).all():
        raise InvalidSamplesError("stitch: a position is not finite")
    return found


def _turns(rotations: ArrayLike | None, n: int, line: bool) -> FloatArray:
    if rotations is None:
        return np.zeros(n)
    turns = np.atleast_1d(as_numbers(rotations, "stitch: rotations must be angles in rad"))
    if turns.shape != (n,) or not np.isfinite(turns).all():
        raise DataError(f"stitch: rotations must be {n} finite angles in rad")
    if line and np.any(turns != 0.0):
        raise DataError("stitch: profiles cannot be turned")
    if np.abs(turns).max() > 2.0 * np.pi + 1e-9:
        raise DataError(
            f"stitch: a rotation is {np.abs(turns).max():.6g} rad, more than one turn; this looks "
            "like degrees: give numpy.radians(rotations)"
        )
    return turns


def _sane(
    corners: FloatArray,
    turns: FloatArray,
    arrays: list[FloatArray],
    dx: float,
    dy: float,
    *,
    calibrated: bool,
) -> None:
    shapes = [np.atleast_2d(a).shape for a in arrays]
    span = np.ptp(corners, axis=0) / np.array([dx, dy])
    wide, high = span[0] + max(s[1] for s in shapes), span[1] + max(s[0] for s in shapes)
    if wide * high > MOST_PIXELS:
        raise DataError(
            f"stitch: the positions span {wide:.4g} x {high:.4g} pixels, more than can be stitched; "
            "are positions and steps both in m?"
        )
    if span.max() < 1.0 and np.ptp(turns) == 0.0:
        hint = (
            f"({dx:.3g} m), so nothing is stitched; are positions and steps both in m?"
            if calibrated
            else "(pixels, as dx was not given), so nothing is stitched; give dx in m."
        )
        raise DataError(
            f"stitch: all positions lie within {span.max():.3g} of one lateral step {hint} Repeats at "
            "one place are for repeatable"
        )


def _unit_warnings(values: tuple[FloatArray, ...], dx: float, dy: float) -> tuple[str, ...]:
    out = []
    if max(dx, dy) > _LARGEST_STEP:
        out.append(f"the lateral step is {max(dx, dy):.3g} m; is it in m? 10 um is 1e-5")
    span = max(float(np.nanmax(v) - np.nanmin(v)) for v in values)
    if span > _LARGEST_SPAN:
        out.append(f"the heights of one sub-aperture span {span:.3g} m; are they in m?")
    return tuple(out)


# ---- overlaps of sub-apertures: which exist, whether they connect all, what does not fit in them ----

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
