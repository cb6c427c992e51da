"""The error over position: estimate with its band, and each feedrate before and after."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.plot.style import (
    BAND_FACTOR,
    COLOURS,
    DASHED,
    axes_or_new,
    house_style,
    length_scale,
    shades,
    speed_name,
    values,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["before_after"]


def before_after(document: Mapping[str, Any], ax: Axes | None = None) -> Axes:
    """Return axes with the error over position before and after compensation.

    Parameters
    ----------
    document : mapping
        A result (schema ``metrosep.result/1``).
    ax : matplotlib Axes, optional
        Axes to draw into; new ones if omitted.

    Returns
    -------
    matplotlib Axes
        Position in mm; error in nm, or in µm where it is large. Thick: the estimate of each
        direction, with a band of two standard uncertainties. Thin: the mean reading of each
        feedrate before and after. Grey: the guard zones outside the evaluation range.

    Raises
    ------
    DataError
        If the result holds no curves.
    """
    plots = document.get("plots")
    if not plots or not plots.get("x_mm"):
        raise DataError("this result holds no curves over position: nothing to draw")
    with house_style():
        axes = axes_or_new(ax)
        x = values(plots["x_mm"])
        estimates = _estimates(plots)
        feeds = plots.get("feeds") or []
        scale, unit = length_scale(
            *(e for _, e, _ in estimates),
            *(values(f.get(k)) for f in feeds for k in ("before_nm", "after_nm")),
        )
        _shade_guard_zones(axes, plots)
        _draw_feeds(axes, feeds, scale)
        for name, error, sd in estimates:
            _draw_estimate(axes, x, error * scale, sd * scale, name)
        axes.axhline(0.0, color=COLOURS["line"], linewidth=0.7, zorder=1.5)
        axes.set_xlabel("position / mm")
        axes.set_ylabel(f"error (actual − nominal) / {unit}")
        axes.set_xlim(*_limits(plots, x))
        _legend_above(axes)
    return axes


def _estimates(plots: Mapping[str, Any]) -> list[tuple[str, FloatArray, FloatArray]]:
    """Name, error and standard uncertainty of each direction, in nm."""
    apart = [d for d in plots.get("directions") or [] if d["direction"] in ("forward", "reverse")]
    if len(apart) > 1:
        return [(d["direction"], values(d["estimate_nm"]), values(d.get("sd_nm"))) for d in apart]
    return [("", values(plots["estimate_nm"]), values(plots.get("sd_nm")))]


def _draw_estimate(axes: Axes, x: FloatArray, error: FloatArray, sd: FloatArray, way: str) -> None:
    colour = COLOURS["reverse" if way == "reverse" else "estimate"]
    label = f"estimate, {way}" if way else "estimate"
    if sd.size == x.size and np.isfinite(sd).any():
        half = BAND_FACTOR * sd
        axes.fill_between(
            x, error - half, error + half, color=colour, alpha=0.25, linewidth=0.0, zorder=3
        )
        label += f" ± {BAND_FACTOR:.0f} sd"
    width, dash, order = (1.4, DASHED, 4.1) if way == "reverse" else (1.8, "-", 4.0)
    axes.plot(x, error, color=colour, linewidth=width, linestyle=dash, zorder=order, label=label)


def _draw_feeds(axes: Axes, feeds: Sequence[Mapping[str, Any]], scale: float) -> None:
    """Before in greys, after in oranges; the faster, the darker."""
    speeds = sorted({f["feed_mm_min"] for f in feeds}, key=_speed_key)
    for key, word, order in (("before_nm", "before", 2.0), ("after_nm", "after", 2.5)):
        for speed, colour in zip(speeds, shades(COLOURS[word], len(speeds)), strict=True):
            label = f"{word}, {speed_name(speed)}"
            for feed in (f for f in feeds if f["feed_mm_min"] == speed):
                y = values(feed.get(key)) * scale
                if np.isfinite(y).any():
                    x = values(feed["x_mm"])
                    axes.plot(x, y, color=colour, linewidth=0.6, zorder=order, label=label)
                    label = "_"


def _speed_key(speed: float | None) -> float:
    return -1.0 if speed is None else speed


def _shade_guard_zones(axes: Axes, plots: Mapping[str, Any]) -> None:
    label = "guard zone (fitted, not evaluated)"
    for low, high in (("fit_low_mm", "start_mm"), ("stop_mm", "fit_high_mm")):
        left, right = plots.get(low), plots.get(high)
        if left is not None and right is not None and right > left:
            axes.axvspan(
                left, right, color=COLOURS["zone"], linewidth=0.0, zorder=0.5, label=label
            )
            label = "_"


def _limits(plots: Mapping[str, Any], x: FloatArray) -> tuple[float, float]:
    low = [v for v in (plots.get("fit_low_mm"), float(np.nanmin(x))) if v is not None]
    high = [v for v in (plots.get("fit_high_mm"), float(np.nanmax(x))) if v is not None]
    return min(low), max(high)


def _legend_above(axes: Axes) -> None:
    """Legend over the axes, where it can cover no curve: estimates, before, after in columns."""
    from matplotlib.lines import Line2D

    handles, labels = axes.get_legend_handles_labels()
    columns: list[list[Any]] = [[], [], []]
    for handle, label in zip(handles, labels, strict=True):
        column = 1 if label.startswith("before") else 2 if label.startswith("after") else 0
        columns[column].append((handle, label))
    columns[0].sort(key=lambda entry: entry[1])
    columns = [c for c in columns if c]
    n_rows = max(len(c) for c in columns)
    blank = (Line2D([], [], linestyle="none"), " ")
    entries = [e for c in columns for e in c + [blank] * (n_rows - len(c))]
    legend = axes.legend(
        *zip(*entries, strict=True),
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0, 1.0, 0.1),
        mode="expand",
        ncols=len(columns),
        borderaxespad=0.3,
    )
    for line in legend.get_lines():
        line.set_linewidth(1.6)
