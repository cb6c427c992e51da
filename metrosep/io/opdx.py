"""Bruker Vision64 ``.opdx``, also of Dektak profilers: profiles and maps inside a tagged tree.

Height in m is ``raw * DataScale`` with the unit that DataScale names. Positions of a profile are
stored; the steps of a map are its extents divided by its points less one. What is not measured is
NaN or 1e38. Rows are in the order that the field Origin says. Layout and sources are in
``data_formats/opdx/SPEC.md``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    CorruptFileError,
    UnitError,
    UnsupportedFeatureError,
)
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.core.units import parse_unit
from metrosep.io.binary import check_area, check_scale
from metrosep.io.maps import lateral_or_none, make_profile, make_surface, only_channels, scaled
from metrosep.io.opdx_tree import Quantity, VcaTree, plain_tree
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


def sniff(head: bytes, name: str) -> Match:
    """Return how sure we are that bytes begin a Vision64 file.

    Parameters
    ----------
    head : bytes
        First bytes of the file.
    name : str
        File name; not used.

    Returns
    -------
    Match
        YES on the magic number, MAYBE on its text alone.
    """
    if head.startswith(_MAGIC):
        return Match.YES
    return Match.MAYBE if head.startswith(_MAGIC[:9]) else Match.NO


def channels(file: RawFile) -> tuple[str, ...]:
    """Return the maps and profiles whose values are lengths.

    Parameters
    ----------
    file : RawFile
        The file.

    Returns
    -------
    tuple of str
        Such as ``"2D_Data/Raw"`` and ``"1D_Data/Raw"``, the primary one first.
    """
    return _heights(file, _tree(file))


def read(
    file: RawFile,
    *,
    channel: str | None = None,
    lateral_step: Any = None,
    unit: Any = None,
    max_pixels: int | None = None,
) -> Surface | Profile:
    """Return a map or a profile of a Vision64 file.

    Parameters
    ----------
    file : RawFile
        The file.
    channel : str, optional
        One of `channels`; the first if omitted.
    lateral_step : float (m), str or pair, optional
        Replaces the positions of the file, whose step is kept in the metadata.
    unit : None
        Not accepted: the format states its units.
    max_pixels : int, optional
        Largest map to allocate; 2**28 if omitted.

    Returns
    -------
    Surface or Profile
        Heights in m.

    Raises
    ------
    FormatMismatchError
        If the magic number is another.
    CorruptFileError
        If an item does not fit or is missing, a scale is not usable, or nothing was measured.
    UnsupportedFeatureError
        If there are no heights, or numbers of another kind, or more than `max_pixels`.
    UnitError
        If a unit is no length.
    """
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
    x = _positions(file, tree, prefix, raw.size, max_pixels, warnings)
    return make_profile(
        file,
        FORMAT,
        x,
        z,
        header=plain_tree(tree),
        override=override[0] if override else None,
        warnings=warnings,
        **facts,
    )


def _positions(
    file: RawFile, node: dict[str, Any], path: str, count: int, warnings: list[str]
) -> FloatArray | None:
    """Return the positions in m: listed, or from the extent, or None where the file has neither."""
    function, array, unit = (node.get(f"Position{n}") for n in ("Function", "Array", "Units"))
    listed = _doubles(file, array, f"{path}/PositionArray") if isinstance(array, Block) else None
    if isinstance(function, Block):
        unit, place = leading_unit(file, function)
        own, place = struct.unpack_from("<Q", file.data, place)[0], place + 8
        size = function.offset + function.size - place
        if (own, size) != (count, 8 * count):
            raise _misfit(file, f"{path}/PositionFunction", count, f"{own} in {size} bytes")
        values = np.frombuffer(file.data, "<f8", count, place)
        if listed is not None and values.tobytes() != listed.tobytes():
            warnings.append(
                f"{path}: PositionFunction and PositionArray differ; the first is used"
            )
        listed = values
    if listed is not None and isinstance(unit, Quantity):
        if listed.size != count:
            raise _misfit(file, f"{path}/PositionArray", count, listed.size)
        return np.asarray(listed * _metres(file, f"{path}/PositionUnits", unit), dtype=np.float64)
    if not isinstance(node.get("Extent"), Quantity):
        return None
    extent = _quantity(file, node, path, "Extent")
    length = extent.value * _metres(file, f"{path}/Extent", extent)
    return np.asarray(np.arange(count) * (length / max(count - 1, 1)), dtype=np.float64)


def _surface(
    file: RawFile,
    node: dict[str, Any],
    path: str,
    override: tuple[float, float] | None,
    warnings: list[str],
    facts: dict[str, Any],
    header: dict[str, Any],
    max_pixels: int | None,
) -> Surface:
    raw = _matrix(file, node["Matrix"], f"{path}/Matrix", max_pixels)
    steps = []
    for number, count in ((2, raw.shape[1]), (1, raw.shape[0])):
        name = f"Dimension{number}"
        if node.get(f"{name}Points", count) != count:
            raise _misfit(file, f"{path}/{name}Points", count, node[f"{name}Points"])
        extent = _quantity(file, node, path, f"{name}Extent")
        factor = _metres(file, f"{path}/{name}Extent", extent)
        step = extent.value / max(count - 1, 1)
        steps.append(lateral_or_none(file, f"{path}/{name}Extent", step, warnings, factor=factor))
    return make_surface(
        file,
        FORMAT,
        scaled(raw, facts["height_per_count_m"], _invalid, turned=True),
        (steps[0], steps[1]),
        row_order=ROW_ORDERS[1],
        turned=True,
        header=header,
        override=override,
        warnings=warnings,
        **facts,
    )


def _invalid(block: NDArray[Any]) -> NDArray[np.bool_]:
    return np.asarray(~(np.abs(block) < _NOT_MEASURED))


def _doubles(
    file: RawFile, block: Block, path: str, max_pixels: int | None = None
) -> NDArray[np.float64]:
    """Return the numbers of an array: type byte, u32 bytes of an item, items."""
    if block.size < 5:
        raise _misfit(file, path, "at least 5 bytes", block.size)
    code, width = struct.unpack_from("<BI", file.data, block.offset)
    if (code, width) != _DOUBLE:
        raise UnsupportedFeatureError(
            f"{file.path}: {path} holds items of type {code:#x} and {width} bytes; only doubles (0xd, 8 "
            "bytes) are read: export the profile as text"
        )
    if (block.size - 5) % width or block.size == 5:
        raise _misfit(file, path, "whole doubles", f"{block.size - 5} bytes")
    count = (block.size - 5) // width
    check_area(file, count, 1, max_pixels=max_pixels, names=(path, "lines"))
    return np.frombuffer(file.data, "<f8", count, block.offset + 5)


def _matrix(file: RawFile, block: Block, path: str, max_pixels: int | None) -> NDArray[np.float32]:
    """Return the numbers of a matrix: u32 rows, u32 columns, singles."""
    if block.size < 8:
        raise _misfit(file, path, "at least 8 bytes", block.size)
    rows, columns = struct.unpack_from("<II", file.data, block.offset)
    check_area(file, columns, rows, max_pixels=max_pixels, names=(path, "rows"))
    if block.size - 8 != 4 * rows * columns:
        raise _misfit(file, path, f"{4 * rows * columns} bytes", f"{block.size - 8} bytes")
    return np.frombuffer(file.data, "<f4", rows * columns, block.offset + 8).reshape(rows, columns)


def _quantity(file: RawFile, node: dict[str, Any], path: str, name: str) -> Quantity:
    value = node.get(name)
    if not isinstance(value, Quantity):
        raise _misfit(file, f"{path}/{name}", "a value with a unit", type(value).__name__)
    return value


def _metres(file: RawFile, path: str, quantity: Quantity) -> float:
    """Return metres per unit; symbol and factor of the file must agree where both are known."""
    symbol, per_si = quantity.symbol or quantity.name, quantity.per_si
    try:
        known = parse_unit(symbol, dimension="length").factor if symbol else None
    except UnitError:
        known = None
    if quantity.is_length is False or (known is None and quantity.is_length is None):
        raise UnitError(
            f"{file.path}: the unit of {path} is {symbol[:20]!r}, which is no length; read another channel"
        )
    if per_si is None:
        return float(known or 0.0)
    check_scale(file, f"{path} (units per m)", per_si, low=1e-3, high=1e15)
    if known is not None and abs(known * per_si - 1.0) > _SAME_UNIT:
        raise _misfit(file, path, f"{1 / known:g} {symbol} in a metre", f"{per_si:g}")
    return known or 1.0 / per_si


def _misfit(file: RawFile, path: str, expected: object, found: object) -> CorruptFileError:
    return CorruptFileError(
        file.path,
        "parts of the file contradict each other",
        field=path[:80],
        expected=expected,
        found=found,
    )
