"""Maps of heights as plain text: a matrix of heights, or the columns x, y, z, without any header.

Nothing in such a file says what it holds. The caller does: one unit and a lateral step make a matrix of
heights; three units make points x, y, z.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from metrosep.core.errors import FormatMismatchError, ReadError, UnitError
from metrosep.core.surface import Surface
from metrosep.io._roles import refuse_marker, to_si
from metrosep.io.objects import make_surface, rows_of_matrix, to_grid
from metrosep.io.source import RawFile
from metrosep.io.text.table import Table

_SHOWN = 12
"""Columns that a message lists."""
_LEAST_COLUMNS = 3
"""A table of one or two columns is a profile."""
_POINTS = 3


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
    row_order: str | None = None,
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
    for c in table.columns:
        refuse_marker(file, table, c.name)
    z = np.column_stack(
        [to_si(file, c, c.unit, dimension="length", role="z", scale=scale) for c in table.columns]
    )
    facts: dict[str, Any] = {"units": {"z": next(u.name for u in units if u is not None)}}
    rows, said = rows_of_matrix(file, row_order)
    return make_surface(
        file,
        format_id,
        z,
        (None, None),
        **rows,
        header=table.header,
        override=steps,
        warnings=(*table.warnings, *said),
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
