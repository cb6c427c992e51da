"""A characteristic over the parts of a batch: chart of individuals, and of moving ranges below it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from metrosep.core.errors import DataError
from metrosep.plot.style import COLOURS, house_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["trend_chart"]

_OUTSIDE = "#B3261E"
_FEW = 120
"""Parts up to which each value has a marker."""


def trend_chart(
    values: Sequence[float | None],
    *,
    name: str,
    unit: str,
    control: tuple[float, float, float] | None = None,
    ranges: tuple[float, float] | None = None,
    limits: tuple[float | None, float | None] = (None, None),
) -> Figure:
    """Return the chart of individuals of a characteristic, with its moving ranges."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    z = np.array([math.nan if v is None else v for v in values], dtype=np.float64)
    if not np.isfinite(z).any():
        raise DataError(f"{name} has no value in this batch, so there is no trend to draw")
    x = np.arange(1, z.size + 1)
    with house_style():
        figure = Figure(figsize=(7.2, 3.9), layout="constrained")
        FigureCanvasAgg(figure)
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[2.2, 1.0])
        _panel(upper, x, z, None if control is None else control[1:])
        if control is not None:
            _line(upper, control[0], "mean", "-")
            for bound, label in zip(control[1:], ("control limits", ""), strict=True):
                _line(upper, bound, label, "--")
        for limit, label in zip(limits, ("limit of the check", ""), strict=True):
            if limit is not None:
                shown = label or ("" if limits[0] is not None else "limit of the check")
                upper.axhline(limit, color=_OUTSIDE, lw=1.2, label=shown)
        upper.set_ylabel(f"{name} / {unit}" if unit else name)
        if upper.get_legend_handles_labels()[1]:
            upper.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, frameon=False)
        steps = np.concatenate([[math.nan], np.abs(np.diff(z))])
        _panel(lower, x, steps, None if ranges is None else (0.0, ranges[1]))
        if ranges is not None:
            _line(lower, ranges[0], "", "-")
            _line(lower, ranges[1], "", "--")
        lower.set_ylim(bottom=0.0)
        lower.set_ylabel(f"range / {unit}" if unit else "range")
        lower.set_xlabel("part, in the order of their names")
        _whole_numbers(lower)
    return figure


def _panel(axes: Axes, x: np.ndarray, z: np.ndarray, control: tuple[float, ...] | None) -> None:
    marker = "o" if z.size <= _FEW else ""
    axes.plot(x, z, color=COLOURS["estimate"], lw=1.0, marker=marker, ms=3.0)
    if control is None:
        return
    out = (z < control[0]) | (z > control[1])
    if out.any():
        axes.plot(x[out], z[out], ls="", marker="s", ms=4.5, color=_OUTSIDE)


def _line(axes: Axes, value: float, label: str, style: str) -> None:
    axes.axhline(value, color=COLOURS["line"], lw=0.9, ls=style, label=label or None)


def _whole_numbers(axes: Axes) -> None:
    from matplotlib.ticker import MaxNLocator

    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
