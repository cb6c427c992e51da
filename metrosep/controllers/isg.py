"""TwinCAT CNC / ISG kernel: compensation value lists (achskw*.lis) over one axis.

`IsgAxis`: leadscrew errors `kw.ssfk`, two columns; the documents calculate the entry as actual minus
setpoint, so k = +1 in entry = k e. `IsgCross`: `kw.crosscomp`, one column at free setpoints of a
master axis; "relative compensation values", so k = -1. Both signs must be tried on the machine.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from metrosep.compensation.knots import choose_knots
from metrosep.compensation.maps import CompensationMap
from metrosep.compensation.table import CompensationTable
from metrosep.controllers._grids import (
    DRY_RUN,
    Carried,
    Resampling,
    ascii_lines,
    carry,
    fixed,
    require_interval,
    require_linear,
    require_one_direction,
    require_sizes,
    uniform_positions,
)
from metrosep.controllers._notes import fact, named_axes, require_agreement
from metrosep.controllers.base import DialectInfo, Encoded, identity, load_sidecar
from metrosep.controllers.neutral import map_fields
from metrosep.controllers.options import Option
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, DataError, LimitError, TableError
from metrosep.core.units import format_length

__all__ = ["IsgAxis", "IsgCross"]


# ---- shared by the writers of the ISG dialects: lists of ``key value`` lines with comments, in units of 0.1 um ----

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


# ---- shared by the readers of the ISG dialects: entries of a list, taken one by one until none is left ----

Entries = dict[str, tuple[str, int]]

_LINE = re.compile(r"([a-z]\w*(?:\.\w+(?:\[\d{1,7}\])*)+)\s+(\S+)", re.ASCII)
_NUMBER = re.compile(r"-?\d{1,10}(?:\.\d{1,12})?")
_COMMENT = re.compile(r"#|/\*")
_WHOLE = re.compile(r"\d{1,7}")
_SIGN = re.compile(r"# metrosep: entry = ([+-])e in 0\.1 um, sign not documented.*")


def read_list(
    data: bytes, path: Path, options: Mapping[str, Any]
) -> tuple[Entries, dict[str, Any]]:
    """Return the entries of a list, and what its comment tells."""
    text, comments = _without_comments(
        "\n".join(ascii_lines(data, path, "compensation value list")), path
    )
    comment = _told(comments, path)
    entries: Entries = {}
    for i, line in enumerate(text.split("\n"), start=1):
        if not line.strip():
            continue
        found = _LINE.fullmatch(line.strip())
        if found is None or found[1] in entries:
            raise CorruptFileError(
                path,
                f"line {i} is no entry, or one that stands twice: {line.strip()[:60]!r}",
                hint="one 'key value' a line; comments behind # or in /* */",
            )
        entries[found[1]] = (found[2], i)
    if options.get("number_type") == "integer":
        _require_whole(entries, path)
    return entries, comment


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


def _told(comments: list[str], path: Path) -> dict[str, Any]:
    told: dict[str, Any] = {}
    for line in comments:
        found = _SIGN.fullmatch(line)
        if not found and line.startswith("# metrosep"):
            raise CorruptFileError(
                path, "the comment of the sign is damaged", hint="write it again"
            )
        if found and told.setdefault("entry_sign", 1 if found[1] == "+" else -1) != (
            1 if found[1] == "+" else -1
        ):
            raise CorruptFileError(
                path,
                "two comments contradict each other about the sign of entries",
                hint="lists were put together: take them apart, or write the table again",
            )
    return told


def _require_whole(entries: Entries, path: Path) -> None:
    for key, (word, line) in entries.items():
        if "." in word:
            raise CorruptFileError(
                path,
                f"line {line}: {key} {word} is no whole number",
                hint="builds before V3.1.3132 / V4.29 cut it: write it with number_type='integer'",
            )


def _taken(entries: Entries, key: str, pattern: re.Pattern[str], path: Path) -> str:
    if key not in entries:
        raise CorruptFileError(
            path, f"{key} is missing", hint="the kernel would use 0: write the table again"
        )
    word, line = entries.pop(key)
    if not pattern.fullmatch(word):
        raise CorruptFileError(path, f"line {line}: {key} cannot be {word[:30]!r}", hint="mend it")
    return word


def header(entries: Entries, options: Mapping[str, Any], path: Path) -> tuple[int, str]:
    """Return number and name of the corrected axis."""
    number = int(_taken(entries, "kopf.achs_nr", _WHOLE, path))
    if options.get("axis_number") not in (None, number):
        raise CorruptFileError(
            path,
            "the list of another axis",
            expected=options["axis_number"],
            found=number,
            hint="choose the list of this axis",
        )
    return number, _taken(entries, "kopf.log_achs_name", NAME, path)


def require_value(entries: Entries, key: str, allowed: set[str], path: Path) -> None:
    """Refuse an entry that is not one of some words."""
    word = _taken(entries, key, _WHOLE, path)
    if word not in allowed:
        raise CorruptFileError(
            path,
            f"{key} is {word}",
            expected=" or ".join(sorted(allowed)),
            found=word,
            hint="only lists in 0.1 um, and of leadscrews only bilateral ones, are read",
        )


def capacity_of(
    entries: Entries, structure: str, usual: int, given: Mapping[str, Any], path: Path
) -> int:
    """Return how many numbers a kernel has reserved for a list."""
    key = f"{structure}.max_points"
    reserved = whole(entries, key, path) if key in entries else 0
    return reserved or given.get("capacity") or usual


def require_room(n: int, room: int, what: str, path: Path) -> None:
    """Refuse a list of more points than the kernel takes."""
    if n > room:
        raise LimitError(
            f"{path}: {n} points, the kernel takes {room}, {what}; if yours has room for more, say "
            "capacity="
        )


def whole(entries: Entries, key: str, path: Path) -> int:
    """Return a count."""
    return int(_taken(entries, key, _WHOLE, path))


def real(entries: Entries, key: str, path: Path) -> float:
    """Return a number."""
    value = float(_taken(entries, key, _NUMBER, path))
    if abs(value) > SGN32:
        raise CorruptFileError(path, f"{key} leaves 32 bits", found=value, hint="mend it")
    return value


def column(entries: Entries, table: str, field: str, n: int, path: Path) -> FloatArray:
    """Return one field of all points."""
    if n < 2 or n > len(entries):
        raise CorruptFileError(
            path, f"{n} points are announced, the list does not hold them", hint="write it again"
        )
    return np.array([real(entries, f"{table}[{i}].{field}", path) for i in range(n)])


def no_more(entries: Entries, path: Path) -> None:
    """Refuse entries that nobody asked for."""
    for key, (_, line) in entries.items():
        raise CorruptFileError(
            path,
            f"line {line}: {key} is not expected here",
            hint="it changes what the kernel does and is not read; remove it or correct the count",
        )


def require_rising(positions: FloatArray, path: Path) -> None:
    """Refuse positions that do not rise."""
    falling = np.flatnonzero(np.diff(positions) <= 0)
    if falling.size:
        raise CorruptFileError(
            path,
            f"point {int(falling[0]) + 1}: the setpoint does not rise",
            hint="sort the points; the kernel deselects such a list",
        )


# ------------------------------------------------------------------------------------------------

_AXIS_POINTS = 1499
"""Default of kw.ssfk.max_points less one: kw_nr_max must be smaller."""
_CROSS_POINTS = 1001
"""Default of kw.crosscomp.max_points: last_index must be smaller."""


class IsgAxis(Resampling):
    """Writer and reader of `kw.ssfk`; see the module."""

    info = DialectInfo(
        id="isg-axis",
        title="TwinCAT CNC / ISG leadscrew error compensation (kw.ssfk)",
        entry="error +e in 0.1 um, one column for each direction",
        units="0.1 um; whole numbers before V3.1.3132 / V4.29, decimals from there on",
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
        Option(
            "capacity",
            "most points; kw.ssfk.max_points (P-COMP-00059) less one",
            "integer",
            default=_AXIS_POINTS,
            lowest=2,
            highest=1_000_000,
        ),
        INTERVAL,
        Option("entry_sign", "k in entry = k e", "choice", default=1, choices=(-1, 1)),
    )

    def encode(self, table: CompensationTable, **options: Any) -> Encoded:
        """Return a bilateral list, at equal spacing if the positions are, else with setpoints."""
        require_linear((table.axis, table.compensates), "kw.ssfk")
        require_sizes(table, "kw.ssfk", farthest=FARTHEST, largest=FARTHEST)
        if not table.is_on_axis:
            raise TableError(
                f"kw.ssfk corrects the axis itself, this table is {table.axis} -> "
                f"{table.compensates}; write controller='isg-cross'"
            )
        carried = placed(table, options, "kw.ssfk")
        kind = options["number_type"]
        k = -options["entry_sign"]
        p = to_units(carried.table.positions, kind)
        made = carried.table
        reverse = made.forward if made.reverse is None else made.reverse
        columns = [to_units(k * c, kind) for c in (made.forward, reverse)]
        step = spacing(p, kind)
        more = options["capacity"] > _AXIS_POINTS
        body = [
            *([f"kw.ssfk.max_points {options['capacity'] + 1}"] if more else []),
            f"kw.ssfk.interval {step}",
            f"kw.ssfk.kw_startpos {p[0]}",
            f"kw.ssfk.kw_nr_max {len(p)}",
            "kw.ssfk.unit 1",
            "kw.ssfk.bilateral 1",
        ]
        fields = zip(("setpoint", "pos", "neg"), (p, *columns), strict=True)
        for field, values in fields:
            if field != "setpoint" or step == "0":
                body += [f"kw.ssfk.table[{i}].{field} {v}" for i, v in enumerate(values)]
        lines = [*head_lines(table.axis, options), *body]
        return encoded(carried, [k * made.forward, k * reverse], columns, lines, kind)

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationTable:
        """Return the table."""
        entries, comment = read_list(data, path, options)
        sign = fact(self, "entry_sign", options, comment, path)
        _, name = header(entries, options, path)
        require_value(entries, "kw.ssfk.unit", {"1"}, path)
        require_value(entries, "kw.ssfk.bilateral", {"1"}, path)
        n = whole(entries, "kw.ssfk.kw_nr_max", path)
        room = capacity_of(entries, "kw.ssfk", _AXIS_POINTS + 1, _plus_one(options), path) - 1
        require_room(n, room, "kw.ssfk.max_points (P-COMP-00059) less one", path)
        interval = real(entries, "kw.ssfk.interval", path)
        start = real(entries, "kw.ssfk.kw_startpos", path)
        if interval == 0.0:
            p = column(entries, "kw.ssfk.table", "setpoint", n, path)
        else:
            p = np.asarray(start + interval * np.arange(n), dtype=np.float64)
        pos = column(entries, "kw.ssfk.table", "pos", n, path)
        neg = column(entries, "kw.ssfk.table", "neg", n, path)
        no_more(entries, path)
        require_rising(p, path)
        forward, reverse = (-sign * UNIT * c + 0.0 for c in (pos, neg))
        fields = identity(path, first=float(p[0] * UNIT))
        return CompensationTable(
            positions=p * UNIT,
            forward=forward,
            reverse=None if np.array_equal(forward, reverse) else reverse,
            is_exact_inverse=True,
            **named_axes(fields, (name, name), path),
        )


class IsgCross(Resampling):
    """Writer and reader of `kw.crosscomp`; see the module."""

    info = DialectInfo(
        id="isg-cross",
        title="TwinCAT CNC / ISG cross compensation (kw.crosscomp)",
        entry="correction -e of the slave axis in 0.1 um at a setpoint of the master axis",
        units="0.1 um; whole numbers before V3.1.3132 / V4.29, decimals from there on",
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
        sign="unconfirmed",
        directions="one",
        resolution="0.1 um, or 0.1 pm with REAL64",
        reference_rule="none; the master must be referenced",
        suffix=".lis",
        example={"axis_number": 3, "master_number": 1},
        page="twincat",
    )

    options = (
        AXIS_NUMBER,
        Option(
            "master_number",
            "logical number of the axis that is looked up",
            "integer",
            required=True,
            lowest=1,
            highest=999,
        ),
        Option("master_name", "name of that axis, to read a list without a sidecar", "text"),
        NUMBER_TYPE,
        Option(
            "capacity",
            "most points; kw.crosscomp.max_points (P-COMP-00060)",
            "integer",
            default=_CROSS_POINTS,
            lowest=2,
            highest=1_000_000,
        ),
        INTERVAL,
        Option("cycles", "n_cycles of smooth switching", "integer", 10, lowest=0, highest=1000),
        Option("entry_sign", "k in entry = k e", "choice", default=-1, choices=(-1, 1)),
    )

    def encode(self, table: CompensationTable, **options: Any) -> Encoded:
        """Return the list of the slave axis."""
        require_linear((table.axis, table.compensates), "kw.crosscomp")
        require_one_direction(table, "kw.crosscomp", "as backlash of the slave or into kw.ssfk")
        require_sizes(table, "kw.crosscomp", farthest=FARTHEST, largest=FARTHEST)
        _require_two_axes(table, options)
        carried = placed(table, options, "kw.crosscomp")
        kind = options["number_type"]
        k = -options["entry_sign"]
        room = options["capacity"]
        p, c = to_units(carried.table.positions, kind), to_units(k * carried.table.forward, kind)
        body = [
            *([f"kw.crosscomp.max_points {room}"] if room > _CROSS_POINTS else []),
            "kw.crosscomp.unit 1",
            f"kw.crosscomp.last_index {len(p) - 1}",
            f"kw.crosscomp.master_ax_nr {options['master_number']}",
            f"kw.crosscomp.n_cycles {options['cycles']}",
        ]
        for i, (a, b) in enumerate(zip(p, c, strict=True)):
            body += [
                f"kw.crosscomp.table[{i}].setpoint {a}",
                f"kw.crosscomp.table[{i}].correction {b}",
            ]
        lines = [*head_lines(table.compensates, options), *body]
        return encoded(carried, [k * carried.table.forward], [c], lines, kind)

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationTable:
        """Return the table."""
        entries, comment = read_list(data, path, options)
        sign = fact(self, "entry_sign", options, comment, path)
        number, name = header(entries, options, path)
        require_value(entries, "kw.crosscomp.unit", {"1"}, path)
        n = whole(entries, "kw.crosscomp.last_index", path) + 1
        room = capacity_of(entries, "kw.crosscomp", _CROSS_POINTS, options, path)
        require_room(n, room, "kw.crosscomp.max_points (P-COMP-00060)", path)
        master = whole(entries, "kw.crosscomp.master_ax_nr", path)
        if options.get("master_number") not in (None, master):
            raise CorruptFileError(
                path,
                "another master axis",
                expected=options["master_number"],
                found=master,
                hint="choose the list of this axis",
            )
        if master == number:
            raise CorruptFileError(
                path,
                f"axis {name} has number {number}, and so has its master",
                hint="an axis that corrects itself has a list kw.ssfk",
            )
        cycles = whole(entries, "kw.crosscomp.n_cycles", path)
        require_agreement(path, "cycles", ("the file", cycles), ("you", options.get("cycles")))
        p = column(entries, "kw.crosscomp.table", "setpoint", n, path)
        c = column(entries, "kw.crosscomp.table", "correction", n, path)
        no_more(entries, path)
        require_rising(p, path)
        return CompensationTable(
            positions=p * UNIT,
            forward=-sign * UNIT * c + 0.0,
            reverse=None,
            is_exact_inverse=True,
            **_fields(path, float(p[0] * UNIT), name, options),
        )


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


def _plus_one(options: Mapping[str, Any]) -> dict[str, Any]:
    capacity = options.get("capacity")
    return {} if capacity is None else {"capacity": capacity + 1}


def _fields(path: Path, first: float, slave: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return what the list cannot hold: the name of the master is that of sidecar or user."""
    told = bool(load_sidecar(path))
    fields = identity(path, first=first)
    master = options.get("master_name")
    if told:
        require_agreement(path, "master_name", ("its sidecar", fields["axis"]), ("you", master))
        require_agreement(
            path, "the corrected axis", ("the file", slave), ("its sidecar", fields["compensates"])
        )
    master = fields["axis"] if master is None else master
    if master == slave:
        raise DataError(
            f"{path}: the list corrects {slave} over another axis, and nothing tells its name; give "
            "master_name="
        )
    return {**fields, "axis": master, "compensates": slave}


# ---- twinCAT CNC / ISG kernel: plane compensation `kw.crosscomp2`, one axis over two others ----
# Entry: `table[j][i].correction` in 0.1 um, j counting the second master axis (rows, y), i the first
# (columns, x); "relative compensation values", so k = -1 in entry = k e. One interval serves both
# masters. The sign must be tried on the machine.

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
