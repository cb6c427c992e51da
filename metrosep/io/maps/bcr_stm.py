"""BCR-STM exchange files ``.bcr`` and ``.bcrf``: a header of text, then 16-bit or float heights.

The header is Latin-1 or UTF-16, 2048 characters unless it says otherwise, lines ``name = value``.
Floats are in ``zunit``; integers times ``bit2nm`` are nm. Lengths are in ``xunit`` and ``yunit``
(nm when missing), the step is length / pixels. Not measured is 32767 or about 3.4e38. The first
row is taken for the top one. See ``data_formats/bcr-stm/SPEC.md``.
"""

from __future__ import annotations

import re
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from metrosep.core.errors import (
    FormatMismatchError,
    UnitError,
    UnsupportedFeatureError,
)
from metrosep.core.surface import Surface
from metrosep.core.units import Unit, parse_unit
from metrosep.io.declared import Match, TextFields, need_bytes
from metrosep.io.objects import (
    Request,
    check_area,
    check_scale,
    height_only,
    lateral_or_none,
    map_reader,
    scaled,
)
from metrosep.io.registry import mismatch
from metrosep.io.source import RawFile

channels = height_only

FORMAT = "bcr-stm"
_MAGIC = re.compile(r"fileformat\s*=\s*(bcrstm|bcrf)(?:_unicode)?\s*$", re.MULTILINE)
_ENCODINGS = (("latin-1", 1), ("utf-16-le", 2), ("utf-16-be", 2))
_CHARACTERS = 2048
_MAX_CHARACTERS = 2**20
_VOID_COUNT = 32767
_VOID_FLOAT = 1.7e38
"""Every larger float is the largest one there is, however rounded."""


class _Header(NamedTuple):
    """Fields as text, bytes of the header, and whether heights are floats."""

    fields: TextFields
    size: int
    is_float: bool

    @property
    def texts(self) -> dict[str, str]:
        return self.fields.texts


def sniff(file: RawFile) -> Match:
    """Return how sure we are that a file is a BCR-STM file."""
    return Match.NO if _encoding(file.head) is None else Match.YES


def _encoding(head: bytes) -> tuple[str, int] | None:
    """Return encoding and bytes per character of the header, None if it is of something else."""
    for encoding, width in _ENCODINGS:
        text = head[: 64 * width].decode(encoding, "replace").lstrip("\ufeff")
        if _MAGIC.match(text):
            return encoding, width
    return None


@map_reader(FORMAT, "BCR-STM")
def read(asked: Request) -> Surface:
    """Return the height map of a BCR-STM file."""
    file = asked.file
    header = _header(file)
    fields = header.fields
    if fields.texts.get("forcecurve", "0") not in ("0", ""):
        raise UnsupportedFeatureError(f"{file.path}: holds force curves, no map of heights")
    columns, rows = (fields.integer(n) for n in ("xpixels", "ypixels"))
    check_area(file, columns, rows, max_pixels=asked.max_pixels, names=("xpixels", "ypixels"))
    warnings = asked.warnings
    own = (
        _step(file, fields, "x", columns, warnings),
        _step(file, fields, "y", rows, warnings),
    )
    scale_unit = _height_unit(file, header, asked.unit)
    counts = 1.0 if header.is_float else fields.number("bit2nm")
    scale = scale_unit.factor * check_scale(file, "bit2nm", counts, low=1e-12, high=1e6)
    raw = _raw(file, header, (rows, columns), warnings)
    invalid = raw > _VOID_FLOAT if header.is_float else raw == _VOID_COUNT
    return asked.surface(
        scaled(raw, scale, invalid),
        own,
        row_order="top row first",
        header=fields.texts,
        height_unit=scale_unit.name,
        height_per_unit_m=scale,
    )


def _header(file: RawFile) -> _Header:
    found = _encoding(file.head)
    if found is None:
        raise mismatch(file, FORMAT)
    encoding, width = found
    mark = 2 if file.head[:2] in (b"\xff\xfe", b"\xfe\xff") else 0
    first = _fields(file, file.head[mark : _CHARACTERS * width].decode(encoding, "replace"))
    first.texts.setdefault("headersize", str(_CHARACTERS))
    n_characters = first.integer("headersize")
    if not _CHARACTERS // 4 <= n_characters <= _MAX_CHARACTERS:
        raise file.corrupt(
            "the size of the header is not usable",
            field="headersize",
            expected=f"{_CHARACTERS // 4} to {_MAX_CHARACTERS} characters",
            found=n_characters,
        )
    size = n_characters * width
    need_bytes(file, 0, size, "the header", name="headersize")
    fields = _fields(file, file.data[mark:size].decode(encoding, "replace"))
    return _Header(fields, size, fields.texts["fileformat"].startswith("bcrf"))


def _fields(file: RawFile, text: str) -> TextFields:
    fields = TextFields(file)
    for line in text.split("\n"):
        fields.take(line[:1100], comments=("%", "#"), name=lambda key: key.lower()[:80])
    return fields


def _step(
    file: RawFile, fields: TextFields, axis: str, n: int, warnings: list[str]
) -> float | None:
    """Return the step of an axis in m: its length divided by its pixels."""
    name = f"{axis}length"
    if name not in fields.texts:
        warnings.append(f"{name} is missing: taken as not calibrated")
        return None
    factor = _unit(file, fields.texts, f"{axis}unit").factor
    return lateral_or_none(file, name, fields.number(name) / n, warnings, factor=factor)


def _unit(file: RawFile, fields: dict[str, str], name: str) -> Unit:
    try:
        return parse_unit(fields.get(name) or "nm", dimension="length")
    except UnitError as exc:
        raise UnitError(f"{file.path}: {name}: {exc}") from None


def _height_unit(file: RawFile, header: _Header, unit: Any) -> Unit:
    own = _unit(file, header.texts, "zunit")
    if unit is None:
        if header.is_float or own.name == "nm":
            return own
        raise UnitError(
            f"{file.path}: heights are in nm by bit2nm and in {own.name} by zunit; say which with unit="
        )
    declared = parse_unit(str(unit), dimension="length")
    allowed = {own.name} if header.is_float else {own.name, "nm"}
    if declared.name not in allowed:
        raise FormatMismatchError(
            f"{file.path}: heights are in {own.name} by the file, but {declared.name} was given; leave it "
            "out"
        )
    return declared


def _raw(
    file: RawFile, header: _Header, shape: tuple[int, int], warnings: list[str]
) -> NDArray[Any]:
    """Return the stored heights; floats in double precision, so that the scale is not rounded."""
    order = ">" if header.texts.get("intelmode", "1") == "0" else "<"
    dtype = np.dtype(order + ("f4" if header.is_float else "i2"))
    count = shape[0] * shape[1]
    need_bytes(file, header.size, count * dtype.itemsize, "the map", name="xpixels, ypixels")
    left = file.size - header.size - count * dtype.itemsize
    if left:
        warnings.append(f"{left} bytes follow the map; they were not read")
    raw = np.frombuffer(file.data, dtype=dtype, count=count, offset=header.size).reshape(shape)
    with np.errstate(invalid="ignore"):  # a signalling NaN is a NaN
        return raw.astype(np.float64) if header.is_float else raw
