"""Positioning test of ISO 230-2 as ``KEY=VALUE`` text: targets and what was reached, per run.

`read` gives one run as a profile of the deviation over the target; `read_targets` gives all runs.
See ``data_formats/iso230-2/SPEC.md``.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    CorruptFileError,
    FormatMismatchError,
    UnitError,
    UnsupportedFeatureError,
)
from metrosep.core.profile import Profile
from metrosep.core.units import Unit, parse_unit
from metrosep.io.objects import make_profile
from metrosep.io.registry import Match
from metrosep.io.source import RawFile, refuse_options
from metrosep.io.text.logger import first_lines, text_lines, to_number

__all__ = ["channels", "read", "read_targets", "sniff"]

FORMAT = "iso230-2"
_LINE = re.compile(r"([A-Za-z][A-Za-z0-9_]*)(?:\[ *(\d{1,6}) *(?:, *(\d{1,6}) *)?\])? *=(.*)")
_TARGET = "TGT_DATA"
_DIRECTIONS = {"REF_DATA_FWD": "forward", "REF_DATA_BWD": "backward"}


def sniff(file: RawFile) -> Match:
    """Return how sure we are that a file is a list of a positioning test."""
    keys: set[str] = set()
    for text in filter(None, map(_content, first_lines(file))):
        match = _LINE.fullmatch(text)
        if match is None:
            break
        keys |= {match.group(1)} if match.group(2) else set()
        if _TARGET in keys and keys & _DIRECTIONS.keys():
            return Match.YES
    return Match.NO


def channels(file: RawFile) -> tuple[str, ...]:
    """Return the names of the runs."""
    return _test(file).runs


def read(
    file: RawFile,
    *,
    channel: str | None = None,
    lateral_step: Any = None,
    unit: str | None = None,
) -> Profile:
    """Return one run of a positioning test."""
    refuse_options(file, "a positioning test", lateral_step=lateral_step)
    test = _test(file)
    if channel not in test.runs:
        reason = "holds several runs" if channel is None else f"has no run {channel!r}"
        raise FormatMismatchError(
            f"{file.path}: {reason}; choose one with channel=: {', '.join(test.runs[:20])}; their mean is "
            "not formed here"
        )
    own = _length_unit(file, test, unit)
    direction, _, number = channel.rpartition(" ")
    deviation = test.reached[direction][:, int(number) - 1] - test.targets
    return make_profile(
        file,
        FORMAT,
        test.targets * own.factor,
        deviation * own.factor,
        header=test.header,
        unit_in_file=test.header.get("UNIT"),
        length_per_unit_m=own.factor,
        run=channel,
    )


def read_targets(
    file: RawFile, *, unit: str | None = None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return all runs of a positioning test."""
    test = _test(file)
    factor = _length_unit(file, test, unit).factor
    return (
        test.targets * factor,
        test.reached["forward"] * factor,
        test.reached["backward"] * factor,
    )


@dataclass
class _Test:
    """Header fields, targets and positions in the unit of the file."""

    header: dict[str, str]
    targets: FloatArray
    reached: dict[str, FloatArray]

    @property
    def runs(self) -> tuple[str, ...]:
        return tuple(
            f"{direction} {j + 1}"
            for direction, values in self.reached.items()
            for j in range(values.shape[1])
        )


def _content(line: str) -> str:
    text = line.strip()
    return "" if text.startswith("#") else text


def _test(file: RawFile) -> _Test:
    lines = text_lines(file)
    header: dict[str, str] = {}
    entries: dict[str, dict[tuple[int, ...], float]] = {_TARGET: {}}
    entries.update({key: {} for key in _DIRECTIONS})
    for number, line in enumerate(lines, start=1):
        text = _content(line)
        if not text:
            continue
        match = _LINE.fullmatch(text)
        if match is None or (match.group(2) and match.group(1) not in entries):
            raise _bad(file, "a line is no known key with a value", number, text)
        key, first, second, value = match.groups()
        if first is None:
            header[key] = value.strip()
            continue
        index = (int(first), int(second)) if second else (int(first),)
        if len(index) != 1 + (key != _TARGET) or index in entries[key] or 0 in index:
            raise _bad(file, "an index does not fit or stands twice", number, text)
        entries[key][index] = to_number(file, value, line=number, name=text.split("=")[0][:40])
    if not entries[_TARGET] or not any(entries[key] for key in _DIRECTIONS):
        raise FormatMismatchError(
            f"{file.path}: is no list of a positioning test: {_TARGET}[i] and {' or '.join(_DIRECTIONS)}"
            "[i,j] are missing"
        )
    return _arrays(file, header, entries)


def _bad(file: RawFile, reason: str, number: int, text: str) -> CorruptFileError:
    return CorruptFileError(
        file.path,
        reason,
        field=f"line {number}",
        expected=f"KEY=VALUE, {_TARGET}[i] or REF_DATA_...[i,j], each once and from 1",
        found=repr(text[:40]),
    )


def _arrays(
    file: RawFile, header: dict[str, str], entries: dict[str, dict[tuple[int, ...], float]]
) -> _Test:
    m = len(entries[_TARGET])
    _demand(file, "POSITIONS", header, m)
    if max(entries[_TARGET])[0] != m:
        raise CorruptFileError(
            file.path,
            "a target is missing",
            field=_TARGET,
            expected=f"{m} targets counted from 1",
            found=f"{_TARGET}[{max(entries[_TARGET])[0]}]",
        )
    targets = np.array([entries[_TARGET][(i + 1,)] for i in range(m)])
    if not np.isfinite(targets).all():
        raise CorruptFileError(file.path, "a target is no number", field=_TARGET)
    reached = {}
    for key, direction in _DIRECTIONS.items():
        found = entries[key]
        n = max((j for _, j in found), default=0)
        if len(found) != m * n or any(i > m for i, _ in found):
            raise CorruptFileError(
                file.path,
                "a position is missing or has no target",
                field=key,
                expected=f"{m} targets x {n} cycles",
                found=f"{len(found)} positions",
            )
        if n:
            _demand(file, "CYCLES", header, n)
        values = [[found[i + 1, j + 1] for j in range(n)] for i in range(m)]
        reached[direction] = np.array(values, dtype=np.float64).reshape(m, n)
    return _Test(header, targets, reached)


def _demand(file: RawFile, key: str, header: dict[str, str], count: int) -> None:
    """Refuse a file that declares another count than it holds: it was cut off."""
    text = header.get(key)
    if text is not None and text != str(count):
        raise CorruptFileError(
            file.path, "the declared count is wrong", field=key, expected=text[:20], found=count
        )


def _length_unit(file: RawFile, test: _Test, unit: str | None) -> Unit:
    label = test.header.get("UNIT", "")
    if not label and unit is None:
        raise UnitError(
            f"{file.path}: the file gives no UNIT; declare it, for example unit='mm' (numbers such as "
            f"{test.targets[0]:g})"
        )
    try:
        own = parse_unit(label or str(unit))
    except UnitError as exc:
        raise UnitError(f"{file.path}: {exc}") from None
    if label and unit is not None and parse_unit(unit) != own:
        raise FormatMismatchError(
            f"{file.path}: is in {own.name} by the file, but unit={unit!r} was given; leave it out"
        )
    if own.dimension != "length":
        raise UnsupportedFeatureError(
            f"{file.path}: is in {own.name}; only linear axes are read, export a rotary one as columns"
        )
    return own
