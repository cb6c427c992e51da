"""Bars of a result: rankings, budgets and coefficients, from the plain values of a chart."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from metrosep.plot.style import COLOURS, axes_or_new, house_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_bars"]


_COLOURS = ("estimate", "after", "before", "reverse")
_UNITS: Mapping[str, tuple[tuple[float, str], ...]] = {
    "m": ((1.0, "m"), (1e-3, "mm"), (1e-6, "µm"), (1e-9, "nm"), (1e-12, "pm")),
    "rad": ((1.0, "rad"), (1e-3, "mrad"), (1e-6, "µrad"), (1e-9, "nrad")),
}
_MANY = 7
"""Labels beyond which they stand upright."""


def draw_bars(chart: Mapping[str, Any], *, ax: Axes | None = None) -> Axes:
    """Return the bars that a chart of kind ``bars`` describes.

    Parameters
    ----------
    chart : mapping
        From `metrosep.recipe.bar_charts.bar_chart`.
    ax : matplotlib Axes, optional
        Where to draw.

    Returns
    -------
    matplotlib Axes
        One group of bars for each label, or one bar with the series stacked.
    """
    series = {k: np.array(v, dtype=np.float64) for k, v in chart["series"].items()}
    spread = {k: np.array(v, dtype=np.float64) for k, v in (chart.get("u") or {}).items()}
    labels = list(chart["labels"])
    largest = max((float(np.nanmax(np.abs(v), initial=0.0)) for v in series.values()), default=0.0)
    unit, symbol = _unit(chart["unit"], largest)
    with house_style():
        axes = axes_or_new(ax)
        place = np.arange(len(labels), dtype=np.float64)
        bottom = np.zeros(len(labels))
        width = 0.8 if chart["stacked"] else 0.8 / max(len(series), 1)
        for k, (name, values) in enumerate(series.items()):
            shift = 0.0 if chart["stacked"] else (k - 0.5 * (len(series) - 1)) * width
            bars = values / unit
            error = spread.get(name)
            axes.bar(
                place + shift,
                bars,
                width,
                bottom=bottom if chart["stacked"] else 0.0,
                color=COLOURS[_COLOURS[k % len(_COLOURS)]],
                label=name or None,
                yerr=None if error is None else 2.0 * np.where(error > 0.0, error, np.nan) / unit,
                error_kw={"elinewidth": 0.9, "capsize": 2.0, "ecolor": COLOURS["text"]},
            )
            if chart["stacked"]:
                bottom += np.nan_to_num(bars)
        if chart["log"]:
            axes.set_yscale("log")
        else:
            axes.axhline(0.0, color=COLOURS["line"], linewidth=0.8)
        upright = len(labels) > _MANY or max((len(v) for v in labels), default=0) > 12
        axes.set_xticks(
            place, labels, rotation=45 if upright else 0, ha="right" if upright else "center"
        )
        axes.grid(visible=False, axis="x")
        axes.set_ylabel(chart["quantity"] + (f" / {symbol}" if symbol else ""))
        if any(series) and len(series) > 1:
            axes.legend(  # above, never on the bars
                loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, borderaxespad=0.2
            )
    return axes


def _unit(unit: str, largest: float) -> tuple[float, str]:
    steps = _UNITS.get(unit)
    if steps is None:
        return 1.0, "" if unit == "1" else unit
    if not largest > 0.0:
        return steps[-1]
    return next((s for s in steps if largest >= 2.0 * s[0]), steps[-1])
