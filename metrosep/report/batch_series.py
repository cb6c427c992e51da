"""A batch as a series of parts: which characteristic, coefficient or wavelength drifts, what moves together."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from metrosep.core.errors import TooFewSamplesError
from metrosep.parameters.rounding_floor import constant
from metrosep.parameters.series import PartSeries, part_series
from metrosep.recipe.part_order import order_words, parts_in_order
from metrosep.report.index_view import link_of, require_index, rounding_floors
from metrosep.report.rows import one_line
from metrosep.report.text import readable_unit

__all__ = ["batch_series", "batch_table", "series_section"]

Document = Mapping[str, Any]

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
            "Values that differ by rounding only are left out."
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
    unit, factor = readable_unit([term.drift], term.unit)
    shown = "" if unit == "1" else f" {unit}"
    text = f"{one_line(term.name)}: {term.drift / factor:+.3g} ± {2 * term.u_drift / factor:.2g}{shown}"
    return text.replace("-", "−") + " (k = 2)"


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
