"""Values of a MATLAB file as flat names: ``z``, ``capture.Y(2).Name``, ``cells{1}``.

Version 5 is decoded by `metrosep.io.matlab_values`; version 7.3 is HDF5 with a block of text before it,
and stores arrays transposed.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core.errors import CorruptFileError, FormatMismatchError, UnsupportedFeatureError
from metrosep.io.hdf5_file import MAGIC, Hdf5File, open_hdf5
from metrosep.io.matlab_matrix import MATRIX, Structs, misfit, variable
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
