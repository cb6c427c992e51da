"""Column text (CSV, TSV, TXT) of every habit: the commonest format of all.

Commas, semicolons, tabs or spaces; decimal point or comma; comments; a header or none; units in
the header, in a row of their own, or declared by the caller; descending positions; empty fields
for "not measured". No unit is ever guessed. See ``data_formats/delimited/SPEC.md``.
"""

from __future__ import annotations

import io
import itertools
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    FormatMismatchError,
    ReadError,
    UnsupportedFeatureError,
)
from metrosep.core.profile import Profile
from metrosep.core.recording import Recording
from metrosep.core.surface import Surface
from metrosep.core.text_options import TextOptions
from metrosep.io.declared import Match
from metrosep.io.source import HEAD_BYTES, RawFile
from metrosep.io.text._rows import Block
from metrosep.io.text.dialect import find_layout, is_comment, unmeasured_rows
from metrosep.io.text.encoding import decode, head_text, plain_ends
from metrosep.io.text.logger import first_lines
from metrosep.io.text.measurement import measurement
from metrosep.io.text.table import (
    Column,
    ColumnSpec,
    TableHead,
    cut_off,
    read_table,
    refuse_markers,
)

__all__ = ["channels", "read", "sniff"]

FORMAT = "delimited"
_DIGITS = re.compile(r"[\s\"'+.,;|-]*\d[\d.,;|'eE+\-\s\"]*(?:[,;|\t ]|$)")
_MAX_TITLES = 5
"""Lines above a table with which a short text still counts as one."""


def sniff(file: RawFile) -> Match:
    """Return how sure we are that a file is a table of numbers."""
    text = head_text(file)
    if text is None:
        return Match.NO
    lines = [line for line in text.split("\n") if line.strip() and not is_comment(line)]
    if len(file.head) == HEAD_BYTES and not text.endswith("\n"):
        lines = lines[:-1]
    if not lines:  # comments as long as the head, such as a history that metrosep wrote
        rest = (s for s in first_lines(file) if s.strip() and not is_comment(s))
        lines = list(itertools.islice(rest, 300))
    above = unmeasured_rows(lines)
    if above > 1 and above == len(lines):
        return Match.MAYBE  # a map whose first rows were not measured
    sample = lines[: above + 300]
    try:
        layout = find_layout(sample, file.name)
    except ReadError:
        return _mostly_digits(sample)
    others = len(sample) - layout.n_fit
    is_table = layout.ends and (
        layout.n_fit >= others or (layout.n_fit > 1 and others <= _MAX_TITLES)
    )
    return Match.MAYBE if is_table else _mostly_digits(sample)


def _mostly_digits(lines: list[str]) -> Match:
    """Return MAYBE when half of the lines begin like a row of numbers, though the table is damaged."""
    good = sum(_DIGITS.match(line) is not None for line in lines)
    return Match.MAYBE if lines and good >= 0.5 * len(lines) else Match.NO


def channels(file: RawFile) -> tuple[str, ...]:
    """Return what ``channel=`` accepts: labels of a column of labels, else column names."""
    table = read_table(file)
    for column in table.columns:
        if column.labels is not None and len(set(column.labels)) > 1:
            return tuple(dict.fromkeys(column.labels))
    return tuple(c.name for c in table.numbers)


def read(
    file: RawFile,
    *,
    channel: str | None = None,
    lateral_step: Any = None,
    unit: Any = None,
    x: ColumnSpec | None = None,
    y: ColumnSpec | None = None,
    z: ColumnSpec | None = None,
    time: ColumnSpec | None = None,
    sampling_rate: float | str | None = None,
    scale: float | str | None = None,
    **text: Any,
) -> Profile | Recording | Surface:
    """Return the profile, the recording or the surface that a table of numbers holds."""
    table = read_table(file, **text)
    return measurement(
        file,
        table,
        FORMAT,
        channel=channel,
        lateral_step=lateral_step,
        unit=unit,
        x=x,
        y=y,
        z=z,
        time=time,
        sampling_rate=sampling_rate,
        scale=scale,
    )


# ---- columns of a long text file in chunks, in bounded memory ----------------------------------
# The head of the file gives dialect, names and units exactly as for a short file, and the same `Body`
# takes the rest block by block: every line is accounted for, and what does not fit is named.

_BLOCK = 2**22
"""Bytes of text that are parsed at once."""

_HEAD = HEAD_BYTES
"""Bytes that tell dialect, names and units."""

_KEPT = 1000
"""Earlier values of a column with which those of a block are compared for markers."""


def open_source(file: RawFile, stack: ExitStack, **text: Any) -> TextSource:
    """Return the columns of numbers of a text file."""
    options = TextOptions.of(text)
    head = file.head[:_HEAD]
    if file.size > len(head):
        head = head[: head.rfind(_end_of(head)) + 1]
    content, encoding = decode(head, file.path, options.encoding)
    table = TableHead(file, content, encoding, options)
    labels = [n for n, label in zip(table.names, table.layout.labels, strict=False) if label]
    if labels:
        raise UnsupportedFeatureError(
            f"{file.path}: column {labels[0]!r} holds text; a file with labels is not read in chunks"
        )
    if encoding.startswith("utf-16"):
        raise UnsupportedFeatureError(
            f"{file.path}: UTF-16 text is not read in chunks; convert it to UTF-8"
        )
    handle = stack.enter_context(file.stream())
    return TextSource(file, handle, content, encoding, options)


def _end_of(head: bytes) -> bytes:
    r"""Return the byte that ends lines: CR only where there is no LF."""
    return b"\n" if b"\n" in head else b"\r"


class TextSource:
    """Columns of numbers of a text file; see `metrosep.io.stream.ChunkSource`."""

    def __init__(
        self,
        file: RawFile,
        handle: io.BufferedIOBase,
        head: str,
        encoding: str,
        options: TextOptions,
    ) -> None:
        self._file, self._handle, self._head = file, handle, head
        self._encoding, self._options = encoding, options
        table = TableHead(file, head, encoding, options)
        self._names = table.names
        self._columns = [Column(n, u, None) for n, u in zip(table.names, table.units, strict=True)]
        self.labels: Mapping[str, str] = {
            c.name: c.unit.name if c.unit is not None else "" for c in self._columns
        }
        self.n_samples = None
        self.warnings: tuple[str, ...] = ()
        self.lines: Mapping[str, Any] = {}
        self.time_step = self._step(table)

    def _step(self, table: TableHead) -> float | None:
        """Return the interval of a column of time that is uniform in the head, in s."""
        timed = [
            (k, c.unit.factor)
            for k, c in enumerate(self._columns)
            if c.unit is not None and c.unit.dimension == "time"
        ]
        if not timed:
            return None
        rows = table.body().take(self._head, table.first_line, last=False, start=table.offset)
        for k, factor in timed:
            steps = np.diff(np.asarray(rows.columns[k])) * factor
            usual = float(np.median(steps)) if steps.size else float("nan")
            if usual > 0.0 and float(np.abs(steps - usual).max()) < 0.01 * usual:
                return usual
        return None

    def chunks(self, names: Sequence[str], size: int) -> Iterator[dict[str, FloatArray]]:
        """Yield the columns, `size` rows at a time."""
        where = [self._names.index(n) for n in names]
        rest = np.empty((0, len(self._names)))
        kept = np.empty((0, len(self._names)))
        kept_lines = np.empty(0, dtype=np.int64)
        odd: dict[str, str] = {}
        for block in self._blocks():
            rows = np.column_stack([np.asarray(c) for c in block.columns])
            every = np.concatenate([kept, rows])
            lines = np.concatenate([kept_lines, block.lines])
            columns = [replace(c, values=every[:, k]) for k, c in enumerate(self._columns)]
            for message in refuse_markers(self._file, columns, lines, self._options):
                odd.setdefault(message.partition(" holds ")[0], message)
            kept, kept_lines = _sample(every, lines)
            rest = np.concatenate([rest, rows]) if rest.size else rows
            while rest.shape[0] >= size:
                yield {n: rest[:size, k].copy() for n, k in zip(names, where, strict=True)}
                rest = rest[size:]
        self.warnings = (*self.warnings, *odd.values())
        if rest.shape[0]:
            yield {n: rest[:, k].copy() for n, k in zip(names, where, strict=True)}

    def _blocks(self) -> Iterator[Block]:
        """Yield rows of numbers; whole lines only, the last of which may lack its end."""
        self._handle.seek(0)
        table = TableHead(self._file, self._head, self._encoding, self._options)
        body = table.body()
        mark = _end_of(self._file.head[:_HEAD])
        line, left, n_rows = 1, b"", 0
        end_of_text, last_line = "", 0
        while True:
            data = self._handle.read(_BLOCK)
            raw = left + data
            end = raw.rfind(mark) + 1 if data else len(raw)
            if data and mark == b"\r" and end == len(raw):
                end = raw.rfind(mark, 0, -1) + 1  # a line feed may follow
            raw, left = raw[:end], raw[end:]
            text = self._decoded(raw, line)
            n_lines = text.count("\n") + (text != "" and not text.endswith("\n"))
            above = table.first_line - line
            if above > 0:
                text = text.split("\n", above)[above]
            if text:
                block = body.take(text, max(line, table.first_line), last=not data)
                n_rows += len(block.lines)
                end_of_text = text
                if len(block.lines):
                    last_line = int(block.lines[-1])
                    yield block
            line += n_lines
            if not data:
                break
            if len(left) > _BLOCK:
                raise FormatMismatchError(
                    f"{self._file.path}: line {line} is longer than {_BLOCK} bytes: no table"
                )
        body.finish(line - 1)
        self.warnings = (*table.warnings(n_rows), *body.warnings)
        if (
            body.last_row
            and not end_of_text.endswith("\n")
            and end_of_text.endswith(body.last_row)
        ):
            found = cut_off(self._file, end_of_text, body.last_row, last_line)
            self.warnings = (*self.warnings, *found)
        self.lines = table.ledger.to_dict()

    def _decoded(self, raw: bytes, line: int) -> str:
        try:
            return plain_ends(raw.decode(self._encoding))
        except UnicodeDecodeError as exc:
            at = line + raw[: exc.start].count(b"\n")
            raise self._file.corrupt(f"is not {self._encoding} text", field=f"line {at}") from None


def _sample(rows: FloatArray, lines: NDArray[np.int64]) -> tuple[FloatArray, NDArray[np.int64]]:
    """Return rows from all over a block, among them those with the extremes of each column."""
    if len(rows) <= _KEPT:
        return rows, lines
    picked = set(np.linspace(0, len(rows) - 1, _KEPT).astype(int).tolist())
    known = ~np.isnan(rows).all(axis=0)
    if known.any():
        picked |= set(np.nanargmin(rows[:, known], axis=0).tolist())
        picked |= set(np.nanargmax(rows[:, known], axis=0).tolist())
    order = sorted(picked)
    return rows[order], lines[order]
