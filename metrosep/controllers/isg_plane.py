"""TwinCAT CNC / ISG plane compensation `kw.crosscomp2`: one axis over two others, one interval for both.

``table[j][i].correction``, j counting the second master axis (rows, y), i the first (columns, x);
"relative compensation values", so k = -1 in entry = k e, to be tried on the machine. Masters are
linear; the slave may turn.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from metrosep.compensation.area_errors import is_rotary
from metrosep.compensation.maps import CompensationMap
from metrosep.controllers._facts import agreed
from metrosep.controllers._grammar import Word, damaged
from metrosep.controllers._grids import Carried, map_at, require_interval
from metrosep.controllers.base import DialectInfo, Encoded, map_identity, nearest_zero
from metrosep.controllers.isg import (
    AXIS_NUMBER,
    COUNT,
    MOST,
    NUMBER_TYPE,
    REAL64,
    UNIT,
    CompensationList,
    to_units,
    unit_of,
)
from metrosep.controllers.options import Option, pick, whole
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, LimitError, TableError
from metrosep.core.units import format_length

__all__ = ["IsgPlane"]

_POINTS, _PER_AXIS = 10201, 101
"""Room where max_points is not given: both last indices up to 100."""
_SAME = 1e-6
"""Share of the interval within which a position lies on the grid."""


class IsgPlane(CompensationList):
    """Writer and reader of `kw.crosscomp2`; see the module."""

    info = DialectInfo(
        id="isg-plane",
        title="TwinCAT CNC / ISG plane compensation (kw.crosscomp2)",
        entry="correction -e of the slave axis, in 0.1 um or 0.0001 deg if it turns, over two linear "
        "master axes",
        units="0.1 um, of a slave that turns 0.0001 deg; whole numbers before V3.1.3132 / V4.29, "
        "decimals from there on",
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
            whole(
                f"master{i}_number",
                f"logical number of the {which} axis that is looked up",
                1,
                999,
                required=True,
            )
            for i, which in ((1, "first (columns)"), (2, "second (rows)"))
        ),
        NUMBER_TYPE,
        whole(
            "capacity",
            "room for points, written as kw.crosscomp2.max_points (P-COMP-00061, builds from "
            "V3.1.3079.06 on); without it 101 along each axis",
            4,
            9_999_999,
        ),
        Option(
            "interval",
            "spacing of both axes; the finest if omitted",
            "length",
            positive=True,
            highest=100.0,
        ),
        whole("cycles", "n_cycles of smooth switching", 0, 1000, default=10),
        pick("entry_sign", "k in entry = k e", (-1, 1), default=-1),
    )

    structure = "crosscomp2"
    settings: ClassVar[Mapping[str, Word | str]] = {
        "max_points": COUNT, "unit": "1", "interval": REAL64, "last_index_master1": COUNT,
        "last_index_master2": COUNT, "start_position_master1": REAL64,
        "start_position_master2": REAL64, "master1_ax_nr": COUNT, "master2_ax_nr": COUNT,
        "n_cycles": COUNT,
    }  # fmt: skip
    parameter = "kw.crosscomp2.max_points (P-COMP-00061)"

    def _numbers(self, found: Mapping[str, Any]) -> dict[str, int]:
        """Return the numbers of slave and masters."""
        masters = {f"master{i}_number": found[f"master{i}_ax_nr"] for i in (1, 2)}
        return {"axis_number": found["axis_number"], **masters}

    def encode(self, table: CompensationMap, **options: Any) -> Encoded:
        _require_axes(table, options)
        kind = options["number_type"]
        quantum = UNIT if kind == "integer" else UNIT * 1e-6
        step = _interval(table, options["interval"], quantum)
        x, y = (_grid(p, step, quantum) for p in (table.x, table.y))
        reserved = _reserved(x.size, y.size, step, options["capacity"])
        same = x.size == table.x.size and y.size == table.y.size
        if same and max(np.abs(x - table.x).max(), np.abs(y - table.y).max()) <= 1e-12:
            carried = Carried(table, 0.0, False)
        else:
            carried = Carried(*map_at(table, x, y), True)
        wanted = (-options["entry_sign"] * carried.table.values).ravel()
        entries = to_units(wanted, kind, unit_of(table.compensates))
        settings = {
            "max_points": reserved, "interval": to_units(np.array([step]), kind, UNIT)[0],
            "last_index_master1": x.size - 1, "last_index_master2": y.size - 1,
            "start_position_master1": to_units(x, kind, UNIT)[0],
            "start_position_master2": to_units(y, kind, UNIT)[0],
            "master1_ax_nr": options["master1_number"], "master2_ax_nr": options["master2_number"],
            "n_cycles": str(options["cycles"]),
        }  # fmt: skip
        cells = [(f"[{n // x.size}][{n % x.size}].correction", v) for n, v in enumerate(entries)]
        columns = [(entries, wanted)]
        return self._encoded(carried, table.compensates, options, settings, cells, columns)

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationMap:
        cells, found = self._opened(data, path, options)
        step, name = found["interval"], found["name"]
        n, m = (found[f"last_index_master{i}"] + 1 for i in (1, 2))
        room = found["max_points"] or options.get("capacity") or 0
        self._require_room(n * m, room or _POINTS, path)
        if not room:
            self._require_room(max(n, m), _PER_AXIS, path, "along an axis without max_points")
        if step <= 0.0 or n < 2 or m < 2 or n * m > len(cells.entries):
            raise damaged(
                path, f"{m} x {n} points every {step:g} are announced, the list does not hold them"
            )
        values = np.array([cells.column("correction", n, f"[{j}]") for j in range(m)])
        cells.end()
        x, y = (
            np.asarray(
                (found[f"start_position_master{i}"] + step * np.arange(k)) * UNIT, dtype=np.float64
            )
            for i, k in ((1, n), (2, m))
        )
        fields = map_identity(
            path, axes=("X", "Y"), compensates=name, first=nearest_zero(x, y), turns=(False, False)
        )
        sources = {"the file": name, "its sidecar": fields["compensates"]}
        agreed(path, "the corrected axis", sources)
        masters = [found[f"master{i}_ax_nr"] for i in (1, 2)]
        _require_numbers(path, fields["axes"], name, masters, found["axis_number"])
        return CompensationMap(
            x, y, found["scale"] * values + 0.0, is_exact_inverse=True, **fields
        )


def _require_axes(table: CompensationMap, options: Mapping[str, Any]) -> None:
    turning = [axis for axis in table.axes if is_rotary(axis)]
    if turning:
        raise TableError(
            f"kw.crosscomp2: the master axis {turning[0]} turns, and the kernel switches plane "
            "compensation off where a master is not linear (70184); write controller='isg-cross' over it"
        )
    farthest = max(float(np.abs(v).max()) for v in (table.x, table.y))
    if farthest > MOST * UNIT:
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
            f"the interval {format_length(step, digits=9)} is not a multiple of {format_length(quantum)}, "
            "the step of a position in the list; give interval= a multiple of it"
        )
    for p in (table.x, table.y):
        require_interval(counts * quantum, float(p[-1] - p[0]), "kw.crosscomp2", table.axes[0])
    return counts * quantum


def _grid(positions: FloatArray, step: float, quantum: float) -> FloatArray:
    """Return positions from the first on that cover all of them."""
    start = math.floor(float(positions[0]) / quantum + _SAME) * quantum
    n = math.ceil((float(positions[-1]) - start) / step - _SAME) + 1
    if n > 10_000_000:
        raise LimitError(f"{n} points at {format_length(step)}; give a larger interval=")
    return np.asarray(start + step * np.arange(max(n, 2)), dtype=np.float64)


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
