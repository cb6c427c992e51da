"""MATLAB files of version 5 to 7: a header of 128 bytes, then variables, plain or packed by zlib."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from typing import Any

from metrosep.core.errors import CorruptFileError, UnsupportedFeatureError
from metrosep.io.matlab_matrix import MATRIX, misfit, variable
from metrosep.io.source import RawFile

__all__ = ["HEADER_BYTES", "byte_order", "variables"]

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
