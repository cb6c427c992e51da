"""Physical lines of a text: those drawn for a person, how many there are of each class, what is refused."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np

from metrosep.core.errors import AmbiguousFormatError, CorruptFileError
from metrosep.io.source import RawFile
from metrosep.io.text.dialect import NUMBER_LIKE, Layout, header_unit, is_comment, n_used
from metrosep.io.text.encoding import NO_READING, may_be_error_cell

_LISTED: Final = 100
"""Lines of a class that are listed with their text."""


class Ledger:
    """How many lines of each class there are, and which they are."""

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()
        self._listed: dict[str, list[tuple[int, str]]] = {}
        self._ranges: dict[str, list[list[int]]] = {}

    def add(self, kind: str, number: int, line: str) -> None:
        """Enter one line of a class that is listed."""
        self._counts[kind] += 1
        self.note(kind, number, line)

    def note(self, kind: str, number: int, line: str) -> None:
        """List a line, or what stands in one that is counted elsewhere."""
        listed = self._listed.setdefault(kind, [])
        if len(listed) < _LISTED:
            listed.append((number, line.strip()[:200]))
        ranges = self._ranges.setdefault(kind, [])
        if ranges and ranges[-1][1] == number - 1:
            ranges[-1][1] = number
        else:
            ranges.append([number, number])

    def count(self, kind: str, n: int) -> None:
        """Enter lines of a class that is only counted: data, blank."""
        self._counts[kind] += n

    def __getitem__(self, kind: str) -> int:
        return self._counts[kind]

    @property
    def total(self) -> int:
        """Lines of all classes."""
        return sum(self._counts.values())

    def texts(self, kind: str) -> list[str]:
        """Return the texts of the listed lines of a class."""
        return [text for _, text in self._listed.get(kind, [])]

    def first(self, kind: str) -> tuple[int, str]:
        """Return number and text of the first line of a class."""
        return self._listed[kind][0]

    def to_dict(self) -> dict[str, Any]:
        """Return the count of each class and, of all but data and blank, numbers and texts."""
        listed = {
            kind: {
                "numbers": ", ".join(
                    f"{a}" if a == b else f"{a}-{b}" for a, b in ranges[:_LISTED]
                ),
                "texts": tuple(text for _, text in self._listed[kind]),
            }
            for kind, ranges in self._ranges.items()
        }
        return {"total": self.total, **self._counts, "listed": listed}


def lines_of_field(lines: Sequence[str], is_row: Callable[[str], object]) -> list[str]:
    """Return the lines behind the first that a field in quotes takes, none where the quotes do not close.

    A line that could be a row of the table, up to the quote that closes the field, may not be swallowed.
    """
    for k, line in enumerate(lines[1:_FIELD_LINES], start=1):
        if is_row(line.partition('"')[0]):
            return []
        if line.count('"') % 2:
            return list(lines[1 : k + 1])
    return []


def may_go_on(lines: Sequence[str], is_row: Callable[[str], object]) -> bool:
    """Return whether a field in quotes that does not close in the last lines of a part may close behind them."""
    return len(lines) < _FIELD_LINES and not any(is_row(s.partition('"')[0]) for s in lines[1:])


_FIELD_LINES = 12
"""Lines of the longest field in quotes."""


def refuse_quotes(file: RawFile, number: int, line: str, mark: str = "") -> None:
    """Refuse a line whose double quotes do not pair up, or of which one ends within a field."""
    problem = "the quotes do not pair up" if line.count('"') % 2 else ""
    if len(mark) == 1 and mark != " " and not problem:
        try:
            list(csv.reader([line], delimiter=mark, skipinitialspace=True, strict=True))
        except csv.Error:
            problem = "something stands between a quote and the next separator"
    if problem:
        raise file.corrupt(
            problem,
            field=f"line {number}",
            found=repr(line[:40]),
            hint=f"correct that line, or leave it out with {file.without_lines(number)}",
        )


def one_or_thousand(
    file: RawFile, line: int, field: str, name: str, mark: str
) -> AmbiguousFormatError:
    """Return the error about a number of which nothing shows whether its mark is one of thousands."""
    small, large = (re.sub(r"\D", "", p) for p in field.split(mark, 1))
    other = "." if mark == "," else ","
    return AmbiguousFormatError(
        f"{file.path}: line {line}: column {name!r} holds {field[:40]!r}, which is {small}.{large} or "
        f"{small}{large}, and no number of the file shows which; give decimal='{mark}', or thousands='{mark}' "
        f"with decimal='{other}'"
    )


_ODD_MINUS = re.compile(
    r"\(\s*([\d.,]+)\s*\)|([\d.,]+)\s*[-\u2212]|[-\u2212\u2013\u00ad]\s*([\d.,]+)"
)
"""A number below zero as bookkeepers, word processors and typesetters write it."""


def bad_field(
    file: RawFile, line: int, field: str, where: str, what: str = "number"
) -> CorruptFileError:
    """Return the error about a field that is not a number, or whatever the others are."""
    grouped = re.fullmatch(r"[+-]?\d{1,3}(?:([.,'])\d{3})+(?:[.,]\d+)?", field)
    if below := _ODD_MINUS.fullmatch(field):
        return file.corrupt(
            f"{where} holds a number with its minus behind it, apart from it, or in brackets for a minus",
            field=f"line {line}",
            found=repr(field[:40]),
            hint=f"write it as -{next(filter(None, below.groups()))}, and all others alike",
        )
    options = f"{file.also_missing(field[:40])} if it means not measured, {file.without_lines(line)} to leave the line out"
    if grouped:
        options = f'thousands="{grouped.group(1)}" if its digits are in groups, {options}'
    return file.corrupt(
        f"{where} holds something that is not a {what}",
        field=f"line {line}",
        expected=f"a {what}, or an empty field where nothing was measured",
        found=repr(field[:40]),
        hint=f"correct that line, or give {options}",
    )


_DIGITS = re.compile(r"\d+")


def stray_text(
    file: RawFile, layout: Layout, line: str, number: int, below: Sequence[str]
) -> CorruptFileError:
    """Return the error about a line of words between rows, which may name the columns of another table."""
    fields = [f.strip() for f in layout.dialect.split([line])[0]]
    if len(fields) == layout.n and all(f[:1].isalpha() for f in fields):
        n = next((k for k, text in enumerate(below) if not text.strip()), len(below))
        if any(header_unit(f)[1] for f in fields):
            return file.corrupt(
                "another table begins below the rows of the first one",
                field=f"line {number}",
                found=repr(line.strip()[:60]),
                hint=f"leave out what stands above it with skip_rows='{number - 1}', or, if the first table is wanted, "
                f"leave out this one with {file.without_lines(*range(number, number + n + 1))}",
            )
    shape = _DIGITS.sub(
        "0", line.strip()
    )  # also Run 3, Run 4: each would be the next to be refused
    alike = [k for k, t in enumerate(below, number + 1) if _DIGITS.sub("0", t.strip()) == shape]
    also = f" (and {len(alike)} more like it)" if alike else ""
    return file.corrupt(
        "a line of text stands within the table",
        field=f"line {number}",
        expected=f"{layout.n} fields ({layout.dialect})",
        found=repr(line.strip()[:60]) + also,
        hint=f"if it may be omitted, give {file.without_lines(number, *alike)}; else split the file there",
    )


def row_in_comment(fields: Sequence[str], layout: Layout) -> bool:
    """Whether the fields of a comment are those of a row, with a number where one belongs."""
    if len(fields) == layout.n == 1 and may_be_error_cell(fields[0].strip()):
        return True
    first = fields[0].strip().lstrip('#%!/; "')
    own = [first or (fields[0] if layout.labels[0] else ""), *fields[1:]]
    if not own[0] and (len(fields) > layout.n or layout.dialect.separator in {" ", ", "}):
        del own[0]  # elsewhere the mark alone takes the place of a number
    kinds = [
        "number" if layout.dialect.plain(f) is not None else f.strip().lower() in NO_READING
        for f, label in zip(own, layout.labels, strict=False)
        if not label
    ]
    return len(own) >= layout.n == n_used(own) and all(kinds) and "number" in kinds


def cut_off(file: RawFile, content: str, row: str, line: int) -> list[str]:
    """Return the warning about a last row without a line end; one that is visibly cut is refused."""
    lengths = [len(text) for text in content[-_TAIL:].split("\n")[1:-1] if text.strip()]
    if lengths and 2 * len(row.strip()) < float(np.median(lengths)):
        raise file.corrupt(
            "the file ends in the middle of a row",
            field=f"line {line} ({row.strip()[:60]!r})",
            hint=f"copy the file again, or leave that line out with {file.without_lines(line)}",
        )
    return [
        (
            f"line {line}, the last one, has no line end: whether its last number is whole cannot be seen; "
            "compare it with the source of the file"
        )
    ]


_TAIL = 5000
"""Characters of the last rows, whose lengths show whether the last one is whole."""


# ---- tables as they are drawn for a person: frames, rules between rows, rows named #1, #2, #3 ----

_NAMED_BY_NUMBER = re.compile(r"\s*\"?#(\d+)\"?[;,\t| ]")


def is_named_by_number(line: str) -> bool:
    """Return whether a line begins with the number of a row, such as #1, and something follows."""
    return _NAMED_BY_NUMBER.match(line) is not None


def are_numbered_rows(lines: Sequence[str]) -> bool:
    """Return whether lines that begin like comments are the rows: #1, #2, #3, and no other line is one."""
    found = [int(m[1]) for m in map(_NAMED_BY_NUMBER.match, lines) if m is not None]
    others = (s for s in lines if not is_comment(s))
    return (
        len(found) >= _FEWEST_NUMBERED
        and found == list(range(found[0], found[0] + len(found)))
        and not any(NUMBER_LIKE.match(s.lstrip(' "')) for s in others)
    )


_FEWEST_NUMBERED = 3


def are_rows_like_comments(lines: Sequence[str]) -> bool:
    """Return whether all rows below names begin like a comment: their first field is a name such as #1."""
    names, *rest = [line for line in lines if line.strip()] or [""]
    mark = max("\t;|,", key=names.count)
    n = names.count(mark)
    alike = (is_comment(line) and line.count(mark) == n for line in rest)
    return n > 0 and len(rest) > n and not is_comment(names) and all(alike)


_CROSSED = re.compile(r"\s*[+|]?(?:[-=:]{2,}\+)*[-=:]{2,}[+|]?\s*")
_DRAWN = re.compile(r"(?=.*([-=_])\1{2})[-=_|+*:\s]+")
_BOX = str.maketrans(
    {chr(c): "+" for c in range(0x2500, 0x2580)}
    | dict.fromkeys("\u2500\u2501\u2504\u2505\u2508\u2509\u254c\u254d\u2550", "-")
    | dict.fromkeys("\u2502\u2503\u2506\u2507\u250a\u250b\u254e\u254f\u2551", "|")
)
"""Lines that are drawn with characters of their own, as with - | and +."""
_HAS_BOX = re.compile("[\u2500-\u257f]")
_FRAMED = re.compile(r"(?m)^[ \t]*\|(.*)\|[ \t]*$")


def is_rule(line: str) -> bool:
    """Return whether a line is drawn between rows, such as +----+----+."""
    return "+" in line and _CROSSED.fullmatch(line) is not None


def is_drawn(line: str) -> bool:
    """Return whether a line holds nothing but what lines are drawn with, such as ----- or |---|:---:|.

    Among rows it may be one of words for "not measured".
    """
    return _DRAWN.fullmatch(line) is not None


def unframed(text: str, head: str) -> str:
    """Return lines without the bars left and right of them, where a frame was drawn in the head of the text.

    The names show it, or a rule above rows without names: rows alone may begin and end with empty cells.
    """
    if _HAS_BOX.search(head):
        text, head = text.translate(_BOX), head.translate(_BOX)
    if "|" not in head:
        return text
    every = head.split("\n")
    lines = [s for s in every if "|" in s and not is_comment(s)]
    framed = sum(_FRAMED.fullmatch(s) is not None for s in lines)
    if framed < _FEWEST_FRAMED or framed < (1.0 - _BARE) * len(lines):
        return text
    lines = [s for s in lines if s.strip("|-=:+ \t")]
    first = next((k for k, s in enumerate(lines) if _may_be_row(s)), 0)
    if first:
        is_drawn = _FRAMED.fullmatch(lines[first - 1]) is not None
    else:
        is_drawn = any(is_rule(s) and s.strip()[0] in "+|" for s in every)
    return _FRAMED.sub(r"\1", text) if is_drawn else text


def _may_be_row(line: str) -> bool:
    """Whether a line between bars holds a number, or nothing but words for "not measured"."""
    fields = [f.strip().lower() for f in line.split("|")]
    return any(map(NUMBER_LIKE.fullmatch, fields)) or all(f in NO_READING for f in fields)


_FEWEST_FRAMED, _BARE = 3, 0.1
"""Lines with a frame that show it, and the share of lines that may lack theirs."""
