"""Fanuc stored pitch error compensation: parameters 3620 to 3627 and one increment per section.

Entry: increment of the correction over a section, walked in + direction, in detection units times
the magnification: k (e(upper) - e(lower)) with k = -1. The layout is that of the parameter manual
of the Series 0i (3620 to 3625) and of report A-77810E (3605, 3626, 3627: a list for each direction);
the sign is not written there and must be tried on the machine. A table of one turn of an axis that
turns starts at the reference point, whose number gets the value of the last one; its increments have
the sum 0.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.compensation.area_errors import format_along, is_rotary
from metrosep.compensation.knots import choose_knots
from metrosep.compensation.limits import Finding
from metrosep.compensation.rounding import round_entries
from metrosep.compensation.table import CompensationTable
from metrosep.controllers._facts import letter_in_file, named_axes, own_axis, read_table, settled
from metrosep.controllers._grammar import (
    AXIS,
    DEG,
    INTEGER,
    MM,
    SIGN,
    Line,
    Text,
    Word,
    ascii_lines,
    damaged,
    joined,
)
from metrosep.controllers._grids import (
    DRY_RUN,
    Repeating,
    Resampling,
    Sections,
    require_capacity,
    require_increments,
    require_linear,
    require_names,
    require_on_axis,
    require_one_direction,
    require_sizes,
    sections,
    walked,
)
from metrosep.controllers.base import DialectInfo, Encoded, identity
from metrosep.controllers.options import (
    INCREMENT,
    INTERVAL,
    AlongOption,
    Option,
    axes_of,
    chosen,
    flag,
    in_axes,
    is_one_turn,
    pick,
    require_turn,
    require_whole_turn,
    unit_along,
    unit_option,
    whole,
)
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, LimitError, TableError
from metrosep.core.units import format_length

IntArray = NDArray[np.int64]

_TITLE = "Fanuc pitch error compensation"
LAST_NUMBER = 1023
_POINT = 10_000
"""Number of the file's word for point 0."""
_BLOCKS_PER_MINUTE = 7500.0
"""Feed over smallest interval, 1/min (parameter manual, metric)."""

_PARAMETERS = {
    "number": 3620, "first": 3621, "last": 3622, "magnification": 3623, "steps": 3624
}  # fmt: skip
_WAYS, _TURN, _BACK, _LOST = 3605, 3625, 3626, 3627
"""Bit 0: a list for each direction; travel of one turn; first point of the list for travel in - direction; lost motion at the reference."""
_MOST_LOST = 32767
"""Largest lost motion in detection units: what two bytes hold; its range is not in what could be read."""
_LEAST = {False: 1e-6, True: math.radians(1e-3)}
"""Least input increment of increment system B, of a linear axis and of one that turns."""


def _head(unit: str, word: Word) -> Line:
    """Return the comment of a file in mm or in degrees."""
    return Line(
        f"%(FANUC PITCH ERROR, DETECTION UNIT {{detection_unit}} {unit}, INCREMENT {{increment}} {unit}, "
        f"REFERENCE {{reference_position}} {unit}, ENTRY = {{entry_sign}}E, {{remark}})",
        detection_unit=word,
        increment=word,
        reference_position=word,
        entry_sign=SIGN,
        remark=Word(r"[A-Z: -]+"),
    )


_HEAD, _HEAD_TURNS = _head("MM", MM), _head("DEG", DEG)
_OF_AXES = Word(
    r"(?:A\d{1,2}P-?\d{1,9})+",
    lambda text: {int(a): int(v) for a, v in re.findall(r"A(\d+)P(-?\d+)", text)},
    lambda values: "".join(f"A{a}P{v}" for a, v in values.items()),
)
_PARAMETER = Line("N{number}{values}", values=_OF_AXES)
"""A parameter; the output of a control has all axes in a line, with or without blanks between them."""
ENTRY = Line("N{number}P{value}", value=INTEGER)


def parameter_file(head: Line, stated: Mapping[str, Any], lines: list[str]) -> bytes:
    """Return a file of parameters; the control skips the comment behind the first %."""
    return joined(
        [head.write(**stated, remark=f"{DRY_RUN.upper()} - MADE BY METROSEP"), *lines, "%"]
    )


def opened_file(data: bytes, path: Path, *heads: Line) -> tuple[Text, dict[str, Any], Line | None]:
    """Return the lines of a file of parameters, what its comment states, and which comment that is."""
    lines = ascii_lines(data, path, "Fanuc parameter file")
    if len(lines) < 3 or not lines[0].startswith("%") or lines[-1] != "%":
        raise damaged(path, "a parameter file begins and ends with %")
    head = next((h for h in heads if h.read(lines[0])), None)
    if head is None and lines[0].startswith("%(FANUC"):
        raise damaged(path, "line 1: the comment is damaged")
    rows = list(enumerate(lines, start=1))[1:-1]
    stated = head.read(lines[0]) if head else None
    return Text(path, rows, "Fanuc parameter file"), stated or {}, head


def require_axis_number(path: Path, name: str, wanted: int | None, found: int) -> None:
    """Refuse parameters of another axis than the one that was asked for."""
    if wanted not in (None, found):
        raise CorruptFileError(
            path, "the parameters are those of another axis", field=name, expected=wanted,
            found=found, hint="choose the file of this axis",
        )  # fmt: skip


class Fanuc(Repeating, Resampling):
    """Writer and reader of pitch error data; see the module."""

    info = DialectInfo(
        id="fanuc",
        title=_TITLE,
        entry="increment over a section, walked in + direction: -(e(upper) - e(lower)) in "
        "detection units times magnification",
        units="whole detection units times magnification (3623); interval in input increments; of an "
        "axis that turns both are angles",
        max_points=128,
        outside="constant beyond both extreme points: no more increments are output; a table of one "
        "turn repeats",
        sign_status="layout documented, sign not: dry-run on the machine first",
        activation=(
            "note the old values of 3605, 3620 to 3627 and of the points",
            "allow parameter writing (PWE) and read the file in, or type the numbers in",
            (
                "a list for each direction (bidirectional=True): set bit 0 of 3605 to 1 by hand, the file "
                "leaves the other bits alone, and set the backlash 1851 of the axis to 0"
            ),
            "switch the power off and on, then return to the reference position (G28)",
            (
                "traverse the axis with a laser or gauge, in each direction that has a list: the error "
                "must shrink, else say entry_sign=1"
            ),
            "lost motion of a table with one list belongs into the backlash parameter 1851",
        ),
        sign="unconfirmed",
        spacing="uniform",
        directions="one",
        resolution="detection unit times magnification",
        reference_rule="zero at the reference position (3620); a table of one turn begins there",
        suffix=".txt",
        example={"detection_unit": "100 nm", "largest": 127},
        page="fanuc",
    )

    options = (
        unit_along("detection_unit", "detection unit of the axis"),
        whole("magnification", "parameter 3623", 1, 100, default=1),
        pick("largest", "largest increment the control takes", (7, 127), default=7),
        whole("capacity", "most points of an axis in a direction", 2, 1024, default=128),
        whole("axis_number", "number behind A", 1, 32, default=1),
        whole("reference_number", "parameter 3620", 0, LAST_NUMBER),
        AlongOption("reference_position", "machine coordinate of the reference position"),
        replace(INTERVAL, help="parameter 3624; that of the table if omitted"),
        replace(
            INCREMENT,
            help="least input increment, unit of parameter 3624; 1 um or 0.001 deg if omitted",
        ),
        Option("rapid", "rapid traverse, for the smallest interval", "speed", positive=True),
        flag(
            "bidirectional",
            "write a list for each direction (3605 bit 0, 3626, 3627), where the control has that option",
        ),
        whole(
            "reverse_number",
            "parameter 3626, first point of the list for travel in - direction; behind the first list "
            "if omitted",
            0,
            LAST_NUMBER,
        ),
        pick("entry_sign", "k in entry = k e", (-1, 1), default=-1),
    )

    def encode(self, table: CompensationTable, **options: Any) -> Encoded:
        """Return parameters and increments."""
        require_on_axis(table, _TITLE, "'fanuc-straightness'")
        turns, turn = is_rotary(table.axis), is_one_turn(table)
        o = in_axes(self.options, options, axes_of(table))
        o["increment"] = o["increment"] or _LEAST[turns]
        table = _directions(table, o)
        require_sizes(table, _TITLE)
        unit = o["detection_unit"] * o["magnification"]
        if turn:
            zero = o["reference_position"]
            table = require_turn(table, unit, first=table.reference if zero is None else zero)
            require_whole_turn(o["interval"], _TITLE)
        made = sections(
            table,
            o,
            title=_TITLE,
            unit=unit,
            most=o["capacity"] + (0 if turn else 1),
            numbers=(0, LAST_NUMBER),
            limits=(-o["largest"], o["largest"]),
            larger="magnification",
        )
        _require_rapid(made.interval, o["rapid"], turns=turns)
        k = -o["entry_sign"]
        entries = k * made.rounded.entries
        first = made.number if turn else made.first
        if turn:  # point 3620 holds the value of the last one, which stands at the same place
            entries = np.append(entries[-1], entries)
        values = {
            "number": made.number, "first": first, "last": made.last,
            "magnification": o["magnification"], "steps": round(made.interval / o["increment"]),
        }  # fmt: skip
        parameters = {p: values[name] for name, p in _PARAMETERS.items()}
        if turn:
            parameters[_TURN] = round(2.0 * math.pi / o["increment"])
        points = {first + i: int(v) for i, v in enumerate(entries)}
        errors = [made.rounded.error]
        if table.reverse is not None:
            back, lost, error = _backwards(made, o, unit, turn=turn)
            start = _start_of_reverse(o["reverse_number"], first, made.last)
            parameters |= {_BACK: start, _LOST: k * lost}
            points |= {start + i: k * int(v) for i, v in enumerate(back)}
            errors.append(error)
        lines = [
            *(
                _PARAMETER.write(number=p, values={o["axis_number"]: v})
                for p, v in parameters.items()
            ),
            *(ENTRY.write(number=_POINT + n, value=v) for n, v in sorted(points.items())),
        ]
        head = _HEAD_TURNS if turns else _HEAD
        return Encoded(
            parameter_file(head, {**o, "reference_position": made.zero}, lines),
            max(errors),
            step=unit,
            carried=made.carried.table,
            resampling_error=made.carried.error,
            findings=tuple(_reminders(table, o, turns=turns, turn=turn)),
            options=chosen(self.options, o),
        )

    def _read(
        self, data: bytes, path: Path, options: Mapping[str, Any]
    ) -> tuple[CompensationTable, bool]:
        """Return the cumulative corrections, and whether they repeat after a turn."""
        text, head, kind = opened_file(data, path, _HEAD, _HEAD_TURNS)
        words, axis = _words(text, options.get("axis_number"))
        require_axis_number(path, "axis_number", options.get("axis_number"), axis)
        number, first, last, magnification, steps = (words[p] for p in _PARAMETERS.values())
        turn = _TURN in words
        turns = (turn or None) if kind is None else kind is _HEAD_TURNS
        letter = letter_in_file(path, turns, options)
        known = settled(
            self.options, options, path, partial=True,
            file={**head, "reference_number": number, "magnification": magnification},
            needed=("detection_unit", "increment", "reference_position", "entry_sign"),
            axes={"axis": letter, "compensates": letter},
        )  # fmt: skip
        lists = _lists(words, first, last, options.get("largest", 127), path)
        require_capacity(self, lists[0].size, options, path)
        if not (first - 1 <= number <= last and steps > 0 and 1 <= magnification <= 100):
            raise damaged(
                path,
                "3620 to 3624 do not fit: the reference must lie between the extremes, the interval "
                "be positive and the magnification 1 to 100",
                found=f"{number}, {first}, {last}, {magnification}, {steps}",
            )
        if turn:
            _require_closed(words, lists, known["increment"], letter, path)
            lists = [entries[1:] for entries in lists]
        k, unit = -known["entry_sign"], known["detection_unit"] * magnification
        below = 0 if turn else number + 1 - first
        zero, interval = known["reference_position"], steps * known["increment"]
        walks = [walked(k * entries, below, zero, interval, unit) for entries in lists]
        reverse = None
        if len(walks) > 1:
            reverse = walks[1][1] + k * words[_LOST] * known["detection_unit"]
        fields = {**own_axis(identity(path, first=zero), path), "reference": zero}
        fields |= {"axis": letter, "compensates": letter}
        made = CompensationTable(*walks[0], reverse, is_exact_inverse=True, **fields)
        return made, turn


def _directions(table: CompensationTable, o: Mapping[str, Any]) -> CompensationTable:
    """Return the table with as many columns as there are lists."""
    if o["bidirectional"]:
        return table if table.reverse is not None else replace(table, reverse=table.forward)
    if o["reverse_number"] is not None:
        raise TableError("reverse_number= is for bidirectional=True, a list for each direction")
    way = "into parameter 1851 (backlash), or say bidirectional=True where the control has a list for each"
    return require_one_direction(table, _TITLE, way)


def _require_rapid(interval: float, rapid: float | None, *, turns: bool) -> None:
    """Refuse an interval that is too short for the rapid traverse of a linear axis."""
    if rapid is not None and turns:
        raise TableError("rapid= is the speed of a linear axis; leave it out for one that turns")
    smallest = (rapid or 0.0) * 60.0 / _BLOCKS_PER_MINUTE
    if interval < smallest * (1.0 - 1e-9):
        raise LimitError(
            f"the interval {format_length(interval)} is below {format_length(smallest)}, the "
            "smallest for this rapid traverse; give a larger interval="
        )


def _backwards(
    made: Sections, o: Mapping[str, Any], unit: float, *, turn: bool
) -> tuple[IntArray, int, float]:
    """Return the list for travel in - direction, lost motion at the reference, and the rounding."""
    table = made.carried.table
    at = int(np.abs(table.positions - made.zero).argmin())
    lost = round(float(table.reverse[at]) / o["detection_unit"])
    if abs(lost) > _MOST_LOST:
        raise LimitError(
            f"the lost motion at the reference is {lost} detection units, parameter 3627 holds "
            f"{_MOST_LOST}; check the units of the table"
        )
    offset = lost * o["detection_unit"]
    curve = np.rint((table.reverse - offset) / unit).astype(np.int64)
    # at the reference the rest is half a detection unit at most, and the list must start from 3627
    curve[at] = 0
    if turn:
        curve[-1] = 0
    entries = np.diff(curve)
    limits = (-o["largest"], o["largest"])
    require_increments(entries, table.positions, limits, unit, table.axis, "magnification")
    error = float(np.abs(offset + curve * unit - table.reverse).max())
    return np.append(entries[-1], entries) if turn else entries, lost, error


def _start_of_reverse(wanted: int | None, first: int, last: int) -> int:
    """Return the first point of the second list, and refuse points that both would have."""
    start = last + 1 if wanted is None else wanted
    end = start + last - first
    if start <= last and end >= first:
        raise LimitError(
            f"the lists of both directions overlap: points {first} to {last} and {start} to {end}; choose "
            "another reverse_number= or reference_number="
        )
    if end > LAST_NUMBER:
        raise LimitError(
            f"points {start} to {end} leave 0 to {LAST_NUMBER}; choose another reverse_number= or "
            "reference_number=, or a larger interval="
        )
    return start


def _reminders(
    table: CompensationTable, o: Mapping[str, Any], *, turns: bool, turn: bool
) -> Iterator[Finding]:
    """Return what the file cannot set, and what is not documented of it."""
    if table.reverse is not None:
        alike = np.array_equal(table.reverse, table.forward)
        lost = (
            "both lists are alike: lost motion stays in the backlash 1851"
            if alike
            else "with both lists the backlash 1851 would correct lost motion twice"
        )
        yield Finding.warning(
            "the file holds a list for each direction, but not parameter 3605, whose other bits belong "
            f"to the machine; {lost}",
            f"set bit 0 of 3605 to 1{'' if alike else ' and 1851 to 0'} by hand",
            "reversal",
        )
        yield Finding.warning(
            "how the list for travel in - direction is walked is from one secondary page: increments "
            "from the - side to the + side, as in the first list",
            "see the bump of a trial table in both directions first",
            "reversal",
        )
    if turns and not turn:
        low, high = (format_along(table.axis, p, digits=9) for p in table.span)
        yield Finding.warning(
            f"the table covers {low} to {high}, part of a turn: it is written like that of a linear "
            "axis, without the travel of one turn (3625)",
            "an axis that the control counts modulo a turn needs a table of one whole turn",
            "coverage",
        )


def _words(text: Text, wanted: int | None) -> tuple[dict[int, int], int]:
    """Return the value of each number, and the axis of the parameters; of several axes one is wanted."""
    entries: dict[int, int] = {}
    of_axes: dict[int, dict[int, int]] = {}
    known = {*_PARAMETERS.values(), _TURN, _BACK, _LOST}
    points = range(_POINT, _POINT + LAST_NUMBER + 1)
    is_output = any(
        len((_PARAMETER.read("".join(code.split())) or {"values": ()})["values"]) > 1
        for _, code in text.rows
    )
    while text:
        code = "".join(text.rows[text.at][1].split()) if is_output else text.rows[text.at][1]
        found = _PARAMETER.read(code)
        entry = ENTRY.read(code) if found is None else None
        number = (found or entry or {"number": -1})["number"]
        is_own = number in (known if found else points)
        if number in of_axes or number in entries or not (is_own or (is_output and number >= 0)):
            raise text.wrong("one N...P... a line, as the control outputs it, each number once")
        if found:
            of_axes[number] = found["values"]
        elif entry and is_own:
            entries[number] = entry["value"]
        text.at += 1
    axes = {a for n, values in of_axes.items() if n in known for a in values}
    if len(axes) > 1 and (wanted not in axes or not is_output):
        raise CorruptFileError(
            text.path,
            "parameters of several axes",
            found=", ".join(f"A{a}" for a in sorted(axes)),
            hint="give axis_number= of the axis that the table corrects"
            if is_output
            else "the file must hold 3620 to 3624 of one axis, and 3626 with 3627 or neither",
        )
    axis = wanted if wanted is not None and wanted in axes else min(axes, default=0)
    words = {n: values[axis] for n, values in of_axes.items() if n in known and axis in values}
    if is_output:
        words = _of_output(words, entries, of_axes.get(_WAYS, {}).get(axis))
    else:
        words |= entries
    needed = [*_PARAMETERS.values(), *((_BACK, _LOST) if {_BACK, _LOST} & {*words} else ())]
    missing = [p for p in needed if p not in words]
    if missing:
        raise CorruptFileError(
            text.path,
            f"parameter {missing[0]} is missing",
            hint="the file must hold 3620 to 3624 of one axis, and 3626 with 3627 or neither",
        )
    return words, axis


def _of_output(
    words: Mapping[int, int], entries: Mapping[int, int], ways: int | None
) -> dict[int, int]:
    """Return the words of one axis of an output, which also holds what does not act, and points of others."""
    found = dict(words)
    if not found.get(_TURN):
        found.pop(_TURN, None)
    has_ways = ways % 10 == 1 if ways is not None else bool(found.get(_BACK) or found.get(_LOST))
    if not has_ways:
        found.pop(_BACK, None)
        found.pop(_LOST, None)
    first, last = (found.get(_PARAMETERS[n], 0) for n in ("first", "last"))
    for start in (first, *([found[_BACK]] if _BACK in found else ())):
        points = range(_POINT + start, _POINT + start + last - first + 1)
        found |= {n: entries[n] for n in points if n in entries}
    return found


def _lists(
    words: Mapping[int, int], first: int, last: int, largest: int, path: Path
) -> list[IntArray]:
    """Return the increments of the list, or of the two of both directions."""
    starts = [first, words[_BACK]] if _BACK in words else [first]
    ranges = [range(_POINT + s, _POINT + s + last - first + 1) for s in starts]
    points = {n for n in words if n >= _POINT}
    wanted = {n for r in ranges for n in r}
    if not ranges[0] or points != wanted:
        wrong = sorted(points.symmetric_difference(wanted))
        raise CorruptFileError(
            path,
            f"the points do not run from {first} to {last} as 3621 and 3622 say"
            + (f", and as many from {starts[1]} (3626)" if len(starts) > 1 else ""),
            found=f"N{wrong[0]}" if wrong else "none",
            hint="a missing point keeps the old value in the control: write the table again",
        )
    if len(wanted) < sum(map(len, ranges)):
        raise CorruptFileError(
            path,
            "the points of both directions overlap",
            field="3626",
            found=starts[1],
            hint="each direction needs points of its own: write the table again",
        )
    lists = [np.array([words[n] for n in r], dtype=np.int64) for r in ranges]
    for entries, r in zip(lists, ranges, strict=True):
        if np.abs(entries).max() > largest:
            raise CorruptFileError(
                path,
                f"an increment leaves -{largest} ... {largest}",
                field=f"N{r[int(np.abs(entries).argmax())]}",
                hint="the control refuses it",
            )
    return lists


def _require_closed(
    words: Mapping[int, int], lists: list[IntArray], increment: float, axis: str, path: Path
) -> None:
    """Refuse a table of one turn that is not one, or adds up with every turn."""
    number, first, last, _, steps = (words[p] for p in _PARAMETERS.values())
    parts = last - number
    turn = words[_TURN] * increment
    if not is_rotary(axis) or abs(turn - 2.0 * math.pi) > 1e-9:
        raise damaged(
            path, "3625 is not the travel of one turn", field="3625",
            expected=round(2.0 * math.pi / increment) if is_rotary(axis) else "nothing: the axis is linear",
            found=words[_TURN],
        )  # fmt: skip
    if first != number or parts * steps != words[_TURN]:
        raise damaged(
            path,
            "3620 to 3625 do not fit: of a table of one turn the first point is that of the reference, and "
            "the intervals fill the turn",
            expected=f"{words[_TURN]} in steps of {steps}",
            found=f"{parts} sections from point {first}, reference {number}",
        )
    for entries in lists:
        if entries[1:].sum() != 0 or entries[0] != entries[-1]:
            raise damaged(
                path,
                "the increments of one turn must have the sum 0, and its first point the value of the "
                "last: the axis would move on with every turn",
                found=f"sum {int(entries[1:].sum())}, {int(entries[0])} and {int(entries[-1])}",
            )


# ---- straightness compensation: four points, three straight segments ----------------------------
# Fanuc straightness compensation: four points, three straight segments, placed where they help most.
#
# Entry: correction of the compensated axis at four of the pitch error points of the moving axis, in
# detection units of the compensated axis: k e with k = -1. The sign is not documented in what could
# be read and must be tried on the machine. What three segments cannot follow stays, and is reported.

_STRAIGHT = "Fanuc straightness compensation"
_POINTS = 4
_LARGEST_ENTRY = 32767
_LAST_AXIS = 32

_STRAIGHT_HEAD = Line(
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
        title=_STRAIGHT,
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
        require_linear((table.axis, table.compensates), _STRAIGHT)
        table = require_one_direction(
            table, _STRAIGHT, "into parameter 1851 (backlash) of the moving axis"
        )
        _require_axes(table, options)
        require_sizes(table, _STRAIGHT, largest=_LARGEST_ENTRY)
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
        if abs(int(rounded.entries[worst])) > _LARGEST_ENTRY:
            raise LimitError(
                f"the correction {format_length(float(knots.values[worst]))} at "
                f"{knots.positions[worst] * 1e3:.9g} mm exceeds {_LARGEST_ENTRY} detection units"
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
            parameter_file(
                _STRAIGHT_HEAD, stated, [ENTRY.write(number=n, value=v) for n, v in words]
            ),
            rounded.error,
            notes={"knots": knots.audit},
            step=unit,
            carried=carried,
            resampling_error=knots.residual,
        )

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationTable:
        """Return the polyline of four points."""
        text, head, _ = opened_file(data, path, _STRAIGHT_HEAD)
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
        return read_table(
            zero + known["interval"] * (points - known["reference_number"]),
            -known["entry_sign"] * entries * known["detection_unit"] + 0.0,
            **fields,
        )


def _require_axes(table: CompensationTable, options: Mapping[str, Any]) -> None:
    if table.is_on_axis:
        raise TableError(
            f"{_STRAIGHT} corrects another axis than the moving one, this table is {table.axis} -> "
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
        or (np.abs(entries) > _LARGEST_ENTRY).any()
    ):
        raise damaged(
            text.path,
            "two axes, four rising points from 0 to 1023 and values up to 32767 are needed",
            found=", ".join(map(str, values.tolist())),
        )
    return axes, points, entries
