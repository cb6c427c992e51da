"""Worksheets of an ``.xlsx`` file, opened as if a stranger had sent it.

Only cells are read: no formulas, no external links, no styles. Sizes are checked in the directory of
the archive before anything is inflated, and the XML may hold no document type or entity. It needs
no other package than ``defusedxml``.
"""

from __future__ import annotations

import io
import re
import struct
import zipfile
import zlib
from collections.abc import Collection, Iterator
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from metrosep.core.errors import (
    CorruptFileError,
    FormatMismatchError,
    UnsupportedFeatureError,
)
from metrosep.io.source import RawFile

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

__all__ = ["Cells", "Workbook", "zip_members"]

Cells: TypeAlias = list[tuple[int, dict[str, float | str]]]
"""Number of each row, from 1, and its cells by column letter; empty cells are left out."""

_LOCAL_HEADER = b"PK\x03\x04"
_MAX_MEMBER = 2**24
"""Largest size in bytes of an XML member; 30000 rows take 1 MB."""

_SHOWN = 2**16
"""Bytes of a member that a recogniser looks at."""

_MAX_RATIO = 400
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_DAMAGE = (
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    EOFError,
    OSError,
    ValueError,
    RuntimeError,
    NotImplementedError,
    OverflowError,
)
_PLACE = re.compile(r"([A-Z]{1,3})(\d{1,7})")


def zip_members(file: RawFile, *wanted: str) -> dict[str, bytes]:
    """Return the members by name with the start of those wanted; of a cut archive, those in its head."""
    if not file.head.startswith(_LOCAL_HEADER):
        return {}
    try:
        with file.stream() as handle, zipfile.ZipFile(handle) as archive:
            return {n: _start(archive, n) if n in wanted else b"" for n in archive.namelist()}
    except _DAMAGE:
        pass
    members = {}
    at = file.head.find(_LOCAL_HEADER)
    while 0 <= at <= len(file.head) - 30:
        method, n_name, n_extra = struct.unpack_from("<8xH16xHH", file.head, at)
        name = file.head[at + 30 : at + 30 + n_name].decode("latin-1")
        content = file.head[at + 30 + n_name + n_extra :]
        try:
            if method == zipfile.ZIP_DEFLATED:
                content = zlib.decompressobj(-15).decompress(content, _SHOWN)
        except zlib.error:
            content = b""
        members[name] = content[:_SHOWN]
        at = file.head.find(_LOCAL_HEADER, at + 4)
    return members


def _start(archive: zipfile.ZipFile, name: str) -> bytes:
    try:
        with archive.open(name) as stream:
            return stream.read(_SHOWN)
    except _DAMAGE:
        return b""


class Workbook:
    """Worksheets of a file, by name."""

    def __init__(self, file: RawFile) -> None:
        self._file = file
        if not file.head.startswith(_LOCAL_HEADER):
            raise FormatMismatchError(
                f"{file.path}: is no workbook: expected 50 4b 03 04 at offset 0, found "
                f"{file.head[:4].hex(' ')}; leave out format= to have it recognised"
            )
        try:
            self._zip = zipfile.ZipFile(io.BytesIO(file.data))
        except _DAMAGE as exc:
            raise self._corrupt(f"is not a whole zip archive ({_short(exc)})") from None
        self._members = {i.filename: i for i in self._zip.infolist()}
        self._sheets = self._list_sheets()
        self._texts: list[str] | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the worksheets in their order."""
        return tuple(self._sheets)

    def cells(self, sheet: str, columns: Collection[str] = (), stop: int | None = None) -> Cells:
        """Return the cells of a worksheet that hold something."""
        if sheet not in self._sheets:
            raise self._corrupt(f"has no worksheet {sheet!r}")
        member = self._sheets[sheet]
        rows: Cells = []
        for row in self._elements(member, "row"):
            number = len(rows) + 1
            found: dict[str, float | str] = {}
            for cell in row:
                place = _PLACE.fullmatch(cell.get("r", ""))
                if place is None:
                    raise self._corrupt("has a cell without a place", member)
                number = int(place[2])
                if not columns or place[1] in columns:
                    value = self._value(cell, member)
                    if value is not None:
                        found[place[1]] = value
            if found:
                rows.append((number, found))
            if len(rows) == stop:
                break
        return rows

    def _value(self, cell: Element, member: str) -> float | str | None:
        kind = cell.get("t", "n")
        text = "".join(t.text or "" for t in cell.iter() if _tag(t) in {"v", "t"})
        if not text or kind == "e":
            return None
        if kind in {"str", "inlineStr", "d", "b"}:
            return text
        try:
            if kind == "s":
                return self._shared()[_index(text)]
            number = float(text)
        except (ValueError, IndexError):
            raise self._corrupt(f"has a cell {text[:20]!r} that is no value", member) from None
        if not np.isfinite(number):
            raise self._corrupt(f"has a cell {text[:20]!r} that is not finite", member)
        return number

    def _shared(self) -> list[str]:
        if self._texts is None:
            items = self._elements("xl/sharedStrings.xml", "si")
            self._texts = ["".join(item.itertext()) for item in items]
        return self._texts

    def _list_sheets(self) -> dict[str, str]:
        targets = {
            e.get("Id", ""): e.get("Target", "")
            for e in self._elements("xl/_rels/workbook.xml.rels", "Relationship")
            if e.get("TargetMode", "Internal") == "Internal"
        }
        sheets: dict[str, str] = {}
        for element in self._elements("xl/workbook.xml", "sheet"):
            ids = [v for k, v in element.attrib.items() if k.rsplit("}", 1)[-1] == "id"]
            target = targets.get(ids[0] if ids else "", "")
            member = target[1:] if target.startswith("/") else f"xl/{target}"
            if member in self._members and member.startswith("xl/worksheets/"):
                sheets[element.get("name", "")] = member
        if not sheets:
            raise self._corrupt("has no worksheet")
        return sheets

    def _elements(self, member: str, tag: str) -> Iterator[Element]:
        """Yield the elements of one name, each emptied after use."""
        from xml.etree.ElementTree import ParseError

        from defusedxml import DefusedXmlException
        from defusedxml.ElementTree import iterparse

        stream = io.BytesIO(self._bytes(member))
        try:
            for _, element in iterparse(stream, forbid_dtd=True):
                if _tag(element) == tag:
                    yield element
                    element.clear()
        except DefusedXmlException as exc:
            raise CorruptFileError(
                self._file.path,
                f"{member} declares a document type or entities ({type(exc).__name__})",
                field=member,
                hint="do not trust this file; ask its sender",
            ) from None
        except ParseError as exc:
            raise self._corrupt(f"is not well-formed ({exc})", member) from None
        except (LookupError, UnicodeError) as exc:
            raise self._corrupt(f"cannot be decoded ({_short(exc)})", member) from None

    def _bytes(self, member: str) -> bytes:
        info = self._members.get(member)
        if info is None:
            raise self._corrupt("has no such member", member)
        if info.flag_bits & 0x1 or info.compress_type not in _METHODS:
            raise UnsupportedFeatureError(
                f"{self._file.path}: {member} is encrypted or packed in an unusual way; save the workbook "
                "again without a password"
            )
        ratio = info.file_size / max(info.compress_size, 1)
        if info.file_size > _MAX_MEMBER or (ratio > _MAX_RATIO and info.file_size > 2**20):
            raise CorruptFileError(
                self._file.path,
                "a member of the workbook is larger than it may be",
                field=member,
                expected=f"at most {_MAX_MEMBER} bytes, packed no more than {_MAX_RATIO}:1",
                found=f"{info.file_size} bytes, {ratio:.0f}:1",
            )
        try:
            with self._zip.open(info) as stream:
                data = stream.read(_MAX_MEMBER + 1)
        except _DAMAGE as exc:
            raise self._corrupt(f"is damaged ({_short(exc)})", member) from None
        if len(data) != info.file_size:
            raise self._corrupt(f"holds {len(data)} of {info.file_size} bytes", member)
        return data

    def _corrupt(self, reason: str, member: str | None = None) -> CorruptFileError:
        return CorruptFileError(
            self._file.path,
            f"the workbook {reason}",
            field=member,
            hint="save it again as .xlsx",
        )


def _tag(element: Element) -> str:
    return str(element.tag).rsplit("}", 1)[-1]


def _index(text: str) -> int:
    """Return a place in the list of texts; a negative one would count from its end."""
    if not text.isdecimal():
        raise ValueError(text)
    return int(text)


def _short(exc: BaseException) -> str:
    """Return the first words of a message; zipfile quotes whole headers."""
    return " ".join(str(exc).split())[:80]
