"""The options by which a caller describes the layout of a file: declared once, taken by every door."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from metrosep.core.errors import ReadError

TEXT_OPTIONS: Final = {
    "separator": "Column separator, if it cannot be detected: tab, space, comma, semicolon.",
    "decimal": "Decimal mark, if it cannot be detected: . or ,",
    "thousands": "Mark between groups of three digits, where numbers have one: , or . or '",
    "encoding": "Encoding of the text, if it cannot be detected: utf-16.",
    "comment": "Text at the start of lines to skip, if it is not # % ! or //",
    "skip_rows": "Number of lines to skip at the start.",
    "skip_lines": "Lines to skip, by number: 31,40-52.",
    "missing": "Numbers or words for 'not measured': -9999; none where such numbers are readings.",
    "sheet": "Worksheet, table or array of a file that holds several, by its name.",
}
"""Names and help of the options of every command and function that reads text."""

ROW_ORDERS: Final = ("smallest y first", "top row first")
"""Order of the rows of a map in a file; the second is turned on reading."""

_RANGE = re.compile(r"\s*(\d+)(?:\s*-\s*(\d+))?\s*")
_NO_MARKER = frozenset({"", "()", "none"})


@dataclass(frozen=True, slots=True)
class TextOptions:
    """How a caller describes a text."""

    separator: str | None = None  # as in `TEXT_OPTIONS`; found from the content if omitted
    decimal: str | None = None
    thousands: str | None = None
    encoding: str | None = None
    comment: str | None = None
    skip_rows: int = 0  # lines to leave out at the start
    skip_lines: tuple[range, ...] = ()  # of range: lines to leave out by number, from 1
    # or str: numbers and words for "not measured"; empty: no number means that
    missing: tuple[float | str, ...] | None = None
    sheet: str | None = None  # which of the tables of a workbook, a database or an archive

    def sets_aside(self, line: int) -> bool:
        """Return whether the caller leaves out a line."""
        return line <= self.skip_rows or any(line in r for r in self.skip_lines)

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> TextOptions:
        """Return the options of a call, checked; numbers may be text, as a person types them."""
        known = {k: v for k, v in given.items() if v is not None}
        unknown = [k for k in known if k not in TEXT_OPTIONS]
        if unknown:
            raise ReadError(
                f"no option {unknown[0]!r} for the layout of a text; there are {', '.join(TEXT_OPTIONS)}"
            )
        if known.get("thousands") not in (None, ",", ".", "'"):
            raise ReadError(
                f"thousands {known['thousands']!r} is not known; use ',' or '.' or \"'\""
            )
        if known.get("thousands") is not None and known["thousands"] == known.get("decimal"):
            raise ReadError("thousands and decimal are the same mark; give two different marks")
        if "sheet" in known and not isinstance(known["sheet"], str):
            raise ReadError(f"sheet is {known['sheet']!r}; give the name of a worksheet or table")
        if "skip_rows" in known:
            known["skip_rows"] = _count(known["skip_rows"])
        if "skip_lines" in known:
            known["skip_lines"] = _lines(known["skip_lines"])
        if "missing" in known:
            known["missing"] = _markers(known["missing"])
        return cls(**known)


def _count(value: Any) -> int:
    text = str(value).strip()
    if isinstance(value, bool) or not text.isdecimal():
        raise ReadError(f"skip_rows is {value!r}; give how many lines to leave out, such as 2")
    return int(text)


def _lines(value: Any) -> tuple[range, ...]:
    items: Iterable[Any] = (
        value.split(",")
        if isinstance(value, str)
        else [value]
        if isinstance(value, int)
        else value
    )
    found = []
    for item in items:
        match = _RANGE.fullmatch(str(item))
        if match is None or int(match.group(1)) < 1:
            raise ReadError(
                f"skip_lines has {item!r}; give numbers of lines, from 1, such as '31,40-52'"
            )
        first, last = int(match.group(1)), int(match.group(2) or match.group(1))
        found.append(range(first, last + 1))
    return tuple(found)


def _markers(value: Any) -> tuple[float | str, ...]:
    if isinstance(value, str):
        value = [] if value.strip().lower() in _NO_MARKER else value.split(",")
    elif isinstance(value, int | float):
        value = [value]
    markers: list[float | str] = []
    for item in value:
        try:
            markers.append(float(item))
        except (TypeError, ValueError):
            markers.append(str(item).strip().lower())
    return tuple(markers)


def accepted_options(function: Callable[..., Any]) -> list[str]:
    """Return the names of the arguments of a reader."""
    names: list[str] = []
    for name, parameter in inspect.signature(function).parameters.items():
        is_text = parameter.kind is inspect.Parameter.VAR_KEYWORD
        names += list(TEXT_OPTIONS) if is_text else [name]
    return names
