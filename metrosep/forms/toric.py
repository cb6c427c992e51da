"""Surfaces with two radii: the torus of an optical toric, and the biconic.

`Toric` turns a circle of radius Rd in the yz plane about a line parallel to y, at the distance Rb
above the vertex. `Biconic` has a conic section in each of the planes xz and yz. Their sections on
the axes can agree; between the axes they differ in the fourth order.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DegenerateFitError
from metrosep.forms.base import Shape, positive_root, root
from metrosep.forms.conic import EQUATOR, hessian, inside, radius_of


def _start_radii(
    x: FloatArray, y: FloatArray, z: FloatArray, wanted: Sequence[bool], name: str
) -> tuple[float, float]:
    """Return the radii along x and y of the best quadratic; those not wanted are not judged."""
    H = hessian(x, y, z, name=name)
    for axis, values, is_wanted in (("x", x, wanted[0]), ("y", y, wanted[1])):
        if is_wanted and np.unique(values).size < 3:
            raise DegenerateFitError(
                f"the points have fewer than 3 positions along {axis}: the radius of a {name} "
                "along it shows nowhere; give it, or measure a map"
            )
    return radius_of(float(H[0, 0])), radius_of(float(H[1, 1]))


@dataclass(frozen=True, repr=False)
class Toric(Shape):
    """A torus that touches the plane z = 0 at the origin.

    Parameters
    ----------
    Rb : float or None, m
        Base radius, along x, not zero; > 0 for concave. None: not known, a fit finds it.
    Rd : float or None, m
        Radius of the turned circle, along y, not zero; > 0 for concave. None: not known.

    Raises
    ------
    DataError
        If a radius is zero or not finite.

    Notes
    -----
    ``z = Rb - sqrt((Rb - Rd + sqrt(Rd^2 - y^2))^2 - x^2)`` [1]_ for positive radii; each root takes
    the sign of its radius, so that opposite signs give a saddle. It is evaluated without the
    difference of large numbers. NaN where a root does not exist; slopes and derivatives also where
    it is zero.

    References
    ----------
    .. [1] Micromachines 11 (2020) 331, errors of fast tool servo turning and optical performance,
       Eq. (12), with Rb = 265 mm and Rd = 132.5 mm, x = rho cos(theta), y = rho sin(theta).

    Examples
    --------
    >>> round(Toric(Rb=5e-3, Rd=13e-3)(3e-3, 0.0).item(), 15)
    0.001
    >>> round(Toric(Rb=5e-3, Rd=13e-3)(0.0, 5e-3).item(), 15)
    0.001
    """

    Rb: float | None = None
    Rd: float | None = None

    name = "toric"
    units = {"Rb": "m", "Rd": "m"}  # noqa: RUF012
    radii = ("Rb", "Rd")

    def start(self, x: FloatArray, y: FloatArray, z: FloatArray) -> Self:
        # Radii from the best quadratic, with all points in the domain.
        if self.Rb is not None and self.Rd is not None:
            return self
        Rb, Rd = _start_radii(x, y, z, (self.Rb is None, self.Rd is None), self.name)
        Rd = inside(Rd, float(np.abs(y).max())) if self.Rd is None else self.Rd
        u = np.minimum(np.abs(y / Rd), 1.0)
        sag = Rd * u * u / (1.0 + np.sqrt(1.0 - u * u))
        reach = float((np.abs(x) + math.copysign(1.0, Rb) * sag).max())
        Rb = inside(Rb, max(reach, 0.0)) if self.Rb is None else self.Rb
        return self.with_parameters(Rb=Rb, Rd=Rd)

    def _parts(
        self, x: FloatArray, y: FloatArray
    ) -> tuple[float, float, FloatArray, FloatArray, FloatArray]:
        """Return Rb, Rd, the sag g along y, Rb - g, and the square of the outer root."""
        Rb, Rd = self._known("Rb", "Rd")
        u = y / Rd
        g = y * u / (1.0 + root(1.0 - u * u))
        arm = Rb - g
        left = np.where(arm * Rb > 0.0, (arm - x) * (arm + x), np.nan)
        return Rb, Rd, g, arm, left

    def height(self, x: FloatArray, y: FloatArray) -> FloatArray:
        Rb, _, g, arm, left = self._parts(x, y)
        return g + x * x / (arm + math.copysign(1.0, Rb) * root(left))

    def slopes(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        Rb, Rd, _, arm, left = self._parts(x, y)
        Q = math.copysign(1.0, Rb) * positive_root(left)
        u = y / Rd
        return x / Q, arm / Q * (u / positive_root(1.0 - u * u))

    def _derivatives(self, x: FloatArray, y: FloatArray, names: Sequence[str]) -> list[FloatArray]:
        Rb, Rd, _, arm, left = self._parts(x, y)
        Q = math.copysign(1.0, Rb) * positive_root(left)
        found: list[FloatArray] = []
        for name in names:
            if name == "Rb":
                found.append(-x * x / ((arm + Q) * Q))
            else:
                u2 = (y / Rd) ** 2
                w = positive_root(1.0 - u2)
                found.append(-(arm / Q) * u2 / (w * (1.0 + w)))
        return found


@dataclass(frozen=True, repr=False)
class Biconic(Shape):
    """A surface with a conic section in each of the planes xz and yz.

    Parameters
    ----------
    Rx, Ry : float or None, m
        Radii of curvature at the vertex along x and y, not zero; > 0 for concave. None: not known.
    kx, ky : float or None, dimensionless
        Conic constants of the sections. None: not known, a fit finds it.

    Raises
    ------
    DataError
        If a radius is zero, or a value is not finite.

    Notes
    -----
    ``z = (cx x^2 + cy y^2) / (1 + sqrt(1 - (1 + kx) cx^2 x^2 - (1 + ky) cy^2 y^2))``, c = 1/R. With
    equal radii and constants it is the conic of revolution. NaN where the root does not exist;
    slopes and derivatives also where it is zero.

    References
    ----------
    .. [1] ISO 10110-19:2015, general description of surfaces.

    Examples
    --------
    >>> round(Biconic(Rx=5e-3, Ry=8e-3, kx=0.0, ky=-1.0)(3e-3, 0.0).item(), 15)
    0.001
    """

    Rx: float | None = None
    Ry: float | None = None
    kx: float | None = None
    ky: float | None = None

    name = "biconic"
    units = {"Rx": "m", "Ry": "m", "kx": "1", "ky": "1"}  # noqa: RUF012
    radii = ("Rx", "Ry")
    weak = ("kx", "ky")

    def start(self, x: FloatArray, y: FloatArray, z: FloatArray) -> Self:
        # Radii from the best quadratic; an unknown conic constant is 0, or -1 where the data would
        # leave the domain.
        Rx, Ry, kx, ky = self.Rx, self.Ry, self.kx, self.ky
        if Rx is None or Ry is None:
            found = _start_radii(x, y, z, (Rx is None, Ry is None), self.name)
            Rx, Ry = Rx or found[0], Ry or found[1]
        outside = ((x / Rx) ** 2 + (y / Ry) ** 2).max(initial=0.0) * EQUATOR > 1.0
        unknown = -1.0 if outside else 0.0
        kx, ky = (unknown if kx is None else kx), (unknown if ky is None else ky)
        load = ((1.0 + kx) * (x / Rx) ** 2 + (1.0 + ky) * (y / Ry) ** 2).max(initial=0.0) * EQUATOR
        if load > 1.0:
            Rx = Rx * math.sqrt(load) if self.Rx is None else Rx
            Ry = Ry * math.sqrt(load) if self.Ry is None else Ry
        return self.with_parameters(Rx=Rx, Ry=Ry, kx=kx, ky=ky)

    def _parts(self, x: FloatArray, y: FloatArray) -> tuple[list[float], FloatArray, FloatArray]:
        """Return the parameters, the numerator, and the square of the root."""
        Rx, Ry, kx, ky = values = self._known("Rx", "Ry", "kx", "ky")
        u, v = x / Rx, y / Ry
        return values, u * x + v * y, 1.0 - (1.0 + kx) * u * u - (1.0 + ky) * v * v

    def height(self, x: FloatArray, y: FloatArray) -> FloatArray:
        _, top, w = self._parts(x, y)
        return top / (1.0 + root(w))

    def slopes(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        (Rx, Ry, kx, ky), top, w = self._parts(x, y)
        w = positive_root(w)
        first = 2.0 / (1.0 + w)
        second = top / (w * (1.0 + w) ** 2)
        u, v = x / Rx, y / Ry
        return (
            u * (first + second * ((1.0 + kx) / Rx)),
            v * (first + second * ((1.0 + ky) / Ry)),
        )

    def _derivatives(self, x: FloatArray, y: FloatArray, names: Sequence[str]) -> list[FloatArray]:
        (Rx, Ry, kx, ky), top, w = self._parts(x, y)
        w = positive_root(w)
        second = top / (w * (1.0 + w) ** 2)
        found: list[FloatArray] = []
        for name in names:
            t, R, k = (x, Rx, kx) if name.endswith("x") else (y, Ry, ky)
            square = (t / R) ** 2
            if name.startswith("k"):
                found.append(0.5 * second * square)
            else:
                found.append(-square * (1.0 / (1.0 + w) + second * ((1.0 + k) / R)))
        return found
