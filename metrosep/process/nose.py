"""The nose of a diamond tool: radius, rake, sharp window, measured waviness, and the error of rake.

The edge is a curve in space. With the angle psi from the tip, positive outwards, and the deviation
delta(psi) of its radius, positive outwards, it has risen by ``up = R - (R + delta) cos psi`` and lies

    x = (R + delta) sin psi,  y = -sigma ky up,  z = kz up

from the tip, where ``kz = cos(rake), ky = sin(rake)`` if R is the radius in the rake face, and
``kz = 1, ky = tan(rake)`` if it is that of the view along the cut. sigma = +1 where the tool goes
round the part counter-clockwise, seen from +z. Yaw turns the edge about z. Slopes are dz/drho at
constant azimuth; z points out of the material. Error = actual - nominal.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, field
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray, frozen_float, same_length
from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotConvergedError,
    TooFewSamplesError,
    UnitError,
)
from metrosep.core.provenance import freeze_mapping
from metrosep.core.units import format_length
from metrosep.forms.base import Form
from metrosep.process._plain import finite_positions, length
from metrosep.process._setting_equations import known_form, polar_gradient, polar_slopes
from metrosep.process.setting_maps import LARGEST_NOSE, positions

Flank = Literal["conical", "cylindrical"]
RadiusIn = Literal["face", "projection"]
Sense = Literal["counterclockwise", "clockwise"]

_STEEPEST_RAKE, _LARGEST_YAW = math.radians(85.0), math.radians(45.0)
_LARGEST_WAVE = 1e-3
"""m: no edge deviates that much from its circle; a number above is in um or nm."""
_SENSES_AGREE = 1e-12
"""m: errors of both senses that are nearer than that are one."""
_MOST_STEPS, _TANGENT_STEPS = 40, 8
_CLOSE = 1e-13
"""m: of a position; the error changes by 1e-3 of it at most, which is 1e-7 nm."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class EdgeProfile:
    """Measured waviness of an edge: deviation of its radius over the angle.

    Parameters
    ----------
    angle : array_like, shape (n,), rad
        From the tip, positive outwards (away from the spindle axis), strictly growing; n >= 4.
    deviation : array_like, shape (n,), m
        Of the radius, outward positive: such an edge cuts deeper there.
    removed : mapping of str to float, m, optional
        What `from_certificate` took off: ``dR``, ``dx``, ``dz``.
    messages : tuple of str, optional
        What to know.

    Raises
    ------
    InvalidSamplesError
        If a value is not finite, or the angles do not grow.
    TooFewSamplesError
        If there are fewer than four.
    DataError
        If the lengths differ, or a deviation is larger than 1 mm.
    UnitError
        If the angles cannot be in radians.

    Notes
    -----
    A cubic spline between the points; there is no edge beyond them.

    Examples
    --------
    >>> wave = EdgeProfile(np.radians([-40.0, -20.0, 0.0, 20.0, 40.0]), [0.0, 4e-8, 0.0, -4e-8, 0.0])
    >>> wave.at(np.array([0.0])).round(12).tolist()
    [0.0]
    """

    angle: FloatArray
    deviation: FloatArray
    removed: Mapping[str, float] = field(default_factory=dict)
    messages: tuple[str, ...] = ()
    _splines: tuple[Any, Any] = field(init=False)

    def __post_init__(self) -> None:
        from scipy.interpolate import CubicSpline

        angle = frozen_float(self.angle, name="angle of the edge", ndim=1)
        deviation = frozen_float(self.deviation, name="deviation of the edge", ndim=1)
        same_length(angle=angle, deviation=deviation)
        if angle.size < 4:
            raise TooFewSamplesError(f"an edge profile needs 4 points or more, got {angle.size}")
        if np.isnan(angle).any() or np.isnan(deviation).any() or not (np.diff(angle) > 0.0).all():
            raise InvalidSamplesError(
                "angles of an edge must grow strictly, and no value may be NaN: sort them, and leave "
                "out what was not measured"
            )
        if float(np.abs(angle).max()) > math.pi:
            raise UnitError(
                f"an angle of the edge is {float(np.abs(angle).max()):.4g} rad, beyond half a turn: "
                "angles are in radians"
            )
        if float(np.abs(deviation).max()) > _LARGEST_WAVE:
            raise DataError(
                f"the edge deviates by {float(np.abs(deviation).max()):.4g} m from its circle: "
                "deviations are in metres"
            )
        spline = CubicSpline(angle, deviation)
        object.__setattr__(self, "angle", angle)
        object.__setattr__(self, "deviation", deviation)
        object.__setattr__(self, "removed", freeze_mapping(dict(self.removed)))
        object.__setattr__(self, "_splines", (spline, spline.derivative()))

    def __repr__(self) -> str:
        low, high = np.degrees(self.angle[[0, -1]])
        size = format_length(float(np.ptp(self.deviation)))
        return (
            f"EdgeProfile({self.angle.size} points from {low:.4g} to {high:.4g} deg, P-V {size})"
        )

    @classmethod
    def from_certificate(
        cls, angle: ArrayLike, deviation: ArrayLike, *, rises: Literal["outwards", "inwards"]
    ) -> EdgeProfile:
        """Return the profile of a maker's certificate, without the circle that fits it best.

        Parameters
        ----------
        angle : array_like, shape (n,), rad
            As plotted, from the tip, growing.
        deviation : array_like, shape (n,), m
            Outward positive.
        rises : {"outwards", "inwards"}
            Where the plotted angle grows to: away from the spindle axis or towards it. Plots run from
            left to right on the rake face; that is either, by the side on which the tool stands.

        Returns
        -------
        EdgeProfile
            `removed` holds the mean (dR) and the shifts of the circle (dx, dz); messages name them.

        Raises
        ------
        DataError
            If the direction is not known, or as of the class.

        Examples
        --------
        >>> at = np.radians(np.linspace(-50.0, 50.0, 41))
        >>> made = EdgeProfile.from_certificate(at, 1e-7 + 2e-7 * np.sin(at), rises="outwards")
        >>> float(np.abs(made.deviation).max()) < 1e-20, round(made.removed["dx"] * 1e9, 6)
        (True, 200.0)
        """
        numbers.choice(rises, "rises", ("outwards", "inwards"))
        raw = cls(angle, deviation)  # type: ignore[arg-type]
        psi, delta = raw.angle, raw.deviation
        if rises == "inwards":
            psi, delta = -psi[::-1], delta[::-1]
        # a circle shifted by (dx, dz) and larger by dR: dR + dx sin psi - dz cos psi, up to 2nd order
        columns = np.stack([np.ones_like(psi), np.sin(psi), -np.cos(psi)], axis=1)
        found, *_ = np.linalg.lstsq(columns, delta, rcond=None)
        removed = dict(zip(("dR", "dx", "dz"), (float(v) for v in found), strict=True))
        said = ", ".join(f"{n} {format_length(v)}" for n, v in removed.items())
        text = (
            f"the least-squares circle was taken off the certificate: {said}; a shift is a matter of "
            "touching off, a mean is an error of the radius"
        )
        return cls(psi, delta - columns @ found, removed, (text,))

    def at(self, psi: FloatArray) -> FloatArray:
        """Return the deviation of the radius at angles.

        Parameters
        ----------
        psi : ndarray, rad
            From the tip; beyond the table the spline is carried on, where there is no edge.

        Returns
        -------
        ndarray, m
            Outward positive.
        """
        return np.asarray(self._splines[0](psi))

    def slope(self, psi: FloatArray) -> FloatArray:
        """Return the change of the deviation with the angle.

        Parameters
        ----------
        psi : ndarray, rad
            As of `at`.

        Returns
        -------
        ndarray, m
            For each rad.
        """
        return np.asarray(self._splines[1](psi))


@dataclass(frozen=True, slots=True)
class RoundNose:
    """A round nose with rake, and the slopes and clearances it stands.

    Parameters
    ----------
    radius : float, m
        Of the edge, > 0; where it is measured says `radius_in`.
    rake : float, rad, optional
        Of the face in which the radius is measured, positive leaning back; less than 85 degrees.
        Its sign matters where the surface rises along the cut.
    clearance : float, rad, optional
        Angle between flank and cut surface, > 0; needed by `clearance_check`.
    window : float or tuple of (float, float), rad, optional
        Sharp part of the nose: its whole angle, symmetric about the tip, or from where (negative,
        towards the axis) to where (positive, outwards); needed by `window_check`.
    flank : {"conical", "cylindrical"}, optional
        Whether the clearance is normal to the edge all round it, or in the direction of cut.
    yaw : float, rad, optional
        Turn of the rake face about z, positive counter-clockwise seen from +z.
    radius_in : {"face", "projection"}, optional
        Whether the radius is that in the rake face, or that of the view along the cut, which makers
        certify. Both agree without rake.
    edge : EdgeProfile, optional
        Measured waviness.
    swivel : float, rad, optional
        Turn of the tool about y, right-handed: profile and window move along the edge by it, and the
        circle stays. Without rake only.

    Raises
    ------
    DataError
        If a value is not a finite number or out of range.
    UnitError
        If an angle can only be in degrees, or the radius not in metres.

    Notes
    -----
    The tip radius is ``R / cos(rake)``. A path made for R then has
    ``dR = R (1 / cos(rake) - 1)``, which the paper leaves out: 155 um at -30 degrees and 1 mm.

    Examples
    --------
    >>> import math
    >>> nose = RoundNose(1e-3, rake=math.radians(-30))
    >>> round(nose.tip_radius * 1e3, 4), round(nose.dR * 1e6, 1)
    (1.1547, 154.7)
    """

    radius: float
    rake: float = 0.0
    clearance: float | None = None
    window: float | tuple[float, float] | None = None
    _: KW_ONLY
    flank: Flank = "conical"
    yaw: float = 0.0
    radius_in: RadiusIn = "face"
    edge: EdgeProfile | None = None
    swivel: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "radius", length(self.radius, "the nose radius", LARGEST_NOSE))
        for name, limit in (("rake", _STEEPEST_RAKE), ("yaw", _LARGEST_YAW), ("swivel", 1.6)):
            turned = _angle(getattr(self, name), name, limit, signed=True)
            object.__setattr__(self, name, turned)
        if self.clearance is not None:
            value = _angle(self.clearance, "clearance", 0.5 * math.pi, signed=False)
            object.__setattr__(self, "clearance", value)
        if isinstance(self.window, tuple | list):
            object.__setattr__(self, "window", _ends_of(self.window))
        elif self.window is not None:
            value = _angle(self.window, "window", math.pi, signed=False)
            object.__setattr__(self, "window", value)
        numbers.choice(self.flank, "flank", get_args(Flank))
        numbers.choice(self.radius_in, "radius_in", get_args(RadiusIn))
        if self.edge is not None and not isinstance(self.edge, EdgeProfile):
            raise DataError(f"edge must be an EdgeProfile, got {type(self.edge).__name__}")
        if self.swivel and self.rake:
            raise DataError(
                "swivel and rake together are not in the model: measure the waviness of the edge as "
                "the tool is mounted, with swivel 0"
            )
        low, high = self.limits
        if not low < 0.0 < high:
            raise DataError(
                f"the sharp part of the nose, {math.degrees(low):.4g} to {math.degrees(high):.4g} "
                "degrees from its tip, does not hold the tip"
            )

    @property
    def tilt(self) -> tuple[float, float]:
        """How far a point of the edge lies up z and behind the tip, for each m it has risen."""
        if self.radius_in == "projection":
            return 1.0, math.tan(self.rake)
        return math.cos(self.rake), math.sin(self.rake)

    @property
    def limits(self) -> tuple[float, float]:
        """Angles from the tip between which the edge is sharp and known, rad."""
        half = 0.5 * math.pi
        ends = (-half, half)
        if isinstance(self.window, tuple):
            ends = self.window
        elif self.window is not None:
            ends = (-0.5 * self.window, 0.5 * self.window)
        if self.edge is not None:
            ends = (
                max(ends[0], float(self.edge.angle[0])),
                min(ends[1], float(self.edge.angle[-1])),
            )
        return max(ends[0] - self.swivel, -half), min(ends[1] - self.swivel, half)

    @property
    def needs_sense(self) -> bool:
        """Whether the edge leaves the plane of the spindle axis, so that the way of the tool counts."""
        return self.rake != 0.0 or self.yaw != 0.0

    @property
    def tip_radius(self) -> float:
        """Radius of curvature of the projected edge at its tip, m."""
        return self.radius / self.tilt[0]

    @property
    def dR(self) -> float:  # noqa: N802
        """What rake adds to the radius of a path made without it, m; to the second order."""
        return self.radius * (1.0 / self.tilt[0] - 1.0)

    def contact(self, slope: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return where the projected edge touches a slope, from the tip.

        Parameters
        ----------
        slope : array_like
            dz/drho, finite.

        Returns
        -------
        tuple of ndarray, m
            Along x and along z.

        Raises
        ------
        InvalidSamplesError
            If a slope is not finite.

        Examples
        --------
        >>> x, z = RoundNose(1e-3).contact(0.75)
        >>> round(x.item() * 1e3, 12), round(z.item() * 1e3, 12)
        (0.6, 0.2)
        """
        t = finite_positions(slope, "slope")
        squeeze = self.tilt[0]
        root = np.sqrt(squeeze**2 + t * t)
        return self.radius * t / root, self.radius * squeeze * t * t / (root * (root + squeeze))

    def error(self, slope: ArrayLike) -> FloatArray:
        """Return the height error of a path that was made for a circle of this radius.

        Parameters
        ----------
        slope : array_like
            dz/drho of a plane, finite.

        Returns
        -------
        ndarray, m
            Actual - nominal along z; <= 0, the projected nose is wider and cuts deeper there.

        Raises
        ------
        InvalidSamplesError
            If a slope is not finite.

        Notes
        -----
        ``(b - sqrt(b^2 + a^2 t^2)) - (R - R sqrt(1 + t^2))`` with a = R, b = R kz, for a plane
        of slope t that does not rise along the cut; `rake_error` follows any surface.

        Examples
        --------
        >>> import math
        >>> round(RoundNose(1e-3, rake=math.radians(-30)).error(0.0031416).item() * 1e9, 2)
        -0.76
        """
        t = finite_positions(slope, "slope")
        squeeze = self.tilt[0]
        of_ellipse = -t * t / (squeeze + np.sqrt(squeeze**2 + t * t))
        of_circle = -t * t / (1.0 + np.sqrt(1.0 + t * t))
        return self.radius * (of_ellipse - of_circle)


def rake_error(
    form: Form, x: ArrayLike, y: ArrayLike = 0.0, *, nose: RoundNose, sense: Sense | None = None
) -> FloatArray:
    """Return the error of a path made without rake and cut with it, turns infinitely close.

    Parameters
    ----------
    form : Form
        The nominal surface, with the spindle axis at its origin.
    x, y : array_like, m
        Positions that broadcast.
    nose : RoundNose
        Radius and rake; the path was made for the same radius without rake.
    sense : {"counterclockwise", "clockwise"}, optional
        How the tool goes round the part, seen from above; needed where both differ.

    Returns
    -------
    ndarray, m
        Actual - nominal along z; either sign where the surface rises along the cut.

    Raises
    ------
    DataError
        If the form or the nose is none, the form has unknown parameters, it is not defined at a
        point, or the sense is needed.
    InvalidSamplesError
        If a position is not a finite number, or the positions do not broadcast.
    UnitError
        If a position cannot be in metres.
    NotConvergedError
        If the nose, with or without rake, does not fit the curvature of the surface.

    Notes
    -----
    A tip of the path stands at ``X = r - R sin(psi)`` and azimuth a for a contact ``(r, a)`` with
    ``tan(psi) = sX``. Its height changes with X by ``sX``, with the azimuth by ``r sY``. The tilted
    edge leaves its mark where it is tangential to the motion, ``tan(psi') = sX / (cos(rake) +
    sigma zy sin(rake))`` with ``zy = (y sX + r sY) / (X + x)``, at ``hypot(X + x, y)`` and
    ``a + atan2(y, X + x)``. Newton's method finds the contact that left its mark at each position.
    A disc about the axis, as wide as the edge leaves the plane there, is not cut by one place of the
    edge; it has the value at ten times its radius.

    Examples
    --------
    >>> import math
    >>> from metrosep.forms import SineGrid
    >>> grid = SineGrid(amplitude=50e-9, wavelength=100e-6)
    >>> round(rake_error(grid, 0.0, nose=RoundNose(1e-3, math.radians(-30))).item() * 1e9, 2)
    -0.76
    """
    form = known_form(form)
    checked_nose(nose)
    xs, ys = positions(x, y)
    at = xs.ravel(), ys.ravel()
    if sense is not None or nose.rake == 0.0:
        found = _raked(form, *at, nose, signed_sense(sense))
    else:
        found = _raked(form, *at, nose, 1.0)
        other = float(np.abs(found - _raked(form, *at, nose, -1.0)).max(initial=0.0))
        if other > _SENSES_AGREE:
            raise DataError(
                f"the error of the rake depends on the way of the tool, by up to {format_length(other)} "
                'here: give sense="counterclockwise" or sense="clockwise" (how the tool goes round '
                "the part, seen from above)"
            )
    shaped: FloatArray = found.reshape(xs.shape)
    return shaped


def signed_sense(sense: str | None, why: str = "") -> float:
    """Return +1 for counterclockwise, -1 for clockwise; DataError if it is none and that matters."""
    if sense is None and why:
        raise DataError(
            f"{why} cuts differently both ways: give "
            'sense="counterclockwise" or sense="clockwise" (how the tool goes round the part, seen '
            "from above)"
        )
    if sense is not None:
        numbers.choice(sense, "sense", get_args(Sense))
    return -1.0 if sense == "clockwise" else 1.0


def _ends_of(window: Any) -> tuple[float, float]:
    """Return where the sharp part of a nose begins and ends."""
    if len(window) != 2:
        raise DataError(f"window is one angle, or where it begins and ends; got {window!r}")
    low, high = (_angle(v, "an end of the window", 0.5 * math.pi, signed=True) for v in window)
    return low, high


def checked_nose(nose: object) -> None:
    """Refuse what is not a nose."""
    if not isinstance(nose, RoundNose):
        raise DataError(f"the nose must be a RoundNose, got {type(nose).__name__}")


def smallest_length(form: Form) -> float:
    """Return the smallest lateral length that a form knows of itself, m; inf where it knows none."""
    surface = getattr(form, "surface", None)  # of a form made of a map
    steps = [] if surface is None else [surface.dx, surface.dy]
    return min([*(form.period or ()), *steps], default=math.inf)


def _raked(form: Form, x: FloatArray, y: FloatArray, nose: RoundNose, sign: float) -> FloatArray:
    """Return the error at flat arrays of positions for one sense."""
    rho, theta = np.hypot(x, y), np.arctan2(y, x)
    squeeze, lean = nose.tilt
    lean, R = sign * lean, nose.radius
    slope, _ = polar_gradient(form, rho, theta)
    core = R * abs(lean) * (1.0 - 1.0 / np.hypot(1.0, slope / squeeze))
    rho = np.fmax(rho, 10.0 * core)
    offset = 1e-6 * R  # of the Jacobian, which only decides how fast the iteration ends

    def mark(r: FloatArray, a: FloatArray) -> tuple[FloatArray, ...]:
        height, s, across = polar_slopes(form, r, a)
        root = np.hypot(1.0, s)
        tip = r - R * s / root
        z = height - R * (1.0 - 1.0 / root)
        rise, psi, px, py, pz = across, s, s, s, s
        for _ in range(_TANGENT_STEPS):
            psi = np.arctan2(s, squeeze + lean * rise)
            up = 2.0 * R * np.sin(0.5 * psi) ** 2
            px, py, pz = tip + R * np.sin(psi), -lean * up, squeeze * up
            with np.errstate(divide="ignore", invalid="ignore"):
                rise = np.where(px == 0.0, across, (py * s + r * across) / px)
        turn = np.arctan(py / np.where(px == 0.0, math.inf, px))
        return np.copysign(np.hypot(px, py), px), a + turn, z + pz, tip

    r, a, reach = rho.copy(), theta.copy(), np.where(rho > 0.0, rho, offset)
    close = _CLOSE + 4e-16 * float(np.fmax.reduce(rho, initial=0.0))
    folded = np.zeros(rho.shape, dtype=bool)
    worst = 0.0
    for _ in range(_MOST_STEPS):
        here, out, on = mark(r, a), mark(r + offset, a), mark(r, a + offset / reach)
        miss = here[0] - rho, reach * (here[1] - theta)
        rr, ra = (out[0] - here[0]) / offset, (on[0] - here[0]) / offset
        ar, aa = (reach * (o[1] - here[1]) / offset for o in (out, on))
        det = rr * aa - ra * ar
        folded = (det <= 0.0) | (out[3] - here[3] <= 0.0)
        det = np.where(det == 0.0, 1.0, det)
        move = (aa * miss[0] - ra * miss[1]) / det, (rr * miss[1] - ar * miss[0]) / det
        r, a = r - move[0], a - move[1] / reach
        worst = float(np.fmax.reduce(np.hypot(*move), initial=0.0))
        if worst <= close:
            break
    if worst > close or folded.any():
        raise NotConvergedError(
            f"the nose, with a tip radius of {format_length(nose.tip_radius)}, does not fit the "
            f"curvature of the {form.name} along rho: points of the path leave no single mark; take a "
            "smaller nose, and see where it gouges with gouge_check"
        )
    e = mark(r, a)[2] - form.height(rho * np.cos(theta), rho * np.sin(theta))
    if nose.rake == 0.0:
        e = 0.0 * e  # one path: what is left is rounding
    bad = np.flatnonzero(np.isnan(e))
    if bad.size:
        raise DataError(
            f"the {form.name} is not defined at rho = {format_length(float(rho[bad[0]]))} or where "
            "the tool was commanded for it; leave the point out"
        )
    return np.asarray(e)


def _angle(value: object, name: str, limit: float, *, signed: bool) -> float:
    angle = numbers.quantity(value, name, "angle")
    if abs(angle) > math.pi:
        raise UnitError(
            f"{name} = {angle:g} rad is not such an angle: angles are in radians, so {angle:g} degrees "
            f"is {math.radians(angle):.4g}"
        )
    if abs(angle) >= limit or (not signed and angle <= 0.0):
        least = -math.degrees(limit) if signed else 0.0
        raise DataError(
            f"{name} must lie within {least:.4g} ... {math.degrees(limit):.4g} degrees, got "
            f"{math.degrees(angle):.4g}"
        )
    return angle
