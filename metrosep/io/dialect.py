"""How a table of numbers is written as text: encoding, separator, decimal mark, comments.

A dialect is accepted only if every line of a sample reads the same way under it. Two dialects
that read different numbers out of the same lines (``0,123`` is one number or two) are refused
with a sentence, unless the header or the caller (``separator=``, ``decimal=``) decides. Groups of
thousands (``1,234.5`` or ``1 234,5``) are never guessed.
"""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, NamedTuple

from metrosep.core.errors import (
    AmbiguousFormatError,
    CorruptFileError,
    FormatMismatchError,
    ReadError,
)
from metrosep.io.source import HEAD_BYTES

__all__ = [
    "MISSING",
    "Dialect",
    "body_start",
    "decode",
    "detect",
    "is_comment",
    "is_number",
    "unmeasured_rows",
]

MISSING: Final = frozenset(
    {"", "nan", "-nan", "na", "n/a", "#n/a", "null", "none", "-", "--", "---", "no data", "bad"}
)
"""Words, in lower case, for "not measured"."""

_UNMEASURED = re.compile(
    r"[\s,;\"]*(?:[-+]?nan|na|n/a|#n/a|null|none|no data|bad)(?:[\s,;\"]|$)", re.IGNORECASE
)
"""How a row begins in which nothing was measured; a row of dashes may be a rule under a title."""

_NUMBER = {
    ".": re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d+)?"),
    ",": re.compile(r"[+-]?(?:\d+(?:,\d+)?|,\d+)(?:[eEdD][+-]?\d+)?"),
}
_NUMBER_LIKE = re.compile(r"[+-]?[\d.,][\d.,' \u00a0\u202f;\t]*(?:[eE][+-]?\d+)?")
_THOUSANDS_COMMA = re.compile(
    r"\s*[+-]?[1-9]\d{0,2}(?:,\d{3})+(?:\.\d+)?(?:\s*,\s*[+-]?[1-9]\d{0,2}(?:,\d{3})+(?:\.\d+)?)*\s*"
)
_THOUSANDS_SPACE = re.compile(r"(?<![\d.,])[1-9]\d{0,2}(?:[ \u00a0\u202f']\d{3})+(?![\d])")
_NAMES = {"tab": "\t", "space": " ", "whitespace": " ", "comma": ",", "semicolon": ";"}
_WORDS = {"\t": "tab", " ": "space", ",": "comma", ";": "semicolon", ", ": "comma and space"}
_CANDIDATES = (
    ("\t", "."),
    (";", "."),
    (",", "."),
    (" ", "."),
    ("\t", ","),
    (";", ","),
    (" ", ","),
    (", ", ","),
    (",", ","),
)
_CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1a\x1c-\x1f]")
_SAMPLE = 300


@dataclass(frozen=True, slots=True)
class Dialect:
    """Separator and decimal mark of a table.

    Parameters
    ----------
    separator : str
        Tab, ``";"``, ``","``, ``", "`` (a comma followed by space, where the decimal mark is a
        comma too) or ``" "`` for any white space.
    decimal : {".", ","}
        Decimal mark.
    quoted : bool, optional
        Whether fields may stand in double quotes.
    """

    separator: str
    decimal: str
    quoted: bool = False

    def split(self, lines: Iterable[str]) -> list[list[str]]:
        """Return the fields of each line.

        Parameters
        ----------
        lines : iterable of str
            Lines without their ends.

        Returns
        -------
        list of list of str
            Fields; outer white space may remain.
        """
        if self.separator == " ":
            return [line.split() for line in lines]
        if self.separator == ", ":
            return [re.split(r",\s+", line.strip()) for line in lines]
        if self.quoted:
            return list(csv.reader(lines, delimiter=self.separator, skipinitialspace=True))
        return [line.split(self.separator) for line in lines]

    def __str__(self) -> str:
        mark = "point" if self.decimal == "." else "comma"
        return f"separator {_WORDS[self.separator]}, decimal {mark}"


def decode(data: bytes, path: object, encoding: str | None = None) -> tuple[str, str]:
    r"""Return the text of a file and the encoding it was in.

    Parameters
    ----------
    data : bytes
        Content.
    path : object
        For the message.
    encoding : str, optional
        Declared encoding; otherwise a byte order mark decides, then UTF-16 by its zero bytes, then
        UTF-8, then Latin-1 (which also carries the micro sign of older instruments).

    Returns
    -------
    tuple of (str, str)
        Text with ``\n`` line ends, and the encoding.

    Raises
    ------
    ReadError
        If the bytes are not text, or not in the declared encoding.
    """
    if encoding is None and len(data) <= HEAD_BYTES:
        known = _decoded_head(data)
        if known is not None:
            return known
    name = encoding or _encoding(data)
    try:
        text = data.decode(name)
    except (UnicodeDecodeError, LookupError) as exc:
        raise ReadError(f"{path}: is not {name} text ({exc}); name it with encoding=") from None
    if _is_binary(data, text, name):
        raise FormatMismatchError(
            f"{path}: holds binary data, not text; if it is a text file, name it with encoding="
        )
    return _plain_ends(text), name


def _plain_ends(text: str) -> str:
    for end in ("\r\r\n", "\r\n", "\r"):
        text = text.replace(end, "\n")
    return text.removeprefix("\ufeff")


@lru_cache(maxsize=2)
def _decoded_head(data: bytes) -> tuple[str, str] | None:
    """Return what `decode` does of a head that a dozen readers look at; None where it refuses."""
    name = _encoding(data)
    try:
        text = data.decode(name)
    except (UnicodeDecodeError, LookupError):
        return None
    return None if _is_binary(data, text, name) else (_plain_ends(text), name)


def _is_binary(data: bytes, text: str, name: str) -> bool:
    by_byte = name in {"utf-8", "utf-8-sig", "latin-1"}
    return "\0" in text or (by_byte and _CONTROL.search(data) is not None)


def _encoding(data: bytes) -> str:
    for mark, name in (
        (codecs.BOM_UTF8, "utf-8-sig"),
        (codecs.BOM_UTF16_LE, "utf-16"),
        (codecs.BOM_UTF16_BE, "utf-16"),
    ):
        if data.startswith(mark):
            return name
    head = data[:2000]
    if len(head) >= 4 and head[1::2].count(0) > 0.4 * len(head) / 2:
        return "utf-16-le"
    if len(head) >= 4 and head[0::2].count(0) > 0.4 * len(head) / 2:
        return "utf-16-be"
    try:
        data.decode("utf-8")
    except UnicodeDecodeError as exc:
        # the sample that sniff gets may end inside a character
        return "latin-1" if exc.start < len(data) - 4 or len(data) < 1000 else "utf-8"
    return "utf-8"


def is_comment(line: str, prefix: str | None = None) -> bool:
    """Return whether a line is a comment.

    Parameters
    ----------
    line : str
        The line.
    prefix : str, optional
        Declared start of comments; otherwise ``#``, ``%``, ``!``, ``//`` and, before anything that
        is no number, ``;``.

    Returns
    -------
    bool
        True for a comment.
    """
    text = line.lstrip().lstrip('"')
    if prefix is not None:
        return text.startswith(prefix)
    if text.startswith(("#", "%", "!", "//")):
        return True
    if text.startswith(";"):
        rest = text.lstrip("; \t")
        return bool(rest) and not _NUMBER_LIKE.match(rest)
    return False


def is_number(field: str, decimal: str) -> bool:
    """Return whether a field is one number.

    Parameters
    ----------
    field : str
        The field.
    decimal : {".", ","}
        Decimal mark.

    Returns
    -------
    bool
        True for a number; words for "not measured" are not numbers.
    """
    return _NUMBER[decimal].fullmatch(field.strip()) is not None


def detect(
    lines: Sequence[str],
    path: object,
    *,
    separator: str | None = None,
    decimal: str | None = None,
) -> Dialect:
    """Return the one dialect under which lines are a table of numbers.

    Parameters
    ----------
    lines : sequence of str
        Lines without comments and blank lines.
    path : object
        For the message.
    separator, decimal : str, optional
        What the caller declares; ``"tab"``, ``"space"``, ``"comma"``, ``"semicolon"`` are
        accepted as names.

    Returns
    -------
    Dialect
        Separator and decimal mark.

    Raises
    ------
    AmbiguousFormatError
        If two dialects read different numbers.
    CorruptFileError
        If none fits.
    ReadError
        If `separator` or `decimal` is not one of those known.
    """
    above = unmeasured_rows(lines)
    sample = list(lines[above : above + _SAMPLE])
    wanted = _NAMES.get(separator or "", separator)
    if wanted is not None and wanted not in _WORDS:
        raise ReadError(
            f"separator {separator!r} is not known; use one of {', '.join(repr(w) for w in _NAMES)}"
        )
    if decimal not in (None, ".", ","):
        raise ReadError(f"decimal {decimal!r} is not known; use '.' or ','")
    quoted = any('"' in line for line in sample)
    fits: list[_Fit] = []
    for mark, point in _CANDIDATES:
        if (wanted is not None and mark[:1] != wanted[:1]) or (decimal or point) != point:
            continue
        if mark == ", " and wanted == "," and decimal is None:
            continue  # whoever says "comma" means the separator
        if mark == point and not quoted:
            continue
        dialect = Dialect(mark, point, quoted and mark in "\t;,")
        start, rows = _body(sample, dialect)
        if rows:
            fits.append(_Fit(dialect, start, rows))
    fits = _prefer_longest(fits, sample)
    if not fits:
        raise _no_dialect(sample, path)
    return _one_reading(fits, sample, path, declared=wanted is not None)


def body_start(lines: Sequence[str], dialect: Dialect) -> int:
    """Return the index of the first line of numbers.

    Parameters
    ----------
    lines : sequence of str
        Lines without comments and blank lines.
    dialect : Dialect
        How they are written.

    Returns
    -------
    int
        Lines before it are titles, names and units.
    """
    above = unmeasured_rows(lines)
    start = _body(lines[above : above + _SAMPLE], dialect)[0]
    return 0 if start == 0 else above + start


def unmeasured_rows(lines: Sequence[str]) -> int:
    """Return how many rows at the start hold only words for "not measured": data, no header.

    Parameters
    ----------
    lines : sequence of str
        Lines without comments and blank lines.

    Returns
    -------
    int
        Rows such as ``nan,nan,nan`` above all others; a row of empty fields counts where it has
        four and more.
    """
    for i, line in enumerate(lines):
        if not _is_unmeasured(line):
            return i
    return len(lines)


def _is_unmeasured(line: str) -> bool:
    """Whether a row holds words for "not measured" and separators, and nothing else."""
    if _UNMEASURED.match(line):
        return all(
            f.strip(' "').lower() in MISSING | {"+nan"} for f in re.split(r"[,;\t]| +", line)
        )
    return not line.strip(",;\t ") and sum(line.count(mark) for mark in ",;\t") >= 3


def _body(sample: Sequence[str], dialect: Dialect) -> tuple[int, list[list[str]]]:
    """Return the start and the fields of the run of alike rows that ends the sample.

    A last line that stands alone does not count: the file may be cut off in it.
    """
    rows = _alike(sample, dialect)
    if len(rows) <= 1 < len(sample) - 1:
        without_last = _alike(sample[:-1], dialect)
        if len(without_last) > len(rows):
            return len(sample) - 1 - len(without_last), without_last
    return len(sample) - len(rows), rows


def _alike(sample: Sequence[str], dialect: Dialect) -> list[list[str]]:
    rows: list[list[str]] = []
    kinds: list[str] = []
    for fields in reversed(dialect.split(sample)):
        found = [_kind(f, dialect) for f in fields]
        if rows and len(found) != len(kinds):
            break
        unmeasured = all(kind == "missing" for kind in found)
        if ("number" not in found and not unmeasured) or "odd" in found:
            break
        pairs = list(zip(found, kinds, strict=True)) if rows else []
        if any({a, b} == {"number", "label"} for a, b in pairs):
            break
        kinds = [a if b == "missing" else b for a, b in pairs] if rows else found
        rows.append(fields)
    if "number" not in kinds:
        return []
    while not any(_is_word_or_number(f, dialect) for f in rows[-1]):
        rows.pop()  # empty fields or dashes under a title
    return rows[::-1]


def _is_word_or_number(field: str, dialect: Dialect) -> bool:
    """Whether a field is a number or says in letters that nothing was measured."""
    text = field.strip().lower()
    return any(c.isalpha() for c in text) or _kind(text, dialect) == "number"


def _kind(field: str, dialect: Dialect) -> str:
    text = field.strip()
    if text.lower() in MISSING:
        return "missing"
    if is_number(text, dialect.decimal):
        return "number"
    if _NUMBER_LIKE.fullmatch(text):
        return "odd"
    if dialect.separator in {" ", ", "} and any(mark in text for mark in ",;\t"):
        return "odd"
    return "label"


class _Fit(NamedTuple):
    """A dialect, the first line that it reads as numbers, and the fields from there on."""

    dialect: Dialect
    start: int
    rows: list[list[str]]

    def values(self) -> list[list[str]]:
        point = self.dialect.decimal
        return [[f.strip().replace(point, ".").removesuffix(".") for f in r] for r in self.rows]

    def agrees_with_header(self, sample: list[str]) -> bool:
        n_columns = len(self.rows[0])
        above = sample[: self.start]
        if n_columns == 1:
            return bool(above) and not any(mark in above[-1] for mark in ",;\t")
        return any(len(fields) == n_columns for fields in self.dialect.split(above))


def _prefer_longest(fits: list[_Fit], sample: list[str]) -> list[_Fit]:
    """Return the fits with the most rows, not counting a last line that may be cut off."""
    n_lines = len(sample)
    longest = max((n_lines - f.start for f in fits), default=0)
    fits = [f for f in fits if n_lines - f.start == longest]
    whole = [f for f in fits if f.start + len(f.rows) == n_lines]
    named = [f for f in fits if f.agrees_with_header(sample)]
    if whole and (not named or any(f in whole for f in named)):
        fits = whole
    if any(f.dialect.separator == "\t" and len(f.rows[0]) > 1 for f in fits):
        return [f for f in fits if f.dialect.separator != " "]
    return fits


def _one_reading(fits: list[_Fit], sample: list[str], path: object, *, declared: bool) -> Dialect:
    first = fits[0]
    reference = first.values()
    other = next((f for f in fits[1:] if f.values() != reference), None)
    line = sample[first.start].strip()[:60]
    if other is not None:
        named = [f for f in fits if f.agrees_with_header(sample)]
        if len(named) == 1:
            return named[0].dialect
        raise AmbiguousFormatError(
            f"{path}: the line {line!r} reads as {len(first.rows[0])} number(s) with {first.dialect}, or "
            f"as {len(other.rows[0])} with {other.dialect}; say which with separator= and decimal="
        )
    grouped = _looks_like_thousands(sample[first.start :], first.dialect)
    if grouped and not declared and not first.agrees_with_header(sample):
        raise AmbiguousFormatError(
            f"{path}: the line {line!r} may hold numbers in groups of thousands; export it without such "
            f"groups, or say separator={_WORDS[first.dialect.separator]!r} if it holds "
            f"{len(first.rows[0])} numbers"
        )
    return first.dialect


def _looks_like_thousands(body: list[str], dialect: Dialect) -> bool:
    if dialect.separator == ",":
        return all(_THOUSANDS_COMMA.fullmatch(line) for line in body)
    if dialect.separator == " ":
        pattern = r"\s*(?:[+-]?[1-9]\d{0,2}(?:[ \u00a0]\d{3})+(?:[.,]\d+)?\s*)+"
        return all(re.fullmatch(pattern, line) for line in body)
    return False


def _no_dialect(sample: list[str], path: object) -> ReadError:
    grouped = [line for line in sample if _THOUSANDS_SPACE.search(line) or "'" in line]
    mixed = [line for line in sample if re.search(r"\d,\d{3}\.\d|\d\.\d{3},\d", line)]
    if grouped or mixed:
        return AmbiguousFormatError(
            f"{path}: the line {(mixed or grouped)[0].strip()[:60]!r} seems to hold numbers in groups of "
            "thousands, which are not guessed; export it without such groups"
        )
    last = sample[-1].strip()[:60] if sample else "nothing"
    return CorruptFileError(
        path,
        "holds no table of numbers",
        expected="rows of numbers with one separator and one decimal mark",
        found=repr(last),
        hint="export it as CSV, or declare separator= and decimal=",
    )
