"""The tagged tree of Vision64 files (``.opdx``), read as if a stranger had sent it.

An item is a name (u32 length, UTF-8), a type byte and a value, little-endian. Containers hold items
and say how many bytes they take; each ends with a terminator. Every step moves forward inside the
container that encloses it, containers nest only so deep, and an array is a place in the file, not a
copy: nothing is allocated that the file does not hold. A type that is not known ends its container,
which is noted.
"""

from __future__ import annotations

import struct
from typing import Any, NamedTuple

from metrosep.core.errors import CorruptFileError
from metrosep.io.source import RawFile

__all__ = ["Quantity", "VcaBytes", "VcaTree", "plain_tree", "read_tree"]

_SCALARS = {
    0x01: "?",
    0x04: "<h",
    0x05: "<H",
    0x06: "<i",
    0x07: "<I",
    0x0A: "<q",
    0x0B: "<Q",
    0x0C: "<f",
    0x0D: "<d",
}
_TEXT, _QUANTITY, _UNIT, _TIME, _LIST, _END = 0x12, 0x13, 0x18, 0x15, 0x42, 0x7F
_CONTAINERS = (0x7D, 0x46, 0x47)
_CHOICE = 0x0E
_NAMED = (_CHOICE, 0x40, 0x45, 0x7C)
_MATRIX = 0x00
_TIME_BYTES = 9
_END_BYTES = 2
_MAX_CHOICE = 8
_MAX_TEXT = 2**16
_MAX_DEPTH = 32
_MAX_ITEMS = 100_000


class Quantity(NamedTuple):
    """A number with its unit; a unit alone has the value 1."""

    value: float  # the number
    name: str  # of the unit, such as ``"Micrometer"`` and ``"µm"``; empty when there is none
    symbol: str
    per_si: float | None  # units per SI unit, such as 1e6; ``None`` when the file does not say


class VcaBytes(NamedTuple):
    """Where an array or another structure lies in the file."""

    type: str  # its name, such as ``"Matrix<float>"``
    offset: int  # first byte and number of bytes
    size: int


class VcaTree(NamedTuple):
    """The items of a file."""

    # path such as ``"/1D_Data/Raw/Array"`` to plain values, `Quantity`, lists or `VcaBytes`
    items: dict[str, Any]
    warnings: list[str]  # what was not known and left out


def read_tree(file: RawFile, offset: int) -> VcaTree:
    """Return the items from an offset to the end of the file."""
    reader = _Reader(file)
    reader.container(offset, file.size, "", 0)
    return VcaTree(reader.items, reader.warnings)


def plain_tree(tree: VcaTree) -> dict[str, Any]:
    """Return the items as plain values; structures become their type and size."""
    plain: dict[str, Any] = {}
    for path, value in tree.items.items():
        if isinstance(value, Quantity):
            plain[path] = {"value": value.value, "unit": value.symbol or value.name}
        elif isinstance(value, VcaBytes):
            plain[path] = {"type": value.type, "bytes": value.size}
        else:
            plain[path] = value
    return plain


class _Reader:
    def __init__(self, file: RawFile) -> None:
        self._file = file
        self._n = 0
        self.items: dict[str, Any] = {}
        self.warnings: list[str] = []

    def container(self, place: int, end: int, path: str, depth: int) -> None:
        """Read the items of a container; each takes five bytes or more."""
        if depth > _MAX_DEPTH:
            raise self._corrupt("containers are nested too deep", place, path, str(_MAX_DEPTH), "")
        while place < end:
            self._n += 1
            if self._n > _MAX_ITEMS:
                raise self._corrupt("has too many items", place, path, f"up to {_MAX_ITEMS}", "")
            name, place = self._name(place, end, path or "the first item")
            where = f"{path}/{name[:60]}"
            self._need(place, 1, end, where)
            kind = self._file.data[place]
            if kind == _END:
                self._finish(name, place + 1, end, path)
                return
            following = self._item(kind, place + 1, end, where, depth)
            if following is None:
                self.warnings.append(
                    f"{where} has the unknown type {kind:#04x}: it and what follows in "
                    f"{path or 'the file'} were not read"
                )
                return
            place = following
        raise self._corrupt("ends without a terminator", place, path, "an item 7f ff ff", "none")

    def _finish(self, name: str, place: int, end: int, path: str) -> None:
        """Refuse a terminator that has a name or does not stand at the end."""
        self._need(place, _END_BYTES, end, path or "the terminator")
        left = end - place - _END_BYTES
        if left and not path:
            self.warnings.append(f"{left} bytes follow the tree; they were not read")
        elif left or name:
            raise self._corrupt("a container ends too early", place, path, "0 bytes left", left)

    def _item(self, kind: int, place: int, end: int, path: str, depth: int) -> int | None:
        """Read a value and return where it ends; None if its type is not known."""
        if kind in _SCALARS:
            self.items[path], place = self._scalar(_SCALARS[kind], place, end, path)
            return place
        if kind == _TIME:
            self._need(place, _TIME_BYTES, end, path)
            self.items[path] = self._file.data[place : place + _TIME_BYTES].hex()
            return place + _TIME_BYTES
        type_name = ""
        if kind in (*_NAMED, _LIST, _MATRIX):
            type_name, place = self._name(place, end, path)
        elif kind not in (*_CONTAINERS, _TEXT, _QUANTITY, _UNIT):
            return None
        if kind == _MATRIX:
            _, place = self._scalar("<I", place, end, path)
            _, place = self._name(place, end, path)
        start, size = self._size(place, end, path)
        stop = start + size
        if kind in _CONTAINERS:
            self.container(start, stop, path, depth + 1)
        elif kind == _TEXT:
            text = self._file.data[start : min(stop, start + _MAX_TEXT)]
            self.items[path] = text.decode("utf-8", "replace")
        elif kind == _CHOICE and size <= _MAX_CHOICE:
            self.items[path] = int.from_bytes(self._file.data[start:stop], "little")
        elif kind in (_QUANTITY, _UNIT):
            self.items[path] = self._quantity(start, stop, path, has_value=kind == _QUANTITY)
        elif kind == _LIST:
            self.items[path] = self._texts(start, stop, path)
        else:
            self.items[path] = VcaBytes(type_name, start, size)
        return stop

    def _quantity(self, place: int, end: int, path: str, *, has_value: bool) -> Quantity:
        value = 1.0
        if has_value:
            value, place = self._scalar("<d", place, end, path)
        name, place = self._name(place, end, path)
        symbol, place = self._name(place, end, path)
        per_si = None
        if place + 8 <= end:
            per_si, _ = self._scalar("<d", place, end, path)
        return Quantity(value, name, symbol, per_si)

    def _texts(self, place: int, end: int, path: str) -> list[str]:
        texts = []
        while place < end:
            text, place = self._name(place, end, path)
            texts.append(text)
        return texts

    def _scalar(self, code: str, place: int, end: int, path: str) -> tuple[Any, int]:
        size = struct.calcsize(code)
        self._need(place, size, end, path)
        return struct.unpack_from(code, self._file.data, place)[0], place + size

    def _name(self, place: int, end: int, path: str) -> tuple[str, int]:
        size, place = self._scalar("<I", place, end, path)
        self._need(place, size, end, path)
        return self._file.data[place : place + size].decode("utf-8", "replace"), place + size

    def _size(self, place: int, end: int, path: str) -> tuple[int, int]:
        """Return where a value begins and its size, which has a length of its own: 1, 2 or 4."""
        self._need(place, 1, end, path)
        width = self._file.data[place]
        if width not in (1, 2, 4):
            raise self._corrupt("the width of a size is unknown", place, path, "1, 2 or 4", width)
        self._need(place + 1, width, end, path)
        start = place + 1 + width
        size = int.from_bytes(self._file.data[place + 1 : start], "little")
        self._need(start, size, end, path)
        return start, size

    def _need(self, place: int, count: int, end: int, path: str) -> None:
        if place + count > end:
            left = max(end - place, 0)
            reason = "an item is larger than what encloses it"
            raise self._corrupt(reason, place, path, f"at most {left} bytes", f"{count} bytes")

    def _corrupt(
        self, reason: str, place: int, path: str, expected: str, found: object
    ) -> CorruptFileError:
        where = min(place, self._file.size)
        return CorruptFileError(
            self._file.path, reason, field=path[-80:], offset=where, expected=expected, found=found
        )
