"""A file that was active while the readings for its successor were taken.

The readings then show e2(p) = c_old(p) + e(p + c_old(p)). What is loaded instead holds both (see
`metrosep.compensation.combine`); it is judged against the state that was measured, which its bytes
change by c_new(p) with ``c(p) = c_new(p) + c_old(p + c_new(p))``.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.compensation.area_errors import AxisUnits, format_span
from metrosep.compensation.combine import combine_tables
from metrosep.compensation.limits import Finding
from metrosep.compensation.measured import cooled, measured_error
from metrosep.compensation.table import CompensationTable
from metrosep.compensation.uniform import is_uniform
from metrosep.controllers._grids import carry
from metrosep.controllers.base import (
    ALONE,
    Dialect,
    Encoded,
    Prepared,
    Simulator,
    load_bytes,
    load_sidecar,
    own_part,
    require_unchanged,
    sidecar_options,
)
from metrosep.controllers.options import checked_options, is_one_turn
from metrosep.controllers.registry import find
from metrosep.controllers.safety import require_read_back
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, DataError, TableError
from metrosep.core.numbers import choice
from metrosep.core.runset import RunSet
from metrosep.separation.positions.expansion import Expansion
from metrosep.separation.positions.pitch import REFERENCE_DIRECTIONS

_NEAR = 1e-9
"""Of a span: places so near to each other are one."""
_NOTHING = 1e-13
"""A tenth of a picometre."""
_STEPS = 8
"""Of the fixed point for c_new; slopes of 1e-2 need seven."""


@dataclass(frozen=True, slots=True, eq=False)
class Active:
    """The file that was active, as a table and as its controller looks it up."""

    name: str
    sha256: str
    table: CompensationTable
    lookup: Simulator
    is_zeroed: bool  # whether the axis would jump by what the file holds at its reference

    def added(self, new: CompensationTable) -> CompensationTable:
        """Return the table that holds both, without an offset at the reference where none may be."""
        both = combine_tables(self.table, new)
        low, high = both.span
        if not self.is_zeroed or not low <= both.reference <= high:
            return both
        there = both.at_reference
        return replace(
            both,
            forward=both.forward - there,
            reverse=None if both.reverse is None else both.reverse - there,
            offset_removed=both.offset_removed + there,
        )

    def require_temperature(self, new: CompensationTable) -> None:
        """Refuse to add, to a table held at 20 degC, one of readings whose temperature nobody states."""
        old = self.table
        if old.heat.is_stated and old.is_on_axis and not new.heat.is_stated:
            raise DataError(
                f"{self.name} holds without thermal expansion, and the temperature of the readings "
                'taken with it is not stated: say temperature="22.4 degC" and expansion="11.5 ppm/K", or '
                "already_corrected=True"
            )

    def increment(self, lookup: Simulator) -> Simulator:
        """Return what a file that is loaded instead changes of the state that was measured."""

        def at(position: ArrayLike, direction: int = 1) -> FloatArray:
            p = np.asarray(position, dtype=np.float64)
            whole = lookup(p, direction)
            step = whole - self.lookup(p, direction)
            for _ in range(_STEPS if self.table.is_on_axis else 0):
                step = whole - self.lookup(p + step, direction)
            return np.asarray(step)

        return at

    def described(self, runs: Any, heat: Expansion | None = None) -> dict[str, Any]:
        """Return what a sidecar says of it: its hash, and the error without any table, as it is held."""
        found: dict[str, Any] = {"name": self.name, "sha256": self.sha256}
        if isinstance(runs, RunSet):
            runs = cooled(runs, 0.0 if heat is None else heat.slope, self.table.reference)
            found["without_any_table_rms_m"] = self._rms(runs, alone=True)
            found["with_it_rms_m"] = self._rms(runs, alone=False)
        return found

    def finding(self, told: Mapping[str, Any], *, is_trial: bool) -> Finding:
        """Return what the user should know: both are in the file, and what the old one did."""
        if is_trial:
            text = (
                f"{self.name} was active and is in this file beside the bump: 'without the trial table' "
                f"means with {self.name}"
            )
            return Finding.warning(text, "", "active")
        text = (
            f"{self.name} was active: this file holds it and what it left, load it INSTEAD of it"
        )
        if "with_it_rms_m" in told:
            units = AxisUnits.of(self.table)
            without, there = told["without_any_table_rms_m"], told["with_it_rms_m"]
            text += (
                f"; RMS of the readings without any table {units.amount(without)}, with "
                f"{self.name} {units.amount(there)}"
            )
            if there > without:
                text += f": {self.name} made it worse, its sign or its axis is wrong"
        return Finding.warning(text, "", "active")

    def _rms(self, runs: RunSet, *, alone: bool) -> float:
        """Return the RMS of a pass, one constant off: (27) where no table acts."""
        if alone:
            runs = RunSet([replace(r, z=r.z - self.lookup(r.x, r.direction)) for r in runs])
        passes = [
            np.concatenate([row.curves[d](x) for d, x in row.places.items()])
            for row in measured_error(runs, self.table.span).rows
        ]
        return float(np.sqrt(np.mean([np.var(z) for z in passes])))


def active_file(
    path: str | os.PathLike[str], new: Any, controller: str, options: Mapping[str, Any]
) -> Active:
    """Return the file that was active; without a sidecar it is of the axes of the new table."""
    if not isinstance(new, CompensationTable):
        raise DataError(
            f"active= is for tables over one axis, not for a {type(new).__name__}: add maps with "
            "metrosep.compensation.combine_tables"
        )
    file = Path(path)
    data = load_bytes(file)
    require_unchanged(file, data)
    beside = own_part(load_sidecar(file), new.compensates)
    name = str(beside.get("controller", controller))
    dialect = find(name)
    if dialect.info.carries != "table":
        raise TableError(f"{file}: holds a {dialect.info.carries}, not a table over one axis")
    known = {o.name for o in dialect.options}
    given = {k: v for k, v in options.items() if k in known and v is not None}
    given = {
        **checked_options(given, dialect.options, name, partial=True),
        **sidecar_options(file, dialect.options),
    }
    if "column" in known:
        given["column"] = new.compensates
    if "first" in known and not beside and dialect.facts(data, file, **given).get("first") is None:
        # the travel of the machine, which a file of the control does not state
        given |= dict(zip(("first", "last"), new.span, strict=True))
    table = dialect.decode(data, file, **given)
    if not beside:
        table = replace(
            table, axis=new.axis, compensates=new.compensates, reference=new.reference,
            reference_direction=new.reference_direction,
        )  # fmt: skip
    else:
        table = replace(table, **held_as(file, beside))
    lookup = dialect.lookup(data, file, **given)
    return Active(
        file.name,
        hashlib.sha256(data).hexdigest(),
        _gone_on(table, lookup, new.span),
        lookup,
        find(controller).needs_zero,
    )


def _gone_on(
    table: CompensationTable, lookup: Simulator, span: tuple[float, float]
) -> CompensationTable:
    """Return a table that also holds what its control does beyond it over a travel: it may roll over."""
    low, high = table.span
    near = _NEAR * (high - low)
    if low - near <= span[0] and span[1] <= high + near:
        return table
    if is_uniform(table.positions):
        length, knots = (high - low) / (table.positions.size - 1), np.array([low])
    else:
        length, knots = high - low, table.positions[:-1]
    turns = np.arange(
        math.floor((span[0] - high) / length), math.ceil((span[1] - low) / length) + 1
    )
    places = np.sort((knots + length * turns[:, None]).ravel())
    inside = places[(places > span[0] + near) & (places < span[1] - near)]
    places = np.concatenate([span[:1], inside, span[1:]])
    ways = (1,) if table.reverse is None else (1, -1)
    columns = {d: lookup(places, d) for d in ways}
    if all(np.abs(columns[d] - table.correction(places, d)).max() <= _NOTHING for d in ways):
        return table  # its ends hold
    if not is_one_turn(table):  # whose other places are these again
        own = table.positions[
            (table.positions < span[0] - near) | (table.positions > span[1] + near)
        ]
        places = np.sort(np.concatenate([own, places]))
        columns = {d: lookup(places, d) for d in ways}
    return replace(
        table,
        positions=places,
        forward=columns[1],
        reverse=columns.get(-1),
        u=None,
        covariances={},
    )


def held_as(file: Path, beside: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a sidecar states of a table that its bytes do not: homing and temperatures."""
    told = beside.get("table")
    if not isinstance(told, Mapping):
        return {}
    way, heat = told.get("reference_direction", "forward"), told.get("heat") or {}
    try:
        choice(way, "reference_direction", REFERENCE_DIRECTIONS)
        stated = Expansion.of_options(heat) or Expansion()
    except (AttributeError, DataError, TypeError, ValueError):
        raise CorruptFileError(
            file,
            "its sidecar is not that of a table: 'reference_direction' or 'heat' is damaged",
            hint="move the sidecar away, or write the table again",
        ) from None
    return {"reference_direction": way, "heat": stated}


# ---- a file whose columns a new one takes over --------------------------------------------------
# Files that hold the tables of several corrected axes over one axis, a column for each.
#
# Each table is checked and judged alone; then the columns are put together, digit for digit, and the
# sidecar keeps what was found for each of them.

_OF_A_FILE = (
    "schema", "metrosep", "controller", "entry", "units", "outside", "sign_status",
    "sign_confirmed_by_user", "activation",
)  # fmt: skip
"""What the sidecars of all columns of a file have in common."""


def in_columns(dialect: Dialect, parts: list[Prepared], target: Path | None = None) -> Prepared:
    """Return several tables, each checked alone, as one file that reads back as each of them."""
    if not parts:
        raise TableError("there is no table in the list")
    nowhere = Path(os.devnull)
    data = dialect.in_columns([p.data for p in parts])
    sidecars = [json.loads(p.sidecar) for p in parts]
    columns = {}
    for part, beside in zip(parts, sidecars, strict=True):
        name, options = beside["table"]["compensates"], beside["options"]
        alone = dialect.decode(part.data, nowhere, **options)
        found = dialect.decode(data, nowhere, **{**options, "column": name})
        # the same digits, read from two files
        require_read_back(alone, found, Encoded(part.data, 0.0))
        beside["findings"] = [f for f in beside["findings"] if f["check"] != ALONE]
        columns[name] = beside
    shared = sidecars[0]["options"].items()
    sidecar = {
        **{key: sidecars[0][key] for key in _OF_A_FILE},
        "waived": sorted({w for s in sidecars for w in s["waived"]}),
        "options": {k: v for k, v in shared if all(s["options"].get(k) == v for s in sidecars)},
        "file_sha256": hashlib.sha256(data).hexdigest(),
        "columns": columns,
    }
    text = json.dumps(sidecar, indent=1, sort_keys=True, allow_nan=False) + "\n"
    judged_by = [p.verification for p in parts]
    return Prepared(
        target or parts[0].target, data, text.encode("utf-8"), judged_by, parts[0].overwrite
    )


@dataclass(frozen=True, slots=True, eq=False)
class Beside:
    """A file whose columns a new file takes over, but for that of the axis that the new table corrects."""

    name: str
    parts: tuple[Prepared, ...]  # each column as a file of its own
    corrects: tuple[str, ...]  # their corrected axes
    positions: FloatArray  # of all columns, m or rad

    def placed(self, table: CompensationTable) -> tuple[CompensationTable, float]:
        """Return a table at the positions of the file, and what the steps between them lose of it."""
        low, high = self.positions[0], self.positions[-1]
        near = 1e-6 * float(high - low)
        if table.span[0] > low + near or table.span[1] < high - near:
            ends = [format_span(table.axis, v, digits=6) for v in (*table.span, low, high)]
            raise TableError(
                f"the new table covers {ends[0]} ... {ends[1]}, the columns of {self.name} stand at {ends[2]} ... "
                f"{ends[3]}, and all columns of a file at one list of positions: measure that range"
            )
        fitted = carry(table, self.positions)
        return fitted.table, fitted.error

    def nearly_holds(self, table: CompensationTable) -> bool:
        """Return whether a table ends less than a step beyond the file; the dry-run judges what is left."""
        step = float(self.positions[1] - self.positions[0])
        low, high = table.span
        return bool(low > self.positions[0] - step and high < self.positions[-1] + step)

    def joined(self, dialect: Dialect, made: Prepared) -> Prepared:
        """Return the file of the columns that were there and a new one; judged as the new one alone."""
        whole = in_columns(dialect, [*self.parts, made], made.target)
        return replace(whole, verification=made.verification, overwrite=made.overwrite)


def columns_beside(dialect: Dialect, file: Path, table: Any) -> Beside:
    """Return the columns of a file that metrosep wrote, for a new table over the same axis."""
    data = load_bytes(file)
    require_unchanged(file, data)
    if not dialect.has_columns:
        raise TableError(f"{dialect.info.id} holds one table in a file: leave beside= out")
    whole = load_sidecar(file)
    if whole.get("controller") != dialect.info.id or whole.get("trial") is not None:
        raise TableError(
            f"{file}: beside= takes a table of {dialect.info.id} with the sidecar that says how its columns "
            "were judged; name such a file, or write all tables again"
        )
    parts, positions = [], np.empty(0)
    for target, column in dialect.columns_of(data, file).items():
        held = own_part(whole, target)
        axis = held["table"]["axis"]
        if axis != table.axis:
            raise TableError(
                f"{file}: its columns are looked up over {axis}, the new table over {table.axis}: one file "
                "is of one such axis"
            )
        positions = dialect.decode(data, file, column=target).positions
        if target != table.compensates:
            text = json.dumps(held, allow_nan=False).encode("utf-8")
            parts.append(Prepared(file, column, text, None, overwrite=False))
    names = tuple(json.loads(p.sidecar)["table"]["compensates"] for p in parts)
    return Beside(file.name, tuple(parts), names, positions)
