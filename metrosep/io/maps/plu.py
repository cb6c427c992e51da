"""Sensofar PLu ``.plu``: float maps or a profile in um behind a header of 500 bytes, little-endian.

Each layer repeats its number of rows and columns before the heights; a reader that starts at these
eight bytes shifts the whole map by two points. 1000001 is not measured. The file stores the top row
first; rows are turned so that row 0 has the smallest y. Layout and sources are in
``data_formats/plu/SPEC.md``.
"""

from __future__ import annotations

import re
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from metrosep.core.errors import FormatMismatchError, UnitError, UnsupportedFeatureError
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.io.objects import (
    check_area,
    lateral_or_none,
    make_profile,
    make_surface,
    need_bytes,
    only_channels,
    scaled,
    unpack_fields,
)
from metrosep.io.registry import Match
from metrosep.io.source import RawFile, lateral_steps, refuse_options

__all__ = ["FIELDS", "LAYER", "channels", "read", "sniff"]

FORMAT = "plu"

FIELDS: tuple[tuple[int, str, str], ...] = (
    (0, "128s", "date"),
    (128, "I", "unix_time"),
    (132, "256s", "comment"),
    (388, "I", "calibration_rows"),
    (392, "I", "calibration_columns"),
    (396, "I", "n_tall"),
    (400, "f", "dy_multip"),
    (404, "f", "um_per_pixel_x"),
    (408, "f", "um_per_pixel_y"),
    (412, "f", "x_0_um"),
    (416, "f", "y_0_um"),
    (420, "f", "um_per_pixel_tall"),
    (424, "f", "z_0_um"),
    (428, "I", "type"),
    (432, "I", "algorithm"),
    (436, "I", "method"),
    (440, "I", "objective"),
    (444, "I", "area"),
    (448, "I", "area_rows"),
    (452, "I", "area_columns"),
    (456, "I", "rows"),
    (460, "I", "columns"),
    (464, "I", "na"),
    (468, "d", "z_increment"),
    (476, "f", "range"),
    (480, "I", "n_planes"),
    (484, "I", "threshold"),
    (488, "B", "restore"),
    (489, "B", "n_layers"),
    (490, "B", "version"),
    (491, "B", "hardware"),
    (492, "B", "n_images"),
    (496, "I", "decimation"),
)
"""Offset in bytes, `struct` code (little-endian) and name of each header field."""

LAYER: tuple[tuple[int, str, str], ...] = ((0, "I", "layer_rows"), (4, "I", "layer_columns"))
"""Fields before the heights of a layer."""

_HEADER_BYTES = 500
_LAYER_BYTES = 8
_LIMIT_BYTES = 8
_LIMITS: tuple[tuple[int, str, str], ...] = ((0, "f", "minimum_um"), (4, "f", "maximum_um"))
_UM = 1e-6
_NOT_MEASURED = 1000001.0
_PROFILE, _TOPOGRAPHY = 1, 3
_TYPES = {
    0: "an image",
    2: "several profiles",
    4: "coordinates",
    5: "a thickness",
    6: "custom data",
}
_DATE = re.compile(
    rb"(?:Mon|Tue|Wed|Thu|Fri|Sat|Sun) "
    rb"(?:Jan|Feb|Mar|Apr|May|Jun|Jul|Aug|Sep|Oct|Nov|Dec) [ 0-3]\d "
    rb"\d\d:\d\d:\d\d \d{4}\s?\0"
)


class _Layer(NamedTuple):
    """Rows and columns of a layer, and where its heights begin."""

    rows: int
    columns: int
    start: int


def sniff(file: RawFile) -> Match:
    """Return how sure we are that a file is a PLu file; the format has no magic number."""
    if not _DATE.match(file.head) or len(file.head) < _HEADER_BYTES + _LAYER_BYTES:
        return Match.NO
    kind = int.from_bytes(file.head[428:432], "little")
    return Match.YES if kind in (_PROFILE, _TOPOGRAPHY, *_TYPES) else Match.MAYBE


def channels(file: RawFile) -> tuple[str, ...]:
    """Return the layers of the file."""
    return tuple(_layers(file, _header(file)))


def read(
    file: RawFile,
    *,
    channel: str | None = None,
    lateral_step: Any = None,
    unit: Any = None,
    max_pixels: int | None = None,
) -> Surface | Profile:
    """Return the height map or the profile of a PLu file."""
    refuse_options(file, "a PLu file with its own units", unit=unit)
    override = lateral_steps(lateral_step)
    header = _header(file)
    layers = _layers(file, header, max_pixels)
    name = only_channels(file, "PLu", channel, tuple(layers))
    layer = layers[name]
    z = scaled(_raw(file, layer), _UM, lambda block: block == _NOT_MEASURED, turned=True)
    facts = {
        "channel": name,
        "height_per_count_m": _UM,
        "position_m": tuple(header[f"{axis}_0_um"] * _UM for axis in "xyz"),
        "unix_time_s": header["unix_time"],
    }
    header |= unpack_fields(file, LAYER, order="<", start=layer.start - _LAYER_BYTES)
    if layer.start + 4 * z.size + _LIMIT_BYTES <= file.size:
        header |= unpack_fields(file, _LIMITS, order="<", start=layer.start + 4 * z.size)
    warnings: list[str] = []
    claimed = header["calibration_rows"], header["calibration_columns"]
    if (layer.rows, layer.columns) != claimed:
        warnings.append(
            f"the layer has {layer.rows} x {layer.columns} points, but the header says "
            f"{claimed[0]} x {claimed[1]} (rows x columns): check that the map is not sheared"
        )
    dx = _step(file, header, "x", 404, warnings)
    if header["type"] == _PROFILE:
        step = override[0] if override else None
        if dx is None and step is None:
            raise UnitError(
                f"{file.path}: um_per_pixel_x of the profile is {header['um_per_pixel_x']}, so it is "
                "not calibrated; declare its step with lateral_step="
            )
        x = (dx or step or 0.0) * np.arange(z.size, dtype=np.float64)
        return make_profile(
            file, FORMAT, x, z[0], header=header, override=step, warnings=warnings, **facts
        )
    dy = _step(file, header, "y", 408, warnings)
    return make_surface(
        file,
        FORMAT,
        z,
        (dx, dy),
        row_order="top row first",
        turned=True,
        header=header,
        override=override,
        warnings=warnings,
        **facts,
    )


def _header(file: RawFile) -> dict[str, Any]:
    if not _DATE.match(file.head):
        raise FormatMismatchError(
            f"{file.path}: is not a PLu file: expected a date such as 'Fri Mar 10 16:35:59 2023' at "
            f"offset 0, found {file.head[:24]!r}; leave out format= to have it recognised"
        )
    header = unpack_fields(file, FIELDS, order="<")
    if header["type"] not in (_PROFILE, _TOPOGRAPHY):
        what = _TYPES.get(header["type"], "something unknown")
        raise UnsupportedFeatureError(
            f"{file.path}: holds {what} (type {header['type']}); only a topography (3) or a profile "
            "(1) is read: save the measurement as one of them"
        )
    return header


def _layers(
    file: RawFile, header: dict[str, Any], max_pixels: int | None = None
) -> dict[str, _Layer]:
    """Return the layers by name; every one lies in the file."""
    found, place = [], _HEADER_BYTES
    for _ in range(max(header["n_layers"], 1)):
        size = unpack_fields(file, LAYER, order="<", start=place, what="a layer")
        rows, columns = size["layer_rows"], size["layer_columns"]
        names, offsets = ("layer_columns", "layer_rows"), (place + 4, place)
        check_area(file, columns, rows, max_pixels=max_pixels, names=names, offsets=offsets)
        if header["type"] == _PROFILE and rows != 1:
            raise UnsupportedFeatureError(
                f"{file.path}: the profile has {rows} rows (layer_rows at offset {place}); only one "
                "is read: save the profiles one by one"
            )
        start = place + _LAYER_BYTES
        count = rows * columns
        need_bytes(file, start, 4 * count, "a layer", name="layer_rows, layer_columns")
        place = start + 4 * count + _LIMIT_BYTES + 3 * count * header["n_images"]
        found.append(_Layer(rows, columns, start))
    if len(found) == 1:
        return {"height": found[0]}
    return {f"layer {i}": layer for i, layer in enumerate(found, start=1)}


def _raw(file: RawFile, layer: _Layer) -> NDArray[Any]:
    count = layer.rows * layer.columns
    flat = np.frombuffer(file.data, dtype="<f4", count=count, offset=layer.start)
    return flat.reshape(layer.rows, layer.columns)


def _step(
    file: RawFile, header: dict[str, Any], axis: str, offset: int, warnings: list[str]
) -> float | None:
    name = f"um_per_pixel_{axis}"
    return lateral_or_none(file, name, header[name], warnings, offset=offset, factor=_UM)
