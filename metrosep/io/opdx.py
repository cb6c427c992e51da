"""Bruker Vision64 ``.opdx``, also of Dektak profilers: profiles and maps inside a tagged tree.

Height in m is ``raw * DataScale`` with the unit that DataScale names. Positions of a profile are
stored; the steps of a map are its extents divided by its points less one. What is not measured is
NaN or 1e38. Rows are in the order that the field Origin says. Layout and sources are in
``data_formats/opdx/SPEC.md``.
"""

from __future__ import annotations

import struct
from typing import Any

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
from metrosep.io.binary import check_area, check_scale
from metrosep.io.maps import (
    ROW_ORDERS,
    lateral_or_none,
    make_profile,
    make_surface,
    only_channels,
    scaled,
)
from metrosep.io.opdx_tree import Quantity, VcaBytes, VcaTree, plain_tree, read_tree
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
