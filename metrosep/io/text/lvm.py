"""LabVIEW measurement file ``.lvm``: text of NI loggers, in segments with a header each.

The file header declares separator and decimal mark, each segment its channels, X0 and Delta_X.
The X column may be absent (``No``), shared (``One``) or stand before each channel (``Multi``).
The declared count of samples is a block size, not a length, so the rows that are there count.
See ``data_formats/lvm/SPEC.md``.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, FormatMismatchError, UnsupportedFeatureError
from metrosep.core.recording import Recording
from metrosep.io.declared import Match
from metrosep.io.registry import mismatch
from metrosep.io.source import RawFile, refuse_options
from metrosep.io.text.dialect import is_number
from metrosep.io.text.logger import Channels, first_lines, plain_block, text_lines, to_number

FORMAT = "lvm"
_MAGIC = "LabVIEW Measurement"
_END = "***End_of_Header***"
_SEPARATORS = {"tab": "\t", "comma": ","}


def sniff(file: RawFile) -> Match:
    """Return how sure we are that a file is a LabVIEW measurement file."""
    return Match.YES if next(first_lines(file), "").startswith(_MAGIC) else Match.NO


def channels(file: RawFile) -> tuple[str, ...]:
    """Return the names of the channels of the first segment."""
    return tuple(read(file, segment=0).channels)


def read(
    file: RawFile,
    *,
    channel: str | None = None,
    lateral_step: Any = None,
    unit: Any = None,
    segment: int | None = None,
) -> Recording:
    """Return the channels of a LabVIEW measurement file."""
    refuse_options(file, "a LabVIEW recording", lateral_step=lateral_step)
    lines = text_lines(file)
    head, start = _file_header(file, lines)
    segments = _segments(file, lines, start, head)
    if segment is None and len(segments) > 1:
        raise FormatMismatchError(
            f"{file.path}: holds {len(segments)} segments; choose one with segment=0 ... "
            f"segment={len(segments) - 1}"
        )
    if not 0 <= (segment or 0) < len(segments):
        raise FormatMismatchError(
            f"{file.path}: has no segment {segment}; it holds {len(segments)}, counted from 0"
        )
    chosen = segments[segment or 0]
    warnings = [*chosen.warnings(), *chosen.start_warnings()]
    warnings += file.cut_text()
    data, comments = _samples(file, chosen, head)
    return data.recording(
        FORMAT,
        {"file": head.fields, "segment": chosen.fields},
        channel=channel,
        unit=unit,
        warnings=tuple(warnings),
        segment=segment or 0,
        n_segments=len(segments),
        comments=comments,
    )


@dataclass
class _Head:
    """Fields of the file header and the dialect that they declare."""

    fields: dict[str, str]
    separator: str
    decimal: str
    x_columns: str


@dataclass
class _Segment:
    """Fields of a segment, one text per column, the names, and the rows with their line numbers."""

    fields: dict[str, tuple[str, ...]]
    names: list[str] = field(default_factory=list)
    rows: list[str] = field(default_factory=list)
    lines: list[int] = field(default_factory=list)

    def drop_blank_end(self, separator: str) -> None:
        """Remove empty rows behind the last one; between others they are samples not measured."""
        while self.rows and not self.rows[-1].strip(f"{separator} \t"):
            del self.rows[-1], self.lines[-1]

    def warnings(self) -> tuple[str, ...]:
        declared = {s for s in self.fields.get("Samples", ()) if s.isdecimal()}
        if declared and str(len(self.rows)) not in declared:
            counts = ", ".join(sorted(declared))
            found = (
                f"the header declares {counts} samples and the segment holds {len(self.rows)} rows"
            )
            if len(self.rows) < max(int(n) for n in declared):
                return (f"{found}: samples may be missing; compare with the original file",)
            return (f"{found} (the count is that of one block); all rows were read",)
        return ()

    def start_warnings(self) -> tuple[str, ...]:
        """Return a sentence where the channels began at different moments of the day."""
        for key in ("Date", "Time"):
            moments = sorted({m for m in self.fields.get(key, ()) if m.strip()})
            if len(moments) > 1:
                break
        else:
            return ()
        shown = " and ".join(moments[:2])
        return (
            f"the channels were started at different moments ({shown}); their times here all begin with X0",
        )


def _file_header(file: RawFile, lines: list[str]) -> tuple[_Head, int]:
    if not lines[0].startswith(_MAGIC):
        raise mismatch(file, FORMAT)
    end = next((i for i, line in enumerate(lines) if line.startswith(_END)), None)
    if end is None:
        raise file.corrupt("the header has no end", expected=_END, found="the end")
    fields: dict[str, str] = {}
    for line in filter(str.strip, lines[1:end]):
        key, _, value = line.partition("\t" if "\t" in line else ",")
        fields[key.strip()] = value.strip()
    word = fields.get("Separator", "Tab")
    decimal = fields.get("Decimal_Separator", ".") or "."
    x_columns = fields.get("X_Columns", "One")
    for name, value, legal in (
        ("Separator", word.lower(), tuple(_SEPARATORS)),
        ("Decimal_Separator", decimal, (".", ",")),
        ("X_Columns", x_columns, ("No", "One", "Multi")),
    ):
        if value not in legal:
            raise file.corrupt(
                "the header declares something unknown",
                field=name,
                expected=" or ".join(legal),
                found=repr(value[:20]),
            )
    return _Head(fields, _SEPARATORS[word.lower()], decimal, x_columns), end + 1


def _segments(file: RawFile, lines: list[str], start: int, head: _Head) -> list[_Segment]:
    """Return the segments; each begins with ``Channels`` and has its own end of header."""
    segments: list[_Segment] = []
    remarks: list[str] = []
    state = "between"
    special = False
    for number, line in enumerate(lines[start:], start=start + 1):
        if line.startswith(("***Start_Special***", "***End_Special***")):
            special = line.startswith("***Start")
            continue
        blank = not line.strip(f"{head.separator} \t")
        counts = head.separator in line or head.x_columns == "No"  # a blank row is a sample then
        if special or (blank and not (state == "rows" and counts)):
            continue
        if state == "rows" and not line.startswith("Channels"):
            segments[-1].rows.append(line)
            segments[-1].lines.append(number)
            continue
        fields = [f.strip() for f in line.split(head.separator)]
        if fields[0] == "Channels":
            segments.append(_Segment({"Channels": tuple(fields[1:])}))
            state = "header"
        elif state == "header":
            if fields[0] == _END:
                state = "names"
            else:
                segments[-1].fields[fields[0]] = tuple(fields[1:])
        elif state == "names":
            segments[-1].names = fields
            state = "rows"
        elif all(is_number(f, head.decimal) for f in fields if f):
            raise file.corrupt(
                "a row of numbers stands above the first segment",
                field=f"line {number}",
                expected="Channels, or a key and its text",
                found=repr(line[:40]),
            )
        else:  # such as Notes, which may run over several lines
            remarks.append(line.strip())
    if remarks:
        head.fields["remarks"] = "\n".join(remarks)
    for segment in segments:
        segment.drop_blank_end(head.separator)
    if special or state != "rows" or any(not s.rows for s in segments):
        raise file.corrupt(
            "a segment has no rows", field=f"line {len(lines)}", expected="rows of numbers"
        )
    return segments


def _samples(
    file: RawFile, segment: _Segment, head: _Head
) -> tuple[Channels, tuple[tuple[float, str], ...]]:
    """Return the samples of a segment by the row of names, and the comments with their times."""
    names = segment.names
    n = len(names) - (names[-1] == "Comment")
    multi = head.x_columns == "Multi"
    y_columns = range(1, n, 2 if multi else 1)
    _demand_channels(file, segment, len(y_columns))
    body = _numbers(file, segment, head, n)
    first_t = _times(file, segment, head, body, 1)
    data = Channels(file)
    for y in y_columns:
        t = _times(file, segment, head, body, y) if multi or head.x_columns == "No" else first_t
        values = body[:, y]
        untimed = np.isnan(t)
        if not np.isnan(values[untimed]).all():
            raise file.corrupt(f"channel {names[y]!r} has a value without a time")
        keep = ~untimed
        data.add(names[y], t[keep], values[keep], _at(segment, "Y_Unit_Label", y))
    comments = tuple(
        (float(first_t[k]), text)
        for k, row in enumerate(segment.rows)
        if row.count(head.separator) >= n and (text := row.split(head.separator)[n].strip())
    )
    return data, comments


def _demand_channels(file: RawFile, segment: _Segment, n_columns: int) -> None:
    declared = _at(segment, "Channels", 1)
    if n_columns < 1 or declared != str(n_columns):
        raise file.corrupt(
            "the row of names does not fit the header",
            field="Channels",
            expected=f"{declared[:20]!r} channels",
            found=f"{n_columns}",
        )
    for axis in segment.fields.get("X_Dimension", ()):
        if axis not in ("", "Time"):
            raise UnsupportedFeatureError(
                f"{file.path}: its axis is {axis[:20]!r}, not time; export the samples over time"
            )


def _numbers(file: RawFile, segment: _Segment, head: _Head, n: int) -> FloatArray:
    """Return the numbers of the rows, NaN where a field is empty or a row ends early."""
    body = _plain_numbers(segment, head, n)
    if body is not None:
        return body
    body = np.full((len(segment.rows), n), np.nan)
    last = segment.lines[-1]
    for k, (line, row) in enumerate(zip(segment.lines, segment.rows, strict=True)):
        fields = [f.strip() for f in row.split(head.separator)]
        if len(fields) > n + 1 and any(fields[n + 1 :]):
            raise _wrong_count(file, line, n, len(fields), "a row has fields too many")
        if len(fields) < n and line == last:
            raise _wrong_count(file, line, n, len(fields), "the file ends in the middle of a row")
        for j, text in enumerate(fields[:n]):
            if text:
                name = segment.names[j][:40]
                body[k, j] = to_number(file, text, line=line, name=name, decimal=head.decimal)
    return body


def _plain_numbers(segment: _Segment, head: _Head, n: int) -> FloatArray | None:
    """Return the numbers where no field is empty, by the C parser; otherwise ``None``."""
    first = int(head.x_columns == "No")
    block = plain_block(
        segment.rows,
        range(first, n),
        separator=head.separator,
        decimal=head.decimal,
        counts=(n, n + 1),
    )
    if block is None:
        return None
    return np.hstack([np.full((len(block), first), np.nan), block])


def _wrong_count(file: RawFile, line: int, n: int, found: int, reason: str) -> CorruptFileError:
    return file.corrupt(reason, field=f"line {line}", expected=n, found=found)


def _times(file: RawFile, segment: _Segment, head: _Head, body: FloatArray, y: int) -> FloatArray:
    """Return the times of a channel in s: its own column, the first one, or X0 + k Delta_X."""
    if head.x_columns == "Multi":
        return np.asarray(body[:, y - 1])
    if head.x_columns == "One":
        return np.asarray(body[:, 0])
    found = []
    for name in ("X0", "Delta_X"):
        value = float("nan")
        if text := _at(segment, name, y):
            value = to_number(file, text, line=0, name=name, decimal=_mark(text))
        if not np.isfinite(value) or (name == "Delta_X" and value <= 0.0):
            raise file.corrupt(
                "the times cannot be computed",
                field=name,
                expected="a finite number" if name == "X0" else "a positive step in s",
                found=repr(_at(segment, name, y)[:20]),
            )
        found.append(value)
    return np.asarray(found[0] + found[1] * np.arange(len(body), dtype=np.float64))


def _mark(text: str) -> str:
    return "," if "," in text else "."


def _at(segment: _Segment, name: str, column: int) -> str:
    """Return the header field above a column; header fields start at the first channel."""
    fields = segment.fields.get(name, ())
    return fields[column - 1] if column <= len(fields) else ""
