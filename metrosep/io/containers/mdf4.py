"""ASAM MDF 4 ``.mf4``: groups of channels over a master of times, in blocks that point to one another.

A block has a name, a length, links and fields; the samples are records in a data block, plain or
deflated, whole or in a list. Status texts are labels: the number stays. Layouts and sources are in
``data_formats/mdf4/SPEC.md``.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import UnsupportedFeatureError
from metrosep.core.recording import Recording
from metrosep.io.declared import Fields, need_bytes
from metrosep.io.registry import demand, sniffer, structure
from metrosep.io.source import MAX_PIXELS, RawFile, refuse_options
from metrosep.io.text.logger import Channels

FORMAT = "mdf4"
_BLOCK = structure(FORMAT, "block")
_FIELDS = {name: structure(FORMAT, name) for name in ("HD", "DG", "CG", "CN", "CC", "DZ")}
_HEADER_BYTES = 24
_FIRST = 64
_MAX_LINKS = 2**20
_MAX_RATIO = 1040
"""A deflate stream grows by 1032 at most."""

_VALUE, _MASTER, _VIRTUAL_MASTER = 0, 2, 3
_TIME = 1
_LABELS = (7, 8)
_SIGNED, _FLOAT, _BIG = (2, 3), (4, 5), (1, 3, 5)

sniff = sniffer(FORMAT)


class _Block(NamedTuple):
    """A block: its name, links to others (0 for none), and its fields."""

    name: str
    at: int
    links: tuple[int, ...]
    start: int  # of the fields
    end: int
    fields: Fields  # of its kind, or of the block where the kind has none

    def link(self, index: int) -> int:
        """Return the offset of another block, 0 where there is none."""
        return self.links[index] if index < len(self.links) else 0


class _Tree:
    """The blocks of a file; every one is read once, and their number is bounded."""

    def __init__(self, file: RawFile) -> None:
        self.file = file
        self._left = 1000 + file.size // 6  # a block has 24 bytes, and few are led to four times

    def block(self, at: int, *names: str) -> _Block:
        """Return the block at an offset, which must be of one of these kinds."""
        self._left -= 1
        if self._left < 0:
            raise self.file.corrupt("the blocks lead to one another without end", offset=at)
        head = _BLOCK.read(self.file, at)
        name = head["name"].removeprefix("##")
        if name not in names:
            raise self.file.corrupt(
                "a block is of another kind",
                offset=at,
                expected=" or ".join(names),
                found=head["name"],
            )
        n, length = head["links"], head["length"]
        need_bytes(self.file, at, length, f"block {name}", name="length")
        start = at + _HEADER_BYTES + 8 * n
        if n > _MAX_LINKS or start > at + length:
            raise head.error("links", f"as many as fit into {length} bytes")
        links = struct.unpack_from(f"<{n}Q", self.file.data, at + _HEADER_BYTES)
        declared = _FIELDS.get(name)
        fields = head if declared is None else declared.read(self.file, start)
        return _Block(name, at, links, start, at + length, fields)

    def chain(self, at: int, name: str) -> Iterator[_Block]:
        """Yield the blocks that follow one another by their first link."""
        while at:
            found = self.block(at, name)
            yield found
            at = found.link(0)

    def text(self, at: int) -> str:
        """Return the text of a block, of XML that of its element ``TX``."""
        if not at:
            return ""
        found = self.block(at, "TX", "MD")
        raw = self.file.data[found.start : found.end].split(b"\0")[0].decode("utf-8", "replace")
        if found.name == "MD":
            raw = raw.partition("<TX>")[2].partition("</TX>")[0]
        return raw.strip()


def channels(file: RawFile) -> tuple[str, ...]:
    """Return the names of the channels."""
    return _data(file, None)[0].names


def read(
    file: RawFile,
    *,
    channel: str | None = None,
    lateral_step: Any = None,
    unit: Any = None,
    group: Any = None,
) -> Recording:
    """Return the channels of an MDF file."""
    refuse_options(file, "an MDF recording", lateral_step=lateral_step)
    data, header, warnings = _data(file, group)
    return data.recording(
        FORMAT,
        header,
        channel=channel,
        unit=unit,
        warnings=tuple(warnings),
        start_ns=header["start_time_ns"],
    )


def _data(file: RawFile, group: Any) -> tuple[Channels, dict[str, Any], list[str]]:
    demand(file, FORMAT)
    tree = _Tree(file)
    head = tree.block(_FIRST, "HD")
    header: dict[str, Any] = {"version": file.head[8:16].decode("latin-1").strip(" \0")}
    header |= head.fields
    warnings: list[str] = []
    data, number = Channels(file), 0
    for part in tree.chain(head.link(0), "DG"):
        groups = list(tree.chain(part.link(1), "CG"))
        if len(groups) > 1:
            raise UnsupportedFeatureError(
                f"{file.path}: a data group of the MDF file mixes the records of {len(groups)} channel "
                "groups; sort it first, as the program that wrote it can"
            )
        for described in groups:
            number += 1
            if group in (None, number, str(number)):
                _add_group(tree, part, described, number, data, header, warnings)
    if not data.names:
        raise file.corrupt(
            "holds no channel of numbers",
            expected="a group with samples",
            found=f"{number} groups",
        )
    return data, header, warnings


def _add_group(
    tree: _Tree,
    part: _Block,
    described: _Block,
    number: int,
    data: Channels,
    header: dict[str, Any],
    warnings: list[str],
) -> None:
    """Add the channels of a group with their times."""
    cg, dg = described.fields, part.fields
    count = cg["cycles"]
    if not count:
        return
    width = dg["id_bytes"] + cg["data_bytes"] + cg["invalid_bytes"]
    if count > MAX_PIXELS or width > 2**20 or width * count > 8 * MAX_PIXELS:
        raise cg.error("cycles", "a recording that can be read at once")
    raw = _records(tree, part.link(2), count * width)
    records = np.frombuffer(raw, np.uint8).reshape(count, width)
    found: dict[str, tuple[FloatArray, str]] = {}
    names: list[str] = []
    times = None
    for cn in tree.chain(described.link(1), "CN"):
        fields = cn.fields
        name = tree.text(cn.link(2)) or f"channel {len(names) + 1}"
        names.append(name)
        master = fields["type"] in (_MASTER, _VIRTUAL_MASTER)
        if master and fields["sync"] != _TIME:
            raise UnsupportedFeatureError(
                f"{tree.file.path}: group {number} is over an angle, a distance or an index ({name}), not "
                "over time"
            )
        if not master and (
            fields["type"] != _VALUE or fields["data_type"] > max(_FLOAT) or cn.link(1)
        ):
            warnings.append(f"{name} holds texts, bytes or an array and was omitted")
            continue
        if fields["type"] == _VIRTUAL_MASTER:
            values = np.arange(count, dtype=np.float64)
        else:
            values = _numbers(records, fields, dg["id_bytes"])
        values, unit, note = _converted(tree, cn.link(4), values)
        if note:
            warnings.append(f"{name}: {note}")
        if master:
            times = values
        else:
            invalid = _invalid(records, fields, dg["id_bytes"] + cg["data_bytes"])
            values[invalid] = np.nan
            found[name] = (values, tree.text(cn.link(6)) or unit)
    header[f"group {number}"] = {"samples": count, "channels": tuple(names)}
    if times is None:
        raise tree.file.corrupt(f"group {number} has no channel of times", offset=described.at)
    for name, (values, unit) in found.items():
        data.add(name, times, values, unit)


def _records(tree: _Tree, at: int, size: int) -> bytes:
    """Return the bytes of all records, joined and inflated up to the size that the group claims."""
    parts: list[bytes] = []
    held = 0
    for block in _pieces(tree, at):
        data = tree.file.data[block.start : block.end]
        if block.name == "DZ":
            data = _inflated(tree, block)
        parts.append(data)
        held += len(data)
        if held >= size:
            break
    if held < size:
        raise tree.file.corrupt(
            "the samples end early", offset=at, expected=f"{size} bytes", found=f"{held} bytes"
        )
    return b"".join(parts)[:size]


def _pieces(tree: _Tree, at: int) -> Iterator[_Block]:
    """Yield the blocks that hold the samples, in order."""
    while at:
        block = tree.block(at, "DT", "DZ", "DL", "HL")
        if block.name == "HL":
            at = block.link(0)
        elif block.name == "DL":
            for piece in block.links[1:]:
                if piece:
                    yield tree.block(piece, "DT", "DZ")
            at = block.link(0)
        else:
            yield block
            return


def _inflated(tree: _Tree, block: _Block) -> bytes:
    fields = block.fields
    size, packed = fields["plain_bytes"], fields["packed_bytes"]
    start = block.start + _FIELDS["DZ"].size
    if start + packed > block.end or size > _MAX_RATIO * packed or fields["method"] > 1:
        raise fields.error("plain_bytes", "what a deflated block of this size can hold")
    try:
        inflater = zlib.decompressobj()
        data = inflater.decompress(tree.file.data[start : start + packed], size + 1)
    except zlib.error as exc:
        raise tree.file.corrupt(f"a deflated block is damaged ({exc})", offset=start) from None
    if len(data) != size:
        raise fields.error("plain_bytes", f"{len(data)} bytes")
    columns = fields["columns"]
    if fields["method"] == 1 and columns > 1:  # the bytes of each column of the records together
        rows = size // columns
        body = np.frombuffer(data[: rows * columns], np.uint8).reshape(columns, rows)
        data = body.T.tobytes() + data[rows * columns :]
    return data


def _numbers(records: NDArray[np.uint8], fields: Fields, skip: int) -> FloatArray:
    """Return the raw numbers of a channel, whatever bits of a record it takes."""
    bits, offset, kind = fields["bits"], fields["bit_offset"], fields["data_type"]
    start, width = skip + fields["byte_offset"], -(-(bits + offset) // 8)
    if not 1 <= bits <= 64 or width > 8 or offset > 7 or start + width > records.shape[1]:
        raise fields.error("bits", "a number within the record")
    body = records[:, start : start + width]
    if kind in _BIG:
        body = body[:, ::-1]
    if kind in _FLOAT:
        if bits not in (16, 32, 64) or offset:
            raise fields.error("bits", "16, 32 or 64 for a float")
        with np.errstate(invalid="ignore"):
            return np.ascontiguousarray(body).view(f"<f{width}")[:, 0].astype(np.float64)
    words = np.zeros((len(records), 8), np.uint8)
    words[:, :width] = body
    whole = words.view("<u8")[:, 0] >> np.uint64(offset)
    if bits < 64:
        whole = whole & np.uint64((1 << bits) - 1)
    if kind in _SIGNED:
        left = np.uint64(64 - bits)
        return ((whole << left).view(np.int64) >> np.int64(64 - bits)).astype(np.float64)
    return whole.astype(np.float64)


def _invalid(records: NDArray[np.uint8], fields: Fields, start: int) -> NDArray[np.bool_]:
    """Return where the record says that the sample is not valid."""
    if fields["flags"] & 1:
        return np.ones(len(records), dtype=np.bool_)
    if not fields["flags"] & 2:
        return np.zeros(len(records), dtype=np.bool_)
    byte, bit = divmod(fields["invalid_bit"], 8)
    if start + byte >= records.shape[1]:
        raise fields.error("invalid_bit", "a bit within the record")
    return np.asarray(records[:, start + byte] >> bit & 1, dtype=np.bool_)


def _converted(tree: _Tree, at: int, raw: FloatArray) -> tuple[FloatArray, str, str]:
    """Return physical values, the unit of the conversion, and a sentence where it was not applied."""
    if not at:
        return raw, "", ""
    block = tree.block(at, "CC")
    fields = block.fields
    unit, kind, n = tree.text(block.link(1)), fields["type"], fields["values"]
    start = block.start + _FIELDS["CC"].size
    if start + 8 * n > block.end:
        raise fields.error("values", f"up to {(block.end - start) // 8}")
    v = np.frombuffer(tree.file.data, "<f8", n, start)
    least = {1: 2, 2: 6, 4: 2, 5: 2, 6: 4}.get(kind, 0)
    if n < least:
        raise fields.error("values", f"at least {least}")
    if kind == 0:
        return raw, unit, ""
    if kind in _LABELS:
        return raw, unit, "its texts are labels of the numbers, which were kept"
    with np.errstate(all="ignore"):
        if kind == 1:
            return v[0] + v[1] * raw, unit, ""
        if kind == 2:
            top, below = (np.polynomial.polynomial.polyval(raw, c[::-1]) for c in (v[:3], v[3:6]))
            values = np.asarray(top / below)
        elif kind == 4:
            values = np.interp(raw, v[0 : n // 2 * 2 : 2], v[1 : n // 2 * 2 : 2])
        elif kind == 5:
            keys, results = v[0 : n // 2 * 2 : 2], v[1 : n // 2 * 2 : 2]
            above = np.searchsorted(keys, raw).clip(1, keys.size - 1) if keys.size > 1 else 0
            below_ = np.maximum(np.asarray(above) - 1, 0)
            nearer = raw - keys[below_] <= keys[above] - raw  # the lower one of two equally near
            values = np.where(nearer, results[below_], results[above])
        elif kind == 6:
            values = np.full(raw.size, v[-1])
            for low, high, result in reversed(v[: (n - 1) // 3 * 3].reshape(-1, 3).tolist()):
                values[(raw >= low) & (raw <= high)] = result
        else:
            return raw, "", f"conversion {kind} (a formula or texts) is not applied: raw numbers"
    return np.where(np.isfinite(values), values, np.nan), unit, ""
