"""The lines above a table: names, units, a count of rows; whatever stands above the names is a preamble."""

from __future__ import annotations

import re
from collections.abc import Sequence

from metrosep.core.errors import AmbiguousFormatError, FormatMismatchError, MetrosepError
from metrosep.core.units import Unit
from metrosep.io.source import RawFile
from metrosep.io.text.dialect import (
    Layout,
    bare_unit,
    encoding_hint,
    fields_in_quotes,
    header_unit,
    is_number,
    is_other_unit,
    n_used,
    split_header,
)
from metrosep.io.text.encoding import NO_READING, ROLE_WORDS
from metrosep.io.text.lines import bad_field, is_drawn

_POSITIONS = frozenset(ROLE_WORDS["position"].split())
"""Names of columns that have a unit, whatever stands above them."""

_MEASURED = _POSITIONS.union(*(ROLE_WORDS[role].split() for role in ("height", "time")))
"""Names of columns of which one that all rows lack need not be the last."""


_OFTEN_WORDS = frozenset(
    [
        "target",
        "error",
        "err",
        "fehler",
        "erreur",
        "errore",
        "sensor",
        "cap",
        "probe",
        "profile",
        "profil",
        "profilo",
        "perfil",
        "профиль",
        "taster",
        "palpeur",
        "palpador",
    ]
)
"""Words for a number under which the name of a thing, or a message, may stand as well."""
_NUMBERS = (
    frozenset(
        w
        for role in ("position", "height", "feed", "angle", "temperature")
        for w in ROLE_WORDS[role].split()
    )
    - _OFTEN_WORDS
)


def names_a_number(name: str) -> bool:
    """Return whether the last word of the name of a column says that numbers belong into it: "x position", no "position remark"."""
    words = re.split(r"[\W_\d]+", header_unit(name)[0].casefold())
    return next((w for w in reversed(words) if w), "") in _NUMBERS


def _ends(line: str) -> list[int]:
    """Return where the words of a line end."""
    return [m.end() for m in re.finditer(r"\S+", line)]


def _is_measured(name: str) -> bool:
    return header_unit(name.strip().strip('"'))[0].strip().casefold() in _MEASURED


_UNIT_WORDS = frozenset(
    [
        "unit",
        "units",
        "einheit",
        "einheiten",
        "unité",
        "unités",
        "unità",
        "unidad",
        "unidades",
        "单位",
        "單位",
        "単位",
    ]
)
"""What stands in front of a row of units."""
_MICRO_ALONE = re.compile(r"(?<!\w)[\u00b5\u03bc][ )\]]*$")
BEGUN = re.compile(r"\s*\"?[+-]?(?:\d+[.,]?\d*|[.,]\d)")
"""How a number begins, whatever follows."""


_SIGNS = re.compile(r"[-+*/=<>^]+")


_QUOTED = re.compile(r'\s*"[^"]*"(?:[,;\t ]\s*"[^"]*")*\s*')
"""Names of which each is in quotes."""
_UNDERLINE = 5
"""Dashes in a row from which a line below the name of a single column is drawn: shorter ones are words."""


_COUNTING = frozenset({"first", "third", "1st", "2nd", "3rd"})
"""Names beside which a column called Second is the second one."""


def _seconds(name: str) -> Unit | None:
    """Return the unit of a column that is called after it, such as Second."""
    if len(name) > len("s") + 1 or not name.isascii():
        own = bare_unit(name)
        return own if own is not None and own.name == "s" else None
    return None


class Preamble:
    """The lines above a table: units, names, a count; text above the names is a preamble."""

    def __init__(self, file: RawFile, layout: Layout, rows: Sequence[str] = ()) -> None:
        self._file = file
        self._dialect = layout.dialect
        self._n, self._most, self._usual = layout.n, layout.n_raw, layout.n_usual
        counted = [
            all(line.lstrip().startswith(mark.format(k)) for k, line in enumerate(rows, start))
            for mark, start in (('"{}"', 1), ("{} ", 0), ("{} ", 1), ("{}\t", 0), ("{}\t", 1))
        ]  # the rows of R and pandas, whose numbers have no name
        self._is_counted = len(rows) > 1 and any(counted)
        self._ends = _ends(rows[0])[1:] if rows else []  # of the fields behind the row number
        self.rows: list[list[str]] = []
        self._names: list[str] | None = None
        self._units: list[Unit | None] | None = None
        self._as_written: list[str] = []  # the row of units
        self._units_at = 0  # its line, 0 for a comment
        self._listed_at: tuple[int, str] | None = None  # units behind a word, above the names
        self._count: int | None = None
        self._named_at = (0, "")
        self._waiting: list[tuple[int, str]] = []
        self.unnamed: tuple[str, ...] = ()
        self._below_text = False  # whether the line above is names, units or other text
        self._drawn: list[tuple[int, str]] = []  # drawn lines that may be rows without a reading
        self._lost: list[int] = []  # rows of names with units above another row of names
        self._damaged: dict[int, MetrosepError] = {}  # lines that may be rows, and what is wrong

    def take(self, line: str, number: int) -> str | None:
        """Return the class of a line; None where it waits to be refused."""
        fields = self._dialect.split([line])[0]
        if is_drawn(" ".join(fields)):
            if n_used(fields) >= self._n and not (self._below_text and self._is_underline(fields)):
                self._drawn.append((number, line.strip()))
            self._below_text = False
            return "rule"
        self._below_text = True
        fields = [f.strip() for f in fields]
        listed = fields[0].rstrip(": ").casefold() in _UNIT_WORDS
        if listed:
            fields[0] = ""
        while len(fields) > self._n and not fields[-1]:
            fields.pop()
        if self._n > 1 and len(fields) == 1 and fields[0].isdecimal():
            self._count = int(fields[0])
            return "count"
        if len(words := line.split()) == self._n != len(fields) and all(map(bare_unit, words)):
            fields = words  # whatever separates the fields of the rows
        units = [bare_unit(f) for f in fields]
        shared = len(fields) == 1 and units[0] is not None
        empty = [not f.strip("[]() ") for f in fields]
        known = all(
            u is not None or e or (any(units) and is_other_unit(f))
            for u, e, f in zip(units, empty, fields, strict=True)
        )
        if (shared or len(fields) == self._n) and known and not all(empty):
            self._take_odd_names(number, empty)
            self._units = units * self._n if shared else units
            self._as_written = fields * self._n if shared else fields
            self._units_at = number
            if listed and self._names is None:
                self._listed_at = (number, line.strip())
            self.rows.append(fields)
            return "units"
        names = self._names_of(line)
        if names is not None and not any(is_number(n, self._dialect.decimal) for n in names):
            if all(BEGUN.match(n) for n in names):
                self._take_damaged(number, line, names)
                return None
            if self._names is not None:
                self._waiting.append(self._named_at)  # the last row of names counts
                if any(header_unit(n)[1] for n in self._names) and not any(
                    map(str.isdigit, self._named_at[1])
                ):
                    self._lost.append(self._named_at[0])
                self.rows.remove(self._names)
            self._names, self._named_at = names, (number, line.strip())
            self.rows.append(names)
            return "names"
        if n_used(fields) == 0:
            return "blank"
        decimal = self._dialect.decimal
        bad = [f for f in fields if not is_number(f, decimal) and f.lower() not in NO_READING]
        begun = BEGUN.match(fields[0]) is not None
        if begun and len(fields) == self._n and 0 < len(bad) < self._n:
            self._take_damaged(number, line, bad)
        elif all(BEGUN.match(f) or f.lower() in NO_READING for f in fields):
            self._take_damaged(number, line, ())
        else:
            self._waiting.append((number, line.strip()))
        return None

    def _take_damaged(self, number: int, line: str, bad: Sequence[str]) -> None:
        """Take a line that begins like a row: next to the rows it is one of them, above names or text it is not."""
        self._waiting.append((number, line.strip()))
        if bad:
            self._damaged[number] = bad_field(self._file, number, bad[0], "one of the columns")
        else:
            self._damaged[number] = self._file.corrupt(
                "a row has another number of fields",
                field=f"line {number} ({line.strip()[:60]!r})",
                expected=f"{self._n} fields ({self._dialect})",
                found=f"{len(self._dialect.split([line])[0])}",
                hint=f"correct that line, or leave it out with {self._file.without_lines(number)}",
            )

    def _is_underline(self, fields: Sequence[str]) -> bool:
        """Whether a drawn line below text cannot be a row in which nothing was measured."""
        texts = [f.strip() for f in fields if f.strip()]
        shortest = min(map(len, texts))
        if self._dialect.separator == "|" or "=" in texts[0]:
            return True  # Markdown has one below its names
        if self._n == 1:
            return shortest >= _UNDERLINE
        if len(set("".join(texts))) == 1 and len(set(texts)) > 1:
            return True  # a word for "not measured" is the same in every column
        names = self._names or []
        return self._dialect.separator == " " and [len(n) for n in names] == [
            len(t) for t in texts
        ]

    def _take_odd_names(self, number: int, is_empty: Sequence[bool]) -> None:
        """Take the line above a row of units as names where some are numbers, or where it is empty like the units."""
        if self._names is not None or not self._waiting or self._waiting[-1][0] != number - 1:
            return
        line = self._waiting[-1][1]
        names = split_header(line, self._dialect.separator, self._n)
        fields = [f.strip().strip('"').strip() for f in self._dialect.split([line])[0]]
        named = [bool(f) or e for f, e in zip(fields, is_empty, strict=False)]
        if names is None and len(is_empty) <= len(fields) <= self._most and all(named):
            self._n = len(fields)
            names = [f or f"column{k}" for k, f in enumerate(fields, 1)]
            self.unnamed = tuple(f"column{k}" for k, f in enumerate(fields, 1) if not f)
        if names is not None and names[0][:1].isalpha():
            self._named_at = self._waiting.pop()
            self._names = names
            self.rows.append(names)

    def _names_of(self, line: str) -> list[str] | None:
        """Return the names in a line; they may tell of columns that the rows leave empty, or of fewer."""
        mark = self._dialect.separator
        n = n_used(self._dialect.split([line])[0])
        named = self._n < n <= self._most or n == self._usual < self._n
        own = self._dialect.split([line])[0]
        lacking = n > self._most and not any(map(_is_measured, own[self._n :]))
        if (
            n == self._n + 1 > self._most and not own[0].strip()
        ):  # as many names as the rows have fields
            if lacking and (mark != "\t" or self._is_counted):
                return None  # a column without a name, and one without values; or names set in
            if mark == "\t":
                line, n, lacking = line.strip(), self._n, False
        if mark == ",":  # which may stand within a name
            lacking &= all(header_unit(f)[1] for f in own[: self._n])
        if mark not in {" ", ", "} and (named or lacking):
            names = split_header(line, mark, n)
            if names is not None and not any(is_number(m, self._dialect.decimal) for m in names):
                self._n = n
                return names
        names = split_header(line, mark, self._n)
        if names is not None and mark == " " and any(map(_SIGNS.fullmatch, names)):
            return None  # a formula: y = a + b
        if names is None and self._is_counted and (mark in " \t" or _QUOTED.fullmatch(line)):
            names = split_header(line, mark, self._n - 1)
            if names is not None and self._is_named_so(line, names):
                self.unnamed = ("column1",)
                return ["column1", *names]
            names = None
        if names is not None or mark in {" ", ", "}:
            return names
        # a column without a name among others: the row numbers of pandas, R and Excel
        fields = [f.strip().strip('"').strip() for f in self._dialect.split([line])[0]]
        n = n if named or lacking else self._n
        few = 2 * sum(map(bool, fields)) < n or len(fields[n:]) != fields[n:].count("")
        if few or len(fields) < n or not any(header_unit(f)[1] for f in fields if f):
            return None
        self._n, fields = n, fields[:n]
        self.unnamed = tuple(f"column{k}" for k, f in enumerate(fields, 1) if not f)
        return [f or f"column{k}" for k, f in enumerate(fields, 1)]

    def _is_named_so(self, line: str, names: Sequence[str]) -> bool:
        """Whether a line names all columns but the row number, and is no title: quotes, most units, or columns that end with their names."""
        units = sum(header_unit(name)[1] is not None for name in names)
        aligned = "\t" not in line and set(self._ends) <= set(_ends(line))
        return bool(_QUOTED.fullmatch(line)) or 2 * units > len(names) or aligned

    @property
    def named(self) -> bool:
        """Whether a row or a comment names the columns."""
        return self._names is not None

    def rest(self, first_row: int) -> list[int]:
        """Return the numbers of the lines above the row of names; one between the names and the numbers is refused.

        Without names the line next to the numbers may be what remains of them.
        """
        text = [n for n, _ in self._waiting if n not in self._damaged]
        above = max([self._named_at[0], *text])
        for number, damage in self._damaged.items():
            if number > above:
                raise damage
        drawn = [(n, line) for n, line in self._drawn if n > self._named_at[0]]
        if drawn:
            first, line = drawn[0]
            word = (
                line.split()[0]
                if self._dialect.separator == " "
                else fields_in_quotes(line, self._dialect.separator[0])[0].strip()
            )
            raise AmbiguousFormatError(
                f"{self._file.path}: line {first} ({line[:40]!r}) is a drawn line, or a row in which nothing was "
                f"measured; if it is a row, give missing={word!r}, else leave it out with "
                f"{self._file.without_lines(*(n for n, _ in drawn))}"
            )
        odd = [
            (n, line)
            for n, line in self._waiting
            if not line.lstrip('" [')[:1].isalpha() or n > self._named_at[0] > 0 or n in self._lost
        ]
        if not odd and self._names is None and self._waiting:
            nearest = max(self._waiting)
            odd = [nearest] if len(self._dialect.split([nearest[1]])[0]) > 1 else []
        if odd:
            first, line = min(odd)
            n_names = len([f for f in line.split(",") if f.strip()])
            if self._dialect.separator == "," and self._n == 2 * n_names > 2:
                raise AmbiguousFormatError(
                    f"{self._file.path}: line {first} ({line[:40]!r}) has {n_names} names, and the rows have {self._n} "
                    "fields: the comma seems to separate the columns and to be their decimal mark too, which cannot "
                    "be distinguished; export it with ';' between the columns, or with a decimal point"
                )
            out = f"leave it out with {self._file.without_lines(*(n for n, _ in odd))}, or start it with '#'"
            at, names = self._named_at
            if sum(n > at for n, _ in odd) > 1:  # the names may be those of another table
                out = (
                    f"leave out all that stands above the rows with skip_rows='{first_row - 1}'"
                    + (
                        f", or, if line {at} ({names[:40]!r}) names the columns, the other lines with "
                        f"{self._file.without_lines(*(n for n, _ in odd))}"
                    )
                    * (at > 0)
                )
            raise FormatMismatchError(
                f"{self._file.path}: line {first} ({line[:40]!r}) is neither a row of {self._n} names, "
                f"nor of units, nor of numbers; {out}"
            )
        return [n for n, _ in self._waiting]

    def take_comment(self, comments: Sequence[str], named: int) -> None:
        """Take the names in the last comment; one whose mark is the first name (#) also below a title like names."""
        above = self._names is not None and named <= self._named_at[0]
        if above or not comments or ":" in comments[-1]:
            return
        below = [bare_unit(f) for f in self._dialect.split([comments[-1].strip()])[0]]
        if len(below) == self._n > 1 and len(comments) > 1 and all(below) and not self._units:
            self._units, comments = list(below), comments[:-1]
        names = self._names_of(comments[-1])
        if names is None or any(is_number(n, self._dialect.decimal) for n in names):
            return
        if self._n > 1 or header_unit(names[0])[1] is not None:
            if self._names is not None:
                self._waiting.append(self._named_at)
            self._names = names

    def columns(self) -> tuple[tuple[str, ...], tuple[Unit | None, ...]]:
        raw = self._names or [f"column{i + 1}" for i in range(self._n)]
        names: list[str] = []
        known: dict[str, int] = {}  # how often each name was met
        for name in raw:
            unique = name
            while unique in known:
                known[name] += 1
                unique = f"{name} ({known[name]})"
            known[unique] = known.get(unique, 1)
            names.append(unique)
        for i, text in enumerate(self._as_written):
            if is_other_unit(text) and any(map(str.isalpha, text)):
                names[i] = f"{names[i]} [{text.strip('[]()<> ')}]"
        units: list[Unit | None] = [header_unit(n)[1] if self.named else None for n in raw]
        for name, unit in zip(raw, units, strict=True):
            inner = header_unit(name)[0].strip()
            other = header_unit(inner)[1] if inner.endswith((")", "]")) else None
            if unit is not None and other is not None and other != unit:
                raise FormatMismatchError(
                    f"{self._file.path}: column {name!r} names two units, {other.name} and {unit.name}; correct the "
                    "header"
                )
        if self._listed_at is not None and self._is_list(raw, units):
            return tuple(names), tuple(units)
        for i, unit in enumerate(self._units or []):
            own = units[i]
            if own is not None and unit is not None and own != unit:
                raise FormatMismatchError(
                    f"{self._file.path}: column {names[i]!r} is in {own.name} by its name, but in "
                    f"{unit.name} by the row of units; correct the header{self._or_without_units()}"
                )
            units[i] = own or unit
        if self.named and not _COUNTING.intersection(n.strip().lower() for n in raw):
            units = [u or _seconds(n) for n, u in zip(raw, units, strict=True)]
        return tuple(names), tuple(units)

    def _or_without_units(self) -> str:
        """Return the option that leaves out a row of units that may be a title, such as nm um."""
        out = self._file.without_lines(self._units_at)
        return f", or leave out line {self._units_at} with {out} if it is a title" * (
            self._units_at > 0
        )

    def _is_list(self, names: Sequence[str], units: Sequence[Unit | None]) -> bool:
        """Return whether the units above the names are a list that agrees with theirs, not one for each column.

        The word in front takes the place of the first column: where that has a unit, or is a length by
        its name, the others are not those below which they stand.
        """
        number, line = self._listed_at or (0, "")
        first = header_unit(names[0])[0].strip(" _-.[](){}<>/").casefold()
        if units[0] is None and first not in _POSITIONS:
            return False
        told = {u for u in self._units or () if u is not None}
        if told == {u for u in units if u is not None}:
            return True
        said = ", ".join(
            f"{n!r} in {u.name}" if u is not None else f"{n!r} without a unit"
            for n, u in zip(names, units, strict=True)
        )
        raise FormatMismatchError(
            f"{self._file.path}: line {number} ({line[:40]!r}) lists {', '.join(sorted(u.name for u in told))}, and "
            f"the columns are {said}; leave that line out with {self._file.without_lines(number)}, or correct the header"
        )

    def warnings(self, n_rows: int) -> tuple[str, ...]:
        """Return what is unusual about the lines above a table of so many rows."""
        found = []
        if self._count is not None and self._count != n_rows:
            found.append(f"the file declares {self._count} rows and holds {n_rows}")
        raw = self._names or []
        for name in dict.fromkeys(n for n in raw if raw.count(n) > 1):
            own = [c for r, c in zip(raw, self.columns()[0], strict=True) if r == name]
            found.append(
                f"{len(own)} columns have the name {name!r}; from the left they are {', '.join(map(repr, own))}"
            )
        if odd := encoding_hint(self.columns()[0]):
            found.append(odd)
        names, units = self.columns()
        written = [*self._as_written, *[""] * len(names)][: len(names)]
        for name, below, unit in zip(names, written, units, strict=True):
            capital = "" if unit is None else unit.name.upper()
            text = name if header_unit(name)[1] is not None else below
            words = re.split(r"[^\w/]|_", text)
            if unit is not None and unit.name not in words and unit.name != capital in words:
                found.append(f"column {name!r}: {capital} was read as {unit.name}")
            if unit is not None and _MICRO_ALONE.search(text):
                found.append(
                    f"column {name!r}: the sign {text.rstrip(' )]')[-1]} alone was read as {unit.name}"
                )
        return tuple(found)
