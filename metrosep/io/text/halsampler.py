"""LinuxCNC ``halsampler`` text: columns of HAL pins, without a header, at the rate of a thread.

Nothing in the text names the pins or the rate, so both are declared. Where the FIFO was full a line
``overrun`` stands: samples are lost, and only the numbers of ``halsampler -t`` tell how many.
See ``data_formats/halsampler/SPEC.md``.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, FormatMismatchError
from metrosep.core.recording import Recording
from metrosep.io.registry import Match
from metrosep.io.source import RawFile, refuse_options
from metrosep.io.text.dialect import is_number
from metrosep.io.text.logger import (
    Channels,
    column_names,
    first_lines,
    interval,
    number_block,
    scales_of,
    text_lines,
)

__all__ = ["channels", "read", "sniff"]

FORMAT = "halsampler"
_SNIFFED = 100
_OVERRUN = "overrun"
_PIN = "pin"


def sniff(file: RawFile) -> Match:
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


def channels(file: RawFile) -> tuple[str, ...]:
    """Return the names of the columns when none are declared."""
    body, _ = _rows(file, text_lines(file))
    return tuple(column_names(file, None, body.shape[1], _PIN))


def read(
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
    if lines[-1]:
        warnings.append("the file does not end with a line end; its last row may be cut off")
    data = Channels(file)
    pins = column_names(file, names, body.shape[1], _PIN)
    scales = scales_of(file, scale, pins)
    for name, column in zip(pins, body.T, strict=True):
        factor, label = scales[name]
        data.add(name, t, column * factor, label)
    return data.recording(
        FORMAT,
        {"rows": len(body), "overruns_before_rows": breaks},
        channel=channel,
        unit=unit,
        warnings=tuple(warnings),
        sampling_interval_s=step,
        segment=segment,
        numbered=numbered,
    )


def _rows(file: RawFile, lines: list[str]) -> tuple[FloatArray, list[int]]:
    """Return the numbers, and the rows before which samples are lost."""
    rows: list[tuple[int, str]] = []
    breaks: list[int] = []
    for number, line in enumerate(lines, start=1):
        text = line.strip()
        if text == _OVERRUN:
            breaks.append(len(rows))
        elif text:
            rows.append((number, text))
    return number_block(file, rows), breaks


def _numbered(file: RawFile, body: FloatArray, step: float) -> tuple[FloatArray, FloatArray]:
    """Return the times by the numbers in the first column, and the other columns."""
    count = body[:, 0]
    if body.shape[1] < 2 or not (np.isfinite(count).all() and (count == np.floor(count)).all()):
        raise CorruptFileError(
            file.path,
            "the first column holds no sample numbers",
            field="column 0",
            expected="whole numbers and at least one more column",
            hint="leave numbered= out if halsampler ran without -t",
        )
    falls = np.flatnonzero(np.diff(count) <= 0.0)
    if falls.size:
        raise CorruptFileError(
            file.path,
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
