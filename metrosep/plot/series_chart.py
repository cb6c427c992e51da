"""A series of parts on one page: what drifts, how the surest of it went, and what moves together."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.plot.style import (
    COLOURS,
    DASHED,
    DOTTED,
    axes_or_new,
    house_style,
    new_figure,
    scale_of,
    values,
    write_beside,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from metrosep.separation.drift.drift import DriftTest

_MOST_BARS = 14
_MOST_CURVES = 3
_MOST_PAIRS = 16


def draw_part_series(series: Mapping[str, Any]) -> Figure:
    """Return one picture of a series of parts."""
    terms = sorted(series["terms"], key=lambda t: _or_one(t["p"]))
    with house_style():
        figure = new_figure((11.0, 7.6))
        halves: Any = figure.subfigures(1, 2, width_ratios=(1.0, 1.1))
        left, right = halves
        shown = terms[:_MOST_CURVES]
        axes = left.subplots(1 + len(shown), 1, height_ratios=[1.6, *[1.0] * len(shown)])
        rows = list(np.atleast_1d(axes))
        _drifts(rows[0], terms)
        for place, term in zip(rows[1:], shown, strict=True):
            _curve(place, term, is_last=place is rows[-1])
        _pairs(right, series, [t["name"] for t in terms[:_MOST_PAIRS]])
    return figure


def _or_one(p: float | None) -> float:
    return 1.0 if p is None or not np.isfinite(p) else float(p)


def _drifts(axes: Axes, terms: Sequence[Mapping[str, Any]]) -> None:
    chosen = terms[:_MOST_BARS]
    ratios = [_ratio(t) for t in chosen]
    place = np.arange(len(chosen))
    colours = [COLOURS["after"] if t["drifts"] else "#B8BEC6" for t in chosen]
    axes.barh(place, ratios, color=colours, height=0.72)
    axes.axvline(0.0, color=COLOURS["line"], linewidth=0.8)
    reach = 1.55 * max((abs(r) for r in ratios), default=1.0) + 1.0
    axes.set_xlim(-reach, reach)
    for y, (t, ratio) in enumerate(zip(chosen, ratios, strict=True)):
        scale, symbol = scale_of(t["unit"], abs(float(t["drift"])), least=1.0)
        text, side = f"{float(t['drift']) * scale:+.3g} {symbol}", 1.0 if ratio >= 0 else -1.0
        where = {"ha": "left" if side > 0 else "right", "va": "center"}
        write_beside(axes, text, (ratio, float(y)), (4.0 * side, 0.0), **where)
    axes.set_yticks(place, [_short(t["name"]) for t in chosen])
    axes.invert_yaxis()
    axes.grid(visible=False, axis="y")
    axes.set_xlabel("drift, first to last part, in its standard uncertainties")
    n = sum(bool(t["drifts"]) for t in terms)
    beyond = "none beyond chance" if n == 0 else f"{n} beyond chance (coloured)"
    axes.set_title(f"Drift of {len(terms)} terms: {beyond}", fontsize=9.5, loc="left")


def _ratio(term: Mapping[str, Any]) -> float:
    drift, u = float(term["drift"]), term["u_drift"]
    if not u or not np.isfinite(u):
        return float(np.sign(drift)) * 10.0
    return float(np.clip(drift / u, -60.0, 60.0))


def _curve(axes: Axes, term: Mapping[str, Any], *, is_last: bool) -> None:
    from matplotlib.ticker import MaxNLocator

    heights = values(term["values"])
    part = np.arange(1, heights.size + 1)
    largest = float(np.nanmax(np.abs(heights), initial=0.0))
    scale, symbol = scale_of(term["unit"], largest, least=1.0)
    axes.plot(
        part, heights * scale, "o-", color=COLOURS["estimate"], markersize=3.0, linewidth=0.9
    )
    beyond = np.array(term["beyond"], dtype=int)
    if beyond.size:
        axes.plot(
            part[beyond], heights[beyond] * scale, "s", color=COLOURS["after"], markersize=5.5,
            fillstyle="none", label="outside the limits",
        )  # fmt: skip
    axes.axhline(term["mean"] * scale, color=COLOURS["line"], linewidth=0.8)
    for limit in (term["lower"], term["upper"]):
        if limit is not None and np.isfinite(limit):
            axes.axhline(limit * scale, color=COLOURS["line"], linewidth=0.8, linestyle=DASHED)
    axes.set_ylabel(symbol, fontsize=8.5)
    axes.set_title(str(term["name"]), fontsize=8.5, loc="left", pad=3.0)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    if is_last:
        axes.set_xlabel("part, in order; dashed: control limits")


def _pairs(figure: Any, series: Mapping[str, Any], names: Sequence[str]) -> None:
    order = [t["name"] for t in series["terms"]]
    index = [order.index(name) for name in names]
    matrix = np.array(
        [[np.nan if v is None else v for v in row] for row in series["correlation"]], dtype=float
    )[np.ix_(index, index)]
    axes = figure.subplots()
    image = axes.imshow(matrix, cmap="RdBu_r", vmin=-1.0, vmax=1.0)
    axes.grid(visible=False)
    labels = [_short(n) for n in names]
    axes.set_xticks(np.arange(len(names)), labels, rotation=90)
    axes.set_yticks(np.arange(len(names)), labels)
    from matplotlib.patches import Rectangle

    for a, b, _ in series["correlated"]:
        if a in names and b in names:
            i, j = names.index(a), names.index(b)
            for x, y in ((i, j), (j, i)):
                axes.add_patch(Rectangle((x - 0.5, y - 0.5), 1, 1, fill=False, linewidth=1.6))
    if len(names) <= 10:
        for i, j in np.ndindex(matrix.shape):
            if np.isfinite(matrix[i, j]):
                shade = "white" if abs(matrix[i, j]) > 0.6 else "black"
                text = f"{matrix[i, j]:.2f}"
                axes.text(j, i, text, ha="center", va="center", color=shade, fontsize=8.0)
    figure.colorbar(
        image,
        ax=axes,
        location="bottom",
        shrink=0.6,
        ticks=(-1.0, -0.5, 0.0, 0.5, 1.0),
        label="correlation without the drifts",
    )
    pairs = len(series["correlated"])
    found = "none beyond chance" if pairs == 0 else f"{pairs} beyond chance (framed)"
    axes.set_title(f"Pairs of terms: {found}", fontsize=9.5, loc="left")


def _short(name: str) -> str:
    return name if len(name) <= 22 else f"{name[:20]}…"


# ---- A characteristic over the parts of a batch: chart of individuals, and of moving ranges below it ----

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
    z = np.array([math.nan if v is None else v for v in values], dtype=np.float64)
    if not np.isfinite(z).any():
        raise DataError(f"{name} has no value in this batch, so there is no trend to draw")
    x = np.arange(1, z.size + 1)
    with house_style():
        figure = new_figure((7.2, 3.9))
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
        lower.set(
            ylabel=f"range / {unit}" if unit else "range",
            xlabel="part, in the order of their names",
        )
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


# ---- drift over time with its ranges, and the Allan deviation of a reading ---------------------

_LINES = (
    ("estimate", "-"),
    ("after", DASHED),
    ("reverse", DOTTED),
    ("before", (0, (6, 1.5, 1, 1.5))),
    ("text", "-"),
)


def drift_chart(test: DriftTest, ax: Axes | None = None) -> Axes:
    """Return axes with the drift of each channel and its range in each window.

    Parameters
    ----------
    test : DriftTest
        Result of `metrosep.separation.drift.drift.iso230_3_drift`.
    ax : matplotlib Axes, optional
        Axes to draw into; new ones if omitted.

    Returns
    -------
    matplotlib Axes
        Change since the first reading over time, gaps where nothing was measured; the names in the
        legend carry the ranges by window. Shaded: every other window. Channels in rad are not
        drawn.

    Raises
    ------
    DataError
        If no channel is a length.
    """
    names = [n for n, q in test.ranges.items() if q[0].unit == "m"]
    if not names:
        raise DataError("no channel is a length: nothing to draw")
    start = {n: _first(test.channels[n]) for n in names}
    largest = max(float(np.nanmax(np.abs(test.channels[n] - start[n]))) for n in names)
    scale, unit = (1e6, "µm") if largest >= 1e-6 else (1e9, "nm")
    span, time_unit = (3600.0, "h") if test.t[-1] - test.t[0] >= 10800 else (60.0, "min")
    with house_style():
        axes = axes_or_new(ax, size=(7.2, 4.2))
        for i, (a, b) in enumerate(test.windows):
            if len(test.windows) > 1 and i % 2 == 0:
                axes.axvspan(a / span, b / span, color=COLOURS["zone"], zorder=0.5)
        for i, name in enumerate(names):
            colour, dash = _LINES[i % len(_LINES)]
            ranges = ", ".join(f"{q.value * scale:.3g}" for q in test.ranges[name])
            axes.plot(
                test.t / span,
                (test.channels[name] - start[name]) * scale,
                color=COLOURS[colour],
                linestyle=dash,
                linewidth=1.6,
                label=f"{name}: range {ranges} {unit}",
            )
        total = ", ".join(f"{q.value * scale:.3g}" for q in test.combined)
        axes.plot([], [], " ", label=f"combined (RSS): {total} {unit}")
        axes.axhline(0.0, color=COLOURS["line"], linewidth=0.7, zorder=1.5)
        axes.set(xlabel=f"time / {time_unit}", ylabel=f"drift / {unit}")
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, borderaxespad=0.2)
    return axes


def _first(z: FloatArray) -> float:
    valid = z[~np.isnan(z)]
    return float(valid[0]) if valid.size else math.nan


def allan_plot(
    tau: Sequence[float] | FloatArray,
    deviation: Sequence[float] | FloatArray,
    u: Sequence[float] | FloatArray | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Return axes with an Allan deviation against averaging time.

    Parameters
    ----------
    tau : array_like, shape (n,), s
        Averaging times.
    deviation : array_like, shape (n,), m
        As `metrosep.separation.allan_deviation` gives it.
    u : array_like, shape (n,), m, optional
        Its standard uncertainty, drawn as a band of two.
    ax : matplotlib Axes, optional
        Axes to draw into; new ones if omitted.

    Returns
    -------
    matplotlib Axes
        Both axes logarithmic; dashed: white noise from the first point; ring: the minimum, the
        longest averaging that pays.

    Raises
    ------
    DataError
        If lengths differ or there is nothing to draw.
    """
    x, y = np.asarray(tau, dtype=np.float64), np.asarray(deviation, dtype=np.float64)
    if x.size == 0 or x.shape != y.shape or (u is not None and np.shape(u) != x.shape):
        raise DataError("averaging times, deviations and u must be equally many, at least one")
    scale, unit = (1e6, "µm") if float(np.nanmax(y)) >= 2e-6 else (1e9, "nm")
    with house_style():
        axes = axes_or_new(ax, size=(6.2, 4.2))
        axes.set(xscale="log", yscale="log")
        if u is not None:
            band = 2.0 * np.asarray(u, dtype=np.float64)
            low = np.maximum(y - band, 0.2 * y)
            axes.fill_between(
                x, low * scale, (y + band) * scale, color=COLOURS["estimate"], alpha=0.16, lw=0
            )
        axes.plot(x, y * scale, "o-", color=COLOURS["estimate"], ms=3.5, lw=1.5, label="readings")
        axes.plot(
            x,
            y[0] * np.sqrt(x[0] / x) * scale,
            color=COLOURS["before"],
            linestyle=DASHED,
            linewidth=1.1,
            label="white noise",
        )
        best = int(np.nanargmin(y))
        axes.plot(
            x[best],
            y[best] * scale,
            "o",
            ms=10,
            mfc="none",
            mec=COLOURS["after"],
            mew=1.6,
            label=f"best: {y[best] * scale:.3g} {unit} at {x[best]:.3g} s",
        )
        axes.set(xlabel="averaging time / s", ylabel=f"Allan deviation / {unit}")
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, borderaxespad=0.2)
    return axes
