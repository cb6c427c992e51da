"""Wyko, Veeco and Bruker Vision ``.opd``: a directory of named blocks, little-endian.

Height in m is ``raw * Wavelength / Mult`` (Wavelength in nm); dx is ``Pixel_size`` (mm), dy is
``Pixel_size * Aspect``: the pixels are often not square. A map is stored column by column, the
smallest y first. Blocks of an unknown type are skipped and named in the metadata. Layout and
sources are in ``data_formats/opd/SPEC.md``.
"""

from __future__ import annotations

import struct
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from metrosep.core.errors import CorruptFileError, FormatMismatchError, UnsupportedFeatureError
from metrosep.core.surface import Surface
from metrosep.io.objects import (
    check_area,
    check_scale,
    lateral_or_none,
    make_surface,
    need_bytes,
    only_channels,
    scaled,
    unpack_fields,
)
from metrosep.io.registry import Match
from metrosep.io.source import RawFile, lateral_steps, refuse_options

__all__ = ["ENTRY", "channels", "read", "sniff"]

FORMAT = "opd"

ENTRY: tuple[tuple[int, str, str], ...] = (
    (0, "16s", "name"),
    (16, "h", "type"),
    (18, "i", "bytes"),
    (22, "H", "attribute"),
)
"""Offset in bytes, `struct` code and name of the fields of an entry of the directory."""

_START = 2
_ENTRY_BYTES = 24
_MAX_ENTRIES = 2**16
_DIRECTORY, _ARRAY, _TEXT = 1, 3, 5
_SCALARS = {(6, 2): "h", (6, 4): "i", (7, 2): "h", (7, 4): "f", (8, 8): "d", (12, 4): "i"}
"""Type and length of a block to the `struct` code of its number; the length decides for type 7."""

_SCALES = ("Wavelength", "Mult", "Aspect", "Pixel_size")
"""Blocks without which heights or steps would be wrong: refused, not skipped, if unknown."""

_ARRAY_HEADER: tuple[tuple[int, str, str], ...] = (
    (0, "H", "columns"),
    (2, "H", "rows"),
    (4, "H", "item_bytes"),
)
_ARRAY_HEADER_BYTES = 6
_HEIGHTS = ("RAW_DATA", "RAW DATA", "OPD", "Raw", "SAMPLE_DATA")
"""Names of arrays with heights; all others (Image, Intensity, SecArr_0) are something else."""

_ITEMS = {2: "<i2", 4: "<f4"}
_FIRST_INVALID = {2: 32766.0, 4: 1e38}
_WAVELENGTHS_NM = (10.0, 1e6)


class _Block(NamedTuple):
    """Entry of the directory, where its content begins, and the content of an array's header."""

    name: str
    type: int
    size: int
    offset: int
    value: Any


def sniff(file: RawFile) -> Match:
    """Return how sure we are that a file is an OPD file."""
    if file.head[2:18].rstrip(b"\0") != b"Directory":
        return Match.NO
    return Match.YES if file.head[18:20] == b"\x01\0" else Match.MAYBE


def channels(file: RawFile) -> tuple[str, ...]:
    """Return the maps of heights in the file."""
    return tuple(_maps(file, _blocks(file)))


def read(
    file: RawFile,
    *,
    channel: str | None = None,
    lateral_step: Any = None,
    unit: Any = None,
    max_pixels: int | None = None,
) -> Surface:
    """Return a height map of an OPD file."""
    refuse_options(file, "an OPD map with its own units", unit=unit)
    override = lateral_steps(lateral_step)
    blocks = _blocks(file)
    maps = _maps(file, blocks)
    name = only_channels(file, "OPD", channel, tuple(maps))
    warnings: list[str] = []
    raw = _raw(file, maps[name], max_pixels, warnings)
    first = _FIRST_INVALID[raw.dtype.itemsize]
    numbers = _numbers(file, blocks)
    scale = _scale(file, numbers, name, raw.dtype)
    own = _steps(file, numbers, warnings)
    left = file.size - max(b.offset + b.size for b in blocks)
    if left:
        warnings.append(f"{left} bytes follow the last block; they were not read")
    z = scaled(raw.T, scale, lambda block: ~(block < first))  # NaN is not smaller either
    return make_surface(
        file,
        FORMAT,
        z,
        own,
        row_order="smallest y first",
        header=_plain(blocks),
        override=override,
        warnings=warnings,
        channel=name,
        wavelength_m=float(numbers["Wavelength"].value) * 1e-9,
        mult=numbers["Mult"].value if "Mult" in numbers else 1,
        aspect=numbers["Aspect"].value if "Aspect" in numbers else None,
        height_per_count_m=scale,
    )


def _blocks(file: RawFile) -> list[_Block]:
    """Return the blocks with content; every one lies in the file."""
    if sniff(file) is Match.NO:
        raise FormatMismatchError(
            f"{file.path}: is not an OPD file: expected 'Directory' at offset 2, found "
            f"{file.head[2:11]!r}; leave out format= to have it recognised"
        )
    directory = unpack_fields(file, ENTRY, order="<", start=_START, what="the directory")
    n_entries, rest = divmod(directory["bytes"], _ENTRY_BYTES)
    if directory["type"] != _DIRECTORY or rest or not 1 < n_entries <= _MAX_ENTRIES:
        raise CorruptFileError(
            file.path,
            "the directory is not usable",
            field="bytes of Directory",
            offset=_START + 18,
            expected=f"a multiple of {_ENTRY_BYTES}, up to {_MAX_ENTRIES} entries",
            found=directory["bytes"],
        )
    need_bytes(file, _START, directory["bytes"], "the directory", name="bytes of Directory")
    place = _START + directory["bytes"]
    blocks = []
    for i in range(1, n_entries):
        entry = unpack_fields(file, ENTRY, order="<", start=_START + i * _ENTRY_BYTES)
        if entry["bytes"] == 0:
            continue
        need_bytes(file, place, entry["bytes"], "a block", name=f"bytes of {entry['name']!r}")
        value = _value(file, entry["type"], place, entry["bytes"])
        blocks.append(_Block(entry["name"], entry["type"], entry["bytes"], place, value))
        place += entry["bytes"]
    if not blocks:
        raise CorruptFileError(file.path, "the directory has no block with content", offset=_START)
    return blocks


def _value(file: RawFile, kind: int, offset: int, size: int) -> Any:
    """Return the number or text of a block, the header of an array, None for what is not known."""
    if (kind, size) in _SCALARS:
        return struct.unpack_from("<" + _SCALARS[kind, size], file.data, offset)[0]
    if kind == _TEXT:
        text = file.data[offset : offset + min(size, 4096)]
        return text.split(b"\0")[0].decode("latin-1").strip()
    if kind == _ARRAY and size >= _ARRAY_HEADER_BYTES:
        return unpack_fields(file, _ARRAY_HEADER, order="<", start=offset, what="an array")
    return None


def _maps(file: RawFile, blocks: list[_Block]) -> dict[str, _Block]:
    """Return the maps of heights by name; a name that comes again gets a number."""
    maps: dict[str, _Block] = {}
    for block in blocks:
        if block.name in _HEIGHTS and block.type == _ARRAY:
            n = sum(key.partition("#")[0] == block.name for key in maps)
            maps[f"{block.name}#{n + 1}" if n else block.name] = block
    if not maps:
        found = ", ".join(repr(b.name) for b in blocks if b.type == _ARRAY) or "no array"
        raise UnsupportedFeatureError(
            f"{file.path}: the OPD file holds no map of heights (a block named "
            f"{', '.join(_HEIGHTS)}), but {found}; save the measurement with its heights"
        )
    return maps


def _raw(
    file: RawFile, block: _Block, max_pixels: int | None, warnings: list[str]
) -> NDArray[Any]:
    """Return the stored values, x as the first index; sizes are checked before."""
    if block.value is None:
        raise CorruptFileError(
            file.path,
            "a map has no header",
            field=f"bytes of {block.name!r}",
            offset=block.offset,
            expected=f"at least {_ARRAY_HEADER_BYTES}",
            found=block.size,
        )
    columns, rows, item = (block.value[n] for n in ("columns", "rows", "item_bytes"))
    if item == 1:
        raise UnsupportedFeatureError(
            f"{file.path}: {block.name} has heights of 8 bits, for which no rule for not-measured "
            "points is known; save the measurement again with 16 bits or as floats"
        )
    offsets = (block.offset, block.offset + 2)
    check_area(file, columns, rows, max_pixels=max_pixels, offsets=offsets)
    size = _ARRAY_HEADER_BYTES + columns * rows * item
    if item not in _ITEMS or size > block.size:
        raise CorruptFileError(
            file.path,
            "the map does not fit into its block",
            field=f"columns, rows, item_bytes of {block.name!r}",
            offset=block.offset,
            expected=f"up to {block.size} bytes, 2 or 4 for a point",
            found=f"{columns} x {rows} x {item} bytes and {_ARRAY_HEADER_BYTES}",
        )
    if size < block.size:
        warnings.append(f"{block.size - size} bytes follow the map in its block; not read")
    start = block.offset + _ARRAY_HEADER_BYTES
    raw = np.frombuffer(file.data, dtype=_ITEMS[item], count=columns * rows, offset=start)
    return raw.reshape(columns, rows)


def _numbers(file: RawFile, blocks: list[_Block]) -> dict[str, _Block]:
    """Return the blocks with scales by name, the first of each; every one holds a number."""
    numbers: dict[str, _Block] = {}
    for block in blocks:
        if block.name not in _SCALES:
            continue
        if not isinstance(block.value, (int, float)):
            raise CorruptFileError(
                file.path,
                "a scale is not stored as a number",
                field=block.name,
                offset=block.offset,
                expected="a block of type 6, 7, 8 or 12 of its length",
                found=f"type {block.type} with {block.size} bytes",
            )
        numbers.setdefault(block.name, block)
    return numbers


def _scale(file: RawFile, numbers: dict[str, _Block], channel: str, dtype: np.dtype[Any]) -> float:
    """Return the height of one raw unit in m: Wavelength / Mult."""
    needed = ("Wavelength", "Mult") if dtype.kind == "i" else ("Wavelength",)
    for name in needed:
        if name not in numbers:
            raise CorruptFileError(
                file.path,
                f"the scale of the heights of {channel} is missing",
                field=name,
                expected="a block of that name with a number",
            )
    low, high = _WAVELENGTHS_NM
    block = numbers["Wavelength"]
    wavelength = check_scale(
        file, "Wavelength", block.value, offset=block.offset, low=low, high=high
    )
    if "Mult" not in numbers:
        return wavelength * 1e-9
    mult = numbers["Mult"]
    divisor = check_scale(file, "Mult", mult.value, offset=mult.offset, low=1.0, high=1e9)
    return wavelength * 1e-9 / divisor


def _steps(
    file: RawFile, numbers: dict[str, _Block], warnings: list[str]
) -> tuple[float | None, float | None]:
    """Return dx and dy in m, None where Pixel_size is missing or zero."""
    if "Pixel_size" not in numbers:
        warnings.append("Pixel_size is missing: taken as not calibrated")
        return None, None
    pixel = numbers["Pixel_size"]
    dx = lateral_or_none(
        file, "Pixel_size", pixel.value, warnings, offset=pixel.offset, factor=1e-3
    )
    if dx is None:
        return None, None
    if "Aspect" not in numbers:
        warnings.append("Aspect is missing: pixels taken as square")
        return dx, dx
    aspect = numbers["Aspect"]
    ratio = check_scale(file, "Aspect", aspect.value, offset=aspect.offset, low=0.01, high=100.0)
    return dx, dx * ratio


def _plain(blocks: list[_Block]) -> dict[str, Any]:
    """Return the blocks as plain values; of those that are not known, their type and size."""
    header: dict[str, Any] = {}
    for block in blocks:
        skipped = {"type": block.type, "bytes": block.size, "skipped": True}
        name, n = block.name, 1
        while name in header:
            n += 1
            name = f"{block.name}#{n}"
        header[name] = skipped if block.value is None else block.value
    return header
