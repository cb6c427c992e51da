"""imc FAMOS ``.raw`` and ``.dat``: blocks ``|XX,version,length,fields;`` and samples between them.

A group (CG) holds components (CC), each with a numeric type (CP), a place in the samples (Cb), a scale
(CR) and a name (CN). A sample is ``raw * factor + offset``; sample k of a channel is at ``x0 + k dx``,
in an XY set the second component holds the times. See ``data_formats/imc/SPEC.md``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import FormatMismatchError, UnitError, UnsupportedFeatureError
from metrosep.core.recording import Recording
from metrosep.core.units import parse_unit
from metrosep.io.declared import need_bytes
from metrosep.io.objects import check_area, check_scale
from metrosep.io.registry import demand, sniffer
from metrosep.io.source import RawFile, refuse_options
from metrosep.io.text.logger import Channels

FORMAT = "imc"
_BLOCK = re.compile(rb"\s*\|([A-Za-z]{2}),\s*(\d{1,9}),\s*(\d{1,12}),")
_MAX_BLOCKS = 100_000
_TYPES = {1: "u1", 2: "i1", 3: "u2", 4: "i2", 5: "u4", 6: "i4", 7: "f4", 8: "f8", 11: "u2",
          12: "u8", 13: "6u1", 14: "i8"}  # fmt: skip
_OTHER_TYPES = {9: "compressed by the device", 10: "ASCII time stamps"}
_SINGLE, _XY = 1, (2, 3)
_OTHER_FIELDS = {4: "complex", 5: "complex", 6: "complex", 7: "a polar field"}
_LARGEST_STEP = 1e9

sniff = sniffer(FORMAT)


@dataclass
class _Component:
    """Blocks of one component by their key, with where each begins."""

    group: int
    blocks: dict[str, tuple[int, list[str]]] = field(default_factory=dict)


@dataclass
class _Content:
    """Groups with their own blocks, components in order, samples by index."""

    order: str = "<"
    groups: list[dict[str, tuple[int, list[str]]]] = field(default_factory=list)
    components: list[_Component] = field(default_factory=list)
    samples: dict[int, tuple[int, int]] = field(default_factory=dict)  # start, bytes


def channels(file: RawFile) -> tuple[str, ...]:
    """Return the names of the channels."""
    return _data(file, _content(file)).names


def read(
    file: RawFile,
    *,
    channel: str | None = None,
    lateral_step: Any = None,
    unit: Any = None,
) -> Recording:
    """Return the channels of an imc file."""
    refuse_options(file, "an imc recording", lateral_step=lateral_step)
    content = _content(file)
    header = {
        f"group {g}": {key: ",".join(v) for key, (_, v) in blocks.items()}
        for g, blocks in enumerate(content.groups, start=1)
    } | {
        f"component {k}": {key: ",".join(v) for key, (_, v) in c.blocks.items()}
        for k, c in enumerate(content.components, start=1)
    }
    start = _start(content)
    data = _data(file, content)
    return data.recording(FORMAT, header, channel=channel, unit=unit, start=start)


def _content(file: RawFile) -> _Content:
    demand(file, FORMAT)
    content = _Content()
    for key, at, body in _blocks(file):
        if key == "CS":
            head = body[:20].split(b",", 1)
            index = head[0].strip()
            if len(head) < 2 or not index.isdigit():
                raise file.corrupt("samples have no number", field="CS", offset=at)
            skip = len(head[0]) + 1
            content.samples[int(index)] = (at + skip, len(body) - skip)
            continue
        values = body.decode("latin-1").split(",")
        if key == "CG":
            content.groups.append({key: (at, values)})
        elif key == "CC":
            if not content.groups:
                raise file.corrupt("a component belongs to no group", field="CC", offset=at)
            content.components.append(_Component(len(content.groups) - 1))
        elif key in ("CP", "Cb", "CR", "CN") and content.components:
            content.components[-1].blocks[key] = (at, values)
        elif content.groups:
            content.groups[-1].setdefault(key, (at, values))
    if not content.components:
        raise file.corrupt("holds no channel", expected="a block |CC", field="CC")
    return content


def _blocks(file: RawFile) -> Iterator[tuple[str, int, bytes]]:
    """Yield key, offset of the content and content of each block; samples are not copied whole."""
    data, place = file.data, 0
    for _ in range(_MAX_BLOCKS):
        found = _BLOCK.match(data, place, place + 64)
        if found is None:
            left = data[place : place + 64].strip()
            if left:
                raise file.corrupt(
                    "a block does not begin where the one before it ends",
                    offset=place,
                    expected="'|' and two letters",
                    found=repr(left[:12]),
                )
            return
        length, start = int(found[3]), found.end()
        need_bytes(file, start, length + 1, f"block {found[1].decode()}", name="length")
        if data[start + length : start + length + 1] != b";":
            raise file.corrupt(
                "a block has another length than it says",
                field=found[1].decode(),
                offset=start + length,
                expected="';'",
                found=repr(data[start + length : start + length + 1]),
            )
        key = found[1].decode()
        yield key, start, data[start : start + length]
        place = start + length + 1
    raise file.corrupt("holds more blocks than a recording can have", expected=_MAX_BLOCKS)


def _data(file: RawFile, content: _Content) -> Channels:
    data = Channels(file)
    for index, group in enumerate(content.groups):
        members = [c for c in content.components if c.group == index]
        kind = int(_value(file, group, "CG", 1, "0"))
        if kind in _XY and len(members) == 2:
            values, times = (_samples(file, content, c) for c in members)
            factor = _seconds(file, _unit(members[1]), "the second component of an XY set")
            if values.size != times.size:
                raise file.corrupt(
                    "the components of an XY set differ in length",
                    expected=times.size,
                    found=values.size,
                )
            data.add(_name(members[0]), times * factor, values, _unit(members[0]))
            continue
        if kind != _SINGLE:
            what = _OTHER_FIELDS.get(kind, f"type {kind}")
            raise UnsupportedFeatureError(
                f"{file.path}: a group of the imc file is {what}; only channels over time and XY sets "
                "are read: export it as one of them"
            )
        for member in members:
            values = _samples(file, content, member)
            dx = _value(file, group, "CD", 0)
            unit = _text(group, "CD", 3).strip('"')
            factor = _seconds(file, unit, "the abscissa")
            check_scale(file, "CD dx", dx, low=1e-15, high=_LARGEST_STEP)
            x0 = _value(file, member.blocks, "Cb", 9, "0")
            t = (x0 + dx * np.arange(values.size, dtype=np.float64)) * factor
            data.add(_name(member), t, values, _unit(member))
    return data


def _samples(file: RawFile, content: _Content, member: _Component) -> FloatArray:
    """Return the scaled samples of a component."""
    blocks = member.blocks
    if _value(file, blocks, "Cb", 0) != 1:
        raise UnsupportedFeatureError(
            f"{file.path}: channel {_name(member)!r} lies in several buffers; save it again as one"
        )
    kind = int(_value(file, blocks, "CP", 2))
    if kind not in _TYPES:
        what = _OTHER_TYPES.get(kind, "unknown")
        raise UnsupportedFeatureError(
            f"{file.path}: the samples of {_name(member)!r} are of type {kind} ({what}); export "
            "them as numbers"
        )
    width = int(_value(file, blocks, "CP", 1))
    dtype = np.dtype(_TYPES[kind]).newbyteorder("<")
    if width != dtype.itemsize:
        raise file.corrupt(
            "the size of a sample contradicts its type",
            field="CP",
            offset=blocks["CP"][0],
            expected=dtype.itemsize,
            found=width,
        )
    reference = int(_value(file, blocks, "Cb", 3))
    if reference not in content.samples:
        raise file.corrupt("the samples are missing", field=f"CS {reference}")
    start, size = content.samples[reference]
    offset, filled = (int(_value(file, blocks, "Cb", k)) for k in (4, 7))
    need_bytes(file, start, size, "the samples")
    if offset < 0 or filled < width or offset + filled > size:
        raise file.corrupt(
            "a channel does not fit into its samples",
            field="Cb",
            offset=blocks["Cb"][0],
            expected=f"{width} to {size} bytes",
            found=f"{filled} bytes from {offset}",
        )
    count = filled // width
    check_area(file, count, 1, names=("samples", "channels"))
    raw = np.frombuffer(file.data, dtype=dtype, count=count, offset=start + offset)
    if kind == 13:  # 48 bits, unsigned
        values = raw.astype(np.float64) @ (256.0 ** np.arange(6))
    else:
        with np.errstate(invalid="ignore"):
            values = raw.astype(np.float64)
    if _value(file, blocks, "CR", 0, "0") == 1:
        factor = _value(file, blocks, "CR", 1)
        shift = _value(file, blocks, "CR", 2)
        check_scale(file, "CR factor", abs(factor), low=1e-300, high=1e300)
        values = values * factor + shift
    return np.where(np.isfinite(values), values, np.nan)


def _value(
    file: RawFile,
    blocks: Mapping[str, tuple[int, list[str]]],
    key: str,
    index: int,
    default: str | None = None,
) -> float:
    """Return a finite number of a block."""
    at, values = blocks.get(key, (None, []))
    text = (values[index].strip() if index < len(values) else "") or default
    try:
        number = float((text or "")[:40])
    except ValueError:
        number = math.nan
    if not abs(number) < 1e15 and key != "CR":
        raise file.corrupt(
            "a field is missing or not usable",
            field=f"{key}, field {index + 1}",
            offset=at,
            expected="a number",
            found=repr((text or "")[:40]),
        )
    return number


def _text(blocks: Mapping[str, tuple[int, list[str]]], key: str, index: int) -> str:
    values = blocks.get(key, (0, []))[1]
    return values[index].strip() if index < len(values) else ""


def _name(member: _Component) -> str:
    return _counted(member, "CN", 3) or "channel"


def _unit(member: _Component) -> str:
    return _counted(member, "CR", 4)


def _counted(member: _Component, key: str, index: int) -> str:
    """Return a text whose length stands before it; it may hold commas."""
    length = _text(member.blocks, key, index)
    rest = ",".join(member.blocks.get(key, (0, []))[1][index + 1 :])
    if not length.isdecimal() or len(length) > 6:
        return ""
    quotes = rest.startswith('"')  # the length counts what stands between them
    return rest[quotes : int(length) + quotes].strip()


def _seconds(file: RawFile, unit: str, what: str) -> float:
    """Return seconds per unit of an abscissa; refuse another one than time."""
    try:
        return parse_unit(unit, dimension="time").factor
    except UnitError:
        raise FormatMismatchError(
            f"{file.path}: {what} is in {unit or 'no unit'!r}, not in a unit of time; only recordings "
            "over time are read"
        ) from None


def _start(content: _Content) -> str | None:
    """Return the time of the trigger without a zone, ``None`` where there is none."""
    blocks = content.groups[0]
    seconds = _text(content.components[0].blocks, "Cb", 10) or "0"
    try:
        day, month, year, hour, minute = (int(_text(blocks, "NT", k)) for k in range(5))
        moment = datetime(year, month, day, hour, minute)
        more = float(_text(blocks, "NT", 5)) + float(seconds)
        return (moment + timedelta(seconds=more)).isoformat()
    except (ValueError, OverflowError):
        return None
