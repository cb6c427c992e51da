"""A file as readers see it: its name, its first bytes, its content and its hash.

Opening is done once and in one place, so that a missing file, a folder, an empty file and a file
without permission give the same sentence whatever the format.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import io
import os
import threading
import tomllib
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cache, cached_property, partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    CorruptFileError,
    FileAccessError,
    FileMissingError,
    ReadError,
    ReadOptionError,
    UnsupportedFeatureError,
)
from metrosep.core.inside import carried
from metrosep.core.numbers import positive, steps_of
from metrosep.core.provenance import Step, hash_bytes
from metrosep.core.text_options import TextOptions

HEAD_BYTES = 65536
"""Bytes that a reader may look at to recognise its format."""

MAX_PIXELS = 2**28
"""Largest number of samples that a reader allocates unless ``max_pixels`` says otherwise."""

LOCAL_HEADER = b"PK\x03\x04"
"""First bytes of a zip archive."""

HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
"""First bytes of an HDF5 file, which may stand behind a block of the user."""

_MAX_BYTES = 2**32
_PACKED = {b"\x1f\x8b": "gzip", b"BZh": "bz2", b"\xfd7zXZ\x00": "lzma"}
"""First bytes of files that are compressed as a whole, and the module that unpacks them."""
_ZSTD = b"\x28\xb5\x2f\xfd"
_MAX_UNPACKED, _MAX_RATIO, _UNASKED = 2**31, 200, 2**26
"""Bytes, and times the packed size beyond some bytes, at which unpacking stops."""
_HASH_ASIDE = 2**22
"""Bytes from which a file is hashed by a thread of its own."""


class _Hashing:
    """The hash of a large file, made by a second thread while the content is decoded."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._digest: str | None = None
        self._thread = threading.Thread(target=carried(self._run), daemon=True)
        self._thread.start()

    def _run(self) -> None:
        with suppress(OSError, ReadError), self._path.open("rb") as handle:
            self._digest = hashlib.file_digest(handle, "sha256").hexdigest()

    def result(self) -> str | None:
        """Return the digest, ``None`` where the file could not be read."""
        self._thread.join()
        return self._digest


class RawFile:
    """A file that exists, is not empty and may be read.

    Parameters
    ----------
    path : Path
        Where it is.
    data : bytes, optional
        Its content; read from `path` when first needed if omitted.
    packed : Path, optional
        The file that it was unpacked from, whose hash is given.
    """

    written: Mapping[str, Any] = MappingProxyType({})
    """Text options that are known of a text that was made from a table in a container."""

    notes: tuple[str, ...] = ()
    """Sentences on what is odd about that table."""

    table_format: str = "delimited"
    """Format of a file whose content is a table."""

    asked = TextOptions()
    """How the caller describes the text."""

    def __init__(self, path: Path, data: bytes | None = None, packed: Path | None = None) -> None:
        self.path = path
        self._given = data
        self._packed = packed
        self._hashing: _Hashing | None = None

    @property
    def name(self) -> str:
        """File name without its folder."""
        return self.path.name

    @property
    def in_memory(self) -> bool:
        """Whether the content was given, so that the path need not exist."""
        return self._given is not None

    @cached_property
    def size(self) -> int:
        """Bytes."""
        return self.path.stat().st_size if self._given is None else len(self._given)

    @cached_property
    def data(self) -> bytes:
        """The whole content; refused beyond 4 GiB."""
        if self._given is not None:
            return self._given
        if self.size > _MAX_BYTES:
            raise UnsupportedFeatureError(
                f"{self.path}: holds {self.size} bytes, more than the {_MAX_BYTES} that are read at "
                "once; cut the recording into parts, or read it in chunks with metrosep.io.stream"
            )
        with _explained(self.path):
            data = self.path.read_bytes()
        self.demand_bytes(len(data))
        return data

    def demand_bytes(self, n: int) -> None:
        """Refuse a file of which fewer bytes came than it had when it was opened."""
        if n < self.size:
            raise self.corrupt(
                "became shorter while it was read",
                expected=f"{self.size} bytes",
                found=f"{n}",
                hint="another program writes it anew: read it again when that is done",
            )

    def without_lines(self, *lines: int) -> str:
        """Return the option that leaves lines out too: ``skip_lines='4,7-19'`` with those that the caller gave."""
        spans: list[tuple[int, int]] = []
        given = ((r.start, r.stop - 1) for r in self.asked.skip_lines)
        for first, last in sorted([*given, *((n, n) for n in lines)]):
            if spans and first <= spans[-1][1] + 1:
                spans[-1] = (spans[-1][0], max(spans[-1][1], last))
            else:
                spans.append((first, last))
        listed = (f"{a}" if a == b else f"{a}-{b}" for a, b in spans)
        return f"skip_lines='{','.join(listed)}'"

    def also_missing(self, word: str) -> str:
        """Return the option that takes a word for "not measured" beside those that the caller gave."""
        given = (
            repr(m).removesuffix(".0") if isinstance(m, float) else m
            for m in self.asked.missing or ()
        )
        return f"missing='{','.join([*given, word])}'"

    def hash_aside(self) -> None:
        """Begin to hash a large file in a second thread, since the hash will be needed."""
        if self._given is None and self._hashing is None and self.size > _HASH_ASIDE:
            self._hashing = _Hashing(self.path)

    @cached_property
    def head(self) -> bytes:
        """The first `HEAD_BYTES` bytes."""
        with self.stream() as handle:
            head = handle.read(HEAD_BYTES)
        self.demand_bytes(len(head) + max(self.size - HEAD_BYTES, 0))
        return head

    @cached_property
    def head_lines(self) -> bytes:
        """The whole lines in the first `HEAD_BYTES` bytes; of one longer line, as much as there is."""
        head = self.head
        if len(head) == self.size or b"\0" in head[:64]:  # UTF-16 has a mark of its own for lines
            return head
        return head[: head.rfind(b"\n") + 1] or head

    def stream(self) -> io.BufferedReader | io.BytesIO:
        """Return an open binary file at its start; the caller closes it."""
        if self._given is not None:
            return io.BytesIO(self._given)
        with _explained(self.path):
            return self.path.open("rb")

    def corrupt(self, reason: str, **facts: Any) -> CorruptFileError:
        """Return the error about bytes that do not fit their format, for the caller to raise."""
        return CorruptFileError(self.path, reason, **facts)

    def cut_text(self) -> list[str]:
        """Return a warning where a text ends without a line end, in its last number perhaps."""
        if self.data[-4:].rstrip(b"\0")[-1:].isspace():
            return []
        return ["the file does not end with a line end; its last number may be cut off"]

    @cached_property
    def sha256(self) -> str:
        """SHA-256 of the content, 64 hexadecimal digits."""
        if self._hashing is not None and (digest := self._hashing.result()) is not None:
            return digest
        if self._packed is None and (self._given is not None or "data" in self.__dict__):
            return hash_bytes(self.data)
        with self._packed.open("rb") if self._packed else self.stream() as handle:
            return hashlib.file_digest(handle, "sha256").hexdigest()

    def history(self, format_id: str, parameters: Mapping[str, Any] | None = None) -> tuple[Step]:
        """Return the history of an object read from this file: one step ``read``.

        Parameters
        ----------
        format_id : str
            Identifier of the format.
        parameters : mapping, optional
            What the caller declared, plain values.

        Returns
        -------
        tuple of Step
            With file name, SHA-256, size and format.
        """
        facts = {
            "file": self.name,
            "sha256": self.sha256,
            "size": self.size,
            "format": format_id,
        }
        return (Step("read", {**facts, **dict(parameters or {})}),)

    def metadata(
        self,
        format_id: str,
        header: Mapping[str, Any],
        *,
        warnings: tuple[str, ...] = (),
        **facts: Any,
    ) -> dict[str, Any]:
        """Return the metadata of an object read from this file.

        Parameters
        ----------
        format_id : str
            Identifier of the format.
        header : mapping
            Every raw header field, by the name in the format's description.
        warnings : tuple of str, optional
            Sentences on what is unusual about the file.
        **facts
            What the reader derived, keys with unit suffixes.

        Returns
        -------
        dict
            Keys ``format``, ``file``, ``sha256``, the facts, ``warnings`` and ``header``; ``unproven`` where
            no file of an instrument has proven the reader, a warning too.
        """
        said = unproven(format_id)
        return {
            "format": format_id,
            "file": self.name,
            "sha256": self.sha256,
            **facts,
            **({"unproven": said} if said else {}),
            "warnings": (*warnings, *((said,) if said else ())),
            "header": dict(header),
        }


def has_hdf5_magic(file: RawFile) -> bool:
    """Return whether a file is HDF5: the magic stands at 0 or at a power of two from 512 on."""
    offset = 0
    with file.stream() as handle:
        while offset + len(HDF5_MAGIC) <= file.size:
            handle.seek(offset)
            if handle.read(len(HDF5_MAGIC)) == HDF5_MAGIC:
                return True
            offset = 2 * offset or 512
    return False


def open_file(path: str | os.PathLike[str]) -> RawFile:
    """Return the content of a file."""
    where = Path(path)
    with _explained(path):
        if where.is_dir():
            if (where / "result.json").is_file():
                raise ReadError(
                    f"{where}: is a folder with a result that metrosep wrote, not a measurement: 'metrosep report' "
                    "makes its reports again and 'metrosep table' a file for a controller; to look at what was "
                    "measured, name that file"
                )
            raise ReadError(f"{where}: is a folder; name a file in it")
        if where.exists() and not where.is_file():
            raise ReadError(f"{where}: is a device or a pipe; copy the data into a file first")
        size = where.stat().st_size
        with where.open("rb") as handle:
            start = handle.read(6)
    if size == 0:
        raise ReadError(f"{where}: the file is empty (0 bytes); export or copy it again")
    opened = _only_member(where) if start.startswith(b"PK\x03\x04") else None
    for magic, module in _PACKED.items():
        if start.startswith(magic):
            opened = partial(importlib.import_module(module).open, where, "rb")
    if start.startswith(_ZSTD) and importlib.util.find_spec("pyarrow") is not None:
        opened = partial(_zstandard, where)
    if opened is not None:
        return RawFile(where, _unpacked(where, opened, size), where)
    file = RawFile(where)
    file.__dict__["size"] = size  # if it is cut from here on, that is seen
    return file


def _zstandard(path: Path) -> Any:
    """Return a file that Zstandard packed, opened to be read."""
    return importlib.import_module("pyarrow").input_stream(str(path), compression="zstd")


def _only_member(path: Path) -> Callable[[], Any] | None:
    """Return what opens the one file in a zip archive; None where there are more, or it is part of a format."""
    import zipfile

    try:
        with zipfile.ZipFile(path) as archive:
            names = [
                n for n in archive.namelist() if not n.startswith("__MACOSX/") and n[-1:] != "/"
            ]
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError):
        return None
    # arrays, and maps of which a part is lost
    if len(names) != 1 or names[0].endswith((".npy", ".xml")):
        return None
    return partial(zipfile.Path(path, names[0]).open, "rb")


def _unpacked(path: Path, opened: Callable[[], Any], size: int) -> bytes:
    """Return the content of a file that is compressed as a whole."""
    import lzma
    import zipfile

    damage = (OSError, EOFError, zlib.error, lzma.LZMAError, zipfile.BadZipFile, RuntimeError)
    most = min(_MAX_UNPACKED, max(_UNASKED, _MAX_RATIO * size))
    try:
        with opened() as handle:
            data: bytes = handle.read(most + 1)
    except damage as exc:
        raise ReadError(f"{path}: cannot be unpacked ({exc}); copy it again") from None
    if len(data) > most:
        raise UnsupportedFeatureError(
            f"{path}: holds more than {most} bytes when it is unpacked; unpack it first and look at it"
        )
    if not data:
        raise ReadError(f"{path}: holds nothing (0 bytes when it is unpacked); export it again")
    return data


@contextmanager
def _explained(path: str | os.PathLike[str]) -> Iterator[None]:
    """Turn what the system says about a file into one sentence."""
    try:
        yield
    except FileNotFoundError:
        message = f"{path}: no such file; check the name and the folder"
        raise FileMissingError(message, os.fspath(path)) from None
    except PermissionError:
        message = f"{path}: you may not read this file; ask for permission"
        raise FileAccessError(message, os.fspath(path)) from None
    except ReadError:
        raise
    except (OSError, ValueError) as exc:
        reason = getattr(exc, "strerror", None) or str(exc)
        raise ReadError(f"{str(path)!r}: cannot be read ({reason}); check the path") from None


def declared_steps(
    override: float | str | tuple[float | str, float | str] | None,
) -> tuple[float, float] | None:
    """Return the lateral steps that a caller declares, in m: one for both directions, or (dx, dy)."""
    if override is None:
        return None
    items = steps_of(override)
    if len(items) > 2 or (len(items) == 1 and isinstance(override, tuple | list)):
        raise ReadOptionError(
            f"lateral_step has {len(items)} values, where one step or two (dx, dy) are needed"
        )
    found = [positive(s, "lateral_step", dimension="length") for s in items]
    return found[0], found[-1]


def rate_of(sampling_rate: float | str) -> float:
    """Return a declared sampling rate in Hz."""
    return positive(sampling_rate, "sampling_rate", dimension="frequency")


def flat_map(z: FloatArray) -> tuple[str, ...]:
    """Return a warning when every valid height of a map is the same."""
    if float(np.nanmin(z)) == float(np.nanmax(z)):
        return (
            f"every valid height is the same, {float(np.nanmax(z)):g} m: no relief was stored",
        )
    return ()


def refuse_options(file: RawFile, format_title: str, **options: object) -> None:
    """Refuse options that a format does not take, by name."""
    given = [name for name, value in options.items() if value is not None]
    if given:
        raise ReadError(
            f"{file.path}: is {format_title}, which takes no {', '.join(given)}; leave "
            f"{'it' if len(given) == 1 else 'them'} out"
        )


# ---- descriptions of formats: data_formats/<id>/format.toml ----------------------------------------


def format_folder() -> Path | None:
    """Return the folder of all formats: in an installed package, or in a checkout."""
    here = Path(__file__).resolve().parents[1]
    for folder in (here / "_formats", here.parent / "data_formats"):
        if folder.is_dir():
            return folder
    return None


def entries_of(file: Path) -> dict[str, Any]:
    """Return the entries of one description."""
    try:
        return tomllib.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as exc:
        raise ReadError(f"{file}: is not readable TOML ({exc}); correct it") from None


@cache
def unproven(format_id: str) -> str:
    """Return the warning about a format that is read from descriptions alone; empty for the others."""
    folder = format_folder()
    file = None if folder is None else folder / format_id / "format.toml"
    entries = {} if file is None or not file.is_file() else entries_of(file)
    if entries.get("status") != "from-specification":
        return ""
    return (
        f"the format {entries['title']} ({format_id}) is read from descriptions alone: no file of an instrument has "
        "proven its reader; compare a measurement whose values are known before you rely on it"
    )


@cache
def evidence(format_id: str) -> str:
    """Return what shows which way up the maps of a format lie; ``"assumed"`` where nothing does."""
    folder = format_folder()
    file = None if folder is None else folder / format_id / "format.toml"
    if file is None or not file.is_file():
        return "assumed"
    entries = entries_of(file)
    if "orientation" in entries:
        return str(entries["orientation"]["evidence"])
    return "assumed" if "surface" in str(entries["kind"]) else ""
