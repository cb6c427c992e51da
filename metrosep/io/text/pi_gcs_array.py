"""PI GCS array: what the data recorder of a PI controller answers, with a header of ``#`` lines.

The header declares separator, number of columns and rows, sampling interval and names, so that every
row is checked against it. See ``data_formats/pi-gcs/SPEC.md``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, FormatMismatchError, ReadError
from metrosep.core.recording import Recording
from metrosep.core.units import parse_quantity
from metrosep.io.registry import Match
from metrosep.io.source import RawFile, refuse_options
from metrosep.io.text.logger import Channels, first_lines, plain_block, text_lines, to_number

__all__ = ["channels", "read", "sniff"]

FORMAT = "pi-gcs"
_END = "END_HEADER"
_NEEDED = frozenset({"TYPE", "SEPARATOR", "DIM"})
_SEPARATORS = {32: None, 9: "\t", 44: ",", 59: ";"}
_MAX_COLUMNS = 1024
_SAME_STEP = 1e-6
"""Relative deviation of a declared interval from the one of the file that is only rounding."""


def sniff(file: RawFile) -> Match:
    """Return how sure we are that a file is a GCS array."""
    fields, body = _header(first_lines(file))
    return Match.YES if body and fields.keys() >= _NEEDED else Match.NO


def channels(file: RawFile) -> tuple[str, ...]:
    """Return the names of the columns."""
    fields, _ = _checked(file, text_lines(file))
    return tuple(_names(fields, _count(file, fields, "DIM")))


def read(
    file: RawFile,
    *,
    channel: str | None = None,
    lateral_step: Any = None,
    unit: Any = None,
    sampling_rate: float | str | None = None,
) -> Recording:
    """Return the columns of a GCS array."""
    refuse_options(file, "a GCS array", lateral_step=lateral_step)
    lines = text_lines(file)
    fields, start = _checked(file, lines)
    n_columns = _count(file, fields, "DIM")
    rows = [(k, s) for k, s in enumerate(lines[start:], start=start + 1) if s.strip()]
    warnings = _row_count(file, fields, len(rows))
    if lines[-1]:
        warnings.append("the file does not end with a line end; its last row may be cut off")
    step = _step(file, fields, sampling_rate)
    body = _numbers(file, fields, rows, n_columns)
    t = step * np.arange(len(body), dtype=np.float64)
    data = Channels(file)
    for name, column in zip(_names(fields, n_columns), body.T, strict=True):
        data.add(name, t, column)
    remarks = [line.lstrip("# ")[3:].strip() for line in lines[:start] if line[:5] == "# REM"]
    return data.recording(
        FORMAT,
        {**fields, "REM": remarks},
        channel=channel,
        unit=unit,
        warnings=tuple(warnings),
        sample_time_s=step,
    )


def _header(lines: Iterable[str]) -> tuple[dict[str, str], int]:
    """Return the fields, and the index of the first row or 0 without an end of the header."""
    fields: dict[str, str] = {}
    for k, line in enumerate(lines):
        if not line.startswith("#"):
            if line.strip():
                return fields, 0
            continue
        text = line[1:].strip()
        if text == _END:
            return fields, k + 1
        match = re.fullmatch(r"([A-Z_]+\d*)\s*=\s*(.*)", text)
        if match:
            fields[match.group(1)] = match.group(2).strip()
    return fields, 0


def _checked(file: RawFile, lines: list[str]) -> tuple[dict[str, str], int]:
    fields, start = _header(lines)
    missing = _NEEDED - fields.keys()
    if len(missing) == len(_NEEDED):
        raise FormatMismatchError(
            f"{file.path}: is no GCS array: expected lines '# TYPE =', '# SEPARATOR =' and '# DIM ='"
        )
    if missing or not start:
        what = ", ".join(sorted(missing)) or _END
        raise CorruptFileError(file.path, "the header is not complete", expected=what)
    return fields, start


def _count(file: RawFile, fields: dict[str, str], name: str) -> int:
    text = fields[name]
    limit = _MAX_COLUMNS if name == "DIM" else 10**12
    if not (text.isascii() and text.isdecimal()) or not 1 <= int(text[:18]) <= limit:
        raise CorruptFileError(
            file.path,
            "a count of the header is not usable",
            field=name,
            expected=f"1 ... {limit}",
            found=repr(text[:20]),
        )
    return int(text[:18])


def _names(fields: dict[str, str], n_columns: int) -> list[str]:
    return [fields.get(f"NAME{k}") or f"column {k}" for k in range(n_columns)]


def _row_count(file: RawFile, fields: dict[str, str], n_rows: int) -> list[str]:
    """Return a warning where the count of rows is not declared; refuse a file that was cut off."""
    if "NDATA" not in fields:
        return ["the header has no NDATA, so missing rows would not be noticed"]
    declared = _count(file, fields, "NDATA")
    if declared != n_rows:
        raise CorruptFileError(
            file.path,
            "the count of rows is wrong",
            field="NDATA",
            expected=declared,
            found=n_rows,
            hint="record again or ask the controller for all points (DRR?)",
        )
    return []


def _step(file: RawFile, fields: dict[str, str], sampling_rate: float | str | None) -> float:
    declared = None
    if sampling_rate is not None:
        rate = parse_quantity(sampling_rate, dimension="frequency", name="sampling_rate")
        if not (math.isfinite(rate) and rate > 0.0):
            raise ReadError(f"{file.path}: sampling_rate is {rate} Hz; it must be positive")
        declared = 1.0 / rate
    if "SAMPLE_TIME" not in fields:
        if declared is None:
            raise ReadError(f"{file.path}: the header has no SAMPLE_TIME; give sampling_rate=")
        return declared
    own = to_number(file, fields["SAMPLE_TIME"], line=0, name="SAMPLE_TIME")
    if not own > 0.0:
        raise CorruptFileError(
            file.path,
            "the sampling interval is not usable",
            field="SAMPLE_TIME",
            expected="a positive number of s",
            found=repr(fields["SAMPLE_TIME"][:20]),
        )
    if declared is not None and abs(declared - own) > _SAME_STEP * own:
        raise FormatMismatchError(
            f"{file.path}: SAMPLE_TIME is {own:g} s, but sampling_rate={sampling_rate!r} was given; leave it out"
        )
    return own


def _numbers(
    file: RawFile, fields: dict[str, str], rows: list[tuple[int, str]], n_columns: int
) -> FloatArray:
    code = fields["SEPARATOR"]
    if not code.isdecimal() or int(code[:6]) not in _SEPARATORS:
        raise CorruptFileError(
            file.path,
            "the separator is not known",
            field="SEPARATOR",
            expected="32, 9, 44 or 59 (the code of a character)",
            found=repr(code[:20]),
        )
    separator = _SEPARATORS[int(code[:6])]
    texts = [text.strip(" \r") for _, text in rows]
    counts = {len(text.split(separator)) for text in texts}
    if counts == {n_columns}:
        block = plain_block(texts, range(n_columns), separator=separator, counts=counts)
        if block is not None:
            return block
    names = _names(fields, n_columns)
    body = np.empty((len(rows), n_columns))
    for k, (line, _) in enumerate(rows):
        found = texts[k].split(separator)
        if len(found) != n_columns:
            raise CorruptFileError(
                file.path,
                "a row does not fit",
                field=f"line {line}",
                expected=f"{n_columns} numbers",
                found=f"{len(found)}",
            )
        body[k] = [
            to_number(file, text, line=line, name=name[:40])
            for text, name in zip(found, names, strict=True)
        ]
    return body
