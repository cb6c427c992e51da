"""Private: areal Gaussian of arrays with holes, by local regression of order 0 or 1.

With weights p = s(x_j - x, y_j - y) over the valid pixels j, means < > under p, m = <r_j - r>
and V the covariance of r_j under p, the plane through the neighbourhood has at the pixel the
height ``<z> - m' V^-1 (<r z> - m <z>)`` (moment criterion of order 1, ISO 16610-28). Stripe by
stripe the moments come out of `metrosep.filters._passes` and the 2 x 2 system of each pixel is
solved while they are in the cache; blocks whose windows are complete need one moment only.

A plane is taken out first and put back: order 1 keeps planes, so this changes nothing but digits.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from metrosep.core.blas import one_blas_thread
from metrosep.filters._kernel import COMPLETE, SINGULAR
from metrosep.filters._passes import Axis, Piece, make_axis

FloatArray = NDArray[np.float64]

_STRIPE = 96
_BLOCK = 96
"""Rows of a stripe and columns of a block: small enough for the cache, large enough for two threads."""

_TINY = 1e-30
"""Smallest weight that is divided by; such pixels are reported as without support."""

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
    n_x = z.shape[1]
    plane = reference_plane(z, order)

    def finish(part: slice, out: FloatArray, share: FloatArray) -> None:
        out += _plane(plane, part, n_x)
        lost = share < min_support
        if not fill:
            lost |= np.isnan(z[part])
        if lost.any():
            out[lost] = np.nan

    return _passes(z, sds, plane, order, finish)


def areal_support(z: FloatArray, sds: tuple[float, float]) -> FloatArray:
    """Return the share of the weight that lies on valid pixels, 0 to 1."""

    def finish(part: slice, out: FloatArray, share: FloatArray) -> None:
        np.clip(share, 0.0, 1.0, out=out)

    return _passes(z, sds, (0.0, 0.0, 0.0), 0, finish)


def _passes(
    z: FloatArray,
    sds: tuple[float, float],
    plane: tuple[float, float, float],
    order: int,
    finish: Callable[[slice, FloatArray, FloatArray], None],
) -> FloatArray:
    n_y, n_x = z.shape
    y, x = make_axis(n_y, sds[0], _STRIPE), make_axis(n_x, sds[1], _BLOCK)
    rows = np.empty((2, n_y, x.n_nodes))
    out = np.empty_like(z)

    whole_row = _down_x(np.ones((1, n_x)), x)

    def down(start: int) -> None:
        part = slice(start, min(start + _STRIPE, n_y))
        lost, heights = _residual(z, plane, part)
        rows[1, part] = _down_x(heights, x)
        # most stripes of most measurements are whole: their weights are known
        rows[0, part] = _down_x((~lost).astype(np.float64), x) if lost.any() else whole_row

    def up(piece: Piece) -> None:
        part = slice(piece.start, piece.stop)
        share = np.empty_like(out[part])
        _up(piece, x, nodes, out[part], share, order)
        finish(part, out[part], share)

    with one_blas_thread(), ThreadPoolExecutor(min(_MAX_WORKERS, os.cpu_count() or 1)) as pool:
        list(pool.map(down, range(0, n_y, _STRIPE)))
        nodes = _down_y(rows, y)
        list(pool.map(up, y.up))
    return out


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


def _plane(plane: tuple[float, float, float], part: slice, n_x: int) -> FloatArray:
    rows = plane[0] + plane[1] * np.arange(part.start, part.stop)
    return np.asarray(rows[:, None] + plane[2] * np.arange(n_x))


def _residual(
    z: FloatArray, plane: tuple[float, float, float], part: slice
) -> tuple[NDArray[np.bool_], FloatArray]:
    """Return what was not measured, and the height above the plane, 0 where not measured."""
    heights = _plane(plane, part, z.shape[1])
    np.subtract(z[part], heights, out=heights)
    lost = np.isnan(heights)
    heights[lost] = 0.0
    return lost, heights


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
    piece: Piece, x: Axis, nodes: FloatArray, out: FloatArray, share: FloatArray, order: int
) -> None:
    """Fill a stripe of the result and of the support share."""
    b = piece.stop - piece.start
    w = piece.matrix @ nodes[0, piece.first : piece.last]
    t = piece.matrix[: 2 * b] @ nodes[1, piece.first : piece.last]
    work = np.empty((12, b, _BLOCK))
    for p in x.up:
        c = p.stop - p.start
        m = [p.matrix[i * c : (i + 1) * c].T for i in range(3)]
        near = slice(p.first, p.last)
        w0, w1, w2 = (w[i * b : (i + 1) * b, near] for i in range(3))
        t0, t1 = (t[i * b : (i + 1) * b, near] for i in range(2))
        fields = list(work[:, :, :c])
        part = out[:, p.start : p.stop]
        zeroth = np.matmul(w0, m[0], out=fields[0])
        share[:, p.start : p.stop] = zeroth
        np.matmul(t0, m[0], out=fields[6])
        if order == 0 or zeroth.min() > COMPLETE:
            np.divide(fields[6], np.maximum(zeroth, _TINY, out=zeroth), out=part)
            continue
        pairs = ((w0, m[1]), (w1, m[0]), (w0, m[2]), (w1, m[1]), (w2, m[0]))
        for field, (left, right) in zip(fields[1:6], pairs, strict=True):
            np.matmul(left, right, out=field)
        np.matmul(t0, m[1], out=fields[7])
        np.matmul(t1, m[0], out=fields[8])
        _local_plane(fields, part)


def _local_plane(fields: list[FloatArray], out: FloatArray) -> None:
    """Fill `out` with the heights at the pixels of the planes through their neighbours.

    Fields 0-5 are the moments 1, x, y, xx, xy, yy of the weights, 6-8 the moments 1, x, y of the
    weighted heights, the rest is room. Cramer's rule with the first row of the adjugate (a, b, c).
    """
    one, x, y, xx, xy, yy, z, xz, yz, a, b, c = fields
    np.multiply(xx, yy, out=a)
    a -= np.multiply(xy, xy, out=b)
    np.multiply(xy, y, out=b)
    b -= np.multiply(x, yy, out=c)
    np.multiply(x, xy, out=c)
    c -= np.multiply(xx, y, out=xx)
    determinant = np.multiply(a, one, out=xx)
    determinant += np.multiply(b, x, out=x)
    determinant += np.multiply(c, y, out=y)
    cube = np.multiply(one, one, out=xy)
    cube *= one
    cube *= SINGULAR
    singular = determinant <= cube
    a *= z
    a += np.multiply(b, xz, out=xz)
    a += np.multiply(c, yz, out=yz)
    if singular.any():
        a[singular] = z[singular]
        determinant[singular] = np.maximum(one[singular], _TINY)
    np.divide(a, determinant, out=out)
