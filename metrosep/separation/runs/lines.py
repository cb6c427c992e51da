r"""Private to separation: deterministic lines in the residual, found by a likelihood-ratio test.

A lightly damped mode and a line both peak in a periodogram; they differ in how well the past
predicts them. So the noise model is fitted without and with a sine of free phase in each run, and
:math:`\Lambda = AICc_0 - AICc_1` is compared with chi-square of the sine's parameters, times the
number of frequencies that were looked at (Bonferroni). A mode that the noise model holds gains
nothing more than chance.

Source: Rife and Boorstyn 1974 (single tone); likelihood ratio after Wilks 1938.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.separation.runs.design import PreparedRun
from metrosep.spectral.autoregressive import fit_autoregressive, whiten

if TYPE_CHECKING:
    from metrosep.separation.runs.options import JointOptions
    from metrosep.separation.runs.posterior import Model
    from metrosep.separation.runs.system import System

_OVERSAMPLING = 4
_CANDIDATES = 4
"""Peaks of the periodogram that are tested in one search."""

_BACKGROUND = 12
"""Half-width, in resolution cells, of the stretch whose median is the background of a peak."""

_NEAR = 3.0
"""No second line is looked for within so many resolution cells of one that was found."""

_FIRST_CELL = 3.0
"""Lowest frequency looked at, over one per duration of the shortest run: below it is drift."""


_TABLE = 2_000_000
"""Complex numbers in a table of the transform."""


@dataclass(frozen=True, slots=True)
class FoundLine:
    """A frequency with its test."""

    frequency: float  # of the sine that lowers the noise most
    statistic: float  # fall of AICc of the noise models, parameters of the sine not counted
    p: float  # chance of it without a line, for all frequencies looked at


def find_line(
    residuals: Sequence[FloatArray],
    groups: Sequence[Sequence[int]],
    terms: Terms,
    orders: Sequence[int],
    *,
    level: float,
) -> FoundLine | None:
    """Return the strongest line whose chance is below a level."""
    frequency, power, cell = _search_spectrum(residuals, terms)
    if frequency.size < 2 * _OVERSAMPLING * _BACKGROUND:
        return None
    for known in terms.frequencies:
        power[np.abs(frequency - known) < _NEAR * cell] = 0.0
    ratio = power / _running_median(power, _OVERSAMPLING * _BACKGROUND)
    n_looked = 2.0 * frequency.size / _OVERSAMPLING
    base = _noise_criterion(residuals, groups, terms, orders)
    for _ in range(_CANDIDATES):
        at = int(ratio.argmax())
        if ratio[at] <= 0.0:
            return None
        best = _refined(residuals, terms, float(frequency[at]), cell)
        found = _tested(residuals, groups, terms, orders, best, base, n_looked)
        if found.p < level:
            return found
        ratio[np.abs(frequency - frequency[at]) < 2.0 * cell] = 0.0
    return None


def nearest_power(residuals: Sequence[FloatArray], terms: Terms, frequency: float) -> float:
    """Return the frequency of most power within half a resolution cell of a stated one."""
    cell = 1.0 / max(float(np.ptp(r.t)) for r in terms.runs)
    return _refined(residuals, terms, frequency, cell)


def _search_spectrum(
    residuals: Sequence[FloatArray], terms: Terms
) -> tuple[FloatArray, FloatArray, float]:
    """Return frequencies, power summed over the runs, and the resolution of the longest run."""
    step = max(r.time_step for r in terms.runs)
    longest = max(float(np.ptp(r.t)) for r in terms.runs)
    shortest = min(float(np.ptp(r.t)) for r in terms.runs)
    cell = 1.0 / longest
    frequency = np.arange(_FIRST_CELL / shortest, 0.49 / step, cell / _OVERSAMPLING)
    total = np.zeros(frequency.size, dtype=np.complex128 if terms.locked else np.float64)
    for i, residual in enumerate(residuals):
        sums = _transform(terms.line_time(i), residual, frequency)
        total = total + (sums if terms.locked else np.abs(sums) ** 2 / residual.size)
    return frequency, np.asarray(np.abs(total) ** (2 if terms.locked else 1)), cell


def _transform(t: FloatArray, z: FloatArray, frequency: FloatArray) -> NDArray[np.complex128]:
    """Return the sums of z exp(-2 pi i f t) over uniform frequencies, in bounded memory.

    With f = f_0 + (a B + b) df the factor splits into one of a and one of b: two short tables and
    one product, at the true times.
    """
    filled = np.where(np.isnan(z), 0.0, z)
    n = frequency.size
    inner = int(np.ceil(np.sqrt(n)))
    fine = frequency[:inner] - frequency[0]
    coarse = frequency[::inner]
    out = np.zeros((coarse.size, inner), dtype=np.complex128)
    size = max(1, _TABLE // inner)
    for first in range(0, t.size, size):
        part = slice(first, first + size)
        left = np.exp(-2j * np.pi * np.outer(coarse, t[part])) * filled[part]
        out += left @ np.exp(-2j * np.pi * np.outer(t[part], fine))
    return np.asarray(out.ravel()[:n])


def _running_median(values: FloatArray, half: int) -> FloatArray:
    from scipy.ndimage import median_filter

    smooth = median_filter(values, size=2 * half + 1, mode="nearest")
    return np.asarray(np.maximum(smooth, 1e-12 * max(float(values.max()), 1e-300)))


def _refined(
    residuals: Sequence[FloatArray], terms: Terms, frequency: float, cell: float
) -> float:
    """Return the frequency of most power within a cell."""
    for half in (0.5, 0.025, 0.00125):
        fine = frequency + np.linspace(-half, half, 41) * cell
        total = np.zeros(fine.size, dtype=np.complex128 if terms.locked else np.float64)
        for i, residual in enumerate(residuals):
            sums = _transform(terms.line_time(i), residual, fine)
            total = total + (sums if terms.locked else np.abs(sums) ** 2 / residual.size)
        frequency = float(fine[int(np.abs(total).argmax())])
    return frequency


def _tested(
    residuals: Sequence[FloatArray],
    groups: Sequence[Sequence[int]],
    terms: Terms,
    orders: Sequence[int],
    frequency: float,
    base: float,
    n_looked: float,
) -> FoundLine:
    from scipy.stats import chi2

    rest = _without_line(residuals, groups, terms, orders, frequency)
    statistic = base - _noise_criterion(rest, groups, terms, orders)
    freedom = 2 if terms.locked else 2 * len(residuals)
    p = min(1.0, n_looked * float(chi2.sf(max(statistic, 0.0), freedom)))
    return FoundLine(frequency, statistic, p)


def _noise_criterion(
    residuals: Sequence[FloatArray],
    groups: Sequence[Sequence[int]],
    terms: Terms,
    orders: Sequence[int],
) -> float:
    """Return AICc of the best noise models."""
    total = 0.0
    for group in groups:
        own = [residuals[i] for i in group]
        allowed = [p for p in orders if p <= max(1, min(r.size for r in own) // 8)] or [1]
        _, _, aicc = fit_autoregressive(
            own, orders=allowed, time_step=terms.runs[group[0]].time_step
        )
        total += min(aicc.values())
    return total


def _without_line(
    residuals: Sequence[FloatArray],
    groups: Sequence[Sequence[int]],
    terms: Terms,
    orders: Sequence[int],
    frequency: float,
) -> list[FloatArray]:
    """Take the line out, first by least squares, then with the noise model that is left."""
    rest = list(residuals)
    for whitened in (False, True):
        new = list(residuals)
        for group in groups:
            own = [rest[i] for i in group]
            coefficients = np.empty(0)
            if whitened:
                allowed = [p for p in orders if p <= max(1, min(r.size for r in own) // 8)]
                step = terms.runs[group[0]].time_step
                try:
                    coefficients = fit_autoregressive(own, orders=allowed or [1], time_step=step)[
                        0
                    ].coefficients
                except TooFewSamplesError:
                    coefficients = np.empty(0)
            for i, fitted in _line_of_group(
                residuals, group, terms, frequency, coefficients
            ).items():
                new[i] = residuals[i] - fitted
        rest = new
    return rest


def _line_of_group(
    residuals: Sequence[FloatArray],
    group: Sequence[int],
    terms: Terms,
    frequency: float,
    coefficients: FloatArray,
) -> dict[int, FloatArray]:
    pairs = {i: terms.line_pair(i, frequency) for i in group}
    tables = {}
    for i in group:
        rows = whiten(np.column_stack([pairs[i], residuals[i]]), coefficients)
        tables[i] = rows[~np.isnan(rows[:, 2])]
    if terms.locked:
        table = np.concatenate(list(tables.values()))
        tables = dict.fromkeys(group, table)
    return {
        i: pairs[i] @ np.linalg.lstsq(tables[i][:, :2], tables[i][:, 2], rcond=None)[0]
        for i in group
    }


# ---- private to separation: columns of the joint model beside offsets, slope and Fourier basis ----
# Drift of a run: :math:`\bar d u + \sum_j \delta_{rj} u^j`, u time from the middle of the run over
# half the longest run, each power without its mean; the :math:`\delta_{rj}` of the runs are drawn
# from :math:`N(0, \sigma_j^2)`, the variance being learnt, and the common rate :math:`\bar d` is
# free where feedrates differ. A common bow is not: it would take the long waves of the geometry. Lines: cosine and sine in time, one pair for each run or one for all.
# Waves that grow with the feedrate: cosine and sine in position times (v - v0)/v0.
#
# Heights are dimensionless as in `metrosep.separation.runs.system`; frequencies are in Hz.

_FLAT = 1e-6
"""Prior precision of coefficients that are left free: their sd is a thousand times the readings."""

_WAVE_PRECISION = 1.0
"""Of waves that grow with the feedrate: at twice the mean feed they may double the readings."""

_LEAST_VARIANCE = 1e-10
"""Variance of the drifts at which they are taken to be zero."""


class Terms:
    """Extra columns of a system, in this order: drift, lines, feed-dependent waves."""

    def __init__(
        self,
        runs: Sequence[PreparedRun],
        *,
        drift: int,
        locked: bool,
        several_feeds: bool,
        set_up_anew: bool = False,
    ) -> None:
        self.runs, self.drift, self.locked = runs, drift, locked
        self.set_up_anew = set_up_anew
        self.half_time = max(float(np.ptp(r.t)) for r in runs) / 2.0
        self.common_drift = several_feeds and drift > 0
        self.drift_variance = np.ones(drift)
        if set_up_anew:  # a learnt scatter may vanish, and the slopes then bend the error
            self.drift_variance[:1] = 1.0 / _FLAT
        self.frequencies: list[float] = []
        self.wavenumbers: FloatArray = np.empty(0)
        self.origin = 0.0
        speeds = np.array([abs(r.velocity) for r in runs])
        self.reference = float(speeds.mean())
        self.relative_speed = speeds / self.reference - 1.0

    @property
    def n_drift(self) -> int:
        """Columns of the drift: those of the runs, degree by degree, then the common rate."""
        return self.drift * len(self.runs) + int(self.common_drift)

    @property
    def n_per_line(self) -> int:
        """Columns of one line."""
        return 2 if self.locked else 2 * len(self.runs)

    @property
    def size(self) -> int:
        """Number of columns."""
        return self.n_drift + self.n_per_line * len(self.frequencies) + 2 * self.wavenumbers.size

    def columns(self, index: int) -> FloatArray:
        """Return the columns of one run."""
        run = self.runs[index]
        out = np.zeros((run.x.size, self.size))
        n = len(self.runs)
        for j in range(self.drift):
            out[:, j * n + index] = self.drift_shape(index, j + 1)
        if self.common_drift:
            out[:, self.drift * n] = self.drift_shape(index, 1)
        for i, frequency in enumerate(self.frequencies):
            first = self.line_start(i) + (0 if self.locked else 2 * index)
            out[:, first : first + 2] = self.line_pair(index, frequency)
        if self.wavenumbers.size:
            out[:, -2 * self.wavenumbers.size :] = self.relative_speed[index] * self.waves(index)
        return out

    def drift_shape(self, index: int, degree: int) -> FloatArray:
        """Return the drift of a degree over one run."""
        t = self.runs[index].t
        u = (t - 0.5 * (t[0] + t[-1])) / self.half_time
        return np.asarray(u if degree == 1 else u**2 - float(np.mean(u**2)))

    def line_start(self, line: int) -> int:
        """Return the first column of a line."""
        return self.n_drift + line * self.n_per_line

    def line_time(self, index: int) -> FloatArray:
        """Return the time from which the phase of a line counts: start, or middle if free."""
        t = self.runs[index].t
        if not self.locked:
            return np.asarray(t - 0.5 * (t[0] + t[-1]))
        run = self.runs[index]
        return np.asarray(t - t[0] + 0.5 * (run.block - 1) * run.time_step / run.block)

    def line_pair(self, index: int, frequency: float) -> FloatArray:
        """Return cosine and sine of a line in one run, averaged as its samples are."""
        run = self.runs[index]
        phase = 2.0 * np.pi * frequency * self.line_time(index)
        pair = np.column_stack([np.cos(phase), np.sin(phase)])
        return np.asarray(_block_gain(run, frequency) * pair)

    def line_change(self, index: int, line: int, coefficients: FloatArray) -> FloatArray:
        """Return the derivative of a line with its frequency."""
        first = self.line_start(line) + (0 if self.locked else 2 * index)
        a, b = coefficients[first : first + 2]
        cosine, sine = self.line_pair(index, self.frequencies[line]).T
        return np.asarray(2.0 * np.pi * self.line_time(index) * (b * cosine - a * sine))

    def waves(self, index: int) -> FloatArray:
        """Return cosines and sines in position of the waves that depend on the feedrate."""
        run = self.runs[index]
        phase = 2.0 * np.pi * np.outer(run.x - self.origin, self.wavenumbers)
        gain = np.sinc(np.tile(self.wavenumbers, 2) * run.block_length)
        return np.asarray(np.hstack([np.cos(phase), np.sin(phase)]) * gain)

    def precision(self) -> FloatArray:
        """Return the prior precision of every column."""
        out = np.full(self.size, _FLAT)
        n = len(self.runs)
        for j in range(self.drift):
            out[j * n : (j + 1) * n] = 1.0 / self.drift_variance[j]
        if self.wavenumbers.size:
            out[-2 * self.wavenumbers.size :] = _WAVE_PRECISION
        return out

    def learn(self, mean: FloatArray, variance: FloatArray) -> None:
        """Update the variance of the drifts among the runs (one step of expectation-maximisation)."""
        n = len(self.runs)
        for j in range(int(self.set_up_anew), self.drift):
            own = slice(j * n, (j + 1) * n)
            new = float(np.mean(mean[own] ** 2 + variance[own]))
            self.drift_variance[j] = max(new, _LEAST_VARIANCE)


def _block_gain(run: PreparedRun, frequency: float) -> float:
    """Return what averaging samples in blocks leaves of a line."""
    step = run.time_step / run.block
    low = np.sin(np.pi * frequency * step)
    return float(np.sin(np.pi * frequency * run.time_step) / (run.block * low)) if low else 1.0


# ---- private to separation: unknowns that are not linear, solved by Gauss-Newton ----
# The frequency of a line, the growth of the error with the feedrate, the sensitivity of a probe and
# the position of a run: each gives a column, its derivative over the runs, and takes the step that
# is solved for.


@dataclass(slots=True)
class Unknown:
    """One number that the model depends on in a curved way."""

    prior_sd: float  # scale of its column, which has a prior of unit variance
    largest_step: float  # the model counts as linear over such a change
    done: float  # A smaller change means that it has converged
    sd: float = float("nan")  # standard uncertainty after the last solution

    def column(self, system: System, index: int, model: Model) -> FloatArray:
        """Return the derivative of the readings of one run."""
        raise NotImplementedError

    def shift(self, system: System, step: float) -> None:
        """Change the number in the system."""
        raise NotImplementedError


@dataclass(slots=True)
class Frequency(Unknown):
    """Frequency of a line, Hz."""

    line: int = 0  # which line

    def column(self, system: System, index: int, model: Model) -> FloatArray:
        """Return the change of the line with its frequency; see `Unknown`."""
        assert model.post is not None  # noqa: S101  (after a solution)
        return system.terms.line_change(index, self.line, model.post.theta[system.extra])

    def shift(self, system: System, step: float) -> None:
        """Add to the frequency; see `Unknown`."""
        system.terms.frequencies[self.line] += step


@dataclass(slots=True, eq=False)
class Gain(Unknown):
    """Factor on the error in some runs: ``1 + value * lever`` in each."""

    # shape (n_runs,): relative speed for growth with the feedrate; 1 in the runs of a probe
    lever: FloatArray = field(default_factory=lambda: np.empty(0))
    with_slope: bool = False  # whether the alignment slope is multiplied too, as a probe does
    name: str = ""  # of the probe, or "following"
    value: float = 0.0  # the factor's excess

    def column(self, system: System, index: int, model: Model) -> FloatArray:
        """Return the error in the runs with a lever; see `Unknown`."""
        if self.lever[index] == 0.0:
            return np.zeros(system.runs[index].x.size)
        out = system.shape(index, model, with_slope=self.with_slope) / self._own(index)
        return np.asarray(self.lever[index] * out)

    def _own(self, index: int) -> float:
        return 1.0 + self.value * float(self.lever[index])

    def shift(self, system: System, step: float) -> None:
        """Add to the factor; see `Unknown`."""
        before = 1.0 + self.value * self.lever
        self.value += step
        change = (1.0 + self.value * self.lever) / before
        system.gain = system.gain * change
        if self.with_slope:
            system.slope_gain = system.slope_gain * change


@dataclass(slots=True, eq=False)
class Shift(Unknown):
    """Position offset in m: run i shows the error of ``x - d_i``, with ``d = value * lever``."""

    lever: FloatArray = field(default_factory=lambda: np.empty(0))  # shape (n_runs,)
    value: float = 0.0  # m

    def column(self, system: System, index: int, model: Model) -> FloatArray:
        """Return minus the slope of the error in the runs with a lever; see `Unknown`."""
        assert model.post is not None  # noqa: S101  (after a solution)
        # d/dx (a cos w x + b sin w x) = w b cos w x - w a sin w x; a line has no wave of its own
        k, w = system.extension.n, system.extension.wavenumbers
        a, b = model.post.theta[1 : 1 + k], model.post.theta[1 + k : 1 + 2 * k]
        theta = np.zeros(system.size)
        theta[1 : 1 + 2 * k] = np.concatenate([w * b, -w * a])
        return np.asarray(-self.lever[index] * system.curve(index, theta, model.sensor))

    def shift(self, system: System, step: float) -> None:
        """Move the runs; see `Unknown`."""
        self.value += step
        system.runs = [
            replace(run, x=run.x - step * float(d)) if d else run
            for run, d in zip(system.runs, self.lever, strict=True)
        ]
        system._bases.clear()  # noqa: SLF001  (they are those of the old places)


_SHIFT_PRIOR, _SHIFT_STEP, _SHIFT_DONE = 3e-3, 0.3e-3, 1e-6
"""m; as far as the checks of the runs look for a displaced one."""


_GAIN_PRIOR = 1.0
"""Standard deviation of a weak prior on the excess of a gain."""

_GAIN_STEP, _GAIN_DONE = 0.2, 1e-5


def wanted_unknowns(system: System, options: JointOptions) -> list[Unknown]:
    """Return the unknowns that the options ask for."""
    cell = 1.0 / max(float(np.ptp(r.t)) for r in system.runs)
    unknowns: list[Unknown] = [
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
    if options.position_offsets:
        unknowns += shifts([r.run_id for r in system.runs], options.position_reference)
    return unknowns


def shifts(names: Sequence[str], reference: str) -> list[Unknown]:
    """Return the unknowns of the position offsets of runs: of all beside a reference, or of sum zero."""
    n = len(names)
    if reference:
        levers = np.delete(np.eye(n), names.index(reference), axis=0)
    else:  # an orthonormal basis of what has the sum zero
        levers = np.linalg.qr(np.column_stack([np.ones(n), np.eye(n)[:, 1:]]))[0][:, 1:].T
    return [Shift(_SHIFT_PRIOR, _SHIFT_STEP, _SHIFT_DONE, lever=lever) for lever in levers]


def check_reference(names: Sequence[str], reference: str, way: str) -> None:
    """Refuse position offsets that these runs cannot show."""
    if len(names) < 2:
        raise DataError(
            f"position offsets compare runs, and there is {len(names)} {way} run; measure more"
        )
    n = list(names).count(reference)
    if reference and n != 1:
        raise DataError(
            f"position_reference={reference!r} names {'no' if n == 0 else n} {way} run"
            f"{'s' if n > 1 else ''}; the runs are {', '.join(names)}"
            + ("" if n else " (of two directions, leave the reference out: the sum is then zero)")
        )


def fitted_positions(
    unknowns: Sequence[Unknown], covariance: FloatArray, n_runs: int
) -> tuple[FloatArray, FloatArray]:
    """Return position offset and standard uncertainty of each run, m, from those of the unknowns."""
    own = [i for i, u in enumerate(unknowns) if isinstance(u, Shift)]
    first = covariance.shape[0] - len(unknowns)
    found = [u for u in unknowns if isinstance(u, Shift)]
    levers = np.array([u.lever for u in found]).reshape(-1, n_runs)
    at = first + np.array(own, dtype=int)
    spread = levers.T @ covariance[np.ix_(at, at)] @ levers
    value = np.array([u.value for u in found]) @ levers
    return value, np.sqrt(np.maximum(np.diag(spread), 0.0))


PositionOffsets = tuple[FloatArray, FloatArray] | None
"""Position offset and standard uncertainty of each run, m; None where they are not fitted."""

_UNPLACED = 1e-3
"""m; position offsets of a greater standard uncertainty are not determined."""

_MM = 1e-3


def position_columns(offsets: PositionOffsets) -> dict[str, list[float]]:
    """Return the columns of the table of the runs."""
    if offsets is None:
        return {}
    d, u = ((v / _MM).tolist() for v in offsets)
    return {"position_offset_mm": d, "u_position_offset_mm": u}


def explain_positions(
    names: Sequence[str],
    offsets: PositionOffsets,
    reference: str,
    *,
    delay: bool,
    nothing: bool,
) -> list[str]:
    """Say how far the runs lie from their places; `delay` would show in them, `nothing` was found."""
    if offsets is None:
        return []
    d, u = offsets
    i = int(u.argmax())
    if nothing or float(u[i]) > _UNPLACED:
        why = (
            "no error is above the noise that could show them"
            if nothing
            else f"u of run {names[i]} is {u[i] / _MM:.2g} mm, since the error is small or without short waves"
        )
        sentence = (
            f"position offsets are not determined by these runs: {why}; leave position_offsets out"
        )
        return [sentence]
    i = int(np.abs(d).argmax())
    zero = f"run {reference} is taken to lie at its place" if reference else "their sum is zero"
    sentence = (
        f"position offsets of the runs were fitted, {zero}: the largest is {d[i] / _MM:+.3g} mm "
        f"(u {u[i] / _MM:.2g} mm) of run {names[i]}"
    )
    if delay:
        sentence += "; a delay of the reading is part of them and was not looked for"
    return [sentence]
