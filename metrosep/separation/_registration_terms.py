"""Uncertainty of maps from registration: gradient times shift, through the same linear operation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.separation._map_input import MapGrid
from metrosep.separation._map_orders import RIGID, without_plane
from metrosep.separation.map_turning import turned

_SMOOTHING = 1.0
_REACH = 4


class _Linear(Protocol):
    def parts(self, stack: FloatArray, grid: MapGrid) -> FloatArray: ...


def map_gradient(
    z: FloatArray, grid: MapGrid, *, smoothing: float = _SMOOTHING
) -> tuple[FloatArray, FloatArray]:
    """Return the derivatives of a map by x and y: slopes of local planes over a few pixels."""
    valid = np.isfinite(z)
    if not valid.any():
        return np.full(z.shape, np.nan), np.full(z.shape, np.nan)
    mask = valid.astype(np.float64)
    filled = np.where(valid, z - np.mean(z[valid]), 0.0)
    m00, m10, m01 = (_moment(mask, i, j, smoothing) for i, j in ((0, 0), (1, 0), (0, 1)))
    m20, m11, m02 = (_moment(mask, i, j, smoothing) for i, j in ((2, 0), (1, 1), (0, 2)))
    z00, z10, z01 = (_moment(filled, i, j, smoothing) for i, j in ((0, 0), (1, 0), (0, 1)))
    with np.errstate(invalid="ignore", divide="ignore"):
        a, b, c = m20 - m10**2 / m00, m11 - m10 * m01 / m00, m02 - m01**2 / m00
        p, q = z10 - m10 * z00 / m00, z01 - m01 * z00 / m00
        determinant = a * c - b**2
        told = valid & (determinant > 1e-3 * smoothing**4 * m00**2)
        gx = np.where(told, (c * p - b * q) / determinant / grid.dx, 0.0)
        gy = np.where(told, (a * q - b * p) / determinant / grid.dy, 0.0)
    return np.where(valid, gx, np.nan), np.where(valid, gy, np.nan)


def _moment(values: FloatArray, power_x: int, power_y: int, smoothing: float) -> FloatArray:
    """Return Gaussian-weighted sums of values times powers of the distance in pixels."""
    from scipy import ndimage

    reach = math.ceil(_REACH * smoothing)
    t = np.arange(-reach, reach + 1.0)
    weight = np.exp(-0.5 * (t / smoothing) ** 2)
    out = ndimage.correlate1d(values, weight * t**power_x, axis=1, mode="constant")
    return np.asarray(
        ndimage.correlate1d(out, weight * t**power_y, axis=0, mode="constant"), dtype=np.float64
    )


def extended(field: FloatArray) -> FloatArray:
    """Return a map whose missing pixels have the value of the nearest one."""
    from scipy import ndimage

    missing = np.isnan(field)
    if not missing.any() or missing.all():
        return field
    nearest = ndimage.distance_transform_edt(missing, return_distances=False, return_indices=True)
    return np.asarray(field[tuple(nearest)])


def registration_share(
    solver: _Linear,
    part: FloatArray,
    angles: FloatArray,
    grid: MapGrid,
    u_shift: float,
    u_angle: float,
    *,
    unseparated: FloatArray | float = 0.0,
    removed: Sequence[str] = RIGID,
) -> FloatArray:
    """Return the standard uncertainty of each part from centring and angles."""
    total: FloatArray | None = None
    known = np.isfinite(part)
    for i, angle in enumerate(angles):
        moved = turned(part[None], float(angle), grid)[0][0] + unseparated
        gx, gy = (extended(g) for g in map_gradient(moved, grid))
        fields = [(gx, u_shift), (gy, u_shift), (grid.x * gy - grid.y[:, None] * gx, u_angle)]
        for field, u in fields:
            if u == 0.0:
                continue
            stack = np.zeros((angles.size, *grid.shape))
            stack[i] = field * u
            found = solver.parts(stack, grid)
            square = np.stack(
                [without_plane(z, grid, removed=removed, mask=known) ** 2 for z in found]
            )
            total = square if total is None else total + square
    if total is None:
        return np.zeros((1, *grid.shape))
    return np.sqrt(total)
