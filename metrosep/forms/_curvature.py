"""Curvature of points, to start the fit of a curved form."""

from __future__ import annotations

import math

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DegenerateFitError, TooFewSamplesError

FLAT = 1e100
"""m: the radius that stands for a curvature of zero. Its sag is below the smallest float of any
height, and its square is still a float, which the derivative by the curvature needs."""

EQUATOR = 1.02
"""A guessed radius keeps the data this factor inside the equator."""

PICARD_STEPS = 5
"""Repeats of the algebraic fit; each gains a digit on a hemisphere, and it is only a start."""


def scaled(
    x: FloatArray, y: FloatArray, z: FloatArray, name: str, needed: int
) -> tuple[float, float]:
    if z.size < needed:
        raise TooFewSamplesError(
            f"a {name} needs at least {needed} points to guess its curvature, got {z.size}"
        )
    extent = float(max(np.abs(x).max(), np.abs(y).max()))
    spread = float(np.ptp(z))
    if extent == 0.0:
        raise DegenerateFitError(
            f"all points lie at the centre: a {name} has no curvature to find there; give the radius"
        )
    return extent, spread or 1.0


def mean_curvature(
    x: FloatArray,
    y: FloatArray,
    z: FloatArray,
    *,
    name: str,
    k: float = 0.0,
    across: FloatArray | None = None,
) -> float:
    """Return the vertex curvature 1/R of a conic of revolution through points, 1/m.

    Regression of z on 1, x, y and ``r^2 + (1 + k) (z - z0)^2``, whose last coefficient is 1/(2 R)
    exactly for a conic with its vertex at (0, 0, z0); z0 starts from the fit without it. With
    `across`, the distance from the axis of a cylinder, that stands for r.
    """
    extent, spread = scaled(x, y, z, name, 4)
    u, v, w = x / extent, y / extent, (z - z.mean()) / spread
    square = u * u + v * v if across is None else (across / extent) ** 2
    slope = spread / extent
    column, sag = square, 0.0
    for _ in range(PICARD_STEPS):
        matrix = np.stack([np.ones_like(u), u, v, column], axis=1)
        (z0, _, _, sag), _, _, _ = np.linalg.lstsq(matrix, w, rcond=1e-12)
        column = square + (1.0 + k) * (slope * (w - z0)) ** 2
    return 2.0 * float(sag) * spread / extent**2


def hessian(x: FloatArray, y: FloatArray, z: FloatArray, *, name: str) -> FloatArray:
    """Return the second derivatives of the best quadratic, shape (2, 2), 1/m.

    What the points cannot tell (a profile has no curvature across) comes out as zero.
    """
    extent, spread = scaled(x, y, z, name, 4)
    u, v, w = x / extent, y / extent, (z - z.mean()) / spread
    matrix = np.stack([np.ones_like(u), u, v, 0.5 * u * u, u * v, 0.5 * v * v], axis=1)
    c, _, _, _ = np.linalg.lstsq(matrix, w, rcond=1e-12)
    return np.array([[c[3], c[4]], [c[4], c[5]]]) * (spread / extent**2)


def radius_of(curvature: float) -> float:
    """Return 1/curvature, finite also for a curvature of zero."""
    return math.copysign(FLAT, curvature) if abs(curvature) * FLAT < 1.0 else 1.0 / curvature


def is_flat(radius: float) -> bool:
    """Return whether a radius stands for a curvature of zero; rounding may have lowered it."""
    return abs(radius) >= 0.1 * FLAT


def curvature_of(radius: float) -> float:
    """Return 1/radius, zero for a radius that stands for a flat."""
    return 0.0 if is_flat(radius) else 1.0 / radius


def inside(radius: float, extent: float) -> float:
    """Return a radius of curvature of the same sign whose equator lies outside the data."""
    return math.copysign(max(abs(radius), EQUATOR * extent), radius)


def curvature_name(radius: str) -> str:
    """Return the name of 1/R: c for R, cx for Rx."""
    return "c" + radius[1:]
