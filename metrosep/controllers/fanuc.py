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
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.compensation.area_errors import format_along, is_rotary
from metrosep.compensation.limits import Finding
from metrosep.compensation.table import CompensationTable
from metrosep.controllers._facts import letter_in_file, own_axis, settled
from metrosep.controllers._grammar import (
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
    whole,
)
from metrosep.core.errors import CorruptFileError, LimitError, TableError
from metrosep.core.units import format_length

__all__ = ["Fanuc"]

IntArray = NDArray[np.int64]

_TITLE = "Fanuc pitch error compensation"
LAST_NUMBER = 1023
FARTHEST, _LARGEST = 1e3, 1.0
"""Position and correction beyond which units are mistaken, m."""
_POINT = 10_000
"""Number of the file's word for point 0."""
_BLOCKS_PER_MINUTE = 7500.0
"""Feed over smallest interval, 1/min (parameter manual, metric)."""

_PARAMETERS = {
    "number": 3620, "first": 3621, "last": 3622, "magnification": 3623, "steps": 3624
}  # fmt: skip
_TURN, _BACK, _LOST = 3625, 3626, 3627
"""Travel of one turn; first point of the list for travel in - direction; lost motion at the reference."""
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
_PARAMETER = Line("N{number}A{axis}P{value}", value=INTEGER)
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
        require_sizes(table, _TITLE, farthest=FARTHEST, largest=_LARGEST)
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
                _PARAMETER.write(number=p, axis=o["axis_number"], value=v)
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
            findings=_reminders(table, o, turns=turns, turn=turn),
            options=chosen(self.options, o),
        )

    def _read(
        self, data: bytes, path: Path, options: Mapping[str, Any]
    ) -> tuple[CompensationTable, bool]:
        """Return the cumulative corrections, and whether they repeat after a turn."""
        text, head, kind = opened_file(data, path, _HEAD, _HEAD_TURNS)
        words, axis = _words(text)
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
) -> tuple[Finding, ...]:
    """Return what the file cannot set, and what is not documented of it."""
    found = []
    if table.reverse is not None:
        found.append(
            Finding(
                "warning",
                "the file holds a list for each direction, but not parameter 3605, whose other bits belong "
                "to the machine; with both lists the backlash 1851 would correct lost motion twice",
                "set bit 0 of 3605 to 1 and 1851 to 0 by hand",
                "reversal",
            )
        )
        found.append(
            Finding(
                "warning",
                "how the list for travel in - direction is walked is from one secondary page: increments "
                "from the - side to the + side, as in the first list",
                "see the bump of a trial table in both directions first",
                "reversal",
            )
        )
    if turns and not turn:
        low, high = (format_along(table.axis, p, digits=9) for p in table.span)
        found.append(
            Finding(
                "warning",
                f"the table covers {low} to {high}, part of a turn: it is written like that of a linear "
                "axis, without the travel of one turn (3625)",
                "an axis that the control counts modulo a turn needs a table of one whole turn",
                "coverage",
            )
        )
    return tuple(found)


def _words(text: Text) -> tuple[dict[int, int], int]:
    """Return the value of each number, and the axis of the parameters."""
    words: dict[int, int] = {}
    axes: set[int] = set()
    parameters = {*_PARAMETERS.values(), _TURN, _BACK, _LOST}
    while text:
        code = text.rows[text.at][1]
        found = _PARAMETER.read(code)
        entry = ENTRY.read(code) if found is None else None
        number = (found or entry or {"number": -1})["number"]
        known = parameters if found else range(_POINT, _POINT + LAST_NUMBER + 1)
        if number not in known or number in words:
            raise text.wrong("one N...P... a line, as the control outputs it, each number once")
        words[number] = (found or entry or {})["value"]
        axes |= {found["axis"]} if found else set()
        text.at += 1
    needed = [*_PARAMETERS.values(), *((_BACK, _LOST) if {_BACK, _LOST} & {*words} else ())]
    missing = [p for p in needed if p not in words]
    if missing or len(axes) != 1:
        raise CorruptFileError(
            text.path,
            f"parameter {missing[0]} is missing" if missing else "parameters of several axes",
            hint="the file must hold 3620 to 3624 of one axis, and 3626 with 3627 or neither",
        )
    return words, axes.pop()


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
