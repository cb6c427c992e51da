"""Worksheets of an OpenDocument file (``.ods``), opened as if a stranger had sent it.

All sheets lie in one XML member, whose cells state the type of their value. Repeated rows and
columns are spread out, notes and tracked changes left out; no formula is computed. What a sheet gives is
what `metrosep.io.containers.workbook.Workbook` gives of ``.xlsx``.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import numpy as np

from metrosep.core.errors import UnsupportedFeatureError
from metrosep.io.archive import Archive, xml_of
from metrosep.io.containers.workbook import COLUMNS, NUMBER, PIECE, ROWS, Cell, letters
from metrosep.io.source import RawFile

CONTENT = "content.xml"
_MAX_CONTENT = 2**29
_MAX_CELLS = 2**26
_NUMBERS = frozenset({"float", "percentage", "currency"})
_KINDS = {"date": "d", "time": "d", "boolean": "b", "string": "str"}
_ERROR = re.compile(r"Err:\d+|#(?:[^\W\d]+[!?]|DIV/0!|N/?A|NV)")
"""An error as it is shown; #1 and #A are a number and a name in a format of their own."""
_DURATION = re.compile(r"(-?)P(?:(\d+)D)?T(?:(\d+)H)?(?:(\d+)M)?(?:(\d+)([.,]\d+)?S)?")


class _Archive(Archive):
    suspect_bytes, suspect_ratio, may_be_trusted = 2**20, 400, False


class OpenDocument:
    """Worksheets of a file, by name."""

    def __init__(self, file: RawFile) -> None:
        self._archive = _Archive(file, "the OpenDocument file", "save it again as .ods or .xlsx")
        self.corrupt = self._archive.corrupt
        manifest = "META-INF/manifest.xml"
        if manifest in self._archive.members and b"encryption-data" in self._archive.read(
            manifest, limit=2**24
        ):
            raise UnsupportedFeatureError(
                f"{file.path}: is locked with a password; save it without one"
            )
        self._sheets = _Content(self._archive)
        self.hidden = self._sheets.hidden
        self.merged: list[str] = []
        self.n_hidden_rows = 0
        self.unseen: list[tuple[int, int]] = []

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the worksheets in their order."""
        return tuple(self._sheets.rows)

    def rows(self, sheet: str) -> Iterator[tuple[int, list[Cell]]]:
        """Yield the number of each row, from 1, and its cells that hold something."""
        self.merged, self.n_hidden_rows = self._sheets.merged[sheet], self._sheets.n_hidden[sheet]
        self.unseen = self._sheets.unseen[sheet]
        yield from self._sheets.rows[sheet]

    def text_of(self, cell: Cell, sheet: str) -> str:
        """Return what a cell holds as text: a number as it is written, an error by its sign."""
        if cell.kind != "n" or not cell.text:
            return cell.text
        if NUMBER.fullmatch(cell.text) is None or not np.isfinite(float(cell.text)):
            raise self.corrupt(f"has a cell {cell.text[:20]!r} that is not a number", sheet)
        return cell.text

    def moment(self, cell: Cell, text: str) -> str:
        """Return a number as it is: dates and times have a type of their own."""
        return text


class _Content:
    """Takes the XML of all sheets piece by piece."""

    def __init__(self, archive: Archive) -> None:
        from xml.parsers import expat

        self._archive = archive
        self.rows: dict[str, list[tuple[int, list[Cell]]]] = {}
        self.merged: dict[str, list[str]] = {}
        self.n_hidden: dict[str, int] = {}
        self.unseen: dict[str, list[tuple[int, int]]] = {}  # first and last of hidden columns
        self.hidden: set[str] = set()
        self._unseen: set[str] = set()  # styles of tables that are not shown
        self._style = self._sheet = ""
        self._number = self._column = self._repeated = self._n_cells = 0
        self._row: list[Cell] = []
        self._cell: dict[str, str] | None = None
        self._lines: list[str] = []
        self._aside = 0  # depth within a note, a shape or tracked changes
        self._in_text = False
        parser = expat.ParserCreate(namespace_separator="}")
        parser.buffer_text = True
        parser.StartElementHandler, parser.EndElementHandler = self._start, self._end
        parser.CharacterDataHandler = self._characters
        parser.StartDoctypeDeclHandler = self._refuse
        data = archive.read(CONTENT, limit=_MAX_CONTENT)
        with xml_of(archive, CONTENT):
            for start in range(0, max(len(data), 1), PIECE):
                parser.Parse(data[start : start + PIECE], start + PIECE >= len(data))

    def _refuse(self, name: str, system: str | None, public: str | None, _: int) -> None:
        from defusedxml import DTDForbidden

        raise DTDForbidden(name, system, public)

    def _start(self, name: str, attributes: dict[str, Any]) -> None:
        tag = _tag(name)
        if self._aside or tag in _ASIDE:
            self._aside += 1
            return
        own = {_tag(k): str(v) for k, v in attributes.items()}
        if tag == "style":
            self._style = own.get("name", "")
        elif tag == "table-properties" and own.get("display") == "false":
            self._unseen.add(self._style)
        elif tag == "table":
            self._open(own)
        elif tag == "table-column" and self._sheet:
            first = self._column + 1
            self._column += _count(own, "number-columns-repeated")
            if own.get("visibility", "visible") != "visible":
                self.unseen[self._sheet].append((first, self._column))
        elif tag == "table-row" and self._sheet:
            self._row, self._column = [], 0
            self._repeated = _count(own, "number-rows-repeated")
            if own.get("visibility", "visible") != "visible":
                self.n_hidden[self._sheet] += self._repeated
        elif tag == "table-cell" and self._sheet:
            self._cell, self._lines = own, []
        elif tag == "covered-table-cell":
            self._column += _count(own, "number-columns-repeated")
        elif self._cell is not None:
            if tag == "p":
                self._lines.append("")
                self._in_text = True
            elif self._in_text and tag in ("s", "tab", "line-break"):
                self._lines[-1] += " " * min(_count(own, "c"), 1000)

    def _open(self, own: dict[str, str]) -> None:
        self._sheet = own.get("name", "") or f"sheet {len(self.rows) + 1}"
        if self._sheet in self.rows:
            raise self._archive.corrupt(f"has two worksheets {self._sheet!r}", CONTENT)
        self.rows[self._sheet], self.merged[self._sheet], self.unseen[self._sheet] = [], [], []
        self.n_hidden[self._sheet] = self._number = self._column = 0
        if own.get("style-name") in self._unseen:
            self.hidden.add(self._sheet)

    def _end(self, name: str) -> None:
        if self._aside:
            self._aside -= 1
            return
        tag = _tag(name)
        if tag == "p":
            self._in_text = False
        elif tag == "table-cell" and self._cell is not None:
            self._close_cell(self._cell)
            self._cell = None
        elif tag == "table-row" and self._sheet:
            self._close_row()
        elif tag == "table":
            self._sheet = ""

    def _close_cell(self, own: dict[str, str]) -> None:
        n = _count(own, "number-columns-repeated")
        cell = _cell_of(own, " ".join(self._lines).strip(), self._column + 1)
        if self._column + n > COLUMNS and cell is not None:
            raise self._archive.corrupt("has a cell beyond the last column", self._sheet)
        wide, high = (_count(own, f"number-{k}-spanned") for k in ("columns", "rows"))
        if cell is not None and wide * high > 1:
            first, last = letters(cell.column), letters(cell.column + wide - 1)
            row = self._number + 1
            self.merged[self._sheet].append(f"{first}{row}:{last}{row + high - 1}")
        if cell is not None:
            self._row += [cell._replace(column=self._column + k) for k in range(1, n + 1)]
        self._column += n

    def _close_row(self) -> None:
        n, row = self._repeated, self._row
        if row:
            self._n_cells += n * len(row)
            if self._number + n > ROWS or self._n_cells > _MAX_CELLS:
                raise self._archive.corrupt(
                    f"has more than {ROWS} rows or {_MAX_CELLS} cells", self._sheet
                )
            self.rows[self._sheet] += [(self._number + k, row) for k in range(1, n + 1)]
        self._number += n

    def _characters(self, data: str) -> None:
        if self._in_text and not self._aside:
            self._lines[-1] += data


_ASIDE = frozenset({"annotation", "tracked-changes", "shapes", "frame", "custom-shape"})
"""Elements whose texts and tables are no cells."""


def _cell_of(own: dict[str, str], shown: str, column: int) -> Cell | None:
    """Return a cell, None for an empty one."""
    kinds = own.get("value-type", "")
    if own.get("calcext-type") == "error" or (kinds and _ERROR.fullmatch(shown)):
        return Cell(column, "e", 0, shown or "#N/A", unsolved=False)
    if kinds in _NUMBERS:
        return Cell(column, "n", 0, own.get("value", ""), unsolved=not own.get("value"))
    text = shown
    if kinds == "date":
        text = own.get("date-value", shown)
    elif kinds == "time":
        text = _clock(own.get("time-value", "")) or shown
    elif kinds == "boolean":
        text = str(int(own.get("boolean-value") == "true"))
    elif kinds == "string":
        text = own.get("string-value", shown)
    unsolved = "formula" in own and not kinds
    if not text and not unsolved:
        return None
    return Cell(column, _KINDS.get(kinds, "str"), 0, text, unsolved)


def _clock(text: str) -> str:
    """Return a duration such as PT11H12M12.5S as 11:12:12.500000, empty for what is none."""
    found = _DURATION.fullmatch(text)
    if found is None or found[1]:
        return ""
    days, hours, minutes, seconds = (int(found[k] or 0) for k in (2, 3, 4, 5))
    micros = round(float(f"0{(found[6] or '.0').replace(',', '.')}") * 1e6)
    total = ((days * 24 + hours) * 60 + minutes) * 60 + seconds + micros // 10**6
    return f"{total // 3600:02d}:{total // 60 % 60:02d}:{total % 60:02d}.{micros % 10**6:06d}"


def _count(own: dict[str, str], key: str) -> int:
    """Return how often something is repeated; ValueError for no positive count."""
    text = own.get(key, "1")
    if not text.isdecimal() or not 0 < int(text) <= 2**31:
        raise ValueError(f"{key} = {text[:20]!r}")
    return int(text)


def _tag(name: str) -> str:
    """Return the name without its namespace; that of a type of LibreOffice's own apart."""
    space, _, local = name.rpartition("}")
    return "calcext-type" if local == "value-type" and "calc" in space else local
