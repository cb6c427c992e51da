"""Doubts about maps that a separation can raise itself: mirrored maps, angles of the other sign."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.separation._map_input import MapGrid
from metrosep.separation._map_orders import coarse, mirror
from metrosep.separation._rotation_solution import RotationSolver

_COARSE = 64
_BETTER = 0.5
_ROUND_OFF = 1e-6
_RIM = 9.0
_MUCH = 0.02


def doubts_of_rotations(
    stack: FloatArray, angles: FloatArray, grid: MapGrid, largest_gain: float
) -> tuple[str, ...]:
    """Return what would explain the readings much better: other signs, a mirrored map."""
    small, small_grid = coarse(stack, grid, _COARSE)
    solver = RotationSolver(angles, largest_gain)
    if solver.n is None:
        return ()
    as_given = _left(solver, small, small_grid)
    size = math.sqrt(float(np.nanmean(small**2)))
    if not as_given > _ROUND_OFF * size:
        return ()
    other = _left(RotationSolver(-angles, largest_gain), small, small_grid)
    if other < _BETTER * as_given:
        text = (
            "the readings fit angles of the opposite sign much better "
            f"({other * 1e9:.3g} nm left instead of {as_given * 1e9:.3g} nm): angles count "
            "counter-clockwise from +x (columns) towards +y (rows); check rows and sign"
        )
        return (text,)
    found = []
    for i in range(stack.shape[0]):
        for axis in ("x", "y"):
            flipped = small.copy()
            flipped[i] = mirror(small[i], axis)
            left = _left(solver, flipped, small_grid)
            if left < _BETTER * as_given:
                found.append((left, i, axis))
    if not found:
        return ()
    left, i, axis = min(found)
    text = (
        f"map {i + 1} looks mirrored: with {axis} reversed the readings fit much better "
        f"({left * 1e9:.3g} nm left instead of {as_given * 1e9:.3g} nm)"
    )
    return (text,)


def lost_pixels(stack: FloatArray, part: FloatArray) -> tuple[str, ...]:
    """Say that gaps cost much more than themselves: their turned counterparts, or whole circles."""
    from scipy import ndimage

    common: NDArray[np.bool_] = np.logical_and.reduce(np.isfinite(stack), axis=0)
    field = np.pad(ndimage.binary_fill_holes(common), 1)
    inner = ndimage.distance_transform_edt(field)[1:-1, 1:-1] > _RIM
    lost = int((inner & common & ~np.isfinite(part)).sum())
    if lost <= _MUCH * inner.sum():
        return ()
    text = (
        f"{lost} pixels that all maps have measured, away from the rim, have no result: a gap or a corner costs its "
        "turned counterparts, and its whole circle where the angles are no multiples of one step"
    )
    return (text,)


def _left(solver: RotationSolver, stack: FloatArray, grid: MapGrid) -> float:
    if not np.isfinite(solver.parts(stack, grid)).all(axis=0).any():
        return math.nan
    residual = solver.solve(stack, grid).residual
    known = residual[np.isfinite(residual)]
    return math.sqrt(float(np.mean(known**2))) if known.size else math.nan
