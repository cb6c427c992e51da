"""Maps of heights as plain text: a matrix of heights, or the columns x, y, z, without any header.

Nothing in such a file says what it holds. The caller does: one unit and a lateral step make a
matrix of heights; three units make points x, y, z.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import FormatMismatchError, ReadError, UnitError, UnsupportedFeatureError
from metrosep.core.surface import Surface
from metrosep.io.objects import ROW_ORDERS, make_surface
from metrosep.io.source import MAX_PIXELS, RawFile
from metrosep.io.text.table import Table, to_si

__all__ = [
    "declared_units",
    "is_matrix",
    "looks_like_points",
    "matrix",
    "shown_columns",
    "to_grid",
]

_SHOWN = 12
"""Columns that a message lists."""
_LEAST_COLUMNS = 3
"""A table of one or two columns is a profile."""
_POINTS = 3
_FIRST_ROW = (
    "the file does not say where its first row lies: it was taken as the row of the smallest y; turn "
    "the rows (numpy.flipud) of an export that begins with the top row"
)


def declared_units(unit: Any) -> Any:
    """Return what a caller wrote as unit: several in one text become one for each column.

    Examples
    --------
    >>> declared_units("um, um, nm"), declared_units("x=um,z=nm"), declared_units("nm")
    (('um', 'um', 'nm'), {'x': 'um', 'z': 'nm'}, 'nm')
    """
    if not isinstance(unit, str) or not ("," in unit or "=" in unit):
        return unit
    items = [item.strip() for item in unit.split(",")]
    named = ["=" in item for item in items]
    if not any(named):
        return tuple(items)
    if not all(named):
        raise FormatMismatchError(
            f"unit {unit!r} names the column of some units only; write um,um,nm or x=um,y=um,z=nm"
        )
    pairs = (item.split("=", 1) for item in items)
    return {name.strip(): text.strip() for name, text in pairs}


def is_matrix(table: Table) -> bool:
    """Return whether a table holds only numbers, three and more columns, and no names of columns."""
    plain = not table.header.get("named", True)
    n = len(table.columns)
    return plain and n >= _LEAST_COLUMNS and len(table.numbers) == n


def looks_like_points(file: RawFile, table: Table) -> bool:
    """Return whether three columns of numbers lie on a grid of the first two: x, y, z."""
    columns = [c.values for c in table.columns if c.values is not None]
    if len(columns) != _POINTS or len(table.columns) != _POINTS:
        return False
    try:
        to_grid(file, columns[0], columns[1], columns[2])
    except ReadError:
        return False
    return True


def matrix(
    file: RawFile,
    table: Table,
    format_id: str,
    *,
    steps: tuple[float, float] | None,
    scale: float | None,
) -> Surface:
    """Return the map that a matrix of heights holds."""
    units = {c.unit for c in table.columns}
    if looks_like_points(file, table):
        raise FormatMismatchError(
            f"{file.path}: holds three columns without names that lie on a grid like points x, y, z; "
            "give the unit of each with unit='um,um,nm' and no lateral step"
        )
    if steps is None or None in units:
        missing = [
            *(["unit='nm'"] if None in units else []),
            *(["lateral_step='3 um'"] if steps is None else []),
        ]
        text = (
            f"{file.path}: holds {len(table)} x {len(table.columns)} numbers without names of columns; "
            f"for a map of heights give {' and '.join(missing)} (with your values)"
        )
        if steps is not None:
            raise UnitError(text)
        raise FormatMismatchError(text)
    if len(units) > 1:
        raise FormatMismatchError(
            f"{file.path}: a map of heights has one unit; give one, such as unit='nm'"
        )
    _refuse_gaps(file, table)
    z = np.column_stack(
        [to_si(file, c, c.unit, dimension="length", role="z", scale=scale) for c in table.columns]
    )
    facts: dict[str, Any] = {"units": {"z": next(u.name for u in units if u is not None)}}
    return make_surface(
        file,
        format_id,
        z,
        (None, None),
        row_order=ROW_ORDERS[0],
        header=table.header,
        override=steps,
        warnings=(*table.warnings, _FIRST_ROW),
        lines=table.ledger,
        **facts,
    )


def _refuse_gaps(file: RawFile, table: Table) -> None:
    """Refuse empty lines between rows where an empty line may be a row without a value."""
    if table.header.get("separator") != "\t":
        return
    gaps = np.flatnonzero(np.diff(table.lines) > 1)
    if gaps.size:
        line = int(table.lines[gaps[0]]) + 1
        raise FormatMismatchError(
            f"{file.path}: line {line} stands empty between rows of heights; write nan for each height "
            "of a row that was not measured, or remove the line"
        )


def shown_columns(names: tuple[str, ...]) -> str:
    """Return names of columns for a message, the first dozen of many.

    Examples
    --------
    >>> shown_columns(("x", "z"))
    'x, z'
    """
    rest = len(names) - _SHOWN
    return ", ".join(names[:_SHOWN]) + (f" and {rest} more" if rest > 0 else "")


# ---- A list of points x, y, z on a regular grid becomes a surface ------------------------------

_STEP_RTOL = 1e-3
"""Largest deviation of a position from the grid, relative to the step (digits of a text file)."""

_NOISE = 1e-12
"""Positions closer than this, relative to the span, are one position."""

_SPARSE = 64
"""Pixels per point beyond which points are scattered and no map."""

_SMALL = 4096
"""Pixels that a map may have whatever its points."""


def to_grid(
    file: RawFile, x: FloatArray, y: FloatArray, z: FloatArray
) -> tuple[FloatArray, tuple[float, float], tuple[float, float]]:
    """Return points in any order as a map."""
    columns, dx = _indices(file, x, "x")
    rows, dy = _indices(file, y, "y")
    shape = (int(rows.max()) + 1, int(columns.max()) + 1)
    pixels = shape[0] * shape[1]
    if pixels > MAX_PIXELS:
        raise UnsupportedFeatureError(
            f"{file.path}: the points span {shape[1]} x {shape[0]} steps, more than {MAX_PIXELS} pixels"
        )
    if pixels > max(_SPARSE * x.size, _SMALL):
        raise UnsupportedFeatureError(
            f"{file.path}: {x.size} points are scattered over a grid of {shape[1]} x {shape[0]}; resample "
            "them to a map first"
        )
    places = rows * shape[1] + columns
    if np.unique(places).size != places.size:
        raise FormatMismatchError(
            f"{file.path}: two points of the list lie at the same place; remove the repeats"
        )
    heights = np.full(shape[0] * shape[1], np.nan)
    heights[places] = z
    return heights.reshape(shape), (dx, dy), (float(x.min()), float(y.min()))


def _indices(file: RawFile, values: FloatArray, name: str) -> tuple[NDArray[np.int64], float]:
    if np.isnan(values).any():
        raise FormatMismatchError(f"{file.path}: a point has no position {name}; remove its row")
    levels = np.unique(values)
    if levels.size < 2:
        raise FormatMismatchError(
            f"{file.path}: all points have the same {name}, so there is no grid; read a profile with x= "
            "and z="
        )
    steps = np.diff(levels)
    span = float(levels[-1] - levels[0])
    steps = steps[steps > _NOISE * span]
    for guess in (
        float(np.median(steps)),
        float(steps.min()),
    ):  # the smallest where rows are missing
        step = span / max(round(span / guess), 1)
        index = np.rint((values - levels[0]) / step)
        fits = np.abs(values - levels[0] - index * step).max() <= _STEP_RTOL * step
        if fits and np.unique(index).size == steps.size + 1:
            return index.astype(np.int64), step
    raise FormatMismatchError(
        f"{file.path}: the positions {name} do not lie on a regular grid (step near "
        f"{float(np.median(steps)):.6g} m); resample the points first"
    )
