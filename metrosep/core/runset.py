"""`Run` and `RunSet`: repeated passes of one axis over one path.

A `Run` keeps its samples in the order of time, since a vibration is a process in time while a
geometric error is a function of position; a reverse run has falling positions. The feedrate, the
time and the positions must agree with each other: a feed typed in the wrong unit is refused.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray, frozen_float, same_length
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.core.numbers import positive
from metrosep.core.profile import Profile, html_table
from metrosep.core.provenance import Step, freeze_mapping, hash_bytes
from metrosep.core.public import PublicObject, shortened
from metrosep.core.units import format_ends, format_length

_FEED_RTOL = 0.2
"""Largest relative disagreement of a stated feed with positions over time."""

SAME_FEED = 0.02
"""Feeds closer than this, relative, are one feedrate."""

FORWARD = frozenset(
    [
        "fwd",
        "forward",
        "forwards",
        "f",
        "+",
        "+1",
        "1",
        "1.0",
        "up",
        "vor",
        "vorwärts",
        "hin",
        "aller",
        "avanti",
        "ida",
        "正向",
        "正",
        "往",
        "往路",
        "positive",
    ]
)
REVERSE = frozenset(
    [
        "rev",
        "reverse",
        "r",
        "bwd",
        "backward",
        "backwards",
        "b",
        "-",
        "-1",
        "-1.0",
        "down",
        "zurück",
        "rück",
        "rückwärts",
        "her",
        "retour",
        "indietro",
        "vuelta",
        "反向",
        "逆",
        "復",
        "復路",
        "negative",
    ]
)
"""How a column of directions says which way a run goes, or a target is approached."""

_MM_PER_MIN = 1e-3 / 60.0


def feed_groups(feeds: Sequence[float]) -> list[list[int]]:
    """Return the indices of feeds that are one feedrate, slowest group first: the slowest of it leads."""
    groups: list[list[int]] = []
    for i in sorted(range(len(feeds)), key=lambda k: (feeds[k], k)):
        if groups and feeds[i] <= feeds[groups[-1][0]] * (1.0 + SAME_FEED):
            groups[-1].append(i)
        else:
            groups.append([i])
    return groups


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Run(PublicObject):
    """One pass of an axis, in the order of time; frozen, SI, NaN = not measured.

    Parameters
    ----------
    x : array_like, shape (n,), m
        Position read by the encoder, finite, strictly rising (forward) or falling (reverse).
    z : array_like, shape (n,), m
        Measured error ``actual - nominal``; NaN where not measured.
    t : array_like, shape (n,), s, optional
        Time stamp of each sample, in order but for the jitter of the clock: stamps may repeat, or
        fall back by up to two mean steps. Without it the time follows from `feed` and the mean step;
        without either the run has no time, and only methods in space accept it.
    feed : float, m/s, optional
        Feedrate, > 0. Without it, from position over time.
    run_id : str, optional
        Name of the run.
    metadata : mapping, optional
        What the file said.

    Raises
    ------
    InvalidSamplesError
        If positions turn, repeat or are NaN, or time stands still or falls back.
    TooFewSamplesError
        If there are fewer than three samples.
    DataError
        If feed and time contradict each other by more than 20 %.

    Examples
    --------
    >>> import numpy as np
    >>> Run(np.linspace(10e-3, 0, 101), np.zeros(101), feed=0.08, run_id="r1")
    Run('r1': 101 samples, 10 ... 0 mm, reverse, 4800 mm/min)
    """

    x: FloatArray
    z: FloatArray
    t: FloatArray | None = None
    feed: float | None = None
    run_id: str = ""
    metadata: Mapping[str, Any] = field(default_factory=dict)

    def __init__(
        self,
        x: ArrayLike,
        z: ArrayLike,
        *,
        t: ArrayLike | None = None,
        feed: float | None = None,
        run_id: str = "",
        metadata: Mapping[str, Any] | None = None,
    ) -> None:
        xs = frozen_float(x, name=f"run {run_id!r}: x", ndim=1, min_size=3)
        zs = frozen_float(z, name=f"run {run_id!r}: z", ndim=1, min_size=3)
        same_length(x=xs, z=zs)
        _check_monotonic(xs, run_id)
        speed = _checked_feed(feed, run_id)
        ts: FloatArray | None = None
        if t is not None:
            ts = frozen_float(t, name=f"run {run_id!r}: t", ndim=1, min_size=3)
            same_length(x=xs, t=ts)
            _check_time(ts, run_id)
            measured = abs(float(xs[-1] - xs[0])) / float(ts[-1] - ts[0])
            if speed is None:
                speed = measured
            elif abs(measured / speed - 1.0) > _FEED_RTOL:
                raise DataError(
                    f"run {run_id!r}: the stated feed is {speed / _MM_PER_MIN:.6g} mm/min, but "
                    f"positions over time give {measured / _MM_PER_MIN:.6g} mm/min; check the units "
                    "of feed, position and time (or the sampling rate)"
                )
        elif speed is not None:
            ts = frozen_float(
                np.arange(xs.size) * (abs(xs[-1] - xs[0]) / (xs.size - 1) / speed),
                name="t",
                ndim=1,
            )
        object.__setattr__(self, "x", xs)
        object.__setattr__(self, "z", zs)
        object.__setattr__(self, "t", ts)
        object.__setattr__(self, "feed", speed)
        object.__setattr__(self, "run_id", str(run_id))
        object.__setattr__(self, "metadata", freeze_mapping(metadata))

    def __len__(self) -> int:
        return int(self.x.size)

    @property
    def direction(self) -> int:
        """+1 for a forward run (rising positions), -1 for a reverse one."""
        return 1 if self.x[-1] > self.x[0] else -1

    @property
    def sampling_rate(self) -> float | None:
        """Mean sampling rate in Hz; None without time."""
        if self.t is None:
            return None
        return float((self.t.size - 1) / (self.t[-1] - self.t[0]))

    @property
    def sha256(self) -> str:
        """Digest of positions and readings: the same numbers, the same run."""
        z = np.where(np.isnan(self.z), np.nan, self.z)  # one kind of NaN
        return hash_bytes(self.x.tobytes() + z.tobytes())

    @property
    def n_invalid(self) -> int:
        """Number of samples that were not measured."""
        return int(np.isnan(self.z).sum())

    def to_profile(self) -> Profile:
        """Return the run as a profile with rising positions.

        Returns
        -------
        Profile
            Positions and heights; time and feed are dropped.
        """
        return Profile(self.x, self.z, metadata=self.metadata)

    def __repr__(self) -> str:
        way = "forward" if self.direction > 0 else "reverse"
        feed = "feed unknown" if self.feed is None else f"{self.feed / _MM_PER_MIN:.6g} mm/min"
        gaps = f", {self.n_invalid} not measured" if self.n_invalid else ""
        ends = _format_travel(float(self.x[0]), float(self.x[-1]), self.metadata)
        return shortened(
            f"Run({self.run_id!r}: {self.x.size} samples, {ends}, {way}, {feed}{gaps})"
        )


def _format_travel(
    low: float, high: float, metadata: Mapping[str, Any], *, between: str = " ... "
) -> str:
    """Return two positions in m as text, or in rad where the metadata of their run say so."""
    if metadata.get("unit") != "rad":
        return format_ends(low, high, between=between)
    return f"{math.degrees(low):.6g}{between}{math.degrees(high):.6g} deg"


def _check_time(t: FloatArray, run_id: str) -> None:
    if not np.isfinite(t).all():
        bad = np.flatnonzero(~np.isfinite(t))
        raise InvalidSamplesError(
            f"run {run_id!r}: no time for {bad.size} of {t.size} samples, the first is sample {bad[0]}; "
            "leave these rows out (a row that is not there is a gap), or give the sampling rate instead"
        )
    if t[-1] < t[0]:
        raise InvalidSamplesError(
            f"run {run_id!r}: time does not increase, it runs back from {t[0]:.10g} to {t[-1]:.10g} s; "
            "check the order of the rows and the sign of the time"
        )
    if t[-1] == t[0]:
        raise InvalidSamplesError(
            f"run {run_id!r}: time does not increase, it goes from {t[0]:.10g} to {t[-1]:.10g} s; time "
            "stamps with too few digits (32-bit seconds since 1970) are all equal: write more digits, "
            "or give the sampling rate instead"
        )
    back = np.flatnonzero(np.diff(t) < -2.0 * (t[-1] - t[0]) / (t.size - 1))
    if back.size:
        i = int(back[0])
        raise InvalidSamplesError(
            f"run {run_id!r}: time falls back from {t[i]:.10g} to {t[i + 1]:.10g} s at sample {i + 1}; "
            "split the recording there if another run begins, or give the sampling rate if the clock "
            "was set"
        )


def _check_monotonic(x: FloatArray, run_id: str) -> None:
    if np.isnan(x).any():
        raise InvalidSamplesError(
            f"run {run_id!r}: position is NaN at sample {int(np.flatnonzero(np.isnan(x))[0])}; drop "
            "samples without a position"
        )
    steps = np.diff(x)
    sign = 1.0 if x[-1] >= x[0] else -1.0
    bad = np.flatnonzero(sign * steps <= 0.0)
    if bad.size:
        i = int(bad[0])
        if (steps[bad] != 0.0).any():
            cure = "split the recording at its turning points and cut off the dwell at the ends"
        elif bad.size > 0.1 * steps.size:
            cure = (
                "the position is updated more slowly than rows are written: keep one row of each"
            )
        else:
            cure = "drop rows that were written twice and cut off the dwell at the ends"
        raise InvalidSamplesError(
            f"run {run_id!r}: the encoder is not monotonic, x[{i}] = {x[i] * 1e3:.6f} mm and "
            f"x[{i + 1}] = {x[i + 1] * 1e3:.6f} mm ({bad.size} such step(s)); {cure}"
        )


def _checked_feed(feed: float | None, run_id: str) -> float | None:
    if feed is None:
        return None
    return positive(
        feed,
        f"run {run_id!r}: feed",
        dimension="speed",
        why="the direction is that of the positions",
    )


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class RunSet(PublicObject):
    """Repeated runs over the same path; frozen.

    Parameters
    ----------
    runs : iterable of Run or Profile
        At least one. Profiles become forward runs without time.
    metadata : mapping, optional
        What the files said.
    history : tuple of Step, optional
        Where they came from.

    Raises
    ------
    TooFewSamplesError
        If there is no run.
    InvalidSamplesError
        If an element is neither a run nor a profile, or a run was not measured anywhere.

    Examples
    --------
    >>> import numpy as np
    >>> x = np.linspace(0, 10e-3, 101)
    >>> RunSet([Run(x, np.zeros(101), feed=f) for f in (0.08, 0.12)])
    RunSet(2 runs, feeds 4800, 7200 mm/min, forward, common travel 0 ... 10 mm)
    """

    runs: tuple[Run, ...]
    metadata: Mapping[str, Any] = field(default_factory=dict)
    history: tuple[Step, ...] = ()

    def __init__(
        self,
        runs: Iterable[Run | Profile],
        *,
        metadata: Mapping[str, Any] | None = None,
        history: tuple[Step, ...] = (),
    ) -> None:
        items: list[Run] = []
        if isinstance(runs, Run | Profile):
            raise InvalidSamplesError("a RunSet needs a list of runs, got one; pass RunSet([run])")
        for i, item in enumerate(runs):
            run = item
            if isinstance(item, Profile):
                item.require_metres()
                run = Run(item.x, item.z, run_id=str(i), metadata=item.metadata)
            if not isinstance(run, Run):
                raise InvalidSamplesError(
                    f"element {i} of a RunSet is a {type(item).__name__}; pass Run or Profile"
                )
            if run.n_invalid == len(run):
                raise InvalidSamplesError(
                    f"run {run.run_id or i!r} holds no valid sample; leave it out or check the sensor"
                )
            items.append(run)
        if not items:
            raise TooFewSamplesError("a RunSet needs at least one run, got none")
        object.__setattr__(self, "runs", tuple(items))
        object.__setattr__(self, "metadata", freeze_mapping(metadata))
        object.__setattr__(self, "history", tuple(history))

    def __len__(self) -> int:
        return len(self.runs)

    def __iter__(self) -> Iterator[Run]:
        return iter(self.runs)

    def __getitem__(self, index: int) -> Run:
        return self.runs[index]

    @property
    def feeds(self) -> tuple[float, ...]:
        """Distinct feedrates in m/s, rising; feeds within 2 % count as one."""
        groups = self.by_feed()
        return tuple(feed for feed, _ in groups)

    @property
    def directions(self) -> tuple[int, ...]:
        """Directions that occur, of -1 and +1."""
        return tuple(sorted({r.direction for r in self.runs}))

    @property
    def common_travel(self) -> tuple[float, float]:
        """Range of positions in m that every run covers.

        Raises
        ------
        InvalidSamplesError
            If the runs have no range in common.
        """
        low = max(float(min(r.x[0], r.x[-1])) for r in self.runs)
        high = min(float(max(r.x[0], r.x[-1])) for r in self.runs)
        if low >= high:
            raise InvalidSamplesError(
                f"the runs have no travel in common: the latest starts at {format_length(low)}, the "
                f"earliest ends at {format_length(high)}; give start and length of a travel that was measured part by "
                "part, or leave out the run that was taken elsewhere"
            )
        return low, high

    @property
    def full_travel(self) -> tuple[float, float]:
        """Range of positions in m that any run covers."""
        return (
            min(float(min(r.x[0], r.x[-1])) for r in self.runs),
            max(float(max(r.x[0], r.x[-1])) for r in self.runs),
        )

    def by_feed(self) -> list[tuple[float, tuple[Run, ...]]]:
        """Return the runs grouped by feedrate, slowest first.

        Returns
        -------
        list of (float, tuple of Run)
            Mean feed of the group in m/s and its runs. Runs without a feed are omitted.
        """
        timed = [(r.feed, r) for r in self.runs if r.feed is not None]
        return [
            (float(np.mean([timed[i][0] for i in group])), tuple(timed[i][1] for i in group))
            for group in feed_groups([feed for feed, _ in timed])
        ]

    def select(self, *, direction: int | None = None, feed: float | None = None) -> RunSet:
        """Return the runs of one direction and/or one feedrate.

        Parameters
        ----------
        direction : {1, -1}, optional
            Forward or reverse.
        feed : float, m/s, optional
            Feedrate; runs within 2 % of it are kept.

        Returns
        -------
        RunSet
            The kept runs.

        Raises
        ------
        TooFewSamplesError
            If none is left.
        DataError
            If `feed` is not positive.
        """
        if feed is not None:
            feed = positive(feed, "feed", dimension="speed")
        kept: Sequence[Run] = [
            r
            for r in self.runs
            if (direction is None or r.direction == direction)
            and (feed is None or (r.feed is not None and abs(r.feed / feed - 1.0) <= SAME_FEED))
        ]
        if not kept:
            have = ", ".join(f"{f / _MM_PER_MIN:.6g}" for f in self.feeds)
            raise TooFewSamplesError(
                f"no run with direction={direction} and feed="
                f"{'any' if feed is None else f'{feed / _MM_PER_MIN:.6g} mm/min'}; the set has "
                f"directions {self.directions} and feeds {have or 'unknown'} mm/min"
            )
        return RunSet(kept, metadata=self.metadata, history=self.history)

    def _summary(self) -> tuple[str, str]:
        feeds = ", ".join(f"{f / _MM_PER_MIN:.6g}" for f in self.feeds)
        names = {1: "forward", -1: "reverse"}
        return (
            f"feeds {feeds} mm/min" if feeds else "feeds unknown",
            " and ".join(names[d] for d in reversed(self.directions)),
        )

    def __repr__(self) -> str:
        feeds, ways = self._summary()
        plural = "run" if len(self) == 1 else "runs"
        return shortened(
            f"RunSet({len(self)} {plural}, {feeds}, {ways}, common travel "
            f"{self._travel_text(' ... ')})"
        )

    def _travel_text(self, to: str) -> str:
        """Return the common travel as text; a set without one must still be printable."""
        try:
            low, high = self.common_travel
        except InvalidSamplesError:
            return "none"
        own = self.metadata if "unit" in self.metadata else self.runs[0].metadata
        return _format_travel(low, high, own, between=to)

    def _repr_html_(self) -> str:
        """Return a small table for notebooks."""
        feeds, ways = self._summary()
        return html_table(
            "RunSet",
            {
                "runs": str(len(self)),
                "feeds": feeds,
                "directions": ways,
                "common travel": self._travel_text(" … "),
                "samples": str(sum(len(r) for r in self.runs)),
                "not measured": str(sum(r.n_invalid for r in self.runs)),
                "history": " → ".join(s.name for s in self.history) or "made in memory",
            },
        )
