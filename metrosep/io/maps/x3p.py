"""X3P (ISO 25178-72): surfaces and profiles in metres, a zip archive with a description in XML.

A value is ``raw * Increment + Offset`` of its axis, the z axis included. Points lie x-fastest; the
first row has the smallest y. Not measured is NaN, an empty ``Datum``, or a zero bit in the
validity file (least significant bit first). A wrong MD5 is a warning, not an error: files with
wrong sums are in circulation. See ``data_formats/x3p/SPEC.md``.
"""

from __future__ import annotations

import hashlib
import io
import math
import zipfile
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple
from xml.etree import ElementTree as ET

import numpy as np

from metrosep._version import __version__
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    DataError,
    FormatMismatchError,
    UnsupportedFeatureError,
    WriteError,
)
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.io.archive import Archive, xml_of
from metrosep.io.objects import (
    Request,
    height_only,
    map_reader,
    not_calibrated,
    to_grid,
)
from metrosep.io.own_notes import OwnNotes, comment_notes, comment_text
from metrosep.io.registry import mismatch, sniffer
from metrosep.io.source import MAX_PIXELS, RawFile, flat_map, refuse_options

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

channels = height_only

FORMAT = "x3p"


sniff = sniffer(FORMAT)


@map_reader(FORMAT, "X3P", "an X3P file in metres")
def read(asked: Request) -> Surface | Profile:
    """Return the surface or profile of an X3P file.

    Notes
    -----
    A list of points (PCL), or a surface whose points carry their positions, is a surface if they
    lie on a regular grid, in any order; then `lateral_step` is refused.
    """
    file = asked.file
    if not file.head.startswith(b"PK"):
        raise mismatch(file, FORMAT)
    container = Container(file)
    document = container.read("main.xml", limit=_MAX_XML)
    root = parse_xml(container, document)
    warnings = asked.warnings = container.warnings
    if not root.tag.startswith("ISO5436"):
        raise file.corrupt("the XML is of something else", expected="ISO5436_2", found=root.tag)
    if root.tag != "ISO5436_2":
        warnings.append(f"the root element is {root.tag!r} instead of 'ISO5436_2'")
    _check_document_sum(container, document, warnings)
    axes = read_axes(file, root, warnings)
    shape = read_shape(file, root, asked.max_pixels or MAX_PIXELS)
    refuse_unread(file, root, axes, shape)
    trusted = asked.max_pixels is not None
    values = read_points(file, container, root, axes, shape, trusted=trusted)
    warnings.extend(flat_map(values["CZ"]))
    header = flatten(root)
    _note_rotation(header, warnings)
    notes = comment_notes(file, header.get("Record2/Comment", ""))
    warnings.extend(notes.warnings)
    has_positions = axes[0].is_absolute or axes[1].is_absolute
    build = _profile if feature(root) == "PRF" else _gridded if has_positions else _surface
    try:
        return build(_Content(asked, axes, shape, values, header, notes))
    except DataError as exc:
        raise FormatMismatchError(f"{file.path}: {exc}") from None


def _check_document_sum(container: Container, document: bytes, warnings: list[str]) -> None:
    if "md5checksum.hex" not in container.members:
        warnings.append("md5checksum.hex is missing")
        return
    text = container.read("md5checksum.hex", limit=4096).decode("latin-1").split()
    if not text or text[0].lower() != md5(document):
        warnings.append("the MD5 of main.xml is wrong: the description was changed after writing")


def _note_rotation(header: dict[str, str], warnings: list[str]) -> None:
    identity = {"r11": 1.0, "r22": 1.0, "r33": 1.0}
    for key, text in header.items():
        if "/Rotation/" not in key:
            continue
        try:
            turned = float(text) != identity.get(key.rsplit("/", 1)[-1], 0.0)
        except ValueError:
            turned = True
        if turned:
            warnings.append("the file's Rotation was not applied: heights are in its own frame")
            return


class _Content(NamedTuple):
    """What the description and the points say, on its way to an object."""

    asked: Request
    axes: tuple[Axis, ...]
    shape: tuple[int, int]
    values: dict[str, FloatArray]
    header: dict[str, str]
    notes: OwnNotes

    def described(self, parameters: dict[str, Any] | None = None, **facts: Any) -> dict[str, Any]:
        """Return metadata and history of the object."""
        names = (f"Record2/Instrument/{k}" for k in ("Manufacturer", "Model", "Serial"))
        file = self.asked.file
        return {
            "metadata": file.metadata(
                FORMAT,
                self.header,
                warnings=tuple(self.asked.warnings),
                instrument=" ".join(self.header.get(name, "") for name in names).strip(),
                **facts,
            ),
            "history": (*self.notes.history, *file.history(FORMAT, parameters)),
        }


def _surface(content: _Content) -> Surface:
    axes, shape, override = content.axes, content.shape, content.asked.override
    z = content.values["CZ"].reshape(shape)
    origin = []
    for axis, direction, n in ((axes[0], 1, shape[1]), (axes[1], 0, shape[0])):
        start = axis.offset
        if axis.increment < 0.0:
            z = np.flip(z, axis=direction)
            start += axis.increment * (n - 1)
        origin.append(start)
    own = (abs(axes[0].increment), abs(axes[1].increment))
    dx, dy = override or own
    described = content.described(
        {"lateral_step_m": override},
        orientation_evidence="standard",
        row_order_in_file="smallest y first" if axes[1].increment > 0 else "largest y first",
        lateral_step_in_file_m=own,
        lateral_step_override_m=override,
    )
    return Surface(z, dx, dy, origin=(origin[0], origin[1]), **described)


def _gridded(content: _Content) -> Surface:
    asked, shape = content.asked, content.shape
    title = "an X3P file with a position for each point"
    refuse_options(asked.file, title, lateral_step=asked.override)
    z, steps, origin = on_grid(asked.file, content.axes, shape, content.values, asked.warnings)
    described = content.described(
        orientation_evidence="coordinates",
        row_order_in_file="points placed by their positions",
        lateral_step_in_file_m=steps,
        lateral_step_override_m=None,
        n_points=shape[0] * shape[1],
    )
    return Surface(z, *steps, origin=origin, **described)


def _profile(content: _Content) -> Profile:
    asked, axis, z = content.asked, content.axes[0], content.values["CZ"]
    if axis.is_absolute:
        title = "an X3P profile with its own positions"
        refuse_options(asked.file, title, lateral_step=asked.override)
        x = content.values["CX"]
        known = ~np.isnan(x)
        if not known.all():
            asked.warnings.append(f"{int((~known).sum())} points without a position were omitted")
            x, z = x[known], z[known]
    else:
        step = axis.increment if asked.step is None else asked.step
        x = axis.offset + step * np.arange(content.shape[1], dtype=np.float64)
    if content.axes[1].is_absolute:
        asked.warnings.append("the y positions of the profile were not kept")
    described = content.described(
        lateral_step_in_file_m=None if axis.is_absolute else axis.increment,
        lateral_step_override_m=asked.step,
        **content.notes.facts,
    )
    return Profile(x, z, **described)


# ---- points of an X3P file that carry their positions become a map, if they lie on a regular grid ----

_MAX_GAPS = 64.0
"""Pixels of a grid per point of a list; with more the points are taken for scattered."""

_SAME = 1e-12
"""Positions closer than this, relative to the span, are one position."""


def on_grid(
    file: RawFile,
    axes: tuple[Axis, ...],
    shape: tuple[int, int],
    values: dict[str, FloatArray],
    warnings: list[str],
) -> tuple[FloatArray, tuple[float, float], tuple[float, float]]:
    """Return points that carry their positions as a map, if they lie on a regular grid."""
    row, column = np.divmod(np.arange(shape[0] * shape[1]), shape[1])
    x, y = (
        values[a.name] if a.is_absolute else a.metres(np.asarray(index, dtype=np.float64))
        for a, index in zip(axes, (column, row), strict=False)
    )
    known = ~(np.isnan(x) | np.isnan(y))
    if not known.all():
        warnings.append(f"{int((~known).sum())} points without a position were omitted")
    x, y, z = x[known], y[known], values["CZ"][known]
    reason = "there are too few of them for a grid"
    if z.size and _n_steps(x) * _n_steps(y) <= _MAX_GAPS * z.size:
        try:
            return to_grid(file, x, y, z)
        except FormatMismatchError as exc:
            reason = str(exc).removeprefix(f"{file.path}: ")
    raise UnsupportedFeatureError(
        f"{file.path}: the points of the X3P file are scattered, not on a regular grid ({reason}); "
        "resample them to a grid and save it as a surface (SUR)"
    )


def _n_steps(values: FloatArray) -> float:
    """Return how many of the smallest steps the positions span."""
    levels = np.unique(values)
    steps = np.diff(levels)
    steps = steps[steps > _SAME * (levels[-1] - levels[0])]
    return float((levels[-1] - levels[0]) / steps.min()) + 1.0 if steps.size else 1.0


# ---- axes, sizes and points of an X3P file, checked before anything is allocated ---------------

_TYPES = {"I": "<i2", "L": "<i4", "F": "<f4", "D": "<f8"}
_AXES = ("CX", "CY", "CZ")
_MAX_STEP = 1e3
"""Largest lateral step in m that is taken for one."""


@dataclass(frozen=True, slots=True)
class Axis:
    """One axis of the file."""

    name: str  # ``CX``, ``CY`` or ``CZ``
    # whether its coordinates are stored; an incremental axis counts from its offset
    is_absolute: bool
    dtype: str  # type of a stored coordinate
    increment: float  # m: ``metres = raw * increment + offset``
    offset: float

    def metres(self, raw: FloatArray) -> FloatArray:
        """Return stored coordinates in m."""
        return raw * self.increment + self.offset


def feature(root: Element) -> str:
    """Return the kind of the data."""
    return (root.findtext("Record1/FeatureType") or "SUR").strip().upper()


def _number(file: RawFile, text: str | None, field: str, default: float | None = None) -> float:
    if (text is None or not text.strip()) and default is not None:
        return default
    try:
        value = float((text or "").strip())
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise file.corrupt(
            "a number is not usable", field=field, expected="a finite number", found=text
        )
    return value


def read_axes(file: RawFile, root: Element, warnings: list[str]) -> tuple[Axis, ...]:
    """Return the three axes."""
    axes = []
    for name in _AXES:
        element = root.find(f"Record1/Axes/{name}")
        if element is None:
            raise file.corrupt("an axis is missing", field=f"Record1/Axes/{name}")
        kind = (element.findtext("AxisType") or "").strip().upper()
        code = (element.findtext("DataType") or "D").strip().upper()
        if kind not in {"I", "A"} or code not in _TYPES:
            raise file.corrupt(
                "an axis is of unknown type",
                field=name,
                expected="AxisType I or A, DataType I, L, F or D",
                found=f"{kind or 'nothing'}, {code}",
            )
        text = element.findtext("Increment")
        if kind == "A" and _TYPES[code][1] == "i" and not (text or "").strip():
            warnings.append(f"axis {name} stores integers without an increment: taken as 1 m")
        increment = _number(file, text, f"{name}/Increment", 1.0 if kind == "A" else None)
        if increment == 0.0 or (kind == "I" and abs(increment) > _MAX_STEP):
            raise file.corrupt(
                "a step is not usable",
                field=f"{name}/Increment",
                expected=f"not 0 and at most {_MAX_STEP:g} m",
                found=increment,
            )
        offset = _number(file, element.findtext("Offset"), f"{name}/Offset", 0.0)
        axes.append(Axis(name, kind == "A", _TYPES[code], increment, offset))
    return tuple(axes)


def read_shape(file: RawFile, root: Element, max_pixels: int) -> tuple[int, int]:
    """Return the size of the map, before anything is allocated."""
    if root.find("Record3/MatrixDimension") is None and feature(root) == "PCL":
        columns, rows, layers = _size(file, root, "ListDimension"), 1, 1
    else:
        columns, rows, layers = (
            _size(file, root, f"MatrixDimension/Size{axis}") for axis in "XYZ"
        )
    if layers != 1:
        raise UnsupportedFeatureError(
            f"{file.path}: the X3P file holds {layers} layers; save the one you need on its own"
        )
    if columns * rows > max_pixels:
        raise UnsupportedFeatureError(
            f"{file.path}: claims {columns} x {rows} points, more than {max_pixels}; pass max_pixels= "
            "if that is true"
        )
    return rows, columns


def _size(file: RawFile, root: Element, name: str) -> int:
    text = (root.findtext(f"Record3/{name}") or "").strip()
    if not (text.isascii() and text.isdecimal() and len(text) < 12 and int(text) > 0):
        raise file.corrupt(
            "the size of the map is not usable",
            field=name,
            expected="a whole number above 0",
            found=text[:40] or "nothing",
        )
    return int(text)


def refuse_unread(
    file: RawFile, root: Element, axes: tuple[Axis, ...], shape: tuple[int, int]
) -> None:
    """Refuse what is legal X3P and not read."""
    kind = feature(root)
    if kind not in {"SUR", "PRF", "PCL"}:
        raise UnsupportedFeatureError(
            f"{file.path}: X3P feature {kind[:20]!r} is not read; save it as a surface (SUR) or profile "
            "(PRF)"
        )
    if kind == "PCL" and not (axes[0].is_absolute and axes[1].is_absolute):
        raise file.corrupt("a list of points needs absolute axes", field="AxisType", expected="A")
    if not axes[2].is_absolute:
        raise file.corrupt(
            "the z axis must be absolute", field="CZ/AxisType", expected="A", found="I"
        )
    if kind == "PRF" and shape[0] != 1:
        raise file.corrupt("a profile has one row", field="SizeY", expected=1, found=shape[0])


def read_points(
    file: RawFile,
    container: Container,
    root: Element,
    axes: tuple[Axis, ...],
    shape: tuple[int, int],
    *,
    trusted: bool,
) -> dict[str, FloatArray]:
    """Return the stored coordinates of each absolute axis."""
    stored = [a for a in axes if a.is_absolute]
    count = shape[0] * shape[1]
    link = (root.findtext("Record3/DataLink/PointDataLink") or "").strip()
    if link:
        raw = _binary_points(file, container, root, link, stored, count, trusted=trusted)
    elif root.find("Record3/DataList") is not None:
        raw = _text_points(file, root, stored, count)
    else:
        raise file.corrupt("the description names no data", field="Record3")
    values = {a.name: a.metres(raw[a.name]) for a in stored}
    for v in values.values():
        v[~np.isfinite(v)] = np.nan
    if np.isnan(values["CZ"]).all():
        raise file.corrupt(
            "no point was measured",
            expected="at least one valid height",
            found=f"{count} invalid ones",
            hint="measure again, or check the mask of the export",
        )
    return values


def _binary_points(
    file: RawFile,
    container: Container,
    root: Element,
    link: str,
    stored: list[Axis],
    count: int,
    *,
    trusted: bool,
) -> dict[str, FloatArray]:
    record = np.dtype([(a.name, a.dtype) for a in stored])
    expected = count * record.itemsize
    data = container.read(link, limit=max(expected, 1), trusted=trusted)
    if len(data) != expected:
        raise file.corrupt(
            "the data do not fill the map",
            field=link,
            expected=f"{expected} bytes",
            found=f"{len(data)} bytes",
        )
    _check_sum(container, root, "MD5ChecksumPointData", link, data)
    points = np.frombuffer(data, dtype=record)
    raw = {a.name: points[a.name].astype(np.float64) for a in stored}
    mask = (root.findtext("Record3/DataLink/ValidPointsLink") or "").strip()
    if mask:
        n_bytes = (count + 7) // 8
        bits = container.read(mask, limit=n_bytes + 8, trusted=trusted)
        if len(bits) < n_bytes:
            raise file.corrupt(
                "the validity mask is too short",
                field=mask,
                expected=f"{n_bytes} bytes",
                found=f"{len(bits)} bytes",
            )
        _check_sum(container, root, "MD5ChecksumValidPoints", mask, bits)
        packed = np.frombuffer(bits, dtype=np.uint8)
        valid = np.unpackbits(packed, count=count, bitorder="little").astype(bool)
        for column in raw.values():
            column[~valid] = np.nan
    return raw


def _check_sum(container: Container, root: Element, name: str, member: str, data: bytes) -> None:
    claimed = (root.findtext(f"Record3/DataLink/{name}") or "").strip().lower()
    if claimed and claimed != md5(data):
        container.warnings.append(
            f"the MD5 of {member} is wrong: the data were changed after writing"
        )


def _text_points(
    file: RawFile, root: Element, stored: list[Axis], count: int
) -> dict[str, FloatArray]:
    data = root.findall("Record3/DataList/Datum")
    if len(data) != count:
        raise file.corrupt(
            "the list of points does not fill the map",
            field="Record3/DataList",
            expected=f"{count} points",
            found=f"{len(data)}",
        )
    table = np.full((count, len(stored)), np.nan)
    for i, element in enumerate(data):
        fields = [f.strip() for f in (element.text or "").strip().split(";")]
        if fields == [""]:
            continue
        try:
            table[i] = [float(f) for f in fields]
        except ValueError:
            raise file.corrupt(
                "a point of the list is not usable",
                field=f"Datum {i + 1}",
                expected=f"{len(stored)} number(s) separated by ';'",
                found=(element.text or "").strip()[:40],
            ) from None
    return {a.name: table[:, k].copy() for k, a in enumerate(stored)}


# ---- the zip archive and the XML of an X3P file, opened as if a stranger had sent it -----------
# Nothing is inflated beyond the size that the reader asked for, nothing outside the archive is
# touched, and the XML may hold no document type, entity or external reference.

_MAX_XML = 2**25


def md5(data: bytes) -> str:
    """Return the MD5 of bytes, as the format demands it; not for security."""
    return hashlib.md5(data, usedforsecurity=False).hexdigest()


class Container(Archive):
    """Members of an X3P archive by their names in the folder of main.xml."""

    def __init__(self, file: RawFile) -> None:
        super().__init__(file, "the X3P archive")
        self.warnings: list[str] = []
        infos = [
            i
            for i in self.infos()
            if "__MACOSX" not in i.filename and not i.filename.endswith("/")
        ]
        names = [i.filename for i in infos]
        if len(set(names)) != len(names):
            raise self.corrupt("holds two members of one name")
        prefix = ""
        if "main.xml" not in names:
            found = [n for n in names if n.count("/") == 1 and n.endswith("/main.xml")]
            if len(found) != 1:
                raise self.corrupt("holds no main.xml")
            prefix = found[0].removesuffix("main.xml")
            self.warnings.append(f"the content lies in the folder {prefix!r} of the archive")
        self.members = {
            i.filename.removeprefix(prefix): i for i in infos if i.filename.startswith(prefix)
        }


def parse_xml(archive: Archive, data: bytes) -> Element:
    """Return the root of a document without document type, entities or references."""
    from defusedxml.ElementTree import fromstring

    with xml_of(archive, "main.xml"):
        root: Element = fromstring(data, forbid_dtd=True)
    for element in root.iter():
        element.tag = str(element.tag).rsplit("}", 1)[-1]
    return root


def flatten(root: Element) -> dict[str, str]:
    """Return the text of every leaf by its path, such as ``Record1/Axes/CX/Increment``."""
    fields: dict[str, str] = {}

    def visit(element: Element, path: str) -> None:
        for child in element:
            if child.tag == "Datum":
                continue
            name = f"{path}/{child.tag}" if path else str(child.tag)
            if len(child):
                visit(child, name)
                continue
            unique, count = name, 1
            while unique in fields:
                count += 1
                unique = f"{name}#{count}"
            fields[unique] = (child.text or "").strip()

    visit(root, "")
    return fields


# ---- bytes of an X3P file from a surface or a profile; the same object gives the same bytes ----
# Heights are stored as double precision numbers in metres, so that reading them back gives the same
# numbers; NaN marks what was not measured. The history of the object travels in the
# comment, and of a profile its kind and cut-offs.

_NAMESPACE = "http://www.opengps.eu/2008/ISO5436_2"
_DATA = "bindata/data.bin"
_NO_DATE = "1970-01-01T00:00:00"
"""The format demands a date; a clock would make the same object give other bytes."""


def x3p_bytes(obj: Surface | Profile) -> bytes:
    """Return an object as the content of an X3P file."""
    if np.isnan(obj.z).all():
        raise WriteError("nothing was measured, so there is nothing to write as X3P")
    if isinstance(obj, Surface):
        if obj.dx is None or obj.dy is None:
            raise not_calibrated("X3P")
        axes = [(obj.dx, obj.origin[0]), (obj.dy, obj.origin[1])]
        rows, columns = obj.shape
        return _archive("SUR", axes, (columns, rows), obj.z.astype("<f8").tobytes(), obj)
    step = _exact_step(obj.x)
    if step is not None:
        axes = [(step, float(obj.x[0])), (1.0, 0.0)]
        return _archive("PRF", axes, (len(obj), 1), obj.z.astype("<f8").tobytes(), obj)
    points = np.column_stack([obj.x, obj.z]).astype("<f8").tobytes()
    return _archive("PRF", [(None, 0.0), (1.0, 0.0)], (len(obj), 1), points, obj)


def _exact_step(x: FloatArray) -> float | None:
    """Return the step that reproduces the positions bit by bit, or None."""
    if x.size < 2:
        return None
    for step in (float(x[-1] - x[0]) / (x.size - 1), float(x[1] - x[0])):
        if np.array_equal(x[0] + step * np.arange(x.size), x):
            return step
    return None


def _archive(
    feature: str,
    axes: list[tuple[float | None, float]] | list[tuple[float, float]],
    size: tuple[int, int],
    data: bytes,
    obj: Surface | Profile,
) -> bytes:
    document = _document(feature, axes, size, md5(data), obj)
    members = [
        ("main.xml", document),
        (_DATA, data),
        ("md5checksum.hex", f"{md5(document)} *main.xml\n".encode("ascii")),
    ]
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, content in members:
            info = zipfile.ZipInfo(name, date_time=(1980, 1, 1, 0, 0, 0))
            info.external_attr = 0o644 << 16
            info.create_system = 3
            archive.writestr(info, content, compress_type=zipfile.ZIP_DEFLATED, compresslevel=6)
    return stream.getvalue()


def _document(
    feature: str,
    axes: list[tuple[float | None, float]] | list[tuple[float, float]],
    size: tuple[int, int],
    data_md5: str,
    obj: Surface | Profile,
) -> bytes:
    ET.register_namespace("p", _NAMESPACE)
    root = ET.Element(f"{{{_NAMESPACE}}}ISO5436_2")
    record1 = ET.SubElement(root, "Record1")
    _text(record1, "Revision", "ISO5436 - 2000")
    _text(record1, "FeatureType", feature)
    element = ET.SubElement(record1, "Axes")
    for name, (increment, offset) in zip(("CX", "CY"), axes, strict=True):
        _axis(element, name, increment, offset)
    _axis(element, "CZ", None, 0.0)
    record2 = ET.SubElement(root, "Record2")
    _text(record2, "Date", _NO_DATE)
    instrument = ET.SubElement(record2, "Instrument")
    for name, text in (
        ("Manufacturer", "not available"),
        ("Model", "metrosep"),
        ("Serial", "not available"),
        ("Version", __version__),
    ):
        _text(instrument, name, text)
    _text(record2, "CalibrationDate", _NO_DATE)
    probing = ET.SubElement(record2, "ProbingSystem")
    _text(probing, "Type", "Software")
    _text(probing, "Identification", "not available")
    _text(record2, "Comment", comment_text(obj))
    record3 = ET.SubElement(root, "Record3")
    matrix = ET.SubElement(record3, "MatrixDimension")
    for name, count in zip(("SizeX", "SizeY", "SizeZ"), (*size, 1), strict=True):
        _text(matrix, name, str(count))
    link = ET.SubElement(record3, "DataLink")
    _text(link, "PointDataLink", _DATA)
    _text(link, "MD5ChecksumPointData", data_md5)
    _text(ET.SubElement(root, "Record4"), "ChecksumFile", "md5checksum.hex")
    ET.indent(root, space="  ")
    body = ET.tostring(root, encoding="unicode")
    return ('<?xml version="1.0" encoding="UTF-8"?>\n' + body + "\n").encode("utf-8")


def _axis(parent: ET.Element, name: str, increment: float | None, offset: float) -> None:
    """Add an axis: incremental with a step, absolute without one."""
    axis = ET.SubElement(parent, name)
    _text(axis, "AxisType", "A" if increment is None else "I")
    _text(axis, "DataType", "D")
    _text(axis, "Increment", repr(1.0 if increment is None else float(increment)))
    _text(axis, "Offset", repr(float(offset)))


def _text(parent: ET.Element, name: str, text: str) -> None:
    ET.SubElement(parent, name).text = text
