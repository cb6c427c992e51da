"""`ToolSetting`: how far the tool of a turning machine stands from where the programme thinks it is.

dx, dy and dR are actual - nominal, SI. Frame: z out of the material, the edge in the plane of the
spindle axis and x, theta the azimuth on the *workpiece*. A tool with dx > 0 stands further from
the spindle axis, with dy > 0 towards growing workpiece azimuth; dR > 0 is a nose radius larger than
programmed. Error = actual - nominal along z. After Deterministic error compensation for slow tool
servo-driven diamond turning, Eq. (12)-(20), made exact.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.docs import described_by
from metrosep.core.errors import DataError, DegenerateFitError, InvalidSamplesError
from metrosep.core.profile import Profile
from metrosep.core.public import PublicObject
from metrosep.core.quantity import Quantity
from metrosep.core.surface import Surface
from metrosep.core.units import format_length
from metrosep.forms.base import Form
from metrosep.forms.points import PointSet, points_of
from metrosep.process._plain import Frozen, frozen, not_above, optional_length
from metrosep.process._setting_equations import (
    FACTORS,
    FREEDOMS,
    Factor,
    exact_cut,
    height_errors,
    known_form,
    modelled,
    solve,
)
from metrosep.process._setting_steps import (
    Settled,
    Task,
    correlation,
    covariance,
    settle_in_period,
)
from metrosep.process._setting_words import (
    correlated_pairs,
    effect_of_dy,
    said_of_dy,
    warnings_of_fit,
    with_held_dy,
)
from metrosep.process.setting_maps import (
    LARGEST_NOSE,
    LARGEST_SETTING,
    Mesh,
    SettingError,
    checked_covariance,
    checked_region,
    checked_uncertainty,
    map_extent,
    polar_axes,
    positions,
    setting_tolerance,
    square_axes,
)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ToolSetting(PublicObject):
    """Errors of the tool's position and nose radius, with their uncertainty.

    Parameters
    ----------
    dx : float, m, optional
        Tool further from the spindle axis than programmed; at most 1 mm.
    dy : float, m, optional
        Tool off the spindle axis towards growing workpiece azimuth; at most 1 mm.
    dR : float, m, optional
        Nose radius larger than programmed, tip height right; at most 10 mm.
    u_dx, u_dy, u_dR : float or None, m, optional
        Standard uncertainties; None where not known, infinite where not determined.
    cov : array_like, shape (3, 3), m^2, optional
        Covariance of (dx, dy, dR), which replaces the three uncertainties.
    fit : SettingFit, optional
        Where the setting was identified from.

    Raises
    ------
    DataError
        If a value is not a finite number, an uncertainty is negative or NaN, or the covariance is not
        symmetric and positive.
    UnitError
        If a value is so large that it cannot be in metres.
    InvalidSamplesError
        If the covariance has another shape.

    Notes
    -----
    Near the spindle axis a tool with dy leaves a core of radius ``|dy|`` uncut.

    References
    ----------
    .. [1] Deterministic error compensation for slow tool servo-driven diamond turning,
       Eq. (12)-(20).

    Examples
    --------
    >>> ToolSetting(dx=-3.5e-6, dR=100e-6, u_dx=2e-9)
    ToolSetting(dx=-3.5 um (u 2 nm), dy=0 m, dR=100 um)
    """

    dx: float = 0.0
    dy: float = 0.0
    dR: float = 0.0
    u_dx: float | None = None
    u_dy: float | None = None
    u_dR: float | None = None
    cov: FloatArray | None = None
    fit: SettingFit | None = None

    def __post_init__(self) -> None:
        for name in FACTORS:
            size = numbers.quantity(getattr(self, name), name, "length")
            object.__setattr__(self, name, not_above(size, name, LARGEST_SETTING[name]))
            value = getattr(self, f"u_{name}")
            object.__setattr__(self, f"u_{name}", checked_uncertainty(value, f"u_{name}"))
        if self.cov is not None:
            cov = checked_covariance(self.cov)
            object.__setattr__(self, "cov", cov)
            for i, name in enumerate(FACTORS):
                object.__setattr__(self, f"u_{name}", math.sqrt(float(cov[i, i])))

    @property
    def values(self) -> FloatArray:
        """The setting (dx, dy, dR) as an array, m."""
        return np.array([self.dx, self.dy, self.dR])

    @property
    def covariance(self) -> FloatArray | None:
        """Covariance of (dx, dy, dR), m^2; None unless the u of all that are not zero are known."""
        if self.cov is not None:
            return self.cov
        u = [getattr(self, f"u_{n}") for n in FACTORS]
        absent = [v is None and getattr(self, n) == 0.0 for n, v in zip(FACTORS, u, strict=True)]
        if all(absent) or any(v is None and not a for v, a in zip(u, absent, strict=True)):
            return None
        return np.diag(np.square([0.0 if v is None else v for v in u]))

    @property
    def messages(self) -> tuple[str, ...]:
        """What the identification could not tell; empty for a setting given by hand."""
        return () if self.fit is None else self.fit.messages

    def only(self, *factors: Factor) -> ToolSetting:
        """Return the setting with all other factors zero.

        Parameters
        ----------
        *factors : {"dx", "dy", "dR"}
            What stays.

        Returns
        -------
        ToolSetting
            Without the identification it came from.

        Raises
        ------
        DataError
            If a name is none of the three.

        Examples
        --------
        >>> ToolSetting(dx=1e-6, dy=2e-6).only("dy")
        ToolSetting(dx=0 m, dy=2 um, dR=0 m)
        """
        for name in factors:
            numbers.choice(name, "a factor of the setting", FACTORS)
        kept = {n: getattr(self, n) for n in factors}
        return ToolSetting(**kept, **{f"u_{n}": getattr(self, f"u_{n}") for n in factors})

    def error(
        self,
        form: Form,
        x: ArrayLike,
        y: ArrayLike = 0.0,
        *,
        exact: bool = True,
        factor: Factor | None = None,
    ) -> FloatArray:
        """Return actual - nominal height at points of the workpiece.

        Parameters
        ----------
        form : Form
            The nominal surface, with the spindle axis at its origin.
        x, y : array_like, m
            Positions that broadcast.
        exact : bool, optional
            Whether the exact model is taken; otherwise the sum of Eq. (12), (17) and (20).
        factor : {"dx", "dy", "dR"}, optional
            The error of this factor alone; of all three together if omitted.

        Returns
        -------
        ndarray, m
            In the shape of the points.

        Raises
        ------
        DataError
            If the form is none or has unknown parameters, the factor is unknown, or the surface is
            not defined at a point.
        InvalidSamplesError
            If a position is not a finite number, the positions do not broadcast, or one lies in the
            uncut core ``rho < |dy|``.
        UnitError
            If a position is so large that it cannot be in metres.
        NotConvergedError
            If dR exceeds what the curvature of the surface allows.

        Notes
        -----
        Exact: ``z_act(rho, theta) = S(r, theta_c) + dR (1 - cos phi)`` with
        ``theta_c = theta - asin(dy / rho)`` and
        ``r + dR sin(phi) = sqrt(rho^2 - dy^2) - dx``, ``tan(phi) = dS/dr``.

        References
        ----------
        .. [1] Deterministic error compensation for slow tool servo-driven diamond turning,
           Eq. (12)-(20).

        Examples
        --------
        >>> from metrosep.forms import SineGrid
        >>> grid = SineGrid(amplitude=50e-9, wavelength=100e-6)
        >>> round(ToolSetting(dx=1e-6).error(grid, 100e-6, exact=False).item() * 1e9, 4)
        -3.1416
        """
        form = known_form(form)
        xs, ys = positions(x, y)
        if factor is not None:
            return self.only(factor).error(form, x, y, exact=exact)
        e = self._errors(form, xs.ravel(), ys.ravel(), exact=exact)
        bad = np.flatnonzero(np.isnan(e))
        if bad.size:
            self._refuse(float(xs.ravel()[bad[0]]), float(ys.ravel()[bad[0]]), form)
        return e.reshape(xs.shape)

    @described_by(error, setting_tolerance, errors=False)
    def error_map(
        self,
        form: Form,
        *,
        radius: float | None = None,
        region: tuple[float, float] | None = None,
        mesh: Mesh = "polar",
        n_rho: int = 401,
        n_theta: int = 720,
        step: float | None = None,
        exact: bool = True,
        factor: Factor | None = None,
    ) -> SettingError:
        """Return the error over the whole workpiece.

        Parameters
        ----------
        mesh : {"polar", "square"}, optional
            Kind of mesh.
        n_rho, n_theta : int, optional
            Radii, both ends included, and azimuths of a polar mesh.
        step : float, m, optional
            Pixel of a square mesh; a 400th of the diameter if omitted.

        Returns
        -------
        SettingError
            With ``rho``, ``theta``, ``z``, and ``u`` if uncertainties are known. NaN in the core
            and where the surface is not defined, with a message.

        Raises
        ------
        DataError
            If the region or the mesh is not usable, or nothing is defined; else as of `error`.

        Examples
        --------
        >>> from metrosep.forms import SineGrid
        >>> grid = SineGrid(amplitude=50e-9, wavelength=100e-6)
        >>> tool = ToolSetting(dx=0.25e-6, dy=0.25e-6, dR=10e-6)
        >>> round(tool.error_map(grid, region=(5e-6, 500e-6)).peak_to_valley() * 1e9, 1)
        3.1
        """
        form = known_form(form)
        if factor is not None:
            options: Any = {"mesh": mesh, "n_rho": n_rho, "n_theta": n_theta, "step": step}
            alone = self.only(factor)
            return alone.error_map(form, radius=radius, region=region, exact=exact, **options)
        inner, outer, said = map_extent(radius, region)
        numbers.choice(mesh, "mesh", ("polar", "square"))
        if mesh == "polar":
            rho, theta = polar_axes((inner, outer), n_rho, n_theta)
            x, y = rho * np.cos(theta), rho * np.sin(theta)
            inside = np.ones(rho.shape, dtype=bool)
        else:
            x, y, _ = square_axes(outer, step)
            rho, theta = np.hypot(x, y), np.arctan2(y, x)
            inside = (rho <= outer * (1.0 + 1e-12)) & (rho >= inner * (1.0 - 1e-12))
        z = self._errors(form, x.ravel(), y.ravel(), exact=exact).reshape(x.shape)
        said += self._map_messages(rho, z, inside, form)
        z[~inside] = np.nan
        u = self._uncertainties(form, x, y, z)
        audit = {
            "form": repr(form),
            **{f"{n}_um": getattr(self, n) * 1e6 for n in FACTORS},
            "inner_um": inner * 1e6,
            "outer_um": outer * 1e6,
            "mesh": mesh,
            "model": "exact" if exact else "sum of Eq. (12), (17), (20)",
            "removed": "nothing",
        }
        at_points = partial(_errors_at, form, (self.dx, self.dy, self.dR), exact)
        return SettingError(rho, theta, z, mesh, u, tuple(said), audit, at_points)

    @classmethod
    def identify(
        cls,
        surface: Surface | Profile | PointSet,
        form: Form,
        *,
        free: Sequence[str] | None = None,
        nose_radius: float | None = None,
        centre: tuple[float, float] | None = None,
        region: tuple[float, float] | None = None,
        start: ToolSetting | None = None,
        noise: float | None = None,
    ) -> ToolSetting:
        """Return the setting that explains a measured map, with its uncertainty.

        Returns
        -------
        ToolSetting
            Its ``fit`` holds residual, covariance of all freedoms, groups and messages.

        Examples
        --------
        >>> import numpy as np
        >>> from metrosep import Surface
        >>> from metrosep.forms import SineGrid
        >>> grid = SineGrid(amplitude=50e-9, wavelength=100e-6)
        >>> x, y = np.meshgrid(*[4e-6 * np.arange(-50, 51)] * 2)
        >>> with np.errstate(invalid="ignore"):
        ...     error = ToolSetting(dx=-3e-6).error_map(grid, radius=200e-6, mesh="square", step=4e-6)
        >>> measured = Surface(grid(x, y) + error.z, 4e-6, 4e-6, origin=(-200e-6, -200e-6))
        >>> round(ToolSetting.identify(measured, grid).dx * 1e6, 6)
        -3.0
        """
        return identify_setting(
            surface,
            form,
            free=free,
            nose_radius=nose_radius,
            centre=centre,
            region=region,
            start=start,
            noise=noise,
        ).setting

    def _errors(self, form: Form, x: FloatArray, y: FloatArray, *, exact: bool) -> FloatArray:
        """Return the error at points of any shape; NaN in the core and off the form."""
        return _errors_at(form, (self.dx, self.dy, self.dR), exact, x, y)

    def _uncertainties(
        self, form: Form, x: FloatArray, y: FloatArray, z: FloatArray
    ) -> FloatArray | None:
        """Return u of the error, or None; a factor without any effect adds nothing."""
        cov = self.covariance
        if cov is None or not np.isfinite(cov).all():
            return None
        u = np.full(z.shape, np.nan)
        valid = ~np.isnan(z)
        rho, theta = np.hypot(x[valid], y[valid]), np.arctan2(y[valid], x[valid])
        cut = exact_cut(form, rho, theta, self.dx, self.dy, self.dR)
        effect = np.stack([cut.by_dx, cut.by_dy, cut.by_dR])
        with np.errstate(invalid="ignore"):
            variance = np.einsum("in,ij,jn->n", effect, cov, effect)
        finite = np.isfinite(variance)
        u[valid] = np.where(finite, np.sqrt(np.where(finite, np.maximum(variance, 0), 0)), np.nan)
        return u

    def _map_messages(
        self, rho: FloatArray, z: FloatArray, inside: NDArray[np.bool_], form: Form
    ) -> list[str]:
        said = []
        core = int(np.count_nonzero(inside & (rho < abs(self.dy))))
        if core:
            said.append(
                f"{core} points lie nearer to the spindle axis than |dy| = "
                f"{format_length(abs(self.dy))}: the tool never reaches them and leaves a core "
                "there; they are NaN"
            )
        undefined = inside & np.isnan(z) & (rho >= abs(self.dy))
        if undefined.any():
            said.append(
                f"{int(undefined.sum())} points are NaN because the nominal surface ({form.name}) "
                "is not defined there or where the tool was commanded, the first at rho = "
                f"{format_length(float(rho[undefined][0]))}"
            )
        if not (inside & ~np.isnan(z)).any():
            raise DataError(f"the {form.name} is not defined anywhere on the region: {said[0]}")
        near = math.hypot(self.dx, self.dy)
        crossed = int(np.count_nonzero(inside & (rho < near) & (rho >= abs(self.dy))))
        if crossed and self.dx > 0.0:
            said.append(
                f"{crossed} points within {format_length(near)} of the spindle axis are cut only "
                "if the path goes on past the centre by dx, which is assumed"
            )
        elif crossed:
            said.append(
                f"{crossed} points within {format_length(near)} of the spindle axis are passed "
                "twice, because the tool crosses the axis before the path ends; the second pass "
                "may cut deeper and is not in the model"
            )
        return said

    def _refuse(self, x: float, y: float, form: Form) -> None:
        rho = math.hypot(x, y)
        if rho < abs(self.dy):
            raise InvalidSamplesError(
                f"the point at rho = {format_length(rho)} lies in the uncut core of radius |dy| = "
                f"{format_length(abs(self.dy))}: no height exists there; leave it out"
            )
        raise DataError(
            f"the {form.name} is not defined at x = {format_length(x)}, y = {format_length(y)}, or "
            "where the tool was commanded for it; leave the point out"
        )

    def __repr__(self) -> str:
        parts = []
        for name in FACTORS:
            u = getattr(self, f"u_{name}")
            value = getattr(self, name)
            shown = "0 m" if value == 0.0 else format_length(value)
            if u is not None:
                shown += f" (u {format_length(u, digits=2) if math.isfinite(u) else 'infinite'})"
            parts.append(f"{name}={shown}")
        return f"ToolSetting({', '.join(parts)})"


def _errors_at(
    form: Form, setting: tuple[float, float, float], exact: bool, x: FloatArray, y: FloatArray
) -> FloatArray:
    """Return the error of a setting at points of any shape; NaN in the core and off the form."""
    return height_errors(form, x.ravel(), y.ravel(), setting, exact=exact).reshape(x.shape)


# ---- which setting explains a measured map: linear start, exact finish, uncertainty, messages ------
# The heights of the part as cut are compared with what the exact model cuts, moved by what the
# microscope does not know: piston, tilts, lateral shift and, if wanted, rotation. dx, dy and dR of the
# result are those of the tool, to be compensated.


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SettingFit(Frozen):
    """A tool setting found on a measured map, and how far to trust it.

    Parameters
    ----------
    setting : ToolSetting
        dx, dy, dR with their covariance; a factor that was not determined is 0 with infinite u.
    values, u : mapping of str to float
        All fitted freedoms and their standard uncertainties, SI.
    cov : ndarray, shape (n, n)
        Covariance of the freedoms, in the order of `values`.
    residual : Surface, Profile or PointSet
        Measured - modelled height; NaN where not used.
    rms : float, m
        Of the residual: what would remain were the setting compensated.
    n_used : int
        Points used.
    groups : tuple of (str, str, float)
        Pairs of fitted freedoms that are hardly distinguished (``|r| > 0.9``), with their correlation.
    held : mapping of str to tuple of str
        Freedoms that were wanted and are not determined, and what holds their effect.
    messages : tuple of str
        In plain words.
    audit : mapping
        Numbers with units in the keys.

    Examples
    --------
    >>> import numpy as np
    >>> from metrosep import Surface
    >>> from metrosep.forms import SineGrid
    >>> grid = SineGrid(amplitude=50e-9, wavelength=100e-6)
    >>> x, y = np.meshgrid(*[4e-6 * np.arange(-50, 51)] * 2)
    >>> fit = identify_setting(Surface(grid(x, y), 4e-6, 4e-6), grid)
    >>> abs(fit.setting.dx) < 1e-15
    True
    """

    setting: ToolSetting
    values: Mapping[str, float]
    u: Mapping[str, float]
    cov: FloatArray
    residual: Surface | Profile | PointSet
    rms: float
    n_used: int
    groups: tuple[tuple[str, str, float], ...] = ()
    held: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    messages: tuple[str, ...] = ()
    audit: Mapping[str, Any] = field(default_factory=dict)

    @property
    def quantities(self) -> dict[str, Quantity]:
        """Every fitted freedom with unit, definition and standard uncertainty."""
        return {
            name: Quantity(
                value, FREEDOMS[name], f"{_MEANING[name]}, fitted to a map", self.u[name], name
            )
            for name, value in self.values.items()
        }

    def report(self) -> str:
        """Return the result as text, one line for each freedom and message.

        Returns
        -------
        str
            For people.
        """
        lines = [f"{name:9s} {quantity}" for name, quantity in self.quantities.items()]
        lines.append(f"residual RMS {format_length(self.rms)} on {self.n_used} points")
        return "\n".join([*lines, *self.messages])

    def __repr__(self) -> str:
        return (
            f"SettingFit({self.setting!r}, residual RMS {format_length(self.rms)}, "
            f"{self.n_used} points)"
        )


_MEANING = {
    "piston": "height of the map",
    "tilt_x": "slope of the map along x",
    "tilt_y": "slope of the map along y",
    "dx": "tool further from the spindle axis than programmed",
    "dy": "tool off the spindle axis towards growing azimuth",
    "dR": "nose radius larger than programmed",
    "shift_x": "part further along x than the centre says",
    "shift_y": "part further along y than the centre says",
    "rotation": "part turned counter-clockwise",
}


def identify_setting(
    surface: Surface | Profile | PointSet,
    form: Form,
    *,
    free: Sequence[str] | None = None,
    nose_radius: float | None = None,
    centre: tuple[float, float] | None = None,
    region: tuple[float, float] | None = None,
    start: ToolSetting | None = None,
    noise: float | None = None,
) -> SettingFit:
    """Return the tool setting that explains measured heights, with all that was fitted.

    Parameters
    ----------
    surface : Surface, Profile or PointSet
        Heights of the part as cut, form included; NaN = not measured. A profile is the line y = 0.
    form : Form
        The nominal surface, all parameters known, with the spindle axis at its origin.
    free : sequence of str, optional
        Of ``dx dy dR piston tilt_x tilt_y shift_x shift_y rotation``. If omitted all but the
        rotation; on a profile without tilt_y and the shifts.
    nose_radius : float, m, optional
        Programmed nose radius, > 0; a dR that would leave no nose is then refused.
    centre : tuple of (float, float), m, optional
        Spindle axis in the coordinates of the map. If omitted (0, 0), or the middle of what was
        measured on a map whose origin was not declared.
    region : tuple of (float, float), m, optional
        Inner and outer radius of what is used.
    start : ToolSetting, optional
        Where to start; zero, and so the linear solution, if omitted. What is not fitted stays
        there; its u_dy then goes into the uncertainty of dx.
    noise : float, m, optional
        Standard deviation of one height, > 0; from the residual if omitted.

    Returns
    -------
    SettingFit
        Setting, residual, covariance, groups and messages.

    Raises
    ------
    DataError
        If the form, a freedom, the centre, the region, the nose radius or the noise is not usable.
    TooFewSamplesError
        If fewer points than freedoms remain.
    DegenerateFitError
        If neither dx, dy nor dR leaves a trace, or dR would leave no nose.
    NotConvergedError
        If the iteration does not settle.
    UnitError
        If the nose radius, the noise or the region cannot be in metres.

    Notes
    -----
    Least squares over the valid points, Gauss-Newton with analytic derivatives, damped where the
    valley is curved, until no freedom moves by more than 1e-3 of its uncertainty; the first step
    from zero is the linear solution. Points within 3 hypot(dx, dy) of the axis are omitted. The correlation of the residual along x and y raises the uncertainty; on scattered
    points it is only said. A freedom that the points do not determine is given up, shifts and
    rotation first: on a one-sided profile a shift looks exactly like dx. NaN is omitted.

    References
    ----------
    .. [1] Deterministic error compensation for slow tool servo-driven diamond turning,
       Eq. (12)-(20), inverted here.

    Examples
    --------
    >>> import numpy as np
    >>> from metrosep import Profile
    >>> from metrosep.forms import SineGrid
    >>> grid = SineGrid(amplitude=50e-9, wavelength=100e-6)
    >>> x = np.arange(20e-6, 300e-6, 1e-6)
    >>> z = grid(x) + ToolSetting(dx=-2e-6).error(grid, x)
    >>> fit = identify_setting(Profile(x, z), grid)
    >>> round(fit.setting.dx * 1e6, 6), "shift_x" in " ".join(fit.messages)
    (-2.0, True)
    """
    form = known_form(form)
    points = points_of(surface, centre=centre, middle=True)
    names = _checked_free(free, is_line=isinstance(surface, Profile))
    wanted = (0.0, math.inf) if region is None else checked_region(region)
    noise = optional_length(noise, "noise", 1e-3)
    nose_radius = optional_length(nose_radius, "nose_radius", LARGEST_NOSE)
    if start is not None and not isinstance(start, ToolSetting):
        raise DataError(f"start must be a ToolSetting, got {type(start).__name__}")
    extent = float(np.hypot(np.abs(points.x).max(), np.abs(points.y).max()))
    task = Task(points, form, names, wanted, noise, extent)
    values = dict.fromkeys(FREEDOMS, 0.0)
    if start is not None:
        values |= {"dx": start.dx, "dy": start.dy, "dR": start.dR}
    found, said = settle_in_period(task, values)
    u_dy = None if start is None else start.u_dy
    return _result(surface, task, found, (*points.notes, *said), nose_radius, u_dy)


described_by(identify_setting)(vars(ToolSetting)["identify"])


def _result(
    surface: Surface | Profile | PointSet,
    task: Task,
    settled: Settled,
    said: tuple[str, ...],
    nose_radius: float | None,
    u_dy: float | None,
) -> SettingFit:
    sums, choice, values = settled.sums, settled.choice, settled.values
    residual = _residual(surface, task, settled)
    linked = correlation(task, residual.z)
    cov, variance = covariance(task, settled, (task.noise or 0.0) ** 2, linked)
    level = math.sqrt(variance)
    raised = _raised(settled, cov, level)
    cov = with_held_dy(task, settled, cov, u_dy)
    fitted = {n: values[n] for n in choice.used}
    u = dict(zip(choice.used, np.sqrt(np.diag(cov)).tolist(), strict=True))
    if nose_radius is not None and fitted.get("dR", 0.0) <= -nose_radius:
        raise DegenerateFitError(
            f"dR = {format_length(fitted['dR'])} (u {format_length(u['dR'])}) would leave no nose of "
            f"the programmed {format_length(nose_radius)}: the map does not show the nose radius; "
            "hold dR with free=, or check the form"
        )
    groups = correlated_pairs(choice.used, cov)
    effect = effect_of_dy(task, settled)
    audit = {
        "n_used": sums.n,
        "n_measured": task.points.n_valid,
        "inner_um": settled.region.inner * 1e6,
        "residual_rms_nm": math.sqrt(sums.mean_square) * 1e9,
        "noise_from": "residual" if task.noise is None else "stated",
        "steps": settled.steps,
        "centre_um": tuple(c * 1e6 for c in task.points.centre),
        "free": tuple(task.names),
        "form": repr(task.form),
        "noise_nm": level * 1e9,
        "u_raised": max(raised.values(), default=1.0),
        "points_alike": linked.alike,
    }
    if effect is not None:
        audit["dx_by_1um_of_dy_nm"] = effect[0] * 1e9
    said += said_of_dy(settled, effect, u, u_dy)
    said += warnings_of_fit(task, settled, groups, residual, level, linked, raised)
    dx, dy, dR = (values[n] for n in FACTORS)
    tool = ToolSetting(dx, dy, dR, cov=_of_setting(task, settled, cov, u_dy))
    rms, held = math.sqrt(sums.mean_square), dict(choice.given_up)
    alone = SettingFit(
        tool, fitted, u, frozen(cov), residual, rms, sums.n, groups, held, said, audit
    )
    return replace(alone, setting=replace(tool, fit=alone))


def _of_setting(task: Task, settled: Settled, cov: FloatArray, u_dy: float | None) -> FloatArray:
    """Return the covariance of (dx, dy, dR); infinite where not determined, 0 where not asked."""
    where = {n: i for i, n in enumerate(settled.choice.used)}
    joint = np.zeros((3, 3))
    for i, first in enumerate(FACTORS):
        if first in where:
            for j, second in enumerate(FACTORS):
                if second in where:
                    joint[i, j] = cov[where[first], where[second]]
        elif first == "dy" and u_dy is not None:
            joint[i, i] = u_dy**2
        elif first in task.names:
            joint[i, i] = math.inf
    return joint


def _raised(settled: Settled, cov: FloatArray, level: float) -> dict[str, float]:
    """Return by how much correlated noise raises the uncertainty of each factor."""
    _, inverse = solve(settled.sums, settled.choice)
    if level == 0.0:
        return {}
    ratios = np.sqrt(np.diag(cov) / np.diag(inverse)) / level
    found = dict(zip(settled.choice.used, ratios.tolist(), strict=True))
    return {n: max(found[n], 1.0) for n in FACTORS if n in found}


def _residual(
    surface: Surface | Profile | PointSet, task: Task, settled: Settled
) -> Surface | Profile | PointSet:
    """Return measured - modelled as an object of the same kind; NaN where not used."""
    values, region = settled.values, settled.region

    def off(x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        model, _ = modelled(task.form, x.ravel(), y.ravel(), values)
        return np.where(region.holds(x, y), z - model.reshape(z.shape), np.nan)

    z = task.points.over_blocks(off)
    if isinstance(surface, Surface):
        return Surface(z, surface.dx, surface.dy, origin=surface.origin)
    if isinstance(surface, Profile):
        return Profile(surface.x, z[0])
    return PointSet(surface.x, surface.y, z[0])


def _checked_free(free: Sequence[str] | None, *, is_line: bool) -> list[str]:
    if free is None:
        gone = {"rotation"} | ({"tilt_y", "shift_x", "shift_y"} if is_line else set())
        return [n for n in FREEDOMS if n not in gone]
    try:
        asked = [free] if isinstance(free, str) else list(free)
    except TypeError:
        raise DataError(f"free must name freedoms, got {free!r}") from None
    for name in asked:
        numbers.choice(name, "a freedom", FREEDOMS)
    if not any(n in FACTORS for n in asked):
        raise DataError("free names neither dx, dy nor dR: there is no setting to find")
    return [n for n in FREEDOMS if n in asked]
