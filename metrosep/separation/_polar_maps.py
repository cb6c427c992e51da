"""Rotations by any angles: maps on circles, one least-squares system for each angular order."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from metrosep.core._arrays import ComplexArray, FloatArray
from metrosep.core.errors import DataError
from metrosep.separation._map_input import MapGrid
from metrosep.separation._map_orders import solve_order
from metrosep.separation.map_turning import interpolated


def polar_grid(grid: MapGrid) -> tuple[FloatArray, int]:
    """Return radii at the pitch of the pixels and a number of angles that is as dense at the rim."""
    from scipy.fft import next_fast_len

    step = min(grid.dx, grid.dy)
    largest = math.hypot(np.abs(grid.x).max(), np.abs(grid.y).max())
    radii = np.asarray((np.arange(math.ceil(largest / step)) + 0.5) * step, dtype=np.float64)
    return radii, 2 * int(next_fast_len(math.ceil(1.3 * math.pi * radii[-1] / step)))


def to_polar(stack: FloatArray, grid: MapGrid) -> FloatArray:
    """Return maps over (radius, angle)."""
    radii, n = polar_grid(grid)
    angle = 2.0 * np.pi * np.arange(n) / n
    columns = (radii[:, None] * np.cos(angle) + grid.centre[0]) / grid.dx
    rows = (radii[:, None] * np.sin(angle) + grid.centre[1]) / grid.dy
    found, _ = interpolated(stack, rows.ravel(), columns.ravel())
    return found.reshape(stack.shape[0], radii.size, n)


def from_polar(polar: FloatArray, grid: MapGrid) -> FloatArray:
    """Return maps over rows and columns from those over (radius, angle)."""
    n = polar.shape[2]
    inner = np.roll(polar[:, :3][:, ::-1], n // 2, axis=2)  # through the centre to the other side
    whole = np.concatenate([inner, polar], axis=1)
    whole = np.concatenate([whole[:, :, -3:], whole, whole[:, :, :4]], axis=2)
    step = min(grid.dx, grid.dy)
    radius = np.hypot(grid.x, grid.y[:, None]) / step - 0.5 + 3.0
    angle = np.mod(np.arctan2(grid.y[:, None], grid.x), 2.0 * np.pi) * n / (2.0 * np.pi) + 3.0
    found, _ = interpolated(whole, radius.ravel(), angle.ravel())
    return found.reshape(polar.shape[0], *grid.shape)


def solve_polar(
    stack: FloatArray, angles: FloatArray, grid: MapGrid, largest_gain: float
) -> tuple[FloatArray, tuple[int, ...]]:
    """Return instrument, part and the sum that is not separable, order by order."""
    polar = to_polar(stack, grid)
    whole = np.isfinite(polar).all(axis=(0, 2))
    if whole.sum() < 6:
        raise DataError(
            "no six circles about the centre were measured completely in all maps, which angles "
            "that are not multiples of one step need: state centre=, or use equal steps"
        )
    n = polar.shape[2]
    weights, hidden = order_weights(tuple(np.asarray(angles).tolist()), n // 2, largest_gain)
    out = np.full((3, whole.size, n), np.nan)
    out[:, whole] = _parts_on_circles(polar[None, :, whole], weights)[0]
    return from_polar(out, grid), hidden


def noise_on_circles(
    trials: FloatArray, angles: FloatArray, grid: MapGrid, largest_gain: float
) -> FloatArray:
    """Return the parts of many sets of readings without gaps."""
    t, s = trials.shape[:2]
    polar = to_polar(trials.reshape(t * s, *grid.shape), grid)
    n = polar.shape[2]
    weights, _ = order_weights(tuple(np.asarray(angles).tolist()), n // 2, largest_gain)
    whole = np.isfinite(polar).all(axis=(0, 2))
    out = np.full((t, 3, whole.size, n), np.nan)
    out[:, :, whole] = _parts_on_circles(polar[:, whole].reshape(t, s, -1, n), weights)
    return from_polar(out.reshape(t * 3, -1, n), grid).reshape(t, 3, *grid.shape)


def _parts_on_circles(circles: FloatArray, weights: ComplexArray) -> FloatArray:
    """Return the three parts of circles, shape (T, S, n_r, n_angles)."""
    series = np.fft.rfft(circles, axis=3)
    found = np.einsum("mps,tsrm->tprm", weights, series, optimize=True)
    return np.asarray(np.fft.irfft(found, n=circles.shape[3], axis=3))


@lru_cache(maxsize=16)
def order_weights(
    angles: tuple[float, ...], highest: int, largest_gain: float
) -> tuple[ComplexArray, tuple[int, ...]]:
    """Return what each reading counts in instrument, part and inseparable sum, order by order."""
    weights = np.zeros((highest + 1, 3, len(angles)), dtype=np.complex128)
    hidden = []
    for m in range(highest + 1):
        turn = np.exp(-1j * m * np.array(angles))
        solved = solve_order(np.stack([np.ones_like(turn), turn], axis=1))
        if solved.seen.all() and solved.gain.max() <= largest_gain:
            weights[m, :2] = solved.weights
        else:
            weights[m, 2] = 1.0 / len(angles)
            hidden.append(m)
    weights.setflags(write=False)
    return weights, tuple(hidden)
