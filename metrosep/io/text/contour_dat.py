"""Contour ``.DAT``: a unit, a count, then rows ``x, z``; written by contour measuring instruments.

Line 1 is the unit of both columns, line 2 the number of points (a hint: the rows that are there
count). Positions usually fall; they are turned. See ``data_formats/contour-dat/SPEC.md``.
"""

from __future__ import annotations

import itertools
import re

from metrosep.core.errors import UnitError
from metrosep.core.profile import Profile
from metrosep.core.units import Unit, parse_unit
from metrosep.io.declared import mismatch
from metrosep.io.objects import (
    Request,
    height_only as channels,
    map_reader,
)
from metrosep.io.registry import Match
from metrosep.io.source import RawFile
from metrosep.io.text.dialect import is_number
from metrosep.io.text.logger import first_lines, number_block, numbered_rows, text_lines

__all__ = ["channels", "read", "sniff"]

FORMAT = "contour-dat"
_WORD = re.compile(r"\s*([A-Za-zµμ]+)\s*")
_COUNT = re.compile(r"\s*(\d{1,10})\s*")


def sniff(file: RawFile) -> Match:
    """Return how sure we are that a file is a contour file."""
    lines = list(itertools.islice(first_lines(file), 3))
    if len(lines) < 3 or _unit(lines[0]) is None or not _COUNT.fullmatch(lines[1]):
        return Match.NO
    fields = lines[2].split(",")
    is_row = len(fields) == 2 and all(f[:1] == " " and is_number(f, ".") for f in fields)
    return Match.YES if is_row else Match.NO


@map_reader(FORMAT, "contour", "a contour with its own unit", pixels=False)
def read(asked: Request) -> Profile:
    """Return the profile of a contour file."""
    file = asked.file
    lines = text_lines(file)
    own = _unit(lines[0])
    if sniff(file) is Match.NO or own is None:
        raise mismatch(file, FORMAT)
    points = number_block(file, numbered_rows(lines[2:], 3), names=("x", "z"), separator=",").T
    warnings = file.cut_text()
    declared = int(lines[1])
    if declared != points.shape[1]:
        warnings.append(
            f"line 2 declares {declared} points and the file holds {points.shape[1]}; all were read"
        )
    return asked.profile(
        points[0] * own.factor,
        points[1] * own.factor,
        header={"unit": lines[0].strip(), "count": declared},
        warnings=warnings,
        unit_in_file=own.name,
    )


def _unit(line: str) -> Unit | None:
    word = _WORD.fullmatch(line)
    try:
        return parse_unit(word[1], dimension="length") if word else None
    except UnitError:
        return None
