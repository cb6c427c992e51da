"""Values of a MATLAB file as flat names: ``z``, ``capture.Y(2).Name``, ``cells{1}``.

Version 5 is decoded by `metrosep.io.matlab_values`; version 7.3 is HDF5 with a block of text before it,
and stores arrays transposed.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from metrosep.core.errors import CorruptFileError, FormatMismatchError, UnsupportedFeatureError
from metrosep.io.hdf5_file import MAGIC, Hdf5File, open_hdf5
from metrosep.io.source import MAX_PIXELS, RawFile

__all__ = ["V5", "V73", "Values", "load", "version_of"]

V5, V73 = "5.0", "7.3"

_MARKS = {V5: b"MATLAB 5.0 MAT-file", V73: b"MATLAB 7."}
_HDF5_START = 512
_LONGEST_TEXT = 1000


@dataclass
class Values:
    """What the variables of a file hold, by flat name."""

    # to ndarray: arrays that are not empty, in the shape of MATLAB
    numbers: dict[str, NDArray[Any]] = field(default_factory=dict)
    texts: dict[str, str] = field(default_factory=dict)  # to str: texts, one line per row
    # names of what is not read: objects, functions, sparse and complex arrays
    left_out: list[str] = field(default_factory=list)
    # what the metadata of the file are to say
    header: dict[str, Any] = field(default_factory=dict)

    def add(self, name: str, value: Any) -> None:
        """Add a value, and what is inside it."""
        if isinstance(value, Structs):
            alone = len(value.items) == 1
            for i, item in enumerate(value.items, start=1):
                for key, part in item.items():
                    self.add(f"{name}.{key}" if alone else f"{name}({i}).{key}", part)
        elif isinstance(value, list):
            for i, part in enumerate(value, start=1):
                self.add(f"{name}{{{i}}}", part)
        elif isinstance(value, str):
            self.texts[name] = value[:_LONGEST_TEXT]
        elif value is None:
            self.left_out.append(name)
        elif value.size:
            self.numbers[name] = value


def version_of(head: bytes) -> str | None:
    """Return the version of a MATLAB file."""
    if head.startswith(_MARKS[V5]) and head[126:128] in (b"IM", b"MI"):
        return V5
    if head.startswith(_MARKS[V73]) and head.startswith(MAGIC, _HDF5_START):
        return V73
    return None


def load(file: RawFile, max_pixels: int | None = None) -> Values:
    """Return the values of all variables."""
    version = version_of(file.head)
    if version is None:
        raise FormatMismatchError(
            f"{file.path}: is no MATLAB file of version 5 or 7.3: expected 'MATLAB 5.0 MAT-file' at offset "
            f"0 and IM or MI at 126, found {file.head[:20]!r}; in MATLAB save it with -v7"
        )
    text = file.head[: HEADER_BYTES - 12].split(b"\0")[0].decode("latin-1").strip()
    values = Values(header={"text": text, "version": version})
    if version == V5:
        _load_v5(file, values, max_pixels or MAX_PIXELS)
    else:
        with open_hdf5(file) as handle:
            _load_v73(handle, values, max_pixels)
    shapes = {n: " x ".join(map(str, v.shape)) for n, v in values.numbers.items() if v.size > 1}
    single = {n: _plain(v) for n, v in values.numbers.items() if v.size == 1}
    values.header |= {"shapes": shapes, "scalars": single, "texts": dict(values.texts)}
    values.header["left_out"] = list(values.left_out)
    return values


def _plain(value: NDArray[Any]) -> int | float:
    number = value.ravel()[0].item()
    return number if isinstance(number, float) else int(number)


def _load_v5(file: RawFile, values: Values, max_pixels: int) -> None:
    values.header["byte_order"] = "little" if byte_order(file) == "<" else "big"
    for name, value in variables(file, max_bytes=8 * max_pixels):
        if name:  # the one without a name belongs to MATLAB itself
            values.add(name, value)


def _load_v73(handle: Hdf5File, values: Values, max_pixels: int | None) -> None:
    for path in handle.datasets:
        name = path.strip("/").replace("/", ".")
        own = handle.attributes(path)
        kind = str(own.get("MATLAB_class", ""))
        if name.startswith("#") or own.get("MATLAB_empty"):
            continue
        if not handle.is_numeric(path) or 0 in handle.shape(path):
            values.left_out.append(name)
            continue
        array = handle.read(path, max_pixels=max_pixels).T
        if kind == "char":
            values.texts[name] = _letters(array)
        else:
            values.numbers[name] = array


def _letters(array: NDArray[Any]) -> str:
    """Return the text of an array of UTF-16 codes, one line per row."""
    codes = np.atleast_2d(array)[:, :_LONGEST_TEXT].astype("<u2")
    rows = (row.tobytes().decode("utf-16-le", "replace").rstrip() for row in codes)
    return "\n".join(rows)[:_LONGEST_TEXT]


# ---- MATLAB files of version 5 to 7: a header of 128 bytes, then variables, plain or packed by zlib ----

HEADER_BYTES = 128

_PACKED = 15
_MAX_RATIO = 1032
"""Largest ratio that deflate can reach."""


def byte_order(file: RawFile) -> str:
    """Return the byte order of a v5 file for `struct`."""
    mark = file.head[126:128]
    if mark not in (b"IM", b"MI"):
        raise CorruptFileError(
            file.path,
            "the mark of the byte order is damaged",
            field="endian indicator",
            offset=126,
            expected="IM or MI",
            found=repr(mark),
        )
    return "<" if mark == b"IM" else ">"


def variables(file: RawFile, *, max_bytes: int) -> Iterator[tuple[str, Any]]:
    """Return the variables of a v5 file, one after another."""
    order, data = byte_order(file), file.data
    position, budget = HEADER_BYTES, max_bytes
    if position >= len(data):
        raise CorruptFileError(file.path, "holds no variable", offset=HEADER_BYTES)
    while position < len(data):
        if len(data) - position < 8:
            left = f"{len(data) - position} bytes"
            raise misfit(file, "a tag", position, "8 bytes", left)
        kind, size = struct.unpack_from(order + "II", data, position)
        start, end = position + 8, position + 8 + size
        if kind not in (MATRIX, _PACKED) or end > len(data):
            expected = f"a matrix in {len(data) - start} bytes"
            raise misfit(file, "a variable", position, expected, f"type {kind} in {size} bytes")
        if kind == _PACKED:
            element = _inflated(file, data[start:end], order, position, budget)
        else:
            element = data[position:end]
        budget -= len(element)
        if budget < 0:
            raise _too_large(file, max_bytes)
        yield variable(file, element, order, position)
        position = end


def _inflated(file: RawFile, packed: bytes, order: str, where: int, budget: int) -> bytes:
    """Return the element inside a packed one, inflated up to the bytes that its tag claims."""
    inflater = zlib.decompressobj()
    what = "a packed variable"
    try:
        tag = inflater.decompress(packed, 8)
        kind, size = struct.unpack(order + "II", tag)
        if kind != MATRIX or size > _MAX_RATIO * len(packed):
            raise misfit(file, what, where, "a matrix", f"type {kind} in {size} bytes")
        if size + 8 > budget:
            raise _too_large(file, budget)
        body = inflater.decompress(inflater.unconsumed_tail, size) if size else b""
        surplus = inflater.decompress(inflater.unconsumed_tail, 1)
    except (zlib.error, struct.error) as exc:
        raise CorruptFileError(
            file.path, f"{what} cannot be inflated ({exc})", offset=where
        ) from None
    if len(body) != size or surplus or not inflater.eof:
        found = f"{len(body) + len(surplus)} bytes or more"
        raise misfit(file, what, where, f"{size} bytes and the end", found)
    return tag + body


def _too_large(file: RawFile, limit: int) -> UnsupportedFeatureError:
    return UnsupportedFeatureError(
        f"{file.path}: its variables take more than the {limit} bytes allowed; save fewer, or pass "
        "max_pixels= if that is true"
    )


# ---- one variable of a MATLAB v5 file: its elements are checked against what encloses them, and decoded ----
# An element is a tag (type, bytes) and its data, padded to 8 bytes; up to 4 bytes may stand inside
# the tag itself. SciPy is not used: it crashes the process on some damaged files.

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
