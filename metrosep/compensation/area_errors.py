"""Errors over two axes: measured on a rectangular grid, on a surface, or given as a function.

Rows are the second axis and columns the first, ``values[y, x]``, as in
`metrosep.core.surface.Surface`. Between nodes the error is bilinear, as controllers interpolate.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray, frozen_float
from metrosep.core.errors import DataError, TableError
from metrosep.core.provenance import Step
from metrosep.core.surface import Surface
from metrosep.core.units import format_ends, format_length

AreaFunction = Callable[[FloatArray, FloatArray], FloatArray]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ErrorMap:
    """Errors on a rectangular grid of two axes, spacing free; frozen, SI, NaN = not measured.

    Parameters
    ----------
    x : array_like, shape (n,), m or rad
        Positions of the first axis (columns), strictly rising, n >= 2.
    y : array_like, shape (m,), m or rad
        Positions of the second axis (rows), strictly rising, m >= 2.
    values : array_like, shape (m, n), m
        Error e = actual - nominal; NaN where not measured.
    history : tuple of Step, optional
        Where it came from.

    Raises
    ------
    TableError
        If positions do not rise, or the shape is not (m, n).
    InvalidSamplesError
        If a value is infinite.

    Examples
    --------
    >>> ErrorMap([0.0, 0.1], [0.0, 0.2], [[0.0, 1e-6], [2e-6, 3e-6]])([0.05], [0.1]).tolist()
    [1.5e-06]
    """

    x: FloatArray
    y: FloatArray
    values: FloatArray
    history: tuple[Step, ...] = field(default=())

    def __post_init__(self) -> None:
        for name in ("x", "y"):
            object.__setattr__(self, name, rising(getattr(self, name), name))
        values = frozen_float(self.values, name="values", ndim=2)
        if values.shape != (self.y.size, self.x.size):
            raise TableError(
                f"values have shape {values.shape}; {self.y.size} rows (y) and {self.x.size} "
                "columns (x) are needed: transpose them if rows and columns are exchanged"
            )
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "history", tuple(self.history))

    def __call__(self, x: ArrayLike, y: ArrayLike) -> FloatArray:
        """Return the error at positions, bilinear between and held outside."""
        return bilinear(self.x, self.y, self.values, x, y)

    def __repr__(self) -> str:
        gaps = int(np.isnan(self.values).sum())
        return (
            f"ErrorMap({self.y.size} rows x {self.x.size} columns, {gaps} not measured, "
            f"x {self.x[0]:.6g} ... {self.x[-1]:.6g}, y {self.y[0]:.6g} ... {self.y[-1]:.6g})"
        )


AreaSource = Surface | ErrorMap | AreaFunction


def column(values: ArrayLike, name: str) -> FloatArray:
    """Return a read-only copy of a column of a table."""
    copied = np.array(values, dtype=np.float64)
    if copied.ndim != 1:
        raise TableError(f"{name} must be one-dimensional, got shape {copied.shape}")
    if not np.isfinite(copied).all():
        i = int(np.flatnonzero(~np.isfinite(copied))[0])
        raise TableError(
            f"{name}[{i}] is {copied[i]}: a table must be finite everywhere; narrow the positions to "
            "what was measured"
        )
    copied.setflags(write=False)
    return copied


def rising(values: ArrayLike, name: str) -> FloatArray:
    """Return positions of a grid, read-only, after a check."""
    try:
        positions = column(values, name)
    except (TypeError, ValueError):
        raise TableError(
            f"positions of {name} must be real numbers in SI, got {values!r}"
        ) from None
    if positions.size < 2:
        raise TableError(f"at least 2 positions of {name} are needed, got {positions.size}")
    bad = np.flatnonzero(np.diff(positions) <= 0)
    if bad.size:
        i = int(bad[0])
        raise TableError(
            f"positions of {name} must rise strictly: entry {i} is {positions[i]:.9g}, entry {i + 1} "
            f"is {positions[i + 1]:.9g}; sort them, with their values, and remove duplicates"
        )
    return positions


def bilinear(
    x: FloatArray, y: FloatArray, values: FloatArray, at_x: ArrayLike, at_y: ArrayLike
) -> FloatArray:
    """Return values of a grid between its nodes, clamped outside, as controllers do.

    Examples
    --------
    >>> import numpy as np
    >>> bilinear(np.array([0.0, 1.0]), np.array([0.0, 2.0]), np.eye(2), 0.25, 0.5).tolist()
    [0.625]
    """
    try:
        px, py = np.broadcast_arrays(
            np.atleast_1d(np.asarray(at_x, dtype=np.float64)),
            np.atleast_1d(np.asarray(at_y, dtype=np.float64)),
        )
    except ValueError:
        raise DataError(
            f"positions of shapes {np.shape(at_x)} and {np.shape(at_y)} do not broadcast; give both "
            "the same shape, or y as a column (y[:, None]) for a grid"
        ) from None
    i, s = _cell(x, px)
    j, t = _cell(y, py)
    total = np.zeros(px.shape)
    for rows, weight_y in ((j, 1.0 - t), (j + 1, t)):
        for columns, weight_x in ((i, 1.0 - s), (i + 1, s)):
            weight = weight_x * weight_y
            total += np.where(weight == 0.0, 0.0, weight * values[rows, columns])
    return total


def _cell(nodes: FloatArray, at: FloatArray) -> tuple[NDArray[np.intp], FloatArray]:
    """Return the node below and the fraction of the cell; both ends are clamped."""
    i = np.clip(np.searchsorted(nodes, at, side="right") - 1, 0, nodes.size - 2)
    return i, np.clip((at - nodes[i]) / (nodes[i + 1] - nodes[i]), 0.0, 1.0)


def area_error(error: Any, x: Any = None, y: Any = None) -> AreaFunction:
    """Return an error over two axes as a function; a measured one is an `ErrorMap`."""
    if isinstance(error, ErrorMap):
        return error
    if isinstance(error, Surface):
        return _of_surface(error)
    if isinstance(error, np.ndarray | list | tuple):
        if not (np.ndim(x) == 1 and np.ndim(y) == 1):
            raise DataError(
                "an error as an array does not say where it was measured: give x= and y= as "
                "arrays of its columns and rows, or pass ErrorMap(x, y, values)"
            )
        return ErrorMap(np.asarray(x), np.asarray(y), np.asarray(error))
    if callable(error):
        function = error

        def at(px: FloatArray, py: FloatArray) -> FloatArray:
            values = np.asarray(function(px, py))
            if values.dtype.kind not in "fiu":
                raise DataError(
                    f"the error function returned {values.dtype}, not real numbers in m"
                )
            try:
                return np.broadcast_to(values.astype(np.float64), px.shape)
            except ValueError:
                raise DataError(
                    f"the error function returned shape {values.shape} for positions of shape "
                    f"{px.shape}; it must work on arrays of any shape"
                ) from None

        return at
    raise DataError(
        f"the error is a {type(error).__name__}; pass a Surface, an ErrorMap, a function e(x, y), or "
        "an array together with x= and y="
    )


def _of_surface(surface: Surface) -> ErrorMap:
    if surface.dx is None or surface.dy is None:
        raise DataError(
            "the surface is not calibrated laterally (dx, dy), so its heights have no axis "
            "positions; give it dx and dy in m"
        )
    rows, columns = surface.shape
    return ErrorMap(
        surface.origin[0] + surface.dx * np.arange(columns, dtype=np.float64),
        surface.origin[1] + surface.dy * np.arange(rows, dtype=np.float64),
        surface.z,
        surface.history,
    )


def is_rotary(axis: str) -> bool:
    """Return whether an axis turns, by its name after ISO 841.

    Examples
    --------
    >>> is_rotary("C"), is_rotary("X"), is_rotary("AX1")
    (True, False, False)
    """
    index = axis[1:]
    return axis[:1].upper() in ("A", "B", "C") and (not index or index.isdecimal())


def format_position(axis: str, value: float) -> str:
    """Return a position of an axis as text with its unit.

    Examples
    --------
    >>> format_position("X", 0.0125)
    'X = 12.5 mm'
    """
    if is_rotary(axis):
        return f"{axis} = {math.degrees(value):.9g} deg"
    return f"{axis} = {value * 1e3:.9g} mm"


def format_span(axis: str, value: float, *, digits: int = 4) -> str:
    """Return a distance along an axis as text with its unit.

    Examples
    --------
    >>> format_span("X", 5e-4), format_span("C", 0.03490658503988659)
    ('0.5 mm', '2 deg')
    """
    if is_rotary(axis):
        return f"{math.degrees(value):.{digits}g} deg"
    return f"{value * 1e3:.{digits}g} mm"


def format_amount(axis: str, value: float, *, digits: int = 4) -> str:
    """Return a small amount of an axis as text with its unit.

    Examples
    --------
    >>> format_amount("X", 2.5e-7), format_amount("C", 2.5e-7)
    ('250 nm', '0.25 urad')
    """
    if is_rotary(axis):
        return f"{value * 1e6:.{digits}g} urad"
    return format_length(value, digits=digits)


def format_along(axis: str, value: float, *, digits: int = 4) -> str:
    """Return a place or step along an axis as text, in degrees where it turns.

    Examples
    --------
    >>> format_along("X", 2.5e-7), format_along("C", 0.03490658503988659)
    ('250 nm', '2 deg')
    """
    if is_rotary(axis):
        return format_span(axis, value, digits=digits)
    return format_length(value, digits=digits)


def ends_along(axis: str, low: float, high: float) -> str:
    """Return two places of an axis with one unit."""
    if is_rotary(axis):
        return f"{format_along(axis, low)} ... {format_along(axis, high)}"
    return format_ends(low, high)


def format_range(axis: str, low: float, high: float) -> str:
    """Return a range of an axis, such as "X = 0 mm ... 80 mm"."""
    return f"{format_position(axis, low)} ... {format_position(axis, high).split(' = ', 1)[1]}"


_PLACES = ("span", "positions", "reference", "made_over", "spacing", "held")
"""Keys of positions along the looked-up axis; others are amounts of the corrected one."""


@dataclass(frozen=True, slots=True)
class AxisUnits:
    """Units of a table over one axis in texts and keys, by what its axes do: move along or turn."""

    looked_up: str = "X"
    corrected: str = "X"

    @classmethod
    def of(cls, carried: Any) -> AxisUnits:
        """Return those of a table; lengths for what names no axes."""
        if hasattr(carried, "axis") and hasattr(carried, "compensates"):
            return cls(carried.axis, carried.compensates)
        return cls()

    def place(self, value: float, *, digits: int = 4) -> str:
        """Return a position or a step along the looked-up axis."""
        return format_along(self.looked_up, value, digits=digits)

    def amount(self, value: float) -> str:
        """Return a correction or an error: nm or um, or urad."""
        if is_rotary(self.corrected):
            return format_amount(self.corrected, value)
        return f"{value * 1e9:.4g} nm" if abs(value) < 1e-5 else f"{value * 1e6:.4g} um"

    def slope(self, value: float) -> str:
        """Return an amount for each step along the looked-up axis."""
        units = "urad" if is_rotary(self.corrected) else "um"
        return f"{value * 1e6:.4g} {units}/{'rad' if is_rotary(self.looked_up) else 'm'}"

    def named(self, found: Any) -> Any:
        """Return values with the unit in their keys that is true: ``_rad`` for ``_m`` where an axis turns.

        Examples
        --------
        >>> AxisUnits("C", "Z").named({"span_m": [0.0, 1.0], "stroke_m": 1e-6})
        {'span_rad': [0.0, 1.0], 'stroke_m': 1e-06}
        """
        if isinstance(found, list):
            return [self.named(v) for v in found]
        if not isinstance(found, Mapping):
            return found
        return {self._key(k): v if k == "history" else self.named(v) for k, v in found.items()}

    def _key(self, key: str) -> str:
        name, _, unit = key.rpartition("_")
        axis = self.looked_up if name in _PLACES else self.corrected
        if unit not in ("m", "m2") or not is_rotary(axis):
            return key
        return f"{name}_{unit.replace('m', 'rad')}"


LENGTHS = AxisUnits()


def numbers_of(found: Any) -> Any:
    """Return stored values with ``_m`` for ``_rad`` in their keys, for readers of the numbers alone."""
    if not isinstance(found, Mapping):
        return found
    names = ((k, re.sub(r"_rad(2?)$", r"_m\1", k)) for k in found)
    return {new: numbers_of(found[k]) for k, new in names}
