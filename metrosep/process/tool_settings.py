"""`ToolSetting`: how far the tool of a turning machine stands from where the programme thinks it is.

dx, dy and dR are actual - nominal, SI. Frame: z out of the material, the edge in the plane of the
spindle axis and x, theta the azimuth on the *workpiece*. A tool with dx > 0 stands further from
the spindle axis, with dy > 0 towards growing workpiece azimuth; dR > 0 is a nose radius larger than
programmed. Error = actual - nominal along z. After Deterministic error compensation for slow tool
servo-driven diamond turning, Eq. (12)-(20), made exact.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.core.units import format_length
from metrosep.forms.base import Form
from metrosep.process._plain import not_above
from metrosep.process._setting_equations import (
    FACTORS,
    Factor,
    exact_cut,
    height_errors,
    known_form,
)
from metrosep.process.setting_maps import (
    LARGEST_SETTING,
    Mesh,
    SettingError,
    checked_covariance,
    checked_uncertainty,
    map_extent,
    polar_axes,
    positions,
    square_axes,
)

if TYPE_CHECKING:
    from metrosep.core.profile import Profile
    from metrosep.core.surface import Surface
    from metrosep.forms.points import PointSet
    from metrosep.process.setting_fit import SettingFit

__all__ = ["ToolSetting"]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ToolSetting:
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
        If a value is no finite number, an uncertainty is negative or NaN, or the covariance is not
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
            If a position is no finite number, the positions do not broadcast, or one lies in the
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
        form : Form
            The nominal surface, with the spindle axis at its origin.
        radius : float, m, optional
            Of the workpiece; 500 um with a message if neither it nor a region is given.
        region : tuple of (float, float), m, optional
            Inner and outer radius instead.
        mesh : {"polar", "square"}, optional
            Kind of mesh.
        n_rho, n_theta : int, optional
            Radii, both ends included, and azimuths of a polar mesh.
        step : float, m, optional
            Pixel of a square mesh; a 400th of the diameter if omitted.
        exact : bool, optional
            Whether the exact model is taken; otherwise the sum of Eq. (12), (17) and (20).
        factor : {"dx", "dy", "dR"}, optional
            The error of this factor alone.

        Returns
        -------
        SettingError
            With ``rho``, ``theta``, ``z``, and ``u`` if uncertainties are known. NaN in the core
            and where the surface is not defined, with a message.

        Raises
        ------
        DataError
            If the form, the region, the mesh or the factor is not usable, or nothing is defined.
        TooFewSamplesError
            If the mesh has too few points.
        UnitError
            If the radius cannot be in metres.
        NotConvergedError
            If dR exceeds what the curvature of the surface allows.

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
        cls, surface: Surface | Profile | PointSet, form: Form, **options: Any
    ) -> ToolSetting:
        """Return the setting that explains a measured map, with its uncertainty.

        Parameters
        ----------
        surface : Surface, Profile or PointSet
            Heights of the part as cut, form included; NaN = not measured.
        form : Form
            The nominal surface, all parameters known.
        **options : object
            Of `metrosep.process.setting_fit.identify_setting`: free, nose_radius, centre, region,
            start, noise.

        Returns
        -------
        ToolSetting
            Its ``fit`` holds residual, covariance of all freedoms, groups and messages.

        Raises
        ------
        DataError
            If the form, a freedom, the centre, the region or the noise is not usable.
        TooFewSamplesError
            If fewer points than freedoms remain.
        DegenerateFitError
            If neither dx, dy nor dR leaves a trace on this surface.
        UnitError
            If the nose radius or the noise cannot be in metres.
        NotConvergedError
            If the iteration does not settle.

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
        from metrosep.process.setting_fit import identify_setting

        return identify_setting(surface, form, **options).setting

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
