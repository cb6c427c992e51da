"""Columns of a stitching's design: polynomials as products of two axes, or any windows.

A polynomial of x and y, turned or not, is a short sum of products of Legendre polynomials along the
columns and along the rows of a window. Sums over its pixels then need one product of small matrices
with the window of weights, and no column is ever written out. Nothing is approximated by this.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.separation._stitch_grid import Layout, Placed

Box = tuple[slice, slice]
Make = Callable[[int, FloatArray, FloatArray], FloatArray]
"""Index of a sub-aperture, x and y in its instrument's frame -> (n_columns, ...)."""

WHOLE: Box = (slice(None), slice(None))


class Terms(Protocol):
    """The columns of each sub-aperture, by what is done with them."""

    def values(self, k: int, box: Box = WHOLE) -> FloatArray:
        """Return the columns in a part of a window, shape (n, rows, columns)."""

    def gram(self, i: int, in_i: Box, j: int, in_j: Box, weight: FloatArray) -> FloatArray:
        """Return ``sum of f_i weight f_j`` over a common part, shape (n_i, n_j)."""

    def project(self, k: int, window: FloatArray, box: Box = WHOLE) -> FloatArray:
        """Return ``sum of f_k window`` over a part, shape (n,)."""

    def combine(self, k: int, factors: FloatArray, box: Box = WHOLE) -> FloatArray:
        """Return ``factors @ f_k`` for factors of shape (m, n): shape (m, rows, columns)."""

    def quadratic(self, i: int, in_i: Box, j: int, in_j: Box, block: FloatArray) -> FloatArray:
        """Return ``f_i block f_j`` at each pixel of a common part."""


class WindowTerms:
    """Columns that are given as windows."""

    def __init__(self, make: Callable[[int, Box], FloatArray]) -> None:
        self.make = make

    def values(self, k: int, box: Box = WHOLE) -> FloatArray:
        """Return the columns in a part of a window."""
        return self.make(k, box)

    def gram(self, i: int, in_i: Box, j: int, in_j: Box, weight: FloatArray) -> FloatArray:
        """Return the weighted sums of products."""
        f_i = _flat(self.make(i, in_i))
        f_j = f_i if i == j and in_i == in_j else _flat(self.make(j, in_j))
        return np.asarray((f_i * weight.ravel()) @ f_j.T)

    def project(self, k: int, window: FloatArray, box: Box = WHOLE) -> FloatArray:
        """Return the sums of products with a window."""
        return np.asarray(_flat(self.make(k, box)) @ window.ravel())

    def combine(self, k: int, factors: FloatArray, box: Box = WHOLE) -> FloatArray:
        """Return sums of columns."""
        return np.asarray(np.tensordot(factors, self.make(k, box), axes=1))

    def quadratic(self, i: int, in_i: Box, j: int, in_j: Box, block: FloatArray) -> FloatArray:
        """Return a bilinear form at each pixel."""
        f_i, f_j = self.make(i, in_i), self.make(j, in_j)
        return np.asarray((np.tensordot(block.T, f_i, axes=1) * f_j).sum(axis=0))


@dataclass(frozen=True, slots=True)
class _Table:
    """One sub-aperture: columns ``f = sum of factor[f, b, a] along_y[b] along_x[a]``."""

    factor: FloatArray
    along_y: FloatArray
    along_x: FloatArray


class PolynomialTerms:
    """Columns that are polynomials of x and y."""

    def __init__(self, layout: Layout, make: Make, degree: int) -> None:
        self.layout, self.make, self.degree = layout, make, degree
        self._tables: dict[int, _Table] = {}

    def _table(self, k: int) -> _Table:
        if k not in self._tables:
            self._tables[k] = self._made(k, self.layout.placed[k])
        return self._tables[k]

    def _made(self, k: int, piece: Placed) -> _Table:
        n_y, n_x = piece.valid.shape
        nodes_y, along_y, from_y = _axis(n_y, self.degree)
        nodes_x, along_x, from_x = _axis(n_x, self.degree)
        x, y = (_affine(c, piece.valid.shape, nodes_x, nodes_y) for c in (piece.x, piece.y))
        values = self.make(k, x, y)
        return _Table(np.asarray(from_y @ values @ from_x.T), along_y, along_x)

    def values(self, k: int, box: Box = WHOLE) -> FloatArray:
        """Return the columns in a part of a window."""
        t = self._table(k)
        return np.asarray(t.along_y[:, box[0]].T @ t.factor @ t.along_x[:, box[1]])

    def gram(self, i: int, in_i: Box, j: int, in_j: Box, weight: FloatArray) -> FloatArray:
        """Return the weighted sums of products."""
        first, second = self._table(i), self._table(j)
        base_y, pair_y = _products(first.along_y[:, in_i[0]], second.along_y[:, in_j[0]])
        base_x, pair_x = _products(first.along_x[:, in_i[1]], second.along_x[:, in_j[1]])
        sums = (base_y.T @ weight) @ base_x
        moments = np.tensordot(pair_y @ sums, pair_x, axes=([2], [2]))  # b, d, a, c
        half = np.tensordot(first.factor, moments, axes=([1, 2], [0, 2]))
        return np.asarray(np.tensordot(half, second.factor, axes=([1, 2], [1, 2])))

    def project(self, k: int, window: FloatArray, box: Box = WHOLE) -> FloatArray:
        """Return the sums of products with a window."""
        t = self._table(k)
        sums = (t.along_y[:, box[0]] @ window) @ t.along_x[:, box[1]].T
        return np.asarray(np.tensordot(t.factor, sums, axes=2))

    def combine(self, k: int, factors: FloatArray, box: Box = WHOLE) -> FloatArray:
        """Return sums of columns."""
        t = self._table(k)
        inner = np.tensordot(factors, t.factor, axes=1)
        return np.asarray(t.along_y[:, box[0]].T @ (inner @ t.along_x[:, box[1]]))

    def quadratic(self, i: int, in_i: Box, j: int, in_j: Box, block: FloatArray) -> FloatArray:
        """Return a bilinear form at each pixel."""
        first, second = self._table(i), self._table(j)
        base_y, pair_y = _products(first.along_y[:, in_i[0]], second.along_y[:, in_j[0]])
        base_x, pair_x = _products(first.along_x[:, in_i[1]], second.along_x[:, in_j[1]])
        form = np.tensordot(
            np.tensordot(first.factor, block, axes=([0], [0])), second.factor, axes=1
        )  # b, a, d, c
        inner = np.tensordot(form, pair_y, axes=([0, 2], [0, 1]))  # a, c, r
        inner = np.tensordot(inner, pair_x, axes=([0, 1], [0, 1]))  # r, q
        return np.asarray((base_y @ inner) @ base_x.T)


def n_of(terms: Terms) -> int:
    """Return how many columns each sub-aperture has."""
    return int(terms.values(0, (slice(0, 1), slice(0, 1))).shape[0])


def _axis(n: int, degree: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return nodes, Legendre polynomials at the pixels, and what turns node values to factors."""
    from numpy.polynomial.legendre import leggauss, legvander

    pixels = np.linspace(-1.0, 1.0, n) if n > 1 else np.zeros(1)
    top = min(degree, n - 1)
    nodes = pixels if n <= degree + 1 else leggauss(degree + 1)[0]
    from_nodes = np.asarray(np.linalg.inv(legvander(nodes, top)), dtype=np.float64)
    along = np.asarray(legvander(pixels, top).T, dtype=np.float64)
    return np.asarray(nodes, dtype=np.float64), along, from_nodes


def _affine(
    c: FloatArray, shape: tuple[int, ...], nodes_x: FloatArray, nodes_y: FloatArray
) -> FloatArray:
    """Return a coordinate, linear over a window, at nodes of -1 ... 1 along both sides."""
    full = np.broadcast_to(c, shape)
    along_x, along_y = (full[0, -1] - full[0, 0]) / 2.0, (full[-1, 0] - full[0, 0]) / 2.0
    middle = full[0, 0] + along_x + along_y
    return np.asarray(middle + along_x * nodes_x + along_y * nodes_y[:, None])


def _products(first: FloatArray, second: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return an orthonormal basis of all products of two axes' polynomials, and their factors."""
    base = _orthonormal(first.shape[1], first.shape[0] + second.shape[0] - 2)
    return base, np.asarray((first[:, None, :] * second) @ base)


@lru_cache(maxsize=256)
def _orthonormal(n: int, degree: int) -> FloatArray:
    from numpy.polynomial.legendre import legvander

    pixels = np.linspace(-1.0, 1.0, n) if n > 1 else np.zeros(1)
    base = np.asarray(np.linalg.qr(legvander(pixels, min(degree, n - 1)))[0], dtype=np.float64)
    base.setflags(write=False)
    return base


def _flat(values: FloatArray) -> FloatArray:
    return values.reshape(values.shape[0], -1)
