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

import enum
import functools
import importlib
import os
import sys
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any, Protocol, cast

from metrosep.core.errors import AmbiguousFormatError, ReadError, UnknownFormatError
from metrosep.core.profile import Profile
from metrosep.core.recording import Recording
from metrosep.core.runset import RunSet
from metrosep.core.surface import Surface
from metrosep.io.source import RawFile, open_file

__all__ = ["Format", "Match", "Reader", "find", "formats", "get", "identify", "principal"]

ENTRY_POINTS = "metrosep.readers"
"""Entry-point group of readers that other packages bring."""

FOLDERS_VARIABLE = "METROSEP_FORMATS"
"""Environment variable with folders (separated as in PATH) of further descriptions of text."""

_NEVER_SURE = frozenset({"delimited"})
"""Formats whose reader says MAYBE at best, and takes its time: asked when no other one is sure."""

_KEYS = frozenset(
    {"id", "title", "vendor", "kind", "suffixes", "reader", "reads", "writes", "status"}
)


class Match(enum.IntEnum):
    """How sure a reader is that a file is of its format."""

    NO = 0
    MAYBE = 1
    YES = 2


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


@dataclass(frozen=True, slots=True)
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
        ``"builtin:<module of metrosep.io>"``, ``"layout"`` (the facts describe the text),
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
    def magic(self) -> tuple[tuple[int, bytes], ...]:
        """Pairs of offset and bytes; any one of them marks the format."""
        items = self.facts.get("magic", ())
        return tuple((int(m["offset"]), bytes.fromhex(m["hex"])) for m in items)

    def load_reader(self) -> Reader:
        """Return the module that reads the format.

        Raises
        ------
        ReadError
            If metrosep reads the format elsewhere (`metrosep.controllers`) or not at all.
        """
        where, _, name = self.reader.partition(":")
        if where == "builtin":
            return cast("Reader", importlib.import_module(f"metrosep.io.{name}"))
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
        raise UnknownFormatError(f"no format {format_id!r}; known are {', '.join(known)}")
    return known[format_id]


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
    known = ", ".join(f.id for f in formats() if f.is_measurement)
    raise UnknownFormatError(
        f"{file.path}: no reader knows this content (it starts with {_preview(file.head)}); known are "
        f"{known}. If it is a table of numbers, remove the text before it or pass skip_rows=; "
        "otherwise export it as CSV"
    )


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
                if described.load_reader().sniff(other) is Match.YES:
                    return other
    return file


def _choose(file: RawFile, candidates: Sequence[Format]) -> Format | None:
    found = {f.id: _asked(file, f) for f in candidates if f.id not in _NEVER_SURE}
    if Match.YES not in found.values():
        found |= {f.id: _asked(file, f) for f in candidates if f.id in _NEVER_SURE}
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


def _asked(file: RawFile, candidate: Format) -> Match:
    return candidate.load_reader().sniff(file)


def _preview(head: bytes) -> str:
    start = head[:16]
    if all(32 <= b < 127 or b in b"\t\r\n" for b in start):
        return repr(start.decode("ascii"))
    return "bytes " + start[:8].hex(" ")


def _format_folder() -> Path | None:
    here = Path(__file__).resolve().parents[1]
    for folder in (here / "_formats", here.parent / "data_formats"):
        if folder.is_dir():
            return folder
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
    try:
        entries = tomllib.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as exc:
        raise ReadError(f"{file}: is no readable TOML ({exc}); correct it") from None
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
    found = _installed(metadata.entry_points, tuple(sys.path))
    return {entry.name: entry.load() for entry in sorted(found, key=lambda e: e.name)}


@functools.lru_cache(maxsize=4)
def _installed(look: Callable[..., Any], _path: tuple[str, ...]) -> tuple[Any, ...]:
    """Return the entry points of readers; looking them up costs 10 ms, as much as a small file."""
    return tuple(look(group=ENTRY_POINTS))


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
