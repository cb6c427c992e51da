r"""Generalised least squares of all runs together: spatial Fourier basis, noise correlated in time.

Model, for reading i of run r with signed velocity v_r:

.. math:: z_r(t_i) = c_r + s\,x + \sum_k a_k \cos + b_k \sin (2 \pi k \tilde x / L_x) + n_r(t_i),
          \quad \tilde x = x_{enc} - v_r \tau

with :math:`L_x` 1.25 times the travel (the error need not be periodic over the travel), n an
autoregressive process in time that all runs of one sampling interval share, and the prior of
`metrosep.separation.runs.weights` on the pairs (a_k, b_k). Geometry is what sits at the same place
whatever the feedrate; noise is what sits at the same frequency.

Options add drift, lines, a part that grows with the feedrate, gains of probes and weights
(`metrosep.separation.runs.lines`, `unknowns`, `weights`); without them nothing of this changes.

Everything here is dimensionless: heights over their RMS, positions over half the travel.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Literal

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import (
    DataError,
    DegenerateFitError,
    InvalidSamplesError,
    TooFewSamplesError,
    UnitError,
)
from metrosep.separation._readings import positive, real_numbers
from metrosep.separation.runs._unknowns import Frequency, Gain, Lag, Unknown
from metrosep.separation.runs.design import PreparedRun
from metrosep.separation.runs.lines import FoundLine, Terms, find_line, nearest_power
from metrosep.separation.runs.options import JointOptions
from metrosep.separation.runs.system import System, whitened
from metrosep.separation.runs.weights import Cavity, OctavePrior, PriorWeights, RowWeights
from metrosep.spectral.autoregressive import AutoregressiveModel
from metrosep.spectral.spectra import Psd

__all__ = ["Solution", "TimeDensity", "solve_joint", "time_density"]

LAG_CHI2 = 12.0
"""Square of a lag over its uncertainty from which it is named and fitted: 5 in 10,000 by chance."""

LAG_PRIOR = 1e-3
"""Standard deviation in s of the lag of a machine that has one."""

AR_ORDERS = (1, 2, 4, 6, 8, 12, 16, 24, 32, 48)
"""Candidate orders of the noise model."""

_FIRST_INNER = 6

_WHITE_ROUNDS = 5
"""Rounds in which the noise is taken for white and its size is learnt."""


def _chosen_harmonics(weights: PriorWeights) -> int:
    """Return the number of harmonics of greatest evidence, with a margin of a tenth."""
    evidence = np.cumsum(weights.log_bayes_factor)
    best = int(np.argmax(evidence)) + 1 if evidence.max() > 0.0 else 1
    return min(max(best + max(2, best // 10), 8), evidence.size)


def _white_rounds(system: System, state: SolverState) -> None:
    """Learn how large the noise is before a model learns its colour.

    The first variance is a guess of half the spread of the readings. Where the noise is far below
    it, geometry is damped at first, and a model of high order would take what is left of it for
    noise of that colour: errors of tens of nm beside an uncertainty ten times too small.
    """
    for _ in range(_WHITE_ROUNDS):
        system.update_noise(state.freedom, (0,))
        iterate(system, state, _FIRST_INNER, learn_from=0)


def solve_joint(
    runs: Sequence[PreparedRun],
    *,
    origin: float,
    period: float,
    n_harmonics: int,
    choose_shortest: bool,
    lag: float,
    lag_mode: Literal["stated", "auto", "fit"],
    orders: Sequence[int] = AR_ORDERS,
    options: JointOptions | None = None,
    several_feeds: bool = True,
) -> Solution:
    """Estimate geometry, noise and prior from all runs together."""
    options = options or JointOptions()
    with one_blas_thread():
        terms = Terms(
            runs,
            drift=options.drift,
            locked=options.line_phase == "locked",
            several_feeds=several_feeds,
        )
        system = System(
            runs,
            origin=origin,
            period=period,
            n_harmonics=n_harmonics,
            terms=terms,
            robust=options.robust,
        )
        system.lag = lag
        state_terms(system, options)
        state = first_state(n_harmonics)
        iterate(system, state, _FIRST_INNER, learn_from=3)
        while system.mark_again():  # before a noise model can take what is wrong for noise
            state = first_state(n_harmonics)
            iterate(system, state, _FIRST_INNER, learn_from=3)
        if options.lines and options.lines != "auto":
            place_lines(system, options.lines)
            iterate(system, state, _FIRST_INNER, learn_from=3)
        if several_feeds:
            _white_rounds(system, state)
        system.update_noise(state.freedom, orders)
        iterate(system, state, INNER, learn_from=0)
        found = find_lines(system, state, options, orders)
        choose_waves(system, state, options, orders)
        considered = considered_amplitudes(system, state)
        if choose_shortest:
            _drop_short(system, state)
        for _ in range(4 if options.robust else 2):
            system.update_noise(state.freedom, orders)
            iterate(system, state, INNER, learn_from=0)
        lag_test = None
        if several_feeds and lag_mode != "fit" and options.following != "waves":
            lag_test = _tested_lag(system, state, correct=lag_mode == "auto")
        fit_lag = lag_mode == "fit" or (lag_test is not None and lag_test.fitted)
        fit_unknowns(system, state, wanted_unknowns(system, options, fit_lag), orders)
        if lag_test is not None and lag_mode == "auto" and not lag_test.fitted:
            _average_over_lag(system, state, lag_test)
        assert state.covariance is not None  # noqa: S101  (set by iterate)
        test = None
        if options.following in ("scale", "waves"):
            test = square_of_feed_score(system, state.covariance, kind=options.following)
        differences: tuple[ProbeDifference, ...] = ()
        if options.probe_gain == "equal":
            differences = probe_differences(system, state.covariance)
        return make_solution(system, state, considered, found, test, differences, lag_test)


def _tested_lag(system: System, state: SolverState, *, correct: bool) -> LagTest | None:
    """Return what the readings say of a lag beside the one at hand."""
    assert state.covariance is not None  # noqa: S101  (set by iterate)
    found = lag_score(system, state.covariance)
    if found is None:
        return None
    lag, u, _ = found
    sure = lag**2 > LAG_CHI2 * u**2 and u < LAG_PRIOR
    return LagTest(lag, u, _chance_of_lag(lag, u), fitted=correct and sure)


def _chance_of_lag(lag: float, u: float) -> float:
    """Return the probability of a lag N(0, LAG_PRIOR^2) against none, both as likely before."""
    both = u**2 + LAG_PRIOR**2
    odds = 0.5 * np.log(u**2 / both) + 0.5 * lag**2 * LAG_PRIOR**2 / (u**2 * both)
    return float(1.0 / (1.0 + np.exp(-odds)))


def _average_over_lag(system: System, state: SolverState, test: LagTest) -> None:
    """Take the mean of the solutions without and with the lag, weighted by their probabilities.

    A threshold would leave a lag just below it in the estimate and out of its uncertainty. The
    solution with the lag is the present one plus lag times its change, so the mean moves by
    p lag and its variance grows by p/I + p (1 - p) lag^2 along that change.
    """
    assert state.covariance is not None  # noqa: S101  (set by iterate)
    found = lag_score(system, state.covariance)
    if found is None or test.u > LAG_PRIOR:  # then nothing is known of a lag
        return
    lag, u, change = found
    p = _chance_of_lag(lag, u)
    system.solution = system.solution + p * lag * change
    variance = p * u**2 + p * (1.0 - p) * lag**2
    state.covariance = state.covariance + variance * np.outer(change, change)


def _drop_short(system: System, state: SolverState) -> None:
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


# ---- private to separation: what the joint solver returns, in the units of the runs ------------


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


# ---- private to separation: lines, waves and unknowns that the options add to the joint fit ----

_MAX_LINES = 6
"""Most lines that are looked for."""

_GAIN_PRIOR = 1.0
"""Standard deviation of a weak prior on the excess of a gain."""

_GAIN_STEP, _GAIN_DONE = 0.2, 1e-5


def state_terms(system: System, options: JointOptions) -> None:
    """Give the system the waves that the user stated."""
    system.terms.origin = system.origin
    waves = options.following_waves
    stated = options.following == "waves" and not isinstance(waves, int)
    system.set_terms(
        frequencies=(),
        wavenumbers=1.0 / np.array(waves) if stated else np.empty(0),
    )


def place_lines(system: System, stated: Sequence[float]) -> None:
    """Move stated lines to the nearest power, before a noise model can take them for noise."""
    residuals = system.residuals()
    if system.weights is not None:
        residuals = system.weights.clean(residuals, system.groups, system.noise)
    placed = [nearest_power(residuals, system.terms, f) for f in stated]
    system.set_terms(frequencies=placed, wavenumbers=system.terms.wavenumbers)


def find_lines(
    system: System, state: SolverState, options: JointOptions, orders: Sequence[int]
) -> list[FoundLine]:
    """Add lines one by one as long as the next one passes its test."""
    found: list[FoundLine] = []
    while options.lines == "auto" and len(found) < _MAX_LINES:
        residuals = system.residuals()
        if system.weights is not None:
            residuals = system.weights.clean(residuals, system.groups, system.noise)
        line = find_line(residuals, system.groups, system.terms, orders, level=options.false_alarm)
        if line is None:
            break
        found.append(line)
        system.set_terms(
            frequencies=[f.frequency for f in found], wavenumbers=system.terms.wavenumbers
        )
        iterate(system, state, 3, learn_from=0)
        system.update_noise(state.freedom, orders)
        iterate(system, state, INNER, learn_from=0)
    return found


def choose_waves(
    system: System, state: SolverState, options: JointOptions, orders: Sequence[int]
) -> None:
    """Let the strongest wavelengths of the geometry depend on the feedrate."""
    n = options.following_waves
    if options.following != "waves" or not isinstance(n, int):
        return
    a, b = np.split(system.solution[system.n_fixed :], 2)
    power = np.concatenate([[0.0], a**2 + b**2, [0.0]])
    peaks = [
        k
        for k in range(1, a.size + 1)
        if power[k] > 0.0 and power[k] >= power[k - 1] and power[k] > power[k + 1]
    ]
    chosen = sorted(peaks, key=lambda k: -power[k])[:n]
    around = [np.arange(k - 1, k + 2) for k in sorted(chosen)]
    centres = [float(power[w] @ w / power[w].sum()) for w in around]
    system.set_terms(
        frequencies=system.terms.frequencies, wavenumbers=np.array(centres) / system.period
    )
    system.update_noise(state.freedom, orders)
    iterate(system, state, INNER, learn_from=0)


def wanted_unknowns(system: System, options: JointOptions, fit_lag: bool) -> list[Unknown]:
    """Return the unknowns that the options ask for, the lag first."""
    unknowns: list[Unknown] = [Lag()] if fit_lag else []
    cell = 1.0 / max(float(np.ptp(r.t)) for r in system.runs)
    unknowns += [
        Frequency(0.5 * cell, 0.05 * cell, 1e-5 * cell, line=i)
        for i in range(len(system.terms.frequencies))
    ]
    gain = (_GAIN_PRIOR, _GAIN_STEP, _GAIN_DONE)
    if options.following == "scale":
        unknowns.append(Gain(*gain, lever=system.terms.relative_speed, name="following"))
    if options.probe_gain == "fit":
        names = [r.probe for r in system.runs]
        for probe in list(dict.fromkeys(names))[1:]:
            lever = np.array([float(n == probe) for n in names])
            unknowns.append(Gain(*gain, lever=lever, with_slope=True, name=probe))
    return unknowns


def fit_unknowns(
    system: System,
    state: SolverState,
    unknowns: Sequence[Unknown],
    orders: Sequence[int],
    *,
    n_max: int = 40,
) -> None:
    """Gauss-Newton: solve with the derivatives as columns, shift, repeat."""
    if not unknowns:
        return
    system.add_unknowns(unknowns)
    first = system.extra.stop
    for i in range(n_max):
        iterate(system, state, 3, learn_from=0)
        steps = []
        for j, unknown in enumerate(unknowns):
            step = float(system.solution[first + j]) * unknown.prior_sd
            step = float(np.clip(step, -unknown.largest_step, unknown.largest_step))
            unknown.shift(system, step)
            system.solution[first + j] = 0.0
            steps.append(abs(step) / unknown.done)
        if i < 4:
            system.update_noise(state.freedom, orders)
        if max(steps) < 1.0:
            break
    iterate(system, state, 3, learn_from=0)
    assert state.covariance is not None  # noqa: S101  (set by iterate)
    for j, unknown in enumerate(unknowns):
        unknown.sd = float(np.sqrt(state.covariance[first + j, first + j])) * unknown.prior_sd


# ---- private to separation: whether probes that were taken as equal have the same sensitivity ----
# A score test: one step of the gain from 1, at the solution without it, with its uncertainty.

_UNSEEN = 1e-6
"""Share of its information that must be left beside the other columns."""


@dataclass(frozen=True, slots=True)
class ProbeDifference:
    """Sensitivity of a probe against the first, as one step from equality shows it."""

    probe: str  # names
    first: str
    gain: float  # excess of the sensitivity: 0.05 reads 5 % more
    sd: float  # its standard uncertainty if the probes are equal


def probe_differences(system: System, covariance: FloatArray) -> tuple[ProbeDifference, ...]:
    """Return the difference of each probe from the first."""
    names = list(dict.fromkeys(r.probe for r in system.runs))
    if len(names) < 2:
        return ()
    n = system.n_fixed + 2 * system.n_harmonics
    score, own = np.zeros(len(names)), np.zeros(len(names))
    cross = np.zeros((n, len(names)))
    for group, model in zip(system.groups, system.noise, strict=True):
        for i in group:
            at = names.index(system.runs[i].probe)
            column = _shape(system, i)[:, None]
            rows, extra, rest, variance = whitened_rows(system, i, model, column)
            variance *= system.sharing[0]
            score[at] += float(extra[:, 0] @ rest) / variance
            own[at] += float(extra[:, 0] @ extra[:, 0]) / variance
            cross[:, at] += rows.T @ extra[:, 0] / variance
    information = own - np.einsum("ij,ik,kj->j", cross, covariance, cross)
    return tuple(
        ProbeDifference(
            names[j],
            names[0],
            float(score[j] / information[j]),
            float(1.0 / np.sqrt(information[j])),
        )
        for j in range(1, len(names))
        if information[j] > _UNSEEN * own[j] > 0.0
    )


def _shape(system: System, index: int) -> FloatArray:
    """Return the error with its slope in one run, which a gain multiplies."""
    run = system.runs[index]
    curve = system.basis(index) @ system.solution[system.n_fixed :]
    x = run.x - run.velocity * system.lag
    slope = system.solution[len(system.runs)] * (x - system.centre) / system.half
    return np.asarray(curve * system.gain[index] + slope * system.slope_gain[index])


# ---- private to separation: one step of the joint solver, coefficients and prior in turn -------

INNER = 12
"""Rounds of coefficients and prior for one noise model."""


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
class SolverState:
    """Prior, posterior covariance and effective parameters between two steps."""

    prior: OctavePrior
    weights: PriorWeights
    cavity: Cavity | None = None
    covariance: FloatArray | None = None
    freedom: float = 0.0


def iterate(system: System, state: SolverState, n_inner: int, *, learn_from: int) -> None:
    """Solve for the coefficients and the prior in turn, at a given noise model."""
    gram, right = system.normal_equations()
    f, k = system.n_fixed, system.n_harmonics
    ia, ib = f + np.arange(k), f + k + np.arange(k)
    for i in range(n_inner):
        precision = np.zeros(f + 2 * k)
        precision[f:] = np.tile(1.0 / state.weights.tau2, 2)
        precision[:f] = system.fixed_precision()
        mean, covariance = _posterior(gram, right, precision)
        variance = np.diag(covariance)
        state.freedom = f + float(np.sum(2.0 - (variance[ia] + variance[ib]) / state.weights.tau2))
        if system.terms.size:
            extra = system.extra
            held = float(system.terms.precision() @ variance[extra])
            state.freedom -= held
            system.terms.learn(mean[extra], variance[extra])
        state.cavity = Cavity.from_posterior(
            (mean[ia], mean[ib]),
            (variance[ia], variance[ib], covariance[ia, ib]),
            state.weights.tau2,
        )
        state.weights = state.prior.update(state.cavity, learn=i >= learn_from)
        system.solution, state.covariance = mean, covariance


def first_state(n_harmonics: int) -> SolverState:
    """Return the state before anything was learnt: every wavelength may be as strong as the runs."""
    nothing = np.zeros(n_harmonics)
    return SolverState(
        OctavePrior(n_harmonics),
        PriorWeights(np.full(n_harmonics, 0.25), nothing, (nothing, nothing, nothing)),
    )


# ---- one-sided density S(f) of the disturbance over time, from whatever the user has of it -----
# ``S`` is in m^2/Hz and one-sided: it integrates over f > 0 to the variance. Between two measured
# frequencies it is interpolated linearly. Below the first one its value is held, because every
# estimate of S ends at about one over the record length while long waves lie below it; above the
# last one S is not known and is NaN.

_LARGEST_RMS = 1e-4
"""m; a machine axis that shakes by more than 0.1 mm RMS is a mistake of units."""

_BAND = (1.0, 1e3)
"""Hz; a formula is integrated over it."""

_LINES = 4096


@dataclass(frozen=True, slots=True, eq=False)
class TimeDensity:
    """One-sided density of the disturbance over time.

    Parameters
    ----------
    function : callable
        S(f) for an array of frequencies in Hz, in m^2/Hz.
    lowest, highest : float, Hz
        Where it is known: 0 and infinity for a formula.
    source : str
        Where it came from, for the audit.
    """

    function: Callable[[FloatArray], Any]
    lowest: float
    highest: float
    source: str

    def __call__(self, frequency: FloatArray) -> FloatArray:
        """Return S at frequencies, held below the first known one, NaN above the last."""
        f = np.asarray(frequency, dtype=np.float64)
        known = f <= self.highest * (1.0 + 1e-12)
        out = np.full(f.shape, np.nan)
        at = np.clip(f[known], self.lowest, self.highest)
        try:
            values = real_numbers(self.function(at), "S(f)")
            out[known] = np.broadcast_to(np.asarray(values, dtype=np.float64), at.shape)
        except Exception as exc:
            raise InvalidSamplesError(
                f"S(f) must return one real density for each of {at.size} frequencies: "
                f"{type(exc).__name__}: {exc}"
            ) from exc
        bad = known & ~(np.isfinite(out) & (out > 0.0))
        if bad.any():
            raise InvalidSamplesError(
                f"the density of the disturbance is {out[bad][0]:.4g} m^2/Hz at "
                f"{f[bad][0]:.6g} Hz; it must be finite and above zero: add the noise of the "
                "sensor, no reading is free of it"
            )
        return out


def time_density(psd: Any, *, feed: float | None = None) -> TimeDensity:
    """Return the density of the disturbance over time from any of its usual forms.

    Parameters
    ----------
    psd : TimeDensity, Psd, DataFrame, tuple of arrays or callable
        A table with the columns ``frequency_hz`` and ``psd_nm2_per_hz`` as
        ``ErrorEstimate.residual_psd`` gives it; ``(f, S)`` in Hz and m^2/Hz; a function S(f); or
        a `Psd`, whose frequencies are Hz where it was computed over time.
    feed : float, m/s, optional
        For a `Psd` over position only: the feedrate at which that profile was recorded. Its
        waves per metre become ``f = feed * frequency`` and its density ``density / feed``.

    Returns
    -------
    TimeDensity
        Callable S(f).

    Raises
    ------
    DataError
        If it is none of these, or `feed` comes with something else than a `Psd`.
    InvalidSamplesError
        If frequencies do not rise, or a density is not finite and above zero.
    TooFewSamplesError
        If fewer than two frequencies above zero are given.
    UnitError
        If the density integrates to more than 0.1 mm RMS (a formula: over 1 Hz to 1 kHz).

    Notes
    -----
    The zero frequency is the mean, not a disturbance, and is left out. The column
    ``psd_nm2_per_hz`` is the measured density, not the model beside it.

    Examples
    --------
    >>> density = time_density(([1.0, 100.0], [1e-16, 3e-16]))
    >>> (density(np.array([0.5, 50.5, 200.0])) * 1e16).tolist()
    [1.0, 2.0, nan]
    """
    if isinstance(psd, TimeDensity):
        return psd
    if isinstance(psd, Psd):
        speed = 1.0 if feed is None else _positive_feed(feed)
        text = "Psd over time" if feed is None else f"Psd over position at {feed:.6g} m/s"
        return _sampled(psd.frequency * speed, psd.density / speed, text)
    if feed is not None:
        raise DataError("psd_feed is for a Psd over position only; leave it out")
    if callable(psd):
        formula = TimeDensity(psd, 0.0, math.inf, "function S(f)")
        f = np.geomspace(*_BAND, _LINES)
        _refuse_shaking(f, formula(f), " over 1 Hz to 1 kHz")
        return formula
    columns = getattr(psd, "columns", None)
    if columns is not None or isinstance(psd, dict):
        names = list(psd if columns is None else columns)
        if not {"frequency_hz", "psd_nm2_per_hz"} <= set(names):
            raise DataError(
                "the table of the density needs the columns frequency_hz and psd_nm2_per_hz, got "
                f"{names}"
            )
        density = np.asarray(psd["psd_nm2_per_hz"], dtype=np.float64) * 1e-18
        return _sampled(psd["frequency_hz"], density, "table psd_nm2_per_hz")
    if isinstance(psd, (tuple, list)) and len(psd) == 2:
        return _sampled(psd[0], psd[1], "samples (f, S)")
    raise DataError(
        "psd must be a table with frequency_hz and psd_nm2_per_hz, a tuple (f_Hz, S_m2_per_Hz), a "
        f"Psd or a function S(f), got {type(psd).__name__}"
    )


def _positive_feed(feed: float) -> float:
    return positive(feed, "psd_feed", "m/s")


def _sampled(frequency: Any, density: Any, source: str) -> TimeDensity:
    f = np.array(real_numbers(frequency, "the frequency"), dtype=np.float64)
    s = np.array(real_numbers(density, "the density"), dtype=np.float64)
    if f.ndim != 1 or f.shape != s.shape:
        raise InvalidSamplesError(
            f"frequency and density must be equally long lists, got shapes {f.shape} and {s.shape}"
        )
    if f.size and f[0] == 0.0:
        f, s = f[1:], s[1:]
    if f.size < 2:
        raise TooFewSamplesError(
            f"a density needs at least 2 frequencies above zero, got {f.size}; a result of "
            "method='mean' or 'kono' may have none: use method='joint'"
        )
    if not np.isfinite(f).all() or f[0] < 0.0 or not (np.diff(f) > 0.0).all():
        raise InvalidSamplesError("the frequencies of a density must be finite, >= 0 and rising")
    bad = ~(np.isfinite(s) & (s > 0.0))
    if bad.any():
        raise InvalidSamplesError(
            f"the density is {s[bad][0]:.4g} at {f[bad][0]:.6g} Hz; it must be finite and above "
            "zero at every frequency but zero"
        )
    _refuse_shaking(f, s, "")
    return TimeDensity(partial(_between, f, s), float(f[0]), float(f[-1]), source)


def _between(f: FloatArray, s: FloatArray, at: FloatArray) -> FloatArray:
    return np.interp(at, f, s)


def _refuse_shaking(f: FloatArray, s: FloatArray, where: str) -> None:
    rms = math.sqrt(float(np.sum(np.diff(f) * (s[1:] + s[:-1]) / 2.0)))
    if rms > _LARGEST_RMS:
        raise UnitError(
            f"the density integrates to {rms:.3g} m RMS{where}, more than any machine shakes; give "
            "m^2/Hz (1 um^2/Hz is 1e-12 m^2/Hz, 1 nm^2/Hz is 1e-18)"
        )


# ---- private to separation: score tests of what the fit left out: a square of the feed, a lag ----


def square_of_feed_score(
    system: System, covariance: FloatArray, *, kind: str
) -> tuple[float, int] | None:
    """Return the score test of a part that grows with the square of the feedrate."""
    rel = system.terms.relative_speed
    score, own, cross = _score(
        system, lambda i: _columns(system, i, kind) * (rel[i] ** 2 - float(np.mean(rel**2)))
    )
    information = own - cross.T @ covariance @ cross
    values, vectors = np.linalg.eigh(information)
    seen = values > 1e-6 * float(np.diag(own).max())
    if not seen.any():
        return None
    along = vectors[:, seen].T @ score
    return float(np.sum(along**2 / values[seen])), int(seen.sum())


def lag_score(system: System, covariance: FloatArray) -> tuple[float, float, FloatArray] | None:
    """Return the lag beside the one at hand, its u, and the change of the solution with it.

    With g the score and I the information that the other unknowns leave: lag = g/I, u = 1/sqrt(I),
    chi-square of 1 degree (lag/u)^2; the solution changes by - C b for each second, b the cross
    information.
    """
    column = Lag().column
    score, own, cross = _score(system, lambda i: column(system, i, system.basis(i))[:, None])
    along = covariance @ cross[:, 0]
    information = float(own[0, 0] - cross[:, 0] @ along)
    if information <= 1e-9 * float(own[0, 0]):
        return None
    return float(score[0]) / information, information**-0.5, -along


def _score(
    system: System, columns_of: Callable[[int], FloatArray]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return score, own and cross information of extra columns at the solution."""
    n, q = system.n_fixed + 2 * system.n_harmonics, columns_of(0).shape[1]
    score, own, cross = np.zeros(q), np.zeros((q, q)), np.zeros((n, q))
    for group, model in zip(system.groups, system.noise, strict=True):
        for i in group:
            rows, extra, rest, variance = whitened_rows(system, i, model, columns_of(i))
            variance *= system.sharing[0]
            score += extra.T @ rest / variance
            own += extra.T @ extra / variance
            cross += rows.T @ extra / variance
    return score, own, cross


def _columns(system: System, index: int, kind: str) -> FloatArray:
    if kind == "waves":
        return system.terms.waves(index)
    curve = system.basis(index) @ system.solution[system.n_fixed :]
    return np.asarray(curve[:, None])


def whitened_rows(
    system: System, index: int, model: AutoregressiveModel, columns: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Return whitened design, extra columns, residual and variance of a row."""
    design = np.hstack([system.design(index), columns])
    n = design.shape[1]
    variance = model.variance
    if system.weights is None:
        rows, values = whitened(design, system.z[index], model.coefficients)
    else:
        marks = system.weights.marks(index)
        rows, values = whitened(np.hstack([design, marks]), system.z[index], model.coefficients)
        rows, values = system.weights.apply(index, rows, values, n)
        variance /= system.weights.information(index)
    first = n - columns.shape[1]
    return rows[:, :first], rows[:, first:], values - rows[:, :first] @ system.solution, variance
