"""Private helpers of follow-up logs: uniform time, noise-aware derivatives, delay."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, DegenerateFitError, NotUniformError, TooFewSamplesError
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.core.surface import Surface
from metrosep.process._plain import Frozen, OnPart, plain

if TYPE_CHECKING:
    import pandas as pd

    from metrosep.spectral.spectra import AmplitudeSpectrum

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
    # sums round: a change of that size is not motion
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
            gone = np.isnan(column).all()
            seen = np.inf if gone else float(np.nanmean((column - shorter) ** 2))
            by_chance = 1.05 + 3.0 * math.sqrt(2.0 * other.size / z.size)
            bias = max(bias, seen - by_chance * noise**2 * float(difference @ difference))
        costs.append(bias + noise**2 * float(own @ own))
    return sizes[int(np.argmin(costs))]


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
        raise DegenerateFitError("the command does not move: no delay follows from it")
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
class FollowUpMap(Frozen, OnPart):
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
        step = numbers.positive(step, "the step of the grid", dimension="length")
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
class FollowUp(Frozen):
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
        By how much actual lags the command; NaN if it cannot be determined.
    quantities : mapping of str to Quantity
        ``PV``, ``PV95``, ``RMS`` of the error in m, ``noise`` of the command in m.
    map : FollowUpMap or None
        Error over the part.
    audit : mapping
        Settings and counts, units in the keys.
    messages : tuple of str
        Hints and warnings.
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

        runs = stretches(~np.isnan(self.error))
        start, stop = max(runs, key=lambda run: run[1] - run[0], default=(0, 0))
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
        names = ("pv", "rms", "share", "significance")
        shares = {k: {n: getattr(s, n) for n in names} for k, s in self.shares.items()}
        found: dict[str, Any] = plain(
            {
                "coefficients": self.coefficients,
                "shares": shares,
                "r2": self.r2,
                "delay": self.delay,
                "quantities": self.quantities,
                "has_map": self.map is not None,
                "audit": self.audit,
                "messages": self.messages,
            }
        )
        return found

    def to_frame(self) -> pd.DataFrame:
        """Return one row for each term: coefficient, its uncertainty, P-V, RMS and share.

        Returns
        -------
        pandas.DataFrame
            Columns ``term coefficient u unit pv_nm rms_nm share significance``.
        """
        import pandas as pd

        fitted = [c for name, c in self.coefficients.items() if name != "c0"]
        rows = [
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
            for c, share in zip(fitted, self.shares.values(), strict=True)
        ]
        return pd.DataFrame(rows)


def stretches(used: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return start and stop of each run of samples that are used."""
    edges = np.diff(np.concatenate([[0], used.astype(int), [0]]))
    starts, stops = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    return list(zip(starts.tolist(), stops.tolist(), strict=True))


# ---- linear regression whose residuals are not independent, with honest uncertainty --------------

_CONDITION = 1e-9
"""Smallest singular value of the scaled design, relative, below which terms are one."""


@dataclass(frozen=True, slots=True)
class Regression:
    """Coefficients, covariance, residual and over how many samples the residual is correlated."""

    coefficients: FloatArray
    cov: FloatArray
    residual: FloatArray
    bandwidth: int
    inflation: float


def regress(
    basis: FloatArray,
    y: FloatArray,
    segments: NDArray[np.intp],
    *,
    at: NDArray[np.intp] | None = None,
) -> Regression:
    """Return least squares with a covariance that knows how the residuals hang together.

    `segments` numbers the stretches without a gap, `at` places the samples on the time grid; a
    gap counts as one sample where that is not known. Residuals that look less than independent are
    not believed, and noise that is larger where a term is large widens that term.
    """
    n, k = basis.shape
    if n < 2 * k + 4:
        raise TooFewSamplesError(f"{k} terms need at least {2 * k + 4} samples, got {n}")
    scale = np.linalg.norm(basis, axis=0)
    if (scale == 0.0).any():
        raise DegenerateFitError("a term of the regression is zero throughout; the axis stands")
    design = basis / scale
    u, s, vt = np.linalg.svd(design, full_matrices=False)
    if s[-1] < _CONDITION * s[0]:
        raise DegenerateFitError(
            "the terms of the regression cannot be distinguished in this motion; leave one out or "
            "log a motion of more than one frequency"
        )
    back = vt.T / s
    coefficients = back @ (u.T @ y)
    residual = y - design @ coefficients
    place = np.arange(n) + segments if at is None else at
    found = long_run(u, residual, place)
    cov = back @ found.cov @ back.T
    power = float(residual @ residual) / (n - k)
    white = back @ back.T * power
    inflation = 1.0
    if power > 0.0:
        scores = u * residual[:, None]
        uneven = back @ (scores.T @ scores) @ back.T / power
        least = np.diag(white)
        wider = np.sqrt(np.maximum(np.diag(uneven) / np.diag(back @ back.T), 1.0))
        wider = wider * np.sqrt(np.maximum(least / np.maximum(np.diag(cov), 1e-300), 1.0))
        cov = cov * np.outer(wider, wider)
        inflation = float(np.sqrt(np.max(np.diag(cov) / least)))
    return Regression(
        coefficients / scale,
        cov / np.outer(scale, scale),
        residual,
        math.ceil(found.samples),
        inflation,
    )


# ---- private: the covariance of sums over a residual that is not white, from models of its spectrum ----
# The noise is taken as stationary and independent of the motion. Autoregressive models are fitted
# to the residual (Burg, order by AIC) and to its means over blocks, which see slow noise below white
# noise; for each sum the largest variance counts.

_BLOCK_SIZES = (1, 4, 16, 64)
"""Samples of a block."""

_FEWEST = 60
"""Blocks that a model of them needs."""

_KEPT = 0.9
"""Of the square of every column: less of it left in the means of blocks, and these say nothing."""

_PATIENCE = 16
"""Orders without a better AIC after which the search ends."""

_NEAR_ONE = 1.0 - 1e-9
"""Largest reflection coefficient: the model stays stable."""


@dataclass(frozen=True, slots=True)
class LongRun:
    """Covariance of the sums Q'e of orthonormal columns, and how long the residual is correlated."""

    cov: FloatArray
    samples: float


def long_run(columns: FloatArray, residual: FloatArray, at: NDArray[np.intp]) -> LongRun:
    """Return the covariance of ``columns.T @ noise`` from the residual of a fit on these columns.

    `columns` (n, k) are orthonormal, `at` (n,) is the place of each sample on the even time grid.
    """
    k = columns.shape[1]
    power = float(residual @ residual)
    if power <= 0.0:
        return LongRun(np.zeros((k, k)), 1.0)
    size = int(at[-1] - at[0]) + 1
    place = at - at[0]
    total: FloatArray = np.zeros((k, k))
    slowest = 0.0
    for block in _BLOCK_SIZES:
        blocks = -(-size // block)
        q, r, count = _means(columns, residual, place, block, blocks)
        pieces = [r[a:b] for a, b in stretches(count >= 0.5 * block)]
        usable = sum(p.size for p in pieces)
        if block > 1 and (usable < _FEWEST or np.linalg.svd(q, compute_uv=False)[-1] ** 2 < _KEPT):
            break
        model = _burg(pieces, usable)
        cov, at_zero = _sums(q, *model)
        # the fit took its part of the noise away
        own = sum(float(p @ p) for p in pieces)
        expected = usable * _power(*model, 2 * blocks) - float(np.trace(cov))
        share = max(own / max(expected, 0.1 * own), 1.0)
        cov, slowest = cov * share, max(slowest, at_zero * share)
        if block == _BLOCK_SIZES[0]:
            total = cov
        else:
            wider = np.sqrt(np.maximum(np.diag(cov) / np.diag(total), 1.0))
            total = total * np.outer(wider, wider)
    return LongRun(total, max(slowest * residual.size / power, 1.0))


def _means(
    columns: FloatArray, residual: FloatArray, place: NDArray[np.intp], block: int, blocks: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return sums of columns and mean residual of blocks, scaled so that white noise stays."""
    if block == 1 and place.size == blocks:
        return columns, residual, np.ones(blocks)
    which = place // block
    count = np.bincount(which, minlength=blocks).astype(float)
    root = math.sqrt(block)
    q = np.column_stack([np.bincount(which, weights=c, minlength=blocks) for c in columns.T])
    r = np.bincount(which, weights=residual, minlength=blocks) / np.maximum(count, 1.0)
    return q / root, r * root, count


def _burg(pieces: list[FloatArray], n: int) -> tuple[FloatArray, float]:
    """Return coefficients (1, a1, a2 ...) and innovation variance of the order of least AIC."""
    forward, backward = [p.copy() for p in pieces], [p.copy() for p in pieces]
    variance = sum(float(p @ p) for p in pieces) / n
    a = np.array([1.0])
    best = (a, variance)
    least, order = n * math.log(max(variance, 1e-300)), 0
    for m in range(1, max(min(int(15.0 * math.log10(n)), n // 10), 0) + 1):
        forward, backward = [f[1:] for f in forward], [b[:-1] for b in backward]
        if sum(f.size for f in forward) < 0.5 * n:
            break
        both = list(zip(forward, backward, strict=True))
        below = sum(float(f @ f) + float(b @ b) for f, b in both)
        if below <= 0.0:
            break
        k = -2.0 * sum(float(f @ b) for f, b in both) / below
        k = min(max(k, -_NEAR_ONE), _NEAR_ONE)
        forward, backward = [f + k * b for f, b in both], [b + k * f for f, b in both]
        longer = np.append(a, 0.0)
        a = longer + k * longer[::-1]
        variance *= 1.0 - k * k
        score = n * math.log(max(variance, 1e-300)) + 2.0 * m
        if score < least:
            best, least, order = (a, variance), score, m
        elif m - order >= _PATIENCE:
            break
    return best


def _spectrum(a: FloatArray, variance: float, n: int) -> tuple[FloatArray, FloatArray]:
    """Return the two-sided density at the frequencies of rfft, and how often each one counts."""
    density = variance / np.maximum(np.abs(np.fft.rfft(a, n)) ** 2, 1e-300)
    weight = np.full(density.size, 2.0)
    weight[0] = 1.0
    if n % 2 == 0:
        weight[-1] = 1.0
    return density, weight


def _power(a: FloatArray, variance: float, n: int) -> float:
    """Return the variance of a model."""
    density, weight = _spectrum(a, variance, max(n, 8 * a.size))
    return float(density @ weight) / max(n, 8 * a.size)


def _sums(q: FloatArray, a: FloatArray, variance: float) -> tuple[FloatArray, float]:
    """Return Q' Gamma Q of a model, and the density at frequency zero."""
    from scipy.fft import next_fast_len

    n = next_fast_len(2 * q.shape[0], real=True)
    density, weight = _spectrum(a, variance, n)
    waves = np.fft.rfft(q, n, axis=0)
    cov = np.real((waves.conj().T * (density * weight)) @ waves) / n
    return np.asarray(0.5 * (cov + cov.T)), float(density[0])
