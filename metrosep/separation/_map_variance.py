"""Variance, pixel by pixel, of sums of turned and mirrored maps with white noise.

A turned map is interpolated: its value is a sum of 6 x 6 pixels. Near the axis the same reading,
turned by two angles, takes the same pixels twice, and on the lines that a mirror keeps, the reading
and its mirror image do: their noise adds with its sign there and not as squares. The overlap of two
such sums is a product of one along x and one along y.
"""

from __future__ import annotations

import math

import numpy as np

from metrosep.core._arrays import FloatArray, IntArray
from metrosep.separation._map_input import MapGrid
from metrosep.separation._map_orders import mirror
from metrosep.separation.map_turning import lagrange_weights, quarters_by_index

_REACH = 6.0
_USED = 1e-14
_DEGREE = 5


class TurnedNoise:
    """Overlaps of the turned and mirrored copies of one white map."""

    def __init__(self, grid: MapGrid, n: int, flip: str = "x", offset: float = 0.0) -> None:
        self.grid, self.n, self.flip = grid, n, flip
        self.angles = offset + 2.0 * np.pi * np.arange(n) / n
        # turned by 90 deg more, both copies take the same pixels of a square map turned back
        self.orbit = 4 if n % 4 == 0 and quarters_by_index(grid) else 1
        x, y = np.broadcast_arrays(grid.x, grid.y[:, None])
        self.x, self.y = x.ravel(), y.ravel()
        self.radius = np.hypot(self.x, self.y)
        self.reach = _REACH * math.hypot(grid.dx, grid.dy)

    def variance(self, direct: FloatArray, mirrored: FloatArray | None = None) -> FloatArray:
        """Return the variance of sums of copies for readings with noise of variance 1."""
        shape = (direct.shape[0], *self.grid.shape)
        total = self._one_kind(direct).reshape(shape)
        if mirrored is not None:
            total = total + mirror(self._one_kind(mirrored).reshape(shape), self.flip)
            total = total + 2.0 * self._both_kinds(direct, mirrored).reshape(shape)
        return np.asarray(np.maximum(total, 0.0))

    def _one_kind(self, weights: FloatArray) -> FloatArray:
        products = np.einsum("psk,psl->pkl", weights, weights)
        out = np.zeros((weights.shape[0], self.x.size))
        for k, other, product in self._orbits(products):
            if k == other:
                out += np.outer(product, self._own(k))
            else:
                turn = abs(math.sin((self.angles[k] - self.angles[other]) / 2.0))
                near = np.flatnonzero(self.radius < self.reach / (2.0 * turn))
                self._add(out, near, product, self._at(k, near), self._at(other, near))
        return out

    def _both_kinds(self, direct: FloatArray, mirrored: FloatArray) -> FloatArray:
        products = np.einsum("psk,psl->pkl", direct, mirrored)
        out = np.zeros((direct.shape[0], self.x.size))
        strips: dict[int, IntArray] = {}
        for k, other, product in self._orbits(products):
            apart = (k - other) % self.n
            if apart not in strips:
                strips[apart] = self._strip(k, other)
            near = strips[apart]
            self._add(out, near, product, self._at(k, near), self._at(other, near, mirror=True))
        return out

    def _orbits(self, products: FloatArray) -> list[tuple[int, int, FloatArray]]:
        """Return pairs of copies with other overlaps, and what they count in each sum."""
        step = self.n // self.orbit
        out = []
        for k in range(step):
            for other in range(self.n):
                j = step * np.arange(self.orbit)
                product = products[:, (k + j) % self.n, (other + j) % self.n].sum(axis=1)
                if np.abs(product).max() > _USED:
                    out.append((k, other, product))
        return out

    def _strip(self, k: int, other: int) -> IntArray:
        """Return the pixels along the line that the two copies take from the same place."""
        half = (self.angles[k] - self.angles[other]) / 2.0
        line = half + (np.pi / 2.0 if self.flip == "x" else 0.0)
        away = np.abs(self.y * math.cos(line) - self.x * math.sin(line))
        return np.flatnonzero(away < self.reach / 2.0)

    def _at(
        self, k: int, chosen: IntArray | slice, *, mirror: bool = False
    ) -> tuple[FloatArray, FloatArray]:
        """Return the columns and rows that a copy takes its values from."""
        x, y = self.x[chosen], self.y[chosen]
        if mirror:
            x, y = (-x, y) if self.flip == "x" else (x, -y)
        c, s = math.cos(self.angles[k]), math.sin(self.angles[k])
        columns = (c * x + s * y + self.grid.centre[0]) / self.grid.dx
        rows = (-s * x + c * y + self.grid.centre[1]) / self.grid.dy
        return _whole_where_close(columns), _whole_where_close(rows)

    def _own(self, k: int) -> FloatArray:
        columns, rows = self._at(k, slice(None))
        return _sum_of_squares(columns) * _sum_of_squares(rows)

    @staticmethod
    def _add(
        out: FloatArray,
        near: IntArray,
        product: FloatArray,
        first: tuple[FloatArray, FloatArray],
        second: tuple[FloatArray, FloatArray],
    ) -> None:
        close = (np.abs(first[0] - second[0]) < _REACH) & (np.abs(first[1] - second[1]) < _REACH)
        if not close.any():
            return
        value = overlap(first[0][close], second[0][close])
        value *= overlap(first[1][close], second[1][close])
        out[:, near[close]] += np.outer(product, value)


def overlap(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the sum of the products of the interpolation weights of two positions on a line."""
    whole_a, whole_b = np.floor(a), np.floor(b)
    apart = (whole_b - whole_a).astype(np.intp)
    wa, wb = lagrange_weights(a), lagrange_weights(b)
    out = np.zeros(a.size)
    for d in range(-5, 6):
        here = np.flatnonzero(apart == d)
        if here.size:
            mine, other = slice(max(0, d), 6 + min(0, d)), slice(max(0, -d), 6 + min(0, -d))
            out[here] = np.einsum("ij,ij->j", wa[mine][:, here], wb[other][:, here])
    return out


def _whole_where_close(position: FloatArray) -> FloatArray:
    nearest = np.round(position)
    return np.where(np.abs(position - nearest) < 1e-9, nearest, position)


def _sum_of_squares(position: FloatArray) -> FloatArray:
    """Return `overlap` of positions with themselves: a polynomial in (t - 1/2)**2."""
    t = position - np.floor(position)
    return np.asarray(np.polynomial.polynomial.polyval((t - 0.5) ** 2, _SQUARES))


def _square_polynomial() -> FloatArray:
    t = (1.0 - np.cos(np.pi * np.arange(_DEGREE + 1) / _DEGREE)) / 4.0
    values = (lagrange_weights(t) ** 2).sum(axis=0)
    found: FloatArray = np.linalg.solve(np.vander((t - 0.5) ** 2, increasing=True), values)
    return found


_SQUARES = _square_polynomial()
