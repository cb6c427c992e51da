"""Points of a Mitaka MLP file: two versions of the header, the rows, and where its lines begin.

All numbers of the header are hints: they give warnings, never an error, and are never used to cut
or pad.
"""

from __future__ import annotations

import itertools
import re
from dataclasses import dataclass

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, FormatMismatchError
from metrosep.io.logger import first_lines, text_lines, to_number
from metrosep.io.source import RawFile

__all__ = ["AXES", "Points", "is_mlp", "read_points"]

AXES = ("X", "Y", "Z")
"""Names of the columns."""

_MM = 1e-3
_TITLE = "X,Y,Z"
_OLD, _NEW = re.compile(r"3D_\d{3},(\d{1,4})\s*"), re.compile(r"MLP-\d+ 3D CSV\s*")
_MARKS = ("AF gain,", "AF sensor,")
_MAX_HEADER = 200


@dataclass(frozen=True)
class Points:
    """Points of a file, where each line begins, and what the header says."""

    header: dict[str, list[str]]  # fields of each header line by its first one
    xyz: FloatArray  # shape (n, 3), m: columns X, Y, Z
    bounds: list[int]  # first point of each line, and the number of points
    stepping: str | None  # the stepping axis, where the header names it
    first_line: int  # line of the first point in the file, from 1
    warnings: list[str]  # what is odd about the file


def is_mlp(file: RawFile) -> bool:
    """Return whether a file has the first line of either version, and the lines on the autofocus."""
    lines = list(itertools.islice(first_lines(file), _MAX_HEADER))
    known = bool(lines) and (_OLD.fullmatch(lines[0]) or _NEW.fullmatch(lines[0]))
    return bool(known) and all(any(line.startswith(m) for line in lines) for m in _MARKS)


def read_points(file: RawFile) -> Points:
    """Return the points of an MLP file."""
    lines = text_lines(file)
    if not is_mlp(file):
        raise FormatMismatchError(
            f"{file.path}: is no MLP file: expected '3D_003,24' or 'MLP-2 3D CSV' in line 1 and lines on "
            f"the autofocus, found {lines[0][:40]!r}"
        )
    title = next((i for i, s in enumerate(lines[:_MAX_HEADER]) if s.strip() == _TITLE), None)
    if title is None:
        raise CorruptFileError(file.path, "the header has no end", expected=f"a line {_TITLE}")
    header: dict[str, list[str]] = {}
    for line in filter(str.strip, lines[:title]):
        key, *values = (f.strip() for f in line.split(","))
        header[key] = values
    xyz = _numbers(file, lines, title + 1)
    warnings = []
    old = _OLD.fullmatch(lines[0])
    if old and int(old[1]) != title + 1:
        warnings.append(f"the header declares {old[1]} lines and has {title + 1}")
    declared, pitch, stepping = _declared(header)
    if declared and declared != len(xyz):
        warnings.append(
            f"the header declares {declared} points and the file holds {len(xyz)}; all were read"
        )
    for axis in AXES:
        high, low = (_value(header, f"{word} in {axis} direction", 0) for word in ("Max.", "Min."))
        if high < low:
            warnings.append(f"Max. in {axis} direction is less than Min. in {axis} direction")
    bounds = _bounds(xyz, pitch * _MM, stepping)
    return Points(header, xyz, bounds, stepping, title + 2, warnings)


def _numbers(file: RawFile, lines: list[str], start: int) -> FloatArray:
    rows = [(n, s.split(",")) for n, s in enumerate(lines[start:], start=start + 1) if s.strip()]
    if len(rows) < 2:
        raise CorruptFileError(
            file.path, "has no points", field=f"line {start + 1}", expected="2 rows or more"
        )
    xyz = np.empty((len(rows), 3))
    for k, (line, fields) in enumerate(rows):
        if len(fields) != 3:
            raise CorruptFileError(
                file.path,
                "a point has another number of coordinates",
                field=f"line {line}",
                expected=3,
                found=len(fields),
            )
        for j in range(3):
            xyz[k, j] = to_number(file, fields[j], line=line, name=AXES[j])
    if np.isnan(xyz).any():
        line = rows[int(np.flatnonzero(np.isnan(xyz).any(axis=1))[0])][0]
        raise CorruptFileError(file.path, "a coordinate is missing", field=f"line {line}")
    return xyz * _MM


def _value(header: dict[str, list[str]], key: str, index: int) -> float:
    """Return a number of the header, NaN where there is none: all of them are hints."""
    try:
        return float(header[key][index])
    except (KeyError, IndexError, ValueError):
        return float("nan")


def _declared(header: dict[str, list[str]]) -> tuple[int, float, str | None]:
    """Return count of points, stepping pitch in mm (0: one line) and stepping axis, if stated."""
    if "Axis" in header:
        n, m = _value(header, "Number of data", 0), _value(header, "Number of data", 1)
        pitch = _value(header, "Pitch", 1)
        axis = header["Axis"][1] if len(header["Axis"]) > 1 else ""
        stepping = axis if axis in AXES else None
    else:
        n, m = (_value(header, f"Number of points in {a} direction", 0) for a in "XY")
        pitch, stepping = _value(header, "Pitch", 3), None
    whole = np.isfinite(n * m) and 0 < n * m < 2**40
    several = m > 1 and np.isfinite(pitch) and pitch > 0
    return (int(n * m) if whole else 0), (float(pitch) if several else 0.0), stepping


def _bounds(xyz: FloatArray, pitch: float, stepping: str | None) -> list[int]:
    """Return where lines begin: the stepping coordinate moves by more than half its pitch."""
    if pitch == 0.0:
        return [0, len(xyz)]
    moves = np.abs(np.diff(xyz, axis=0))
    column = int(np.median(moves, axis=0).argmin()) if stepping is None else AXES.index(stepping)
    cuts = np.flatnonzero(moves[:, column] > 0.5 * pitch) + 1
    return [0, *(int(c) for c in cuts), len(xyz)]
