"""Bruker Vision64 ``.opdx``, also of Dektak profilers: profiles and maps inside a tagged tree.

Height in m is ``raw * DataScale`` with the unit that DataScale names. Positions of a profile are
stored; the steps of a map are its extents divided by its points less one. What is not measured is
NaN or 1e38. Rows are in the order that the field Origin says. Layout and sources are in
``data_formats/opdx/SPEC.md``.
"""

from __future__ import annotations

import struct
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    CorruptFileError,
    FormatMismatchError,
    UnitError,
    UnsupportedFeatureError,
)
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.core.units import parse_unit
from metrosep.io.objects import (
    ROW_ORDERS,
    check_area,
    check_scale,
    lateral_or_none,
    make_profile,
    make_surface,
    only_channels,
    scaled,
)
from metrosep.io.registry import Match
from metrosep.io.source import RawFile, lateral_steps, refuse_options

__all__ = ["channels", "read", "sniff"]

FORMAT = "opdx"

_MAGIC = b"VCA DATA\x01\0\0\x55"
_GROUPS = {"/2D_Data/": "/Matrix", "/1D_Data/": "/Array"}
_ARRAY_ITEMS = {b"\x0d\x08\0\0\0": "<f8", b"\x0c\x04\0\0\0": "<f4"}
"""First bytes of an array: type and size of its numbers."""

_ARRAY_HEAD = 5
_MATRIX_HEAD = 8
_FIRST_INVALID = 1e38
_LOWER_LEFT = 1
_UNIT_RTOL = 1e-6
"""Agreement of the symbol of a unit with its factor, which the file keeps in double precision."""


def sniff(file: RawFile) -> Match:
    """Return how sure we are that a file is a Vision64 file."""
    if file.head.startswith(_MAGIC):
        return Match.YES
    return Match.MAYBE if file.head.startswith(_MAGIC[:9]) else Match.NO


def channels(file: RawFile) -> tuple[str, ...]:
    """Return the maps and profiles whose values are lengths."""
    return _heights(file, _tree(file))


def read(
    file: RawFile,
    *,
    channel: str | None = None,
    lateral_step: Any = None,
    unit: Any = None,
    max_pixels: int | None = None,
) -> Surface | Profile:
    """Return a map or a profile of a Vision64 file."""
    refuse_options(file, "a Vision64 file with its own units", unit=unit)
    override = lateral_steps(lateral_step)
    tree = _tree(file)
    name = only_channels(file, "Vision64", channel, _heights(file, tree))
    prefix = f"/{name}"
    scale = _length(file, tree, f"{prefix}/DataScale")
    check_scale(file, f"{prefix}/DataScale", scale, low=1e-24, high=1e3)
    facts = {"channel": name, "height_per_count_m": scale}
    if name.startswith("1D_Data"):
        return _profile(file, tree, prefix, override, max_pixels, facts)
    return _surface(file, tree, prefix, override, max_pixels, facts)


def _profile(
    file: RawFile,
    tree: VcaTree,
    prefix: str,
    override: tuple[float, float] | None,
    max_pixels: int | None,
    facts: dict[str, Any],
) -> Profile:
    raw = _numbers(file, tree, f"{prefix}/Array", max_pixels)
    count = tree.items.get(f"{prefix}/NumPoints", raw.size)
    if count != raw.size:
        raise _corrupt(
            file, "the profile has another length", f"{prefix}/NumPoints", raw.size, count
        )
    warnings = list(tree.warnings)
    z = scaled(raw, facts["height_per_count_m"], _is_invalid)
    step = override[0] if override else None
    x = _positions(file, tree, prefix, raw.size, warnings)
    if x is None:
        if step is None:
            raise UnitError(f"{file.path}: {prefix} has no positions; declare lateral_step=")
        x = np.arange(raw.size, dtype=np.float64) * step
    return make_profile(
        file,
        FORMAT,
        x,
        z,
        header=plain_tree(tree),
        override=step,
        warnings=warnings,
        **facts,
    )


def _positions(
    file: RawFile, tree: VcaTree, prefix: str, count: int, warnings: list[str]
) -> FloatArray | None:
    """Return the positions in m: listed, or from the extent, or None where the file has neither."""
    lists = _listed(file, tree, prefix, count)
    if lists and f"{prefix}/PositionUnits" in tree.items:
        if len({values.tobytes() for values in lists}) > 1:
            warnings.append(f"{prefix}: the two lists of positions differ; PositionArray is used")
        return np.asarray(lists[0] * _length(file, tree, f"{prefix}/PositionUnits"), dtype=float)
    if f"{prefix}/Extent" not in tree.items:
        return None
    extent = _length(file, tree, f"{prefix}/Extent")
    return np.asarray(np.arange(count) * (extent / max(count - 1, 1)), dtype=np.float64)


def _listed(file: RawFile, tree: VcaTree, prefix: str, count: int) -> list[NDArray[Any]]:
    """Return PositionArray and the end of PositionFunction: u64 number, that many doubles."""
    lists: list[NDArray[Any]] = []
    if f"{prefix}/PositionArray" in tree.items:
        lists.append(_numbers(file, tree, f"{prefix}/PositionArray", None))
        if lists[0].size != count:
            field = f"{prefix}/PositionArray"
            raise _corrupt(file, "there are not as many positions", field, count, lists[0].size)
    block = tree.items.get(f"{prefix}/PositionFunction")
    if isinstance(block, VcaBytes) and block.size >= 8 * count + 8:
        place = block.offset + block.size - 8 * count
        if file.data[place - 8 : place] == struct.pack("<Q", count):
            lists.append(np.frombuffer(file.data, "<f8", count, place))
    return lists


def _surface(
    file: RawFile,
    tree: VcaTree,
    prefix: str,
    override: tuple[float, float] | None,
    max_pixels: int | None,
    facts: dict[str, Any],
) -> Surface:
    raw = _matrix(file, tree, f"{prefix}/Matrix", max_pixels)
    warnings = list(tree.warnings)
    steps = []
    for axis, count in (("Dimension2", raw.shape[1]), ("Dimension1", raw.shape[0])):
        points, name = f"{prefix}/{axis}Points", f"{prefix}/{axis}Extent"
        claimed = tree.items.get(points, count)
        if claimed != count:
            raise _corrupt(file, "the map has another size", points, count, claimed)
        step = _length(file, tree, name) / max(count - 1, 1)
        steps.append(lateral_or_none(file, name, step, warnings))
    is_turned = tree.items.get(f"{prefix}/Origin") != _LOWER_LEFT
    return make_surface(
        file,
        FORMAT,
        scaled(raw, facts["height_per_count_m"], _is_invalid, turned=is_turned),
        (steps[0], steps[1]),
        row_order=ROW_ORDERS[is_turned],
        turned=True,
        header=plain_tree(tree),
        override=override,
        warnings=warnings,
        **facts,
    )


def _tree(file: RawFile) -> VcaTree:
    if not file.head.startswith(_MAGIC):
        raise FormatMismatchError(
            f"{file.path}: is no Vision64 file: expected 'VCA DATA' 01 00 00 55 at offset 0, found "
            f"{file.head[:12].hex(' ')}; leave out format= to have it recognised"
        )
    return read_tree(file, len(_MAGIC))


def _heights(file: RawFile, tree: VcaTree) -> tuple[str, ...]:
    """Return the channels whose scale is a length, the primary one first."""
    found = [
        path[1 : -len(leaf)]
        for group, leaf in _GROUPS.items()
        for path in tree.items
        if path.startswith(group) and path.endswith(leaf) and path.count("/") == 3
    ]
    lengths = [n for n in found if _factor(tree.items.get(f"/{n}/DataScale")) is not None]
    if not lengths:
        raise UnsupportedFeatureError(
            f"{file.path}: holds no map or profile in a unit of length, only "
            f"{', '.join(found[:8]) or 'settings'}; save the measurement with its raw data"
        )
    is_profile = tree.items.get("/MetaData/DataKind") == "Surface Profile"
    primary = f"2D_Data/{tree.items.get('/MetaData/PrimaryData2D')}"
    lengths.sort(key=lambda n: (n.startswith("1D_Data") != is_profile, n != primary))
    return tuple(lengths)


def _factor(quantity: object) -> float | None:
    """Return metres per unit, None if it is no length; an inch is written with a full stop."""
    if isinstance(quantity, Quantity):
        for word in (quantity.symbol.rstrip("."), quantity.name.lower()):
            try:
                return parse_unit(word, dimension="length").factor
            except UnitError:
                continue
    return None


def _length(file: RawFile, tree: VcaTree, path: str) -> float:
    """Return a quantity in m; its symbol must agree with the factor that stands beside it."""
    quantity, factor = tree.items.get(path), _factor(tree.items.get(path))
    if not isinstance(quantity, Quantity):
        found = type(quantity).__name__
        raise _corrupt(file, "an item is missing or of another type", path, "a quantity", found)
    if factor is None:
        unit = quantity.symbol[:20] or quantity.name[:20]
        raise UnitError(f"{file.path}: {path} has the unit {unit!r}, which is no length")
    if quantity.per_si is not None and not abs(factor * quantity.per_si - 1.0) <= _UNIT_RTOL:
        found = f"{quantity.per_si:g} {quantity.symbol} in a metre"
        raise _corrupt(file, "a unit contradicts its factor", path, f"{1 / factor:g}", found)
    return quantity.value * factor


def _is_invalid(block: NDArray[Any]) -> NDArray[np.bool_]:
    return np.asarray(~(block < _FIRST_INVALID))


def _numbers(
    file: RawFile, tree: VcaTree, path: str, max_pixels: int | None
) -> NDArray[np.floating]:
    """Return the numbers of an array: type byte, u32 bytes of a number, numbers."""
    block = _block(file, tree, path, _ARRAY_HEAD)
    head = file.data[block.offset : block.offset + _ARRAY_HEAD]
    if head not in _ARRAY_ITEMS:
        raise UnsupportedFeatureError(
            f"{file.path}: {path} begins with {head.hex(' ')}; only doubles (0d 08 00 00 00) and "
            "singles (0c 04 00 00 00) are read: export the profile as text"
        )
    dtype = np.dtype(_ARRAY_ITEMS[head])
    size = block.size - _ARRAY_HEAD
    if size % dtype.itemsize:
        raise _corrupt(
            file, "the last number is cut off", path, f"{dtype.itemsize} bytes each", size
        )
    count = size // dtype.itemsize
    check_area(file, count, 1, max_pixels=max_pixels, names=(path, "lines"))
    return np.frombuffer(file.data, dtype, count, block.offset + _ARRAY_HEAD)


def _matrix(
    file: RawFile, tree: VcaTree, path: str, max_pixels: int | None
) -> NDArray[np.floating]:
    """Return the numbers of a matrix: u32 rows, u32 columns, singles."""
    block = _block(file, tree, path, _MATRIX_HEAD)
    rows, columns = struct.unpack_from("<II", file.data, block.offset)
    check_area(file, columns, rows, max_pixels=max_pixels, names=(path, "rows"))
    size = 4 * rows * columns
    if block.size - _MATRIX_HEAD != size:
        found = f"{block.size - _MATRIX_HEAD} bytes of {block.type[:40]}"
        raise _corrupt(file, "the map has another size", path, f"{size} bytes", found)
    if "double" in block.type or "int" in block.type:
        raise UnsupportedFeatureError(f"{file.path}: {path} is {block.type[:40]}, not of singles")
    flat = np.frombuffer(file.data, "<f4", rows * columns, block.offset + _MATRIX_HEAD)
    return flat.reshape(rows, columns)


def _block(file: RawFile, tree: VcaTree, path: str, least: int) -> VcaBytes:
    block = tree.items.get(path)
    if not isinstance(block, VcaBytes) or block.size < least:
        found = f"{block.size} bytes" if isinstance(block, VcaBytes) else type(block).__name__
        raise _corrupt(file, "numbers are missing", path, f"at least {least} bytes", found)
    return block


def _corrupt(
    file: RawFile, reason: str, path: str, expected: object, found: object
) -> CorruptFileError:
    return CorruptFileError(file.path, reason, field=path[-80:], expected=expected, found=found)


# ---- the tagged tree of Vision64 files (``.opdx``), read as if a stranger had sent it ----------
# An item is a name (u32 length, UTF-8), a type byte and a value, little-endian. Containers hold items
# and say how many bytes they take; each ends with a terminator. Every step moves forward inside the
# container that encloses it, containers nest only so deep, and an array is a place in the file, not a
# copy: nothing is allocated that the file does not hold. A type that is not known ends its container,
# which is noted.

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
