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

from metrosep.compensation.area_errors import is_rotary
from metrosep.compensation.table import CompensationTable
from metrosep.controllers._facts import named_axes, read_table, settled
from metrosep.controllers._grammar import (
    AXIS,
    INTEGER,
    MM,
    Line,
    Text,
    Word,
    ascii_lines,
    damaged,
    joined,
    mm_text,
    mm_value,
)
from metrosep.controllers._grids import (
    Resampling,
    require_names,
    require_one_direction,
    require_sizes,
    sections,
    walked,
)
from metrosep.controllers.base import DialectInfo, Encoded, identity
from metrosep.controllers.options import Option, pick, unit_option, whole
from metrosep.core.errors import CorruptFileError, Example, TableError

_TITLE = "Mitsubishi machine error compensation"
_FIRST, _LAST = 4101, 5124
_LOW, _HIGH = -128, 127
_CAPACITY = _LAST - _FIRST + 1

_HEAD = Line(
    "; MITSUBISHI MACHINE ERROR COMPENSATION, INCREMENTAL, OUTPUT UNIT {output_unit} MM, REFERENCE "
    "{reference_position} MM{by}",
    output_unit=MM,
    reference_position=MM,
    by=Word("(?:, MADE BY METROSEP)?"),  # lists of earlier versions do not say it
)
_LINE = Line("#{number} {value}", value=Word(r"\S+"))
_SETTINGS = (AXIS, AXIS, *4 * (INTEGER,), Word(r"\d{1,6}\.?\d{0,12}", mm_value, mm_text))
"""Looked-up and corrected axis; reference, first and last number, scale; interval."""


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
        spacing="uniform",
        directions="one",
        resolution="half an output unit times scale factor",
        reference_rule="zero at the reference point (#4003)",
        suffix=".txt",
        example={"output_unit": "100 nm"},
        page="mitsubishi",
    )

    options = (
        unit_option("output_unit", "unit of output of the control"),
        whole("scale", "parameter #4006", 1, 99, default=1),
        whole("set_number", "set of parameters, 1 for #4001", 1, 10, default=1),
        whole(
            "reference_number",
            "parameter #4003; the lowest that fits if omitted",
            _FIRST - 1,
            _LAST,
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
        pick(
            "cross_axis",
            "a table that corrects another axis than it looks up: its sign is not documented",
            ("refuse", "tried"),
            default="refuse",
        ),
    )

    def encode(self, table: CompensationTable, **options: Any) -> Encoded:
        """Return parameters and numbers."""
        for axis in (table.axis, table.compensates):
            if is_rotary(axis):
                raise TableError(
                    f"{_TITLE}: axis {axis} turns, and the rotary rule was not found in public pages (unit "
                    "of the interval, points of one turn, what happens after it); write controller='csv' "
                    "and enter it after your manual"
                )
        table = require_one_direction(table, _TITLE, "into #2011 and #2012 (backlash)")
        _require_axes(table, options["cross_axis"])
        require_sizes(table, _TITLE)
        unit = 0.5 * options["output_unit"] * options["scale"]
        made = sections(
            table,
            options,
            title=_TITLE,
            unit=unit,
            most=_CAPACITY + 1,
            numbers=(_FIRST, _LAST),
            limits=(_LOW, _HIGH),
            larger="scale",
        )
        steps = round(made.interval / options["increment"])
        values = (
            table.axis, table.compensates, made.number, made.first, made.last, options["scale"],
            steps * Decimal(repr(options["increment"])),
        )  # fmt: skip
        base = 4000 + 10 * (options["set_number"] - 1)
        lines = [
            _HEAD.write(
                output_unit=options["output_unit"],
                reference_position=made.zero,
                by=", MADE BY METROSEP",
            ),
            *(
                _LINE.write(number=base + i, value=word.write(v))
                for i, (word, v) in enumerate(zip(_SETTINGS, values, strict=True), start=1)
            ),
            *(
                _LINE.write(number=made.first + i, value=str(int(v)))
                for i, v in enumerate(made.rounded.entries)
            ),
            "; END",
        ]
        return Encoded(
            joined(lines),
            made.rounded.error,
            step=unit,
            carried=made.carried.table,
            resampling_error=made.carried.error,
        )

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationTable:
        """Return the cumulative corrections."""
        lines = ascii_lines(data, path, "list of Mitsubishi parameters")
        if lines[-1] != "; END":
            raise damaged(path, "the list does not end with '; END': it was cut short")
        head = _HEAD.read(lines[0])
        if head is None and lines[0].startswith("; MITSUBISHI"):
            raise damaged(path, "line 1: the comment is damaged")
        first_row = 1 if lines[0].startswith(";") else 0
        rows = list(enumerate(lines, start=1))[first_row:-1]
        words = Text(path, rows, "list of Mitsubishi parameters").table(_LINE, "number")
        base, stated = _stated(words, path)
        axes, (number, first, last, scale, interval) = (stated[0], stated[1]), stated[2:]
        known = settled(
            self.options, options, path, partial=True,
            file={**(head or {}), "reference_number": number, "scale": scale},
            needed=("output_unit", "reference_position"),
        )  # fmt: skip
        wanted = options.get("set_number")
        if wanted is not None and base != 4000 + 10 * (wanted - 1):
            raise CorruptFileError(
                path,
                "another set of parameters",
                expected=f"#{4001 + 10 * (wanted - 1)}",
                found=f"#{base + 1}",
                hint="choose the list of this axis",
            )
        entries = _entries(words, first, last, path)
        if not (first - 1 <= number <= last and 1 <= scale <= 99 and interval > 0.0):
            raise damaged(
                path,
                "the reference must lie between the ends, the interval be positive and the scale "
                "factor 1 to 99",
                found=f"{number}, {first}, {last}, {scale}, {interval * 1e3:.9g} mm",
            )
        zero, unit = known["reference_position"], 0.5 * known["output_unit"] * scale
        positions, forward = walked(entries, number + 1 - first, zero, interval, unit)
        fields = {**named_axes(identity(path, first=zero), axes, path), "reference": zero}
        return read_table(positions, forward, **fields)


def _require_axes(table: CompensationTable, cross_axis: str) -> None:
    require_names(table, "Mitsubishi")
    if not table.is_on_axis and cross_axis != "tried":
        raise TableError(
            f"the rule of signs is documented for an axis that corrects itself, this table is "
            f"{table.axis} -> {table.compensates}; write a trial table, see on the machine which way "
            "it moves, then say cross_axis='tried'"
        ).hinting(cross_axis=Example("tried"))


def _stated(words: Mapping[int, Mapping[str, Any]], path: Path) -> tuple[int, list[Any]]:
    """Return the number before the settings of one axis, and what they are."""
    numbers = sorted(n for n in words if n < _FIRST)
    base = 4000 + 10 * ((numbers[0] - 4001) // 10) if numbers else 0
    if numbers != [base + i for i in range(1, 8)] or base < 4000:
        raise damaged(
            path,
            "the settings of one axis must be there, seven in a row from #4001, #4011 ...",
            found=", ".join(f"#{n}" for n in numbers)[:80] or "none",
        )
    values = [words[n]["value"] for n in numbers]
    for word, value, number in zip(_SETTINGS, values, numbers, strict=True):
        if not re.fullmatch(word.pattern, value, re.ASCII):
            raise damaged(
                path, f"line {words[number]['line']}: #{number} cannot be {value[:40]!r}",
            )  # fmt: skip
    return base, [word.read(v) for word, v in zip(_SETTINGS, values, strict=True)]


def _entries(
    words: Mapping[int, Mapping[str, Any]], first: int, last: int, path: Path
) -> NDArray[np.int64]:
    """Return the increments, all of them and each in its range."""
    numbers = {n: row for n, row in words.items() if n >= _FIRST}
    for row in numbers.values():
        is_whole = re.fullmatch(r"-?\d{1,5}", row["value"], re.ASCII)
        if is_whole is None or not _LOW <= int(row["value"]) <= _HIGH:
            raise CorruptFileError(
                path,
                f"line {row['line']}: {row['value'][:40]!r} is not a whole number from {_LOW} to {_HIGH}",
            )
    wanted = range(first, last + 1)
    if not wanted or set(numbers) != set(wanted):
        raise CorruptFileError(
            path,
            f"the numbers do not run from #{first} to #{last} as the settings say",
            hint="a missing number keeps its old value in the control: write the table again",
        )
    return np.array([int(numbers[n]["value"]) for n in wanted], dtype=np.int64)
