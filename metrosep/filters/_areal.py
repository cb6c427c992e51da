"""Private: areal Gaussian of arrays with holes, by local regression of order 0 or 1.

With weights p = s(x_j - x, y_j - y) over the valid pixels j, means < > under p, m = <r_j - r>
and V the covariance of r_j under p, the plane through the neighbourhood has at the pixel the
height ``<z> - m' V^-1 (<r z> - m <z>)`` (moment criterion of order 1, ISO 16610-28). Stripe by
stripe the moments come out of the passes below and the 2 x 2 system of each pixel is
solved while they are in the cache; blocks whose windows are complete need one moment only.

A plane is taken out first and put back: order 1 keeps planes, so this changes nothing but digits.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray, IntArray
from metrosep.core.blas import one_blas_thread, threads

ALPHA = math.sqrt(math.log(2.0) / math.pi)
"""The constant a = 0.4697: half of the amplitude passes at the cutoff."""

WINDOW = 7.0
"""Half-width in standard deviations (1.31 cutoffs); 3e-12 of the weight lies outside."""

COMPLETE = 1.0 - 5e-11
"""Support share from which the window counts as complete."""

SINGULAR = 1e-9
"""Determinant of the second moments (in squared deviations) below which no slope is fitted."""


def standard_deviation(cutoff: float, step: float) -> float:
    """Return the standard deviation of the weighting function in samples."""
    return ALPHA * cutoff / (math.sqrt(2.0 * math.pi) * step)


def lattice_sum(sd: float) -> float:
    """Return the sum of exp(-u^2 / 2 sd^2) over the integers u of the window."""
    u = np.arange(1, half_width(sd) + 1) / sd
    return 1.0 + 2.0 * float(np.exp(-0.5 * u * u).sum())


def half_width(sd: float) -> int:
    """Return the number of samples on either side of the centre that carry weight."""
    return math.ceil(WINDOW * sd)


_STRIPE = 96
_BLOCK = 96
"""Rows of a stripe and columns of a block: small enough for the cache, large enough for two threads."""

_LINES = 32
"""Rows that are read together: their heights and weights stay in the second-level cache."""

_TINY = 1e-30
"""Smallest weight that is divided by; such pixels are reported as without support."""

_SURE = 2.0 * SINGULAR
"""Determinant above which no pixel is singular, since its zeroth moment does not exceed 1."""

_MAX_WORKERS = 4
_MAX_FIT = 65536
"""Pixels that the reference plane is fitted to."""


def areal_gaussian(
    z: FloatArray, sds: tuple[float, float], *, order: int, min_support: float, fill: bool
) -> FloatArray:
    """Return the mean surface.

    `sds` are the standard deviations along y and x in pixels. The result is NaN where the support
    share is below `min_support` and, without `fill`, where `z` is.
    """
    plane = reference_plane(z, order)

    def finish(part: slice, out: FloatArray, share: FloatArray, room: FloatArray) -> None:
        out += _plane(plane, part, room)
        if not fill:
            with np.errstate(invalid="ignore"):
                out += np.subtract(z[part], z[part], out=room)  # 0, or NaN where z is
        if share.min() < min_support:
            out[share < min_support] = np.nan

    return _passes(z, sds, plane, order, finish)


def areal_support(z: FloatArray, sds: tuple[float, float]) -> FloatArray:
    """Return the share of the weight that lies on valid pixels, 0 to 1."""

    def finish(part: slice, out: FloatArray, share: FloatArray, room: FloatArray) -> None:
        np.clip(share, 0.0, 1.0, out=out)

    return _passes(z, sds, (0.0, 0.0, 0.0), 0, finish)


def _passes(
    z: FloatArray,
    sds: tuple[float, float],
    plane: tuple[float, float, float],
    order: int,
    finish: Callable[[slice, FloatArray, FloatArray, FloatArray], None],
) -> FloatArray:
    n_y, n_x = z.shape
    y, x = make_axis(n_y, sds[0], _STRIPE), make_axis(n_x, sds[1], _BLOCK)
    rows = np.empty((2, n_y, x.n_nodes))
    out = np.empty_like(z)
    transposed = [[np.ascontiguousarray(m.T) for m in np.split(p.matrix, 3)] for p in x.up]

    whole_row = _down_x(np.ones((1, n_x)), x)

    # fresh memory costs more than what is done with it: each worker keeps its own for all stripes
    def down(starts: Sequence[int]) -> None:
        room = _Room.of(_LINES, n_x)
        for start in starts:
            part = slice(start, min(start + _LINES, n_y))
            n_lost = room.read(z[part], plane, part)
            heights, weights = room.heights[: part.stop - start], room.weights[: part.stop - start]
            rows[1, part] = _down_x(heights, x)
            # most stripes of most measurements are whole: their weights are known
            rows[0, part] = _down_x(weights, x) if n_lost else whole_row

    def up(pieces: Sequence[Piece]) -> None:
        room = np.empty((2, min(_STRIPE, n_y), n_x))
        work = _Work.of(min(_STRIPE, n_y), x.n_nodes)
        for piece in pieces:
            part = slice(piece.start, piece.stop)
            share, other = room[:, : piece.stop - piece.start]
            _up(piece, x, transposed, nodes, out[part], share, order, work)
            finish(part, out[part], share, other)

    n_workers = threads(_MAX_WORKERS)
    strips = [range(k * _LINES, n_y, n_workers * _LINES) for k in range(n_workers)]
    with one_blas_thread(), ExitStack() as stack:
        pool = stack.enter_context(ThreadPoolExecutor(n_workers)) if n_workers > 1 else None
        _each(pool, down, strips)
        nodes = _down_y(rows, y)
        _each(pool, up, [y.up[k::n_workers] for k in range(n_workers)])
    return out


def _each(
    pool: ThreadPoolExecutor | None, function: Callable[[Any], None], items: list[Any]
) -> None:
    """Call a function with each item, in the threads of a pool if there is one."""
    for _ in map(function, items) if pool is None else pool.map(function, items):
        pass


class _Room(NamedTuple):
    """Memory for some rows of a map: heights, weights, what is valid."""

    heights: FloatArray
    weights: FloatArray
    valid: NDArray[np.bool_]

    @classmethod
    def of(cls, n_rows: int, n_x: int) -> _Room:
        """Return room for rows of a map."""
        shape = (n_rows, n_x)
        return cls(np.empty(shape), np.empty(shape), np.empty(shape, dtype=np.bool_))

    def read(self, z: FloatArray, plane: tuple[float, float, float], part: slice) -> int:
        """Fill in heights above the plane and weights, 0 where not measured; count those."""
        n = z.shape[0]
        heights, weights, valid = self.heights[:n], self.weights[:n], self.valid[:n]
        np.subtract(z, _plane(plane, part, heights), out=heights)
        np.equal(heights, heights, out=valid)
        n_lost = valid.size - int(np.count_nonzero(valid))
        if n_lost:  # zeros by their bits, because NaN times zero is NaN
            bits, ones = heights.view(np.int64), weights.view(np.int64)
            np.copyto(ones, np.negative(valid.view(np.int8)))
            bits &= ones
            np.copyto(weights, valid)
        return n_lost


class _Work(NamedTuple):
    """Memory for a stripe of the result: rows at the nodes, and fields of a block."""

    w: FloatArray
    t: FloatArray
    fields: FloatArray

    @classmethod
    def of(cls, n_rows: int, n_nodes: int) -> _Work:
        """Return room for a stripe."""
        shape = (n_rows, n_nodes)
        return cls(np.empty((3, *shape)), np.empty((2, *shape)), np.empty(12 * n_rows * _BLOCK))


def reference_plane(z: FloatArray, order: int) -> tuple[float, float, float]:
    """Return level and slopes per row and column of a plane near the valid data.

    Order 0 keeps constants only, so its slopes are 0.
    """
    stride = max(1, int(np.sqrt(z.size / _MAX_FIT)))
    part = z[::stride, ::stride]
    valid = ~np.isnan(part)
    if np.count_nonzero(valid) < 4:
        return float(z[~np.isnan(z)][0]), 0.0, 0.0
    row, column = (stride * i.astype(np.float64) for i in np.nonzero(valid))
    heights = part[valid]
    level = float(heights[0])
    if order == 0:
        return level, 0.0, 0.0
    scale = float(max(z.shape))
    basis = np.column_stack([np.ones(heights.size), row / scale, column / scale])
    c = np.linalg.lstsq(basis, heights - level, rcond=None)[0]
    return level + float(c[0]), float(c[1] / scale), float(c[2] / scale)


def _plane(plane: tuple[float, float, float], part: slice, out: FloatArray) -> FloatArray:
    rows = plane[0] + plane[1] * np.arange(part.start, part.stop)
    columns = plane[2] * np.arange(out.shape[1])
    np.add(rows[:, None], columns, out=out)
    return out


def _down_x(values: FloatArray, x: Axis) -> FloatArray:
    if x.down is None:
        return values
    nodes = np.empty((values.shape[0], x.n_nodes))
    for p in x.down:
        np.matmul(values[:, p.first : p.last], p.matrix.T, out=nodes[:, p.start : p.stop])
    return nodes


def _down_y(rows: FloatArray, y: Axis) -> FloatArray:
    if y.down is None:
        return rows
    nodes = np.empty((2, y.n_nodes, rows.shape[2]))
    for p in y.down:
        np.matmul(p.matrix, rows[:, p.first : p.last], out=nodes[:, p.start : p.stop])
    return nodes


def _up(
    piece: Piece,
    x: Axis,
    transposed: list[list[FloatArray]],
    nodes: FloatArray,
    out: FloatArray,
    share: FloatArray,
    order: int,
    work: _Work,
) -> None:
    """Fill a stripe of the result and of the support share."""
    b = piece.stop - piece.start
    w, t = work.w.reshape(-1, x.n_nodes)[: 3 * b], work.t.reshape(-1, x.n_nodes)[: 2 * b]
    np.matmul(piece.matrix, nodes[0, piece.first : piece.last], out=w)
    np.matmul(piece.matrix[: 2 * b], nodes[1, piece.first : piece.last], out=t)
    for p, m in zip(x.up, transposed, strict=True):
        c = p.stop - p.start
        near = slice(p.first, p.last)
        rows = work.fields[: 12 * b * c].reshape(
            12 * b, c
        )  # b rows of each field, products in one go
        fields = rows.reshape(12, b, c)
        part = out[:, p.start : p.stop]
        np.matmul(w[:b, near], m[0], out=rows[:b])
        np.matmul(t[:b, near], m[0], out=rows[6 * b : 7 * b])
        zeroth = fields[0]
        share[:, p.start : p.stop] = zeroth
        if order == 0 or zeroth.min() > COMPLETE:
            np.divide(fields[6], np.maximum(zeroth, _TINY, out=zeroth), out=part)
            continue
        np.matmul(w[b:, near], m[0], out=rows[b : 3 * b])
        np.matmul(w[: 2 * b, near], m[1], out=rows[3 * b : 5 * b])
        np.matmul(w[:b, near], m[2], out=rows[5 * b : 6 * b])
        np.matmul(t[b:, near], m[0], out=rows[7 * b : 8 * b])
        np.matmul(t[:b, near], m[1], out=rows[8 * b : 9 * b])
        _local_plane(fields, part)


def _local_plane(fields: FloatArray, out: FloatArray) -> None:
    """Fill `out` with the heights at the pixels of the planes through their neighbours.

    Fields 0-5 are the moments 1, y, yy, x, xy, xx of the weights, 6-8 the moments 1, y, x of the
    weighted heights, the rest is room. Cramer's rule with the first row of the adjugate (a, b, c);
    fields of like treatment go in pairs, because each call costs as much as a thousand pixels.
    """
    one, _, b_x, _, xy, c_y, z, c_yz, b_xz, a = fields[:10]
    y_x, x_y, xx_yy, yz_xz = fields[1:4:2], fields[3:0:-2], fields[5:1:-3], fields[7:9]
    c_b = fields[10:12]
    np.multiply(fields[5], fields[2], out=a)
    np.multiply(xy, x_y, out=c_b)
    c_b -= np.multiply(y_x, xx_yy, out=xx_yy)
    a -= np.multiply(xy, xy, out=xy)
    np.multiply(c_b, y_x, out=xx_yy)
    determinant = np.multiply(a, one, out=xy)
    determinant += b_x
    determinant += c_y
    a *= z
    np.multiply(c_b, yz_xz, out=yz_xz)
    a += b_xz
    a += c_yz
    if determinant.min() <= _SURE:
        singular = determinant <= SINGULAR * one * one * one
        a[singular] = z[singular]
        determinant[singular] = np.maximum(one[singular], _TINY)
    np.divide(a, determinant, out=out)


# ---- private: Gaussian weighting along one axis as two passes of small banded matrices ---------
# The Gaussian is split into two of half the variance. The first pass brings the samples onto a
# coarse grid (2.4 nodes per standard deviation), the second brings them back; the sum over the nodes
# equals the one Gaussian to 1e-12. First and second moments about a sample are derivatives of the
# zeroth one, so they cost only other weights in the second pass and nothing in the first. A narrow
# Gaussian (less than two samples per node) is applied in one pass.

_NODES_PER_SD = 2.4
"""Coarse nodes per standard deviation: 2 exp(-pi^2 2.4^2 / 2) = 9e-13 of aliasing."""


class Piece(NamedTuple):
    """A dense piece of a banded matrix: ``out[start:stop] += matrix @ in[first:last]``."""

    start: int
    stop: int
    first: int
    last: int
    matrix: FloatArray


@dataclass(frozen=True, slots=True)
class Axis:
    """The two passes along one axis of `n` pixels."""

    n: int
    n_nodes: int
    down: tuple[Piece, ...] | None
    up: tuple[Piece, ...]


def make_axis(n: int, sd: float, block: int) -> Axis:
    """Return the passes of a Gaussian of `sd` pixels along `n` pixels.

    The matrices of `up` hold three blocks of rows: the weights times 1, u and u^2, where u is the
    distance in standard deviations from the pixel to the datum.
    """
    pitch = int(sd / _NODES_PER_SD)
    if pitch < 2:
        u_max, scale = WINDOW * sd, 1.0 / lattice_sum(sd)

        def weights(u: FloatArray) -> FloatArray:
            v = u / sd
            g = scale * np.exp(-0.5 * v * v)
            return np.concatenate([g, v * g, v * v * g])

        return Axis(n, n, None, _pieces(np.arange(n), np.arange(n), u_max, block, weights))
    reach = math.ceil(WINDOW * sd / math.sqrt(2.0))
    nodes = pitch * np.arange(-(reach // pitch), (n - 1 + reach) // pitch + 1)
    norm = 1.0 / (sd * math.sqrt(math.pi))

    def narrow(u: FloatArray) -> FloatArray:
        v = u / sd
        return np.asarray(norm * np.exp(-v * v))

    def moments(u: FloatArray) -> FloatArray:
        v = u / sd
        g = (pitch * norm) * np.exp(-v * v)
        return np.concatenate([g, 2.0 * v * g, (4.0 * v * v - 1.0) * g])

    pixels = np.arange(n)
    return Axis(
        n,
        nodes.size,
        _pieces(nodes, pixels, reach, max(8, block // pitch), narrow),
        _pieces(pixels, nodes, reach, block, moments),
    )


def _pieces(
    targets: IntArray,
    sources: IntArray,
    reach: float,
    block: int,
    weights: Callable[[FloatArray], FloatArray],
) -> tuple[Piece, ...]:
    """Cut the matrix weights(source - target) into dense pieces of `block` targets."""
    pieces = []
    for start in range(0, targets.size, block):
        part = targets[start : start + block]
        first = int(np.searchsorted(sources, part[0] - reach))
        last = int(np.searchsorted(sources, part[-1] + reach, side="right"))
        u = (sources[None, first:last] - part[:, None]).astype(np.float64)
        pieces.append(Piece(start, start + part.size, first, last, weights(u)))
    return tuple(pieces)
