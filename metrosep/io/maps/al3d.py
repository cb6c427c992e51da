"""Alicona ``.al3d``: a list of text tags, then a depth image of little-endian floats in metres.

A tag has 52 bytes: key, value, line end. Rows of the depth image are padded to a multiple of 8
bytes. The tag ``InvalidPixelValue`` names the number that is not measured. Heights include the
position of the stage, which costs digits of the floats: the metadata say how fine they are. The
top row is stored first; rows are turned so that row 0 has the smallest y. Layout and sources are in
``data_formats/al3d/SPEC.md``.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core.errors import UnsupportedFeatureError
from metrosep.core.surface import Surface
from metrosep.io.declared import TextFields, demand, need_bytes, sniffer, structure
from metrosep.io.objects import (
    Request,
    check_area,
    height_only as channels,
    lateral_or_none,
    map_reader,
    scaled,
)
from metrosep.io.source import RawFile

__all__ = ["channels", "read", "sniff"]

FORMAT = "al3d"

_MAGIC_BYTES = 17
_TAG = structure(FORMAT, "tag")
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


sniff = sniffer(FORMAT)


@map_reader(FORMAT, "Alicona", "an Alicona file with its own units")
def read(asked: Request) -> Surface:
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
    demand(file, FORMAT)
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
