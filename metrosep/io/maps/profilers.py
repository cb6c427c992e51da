"""Maps of optical profilers, binary: Alicona ``.al3d`` and Sensofar ``.plu``."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from metrosep.core.errors import UnitError, UnsupportedFeatureError
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.io.declared import Fields, TextFields, need_bytes
from metrosep.io.objects import (
    Request,
    check_area,
    height_only,
    lateral_or_none,
    map_reader,
    scaled,
)
from metrosep.io.registry import BuiltIn, demand, sniffer, structure
from metrosep.io.source import RawFile

# ---- Alicona ``.al3d``: a list of text tags, then a depth image of little-endian floats in metres
# A tag has 52 bytes: key, value, line end. Rows of the depth image are padded to a multiple of 8
# bytes. The tag ``InvalidPixelValue`` names the number that is not measured. Heights include the
# position of the stage, which costs digits of the floats: the metadata say how fine they are. The
# top row is stored first; rows are turned so that row 0 has the smallest y. Layout and sources are in
# ``data_formats/al3d/SPEC.md``.

_AL3D = "al3d"

_MAGIC_BYTES = 17
_TAG = structure(_AL3D, "tag")
_TAG_BYTES = 52
_LINE_END = b"\r\n"
_MAX_TAGS = 10_000
_COMMENT_BYTES = 256
_ROW_MULTIPLE = 8
_ITEM_BYTES = 4
_MARKER_RTOL = 1.5e-7
"""A marker is text with a few more digits than a float holds: half a step of the float, and some."""

_LARGEST = 10.0
"""Largest height in m, with the position of the stage; the usual marker is 3e15."""

_PICTURES = ("TextureImageOffset", "IconOffset")


_al3d_sniff = sniffer(_AL3D)


@map_reader(_AL3D, "Alicona", "an Alicona file with its own units")
def _al3d_read(asked: Request) -> Surface:
    """Return the depth image of an Alicona file."""
    file = asked.file
    tags = _tags(file)
    raw = _depth(file, tags, asked.max_pixels)
    marker = tags.number("InvalidPixelValue", math.nan)
    z = scaled(raw, 1.0, lambda block: _is_marked(block, marker), turned=True)
    warnings = _gap_notes(tags, raw)
    own = tuple(
        lateral_or_none(file, n, tags.number(n, 0.0), warnings, offset=tags.offsets.get(n))
        for n in ("PixelSizeXMeter", "PixelSizeYMeter")
    )
    largest = np.float32(np.fmax.reduce(np.abs(z), axis=None))
    if largest > _LARGEST:
        expected = f"the number of the points that were not measured, heights up to {_LARGEST:g} m"
        raise tags.error("InvalidPixelValue", f"{expected} (there is {largest:g} m)")
    return asked.surface(
        z,
        (own[0], own[1]),
        row_order="top row first",
        turned=True,
        header=tags.texts,
        warnings=warnings,
        height_per_count_m=1.0,
        height_rounding_m=float(np.spacing(largest)) if np.isfinite(largest) else None,
        invalid_value_m=marker if math.isfinite(marker) else None,
    )


def _tags(file: RawFile) -> TextFields:
    """Return the tags in order with the comment, and where their values begin."""
    demand(file, _AL3D)
    tags = TextFields(file, noun="the tag")
    place = _add_tags(tags, _MAGIC_BYTES, 2)
    place = _add_tags(tags, place, tags.whole("TagCount", most=_MAX_TAGS))
    need_bytes(file, place, _COMMENT_BYTES, "the comment", name="TagCount")
    comment = file.data[place : place + _COMMENT_BYTES].split(b"\0")[0]
    tags.texts["Comment"] = comment.decode("latin-1").strip()
    tags.offsets["Comment"] = place
    return tags


def _add_tags(tags: TextFields, place: int, count: int) -> int:
    """Read some tags and return where the last one ends."""
    file = tags.file
    for _ in range(count):
        tag = _TAG.read(file, place)
        end = file.data[place + _TAG_BYTES - 2 : place + _TAG_BYTES]
        if end != _LINE_END or not tag["key"]:
            raise file.corrupt(
                "a tag is damaged",
                field=tag["key"] or "key",
                offset=place,
                expected="a key, and a line end after 50 bytes",
                found=end.hex(" ") or "the end of the file",
            )
        tags.texts.setdefault(tag["key"], tag["value"])
        tags.offsets.setdefault(tag["key"], tag.offset("value"))
        place += _TAG_BYTES
    return place


def _depth(file: RawFile, tags: TextFields, max_pixels: int | None) -> NDArray[Any]:
    """Return the stored heights without the padding of the rows; sizes are checked before."""
    rows, columns = (tags.whole(name, most=2**31) for name in ("Rows", "Cols"))
    start = tags.whole("DepthImageOffset", most=file.size)
    if start == 0:
        raise UnsupportedFeatureError(
            f"{file.path}: the Alicona file holds no depth image (DepthImageOffset is 0), only "
            "pictures; save the measurement with its heights"
        )
    first = tags.offsets["Comment"] + _COMMENT_BYTES
    if start < first:
        raise tags.error("DepthImageOffset", f"at least {first}, after the tags")
    offsets = tags.offsets["Cols"], tags.offsets["Rows"]
    check_area(file, columns, rows, max_pixels=max_pixels, names=("Cols", "Rows"), offsets=offsets)
    stride = -(-columns * _ITEM_BYTES // _ROW_MULTIPLE) * _ROW_MULTIPLE
    need_bytes(file, start, rows * stride, "the depth image", name="Rows, Cols, DepthImageOffset")
    count = rows * stride // _ITEM_BYTES
    flat = np.frombuffer(file.data, dtype="<f4", count=count, offset=start)
    return flat.reshape(rows, -1)[:, :columns]


def _gap_notes(tags: TextFields, raw: NDArray[Any]) -> list[str]:
    """Return a sentence where the depth image does not end at the next part of the file."""
    start = tags.whole("DepthImageOffset")
    end = start + raw.shape[0] * raw.strides[0]
    offsets = [tags.whole(n, most=2**40) for n in _PICTURES if n in tags.texts]
    following = min((o for o in offsets if o > start), default=tags.file.size)
    if end == following:
        return []
    size = f"Rows ({tags.texts['Rows']}) and Cols ({tags.texts['Cols']})"
    return [
        f"the depth image ends at {end}, but the next part begins at {following}: check {size}"
    ]


def _is_marked(block: NDArray[Any], marker: float) -> NDArray[np.bool_]:
    """Return where nothing was measured: NaN, or the marker as far as a float holds it."""
    if not math.isfinite(marker):
        nan: NDArray[np.bool_] = np.isnan(block)
        return nan
    with np.errstate(invalid="ignore", over="ignore"):
        distance = np.abs(block.astype(np.float64) - marker)
    marked: NDArray[np.bool_] = ~(distance > _MARKER_RTOL * abs(marker))  # NaN is not larger
    return marked


al3d = BuiltIn(_al3d_sniff, height_only, _al3d_read)


# ---- sensofar PLu ``.plu``: float maps or a profile in um behind a header of 500 bytes, little-endian ----
# Each layer repeats its number of rows and columns before the heights; a reader that starts at these
# eight bytes shifts the whole map by two points. 1000001 is not measured. The file stores the top row
# first; rows are turned so that row 0 has the smallest y. Layout and sources are in
# ``data_formats/plu/SPEC.md``.

_PLU = "plu"

_HEADER, _LAYER, _LIMITS = (structure(_PLU, n) for n in ("header", "layer", "limits"))
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


_plu_sniff = sniffer(_PLU)


class _Place(NamedTuple):
    """Rows and columns of a layer, and where its heights begin."""

    rows: int
    columns: int
    start: int


def _plu_channels(file: RawFile) -> tuple[str, ...]:
    """Return the layers of the file."""
    return tuple(_layers(file, _header(file)))


@map_reader(_PLU, "PLu", "a PLu file with its own units", several=True)
def _plu_read(asked: Request) -> Surface | Profile:
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
    demand(file, _PLU)
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


plu = BuiltIn(_plu_sniff, _plu_channels, _plu_read)
