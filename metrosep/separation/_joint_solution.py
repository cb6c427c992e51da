"""Private to separation: what the joint solver returns, in the units of the runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.separation._joint_probe_test import ProbeDifference
from metrosep.separation._solver_state import SolverState
from metrosep.separation._unknowns import Lag, Unknown
from metrosep.separation.lines import FoundLine
from metrosep.separation.system import System
from metrosep.separation.terms import Terms
from metrosep.separation.weights import RowWeights
from metrosep.spectral.autoregressive import AutoregressiveModel

__all__ = ["LagTest", "Solution", "considered_amplitudes", "make_solution"]


@dataclass(frozen=True, slots=True)
class LagTest:
    """Lag beside the stated one and its u in s, its probability, and whether it was then fitted."""

    lag: float
    u: float
    probability: float
    fitted: bool


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Result of `solve_joint`, in the units of the runs."""

    origin: float  # m: of the basis; centre of the linear term
    period: float
    centre: float
    coefficients: FloatArray  # shape (1 + 2 K,): slope (rad), a_k, b_k (m)
    # shape (1 + 2 K, 1 + 2 K): posterior covariance with the share of the prior's spread
    covariance: FloatArray
    offsets: FloatArray  # shape (n_runs,), m: c_r at the centre
    offset_sd: FloatArray  # shape (n_runs,), m: their standard uncertainty
    # shape (K_first,): of every wavelength that was considered, before shrinkage; those beyond K
    # were dropped
    amplitude: FloatArray
    amplitude_sd: FloatArray
    chi2: FloatArray
    log_bayes_factor: FloatArray
    n_harmonics: int  # K, after the choice by evidence
    noise: list[AutoregressiveModel]  # one for each sampling interval, slowest first; heights in m
    residuals: list[FloatArray]  # of ndarray, m: readings minus model, NaN where not measured
    lag: float  # s: delay and its standard uncertainty (NaN if given)
    lag_sd: float
    freedom: float  # effective number of parameters
    terms: Terms  # drift, lines and waves, with their frequencies
    extra: FloatArray  # shape (n_extra,), m: coefficients of the terms
    unknowns: list[Unknown]  # lag, frequencies and gains that were fitted, with sd
    # shape (n, n): posterior covariance of slope, a_k, b_k, terms, unknowns, in that order
    joint_covariance: FloatArray
    weights: RowWeights | None  # where the fit was robust
    found: list[FoundLine]  # lines that were found, with their tests
    # of (float, int) or None: score statistic and degrees of freedom of a part that grows with the
    # square of the feed
    feed_test: tuple[float, int] | None
    # of (float, float, int): growth of the variance because probes share passes, correlation,
    # number of such pairs
    sharing: tuple[float, float, int]
    # of the sensitivities, where they were not fitted
    probe_differences: tuple[ProbeDifference, ...] = ()
    # where the feedrates can show a lag and it was not fitted in any case
    lag_test: LagTest | None = None
    # of ndarray, m: residuals, rejected samples replaced by what the noise model expects there:
    # for spectra
    bridged: Sequence[FloatArray] = ()
    # shape (1 + 2 K, 1 + 2 K): `covariance` without the share of the prior's spread
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
