"""A text file as columns of numbers and labels, with the units that it declares.

Numbers stay as they stand in the file; `Column.values` and the unit give SI where a reader asks
for it. Counts of fields are checked on every line, so that a file cut in the middle of a row or a
row with a field too many is named by its line instead of being filled or shifted.
"""

from __future__ import annotations

import copy
import itertools
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from decimal import Decimal
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    AmbiguousFormatError,
    CorruptFileError,
    FormatMismatchError,
    UnitError,
)
from metrosep.core.text_options import TextOptions
from metrosep.core.units import Unit, parse_unit
from metrosep.io.own_notes import is_marked
from metrosep.io.source import RawFile
from metrosep.io.text._compiled import Words, different
from metrosep.io.text._rows import (
    DECIMAL_SHOWN,
    Block,
    Body,
    joined,
)
from metrosep.io.text.dialect import (
    NO_COMMENT,
    find_layout,
    is_comment,
    number_of,
    quantity,
    refuse_long,
    unmeasured_rows,
)
from metrosep.io.text.encoding import (
    BEYOND,
    NO_READING,
    decode,
    encoding_of,
    encoding_of_head,
    lines_before,
    plain_ends,
    refuse_zero_bytes,
)
from metrosep.io.text.lines import (
    Ledger,
    are_numbered_rows,
    are_rows_like_comments,
    bad_field,
    cut_off,
    is_named_by_number,
    is_rule,
    lines_of_field,
    one_or_thousand,
    refuse_quotes,
    row_in_comment,
    unframed,
)
from metrosep.io.text.preamble import BEGUN, Preamble, names_a_number
from metrosep.io.text.quality import marked_bad, marker_of
from metrosep.io.text.times import (
    Entries,
    Moments,
    is_long_count,
    is_moment,
    may_be_minutes,
    moments,
)

_SAMPLE = 300
"""Rows that are looked at first; further ones come from `_PLACES` parts of the rest."""
_PLACES, _PLACE = 9, 2000
_FIRST_PART = 20_000
"""Characters that show whether all rows begin with the mark of a comment."""
_LONG_FIELD = 2000
"""Characters in which a field in quotes that takes several lines must end."""
_COUNTED = 20
"""Rows that show whether they begin with "1", "2", "3"."""
_FEW = 3
"""Separators from which a line of nothing else, above or below a map, is a row of it."""
_WHOLE = 2.0**53
"""Largest number up to which every whole number is a float."""
_CONTAINERS = (b"PK\x03\x04", b"SQLite format 3\x00", b"PAR1", b"ARROW1")
"""First bytes of files that may hold tables: workbooks and archives, SQLite, Parquet, Feather."""
_DECLARATION = re.compile(r'\s*"?sep=(.)"?\s*', re.IGNORECASE)
_RUN = re.compile(r'"?run"?\s*[,;\t]')
_SEPARATOR = re.compile(r"[,;\t]")
_NUMBER_SIGN = re.compile(r'\s*("#"|#)\s*[,;\t|]')
_BLANKS = re.compile(r"\n+")


@dataclass(frozen=True, slots=True, eq=False)
class Column:
    """One column of a table."""

    name: str  # as in the header, or ``column1`` where there is none
    unit: Unit | None  # what the file declares
    # shape (n,), or None: numbers in the unit of the file, NaN = not measured; ``None`` for a
    # column of labels
    values: FloatArray | None
    labels: Sequence[str] | None = (
        None  # texts of a column of labels; a tuple once its dates are read
    )


class SinceFirst(NamedTuple):
    """Numbers of a clock of which a float does not hold every digit, from the first of them."""

    first: str  # as it is written
    lines: NDArray[np.int64]  # shape (n,): line of each row
    values: FloatArray  # shape (n,): in the unit of the file, exact before the rounding to a float


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Columns of a text file."""

    columns: tuple[Column, ...]  # in the order of the file
    lines: NDArray[np.int64]  # shape (n,): line of each row in the file, from 1
    # mapping: encoding, separator, decimal mark, comments and the lines above the table
    header: Mapping[str, Any]
    warnings: tuple[str, ...] = ()  # what is odd
    # mapping: how many lines of each class the text has, and which they are; empty for a recording
    ledger: Mapping[str, Any] = field(default_factory=dict)
    # mapping: by name, columns whose numbers are longer than a float, such as decimal s since 1970
    exact: Mapping[str, SinceFirst] = field(default_factory=dict)

    def __len__(self) -> int:
        return int(self.lines.size)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all columns."""
        return tuple(c.name for c in self.columns)

    @property
    def numbers(self) -> tuple[Column, ...]:
        """The columns of numbers."""
        return tuple(c for c in self.columns if c.values is not None)

    def __getitem__(self, name: str) -> Column:
        return next(c for c in self.columns if c.name == name)

    def since_first(self, column: Column) -> tuple[FloatArray, str]:
        """Return numbers of a clock from the first of them, before any is rounded, and that first one."""
        values = np.empty(0) if column.values is None else column.values
        first = next((f"{v:.17g}" for v in values if np.isfinite(v)), "")
        if (exact := self.exact.get(column.name)) is not None:
            first = exact.first
            values = exact.values[np.searchsorted(exact.lines, self.lines)]
        return values - next((v for v in values if np.isfinite(v)), np.nan), first


def read_table(file: RawFile, *, is_named: bool = False, **text: Any) -> Table:
    """Return the columns of a text file; every one of its lines is accounted for.

    Numbers among words below a unit are refused; where the caller names the columns it wants, only in those (`pick`).
    """
    source = TextTable(file, TextOptions.of(text))
    file = source.file
    n = len(source.head.names)  # empty columns may have a name, and fields without one be remarks
    rows = source.rows()
    dated = (*source.head.layout.dated, *[False] * n)[:n]
    columns = [
        Column(name, unit, values)
        if isinstance(values, np.ndarray)
        else Column(
            name, unit, None, values if is_dated or isinstance(values, Words) else tuple(values)
        )
        for name, unit, values, is_dated in zip(
            source.head.names, source.head.units, rows.columns, dated, strict=True
        )
    ]
    unnamed = source.head.facts["unnamed"]
    columns = [c for c in columns if c.name not in unnamed or not _is_empty(c)]
    names = columns[
        : int(source.head.has_own_runs)
    ]  # 07 or 2026-01-01: a name, whatever it looks like
    columns = columns[len(names) :]
    mixed: dict[str, CorruptFileError] = {}
    columns, beyond = _with_quantities(file, columns, rows.lines, source.head, mixed)
    for name, refused in mixed.items():
        if not is_named:
            more = "or, if that column is not wanted, name those that are, x= and z= of a profile"
            refused.args = (f"{refused}, {more}",)
            raise refused
        beyond.append(
            f"column {name!r} holds words ({refused.found} in {refused.field}) and numbers, and was read as one of words"
        )
    columns, clocks, undecided = with_moments(file, columns, rows.lines, source.head.options)
    exact = source.exact(columns, rows.lines)
    columns = [*names, *columns]
    odd, markers = markers_in(
        [c for c in columns if c.name not in exact], rows.lines, source.head.options
    )
    odd += marked_bad(file, columns[len(names) :], rows.lines)
    header = {**source.head.facts, "comments": source.comments, "clocks": clocks}
    if undecided:
        header["undecided"] = undecided
    if markers or mixed:
        whys = {n: str(e).removeprefix(f"{file.path}: ") for n, e in mixed.items()}
        header["markers"] = markers | whys
    warnings = (*source.warnings, *beyond, *markers.values(), *odd, *undecided.values())
    return Table(tuple(columns), rows.lines, header, warnings, source.lines, exact)


def text_of(file: RawFile, options: TextOptions | Mapping[str, Any]) -> RawFile:
    """Return the text with the columns: the file itself, or the table of a container that is chosen."""
    if not isinstance(options, TextOptions):
        options = TextOptions.of(options)
    if options.sheet is not None or file.head.startswith(_CONTAINERS):
        from metrosep.io.containers.sheets import as_text

        file = as_text(file, options)
    file.asked = options
    return file


def _is_empty(column: Column) -> bool:
    if column.values is None:
        return not any(different(column.labels or ()))
    return bool(np.isnan(column.values).all())


def _with_quantities(
    file: RawFile,
    columns: Sequence[Column],
    lines: NDArray[np.int64],
    head: TableHead,
    mixed: dict[str, CorruptFileError],
) -> tuple[list[Column], list[str]]:
    """Return the columns, those of numbers with one unit (1.5 mm) as numbers, and what is odd; add those that mix numbers and words."""
    words = NO_READING | {m for m in head.options.missing or () if isinstance(m, str)}
    markers = {m for m in head.options.missing or () if isinstance(m, float)}
    plain = head.layout.dialect.plain
    made, said = list(columns), []
    if head.layout.unproven:
        _refuse_groups(file, columns, lines, head)
    dated = {n for n, is_date in zip(head.names, head.layout.dated, strict=False) if is_date}
    for k, column in enumerate(columns):
        if column.labels is None or column.name in dated:
            continue
        kinds = {t: "" if t.lower() in words else t for t in different(column.labels)}
        if markers:  # also without the unit of the others
            kinds = {t: "" if float(plain(s) or "nan") in markers else s for t, s in kinds.items()}
        if not any(t[:1] in _DIGITS for t in kinds.values() if t):
            continue
        quantities = {t: quantity(s, head.layout.dialect) for t, s in kinds.items()}
        texts = [kinds[t] for t in column.labels]
        found = [quantities[t] for t in column.labels]
        unit = next((f[1] for f in found if f is not None), None)
        if unit is None or 2 * sum(f is not None for f in found) <= sum(map(bool, texts)):
            plains = [plain(t) for t in texts]
            bad = next((i for i, t in enumerate(texts) if t and plains[i] is None), None)
            if bad is None:  # words that the caller declares, and numbers
                values = np.array([float(p or "nan") for p in plains])
                made[k] = Column(column.name, column.unit, values)
            elif column.unit is not None and any(plains):  # which would be lost among words
                where = f"column {column.name!r}, in {column.unit.name},"
                mixed[column.name] = bad_field(file, int(lines[bad]), texts[bad], where)
            continue
        values = np.full(len(texts), np.nan)
        for i, (text, own) in enumerate(zip(texts, found, strict=True)):
            wanted = column.unit or unit
            if own is not None and own[1] != wanted:
                where = "its name says" if column.unit else "the rows above have"
                raise UnitError(
                    f"{file.path}: line {int(lines[i])}: column {column.name!r} holds {text[:40]!r} in "
                    f"{own[1].name}, but {where} {wanted.name}: a column has one unit; write all of it in one"
                )
            if text and own is None:
                where = f"column {column.name!r} of numbers with the unit {wanted.name}"
                raise bad_field(file, int(lines[i]), text, where)
            values[i] = np.nan if own is None or own[0] in markers else own[0]
        made[k] = Column(column.name, unit, values)
        if out := [i for i, t in enumerate(column.labels or ()) if t.lower() in BEYOND]:
            first = (column.labels or ())[out[0]]
            said.append(
                f"{len(out)} fields such as {first!r} (first: line {int(lines[out[0]])}) say that the sensor was "
                "out of its range; they count as not measured"
            )
    return made, said


_DIGITS = frozenset("0123456789+-.,\u2212")


def _refuse_groups(
    file: RawFile, columns: Sequence[Column], lines: NDArray[np.int64], head: TableHead
) -> None:
    """Refuse numbers with a unit such as 1,234 mm where no number of the file shows what the mark is.

    A plain number of another column that is not whole does: `Body` has refused those in doubt.
    """
    dialect = head.layout.dialect
    texts = {
        c.name: [number_of(t) for t in c.labels]
        for c in columns
        if c.labels is not None and any(quantity(t, dialect) for t in different(c.labels))
    }
    values = [c.values for c in columns if c.values is not None]
    if any(np.any(v[np.isfinite(v)] % 1.0) for v in values):
        return
    for mark in ",.":
        own = (t for numbers in texts.values() for t in numbers)
        if mark == dialect.decimal and any(map(DECIMAL_SHOWN[mark].search, own)):
            continue
        if mark == dialect.decimal == "." and dialect.separator not in ";\t":
            continue  # where a decimal comma would separate columns
        grouped = re.compile(rf"[+\-\u2212]?[1-9]\d{{0,2}}\{mark}\d{{3}}\s*")
        for name, numbers in texts.items():
            at = next((i for i, t in enumerate(numbers) if grouped.fullmatch(t)), None)
            if at is not None:
                field = next(c.labels for c in columns if c.name == name and c.labels)[at]
                raise one_or_thousand(file, int(lines[at]), field, name, mark)


_SHOWN = 2000
"""Entries of a column that show whether any is a date or a time of day."""


def with_moments(
    file: RawFile, columns: Sequence[Column], lines: NDArray[np.int64], options: TextOptions
) -> tuple[list[Column], dict[str, str], dict[str, str]]:
    """Return the columns with dates and times of day in s from the first row, and when that was.

    A date beside a time of day belongs to it; one date for all rows stays a text, and so does what can
    be read in two ways: a message by column, for whoever needs that time.
    """
    found: dict[int, Moments] = {}
    undecided: dict[str, str] = {}
    entries: dict[int, Entries] = {}
    words = NO_READING | {m for m in options.missing or () if isinstance(m, str)}

    def of(k: int, days: Entries | None = None) -> Moments | None:
        where = f"{file.path}: column {columns[k].name!r}"
        try:
            return moments(columns[k].labels or (), lines, where, days, entries=entries[k])
        except AmbiguousFormatError as exc:
            undecided[columns[k].name] = str(exc)
            return None

    for k, column in enumerate(columns):
        texts = column.labels or ()
        if not any(is_moment(t.strip('"')) for t in texts[:: 1 + len(texts) // _SHOWN]):
            continue
        own = entries[k] = Entries(texts)
        for i in np.flatnonzero(~own.is_known & ~own.is_empty).tolist():
            text = texts[i]
            own.is_empty[i] = text.lower() in words
            if not own.is_empty[i] and '"' in text:
                own.set(i, text.strip('"'))
        odd = np.flatnonzero(~own.is_known & ~own.is_empty)
        if odd.size and 2 * odd.size < np.count_nonzero(~own.is_empty):
            where = f"column {column.name!r} of dates and times"
            raise bad_field(file, int(lines[odd[0]]), texts[odd[0]].strip('"'), where, "moment")
        moment = None if odd.size else of(k)
        if moment is not None:
            found[k] = moment
    dates = [k for k, m in found.items() if m.kind == "date"]
    clocks = [k for k, m in found.items() if m.kind == "clock"]
    if len(dates) == len(clocks) == 1:
        (day,), (k,) = dates, clocks
        both = of(k, entries[day])
        if both is not None:
            found = {**{i: m for i, m in found.items() if i != day}, k: both}
    else:
        day = -1
    unsettled = [
        k for k, e in entries.items() if columns[k].name in undecided and e.is_dated.any()
    ]
    if len(unsettled) == len(clocks) == 1 and not dates:  # no time without the dates beside it
        del found[clocks[0]]
        undecided[columns[clocks[0]].name] = undecided[columns[unsettled[0]].name]
    for k in [k for k in clocks if k in found and found[k].kind == "clock"]:
        texts = columns[k].labels or ()
        if not (len(dates) == len(clocks) == 1) and may_be_minutes(texts, entries[k]):
            del found[k]
            undecided[columns[k].name] = (
                f"{file.path}: column {columns[k].name!r}: times such as {texts[0]!r} may be hours and minutes, "
                "or minutes and seconds; write them as hh:mm:ss, or give sampling_rate="
            )
    unit = parse_unit("s")
    made = [
        Column(c.name, unit, m.seconds)
        if (m := found.get(k)) is not None and np.any(m.seconds)
        else c
        if c.labels is None or isinstance(c.labels, Words)
        else replace(c, labels=tuple(c.labels))
        for k, c in enumerate(columns)
    ]
    kept = [c for k, c in enumerate(made) if k != day or k in found]
    return kept, {columns[k].name: m.start for k, m in found.items()}, undecided


class TextTable:
    """A table of a text file: what stands above it at once, its rows block by block."""

    def __init__(self, file: RawFile, options: TextOptions) -> None:
        file = text_of(file, options)
        options = replace(options, sheet=None, **file.written)
        self.file = self._file = file
        whole = file.size <= _BLOCK
        self._encoding = options.encoding or ("" if whole else encoding_of_head(file))
        self._decided = bool(options.encoding)  # else the first text beyond ASCII decides
        self._text: str | None = None
        if whole or re.match("utf.?(16|32)", self._encoding, re.IGNORECASE):
            text, self._encoding = decode(file.data, file.path, options.encoding)
            self._text = unframed(text, text[:_FIRST_PART])
            self.head = TableHead(file, self._text, self._encoding, options)
            return
        with file.stream() as handle:
            raw = handle.read(_BLOCK)
            file.demand_bytes(len(raw) + max(file.size - _BLOCK, 0))
            self._decide(raw)
            top = _plain(file, raw[: raw.rfind(_end_of(raw)) + 1], self._encoding, 0)
            self._first_part = top[:_FIRST_PART]
            top = unframed(top, self._first_part)
            further: list[str] = []
            for k in range(1, _PLACES + 1):
                handle.seek(max(file.size - _PLACE, 0) * k // _PLACES)
                raw = handle.read(_PLACE)
                self._decide(raw)
                part = plain_ends(raw.decode(self._encoding, "replace"))
                further += _usable(unframed(part, self._first_part), options)
        self.head = TableHead(file, top, self._encoding, options, further)

    def _decide(self, raw: bytes) -> None:
        """Decide the encoding of the whole text at the first bytes that are not ASCII, which all encodings share."""
        if not self._decided and not raw.isascii():
            self._encoding, self._decided = encoding_of(self._file, _BLOCK), True

    def rows(self) -> Block:
        """Return all rows; a column that begins with empty fields is one of words where words follow, and no number."""
        late: dict[int, CorruptFileError] = {}
        while True:
            try:
                rows = joined(self.blocks(), self._labels(), self._rows_at_most())
            except CorruptFileError as refused:
                if (k := self.words_in) is None:
                    raise
                late[k] = refused
                self.take_words(k)
                continue
            plain = self.head.layout.dialect.plain
            for k, why in late.items():
                if any(plain(str(t)) is not None for t in set(rows.columns[k])):
                    raise why
            return rows

    def _labels(self) -> tuple[bool, ...]:
        n = len(self.head.names)
        return (*self.head.layout.labels, *[False] * n)[:n]

    @property
    def words_in(self) -> int | None:
        """The column that was refused for its first word, below empty fields."""
        return self._body.words_in

    def take_words(self, k: int) -> None:
        """Take a column as one of words, when the rows are read again."""
        labels = self._labels()
        labels = (*labels[:k], True, *labels[k + 1 :])
        self.head.layout = replace(self.head.layout, labels=labels)

    def _rows_at_most(self) -> int:
        """Return a guess of the number of rows, from the length of the lines at the start."""
        head = self.file.head_lines
        return 16 + int(1.1 * self.file.size * max(head.count(_end_of(head)), 1) / len(head))

    def blocks(self) -> Iterator[Block]:
        """Yield the rows; at the end the lines must add up, and what was odd is known."""
        self._body = body = self.head.body()
        self.warnings: tuple[str, ...] = ()
        self.comments: tuple[str, ...] = ()
        text, hidden, n_rows = "", self.head.first_line - 1, 0
        for part, last in self._texts():
            text = "".join(part.split("\n", hidden)[hidden:]) if hidden else part
            hidden -= min(hidden, part.count("\n")) if hidden else 0
            for block in body.take(text, last=last):
                n_rows += block.lines.size
                yield block
        body.finish()
        self.comments = (*self.head.comments, *body.comments)
        self.warnings = (*self.file.notes, *self.head.warnings(n_rows), *body.warnings)
        if body.last_row and not text.endswith("\n") and text.endswith(body.last_row):
            self.warnings += tuple(cut_off(self._file, text, body.last_row, body.last_line))
        self.lines: Mapping[str, Any] = body.ledger.to_dict()

    def exact(self, columns: Sequence[Column], lines: NDArray[np.int64]) -> dict[str, SinceFirst]:
        """Return columns of long counts from their first number, by the digits that stand in the file.

        A column whose fields are not the numbers that were read (one over several lines) is omitted.
        """
        long = [c for c in columns if c.values is not None and is_long_count(c.name, c.values)]
        texts: dict[str, list[str]] = {c.name: [] for c in long}
        places = [(texts[c.name], self.head.names.index(c.name)) for c in long]
        dialect, above = self.head.layout.dialect, 0
        for part, _ in self._texts() if long else ():
            every = part.split("\n")
            low, high = np.searchsorted(lines, [above + 1, above + len(every)])
            rows = dialect.split(every[n] for n in (lines[low:high] - above - 1).tolist())
            above += len(every) - 1
            for own, k in places:
                fields = (f[k].strip().strip('"') if k < len(f) else "" for f in rows)
                own += [dialect.plain(f) or "nan" for f in fields]
        found = {}
        for c in long:
            own = texts[c.name]
            read = np.empty(0) if c.values is None else c.values
            if np.array_equal(np.array(own, dtype=np.float64), read, equal_nan=True):
                first = next(t for t in own if t != "nan")
                start = Decimal(first)
                since = np.array([float(Decimal(t) - start) for t in own])
                found[c.name] = SinceFirst(first, lines, since)
        return found

    def _texts(self) -> Iterator[tuple[str, bool]]:
        """Yield whole lines, and whether they are the last."""
        if self._text is not None:
            yield self._text, True
            return
        mark = _end_of(self._file.head)
        left, n_bytes = b"", 0
        with self._file.stream() as handle:
            data = handle.read(_BLOCK)
            while data:
                follows = handle.read(_BLOCK)
                raw = left + data
                end = raw.rfind(mark) + 1 if follows else len(raw)
                if follows and mark == b"\r" and end == len(raw):
                    end = raw.rfind(mark, 0, -1) + 1  # a line feed may follow
                raw, left, data = raw[:end], raw[end:], follows
                if len(left) > _BLOCK:
                    raise FormatMismatchError(
                        f"{self._file.path}: holds a line longer than {_BLOCK} bytes: not a table"
                    )
                if not self._decided:
                    self._decide(raw)
                    refuse_zero_bytes(self._file, raw, n_bytes)
                    self.head.facts["encoding"] = self._encoding
                part = _plain(self._file, raw, self._encoding, n_bytes)
                yield unframed(part, self._first_part), not follows
                n_bytes += len(raw)
        self._file.demand_bytes(n_bytes)


_BLOCK = 2**22
"""Bytes of text that are taken at once; a shorter file is taken whole."""


def _end_of(head: bytes) -> bytes:
    r"""Return the byte that ends lines: CR only where there is no LF."""
    return b"\n" if b"\n" in head else b"\r"


def _plain(file: RawFile, raw: bytes, encoding: str, start: int) -> str:
    """Return the lines of a text that begin at a byte of the file."""
    try:
        return plain_ends(raw.decode(encoding))
    except (UnicodeDecodeError, LookupError) as exc:
        odd = start + (exc.start if isinstance(exc, UnicodeDecodeError) else 0)
        at = 1 + lines_before(file, odd, _end_of(file.head))
        raise file.corrupt(f"is not {encoding} text", field=f"line {at}") from None


def markers_in(
    columns: Sequence[Column], lines: NDArray[np.int64], options: TextOptions
) -> tuple[list[str], dict[str, str]]:
    """Return warnings about values that may mean "not measured", and what says so of columns where it is sure."""
    found: list[str] = []
    markers: dict[str, str] = {}
    for column in () if options.missing is not None else columns:
        if column.values is None:
            continue
        if column.unit is not None and column.unit.dimension == "time":
            most = float(np.fmax.reduce(column.values, initial=0.0))
            whole = max(most, -float(np.fmin.reduce(column.values, initial=0.0)))
            if whole > _WHOLE:
                step = np.spacing(whole) * column.unit.factor
                found.append(
                    f"column {column.name!r} holds numbers of {len(f'{whole:.0f}')} digits, which are kept to "
                    f"{step:.2g} s; export the time from the start of the recording if that is too coarse"
                )
            continue
        marker = marker_of(column.values)
        if marker is None:
            continue
        value, ratio, sure = marker
        at = np.flatnonzero(column.values == value)
        text = repr(value).removesuffix(".0")
        message = (
            f"column {column.name!r} holds {text} in {at.size} row(s) (first: line {int(lines[at[0]])}), "
            f"{ratio:.3g} times the spread of the others away; if it means 'not measured', give "
            f"missing='{text}', else missing='none'"
        )
        if sure:
            markers[column.name] = message
        else:
            found.append(message)
    return found, markers


def without_empty_rows(table: Table) -> Table:
    """Return a table without the rows of which every field is empty, with a warning that names them."""
    filled = np.zeros(len(table), dtype=np.bool_)
    for c in sorted(table.columns, key=lambda c: c.values is None):
        if not filled.all():
            filled |= list(map(bool, c.labels or ())) if c.values is None else ~np.isnan(c.values)
    if filled.all() or not filled.any():
        return table
    columns = tuple(
        replace(
            c,
            values=None if c.values is None else c.values[filled],
            labels=None if c.labels is None else tuple(itertools.compress(c.labels, filled)),
        )
        for c in table.columns
    )
    lines = table.lines[~filled]
    said = f"line {int(lines[0])} holds no value and was omitted ({lines.size} such row(s))"
    return replace(
        table, columns=columns, lines=table.lines[filled], warnings=(*table.warnings, said)
    )


def refuse_row_gap(file: RawFile, said: str | None, otherwise: str) -> None:
    """Refuse rows whose place is counted where their own numbers have a gap: all later ones would lie too early."""
    if said:
        raise FormatMismatchError(
            f"{file.path}: {said}, and all later rows would lie too early; give the rows a column of position or "
            f"time, or {otherwise}"
        )


AS_THEY_FOLLOW = "to take them as they follow one another"
"""What the option does that is named beside a gap."""


def interruption(table: Table) -> tuple[str, ...]:
    """Return a warning about lines without numbers between the rows, where time is counted by rows."""
    gaps = np.flatnonzero(np.diff(table.lines) > 1)
    if not gaps.size or "separator" not in table.header:
        return ()
    if np.sum(np.diff(table.lines)[gaps] - 1) <= _rules_between(table):
        return ()  # nothing but lines drawn between the rows
    first = int(table.lines[gaps[0]]) + 1
    return (
        (
            f"line {first} stands between the rows and holds no sample ({gaps.size} such place(s)), and the file "
            "has no column of time; if samples were lost there, all later ones are too early"
        ),
    )


def _rules_between(table: Table) -> int:
    """Return how many drawn lines stand neither above nor below the rows."""
    listed = table.ledger.get("listed", {}).get("rule", {}).get("numbers", "")
    n = int(table.ledger.get("rule", 0))
    for part in filter(None, listed.split(", ")):
        first, _, last = part.partition("-")
        if int(first) < table.lines[0] or int(first) > table.lines[-1]:
            n -= int(last or first) - int(first) + 1
    return n


class TableHead:
    """What stands above the rows of a table: its layout, names and units; each line is classified."""

    def __init__(
        self,
        file: RawFile,
        text: str,
        encoding: str,
        options: TextOptions,
        further: Sequence[str] = (),
    ) -> None:
        self._file, self._ledger = file, Ledger()
        self.comments: list[str] = []
        self.has_own_runs = (
            False  # whether metrosep wrote it: the first column holds names of runs
        )
        n_marks = 0  # and how many separators its header has
        content: list[tuple[int, str]] = []  # number of the line, and the line itself
        others: list[tuple[int, str, str]] = []
        spans: dict[int, list[str]] = {}  # further lines of a name or a field in quotes
        position = number = n_measured = 0
        first_lines = text[:_FIRST_PART].split("\n")[:-1] if options.comment is None else []
        if are_rows_like_comments(first_lines):
            options = replace(options, comment=NO_COMMENT)
        self._is_numbered = are_numbered_rows(first_lines)
        while position < len(text) and n_measured <= _SAMPLE:
            end = text.find("\n", position)
            end = len(text) if end < 0 else end
            line = text[position:end]
            position, number = end + 1, number + 1
            if (
                not line and not options.skip_lines and number > options.skip_rows
            ):  # a worksheet may have a million of them
                run = _BLANKS.match(text, position)
                n = 0 if run is None else run.end() - position
                others.append((number, "\n" * n, "blank"))
                position, number = position + n, number + n
                continue
            declared = _DECLARATION.fullmatch(line) if number == 1 else None
            if options.sets_aside(number):
                others.append((number, line, "set aside"))
            elif declared is not None:
                others.append((number, line, "declaration"))
                options = replace(options, separator=options.separator or declared.group(1))
            elif not line.strip() and line.count("\t") < _FEW:
                others.append((number, line, "blank"))
            elif is_rule(line):
                others.append((number, line, "rule"))
            elif is_comment(line, options.comment) and not (
                (self.has_own_runs and len(_SEPARATOR.findall(line)) >= n_marks)
                or (self._is_numbered and is_named_by_number(line))
            ):
                others.append((number, line, "comment"))
            else:
                first = number
                refuse_long(file, number, line)
                if not content and _RUN.match(line):
                    above = (t.lstrip('# "') for _, t, k in others if k == "comment")
                    self.has_own_runs = any(map(is_marked, above))
                    n_marks = len(_SEPARATOR.findall(line))
                if line.replace('["]', "").replace('(")', "").count('"') % 2:
                    rest = text[position : position + _LONG_FIELD].split("\n")
                    more = spans[first] = lines_of_field([line, *rest], BEGUN.match)
                    line = " ".join([line, *more])
                    refuse_quotes(file, first, line)
                    position += sum(len(m) + 1 for m in more)
                    number += len(more)
                content.append((first, line))
                n_measured += unmeasured_rows([line]) == 0 or n_measured > 0
        self.options = options
        lines = [line for _, line in content]
        further = further or _further(text[position:], options)
        layout = find_layout(
            lines, file.path, options=options, further=further, labelled=self.has_own_runs
        )
        self.first_line = content[layout.start][0]
        if layout.start and options.comment is None:  # rows that are named like comments: #1
            header = content[layout.start - 1][0]
            fields = (
                (n, layout.dialect.split([line])[0]) for n, line, k in others if k == "comment"
            )
            named = [n for n, f in fields if n > header and row_in_comment(f, layout)]
            self.first_line = min([self.first_line, *named])
        preamble = Preamble(file, layout, lines[layout.start : layout.start + _COUNTED])
        kinds = {
            place: preamble.take(line, place) or "preamble"
            for place, line in content[: layout.start]
        }
        commented = 0  # the last comment whose mark is a name
        for place, line, kind in others:
            if place >= self.first_line:
                break
            if kind == "blank":
                self._ledger.count(kind, 1 + line.count("\n"))
                continue
            self._ledger.add(kind, place, line)
            if kind == "comment":
                is_named = _NUMBER_SIGN.match(line)  # the name of the first column is #
                marks = " \t" if is_named else '#%!;/" \t'
                if line.lstrip()[0] == layout.dialect.separator and layout.n == len(
                    layout.dialect.split([line])[0]
                ):
                    marks = " \t"  # the first column has no name
                self.comments.append(line.strip().lstrip(marks).rstrip('"'))
                commented = place if is_named else 0
        preamble.take_comment(self.comments, commented)
        kinds |= dict.fromkeys(preamble.rest(self.first_line), "preamble")
        for place, line in content[: layout.start]:
            self._ledger.add(kinds[place], place, line)
            for k, further_line in enumerate(spans.get(place, ()), start=1):
                self._ledger.add(kinds[place], place + k, further_line)
        self.names, self.units = preamble.columns()
        self.warnings = preamble.warnings
        self.layout, self._header = layout, preamble.rows
        self.facts: dict[str, Any] = {
            "encoding": encoding,
            "separator": layout.dialect.separator,
            "decimal": layout.dialect.decimal,
            "quoted": layout.dialect.quoted,
            "n_fields": layout.n_raw,
            "columns": self.names,
            "named": preamble.named,
            "unnamed": preamble.unnamed,
            "preamble": tuple(lines[: layout.start]),
        }

    def body(self) -> Body:
        """Return what takes the lines from the first row on."""
        return Body(
            self._file,
            self.layout,
            self.options,
            copy.deepcopy(self._ledger),
            first=self.first_line,
            names=self.names,
            header=self._header,
            has_own_runs=self.has_own_runs,
            is_map=not self.facts["named"] and len(self.names) > _FEW,
            is_numbered=self._is_numbered,
            may_be_words=self._may_be_words(),
        )

    def _may_be_words(self) -> Iterator[int]:
        """Yield named columns without a field in the sample, of which neither name nor unit says numbers.

        A first word under no name is that of a row: "Mean, 5, 1.2" among the readings.
        """
        empty = (*self.layout.empty, *[True] * len(self.names))
        labels = (*self.layout.labels, *[False] * len(self.names))
        is_named = self.facts["named"]
        for k, (name, unit) in enumerate(zip(self.names, self.units, strict=True)):
            if k == 0 and (not is_named or name in self.facts["unnamed"]):
                continue
            if empty[k] and not labels[k] and unit is None and not names_a_number(name):
                yield k


def _further(rest: str, options: TextOptions) -> list[str]:
    """Return whole lines from all over the rest of a text: they decide with the first ones."""
    places = (len(rest) * k // _PLACES for k in range(_PLACES))
    return [line for at in places for line in _usable(rest[at : at + _PLACE], options)]


def _usable(part: str, options: TextOptions) -> list[str]:
    """Return the whole lines of a part that may be rows."""
    lines = part.split("\n")[1:-1]
    return [line for line in lines if line.strip() and not is_comment(line, options.comment)]
