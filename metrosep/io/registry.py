"""Which formats there are, and which of them a file is.

A format is a folder in ``data_formats/`` with a ``format.toml`` (what it is) and a module that
``reader = "builtin:<module>"`` names (how to read it), or a table ``[layout]`` that describes a
text so that no module is needed. The folders lie in the root of a checkout and, inside a wheel, in
``metrosep/_formats``; folders of one's own are named by the environment variable
`FOLDERS_VARIABLE`. A file is recognised by its content; a name alone never makes a reader sure.
Packages may add readers with the entry-point group ``metrosep.readers``; they are asked only when
no other reader knows the file.
"""

from __future__ import annotations

import functools
import importlib
import itertools
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, Protocol, cast

from metrosep.core.errors import (
    AmbiguousFormatError,
    FormatMismatchError,
    ReadError,
    UnknownFormatError,
)
from metrosep.core.plugins import entries
from metrosep.core.profile import Profile
from metrosep.core.readable import did_you_mean
from metrosep.core.recording import Recording
from metrosep.core.runset import RunSet
from metrosep.core.surface import Surface
from metrosep.io.declared import LAYOUT_LINES, Marks, Match, Structure, marks_of, preview
from metrosep.io.source import RawFile, entries_of, format_folder as _format_folder, open_file
from metrosep.io.text.encoding import zero_byte

ENTRY_POINTS = "metrosep.readers"
"""Entry-point group of readers that other packages bring."""

FOLDERS_VARIABLE = "METROSEP_FORMATS"
"""Environment variable with folders (separated as in PATH) of further descriptions of text."""

_INSTEAD = {
    rb"\x28\xb5\x2f\xfd": "is compressed with Zstandard; install metrosep[parquet], or unpack it first (unzstd FILE) "
    "and read the file inside",
    rb"7z\xbc\xaf\x27\x1c": "is compressed with 7-Zip; unpack it first (7z x FILE) and read the file inside",
    rb"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1": "is an OLE file such as an old (.xls) or a locked workbook; save it as "
    ".xlsx without a password, or export the table as CSV",
    rb"PK\x03\x04.*xl/workbook\.bin": "is a binary workbook (.xlsb); save it as .xlsx or CSV",
    rb"PK\x03\x04.*Index/Document\.iwa": "is a workbook of Numbers; export it as .xlsx or CSV",
    rb"(?:\xef\xbb\xbf)?\s*<\?xml.*(?:Excel\.Sheet|office:spreadsheet|<office:document)": "is a workbook in one XML "
    "file (Excel 2003 or .fods), whatever its name says; save it as .xlsx, .ods or CSV",
    rb"(?:\xef\xbb\xbf)?\s*\{\s*\"characteristics\"\s*:": "is a result that metrosep wrote, not a measurement: "
    "'metrosep report' makes its reports again and 'metrosep table' a file for a controller; to look at what was "
    "measured, name that file",
    rb"(?:\xef\xbb\xbf)?\s*(?:%[^\n]*\s+)?(?:[O:]\d+[^\n]*\s+)?(?:\([^\n]*\)\s*|;[^\n]*\s+)*(?:N\d+\s*)?G\d{1,3}(?=\s|\.\d|[XYZACUWF][-+.\d])": "is a program of G-code, not a measurement; 'metrosep path' corrects it by the map of an error",
    rb"(?:\xef\xbb\xbf)?\s*[\[{]\s*(?:[\[{]\s*)*[\"'\d\-\]}]": "holds data in braces or brackets (JSON or source text), not "
    "lines of a table; write them as CSV, one row a line",
    rb"(?:\xef\xbb\xbf)?\s*<\?xml": "is XML of a kind that no reader knows; export the table as CSV",
    rb"\{\\rtf": "is a text of a word processor (RTF); save it as plain text or CSV",
    rb"FEA1": "is a Feather file of version 1; write it again as Feather 2 or Parquet",
    rb"(?:\xef\xbb\xbf)?\s*<(?:!doctype html|html|table|meta)[ >]": "is a web page (HTML), whatever its name says; "
    "open it in a spreadsheet program and save it as .xlsx or CSV",
}
"""How files begin that are known and not read, and what to do with them."""

_FEW_LINES = 20
"""Lines of a text that may be all header."""

_KEYS = frozenset(
    {"id", "title", "vendor", "kind", "suffixes", "reader", "reads", "writes", "status"}
)


class Reader(Protocol):
    """What the module of a format offers."""

    def sniff(self, file: RawFile) -> Match:
        """Return how sure the reader is: it looks at what `read` will demand first.

        Parameters
        ----------
        file : RawFile
            The file; ``file.head`` settles most of them, a container is opened. A name alone is
            never YES, and no content may raise.

        Returns
        -------
        Match
            NO, MAYBE or YES.
        """

    def channels(self, file: RawFile) -> tuple[str, ...]:
        """Return the names that ``read(..., channel=)`` accepts.

        Parameters
        ----------
        file : RawFile
            The file.

        Returns
        -------
        tuple of str
            The default first.
        """

    def read(
        self,
        file: RawFile,
        *,
        channel: str | None = None,
        lateral_step: Any = None,
        unit: Any = None,
        **layout: Any,
    ) -> Surface | Profile | Recording | RunSet:
        """Return the measurement.

        Parameters
        ----------
        file : RawFile
            The file.
        channel : str, optional
            One of `channels`.
        lateral_step : float (m), str or pair, optional
            Replaces the file's own steps.
        unit : str, tuple or dict, optional
            For formats that state none.
        **layout
            Options of the format; `metrosep.io.read.read` refuses others by name.

        Returns
        -------
        Surface, Profile, Recording or RunSet
            With ``file.metadata(...)`` and ``file.history(...)``.
        """


class BuiltIn(NamedTuple):
    """The reader of one format of a module that holds several."""

    sniff: Callable[[RawFile], Match]
    channels: Callable[[RawFile], tuple[str, ...]]
    read: Callable[..., Any]


@dataclass(frozen=True)
class Format:
    """Description of one file format, from its ``format.toml``.

    Parameters
    ----------
    id : str
        Short identifier, the name of the folder.
    title : str
        Name for a person.
    vendor : str
        Who defined it.
    kind : str
        ``"surface"``, ``"profile"``, ``"recording"``, ``"compensation"`` or several joined by
        ``" | "``.
    suffixes : tuple of str
        Usual endings of the file name, with the dot.
    reader : str
        ``"builtin:<module of metrosep.io>"`` (and ``:<member>`` where it holds several formats),
        ``"layout"`` (the facts describe the text),
        ``"controllers:<name>"`` or ``"plugin:<name>"``.
    reads, writes : bool
        What metrosep does with it.
    status : str
        ``"verified-on-real-file"``, ``"from-specification"`` or ``"synthetic"``.
    facts : mapping, optional
        The other keys of the file: magic, unit rule, invalid rule, axis order, sources, layout.
    folder : Path or None, optional
        Where the description lies; ``None`` for a plug-in.
    """

    id: str
    title: str
    vendor: str
    kind: str
    suffixes: tuple[str, ...]
    reader: str
    reads: bool
    writes: bool
    status: str
    facts: Mapping[str, Any] = field(default_factory=dict)
    folder: Path | None = None

    @property
    def is_measurement(self) -> bool:
        """Whether `metrosep.io.read.read` reads it (a table of a controller is not)."""
        return self.reads and self.reader.partition(":")[0] in ("builtin", "plugin", "layout")

    @property
    def is_table(self) -> bool:
        """Whether its content is a table of columns, of which the caller may say what they are."""
        return bool(self.facts.get("table"))

    @functools.cached_property
    def marks(self) -> Marks:
        """What the description declares for recognition; the reader decides where it says nothing."""
        layout = self.facts.get("layout", {})
        mark = str(next(iter(layout.get("recognise", ())), ""))
        plain = str(layout.get("encoding", "utf-8")).lower() in ("utf-8", "latin-1", "ascii")
        if mark and mark.isascii() and plain:
            pattern = rf"(?m)^[^\S\n]*{re.escape(mark)}"
            return Marks(text=pattern, lines=LAYOUT_LINES, closer=True)
        return marks_of(self.facts.get("recognise", {"closer": True}), self.folder)

    def recognise(self, file: RawFile) -> Match:
        """Return how sure the format is of a file; its module is loaded if the marks ask for it.

        Parameters
        ----------
        file : RawFile
            The file.

        Returns
        -------
        Match
            NO where a declared mark is missing.
        """
        declared = self.marks.text or "recognise" in self.facts
        found = self.marks.look(file) if declared else Match.YES
        return self.load_reader().sniff(file) if found and self.marks.closer else found

    def load_reader(self) -> Reader:
        """Return the module that reads the format.

        Raises
        ------
        ReadError
            If metrosep reads the format elsewhere (`metrosep.controllers`) or not at all.
        """
        where, _, name = self.reader.partition(":")
        if where == "builtin":
            module, _, member = name.partition(":")
            found = importlib.import_module(f"metrosep.io.{module}")
            return cast("Reader", getattr(found, member) if member else found)
        if where == "layout":
            from metrosep.io.text.layout import LayoutReader

            source = self.folder / "format.toml" if self.folder else self.id
            layout = self.facts.get("layout", {})
            return cast("Reader", LayoutReader(self.id, self.title, layout, source))
        if where == "plugin":
            return cast("Reader", _plugins()[name])
        raise ReadError(
            f"format {self.id!r} ({self.title}) holds a {self.kind}, not a measurement; read it with "
            "metrosep.controllers.read"
        )


def formats() -> list[Format]:
    """Return every format that metrosep knows, sorted by identifier.

    Returns
    -------
    list of Format
        Built-in ones and those of installed plug-ins.
    """
    known = {f.id: f for f in _descriptors()}
    for name, reader in _plugins().items():
        known.setdefault(name, _plugin_format(name, reader))
    return sorted(known.values(), key=lambda f: f.id)


def get(format_id: str) -> Format:
    """Return the format of an identifier."""
    known = {f.id: f for f in formats()}
    if format_id not in known:
        raise UnknownFormatError(
            f"no format {format_id!r}; known are {', '.join(known)}.{did_you_mean(format_id, known)}"
        )
    return known[format_id]


def own(format_id: str) -> Format:
    """Return the description of a format that metrosep brings; plug-ins are not looked for."""
    return _own_by_id()[format_id]


@functools.cache
def _own_by_id() -> dict[str, Format]:
    return {f.id: f for f in _own_descriptors()}


def sniffer(format_id: str) -> Callable[[RawFile], Match]:
    """Return the recogniser of a format whose marks say all: ``sniff`` of its module."""

    def sniff(file: RawFile) -> Match:
        """Return how sure the declared marks make us."""
        return own(format_id).marks.look(file)

    return sniff


def demand(file: RawFile, format_id: str) -> None:
    """Refuse a file that lacks the declared marks of a format."""
    if own(format_id).marks.look(file) is Match.NO:
        raise mismatch(file, format_id)


def mismatch(file: RawFile, format_id: str, found: str | None = None) -> FormatMismatchError:
    """Return the error about a file that is not of the format it is to be read as."""
    marks = own(format_id).marks
    return FormatMismatchError(
        f"{file.path}: is not {marks.what}: expected {marks.expected}, found "
        f"{found or preview(file.head)}; {marks.hint}"
    )


def structure(format_id: str, name: str = "header") -> Structure:
    """Return a structure that the ``format.toml`` of a format declares."""
    declared = own(format_id).facts["structures"][name]
    return Structure(declared["order"], declared["fields"], declared.get("what", "the header"))


def identify(path: Any) -> Format:
    """Return the format of a file, from its content.

    Parameters
    ----------
    path : str or path
        The file.

    Returns
    -------
    Format
        The one whose reader is sure, else the only one for which it is possible.

    Raises
    ------
    ReadError
        If the file cannot be opened.
    UnknownFormatError
        If no reader knows the content.
    AmbiguousFormatError
        If several do equally well.
    """
    return find(principal(open_file(path)))


def find(file: RawFile) -> Format:
    """Return the format of an opened file; see `identify`."""
    for candidates in (
        [f for f in _descriptors() if f.is_measurement],
        [_plugin_format(n, r) for n, r in _plugins().items()],
    ):
        choice = _choose(file, candidates)
        if choice is not None:
            return choice
    for start, instead in _INSTEAD.items():
        if re.match(start, file.head, re.DOTALL | re.IGNORECASE):
            raise UnknownFormatError(f"{file.path}: {instead}")
    if odd := zero_byte(file.head):
        raise UnknownFormatError(f"{file.path}: {odd}")
    lines = [line for line in file.head.splitlines() if line.strip()]
    if (
        b"\0" not in file.head
        and 0 < len(lines) <= _FEW_LINES
        and not any(re.search(rb"(?<!\w)\d", s) for s in lines[1:])
    ):
        raise UnknownFormatError(
            f"{file.path}: holds {len(lines)} line(s) of text and no row of numbers (it starts with "
            f"{preview(file.head)}); export the measurement again"
        )
    above = 0 if b"\0" in file.head else _lines_above_rows(file.head)
    advice = (
        f"if the rows from line {above + 1} on are a table, give skip_rows={above}, else "
        if above
        else ""
    )
    raise UnknownFormatError(
        f"{file.path}: no reader knows this content (it starts with {preview(file.head)}); {advice}export it as "
        "CSV, or in one of the formats that metrosep formats lists"
    )


def _lines_above_rows(head: bytes) -> int:
    """Return how many lines stand above the last few that hold nothing but numbers, 0 where there are none."""
    lines = head.rstrip().splitlines()
    n = len(list(itertools.takewhile(_ROW_OF_NUMBERS.fullmatch, reversed(lines))))
    return len(lines) - n if n >= _FEWEST_ROWS else 0


_FEWEST_ROWS = 3
_ROW_OF_NUMBERS = re.compile(rb"(?=.*\d)[\s\d.,;|+\-eE\"]+")


def principal(file: RawFile) -> RawFile:
    """Return the file that describes another one, where that lies beside it."""
    suffix = file.path.suffix.lower()
    for described in _descriptors():
        if suffix not in described.facts.get("sidecars", ()):
            continue
        for own in described.suffixes:
            beside = file.path.with_suffix(own)
            if beside.is_file() and beside != file.path:
                other = open_file(beside)
                if described.recognise(other) is Match.YES:
                    return other
    return file


def _choose(file: RawFile, candidates: Sequence[Format]) -> Format | None:
    found = {f.id: f.recognise(file) for f in candidates if not f.marks.last}
    if Match.YES not in found.values():
        found |= {f.id: f.recognise(file) for f in candidates if f.marks.last}
    answers = [(found[f.id], f) for f in candidates if f.id in found]
    for wanted in (Match.YES, Match.MAYBE):
        sure = [f for match, f in answers if match is wanted]
        if len(sure) > 1:
            names = " and ".join(f.id for f in sure)
            raise AmbiguousFormatError(
                f"{file.path}: the content fits {names} equally well; name one with "
                f"format={sure[0].id!r}"
            )
        if sure:
            return sure[0]
    return None


def _descriptors() -> tuple[Format, ...]:
    return _own_descriptors() + _user_descriptors(os.environ.get(FOLDERS_VARIABLE, ""))


@functools.cache
def _user_descriptors(folders: str) -> tuple[Format, ...]:
    """Return the formats in folders of the user: text layouts only, since a TOML file runs no code."""
    found: list[Format] = []
    taken = {f.id for f in _own_descriptors()}
    for folder in filter(None, folders.split(os.pathsep)):
        files = sorted(Path(folder).glob("*/format.toml"))
        if not files:
            raise ReadError(
                f"{folder}: holds no <format>/format.toml; correct {FOLDERS_VARIABLE} or unset it"
            )
        for file in files:
            described = _load(file)
            if described.reader != "layout":
                raise ReadError(f'{file}: reader must be "layout" outside of metrosep')
            if described.id in taken:
                raise ReadError(f"{file}: there is a format {described.id!r} already; rename it")
            described.load_reader()
            taken.add(described.id)
            found.append(described)
    return tuple(found)


@functools.cache
def _own_descriptors() -> tuple[Format, ...]:
    folder = _format_folder()
    if folder is None:
        raise ReadError(
            "the format descriptions (data_formats) are missing from this installation; install "
            "metrosep again"
        )
    return tuple(_load(file) for file in sorted(folder.glob("*/format.toml")))


def _load(file: Path) -> Format:
    entries = entries_of(file)
    facts = {k: v for k, v in entries.items() if k not in _KEYS}
    try:
        return Format(
            id=str(entries["id"]),
            title=str(entries["title"]),
            vendor=str(entries["vendor"]),
            kind=str(entries["kind"]),
            suffixes=tuple(entries["suffixes"]),
            reader=str(entries["reader"]),
            reads=bool(entries["reads"]),
            writes=bool(entries["writes"]),
            status=str(entries["status"]),
            facts=facts,
            folder=file.parent,
        )
    except KeyError as exc:
        raise ReadError(f"{file}: the key {exc} is missing; see data_formats/README.md") from None


def _plugins() -> dict[str, Any]:
    return {name: entry.load() for name, entry in entries(ENTRY_POINTS).items()}


def _plugin_format(name: str, reader: Any) -> Format:
    return Format(
        id=name,
        title=str(getattr(reader, "title", name)),
        vendor=str(getattr(reader, "vendor", "")),
        kind=str(getattr(reader, "kind", "surface")),
        suffixes=tuple(getattr(reader, "suffixes", ())),
        reader=f"plugin:{name}",
        reads=True,
        writes=False,
        status="plug-in",
    )
