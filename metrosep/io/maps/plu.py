"""Sensofar PLu ``.plu``: float maps or a profile in um behind a header of 500 bytes, little-endian.

Each layer repeats its number of rows and columns before the heights; a reader that starts at these
eight bytes shifts the whole map by two points. 1000001 is not measured. The file stores the top row
first; rows are turned so that row 0 has the smallest y. Layout and sources are in
``data_formats/plu/SPEC.md``.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from metrosep.core.errors import UnitError, UnsupportedFeatureError
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.io.declared import Fields, demand, need_bytes, sniffer, structure
from metrosep.io.objects import (
    Request,
    map_reader,
    scaled,
)
from metrosep.io.source import RawFile

__all__ = ["channels", "read", "sniff"]

FORMAT = "plu"

_HEADER, _LAYER, _LIMITS = (structure(FORMAT, n) for n in ("header", "layer", "limits"))
_HEADER_BYTES = 500
_LAYER_BYTES = 8
_LIMIT_BYTES = 8
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


sniff = sniffer(FORMAT)


class _Place(NamedTuple):
    """Rows and columns of a layer, and where its heights begin."""

    rows: int
    columns: int
    start: int


def channels(file: RawFile) -> tuple[str, ...]:
    """Return the layers of the file."""
    return tuple(_layers(file, _header(file)))


@map_reader(FORMAT, "PLu", "a PLu file with its own units", several=True)
def read(asked: Request) -> Surface | Profile:
    """Return the height map or the profile of a PLu file."""
    file = asked.file
    header = _header(file)
    layers = _layers(file, header, asked.max_pixels)
    name = asked.choose(layers)
    layer = layers[name]
    z = scaled(_raw(file, layer), _UM, lambda block: block == _NOT_MEASURED, turned=True)
    facts = {
        "channel": name,
        "height_per_count_m": _UM,
        "position_m": tuple(header[f"{axis}_0_um"] * _UM for axis in "xyz"),
        "unix_time_s": header["unix_time"],
    }
    header.update(_LAYER.read(file, layer.start - _LAYER_BYTES))
    if layer.start + 4 * z.size + _LIMIT_BYTES <= file.size:
        header.update(_LIMITS.read(file, layer.start + 4 * z.size))
    warnings = asked.warnings
    claimed = header["calibration_rows"], header["calibration_columns"]
    if (layer.rows, layer.columns) != claimed:
        warnings.append(
            f"the layer has {layer.rows} x {layer.columns} points, but the header says "
            f"{claimed[0]} x {claimed[1]} (rows x columns): check that the map is not sheared"
        )
    dx = header.step("um_per_pixel_x", warnings)
    if header["type"] == _PROFILE:
        step = asked.step
        if dx is None and step is None:
            raise UnitError(
                f"{file.path}: um_per_pixel_x of the profile is {header['um_per_pixel_x']}, so it is "
                "not calibrated; declare its step with lateral_step="
            )
        x = (dx or step or 0.0) * np.arange(z.size, dtype=np.float64)
        return asked.profile(x, z[0], header=header, **facts)
    dy = header.step("um_per_pixel_y", warnings)
    return asked.surface(
        z,
        (dx, dy),
        row_order="top row first",
        turned=True,
        header=header,
        **facts,
    )


def _header(file: RawFile) -> Fields:
    demand(file, FORMAT)
    header = _HEADER.read(file)
    if header["type"] not in (_PROFILE, _TOPOGRAPHY):
        what = _TYPES.get(header["type"], "something unknown")
        raise UnsupportedFeatureError(
            f"{file.path}: holds {what} (type {header['type']}); only a topography (3) or a profile "
            "(1) is read: save the measurement as one of them"
        )
    return header


def _layers(
    file: RawFile, header: dict[str, Any], max_pixels: int | None = None
) -> dict[str, _Place]:
    """Return the layers by name; every one lies in the file."""
    found, place = [], _HEADER_BYTES
    for _ in range(max(header["n_layers"], 1)):
        columns, rows = _LAYER.read(file, place).area("layer_columns", "layer_rows", max_pixels)
        if header["type"] == _PROFILE and rows != 1:
            raise UnsupportedFeatureError(
                f"{file.path}: the profile has {rows} rows (layer_rows at offset {place}); only one "
                "is read: save the profiles one by one"
            )
        start = place + _LAYER_BYTES
        count = rows * columns
        need_bytes(file, start, 4 * count, "a layer", name="layer_rows, layer_columns")
        place = start + 4 * count + _LIMIT_BYTES + 3 * count * header["n_images"]
        found.append(_Place(rows, columns, start))
    if len(found) == 1:
        return {"height": found[0]}
    return {f"layer {i}": layer for i, layer in enumerate(found, start=1)}


def _raw(file: RawFile, layer: _Place) -> NDArray[Any]:
    count = layer.rows * layer.columns
    flat = np.frombuffer(file.data, dtype="<f4", count=count, offset=layer.start)
    return flat.reshape(layer.rows, layer.columns)
