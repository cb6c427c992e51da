"""The nose of a diamond tool: the ellipse that rake makes of it, and the error of ignoring it.

A round nose of radius R, tilted by the rake about its tip, shows an ellipse in the plane of spindle
axis and x: semi-axes ``R`` along x and ``R cos(rake)`` along z. Slopes are dz/drho at constant
azimuth in that plane; z points out of the material. Error = actual - nominal.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core.errors import DataError, InvalidSamplesError, UnitError
from metrosep.core.units import format_length
from metrosep.forms.base import Form
from metrosep.process._setting_checks import (
    LARGEST_NOSE,
    finite_positions,
    positions,
    real_number,
)
from metrosep.process._setting_model import commanded_radius, known_form, polar_slopes

__all__ = ["RoundNose", "rake_error"]

FloatArray = NDArray[np.float64]

_STEEPEST_RAKE = math.radians(85.0)


@dataclass(frozen=True, slots=True)
class RoundNose:
    """A round nose with rake, and the slopes and clearances it stands.

    Parameters
    ----------
    radius : float, m
        Of the edge in its own plane, > 0.
    rake : float, rad, optional
        Either sign does the same to the shape; less than 85 degrees.
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
        radius = _number(self.radius, "radius")
        if radius <= 0.0:
            raise DataError(f"the nose radius must be > 0, got {radius} m")
        if radius >= LARGEST_NOSE:
            raise UnitError(
                f"the nose radius is {radius:g} m: it is in metres, so {radius:g} mm is "
                f"{radius * 1e-3:g}"
            )
        object.__setattr__(self, "radius", radius)
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
            Actual - nominal along z; <= 0, the projected nose is wider and cuts deeper.

        Raises
        ------
        InvalidSamplesError
            If a slope is not finite.

        Notes
        -----
        ``(b - sqrt(b^2 + a^2 t^2)) - (R - R sqrt(1 + t^2))`` with a = R, b = R cos(rake), exact for
        a plane of slope t; `rake_error` follows a curved surface.

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


def rake_error(form: Form, x: ArrayLike, y: ArrayLike = 0.0, *, nose: RoundNose) -> FloatArray:
    """Return the error of a path made for a circle and cut with the projected ellipse.

    Parameters
    ----------
    form : Form
        The nominal surface, with the spindle axis at its origin.
    x, y : array_like, m
        Positions that broadcast.
    nose : RoundNose
        Radius and rake.

    Returns
    -------
    ndarray, m
        Actual - nominal along z.

    Raises
    ------
    DataError
        If the form or the nose is none, the form has unknown parameters, or it is not defined at a
        point.
    InvalidSamplesError
        If a position is no finite number, or the positions do not broadcast.
    UnitError
        If a position cannot be in metres.
    NotConvergedError
        If the contact moves by more than the curvature allows.

    Notes
    -----
    As `ToolSetting.error` with ``dR = nose.dR`` for small slopes; exact for steep ones too.

    Examples
    --------
    >>> import math
    >>> from metrosep.forms import SineGrid
    >>> grid = SineGrid(amplitude=50e-9, wavelength=100e-6)
    >>> round(rake_error(grid, 0.0, nose=RoundNose(1e-3, math.radians(-30))).item() * 1e9, 2)
    -0.76
    """
    form = known_form(form)
    if not isinstance(nose, RoundNose):
        raise DataError(f"the nose must be a RoundNose, got {type(nose).__name__}")
    xs, ys = positions(x, y)
    rho, theta = np.hypot(xs, ys).ravel(), np.arctan2(ys, xs).ravel()

    def offset(t: FloatArray) -> tuple[FloatArray, FloatArray]:
        inside = np.where(np.isnan(t), 0.0, t)
        real, made = nose.contact(inside), RoundNose(nose.radius).contact(inside)
        gap = 0.0 * t
        return real[0] - made[0] + gap, real[1] - made[1] + gap

    cause = f"a rake of {math.degrees(nose.rake):.4g} degrees"
    r = commanded_radius(form, rho, theta, lambda t: offset(t)[0], cause)
    height, slope, _ = polar_slopes(form, r, theta)
    along, up = offset(slope)
    cut = height + up + slope * (rho - along - r)
    e = cut - form.height(xs.ravel(), ys.ravel())
    bad = np.flatnonzero(np.isnan(e))
    if bad.size:
        raise DataError(
            f"the {form.name} is not defined at rho = {format_length(float(rho[bad[0]]))} or where "
            "the tool was commanded for it; leave the point out"
        )
    shaped: FloatArray = e.reshape(xs.shape)
    return shaped


def _number(value: object, name: str) -> float:
    try:
        number = real_number(value)
    except (TypeError, ValueError):
        raise DataError(f"{name} must be a number, got {value!r}") from None
    if not math.isfinite(number):
        raise InvalidSamplesError(f"{name} must be finite, got {number}")
    return number


def _angle(value: object, name: str, limit: float, *, signed: bool) -> float:
    angle = _number(value, name)
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
