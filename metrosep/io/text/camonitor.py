"""EPICS ``camonitor`` text: one line for each change of a process variable, all interleaved.

Each variable has its own irregular times, so the recording has the union of all times with NaN
where a variable did not report. See ``data_formats/camonitor/SPEC.md``.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any

import numpy as np

from metrosep.core.errors import CorruptFileError, FormatMismatchError
from metrosep.core.recording import Recording
from metrosep.io.registry import Match
from metrosep.io.source import RawFile, refuse_options
from metrosep.io.text.dialect import MISSING, is_number
from metrosep.io.text.logger import Channels, first_lines, text_lines, to_number

__all__ = ["channels", "read", "sniff"]

FORMAT = "camonitor"
_NAME = r"[A-Za-z0-9_:.\-+\[\]<>;{}/$@&^%]+"
_LINE = re.compile(
    rf"({_NAME})\s+(\d{{4}}-\d\d-\d\d)[ T](\d\d:\d\d:\d\d)(?:\.(\d{{1,9}}))?(?:\s+(.*))?"
)
_SILENT = re.compile(rf"({_NAME})\s+(?:\*\*\* ?(.*)|<undefined>.*)")
_ALARM = re.compile(r"(?:^|\s)([A-Z_]+) (MINOR|MAJOR|INVALID|NO_ALARM)$")
_SNIFFED = 20


def sniff(file: RawFile) -> Match:
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


def channels(file: RawFile) -> tuple[str, ...]:
    """Return the names of the process variables that hold numbers."""
    return tuple(read(file).channels)


def read(
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
        raise FormatMismatchError(
            f"{file.path}: is no text of camonitor: no line holds a name, a date, a time and a value"
        )
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
        raise CorruptFileError(
            file.path, "no variable holds numbers", expected="one number on each line"
        )
    return data.recording(
        FORMAT,
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
                f"{self.texts[0][:40]!r}; it was left out"
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
            raise CorruptFileError(
                file.path,
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
    if lines[-1]:
        notes.append("the file does not end with a line end; its last value may be cut off")
    return variables, notes


def _bad_line(file: RawFile, number: int, text: str) -> CorruptFileError:
    return CorruptFileError(
        file.path,
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
        raise CorruptFileError(
            file.path,
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
