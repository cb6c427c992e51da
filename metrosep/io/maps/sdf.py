"""Surface data file ``.sdf`` (ISO 25178-71) and its ancestor BCR: text or binary, in metres.

The first letter of the version tells text (``aISO-1.0``) from binary (``bISO-1.0``). Height in m
is ``raw * Zscale``, steps are Xscale and Yscale; not measured is the word BAD in text, NaN or a
reserved count in binary data. The first profile has the smallest y; a file with one profile gives
a `Profile`. See ``data_formats/sdf/SPEC.md``.
"""

from __future__ import annotations

import re
from typing import Any, NamedTuple

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    UnsupportedFeatureError,
    WriteError,
)
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.io.declared import Structure, TextFields, need_bytes
from metrosep.io.objects import (
    Request,
    check_area,
    check_scale,
    height_only,
    lateral_or_none,
    map_reader,
    rows_to_write,
    scaled,
)
from metrosep.io.registry import demand, sniffer, structure
from metrosep.io.source import RawFile
from metrosep.io.text.logger import parse_numbers

channels = height_only

FORMAT = "sdf"
_HEADER, _WIDE = structure(FORMAT), structure(FORMAT, "wide")
_EXTRA = Structure("<", "0 2I extra")
_MAX_HEADER = 100
_MAX_TRAILER = 65536

_TYPES = {0: "<u1", 1: "<u2", 2: "<u4", 3: "<f4", 4: "<i1", 5: "<i2", 6: "<i4", 7: "<f8"}
_ISO_TYPES = {"ISO-1.0": (5, 6, 7), "ISO-2.0": (3, 4, 5, 6, 7)}
_MARKERS = {1: 2**16 - 1, 2: 2**32 - 1, 5: -(2**15), 6: -(2**31)}
"""Reserved count that marks a point as not measured, by DataType."""

_OLYMPUS = (5, 1)
"""Two extra numbers after the header of files of that maker."""

_KEYS = {name.lower(): name for _, _, name in _HEADER.layout}
_OPTIONAL = {"Zresolution": "-1", "Compression": "0", "CheckType": "0"}


class _Content(NamedTuple):
    """Header, raw values in the order of the file, where they are not measured, and warnings."""

    header: dict[str, Any]
    raw: np.ndarray[Any, np.dtype[Any]]
    invalid: np.ndarray[Any, np.dtype[np.bool_]] | None
    warnings: list[str]


sniff = sniffer(FORMAT)


@map_reader(FORMAT, "SDF", "a surface data file in metres")
def read(asked: Request) -> Surface | Profile:
    """Return the surface, or the one profile, of a surface data file."""
    file = asked.file
    demand(file, FORMAT)
    content = (_text if file.head[:1] == b"a" else _binary)(file, asked.max_pixels)
    header, warnings = content.header, content.warnings
    scale = check_scale(file, "Zscale", header["Zscale"], low=1e-18, high=1e6)
    own = [lateral_or_none(file, n, header[n], warnings) for n in ("Xscale", "Yscale")]
    shape = (header["NumProfiles"], header["NumPoints"])
    origin = _own_origin(header)
    with np.errstate(invalid="ignore"):  # a signalling NaN is a NaN
        z = scaled(content.raw, scale, content.invalid).reshape(shape)
    if shape[0] > 1:
        return asked.surface(
            z,
            (own[0], own[1]),
            row_order="smallest y first",
            header=header,
            origin=origin,
            warnings=warnings,
            height_per_unit_m=scale,
        )
    step = own[0] or asked.step
    if step is None:
        raise UnsupportedFeatureError(
            f"{file.path}: its one profile has no step (Xscale 0); pass lateral_step="
        )
    return asked.profile(
        origin[0] + step * np.arange(shape[1], dtype=np.float64),
        z[0],
        header=header,
        warnings=warnings,
        height_per_unit_m=scale,
    )


def _own_origin(header: dict[str, Any]) -> tuple[float, float]:
    """Return the origin that metrosep states below the heights, 0 in files of others: the format has none."""
    stated = _ORIGIN.fullmatch(header["trailer"]) if header["ManufacID"] == "metrosep" else None
    return (0.0, 0.0) if stated is None else (float(stated[1]), float(stated[2]))


_ORIGIN = re.compile(r"<Origin> {0} {0} </Origin>".format(r"(-?\d+(?:\.\d+)?(?:e[+-]?\d\d?)?)"))


def _check_flags(file: RawFile, header: dict[str, Any], max_pixels: int | None) -> None:
    """Refuse sizes, types and packings before anything is allocated."""
    names = ("NumPoints", "NumProfiles")
    check_area(file, header[names[0]], header[names[1]], max_pixels=max_pixels, names=names)
    for name in ("Compression", "CheckType"):
        if header[name] != 0:
            raise UnsupportedFeatureError(
                f"{file.path}: has {name} {header[name]}; save it with {name} 0"
            )
    if header["DataType"] not in _TYPES:
        raise UnsupportedFeatureError(
            f"{file.path}: has DataType {header['DataType']}; there are 0 to {max(_TYPES)}"
        )


def _type_notes(header: dict[str, Any]) -> list[str]:
    allowed = _ISO_TYPES.get(header["version"][1:], tuple(_TYPES))
    if header["DataType"] in allowed:
        return []
    return [f"DataType {header['DataType']} does not belong to {header['version']}"]


def _binary(file: RawFile, max_pixels: int | None) -> _Content:
    declared = _WIDE if file.head[:8] == b"bISO-2.0" else _HEADER
    header = declared.read(file)
    _check_flags(file, header, max_pixels)
    dtype = np.dtype(_TYPES[header["DataType"]])
    count = header["NumPoints"] * header["NumProfiles"]
    start = declared.size
    warnings = _type_notes(header)
    longer = header["version"] == "bISO-1.0" and file.size >= start + 8
    if longer and _EXTRA.read(file, start)["extra"] == _OLYMPUS:
        start += 8
        warnings.append("the header is 8 bytes longer than the standard says; they were skipped")
    need_bytes(file, start, count * dtype.itemsize, "the map", name="NumPoints, NumProfiles")
    raw = np.frombuffer(file.data, dtype=dtype, count=count, offset=start)
    header["trailer"] = _trailer(file, start + raw.nbytes)
    markers = dict(_MARKERS)
    if header["version"] == "bISO-2.0":
        markers[4] = -128
    marker = markers.get(header["DataType"])
    invalid = None if marker is None else raw == marker
    if raw.dtype.kind == "f":
        with np.errstate(invalid="ignore"):
            raw = raw.astype(np.float64)  # the scale must not be rounded to single precision
    return _Content(header, raw, invalid, warnings)


def _trailer(file: RawFile, start: int) -> str:
    """Return the text after the heights; other bytes show that sizes or type are wrong."""
    trailer = file.data[start : start + _MAX_TRAILER].strip(b"\0 \r\n*")
    if not trailer.isascii() or b"\0" in trailer:
        raise file.corrupt(
            "what follows the heights is not text",
            offset=start,
            field="NumPoints, NumProfiles, DataType",
            expected=f"the end of the file at {start}",
            found=file.size,
        )
    return trailer.decode("ascii")


def _text(file: RawFile, max_pixels: int | None) -> _Content:
    header, start = _text_header(file)
    _check_flags(file, header, max_pixels)
    star = file.data.find(b"*", start)
    body = file.data[start : star if star >= 0 else file.size]
    count = header["NumPoints"] * header["NumProfiles"]
    if 2 * count > len(body) + 1:
        found: object = f"{len(body)} bytes"
    else:
        raw: FloatArray = parse_numbers(file, body, offset=start, missing=(b"BAD", b"bad"))
        found = raw.size
        if raw.size == count:
            warnings = _type_notes(header)
            if star < 0:
                if not bytes(body[-1:]).isspace():
                    raise file.corrupt(
                        "the file ends within its last height",
                        field="heights",
                        expected="the '*' after them, or a line end",
                        found=bytes(body[-20:]).decode("ascii", "replace"),
                        hint="copy the file again; if it is whole, end its last line",
                    )
                warnings.append("the '*' after the heights is missing")
            header["trailer"] = _trailer(file, star + 1 if star >= 0 else file.size)
            return _Content(header, raw, None, warnings)
    raise file.corrupt(
        "the heights do not fill the map",
        offset=start,
        field="NumPoints, NumProfiles",
        expected=f"{header['NumPoints']} x {header['NumProfiles']} = {count}",
        found=found,
    )


def _text_header(file: RawFile) -> tuple[dict[str, Any], int]:
    """Return the header in the types of the binary one, and where the heights begin."""
    texts = TextFields(file)
    start = file.head.find(b"\n") + 1
    version = file.head[: max(start, 1)].decode("latin-1").strip().replace(" ", "")
    for number in range(2, _MAX_HEADER):
        end = file.head.find(b"\n", start)
        line = file.head[start : end if end >= 0 else None].decode("latin-1").strip()
        if end < 0:
            break
        start = end + 1
        if line == "*":
            return {"version": version, **_typed(texts)}, start
        texts.take(
            line, comments=(";",), line=number, name=lambda key: _KEYS.get(key.lower(), key)
        )
    raise file.corrupt(
        "the header has no end", offset=start, expected="a line '*' before the heights"
    )


def _typed(header: TextFields) -> dict[str, Any]:
    """Return the fields in the types of the binary header, and further ones as text."""
    found: dict[str, Any] = {}
    for _, code, name in _HEADER.layout[1:]:
        if code.endswith("s"):
            found[name] = header.texts.get(name, "")
            continue
        if name in _OPTIONAL:
            header.texts.setdefault(name, _OPTIONAL[name])
        found[name] = header.number(name) if code == "d" else header.integer(name)
    return found | {k: v for k, v in header.texts.items() if k not in found}


# ---- bytes of a surface data file (ISO 25178-71, version 1.0); the same surface gives the same bytes ----
# Heights are written as double precision numbers in metres with Zscale 1, so that reading them back
# gives the same numbers; not measured is the word BAD in text and NaN in binary data. The first
# profile has the smallest y. The format has no origin: it is stated in the trailer, which we read back.

_MAX_SIZE = 65535
_NO_DATE = "010119700000"
"""The format demands DDMMYYYYHHMM; a clock would make the same surface give other bytes."""

_DOUBLE = 7


def sdf_bytes(surface: Surface | Profile, *, binary: bool = False) -> bytes:
    """Return a surface or a profile as an SDF file, version 1.0: text ``aISO-1.0`` or ``bISO-1.0``."""
    z, dx, dy, (x, y) = rows_to_write(surface, "SDF")
    rows, columns = z.shape
    if max(rows, columns) > _MAX_SIZE:
        raise WriteError(
            f"SDF version 1.0 holds at most {_MAX_SIZE} points a side, got {columns} x {rows}; write X3P"
        )
    trailer = f"<Origin> {x!r} {y!r} </Origin>\n"
    fields = {
        "ManufacID": "metrosep",
        "CreateDate": _NO_DATE,
        "ModDate": _NO_DATE,
        "NumPoints": columns,
        "NumProfiles": rows,
        "Xscale": dx,
        "Yscale": dy,
        "Zscale": 1.0,
        "Zresolution": -1.0,
        "Compression": 0,
        "DataType": _DOUBLE,
        "CheckType": 0,
    }
    if binary:
        header = _HEADER.pack({"version": "bISO-1.0", **fields}, _HEADER.size)
        return header + z.astype("<f8").tobytes() + trailer.encode("ascii")
    lines = ["aISO-1.0", *(f"{k:<12}= {v}" for k, v in fields.items()), "*"]
    lines += [" ".join("BAD" if v != v else repr(v) for v in row) for row in z.tolist()]
    return ("\n".join(lines) + f"\n*\n{trailer}*\n").encode("ascii")
