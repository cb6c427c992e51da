"""TwinCAT Tc2_MC2: table of MC_TableBasedPositionCompensation as a global variable list (ST text).

Entry: Compensation is additive to the uncorrected set position, so it is the correction -e, in mm
as the positions, or in degrees for an axis that turns. Positions are equidistant and rise. Of the
parameter structure Modulo and Direction are written where they are not FALSE and both: a modulo
table covers 0 to 360 deg, and a table for each direction is a variable and a structure of its own.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from metrosep.compensation.area_errors import is_rotary
from metrosep.compensation.table import CompensationTable
from metrosep.controllers._facts import letter_in_file, own_axis, read_table
from metrosep.controllers._grammar import (
    IEC_WORDS,
    Line,
    Text,
    Word,
    ascii_lines,
    damaged,
    deg_value,
    fixed,
    joined,
    mm_value,
)
from metrosep.controllers._grids import (
    Repeating,
    Resampling,
    carry,
    require_on_axis,
    require_one_direction,
    require_sizes,
    uniform_positions,
)
from metrosep.controllers.base import DialectInfo, Encoded, identity
from metrosep.controllers.options import (
    INTERVAL,
    Option,
    axes_of,
    chosen,
    flag,
    in_axes,
    require_turn,
    require_whole_turn,
)
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, TableError

_TITLE = "TwinCAT 3 Tc2_MC2 position compensation table"
_CAPACITY = 100_000
"""No limit is documented; a table beyond this is a mistake of units."""
_DECIMALS = 9
"""Decimals of a mm, 1 pm, or of a degree; LREAL holds them."""
_UNIFORM = 1e-8
"""Deviation of printed positions from equal spacing in mm or mrad: rounding of the last decimal."""

_NAME = re.compile(r"[A-Za-z]\w{0,59}", re.ASCII)
_USUAL = "CompTable"
"""Name of the variable where nobody gives one; of a list that is read any name will do then."""
_IDENTIFIER = Word(r"\w+")
_TYPE = "ST_PositionCompensationTableElement"
_STRUCTURE = "ST_PositionCompensationTableParameter"
_WAYS = {0: "", 1: "WorkDirectionPositive", -1: "WorkDirectionNegative"}
"""Values of E_WorkDirection; without one it is WorkDirectionBoth."""
_DIRECTION = Word(
    r"(?:, Direction := WorkDirection(?:Both|Positive|Negative))?",
    lambda text: {"": 0, "Both": 0, "Positive": 1, "Negative": -1}[
        text.partition("WorkDirection")[2]
    ],
    lambda way: f", Direction := {_WAYS[way]}" if way else "",
)
_MODULO = Word(
    r"(?:, Modulo := (?:TRUE|FALSE))?",
    lambda text: text.endswith("TRUE"),
    lambda modulo: ", Modulo := TRUE" if modulo else "",
)


def _layout(read: Callable[[str], float]) -> dict[str, Line]:
    """Return the lines of a list, without their indents, for a unit of positions and corrections."""
    number = Word(r"-?\d{1,9}(?:\.\d{1,12})?", read)
    return {
        "begin": Line("VAR_GLOBAL"),
        "open": Line(f"{{name}} : ARRAY[1..{{size}}] OF {_TYPE} := [", name=_IDENTIFIER),
        "row": Line(
            "(Position := {p}, Compensation := {c}){comma}", p=number, c=number, comma=Word(",?")
        ),
        "close": Line("];"),
        "parameter": Line(
            f"{{name}} : {_STRUCTURE} := (MinPosition := {{low}}, "
            "MaxPosition := {high}, NoOfTableElements := {size}{direction}{modulo});",
            name=_IDENTIFIER, low=number, high=number, direction=_DIRECTION, modulo=_MODULO,
        ),
        "end": Line("END_VAR"),
    }  # fmt: skip


_LAYOUTS = {False: _layout(mm_value), True: _layout(deg_value)}
"""By whether the axis turns."""
_NOTE = "(* metrosep: correction -e in {unit}, additive to the set position *)"
_REVERSE = "Reverse"
"""What is appended to the name of the variable for travel in - direction."""
_BETWEEN = re.compile(r"(?<=:= \[)\s*(?=\()|(?<=\),)\s*(?=\()|(?<=\))\s*(?=\];)")
"""Where a person, or a tool, need not begin a new line."""
_COMMENT = re.compile(r"\(\* [^*()]* \*\)")
_REMARK = re.compile(r"//.*|^[ \t]*\{attribute[^{}\n]*\}", re.MULTILINE | re.IGNORECASE)
_GLOBAL = re.compile(
    r"^\s*VAR_GLOBAL(?: (?:CONSTANT|PERSISTENT|RETAIN))*[ \t]*$", re.MULTILINE | re.IGNORECASE
)
_ARRAY = re.compile(
    rf"(\w+)\s*:\s*ARRAY\s*\[\s*(\d+)\s*\.\.\s*(\d+)\s*\]\s*OF\s+{_TYPE}\s*:=\s*\[", re.IGNORECASE
)
_ELEMENT = re.compile(
    r"\(\s*Position\s*:=\s*([^\s,()]+)\s*,\s*Compensation\s*:=\s*([^\s,()]+)\s*\)", re.IGNORECASE
)
_FIELDS = re.compile(rf"(\w+)\s*:\s*{_STRUCTURE}\s*:=\s*\(([^()]*)\)\s*;", re.IGNORECASE)
_FIELD = re.compile(r"\s*(\w+)\s*:=\s*(?:E_WorkDirection\s*\.\s*)?([\w.+-]+)\s*")
_ORDER = ("MinPosition", "MaxPosition", "NoOfTableElements", "Direction", "Modulo")


class TwinCAT(Repeating, Resampling):
    """Writer and reader of the ST table; see the module."""

    info = DialectInfo(
        id="twincat",
        title=_TITLE,
        entry="correction -e, additive to the uncorrected set position",
        units="mm, of an axis that turns deg (position unit of the axis)",
        outside="not documented; taken as constant beyond both ends: cover the whole travel; with "
        "Modulo := TRUE it repeats",
        sign_status="documented: the compensation is additive to the uncorrected set position",
        activation=(
            "import the text as a global variable list (GVL) of the PLC project, build, download",
            (
                "call MC_TableBasedPositionCompensation with pTable := ADR(table), TableSize := "
                "SIZEOF(table) and the parameter structure of the list"
            ),
            (
                "set Ramp to a speed the axis can follow, home the axis, then Enable; Direction and Modulo "
                "are as the structure says, both directions and FALSE where it does not"
            ),
            "compare CurrentCorrection with the table at some positions in both directions",
            (
                "a table for each direction (bidirectional=True) is one call for each; whether two may be "
                "enabled on one axis is not documented: see that both show in CurrentCorrection"
            ),
        ),
        spacing="uniform",
        directions="one",
        resolution="1 pm, or 1e-9 deg",
        suffix=".TcGVL.txt",
        page="twincat",
    )

    options = (
        replace(INTERVAL, help="spacing; that of the table if omitted"),
        flag(
            "modulo",
            "Modulo := TRUE: the table of 0 to 360 deg repeats, for an axis that turns on",
        ),
        flag(
            "bidirectional",
            "write a table for each direction (Direction of the parameter structure)",
        ),
        Option("name", "name of the variable", "text", default=_USUAL),
    )

    def encode(self, table: CompensationTable, **options: Any) -> Encoded:
        """Return the declarations of table and parameters."""
        require_on_axis(
            table, _TITLE, "'isg-cross' (TwinCAT CNC), or 'csv' for a program of your own"
        )
        o = in_axes(self.options, options, axes_of(table))
        if not o["bidirectional"]:
            table = require_one_direction(
                table,
                _TITLE,
                "as backlash of the axis, or say bidirectional=True for a table for each direction",
            )
        turns = is_rotary(table.axis)
        layout = _LAYOUTS[turns]
        unit = math.radians(1.0) if turns else 1e-3
        if o["modulo"]:
            table = require_turn(table, unit * 10.0**-_DECIMALS, first=0.0)
            require_whole_turn(o["interval"], _TITLE)
        require_sizes(table, _TITLE)
        _require_name(o["name"])
        positions = uniform_positions(
            table, interval=o["interval"], max_points=_CAPACITY, title=_TITLE
        )
        carried = carry(table, positions)
        made = carried.table
        ways = {0: made.forward} if made.reverse is None else {1: made.forward, -1: made.reverse}
        places = _texts(positions, turns=turns)
        back = np.array([layout["row"].words["p"].read(v) for v in places])
        if (np.diff(back) <= 0).any():
            raise TableError(
                f"positions closer than 1e-{_DECIMALS} {'deg' if turns else 'mm'} cannot be written"
            )
        lines, off = [], 0.0
        for way, column in ways.items():
            values = _texts(column, turns=turns)
            read = np.array([layout["row"].words["c"].read(v) for v in values])
            off = max(off, float(np.abs(read - column).max()))
            name = o["name"] + (_REVERSE if way < 0 else "")
            lines += _declared(layout, name, places, values, way, modulo=o["modulo"])
        note = _NOTE.format(unit="deg" if turns else "mm")
        return Encoded(
            joined([note, layout["begin"].write(), *lines, layout["end"].write()]),
            off,
            carried=made,
            resampling_error=carried.error,
            options=chosen(self.options, o),
        )

    def _read(
        self, data: bytes, path: Path, options: dict[str, Any]
    ) -> tuple[CompensationTable, bool]:
        """Return the table of one or of both directions, and whether it repeats."""
        text = _as_we_write("\n".join(ascii_lines(data, path, "ST table of TwinCAT")))
        lines = enumerate(text.split("\n"), start=1)
        rows = [
            (i, row.strip()) for i, line in lines for row in _BETWEEN.sub("\n", line).split("\n")
        ]
        notes = [row[1] for row in rows if _COMMENT.fullmatch(row[1])]
        rows = [row for row in rows if row[1] and not _COMMENT.fullmatch(row[1])]
        rest = Text(path, rows, "ST table of TwinCAT")
        turns = _turns(notes, [row[1] for row in rows])
        letter = letter_in_file(path, turns, options)
        layout = _LAYOUTS[is_rotary(letter)]
        rest.take(layout["begin"])
        told = options.get("name")
        one = _take(rest, layout, path, None if told == _USUAL else told)
        ways = {one.way: one}
        if one.way:
            two = _take(rest, layout, path, None)
            ways[two.way] = two
            if one.facts == f"{two.name}Parameter" or two.facts == f"{one.name}Parameter":
                raise damaged(path, "each table must be followed by its own parameters")
            if {*ways} != {1, -1} or two.modulo != one.modulo or (two.p != one.p).any():
                raise damaged(
                    path,
                    "two tables of one axis must be those of both directions, at the same positions",
                )
        rest.take(layout["end"])
        rest.end()
        if one.modulo:
            _require_turn(ways.values(), letter, path)
        fields = own_axis(identity(path), path)
        table = read_table(
            one.p,
            ways[1].c if one.way else one.c,
            ways[-1].c if one.way else None,
            **{**fields, "axis": letter, "compensates": letter},
        )
        return table, one.modulo


@dataclass(frozen=True, slots=True)
class _Declared:
    """One table of a list, read."""

    name: str
    p: FloatArray  # m or rad, rising
    c: FloatArray
    way: int  # 1, -1, or 0 for both directions
    modulo: bool
    facts: str  # name of the structure that says them


def _texts(values: FloatArray, *, turns: bool) -> list[str]:
    """Return numbers of the file: mm or degrees."""
    scaled = np.degrees(values) if turns else np.asarray(values) * 1e3
    return [fixed(float(v), _DECIMALS) for v in scaled]


def _declared(
    layout: dict[str, Line], name: str, p: list[str], c: list[str], way: int, *, modulo: bool
) -> list[str]:
    """Return the declarations of one table and its parameters."""
    n = len(p)
    rows = enumerate(zip(p, c, strict=True), start=1)
    parameter = layout["parameter"].write(
        name=f"{name}Parameter", size=n, low=p[0], high=p[-1], direction=way, modulo=modulo
    )
    return [
        "  " + layout["open"].write(name=name, size=n),
        *(
            "    " + layout["row"].write(p=at, c=value, comma="," if i < n else "")
            for i, (at, value) in rows
        ),
        "  " + layout["close"].write(),
        "  " + parameter,
    ]


def _as_we_write(text: str) -> str:
    """Return ST as a person typed it in the words and blanks of ours; what is no such list stays."""

    def structure(found: re.Match[str]) -> str:
        fields = [_FIELD.fullmatch(part) for part in found[2].split(",")]
        names = {name.lower(): name for name in _ORDER}
        known = {names.get(f[1].lower()): f[2] for f in fields if f}
        if None in known or len(known) < len(fields):
            return found[0]
        inside = ", ".join(f"{name} := {known[name]}" for name in _ORDER if name in known)
        return f"{found[1]} : {_STRUCTURE} := ({inside});" + "\n" * found[0].count("\n")

    def array(found: re.Match[str]) -> str:
        size = int(found[3]) - int(found[2]) + 1
        return f"{found[1]} : ARRAY[1..{size}] OF {_TYPE} := [" + "\n" * found[0].count("\n")

    text = _GLOBAL.sub("VAR_GLOBAL", _REMARK.sub("", text))
    text = _ELEMENT.sub(r"(Position := \1, Compensation := \2)", _FIELDS.sub(structure, text))
    return re.sub(r"\)[ \t]*,", "),", _ARRAY.sub(array, text))


def _take(text: Text, layout: dict[str, Line], path: Path, wanted: str | None) -> _Declared:
    """Return the next table of a list."""
    opened = text.take(layout["open"])
    wanted = wanted or opened["name"]
    found = text.many(layout["row"])
    text.take(layout["close"])
    closed = text.take(layout["parameter"])
    if opened["name"] != wanted:
        raise CorruptFileError(
            path,
            "another variable",
            expected=wanted,
            found=opened["name"],
            hint="give name= of the variable, or write the table again",
        )
    table = np.array([(row["p"], row["c"]) for row in found]).reshape(-1, 2)
    _require_frame(table, [row["comma"] for row in found], opened["size"], closed, path)
    return _Declared(
        wanted, table[:, 0], table[:, 1], closed["direction"], closed["modulo"], closed["name"]
    )


def _turns(notes: list[str], rows: list[str]) -> bool | None:
    """Return whether a list is in degrees, as its comment or Modulo says; None if nothing does."""
    for turns, unit in ((False, "mm"), (True, "deg")):
        if _NOTE.format(unit=unit) in notes:
            return turns
    return True if any("Modulo := TRUE" in row for row in rows) else None


def _require_turn(tables: Iterable[_Declared], axis: str, path: Path) -> None:
    """Refuse a modulo table that is not one from 0 to 360 deg with the first value equal to the last."""
    for t in tables:
        off = max(abs(float(t.p[0])), abs(float(t.p[-1]) - 2.0 * math.pi))
        if not is_rotary(axis) or off > 1e-9 or t.c[0] != t.c[-1]:
            raise CorruptFileError(
                path,
                "a modulo table must cover 0 to 360 deg of an axis that turns, with the first value equal "
                "to the last",
                hint="enter the value of 0 again at 360 deg",
            )


def _require_name(name: str) -> None:
    """Refuse what IEC 61131-3 does not take as the name of a variable."""
    is_word = f" {name.upper()} " in IEC_WORDS
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
    p = table[:, 0]
    even = p[0] + (p[-1] - p[0]) / (n - 1) * np.arange(n)
    if (np.diff(p) <= 0).any() or np.abs(p - even).max() > _UNIFORM * 1e-3:
        i = int(np.abs(p - even).argmax())
        raise CorruptFileError(
            path,
            f"element {i + 1}: the positions are not equidistant and rising",
            found=f"{p[i] * 1e3:.9g} mm",
            hint="TwinCAT needs equal steps: write the table again",
        )
    if (closed["low"], closed["high"]) != (table[0, 0], table[-1, 0]):
        raise damaged(path, "MinPosition and MaxPosition are not the ends of the table")
