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

from metrosep.core.errors import CorruptFileError, FormatMismatchError, UnsupportedFeatureError
from metrosep.core.surface import Surface
from metrosep.io.objects import (
    check_area,
    height_only as channels,
    lateral_or_none,
    make_surface,
    need_bytes,
    only_channels,
    scaled,
    unpack_fields,
)
from metrosep.io.registry import Match
from metrosep.io.source import RawFile, lateral_steps, refuse_options

__all__ = ["TAG", "channels", "read", "sniff"]

FORMAT = "al3d"

TAG: tuple[tuple[int, str, str], ...] = ((0, "20s", "key"), (20, "30s", "value"))
"""Offset, `struct` code and name of the parts of a tag; a line end (0d 0a) follows at 50."""

_MAGIC = b"AliconaImaging\0\r\n"
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


def sniff(file: RawFile) -> Match:
    """Return how sure we are that a file is an Alicona file."""
    if not file.head.startswith(_MAGIC):
        return Match.NO
    first = file.head[len(_MAGIC) : len(_MAGIC) + 8]
    return Match.YES if first == b"Version\0" else Match.MAYBE


def read(
    file: RawFile,
    *,
    channel: str | None = None,
    lateral_step: Any = None,
    unit: Any = None,
    max_pixels: int | None = None,
) -> Surface:
    """Return the depth image of an Alicona file."""
    refuse_options(file, "an Alicona file with its own units", unit=unit)
    only_channels(file, "Alicona", channel)
    override = lateral_steps(lateral_step)
    tags, places = _tags(file)
    raw = _depth(file, tags, places, max_pixels)
    marker = _number(file, tags, places, "InvalidPixelValue", math.nan)
    z = scaled(raw, 1.0, lambda block: _is_marked(block, marker), turned=True)
    warnings = _gap_notes(file, tags, places, raw)
    own = tuple(
        lateral_or_none(
            file, n, _number(file, tags, places, n, 0.0), warnings, offset=places.get(n)
        )
        for n in ("PixelSizeXMeter", "PixelSizeYMeter")
    )
    largest = np.float32(np.fmax.reduce(np.abs(z), axis=None))
    if largest > _LARGEST:
        expected = f"the number of the points that were not measured, heights up to {_LARGEST:g} m"
        raise _bad_tag(
            file, tags, places, "InvalidPixelValue", f"{expected} (there is {largest:g} m)"
        )
    return make_surface(
        file,
        FORMAT,
        z,
        (own[0], own[1]),
        row_order="top row first",
        turned=True,
        header=tags,
        override=override,
        warnings=warnings,
        height_per_count_m=1.0,
        height_rounding_m=float(np.spacing(largest)) if np.isfinite(largest) else None,
        invalid_value_m=marker if math.isfinite(marker) else None,
    )


def _tags(file: RawFile) -> tuple[dict[str, str], dict[str, int]]:
    """Return the tags in order with the comment, and where their values begin."""
    if not file.head.startswith(_MAGIC):
        raise FormatMismatchError(
            f"{file.path}: is not an Alicona file: expected 'AliconaImaging' at offset 0, found "
            f"{file.head[:14]!r}; leave out format= to have it recognised"
        )
    tags: dict[str, str] = {}
    places: dict[str, int] = {}
    place = _add_tags(file, len(_MAGIC), 2, tags, places)
    count = _count(file, tags, places, "TagCount", _MAX_TAGS)
    place = _add_tags(file, place, count, tags, places)
    need_bytes(file, place, _COMMENT_BYTES, "the comment", name="TagCount")
    comment = file.data[place : place + _COMMENT_BYTES].split(b"\0")[0]
    tags["Comment"] = comment.decode("latin-1").strip()
    places["Comment"] = place
    return tags, places


def _add_tags(
    file: RawFile, place: int, count: int, tags: dict[str, str], places: dict[str, int]
) -> int:
    """Read some tags and return where the last one ends."""
    for _ in range(count):
        tag = unpack_fields(file, TAG, order="<", start=place, what="a tag")
        end = file.data[place + _TAG_BYTES - 2 : place + _TAG_BYTES]
        if end != _LINE_END or not tag["key"]:
            raise CorruptFileError(
                file.path,
                "a tag is damaged",
                field=tag["key"] or "key",
                offset=place,
                expected="a key, and a line end after 50 bytes",
                found=end.hex(" ") or "the end of the file",
            )
        tags.setdefault(tag["key"], tag["value"])
        places.setdefault(tag["key"], place + 20)
        place += _TAG_BYTES
    return place


def _depth(
    file: RawFile, tags: dict[str, str], places: dict[str, int], max_pixels: int | None
) -> NDArray[Any]:
    """Return the stored heights without the padding of the rows; sizes are checked before."""
    rows = _count(file, tags, places, "Rows", 2**31)
    columns = _count(file, tags, places, "Cols", 2**31)
    start = _count(file, tags, places, "DepthImageOffset", file.size)
    if start == 0:
        raise UnsupportedFeatureError(
            f"{file.path}: the Alicona file holds no depth image (DepthImageOffset is 0), only "
            "pictures; save the measurement with its heights"
        )
    first = places["Comment"] + _COMMENT_BYTES
    if start < first:
        raise _bad_tag(file, tags, places, "DepthImageOffset", f"at least {first}, after the tags")
    offsets = places["Cols"], places["Rows"]
    check_area(file, columns, rows, max_pixels=max_pixels, names=("Cols", "Rows"), offsets=offsets)
    stride = -(-columns * _ITEM_BYTES // _ROW_MULTIPLE) * _ROW_MULTIPLE
    need_bytes(file, start, rows * stride, "the depth image", name="Rows, Cols, DepthImageOffset")
    count = rows * stride // _ITEM_BYTES
    flat = np.frombuffer(file.data, dtype="<f4", count=count, offset=start)
    return flat.reshape(rows, -1)[:, :columns]


def _gap_notes(
    file: RawFile, tags: dict[str, str], places: dict[str, int], raw: NDArray[Any]
) -> list[str]:
    """Return a sentence where the depth image does not end at the next part of the file."""
    start = int(tags["DepthImageOffset"])
    end = start + raw.shape[0] * raw.strides[0]
    offsets = [_count(file, tags, places, n, 2**40) for n in _PICTURES if n in tags]
    following = min((o for o in offsets if o > start), default=file.size)
    if end == following:
        return []
    size = f"Rows ({tags['Rows']}) and Cols ({tags['Cols']})"
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


def _count(
    file: RawFile, tags: dict[str, str], places: dict[str, int], name: str, largest: int
) -> int:
    """Return a whole number of a tag, 0 or more."""
    text = tags.get(name, "")
    if text.isascii() and text.isdecimal() and len(text) <= 12 and int(text) <= largest:
        return int(text)
    raise _bad_tag(file, tags, places, name, f"a whole number up to {largest}")


def _number(
    file: RawFile, tags: dict[str, str], places: dict[str, int], name: str, missing: float
) -> float:
    try:
        return float(tags.get(name, missing))
    except ValueError:
        raise _bad_tag(file, tags, places, name, "a number") from None


def _bad_tag(
    file: RawFile, tags: dict[str, str], places: dict[str, int], name: str, expected: str
) -> CorruptFileError:
    return CorruptFileError(
        file.path,
        f"the tag {name} is {'not usable' if name in tags else 'missing'}",
        field=name,
        offset=places.get(name),
        expected=expected,
        found=repr(tags.get(name, "")),
    )
