"""Gwyddion ASCII export: four comment lines, then the heights as a matrix of text.

The words of the comments follow the language of the program (``Width``, ``Breite`` ...), so lines are
known by their place: title, width, height, unit of the values. The decimal mark may be a comma.
See ``data_formats/gwyddion-ascii/SPEC.md``.
"""

from __future__ import annotations

import itertools
import re
from typing import Any

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import UnitError
from metrosep.core.surface import Surface
from metrosep.core.text_options import ROW_ORDERS
from metrosep.core.units import Unit, parse_unit
from metrosep.io.declared import Match
from metrosep.io.objects import Request, height_only, lateral_or_none, map_reader
from metrosep.io.registry import mismatch
from metrosep.io.source import RawFile, refuse_options
from metrosep.io.text.dialect import is_number
from metrosep.io.text.encoding import MISSING
from metrosep.io.text.logger import first_lines, number_block, numbered_rows, text_lines, to_number

channels = height_only

FORMAT = "gwyddion-ascii"
_COMMENT = re.compile(r"#\s*([^\W\d_][^\d:]{0,40}?)\s*:\s*(.*\S|)\s*")
_SIZE = re.compile(r"([0-9][0-9.,eE+-]*)\s*(\S{1,10})")
_UNIT = re.compile(r"\D.{0,20}|")
_N_HEADER = 4


def sniff(file: RawFile) -> Match:
    """Return how sure we are that a file is a Gwyddion ASCII export."""
    lines = list(itertools.islice(first_lines(file), _N_HEADER + 1))
    if len(lines) <= _N_HEADER:
        return Match.NO
    values = [m[2] if (m := _COMMENT.fullmatch(line)) else None for line in lines[:_N_HEADER]]
    sizes = all(v is not None and _SIZE.fullmatch(v) for v in values[1:3])
    if values[0] is None or not sizes or values[3] is None or not _UNIT.fullmatch(values[3]):
        return Match.NO
    row = lines[_N_HEADER].split()
    numbers = (f.lower() in MISSING or is_number(f, ".") or is_number(f, ",") for f in row)
    return Match.YES if row and all(numbers) else Match.NO


@map_reader(FORMAT, "Gwyddion ASCII", pixels=False)
def read(asked: Request) -> Surface:
    """Return the map of a Gwyddion ASCII export."""
    file = asked.file
    if sniff(file) is Match.NO:
        raise mismatch(file, FORMAT)
    lines = text_lines(file)
    comments = [_COMMENT.fullmatch(line) for line in lines[:_N_HEADER]]
    words, values = zip(*((m[1], m[2]) for m in comments if m), strict=True)
    z_unit = _value_unit(file, values[3], asked.unit)
    z = _matrix(file, lines)
    warnings = file.cut_text()
    sizes = tuple(_size(file, n, values[n], warnings) for n in (1, 2))
    own = tuple(
        None if s is None else lateral_or_none(file, words[n], s / count, warnings)
        for n, s, count in zip((1, 2), sizes, z.shape[::-1], strict=True)
    )
    return asked.surface(
        z * z_unit.factor,
        (own[0], own[1]),
        row_order=ROW_ORDERS[1],
        header=dict(zip(words, values, strict=True)),
        warnings=warnings,
        title=values[0],
        width_m=sizes[0],
        height_m=sizes[1],
        unit_in_file=values[3],
    )


def _value_unit(file: RawFile, text: str, declared: Any) -> Unit:
    """Return the unit of the values: that of the file, else the declared one."""
    if text:
        refuse_options(file, "a Gwyddion export that states its unit", unit=declared)
        try:
            return parse_unit(text, dimension="length")
        except UnitError as exc:
            raise UnitError(
                f"{file.path}: the values are in {text!r}, which is not a height ({str(exc)[:60]})"
            ) from None
    if declared is None:
        raise UnitError(
            f"{file.path}: states no unit of the values; declare it, such as unit='nm'"
        )
    return parse_unit(str(declared), dimension="length")


def _size(file: RawFile, n: int, text: str, warnings: list[str]) -> float | None:
    """Return a side of the map in m, or None where its unit is none of length."""
    match = _SIZE.fullmatch(text)
    number = match[1] if match else ""
    decimal = "," if "," in number else "."
    value = to_number(file, number, line=n + 1, name="the size of the map", decimal=decimal)
    try:
        return value * parse_unit(match[2] if match else "", dimension="length").factor
    except UnitError:
        warnings.append(
            f"line {n + 1} gives {text!r}, which is not a length: taken as not calibrated"
        )
        return None


def _matrix(file: RawFile, lines: list[str]) -> FloatArray:
    rows = numbered_rows(lines[_N_HEADER:], _N_HEADER + 1)
    rows = [(n, line) for n, line in rows if not line.startswith("#")]
    decimal = "," if any("," in line for _, line in rows) else "."
    return number_block(file, rows, decimal=decimal)
