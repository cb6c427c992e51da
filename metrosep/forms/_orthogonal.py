"""Private helpers: values and derivatives of Legendre, Chebyshev and power polynomials on [-1, 1].

All are rows of one array, ``out[k]`` being degree k, by three-term recurrences.
"""

from __future__ import annotations

from functools import cache, lru_cache
from typing import Literal

import numpy as np

from metrosep.core._arrays import FloatArray

_KEPT = 1 << 18
"""Values on an axis up to which they are kept."""

Basis = Literal["power", "legendre", "chebyshev"]


def _recurrence(basis: Basis, k: int) -> tuple[float, float]:
    """Return a, b of ``p[k+1] = a u p[k] - b p[k-1]``."""
    if basis == "legendre":
        return (2 * k + 1) / (k + 1), k / (k + 1)
    if basis == "chebyshev":
        return (2.0 if k else 1.0), 1.0
    return 1.0, 0.0


def values(u: FloatArray, degree: int, *, basis: Basis = "legendre") -> FloatArray:
    """Return degrees 0 to `degree` at u, shape (degree + 1, *u.shape), in the precision of u."""
    out = np.empty((degree + 1, *u.shape), dtype=u.dtype)
    out[0] = 1.0
    if degree:
        out[1] = u
    for k in range(1, degree):
        a, b = _recurrence(basis, k)
        np.multiply(u, out[k], out=out[k + 1])
        out[k + 1] *= a
        if b:
            out[k + 1] -= b * out[k - 1]
    return out


def values_on_axis(u: FloatArray, degree: int) -> FloatArray:
    """Return Legendre values on an axis, read-only: maps of a batch mostly have the same axes."""
    if u.size * (degree + 1) > _KEPT:
        return values(u, degree)
    return _kept_values(u.tobytes(), degree)


@lru_cache(maxsize=32)
def _kept_values(u: bytes, degree: int) -> FloatArray:
    out = values(np.frombuffer(u), degree)
    out.setflags(write=False)
    return out


def values_and_slopes(
    u: FloatArray, degree: int, *, basis: Basis = "legendre"
) -> tuple[FloatArray, FloatArray]:
    """Return degrees 0 to `degree` at u and their derivatives by u."""
    p = values(u, degree, basis=basis)
    d = np.zeros_like(p)
    if degree:
        d[1] = 1.0
    for k in range(1, degree):
        a, b = _recurrence(basis, k)
        d[k + 1] = a * (p[k] + u * d[k]) - b * d[k - 1]
    return p, d


@cache
def linearisation(degree: int) -> FloatArray:
    """Return c with ``P_i P_j = sum_k c[i, j, k] P_k`` for Legendre i, j up to `degree`.

    By Gauss-Legendre quadrature, which is exact for the triple product.
    """
    nodes, weights = np.polynomial.legendre.leggauss((4 * degree) // 2 + 1)
    p = values(nodes, 2 * degree)
    low = p[: degree + 1]
    scaled = p * weights * (np.arange(2 * degree + 1)[:, None] + 0.5)
    out: FloatArray = np.einsum("iq,jq,kq->ijk", low, low, scaled, optimize=True)
    i, j, k = np.ogrid[: degree + 1, : degree + 1, : 2 * degree + 1]
    out[((i + j + k) % 2 == 1) | (k > i + j) | (k < abs(i - j))] = 0.0
    out.setflags(write=False)
    return out
