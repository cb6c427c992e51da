"""Columns of a table picked by name and brought to SI, with a unit that somebody declared."""

from __future__ import annotations

import re
from decimal import Decimal
from typing import TypeAlias

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import AmbiguousFormatError, FormatMismatchError, UnitError
from metrosep.core.units import Unit, likely_meaning, parse_sensitivity, parse_unit
from metrosep.io.source import RawFile
from metrosep.io.text.dialect import encoding_hint, find_column
from metrosep.io.text.table import Column, Table
from metrosep.io.text.times import LONG_AGO_S, written_moments

__all__ = [
    "ColumnSpec",
    "pick",
    "refuse_marker",
    "sensitivity",
    "since_first_row",
    "to_si",
]

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
    refuse_marker(file, table, column.name)
    if not declared:
        return column, column.unit
    unit = parse_unit(declared)
    if column.unit is not None and column.unit != unit:
        raise FormatMismatchError(
            f"{file.path}: {role} column {column.name!r} is in {column.unit.name} by its header, but "
            f"{unit.name} was given; leave the unit out or correct the header"
        )
    return column, unit


def refuse_marker(file: RawFile, table: Table, name: str) -> None:
    """Refuse a column that is used where one of its values surely means "not measured"."""
    if (message := table.header.get("markers", {}).get(name)) is not None:
        raise AmbiguousFormatError(f"{file.path}: {message}")


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
    if unit is None and (odd := encoding_hint([column.name])):
        raise UnitError(
            f"{file.path}: the unit of column {column.name!r} ({role}) is not known: {odd}"
        )
    if unit is None and _COUNTS.search(column.name):
        raise UnitError(
            f"{file.path}: column {column.name!r} ({role}) holds counts, which are not a {dimension}; multiply them by "
            f"what one count is, and write the column in {_usual(dimension)}"
        )
    bracketed = re.search(r"[\[(<]\s*([^\])>]+?)\s*[\])>]\s*$", column.name)
    if unit is None and bracketed:
        raise UnitError(
            f"{file.path}: column {column.name!r} ({role}) has {bracketed[1]!r} for its unit, which is not known "
            f"as one of a {dimension}; correct the header, or give {role}=({column.name!r}, 'UNIT')"
        )
    if unit is None:
        raise UnitError(
            f"{file.path}: column {column.name!r} ({role}) declares no unit; rename it like "
            f"'{column.name}_{_usual(dimension)}', or give {role}=({column.name!r}, "
            f"{_usual(dimension)!r}) or unit="
            + (", with ms, us or ns for s if it counts these" if dimension == "time" else "")
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


def since_first_row(
    table: Table, column: Column, unit: Unit | None
) -> tuple[FloatArray, str, Decimal] | None:
    """Return a time that counts from a date as counts from its first row, the sentence that says so, and that row's count in s.

    A float of seconds since 1970 holds 0.24 us.
    """
    if unit is None or unit.dimension != "time" or column.values is None:
        return None
    least = np.fmin.reduce(np.abs(column.values), initial=np.inf)
    if not LONG_AGO_S < least * unit.factor < np.inf:
        return None
    if written_moments(column.values) is not None:
        raise UnitError(
            f"column {column.name!r} holds dates written as numbers such as {column.values[0]:.0f}, not counts in "
            f"{unit.name}; leave its unit out, or write them as yyyy-mm-dd hh:mm:ss"
        )
    since, first = table.since_first(column)
    said = (
        f"column {column.name!r} counts from a date; its time is given from the first row, which is at {first} "
        f"{unit.name}"
    )
    return since, said, Decimal(first) * Decimal(repr(unit.factor))


_COUNTS = re.compile(
    r"(?:^|[\s_\[(])(?:counts?|cts|incs?|increments?|inkremente?|pulses?|impulse?)\s*[\])]?$",
    re.IGNORECASE,
)


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
