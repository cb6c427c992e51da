"""Whether a nose fits a surface: hollows along rho, descent along the cut, the sharp window.

Slopes are dz/drho at constant azimuth, and (1/rho) dz/dtheta along the cut; z points out of the
material. Each check says where it is worst, whether or not it fails.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from metrosep.core.errors import DataError, LimitError
from metrosep.core.provenance import freeze_mapping
from metrosep.core.units import format_length
from metrosep.forms.base import Form
from metrosep.process._setting_checks import map_extent
from metrosep.process._setting_model import known_form, polar_slopes
from metrosep.process.nose import RoundNose
from metrosep.process.setting_maps import polar_axes

__all__ = ["NoseCheck", "clearance_check", "gouge_check", "window_check"]

FloatArray = NDArray[np.float64]
Travel = Literal["growing", "falling", "both"]


@dataclass(frozen=True, slots=True)
class NoseCheck:
    """Whether a nose fits a surface, and where it fits worst.

    Parameters
    ----------
    ok : bool
        Whether it fits everywhere on the mesh.
    worst, limit : float
        The value at the worst place and what is allowed; m for curvature, rad for angles.
    unit : str
        Of both.
    rho, theta : float
        Worst place on the workpiece, m and rad.
    n_bad : int
        Points of the mesh that do not fit.
    messages : tuple of str
        In plain words.
    audit : mapping
        Mesh and nose.

    Examples
    --------
    >>> from metrosep.forms import Sphere
    >>> gouge_check(Sphere(R=0.5e-3), RoundNose(1e-3), radius=0.2e-3).ok
    False
    """

    ok: bool
    worst: float
    limit: float
    unit: str
    rho: float
    theta: float
    n_bad: int
    messages: tuple[str, ...] = ()
    audit: Mapping[str, Any] = field(default_factory=dict)

    def require(self) -> None:
        """Raise the first message as an error unless the nose fits.

        Raises
        ------
        LimitError
            If it does not.
        """
        if not self.ok:
            raise LimitError(self.messages[0])


def gouge_check(
    form: Form,
    nose: RoundNose,
    *,
    radius: float | None = None,
    region: tuple[float, float] | None = None,
    n_rho: int = 401,
    n_theta: int = 360,
) -> NoseCheck:
    """Return whether the nose fits into every hollow of the surface along rho.

    Parameters
    ----------
    form : Form
        The nominal surface, with the spindle axis at its origin.
    nose : RoundNose
        Radius and rake.
    radius : float, m, optional
        Of the workpiece; 500 um with a message if neither it nor a region is given.
    region : tuple of (float, float), m, optional
        Inner and outer radius instead.
    n_rho, n_theta : int, optional
        Of the mesh that is searched.

    Returns
    -------
    NoseCheck
        ``worst`` is the smallest concave radius of curvature (infinite without hollows), ``limit``
        the tip radius of the projected nose.

    Raises
    ------
    DataError
        If the form or the region is not usable, or nothing is defined.
    TooFewSamplesError
        If the mesh has too few points.
    UnitError
        If the radius cannot be in metres.

    Notes
    -----
    Curvature is ``z_rr / (1 + z_r^2)^(3/2)``, z_rr from a central difference of the slopes. Where
    it is below that of the nose everywhere, the nose touches nowhere else, however far: the slope
    of the nose outruns that of the surface on both sides of the contact. The tip is the flattest
    place of the ellipse, so this is safe for steep slopes. Between the points of the mesh nothing
    is seen; NaN (off the surface) is left out with a message.

    Examples
    --------
    >>> from metrosep.forms import SineGrid
    >>> grid = SineGrid(amplitude=50e-9, wavelength=100e-6)
    >>> round(gouge_check(grid, RoundNose(1e-3), radius=500e-6).worst * 1e3, 2)
    5.07
    """
    form, rho, theta, said, audit = _mesh(form, nose, radius, region, n_rho, n_theta)
    h = 1e-5 * float(rho.max())
    _, slope, _ = polar_slopes(form, rho, theta)
    after, before = (polar_slopes(form, rho + s * h, theta)[1] for s in (1.0, -1.0))
    curvature = (after - before) / (2.0 * h) / (1.0 + slope * slope) ** 1.5
    known, said = _defined(curvature, rho, form, said)
    at = int(np.nanargmax(np.where(known, curvature, np.nan)))
    hollow = max(float(curvature[at]), 0.0)
    worst = 1.0 / hollow if hollow > 0.0 else math.inf
    bad = int(np.count_nonzero(curvature[known] * nose.tip_radius >= 1.0))
    if bad:
        said = (
            (
                f"the nose gouges: its tip radius {format_length(nose.tip_radius)} is larger than the "
                f"concave radius {format_length(worst)} of the {form.name} at {_place(rho[at], theta[at])} "
                f"({bad} points of the mesh); take a smaller nose"
            ),
            *said,
        )
    return NoseCheck(
        not bad, worst, nose.tip_radius, "m", float(rho[at]), float(theta[at]), bad, said, audit
    )


def clearance_check(
    form: Form,
    nose: RoundNose,
    *,
    travel: Travel = "both",
    radius: float | None = None,
    region: tuple[float, float] | None = None,
    n_rho: int = 401,
    n_theta: int = 360,
) -> NoseCheck:
    """Return whether the flank clears the surface where the tool goes down along the cut.

    Parameters
    ----------
    form : Form
        The nominal surface, with the spindle axis at its origin.
    nose : RoundNose
        With its clearance angle.
    travel : {"growing", "falling", "both"}, optional
        Whether the tool runs towards growing or falling azimuth of the workpiece.
    radius : float, m, optional
        Of the workpiece; 500 um with a message if neither it nor a region is given.
    region : tuple of (float, float), m, optional
        Inner and outer radius instead.
    n_rho, n_theta : int, optional
        Of the mesh that is searched.

    Returns
    -------
    NoseCheck
        ``worst`` is the steepest descent along the cut and ``limit`` the clearance angle, rad.

    Raises
    ------
    DataError
        If the nose has no clearance angle, the direction is unknown, the form or the region is not
        usable, or nothing is defined.
    TooFewSamplesError
        If the mesh has too few points.
    UnitError
        If the radius cannot be in metres.

    Notes
    -----
    Descent is ``-(1/rho) dz/dtheta`` towards growing azimuth. The flank lies behind the edge, over
    what was just cut, so it rubs where the surface falls more steeply than it.

    Examples
    --------
    >>> import math
    >>> from metrosep.forms import SineGrid
    >>> nose = RoundNose(1e-3, clearance=math.radians(10))
    >>> clearance_check(SineGrid(amplitude=50e-9, wavelength=100e-6), nose, radius=500e-6).ok
    True
    """
    _check_nose(nose)
    if nose.clearance is None:
        raise DataError("the nose has no clearance angle: give RoundNose(..., clearance=...)")
    if travel not in ("growing", "falling", "both"):
        raise DataError(f'travel must be "growing", "falling" or "both", got {travel!r}')
    form, rho, theta, said, audit = _mesh(form, nose, radius, region, n_rho, n_theta)
    _, _, along = polar_slopes(form, rho, theta)
    if travel == "both":
        descent = np.abs(along)
    else:
        descent = -along if travel == "growing" else along
    known, said = _defined(descent, rho, form, said)
    return _steepest(
        np.arctan(descent), known, rho, theta, nose.clearance, said, {**audit, "travel": travel},
        f"the flank rubs on the {form.name}: it falls along the cut by", "its clearance",
    )  # fmt: skip


def window_check(
    form: Form,
    nose: RoundNose,
    *,
    radius: float | None = None,
    region: tuple[float, float] | None = None,
    n_rho: int = 401,
    n_theta: int = 360,
) -> NoseCheck:
    """Return whether the surface touches the nose only where it is sharp.

    Parameters
    ----------
    form : Form
        The nominal surface, with the spindle axis at its origin.
    nose : RoundNose
        With its window.
    radius : float, m, optional
        Of the workpiece; 500 um with a message if neither it nor a region is given.
    region : tuple of (float, float), m, optional
        Inner and outer radius instead.
    n_rho, n_theta : int, optional
        Of the mesh that is searched.

    Returns
    -------
    NoseCheck
        ``worst`` is the steepest slope along rho and ``limit`` half the window, rad.

    Raises
    ------
    DataError
        If the nose has no window, the form or the region is not usable, or nothing is defined.
    TooFewSamplesError
        If the mesh has too few points.
    UnitError
        If the radius cannot be in metres.

    Examples
    --------
    >>> import math
    >>> from metrosep.forms import Sphere
    >>> nose = RoundNose(0.2e-3, window=math.radians(60))
    >>> window_check(Sphere(R=5e-3), nose, radius=3e-3).ok
    False
    """
    _check_nose(nose)
    if nose.window is None:
        raise DataError("the nose has no window: give RoundNose(..., window=...)")
    form, rho, theta, said, audit = _mesh(form, nose, radius, region, n_rho, n_theta)
    _, slope, _ = polar_slopes(form, rho, theta)
    known, said = _defined(slope, rho, form, said)
    return _steepest(
        np.arctan(np.abs(slope)), known, rho, theta, 0.5 * nose.window, said, audit,
        f"the {form.name} touches the nose beyond its window: its slope along rho is",
        "half the window",
    )  # fmt: skip


def _steepest(
    angle: FloatArray,
    known: NDArray[np.bool_],
    rho: FloatArray,
    theta: FloatArray,
    limit: float,
    said: tuple[str, ...],
    audit: Mapping[str, Any],
    what: str,
    against: str,
) -> NoseCheck:
    at = int(np.nanargmax(np.where(known, angle, np.nan)))
    worst = float(angle[at])
    bad = int(np.count_nonzero(angle[known] >= limit))
    if bad:
        said = (
            (
                f"{what} {math.degrees(worst):.4g} degrees at {_place(rho[at], theta[at])}, "
                f"{against} is {math.degrees(limit):.4g} degrees ({bad} points of the mesh)"
            ),
            *said,
        )
    return NoseCheck(
        not bad, worst, limit, "rad", float(rho[at]), float(theta[at]), bad, said, audit
    )


def _check_nose(nose: object) -> None:
    if not isinstance(nose, RoundNose):
        raise DataError(f"the nose must be a RoundNose, got {type(nose).__name__}")


def _mesh(
    form: Form,
    nose: RoundNose,
    radius: float | None,
    region: tuple[float, float] | None,
    n_rho: int,
    n_theta: int,
) -> tuple[Form, FloatArray, FloatArray, tuple[str, ...], Mapping[str, Any]]:
    form = known_form(form)
    _check_nose(nose)
    inner, outer, said = map_extent(radius, region)
    rho, theta = polar_axes((inner, outer), n_rho, n_theta)
    audit = {
        "form": repr(form),
        "nose_radius_mm": nose.radius * 1e3,
        "rake_deg": math.degrees(nose.rake),
        "inner_um": inner * 1e6,
        "outer_um": outer * 1e6,
        "n_rho": n_rho,
        "n_theta": n_theta,
    }
    return form, rho.ravel(), theta.ravel(), said, freeze_mapping(audit)


def _defined(
    values: FloatArray, rho: FloatArray, form: Form, said: tuple[str, ...]
) -> tuple[NDArray[np.bool_], tuple[str, ...]]:
    known = np.isfinite(values)
    if not known.any():
        raise DataError(f"the {form.name} is not defined anywhere on the region")
    if not known.all():
        first = format_length(float(rho[~known][0]))
        said = (
            *said,
            (
                f"{int(np.count_nonzero(~known))} points are not judged because the {form.name} is not "
                f"defined there, the first at rho = {first}"
            ),
        )
    return known, said


def _place(rho: float, theta: float) -> str:
    return f"rho = {format_length(float(rho))}, azimuth {math.degrees(theta):.4g} degrees"
