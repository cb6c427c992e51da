"""The zip archive and the XML of an X3P file, opened as if a stranger had sent it.

Nothing is inflated beyond the size that the reader asked for, nothing outside the archive is
touched, and the XML may hold no document type, entity or external reference.
"""

from __future__ import annotations

import hashlib
import io
import zipfile
import zlib
from pathlib import PurePosixPath
from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

import numpy as np

from metrosep._version import __version__
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, UnsupportedFeatureError, WriteError
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.io.own_notes import comment_text

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

    from metrosep.io.source import RawFile

__all__ = ["Container", "flatten", "md5", "parse_xml"]

_MAX_XML = 2**25
_SUSPECT_BYTES = 2**28
_SUSPECT_RATIO = 200
"""Members above 256 MiB that claim to shrink more than 200:1 are taken for a zip bomb."""

_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_DAMAGE = (
    zipfile.BadZipFile,
    zlib.error,
    EOFError,
    OSError,
    ValueError,
    RuntimeError,
    NotImplementedError,
    OverflowError,
)


def md5(data: bytes) -> str:
    """Return the MD5 of bytes, as the format demands it; not for security."""
    return hashlib.md5(data, usedforsecurity=False).hexdigest()


class Container:
    """Members of an X3P archive."""

    def __init__(self, file: RawFile) -> None:
        self._file = file
        self.warnings: list[str] = []
        try:
            self._zip = zipfile.ZipFile(io.BytesIO(file.data))
        except _DAMAGE as exc:
            raise self._corrupt(f"is not a whole zip archive ({_short(exc)})") from None
        self._members = self._list_members()

    def _corrupt(self, reason: str, member: str | None = None) -> CorruptFileError:
        return CorruptFileError(self._file.path, f"the X3P archive {reason}", field=member)

    def _list_members(self) -> dict[str, zipfile.ZipInfo]:
        infos = [
            i
            for i in self._zip.infolist()
            if not i.is_dir() and "__MACOSX" not in i.filename and not i.filename.endswith("/")
        ]
        names = [i.filename for i in infos]
        if len(set(names)) != len(names):
            raise self._corrupt("holds two members of one name")
        prefix = ""
        if "main.xml" not in names:
            found = [n for n in names if n.count("/") == 1 and n.endswith("/main.xml")]
            if len(found) != 1:
                raise self._corrupt("holds no main.xml")
            prefix = found[0].removesuffix("main.xml")
            self.warnings.append(f"the content lies in the folder {prefix!r} of the archive")
        return {i.filename.removeprefix(prefix): i for i in infos if i.filename.startswith(prefix)}

    def __contains__(self, member: str) -> bool:
        return member in self._members

    def read(self, member: str, *, limit: int = _MAX_XML, trusted: bool = False) -> bytes:
        """Return the content of a member."""
        parts = PurePosixPath(member.replace("\\", "/")).parts
        if ".." in parts or member.startswith(("/", "\\")) or ":" in member:
            raise self._corrupt("points to a file outside of itself, which is never read", member)
        if member not in self._members:
            raise self._corrupt(f"has no member {member!r}", member)
        info = self._members[member]
        if info.flag_bits & 0x1:
            raise UnsupportedFeatureError(f"{self._file.path}: is encrypted; save it without")
        if info.compress_type not in _METHODS:
            raise UnsupportedFeatureError(
                f"{self._file.path}: packs {member} with method {info.compress_type}; save it with "
                "deflate"
            )
        self._check_size(info, member, limit, trusted=trusted)
        try:
            with self._zip.open(info) as stream:
                data = stream.read(limit + 1)
        except _DAMAGE as exc:
            raise self._corrupt(f"is damaged ({_short(exc)})", member) from None
        if len(data) > limit or len(data) != info.file_size:
            raise self._corrupt(
                f"holds {len(data)} bytes where its directory claims {info.file_size}", member
            )
        return data

    def _check_size(
        self, info: zipfile.ZipInfo, member: str, limit: int, *, trusted: bool
    ) -> None:
        if info.file_size > limit:
            raise CorruptFileError(
                self._file.path,
                "a member of the X3P archive is larger than it may be",
                field=member,
                expected=f"at most {limit} bytes",
                found=f"{info.file_size} bytes",
            )
        ratio = info.file_size / max(info.compress_size, 1)
        if info.file_size > _SUSPECT_BYTES and ratio > _SUSPECT_RATIO and not trusted:
            raise UnsupportedFeatureError(
                f"{self._file.path}: {member} would swell {ratio:.0f} times to {info.file_size} bytes, "
                "as a zip bomb does; pass max_pixels= if the map is really that large"
            )


def _short(exc: BaseException) -> str:
    """Return the first words of a message; zipfile quotes whole headers."""
    words = " ".join(str(exc).split())
    return words if len(words) <= 80 else words[:80] + " ..."


def parse_xml(file: RawFile, data: bytes) -> Element:
    """Return the root of a document without document type, entities or references."""
    from xml.etree.ElementTree import ParseError

    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import fromstring

    try:
        root: Element = fromstring(data, forbid_dtd=True)
    except ParseError as exc:
        raise CorruptFileError(
            file.path, f"main.xml is not well-formed ({exc})", field="main.xml"
        ) from None
    except DefusedXmlException as exc:
        raise CorruptFileError(
            file.path,
            f"main.xml declares a document type or entities ({type(exc).__name__}), which X3P does not",
            field="main.xml",
            hint="do not trust this file; ask its sender",
        ) from None
    except (ValueError, LookupError) as exc:
        raise CorruptFileError(
            file.path, f"main.xml cannot be decoded ({exc})", field="main.xml"
        ) from None
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
            raise WriteError(
                "the surface is laterally not calibrated and X3P needs both steps; give them on "
                "reading with lateral_step=(dx, dy)"
            )
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
