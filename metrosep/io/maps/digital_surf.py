"""Digital Surf ``.sur`` and ``.pro``: surfaces, profiles and series of them, plain or compressed.

Each object has a header of 512 bytes, a comment, a private zone and its points. Height in m is
``(raw - zmin) * z_spacing + z_offset``, both in the unit ``z_step_unit``; x and y have a step unit of
their own. ``zmin - 2`` is not measured. The first line is the top one; rows are turned so that row 0
has the smallest y. Layout and sources are in ``data_formats/digital-surf/SPEC.md``.
"""

from __future__ import annotations

import math
import zlib
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    UnitError,
    UnsupportedFeatureError,
    WriteError,
)
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.core.units import parse_unit
from metrosep.io.declared import Fields, Structure, need_bytes
from metrosep.io.objects import (
    Request,
    map_reader,
    rows_to_write,
    scaled,
)
from metrosep.io.registry import demand, sniffer, structure
from metrosep.io.source import RawFile

FORMAT = "digital-surf"

_MAX_OFFSET = 1e6
_PROFILES, _SURFACES = (1, 4), (2, 5, 8)
_OTHERS = {3: "a binary image", 10: "an intensity image", 12: "a colour image", 20: "a spectrum"}


sniff = sniffer(FORMAT)


def channels(file: RawFile) -> tuple[str, ...]:
    """Return the objects of the file."""
    return tuple(_named(read_objects(file)))


@map_reader(FORMAT, "Digital Surf", "a Digital Surf file with its own units", several=True)
def read(asked: Request) -> Surface | Profile:
    """Return a surface or a profile of a Digital Surf file."""
    file = asked.file
    objects = read_objects(file)
    names = _named(objects)
    name = asked.choose(names)
    chosen = names[name]
    header = chosen.header
    is_profile = _check_header(file, chosen, asked.max_pixels)
    warnings = _warnings(file, objects, header)
    facts = {"channel": name, "object_name": header["object_name"], **_scale(file, chosen)}
    z = _heights(read_points(file, chosen), header, facts, warnings)
    if is_profile:
        return _profile(asked, chosen, z[0], warnings, facts)
    steps = _step(chosen, "x", warnings), _step(chosen, "y", warnings)
    origin = _origin(chosen, "x"), _origin(chosen, "y")
    return asked.surface(
        z,
        steps,
        row_order="top row first",
        turned=True,
        header=header,
        origin=origin,
        warnings=warnings,
        **facts,
    )


def _named(objects: list[SurfObject]) -> dict[str, SurfObject]:
    if len(objects) == 1:
        return {"height": objects[0]}
    return {f"object {i}": item for i, item in enumerate(objects, start=1)}


def _check_header(file: RawFile, item: SurfObject, max_pixels: int | None) -> bool:
    """Refuse what is not a map of heights; return whether it is a profile."""
    header = item.header
    kind = header["object_type"]
    if kind not in (*_PROFILES, *_SURFACES):
        raise UnsupportedFeatureError(
            f"{file.path}: holds {_OTHERS.get(kind, 'no heights')} (object_type {kind}); only "
            "profiles, surfaces and series of them are read: export it as a surface"
        )
    if header["format"] != 0 or header["w_size"] > 1:
        name = "format" if header["format"] else "w_size"
        raise UnsupportedFeatureError(
            f"{file.path}: {name} is {header[name]}: big-endian files and spectra are not read; save "
            "the surface again with the present program"
        )
    columns, rows = header.area("points_per_line", "lines", max_pixels)
    if header["total_points"] != columns * rows:
        raise header.error("total_points", str(columns * rows))
    return kind in _PROFILES and rows == 1


def _warnings(file: RawFile, objects: list[SurfObject], header: dict[str, Any]) -> list[str]:
    warnings = []
    left = file.size - objects[-1].end
    if left:
        warnings.append(f"{left} bytes follow the last object; they were not read")
    if header["inverted"] != 0:
        warnings.append(
            f"inverted is {header['inverted']}: heights are given as stored; other programs negate "
            "them, so check the sign on a known feature"
        )
    if header["object_type"] in _PROFILES and header["lines"] != 1:
        warnings.append(
            f"object_type says profile, but there are {header['lines']} lines: surface"
        )
    return warnings


def _heights(
    raw: NDArray[Any], header: dict[str, Any], facts: dict[str, Any], warnings: list[str]
) -> FloatArray:
    """Return heights in m with the lowest row first, NaN for zmin - 2."""
    low, high = header["zmin"], header["zmax"]
    special, void = header["special_points"] != 0, low - 2
    outside = np.count_nonzero((raw < low) | (raw > high))
    if special:
        outside -= np.count_nonzero(raw == void)
    if outside > 0:
        warnings.append(f"{outside} values are outside of zmin to zmax: saturated, perhaps")
    scale = facts["height_per_count_m"]
    offset = facts["height_offset_m"] - low * scale
    return scaled(raw, scale, (lambda b: b == void) if special else None, offset, turned=True)


def _profile(
    asked: Request, item: SurfObject, z: FloatArray, warnings: list[str], facts: dict[str, Any]
) -> Profile:
    file = asked.file
    dx = _step(item, "x", warnings) or asked.step
    if dx is None:
        raise UnitError(
            f"{file.path}: the profile is not calibrated (x_spacing {item.header['x_spacing']:g}, "
            f"x_step_unit {item.header['x_step_unit']!r}); declare its step with lateral_step="
        )
    x = _origin(item, "x") + dx * np.arange(z.size, dtype=np.float64)
    return asked.profile(x, z, header=item.header, warnings=warnings, **facts)


def _scale(file: RawFile, item: SurfObject) -> dict[str, float]:
    """Return the height of one count and that of zmin, in m."""
    header = item.header
    factor = _factor(header["z_step_unit"])
    if factor is None:
        raise UnitError(
            f"{file.path}: z_step_unit is {header['z_step_unit']!r}, no unit of length: the object "
            f"holds {header['z_axis']!r}, not heights; choose another channel or export heights"
        )
    spacing = header.scale("z_spacing", low=1e-24, high=1e6)
    if not abs(header["z_offset"]) < _MAX_OFFSET:
        raise header.error("z_offset", f"less than {_MAX_OFFSET:g}")
    return {"height_per_count_m": spacing * factor, "height_offset_m": header["z_offset"] * factor}


def _factor(unit: str) -> float | None:
    """Return metres per unit, None if it is not a length; old files have the micro sign of DOS."""
    try:
        return parse_unit(unit.replace("\xe6", "u"), dimension="length").factor
    except UnitError:
        return None


def _step(item: SurfObject, axis: str, warnings: list[str]) -> float | None:
    name, unit = f"{axis}_spacing", item.header[f"{axis}_step_unit"]
    factor = _factor(unit)
    if factor is None:
        warnings.append(f"{axis}_step_unit is {unit!r}, no length: taken as not calibrated")
        return None
    return item.header.step(name, warnings, factor)


def _origin(item: SurfObject, axis: str) -> float:
    name = f"{axis}_offset"
    value = item.header[name] * (_factor(item.header[f"{axis}_step_unit"]) or 0.0)
    if not math.isfinite(value) or abs(value) > _MAX_OFFSET:
        raise item.header.error(name, f"up to {_MAX_OFFSET:g} m")
    return float(value)


# ---- the objects inside a Digital Surf file: header, comment, private zone and points, plain or zlib ----
# An object begins where the one before ends. Nothing is allocated or inflated before the sizes that
# the headers claim have been compared with the bytes that there are; see
# ``data_formats/digital-surf/SPEC.md``.

_HEADER, _STREAM = structure(FORMAT, "header"), structure(FORMAT, "stream")

SIGNATURES = (b"DIGITAL SURF", b"DSCOMPRESSED")
"""First bytes of an object with plain and with compressed points."""

_HEADER_BYTES = 512
_COMPRESSED = "DSCOMPRESSED"
_COUNT = Structure("<", "0 I streams")
_ITEMS = {16: "<i2", 32: "<i4"}
_MAX_OBJECTS = 65535
_MAX_STREAMS = 4096
_MAX_RATIO = 1040
"""A deflate stream grows by 1032 at most."""


class SurfObject(NamedTuple):
    """Where an object lies in the file, and what its header says."""

    header: Fields  # every header field, and the comment
    start: int  # offset of the header
    points: int  # offset of the points, or of the list of compressed streams
    end: int  # offset of the first byte after the object


def read_objects(file: RawFile) -> list[SurfObject]:
    """Return the objects of the file in order; each begins where the one before ends."""
    demand(file, FORMAT)
    objects = [_object(file, 0)]
    while len(objects) < _MAX_OBJECTS:
        end = objects[-1].end
        if file.data[end : end + 12] not in SIGNATURES:
            break
        objects.append(_object(file, end))
    claimed = max(objects[0].header["n_objects"], 1)
    if len(objects) < claimed:
        raise file.corrupt(
            "an object is missing",
            field="n_objects",
            offset=14,
            expected=claimed,
            found=len(objects),
        )
    return objects


def _object(file: RawFile, start: int) -> SurfObject:
    """Return the object at an offset; all of its parts lie in the file."""
    header = _HEADER.read(file, start)
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
        raise header.error(name, "at least 1" if bits in _ITEMS else "16 or 32")
    if header["signature"] == _COMPRESSED:
        skip, sizes = _streams(file, place)
        end = place + skip + sum(packed for _, packed in sizes)
    else:
        end = place + points * bits // 8 * max(header["w_size"], 1)
    need_bytes(file, place, end - place, "the map", name="total_points")
    return SurfObject(header, start, place, end)


def _streams(file: RawFile, place: int) -> tuple[int, list[tuple[int, int]]]:
    """Return the bytes of the list of streams, and the plain and packed size of each."""
    head = _COUNT.read(file, place)
    count = head["streams"]
    if not 1 <= count <= _MAX_STREAMS:
        reason = "the number of compressed streams is not usable"
        raise head.error("streams", f"1 to {_MAX_STREAMS}", reason)
    need_bytes(file, place + 4, 8 * count, "the list of streams", name="streams")
    sizes = [_STREAM.read(file, place + 4 + 8 * i) for i in range(count)]
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
        raise file.corrupt(
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
    raise file.corrupt(
        "a compressed stream is damaged",
        field="plain_bytes",
        offset=place,
        expected=f"{size} bytes",
        found=found,
    )


# ---- bytes of a Digital Surf surface or profile (32 bit, not compressed); the same surface, the same bytes ----
# Heights are rounded to steps of about P-V / 2^31, counted from zmin = 0, so that programs which
# subtract zmin and programs which do not agree. Spacings and offsets are single precision by the
# format: the spacing of the heights is chosen as a single-precision number before the counts are
# made and adds no error of scale; lateral steps are rounded to 6e-8 of themselves. All units are mm.

_MM = 1e-3
_MAX_COUNT = 2**31 - 1
_NOT_MEASURED = -2
_PROFILE, _SURFACE, _BITS = 1, 2, 32
_FINEST = 1e-21
"""Smallest step of the heights in mm; finer than any height means something."""

_LARGEST = 1e9
"""Largest height, offset or step in mm that is written."""


def sur_bytes(surface: Surface | Profile) -> bytes:
    """Return a surface, or a profile, as the content of a Digital Surf file."""
    z, *steps, origin = rows_to_write(surface, "SUR" if isinstance(surface, Surface) else "PRO")
    valid = ~np.isnan(z)
    low, high = (float(f(z)) / _MM for f in (np.nanmin, np.nanmax))
    values = (low, high, *(s / _MM for s in steps), *(o / _MM for o in origin))
    if max(abs(v) for v in values) > _LARGEST:
        raise WriteError(f"SUR is written up to {_LARGEST * _MM:g} m, got {max(values) * _MM:g} m")
    offset, step = _grid_of_heights(low, high)
    counts = np.full(z.shape, _NOT_MEASURED, dtype="<i4")
    heights = z[valid] / _MM
    counts[valid] = np.rint((heights - offset) / step).clip(0, _MAX_COUNT).astype("<i4")
    comment = f"metrosep: heights rounded to steps of {step!r} mm\r\n".encode("latin-1")
    rows, columns = z.shape
    fields = {
        "signature": "DIGITAL SURF",
        "n_objects": 1,
        "version": 1,
        "object_type": _SURFACE if isinstance(surface, Surface) else _PROFILE,
        "object_name": "",
        "operator_name": "metrosep",
        "special_points": int(not valid.all()),
        "absolute": 1,
        "bits_per_point": _BITS,
        "zmax": int(counts.max()),
        "points_per_line": columns,
        "lines": rows,
        "total_points": columns * rows,
        **{f"{axis}_spacing": value / _MM for axis, value in zip("xy", steps, strict=True)},
        **{f"{axis}_offset": o / _MM for axis, o in zip("xy", origin, strict=True)},
        "z_spacing": step,
        "z_offset": offset,
        **{f"{axis}_axis": axis.upper() for axis in "xyzt"},
        **{f"{axis}_{kind}_unit": "mm" for axis in "xyz" for kind in ("step", "length")},
        **{f"{axis}_unit_ratio": 1.0 for axis in "xyz"},
        "comment_bytes": len(comment),
        "t_step_unit": "s",
    }  # date and time are left at zero
    return _HEADER.pack(fields, _HEADER_BYTES) + comment + counts[::-1].tobytes()


def _grid_of_heights(low: float, high: float) -> tuple[float, float]:
    """Return height of count 0 and height of a count in mm, both exact in single precision."""
    offset = np.float32(low)
    if float(offset) > low:
        offset = np.nextafter(offset, np.float32(-math.inf))
    step = np.float32(max((high - float(offset)) / _MAX_COUNT, _FINEST))
    if float(step) * _MAX_COUNT < high - float(offset):
        step = np.nextafter(step, np.float32(math.inf))
    return float(offset), float(step)
