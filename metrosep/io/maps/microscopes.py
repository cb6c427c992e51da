"""Maps of microscopes: Keyence VK, Sensofar PLUX, OmniSurf3D, TrueMap, Olympus LEXT, NanoFocus.

Fields are declared in ``data_formats/*/format.toml``. All are from descriptions; no real file was at hand. Where nothing shows which row is on top, the map
carries a warning and ``row_order=`` states it.
"""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core.errors import ReadError, UnitError, UnsupportedFeatureError
from metrosep.core.surface import Surface
from metrosep.core.text_options import ROW_ORDERS
from metrosep.core.units import parse_unit
from metrosep.io.archive import Archive, xml_of, zip_members
from metrosep.io.declared import Cursor, Match, TextFields, need_bytes
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

_TOP = ROW_ORDERS[1]
_UM, _PM = 1e-6, 1e-12
_MAX_XML = 2**22


def _grid(
    file: RawFile, start: int, dtype: str, columns: int, rows: int, most: int | None
) -> NDArray[Any]:
    """Return the numbers of a map, x fastest; sizes are checked before."""
    check_area(file, columns, rows, max_pixels=most)
    count = columns * rows
    need_bytes(file, start, count * np.dtype(dtype).itemsize, "the map", name="columns and rows")
    return np.frombuffer(file.data, dtype, count, start).reshape(rows, columns)


# ---- Keyence VK: a table of offsets, conditions, and up to three images of heights in digits --------

_VK = "vk"
_OFFSETS, _CONDITIONS, _IMAGE = (structure(_VK, n) for n in ("offsets", "conditions", "image"))
_VK_MEMBER = "Vk4File"
_PALETTE = 768
_CONDITIONS_AT = {"VK3_": 80, "VK4_": 84}


def _vk_stream(file: RawFile) -> RawFile:
    """Return the content of version 4, which newer files pack into an archive behind a picture."""
    demand(file, _VK)
    if file.head[:4] in (b"VK3_", b"VK4_"):
        return file
    archive = Archive(file, "the Keyence file")
    inner = RawFile(file.path, archive.read(_VK_MEMBER, limit=2**31))
    if inner.head[:4] != b"VK4_":
        raise archive.corrupt("holds no measurement of version 4", _VK_MEMBER)
    return inner


def _vk_images(stream: RawFile) -> dict[str, int]:
    """Return the images of heights by name, with their offsets."""
    offsets = _OFFSETS.read(stream)
    found = {f"height {k}": offsets[f"height_{k}"] for k in (1, 2, 3) if offsets[f"height_{k}"]}
    if not found:
        raise UnsupportedFeatureError(
            f"{stream.path}: the Keyence file holds no image of heights, only pictures"
        )
    return found


def _vk_channels(file: RawFile) -> tuple[str, ...]:
    """Return the images of heights."""
    return tuple(_vk_images(_vk_stream(file)))


@map_reader(_VK, "Keyence", "a Keyence file with its own units", several=True)
def _vk_read(asked: Request) -> Surface:
    """Return a map of heights of a Keyence file."""
    stream = _vk_stream(asked.file)
    images = _vk_images(stream)
    name = asked.choose(images)
    conditions = _CONDITIONS.read(stream, _CONDITIONS_AT[stream.head[:4].decode()])
    image = _IMAGE.read(stream, images[name])
    columns, rows = image.area("width", "height", asked.max_pixels)
    bits = image["bits"]
    if bits not in (8, 16, 32) or image["compression"]:
        raise image.error("bits", "8, 16 or 32, not compressed")
    image.demand("bytes", columns * rows * bits // 8)
    start = images[name] + _IMAGE.size + _PALETTE
    raw = _grid(stream, start, f"<u{bits // 8}", columns, rows, asked.max_pixels)
    scale = conditions.scale("height_per_digit", 1.0, 1e9) * _PM
    zeros = int(np.count_nonzero(raw == 0))
    if zeros:
        asked.warnings.append(
            f"{zeros} points have digit 0, which often means not measured; they are kept as heights"
        )
    return asked.surface(
        scaled(raw, scale),
        (
            conditions.step("x_per_pixel", asked.warnings),
            conditions.step("y_per_pixel", asked.warnings),
        ),
        row_order=_TOP,
        header={**conditions, **image},
        channel=name,
        height_per_count_m=scale,
    )


def _vk_sniff(file: RawFile) -> Match:
    """Return how sure we are: newer files hold the older content in an archive."""
    found = sniffer(_VK)(file)
    if found is not Match.MAYBE:
        return found
    try:
        inside = _VK_MEMBER in Archive(file, "the Keyence file").members
    except ReadError:
        return Match.MAYBE
    return Match.YES if inside else Match.NO


vk = BuiltIn(_vk_sniff, _vk_channels, _vk_read)


# ---- Sensofar PLUX: an archive with index.xml and layers of floats in um ---------------------------

_PLUX = "plux"
_INDEX = "index.xml"


def _plux_index(file: RawFile) -> tuple[Archive, dict[str, str], dict[str, str]]:
    """Return the archive, the texts of GENERAL, and the member of each layer by name."""
    from defusedxml.ElementTree import fromstring

    demand(file, _PLUX)
    archive = Archive(file, "the PLUX file")
    with xml_of(archive, _INDEX):
        root = fromstring(archive.read(_INDEX, limit=_MAX_XML), forbid_dtd=True)
    general = {e.tag: (e.text or "").strip() for e in root.find("GENERAL") or ()}
    layers = {
        e.tag: (e.findtext("FILENAME_Z") or "").strip()
        for e in root
        if re.fullmatch(r"LAYER_\d{1,4}", e.tag)
    }
    layers = {name: member for name, member in layers.items() if member}
    if "IMAGE_SIZE_X" not in general or not layers:
        raise archive.corrupt("has no GENERAL/IMAGE_SIZE_X or no layer with heights", _INDEX)
    return archive, general, layers


def _plux_channels(file: RawFile) -> tuple[str, ...]:
    """Return the layers."""
    return tuple(_plux_index(file)[2])


@map_reader(_PLUX, "PLUX", "a PLUX file with its own units", several=True)
def _plux_read(asked: Request) -> Surface:
    """Return a layer of a PLUX file."""
    file = asked.file
    archive, general, layers = _plux_index(file)
    name = asked.choose(layers)
    fields = TextFields(file, general, noun="GENERAL")
    columns, rows = (fields.whole(f"IMAGE_SIZE_{a}", most=2**20) for a in "XY")
    check_area(file, columns, rows, max_pixels=asked.max_pixels)
    limit = 4 * columns * rows
    data = archive.read(layers[name], limit=limit, trusted=asked.max_pixels is not None)
    if len(data) != limit:
        raise archive.corrupt(f"holds {len(data)} bytes where {limit} are claimed", layers[name])
    steps = [
        lateral_or_none(
            file, f"FOV_{a}", fields.number(f"FOV_{a}", 0.0), asked.warnings, factor=_UM
        )
        for a in "XY"
    ]
    raw = np.frombuffer(data, "<f4").reshape(rows, columns)
    return asked.surface(
        scaled(raw, _UM), (steps[0], steps[1]), row_order=_TOP, header=general, channel=name
    )


def _plux_sniff(file: RawFile) -> Match:
    """Return how sure we are: other archives have an index too."""
    index = zip_members(file, _INDEX).get(_INDEX, b"")
    return Match.YES if b"IMAGE_SIZE_X" in index else Match.NO


plux = BuiltIn(_plux_sniff, _plux_channels, _plux_read)


# ---- OmniSurf3D: texts with their length, sizes, steps, floats in um -------------------------------

_OS3D = "os3d"
_NO_DATA = -3e38


@map_reader(_OS3D, "OmniSurf3D", "an OmniSurf3D file with its own units")
def _os3d_read(asked: Request) -> Surface:
    """Return the map of an OmniSurf3D file."""
    file = asked.file
    demand(file, _OS3D)
    cursor = Cursor(file, file.data, 10)
    version = cursor.numbers("2i", "version")
    texts = cursor.text("identification"), cursor.text("date")
    columns, rows = cursor.numbers("2i", "points")
    numbers = cursor.numbers("4d", "steps and origin")
    if not all(math.isfinite(v) and abs(v) < 1e9 for v in numbers):
        raise cursor.wrong("steps and origin are not usable", "origin", "numbers in um", numbers)
    raw = _grid(file, cursor.place, "<f4", columns, rows, asked.max_pixels)
    own = [
        lateral_or_none(file, f"step_{a}", v, asked.warnings, factor=_UM)
        for a, v in zip("xy", numbers[:2], strict=True)
    ]
    return asked.surface(
        scaled(raw, _UM, lambda block: block < _NO_DATA),
        (own[0], own[1]),
        row_order=_TOP,
        origin=(numbers[2] * _UM, numbers[3] * _UM),
        header={
            "version": version,
            "identification": texts[0],
            "date": texts[1],
            "numbers": numbers,
        },
    )


os3d = BuiltIn(sniffer(_OS3D), height_only, _os3d_read)


# ---- TrueMap: sizes and floats in a unit that the file does not state ------------------------------

_TMD = "tmd"
_TMD_HEADER = structure(_TMD)


@map_reader(_TMD, "TrueMap")
def _tmd_read(asked: Request) -> Surface:
    """Return the map of a TrueMap file; ``unit=`` is needed."""
    file = asked.file
    demand(file, _TMD)
    if asked.unit is None:
        raise UnitError(
            f"{file.path}: a TrueMap file states no unit, and programs that read it differ by 1000; give "
            "the unit of heights and lengths, such as unit='mm'"
        )
    factor = parse_unit(str(asked.unit), dimension="length").factor
    header = _TMD_HEADER.read(file)
    columns, rows = header.area("columns", "rows", asked.max_pixels)
    raw = _grid(file, _TMD_HEADER.size, "<f4", columns, rows, asked.max_pixels)
    steps = [
        lateral_or_none(
            file, f"length_{a}", header[f"length_{a}"] / n, asked.warnings, factor=factor
        )
        for a, n in (("x", columns), ("y", rows))
    ]
    return asked.surface(scaled(raw, factor), (steps[0], steps[1]), row_order=_TOP, header=header)


tmd = BuiltIn(sniffer(_TMD), height_only, _tmd_read)


# ---- NanoFocus: no magic; sizes that fill the file exactly, counts between two heights --------------

_NMS = "nms"
_NMS_HEADER = structure(_NMS)
_NMS_BYTES = 3468
_NMS_COUNTS = 2**16 - 2


def _nms_sniff(file: RawFile) -> Match:
    """Return MAYBE where sizes, steps and heights fit the file; the format has no magic."""
    if file.size < _NMS_BYTES:
        return Match.NO
    header = _NMS_HEADER.read(file)
    points = header["columns"] * header["rows"]
    steps = 0.0 < header["dx_mm"] < 1.0 and 0.0 < header["dy_mm"] < 1.0
    heights = -1e6 < header["low_um"] < header["high_um"] < 1e6
    whole = points > 0 and _NMS_BYTES + 2 * points == file.size
    return Match.MAYBE if whole and steps and heights else Match.NO


@map_reader(_NMS, "NanoFocus", "a NanoFocus file with its own units")
def _nms_read(asked: Request) -> Surface:
    """Return the map of a NanoFocus file."""
    file = asked.file
    header = _NMS_HEADER.read(file)
    columns, rows = header.area("columns", "rows", asked.max_pixels)
    if not _nms_sniff(file):
        raise header.error("columns", f"a map that fills {file.size - _NMS_BYTES} bytes")
    raw = _grid(file, _NMS_BYTES, "<u2", columns, rows, asked.max_pixels)
    low, high = header["low_um"] * _UM, header["high_um"] * _UM
    return asked.surface(
        scaled(raw, (high - low) / _NMS_COUNTS, offset=low),
        (header.step("dx_mm", asked.warnings), header.step("dy_mm", asked.warnings)),
        row_order=_TOP,
        header=header,
        height_per_count_m=(high - low) / _NMS_COUNTS,
    )


nms = BuiltIn(_nms_sniff, height_only, _nms_read)


# ---- Olympus LEXT: a TIFF whose page "HEIGHT" holds counts, with XML on the scale of a count --------

_LEXT = "lext"
_TIFF = {b"II*\0": "<", b"MM\0*": ">"}
_TAG_BYTES = 12
_ITEM = {1: 1, 2: 1, 3: 2, 4: 4, 7: 1}
_MAX_PAGES = 64


def _pages(file: RawFile) -> list[dict[int, tuple[int, int, int]]]:
    """Return the tags of each page of a TIFF: type, count and where the values lie."""
    order = _TIFF[file.head[:4]]
    place = Cursor(file, file.data, 4, order=order).number("I", "first page")
    pages: list[dict[int, tuple[int, int, int]]] = []
    while place and len(pages) < _MAX_PAGES:
        pages.append(_tags(file, order, place))
        place = Cursor(file, file.data, pages[-1][0][2], order=order).number("I", "next page")
    return pages


def _tags(file: RawFile, order: str, place: int) -> dict[int, tuple[int, int, int]]:
    """Return the tags of a page; tag 0 tells where the offset of the next page lies."""
    cursor = Cursor(file, file.data, place, order=order)
    found = {}
    for _ in range(cursor.number("H", "tags")):
        tag, kind, count = cursor.numbers("HHI", "tag")
        at = cursor.place
        value = cursor.number("I", "value")
        found[tag] = (kind, count, at if _ITEM.get(kind, 8) * count <= 4 else value)
    found[0] = (4, 1, cursor.place)
    return found


def _tag_numbers(
    file: RawFile, page: dict[int, tuple[int, int, int]], tag: int
) -> tuple[int, ...]:
    """Return the whole numbers of a tag."""
    kind, count, at = page.get(tag, (0, 0, 0))
    if kind not in (3, 4) or not 1 <= count <= 2**20:
        raise file.corrupt("a page lacks a tag", field=f"tag {tag}", expected="whole numbers")
    cursor = Cursor(file, file.data, at, order=_TIFF[file.head[:4]])
    return cursor.numbers(f"{count}{'H' if kind == 3 else 'I'}", f"tag {tag}")


def _tag_text(file: RawFile, page: dict[int, tuple[int, int, int]], tag: int) -> str:
    kind, count, at = page.get(tag, (0, 0, 0))
    if kind not in (1, 2, 7) or count > _MAX_XML:
        return ""
    return (
        Cursor(file, file.data, at)
        .take(count, f"tag {tag}")
        .decode("utf-8", "replace")
        .strip("\0 ")
    )


def _xml_number(file: RawFile, text: str, name: str) -> float:
    """Return the number of the first element of a name."""
    found = re.search(rf"<{name}>\s*([-+.\deE]{{1,40}})\s*</{name}>", text)
    try:
        return float(found[1] if found else "")
    except ValueError:
        raise file.corrupt(f"the element {name} is missing or not a number", field=name) from None


@map_reader(_LEXT, "LEXT", "a LEXT file with its own units")
def _lext_read(asked: Request) -> Surface:
    """Return the map of heights of an Olympus LEXT file."""
    file = asked.file
    demand(file, _LEXT)
    pages = _pages(file)
    named = {_tag_text(file, page, 270): page for page in pages}
    about = next((text for text in named if "TiffTagDescData" in text), None)
    if "HEIGHT" not in named or about is None:
        raise file.corrupt("holds no page HEIGHT with its description", field="ImageDescription")
    exif = _tag_numbers(file, named[about], 34665)[0]
    settings = _tag_text(file, _tags(file, _TIFF[file.head[:4]], exif), 41995)
    page = named["HEIGHT"]
    columns, rows, bits, packing = (_tag_numbers(file, page, t)[0] for t in (256, 257, 258, 259))
    if bits != 16 or packing != 1:
        raise UnsupportedFeatureError(
            f"{file.path}: the page HEIGHT has {bits} bits packed by method {packing}; only 16 plain ones "
            "are read"
        )
    check_area(file, columns, rows, max_pixels=asked.max_pixels)
    starts, sizes = _tag_numbers(file, page, 273), _tag_numbers(file, page, 279)
    if len(starts) != len(sizes) or sum(sizes) != 2 * columns * rows:
        raise file.corrupt("the strips do not make the map", field="StripByteCounts",
                           expected=2 * columns * rows, found=sum(sizes))  # fmt: skip
    data = b"".join(
        Cursor(file, file.data, at).take(n, "strip") for at, n in zip(starts, sizes, strict=True)
    )
    per = {
        a: _xml_number(file, about, f"HeightDataPerPixel{a}")
        * _xml_number(file, settings, f"MakerCalibrationValue{a}")
        for a in "XYZ"
    }
    if not 0.0 < per["Z"] < 1e9:
        raise file.corrupt("the scale is not usable", field="HeightDataPerPixelZ", found=per["Z"])
    raw = np.frombuffer(data, _TIFF[file.head[:4]] + "u2").reshape(rows, columns)
    steps = [
        lateral_or_none(file, f"HeightDataPerPixel{a}", per[a], asked.warnings, factor=_PM)
        for a in "XY"
    ]
    return asked.surface(
        scaled(raw, per["Z"] * _PM),
        (steps[0], steps[1]),
        row_order=_TOP,
        header={"description": about, "settings": settings},
        height_per_count_m=per["Z"] * _PM,
    )


def _lext_sniff(file: RawFile) -> Match:
    """Return how sure we are: the pages of a TIFF say what they hold, wherever they lie."""
    if not sniffer(_LEXT)(file):
        return Match.NO
    try:
        names = [_tag_text(file, page, 270) for page in _pages(file)]
    except ReadError:
        return Match.MAYBE if b"TiffTagDescData" in file.head else Match.NO
    return Match.YES if "HEIGHT" in names else Match.NO


lext = BuiltIn(_lext_sniff, height_only, _lext_read)
