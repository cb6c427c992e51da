"""How a table of numbers is written as text: encoding, separator, decimal mark, comments.

Which dialect a text is in is found by `metrosep.io.text.dialect`.
"""

from __future__ import annotations

import csv
import re
import unicodedata
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Final, NamedTuple

from metrosep.core.errors import (
    AmbiguousFormatError,
    CorruptFileError,
    FormatMismatchError,
    ReadError,
    ReadNameError,
    UnitError,
)
from metrosep.core.readable import nearest
from metrosep.core.text_options import TextOptions
from metrosep.core.units import Unit, column_unit, parse_unit
from metrosep.io.text.encoding import NO_READING, ROLE_WORDS, Role, is_error_cell
from metrosep.io.text.times import is_moment

if TYPE_CHECKING:
    from metrosep.io.source import RawFile

_NO_DATA = re.compile(r"(?<!\S)no data(?!\S)", re.IGNORECASE)
"""One field, of two words, also where blanks separate the fields."""

_NUMBER = {
    ".": re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d+)?"),
    ",": re.compile(r"[+-]?(?:\d+(?:,\d+)?|,\d+)(?:[eEdD][+-]?\d+)?"),
}
NUMBER_LIKE = re.compile(
    r"[+\-\u2212\u2010-\u2013\ufe63\uff0d]?[\d.,][\d.,'\u2019 \u00a0\u2009\u202f;\t]*(?:[eE][+-]?\d+)?"
)
_SPACED_GROUPS = {
    mark: re.compile(
        rf"[+-]?[1-9]\d{{0,2}}([ '\u2019])\d{{3}}(?:\1\d{{3}})*(?:{re.escape(mark)}\d*)?"
    )
    for mark in ".,"
}
"""Groups of three digits between blanks or apostrophes, which are nothing else: 1 234.5."""
_MINUS = dict.fromkeys(map(ord, "\u2212\u2010\u2011\u2012\u2013\ufe63\uff0d"), "-")
MARKS = {
    "tab": "\t", "space": " ", "whitespace": " ", "comma": ",", "semicolon": ";", "pipe": "|"
}  # fmt: skip
WORDS = {mark: name for name, mark in MARKS.items()} | {" ": "space", ", ": "comma and space"}


@dataclass(frozen=True, slots=True)
class Dialect:
    """Separator and decimal mark of a table."""

    # tab, ``";"``, ``","``, ``", "`` (a comma followed by space, where the decimal mark is a comma
    # too) or ``" "`` for any white space
    separator: str
    decimal: str  # {".", ","}: decimal mark
    quoted: bool = False  # whether fields may stand in double quotes
    thousands: str = ""  # mark between groups of three digits: declared, or shown by the file

    @property
    def other_mark(self) -> str:
        """The comma where the point is the decimal mark, and the point where the comma is."""
        return "." if self.decimal == "," else ","

    def split(self, lines: Iterable[str]) -> list[list[str]]:
        """Return the fields of each line."""
        if self.separator == " " and self.quoted:
            return [_blank_separated(line) for line in lines]
        if self.separator == " ":
            return [_NO_DATA.sub("nodata", line).split() for line in lines]
        if self.separator == ", ":
            return [re.split(r",\s+", line.strip()) for line in lines]
        if self.quoted:
            # line by line: an odd quote must not swallow the lines after it
            return [
                fields_in_quotes(line, self.separator) or [""]
                if '"' in line
                else line.split(self.separator)
                for line in lines
            ]
        return [line.split(self.separator) for line in lines]

    def plain(self, field: str) -> str | None:
        """Return a number as `float` reads it."""
        text = field.strip()
        if not text.isascii():
            text = unicodedata.normalize("NFKC", text.translate(_MINUS)).translate(_MINUS)
        number, mark = _NUMBER[self.decimal], self.thousands
        if (mark and mark in text) or number.fullmatch(text) is None:
            if _SPACED_GROUPS[self.decimal].fullmatch(text):
                text = re.sub(r"[ '\u2019]", "", text)
            if mark and mark in text:
                if _grouped(mark, self.decimal).fullmatch(text) is None:
                    return None
                text = text.replace(mark, "")
            if number.fullmatch(text) is None:
                return None
        return text.replace(",", ".").replace("d", "e").replace("D", "e")

    def __str__(self) -> str:
        mark = "point" if self.decimal == "." else "comma"
        return f"separator {WORDS[self.separator]}, decimal {mark}"


@lru_cache
def _grouped(mark: str, decimal: str) -> re.Pattern[str]:
    """Return what numbers with groups of three digits look like."""
    return re.compile(
        rf"[+-]?[1-9]\d{{0,2}}(?:{re.escape(mark)}\d{{3}})+(?:{re.escape(decimal)}\d*)?"
    )


LONGEST_FIELD: Final = 131_072
"""Characters of the longest field that a table may hold; csv reads no longer one either."""


def fields_in_quotes(line: str, mark: str) -> list[str]:
    """Return the fields of one line, whose quotes are dropped; whoever numbers lines refuses too long ones."""
    try:
        return next(csv.reader([line], delimiter=mark, skipinitialspace=True), [])
    except csv.Error:
        return line.split(mark)


def refuse_long(file: RawFile, number: int, line: str) -> None:
    """Refuse a line with a field or a remark that is too long, or too many fields, for a table."""
    if len(line) <= _MOST_COLUMNS:
        return
    remarks = re.findall(r"\s#\s*([^\W\d].*)", line)
    fields = [*re.findall(r'"([^"]*)', line), *re.split(r'[,;\t| "]+', line), *remarks]
    longest = max(map(len, fields))
    most = max(map(line.count, ",;\t| ")) + 1
    if longest > LONGEST_FIELD:
        what = f"a field or a remark of {longest} characters, more than the {LONGEST_FIELD} that a table may hold"
    elif most > _MOST_COLUMNS + 1:
        what = f"{most} fields, more than {_MOST_COLUMNS}: not a table of columns"
    else:
        return
    raise FormatMismatchError(
        f"{file.path}: line {number} has {len(line)} characters with {what}; shorten it, or leave it out with "
        f"{file.without_lines(number)}"
    )


NO_COMMENT: Final = "\0"
"""Prefix of comments of a text that has none: no line begins with it."""


def is_comment(line: str, prefix: str | None = None) -> bool:
    """Return whether a line is a comment."""
    text = line.lstrip()
    if text.startswith('""'):
        return False  # an empty cell
    text = text.lstrip('"')
    if prefix is not None:
        return text.startswith(prefix)
    if text.startswith(("#", "%", "!", "//")):
        return not is_error_cell(text)  # else a row whose first cell has no value
    if not text.startswith(";") or re.match(r";[^;\s]+[^;]*;", text):
        return False  # names or values behind an empty field
    rest = text.lstrip("; \t")
    return bool(rest) and not NUMBER_LIKE.match(rest)


def is_number(field: str, decimal: str) -> bool:
    """Return whether a field is one number."""
    return _NUMBER[decimal].fullmatch(field.strip()) is not None


def _blank_separated(line: str) -> list[str]:
    """Return what stands between blanks, or in quotes."""
    return [plain or quoted for quoted, plain in re.findall(r'"([^"]*)"(?=\s|$)|(\S+)', line)]


def n_used(fields: Sequence[str]) -> int:
    """Return how many fields there are up to the last that is not empty."""
    n = len(fields)
    while n and not fields[n - 1].strip():
        n -= 1
    return n


# ---- names and units of columns, as people and loggers write them above a table ----------------

_IN = re.compile(r"^(.+?)\s+in\s+(\S+)$")
_SLASH = re.compile(r"^(.+?)\s*/\s*(\S+)$")
_COMMA = re.compile(r"^(.+?),\s*(\S+)$")
"""Where the comma separates the columns it stands in no name."""
_FULL_WIDTH = {0xFF01 + k: 0x21 + k for k in range(94)} | {0x3000: " "}
_SPACED = re.compile(
    r"^(.+?)\s+(pm|nm|um|\u00b5m|\u03bcm|mm|cm|urad|mrad|arcsec|deg|ms|us|mV|mm/min|m/min|mm/s|m/s)$"
)
_SPEED = re.compile(r"^([^/]+?)[\s_]+(?:/\s*)?(\S+/(?:min|s|h))$")
"""Before what follows a slash: ``feed mm/min`` is no time."""
_OTHER_BRACKETS = re.compile(r"[{<]\s*([^{}<>]+?)\s*[}>]$")
_BRACKETS = re.compile(r"^[\[(<]\s*(.*?)\s*[\])>]$")


def bare_unit(field: str) -> Unit | None:
    """Return the unit that a field names and nothing else, such as ``"[um]"``."""
    text = field.translate(_FULL_WIDTH).strip().strip('"').strip()
    match = _BRACKETS.match(text)
    try:
        return parse_unit(match.group(1) if match else text)
    except UnitError:
        return None


_OTHER_UNITS = frozenset((
    "N", "mN", "kN", "g", "kg", "K", "C", "degC", "degF", "°C", "℃", "°F", "A", "mA", "uA",
    "µA", "W", "kW", "bar", "mbar", "Pa", "hPa", "kPa", "MPa", "%", "%RH", "ppm", "dB", "J",
    "Ohm", "Ω", "kg/m3", "N/mm2", "counts", "cts", "inc", "digit", "digits", "-", "n/a", "1",
))  # fmt: skip
"""Other units, and marks for none, that stand in a row of units: such a column keeps its numbers."""


def is_other_unit(field: str) -> bool:
    """Return whether a field of a row of units names a unit that no role of a column needs."""
    text = field.strip().strip('"').strip()
    match = _BRACKETS.match(text)
    return (match.group(1) if match else text) in _OTHER_UNITS


_COUNTS = re.compile(
    r"(?:^|(?-i:(?<=[a-z])(?=[A-Z]))|[\W\d_])(?:counts?|cts|incs?|inkr|increments?|inkremente?|pulses?|"
    r"impulse?|ticks?|digits?|lsbs?)\d*[\s.\])>}]*$",
    re.IGNORECASE,
)


def holds_counts(name: str) -> bool:
    """Return whether the name of a column without a unit says that it holds counts: z_counts, zCounts, z (LSB)."""
    return _COUNTS.search(name) is not None


def header_unit(header: str) -> tuple[str, Unit | None]:
    """Return the bare name of a column and the unit that its header declares.

    Examples
    --------
    >>> header_unit("s / mm")[0], header_unit("s / mm")[1].name
    ('s', 'mm')
    """
    text = _OTHER_BRACKETS.sub(r"[\1]", header.translate(_FULL_WIDTH).strip())
    name, unit = column_unit(text)
    if unit is not None:
        return (text, None) if _is_of_another(name, unit) else (name, unit)
    if bare_unit(text) is not None:
        return text, None
    for pattern in (_IN, _SPEED, _SLASH, _COMMA, _SPACED):
        match = pattern.match(text)
        if match is not None:
            unit = bare_unit(match.group(2))
            if unit is not None and unit.dimension != "number":
                return match.group(1).strip(" _"), unit
    return text, None


_MEANT: Final[dict[str, Role]] = {"angle": "temperature", "time": "angle"}
"""Words for degrees and seconds stand for two units each: beside a name of this role they mean the other."""


def _is_of_another(name: str, unit: Unit) -> bool:
    """Return whether a name tells that a unit is meant otherwise: Temperatur [Grad], Winkel [Sekunden]."""
    role = _MEANT.get(unit.dimension)
    words = {w for w in re.split(r"[\s_.\-]+", name.casefold()) if len(w) > 1}
    return (
        role is not None
        and not words.isdisjoint(ROLE_WORDS[role].split())
        and (unit.dimension != "time" or words.isdisjoint(ROLE_WORDS["time"].split()))
    )


_NO_NAMES = frozenset({"=", ":=", ":", "[", "{", "(", "|"})
"""What stands behind the name of a variable, such as ``data =``, and is no name of a column."""


def split_header(line: str, separator: str, n_columns: int) -> list[str] | None:
    """Return the names of `n_columns` columns from a line above a table."""
    text = line.strip(" " if separator == "\t" else None)
    patterns = {
        "\t": r"\t",
        ";": ";",
        "|": r"\|",
        ",": ",",
        ", ": r",\s+",
        " ": r"\s{2,}|\t",
    }
    order = [separator, *(s for s in patterns if s != separator)]
    if separator in "\t;|" and separator in text:
        order = [separator]  # what stands between them are the names, whatever else is in these
    for mark in order:
        if len(mark) == 1 and mark != " ":
            fields = fields_in_quotes(text, mark)
        else:
            fields = re.split(patterns[mark], text)
        if mark == " " and '"' in text:
            fields = _blank_separated(text)
        names = [n.strip().strip('"').strip() for n in fields]
        while len(names) > n_columns and not names[-1]:
            names.pop()
        if len(names) == n_columns and all(names):
            return None if any(n in _NO_NAMES for n in names) else names
        if len(names) == n_columns and mark == separator != " ":
            return None  # one has none
        if mark == separator == " ":
            names = re.findall(r"[^\s\[(]+(?:\s*[\[(][^\])]*[\])])?", text)
            if len(names) == n_columns:
                return names if _NO_NAMES.isdisjoint(names) else None
    names = text.split() if len(order) > 1 else []
    few = 2 * sum(map(_is_known, names)) < n_columns  # a title of as many words
    return None if few or len(names) != n_columns or not _NO_NAMES.isdisjoint(names) else names


def _is_known(name: str) -> bool:
    """Whether a name has a unit, or is what columns are called."""
    bare, unit = header_unit(name)
    return unit is not None or re.sub(r"[\W\d_]+$", "", bare.casefold()) in _ROLE_NAMES


_ROLE_NAMES = frozenset(w for words in ROLE_WORDS.values() for w in words.split())


_NO_WORD = re.compile("[\x80-\x9f]|[\xa0-\xff]{3}")
"""Codes that are no letters, or more of them in a row than words of Latin-1 have."""


def encoding_hint(names: Iterable[str]) -> str:
    """Return what to do where names hold codes that are not letters of Latin-1, empty elsewhere."""
    if not any(_NO_WORD.search(name) for name in names):
        return ""
    return (
        "the names of the columns are in another encoding than UTF-8 or Latin-1; name it with "
        "encoding=, such as encoding='shift_jis', 'gb18030' or 'cp1252'"
    )


def find_column(wanted: str, names: Sequence[str], path: object, *, role: str) -> str:
    """Return the column that a caller means."""
    key = wanted.strip().casefold()
    for candidates in (
        [n for n in names if n == wanted],
        [n for n in names if n.casefold() == key],
        [n for n in names if header_unit(n)[0].casefold() == key],
    ):
        if len(candidates) == 1:
            return candidates[0]
        if candidates:
            raise FormatMismatchError(
                f"{path}: {role} column {wanted!r} may be {' or '.join(candidates)}; give the full name"
            )
    guess = nearest(key, names, 0.5)
    odd = encoding_hint(names)
    hint = f"; did you mean {guess!r}?" if guess else f"; {odd}" if odd else ""
    raise ReadNameError(
        f"{path}: has no {role} column {wanted!r}; the columns are {', '.join(names)}{hint}"
    )


# ---- which dialect and how many columns the lines of a text have, and where its rows begin -----
# A dialect is accepted only if it reads most lines of a sample, wherever the others stand: no part is
# left out for the reason that the rest fits. Two dialects that read different numbers out of the same
# lines (``0,123`` is one number or two) are refused with a sentence, unless the header or the caller
# (``separator=``, ``decimal=``) decides. Groups of thousands (``1,234.5`` or ``1 234,5``) are never guessed.

_UNMEASURED = re.compile(
    r"[\s,;|\"]*(?:[-+]?nan|#?na|#?n/a|#nv|null|none|no data|bad)(?:[\s,;|\"]|$)", re.IGNORECASE
)
"""How a row begins in which nothing was measured; a row of dashes may be a rule under a title."""
_AMBIGUOUS = {
    ",": re.compile(r"[+-]?[1-9]\d{0,2},\d{3}"),
    ".": re.compile(r"[+-]?[1-9]\d{0,2}\.\d{3}"),
}
"""One mark with three digits behind it: a decimal mark, or one of thousands."""
_THOUSANDS_COMMA = re.compile(
    r"\s*[+-]?[1-9]\d{0,2}(?:,\d{3})+(?:\.\d+)?(?:\s*,\s*[+-]?[1-9]\d{0,2}(?:,\d{3})+(?:\.\d+)?)*\s*"
)
_THOUSANDS_SPACE = re.compile(r"(?<![\d.,])[1-9]\d{0,2}(?:[ \u00a0\u202f']\d{3})+(?![\d])")
_NEVER_IN_NUMBERS = frozenset("\t;|")
_CANDIDATES = (
    ("\t", "."),
    (";", "."),
    ("|", "."),
    ("|", ","),
    (",", "."),
    (" ", "."),
    ("\t", ","),
    (";", ","),
    (" ", ","),
    (", ", ","),
    (",", ","),
)
_SAMPLE = 300
_DEFAULTS = TextOptions()
_MOST_COLUMNS = 2**15
"""Twice as many as a worksheet has."""


def find_layout(
    lines: Sequence[str],
    path: object,
    *,
    options: TextOptions = _DEFAULTS,
    further: Sequence[str] = (),
    labelled: bool = False,
) -> Layout:
    """Return the one layout under which lines are a table of numbers; the first column may be names."""
    for line in lines:
        most = max(map(line.count, ",;\t| "), default=0) if len(line) > _MOST_COLUMNS else 0
        if most > _MOST_COLUMNS:
            raise FormatMismatchError(
                f"{path}: a line has {most + 1} fields, more than {_MOST_COLUMNS}: not a table of columns"
            )
    above = unmeasured_rows(lines)
    head = list(lines[above : above + _SAMPLE])
    sample = [*head, *further]
    wanted = MARKS.get(options.separator or "", options.separator)
    if wanted is not None and wanted not in WORDS:
        raise ReadError(
            f"separator {options.separator!r} is not known; use one of "
            f"{', '.join(repr(w) for w in MARKS)}"
        )
    if options.decimal not in (None, ".", ","):
        raise ReadError(f"decimal {options.decimal!r} is not known; use '.' or ','")
    quoted = any('"' in line for line in sample)
    fits: list[_Fit] = []
    whole: dict[str, _Fit | None] = {}  # by decimal mark: the fit whose mark is in no line
    for mark, point in _CANDIDATES:
        if (wanted is not None and mark[:1] != wanted[:1]) or (options.decimal or point) != point:
            continue
        if point == options.thousands:
            continue
        if mark == ", " and wanted == "," and options.decimal is None:
            continue  # whoever says "comma" means the separator
        if mark == point and not quoted:
            continue
        dialect = Dialect(mark, point, quoted and mark in "\t;,| ", options.thousands or "")
        if mark not in "\t;|," or any(mark in line for line in sample):
            found = _fit(sample, len(head), dialect, labelled, options.missing or ())
        else:  # every line is one field, whichever mark is in none of them
            if point not in whole:
                whole[point] = _fit(sample, len(head), dialect, labelled, options.missing or ())
            found = whole[point]
            found = None if found is None else found._replace(dialect=dialect)
        if found is not None:
            fits.append(found)
    if not fits:
        raise _no_dialect(sample, path)
    best = _one_reading(_contenders(fits), sample, path, declared=wanted is not None)
    if best.dialect.separator not in _NEVER_IN_NUMBERS and options.decimal is None:
        _refuse_both_marks(sample, path)
    start = 0 if best.start == 0 else above + best.start
    unproven = options.decimal is None and options.thousands is None and not best.is_proven()
    dialect = best.dialect
    if unproven and best.has_groups():
        dialect = replace(dialect, decimal=dialect.other_mark, thousands=dialect.decimal)
        unproven = False
    usual = Counter(n_used(fields) for fields in best.rows.values()).most_common(1)[0][0]
    return Layout(
        dialect,
        start,
        best.n,
        best.n_raw,
        usual,
        best.labels,
        best.dated,
        above + len(best.rows) + len(best.unmeasured),
        unproven,
        len(sample) - 1 in best.rows or len(sample) - 1 in best.unmeasured,
        tuple(
            not any(f.strip() for f in column) for column in zip(*best.rows.values(), strict=True)
        ),
    )


@dataclass(frozen=True, slots=True)
class Layout:
    """How a table is written: ``n`` columns, ``n_raw`` fields of the usual row with those left empty."""

    dialect: Dialect  # separator and decimal mark
    start: int  # first row among the lines looked at
    n: int  # columns; fields of the usual row; fields of most rows that are not empty
    n_raw: int
    n_usual: int
    labels: tuple[bool, ...]  # which columns hold words
    dated: tuple[bool, ...]  # which of these hold dates or times of day
    n_fit: int  # lines that are rows
    unproven: bool  # no number shows what its decimal mark is
    ends: bool  # the last line looked at is a row
    empty: tuple[bool, ...]  # which columns hold nothing in the lines looked at


def unmeasured_rows(lines: Sequence[str]) -> int:
    """Return how many rows at the start hold only words for "not measured": data, no header."""
    for i, line in enumerate(lines):
        if not _is_unmeasured(line):
            return i
    return len(lines)


def _is_unmeasured(line: str) -> bool:
    """Whether a row holds words for "not measured" and separators, and nothing else."""
    if _UNMEASURED.match(line):
        return all(f.strip(' "').lower() in NO_READING for f in re.split(r"[,;|\t]| +", line))
    return not line.strip(",;|\t ") and sum(line.count(mark) for mark in ",;|\t") >= 3


def _fit(
    sample: Sequence[str],
    n_head: int,
    dialect: Dialect,
    labelled: bool = False,
    declared: Collection[object] = (),
) -> _Fit | None:
    """Return the rows of a sample under a dialect: the commonest number of fields makes the table."""
    with_groups = dialect if dialect.thousands else replace(dialect, thousands=dialect.other_mark)
    first = tuple(sample[:n_head])
    known_rows = _rows_of if sum(map(len, first)) <= _MOST_KEPT else _rows_of.__wrapped__
    head = known_rows(first, dialect, with_groups, labelled)
    if head is None:
        return None  # no row among the first lines, whatever the others are
    split = [*head, *dialect.split(sample[n_head:])]
    known = _kinds_of({f for row in split for f in row}, dialect, with_groups)
    if not any(_shows_mark(f, dialect) for f in known):
        known |= {f: "odd" for f, k in known.items() if k == "grouped"}
    kinds = _kinds(split, known, labelled)
    numbered = [i for i, k in enumerate(kinds) if _is_numbered(k)]
    if not numbered:
        return None
    lacking: set[int] = set()
    if dialect.separator not in {" ", ", "}:
        n_full = _n_where_rows_lack(split, kinds, numbered)
        lacking = {i for i in numbered if len(split[i]) < n_full}
        for i in lacking:
            kinds[i] += ["missing"] * (n_full - len(split[i]))
            split[i] = [*split[i], *[""] * (n_full - len(split[i]))]
    n_raw = Counter(len(split[i]) for i in numbered).most_common(1)[0][0]
    n = max(n_used(split[i]) for i in numbered if len(split[i]) == n_raw)
    alike = [i for i in numbered if len(split[i]) >= n and n_used(split[i]) <= n]
    whole = [i for i in alike if i not in lacking] or alike
    labels, dated = (
        tuple(
            2 * sum(kinds[i][k] in what for i in whole)
            > sum(kinds[i][k] != "missing" for i in whole)
            for k in range(n)
        )
        for what in (_TEXTS, ("date",))
    )
    rows = {
        i: split[i][:n]
        for i in alike
        if not any(kinds[i][k] in _TEXTS and not labels[k] for k in range(n))
    }
    for i in sorted(rows):  # the date of a header begins with its key: "delta t", then numbers
        if not dated[0] or kinds[i][0] != "label" or not split[i][0].strip()[:1].isalpha():
            break
        del rows[i]
    if not rows or min(rows) >= n_head:
        return None
    start = min(rows)
    while start and len(split[start - 1]) >= n and _is_row_of_words(split[start - 1], declared):
        start -= 1
    if all(_is_unmeasured(line) for line in sample[:start]):
        start = 0
    unmeasured = {
        i
        for i, k in enumerate(kinds)
        if start <= i and len(k) >= n and all(kind == "missing" for kind in k)
    }
    n_texts = sum(
        kinds[i][k] == "label" and f.strip()[:1].isdigit()
        for i, r in rows.items()
        for k, f in enumerate(r)
    )
    return _Fit(dialect, start, n, n_raw, labels, dated, rows, unmeasured, n_texts)


def _n_where_rows_lack(
    split: Sequence[Sequence[str]], kinds: Sequence[Sequence[str]], numbered: Sequence[int]
) -> int:
    """Return the number of columns where a row of names has them and some rows lack their last ones, else 0.

    All rows from one on lack them, as a spreadsheet writes empty cells, or the last column is of words.
    """
    counts = [len(split[i]) for i in numbered]
    most, least = max(counts), min(counts)
    named = any(
        len(f) == most and all(k == "label" for k in own)
        for f, own in zip(split[: numbered[0]], kinds, strict=False)
    )
    if most == least or not named or not {most, least}.issuperset(counts):
        return 0
    falls = counts == sorted(counts, reverse=True) and counts[-2] == least
    words = least == most - 1 and all(
        kinds[i][-1] in ("label", "missing") for i in numbered if len(kinds[i]) == most
    )
    return most if falls or words else 0


_COUNTED = frozenset({"number", "grouped", "quantity"})
_TEXTS = ("label", "date", "quantity")


def _is_row_of_words(fields: Sequence[str], declared: Collection[object]) -> bool:
    """Whether all fields say "not measured", in letters or as it was declared."""
    texts = [f.strip(' "').lower() for f in fields]
    return any(t in declared or any(map(str.isalpha, t)) for t in texts) and all(
        t in NO_READING or t in declared for t in texts
    )


def _shows_mark(field: str, dialect: Dialect) -> bool:
    """Whether a number shows what its decimal mark is: 0,5 or 1,25 mm or 1234,567, but not 1,234."""
    mark, text = dialect.decimal, field.strip()
    if mark not in text:
        return False
    if quantity(text, dialect) is not None:
        text = number_of(text)
    return (
        mark in text
        and _AMBIGUOUS[mark].fullmatch(text) is None
        and dialect.plain(text) is not None
    )


def _kinds(
    split: Sequence[Sequence[str]], known: Mapping[str, str], labelled: bool
) -> list[list[str]]:
    """Return what each field is, of fields that are known."""
    found = [[known[f] for f in row] for row in split]
    return [["label", *own[1:]] for own in found] if labelled else found


def _kinds_of(fields: set[str], dialect: Dialect, grouped: Dialect) -> dict[str, str]:
    """Return the kind of each field; one that repeats is looked at once, also when the file is recognised again."""
    kinds = _known_kinds(dialect, grouped)
    if len(kinds) > _MOST_KNOWN:  # emptied by nobody: another thread may hold it
        _known_kinds.cache_clear()
        kinds = _known_kinds(dialect, grouped)
    return {f: kinds.get(f) or kinds.setdefault(f, _kind(f, dialect, grouped)) for f in fields}


_MOST_KEPT = 100_000
"""Characters of first lines that are kept: a file is read right after it was recognised."""


@lru_cache(maxsize=16)
def _rows_of(
    lines: tuple[str, ...], dialect: Dialect, grouped: Dialect, labelled: bool
) -> list[list[str]] | None:
    """Return the fields of the first lines, which nobody changes; None where no line is a row of numbers."""
    split, kinds = dialect.split(lines), _known_kinds(dialect, grouped)
    found = any(_has_numbers(row[labelled:], kinds, dialect, grouped) for row in split)
    return split if found else None


def _has_numbers(
    fields: Sequence[str], kinds: dict[str, str], dialect: Dialect, grouped: Dialect
) -> bool:
    """Whether fields are a row of numbers; under another decimal mark the first of a thousand says no."""
    counted = False
    for field in fields:
        kind = kinds.get(field) or kinds.setdefault(field, _kind(field, dialect, grouped))
        if kind == "odd":
            return False
        counted |= kind in _COUNTED
    return counted


@lru_cache(maxsize=64)
def _known_kinds(dialect: Dialect, grouped: Dialect) -> dict[str, str]:
    """Return the kinds of the fields that were looked at under a dialect; `_kinds_of` fills it."""
    return {}


_MOST_KNOWN = 10_000


def _is_numbered(kinds: Sequence[str]) -> bool:
    return "odd" not in kinds and not _COUNTED.isdisjoint(kinds)


def _kind(field: str, dialect: Dialect, grouped: Dialect) -> str:
    """Return what a field is; "grouped" is a number only where groups of thousands are proven."""
    text = field.strip()
    if dialect.plain(text) is not None:
        return "number"
    if text.lower() in NO_READING:
        return "missing"
    if is_moment(text):
        return "date"
    if NUMBER_LIKE.fullmatch(text):
        return "odd" if grouped.plain(text) is None else "grouped"
    if dialect.separator in {" ", ", "} and any(mark in text for mark in ",;\t"):
        return "odd"
    return "label" if quantity(text, dialect) is None else "quantity"


_QUANTITY = re.compile(r"([+\-\u2212]?[\d.,]+(?:[eE][+-]?\d+)?)\s*([^\s\d.,+\-][^\d]*)")


def number_of(text: str) -> str:
    """Return the number of a text such as ``1.5 mm`` as it is written, the text itself where there is none."""
    found = _QUANTITY.fullmatch(text.strip())
    return text if found is None else found[1]


def quantity(field: str, dialect: Dialect) -> tuple[float, Unit] | None:
    """Return the number and the unit of a field such as ``1.5 mm``, None for anything else."""
    found = _QUANTITY.fullmatch(field.strip())
    plain = None if found is None else dialect.plain(found[1])
    unit = None if found is None or plain is None else bare_unit(found[2])
    return None if plain is None or unit is None else (float(plain), unit)


class _Fit(NamedTuple):
    """A dialect with its columns and its rows in the sample, by their index; some hold no number."""

    dialect: Dialect
    start: int
    n: int
    n_raw: int
    labels: tuple[bool, ...]
    dated: tuple[bool, ...]
    rows: dict[int, list[str]]
    unmeasured: set[int]
    n_texts: (
        int  # fields of the rows that hold digits and are neither a number nor one with a unit
    )

    def values(self, index: int) -> list[str]:
        return [(self.dialect.plain(f) or f.strip()).removesuffix(".") for f in self.rows[index]]

    def reads_as(self, other: _Fit) -> bool:
        """Whether two dialects read the same out of the lines that fit both."""
        return all(self.values(i) == other.values(i) for i in self.rows if i in other.rows)

    def is_proven(self) -> bool:
        """Whether a number of the sample shows what the decimal mark is: 0,5 or 1,25 or 1234,567."""
        return any(_shows_mark(f, self.dialect) for fields in self.rows.values() for f in fields)

    def has_groups(self) -> bool:
        """Whether the mark stands between groups of three digits: 1,000 beside 990 in one column.

        A writer with fixed decimals marks every number, a shortest-form writer never ends in 0
        behind the mark: neither writes both.
        """
        groups = _AMBIGUOUS[self.dialect.decimal]
        for column in zip(*self.rows.values(), strict=True):
            texts = [f.strip() for f in column]
            marked = [t for t in texts if groups.fullmatch(t)]
            if any(t[-1] == "0" for t in marked) and any(
                t.lstrip("+-").isdecimal() and len(t.lstrip("+-")) <= 3 for t in texts
            ):
                return True
        return False

    def agrees_with_header(self, sample: list[str]) -> bool:
        above = sample[: self.start]
        if self.n == 1:
            return bool(above) and not any(mark in above[-1] for mark in ",;\t|")
        return any(n_used(fields) == self.n for fields in self.dialect.split(above))


_TOLERATED = 0.1
"""Share of the rows in which a dialect may fail and still contend: a damaged row must not decide."""


def _contenders(fits: list[_Fit]) -> list[_Fit]:
    """Return the fits with about the most rows; marks that no number holds come first."""
    most = max(len(f.rows) for f in fits)
    fits = [f for f in fits if len(f.rows) >= most - int(_TOLERATED * most)]
    sure = [f for f in fits if f.dialect.separator in _NEVER_IN_NUMBERS and f.n_raw > 1]
    return sorted(sure or fits, key=lambda f: (-len(f.rows), f.n_texts))


def _one_reading(fits: list[_Fit], sample: list[str], path: object, *, declared: bool) -> _Fit:
    first = fits[0]
    others = [f for f in fits[1:] if not f.reads_as(first)]
    line = sample[min(first.rows)].strip()[:60]
    if others:
        alike = [f for f in fits if f.reads_as(first)]
        groups = [alike, *([f] for f in others)]
        named = [g[0] for g in groups if any(f.agrees_with_header(sample) for f in g)]
        if len(named) == 1 or (named and all(f.reads_as(named[0]) for f in named)):
            return named[0]
        raise AmbiguousFormatError(
            f"{path}: the line {line!r} reads as {first.n} number(s) with {first.dialect}, or as "
            f"{others[0].n} with {others[0].dialect}; say which with separator= and decimal="
        )
    grouped = _looks_like_thousands([sample[i] for i in first.rows], first.dialect)
    if grouped and not declared and not first.agrees_with_header(sample):
        raise AmbiguousFormatError(
            f"{path}: the line {line!r} may hold numbers in groups of thousands; export it without such "
            f"groups, or say separator={WORDS[first.dialect.separator]!r} if it holds {first.n} numbers"
        )
    return first


def _refuse_both_marks(sample: Sequence[str], path: object) -> None:
    """Refuse lines that a sure separator divides alike into numbers of both decimal marks."""
    for mark in sorted(_NEVER_IN_NUMBERS):
        split = [line.split(mark) for line in sample]
        n = Counter(map(len, split)).most_common(1)[0][0]
        rows = [[f.strip() for f in r] for r in split if len(r) == n > 1]
        both = [
            [f for r in rows for f in r if m in f and _NUMBER[m].fullmatch(f)] for m in (".", ",")
        ]
        if 2 * len(rows) > len(sample) and all(both):
            raise AmbiguousFormatError(
                f"{path}: numbers such as {both[0][0]!r} and {both[1][0]!r} have different decimal marks, and a "
                f"file has one; export it with one mark, or name it with decimal= (and thousands= for groups)"
            )


def _looks_like_thousands(body: list[str], dialect: Dialect) -> bool:
    if dialect.separator == ",":
        return all(_THOUSANDS_COMMA.fullmatch(line) for line in body)
    if dialect.separator == " ":
        pattern = r"\s*(?:[+-]?[1-9]\d{0,2}(?:[ \u00a0]\d{3})+(?:[.,]\d+)?\s*)+"
        return all(re.fullmatch(pattern, line) for line in body)
    return False


def _no_dialect(sample: list[str], path: object) -> ReadError:
    grouped = [s for s in sample if _THOUSANDS_SPACE.search(s) or re.search(r"\d'\d{3}", s)]
    mixed = [line for line in sample if re.search(r"\d,\d{3}\.\d|\d\.\d{3},\d", line)]
    if lakhs := [s for s in sample if re.search(r"(?<!\d)\d{1,2}(?:,\d\d)+,\d{3}(?!\d)", s)]:
        return AmbiguousFormatError(
            f"{path}: the line {lakhs[0].strip()[:60]!r} holds numbers in groups of two digits (lakh, crore), which "
            "are not read; export it without groups"
        )
    if grouped or mixed:
        return AmbiguousFormatError(
            f"{path}: the line {(mixed or grouped)[0].strip()[:60]!r} seems to hold numbers in groups of "
            "thousands, which are not guessed; name their mark with thousands= (',' or '.' or \"'\"), or "
            "export it without such groups"
        )
    last = sample[-1].strip()[:60] if sample else "nothing"
    return CorruptFileError(
        path,
        "holds no table of numbers",
        expected="rows of numbers with one separator and one decimal mark",
        found=repr(last),
        hint="export it as CSV, or declare separator= and decimal=, and thousands= for groups of digits",
    )
