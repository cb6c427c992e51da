"""Surfaces of revolution: conics, spheres, aspheres, the plane; and the cylinder.

Sag of ISO 10110-12: ``z = c r^2 / (1 + sqrt(1 - (1 + k) c^2 r^2))`` with ``c = 1/R``; R > 0 opens
towards +z, out of the material, and is a concave part.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self, cast

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, DegenerateFitError, TooFewSamplesError
from metrosep.core.numbers import positive
from metrosep.forms.base import Shape, checked, positive_root, root


class _Revolution(Shape):
    """A conic of revolution in R and k; `k` of a class is 0 where it is not a parameter."""

    R: Any
    k: Any
    radii = ("R",)

    def start(self, x: FloatArray, y: FloatArray, z: FloatArray) -> Self:
        # R by algebraic regression with tilt and piston, finite also for a flat part; an unknown k
        # is 0, or -1 where a sphere of that R would end before the data do.
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
            values["R"] = inside(R, extent * math.sqrt(max(1.0 + k, 0.0)))
        return self.with_parameters(**values) if values else self

    def _parts(self, x: FloatArray, y: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """Return R, r^2, and the square of the root."""
        R, k = (*self._known(*self.units), 0.0)[:2]
        square = x * x + y * y
        return R, square, 1.0 - ((1.0 + k) / R / R) * square

    def height(self, x: FloatArray, y: FloatArray) -> FloatArray:
        R, square, w = self._parts(x, y)
        return square / (R * (1.0 + root(w)))

    def slopes(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        R, _, w = self._parts(x, y)
        rate = 1.0 / (R * positive_root(w))
        return x * rate, y * rate

    def _derivatives(self, x: FloatArray, y: FloatArray, names: Sequence[str]) -> list[FloatArray]:
        return self.expansion(x, y, names, slopes=False)[2]

    def expansion(
        self, x: FloatArray, y: FloatArray, names: Sequence[str], *, slopes: bool
    ) -> tuple[FloatArray, tuple[FloatArray, FloatArray] | None, list[FloatArray]]:
        # From one square root; heights are NaN also on the equator, where slopes are infinite.
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


@dataclass(frozen=True, repr=False)
class Conic(_Revolution):
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
    weak = ("k",)


# ---- curvature of points, to start the fit of a curved form ------------------------------------

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
    """Return the half width of points and the spread of their heights, where they determine a form."""
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


# ---- the rotationally symmetric asphere of lens drawings: a conic and powers of the radius -----
# ``z = c r^2 / (1 + sqrt(1 - (1 + k) c^2 r^2)) + sum of a_n r^n``, as in ISO 10110-12.

Terms = Mapping[int, float | None] | Sequence[Any]

_HIGHEST = 40
"""Powers above it are a slip of the pen."""


class Departing(Shape):
    """A sphere or conic with something added to it along the axis."""

    @abstractmethod
    def departure(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return what is added, the height above the sphere or conic along the axis.

        Parameters
        ----------
        x, y : ndarray, m
            Positions in the form's frame.

        Returns
        -------
        ndarray, m
            Heights.

        Raises
        ------
        DataError
            If a parameter or the radius is not known yet.
        """


@dataclass(frozen=True, repr=False)
class Asphere(Departing):
    """A conic of revolution with added powers of the radius.

    Parameters
    ----------
    R : float or None, m
        Radius of curvature at the vertex, not zero; > 0 for a concave part. None: not known.
    k : float or None, dimensionless
        Conic constant, 0 for a sphere. None: not known.
    coefficients : mapping of int to float, or sequence of float, m^(1-n)
        Power and coefficient, such as ``{4: 1.5e3, 6: None}``, or the even terms from r^4 on.
        None as a value: not known, a fit finds it.
    odd : mapping of int to float, or sequence of float, m^(1-n)
        The same for odd powers; a sequence starts at r^3.
    norm_radius : float or None, m
        With it the powers are those of r/norm_radius, and all coefficients are in m.

    Raises
    ------
    DataError
        If R or norm_radius is zero, a value is not finite, a power is not an integer from 2 to 40,
        is given twice, or is even in `odd`.

    Notes
    -----
    Parameters are named ``R``, ``k``, ``a3``, ``a4`` ... A drawing in millimetres gives a_n in
    mm^(1-n): multiply by 1e3^(n-1). A power of 2 acts like a change of 1/R, and a free k like a
    free a4 on a shallow part: a fit of both is confounded. Domain as for `Conic`.

    References
    ----------
    .. [1] ISO 10110-12:2019, rotationally symmetric surfaces, even and odd terms.

    Examples
    --------
    >>> Asphere(R=50e-3, k=-1.0, coefficients=[1e3])(10e-3).item()
    0.00101
    """

    R: float | None = None
    k: float | None = 0.0
    coefficients: Terms = ()
    odd: Terms = ()
    norm_radius: float | None = None

    name = "asphere"
    radii = ("R",)
    weak = ("k",)

    def __post_init__(self) -> None:
        terms = _terms(self.coefficients, first=4, is_odd=False)
        for power, value in _terms(self.odd, first=3, is_odd=True).items():
            if power in terms:
                raise DataError(f"the power {power} is given twice in the asphere; give it once")
            terms[power] = value
        ordered = tuple(sorted(terms.items()))
        norm = self.norm_radius
        if norm is not None:
            norm = positive(norm, "norm_radius", dimension="length")
        units = {"R": "m", "k": "1"}
        units |= {f"a{n}": "m" if norm else f"m^{1 - n}" for n, _ in ordered}
        self._set(
            R=checked(self.R, "R", zero=False, dimension="length"),
            k=checked(self.k, "k"),
            coefficients=ordered,
            odd=(),
            norm_radius=norm,
            units=units,
        )

    @property
    def terms(self) -> tuple[tuple[int, float | None], ...]:
        """Powers and coefficients, rising."""
        return cast("tuple[tuple[int, float | None], ...]", self.coefficients)

    @property
    def parameters(self) -> dict[str, float | None]:
        return {"R": self.R, "k": self.k, **{f"a{n}": v for n, v in self.terms}}

    def with_parameters(self, **values: float) -> Self:
        self._check_names(values)
        now = {**self.parameters, **values}
        terms = {n: now[f"a{n}"] for n, _ in self.terms}
        return type(self)(now["R"], now["k"], terms, norm_radius=self.norm_radius)

    def start(self, x: FloatArray, y: FloatArray, z: FloatArray) -> Self:
        # Unknown coefficients are 0; R and k as of a conic, without the known coefficients.
        zeros = {f"a{n}": 0.0 for n, v in self.terms if v is None}
        form = self.with_parameters(**zeros)
        if self.R is not None and self.k is not None:
            return form
        rest = z - form.departure(x, y)
        conic = Conic(self.R, self.k).start(x, y, rest)
        return form.with_parameters(**{n: v for n, v in conic.parameters.items() if v is not None})

    def departure(self, x: FloatArray, y: FloatArray) -> FloatArray:
        return self._powers(x * x + y * y, lowered=0)

    def _powers(self, square: FloatArray, *, lowered: int) -> FloatArray:
        """Return the sum of a_n rho^n, or of n a_n rho^(n-2) / norm^2 when lowered by 2."""
        norm = self.norm_radius or 1.0
        values = self._known(*(f"a{n}" for n, _ in self.terms))
        weights = {
            n: v * (n / norm**2 if lowered else 1.0)
            for (n, _), v in zip(self.terms, values, strict=True)
        }
        if not weights:
            return np.zeros_like(square)
        rho2 = square / norm**2
        even = {(n - lowered) // 2: v for n, v in weights.items() if n % 2 == 0}
        odd = {(n - 1 - lowered) // 2: v for n, v in weights.items() if n % 2}
        total = _horner(even, rho2)
        return total + np.sqrt(rho2) * _horner(odd, rho2) if odd else total

    def height(self, x: FloatArray, y: FloatArray) -> FloatArray:
        return Conic(self.R, self.k).height(x, y) + self.departure(x, y)

    def slopes(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        gx, gy = Conic(self.R, self.k).slopes(x, y)
        rate = self._powers(x * x + y * y, lowered=2)
        return gx + x * rate, gy + y * rate

    def _derivatives(self, x: FloatArray, y: FloatArray, names: Sequence[str]) -> list[FloatArray]:
        conic = [n for n in names if n in ("R", "k")]
        found = dict(zip(conic, Conic(self.R, self.k).derivatives(x, y, conic), strict=True))
        rho = np.hypot(x, y) / (self.norm_radius or 1.0)
        return [found[n] if n in found else rho ** int(n[1:]) for n in names]


def _horner(terms: Mapping[int, float], variable: FloatArray) -> FloatArray:
    total = np.zeros_like(variable)
    for power in range(max(terms, default=0), -1, -1):
        total *= variable
        if power in terms:
            total += terms[power]
    return total


def _terms(given: Terms, *, first: int, is_odd: bool) -> dict[int, float | None]:
    if isinstance(given, Mapping):
        pairs = list(given.items())
    elif isinstance(given, str):
        raise DataError("coefficients are a mapping of power to value or a sequence of values")
    else:
        items = list(given)
        paired = bool(items) and all(isinstance(i, tuple) for i in items)
        pairs = items if paired else [(first + 2 * i, v) for i, v in enumerate(items)]
    terms: dict[int, float | None] = {}
    for power, value in pairs:
        if power not in range(2, _HIGHEST + 1):
            raise DataError(
                f"a power of an asphere is an integer from 2 to {_HIGHEST}, got {power!r}"
            )
        if is_odd and power % 2 == 0:
            raise DataError(f"odd= has the even power {power}; put it into coefficients=")
        terms[int(power)] = checked(value, f"a{power}")
    return terms


# ---- the plane z = 0 ---------------------------------------------------------------------------


@dataclass(frozen=True, repr=False)
class Plane(Shape):
    """The plane ``z = 0``; its height and inclination are rigid-body freedoms of a fit.

    Notes
    -----
    It has no parameters and no centre: a map is not moved for it.

    Examples
    --------
    >>> Plane()(1e-3, 2e-3).item()
    0.0
    """

    name = "plane"
    has_centre = False
    is_everywhere = True

    def height(self, x: FloatArray, y: FloatArray) -> FloatArray:
        return np.zeros_like(x)

    def slopes(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        return np.zeros_like(x), np.zeros_like(x)

    def _derivatives(self, x: FloatArray, y: FloatArray, names: Sequence[str]) -> list[FloatArray]:
        return []


# ---- the sphere --------------------------------------------------------------------------------


@dataclass(frozen=True, repr=False)
class Sphere(_Revolution):
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
    k = 0.0
    units = {"R": "m"}  # noqa: RUF012


# ---- the circular cylinder that lies on the plane z = 0 ----------------------------------------


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
