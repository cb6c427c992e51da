"""Shared by the writers of the ISG dialects: lists of ``key value`` lines with comments, in units of 0.1 um."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from metrosep.compensation.knots import choose_knots
from metrosep.compensation.table import CompensationTable
from metrosep.controllers._increments import (
    DRY_RUN,
    Carried,
    ascii_lines,
    carry,
    fixed,
    uniform_positions,
)
from metrosep.controllers.base import Encoded
from metrosep.controllers.options import Option
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, LimitError, TableError
from metrosep.core.units import format_length

__all__ = [
    "AXIS_NUMBER",
    "FARTHEST",
    "INTERVAL",
    "NAME",
    "NUMBER_TYPE",
    "SGN32",
    "UNIT",
    "capacity_of",
    "column",
    "encoded",
    "head_lines",
    "header",
    "no_more",
    "placed",
    "read_list",
    "real",
    "require_rising",
    "require_room",
    "require_value",
    "spacing",
    "to_units",
    "whole",
]

UNIT = 1e-7
"""Length of 1 in a list with unit 1, m."""
_DECIMALS = 6
"""Decimals of a REAL64 entry: 0.1 pm."""
SGN32 = 2**31 - 1

NAME = re.compile(r"[A-Za-z]\w{0,15}", re.ASCII)

AXIS_NUMBER = Option(
    "axis_number",
    "logical number of the corrected axis",
    "integer",
    required=True,
    lowest=1,
    highest=999,
)
FARTHEST = 214.0
"""What 32 bits of 0.1 um hold, m."""

INTERVAL = Option(
    "interval",
    "equal spacing; as the table if omitted",
    "length",
    positive=True,
    highest=100.0,
)
NUMBER_TYPE = Option(
    "number_type",
    "whole numbers, or decimals (REAL64: builds from V3.1.3132 or V4.29 on)",
    "choice",
    default="integer",
    choices=("integer", "real"),
)


def placed(table: CompensationTable, options: Mapping[str, Any], title: str) -> Carried:
    """Return a table at positions that a list can hold."""
    capacity = options["capacity"]
    values = None
    if options["interval"] is not None:
        positions = uniform_positions(
            table, interval=options["interval"], max_points=capacity, title=title
        )
    elif table.positions.size <= capacity:
        positions = np.asarray(table.positions)
    elif table.reverse is None:
        knots = choose_knots(table.positions, table.forward, capacity)
        positions, values = knots.positions, knots.values
    else:
        positions = np.linspace(*table.span, capacity)
    quantum = UNIT if options["number_type"] == "integer" else UNIT * 10.0**-_DECIMALS
    at = np.rint(positions / quantum) * quantum
    if (np.diff(at) <= 0).any():
        i = int(np.flatnonzero(np.diff(at) <= 0)[0])
        raise TableError(
            f"{title}: the positions {positions[i] * 1e3:.9g} and {positions[i + 1] * 1e3:.9g} mm fall "
            f"together at steps of {format_length(quantum)}; use a wider spacing"
        )
    if values is None:
        return carry(table, at)
    made = replace(table, positions=at, forward=values, u=None)
    everywhere = np.union1d(at, table.positions)
    error = np.abs(made.correction(everywhere) - table.correction(everywhere)).max()
    return Carried(made, float(error), True)


def to_units(values: FloatArray, kind: str) -> list[str]:
    """Return lengths as numbers of a list."""
    counts = np.asarray(values) / UNIT
    if float(np.abs(counts).max()) > SGN32:
        worst = float(np.asarray(values)[int(np.abs(counts).argmax())])
        raise LimitError(
            f"{format_length(worst)} is beyond the 32 bits of a list in 0.1 um (214 m); check the "
            "units of the table"
        )
    return [_printed(float(c), kind) for c in counts]


def _printed(count: float, kind: str) -> str:
    return str(round(count)) if kind == "integer" else fixed(count, _DECIMALS)


def spacing(positions: list[str], kind: str) -> str:
    """Return the interval of equally spaced positions, "0" if they are not."""
    p = np.array([float(v) for v in positions])
    step = _printed(float(p[-1] - p[0]) / (p.size - 1), kind)
    off = np.abs(p - (p[0] + float(step) * np.arange(p.size))).max()
    return step if off <= 1e-9 * abs(float(step)) + 10.0**-_DECIMALS else "0"


def head_lines(name: str, options: Mapping[str, Any]) -> list[str]:
    """Return comment and head of a list."""
    if not NAME.fullmatch(name):
        raise TableError(f"axis {name!r} is no name for a list: letters, digits, underscores")
    sign = "+" if options["entry_sign"] > 0 else "-"
    return [
        f"# metrosep: entry = {sign}e in 0.1 um, {DRY_RUN}",
        f"kopf.achs_nr {options['axis_number']}",
        f"kopf.log_achs_name {name}",
    ]


def encoded(
    carried: Any, wanted: list[FloatArray], columns: list[list[str]], lines: list[str], kind: str
) -> Encoded:
    """Return the bytes with what rounding costs."""
    off = max(
        float(np.abs(np.array([float(v) for v in c]) * UNIT - w).max())
        for c, w in zip(columns, wanted, strict=True)
    )
    return Encoded(
        ("\n".join(lines) + "\n").encode("ascii"),
        off,
        step=UNIT if kind == "integer" else 0.0,
        carried=carried.table,
        resampling_error=carried.error,
    )


# ---- shared by the readers of the ISG dialects: entries of a list, taken one by one until none is left ----

Entries = dict[str, tuple[str, int]]

_LINE = re.compile(r"([a-z]\w*(?:\.\w+(?:\[\d{1,7}\])*)+)\s+(\S+)", re.ASCII)
_NUMBER = re.compile(r"-?\d{1,10}(?:\.\d{1,12})?")
_COMMENT = re.compile(r"#|/\*")
_WHOLE = re.compile(r"\d{1,7}")
_SIGN = re.compile(r"# metrosep: entry = ([+-])e in 0\.1 um, sign not documented.*")


def read_list(
    data: bytes, path: Path, options: Mapping[str, Any]
) -> tuple[Entries, dict[str, Any]]:
    """Return the entries of a list, and what its comment tells."""
    text, comments = _without_comments(
        "\n".join(ascii_lines(data, path, "compensation value list")), path
    )
    comment = _told(comments, path)
    entries: Entries = {}
    for i, line in enumerate(text.split("\n"), start=1):
        if not line.strip():
            continue
        found = _LINE.fullmatch(line.strip())
        if found is None or found[1] in entries:
            raise CorruptFileError(
                path,
                f"line {i} is no entry, or one that stands twice: {line.strip()[:60]!r}",
                hint="one 'key value' a line; comments behind # or in /* */",
            )
        entries[found[1]] = (found[2], i)
    if options.get("number_type") == "integer":
        _require_whole(entries, path)
    return entries, comment


def _without_comments(text: str, path: Path) -> tuple[str, list[str]]:
    """Return the text with its lines as they were, and the comments behind #; one pass."""
    kept: list[str] = []
    comments: list[str] = []
    at = 0
    while (found := _COMMENT.search(text, at)) is not None:
        kept.append(text[at : found.start()])
        end = text.find("\n" if found[0] == "#" else "*/", found.end())
        if end < 0 and found[0] != "#":
            line = text.count("\n", 0, found.start()) + 1
            raise CorruptFileError(
                path,
                f"line {line}: the comment /* is not closed",
                hint="close it with */, or write the table again",
            )
        end = len(text) if end < 0 else end
        if found[0] == "#":
            comments.append(text[found.start() : end].strip())
            at = end
        else:
            kept.append("\n" * text.count("\n", found.start(), end))
            at = end + 2
    return "".join([*kept, text[at:]]), comments


def _told(comments: list[str], path: Path) -> dict[str, Any]:
    told: dict[str, Any] = {}
    for line in comments:
        found = _SIGN.fullmatch(line)
        if not found and line.startswith("# metrosep"):
            raise CorruptFileError(
                path, "the comment of the sign is damaged", hint="write it again"
            )
        if found and told.setdefault("entry_sign", 1 if found[1] == "+" else -1) != (
            1 if found[1] == "+" else -1
        ):
            raise CorruptFileError(
                path,
                "two comments contradict each other about the sign of entries",
                hint="lists were put together: take them apart, or write the table again",
            )
    return told


def _require_whole(entries: Entries, path: Path) -> None:
    for key, (word, line) in entries.items():
        if "." in word:
            raise CorruptFileError(
                path,
                f"line {line}: {key} {word} is no whole number",
                hint="builds before V3.1.3132 / V4.29 cut it: write it with number_type='integer'",
            )


def _taken(entries: Entries, key: str, pattern: re.Pattern[str], path: Path) -> str:
    if key not in entries:
        raise CorruptFileError(
            path, f"{key} is missing", hint="the kernel would use 0: write the table again"
        )
    word, line = entries.pop(key)
    if not pattern.fullmatch(word):
        raise CorruptFileError(path, f"line {line}: {key} cannot be {word[:30]!r}", hint="mend it")
    return word


def header(entries: Entries, options: Mapping[str, Any], path: Path) -> tuple[int, str]:
    """Return number and name of the corrected axis."""
    number = int(_taken(entries, "kopf.achs_nr", _WHOLE, path))
    if options.get("axis_number") not in (None, number):
        raise CorruptFileError(
            path,
            "the list of another axis",
            expected=options["axis_number"],
            found=number,
            hint="choose the list of this axis",
        )
    return number, _taken(entries, "kopf.log_achs_name", NAME, path)


def require_value(entries: Entries, key: str, allowed: set[str], path: Path) -> None:
    """Refuse an entry that is not one of some words."""
    word = _taken(entries, key, _WHOLE, path)
    if word not in allowed:
        raise CorruptFileError(
            path,
            f"{key} is {word}",
            expected=" or ".join(sorted(allowed)),
            found=word,
            hint="only lists in 0.1 um, and of leadscrews only bilateral ones, are read",
        )


def capacity_of(
    entries: Entries, structure: str, usual: int, given: Mapping[str, Any], path: Path
) -> int:
    """Return how many numbers a kernel has reserved for a list."""
    key = f"{structure}.max_points"
    reserved = whole(entries, key, path) if key in entries else 0
    return reserved or given.get("capacity") or usual


def require_room(n: int, room: int, what: str, path: Path) -> None:
    """Refuse a list of more points than the kernel takes."""
    if n > room:
        raise LimitError(
            f"{path}: {n} points, the kernel takes {room}, {what}; if yours has room for more, say "
            "capacity="
        )


def whole(entries: Entries, key: str, path: Path) -> int:
    """Return a count."""
    return int(_taken(entries, key, _WHOLE, path))


def real(entries: Entries, key: str, path: Path) -> float:
    """Return a number."""
    value = float(_taken(entries, key, _NUMBER, path))
    if abs(value) > SGN32:
        raise CorruptFileError(path, f"{key} leaves 32 bits", found=value, hint="mend it")
    return value


def column(entries: Entries, table: str, field: str, n: int, path: Path) -> FloatArray:
    """Return one field of all points."""
    if n < 2 or n > len(entries):
        raise CorruptFileError(
            path, f"{n} points are announced, the list does not hold them", hint="write it again"
        )
    return np.array([real(entries, f"{table}[{i}].{field}", path) for i in range(n)])


def no_more(entries: Entries, path: Path) -> None:
    """Refuse entries that nobody asked for."""
    for key, (_, line) in entries.items():
        raise CorruptFileError(
            path,
            f"line {line}: {key} is not expected here",
            hint="it changes what the kernel does and is not read; remove it or correct the count",
        )


def require_rising(positions: FloatArray, path: Path) -> None:
    """Refuse positions that do not rise."""
    falling = np.flatnonzero(np.diff(positions) <= 0)
    if falling.size:
        raise CorruptFileError(
            path,
            f"point {int(falling[0]) + 1}: the setpoint does not rise",
            hint="sort the points; the kernel deselects such a list",
        )
