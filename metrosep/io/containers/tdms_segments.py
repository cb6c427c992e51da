"""Structure of a TDMS file: the segments, their objects, and where the samples of a channel are.

Only lead-ins and metadata are read. The samples stay in the file as extents, so that sizes are
checked against the file before anything is allocated, and any part can be read by itself. An index
file beside it is not used. See ``data_formats/tdms/SPEC.md``.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from metrosep.core.errors import CorruptFileError, FormatMismatchError, UnsupportedFeatureError
from metrosep.io.declared import Cursor
from metrosep.io.source import RawFile

MAGIC = b"TDSm"
_LEAD_IN = 28
_OPEN_END = 0xFFFFFFFFFFFFFFFF
_META, _NEW_LIST, _INTERLEAVED, _BIG_ENDIAN = 2, 4, 32, 64
_NO_DATA, _AS_BEFORE = 0xFFFFFFFF, 0
_MAX_EXTENTS = 2**20
_BLOCK_BYTES = 2**22
"""Bytes that are read from the file at once."""


@dataclass(frozen=True, slots=True)
class Extent:
    """Values of a channel in the chunks of one segment."""

    offset: int  # byte of the first value in the file
    dtype: np.dtype[Any]  # dtype: type and byte order of a value
    stride: int  # bytes from a value to the next one
    count: int  # values in a whole chunk
    n_chunks: int  # whole chunks
    chunk_bytes: int  # bytes of a chunk with all its channels
    last_offset: int = 0  # byte of the first value in the chunk that is not whole
    last_count: int = 0  # values there
    bit: int | None = None  # the bit that holds a digital line

    @property
    def n_values(self) -> int:
        """Number of values."""
        return self.count * self.n_chunks + self.last_count

    def blocks(self, handle: BinaryIO) -> Iterator[NDArray[Any]]:
        """Yield the values in order, a few megabytes at a time."""
        size = self.dtype.itemsize
        if self.chunk_bytes <= _BLOCK_BYTES:  # many chunks at once
            each = max(1, _BLOCK_BYTES // self.chunk_bytes)
            span = (self.count - 1) * self.stride + size
            for first in range(0, self.n_chunks if self.count else 0, each):
                n = min(each, self.n_chunks - first)
                length = (n - 1) * self.chunk_bytes + span
                content = _part(handle, self.offset + first * self.chunk_bytes, length)
                yield self._values(content, (n, self.count), (self.chunk_bytes, self.stride))
        else:
            for k in range(self.n_chunks):
                yield from self._run(handle, self.offset + k * self.chunk_bytes, self.count)
        yield from self._run(handle, self.last_offset, self.last_count)

    def _run(self, handle: BinaryIO, offset: int, count: int) -> Iterator[NDArray[Any]]:
        each = max(1, _BLOCK_BYTES // self.stride)
        for first in range(0, count, each):
            n = min(each, count - first)
            length = (n - 1) * self.stride + self.dtype.itemsize
            content = _part(handle, offset + first * self.stride, length)
            yield self._values(content, (n,), (self.stride,))

    def _values(
        self, content: bytes, shape: tuple[int, ...], strides: tuple[int, ...]
    ) -> NDArray[Any]:
        values = np.ndarray(shape, self.dtype, content, strides=strides).reshape(-1)
        return values if self.bit is None else (values >> self.bit) & 1


def _part(handle: BinaryIO, offset: int, length: int) -> bytes:
    handle.seek(offset)
    return handle.read(length)


@dataclass(slots=True)
class TdmsChannel:
    """An object of the file: properties, and the places of its samples."""

    group: str  # the two parts of its path; `name` is empty for a group, both for the file itself
    name: str
    # as in the file; what a later segment says counts
    properties: dict[str, Any] = field(default_factory=dict)
    # to list of Extent: by the number of the DAQmx scaler, -1 for other data
    extents: dict[int, list[Extent]] = field(default_factory=dict)
    type_code: int = 0  # type of the values; 0 when there are none

    @property
    def n_values(self) -> int:
        """Number of samples, by the shortest scaler."""
        return min((sum(e.n_values for e in es) for es in self.extents.values()), default=0)


@dataclass(slots=True)
class TdmsFile:
    """Objects of a file by their path, and what is unusual about it."""

    # to TdmsChannel: in the order of the file
    objects: dict[str, TdmsChannel] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)  # sentences
    version: int = 0  # version in the first lead-in
    n_segments: int = 0  # number of segments


@dataclass(slots=True)
class _Segment:
    """A lead-in, and the objects whose samples are in the segment."""

    flags: int
    data: int
    end: int
    is_cut: bool

    @property
    def order(self) -> str:
        return ">" if self.flags & _BIG_ENDIAN else "<"


def read_structure(file: RawFile) -> TdmsFile:
    """Return the objects of a TDMS file and the places of their samples."""
    found = TdmsFile()
    layout: dict[str, Index | None] = {}  # objects of the segment, None without samples
    active: dict[str, Index] = {}
    known: dict[str, Index] = {}
    n_extents = 0
    with file.stream() as handle:
        position = 0
        while position + _LEAD_IN <= file.size:
            segment = _lead_in(file, found, handle.read(_LEAD_IN), position)
            if segment.data > file.size:
                found.warnings.append(
                    f"the last segment, at byte {position}, ends inside its description: its samples are "
                    "lost"
                )
                break
            if segment.flags & _META:
                block = handle.read(segment.data - position - _LEAD_IN)
                cursor = MetaCursor(file, block, order=segment.order, start=position + _LEAD_IN)
                layout = {} if segment.flags & _NEW_LIST else dict(layout)
                _objects(cursor, found, layout, known)
                active = {path: index for path, index in layout.items() if index is not None}
            if segment.end > segment.data:
                n_extents += len(active)
            if n_extents > _MAX_EXTENTS:
                raise UnsupportedFeatureError(
                    f"{file.path}: the samples are in more than {_MAX_EXTENTS} pieces; defragment the file "
                    "in LabVIEW (TDMS Defragment)"
                )
            if segment.end > segment.data:
                _place(file, found, segment, active)
            found.n_segments += 1
            if segment.is_cut:
                found.warnings.append(
                    f"the last segment, at byte {position}, was not finished: the recording was "
                    "interrupted or the file is cut off; the samples that are there were read"
                )
            position = segment.end
            handle.seek(position)
    if position < file.size and not found.warnings:
        found.warnings.append(f"the last {file.size - position} bytes belong to no segment")
    return found


def _lead_in(file: RawFile, found: TdmsFile, head: bytes, position: int) -> _Segment:
    if head[:4] != MAGIC:
        if position == 0:
            raise FormatMismatchError(
                f"{file.path}: is not a TDMS file: expected {MAGIC!r}, found {head[:4]!r}"
            )
        raise file.corrupt(
            "a segment does not begin where the one before ends",
            offset=position,
            field="tag",
            expected=MAGIC,
            found=head[:4],
        )
    (flags,) = struct.unpack_from("<I", head, 4)
    order = ">" if flags & _BIG_ENDIAN else "<"
    version, length, meta = struct.unpack_from(f"{order}IQQ", head, 8)
    if version not in (4712, 4713):
        raise file.corrupt(
            "the version of a segment is unknown",
            offset=position + 8,
            field="version",
            expected="4712 or 4713",
            found=version,
        )
    start = position + _LEAD_IN
    is_cut = length == _OPEN_END or start + length > file.size
    end = file.size if is_cut else start + length
    if meta > length:
        raise file.corrupt(
            "the samples of a segment begin behind its end",
            offset=position + 20,
            field="raw data offset",
            expected=f"up to {length}",
            found=meta,
        )
    found.version = found.version or version
    return _Segment(flags, start + meta, end, is_cut)


def _objects(
    cursor: MetaCursor, found: TdmsFile, layout: dict[str, Index | None], known: dict[str, Index]
) -> None:
    """Read the objects of a segment into the layout, and their properties into the file."""
    (n_objects,) = cursor.numbers("I", "number of objects")
    for _ in range(n_objects):
        path = cursor.text("path of an object")
        group, name = _parts(path)
        channel = found.objects.setdefault(path, TdmsChannel(group, name))
        (head,) = cursor.numbers("I", f"raw data of {path[:40]}")
        if head == _NO_DATA:
            layout[path] = None
        elif head == _AS_BEFORE:
            if path not in known:
                raise cursor.wrong(
                    "raw data are said to be as before, but there were none",
                    path[:40],
                    "an index",
                    0,
                )
            layout[path] = known[path]
        else:
            layout[path] = known[path] = read_index(cursor, head, path)
            code = known[path].type_code
            if channel.type_code not in (0, code):
                raise cursor.wrong(
                    "the type of a channel changes", path[:40], channel.type_code, code
                )
            channel.type_code = code
        (n_properties,) = cursor.numbers("I", f"number of properties of {path[:40]}")
        for _ in range(n_properties):
            key, value = cursor.property()
            channel.properties[key] = value


def _parts(path: str) -> tuple[str, str]:
    """Return group and channel of ``/'group'/'channel'``; a quote inside is doubled."""
    parts = path.strip("/").removeprefix("'").removesuffix("'").split("'/'", 1)
    group, *rest = (p.replace("''", "'") for p in parts)
    return group, rest[0] if rest else ""


def _place(file: RawFile, found: TdmsFile, segment: _Segment, active: Mapping[str, Index]) -> None:
    """Add the extents of a segment to its channels."""
    n_bytes = segment.end - segment.data
    is_daqmx = {bool(index.scalers) for index in active.values()}
    if len(is_daqmx) > 1:
        raise _unfit(file, segment, "DAQmx and other samples stand in one segment", "one kind")
    if True in is_daqmx:
        pieces, chunk = _daqmx_pieces(file, segment, active)
    elif segment.flags & _INTERLEAVED:
        pieces, chunk = _interleaved_pieces(file, segment, active)
    else:
        pieces, chunk = _contiguous_pieces(segment, active)
    if chunk == 0:
        raise _unfit(file, segment, "there are bytes, but no channel has samples", "0 bytes")
    n_chunks, rest = divmod(n_bytes, chunk)
    if rest and not segment.is_cut:
        if n_chunks == 0:
            raise _unfit(file, segment, "the samples do not fill a chunk", f"{chunk} bytes")
        found.warnings.append(
            f"the last chunk at byte {segment.data + n_chunks * chunk} is shorter than declared: its "
            "bytes were shared out among the channels in proportion"
        )
    if rest and not segment.is_cut and any(index.type_code == STRING for index in active.values()):
        raise _unfit(
            file, segment, "chunks with text are not whole", f"a multiple of {chunk} bytes"
        )
    before = 0
    for piece in pieces:
        last, shift = _last(segment, piece, chunk, rest, before)
        before += last * piece.stride
        extent = Extent(
            segment.data + piece.shift,
            piece.dtype,
            piece.stride,
            piece.count,
            n_chunks,
            chunk,
            segment.data + n_chunks * chunk + shift,
            last,
            piece.bit,
        )
        if piece.is_number and extent.n_values:
            found.objects[piece.path].extents.setdefault(piece.scaler, []).append(extent)


@dataclass(frozen=True, slots=True)
class _Piece:
    """Values of a channel in a chunk; `shift` counts from the start of the chunk, `row` likewise."""

    path: str
    shift: int
    dtype: np.dtype[Any]
    stride: int
    count: int
    is_number: bool = True
    in_rows: bool = False
    row: int = 0
    scaler: int = -1
    bit: int | None = None


def _last(segment: _Segment, piece: _Piece, chunk: int, rest: int, before: int) -> tuple[int, int]:
    """Return number and place of the values in a chunk that is not whole."""
    if rest == 0:
        return 0, 0
    if piece.in_rows:  # whole rows
        return min(piece.count, max(0, (rest - piece.row) // piece.stride)), piece.shift
    if segment.is_cut:  # channel after channel, until the file ends
        room = max(0, rest - piece.shift)
        return min(piece.count, room // piece.stride), piece.shift
    return piece.count * rest // chunk, before  # a shorter chunk: all channels in proportion


def _contiguous_pieces(segment: _Segment, active: Mapping[str, Index]) -> tuple[list[_Piece], int]:
    pieces, shift = [], 0
    for path, index in active.items():
        code = NUMBER_TYPES.get(index.type_code)
        size = index.n_bytes // index.count if index.count else 1
        dtype = np.dtype(segment.order + (code or "u1"))
        count = index.count if code or index.n_bytes else 0
        pieces.append(_Piece(path, shift, dtype, max(1, size), count, code is not None))
        shift += index.n_bytes
    return pieces, shift


def _interleaved_pieces(
    file: RawFile, segment: _Segment, active: Mapping[str, Index]
) -> tuple[list[_Piece], int]:
    counts = {index.count for index in active.values()}
    if len(counts) > 1 or any(index.type_code == STRING for index in active.values()):
        raise _unfit(file, segment, "interleaved channels must be equally long", "one count")
    count = counts.pop() if counts else 0
    row = sum(index.n_bytes for index in active.values()) // count if count else 0
    pieces, shift = [], 0
    for path, index in active.items():
        code = NUMBER_TYPES.get(index.type_code)
        dtype = np.dtype(segment.order + (code or "u1"))
        pieces.append(
            _Piece(path, shift, dtype, max(1, row), count, code is not None, in_rows=True)
        )
        shift += index.n_bytes // count if count else 0
    return pieces, row * count


def _daqmx_pieces(
    file: RawFile, segment: _Segment, active: Mapping[str, Index]
) -> tuple[list[_Piece], int]:
    """Return pieces of buffers that stand one after another, each in rows."""
    widths = {index.widths for index in active.values()}
    if len(widths) > 1:
        raise _unfit(file, segment, "DAQmx channels have different rows", "the same widths")
    row_widths = widths.pop()
    rows = [0] * len(row_widths)
    for index in active.values():
        for scaler in index.scalers:
            rows[scaler.buffer] = max(rows[scaler.buffer], index.count)
    starts = [0]
    for width, n in zip(row_widths, rows, strict=True):
        starts.append(starts[-1] + width * n)
    pieces = []
    for path, index in active.items():
        for scaler in index.scalers:
            begin = starts[scaler.buffer]
            pieces.append(
                _Piece(
                    path,
                    begin + scaler.byte,
                    np.dtype(segment.order + scaler.code),
                    row_widths[scaler.buffer],
                    index.count,
                    in_rows=True,
                    row=begin,
                    scaler=scaler.number if index.type_code == DAQMX_RAW else -1,
                    bit=scaler.bit,
                )
            )
    return pieces, starts[-1]


def _unfit(file: RawFile, segment: _Segment, reason: str, expected: str) -> CorruptFileError:
    return file.corrupt(
        reason,
        offset=segment.data,
        field="raw data",
        expected=expected,
        found=f"{segment.end - segment.data} bytes",
    )


# ---- metadata of a TDMS segment: strings, properties and the index of raw data, with bounds ----
# Every step of the cursor needs bytes that are there, so a damaged count ends at the end of the block.

NUMBER_TYPES = {
    1: "i1", 2: "i2", 3: "i4", 4: "i8", 5: "u1", 6: "u2", 7: "u4", 8: "u8", 9: "f4", 10: "f8",
    0x19: "f4", 0x1A: "f8", 0x21: "u1",
}  # fmt: skip
"""Type code to NumPy code of the types that become samples."""

DAQMX_RAW = 0xFFFFFFFF
STRING = 0x20
"""Type code of text."""

_TIMESTAMP = 0x44
_OTHER_SIZES = {_TIMESTAMP: 16, 0x08000C: 8, 0x10000D: 16}
_FORMAT_CHANGING, _DIGITAL_LINE = 0x1269, 0x126A
_DAQMX_TYPES = ("u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f4", "f8")
_EPOCH = datetime(1904, 1, 1)  # UTC by definition


@dataclass(frozen=True, slots=True)
class Scaler:
    """Where the raw values of a DAQmx channel are."""

    number: int  # the scale that these values are the input of
    code: str  # numPy type
    buffer: int  # which buffer of the chunk
    byte: int  # first byte in a row
    bit: int | None  # bit of a digital line


@dataclass(frozen=True, slots=True)
class Index:
    """Raw data of an object in each chunk."""

    type_code: int  # type of the values
    count: int  # number of values
    n_bytes: int  # bytes, unless DAQmx
    scalers: tuple[Scaler, ...] = ()  # for DAQmx
    widths: tuple[int, ...] = ()  # bytes of a row of each DAQmx buffer


class MetaCursor(Cursor):
    """A place in a block of metadata."""

    short = "the metadata of a segment end too early"

    def property(self) -> tuple[str, Any]:
        """Return the next property."""
        name = self.text("name of a property")
        (code,) = self.numbers("I", f"type of property {name[:40]!r}")
        if code == STRING:
            return name, self.text(name[:40])
        if code == _TIMESTAMP:
            return name, self._time(name[:40])
        if code in NUMBER_TYPES:
            dtype = np.dtype(self.order + NUMBER_TYPES[code])
            value = np.frombuffer(self.take(dtype.itemsize, name[:40]), dtype)[0].item()
            return name, bool(value) if code == 0x21 else value
        raise self.wrong("a property has an unknown type", name[:40], "a type of TDMS", hex(code))

    def _time(self, name: str) -> str:
        seconds, fraction = 0, 0
        if self.order == "<":
            fraction, seconds = self.numbers("Qq", name)
        else:
            seconds, fraction = self.numbers("qQ", name)
        try:
            moment = _EPOCH + timedelta(seconds=seconds)
        except OverflowError:
            return f"{seconds} s after 1904-01-01"
        return f"{moment.isoformat(timespec='seconds')}.{fraction * 10**9 >> 64:09d}Z"


def read_index(cursor: MetaCursor, head: int, path: str) -> Index:
    """Return the index of raw data that follows its first word."""
    name = f"raw data of {path[:40]}"
    code, dimension, count = cursor.numbers("IIQ", name)
    if dimension != 1:
        raise cursor.wrong("the dimension of raw data is not 1", name, 1, dimension)
    if head in (_FORMAT_CHANGING, _DIGITAL_LINE):
        return _daqmx_index(cursor, head, code, count, name)
    if code == STRING:
        return Index(code, count, *cursor.numbers("Q", name))
    if code in NUMBER_TYPES:
        return Index(code, count, count * np.dtype(NUMBER_TYPES[code]).itemsize)
    if code in _OTHER_SIZES:
        return Index(code, count, count * _OTHER_SIZES[code])
    raise UnsupportedFeatureError(
        f"{cursor.file.path}: {path[:80]} holds values of the TDMS type 0x{code:x}, which metrosep does "
        "not read; export them as double"
    )


def _daqmx_index(cursor: MetaCursor, head: int, code: int, count: int, name: str) -> Index:
    digital = head == _DIGITAL_LINE
    (n_scalers,) = cursor.numbers("I", name)
    scalers = []
    for _ in range(n_scalers):
        kind, buffer, place, _bitmap, number = cursor.numbers("IIIBI" if digital else "5I", name)
        if kind >= len(_DAQMX_TYPES) or (digital and kind >= 8):
            raise cursor.wrong("the type of a DAQmx scaler is unknown", name, "0 to 9", kind)
        bit = place % 8 if digital else None
        byte = place // 8 if digital else place
        scalers.append(Scaler(number, _DAQMX_TYPES[kind], buffer, byte, bit))
    (n_widths,) = cursor.numbers("I", name)
    widths = struct.unpack(f"{cursor.order}{n_widths}I", cursor.take(4 * n_widths, name))
    for scaler in scalers:
        size = np.dtype(scaler.code).itemsize
        if scaler.buffer >= n_widths or scaler.byte + size > widths[scaler.buffer]:
            raise cursor.wrong("a DAQmx scaler lies outside of its buffer", name, widths, scaler)
    if not scalers or (code != DAQMX_RAW and len(scalers) != 1):
        raise cursor.wrong("the number of DAQmx scalers does not fit", name, 1, n_scalers)
    return Index(code, count, 0, tuple(scalers), widths)
