"""Private helpers: a Legendre series on one domain as a series of another kind on another domain.

In powers of x the coefficients of degree ten are differences of numbers that are many decades
larger. The conversion is therefore done in fractions of whole numbers (low degrees: in extended
precision from exact matrices), and rounded once at the end.
"""

from __future__ import annotations

from fractions import Fraction
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.forms._orthogonal import Basis

__all__ = ["conversion_matrix", "converted"]

Row = list[Fraction]

_LOW = 6
"""Up to this degree extended precision (64 bits) loses nothing that a float64 could hold."""


@lru_cache(maxsize=64)
def _exact(
    degree: int, basis: Basis, centre: float, half_width: float, to_centre: float, to_half: float
) -> tuple[tuple[Fraction, ...], ...]:
    """Return row k: P_k((x - centre) / half_width) in the functions of (x - to_centre) / to_half."""
    scale = Fraction(to_half) / Fraction(half_width)
    shift = (Fraction(to_centre) - Fraction(centre)) / Fraction(half_width)
    rows: list[Row] = [[Fraction(1)]]
    for k in range(degree):
        # (k + 1) P_{k+1} = (2 k + 1) s P_k - k P_{k-1}, s = scale u + shift
        stepped = _times_u(rows[k], basis)
        row = [Fraction(2 * k + 1, k + 1) * scale * value for value in stepped]
        for i, value in enumerate(rows[k]):
            row[i] += Fraction(2 * k + 1, k + 1) * shift * value
        if k:
            for i, value in enumerate(rows[k - 1]):
                row[i] -= Fraction(k, k + 1) * value
        rows.append(row)
    return tuple(tuple(row + [Fraction(0)] * (degree + 1 - len(row))) for row in rows)


@lru_cache(maxsize=64)
def _extended(
    degree: int, basis: Basis, centre: float, half_width: float, to_centre: float, to_half: float
) -> NDArray[np.longdouble]:
    """Return the rows of `_exact` in extended precision."""
    rows = _exact(degree, basis, centre, half_width, to_centre, to_half)
    high = np.array([[float(v) for v in row] for row in rows])
    rest = [
        [float(v - Fraction(h)) for v, h in zip(*p, strict=True)]
        for p in zip(rows, high.tolist(), strict=True)
    ]
    out: NDArray[np.longdouble] = high.astype(np.longdouble) + np.array(rest)
    return out


def _times_u(row: Row, basis: Basis) -> Row:
    """Return the coefficients of u times a series."""
    out = [Fraction(0)] * (len(row) + 1)
    for i, value in enumerate(row):
        if basis == "power" or (basis == "chebyshev" and i == 0):
            out[i + 1] += value
        elif basis == "chebyshev":
            out[i + 1] += value / 2
            out[i - 1] += value / 2
        else:
            out[i + 1] += value * Fraction(i + 1, 2 * i + 1)
            if i:
                out[i - 1] += value * Fraction(i, 2 * i + 1)
    return out


def conversion_matrix(
    degree: int, basis: Basis, source: tuple[float, float], target: tuple[float, float]
) -> FloatArray:
    """Return A with ``new = A @ old`` in double precision; domains are (centre, half width)."""
    return np.array(_exact(degree, basis, *source, *target), dtype=np.float64).T


def converted(
    c: NDArray[Any],
    basis: Basis,
    source: list[tuple[float, float]],
    target: list[tuple[float, float]],
) -> FloatArray:
    """Return the coefficients of a Legendre series along each of its axes, rounded once.

    The coefficients may be of extended precision.
    """
    if basis == "legendre" and source == target:
        return np.asarray(c, dtype=np.float64)
    if max(c.shape) <= _LOW + 1:
        extended = np.asarray(c, dtype=np.longdouble)
        for axis, (old, new) in enumerate(zip(source, target, strict=True)):
            rows = _extended(c.shape[axis] - 1, basis, *old, *new)
            extended = np.moveaxis(np.tensordot(rows, extended, axes=([0], [axis])), 0, axis)
        return np.asarray(extended, dtype=np.float64)
    ratios = [Fraction(*v.as_integer_ratio()) for v in c.ravel()]
    exact = np.array(ratios, dtype=object).reshape(c.shape)
    for axis, (old, new) in enumerate(zip(source, target, strict=True)):
        rows = np.array(_exact(c.shape[axis] - 1, basis, *old, *new), dtype=object)
        exact = np.moveaxis(np.tensordot(rows, exact, axes=([0], [axis])), 0, axis)
    return np.array([float(v) for v in exact.ravel()]).reshape(c.shape)
