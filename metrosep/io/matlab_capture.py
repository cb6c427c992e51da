"""Captures of dSPACE in a MATLAB file: a struct with times X and channels Y, each with a Name.

``X(1).Data`` are the times in s, ``Y(i).Data`` the samples, ``Capture.SamplingPeriod`` the step.
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from metrosep.core.errors import CorruptFileError, FormatMismatchError, UnsupportedFeatureError
from metrosep.core.recording import Recording
from metrosep.io.logger import Channels
from metrosep.io.matlab_values import Values
from metrosep.io.source import RawFile

__all__ = ["find_capture", "recording_of", "trace_names"]

_CAPTURE = re.compile(r"(.+)\.Y(?:\((\d+)\))?\.Data")


def _captures(values: Values) -> dict[str, list[str]]:
    """Return each capture with the prefixes of its channels, such as ``capture.Y(2)``."""
    found: dict[str, list[str]] = {}
    for name in values.numbers:
        match = _CAPTURE.fullmatch(name)
        if match is None:
            continue
        prefix = name.removesuffix(".Data")
        if f"{prefix}.Name" in values.texts and _clock(values, match[1]) is not None:
            found.setdefault(match[1], []).append(prefix)
    return found


def trace_names(values: Values) -> dict[str, dict[str, str]]:
    """Return the channels of every capture."""
    return {name: _traces(values, parts) for name, parts in _captures(values).items()}


def _traces(values: Values, prefixes: list[str]) -> dict[str, str]:
    """Return the names of channels with their prefixes; a name that is taken gets a number."""
    named: dict[str, str] = {}
    for prefix in prefixes:
        name = text = values.texts[f"{prefix}.Name"] or prefix
        count = 1
        while name in named:
            count += 1
            name = f"{text} ({count})"
        named[name] = prefix
    return named


def _clock(values: Values, capture: str) -> str | None:
    """Return the name of the times or of the sampling period of a capture."""
    names = (f"{capture}.X.Data", f"{capture}.X(1).Data", f"{capture}.Capture.SamplingPeriod")
    return next((n for n in names if n in values.numbers), None)


def find_capture(
    file: RawFile, values: Values, channel: str | None
) -> tuple[str, dict[str, str]] | None:
    """Return the capture that is meant, and its channels."""
    captures = trace_names(values)
    if channel is None:
        if len(captures) > 1:
            raise FormatMismatchError(
                f"{file.path}: holds {len(captures)} captures ({', '.join(captures)}); choose one with "
                f"channel={next(iter(captures))!r}"
            )
        return next(iter(captures.items()), None)
    for name, traces in captures.items():
        if channel == name:
            return name, traces
        if channel in traces:
            return name, {channel: traces[channel]}
    return None


def recording_of(
    file: RawFile,
    format_id: str,
    values: Values,
    capture: str,
    traces: dict[str, str],
    *,
    unit: Any,
) -> Recording:
    """Return the channels of a capture over its times."""
    if f"{capture}.X(2).Data" in values.numbers:
        raise UnsupportedFeatureError(
            f"{file.path}: capture {capture!r} has several axes of time (X), and which channel has which is "
            "not known; export the channels of one raster"
        )
    clock = _clock(values, capture) or ""
    period = values.numbers.get(f"{capture}.Capture.SamplingPeriod")
    period_s = None if period is None else float(period.ravel()[0])
    data = Channels(file)
    for name, prefix in traces.items():
        samples = np.asarray(values.numbers[f"{prefix}.Data"].ravel(), dtype=np.float64)
        if clock.endswith("Data"):
            t = np.asarray(values.numbers[clock].ravel(), dtype=np.float64)
        elif period_s is not None and 0.0 < period_s < np.inf:
            t = period_s * np.arange(samples.size, dtype=np.float64)
        else:
            raise CorruptFileError(
                file.path, "the sampling period is not positive", field=clock, found=period_s
            )
        if t.size != samples.size:
            raise CorruptFileError(
                file.path,
                "a channel and its times differ in length",
                field=prefix,
                expected=f"{t.size} samples",
                found=f"{samples.size}",
            )
        data.add(name, t, samples, values.texts.get(f"{prefix}.Unit", ""))
    return data.recording(
        format_id,
        values.header,
        unit=unit,
        capture=capture,
        sampling_period_s=period_s,
    )
