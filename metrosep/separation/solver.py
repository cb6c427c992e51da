r"""Generalised least squares of all runs together: spatial Fourier basis, noise correlated in time.

Model, for reading i of run r with signed velocity v_r:

.. math:: z_r(t_i) = c_r + s\,x + \sum_k a_k \cos + b_k \sin (2 \pi k \tilde x / L_x) + n_r(t_i),
          \quad \tilde x = x_{enc} - v_r \tau

with :math:`L_x` 1.25 times the travel (the error need not be periodic over the travel), n an
autoregressive process in time that all runs of one sampling interval share, and the prior of
`metrosep.separation.shrinkage` on the pairs (a_k, b_k). Geometry is what sits at the same place
whatever the feedrate; noise is what sits at the same frequency.

Everything here is dimensionless: heights over their RMS, positions over half the travel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import DegenerateFitError
from metrosep.separation.design import PreparedRun
from metrosep.separation.shrinkage import Cavity, OctavePrior, PriorWeights
from metrosep.spectral.autoregressive import AutoregressiveModel, fit_autoregressive
from metrosep.spectral.dft import fourier_basis

__all__ = ["Solution", "solve_joint"]

FloatArray = NDArray[np.float64]

AR_ORDERS = (1, 2, 4, 6, 8, 12, 16, 24, 32, 48)
"""Candidate orders of the noise model."""

_FIRST_INNER, _INNER = 6, 12
_BLOCK = 128
_LAG_PRIOR = 0.05
"""Standard deviation in s of a weak prior on the lag: a machine does not lag by seconds."""

_LAG_DONE = 1e-7
"""Change of the lag in s below which it has converged."""

_LAG_STEP = 2e-3
"""Largest change of the lag in s in one step: the model is linear in it over such a time."""


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Result of `solve_joint`, in the units of the runs.

    Parameters
    ----------
    origin, period, centre : float, m
        Of the basis; centre of the linear term.
    coefficients : ndarray, shape (1 + 2 K,)
        Slope (rad), a_k, b_k (m).
    covariance : ndarray, shape (1 + 2 K, 1 + 2 K)
        Posterior covariance with the share of the prior's spread.
    offsets : ndarray, shape (n_runs,), m
        c_r at the centre.
    offset_sd : ndarray, shape (n_runs,), m
        Their standard uncertainty.
    amplitude, amplitude_sd, chi2, log_bayes_factor : ndarray, shape (K_first,)
        Of every wavelength that was considered, before shrinkage; those beyond K were dropped.
    n_harmonics : int
        K, after the choice by evidence.
    noise : list of AutoregressiveModel
        One for each sampling interval, slowest first; heights in m.
    residuals : list of ndarray, m
        Readings minus model, NaN where not measured.
    lag, lag_sd : float, s
        Delay and its standard uncertainty (NaN if given).
    freedom : float
        Effective number of parameters.
    """

    origin: float
    period: float
    centre: float
    coefficients: FloatArray
    covariance: FloatArray
    offsets: FloatArray
    offset_sd: FloatArray
    amplitude: FloatArray
    amplitude_sd: FloatArray
    chi2: FloatArray
    log_bayes_factor: FloatArray
    n_harmonics: int
    noise: list[AutoregressiveModel]
    residuals: list[FloatArray]
    lag: float
    lag_sd: float
    freedom: float


class _System:
    """The linear system of one data set; grows a lag column and loses short wavelengths."""

    def __init__(
        self, runs: Sequence[PreparedRun], *, origin: float, period: float, n_harmonics: int
    ) -> None:
        self.runs = runs
        self.origin, self.period, self.n_harmonics = origin, period, n_harmonics
        stacked = np.concatenate([r.z - np.nanmean(r.z) for r in runs])
        rms = float(np.sqrt(np.nanmean(stacked**2)))
        if rms == 0.0:
            raise DegenerateFitError(
                "the readings are constant in every run: there is no error and no noise to "
                "separate; check that the sensor moved with the axis"
            )
        self.centre = float(np.mean([r.x.mean() for r in runs]))
        self.half = max(float(np.ptp(r.x)) for r in runs) / 2.0
        # The prior is relative to this scale, so the alignment slope must not be in it.
        self.scale = max(_rms_about_line(runs), 1e-9 * rms)
        self.z = [r.z / self.scale for r in runs]
        self.groups = _time_step_groups(runs)
        self.noise = [
            AutoregressiveModel(np.empty(0), 0.25, runs[g[0]].time_step) for g in self.groups
        ]
        self.lag = 0.0
        self.has_lag_column = False
        self.solution = np.zeros(len(runs) + 1 + 2 * n_harmonics)

    @property
    def n_fixed(self) -> int:
        return len(self.runs) + 1 + int(self.has_lag_column)

    def design(self, index: int) -> FloatArray:
        """Return columns: offsets of the runs, slope, [lag], cosines, sines."""
        run = self.runs[index]
        x = run.x - run.velocity * self.lag
        k = np.arange(1, self.n_harmonics + 1)
        basis = fourier_basis(x, origin=self.origin, period=self.period, n_harmonics=k.size)
        if run.block_length:
            basis *= np.tile(np.sinc(k * run.block_length / self.period), 2)
        fixed = np.zeros((x.size, self.n_fixed))
        fixed[:, index] = 1.0
        fixed[:, len(self.runs)] = (x - self.centre) / self.half
        if self.has_lag_column:
            cosine, sine = np.split(self.solution[self.n_fixed :], 2)
            wave = 2.0 * np.pi * k / self.period
            change = basis @ np.concatenate([wave * sine, -wave * cosine])
            slope = self.solution[len(self.runs)] / self.half
            fixed[:, -1] = -run.velocity * (change + slope) * _LAG_PRIOR
        return np.hstack([fixed, basis])

    def normal_equations(self) -> tuple[FloatArray, FloatArray, int]:
        """Return G, g of the whitened system in units of the noise, and the number of rows."""
        size = self.n_fixed + 2 * self.n_harmonics
        gram, right, n_rows = np.zeros((size, size)), np.zeros(size), 0
        for group, model in zip(self.groups, self.noise, strict=True):
            for i in group:
                rows, values = _whitened(self.design(i), self.z[i], model.coefficients)
                gram += rows.T @ rows / model.variance
                right += values @ rows / model.variance
                n_rows += values.size
        return gram, right, n_rows

    def residuals(self) -> list[FloatArray]:
        """Return readings minus model for each run, dimensionless."""
        return [z - self.design(i) @ self.solution for i, z in enumerate(self.z)]

    def update_noise(self, freedom: float, orders: Sequence[int]) -> None:
        """Fit the noise model of every group anew; its variance pays for the parameters."""
        residuals = self.residuals()
        total = sum(int((~np.isnan(r)).sum()) for r in residuals)
        models = []
        for group, old in zip(self.groups, self.noise, strict=True):
            own = [residuals[i] for i in group]
            shortest = min(r.size for r in own)
            allowed = [p for p in orders if p <= max(1, shortest // 8)]
            model, n_rows, _ = fit_autoregressive(
                own, orders=allowed or [1], time_step=old.time_step
            )
            share = freedom * n_rows / total
            factor = n_rows / max(n_rows - share - model.order, 1.0)
            models.append(
                AutoregressiveModel(model.coefficients, model.variance * factor, model.time_step)
            )
        self.noise = models

    def truncate(self, n_harmonics: int) -> None:
        """Drop the harmonics beyond `n_harmonics`."""
        fixed = self.solution[: self.n_fixed]
        cosine, sine = np.split(self.solution[self.n_fixed :], 2)
        self.solution = np.concatenate([fixed, cosine[:n_harmonics], sine[:n_harmonics]])
        self.n_harmonics = n_harmonics

    def add_lag_column(self) -> None:
        """Make the lag an unknown of the next solution."""
        self.solution = np.insert(self.solution, self.n_fixed, 0.0)
        self.has_lag_column = True


def _rms_about_line(runs: Sequence[PreparedRun]) -> float:
    """Return the RMS of the readings about one slope and an offset for each run."""
    pairs = [
        (r.x[v] - r.x[v].mean(), r.z[v] - r.z[v].mean()) for r in runs for v in [~np.isnan(r.z)]
    ]
    x, z = (np.concatenate(part) for part in zip(*pairs, strict=True))
    return float(np.sqrt(np.mean((z - (x @ z) / (x @ x) * x) ** 2)))


def _time_step_groups(runs: Sequence[PreparedRun]) -> list[list[int]]:
    groups: list[list[int]] = []
    for i in sorted(range(len(runs)), key=lambda j: -runs[j].time_step):
        if groups and runs[i].time_step > 0.99 * runs[groups[-1][0]].time_step:
            groups[-1].append(i)
        else:
            groups.append([i])
    return groups


def _whitened(
    design: FloatArray, values: FloatArray, coefficients: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Filter rows by blocks of a banded Toeplitz matrix; rows that touch a NaN are dropped."""
    p = coefficients.size
    invalid = np.isnan(values)
    table = np.hstack([design, np.where(invalid, 0.0, values)[:, None]])
    n_out = values.size - p
    if p:
        taps = np.concatenate([-coefficients[::-1], [1.0]])
        band = np.zeros((_BLOCK, _BLOCK + p))
        for row in range(_BLOCK):
            band[row, row : row + p + 1] = taps
        out = np.empty((n_out, table.shape[1]))
        for first in range(0, n_out, _BLOCK):
            size = min(_BLOCK, n_out - first)
            np.matmul(
                band[:size, : size + p],
                table[first : first + size + p],
                out=out[first : first + size],
            )
    else:
        out = table
    if invalid.any():
        touched = np.convolve(invalid.astype(np.float64), np.ones(p + 1))[p : p + n_out] > 0.5
        out = out[~touched]
    return out[:, :-1], out[:, -1]


def _posterior(
    gram: FloatArray, right: FloatArray, precision: FloatArray
) -> tuple[FloatArray, FloatArray]:
    from scipy.linalg.lapack import dpotrf, dpotri

    matrix = gram + np.diag(precision)
    scale = 1.0 / np.sqrt(np.diag(matrix))
    factor, info = dpotrf(matrix * scale[:, None] * scale, lower=1, clean=1)
    inverse = factor
    if info == 0:
        inverse, info = dpotri(factor, lower=1)
    if info != 0:
        raise DegenerateFitError(
            "the runs do not determine the model: two runs or wavelengths are indistinguishable; "
            "ask for longer wavelengths (shortest=) or add runs"
        )
    full = np.tril(inverse) + np.tril(inverse, -1).T
    covariance = full * scale[:, None] * scale
    return covariance @ right, covariance


@dataclass(slots=True)
class _State:
    prior: OctavePrior
    weights: PriorWeights
    cavity: Cavity | None = None
    covariance: FloatArray | None = None
    freedom: float = 0.0


def _iterate(system: _System, state: _State, n_inner: int, *, learn_from: int) -> None:
    """Solve for the coefficients and the prior in turn, at a given noise model."""
    gram, right, _ = system.normal_equations()
    f, k = system.n_fixed, system.n_harmonics
    ia, ib = f + np.arange(k), f + k + np.arange(k)
    for i in range(n_inner):
        precision = np.zeros(f + 2 * k)
        precision[f:] = np.tile(1.0 / state.weights.tau2, 2)
        if system.has_lag_column:
            precision[f - 1] = 1.0
        mean, covariance = _posterior(gram, right, precision)
        variance = np.diag(covariance)
        state.freedom = f + float(np.sum(2.0 - (variance[ia] + variance[ib]) / state.weights.tau2))
        state.cavity = Cavity.from_posterior(
            (mean[ia], mean[ib]),
            (variance[ia], variance[ib], covariance[ia, ib]),
            state.weights.tau2,
        )
        state.weights = state.prior.update(state.cavity, learn=i >= learn_from)
        system.solution, state.covariance = mean, covariance


def _chosen_harmonics(weights: PriorWeights) -> int:
    """Return the number of harmonics of greatest evidence, with a margin of a tenth."""
    evidence = np.cumsum(weights.log_bayes_factor)
    best = int(np.argmax(evidence)) + 1 if evidence.max() > 0.0 else 1
    return min(max(best + max(2, best // 10), 8), evidence.size)


def solve_joint(
    runs: Sequence[PreparedRun],
    *,
    origin: float,
    period: float,
    n_harmonics: int,
    choose_shortest: bool,
    lag: float,
    fit_lag: bool,
    orders: Sequence[int] = AR_ORDERS,
) -> Solution:
    """Estimate geometry, noise and prior from all runs together.

    Parameters
    ----------
    runs : sequence of PreparedRun
        All runs of one direction.
    origin, period : float, m
        Of the Fourier basis.
    n_harmonics : int
        Largest K to consider.
    choose_shortest : bool
        Whether to drop the short wavelengths that carry no evidence.
    lag : float, s
        Delay of the reading against the position, or the start value for the fit.
    fit_lag : bool
        Whether to fit the lag.
    orders : sequence of int, optional
        Candidate orders of the noise model.

    Returns
    -------
    Solution
        Coefficients, covariance, noise, residuals.

    Raises
    ------
    DegenerateFitError
        If the readings are constant or do not determine the model.
    """
    with one_blas_thread():
        system = _System(runs, origin=origin, period=period, n_harmonics=n_harmonics)
        system.lag = lag
        state = _State(
            OctavePrior(n_harmonics),
            PriorWeights(
                np.full(n_harmonics, 0.25), np.zeros(n_harmonics), (np.zeros(n_harmonics),) * 3
            ),
        )
        _iterate(system, state, _FIRST_INNER, learn_from=3)
        system.update_noise(state.freedom, orders)
        _iterate(system, state, _INNER, learn_from=0)
        considered = _considered(system, state)
        if choose_shortest:
            _drop_short(system, state)
        for _ in range(2):
            system.update_noise(state.freedom, orders)
            _iterate(system, state, _INNER, learn_from=0)
        if fit_lag:
            _fit_lag(system, state, orders)
        return _solution(system, state, considered, fit_lag=fit_lag)


def _drop_short(system: _System, state: _State) -> None:
    kept = _chosen_harmonics(state.weights)
    system.truncate(kept)
    state.prior.truncate(kept)
    state.weights = PriorWeights(
        state.weights.tau2[:kept],
        state.weights.log_bayes_factor[:kept],
        (
            state.weights.spread[0][:kept],
            state.weights.spread[1][:kept],
            state.weights.spread[2][:kept],
        ),
    )


def _fit_lag(system: _System, state: _State, orders: Sequence[int], *, n_max: int = 40) -> None:
    """Gauss-Newton on the lag: solve with its derivative as a column, shift, repeat."""
    system.add_lag_column()
    for i in range(n_max):
        _iterate(system, state, 3, learn_from=0)
        step = float(system.solution[system.n_fixed - 1]) * _LAG_PRIOR
        step = float(np.clip(step, -_LAG_STEP, _LAG_STEP))
        system.lag += step
        system.solution[system.n_fixed - 1] = 0.0
        if i < 4:
            system.update_noise(state.freedom, orders)
        if abs(step) < _LAG_DONE:
            break
    _iterate(system, state, 3, learn_from=0)


def _considered(
    system: _System, state: _State
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    cavity = state.cavity
    assert cavity is not None  # noqa: S101  (set by _iterate)
    a, b = cavity.mean
    return (
        np.hypot(a, b) * system.scale,
        system.scale / np.sqrt(cavity.precision.mean(axis=0)),
        cavity.chi2,
        state.weights.log_bayes_factor,
    )


def _solution(
    system: _System,
    state: _State,
    considered: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    *,
    fit_lag: bool,
) -> Solution:
    n, k, f = len(system.runs), system.n_harmonics, system.n_fixed
    assert state.covariance is not None  # noqa: S101  (set by _iterate)
    covariance = state.covariance.copy()
    ia, ib = f + np.arange(k), f + k + np.arange(k)
    aa, bb, ab = state.weights.spread
    covariance[ia, ia] += aa
    covariance[ib, ib] += bb
    covariance[ia, ib] += ab
    covariance[ib, ia] += ab
    merged = [
        np.concatenate([new, old[k:]])
        for new, old in zip(_considered(system, state), considered, strict=True)
    ]
    units = np.concatenate([[system.scale / system.half], np.full(2 * k, system.scale)])
    wanted = np.concatenate([[n], np.arange(f, f + 2 * k)])
    lag_sd = float("nan")
    if fit_lag:
        lag_sd = float(np.sqrt(state.covariance[f - 1, f - 1])) * _LAG_PRIOR
    return Solution(
        origin=system.origin,
        period=system.period,
        centre=system.centre,
        coefficients=system.solution[wanted] * units,
        covariance=covariance[np.ix_(wanted, wanted)] * units[:, None] * units,
        offsets=system.solution[:n] * system.scale,
        offset_sd=np.sqrt(np.diag(state.covariance)[:n]) * system.scale,
        amplitude=merged[0],
        amplitude_sd=merged[1],
        chi2=merged[2],
        log_bayes_factor=merged[3],
        n_harmonics=k,
        noise=[
            AutoregressiveModel(m.coefficients, m.variance * system.scale**2, m.time_step)
            for m in system.noise
        ],
        residuals=[r * system.scale for r in system.residuals()],
        lag=system.lag,
        lag_sd=lag_sd,
        freedom=state.freedom,
    )
