"""Whether what a model leaves of maps is noise, and whether maps are in the units they should be."""

from __future__ import annotations

import math

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.separation._map_input import MapGrid

_SMOOTHER = 1.2
_NEGLIGIBLE = 1e-3
_HIGHEST = 1e-3
_COARSEST = 0.1


def smoothness(residual: FloatArray) -> float:
    """Return the RMS of maps over that of the steps between neighbours, 1 for white noise."""
    steps = np.concatenate([np.diff(residual, axis=k).ravel() for k in (1, 2)])
    steps, known = steps[np.isfinite(steps)], residual[np.isfinite(residual)]
    if steps.size == 0 or not known.any():
        return 1.0
    rough = math.sqrt(float(np.mean(steps**2)) / 2.0)
    return math.sqrt(float(np.mean(known**2))) / rough if rough > 0.0 else math.inf


def residual_doubts(
    residual: FloatArray, readings: FloatArray, *, expected: float = 1.0
) -> tuple[str, ...]:
    """Say that the residual is no noise: neighbours resemble each other more than noise would."""
    known = residual[np.isfinite(residual)]
    read = readings[np.isfinite(readings)]
    if known.size < 200 or read.size == 0:
        return ()
    left = math.sqrt(float(np.mean(known**2)))
    size = math.sqrt(float(np.mean(read**2)))
    found = smoothness(residual)
    if left <= _NEGLIGIBLE * size or found <= (_SMOOTHER + 3.0 / math.sqrt(known.size)) * expected:
        return ()
    text = (
        f"the residuals are not noise: {left * 1e9:.3g} nm RMS are left and neighbouring pixels "
        "resemble each other; check the set-up (angles, order and sign of the maps, which part was "
        "turned, centring). u takes them as noise of single pixels and does not cover such errors"
    )
    return (text,)


def unit_doubts(
    stack: FloatArray, grid: MapGrid, angles: FloatArray | None = None
) -> tuple[str, ...]:
    """Say that heights, steps or angles look as if they were in other units."""
    found = []
    span = float(np.nanmax(stack) - np.nanmin(stack))
    if span > _HIGHEST:
        found.append(
            f"the heights span {span:.3g} m, more than 1 mm; heights are in m: are these nm or um?"
        )
    step = max(grid.dx, grid.dy)
    if grid.calibrated and step > _COARSEST:
        found.append(f"the lateral step is {step:.3g} m; steps are in m: is this mm or um?")
    if angles is not None and angles.size:
        most = float(np.abs(angles).max())
        if most > 2.0 * math.pi + 1e-9:
            found.append(
                f"an angle is {most:.6g} rad, more than a turn ({math.degrees(most):.4g} deg); "
                "if it is in degrees, give numpy.radians(angles)"
            )
    return tuple(found)
