"""Private to separation: runs made ready for a linear model in position and time.

Scales the heights to unit variance and positions to the travel, thins very long records by block
averages (the basis is averaged with them, so nothing is biased), and groups runs that share a
sampling interval, since an autoregressive model in time belongs to one interval. Times are those of
the fitted clock (`clock`); a lost sample is a row without a reading.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotUniformError,
    TooFewSamplesError,
)
from metrosep.core.runset import Run, RunSet
from metrosep.core.units import format_ends
from metrosep.separation.runs.clock import fit_clock

__all__ = ["PreparedRun", "evaluation_range", "prepare_runs", "probe_names", "thin_parts"]


_MAX_ROWS = 12_000
"""More samples than this, all runs together, are averaged in blocks."""

_TIME_STEP = 1e-3
"""Interval in s up to which fast records are averaged: 48 coefficients of the noise model must span
the slow modes of a machine."""

_PITCHES = 800
"""A run keeps at least this many samples when it is averaged for that reason: short waves stay."""

_TRAVEL_RTOL = 0.02
"""Ends of the runs may differ by this share of the travel before the range must be stated."""

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
    return [_prepare(run, block, name) for run, name in zip(runs, names, strict=True)]


def _prepare(run: Run, block: int, probe: str) -> PreparedRun:
    name = run.run_id
    if run.t is None or run.feed is None:
        raise InvalidSamplesError(
            f"run {name!r} has no time; the joint method needs time to tell vibration from "
            "geometry: give a time column, the sampling rate or the feed (or use method='mean')"
        )
    try:
        clock = fit_clock(run)
    except NotUniformError as exc:
        raise NotUniformError(f"run {name!r}: {exc}") from None
    # Averaged as far as slow modes and short waves bear it.
    slow = min(int(_TIME_STEP / clock.step * (1.0 + 1e-6)), clock.size // _PITCHES)
    block = max(block, slow)
    if (~np.isnan(run.z)).sum() < 32 * block:
        raise TooFewSamplesError(
            f"run {name!r} has {int((~np.isnan(run.z)).sum())} valid samples, the joint method needs "
            f"at least {32 * block} in each run; use method='mean' or leave the run out"
        )
    n = clock.size // block * block
    taken = np.arange(clock.size)
    z = np.full(clock.size, np.nan)
    z[clock.index] = run.z
    places = np.interp(taken, clock.index, run.x)
    times = clock.start + clock.step * taken
    x, z, t = (row[:n].reshape(-1, block).mean(axis=1) for row in (places, z, times))
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


def evaluation_range(
    runs: RunSet, *, start: float | None, length: float | None, method: str = ""
) -> tuple[float, float]:
    """Return start and stop of the evaluation range.

    Every run covers it; for the joint method, where it is stated, some run does at each place.
    """
    every = method != "joint" or start is None or length is None
    for name, value in (("start", start), ("length", length)):
        if value is not None and not np.isfinite(value):
            raise InvalidSamplesError(f"{name} must be a finite number in m, got {value}")
    low, high = runs.common_travel
    widest_low, widest_high = runs.full_travel
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
        low, high, what = widest_low, widest_high, "by the runs: they reach"
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
