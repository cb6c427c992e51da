"""Columns of numbers without any header, over time: the caller declares names, interval and scale.

Shared by the formats that nothing in the file describes (LinuxCNC halsampler, PMAC gather).
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from numbers import Real
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, FormatMismatchError, ReadError
from metrosep.core.units import parse_quantity, parse_unit
from metrosep.io.logger import plain_block, to_number
from metrosep.io.source import RawFile

__all__ = ["column_names", "interval", "number_block", "scales_of"]

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
