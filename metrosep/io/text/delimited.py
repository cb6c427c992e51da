"""Column text (CSV, TSV, TXT) of every habit: the commonest format of all.

Commas, semicolons, tabs or spaces; decimal point or comma; comments; a header or none; units in
the header, in a row of their own, or declared by the caller; descending positions; empty fields
for "not measured". No unit is ever guessed. See ``data_formats/delimited/SPEC.md``.
"""

from __future__ import annotations

import functools
import itertools
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import AmbiguousFormatError, CorruptFileError, ReadError
from metrosep.core.profile import Profile
from metrosep.core.recording import Recording
from metrosep.core.runset import RunSet
from metrosep.core.surface import Surface
from metrosep.core.text_options import TextOptions
from metrosep.core.units import parse_unit
from metrosep.io._roles import ColumnSpec, gap_in, numbering
from metrosep.io.declared import Match
from metrosep.io.own_notes import is_marked
from metrosep.io.registry import BuiltIn, demand, sniffer
from metrosep.io.source import HEAD_BYTES, RawFile
from metrosep.io.text._compiled import Stamps, different
from metrosep.io.text._rows import Block
from metrosep.io.text.dialect import (
    Layout,
    bare_unit,
    find_layout,
    header_unit,
    is_comment,
    split_header,
    unmeasured_rows,
)
from metrosep.io.text.encoding import NO_READING, head_text
from metrosep.io.text.lines import are_numbered_rows, are_rows_like_comments, is_rule, unframed
from metrosep.io.text.logger import first_lines
from metrosep.io.text.measurement import measurement
from metrosep.io.text.table import Column, Table, TextTable, markers_in, read_table, text_of
from metrosep.io.text.times import RunningClock, moments

_DIGITS = re.compile(r"[\s\"'+.,;|-]*\d[\d.,;|'eE+\-\s\"]*(?:[,;|\t ]|$)")
_JSON = re.compile(r"\s*(?:\{\s*\"|\[\s*[\[{])")
_FEWEST = 3
_MAX_TITLES = 5
"""Lines above a table with which a short text still counts as one."""


_MARK_BELOW = 3
"""Lines within which metrosep writes its mark."""


def sniff(file: RawFile) -> Match:
    """Return how sure we are that a file is a table of numbers."""
    text = head_text(file)
    if text is None:
        return Match.NO
    if _JSON.match(text):
        return Match.NO
    if any(is_marked(line.lstrip('# "')) for line in text.split("\n", _MARK_BELOW)[:_MARK_BELOW]):
        return Match.MAYBE
    text = unframed(text, text)
    lines = [s for s in text.split("\n") if s.strip() and not is_comment(s) and not is_rule(s)]
    if len(file.head) == HEAD_BYTES and not text.endswith("\n"):
        lines = lines[:-1]
    every = text.split("\n")[:-1]
    if (len(lines) == 1 and are_rows_like_comments(every)) or are_numbered_rows(every):
        return Match.MAYBE
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
    whole = layout.ends or (layout.start <= 1 and layout.n_fit >= max(_FEWEST, others))
    is_table = whole and (layout.n_fit >= others or (layout.n_fit > 1 and others <= _MAX_TITLES))
    return Match.MAYBE if is_table or _is_named(sample, layout) else _mostly_digits(sample)


def _is_named(lines: list[str], layout: Layout) -> bool:
    """Whether a few rows stand right below names with units, or units, however much text is round them."""
    above = lines[max(layout.start - 2, 0) : layout.start]
    split = layout.dialect.split(above)
    units = [f.strip() for own in split if layout.n <= len(own) <= layout.n_raw for f in own]
    names = [split_header(line, layout.dialect.separator, layout.n) for line in above]
    return layout.n_fit >= _FEWEST and (
        any(map(bare_unit, units)) or any(header_unit(n)[1] for own in names for n in own or ())
    )


def _mostly_digits(lines: list[str]) -> Match:
    """Return MAYBE when half of the lines begin like a row of numbers, though the table is damaged."""
    good = sum(_DIGITS.match(line) is not None for line in lines)
    return Match.MAYBE if lines and good >= 0.5 * len(lines) else Match.NO


def channels(file: RawFile) -> tuple[str, ...]:
    """Return what ``channel=`` accepts: labels of a column of labels, else column names."""
    table = read_table(file)
    for column in table.columns:
        if column.labels is not None and len(texts := different(column.labels)) > 1:
            return texts
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
    row_order: str | None = None,
    **text: Any,
) -> Profile | Recording | Surface | RunSet:
    """Return the profile, recording or surface that a table of numbers holds, or metrosep's own runs."""
    file = text_of(file, text)
    named = x is not None and z is not None
    table = read_table(file, is_named=named or channel is not None, **text)
    asked = (channel, lateral_step, unit, x, y, z, time, sampling_rate, scale)
    if all(a is None for a in asked) and any(map(is_marked, table.header["comments"])):
        from metrosep.io.own_runs import own_runs

        if (runs := own_runs(file, table)) is not None:
            return runs
    return measurement(
        file,
        table,
        file.table_format,
        channel=channel,
        lateral_step=lateral_step,
        unit=unit,
        x=x,
        y=y,
        z=z,
        time=time,
        sampling_rate=sampling_rate,
        scale=scale,
        row_order=row_order,
    )


# ---- tables in containers: recognised by their marks, then read as the text that is made of them -------


def _container(format_id: str) -> BuiltIn:
    """Return the reader of a container of tables."""

    @functools.wraps(read)
    def of_container(file: RawFile, **options: Any) -> Profile | Recording | Surface | RunSet:
        demand(file, format_id)
        return read(file, **options)

    return BuiltIn(sniffer(format_id), channels, of_container)


worksheet, sqlite, parquet = map(_container, ("worksheet", "sqlite", "parquet"))


# ---- columns of a long text file in chunks, in bounded memory ----------------------------------
# The head of the file gives dialect, names and units exactly as for a short file, and the same `Body`
# takes the rest block by block: every line is accounted for, and what does not fit is named.

_KEPT = 1000
"""Earlier values of a column with which those of a block are compared for markers."""
_FIRST = 1000
"""Rows whose time tells the sampling interval."""


def open_source(file: RawFile, stack: ExitStack, **text: Any) -> TextSource:
    """Return the columns of numbers and of time of a text file."""
    source = TextTable(file, TextOptions.of(text))
    return TextSource(source.file, source)


class TextSource:
    """Columns of numbers and of time of a text file; see `metrosep.io.stream.ChunkSource`.

    A column of dates or of times of day is in s from the first row; a date beside a time of day belongs
    to it. Columns of words are not channels.
    """

    def __init__(self, file: RawFile, source: TextTable) -> None:
        self._file, self._source = file, source
        head = source.head
        places = range(len(head.names))
        dated = {k for k in places if any(head.layout.dated[k : k + 1])}
        words = {k for k in places if any(head.layout.labels[k : k + 1])}
        self._late: set[int] = set()  # columns of which the first word stands far below
        self._days, self._clocks = self._moments(dated)
        self._keep([k for k in places if k not in words or k in self._clocks])
        self.n_samples = None
        self.warnings: tuple[str, ...] = ()
        self.row_gap = ""  # where the rows that were given so far number themselves with a gap
        self.lines: Mapping[str, Any] = {}
        self._left = [
            _left_out(head.names[k]) for k in sorted(words - self._clocks.keys() - {self._days})
        ]
        self.time_step = self._step()
        self._keep([k for k in self._kept if k not in self._late])

    def _keep(self, places: list[int]) -> None:
        """Take some columns as channels."""
        head = self._source.head
        self._kept = places
        second = parse_unit("s")
        self._columns = [
            Column(head.names[k], second if k in self._clocks else head.units[k], None)
            for k in self._kept
        ]
        self._names = tuple(c.name for c in self._columns)
        self.labels: Mapping[str, str] = {
            c.name: c.unit.name if c.unit is not None else "" for c in self._columns
        }

    def _moments(self, dated: set[int]) -> tuple[int | None, dict[int, str]]:
        """Return the column of days beside a time of day, and the columns of moments with their names."""
        where = {k: f"{self._file.path}: column {self._source.head.names[k]!r}" for k in dated}
        if len(dated) != 2:
            return None, where
        first = next(self._source.blocks())
        kinds = {
            k: m.kind
            for k in dated
            if (m := moments([str(t) for t in first.columns[k]], first.lines, where[k]))
            is not None
        }
        if sorted(kinds.values()) != ["clock", "date"]:
            return None, where
        day = next(k for k, kind in kinds.items() if kind == "date")
        return day, {k: w for k, w in where.items() if k != day}

    def _rows(self, names: Sequence[str]) -> Iterator[tuple[FloatArray, NDArray[np.int64]]]:
        """Yield the numbers of the columns, and the line of each row; a time that is not asked for is NaN."""
        asked = {k for k, c in zip(self._kept, self._columns, strict=True) if c.name in names}
        clocks = {k: RunningClock(where) for k, where in self._clocks.items() if k in asked}
        for block in self._blocks(asked):
            days = None if self._days is None else _moment_texts(block.columns[self._days])
            columns = [
                clocks[k].seconds(_moment_texts(block.columns[k]), block.lines, days)
                if k in clocks
                else np.full(block.lines.size, np.nan)
                if k in self._clocks or k in self._late
                else np.asarray(block.columns[k])
                for k in self._kept
            ]
            yield np.column_stack(columns), block.lines

    def _blocks(self, asked: set[int]) -> Iterator[Block]:
        """Yield the rows; a first word far below the first rows refuses a column only where it is asked for."""
        n_given = 0
        while True:
            above = n_given
            try:
                for block in self._source.blocks():
                    new = block.lines[above:]
                    if new.size:
                        yield Block([c[above:] for c in block.columns], new) if above else block
                    above = max(above - block.lines.size, 0)
                    n_given += new.size
            except CorruptFileError as refused:
                if (k := self._source.words_in) is None:
                    raise
                if k in asked:
                    others = [n for i, n in zip(self._kept, self._names, strict=True) if i != k]
                    raise self._file.corrupt(
                        refused.reason,
                        field=refused.field,
                        expected=refused.expected,
                        found=refused.found,
                        hint=f"correct that line, or read the channels without it: channels={others}",
                    ) from None
                self._source.take_words(k)
                self._late.add(k)
                self._left.append(_left_out(self._source.head.names[k]))
            else:
                return

    def _step(self) -> float | None:
        """Return the interval of a column of time that is uniform in the first rows, in s."""
        timed = [
            (k, c.unit.factor)
            for k, c in enumerate(self._columns)
            if c.unit is not None and c.unit.dimension == "time"
        ]
        try:  # also without a time: a column with a first word in these rows is no channel
            rows, _ = next(self._rows([self._names[k] for k, _ in timed]))
        except AmbiguousFormatError:  # said when that time is read
            return None
        for k, factor in timed:
            steps = np.diff(rows[:_FIRST, k]) * factor
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
        self.row_gap = ""
        counters = self._counters(kept, kept_lines)
        last = kept_lines
        for rows, own in self._rows(names):
            for name, numbers in [*counters.items()]:
                k = self._names.index(name)
                here = np.concatenate([numbers, rows[:, k]])
                self.row_gap = self.row_gap or gap_in(name, here, np.concatenate([last, own]))
                counters[name] = here[-2:]
            last = np.concatenate([last, own])[-2:]
            every = np.concatenate([kept, rows])
            lines = np.concatenate([kept_lines, own])
            columns = self._columns_of(every)
            options = self._source.head.options
            said, markers = markers_in(columns, lines, options)
            for name in names:
                if name in markers:
                    raise AmbiguousFormatError(f"{self._file.path}: {markers[name]}")
            for message in (*markers.values(), *said):
                odd.setdefault(message.partition(" holds ")[0], message)
            kept, kept_lines = _sample(every, lines)
            rest = np.concatenate([rest, rows]) if rest.size else rows
            while rest.shape[0] >= size:
                yield {n: rest[:size, k].copy() for n, k in zip(names, where, strict=True)}
                rest = rest[size:]
        gap = (self.row_gap,) if self.row_gap else ()
        self.warnings = (*self._source.warnings, *odd.values(), *self._left, *gap)
        self.lines = self._source.lines
        if rest.shape[0]:
            yield {n: rest[:, k].copy() for n, k in zip(names, where, strict=True)}

    def _counters(self, rows: FloatArray, lines: NDArray[np.int64]) -> dict[str, FloatArray]:
        """Return an empty start for each column that numbers the rows, where there are others."""
        head = self._source.head
        header = {**head.facts, "comments": head.comments}
        found = numbering(Table(tuple(self._columns_of(rows)), lines, header), given=())
        return {c.name: _EMPTY for c in found} if len(found) < len(self._columns) else {}

    def _columns_of(self, rows: FloatArray) -> list[Column]:
        return [replace(c, values=rows[:, k]) for k, c in enumerate(self._columns)]


_EMPTY = np.empty(0)


def _left_out(name: str) -> str:
    return f"column {name!r} holds words and is not read in chunks"


def _moment_texts(texts: Any) -> Sequence[str]:
    """Return the entries of a column of moments, empty where a word says that there is none."""
    if isinstance(texts, Stamps) and texts.begin_with_digits():
        return texts
    return ["" if t.lower() in NO_READING else t.strip('"') for t in map(str, texts)]


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
