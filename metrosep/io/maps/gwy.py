"""Gwyddion native ``.gwy``: data fields of a container, with their titles, units and masks.

Heights are doubles in the unit of the field, row by row, the top row first. Pixels under a mask stay
valid (a mask marks, it does not delete); their number is recorded. The tree is read by
`metrosep.io.maps.gwy`; see ``data_formats/gwy/SPEC.md``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    FormatMismatchError,
    UnitError,
    UnsupportedFeatureError,
)
from metrosep.core.surface import Surface
from metrosep.core.text_options import ROW_ORDERS
from metrosep.core.units import parse_unit
from metrosep.io.declared import Cursor
from metrosep.io.objects import Request, check_area, lateral_or_none, map_reader, only_channels
from metrosep.io.registry import demand, sniffer
from metrosep.io.source import RawFile

FORMAT = "gwy"
_MAGIC = b"GWYP"
_CONTAINER = "GwyContainer"
_DATA = re.compile(r"/(\d{1,9})/data")
_FIELD = "GwyDataField"
_AXES = ("xy", "z")


sniff = sniffer(FORMAT)


def channels(file: RawFile) -> tuple[str, ...]:
    """Return the data fields, such as ``"/0/data"``."""
    return _fields(_container(file, []))


@map_reader(FORMAT, "Gwyddion", several=True)
def read(asked: Request) -> Surface:
    """Return a data field of a Gwyddion file."""
    file = asked.file
    warnings = asked.warnings
    root = _container(file, warnings)
    key = _chosen(file, root, asked.channel)
    field = root.items[key]
    z, shape = _values(file, key, field, asked.max_pixels)
    units = _units(file, field, asked.unit, warnings)
    steps = []
    for name, count in (("xreal", shape[1]), ("yreal", shape[0])):
        size = _number(file, field, name)
        steps.append(lateral_or_none(file, name, size / count, warnings, factor=units["xy"]))
    return asked.surface(
        z.reshape(shape) * units["z"],
        (steps[0], steps[1]),
        row_order=ROW_ORDERS[1],
        header={k: plain(v) for k, v in root.items.items()},
        channel=key,
        title=_title(root, key),
        units_in_file={a: _unit_text(field, a) for a in _AXES},
        size_in_file=(_number(file, field, "xreal"), _number(file, field, "yreal")),
        offset_in_file=tuple(_number(file, field, n, 0.0) for n in ("xoff", "yoff")),
        n_masked=_masked(file, root, key, shape, asked.max_pixels),
    )


def _container(file: RawFile, warnings: list[str]) -> GwyObject:
    demand(file, FORMAT)
    root, end = read_object(file, len(_MAGIC))
    if root.type != _CONTAINER:
        raise file.corrupt(
            "holds no container", offset=4, expected=_CONTAINER, found=root.type[:40]
        )
    if end < file.size:
        warnings.append(f"{file.size - end} bytes follow the container; they were not read")
    return root


def _fields(root: GwyObject) -> tuple[str, ...]:
    found = [
        (int(m[1]), key)
        for key, value in root.items.items()
        if (m := _DATA.fullmatch(key)) and isinstance(value, GwyObject) and value.type == _FIELD
    ]
    return tuple(key for _, key in sorted(found))


def _chosen(file: RawFile, root: GwyObject, channel: str | None) -> str:
    keys = _fields(root)
    if not keys:
        raise UnsupportedFeatureError(
            f"{file.path}: holds no data field, only {', '.join(list(root.items)[:8]) or 'nothing'}; "
            "save a height channel"
        )
    titled = [key for key in keys if channel is not None and _title(root, key) == channel]
    return titled[0] if len(titled) == 1 else only_channels(file, "Gwyddion", channel, keys)


def _title(root: GwyObject, key: str) -> str:
    title = root.items.get(f"{key}/title", "")
    return title if isinstance(title, str) else ""


def _values(
    file: RawFile, key: str, field: GwyObject, max_pixels: int | None
) -> tuple[FloatArray, tuple[int, int]]:
    """Return the values of a field and its shape; sizes are checked before anything is copied."""
    columns, rows = (int(_number(file, field, n, whole=True)) for n in ("xres", "yres"))
    check_area(file, columns, rows, max_pixels=max_pixels, names=("xres", "yres"))
    data = field.items.get("data")
    if not isinstance(data, GwyArray) or data.code != "D" or data.count != columns * rows:
        found = f"{data.count} of type {data.code}" if isinstance(data, GwyArray) else "none"
        raise file.corrupt(
            f"the values of {key} do not fit its sizes",
            offset=data.offset if isinstance(data, GwyArray) else field.offset,
            field="data",
            expected=f"{columns * rows} of type D",
            found=found,
        )
    return np.frombuffer(file.data, "<f8", data.count, data.offset), (rows, columns)


def _number(
    file: RawFile,
    field: GwyObject,
    name: str,
    default: float | None = None,
    *,
    whole: bool = False,
) -> float:
    value = field.items.get(name, default)
    if isinstance(value, bool) or not isinstance(value, (int,) if whole else (int, float)):
        raise file.corrupt(
            "a field of the map is missing or of another type",
            offset=field.offset,
            field=name,
            expected="a whole number" if whole else "a number",
            found=type(value).__name__,
        )
    return value


def _unit_text(field: GwyObject, axis: str) -> str:
    """Return the unit as the file writes it; empty where it states none."""
    unit = field.items.get(f"si_unit_{axis}")
    text = unit.items.get("unitstr", "") if isinstance(unit, GwyObject) else ""
    return text.strip() if isinstance(text, str) else ""


def _units(
    file: RawFile, field: GwyObject, declared: Any, warnings: list[str]
) -> dict[str, float]:
    """Return metres per unit of both axes; the format stores base SI, so metres if none is named."""
    if isinstance(declared, Mapping):
        given = {axis: declared.get(axis) for axis in _AXES}
        refused = [a for a in declared if a not in _AXES or _unit_text(field, a)]
    else:
        given = dict.fromkeys(_AXES, declared)
        refused = list(_AXES) if declared and all(_unit_text(field, a) for a in _AXES) else []
    if refused:
        raise FormatMismatchError(
            f"{file.path}: unit= was given for {' and '.join(map(str, refused))}, but the field states xy "
            f"in {_unit_text(field, 'xy')!r} and z in {_unit_text(field, 'z')!r}; give it only for xy or "
            "z without one"
        )
    factors: dict[str, float] = {}
    for axis in _AXES:
        word = _unit_text(field, axis) or given[axis]
        if not word:
            warnings.append(
                f"states no unit of {axis}: metres were taken, since the format stores base SI units; "
                f"declare another one, such as unit={{'{axis}': 'um'}}, if that is not so"
            )
        try:
            factors[axis] = parse_unit(str(word or "m"), dimension="length").factor
        except UnitError as exc:
            raise UnitError(
                f"{file.path}: the unit of {axis} is {str(word)[:20]!r}, which is not a length "
                f"({str(exc)[:60]}); read another channel"
            ) from None
    return factors


def _masked(
    file: RawFile, root: GwyObject, key: str, shape: tuple[int, int], max_pixels: int | None
) -> int | None:
    """Return how many pixels the mask marks, None without a mask of the same shape."""
    mask = root.items.get(key.removesuffix("data") + "mask")
    if not isinstance(mask, GwyObject) or mask.type != _FIELD:
        return None
    values, own = _values(file, "the mask", mask, max_pixels)
    return int((values >= 1.0).sum()) if own == shape else None


# ---- the typed tree inside a Gwyddion ``.gwy`` file, read as if a stranger had sent it ---------
# An object is a name, a size and components; a component is a name, a type letter and a value, little-
# endian: ``b c i q d s o`` for bool, byte, int32, int64, double, text and object, capitals for arrays of
# them. Every step moves forward inside the object that encloses it, objects nest only so deep, and an
# array is a place in the file, not a copy: nothing is allocated that the file does not hold.

_SCALARS = {"b": "?", "c": "b", "i": "i", "q": "q", "d": "d"}
_ITEM_BYTES = {"C": 1, "I": 4, "Q": 8, "D": 8}
_MAX_DEPTH = 32
_MAX_COMPONENTS = 100_000


@dataclass(frozen=True)
class GwyArray:
    """Where an array of numbers lies in the file."""

    code: str  # ``"C"``, ``"I"``, ``"Q"`` or ``"D"``
    offset: int  # first byte
    count: int  # number of items


@dataclass(frozen=True)
class GwyObject:
    """An object of the tree."""

    type: str  # such as ``"GwyDataField"``
    # components by name: plain values, `GwyArray`, `GwyObject` or tuples of them
    items: dict[str, Any]
    offset: int  # where the object begins


def read_object(file: RawFile, offset: int) -> tuple[GwyObject, int]:
    """Return the object that begins at an offset, and where it ends."""
    at = Cursor(file, file.data, offset)
    return _Tree().object(at, 0), at.place


def plain(value: Any) -> Any:
    """Return a value of the tree as plain values; arrays become their type and length."""
    if isinstance(value, GwyObject):
        return {"type": value.type, **{k: plain(v) for k, v in value.items.items()}}
    if isinstance(value, GwyArray):
        return f"{value.count} items of type {value.code}"
    if isinstance(value, tuple):
        return [plain(v) for v in value]
    return value


class _Tree:
    """Counts the components while the cursor refuses what leads out of the object that encloses it."""

    def __init__(self) -> None:
        self._n = 0

    def object(self, at: Cursor, depth: int) -> GwyObject:
        start = at.place
        if depth > _MAX_DEPTH:
            raise at.wrong("objects are nested too deep", None, f"at most {_MAX_DEPTH}")
        name = at.word("the name of an object")
        inner = at.inside(at.number("I", f"size of {name}"), f"size of {name}")
        items: dict[str, Any] = {}
        while inner.left:
            self._tally(inner)
            key = inner.word("the name of a component")
            items[key] = self._value(inner, key, depth)
        return GwyObject(name, items, start)

    def _value(self, at: Cursor, key: str, depth: int) -> Any:
        """Return a value; at least one byte is consumed."""
        code = at.take(1, key).decode("latin-1")
        if code in _SCALARS:
            return at.number(_SCALARS[code], key)
        if code == "s":
            return at.word(key)
        if code == "o":
            return self.object(at, depth + 1)
        if code not in {*_ITEM_BYTES, "S", "O"}:
            raise at.wrong("a component has an unknown type", key, None, repr(code))
        count = at.number("I", key)
        if code in _ITEM_BYTES:
            inner = at.inside(count * _ITEM_BYTES[code], key)
            return GwyArray(code, inner.place, count)
        values = []
        for _ in range(count):  # each item takes a byte or more, so a false count soon ends
            self._tally(at)
            values.append(at.word(key) if code == "S" else self.object(at, depth + 1))
        return tuple(values)

    def _tally(self, at: Cursor) -> None:
        self._n += 1
        if self._n > _MAX_COMPONENTS:
            raise at.wrong("has too many components", None, f"up to {_MAX_COMPONENTS}")
