"""Maps in trees of tagged blocks: FRT MicroProf ``.frt`` and Digital Surf Mountains ``.mnt``.

A block has a tag, a size and data, which may be blocks again. Layouts and sources are in
``data_formats/*/SPEC.md``.
"""

from __future__ import annotations

import math
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import ReadError, UnitError, UnsupportedFeatureError
from metrosep.core.surface import Surface
from metrosep.core.text_options import ROW_ORDERS
from metrosep.core.units import parse_unit
from metrosep.io.declared import Cursor, Match
from metrosep.io.objects import (
    Request,
    check_area,
    check_scale,
    height_only,
    lateral_or_none,
    map_reader,
    scaled,
)
from metrosep.io.registry import BuiltIn, demand, mismatch, sniffer
from metrosep.io.source import RawFile

_MAX_BLOCKS = 100_000
_MAX_RATIO = 1040
"""A deflate stream grows by 1032 at most."""

# ---- FRT: one list of blocks; heights in metres per count, 1 is not measured ------------------------

_FRT = "frt"
_GRID, _SIZE, _SCALE, _HEIGHTS, _IMAGES = 0x66, 0x67, 0x6C, 0x0B, 0x7D
_HEIGHT_IMAGES = 0x0004 | 0x0080 | 0x0800 | 0x1000
_FRT_TYPES = {16: "<u2", 32: "<i4"}
_NOT_MEASURED = 1


def _frt_blocks(file: RawFile) -> dict[int, Cursor]:
    """Return the blocks by tag, the first of each."""
    demand(file, _FRT)
    cursor = Cursor(file, file.data, 12)
    version = cursor.take(4, "version")
    if version not in (b"1.00", b"1.01"):
        raise UnsupportedFeatureError(
            f"{file.path}: is of version {version!r}; versions 1.00 and 1.01 are read"
        )
    found: dict[int, Cursor] = {}
    for _ in range(cursor.number("H", "number of blocks")):
        tag = cursor.number("H", "tag")
        size = cursor.number("I" if version == b"1.00" else "Q", f"size of block {tag:#x}")
        found.setdefault(tag, cursor.inside(size, f"block {tag:#x}"))
    for tag, what in ((_GRID, "size of the map"), (_SIZE, "lengths"), (_SCALE, "scale")):
        if tag not in found:
            raise file.corrupt(f"has no block {tag:#x} with the {what}", field=f"block {tag:#x}")
    return found


@map_reader(_FRT, "FRT", "an FRT file with its own units")
def _frt_read(asked: Request) -> Surface:
    """Return the topography of an FRT file."""
    file = asked.file
    blocks = _frt_blocks(file)
    grid = blocks[_GRID].numbers("3I", "columns, rows, bits")
    if _HEIGHTS in blocks:
        body = blocks[_HEIGHTS]
    elif _IMAGES in blocks:
        body, grid = _frt_image(blocks[_IMAGES])
    else:
        raise UnsupportedFeatureError(f"{file.path}: the FRT file holds no topography")
    columns, rows, bits = grid
    check_area(file, columns, rows, max_pixels=asked.max_pixels)
    if bits not in _FRT_TYPES:
        raise body.wrong("the size of a count is not usable", "bits", "16 or 32", bits)
    data = body.take(columns * rows * bits // 8, "heights")
    raw = np.frombuffer(data, _FRT_TYPES[bits]).reshape(rows, columns)
    scale = blocks[_SCALE].numbers("Id", "scale")[1]
    check_scale(file, "height per count", scale, low=1e-18, high=1.0)
    lengths = blocks[_SIZE].numbers("2d", "lengths")
    steps = [
        lateral_or_none(file, f"length in {axis}", length / n, asked.warnings)
        for axis, length, n in zip("xy", lengths, (columns, rows), strict=True)
    ]
    return asked.surface(
        scaled(raw, scale, lambda block: block == _NOT_MEASURED),
        (steps[0], steps[1]),
        row_order=ROW_ORDERS[0],
        header={"columns": columns, "rows": rows, "bits": bits, "lengths_m": lengths,
                "blocks": tuple(f"{tag:#x}" for tag in blocks)},
        height_per_count_m=scale,
    )  # fmt: skip


def _frt_image(body: Cursor) -> tuple[Cursor, tuple[int, int, int]]:
    """Return the first image of heights of a block of several, and its size."""
    body.numbers("4H", "buffers")
    while body.left:
        kind, columns, rows, bits = body.numbers("4I", "header of an image")
        inside = body.inside(columns * rows * bits // 8, "an image")
        if kind & _HEIGHT_IMAGES:
            return inside, (columns, rows, bits)
    raise UnsupportedFeatureError(f"{body.file.path}: the FRT file holds no image of heights")


frt = BuiltIn(sniffer(_FRT), height_only, _frt_read)


# ---- OLE compound files: streams whose sectors a table of allocation links ---------------------------

_OLE = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"
_NO_SECTOR = 0xFFFFFFFA
"""Numbers from here on are marks, not sectors."""


class _Compound:
    """The streams of an OLE file; chains of sectors are followed no longer than the file is."""

    def __init__(self, file: RawFile) -> None:
        self.file = file
        head = Cursor(file, file.data, 24)
        _, _, _, big, small = head.numbers("5H", "version and sizes of sectors")
        if big not in (9, 12) or not 0 < small < big:
            raise head.wrong("the size of a sector is not usable", "sector shift", "9 or 12", big)
        self._big, self._small = 1 << big, 1 << small
        head.place = 44
        count, first_dir, _, self._cutoff, first_mini, _, first_more, _ = head.numbers(
            "8I", "places of the tables"
        )
        tables = [s for s in head.numbers("109I", "table of sectors") if s < _NO_SECTOR]
        while first_more < _NO_SECTOR and len(tables) <= file.size // self._big:
            more = self._sector(first_more, "I")
            tables += [s for s in more[:-1] if s < _NO_SECTOR]
            first_more = more[-1]
        self._next = [n for t in tables[:count] for n in self._sector(t, "I")]
        self._entries = self._directory(self._chain(first_dir))
        root = self._entries.get("Root Entry", (_NO_SECTOR, 0))
        self._mini = self._chain(root[0])
        links = self._chain(first_mini)
        self._mini_next = np.frombuffer(links[: len(links) // 4 * 4], "<u4").tolist()

    def _sector(self, number: int, code: str) -> tuple[Any, ...]:
        at = (number + 1) * self._big
        return Cursor(self.file, self.file.data, at).numbers(f"{self._big // 4}{code}", "a sector")

    def _chain(self, sector: int, size: int | None = None, *, mini: bool = False) -> bytes:
        """Return the sectors from one on, of the file or of the stream of small ones."""
        links = self._mini_next if mini else self._next
        data, width = (self._mini, self._small) if mini else (self.file.data, self._big)
        parts: list[bytes] = []
        most = len(links) if size is None else -(-size // width)
        while sector < _NO_SECTOR and len(parts) < most:
            if sector >= len(links):
                raise self.file.corrupt("a chain of sectors leaves the file", found=sector)
            at = (sector + (not mini)) * width
            parts.append(data[at : at + width])
            sector = links[sector]
        return b"".join(parts)

    def _directory(self, table: bytes) -> dict[str, tuple[int, int]]:
        found = {}
        for at in range(0, len(table) - 127, 128):
            entry = Cursor(self.file, table, at)
            name, length, kind = entry.numbers("64sHB", "an entry")
            entry.place = at + 116
            start, size = entry.numbers("II", "an entry")
            if kind in (2, 5) and 2 <= length <= 64:
                found[name[: length - 2].decode("utf-16-le", "replace")] = (start, size)
        return found

    def stream(self, name: str) -> bytes | None:
        """Return the content of a stream, ``None`` where there is none of that name."""
        if name not in self._entries:
            return None
        start, size = self._entries[name]
        if size > self.file.size:
            raise self.file.corrupt("a stream is larger than the file", field=name, found=size)
        data = self._chain(start, size, mini=size < self._cutoff)[:size]
        if len(data) != size:
            raise self.file.corrupt(
                "a stream ends early", field=name, expected=size, found=len(data)
            )
        return data


# ---- Mountains: the document is a tree; a measured surface is an object of class 9012 ----------------

_MNT = "mnt"
_STREAM = "ScopedContents"
_INNER = 0xFFFF
_CLASS_SURFACE, _CLASS_DATA, _CLASS_HEIGHTS, _CLASS_MASK = 9012, 9062, 9049, 9056
_TO_OBJECTS = (1, 0x02BD, 2, 1)
_MEASURED = 9
_TEXT = b"\x04"
_COUNT_TYPES = {2: "<i2", 4: "<i4"}


def _entry(cursor: Cursor | None, *path: int) -> Cursor | None:
    """Return the data of the block that a path of tags leads to, ``None`` where one is missing."""
    for wanted in path:
        if cursor is None:
            return None
        inside = cursor.again()
        cursor = None
        while inside.left >= 10:
            tag, size = inside.numbers("HQ", "tag and size")
            body = inside.inside(size, f"block {tag:#06x}")
            if tag == wanted:
                cursor = body
                break
    return cursor


def _number(cursor: Cursor | None, code: str, name: str, *path: int) -> Any:
    found = _entry(cursor, *path)
    return None if found is None else found.again().number(code, name)


def _mnt_text(cursor: Cursor | None, *path: int) -> str:
    """Return a text: a mark, then UTF-16."""
    found = _entry(cursor, *path)
    raw = b"" if found is None else found.again().take(found.left, "a text")
    return raw[1:].decode("utf-16-le", "replace").rstrip("\0") if raw[:1] == _TEXT else ""


def _mnt_surfaces(file: RawFile) -> dict[str, Cursor]:
    """Return the measured surfaces of the document by name."""
    demand(file, _MNT)
    content = _Compound(file).stream(_STREAM)
    if content is None:
        raise mismatch(file, _MNT, f"an OLE file without a stream {_STREAM}")
    objects = _entry(Cursor(file, content, 8), *_TO_OBJECTS)
    found: dict[str, Cursor] = {}
    while objects is not None and objects.left > 18 and len(found) < _MAX_BLOCKS:
        objects.number("Q", "size of an object")
        _, size = objects.numbers("HQ", "tag and size")
        item = objects.inside(size, "an object")
        if _number(item, "I", "class", 1, 1) != _CLASS_SURFACE:
            continue
        inner = _entry(item, 2, 1)
        if _number(inner, "I", "class", 1, 1) != _CLASS_DATA:
            continue
        measured = _entry(inner, 2, _INNER)
        if measured is not None and _metres(_mnt_text(measured, 2, _INNER, 2)) is not None:
            name = _mnt_text(measured, _INNER, _INNER, _INNER, 1) or f"surface {len(found) + 1}"
            while name in found:
                name += "'"
            found[name] = measured
    if not found:
        raise UnsupportedFeatureError(
            f"{file.path}: the document holds no measured surface; export the map as SUR or X3P"
        )
    return found


def _metres(unit: str) -> float | None:
    try:
        return parse_unit(unit, dimension="length").factor
    except UnitError:
        return None


def _mnt_channels(file: RawFile) -> tuple[str, ...]:
    """Return the measured surfaces."""
    return tuple(_mnt_surfaces(file))


@map_reader(_MNT, "Mountains", "a Mountains document with its own units", several=True)
def _mnt_read(asked: Request) -> Surface:
    """Return a measured surface of a Mountains document."""
    file = asked.file
    surfaces = _mnt_surfaces(file)
    name = asked.choose(surfaces)
    measured = surfaces[name]
    grid = _entry(measured, _INNER)
    sizes, steps = [], []
    for axis, tag in (("x", 1), ("y", 2)):
        inner = _entry(grid, tag, _INNER)
        sizes.append(_number(inner, "I", "points", 1) or 0)
        step = _number(inner, "d", "step", _INNER, 1) or 0.0
        factor = _metres(_mnt_text(inner, _INNER, 2)) or 0.0
        steps.append(lateral_or_none(file, f"step in {axis}", step * factor, asked.warnings))
    columns, rows = sizes
    check_area(file, columns, rows, max_pixels=asked.max_pixels)
    scale = _entry(measured, 2, _INNER)
    unit = _metres(_mnt_text(scale, 2)) or 0.0
    step = check_scale(
        file,
        "height per count",
        (_number(scale, "d", "step", 1) or 0.0) * unit,
        low=1e-18,
        high=1.0,
    )
    shown = _metres(_mnt_text(scale, 3)) or unit
    origin = (_number(scale, "d", "origin", 5) or 0.0) * shown
    if not math.isfinite(origin) or abs(origin) > 1e3:
        raise file.corrupt("the origin of the heights is not usable", field="origin", found=origin)
    heights = _entry(measured, 1)
    if _number(heights, "I", "class", 1, 1) != _CLASS_HEIGHTS:
        raise file.corrupt("the heights are not an array of counts", field="class")
    raw = _array(file, _entry(heights, 2), columns * rows).reshape(rows, columns)
    z: FloatArray = scaled(raw, step, offset=origin)
    mask = _entry(grid, 3)
    if _number(mask, "I", "class", 1, 1) == _CLASS_MASK:
        framed = _array(file, _entry(mask, 2, 5, 2), (columns + 2) * (rows + 2), marks=True)
        z[framed.reshape(rows + 2, columns + 2)[1:-1, 1:-1] != _MEASURED] = np.nan
    header = {
        "name": name,
        "points": (columns, rows),
        "z_unit": _mnt_text(scale, 2),
        "z_origin_m": origin,
    }
    return asked.surface(
        z,
        (steps[0], steps[1]),
        row_order=ROW_ORDERS[1],
        header=header,
        channel=name,
        height_per_count_m=step,
    )


def _array(
    file: RawFile, cursor: Cursor | None, count: int, *, marks: bool = False
) -> NDArray[Any]:
    """Return the numbers of an array: deflated pieces, each at its own place."""
    body = _entry(cursor, 2)
    if body is None or _number(cursor, "I", "elements", 1) != count:
        raise file.corrupt(
            "an array has another length than the map", expected=f"{count} elements"
        )
    size = body.number("Q", "bytes of an array")
    width, rest = divmod(size, count)
    if size > _MAX_RATIO * body.left:
        raise body.wrong("the pieces cannot fill the array", "bytes of an array", "less", size)
    if rest or width not in ((1,) if marks else _COUNT_TYPES):
        raise body.wrong("an element has a size of its own", "bytes of an array", 4 * count, size)
    whole, filled = bytearray(size), 0
    while body.left:
        first, n, packed = body.numbers("QII", "a piece of an array")
        data = body.take(packed, "a deflated piece")
        start, length = first * width, n * width
        if start + length > size:
            raise body.wrong("a piece leaves its array", "offset", f"up to {size}", start + length)
        try:
            part = zlib.decompressobj().decompress(data, length + 1)
        except zlib.error as exc:
            raise body.wrong(f"a deflated piece is damaged ({exc})", "piece") from None
        if len(part) != length:
            raise body.wrong("a piece has another length", "piece", length, len(part))
        whole[start : start + length] = part
        filled += length
    if filled != size:
        raise body.wrong(
            "the pieces do not fill the array", "pieces", f"{size} bytes", f"{filled} bytes"
        )
    return np.frombuffer(bytes(whole), "u1" if marks else _COUNT_TYPES[width])


def _mnt_sniff(file: RawFile) -> Match:
    """Return how sure we are: old workbooks are OLE files too."""
    if not sniffer(_MNT)(file):
        return Match.NO
    try:
        return Match.YES if _Compound(file).stream(_STREAM) is not None else Match.NO
    except ReadError:
        return Match.MAYBE


mnt = BuiltIn(_mnt_sniff, _mnt_channels, _mnt_read)
