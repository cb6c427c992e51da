"""Rules that integrate slopes, all linear, and what they make of white noise."""

from __future__ import annotations

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.separation._readings import line_basis

LONG = 1500
"""More slopes than this have the uncertainty of trapezoids: the rules differ by 1/n of it on
equal steps, by some percent on uneven ones."""

_BLOCK = 256
"""Unit slopes that are integrated at a time for the uncertainty."""


def heights_at(x: FloatArray, method: str) -> FloatArray:
    """Return where the heights are: at the slopes, for feet also under the last front foot."""
    if method != "feet":
        return x
    return np.asarray(np.append(x, x[-1] + (x[-1] - x[0]) / (x.size - 1)))


def integral(s: FloatArray, x: FloatArray, method: str) -> FloatArray:
    """Return heights of slopes, shape (k, n), the first one 0."""
    zero = np.zeros((s.shape[0], 1))
    if method == "feet":
        step = (x[-1] - x[0]) / (x.size - 1)
        return np.concatenate([zero, step * np.cumsum(s, axis=1)], axis=1)
    if method == "fourier":
        return _cosine_integral(s, x)
    if method == "simpson":
        from scipy.integrate import cumulative_simpson

        return np.asarray(cumulative_simpson(s, x=x, axis=1, initial=0.0))
    if method == "spline":
        from scipy.interpolate import make_interp_spline

        centre, scale = x[0], x[-1] - x[0]
        spline = make_interp_spline((x - centre) / scale, s.T, k=3).antiderivative()
        return np.asarray(spline((x - centre) / scale).T * scale)
    steps = 0.5 * (s[:, 1:] + s[:, :-1]) * np.diff(x)
    return np.concatenate([zero, np.cumsum(steps, axis=1)], axis=1)


def _cosine_integral(s: FloatArray, x: FloatArray) -> FloatArray:
    """Integrate a cubic exactly and what is left as a cosine series over the record."""
    from scipy.fft import dct, dst

    n = x.size
    t = np.linspace(-1.0, 1.0, n)
    half = (x[-1] - x[0]) / 2.0
    basis = np.polynomial.legendre.legvander(t, 3)
    found = np.linalg.lstsq(basis, s.T, rcond=None)[0]
    smooth = np.polynomial.legendre.legint(found, lbnd=-1.0)
    out = np.polynomial.legendre.legval(t, smooth) * half
    a = dct(s - (basis @ found).T, type=1, axis=1) / (n - 1)
    waves = np.zeros_like(out)
    k = np.arange(1, n - 1)
    waves[:, 1:-1] = dst(a[:, 1:-1] * (2.0 * half / (np.pi * k)), type=1, axis=1) / 2.0
    return np.asarray(out + waves + 0.5 * a[:, :1] * half * (t + 1.0))


def levelled(height: FloatArray, grid: FloatArray, degree: int) -> FloatArray:
    basis = line_basis(grid)[:, : degree + 1]
    q = np.linalg.qr(basis)[0]
    return np.asarray(height - (height @ q) @ q.T)


def unit_uncertainty(x: FloatArray, method: str, grid: FloatArray, degree: int) -> FloatArray:
    """Return the uncertainty of heights for unit white noise.

    Sums and trapezoids in closed form; the other rules by trying every slope alone, and as
    trapezoids, from which they differ at the ends only, where the record is long.
    """
    if method in ("feet", "trapezoid") or x.size > LONG:
        return _walk_uncertainty(x, method, grid, degree)
    n = x.size
    total = np.zeros(grid.size)
    for start in range(0, n, _BLOCK):
        rows = np.eye(min(_BLOCK, n - start), n, k=start)
        total += (levelled(integral(rows, x, method), grid, degree) ** 2).sum(axis=0)
    return np.sqrt(total)


def _walk_uncertainty(x: FloatArray, method: str, grid: FloatArray, degree: int) -> FloatArray:
    """Return the root of the diagonal of P T T' P: T sums, P removes the line."""
    rule = "feet" if method == "feet" else "trapezoid"
    n, step = x.size, np.diff(grid)
    weight = step if rule == "feet" else np.concatenate([[0.0], step]) / 2.0
    if rule == "feet":
        own = np.concatenate([[0.0], np.cumsum(weight**2)])
    else:
        inner = weight + np.append(weight[1:], 0.0)
        own = np.concatenate([[0.0], np.cumsum(inner**2)[:-1]]) + weight**2
        own[0] = 0.0
    q = np.linalg.qr(line_basis(grid)[:, : degree + 1])[0]
    above = np.cumsum(q[::-1], axis=0)[::-1][1:] * step[:, None]
    if rule == "feet":
        back = above
    else:
        back = np.zeros((n, q.shape[1]))
        back[:-1] += above / 2.0
        back[1:] += above / 2.0
    spread = integral(back.T, x, rule).T
    core = q.T @ spread
    variance = own - 2.0 * np.sum(spread * q, axis=1) + np.sum((q @ core) * q, axis=1)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))
