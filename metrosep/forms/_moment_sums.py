"""Private helpers: one pass over a map gathers all sums of a least-squares fit, in row blocks."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DegenerateFitError, InvalidSamplesError
from metrosep.forms._orthogonal import linearisation

__all__ = [
    "Grid",
    "Sums",
    "UnsignedArray",
    "bounding_box",
    "grid_values",
    "inverse_of",
    "normal_matrix",
    "residual_sums",
]

UnsignedArray = NDArray[np.unsignedinteger[Any]]

_BLOCK = 65536
"""Pixels of a block: residuals and weights together stay in the second-level cache."""

_SMALL_PRODUCT = 1_000_000
"""Multiplications up to which OpenBLAS spares itself the packing of a matrix; measured: half the
time of a product that is a tenth larger."""

_BUFFER = 512
"""Elements of numpy's buffer. Rows shorter than it, of which a part is taken, are copied to fill it
first, which doubles the time of a difference and triples that of a comparison."""

_SMALLEST_EIGENVALUE = 1e-13
"""Of the normal matrix with ones on its diagonal: below it, rounding decides the answer."""

_PLAIN = 1e4
"""Condition up to which a plain inverse is as good as one by eigenvalues, which costs more."""


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """A map with its Legendre values, degree along the rows of `px` (columns) and `py` (rows).

    `reach` holds, for each row, the first column that counts and the first one after them, as
    unsigned numbers; without it all columns do. NaN and pixels of weight 0 never count.
    """

    z: FloatArray
    weights: FloatArray | None
    px: FloatArray
    py: FloatArray
    reach: tuple[UnsignedArray, UnsignedArray] | None = None

    def every(self, skip: int) -> Grid:
        """Return every n-th row and column."""
        some = slice(None, None, skip)
        reach = None
        if self.reach is not None:
            first, after = ((end[some] + (skip - 1)) // skip for end in self.reach)
            reach = (first, after)
        return Grid(
            np.ascontiguousarray(self.z[some, some]),
            None if self.weights is None else self.weights[some, some],
            np.ascontiguousarray(self.px[:, some]),
            np.ascontiguousarray(self.py[:, some]),
            reach,
        )

    def valid(self) -> NDArray[np.bool_]:
        """Return which pixels count."""
        out: NDArray[np.bool_] = ~np.isnan(self.z)
        if self.weights is not None:
            out &= self.weights > 0.0
        if self.reach is not None:
            first, after = self.reach
            place = np.arange(self.z.shape[1])
            out &= (place >= first[:, None]) & (place < after[:, None])
        return out


@dataclass(frozen=True, slots=True, eq=False)
class Sums:
    """Sums over a map; first index along x, second along y."""

    weights: FloatArray
    heights: FloatArray
    squares: float
    n_valid: int


class _Block(NamedTuple):
    """Rows, the columns that count in any of them, and those that count in all: from, to."""

    rows: slice
    columns: slice
    all_from: int
    all_to: int


def bounding_box(z: FloatArray, weights: FloatArray | None) -> tuple[slice, slice]:
    """Return rows and columns that hold every valid pixel; empty if there is none."""
    if weights is not None:
        z = np.where(weights == 0.0, np.nan, z)
    rows = _used(z)
    return rows, _used(z[rows].T)


def _used(z: FloatArray) -> slice:
    """Return the rows from the first to the last with a valid pixel: a look at the edges."""
    first = _unused(z)
    return slice(first, z.shape[0] - _unused(z[::-1])) if first < z.shape[0] else slice(0, 0)


def _used_columns(z: FloatArray) -> slice:
    """Return the columns from the first to the last with a valid pixel, of rows that are few."""
    if z.size and z[0, 0] == z[0, 0] and z[0, -1] == z[0, -1]:  # no NaN: quick to see
        return slice(0, z.shape[1])
    used = np.flatnonzero(~np.isnan(z).all(axis=0))
    return slice(int(used[0]), int(used[-1]) + 1) if used.size else slice(0, 0)


def _unused(z: FloatArray) -> int:
    """Return how many rows come before the first with a valid pixel."""
    n_lines = int(z.shape[0])
    if z.size and z[0, 0] == z[0, 0]:  # no NaN: mostly so, and quick to see
        return 0
    start, n_rows = 0, 16
    while start < n_lines:
        valid = ~np.isnan(z[start : start + n_rows]).all(axis=1)
        if valid.any():
            return start + int(valid.argmax())
        start, n_rows = start + n_rows, 2 * n_rows
    return n_lines


def residual_sums(grid: Grid, c: FloatArray, degree: int, *, with_weights: bool = True) -> Sums:
    """Return the sums over a map less the polynomial c.

    Sums of weights go to degree 2 d, and are zero unless asked for; sums of heights to degree d.
    """
    rows, n_columns = grid.z.shape
    n, m = degree + 1, 2 * degree + 1
    right = np.ascontiguousarray(grid.px[:m].T)
    low = np.ascontiguousarray(right[:, :n])
    left, across = c.T @ grid.px[: c.shape[0]], np.ascontiguousarray(grid.py[: c.shape[1]].T)
    row_weights, row_heights = np.zeros((rows, m)), np.zeros((rows, n))
    squares, n_valid = 0.0, 0
    height = max(1, min(_BLOCK, _SMALL_PRODUCT // m) // max(n_columns, 1))
    room = np.empty((2, height * n_columns))
    marks = np.empty(height * n_columns, dtype=np.bool_)
    with np.errstate(invalid="ignore", over="ignore"):
        np.setbufsize(_BUFFER)  # until the end of errstate
        for block in _blocks(grid, height):
            part, columns = block.rows, block.columns
            shape = (part.stop - part.start, columns.stop - columns.start)
            n_block = shape[0] * shape[1]
            if n_block == 0:
                continue
            r, w = room[0, :n_block].reshape(shape), room[1, :n_block].reshape(shape)
            valid = marks[:n_block].reshape(shape)
            n_here, energy = _fill(grid, block, across[part], left[:, columns], r, w, valid)
            n_valid += n_here
            if grid.weights is not None:
                w *= grid.weights[part, columns]
                energy = float(np.vdot(r * w, r))
                r *= w
            squares += energy
            if with_weights:
                these = right[columns]
                whole = n_here == n_block and grid.weights is None
                row_weights[part] = these.sum(axis=0) if whole else w @ these
            np.matmul(r, low[columns], out=row_heights[part])
        sums = row_heights.T @ grid.py[:n].T
    if not np.isfinite(sums).all() or not np.isfinite(squares):
        raise InvalidSamplesError(
            "z is infinite somewhere, or too large to be squared; write NaN where nothing was "
            "measured"
        )
    return Sums(row_weights.T @ grid.py[:m].T, sums, squares, n_valid)


def _blocks(grid: Grid, height: int) -> Iterator[_Block]:
    """Yield the blocks of a map, without the columns at either side that do not count."""
    rows, n_columns = grid.z.shape
    starts = np.arange(0, rows, height)
    if grid.reach is None or not rows:
        for start in starts.tolist():
            part = slice(start, min(start + height, rows))
            yield _Block(part, _used_columns(grid.z[part]), 0, n_columns)
        return
    edges = [
        extreme.reduceat(end, starts).tolist()
        for end in grid.reach
        for extreme in (np.minimum, np.maximum)
    ]
    for start, first, from_here, to_here, after in zip(starts.tolist(), *edges, strict=True):
        part = slice(start, min(start + height, rows))
        yield _Block(part, slice(first, max(first, after)), from_here, to_here)


def _fill(
    grid: Grid,
    block: _Block,
    across: FloatArray,
    left: FloatArray,
    r: FloatArray,
    w: FloatArray,
    valid: NDArray[np.bool_],
) -> tuple[int, float]:
    """Fill r with z less the product, w with 1, both 0 in gaps; return the pixels and squares of r.

    In gaps r is NaN at first. The lesser of r and w, NaN giving way, is 0 there and r elsewhere,
    unless r exceeds 1: then its squares do too, and gaps become zeros by their bits.
    """
    z = grid.z[block.rows, block.columns]
    np.subtract(z, np.matmul(across, left, out=r), out=r)
    np.equal(r, r, out=valid)
    _leave_out(grid, block, r, valid)
    n_valid = int(np.count_nonzero(valid))
    if n_valid == r.size:
        if grid.weights is not None:
            w.fill(1.0)
        return n_valid, float(np.vdot(r, r))
    np.copyto(w, valid.view(np.int8))  # whole numbers are converted faster than booleans
    np.fmin(r, w, out=r)
    energy = float(np.vdot(r, r))
    if energy < 1.0:
        return n_valid, energy
    np.subtract(z, np.matmul(across, left, out=r), out=r)
    bits = r.view(np.int64)
    bits &= np.negative(valid.view(np.int8)).astype(np.int64)
    return n_valid, float(np.vdot(r, r))


def _leave_out(grid: Grid, block: _Block, r: FloatArray, valid: NDArray[np.bool_]) -> None:
    """Take measured pixels that do not count out of `valid`, and write NaN into r there."""
    if grid.weights is not None:
        _take_out(grid.weights[block.rows, block.columns] == 0.0, r, valid)
    if grid.reach is None:
        return
    first, after = (end[block.rows, None] for end in grid.reach)
    start, stop = block.columns.start, block.columns.stop
    if block.all_from > start:
        place = np.arange(start, block.all_from, dtype=first.dtype)
        _take_out(place < first, r[:, : place.size], valid[:, : place.size])
    if block.all_to < stop:
        place = np.arange(max(block.all_to, start), stop, dtype=after.dtype)
        _take_out(place >= after, r[:, -place.size :], valid[:, -place.size :])


def _take_out(beyond: NDArray[np.bool_], r: FloatArray, valid: NDArray[np.bool_]) -> None:
    beyond &= valid
    if beyond.any():  # most maps hold nothing outside their aperture
        valid ^= beyond
        np.copyto(r, np.nan, where=beyond)


def grid_values(
    c: FloatArray, px: FloatArray, py: FloatArray, *, minus_from: FloatArray | None = None
) -> FloatArray:
    """Return the polynomial at every pixel, or a map minus it.

    From the last row up: what the pass before this one read last is still in the cache.
    """
    n = c.shape[0]
    left, across = c.T @ px[:n], np.ascontiguousarray(py[:n].T)
    out = np.empty((py.shape[1], px.shape[1]))
    height = max(1, _BLOCK // max(out.shape[1], 1))
    for start in reversed(range(0, out.shape[0], height)):
        part = slice(start, start + height)
        block = np.matmul(across[part], left, out=out[part])
        if minus_from is not None:
            np.subtract(minus_from[part], block, out=block)
    return out


def normal_matrix(sums: FloatArray, degree: int) -> FloatArray:
    """Return the weighted sums of ``P_i P_j P_k P_l`` at [i, j, k, l]; i, k along x, j, l along y.

    The product of two Legendre polynomials is a sum of others, so sums to degree 2 d suffice.
    """
    n, m = degree + 1, 2 * degree + 1
    product = linearisation(degree).reshape(n * n, m)
    both = (product @ sums @ product.T).reshape(n, n, n, n)
    return np.ascontiguousarray(both.transpose(0, 2, 1, 3))


def inverse_of(normal: FloatArray, what: str) -> tuple[FloatArray, float]:
    """Return the inverse of a normal matrix and a bound of its condition, or refuse to.

    With ones on its diagonal; the bound is the product of the largest column sums.
    """
    diagonal = np.sqrt(np.maximum(np.diag(normal), 0.0))
    if diagonal[0] > 0.0 and (diagonal > 1e-12 * diagonal[0]).all():
        scale = np.outer(diagonal, diagonal)
        scaled = normal / scale
        with suppress(np.linalg.LinAlgError):
            plain = np.linalg.inv(scaled)
            condition = float(np.abs(scaled).sum(axis=0).max() * np.abs(plain).sum(axis=0).max())
            if condition <= _PLAIN:
                return _fixed((plain + plain.T) / (2.0 * scale)), condition
        eigenvalues, vectors = np.linalg.eigh(scaled)
        if eigenvalues[0] > _SMALLEST_EIGENVALUE * eigenvalues[-1]:
            vectors /= diagonal[:, None]
            condition = float(eigenvalues[-1] / eigenvalues[0])
            return _fixed((vectors / eigenvalues) @ vectors.T), condition
    raise DegenerateFitError(
        f"the valid pixels do not determine {what}: they lie on too few rows, columns or curves, "
        "or on too small a part of the domain; use fewer terms or measure more of the part"
    )


def _fixed(inverse: FloatArray) -> FloatArray:
    inverse.setflags(write=False)
    return inverse
