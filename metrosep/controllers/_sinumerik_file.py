"""The text of SINUMERIK compensation files: a header, assignments of system variables, ``M17``."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from metrosep.compensation.area_errors import is_rotary
from metrosep.controllers._along import format_span
from metrosep.controllers._notes import note, read_notes
from metrosep.controllers.base import Simulator
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, DataError, TableError

__all__ = [
    "Assignment",
    "Grid",
    "axis_letter",
    "checked_modulo",
    "checked_name",
    "folded",
    "grid_of",
    "number_text",
    "read_assignments",
    "turning",
    "units",
    "write_program",
]


_MM = 1e-3
_DEGREE = float(np.pi) / 180.0
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)")
_NAME = re.compile(r"[A-Za-z]\w*", re.ASCII)
_HEADER = re.compile(r"%_N_\w+_INI", re.ASCII)
_LETTER = re.compile(r"([A-CU-Z])\d*", re.ASCII)
_LINE = re.compile(r"(\$[A-Z][A-Z_]*) *\[ *([^\[\]]*?) *\] *= *(.*\S)", re.ASCII)
_WHOLE = 1e-6
"""MAX - MIN over STEP is a whole number, but for rounding of the decimals in the file."""

_LARGEST = 1e12
"""No position or entry of a file is as large, in mm or degrees."""

_MOST = 1e9
"""Entries of a table, at most; far above any control."""

_SAME = 1e-12
"""Ends of a table that repeats are equal, but for rounding, in m or rad."""


@dataclass(frozen=True, slots=True)
class Assignment:
    """One line of the file."""

    line: int  # its number
    name: str  # system variable
    indices: tuple[str, ...]  # in the brackets
    value: str  # after the equals sign


@dataclass(frozen=True, slots=True)
class Grid:
    """Entries of one table."""

    low: float  # first position, last position and spacing, in units of the file
    high: float
    step: float
    entries: FloatArray  # shape (n,): in units of the file
    modulo: bool  # whether it repeats

    @property
    def positions(self) -> FloatArray:
        """Where the entries stand, in units of the file."""
        return np.asarray(self.low + self.step * np.arange(self.entries.size), dtype=np.float64)


def checked_name(name: str, what: str) -> str:
    """Return the name of a machine axis, and refuse what is none."""
    if not _NAME.fullmatch(name):
        raise DataError(f"{what}={name!r} is no name of a machine axis such as 'X1'")
    return name


def number_text(value: float, *, decimals: int, at_least: int = 0) -> str:
    """Return a number without exponent and without needless zeros.

    Examples
    --------
    >>> number_text(0.003, decimals=9), number_text(5.0, decimals=9, at_least=1)
    ('0.003', '5.0')
    """
    whole, _, rest = f"{value:.{decimals}f}".partition(".")
    rest = rest.rstrip("0").ljust(at_least, "0")
    text = f"{whole}.{rest}" if rest else whole
    return text.removeprefix("-") if not float(text) else text


def write_program(
    name: str,
    channel: int,
    comments: Sequence[str],
    lines: Sequence[str],
    facts: Mapping[str, object],
) -> bytes:
    """Return a file."""
    head = [f"%_N_{name}", f"CHANDATA({channel})"]
    told = [*comments, note(facts, [*head, *lines, "M17"])]
    body = [*head, *(f"; {c}" for c in told), *lines, "M17"]
    return ("\n".join(body) + "\n").encode("ascii")


def read_assignments(data: bytes, path: Path) -> tuple[list[Assignment], dict[str, str]]:
    """Return the assignments of a file, and the facts of metrosep's own comment."""
    try:
        text = data.decode("ascii")
    except UnicodeDecodeError as exc:
        raise CorruptFileError(path, "not ASCII text", offset=exc.start) from None
    comments: list[str] = []
    code: list[tuple[int, str]] = []
    for number, line in enumerate(text.splitlines(), start=1):
        words, mark, comment = line.partition(";")
        if mark:
            comments.append(comment.strip())
        if words.strip():
            code.append((number, words.strip()))
    head = [c for _, c in code[:2]]
    if (
        len(head) < 2
        or not _HEADER.fullmatch(head[0])
        or not re.fullmatch(r"CHANDATA\(\d+\)", head[1])
    ):
        raise CorruptFileError(
            path,
            "not a compensation file of SINUMERIK",
            expected="%_N_..._INI and CHANDATA(...)",
            found=repr(" ".join(head))[:60],
        )
    if code[-1][1] != "M17":
        raise CorruptFileError(
            path, "it does not end with M17: it was cut short", found=repr(code[-1][1])[:60]
        )
    found = _assignments(code[2:-1], path)
    return found, read_notes(comments, [c for _, c in code], path)


def _assignments(code: list[tuple[int, str]], path: Path) -> list[Assignment]:
    found: dict[tuple[str, tuple[str, ...]], Assignment] = {}
    for number, line in code:
        match = _LINE.fullmatch(line)
        if match is None:
            raise CorruptFileError(
                path, f"line {number} is not $NAME[index]=value but {line[:60]!r}"
            )
        indices = tuple(i.strip() for i in match[2].split(","))
        if not all(re.fullmatch(r"\d{1,9}|[A-Za-z]\w{0,40}", i, re.ASCII) for i in indices):
            raise CorruptFileError(
                path,
                f"line {number}: the indices {match[2][:40]!r} are not numbers and axes with commas "
                "between them",
            )
        key = (match[1], indices)
        if key in found:
            raise CorruptFileError(
                path,
                f"line {number} sets {line.partition('=')[0]} again, after line {found[key].line}",
            )
        found[key] = Assignment(number, match[1], indices, match[3])
    return list(found.values())


def grid_of(
    values: dict[int, Assignment], facts: dict[str, Assignment], path: Path, what: str
) -> Grid:
    """Return the entries of a table, checked against its own first, last and step."""
    missing = [k for k in ("STEP", "MIN", "MAX", "IS_MODULO") if k not in facts]
    if missing:
        raise CorruptFileError(path, f"{what} has no {missing[0]}", field=missing[0])
    step, low, high = (_number(facts[k], path) for k in ("STEP", "MIN", "MAX"))
    if facts["IS_MODULO"].value not in ("0", "1"):
        raise CorruptFileError(
            path,
            f"line {facts['IS_MODULO'].line}: IS_MODULO is 0 or 1",
            found=facts["IS_MODULO"].value[:20],
        )
    if not step > 0.0 or not high > low:
        raise CorruptFileError(
            path,
            f"{what}: the step must be positive and MAX above MIN",
            found=f"STEP {step:g}, MIN {low:g}, MAX {high:g}",
        )
    count = (high - low) / step
    if not count < _MOST:
        raise CorruptFileError(
            path,
            f"{what}: MIN, MAX and STEP ask for {count:.3g} entries",
            found=f"{len(values)} entries",
        )
    if abs(count - round(count)) > _WHOLE * max(count, 1.0):
        raise CorruptFileError(path, f"{what}: MAX - MIN is not a multiple of STEP", found=count)
    if len(values) != round(count) + 1 or max(values) != round(count):
        raise CorruptFileError(
            path,
            f"{what}: MIN, MAX and STEP ask for the entries 0 ... {round(count)}",
            found=f"{len(values)} entries, the last {max(values, default=-1)}",
            hint="lines are missing or too many: write the file again",
        )
    entries = np.array([_number(values[i], path) for i in range(len(values))])
    modulo = facts["IS_MODULO"].value == "1"
    if modulo and entries[0] != entries[-1]:
        raise CorruptFileError(
            path,
            f"{what} repeats, but its first entry {entries[0]:g} is not its last {entries[-1]:g}",
        )
    return Grid(low, high, step, entries, modulo)


def _number(assignment: Assignment, path: Path) -> float:
    if not _NUMBER.fullmatch(assignment.value) or not abs(float(assignment.value)) < _LARGEST:
        raise CorruptFileError(
            path, f"line {assignment.line} holds no number but {assignment.value[:40]!r}"
        )
    return float(assignment.value)


def folded(lookup: Simulator, low: float, high: float) -> Simulator:
    """Return a lookup that repeats after its range."""

    def along(position: ArrayLike, direction: ArrayLike = 1) -> FloatArray:
        p = np.asarray(position, dtype=np.float64)
        return lookup(low + np.mod(p - low, high - low), direction)

    return along


def units(*, turns: bool) -> float:
    """Return the unit of an axis in the file: degrees if it turns, else mm."""
    return _DEGREE if turns else _MM


def axis_letter(machine_axis: str, *, turns: bool, otherwise: str) -> str:
    """Return the name of an axis of a table for a machine axis that nothing else names.

    Examples
    --------
    >>> axis_letter("Y1", turns=False, otherwise="X"), axis_letter("AX4", turns=True, otherwise="X")
    ('Y', 'C')
    """
    match = _LETTER.fullmatch(machine_axis)
    if match and is_rotary(match[1]) == turns:
        return match[1]
    return otherwise if is_rotary(otherwise) == turns else "C"


def turning(machine_axis: str, told: bool | None, option: str, path: Path) -> bool:
    """Return whether a machine axis turns, and refuse where nothing tells."""
    if told is not None:
        return told
    match = _LETTER.fullmatch(machine_axis)
    if match is None:
        raise DataError(
            f"{path}: nothing tells whether {machine_axis[:40]} is in mm or in degrees; give {option}"
        )
    return is_rotary(match[1])


def checked_modulo(
    words: list[str], values: FloatArray, span: tuple[float, float], axis: str
) -> None:
    """Make both ends of a table that repeats equal as printed, and refuse one that cannot repeat."""
    first, last = float(values[0]), float(values[-1])
    if abs(first - last) > _SAME:
        raise TableError(
            "the table repeats with modulo=True, but its corrections at both ends differ by "
            f"{abs(first - last):.3g}: the axis would step there; make the error equal at both ends"
        )
    period = span[1] - span[0]
    times = 2.0 * math.pi / period
    if is_rotary(axis) and abs(times - round(times)) > _WHOLE * times:
        raise TableError(
            f"the table repeats with modulo=True after {format_span(axis, period, digits=7)}, a turn of "
            f"{axis} is 360 deg: the second turn would be corrected at the wrong place; append the "
            "position 360 deg after the first one, with the first one's correction"
        )
    words[-1] = words[0]
