"""What `follow_up` returns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from metrosep.core._arrays import FloatArray, frozen_float
from metrosep.core.errors import DataError, NotUniformError, TooFewSamplesError
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.core.surface import Surface
from metrosep.process._plain import plain

if TYPE_CHECKING:
    import pandas as pd

    from metrosep.spectral.spectra import AmplitudeSpectrum

__all__ = ["FollowUp", "FollowUpMap", "TermShare"]


@dataclass(frozen=True, slots=True)
class TermShare:
    """How much of the follow-up error one term of the regression explains.

    Parameters
    ----------
    term : str
        ``"velocity"``, ``"acceleration"`` and so on.
    pv, rms : Quantity, m
        Of coefficient times motion, the mean removed.
    share : float
        Covariance with the error over the variance of the error; all shares sum to R squared. 0
        where the error does not vary.
    significance : float
        Coefficient over its standard uncertainty; 0 where the error does not vary.
    """

    term: str
    pv: Quantity
    rms: Quantity
    share: float
    significance: float


@dataclass(frozen=True, slots=True, eq=False)
class FollowUpMap:
    """The follow-up error at the places of the part where it was cut.

    Parameters
    ----------
    rho, theta : ndarray, shape (n,), m and rad
        Radius and azimuth on the part.
    z : ndarray, shape (n,), m
        Error, positive out of the material; NaN where not measured.
    history : tuple of Step
        From the log on.
    """

    rho: FloatArray
    theta: FloatArray
    z: FloatArray
    history: tuple[Step, ...] = ()

    def __post_init__(self) -> None:
        for name in ("rho", "theta", "z"):
            object.__setattr__(self, name, frozen_float(getattr(self, name), name=name, ndim=1))

    @property
    def x(self) -> FloatArray:
        """Positions along x in m."""
        return np.asarray(self.rho * np.cos(self.theta))

    @property
    def y(self) -> FloatArray:
        """Positions along y in m."""
        return np.asarray(self.rho * np.sin(self.theta))

    def on_grid(self, step: float) -> Surface:
        """Return a map on a square grid: the mean of the samples in each cell, NaN where none is.

        Parameters
        ----------
        step : float, m
            Width of a cell.

        Returns
        -------
        Surface
            Form error, centred on the spindle axis.

        Raises
        ------
        DataError
            If the step is not positive or the grid would have more than 4000 cells along an axis.
        TooFewSamplesError
            If nothing was measured.
        """
        valid = ~(np.isnan(self.z) | np.isnan(self.rho) | np.isnan(self.theta))
        if not valid.any():
            raise TooFewSamplesError("the map holds no valid sample")
        if not step > 0.0:
            raise DataError(f"the step of the grid is {step} m; give a positive one")
        half = int(np.ceil(float(self.rho[valid].max()) / step))
        n = 2 * half + 1
        if n > _CELLS:
            raise DataError(f"a step of {step:.3g} m gives {n} cells along x; choose a wider one")
        column = np.rint(self.x[valid] / step).astype(int) + half
        row = np.rint(self.y[valid] / step).astype(int) + half
        at = row * n + column
        count = np.bincount(at, minlength=n * n)
        total = np.bincount(at, weights=self.z[valid], minlength=n * n)
        z = np.full(n * n, np.nan)
        np.divide(total, count, out=z, where=count > 0)
        done = Step("follow_up_map", {"step_m": step})
        corner = -half * step
        return Surface(
            z.reshape(n, n), step, step, origin=(corner, corner), history=(*self.history, done)
        )


_CELLS = 4000


@dataclass(frozen=True, slots=True, eq=False)
class FollowUp:
    """A follow-up error and what it depends on.

    Parameters
    ----------
    t : ndarray, shape (n,), s
        Uniform time.
    error : ndarray, shape (n,), m
        Actual minus commanded position; NaN where not measured.
    command : ndarray, shape (n,), m
        Commanded position.
    velocity, acceleration, jerk : ndarray, shape (n,), m/s, m/s^2, m/s^3
        Of the command; NaN within half a window of an end or of a gap.
    coefficients : mapping of str to Quantity
        ``c0`` in m, ``cv`` in s, ``ca`` in s^2, ``cj`` in s^3, those that were fitted.
    cov : ndarray, shape (k, k)
        Covariance of the coefficients in their order.
    shares : mapping of str to TermShare
        What each term explains.
    r2 : float
        Share of the variance of the error that the regression explains, 0 to 1; 0 where the error
        does not vary.
    residual : ndarray, shape (n,), m
        Error minus regression.
    delay : Quantity, s
        By how much actual lags the command; NaN if it cannot be told.
    quantities : mapping of str to Quantity
        ``PV``, ``PV95``, ``RMS`` of the error in m, ``noise`` of the command in m.
    map : FollowUpMap or None
        Error over the part.
    audit : mapping
        Settings and counts, units in the keys.
    messages : tuple of str
        Hints and doubts in plain words.
    history : tuple of Step
        From the log on.
    """

    t: FloatArray
    error: FloatArray
    command: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    jerk: FloatArray
    coefficients: Mapping[str, Quantity]
    cov: FloatArray
    shares: Mapping[str, TermShare]
    r2: float
    residual: FloatArray
    delay: Quantity
    quantities: Mapping[str, Quantity]
    map: FollowUpMap | None
    audit: Mapping[str, Any]
    messages: tuple[str, ...]
    history: tuple[Step, ...]

    @property
    def c0(self) -> float:
        """Constant part in m."""
        return self.coefficients["c0"].value

    @property
    def cv(self) -> float:
        """Coefficient of velocity in s; NaN if it was not fitted."""
        return self._value("cv")

    @property
    def ca(self) -> float:
        """Coefficient of acceleration in s^2; NaN if it was not fitted."""
        return self._value("ca")

    @property
    def cj(self) -> float:
        """Coefficient of jerk in s^3; NaN if it was not fitted."""
        return self._value("cj")

    @property
    def pv(self) -> float:
        """Peak-to-valley of the error in m, nothing removed."""
        return self.quantities["PV"].value

    @property
    def rms(self) -> float:
        """Root mean square of the error about its mean in m."""
        return self.quantities["RMS"].value

    def _value(self, name: str) -> float:
        found = self.coefficients.get(name)
        return float("nan") if found is None else found.value

    def spectrum(self) -> AmplitudeSpectrum:
        """Return the amplitude spectrum of the error over frequency in Hz, Hann window.

        Returns
        -------
        AmplitudeSpectrum
            Of the longest stretch without a gap; `frequency` in Hz.

        Raises
        ------
        TooFewSamplesError
            If that stretch has fewer than 4 samples.
        NotUniformError
            If the time is not uniform.
        """
        from metrosep.spectral.density import amplitude_spectrum

        start, stop = longest_stretch(self.error)
        if stop - start < 4:
            raise TooFewSamplesError(
                f"a spectrum needs 4 samples in a row, the log has {stop - start}"
            )
        profile = Profile(self.t[start:stop], self.error[start:stop], history=self.history)
        if not profile.is_uniform:
            n = profile.x.size
            even = np.linspace(profile.x[0], profile.x[-1], n)
            if float(np.abs(even - profile.x).max()) > 2e-2 * (even[1] - even[0]):
                raise NotUniformError("the time of the log is not uniform; resample it first")
            profile = Profile(even, profile.z, history=self.history)
        return amplitude_spectrum(profile)

    def to_dict(self) -> dict[str, Any]:
        """Return what was found as plain values, without the samples; None where not known.

        Returns
        -------
        dict
            Keys ``coefficients``, ``shares``, ``r2``, ``delay``, ``quantities``, ``has_map``,
            ``audit``, ``messages``.
        """
        return {
            "coefficients": plain(self.coefficients),
            "shares": {
                name: {
                    "pv": plain(s.pv),
                    "rms": plain(s.rms),
                    "share": plain(s.share),
                    "significance": plain(s.significance),
                }
                for name, s in self.shares.items()
            },
            "r2": plain(self.r2),
            "delay": plain(self.delay),
            "quantities": plain(self.quantities),
            "has_map": self.map is not None,
            "audit": plain(self.audit),
            "messages": list(self.messages),
        }

    def to_frame(self) -> pd.DataFrame:
        """Return one row for each term: coefficient, its uncertainty, P-V, RMS and share.

        Returns
        -------
        pandas.DataFrame
            Columns ``term coefficient u unit pv_nm rms_nm share significance``.
        """
        import pandas as pd

        rows = []
        for name, share in zip(
            [c for c in self.coefficients if c != "c0"], self.shares.values(), strict=True
        ):
            c = self.coefficients[name]
            rows.append(
                {
                    "term": share.term,
                    "coefficient": c.value,
                    "u": c.u,
                    "unit": c.unit,
                    "pv_nm": share.pv.value * 1e9,
                    "rms_nm": share.rms.value * 1e9,
                    "share": share.share,
                    "significance": share.significance,
                }
            )
        return pd.DataFrame(rows)


def longest_stretch(z: FloatArray) -> tuple[int, int]:
    """Return start and stop of the longest run of samples that were measured."""
    edges = np.diff(np.concatenate([[0], (~np.isnan(z)).astype(int), [0]]))
    starts, stops = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    if not starts.size:
        return 0, 0
    best = int(np.argmax(stops - starts))
    return int(starts[best]), int(stops[best])
