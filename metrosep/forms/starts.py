"""Where a fit begins: vertex of the best quadric, or the shift at which the form matches best."""

from __future__ import annotations

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.forms.base import Form
from metrosep.forms.points import Points

__all__ = ["best_shift", "vertex"]


_MAX_LAGS = 512
"""Points per side of the map that is correlated."""


def vertex(x: FloatArray, y: FloatArray, z: FloatArray) -> tuple[float, float]:
    """Return where the least-squares quadric is level, or (0, 0) where that is far outside."""
    half = max(float(np.abs(x).max()), float(np.abs(y).max()), np.finfo(float).tiny)
    u, v = x / half, y / half
    columns = [np.ones_like(u), u, u * u]
    is_line = float(np.ptp(y)) == 0.0
    if not is_line:
        columns = [np.ones_like(u), u, v, u * u, u * v, v * v]
    if z.size < len(columns):
        return 0.0, 0.0
    c = np.linalg.lstsq(np.column_stack(columns), z - z.mean(), rcond=None)[0]
    hessian = (
        np.array([[2.0 * c[2]]]) if is_line else np.array([[2.0 * c[3], c[4]], [c[4], 2.0 * c[5]]])
    )
    slope = c[1:2] if is_line else c[1:3]
    if abs(np.linalg.det(hessian)) < 1e-12 * float(np.abs(hessian).max(initial=0.0)) ** len(slope):
        return 0.0, 0.0
    place = -np.linalg.solve(hessian, slope)
    if not np.isfinite(place).all() or float(np.abs(place).max()) > 1.0:
        return 0.0, 0.0
    return float(place[0] * half), 0.0 if is_line else float(place[1] * half)


def best_shift(form: Form, points: Points, *, free: tuple[bool, bool]) -> tuple[float, float]:
    """Return the shift of the form, in whole samples, that leaves the smallest sum of squares.

    Notes
    -----
    The sum of squares for every shift comes from three correlations by FFT; the piston is taken
    out for each. A large map is thinned to 512 points per side first.
    """
    z, x, y = _thinned(points)
    period_x, period_y = form.period or (None, None)
    lags_x = _lags(x, period=period_x, allowed=free[0])
    lags_y = _lags(y, period=period_y, allowed=free[1])
    step_x, step_y = _step(x), _step(y)
    wide_x = x[0] + step_x * np.arange(-lags_x, x.size + lags_x)
    wide_y = y[0] + step_y * np.arange(-lags_y, y.size + lags_y)
    h = form.height(*np.meshgrid(wide_x, wide_y))
    defined = ~np.isnan(h)
    h = np.where(defined, h - h[defined].mean(), 0.0) if defined.any() else np.zeros_like(h)
    valid = ~np.isnan(z)
    data = np.where(valid, z - z[valid].mean(), 0.0)
    mask = valid.astype(np.float64)
    n = np.maximum(_slide(mask, defined.astype(np.float64)), 1.0)
    zh, mh, mhh = _slide(data, h), _slide(mask, h), _slide(mask, h * h)
    zz, mz = _slide(data * data, defined * 1.0), _slide(data, defined * 1.0)
    squares = zz - 2.0 * zh + mhh - (mz - mh) ** 2 / n
    mean = np.where(n > 0.25 * mask.sum(), squares / n, np.inf)
    row, column = np.unravel_index(int(np.argmin(mean)), mean.shape)
    return float((lags_x - column) * step_x), float((lags_y - row) * step_y)


def _step(axis: FloatArray) -> float:
    return float((axis[-1] - axis[0]) / (axis.size - 1)) if axis.size > 1 else 0.0


def _lags(axis: FloatArray, *, period: float | None, allowed: bool) -> int:
    if not allowed or axis.size < 2:
        return 0
    half = axis.size // 2
    return half if period is None else min(half, int(np.ceil(0.5 * period / _step(axis))))


def _thinned(points: Points) -> tuple[FloatArray, FloatArray, FloatArray]:
    limit = _MAX_LAGS if points.y.size > 1 else _MAX_LAGS**2
    step_x, step_y = (max(1, -(-axis.size // limit)) for axis in (points.x, points.y))
    return points.z[::step_y, ::step_x], points.x[::step_x], points.y[::step_y]


def _slide(small: FloatArray, large: FloatArray) -> FloatArray:
    """Return the sums of `small` times `large` at every place where it fits into it."""
    shape = large.shape
    spectrum = np.conj(np.fft.rfft2(small, shape)) * np.fft.rfft2(large)
    full = np.fft.irfft2(spectrum, shape)
    rows, columns = (big - little + 1 for big, little in zip(shape, small.shape, strict=True))
    return np.asarray(full[:rows, :columns])
