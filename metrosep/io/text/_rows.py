"""Every physical line of a text: to which class it belongs, and the rows of numbers.

One mechanism for all doors: `read`, `read_runs`, `open_stream` and `check` hand the lines from the
first row on to a `Body`, in blocks. A line is data, blank, a comment, a repeated header, a footer or
set aside by the caller; any other line is refused with its number. Nothing is left out for the
reason that the rest fits.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterable, Iterator, Sequence, Set
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import AmbiguousFormatError, CorruptFileError
from metrosep.core.text_options import TextOptions
from metrosep.io.source import RawFile
from metrosep.io.text._compiled import (
    Stamps,
    columns_of,
    may_hold_comments,
    may_hold_words,
    n_in,
    single_blanks,
    stacked,
    without_groups,
    without_quotes,
    words_in,
)
from metrosep.io.text.dialect import (
    LONGEST_FIELD,
    MARKS,
    NO_COMMENT,
    NUMBER_LIKE,
    Layout,
    bare_unit,
    is_comment,
    n_used,
    refuse_long,
)
from metrosep.io.text.encoding import BEYOND, NO_READING
from metrosep.io.text.lines import (
    Ledger,
    bad_field,
    is_drawn,
    is_named_by_number,
    is_rule,
    lines_of_field,
    may_go_on,
    one_or_thousand,
    refuse_quotes,
    row_in_comment,
    stray_text,
)
from metrosep.io.text.quality import changes_row

_PART: Final = 2**20
"""Characters that are parsed at once: what is odd in one part does not slow the others."""
_MANY: Final = 4
"""Such parts that are tried together first, since each call of a parser has its price."""
DECIMAL_SHOWN = {
    mark: re.compile(
        rf"(?<![\d.,])(?:0\d*{m}\d|\d{{4,}}{m}\d|\d{{1,3}}{m}(?:\d{{1,2}}|\d{{4,}})(?![\d.,])|{m}\d|"
        rf"\d+{m}\d+[eEdD])"
    )
    for mark, m in ((",", ","), (".", r"\."))
}
"""A number that shows what its mark is: 0,123 or 1,25 or 1234,567, but not 1,234."""

_REMARK = re.compile(r"\s+[#%]\s*[^\W\d].*")
"""What somebody wrote behind a row."""
_COUNTED = re.compile(r"\(\d+ [^\W\d]+(?: [^\W\d]+)?\)|\d+ rows? in set\b.*")
"""What a database writes below a table: (20 rows), (20 rows affected), 20 rows in set (0.00 sec)."""
_RULED = "-=*~_<>[] "
"""What people put round a line below a table: --- end ---."""

_IN_DOUBT = {
    ",": re.compile(r"(?<![\d.,])[1-9]\d{0,2},\d{3}(?![\d.,])"),
    ".": re.compile(r"(?<![\d.,])[1-9]\d{0,2}\.\d{2}0(?![\d.,])"),
}
"""A number that may be in groups of thousands; with a point only where it ends in 0."""


_INFINITE = {word for word in BEYOND if "inf" in word}

_THREE_DIGITS = re.compile(r"(?<![\d.,])[1-9]\d{0,2}\.\d{3}(?![\d.,])")

_APART = re.compile(r"[^\w/\u00b0%'\u2019]+|_")


def _names_unit(comment: str) -> bool:
    """Whether a comment names a unit that readings may have: they may have changed to it."""
    units = (bare_unit(w) for w in _APART.split(comment) if len(w) > 1 and w != "in")
    return any(u is not None and u.dimension in ("length", "angle", "voltage") for u in units)


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Rows in the order of the file: numbers or texts of each column, and the line of each row."""

    columns: list[FloatArray | Sequence[str]]
    lines: NDArray[np.int64]


def joined(blocks: Iterable[Block], labels: Sequence[bool], size: int) -> Block:
    """Return blocks one below the other, each given up once it is taken; `size` is a guess of the rows."""
    n = 0
    lines: Any = np.empty(size, dtype=np.int32 if size < 2**30 else np.int64)
    columns: list[Any] = [[] if label else np.empty(size) for label in labels]
    for block in blocks:
        end = n + block.lines.size
        if end > lines.size:  # memory that nothing is written to costs nothing
            if end + end // 4 >= 2**31:
                lines = lines.astype(np.int64)
            for kept in (lines, *(c for c in columns if not isinstance(c, list))):
                kept.resize(end + end // 4, refcheck=False)
        lines[n:end] = block.lines
        for kept, values in zip(columns, block.columns, strict=True):
            if isinstance(kept, list):
                kept.append(values)
            else:
                kept[n:end] = values
        n = end
    for kept in (lines, *(c for c in columns if not isinstance(c, list))):
        kept.resize(n, refcheck=False)
    return Block([stacked(c) if isinstance(c, list) else c for c in columns], lines)


class Body:
    """The lines from the first row on, taken block by block; each enters the ledger."""

    def __init__(
        self,
        file: RawFile,
        layout: Layout,
        options: TextOptions,
        ledger: Ledger,
        *,
        first: int,
        names: Sequence[str],
        header: Iterable[Sequence[str]] = (),
        is_map: bool = False,
        has_own_runs: bool = False,
        is_numbered: bool = False,
        may_be_words: Iterable[int] = (),
    ) -> None:
        self._file, self._layout, self._options, self.ledger = file, layout, options, ledger
        self._names = tuple(names)
        self._n = len(self._names)
        self._labels = [*layout.labels, *[False] * self._n][: self._n]
        self._header = [[f.strip() for f in fields] for fields in header]
        self._is_map, self._has_own_runs = is_map, has_own_runs
        self._is_numbered = is_numbered  # names of the rows such as #1 are no comments
        self._open = set(may_be_words)  # columns without a field so far, which may hold words
        self.words_in: int | None = (
            None  # the one of these in which words stand, once it was refused
        )
        self._words = NO_READING | {m for m in options.missing or () if isinstance(m, str)}
        self._pending: list[
            tuple[int, str, bool]
        ] = []  # text or empty rows: footer, unless data follow
        self._unproven = layout.unproven
        # a point may stand between groups where a decimal comma is no separator: spreadsheets of Europe
        self._may_be_comma = layout.dialect.decimal == "." and layout.dialect.separator in ";\t"
        self._whole: list[bool] = [
            False
        ] * self._n  # columns with unmarked numbers of 1 to 3 digits
        self._grouped: list[tuple[int, str] | None] = [
            None
        ] * self._n  # and the first such as 1.000
        self._surplus: list[int] = []
        self._lacking: list[int] = []  # lines of rows without their last fields
        self._unworded: tuple[str, int] | None = None  # the first without its word, and its fields
        self._short: tuple[int, str, int] | None = None  # the first of which the numbers end early
        self._n_short = 0
        self._has_whole = False  # whether a row had all its fields
        self._like_rows: list[int] = []  # lines with the mark of a comment and the fields of a row
        self._telling: list[tuple[int, str]] = []  # comments within that name a unit or a fault
        self._beyond: list[tuple[int, str]] = []
        self._groups: list[tuple[int, str]] = []  # the first field with groups of digits
        self._n_groups = 0
        self._has_words: bool | None = None  # whether a field may say that nothing was measured
        self._markers = [m for m in options.missing or () if isinstance(m, float)]
        self.comments: list[str] = []
        self._left = ""  # lines of a field in quotes that ends in the part that follows
        self.line = first  # number of the line that comes next
        self.last_row, self.last_line = "", 0

    @property
    def warnings(self) -> tuple[str, ...]:
        """What has changed its meaning without being lost, so far."""
        found = []
        mark = self._layout.dialect.thousands
        if mark and self._options.thousands is None:
            found.append(
                f"{mark!r} was read as the mark between groups of three digits, since a column holds numbers "
                f"of three digits and fewer beside others with {mark!r} before three digits; if it is the "
                f"decimal mark, give decimal='{mark}'"
            )
        if self._lacking:
            found.append(
                f"{_rows(len(self._lacking))} fewer fields than there are names (first: line "
                f"{self._lacking[0]}); the last ones, up to {self._names[-1]!r}, count as empty"
            )
        if self._surplus:
            found.append(
                f"{_rows(len(self._surplus))} more separators at the end than the others (first: line "
                f"{self._surplus[0]}); they were omitted, since nothing stands behind them"
            )
        for found_at, n, what in (
            (
                self._beyond,
                len(self._beyond),
                "say that the sensor was out of its range; they count as not measured",
            ),
            (
                self._groups,
                self._n_groups,
                "were read as groups of three digits, since the file has another decimal mark",
            ),
        ):
            if found_at:
                line, text = found_at[0]
                found.append(f"{n} fields such as {text!r} (first: line {line}) {what}")
        if texts := self.ledger.texts("remark"):
            line, _ = self.ledger.first("remark")
            found.append(
                f"line {line}: {texts[0][:40]!r} stands behind the row and was taken as a remark "
                f"({len(texts)} such row(s))"
            )
        if self._telling:
            line, text = self._telling[0]
            found.append(
                f"line {line}: the comment {text[:40]!r} within the table may change what the rows below it say "
                f"({len(self._telling)} such comment(s)); they were read like the others"
            )
        if self._like_rows:
            kept = (
                "were read as rows whose first field is a name; leave them out with skip_lines= if they are not"
                if self._labels[0]
                else "were omitted as comments; if they were measured, remove the mark"
            )
            found.append(
                f"{len(self._like_rows)} line(s) (first: line {self._like_rows[0]}) begin with the mark of a "
                f"comment and have the fields of a row: they {kept}"
            )
        for kind, what in (
            ("repeated header", "repeats the header within the table"),
            ("footer", "stands below the table and is not a row of it"),
        ):
            if n := self.ledger[kind]:
                line, text = self.ledger.first(kind)
                more = f" (and {n - 1} more)" if n > 1 else ""
                found.append(
                    f"line {line} ({text[:40]!r}){more} {what}; look whether parts of the file belong "
                    "together"
                )
        return tuple(found)

    def take(self, text: str, *, last: bool) -> Iterator[Block]:
        r"""Yield the rows of the whole lines that come next, which end with ``\n``."""
        for part, is_last in _in_parts(text, _MANY * _PART, last=last):
            block = None if self._left else self._quick_block(part)
            if block is not None:
                yield block
                continue
            for piece, is_end in _in_parts(part, _PART, last=is_last):
                small, self._left = self._left + piece, ""
                one = self._quick_block(small) if len(small) < len(part) else None
                block = self._slow_block(small, last=is_end) if one is None else one
                if block.lines.size:
                    yield block

    def _quick_block(self, text: str) -> Block | None:
        """Return the rows of lines that a compiled parser can take, else ``None``."""
        dialect = self._layout.dialect
        n_lines, n_marks = n_in(text, "\n", dialect.separator[0])
        n_lines += not text.endswith("\n")
        if '"' in text and not dialect.quoted and dialect.separator in MARKS.values():
            # quotes that the sample did not show
            self._layout = replace(self._layout, dialect=replace(dialect, quoted=True))
        first = self.line
        columns = self._fast(text, n_lines, n_marks, first)
        if columns is None:
            return None
        self._take_whole(ends_empty=self._unworded is not None and _has_empty(columns[-1]))
        self.line += n_lines
        self.ledger.count("data", n_lines)
        self.last_row = text[text.rfind("\n", 0, len(text) - 1) + 1 :]
        return self._seen(Block(columns, np.arange(first, self.line, dtype=np.int64)))

    def _slow_block(self, text: str, *, last: bool) -> Block:
        first = self.line
        self.line += text.count("\n") + (not text.endswith("\n"))
        block = self._line_by_line(text, first, last=last)
        self.line -= self._left.count("\n")
        return self._seen(block)

    def _seen(self, block: Block) -> Block:
        """Note where the rows end, and make declared markers NaN."""
        if block.lines.size:
            self.last_line = int(block.lines[-1])
        self._open -= {k for k in self._open if np.isfinite(block.columns[k]).any()}
        if self._markers:
            for values in block.columns:
                if isinstance(values, np.ndarray):
                    values[np.isin(values, self._markers)] = np.nan
        return block

    def finish(self) -> None:
        """Close the table: what still waits is a footer or blank; every line must be accounted for."""
        if self._short is not None and self._n_short == 1 and self._has_whole:
            raise self._wrong_count(*self._short, at_end=not any(not e for *_, e in self._pending))
        for number, line, empty in self._pending:
            if empty:
                self.ledger.count("blank", 1)
            else:
                self.ledger.add("footer", number, line)
        self._pending = []
        if self.ledger.total != self.line - 1 or self._left:
            raise self._file.corrupt(
                "the lines do not add up",
                expected=f"{self.line - 1} lines",
                found=f"{self.ledger.to_dict()}",
                hint="report this file: it is an error of metrosep",
            )

    def _fast(
        self, text: str, n_lines: int, n_marks: int, first: int
    ) -> list[FloatArray | Sequence[str]] | None:
        """Return the columns of a block in which every line is a row, else ``None``.

        The separators are counted, so that the compiled parser, which fills a short row in silence and
        refuses a long one, can find neither.
        """
        layout, dialect = self._layout, self._layout.dialect
        mark, options = dialect.separator, self._options
        if (
            not n_lines
            or self._pending
            or all(
                self._labels
            )  # only line by line it shows whether words are a row or below the table
            or mark == ", "
            or options.comment not in (None, NO_COMMENT)
            or (any(self._labels) and may_hold_comments(text, mark))
            or any(r.start < first + n_lines and r.stop > first for r in options.skip_lines)
        ):
            return None
        if '"' in text:
            plain = without_quotes(text, mark, n_lines) if dialect.quoted else None
            if plain is None:
                return None
            text, mark = plain
            (n_marks,) = n_in(text, mark)
        if mark == " " and any(
            self._labels
        ):  # of words the parser would fill a short row with none
            text = single_blanks(text)
            if text.count(" ") != n_lines * (layout.n_raw - 1):
                return None
        if mark != " ":
            if n_marks != n_lines * (layout.n_raw - 1):
                return None
            if surplus := mark * (layout.n_raw - self._n):
                text = text if text.endswith("\n") else text + "\n"
                if text.count(surplus + "\n") != n_lines:
                    return None
                text = text.replace(surplus + "\n", "\n")
        if self._unproven and not (self._prove(text) and not any(self._labels)):
            return None
        n_groups, group = 0, (0, "")
        if not any(self._labels):
            found = self._ungrouped(text, mark)
            if found is None:
                return None
            text, n_groups, group = found
            if dialect.decimal == ",":
                text = text.replace(",", ".")
        decimal = dialect.decimal if any(self._labels) else "."
        columns = self._parsed(text, mark, n_lines, decimal, first)
        if columns is None or (any(self._labels) and mark == ";" and _has_empty(columns[0])):
            return None  # a line that begins with a semicolon may be a comment
        numbers = [c for c in columns if isinstance(c, np.ndarray)]
        if len(columns) != self._n or any(len(c) != n_lines for c in columns):
            return None
        finite = [np.isfinite(c) for c in numbers]
        if not all(f.all() for f in finite):
            whole = np.logical_or.reduce(finite)  # a row without any number is looked at
            if not whole.all() or any(np.isinf(c).any() for c in numbers):
                return None
        if n_groups:
            self._n_groups += n_groups
            self._groups = self._groups or [(first + group[0], group[1])]
        return columns

    def _parsed(
        self,
        text: str,
        mark: str,
        n_lines: int,
        decimal: str,
        first: int,
    ) -> list[FloatArray | Sequence[str]] | None:
        """Return the columns as the compiled parser reads them, words for no reading only once there are any."""
        if self._has_words is None:
            self._has_words = may_hold_words(text, mark) and not any(self._labels)
        if not self._has_words:
            with contextlib.suppress(ValueError):
                columns = columns_of(text, mark, self._labels, frozenset(), n_lines, decimal)
                if not any(np.isinf(c).any() for c in columns if isinstance(c, np.ndarray)):
                    return columns
        words = words_in(text, self._words - _INFINITE)  # 1e999 would be such a word
        if mark == " ":  # in a short row the parser would take what is missing for a word
            text, words = single_blanks(text), {w for w in words if w and " " not in w}
            if text.count(" ") != n_lines * (self._layout.n_raw - 1):
                return None
        try:
            columns = columns_of(text, mark, self._labels, words, n_lines, decimal)
        except ValueError:
            return None
        self._has_words = True
        return columns if self._note_beyond(text, mark, columns, first, words) else None

    def _note_beyond(
        self,
        text: str,
        mark: str,
        columns: list[FloatArray | Sequence[str]],
        first: int,
        words: Set[str],
    ) -> bool:
        """Make the fields NaN that say that the sensor was out of its range, and list them.

        False where a number is beyond all floats.
        """
        declared = self._options.missing or ()
        odd = {
            k: (c, np.flatnonzero(~np.isfinite(c)))
            for k, c in enumerate(columns)
            if isinstance(c, np.ndarray)
        }
        if words.isdisjoint(BEYOND) and not any(np.isinf(c[at]).any() for c, at in odd.values()):
            return True
        raw = text.encode()
        ends = np.flatnonzero(np.frombuffer(raw + b"\n", dtype=np.uint8) == ord("\n"))
        found = []
        for k, (values, at) in odd.items():
            if at.size:
                for i in at.tolist():
                    line = raw[ends[i - 1] + 1 if i else 0 : ends[i]].decode()
                    field = line.split(mark)[k].strip()
                    if field.lower() in BEYOND and field.lower() not in declared:
                        found.append((first + i, field))
                    elif np.isinf(values[i]) and field.lower() not in declared:
                        return False
                columns[k] = np.where(np.isinf(values), np.nan, values)
        self._beyond += sorted(found)
        return True

    def _ungrouped(self, text: str, mark: str) -> tuple[str, int, tuple[int, str]] | None:
        """Return the text without marks of thousands, how many fields had one, and the first of these.

        None where a mark is none of thousands, or where it must be looked at field by field.
        """
        dialect = self._layout.dialect
        n, first = 0, (0, "")
        for own in ("'", dialect.thousands or dialect.other_mark):
            if own == mark or own not in text:
                continue
            found = None if self._unproven else without_groups(text, own, mark, dialect.decimal)
            if found is None:
                return None
            text, n_own, first_own, is_sure = found
            if own == dialect.other_mark and not dialect.thousands:
                if not is_sure:
                    return None
                n, first = n_own, first_own
        return text, n, first

    def _prove(self, text: str) -> bool:
        """Whether the block needs no closer look for what its decimal mark is."""
        mark = self._layout.dialect.decimal
        if mark not in text:
            self._whole = [True] * self._n
            return True
        if DECIMAL_SHOWN[mark].search(text):
            self._unproven = False
            return True
        if self._may_be_comma:
            return _THREE_DIGITS.search(text) is None
        return _IN_DOUBT[mark].search(text) is None

    def _line_by_line(self, text: str, first: int, *, last: bool) -> Block:
        dialect, options = self._layout.dialect, self._options
        every = text.split("\n")
        self._first, self._every = first, every
        if every[-1] == "":
            every.pop()
            last_open = 0
        else:
            last_open = first + len(every) - 1 if last else 0  # a line without its end
        rows: list[list[str]] = []
        numbers: list[int] = []
        blanks = " " if dialect.separator == "\t" else None
        if self._unproven:
            self._prove(text)
        for number, line in self._records(every, first, last=last):
            if options.skip_lines and options.sets_aside(number):
                self.ledger.add("set aside", number, line)
                continue
            if not line.strip(blanks):
                self.ledger.count("blank", 1)
                continue
            if len(line) > LONGEST_FIELD and not is_comment(line, options.comment):
                refuse_long(self._file, number, line)
            if is_rule(line):
                self.ledger.add("rule", number, line)
                continue
            fields = dialect.split([line])[0]
            if is_comment(line, options.comment) and not (
                (line.lstrip().startswith(dialect.separator) and len(fields) >= self._n)
                or (self._is_numbered and is_named_by_number(line))
                or self._is_named_like_comment(number, fields)
            ):
                self.ledger.add("comment", number, line)
                if (rows or self.last_line) and _names_unit(line):
                    self._telling.append((number, line.strip()))
                self.comments.append(line.strip().lstrip('#%!;/" \t').rstrip('"'))
                continue
            if '"' in line:
                refuse_quotes(self._file, number, _REMARK.sub("", line), dialect.separator)
            used = n_used(fields)
            if (remark := _REMARK.search(line)) and used >= self._n:
                fields = self._without_remark(number, line, remark) or fields
                used = n_used(fields)
            if not used:
                self._pending.append((number, line, True))
                continue
            if [f.strip() for f in fields[:used]] in self._header:
                self.ledger.add("repeated header", number, line)
                continue
            if self._is_text(fields):
                self._pending.append((number, line, False))
                continue
            if used > self._n and self._has_remark(number, fields[:used]):
                used = self._n
            if len(fields) >= self._n:
                self._take_whole(ends_empty=not fields[self._n - 1].strip())
            elif self._may_lack(
                number,
                line,
                fields,
                numbers[-1] if numbers else self.last_line,
                is_open=number == last_open,
            ):
                fields = [*fields, *[""] * (self._n - len(fields))]
            if len(fields) < self._n or used > self._n:
                at_end = last and not any(rest.strip() for rest in every[number - first + 1 :])
                raise self._wrong_count(number, line, len(fields), at_end=at_end)
            if self._pending:
                waiting = self._flush()
                rows += [[""] * self._n for _ in waiting]
                numbers += waiting
            if (
                used == n_used(fields)
                and len(fields) > max(self._layout.n_raw, self._n)
                and dialect.separator != " "
            ):
                self._surplus.append(number)
            rows.append(fields[: self._n])
            numbers.append(number)
            self.last_row = line
        if last and self._is_map and all(empty for *_, empty in self._pending):
            waiting = self._flush()  # rows of a map in which nothing was measured
            rows += [[""] * self._n for _ in waiting]
            numbers += waiting
        self.ledger.count("data", len(rows))
        lines = np.array(numbers, dtype=np.int64)
        return Block(self._columns(rows, lines), lines)

    def _records(
        self, every: Sequence[str], first: int, *, last: bool
    ) -> Iterator[tuple[int, str]]:
        """Yield the number of each line and its text; a quoted field over several lines is joined.

        One that may end behind these lines is left for the part that follows.
        """
        if not self._layout.dialect.quoted:
            yield from enumerate(every, first)
            return
        rest = iter(enumerate(every, first))
        for number, line in rest:
            more: list[str] = []
            if line.count('"') % 2:
                own = every[number - first :]
                more = lines_of_field(own, self._may_be_row)
                if not (more or last) and may_go_on(own, self._may_be_row):
                    self._left = "".join(f"{rest_of}\n" for rest_of in own)
                    return
                self.ledger.count("data", len(more))
                for _ in more:
                    next(rest)
            yield number, " ".join([line, *more])

    def _is_named_like_comment(self, number: int, fields: list[str]) -> bool:
        """Whether a line with the mark of a comment is a row: its first field may be a name, such as #1.

        Elsewhere a comment that holds the numbers of a row remains one, and is reported.
        """
        if self._options.comment is not None or not row_in_comment(fields, self._layout):
            return False
        if not self._has_own_runs:
            self._like_rows.append(number)
        return self._labels[0]

    def _take_whole(self, *, ends_empty: bool) -> None:
        """Take a row with all its fields: above it no row may lack numbers, nor, where this one ends empty, its word."""
        if ends_empty and self._unworded is not None:
            raise self._wrong_count(self._lacking[0], *self._unworded, at_end=False)
        self._has_whole = True
        if self._short is not None:
            raise self._wrong_count(*self._short, at_end=False)

    def _may_lack(
        self, number: int, line: str, fields: Sequence[str], before: int, *, is_open: bool
    ) -> bool:
        """Whether a row may lack its last fields: words, or the same numbers in all rows from there on.

        Behind a line that is no row, shorter rows may be another table, such as means; a line without
        its end may be cut. A word in a column that was empty has moved there.
        """
        n = len(fields)
        if any(k < n and fields[k].strip() for k in self._open):
            return False
        named = any(len(fields) >= self._n for fields in self._header)
        if not named or self._layout.dialect.separator in {" ", ", "}:
            return False
        below = self._has_whole and number != before + 1
        if n == self._n - 1 and self._labels[-1]:
            if (below or is_open) and not self._lacking:
                return False
            self._unworded = self._unworded or (line, n)
        else:
            if below:
                return False
            self._short = self._short or (number, line, n)
            self._n_short += 1
            if n != self._short[2]:
                return False
        self._lacking.append(number)
        return True

    def _may_be_row(self, line: str) -> bool:
        fields = [f for f in self._layout.dialect.split([line])[0] if f.strip()]
        return len(fields) >= self._n or any(map(self._layout.dialect.plain, fields))

    def _without_remark(self, number: int, line: str, remark: re.Match[str]) -> list[str] | None:
        """Return the fields before a remark where they are a whole row."""
        fields = self._layout.dialect.split([line[: remark.start()]])[0]
        text = remark.group().strip()
        if n_used(fields) != self._n or self._labels[-1]:
            return None
        if changes_row(text):
            raise self._file.corrupt(
                "the remark behind the row may change what the row says",
                field=f"line {number}",
                found=repr(text[:40]),
                hint=f"leave that line out with {self._file.without_lines(number)}, or correct it and remove the remark",
            )
        self.ledger.note("remark", number, text)
        return fields

    def _has_remark(self, number: int, fields: Sequence[str]) -> bool:
        """Whether nothing but words stand behind a whole row: in a field that other rows do not have.

        A digit, a unit or a word that calls the row bad may change what the row says: no remark. In a
        worksheet numbers behind a word are cells of their own, such as a mean beside the table.
        """
        beside = self._file.table_format == "worksheet"
        row, behind = fields[: self._n], [f.strip().strip('"').strip() for f in fields[self._n :]]
        first = next(f for f in behind if f)
        odd = (
            f.lower() in self._words or changes_row(f)
            for f in behind
            if f and not (beside and NUMBER_LIKE.fullmatch(f))
        )
        if not first[:1].isalpha() or any(odd) or not all(map(self._fits, row, self._labels)):
            return False
        self.ledger.note("remark", number, " ".join(f for f in behind if f))
        return True

    def _fits(self, field: str, label: bool) -> bool:
        """Whether a field is a number or a word for none; any text fits a column of labels."""
        word = field.strip().lower()
        return label or word in self._words or self._layout.dialect.plain(field) is not None

    def _is_text(self, fields: Sequence[str]) -> bool:
        """Whether a line is words, no row: it begins with a letter where a number should stand."""
        begin = fields[0].strip().strip('"')
        ruled = " ".join(f.strip() for f in fields)
        declared = self._options.missing or ()
        if is_drawn(ruled) and not all(f.strip() in declared for f in fields):
            # -----: also a word for no reading
            return len(fields) < self._n or not ruled.strip("=_+| ")
        if not any(self._labels):
            words = " ".join(fields).strip(_RULED + '"').lower().split()
            if words and all(w.isalpha() and w not in self._words for w in words):
                return True
        if _COUNTED.fullmatch(ruled.strip('" ')):
            return True
        if not begin[:1].isalpha() or begin.lower() in self._words:
            return False
        if not self._labels[0] or self._layout.dated[0] or len(fields) < self._n:
            return True
        own = zip(fields, self._labels, strict=False)
        plain = self._layout.dialect.plain
        return not any(
            f.strip().lower() in self._words or plain(f) is not None
            for f, label in own
            if not label
        )

    def _flush(self) -> list[int]:
        """Return the lines of empty rows that waited, now that a row follows; text is refused."""
        for number, line, empty in self._pending:
            if not empty:
                self._refuse_damaged(number, line)
                below = self._every[max(number + 1 - self._first, 0) :]
                raise stray_text(self._file, self._layout, line, number, below)
        waiting = [number for number, *_ in self._pending]
        self._pending = []
        return waiting

    def _refuse_damaged(self, number: int, line: str) -> None:
        """Refuse a row of which only some fields are not numbers by the first of these."""
        fields = [f.strip() for f in self._layout.dialect.split([line])[0]]
        good = [self._layout.dialect.plain(f) is not None for f in fields]
        if len(fields) == self._n and any(good):
            bad = next(f for f, g in zip(fields, good, strict=True) if not g)
            self.words_in = 0 if 0 in self._open else None
            raise bad_field(self._file, number, bad, "a row")

    def _wrong_count(
        self, number: int, line: str, found: int, *, at_end: bool
    ) -> CorruptFileError:
        cut = at_end and found < self._n
        return self._file.corrupt(
            "the file ends in the middle of a row"
            if cut
            else "a row has another number of fields",
            field=f"line {number} ({line.strip()[:60]!r})",
            expected=f"{self._n} fields ({self._layout.dialect})",
            found=f"{found}",
            hint=f"copy the file again, or leave that line out with {self._file.without_lines(number)}",
        )

    def _columns(
        self, rows: list[list[str]], lines: NDArray[np.int64]
    ) -> list[FloatArray | Sequence[str]]:
        if not rows:
            return [[] if label else np.empty(0) for label in self._labels]
        found: list[FloatArray | Sequence[str]] = []
        for k, fields in enumerate(zip(*rows, strict=True)):
            if self._labels[k]:
                found.append([f.strip() for f in fields])
                continue
            found.append(self._floats(fields, lines, k))
            if self._unproven:
                self._look_for_groups(k, fields, lines)
        return found

    def _look_for_groups(self, k: int, fields: Sequence[str], lines: NDArray[np.int64]) -> None:
        """Refuse a column whose numbers may be in groups of thousands, with nothing to show it.

        A writer with fixed decimals marks every number, a shortest-form writer never ends in 0
        behind the mark: neither writes 990 beside 1.000.
        """
        mark = self._layout.dialect.decimal
        texts = [f.strip().lstrip("+-") for f in fields]
        self._whole[k] |= any(t.isdecimal() and len(t) <= 3 for t in texts)
        if self._grouped[k] is None:
            doubt = _THREE_DIGITS if self._may_be_comma else _IN_DOUBT[mark]
            at = next((i for i, t in enumerate(texts) if doubt.fullmatch(t)), None)
            self._grouped[k] = None if at is None else (int(lines[at]), fields[at].strip())
        odd = self._grouped[k]
        if odd is not None and (mark == "," or self._whole[k] or self._may_be_comma):
            raise one_or_thousand(self._file, *odd, self._names[k], mark)

    def _floats(self, fields: Sequence[str], lines: NDArray[np.int64], k: int) -> FloatArray:
        """Return the numbers of a column; the quick way first, then field by field."""
        dialect, name = self._layout.dialect, self._names[k]
        joined = "\n".join(fields)
        if dialect.decimal == "," and "." not in joined:
            joined = joined.replace(",", ".")
        elif dialect.decimal == ",":
            joined = "_"
        # what float() reads and a table may not
        if joined.isascii() and not any(mark in joined for mark in "_nN,"):
            with contextlib.suppress(ValueError):
                quick = np.array(list(map(float, joined.split("\n"))), dtype=np.float64)
                if np.isfinite(quick).all():
                    return quick
        values = np.empty(len(fields))
        for i, field in enumerate(fields):
            plain = dialect.plain(field)
            if plain is not None:
                values[i] = float(plain)
            elif (word := field.strip().lower()) in self._words:
                values[i] = np.nan
                if word in BEYOND and word not in (self._options.missing or ()):
                    self._beyond.append((int(lines[i]), field.strip()))
            elif (grouped := self._grouped_number(field, fields)) is not None:
                values[i] = grouped
                self._n_groups += 1
                if not self._groups or lines[i] < self._groups[0][0]:
                    self._groups = [(int(lines[i]), field.strip())]
            else:
                if k in self._open and not np.isfinite(values[:i]).any():
                    self.words_in = k
                self._refuse_other_mark(int(lines[i]), field.strip(), name)
                raise bad_field(self._file, int(lines[i]), field.strip(), f"column {name!r}")
        if np.isinf(values).any():
            i = int(np.flatnonzero(np.isinf(values))[0])
            raise bad_field(self._file, int(lines[i]), fields[i], f"column {name!r}")
        return values

    def _refuse_other_mark(self, line: int, field: str, name: str) -> None:
        """Refuse a number with the decimal mark that the others of the file do not have, by that cause."""
        dialect = self._layout.dialect
        other = replace(dialect, decimal=dialect.other_mark, thousands="")
        if other.plain(field) is not None:
            raise AmbiguousFormatError(
                f"{self._file.path}: line {line}: column {name!r} holds {field[:40]!r}, whose decimal mark is "
                f"{other.decimal!r}, but others of the file have {dialect.decimal!r}, and a file has one: export "
                "it with one decimal mark"
            )

    def _grouped_number(self, field: str, column: Sequence[str]) -> float | None:
        """Return a number in groups of three digits: their mark can be no decimal mark in this file.

        7,123 among 7.5 and 7.6 may be a slip of the hand, 1,000 among 990 and 995 is none.
        """
        dialect = self._layout.dialect
        if self._unproven or dialect.thousands:
            return None
        other = dialect.other_mark
        plain = replace(dialect, thousands=other).plain(field)
        is_sure = dialect.decimal in field or field.count(other) > 1
        if plain is None or (not is_sure and any(dialect.decimal in f for f in column)):
            return None
        return float(plain)


def _in_parts(text: str, size: int, *, last: bool) -> Iterator[tuple[str, bool]]:
    """Yield whole lines of about so many characters, and whether they are the last of the file."""
    start = 0
    while start < len(text):
        end = text.find("\n", start + size) + 1 or len(text)
        yield text[start:end], last and end == len(text)
        start = end


def _has_empty(column: FloatArray | Sequence[str]) -> bool:
    if isinstance(column, Stamps):
        return False
    return bool(np.isnan(column).any()) if isinstance(column, np.ndarray) else "" in column


def _rows(n: int) -> str:
    return "1 row has" if n == 1 else f"{n} rows have"
