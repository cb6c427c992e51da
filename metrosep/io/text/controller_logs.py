"""What controllers log as text: EPICS ``camonitor`` and arrays of PI GCS."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, FormatMismatchError, ReadError
from metrosep.core.recording import Recording
from metrosep.io.declared import Match
from metrosep.io.registry import BuiltIn, mismatch
from metrosep.io.source import RawFile, rate_of, refuse_options
from metrosep.io.text.dialect import is_number
from metrosep.io.text.encoding import MISSING
from metrosep.io.text.logger import (
    Channels,
    first_lines,
    number_block,
    numbered_rows,
    text_lines,
    to_number,
)

# ---- EPICS ``camonitor`` text: one line for each change of a process variable, all interleaved
# Each variable has its own irregular times, so the recording has the union of all times with NaN
# where a variable did not report. See ``data_formats/camonitor/SPEC.md``.

_CAMONITOR = "camonitor"
_NAME = r"[A-Za-z0-9_:.\-+\[\]<>;{}/$@&^%]+"
_LINE = re.compile(
    rf"({_NAME})\s+(\d{{4}}-\d\d-\d\d)[ T](\d\d:\d\d:\d\d)(?:\.(\d{{1,9}}))?(?:\s+(.*))?"
)
_SILENT = re.compile(rf"({_NAME})\s+(?:\*\*\* ?(.*)|<undefined>.*)")
_ALARM = re.compile(r"(?:^|\s)([A-Z_]+) (MINOR|MAJOR|INVALID|NO_ALARM)$")
_SNIFFED = 20


def _camonitor_sniff(file: RawFile) -> Match:
    """Return how sure we are that a file is the output of camonitor."""
    rest = (text for line in first_lines(file) if (text := line.strip()))
    found = False
    for number, text in enumerate(rest, start=1):
        match = _LINE.fullmatch(text)
        if match is None and _SILENT.fullmatch(text) is None:
            found &= next(rest, None) is None  # only the last line may have been cut off
            break
        found |= match is not None and bool(match.group(5))
        if found and number >= _SNIFFED:
            break
    return Match.YES if found else Match.NO


def _camonitor_channels(file: RawFile) -> tuple[str, ...]:
    """Return the names of the process variables that hold numbers."""
    return tuple(_camonitor_read(file).channels)


def _camonitor_read(
    file: RawFile,
    *,
    channel: str | None = None,
    lateral_step: Any = None,
    unit: Any = None,
) -> Recording:
    """Return the process variables on the union of their times."""
    refuse_options(file, "a text of camonitor", lateral_step=lateral_step)
    lines = text_lines(file)
    variables, notes = _variables(file, lines)
    if not variables:
        raise mismatch(file, _CAMONITOR)
    data = Channels(file)
    start = min(v.ns[0] for v in variables.values())
    invalid = 0
    for name, variable in variables.items():
        values = variable.numbers(file, name, notes)
        if values is None:
            continue
        keep = [k for k, ns in enumerate(variable.ns) if variable.ns[k + 1 : k + 2] != [ns]]
        if len(keep) < len(variable.ns):
            doubled = len(variable.ns) - len(keep)
            notes.append(
                f"{name} has {doubled} lines with the time of the next; those were dropped"
            )
        t = np.array([(ns - start) * 1e-9 for ns in variable.ns])
        data.add(name, t[keep], np.array(values)[keep])
        invalid += variable.n_invalid
    if invalid:
        notes.append(f"{invalid} values with severity INVALID were taken as not measured")
    if not data.names:
        raise file.corrupt("no variable holds numbers", expected="one number on each line")
    return data.recording(
        _CAMONITOR,
        {"lines": len(lines), "variables": {n: len(v.ns) for n, v in variables.items()}},
        channel=channel,
        unit=unit,
        union=True,
        warnings=tuple(notes),
        start_local=_iso(start),
    )


_OLDER_NS = 5 * 10**9
"""A line so much older than one before it is worth a warning."""


@dataclass
class _Variable:
    """Times in ns, values as text and line numbers of one process variable."""

    ns: list[int] = field(default_factory=list)
    texts: list[str] = field(default_factory=list)
    lines: list[int] = field(default_factory=list)
    n_invalid: int = 0

    def numbers(self, file: RawFile, name: str, notes: list[str]) -> list[float] | None:
        """Return the values, or ``None`` with a note where the variable holds no numbers."""
        if not any(is_number(text, ".") for text in self.texts):
            is_array = any(len(text.split()) > 1 for text in self.texts)
            notes.append(
                f"{name} holds {'arrays or text' if is_array else 'text'}, for example "
                f"{self.texts[0][:40]!r}; it was omitted"
            )
            return None
        return [
            to_number(file, text, line=line, name=name[:40])
            for text, line in zip(self.texts, self.lines, strict=True)
        ]


def _variables(file: RawFile, lines: list[str]) -> tuple[dict[str, _Variable], list[str]]:
    """Return the variables by name, and what is odd."""
    variables: dict[str, _Variable] = {}
    silent: dict[str, str] = {}
    seconds: dict[tuple[str, str], int] = {}
    latest, older = 0, []
    for number, line in enumerate(lines, start=1):
        text = line.strip()
        if not text:
            continue
        match = _LINE.fullmatch(text)
        if match is None:
            quiet = _SILENT.fullmatch(text)
            if quiet is None:
                raise _bad_line(file, number, text)
            silent[quiet.group(1)] = quiet.group(2) or "no time"
            continue
        name, day, clock, fraction, value = match.groups()
        if not value:
            raise _bad_line(file, number, text)
        if (day, clock) not in seconds:
            seconds[day, clock] = _seconds(file, number, day, clock)
        ns = seconds[day, clock] * 10**9 + int((fraction or "0").ljust(9, "0"))
        if ns < latest - _OLDER_NS:
            older.append(f"{name[:40]} at {_iso(ns)}")
        latest = max(latest, ns)
        variable = variables.setdefault(name, _Variable())
        if variable.ns and ns < variable.ns[-1]:
            raise file.corrupt(
                f"the time of {name[:40]} goes back",
                field=f"line {number}",
                expected=f"{_iso(variable.ns[-1])} or later",
                found=_iso(ns),
                hint="cut the file there: the clock was set back, or two recordings were joined",
            )
        if (alarm := _ALARM.search(value)) is not None:
            value = value[: alarm.start()].strip()
            if alarm.group(2) == "INVALID":
                variable.n_invalid += 1
                value = "nan" if is_number(value, ".") or value.lower() in MISSING else value
        variable.ns.append(ns)
        variable.texts.append(value)
        variable.lines.append(number)
    notes = [
        f"{name} reported nothing in a line: {why}" for name, why in list(silent.items())[:20]
    ]
    if older:
        notes.append(
            f"{len(older)} line(s) are more than 5 s older than a line before them (the first: {older[0]}): "
            "values that had not changed for long, or clocks that differ; their times were kept"
        )
    notes += file.cut_text()
    return variables, notes


def _bad_line(file: RawFile, number: int, text: str) -> CorruptFileError:
    return file.corrupt(
        "a line is none of camonitor",
        field=f"line {number}",
        expected="name, date, time, value",
        found=repr(text[:60]),
    )


def _seconds(file: RawFile, number: int, day: str, clock: str) -> int:
    """Return whole seconds since 1970 on the clock that wrote the file."""
    try:
        moment = datetime.fromisoformat(f"{day}T{clock}")
    except ValueError:
        raise file.corrupt(
            "a line has no time",
            field=f"line {number}",
            expected="YYYY-MM-DD HH:MM:SS",
            found=f"{day} {clock}",
        ) from None
    delta = moment - datetime(1970, 1, 1)
    return delta.days * 86400 + delta.seconds


def _iso(ns: int) -> str:
    seconds, rest = divmod(ns, 10**9)
    moment = np.datetime64(seconds, "s")
    return f"{moment}.{rest:09d}"


camonitor = BuiltIn(_camonitor_sniff, _camonitor_channels, _camonitor_read)


# ---- PI GCS array: what the data recorder of a PI controller answers, with a header of ``#`` lines ----
# The header declares separator, number of columns and rows, sampling interval and names, so that every
# row is checked against it. See ``data_formats/pi-gcs/SPEC.md``.

_PI_GCS_ARRAY = "pi-gcs"
_END = "END_HEADER"
_NEEDED = frozenset({"TYPE", "SEPARATOR", "DIM"})
_SEPARATORS = {32: None, 9: "\t", 44: ",", 59: ";"}
_MAX_COLUMNS = 1024
_SAME_STEP = 1e-6
"""Relative deviation of a declared interval from the one of the file that is only rounding."""


def _pi_gcs_array_sniff(file: RawFile) -> Match:
    """Return how sure we are that a file is a GCS array."""
    fields, body = _header(first_lines(file))
    return Match.YES if body and fields.keys() >= _NEEDED else Match.NO


def _pi_gcs_array_channels(file: RawFile) -> tuple[str, ...]:
    """Return the names of the columns."""
    fields, _ = _checked(file, text_lines(file))
    return tuple(_names(fields, _count(file, fields, "DIM")))


def _pi_gcs_array_read(
    file: RawFile,
    *,
    channel: str | None = None,
    lateral_step: Any = None,
    unit: Any = None,
    sampling_rate: float | str | None = None,
) -> Recording:
    """Return the columns of a GCS array."""
    refuse_options(file, "a GCS array", lateral_step=lateral_step)
    lines = text_lines(file)
    fields, start = _checked(file, lines)
    n_columns = _count(file, fields, "DIM")
    rows = numbered_rows(lines[start:], start + 1)
    warnings = _row_count(file, fields, len(rows))
    warnings += file.cut_text()
    step = _step(file, fields, sampling_rate)
    body = _numbers(file, fields, rows, n_columns)
    t = step * np.arange(len(body), dtype=np.float64)
    data = Channels(file)
    for name, column in zip(_names(fields, n_columns), body.T, strict=True):
        data.add(name, t, column)
    remarks = [line.lstrip("# ")[3:].strip() for line in lines[:start] if line[:5] == "# REM"]
    return data.recording(
        _PI_GCS_ARRAY,
        {**fields, "REM": remarks},
        channel=channel,
        unit=unit,
        warnings=tuple(warnings),
        sample_time_s=step,
    )


def _header(lines: Iterable[str]) -> tuple[dict[str, str], int]:
    """Return the fields, and the index of the first row or 0 without an end of the header."""
    fields: dict[str, str] = {}
    for k, line in enumerate(lines):
        if not line.startswith("#"):
            if line.strip():
                return fields, 0
            continue
        text = line[1:].strip()
        if text == _END:
            return fields, k + 1
        match = re.fullmatch(r"([A-Z_]+\d*)\s*=\s*(.*)", text)
        if match:
            fields[match.group(1)] = match.group(2).strip()
    return fields, 0


def _checked(file: RawFile, lines: list[str]) -> tuple[dict[str, str], int]:
    fields, start = _header(lines)
    missing = _NEEDED - fields.keys()
    if len(missing) == len(_NEEDED):
        raise mismatch(file, _PI_GCS_ARRAY)
    if missing or not start:
        what = ", ".join(sorted(missing)) or _END
        raise file.corrupt("the header is not complete", expected=what)
    return fields, start


def _count(file: RawFile, fields: dict[str, str], name: str) -> int:
    text = fields[name]
    limit = _MAX_COLUMNS if name == "DIM" else 10**12
    if not (text.isascii() and text.isdecimal()) or not 1 <= int(text[:18]) <= limit:
        raise file.corrupt(
            "a count of the header is not usable",
            field=name,
            expected=f"1 ... {limit}",
            found=repr(text[:20]),
        )
    return int(text[:18])


def _names(fields: dict[str, str], n_columns: int) -> list[str]:
    return [fields.get(f"NAME{k}") or f"column {k}" for k in range(n_columns)]


def _row_count(file: RawFile, fields: dict[str, str], n_rows: int) -> list[str]:
    """Return a warning where the count of rows is not declared; refuse a file that was cut off."""
    if "NDATA" not in fields:
        return ["the header has no NDATA, so missing rows would not be noticed"]
    declared = _count(file, fields, "NDATA")
    if declared != n_rows:
        raise file.corrupt(
            "the count of rows is wrong",
            field="NDATA",
            expected=declared,
            found=n_rows,
            hint="record again or ask the controller for all points (DRR?)",
        )
    return []


def _step(file: RawFile, fields: dict[str, str], sampling_rate: float | str | None) -> float:
    declared = None if sampling_rate is None else 1.0 / rate_of(sampling_rate)
    if "SAMPLE_TIME" not in fields:
        if declared is None:
            raise ReadError(f"{file.path}: the header has no SAMPLE_TIME; give sampling_rate=")
        return declared
    own = to_number(file, fields["SAMPLE_TIME"], line=0, name="SAMPLE_TIME")
    if not own > 0.0:
        raise file.corrupt(
            "the sampling interval is not usable",
            field="SAMPLE_TIME",
            expected="a positive number of s",
            found=repr(fields["SAMPLE_TIME"][:20]),
        )
    if declared is not None and abs(declared - own) > _SAME_STEP * own:
        raise FormatMismatchError(
            f"{file.path}: SAMPLE_TIME is {own:g} s, but sampling_rate={sampling_rate!r} was given; leave it out"
        )
    return own


def _numbers(
    file: RawFile, fields: dict[str, str], rows: list[tuple[int, str]], n_columns: int
) -> FloatArray:
    code = fields["SEPARATOR"]
    if not code.isdecimal() or int(code[:6]) not in _SEPARATORS:
        raise file.corrupt(
            "the separator is not known",
            field="SEPARATOR",
            expected="32, 9, 44 or 59 (the code of a character)",
            found=repr(code[:20]),
        )
    separator = _SEPARATORS[int(code[:6])]
    texts = [(line, text.strip(" \r")) for line, text in rows]
    return number_block(file, texts, names=_names(fields, n_columns), separator=separator)


pi_gcs_array = BuiltIn(_pi_gcs_array_sniff, _pi_gcs_array_channels, _pi_gcs_array_read)
