"""Maps of scanning probe microscopes: Nanoscope ``.spm``/``.di``, WSxM, Igor ``.ibw``, Nanosurf ``.nid``.

All have a header of texts (Igor: of fields) and blocks of numbers with the lowest row first; WSxM also
stores every row from right to left. Layouts and sources are in ``data_formats/*/SPEC.md``.
"""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from metrosep.core.errors import UnitError, UnsupportedFeatureError
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.core.text_options import ROW_ORDERS
from metrosep.core.units import parse_unit
from metrosep.io.declared import Fields, TextFields, need_bytes
from metrosep.io.objects import Request, check_area, height_only, map_reader, scaled
from metrosep.io.registry import BuiltIn, demand, sniffer, structure
from metrosep.io.source import RawFile

_MAX_HEADER = 2**20
_UP = ROW_ORDERS[0]


class _Block(NamedTuple):
    """One map of a file: what its header says, where it lies and what a count means."""

    fields: TextFields
    start: int
    dtype: str
    columns: int
    rows: int
    scale: float  # m per count
    offset: float = 0.0  # m


def _raw(file: RawFile, block: _Block, most: int | None) -> NDArray[Any]:
    """Return the stored numbers of a map; its size is checked before."""
    check_area(file, block.columns, block.rows, max_pixels=most)
    count = block.columns * block.rows
    dtype = np.dtype(block.dtype)
    need_bytes(file, block.start, count * dtype.itemsize, "the map", name="rows and columns")
    flat = np.frombuffer(file.data, dtype=dtype, count=count, offset=block.start)
    return flat.reshape(block.rows, block.columns)


def _metres(file: RawFile, fields: TextFields, name: str, text: str | None = None) -> float:
    """Return a length such as ``600 nm`` in m."""
    value = fields.texts.get(name, "") if text is None else text
    number, _, unit = value.strip().partition(" ")
    try:
        factor = parse_unit(unit.replace("~", "u"), dimension="length").factor
        found = float(number) * factor
    except (UnitError, ValueError):
        found = float("nan")
    if not 0.0 < found < 1.0:
        raise fields.error(name, "a length with its unit, below 1 m")
    return found


def _map(asked: Request, block: _Block, size: tuple[float, float], **facts: Any) -> Surface:
    """Return the surface of a block that has the lowest row first and spans a size in m."""
    raw = facts.pop("raw", None)
    raw = _raw(asked.file, block, asked.max_pixels) if raw is None else raw
    return asked.surface(
        scaled(raw, block.scale, offset=block.offset),
        (size[0] / block.columns, size[1] / block.rows),
        row_order=_UP,
        height_per_count_m=block.scale,
        **facts,
    )


# ---- Nanoscope: sections ``\*name`` of lines ``\key: value``; one section per image ---------------
# ``@2:Z scale: V [Sens. x] (0.006 V/LSB) 2.9 V``: full scale over 2^bits, times the sensitivity that
# another section gives as ``@Sens. x: V 34.5 nm/V``. Since version 9.2 every count has 32 bits.

_NANOSCOPE = "nanoscope"
_END = b"\\*File list end"
_SCALE = re.compile(r"V\s*(?:\[([^\]]*)\])?\s*(?:\([^)]*\))?\s*([-+.\deE]+)\s*(\S*)")
_ALWAYS_32_BIT = 0x09200000


def _nanoscope_images(file: RawFile) -> dict[str, _Block]:
    """Return the maps of heights by name."""
    demand(file, _NANOSCOPE)
    end = file.data.find(_END, 0, _MAX_HEADER)
    if end < 0:
        raise file.corrupt("the header has no end", expected=_END.decode())
    shared, images = TextFields(file), []
    fields = shared
    for number, line in enumerate(file.data[:end].decode("latin-1").split("\n"), start=1):
        if line.startswith("\\*"):
            is_image = line.rstrip().lower().endswith("image list")
            fields = TextFields(file) if is_image else shared
            if is_image:
                images.append(fields)
        else:
            fields.take(line.strip("\\\r "), mark=": ", line=number, name=str.lower)
    found: dict[str, _Block] = {}
    for image in images:
        name = _quoted(image.texts.get("@2:image data", ""))
        block = _nanoscope_block(file, shared, image)
        if block is not None:
            count = sum(key == name or key.startswith(f"{name} (") for key in found)
            found[f"{name} ({count + 1})" if count else name] = block
    if not found:
        raise UnsupportedFeatureError(
            f"{file.path}: the Nanoscope file holds no map of heights with a sensitivity in a unit of "
            "length; save the height channel"
        )
    return found


def _quoted(text: str) -> str:
    found = re.search(r"\[([^\]]+)\]", text) or re.search(r'"([^"]*)"', text)
    return found[1] if found else "image"


def _nanoscope_block(file: RawFile, shared: TextFields, image: TextFields) -> _Block | None:
    """Return where an image lies and its scale, ``None`` where it is not of heights."""
    scale = _SCALE.match(image.texts.get("@2:z scale", ""))
    soft = _SCALE.match(shared.texts.get(f"@{scale[1]}".lower(), "")) if scale else None
    if scale is None or soft is None or "/" not in soft[3]:
        return None
    unit, _, per = soft[3].partition("/")
    try:
        length = parse_unit(unit.replace("~", "u"), dimension="length").factor
        volts = parse_unit(scale[3]).factor / parse_unit(per).factor
        full = float(scale[2]) * volts * float(soft[2]) * length
    except (UnitError, ValueError):
        return None
    columns, rows = (image.whole(n, most=2**20) for n in ("samps/line", "number of lines"))
    width = image.whole("bytes/pixel", most=4, default="2")
    try:
        version = int(shared.texts.get("version", "0"), 16)
    except ValueError:
        raise shared.error("version", "a hexadecimal number") from None
    stored = 4 if version >= _ALWAYS_32_BIT else width
    if width not in (2, 4):
        raise image.error("bytes/pixel", "2 or 4")
    if image.whole("data length", most=2**40) < columns * rows * stored:
        raise image.error("data length", f"at least {columns} x {rows} x {stored} bytes")
    start = image.whole("data offset", most=2**40)
    return _Block(image, start, f"<i{stored}", columns, rows, full / 256.0**width)


def _nanoscope_size(block: _Block) -> tuple[float, float]:
    """Return width and height in m of ``10 5 ~m`` or of one number for both."""
    fields = block.fields
    parts = fields.texts.get("scan size", "").split()
    if len(parts) not in (2, 3):
        raise fields.error("scan size", "one or two numbers and a unit")
    first, second = (
        _metres(fields.file, fields, "scan size", f"{parts[k]} {parts[-1]}")
        for k in (0, len(parts) - 2)
    )
    return first, second


def _nanoscope_channels(file: RawFile) -> tuple[str, ...]:
    """Return the names of the maps of heights."""
    return tuple(_nanoscope_images(file))


@map_reader(_NANOSCOPE, "Nanoscope", "a Nanoscope file with its own units", several=True)
def _nanoscope_read(asked: Request) -> Surface:
    """Return a map of heights of a Nanoscope file."""
    images = _nanoscope_images(asked.file)
    name = asked.choose(images)
    block = images[name]
    if "slow axis size" in block.fields.texts:
        asked.warnings.append("the header states a size of the slow axis; it was not used")
    return _map(asked, block, _nanoscope_size(block), header=block.fields.texts, channel=name)


nanoscope = BuiltIn(sniffer(_NANOSCOPE), _nanoscope_channels, _nanoscope_read)


# ---- sections ``[name]`` of lines ``key: value`` or ``key = value`` (WSxM, Nanosurf) ----------------


def _sections(file: RawFile, start: int, end: int, mark: str) -> dict[str, TextFields]:
    """Return the fields of each section of a header."""
    found = {"": TextFields(file)}
    name = ""
    first = file.data[:start].count(b"\n") + 1
    text = file.data[start:end].decode("latin-1")
    for number, line in enumerate(text.split("\n"), start=first):
        stripped = line.strip()
        if stripped.startswith("[") and stripped.endswith("]"):
            name = stripped[1:-1]
            found.setdefault(name, TextFields(file))
        else:
            found[name].take(stripped, mark=mark, line=number)
    return found


def _texts(sections: dict[str, TextFields]) -> dict[str, Any]:
    return {name: fields.texts for name, fields in sections.items() if fields.texts}


# ---- WSxM: heights as numbers in the unit of the Z amplitude, or as counts that span it ------------

_WSXM = "wsxm"
_WSXM_TYPES = {"double": "<f8", "float": "<f4", "short": "<i2", "integer": "<i4"}


@map_reader(_WSXM, "WSxM", "a WSxM file with its own units")
def _wsxm_read(asked: Request) -> Surface:
    """Return the map of a WSxM file."""
    file = asked.file
    demand(file, _WSXM)
    found = re.search(rb"\r\nImage header size: *(\d{1,7})\r\n", file.head[:400])
    size = int(found[1]) if found else 0
    if found is None or not file.data[:size].rstrip().endswith(b"[Header end]"):
        raise file.corrupt(
            "the header has another length than it says",
            field="Image header size",
            expected="[Header end] there",
            found=size,
        )
    sections = _sections(file, found.end(), size, ":")
    empty = TextFields(file)
    general, control = (sections.get(n, empty) for n in ("General Info", "Control"))
    kind = general.texts.get("Image Data Type", "short")
    if kind not in _WSXM_TYPES:
        raise general.error("Image Data Type", " or ".join(_WSXM_TYPES))
    columns, rows = (
        general.whole(f"Number of {n}", most=2**20, least=1) for n in ("columns", "rows")
    )
    block = _Block(general, size, _WSXM_TYPES[kind], columns, rows, 1.0)
    raw = _raw(file, block, asked.max_pixels)[:, ::-1]
    amplitude = _metres(file, general, "Z Amplitude")
    unit = parse_unit(general.texts["Z Amplitude"].split(" ")[-1], dimension="length").factor
    if raw.dtype.kind == "i":
        counts = int(raw.max()) - int(raw.min())
        unit = amplitude / max(counts, 1)
    across = _metres(file, control, "X Amplitude")
    along = _metres(file, control, "Y Amplitude") if "Y Amplitude" in control.texts else across
    return _map(
        asked,
        block._replace(scale=unit),
        (across, along),
        raw=raw,
        header=_texts(sections),
        column_order_in_file="largest x first",
    )


wsxm = BuiltIn(sniffer(_WSXM), height_only, _wsxm_read)


# ---- Nanosurf ``.nid``: sections for groups and channels, blocks of counts behind ``#!`` -----------

_NID = "nid"


def _nid_images(file: RawFile) -> tuple[dict[str, _Block], dict[str, TextFields]]:
    """Return the maps of heights by name, and the header."""
    demand(file, _NID)
    end = file.data.find(b"\n#!", 0, _MAX_HEADER)
    if end < 0:
        raise file.corrupt("the header has no end", expected="'#!' before the counts")
    sections = _sections(file, 0, end, "=")
    top, place = sections["DataSet"], end + 3
    found: dict[str, _Block] = {}
    for group in range(top.whole("GroupCount", most=1000)):
        for channel in range(top.whole(f"Gr{group}-Count", most=1000, default="0")):
            image = sections.get(top.texts.get(f"Gr{group}-Ch{channel}", "\0"))
            if image is None:
                continue
            columns, rows = (image.whole(n, most=2**20) for n in ("Points", "Lines"))
            bits = image.whole("SaveBits", most=32, default="16")
            if image.texts.get("SaveMode", "Binary") != "Binary" or bits not in (8, 16, 32):
                raise image.error("SaveBits", "8, 16 or 32 in SaveMode Binary")
            order = "<" if image.texts.get("SaveOrder", "Intel") == "Intel" else ">"
            signed = image.texts.get("SaveSign", "Signed") == "Signed"
            try:
                unit = parse_unit(image.texts.get("Dim2Unit", ""), dimension="length").factor
            except UnitError:
                unit = None
            if unit is not None:
                whole = image.number("Dim2Range") * unit
                low = image.number("Dim2Min", 0.0) * unit + (whole / 2 if signed else 0.0)
                name = (
                    f"{image.texts.get('Frame', group)} ({image.texts.get('Dim2Name', channel)})"
                )
                dtype = f"{order}{'i' if signed else 'u'}{bits // 8}"
                scale = whole / 2.0**bits
                found[name] = _Block(image, place, dtype, columns, rows, scale, low)
            place += columns * rows * bits // 8
    if not found:
        raise UnsupportedFeatureError(
            f"{file.path}: the Nanosurf file holds no channel in a unit of length; save the topography"
        )
    return found, sections


def _nid_channels(file: RawFile) -> tuple[str, ...]:
    """Return the names of the maps of heights."""
    return tuple(_nid_images(file)[0])


@map_reader(_NID, "Nanosurf", "a Nanosurf file with its own units", several=True)
def _nid_read(asked: Request) -> Surface:
    """Return a map of heights of a Nanosurf file."""
    images, sections = _nid_images(asked.file)
    name = asked.choose(images)
    block = images[name]
    sizes = []
    for axis in ("Dim0", "Dim1"):
        fields = block.fields
        unit = fields.texts.get(f"{axis}Unit") or fields.texts["Dim2Unit"]
        text = f"{fields.number(f'{axis}Range')} {unit}"
        sizes.append(_metres(asked.file, fields, f"{axis}Range", text))
    return _map(asked, block, (sizes[0], sizes[1]), header=_texts(sections), channel=name)


nid = BuiltIn(sniffer(_NID), _nid_channels, _nid_read)


# ---- Igor binary waves, version 5: fields, numbers with x fastest, then note and labels ------------
# Point k of a dimension lies at ``sfB + k sfA``, so the format itself says that y rises with the row.

_IBW = "ibw"
_WAVE = structure(_IBW)
_WAVE_TYPES = {2: "f4", 4: "f8", 8: "i1", 16: "i2", 32: "i4", 72: "u1", 80: "u2", 96: "u4"}
_DATA_AT = 384
_HEADER_PART = 320
_LABEL = 32
_LENGTHS = ("Height", "ZSensor", "MapHeight", "NapHeight", "UserCalcHeight")
"""Begin of the names of channels that hold heights in metres, whatever unit the wave states."""


def _ibw_wave(file: RawFile) -> tuple[Fields, str, list[str]]:
    """Return header, byte order and names of the layers of a wave."""
    demand(file, _IBW)
    order = "<" if file.head[:1] == b"\x05" else ">"
    header = replace(_WAVE, order=order).read(file)
    sizes = [
        header[n] for n in ("formula", "note", "data_unit", *(f"dim_unit_{k}" for k in range(4)))
    ]
    labels = [header[f"dim_label_{k}"] for k in range(4)]
    if min(header["wave"] - _HEADER_PART, *sizes, *labels) < 0:
        raise header.error("wave", "sizes that are not negative")
    total = _DATA_AT - _HEADER_PART + header["wave"] + sum(sizes) + sum(labels)
    need_bytes(file, 0, total, "the wave with its note and labels", name="wave")
    place = total - sum(labels) + labels[0] + labels[1]
    texts = file.data[place : place + labels[2]]
    parts = [texts[k : k + _LABEL] for k in range(_LABEL, len(texts), _LABEL)]
    names = [p.split(b"\0")[0].decode("latin-1") for p in parts]
    n_layers = max(header["n_2"], 1)
    if n_layers > 1000:
        raise header.error("n_2", "at most 1000 layers")
    return (
        header,
        order,
        [(*names, *[""] * n_layers)[k] or f"layer {k + 1}" for k in range(n_layers)],
    )


def _ibw_channels(file: RawFile) -> tuple[str, ...]:
    """Return the names of the layers."""
    return tuple(_ibw_wave(file)[2])


@map_reader(_IBW, "Igor", several=True)
def _ibw_read(asked: Request) -> Surface | Profile:
    """Return one layer of an Igor wave, or a wave of one dimension as a profile."""
    file = asked.file
    header, order, names = _ibw_wave(file)
    name = asked.choose(names)
    if header["type"] not in _WAVE_TYPES or header["n_3"] != 0:
        raise UnsupportedFeatureError(
            f"{file.path}: the wave is of type {header['type']} with {header['n_3']} parts in its fourth "
            "dimension; only real numbers in up to three dimensions are read"
        )
    columns, rows = (
        header.area("n_0", "n_1", asked.max_pixels) if header["n_1"] else (header["n_0"], 1)
    )
    lateral, along, height = _ibw_units(asked, header, name)
    dtype = order + _WAVE_TYPES[header["type"]]
    layer = columns * rows * np.dtype(dtype).itemsize
    if header["wave"] != _HEADER_PART + layer * len(names):
        raise header.error("wave", _HEADER_PART + layer * len(names))
    start = _DATA_AT + layer * names.index(name)
    block = _Block(TextFields(file), start, dtype, columns, rows, height)
    z = scaled(_raw(file, block, asked.max_pixels), height)
    dx, dy = header["step_0"] * lateral, header["step_1"] * along
    if header["n_1"] == 0:
        x = (header["start_0"] * lateral) + dx * np.arange(columns)
        return asked.profile(x, z[0], header=header, channel=name)
    if not (0.0 < dx < 1.0 and 0.0 < dy < 1.0):
        raise header.error("step_0", "rising positions, steps below 1 m")
    return asked.surface(
        z,
        (dx, dy),
        row_order=_UP,
        header=header,
        channel=name,
        origin=(header["start_0"] * lateral, header["start_1"] * along),
    )


def _ibw_units(asked: Request, header: Fields, name: str) -> tuple[float, float, float]:
    """Return metres per unit of x, of y and of the heights of a layer."""
    heights = "m" if header["note"] and name.startswith(_LENGTHS) else header["unit_z"]
    own = {"x": header["unit_0"], "y": header["unit_1"] or header["unit_0"], "heights": heights}
    factors = []
    for what, text in own.items():
        unit = text or str(asked.unit or "")
        try:
            factors.append(parse_unit(unit, dimension="length").factor)
        except UnitError:
            raise UnitError(
                f"{asked.file.path}: {what} of layer {name!r}: the unit is {unit or 'not stated'!r}, which "
                "is not a length; where the file states none, declare it with unit="
            ) from None
    return factors[0], factors[1], factors[2]


ibw = BuiltIn(sniffer(_IBW), _ibw_channels, _ibw_read)
