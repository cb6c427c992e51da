"""The index of a batch as one static HTML page: counts, failures first, capability, trends, all units.

The page works without script; a script of a few lines, named by its hash in the page's own policy,
lets the tables be sorted. Nothing is fetched. Same index, same bytes.
"""

from __future__ import annotations

import base64
import hashlib
import json
import math
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import quote

from metrosep.core.atomic import atomic_write
from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.core.limits import STATUS_OF_VERDICT
from metrosep.parameters.gauge import (
    LEAST_VALUES,
    Capability,
    ControlLimits,
    capability_of,
    control_limits,
)
from metrosep.parameters.repeats import constant, floors
from metrosep.parameters.series import PartSeries, part_series
from metrosep.recipe.parts import order_notes, order_words, parts_in_order
from metrosep.report.comparison import known_number
from metrosep.report.text import (
    Stamp,
    capital,
    decimals_for,
    limits_text,
    number,
    one_line,
    readable_unit,
    stamp,
)

Document = Mapping[str, Any]

_ORDER = ("failed", "refused", "rejected", "inconclusive", "measured", "accepted")
"""The worst first; also how the column of the status is sorted."""

_MOST_COLUMNS, _MOST_CHARTS, _MOST_POINTS = 8, 6, 400


def render_index(document: Document, *, folder: str | os.PathLike[str] | None = None) -> str:
    """Return the page of a batch.

    Parameters
    ----------
    document : mapping
        Content of an index.json (schema ``metrosep.index/1``).
    folder : str or path, optional
        Where the page will lie; reports beside the results are linked too where they exist.

    Returns
    -------
    str
        A whole HTML page.

    Raises
    ------
    DataError
        If it is not an index, or is damaged.
    """
    from importlib.resources import files

    from markupsafe import Markup

    from metrosep.report.html import page_template

    place = files("metrosep.report").joinpath("templates")
    script = "\n" + place.joinpath("index.js").read_text("utf-8")
    digest = base64.b64encode(hashlib.sha256(script.encode("utf-8")).digest()).decode("ascii")
    rows, series = require_index(document), series_of(document)
    shown = [s for s in series if s.trend or any(s.verdicts)] or series
    columns, charted = shown[:_MOST_COLUMNS], [s for s in shown if s.trend] or shown
    units = [_row(r, i, columns, None if folder is None else Path(folder), document)
             for i, r in enumerate(rows)]  # fmt: skip
    page = page_template("index").render(
        title=one_line(document.get("title") or "Batch"),
        total=len(rows),
        missing=len((document.get("not_begun") or {}).get("units") or ()),
        counts=_counts(rows),
        notes=_notes(document),
        failed=[u for u in units if u["status"] in ("failed", "refused")],
        not_accepted=_worst_first(
            [
                (u, r)
                for u, r in zip(units, rows, strict=True)
                if u["status"] in ("rejected", "inconclusive")
            ]
        ),
        series=[_series_row(s) for s in series],
        least=LEAST_VALUES,
        trends=_trends([s for s in charted if s.moves], order_words(document)),
        flat=[_label(s) for s in charted if not s.moves and any(v is not None for v in s.values)],
        together=series_section(document, None if folder is None else Path(folder)),
        groups=[one_line(g) for g in document.get("groups") or []],
        columns=[{"label": _label(s), "unit": s.unit} for s in columns],
        hidden=len(series) - len(columns),
        rows=units,
        recipe=one_line((document.get("recipe") or {}).get("sha256") or "not recorded"),
        version=one_line(document.get("metrosep") or "not recorded"),
        script=Markup(script),  # noqa: S704  (our own file, no data in it)
        script_hash=f"sha256-{digest}",
    )
    return page if page.endswith("\n") else page + "\n"


def write_index(document: Document, path: str | os.PathLike[str]) -> Path:
    """Write the page of a batch; it appears whole or not at all.

    Parameters
    ----------
    document : mapping
        Content of an index.json.
    path : str or path
        File, in the output folder of the batch, so that its links lead to the results.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    DataError
        If it is not an index, or is damaged.
    WriteError
        If it cannot be written.
    """
    page = render_index(document, folder=Path(path).parent)
    return atomic_write(path, page.encode("utf-8", "backslashreplace"))


def _counts(rows: Sequence[Document]) -> list[dict[str, Any]]:
    counted = Counter(r.get("status") for r in rows)
    for status in counted:
        status_stamp(status)  # refuses an unknown one
    return [{"n": counted[s], "stamp": status_stamp(s)} for s in _ORDER if counted[s]]


def _notes(document: Document) -> list[str]:
    """Return what the index leaves out, and why."""
    words = {
        "other_recipe": "of another recipe",
        "other_version": "of another version of metrosep",
        "former_content": "of former contents of the files",
        "gone": "of files that are gone",
        "unreadable": "of files that cannot be read now",
    }
    apart = document.get("apart") or {}
    texts = [f"{apart[k]} {words.get(k, one_line(k))}" for k in sorted(apart) if apart[k]]
    notes = [f"{capital(one_line(n))}." for n in document.get("notes") or ()]
    notes += [f"Kept apart, not counted here: {', '.join(texts)}."] if texts else []
    return notes + [f"{capital(one_line(n))}." for n in order_notes(document)]


def _row(
    row: Document, place: int, columns: Sequence[Series], folder: Path | None, document: Document
) -> dict[str, Any]:
    groups = row.get("groups") or {}
    link = link_of(row.get("link"))
    return {
        "unit": one_line(row.get("unit") or "not named"),
        "groups": [one_line(groups.get(g, "")) for g in document.get("groups") or []],
        "status": row.get("status"),
        "stamp": status_stamp(row.get("status")),
        "rank": _ORDER.index(str(row.get("status"))),
        "reason": one_line(row.get("reason") or ""),
        "numbers": [_cell(s.values[place], s) for s in columns],
        "hash": one_line(row.get("hash") or "")[:12],
        "link": link,
        "link_word": str(row.get("link") or "").rpartition("/")[2],
        "report": None if link is None or folder is None else _beside(row, folder, "report.html"),
        "thumb": None if link is None or folder is None else _beside(row, folder, "thumb.png"),
    }


def severity(row: Document) -> float:
    """Return how far a part lies outside its limits, in guard bands; the largest of its values, -inf without one.

    s = max((y - T_U) / g, (T_L - y) / g), g: guard band, else U, else T_U - T_L, else the limit itself.

    Examples
    --------
    >>> value = {"upper": 12.0, "U": 0.3, "guard_factor": 1.0}
    >>> [round(severity({"characteristics": [{**value, "value": y}]}), 6) for y in (36.0, 14.2, 12.2)]
    [80.0, 7.333333, 0.666667]
    """
    found = -math.inf
    for entry in row.get("characteristics") or ():
        y, low, high = (entry.get(k) for k in ("value", "lower", "upper"))
        if y is None or (low is None and high is None):
            continue
        guard = (entry.get("U") or 0.0) * (
            1.0 if entry.get("guard_factor") is None else entry["guard_factor"]
        )
        width = 0.0 if low is None or high is None else abs(high - low)
        limit = max(abs(v) for v in (low, high) if v is not None)
        g = guard or entry.get("U") or width or limit or 1.0
        beyond = [(y - high) / g] if high is not None else []
        beyond += [(low - y) / g] if low is not None else []
        found = max(found, *beyond)
    return found


def _worst_first(pairs: list[tuple[dict[str, Any], Document]]) -> list[dict[str, Any]]:
    """Return rows by severity, those without a value last; equal ones by name."""
    pairs.sort(key=lambda p: (-severity(p[1]), p[0]["unit"]))
    return [u for u, _ in pairs]


def _beside(row: Document, folder: Path, name: str) -> str | None:
    """Return the link to a file beside a result, where there is one."""
    place = str(row["link"]).rpartition("/")[0]
    found = f"{place}/{name}" if place else name
    try:
        return link_of(found) if (folder / found).is_file() else None
    except (OSError, ValueError):
        return None


def _cell(value: float | None, series: Series) -> dict[str, str]:
    if value is None:
        return {"raw": "", "text": "–"}
    return {"raw": repr(value), "text": number(value, 1.0, series.decimals)}


def _label(series: Series) -> str:
    name = series.name if len(series.name) <= len(series.metric) else series.metric
    return f"{name} ({series.number})" if series.number > 1 else name


def _series_row(series: Series) -> dict[str, Any]:
    known = [v for v in series.values if v is not None]
    mean = sum(known) / len(known) if known else None
    sd = None
    if mean is not None and len(known) > 1:
        sd = (sum((v - mean) ** 2 for v in known) / (len(known) - 1)) ** 0.5
    found = series.capability
    cp = cpk = {"raw": "", "text": "–"}
    if found is not None:
        cpk = _index(found.cpk, found.cpk_low, found.cpk_high)
        if found.cp is not None and found.cp_low is not None and found.cp_high is not None:
            cp = _index(found.cp, found.cp_low, found.cp_high)
    name = series.metric if series.metric == series.name else f"{series.metric}: {series.name}"
    name += f" ({series.number})" if series.number > 1 else ""
    return {
        "label": name,
        "unit": series.unit,
        "n": len(known),
        "numbers": [
            _cell(v, series)
            for v in (min(known, default=None), mean, max(known, default=None), sd)
        ],
        "limits": _limits(series),
        "cp": cp,
        "cpk": cpk,
        "spark": [_piece(p) for p in spark_points(_thinned(series.ordered)) if series.moves],
    }


def _piece(points: Sequence[tuple[float, float]]) -> tuple[str, bool, float, float]:
    return (" ".join(f"{x:g},{y:g}" for x, y in points), len(points) > 1, *points[0])


def _thinned(values: Sequence[float | None]) -> list[float | None]:
    """Return at most some hundred values: smallest and largest of each cell, gaps as gaps."""
    if len(values) <= _MOST_POINTS:
        return list(values)
    size = -(-2 * len(values) // _MOST_POINTS)
    found: list[float | None] = []
    for i in range(0, len(values), size):
        cell = [(v, j) for j, v in enumerate(values[i : i + size]) if v is not None]
        if not cell:
            found += [None, None]
            continue
        ends = sorted((min(cell), max(cell)), key=lambda item: item[1])
        found += [v for v, _ in ends]
    return found


def _index(value: float, low: float, high: float) -> dict[str, str]:
    text = f"{value:.2f} ({low:.2f} … {high:.2f})".replace("-", "−")
    return {"raw": repr(value), "text": text}


def _limits(series: Series) -> str:
    if not series.same_limits:
        return "not the same"
    return limits_text(series.lower, series.upper)


def _trends(series: Sequence[Series], order: str) -> list[dict[str, str]]:
    from metrosep.plot.series_chart import trend_chart
    from metrosep.plot.style import figure_svg

    charts: list[dict[str, str]] = []
    for each in series:
        known = [v for v in each.ordered if v is not None]
        if len(known) < 2 or len(charts) == _MOST_CHARTS:
            continue
        control = each.control
        drawn = trend_chart(
            each.ordered,
            name=_label(each)[:40],
            unit=each.unit,
            control=None if control is None else (control.mean, control.lower, control.upper),
            ranges=None if control is None else (control.mean_range, control.upper_range),
            limits=(each.lower, each.upper),
        )
        drawn.axes[-1].set_xlabel(f"part, {order}")
        svg = figure_svg(partial(_given, drawn), {})
        data = base64.b64encode(svg.encode("utf-8")).decode("ascii")
        title = f"{_label(each)} over the batch"
        charts.append({"title": title, "caption": _caption(each, order), "data": data})
    return charts


def _given(figure: Any, _document: Document) -> Any:
    return figure


def _caption(series: Series, order: str) -> str:
    missing = sum(v is None for v in series.ordered)
    text = f"Single values above, moving ranges of two neighbours below; parts {one_line(order)}."
    control = series.control
    if control is not None:
        out = sum(
            v is not None and not control.lower <= v <= control.upper for v in series.ordered
        )
        text += f" Beyond the control limits (squares): {out}."
    return text + (f" Without a value: {missing}; they leave gaps." if missing else "")


# ---- A batch as a series of parts: which characteristic, coefficient or wavelength drifts, what moves together ----

_FEWEST = 5
_MOST_TERMS = 60
_MOST_LINES = 8


def batch_table(
    document: Document, folder: Path | None = None
) -> tuple[dict[str, list[float]], dict[str, str], list[str]]:
    """Return the terms of a batch, a value for each part."""
    found = require_index(document)
    rows = [found[i] for i in parts_in_order(document)]
    n = len(rows)
    table: dict[str, list[float]] = {}
    units: dict[str, str] = {}

    def put(term: str, unit: str, place: int, value: Any) -> None:
        if isinstance(value, bool) or not isinstance(value, int | float):
            return
        if math.isfinite(value):
            table.setdefault(term, [math.nan] * n)[place] = float(value)
            units[term] = unit

    for i, row in enumerate(rows):
        for entry in row.get("characteristics") or []:
            term = one_line(entry.get("metric") or entry.get("name") or "?")
            put(term, one_line(entry.get("unit") or "1"), i, entry.get("value"))
        for term, value in _wavelengths(row, folder):
            put(term, "m", i, value)
    kept = {
        t: v for t, v in table.items() if sum(not math.isnan(x) for x in v) >= max(_FEWEST, n // 2)
    }
    return kept, {t: units[t] for t in kept}, [str(r.get("unit")) for r in rows]


def batch_series(document: Document, folder: Path | None = None) -> PartSeries | None:
    """Return what a batch tells of the process that made its parts."""
    table, units, parts = batch_table(document, folder)
    floor = rounding_floors(document)
    moving = {t: v for t, v in table.items() if not constant(v, floor.get(units[t], 0.0))}
    if len(parts) < _FEWEST or not moving:
        return None
    chosen = dict(list(moving.items())[:_MOST_TERMS])
    try:
        return part_series(chosen, units=units)
    except TooFewSamplesError:
        return None


def series_section(document: Document, folder: Path | None = None) -> dict[str, Any] | None:
    """Return the section of a page on drift and correlation."""
    from metrosep.plot.series_chart import draw_part_series
    from metrosep.plot.style import figure_svg

    found = batch_series(document, folder)
    if found is None:
        return None
    svg = figure_svg(draw_part_series, found.to_dict())
    return {
        "data": base64.b64encode(svg.encode("utf-8")).decode("ascii"),
        "caption": (
            f"{len(found.terms)} terms of {found.n_parts} parts, {one_line(order_words(document))}. "
            "Left: drift from the first to the last part over its standard uncertainty, and the "
            "surest terms with control limits. Right: correlation after each term's own line is taken "
            f"off. Beyond chance: false discovery rate {100 * found.rate:g} % over all terms, and over "
            "all pairs; of terms that say the same (correlation 0.9999 and more) one is counted. "
            "Values that differ by rounding only are omitted."
        ),
        "drifts": [_drift_line(t) for t in found.drifting[:_MOST_LINES]],
        "pairs": [
            f"{one_line(a)} and {one_line(b)}: {r:+.{2 if abs(r) < 0.995 else 4}f}".replace(
                "-", "−"
            )
            for a, b, r in found.correlated[:_MOST_LINES]
        ],
        "same": "; ".join(", ".join(map(one_line, group)) for group in found.same),
    }


def _drift_line(term: Any) -> str:
    from metrosep.forms._correlated import expanding_factor

    k = expanding_factor(sum(map(math.isfinite, term.values)) - 2)  # of a slope
    unit, factor = readable_unit([term.drift], term.unit)
    shown = "" if unit == "1" else f" {unit}"
    text = f"{one_line(term.name)}: {term.drift / factor:+.3g} ± {k * term.u_drift / factor:.2g}{shown}"
    return text.replace("-", "−") + f" (k = {k:.2f})"


def _wavelengths(row: Document, folder: Path | None) -> list[tuple[str, float]]:
    """Return the amplitudes of the wavelengths that a separation selected."""
    link = row.get("link")
    if folder is None or link_of(link) is None or not str(link).endswith("result.json"):
        return []
    try:
        content = json.loads((folder / str(link)).read_text(encoding="utf-8"))
        table = (content.get("estimate") or {}).get("spectrum") or {}
        columns = zip(
            table["wavelength_mm"], table["amplitude_nm"], table["selected"], strict=True
        )
        ways = table.get("direction") or [""] * len(table["selected"])
        return [
            (f"wavelength {w:.4g} mm{f' {way}' if way else ''}", a * 1e-9)
            for (w, a, chosen), way in zip(columns, ways, strict=True)
            if chosen and a is not None
        ]
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return []


# ---- from the index of a batch to the texts, series and links that its page and its workbook show ----

_Key = tuple[str, str, str, int]

INDEX_SCHEMA = "metrosep.index/1"
_VERDICTS = {status: verdict for verdict, status in STATUS_OF_VERDICT.items()}
_OTHERS = {
    "measured": stamp(None),
    "failed": Stamp("FAILED", "!", "#6A1B5A", "The unit could not be measured."),
    "refused": Stamp("NOT BEGUN", "∅", "#3F4A56", "The unit was not begun."),
}


@dataclass(frozen=True, slots=True)
class Series:
    """One characteristic over all units of a batch."""

    metric: str  # what it is
    name: str
    unit: str  # printed unit of all numbers here; empty for pure ones
    factor: float  # of the unit, to SI
    decimals: int  # to print
    # of (float or None): by row of the index; ``None`` where it is not there
    values: tuple[float | None, ...]
    verdicts: tuple[str | None, ...]  # of (str or None): by row
    lower: float | None  # limits, where they are the same in every row
    upper: float | None
    same_limits: bool  # whether they are
    capability: Capability | None  # of the values, where there are enough and limits
    # of the values in the order of the parts; None, as capability, where they differ by rounding
    # only
    control: ControlLimits | None
    trend: bool  # whether the recipe asks for its trend
    number: int = 1  # from 1; 2 for the second check of one metric under one name
    # of (float or None): values in the order of the parts, as charts show them; parts without a
    # place are left out
    ordered: tuple[float | None, ...] = ()
    moves: bool = True  # whether the values differ by more than rounding


def require_index(document: Any) -> Sequence[Document]:
    """Return the rows of an index."""
    found = document.get("schema") if isinstance(document, Mapping) else type(document).__name__
    if found != INDEX_SCHEMA:
        raise DataError(
            f"this is not the index of a batch (schema {found!r}, expected {INDEX_SCHEMA!r}); give the "
            "index.json that 'metrosep batch' wrote"
        )
    rows = document.get("rows") or []
    if not isinstance(rows, Sequence) or not all(isinstance(r, Mapping) for r in rows):
        raise DataError("the rows of the index are not a list of units; write the index again")
    return rows


def status_stamp(status: Any) -> Stamp:
    """Return word, symbol and colour of the status of a unit.

    Examples
    --------
    >>> status_stamp("rejected").word, status_stamp("failed").symbol
    ('REJECT', '!')
    """
    if status in _VERDICTS:
        return stamp(_VERDICTS[status])
    if status not in _OTHERS:
        known = ", ".join([*_VERDICTS, *_OTHERS])
        raise DataError(f"unknown status {status!r} in the index; expected one of {known}")
    return _OTHERS[status]


def link_of(link: Any) -> str | None:
    """Return a link below the folder of the index, safe in a page.

    Examples
    --------
    >>> link_of("part 7/result.json"), link_of("../x"), link_of("javascript:alert(1)")
    ('part%207/result.json', None, 'javascript%3Aalert%281%29')
    """
    if not isinstance(link, str) or not link or link.startswith(("/", "\\")):
        return None
    if ".." in link.replace("\\", "/").split("/"):
        return None
    return quote(link.encode("utf-8", "replace"), safe="/")


def rounding_floors(document: Document) -> dict[str, float]:
    """Return the spread up to which values of a batch differ by rounding only, by SI unit."""
    entries = [
        e
        for row in require_index(document)
        for e in row.get("characteristics") or []
        if isinstance(e, Mapping)
    ]
    numbers = (
        (one_line(e.get("unit") or "1"), known_number(e.get(k), k))
        for e in entries
        for k in ("value", "lower", "upper")
    )
    return floors((unit, value) for unit, value in numbers if value is not None)


def series_of(document: Document) -> list[Series]:
    """Return the characteristics of a batch, those with a trend first."""
    rows = require_index(document)
    found: dict[_Key, dict[int, Document]] = {}
    for i, row in enumerate(rows):
        counted: Counter[tuple[str, str, str]] = Counter()
        for entry in row.get("characteristics") or []:
            if not isinstance(entry, Mapping):
                raise DataError(
                    "a characteristic of the index is not a value; write the index again"
                )
            metric = one_line(
                entry.get("metric") or entry.get("symbol") or entry.get("name") or "?"
            )
            key = (
                metric,
                one_line(entry.get("name") or metric),
                one_line(entry.get("unit") or "1"),
            )
            counted[key] += 1
            found.setdefault((*key, counted[key]), {})[i] = entry
    wanted = {one_line(t) for t in document.get("trend") or []}
    order = parts_in_order(document)
    floor = rounding_floors(document)
    made = [
        _series(k, entries, len(rows), wanted, order, floor.get(k[2], 0.0))
        for k, entries in found.items()
    ]
    return sorted(made, key=lambda s: (not s.trend, not any(s.verdicts)))


def _series(
    key: _Key,
    entries: Mapping[int, Document],
    n: int,
    wanted: set[str],
    order: Sequence[int],
    floor: float,
) -> Series:
    metric, name, si, number = key
    columns = {
        k: [known_number(entries.get(i, {}).get(k), f"{k} of {metric}") for i in range(n)]
        for k in ("value", "lower", "upper", "U", "u")
    }
    limits = {(columns["lower"][i], columns["upper"][i]) for i in entries}
    same = len(limits) == 1
    lower, upper = next(iter(limits)) if same else (None, None)
    known = [v for v in columns["value"] if v is not None]
    shown: list[float | None] = [v for v in (lower, upper) if v] or list(known)
    unit, factor = readable_unit(shown, si)
    spreads = [v / factor for k in ("u", "U") for v in columns[k] if v is not None and v > 0.0]
    largest = max((abs(v) / factor for v in known), default=0.0)
    verdicts = tuple(entries.get(i, {}).get("verdict") for i in range(n))
    for verdict in verdicts:
        stamp(verdict)  # refuses an unknown one
    values = tuple(None if v is None else v / factor for v in columns["value"])
    ordered = tuple(values[i] for i in order)
    low, high = (None if v is None else v / factor for v in (lower, upper))
    in_order = low is None or high is None or low < high
    moves = not constant(known, floor)
    return Series(
        metric,
        name,
        "" if unit == "1" else unit,
        factor,
        min(decimals_for(min(spreads, default=None), largest), 6),
        values,
        verdicts,
        low,
        high,
        same,
        capability_of(values, lower=low, upper=high) if same and in_order and moves else None,
        control_limits(ordered) if moves else None,
        trend=bool(wanted & {metric, name}),
        number=number,
        ordered=ordered,
        moves=moves,
    )


def spark_points(values: Sequence[float | None]) -> list[list[tuple[float, float]]]:
    """Return the pieces of a sparkline, 100 wide and 20 high; a gap parts them."""
    known = [v for v in values if v is not None and math.isfinite(v)]
    if not known:
        return []
    low, high = min(known), max(known)
    size = (high - low) or 1.0
    across = max(len(values) - 1, 1)
    pieces: list[list[tuple[float, float]]] = [[]]
    for i, value in enumerate(values):
        if value is None or not math.isfinite(value):
            pieces.append([])
            continue
        pieces[-1].append(
            (round(100.0 * i / across, 2), round(18.0 - 16.0 * (value - low) / size, 2))
        )
    return [p for p in pieces if p]
