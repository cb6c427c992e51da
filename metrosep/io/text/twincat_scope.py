"""TwinCAT Scope text export: groups of channels with one column of time each.

Every row of the header begins with its key, and the key stands again above each column of time.
Times are ms since the start of the export, or Windows FILETIME: ticks of 100 ns since 1601-01-01 UTC,
18 digits, which no float64 holds. Slow groups end earlier, so rows get shorter by whole groups.
See ``data_formats/twincat-scope/SPEC.md``.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import UnsupportedFeatureError
from metrosep.core.recording import Recording
from metrosep.io.declared import Match
from metrosep.io.registry import mismatch
from metrosep.io.source import RawFile, refuse_options
from metrosep.io.text.logger import Channels, first_lines, plain_block, text_lines, to_number

FORMAT = "twincat-scope"
_TYPE = re.compile(r"Data-Type([;,\t ])")
_START = ("Starttime of export", "StartRecord")
_END = ("Endtime of export", "EndRecord")
_TICK = 1e-7  # s
_LONGEST_MS = 1e12
"""Relative times beyond thirty years are not times."""

_FILETIME = re.compile(r"\d{17,18}")
_FACTORS = {"ScaleFactor": 1.0, "Offset": 0.0, "Unit ScaleFactor": 1.0, "Unit Offset": 0.0}
_HEADER_LINES = 1000
"""A header has a few dozen rows; a thousand leave room for remarks."""


def sniff(file: RawFile) -> Match:
    """Return how sure we are that a file is a TwinCAT Scope export."""
    return Match.NO if _type_row(first_lines(file)) is None else Match.YES


def channels(file: RawFile) -> tuple[str, ...]:
    """Return the names of the channels."""
    return _export(file)[0].names


def read(
    file: RawFile,
    *,
    channel: str | None = None,
    lateral_step: Any = None,
    unit: Any = None,
) -> Recording:
    """Return the channels of a TwinCAT Scope export."""
    refuse_options(file, "a TwinCAT Scope recording", lateral_step=lateral_step)
    data, header, start, warnings = _export(file)
    return data.recording(
        FORMAT,
        header,
        channel=channel,
        unit=unit,
        warnings=warnings,
        start_filetime=start,
        start_utc=None if start is None else _iso(start),
    )


@dataclass
class _Layout:
    """Rows above the numbers, and where they are."""

    separator: str
    about: dict[str, list[str]]
    rows: dict[str, list[str]]
    body: int

    @property
    def times(self) -> list[int]:
        """Columns of time: there each row repeats its key."""
        n = len(self.rows["Name"])
        return [
            c for c in range(n) if self.rows["Name"][c] == "Name" and self._key("Data-Type", c)
        ]

    def _key(self, name: str, column: int) -> bool:
        return self.rows[name][column] == name

    def ticks(self, names: tuple[str, ...]) -> int | None:
        """Return a FILETIME of the header."""
        for name in names:
            values = self.about.get(name, [""])
            if values and _FILETIME.fullmatch(values[0]):
                return int(values[0])
        return None


def _export(
    file: RawFile,
) -> tuple[Channels, dict[str, Any], int | None, tuple[str, ...]]:
    """Return channels, header, start in ticks and warnings."""
    lines = text_lines(file)
    layout = _layout(file, lines)
    numbered = [
        (k, line)
        for k, line in enumerate(lines[layout.body :], start=layout.body + 1)
        if line.strip() and line.strip() != "EOF"
    ]
    decimal = "."
    if layout.separator != ",":
        decimal = "," if any("," in line for _, line in numbered) else "."
    parts = _groups(file, layout, numbered, decimal)
    start = layout.ticks(_START)
    absolute = [ticks for ticks, _, _ in parts if ticks is not None]
    if absolute:
        start = min(int(t[0]) for t in absolute)
    data = Channels(file)
    axes: list[FloatArray] = []
    for (ticks, relative, values), first in zip(parts, layout.times, strict=True):
        t = relative * 1e-3 if ticks is None else np.float64(_TICK) * (ticks - (start or 0))
        axes.append(t)
        for k, column in enumerate(values.T, start=first + 1):
            data.add(layout.rows["Name"][k], t, column, _unit(layout, k))
    header = {"export": layout.about, "channels": layout.rows}
    return data, header, start, _warnings(file, layout, axes, start, lines)


def _type_row(lines: Iterable[str]) -> tuple[int, str] | None:
    """Return index and separator of the row of data types of a text that begins with ``Name``."""
    for k, line in enumerate(itertools.islice(lines, _HEADER_LINES)):
        if k == 0 and not line.startswith("Name"):
            return None
        if match := _TYPE.match(line):
            return k, match.group(1)
    return None


def _layout(file: RawFile, lines: list[str]) -> _Layout:
    found = _type_row(lines)
    if found is None:
        raise mismatch(file, FORMAT)
    first, separator = found
    while first > 0 and lines[first - 1].strip():
        first -= 1
    about = {}
    for line in filter(str.strip, lines[:first]):
        key, *rest = line.split(separator)
        if separator == " ":
            key, *rest = re.split(r" (?=\d{17,18}\b)", line, maxsplit=1)
        about[key.strip()] = [field.strip() for field in rest]
    rows = {}
    body = first
    while body < len(lines) and lines[body].strip():
        fields = [field.strip() for field in lines[body].split(separator)]
        rows[fields[0]] = fields
        body += 1
    n = len(rows["Data-Type"])
    for name in ("Name", "Unit"):
        if name in rows and len(rows[name]) != n:
            raise UnsupportedFeatureError(
                f"{file.path}: row {name!r} has {len(rows[name])} fields and row 'Data-Type' {n}: the "
                "separator is part of a name; export it again with tab or semicolon"
            )
    if "Name" not in rows or n < 2:
        raise file.corrupt("the header names no channel", field="Name")
    return _Layout(separator, about, rows, body)


def _groups(
    file: RawFile, layout: _Layout, numbered: list[tuple[int, str]], decimal: str
) -> list[tuple[NDArray[np.int64] | None, FloatArray, FloatArray]]:
    """Return for each group its ticks, or its times in ms, and its values by columns."""
    if not numbered:
        raise file.corrupt("holds no row of numbers", field="the end")
    ends = [*layout.times[1:], len(layout.rows["Name"])]
    counts = [line.count(layout.separator) + 1 for _, line in numbered]
    full = ends[-1]
    for (line, text), count, before in zip(numbered, counts, [full, *counts], strict=False):
        if count not in ends or count > before:
            raise file.corrupt(
                "a row does not end with a group of channels",
                field=f"line {line}",
                expected=" or ".join(str(e) for e in ends[:8]) + " fields",
                found=f"{count} in {text[:40]!r}",
            )
    parts = []
    for first, end in zip(layout.times, ends, strict=True):
        own = [row for row, count in zip(numbered, counts, strict=True) if count >= end]
        if end - first < 2 or not own:
            raise file.corrupt("a group of channels is empty", field=f"column {first + 1}")
        parts.append(_group(file, layout, own, range(first, end), decimal, tuple(ends)))
    return parts


def _group(
    file: RawFile,
    layout: _Layout,
    own: list[tuple[int, str]],
    columns: range,
    decimal: str,
    counts: tuple[int, ...],
) -> tuple[NDArray[np.int64] | None, FloatArray, FloatArray]:
    rows = [text for _, text in own]
    mark = layout.separator
    values = plain_block(rows, columns[1:], separator=mark, decimal=decimal, counts=counts)
    if values is None:
        values = np.array(
            [
                [
                    to_number(file, text, line=line, name=name[:40], decimal=decimal)
                    for text, name in zip(
                        row.split(mark)[columns[1] : columns[-1] + 1],
                        layout.rows["Name"][columns[1] : columns[-1] + 1],
                        strict=True,
                    )
                ]
                for line, row in own
            ]
        )
    stamps = [row.split(mark, columns[0] + 1)[columns[0]].strip() for row in rows]
    times = [
        to_number(file, text, line=line, name="the time", decimal=decimal)
        for (line, _), text in zip(own, stamps, strict=True)
    ]
    t = np.array(times)
    if not np.isfinite(t).all():
        line = own[int(np.argmin(np.isfinite(t)))][0]
        raise file.corrupt("a row has no time", field=f"line {line}")
    is_filetime = [_FILETIME.fullmatch(text) is not None for text in stamps]
    if all(is_filetime):
        return np.array([int(text) for text in stamps], dtype=np.int64), t, values
    if any(is_filetime) or np.abs(t).max() > _LONGEST_MS:
        odd = is_filetime.index(False)
        raise file.corrupt(
            "a time is not of the kind of the others",
            field=f"line {own[odd][0]}",
            expected="a FILETIME of 17 or 18 digits, or milliseconds, throughout",
            found=repr(stamps[odd][:40]),
        )
    return None, t, values


def _unit(layout: _Layout, column: int) -> str:
    """Return the unit above a column: ``V (Voltage)`` is V, ``(None)`` is none."""
    if "Unit" not in layout.rows:
        return ""
    return re.sub(r"\s*\([^()]*\)$", "", layout.rows["Unit"][column])


def _warnings(
    file: RawFile, layout: _Layout, axes: list[FloatArray], start: int | None, lines: list[str]
) -> tuple[str, ...]:
    warnings = []
    scaled = [c for c in range(len(layout.rows["Name"])) if _is_scaled(file, layout, c)]
    if scaled:
        names = ", ".join(layout.rows["Name"][c] for c in scaled[:8])
        warnings.append(
            f"the header gives a factor or an offset for {names}; the file does not tell whether its "
            "numbers carry them (export option: scale values before export), so they were taken as written"
        )
    end = layout.ticks(_END)
    if end is not None and start is not None:
        last = max(float(t[-1]) for t in axes)
        step = max(float(t[-1] - t[-2]) if t.size > 1 else 0.0 for t in axes)
        declared = (end - start) * _TICK
        if last + 1.5 * step < declared:
            warnings.append(
                f"the last row is at {last:g} s and the header declares {declared:g} s; the file may be "
                "cut off"
            )
    warnings += file.cut_text()
    return tuple(warnings)


def _is_scaled(file: RawFile, layout: _Layout, column: int) -> bool:
    for name, usual in _FACTORS.items():
        fields = layout.rows.get(name, [])
        text = fields[column] if column < len(fields) else name
        if text != name:
            mark = "," if "," in text else "."
            value = to_number(file, text, line=layout.body, name=name, decimal=mark)
            if value != usual and not np.isnan(value):
                return True
    return False


def _iso(ticks: int) -> str:
    """Return a FILETIME as ISO 8601 text in UTC with 100 ns."""
    moment = datetime(1601, 1, 1) + timedelta(microseconds=ticks // 10)
    return f"{moment.isoformat(timespec='microseconds')}{ticks % 10}Z"
