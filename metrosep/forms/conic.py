"""Conics of revolution: sphere, ellipsoid, paraboloid, hyperboloid.

Sag of ISO 10110-12: ``z = c r^2 / (1 + sqrt(1 - (1 + k) c^2 r^2))`` with ``c = 1/R``; R > 0 opens
towards +z, out of the material, and is a concave part.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.forms._curvature import EQUATOR, mean_curvature, radius_of
from metrosep.forms._shape import Shape, positive_root, root
from metrosep.forms.base import checked

__all__ = ["Conic"]


@dataclass(frozen=True, repr=False)
class Conic(Shape):
    """A conic of revolution about z with its vertex at the origin.

    Parameters
    ----------
    R : float or None, m
        Radius of curvature at the vertex, not zero and finite; > 0 for a concave part (it rises
        away from the vertex). None: not known, a fit finds it.
    k : float or None, dimensionless
        Conic constant: < -1 hyperboloid, -1 paraboloid, -1..0 prolate ellipsoid, 0 sphere, > 0
        oblate ellipsoid. None: not known, a fit finds it.

    Raises
    ------
    DataError
        If R is zero, or a value is not finite.

    Notes
    -----
    Heights are NaN where ``(1 + k) r^2 > R^2``, beyond the equator; slopes and derivatives also on
    it, where they are infinite. No difference of large numbers is formed: a nearly flat part keeps
    all its digits.

    References
    ----------
    .. [1] ISO 10110-12:2019, rotationally symmetric surfaces.

    Examples
    --------
    A paraboloid is r^2 / (2 R) exactly.

    >>> Conic(R=50e-3, k=-1.0)(10e-3).item()
    0.001
    """

    R: float | None = None
    k: float | None = None

    name = "conic"
    units = {"R": "m", "k": "1"}  # noqa: RUF012
    radii = ("R",)
    weak = ("k",)

    def __post_init__(self) -> None:
        self._set(R=checked(self.R, "R", zero=False, dimension="length"), k=checked(self.k, "k"))

    def start(self, x: FloatArray, y: FloatArray, z: FloatArray) -> Self:
        """Return the conic with values for its unknown parameters, good enough to start a fit.

        Parameters
        ----------
        x, y, z : ndarray, shape (n,), m
            Valid points, x and y from the assumed vertex; no NaN.

        Returns
        -------
        Conic
            R by algebraic regression with tilt and piston; an unknown k is 0, or -1 where a
            sphere of that R would end before the data do.

        Raises
        ------
        TooFewSamplesError
            If there are fewer than 4 points.
        DegenerateFitError
            If all points lie at the centre.
        """
        extent = float(np.sqrt((x * x + y * y).max())) if x.size else 0.0
        values: dict[str, float] = {}
        k = self.k
        if k is None:
            k = 0.0
            if self.R is None or abs(self.R) <= EQUATOR * extent:
                parabola = radius_of(mean_curvature(x, y, z, name=self.name, k=-1.0))
                k = 0.0 if abs(self.R or parabola) > EQUATOR * extent else -1.0
            values["k"] = k
        if self.R is None:
            R = radius_of(mean_curvature(x, y, z, name=self.name, k=k))
            least = EQUATOR * extent * math.sqrt(max(1.0 + k, 0.0))
            values["R"] = math.copysign(max(abs(R), least), R)
        return self.with_parameters(**values) if values else self

    def _parts(self, x: FloatArray, y: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        R, k = self._known("R", "k")
        square = x * x + y * y
        return R, square, 1.0 - ((1.0 + k) / R / R) * square

    def _height(self, x: FloatArray, y: FloatArray) -> FloatArray:
        R, square, w = self._parts(x, y)
        return square / (R * (1.0 + root(w)))

    def _slopes(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        R, _, w = self._parts(x, y)
        rate = 1.0 / (R * positive_root(w))
        return x * rate, y * rate

    def _derivatives(self, x: FloatArray, y: FloatArray, names: Sequence[str]) -> list[FloatArray]:
        R, square, w = self._parts(x, y)
        w = positive_root(w)
        common = square / (R * R * w * (1.0 + w))
        return [-common if n == "R" else common * square / (2.0 * R * (1.0 + w)) for n in names]

    def expansion(
        self, x: FloatArray, y: FloatArray, names: Sequence[str], *, slopes: bool
    ) -> tuple[FloatArray, tuple[FloatArray, FloatArray] | None, list[FloatArray]]:
        """Return heights, slopes and derivatives at once, from one square root.

        Parameters
        ----------
        x, y : ndarray, m
            Positions in the form's frame, of equal shape.
        names : sequence of str
            Of parameters.
        slopes : bool
            Whether slopes are wanted.

        Returns
        -------
        height : ndarray, m
            NaN also on the equator, where slopes are infinite.
        slopes : tuple of ndarray or None
            dz/dx and dz/dy.
        derivatives : list of ndarray
            In the order of the names.

        Raises
        ------
        DataError
            If a name is unknown or a parameter is not known yet.
        """
        self._check_names(names)
        R, square, w = self._parts(x, y)
        w = positive_root(w)
        height = square / (R * (1.0 + w))
        found = None
        if slopes:
            rate = 1.0 / (R * w)
            found = x * rate, y * rate
        common = height / (R * w) if names else w
        derived = [-common if n == "R" else 0.5 * common * height for n in names]
        return height, found, derived
