"""`FitResult`: what was found, how well it is known, and what is left."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core.errors import NotConvergedError
from metrosep.core.profile import Profile, html_table
from metrosep.core.surface import Surface
from metrosep.core.units import format_engineering, format_length
from metrosep.forms.base import Form
from metrosep.forms.placement import Placement
from metrosep.forms.points import PointSet

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["FitResult"]

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class FitResult:
    """A form at its best place, and the deviations from it.

    Parameters
    ----------
    form : Form
        With the fitted parameters, in its own frame.
    params : mapping of str to float
        Free and held parameters, SI; rigid-body freedoms first.
    names : tuple of str
        The free ones, in the order of `cov`.
    cov : ndarray, shape (p, p)
        Covariance, for deviations that are independent from point to point.
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
    warnings, notes : tuple of str
        Parameters that hang together; what the fit assumed.
    n_iterations : int
        Steps taken; 0 for a form that is linear in all that is free.
    robust : str or None
        Rule that weighted the points.
    source : Surface, Profile, PointSet or None
        What was fitted.

    Notes
    -----
    Where the deviations are correlated (waviness, a wrong form) the covariance is too small: it
    says how well noise is averaged, not how well the form describes the part.
    """

    form: Form
    params: Mapping[str, float]
    names: tuple[str, ...]
    cov: FloatArray
    residual: Surface | Profile | PointSet
    rms: float
    n_points: int
    centre: tuple[float, float]
    placement: Placement
    units: Mapping[str, str]
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    n_iterations: int = 0
    robust: str | None = None
    source: Surface | Profile | PointSet | None = None

    @property
    def dof(self) -> int:
        """Degrees of freedom."""
        return self.n_points - len(self.names)

    @property
    def u(self) -> dict[str, float]:
        """Standard uncertainty of each free parameter; NaN without degrees of freedom."""
        return dict(zip(self.names, np.sqrt(np.diag(self.cov)).tolist(), strict=True))

    @property
    def correlations(self) -> FloatArray:
        """Correlation of the free parameters, shape (p, p)."""
        sd = np.sqrt(np.diag(self.cov))
        safe = np.where(sd > 0.0, sd, 1.0)
        return np.asarray(self.cov / np.outer(safe, safe))

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
            ``centre_m``, ``tilt``, ``direction``, ``robust``, ``warnings``, ``notes``.
        """
        u = self.u
        return {
            "form": self.form.name,
            "parameters": {
                k: {
                    "value": v,
                    "unit": self.units[k],
                    "u": u[k] if k in u and np.isfinite(u[k]) else None,
                    "free": k in u,
                }
                for k, v in self.params.items()
            },
            "rms_m": self.rms,
            "pv_m": self.peak_to_valley,
            "n_points": self.n_points,
            "dof": self.dof,
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
            text = format_engineering(value, self.units[name], digits=9)
            how = (
                f"u = {format_engineering(u[name], self.units[name], digits=2)}"
                if name in u
                else "held"
            )
            lines.append(f"  {name:<12} {text:<22} {how}")
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
        from metrosep.forms.lmfit_bridge import refit

        return refit(self)

    def __repr__(self) -> str:
        inside = ", ".join(f"{k}={v:.6g}" for k, v in self.params.items())
        return f"FitResult({self.form.name}: {inside}; residual RMS {format_length(self.rms)})"

    def _repr_html_(self) -> str:
        """Return a table for notebooks."""
        u = self.u
        rows = {
            k: format_engineering(v, self.units[k], digits=7)
            + (f" (u = {format_engineering(u[k], self.units[k], digits=2)})" if k in u else "")
            for k, v in self.params.items()
        }
        rows["residual RMS"] = format_length(self.rms)
        rows["residual P-V"] = format_length(self.peak_to_valley)
        for i, warning in enumerate(self.warnings):
            rows[f"warning {i + 1}"] = warning
        return html_table(f"{self.form.name} fit", rows)
