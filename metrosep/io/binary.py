"""Binary headers as data: read the fields of a layout, and refuse sizes before they are allocated.

A layout is a tuple of (offset, `struct` code, name), as in the description of the format. Every
reader of binary maps uses the same checks, so that a damaged header gives the same sentence.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any, TypeAlias

from metrosep.core.errors import CorruptFileError, UnsupportedFeatureError
from metrosep.io.source import MAX_PIXELS, RawFile

__all__ = ["Layout", "check_area", "check_scale", "need_bytes", "unpack_fields"]

Layout: TypeAlias = Sequence[tuple[int, str, str]]
"""Offset in bytes, `struct` code without byte order, and name of each field."""


def unpack_fields(
    file: RawFile, layout: Layout, *, order: str, start: int = 0, what: str = "the header"
) -> dict[str, Any]:
    """Return the fields of a header; text is cut at its first zero byte and stripped."""
    end = max(offset + struct.calcsize(order + code) for offset, code, _ in layout)
    need_bytes(file, start, end, what)
    data = file.head if start + end <= len(file.head) else file.data
    fields: dict[str, Any] = {}
    for offset, code, name in layout:
        values = struct.unpack_from(order + code, data, start + offset)
        value = values[0] if len(values) == 1 else values
        if isinstance(value, bytes):
            value = value.split(b"\0")[0].decode("latin-1").strip()
        fields[name] = value
    return fields


def need_bytes(file: RawFile, offset: int, count: int, what: str, *, name: str = "size") -> None:
    """Refuse a file that ends before something that its header promises."""
    if count < 0 or offset < 0 or offset + count > file.size:
        raise CorruptFileError(
            file.path,
            f"{what} does not fit into the file",
            field=name,
            offset=max(min(offset, file.size), 0),
            expected=f"{count} bytes",
            found=f"{max(file.size - offset, 0)} bytes",
        )


def check_area(
    file: RawFile,
    columns: int,
    rows: int,
    *,
    max_pixels: int | None = None,
    names: tuple[str, str] = ("columns", "rows"),
    offsets: tuple[int | None, int | None] = (None, None),
) -> None:
    """Refuse a map without size, or with more pixels than may be allocated."""
    for value, name, offset in zip((columns, rows), names, offsets, strict=True):
        if value < 1:
            raise CorruptFileError(
                file.path,
                "the map has no size",
                field=name,
                offset=offset,
                expected="at least 1",
                found=value,
            )
    limit = max_pixels or MAX_PIXELS
    if columns * rows > limit:
        raise UnsupportedFeatureError(
            f"{file.path}: claims {columns} x {rows} pixels ({names[0]} x {names[1]}), more than "
            f"{limit}; pass max_pixels= if that is true"
        )


def check_scale(
    file: RawFile,
    name: str,
    value: float,
    *,
    offset: int | None = None,
    low: float = 1e-3,
    high: float = 1e3,
) -> float:
    """Return a scale of the heights, or refuse it."""
    if not low <= value <= high:  # also catches NaN
        raise CorruptFileError(
            file.path,
            "a scale of the heights is not usable",
            field=name,
            offset=offset,
            expected=f"{low:g} to {high:g}",
            found=value,
        )
    return float(value)
