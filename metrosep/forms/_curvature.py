"""Curvature of points, to start the fit of a curved form."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from metrosep.core.errors import DegenerateFitError, TooFewSamplesError

FloatArray = NDArray[np.float64]

ROUNDING = 1e-13
"""A sag below this part of the largest height is rounding, not curvature."""

FLATTEST = 1e-9
"""A sag is never guessed below this part of the spread of heights, so that R stays finite."""

EQUATOR = 1.02
"""A guessed radius keeps the data this factor inside the equator."""

PICARD_STEPS = 5
"""Repeats of the algebraic fit; each gains a digit on a hemisphere, and it is only a start."""


def _scaled(
    x: FloatArray, y: FloatArray, z: FloatArray, name: str, needed: int
) -> tuple[float, float]:
    if z.size < needed:
        raise TooFewSamplesError(
            f"a {name} needs at least {needed} points to guess its curvature, got {z.size}"
        )
    extent = float(max(np.abs(x).max(), np.abs(y).max()))
    spread = float(np.ptp(z))
    if extent == 0.0 or spread == 0.0:
        what = "all heights are equal" if spread == 0.0 else "all points lie at the centre"
        raise DegenerateFitError(
            f"{what}: a {name} has no curvature to find there; fit a plane, or give the radius"
        )
    return extent, spread


def mean_curvature(
    x: FloatArray,
    y: FloatArray,
    z: FloatArray,
    *,
    name: str,
    k: float = 0.0,
    across: FloatArray | None = None,
) -> float:
    """Return the vertex curvature 1/R of a conic of revolution through points, 1/m, never zero.

    Regression of z on 1, x, y and ``r^2 + (1 + k) (z - z0)^2``, whose last coefficient is 1/(2 R)
    exactly for a conic with its vertex at (0, 0, z0); z0 starts from the fit without it. With
    `across`, the distance from the axis of a cylinder, that stands for r.
    """
    extent, spread = _scaled(x, y, z, name, 4)
    u, v, w = x / extent, y / extent, (z - z.mean()) / spread
    square = u * u + v * v if across is None else (across / extent) ** 2
    slope = spread / extent
    column, sag = square, 0.0
    for _ in range(PICARD_STEPS):
        matrix = np.stack([np.ones_like(u), u, v, column], axis=1)
        (z0, _, _, sag), _, _, _ = np.linalg.lstsq(matrix, w, rcond=1e-12)
        column = square + (1.0 + k) * (slope * (w - z0)) ** 2
    return 2.0 * _finite(sag * spread, z, spread, name) / extent**2


def _finite(sag: float, z: FloatArray, spread: float, name: str) -> float:
    if abs(sag) <= ROUNDING * float(np.abs(z).max()):
        raise DegenerateFitError(
            f"the points lie in a plane to rounding: a {name} has no curvature to find there; "
            "fit a plane, or give the radius"
        )
    return math.copysign(max(abs(sag), FLATTEST * spread), sag)


def hessian(x: FloatArray, y: FloatArray, z: FloatArray, *, name: str) -> FloatArray:
    """Return the second derivatives of the best quadratic, shape (2, 2), 1/m.

    What the points cannot tell (a profile has no curvature across) comes out as zero.
    """
    extent, spread = _scaled(x, y, z, name, 4)
    u, v, w = x / extent, y / extent, (z - z.mean()) / spread
    matrix = np.stack([np.ones_like(u), u, v, 0.5 * u * u, u * v, 0.5 * v * v], axis=1)
    c, _, _, _ = np.linalg.lstsq(matrix, w, rcond=1e-12)
    largest = 0.5 * float(np.abs(c[3:]).max()) * spread
    _finite(largest, z, spread, name)
    return np.array([[c[3], c[4]], [c[4], c[5]]]) * (spread / extent**2)


def radius_of(curvature: float, x: FloatArray, y: FloatArray, z: FloatArray) -> float:
    """Return 1/curvature, large and finite for a flat direction."""
    extent = float(max(np.abs(x).max(), np.abs(y).max()))
    least = 2.0 * FLATTEST * float(np.ptp(z)) / extent**2
    return 1.0 / math.copysign(max(abs(curvature), least), curvature)


def inside(radius: float, extent: float) -> float:
    """Return a radius of curvature of the same sign whose equator lies outside the data."""
    return math.copysign(max(abs(radius), EQUATOR * extent), radius)
