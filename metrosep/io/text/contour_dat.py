"""Contour ``.DAT``: a unit, a count, then rows ``x, z``; written by contour measuring instruments.

Line 1 is the unit of both columns, line 2 the number of points (a hint: the rows that are there
count). Positions usually fall; they are turned. See ``data_formats/contour-dat/SPEC.md``.
"""

from __future__ import annotations

import itertools
import re
from typing import Any

import numpy as np

from metrosep.core.errors import CorruptFileError, FormatMismatchError, UnitError
from metrosep.core.profile import Profile
from metrosep.core.units import Unit, parse_unit
from metrosep.io.objects import (
    height_only as channels,
    make_profile,
    only_channels,
)
from metrosep.io.registry import Match
from metrosep.io.source import RawFile, lateral_steps, refuse_options
from metrosep.io.text.dialect import is_number
from metrosep.io.text.logger import first_lines, text_lines, to_number

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


def read(
    file: RawFile, *, channel: str | None = None, lateral_step: Any = None, unit: Any = None
) -> Profile:
    """Return the profile of a contour file."""
    refuse_options(file, "a contour with its own unit", unit=unit)
    only_channels(file, "contour", channel)
    override = lateral_steps(lateral_step)
    if sniff(file) is Match.NO:
        raise FormatMismatchError(
            f"{file.path}: is no contour file: expected a unit such as mm in line 1, a count in line 2 "
            "and 'x, z' in line 3; leave out format= to have it recognised"
        )
    lines = text_lines(file)
    own = _unit(lines[0])
    if own is None:  # sniff has seen it
        raise FormatMismatchError(f"{file.path}: line 1 is no unit of length")
    rows = [(n, s.split(",")) for n, s in enumerate(lines[2:], start=3) if s.strip()]
    points = np.empty((2, len(rows)))
    for k, (line, fields) in enumerate(rows):
        if len(fields) != 2:
            raise CorruptFileError(
                file.path,
                "a row does not hold a position and a height",
                field=f"line {line}",
                expected=2,
                found=len(fields),
            )
        for j, name in enumerate(("x", "z")):
            points[j, k] = to_number(file, fields[j], line=line, name=name)
    warnings = file.cut_text()
    declared = int(lines[1])
    if declared != len(rows):
        warnings.append(
            f"line 2 declares {declared} points and the file holds {len(rows)}; all were read"
        )
    return make_profile(
        file,
        FORMAT,
        points[0] * own.factor,
        points[1] * own.factor,
        header={"unit": lines[0].strip(), "count": declared},
        override=override[0] if override else None,
        warnings=warnings,
        unit_in_file=own.name,
    )


def _unit(line: str) -> Unit | None:
    word = _WORD.fullmatch(line)
    try:
        return parse_unit(word[1], dimension="length") if word else None
    except UnitError:
        return None
