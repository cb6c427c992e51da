"""Bytes of an X3P file from a surface or a profile; the same object gives the same bytes.

Heights are stored as double precision numbers in metres, so that reading them back gives the same
numbers; NaN marks what was not measured. The history of the object travels in the
comment, and of a profile its kind and cut-offs.
"""

from __future__ import annotations

import io
import zipfile
from xml.etree import ElementTree as ET

import numpy as np

from metrosep._version import __version__
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import WriteError
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.io.own_notes import comment_text
from metrosep.io.x3p_container import md5

__all__ = ["x3p_bytes"]

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
