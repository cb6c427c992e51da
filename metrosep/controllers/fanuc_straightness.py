"""Fanuc straightness compensation: four points, three straight segments, placed where they help most.

Entry: correction of the compensated axis at four of the pitch error points of the moving axis, in
detection units of the compensated axis: k e with k = -1. The sign is not documented in what could
be read and must be tried on the machine. What three segments cannot follow stays, and is reported.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.compensation.knots import choose_knots
from metrosep.compensation.rounding import round_entries
from metrosep.compensation.table import CompensationTable
from metrosep.controllers._facts import named_axes, settled
from metrosep.controllers._grammar import AXIS, MM, SIGN, Line, Text, Word, damaged
from metrosep.controllers._grids import (
    Resampling,
    require_linear,
    require_names,
    require_one_direction,
    require_sizes,
)
from metrosep.controllers.base import DialectInfo, Encoded, identity
from metrosep.controllers.fanuc import (
    ENTRY,
    FARTHEST,
    LAST_NUMBER,
    opened_file,
    parameter_file,
    require_axis_number,
)
from metrosep.controllers.options import Option, pick, unit_option, whole
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import LimitError, TableError
from metrosep.core.units import format_length

__all__ = ["FanucStraightness"]

_TITLE = "Fanuc straightness compensation"
_POINTS = 4
_LARGEST = 32767
_LAST_AXIS = 32

_HEAD = Line(
    "%(FANUC STRAIGHTNESS {axis} TO {compensates}, DETECTION UNIT {detection_unit} MM, POINTS EVERY "
    "{interval} MM, POINT {reference_number} AT {reference_position} MM, ENTRY = {entry_sign}E, "
    "{remark})",
    axis=AXIS,
    compensates=AXIS,
    detection_unit=MM,
    interval=MM,
    reference_position=MM,
    entry_sign=SIGN,
    remark=Word(r"[A-Z: -]+"),
)


class FanucStraightness(Resampling):
    """Writer and reader of parameters 5711 to 5784; see the module."""

    info = DialectInfo(
        id="fanuc-straightness",
        title=_TITLE,
        entry="correction -e of the compensated axis at a point, in its detection units",
        units="whole detection units of the compensated axis; numbers of pitch error points",
        max_points=_POINTS,
        outside="constant beyond the first and last point (not documented)",
        sign_status="neither sign nor file documented in what could be read: dry-run first",
        activation=(
            "set the pitch error points of the moving axis (3620, 3621, 3622, 3624); they may be 0",
            "note the old values of 5711 to 5784",
            "allow parameter writing (PWE) and read the file in, or type the numbers in",
            "switch the power off and on, then return both axes to their reference (G28)",
            "traverse the moving axis along a straightedge: the error must shrink, else entry_sign=1",
        ),
        sign="unconfirmed",
        spacing="free",
        directions="one",
        resolution="detection unit of the compensated axis",
        reference_rule="none: an offset of the polyline moves the zero of the compensated axis",
        suffix=".txt",
        example={"detection_unit": "100 nm", "interval": "5 mm", "reference_number": 40},
        page="fanuc",
    )

    options = (
        unit_option("detection_unit", "detection unit of the compensated axis"),
        Option(
            "interval",
            "spacing of the moving axis' pitch error points (3624)",
            "length",
            required=True,
            lowest=1e-9,
            highest=100.0,
        ),
        whole(
            "reference_number",
            "pitch error point of the moving axis' reference (3620)",
            0,
            LAST_NUMBER,
            required=True,
        ),
        Option("reference_position", "machine coordinate of that point", "length"),
        whole("moving_axis", "number of the moving axis", 1, _LAST_AXIS, default=1),
        whole("compensated_axis", "number of the compensated axis", 1, _LAST_AXIS, default=2),
        whole("set_number", "set of parameters, 1 for 5711", 1, 3, default=1),
        pick("entry_sign", "k in entry = k e", (-1, 1), default=-1),
    )

    def encode(self, table: CompensationTable, **options: Any) -> Encoded:
        """Return the parameters of four points."""
        require_linear((table.axis, table.compensates), _TITLE)
        table = require_one_direction(
            table, _TITLE, "into parameter 1851 (backlash) of the moving axis"
        )
        _require_axes(table, options)
        require_sizes(table, _TITLE, farthest=FARTHEST, largest=_LARGEST)
        zero = options["reference_position"]
        zero = table.reference if zero is None else zero
        step, unit, number = (
            options[n] for n in ("interval", "detection_unit", "reference_number")
        )
        steps, places = _grid(table, zero, step)
        x = np.union1d(table.positions, places[[0, -1]])
        knots = choose_knots(x, table.correction(x), _POINTS, grid=places)
        chosen = [int(steps[np.abs(places - p).argmin()]) for p in knots.positions]
        points = [number + s for s in chosen]
        if points[0] < 0 or points[-1] > LAST_NUMBER:
            raise LimitError(
                f"points {points[0]} to {points[-1]} leave 0 to {LAST_NUMBER}; check interval and "
                "reference_number"
            )
        rounded = round_entries(knots.values, unit)
        worst = int(np.abs(rounded.entries).argmax())
        if abs(int(rounded.entries[worst])) > _LARGEST:
            raise LimitError(
                f"the correction {format_length(float(knots.values[worst]))} at "
                f"{knots.positions[worst] * 1e3:.9g} mm exceeds {_LARGEST} detection units"
            )
        entries = [-options["entry_sign"] * int(v) for v in rounded.entries]
        carried = replace(
            table,
            positions=zero + step * np.array(chosen, dtype=np.float64),
            forward=knots.values,
            u=None if table.u is None else np.interp(knots.positions, table.positions, table.u),
        )
        values = [options["moving_axis"], options["compensated_axis"], *points, *entries]
        stated = {
            **options, "axis": table.axis, "compensates": table.compensates,
            "reference_position": zero,
        }  # fmt: skip
        words = zip(_numbers(options["set_number"]), values, strict=True)
        return Encoded(
            parameter_file(_HEAD, stated, [ENTRY.write(number=n, value=v) for n, v in words]),
            rounded.error,
            notes={"knots": knots.audit},
            step=unit,
            carried=carried,
            resampling_error=knots.residual,
        )

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationTable:
        """Return the polyline of four points."""
        text, head, _ = opened_file(data, path, _HEAD)
        axes, points, entries = _parameters(text)
        for name, found in zip(("moving_axis", "compensated_axis"), axes, strict=True):
            require_axis_number(path, name, options.get(name), found)
        known = settled(
            self.options, options, path, partial=True, file=head,
            needed=(
                "detection_unit", "interval", "reference_number", "reference_position", "entry_sign",
            ),
        )  # fmt: skip
        zero = known["reference_position"]
        fields = identity(path, first=zero)
        if head:
            fields = named_axes(fields, (head["axis"], head["compensates"]), path)
        return CompensationTable(
            zero + known["interval"] * (points - known["reference_number"]),
            -known["entry_sign"] * entries * known["detection_unit"] + 0.0,
            None,
            is_exact_inverse=True,
            **fields,
        )


def _require_axes(table: CompensationTable, options: Mapping[str, Any]) -> None:
    if table.is_on_axis:
        raise TableError(
            f"{_TITLE} corrects another axis than the moving one, this table is {table.axis} -> "
            f"{table.compensates}; write controller='fanuc'"
        )
    require_names(table, "Fanuc")
    if options["moving_axis"] == options["compensated_axis"]:
        raise TableError(
            f"moving_axis and compensated_axis are both {options['moving_axis']}: give the numbers of "
            "two axes"
        )


def _grid(
    table: CompensationTable, zero: float, step: float
) -> tuple[NDArray[np.int64], FloatArray]:
    """Return the pitch error points that cover the table: steps from the reference, positions."""
    low, high = ((p - zero) / step for p in table.span)
    first, last = math.floor(low + 1e-6), math.ceil(high - 1e-6)
    if last - first > LAST_NUMBER:
        raise LimitError(
            f"the table spans {last - first} intervals of {format_length(step)}, there are "
            f"{LAST_NUMBER}; check interval"
        )
    if last - first < _POINTS - 1:
        raise TableError(
            f"the table spans {last - first} intervals of {format_length(step)}, four points need "
            "three; use a finer interval of the pitch error points"
        )
    steps = np.arange(first, last + 1, dtype=np.int64)
    places = zero + step * steps
    # where a point is an entry of the table within rounding, take the very number of the entry
    p = table.positions
    right = np.clip(np.searchsorted(p, places), 1, p.size - 1)
    near = np.where(places - p[right - 1] < p[right] - places, p[right - 1], p[right])
    return steps, np.where(np.abs(near - places) <= 1e-6 * step, near, places)


def _numbers(set_number: int) -> list[int]:
    """Return the parameters of a set: moving axis, compensated axis, points, values."""
    s = set_number - 1
    return [
        5711 + s,
        5721 + s,
        *(5731 + 10 * s + i for i in range(_POINTS)),
        *(5761 + 10 * s + i for i in range(_POINTS)),
    ]


def _parameters(text: Text) -> tuple[tuple[int, int], NDArray[np.int64], NDArray[np.int64]]:
    """Return the two axes, the points and the entries of one set."""
    words = {number: row["value"] for number, row in text.table(ENTRY, "number").items()}
    wanted = next((n for n in map(_numbers, (1, 2, 3)) if set(n) == set(words)), None)
    if wanted is None:
        raise damaged(
            text.path,
            "the ten parameters of one set must be there, 5711, 5721, 5731 to 5734, 5761 to 5764",
            found=", ".join(map(str, sorted(words)))[:80],
        )
    values = np.array([words[n] for n in wanted], dtype=np.int64)
    points, entries = values[2:6], values[6:]
    axes = int(values[0]), int(values[1])
    if (
        axes[0] == axes[1]
        or not 1 <= min(axes) <= max(axes) <= _LAST_AXIS
        or (np.diff(points) <= 0).any()
        or (points < 0).any()
        or (points > LAST_NUMBER).any()
        or (np.abs(entries) > _LARGEST).any()
    ):
        raise damaged(
            text.path,
            "two axes, four rising points from 0 to 1023 and values up to 32767 are needed",
            found=", ".join(map(str, values.tolist())),
        )
    return axes, points, entries
