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
    """Return how sure we are that a file is a table of numbers.

    Parameters
    ----------
    file : RawFile
        The file.

    Returns
    -------
    Match
        MAYBE for text in which most lines are rows of numbers (also when its dialect is
        ambiguous, so that `read` can say why), else NO; plain numbers are never YES.
    """
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
    """Return what ``channel=`` accepts: labels of a column of labels, else column names.

    Parameters
    ----------
    file : RawFile
        The file.

    Returns
    -------
    tuple of str
        Labels (such as the slices of a stacked export) or names of the columns of numbers.
    """
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
    """Return the profile, the recording or the surface that a table of numbers holds.

    Parameters
    ----------
    file : RawFile
        The file.
    channel : str, optional
        Label of the rows to read where a column of labels stacks several data sets; for a
        recording, the one column to read.
    lateral_step : float (m) or str, optional
        Step of the positions of a file with heights only: one column, or a matrix.
    unit : str, tuple of str, or dict of str to str, optional
        Unit of the columns that declare none: one for all, one per column of numbers, or by name;
        also in one text, ``"um,um,nm"`` or ``"x=um,y=um,z=nm"``.
    x, z : str or tuple of (str, str), optional
        Columns of a profile, by name, ``"name:unit"`` or ``("name", "unit")``; by number from 1,
        ``"3:nm"``, where no header names them.
    y : str or tuple of (str, str), optional
        With `x` and `z`: the columns of points on a regular grid, which make a surface.
    time : str or tuple of (str, str), optional
        Column of time of a recording.
    sampling_rate : float (Hz) or str, optional
        Makes a recording of a file without a column of time.
    scale : float (m/V) or str, optional
        Sensitivity of the sensor where the heights are a voltage, such as ``"2.5 um/V"``.
    **text
        How the text is written, where that is not clear: `metrosep.core.text_options.TEXT_OPTIONS`.

    Returns
    -------
    Profile, Recording or Surface
        A profile when `x` or `z` is given, or when the file has exactly two columns of numbers of
        which neither is a time (position first, then height), or one column and `lateral_step`.
        A recording when `time` or `sampling_rate` is given or a column is a time. Columns of a
        recording whose unit is unknown keep their numbers and have no entry in ``units``. A surface
        when `y` is given, or the columns are called x, y and z and all three declare a length, or
        three columns without names get a unit of length each; or of three and more columns
        without names, `unit` and `lateral_step`: a matrix of heights, first row at the smallest y.
        What metrosep wrote brings its history, and a profile its kind and cut-offs.

    Raises
    ------
    ReadError
        If the text is no table, a row does not fit, a column is missing, positions are not
        monotonic, the file has three and more columns and nothing says what they are, or the kind
        or a cut-off that metrosep noted above the table is damaged.
    UnitError
        If a length or time has no unit.
    """
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
