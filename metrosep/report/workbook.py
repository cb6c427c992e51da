"""A result as a workbook (xlsx): summary, characteristics, curves and provenance on four sheets.

Texts are texts: nothing in a cell is taken for a formula or a link. Same document, same bytes.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from importlib import import_module
from typing import Any, NamedTuple

from metrosep.core.errors import DataError, UnsupportedFeatureError
from metrosep.report.certificate import expanded_of
from metrosep.report.comparison import known_number
from metrosep.report.index import Series, require_index, series_of, status_stamp
from metrosep.report.text import (
    CharacteristicRow,
    capital,
    characteristic_rows,
    document_writer,
    one_line,
    printing,
    stamp,
)
from metrosep.report.view import view

Workbook = Any
Worksheet = Any
"""Of xlsxwriter, which has no type hints."""

_DATE = datetime(2000, 1, 1)
"""Of every workbook: a clock would make other bytes each time."""

_MOST_LETTERS = 32_000
"""In one cell; longer texts go on in the next row."""

_MOST_ROWS = 1_048_000

_HEADS = (
    ("characteristic", 46), ("metric", 14), ("value", 14), ("unit", 8), ("lower", 12), ("upper", 12),
    ("u", 12), ("U", 12), ("k", 8), ("guard band", 12), ("verdict", 18), ("origin of U", 24),
    ("definition", 80),
)  # fmt: skip


def render_workbook(document: Mapping[str, Any]) -> bytes:
    """Return a result as the bytes of an xlsx file."""
    shown, rows = view(document), characteristic_rows(document)
    stream = io.BytesIO()
    book = new_workbook(stream, one_line(shown["title"]))
    _summary(book, document, shown)
    _characteristics(book, document.get("characteristics") or [], rows)
    _profiles(book, document)
    _provenance(book, document, shown)
    book.close()
    return stream.getvalue()


write_workbook = document_writer(
    "write_workbook", render_workbook, "a result as an xlsx file",
    DataError="If the result is damaged, or a verdict is unknown.",
    UnsupportedFeatureError="If xlsxwriter is not installed.",
)  # fmt: skip


def new_workbook(stream: io.BytesIO, title: str) -> Workbook:
    """Return an empty workbook without clock, formulas and links."""
    try:
        xlsxwriter = import_module("xlsxwriter")
    except ImportError:
        raise UnsupportedFeatureError(
            "workbooks need xlsxwriter, which is not installed; install it: pip install "
            '"metrosep[xlsx]"'
        ) from None
    book = xlsxwriter.Workbook(
        stream,
        {
            "in_memory": True,
            "strings_to_formulas": False,
            "strings_to_urls": False,
            "strings_to_numbers": False,
        },
    )
    book.set_properties({"title": title[:250], "author": "metrosep", "created": _DATE})
    return book


def write_text(sheet: Worksheet, row: int, column: int, text: Any, style: Any = None) -> int:
    """Write a text, over several rows where a cell cannot hold it."""
    line = one_line(text)
    pieces = [line[i : i + _MOST_LETTERS] for i in range(0, len(line), _MOST_LETTERS)] or [""]
    for i, piece in enumerate(pieces):
        sheet.write_string(row + i, column, piece, style)
    return row + len(pieces)


def _sheet(book: Workbook, name: str, widths: Sequence[int]) -> Worksheet:
    sheet = book.add_worksheet(name)
    for i, width in enumerate(widths):
        sheet.set_column(i, i, width)
    sheet.set_paper(9)
    sheet.set_landscape()
    sheet.fit_to_pages(1, 0)
    sheet.set_footer("&L&A&RPage &P of &N")
    return sheet


def _verdict_style(book: Workbook, verdict: str | None) -> Any:
    colour = stamp(verdict).colour
    return book.add_format({"bold": True, "font_color": "#FFFFFF", "bg_color": colour})


def _summary(book: Workbook, document: Mapping[str, Any], shown: Mapping[str, Any]) -> None:
    sheet = _sheet(book, "Summary", (34, 90))
    bold, soft = (
        book.add_format({"bold": True, "font_size": 14}),
        book.add_format({"italic": True}),
    )
    wrapped = book.add_format({"text_wrap": True, "valign": "top"})
    c = shown["c"]
    row = write_text(sheet, 0, 0, c["heading"], bold)
    row = write_text(sheet, row, 0, shown["title"], bold)
    mark = shown["stamp"]
    verdict = document.get("verdict")
    sheet.write_string(row, 0, f"{mark.symbol} {c['verdict']}", _verdict_style(book, verdict))
    row = write_text(sheet, row, 1, mark.meaning)
    t = c["t"]
    facts = [(t["decision_rule"], c["rule"])] if c["rule"] else []
    facts += [(t["draft"], c["missing"])] if c["missing"] else []
    facts += [
        (t[name], c[k]) for k, name in (("issued", "issued"), ("replaces", "revision")) if c[k]
    ]
    facts += [(title, "; ".join(f"{k}: {v}" for k, v in rows)) for title, rows in c["blocks"]]
    facts += [(t["u_origin"], o) for o in c["origins"]]
    facts += [(t["traceability"], c["traceability"])] if c["traceability"] else []
    facts += [(t["deviations"], d) for d in c["deviations"]]
    facts += [(t["external"], c["external"])] if c["external"] else []
    facts += [(who, name or t["not_stated"]) for who, name in c["persons"]]
    facts += [(t["results"], t["statement"])]
    facts = [(capital(name), value) for name, value in facts]
    facts += [*shown["summary"], *((shown["table"] or {}).get("rows") or [])]
    for name, value in facts:
        sheet.write_string(row, 0, one_line(name))
        row = write_text(sheet, row, 1, value, wrapped)
    for found in (shown["table"] or {}).get("findings") or []:
        sheet.write_string(row, 0, one_line(f"Table, {found['level']}"), soft)
        row = write_text(sheet, row, 1, f"{found['problem']} {found['fix']}", wrapped)
    said = [(t["warnings"], m) for m in c["warnings"]] + [("Note", m) for m in shown["messages"]]
    for name, message in said:
        sheet.write_string(row, 0, capital(name), soft)
        row = write_text(sheet, row, 1, message, wrapped)
    _picture(sheet, document, row + 1)


def _picture(sheet: Worksheet, document: Mapping[str, Any], row: int) -> None:
    """Insert the first figure of the result."""
    from metrosep.plot import drawable, figure_png

    for name, draw in drawable(document).items():
        data = io.BytesIO(figure_png(draw, document))
        options = {"image_data": data, "x_scale": 0.56, "y_scale": 0.56, "description": name}
        sheet.insert_image(row, 0, f"{name}.png", options)
        return


def _characteristics(
    book: Workbook, entries: Sequence[Mapping[str, Any]], rows: Sequence[CharacteristicRow]
) -> None:
    sheet = _sheet(book, "Characteristics", [w for _, w in _HEADS])
    head = book.add_format({"bold": True, "bottom": 1})
    for i, (name, _) in enumerate(_HEADS):
        sheet.write_string(0, i, name, head)
    sheet.freeze_panes(1, 1)
    styles: dict[str | None, Any] = {}
    for i, (entry, row) in enumerate(zip(entries, rows, strict=True), start=1):
        U, k = expanded_of(entry, row)
        of = printing(row.value, U or row.u, row.unit, (row.lower, row.upper))
        digits = book.add_format({"num_format": f"{0:.{of.decimals}f}"})
        sheet.write_string(i, 0, row.name[:_MOST_LETTERS])
        sheet.write_string(i, 1, row.metric[:_MOST_LETTERS])
        sheet.write_string(i, 3, "" if of.unit == "1" else of.unit[:_MOST_LETTERS])
        for column, value in ((2, row.value), (6, row.u), (7, row.U), (9, row.guard)):
            _number(sheet, i, column, value, of.factor, digits)
        for column, value in ((4, row.lower), (5, row.upper)):
            _number(sheet, i, column, value, of.factor, None)
        if row.U is not None:
            _number(
                sheet, i, 8, k if row.U else None, 1.0, book.add_format({"num_format": "0.00"})
            )
            sheet.write_string(i, 11, one_line(entry.get("u_source") or "of the method"))
        if row.verdict is not None:
            mark = stamp(row.verdict)
            if row.verdict not in styles:
                styles[row.verdict] = _verdict_style(book, row.verdict)
            sheet.write_string(i, 10, f"{mark.symbol} {mark.word}", styles[row.verdict])
        sheet.write_string(i, 12, row.definition[:_MOST_LETTERS])
    if rows:
        sheet.autofilter(0, 0, len(rows), len(_HEADS) - 1)


def _number(
    sheet: Worksheet, row: int, column: int, value: float | None, factor: float, style: Any
) -> None:
    if value is not None:
        # 15 digits: what a person wrote as 100 nm is 100 again
        sheet.write_number(row, column, float(f"{value / factor:.15g}"), style)


def _profiles(book: Workbook, document: Mapping[str, Any]) -> None:
    """Write every curve of the result as a column, gaps as empty cells."""
    columns = curve_columns(document)
    sheet = _sheet(book, "Profiles", [16] * len(columns))
    bold = book.add_format({"bold": True, "text_wrap": True, "valign": "top"})
    if not columns:
        sheet.write_string(0, 0, "The result holds no curves.")
    for i, column in enumerate(columns):
        for row, text in enumerate((column.chart, column.name, column.unit)):
            sheet.write_string(row, i, one_line(text)[:_MOST_LETTERS], bold)
        for row, value in enumerate(column.values[:_MOST_ROWS], start=3):
            if value is not None:
                sheet.write_number(row, i, value)
    sheet.freeze_panes(3, 0)
    if columns:
        _charts(book, columns)


_CHART_ROWS, _CHART_SIZE = 20, {"width": 900, "height": 380}


def _charts(book: Workbook, columns: Sequence[Column]) -> None:
    """Draw each group of curves as a native chart over the columns of the sheet Profiles; u is not drawn."""
    sheet = _sheet(book, "Charts", (14,))
    groups: dict[str, list[int]] = {}
    for i, column in enumerate(columns):
        groups.setdefault(column.chart, []).append(i)
    for number, (title, members) in enumerate(groups.items()):
        chart = book.add_chart({"type": "scatter", "subtype": "straight"})
        first = columns[members[0]]
        abscissa, unit, is_log = members[0], "", False
        for i in members:
            column = columns[i]
            if column.name == first.name or column.name.startswith(f"{first.name}, "):
                abscissa = i
            elif not column.name.startswith("standard uncertainty"):
                last = 2 + min(len(column.values), _MOST_ROWS)
                chart.add_series(
                    {
                        "name": one_line(column.name)[:_MOST_LETTERS],
                        "categories": ["Profiles", 3, abscissa, last, abscissa],
                        "values": ["Profiles", 3, i, last, i],
                        "line": {"width": 1.25},
                    }
                )
                unit, is_log = unit or column.unit, is_log or column.log
        chart.set_title({"name": one_line(title)[:_MOST_LETTERS]})
        for place, text, log in (
            (chart.set_x_axis, _axis_name(first.name, first.unit), first.log),
            (chart.set_y_axis, _axis_name("value", unit), is_log),
        ):
            place({"name": text, "crossing": "min", **({"log_base": 10} if log else {})})
        chart.set_size(_CHART_SIZE)
        chart.show_blanks_as("gap")
        sheet.insert_chart(number * _CHART_ROWS, 0, chart)


def _axis_name(name: str, unit: str) -> str:
    return one_line(f"{name} / {unit}" if unit not in ("", "1") else name)


def _provenance(book: Workbook, document: Mapping[str, Any], shown: Mapping[str, Any]) -> None:
    sheet = _sheet(book, "Provenance", (30, 100))
    head, row = book.add_format({"bold": True}), 0
    inputs = [
        (i["name"], f"{i['format']}, {i['size']}, SHA-256 {i['sha256']}") for i in shown["inputs"]
    ]
    steps = [(s["name"], f"{s['parameters']} (metrosep {s['version']})") for s in shown["steps"]]
    versions = [("metrosep", shown["version"]), *shown["versions"]]
    recipe = shown["recipe"] or {}
    text = [("", line) for line in str(recipe.get("text") or "").splitlines()]
    hashes = [("SHA-256", recipe.get("sha256") or "–")] if recipe else []
    groups = (("Input", inputs), ("Steps", steps), ("Versions", versions))
    for title, facts in (*groups, ("Recipe", [*hashes, *text])):
        sheet.write_string(row, 0, title, head)
        row += 1
        for name, value in facts:
            sheet.write_string(row, 0, one_line(name)[:_MOST_LETTERS])
            row = write_text(sheet, row, 1, value)
        row += 1


# ---- the curves that a result holds, as columns with units: what its figures draw --------------

Document = Mapping[str, Any]


class Column(NamedTuple):
    """One column of numbers."""

    chart: str  # figure it belongs to, what it is, and the unit of its numbers
    name: str
    unit: str
    values: list[float | None]  # of (float or None): ``None`` where nothing was measured
    log: bool = False  # whether its axis is logarithmic


def curve_columns(document: Document) -> list[Column]:
    """Return the curves of a result."""
    try:
        found = [
            *_of_plots(document.get("plots") or {}),
            *_of_spectrum((document.get("estimate") or {}).get("spectrum") or {}),
            *_of_charts(document),
        ]
    except (AttributeError, KeyError, TypeError) as exc:
        raise DataError(
            f"a curve is damaged ({type(exc).__name__}: {exc}); run the recipe again"
        ) from None
    return found


def _of_plots(plots: Document) -> Iterator[Column]:
    if not plots.get("x_mm"):
        return
    chart = "Error over position"
    yield _column(chart, "position", "mm", plots["x_mm"])
    directions = plots.get("directions") or [{**plots, "direction": "both"}]
    for line in directions:
        way = line["direction"]
        yield _column(chart, f"separated error, {way}", "nm", line["estimate_nm"])
        yield _column(chart, f"standard uncertainty, {way}", "nm", line["sd_nm"])
    for feed in plots.get("feeds") or []:
        speed = feed.get("feed_mm_min")
        label = "feedrate not known" if speed is None else f"{speed:.6g} mm/min"
        label = f"{label}, {feed['direction']}"
        yield _column(chart, f"position, {label}", "mm", feed["x_mm"])
        yield _column(chart, f"mean run before, {label}", "nm", feed["before_nm"])
        yield _column(chart, f"mean run after, {label}", "nm", feed["after_nm"])


def _of_spectrum(spectrum: Document) -> Iterator[Column]:
    """Return amplitude over wavelength of the separated error, by direction; zero has no logarithm."""
    n = len(spectrum.get("wavelength_mm") or [])
    ways = spectrum.get("direction") or [None] * n
    chart = "Amplitude over wavelength"
    for way in dict.fromkeys(ways):
        rows = [i for i, w in enumerate(ways) if w == way]
        x, amplitude, sd = (
            [spectrum[k][i] for i in rows] for k in ("wavelength_mm", "amplitude_nm", "sd_nm")
        )
        name = f"amplitude, {way}" if way else "amplitude"
        yield _column(chart, "wavelength", "mm", x, log=True)
        yield _column(chart, name, "nm", [a or None for a in amplitude], log=True)
        yield _column(chart, f"standard uncertainty of {name}", "nm", sd)


def _of_charts(document: Document) -> Iterator[Column]:
    for part in ("separation", "plan"):
        for chart in (document.get(part) or {}).get("charts") or []:
            if chart.get("kind") != "curves":
                continue
            title, axis = str(chart.get("title") or "Chart"), chart["x"]
            for panel in chart["panels"]:
                yield from _of_panel(panel, title, axis)


def _of_panel(panel: Document, title: str, axis: Document) -> Iterator[Column]:
    for curve in panel["curves"]:
        name = ", ".join(str(t) for t in (panel.get("title"), curve.get("label")) if t)
        x_name, x_unit = str(axis.get("name") or "x"), str(axis.get("unit") or "")
        yield _column(title, x_name, x_unit, curve["x"], log=bool(axis.get("log")))
        yield _column(title, name or "value", str(panel.get("unit") or ""), curve["y"])
        if curve.get("u"):
            yield _column(
                title,
                f"standard uncertainty of {name or 'value'}",
                str(panel.get("unit") or ""),
                curve["u"],
            )


def _column(
    chart: str, name: str, unit: str, values: Sequence[Any], *, log: bool = False
) -> Column:
    numbers = [known_number(v, f"an entry of {name}") for v in values]
    return Column(chart, name, unit, numbers, log)


# ---- the index of a batch as a workbook (xlsx): units, all characteristics, capability ---------

_MOST_COLUMNS = 16_000


def render_index_workbook(document: Document) -> bytes:
    """Return the index of a batch as the bytes of an xlsx file."""
    rows, series = require_index(document), series_of(document)
    stream = io.BytesIO()
    book = new_workbook(stream, one_line(document.get("title") or "Batch"))
    head = book.add_format({"bold": True, "bottom": 1, "text_wrap": True, "valign": "top"})
    _units(book, document, rows, series, head)
    _capability(book, series, head)
    _workbook_provenance(book, document, head)
    book.close()
    return stream.getvalue()


write_index_workbook = document_writer(
    "write_index_workbook", render_index_workbook, "the index of a batch as an xlsx file",
    of="index.json", DataError="If it is not an index, or is damaged.",
    UnsupportedFeatureError="If xlsxwriter is not installed.",
)  # fmt: skip


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


def _workbook_provenance(book: Any, document: Document, head: Any) -> None:
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
