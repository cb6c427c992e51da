"""`ProfileView`: a long profile for the screen, with the extremes of each pixel column.

A line through every hundredth sample hides the spike that scraps the part. So each pixel column
shows its least and greatest sample, all of them counted; `Extremes` keeps those of blocks of
samples, so that any window of ten million samples costs a millisecond or two.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrosep.app.view_limits import checked_columns, checked_window
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.core.profile import Profile
from metrosep.core.runset import Run, RunSet

__all__ = ["Extremes", "ProfileView", "find_holes", "profile_view", "repeat_views"]

IndexArray = NDArray[np.intp]
Level = tuple[FloatArray, FloatArray, NDArray[np.int32]]

_BLOCK = 16
"""Samples of a block, and blocks of a block of the next level."""

_HOLE = 8.0
"""A step this many times longer than both of its neighbours is a hole in the record."""


@dataclass(frozen=True, slots=True, eq=False, init=False)
class Extremes:
    """A profile with the extremes of its blocks of 16, 256, 4096 ... samples.

    Notes
    -----
    Memory beyond the profile: 1.4 bytes for each sample.

    Examples
    --------
    >>> import numpy as np
    >>> Extremes(Profile(np.arange(40.0), np.arange(40.0) % 7)).high[0].tolist()
    [6.0, 6.0, 6.0]
    """

    x: FloatArray  # shape (n,), m: of the profile, positions rising
    z: FloatArray
    # of ndarray: least and greatest valid height (NaN where none) and number of valid samples of
    # the blocks of each level
    low: tuple[FloatArray, ...]
    high: tuple[FloatArray, ...]
    count: tuple[NDArray[np.int32], ...]
    # index of the sample before each hole: a step more than eight times as long as both steps
    # beside it. There samples are missing, though none says NaN
    holes: IndexArray
    name: str  # of a run: its name and its feedrate in m/s
    feed: float | None

    def __init__(self, profile: Profile | Run) -> None:
        if not isinstance(profile, Profile | Run):
            raise DataError(f"a profile view is made of a Profile, got {type(profile).__name__}")
        turned = -1 if profile.x[-1] < profile.x[0] else 1
        x, z = profile.x[::turned], profile.z[::turned]
        levels = _levels(z)
        name, feed = (profile.run_id, profile.feed) if isinstance(profile, Run) else ("", None)
        values = (x, z, *zip(*levels, strict=True)) if levels else (x, z, (), (), ())
        for field, value in zip(self.__slots__, (*values, find_holes(x), name, feed), strict=True):
            object.__setattr__(self, field, value)

    def of(self, start: IndexArray, stop: IndexArray) -> tuple[FloatArray, FloatArray, IndexArray]:
        """Return the extremes of any ranges of samples."""
        low = np.full(start.size, np.nan)
        high, count = low.copy(), np.zeros(start.size, dtype=np.intp)
        sources = [(self.z, self.z, None), *zip(self.low, self.high, self.count, strict=True)]
        for k, (lows, highs, counts) in enumerate(sources):
            inner = -(-start // _BLOCK), stop // _BLOCK
            whole = (inner[0] < inner[1]) & (k + 1 < len(sources))
            head = np.where(whole, inner[0] * _BLOCK, stop)
            for first, last in ((start, head), (np.where(whole, inner[1] * _BLOCK, stop), stop)):
                a, b, n = _gathered(lows, highs, counts, first, last)
                low, high, count = np.fmin(low, a), np.fmax(high, b), count + n
            start, stop = (np.where(whole, v, 0) for v in inner)
            if not whole.any():
                break
        return low, high, count


def _levels(z: FloatArray) -> list[Level]:
    levels: list[Level] = []
    low, high, count = z, z, (~np.isnan(z)).astype(np.int32)
    while low.size > _BLOCK:
        first = np.arange(0, low.size, _BLOCK)
        low, high = np.fmin.reduceat(low, first), np.fmax.reduceat(high, first)
        count = np.add.reduceat(count, first, dtype=np.int32)
        for array in (low, high, count):
            array.setflags(write=False)
        levels.append((low, high, count))
    return levels


def _gathered(
    lows: FloatArray,
    highs: FloatArray,
    counts: NDArray[np.int32] | None,
    first: IndexArray,
    last: IndexArray,
) -> tuple[FloatArray, FloatArray, IndexArray]:
    """Return the extremes of short ranges, some of them empty."""
    width = max(1, int((last - first).max()))
    i = first[:, np.newaxis] + np.arange(width)
    outside = i >= last[:, np.newaxis]
    i = np.where(outside, 0, i)
    low, high = np.where(outside, np.nan, lows[i]), np.where(outside, np.nan, highs[i])
    n = ~np.isnan(low) if counts is None else np.where(outside, 0, counts[i])
    return np.fmin.reduce(low, axis=1), np.fmax.reduce(high, axis=1), n.sum(axis=1)


def find_holes(x: FloatArray) -> IndexArray:
    """Return where samples are missing from a record, though none says NaN.

    Examples
    --------
    >>> import numpy as np
    >>> find_holes(np.array([0.0, 1.0, 2.0, 20.0, 21.0])).tolist()
    [2]
    """
    step = np.diff(x)
    if step.size < 3:
        return np.zeros(0, dtype=np.intp)
    longer = (step[1:-1] > _HOLE * step[:-2]) & (step[1:-1] > _HOLE * step[2:])
    return np.asarray(np.flatnonzero(longer) + 1)


@dataclass(frozen=True, slots=True, eq=False)
class ProfileView:
    """A profile as the screen shows it."""

    # shape (n,), m: middle of the samples of each pixel column that holds any, and the middle of
    # each hole
    x: FloatArray
    # shape (n,), m: least and greatest valid sample of the column; NaN where there is none: a gap
    low: FloatArray
    high: FloatArray
    # shape (n,), dimensionless: valid share of the samples of the column; 0 in a hole
    coverage: FloatArray
    n_samples: int  # samples in the window
    name: str = ""  # run or series
    feed: float | None = None  # m/s: feedrate of a run

    @property
    def is_reduced(self) -> bool:
        """Whether a column holds more than one sample."""
        return self.n_samples > self.x.size


def profile_view(
    profile: Extremes | Profile | Run,
    *,
    window: Sequence[float] | None = None,
    columns: int = 1000,
    name: str = "",
) -> ProfileView:
    """Return a window of a profile for the screen.

    Notes
    -----
    Columns are equally wide in x, also where positions are not uniform. Gaps stay: a column
    without a valid sample is NaN, and so is a point put into each hole that parts two columns.
    A gap narrower than a column shows in `coverage`.

    Examples
    --------
    >>> import numpy as np
    >>> z = np.zeros(1000)
    >>> z[123] = 5.0
    >>> view = profile_view(Profile(np.arange(1000.0), z), columns=10)
    >>> view.high.tolist()
    [0.0, 5.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    """
    found = profile if isinstance(profile, Extremes) else Extremes(profile)
    wide = checked_columns(columns)
    x0, x1 = checked_window(window, (float(found.x[0]), float(found.x[-1])))
    first = int(np.searchsorted(found.x, x0, side="left"))
    last = int(np.searchsorted(found.x, x1, side="right"))
    n = last - first
    if n <= wide:
        start = np.arange(max(first - 1, 0), min(last + 1, found.x.size))
        stop = start + 1
    else:
        inner = np.searchsorted(found.x, np.linspace(x0, x1, wide + 1)[1:-1], side="left")
        edges = np.unique(np.concatenate([[first], np.clip(inner, first, last), [last]]))
        start, stop = edges[:-1], edges[1:]
    return _view(found, start, stop, n, name or found.name)


def _view(
    found: Extremes, start: IndexArray, stop: IndexArray, n_samples: int, name: str
) -> ProfileView:
    if start.size == 0:
        nothing = np.zeros(0)
        return ProfileView(nothing, nothing, nothing, nothing, n_samples, name, found.feed)
    low, high, count = found.of(start, stop)
    x = (found.x[start] + found.x[stop - 1]) / 2.0
    coverage = count / (stop - start)
    holes = found.holes[np.isin(found.holes + 1, start[1:])]
    if holes.size:
        at = np.searchsorted(start, holes + 1)
        x = np.insert(x, at, (found.x[holes] + found.x[holes + 1]) / 2.0)
        low, high = np.insert(low, at, np.nan), np.insert(high, at, np.nan)
        coverage = np.insert(coverage, at, 0.0)
    for array in (x, low, high, coverage):
        array.setflags(write=False)
    return ProfileView(x, low, high, coverage, n_samples, name, found.feed)


def repeat_views(
    runs: RunSet | Iterable[Extremes | Profile | Run],
    *,
    window: Sequence[float] | None = None,
    columns: int = 1000,
) -> tuple[ProfileView, ...]:
    """Return one view for each run, for lines over one another.

    Examples
    --------
    >>> import numpy as np
    >>> x = np.linspace(0.0, 10e-3, 101)
    >>> run = Run(x[::-1], np.arange(101.0), feed=0.01, run_id="back")
    >>> [(v.name, v.feed, v.high[0].item()) for v in repeat_views([run])]
    [('back', 0.01, 100.0)]
    """
    given = list(runs)
    if not given:
        raise DataError("there is no run to look at")
    found = [r if isinstance(r, Extremes) else Extremes(r) for r in given]
    if window is None:
        ends = min(float(e.x[0]) for e in found), max(float(e.x[-1]) for e in found)
        window = ends if ends[0] < ends[1] else None
    return tuple(profile_view(e, window=window, columns=columns) for e in found)
