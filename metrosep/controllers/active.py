"""A file that was active while the readings for its successor were taken.

The readings then show e2(p) = c_old(p) + e(p + c_old(p)). What is loaded instead holds both (see
`metrosep.compensation.combine`); it is judged against the state that was measured, which its bytes
change by c_new(p) with ``c(p) = c_new(p) + c_old(p + c_new(p))``.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.compensation.area_errors import AxisUnits
from metrosep.compensation.combine import combine_tables
from metrosep.compensation.limits import Finding
from metrosep.compensation.measured import cooled, paired
from metrosep.compensation.table import CompensationTable
from metrosep.controllers.base import (
    Simulator,
    load_bytes,
    load_sidecar,
    own_part,
    require_unchanged,
    sidecar_options,
)
from metrosep.controllers.options import checked_options
from metrosep.controllers.registry import find
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, DataError, TableError
from metrosep.core.numbers import choice
from metrosep.core.runset import RunSet
from metrosep.separation.positions.expansion import Expansion
from metrosep.separation.positions.pitch import REFERENCE_DIRECTIONS

__all__ = ["Active", "active_file", "held_as"]

_STEPS = 8
"""Of the fixed point for c_new; slopes of 1e-2 need seven."""


@dataclass(frozen=True, slots=True, eq=False)
class Active:
    """The file that was active, as a table and as its controller looks it up."""

    name: str
    sha256: str
    table: CompensationTable
    lookup: Simulator

    def added(self, new: CompensationTable) -> CompensationTable:
        """Return the table that holds both."""
        return combine_tables(self.table, new)

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
            return Finding("warning", text, "", "active")
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
        return Finding("warning", text, "", "active")

    def _rms(self, runs: RunSet, *, alone: bool) -> float:
        """Return the RMS of a row, one constant off: (27) where no table acts."""
        squares = []
        for members in paired(runs)[0]:
            parts = []
            for i in members:
                run = runs[i]
                off = self.lookup(run.x, run.direction) if alone else 0.0
                parts.append((run.z - off)[~np.isnan(run.z)])
            row = np.concatenate(parts)
            squares.append(float(((row - row.mean()) ** 2).mean()))
        return float(np.sqrt(np.mean(squares)))


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
    table = dialect.decode(data, file, **given)
    if not beside:
        table = replace(
            table, axis=new.axis, compensates=new.compensates, reference=new.reference,
            reference_direction=new.reference_direction,
        )  # fmt: skip
    else:
        table = replace(table, **held_as(file, beside))
    return Active(
        file.name, hashlib.sha256(data).hexdigest(), table, dialect.lookup(data, file, **given)
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
            "its sidecar is not that of a table: reference_direction or heat is damaged",
            hint="move the sidecar away, or write the table again",
        ) from None
    return {"reference_direction": way, "heat": stated}
