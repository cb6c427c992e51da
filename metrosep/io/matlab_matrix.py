"""One variable of a MATLAB v5 file: its elements are checked against what encloses them, and decoded.

An element is a tag (type, bytes) and its data, padded to 8 bytes; up to 4 bytes may stand inside
the tag itself. SciPy is not used: it crashes the process on some damaged files.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from metrosep.core.errors import CorruptFileError, UnsupportedFeatureError
from metrosep.io.source import RawFile

__all__ = ["MATRIX", "Structs", "misfit", "variable"]

MATRIX = 14
"""Type of the element that holds a variable."""

_INT8, _UINT16, _INT32, _UINT32, _UTF8, _UTF16, _UTF32 = 1, 4, 5, 6, 16, 17, 18
_DTYPES = {
    _INT8: "i1",
    2: "u1",
    3: "i2",
    _UINT16: "u2",
    _INT32: "i4",
    _UINT32: "u4",
    7: "f4",
    9: "f8",
    12: "i8",
    13: "u8",
    _UTF8: "u1",
    _UTF16: "u2",
    _UTF32: "u4",
}
_CELL, _STRUCT, _OBJECT, _CHAR, _SPARSE, _FUNCTION, _OPAQUE = 1, 2, 3, 4, 5, 16, 17
_NUMERIC = range(6, 16)
_NOT_READ = (_OBJECT, _SPARSE, _FUNCTION)
_COMPLEX = 0x0800

_MAX_DEPTH = 16
_MAX_ELEMENTS = 200_000
_MAX_NAME = 255
_MAX_DIMENSIONS = 32


class Structs(NamedTuple):
    """An array of structs."""

    items: list[dict[str, Any]]  # of dict: field to value, for each struct


class _Element(NamedTuple):
    """Type of an element, where its data begin and end, and where the next one begins."""

    type: int
    start: int
    end: int
    next: int


def variable(file: RawFile, data: bytes, order: str, where: int) -> tuple[str, Any]:
    """Return the name and the value of a variable."""
    decoder = _Decoder(file, data, order, where)
    return decoder.matrix(decoder.tag(0, len(data)), 0)


def misfit(
    file: RawFile, what: str, offset: int, expected: object, found: object
) -> CorruptFileError:
    """Return the error for something whose size or type does not fit."""
    return CorruptFileError(
        file.path, f"{what} does not fit", offset=offset, expected=expected, found=found
    )


@dataclass
class _Decoder:
    """Bytes of one variable, and how many of its elements were seen."""

    file: RawFile
    data: bytes
    order: str
    where: int
    n_elements: int = 0

    def tag(self, position: int, end: int) -> _Element:
        """Return the element at a position; it must end before `end`."""
        self.n_elements += 1
        if self.n_elements > _MAX_ELEMENTS:
            raise UnsupportedFeatureError(
                f"{self.file.path}: a variable has more than {_MAX_ELEMENTS} elements; save the "
                "numbers as plain arrays"
            )
        if end - position < 8:
            raise self.misfit("a tag", position, "8 bytes", f"{max(end - position, 0)} bytes")
        first, size = struct.unpack_from(self.order + "II", self.data, position)
        if first >> 16:
            size, start, after = first >> 16, position + 4, position + 8
            kind = first & 0xFFFF
            if size > 4:
                raise self.misfit("a small element", position, "1 to 4 bytes", f"{size} bytes")
        else:
            kind, start = first, position + 8
            after = start + size if kind == MATRIX else start + size + -size % 8
        if start + size > end or (kind != MATRIX and kind not in _DTYPES):
            found = f"type {kind} in {size} bytes"
            raise self.misfit("an element", position, f"data in {end - start} bytes", found)
        if kind != MATRIX and size % np.dtype(_DTYPES[kind]).itemsize:
            raise self.misfit("an element", position, "whole values", f"{size} bytes")
        return _Element(kind, start, start + size, min(after, end))

    def matrix(self, element: _Element, depth: int) -> tuple[str, Any]:
        """Return the name and the value of a matrix, and check all inside it."""
        if element.type != MATRIX or depth > _MAX_DEPTH:
            found = f"type {element.type} at depth {depth}"
            raise self.misfit("a variable", element.start, "a matrix", found)
        if element.start == element.end:  # how an empty cell or field is written
            return "", np.empty(0)
        flags = self.part(element.start, element.end, (_UINT32,), 2)
        word = int(self.array(flags)[0])
        kind = word & 0xFF
        if kind == _OPAQUE:  # an object of a class: its name stands where others have dimensions
            return self.text(self.part(flags.next, element.end, (_INT8, _UTF8))), None
        if kind not in (_CELL, _STRUCT, _CHAR, *_NUMERIC, *_NOT_READ):
            raise self.misfit("a variable", flags.start, "a known class", f"class {kind}")
        sizes = self.part(flags.next, element.end, (_INT32, _UINT32))
        shape = tuple(self.array(sizes).tolist())
        if not 2 <= len(shape) <= _MAX_DIMENSIONS or min(shape) < 0:
            raise self.misfit("the dimensions", sizes.start, "2 or more", shape[:4])
        name = self.part(sizes.next, element.end, (_INT8, _UTF8))
        if name.end - name.start > _MAX_NAME:
            size = f"{name.end - name.start} bytes"
            raise self.misfit("a name", name.start, f"up to {_MAX_NAME} bytes", size)
        is_complex = bool(word & _COMPLEX)
        return self.text(name), self.content(
            kind, shape, name.next, element.end, depth, is_complex
        )

    def content(
        self,
        kind: int,
        shape: tuple[int, ...],
        position: int,
        end: int,
        depth: int,
        is_complex: bool,
    ) -> Any:
        """Return what follows the name of a matrix."""
        value: Any = None
        if kind in _NOT_READ:
            return None
        if kind in _NUMERIC:
            value, position = self.numbers(shape, position, end)
            if is_complex:
                _, position = self.numbers(shape, position, end)
                value = None
        elif kind == _CHAR:
            value, position = self.letters(shape, position, end)
        else:
            fields = None
            if kind == _STRUCT:
                fields, position = self.fields(position, end)
            value, position = self.items(fields, _product(shape), position, end, depth)
        if end - position >= 8:
            raise self.misfit("a variable", position, "its end", f"{end - position} more bytes")
        return value

    def numbers(self, shape: tuple[int, ...], position: int, end: int) -> tuple[NDArray[Any], int]:
        """Return the real or imaginary part of an array, and where the next part begins."""
        part = self.tag(position, end)
        if part.type == MATRIX:
            raise self.misfit("an array", part.start, "numbers", f"type {part.type}")
        values = self.array(part)
        if values.size != _product(shape):
            found = f"{values.size} values of type {part.type}"
            raise self.misfit("an array", part.start, f"{_product(shape)} values", found)
        return values.reshape(shape, order="F"), part.next

    def letters(self, shape: tuple[int, ...], position: int, end: int) -> tuple[str, int]:
        """Return a text, one line per row; it may be shorter than its dimensions, or absent."""
        if position == end:
            return "", position
        part = self.tag(position, end)
        if part.type == MATRIX:
            raise self.misfit("a text", part.start, "letters", f"type {part.type}")
        raw = self.data[part.start : part.end]
        suffix = "le" if self.order == "<" else "be"
        if part.type in (_UINT16, _UTF16):
            text = raw.decode(f"utf-16-{suffix}", "replace")
        elif part.type == _UTF32:
            text = raw.decode(f"utf-32-{suffix}", "replace")
        else:
            text = raw.decode("utf-8", "replace")
        if len(text) > _product(shape):
            found = f"{len(text)} letters"
            raise self.misfit("a text", part.start, f"{_product(shape)} letters", found)
        n_rows = min(shape[0], len(text))
        return "\n".join(text[row::n_rows].rstrip() for row in range(n_rows)), part.next

    def fields(self, position: int, end: int) -> tuple[list[str], int]:
        """Return the names of the fields of a struct, and where their values begin."""
        length = self.part(position, end, (_INT32, _UINT32), 1)
        width = int(self.array(length)[0])
        names = self.part(length.next, end, (_INT8,))
        size = names.end - names.start
        if width < 1 or size % width:
            expected = f"{width} bytes each"
            raise self.misfit("names of fields", names.start, expected, f"{size} bytes")
        raw = (self.data[i : i + width] for i in range(names.start, names.end, width))
        return [name.split(b"\0")[0].decode("utf-8", "replace") for name in raw], names.next

    def items(
        self, fields: list[str] | None, count: int, position: int, end: int, depth: int
    ) -> tuple[list[Any] | Structs, int]:
        """Return the cells, or the structs with these fields, and where they end."""
        per_item = 1 if fields is None else len(fields)
        left = (end - position) // 8
        if count * per_item > left or count > _MAX_ELEMENTS:
            raise self.misfit("a list", position, f"{left} elements", f"{count} x {per_item}")
        values: list[Any] = []
        for _ in range(count * per_item):
            part = self.tag(position, end)
            values.append(self.matrix(part, depth + 1)[1])
            position = part.next
        if fields is None:
            return values, position
        rows = (values[i * per_item : (i + 1) * per_item] for i in range(count))
        return Structs([dict(zip(fields, row, strict=True)) for row in rows]), position

    def part(
        self, position: int, end: int, types: tuple[int, ...], count: int | None = None
    ) -> _Element:
        """Return the element at a position, which must be of a type and hold so many values."""
        element = self.tag(position, end)
        size = element.end - element.start
        if element.type not in types or count not in (None, self.array(element).size):
            expected = f"type {types[0]}" + (f" with {count} values" if count else "")
            found = f"type {element.type} in {size} bytes"
            raise self.misfit("an element", element.start, expected, found)
        return element

    def array(self, element: _Element) -> NDArray[Any]:
        """Return the numbers of an element, without a copy."""
        dtype = np.dtype(_DTYPES[element.type]).newbyteorder("<" if self.order == "<" else ">")
        count = (element.end - element.start) // dtype.itemsize
        return np.frombuffer(self.data, dtype=dtype, count=count, offset=element.start)

    def text(self, element: _Element) -> str:
        """Return the text of a name."""
        return self.data[element.start : element.end].split(b"\0")[0].decode("utf-8", "replace")

    def misfit(self, what: str, offset: int, expected: object, found: object) -> CorruptFileError:
        """Return the error; the offset is that of the variable in the file."""
        inside = f"{what} (byte {offset} of the variable)"
        return misfit(self.file, inside, self.where, expected, found)


def _product(shape: tuple[int, ...]) -> int:
    count = 1
    for n in shape:
        count *= n
    return count
