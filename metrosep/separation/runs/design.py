"""Private to separation: runs made ready for a linear model in position and time.

Scales the heights to unit variance and positions to the travel, thins very long records by block
averages (the basis is averaged with them, so nothing is biased), and groups runs that share a
sampling interval, since an autoregressive model in time belongs to one interval. Times are those of
the fitted clock (`clock`); a lost sample is a row without a reading.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotUniformError,
    TooFewSamplesError,
)
from metrosep.core.runset import Run, RunSet
from metrosep.core.units import format_ends
from metrosep.separation._readings import joint_coefficients, not_tied
from metrosep.separation.runs.clock import Clock, fit_clock

if TYPE_CHECKING:
    from metrosep.separation.runs.base import ErrorEstimate

_MAX_POINTS = 100_000
"""Positions of the grid on which runs are compared one by one."""

_MAX_ROWS = 12_000
"""More samples than this, all runs together, are averaged in blocks."""

_TIME_STEP = 1e-3
"""Interval in s up to which fast records are averaged: 48 coefficients of the noise model must span
the slow modes of a machine."""

_PITCHES = 800
"""The slowest feed keeps at least this many samples over the travel when runs are averaged for that reason: short waves stay."""

SAME_INTERVAL = 0.01
"""Sampling intervals that differ by less are one: such runs are averaged alike and share a noise model."""

_TRAVEL_RTOL = 0.02
"""Ends of the runs may differ by this share of the travel before the range must be stated."""

COVERED = 0.95
"""Share of a travel that is demanded of the readings of a table, and from which one run covers it."""

_RANGE_RTOL = 1e-6
"""Rounding by which a stated range may pass the measured travel, relative."""


@dataclass(frozen=True, slots=True, eq=False)
class PreparedRun:
    """One run, thinned where necessary."""

    x: FloatArray  # shape (n,), m: positions and readings in the order of time
    z: FloatArray
    velocity: float  # m/s: signed mean velocity
    time_step: float  # s: sampling interval after thinning
    block: int  # samples averaged into one
    block_length: float  # m: travel over which one sample averages, 0 without thinning
    run_id: str  # name of the run
    t: FloatArray  # shape (n,), s: time of each sample
    probe: str = ""  # name of the probe that read it; empty where there is one only


def prepare_runs(runs: RunSet, *, probes: Sequence[str] | None = None) -> list[PreparedRun]:
    """Return the runs checked for time, thinned so that the model stays affordable."""
    block = max(1, -(-sum(len(r) for r in runs) // _MAX_ROWS))
    names = probes or [""] * len(runs)
    clocks = [_clock(run) for run in runs]
    slow = _averaged(runs, clocks)
    return [
        _prepare(run, clock, max(block, own), name)
        for run, clock, own, name in zip(runs, clocks, slow, names, strict=True)
    ]


def _clock(run: Run) -> Clock:
    name = run.run_id
    if run.t is None or run.feed is None:
        raise InvalidSamplesError(
            f"run {name!r} has no time; the joint method needs time to tell vibration from "
            "geometry: give a time column, the sampling rate or the feed (or use method='mean')"
        ).hinting(method="mean")
    try:
        return fit_clock(run)
    except NotUniformError as exc:
        raise NotUniformError(f"run {name!r}: {exc}") from None


def _averaged(runs: RunSet, clocks: Sequence[Clock]) -> list[int]:
    """Return how many samples of each run are averaged, as far as slow modes and short waves bear it.

    Runs of one sampling interval have one number, that of the slowest feed: in time vibration is alike
    at every feedrate, and what is tied to position is not. A noise model for each feedrate, which
    another interval would give it, takes what slips for its own vibration.
    """
    travel = max(abs(float(r.x[-1] - r.x[0])) for r in runs)
    steps = np.array([c.step for c in clocks])
    pitches = [
        abs(float(r.x[-1] - r.x[0])) / max(c.size - 1, 1)
        for r, c in zip(runs, clocks, strict=True)
    ]
    places = travel / np.maximum(pitches, 1e-300) + 1.0
    own = np.minimum(
        np.floor(_TIME_STEP / steps * (1.0 + 1e-6)), np.floor(places / _PITCHES * (1.0 + 1e-6))
    )
    return [int(own[np.abs(steps - step) <= SAME_INTERVAL * step].max()) for step in steps]


def _prepare(run: Run, clock: Clock, block: int, probe: str) -> PreparedRun:
    name = run.run_id
    if (~np.isnan(run.z)).sum() < 32 * block:
        raise TooFewSamplesError(
            f"run {name!r} has {int((~np.isnan(run.z)).sum())} valid samples, the joint method needs "
            f"at least {32 * block} in each run; use method='mean' or leave the run out"
        ).hinting(method="mean")
    n = clock.size // block * block
    taken = np.arange(clock.size)
    z = np.full(clock.size, np.nan)
    z[clock.index] = run.z
    places = np.interp(taken, clock.index, run.x)
    times = clock.start + clock.step * taken
    x, z = block_means(places[:n].reshape(-1, block), z[:n].reshape(-1, block))
    t = times[:n].reshape(-1, block).mean(axis=1)
    pitch = abs(float(places[n - 1] - places[0])) / max(n - 1, 1)
    return PreparedRun(
        x=x,
        z=z,
        velocity=float(run.x[-1] - run.x[0]) / float(times[-1] - times[0]),
        time_step=clock.step * block,
        block=block,
        block_length=pitch * block if block > 1 else 0.0,
        run_id=name,
        t=t,
        probe=probe,
    )


def block_means(x: FloatArray, z: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the means of the measured samples of each block, NaN where few were measured.

    Few is less than half of what a block of this run usually has: a mean of few samples has more
    noise than the rest, which share one noise model.
    """
    valid = ~np.isnan(z)
    count = valid.sum(axis=1)
    some = count > 0
    known = some & (2 * count >= np.median(count[some])) if some.any() else some
    mean_x, mean_z = x.mean(axis=1), np.full(len(z), np.nan)
    mean_x[known] = np.where(valid, x, 0.0).sum(axis=1)[known] / count[known]
    mean_z[known] = np.where(valid, z, 0.0).sum(axis=1)[known] / count[known]
    return mean_x, mean_z


def evaluation_range(
    runs: RunSet, *, start: float | None, length: float | None, method: str = ""
) -> tuple[float, float]:
    """Return start and stop of the evaluation range.

    Every run covers it; for the joint method and the mean, where it is stated, some run does at each
    place, and no part needs to be covered by all of them.
    """
    every = method not in ("joint", "mean") or start is None or length is None
    for name, value in (("start", start), ("length", length)):
        if value is not None and not np.isfinite(value):
            raise InvalidSamplesError(f"{name} must be a finite number in m, got {value}")
    widest_low, widest_high = runs.full_travel
    low, high = runs.common_travel if every else runs.full_travel
    travel = high - low
    if length is None and start is None:
        uneven = max(low - widest_low, widest_high - high)
        if uneven > _TRAVEL_RTOL * travel:
            raise InvalidSamplesError(
                f"the runs have different travels: all of them cover {format_ends(low, high)}"
                f", some reach {format_ends(widest_low, widest_high)}"
                f", {_odd_ends(runs)}; state start and length inside the "
                "common part, or leave out the run that differs"
            )
        return low, high
    if length is None:
        assert start is not None  # noqa: S101  (the case of neither was handled above)
        first, last = start, high
    else:
        if not length > 0.0:
            raise InvalidSamplesError(f"length must be positive, got {length} m")
        first = low + (travel - length) / 2.0 if start is None else start
        last = first + length
    margin = _RANGE_RTOL * travel
    what = "by every run: they share"
    if not every:
        what = "by the runs: they reach"
    if first < low - margin or last > high + margin or last <= first:
        raise InvalidSamplesError(
            f"the evaluation range {format_ends(first, last)} is not covered "
            f"{what} {format_ends(low, high)}; shorten it or measure further"
        )
    thin = [] if every else thin_parts(runs, first + margin, last - margin)
    if hole := next((part for part in thin if part[2] == 0), None):
        raise InvalidSamplesError(
            f"no run covers {format_ends(hole[0], hole[1])} of the evaluation "
            f"range {format_ends(first, last)}; shorten it or measure there"
        )
    return max(first, low), min(last, high)


def measured_pitch(run: Run | PreparedRun) -> float:
    """Return the distance in m between readings of a run, as it usually is between measured ones."""
    apart = np.diff(np.flatnonzero(~np.isnan(run.z)))
    usual = round(float(np.median(apart))) if apart.size else 1
    return abs(float(run.x[-1] - run.x[0])) / max(run.x.size - 1, 1) * max(usual, 1)


def on_common_grid(runs: RunSet, low: float, high: float) -> tuple[FloatArray, FloatArray, float]:
    """Return a grid in the pitch of the coarsest run, the runs on it, NaN in gaps, and that pitch."""
    pitch = max(measured_pitch(r) for r in runs)
    n_grid = int(np.clip(math.ceil((high - low) / pitch), 3, _MAX_POINTS)) + 1
    grid = np.linspace(low, high, n_grid)
    return grid, np.array([_on_grid(r.x, r.z, grid, pitch) for r in runs]), pitch


def _on_grid(x: FloatArray, z: FloatArray, grid: FloatArray, pitch: float) -> FloatArray:
    """Interpolate valid samples; a gap of more than two pitches stays a gap."""
    valid = ~np.isnan(z)
    order = np.argsort(x[valid])
    xs, zs = x[valid][order], z[valid][order]
    values = np.interp(grid, xs, zs, left=np.nan, right=np.nan)
    right = np.clip(np.searchsorted(xs, grid), 1, xs.size - 1)
    gap = xs[right] - xs[right - 1] > 2.0 * pitch
    inside_gap = gap & (grid > xs[right - 1]) & (grid < xs[right])
    return np.where(inside_gap, np.nan, values)


def travel_of(runs: RunSet) -> tuple[float, float]:
    """Return the travel that all runs share; where it was measured part by part, all of it."""
    try:
        return runs.common_travel
    except InvalidSamplesError:
        return runs.full_travel


@dataclass(frozen=True, slots=True, eq=False)
class MeanRun:
    """The mean run of one feedrate and direction, before and after the separated error is taken off."""

    x: FloatArray  # shape (n,), m: rising, over the travel that all runs of the direction share
    # shape (n,), m: mean of the levelled runs, of those that were measured there, and what is left of
    # it; NaN where none was
    before: FloatArray
    after: FloatArray
    feed: float | None  # m/s: none where the runs do not say it
    direction: int  # +1 or -1
    n_runs: int  # how many were averaged


def mean_runs(runs: RunSet, estimate: ErrorEstimate) -> tuple[MeanRun, ...]:
    """Return the mean run of each feedrate and direction, before and after the separation.

    Each is put onto as many even places as the longest run of its feedrate has samples, and levelled
    by the line of what the error leaves of it: of a run with holes such a line has no part of the error.
    """
    over = (estimate.start, estimate.stop)
    found = []
    for direction in sorted(runs.directions, reverse=True):
        some = runs.select(direction=direction)
        low, high = travel_of(some)
        for feed, members in some.by_feed() or [(math.nan, some.runs)]:
            x = np.linspace(low, high, max(len(r) for r in members))
            error = estimate.evaluate(x, direction=direction)
            rows = np.array([_levelled(r, x, error, over) for r in members])
            seen = ~np.isnan(rows).all(axis=0)
            before = np.full(x.size, np.nan)
            before[seen] = np.nanmean(rows[:, seen], axis=0)
            after = before - error
            for array in (x, before, after):
                array.setflags(write=False)
            known = None if math.isnan(feed) else feed
            found.append(MeanRun(x, before, after, known, direction, len(members)))
    return tuple(found)


def _levelled(run: Run, x: FloatArray, error: FloatArray, over: tuple[float, float]) -> FloatArray:
    """Return a run at positions less its line over a range; all NaN where it has none."""
    values = _on_grid(run.x, run.z, x, measured_pitch(run))
    rest = values - error
    line = line_over(x, rest, over) or line_over(x, rest, (-math.inf, math.inf))
    return np.asarray(values - np.polyval(line or (math.nan, math.nan), x))


def line_over(
    x: FloatArray, z: FloatArray, over: tuple[float, float]
) -> tuple[float, float] | None:
    """Return slope and level at zero of the line over a range; None where it cannot be fitted."""
    inner = (x >= over[0]) & (x <= over[1]) & ~np.isnan(z)
    if inner.sum() < 2:
        return None
    mid = float(x[inner].mean())
    slope, level = np.polyfit(x[inner] - mid, z[inner], 1)
    return float(slope), float(level - slope * mid)


def lines_of_runs(
    runs: RunSet, table: FloatArray, line: FloatArray, inner: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray | None]:
    """Return offset and slope of each run by `line`, and the normal matrix of lines fitted together.

    Where each run was measured everywhere its line is its own, and there is no such matrix. With
    holes in other places such a line would follow the error of the part that was measured, so all
    are fitted with the mean: ``z_r(x) = f(x) + line(x) c_r``. Then the mean of the c_r is not
    determined (least norm) and left in f.
    """
    valid = inner & ~np.isnan(table)
    for run, seen in zip(runs, valid, strict=True):
        if seen.sum() < 2:
            raise DataError(
                f"run {run.run_id!r} has fewer than 2 valid samples in the evaluation range"
            )
    seen = valid.any(axis=0)
    if (valid == seen).all():
        alone = np.asarray(np.linalg.lstsq(line[seen], table[:, seen].T, rcond=None)[0].T)
        return alone, None
    _require_tied(runs, valid, line.shape[1])
    own = np.where(valid, table, 0.0)
    return joint_coefficients(own, valid, valid.sum(axis=0).astype(np.float64), line)


def in_parts(runs: RunSet, first: float, last: float) -> bool:
    """Return whether a range was measured part by part: no run covers it."""
    reach = (min(float(r.x.max()), last) - max(float(r.x.min()), first) for r in runs)
    return max(reach) < COVERED * (last - first)


def require_tied(runs: RunSet) -> None:
    """Refuse runs of parts that no chain of runs ties by three places: offset and slope are two."""
    pitch = max(measured_pitch(r) for r in runs)
    low, high = runs.full_travel
    grid = np.linspace(low, high, int(min((high - low) / pitch, _MAX_POINTS)) + 1)
    spans = [(known.min(), known.max()) for r in runs for known in [r.x[~np.isnan(r.z)]]]
    _require_tied(runs, np.array([(grid >= a) & (grid <= b) for a, b in spans]), 2)


def _require_tied(runs: RunSet, valid: NDArray[np.bool_], n_columns: int) -> None:
    loose = not_tied(valid, n_columns)
    if not loose:
        return
    names = ", ".join(repr(runs[i].run_id) for i in loose[:8])
    raise DataError(
        f"run {names} and run {runs[0].run_id!r} were measured in separate parts: no chain of runs "
        f"with more than {n_columns} positions in common tells their offsets and slopes apart; add a "
        "run that reaches over both parts, or leave one part out"
    )


def thin_parts(runs: RunSet, first: float, last: float) -> list[tuple[float, float, int, int]]:
    """Return the parts of a range that some runs do not reach: ends, runs and feedrates there."""
    ends = sorted({first, last, *(float(v) for r in runs for v in (r.x.min(), r.x.max()))})
    out: list[tuple[float, float, int, int]] = []
    for a, b in pairwise(ends):
        if b <= first or a >= last:
            continue
        there = [r for r in runs if r.x.min() <= a and r.x.max() >= b]
        feeds = len(RunSet(there).feeds) if there else 0
        if out and out[-1][2:] == (len(there), feeds):
            out[-1] = (out[-1][0], b, len(there), feeds)
        else:
            out.append((a, b, len(there), feeds))
    return [part for part in out if part[2] < len(runs)]


def _odd_ends(runs: RunSet) -> str:
    """Say which run ends farthest from where the runs usually do."""
    ends = np.array([sorted((float(r.x[0]), float(r.x[-1]))) for r in runs])
    far = int(np.argmax(np.abs(ends - np.median(ends, axis=0)).max(axis=1)))
    name = runs[far].run_id or str(far + 1)
    return f"run {name} {format_ends(ends[far, 0], ends[far, 1])}"


def probe_names(runs: RunSet, probes: Sequence[str] | None) -> list[str]:
    """Return the name of the probe of each run."""
    if probes is None:
        told = [run.metadata.get("probe") for run in runs]
        if all(name is None for name in told):
            return [""] * len(runs)
        missing = [r.run_id or str(i) for i, r in enumerate(runs) if told[i] is None]
        if missing:
            raise DataError(
                f"run {missing[0]!r} does not say which probe read it, others do; set "
                "metadata['probe'] in every run, or state probes=[...]"
            )
        return [str(name) for name in told]
    if isinstance(probes, str | bytes) or not np.iterable(probes):
        raise DataError(f"probes is a list with one name for each run, got {probes!r}")
    names = [str(p) for p in probes]
    if len(names) != len(runs):
        raise DataError(f"probes names {len(names)} runs, there are {len(runs)}; one for each run")
    return names
