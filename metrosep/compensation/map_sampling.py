"""How an error over two axes is looked at to make a map of it: on a grid, from a zero, with no gap.

An error is never extrapolated, and never invented where it was not measured. Rows are the second
axis and columns the first, ``values[y, x]``, as in `metrosep.core.surface.Surface`.
"""

from __future__ import annotations

import math
import operator
from dataclasses import dataclass
from functools import partial
from typing import Any, SupportsIndex

import numpy as np
from numpy.typing import ArrayLike

from metrosep.compensation.area_errors import (
    AreaFunction,
    ErrorMap,
    area_error,
    bilinear,
    format_position,
    is_rotary,
    rising,
)
from metrosep.compensation.polynomial import exact_correction
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import TableError
from metrosep.core.units import parse_quantity

__all__ = ["SampledArea", "grid_positions", "inverse_along", "sample_area"]


_MAX_ENTRIES = 100_000
"""More positions of an axis than any controller takes: the spacing was typed in the wrong unit."""

_DENSE = 8
"""Steps between two positions of a function at which the interpolation error is looked for."""

_MAX_DENSE = 250_000
"""Places at which a function is looked at for it, at most; at least the middles are."""

_SAME = 1e-9
"""Positions closer than this, relative to the span, are one (0.1 mm times 3 in binary)."""


@dataclass(frozen=True, slots=True, eq=False)
class SampledArea:
    """An error over two axes made ready for a map."""

    x: FloatArray  # shapes (n,) and (m,), m or rad: positions of columns and rows
    y: FloatArray
    values: FloatArray  # shape (m, n), m: error at the nodes, zero at the reference
    error: AreaFunction  # the same between the nodes, held constant outside of where it is known
    reference: tuple[float, float]  # of (float, float), m or rad: place of zero correction
    offset: float  # m: what was subtracted to make it zero
    # m: largest deviation of the bilinear interpolation between the nodes from the error
    interpolation_error: float
    source: ErrorMap  # the error at and between the nodes, offset included


def grid_positions(
    wanted: ArrayLike | str | int | None, error: AreaFunction, which: int, axis: str
) -> FloatArray:
    """Return the positions of a map along one axis."""
    known = (error.x, error.y)[which] if isinstance(error, ErrorMap) else None
    if wanted is not None and not isinstance(wanted, str) and np.ndim(wanted) > 0:
        positions = rising(wanted, axis)
        return positions if known is None else _inside(positions, known, axis)
    if known is None:
        raise TableError(
            f"for an error function state the positions of {axis} themselves: its range is not known"
        )
    if wanted is None:
        return known
    if isinstance(wanted, str):
        return rising(_multiples(wanted, float(known[0]), float(known[-1]), axis), axis)
    if isinstance(wanted, SupportsIndex):
        count = operator.index(wanted)
        if not 2 <= count <= _MAX_ENTRIES:
            raise TableError(f"{count} positions of {axis}: a map needs 2 to {_MAX_ENTRIES}")
        return rising(np.linspace(known[0], known[-1], count), axis)
    raise TableError(
        f"positions of {axis} are {wanted!r}; give an array in m, a spacing such as '5 mm', or a count"
    )


def sample_area(
    error: Any,
    x: ArrayLike | str | int | None,
    y: ArrayLike | str | int | None,
    *,
    axes: tuple[str, str],
    reference: tuple[float, float] | None,
) -> SampledArea:
    """Return an error at the nodes of a map with its zero, checked for coverage and gaps."""
    first, second = _pair(reference)
    function = area_error(error, x, y)
    given = (x, y)
    if isinstance(error, np.ndarray | list | tuple):
        given = (None, None)
    columns = grid_positions(given[0], function, 0, axes[0])
    rows = grid_positions(given[1], function, 1, axes[1])
    zero = (
        _zero(columns, first, axes[0]),
        _zero(rows, second, axes[1]),
    )
    dense_x, dense_y = _dense(columns, rows, function)
    looked = np.asarray(function(*np.meshgrid(dense_x, dense_y)), dtype=np.float64)
    _refuse_gaps(looked, dense_x, dense_y, axes)
    at_x, at_y = np.searchsorted(dense_x, columns), np.searchsorted(dense_y, rows)
    nodes = looked[np.ix_(at_y, at_x)]
    between = bilinear(columns, rows, nodes, dense_x, dense_y[:, None])
    offset = float(bilinear(columns, rows, nodes, *zero)[0])

    def held(px: FloatArray, py: FloatArray) -> FloatArray:
        inside_x = np.clip(px, *_limits(columns, function, 0))
        inside_y = np.clip(py, *_limits(rows, function, 1))
        return function(inside_x, inside_y) - offset

    return SampledArea(
        x=columns,
        y=rows,
        values=nodes - offset,
        error=held,
        reference=zero,
        offset=offset,
        interpolation_error=float(np.abs(looked - between).max()),
        source=ErrorMap(dense_x, dense_y, looked, tuple(getattr(error, "history", ()))),
    )


def inverse_along(error: AreaFunction, x: FloatArray, y: FloatArray, along: int) -> FloatArray:
    """Return c with ``c(p) = -e(p + c(p))`` along one axis of a map.

    Examples
    --------
    >>> import numpy as np
    >>> grid = np.array([0.0, 1.0])
    >>> inverse_along(lambda x, y: 0.25 * x + 0 * y, grid, grid, 0).round(12).tolist()
    [[0.0, -0.2], [0.0, -0.2]]
    """
    first, second = (x, y) if along == 0 else (y, x)
    lines = [exact_correction(partial(_line, error, along, float(at)), first) for at in second]
    grid = np.array(lines) + 0.0  # no -0.0
    return grid if along == 0 else grid.T.copy()


def _line(error: AreaFunction, along: int, at: float, p: FloatArray) -> FloatArray:
    """Return the error along one axis while the other stands."""
    other = np.full(p.shape, at)
    return error(p, other) if along == 0 else error(other, p)


def _limits(positions: FloatArray, error: AreaFunction, which: int) -> tuple[float, float]:
    """Return where the error is known, at least over the map: beyond it is held, not invented."""
    low, high = float(positions[0]), float(positions[-1])
    if not isinstance(error, ErrorMap):
        return low, high
    known = (error.x, error.y)[which]
    return min(low, float(known[0])), max(high, float(known[-1]))


def _dense(x: FloatArray, y: FloatArray, error: AreaFunction) -> tuple[FloatArray, FloatArray]:
    """Return positions at and between the nodes at which the interpolation error shows.

    The difference of two bilinear maps is largest at a node of one of them, so of a measured error
    its own positions suffice and the result is exact.
    """
    if isinstance(error, ErrorMap):
        return _merged(x, error.x), _merged(y, error.y)
    steps = math.isqrt(_MAX_DENSE // (x.size * y.size))
    return _divided(x, min(max(steps, 2), _DENSE)), _divided(y, min(max(steps, 2), _DENSE))


def _merged(positions: FloatArray, known: FloatArray) -> FloatArray:
    inside = known[(known > positions[0]) & (known < positions[-1])]
    return np.asarray(np.union1d(positions, inside), dtype=np.float64)


def _divided(positions: FloatArray, steps: int) -> FloatArray:
    fraction = np.arange(steps) / steps
    inner = positions[:-1, None] + np.diff(positions)[:, None] * fraction
    return np.append(inner.ravel(), positions[-1])


def _refuse_gaps(values: FloatArray, x: FloatArray, y: FloatArray, axes: tuple[str, str]) -> None:
    bad = np.argwhere(~np.isfinite(values))
    if bad.size:
        row, column_ = (int(i) for i in bad[0])
        raise TableError(
            f"the error is not known at {format_position(axes[0], float(x[column_]))}, "
            f"{format_position(axes[1], float(y[row]))} ({len(bad)} of {values.size} places looked "
            "at): an error is not invented; narrow the map to what was measured, or measure there"
        )


def _pair(reference: Any) -> tuple[float | None, float | None]:
    if reference is None:
        return None, None
    try:
        first, second = (float(r) for r in reference)
    except (TypeError, ValueError):
        raise TableError(
            f"the reference is a position of each axis, such as (0.0, 0.0); got {reference!r}"
        ) from None
    return first, second


def _zero(positions: FloatArray, wanted: float | None, axis: str) -> float:
    low, high = float(positions[0]), float(positions[-1])
    if wanted is None:
        wanted = 0.0 if low <= 0.0 <= high else low
    if not math.isfinite(wanted):
        raise TableError(f"the reference of {axis} is {wanted}; give a position")
    nearest = float(positions[np.argmin(np.abs(positions - wanted))])
    if abs(nearest - wanted) <= _SAME * (high - low):
        return nearest
    if not low <= wanted <= high:
        raise TableError(
            f"the reference {format_position(axis, wanted)} lies outside the map "
            f"{format_position(axis, low)} ... {format_position(axis, high)}"
        )
    return float(wanted)


def _inside(positions: FloatArray, known: FloatArray, axis: str) -> FloatArray:
    low, high = float(known[0]), float(known[-1])
    margin = _SAME * (high - low)
    if positions[0] < low - margin or positions[-1] > high + margin:
        raise TableError(
            f"the positions {format_position(axis, float(positions[0]))} ... "
            f"{format_position(axis, float(positions[-1]))} leave the measured range "
            f"{format_position(axis, low)} ... {format_position(axis, high)}: an error is not "
            "extrapolated; narrow the positions or measure further"
        )
    return positions


def _multiples(text: str, low: float, high: float, axis: str) -> FloatArray:
    kind = "angle" if is_rotary(axis) else "length"
    spacing = parse_quantity(text, dimension=kind, name=f"spacing of {axis}")
    if not 0.0 < spacing <= high - low:
        raise TableError(
            f"spacing {text!r} of {axis} must be positive and at most the measured range "
            f"{format_position(axis, low)} ... {format_position(axis, high)}"
        )
    first, last = math.ceil(low / spacing - _SAME), math.floor(high / spacing + _SAME)
    if last - first > _MAX_ENTRIES:
        raise TableError(
            f"spacing {text!r} gives {last - first + 1} positions of {axis}; at most {_MAX_ENTRIES} "
            "make sense: check the unit"
        )
    if last - first < 1:
        raise TableError(
            f"no two multiples of {text!r} lie in the range of {axis}; use a finer one"
        )
    return np.clip(np.arange(first, last + 1) * spacing, low, high)
