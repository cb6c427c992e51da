"""Column text (CSV, TSV, TXT) of every habit: the commonest format of all.

Commas, semicolons, tabs or spaces; decimal point or comma; comments; a header or none; units in
the header, in a row of their own, or declared by the caller; descending positions; empty fields
for "not measured". No unit is ever guessed. See ``data_formats/delimited/SPEC.md``.
"""

from __future__ import annotations

import itertools
import re
from typing import Any

from metrosep.core.errors import ReadError
from metrosep.core.profile import Profile
from metrosep.core.recording import Recording
from metrosep.core.surface import Surface
from metrosep.io._table_layout import find_layout, unmeasured_rows
from metrosep.io.dialect import decode, is_comment
from metrosep.io.logger import first_lines
from metrosep.io.measurement import measurement
from metrosep.io.registry import Match
from metrosep.io.select import ColumnSpec
from metrosep.io.source import HEAD_BYTES, RawFile
from metrosep.io.table import read_table

__all__ = ["channels", "read", "sniff"]

FORMAT = "delimited"
_DIGITS = re.compile(r"[\s\"'+.,;|-]*\d[\d.,;|'eE+\-\s\"]*(?:[,;|\t ]|$)")
_MAX_TITLES = 5
"""Lines above a table with which a short text still counts as one."""


def sniff(file: RawFile) -> Match:
    """Return how sure we are that a file is a table of numbers."""
    try:
        text, _ = decode(file.head, file.name)
    except ReadError:
        return Match.NO
    every = text.split("\n")
    lines = [line for line in every if line.strip() and not is_comment(line)]
    if len(file.head) == HEAD_BYTES:
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
