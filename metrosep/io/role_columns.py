"""Columns of a table by the role they play: times, targets, labels, runs; each in SI or as text."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core.errors import FormatMismatchError, UnitError
from metrosep.core.provenance import Step
from metrosep.io.dialect import Dialect, decode
from metrosep.io.run_tables import columns_of
from metrosep.io.select import ColumnSpec, pick, sensitivity, to_si
from metrosep.io.source import RawFile, open_file
from metrosep.io.table import Column, Table

__all__ = ["Role", "RoleColumns", "read_roles", "role_values"]

_PER = re.compile(r"[_ ]per[_ ][A-Za-z]+$")
"""A header such as ``speed_rev_per_min`` is in no unit that is known: its numbers stand."""


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


@dataclass(frozen=True, slots=True, eq=False)
class RoleColumns:
    """Columns of one or more files by their role."""

    # mapping of str to ndarray: each role: shape (n,), or (k, n) where it is a list of columns
    values: Mapping[str, NDArray[Any]]
    name: str  # of the file, without its extension; of the first where there are several
    history: tuple[Step, ...]  # one step ``read`` for each file
    warnings: tuple[str, ...] = ()  # what is odd about the files
    # mapping of str to tuple of str: names of the columns of each role, without their unit
    columns: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    # mapping of str to str: ``"m"`` or ``"rad"`` of each role that may be either
    units: Mapping[str, str] = field(default_factory=dict)


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
    for path in files:
        file = open_file(path)
        table, format_id = columns_of(file, {k: v for k, v in layout.items() if v is not None})
        for name, role in roles.items():
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
    stands = unit is None or _PER.search(column.name) is not None
    return np.asarray(column.values * (1.0 if stands or unit is None else unit.factor))


def _cell_texts(file: RawFile, table: Table, column: Column) -> list[str]:
    """Return the cells of a column of numbers as they are written: 01 is not 1, 1E2 not 100."""
    if "separator" not in table.header:  # a recording has no text
        numbers = column.values if column.values is not None else np.empty(0)
        return [repr(float(v)).removesuffix(".0") for v in numbers]
    header = table.header
    dialect = Dialect(header["separator"], header["decimal"], header["quoted"])
    lines = decode(file.data, file.path, header["encoding"])[0].split("\n")
    place = table.names.index(column.name)
    rows = dialect.split(lines[n - 1] for n in table.lines.tolist())
    return [row[place].strip() for row in rows]


def _text(column: Any) -> str:
    return ", ".join(str(c) for c in column) if isinstance(column, list) else str(column)


def _specs(role: Role) -> list[ColumnSpec]:
    return role.column if isinstance(role.column, list) else [role.column]


def _names(file: RawFile, table: Table, role: Role, name: str) -> tuple[str, ...]:
    found = [pick(file, table, spec, role=name)[0] for spec in _specs(role)]
    return tuple(
        c.name.rsplit("_", 1)[0] if c.unit is not None and "_" in c.name.strip("_") else c.name
        for c in found
    )


def _either(file: RawFile, table: Table, role: Role, name: str, before: str | None) -> str:
    """Return m or rad, the same for all columns of a role."""
    units = [pick(file, table, spec, role=name)[1] for spec in _specs(role)]
    found = {"rad" if u is not None and u.dimension == "angle" else "m" for u in units}
    found |= set() if before is None else {before}
    if len(found) > 1:
        raise UnitError(f"{file.path}: the {name} columns are lengths and angles; give one kind")
    return found.pop()
