r"""Generalised least squares of all runs together: a random geometry, noise correlated in time.

.. math:: z_r(t_i) = c_r + (F_r g)(x_i) + p_r(x_i) + n_r(t_i)

g is the geometry (`geometry`), F_r the sensor (`sensor`), p_r what is tied to the position but
differs from run to run (`slip`), n_r an autoregression in time (`noise`). Geometry is what sits at
the same place whatever the feedrate; noise is what sits at the same frequency. One pass over the
samples makes the equations of each run (`system`); everything else works on these (`posterior`).

Options add drift, lines, a part that grows with the feedrate, gains of probes and weights
(`lines`, `weights`); without them nothing of this changes. Equation numbers are those
of separation-2.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal, NamedTuple

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    TooFewSamplesError,
    UnitError,
)
from metrosep.separation._readings import positive, real_numbers
from metrosep.separation.runs import sensor as sensor_room
from metrosep.separation.runs.design import PreparedRun
from metrosep.separation.runs.geometry import (
    PERIOD_SHARE,
    SLOPE,
    SLOPE_SD,
    Sensor,
    Spectrum,
    extension,
    filtered,
)
from metrosep.separation.runs.leave_out import Displacement, RunScore, displacement, run_scores
from metrosep.separation.runs.lines import (
    FoundLine,
    Terms,
    Unknown,
    find_line,
    nearest_power,
    wanted_unknowns,
)
from metrosep.separation.runs.noise import MOST, WITNESS
from metrosep.separation.runs.options import JointOptions
from metrosep.separation.runs.posterior import Answer, Model, Posterior, averaged
from metrosep.separation.runs.system import System
from metrosep.separation.runs.waves import (
    FALSE_ALARM,
    FALSE_DISCOVERY,
    FoundWave,
    SlippingWave,
    find_slip,
    found_waves,
    learn_slip,
    place_slip,
    remove_weak,
    search,
    seed_slip,
    slipping_waves,
    taken_for_noise,
)
from metrosep.separation.runs.weights import RowWeights
from metrosep.spectral.autoregressive import AutoregressiveModel
from metrosep.spectral.spectra import Psd

CONSTANTS: dict[str, float] = {
    "basis_period_over_travel": PERIOD_SHARE,
    "prior_slope": SLOPE,
    "prior_slope_sd": SLOPE_SD,
    "prior_lag_ms": sensor_room.LAG_PRIOR * 1e3,
    "false_alarm_waves": FALSE_ALARM,
    "false_discovery_slip": FALSE_DISCOVERY,
    "noise_order_most": MOST,
    "noise_level_degrees": WITNESS,
}
"""What is not learnt: priors and error rates; none of them is tuned to a coverage."""

AR_ORDERS = (1, 2, 4, 6, 8, 12, 16, 24, 32, 48)
"""Candidate orders of the noise model beside which a line is looked for."""

_WHITE_ROUNDS, _SETTLED = 30, 0.7
"""Most rounds in which the noise is taken for white and its size is learnt, and the ratio of two
sizes from which it counts as settled: where it is far below the first guess, a model of high order
would take damped geometry for noise of that colour."""


def solve_joint(
    runs: Sequence[PreparedRun],
    *,
    travel: tuple[float, float],
    origin: float,
    n_harmonics: int,
    lag: float,
    lag_mode: Literal["stated", "auto", "fit"],
    options: JointOptions | None = None,
    several_feeds: bool = True,
    set_up_anew: bool = False,
    named: Sequence[int] = (),
) -> Solution:
    """Estimate geometry, noise, sensor and slip from all runs together (3.3); the named runs are odd."""
    options = options or JointOptions()
    with one_blas_thread():
        terms = Terms(
            runs,
            drift=options.drift,
            locked=options.line_phase == "locked",
            several_feeds=several_feeds,
            set_up_anew=set_up_anew,
        )
        ext = extension(travel[0], travel[1] - travel[0], n_harmonics, origin)
        system = System(runs, extension=ext, terms=terms, robust=options.robust)
        state_terms(system, options)
        model = Model(ext, Spectrum(n_harmonics), line_sd=system.line_sd)
        model.slip_is_geometry = options.slip == "geometry"
        model.sensor = Sensor(lag)
        seek_lag = several_feeds and lag_mode != "stated" and options.following != "waves"
        if lag_mode == "auto":
            model.lag_prior = sensor_room.LAG_PRIOR
        _pass(system, model, most=12)
        while system.mark_again(model):  # before a noise model takes what is wrong for noise
            _pass(system, model, most=6)
        if options.lines and options.lines != "auto":
            place_lines(system, model, options.lines)
            _pass(system, model, most=6)
        _learn_noise(system, model)
        while not options.position_offsets and (place := taken_for_noise(system, model)):
            system.start_noise()  # a peak that was learnt of it would stay beside it
            _pass(system, model, most=12)
            seed_slip(model, place)
            _learn_noise(system, model)
        found = find_lines(system, model, options)
        choose_following(system, model, options)
        sure = lag_mode == "fit"
        if seek_lag and sure:
            sensor_room.scan_lag(model)
            if model.sensor.lag:
                _pass(system, model, most=10, order=None, above=2.0)
        search(model, options.waves)
        if seek_lag:
            sensor_room.lag_steps(model, sure=sure)
        find_slip(model)
        model.drop_short()
        for i in range(4):
            _pass(system, model, most=6, order=None, above=0.5 if i else 2.0)
            if i == 1:
                search(model)
                remove_weak(model)
                place_slip(model)
                find_slip(model)
            if seek_lag:
                sensor_room.lag_steps(model, sure=sure)
            if seek_lag and i < 3:
                sensor_room.better_split(model)
            learn_slip(model, 8)
        scores = run_scores(model, named)
        # Places that are fitted count once, by what was fitted.
        displaced = (
            Displacement() if options.position_offsets else displacement(model, scores, named)
        )
        model.lag_variances, model.places = displaced.lags, displaced.places
        unpredicted = [system.rest(i, model, s.theta) for i, s in enumerate(scores)]
        model.kept = n_harmonics
        _pass(system, model, most=7, order=None, above=1.0)
        if seek_lag:
            sensor_room.lag_steps(model, sure=sure)
        unknowns = wanted_unknowns(system, options)
        fit_unknowns(system, model, unknowns)
        solution = make_solution(
            system, model, found, options, lag_mode, scores, several_feeds=several_feeds
        )
        return replace(
            solution.displaced_by(displaced.of_mean),
            displaced=displaced,
            unpredicted=[r * system.scale for r in unpredicted],
        )


def _learn_noise(system: System, model: Model) -> None:
    """Learn the size of white noise until it settles, then noise with memory."""
    for i in range(_WHITE_ROUNDS):
        before = [n.variance for n in system.noise]
        _pass(system, model, most=5, order=0)
        pairs = zip(system.noise, before, strict=True)
        if i >= 2 and all(n.variance > _SETTLED * old for n, old in pairs):
            break
    for _ in range(2):
        _pass(system, model, most=10, order=None, above=2.0)


def _pass(
    system: System,
    model: Model,
    *,
    most: int,
    above: float = 0.0,
    order: int | None = -1,
) -> None:
    """Learn the noise (order: None the highest, -1 not), pass over the samples, learn the geometry."""
    before = [n.variance for n in system.noise]
    if order != -1:
        system.update_noise(model, most=order)
    model.n_extra = system.size - system.n_basis
    model.extra_precision = system.extra_precision()
    if order == 0 and model.runs and system.weights is None:  # white as before: only its size
        model.take(system.rescaled(model.runs, before))
    else:
        model.take(system.equations(model))
    model.learn(most, above=above)
    for _ in range(4 if system.terms.drift else 0):
        assert model.post is not None  # noqa: S101  (set by learn)
        spread = np.sum(model.post.full_root**2, axis=1)
        system.terms.learn(model.post.theta[system.extra], spread[system.extra])
        model.extra_precision = system.extra_precision()
        model.learn(2)


# ---- private to separation: what the joint solver returns, in the units of the runs ------------


@dataclass(frozen=True, slots=True)
class LagTest:
    """Lag beside the stated one and its u in s, its probability, and whether it was corrected."""

    lag: float
    u: float
    probability: float
    chi2: float  # by how much it explains the readings better: chi-square of 1 degree by chance
    fitted: bool
    spread: float = 0.0  # s^2: of the split into delay and time constant


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
    # shape (waves + K, 4): amplitude (m), phase (rad), its sd (m), chi-square of 2 degrees: of the
    # free waves, then of each harmonic of the broad part
    rows: FloatArray
    n_harmonics: int
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
    # of ndarray, shape (n, draws), m: draws of the noise, which hold what the geometry took of it
    noise_draws: Sequence[FloatArray] = ()
    # shape (1 + 2 K, 1 + 2 K): `covariance` without the share of the prior's spread
    plain_covariance: FloatArray = field(default_factory=lambda: np.empty((0, 0)))
    waves: Sequence[FoundWave] = ()  # of free wavelength, that the coefficients hold; in m
    slip: Sequence[SlippingWave] = ()  # longest first
    slope_of_spectrum: float = math.nan  # d ln s^2 / d ln k
    scores: Sequence[RunScore] = ()  # of each run against the others
    unpredicted: Sequence[FloatArray] = ()  # m: readings minus what the other runs predict
    displaced: Displacement = field(default_factory=Displacement)  # of each run along the axis

    def displaced_by(self, variance: float) -> Solution:
        """Return the solution with what a displacement of all runs adds to its covariances; m^2."""
        w = 2.0 * math.pi * np.arange(1, self.n_harmonics + 1) / self.period
        along = filtered(self.coefficients, np.asarray(-1j * w))  # of -g'; the line only moves
        along[0] = 0.0
        more = variance * np.outer(along, along)
        joint = self.joint_covariance.copy()
        joint[: along.size, : along.size] += more
        return replace(
            self,
            covariance=self.covariance + more,
            plain_covariance=self.plain_covariance + more,
            joint_covariance=joint,
        )

    @property
    def kept_residuals(self) -> list[FloatArray]:
        """Residuals of the readings that the fit used: rejected ones are NaN."""
        if self.weights is None:
            return self.residuals
        pairs = zip(self.residuals, self.weights.marked, strict=True)
        return [np.where(marked, np.nan, residual) for residual, marked in pairs]


class _WithLag(NamedTuple):
    """The mean over the splits of a lag, with what it leaves open."""

    answer: Answer
    lag: float  # s: mean and standard uncertainty
    u: float
    read: float  # s: without its prior, and its variance in s^2 with the runs where they are
    own: float
    gain: float  # of ln evidence, of the likeliest split, from the lag to the one that is read


def _answer_with_lag(model: Model) -> _WithLag:
    """Return the mean over the splits of a lag."""
    parts = sensor_room.splits(model)
    weights = [p.weight for p in parts]

    def mean(values: Sequence[float], variances: Sequence[float]) -> tuple[float, float]:
        middle = float(np.dot(weights, values))
        return middle, float(np.dot(weights, variances + (np.array(values) - middle) ** 2))

    lag, variance = mean([p.lag for p in parts], [p.variance for p in parts])
    read, own = mean([p.read for p in parts], [p.own for p in parts])
    one, gain = _mean_answer(weights, [p.answer for p in parts]), parts[np.argmax(weights)].gain
    return _WithLag(one, lag, math.sqrt(variance), read, own, gain)


def _mean_answer(weights: Sequence[float], answers: Sequence[Answer]) -> Answer:
    means = [a.mean for a in answers]
    mean, covariance = averaged(weights, means, [a.covariance for a in answers])
    _, plain = averaged(weights, means, [a.plain for a in answers])
    return Answer(mean, covariance, plain)


_UNKNOWN_LAG = 2e-3
"""Standard uncertainty in s of a lag of which nothing is known: of none or one."""


def _with_and_without_lag(
    model: Model, stated: float, mode: str, *, several_feeds: bool
) -> tuple[Answer, LagTest | None]:
    """Return the answer averaged over no lag and the lag that was found (eq. 22)."""
    at = sensor_room.lag_score(model) if several_feeds else None
    if at is None:
        return model.answer(), None
    if mode == "fit" and at.u > _UNKNOWN_LAG and at.hidden(model.sensor.lag - stated):
        model.back_to((Sensor(stated), *model.state()[1:]))
        model.learn(4)
        return model.answer(), LagTest(0.0, at.u, 0.0, 0.0, fitted=False)
    if mode == "fit":
        one = _answer_with_lag(model)
        lag = one.lag - stated
        chi2, spread = (lag / one.u) ** 2, model.sensor.spread
        return one.answer, LagTest(lag, one.u, 1.0, chi2, fitted=True, spread=spread)
    found = model.state()
    if mode == "auto" and model.sensor != Sensor(stated):
        model.back_to((Sensor(stated), *found[1:]))
        model.learn(4)
    if mode == "stated" or at.hidden(found[0].lag - stated):
        at = sensor_room.lag_score(model) or at
        p = sensor_room.chance_of_lag(at.lag, at.own, displaced=model.lag_variances)
        chi2 = (at.lag / at.u) ** 2
        return model.answer(), LagTest(at.lag, at.u, p, chi2, fitted=False)
    none, without = model.answer(), model.state()
    least = model.log_evidence(model.solve())
    # Where short waves are strong the likelihood of a lag has several tops: the steps start from
    # none as well as from what was found, and the better one counts by its evidence.
    sensor_room.lag_steps(model)
    other, most = model.state(), model.log_evidence(model.solve())
    model.back_to(found)
    if model.log_evidence(model.solve()) < most:
        model.back_to(other)
        model.solve()
    gain = max(model.log_evidence(model.solve()) - least, 0.0)
    one = _answer_with_lag(model)
    gain += one.gain
    p = sensor_room.chance_of_lag(one.read, one.own, gain, displaced=model.lag_variances)
    chi2 = min(one.read**2 / (one.own + model.lag_variance), 2.0 * gain)
    test = LagTest(one.lag, one.u, p, chi2, fitted=True, spread=model.sensor.spread)
    if p < 0.5:  # residuals and noise are shown for the likelier of the two
        model.back_to(without)
        model.solve()
    return _mean_answer([p, 1.0 - p], [one.answer, none]), test


def make_solution(
    system: System,
    model: Model,
    found: list[FoundLine],
    options: JointOptions,
    lag_mode: str,
    scores: list[RunScore],
    *,
    several_feeds: bool,
) -> Solution:
    """Return the solution in the units of the runs."""
    stated = 0.0 if lag_mode != "stated" else model.sensor.lag
    answer, lag_test = _with_and_without_lag(
        model,
        stated,
        lag_mode,
        several_feeds=several_feeds and options.following != "waves",
    )
    post = model.post
    assert post is not None  # noqa: S101  (set by the answer)
    k, n = model.extension.n, system.n_basis
    half = 0.5 * model.extension.travel
    units = np.concatenate(
        [
            [system.scale / half],
            np.full(2 * k + system.terms.size, system.scale),
            [u.prior_sd for u in system.unknowns],
        ]
    )
    covariance = answer.covariance * units[:, None] * units
    mean = answer.mean * units
    mean[0] += system.slope
    feed_test = None
    if options.following in ("scale", "waves"):
        feed_test = square_of_feed_score(system, model, kind=options.following)
    differences: tuple[ProbeDifference, ...] = ()
    if options.probe_gain == "equal":
        differences = probe_differences(system, model)
    levels = system.levels(model, post)
    residuals = [r * system.scale for r in system.residuals(model)]
    lag, lag_sd = _lag(stated, lag_test)
    return Solution(
        origin=model.extension.origin,
        period=model.extension.period,
        centre=model.extension.start + half,
        coefficients=mean[:n],
        covariance=covariance[:n, :n],
        offsets=np.array([level for level, _ in levels]) * system.scale,
        offset_sd=_offset_sd(model, post) * system.scale,
        rows=_rows(model, post) * np.array([system.scale, 1.0, system.scale, 1.0]),
        n_harmonics=k,
        noise=[
            AutoregressiveModel(m.coefficients, m.variance * system.scale**2, m.time_step)
            for m in system.noise
        ],
        residuals=residuals,
        lag=lag,
        lag_sd=lag_sd,
        freedom=_freedom(model, post),
        terms=system.terms,
        extra=mean[system.extra],
        unknowns=system.unknowns,
        joint_covariance=covariance,
        weights=system.weights,
        found=found,
        feed_test=feed_test,
        sharing=(*system.sharing, len(system.passes)),
        probe_differences=differences,
        lag_test=lag_test,
        bridged=_bridged(system, residuals),
        noise_draws=_noise_draws(system, model, residuals),
        plain_covariance=(answer.plain * units[:, None] * units)[:n, :n],
        waves=[w.in_units(system.scale) for w in found_waves(model)],
        slip=slipping_waves(model, answer, system.scale),
        slope_of_spectrum=float(
            (model.spectrum.phi[-1] - model.spectrum.phi[0]) / math.log(max(k, 2))
        ),
        scores=scores,
    )


def _lag(stated: float, test: LagTest | None) -> tuple[float, float]:
    """Return the mean lag and its standard uncertainty over both answers; NaN if given."""
    if test is None or not test.fitted:
        return stated, math.nan
    p = test.probability
    u = math.sqrt(p * test.u**2 + p * (1.0 - p) * test.lag**2)
    return stated + p * test.lag, u


def _rows(model: Model, post: Posterior) -> FloatArray:
    """Return amplitude, phase, sd and chi-square of the free waves and of each harmonic beside them."""
    n = int(model.harmonics().sum())  # all K in the last solution
    covariance = post.root @ post.root.T
    pairs = [(part.start, part.start + 1) for part in model.wave_parts()]
    order = np.argsort([model.waves[i].wavenumber for i in range(len(pairs))], kind="stable")
    pairs = [pairs[i] for i in order] + [(1 + k, 1 + n + k) for k in range(n)]
    a, b = (post.mean[list(at)] for at in zip(*pairs, strict=True))
    i, j = (np.array(at) for at in zip(*pairs, strict=True))
    aa, bb, ab = covariance[i, i], covariance[j, j], covariance[i, j]
    det = np.maximum(aa * bb - ab**2, 1e-300)
    chi2 = (bb * a**2 - 2.0 * ab * a * b + aa * b**2) / det
    return np.column_stack([np.hypot(a, b), -np.arctan2(b, a), np.sqrt(0.5 * (aa + bb)), chi2])


def _offset_sd(model: Model, post: Posterior) -> FloatArray:
    """Return the standard uncertainty of the offset of every run."""
    root = post.full_root
    out = []
    for run in model.runs:
        h = model.sensor.response(model.extension.wavenumbers, run.velocity)
        along = filtered(run.level, np.conj(h)) @ root
        out.append(math.sqrt(1.0 / run.level_information + float(along @ along)))
    return np.array(out)


def _freedom(model: Model, post: Posterior) -> float:
    """Return the effective number of parameters."""
    spread = post.spread
    return len(model.runs) + float(np.sum(1.0 - model.precision() * spread))


def _noise_draws(system: System, model: Model, residuals: list[FloatArray]) -> list[FloatArray]:
    """Return draws of the noise of every run (11), rejected samples as in `_bridged`."""
    more = zip(system.draws(model), _bridged(system, residuals), residuals, strict=True)
    return [d * system.scale + (b - r)[:, None] for d, b, r in more]


def _bridged(system: System, residuals: list[FloatArray]) -> list[FloatArray]:
    """Return the residuals in m with rejected samples replaced by the noise model's expectation."""
    if system.weights is None:
        return residuals
    return system.weights.bridged(residuals, system.groups, system.noise)


# ---- private to separation: lines, waves and unknowns that the options add to the joint fit ----

_MAX_LINES = 6
"""Most lines that are looked for."""


def state_terms(system: System, options: JointOptions) -> None:
    """Give the system the waves that the user stated to grow with the feedrate."""
    system.terms.origin = system.extension.origin
    waves = options.following_waves
    stated = options.following == "waves" and not isinstance(waves, int)
    system.set_terms(
        frequencies=(),
        wavenumbers=1.0 / np.array(waves) if stated else np.empty(0),
    )


def _cleaned(system: System, model: Model) -> list[FloatArray]:
    residuals = system.residuals(model)
    if system.weights is not None:
        residuals = system.weights.clean(residuals, system.groups, system.noise)
    return residuals


def place_lines(system: System, model: Model, stated: Sequence[float]) -> None:
    """Move stated lines to the nearest power, before a noise model can take them for noise."""
    residuals = _cleaned(system, model)
    placed = [nearest_power(residuals, system.terms, f) for f in stated]
    system.set_terms(frequencies=placed, wavenumbers=system.terms.wavenumbers)


def find_lines(system: System, model: Model, options: JointOptions) -> list[FoundLine]:
    """Add lines one by one as long as the next one passes its test."""
    found: list[FoundLine] = []
    while options.lines == "auto" and len(found) < _MAX_LINES:
        line = find_line(
            _cleaned(system, model),
            system.groups,
            system.terms,
            AR_ORDERS,
            level=options.false_alarm,
        )
        if line is None:
            break
        found.append(line)
        system.set_terms(
            frequencies=[f.frequency for f in found], wavenumbers=system.terms.wavenumbers
        )
        # A peak that the noise has learnt of a line would stay beside it: nothing else is read there.
        system.start_noise()
        _pass(system, model, most=3)
        _learn_noise(system, model)
    return found


def choose_following(system: System, model: Model, options: JointOptions) -> None:
    """Let the strongest wavelengths of the geometry depend on the feedrate."""
    n = options.following_waves
    if options.following != "waves" or not isinstance(n, int):
        return
    assert model.post is not None  # noqa: S101  (after a pass)
    a, b = np.split(model.post.theta[1 : system.n_basis], 2)
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
        frequencies=system.terms.frequencies,
        wavenumbers=np.array(centres) / system.extension.period,
    )
    _pass(system, model, most=3)
    _pass(system, model, most=6, order=None, above=1.0)


def fit_unknowns(
    system: System, model: Model, unknowns: Sequence[Unknown], *, n_max: int = 40
) -> None:
    """Gauss-Newton: pass with the derivatives as columns, shift, repeat."""
    if not unknowns:
        return
    system.unknowns += list(unknowns)
    first = system.extra.stop
    for i in range(n_max):
        _pass(system, model, most=2, order=None if 0 < i < 4 else -1)
        assert model.post is not None  # noqa: S101  (set by the pass)
        steps = []
        for j, unknown in enumerate(unknowns):
            step = float(model.post.theta[first + j]) * unknown.prior_sd
            step = float(np.clip(step, -unknown.largest_step, unknown.largest_step))
            unknown.shift(system, step)
            steps.append(abs(step) / unknown.done)
        if max(steps) < 1.0:
            break
    _pass(system, model, most=2)
    assert model.post is not None  # noqa: S101  (set by the pass)
    spread = np.sum(model.post.full_root**2, axis=1)
    for j, unknown in enumerate(unknowns):
        unknown.sd = float(np.sqrt(spread[first + j])) * unknown.prior_sd


# ---- private to separation: score tests of what the fit left out --------------------------------

_UNSEEN = 1e-6
"""Share of its information that must be left beside the other columns."""


@dataclass(frozen=True, slots=True)
class ProbeDifference:
    """Sensitivity of a probe against the first, as one step from equality shows it."""

    probe: str  # names
    first: str
    gain: float  # excess of the sensitivity: 0.05 reads 5 % more
    sd: float  # its standard uncertainty if the probes are equal


def probe_differences(system: System, model: Model) -> tuple[ProbeDifference, ...]:
    """Return the difference of each probe from the first."""
    names = list(dict.fromkeys(r.probe for r in system.runs))
    if len(names) < 2:
        return ()

    def columns(index: int) -> FloatArray:
        out = np.zeros((system.runs[index].x.size, len(names)))
        out[:, names.index(system.runs[index].probe)] = system.shape(index, model, with_slope=True)
        return out

    score, own, cross = system.score(model, columns)
    assert model.post is not None  # noqa: S101  (after a solution)
    held = model.post.full_root.T @ cross
    information = np.diag(own) - np.sum(held**2, axis=0)
    return tuple(
        ProbeDifference(
            names[j],
            names[0],
            float(score[j] / information[j]),
            float(1.0 / np.sqrt(information[j])),
        )
        for j in range(1, len(names))
        if information[j] > _UNSEEN * own[j, j] > 0.0
    )


def square_of_feed_score(system: System, model: Model, *, kind: str) -> tuple[float, int] | None:
    """Return the score test of a part that grows with the square of the feedrate."""
    rel = system.terms.relative_speed
    mean_square = float(np.mean(rel**2))

    def columns(index: int) -> FloatArray:
        if kind == "waves":
            shape = system.terms.waves(index)
        else:
            shape = system.shape(index, model, with_slope=False)[:, None]
        return np.asarray(shape * (rel[index] ** 2 - mean_square))

    score, own, cross = system.score(model, columns)
    assert model.post is not None  # noqa: S101  (after a solution)
    held = model.post.full_root.T @ cross
    information = own - held.T @ held
    values, vectors = np.linalg.eigh(information)
    seen = values > _UNSEEN * float(np.diag(own).max())
    if not seen.any():
        return None
    along = vectors[:, seen].T @ score
    return float(np.sum(along**2 / values[seen])), int(seen.sum())


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
    The zero frequency is the mean, not a disturbance, and is omitted. The column
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
