"""Fanuc stored pitch error compensation: parameters 3620 to 3624 and one increment per section.

Entry: increment of the correction over a section, walked in + direction, in detection units times
the magnification: k (e(upper) - e(lower)) with k = -1. The layout is that of the parameter manual
of the Series 0i (3620 to 3624); the sign is not written there and must be tried on the machine.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.compensation.knots import choose_knots
from metrosep.compensation.rounding import round_entries, round_increments
from metrosep.compensation.table import CompensationTable
from metrosep.controllers._grids import (
    DRY_RUN,
    Resampling,
    ascii_lines,
    carry,
    mm_text,
    mm_value,
    require_capacity,
    require_linear,
    require_on_axis,
    require_one_direction,
    require_sizes,
    require_zero,
    uniform_positions,
)
from metrosep.controllers._notes import fact, named_axes, own_axis, require_agreement
from metrosep.controllers.base import DialectInfo, Encoded, identity
from metrosep.controllers.options import Option
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, LimitError, TableError
from metrosep.core.units import format_length

__all__ = ["Fanuc"]

IntArray = NDArray[np.int64]

_TITLE = "Fanuc pitch error compensation"
_LAST_NUMBER = 1023
_FARTHEST, _LARGEST = 1e3, 1.0
"""Position and correction beyond which units are mistaken, m."""
_POINT = 10_000
"""Number of the file's word for point 0."""
_BLOCKS_PER_MINUTE = 7500.0
"""Feed over smallest interval, 1/min (parameter manual, metric)."""

_HEAD = re.compile(
    r"%\(FANUC PITCH ERROR, DETECTION UNIT (\d+\.?\d*) MM, INCREMENT (\d+\.?\d*) MM, "
    r"REFERENCE (-?\d+\.?\d*) MM, ENTRY = ([+-])E, [A-Z: -]+\)"
)
_WORD = re.compile(r"N(\d{4,5})(?:A(\d{1,2}))?P(-?\d{1,9})")
_PARAMETERS = (3620, 3621, 3622, 3623, 3624)


class Fanuc(Resampling):
    """Writer and reader of pitch error data; see the module."""

    info = DialectInfo(
        id="fanuc",
        title=_TITLE,
        entry="increment over a section, walked in + direction: -(e(upper) - e(lower)) in "
        "detection units times magnification",
        units="whole detection units times magnification (3623); interval in input increments",
        max_points=128,
        outside="constant beyond both extreme points: no more increments are output",
        sign_status="layout documented, sign not: dry-run on the machine first",
        activation=(
            "note the old values of 3620 to 3624 and of the points",
            "allow parameter writing (PWE) and read the file in, or type the numbers in",
            "switch the power off and on, then return to the reference position (G28)",
            "traverse the axis with a laser or gauge: the error must shrink, else say entry_sign=1",
            "lost motion belongs into the backlash parameter 1851, not into this table",
        ),
        sign="unconfirmed",
        spacing="uniform",
        directions="one",
        resolution="detection unit times magnification",
        reference_rule="zero at the reference position (3620)",
        suffix=".txt",
        example={"detection_unit": "100 nm", "largest": 127},
        page="fanuc",
    )

    options = (
        Option(
            "detection_unit",
            "detection unit of the axis",
            "length",
            required=True,
            lowest=1e-12,
            highest=1e-3,
        ),
        Option("magnification", "parameter 3623", "integer", default=1, lowest=1, highest=100),
        Option(
            "largest", "largest increment the control takes", "choice", default=7, choices=(7, 127)
        ),
        Option(
            "capacity", "most points of an axis", "integer", default=128, lowest=2, highest=1024
        ),
        Option("axis_number", "number behind A", "integer", default=1, lowest=1, highest=32),
        Option("reference_number", "parameter 3620", "integer", lowest=0, highest=_LAST_NUMBER),
        Option("reference_position", "machine coordinate of the reference position", "length"),
        Option(
            "interval",
            "parameter 3624; that of the table if omitted",
            "length",
            positive=True,
            highest=100.0,
        ),
        Option(
            "increment",
            "least input increment, unit of parameter 3624",
            "length",
            default=1e-6,
            lowest=1e-9,
            highest=1e-3,
        ),
        Option("rapid", "rapid traverse, for the smallest interval", "speed", positive=True),
        Option("entry_sign", "k in entry = k e", "choice", default=-1, choices=(-1, 1)),
    )

    def encode(self, table: CompensationTable, **options: Any) -> Encoded:
        """Return parameters and increments."""
        require_linear((table.axis, table.compensates), _TITLE)
        require_on_axis(table, _TITLE, "'fanuc-straightness'")
        require_one_direction(table, _TITLE, "into parameter 1851 (backlash)")
        require_sizes(table, _TITLE, farthest=_FARTHEST, largest=_LARGEST)
        zero = options["reference_position"]
        zero = table.reference if zero is None else zero
        require_zero(table, zero, _TITLE)
        positions = uniform_positions(
            table,
            through=zero,
            interval=options["interval"],
            quantum=options["increment"],
            max_points=options["capacity"] + 1,
            title=_TITLE,
        )
        carried = carry(table, positions)
        interval = float(positions[-1] - positions[0]) / (positions.size - 1)
        _require_interval(interval, options["rapid"])
        unit = options["detection_unit"] * options["magnification"]
        rounded = round_increments(carried.table.forward, unit, limits=None)
        entries = -options["entry_sign"] * rounded.entries
        _require_range(entries, positions, options["largest"], unit)
        below = int(np.abs(positions - zero).argmin())
        number = options["reference_number"]
        number = max(below - 1, 0) if number is None else number
        first = number + 1 - below
        last = number + positions.size - 1 - below
        if first < 0 or last > _LAST_NUMBER:
            raise LimitError(
                f"points {first} to {last} leave 0 to {_LAST_NUMBER}; choose another reference_number"
            )
        text = _text(options, zero, interval, (number, first, last), entries)
        return Encoded(
            text.encode("ascii"),
            rounded.error,
            step=unit,
            carried=carried.table,
            resampling_error=carried.error,
        )

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationTable:
        """Return the cumulative corrections."""
        lines = ascii_lines(data, path, "Fanuc parameter file")
        if len(lines) < 3 or not lines[0].startswith("%") or lines[-1] != "%":
            raise CorruptFileError(
                path, "a parameter file begins and ends with %", hint="write the table again"
            )
        head = _head(lines[0], path)
        known = {
            name: fact(self, name, options, head, path)
            for name in ("detection_unit", "increment", "reference_position", "entry_sign")
        }
        words, axis = _words(lines[1:-1], path)
        wanted = options.get("axis_number")
        if wanted is not None and wanted != axis:
            raise CorruptFileError(
                path,
                "the parameters are those of another axis",
                expected=f"A{wanted}",
                found=f"A{axis}",
                hint="choose the file of this axis",
            )
        number, first, last, magnification, steps = (words[p] for p in _PARAMETERS)
        for name, value in (("reference_number", number), ("magnification", magnification)):
            require_agreement(path, name, ("the file", value), ("you", options.get(name)))
        entries = _entries(words, first, last, options.get("largest", 127), path)
        require_capacity(self, entries.size, options, path)
        if not (first - 1 <= number <= last and steps > 0 and 1 <= magnification <= 100):
            raise CorruptFileError(
                path,
                "3620 to 3624 do not fit: the reference must lie between the extremes, the interval "
                "be positive and the magnification 1 to 100",
                found=f"{number}, {first}, {last}, {magnification}, {steps}",
                hint="write the table again",
            )
        below = number + 1 - first
        curve = np.concatenate([[0], np.cumsum(entries)])
        curve = -known["entry_sign"] * (curve - curve[below])
        zero = known["reference_position"]
        positions = zero + steps * known["increment"] * np.arange(-below, curve.size - below)
        return CompensationTable(
            positions=positions,
            forward=curve * (known["detection_unit"] * magnification) + 0.0,
            reverse=None,
            is_exact_inverse=True,
            **{**own_axis(identity(path, first=zero), path), "reference": zero},
        )


def _require_interval(interval: float, rapid: float | None) -> None:
    smallest = 0.0 if rapid is None else rapid * 60.0 / _BLOCKS_PER_MINUTE
    if interval < smallest * (1.0 - 1e-9):
        raise LimitError(
            f"the interval {format_length(interval)} is below {format_length(smallest)}, the smallest "
            "for this rapid traverse; give a larger interval="
        )


def _require_range(entries: IntArray, positions: Any, largest: int, unit: float) -> None:
    i = int(np.abs(entries).argmax())
    if abs(int(entries[i])) > largest:
        raise LimitError(
            f"the increment {int(entries[i])} between {positions[i] * 1e3:.9g} and "
            f"{positions[i + 1] * 1e3:.9g} mm leaves -{largest} ... {largest} units of "
            f"{format_length(unit)}; use a smaller interval or a larger magnification"
        )


def _text(
    options: Mapping[str, Any],
    zero: float,
    interval: float,
    numbers: tuple[int, int, int],
    entries: IntArray,
) -> str:
    sign = "+" if options["entry_sign"] > 0 else "-"
    head = (
        f"%(FANUC PITCH ERROR, DETECTION UNIT {mm_text(options['detection_unit'])} MM, "
        f"INCREMENT {mm_text(options['increment'])} MM, REFERENCE {mm_text(zero)} MM, "
        f"ENTRY = {sign}E, {DRY_RUN.upper()})"
    )
    values = (*numbers, options["magnification"], round(interval / options["increment"]))
    axis = options["axis_number"]
    lines = [f"N{p}A{axis}P{v}" for p, v in zip(_PARAMETERS, values, strict=True)]
    lines += [f"N{_POINT + numbers[1] + i}P{int(v)}" for i, v in enumerate(entries)]
    return "\n".join([head, *lines, "%"]) + "\n"


def _head(line: str, path: Path) -> dict[str, Any]:
    """Return what the comment behind the first % tells; the control skips it."""
    if line == "%":
        return {}
    found = _HEAD.fullmatch(line)
    if found is None:
        if line.startswith("%(FANUC"):
            raise CorruptFileError(path, "line 1: the comment is damaged", hint="write it again")
        return {}
    return {
        "detection_unit": mm_value(found[1]),
        "increment": mm_value(found[2]),
        "reference_position": mm_value(found[3]),
        "entry_sign": 1 if found[4] == "+" else -1,
    }


def _words(lines: list[str], path: Path) -> tuple[dict[int, int], int]:
    """Return the value of each number, and the axis of the parameters."""
    words: dict[int, int] = {}
    axes: set[int] = set()
    for i, line in enumerate(lines, start=2):
        found = _WORD.fullmatch(line)
        number = int(found[1]) if found else -1
        is_parameter = number in _PARAMETERS
        is_point = _POINT <= number <= _POINT + _LAST_NUMBER
        if found is None or not (is_parameter or is_point) or is_parameter != bool(found[2]):
            raise CorruptFileError(
                path,
                f"line {i} is no word of pitch error data but {line[:60]!r}",
                hint="one N...P... a line, as the control outputs it",
            )
        if number in words:
            raise CorruptFileError(path, f"line {i}: N{number} stands twice", hint="remove one")
        words[number] = int(found[3])
        if is_parameter:
            axes.add(int(found[2]))
    missing = [p for p in _PARAMETERS if p not in words]
    if missing or len(axes) != 1:
        raise CorruptFileError(
            path,
            f"parameter {missing[0]} is missing" if missing else "parameters of several axes",
            hint="the file must hold 3620 to 3624 of one axis",
        )
    return words, axes.pop()


def _entries(
    words: Mapping[int, int], first: int, last: int, largest: int, path: Path
) -> IntArray:
    wanted = range(_POINT + first, _POINT + last + 1)
    points = {n for n in words if n >= _POINT}
    if not wanted or points != set(wanted):
        wrong = sorted(points.symmetric_difference(wanted))
        raise CorruptFileError(
            path,
            f"the points do not run from {first} to {last} as 3621 and 3622 say",
            found=f"N{wrong[0]}" if wrong else "none",
            hint="a missing point keeps the old value in the control: write the table again",
        )
    entries = np.array([words[n] for n in wanted], dtype=np.int64)
    if np.abs(entries).max() > largest:
        raise CorruptFileError(
            path,
            f"an increment leaves -{largest} ... {largest}",
            field=f"N{_POINT + first + int(np.abs(entries).argmax())}",
            hint="the control refuses it",
        )
    return entries


# ---- fanuc straightness compensation: four points, three straight segments, placed where they help most ----
# Entry: correction of the compensated axis at four of the pitch error points of the moving axis, in
# detection units of the compensated axis: k e with k = -1. The sign is not documented in what could
# be read and must be tried on the machine. What three segments cannot follow stays, and is reported.

_STRAIGHTNESS_TITLE = "Fanuc straightness compensation"
_POINTS = 4
_STRAIGHTNESS_LARGEST = 32767
_STRAIGHTNESS_FARTHEST, _BIGGEST = 1e3, 1.0
"""Position and correction beyond which units are mistaken, m."""
_LAST_AXIS = 32

_STRAIGHTNESS_HEAD = re.compile(
    r"%\(FANUC STRAIGHTNESS ([A-Z]\d?) TO ([A-Z]\d?), DETECTION UNIT (\d+\.?\d*) MM, "
    r"POINTS EVERY (\d+\.?\d*) MM, POINT (\d{1,4}) AT (-?\d+\.?\d*) MM, ENTRY = ([+-])E, [A-Z: -]+\)"
)
_STRAIGHTNESS_WORD = re.compile(r"N(\d{4})P(-?\d{1,6})")
_AXIS = re.compile(r"[A-Z]\d?")


class FanucStraightness(Resampling):
    """Writer and reader of parameters 5711 to 5784; see the module."""

    info = DialectInfo(
        id="fanuc-straightness",
        title=_STRAIGHTNESS_TITLE,
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
        Option(
            "detection_unit",
            "detection unit of the compensated axis",
            "length",
            required=True,
            lowest=1e-12,
            highest=1e-3,
        ),
        Option(
            "interval",
            "spacing of the moving axis' pitch error points (3624)",
            "length",
            required=True,
            lowest=1e-9,
            highest=100.0,
        ),
        Option(
            "reference_number",
            "pitch error point of the moving axis' reference (3620)",
            "integer",
            required=True,
            lowest=0,
            highest=_LAST_NUMBER,
        ),
        Option("reference_position", "machine coordinate of that point", "length"),
        Option(
            "moving_axis",
            "number of the moving axis",
            "integer",
            default=1,
            lowest=1,
            highest=_LAST_AXIS,
        ),
        Option(
            "compensated_axis",
            "number of the compensated axis",
            "integer",
            default=2,
            lowest=1,
            highest=_LAST_AXIS,
        ),
        Option("set_number", "set of parameters, 1 for 5711", "integer", 1, lowest=1, highest=3),
        Option("entry_sign", "k in entry = k e", "choice", default=-1, choices=(-1, 1)),
    )

    def encode(self, table: CompensationTable, **options: Any) -> Encoded:
        """Return the parameters of four points."""
        require_linear((table.axis, table.compensates), _STRAIGHTNESS_TITLE)
        require_one_direction(
            table, _STRAIGHTNESS_TITLE, "into parameter 1851 (backlash) of the moving axis"
        )
        _require_axes(table, options)
        require_sizes(
            table, _STRAIGHTNESS_TITLE, farthest=_STRAIGHTNESS_FARTHEST, largest=_BIGGEST
        )
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
        if points[0] < 0 or points[-1] > _LAST_NUMBER:
            raise LimitError(
                f"points {points[0]} to {points[-1]} leave 0 to {_LAST_NUMBER}; check interval and "
                "reference_number"
            )
        rounded = round_entries(knots.values, unit)
        worst = int(np.abs(rounded.entries).argmax())
        if abs(int(rounded.entries[worst])) > _STRAIGHTNESS_LARGEST:
            raise LimitError(
                f"the correction {format_length(float(knots.values[worst]))} at "
                f"{knots.positions[worst] * 1e3:.9g} mm exceeds {_STRAIGHTNESS_LARGEST} detection units"
            )
        entries = [-options["entry_sign"] * int(v) for v in rounded.entries]
        carried = replace(
            table,
            positions=zero + step * np.array(chosen, dtype=np.float64),
            forward=knots.values,
            u=None if table.u is None else np.interp(knots.positions, table.positions, table.u),
        )
        return Encoded(
            _straightness_text(table, options, zero, points, entries).encode("ascii"),
            rounded.error,
            notes={"knots": knots.audit},
            step=unit,
            carried=carried,
            resampling_error=knots.residual,
        )

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationTable:
        """Return the polyline of four points."""
        lines = ascii_lines(data, path, "Fanuc parameter file")
        if len(lines) < 3 or not lines[0].startswith("%") or lines[-1] != "%":
            raise CorruptFileError(
                path, "a parameter file begins and ends with %", hint="write the table again"
            )
        head = _straightness_head(lines[0], path)
        names = (
            "detection_unit",
            "interval",
            "reference_number",
            "reference_position",
            "entry_sign",
        )
        unit, step, number, zero, sign = (fact(self, n, options, head, path) for n in names)
        axes, points, entries = _parameters(lines[1:-1], path)
        for name, found in zip(("moving_axis", "compensated_axis"), axes, strict=True):
            if options.get(name) not in (None, found):
                raise CorruptFileError(
                    path,
                    "the parameters are those of another axis",
                    field=name,
                    expected=options[name],
                    found=found,
                    hint="choose the file of this axis",
                )
        positions = zero + step * (points - number)
        fields = identity(path, first=zero)
        fields = named_axes(fields, head["axes"], path) if "axes" in head else fields
        return CompensationTable(
            positions=positions,
            forward=-sign * entries * unit + 0.0,
            reverse=None,
            is_exact_inverse=True,
            **fields,
        )


def _require_axes(table: CompensationTable, options: Mapping[str, Any]) -> None:
    if table.is_on_axis:
        raise TableError(
            f"{_STRAIGHTNESS_TITLE} corrects another axis than the moving one, this table is {table.axis} -> "
            f"{table.compensates}; write controller='fanuc'"
        )
    for name in (table.axis, table.compensates):
        if not _AXIS.fullmatch(name):
            raise TableError(f"axis {name!r} is no Fanuc axis: a capital and perhaps a digit")
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
    if last - first > _LAST_NUMBER:
        raise LimitError(
            f"the table spans {last - first} intervals of {format_length(step)}, there are "
            f"{_LAST_NUMBER}; check interval"
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


def _straightness_text(
    table: CompensationTable,
    options: Mapping[str, Any],
    zero: float,
    points: list[int],
    entries: list[int],
) -> str:
    sign = "+" if options["entry_sign"] > 0 else "-"
    head = (
        f"%(FANUC STRAIGHTNESS {table.axis} TO {table.compensates}, DETECTION UNIT "
        f"{mm_text(options['detection_unit'])} MM, POINTS EVERY {mm_text(options['interval'])} MM, "
        f"POINT {options['reference_number']} AT {mm_text(zero)} MM, ENTRY = {sign}E, "
        f"{DRY_RUN.upper()})"
    )
    values = [options["moving_axis"], options["compensated_axis"], *points, *entries]
    words = zip(_numbers(options["set_number"]), values, strict=True)
    return "\n".join([head, *(f"N{n}P{v}" for n, v in words), "%"]) + "\n"


def _numbers(set_number: int) -> list[int]:
    """Return the parameters of a set: moving axis, compensated axis, points, values."""
    s = set_number - 1
    return [
        5711 + s,
        5721 + s,
        *(5731 + 10 * s + i for i in range(_POINTS)),
        *(5761 + 10 * s + i for i in range(_POINTS)),
    ]


def _straightness_head(line: str, path: Path) -> dict[str, Any]:
    found = _STRAIGHTNESS_HEAD.fullmatch(line)
    if found is None:
        if line.startswith("%(FANUC"):
            raise CorruptFileError(path, "line 1: the comment is damaged", hint="write it again")
        return {}
    return {
        "axes": (found[1], found[2]),
        "detection_unit": mm_value(found[3]),
        "interval": mm_value(found[4]),
        "reference_number": int(found[5]),
        "reference_position": mm_value(found[6]),
        "entry_sign": 1 if found[7] == "+" else -1,
    }


def _parameters(
    lines: list[str], path: Path
) -> tuple[tuple[int, int], NDArray[np.int64], NDArray[np.int64]]:
    words: dict[int, int] = {}
    for i, line in enumerate(lines, start=2):
        found = _STRAIGHTNESS_WORD.fullmatch(line)
        if found is None or int(found[1]) in words:
            raise CorruptFileError(
                path,
                f"line {i} is no parameter, or one that stands twice: {line[:60]!r}",
                hint="one N...P... a line, as the control outputs it",
            )
        words[int(found[1])] = int(found[2])
    wanted = next((n for n in map(_numbers, (1, 2, 3)) if set(n) == set(words)), None)
    if wanted is None:
        raise CorruptFileError(
            path,
            "the ten parameters of one set must be there, 5711, 5721, 5731 to 5734, 5761 to 5764",
            found=", ".join(map(str, sorted(words)))[:80],
            hint="write the table again",
        )
    values = np.array([words[n] for n in wanted], dtype=np.int64)
    points, entries = values[2:6], values[6:]
    axes = int(values[0]), int(values[1])
    bad = (
        axes[0] == axes[1]
        or not 1 <= min(axes) <= max(axes) <= _LAST_AXIS
        or bool((np.diff(points) <= 0).any())
        or bool((points < 0).any() or (points > _LAST_NUMBER).any())
        or bool((np.abs(entries) > _STRAIGHTNESS_LARGEST).any())
    )
    if bad:
        raise CorruptFileError(
            path,
            "two axes, four rising points from 0 to 1023 and values up to 32767 are needed",
            found=", ".join(map(str, values.tolist())),
            hint="write the table again",
        )
    return axes, points, entries
