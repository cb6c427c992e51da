"""Etalon exchange format: one error parameter of ISO 230-1, such as EXY, over one axis.

Beckhoff (TF5280) and ISG kernels read it and make the correction themselves, so an entry is an
error, not a correction. Which way an error counts is not in the pages that could be read, and the
kernel can negate axes: a file is written only after a trial on the machine.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from metrosep.compensation.area_errors import is_rotary
from metrosep.compensation.table import CompensationTable
from metrosep.controllers._facts import is_note, note, read_notes, read_table, settled
from metrosep.controllers._grammar import decoded, fixed, is_real, joined, short
from metrosep.controllers._grids import DRY_RUN, require_one_direction
from metrosep.controllers.base import (
    Dialect,
    DialectInfo,
    Encoded,
    identity,
    load_sidecar,
    sidecar_options,
)
from metrosep.controllers.options import ENTRY_SIGN, Option, whole
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    CorruptFileError,
    DataError,
    Example,
    LimitError,
    TableError,
    UnsupportedFeatureError,
)

_MM = 1e-3
_DEGREE = float(np.pi) / 180.0
_TURNING = "ABC"
_POSITION_DECIMALS = 9
_LETTERS = "XYZABC"
_COMPONENT = re.compile(r"E([XYZABC])([XYZABC])")
_SECTION = re.compile(r"\[([A-Z]\w\w)\]", re.ASCII)
_VALUE = re.compile(r"VALUE *= *(\S+)")
_OPEN = re.compile(r"Gridpoints *= *\{")


@dataclass(frozen=True, slots=True)
class _Rows:
    """One look-up table: its parameter, its rows, and what metrosep's comment says about it."""

    parameter: str
    rows: FloatArray
    noted: Mapping[str, str]


class Etalon(Dialect):
    """Writer and reader of one error parameter; see the module."""

    info = DialectInfo(
        id="etalon",
        title="Etalon exchange format, for Beckhoff TF5280 and ISG volumetric compensation",
        entry="+e with entry_sign=1, an error parameter of ISO 230-1; -e with entry_sign=-1",
        units="mm for lengths, rad for angles; positions mm, of a turning axis degrees",
        outside="not documented; simulated as constant",
        sign_status="not stated in the pages of TF5280 that could be read; the kernel can negate axes",
        activation=(
            "hochlauf.lis: vol_comp[0].max_records at least the number of rows of all files",
            "hochlauf.lis: vol_comp[0].file_name = the list with axes, kinematic chain and file[j]",
            "the list: this file as file[0], its file_format[0] that of Etalon, variant 'Vendor'",
            "the letters X, Y, Z, A, B, C of the list must be the axes the machine was measured with",
            "switch VOLCOMP on, move over a bump and read the change; 'negate XY' turns axes round",
        ),
        sign="unconfirmed",
        spacing="free",
        directions="one",
        resolution="1 fm with 12 decimals of a mm, 1 prad of an angle",
        reference_rule="none",
        suffix=".txt",
        example={},
        page="etalon",
    )

    options = (
        Option("parameter", "name after ISO 230-1 such as EXY; from the axes if omitted", "text"),
        ENTRY_SIGN,
        whole("records_limit", "max_records of hochlauf.lis", 2),
        whole("decimals", "of an entry", 1, 15, default=12),
    )

    def encode(self, table: CompensationTable, **options: Any) -> Encoded:
        o = self.filled(options)
        parameter = _parameter(table, o["parameter"])
        table = require_one_direction(table, "an error parameter", "into the backlash parameter")
        n = table.positions.size
        if o["records_limit"] is not None and n > o["records_limit"]:
            raise LimitError(
                f"{n} rows, the control keeps {o['records_limit']} (max_records): raise it, or make "
                "the table with fewer positions"
            )
        place, unit = _units(parameter)
        d = o["decimals"]
        words = [
            (
                short(p / place, _POSITION_DECIMALS, at_least=1),
                fixed(-o["entry_sign"] * c / unit, d),
            )
            for p, c in zip(table.positions, table.forward, strict=True)
        ]
        back = np.array(words, dtype=np.float64)
        if (np.diff(back[:, 0]) <= 0).any():
            raise TableError(f"positions closer than 1e-{_POSITION_DECIMALS} cannot be written")
        sign = "+" if o["entry_sign"] > 0 else "-"
        code = [f"[{parameter}]", "Gridpoints = {", *(f"          {p} {e}" for p, e in words), "}"]
        facts = {"entry_sign": o["entry_sign"], "parameter": parameter, "rows": n}
        lines = [
            f"// entry = {sign}e, {DRY_RUN}",
            f"// {note(facts, code)}",
            *code[:-1],
            f"}}  // end of {parameter}",
        ]
        wrong = -o["entry_sign"] * back[:, 1] * unit - table.forward
        return Encoded(
            data=joined(lines),
            quantisation=float(np.abs(wrong).max()),
            notes={"parameter": parameter, "max_records_at_least": n},
            step=10.0**-d * unit,
        )

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationTable:
        """Return one look-up table of a file as corrections."""
        told = {**sidecar_options(path, self.options), **options}
        chosen = _chosen(_read(data, path), told.get("parameter"), path)
        o = settled(
            self.options, options, path, file=chosen.noted, needed=("entry_sign",), partial=True
        )
        place, unit = _units(chosen.parameter)
        positions = chosen.rows[:, 0] * place
        fields = identity(path)
        if not load_sidecar(path):
            fields |= {"axis": chosen.parameter[2], "compensates": chosen.parameter[1]}
        forward = 0.0 - o["entry_sign"] * chosen.rows[:, 1] * unit
        return read_table(positions, forward, **fields)


def _parameter(table: CompensationTable, wanted: str | None) -> str:
    name = f"E{table.compensates}{table.axis}" if wanted is None else wanted
    if not _COMPONENT.fullmatch(name):
        raise DataError(
            f"{name!r} is not an error parameter of ISO 230-1: E, the direction of the error and the axis "
            f"that moves, of X, Y, Z, A, B, C; the table is {table.axis} -> {table.compensates}; give "
            "parameter='EXY', or name the axes of the table so"
        ).hinting(parameter=Example("EXY"))
    pairs = ((table.compensates, name[1]), (table.axis, name[2]))
    if any(is_rotary(axis) != (letter in _TURNING) for axis, letter in pairs):
        raise DataError(
            f"{name} and the table {table.axis} -> {table.compensates} mix lengths and angles"
        )
    if any(len(axis) == 1 and axis in _LETTERS and axis != letter for axis, letter in pairs):
        raise DataError(
            f"parameter={name} is the error in {name[1]} over {name[2]}, but the table is {table.axis} -> "
            f"{table.compensates}, which is E{table.compensates}{table.axis}; leave parameter out, or "
            "make the table for the axes it is meant for"
        )
    return name


def _units(parameter: str) -> tuple[float, float]:
    """Return the units of positions and entries, m or rad."""
    return (_DEGREE if parameter[2] in _TURNING else _MM, 1.0 if parameter[1] in _TURNING else _MM)


def _chosen(tables: Mapping[str, _Rows], wanted: str | None, path: Path) -> _Rows:
    names = ", ".join(tables)
    if wanted is None and len(tables) > 1:
        raise UnsupportedFeatureError(
            f"{path}: it holds the tables {names}; choose one with parameter="
        )
    if wanted is not None and wanted not in tables:
        raise DataError(f"{path}: no table of {wanted} in it; there are {names}")
    return tables[wanted] if wanted is not None else next(iter(tables.values()))


def _read(data: bytes, path: Path) -> dict[str, _Rows]:
    """Return the look-up tables of a file; a comment of metrosep belongs to the next section."""
    text = decoded(data, path, "file of Etalon", encoding="utf-8-sig")
    code: list[tuple[int, str]] = []
    notes: list[tuple[int, str]] = []
    for number, line in enumerate(text.splitlines(), start=1):
        words, _, comment = line.partition("//")
        if is_note(comment):
            notes.append((number, comment))
        if words.strip():
            code.append((number, words.strip()))
    tables: dict[str, _Rows] = {}
    seen: set[str] = set()
    at = after = 0
    while at < len(code):
        number, line = code[at]
        match = _SECTION.fullmatch(line)
        if match is None:
            raise CorruptFileError(path, f"line {number} is not a [parameter]: {line[:60]!r}")
        if match[1] in seen:
            raise CorruptFileError(path, f"line {number}: a second [{match[1]}]")
        seen.add(match[1])
        start = at
        at, rows = _block(code, at + 1, number, match[1], path)
        last = code[at - 1][0] if at < len(code) else number + data.count(b"\n") + 1
        own = [c for n, c in notes if after < n <= last]
        after = last
        if rows is not None:
            noted = read_notes(own, [words for _, words in code[start:at]], path)
            tables[match[1]] = _Rows(match[1], rows, noted)
    if not tables:
        raise CorruptFileError(path, "it holds no look-up table", expected="[EXY] and Gridpoints")
    return tables


def _block(
    code: list[tuple[int, str]], at: int, start: int, name: str, path: Path
) -> tuple[int, FloatArray | None]:
    """Return where the next section starts, and the rows of this one if it has any."""
    number, line = code[at] if at < len(code) else (start, "")
    value = _VALUE.fullmatch(line)
    if value is not None and is_real(value[1]):
        return at + 1, None
    if not _OPEN.fullmatch(line):
        raise CorruptFileError(
            path,
            f"line {number}: [{name}] is followed by {line[:40]!r}",
            expected="VALUE = number or Gridpoints = {",
        )
    if not _COMPONENT.fullmatch(name):
        raise CorruptFileError(path, f"line {start}: {name} is not an error over an axis")
    rows: list[tuple[float, float]] = []
    for number, line in code[at + 1 :]:
        if line == "}":
            break
        words = line.split()
        if len(words) != 2 or not all(map(is_real, words)):
            raise CorruptFileError(
                path, f"line {number} is not a position and an error but {line[:60]!r}"
            )
        rows.append((float(words[0]), float(words[1])))
        if len(rows) > 1 and rows[-1][0] <= rows[-2][0]:
            raise CorruptFileError(path, f"line {number}: the position does not rise")
    else:
        raise CorruptFileError(path, f"[{name}] does not end with }}: the file was cut short")
    if len(rows) < 2:
        raise CorruptFileError(path, f"[{name}] needs at least 2 rows", found=len(rows))
    return at + 2 + len(rows), np.array(rows)
