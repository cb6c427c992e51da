"""A text file as columns of numbers and labels, with the units that it declares.

Numbers stay as they stand in the file; `Column.values` and the unit give SI where a reader asks
for it. Counts of fields are checked on every line, so that a file cut in the middle of a row or a
row with a field too many is named by its line instead of being filled or shifted.
"""

from __future__ import annotations

import contextlib
import csv
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, FormatMismatchError
from metrosep.core.units import Unit
from metrosep.io.dialect import (
    MISSING,
    Dialect,
    body_start,
    decode,
    detect,
    is_comment,
    is_number,
)
from metrosep.io.headers import bare_unit, header_unit, split_header
from metrosep.io.source import RawFile

__all__ = ["Column", "Table", "read_table", "rows_as_columns"]

_CHUNK = 50_000
_DIGITS = frozenset("0123456789+-.")


@dataclass(frozen=True, slots=True, eq=False)
class Column:
    """One column of a table.

    Parameters
    ----------
    name : str
        As in the header, or ``column1`` where there is none.
    unit : Unit or None
        What the file declares.
    values : ndarray, shape (n,), or None
        Numbers in the unit of the file, NaN = not measured; ``None`` for a column of labels.
    labels : tuple of str or None
        Texts of a column of labels.
    """

    name: str
    unit: Unit | None
    values: FloatArray | None
    labels: tuple[str, ...] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Columns of a text file.

    Parameters
    ----------
    columns : tuple of Column
        In the order of the file.
    lines : ndarray of int, shape (n,)
        Line of each row in the file, from 1.
    header : mapping
        Encoding, separator, decimal mark, comments and the lines above the table.
    warnings : tuple of str
        What is odd.
    """

    columns: tuple[Column, ...]
    lines: NDArray[np.int64]
    header: Mapping[str, Any]
    warnings: tuple[str, ...] = ()

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


def read_table(
    file: RawFile,
    *,
    separator: str | None = None,
    decimal: str | None = None,
    encoding: str | None = None,
    comment: str | None = None,
    skip_rows: int = 0,
) -> Table:
    """Return the columns of a text file.

    Parameters
    ----------
    file : RawFile
        The file.
    separator, decimal : str, optional
        Dialect; found from the content if omitted.
    encoding : str, optional
        Text encoding; found from the content if omitted.
    comment : str, optional
        Start of comment lines.
    skip_rows : int, optional
        Lines to leave out at the start.

    Returns
    -------
    Table
        Columns of numbers and labels.

    Raises
    ------
    ReadError
        If the file is not text, its dialect is ambiguous, or a line does not fit.
    """
    text, encoding = decode(file.data, file.path, encoding)
    comments: list[str] = []
    lines: list[str] = []
    numbers: list[int] = []
    for number, line in enumerate(text.split("\n"), start=1):
        if line[:1] in _DIGITS and comment is None and number > skip_rows and '"' not in line:
            lines.append(line)  # the common row, quickly
            numbers.append(number)
            continue
        if number <= skip_rows or not line.strip():
            continue
        if is_comment(line, comment):
            comments.append(line.strip().lstrip('#%!;/" \t').rstrip('"'))
            continue
        if line.count('"') % 2:
            raise CorruptFileError(
                file.path,
                "the quotes do not pair up",
                field=f"line {number}",
                found=repr(line[:40]),
            )
        lines.append(line)
        numbers.append(number)
    try:
        return _table(file, lines, numbers, comments, encoding, separator, decimal)
    except csv.Error as exc:
        raise CorruptFileError(file.path, f"the quotes do not pair up ({exc})") from None


def rows_as_columns(
    file: RawFile, table: Table, text: bytes, first_line: int, *, comment: str | None = None
) -> FloatArray:
    """Return further rows of a table whose head is known.

    Parameters
    ----------
    file : RawFile
        For the message.
    table : Table
        The head: dialect, names and number of fields.
    text : bytes
        Whole lines that follow it somewhere in the file.
    first_line : int
        Line of the first one in the file, from 1.
    comment : str, optional
        Start of comment lines.

    Returns
    -------
    ndarray, shape (n, n_columns)
        Numbers in the unit of the file, NaN = not measured.

    Raises
    ------
    CorruptFileError
        If a row does not fit; the message names its line.
    """
    header = table.header
    dialect = Dialect(header["separator"], header["decimal"], header["quoted"])
    try:
        decoded = text.decode(header["encoding"])
    except UnicodeDecodeError as exc:
        line = first_line + text[: exc.start].count(b"\n")
        raise CorruptFileError(
            file.path, f"is not {header['encoding']} text", field=f"line {line}"
        ) from None
    kept = [
        (number, line)
        for number, line in enumerate(decoded.split("\n"), start=first_line)
        if line.strip() and not is_comment(line, comment)
    ]
    cells = _Cells(
        file, dialect, [line for _, line in kept], [n for n, _ in kept], header["n_fields"]
    )
    return cells.numbers(table.names)


def _table(
    file: RawFile,
    lines: list[str],
    numbers: list[int],
    comments: list[str],
    encoding: str,
    separator: str | None,
    decimal: str | None,
) -> Table:
    dialect = detect(lines, file.path, separator=separator, decimal=decimal)
    start = body_start(lines, dialect)
    cells = _Cells(file, dialect, lines[start:], numbers[start:])
    cells.drop_trailing(lines[:start])
    preamble = _Preamble(file, dialect, cells.n_columns)
    for line, number in zip(lines[:start], numbers[:start], strict=True):
        preamble.take(line, number)
    preamble.refuse_rest()
    preamble.take_comment(comments)
    names, units = preamble.columns()
    columns, kept = cells.columns(names, units)
    warnings = preamble.warnings(len(kept))
    header = {
        "encoding": encoding,
        "separator": dialect.separator,
        "decimal": dialect.decimal,
        "quoted": dialect.quoted,
        "n_fields": cells.n_fields,
        "columns": names,
        "named": preamble.named,
        "comments": tuple(comments),
        "preamble": tuple(lines[:start]),
    }
    return Table(columns, np.asarray(kept, dtype=np.int64), header, warnings)


class _Preamble:
    """The lines above a table: names, units, a count; anything else is refused."""

    def __init__(self, file: RawFile, dialect: Dialect, n_columns: int) -> None:
        self._file = file
        self._dialect = dialect
        self._n = n_columns
        self._names: list[str] | None = None
        self._units: list[Unit | None] | None = None
        self._count: int | None = None
        self._named_at = (0, "")
        self._refused: list[tuple[int, str]] = []

    def take(self, line: str, number: int) -> None:
        fields = [f.strip() for f in self._dialect.split([line])[0]]
        while len(fields) > self._n and not fields[-1]:
            fields.pop()
        if self._n > 1 and len(fields) == 1 and fields[0].isdecimal():
            self._count = int(fields[0])
            return
        units = [bare_unit(f) for f in fields]
        shared = len(fields) == 1 and units[0] is not None
        empty = [not f.strip("[]() ") for f in fields]
        known = all(u is not None or e for u, e in zip(units, empty, strict=True))
        if (shared or len(fields) == self._n) and known and not all(empty):
            self._units = units * self._n if shared else units
            return
        names = split_header(line, self._dialect.separator, self._n)
        if names is not None and not any(is_number(n, self._dialect.decimal) for n in names):
            if self._names is not None:
                self._refused.append(self._named_at)  # the last row of names counts
            self._names, self._named_at = names, (number, line.strip())
            return
        decimal = self._dialect.decimal
        bad = [f for f in fields if not is_number(f, decimal) and f.lower() not in MISSING]
        if len(fields) == self._n and len(bad) < self._n:
            if bad:
                raise _bad_field(self._file, number, bad[0], "one of the columns")
            return  # a good row above a damaged one, which is named when its turn comes
        self._refused.append((number, line.strip()))

    @property
    def named(self) -> bool:
        """Whether a row or a comment names the columns."""
        return self._names is not None

    def refuse_rest(self) -> None:
        """Refuse the lines that are neither names nor units."""
        if self._refused:
            (first, line), (last, _) = min(self._refused), max(self._refused)
            raise FormatMismatchError(
                f"{self._file.path}: line {first} ({line[:40]!r}) is neither a row of {self._n} names, "
                f"nor of units, nor of numbers; leave it out with skip_rows={last}, or start it with '#'"
            )

    def take_comment(self, comments: Sequence[str]) -> None:
        if self._names is not None or not comments or ":" in comments[-1]:
            return
        names = split_header(comments[-1], self._dialect.separator, self._n)
        if names is None or any(is_number(n, self._dialect.decimal) for n in names):
            return
        if self._n > 1 or header_unit(names[0])[1] is not None:
            self._names = names

    def columns(self) -> tuple[tuple[str, ...], tuple[Unit | None, ...]]:
        raw = self._names or [f"column{i + 1}" for i in range(self._n)]
        names: list[str] = []
        for name in raw:
            unique, count = name, 1
            while unique in names:
                count += 1
                unique = f"{name} ({count})"
            names.append(unique)
        units = [header_unit(n)[1] for n in raw]
        for i, unit in enumerate(self._units or []):
            own = units[i]
            if own is not None and unit is not None and own != unit:
                raise FormatMismatchError(
                    f"{self._file.path}: column {names[i]!r} is in {own.name} by its name, but in "
                    f"{unit.name} by the row of units; correct the header"
                )
            units[i] = own or unit
        return tuple(names), tuple(units)

    def warnings(self, n_rows: int) -> tuple[str, ...]:
        if self._count is not None and self._count != n_rows:
            return (f"the file declares {self._count} rows and holds {n_rows}",)
        return ()


class _Cells:
    """The rows of a table, checked for the same number of fields."""

    def __init__(
        self,
        file: RawFile,
        dialect: Dialect,
        lines: list[str],
        numbers: list[int],
        n_fields: int | None = None,
    ) -> None:
        self._file = file
        self._dialect = dialect
        self._lines = lines
        self._numbers = numbers
        self.n_fields = n_fields or len(dialect.split(lines[:1])[0])
        self.n_columns = self.n_fields

    def drop_trailing(self, preamble: list[str]) -> None:
        """Leave out last columns without a name that are empty everywhere (trailing separators)."""
        if self._dialect.separator == " ":
            return
        mark = self._dialect.separator.strip(" ")
        ends = [line.replace(" ", "") for line in self._lines]
        n_empty = min(len(e) - len(e.rstrip(mark)) for e in ends)
        named = [
            max((i + 1 for i, f in enumerate(fields) if f.strip()), default=0)
            for fields in self._dialect.split(preamble)
            if len(fields) <= self.n_fields
        ]
        self.n_columns = max(self.n_fields - n_empty, 1, *named)

    def columns(
        self, names: tuple[str, ...], units: tuple[Unit | None, ...]
    ) -> tuple[tuple[Column, ...], list[int]]:
        parts: list[list[Any]] = [[] for _ in names]
        is_label = self._label_columns()
        for start, rows in self._rows():
            for k, fields in enumerate(zip(*rows, strict=True)):
                if k >= self.n_columns:
                    continue
                if is_label[k]:
                    parts[k].extend(f.strip() for f in fields)
                else:
                    parts[k].append(self._floats(fields, start, names[k]))
        columns = [
            Column(name, unit, None, tuple(part))
            if label
            else Column(name, unit, np.concatenate(part))
            for name, unit, part, label in zip(names, units, parts, is_label, strict=True)
        ]
        return tuple(columns), self._numbers

    def numbers(self, names: tuple[str, ...]) -> FloatArray:
        """Return rows of which every field is a number or empty, shape (n, n_columns)."""
        parts = [
            np.column_stack(
                [
                    self._floats(fields, start, name)
                    for name, fields in zip(names, zip(*rows, strict=True), strict=False)
                ]
            )
            for start, rows in self._rows()
        ]
        return np.concatenate(parts) if parts else np.empty((0, len(names)))

    def _rows(self) -> Iterator[tuple[int, list[list[str]]]]:
        """Yield the rows in blocks with the index of the first; a short or long row is refused."""
        for start in range(0, len(self._lines), _CHUNK):
            rows = self._dialect.split(self._lines[start : start + _CHUNK])
            for i, row in enumerate(rows):
                if len(row) != self.n_fields:
                    raise self._wrong_count(start + i, len(row))
            yield start, rows

    def _label_columns(self) -> list[bool]:
        sample = self._dialect.split(self._lines[:300])
        found = []
        for k in range(self.n_columns):
            fields = [row[k].strip() for row in sample if len(row) > k]
            words = [
                f
                for f in fields
                if f.lower() not in MISSING and not is_number(f, self._dialect.decimal)
            ]
            found.append(bool(words))
        return found

    def _wrong_count(self, index: int, found: int) -> CorruptFileError:
        is_last = index == len(self._lines) - 1
        return CorruptFileError(
            self._file.path,
            "the file ends in the middle of a row"
            if is_last and found < self.n_fields
            else "a row has another number of fields",
            field=f"line {self._numbers[index]}",
            expected=f"{self.n_fields} fields ({self._dialect})",
            found=f"{found}",
            hint="copy the file again, or remove that line",
        )

    def _floats(self, fields: Sequence[str], start: int, name: str) -> FloatArray:
        """Return the numbers of a column; the quick way first, then field by field."""
        decimal = self._dialect.decimal
        joined = "\n".join(fields)
        if decimal == "," and "." not in joined:
            joined = joined.replace(",", ".")
        if not any(mark in joined for mark in "_nN,"):  # what float() reads and a table may not
            with contextlib.suppress(ValueError):
                quick = np.array(list(map(float, joined.split("\n"))), dtype=np.float64)
                if np.isfinite(quick).all():
                    return quick
        values = np.empty(len(fields))
        for i, field in enumerate(fields):
            text = field.strip()
            if is_number(text, decimal):
                values[i] = float(text.replace(",", ".").replace("d", "e").replace("D", "e"))
            elif text.lower() in MISSING:
                values[i] = np.nan
            else:
                raise _bad_field(self._file, self._numbers[start + i], text, f"column {name!r}")
        if np.isinf(values).any():
            i = int(np.flatnonzero(np.isinf(values))[0])
            raise _bad_field(self._file, self._numbers[start + i], fields[i], f"column {name!r}")
        return values


def _bad_field(file: RawFile, line: int, field: str, where: str) -> CorruptFileError:
    return CorruptFileError(
        file.path,
        f"{where} holds something that is no number",
        field=f"line {line}",
        expected="a number, or an empty field where nothing was measured",
        found=repr(field[:40]),
        hint="correct that line, or export the file again",
    )
