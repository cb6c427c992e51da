"""A series of parts on one page: what drifts, how the surest of it went, and what moves together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from metrosep.plot.style import COLOURS, DASHED, house_style, values

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw_part_series"]

_MOST_BARS = 14
_MOST_CURVES = 3
_MOST_PAIRS = 16
_UNITS: Mapping[str, tuple[tuple[float, str], ...]] = {
    "m": ((1.0, "m"), (1e-3, "mm"), (1e-6, "µm"), (1e-9, "nm"), (1e-12, "pm")),
    "rad": ((1.0, "rad"), (1e-3, "mrad"), (1e-6, "µrad"), (1e-9, "nrad")),
}


def draw_part_series(series: Mapping[str, Any]) -> Figure:
    """Return one picture of a series of parts."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    terms = sorted(series["terms"], key=lambda t: _or_one(t["p"]))
    with house_style():
        figure = Figure(figsize=(11.0, 7.6), layout="constrained")
        FigureCanvasAgg(figure)
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
        unit, symbol = _unit(t["unit"], abs(float(t["drift"])))
        words = f"{float(t['drift']) / unit:+.3g} {symbol}"
        side = 1.0 if ratio >= 0 else -1.0
        axes.annotate(
            words,
            (ratio, y),
            xytext=(4.0 * side, 0.0),
            textcoords="offset points",
            ha="left" if side > 0 else "right",
            va="center",
            fontsize=8.0,
        )
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
    unit, symbol = _unit(term["unit"], float(np.nanmax(np.abs(heights), initial=0.0)))
    axes.plot(part, heights / unit, "o-", color=COLOURS["estimate"], markersize=3.0, linewidth=0.9)
    beyond = np.array(term["beyond"], dtype=int)
    if beyond.size:
        axes.plot(
            part[beyond], heights[beyond] / unit, "s", color=COLOURS["after"], markersize=5.5,
            fillstyle="none", label="outside the limits",
        )  # fmt: skip
    axes.axhline(term["mean"] / unit, color=COLOURS["line"], linewidth=0.8)
    for limit in (term["lower"], term["upper"]):
        if limit is not None and np.isfinite(limit):
            axes.axhline(limit / unit, color=COLOURS["line"], linewidth=0.8, linestyle=DASHED)
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


def _unit(unit: str, largest: float) -> tuple[float, str]:
    for factor, symbol in _UNITS.get(unit, ()):
        if largest >= factor:
            return factor, symbol
    return (1.0, "" if unit == "1" else unit) if unit not in _UNITS else _UNITS[unit][-1]


def _short(name: str) -> str:
    return name if len(name) <= 22 else f"{name[:20]}…"
