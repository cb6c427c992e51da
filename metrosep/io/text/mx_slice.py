"""Slices exported by Zygo Mx as CSV: header ``X ,Y ,Slice``, fields padded with blanks.

Each row is a position, a height and the name of its slice; an empty height is not measured.
Several slices may follow one another in one file. Both columns are in um; the file does not say
so, it is known of this export, so ``unit=`` overrides it. See ``data_formats/mx-slice/SPEC.md``.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from metrosep.core.errors import CorruptFileError, FormatMismatchError, ReadError
from metrosep.core.profile import Profile
from metrosep.core.units import Unit, parse_unit
from metrosep.io.objects import make_profile
from metrosep.io.registry import Match
from metrosep.io.source import RawFile, lateral_steps
from metrosep.io.text.logger import first_lines, text_lines, to_number

__all__ = ["channels", "read", "sniff"]

FORMAT = "mx-slice"
_HEADER = re.compile(r"X +,Y +,Slice *")
_NAMES = ("X", "Y")


def sniff(file: RawFile) -> Match:
    """Return how sure we are that a file is a slice export of Mx."""
    lines = list(itertools.islice(first_lines(file), 2))
    if len(lines) < 2 or not _HEADER.fullmatch(lines[0]):
        return Match.NO
    return Match.YES if lines[1].count(",") == 2 and ",Slice" in lines[1] else Match.NO


def channels(file: RawFile) -> tuple[str, ...]:
    """Return the names of the slices."""
    return tuple(_rows(file)[0])


def read(
    file: RawFile,
    *,
    channel: str | None = None,
    lateral_step: Any = None,
    unit: Any = None,
) -> Profile:
    """Return one slice."""
    x_unit, z_unit = _units(file, unit)
    override = lateral_steps(lateral_step)
    slices, warnings = _rows(file)
    label = _choose(file, tuple(slices), channel)
    if channel is None and len(slices) > 1:
        others = ", ".join(repr(s) for s in list(slices)[1:21])
        warnings.append(
            f"read slice {label!r}; the file also holds {others}: choose with channel="
        )
    if unit is None:
        warnings.append("the file states no units; X and Y were taken as um: unit= overrides it")
    x, z = np.array(slices[label], dtype=np.float64).T
    return make_profile(
        file,
        FORMAT,
        x * x_unit.factor,
        z * z_unit.factor,
        header={"columns": ["X", "Y", "Slice"], "slices": {k: len(v) for k, v in slices.items()}},
        override=override[0] if override else None,
        warnings=warnings,
        slice=label,
        x_unit=x_unit.name,
        height_unit=z_unit.name,
        units_from="caller" if unit is not None else "known of this export",
    )


def _units(file: RawFile, unit: Any) -> tuple[Unit, Unit]:
    """Return the units of X and Y: um, or what the caller declares."""
    if unit is None or isinstance(unit, str):
        pair = [unit or "um"] * 2
    elif isinstance(unit, Mapping):
        unknown = [str(k) for k in unit if k not in _NAMES]
        if unknown:
            raise FormatMismatchError(
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
        raise FormatMismatchError(
            f"{file.path}: is not a slice export of Mx: expected 'X ,Y ,Slice' in line 1, found "
            f"{lines[0][:40]!r}; leave out format= to have it recognised"
        )
    slices: dict[str, list[tuple[float, float]]] = {}
    for number, line in enumerate(lines[1:], start=2):
        if not line.strip():
            continue
        fields = line.split(",")
        if len(fields) != 3 or not fields[2].strip():
            raise CorruptFileError(
                file.path,
                "a row does not fit",
                field=f"line {number}",
                expected="position, height and slice",
                found=repr(line[:60]),
            )
        x = to_number(file, fields[0], line=number, name="X")
        if np.isnan(x):
            raise CorruptFileError(file.path, "a row has no position", field=f"line {number}")
        z = to_number(file, fields[1], line=number, name="Y")
        slices.setdefault(fields[2].strip(), []).append((x, z))
    if not slices:
        raise CorruptFileError(file.path, "holds no row", field="line 2")
    cut = "the file does not end with a line end; its last row may be cut off"
    return slices, [cut] if lines[-1] else []


def _choose(file: RawFile, labels: tuple[str, ...], channel: str | None) -> str:
    if channel is None:
        return labels[0]
    for label in labels:
        if label.lower() == channel.strip().lower():
            return label
    raise FormatMismatchError(
        f"{file.path}: has no slice {channel!r}; the slices are "
        f"{', '.join(repr(s) for s in labels[:20])}"
    )
