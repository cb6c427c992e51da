"""Axes, sizes and points of an X3P file, checked before anything is allocated."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, UnsupportedFeatureError
from metrosep.io.source import RawFile
from metrosep.io.x3p_container import Container, md5

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

__all__ = [
    "Axis",
    "feature",
    "read_axes",
    "read_points",
    "read_shape",
    "refuse_unread",
]

_TYPES = {"I": "<i2", "L": "<i4", "F": "<f4", "D": "<f8"}
_AXES = ("CX", "CY", "CZ")
_MAX_STEP = 1e3
"""Largest lateral step in m that is taken for one."""


@dataclass(frozen=True, slots=True)
class Axis:
    """One axis of the file."""

    name: str  # ``CX``, ``CY`` or ``CZ``
    # whether its coordinates are stored; an incremental axis counts from its offset
    is_absolute: bool
    dtype: str  # type of a stored coordinate
    increment: float  # m: ``metres = raw * increment + offset``
    offset: float

    def metres(self, raw: FloatArray) -> FloatArray:
        """Return stored coordinates in m."""
        return raw * self.increment + self.offset


def feature(root: Element) -> str:
    """Return the kind of the data."""
    return (root.findtext("Record1/FeatureType") or "SUR").strip().upper()


def _number(file: RawFile, text: str | None, field: str, default: float | None = None) -> float:
    if (text is None or not text.strip()) and default is not None:
        return default
    try:
        value = float((text or "").strip())
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise CorruptFileError(
            file.path,
            "a number is not usable",
            field=field,
            expected="a finite number",
            found=text,
        )
    return value


def read_axes(file: RawFile, root: Element, warnings: list[str]) -> tuple[Axis, ...]:
    """Return the three axes."""
    axes = []
    for name in _AXES:
        element = root.find(f"Record1/Axes/{name}")
        if element is None:
            raise CorruptFileError(file.path, "an axis is missing", field=f"Record1/Axes/{name}")
        kind = (element.findtext("AxisType") or "").strip().upper()
        code = (element.findtext("DataType") or "D").strip().upper()
        if kind not in {"I", "A"} or code not in _TYPES:
            raise CorruptFileError(
                file.path,
                "an axis is of unknown type",
                field=name,
                expected="AxisType I or A, DataType I, L, F or D",
                found=f"{kind or 'nothing'}, {code}",
            )
        text = element.findtext("Increment")
        if kind == "A" and _TYPES[code][1] == "i" and not (text or "").strip():
            warnings.append(f"axis {name} stores integers without an increment: taken as 1 m")
        increment = _number(file, text, f"{name}/Increment", 1.0 if kind == "A" else None)
        if increment == 0.0 or (kind == "I" and abs(increment) > _MAX_STEP):
            raise CorruptFileError(
                file.path,
                "a step is not usable",
                field=f"{name}/Increment",
                expected=f"not 0 and at most {_MAX_STEP:g} m",
                found=increment,
            )
        offset = _number(file, element.findtext("Offset"), f"{name}/Offset", 0.0)
        axes.append(Axis(name, kind == "A", _TYPES[code], increment, offset))
    return tuple(axes)


def read_shape(file: RawFile, root: Element, max_pixels: int) -> tuple[int, int]:
    """Return the size of the map, before anything is allocated."""
    if root.find("Record3/MatrixDimension") is None and feature(root) == "PCL":
        columns, rows, layers = _size(file, root, "ListDimension"), 1, 1
    else:
        columns, rows, layers = (
            _size(file, root, f"MatrixDimension/Size{axis}") for axis in "XYZ"
        )
    if layers != 1:
        raise UnsupportedFeatureError(
            f"{file.path}: the X3P file holds {layers} layers; save the one you need on its own"
        )
    if columns * rows > max_pixels:
        raise UnsupportedFeatureError(
            f"{file.path}: claims {columns} x {rows} points, more than {max_pixels}; pass max_pixels= "
            "if that is true"
        )
    return rows, columns


def _size(file: RawFile, root: Element, name: str) -> int:
    text = (root.findtext(f"Record3/{name}") or "").strip()
    if not (text.isascii() and text.isdecimal() and len(text) < 12 and int(text) > 0):
        raise CorruptFileError(
            file.path,
            "the size of the map is not usable",
            field=name,
            expected="a whole number above 0",
            found=text[:40] or "nothing",
        )
    return int(text)


def refuse_unread(
    file: RawFile, root: Element, axes: tuple[Axis, ...], shape: tuple[int, int]
) -> None:
    """Refuse what is legal X3P and not read."""
    kind = feature(root)
    if kind not in {"SUR", "PRF", "PCL"}:
        raise UnsupportedFeatureError(
            f"{file.path}: X3P feature {kind[:20]!r} is not read; save it as a surface (SUR) or profile "
            "(PRF)"
        )
    if kind == "PCL" and not (axes[0].is_absolute and axes[1].is_absolute):
        raise CorruptFileError(
            file.path, "a list of points needs absolute axes", field="AxisType", expected="A"
        )
    if not axes[2].is_absolute:
        raise CorruptFileError(
            file.path, "the z axis must be absolute", field="CZ/AxisType", expected="A", found="I"
        )
    if kind == "PRF" and shape[0] != 1:
        raise CorruptFileError(
            file.path, "a profile has one row", field="SizeY", expected=1, found=shape[0]
        )


def read_points(
    file: RawFile,
    container: Container,
    root: Element,
    axes: tuple[Axis, ...],
    shape: tuple[int, int],
    *,
    trusted: bool,
) -> dict[str, FloatArray]:
    """Return the stored coordinates of each absolute axis."""
    stored = [a for a in axes if a.is_absolute]
    count = shape[0] * shape[1]
    link = (root.findtext("Record3/DataLink/PointDataLink") or "").strip()
    if link:
        raw = _binary_points(file, container, root, link, stored, count, trusted=trusted)
    elif root.find("Record3/DataList") is not None:
        raw = _text_points(file, root, stored, count)
    else:
        raise CorruptFileError(file.path, "the description names no data", field="Record3")
    values = {a.name: a.metres(raw[a.name]) for a in stored}
    for v in values.values():
        v[~np.isfinite(v)] = np.nan
    if np.isnan(values["CZ"]).all():
        raise CorruptFileError(
            file.path,
            "no point was measured",
            expected="at least one valid height",
            found=f"{count} invalid ones",
            hint="measure again, or check the mask of the export",
        )
    return values


def _binary_points(
    file: RawFile,
    container: Container,
    root: Element,
    link: str,
    stored: list[Axis],
    count: int,
    *,
    trusted: bool,
) -> dict[str, FloatArray]:
    record = np.dtype([(a.name, a.dtype) for a in stored])
    expected = count * record.itemsize
    data = container.read(link, limit=max(expected, 1), trusted=trusted)
    if len(data) != expected:
        raise CorruptFileError(
            file.path,
            "the data do not fill the map",
            field=link,
            expected=f"{expected} bytes",
            found=f"{len(data)} bytes",
        )
    _check_sum(container, root, "MD5ChecksumPointData", link, data)
    points = np.frombuffer(data, dtype=record)
    raw = {a.name: points[a.name].astype(np.float64) for a in stored}
    mask = (root.findtext("Record3/DataLink/ValidPointsLink") or "").strip()
    if mask:
        n_bytes = (count + 7) // 8
        bits = container.read(mask, limit=n_bytes + 8, trusted=trusted)
        if len(bits) < n_bytes:
            raise CorruptFileError(
                file.path,
                "the validity mask is too short",
                field=mask,
                expected=f"{n_bytes} bytes",
                found=f"{len(bits)} bytes",
            )
        _check_sum(container, root, "MD5ChecksumValidPoints", mask, bits)
        packed = np.frombuffer(bits, dtype=np.uint8)
        valid = np.unpackbits(packed, count=count, bitorder="little").astype(bool)
        for column in raw.values():
            column[~valid] = np.nan
    return raw


def _check_sum(container: Container, root: Element, name: str, member: str, data: bytes) -> None:
    claimed = (root.findtext(f"Record3/DataLink/{name}") or "").strip().lower()
    if claimed and claimed != md5(data):
        container.warnings.append(
            f"the MD5 of {member} is wrong: the data were changed after writing"
        )


def _text_points(
    file: RawFile, root: Element, stored: list[Axis], count: int
) -> dict[str, FloatArray]:
    data = root.findall("Record3/DataList/Datum")
    if len(data) != count:
        raise CorruptFileError(
            file.path,
            "the list of points does not fill the map",
            field="Record3/DataList",
            expected=f"{count} points",
            found=f"{len(data)}",
        )
    table = np.full((count, len(stored)), np.nan)
    for i, element in enumerate(data):
        fields = [f.strip() for f in (element.text or "").strip().split(";")]
        if fields == [""]:
            continue
        try:
            table[i] = [float(f) for f in fields]
        except ValueError:
            raise CorruptFileError(
                file.path,
                "a point of the list is not usable",
                field=f"Datum {i + 1}",
                expected=f"{len(stored)} number(s) separated by ';'",
                found=(element.text or "").strip()[:40],
            ) from None
    return {a.name: table[:, k].copy() for k, a in enumerate(stored)}
