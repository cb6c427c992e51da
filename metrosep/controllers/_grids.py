"""Uniform grids for formats that take no other, also those that start at zero and roll over."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrosep.compensation.uniform import is_uniform
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import LimitError, TableError
from metrosep.core.units import format_length

__all__ = [
    "RollingGrid",
    "enclosing_nodes",
    "holds_zero",
    "is_whole",
    "natural_spacing",
    "rolled_values",
    "rolling_grid",
]


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
            f"{axis}: a spacing of {format_length(step)} over {format_length(max(travel, span or 0.0))} "
            f"makes more than {_MOST} entries; give a wider spacing="
        )
    if span is None:
        needed = int(np.ceil(travel / step - _NEAR))
        n = needed + max(2, int(np.ceil(0.05 * needed)))
        span = n * step
    elif spacing is not None and not is_whole(span / step):
        raise TableError(
            f"{axis}: the span {format_length(span)} is no multiple of the spacing "
            f"{format_length(step)}; entries stand at equal steps over it"
        )
    else:
        n = max(1, round(span / step))
    if span < travel - max(0.5 * count, _NEAR * step):
        raise TableError(
            f"{axis}: the span {format_length(span)} is shorter than the travel "
            f"{format_length(low)} ... {format_length(high)} (zero included): positions would roll "
            f"over inside it; give span= of at least {format_length(travel)}"
        )
    counts = round(span / count)
    if counts < n:
        raise LimitError(
            f"{axis}: {n} entries over {format_length(span)} ({counts} counts) stand closer than a "
            "count: give a wider spacing=, and check the units of count="
        )
    return RollingGrid(n, counts * count / n, low, high, counts)


def rolled_values(grid: RollingGrid, x: FloatArray, y: FloatArray, tolerance: float) -> FloatArray:
    """Return a broken line at the nodes 0 ... n - 1 of a grid, zero at zero."""
    if holds_zero(x):
        there = float(np.interp(0.0, x, y))
        if abs(there) > tolerance:
            raise TableError(
                f"the value at the zero of the motor must be 0 by definition of the format, the "
                f"table has {format_length(there)}; make the table with its reference there "
                "(CompensationTable.from_error(reference=...)), or state where the zero of the motor "
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
            f"the travel fills the span of {format_length(grid.span)}, so its ends are one place, but "
            f"the corrections there are {format_length(float(y[0]))} and "
            f"{format_length(float(y[-1]))}; give a longer span="
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
