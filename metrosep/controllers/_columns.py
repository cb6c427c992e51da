"""Files that hold the tables of several corrected axes over one axis, a column for each.

Each table is checked and judged alone; then the columns are put together, digit for digit, and the
sidecar keeps what was found for each of them.
"""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from metrosep.compensation.area_errors import format_span
from metrosep.compensation.table import CompensationTable
from metrosep.controllers._grids import carry
from metrosep.controllers._pairs import Prepared
from metrosep.controllers.base import (
    ALONE,
    Dialect,
    Encoded,
    load_bytes,
    load_sidecar,
    own_part,
    require_unchanged,
)
from metrosep.controllers.safety import require_read_back
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import TableError

__all__ = ["Beside", "columns_beside", "in_columns"]

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
