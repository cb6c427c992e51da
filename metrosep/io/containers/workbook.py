"""Worksheets of an ``.xlsx`` file, opened as if a stranger had sent it.

Only cells are read: no formulas, no external links, no styles. Sizes are checked in the directory of
the archive before anything is inflated, and the XML may hold no document type or entity. It needs
no other package than ``defusedxml``.
"""

from __future__ import annotations

import io
import re
from collections.abc import Collection, Iterator
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from metrosep.core.errors import (
    FormatMismatchError,
)
from metrosep.io.archive import LOCAL_HEADER, Archive, xml_of
from metrosep.io.source import RawFile

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

__all__ = ["Cells", "Workbook"]

Cells: TypeAlias = list[tuple[int, dict[str, float | str]]]
"""Number of each row, from 1, and its cells by column letter; empty cells are left out."""

_MAX_MEMBER = 2**24
"""Largest size in bytes of an XML member; 30000 rows take 1 MB."""

_PLACE = re.compile(r"([A-Z]{1,3})(\d{1,7})")


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
        self._corrupt = self._archive.corrupt
        self._sheets = self._list_sheets()
        self._texts: list[str] | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the worksheets in their order."""
        return tuple(self._sheets)

    def cells(self, sheet: str, columns: Collection[str] = (), stop: int | None = None) -> Cells:
        """Return the cells of a worksheet that hold something."""
        if sheet not in self._sheets:
            raise self._corrupt(f"has no worksheet {sheet!r}")
        member = self._sheets[sheet]
        rows: Cells = []
        for row in self._elements(member, "row"):
            number = len(rows) + 1
            found: dict[str, float | str] = {}
            for cell in row:
                place = _PLACE.fullmatch(cell.get("r", ""))
                if place is None:
                    raise self._corrupt("has a cell without a place", member)
                number = int(place[2])
                if not columns or place[1] in columns:
                    value = self._value(cell, member)
                    if value is not None:
                        found[place[1]] = value
            if found:
                rows.append((number, found))
            if len(rows) == stop:
                break
        return rows

    def _value(self, cell: Element, member: str) -> float | str | None:
        kind = cell.get("t", "n")
        text = "".join(t.text or "" for t in cell.iter() if _tag(t) in {"v", "t"})
        if not text or kind == "e":
            return None
        if kind in {"str", "inlineStr", "d", "b"}:
            return text
        try:
            if kind == "s":
                return self._shared()[_index(text)]
            number = float(text)
        except (ValueError, IndexError):
            raise self._corrupt(f"has a cell {text[:20]!r} that is not a value", member) from None
        if not np.isfinite(number):
            raise self._corrupt(f"has a cell {text[:20]!r} that is not finite", member)
        return number

    def _shared(self) -> list[str]:
        if self._texts is None:
            items = self._elements("xl/sharedStrings.xml", "si")
            self._texts = ["".join(item.itertext()) for item in items]
        return self._texts

    def _list_sheets(self) -> dict[str, str]:
        targets = {
            e.get("Id", ""): e.get("Target", "")
            for e in self._elements("xl/_rels/workbook.xml.rels", "Relationship")
            if e.get("TargetMode", "Internal") == "Internal"
        }
        sheets: dict[str, str] = {}
        for element in self._elements("xl/workbook.xml", "sheet"):
            ids = [v for k, v in element.attrib.items() if k.rsplit("}", 1)[-1] == "id"]
            target = targets.get(ids[0] if ids else "", "")
            member = target[1:] if target.startswith("/") else f"xl/{target}"
            if member in self._archive.members and member.startswith("xl/worksheets/"):
                sheets[element.get("name", "")] = member
        if not sheets:
            raise self._corrupt("has no worksheet")
        return sheets

    def _elements(self, member: str, tag: str) -> Iterator[Element]:
        """Yield the elements of one name, each emptied after use."""
        from defusedxml.ElementTree import iterparse

        stream = io.BytesIO(self._archive.read(member, limit=_MAX_MEMBER))
        with xml_of(self._archive, member):
            for _, element in iterparse(stream, forbid_dtd=True):
                if _tag(element) == tag:
                    yield element
                    element.clear()


def _tag(element: Element) -> str:
    return str(element.tag).rsplit("}", 1)[-1]


def _index(text: str) -> int:
    """Return a place in the list of texts; a negative one would count from its end."""
    if not text.isdecimal():
        raise ValueError(text)
    return int(text)
