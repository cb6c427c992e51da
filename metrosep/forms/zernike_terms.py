"""Values and gradients of Zernike circle polynomials, by recurrences in Cartesian coordinates.

With ``w = x + i y`` on the unit disc and ``V_n^m = R_n^|m|(|w|) e^(i m theta)``::

    V_n^m       = w V_{n-1}^{m-1} + conj(w) V_{n-1}^{m+1} - V_{n-2}^m
    dV_n^m/dw   = n V_{n-1}^{m-1} + dV_{n-2}^m/dw
    dV_n^m/dw*  = n V_{n-1}^{m+1} + dV_{n-2}^m/dw*

There is no division by the radius, so values and slopes are finite at the centre, and no factorial,
so they are exact to rounding at order 100. References: Shakibaei & Paramesran, Opt. Lett. 38 (2013)
2487; Andersen, Opt. Express 26 (2018) 18878.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from metrosep.core._arrays import ComplexArray, FloatArray

__all__ = ["zernike_gradients", "zernike_values"]


class _Table:
    """V and its derivatives at points, each computed once; m >= 0 is kept, the rest is conjugate."""

    def __init__(self, x: FloatArray, y: FloatArray) -> None:
        self.w: ComplexArray = x + 1j * y
        self.kept: dict[tuple[int, int], ComplexArray] = {(0, 0): np.ones_like(self.w)}
        self.slopes: dict[tuple[int, int], tuple[Any, Any]] = {}

    def value(self, n: int, m: int) -> Any:
        if abs(m) > n or n < 0:
            return 0.0
        if m < 0:
            return np.conj(self.value(n, -m))
        if (n, m) not in self.kept:
            if m == 0:
                inner = 2.0 * (np.conj(self.w) * self.value(n - 1, 1)).real + 0j
            else:
                inner = self.w * self.value(n - 1, m - 1)
                if m < n:
                    inner += np.conj(self.w) * self.value(n - 1, m + 1)
            self.kept[n, m] = inner - self.value(n - 2, m)
        return self.kept[n, m]

    def slope(self, n: int, m: int) -> tuple[Any, Any]:
        """Return the derivatives by w and by its conjugate, m >= 0."""
        if m > n or n <= 0:
            return 0.0, 0.0
        if (n, m) not in self.slopes:
            by_w, by_conjugate = self.slope(n - 2, m)
            self.slopes[n, m] = (
                n * self.value(n - 1, m - 1) + by_w,
                n * self.value(n - 1, m + 1) + by_conjugate,
            )
        return self.slopes[n, m]


def zernike_values(x: FloatArray, y: FloatArray, nm: Sequence[tuple[int, int]]) -> FloatArray:
    """Return Zernike polynomials that are 1 at the rim of the unit disc."""
    table = _Table(x, y)
    _climb(table, nm)
    out = np.empty((len(nm), *x.shape))
    for k, (n, m) in enumerate(nm):
        v = table.value(n, abs(m))
        out[k] = v.real if m >= 0 else v.imag
    return out


def zernike_gradients(
    x: FloatArray, y: FloatArray, nm: Sequence[tuple[int, int]]
) -> tuple[FloatArray, FloatArray]:
    """Return the derivatives of `zernike_values` by x and by y."""
    table = _Table(x, y)
    _climb(table, nm)
    dx, dy = np.empty((len(nm), *x.shape)), np.empty((len(nm), *x.shape))
    for k, (n, m) in enumerate(nm):
        by_w, by_conjugate = table.slope(n, abs(m))
        along = by_w + by_conjugate
        across = 1j * (by_w - by_conjugate)
        dx[k] = np.real(along) if m >= 0 else np.imag(along)
        dy[k] = np.real(across) if m >= 0 else np.imag(across)
    return dx, dy


def _climb(table: _Table, nm: Sequence[tuple[int, int]]) -> None:
    """Fill the table from low orders up, so that no call goes deeper than one order."""
    top = {(n, abs(m)) for n, m in nm}
    needed = set(top)
    while top:
        top = {
            (a, b)
            for n, m in top
            for a, b in ((n - 1, abs(m - 1)), (n - 1, m + 1), (n - 2, m))
            if 0 <= b <= a
        } - needed
        needed |= top
    for n, m in sorted(needed):
        table.value(n, m)
