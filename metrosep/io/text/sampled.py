"""Columns of numbers over time without any header: LinuxCNC ``halsampler`` and PMAC gather data.

Nothing in such a text names the columns, the interval or what a count is, so all are declared. Where
the FIFO of halsampler was full a line ``overrun`` stands: samples are lost, and only the numbers of
``halsampler -t`` tell how many. Bare columns of a gather look like any other table, so their format
has to be named. See ``SPEC.md`` in ``data_formats/halsampler`` and ``data_formats/pmac-gather``.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Mapping, Sequence
from numbers import Real
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import FormatMismatchError, ReadError, ReadNameError
from metrosep.core.numbers import count, positive
from metrosep.core.recording import Recording
from metrosep.core.units import parse_unit
from metrosep.io.declared import Match
from metrosep.io.registry import BuiltIn, sniffer
from metrosep.io.source import RawFile, rate_of, refuse_options
from metrosep.io.text.dialect import is_number
from metrosep.io.text.logger import Channels, first_lines, number_block, text_lines

_SCALE = re.compile(r"\s*([+-]?[0-9.]+(?:[eE][+-]?\d+)?)\s*(\S+)\s*")
_SNIFFED = 100
_OVERRUN = "overrun"
_PIN, _COLUMN = "pin", "column"


def _overruns(file: RawFile) -> Match:
    """Return how sure we are that a file is the output of halsampler."""
    lines = itertools.islice(first_lines(file), _SNIFFED)
    rows = [text for line in lines if (text := line.strip()) and text != _OVERRUN]
    plain = all(is_number(field, ".") for text in rows for field in text.split())
    return Match.YES if rows and plain and _lost_samples(file) else Match.NO


def _lost_samples(file: RawFile) -> bool:
    """Return whether a line ``overrun`` stands anywhere; it may be the last of a long recording."""
    line = re.compile(rb"^\s*" + _OVERRUN.encode() + rb"\s*$", re.MULTILINE)
    with file.stream() as handle:
        kept = b""
        while part := handle.read(2**20):
            if _OVERRUN.encode() in (both := kept + part) and line.search(both):
                return True
            kept = part[-2 * len(_OVERRUN) :]
    return False


def _read_pins(
    file: RawFile,
    *,
    channel: str | None = None,
    lateral_step: Any = None,
    unit: Any = None,
    sampling_rate: float | str | None = None,
    names: Sequence[str] | None = None,
    numbered: bool = False,
    scale: Any = None,
    segment: int | None = None,
) -> Recording:
    """Return the pins that halsampler wrote."""
    refuse_options(file, "a text of halsampler", lateral_step=lateral_step)
    lines = text_lines(file)
    body, breaks = _rows(file, lines)
    step = interval(file, sampling_rate=sampling_rate, period=None, name="sampling_rate")
    warnings = []
    if numbered:
        refuse_options(file, "a numbered text of halsampler", segment=segment)
        t, body = _numbered(file, body, step)
        lost = round(t[-1] / step) + 1 - len(body)
        if lost:
            warnings.append(f"{lost} samples are lost; the recording has gaps there")
    else:
        body = _part(file, body, breaks, segment)
        t = step * np.arange(len(body), dtype=np.float64)
        if body.shape[1] > 1 and len(body) > 2 and (np.diff(body[:, 0]) == 1.0).all():
            warnings.append(
                "the first column counts up by one; if halsampler ran with -t, read it with numbered=True"
            )
    warnings += file.cut_text()
    data, _ = _channels(file, t, body, names, scale, _PIN)
    return data.recording(
        "halsampler",
        {"rows": len(body), "overruns_before_rows": breaks},
        channel=channel,
        unit=unit,
        warnings=tuple(warnings),
        sampling_interval_s=step,
        segment=segment,
        numbered=numbered,
    )


def _read_gather(
    file: RawFile,
    *,
    channel: str | None = None,
    lateral_step: Any = None,
    unit: Any = None,
    sampling_rate: float | str | None = None,
    servo_period: float | str | None = None,
    gather_period: int = 1,
    names: Sequence[str] | None = None,
    scale: Any = None,
) -> Recording:
    """Return the columns of a gather."""
    refuse_options(file, "a gather of a PMAC", lateral_step=lateral_step)
    cycles = count(gather_period, "gather_period")
    if servo_period is None and cycles != 1:
        refuse_options(file, "read with a sampling rate", gather_period=gather_period)
    period = interval(file, sampling_rate=sampling_rate, period=servo_period, name="servo_period")
    step = period * cycles
    body, _ = _rows(file, text_lines(file), breaks=False)
    t = step * np.arange(len(body), dtype=np.float64)
    data, scales = _channels(file, t, body, names, scale, _COLUMN)
    return data.recording(
        "pmac-gather",
        {"rows": len(body), "columns": body.shape[1]},
        channel=channel,
        unit=unit,
        warnings=tuple(file.cut_text()),
        sampling_interval_s=step,
        count_scale={
            name: f"{factor!r} {label}".strip() for name, (factor, label) in scales.items()
        },
    )


def _channels(
    file: RawFile,
    t: FloatArray,
    body: FloatArray,
    names: Sequence[str] | None,
    scale: Any,
    usual: str,
) -> tuple[Channels, dict[str, tuple[float, str]]]:
    """Return the columns as channels, and what a count of each is."""
    columns = column_names(file, names, body.shape[1], usual)
    scales = scales_of(file, scale, columns)
    data = Channels(file)
    for name, column in zip(columns, body.T, strict=True):
        factor, label = scales[name]
        data.add(name, t, column * factor, label)
    return data, scales


def _names_of(usual: str, *, breaks: bool) -> Callable[[RawFile], tuple[str, ...]]:
    def channels(file: RawFile) -> tuple[str, ...]:
        """Return the names of the columns when none are declared."""
        body, _ = _rows(file, text_lines(file), breaks=breaks)
        return tuple(column_names(file, None, body.shape[1], usual))

    return channels


def _rows(file: RawFile, lines: list[str], *, breaks: bool = True) -> tuple[FloatArray, list[int]]:
    """Return the numbers, and the rows before which samples are lost."""
    rows: list[tuple[int, str]] = []
    lost: list[int] = []
    for number, line in enumerate(lines, start=1):
        text = line.strip()
        if text == _OVERRUN and breaks:
            lost.append(len(rows))
        elif text:
            rows.append((number, text))
    return number_block(file, rows), lost


def _numbered(file: RawFile, body: FloatArray, step: float) -> tuple[FloatArray, FloatArray]:
    """Return the times by the numbers in the first column, and the other columns."""
    count = body[:, 0]
    if body.shape[1] < 2 or not (np.isfinite(count).all() and (count == np.floor(count)).all()):
        raise file.corrupt(
            "the first column holds no sample numbers",
            field="column 0",
            expected="whole numbers and at least one more column",
            hint="leave numbered= out if halsampler ran without -t",
        )
    falls = np.flatnonzero(np.diff(count) <= 0.0)
    if falls.size:
        raise file.corrupt(
            "the sample numbers do not rise",
            field=f"row {int(falls[0]) + 2}",
            expected=f"more than {count[falls[0]]:.0f}",
            found=f"{count[falls[0] + 1]:.0f}",
        )
    return step * (count - count[0]), body[:, 1:]


def _part(file: RawFile, body: FloatArray, breaks: list[int], segment: int | None) -> FloatArray:
    """Return the rows between two overruns."""
    edges = sorted({0, *breaks, len(body)})
    n = len(edges) - 1
    if segment is None and n > 1:
        raise FormatMismatchError(
            f"{file.path}: samples are lost {n - 1} times (overrun) and their number is unknown; read one "
            f"part with segment=0 ... segment={n - 1}, or record with halsampler -t"
        )
    if not 0 <= (segment or 0) < n:
        raise FormatMismatchError(
            f"{file.path}: has no segment {segment}; it holds {n}, counted from 0"
        )
    return body[edges[segment or 0] : edges[(segment or 0) + 1]]


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
        return positive(period, name, dimension="time")
    return 1.0 / rate_of(sampling_rate or 0.0)


def scales_of(file: RawFile, scale: Any, names: Sequence[str]) -> dict[str, tuple[float, str]]:
    """Return what one count of each column is."""
    if scale is None:
        return dict.fromkeys(names, (1.0, ""))
    if isinstance(scale, Mapping):
        unknown = [str(name) for name in scale if name not in names]
        if unknown:
            raise ReadNameError(
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
        raise ReadError(f"{file.path}: scale {scale!r} is not a number") from None
    if not math.isfinite(factor) or factor == 0.0:
        raise ReadError(f"{file.path}: scale {scale!r} must be finite and not zero")
    return factor, label


halsampler = BuiltIn(_overruns, _names_of(_PIN, breaks=True), _read_pins)
"""Reader of LinuxCNC halsampler text."""

pmac_gather = BuiltIn(sniffer("pmac-gather"), _names_of(_COLUMN, breaks=False), _read_gather)
"""Reader of PMAC gather data; it is never recognised, since any columns of numbers look the same."""
