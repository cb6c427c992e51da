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

from metrosep.core.errors import CorruptFileError, UnsupportedFeatureError

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
