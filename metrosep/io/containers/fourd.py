"""4D Technology 4Sight ``.h5``/``.4D``: maps of an interferometer in HDF5, one or several per file.

Height in m is ``data * wavelength * wedge``: data are waves, `wedge` is 0.5 where a wave of path is
half a wave of surface. 3.4e38 (the largest float32) is not measured. The top row of the camera image
comes first: maps of one part that was turned in the instrument fit together so, and not mirrored.
Layout and sources are in ``data_formats/fourd/SPEC.md``.
"""

from __future__ import annotations

import re
from typing import Any

from metrosep.core.errors import CorruptFileError, UnitError, UnsupportedFeatureError
from metrosep.core.surface import Surface
from metrosep.core.units import parse_quantity
from metrosep.io.containers.hdf5_file import Hdf5File, look_into, open_hdf5
from metrosep.io.objects import (
    check_area,
    check_scale,
    lateral_or_none,
    make_surface,
    only_channels,
    scaled,
)
from metrosep.io.registry import Match
from metrosep.io.source import RawFile, lateral_steps, refuse_options

__all__ = ["channels", "read", "sniff"]

FORMAT = "fourd"

_DATA = re.compile(r"/(measurement(\d+))/genraw/data")
_FIRST_INVALID = 1e38
"""Above every height in waves; the marker is 3.4028235e38."""

_WAVELENGTHS = (1e-8, 1e-3)
_DEFAULT_PIXEL = 0.00903e-3
"""Pixel of the camera in m, which the software writes until someone calibrates."""

_DEFAULT_RTOL = 2e-3
"""The default is written with three to six digits."""


def sniff(file: RawFile) -> Match:
    """Return how sure we are that a file is a 4Sight file."""
    handle = look_into(file)
    return Match.YES if handle is not None and _found(handle) else Match.NO


def channels(file: RawFile) -> tuple[str, ...]:
    """Return the measurements, by number."""
    with open_hdf5(file) as handle:
        return _measurements(file, handle)


def read(
    file: RawFile,
    *,
    channel: str | None = None,
    lateral_step: Any = None,
    unit: Any = None,
    max_pixels: int | None = None,
) -> Surface:
    """Return one raw map of a 4Sight file; masks and fits of the software are not applied."""
    refuse_options(file, "a 4D map with its own units", unit=unit)
    override = lateral_steps(lateral_step)
    with open_hdf5(file) as handle:
        names = _measurements(file, handle)
        name = only_channels(file, "4D", channel, names)
        header = _header(handle, name)
        raw_attributes = header[f"/{name}/genraw"]
        data = f"/{name}/genraw/data"
        shape = handle.shape(data)
        if len(shape) != 2:
            raise CorruptFileError(
                file.path, "a map has two dimensions", field=data, expected="2", found=len(shape)
            )
        check_area(file, shape[1], shape[0], max_pixels=max_pixels)
        raw = handle.read(data, max_pixels=max_pixels)
    wavelength, wedge = _scale(file, raw_attributes)
    warnings: list[str] = []
    steps = _steps(file, raw_attributes, warnings)
    _check_count(header, names, warnings)
    return make_surface(
        file,
        FORMAT,
        scaled(raw, wavelength * wedge, lambda block: ~(abs(block) < _FIRST_INVALID)),
        steps,
        row_order="top row first",
        header=header,
        override=override,
        warnings=warnings,
        measurement=name,
        wavelength_m=wavelength,
        wedge=wedge,
        height_per_wave_m=wavelength * wedge,
        orientation_evidence="rotation",
    )


def _measurements(file: RawFile, handle: Hdf5File) -> tuple[str, ...]:
    names = _found(handle)
    if not names:
        raise CorruptFileError(
            file.path, "holds no map of 4Sight", expected="/measurement0/genraw/data"
        )
    return names


def _found(handle: Hdf5File) -> tuple[str, ...]:
    """Return the measurements that have a raw map, by number."""
    matches = (_DATA.fullmatch(d) for d in handle.datasets)
    return tuple(name for _, name in sorted((int(m[2]), m[1]) for m in matches if m))


def _header(handle: Hdf5File, name: str) -> dict[str, Any]:
    """Return the attributes of every group that belongs to the measurement, by path."""
    groups = {
        path: dict(values)
        for path, values in handle.groups.items()
        if path in ("/", "/4D") or f"{path}/".startswith(f"/{name}/")
    }
    groups.setdefault(f"/{name}/genraw", {})
    return groups


def _quantity(file: RawFile, attributes: dict[str, Any], key: str) -> float:
    """Return an attribute such as ``632.8 nm`` in m; it must carry its unit."""
    value = attributes.get(key)
    try:
        return parse_quantity(value if isinstance(value, str) else "", dimension="length")
    except UnitError:
        raise CorruptFileError(
            file.path,
            "a length has no unit",
            field=f"genraw {key}",
            expected="a number and a unit",
            found=repr(value)[:40],
        ) from None


def _scale(file: RawFile, attributes: dict[str, Any]) -> tuple[float, float]:
    """Return the wavelength in m and the wedge factor."""
    unit = str(attributes.get("height_units"))[:40]
    if unit != "wv":
        raise UnsupportedFeatureError(
            f"{file.path}: the heights are in {unit!r} (height_units), only waves ('wv') are known; "
            "export the measurement in waves"
        )
    kind = attributes.get("lut_type", "opd")
    if kind != "opd":
        raise UnsupportedFeatureError(
            f"{file.path}: the map is of type {str(kind)[:40]!r} (lut_type), only optical path differences ('opd') "
            "are known; export the measured phase"
        )
    low, high = _WAVELENGTHS
    wavelength = check_scale(
        file, "genraw wavelength", _quantity(file, attributes, "wavelength"), low=low, high=high
    )
    wedge = attributes.get("wedge")
    number = float(wedge) if isinstance(wedge, (int, float)) else float("nan")
    return wavelength, check_scale(file, "genraw wedge", number)


def _steps(
    file: RawFile, attributes: dict[str, Any], warnings: list[str]
) -> tuple[float | None, float | None]:
    """Return dx = xpix and dy = xpix * aspect, in m."""
    if "xpix" not in attributes:
        return None, None
    dx = lateral_or_none(file, "genraw xpix", _quantity(file, attributes, "xpix"), warnings)
    if dx is None:
        return None, None
    if abs(dx / _DEFAULT_PIXEL - 1.0) < _DEFAULT_RTOL:
        warnings.append(
            f"xpix is {dx * 1e3:.6g} mm, the pixel of the camera, which the software writes when "
            "nobody calibrated; pass lateral_step= if the part's pixel differs"
        )
    aspect = attributes.get("aspect", 1.0)
    number = float(aspect) if isinstance(aspect, (int, float)) else float("nan")
    check_scale(file, "genraw aspect", number)
    if number != 1.0:
        warnings.append(f"aspect is {number:g}: taken as dy / dx, which no real file confirmed")
    return dx, lateral_or_none(file, "genraw xpix * aspect", dx * number, warnings)


def _check_count(header: dict[str, Any], names: tuple[str, ...], warnings: list[str]) -> None:
    declared = header.get("/4D", {}).get("nummeas", len(names))
    if declared != len(names):
        warnings.append(f"the file declares {declared} measurements and holds {len(names)}")
