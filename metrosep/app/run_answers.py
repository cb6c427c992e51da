"""Answers about repeated runs: the curves over the travel, and the waves by wavelength.

`curves` shows the runs at once and the separated error where ``level`` is "full"; `waves` carries
the separation out where ``level`` is "full", and then both are quick.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal
from weakref import WeakKeyDictionary

import numpy as np

from metrosep.app.documents import Remembered
from metrosep.app.map_views import Vibration, find_vibrations
from metrosep.app.separations import Separations
from metrosep.app.sessions import Session
from metrosep.app.spectrum_views import SpectrumView, estimate_view
from metrosep.app.view_tables import (
    Extremes,
    ProfileView,
    checked_columns,
    checked_window,
    profile_view,
    repeat_views,
)
from metrosep.app.wire import Answer, Arrays, Cancel, Message, Tell, level_of, number_or_none
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, MetrosepError
from metrosep.core.profile import Profile
from metrosep.core.quantity import Quantity
from metrosep.core.readable import said_value
from metrosep.core.runset import SAME_FEED, Run, RunSet
from metrosep.core.units import format_ends, format_length
from metrosep.plot.left_out import lag_words, run_rows
from metrosep.recipe.recipe import Recipe
from metrosep.separation.runs.base import ErrorEstimate, SampledCurve
from metrosep.separation.runs.design import evaluation_range, line_over, mean_runs, travel_of
from metrosep.separation.runs.spectra import feed_spectra_columns, n_wavelengths

_STATED = ("method", "start", "length", "shortest", "sigma_t", "p_t", "false_discovery_rate")


@dataclass(slots=True)
class _Kept:
    """What was made of the runs of one session, so that zooming is quick."""

    levelled: dict[tuple[float, float], Remembered[Any]] = field(default_factory=dict)
    means: Remembered[Any] = field(default_factory=lambda: Remembered(_mean_extremes, most=4))
    vibrations: Remembered[Any] = field(default_factory=lambda: Remembered(_vibrations, most=8))
    found: Remembered[Any] = field(default_factory=lambda: Remembered(_found, most=2))

    def of_runs(self, runs: RunSet, over: tuple[float, float]) -> Any:
        """Return the runs levelled over a range."""
        if over not in self.levelled:
            while len(self.levelled) >= 2:
                self.levelled.pop(next(iter(self.levelled)))
            self.levelled[over] = Remembered(lambda some: level_runs(some, over), most=1)
        return self.levelled[over].of(runs)


_KEPT: WeakKeyDictionary[Session, _Kept] = WeakKeyDictionary()


def _mean_extremes(estimate: ErrorEstimate, runs: RunSet) -> Any:
    return [
        (m, Extremes(Profile(m.x, m.before)), Extremes(Profile(m.x, m.after)))
        for m in mean_runs(runs, estimate)
    ]


def _vibrations(
    estimate: ErrorEstimate, runs: RunSet
) -> dict[int, tuple[tuple[Vibration, ...], str]]:
    return {d: find_vibrations(runs, estimate, direction=d) for d in runs.directions}


def _found(estimate: ErrorEstimate) -> dict[str, Any]:
    """Return what the separation found about its runs, for the table of them."""
    return {
        "lag": [list(pair) for pair in lag_words(estimate)],
        "runs": run_rows(estimate),
        "messages": [str(m) for m in estimate.messages],
    }


def _of_session(session: Session) -> tuple[Recipe, Separations, RunSet, _Kept]:
    opened, document = session.need()
    if not isinstance(opened.material, Separations):
        raise DataError(f"This view needs repeated runs; the open file is a {opened.kind}.")
    recipe = document.recipe
    kept = _KEPT.setdefault(session, _Kept())
    return recipe, opened.material, opened.material.runs(recipe), kept


def _step(recipe: Recipe) -> Mapping[str, Any]:
    return next(s for s in recipe.steps if s["op"] == "separate")


# ---- curves ----------------------------------------------------------------------------------


def curves(session: Session, message: Message, cancel: Cancel, tell: Tell) -> Answer:
    """Answer a request ``curves``: the runs over one another, and what was separated from them."""
    recipe, material, runs, kept = _of_session(session)
    full = level_of(message) == "full"
    estimate = material.estimate(recipe, cancel) if full else None
    step = _step(recipe)
    if estimate is None:
        method = step.get("method", "joint")
        over, why = shown_range(runs, step.get("start"), step.get("length"), method=method)
    else:
        over, why = (estimate.start, estimate.stop), ""
    levelled = kept.of_runs(runs, over)
    window, columns = message.get("window"), message.get("columns") or 1000
    header: dict[str, Any] = {
        "is_preview": estimate is None,
        "range": list(over),
        "travel": list(_common(runs)),
        "full_travel": list(runs.full_travel),
        "levelled": levelled.message,
        "messages": [why] if why else [],
        "stated": {k: step.get(k) for k in _STATED},
        "runs": [
            {
                "run": r.run_id,
                "feed": r.feed,
                "feed_words": feed_words(r.feed),
                "direction": r.direction,
                "not_measured": r.n_invalid,
            }
            for r in runs
        ],
        "feeds": [{"feed": f, "feed_words": feed_words(f)} for f in runs.feeds],
        "directions": sorted(runs.directions, reverse=True),
    }
    arrays: Arrays = {}
    for i, view in enumerate(levelled.views(window=window, columns=columns)):
        arrays |= {f"run_{i}_x": view.x, f"run_{i}_low": view.low, f"run_{i}_high": view.high}
    if estimate is not None:
        header |= _numbers(estimate)
        header["found"] = kept.found.of(estimate)
        header["separated"] = _separated(estimate, window, columns, arrays)
        header["means"] = _means(kept.means.of(estimate, runs), window, columns, arrays)
    return header, arrays


def _common(runs: RunSet) -> tuple[float, float]:
    low = max(float(min(r.x[0], r.x[-1])) for r in runs)
    high = min(float(max(r.x[0], r.x[-1])) for r in runs)
    return (low, high) if low < high else runs.full_travel


def _separated(estimate: ErrorEstimate, window: Any, columns: Any, arrays: Arrays) -> list[Any]:
    found = []
    for i, direction in enumerate(sorted(estimate.directions, reverse=True)):
        view = separated_view(estimate, direction=direction, window=window, columns=columns)
        arrays |= {
            f"error_{i}_x": view.x,
            f"error_{i}_low": view.low,
            f"error_{i}_high": view.high,
            f"error_{i}_band_low": view.band_low,
            f"error_{i}_band_high": view.band_high,
        }
        found.append({"direction": direction})
    return found


def _means(means: Sequence[Any], window: Any, columns: Any, arrays: Arrays) -> list[Any]:
    found = []
    for i, (one, before, after) in enumerate(means):
        for name, extremes in (("before", before), ("after", after)):
            view = profile_view(extremes, window=window, columns=columns)
            arrays |= {
                f"mean_{i}_{name}_x": view.x,
                f"mean_{i}_{name}_low": view.low,
                f"mean_{i}_{name}_high": view.high,
            }
        found.append(
            {
                "feed": one.feed,
                "feed_words": feed_words(one.feed),
                "direction": one.direction,
                "n_runs": one.n_runs,
            }
        )
    return found


def _numbers(estimate: ErrorEstimate) -> dict[str, Any]:
    return {
        "method": estimate.method,
        "lost_motion": _quantity(estimate.lost_motion),
        "slope": _quantity(estimate.slope),
        "residual_rms": number_or_none(estimate.residual_rms),
        "lag": _lag(estimate),
        "pv": _quantity(estimate.peak_to_valley()),
        "messages": [str(m) for m in estimate.messages],
    }


def _lag(estimate: ErrorEstimate) -> dict[str, Any] | None:
    if estimate.method != "joint" or (estimate.lag == 0.0 and math.isnan(estimate.lag_sd)):
        return None  # nothing was corrected
    phrases = [f"{way}: {phrase}" if way else phrase for way, phrase in lag_words(estimate)]
    return {
        "value": number_or_none(estimate.lag),
        "unit": "s",
        "u": number_or_none(estimate.lag_sd),
        "definition": "; ".join(phrases),
    }


def _quantity(given: Quantity | None) -> dict[str, Any] | None:
    if given is None:
        return None
    return {
        "value": number_or_none(given.value),
        "unit": given.unit,
        "u": number_or_none(given.u),
        "definition": given.definition,
    }


# ---- waves -----------------------------------------------------------------------------------


def waves(session: Session, message: Message, cancel: Cancel, tell: Tell) -> Answer:
    """Answer a request ``waves``: amplitude against wavelength, and what repeats."""
    recipe, material, runs, kept = _of_session(session)
    estimate = material.estimate(recipe, cancel) if level_of(message) == "full" else None
    direction = _direction(message.get("direction"), runs)
    lines = feed_waves(runs, direction=direction, estimate=estimate)
    step = _step(recipe)
    header: dict[str, Any] = {
        "is_preview": estimate is None,
        "direction": direction,
        "directions": sorted(runs.directions, reverse=True),
        "part": lines.part,
        "feeds": [{"feed": f, "feed_words": feed_words(f)} for f in lines.feeds],
        "stated": {k: step.get(k) for k in _STATED},
        "messages": [],
    }
    arrays: Arrays = {"wavelength": lines.wavelength}
    arrays |= {f"feed_{i}": row for i, row in enumerate(lines.amplitude)}
    if estimate is not None:
        header["method"] = estimate.method
        header["vibrations"], why = _slides(kept, estimate, runs, direction, lines)
        header["messages"] += [why] if why else []
        if estimate.spectrum_data.get("wavelength_mm"):
            header |= _evidence(estimate_waves(estimate, direction=direction), arrays)
        else:
            header["words"] = (
                f'the method "{estimate.method}" tells no wavelengths apart: the lines are those of '
                "the runs"
            )
    return header, arrays


def _direction(wanted: Any, runs: RunSet) -> int:
    have = sorted(runs.directions, reverse=True)
    if wanted is None:
        return have[0]
    if isinstance(wanted, bool) or wanted not in have:
        raise DataError(
            f"direction is one of {have} (+1 forward, -1 reverse), got {said_value(wanted)}"
        )
    return int(wanted)


def _slides(
    kept: _Kept, estimate: ErrorEstimate, runs: RunSet, direction: int, lines: FeedWaves
) -> tuple[list[dict[str, Any]], str]:
    found, why = kept.vibrations.of(estimate, runs)[direction]
    places = {f: i for i, f in enumerate(lines.feeds) if f is not None}

    def at(feed: float, wavelength: float) -> dict[str, Any]:
        near = min(places, key=lambda f: abs(f - feed), default=None)
        shown = near is not None and abs(near / feed - 1.0) < SAME_FEED
        amplitude = at_wavelength(lines, places[near], wavelength) if shown and near else None
        return {"feed": feed, "wavelength": wavelength, "amplitude": amplitude}

    entries = [
        {
            "frequency": one.frequency,
            "source": one.source,
            "at": [at(v, w) for v, w in zip(one.feeds, one.wavelengths, strict=True)],
        }
        for one in found
    ]
    return entries, why


def _evidence(found: EstimateWaves, arrays: Arrays) -> dict[str, Any]:
    view = found.view
    names = list(dict.fromkeys(found.reasons))
    arrays |= {
        "estimate_wavelength": view.wavelength,
        "estimate_amplitude": view.amplitude,
        "sd": found.sd,
        "reason": np.array([names.index(r) for r in found.reasons], dtype=np.int32),
    }
    for name, values in (("selected", view.selected), ("low", view.low), ("high", view.high)):
        if values is not None:
            arrays[name] = values
    arrays |= {f"statistic_{i}": s.values for i, s in enumerate(found.statistics)}
    return {
        "words": found.words,
        "shortest": {"value": number_or_none(found.shortest), "by": found.shortest_by},
        "m": found.m,
        "reasons": names,
        "thresholds_in_use": found.in_use,
        "statistics": [
            {
                "name": s.name,
                "key": s.threshold.key,
                "value": s.threshold.value,
                "unit": s.threshold.unit,
                "keeps": s.threshold.keeps,
                "least": s.least,
            }
            for s in found.statistics
        ],
    }


# ---- repeated runs over one another, the error that was separated from them, and what is left ----
# Everything is ``error = actual - nominal`` in m over the position in m. Runs are shown without their
# least-squares line over the evaluation range, since each set-up is aligned anew; that is done for
# the picture only. Gaps stay gaps.

_FINE = 8
"""Places in each pixel column at which a separated error is looked at."""

_COVERAGE_K = 2.0
"""Half width of the band in standard uncertainties."""


@dataclass(frozen=True, slots=True, eq=False)
class LevelledRuns:
    """Runs without their lines, ready to be looked at."""

    runs: tuple[Run, ...]  # in the order of the set, without the line of each
    extremes: tuple[Extremes, ...]  # of each run, for any window
    slopes: FloatArray  # shape (n_runs,), rad: slope of each line
    range: tuple[float, float]  # of (float, float), m: over which the lines were fitted
    message: str  # what was done, in plain words

    def views(
        self, *, window: Sequence[float] | None = None, columns: int = 1000
    ) -> tuple[ProfileView, ...]:
        """Return the least and greatest reading of each run in each pixel column."""
        return repeat_views(self.extremes, window=window, columns=columns)


def shown_range(
    runs: RunSet, start: float | None, length: float | None, *, method: str = "joint"
) -> tuple[tuple[float, float], str]:
    """Return the evaluation range before anything is separated.

    Examples
    --------
    >>> runs = RunSet([Run(np.linspace(0.0, 50e-3, 101), np.zeros(101), feed=0.1)])
    >>> shown_range(runs, 0.0, 45e-3)
    ((0.0, 0.045), '')
    """
    try:
        return evaluation_range(runs, start=start, length=length, method=method), ""
    except MetrosepError as exc:
        return runs.full_travel, str(exc)


def level_runs(runs: RunSet, over: tuple[float, float]) -> LevelledRuns:
    """Return runs without the least-squares line of each over a range.

    Notes
    -----
    A run with fewer than two valid samples in the range is levelled over all that it has, which
    the message says. NaN stays NaN.

    Examples
    --------
    >>> x = np.linspace(0.0, 10e-3, 101)
    >>> found = level_runs(RunSet([Run(x, 2e-6 + 1e-4 * x)]), (0.0, 10e-3))
    >>> bool(np.abs(found.runs[0].z).max() < 1e-18), round(float(found.slopes[0]), 12)
    (True, 0.0001)
    """
    level, slopes, elsewhere = [], [], []
    for run in runs:
        line = line_over(run.x, run.z, over)
        if line is None:
            elsewhere.append(run.run_id)
            line = line_over(run.x, run.z, (-math.inf, math.inf)) or (0.0, 0.0)
        slopes.append(line[0])
        level.append(Run(run.x, run.z - np.polyval(line, run.x), feed=run.feed, run_id=run.run_id))
    message = (
        "each without its least-squares line over "
        f"{format_ends(over[0], over[1])}, for display only"
    )
    if elsewhere:
        message += f"; not measured there and levelled over all that was: {', '.join(elsewhere)}"
    array = np.array(slopes)
    array.setflags(write=False)
    return LevelledRuns(tuple(level), tuple(Extremes(r) for r in level), array, over, message)


@dataclass(frozen=True, slots=True, eq=False)
class SeparatedView:
    """The separated error as the screen shows it."""

    x: FloatArray  # shape (n,), m: middle of each pixel column
    # shape (n,), m: least and greatest error in the column; NaN outside the measured travel
    low: FloatArray
    high: FloatArray
    # shape (n,), m: error -+ 2 standard uncertainties, the outermost of the column; NaN where not
    # known
    band_low: FloatArray
    band_high: FloatArray
    direction: int  # +1 forward, -1 reverse, 0 not distinguished


def separated_view(
    estimate: ErrorEstimate,
    *,
    direction: int = 0,
    window: Sequence[float] | None = None,
    columns: int = 1000,
) -> SeparatedView:
    """Return the separated error with its band of two standard uncertainties."""
    if direction not in estimate.directions:
        raise DataError(
            f"the estimate has no direction {direction!r}; it has {estimate.directions}"
        )
    wide = checked_columns(columns)
    x0, x1 = checked_window(window, estimate.fit_range)
    part = estimate.directions_data[direction]
    edges = np.linspace(x0, x1, wide + 1)
    places = np.linspace(x0, x1, wide * _FINE + 1)
    nodes = part.error.x if isinstance(part.error, SampledCurve) else places[:1]
    fine = np.union1d(places, nodes[(nodes >= x0) & (nodes <= x1)])
    first = np.searchsorted(fine, edges[:-1], side="left")
    error = part.error(fine)
    half = _COVERAGE_K * part.uncertainty(fine)
    parts = [
        (edges[:-1] + edges[1:]) / 2.0,
        np.fmin.reduceat(error, first),
        np.fmax.reduceat(error, first),
        np.fmin.reduceat(error - half, first),
        np.fmax.reduceat(error + half, first),
    ]
    for array in parts:
        array.setflags(write=False)
    x, low, high, band_low, band_high = parts
    return SeparatedView(x, low, high, band_low, band_high, direction)


def feed_words(feed: float | None) -> str:
    """Return a feedrate as a person writes it.

    Examples
    --------
    >>> feed_words(0.08)
    '4800 mm/min'
    """
    return "feed not known" if feed is None else f"{feed * 6e4:.6g} mm/min"


# ---- amplitude against wavelength of repeated runs, and what decides which wavelength repeats ----
# Amplitudes are those of waves of the error ``actual - nominal`` in m. Geometry shows at the same
# wavelength at every feedrate, a vibration at v/f.

_MM, _NM = 1e-3, 1e-9
_WAYS = {1: "forward", -1: "reverse"}

_QUICK = 1e8
"""Samples times wavelengths that are summed for a picture before the separation: about two seconds."""

_SMALLEST_Q = 1e-5
"""Adjusted chances below are shown as this: the logarithmic axis ends somewhere."""


@dataclass(frozen=True, slots=True, eq=False)
class FeedWaves:
    """Amplitude against wavelength of the mean run of each feedrate."""

    feeds: tuple[float | None, ...]  # m/s: slowest first; None where the runs do not say it
    wavelength: FloatArray  # shape (K,), m: falling, the same for all
    amplitude: FloatArray  # shape (n_feeds, K), m: of each feedrate
    part: str  # from which part of the travel, in plain words


def feed_waves(
    runs: RunSet, *, direction: int, estimate: ErrorEstimate | None = None
) -> FeedWaves:
    """Return amplitude against wavelength, one line for each feedrate."""
    some = runs.select(direction=direction)
    data: Mapping[str, Sequence[Any]]
    if estimate is None:
        low, high = travel_of(some)
        if sum(len(r) for r in some) * n_wavelengths(some, high - low) > _QUICK:
            part = "they come with the separation: the runs have many samples"
            return FeedWaves((), np.zeros(0), np.zeros((0, 0)), part)
        data = feed_spectra_columns(some)
    else:
        data = _of_direction(estimate.feed_spectra_data, direction)
    feed = np.asarray(data["feed_mm_min"], dtype=np.float64)
    n = int((feed == feed[0]).sum()) if feed.size and not np.isnan(feed[0]) else feed.size
    low, high = travel_of(some)
    part = f"{format_ends(low, high)}, the travel that all runs share, tapered"
    if not n:
        part = "no run is without a gap over the common travel: a Fourier sum cannot bridge it"
        return FeedWaves((), np.zeros(0), np.zeros((0, 0)), part)
    speeds = tuple(None if math.isnan(v) else float(v) / 6e4 for v in feed[::n])
    wavelength = _frozen(np.asarray(data["wavelength_mm"], dtype=np.float64)[:n] * _MM)
    amplitude = np.asarray(data["amplitude_nm"], dtype=np.float64).reshape(-1, n) * _NM
    return FeedWaves(speeds, wavelength, _frozen(amplitude), part)


def at_wavelength(waves: FeedWaves, feed: int, wavelength: float) -> float | None:
    """Return the amplitude of the line of a feedrate at any wavelength.

    Examples
    --------
    >>> line = FeedWaves((0.1,), np.array([4e-3, 1e-3]), np.array([[8e-9, 2e-9]]), "")
    >>> round(at_wavelength(line, 0, 2e-3) * 1e9, 9), at_wavelength(line, 0, 5e-3)
    (4.0, None)
    """
    x, y = waves.wavelength, waves.amplitude[feed]
    if x.size < 2 or not x[-1] <= wavelength <= x[0] or not (y > 0.0).all():
        return None
    place = np.log(wavelength)
    return float(np.exp(np.interp(place, np.log(x[::-1]), np.log(y[::-1]))))


@dataclass(frozen=True, slots=True)
class Threshold:
    """A threshold of the separation that can be moved."""

    key: Literal["sigma_t", "p_t", "false_discovery_rate"]  # of the step ``separate``
    value: float  # as it was used, SI
    unit: str  # ``"m"``, ``"m2"``, ``"m3"`` or ``"1"``
    keeps: Literal["below", "above"]  # {"below", "above"}: which side of it passes


@dataclass(frozen=True, slots=True, eq=False)
class Statistic:
    """What a threshold is compared with, for each wavelength."""

    name: str  # for the axis, in plain words
    values: FloatArray  # shape (K,): naN where not known
    threshold: Threshold  # its threshold
    least: float = 0.0  # smaller values are shown as this


@dataclass(frozen=True, slots=True, eq=False)
class EstimateWaves:
    """The wavelengths of a separation with the evidence for each."""

    # wavelength (falling), amplitude, selected, band of -+ 2 standard uncertainties
    view: SpectrumView
    sd: FloatArray  # shape (K,), m: standard uncertainty of each amplitude; NaN where not known
    reasons: tuple[str, ...]  # why each wavelength is selected or not
    # what the method decides by; none where the method has no threshold
    statistics: tuple[Statistic, ...]
    shortest: float | None  # m: shortest wavelength of the model
    shortest_by: str  # who chose it
    m: int | None  # highest harmonic that Kono's method keeps
    # whether the thresholds choose; not where ``shortest`` is set by hand in Kono's method
    in_use: bool
    words: str  # what this is, in a sentence


def estimate_waves(estimate: ErrorEstimate, *, direction: int) -> EstimateWaves:
    """Return the wavelengths of a separation of one direction, with the evidence for each.

    Notes
    -----
    Joint: a wavelength is selected where its chance ``p``, adjusted for the number of wavelengths
    after Benjamini and Hochberg, does not exceed ``false_discovery_rate``. Kono: where the
    standard deviation over the feedrates lies below ``sigma_t`` and the mean above ``p_t``; with
    the rule "shortest" all longer wavelengths too.
    """
    view = estimate_view(estimate, direction=direction)
    data = _of_direction(estimate.spectrum_data, direction)
    order = np.argsort(-np.asarray(data["wavelength_mm"], dtype=np.float64), kind="stable")
    audit = estimate.audit.get(_WAYS[direction], estimate.audit)
    column = {
        k: np.asarray(v, dtype=np.float64)[order]
        for k, v in data.items()
        if k in ("sd_nm", "p", "sigma_si", "mean_power_si")
    }
    reasons = tuple(str(data["reason"][i]) for i in order)
    sd = _frozen(column["sd_nm"] * _NM)
    if estimate.method == "kono":
        by_hand = audit["wavelength_chosen_by"] == "user"
        m = int(audit["m"])
        shortest = float(audit["selected_wavelength_mm"]) * _MM
        words = f"m = {m} waves in {audit['modelling_length_mm']:.6g} mm"
        words += (
            ", set by hand: the thresholds are not in use"
            if by_hand
            else f"; shortest wavelength that repeats {format_length(shortest)}"
        )
        chosen = "set by hand" if by_hand else f"the thresholds, rule {audit['rule']}"
        return EstimateWaves(
            view, sd, reasons, _of_kono(column, audit), shortest, chosen, m, not by_hand, words
        )
    shortest = float(audit["shortest_wavelength_mm"]) * _MM
    by_hand = audit["shortest_wavelength_chosen_by"] == "user"
    rate = Threshold("false_discovery_rate", float(audit["false_discovery_rate"]), "1", "below")
    q = _frozen(np.maximum(adjusted_p(column["p"]), _SMALLEST_Q))
    n_selected = int(view.selected.sum()) if view.selected is not None else 0
    return EstimateWaves(
        view,
        sd,
        reasons,
        (Statistic("chance of such a wave in noise alone, adjusted", q, rate, _SMALLEST_Q),),
        shortest,
        "set by hand" if by_hand else "the evidence",
        None,
        True,
        f"{n_selected} of {len(reasons)} wavelengths repeat; the model goes down to "
        f"{format_length(shortest)}",
    )


def _of_kono(column: Mapping[str, FloatArray], audit: Mapping[str, Any]) -> tuple[Statistic, ...]:
    unit = str(audit["sigma_t_unit"])
    sigma = Threshold("sigma_t", float(audit["sigma_t_si"]), unit, "below")
    mean = Threshold("p_t", float(audit["p_t_si"]), str(audit["p_t_unit"]), "above")
    what = "standard deviation over mean" if unit == "1" else "standard deviation"
    return (
        Statistic(f"{what} over the feedrates", _frozen(column["sigma_si"]), sigma),
        Statistic("mean over the feedrates", _frozen(column["mean_power_si"]), mean),
    )


def adjusted_p(p: FloatArray) -> FloatArray:
    """Return chances adjusted after Benjamini and Hochberg.

    References
    ----------
    .. [1] Benjamini and Hochberg 1995; Yekutieli and Benjamini 1999, eq. 3.

    Examples
    --------
    >>> adjusted_p(np.array([0.01, 0.9, 0.02])).round(6).tolist()
    [0.03, 0.9, 0.03]
    """
    n = p.size
    order = np.argsort(p, kind="stable")
    stepped = p[order] * n / np.arange(1, n + 1)
    adjusted = np.minimum(np.minimum.accumulate(stepped[::-1])[::-1], 1.0)
    out = np.empty(n)
    out[order] = adjusted
    return out


def _of_direction(data: Mapping[str, Sequence[Any]], direction: int) -> dict[str, list[Any]]:
    """Return the rows of a table that belong to a direction."""
    if "direction" not in data:
        return {k: list(v) for k, v in data.items()}
    mine = [i for i, way in enumerate(data["direction"]) if way == _WAYS[direction]]
    return {k: [v[i] for i in mine] for k, v in data.items() if k != "direction"}


def _frozen(array: FloatArray) -> FloatArray:
    array.setflags(write=False)
    return array
