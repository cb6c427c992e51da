"""Private to separation: what the joint solver returns, in the units of the runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from metrosep.separation._joint_probe_test import ProbeDifference
from metrosep.separation._solver_state import SolverState
from metrosep.separation._unknowns import Lag, Unknown
from metrosep.separation.lines import FoundLine
from metrosep.separation.system import System
from metrosep.separation.terms import Terms
from metrosep.separation.weights import RowWeights
from metrosep.spectral.autoregressive import AutoregressiveModel

__all__ = ["LagTest", "Solution", "considered_amplitudes", "make_solution"]

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class LagTest:
    """Lag beside the stated one and its u in s, its probability, and whether it was then fitted."""

    lag: float
    u: float
    probability: float
    fitted: bool


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
    terms : Terms
        Drift, lines and waves, with their frequencies.
    extra : ndarray, shape (n_extra,), m
        Coefficients of the terms.
    unknowns : list of Unknown
        Lag, frequencies and gains that were fitted, with sd.
    joint_covariance : ndarray, shape (n, n)
        Posterior covariance of slope, a_k, b_k, terms, unknowns, in that order.
    weights : RowWeights or None
        Where the fit was robust.
    found : list of FoundLine
        Lines that were found, with their tests.
    feed_test : tuple of (float, int) or None
        Score statistic and degrees of freedom of a part that grows with the square of the feed.
    sharing : tuple of (float, float, int)
        Growth of the variance because probes share passes, correlation, number of such pairs.
    probe_differences : tuple of ProbeDifference
        Of the sensitivities, where they were not fitted.
    lag_test : LagTest or None
        Where the feedrates can show a lag and it was not fitted in any case.
    bridged : sequence of ndarray, m
        Residuals, rejected samples replaced by what the noise model expects there: for spectra.
    plain_covariance : ndarray, shape (1 + 2 K, 1 + 2 K)
        `covariance` without the share of the prior's spread.
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
    terms: Terms
    extra: FloatArray
    unknowns: list[Unknown]
    joint_covariance: FloatArray
    weights: RowWeights | None
    found: list[FoundLine]
    feed_test: tuple[float, int] | None
    sharing: tuple[float, float, int]
    probe_differences: tuple[ProbeDifference, ...] = ()
    lag_test: LagTest | None = None
    bridged: Sequence[FloatArray] = ()
    plain_covariance: FloatArray = field(default_factory=lambda: np.empty((0, 0)))

    @property
    def kept_residuals(self) -> list[FloatArray]:
        """Residuals of the readings that the fit used: rejected ones are NaN."""
        if self.weights is None:
            return self.residuals
        pairs = zip(self.residuals, self.weights.marked, strict=True)
        return [np.where(marked, np.nan, residual) for residual, marked in pairs]


def considered_amplitudes(
    system: System, state: SolverState
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return amplitude, sd, chi-square and evidence of every wavelength, before shrinkage."""
    cavity = state.cavity
    assert cavity is not None  # noqa: S101  (set by iterate)
    a, b = cavity.mean
    return (
        np.hypot(a, b) * system.scale,
        system.scale / np.sqrt(cavity.precision.mean(axis=0)),
        cavity.chi2,
        state.weights.log_bayes_factor,
    )


def make_solution(
    system: System,
    state: SolverState,
    considered: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    found: list[FoundLine],
    feed_test: tuple[float, int] | None,
    differences: tuple[ProbeDifference, ...] = (),
    lag_test: LagTest | None = None,
) -> Solution:
    """Return the solution in the units of the runs; dropped wavelengths keep what was considered."""
    n, k, f = len(system.runs), system.n_harmonics, system.n_fixed
    assert state.covariance is not None  # noqa: S101  (set by iterate)
    covariance = state.covariance.copy()
    ia, ib = f + np.arange(k), f + k + np.arange(k)
    aa, bb, ab = state.weights.spread
    covariance[ia, ia] += aa
    covariance[ib, ib] += bb
    covariance[ia, ib] += ab
    covariance[ib, ia] += ab
    merged = [
        np.concatenate([new, old[k:]])
        for new, old in zip(considered_amplitudes(system, state), considered, strict=True)
    ]
    units = np.concatenate([[system.scale / system.half], np.full(2 * k, system.scale)])
    wanted = np.concatenate([[n], np.arange(f, f + 2 * k)])
    everything = np.concatenate([wanted, np.arange(n + 1, f)])
    all_units = np.concatenate(
        [
            units,
            np.full(system.terms.size, system.scale),
            [u.prior_sd for u in system.unknowns],
        ]
    )
    lag = next((u for u in system.unknowns if isinstance(u, Lag)), None)
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
        lag_sd=float("nan") if lag is None else lag.sd,
        freedom=state.freedom,
        terms=system.terms,
        extra=system.solution[system.extra] * system.scale,
        unknowns=system.unknowns,
        joint_covariance=covariance[np.ix_(everything, everything)]
        * all_units[:, None]
        * all_units,
        weights=system.weights,
        found=found,
        feed_test=feed_test,
        sharing=(*system.sharing, len(system.passes)),
        probe_differences=differences,
        lag_test=lag_test,
        bridged=_bridged(system),
        plain_covariance=state.covariance[np.ix_(wanted, wanted)] * units[:, None] * units,
    )


def _bridged(system: System) -> list[FloatArray]:
    """Return the residuals in m with rejected samples replaced by the noise model's expectation."""
    residuals = system.residuals()
    if system.weights is not None:
        residuals = system.weights.bridged(residuals, system.groups, system.noise)
    return [r * system.scale for r in residuals]
