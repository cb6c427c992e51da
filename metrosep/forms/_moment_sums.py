"""Private helpers: one pass over a map gathers all sums of a least-squares fit, in row blocks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DegenerateFitError, InvalidSamplesError
from metrosep.forms._orthogonal import linearisation

__all__ = [
    "Grid",
    "Sums",
    "bounding_box",
    "grid_values",
    "inverse_of",
    "normal_matrix",
    "residual_sums",
]

_BLOCK = 65536
"""Pixels of a block: half a megabyte of heights, so that the products run in the cache."""

_ONE = np.float64(1.0).view(np.int64)

_SMALLEST_EIGENVALUE = 1e-13
"""Of the normal matrix with ones on its diagonal: below it, rounding decides the answer."""


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """A map with its Legendre values, degree along the rows of `px` (columns) and `py` (rows)."""

    z: FloatArray
    invalid: NDArray[np.bool_]
    weights: FloatArray | None
    px: FloatArray
    py: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Sums:
    """Sums over a map; first index along x, second along y."""

    weights: FloatArray
    heights: FloatArray
    squares: float


def bounding_box(invalid: NDArray[np.bool_], needed: int) -> tuple[tuple[slice, slice], int]:
    """Return rows and columns that hold every valid pixel, and the number of valid pixels."""
    n_valid = int(invalid.size) - int(np.count_nonzero(invalid))
    if n_valid < needed:
        raise DegenerateFitError(
            f"{n_valid} valid pixels cannot determine {needed} terms; lower the degree or measure "
            "more of the part"
        )
    rows = np.flatnonzero(~invalid.all(axis=1))
    columns = np.flatnonzero(~invalid.all(axis=0))
    return (
        slice(int(rows[0]), int(rows[-1]) + 1),
        slice(int(columns[0]), int(columns[-1]) + 1),
    ), n_valid


def _valid_columns(invalid: NDArray[np.bool_]) -> slice:
    """Return the columns from the first to the last that hold a valid pixel."""
    used: NDArray[np.bool_] = np.logical_not(np.logical_and.reduce(invalid, axis=0))
    first = int(used.argmax())
    if not used[first]:
        return slice(0, 0)
    return slice(first, used.size - int(used[::-1].argmax()))


def residual_sums(grid: Grid, c: FloatArray, degree: int, *, with_weights: bool = True) -> Sums:
    """Return the sums over a map less the polynomial c.

    Sums of weights go to degree 2 d, and are zero unless asked for; sums of heights to degree d.
    Gaps become zeros by their bits, because NaN times zero is NaN.
    """
    rows, columns = grid.z.shape
    n, m = degree + 1, 2 * degree + 1
    right = np.ascontiguousarray(grid.px[:m].T)
    low = np.ascontiguousarray(right[:, :n])
    left, across = c.T @ grid.px[: c.shape[0]], np.ascontiguousarray(grid.py[: c.shape[1]].T)
    row_weights, row_heights = np.zeros((rows, m)), np.zeros((rows, n))
    squares = 0.0
    height = max(1, _BLOCK // max(columns, 1))
    heights = np.empty(height * columns)
    mask = np.empty(height * columns, dtype=np.int64)
    with np.errstate(invalid="ignore", over="ignore"):
        for start in range(0, rows, height):
            part = slice(start, min(start + height, rows))
            across_valid = _valid_columns(grid.invalid[part])
            size = (part.stop - start, across_valid.stop - across_valid.start)
            n_block = size[0] * size[1]
            if n_block == 0:
                continue
            invalid = grid.invalid[part, across_valid]
            r, bits = heights[:n_block].reshape(size), mask[:n_block].reshape(size)
            gaps = grid.weights is not None or bool(invalid.any())
            np.matmul(across[part], left[:, across_valid], out=r)
            np.subtract(grid.z[part, across_valid], r, out=r)
            if gaps:
                np.copyto(bits, invalid.view(np.int8) - np.int8(1))
                r_bits = r.view(np.int64)
                np.bitwise_and(r_bits, bits, out=r_bits)
            if (gaps and with_weights) or grid.weights is not None:
                np.bitwise_and(bits, _ONE, out=bits)
            w = bits.view(np.float64)
            if grid.weights is None:
                squares += float(np.vdot(r, r))
            else:
                np.multiply(w, grid.weights[part, across_valid], out=w)
                squares += float(np.vdot(r * w, r))
                r *= w
            if with_weights:
                these = right[across_valid]
                row_weights[part] = w @ these if gaps else these.sum(axis=0)
            np.matmul(r, low[across_valid], out=row_heights[part])
        sums = row_heights.T @ grid.py[:n].T
    if not np.isfinite(sums).all() or not np.isfinite(squares):
        raise InvalidSamplesError(
            "z is infinite somewhere, or too large to be squared; write NaN where nothing was "
            "measured"
        )
    return Sums(row_weights.T @ grid.py[:m].T, sums, squares)


def grid_values(
    c: FloatArray, px: FloatArray, py: FloatArray, *, minus_from: FloatArray | None = None
) -> FloatArray:
    """Return the polynomial at every pixel, or a map minus it."""
    n = c.shape[0]
    left, across = c.T @ px[:n], np.ascontiguousarray(py[:n].T)
    out = np.empty((py.shape[1], px.shape[1]))
    height = max(1, _BLOCK // max(out.shape[1], 1))
    for start in range(0, out.shape[0], height):
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
    """Return the inverse of a normal matrix and its condition, or refuse to."""
    diagonal = np.sqrt(np.maximum(np.diag(normal), 0.0))
    if diagonal[0] > 0.0 and (diagonal > 1e-12 * diagonal[0]).all():
        eigenvalues, vectors = np.linalg.eigh(normal / np.outer(diagonal, diagonal))
        if eigenvalues[0] > _SMALLEST_EIGENVALUE * eigenvalues[-1]:
            scaled = vectors / diagonal[:, None]
            inverse: FloatArray = (scaled / eigenvalues) @ scaled.T
            inverse.setflags(write=False)
            return inverse, float(eigenvalues[-1] / eigenvalues[0])
    raise DegenerateFitError(
        f"the valid pixels do not determine {what}: they lie on too few rows, columns or curves, "
        "or on too small a part of the domain; use fewer terms or measure more of the part"
    )
