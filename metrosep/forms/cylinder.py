"""The circular cylinder that lies on the plane z = 0."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DegenerateFitError
from metrosep.forms.base import Shape, checked, positive_root, root
from metrosep.forms.conic import inside, mean_curvature, radius_of, scaled

__all__ = ["Cylinder"]


@dataclass(frozen=True, repr=False)
class Cylinder(Shape):
    """A circular cylinder that touches the plane z = 0 along its axis direction.

    Parameters
    ----------
    R : float or None, m
        Radius, not zero and finite; > 0 for a concave part (a trough), < 0 for a convex one.
        None: not known, a fit finds it.
    angle : float or None, rad
        Direction of the axis in the xy plane, from +x towards +y. With 0 the part is curved along
        y, with pi/2 along x, which is what a profile sees. None: not known, a fit finds it.

    Raises
    ------
    DataError
        If R is zero, or a value is not finite.

    Notes
    -----
    ``z = (t^2/R) / (1 + sqrt(1 - (t/R)^2))`` with the distance from the axis ``t = y cos(angle) -
    x sin(angle)``. Angles that differ by pi are the same cylinder. NaN beyond ``|t| = |R|``; slopes
    and derivatives also on it.

    Examples
    --------
    >>> round(Cylinder(R=5e-3)(1.0, 3e-3).item(), 15)
    0.001
    """

    R: float | None = None
    angle: float | None = 0.0

    name = "cylinder"
    units = {"R": "m", "angle": "rad"}  # noqa: RUF012
    radii = ("R",)
    weak = ("angle",)

    def __post_init__(self) -> None:
        self._set(
            R=checked(self.R, "R", zero=False, dimension="length"),
            angle=checked(self.angle, "angle", dimension="angle"),
        )

    def start(self, x: FloatArray, y: FloatArray, z: FloatArray) -> Self:
        # The axis, -pi/2 < angle <= pi/2, in which a parabolic cylinder with tilt and piston leaves
        # least; R by algebraic regression across it.
        values: dict[str, float] = {}
        angle = self.angle
        if angle is None:
            scaled(x, y, z, self.name, 4)
            angle = values["angle"] = _best_direction(x, y, z)
        if self.R is None:
            across = y * math.cos(angle) - x * math.sin(angle)
            extent = float(np.abs(across).max(initial=0.0))
            if extent < 1e-12 * float(np.hypot(x, y).max(initial=0.0)):
                raise DegenerateFitError(
                    f"the points have no extent across the axis of the cylinder (angle {angle:.4g}"
                    " rad from +x): its radius shows nowhere; along a profile a cylinder is curved "
                    "with angle=pi/2"
                )
            R = radius_of(mean_curvature(x, y, z, name=self.name, across=across))
            values["R"] = inside(R, extent)
        return self.with_parameters(**values) if values else self

    def _parts(self, x: FloatArray, y: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        R, angle = self._known("R", "angle")
        t = y * math.cos(angle) - x * math.sin(angle)
        u = t / R
        return R, t, 1.0 - u * u

    def height(self, x: FloatArray, y: FloatArray) -> FloatArray:
        R, t, w = self._parts(x, y)
        return t * (t / R) / (1.0 + root(w))

    def slopes(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        R, t, w = self._parts(x, y)
        (angle,) = self._known("angle")
        rate = t / (R * positive_root(w))
        return -math.sin(angle) * rate, math.cos(angle) * rate

    def _derivatives(self, x: FloatArray, y: FloatArray, names: Sequence[str]) -> list[FloatArray]:
        R, t, w = self._parts(x, y)
        (angle,) = self._known("angle")
        w = positive_root(w)
        u = t / R
        along = x * math.cos(angle) + y * math.sin(angle)
        return [-u * u / (w * (1.0 + w)) if n == "R" else -along * u / w for n in names]


def _best_direction(x: FloatArray, y: FloatArray, z: FloatArray) -> float:
    """Return the axis of the parabolic cylinder that leaves least, rad; a saddle has two valleys.

    With t^2 = x^2 sin^2 - 2 x y sin cos + y^2 cos^2 beside 1, x, y: what t^2 explains is
    (t^2 . z)^2 / (t^2 . t^2) of what the plane leaves, from the 3 x 3 sums of x^2, x y, y^2.
    """
    half = max(float(np.abs(x).max()), float(np.abs(y).max())) or 1.0
    u, v = x / half, y / half
    plane = np.linalg.qr(np.stack([np.ones_like(u), u, v], axis=1))[0]
    bent = np.stack([u * u, u * v, v * v], axis=1)
    bent = bent - plane @ (plane.T @ bent)
    sums, right = bent.T @ bent, bent.T @ (z - z.mean())
    angle = 0.5 * math.pi - math.pi / 720.0 * np.arange(720)
    s, c = np.sin(angle), np.cos(angle)
    square = np.stack([s * s, -2.0 * s * c, c * c])
    length = np.einsum("in,ij,jn->n", square, sums, square)
    gain = np.square(right @ square) / np.where(length > 0.0, length, np.inf)
    # A profile shows no direction: the first of equals, curved along x.
    return float(angle[int(np.argmax(gain >= (1.0 - 1e-9) * gain.max()))])
