"""What the page shows of a measurement, in the table ``[view]`` of its recipe: runs ignore it."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.core.profile import Profile
from metrosep.core.readable import said_value
from metrosep.core.runset import Run, RunSet
from metrosep.core.sections import Reading, height_at, is_calibrated, read_line
from metrosep.core.surface import Surface

VIEW_KEYS = (
    "tab",
    "colours",
    "hill_shade",
    "section_mm",
    "section_px",
    "band_mm",
    "band_px",
    "lower",
)
"""Tab, colours of the map, hill-shade, ends of the section, limits of the band of wavelengths, lower picture."""

_FARTHEST = 1e9
"""No machine is larger, mm; pixels neither."""


def checked_view(given: Any) -> dict[str, Any]:
    """Return what the page wants to be remembered, or refuse it."""
    if not isinstance(given, Mapping):
        raise DataError("view is an object of what is shown")
    unknown = [k for k in given if k not in VIEW_KEYS]
    if unknown:
        raise DataError(f"there is no view key {unknown[0]!r}; there are {', '.join(VIEW_KEYS)}")
    found = {k: v for k, v in given.items() if v is not None}
    for key, value in found.items():
        if not _fits(key, value):
            raise DataError(f"view: {key} = {said_value(value)} is not what belongs there")
    return found


def shown_view(view: object) -> dict[str, Any]:
    """Return what the page can show of a table ``[view]``, which may have been written by hand.

    Examples
    --------
    >>> shown_view({"tab": "report", "section_mm": [1, 2], "band_mm": [2, -1]})
    {'tab': 'report'}
    """
    if not isinstance(view, Mapping):
        return {}
    return {k: v for k, v in view.items() if k in VIEW_KEYS and _fits(k, v)}


def _fits(key: str, value: Any) -> bool:
    if key in ("tab", "colours", "lower"):
        return isinstance(value, str) and len(value) <= 40 and value.isprintable()
    if key == "hill_shade":
        return isinstance(value, bool)
    if key in ("band_mm", "band_px"):
        return _numbers(value) and 0 < value[0] < value[1]
    two = isinstance(value, list) and len(value) == 2 and all(_numbers(end) for end in value)
    return two and value[0] != value[1]


def _numbers(value: Any) -> bool:
    return (
        isinstance(value, list)
        and len(value) == 2
        and all(
            isinstance(v, int | float) and not isinstance(v, bool) and abs(v) <= _FARTHEST
            for v in value
        )
    )


def view_of(text: str) -> dict[str, Any]:
    r"""Return the table ``[view]`` of a recipe.

    Examples
    --------
    >>> view_of("metrosep = 1\n[view]\ntab = 'report'\n")
    {'tab': 'report'}
    """
    found = tomllib.loads(text).get("view", {})
    return dict(found) if isinstance(found, Mapping) else {}


def with_view(text: str, view: Mapping[str, Any]) -> str:
    r"""Return a recipe with another table ``[view]``; all else stays as it is written.

    Examples
    --------
    >>> print(with_view("metrosep = 1  # first\n", {"tab": "table"}))
    metrosep = 1  # first
    <BLANKLINE>
    [view]
    tab = "table"
    <BLANKLINE>
    """
    import tomlkit

    if view_of(text) == dict(view):
        return text
    made = tomlkit.parse(text)
    if "view" in made:
        del made["view"]
    plain = str(tomlkit.dumps(made)).rstrip("\n") + "\n"
    if not view:
        return plain
    table = tomlkit.document()
    table.add("view", tomlkit.item(dict(view)))
    return f"{plain}\n{tomlkit.dumps(table)}"


# ---- what a picture of a line is asked for: its part, and its pixel columns --------------------

_MOST_COLUMNS = 100_000
_MOST_CURSORS = 8


def checked_window(
    window: Sequence[float] | None, whole: tuple[float, float]
) -> tuple[float, float]:
    """Return the part of a line that is looked at."""
    if window is None:
        return whole
    try:
        x0, x1 = (float(v) for v in window)
    except (TypeError, ValueError):
        x0 = x1 = math.nan
    if not (math.isfinite(x0) and math.isfinite(x1) and x0 < x1):
        raise DataError(f"window must be two positions x0 < x1 in m, got {said_value(window)}")
    return x0, x1


def checked_columns(columns: Any) -> int:
    """Return the number of pixel columns of a picture."""
    is_whole = isinstance(columns, int | np.integer) and not isinstance(columns, bool)
    if not is_whole or not 1 <= columns <= _MOST_COLUMNS:
        raise DataError(
            f"columns must be a whole number from 1 to 100 000, got {said_value(columns)}"
        )
    return int(columns)


# ---- `SectionView`: heights of a map along a straight line, at full resolution -----------------
# The section is read from the map itself, never from its means: a line costs a millisecond even on
# 4096 x 4096 pixels, so what follows the pointer is already the truth.


@dataclass(frozen=True, slots=True, eq=False)
class SectionView:
    """A section as the screen shows it, with the numbers of its full resolution."""

    distance: FloatArray  # shape (n,), m: from a, middle of the samples of each pixel column
    # shape (n,), m: least and greatest height of each column; NaN where no sample of it is valid
    low: FloatArray
    high: FloatArray
    length: float  # m: from a to b
    # m: greatest less least valid height of all samples, nothing removed; NaN if none is valid
    pv: float
    sq: float  # m: RMS of the valid samples about their mean; NaN if none is valid
    share_valid: float  # dimensionless: valid samples over all samples
    n_samples: int  # samples that were read
    method: str  # ``"lanczos"``, ``"bilinear"`` or ``"nearest"``
    unit: str  # of distance and length: ``"m"``, or ``"px"`` for a map without lateral calibration
    # by the part of the length that was asked for, m: height there, NaN in a gap
    heights: Mapping[float, float]


def section_view(
    surface: Surface,
    a: Sequence[float],
    b: Sequence[float],
    *,
    columns: int = 1000,
    method: Reading = "lanczos",
    cursors: Sequence[float] = (),
) -> SectionView:
    """Return a section for the screen, and its heights at parts of its length, whatever the columns.

    Examples
    --------
    >>> surface = Surface([[0.0, 1.0, 2.0, 9.0]] * 2, dx=1.0, dy=1.0)
    >>> view = section_view(surface, (0.0, 0.5), (3.0, 0.5), columns=2)
    >>> view.low.tolist(), view.high.tolist(), view.pv
    ([0.0, 2.0], [1.0, 9.0], 9.0)
    """
    wide: Any = columns
    if isinstance(wide, bool) or not isinstance(wide, int | np.integer) or wide < 1:
        raise DataError(f"columns must be a whole number from 1, got {said_value(columns)}")
    parts = checked_cursors(cursors)
    distance, z, length, _ = read_line(surface, a, b, method)
    n = z.size
    wide = min(n, int(wide))
    first = np.arange(wide) * n // wide
    last = np.append(first[1:], n) - 1
    valid = z[~np.isnan(z)]
    return SectionView(
        distance=_frozen((distance[first] + distance[last]) / 2.0),
        low=_frozen(np.fmin.reduceat(z, first)),
        high=_frozen(np.fmax.reduceat(z, first)),
        length=length,
        pv=float(np.ptp(valid)) if valid.size else math.nan,
        sq=float(valid.std()) if valid.size else math.nan,
        share_valid=valid.size / n,
        n_samples=n,
        method=method,
        unit="m" if is_calibrated(surface) else "px",
        heights={
            t: height_at(
                surface, [p + t * (q - p) for p, q in zip(a, b, strict=True)], method=method
            )
            for t in parts
        },
    )


def checked_cursors(cursors: Any) -> list[float]:
    """Return parts of the length of a section, 0 at a and 1 at b."""
    parts = list(cursors) if isinstance(cursors, list | tuple) else [math.nan]
    plain = all(isinstance(t, int | float) and not isinstance(t, bool) for t in parts)
    if not plain or not all(0.0 <= t <= 1.0 for t in parts) or len(parts) > _MOST_CURSORS:
        raise DataError(
            f"cursors are up to {_MOST_CURSORS} parts of the length from 0 to 1, got {cursors!r}"
        )
    return [float(t) for t in parts]


def _frozen(array: FloatArray) -> FloatArray:
    array.setflags(write=False)
    return array


# ---- `ProfileView`: a long profile for the screen, with the extremes of each pixel column ------
# A line through every hundredth sample hides the spike that scraps the part. So each pixel column
# shows its least and greatest sample, all of them counted; `Extremes` keeps those of blocks of
# samples, so that any window of ten million samples costs a millisecond or two.

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
        raise DataError("No run is open.")
    found = [r if isinstance(r, Extremes) else Extremes(r) for r in given]
    if window is None:
        ends = min(float(e.x[0]) for e in found), max(float(e.x[-1]) for e in found)
        window = ends if ends[0] < ends[1] else None
    return tuple(profile_view(e, window=window, columns=columns) for e in found)
