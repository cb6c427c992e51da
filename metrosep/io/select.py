"""Columns of a table picked by name and brought to SI, with a unit that somebody declared."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import FormatMismatchError, UnitError
from metrosep.core.units import Unit, likely_meaning, parse_sensitivity, parse_unit
from metrosep.io.headers import find_column
from metrosep.io.source import RawFile
from metrosep.io.table import Column, Table

__all__ = ["ColumnSpec", "pick", "sensitivity", "to_si"]

ColumnSpec: TypeAlias = str | tuple[str, str]
"""A column: its name, ``"name:unit"`` or ``("name", "unit")``."""


def pick(
    file: RawFile, table: Table, spec: ColumnSpec, *, role: str
) -> tuple[Column, Unit | None]:
    """Return the column that a specification names, and its unit."""
    declared: str | None = None
    if isinstance(spec, str):
        name = spec
        if spec not in table.names and ":" in spec:
            name, declared = spec.rsplit(":", 1)
    else:
        if len(spec) != 2:
            raise FormatMismatchError(
                f"{role} column {spec!r} must be a name or a pair of name and unit"
            )
        name, declared = spec
    if name.strip().isdecimal() and not table.header.get("named", True):
        number = int(name)
        name = table.names[number - 1] if 1 <= number <= len(table.names) else name
    column = table[find_column(name, table.names, file.path, role=role)]
    if not declared:
        return column, column.unit
    unit = parse_unit(declared)
    if column.unit is not None and column.unit != unit:
        raise FormatMismatchError(
            f"{file.path}: {role} column {column.name!r} is in {column.unit.name} by its header, but "
            f"{unit.name} was given; leave the unit out or correct the header"
        )
    return column, unit


def to_si(
    file: RawFile,
    column: Column,
    unit: Unit | None,
    *,
    dimension: str,
    role: str,
    scale: float | None = None,
) -> FloatArray:
    """Return the numbers of a column in SI."""
    if column.values is None:
        first = column.labels[0] if column.labels else ""
        raise FormatMismatchError(
            f"{file.path}: {role} column {column.name!r} holds text ({first!r}), not numbers; name "
            "another column"
        )
    odd = likely_meaning(column.name) if unit is None else None
    if odd is not None:
        raise UnitError(
            f"{file.path}: the unit of column {column.name!r} ({role}) is not known: {odd}; correct the "
            f"header, or give {role}=({column.name!r}, {_usual(dimension)!r})"
        )
    if unit is None:
        raise UnitError(
            f"{file.path}: column {column.name!r} ({role}) declares no unit; rename it like "
            f"'{column.name}_{_usual(dimension)}', or give {role}=({column.name!r}, "
            f"{_usual(dimension)!r}) or unit="
        )
    if scale is not None:
        if unit.dimension != "voltage":
            raise UnitError(
                f"{file.path}: column {column.name!r} ({role}) is in {unit.name}, not in volts; leave "
                "scale= out"
            )
        return np.asarray(column.values * (unit.factor * scale))
    if unit.dimension == "voltage" and dimension == "length":
        raise UnitError(
            f"{file.path}: column {column.name!r} ({role}) is in {unit.name}; give the sensitivity of "
            "the sensor, such as scale='2.5 um/V'"
        )
    if unit.dimension != dimension:
        raise UnitError(
            f"{file.path}: column {column.name!r} ({role}) is in {unit.name} ({unit.dimension}); "
            f"{'an' if dimension[:1] in 'aeiou' else 'a'} {dimension} is needed; name another column"
        )
    return np.asarray(column.values * unit.factor)


def sensitivity(scale: float | str | None) -> float | None:
    """Return the sensitivity of a sensor in m/V."""
    if isinstance(scale, str):
        return parse_sensitivity(scale)
    return None if scale is None else float(scale)


def _usual(dimension: str) -> str:
    return {
        "length": "um",
        "time": "s",
        "speed": "mm/min",
        "angle": "deg",
        "voltage": "V",
        "frequency": "Hz",
    }.get(dimension, "um")
