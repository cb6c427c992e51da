"""Mitsubishi MELDAS machine error compensation, incremental system: parameters #4001 to #4007.

Entry of a section, from the manual: on the + side of the reference (interval - travel) x 2, on the
- side (interval + travel) x 2 with the signed travel, walked outward. Walked outward the second is
+2 (e(outer) - e(inner)), so both are one rule: -2 (e(upper) - e(lower)) in output units times scale.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.compensation.rounding import round_increments
from metrosep.compensation.table import CompensationTable
from metrosep.controllers._grids import (
    Resampling,
    ascii_lines,
    carry,
    mm_text,
    mm_value,
    require_linear,
    require_one_direction,
    require_sizes,
    require_zero,
    uniform_positions,
)
from metrosep.controllers._notes import fact, named_axes, require_agreement
from metrosep.controllers.base import DialectInfo, Encoded, identity
from metrosep.controllers.options import Option
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, LimitError, TableError
from metrosep.core.units import format_length

__all__ = ["Mitsubishi"]

IntArray = NDArray[np.int64]

_TITLE = "Mitsubishi machine error compensation"
_FIRST, _LAST = 4101, 5124
_LOW, _HIGH = -128, 127
_FARTHEST, _LARGEST = 1e3, 1.0
"""Position and correction beyond which units are mistaken, m."""
_CAPACITY = _LAST - _FIRST + 1

_FACTS = re.compile(
    r"; MITSUBISHI MACHINE ERROR COMPENSATION, INCREMENTAL, OUTPUT UNIT (\d+\.?\d*) MM, "
    r"REFERENCE (-?\d+\.?\d*) MM"
)
_LINE = re.compile(r"#(\d{4}) (\S+)")
_AXIS = re.compile(r"[A-Z]\d?")
_INTEGER = re.compile(r"-?\d{1,5}")
_DECIMAL = re.compile(r"\d{1,6}\.?\d{0,12}")


class Mitsubishi(Resampling):
    """Writer and reader of compensation numbers; see the module."""

    info = DialectInfo(
        id="mitsubishi",
        title=_TITLE,
        entry="increment over a section: -2 (e(upper) - e(lower)) in output units times scale "
        "factor, on both sides of the reference",
        units="whole halves of the output unit times scale factor; interval in mm",
        max_points=_CAPACITY,
        outside="constant beyond both ends: no more increments are output",
        sign_status="documented for the axis itself (interval minus travel, times 2); for another "
        "axis not",
        activation=(
            "note the old values of #4001 to #4007 of this axis and of its numbers",
            "type the numbers in on the machine error compensation page, or convert this list",
            "select the incremental system",
            "switch the power off and on, then return to the reference point",
            "traverse the axis with a laser or gauge: the error must shrink",
            "lost motion belongs into the backlash parameters #2011 and #2012, not into this table",
        ),
        sign="documented",
        spacing="uniform",
        directions="one",
        resolution="half an output unit times scale factor",
        reference_rule="zero at the reference point (#4003)",
        suffix=".txt",
        example={"output_unit": "100 nm"},
        page="mitsubishi",
    )

    options = (
        Option(
            "output_unit",
            "unit of output of the control",
            "length",
            required=True,
            lowest=1e-12,
            highest=1e-3,
        ),
        Option("scale", "parameter #4006", "integer", default=1, lowest=1, highest=99),
        Option("set_number", "set of parameters, 1 for #4001", "integer", 1, lowest=1, highest=10),
        Option(
            "reference_number",
            "parameter #4003; the lowest that fits if omitted",
            "integer",
            lowest=_FIRST - 1,
            highest=_LAST,
        ),
        Option("reference_position", "machine coordinate of the reference point", "length"),
        Option(
            "interval",
            "parameter #4007; that of the table if omitted",
            "length",
            positive=True,
            highest=100.0,
        ),
        Option(
            "increment",
            "unit of parameter #4007",
            "length",
            default=1e-6,
            lowest=1e-9,
            highest=1e-3,
        ),
        Option(
            "cross_axis",
            "a table that corrects another axis than it looks up: its sign is not documented",
            "choice",
            default="refuse",
            choices=("refuse", "tried"),
        ),
    )

    def encode(self, table: CompensationTable, **options: Any) -> Encoded:
        """Return parameters and numbers."""
        require_linear((table.axis, table.compensates), _TITLE)
        require_one_direction(table, _TITLE, "into #2011 and #2012 (backlash)")
        _require_axes(table, options["cross_axis"])
        require_sizes(table, _TITLE, farthest=_FARTHEST, largest=_LARGEST)
        zero = options["reference_position"]
        zero = table.reference if zero is None else zero
        require_zero(table, zero, _TITLE)
        positions = uniform_positions(
            table,
            through=zero,
            interval=options["interval"],
            quantum=options["increment"],
            max_points=_CAPACITY + 1,
            title=_TITLE,
        )
        carried = carry(table, positions)
        unit = 0.5 * options["output_unit"] * options["scale"]
        rounded = round_increments(carried.table.forward, unit, limits=None)
        _require_range(rounded.entries, positions, unit)
        below = int(np.abs(positions - zero).argmin())
        number = options["reference_number"]
        number = max(_FIRST + below - 1, _FIRST) if number is None else number
        first, last = number + 1 - below, number + positions.size - 1 - below
        if first < _FIRST or last > _LAST:
            raise LimitError(
                f"numbers #{first} to #{last} leave #{_FIRST} to #{_LAST}; choose another "
                "reference_number"
            )
        interval = float(positions[-1] - positions[0]) / (positions.size - 1)
        steps = round(interval / options["increment"])
        text = _text(table, options, zero, (number, first, last), steps, rounded.entries)
        return Encoded(
            text.encode("ascii"),
            rounded.error,
            step=unit,
            carried=carried.table,
            resampling_error=carried.error,
        )

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationTable:
        """Return the cumulative corrections."""
        lines = ascii_lines(data, path, "list of Mitsubishi parameters")
        head = _head(lines, path)
        unit = fact(self, "output_unit", options, head, path)
        zero = fact(self, "reference_position", options, head, path)
        numbers, words = _parameters(lines, path)
        base = 4000 + 10 * ((min(words) - 4001) // 10) if words else 0
        axes, (number, first, last, scale), interval = _settings(words, base, path)
        for name, value in (("reference_number", number), ("scale", scale)):
            require_agreement(path, name, ("the file", value), ("you", options.get(name)))
        wanted = options.get("set_number")
        if wanted is not None and base != 4000 + 10 * (wanted - 1):
            raise CorruptFileError(
                path,
                "another set of parameters",
                expected=f"#{4001 + 10 * (wanted - 1)}",
                found=f"#{base + 1}",
                hint="choose the list of this axis",
            )
        entries = _entries(numbers, first, last, path)
        if not (first - 1 <= number <= last and 1 <= scale <= 99 and interval > 0.0):
            raise CorruptFileError(
                path,
                "the reference must lie between the ends, the interval be positive and the scale "
                "factor 1 to 99",
                found=f"{number}, {first}, {last}, {scale}, {interval * 1e3:.9g} mm",
                hint="write the table again",
            )
        below = number + 1 - first
        curve = np.concatenate([[0], np.cumsum(entries)])
        curve = curve - curve[below]
        fields = {**named_axes(identity(path, first=zero), axes, path), "reference": zero}
        return CompensationTable(
            positions=zero + interval * np.arange(-below, curve.size - below),
            forward=curve * (0.5 * unit * scale) + 0.0,
            reverse=None,
            is_exact_inverse=True,
            **fields,
        )


def _require_axes(table: CompensationTable, cross_axis: str) -> None:
    for name in (table.axis, table.compensates):
        if not _AXIS.fullmatch(name):
            raise TableError(f"axis {name!r} is no Mitsubishi axis: a capital and perhaps a digit")
    if not table.is_on_axis and cross_axis != "tried":
        raise TableError(
            f"the rule of signs is documented for an axis that corrects itself, this table is "
            f"{table.axis} -> {table.compensates}; write a trial table, see on the machine which way "
            "it moves, then say cross_axis='tried'"
        )


def _require_range(entries: IntArray, positions: FloatArray, unit: float) -> None:
    bad = np.flatnonzero((entries < _LOW) | (entries > _HIGH))
    if bad.size:
        i = int(bad[0])
        raise LimitError(
            f"the increment {int(entries[i])} between {positions[i] * 1e3:.9g} and "
            f"{positions[i + 1] * 1e3:.9g} mm leaves {_LOW} ... {_HIGH} steps of "
            f"{format_length(unit)}; use a smaller interval or a larger scale"
        )


def _text(
    table: CompensationTable,
    options: Mapping[str, Any],
    zero: float,
    numbers: tuple[int, int, int],
    steps: int,
    entries: IntArray,
) -> str:
    base = 4000 + 10 * (options["set_number"] - 1)
    values = (
        table.axis,
        table.compensates,
        *numbers,
        options["scale"],
        mm_text(steps * Decimal(repr(options["increment"]))),
    )
    lines = [
        (
            f"; MITSUBISHI MACHINE ERROR COMPENSATION, INCREMENTAL, OUTPUT UNIT "
            f"{mm_text(options['output_unit'])} MM, REFERENCE {mm_text(zero)} MM"
        )
    ]
    lines += [f"#{base + i} {v}" for i, v in enumerate(values, start=1)]
    lines += [f"#{numbers[1] + i} {int(v)}" for i, v in enumerate(entries)]
    return "\n".join([*lines, "; END"]) + "\n"


def _head(lines: list[str], path: Path) -> dict[str, Any]:
    if lines[-1:] != ["; END"]:
        raise CorruptFileError(
            path, "the list does not end with '; END': it was cut short", hint="write it again"
        )
    found = _FACTS.fullmatch(lines[0])
    if found is None:
        if lines[0].startswith("; MITSUBISHI"):
            raise CorruptFileError(path, "line 1: the comment is damaged", hint="write it again")
        return {}
    return {"output_unit": mm_value(found[1]), "reference_position": mm_value(found[2])}


def _parameters(lines: list[str], path: Path) -> tuple[dict[int, int], dict[int, str]]:
    """Return the compensation numbers and the settings."""
    numbers: dict[int, int] = {}
    words: dict[int, str] = {}
    for i, line in enumerate(lines[:-1], start=1):
        if line.startswith(";") and i == 1:
            continue
        found = _LINE.fullmatch(line)
        number = int(found[1]) if found else 0
        if found is None or not 4001 <= number <= _LAST or number in numbers or number in words:
            raise CorruptFileError(
                path,
                f"line {i} is no parameter, or one that stands twice: {line[:60]!r}",
                hint="one '#number value' a line",
            )
        if number < _FIRST:
            words[number] = found[2]
        elif _INTEGER.fullmatch(found[2]) and _LOW <= int(found[2]) <= _HIGH:
            numbers[number] = int(found[2])
        else:
            raise CorruptFileError(
                path, f"line {i}: {found[2]!r} is no whole number from {_LOW} to {_HIGH}"
            )
    return numbers, words


def _settings(
    words: Mapping[int, str], base: int, path: Path
) -> tuple[tuple[str, str], tuple[int, int, int, int], float]:
    wanted = [base + i for i in range(1, 8)]
    if sorted(words) != wanted:
        raise CorruptFileError(
            path,
            "the settings of one axis must be there, seven in a row from #4001, #4011 ...",
            found=", ".join(f"#{n}" for n in sorted(words))[:80] or "none",
            hint="write the table again",
        )
    values = [words[n] for n in wanted]
    good = [_AXIS.fullmatch(v) for v in values[:2]] + [_INTEGER.fullmatch(v) for v in values[2:6]]
    if not all(good) or not _DECIMAL.fullmatch(values[6]):
        raise CorruptFileError(
            path, f"a setting is no such value: {', '.join(values)[:80]}", hint="write it again"
        )
    a, b, c, d = (int(v) for v in values[2:6])
    return (values[0], values[1]), (a, b, c, d), mm_value(values[6])


def _entries(numbers: Mapping[int, int], first: int, last: int, path: Path) -> IntArray:
    wanted = range(first, last + 1)
    if not wanted or set(numbers) != set(wanted):
        raise CorruptFileError(
            path,
            f"the numbers do not run from #{first} to #{last} as the settings say",
            hint="a missing number keeps its old value in the control: write the table again",
        )
    return np.array([numbers[n] for n in wanted], dtype=np.int64)
