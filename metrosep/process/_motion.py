"""Private helpers of follow-up logs: uniform time, noise-aware derivatives, delay."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray, frozen_float
from metrosep.core.errors import DataError, DegenerateFitError, NotUniformError, TooFewSamplesError
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.core.surface import Surface
from metrosep.process._plain import plain
from metrosep.process._regression import regress

if TYPE_CHECKING:
    import pandas as pd

    from metrosep.spectral.spectra import AmplitudeSpectrum

__all__ = ["FollowUp", "FollowUpMap", "TermShare"]

ORDER = 5
"""Of the local polynomials: two above the third derivative, so that its bias is of order h^4."""

_JITTER = 1e-3
"""Largest deviation of a step from the usual one, relative, that needs no resampling."""

_MOST = 20
"""Resampling may need this many times the samples of the log."""

_GAP = 1.5
"""A pause longer than this many usual steps is a gap and stays NaN."""

_SHORT = 6
"""Shortest windows, of which the lowest residual tells the noise of the positions."""

_ROUNDING = 1e-12
"""Residual, relative to the range, that is rounding and no noise."""

_LAST_PLACES = 1e-15
"""Rounding of a weighted sum, relative to the range of the positions."""


@dataclass(frozen=True, slots=True)
class Derivatives:
    """Velocity, acceleration and jerk with the half-window at each end NaN."""

    velocity: FloatArray
    acceleration: FloatArray
    jerk: FloatArray
    window: int
    noise: float
    sd: tuple[float, float, float]


def uniform(
    t: FloatArray, columns: dict[str, FloatArray]
) -> tuple[FloatArray, dict[str, FloatArray], float, float]:
    """Return time, columns, step and largest relative jitter, resampled only where it must be."""
    steps = np.diff(t)
    usual = float(np.median(steps))
    jitter = float(np.abs(steps / usual - 1.0).max())
    if jitter <= _JITTER:
        return t, columns, float((t[-1] - t[0]) / (t.size - 1)), jitter
    n = round(float(t[-1] - t[0]) / usual) + 1
    if n > _MOST * t.size:
        raise NotUniformError(
            f"the log has {t.size} samples but lasts for {n} of its usual steps of {usual:.4g} s, "
            f"the longest pause is {float(steps.max()):.4g} s; cut it at its pauses"
        )
    grid = t[0] + usual * np.arange(n)
    return grid, {k: _resampled(t, c, grid, usual) for k, c in columns.items()}, usual, jitter


def _resampled(t: FloatArray, values: FloatArray, grid: FloatArray, step: float) -> FloatArray:
    from scipy.interpolate import CubicSpline

    valid = ~np.isnan(values)
    if valid.sum() < 4:
        return np.full(grid.size, np.nan)
    x = t[valid]
    inside = np.clip(grid, x[0], x[-1])
    result = np.asarray(CubicSpline(x, values[valid])(inside), dtype=np.float64)
    after = np.clip(np.searchsorted(x, grid, side="left"), 1, x.size - 1)
    gap = (x[after] - x[after - 1] > _GAP * step) & (grid > x[after - 1]) & (grid < x[after])
    outside = (grid < x[0] - 1e-9 * step) | (grid > x[-1] + 1e-9 * step)
    result[gap | outside] = np.nan
    return result


def derivatives(z: FloatArray, step: float, window: int | None = None) -> Derivatives:
    """Return v, a and j by local polynomials over a window that balances noise and bias."""
    longest = (z.size - 1) // 2 * 2 - 1
    if window is not None:
        if window % 2 == 0 or not ORDER + 2 <= window <= longest:
            raise DataError(
                f"window={window} samples; use an odd number from {ORDER + 2} to {longest}"
            )
        chosen = window
    else:
        chosen = _window(z, longest)
    smooth = _weights(chosen, 0)
    noise = _residual(z, smooth)
    # sums round: a change of that size is no motion
    least = max(noise, _LAST_PLACES * float(np.nanmax(z) - np.nanmin(z)))
    weights = [_weights(chosen, k, step) for k in (1, 2, 3)]
    v, a, j = (_filtered(z, w) for w in weights)
    sd_v, sd_a, sd_j = (least * float(np.linalg.norm(w)) for w in weights)
    return Derivatives(v, a, j, chosen, noise, (sd_v, sd_a, sd_j))


def _weights(size: int, derivative: int, step: float = 1.0) -> FloatArray:
    """Return the weights of a local polynomial's derivative in the middle, as convolution wants.

    In Legendre polynomials of the scaled window: powers of the sample number lose five digits.
    """
    half = size // 2
    u = np.arange(-half, half + 1) / half
    q, r = np.linalg.qr(legendre.legvander(u, ORDER))
    at_zero = [
        float(legendre.legval(0.0, legendre.legder(np.eye(ORDER + 1)[i], derivative)))
        for i in range(ORDER + 1)
    ]
    weights = q @ np.linalg.solve(r.T, np.array(at_zero)) / (half * step) ** derivative
    return np.asarray(weights[::-1], dtype=np.float64)


def _window(z: FloatArray, longest: int) -> int:
    """Return the window of least expected error of the acceleration (Goldenshluger and Lepski).

    The bias of a window is what it differs from shorter ones by beyond what their noise explains.
    """
    if longest < ORDER + 2:
        raise TooFewSamplesError(
            f"velocity, acceleration and jerk need at least {ORDER + 4} samples, got {z.size}"
        )
    sizes = [ORDER + 2]
    while (following := int(sizes[-1] * 1.25) // 2 * 2 + 1) <= min(longest, z.size // 4):
        sizes.append(max(following, sizes[-1] + 2))
    noise = min(_residual(z, _weights(w, 0)) for w in sizes[:_SHORT])
    noise = max(noise, _ROUNDING * float(np.nanmax(z) - np.nanmin(z)))
    weights = [_weights(w, 2) for w in sizes]
    columns = [_filtered(z, w) for w in weights]
    costs = []
    for i, (own, column) in enumerate(zip(weights, columns, strict=True)):
        bias = 0.0
        for other, shorter in zip(weights[:i], columns[:i], strict=True):
            difference = own.copy()
            edge = (own.size - other.size) // 2
            difference[edge : own.size - edge] -= other
            seen = float(np.nanmean((column - shorter) ** 2)) if _any(column) else np.inf
            by_chance = 1.05 + 3.0 * math.sqrt(2.0 * other.size / z.size)
            bias = max(bias, seen - by_chance * noise**2 * float(difference @ difference))
        costs.append(bias + noise**2 * float(own @ own))
    return sizes[int(np.argmin(costs))]


def _any(column: FloatArray) -> bool:
    return not bool(np.isnan(column).all())


def _residual(z: FloatArray, smooth: FloatArray) -> float:
    """Return the noise that a window sees: RMS residual over the root of its freedom."""
    rest = z - _filtered(z, smooth)
    valid = rest[~np.isnan(rest)]
    if not valid.size:
        raise TooFewSamplesError(
            f"no {smooth.size} samples in a row were measured; log without gaps"
        )
    free = 1.0 - smooth[smooth.size // 2]
    return float(np.sqrt(np.mean(valid**2) / free))


def _filtered(z: FloatArray, weights: FloatArray) -> FloatArray:
    """Return a convolution, NaN where the window holds a sample that was not measured."""
    from scipy.signal import fftconvolve

    half = weights.size // 2
    gaps = np.isnan(z)
    result = np.full(z.size, np.nan)
    # the mean is put back by hand, so that a large position costs no digits
    level = float(z[~gaps].mean()) if not gaps.all() else 0.0
    convolve = np.convolve if weights.size < 64 else fftconvolve
    centred = np.where(gaps, 0.0, z - level)
    result[half : z.size - half] = convolve(centred, weights, mode="valid")
    result += level * round(float(weights.sum()))
    if gaps.any():
        near = np.convolve(gaps.astype(float), np.ones(weights.size), mode="same") > 0.5
        result[near] = np.nan
    return result


def shifted(z: FloatArray, step: float, delay: float) -> FloatArray:
    """Return z(t - delay) on the same grid, NaN where that lies outside the log or in a gap."""
    t = np.asarray(step * np.arange(z.size), dtype=np.float64)
    wanted = t - delay
    result = _resampled(t, z, wanted, step)
    result[(wanted < 0.0) | (wanted > t[-1])] = np.nan
    return result


def best_delay(
    command: FloatArray, actual: FloatArray, velocity: FloatArray, step: float
) -> tuple[float, float]:
    """Return by how much actual lags command, in s, and its residual RMS in m.

    Coarse by cross-correlation of the velocities, then Gauss-Newton on actual(t) = c(t - d) + b.
    """
    valid = ~(np.isnan(command) | np.isnan(actual))
    if valid.sum() < ORDER + 4:
        raise TooFewSamplesError(
            f"command and actual share {int(valid.sum())} samples; a delay needs {ORDER + 4}"
        )
    if not float(np.nanmax(velocity) - np.nanmin(velocity)) > 0.0:
        raise DegenerateFitError("the command does not move: no delay can be told from it")
    delay = _coarse(command, actual, valid) * step
    rms = np.inf
    for _ in range(30):
        c = shifted(command, step, delay)
        v = shifted(np.where(np.isnan(velocity), 0.0, velocity), step, delay)
        keep = ~(np.isnan(c) | np.isnan(actual))
        if keep.sum() < ORDER + 4:
            raise DegenerateFitError(
                f"the delay of {delay:.3g} s leaves no overlap of command and actual"
            )
        basis = np.column_stack([-v[keep], np.ones(int(keep.sum()))])
        rest = actual[keep] - c[keep]
        scale = np.linalg.norm(basis, axis=0)
        change = np.linalg.lstsq(basis / scale, rest, rcond=None)[0] / scale
        delay += float(change[0])
        rms = float(np.sqrt(np.mean((rest - basis @ change) ** 2)))
        if abs(change[0]) < 1e-9 * step:
            break
    return delay, rms


def delay_uncertainty(
    command: FloatArray, actual: FloatArray, velocity: FloatArray, step: float, delay: float
) -> float:
    """Return the standard uncertainty of a delay in s, from a residual that may be correlated."""
    c = shifted(command, step, delay)
    v = shifted(np.where(np.isnan(velocity), 0.0, velocity), step, delay)
    at = np.flatnonzero(~(np.isnan(c) | np.isnan(actual) | np.isnan(v)))
    basis = np.column_stack([-v[at], np.ones(at.size)])
    segments = np.cumsum(np.concatenate([[0], np.diff(at) > 1]))
    fit = regress(basis, actual[at] - c[at], segments, at=at)
    return float(np.sqrt(max(float(fit.cov[0, 0]), 0.0)))


def _coarse(command: FloatArray, actual: FloatArray, valid: NDArray[np.bool_]) -> int:
    from scipy.signal import fftconvolve

    a = np.where(valid, actual - actual[valid].mean(), 0.0)
    c = np.where(valid, command - command[valid].mean(), 0.0)
    reach = max(min(command.size // 4, 2000), 1)
    both = fftconvolve(a, c[::-1])
    middle = command.size - 1
    return int(np.argmax(both[middle - reach : middle + reach + 1])) - reach


# ---- what `follow_up` returns ------------------------------------------------------------------


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
