"""Tests of machines as text: the Etalon exchange format and lists of ISO 230-2 positioning tests."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    CorruptFileError,
    FormatMismatchError,
    ReadNameError,
    UnitError,
    UnsupportedFeatureError,
)
from metrosep.core.profile import Profile
from metrosep.core.units import Unit, parse_unit
from metrosep.io.declared import Match
from metrosep.io.objects import make_profile
from metrosep.io.registry import BuiltIn, mismatch
from metrosep.io.source import RawFile, refuse_options
from metrosep.io.text.logger import first_lines, text_lines, to_number

# ---- Etalon exchange format: error terms of a machine over the position of an axis, in mm and rad
# ``[EXY]`` is the error in direction X of the motion along Y, ``[EAX]`` the rotation about X of the motion
# along X, ``[C0B]`` a constant of location. `read` gives one length term, `read_terms` gives all.
# See ``data_formats/etalon/SPEC.md``.

_ETALON = "etalon"
_SECTION = re.compile(r"\[\s*(E[XYZABC][XYZABCUVW]|[XYZABC]0[XYZABCUVW])\s*\]")
_ANY_SECTION = re.compile(r"\[\s*([^\[\]]{1,40}?)\s*\]")
_KEY = re.compile(r"([A-Za-z_](?:[\w.]|[ \t]++(?=[\w.]))*+)\s*+=\s*+(.*)")
_TABLE, _VALUE = "gridpoints", "value"
_LENGTH, _ANGLE = "XYZ", "ABC"
_UNITS = {"length": ("mm", "m"), "angle": ("rad", "rad")}


@dataclass(frozen=True, slots=True, eq=False)
class Term:
    """One error term in SI."""

    name: str  # as in the file, such as ``"EXY"``
    positions: FloatArray  # shape (n,): positions of the axis; empty for a constant
    errors: FloatArray  # shape (n,) or (1,): error at each position, or the constant
    # ``"m"``; empty for a rotary axis, whose unit the format leaves open (numbers as written)
    position_unit: str
    error_unit: str  # ``"m"`` or ``"rad"``

    @property
    def is_profile(self) -> bool:
        """Whether it is an error in m over a position in m."""
        return bool(self.positions.size) and self.position_unit == self.error_unit == "m"


def _etalon_sniff(file: RawFile) -> Match:
    """Return how sure we are that a file is a file in the Etalon exchange format."""
    section = ""
    for text in filter(None, map(_content, first_lines(file))):
        heading, key = _ANY_SECTION.fullmatch(text), _KEY.fullmatch(text)
        if heading is not None:
            section = heading.group(1)
        elif key is None:
            break
        elif _is_term(section, key.group(1)):
            return Match.YES
    return Match.NO


def _etalon_channels(file: RawFile) -> tuple[str, ...]:
    """Return the names of the terms that `read` gives as profiles."""
    return tuple(name for name, term in read_terms(file).items() if term.is_profile)


def _etalon_read(
    file: RawFile,
    *,
    channel: str | None = None,
    lateral_step: Any = None,
    unit: Any = None,
) -> Profile:
    """Return one length term over the position of its axis."""
    refuse_options(file, "in the Etalon format", lateral_step=lateral_step, unit=unit)
    terms = read_terms(file)
    profiles = [name for name, term in terms.items() if term.is_profile]
    if channel is None and len(profiles) == 1:
        channel = profiles[0]
    if channel not in terms:
        reason = "holds several terms" if channel is None else f"has no term {channel!r}"
        if not profiles:
            reason = "holds no length term over a linear axis"
        wrong = FormatMismatchError if channel is None else ReadNameError
        raise wrong(
            f"{file.path}: {reason}; the terms are {', '.join(list(terms)[:40])}; choose a length term with "
            "channel="
        )
    term = terms[channel]
    if not term.is_profile:
        what = (
            "a constant"
            if not term.positions.size
            else "an angle in rad"
            if term.error_unit == "rad"
            else "over the angle of a rotary axis"
        )
        raise UnsupportedFeatureError(
            f"{file.path}: term {channel} is {what}, and a profile is a length over a length; get it with "
            "metrosep.io.text.machine_tests.read_terms(file)"
        )
    _, others = _sections(file)
    return make_profile(
        file,
        _ETALON,
        term.positions,
        term.errors,
        header={"term": channel, "terms": list(terms), "other_keys": others},
        unit_in_file="mm",
        length_per_unit_m=1e-3,
        sign="as in the file",
    )


def read_terms(file: RawFile) -> dict[str, Term]:
    """Return every term of the file."""
    tables, _ = _sections(file)
    if not tables:
        raise mismatch(file, _ETALON)
    terms = {}
    for name, rows in tables.items():
        error = "length" if name[name[0] == "E"] in _LENGTH else "angle"
        is_linear = name[2] in _LENGTH
        body = np.array(rows, dtype=np.float64)
        constant = body.shape[1] == 1
        positions = np.empty(0) if constant else body[:, 0] * (1e-3 if is_linear else 1.0)
        written, si = _UNITS[error]
        terms[name] = Term(
            name,
            positions,
            body[:, -1] * parse_unit(written).factor,
            "m" if is_linear and not constant else "",
            si,
        )
    return terms


def _is_term(section: str, key: str) -> bool:
    """Return whether a key holds the table or the value of an error term."""
    return _SECTION.fullmatch(f"[{section}]") is not None and key.lower() in (_TABLE, _VALUE)


def _content(line: str) -> str:
    return line.split("//", 1)[0].strip()


def _sections(file: RawFile) -> tuple[dict[str, list[list[float]]], dict[str, str]]:
    """Return the rows of each term (of one number for a constant), and the other keys."""
    tables: dict[str, list[list[float]]] = {}
    others: dict[str, str] = {}
    section, rows = "", None
    for number, line in enumerate(text_lines(file), start=1):
        text = _content(line)
        if not text:
            continue
        if rows is not None:
            rows = _row(file, number, text, section, rows)
            continue
        heading = _ANY_SECTION.fullmatch(text)
        key = _KEY.fullmatch(text)
        if heading is not None:
            section = heading.group(1)
        elif key is None:
            raise _bad(file, number, text, "a section, a key or a row of a table")
        elif not _is_term(section, key.group(1)):
            others[f"{section}.{key.group(1)}"] = key.group(2)
        elif section in tables:
            raise _bad(file, number, text, f"one table for {section}")
        elif key.group(1).lower() == _VALUE:
            tables[section] = [[_number(file, number, key.group(2), section)]]
        elif not key.group(2).startswith("{"):
            raise _bad(file, number, text, "Gridpoints = {")
        else:
            rows = tables[section] = []
            rest = key.group(2)[1:].strip()
            rows = _row(file, number, rest, section, rows) if rest else rows
    if rows is not None:
        raise file.corrupt(
            f"the table of {section} has no end", expected="}", found="the end of the file"
        )
    return tables, others


def _row(
    file: RawFile, number: int, text: str, section: str, rows: list[list[float]]
) -> list[list[float]] | None:
    """Add a row of a table; return ``None`` when the table ends with it."""
    body, end, rest = text.partition("}")
    fields = body.split()
    if fields:
        if len(fields) != 2:
            raise _bad(file, number, text, f"a position and an error of {section}")
        rows.append([_number(file, number, field, section) for field in fields])
    if not end:
        return rows
    if rest.strip() or not rows:
        raise _bad(
            file, number, text, f"at least one row of {section} before }} and nothing after it"
        )
    return None


def _number(file: RawFile, number: int, text: str, section: str) -> float:
    value = to_number(file, text, line=number, name=f"an entry of {section}")
    if not np.isfinite(value):
        raise _bad(file, number, text, f"a number of {section}")
    return value


def _bad(file: RawFile, number: int, text: str, expected: str) -> CorruptFileError:
    return file.corrupt(
        "a line does not fit", field=f"line {number}", expected=expected, found=repr(text[:40])
    )


etalon = BuiltIn(_etalon_sniff, _etalon_channels, _etalon_read)


# ---- positioning test of ISO 230-2 as ``KEY=VALUE`` text: targets and what was reached, per run ----
# `read` gives one run as a profile of the deviation over the target; `read_targets` gives all runs.
# See ``data_formats/iso230-2/SPEC.md``.

ISO230_2 = "iso230-2"
_LINE = re.compile(r"([A-Za-z][A-Za-z0-9_]*)(?:\[ *(\d{1,6}) *(?:, *(\d{1,6}) *)?\])? *=(.*)")
_TARGET = "TGT_DATA"
_DIRECTIONS = {"REF_DATA_FWD": "forward", "REF_DATA_BWD": "backward"}


def _iso230_2_list_sniff(file: RawFile) -> Match:
    """Return how sure we are that a file is a list of a positioning test."""
    keys: set[str] = set()
    for text in filter(None, map(_list_content, first_lines(file))):
        match = _LINE.fullmatch(text)
        if match is None:
            break
        keys |= {match.group(1)} if match.group(2) else set()
        if _TARGET in keys and keys & _DIRECTIONS.keys():
            return Match.YES
    return Match.NO


def _iso230_2_list_channels(file: RawFile) -> tuple[str, ...]:
    """Return the names of the runs."""
    return _test(file).runs


def _iso230_2_list_read(
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
        wrong = FormatMismatchError if channel is None else ReadNameError
        raise wrong(
            f"{file.path}: {reason}; choose one with channel=: {', '.join(test.runs[:20])}; their mean is "
            "not formed here"
        )
    own = _length_unit(file, test, unit)
    direction, _, number = channel.rpartition(" ")
    deviation = test.reached[direction][:, int(number) - 1] - test.targets
    return make_profile(
        file,
        ISO230_2,
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


def _list_content(line: str) -> str:
    text = line.strip()
    return "" if text.startswith("#") else text


def _test(file: RawFile) -> _Test:
    lines = text_lines(file)
    header: dict[str, str] = {}
    entries: dict[str, dict[tuple[int, ...], float]] = {_TARGET: {}}
    entries.update({key: {} for key in _DIRECTIONS})
    for number, line in enumerate(lines, start=1):
        text = _list_content(line)
        if not text:
            continue
        match = _LINE.fullmatch(text)
        if match is None or (match.group(2) and match.group(1) not in entries):
            raise _list_bad(file, "a line is not a known key with a value", number, text)
        key, first, second, value = match.groups()
        if first is None:
            header[key] = value.strip()
            continue
        index = (int(first), int(second)) if second else (int(first),)
        if len(index) != 1 + (key != _TARGET) or index in entries[key] or 0 in index:
            raise _list_bad(file, "an index does not fit or is given twice", number, text)
        entries[key][index] = to_number(file, value, line=number, name=text.split("=")[0][:40])
    if not entries[_TARGET] or not any(entries[key] for key in _DIRECTIONS):
        raise mismatch(file, ISO230_2)
    return _arrays(file, header, entries)


def _list_bad(file: RawFile, reason: str, number: int, text: str) -> CorruptFileError:
    return file.corrupt(
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
        raise file.corrupt(
            "a target is missing",
            field=_TARGET,
            expected=f"{m} targets counted from 1",
            found=f"{_TARGET}[{max(entries[_TARGET])[0]}]",
        )
    targets = np.array([entries[_TARGET][(i + 1,)] for i in range(m)])
    if not np.isfinite(targets).all():
        raise file.corrupt("a target is not a number", field=_TARGET)
    reached = {}
    for key, direction in _DIRECTIONS.items():
        found = entries[key]
        n = max((j for _, j in found), default=0)
        if len(found) != m * n or any(i > m for i, _ in found):
            raise file.corrupt(
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
        raise file.corrupt(
            "the declared count is wrong", field=key, expected=text[:20], found=count
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


iso230_2_list = BuiltIn(_iso230_2_list_sniff, _iso230_2_list_channels, _iso230_2_list_read)
