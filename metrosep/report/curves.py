"""The curves that a result holds, as columns with units: what its figures draw."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from metrosep.core.errors import DataError
from metrosep.report.comparison import known_number

__all__ = ["Column", "curve_columns"]

Document = Mapping[str, Any]


class Column(NamedTuple):
    """One column of numbers."""

    chart: str  # figure it belongs to, what it is, and the unit of its numbers
    name: str
    unit: str
    values: list[float | None]  # of (float or None): ``None`` where nothing was measured


def curve_columns(document: Document) -> list[Column]:
    """Return the curves of a result."""
    try:
        found = [*_of_plots(document.get("plots") or {}), *_of_charts(document)]
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
        yield _column(title, str(axis.get("name") or "x"), str(axis.get("unit") or ""), curve["x"])
        yield _column(title, name or "value", str(panel.get("unit") or ""), curve["y"])
        if curve.get("u"):
            yield _column(
                title,
                f"standard uncertainty of {name or 'value'}",
                str(panel.get("unit") or ""),
                curve["u"],
            )


def _column(chart: str, name: str, unit: str, values: Sequence[Any]) -> Column:
    return Column(chart, name, unit, [known_number(v, f"an entry of {name}") for v in values])
