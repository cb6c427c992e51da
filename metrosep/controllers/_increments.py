"""Shared by the dialects of uniform tables and of increments: spacing, facts in comments, numbers.

Unlike `metrosep.compensation.uniform.resample_uniform`, `carry` does not shift the entries: what a
file holds is the table at other positions, and every deviation is reported.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from metrosep.compensation.area_errors import is_rotary
from metrosep.compensation.limits import Limits
from metrosep.compensation.table import CompensationTable
from metrosep.compensation.uniform import is_uniform
from metrosep.controllers.base import Dialect, sidecar_options
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, LimitError, TableError
from metrosep.core.units import format_length

__all__ = [
    "DRY_RUN",
    "Carried",
    "Resampling",
    "ascii_lines",
    "carry",
    "fixed",
    "mm_text",
    "mm_value",
    "require_capacity",
    "require_interval",
    "require_linear",
    "require_on_axis",
    "require_one_direction",
    "require_sizes",
    "require_zero",
    "uniform_positions",
]


DRY_RUN = "sign not documented: dry-run on the machine first"

_UNIFORM = 1e-9
"""Deviation from a grid over its spacing within which a position lies on it."""

_SAME = 1e-12
"""A picometre: interpolation between two entries leaves 1e-23 m of a zero."""


class Resampling(Dialect):
    """A dialect that resamples by itself: its points are counted in the file, not in the table."""

    def limits(self, **machine: Any) -> Limits:
        """Return the limits of the machine; the entries are counted by `encode`."""
        return super().limits(**{"max_points": None, **machine})


@dataclass(frozen=True, slots=True)
class Carried:
    """A table or map at the positions of a file."""

    table: Any  # or CompensationMap: at these positions, not rounded
    error: float  # m: largest deviation from the table it was made of, in both directions
    is_new: bool  # whether its positions are others


def carry(table: CompensationTable, positions: FloatArray) -> Carried:
    """Return a table at other positions."""
    margin = _UNIFORM * float(np.diff(positions).min())
    same = positions.size == table.positions.size
    if same and float(np.abs(positions - table.positions).max()) <= margin:
        return Carried(table, 0.0, False)
    made = replace(
        table,
        positions=positions,
        forward=table.correction(positions, 1),
        reverse=None if table.reverse is None else table.correction(positions, -1),
        u=None if table.u is None else np.interp(positions, table.positions, table.u),
    )
    everywhere = np.union1d(table.positions, positions)
    error = max(
        float(np.abs(made.correction(everywhere, d) - table.correction(everywhere, d)).max())
        for d in (1, -1)
    )
    return Carried(made, error, True)


def uniform_positions(
    table: CompensationTable,
    *,
    through: float | None = None,
    interval: float | None = None,
    quantum: float = 0.0,
    max_points: int,
    title: str,
) -> FloatArray:
    """Return positions of equal spacing that cover a table."""
    low, high = table.span
    span = high - low
    anchor = low if through is None else through
    own = span / (table.positions.size - 1)
    if interval is None and _is_grid(table.positions, own, anchor):
        interval = own
    elif interval is None:
        spare = 3 if through is not None else 1
        interval = max(float(np.diff(table.positions).min()), span / max(max_points - spare, 1))
        interval = span / math.ceil(span / interval) if not quantum else interval
        interval = math.ceil(interval / quantum - 1e-6) * quantum if quantum else interval
    if quantum and abs(interval / quantum - round(interval / quantum)) > 1e-6:
        raise TableError(
            f"{title}: the spacing {format_length(interval, digits=9)} is not a multiple of "
            f"{format_length(quantum)}; give interval= a multiple of it"
        )
    require_interval(interval, span, title)
    below = math.ceil((anchor - low) / interval - 1e-6)
    above = math.ceil((high - anchor) / interval - 1e-6)
    below, above = max(below, 0), max(above, 0)
    if below + above + 1 > max_points:
        raise LimitError(
            f"{below + above + 1} points at {format_length(interval, digits=6)}, {title} takes "
            f"{max_points}; give interval= at least {span / max(max_points - 3, 1) * 1e3:.4g} mm"
        )
    return np.asarray(anchor + interval * np.arange(-below, above + 1, dtype=np.float64))


def require_interval(interval: float, span: float, title: str) -> None:
    """Refuse a spacing that is larger than the table."""
    if interval > span * (1.0 + 1e-9):
        raise LimitError(
            f"{title}: interval={format_length(interval, digits=9)} is larger than the table, which "
            f"spans {format_length(span, digits=9)}; check the units of interval="
        )


def require_sizes(
    table: CompensationTable, title: str, *, farthest: float, largest: float
) -> None:
    """Refuse positions and corrections that no number of the format holds."""
    p = table.positions
    columns = [table.forward] if table.reverse is None else [table.forward, table.reverse]
    for what, values, most in (
        ("position", p, farthest),
        *(("correction", c, largest) for c in columns),
    ):
        worst = int(np.abs(values).argmax())
        if abs(float(values[worst])) > most:
            raise LimitError(
                f"{title}: the {what} {format_length(float(values[worst]))} of entry {worst} exceeds "
                f"{format_length(most)}; check the units of the table"
            )


def _is_grid(positions: FloatArray, spacing: float, anchor: float) -> bool:
    steps = (anchor - positions[0]) / spacing
    return is_uniform(positions) and abs(steps - round(steps)) <= _UNIFORM * positions.size


def require_one_direction(table: CompensationTable, title: str, way: str) -> None:
    """Refuse a table of two directions."""
    if table.reverse is not None:
        raise TableError(
            f"{title} holds one value for both directions and this table has two; make it with "
            f"direction='both' and enter the lost motion {way}"
        )


def require_on_axis(table: CompensationTable, title: str, instead: str) -> None:
    """Refuse a table that corrects another axis than it looks up."""
    if not table.is_on_axis:
        raise TableError(
            f"{title} shifts the axis whose position it looks up; this table is {table.axis} -> "
            f"{table.compensates} and would move {table.axis} instead of {table.compensates}; write "
            f"controller={instead}"
        )


def require_capacity(dialect: Dialect, n: int, given: Mapping[str, Any], path: Path) -> None:
    """Refuse a file of more points than the control takes."""
    option = next(o for o in dialect.options if o.name == "capacity")
    stored = sidecar_options(path, (option,))
    capacity = given.get("capacity") or stored.get("capacity") or option.default
    if n > capacity:
        raise LimitError(
            f"{path}: {n} points, the control takes {capacity} as it comes; if yours has room for "
            f"more ({option.help}), say capacity="
        )


def require_linear(axes: Iterable[str], title: str) -> None:
    """Refuse axes that turn."""
    for axis in axes:
        if is_rotary(axis):
            raise TableError(
                f"{title}: axis {axis} turns, this dialect writes lengths only; write "
                "controller='csv' and enter it by hand, in the unit of that axis"
            )


def require_zero(table: CompensationTable, reference: float, title: str) -> None:
    """Refuse a table that is not zero where the controller takes it to be."""
    there = float(table.correction(reference, 1)[0])
    if abs(there) > _SAME:
        raise TableError(
            f"{title} counts from the reference position {format_length(reference)}, where the "
            f"correction must be exactly 0 and is {format_length(there)}; make the reference "
            f"one of the positions: CompensationTable.from_error(..., positions=[..., "
            f"{reference:.9g}, ...], reference={reference:.9g})"
        )


def fixed(value: float, decimals: int) -> str:
    """Return a decimal without exponent, and without the sign of a zero."""
    text = f"{value:.{decimals}f}"
    return text[1:] if text.startswith("-") and not text.strip("-0.") else text


def mm_text(value: float | Decimal) -> str:
    """Return a length in mm, exact, without exponent."""
    number = value if isinstance(value, Decimal) else Decimal(repr(float(value)))
    text = format(number.scaleb(3), "f")
    text = text.rstrip("0").rstrip(".") if "." in text else text
    return "0" if text in ("-0", "") else text


def mm_value(text: str) -> float:
    """Return a length that is printed in mm."""
    return float(Decimal(text).scaleb(-3))


def ascii_lines(data: bytes, path: Path, what: str) -> list[str]:
    """Return the lines of a text, and refuse one that was cut."""
    try:
        text = data.decode("ascii")
    except UnicodeDecodeError as exc:
        raise CorruptFileError(
            path, "not ASCII text", offset=exc.start, hint=f"this is no {what}"
        ) from None
    if re.search(r"[^\t\r\n -~]|\r(?!\n)", text):
        raise CorruptFileError(path, "it holds control characters", hint=f"this is no {what}")
    if not text.endswith("\n"):
        raise CorruptFileError(
            path, "the last line has no end: the file was cut short", hint="write the table again"
        )
    return text.replace("\r\n", "\n").split("\n")[:-1]
