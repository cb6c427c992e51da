"""The text of an Aerotech 2-D table: written and read strictly, lengths along the encoders."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from metrosep.controllers._notes import agreed, note, read_notes
from metrosep.controllers.base import sidecar_options
from metrosep.controllers.options import Option
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, DataError, UnsupportedFeatureError

__all__ = ["Grid", "read_grid", "write_grid"]


_MM = 1e-3
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)", re.ASCII)
_WHOLE = re.compile(r"\d{1,9}", re.ASCII)
_WORD = re.compile(r"([A-Z][A-Z0-9]*)\s*=\s*(\S+)")
_UNIT = re.compile(r"(METRIC|PRIMARY)(?:/(\d{1,9}))?", re.ASCII)
_LARGEST = 1e12
"""No distance, offset or entry of a file is as large, in any unit."""

_START = ":START2D"
_KEYS = ("OUTAXIS3", "POSUNIT", "CORUNIT", "OFFSETROW", "OFFSETCOL")


@dataclass(frozen=True, slots=True)
class Grid:
    """A 2-D table as it stands in the file."""

    row_axis: int  # numbers of the axes along rows and columns and of the corrected one, from 1
    column_axis: int
    output: int
    row_step: float  # m: sample distances; negative where the encoder counts against its axis
    column_step: float
    row_offset: float  # m: as the file holds them: minus the first position
    column_offset: float
    values: FloatArray  # shape (rows, columns), m: entries along the encoder of the corrected axis


def _mm(value: float) -> str:
    """Return a length in mm, with three decimals or as many as it takes."""
    text = f"{value / _MM + 0.0:.12f}".rstrip("0")
    whole, _, decimals = text.partition(".")
    text = f"{whole}.{decimals:0<3}"
    return text.removeprefix("-") if not float(text) else text


def write_grid(grid: Grid, o: dict[str, Any], names: tuple[str, ...]) -> tuple[str, FloatArray]:
    """Return the file, and its entries as printed, in m."""
    first = grid.output == grid.column_axis
    third = "" if grid.output in (grid.row_axis, grid.column_axis) else f"OUTAXIS3={grid.output} "
    um = grid.values * 1e6
    words = [[_entry(v, o["decimals"]) for v in row] for row in um]
    cell = "0 0 {}" if third else ("{} 0" if first else "0 {}")
    width = max(
        len(cell) - 2 + o["decimals"] + 3, *(len(cell.format(w)) for r in words for w in r)
    )
    facts: dict[str, Any] = {
        "corrected_sign": o["corrected_sign"],
        "offset_follows": o["offset_follows"],
        "corrected_axis": grid.output,
        "rows": len(words),
    }
    if all(n.isascii() and n.isalnum() for n in names):
        facts |= {"axes": f"{names[0]},{names[1]}", "corrects": names[2]}
    row, column = grid.row_axis, grid.column_axis
    numbers = f"{row:<3} {column:<3} {column:<4} {row:<3}"
    offsets = f"OFFSETROW={_mm(grid.row_offset)} OFFSETCOL={_mm(grid.column_offset)}"
    lines = [
        f"{_START} {numbers} {_mm(grid.row_step)} {_mm(grid.column_step)} {um.shape[1]}",
        f"{_START} {third}POSUNIT=METRIC CORUNIT=METRIC/1000 {offsets}",
        *("   ".join(cell.format(w).ljust(width) for w in row).rstrip() for row in words),
        ":END",
    ]
    lines[:0] = [f"; {note(facts, lines)}", ";       row col out1 out2 dRow  dCol  nCols"]
    return "\n".join(lines) + "\n", np.array(words, dtype=np.float64) * 1e-6


def _entry(value: float, decimals: int) -> str:
    text = f"{value:.{decimals}f}"
    return text.removeprefix("-") if not float(text) else text


def read_grid(
    data: bytes, path: Path, known: tuple[Option, ...], given: dict[str, Any], controller: str
) -> tuple[Grid, dict[str, Any]]:
    """Return the table of a file, and the facts about the machine that are known."""
    lines, noted = _lines(data, path)
    told = {**sidecar_options(path, known), **given}
    facts: dict[str, Any] = {
        **{k: v for k, v in noted.items() if k in ("axes", "corrects")},
        **agreed(noted, known, told, path),
    }
    if "corrected_sign" not in facts:
        raise DataError(
            f"{path}: neither the file nor a sidecar tells how the encoder of the corrected axis "
            f"counts; give corrected_sign=1 or -1 to read it as {controller}"
        )
    grid = _parsed(lines, path, facts)
    for name, found in (
        ("row_sign", math.copysign(1, grid.row_step)),
        ("column_sign", math.copysign(1, grid.column_step)),
        ("row_axis", grid.row_axis),
        ("column_axis", grid.column_axis),
        ("corrected_axis", grid.output),
    ):
        if facts.get(name) not in (None, found):
            raise DataError(f"{path}: you say {name}={facts[name]}, the file says {found:g}")
    return grid, facts


def _lines(data: bytes, path: Path) -> tuple[list[tuple[int, str]], dict[str, str]]:
    """Return the lines that are not comments, with their numbers, and metrosep's own comment."""
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as exc:
        raise CorruptFileError(path, "not UTF-8 text", offset=exc.start) from None
    lines: list[tuple[int, str]] = []
    comments: list[str] = []
    for number, line in enumerate(text.splitlines(), start=1):
        words, mark, comment = line.partition(";")
        if mark:
            comments.append(comment)
        if words.strip():
            lines.append((number, words.strip()))
    return lines, read_notes(comments, [code for _, code in lines], path)


def _parsed(lines: list[tuple[int, str]], path: Path, facts: dict[str, Any]) -> Grid:
    starts = [i for i, (_, code) in enumerate(lines) if code.startswith(_START)]
    ends = [i for i, (_, code) in enumerate(lines) if code == ":END"]
    if len(starts) > 2 or len(ends) > 1:
        raise UnsupportedFeatureError(
            f"{path}: it holds several tables, which the controller adds up; read one table a file"
        )
    if starts != [0, 1] or ends != [len(lines) - 1]:
        raise CorruptFileError(
            path,
            "a table is two lines :START2D, rows of numbers and :END, and nothing else",
            found=f"{len(starts)} :START2D and {len(ends)} :END in {len(lines)} lines",
            hint="it was cut short, or is no 2-D calibration of Aerotech",
        )
    numbers = _header(lines[0], path)
    words = _keys(lines[1], path)
    axes = [int(v) for v in numbers[:4]]
    columns = int(numbers[6])
    outputs = [axes[2], axes[3]] + ([int(words["OUTAXIS3"])] if "OUTAXIS3" in words else [])
    unit, cell = (_unit(words[k], lines[1][0], path, facts) for k in ("POSUNIT", "CORUNIT"))
    rows = [_row(line, columns * len(outputs), path) for line in lines[2:-1]]
    if len(rows) < 2:
        raise CorruptFileError(path, "a table needs at least 2 rows", found=len(rows))
    values = np.array(rows).reshape(len(rows), columns, len(outputs)) * cell
    which = _output(values, outputs, path, facts)
    return Grid(
        row_axis=axes[0],
        column_axis=axes[1],
        output=outputs[which],
        row_step=numbers[4] * unit,
        column_step=numbers[5] * unit,
        row_offset=float(words["OFFSETROW"]) * unit,
        column_offset=float(words["OFFSETCOL"]) * unit,
        values=values[:, :, which],
    )


def _output(values: FloatArray, outputs: list[int], path: Path, facts: dict[str, Any]) -> int:
    used = [i for i in range(len(outputs)) if values[:, :, i].any()]
    if len(used) > 1:
        raise UnsupportedFeatureError(
            f"{path}: it corrects {len(used)} axes at once; metrosep reads corrections of one axis"
        )
    if used:
        return used[0]
    wanted = facts.get("corrected_axis")
    return outputs.index(wanted) if wanted in outputs else len(outputs) - 1


def _header(line: tuple[int, str], path: Path) -> list[float]:
    number, code = line
    words = code.removeprefix(_START).split()
    fine = len(words) == 7 and all(map(_NUMBER.fullmatch, words))
    values = [float(w) for w in words] if fine else []
    if (
        not values
        or not all(map(_WHOLE.fullmatch, [*words[:4], *words[6:]]))
        or max(map(abs, values)) > _LARGEST
        or min(*values[:4], values[6]) < 1
        or values[6] < 2
        or not values[4]
        or not values[5]
        or values[0] == values[1]
    ):
        raise CorruptFileError(
            path,
            f"line {number} is not a table's first line but {code[:60]!r}",
            expected=":START2D row, column, output 1, output 2 (whole numbers from 1), row distance, "
            "column distance, columns (2 or more)",
        )
    return values


def _keys(line: tuple[int, str], path: Path) -> dict[str, str]:
    number, code = line
    rest = code.removeprefix(_START)
    found = _WORD.findall(rest)
    words = dict(found)
    problem = ""
    if _WORD.sub("", rest).strip() or len(words) != len(found):
        problem = "is not a list of KEY=VALUE"
    elif unknown := [k for k in words if k not in _KEYS]:
        problem = f"holds the unknown key {unknown[0]}"
    elif missing := [k for k in _KEYS[1:] if k not in words]:
        problem = f"lacks {missing[0]}"
    elif not all(_is_number(words[k]) for k in _KEYS[3:]):
        problem = "holds an offset that is not a number"
    elif not _WHOLE.fullmatch(words.get("OUTAXIS3", "1")) or not int(words.get("OUTAXIS3", "1")):
        problem = "holds an OUTAXIS3 that is not the number of an axis"
    if problem:
        raise CorruptFileError(path, f"line {number} {problem}: {code[:60]!r}")
    return words


def _unit(text: str, number: int, path: Path, facts: dict[str, Any]) -> float:
    match = _UNIT.fullmatch(text)
    if match is None or (match[2] is not None and not int(match[2])):
        raise UnsupportedFeatureError(
            f"{path}: line {number}: unit {text[:40]!r}; metrosep reads METRIC and PRIMARY, also divided "
            "as in METRIC/1000"
        )
    whole = _MM if match[1] == "METRIC" else facts.get("primary_unit")
    if whole is None:
        raise DataError(
            f"{path}: line {number}: the unit is PRIMARY, that of the axis; say how long it is, "
            "primary_unit='1 mm'"
        )
    return float(whole) / int(match[2] or 1)


def _row(line: tuple[int, str], count: int, path: Path) -> list[float]:
    number, code = line
    words = code.split()
    if len(words) != count or not all(map(_is_number, words)):
        raise CorruptFileError(
            path,
            f"line {number} is not a row of {count} numbers but {code[:60]!r}",
            found=f"{len(words)} words",
        )
    return [float(w) for w in words]


def _is_number(word: str) -> bool:
    return bool(_NUMBER.fullmatch(word)) and abs(float(word)) <= _LARGEST
