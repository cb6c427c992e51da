"""Etalon exchange format: error terms of a machine over the position of an axis, in mm and rad.

``[EXY]`` is the error in direction X of the motion along Y, ``[EAX]`` the rotation about X of the motion
along X, ``[C0B]`` a constant of location. `read` gives one length term, `read_terms` gives all.
See ``data_formats/etalon/SPEC.md``.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, FormatMismatchError, UnsupportedFeatureError
from metrosep.core.profile import Profile
from metrosep.core.units import parse_unit
from metrosep.io.objects import make_profile
from metrosep.io.registry import Match
from metrosep.io.source import RawFile, refuse_options
from metrosep.io.text.logger import first_lines, text_lines, to_number

__all__ = ["Term", "channels", "read", "read_terms", "sniff"]

FORMAT = "etalon"
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


def sniff(file: RawFile) -> Match:
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


def channels(file: RawFile) -> tuple[str, ...]:
    """Return the names of the terms that `read` gives as profiles."""
    return tuple(name for name, term in read_terms(file).items() if term.is_profile)


def read(
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
        raise FormatMismatchError(
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
            "metrosep.io.text.etalon.read_terms(file)"
        )
    _, others = _sections(file)
    return make_profile(
        file,
        FORMAT,
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
        raise FormatMismatchError(
            f"{file.path}: is not in the Etalon format: no term such as [EXY] has Gridpoints or VALUE"
        )
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
        raise CorruptFileError(
            file.path,
            f"the table of {section} has no end",
            expected="}",
            found="the end of the file",
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
    return CorruptFileError(
        file.path,
        "a line does not fit",
        field=f"line {number}",
        expected=expected,
        found=repr(text[:40]),
    )
