"""Worksheets of an ``.xlsx`` file, opened as if a stranger had sent it.

Only cells are read: no formula is computed, no link is followed. Sizes are checked in the directory of
the archive before anything is inflated, and the XML may hold no document type or entity. It needs
no other package than ``defusedxml``.
"""

from __future__ import annotations

import datetime as dt
import io
import re
from collections.abc import Collection, Iterator
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeAlias

import numpy as np

from metrosep.core.errors import FormatMismatchError
from metrosep.io.archive import Archive, xml_of
from metrosep.io.source import LOCAL_HEADER, RawFile

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

Cells: TypeAlias = list[tuple[int, dict[str, float | str]]]
"""Number of each row, from 1, and its cells by column letter; empty cells are left out."""

_MAX_MEMBER = 2**24
"""Largest size in bytes of an XML member beside the worksheets."""
_MAX_SHEET = 2**29
ROWS, COLUMNS = 2**20, 2**14
"""Rows and columns of the largest worksheet there is."""
PIECE = 2**16
_PLACE = re.compile(r"([A-Z]{1,3})(\d{1,7})")
NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
_BUILT_IN: Final = {
    **dict.fromkeys((14, 15, 16, 17, *range(27, 37), *range(50, 59)), "d"),
    **dict.fromkeys((18, 19, 20, 21, 45), "h"),
    22: "dh",
    46: "[h]",
    47: "h",
}
"""Formats that every workbook has and that show a date (d), a time of day (h), or a duration."""


class Cell(NamedTuple):
    """What a cell holds, as the file has it."""

    column: int  # from 1
    kind: str  # n number, s shared text, str, inlineStr, b, e error, d date
    style: int
    text: str
    unsolved: bool  # a formula without its result


class _Archive(Archive):
    suspect_bytes, suspect_ratio, may_be_trusted = 2**20, 400, False


class Workbook:
    """Worksheets of a file, by name."""

    def __init__(self, file: RawFile) -> None:
        if not file.head.startswith(LOCAL_HEADER):
            raise FormatMismatchError(
                f"{file.path}: is not a workbook: expected 50 4b 03 04 at offset 0, found "
                f"{file.head[:4].hex(' ')}; leave out format= to have it recognised"
            )
        self._archive = _Archive(file, "the workbook", "save it again as .xlsx")
        self.corrupt = self._archive.corrupt
        self.hidden: set[str] = set()
        self.unseen: list[tuple[int, int]] = []  # hidden columns of the sheet that was read last
        self._sheets = self._list_sheets()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the worksheets in their order."""
        return tuple(self._sheets)

    def cells(self, sheet: str, columns: Collection[str] = (), stop: int | None = None) -> Cells:
        """Return the cells of a worksheet that hold a number or a text."""
        rows: Cells = []
        for number, row in self.rows(sheet):
            found: dict[str, float | str] = {}
            for cell in row:
                name = letters(cell.column)
                if cell.kind == "e" or (columns and name not in columns):
                    continue
                text = self.text_of(cell, sheet)
                if text:
                    found[name] = float(text) if cell.kind == "n" else text
            if found:
                rows.append((number, found))
            if len(rows) == stop:
                break
        return rows

    def rows(self, sheet: str) -> Iterator[tuple[int, list[Cell]]]:
        """Yield the number of each row, from 1, and its cells that hold something."""
        if sheet not in self._sheets:
            raise self.corrupt(f"has no worksheet {sheet!r}")
        member = self._sheets[sheet]
        data = self._archive.read(member, limit=_MAX_SHEET)
        parser = _SheetParser()
        before = 0
        with xml_of(self._archive, member):
            for start in range(0, max(len(data), 1), PIECE):
                parser.feed(data[start : start + PIECE], last=start + PIECE >= len(data))
                for number, row in parser.taken():
                    columns = [c.column for c in row]
                    if not before < number <= ROWS:
                        raise self.corrupt(f"has a row {number} behind row {before}", member)
                    if columns and not 0 < min(columns) <= max(columns) <= COLUMNS:
                        raise self.corrupt(f"has a cell without a place in row {number}", member)
                    before = number
                    yield number, row
        self.merged, self.n_hidden_rows = parser.merged, parser.n_hidden
        self.unseen = parser.unseen

    def text_of(self, cell: Cell, sheet: str) -> str:
        """Return what a cell holds as text: a number as it is written, an error by its sign."""
        if cell.kind == "s":
            shared = self._shared
            try:
                return shared[_index(cell.text)] if cell.text else ""
            except (ValueError, IndexError):
                raise self._bad(cell, sheet, "that is not a value") from None
        if cell.kind != "n" or not cell.text:
            return cell.text
        if NUMBER.fullmatch(cell.text) is None:
            raise self._bad(cell, sheet, "that is not a value")
        if not np.isfinite(float(cell.text)):
            raise self._bad(cell, sheet, "that is not finite")
        return cell.text

    def _bad(self, cell: Cell, sheet: str, what: str) -> Exception:
        return self.corrupt(f"has a cell {cell.text[:20]!r} {what}", self._sheets[sheet])

    def moment(self, cell: Cell, text: str) -> str:
        """Return a number that is shown as a date, a time or a duration as such, else the number."""
        shown = self._shown.get(cell.style, "")
        value = float(text) if shown else -1.0
        if value < 0.0 or value >= _LAST_DAY:
            return text
        micros = round(value * 86400e6)
        if shown == "[h]" or value < 1.0:
            seconds, rest = divmod(micros, 10**6)
            return f"{seconds // 3600:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d}.{rest:06d}"
        first = dt.datetime(1904, 1, 1) if self._since_1904 else _FIRST_DAY
        if (
            not self._since_1904 and value < 60.0
        ):  # the 29 February 1900, which never was, is day 60
            first += dt.timedelta(days=1)
        when = first + dt.timedelta(microseconds=micros)
        is_day = shown == "d" and micros % 86400_000_000 == 0
        return when.date().isoformat() if is_day else when.isoformat(timespec="microseconds")

    @cached_property
    def _shared(self) -> list[str]:
        items = self._elements("xl/sharedStrings.xml", "si")
        return ["".join(_spoken(item)) for item in items]

    @cached_property
    def _shown(self) -> dict[int, str]:
        """What the styles show that is no plain number: a date, a time of day or a duration."""
        if "xl/styles.xml" not in self._archive.members:
            return {}
        codes: dict[int, str] = dict(_BUILT_IN)
        for e in self._elements("xl/styles.xml", "numFmt"):
            codes[int(e.get("numFmtId", "0"))] = _shows(e.get("formatCode", ""))
        styles: dict[int, str] = {}
        for formats in self._elements("xl/styles.xml", "cellXfs"):
            for k, e in enumerate(formats):
                styles[k] = codes.get(int(e.get("numFmtId", "0")), "")
        return styles

    def _list_sheets(self) -> dict[str, str]:
        targets = {
            e.get("Id", ""): e.get("Target", "")
            for e in self._elements("xl/_rels/workbook.xml.rels", "Relationship")
            if e.get("TargetMode", "Internal") == "Internal"
        }
        found = self._elements("xl/workbook.xml", "workbookPr")
        self._since_1904 = any(e.get("date1904") in ("1", "true") for e in found)
        sheets: dict[str, str] = {}
        for element in self._elements("xl/workbook.xml", "sheet"):
            ids = [v for k, v in element.attrib.items() if k.rsplit("}", 1)[-1] == "id"]
            target = targets.get(ids[0] if ids else "", "")
            member = target[1:] if target.startswith("/") else f"xl/{target}"
            if member in self._archive.members and member.startswith("xl/worksheets/"):
                name = element.get("name", "")
                sheets[name] = member
                if element.get("state", "visible") != "visible":
                    self.hidden.add(name)
        if not sheets:
            raise self.corrupt("has no worksheet")
        return sheets

    def _elements(self, member: str, tag: str) -> Iterator[Element]:
        """Yield the elements of one name, each emptied after use."""
        from defusedxml.ElementTree import iterparse

        stream = io.BytesIO(self._archive.read(member, limit=_MAX_MEMBER))
        with xml_of(self._archive, member):
            for _, element in iterparse(stream, forbid_dtd=True):
                if _tag(element.tag) == tag:
                    yield element
                    element.clear()


_FIRST_DAY = dt.datetime(1899, 12, 30)
_LAST_DAY = 2_900_000.0
"""Day of the year 9840; later ones are no dates."""


def letters(column: int) -> str:
    """Return the letters of a column of a worksheet.

    Examples
    --------
    >>> letters(1), letters(28)
    ('A', 'AB')
    """
    text = ""
    while column > 0:
        column, rest = divmod(column - 1, 26)
        text = chr(65 + rest) + text
    return text


def _shows(code: str) -> str:
    """Return what a format shows: d a date, h a time of day, dh both, [h] a duration, or nothing of these."""
    plain = re.sub(r'"[^"]*"|\\.|_.|\*.', "", code.split(";", maxsplit=1)[0]).lower()
    if re.search(r"\[(?:h+|m+|s+)\]", plain):
        return "[h]"
    plain = re.sub(r"\[[^\]]*\]", "", plain)
    if "general" in plain or re.search("[0#?@]", re.sub(r"(?<=s)[.,]0+", "", plain)):
        return ""
    has_time = "h" in plain or "s" in plain
    has_date = "y" in plain or "d" in plain or ("m" in plain and not has_time)
    return ("d" if has_date else "") + ("h" if has_time else "")


class _SheetParser:
    """Takes the XML of a worksheet piece by piece and gives its whole rows."""

    def __init__(self) -> None:
        from xml.parsers import expat

        self._parser = expat.ParserCreate(namespace_separator="}")
        self._parser.buffer_text = True
        self._parser.StartElementHandler = self._start
        self._parser.EndElementHandler = self._end
        self._parser.CharacterDataHandler = self._characters
        self._parser.StartDoctypeDeclHandler = self._refuse
        self.merged: list[str] = []
        self.n_hidden = 0
        self.unseen: list[tuple[int, int]] = []  # first and last of hidden columns
        self._rows: list[tuple[int, list[Cell]]] = []
        self._row: list[Cell] | None = None
        self._number = self._column = self._style = 0
        self._kind, self._text, self._formula, self._valued = "n", "", False, False
        self._in_cell = self._taking = False

    def feed(self, data: bytes, *, last: bool) -> None:
        self._parser.Parse(data, last)

    def taken(self) -> list[tuple[int, list[Cell]]]:
        """Return the rows that are complete."""
        rows, self._rows = self._rows, []
        return rows

    def _refuse(self, name: str, system: str | None, public: str | None, _: int) -> None:
        from defusedxml import DTDForbidden

        raise DTDForbidden(name, system, public)

    def _start(self, name: str, attributes: dict[str, Any]) -> None:
        tag = _tag(name)
        if tag == "row":
            self._row, self._column = [], 0
            self._number = _index(attributes.get("r", str(self._number + 1)))
            self.n_hidden += attributes.get("hidden") in ("1", "true")
        elif tag == "c" and self._row is not None:
            place = attributes.get("r")
            found = None if place is None else _PLACE.fullmatch(place)
            self._column = (
                self._column + 1 if place is None else column_number(found[1] if found else "")
            )
            self._style = _index(attributes.get("s", "0"))
            self._kind, self._text = attributes.get("t", "n"), ""
            self._formula = self._valued = False
            self._in_cell = True
            if found is not None and int(found[2]) != self._number:
                self._column = 0  # a cell of another row has no place in this one
        elif self._in_cell and tag in ("v", "t"):
            self._taking = self._valued = True
        elif self._in_cell and tag == "f":
            self._formula = True
        elif self._in_cell and tag == "rPh":
            self._in_cell = False  # how a text is spoken, behind the text itself
        elif tag == "col" and attributes.get("hidden") in ("1", "true"):
            span = (_index(attributes.get(k, "0")) for k in ("min", "max"))
            self.unseen.append((next(span), next(span)))
        elif tag == "mergeCell":
            self.merged.append(str(attributes.get("ref", "")))

    def _end(self, name: str) -> None:
        tag = _tag(name)
        if tag in ("v", "t"):
            self._taking = False
        elif tag == "c" and self._row is not None:
            self._in_cell = False
            # a formula may have the empty text as its result
            solved = self._text or (self._kind == "str" and self._valued)
            if self._text or (self._formula and not solved):
                cell = Cell(self._column, self._kind, self._style, self._text, not solved)
                self._row.append(cell)
        elif tag == "row" and self._row is not None:
            self._rows.append((self._number, self._row))
            self._row = None

    def _characters(self, data: str) -> None:
        if self._taking:
            self._text += data


def _spoken(item: Element) -> Iterator[str]:
    """Yield the texts of a shared text without those that say how it is spoken."""
    for part in item:
        if _tag(part.tag) == "t":
            yield part.text or ""
        elif _tag(part.tag) == "r":
            yield from (t.text or "" for t in part if _tag(t.tag) == "t")


def _tag(name: object) -> str:
    return str(name).rsplit("}", 1)[-1]


def column_number(text: str) -> int:
    """Return the number of a column from its letters, 0 for none."""
    number = 0
    for letter in text:
        number = 26 * number + ord(letter) - 64
    return number


def _index(text: str) -> int:
    """Return a place in a list; a negative one would count from its end."""
    if not text.isdecimal():
        raise ValueError(text)
    return int(text)
