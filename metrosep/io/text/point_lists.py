"""Lines of points as text: contour ``.DAT`` and slices exported by Zygo Mx."""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from metrosep.core.errors import ReadError, ReadNameError, UnitError
from metrosep.core.profile import Profile
from metrosep.core.units import Unit, parse_unit
from metrosep.io.declared import Match
from metrosep.io.objects import Request, height_only, map_reader
from metrosep.io.registry import BuiltIn, mismatch
from metrosep.io.source import RawFile
from metrosep.io.text.dialect import is_number
from metrosep.io.text.logger import first_lines, number_block, numbered_rows, text_lines, to_number

# ---- Contour ``.DAT``: a unit, a count, then rows ``x, z``; written by contour measuring instruments
# Line 1 is the unit of both columns, line 2 the number of points (a hint: the rows that are there
# count). Positions usually fall; they are turned. See ``data_formats/contour-dat/SPEC.md``.

_CONTOUR_DAT = "contour-dat"
_WORD = re.compile(r"\s*([A-Za-zµμ]+)\s*")
_COUNT = re.compile(r"\s*(\d{1,10})\s*")


def _contour_dat_sniff(file: RawFile) -> Match:
    """Return how sure we are that a file is a contour file."""
    lines = list(itertools.islice(first_lines(file), 3))
    if len(lines) < 3 or _unit(lines[0]) is None or not _COUNT.fullmatch(lines[1]):
        return Match.NO
    fields = lines[2].split(",")
    is_row = len(fields) == 2 and all(f[:1] == " " and is_number(f, ".") for f in fields)
    return Match.YES if is_row else Match.NO


@map_reader(_CONTOUR_DAT, "contour", "a contour with its own unit", pixels=False)
def _contour_dat_read(asked: Request) -> Profile:
    """Return the profile of a contour file."""
    file = asked.file
    lines = text_lines(file)
    own = _unit(lines[0])
    if _contour_dat_sniff(file) is Match.NO or own is None:
        raise mismatch(file, _CONTOUR_DAT)
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


contour_dat = BuiltIn(_contour_dat_sniff, height_only, _contour_dat_read)


# ---- slices exported by Zygo Mx as CSV: header ``X ,Y ,Slice``, fields padded with blanks ------
# Each row is a position, a height and the name of its slice; an empty height is not measured.
# Several slices may follow one another in one file. Both columns are in um; the file does not say
# so, it is known of this export, so ``unit=`` overrides it. See ``data_formats/mx-slice/SPEC.md``.

_MX_SLICE = "mx-slice"
_HEADER = re.compile(r"X +,Y +,Slice *")
_NAMES = ("X", "Y")


def _mx_slice_sniff(file: RawFile) -> Match:
    """Return how sure we are that a file is a slice export of Mx."""
    lines = list(itertools.islice(first_lines(file), 2))
    if len(lines) < 2 or not _HEADER.fullmatch(lines[0]):
        return Match.NO
    return Match.YES if lines[1].count(",") == 2 and ",Slice" in lines[1] else Match.NO


def _mx_slice_channels(file: RawFile) -> tuple[str, ...]:
    """Return the names of the slices."""
    return tuple(_rows(file)[0])


@map_reader(_MX_SLICE, "Mx", several=True, pixels=False)
def _mx_slice_read(asked: Request) -> Profile:
    """Return one slice."""
    file = asked.file
    x_unit, z_unit = _units(file, asked.unit)
    slices, warnings = _rows(file)
    label = _choose(file, tuple(slices), asked.channel)
    if asked.channel is None and len(slices) > 1:
        others = ", ".join(repr(s) for s in list(slices)[1:21])
        warnings.append(
            f"read slice {label!r}; the file also holds {others}: choose with channel="
        )
    if asked.unit is None:
        warnings.append("the file states no units; X and Y were taken as um: unit= overrides it")
    x, z = np.array(slices[label], dtype=np.float64).T
    return asked.profile(
        x * x_unit.factor,
        z * z_unit.factor,
        header={"columns": ["X", "Y", "Slice"], "slices": {k: len(v) for k, v in slices.items()}},
        warnings=warnings,
        slice=label,
        x_unit=x_unit.name,
        height_unit=z_unit.name,
        units_from="caller" if asked.unit is not None else "known of this export",
    )


def _units(file: RawFile, unit: Any) -> tuple[Unit, Unit]:
    """Return the units of X and Y: um, or what the caller declares."""
    if unit is None or isinstance(unit, str):
        pair = [unit or "um"] * 2
    elif isinstance(unit, Mapping):
        unknown = [str(k) for k in unit if k not in _NAMES]
        if unknown:
            raise ReadNameError(
                f"{file.path}: has no column {unknown[0]!r}; the columns with a unit are X and Y"
            )
        pair = [str(unit.get(name, "um")) for name in _NAMES]
    else:
        pair = [str(u) for u in unit]
    if len(pair) != 2:
        raise ReadError(f"{file.path}: unit= has {len(pair)} units; give one, or those of X and Y")
    first, second = (parse_unit(u, dimension="length") for u in pair)
    return first, second


def _rows(file: RawFile) -> tuple[dict[str, list[tuple[float, float]]], list[str]]:
    """Return position and height of each row by slice, in the unit of the file, and warnings."""
    lines = text_lines(file)
    if not _HEADER.fullmatch(lines[0]):
        raise mismatch(file, _MX_SLICE)
    slices: dict[str, list[tuple[float, float]]] = {}
    for number, line in enumerate(lines[1:], start=2):
        if not line.strip():
            continue
        fields = line.split(",")
        if len(fields) != 3 or not fields[2].strip():
            raise file.corrupt(
                "a row does not fit",
                field=f"line {number}",
                expected="position, height and slice",
                found=repr(line[:60]),
            )
        x = to_number(file, fields[0], line=number, name="X")
        if np.isnan(x):
            raise file.corrupt("a row has no position", field=f"line {number}")
        z = to_number(file, fields[1], line=number, name="Y")
        slices.setdefault(fields[2].strip(), []).append((x, z))
    if not slices:
        raise file.corrupt("holds no row", field="line 2")
    return slices, file.cut_text()


def _choose(file: RawFile, labels: tuple[str, ...], channel: str | None) -> str:
    if channel is None:
        return labels[0]
    for label in labels:
        if label.lower() == channel.strip().lower():
            return label
    raise ReadNameError(
        f"{file.path}: has no slice {channel!r}; the slices are "
        f"{', '.join(repr(s) for s in labels[:20])}"
    )


mx_slice = BuiltIn(_mx_slice_sniff, _mx_slice_channels, _mx_slice_read)
