"""Gwyddion native ``.gwy``: data fields of a container, with their titles, units and masks.

Heights are doubles in the unit of the field, row by row, the top row first. Pixels under a mask stay
valid (a mask marks, it does not delete); their number is recorded. The tree is read by
`metrosep.io.gwy_tree`; see ``data_formats/gwy/SPEC.md``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    CorruptFileError,
    FormatMismatchError,
    UnitError,
    UnsupportedFeatureError,
)
from metrosep.core.surface import Surface
from metrosep.core.units import parse_unit
from metrosep.io.binary import check_area
from metrosep.io.gwy_tree import GwyArray, GwyObject, plain, read_object
from metrosep.io.maps import ROW_ORDERS, lateral_or_none, make_surface, only_channels
from metrosep.io.registry import Match
from metrosep.io.source import RawFile, lateral_steps

__all__ = ["channels", "read", "sniff"]

FORMAT = "gwy"
_MAGIC = b"GWYP"
_CONTAINER = "GwyContainer"
_DATA = re.compile(r"/(\d{1,9})/data")
_FIELD = "GwyDataField"
_AXES = ("xy", "z")


def sniff(file: RawFile) -> Match:
    """Return how sure we are that a file is a Gwyddion file."""
    if not file.head.startswith(_MAGIC):
        return Match.NO
    return Match.YES if file.head[4:].startswith(_CONTAINER.encode() + b"\0") else Match.MAYBE


def channels(file: RawFile) -> tuple[str, ...]:
    """Return the data fields, such as ``"/0/data"``."""
    return _fields(_container(file, []))


def read(
    file: RawFile,
    *,
    channel: str | None = None,
    lateral_step: Any = None,
    unit: Any = None,
    max_pixels: int | None = None,
) -> Surface:
    """Return a data field of a Gwyddion file."""
    override = lateral_steps(lateral_step)
    warnings: list[str] = []
    root = _container(file, warnings)
    key = _chosen(file, root, channel)
    field = root.items[key]
    z, shape = _values(file, key, field, max_pixels)
    units = _units(file, field, unit, warnings)
    steps = []
    for name, count in (("xreal", shape[1]), ("yreal", shape[0])):
        size = _number(file, field, name)
        steps.append(lateral_or_none(file, name, size / count, warnings, factor=units["xy"]))
    return make_surface(
        file,
        FORMAT,
        z.reshape(shape) * units["z"],
        (steps[0], steps[1]),
        row_order=ROW_ORDERS[1],
        header={k: plain(v) for k, v in root.items.items()},
        override=override,
        warnings=warnings,
        channel=key,
        title=_title(root, key),
        units_in_file={a: _unit_text(field, a) for a in _AXES},
        size_in_file=(_number(file, field, "xreal"), _number(file, field, "yreal")),
        offset_in_file=tuple(_number(file, field, n, 0.0) for n in ("xoff", "yoff")),
        n_masked=_masked(file, root, key, shape, max_pixels),
    )


def _container(file: RawFile, warnings: list[str]) -> GwyObject:
    if not file.head.startswith(_MAGIC):
        raise FormatMismatchError(
            f"{file.path}: is no Gwyddion file: expected 'GWYP' at offset 0, found "
            f"{file.head[:4].hex(' ')}; leave out format= to have it recognised"
        )
    root, end = read_object(file, len(_MAGIC))
    if root.type != _CONTAINER:
        raise CorruptFileError(
            file.path, "holds no container", offset=4, expected=_CONTAINER, found=root.type[:40]
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
        raise CorruptFileError(
            file.path,
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
        raise CorruptFileError(
            file.path,
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
                f"declare unit={{'{axis}': ...}} if that is not so"
            )
        try:
            factors[axis] = parse_unit(str(word or "m"), dimension="length").factor
        except UnitError as exc:
            raise UnitError(
                f"{file.path}: the unit of {axis} is {str(word)[:20]!r}, which is no length "
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
