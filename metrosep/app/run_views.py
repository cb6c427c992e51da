"""Repeated runs over one another, the error that was separated from them, and what is left.

Everything is ``error = actual - nominal`` in m over the position in m. Runs are shown without their
least-squares line over the evaluation range, since each set-up is aligned anew; that is done for
the picture only. Gaps stay gaps.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from metrosep.app.profile_views import Extremes, ProfileView, find_holes, repeat_views
from metrosep.app.view_limits import checked_columns, checked_window
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, MetrosepError
from metrosep.core.runset import Run, RunSet
from metrosep.core.units import format_length
from metrosep.separation.base import ErrorEstimate
from metrosep.separation.curves import SampledCurve
from metrosep.separation.design import evaluation_range

__all__ = [
    "LevelledRuns",
    "MeanRun",
    "SeparatedView",
    "feed_words",
    "level_runs",
    "mean_runs",
    "separated_view",
    "shown_range",
]


_FINE = 8
"""Places in each pixel column at which a separated error is looked at."""

_COVERAGE_K = 2.0
"""Half width of the band in standard uncertainties."""

_LEAST = 2
"""Valid samples that a line needs."""


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
    runs: RunSet, start: float | None, length: float | None
) -> tuple[tuple[float, float], str]:
    """Return the evaluation range before anything is separated.

    Examples
    --------
    >>> runs = RunSet([Run(np.linspace(0.0, 50e-3, 101), np.zeros(101), feed=0.1)])
    >>> shown_range(runs, 0.0, 45e-3)
    ((0.0, 0.045), '')
    """
    try:
        return evaluation_range(runs, start=start, length=length), ""
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
        line = _line(run.x, run.z, over)
        if line is None:
            elsewhere.append(run.run_id)
            line = _line(run.x, run.z, (-math.inf, math.inf)) or (0.0, 0.0)
        slopes.append(line[0])
        level.append(Run(run.x, run.z - np.polyval(line, run.x), feed=run.feed, run_id=run.run_id))
    message = (
        "each without its least-squares line over "
        f"{format_length(over[0])} ... {format_length(over[1])}, for display only"
    )
    if elsewhere:
        message += f"; not measured there and levelled over all that was: {', '.join(elsewhere)}"
    array = np.array(slopes)
    array.setflags(write=False)
    return LevelledRuns(tuple(level), tuple(Extremes(r) for r in level), array, over, message)


def _line(x: FloatArray, z: FloatArray, over: tuple[float, float]) -> tuple[float, float] | None:
    """Return slope and level at zero of the line over a range; None where it cannot be fitted."""
    inner = (x >= over[0]) & (x <= over[1]) & ~np.isnan(z)
    if inner.sum() < _LEAST:
        return None
    mid = float(x[inner].mean())
    slope, level = np.polyfit(x[inner] - mid, z[inner], 1)
    return float(slope), float(level - slope * mid)


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


@dataclass(frozen=True, slots=True, eq=False)
class MeanRun:
    """The mean run of one feedrate and direction, before and after the separated error is taken off."""

    x: FloatArray  # shape (n,), m: rising, over the travel that all runs of the direction share
    # shape (n,), m: mean of the levelled runs, and what is left of it; NaN where any of them was
    # not measured
    before: FloatArray
    after: FloatArray
    feed: float | None  # m/s: none where the runs do not say it
    direction: int  # +1 or -1
    n_runs: int  # how many were averaged


def mean_runs(runs: RunSet, estimate: ErrorEstimate) -> tuple[MeanRun, ...]:
    """Return the mean run of each feedrate and direction, before and after the separation.

    Notes
    -----
    Each run is put onto as many even places as the longest run of its feedrate has samples, and
    levelled over the evaluation range. Neither NaN nor a hole in the positions is bridged.
    """
    over = (estimate.start, estimate.stop)
    found = []
    for direction in sorted(runs.directions, reverse=True):
        some = runs.select(direction=direction)
        low, high = some.common_travel
        for feed, members in some.by_feed() or [(math.nan, some.runs)]:
            x = np.linspace(low, high, max(len(r) for r in members))
            before = np.mean([_levelled_on(r, x, over) for r in members], axis=0)
            after = before - estimate.evaluate(x, direction=direction)
            for array in (x, before, after):
                array.setflags(write=False)
            known = None if math.isnan(feed) else feed
            found.append(MeanRun(x, before, after, known, direction, len(members)))
    return tuple(found)


def _levelled_on(run: Run, x: FloatArray, over: tuple[float, float]) -> FloatArray:
    """Return a run at positions, without its line over a range; gaps and holes are NaN."""
    turned = 1 if run.direction > 0 else -1
    xs, zs = run.x[::turned], run.z[::turned]
    values = np.interp(x, xs, zs)
    for i in find_holes(xs):
        values[(x > xs[i]) & (x < xs[i + 1])] = np.nan
    line = _line(x, values, over) or _line(x, values, (-math.inf, math.inf))
    return np.asarray(values if line is None else values - np.polyval(line, x))


def feed_words(feed: float | None) -> str:
    """Return a feedrate as a person writes it.

    Examples
    --------
    >>> feed_words(0.08)
    '4800 mm/min'
    """
    return "feed not known" if feed is None else f"{feed * 6e4:.6g} mm/min"
