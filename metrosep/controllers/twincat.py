"""TwinCAT Tc2_MC2: table of MC_TableBasedPositionCompensation as a global variable list (ST text).

Entry: Compensation is additive to the uncorrected set position, so it is the correction -e, in mm
as the positions. Positions are equidistant and rise. The parameter structure also has a direction
and a modulo field, which belong into the program that calls the function block.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from metrosep.compensation.table import CompensationTable
from metrosep.controllers._facts import own_axis
from metrosep.controllers._grammar import (
    Line,
    Text,
    Word,
    ascii_lines,
    damaged,
    fixed,
    joined,
    mm_value,
)
from metrosep.controllers._grids import (
    Resampling,
    carry,
    require_linear,
    require_on_axis,
    require_one_direction,
    require_sizes,
    uniform_positions,
)
from metrosep.controllers.base import DialectInfo, Encoded, identity
from metrosep.controllers.options import Option
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, TableError

__all__ = ["TwinCAT"]


_TITLE = "TwinCAT 3 Tc2_MC2 position compensation table"
_CAPACITY = 100_000
"""No limit is documented; a table beyond this is a mistake of units."""
_FARTHEST, _LARGEST = 1e3, 1.0
"""Position and correction beyond which units are mistaken, m."""
_DECIMALS = 9
"""Decimals of a mm: 1 pm; LREAL holds them."""
_UNIFORM = 1e-8
"""Deviation of printed positions from equal spacing in mm: rounding of the last decimal."""

_NAME = re.compile(r"[A-Za-z]\w{0,59}", re.ASCII)
_KEYWORDS = (
    " ABS ACTION ADD ADR AND AND_THEN ANY ARRAY AT BIT BOOL BY BYTE CAL CASE CLASS CONFIGURATION "
    "CONSTANT CONTINUE DATE DATE_AND_TIME DINT DIV DO DT DWORD ELSE ELSIF END_ACTION END_CASE "
    "END_CLASS END_CONFIGURATION END_FOR END_FUNCTION END_FUNCTION_BLOCK END_IF END_INTERFACE "
    "END_METHOD END_NAMESPACE END_PROGRAM END_PROPERTY END_REPEAT END_RESOURCE END_STEP END_STRUCT "
    "END_TRANSITION END_TYPE END_UNION END_VAR END_WHILE EQ EXIT EXTENDS EXTERNAL FALSE FINAL FOR "
    "FROM FUNCTION FUNCTION_BLOCK GE GT IF IMPLEMENTS INITIAL_STEP INT INTERFACE INTERNAL JMP LDATE "
    "LE LIMIT LINT LREAL LT LTIME LTOD LWORD MAX METHOD MIN MOD MOVE MUL MUX NAMESPACE NE NOT OF ON "
    "OR OR_ELSE OVERRIDE PERSISTENT POINTER PRIVATE PROGRAM PROPERTY PROTECTED PUBLIC READ_ONLY "
    "READ_WRITE REAL REFERENCE REPEAT RESOURCE RET RETAIN RETURN SEL SINGLE SINT SIZEOF STEP STRING "
    "STRUCT SUB SUPER TASK THEN THIS TIME TIME_OF_DAY TO TOD TRANSITION TRUE TRUNC TYPE UDINT UINT "
    "ULINT UNION UNTIL USING USINT VAR VAR_ACCESS VAR_CONFIG VAR_EXTERNAL VAR_GLOBAL VAR_INPUT "
    "VAR_INST VAR_IN_OUT VAR_OUTPUT VAR_STAT VAR_TEMP WCHAR WHILE WITH WORD WSTRING XOR "
)
"""Words of ST (IEC 61131-3 with the additions of TwinCAT); capitals do not matter."""
_MM = Word(r"-?\d{1,9}\.\d{1,12}", mm_value)
_IDENTIFIER = Word(r"\w+")
_TYPE = "ST_PositionCompensationTableElement"
_LAYOUT = {
    "begin": Line("VAR_GLOBAL"),
    "open": Line(f"{{name}} : ARRAY[1..{{size}}] OF {_TYPE} := [", name=_IDENTIFIER),
    "row": Line(
        "(Position := {p}, Compensation := {c}){comma}", p=_MM, c=_MM, comma=Word(",?")
    ),
    "close": Line("];"),
    "parameter": Line(
        "{name}Parameter : ST_PositionCompensationTableParameter := (MinPosition := {low}, "
        "MaxPosition := {high}, NoOfTableElements := {size});",
        name=_IDENTIFIER, low=_MM, high=_MM,
    ),
    "end": Line("END_VAR"),
}  # fmt: skip
"""Lines of the list, without their indents."""
_COMMENT = re.compile(r"\(\* [^*()]* \*\)")


class TwinCAT(Resampling):
    """Writer and reader of the ST table; see the module."""

    info = DialectInfo(
        id="twincat",
        title=_TITLE,
        entry="correction -e, additive to the uncorrected set position",
        units="mm (position unit of the axis)",
        outside="not documented; taken as constant beyond both ends: cover the whole travel",
        sign_status="documented: the compensation is additive to the uncorrected set position",
        activation=(
            "import the text as a global variable list (GVL) of the PLC project, build, download",
            (
                "call MC_TableBasedPositionCompensation with pTable := ADR(table), TableSize := "
                "SIZEOF(table) and the parameter structure of the list"
            ),
            (
                "set Direction to both directions and Modulo FALSE in that structure, Ramp to a speed "
                "the axis can follow, home the axis, then Enable"
            ),
            "compare CurrentCorrection with the table at some positions in both directions",
            "write one table for each direction if lost motion matters, or use the backlash setting",
        ),
        spacing="uniform",
        directions="one",
        resolution="1 pm",
        suffix=".TcGVL.txt",
        page="twincat",
    )

    options = (
        Option(
            "interval",
            "spacing; that of the table if omitted",
            "length",
            positive=True,
            highest=100.0,
        ),
        Option("name", "name of the variable", "text", default="CompTable"),
    )

    def encode(self, table: CompensationTable, **options: Any) -> Encoded:
        """Return the declarations of table and parameters."""
        require_linear((table.axis, table.compensates), _TITLE)
        require_on_axis(
            table, _TITLE, "'isg-cross' (TwinCAT CNC), or 'csv' for a program of your own"
        )
        table = require_one_direction(
            table, _TITLE, "as backlash of the axis, or write a table for each direction"
        )
        require_sizes(table, _TITLE, farthest=_FARTHEST, largest=_LARGEST)
        name = options["name"]
        _require_name(name)
        positions = uniform_positions(
            table, interval=options["interval"], max_points=_CAPACITY, title=_TITLE
        )
        carried = carry(table, positions)
        rows = [
            (fixed(p * 1e3, _DECIMALS), fixed(c * 1e3, _DECIMALS))
            for p, c in zip(positions, carried.table.forward, strict=True)
        ]
        back = np.array([[mm_value(v) for v in row] for row in rows])
        if (np.diff(back[:, 0]) <= 0).any():
            raise TableError(f"positions closer than 1e-{_DECIMALS} mm cannot be written")
        n, ends = len(rows), {"low": rows[0][0], "high": rows[-1][0]}
        lines = [
            "(* metrosep: correction -e in mm, additive to the set position *)",
            _LAYOUT["begin"].write(),
            "  " + _LAYOUT["open"].write(name=name, size=n),
            *(
                "    " + _LAYOUT["row"].write(p=p, c=c, comma="," if i < n else "")
                for i, (p, c) in enumerate(rows, start=1)
            ),
            "  " + _LAYOUT["close"].write(),
            "  " + _LAYOUT["parameter"].write(name=name, size=n, **ends),
            _LAYOUT["end"].write(),
        ]
        return Encoded(
            joined(lines),
            float(np.abs(back[:, 1] - carried.table.forward).max()),
            carried=carried.table,
            resampling_error=carried.error,
        )

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationTable:
        lines = enumerate(ascii_lines(data, path, "ST table of TwinCAT"), start=1)
        rows = [(i, line.strip()) for i, line in lines]
        rows = [row for row in rows if row[1] and not _COMMENT.fullmatch(row[1])]
        text = Text(path, rows, "ST table of TwinCAT")
        text.take(_LAYOUT["begin"])
        opened = text.take(_LAYOUT["open"])
        wanted = options.get("name") or opened["name"]
        found = text.many(_LAYOUT["row"])
        text.take(_LAYOUT["close"])
        closed = text.take(_LAYOUT["parameter"])
        text.take(_LAYOUT["end"])
        text.end()
        if opened["name"] != wanted or closed["name"] != wanted:
            raise CorruptFileError(
                path,
                "another variable",
                expected=wanted,
                found=f"{opened['name']}, {closed['name']}Parameter",
                hint="give name= of the variable, or write the table again",
            )
        table = np.array([(row["p"], row["c"]) for row in found]).reshape(-1, 2)
        _require_frame(table, [row["comma"] for row in found], opened["size"], closed, path)
        return CompensationTable(
            table[:, 0],
            table[:, 1],
            None,
            is_exact_inverse=True,
            **own_axis(identity(path, first=float(table[0, 0])), path),
        )


def _require_name(name: str) -> None:
    """Refuse what IEC 61131-3 does not take as the name of a variable."""
    is_word = f" {name.upper()} " in _KEYWORDS
    if not _NAME.fullmatch(name) or "__" in name or name.endswith("_") or is_word:
        raise TableError(
            f"name={name[:60]!r} is not an ST identifier: letters, digits and single underscores, up to 60, "
            "and no word of the language"
        )


def _require_frame(
    table: FloatArray, commas: list[str], size: int, closed: dict[str, Any], path: Path
) -> None:
    """Refuse counts, commas, ends and spacing that do not fit together."""
    n = table.shape[0]
    if n < 2 or n != size or n != closed["size"]:
        raise damaged(
            path,
            "the number of elements does not fit",
            expected=f"{size} and {closed['size']}",
            found=n,
        )
    if commas != [","] * (n - 1) + [""]:
        raise damaged(path, "a comma is missing or too many")
    p = table[:, 0] * 1e3
    even = p[0] + (p[-1] - p[0]) / (n - 1) * np.arange(n)
    if (np.diff(p) <= 0).any() or np.abs(p - even).max() > _UNIFORM:
        i = int(np.abs(p - even).argmax())
        raise CorruptFileError(
            path,
            f"element {i + 1}: the positions are not equidistant and rising",
            found=f"{p[i]:.9g} mm",
            hint="TwinCAT needs equal steps: write the table again",
        )
    if (closed["low"], closed["high"]) != (table[0, 0], table[-1, 0]):
        raise damaged(path, "MinPosition and MaxPosition are not the ends of the table")
