"""The typed tree inside a Gwyddion ``.gwy`` file, read as if a stranger had sent it.

An object is a name, a size and components; a component is a name, a type letter and a value, little-
endian: ``b c i q d s o`` for bool, byte, int32, int64, double, text and object, capitals for arrays of
them. Every step moves forward inside the object that encloses it, objects nest only so deep, and an
array is a place in the file, not a copy: nothing is allocated that the file does not hold.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

from metrosep.core.errors import CorruptFileError
from metrosep.io.source import RawFile

__all__ = ["GwyArray", "GwyObject", "plain", "read_object"]

_SCALARS = {"b": "?", "c": "b", "i": "i", "q": "q", "d": "d"}
_ITEM_BYTES = {"C": 1, "I": 4, "Q": 8, "D": 8}
_MAX_DEPTH = 32
_MAX_COMPONENTS = 100_000


@dataclass(frozen=True)
class GwyArray:
    """Where an array of numbers lies in the file."""

    code: str  # ``"C"``, ``"I"``, ``"Q"`` or ``"D"``
    offset: int  # first byte
    count: int  # number of items


@dataclass(frozen=True)
class GwyObject:
    """An object of the tree."""

    type: str  # such as ``"GwyDataField"``
    # components by name: plain values, `GwyArray`, `GwyObject` or tuples of them
    items: dict[str, Any]
    offset: int  # where the object begins


def read_object(file: RawFile, offset: int) -> tuple[GwyObject, int]:
    """Return the object that begins at an offset, and where it ends."""
    return _Tree(file).object(offset, file.size, 0)


def plain(value: Any) -> Any:
    """Return a value of the tree as plain values; arrays become their type and length."""
    if isinstance(value, GwyObject):
        return {"type": value.type, **{k: plain(v) for k, v in value.items.items()}}
    if isinstance(value, GwyArray):
        return f"{value.count} items of type {value.code}"
    if isinstance(value, tuple):
        return [plain(v) for v in value]
    return value


class _Tree:
    def __init__(self, file: RawFile) -> None:
        self._file = file
        self._n = 0

    def object(self, offset: int, end: int, depth: int) -> tuple[GwyObject, int]:
        if depth > _MAX_DEPTH:
            raise self._corrupt("objects are nested too deep", offset, f"at most {_MAX_DEPTH}")
        name, place = self._text(offset, end, "the name of an object")
        size = self._count(place, end, f"size of {name}")
        place += 4
        stop = place + size
        if stop > end:
            raise self._corrupt(
                "an object is larger than what encloses it",
                place - 4,
                f"at most {end - place} bytes",
                f"{size} bytes",
                f"size of {name}",
            )
        items: dict[str, Any] = {}
        while place < stop:
            self._tally(place)
            key, place = self._text(place, stop, "the name of a component")
            items[key], place = self._value(key, place, stop, depth)
        return GwyObject(name, items, offset), stop

    def _value(self, key: str, offset: int, end: int, depth: int) -> tuple[Any, int]:
        """Return a value and where it ends; at least one byte is consumed."""
        code = self._file.data[offset : offset + 1].decode("latin-1") if offset < end else ""
        place = offset + 1
        if code in _SCALARS:
            form = "<" + _SCALARS[code]
            self._need(place, struct.calcsize(form), end, key)
            return struct.unpack_from(form, self._file.data, place)[0], place + struct.calcsize(
                form
            )
        if code == "s":
            return self._text(place, end, key)
        if code == "o":
            return self.object(place, end, depth + 1)
        if code not in {*_ITEM_BYTES, "S", "O"}:
            raise self._corrupt("a component has an unknown type", offset, None, repr(code), key)
        count = self._count(place, end, key)
        place += 4
        if code in _ITEM_BYTES:
            self._need(place, count * _ITEM_BYTES[code], end, key)
            return GwyArray(code, place, count), place + count * _ITEM_BYTES[code]
        values = []
        for _ in range(count):  # each item takes a byte or more, so a false count soon ends
            self._tally(place)
            value, place = (
                self._text(place, end, key) if code == "S" else self.object(place, end, depth + 1)
            )
            values.append(value)
        return tuple(values), place

    def _tally(self, offset: int) -> None:
        self._n += 1
        if self._n > _MAX_COMPONENTS:
            raise self._corrupt("has too many components", offset, f"up to {_MAX_COMPONENTS}")

    def _text(self, offset: int, end: int, what: str) -> tuple[str, int]:
        stop = self._file.data.find(b"\0", offset, end)
        if stop < 0:
            raise self._corrupt("a text has no end", offset, "a zero byte", None, what)
        return self._file.data[offset:stop].decode("utf-8", "replace"), stop + 1

    def _count(self, offset: int, end: int, what: str) -> int:
        self._need(offset, 4, end, what)
        return int(struct.unpack_from("<I", self._file.data, offset)[0])

    def _need(self, offset: int, count: int, end: int, what: str) -> None:
        if offset + count > end:
            raise self._corrupt(
                "a value is larger than what encloses it",
                offset,
                f"at most {max(end - offset, 0)} bytes",
                f"{count} bytes",
                what,
            )

    def _corrupt(
        self,
        reason: str,
        offset: int,
        expected: str | None = None,
        found: str | None = None,
        what: str | None = None,
    ) -> CorruptFileError:
        return CorruptFileError(
            self._file.path,
            reason,
            offset=offset,
            field=what and what[:60],
            expected=expected,
            found=found,
        )
