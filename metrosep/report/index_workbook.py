"""The index of a batch as a workbook (xlsx): units, all characteristics, capability."""

from __future__ import annotations

import io
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from metrosep.core.atomic import atomic_write
from metrosep.report.index import Series, require_index, series_of, status_stamp
from metrosep.report.rows import one_line
from metrosep.report.workbook import new_workbook

__all__ = ["render_index_workbook", "write_index_workbook"]

Document = Mapping[str, Any]

_MOST_LETTERS = 32_000
_MOST_COLUMNS = 16_000


def render_index_workbook(document: Document) -> bytes:
    """Return the index of a batch as the bytes of an xlsx file."""
    rows, series = require_index(document), series_of(document)
    stream = io.BytesIO()
    book = new_workbook(stream, one_line(document.get("title") or "Batch"))
    head = book.add_format({"bold": True, "bottom": 1, "text_wrap": True, "valign": "top"})
    _units(book, document, rows, series, head)
    _capability(book, series, head)
    _provenance(book, document, head)
    book.close()
    return stream.getvalue()


def write_index_workbook(document: Document, path: str | os.PathLike[str]) -> Path:
    """Write the index of a batch as an xlsx file.

    Parameters
    ----------
    document : mapping
        Content of an index.json.
    path : str or path
        File.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    DataError
        If it is not an index, or is damaged.
    UnsupportedFeatureError
        If xlsxwriter is not installed.
    WriteError
        If it cannot be written.
    """
    return atomic_write(path, render_index_workbook(document))


def _text(sheet: Any, row: int, column: int, text: Any, style: Any = None) -> None:
    line = one_line(text or "").encode("utf-8", "backslashreplace").decode("utf-8")
    sheet.write_string(row, column, line[:_MOST_LETTERS], style)


def _again(series: Series) -> str:
    """Return what tells the second check of one metric from the first."""
    return f" ({series.number})" if series.number > 1 else ""


def _units(
    book: Any, document: Document, rows: Sequence[Document], series: Sequence[Series], head: Any
) -> None:
    sheet = book.add_worksheet("Units")
    groups = list(document.get("groups") or [])
    names = ["unit", *groups, "status", "reason"]
    shown = series[: _MOST_COLUMNS - len(names)]
    titles = [f"{s.metric}{_again(s)}{f' / {s.unit}' if s.unit else ''}" for s in shown]
    for i, name in enumerate([*names, *titles, "hash", "result"]):
        _text(sheet, 0, i, name, head)
    sheet.freeze_panes(1, 1)
    sheet.set_column(0, 0, 30)
    sheet.set_column(len(names) - 1, len(names) - 1, 60)
    styles: dict[Any, Any] = {}
    for place, row in enumerate(rows):
        i, status = place + 1, row.get("status")
        mark = status_stamp(status)
        if status not in styles:
            colours = {"font_color": "#FFFFFF", "bg_color": mark.colour}
            styles[status] = book.add_format({"bold": True} | colours)
        cells = [row.get("unit"), *((row.get("groups") or {}).get(g) for g in groups)]
        for column, cell in enumerate(cells):
            _text(sheet, i, column, cell)
        _text(sheet, i, len(cells), f"{mark.symbol} {mark.word}", styles[status])
        _text(sheet, i, len(cells) + 1, row.get("reason"))
        for column, each in enumerate(shown, start=len(names)):
            value = each.values[place]
            if value is not None:
                sheet.write_number(i, column, value)
        for column, key in enumerate(("hash", "link"), start=len(names) + len(shown)):
            _text(sheet, i, column, row.get(key))
    missing = (document.get("not_begun") or {}).get("units") or ()
    for i, name in enumerate(missing, start=len(rows) + 1):
        _text(sheet, i, 0, name)
        _text(sheet, i, len(names) - 2, "not begun")
    if rows or missing:
        sheet.autofilter(0, 0, len(rows) + len(missing), len(names) + len(shown) + 1)


def _capability(book: Any, series: Sequence[Series], head: Any) -> None:
    sheet = book.add_worksheet("Capability")
    titles = (
        "metric", "characteristic", "unit", "values", "mean", "sd", "lower", "upper", "Cp",
        "Cp from (95 %)", "Cp to (95 %)", "Cpk", "Cpk from (95 %)", "Cpk to (95 %)",
        "mean (control)", "lower control limit", "upper control limit", "mean moving range",
        "upper limit of the ranges",
    )  # fmt: skip
    for i, title in enumerate(titles):
        _text(sheet, 0, i, title, head)
    sheet.set_column(1, 1, 40)
    sheet.freeze_panes(1, 2)
    for i, each in enumerate(series, start=1):
        for column, text in enumerate((each.metric, each.name + _again(each), each.unit)):
            _text(sheet, i, column, text)
        found, control = each.capability, each.control
        known = [v for v in each.values if v is not None]
        numbers: list[float | None] = [len(known), None, None, each.lower, each.upper]
        if found is not None:
            numbers[1:3] = [found.mean, found.sd]
            numbers += [found.cp, found.cp_low, found.cp_high]
            numbers += [found.cpk, found.cpk_low, found.cpk_high]
        else:
            numbers += [None] * 6
        if control is not None:
            numbers += [control.mean, control.lower, control.upper]
            numbers += [control.mean_range, control.upper_range]
        for column, value in enumerate(numbers, start=3):
            if value is not None:
                sheet.write_number(i, column, value)


def _provenance(book: Any, document: Document, head: Any) -> None:
    sheet = book.add_worksheet("Provenance")
    sheet.set_column(0, 0, 24)
    sheet.set_column(1, 1, 100)
    recipe = document.get("recipe") or {}
    facts = [
        ("metrosep", document.get("metrosep")),
        ("recipe", recipe.get("name")),
        ("SHA-256 of the recipe", recipe.get("sha256")),
        *(("note", note) for note in document.get("notes") or ()),
        *(("", line) for line in str(recipe.get("text") or "").splitlines()),
    ]
    _text(sheet, 0, 0, document.get("title") or "Batch", head)
    for i, (name, value) in enumerate(facts, start=1):
        _text(sheet, i, 0, name)
        _text(sheet, i, 1, value)
