"""Zygo MetroPro ``.dat``: phase map of an interferometer, binary, big-endian.

The header is data: `FIELDS` lists offset, type and name of every field that is read. Height in m
is ``raw * S * O * wavelength / R`` with the interferometric scale factor S, the obliquity factor O
and the resolution R that the field ``phase_res`` selects; raw >= 2147483640 is not measured. The
file stores the top row first; rows are turned so that row 0 has the smallest y. Layout and sources
are in ``data_formats/metropro/SPEC.md``.
"""

from __future__ import annotations

import struct
from typing import Any

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, FormatMismatchError, UnsupportedFeatureError
from metrosep.core.surface import Surface
from metrosep.io.objects import (
    check_area,
    check_scale,
    height_only as channels,
    lateral_or_none,
    make_surface,
    only_channels,
    scaled_file,
    unpack_fields,
)
from metrosep.io.registry import Match
from metrosep.io.source import RawFile, lateral_steps, refuse_options

__all__ = ["FIELDS", "channels", "read", "sniff"]

FORMAT = "metropro"

_HEADER_BYTES = {1: 834, 2: 834, 3: 4096}
_MAGIC = {0x881B036F: 1, 0x881B0370: 2, 0x881B0371: 3}
_RESOLUTION = {0: 4096, 1: 32768, 2: 131072}
_FIRST_INVALID = 2147483640
_WAVELENGTHS = (1e-8, 1e-3)
"""Range in m of a wavelength that an interferometer can have."""

FIELDS: tuple[tuple[int, str, str], ...] = (
    (0, "I", "magic_number"),
    (4, "h", "header_format"),
    (6, "i", "header_size"),
    (10, "h", "software_type"),
    (12, "30s", "software_date"),
    (42, "h", "version_major"),
    (44, "h", "version_minor"),
    (46, "h", "version_bug"),
    (48, "h", "intensity_origin_x"),
    (50, "h", "intensity_origin_y"),
    (52, "h", "intensity_width"),
    (54, "h", "intensity_height"),
    (56, "h", "n_buckets"),
    (58, "h", "intensity_range"),
    (60, "i", "intensity_bytes"),
    (64, "h", "phase_origin_x"),
    (66, "h", "phase_origin_y"),
    (68, "h", "phase_width"),
    (70, "h", "phase_height"),
    (72, "i", "phase_bytes"),
    (76, "i", "time_stamp"),
    (80, "82s", "comment"),
    (162, "h", "source"),
    (164, "f", "interferometric_scale_factor"),
    (168, "f", "wavelength"),
    (172, "f", "numerical_aperture"),
    (176, "f", "obliquity_factor"),
    (180, "f", "magnification"),
    (184, "f", "lateral_resolution"),
    (188, "h", "acquisition_type"),
    (190, "h", "intensity_average_count"),
    (192, "h", "ramp_calibration"),
    (194, "h", "scale_factor_limit"),
    (196, "h", "ramp_gain"),
    (198, "f", "part_thickness"),
    (202, "h", "software_llc"),
    (204, "f", "target_range"),
    (208, "h", "radius_sequence"),
    (210, "i", "minimum_modulation"),
    (214, "i", "minimum_modulation_count"),
    (218, "h", "phase_resolution"),
    (220, "i", "minimum_area"),
    (224, "h", "discontinuity_action"),
    (226, "f", "discontinuity_filter"),
    (230, "h", "connection_order"),
    (232, "h", "sign"),
    (234, "h", "camera_width"),
    (236, "h", "camera_height"),
    (238, "h", "system_type"),
    (240, "h", "system_board"),
    (242, "H", "system_serial"),
    (244, "h", "instrument_id"),
    (246, "12s", "objective"),
    (258, "40s", "part_number"),
    (298, "h", "code_v_type"),
    (300, "h", "phase_average_count"),
    (302, "h", "subtract_system_error"),
    (304, "40s", "part_serial"),
)
"""Offset in bytes, `struct` code (big-endian) and name of each header field."""


def sniff(file: RawFile) -> Match:
    """Return how sure we are that a file is a MetroPro file."""
    if len(file.head) < 6:
        return Match.NO
    magic, header_format = struct.unpack_from(">Ih", file.head)
    if magic not in _MAGIC:
        return Match.NO
    return Match.YES if _MAGIC[magic] == header_format else Match.MAYBE


def read(
    file: RawFile,
    *,
    channel: str | None = None,
    lateral_step: Any = None,
    unit: Any = None,
    max_pixels: int | None = None,
) -> Surface:
    """Return the height map of a MetroPro file."""
    refuse_options(file, "a MetroPro map with its own units", unit=unit)
    only_channels(file, "MetroPro", channel)
    override = lateral_steps(lateral_step)
    header = _header(file)
    warnings = _check_sizes(file, header, max_pixels)
    scale = _scale(file, header)
    z = _heights(file, header, scale)
    own = lateral_or_none(
        file, "lateral_resolution", header["lateral_resolution"], warnings, offset=184
    )
    facts = {
        "wavelength_m": header["wavelength"],
        "interferometric_scale_factor": header["interferometric_scale_factor"],
        "obliquity_factor": header["obliquity_factor"],
        "phase_resolution": header["phase_resolution"],
        "sign": header["sign"],
        "height_per_count_m": scale,
        "window_origin_px": (header["phase_origin_x"], header["phase_origin_y"]),
        "window_px": (header["phase_width"], header["phase_height"]),
        "camera_px": (header["camera_width"], header["camera_height"]),
        "unix_time_s": header["time_stamp"],
    }
    return make_surface(
        file,
        FORMAT,
        z,
        (own, own),
        row_order="top row first",
        turned=True,
        header=header,
        override=override,
        warnings=warnings,
        **facts,
    )


def _header(file: RawFile) -> dict[str, Any]:
    if sniff(file) is Match.NO:
        raise FormatMismatchError(
            f"{file.path}: is not a MetroPro file: expected 88 1b 03 6f (or 70, 71) at offset 0, "
            f"found {file.head[:4].hex(' ')}; leave out format= to have it recognised"
        )
    return unpack_fields(file, FIELDS, order=">")


def _check_sizes(file: RawFile, header: dict[str, Any], max_pixels: int | None) -> list[str]:
    """Refuse a header whose sizes do not add up to the file, before anything is allocated."""
    number = _MAGIC[header["magic_number"]]
    _demand(file, header, "header_format", 4, number)
    _demand(file, header, "header_size", 6, _HEADER_BYTES[number])
    width, height = header["phase_width"], header["phase_height"]
    if width == 0 and height == 0 and header["phase_bytes"] == 0:
        raise UnsupportedFeatureError(
            f"{file.path}: the MetroPro file holds an intensity image only, no phase map; save the "
            "measurement with its phase data"
        )
    check_area(
        file,
        width,
        height,
        max_pixels=max_pixels,
        names=("phase_width", "phase_height"),
        offsets=(68, 70),
    )
    _demand(file, header, "phase_bytes", 72, 4 * width * height)
    intensity = header["intensity_bytes"]
    total = header["header_size"] + intensity + header["phase_bytes"]
    image = (
        2 * header["intensity_width"] * header["intensity_height"] * max(header["n_buckets"], 1)
    )
    if intensity < 0 or total > file.size or (total < file.size and intensity != image):
        raise CorruptFileError(
            file.path,
            "header, intensity and phase do not add up to the file",
            field="intensity_bytes",
            offset=60,
            expected=f"{file.size} bytes",
            found=f"{total} bytes",
        )
    if total < file.size:
        return [f"{file.size - total} bytes follow the phase map; they were not read"]
    return []


def _demand(file: RawFile, header: dict[str, Any], name: str, offset: int, expected: int) -> None:
    if header[name] != expected:
        raise CorruptFileError(
            file.path,
            "the header contradicts itself",
            field=name,
            offset=offset,
            expected=expected,
            found=header[name],
        )


def _scale(file: RawFile, header: dict[str, Any]) -> float:
    """Return the height of one count in m: S * O * wavelength / R."""
    ranges = {
        "interferometric_scale_factor": (164, 1e-3, 1e3),
        "wavelength": (168, *_WAVELENGTHS),
        "obliquity_factor": (176, 1e-3, 1e3),
    }
    product = 1.0
    for name, (offset, low, high) in ranges.items():
        product *= check_scale(file, name, header[name], offset=offset, low=low, high=high)
    if header["phase_resolution"] not in _RESOLUTION:
        raise CorruptFileError(
            file.path,
            "the resolution of the phase is unknown",
            field="phase_resolution",
            offset=218,
            expected="0, 1 or 2",
            found=header["phase_resolution"],
        )
    return float(product / _RESOLUTION[header["phase_resolution"]])


def _heights(file: RawFile, header: dict[str, Any], scale: float) -> FloatArray:
    """Return the heights with the lowest row first."""
    width, height = header["phase_width"], header["phase_height"]
    start = header["header_size"] + header["intensity_bytes"]
    signed = -scale if header["sign"] != 0 else scale
    return scaled_file(
        file,
        start,
        (height, width),
        ">i4",
        signed,
        lambda block: block >= _FIRST_INVALID,
        turned=True,
    )
