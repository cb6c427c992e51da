"""Zip archives with XML (X3P, workbooks), opened as if a stranger had sent them.

Sizes are checked in the directory of the archive before anything is inflated, nothing outside of it
is touched, and the XML may hold no document type, entity or external reference.
"""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import PurePosixPath

from metrosep.core.errors import CorruptFileError, ReadError, UnsupportedFeatureError
from metrosep.io.source import LOCAL_HEADER, RawFile

_SHOWN = 2**16
"""Bytes of a member that a recogniser looks at."""

_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_DAMAGE = (
    zipfile.BadZipFile, zlib.error, struct.error, EOFError, OSError, ValueError, RuntimeError,
    NotImplementedError, OverflowError,
)  # fmt: skip


def zip_members(file: RawFile, *wanted: str) -> dict[str, bytes]:
    """Return the members by name with the start of those wanted; of a cut archive, those in its head."""
    if not file.head.startswith(LOCAL_HEADER):
        return {}
    try:
        with file.stream() as handle, zipfile.ZipFile(handle) as archive:
            return {n: _start(archive, n) if n in wanted else b"" for n in archive.namelist()}
    except _DAMAGE:
        pass
    members = {}
    at = file.head.find(LOCAL_HEADER)
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
        at = file.head.find(LOCAL_HEADER, at + 4)
    return members


def _start(archive: zipfile.ZipFile, name: str) -> bytes:
    try:
        with archive.open(name) as stream:
            return stream.read(_SHOWN)
    except _DAMAGE:
        return b""


class Archive:
    """Members of a zip archive."""

    suspect_bytes = 2**28
    suspect_ratio = 200
    """Members above so many bytes that claim to shrink more than so are taken for a zip bomb."""

    may_be_trusted = True
    """Whether a caller who allows so many pixels may have them."""

    def __init__(self, file: RawFile, title: str, hint: str | None = None) -> None:
        self.file, self._title = file, title
        self._hint = {} if hint is None else {"hint": hint}
        try:
            self._zip = zipfile.ZipFile(io.BytesIO(file.data))
        except _DAMAGE as exc:
            raise self.corrupt(f"is not a whole zip archive ({_short(exc)})") from None
        self.members = {i.filename: i for i in self._zip.infolist()}

    def corrupt(self, reason: str, member: str | None = None) -> CorruptFileError:
        """Return the error about the archive or one of its members, for the caller to raise."""
        return self.file.corrupt(f"{self._title} {reason}", field=member, **self._hint)

    def infos(self) -> list[zipfile.ZipInfo]:
        """Return all entries of the directory, also those of one name."""
        return self._zip.infolist()

    def read(self, member: str, *, limit: int, trusted: bool = False) -> bytes:
        """Return the content of a member of at most so many bytes."""
        parts = PurePosixPath(member.replace("\\", "/")).parts
        if ".." in parts or member.startswith(("/", "\\")) or ":" in member:
            raise self.corrupt("points to a file outside of itself, which is never read", member)
        info = self.members.get(member)
        if info is None:
            raise self.corrupt(f"has no member {member!r}", member)
        if info.flag_bits & 0x1 or info.compress_type not in _METHODS:
            how = "is encrypted" if info.flag_bits & 0x1 else f"by method {info.compress_type}"
            raise UnsupportedFeatureError(
                f"{self.file.path}: {member} {how}; save it again with deflate and no password"
            )
        ratio = info.file_size / max(info.compress_size, 1)
        suspect = info.file_size > self.suspect_bytes and ratio > self.suspect_ratio
        if info.file_size > limit or (suspect and not self.may_be_trusted):
            raise self.file.corrupt(
                f"a member of {self._title} is larger than it may be",
                field=member,
                expected=f"at most {limit} bytes, not packed like a zip bomb",
                found=f"{info.file_size} bytes, packed {ratio:.0f}:1",
            )
        if suspect and not trusted:
            raise UnsupportedFeatureError(
                f"{self.file.path}: {member} would swell {ratio:.0f} times to {info.file_size} bytes, "
                "as a zip bomb does; pass max_pixels= if the map is really that large"
            )
        try:
            with self._zip.open(info) as stream:
                data = stream.read(limit + 1)
        except _DAMAGE as exc:
            raise self.corrupt(f"is damaged ({_short(exc)})", member) from None
        if len(data) > limit or len(data) != info.file_size:
            raise self.corrupt(
                f"holds {len(data)} bytes where its directory claims {info.file_size}", member
            )
        return data


@contextmanager
def xml_of(archive: Archive, member: str) -> Iterator[None]:
    """Turn what the parser says about XML into one sentence."""
    from xml.etree.ElementTree import ParseError
    from xml.parsers.expat import ExpatError

    from defusedxml import DefusedXmlException

    try:
        yield
    except ReadError:
        raise  # some are a ValueError too
    except (ParseError, ExpatError) as exc:
        raise archive.corrupt(f"is not well-formed ({exc})", member) from None
    except DefusedXmlException as exc:
        raise archive.file.corrupt(
            f"{member} declares a document type or entities ({type(exc).__name__})",
            field=member,
            hint="do not trust this file; ask its sender",
        ) from None
    except (ValueError, LookupError) as exc:
        raise archive.corrupt(f"cannot be decoded ({_short(exc)})", member) from None


def _short(exc: BaseException) -> str:
    """Return the first words of a message; zipfile quotes whole headers."""
    words = " ".join(str(exc).split())
    return words if len(words) <= 80 else words[:80] + " ..."
