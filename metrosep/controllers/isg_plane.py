"""TwinCAT CNC / ISG kernel: plane compensation `kw.crosscomp2`, one axis over two others.

Entry: `table[j][i].correction` in 0.1 um, j counting the second master axis (rows, y), i the first
(columns, x); "relative compensation values", so k = -1 in entry = k e. One interval serves both
masters. The sign must be tried on the machine.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from metrosep.compensation.maps import CompensationMap
from metrosep.controllers._agreement import fact, require_agreement
from metrosep.controllers._increments import (
    Carried,
    Resampling,
    require_interval,
    require_linear,
)
from metrosep.controllers._isg_lists import (
    AXIS_NUMBER,
    FARTHEST,
    NUMBER_TYPE,
    UNIT,
    encoded,
    head_lines,
    to_units,
)
from metrosep.controllers._isg_reading import (
    capacity_of,
    header,
    no_more,
    read_list,
    real,
    require_room,
    require_value,
    whole,
)
from metrosep.controllers.base import DialectInfo, Encoded, load_sidecar
from metrosep.controllers.neutral_map import map_fields
from metrosep.controllers.options import Option
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, LimitError, TableError
from metrosep.core.units import format_length

__all__ = ["IsgPlane"]


_POINTS, _PER_AXIS = 10201, 101
"""Room where max_points is not given: both last indices up to 100."""
_SAME = 1e-6
"""Share of the interval within which a position lies on the grid."""


class IsgPlane(Resampling):
    """Writer and reader of `kw.crosscomp2`; see the module."""

    info = DialectInfo(
        id="isg-plane",
        title="TwinCAT CNC / ISG plane compensation (kw.crosscomp2)",
        entry="correction -e of the slave axis in 0.1 um over two master axes",
        units="0.1 um; whole numbers before V3.1.3132 / V4.29, decimals from there on",
        max_points=_POINTS,
        outside="value of the edge: the last one stays valid",
        sign_status="not documented (relative compensation values): dry-run first",
        activation=(
            "put the list (achskw*.lis) of the slave axis into the start-up file or load it again",
            "set lr_param.crosscomp2 1 (P-AXIS-00174) in the list of the slave axis, home both masters",
            "switch on with the slave at rest (automatically, or X[COMP ON PLANE] in the program)",
            (
                "move to the bump of a trial map and gauge the slave: where it moves the wrong way, say "
                "entry_sign=1; go to two corners too, the indices must not be swapped"
            ),
            (
                "70182 and 70183 stop the axis (no such master, no list), 70184 is a master that is "
                "not linear: the compensation is off in all three"
            ),
            "where the list has max_points: restart the controller, it is read at start-up only",
        ),
        sign="unconfirmed",
        carries="map",
        spacing="uniform",
        directions="one",
        resolution="0.1 um, or 0.1 pm with REAL64",
        reference_rule="none; both masters must be referenced",
        suffix=".lis",
        example={"axis_number": 3, "master1_number": 1, "master2_number": 2},
        page="twincat",
    )

    options = (
        AXIS_NUMBER,
        *(
            Option(
                f"master{i}_number",
                f"logical number of the {which} axis that is looked up",
                "integer",
                required=True,
                lowest=1,
                highest=999,
            )
            for i, which in ((1, "first (columns)"), (2, "second (rows)"))
        ),
        NUMBER_TYPE,
        Option(
            "capacity",
            "room for points, written as kw.crosscomp2.max_points (P-COMP-00061, builds from "
            "V3.1.3079.06 on); without it 101 along each axis",
            "integer",
            lowest=4,
            highest=9_999_999,
        ),
        Option(
            "interval",
            "spacing of both axes; the finest if omitted",
            "length",
            positive=True,
            highest=100.0,
        ),
        Option("cycles", "n_cycles of smooth switching", "integer", 10, lowest=0, highest=1000),
        Option("entry_sign", "k in entry = k e", "choice", default=-1, choices=(-1, 1)),
    )

    def encode(self, table: CompensationMap, **options: Any) -> Encoded:
        """Return the list of the slave axis."""
        _require_axes(table, options)
        kind = options["number_type"]
        quantum = UNIT if kind == "integer" else UNIT * 1e-6
        step = _interval(table, options["interval"], quantum)
        x, y = (_grid(p, step, quantum) for p in (table.x, table.y))
        reserved = _reserved(x.size, y.size, step, options["capacity"])
        carried = _carried(table, x, y)
        k = -options["entry_sign"]
        wanted = k * carried.table.values
        entries = to_units(wanted.ravel(), kind)
        body = [
            *([f"kw.crosscomp2.max_points {reserved}"] if reserved else []),
            "kw.crosscomp2.unit 1",
            f"kw.crosscomp2.interval {to_units(np.array([step]), kind)[0]}",
            f"kw.crosscomp2.last_index_master1 {x.size - 1}",
            f"kw.crosscomp2.last_index_master2 {y.size - 1}",
            f"kw.crosscomp2.start_position_master1 {to_units(x, kind)[0]}",
            f"kw.crosscomp2.start_position_master2 {to_units(y, kind)[0]}",
            f"kw.crosscomp2.master1_ax_nr {options['master1_number']}",
            f"kw.crosscomp2.master2_ax_nr {options['master2_number']}",
            f"kw.crosscomp2.n_cycles {options['cycles']}",
        ]
        body += [
            f"kw.crosscomp2.table[{n // x.size}][{n % x.size}].correction {v}"
            for n, v in enumerate(entries)
        ]
        lines = [*head_lines(table.compensates, options), *body]
        return encoded(carried, [wanted.ravel()], [entries], lines, kind)

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationMap:
        """Return the map."""
        entries, comment = read_list(data, path, options)
        sign = fact(self, "entry_sign", options, comment, path)
        number, name = header(entries, options, path)
        key = "kw.crosscomp2."
        require_value(entries, f"{key}unit", {"1"}, path)
        step = real(entries, f"{key}interval", path)
        n, m = (whole(entries, f"{key}last_index_master{i}", path) + 1 for i in (1, 2))
        room = capacity_of(entries, "kw.crosscomp2", 0, options, path)
        require_room(n * m, room or _POINTS, "kw.crosscomp2.max_points (P-COMP-00061)", path)
        if not room:
            require_room(max(n, m), _PER_AXIS, "along an axis without max_points", path)
        starts = [real(entries, f"{key}start_position_master{i}", path) for i in (1, 2)]
        masters = [whole(entries, f"{key}master{i}_ax_nr", path) for i in (1, 2)]
        for i in (1, 2):
            if options.get(f"master{i}_number") not in (None, masters[i - 1]):
                raise CorruptFileError(
                    path,
                    f"another master axis {i}",
                    expected=options[f"master{i}_number"],
                    found=masters[i - 1],
                    hint="choose the list of these axes; the two must not be swapped",
                )
        cycles = whole(entries, f"{key}n_cycles", path)
        require_agreement(path, "cycles", ("the file", cycles), ("you", options.get("cycles")))
        if step <= 0.0 or n < 2 or m < 2 or n * m > len(entries):
            raise CorruptFileError(
                path,
                f"{m} x {n} points every {step:g} are announced, the list does not hold them",
                hint="write the table again",
            )
        values = np.array(
            [
                [real(entries, f"{key}table[{j}][{i}].correction", path) for i in range(n)]
                for j in range(m)
            ]
        )
        no_more(entries, path)
        x, y = (
            np.asarray((start + step * np.arange(k)) * UNIT, dtype=np.float64)
            for start, k in zip(starts, (n, m), strict=True)
        )
        fields = map_fields(path, x, y)
        if load_sidecar(path):
            told = ("its sidecar", fields["compensates"])
            require_agreement(path, "the corrected axis", ("the file", name), told)
        _require_numbers(path, fields["axes"], name, masters, number)
        return CompensationMap(
            x,
            y,
            -sign * UNIT * values + 0.0,
            is_exact_inverse=True,
            **{**fields, "compensates": name},
        )


def _require_axes(table: CompensationMap, options: Mapping[str, Any]) -> None:
    require_linear((*table.axes, table.compensates), "kw.crosscomp2")
    farthest = max(float(np.abs(v).max()) for v in (table.x, table.y, table.values))
    if farthest > FARTHEST:
        raise LimitError(
            f"kw.crosscomp2: {format_length(farthest)} is beyond the 32 bits of a list in 0.1 um "
            "(214 m); check the units of the map"
        )
    numbers = [options[n] for n in ("axis_number", "master1_number", "master2_number")]
    if numbers[1] == numbers[2]:
        raise TableError(f"both master axes have the number {numbers[1]}; give those of two axes")
    for i, name in enumerate(table.axes, start=1):
        if (numbers[0] == numbers[i]) != (name == table.compensates):
            raise TableError(
                f"the map is {table.axes[0]}, {table.axes[1]} -> {table.compensates}, the numbers "
                f"{numbers[1]}, {numbers[2]} -> {numbers[0]} do not say the same"
            )


def _require_numbers(
    path: Path, axes: tuple[str, str], name: str, masters: list[int], number: int
) -> None:
    if masters[0] == masters[1] or any(
        (a == name) != (m == number) for a, m in zip(axes, masters, strict=True)
    ):
        raise CorruptFileError(
            path,
            f"numbers and names of the axes do not fit: {masters[0]}, {masters[1]} -> {number} and "
            f"{axes[0]}, {axes[1]} -> {name}",
            hint="an axis has one number: write the table again",
        )


def _reserved(n: int, m: int, step: float, capacity: int | None) -> int:
    """Return max_points of the list, 0 if what every kernel has is enough."""
    if n * m > (capacity or _POINTS) or (capacity is None and max(n, m) > _PER_AXIS):
        room = str(capacity or f"{_PER_AXIS} along each axis as it comes")
        raise LimitError(
            f"{n} x {m} points at {format_length(step)}, kw.crosscomp2 takes {room}; give a larger "
            f"interval= (one for both axes), or, from V3.1.3079.06 on, say capacity={n * m}: it is "
            "written as max_points (P-COMP-00061)"
        )
    needed = capacity is not None and (capacity > _POINTS or max(n, m) > _PER_AXIS)
    return capacity or 0 if needed else 0


def _interval(table: CompensationMap, wanted: float | None, quantum: float) -> float:
    step = min(float(np.diff(p).min()) for p in (table.x, table.y)) if wanted is None else wanted
    counts = round(step / quantum)
    if counts < 1 or (wanted is not None and abs(wanted / quantum - counts) > _SAME):
        raise TableError(
            f"the interval {format_length(step, digits=9)} is no multiple of {format_length(quantum)}, "
            "the step of a position in the list; give interval= a multiple of it"
        )
    for p in (table.x, table.y):
        require_interval(counts * quantum, float(p[-1] - p[0]), "kw.crosscomp2")
    return counts * quantum


def _grid(positions: FloatArray, step: float, quantum: float) -> FloatArray:
    """Return positions from the first on that cover all of them."""
    start = math.floor(float(positions[0]) / quantum + _SAME) * quantum
    n = math.ceil((float(positions[-1]) - start) / step - _SAME) + 1
    if n > 10_000_000:
        raise LimitError(f"{n} points at {format_length(step)}; give a larger interval=")
    return np.asarray(start + step * np.arange(max(n, 2)), dtype=np.float64)


def _carried(table: CompensationMap, x: FloatArray, y: FloatArray) -> Carried:
    """Return the map on the grid; two bilinear maps differ most at a node of one of them."""
    margin = 1e-12
    same = x.size == table.x.size and y.size == table.y.size
    if same and max(np.abs(x - table.x).max(), np.abs(y - table.y).max()) <= margin:
        return Carried(table, 0.0, False)
    made = replace(table, x=x, y=y, values=table.correction(x, y[:, None]), u=None)
    px, py = np.union1d(x, table.x), np.union1d(y, table.y)[:, None]
    error = float(np.abs(made.correction(px, py) - table.correction(px, py)).max())
    return Carried(made, error, True)
