"""Positions of a file: uniform grids, grids that roll over, and sections."""

from __future__ import annotations

import math
import re
from abc import abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.compensation.area_errors import format_along, format_amount, format_span, is_rotary
from metrosep.compensation.limits import Limits
from metrosep.compensation.maps import CompensationMap
from metrosep.compensation.rounding import Rounded, round_increments
from metrosep.compensation.sampling import rounded_spacing
from metrosep.compensation.table import CompensationTable
from metrosep.compensation.uniform import is_uniform, resample_uniform, resampling_error
from metrosep.controllers.base import Dialect, Simulator, sidecar_options, table_lookup
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import Example, LimitError, TableError
from metrosep.core.units import format_length

_WHOLE = 1e-6
"""Distance from a whole number of steps that rounding of decimals explains."""

_NEAR = 1e-6
"""Share of a step within which a position is a node."""

_AT_ZERO = 1e-3
"""Share of a step within which a table that ends beside the zero of a motor ends there."""

_FINEST = 2000
"""Intervals of the finest grid that is chosen without asking."""

_MOST = 100_000
"""Intervals of any grid, about: more come from a wrong unit."""


def is_whole(value: float) -> bool:
    """Return whether a number of steps is whole, but for the rounding of decimals.

    Examples
    --------
    >>> is_whole(3e-3 / 1e-3), is_whole(2.5)
    (True, False)
    """
    return abs(value - round(value)) <= _WHOLE


def holds_zero(x: FloatArray) -> bool:
    """Return whether knots enclose zero, or end so close to it that no line leads there.

    Examples
    --------
    >>> holds_zero(np.array([1e-10, 1e-3])), holds_zero(np.array([1e-4, 1e-3]))
    (True, False)
    """
    near = _AT_ZERO * float(np.diff(x).min())
    return bool(x[0] <= near and x[-1] >= -near)


def natural_spacing(positions: FloatArray, finest: int = _FINEST) -> float:
    """Return the widest spacing of a grid through zero that holds every position, if there is one.

    Examples
    --------
    >>> natural_spacing(np.array([-2.0, 0.0, 2.0])), natural_spacing(np.array([1.0, 3.0, 5.0]))
    (2.0, 1.0)
    """
    smallest = float(np.diff(positions).min())
    if is_uniform(positions):
        smallest = float(positions[-1] - positions[0]) / (positions.size - 1)
    for parts in range(1, 11):
        if all(is_whole(parts * p / smallest) for p in positions.tolist()):
            return smallest / parts
    travel = max(float(positions[-1]), 0.0) - min(float(positions[0]), 0.0)
    return max(smallest / 4.0, travel / finest)


@dataclass(frozen=True, slots=True)
class RollingGrid:
    """A grid of n intervals from zero to a span, beyond which positions roll over."""

    n: int  # intervals; node n is node 0
    step: float  # m: their length
    low: float  # m: range of positions that is used, zero included; negative ones stand at the top
    high: float
    counts: int  # the span in counts of the axis

    @property
    def span(self) -> float:
        """Length after which positions roll over, m."""
        return self.n * self.step

    @property
    def positions(self) -> FloatArray:
        """Where the nodes 0 ... n - 1 stand: those at the top at their negative positions."""
        at = np.arange(self.n) * self.step
        return np.where(at >= self.span + self.low - _NEAR * self.step, at - self.span, at)


def enclosing_nodes(step: float, first: float, last: float) -> NDArray[np.int64]:
    """Return the numbers of the nodes, multiples of a step, that enclose a range.

    Examples
    --------
    >>> enclosing_nodes(0.5, -0.6, 1.0).tolist()
    [-2, -1, 0, 1, 2]
    """
    start = int(np.floor(first / step + _NEAR))
    stop = int(np.ceil(last / step - _NEAR))
    return np.arange(start, max(stop, start + 1) + 1)


def rolling_grid(
    positions: FloatArray,
    *,
    span: float | None,
    spacing: float | None,
    count: float,
    axis: str,
    finest: int = _FINEST,
) -> RollingGrid:
    """Return the grid of a table that starts at zero and rolls over."""
    low, high = min(float(positions[0]), 0.0), max(float(positions[-1]), 0.0)
    travel = high - low
    step = natural_spacing(positions, finest) if spacing is None else spacing
    if max(travel, span or 0.0) / step > _MOST:
        raise LimitError(
            f"{axis}: a spacing of {format_along(axis, step)} over {format_along(axis, max(travel, span or 0.0))} "
            f"makes more than {_MOST} entries; give a wider spacing="
        )
    if span is None:
        needed = int(np.ceil(travel / step - _NEAR))
        n = needed + max(2, int(np.ceil(0.05 * needed)))
        span = n * step
    elif spacing is not None and not is_whole(span / step):
        raise TableError(
            f"{axis}: the span {format_along(axis, span)} is not a multiple of the spacing "
            f"{format_along(axis, step)}; entries have equal steps over it: choose a spacing that divides the span"
        )
    else:
        n = max(1, round(span / step))
    if span < travel - max(0.5 * count, _NEAR * step):
        raise TableError(
            f"{axis}: the span {format_along(axis, span)} is shorter than the travel "
            f"{format_along(axis, low)} ... {format_along(axis, high)} (zero included): positions would roll "
            f"over inside it; give span= of at least {format_along(axis, travel)}"
        )
    counts = round(span / count)
    if counts < n:
        raise LimitError(
            f"{axis}: {n} entries over {format_along(axis, span)} ({counts} counts) stand closer than a "
            "count: give a wider spacing=, and check the units of count="
        )
    return RollingGrid(n, counts * count / n, low, high, counts)


def rolled_values(
    grid: RollingGrid,
    x: FloatArray,
    y: FloatArray,
    tolerance: float,
    axes: tuple[str, str],
) -> FloatArray:
    """Return a broken line at the nodes 0 ... n - 1 of a grid, zero at zero."""
    axis, corrected = axes
    if holds_zero(x):
        there = float(np.interp(0.0, x, y))
        if abs(there) > tolerance:
            raise TableError(
                f"the value at the zero of the motor must be 0 by definition of the format, the "
                f"table has {format_amount(corrected, there)}; make the table with its reference there "
                "(reference=), or state where the zero of the motor "
                "lies (motor_zero=)"
            )
    elif x[0] > 0.0:
        x, y = np.append(0.0, x), np.append(0.0, y)
    else:
        x, y = np.append(x, 0.0), np.append(y, 0.0)
    end = x[0] + grid.span
    if end > x[-1] + _NEAR * grid.step:
        x, y = np.append(x, end), np.append(y, y[0])
    elif abs(float(y[-1] - y[0])) > tolerance:
        raise TableError(
            f"the travel fills the span of {format_along(axis, grid.span)}, so its ends are one place, but "
            f"the corrections there are {format_amount(corrected, float(y[0]))} and "
            f"{format_amount(corrected, float(y[-1]))}; give a longer span="
        )
    values = np.interp(grid.positions, x, y)
    values[0] = 0.0
    return np.asarray(values)


def rolled_weights(grid: RollingGrid, x: FloatArray) -> FloatArray:
    """Return the matrix that takes values at knots to the nodes 0 ... n - 1 of a grid."""
    knots = np.append(x, x[0] + grid.span)
    at = x[0] + np.mod(grid.positions - x[0], grid.span)
    at = np.where(knots[-1] - at <= _NEAR * grid.step, x[0], at)
    weights = np.zeros((grid.n, x.size + 1))
    right = np.clip(np.searchsorted(knots, at, side="right"), 1, x.size)
    width = np.maximum(knots[right] - knots[right - 1], np.spacing(grid.span))
    share = np.clip((at - knots[right - 1]) / width, 0.0, 1.0)
    rows = np.arange(grid.n)
    weights[rows, right - 1] = 1.0 - share
    weights[rows, right] += share
    weights[:, 0] += weights[:, -1]
    return weights[:, :-1]


# ---- even positions for formats that hold a first position and a step, and a map's sidecar -----

_EVEN_WHOLE = 1e-9
"""A span is a whole number of spacings, but for rounding."""

_MAX_POINTS = 1_000_000
"""Not a limit of a controller: beyond it a spacing has the wrong unit."""


def even_positions(
    positions: FloatArray, spacing: float | None, name: str, axis: str
) -> FloatArray:
    """Return the positions themselves, or even ones from first to last."""
    if spacing is None:
        if is_uniform(positions):
            return positions
        steps = np.diff(positions)
        raise TableError(
            f"the file needs uniform positions of {axis}, these lie "
            f"{format_span(axis, float(steps.min()), digits=9)} to "
            f"{format_span(axis, float(steps.max()), digits=9)} apart ({_between(axis, steps)} between "
            f"them); give {name}='...' to resample them"
        )
    span = float(positions[-1] - positions[0])
    if not span / spacing < _MAX_POINTS:
        raise LimitError(f"{name} gives {span / spacing:.3g} positions of {axis}; check its unit")
    count = max(math.ceil(span / spacing - _EVEN_WHOLE), 1)
    return np.linspace(positions[0], positions[-1], count + 1)


def _between(axis: str, steps: FloatArray) -> str:
    difference = float(np.ptp(steps))
    if is_rotary(axis):
        return format_span(axis, difference, digits=3)
    return format_length(difference, digits=3)


def even_table(
    table: CompensationTable, spacing: float | None, name: str = "spacing"
) -> tuple[CompensationTable, float]:
    """Return a table at even positions, and how far that takes it off."""
    p = even_positions(table.positions, spacing, name, table.axis)
    step = float(p[-1] - p[0]) / (p.size - 1)
    carried = resample_uniform(table, start=float(p[0]), step=step, n=p.size)
    return carried, resampling_error(table, carried)


def even_map(
    table: CompensationMap, spacings: Mapping[str, float | None], names: tuple[str, str]
) -> tuple[CompensationMap, float]:
    """Return a map at even positions, and how far that takes it off."""
    x, y = (
        even_positions(p, spacings[name], name, axis)
        for p, name, axis in zip((table.x, table.y), names, table.axes, strict=True)
    )
    return (table, 0.0) if x is table.x and y is table.y else map_at(table, x, y)


def map_at(table: CompensationMap, x: FloatArray, y: FloatArray) -> tuple[CompensationMap, float]:
    """Return a map at other positions, and its largest error: bilinear maps differ most at a node."""
    made = replace(table, x=x, y=y, values=table.correction(x, y[:, None]), u=None)
    px, py = np.union1d(x, table.x), np.union1d(y, table.y)[:, None]
    return made, float(np.abs(made.correction(px, py) - table.correction(px, py)).max())


# ---- tables that are resampled by the dialect itself ---------------------------------------------
# Unlike `metrosep.compensation.uniform.resample_uniform`, `carry` does not shift the entries: what a
# file holds is the table at other positions, and every deviation is reported.

DRY_RUN = "sign not documented: dry-run on the machine first"

_UNIFORM = 1e-9
"""Deviation from a grid over its spacing within which a position lies on it."""

_SAME = 1e-12
"""A picometre: interpolation between two entries leaves 1e-23 m of a zero."""


class Resampling(Dialect):
    """A dialect that resamples by itself: its points are counted in the file, not in the table."""

    def limits(self, **machine: Any) -> Limits:
        """Return the limits of the machine; the entries are counted by `encode`."""
        return super().limits(**{"max_points": None, **machine})


def folded(lookup: Simulator, low: float, high: float) -> Simulator:
    """Return a lookup that repeats after its range."""

    def along(position: ArrayLike, direction: ArrayLike = 1) -> FloatArray:
        p = np.asarray(position, dtype=np.float64)
        return lookup(low + np.mod(p - low, high - low), direction)

    return along


class Repeating(Dialect):
    """A dialect whose tables may repeat after their range: `_read` returns table and whether it does."""

    @abstractmethod
    def _read(
        self, data: bytes, path: Path, options: dict[str, Any]
    ) -> tuple[CompensationTable, bool]: ...

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationTable:
        """Return the table of a file, or the two of both directions as one."""
        return self._read(data, path, options)[0]

    def lookup(self, data: bytes, path: Path, **options: Any) -> Simulator:
        """Return what the control makes of the file: linear, end values hold, or it repeats."""
        table, repeats = self._read(data, path, options)
        simulator = table_lookup(table)
        return folded(simulator, *table.span) if repeats else simulator


@dataclass(frozen=True, slots=True)
class Carried:
    """A table or map at the positions of a file."""

    table: Any  # or CompensationMap: at these positions, not rounded
    error: float  # m: largest deviation from the table it was made of, in both directions


def carry(table: CompensationTable, positions: FloatArray) -> Carried:
    """Return a table at other positions."""
    margin = _UNIFORM * float(np.diff(positions).min())
    same = positions.size == table.positions.size
    if same and float(np.abs(positions - table.positions).max()) <= margin:
        return Carried(table, 0.0)
    made = replace(
        table,
        positions=positions,
        forward=table.correction(positions, 1),
        reverse=None if table.reverse is None else table.correction(positions, -1),
        u=None if table.u is None else np.interp(positions, table.positions, table.u),
    )
    everywhere = np.union1d(table.positions, positions)
    error = max(
        float(np.abs(made.correction(everywhere, d) - table.correction(everywhere, d)).max())
        for d in (1, -1)
    )
    return Carried(made, error)


def uniform_positions(
    table: CompensationTable,
    *,
    through: float | None = None,
    interval: float | None = None,
    quantum: float = 0.0,
    max_points: int,
    title: str,
) -> FloatArray:
    """Return positions of equal spacing that cover a table."""
    low, high = table.span
    span = high - low
    anchor = low if through is None else through
    own = span / (table.positions.size - 1)
    off = (anchor - low) / own
    on_grid = abs(off - round(off)) <= _UNIFORM * table.positions.size
    if interval is None and on_grid and is_uniform(table.positions):
        interval = own
    elif interval is None:
        spare = 3 if through is not None else 1
        interval = max(float(np.diff(table.positions).min()), span / max(max_points - spare, 1))
        interval = span / math.ceil(span / interval) if not quantum else interval
        interval = math.ceil(interval / quantum - 1e-6) * quantum if quantum else interval
    steps = interval / quantum if quantum else 1.0
    # a multiple but for the rounding of decimals, and of doubles where a step has many units
    if abs(steps - round(steps)) > 1e-6 + 1e-15 * steps:
        raise TableError(
            f"{title}: the spacing {format_along(table.axis, interval, digits=9)} is not a multiple of "
            f"{format_along(table.axis, quantum)}; give interval= a multiple of it"
        )
    require_interval(interval, span, title, table.axis)
    below = math.ceil((anchor - low) / interval - 1e-6)
    above = math.ceil((high - anchor) / interval - 1e-6)
    below, above = max(below, 0), max(above, 0)
    if below + above + 1 > max_points:
        least = span / max(max_points - 3, 1)
        raise LimitError(
            f"{below + above + 1} points at {format_along(table.axis, interval, digits=6)}, {title} takes "
            f"{max_points}; give interval= at least "
            f"{format_span(table.axis, least)}"
        ).hinting(interval=rounded_spacing(least, table.axis, up=True))
    positions = anchor + interval * np.arange(-below, above + 1, dtype=np.float64)
    return np.where(np.abs(positions) < _UNIFORM * interval, 0.0, positions)  # 0 and not 3e-17


def require_interval(interval: float, span: float, title: str, axis: str) -> None:
    """Refuse a spacing that is larger than the table."""
    if interval > span * (1.0 + 1e-9):
        raise LimitError(
            f"{title}: interval={format_along(axis, interval, digits=9)} is larger than the table, which "
            f"spans {format_along(axis, span, digits=9)}; check the units of interval="
        )


def require_sizes(
    table: CompensationTable, title: str, *, farthest: float = 1e3, largest: float = 1.0
) -> None:
    """Refuse positions and corrections, in m or rad, beyond which units are mistaken or no number holds them."""
    p = table.positions
    columns = [table.forward] if table.reverse is None else [table.forward, table.reverse]
    for what, values, most, axis in (
        ("position", p, farthest, table.axis),
        *(("correction", c, largest, table.compensates) for c in columns),
    ):
        worst = int(np.abs(values).argmax())
        if abs(float(values[worst])) > most:
            raise LimitError(
                f"{title}: the {what} {format_along(axis, float(values[worst]))} of entry {worst} "
                f"exceeds {format_along(axis, most)}; check the units of the table"
            )


def require_one_direction(table: CompensationTable, title: str, way: str) -> CompensationTable:
    """Return a table with one column, and refuse one whose directions differ."""
    if table.reverse is None:
        return table
    if not np.array_equal(table.reverse, table.forward):
        raise (
            TableError(
                f"{title} holds one value for both directions and this table has two; make it with "
                f"direction='both' and enter the lost motion {way}"
            )
            .hinting(direction="both")
            .hinting(bidirectional=Example("True"))
        )
    return replace(table, reverse=None)


def require_on_axis(table: CompensationTable, title: str, instead: str) -> None:
    """Refuse a table that corrects another axis than it looks up."""
    if not table.is_on_axis:
        raise TableError(
            f"{title} shifts the axis whose position it looks up; this table is {table.axis} -> "
            f"{table.compensates} and would move {table.axis} instead of {table.compensates}; write "
            f"controller={instead}"
        )


@dataclass(frozen=True, slots=True)
class Sections:
    """Increments of a correction over equal sections, as controls walk them from a reference."""

    carried: Carried
    rounded: Rounded
    zero: float  # m: position of the reference
    interval: float  # m
    number: int  # of the reference point; first and last ones of the sections
    first: int
    last: int


def sections(
    table: CompensationTable,
    options: Mapping[str, Any],
    *,
    title: str,
    unit: float,
    most: int,
    numbers: tuple[int, int],
    limits: tuple[int, int],
    larger: str,
) -> Sections:
    """Return the increments of a table in units, refused where points or increments leave their range."""
    zero = options["reference_position"]
    zero = table.reference if zero is None else zero
    there = float(table.correction(zero, 1)[0])
    if abs(there) > _SAME:
        raise TableError(
            f"{title} counts from the reference position {format_along(table.axis, zero, digits=9)}, where the "
            f"correction must be exactly 0 and is {format_amount(table.axis, there)}; make the "
            f"table with reference='{format_along(table.axis, zero, digits=9)}', as an entry of it"
        )
    positions = uniform_positions(
        table,
        through=zero,
        interval=options["interval"],
        quantum=options["increment"],
        max_points=most,
        title=title,
    )
    carried = carry(table, positions)
    rounded = round_increments(carried.table.forward, unit, limits=None)
    require_increments(rounded.entries, positions, limits, unit, table.axis, larger)
    below = int(np.abs(positions - zero).argmin())
    number = options["reference_number"]
    number = max(numbers[0] + below - 1, numbers[0]) if number is None else number
    first, last = number + 1 - below, number + positions.size - 1 - below
    if first < numbers[0] or last > numbers[1]:
        raise LimitError(
            f"points {first} to {last} leave {numbers[0]} to {numbers[1]}; choose another "
            "reference_number"
        )
    interval = float(positions[-1] - positions[0]) / (positions.size - 1)
    return Sections(carried, rounded, zero, interval, number, first, last)


def require_increments(
    entries: NDArray[np.int64],
    positions: FloatArray,
    limits: tuple[int, int],
    unit: float,
    axis: str,
    larger: str,
) -> None:
    """Refuse an increment out of range, with its section."""
    bad = np.flatnonzero((entries < limits[0]) | (entries > limits[1]))
    if bad.size:
        i = int(bad[0])
        low, high = (format_span(axis, float(p), digits=9) for p in positions[i : i + 2])
        raise LimitError(
            f"the increment {int(entries[i])} between {low.split()[0]} and {high} leaves {limits[0]} ... "
            f"{limits[1]} units of {format_amount(axis, unit)}; use a smaller interval or a larger "
            f"{larger}"
        )


def walked(
    entries: NDArray[np.int64], below: int, zero: float, interval: float, unit: float
) -> tuple[FloatArray, FloatArray]:
    """Return positions and corrections of increments, `below` of which lie below the reference."""
    curve = np.concatenate([[0], np.cumsum(entries)])
    positions = zero + interval * np.arange(-below, curve.size - below)
    return np.asarray(positions), np.asarray((curve - curve[below]) * unit + 0.0)


def require_capacity(dialect: Dialect, n: int, given: Mapping[str, Any], path: Path) -> None:
    """Refuse a file of more points than the control takes."""
    option = next(o for o in dialect.options if o.name == "capacity")
    stored = sidecar_options(path, (option,))
    capacity = given.get("capacity") or stored.get("capacity") or option.default
    if n > capacity:
        raise LimitError(
            f"{path}: {n} points, the control takes {capacity} as it comes; if yours has room for "
            f"more ({option.help}), say capacity="
        )


def require_linear(axes: Iterable[str], title: str) -> None:
    """Refuse axes that turn."""
    for axis in axes:
        if is_rotary(axis):
            raise TableError(
                f"{title}: axis {axis} turns, this dialect writes lengths only; write "
                "controller='csv' and enter it by hand, in the unit of that axis"
            )


def require_names(table: CompensationTable, control: str) -> None:
    """Refuse names of axes that a control does not have: a capital and perhaps a digit."""
    for name in (table.axis, table.compensates):
        if not re.fullmatch(r"[A-Z]\d?", name, re.ASCII):
            raise TableError(
                f"axis {name!r} is not a {control} axis: a capital and perhaps a digit"
            )
