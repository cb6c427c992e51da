"""TwinCAT CNC / ISG kernel: compensation value lists (achskw*.lis), ``key value`` lines in 0.1 um (0.0001 deg).

Setpoints are in the unit of the axis that is looked up, values in that of the corrected one.

`IsgAxis`: leadscrew errors `kw.ssfk`, two columns; the documents calculate the entry as actual minus
setpoint, so k = +1 in entry = k e. `IsgCross`: `kw.crosscomp`, one column at free setpoints of a
master axis; "relative compensation values", so k = -1. Both signs must be tried on the machine.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from metrosep.compensation.area_errors import format_along, format_span, is_rotary
from metrosep.compensation.knots import choose_knots
from metrosep.compensation.maps import CompensationMap
from metrosep.compensation.table import CompensationTable
from metrosep.controllers._facts import agreed, named_axes, read_table, settled
from metrosep.controllers._grammar import (
    SIGN,
    Line,
    Word,
    ascii_lines,
    damaged,
    fixed,
    joined,
    require_rising,
)
from metrosep.controllers._grids import (
    DRY_RUN,
    Carried,
    Repeating,
    Resampling,
    carry,
    map_at,
    require_interval,
    require_one_direction,
    require_sizes,
    uniform_positions,
)
from metrosep.controllers.base import (
    DialectInfo,
    Encoded,
    identity,
    load_sidecar,
    map_identity,
    nearest_zero,
)
from metrosep.controllers.options import (
    INTERVAL,
    Option,
    axes_of,
    chosen,
    flag,
    in_axes,
    pick,
    require_turn,
    require_whole_turn,
    whole,
)
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, DataError, Example, LimitError, TableError
from metrosep.core.units import format_length

UNIT = 1e-7
"""Length of 1 in a list with unit 1, m."""
_DECIMALS = 6
"""Decimals of a REAL64 entry: 0.1 pm."""
_SGN32 = 2**31 - 1
MOST = 2.14e9
"""Units that 32 bits hold: 214 m or 214000 deg."""

_ENTRY = Line("{key} {value}", key=Word(r"[a-z]\w*(?:\.\w+(?:\[\d{1,7}\])*)+"), value=Word(r"\S+"))
_NAME = Word(r"[A-Za-z]\w{0,15}")
COUNT = Word(r"\d{1,7}", int)
REAL64 = Word(r"-?\d{1,10}(?:\.\d{1,12})?", float)
_COMMENT = re.compile(r"#|/\*")
_SIGN = Line(
    f"# metrosep: entry = {{entry_sign}}e in {{unit}}, {DRY_RUN}",
    entry_sign=SIGN,
    unit=Word(r"0\.1 um|0\.0001 deg"),
)

_AXIS_POINTS = 1499
"""Default of kw.ssfk.max_points less one: kw_nr_max must be smaller."""
_CROSS_POINTS = 1001
"""Default of kw.crosscomp.max_points: last_index must be smaller."""
AXIS_NUMBER = whole("axis_number", "logical number of the corrected axis", 1, 999, required=True)
NUMBER_TYPE = pick(
    "number_type",
    "whole numbers, or decimals (REAL64: builds from V3.1.3132 or V4.29 on)",
    ("integer", "real"),
    default="integer",
)


_ANGLE = math.radians(1e-4)
"""Angle of 1 in a list with unit 1, rad."""
_TURN = 3_600_000
"""Steps of one turn."""


def unit_of(axis: str) -> float:
    """Return what 1 in a list is along an axis, in m or rad."""
    return _ANGLE if is_rotary(axis) else UNIT


class CompensationList(Resampling):
    """A list: a head, settings in an order that the class declares, and cells of a table."""

    structure: ClassVar[str]
    settings: ClassVar[Mapping[str, Word | str]]
    """Key and word of each setting; a text is the only value that is read."""
    parameter: ClassVar[str]

    def _encoded(
        self,
        carried: Carried,
        name: str,
        options: Mapping[str, Any],
        settings: Mapping[str, object],
        cells: Iterable[tuple[str, str]],
        wanted: Iterable[tuple[list[str], FloatArray]],
    ) -> Encoded:
        """Return the bytes with what rounding costs: cells by their place, columns as they should be."""
        if not re.fullmatch(_NAME.pattern, name, re.ASCII):
            raise TableError(
                f"axis {name!r} is not a name for a list: letters, digits, underscores"
            )
        key = f"kw.{self.structure}"
        lines = [
            _SIGN.write(
                entry_sign=options["entry_sign"],
                unit="0.0001 deg" if is_rotary(name) else "0.1 um",
            ),
            f"kopf.achs_nr {options['axis_number']}",
            f"kopf.log_achs_name {name}",
            *(
                f"{key}.{k} {settings.get(k, w)}"
                for k, w in self.settings.items()
                if settings.get(k, w)
            ),
            *(f"{key}.table{place} {value}" for place, value in cells),
        ]
        unit = unit_of(name)
        off = max(
            float(np.abs(np.array([float(v) for v in column]) * unit - w).max())
            for column, w in wanted
        )
        return Encoded(
            joined(lines),
            off,
            step=unit if options["number_type"] == "integer" else 0.0,
            carried=carried.table,
            resampling_error=carried.error,
            options=chosen(self.options, options),
        )

    def _opened(
        self, data: bytes, path: Path, options: Mapping[str, Any]
    ) -> tuple[_Cells, dict[str, Any]]:
        """Return the cells of a list, and its head and settings, which fit what the user says."""
        entries, comment = _entries(data, path, options.get("number_type") == "integer")
        cells = _Cells(entries, f"kw.{self.structure}", path)
        found = {
            "axis_number": cells.take("kopf.achs_nr", COUNT),
            "name": cells.take("kopf.log_achs_name", _NAME),
        }
        for setting, word in self.settings.items():
            key = f"{cells.key}.{setting}"
            if setting in ("max_points", "modulo") and key not in entries:
                found[setting] = 0
                continue
            found[setting] = cells.take(key, COUNT if isinstance(word, str) else word)
            if isinstance(word, str) and str(found[setting]) != word:
                raise CorruptFileError(
                    path,
                    f"{key} is {found[setting]}",
                    expected=word,
                    found=found[setting],
                    hint="only lists in 0.1 um, and of leadscrews only bilateral ones, are read",
                )
        for option, n in self._numbers(found).items():
            if options.get(option) not in (None, n):
                raise CorruptFileError(
                    path,
                    f"the list of another axis ({option})",
                    expected=options[option],
                    found=n,
                    hint="choose the list of these axes; they must not be swapped",
                )
        cycles = {"cycles": found["n_cycles"]} if "n_cycles" in found else {}
        known = [o for o in self.options if o.name in ("entry_sign", "cycles")]
        needed = ("entry_sign",)
        sign = settled(known, options, path, file={**comment, **cycles}, needed=needed)
        return cells, {**found, "scale": -sign["entry_sign"] * unit_of(found["name"])}

    def _numbers(self, found: Mapping[str, Any]) -> dict[str, int]:
        """Return the numbers of axes in a list, by the options that state them."""
        return {"axis_number": found["axis_number"]}

    def _require_room(self, n: int, room: int, path: Path, what: str = "") -> None:
        if n > room:
            raise LimitError(
                f"{path}: {n} points, the kernel takes {room}, {what or self.parameter}; if yours has "
                "room for more, say capacity="
            )


class IsgAxis(Repeating, CompensationList):
    """Writer and reader of `kw.ssfk`; see the module."""

    info = DialectInfo(
        id="isg-axis",
        title="TwinCAT CNC / ISG leadscrew error compensation (kw.ssfk)",
        entry="error +e in 0.1 um, of an axis that turns in 0.0001 deg, one column for each direction",
        units="0.1 um or 0.0001 deg; whole numbers before V3.1.3132 / V4.29, decimals from there on",
        max_points=_AXIS_POINTS,
        outside="value of the end of the table",
        sign_status="the documents calculate actual minus setpoint (+e), but their example has the "
        "setpoint on the other side of zero: dry-run first",
        activation=(
            "put the list (achskw*.lis) into the start-up file or load it again",
            "set lr_param.ssfk 1 (P-AXIS-00175) in the list of the axis and home it",
            (
                "read the object 'LSEC::sum epsilon' at the bump of a trial table: it must have the sign "
                "that was meant, else say entry_sign=-1"
            ),
            "mind the messages of the start-up: a list that the kernel does not take is switched off",
            "where the list has max_points: restart the controller, it is read at start-up only",
        ),
        sign="unconfirmed",
        resolution="0.1 um, or 0.1 pm with REAL64",
        reference_rule="none; the axis must be referenced",
        suffix=".lis",
        example={"axis_number": 2},
        page="twincat",
    )

    options = (
        AXIS_NUMBER,
        NUMBER_TYPE,
        whole(
            "capacity",
            "most points; kw.ssfk.max_points (P-COMP-00059) less one",
            2,
            1_000_000,
            default=_AXIS_POINTS,
        ),
        INTERVAL,
        flag(
            "modulo",
            "kw.ssfk.modulo (P-COMP-00022): the table of 0 to 360 deg repeats, for an axis that turns on",
        ),
        pick("entry_sign", "k in entry = k e", (-1, 1), default=1),
    )

    structure = "ssfk"
    settings: ClassVar[Mapping[str, Word | str]] = {
        "max_points": COUNT, "interval": REAL64, "kw_startpos": REAL64, "kw_nr_max": COUNT,
        "unit": "1", "bilateral": "1", "modulo": COUNT,
    }  # fmt: skip
    parameter = "kw.ssfk.max_points (P-COMP-00059) less one"

    def encode(self, table: CompensationTable, **options: Any) -> Encoded:
        """Return a bilateral list, at equal spacing if the positions are, else with setpoints."""
        if not table.is_on_axis:
            raise TableError(
                f"kw.ssfk corrects the axis itself, this table is {table.axis} -> "
                f"{table.compensates}; write controller='isg-cross'"
            )
        options = in_axes(self.options, options, axes_of(table))
        unit = unit_of(table.axis)
        if options["modulo"]:
            table = require_turn(table, unit)
            require_whole_turn(options["interval"], "kw.ssfk")
        require_sizes(table, "kw.ssfk", farthest=MOST * unit, largest=MOST * unit)
        carried = placed(table, options, "kw.ssfk")
        made, kind, k = carried.table, options["number_type"], -options["entry_sign"]
        p = to_units(made.positions, kind, unit)
        wanted = [k * made.forward, k * (made.forward if made.reverse is None else made.reverse)]
        columns = [to_units(w, kind, unit) for w in wanted]
        step = _spacing(p, kind)
        more = options["capacity"] > _AXIS_POINTS
        settings = {
            "max_points": options["capacity"] + 1 if more else 0, "interval": step,
            "kw_startpos": p[0], "kw_nr_max": len(p), "modulo": int(options["modulo"]),
        }  # fmt: skip
        cells = [
            (f"[{i}].{field}", v)
            for field, column in zip(("setpoint", "pos", "neg"), (p, *columns), strict=True)
            for i, v in enumerate(column)
            if field != "setpoint" or step == "0"
        ]
        pairs = zip(columns, wanted, strict=True)
        return self._encoded(carried, table.axis, options, settings, cells, pairs)

    def _read(
        self, data: bytes, path: Path, options: Mapping[str, Any]
    ) -> tuple[CompensationTable, bool]:
        """Return the table, and whether it repeats."""
        cells, found = self._opened(data, path, options)
        n, step = found["kw_nr_max"], found["interval"]
        room = (found["max_points"] or options.get("capacity", _AXIS_POINTS) + 1) - 1
        self._require_room(n, room, path)
        if step == 0.0:
            p = cells.column("setpoint", n)
        else:
            p = np.asarray(found["kw_startpos"] + step * np.arange(n), dtype=np.float64)
        forward, reverse = (found["scale"] * cells.column(c, n) + 0.0 for c in ("pos", "neg"))
        cells.end()
        _require_rising(p, path)
        turns = is_rotary(found["name"])
        modulo = found["modulo"] == 1
        if found["modulo"] > 1 or (modulo and not turns):
            raise CorruptFileError(
                path,
                f"kw.ssfk.modulo is {found['modulo']} for the axis {found['name']}",
                hint="it is 0 or 1, and 1 only where the axis turns",
            )
        if modulo and (
            round(p[-1] - p[0]) != _TURN or forward[0] != forward[-1] or reverse[0] != reverse[-1]
        ):
            raise CorruptFileError(
                path,
                "a modulo list must cover one turn (3600000 steps of 0.0001 deg) with the first value "
                "equal to the last",
                hint="enter the value of 0 again at 360 deg",
            )
        unit = unit_of(found["name"])
        table = read_table(
            p * unit,
            forward,
            None if np.array_equal(forward, reverse) else reverse,
            **named_axes(identity(path), (found["name"],) * 2, path),
        )
        return table, modulo


class IsgCross(CompensationList):
    """Writer and reader of `kw.crosscomp`; see the module."""

    info = replace(
        IsgAxis.info,
        id="isg-cross",
        title="TwinCAT CNC / ISG cross compensation (kw.crosscomp)",
        entry="correction -e of the slave axis at a setpoint of the master axis, each in 0.1 um or, "
        "where that axis turns, in 0.0001 deg",
        max_points=_CROSS_POINTS,
        outside="not documented; taken as the value of the end, as for kw.ssfk",
        sign_status="not documented (relative compensation values): dry-run first",
        activation=(
            "put the list (achskw*.lis) of the slave axis into the start-up file or load it again",
            "set lr_param.crosscomp 1 (P-AXIS-00047) in the list of the slave axis, home the master",
            "switch on with the slave at rest (automatically, or X[COMP ON CROSS] in the program)",
            (
                "move the master over the bump of a trial table and gauge the slave: where it moves the "
                "wrong way, say entry_sign=1"
            ),
            "mind the messages of the start-up: a list that the kernel does not take is switched off",
            "where the list has max_points: restart the controller, it is read at start-up only",
        ),
        directions="one",
        reference_rule="none; the master must be referenced",
        example={"axis_number": 3, "master_number": 1},
    )

    options = (
        AXIS_NUMBER,
        whole(
            "master_number", "logical number of the axis that is looked up", 1, 999, required=True
        ),
        Option(
            "master_name",
            "name of that axis, to read a list without a sidecar; A, B, C turn",
            "text",
        ),
        NUMBER_TYPE,
        whole(
            "capacity",
            "most points; kw.crosscomp.max_points (P-COMP-00060)",
            2,
            1_000_000,
            default=_CROSS_POINTS,
        ),
        INTERVAL,
        whole("cycles", "n_cycles of smooth switching", 0, 1000, default=10),
        pick("entry_sign", "k in entry = k e", (-1, 1), default=-1),
    )

    structure = "crosscomp"
    settings: ClassVar[Mapping[str, Word | str]] = {
        "max_points": COUNT, "unit": "1", "last_index": COUNT, "master_ax_nr": COUNT,
        "n_cycles": COUNT,
    }  # fmt: skip
    parameter = "kw.crosscomp.max_points (P-COMP-00060)"

    def _numbers(self, found: Mapping[str, Any]) -> dict[str, int]:
        """Return the numbers of slave and master."""
        return {"axis_number": found["axis_number"], "master_number": found["master_ax_nr"]}

    def encode(self, table: CompensationTable, **options: Any) -> Encoded:
        options = in_axes(self.options, options, axes_of(table))
        table = require_one_direction(
            table, "kw.crosscomp", "as backlash of the slave or into kw.ssfk"
        )
        units = unit_of(table.axis), unit_of(table.compensates)
        require_sizes(table, "kw.crosscomp", farthest=MOST * units[0], largest=MOST * units[1])
        _require_two_axes(table, options)
        carried = placed(table, options, "kw.crosscomp")
        kind, room = options["number_type"], options["capacity"]
        wanted = -options["entry_sign"] * carried.table.forward
        p = to_units(carried.table.positions, kind, units[0])
        c = to_units(wanted, kind, units[1])
        settings = {
            "max_points": room if room > _CROSS_POINTS else 0, "last_index": str(len(p) - 1),
            "master_ax_nr": options["master_number"], "n_cycles": str(options["cycles"]),
        }  # fmt: skip
        cells = [
            (f"[{i}].{field}", v)
            for i, pair in enumerate(zip(p, c, strict=True))
            for field, v in zip(("setpoint", "correction"), pair, strict=True)
        ]
        made = self._encoded(carried, table.compensates, options, settings, cells, [(c, wanted)])
        return replace(made, options={**made.options, "master_name": table.axis})

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationTable:
        cells, found = self._opened(data, path, options)
        n, number = found["last_index"] + 1, found["axis_number"]
        room = found["max_points"] or options.get("capacity") or _CROSS_POINTS
        self._require_room(n, room, path)
        if found["master_ax_nr"] == number:
            raise CorruptFileError(
                path,
                f"axis {found['name']} has number {number}, and so has its master",
                hint="an axis that corrects itself has a list kw.ssfk",
            )
        p, c = (cells.column(field, n) for field in ("setpoint", "correction"))
        cells.end()
        _require_rising(p, path)
        fields = _fields(path, found["name"], options)
        return read_table(p * unit_of(fields["axis"]), found["scale"] * c + 0.0, **fields)


# ---- what is written ------------------------------------------------------------------------------


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
    unit = unit_of(table.axis)
    quantum = unit if options["number_type"] == "integer" else unit * 10.0**-_DECIMALS
    at = np.rint(positions / quantum) * quantum
    if (np.diff(at) <= 0).any():
        i = int(np.flatnonzero(np.diff(at) <= 0)[0])
        raise TableError(
            f"{title}: the positions {format_span(table.axis, positions[i], digits=9)} and "
            f"{format_span(table.axis, positions[i + 1], digits=9)} fall together at steps of "
            f"{format_along(table.axis, quantum)}; use a wider spacing"
        )
    if values is None:
        return carry(table, at)
    made = replace(table, positions=at, forward=values, u=None)
    everywhere = np.union1d(at, table.positions)
    error = np.abs(made.correction(everywhere) - table.correction(everywhere)).max()
    return Carried(made, float(error))


def to_units(values: FloatArray, kind: str, unit: float) -> list[str]:
    """Return lengths or angles as numbers of a list."""
    counts = np.asarray(values) / unit
    worst = float(counts[int(np.abs(counts).argmax())])
    if abs(worst) > _SGN32:
        raise LimitError(
            f"{worst:.6g} is beyond the 32 bits of a list in 0.1 um (214 m) or 0.0001 deg; check the "
            "units of the table"
        )
    return [_printed(float(c), kind) for c in counts]


def _printed(count: float, kind: str) -> str:
    return str(round(count)) if kind == "integer" else fixed(count, _DECIMALS)


def _spacing(positions: list[str], kind: str) -> str:
    """Return the interval of equally spaced positions, "0" if they are not."""
    p = np.array([float(v) for v in positions])
    step = _printed(float(p[-1] - p[0]) / (p.size - 1), kind)
    off = np.abs(p - (p[0] + float(step) * np.arange(p.size))).max()
    return step if off <= 1e-9 * abs(float(step)) + 10.0**-_DECIMALS else "0"


def _require_two_axes(table: CompensationTable, options: Mapping[str, Any]) -> None:
    if table.is_on_axis:
        raise TableError(
            f"kw.crosscomp corrects another axis than its master, this table is {table.axis} -> "
            f"{table.compensates}; write controller='isg-axis'"
        )
    if options["axis_number"] == options["master_number"]:
        raise TableError(
            f"the table is {table.axis} -> {table.compensates}, but axis_number and master_number are "
            f"the same ({options['axis_number']}); give those of two axes"
        )
    if options["master_name"] not in (None, table.axis):
        raise TableError(
            f"master_name={options['master_name']!r}, but the table is looked up over {table.axis}"
        )


# ---- what is read ---------------------------------------------------------------------------------


class _Cells:
    """Entries of a list, taken one by one until none is left."""

    def __init__(self, entries: dict[str, tuple[str, int]], key: str, path: Path) -> None:
        """Take value and line of each key."""
        self.entries, self.key, self.path = entries, key, path

    def take(self, key: str, word: Word) -> Any:
        """Return one entry."""
        if key not in self.entries:
            raise CorruptFileError(
                self.path,
                f"{key} is missing",
                hint="the kernel would use 0: write the table again",
            )
        text, line = self.entries.pop(key)
        if not re.fullmatch(word.pattern, text, re.ASCII):
            raise damaged(self.path, f"line {line}: {key} cannot be {text[:30]!r}")
        value = word.read(text)
        if isinstance(value, float) and abs(value) > _SGN32:
            raise damaged(self.path, f"{key} leaves 32 bits", found=value)
        return value

    def column(self, field: str, n: int, row: str = "") -> FloatArray:
        """Return one field of all points."""
        if n < 2 or n > len(self.entries):
            raise damaged(self.path, f"{n} points are announced, the list does not hold them")
        table = f"{self.key}.table{row}"
        return np.array([self.take(f"{table}[{i}].{field}", REAL64) for i in range(n)])

    def end(self) -> None:
        """Refuse entries that nobody asked for."""
        for key, (_, line) in self.entries.items():
            raise CorruptFileError(
                self.path,
                f"line {line}: {key} is not expected here",
                hint="it changes what the kernel does and is not read; remove it or correct the count",
            )


def _entries(
    data: bytes, path: Path, whole: bool
) -> tuple[dict[str, tuple[str, int]], dict[str, Any]]:
    """Return value and line of each key of a list, and what its comment states."""
    lines = ascii_lines(data, path, "compensation value list")
    text, comments = _without_comments("\n".join(lines), path)
    stated: dict[str, Any] = {}
    for line in comments:
        found = _SIGN.read(line)
        if found is None and line.startswith("# metrosep"):
            raise damaged(path, "the comment of the sign is damaged")
        sign = (found or {}).get("entry_sign")
        if sign is not None and stated.setdefault("entry_sign", sign) != sign:
            raise CorruptFileError(
                path,
                "two comments contradict each other about the sign of entries",
                hint="lists were put together: take them apart, or write the table again",
            )
    entries: dict[str, tuple[str, int]] = {}
    for i, line in enumerate(text.split("\n"), start=1):
        if not line.strip():
            continue
        entry = _ENTRY.read(" ".join(line.split()))
        if entry is None or entry["key"] in entries:
            raise CorruptFileError(
                path,
                f"line {i} is not an entry, or one that is there twice: {line.strip()[:60]!r}",
                hint="one 'key value' a line; comments behind # or in /* */",
            )
        if whole and "." in entry["value"]:
            raise CorruptFileError(
                path,
                f"line {i}: {entry['key']} {entry['value']} is not a whole number",
                hint="builds before V3.1.3132 / V4.29 cut it: write it with number_type='integer'",
            )
        entries[entry["key"]] = (entry["value"], i)
    return entries, stated


def _without_comments(text: str, path: Path) -> tuple[str, list[str]]:
    """Return the text with its lines as they were, and the comments behind #; one pass."""
    kept: list[str] = []
    comments: list[str] = []
    at = 0
    while (found := _COMMENT.search(text, at)) is not None:
        kept.append(text[at : found.start()])
        end = text.find("\n" if found[0] == "#" else "*/", found.end())
        if end < 0 and found[0] != "#":
            line = text.count("\n", 0, found.start()) + 1
            raise CorruptFileError(
                path,
                f"line {line}: the comment /* is not closed",
                hint="close it with */, or write the table again",
            )
        end = len(text) if end < 0 else end
        if found[0] == "#":
            comments.append(text[found.start() : end].strip())
            at = end
        else:
            kept.append("\n" * text.count("\n", found.start(), end))
            at = end + 2
    return "".join([*kept, text[at:]]), comments


def _fields(path: Path, slave: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return what the list cannot hold: the name of the master is that of sidecar or user."""
    fields = identity(path)
    master = options.get("master_name")
    beside = load_sidecar(path)
    if beside:
        agreed(path, "master_name", {"its sidecar": fields["axis"], "you": master})
        sources = {"the file": slave, "its sidecar": fields["compensates"]}
        agreed(path, "the corrected axis", sources)
    master = fields["axis"] if master is None else master
    if master == slave:
        raise DataError(
            f"{path}: the list corrects {slave} over another axis, and nothing states its name; give "
            "master_name="
        )
    return {**fields, "axis": master, "compensates": slave}


def _require_rising(positions: FloatArray, path: Path) -> None:
    hint = "sort the points; the kernel deselects such a list"
    require_rising(positions, path, "setpoint", hint, first=0)


# ---- plane compensation -------------------------------------------------------------------------
# TwinCAT CNC / ISG plane compensation `kw.crosscomp2`: one axis over two others, one interval for both.
#
# ``table[j][i].correction``, j counting the second master axis (rows, y), i the first (columns, x);
# "relative compensation values", so k = -1 in entry = k e, to be tried on the machine. Masters are
# linear; the slave may turn.

_POINTS, _PER_AXIS = 10201, 101
"""Room where max_points is not given: both last indices up to 100."""
_SAME = 1e-6
"""Share of the interval within which a position lies on the grid."""


class IsgPlane(CompensationList):
    """Writer and reader of `kw.crosscomp2`; see the module."""

    info = replace(
        IsgCross.info,
        id="isg-plane",
        title="TwinCAT CNC / ISG plane compensation (kw.crosscomp2)",
        entry="correction -e of the slave axis, in 0.1 um or 0.0001 deg if it turns, over two linear "
        "master axes",
        units="0.1 um, of a slave that turns 0.0001 deg; whole numbers before V3.1.3132 / V4.29, "
        "decimals from there on",
        max_points=_POINTS,
        outside="value of the edge: the last one stays valid",
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
        carries="map",
        spacing="uniform",
        reference_rule="none; both masters must be referenced",
        example={"axis_number": 3, "master1_number": 1, "master2_number": 2},
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
        _require_masters(table, options)
        kind = options["number_type"]
        quantum = UNIT if kind == "integer" else UNIT * 1e-6
        step = _interval(table, options["interval"], quantum)
        x, y = (_grid(p, step, quantum) for p in (table.x, table.y))
        reserved = _reserved(x.size, y.size, step, options["capacity"])
        same = x.size == table.x.size and y.size == table.y.size
        if same and max(np.abs(x - table.x).max(), np.abs(y - table.y).max()) <= 1e-12:
            carried = Carried(table, 0.0)
        else:
            carried = Carried(*map_at(table, x, y))
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
        number, axes = found["axis_number"], fields["axes"]
        fits = ((a == name) == (k == number) for a, k in zip(axes, masters, strict=True))
        if masters[0] == masters[1] or not all(fits):
            raise CorruptFileError(
                path,
                f"numbers and names of the axes do not fit: {masters[0]}, {masters[1]} -> {number} and "
                f"{axes[0]}, {axes[1]} -> {name}",
                hint="an axis has one number: write the table again",
            )
        return CompensationMap(
            x, y, found["scale"] * values + 0.0, is_exact_inverse=True, **fields
        )


def _require_masters(table: CompensationMap, options: Mapping[str, Any]) -> None:
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
        ).hinting(capacity=Example(str(n * m)))
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
