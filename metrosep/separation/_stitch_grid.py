"""Sub-apertures on the pixels of one stitched grid: interpolation, its adjoint, masks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import BoolArray, FloatArray
from metrosep.separation._stitch_input import Pieces

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


def _extent(pieces: Pieces, k: int) -> tuple[float, float, float, float]:
    n_y, n_x = pieces.values[k].shape
    half = np.array([(n_x - 1) / 2 * pieces.dx, (n_y - 1) / 2 * pieces.dy])
    centre = np.array(centre_of(pieces, k))
    c, s = abs(np.cos(pieces.turns[k])), abs(np.sin(pieces.turns[k]))
    if pieces.turns[k] != 0.0:
        half = np.array([c * half[0] + s * half[1], s * half[0] + c * half[1]])
    low, high = centre - half, centre + half
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


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
