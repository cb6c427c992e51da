"""Shared by the writers of the ISG dialects: lists of ``key value`` lines with comments, in units of 0.1 um."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from metrosep.compensation.knots import choose_knots
from metrosep.compensation.table import CompensationTable
from metrosep.controllers._increments import (
    DRY_RUN,
    Carried,
    carry,
    fixed,
    uniform_positions,
)
from metrosep.controllers.base import Encoded
from metrosep.controllers.options import Option
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import LimitError, TableError
from metrosep.core.units import format_length

__all__ = [
    "AXIS_NUMBER",
    "FARTHEST",
    "INTERVAL",
    "NAME",
    "NUMBER_TYPE",
    "SGN32",
    "UNIT",
    "encoded",
    "head_lines",
    "placed",
    "spacing",
    "to_units",
]


UNIT = 1e-7
"""Length of 1 in a list with unit 1, m."""
_DECIMALS = 6
"""Decimals of a REAL64 entry: 0.1 pm."""
SGN32 = 2**31 - 1

NAME = re.compile(r"[A-Za-z]\w{0,15}", re.ASCII)

AXIS_NUMBER = Option(
    "axis_number",
    "logical number of the corrected axis",
    "integer",
    required=True,
    lowest=1,
    highest=999,
)
FARTHEST = 214.0
"""What 32 bits of 0.1 um hold, m."""

INTERVAL = Option(
    "interval",
    "equal spacing; as the table if omitted",
    "length",
    positive=True,
    highest=100.0,
)
NUMBER_TYPE = Option(
    "number_type",
    "whole numbers, or decimals (REAL64: builds from V3.1.3132 or V4.29 on)",
    "choice",
    default="integer",
    choices=("integer", "real"),
)


def placed(table: CompensationTable, options: Mapping[str, Any], title: str) -> Carried:
    """Return a table at positions that a list can hold."""
    capacity = options["capacity"]
    values = None
    if options["interval"] is not None:
        positions = uniform_positions(
            table, interval=options["interval"], max_points=capacity, title=title
        )
    elif table.positions.size <= capacity:
        positions = np.asarray(table.positions)
    elif table.reverse is None:
        knots = choose_knots(table.positions, table.forward, capacity)
        positions, values = knots.positions, knots.values
    else:
        positions = np.linspace(*table.span, capacity)
    quantum = UNIT if options["number_type"] == "integer" else UNIT * 10.0**-_DECIMALS
    at = np.rint(positions / quantum) * quantum
    if (np.diff(at) <= 0).any():
        i = int(np.flatnonzero(np.diff(at) <= 0)[0])
        raise TableError(
            f"{title}: the positions {positions[i] * 1e3:.9g} and {positions[i + 1] * 1e3:.9g} mm fall "
            f"together at steps of {format_length(quantum)}; use a wider spacing"
        )
    if values is None:
        return carry(table, at)
    made = replace(table, positions=at, forward=values, u=None)
    everywhere = np.union1d(at, table.positions)
    error = np.abs(made.correction(everywhere) - table.correction(everywhere)).max()
    return Carried(made, float(error), True)


def to_units(values: FloatArray, kind: str) -> list[str]:
    """Return lengths as numbers of a list."""
    counts = np.asarray(values) / UNIT
    if float(np.abs(counts).max()) > SGN32:
        worst = float(np.asarray(values)[int(np.abs(counts).argmax())])
        raise LimitError(
            f"{format_length(worst)} is beyond the 32 bits of a list in 0.1 um (214 m); check the "
            "units of the table"
        )
    return [_printed(float(c), kind) for c in counts]


def _printed(count: float, kind: str) -> str:
    return str(round(count)) if kind == "integer" else fixed(count, _DECIMALS)


def spacing(positions: list[str], kind: str) -> str:
    """Return the interval of equally spaced positions, "0" if they are not."""
    p = np.array([float(v) for v in positions])
    step = _printed(float(p[-1] - p[0]) / (p.size - 1), kind)
    off = np.abs(p - (p[0] + float(step) * np.arange(p.size))).max()
    return step if off <= 1e-9 * abs(float(step)) + 10.0**-_DECIMALS else "0"


def head_lines(name: str, options: Mapping[str, Any]) -> list[str]:
    """Return comment and head of a list."""
    if not NAME.fullmatch(name):
        raise TableError(f"axis {name!r} is no name for a list: letters, digits, underscores")
    sign = "+" if options["entry_sign"] > 0 else "-"
    return [
        f"# metrosep: entry = {sign}e in 0.1 um, {DRY_RUN}",
        f"kopf.achs_nr {options['axis_number']}",
        f"kopf.log_achs_name {name}",
    ]


def encoded(
    carried: Any, wanted: list[FloatArray], columns: list[list[str]], lines: list[str], kind: str
) -> Encoded:
    """Return the bytes with what rounding costs."""
    off = max(
        float(np.abs(np.array([float(v) for v in c]) * UNIT - w).max())
        for c, w in zip(columns, wanted, strict=True)
    )
    return Encoded(
        ("\n".join(lines) + "\n").encode("ascii"),
        off,
        step=UNIT if kind == "integer" else 0.0,
        carried=carried.table,
        resampling_error=carried.error,
    )
