"""How a table of numbers is written as text: encoding, separator, decimal mark, comments.

Which dialect a text is in is found by `metrosep.io.text._table_layout`.
"""

from __future__ import annotations

import codecs
import csv
import difflib
import re
import unicodedata
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

from metrosep.core.errors import FormatMismatchError, ReadError, UnitError
from metrosep.core.units import Unit, column_unit, parse_unit
from metrosep.io.source import HEAD_BYTES

__all__ = [
    "MARKS",
    "MISSING",
    "NUMBER_LIKE",
    "WORDS",
    "Dialect",
    "bare_unit",
    "decode",
    "find_column",
    "header_unit",
    "is_comment",
    "is_number",
    "n_used",
    "plain_ends",
    "split_header",
]

_SPREADSHEET = (
    "#n/a", "#na", "#nv", "#value!", "#wert!", "#div/0!", "#ref!", "#bezug!", "#num!", "#zahl!",
    "#name?", "#null!",
)  # fmt: skip
"""What a spreadsheet in English or German writes into a cell without a value."""

MISSING: Final = frozenset(
    {
        "", "nan", "-nan", "+nan", "nan(ind)", "-nan(ind)", "1.#qnan", "-1.#qnan", "1.#ind",
        "-1.#ind", "na", "n/a", "null", "none", "nil", "missing", "bad", "invalid", "void",
        "no data", "nodata", "-", "--", "---", "----", "*", "**", "***", "****", *_SPREADSHEET,
    }
)  # fmt: skip
"""Words, in lower case, for "not measured"."""


_ERROR_CELL = re.compile(
    rf"(?:{'|'.join(map(re.escape, _SPREADSHEET))})(?=[\s;,|\"]|$)", re.IGNORECASE
)
_NUMBER = {
    ".": re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d+)?"),
    ",": re.compile(r"[+-]?(?:\d+(?:,\d+)?|,\d+)(?:[eEdD][+-]?\d+)?"),
}
NUMBER_LIKE = re.compile(r"[+-]?[\d.,][\d.,' \u00a0\u202f;\t]*(?:[eE][+-]?\d+)?")
_MINUS = dict.fromkeys(map(ord, "\u2212\u2010\u2011\u2012\u2013\ufe63\uff0d"), "-")
MARKS = {
    "tab": "\t", "space": " ", "whitespace": " ", "comma": ",", "semicolon": ";", "pipe": "|"
}  # fmt: skip
WORDS = {mark: name for name, mark in MARKS.items()} | {" ": "space", ", ": "comma and space"}
_CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1a\x1c-\x1f]")


@dataclass(frozen=True, slots=True)
class Dialect:
    """Separator and decimal mark of a table."""

    # tab, ``";"``, ``","``, ``", "`` (a comma followed by space, where the decimal mark is a comma
    # too) or ``" "`` for any white space
    separator: str
    decimal: str  # {".", ","}: decimal mark
    quoted: bool = False  # whether fields may stand in double quotes
    thousands: str = ""  # mark between groups of three digits, which only a caller declares

    def split(self, lines: Iterable[str]) -> list[list[str]]:
        """Return the fields of each line."""
        if self.separator == " ":
            return [line.split() for line in lines]
        if self.separator == ", ":
            return [re.split(r",\s+", line.strip()) for line in lines]
        if self.quoted:
            # line by line: an odd quote must not swallow the lines after it
            return [
                next(csv.reader([line], delimiter=self.separator, skipinitialspace=True), [""])
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
        if self.thousands and self.thousands in text:
            whole = re.escape(self.thousands)
            rest = re.escape(self.decimal)
            if not re.fullmatch(rf"[+-]?[1-9]\d{{0,2}}(?:{whole}\d{{3}})+(?:{rest}\d*)?", text):
                return None
            text = text.replace(self.thousands, "")
        if _NUMBER[self.decimal].fullmatch(text) is None:
            return None
        return text.replace(",", ".").replace("d", "e").replace("D", "e")

    def __str__(self) -> str:
        mark = "point" if self.decimal == "." else "comma"
        return f"separator {WORDS[self.separator]}, decimal {mark}"


def decode(data: bytes, path: object, encoding: str | None = None) -> tuple[str, str]:
    r"""Return the text of a file and the encoding it was in."""
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
    return plain_ends(text), name


def plain_ends(text: str) -> str:
    """Return text whose lines end with LF alone; no other character ends a line."""
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
    return None if _is_binary(data, text, name) else (plain_ends(text), name)


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
    """Return whether a line is a comment."""
    text = line.lstrip().lstrip('"')
    if prefix is not None:
        return text.startswith(prefix)
    if text.startswith(("#", "%", "!", "//")):
        return _ERROR_CELL.match(text) is None  # else a row whose first cell has no value
    if text.startswith(";"):
        rest = text.lstrip("; \t")
        return bool(rest) and not NUMBER_LIKE.match(rest)
    return False


def is_number(field: str, decimal: str) -> bool:
    """Return whether a field is one number."""
    return _NUMBER[decimal].fullmatch(field.strip()) is not None


def n_used(fields: Sequence[str]) -> int:
    """Return how many fields there are up to the last that is not empty."""
    n = len(fields)
    while n and not fields[n - 1].strip():
        n -= 1
    return n


# ---- names and units of columns, as people and loggers write them above a table ----------------

_IN = re.compile(r"^(.+?)\s+in\s+(\S+)$")
_SLASH = re.compile(r"^(.+?)\s*/\s*(\S+)$")
_SPACED = re.compile(r"^(.+?)\s+(pm|nm|um|\u00b5m|\u03bcm|mm|cm|urad|mrad|arcsec|deg|ms|us|mV)$")
_BRACKETS = re.compile(r"^[\[(<]\s*(.*?)\s*[\])>]$")


def bare_unit(field: str) -> Unit | None:
    """Return the unit that a field names and nothing else, such as ``"[um]"``."""
    text = field.strip().strip('"').strip()
    match = _BRACKETS.match(text)
    try:
        return parse_unit(match.group(1) if match else text)
    except UnitError:
        return None


def header_unit(header: str) -> tuple[str, Unit | None]:
    """Return the bare name of a column and the unit that its header declares.

    Examples
    --------
    >>> header_unit("s / mm")[0], header_unit("s / mm")[1].name
    ('s', 'mm')
    """
    name, unit = column_unit(header)
    if unit is not None:
        return name, unit
    text = header.strip()
    if bare_unit(text) is not None:
        return text, None
    for pattern in (_IN, _SLASH, _SPACED):
        match = pattern.match(text)
        if match is not None:
            unit = bare_unit(match.group(2))
            if unit is not None and unit.dimension != "number":
                return match.group(1).strip(" _"), unit
    return text, None


def split_header(line: str, separator: str, n_columns: int) -> list[str] | None:
    """Return the names of `n_columns` columns from a line above a table."""
    text = line.strip()
    patterns = {
        "\t": r"\t",
        ";": ";",
        "|": r"\|",
        ",": ",",
        ", ": r",\s+",
        " ": r"\s{2,}|\t",
    }
    order = [separator, *(s for s in patterns if s != separator)]
    for mark in order:
        if len(mark) == 1 and mark != " ":
            fields = next(csv.reader([text], delimiter=mark, skipinitialspace=True), [])
        else:
            fields = re.split(patterns[mark], text)
        names = [n.strip().strip('"').strip() for n in fields]
        while len(names) > n_columns and not names[-1]:
            names.pop()
        if len(names) == n_columns and all(names):
            return names
        if mark == separator == " ":
            names = re.findall(r"[^\s\[(]+(?:\s*[\[(][^\])]*[\])])?", text)
            if len(names) == n_columns:
                return names
    names = text.split()
    return names if len(names) == n_columns else None


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
    near = difflib.get_close_matches(key, [n.casefold() for n in names], n=1, cutoff=0.5)
    guess = next((n for n in names if near and n.casefold() == near[0]), None)
    hint = f"; did you mean {guess!r}?" if guess else ""
    raise FormatMismatchError(
        f"{path}: has no {role} column {wanted!r}; the columns are {', '.join(names)}{hint}"
    )
