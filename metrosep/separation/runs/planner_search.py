"""What runs tell about wavelengths, and the search for the feeds that tell most about the worst one.

Maximise ``min_k sum_r J_k(v_r)``, J_k divided by the weight of its wave. The relaxed problem (shares of candidates instead of whole runs)
is a linear programme; its value bounds every plan from above. Whole runs come from rounding it,
from a greedy start and from an even spread, each improved by exchanging one run at a time and then
by moving feeds between the candidates. No random numbers. The plan is compared with feeds in
geometric progression.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread

if TYPE_CHECKING:
    from metrosep.separation.runs.solver import TimeDensity

Information = Callable[[FloatArray], FloatArray]

_CANDIDATES = 181
_SWEEPS = 60
_FINE = 15
_GAIN = 1e-9
"""Smallest relative gain that counts as one."""


@dataclass(frozen=True, slots=True)
class Limits:
    """What a plan must keep."""

    v_min: float  # m/s: speeds
    v_max: float
    ratio: float  # > 1: two feeds are either equal or at least this ratio apart
    length: float  # m: travel of a run, for its duration
    max_time: float  # s: of all new runs together; infinity if free
    window: float = 1.0  # not more than half of the time lies within this ratio; 1 if free

    def allowed(self, feeds: FloatArray, fixed: FloatArray) -> bool:
        """Return whether a list of new feeds keeps every limit."""
        if float(np.sum(self.length / feeds)) > self.max_time * (1.0 + 1e-12):
            return False
        every = np.concatenate([feeds, fixed])
        distinct = np.unique(every)
        if distinct.size < 2 or distinct[-1] < distinct[0] * self.ratio * (1.0 - 1e-12):
            return False
        gaps = distinct[1:] / distinct[:-1]
        close = gaps < self.ratio * (1.0 - 1e-12)
        new = np.isin(distinct, feeds)
        if bool((close & (new[1:] | new[:-1])).any()):
            return False
        return self.window == 1.0 or self.spread(feeds, fixed)

    def spread(self, feeds: FloatArray, fixed: FloatArray) -> bool:
        """Return whether at most half of the time goes to runs within the ratio of `window`.

        One run more may lie there: of two runs one is always longer.
        """
        every = np.sort(np.concatenate([feeds, fixed]))
        end = np.searchsorted(every, every * self.window * (1.0 - 1e-9))
        time = np.concatenate([[0.0], np.cumsum(1.0 / every)])
        rest = time[end] - time[:-1] - 1.0 / every  # the first of a window is its longest
        crowded = rest > 0.5 * time[-1] * (1.0 + 1e-9)
        new = np.isin(every, feeds)  # what is done already is nobody's choice
        return not any(new[i : end[i]].any() for i in np.flatnonzero(crowded))

    def candidates(self) -> FloatArray:
        """Return feeds on a logarithmic grid, both limits included."""
        grid: FloatArray = np.geomspace(self.v_min, self.v_max, _CANDIDATES)
        grid[0], grid[-1] = self.v_min, self.v_max
        return grid


def information_bound(
    table: FloatArray, feeds: FloatArray, fixed: FloatArray, n_runs: int, limits: Limits
) -> tuple[float, FloatArray]:
    """Return the largest information any plan can have on its worst wavelength, and its shares."""
    from scipy.optimize import linprog

    scale = float(np.median(table[table > 0.0])) if (table > 0.0).any() else 1.0
    size, k = table.shape
    upper = np.hstack([-table.T / scale, np.ones((k, 1))])
    right = fixed / scale
    if np.isfinite(limits.max_time):
        row = np.append(limits.length / feeds / limits.max_time, 0.0)
        upper, right = np.vstack([upper, row]), np.append(right, 1.0)
    cost = np.zeros(size + 1)
    cost[-1] = -1.0
    equal = np.append(np.ones(size), 0.0)[np.newaxis]
    done = linprog(cost, upper, right, equal, [float(n_runs)], bounds=(0.0, None), method="highs")
    if done.x is None:
        return float("nan"), np.full(size, n_runs / size)
    return float(done.x[-1] * scale), np.asarray(done.x[:-1])


def best_feeds(
    information: Information, n_runs: int, limits: Limits, fixed: FloatArray
) -> tuple[FloatArray, float]:
    """Return the feeds of the best plan found and the bound on every plan."""
    candidates = limits.candidates()
    table = information(candidates)
    done = information(fixed).sum(axis=0) if fixed.size else np.zeros(table.shape[1])
    bound, shares = information_bound(table, candidates, done, n_runs, limits)
    best: tuple[float, FloatArray] = (-np.inf, np.empty(0))
    for start in _starts(table, candidates, shares, done, n_runs, limits, fixed):
        if not limits.allowed(start, fixed):
            continue
        feeds = _exchanged(start, candidates, table, information, done, limits, fixed)
        feeds = _refined(feeds, information, done, limits, fixed, candidates[1] / candidates[0])
        score = _score(information(feeds).sum(axis=0) + done)
        if score > best[0] * (1.0 + _GAIN) or not best[1].size:
            best = (score, np.sort(feeds))
    return best[1], bound


def _score(total: FloatArray) -> float:
    """Smallest information; a little of the mean lets a plan climb out of equal minima."""
    low = float(total.min())
    return low + 1e-6 * float(total.mean())


def _starts(
    table: FloatArray,
    candidates: FloatArray,
    shares: FloatArray,
    done: FloatArray,
    n_runs: int,
    limits: Limits,
    fixed: FloatArray,
) -> list[FloatArray]:
    quantiles = (np.arange(n_runs) + 0.5) * (shares.sum() / n_runs)
    rounded = candidates[
        np.minimum(np.searchsorted(np.cumsum(shares), quantiles), candidates.size - 1)
    ]
    greedy: list[float] = []
    total = done.copy()
    for _ in range(n_runs):
        pick = int(np.argmax([_score(total + row) for row in table]))
        greedy.append(float(candidates[pick]))
        total = total + table[pick]
    starts = [_spaced(f, limits, fixed) for f in (rounded, np.sort(greedy))]
    room = int(np.floor(np.log(limits.v_max / limits.v_min) / np.log(limits.ratio) + 1e-9)) + 1
    most = min(room, n_runs)
    for groups in sorted({*range(1, min(most, 5) + 1), most}):  # equal ratios, the finest too
        ladder = np.geomspace(limits.v_min, limits.v_max, groups) if groups > 1 else [limits.v_max]
        starts.append(np.sort(np.resize(ladder, n_runs)))
    fastest = limits.v_max * np.ones(n_runs)
    slower = fastest.copy()
    slower[0] = limits.v_max / limits.ratio
    apart = fastest.copy()
    apart[: n_runs // 2] = max(limits.v_max / limits.window, limits.v_min)
    return [*starts, slower, fastest, apart]


def _spaced(feeds: FloatArray, limits: Limits, fixed: FloatArray) -> FloatArray:
    """Pull feeds that are too close to each other together; part them if all have become one."""
    out = np.sort(feeds).copy()
    anchor = out[0]
    for i, v in enumerate(out):
        if v < anchor * limits.ratio:
            out[i] = anchor
        else:
            anchor = v
    if np.unique(np.concatenate([out, fixed])).size < 2:
        out[-1] = (
            out[-1] * limits.ratio
            if out[-1] * limits.ratio <= limits.v_max
            else out[-1] / limits.ratio
        )
    return np.clip(out, limits.v_min, limits.v_max)


def _exchanged(
    feeds: FloatArray,
    candidates: FloatArray,
    table: FloatArray,
    information: Information,
    done: FloatArray,
    limits: Limits,
    fixed: FloatArray,
) -> FloatArray:
    """Replace one run at a time, or all runs of one feed, by the candidate that gains most."""
    feeds = feeds.copy()
    rows = information(feeds)
    for _ in range(_SWEEPS):
        before = _score(rows.sum(axis=0) + done)
        for moved in _moves(feeds):
            rest = rows.sum(axis=0) - rows[moved].sum(axis=0) + done
            total = rest + moved.sum() * table
            scores = total.min(axis=1) + 1e-6 * total.mean(axis=1)
            current = _score(rows.sum(axis=0) + done)
            for pick in np.argsort(-scores, kind="stable"):
                if scores[pick] <= current * (1.0 + _GAIN):
                    break
                trial = np.where(moved, candidates[pick], feeds)
                if limits.allowed(trial, fixed):
                    feeds, rows = trial, np.where(moved[:, np.newaxis], table[pick], rows)
                    break
        if _score(rows.sum(axis=0) + done) <= before * (1.0 + _GAIN):
            break
    return feeds


def _moves(feeds: FloatArray) -> list[NDArray[np.bool_]]:
    """One run of each distinct feed, and all runs of each distinct feed."""
    moves: list[NDArray[np.bool_]] = []
    for v in np.unique(feeds):
        group = feeds == v
        one = np.zeros_like(group)
        one[int(np.flatnonzero(group)[0])] = True
        moves += [one] if group.sum() == 1 else [one, group]
    return moves


def _refined(
    feeds: FloatArray,
    information: Information,
    done: FloatArray,
    limits: Limits,
    fixed: FloatArray,
    reach: float,
) -> FloatArray:
    """Move each distinct feed between its neighbouring candidates, three times finer each."""
    width = np.log(reach)
    for _ in range(4):
        for v in np.unique(feeds):
            group = feeds == v
            rest = information(feeds[~group]).sum(axis=0) + done if (~group).any() else done
            fine = np.clip(
                v * np.exp(np.linspace(-width, width, _FINE)), limits.v_min, limits.v_max
            )
            total = rest + group.sum() * information(fine)
            scores = total.min(axis=1) + 1e-6 * total.mean(axis=1)
            current = _score(information(feeds).sum(axis=0) + done)
            for pick in np.argsort(-scores, kind="stable"):
                if scores[pick] <= current * (1.0 + _GAIN):
                    break
                trial = np.where(group, fine[pick], feeds)
                if limits.allowed(trial, fixed):
                    feeds = trial
                    break
        width /= 4.0
    return feeds


# ---- what a plan makes worse than feeds in geometric progression, on all waves up to the travel ----


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """sd of a plan and of feeds in geometric progression, long-record formula."""

    waves: FloatArray  # shape (k,), m
    sd: FloatArray  # shape (k,), m: of the plan
    reference: FloatArray  # shape (k,), m: of as many feeds in geometric progression
    feeds: FloatArray  # m/s: these feeds

    @property
    def worst(self) -> float:
        """Largest sd of the plan, m."""
        return float(self.sd.max())

    @property
    def reference_worst(self) -> float:
        """Largest sd of the geometric progression, m."""
        return float(self.reference.max())

    def text(self) -> str:
        """Return both worst waves with their sd."""
        at, other = int(np.argmax(self.sd)), int(np.argmax(self.reference))
        low, high = self.feeds.min() * 6e4, self.feeds.max() * 6e4
        runs = (
            f"{self.feeds.size} runs with feeds in geometric progression from {low:.0f} to "
            f"{high:.0f} mm/min have"
            if self.feeds.size > 1
            else f"a run at the middle of the range, {low:.0f} mm/min, has"
        )
        return (
            f"{_nm(self.worst)} at {self.waves[at] * 1e3:.3g} mm; {runs} "
            f"{_nm(self.reference_worst)} at {self.waves[other] * 1e3:.3g} mm"
        )

    def messages(self) -> tuple[str, ...]:
        """Return what the plan makes worse."""
        ratio = np.where(np.isinf(self.reference), 1.0, self.sd) / np.where(
            np.isinf(self.reference), 1.0, self.reference
        )
        i = int(np.argmax(ratio))
        worse = self.waves[ratio > 1.0 + _NOTICED]
        span = f"{self.waves.min() * 1e3:.3g} to {self.waves.max() * 1e3:.3g} mm"
        out = [f"the worst of all waves from {span} has an sd of {self.text()}"]
        if worse.size:
            out.append(
                f"the plan makes {100 * worse.size / ratio.size:.0f} % of them worse than the "
                f"geometric progression by more than {100 * _NOTICED:.0f} %, most at {self.waves[i] * 1e3:.3g} mm: "
                f"{_nm(self.sd[i])} instead of {_nm(self.reference[i])}"
            )
        else:
            out.append(
                "the plan makes none of them worse than the geometric progression by more than "
                f"{100 * _NOTICED:.0f} %"
            )
        return tuple(out)

    def audit(self) -> dict[str, Any]:
        """Return the numbers with unit suffixes."""
        return {
            "worst_sd_nm": self.worst * 1e9 if math.isfinite(self.worst) else math.nan,
            "worst_wavelength_mm": float(self.waves[np.argmax(self.sd)]) * 1e3,
            "geometric_worst_sd_nm": self.reference_worst * 1e9
            if math.isfinite(self.reference_worst)
            else math.nan,
            "geometric_feeds_mm_per_min": [float(v) * 6e4 for v in self.feeds],
        }


def _nm(sd: float) -> str:
    """Return an sd in nm; where the density is not known nothing is."""
    return f"{sd * 1e9:.3g} nm" if math.isfinite(sd) else "infinity"


_NOTICED = 0.05
"""Growth of an sd that counts as worse."""


def geometric_feeds(n: int, limits: Limits) -> FloatArray:
    """Return n feeds in equal ratios up to the fastest, from as slow as the time allows."""
    if n == 1:
        return np.array([math.sqrt(limits.v_min * limits.v_max)])
    slowest = np.geomspace(limits.v_min, limits.v_max, 400)
    ladders = (np.geomspace(v, limits.v_max, n) for v in slowest)
    in_time = (f for f in ladders if np.sum(limits.length / f) <= limits.max_time)
    return next(in_time, np.full(n, limits.v_max))


def compared(
    density: TimeDensity,
    feeds: FloatArray,
    reference: FloatArray,
    done: FloatArray,
    waves: FloatArray,
    length: float,
) -> Comparison:
    """Return the sd of both sets of feeds, runs already done with each."""
    sds = []
    for own in (feeds, reference):
        every = np.concatenate([own, done])
        j = run_information(density, every, waves, length).sum(axis=0)
        sds.append(np.where(j > 0.0, 1.0 / np.sqrt(np.maximum(j, np.finfo(float).tiny)), np.inf))
    return Comparison(waves, sds[0], sds[1], reference)


# ---- what a set of runs tells about one wavelength: long-record formula and exact finite record ----
# A wave ``a cos(2 pi x / L) + b sin(...)`` read at the speed v is a tone of f = v / wavelength. With
# a disturbance of one-sided density S a run of duration T adds ``T / S(f)`` to the information on a
# and on b (Kay 1993, long records). It is exact only where S hardly changes within 1 / T. A resonance
# narrower than that spreads over 1 / T: its true effect is smaller at the peak, and the offset of
# each run costs a little. `finite_variance` does the generalised least squares without approximation.

_SAMPLES_PER_WAVE = 5.0
"""Samples per wave of the shortest wavelength in the simulated record."""

_MOST_SAMPLES = 1500
"""Longest record that is solved exactly; a longer one has more than 300 waves."""

_N_FREQUENCIES = 2**17
"""Lines that make the autocovariance from the density."""


def run_information(
    density: TimeDensity, feeds: FloatArray, wavelengths: FloatArray, length: float
) -> FloatArray:
    """Return the information of one run at each feed on each wavelength, long-record formula."""
    v = np.asarray(feeds, dtype=np.float64)[:, np.newaxis]
    s = density(v / wavelengths)
    information: FloatArray = np.where(np.isnan(s), 0.0, length / v / np.where(s > 0.0, s, 1.0))
    return information


def finite_variance(
    density: TimeDensity, feeds: FloatArray, wavelengths: FloatArray, length: float
) -> FloatArray:
    """Return the variance of the amplitude coefficients by generalised least squares."""
    shortest = float(wavelengths.min())
    n = int(np.ceil(_SAMPLES_PER_WAVE * length / shortest)) + 1
    if n > _MOST_SAMPLES:
        return np.full(wavelengths.shape, np.nan)
    total = np.zeros((wavelengths.size, 2, 2))
    with one_blas_thread():
        for v, count in zip(*np.unique(feeds, return_counts=True), strict=True):
            used = v / wavelengths <= density.highest
            if used.any():
                total[used] += count * _one_run(density, float(v), wavelengths[used], length)
    trace = total[:, 0, 0] + total[:, 1, 1]
    determinant = total[:, 0, 0] * total[:, 1, 1] - total[:, 0, 1] ** 2
    known = determinant > 1e-12 * trace**2
    out = np.full(wavelengths.shape, np.nan)
    out[known] = 0.5 * trace[known] / determinant[known]
    return out


def _one_run(
    density: TimeDensity, feed: float, wavelengths: FloatArray, length: float
) -> FloatArray:
    """Information matrices (k, 2, 2) of one run, its offset eliminated."""
    from scipy.linalg import cho_factor, cho_solve, toeplitz

    duration = length / feed
    top = min(0.5 * _SAMPLES_PER_WAVE * feed / float(wavelengths.min()), density.highest)
    n = max(int(2.0 * top * duration + 1e-9), 4)
    step = duration / n  # n samples stand for the whole duration
    times = (np.arange(n) - 0.5 * (n - 1)) * step
    covariance = _autocovariance(density, min(0.5 / step, density.highest), step, n)
    factor = cho_factor(toeplitz(covariance), check_finite=False)
    phase = 2.0 * np.pi * feed / wavelengths[:, np.newaxis] * times
    waves = np.stack([np.cos(phase), np.sin(phase)], axis=1)  # (k, 2, n)
    columns = np.concatenate([waves.reshape(-1, n), np.ones((1, n))])
    white = cho_solve(factor, columns.T, check_finite=False)  # (n, 2 k + 1)
    solved = white[:, :-1].T.reshape(waves.shape)
    matrix = np.einsum("kin,kjn->kij", waves, solved)
    with_offset = solved.sum(axis=2)
    removed = with_offset[:, :, np.newaxis] * with_offset[:, np.newaxis, :] / white[:, -1].sum()
    information: FloatArray = matrix - removed
    return information


def _autocovariance(density: TimeDensity, top: float, step: float, n: int) -> FloatArray:
    """Covariance at the first n lags of noise with this density up to `top` = 1 / (2 step)."""
    frequency = (np.arange(_N_FREQUENCIES) + 0.5) * (0.5 / step / _N_FREQUENCIES)
    power = density(np.minimum(frequency, top)) * (0.5 / step / _N_FREQUENCIES)
    # sum_j P_j cos(pi (j + 1/2) k / N): half-way lines keep the zero frequency out
    turn = np.exp(0.5j * np.pi * np.arange(n) / _N_FREQUENCIES)
    spectrum = np.fft.fft(power, 2 * _N_FREQUENCIES)[:n].conj()
    covariance: FloatArray = (spectrum * turn).real
    return covariance
