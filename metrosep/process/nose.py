"""The nose of a diamond tool: the ellipse that rake makes of it, and the error of ignoring it.

A round nose of radius R, tilted by the rake about its tip, shows an ellipse in the plane of spindle
axis and x: semi-axes ``R`` along x and ``R cos(rake)`` along z. The edge itself leaves that plane by
``w sin(rake)`` where it has risen by w up the rake face. Slopes are dz/drho at constant azimuth; z
points out of the material. Error = actual - nominal.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, NotConvergedError, UnitError
from metrosep.core.units import format_length
from metrosep.forms.base import Form
from metrosep.process._plain import finite_positions, length
from metrosep.process._setting_equations import known_form, polar_slopes
from metrosep.process.setting_maps import LARGEST_NOSE, positions

__all__ = ["RoundNose", "rake_error"]


Sense = Literal["counterclockwise", "clockwise"]

_STEEPEST_RAKE = math.radians(85.0)
_SENSES_AGREE = 1e-12
"""m: errors of both senses that are nearer than that are one."""
_MOST_STEPS, _TANGENT_STEPS = 40, 8
_CLOSE = 1e-13
"""m: of a position; the error changes by 1e-3 of it at most, which is 1e-7 nm."""


@dataclass(frozen=True, slots=True)
class RoundNose:
    """A round nose with rake, and the slopes and clearances it stands.

    Parameters
    ----------
    radius : float, m
        Of the edge in its own plane, > 0.
    rake : float, rad, optional
        Of the face in which the radius is measured, positive leaning back; less than 85 degrees.
        Its sign matters where the surface rises along the cut.
    clearance : float, rad, optional
        Effective angle between flank and cut surface, > 0; needed by `clearance_check`.
    window : float, rad, optional
        Angle of the nose that is sharp, symmetric about the tip; needed by `window_check`.

    Raises
    ------
    DataError
        If a value is no finite number or out of range.
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
    window: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "radius", length(self.radius, "the nose radius", LARGEST_NOSE))
        rake = _angle(self.rake, "rake", _STEEPEST_RAKE, signed=True)
        object.__setattr__(self, "rake", rake)
        for name, limit in (("clearance", 0.5 * math.pi), ("window", math.pi)):
            if getattr(self, name) is not None:
                value = _angle(getattr(self, name), name, limit, signed=False)
                object.__setattr__(self, name, value)

    @property
    def tip_radius(self) -> float:
        """Radius of curvature of the projected edge at its tip, m."""
        return self.radius / math.cos(self.rake)

    @property
    def dR(self) -> float:  # noqa: N802
        """What rake adds to the radius of a path made without it, m; to the second order."""
        return self.radius * (1.0 / math.cos(self.rake) - 1.0)

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
        squeeze = math.cos(self.rake)
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
        ``(b - sqrt(b^2 + a^2 t^2)) - (R - R sqrt(1 + t^2))`` with a = R, b = R cos(rake), for a plane
        of slope t that does not rise along the cut; `rake_error` follows any surface.

        Examples
        --------
        >>> import math
        >>> round(RoundNose(1e-3, rake=math.radians(-30)).error(0.0031416).item() * 1e9, 2)
        -0.76
        """
        t = finite_positions(slope, "slope")
        squeeze = math.cos(self.rake)
        of_ellipse = -t * t / (squeeze + np.sqrt(squeeze**2 + t * t))
        of_circle = -t * t / (1.0 + np.sqrt(1.0 + t * t))
        return self.radius * (of_ellipse - of_circle)


def rake_error(
    form: Form,
    x: ArrayLike,
    y: ArrayLike = 0.0,
    *,
    nose: RoundNose,
    sense: Sense | None = None,
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
        If a position is no finite number, or the positions do not broadcast.
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
        found = _raked(form, *at, nose, signed_sense(sense, nose.rake))
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


def signed_sense(sense: str | None, rake: float) -> float:
    """Return +1 for counterclockwise, -1 for clockwise; DataError if rake needs it and it is none."""
    if sense is None and rake != 0.0:
        raise DataError(
            f"a nose with a rake of {math.degrees(rake):.4g} degrees cuts differently both ways: give "
            'sense="counterclockwise" or sense="clockwise" (how the tool goes round the part, seen '
            "from above)"
        )
    if sense is not None:
        numbers.choice(sense, "sense", ("counterclockwise", "clockwise"))
    return -1.0 if sense == "clockwise" else 1.0


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
    lean, squeeze, R = sign * math.sin(nose.rake), math.cos(nose.rake), nose.radius
    _, slope, _ = polar_slopes(form, rho, theta)
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
            f"{name} = {angle:g} rad is no such angle: angles are in radians, so {angle:g} degrees "
            f"is {math.radians(angle):.4g}"
        )
    if abs(angle) >= limit or (not signed and angle <= 0.0):
        least = -math.degrees(limit) if signed else 0.0
        raise DataError(
            f"{name} must lie within {least:.4g} ... {math.degrees(limit):.4g} degrees, got "
            f"{math.degrees(angle):.4g}"
        )
    return angle
