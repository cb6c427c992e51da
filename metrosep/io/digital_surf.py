"""Digital Surf ``.sur`` and ``.pro``: surfaces, profiles and series of them, plain or compressed.

Each object has a header of 512 bytes, a comment, a private zone and its points. Height in m is
``(raw - zmin) * z_spacing + z_offset``, both in the unit ``z_step_unit``; x and y have a step unit of
their own. ``zmin - 2`` is not measured. The first line is the top one; rows are turned so that row 0
has the smallest y. Layout and sources are in ``data_formats/digital-surf/SPEC.md``.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import UnitError, UnsupportedFeatureError
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.core.units import parse_unit
from metrosep.io.binary import check_area, check_scale
from metrosep.io.digital_surf_objects import (
    SIGNATURES,
    SurfObject,
    field_error,
    read_objects,
    read_points,
)
from metrosep.io.maps import lateral_or_none, make_profile, make_surface, only_channels, scaled
from metrosep.io.registry import Match
from metrosep.io.source import RawFile, lateral_steps, refuse_options

__all__ = ["channels", "read", "sniff"]

FORMAT = "digital-surf"

_MAX_OFFSET = 1e6
_PROFILES, _SURFACES = (1, 4), (2, 5, 8)
_OTHERS = {3: "a binary image", 10: "an intensity image", 12: "a colour image", 20: "a spectrum"}


def sniff(file: RawFile) -> Match:
    """Return how sure we are that a file is a Digital Surf file."""
    if file.head[:12] not in SIGNATURES:
        return Match.NO
    return Match.YES if file.head[12:14] in (b"\0\0", b"\x01\x01") else Match.MAYBE


def channels(file: RawFile) -> tuple[str, ...]:
    """Return the objects of the file."""
    return tuple(_named(read_objects(file)))


def read(
    file: RawFile,
    *,
    channel: str | None = None,
    lateral_step: Any = None,
    unit: Any = None,
    max_pixels: int | None = None,
) -> Surface | Profile:
    """Return a surface or a profile of a Digital Surf file."""
    refuse_options(file, "a Digital Surf file with its own units", unit=unit)
    override = lateral_steps(lateral_step)
    objects = read_objects(file)
    names = _named(objects)
    name = only_channels(file, "Digital Surf", channel, tuple(names))
    chosen = names[name]
    header = chosen.header
    is_profile = _check_header(file, chosen, max_pixels)
    warnings = _warnings(file, objects, header)
    facts = {"channel": name, "object_name": header["object_name"], **_scale(file, chosen)}
    z = _heights(read_points(file, chosen), header, facts, warnings)
    if is_profile:
        return _profile(file, chosen, z[0], override, warnings, facts)
    steps = _step(file, chosen, "x", warnings), _step(file, chosen, "y", warnings)
    origin = _origin(file, chosen, "x"), _origin(file, chosen, "y")
    return make_surface(
        file,
        FORMAT,
        z,
        steps,
        row_order="top row first",
        turned=True,
        header=header,
        override=override,
        origin=origin,
        warnings=warnings,
        **facts,
    )


def _named(objects: list[SurfObject]) -> dict[str, SurfObject]:
    if len(objects) == 1:
        return {"height": objects[0]}
    return {f"object {i}": item for i, item in enumerate(objects, start=1)}


def _check_header(file: RawFile, item: SurfObject, max_pixels: int | None) -> bool:
    """Refuse what is no map of heights; return whether it is a profile."""
    header, start = item.header, item.start
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
    columns, rows = header["points_per_line"], header["lines"]
    names, offsets = ("points_per_line", "lines"), (start + 108, start + 112)
    check_area(file, columns, rows, max_pixels=max_pixels, names=names, offsets=offsets)
    if header["total_points"] != columns * rows:
        raise field_error(file, start, header, "total_points", str(columns * rows))
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
    file: RawFile,
    item: SurfObject,
    z: FloatArray,
    override: tuple[float, float] | None,
    warnings: list[str],
    facts: dict[str, Any],
) -> Profile:
    own, step = _step(file, item, "x", warnings), override[0] if override else None
    dx = own or step
    if dx is None:
        raise UnitError(
            f"{file.path}: the profile is not calibrated (x_spacing {item.header['x_spacing']:g}, "
            f"x_step_unit {item.header['x_step_unit']!r}); declare its step with lateral_step="
        )
    x = _origin(file, item, "x") + dx * np.arange(z.size, dtype=np.float64)
    header = item.header
    return make_profile(
        file, FORMAT, x, z, header=header, override=step, warnings=warnings, **facts
    )


def _scale(file: RawFile, item: SurfObject) -> dict[str, float]:
    """Return the height of one count and that of zmin, in m."""
    header = item.header
    factor = _factor(header["z_step_unit"])
    if factor is None:
        raise UnitError(
            f"{file.path}: z_step_unit is {header['z_step_unit']!r}, no unit of length: the object "
            f"holds {header['z_axis']!r}, not heights; choose another channel or export heights"
        )
    name, offset = "z_spacing", item.start + 128
    spacing = check_scale(file, name, header[name], offset=offset, low=1e-24, high=1e6)
    if not abs(header["z_offset"]) < _MAX_OFFSET:
        raise field_error(file, item.start, header, "z_offset", f"less than {_MAX_OFFSET:g}")
    return {"height_per_count_m": spacing * factor, "height_offset_m": header["z_offset"] * factor}


def _factor(unit: str) -> float | None:
    """Return metres per unit, None if it is no length; old files have the micro sign of DOS."""
    try:
        return parse_unit(unit.replace("\xe6", "u"), dimension="length").factor
    except UnitError:
        return None


def _step(file: RawFile, item: SurfObject, axis: str, warnings: list[str]) -> float | None:
    name, unit = f"{axis}_spacing", item.header[f"{axis}_step_unit"]
    factor = _factor(unit)
    if factor is None:
        warnings.append(f"{axis}_step_unit is {unit!r}, no length: taken as not calibrated")
        return None
    offset = item.start + (120 if axis == "x" else 124)
    value = item.header[name]
    return lateral_or_none(file, name, value, warnings, offset=offset, factor=factor)


def _origin(file: RawFile, item: SurfObject, axis: str) -> float:
    name = f"{axis}_offset"
    value = item.header[name] * (_factor(item.header[f"{axis}_step_unit"]) or 0.0)
    if not math.isfinite(value) or abs(value) > _MAX_OFFSET:
        raise field_error(file, item.start, item.header, name, f"up to {_MAX_OFFSET:g} m")
    return float(value)
