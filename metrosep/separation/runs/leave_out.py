"""Private to separation: each run predicted from the others.

The geometry without a run predicts it; what its readings say beside the prediction is a gain, a
shift in position, or a misfit. Equation numbers: separation-2.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from metrosep.core._arrays import BoolArray, FloatArray, IntArray
from metrosep.core.units import format_length
from metrosep.separation.runs.displaced import DISPLACED
from metrosep.separation.runs.geometry import filtered
from metrosep.separation.runs.posterior import PLACED, Model, Posterior, RunEquations
from metrosep.separation.runs.sensor import LAG_CHI2, lag_score, lag_steps

_FAR = 3e-3
"""m; shifts are looked for so far on each side."""

_PLACES = 100
"""Most shifts on each side that are looked at."""

_HIDDEN, _FEW = 0.1, 20
"""Variance over noise below which a run does not show a wave; fewer of them tell no noise."""

_EDGE = 1e-9
"""Directions of the prediction's variance below this share of the largest are not tested."""


_SURE = 5.0
"""Standard uncertainties beyond which a gain or a shift is named."""

_FAR_OFF = 1e-5
"""Chance by which scatter like that of the other runs would take a run so far off."""

_TRUSTED = 10.0
"""Runs' worth of trust that u is right: so much the scatter of the runs has to speak against it."""

_GAIN = 0.1
"""Least excess of a gain that is named."""

_SEEN = 0.1
"""Standard uncertainty of a gain up to which the error is seen in a run well enough to judge it."""

_RARE = 1e-3
"""Chance of so large a misfit in any of the runs from which it is named."""

_MAY_BE_ODD = 1.5
"""Chi-square per degree of freedom of the farthest run from which the others are predicted without it."""

_MISFIT = 2.0
"""Chi-square per degree of freedom, and its ratio to the median run, beyond which a run is named."""


@dataclass(frozen=True, slots=True)
class RunScore:
    """What a run is beside what the others predict of it (eq. 15)."""

    chi2: float  # per degree of freedom
    degrees: int
    gain: float  # 1: as predicted; below 0: the opposite sign
    u_gain: float
    shift: float  # m: the readings show the error of the place x - shift
    u_shift: float
    theta: FloatArray  # what the others predict, in the coordinates of the equations
    chi2_placed: float = math.inf  # as chi2, the prediction moved by the shift


_LEAST, _MOST, _PER_DECADE = 1e-6, 1e-3, 20
"""m; standard deviations of the places of the runs that are as likely before, together as none.
Larger ones only where the readings ask for them."""

_BEYOND = 10.0
"""Sizes go on to so many times the scatter that u does not explain: there the likelihood has fallen."""

_BY_CHANCE = 0.05
"""Chance up to which u explains the scatter."""


@dataclass(frozen=True, slots=True, eq=False)
class Displacement:
    """What the runs of each feedrate differ in their place along the axis by."""

    sd: float = 0.0  # m: of one run, the root of the mean variance
    probability: float = 0.0  # that the places differ at all
    of_mean: float = 0.0  # m^2: variance of the place of the mean of all runs
    # s^2: variances of the lag that the feedrates seem to show, and the chance of each
    lags: tuple[FloatArray, FloatArray] = PLACED
    places: tuple[FloatArray, FloatArray] = PLACED  # m: the sizes, none first, and their chances

    @property
    def of_lag(self) -> float:
        """Mean variance of that lag, s^2."""
        variances, chances = self.lags
        return float(chances @ variances)


def displacement(
    model: Model, scores: Sequence[RunScore], named: Sequence[int] = ()
) -> Displacement:
    """Return the displacement of the runs that their scatter at equal feedrates shows.

    A lag moves all runs of a feedrate alike, so it has no part in it. The mean place at each
    feedrate is free; of one run at each nothing is known.
    """
    if not scores:
        return _unknown()
    # A run that is far off, or of another sign or gain, is named for it: its place is no scatter of all.
    kept = np.ones(len(scores), dtype=bool)
    kept[list(_apart(model, named))] = False
    odd = suspicion(scores)
    if odd is not None:
        kept[odd[0]] = False
    return scatter_of_places(
        np.array([s.shift for s in scores]),
        np.array([s.u_shift for s in scores]) ** 2,
        np.array([run.velocity for run in model.runs]),
        np.array([run.feed for run in model.runs]),
        kept,
    )


def scatter_of_places(
    shift: FloatArray, variance: FloatArray, speed: FloatArray, feed: IntArray, kept: BoolArray
) -> Displacement:
    """Return the displacement that shifts of runs show, m and m^2; of all runs, from those kept."""
    groups = [kept & (feed == f) for f in np.unique(feed) if (kept & (feed == f)).sum() > 1]
    if not groups:
        return _unknown()
    # A run that is displaced moves what it is held against, the others: by 1/(n - 1) of it.
    seen = shift.size / (shift.size - 1.0)
    sizes = np.append(0.0, _sizes(_beyond([(shift[own], variance[own]) for own in groups])))
    size2 = (seen * sizes[:, None]) ** 2
    logs = np.zeros(sizes.size)
    for own in groups:
        w = 1.0 / (variance[own] + size2)
        whole = w.sum(axis=1)
        away = shift[own] - (w @ shift[own] / whole)[:, None]
        logs += 0.5 * (np.log(w).sum(axis=1) - np.log(whole) - (w * away**2).sum(axis=1))
    likely = np.exp(logs - logs.max())
    # Before, sizes are as likely (in the logarithm) as the shifts could tell them (Jeffreys): one far
    # below u is as none, so that of places which hardly show no size is held.
    shown = size2 / (variance[np.any(groups, axis=0)] + size2)
    before = np.sqrt(np.mean(shown**2, axis=1)) / (sizes.size - 1)
    chances = likely * before
    as_none = float(likely[0]) * (1.0 - float(before.sum()))
    all_of_them = float(likely[0]) + as_none + float(chances.sum())
    chances /= all_of_them
    some = float(chances.sum())
    chances[0] = 1.0 - some
    # Of few runs the sd is known badly: what is held is the mean variance, and the lag keeps them all.
    held = float(chances @ sizes**2)
    weight = variance.min() / variance
    away = speed - float(weight @ speed) / float(weight.sum())
    along = float(weight @ away**2)
    of_one = float((weight * away) @ (weight * away)) / along**2 if along > 0.0 else 0.0
    return Displacement(
        math.sqrt(held / some) if some > 0.0 else 0.0,
        1.0 - float(likely[0]) / all_of_them,
        of_mean=held * float(weight @ weight) / float(weight.sum()) ** 2,
        lags=(of_one * sizes**2, chances),
        places=(sizes, chances),
    )


def _unknown() -> Displacement:
    """Return the displacement of runs of which nothing is known: none, or any that is likely before."""
    sizes = _sizes()
    chances = np.append(0.5, np.full(sizes.size, 0.5 / sizes.size))
    return Displacement(places=(np.append(0.0, sizes), chances))


def _sizes(beyond: float = 0.0) -> FloatArray:
    """Return the sizes that are looked at, m, where so much of the variance is not explained, m^2."""
    most = max(_MOST, _BEYOND * math.sqrt(beyond))
    steps = math.ceil(_PER_DECADE * math.log10(most / _LEAST) - 1e-9)
    return np.asarray(_LEAST * 10.0 ** (np.arange(steps + 1) / _PER_DECADE))


def _beyond(groups: Sequence[tuple[FloatArray, FloatArray]]) -> float:
    """Return by how much the shifts at each feedrate scatter more than their variances explain, m^2."""
    from scipy.stats import chi2

    squares, weights, freedom = 0.0, 0.0, 0
    for shift, variance in groups:
        w = 1.0 / variance
        away = shift - float(w @ shift) / float(w.sum())
        squares += float(w @ away**2)
        weights += float(w @ (1.0 - w / w.sum()))
        freedom += shift.size - 1
    return max(squares - float(chi2.isf(_BY_CHANCE, freedom)), 0.0) / weights


def run_scores(model: Model, named: Sequence[int] = ()) -> list[RunScore]:
    """Return the score of each run against all others that are not named; none for fewer than 3 runs.

    A lag that the readings show and the model has not is removed first: it moves the runs of
    each feedrate, and none of them is to blame.
    """
    if len(model.runs) < 3:
        return []
    at = lag_score(model)
    if at is None or (at.lag / at.u) ** 2 <= LAG_CHI2:
        return _scores(model, named)
    state = model.state()
    lag_steps(model)
    scores = _scores(model, named)
    model.back_to(state)
    model.solve()
    return scores


_PREDICT = 3
"""Runs that are in order from which those that are named, or look odd, do not predict the others."""


def _apart(model: Model, named: Sequence[int]) -> Sequence[int]:
    """Return the named runs, unless they leave too few others."""
    return named if len(model.runs) - len(named) >= _PREDICT else ()


def _scores(model: Model, named: Sequence[int]) -> list[RunScore]:
    """Return the scores; named runs, and the farthest one where it may be odd, do not predict the others."""
    odd = list(_apart(model, named))
    scores = _scores_without(model, odd)
    far = max(set(range(len(scores))) - set(odd), key=lambda i: scores[i].chi2)
    if scores[far].chi2 < _MAY_BE_ODD or len(scores) - len(odd) <= _PREDICT:
        return scores
    return _scores_without(model, [*odd, far], scores[far])


def _scores_without(
    model: Model, odd: Sequence[int], last: RunScore | None = None
) -> list[RunScore]:
    """Return the score of each run against all others but the odd ones; of the last of these if known."""
    seen = model.seen
    return [
        last
        if last is not None and i == odd[-1]
        else _score(model, run, [seen[j] for j in odd if j != i])
        for i, run in enumerate(seen)
    ]


def suspicion(scores: Sequence[RunScore]) -> tuple[int, str] | None:
    """Return the run that is farthest from what the others predict, and what is unusual about it."""
    from scipy.stats import chi2

    if len(scores) < 3:
        return None
    typical = max(1.0, float(np.median([s.chi2 for s in scores])))
    found: list[tuple[float, int, str]] = []
    others = len(scores) - 1
    gains = np.array([(s.gain - 1.0, s.u_gain) for s in scores])
    shifts = np.array([(s.shift, s.u_shift) for s in scores])
    for i, s in enumerate(scores):
        # Where a run hardly shows the error neither its gain nor its place is known.
        seen = s.u_gain < _SEEN
        gain = abs(s.gain - 1.0) / _needed(gains, i)
        shift = abs(s.shift) / _needed(shifts, i)
        if seen and abs(s.gain - 1.0) > _GAIN and gain > 1.0:
            text = f"has the gain {s.gain:.2f} (u {s.u_gain:.2g})"
            if s.gain < 0.0:
                text = f"has the opposite sign: gain {s.gain:.2f} (u {s.u_gain:.2g})"
            found.append((gain, i, text))
        if seen and shift > 1.0 and abs(s.shift) < _FAR:
            text = f"{DISPLACED} {format_length(s.shift)} (u {format_length(s.u_shift, digits=2)})"
            found.append((shift, i, text))
        # What lies elsewhere is named for its place, and where all do none is.
        misfit = min(s.chi2, s.chi2_placed)
        chance = float(chi2.sf(misfit / typical * s.degrees, s.degrees)) * len(scores)
        if misfit > _MISFIT * typical and chance < _RARE:
            text = f"differs by {math.sqrt(misfit):.2g} times what the noise explains"
            found.append((math.sqrt(misfit / _MISFIT / typical), i, text))
    if not found:
        return None
    _, i, text = max(found)
    return i, f"{text} against what the other {others} runs predict"


def _needed(values: FloatArray, index: int) -> float:
    """Return how far a run must be off to be named: rows are values and their u.

    A line of a vibration beside a wave of the error scatters all runs by more than their u; that
    scatter counts, u having the weight of `_TRUSTED` runs. One run that is far off moves what is
    predicted of all others by as much: about their median.
    """
    from scipy.stats import t

    rest = np.delete(values, index, axis=0)
    off = (rest[:, 0] - float(np.median(rest[:, 0]))) / rest[:, 1]
    freedom = _TRUSTED + off.size
    variance = (_TRUSTED + float(off @ off)) / freedom
    return float(max(_SURE, t.isf(_FAR_OFF, freedom) * math.sqrt(variance)) * values[index, 1])


def _score(model: Model, run: RunEquations, without: Sequence[RunEquations]) -> RunScore:
    gram, right = run.gram, run.right
    left = (model.total[0] - gram, model.total[1] - right)
    for other in without:
        left = (left[0] - other.gram, left[1] - other.right)
    rest = model.solution(*left)
    curve = rest.theta.copy()
    curve[0] = 0.0  # the line is alignment: neither gain nor shift show in it
    curve[1 + 2 * model.extension.n :] = 0.0
    side = right - gram @ rest.theta
    root = rest.full_root
    noise = max(1.0, _noise(model, gram, side))  # more noise than the others is no other error

    def step(along: FloatArray) -> tuple[float, float]:
        seen = gram @ along
        own = max(float(along @ seen), 1e-300)
        variance = noise * own + float(np.sum((root.T @ seen) ** 2))
        return float(along @ side) / own, math.sqrt(variance) / own

    gain, u_gain = step(curve)
    shift = _shift(model, gram, right, curve, rest.theta)
    w = model.extension.wavenumbers
    _, u_shift = step(
        _waves_only(filtered(curve, np.asarray(-1j * w * np.exp(-1j * w * shift))), w.size)
    )
    moved = filtered(curve, np.exp(-1j * w * shift)) - curve
    misfits, degrees = _misfits(rest, gram, np.column_stack([side, side - gram @ moved]), noise)
    here, placed = misfits.tolist()
    return RunScore(here, degrees, 1.0 + gain, u_gain, shift, u_shift, rest.theta, placed)


def _noise(model: Model, gram: FloatArray, side: FloatArray) -> float:
    """Return the variance of a run's noise over that of all, from the waves that the error lacks.

    What is left of them is noise, wherever the run is and whatever its gain; 1 where there are few.
    """
    n = model.extension.n
    own = np.diag(gram)[1 : 1 + 2 * n]
    unseen = (np.tile(model.spectrum.variance, 2) * own < _HIDDEN) & (own > _EDGE * own.max())
    if unseen.sum() < _FEW:
        return 1.0
    return float(np.mean(side[1 : 1 + 2 * n][unseen] ** 2 / own[unseen]))


def _misfits(
    rest: Posterior, gram: FloatArray, sides: FloatArray, noise: float
) -> tuple[FloatArray, int]:
    """Return chi-square per degree of freedom on the columns in use, and their number (eq. 15)."""
    across = rest.along(gram)
    own = rest.along(across.T)
    half = own @ rest.root
    variance = noise * own + half @ half.T
    values, vectors = np.linalg.eigh(0.5 * (variance + variance.T))
    seen = values > _EDGE * values[-1]
    along = vectors[:, seen].T @ rest.along(sides)
    return np.asarray(np.mean(along**2 / values[seen, None], axis=0)), int(seen.sum())


def _shift(
    model: Model, gram: FloatArray, right: FloatArray, curve: FloatArray, theta: FloatArray
) -> float:
    """Return the shift of greatest likelihood: the best of a scan, then Gauss-Newton."""
    w, n = model.extension.wavenumbers, model.extension.n
    right = right - gram @ (theta - curve)
    far = min(_FAR, 0.25 * model.extension.travel)
    pitch = max(model.extension.period / n / 4.0, far / _PLACES)
    shifts = np.arange(-far, far + pitch, pitch)
    wave = (curve[1 : n + 1] - 1j * curve[n + 1 : 2 * n + 1])[:, None]
    wave = wave * np.exp(-1j * np.outer(w, shifts))
    moved = np.zeros((curve.size, shifts.size))
    moved[1 : n + 1], moved[n + 1 : 2 * n + 1] = wave.real, -wave.imag
    misfit = (moved * (gram @ moved)).sum(axis=0) - 2.0 * right @ moved
    shift = float(shifts[np.argmin(misfit)])
    for _ in range(8):
        at = filtered(curve, np.exp(-1j * w * shift))
        along = _waves_only(filtered(at, np.asarray(-1j * w)), n)
        own = max(float(along @ gram @ along), 1e-300)
        shift += float(np.clip(along @ (right - gram @ at) / own, -pitch, pitch))
    return shift


def _waves_only(theta: FloatArray, n: int) -> FloatArray:
    theta[0] = 0.0
    theta[2 * n + 1 :] = 0.0
    return theta
