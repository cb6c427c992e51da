"""`FitResult`: what was found, how well it is known, and what is left."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, NotConvergedError
from metrosep.core.limits import COVERAGE
from metrosep.core.profile import Profile, html_table
from metrosep.core.public import PublicObject, shortened
from metrosep.core.surface import Surface
from metrosep.core.units import format_engineering, format_length
from metrosep.forms._correlated import (
    PROVEN,
    Estimate,
    estimated,
    expanding_factor,
    from_model,
    student,
)
from metrosep.forms.base import RIGID, Form, Placement
from metrosep.forms.conic import curvature_name
from metrosep.forms.linear import Robust, winsorised
from metrosep.forms.points import PointSet, points_of

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class FitResult(PublicObject):
    """A form at its best place, and the deviations from it.

    Parameters
    ----------
    form : Form
        With the fitted parameters, in its own frame.
    params : mapping of str to float
        Free and held parameters, SI; rigid-body freedoms first. Beside each free radius of
        curvature its curvature (c beside R), 1/m; the radius of a flat is infinite.
    names : tuple of str
        The free ones, in the order of `cov`.
    white : ndarray, shape (p, p)
        Covariance if deviations were independent from point to point, by c where R is free.
    residual : Surface, Profile or PointSet
        Measured minus ideal; NaN where not measured or outside the form's domain.
    rms : float, m
        Root mean square of the residual about zero, all points inside the domain.
    n_points : int
        Points used.
    centre : tuple of (float, float), m
        Where shifts count from, in the coordinates of the object.
    placement : Placement
        The form at its place.
    units : mapping of str to str
        Unit of each parameter.
    found_warnings, notes : tuple of str
        Parameters that hang together or are held; what the fit assumed.
    n_iterations : int
        Steps taken; 0 for a form that is linear in all that is free.
    robust : str or None
        Rule that weighted the points.
    source : Surface, Profile, PointSet or None
        What was fitted.
    covariance_of_noise : ndarray or None, m^2
        Covariance against lag of the noise model that was given to the fit; `u` rests on it.

    Notes
    -----
    `u` and `cov` are made from the correlation of the residual, when they are first asked for
    (explanation page: form fit). They say how well this map determines the parameters. An error
    that has the shape of a parameter is not in them: scale, reference surface, repeatability.
    """

    form: Form
    params: Mapping[str, float]
    names: tuple[str, ...]
    white: FloatArray
    residual: Surface | Profile | PointSet
    rms: float
    n_points: int
    centre: tuple[float, float]
    placement: Placement
    units: Mapping[str, str]
    found_warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    n_iterations: int = 0
    robust: str | None = None
    source: Surface | Profile | PointSet | None = None
    covariance_of_noise: FloatArray | None = None
    _estimates: list[Estimate] = field(default_factory=list, init=False, repr=False)

    @property
    def dof(self) -> int:
        """Points less parameters; `dof_effective` counts what the residual can tell."""
        return self.n_points - len(self.names)

    @property
    def _estimate(self) -> Estimate:
        """What the residual says about the parameters, by c where R is free; kept."""
        if not self._estimates:
            self._estimates.append(self._estimated())
        return self._estimates[0]

    def _estimated(self) -> Estimate:
        p = len(self.names)
        if p == 0 or self.source is None:
            return Estimate(np.full((p, p), np.nan), np.nan, np.nan, np.nan)
        points = points_of(self.source, centre=self.centre, middle=False)
        left = np.atleast_2d(np.asarray(self.residual.z))
        if self.robust is not None:
            left = winsorised(left, cast(Robust, self.robust))
        rigid = tuple(n for n in self.names if n in RIGID)
        shape = tuple(n for n in self.names if n not in RIGID)
        placed = replace(self.placement, form=self.form)

        def linearise(x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
            return placed.linearised(x, y, z, rigid, shape)

        if self.covariance_of_noise is not None:
            valid = ~np.isnan(np.atleast_2d(np.asarray(self.residual.z)))
            return from_model(points, linearise, self.covariance_of_noise, valid, p)
        return estimated(points, linearise, left, p)

    def _by_radius(self, cov: FloatArray) -> FloatArray:
        """Return a covariance by R from that by c: dR = -R^2 dc."""
        rate = np.array(
            [-(self.params[n] ** 2) if n in self.form.radii else 1.0 for n in self.names]
        )
        with np.errstate(over="ignore", invalid="ignore"):
            return np.asarray(rate[:, None] * cov * rate)

    @property
    def cov(self) -> FloatArray:
        """Covariance of the free parameters, shape (p, p), from the correlation of the residual.

        NaN where there are fewer than two independent cells for each parameter.
        """
        return self._by_radius(self._estimate.cov)

    @property
    def cov_white(self) -> FloatArray:
        """Covariance if the deviations were independent from point to point, shape (p, p)."""
        return self._by_radius(self.white)

    @property
    def u(self) -> dict[str, float]:
        """Standard uncertainty of each free parameter and curvature; NaN where it is not known."""
        return self._standard(self._estimate.cov)

    @property
    def guard(self) -> dict[str, float]:
        """Guard band of each at a limit, one-sided 95 %: t_0.95 u, more where deviations may rise beyond the map."""
        t = student(self.dof_effective, PROVEN) * self._estimate.guard * np.ones(len(self.names))
        return self._standard(self._estimate.cov * np.outer(t, t))

    @property
    def u_white(self) -> dict[str, float]:
        """Standard uncertainty if the deviations were independent from point to point."""
        return self._standard(self.white)

    def _standard(self, cov: FloatArray) -> dict[str, float]:
        own = dict(zip(self.names, np.sqrt(np.diag(cov)).tolist(), strict=True))
        bent = {curvature_name(n): u for n, u in own.items() if n in self.form.radii}
        with np.errstate(over="ignore", invalid="ignore"):
            radii = {
                n: float(np.float64(self.params[n]) ** 2 * u)
                for n, u in own.items()
                if n in self.form.radii
            }
        return {**own, **radii, **bent}

    @property
    def dof_effective(self) -> float:
        """Degrees of freedom of `u`; NaN where `u` is not known."""
        return self._estimate.dof

    @property
    def n_effective(self) -> float:
        """Number of independent cells of the residual."""
        return self._estimate.n_effective

    @property
    def correlation_length(self) -> float:
        """Radius of an independent cell of the residual, in steps of the map."""
        return self._estimate.length

    @property
    def coverage_factor(self) -> float:
        """Student's t for 95.45 % and `dof_effective`: the expanded uncertainty is this times `u`."""
        return expanding_factor(self.dof_effective)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a user must know: parameters that are held, tied or not determined by the map."""
        return (
            *self.found_warnings,
            *self._flat(),
            *self._unsettled(),
            *self._too_few(),
            *self._bounded(),
            *self._laid(),
        )

    def _unsettled(self) -> list[str]:
        """Return a sentence for each term of an asphere that may be 0, and each angle that may be any."""
        found = []
        for name in self.names:
            value, U = self.params[name], self.coverage_factor * self.u[name]
            unit = self.units.get(name, "")
            if name in ("angle", "rotation_z") and 0.5 * math.pi <= U:
                found.append(
                    f"{name} is not determined by this map: U = {math.degrees(U):.2g} deg holds every "
                    "direction; hold it at the drawing's"
                )
            elif self.form.name == "asphere" and name[1:].isdecimal() and abs(value) < U:
                found.append(
                    f"{name} can hardly be distinguished from 0: {name} = {value:.3g} {unit}, "
                    f"U = {U:.2g} {unit}; leave the term out, or measure a larger aperture"
                )
        return found

    def _bounded(self) -> list[str]:
        """Return a sentence where the residual cannot say how much the form took up."""
        if not self.names or not self._estimate.bounded:
            return []
        text = (
            f"the deviations are so long that the {len(self.names)} free parameters may have taken up "
            "more of them than is left: u is a bound from the energy of the residual, rather too large, "
            "and does not come from its correlation; measure a larger area or free fewer parameters"
        )
        return [text]

    def _laid(self) -> list[str]:
        """Return a sentence where deviations run along a narrow map: u knows no lay of finite length."""
        ratio = self._estimate.lay if self.names else 1.0
        if not ratio > _LAID:
            return []
        text = (
            f"the deviations run along this narrow map (their slopes across it are {ratio:.2g} times those along "
            "it), and u may be too small by a factor of two: on strips of 8 to 16 rows with such a lay U held 60 "
            "to 90 % of the errors instead of 95 %; state U, or measure a wider map"
        )
        return [text]

    def _too_few(self) -> list[str]:
        cells = self.n_effective
        if not self.names or self.dof < 1 or not (cells < 2 * len(self.names)):
            return []
        text = (
            f"the residual has about {cells:.0f} independent cells for {len(self.names)} "
            "parameters, so their uncertainty is not known; measure a larger area or free fewer"
        )
        return [text]

    def _flat(self) -> list[str]:
        """Return a sentence for each radius that the map hardly tells from a flat."""
        found = []
        for name in (n for n in self.form.radii if n in self.names):
            bent = curvature_name(name)
            c, u = self.params[bent], self.u[bent]
            if not abs(c) < 3.0 * u:
                continue
            U = self.coverage_factor * u
            sag = (
                0.5
                * points_of(cast(Any, self.source), centre=self.centre, middle=False).radius ** 2
            )
            low, high = c - U, c + U
            bounds = f"{name} > {_length(1.0 / high)} or {name} < {_length(1.0 / low)}"
            if low > 0.0 or high < 0.0:
                bounds = f"{name} between {_length(1.0 / high)} and {_length(1.0 / low)}"
            found.append(
                f"{name} can hardly be distinguished from a flat: {bent} = {c:.3g} 1/m, U = {U:.2g} 1/m "
                f"(power {format_length(c * sag)}, U = {format_length(U * sag)} over the aperture);"
                f" with {_SHARE} {bounds}"
            )
        if found and "angle" in self.params and "angle" not in self.names:
            angle = math.degrees(self.params["angle"]) % 180.0
            found[-1] += (
                f"; the axis is held at {angle:.3g} deg from x: where it lies elsewhere, name the "
                f'angle, "{self.form.name}: angle={(angle + 90.0) % 180.0:.3g} deg"'
            )
        return found

    @property
    def assumption(self) -> str:
        """What `u` rests on, one sentence."""
        if not self.names:
            return "nothing was free, so there is no uncertainty of the fit"
        if self.covariance_of_noise is not None:
            return (
                f"u from the noise model that was given, k = {self.coverage_factor:.3g} for {_SHARE}; "
                "what the residual says, scale, reference and repeatability are not in it"
            )
        if not np.isfinite(self.dof_effective):
            return "u is not known: the residual has too few independent points"
        if np.isnan(self.correlation_length):
            how = "from the polynomials next to the model: the points of a list have no neighbours"
        else:
            how = (
                f"from the correlation of the residual ({self.correlation_length:.2g} steps, about "
                f"{self.n_effective:.3g} independent cells)"
            )
        return (
            f"u {how}, {self.dof_effective:.3g} degrees of freedom, k = {self.coverage_factor:.3g} "
            f"for {_SHARE}; scale, reference and repeatability are not in it"
        )

    @property
    def correlations(self) -> FloatArray:
        """Correlation of the free parameters, shape (p, p)."""
        cov = self._estimate.cov
        sd = np.sqrt(np.diag(cov))
        safe = np.where(sd > 0.0, sd, 1.0)
        sign = np.array([-1.0 if n in self.form.radii else 1.0 for n in self.names])
        return np.asarray(cov / np.outer(safe, safe) * np.outer(sign, sign))

    @property
    def peak_to_valley(self) -> float:
        """P-V of the residual, m."""
        return self.residual.peak_to_valley()

    def evaluate(self, x: ArrayLike, y: ArrayLike = 0.0) -> FloatArray:
        """Return the ideal height at positions of the measurement.

        Parameters
        ----------
        x, y : array_like, m
            In the coordinates of the object that was fitted.

        Returns
        -------
        ndarray, m
            Height; NaN outside the domain.

        Raises
        ------
        NotConvergedError
            If a form that was turned is too steep there to be a function of x and y.
        """
        xs, ys = np.broadcast_arrays(
            np.asarray(x, dtype=np.float64) - self.centre[0],
            np.asarray(y, dtype=np.float64) - self.centre[1],
        )
        placed = Placement(self.form, self.placement.rigid, self.placement.tilt)
        z = np.zeros(xs.shape)
        for _ in range(30):
            deviation = placed.deviation(xs, ys, z)
            z = z - deviation
            if placed.tilt == "plane" or not np.nanmax(np.abs(deviation), initial=0.0) > 1e-16 + (
                4e-16 * float(np.nanmax(np.abs(z), initial=0.0))
            ):
                return np.asarray(z)
        raise NotConvergedError(
            "the turned form is too steep to be evaluated as a function of x and y; take its "
            "residual instead"
        )

    def to_frame(self) -> pd.DataFrame:
        """Return the parameters as a data frame.

        Returns
        -------
        pandas.DataFrame
            Index ``parameter``; columns ``value``, ``u``, ``unit``, ``free``.
        """
        import pandas as pd

        u = self.u
        rows = [
            {
                "parameter": k,
                "value": v,
                "u": u.get(k, 0.0),
                "unit": self.units[k],
                "free": k in u,
            }
            for k, v in self.params.items()
        ]
        return pd.DataFrame(rows, columns=["parameter", "value", "u", "unit", "free"]).set_index(
            "parameter"
        )

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON, SI.

        Returns
        -------
        dict
            Keys ``form``, ``parameters``, ``rms_m``, ``pv_m``, ``n_points``, ``dof``,
            ``dof_effective``, ``n_effective``, ``correlation_length_steps``, ``u_rests_on``,
            ``centre_m``, ``tilt``, ``direction``, ``robust``, ``warnings``, ``notes``. A radius
            that is infinite is None beside its curvature.
        """
        u, white = self.u, self.u_white
        effective = {
            "dof_effective": self.dof_effective,
            "n_effective": self.n_effective,
            "correlation_length_steps": self.correlation_length,
        }
        return {
            "form": self.form.name,
            "parameters": {
                k: {
                    "value": v if np.isfinite(v) else None,
                    "unit": self.units[k],
                    "u": u[k] if k in u and np.isfinite(u[k]) else None,
                    "free": k in u,
                }
                | ({"u_white": white[k] if np.isfinite(white[k]) else None} if k in u else {})
                for k, v in self.params.items()
            },
            "rms_m": self.rms,
            "pv_m": self.peak_to_valley,
            "n_points": self.n_points,
            "dof": self.dof,
            **{k: v if np.isfinite(v) else None for k, v in effective.items()},
            "u_rests_on": self.assumption,
            "centre_m": list(self.centre),
            "tilt": self.placement.tilt,
            "direction": self.placement.direction,
            "robust": self.robust,
            "warnings": list(self.warnings),
            "notes": list(self.notes),
        }

    def report(self) -> str:
        """Return the result as text.

        Returns
        -------
        str
            Parameters with standard uncertainties, residual, what hangs together.
        """
        u = self.u
        lines = [
            f"{self.form.name} fitted to {self.n_points} points, {len(self.names)} free",
            (
                f"residual RMS {format_length(self.rms)}, P-V {format_length(self.peak_to_valley)}"
                f" ({self.placement.direction}, measured minus ideal)"
            ),
            (
                f"centre at x = {format_length(self.centre[0])}, y = {format_length(self.centre[1])}; "
                f"tilt as {self.placement.tilt}"
            ),
        ]
        for name, value in self.params.items():
            text, how = _said(value, self.units[name], 9), "held"
            if name in u:
                how = f"u = {format_engineering(u[name], self.units[name], digits=2)}"
                if math.isinf(value):
                    how = f"a flat: see {curvature_name(name)} for u"
            lines.append(f"  {name:<12} {text:<22} {how}")
        lines.append(self.assumption)
        lines += [f"warning: {w}" for w in self.warnings]
        lines += [f"note: {n}" for n in self.notes]
        return "\n".join(lines)

    def lmfit(self) -> Any:
        """Return the same fit as lmfit finds it, from here as a start.

        Returns
        -------
        lmfit.minimizer.MinimizerResult
            Least squares over all points, with lmfit's confidence tools at hand.

        Notes
        -----
        lmfit differentiates numerically and holds all points at once: slow on large maps.
        """
        return refit(self)

    def __repr__(self) -> str:
        inside = ", ".join(f"{k}={v:.6g}" for k, v in self.params.items())
        return shortened(
            f"FitResult({self.form.name}, residual RMS {format_length(self.rms)}: {inside})"
        )

    def _repr_html_(self) -> str:
        """Return a table for notebooks."""
        u = self.u
        rows = {
            k: _said(v, self.units[k], 7)
            + (
                f" (u = {format_engineering(u[k], self.units[k], digits=2)})"
                if k in u and not math.isinf(v)
                else ""
            )
            for k, v in self.params.items()
        }
        rows["residual RMS"] = format_length(self.rms)
        rows["residual P-V"] = format_length(self.peak_to_valley)
        for i, warning in enumerate(self.warnings):
            rows[f"warning {i + 1}"] = warning
        return html_table(f"{self.form.name} fit", rows)


_SHARE = f"{100.0 * COVERAGE:.4g} %"
_LAID = 2.0
"""Slopes across over those along from which a narrow map has a lay: deviations alike in all directions have 0.6
to 1.6 on 8 rows of 64 pixels (white, Gaussian and exponential correlation, f^-2, f^-3)."""


def _said(value: float, unit: str, digits: int) -> str:
    """Return a parameter with its unit; the radius of a flat is infinite."""
    return "infinite" if math.isinf(value) else format_engineering(value, unit, digits=digits)


def _length(value: float) -> str:
    """Return a radius with three digits, in m or km where it is long."""
    if abs(value) >= 1e3:
        return f"{value / 1e3:.3g} km"
    return format_length(value, digits=3)


# ---- A fit as lmfit would do it, for its confidence intervals and as a second opinion ----------


def refit(result: FitResult) -> Any:
    """Return lmfit's least squares with the freedoms of a result, started at it."""
    import lmfit

    if result.source is None:
        raise DataError("this result does not hold the measurement it was fitted to; fit it again")
    points = points_of(result.source, centre=result.centre, middle=False)
    x, y, z = points.sample(points.z.size)
    parameters = lmfit.Parameters()
    held = {k: v for k, v in result.params.items() if k in RIGID}
    start = {**held, **result.form.parameters}
    for name, value in start.items():
        parameters.add(name, value=value, vary=name in result.names)
    unit = result.rms if result.rms > 0.0 else 1.0

    def residual(values: Any) -> Any:
        given = {k: float(values[k].value) for k in start}
        rigid = {k: v for k, v in given.items() if k in RIGID}
        shape = {k: v for k, v in given.items() if k not in RIGID}
        placed = Placement(
            result.form.with_parameters(**shape),
            rigid,
            result.placement.tilt,
            result.placement.direction,
        )
        deviation = placed.deviation(x, y, z)
        return deviation[~np.isnan(deviation)] / unit

    return lmfit.minimize(residual, parameters, method="leastsq")
