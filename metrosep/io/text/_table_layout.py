"""Which dialect and how many columns the lines of a text have, and where its rows begin.

A dialect is accepted only if it reads most lines of a sample, wherever the others stand: no part is
left out for the reason that the rest fits. Two dialects that read different numbers out of the same
lines (``0,123`` is one number or two) are refused with a sentence, unless the header or the caller
(``separator=``, ``decimal=``) decides. Groups of thousands (``1,234.5`` or ``1 234,5``) are never guessed.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from metrosep.core.errors import AmbiguousFormatError, CorruptFileError, ReadError
from metrosep.core.text_options import TextOptions
from metrosep.io.text.dialect import MARKS, MISSING, NUMBER_LIKE, WORDS, Dialect, n_used

__all__ = ["Layout", "find_layout", "unmeasured_rows"]

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


def find_layout(
    lines: Sequence[str],
    path: object,
    *,
    options: TextOptions = _DEFAULTS,
    further: Sequence[str] = (),
) -> Layout:
    """Return the one layout under which lines are a table of numbers."""
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
    for mark, point in _CANDIDATES:
        if (wanted is not None and mark[:1] != wanted[:1]) or (options.decimal or point) != point:
            continue
        if point == options.thousands:
            continue
        if mark == ", " and wanted == "," and options.decimal is None:
            continue  # whoever says "comma" means the separator
        if mark == point and not quoted:
            continue
        dialect = Dialect(mark, point, quoted and mark in "\t;,|", options.thousands or "")
        found = _fit(sample, len(head), dialect)
        if found is not None:
            fits.append(found)
    if not fits:
        raise _no_dialect(sample, path)
    best = _one_reading(_contenders(fits), sample, path, declared=wanted is not None)
    start = 0 if best.start == 0 else above + best.start
    unproven = options.decimal is None and options.thousands is None and not best.is_proven()
    usual = Counter(n_used(fields) for fields in best.rows.values()).most_common(1)[0][0]
    return Layout(
        best.dialect,
        start,
        best.n,
        best.n_raw,
        usual,
        best.labels,
        above + len(best.rows) + len(best.unmeasured),
        unproven,
        len(sample) - 1 in best.rows or len(sample) - 1 in best.unmeasured,
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
    n_fit: int  # lines that are rows
    unproven: bool  # no number shows what its decimal mark is
    ends: bool  # the last line looked at is a row


def unmeasured_rows(lines: Sequence[str]) -> int:
    """Return how many rows at the start hold only words for "not measured": data, no header."""
    for i, line in enumerate(lines):
        if not _is_unmeasured(line):
            return i
    return len(lines)


def _is_unmeasured(line: str) -> bool:
    """Whether a row holds words for "not measured" and separators, and nothing else."""
    if _UNMEASURED.match(line):
        return all(f.strip(' "').lower() in MISSING for f in re.split(r"[,;|\t]| +", line))
    return not line.strip(",;|\t ") and sum(line.count(mark) for mark in ",;|\t") >= 3


def _fit(sample: Sequence[str], n_head: int, dialect: Dialect) -> _Fit | None:
    """Return the rows of a sample under a dialect: the commonest number of fields makes the table."""
    split = dialect.split(sample)
    kinds = [[_kind(f, dialect) for f in fields] for fields in split]
    numbered = [i for i, k in enumerate(kinds) if "number" in k and "odd" not in k]
    if not numbered:
        return None
    n_raw = Counter(len(split[i]) for i in numbered).most_common(1)[0][0]
    n = max(n_used(split[i]) for i in numbered if len(split[i]) == n_raw)
    alike = [i for i in numbered if len(split[i]) >= n and n_used(split[i]) <= n]
    labels = tuple(
        2 * sum(kinds[i][k] == "label" for i in alike)
        > sum(kinds[i][k] != "missing" for i in alike)
        for k in range(n)
    )
    rows = {
        i: split[i][:n]
        for i in alike
        if not any(kinds[i][k] == "label" and not labels[k] for k in range(n))
    }
    if not rows or min(rows) >= n_head:
        return None
    start = min(rows)
    while start and len(split[start - 1]) >= n and _is_row_of_words(split[start - 1]):
        start -= 1
    if all(_is_unmeasured(line) for line in sample[:start]):
        start = 0
    unmeasured = {
        i
        for i, k in enumerate(kinds)
        if start <= i and len(k) >= n and all(kind == "missing" for kind in k)
    }
    return _Fit(dialect, start, n, n_raw, labels, rows, unmeasured)


def _is_row_of_words(fields: Sequence[str]) -> bool:
    """Whether all fields say "not measured", one of them in letters."""
    texts = [f.strip(' "').lower() for f in fields]
    return all(t in MISSING for t in texts) and any(c.isalpha() for t in texts for c in t)


def _kind(field: str, dialect: Dialect) -> str:
    text = field.strip()
    if text.lower() in MISSING:
        return "missing"
    if dialect.plain(text) is not None:
        return "number"
    if NUMBER_LIKE.fullmatch(text):
        return "odd"
    if dialect.separator in {" ", ", "} and any(mark in text for mark in ",;\t"):
        return "odd"
    return "label"


class _Fit(NamedTuple):
    """A dialect with its columns and its rows in the sample, by their index; some hold no number."""

    dialect: Dialect
    start: int
    n: int
    n_raw: int
    labels: tuple[bool, ...]
    rows: dict[int, list[str]]
    unmeasured: set[int]

    def values(self, index: int) -> list[str]:
        return [(self.dialect.plain(f) or f.strip()).removesuffix(".") for f in self.rows[index]]

    def reads_as(self, other: _Fit) -> bool:
        """Whether two dialects read the same out of the lines that fit both."""
        return all(self.values(i) == other.values(i) for i in self.rows if i in other.rows)

    def is_proven(self) -> bool:
        """Whether a number of the sample shows what the decimal mark is: 0,5 or 1,25 or 1234,567."""
        mark, ambiguous = self.dialect.decimal, _AMBIGUOUS[self.dialect.decimal]
        return any(
            mark in f and self.dialect.plain(f) is not None and not ambiguous.fullmatch(f.strip())
            for fields in self.rows.values()
            for f in fields
        )

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
    return sorted(sure or fits, key=lambda f: -len(f.rows))


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
