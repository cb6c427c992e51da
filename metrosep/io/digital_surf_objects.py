"""The objects inside a Digital Surf file: header, comment, private zone and points, plain or zlib.

An object begins where the one before ends. Nothing is allocated or inflated before the sizes that
the headers claim have been compared with the bytes that there are; see
``data_formats/digital-surf/SPEC.md``.
"""

from __future__ import annotations

import zlib
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from metrosep.core.errors import CorruptFileError, FormatMismatchError
from metrosep.io.binary import need_bytes, unpack_fields
from metrosep.io.source import RawFile

__all__ = ["FIELDS", "SIGNATURES", "SurfObject", "field_error", "read_objects", "read_points"]

FIELDS: tuple[tuple[int, str, str], ...] = (
    (0, "12s", "signature"),
    (12, "h", "format"),
    (14, "H", "n_objects"),
    (16, "h", "version"),
    (18, "h", "object_type"),
    (20, "30s", "object_name"),
    (50, "30s", "operator_name"),
    (80, "h", "p_size"),
    (82, "h", "acquisition_type"),
    (84, "h", "range_type"),
    (86, "h", "special_points"),
    (88, "h", "absolute"),
    (90, "f", "gauge_resolution"),
    (94, "I", "w_size"),
    (98, "h", "bits_per_point"),
    (100, "i", "zmin"),
    (104, "i", "zmax"),
    (108, "i", "points_per_line"),
    (112, "i", "lines"),
    (116, "i", "total_points"),
    (120, "f", "x_spacing"),
    (124, "f", "y_spacing"),
    (128, "f", "z_spacing"),
    (132, "16s", "x_axis"),
    (148, "16s", "y_axis"),
    (164, "16s", "z_axis"),
    (180, "16s", "x_step_unit"),
    (196, "16s", "y_step_unit"),
    (212, "16s", "z_step_unit"),
    (228, "16s", "x_length_unit"),
    (244, "16s", "y_length_unit"),
    (260, "16s", "z_length_unit"),
    (276, "f", "x_unit_ratio"),
    (280, "f", "y_unit_ratio"),
    (284, "f", "z_unit_ratio"),
    (288, "h", "imprint"),
    (290, "h", "inverted"),
    (292, "h", "levelled"),
    (306, "h", "second"),
    (308, "h", "minute"),
    (310, "h", "hour"),
    (312, "h", "day"),
    (314, "h", "month"),
    (316, "h", "year"),
    (318, "h", "day_of_week"),
    (320, "f", "duration"),
    (324, "I", "compressed_bytes"),
    (334, "H", "comment_bytes"),
    (336, "H", "private_bytes"),
    (338, "128s", "client_zone"),
    (466, "f", "x_offset"),
    (470, "f", "y_offset"),
    (474, "f", "z_offset"),
    (478, "f", "t_spacing"),
    (482, "f", "t_offset"),
    (486, "13s", "t_axis"),
    (499, "13s", "t_step_unit"),
)
"""Offset in bytes, `struct` code (little-endian) and name of each header field."""

SIGNATURES = (b"DIGITAL SURF", b"DSCOMPRESSED")
"""First bytes of an object with plain and with compressed points."""

_HEADER_BYTES = 512
_COMPRESSED = "DSCOMPRESSED"
_ITEMS = {16: "<i2", 32: "<i4"}
_STREAM: tuple[tuple[int, str, str], ...] = ((0, "I", "plain_bytes"), (4, "I", "packed_bytes"))
_MAX_OBJECTS = 65535
_MAX_STREAMS = 4096
_MAX_RATIO = 1040
"""A deflate stream grows by 1032 at most."""


class SurfObject(NamedTuple):
    """Where an object lies in the file, and what its header says."""

    header: dict[str, Any]  # every header field, and the comment
    start: int  # offset of the header
    points: int  # offset of the points, or of the list of compressed streams
    end: int  # offset of the first byte after the object


def read_objects(file: RawFile) -> list[SurfObject]:
    """Return the objects of the file in order; each begins where the one before ends."""
    if file.head[:12] not in SIGNATURES:
        raise FormatMismatchError(
            f"{file.path}: is no Digital Surf file: expected 'DIGITAL SURF' or 'DSCOMPRESSED' at "
            f"offset 0, found {file.head[:12]!r}; leave out format= to have it recognised"
        )
    objects = [_object(file, 0)]
    while len(objects) < _MAX_OBJECTS:
        end = objects[-1].end
        if file.data[end : end + 12] not in SIGNATURES:
            break
        objects.append(_object(file, end))
    claimed = max(objects[0].header["n_objects"], 1)
    if len(objects) < claimed:
        raise CorruptFileError(
            file.path,
            "an object is missing",
            field="n_objects",
            offset=14,
            expected=claimed,
            found=len(objects),
        )
    return objects


def _object(file: RawFile, start: int) -> SurfObject:
    """Return the object at an offset; all of its parts lie in the file."""
    header = unpack_fields(file, FIELDS, order="<", start=start)
    place = start + _HEADER_BYTES
    for part in ("comment", "private"):
        size = header[f"{part}_bytes"]
        need_bytes(file, place, size, f"the {part}", name=f"{part}_bytes")
        if part == "comment":
            text = file.data[place : place + size].split(b"\0")[0]
            header["comment"] = text.decode("latin-1").strip()
        place += size
    points, bits = header["total_points"], header["bits_per_point"]
    if bits not in _ITEMS or points < 1:
        name = "total_points" if bits in _ITEMS else "bits_per_point"
        raise field_error(
            file, start, header, name, "at least 1" if bits in _ITEMS else "16 or 32"
        )
    if header["signature"] == _COMPRESSED:
        skip, sizes = _streams(file, place)
        end = place + skip + sum(packed for _, packed in sizes)
    else:
        end = place + points * bits // 8 * max(header["w_size"], 1)
    need_bytes(file, place, end - place, "the map", name="total_points")
    return SurfObject(header, start, place, end)


def _streams(file: RawFile, place: int) -> tuple[int, list[tuple[int, int]]]:
    """Return the bytes of the list of streams, and the plain and packed size of each."""
    count = unpack_fields(file, ((0, "I", "streams"),), order="<", start=place)["streams"]
    if not 1 <= count <= _MAX_STREAMS:
        raise CorruptFileError(
            file.path,
            "the number of compressed streams is not usable",
            field="streams",
            offset=place,
            expected=f"1 to {_MAX_STREAMS}",
            found=count,
        )
    need_bytes(file, place + 4, 8 * count, "the list of streams", name="streams")
    sizes = [
        unpack_fields(file, _STREAM, order="<", start=place + 4 + 8 * i) for i in range(count)
    ]
    return 4 + 8 * count, [(s["plain_bytes"], s["packed_bytes"]) for s in sizes]


def read_points(file: RawFile, item: SurfObject) -> NDArray[Any]:
    """Return the stored values of an object; a stream is inflated up to its claimed size only."""
    header = item.header
    dtype = np.dtype(_ITEMS[header["bits_per_point"]])
    shape = header["lines"], header["points_per_line"]
    count = shape[0] * shape[1]
    if header["signature"] != _COMPRESSED:
        flat = np.frombuffer(file.data, dtype=dtype, count=count, offset=item.points)
        return flat.reshape(shape)
    skip, sizes = _streams(file, item.points)
    plain = sum(size for size, _ in sizes)
    if plain != count * dtype.itemsize:
        raise CorruptFileError(
            file.path,
            "the compressed streams do not make the map",
            field="plain_bytes",
            offset=item.points + 4,
            expected=f"{count * dtype.itemsize} bytes",
            found=f"{plain} bytes",
        )
    parts, place = [], item.points + skip
    for size, packed in sizes:
        parts.append(_inflate(file, place, size, packed))
        place += packed
    return np.frombuffer(b"".join(parts), dtype=dtype).reshape(shape)


def _inflate(file: RawFile, place: int, size: int, packed: int) -> bytes:
    found: object = "a larger stream"
    if size <= _MAX_RATIO * packed:
        inflater = zlib.decompressobj()
        try:
            content = inflater.decompress(file.data[place : place + packed], size + 1)
        except zlib.error as exc:
            found = str(exc)
        else:
            if len(content) == size and inflater.eof:
                return content
            found = f"{len(content)} bytes or more"
    raise CorruptFileError(
        file.path,
        "a compressed stream is damaged",
        field="plain_bytes",
        offset=place,
        expected=f"{size} bytes",
        found=found,
    )


def field_error(
    file: RawFile, start: int, header: dict[str, Any], name: str, expected: str
) -> CorruptFileError:
    """Return the error that names a field of a header, for the caller to raise."""
    offset = start + next(o for o, _, n in FIELDS if n == name)
    found = header[name]
    reason = "the header is not usable"
    return CorruptFileError(
        file.path, reason, field=name, offset=offset, expected=expected, found=found
    )
