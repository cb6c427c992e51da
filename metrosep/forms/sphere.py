"""The sphere."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

from metrosep.core._arrays import FloatArray
from metrosep.forms.base import Shape, checked, positive_root, root
from metrosep.forms.conic import inside, mean_curvature, radius_of

__all__ = ["Sphere"]


@dataclass(frozen=True, repr=False)
class Sphere(Shape):
    """A sphere that touches the plane z = 0 at the origin.

    Parameters
    ----------
    R : float or None, m
        Radius, not zero and finite; > 0 for a concave part (it opens towards +z), < 0 for a
        convex one. None: not known, a fit finds it.

    Raises
    ------
    DataError
        If R is zero or not finite.

    Notes
    -----
    ``z = (r^2/R) / (1 + sqrt(1 - (r/R)^2))``, which keeps all digits of a nearly flat part. NaN
    beyond ``r = |R|``; slopes and the derivative also on it, where they are infinite.

    Examples
    --------
    Points of the circle with the sides 3, 4, 5:

    >>> round(Sphere(R=5e-3)(3e-3).item(), 15)
    0.001
    """

    R: float | None = None

    name = "sphere"
    units = {"R": "m"}  # noqa: RUF012
    radii = ("R",)

    def __post_init__(self) -> None:
        self._set(R=checked(self.R, "R", zero=False, dimension="length"))

    def start(self, x: FloatArray, y: FloatArray, z: FloatArray) -> Self:
        # R by algebraic regression with tilt and piston; finite also for a flat part.
        if self.R is not None:
            return self
        R = radius_of(mean_curvature(x, y, z, name=self.name))
        return self.with_parameters(R=inside(R, math.sqrt((x * x + y * y).max())))

    def _parts(self, x: FloatArray, y: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        (R,) = self._known("R")
        u, v = x / R, y / R
        square = u * u + v * v
        return R, square, 1.0 - square

    def height(self, x: FloatArray, y: FloatArray) -> FloatArray:
        R, square, w = self._parts(x, y)
        return R * square / (1.0 + root(w))

    def slopes(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        R, _, w = self._parts(x, y)
        rate = 1.0 / (R * positive_root(w))
        return x * rate, y * rate

    def _derivatives(self, x: FloatArray, y: FloatArray, names: Sequence[str]) -> list[FloatArray]:
        _, square, w = self._parts(x, y)
        w = positive_root(w)
        return [-square / (w * (1.0 + w)) for _ in names]
