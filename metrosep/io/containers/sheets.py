"""Tables inside containers as the text that the one reader of tables sees.

A worksheet of ``.xlsx``, a table of SQLite, the columns of Parquet, Feather or ``.npz`` become lines
with tabs between the fields and points in the numbers: roles, units, markers, dates, footers and
damage follow the same procedure as in a CSV, at every door. Row 17 of a worksheet is line 17; where the
container itself names the columns, line 1 holds the names. Of several tables none is chosen in
silence. Nothing is executed: no formula, pickle, view or trigger; nothing is written beside the file.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from metrosep.core.errors import (
    AmbiguousFormatError,
    CorruptFileError,
    FormatMismatchError,
    ReadError,
    ReadNameError,
    ReadOptionError,
    UnsupportedFeatureError,
)
from metrosep.core.provenance import Step
from metrosep.core.readable import nearest
from metrosep.core.text_options import TextOptions
from metrosep.core.units import column_unit
from metrosep.io.archive import Archive, zip_members
from metrosep.io.containers.arrays import array_of
from metrosep.io.containers.open_document import CONTENT, OpenDocument
from metrosep.io.containers.workbook import Workbook, column_number, letters
from metrosep.io.source import MAX_PIXELS, RawFile
from metrosep.io.text._rows import DECIMAL_SHOWN
from metrosep.io.text.dialect import (
    NO_COMMENT,
    NUMBER_LIKE,
    Dialect,
    bare_unit,
    is_comment,
)
from metrosep.io.text.encoding import NO_READING
from metrosep.io.text.times import is_moment

if TYPE_CHECKING:
    import sqlite3

_SQLITE: Final = b"SQLite format 3\x00"
_PARQUET: Final = b"PAR1"
_ARROW: Final = b"ARROW1"
_MAX_CELLS = 2**26
"""Cells of the largest table that is read as text."""
_BATCH = 2**10
_SWOLLEN = 64
_BOTH = {
    ",": re.compile(r"[+-]?\d{1,3}(?:\.\d{3})+,\d+"),
    ".": re.compile(r"[+-]?\d{1,3}(?:,\d{3})+\.\d+"),
}
"""Numbers with both marks: the second one is the decimal mark."""
_CONTROL = dict.fromkeys(range(32), " ")


class _Place(type(Path())):  # type: ignore[misc]  # a plain Path has no class of its own
    """The path of a container, which a message shows with the table in it."""

    part = ""

    def __format__(self, spec: str) -> str:
        return f"{self!s}, {self.part}" if self.part else f"{self!s}"


class Sheet(RawFile):
    """One table of a container as text; name, size and hash are those of the container."""

    written = MappingProxyType(
        {"separator": "tab", "decimal": ".", "thousands": None, "encoding": "utf-8"}
    )

    def __init__(
        self,
        raw: RawFile,
        part: str,
        text: str,
        notes: Sequence[str] = (),
        *,
        comments: bool = False,
    ) -> None:
        place = _Place(raw.path)
        place.part = part
        super().__init__(place, text.encode())
        self.table_format = container_of(raw) or "delimited"
        self.raw, self.part, self.notes = raw, part, tuple(notes)
        if not comments:
            self.written = MappingProxyType({**self.written, "comment": NO_COMMENT})

    def corrupt(self, reason: str, **facts: Any) -> CorruptFileError:
        """Return the error about a row, which names the table too."""
        return CorruptFileError(f"{self.path}", reason, **facts)

    def history(self, format_id: str, parameters: Mapping[str, Any] | None = None) -> tuple[Step]:
        """Return the history of an object read from the container."""
        return self.raw.history(format_id, {"sheet": self.part, **(parameters or {})})

    @property
    def sha256(self) -> str:
        """SHA-256 of the container."""
        return self.raw.sha256


def as_text(file: RawFile, options: TextOptions) -> RawFile:
    """Return the table that a file holds as text; a text is itself."""
    if isinstance(file, Sheet):
        return file
    kind = container_of(file)
    if kind is None:
        if options.sheet is not None:
            raise ReadOptionError(
                f"{file.path}: is a text, which has no worksheets or tables; leave sheet= out"
            )
        return file
    title = _TITLES[kind]
    for name in ("separator", "encoding", "comment"):
        if getattr(options, name) is not None:
            raise ReadOptionError(f"{file.path}: {title} has no {name}; leave {name}= out")
    key = (options.sheet, options.decimal, options.thousands)
    known: dict[Any, Sheet] = file.__dict__.setdefault("_sheets", {})
    if key not in known:
        with _explained(file, title):
            known[key] = _KINDS[kind](file).table(options)
    return known[key]


def container_of(file: RawFile) -> str | None:
    """Return what kind of container of tables a file is, None where it is none."""
    head = file.head
    for start, kind in ((_SQLITE, "sqlite"), (_PARQUET, "parquet"), (_ARROW, "parquet")):
        if head.startswith(start):
            return kind
    members = zip_members(file)
    if "xl/workbook.xml" in members or CONTENT in members:
        return "worksheet"
    return "npz" if any(n.endswith(".npy") for n in members) else None


def sheets_of(file: RawFile) -> tuple[str, ...]:
    """Return the names of the tables of a container that hold numbers."""
    kind = container_of(file)
    if kind is None:
        return ()
    with _explained(file, _TITLES[kind]):
        return tuple(_KINDS[kind](file).holding())


@contextmanager
def _explained(file: RawFile, title: str) -> Iterator[None]:
    """Turn what another library says about a damaged container into one sentence."""
    try:
        yield
    except ReadError:
        raise
    except MemoryError:
        raise UnsupportedFeatureError(
            f"{file.path}: {title} is too large for the memory of this computer"
        ) from None
    except Exception as exc:
        words = " ".join(str(exc).split())[:80]
        raise file.corrupt(f"{title} cannot be read ({type(exc).__name__}: {words})") from None


class _Columns(NamedTuple):
    """Names and texts of the columns of a table; which of these were texts in the container."""

    names: Sequence[str]
    columns: Sequence[Sequence[str]]
    are_texts: Sequence[bool]
    notes: tuple[str, ...] = ()
    are_named: bool = True  # else they have numbers, as in a text without a row of names


@dataclass
class _Container:
    """Tables of a file by name, of which one is read."""

    file: RawFile
    kind: str = field(default="table", init=False)
    left: tuple[str, ...] = field(default=(), init=False)  # sentences on what is not read

    def holding(self) -> dict[str, str]:
        """Return the tables that hold numbers, and how many, in words."""
        raise NotImplementedError

    def table(self, options: TextOptions) -> Sheet:
        """Return the table that the caller names, or the only one."""
        name = self.chosen(options.sheet)
        table = self.read(name)
        n_rows = len(table.columns[0]) if table.columns else 0
        if not n_rows:
            raise FormatMismatchError(f"{self.file.path}: {self.kind} {name!r} holds no rows")
        columns = list(table.columns)
        where = f"{self.kind} {name!r}"
        texts = (
            ((k, i), text)
            for k, is_text in enumerate(table.are_texts)
            if is_text
            for i, text in enumerate(columns[k])
        )
        numbers, notes = _numbers_as_text(
            self.file, where, texts, options, lambda key: f"line {key[1] + 1 + table.are_named}"
        )
        if numbers:
            columns = [list(c) for c in columns]
            for (k, i), text in numbers.items():
                columns[k][i] = text
        lines = [
            *(["\t".join(_safe_names(table.names))] if table.are_named else []),
            *map("\t".join, zip(*columns, strict=True)),
        ]
        part = f"{where} (line 1 holds the names)" if table.are_named else where
        return Sheet(self.file, part, "\n".join(lines) + "\n", (*table.notes, *notes))

    def read(self, name: str) -> _Columns:
        """Return the columns of a table."""
        raise NotImplementedError

    def chosen(self, wanted: str | None) -> str:
        """Return the table to read: never the first of several in silence."""
        found = self.holding()
        listed = ", ".join(f"{name!r} ({what})" for name, what in list(found.items())[:12])
        if wanted is not None:
            return self.named(wanted, found, listed)
        if not found:
            why = f" ({self.left[0]})" if self.left else ""
            raise FormatMismatchError(f"{self.file.path}: no {self.kind} in it holds numbers{why}")
        if len(found) > 1:
            raise FormatMismatchError(
                f"{self.file.path}: holds {len(found)} {self.kind}s with numbers: {listed}; choose one with "
                f"sheet={self.fullest(found)!r}"
            )
        return next(iter(found))

    def fullest(self, found: Collection[str]) -> str:
        """Return the table that a message takes as its example."""
        return next(iter(found))

    def named(self, wanted: str, found: Collection[str], listed: str) -> str:
        """Return the table of a name, whatever its capitals."""
        same = [n for n in found if n == wanted] or [
            n for n in found if n.casefold() == wanted.strip().casefold()
        ]
        if len(same) == 1:
            return same[0]
        near = nearest(wanted, found)
        hint = f"; did you mean sheet={near!r}?" if near else "; name one of them with sheet="
        raise ReadNameError(
            f"{self.file.path}: has no {self.kind} {wanted!r} with numbers; there is {listed or 'none'}{hint}"
        )


def _safe_names(names: Sequence[str]) -> list[str]:
    """Return names of columns that no reader can take for numbers, nor all of them for units."""
    texts = [_clean(name) for name in names]
    are_units = all(not t or bare_unit(t) is not None for t in texts)
    odd = (are_units or NUMBER_LIKE.fullmatch(t) or t.lower() in NO_READING for t in texts)
    return [f"column{t}" if o else t for t, o in zip(texts, odd, strict=True)]


def _clean(text: str) -> str:
    """Return the text of a cell for a line: no tabs and line ends, quotes as in a CSV."""
    text = text.translate(_CONTROL).strip()
    return f'"{text.replace(chr(34), chr(34) * 2)}"' if '"' in text else text


def _numbers_as_text(
    file: RawFile,
    where: str,
    cells: Iterable[tuple[Any, str]],
    options: TextOptions,
    place: Callable[[Any], str],
) -> tuple[dict[Any, str], tuple[str, ...]]:
    """Return the numbers that are kept as texts, with a point; which mark they have is shown or refused."""
    found = {
        key: text.strip()
        for key, text in cells
        if NUMBER_LIKE.fullmatch(text.strip()) and not is_moment(text.strip())
    }
    if not found:
        return {}, ()
    decimal = options.decimal
    marked = {m: next((k for k, t in found.items() if m in t), None) for m in ".,"}
    if decimal is None and any(k is not None for k in marked.values()):
        shown = {
            m: next((k for k, t in found.items() if DECIMAL_SHOWN[m].search(t)), None)
            for m in ".,"
        }
        both = {m: any(_BOTH[m].fullmatch(t) for t in found.values()) for m in ".,"}
        sure = [m for m, key in shown.items() if key is not None or both[m]]
        if len(sure) != 1 and options.thousands is None:
            key = next(k for k in (*shown.values(), *marked.values()) if k is not None)
            raise AmbiguousFormatError(
                f"{file.path}, {where}: {place(key)} holds the number {found[key]!r} as a text, and nothing "
                "shows which mark is the decimal one; give decimal=',' or decimal='.', or turn the texts "
                "into numbers"
            )
        decimal = sure[0] if len(sure) == 1 else "." if options.thousands == "," else ","
    dialect = Dialect("\t", decimal or ".", thousands=options.thousands or "")
    grouped = replace(dialect, thousands=dialect.other_mark)
    plain = {}
    for key, text in found.items():
        number = dialect.plain(text)
        if number is None and not options.thousands and _BOTH[dialect.decimal].fullmatch(text):
            number = grouped.plain(text)
        if number is not None:
            plain[key] = number
    if not plain:
        return {}, ()
    first = next(iter(plain))
    mark = "comma" if dialect.decimal == "," else "point"
    note = (
        f"{where}: {len(plain)} number(s) are kept as texts (first: {place(first)}, {found[first]!r}); they "
        f"were read with a decimal {mark}"
    )
    return plain, (note,)


# ---- worksheets -------------------------------------------------------------------------------


@dataclass
class _Worksheets(_Container):
    """Worksheets of a workbook; a table begins wherever the rules for text find it."""

    kind: str = field(default="worksheet", init=False)

    def __post_init__(self) -> None:
        opened = Workbook if "xl/workbook.xml" in zip_members(self.file) else OpenDocument
        self._book: Workbook | OpenDocument = opened(self.file)
        self._read: dict[str, _Grid] = {}

    def holding(self) -> dict[str, str]:
        found = {}
        for name in self._book.names:
            if n := self._grid(name).n_numbers:
                hidden = ", hidden" if name in self._book.hidden else ""
                found[name] = f"{n} numbers{hidden}"
        return found

    def table(self, options: TextOptions) -> Sheet:
        if options.sheet in self._book.names:  # the others need not be looked at
            name = str(options.sheet)
        else:
            name = self.chosen(options.sheet)
        grid = self._grid(name)
        where = f"worksheet {name!r}"
        if grid.never_computed:
            raise UnsupportedFeatureError(
                f"{self.file.path}, {where}: cell {grid.never_computed} holds a formula without its result; "
                "open the file in a spreadsheet program, save it there, and read it again"
            )
        numbers, notes = _numbers_as_text(
            self.file, where, grid.texts, options, lambda key: f"cell {letters(key[1])}{key[0]}"
        )
        for (number, column), text in numbers.items():
            grid.rows[number][column] = text
        columns = sorted({c for row in grid.rows.values() for c in row})
        last = max(grid.rows, default=0)
        if last * len(columns) > _MAX_CELLS:
            raise UnsupportedFeatureError(
                f"{self.file.path}, {where}: {last} rows of {len(columns)} columns are more than {_MAX_CELLS} "
                "cells; export it as CSV"
            )
        empty: dict[int, str] = {}
        lines = (
            "\t".join([row.get(c, "") for c in columns])
            if (row := grid.rows.get(n, empty))
            else ""
            for n in range(1, last + 1)
        )
        if grid.n_hidden:
            notes += (
                f"{where}: {grid.n_hidden} row(s) are hidden; they were read like the others",
            )
        if unseen := [letters(c) for c in columns if any(a <= c <= b for a, b in grid.unseen)]:
            notes += (
                f"{where}: column(s) {', '.join(unseen)} are hidden; they were read like the others",
            )
        if name in self._book.hidden:
            notes += (f"{where} is hidden in the workbook",)
        marked = any(
            is_comment(row[min(row)]) for n, row in grid.rows.items() if n in grid.measured
        )
        return Sheet(self.file, where, "\n".join(lines) + "\n", notes, comments=not marked)

    def fullest(self, found: Collection[str]) -> str:
        return max(found, key=lambda name: self._grid(name).n_numbers)

    def _grid(self, name: str) -> _Grid:
        if name not in self._read:
            self._read[name] = _Grid.of(self.file, self._book, name)
        return self._read[name]


@dataclass
class _Grid:
    """Cells of a worksheet by row and column, as texts."""

    rows: dict[int, dict[int, str]]
    texts: list[tuple[tuple[int, int], str]]  # row and column of cells that hold texts
    measured: frozenset[int]  # rows with a number
    n_numbers: int
    n_hidden: int
    unseen: list[tuple[int, int]]  # first and last of hidden columns
    never_computed: str

    @classmethod
    def of(cls, file: RawFile, book: Workbook | OpenDocument, name: str) -> _Grid:
        rows: dict[int, dict[int, str]] = {}
        texts: list[tuple[tuple[int, int], str]] = []
        typed: set[tuple[int, int]] = set()
        never_computed = ""
        for number, row in book.rows(name):
            found: dict[int, str] = {}
            for cell in row:
                text = book.text_of(cell, name)
                if cell.unsolved and not never_computed:
                    never_computed = f"{letters(cell.column)}{number}"
                if cell.kind == "n":
                    if text:
                        typed.add((number, cell.column))
                        text = book.moment(cell, text)
                elif cell.kind == "b":
                    text = "TRUE" if text == "1" else "FALSE"
                elif cell.kind != "e":
                    texts.append(((number, cell.column), text))
                    text = _clean(text)
                if text:
                    found[cell.column] = text
            if found:
                rows[number] = found
        for area in book.merged:
            place = re.match(r"([A-Z]{1,3})(\d{1,7}):", area)
            if place and (int(place[2]), column_number(place[1])) in typed:
                raise FormatMismatchError(
                    f"{file.path}, worksheet {name!r}: the merged cells {area} hold one number for several "
                    "cells; undo the merge and write each number"
                )
        n_texts = sum(NUMBER_LIKE.fullmatch(t.strip()) is not None for _, t in texts)
        measured = frozenset(row for row, _ in typed)
        n_numbers = len(typed) + n_texts
        return cls(
            rows, texts, measured, n_numbers, book.n_hidden_rows, book.unseen, never_computed
        )


# ---- SQLite: tables only, since a view may compute without end --------------------------------------


@dataclass
class _Database(_Container):
    """Tables of a SQLite file, opened so that nothing can be written and nothing runs."""

    def __post_init__(self) -> None:
        import sqlite3

        page, pages = self.file.head[16:18], int.from_bytes(self.file.head[28:32], "big")
        counted = self.file.head[24:28] == self.file.head[92:96]  # else an old program wrote it
        size = pages * (int.from_bytes(page, "big") if page != b"\x00\x01" else 65536)
        if counted and size > self.file.size:
            raise self.file.corrupt(
                "the SQLite file is cut off", expected=f"{size} bytes", found=f"{self.file.size}"
            )
        beside = [Path(f"{self.file.path!s}{end}") for end in ("-wal", "-journal")]
        journal = next((j for j in beside if j.is_file() and j.stat().st_size), None)
        if not self.file.in_memory and journal is not None:
            raise UnsupportedFeatureError(
                f"{self.file.path}: what is not settled yet lies in {journal.name}; close the program "
                "that writes it, and read it again"
            )
        if self.file.in_memory:
            self._base = sqlite3.connect(":memory:")
            self._base.deserialize(self.file.data)
        else:
            where = self.file.path.resolve().as_uri()
            self._base = sqlite3.connect(f"{where}?mode=ro&immutable=1", uri=True)
        # a computed column may make texts that no row holds
        self._base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, max(2**16, self.file.size))
        self._base.text_factory = lambda raw: raw.decode("utf-8", "replace")
        self._base.execute("PRAGMA trusted_schema = OFF")
        self._base.execute("PRAGMA cell_size_check = ON")
        (state,) = self._base.execute("PRAGMA quick_check(1)").fetchone()
        if state != "ok":
            raise self.file.corrupt("the SQLite file is damaged", found=str(state)[:80])
        allowed = (sqlite3.SQLITE_SELECT, sqlite3.SQLITE_READ)
        self._base.set_authorizer(
            lambda action, *_: sqlite3.SQLITE_OK if action in allowed else sqlite3.SQLITE_DENY
        )

    def holding(self) -> dict[str, str]:
        rows = self._base.execute("SELECT name, sql FROM sqlite_master WHERE type = 'table'")
        names = [
            str(n) for n, sql in rows if not str(n).startswith("sqlite_") and not _is_virtual(sql)
        ]
        found = {}
        for name in names:
            if self._holds_numbers(name):
                found[name] = f"{len(self._rows_of(name).description)} columns"
        return found

    def _holds_numbers(self, name: str) -> bool:
        return any(
            isinstance(v, int | float) or (isinstance(v, str) and NUMBER_LIKE.fullmatch(v.strip()))
            for row in self._rows_of(name)
            for v in row
        )

    def _rows_of(self, name: str) -> sqlite3.Cursor:
        """Return the rows of a table in the order in which they were stored."""
        quoted = name.replace('"', '""')
        return self._base.execute(f'SELECT * FROM "{quoted}" NOT INDEXED')  # noqa: S608 - its own name

    def read(self, name: str) -> _Columns:
        cursor = self._rows_of(name)
        names = [str(d[0]) for d in cursor.description]
        columns: list[list[str]] = [[] for _ in names]
        are_texts = [False] * len(names)
        n_cells = n_bytes = 0
        most = max(2**26, _SWOLLEN * self.file.size)
        while rows := cursor.fetchmany(_BATCH):
            n_cells += len(rows) * len(names)
            _refuse_many(self.file, n_cells)
            for k, values in enumerate(zip(*rows, strict=True)):
                are_texts[k] |= any(isinstance(v, str) for v in values)
                texts = [_of_value(v) for v in values]
                n_bytes += sum(map(len, texts)) if are_texts[k] else 0
                columns[k] += texts
            if n_bytes > most:
                raise UnsupportedFeatureError(
                    f"{self.file.path}: table {name!r} computes more text than such a file can hold; export "
                    "the columns that are needed as CSV"
                )
        return _Columns(names, columns, are_texts)


def _is_virtual(sql: object) -> bool:
    return str(sql).lstrip().upper().startswith("CREATE VIRTUAL")


def _of_value(value: object) -> str:
    """Return a value as the text of a field."""
    if value is None:
        return ""
    if isinstance(value, str):
        return _clean(value)
    return f"({len(value)} bytes)" if isinstance(value, bytes) else repr(value)


def _refuse_many(file: RawFile, n_cells: int) -> None:
    if n_cells > _MAX_CELLS:
        raise UnsupportedFeatureError(
            f"{file.path}: holds more than {_MAX_CELLS} cells; export the rows that are needed as CSV"
        )


# ---- Parquet and Feather ---------------------------------------------------------------------------


@dataclass
class _Parquet(_Container):
    """The one table of a Parquet or Feather file; units may stand in the metadata of its columns."""

    def holding(self) -> dict[str, str]:
        return {self.file.path.stem: "the only table"}

    def named(self, wanted: str, found: Collection[str], listed: str) -> str:
        raise ReadOptionError(f"{self.file.path}: holds one table; leave sheet= out")

    def read(self, name: str) -> _Columns:
        table = self._table()
        names: list[str] = []
        columns: list[list[str]] = []
        are_texts: list[bool] = []
        for own, values in zip(table.schema, table.columns, strict=True):
            texts, unit = _of_arrow(self.file, own, values)
            told = (own.metadata or {}).get(b"unit", b"").decode("utf-8", "replace") or unit
            has_unit = column_unit(own.name)[1] is not None or not told or bare_unit(told) is None
            names.append(own.name if has_unit else f"{own.name} [{told}]")
            columns.append(texts)
            are_texts.append(str(own.type) in ("string", "large_string", "string_view"))
        return _Columns(names, columns, are_texts)

    def _table(self) -> Any:
        try:
            pa, ipc, parquet = map(import_module, ("pyarrow", "pyarrow.ipc", "pyarrow.parquet"))
        except ImportError:
            raise UnsupportedFeatureError(
                f"{self.file.path}: a Parquet or Feather file needs the package pyarrow; install it with: pip "
                "install 'metrosep[parquet]'"
            ) from None
        source = pa.BufferReader(self.file.data)
        if self.file.head.startswith(_ARROW):
            table = ipc.open_file(source).read_all()
        else:
            held = parquet.ParquetFile(source, page_checksum_verification=True)
            _refuse_many(self.file, held.metadata.num_rows * held.metadata.num_columns)
            table = held.read(use_threads=False)
        _refuse_many(self.file, table.num_rows * table.num_columns)
        table.validate(full=True)
        return table


def _of_arrow(file: RawFile, own: Any, values: Any) -> tuple[list[str], str]:
    """Return a column as texts, and its unit where the type tells it."""
    pa = import_module("pyarrow")
    kind, unit = own.type, ""
    if pa.types.is_dictionary(kind):
        values = pa.chunked_array([c.dictionary_decode() for c in values.chunks], kind.value_type)
        kind = kind.value_type
    if pa.types.is_duration(kind):
        unit = kind.unit
        values = values.cast(pa.int64())
    elif pa.types.is_timestamp(kind):
        zone = "" if kind.tz is None else "Z"  # such a column holds UTC
        stamps = values.cast(pa.timestamp(kind.unit)).to_numpy()
        return ["" if np.isnat(t) else f"{t}{zone}" for t in stamps], ""
    elif pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_boolean(kind):
        pass
    elif not (
        pa.types.is_string(kind)
        or pa.types.is_large_string(kind)
        or pa.types.is_date(kind)
        or pa.types.is_time(kind)
        or pa.types.is_decimal(kind)
        or pa.types.is_null(kind)
    ):
        raise UnsupportedFeatureError(
            f"{file.path}: column {own.name!r} holds {kind} values; write the table without that column"
        )
    plain = (pa.types.is_floating, pa.types.is_integer, pa.types.is_duration)
    if any(test(kind) for test in plain):
        return ["" if v is None else repr(v) for v in values.to_pylist()], unit
    return ["" if v is None else _clean(str(v)) for v in values.to_pylist()], unit


# ---- .npz: arrays of one length are the columns of one table, a matrix is a table of its own ----------


@dataclass
class _Arrays(_Container):
    """Arrays of an ``.npz`` file; none is ever unpickled."""

    kind: str = field(default="array", init=False)

    def __post_init__(self) -> None:
        self._archive = Archive(self.file, "the archive", "write it again with numpy.savez")
        self._loaded: dict[str, NDArray[Any]] | None = None

    def holding(self) -> dict[str, str]:
        found = {}
        for names, n_rows in self._groups():
            listed = ", ".join(names[:6]) + (", ..." if len(names) > 6 else "")
            what = f"with {listed}, " if len(names) > 1 else ""
            found[names[0]] = f"{what}{n_rows} rows"
        return found

    def named(self, wanted: str, found: Collection[str], listed: str) -> str:
        for names, _ in self._groups():
            if wanted in names:
                return names[0]
        return super().named(wanted, found, listed)

    def _groups(self) -> list[tuple[list[str], int]]:
        """Return the arrays that belong together, and how many rows they have."""
        columns: dict[int, list[str]] = {}
        others = []
        for name, values in self.arrays.items():
            if values.ndim == 1:
                columns.setdefault(len(values), []).append(name)
            elif values.ndim == 2:
                others.append(([name], len(values)))
        groups = [(names, n) for n, names in columns.items()]
        return [
            (names, n)
            for names, n in (*groups, *others)
            if any(self.arrays[m].dtype.kind in "iuf" for m in names)
        ]

    @property
    def arrays(self) -> dict[str, NDArray[Any]]:
        """The arrays by name."""
        if self._loaded is None:
            self._loaded = self._load()
        return self._loaded

    def _load(self) -> dict[str, NDArray[Any]]:
        found: dict[str, NDArray[Any]] = {}
        for member in self._archive.members:
            if not member.endswith(".npy"):
                continue
            data = self._archive.read(member, limit=8 * MAX_PIXELS)
            raw = RawFile(self.file.path, data)
            name = member.removesuffix(".npy")
            try:
                found[name] = array_of(raw, 2**62, kinds="iufbUSM", dimensions=(0, 1, 2))[0]
            except UnsupportedFeatureError as exc:
                self.left += (f"array {name!r} was omitted: {exc}",)
        return found

    def read(self, name: str) -> _Columns:
        names = next(names for names, _ in self._groups() if names[0] == name)
        values = [self.arrays[n] for n in names]
        is_matrix = values[0].ndim == 2
        if is_matrix:
            names = [f"column{k + 1}" for k in range(values[0].shape[1])]
            values = list(values[0].T)
        _refuse_many(self.file, sum(v.size for v in values))
        return _Columns(
            names,
            [_of_array(v) for v in values],
            [v.dtype.kind in "US" for v in values],
            self.left,
            are_named=not is_matrix,
        )


def matrix_of(file: RawFile, sheet: str | None) -> tuple[str, NDArray[Any]] | None:
    """Return name and values of the array to read, where that is a matrix."""
    with _explained(file, _TITLES["npz"]):
        archive = _Arrays(file)
        name = archive.chosen(sheet)
        values = archive.arrays[name]
    return (name, values) if values.ndim == 2 else None


def _of_array(values: NDArray[Any]) -> list[str]:
    """Return a column of an array as texts."""
    if values.dtype.kind == "M":
        return ["" if np.isnat(v) else str(v) for v in values]
    if values.dtype.kind == "S":
        return [_clean(v.decode("utf-8", "replace")) for v in values.tolist()]
    if values.dtype.kind == "f" and values.dtype.itemsize > 8:  # to the nearest float
        values = values.astype(np.float64)
    return [_of_value(v) for v in values.tolist()]


_KINDS: Final[Mapping[str, type[_Container]]] = {
    "worksheet": _Worksheets,
    "sqlite": _Database,
    "parquet": _Parquet,
    "npz": _Arrays,
}
_TITLES: Final = {
    "worksheet": "the workbook",
    "sqlite": "the SQLite file",
    "parquet": "the Parquet or Feather file",
    "npz": "the .npz file",
}
