"""Channels of loggers: lines, numbers and units of text exports, joined on one axis of time.

Shared by the readers of logger text (LabVIEW, TwinCAT, EPICS, PI). A number is checked field by
field, so that damage is named by its line; a unit is what the file or the caller declares.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from numbers import Real
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    CorruptFileError,
    DataError,
    FormatMismatchError,
    ReadError,
    UnitError,
)
from metrosep.core.provenance import Step
from metrosep.core.recording import Recording
from metrosep.core.units import Unit, parse_quantity, parse_unit
from metrosep.io.source import RawFile, open_file
from metrosep.io.text.dialect import MISSING, decode, is_number
from metrosep.io.text.measurement import SI_NAMES

__all__ = [
    "Channels",
    "also_read",
    "beside",
    "column_names",
    "first_lines",
    "interval",
    "number_block",
    "number_rows",
    "plain_block",
    "scales_of",
    "text_lines",
    "to_number",
    "with_units",
]

_LONGEST_TOP = 2**24
"""Bytes that a recogniser looks at: no header of text is longer."""


def first_lines(file: RawFile, encoding: str | None = None) -> Iterator[str]:
    """Yield whole lines from the top, as `text_lines` gives them, no further than they are asked for."""
    shown, content = 0, file.head
    while True:
        try:
            lines = decode(content, file.path, encoding)[0].split("\n")
        except ReadError:
            return
        is_whole = len(content) >= file.size
        yield from lines[shown : len(lines) - (not is_whole)]
        if is_whole or len(content) >= _LONGEST_TOP:
            return
        shown = max(shown, len(lines) - 1)
        with file.stream() as handle:
            content = handle.read(_LONGEST_TOP)


def text_lines(file: RawFile) -> list[str]:
    """Return the lines of a text file; the last is empty when the file ends with a line end."""
    return decode(file.data, file.path)[0].split("\n")


def to_number(file: RawFile, text: str, *, line: int, name: str, decimal: str = ".") -> float:
    """Return the number in a field."""
    field = text.strip()
    if field.lower() in MISSING:
        return float("nan")
    if is_number(field, decimal):
        value = float(field.replace(",", ".").replace("d", "e").replace("D", "e"))
        if np.isfinite(value):
            return value
    raise CorruptFileError(
        file.path,
        f"{name} is no number",
        field=f"line {line}",
        expected=f"a number with decimal mark {decimal!r}",
        found=repr(field[:40]),
    )


def plain_block(
    rows: Sequence[str],
    columns: Iterable[int],
    *,
    separator: str | None = None,
    decimal: str = ".",
    counts: Iterable[int] = (),
) -> FloatArray | None:
    """Return the numbers of rows by the C parser of NumPy, or ``None`` where one is not plain.

    Rows with a gap, a word or another count of fields are for `to_number`, which names the line.
    """
    if separator and {row.count(separator) + 1 for row in rows} - set(counts):
        return None
    if decimal == ",":
        if any("." in row for row in rows):
            return None
        rows = [row.replace(",", ".") for row in rows]
    where = list(columns)
    try:
        block = np.loadtxt(rows, delimiter=separator, comments=None, usecols=where, ndmin=2)
    except ValueError:
        return None
    return block if block.shape[0] == len(rows) and np.isfinite(block).all() else None


def with_units(file: RawFile, labels: Mapping[str, str], unit: Any) -> dict[str, Unit | None]:
    """Return the unit of each channel."""
    known = {name: _unit_or_none(label) for name, label in labels.items()}
    if unit is None:
        return known
    if isinstance(unit, str):
        shared = parse_unit(unit)
        bare = [name for name, label in labels.items() if not _bare(label)]
        if not bare:
            shown = ", ".join(
                f"{n!r} in {_bare(label)!r}" for n, label in list(labels.items())[:8]
            )
            raise FormatMismatchError(
                f"{file.path}: every channel states a unit of its own ({shown}), so one for all cannot be "
                "given; declare those that metrosep does not know by name, unit={'channel': 'um'}"
            )
        return {name: shared if name in bare else own for name, own in known.items()}
    if not isinstance(unit, Mapping):
        raise FormatMismatchError(
            f"{file.path}: unit= must be one unit, or a mapping of channel to unit"
        )
    for name, text in unit.items():
        if name not in known:
            raise FormatMismatchError(
                f"{file.path}: has no channel {name!r}; the channels are {', '.join(known)}"
            )
        declared, own = parse_unit(str(text)), known[name]
        if own is not None and own != declared:
            raise FormatMismatchError(
                f"{file.path}: channel {name!r} is in {own.name} by the file, but {declared.name} was "
                "given; leave it out"
            )
        known[name] = declared
    return known


def _bare(label: str) -> str:
    return label.strip().strip("[]()").strip()


def _unit_or_none(label: str) -> Unit | None:
    try:
        return parse_unit(_bare(label))
    except UnitError:
        return None


class Channels:
    """Samples of each channel with its own times, made into one recording."""

    def __init__(self, file: RawFile) -> None:
        self._file = file
        self._t: dict[str, FloatArray] = {}
        self._values: dict[str, FloatArray] = {}
        self._labels: dict[str, str] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """Names in the order of the file."""
        return tuple(self._values)

    def add(self, name: str, t: FloatArray, values: FloatArray, label: str = "") -> None:
        """Add a channel; a name that is taken gets a number."""
        unique, count = name or "channel", 1
        while unique in self._values:
            count += 1
            unique = f"{name} ({count})"
        self._t[unique], self._values[unique], self._labels[unique] = t, values, label

    def recording(
        self,
        format_id: str,
        header: Mapping[str, Any],
        *,
        channel: str | None = None,
        unit: Any = None,
        union: bool = False,
        warnings: tuple[str, ...] = (),
        **facts: Any,
    ) -> Recording:
        """Return the channels on one axis of time, in SI where the unit is known."""
        units = with_units(self._file, self._labels, unit)
        names = self._chosen(channel)
        t = self._time(names, union=union)
        columns: dict[str, FloatArray] = {}
        for name in names:
            column = np.full(t.size, np.nan)
            where = np.searchsorted(t, self._t[name]) if union else slice(0, self._t[name].size)
            own = units[name]
            column[where] = self._values[name] * (own.factor if own is not None else 1.0)
            columns[name] = column
        if not any(np.isfinite(c).any() for c in columns.values()):
            raise CorruptFileError(self._file.path, "no channel holds a number")
        metadata = self._file.metadata(
            format_id,
            header,
            warnings=warnings,
            units_in_file={n: self._labels[n] for n in names},
            **facts,
        )
        try:
            return Recording(
                t,
                columns,
                units={n: SI_NAMES.get(u.dimension, "") for n in names if (u := units[n])},
                metadata=metadata,
                history=self._file.history(format_id, {"channels": tuple(columns)}),
            )
        except DataError as exc:
            raise CorruptFileError(self._file.path, f"the samples do not fit: {exc}") from None

    def _chosen(self, channel: str | None) -> tuple[str, ...]:
        if not self._values:
            raise CorruptFileError(self._file.path, "holds no channel")
        if channel is None:
            return self.names
        if channel not in self._values:
            raise FormatMismatchError(
                f"{self._file.path}: has no channel {channel!r}; the channels are "
                f"{', '.join(self.names[:20])}"
            )
        return (channel,)

    def _time(self, names: tuple[str, ...], *, union: bool) -> FloatArray:
        if union:
            return np.unique(np.concatenate([self._t[n] for n in names]))
        longest = max(names, key=lambda n: self._t[n].size)
        t = self._t[longest]
        for name in names:
            own = self._t[name]
            if not np.array_equal(own, t[: own.size]):
                raise FormatMismatchError(
                    f"{self._file.path}: channels {longest!r} and {name!r} have different times; read "
                    f"one at a time with channel={name!r}"
                )
        return t


# ---- measurements that take several files: the one that belongs to another, found by its stem only ----


def also_read(data: RawFile, **parameters: Any) -> Step:
    """Return the step of a history that says which file was read beside the one of that name."""
    facts = {"file": data.name, "sha256": data.sha256, "size": data.size}
    return Step("read_columns", {**facts, **parameters})


def beside(file: RawFile, suffixes: Sequence[str]) -> RawFile:
    """Return the file of the same stem in the same folder; content never names it."""
    for suffix in suffixes:
        path = file.path.with_suffix(suffix)
        if path.name != file.name and path.is_file():
            return open_file(path)
    raise ReadError(
        f"{file.path}: describes {file.path.with_suffix(suffixes[0]).name}, which does not lie beside "
        "it; put both into one folder"
    )


def number_rows(
    file: RawFile, data: RawFile, *, skip: int = 0
) -> tuple[list[int], list[list[float]]]:
    """Return rows of numbers between blanks, all of one length."""
    lines = text_lines(data)[skip:]
    rows = [(n, s.split()) for n, s in enumerate(lines, start=skip + 1) if s.strip()]
    if not rows:
        raise CorruptFileError(
            file.path, f"there are no rows in {data.name}", field=f"line {skip + 1}"
        )
    width = len(rows[0][1])
    numbers = []
    for line, fields in rows:
        if len(fields) != width:
            raise CorruptFileError(
                file.path,
                f"a row has another length in {data.name}",
                field=f"line {line}",
                expected=width,
                found=len(fields),
                hint="check how many lines stand above the rows, or copy both files again",
            )
        name = f"a column of {data.name}"
        numbers.append([to_number(file, f, line=line, name=name) for f in fields])
    return [n for n, _ in rows], numbers


# ---- columns of numbers without any header, over time: the caller declares names, interval and scale ----
# Shared by the formats that nothing in the file describes (LinuxCNC halsampler, PMAC gather).

_SCALE = re.compile(r"\s*([+-]?[0-9.]+(?:[eE][+-]?\d+)?)\s*(\S+)\s*")


def number_block(file: RawFile, rows: Sequence[tuple[int, str]]) -> FloatArray:
    """Return the numbers of rows that are separated by white space."""
    if not rows:
        raise CorruptFileError(file.path, "holds no row of numbers", field="the end")
    texts = [text for _, text in rows]
    n = len(texts[0].split())
    block = plain_block(texts, range(n))
    if block is not None and all(len(text.split()) == n for text in texts):
        return block
    body = np.empty((len(rows), n))
    for k, (line, text) in enumerate(rows):
        fields = text.split()
        if len(fields) != n:
            raise CorruptFileError(
                file.path,
                "a row does not fit the first one",
                field=f"line {line}",
                expected=f"{n} numbers",
                found=f"{len(fields)} in {text[:40]!r}",
            )
        body[k] = [to_number(file, f, line=line, name=f"column {j}") for j, f in enumerate(fields)]
    return body


def column_names(file: RawFile, names: Sequence[str] | None, n: int, usual: str) -> list[str]:
    """Return the names of columns."""
    if names is None:
        return [f"{usual} {k}" for k in range(n)]
    if not isinstance(names, (str, Sequence)):
        raise FormatMismatchError(
            f"{file.path}: names must list a name for each column, got {names!r}"
        )
    given = [names] if isinstance(names, str) else [str(name) for name in names]
    if len(given) != n or len(set(given)) != n:
        raise FormatMismatchError(
            f"{file.path}: has {n} columns of samples, but names= gives {len(set(given))} different ones; "
            "name each column once"
        )
    return given


def interval(
    file: RawFile, *, sampling_rate: float | str | None, period: float | str | None, name: str
) -> float:
    """Return the sampling interval that the caller declares."""
    if (sampling_rate is None) == (period is None):
        what = "neither" if period is None else "both"
        options = "sampling_rate=" if name == "sampling_rate" else f"sampling_rate= or {name}="
        raise ReadError(
            f"{file.path}: the file does not tell its sampling interval and {what} was given; give {options}"
        )
    if period is not None:
        step = parse_quantity(period, dimension="time", name=name)
    else:
        rate = parse_quantity(sampling_rate or 0.0, dimension="frequency", name="sampling_rate")
        step = 1.0 / rate if rate > 0.0 else 0.0
    if not (math.isfinite(step) and step > 0.0):
        raise ReadError(f"{file.path}: the sampling interval is {step} s; it must be positive")
    return step


def scales_of(file: RawFile, scale: Any, names: Sequence[str]) -> dict[str, tuple[float, str]]:
    """Return what one count of each column is."""
    if scale is None:
        return dict.fromkeys(names, (1.0, ""))
    if isinstance(scale, Mapping):
        unknown = [str(name) for name in scale if name not in names]
        if unknown:
            raise FormatMismatchError(
                f"{file.path}: has no channel {unknown[0]!r}; the channels are {', '.join(names[:20])}"
            )
        return {n: _scale(file, scale[n]) if n in scale else (1.0, "") for n in names}
    given = [scale] * len(names) if isinstance(scale, (Real, str)) else list(scale)
    if len(given) != len(names):
        raise FormatMismatchError(
            f"{file.path}: scale has {len(given)} entries for {len(names)} columns; give one for each"
        )
    return {n: _scale(file, one) for n, one in zip(names, given, strict=True)}


def _scale(file: RawFile, scale: Any) -> tuple[float, str]:
    number, label = scale, ""
    if isinstance(scale, str):
        match = _SCALE.fullmatch(scale)
        if match is None:
            raise ReadError(f"{file.path}: scale {scale!r} is not a number with a unit ('0.5 nm')")
        number, label = match.groups()
        parse_unit(label)
    try:
        factor = float(number)
    except (TypeError, ValueError):
        raise ReadError(f"{file.path}: scale {scale!r} is no number") from None
    if not math.isfinite(factor) or factor == 0.0:
        raise ReadError(f"{file.path}: scale {scale!r} must be finite and not zero")
    return factor, label
