"""Columns of a table by the role they play: times, targets, labels, runs; each in SI or as text."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from decimal import Decimal
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    FormatMismatchError,
    UnitError,
)
from metrosep.core.methods import RoleColumns
from metrosep.core.provenance import Step
from metrosep.core.units import (
    SURROUNDINGS,
    TYPICAL,
    parse_unit,
    surrounding_header,
)
from metrosep.io._roles import ColumnSpec, pick, sensitivity, to_si
from metrosep.io.runs import columns_of, from_first_row
from metrosep.io.source import RawFile, open_file
from metrosep.io.text.dialect import Dialect
from metrosep.io.text.encoding import decode
from metrosep.io.text.lines import unframed
from metrosep.io.text.table import Column, Table

_PER = re.compile(r"[_ ]per[_ ][A-Za-z]+$")
"""Numbers per turn, or turns per minute, stand where a role has no dimension: the method says their unit."""


@dataclass(frozen=True, slots=True)
class Role:
    """What a column is and where it stands."""

    # pair of str, or list of these: A name whose header carries the unit, ``"name:unit"``,
    # ``("name", "unit")``; a list makes one row for each column
    column: ColumnSpec | list[ColumnSpec]
    # ``"length"``, ``"angle"``, ``"time"`` ... : brought to SI. ``"position"``: a length or an
    # angle. ``"any"``: brought to SI where there is a unit, else as it stands. ``"label"``: texts,
    # those of the cells where they are numbers
    dimension: str
    scale: str | None = None  # sensitivity where the column is a voltage and a length is meant


def read_roles(
    paths: str | os.PathLike[str] | Iterable[str | os.PathLike[str]],
    roles: Mapping[str, Role],
    **layout: Any,
) -> RoleColumns:
    """Read columns by their role; the rows of several files follow one another."""
    files = [paths] if isinstance(paths, str | os.PathLike) else list(paths)
    if not files:
        raise FormatMismatchError("no file to read columns from; name at least one")
    parts: dict[str, list[NDArray[Any]]] = {name: [] for name in roles}
    history: list[Step] = []
    warnings: list[str] = []
    columns: dict[str, tuple[str, ...]] = {}
    units: dict[str, str] = {}
    zero: Decimal | None = None  # of all times that count from a date, whose digits a float loses
    for path in files:
        given = {k: v for k, v in layout.items() if v is not None}
        file, table, format_id = columns_of(open_file(path), given)
        for name, role in roles.items():
            if role.dimension == "time" and not isinstance(role.column, list):
                table, zero = from_first_row(file, table, role.column, zero)
            parts[name].append(role_values(file, table, role, name=name))
            columns[name] = _names(file, table, role, name)
            if role.dimension == "position":
                units[name] = _either(file, table, role, name, units.get(name))
        warnings += [f"{file.name}: {w}" for w in table.warnings]
        history += file.history(format_id, {k: _text(r.column) for k, r in roles.items()})
    return RoleColumns(
        {name: np.concatenate(arrays, axis=-1) for name, arrays in parts.items()},
        open_file(files[0]).name.rsplit(".", 1)[0],
        tuple(history),
        tuple(warnings),
        columns,
        units,
    )


def role_values(file: RawFile, table: Table, role: Role, *, name: str) -> NDArray[Any]:
    """Return the values of one role from a table."""
    if isinstance(role.column, list):
        return np.stack(
            [
                role_values(file, table, Role(c, role.dimension, role.scale), name=name)
                for c in role.column
            ]
        )
    if role.dimension in SURROUNDINGS:
        return _surroundings(file, table, role, name)
    column, unit = pick(file, table, role.column, role=name)
    if role.dimension == "label":
        if column.labels is not None:
            return np.array(column.labels)
        return np.array(_cell_texts(file, table, column))
    if role.dimension == "position":
        dimension = "angle" if unit is not None and unit.dimension == "angle" else "length"
        return to_si(file, column, unit, dimension=dimension, role=name)
    if role.dimension != "any":
        scale = sensitivity(role.scale) if role.dimension == "length" else None
        return to_si(file, column, unit, dimension=role.dimension, role=name, scale=scale)
    if column.values is None:
        raise FormatMismatchError(
            f"{file.path}: {name} column {column.name!r} holds text, not numbers; name another column"
        )
    stands = unit is None or unit.name == "rpm" or _PER.search(column.name) is not None
    return np.asarray(column.values * (1.0 if stands or unit is None else unit.factor))


def _surroundings(file: RawFile, table: Table, role: Role, name: str) -> FloatArray:
    """Return a column of air or parts in SI: its header or ``NAME:UNIT`` says its unit."""
    spec: Any = role.column
    declared: str | None = None
    if isinstance(spec, str) and spec not in table.names and ":" in spec:
        spec, declared = spec.rsplit(":", 1)
    elif not isinstance(spec, str):
        spec, declared = spec
    column, _ = pick(file, table, spec, role=name)
    unit = surrounding_header(column.name, role.dimension)
    if declared is not None:
        given = parse_unit(declared, dimension=role.dimension)
        if unit is not None and unit.name != given.name:
            raise FormatMismatchError(
                f"{file.path}: {name} column {column.name!r} is in {unit.name} by its header, but "
                f"{given.name} was given; leave the unit out or correct the header"
            )
        unit = given
    if column.values is None:
        raise FormatMismatchError(
            f"{file.path}: {name} column {column.name!r} holds text, not numbers; name another column"
        )
    if unit is None:
        example = TYPICAL[role.dimension].split()[-1]
        raise UnitError(
            f"{file.path}: column {column.name!r} ({name}) declares no unit of a {role.dimension}; rename "
            f"it like '{column.name} [{example}]', or name it '{column.name}:{example}'"
        )
    return np.asarray(column.values * unit.factor + unit.zero)


def _cell_texts(file: RawFile, table: Table, column: Column) -> list[str]:
    """Return the cells of a column of numbers as they are written: 01 is not 1, 1E2 not 100."""
    if "separator" not in table.header:  # a recording has no text
        numbers = column.values if column.values is not None else np.empty(0)
        return [repr(float(v)).removesuffix(".0") for v in numbers]
    header = table.header
    text = decode(file.data, file.path, header["encoding"])[0]
    dialect = Dialect(header["separator"], header["decimal"], '"' in text)
    lines = unframed(text, text).split("\n")
    place = table.names.index(column.name)
    rows = dialect.split(lines[n - 1] for n in table.lines.tolist())
    return [row[place].strip() if place < len(row) else "" for row in rows]


def _text(column: Any) -> str:
    return ", ".join(str(c) for c in column) if isinstance(column, list) else str(column)


def _specs(role: Role) -> list[ColumnSpec]:
    return role.column if isinstance(role.column, list) else [role.column]


_BRACKETS = re.compile(r"[\s_]*[(\[][^)\]]*[)\]]\s*$")
_BEHIND = re.compile(r"[\s_]*(?:[(\[][^)\]]*[)\]]|[\s_][^\s_]+)\s*$")


def _said(header: str, dimension: str) -> bool:
    """Return whether a header ends in a unit of air or parts."""
    return surrounding_header(header, dimension) is not None


def _names(file: RawFile, table: Table, role: Role, name: str) -> tuple[str, ...]:
    if role.dimension in SURROUNDINGS:
        plain = [str(c if isinstance(c, str) else c[0]) for c in _specs(role)]
        names = [c if c in table.names or ":" not in c else c.rsplit(":", 1)[0] for c in plain]
        if not isinstance(role.column, list):
            return tuple(plain)
        return tuple(_BEHIND.sub("", n) if _said(n, role.dimension) else n for n in names)
    found = [pick(file, table, spec, role=name)[0] for spec in _specs(role)]
    return tuple(_without_unit(c.name) if c.unit is not None else c.name for c in found)


def _without_unit(name: str) -> str:
    """Return the name of a column whose header bears a unit, ``m1_um`` or ``m1 [um]``, without it."""
    if _BRACKETS.search(name):
        return _BRACKETS.sub("", name)
    return name.rsplit("_", 1)[0] if "_" in name.strip("_") else name


def _either(file: RawFile, table: Table, role: Role, name: str, before: str | None) -> str:
    """Return m or rad, the same for all columns of a role."""
    units = [pick(file, table, spec, role=name)[1] for spec in _specs(role)]
    found = {"rad" if u is not None and u.dimension == "angle" else "m" for u in units}
    found |= set() if before is None else {before}
    if len(found) > 1:
        raise UnitError(f"{file.path}: the {name} columns are lengths and angles; give one kind")
    return found.pop()
