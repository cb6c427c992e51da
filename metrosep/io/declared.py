"""What a ``format.toml`` declares of a format, for recognition and for reading alike.

``[recognise]`` names the marks of a format: bytes, a first line, texts, paths of a tree or members of
an archive. They are looked for in the first 64 KiB (in a container, in its directory), so that the
module of a format is loaded only for a file that may be of it. ``[structures.NAME]`` lists the fields
of a binary header. Both give errors that name the offset, and say what stands there instead.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cached_property
from typing import Any

from metrosep.core.errors import CorruptFileError, ReadError
from metrosep.core.units import parse_unit
from metrosep.io.source import LOCAL_HEADER, RawFile, has_hdf5_magic

LAYOUT_LINES = 200
"""Lines among which a described text has its first mark."""


class Match(IntEnum):
    """How sure a reader is that a file is of its format."""

    NO = 0
    MAYBE = 1
    YES = 2


# ---- marks -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Marks:
    """What must be in a file of a format; see ``data_formats/README.md`` for the keys."""

    what: str = ""  # the format within a sentence: "a MetroPro file"
    expected: str = ""  # what stands in such a file, for the message about one that is none
    hint: str = "leave out format= to have it recognised"
    maybe: str = ""  # pattern of the first bytes, as Latin-1: without it NO
    sure: str = ""  # pattern with which it is YES
    first_line: str | None = None  # of text: pattern of the first line that is not blank
    text: str = ""  # pattern somewhere in the head; what lies behind it is for the reader
    lines: int = 2**31  # lines that the head has at most
    tree: str | None = None  # a path, or /@attribute=value, of an HDF5 file; "" for any such file
    member: str | None = None  # a member of a zip archive
    suffix: str = ""  # end of the name of an archive that is MAYBE without that member
    closer: bool = False  # the reader decides about what has the marks
    last: bool = False  # the reader takes its time: it is asked when no other one is sure

    def look(self, file: RawFile) -> Match:
        """Return what the marks say, without the module of the reader."""
        if self.sure or self.maybe:
            return self._in_bytes(file.head)
        if self.tree is not None:
            return self._in_tree(file)
        if self.member is not None:
            return self._in_archive(file)
        return Match.YES if self._in_text(file) else Match.NO

    def _in_bytes(self, head: bytes) -> Match:
        top = head.decode("latin-1")
        if self.maybe and re.match(self.maybe, top, re.DOTALL) is None:
            return Match.NO
        if self.sure and re.match(self.sure, top, re.DOTALL):
            return Match.YES
        return Match.MAYBE if self.maybe else Match.NO

    def _in_tree(self, file: RawFile) -> Match:
        if not has_hdf5_magic(file):
            return Match.NO
        if not self.tree:
            return Match.MAYBE
        from metrosep.io.containers.hdf5_file import look_into

        handle = look_into(file)
        if handle is None:
            return Match.NO
        own = (f"/@{key}={value}" for key, value in handle.attributes("/").items())
        paths = (*handle.groups, *handle.datasets, *own)
        found = any(re.fullmatch(self.tree, path) for path in paths)
        return Match.YES if found else Match.NO

    def _in_archive(self, file: RawFile) -> Match:
        if not file.head.startswith(LOCAL_HEADER):
            return Match.NO
        from metrosep.io.archive import zip_members

        if any(re.search(self.member or "", name) for name in zip_members(file)):
            return Match.YES
        named = bool(self.suffix) and file.name.lower().endswith(self.suffix)
        return Match.MAYBE if named else Match.NO

    def _in_text(self, file: RawFile) -> bool:
        from metrosep.io.text.encoding import head_text

        text = head_text(file)
        if text is None:
            return False
        if self.first_line is not None:
            blank = len(text) - len(text.lstrip())
            start = text.rfind("\n", 0, blank) + 1
            end = text.find("\n", blank)
            if re.match(self.first_line, text[start : end if end >= 0 else None]) is None:
                return False
        open_end = file.size > len(file.head) and text.count("\n") < self.lines
        return open_end or re.search(self.text, text) is not None


def preview(head: bytes) -> str:
    """Return the first bytes for a message: as text where they are text."""
    start = head[:16]
    if all(32 <= b < 127 or b in b"\t\r\n" for b in start):
        return repr(start.decode("ascii"))
    return "bytes " + start[:8].hex(" ")


# ---- binary headers ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Structure:
    """Fields of a binary header: lines ``offset code name [unit]`` with codes of `struct`."""

    order: str  # "<" or ">"
    fields: str
    what: str = "the header"

    @cached_property
    def layout(self) -> tuple[tuple[int, str, str], ...]:
        """Offset in bytes, `struct` code and name of each field."""
        rows = (line.split() for line in self.fields.splitlines() if line.strip())
        return tuple((int(row[0]), row[1], row[2]) for row in rows)

    @cached_property
    def units(self) -> dict[str, float]:
        """SI units per unit of the fields that have one."""
        rows = (line.split() for line in self.fields.splitlines() if line.strip())
        return {row[2]: parse_unit(row[3]).factor for row in rows if len(row) > 3}

    @cached_property
    def size(self) -> int:
        """Bytes up to the end of the last field."""
        return max(at + struct.calcsize(self.order + code) for at, code, _ in self.layout)

    def read(self, file: RawFile, start: int = 0) -> Fields:
        """Return the fields at a place; text is cut at its first zero byte and stripped."""
        need_bytes(file, start, self.size, self.what)
        data = file.head if start + self.size <= len(file.head) else file.data
        found = Fields(file, self, start)
        for offset, code, name in self.layout:
            values = struct.unpack_from(self.order + code, data, start + offset)
            value = values[0] if len(values) == 1 else values
            if isinstance(value, bytes):
                value = value.split(b"\0")[0].decode("latin-1").strip()
            found[name] = value
        return found

    def pack(self, values: Mapping[str, Any], size: int) -> bytes:
        """Return a header with these values; text is padded with blanks, all else is zero."""
        packed = bytearray(size)
        for offset, code, name in self.layout:
            if name in values:
                value = values[name]
                if code.endswith("s"):
                    value = str(value).encode("ascii").ljust(int(code[:-1]))
                struct.pack_into(self.order + code, packed, offset, value)
        return bytes(packed)


class Fields(dict[str, Any]):
    """Values of a binary header by name, which know the offset that they come from."""

    def __init__(self, file: RawFile, declared: Structure, start: int) -> None:
        super().__init__()
        self.file, self.declared, self.start = file, declared, start

    def offset(self, name: str) -> int:
        """Return where a field stands in the file."""
        return self.start + next(at for at, _, n in self.declared.layout if n == name)

    def error(
        self, name: str, expected: object, reason: str = "the header is not usable"
    ) -> CorruptFileError:
        """Return the error about a field, for the caller to raise."""
        return self.file.corrupt(
            reason, field=name, offset=self.offset(name), expected=expected, found=self[name]
        )

    def demand(self, name: str, expected: object) -> None:
        """Refuse a field that has another value than the rest of the file allows."""
        if self[name] != expected:
            raise self.error(name, expected, "the header contradicts itself")

    def scale(self, name: str, low: float = 1e-3, high: float = 1e3) -> float:
        """Return a scale of the heights, or refuse it."""
        from metrosep.io.objects import check_scale

        return check_scale(
            self.file, name, self[name], offset=self.offset(name), low=low, high=high
        )

    def step(self, name: str, warnings: list[str], factor: float | None = None) -> float | None:
        """Return a lateral step in m, ``None`` where it is not calibrated."""
        from metrosep.io.objects import lateral_or_none

        factor = self.declared.units.get(name, 1.0) if factor is None else factor
        return lateral_or_none(
            self.file, name, self[name], warnings, offset=self.offset(name), factor=factor
        )

    def area(
        self, columns: str, rows: str, max_pixels: int | None, **rest: Any
    ) -> tuple[int, int]:
        """Return columns and rows of a map, refused before anything is allocated."""
        from metrosep.io.objects import check_area

        check_area(
            self.file,
            self[columns],
            self[rows],
            max_pixels=max_pixels,
            names=(columns, rows),
            offsets=(self.offset(columns), self.offset(rows)),
            **rest,
        )
        return self[columns], self[rows]


def need_bytes(file: RawFile, offset: int, count: int, what: str, *, name: str = "size") -> None:
    """Refuse a file that ends before something that its header promises."""
    if count < 0 or offset < 0 or offset + count > file.size:
        raise file.corrupt(
            f"{what} does not fit into the file",
            field=name,
            offset=max(min(offset, file.size), 0),
            expected=f"{count} bytes",
            found=f"{max(file.size - offset, 0)} bytes",
        )


# ---- trees ---------------------------------------------------------------------------------------


class Cursor:
    """A place in bytes that moves forward as fields are read, never past what encloses them."""

    short = "a value is larger than what encloses it"

    def __init__(
        self,
        file: RawFile,
        data: bytes,
        place: int = 0,
        end: int | None = None,
        *,
        order: str = "<",
        start: int = 0,
    ) -> None:
        self.file, self.order, self.place = file, order, place
        self._data, self._start = data, start
        self._end = len(data) if end is None else end

    @property
    def left(self) -> int:
        """Bytes up to the end of what encloses them."""
        return max(self._end - self.place, 0)

    def take(self, count: int, name: str) -> bytes:
        """Return the next bytes."""
        if count > self.left:
            raise self.wrong(self.short, name, f"{count} bytes", f"{self.left} bytes")
        self.place += count
        return self._data[self.place - count : self.place]

    def numbers(self, codes: str, name: str) -> tuple[Any, ...]:
        """Return the next fields by their `struct` codes."""
        layout = struct.Struct(self.order + codes)
        return layout.unpack(self.take(layout.size, name))

    def number(self, code: str, name: str) -> Any:
        """Return the next field."""
        return self.numbers(code, name)[0]

    def text(self, name: str) -> str:
        """Return the next text: its length as u32, then UTF-8."""
        return self.take(self.number("I", name), name).decode("utf-8", "replace")

    def word(self, name: str) -> str:
        """Return the next text up to a zero byte."""
        stop = self._data.find(b"\0", self.place, self._end)
        if stop < 0:
            raise self.wrong("a text has no end", name, "a zero byte")
        return self.take(stop + 1 - self.place, name)[:-1].decode("utf-8", "replace")

    def inside(self, count: int, name: str) -> Cursor:
        """Return a cursor on the next bytes, and go on behind them."""
        start = self.place
        if count > self.left:
            raise self.wrong(self.short, name, f"at most {self.left} bytes", f"{count} bytes")
        self.place += count
        return type(self)(
            self.file, self._data, start, self.place, order=self.order, start=self._start
        )

    def again(self) -> Cursor:
        """Return a cursor on the same bytes, which moves by itself."""
        return type(self)(
            self.file, self._data, self.place, self._end, order=self.order, start=self._start
        )

    def wrong(
        self, reason: str, name: str | None, expected: object = None, found: object = None
    ) -> CorruptFileError:
        """Return the error about a field, for the caller to raise."""
        where = min(self._start + self.place, self.file.size)
        field_ = name and name[-80:]
        return self.file.corrupt(
            reason, offset=where, field=field_, expected=expected, found=found
        )


# ---- headers of text: key = value --------------------------------------------------------------

_LONGEST = 40
"""Characters of a number: what is longer is none."""


@dataclass
class TextFields:
    """Values of a header as text, by name, with the line or the offset of each."""

    file: RawFile
    texts: dict[str, str] = field(default_factory=dict)
    lines: dict[str, int] = field(default_factory=dict)
    offsets: dict[str, int] = field(default_factory=dict)
    noun: str = ""  # "the tag" before a name in a message

    def take(
        self,
        text: str,
        *,
        mark: str = "=",
        comments: tuple[str, ...] = (),
        line: int = 0,
        name: Callable[[str], str] = str,
    ) -> bool:
        """Enter a line ``key = value``, the first of each key; False where it is none."""
        key, found, value = text.partition(mark)
        if not found or key.lstrip().startswith(comments or ("\0",)):
            return False
        known = name(key.strip())
        if known not in self.texts:
            self.texts[known] = value.strip(" \t\r\0")
            self.lines[known] = line
        return True

    def whole(
        self, name: str, *, most: int | None = None, default: str = "", least: int = 0
    ) -> int:
        """Return a whole number."""
        text = self.texts.get(name, default)
        digits = text.isascii() and text.isdecimal() and len(text) <= 12
        if digits and int(text) >= least and (most is None or int(text) <= most):
            return int(text)
        upper = "" if most is None else f" up to {most}"
        raise self.error(name, f"a whole number{upper}")

    def integer(self, name: str) -> int:
        """Return a whole number that may be negative."""
        try:
            return int(self.texts.get(name, "")[:_LONGEST])
        except ValueError:
            raise self.error(name, "a whole number") from None

    def number(self, name: str, default: float | None = None) -> float:
        """Return a number."""
        text = self.texts.get(name)
        if text is None and default is not None:
            return default
        try:
            return float((text or "")[:_LONGEST])
        except ValueError:
            raise self.error(name, "a number") from None

    def error(self, name: str, expected: str) -> CorruptFileError:
        """Return the error about a value that is missing or not usable."""
        text = self.texts.get(name)
        line = self.lines.get(name)
        state = (
            "is missing" if text is None else "is not usable" if self.noun else "is not a number"
        )
        return self.file.corrupt(
            f"{self.noun} {name} {state}".strip(),
            field=f"line {line}, {name}" if line else name,
            offset=self.offsets.get(name),
            expected=expected,
            found=None if text is None else repr(text[:_LONGEST]),
        )


def marks_of(table: Mapping[str, Any], where: object) -> Marks:
    """Return the marks that ``[recognise]`` of a description declares."""
    unknown = [key for key in table if key not in Marks.__dataclass_fields__]
    if unknown:
        known = ", ".join(Marks.__dataclass_fields__)
        raise ReadError(f"{where}: [recognise] has no key {unknown[0]!r}; the keys are {known}")
    return Marks(**table)
