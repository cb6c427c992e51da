"""TDMS, the binary recording of LabVIEW and NI-DAQmx: channels with a sampling interval each.

Structure and sizes are checked by `metrosep.io.containers.tdms_segments` before a sample is read; an index file
is ignored. Interrupted recordings have channels of unequal length: what is missing is NaN. See
``data_formats/tdms/SPEC.md``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from datetime import datetime
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    CorruptFileError,
    FormatMismatchError,
    ReadNameError,
    UnitError,
    UnsupportedFeatureError,
)
from metrosep.core.recording import Recording
from metrosep.io.containers.tdms_segments import (
    DAQMX_RAW,
    TdmsChannel,
    TdmsFile,
    read_structure,
)
from metrosep.io.registry import sniffer
from metrosep.io.source import MAX_PIXELS, RawFile, rate_of, refuse_options
from metrosep.io.text.logger import Channels, with_units

FORMAT = "tdms"
_INDEX_MAGIC = b"TDSh"
_STEP, _OFFSET, _START = "wf_increment", "wf_start_offset", "wf_start_time"
_AXIS, _AXIS_UNIT = "wf_xname", "wf_xunit_string"
_TIME_AXES = frozenset({"time", "zeit", "temps", "tiempo", "tempo", "t"})
_SAME_STEP = 1e-4
"""Largest relative difference of a stated rate from the file's own: digits of a property."""

_UNIT_KEYS = ("unit_string", "NI_UnitDescription")


sniff = sniffer(FORMAT)


def channels(file: RawFile) -> tuple[str, ...]:
    """Return the names of the channels that hold numbers."""
    return tuple(_numbers(_structure(file)))


def read(
    file: RawFile,
    *,
    channel: str | None = None,
    lateral_step: Any = None,
    unit: Any = None,
    group: str | None = None,
    time: str | None = None,
    sampling_rate: Any = None,
) -> Recording:
    """Return the channels of a TDMS file."""
    refuse_options(file, "a TDMS recording", lateral_step=lateral_step)
    found = _structure(file)
    chosen = _chosen(file, _numbers(found), group, channel)
    total = sum(c.n_values for c in chosen.values())
    if total > MAX_PIXELS:
        raise UnsupportedFeatureError(
            f"{file.path}: holds {total} samples, more than the {MAX_PIXELS} that are read at once; "
            "choose a channel, or read it in chunks with metrosep.io.stream"
        )
    values = {}
    with file.stream() as handle:
        for name, described in chosen.items():
            values[name] = _Rest(file, found, described, handle).take(described.n_values)
    warnings = [*found.warnings, *_odd(found, values)]
    times, facts = _times(file, chosen, values, time, sampling_rate, unit)
    if facts.get("channels_without_start"):
        shown = ", ".join(facts["channels_without_start"][:8])
        warnings.append(f"channels without a start of their own begin with the earliest: {shown}")
    data = Channels(file)
    for name, samples in values.items():
        if name != time:
            finite = np.where(np.isfinite(samples), samples, np.nan)
            data.add(name, times[name], finite, _label(chosen[name]))
    if isinstance(unit, Mapping) and time is not None:
        unit = {name: text for name, text in unit.items() if name != time}
    return data.recording(FORMAT, _header(found), unit=unit, warnings=tuple(warnings), **facts)


def iter_chunks(file: RawFile, names: Sequence[str], size: int) -> Iterator[dict[str, FloatArray]]:
    """Yield the samples of channels from their start, a chunk at a time, in bounded memory."""
    found = _structure(file)
    known = _numbers(found)
    chosen = {name: _chosen(file, known, None, name)[name] for name in names}
    longest = max((c.n_values for c in chosen.values()), default=0)
    with file.stream() as handle:
        sources = {n: _Rest(file, found, c, handle) for n, c in chosen.items()}
        for start in range(0, longest, size):
            n = min(size, longest - start)
            yield {name: source.take(n) for name, source in sources.items()}


class _Rest:
    """What is left of a channel: raw blocks of each scaler, scaled when they are taken."""

    def __init__(
        self, file: RawFile, found: TdmsFile, channel: TdmsChannel, handle: BinaryIO
    ) -> None:
        self._scaling = _scaling(file, found, channel)
        self._left = channel.n_values
        self._blocks = {
            k: (block for extent in extents for block in extent.blocks(handle))
            for k, extents in channel.extents.items()
        }
        self._held = {k: np.empty(0) for k in channel.extents}

    def take(self, n: int) -> FloatArray:
        """Return the next samples; NaN behind the end."""
        count = min(n, self._left)
        self._left -= count
        values = np.full(n, np.nan)
        if count:
            values[:count] = self._scaling({k: self._raw(k, count) for k in self._blocks})
            values[np.isinf(values)] = np.nan
        return values

    def _raw(self, scaler: int, count: int) -> np.ndarray[Any, Any]:
        parts, missing = [self._held[scaler][:count]], count - self._held[scaler].size
        rest = self._held[scaler][count:]
        while missing > 0:
            block = next(self._blocks[scaler])
            parts.append(block[:missing])
            rest = block[missing:]
            missing -= block.size
        self._held[scaler] = rest
        filled = [p for p in parts if p.size]
        return filled[0] if len(filled) == 1 else np.concatenate(filled)


def _structure(file: RawFile) -> TdmsFile:
    if file.head[:4] == _INDEX_MAGIC:
        raise UnsupportedFeatureError(
            f"{file.path}: is the index of a TDMS file and holds no samples; read the .tdms file beside it"
        )
    found = read_structure(file)
    if not any(c.extents for c in found.objects.values()):
        raise file.corrupt(
            "no channel holds a number",
            expected="samples",
            found=f"{len(found.objects)} objects without",
        )
    return found


def _numbers(found: TdmsFile) -> dict[str, TdmsChannel]:
    """Return the channels with samples by the name that a caller uses."""
    filled = [c for c in found.objects.values() if c.extents]
    several = len({c.group for c in filled}) > 1
    return {f"{c.group}/{c.name}" if several else c.name: c for c in filled}


def _chosen(
    file: RawFile, known: Mapping[str, TdmsChannel], group: str | None, channel: str | None
) -> dict[str, TdmsChannel]:
    if channel is not None and channel not in known:
        raise ReadNameError(
            f"{file.path}: has no channel {channel!r} with samples; the channels are "
            f"{', '.join(list(known)[:20])}"
        )
    chosen = {
        name: c
        for name, c in known.items()
        if (group is None or c.group == group) and (channel is None or name == channel)
    }
    if not chosen:
        groups = ", ".join(list(dict.fromkeys(c.group for c in known.values()))[:20])
        raise ReadNameError(
            f"{file.path}: has no such channel in group {group!r}; the groups are {groups}"
        )
    return chosen


def _scaling(file: RawFile, found: TdmsFile, channel: TdmsChannel) -> Scaling:
    parents = [
        c.properties
        for group in (channel.group, "")
        for c in found.objects.values()
        if c.group == group and not c.name
    ]
    return scaling_of(file, channel, tuple(parents))


def _label(channel: TdmsChannel) -> str:
    return next((str(v) for k in _UNIT_KEYS if (v := channel.properties.get(k))), "")


def _odd(found: TdmsFile, values: Mapping[str, FloatArray]) -> Iterator[str]:
    """Yield sentences on what is odd about the samples."""
    lengths = {name: v.size for name, v in values.items()}
    if len(set(lengths.values())) > 1:
        shown = ", ".join(f"{n} {k}" for n, k in list(lengths.items())[:8])
        yield f"the channels differ in length ({shown}): the shorter ones end with NaN"
    for name, samples in values.items():
        infinite = int(np.isinf(samples).sum())
        if infinite:
            yield f"{infinite} infinite values of {name} were taken as not measured"
    left = [c.name for c in found.objects.values() if c.type_code and not c.extents]
    if left:
        yield f"channels without numbers were omitted: {', '.join(left[:8])}"


def _positive(file: RawFile, name: str, value: Any) -> float:
    if not isinstance(value, (int, float)) or not np.isfinite(value) or value <= 0.0:
        raise file.corrupt(
            "the sampling interval is not usable",
            field=name,
            expected="a positive number of s",
            found=repr(value)[:40],
        )
    return float(value)


def _times(
    file: RawFile,
    chosen: Mapping[str, TdmsChannel],
    values: Mapping[str, FloatArray],
    time: str | None,
    sampling_rate: Any,
    unit: Any,
) -> tuple[dict[str, FloatArray], dict[str, Any]]:
    """Return the times of each channel in s, and facts for the metadata."""
    if time is not None:
        refuse_options(file, "read with a channel of times", sampling_rate=sampling_rate)
        return _by_channel(file, chosen, values, time, unit), {"time_channel": time}
    declared = None if sampling_rate is None else 1.0 / rate_of(sampling_rate)
    starts = {name: _start(file, c) for name, c in chosen.items()}
    first = min((s for s in starts.values() if s is not None), default=None)
    times = {}
    shared: dict[tuple[float, float, int], FloatArray] = {}
    for name, described in chosen.items():
        step = _step(file, name, described, declared)
        offset = described.properties.get(_OFFSET, 0.0)
        if not isinstance(offset, (int, float)) or not np.isfinite(offset):
            raise file.corrupt("the start is not usable", field=_OFFSET, found=offset)
        start = starts[name]
        if start is not None and first is not None:
            offset += (start[0] - first[0]).total_seconds() + (start[1] - first[1]) * 1e-9
        key = (float(offset), step, values[name].size)
        if key not in shared:
            shared[key] = key[0] + step * np.arange(key[2], dtype=np.float64)
        times[name] = shared[key]
    return times, {
        "start_utc": None if first is None else f"{first[0].isoformat()}.{first[1]:09d}Z",
        "channels_without_start": tuple(
            n for n, s in starts.items() if s is None and first is not None
        ),
    }


def _refuse_other_axis(file: RawFile, name: str, channel: TdmsChannel) -> None:
    """Refuse a waveform over anything but seconds: a spectrum, or times in another unit."""
    axis = str(channel.properties.get(_AXIS, "")).strip()
    unit = str(channel.properties.get(_AXIS_UNIT, "")).strip()
    if (axis and axis.casefold() not in _TIME_AXES) or (unit and unit != "s"):
        raise UnsupportedFeatureError(
            f"{file.path}: channel {name[:40]!r} is over {axis[:20] or 'time'!r} in {unit[:20] or 's'!r}, not over "
            "time in s; only waveforms over time are read"
        )


def _step(file: RawFile, name: str, channel: TdmsChannel, declared: float | None) -> float:
    _refuse_other_axis(file, name, channel)
    own = channel.properties.get(_STEP)
    if own is not None:
        own = _positive(file, _STEP, own)
        if declared is not None and abs(declared / own - 1.0) > _SAME_STEP:
            raise FormatMismatchError(
                f"{file.path}: channel {name!r} has a sampling interval of {own:g} s by the file; leave out "
                "sampling_rate="
            )
        return own
    if declared is None:
        raise FormatMismatchError(
            f"{file.path}: channel {name!r} has no sampling interval; give sampling_rate=, or name the "
            "channel of times with time="
        )
    return declared


def _by_channel(
    file: RawFile,
    chosen: Mapping[str, TdmsChannel],
    values: Mapping[str, FloatArray],
    time: str,
    unit: Any,
) -> dict[str, FloatArray]:
    if time not in chosen or len(chosen) < 2:
        raise ReadNameError(
            f"{file.path}: has no channel {time!r} beside others; the channels are "
            f"{', '.join(list(chosen)[:20])}"
        )
    declared = {time: unit[time]} if isinstance(unit, Mapping) and time in unit else None
    known = with_units(file, {time: _label(chosen[time])}, declared)[time]
    if known is None or known.dimension != "time":
        raise UnitError(
            f"{file.path}: the channel of times {time!r} has no unit of time; declare it, such as "
            f"unit={{{time!r}: 's'}}"
        )
    t = values[time] * known.factor
    longest = max(v.size for v in values.values())
    if not np.isfinite(t).all() or t.size < longest:
        raise file.corrupt(f"channel {time[:40]!r} does not give a time for every sample")
    return {name: t[: v.size] for name, v in values.items()}


def _start(file: RawFile, channel: TdmsChannel) -> tuple[datetime, int] | None:
    """Return the start of a channel as whole seconds and nanoseconds."""
    text = channel.properties.get(_START)
    if text is None:
        return None
    whole, _, fraction = str(text).removesuffix("Z").partition(".")
    try:
        moment = datetime.fromisoformat(whole).replace(tzinfo=None)
        return moment, int(fraction[:9].ljust(9, "0"))
    except ValueError:
        raise file.corrupt(
            "the time of the start is not usable", field=_START, found=repr(text)[:40]
        ) from None


def _header(found: TdmsFile) -> dict[str, Any]:
    return {
        "version": found.version,
        "n_segments": found.n_segments,
        "objects": {path: dict(c.properties) for path, c in found.objects.items()},
    }


# ---- scales of TDMS channels: from raw numbers of a card to volts or a physical quantity -------
# Linear and polynomial scales are computed here, each from the scale that it names as its input or
# from the raw data. Sensors (thermocouple, RTD, strain, table ...) are left to the package npTDMS.

Scaling = Callable[[Mapping[int, NDArray[Any]]], FloatArray]
"""From the raw values of each scaler (-1 without DAQmx) to float64."""

_RAW_INPUT = 0xFFFFFFFF
_MAX_SCALES = 64
_MAX_COEFFICIENTS = 64
_SCALE_TYPE = re.compile(r"NI_Scale\[(\d{1,6})\]_Scale_Type")
_OWN = ("Linear", "Polynomial", "AdvancedAPI")


def scaling_of(
    file: RawFile, channel: TdmsChannel, inherited: tuple[Mapping[str, Any], ...]
) -> Scaling:
    """Return how the raw values of a channel become its samples."""
    for properties in (channel.properties, *inherited):
        n_scales = _number(file, channel, properties)
        if n_scales and properties.get("NI_Scaling_Status", "unscaled") != "scaled":
            break
    else:
        if channel.type_code == DAQMX_RAW:
            raise _wrong(file, channel, "raw DAQmx data have no scale", "NI_Number_Of_Scales", 0)
        return _plain
    kinds = [properties.get(f"NI_Scale[{k}]_Scale_Type") for k in range(n_scales)]
    if any(kind not in (None, *_OWN) for kind in kinds):
        return _foreign(file, channel, properties, ", ".join(str(k) for k in kinds))
    steps: list[FloatArray] = []
    source = n_scales - 1
    for _ in range(n_scales + 1):
        if source == _RAW_INPUT:
            return _chain(file, channel, steps, -1)
        if not 0 <= source < n_scales:
            break
        kind = kinds[source]
        if kind is None:
            return _chain(file, channel, steps, source)
        steps.append(_coefficients(file, channel, properties, source, kind))
        source = properties.get(f"NI_Scale[{source}]_{kind}_Input_Source", _RAW_INPUT)
        if not isinstance(source, int):
            break
    raise _wrong(file, channel, "a scale has no input", "NI_Scale[..]_Input_Source", source)


def _plain(raw: Mapping[int, NDArray[Any]]) -> FloatArray:
    return next(iter(raw.values())).astype(np.float64)


def _chain(file: RawFile, channel: TdmsChannel, steps: list[FloatArray], scaler: int) -> Scaling:
    """Return the polynomials one after another, the one nearest to the raw values last in `steps`."""
    if scaler not in channel.extents:
        raise _wrong(file, channel, "a scale has no raw values", "scaler", scaler)

    def scaled(raw: Mapping[int, NDArray[Any]]) -> FloatArray:
        values = raw[scaler].astype(np.float64)
        for coefficients in reversed(steps):
            values = np.asarray(np.polynomial.polynomial.polyval(values, coefficients))
        return values

    return scaled


def _number(file: RawFile, channel: TdmsChannel, properties: Mapping[str, Any]) -> int:
    declared = properties.get("NI_Number_Of_Scales")
    if declared is None:
        found = [int(m[1]) for key in properties if (m := _SCALE_TYPE.fullmatch(key))]
        declared = max(found, default=-1) + 1
    if not isinstance(declared, (int, float, str)) or not str(declared).isdecimal():
        raise _wrong(
            file, channel, "the number of scales is none", "NI_Number_Of_Scales", declared
        )
    if int(declared) > _MAX_SCALES:
        raise _wrong(file, channel, "there are too many scales", "NI_Number_Of_Scales", declared)
    return int(declared)


def _coefficients(
    file: RawFile, channel: TdmsChannel, properties: Mapping[str, Any], k: int, kind: str
) -> FloatArray:
    """Return the coefficients of a scale, constant first."""
    prefix = f"NI_Scale[{k}]_{kind}"
    if kind == "AdvancedAPI":
        return np.array([0.0, 1.0])
    names = [f"{prefix}_Y_Intercept", f"{prefix}_Slope"]
    if kind == "Polynomial":
        n = properties.get(f"{prefix}_Coefficients_Size", 4)
        if not isinstance(n, int) or not 1 <= n <= _MAX_COEFFICIENTS:
            raise _wrong(file, channel, "a polynomial has no usable length", prefix, n)
        names = [f"{prefix}_Coefficients[{i}]" for i in range(n)]
    values = [properties.get(name) for name in names]
    for name, value in zip(names, values, strict=True):
        if not isinstance(value, (int, float)) or not math.isfinite(value):
            raise _wrong(file, channel, "a scale is not usable", name, value)
    if not any(values[1:]):
        raise _wrong(file, channel, "a scale gives the same value for all", names[-1], values[-1])
    return np.array(values, dtype=np.float64)


def _foreign(
    file: RawFile, channel: TdmsChannel, properties: Mapping[str, Any], kinds: str
) -> Scaling:
    """Return the scaling of a sensor by npTDMS."""
    try:
        from nptdms.base_segment import RawChannelDataChunk
        from nptdms.scaling import get_scaling
    except ImportError:
        raise UnsupportedFeatureError(
            f"{file.path}: channel {channel.name[:40]!r} is scaled by {kinds[:80]}, which needs the package "
            "nptdms; install metrosep[formats]"
        ) from None
    for name, value in properties.items():
        if name.endswith("_Size") and not (isinstance(value, int) and 0 <= value < 10**5):
            raise _wrong(file, channel, "a scale has no usable length", name, value)
    failures = (ArithmeticError, LookupError, RuntimeError, TypeError, ValueError)
    try:
        scaling = get_scaling(properties, {}, {})
    except failures as exc:
        raise _wrong(file, channel, f"a scale is not usable ({exc})", "NI_Scale", kinds) from None
    if scaling is None:
        raise UnsupportedFeatureError(
            f"{file.path}: channel {channel.name[:40]!r} is scaled by {kinds[:80]}, which is not read; "
            "export it as scaled values"
        )

    def scaled(raw: Mapping[int, NDArray[Any]]) -> FloatArray:
        plain = set(raw) == {-1}
        chunk = RawChannelDataChunk(raw[-1] if plain else None, None if plain else dict(raw))
        try:
            return np.asarray(scaling.scale(chunk), dtype=np.float64)
        except Exception as exc:  # npTDMS raises Exception itself
            raise _wrong(file, channel, f"a scale fails ({exc})", "NI_Scale", kinds) from None

    return scaled


def _wrong(
    file: RawFile, channel: TdmsChannel, reason: str, name: str, found: object
) -> CorruptFileError:
    return file.corrupt(
        f"channel {channel.name[:40]!r}: {reason}", field=name[:80], found=repr(found)[:80]
    )


# ---- TDMS channels in chunks; the file is never loaded as a whole ------------------------------


class TdmsSource:
    """The longest channels of a TDMS file; see `metrosep.io.stream.ChunkSource`."""

    def __init__(
        self, file: RawFile, stack: ExitStack | None = None, *, group: str | None = None
    ) -> None:
        self._file = file
        chosen = _chosen(file, _numbers(_structure(file)), group, None)
        longest = max(c.n_values for c in chosen.values())
        alike = {n: c for n, c in chosen.items() if c.n_values == longest}
        clocks = {
            tuple(str(c.properties.get(k, "")) for k in (_STEP, _OFFSET, _START)): n
            for n, c in alike.items()
        }
        if len(clocks) > 1:
            first, second = list(clocks.values())[:2]
            raise FormatMismatchError(
                f"{file.path}: channels {first!r} and {second!r} have different times; name the channels "
                "of one clock with group=, or read them with metrosep.read(channel=)"
            )
        name, described = next(iter(alike.items()))
        _refuse_other_axis(file, name, described)
        step = described.properties.get(_STEP)
        self.labels: Mapping[str, str] = {n: _label(c) for n, c in alike.items()}
        self.n_samples: int | None = longest
        self.time_step = None if step is None else _positive(file, _STEP, step)

    def chunks(self, names: Sequence[str], size: int) -> Iterator[dict[str, FloatArray]]:
        """Yield the channels, `size` samples at a time."""
        yield from iter_chunks(self._file, names, size)


open_source = TdmsSource
