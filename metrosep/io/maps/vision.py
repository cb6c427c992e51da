"""Wyko, Veeco and Bruker Vision, binary: ``.opd`` and ``.opdx`` of Vision64 and Dektak."""

from __future__ import annotations

import struct
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, UnitError, UnsupportedFeatureError
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.core.text_options import ROW_ORDERS
from metrosep.core.units import parse_unit
from metrosep.io.declared import Cursor, Match, need_bytes
from metrosep.io.objects import (
    Request,
    check_area,
    check_scale,
    lateral_or_none,
    map_reader,
    scaled,
)
from metrosep.io.registry import BuiltIn, demand, mismatch, sniffer, structure
from metrosep.io.source import RawFile

# ---- Wyko, Veeco and Bruker Vision ``.opd``: a directory of named blocks, little-endian
# Height in m is ``raw * Wavelength / Mult`` (Wavelength in nm); dx is ``Pixel_size`` (mm), dy is
# ``Pixel_size * Aspect``: the pixels are often not square. A map is stored column by column, the
# smallest y first. Blocks of an unknown type are skipped and named in the metadata. Layout and
# sources are in ``data_formats/opd/SPEC.md``.

_OPD = "opd"

_ENTRY, _ARRAY_HEAD = structure(_OPD, "entry"), structure(_OPD, "array")
_START = 2
_ENTRY_BYTES = 24
_MAX_ENTRIES = 2**16
_DIRECTORY, _ARRAY, _TEXT = 1, 3, 5
_SCALARS = {(6, 2): "h", (6, 4): "i", (7, 2): "h", (7, 4): "f", (8, 8): "d", (12, 4): "i"}
"""Type and length of a block to the `struct` code of its number; the length decides for type 7."""

_SCALES = ("Wavelength", "Mult", "Aspect", "Pixel_size")
"""Blocks without which heights or steps would be wrong: refused, not skipped, if unknown."""

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


_opd_sniff = sniffer(_OPD)


def _opd_channels(file: RawFile) -> tuple[str, ...]:
    """Return the maps of heights in the file."""
    return tuple(_maps(file, _blocks(file)))


@map_reader(_OPD, "OPD", "an OPD map with its own units", several=True)
def _opd_read(asked: Request) -> Surface:
    """Return a height map of an OPD file."""
    file = asked.file
    blocks = _blocks(file)
    maps = _maps(file, blocks)
    name = asked.choose(maps)
    warnings = asked.warnings
    raw = _raw(file, maps[name], asked.max_pixels, warnings)
    first = _FIRST_INVALID[raw.dtype.itemsize]
    numbers = _numbers(file, blocks)
    scale = _scale(file, numbers, name, raw.dtype)
    own = _steps(file, numbers, warnings)
    left = file.size - max(b.offset + b.size for b in blocks)
    if left:
        warnings.append(f"{left} bytes follow the last block; they were not read")
    z = scaled(raw.T, scale, lambda block: ~(block < first))  # NaN is not smaller either
    return asked.surface(
        z,
        own,
        row_order="smallest y first",
        header=_plain(blocks),
        channel=name,
        wavelength_m=float(numbers["Wavelength"].value) * 1e-9,
        mult=numbers["Mult"].value if "Mult" in numbers else 1,
        aspect=numbers["Aspect"].value if "Aspect" in numbers else None,
        height_per_count_m=scale,
    )


def _blocks(file: RawFile) -> list[_Block]:
    """Return the blocks with content; every one lies in the file."""
    demand(file, _OPD)
    directory = _ENTRY.read(file, _START)
    n_entries, rest = divmod(directory["bytes"], _ENTRY_BYTES)
    if directory["type"] != _DIRECTORY or rest or not 1 < n_entries <= _MAX_ENTRIES:
        raise file.corrupt(
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
        entry = _ENTRY.read(file, _START + i * _ENTRY_BYTES)
        if entry["bytes"] == 0:
            continue
        need_bytes(file, place, entry["bytes"], "a block", name=f"bytes of {entry['name']!r}")
        value = _value(file, entry["type"], place, entry["bytes"])
        blocks.append(_Block(entry["name"], entry["type"], entry["bytes"], place, value))
        place += entry["bytes"]
    if not blocks:
        raise file.corrupt("the directory has no block with content", offset=_START)
    return blocks


def _value(file: RawFile, kind: int, offset: int, size: int) -> Any:
    """Return the number or text of a block, the header of an array, None for what is not known."""
    if (kind, size) in _SCALARS:
        return struct.unpack_from("<" + _SCALARS[kind, size], file.data, offset)[0]
    if kind == _TEXT:
        text = file.data[offset : offset + min(size, 4096)]
        return text.split(b"\0")[0].decode("latin-1").strip()
    if kind == _ARRAY and size >= _ARRAY_HEADER_BYTES:
        return _ARRAY_HEAD.read(file, offset)
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
        raise file.corrupt(
            "a map has no header",
            field=f"bytes of {block.name!r}",
            offset=block.offset,
            expected=f"at least {_ARRAY_HEADER_BYTES}",
            found=block.size,
        )
    item = block.value["item_bytes"]
    if item == 1:
        raise UnsupportedFeatureError(
            f"{file.path}: {block.name} has heights of 8 bits, for which no rule for not-measured "
            "points is known; save the measurement again with 16 bits or as floats"
        )
    columns, rows = block.value.area("columns", "rows", max_pixels)
    size = _ARRAY_HEADER_BYTES + columns * rows * item
    if item not in _ITEMS or size > block.size:
        raise file.corrupt(
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
            raise file.corrupt(
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
    for name in ("Wavelength", "Mult") if dtype.kind == "i" else ("Wavelength",):
        if name not in numbers:
            raise file.corrupt(
                f"the scale of the heights of {channel} is missing",
                field=name,
                expected="a block of that name with a number",
            )
    ranges = {"Wavelength": _WAVELENGTHS_NM, "Mult": (1.0, 1e9)}
    wavelength, mult = (
        check_scale(file, n, b.value, offset=b.offset, low=low, high=high)
        if (b := numbers.get(n)) is not None
        else 1.0
        for n, (low, high) in ranges.items()
    )
    return wavelength * 1e-9 / mult


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


opd = BuiltIn(_opd_sniff, _opd_channels, _opd_read)


# ---- bruker Vision64 ``.opdx``, also of Dektak profilers: profiles and maps inside a tagged tree ----
# Height in m is ``raw * DataScale`` with the unit that DataScale names. Positions of a profile are
# stored; the steps of a map are its extents divided by its points less one. What is not measured is
# NaN or 1e38. Rows are in the order that the field Origin says. Layout and sources are in
# ``data_formats/opdx/SPEC.md``.

_OPDX = "opdx"

_MAGIC_BYTES = 12
_GROUPS = {"/2D_Data/": "/Matrix", "/1D_Data/": "/Array"}
_ARRAY_ITEMS = {b"\x0d\x08\0\0\0": "<f8", b"\x0c\x04\0\0\0": "<f4"}
"""First bytes of an array: type and size of its numbers."""

_OPDX_ARRAY_HEAD = 5
_MATRIX_HEAD = 8
_OPDX_FIRST_INVALID = 1e38
_LOWER_LEFT = 1
_UNIT_RTOL = 1e-6
"""Agreement of the symbol of a unit with its factor, which the file keeps in double precision."""


_opdx_sniff = sniffer(_OPDX)


def _opdx_channels(file: RawFile) -> tuple[str, ...]:
    """Return the maps and profiles whose values are lengths."""
    return _heights(file, _tree(file))


@map_reader(_OPDX, "Vision64", "a Vision64 file with its own units", several=True)
def _opdx_read(asked: Request) -> Surface | Profile:
    """Return a map or a profile of a Vision64 file."""
    file = asked.file
    tree = _tree(file)
    name = asked.choose(_heights(file, tree))
    prefix = f"/{name}"
    scale = _length(file, tree, f"{prefix}/DataScale")
    check_scale(file, f"{prefix}/DataScale", scale, low=1e-24, high=1e3)
    facts = {"channel": name, "height_per_count_m": scale}
    if name.startswith("1D_Data"):
        return _profile(asked, tree, prefix, facts)
    return _surface(asked, tree, prefix, facts)


def _profile(asked: Request, tree: VcaTree, prefix: str, facts: dict[str, Any]) -> Profile:
    file = asked.file
    raw = _opdx_numbers(file, tree, f"{prefix}/Array", asked.max_pixels)
    count = tree.items.get(f"{prefix}/NumPoints", raw.size)
    if count != raw.size:
        raise _corrupt(
            file, "the profile has another length", f"{prefix}/NumPoints", raw.size, count
        )
    warnings = list(tree.warnings)
    z = scaled(raw, facts["height_per_count_m"], _is_invalid)
    x = _positions(file, tree, prefix, raw.size, warnings)
    if x is None:
        if asked.step is None:
            raise UnitError(f"{file.path}: {prefix} has no positions; declare lateral_step=")
        x = np.arange(raw.size, dtype=np.float64) * asked.step
    return asked.profile(x, z, header=plain_tree(tree), warnings=warnings, **facts)


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
        lists.append(_opdx_numbers(file, tree, f"{prefix}/PositionArray", None))
        if lists[0].size != count:
            field = f"{prefix}/PositionArray"
            raise _corrupt(file, "there are not as many positions", field, count, lists[0].size)
    block = tree.items.get(f"{prefix}/PositionFunction")
    if isinstance(block, VcaBytes) and block.size >= 8 * count + 8:
        place = block.offset + block.size - 8 * count
        if file.data[place - 8 : place] == struct.pack("<Q", count):
            lists.append(np.frombuffer(file.data, "<f8", count, place))
    return lists


def _surface(asked: Request, tree: VcaTree, prefix: str, facts: dict[str, Any]) -> Surface:
    file = asked.file
    raw = _matrix(file, tree, f"{prefix}/Matrix", asked.max_pixels)
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
    return asked.surface(
        scaled(raw, facts["height_per_count_m"], _is_invalid, turned=is_turned),
        (steps[0], steps[1]),
        row_order=ROW_ORDERS[is_turned],
        turned=True,
        header=plain_tree(tree),
        warnings=warnings,
        **facts,
    )


def _tree(file: RawFile) -> VcaTree:
    if _opdx_sniff(file) is not Match.YES:
        raise mismatch(file, _OPDX)
    return read_tree(file, _MAGIC_BYTES)


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
    """Return metres per unit, None if it is not a length; an inch is written with a full stop."""
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
        raise UnitError(f"{file.path}: {path} has the unit {unit!r}, which is not a length")
    if quantity.per_si is not None and not abs(factor * quantity.per_si - 1.0) <= _UNIT_RTOL:
        found = f"{quantity.per_si:g} {quantity.symbol} in a metre"
        raise _corrupt(file, "a unit contradicts its factor", path, f"{1 / factor:g}", found)
    return quantity.value * factor


def _is_invalid(block: NDArray[Any]) -> NDArray[np.bool_]:
    return np.asarray(~(block < _OPDX_FIRST_INVALID))


def _opdx_numbers(
    file: RawFile, tree: VcaTree, path: str, max_pixels: int | None
) -> NDArray[np.floating]:
    """Return the numbers of an array: type byte, u32 bytes of a number, numbers."""
    block = _block(file, tree, path, _OPDX_ARRAY_HEAD)
    head = file.data[block.offset : block.offset + _OPDX_ARRAY_HEAD]
    if head not in _ARRAY_ITEMS:
        raise UnsupportedFeatureError(
            f"{file.path}: {path} begins with {head.hex(' ')}; only doubles (0d 08 00 00 00) and "
            "singles (0c 04 00 00 00) are read: export the profile as text"
        )
    dtype = np.dtype(_ARRAY_ITEMS[head])
    size = block.size - _OPDX_ARRAY_HEAD
    if size % dtype.itemsize:
        raise _corrupt(
            file, "the last number is cut off", path, f"{dtype.itemsize} bytes each", size
        )
    count = size // dtype.itemsize
    check_area(file, count, 1, max_pixels=max_pixels, names=(path, "lines"))
    return np.frombuffer(file.data, dtype, count, block.offset + _OPDX_ARRAY_HEAD)


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
    return file.corrupt(reason, field=path[-80:], expected=expected, found=found)


# ---- the tagged tree of Vision64 files (``.opdx``), read as if a stranger had sent it ----------
# An item is a name (u32 length, UTF-8), a type byte and a value, little-endian. Containers hold items
# and say how many bytes they take; each ends with a terminator. Every step moves forward inside the
# container that encloses it, containers nest only so deep, and an array is a place in the file, not a
# copy: nothing is allocated that the file does not hold. A type that is not known ends its container,
# which is noted.

_OPDX_SCALARS = {
    0x01: "?",
    0x04: "h",
    0x05: "H",
    0x06: "i",
    0x07: "I",
    0x0A: "q",
    0x0B: "Q",
    0x0C: "f",
    0x0D: "d",
}
_OPDX_TEXT, _QUANTITY, _UNIT, _TIME, _LIST, _END = 0x12, 0x13, 0x18, 0x15, 0x42, 0x7F
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
    reader = _Reader()
    reader.container(Cursor(file, file.data, offset), "", 0)
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
    """Items by path; the cursor refuses whatever leads out of the container that encloses it."""

    def __init__(self) -> None:
        self._n = 0
        self.items: dict[str, Any] = {}
        self.warnings: list[str] = []

    def container(self, at: Cursor, path: str, depth: int) -> None:
        """Read the items of a container; each takes five bytes or more."""
        if depth > _MAX_DEPTH:
            raise at.wrong("containers are nested too deep", path, str(_MAX_DEPTH), "")
        while at.left:
            self._n += 1
            if self._n > _MAX_ITEMS:
                raise at.wrong("has too many items", path, f"up to {_MAX_ITEMS}", "")
            name = at.text(path or "the first item")
            where = f"{path}/{name[:60]}"
            kind = at.number("B", where)
            if kind == _END:
                self._finish(at, name, path)
                return
            if not self._item(at, kind, where, depth):
                self.warnings.append(
                    f"{where} has the unknown type {kind:#04x}: it and what follows in "
                    f"{path or 'the file'} were not read"
                )
                return
        raise at.wrong("ends without a terminator", path, "an item 7f ff ff", "none")

    def _finish(self, at: Cursor, name: str, path: str) -> None:
        """Refuse a terminator that has a name or does not stand at the end."""
        at.take(_END_BYTES, path or "the terminator")
        if at.left and not path:
            self.warnings.append(f"{at.left} bytes follow the tree; they were not read")
        elif at.left or name:
            raise at.wrong("a container ends too early", path, "0 bytes left", at.left)

    def _item(self, at: Cursor, kind: int, path: str, depth: int) -> bool:
        """Read a value; False if its type is not known."""
        if kind in _OPDX_SCALARS:
            self.items[path] = at.number(_OPDX_SCALARS[kind], path)
            return True
        if kind == _TIME:
            self.items[path] = at.take(_TIME_BYTES, path).hex()
            return True
        type_name = ""
        if kind in (*_NAMED, _LIST, _MATRIX):
            type_name = at.text(path)
        elif kind not in (*_CONTAINERS, _OPDX_TEXT, _QUANTITY, _UNIT):
            return False
        if kind == _MATRIX:
            at.number("I", path)
            at.text(path)
        inner = at.inside(self._size(at, path), path)
        if kind in _CONTAINERS:
            self.container(inner, path, depth + 1)
        elif kind == _OPDX_TEXT:
            self.items[path] = inner.take(min(inner.left, _MAX_TEXT), path).decode(
                "utf-8", "replace"
            )
        elif kind == _CHOICE and inner.left <= _MAX_CHOICE:
            self.items[path] = int.from_bytes(inner.take(inner.left, path), "little")
        elif kind in (_QUANTITY, _UNIT):
            value = inner.number("d", path) if kind == _QUANTITY else 1.0
            name, symbol = inner.text(path), inner.text(path)
            per_si = inner.number("d", path) if inner.left >= 8 else None
            self.items[path] = Quantity(value, name, symbol, per_si)
        elif kind == _LIST:
            texts = []
            while inner.left:
                texts.append(inner.text(path))
            self.items[path] = texts
        else:
            self.items[path] = VcaBytes(type_name, inner.place, inner.left)
        return True

    def _size(self, at: Cursor, path: str) -> int:
        """Return the size of a value, which has a length of its own: 1, 2 or 4."""
        width = at.number("B", path)
        if width not in (1, 2, 4):
            raise at.wrong("the width of a size is unknown", path, "1, 2 or 4", width)
        return int.from_bytes(at.take(width, path), "little")


opdx = BuiltIn(_opdx_sniff, _opdx_channels, _opdx_read)
