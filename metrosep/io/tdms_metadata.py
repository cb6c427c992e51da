"""Metadata of a TDMS segment: strings, properties and the index of raw data, with bounds.

Every step of the cursor needs bytes that are there, so a damaged count ends at the end of the block.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

import numpy as np

from metrosep.core.errors import CorruptFileError, UnsupportedFeatureError
from metrosep.io.source import RawFile

__all__ = ["DAQMX_RAW", "NUMBER_TYPES", "STRING", "Cursor", "Index", "Scaler", "read_index"]

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


class Cursor:
    """A place in a block of metadata that moves as fields are read."""

    def __init__(self, file: RawFile, block: bytes, offset: int, order: str) -> None:
        self.file, self.order = file, order
        self._block, self._start, self._at = block, offset, 0

    @property
    def offset(self) -> int:
        """Byte of the file."""
        return self._start + self._at

    def take(self, size: int, name: str) -> bytes:
        """Return the next bytes."""
        end = self._at + size
        if end > len(self._block):
            raise CorruptFileError(
                self.file.path,
                "the metadata of a segment end too early",
                offset=self.offset,
                field=name,
                expected=f"{size} bytes",
                found=f"{len(self._block) - self._at}",
            )
        part = self._block[self._at : end]
        self._at = end
        return part

    def numbers(self, codes: str, name: str) -> tuple[Any, ...]:
        """Return the next fields by their `struct` codes."""
        layout = struct.Struct(self.order + codes)
        return layout.unpack(self.take(layout.size, name))

    def text(self, name: str) -> str:
        """Return the next string."""
        (size,) = self.numbers("I", name)
        return self.take(size, name).decode("utf-8", "replace")

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

    def wrong(self, reason: str, name: str, expected: object, found: object) -> CorruptFileError:
        """Return the error for a field."""
        return CorruptFileError(
            self.file.path,
            reason,
            offset=self.offset,
            field=name,
            expected=expected,
            found=found,
        )


def read_index(cursor: Cursor, head: int, path: str) -> Index:
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


def _daqmx_index(cursor: Cursor, head: int, code: int, count: int, name: str) -> Index:
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
