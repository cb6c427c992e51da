"""Zygo MetroPro ``.dat``: phase map of an interferometer, binary, big-endian.

The fields of the header are declared in ``format.toml``. Height in m
is ``raw * S * O * wavelength / R`` with the interferometric scale factor S, the obliquity factor O
and the resolution R that the field ``phase_res`` selects; raw >= 2147483640 is not measured. The
file stores the top row first; rows are turned so that row 0 has the smallest y. Layout and sources
are in ``data_formats/metropro/SPEC.md``.
"""

from __future__ import annotations

from metrosep.core.errors import UnsupportedFeatureError
from metrosep.core.surface import Surface
from metrosep.io.declared import Fields
from metrosep.io.objects import (
    Request,
    height_only,
    map_reader,
    scaled_file,
)
from metrosep.io.registry import demand, sniffer, structure
from metrosep.io.source import RawFile

channels = height_only

FORMAT = "metropro"

_HEADER_BYTES = {1: 834, 2: 834, 3: 4096}
_MAGIC = {0x881B036F: 1, 0x881B0370: 2, 0x881B0371: 3}
_RESOLUTION = {0: 4096, 1: 32768, 2: 131072}
_FIRST_INVALID = 2147483640
_WAVELENGTHS = (1e-8, 1e-3)
"""Range in m of a wavelength that an interferometer can have."""

_HEADER = structure(FORMAT)
sniff = sniffer(FORMAT)


@map_reader(FORMAT, "MetroPro", "a MetroPro map with its own units")
def read(asked: Request) -> Surface:
    """Return the height map of a MetroPro file."""
    file = asked.file
    demand(file, FORMAT)
    header = _HEADER.read(file)
    warnings = _check_sizes(file, header, asked.max_pixels)
    scale = _scale(header)
    z = scaled_file(
        file,
        header["header_size"] + header["intensity_bytes"],
        (header["phase_height"], header["phase_width"]),
        ">i4",
        -scale if header["sign"] != 0 else scale,
        lambda block: block >= _FIRST_INVALID,
        turned=True,
    )
    own = header.step("lateral_resolution", warnings)
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
    return asked.surface(
        z,
        (own, own),
        row_order="top row first",
        turned=True,
        header=header,
        warnings=warnings,
        **facts,
    )


def _check_sizes(file: RawFile, header: Fields, max_pixels: int | None) -> list[str]:
    """Refuse a header whose sizes do not add up to the file, before anything is allocated."""
    number = _MAGIC[header["magic_number"]]
    header.demand("header_format", number)
    header.demand("header_size", _HEADER_BYTES[number])
    if not (header["phase_width"] or header["phase_height"] or header["phase_bytes"]):
        raise UnsupportedFeatureError(
            f"{file.path}: the MetroPro file holds an intensity image only, no phase map; save the "
            "measurement with its phase data"
        )
    width, height = header.area("phase_width", "phase_height", max_pixels)
    header.demand("phase_bytes", 4 * width * height)
    intensity = header["intensity_bytes"]
    total = header["header_size"] + intensity + header["phase_bytes"]
    image = (
        2 * header["intensity_width"] * header["intensity_height"] * max(header["n_buckets"], 1)
    )
    if intensity < 0 or total > file.size or (total < file.size and intensity != image):
        raise file.corrupt(
            "header, intensity and phase do not add up to the file",
            field="intensity_bytes",
            offset=header.offset("intensity_bytes"),
            expected=f"{file.size} bytes",
            found=f"{total} bytes",
        )
    if total < file.size:
        return [f"{file.size - total} bytes follow the phase map; they were not read"]
    return []


def _scale(header: Fields) -> float:
    """Return the height of one count in m: S * O * wavelength / R."""
    product = (
        header.scale("interferometric_scale_factor")
        * header.scale("wavelength", *_WAVELENGTHS)
        * header.scale("obliquity_factor")
    )
    if header["phase_resolution"] not in _RESOLUTION:
        raise header.error(
            "phase_resolution", "0, 1 or 2", "the resolution of the phase is unknown"
        )
    return float(product / _RESOLUTION[header["phase_resolution"]])
