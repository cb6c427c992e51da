"""MATLAB ``.mat``, version 5 (to -v7) and 7.3 (HDF5): maps, vectors, and captures of dSPACE.

A matrix becomes a surface, vectors become a profile or a recording, as the caller declares; nothing
in the file says a unit. A struct with fields X and Y, as dSPACE writes, is a recording of its own.
Layout and sources are in ``data_formats/matlab/SPEC.md``.
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from metrosep.core.errors import CorruptFileError, FormatMismatchError, UnsupportedFeatureError
from metrosep.core.profile import Profile
from metrosep.core.recording import Recording
from metrosep.core.surface import Surface
from metrosep.core.units import Unit
from metrosep.io.arrays import columns_as_object, map_as_surface
from metrosep.io.logger import Channels
from metrosep.io.matlab_values import Values, load, version_of
from metrosep.io.registry import Match
from metrosep.io.select import ColumnSpec
from metrosep.io.source import RawFile, refuse_options

__all__ = ["channels", "read", "sniff"]

FORMAT = "matlab"

_TIMES = ("t", "time")


def sniff(file: RawFile) -> Match:
    """Return how sure we are that a file is a MATLAB file."""
    return Match.NO if version_of(file.head) is None else Match.YES


def channels(file: RawFile) -> tuple[str, ...]:
    """Return the channels of a capture, and the names of matrices and vectors."""
    values = load(file)
    captures = trace_names(values)
    traces = tuple(name for named in captures.values() for name in named)
    inside = tuple(f"{capture}." for capture in captures)
    arrays = {*_maps(values), *_lines(values)}
    rest = (n for n in values.numbers if n in arrays and not n.startswith(inside))
    return tuple(dict.fromkeys((*traces, *rest)))


def read(
    file: RawFile,
    *,
    channel: str | None = None,
    lateral_step: Any = None,
    unit: Any = None,
    x: ColumnSpec | None = None,
    z: ColumnSpec | None = None,
    time: ColumnSpec | None = None,
    sampling_rate: float | str | None = None,
    scale: float | str | None = None,
    max_pixels: int | None = None,
) -> Surface | Profile | Recording:
    """Return a matrix, vectors of one length, or a capture."""
    values = load(file, max_pixels)
    columns: dict[str, ColumnSpec | None] = {"x": x, "z": z, "time": time}
    asked = [spec for spec in columns.values() if spec is not None]
    declared = bool(asked) or sampling_rate is not None
    capture = None if declared else find_capture(file, values, channel)
    if capture is not None:
        options = {"lateral_step": lateral_step, "scale": scale}
        refuse_options(file, "a dSPACE capture with its own times", **options)
        return recording_of(file, FORMAT, values, *capture, unit=unit)
    maps = _maps(values)
    if not declared and (channel in maps or (channel is None and len(maps) == 1)):
        name = channel or maps[0]
        return map_as_surface(
            file,
            FORMAT,
            values.numbers[name],
            name=name,
            own_unit=None,
            unit=unit,
            lateral_step=lateral_step,
            scale=scale,
            header=values.header,
        )
    vectors = _vectors(file, values, channel, asked, split=declared)
    kept = (
        channel if channel in vectors and (time is not None or sampling_rate is not None) else None
    )
    return columns_as_object(
        file,
        FORMAT,
        vectors,
        values.header,
        channel=kept,
        lateral_step=lateral_step,
        unit=unit,
        sampling_rate=sampling_rate,
        scale=scale,
        **columns,
    )


def _maps(values: Values) -> list[str]:
    return [n for n, v in values.numbers.items() if v.ndim == 2 and min(v.shape) > 1]


def _lines(values: Values) -> list[str]:
    """Return the names of rows and columns with more than one number."""
    return [n for n, v in values.numbers.items() if v.size > 1 and max(v.shape) == v.size]


def _vectors(
    file: RawFile, values: Values, channel: str | None, asked: list[ColumnSpec], *, split: bool
) -> dict[str, tuple[Any, Unit | None]]:
    """Return the vectors that are as long as the one that is named, or as the longest one."""
    found = {n: values.numbers[n].ravel() for n in _lines(values)}
    if split:
        for name in _maps(values):
            matrix = values.numbers[name]
            found |= {f"{name}(:,{k + 1})": matrix[:, k] for k in range(matrix.shape[1])}
            if channel == name:
                found = {n: v for n, v in found.items() if n.startswith(f"{name}(")}
    named = [n for n in (channel, *(n for s in asked for n in _names(s))) if n in found]
    if channel is not None and channel not in found and not (split and channel in _maps(values)):
        raise _missing(file, values, channel)
    if not found:
        raise _unclear(file, values)
    length = found[named[0]].size if named else max(v.size for v in found.values())
    alike: dict[str, tuple[Any, Unit | None]] = {
        n: (v, None) for n, v in found.items() if v.size == length
    }
    if split or channel is None:
        return alike
    return {n: v for n, v in alike.items() if n == channel or n.lower() in _TIMES}


def _names(spec: ColumnSpec) -> tuple[str, ...]:
    """Return the names that a specification can mean; ``z(:,1):um`` has a colon of its own."""
    return (spec, spec.rsplit(":", 1)[0]) if isinstance(spec, str) else (str(spec[0]),)


def _missing(file: RawFile, values: Values, channel: str) -> FormatMismatchError:
    if channel in values.left_out:
        return FormatMismatchError(
            f"{file.path}: {channel!r} is complex, sparse, an object or a function; in MATLAB save "
            "real and full numbers, such as full(real(...))"
        )
    return FormatMismatchError(
        f"{file.path}: has no matrix or vector {channel!r}; there is {_listed(file)}"
    )


def _unclear(file: RawFile, values: Values) -> FormatMismatchError | UnsupportedFeatureError:
    maps = _maps(values)
    if maps:
        return FormatMismatchError(
            f"{file.path}: holds {len(maps)} matrices ({_listed(file)}); choose one with "
            f"channel={maps[0]!r}"
        )
    left = f" (left out: {', '.join(values.left_out[:8])})" if values.left_out else ""
    return UnsupportedFeatureError(
        f"{file.path}: holds no matrix and no vector of real numbers{left}; save some as variables"
    )


def _listed(file: RawFile) -> str:
    names = channels(file)
    return ", ".join(map(repr, names[:12])) + (" ..." if len(names) > 12 else "") or "none"


# ---- captures of dSPACE in a MATLAB file: a struct with times X and channels Y, each with a Name ----
# ``X(1).Data`` are the times in s, ``Y(i).Data`` the samples, ``Capture.SamplingPeriod`` the step.

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
