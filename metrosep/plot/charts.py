"""Charts that a result document describes: curves, harmonics, maps, positions, polar charts.

Everything is drawn from plain values of the document (``separation["charts"]``), so that a report
can be made again from a result.json alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.core.readable import typeset
from metrosep.plot.maps import separation_maps
from metrosep.plot.placing import place_stack
from metrosep.plot.polar import draw_round, harmonic_bars, polar_plot, stacked
from metrosep.plot.series_chart import draw_part_series
from metrosep.plot.style import (
    BAND_FACTOR,
    BARS,
    COLOURS,
    DASHED,
    DOTTED,
    LINES,
    UNITS,
    axes_or_new,
    draw_band,
    house_style,
    new_figure,
    scale_of,
    shades,
    write_beside,
)
from metrosep.separation.runs.planner import FeedPlan

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from metrosep.separation.positions.positioning_result import PositioningTest

# ---- bars of a result: rankings, budgets and coefficients, from the plain values of a chart ----

_MANY = 7
"""Labels beyond which they stand upright."""


def draw_bars(chart: Mapping[str, Any], *, ax: Axes | None = None) -> Axes:
    """Return the bars that a chart of kind ``bars`` describes.

    Parameters
    ----------
    chart : mapping
        From `metrosep.recipe.describe.charts.bar_chart`.
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
    scale, symbol = scale_of(chart["unit"], largest)
    with house_style():
        axes = axes_or_new(ax)
        place = np.arange(len(labels), dtype=np.float64)
        bottom = np.zeros(len(labels))
        width = 0.8 if chart["stacked"] else 0.8 / max(len(series), 1)
        for k, (name, values) in enumerate(series.items()):
            shift = 0.0 if chart["stacked"] else (k - 0.5 * (len(series) - 1)) * width
            bars = values * scale
            error = spread.get(name)
            axes.bar(
                place + shift,
                bars,
                width,
                bottom=bottom if chart["stacked"] else 0.0,
                color=COLOURS[BARS[k % len(BARS)]],
                label=name or None,
                yerr=None if error is None else 2.0 * np.where(error > 0.0, error, np.nan) * scale,
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


# ------------------------------------------------------------------------------------------------

Chart = Mapping[str, Any]

_MORE_LINES = ("#009E73", "#CC79A7", "#56B4E9", "#B8860B")
"""Beside the first four: told apart with any colour vision, after Okabe and Ito."""
_LEGEND_ABOVE = 78
"""Letters of title and legend that fit on the line above a panel."""
_MOST_LEGEND = 8


def draw_chart(chart: Chart) -> Figure | Axes:
    """Return the figure that a chart of a result describes.

    Parameters
    ----------
    chart : mapping
        One of ``document["separation"]["charts"]``.

    Returns
    -------
    matplotlib Figure or Axes
        Drawn from the chart alone.

    Raises
    ------
    DataError
        If its kind is not known or a value is missing.
    """
    kind = str(chart.get("kind"))
    if kind not in CHART_KINDS:
        raise DataError(
            f"a chart of kind {kind!r} is not known; there are {', '.join(CHART_KINDS)}"
        )
    try:
        return CHART_KINDS[kind](chart)
    except (KeyError, TypeError, AttributeError) as exc:
        raise DataError(
            f"the chart {chart.get('title')!r} is damaged ({type(exc).__name__}: {exc}); run the "
            "separation again"
        ) from exc


def _curves(chart: Chart) -> Figure:
    panels = chart["panels"]
    name, unit = chart["x"]["name"], chart["x"]["unit"]
    factor, label = _abscissa(name, unit, [c["x"] for p in panels for c in p["curves"]])
    scales = _scales(panels)
    colours = _line_colours(panels)
    with house_style():
        closed = bool(chart.get("closed"))  # over a whole turn: about a circle, too
        usual = not closed and not any(
            _is_beside(p) or "\n" in f"{p['title']}{name}" for p in panels
        )
        size = (7.2, 0.8 + (2.6 if closed else 2.0) * len(panels))
        figure = new_figure(size, layout=None if usual else "constrained")
        turns = (len(panels) if chart.get("each") else 1) if closed else 0
        grid, places = stacked(figure, len(panels), turns)
        for i, (axes, each) in enumerate(zip(grid, panels, strict=True)):
            _panel(axes, each, factor, scales[each["unit"]], colours[i])
        _about_circles(chart, places, scales, colours)
        grid[-1].set_xlabel(label)
        if unit == "rad":
            from matplotlib.ticker import MultipleLocator

            grid[-1].xaxis.set_major_locator(MultipleLocator(90.0))
        if chart["x"].get("log"):
            grid[-1].set_xscale("log")
        if usual:
            place_stack(figure, list(grid))
    return figure


def _about_circles(
    chart: Chart,
    places: Sequence[Axes],
    scales: Mapping[str, tuple[float, str]],
    colours: Sequence[Sequence[str]],
) -> None:
    """Draw the curves of each panel about a circle, those of one unit enlarged alike."""
    drawn = [
        [(str(c["label"]), _numbers(c["x"]), _numbers(c["y"])) for c in p["curves"]]
        for p in chart["panels"][: len(places)]
    ]
    most: dict[str, float] = {}
    for panel, curves in zip(chart["panels"], drawn, strict=False):
        sizes = [float(np.nanmax(np.abs(y))) for _, _, y in curves if np.isfinite(y).any()]
        most[panel["unit"]] = max([most.get(panel["unit"], 0.0), *sizes])
    for axes, panel, curves, own in zip(places, chart["panels"], drawn, colours, strict=False):
        draw_round(axes, curves, own, scales[panel["unit"]], largest=most[panel["unit"]])


# a curve whose label begins with "limit" is drawn dashed and grey, as every limit is
def _line_colours(panels: Sequence[Chart]) -> list[list[str]]:
    """Return a colour for each curve: the same for the same label in every panel of a chart."""
    palette = [*(COLOURS[name] for name in LINES), *_MORE_LINES]
    known: dict[str, str] = {}
    found = []
    for i, each in enumerate(panels):
        row = []
        for j, item in enumerate(each["curves"]):
            label = item["label"]
            if str(label).startswith("limit"):
                row.append(COLOURS["line"])
                continue
            free = [c for c in palette if c not in row and c not in known.values()]
            usual = palette[(i + j) % len(palette)]
            colour = known.get(label) or (usual if usual in free or not free else free[0])
            if label:
                known[label] = colour
            row.append(colour)
        found.append(row)
    return found


def _panel(
    axes: Axes,
    each: Chart,
    factor: float,
    printed: tuple[float, str],
    colours: Sequence[str],
) -> None:
    curves = [(c, _numbers(c["x"]) * factor, _numbers(c["y"])) for c in each["curves"]]
    scale, unit = printed
    for (item, x, y), colour in zip(curves, colours, strict=True):
        if item.get("u") is not None:
            half = BAND_FACTOR * _numbers(item["u"])
            draw_band(axes, x, y * scale, half * scale, colour)
        style: dict[str, Any] = {"linewidth": 1.3}
        if item.get("points"):
            style = {"marker": ".", "linestyle": "none"}
        elif str(item["label"]).startswith("limit"):
            style |= {"linestyle": DASHED}
        if item.get("classes"):  # of a histogram: x is the middle of each
            axes.fill_between(x, y * scale, step="mid", color=colour, alpha=0.25, linewidth=0.0)
            style |= {"drawstyle": "steps-mid"}
        axes.plot(x, y * scale, color=colour, label=typeset(item["label"]) or None, **style)
    axes.axhline(0.0, color=COLOURS["line"], linewidth=0.7, linestyle=DASHED, zorder=1.5)
    axes.set_title(typeset(each["title"]), loc="left", fontsize=9.5)
    axes.set_ylabel(" / ".join(filter(None, (each.get("quantity"), unit))))
    labels = axes.get_legend_handles_labels()[1]
    if labels and len(curves) <= _MOST_LEGEND:
        _legend(axes, labels, beside=_is_beside(each))


def _is_beside(each: Chart) -> bool:
    """Return whether the legend of a panel has no room above it."""
    labels = [str(c["label"]) for c in each["curves"] if c["label"]]
    if not labels or len(each["curves"]) > _MOST_LEGEND:
        return False
    return len(each["title"]) + sum(len(v) + 7 for v in labels) > _LEGEND_ABOVE


def _legend(axes: Axes, labels: Sequence[str], *, beside: bool) -> None:
    """Put the legend beside the curves, never on them: above at the right, or at the right."""
    if not beside:
        axes.legend(
            loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=len(labels), borderaxespad=0.1
        )
    else:
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))


def _abscissa(name: str, unit: str, positions: Sequence[Any]) -> tuple[float, str]:
    if unit == "rad":
        return 180.0 / math.pi, f"{name} / °"
    if unit == "1":
        return 1.0, name
    if unit == "s":
        largest = max(float(np.nanmax(np.abs(_numbers(x)))) for x in positions)
        factor, text = next((s for s in UNITS["s"] if largest * s[0] >= 2.0), (1.0, "s"))
        return factor, f"{name} / {text}"
    return 1e3, f"{name} / mm"


def _scales(panels: Sequence[Chart]) -> dict[str, tuple[float, str]]:
    """Return factor and printed unit of each unit of a chart: one for all of its panels.

    It is the unit in which the largest value reads well, or a smaller one where the values of
    another panel would vanish in it.
    """
    largest: dict[str, list[float]] = {}
    for each in panels:
        values = [_numbers(c["y"]) for c in each["curves"]]
        sizes = [float(np.nanmax(np.abs(v))) for v in values if np.isfinite(v).any()]
        largest.setdefault(each["unit"], []).append(max(sizes, default=0.0))
    return {unit: _scale(sizes, unit) for unit, sizes in largest.items()}


def _scale(sizes: Sequence[float], unit: str) -> tuple[float, str]:
    """Return factor and name of a unit that fits the largest values of several panels."""
    known = [s for s in sizes if s > 0.0]
    steps = UNITS.get(unit)
    if steps is None or not known:
        return 1.0, unit if unit != "1" else ""
    first = next((i for i, s in enumerate(steps) if max(known) * s[0] >= 2.0), len(steps) - 1)
    for scale, name in steps[first:]:
        if min(known) * scale >= _VANISHING or max(known) * scale * 1e3 > _MANY_DIGITS:
            return scale, name
    return steps[-1]


_VANISHING = 0.02
_MANY_DIGITS = 1e5
"""A panel whose values stay below the first in a unit gets a smaller one, unless those of another
panel would exceed the second in it."""


def _harmonics(chart: Chart) -> Axes:
    u = chart["u"]
    axes = harmonic_bars(
        np.array(chart["k"], dtype=np.intp),
        _numbers(chart["amplitude"]),
        None if u is None else _numbers(u),
        chart["suppressed"],
        chart["unit"],
        limit=None,
    )
    if chart.get("k_name"):
        axes.set_xlabel(chart["k_name"])
    return axes


def _maps(chart: Chart) -> Figure:
    parts = {name: _numbers(rows) for name, rows in chart["parts"].items()}
    x, y = chart.get("origin_m") or (0.0, 0.0)
    return separation_maps(
        parts,
        dx=chart["dx_m"],
        dy=chart["dy_m"],
        unit=chart["unit"],
        origin=(x, y),
        pv=chart.get("pv"),
        limits=chart.get("limits"),
        outside=chart.get("outside") or (0, 0),
        signed=chart.get("signed", True),
        quantity=chart.get("quantity", "value"),
    )


@dataclass(frozen=True, slots=True)
class _Number:
    """A value with its uncertainty, as the charts of the toolbox ask for it."""

    value: float
    u: float | None = None


class _StoredTest:
    """What `positioning_chart` needs of a positioning test, from a chart."""

    def __init__(self, chart: Chart) -> None:
        self._values = {
            k: _Number(math.nan if v is None else v, u) for k, (v, u) in chart["values"].items()
        }
        self.audit = {"unit": chart["unit"]}
        self.targets = _numbers(chart["targets"])
        for way in ("forward", "backward"):
            each = chart[way]
            setattr(self, way, None if each is None else _numbers(each))
            setattr(self, f"mean_{way}", _numbers(chart[f"mean_{way}"]))
            setattr(self, f"sd_{way}", _numbers(chart[f"sd_{way}"]))
        low, high = chart["interval"]
        self.R_interval = (low, high)
        self.R_unbiased = chart["unbiased"]
        self.confidence = chart["confidence"]

    def __getitem__(self, symbol: str) -> _Number:
        return self._values[symbol]

    def __contains__(self, symbol: object) -> bool:
        return symbol in self._values


class _StoredMotion:
    """What `polar_plot` needs of a spindle test, from a chart."""

    def __init__(self, chart: Chart) -> None:
        self.unit = chart["unit"]
        self.angle = _numbers(chart["angle"])
        self.motion = _numbers(chart["motion"])
        self.synchronous_motion = _numbers(chart["synchronous"])
        self.asynchronous_range = _numbers(chart["asynchronous_range"])
        self.n_revolutions = chart["n_revolutions"]
        self.direction, self.sensitive = chart["direction"], chart["sensitive"]
        self.center = chart["center"]
        self.synchronous, self.asynchronous, self.total = (
            _Number(chart["values"][k]) for k in ("synchronous", "asynchronous", "total")
        )


class _StoredPlan:
    """What `plan_sd` needs of a plan of feedrates, from a chart."""

    def __init__(self, chart: Chart) -> None:
        self.columns = {k: _numbers(v) for k, v in chart["columns"].items()}
        self.feeds, self.fixed = _numbers(chart["feeds"]), _numbers(chart["fixed"])
        self.audit = {"one_feed_mm_per_min": chart["one_feed_mm_per_min"]}


def _plan(chart: Chart) -> Axes:
    return plan_sd(cast(Any, _StoredPlan(chart)))


def _positions(chart: Chart) -> Axes:
    return positioning_chart(cast(Any, _StoredTest(chart)))


def _polar(chart: Chart) -> Axes:
    return polar_plot(cast(Any, _StoredMotion(chart)))


def _numbers(values: Any) -> FloatArray:
    """Return nested lists as an array, None as NaN."""
    return np.array(values, dtype=np.float64)


CHART_KINDS: Mapping[str, Callable[[Chart], Figure | Axes]] = {
    "curves": _curves,
    "harmonics": _harmonics,
    "maps": _maps,
    "positions": _positions,
    "polar": _polar,
    "plan": _plan,
    "bars": draw_bars,
    "part_series": draw_part_series,
}


# ---- figures of a feed plan: predicted sd over wavelength, and the density with the plan's feeds ----

_PLANNING_LINES = 2001
_MOST_WAVES = 4


def plan_sd(plan: FeedPlan, ax: Axes | None = None) -> Axes:
    """Return axes with the predicted sd over wavelength of a plan and of naive plans.

    Parameters
    ----------
    plan : FeedPlan
        Of `plan_feedrates` or `predicted_sd`.
    ax : matplotlib Axes, optional
        Axes to draw into; new ones if omitted.

    Returns
    -------
    matplotlib Axes
        Wavelength in mm and sd of an amplitude coefficient in nm, both logarithmic.

    Raises
    ------
    DataError
        If no sd of the plan is known.
    """
    table = plan.columns
    order = np.argsort(table["wavelength_mm"])
    wave = table["wavelength_mm"][order]
    if not np.isfinite(table["sd_nm"]).any():
        raise DataError("no sd of this plan is known: nothing to draw")
    marker = "o" if wave.size <= 20 else ""
    with house_style():
        axes = axes_or_new(ax)
        every = np.concatenate([plan.feeds, plan.fixed])
        middle = float(plan.audit["one_feed_mm_per_min"])
        curves = (
            ("sd_one_feed_nm", f"all at {middle:.0f} mm/min", COLOURS["before"], DOTTED),
            ("sd_geometric_feeds_nm", "feeds in geometric progression", COLOURS["after"], DASHED),
            ("sd_nm", f"this plan: {_feeds(every)} mm/min", COLOURS["estimate"], "-"),
        )
        for name, label, colour, dash in curves:
            axes.plot(
                wave,
                table[name][order],
                color=colour,
                linestyle=dash,
                marker=marker,
                markersize=3.5,
                linewidth=1.8 if name == "sd_nm" else 1.2,
                label=f"{label}",
            )
        axes.set(xscale="log", yscale="log")
        _plain_ticks(axes)
        axes.set(xlabel="wavelength / mm", ylabel="sd of an amplitude coefficient / nm")
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=1, borderaxespad=0.2)
    return axes


def plan_density(
    plan: FeedPlan, ax: Axes | None = None, *, wavelengths: tuple[float, ...] = ()
) -> Axes:
    """Return axes with the density of the disturbance and where the plan reads each wavelength.

    Parameters
    ----------
    plan : FeedPlan
        Of `plan_feedrates` or `predicted_sd`.
    ax : matplotlib Axes, optional
        Axes to draw into; new ones if omitted.
    wavelengths : tuple of float, m, optional
        Waves to mark, at most four; the worst known, the shortest and the longest if omitted.

    Returns
    -------
    matplotlib Axes
        Frequency in Hz and density in nm^2/Hz, both logarithmic; a row of marks at v / wavelength
        for each wave, one mark a feed, the darker the faster.

    Raises
    ------
    DataError
        If more than four wavelengths are to be marked.
    """
    if len(wavelengths) > _MOST_WAVES:
        raise DataError(f"{len(wavelengths)} wavelengths would cover each other; mark up to 4")
    sd = plan.columns["sd_nm"]
    worst = plan.wavelengths[int(np.argmax(np.where(np.isfinite(sd), sd, -np.inf)))]
    chosen = wavelengths or tuple(
        sorted({float(plan.wavelengths.min()), float(worst), float(plan.wavelengths.max())})
    )
    feeds = np.unique(np.concatenate([plan.feeds, plan.fixed]))
    marks = np.array([[v / w for v in feeds] for w in chosen])
    low, high = 0.5 * float(marks.min()), 2.0 * float(marks.max())
    f = np.geomspace(low, min(high, plan.density.highest), _PLANNING_LINES)
    with house_style():
        axes = axes_or_new(ax)
        s = plan.density(f) * 1e18
        axes.plot(f, s, color=COLOURS["line"], linewidth=1.2, label="disturbance")
        top = float(np.nanmax(s))
        tones = shades(COLOURS["estimate"], feeds.size)
        for row, (wave, at) in enumerate(zip(chosen, marks, strict=True)):
            height = top * 3.0 * 2.6**row
            for v, x, tone in zip(feeds, at, tones, strict=True):
                label = f"{v * 6e4:.0f} mm/min" if row == 0 else "_"
                axes.plot(x, height, "v", color=tone, markersize=6, label=label)
                axes.plot([x, x], [float(np.nanmin(s)), height], color=tone, linewidth=0.5)
            write_beside(
                axes, f"{wave * 1e3:.3g} mm", (float(at.max()), height), (7, 0), va="center"
            )
        axes.set(
            xscale="log",
            yscale="log",
            xlim=(low, high * 1.3),
            ylim=(float(np.nanmin(s)) * 0.7, top * 3.0 * 2.6 ** len(chosen)),
        )
        _plain_ticks(axes, which="x")
        axes.set(xlabel="frequency / Hz", ylabel="density / (nm²/Hz)")
        axes.legend(
            loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=min(4, feeds.size + 1), borderaxespad=0.2
        )  # fmt: skip
    return axes


def _feeds(feeds: FloatArray) -> str:
    distinct, counts = np.unique(feeds, return_counts=True)
    if distinct.size > 5:
        return f"{feeds.size} runs at {distinct[0] * 6e4:.0f} to {distinct[-1] * 6e4:.0f}"
    return ", ".join(f"{n} × {v * 6e4:.0f}" for v, n in zip(distinct, counts, strict=True))


def _plain_ticks(axes: Axes, which: str = "both") -> None:
    """Numbers instead of powers of ten, at 1, 2 and 5."""
    from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter

    for axis, name in ((axes.xaxis, "x"), (axes.yaxis, "y")):
        if which in ("both", name):
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.set_major_formatter(FormatStrFormatter("%g"))
            axis.set_minor_formatter(NullFormatter())


# ---- chart of a positioning test after ISO 230-2: both directions with their bands, and the values ----

_SYMBOLS = (
    "A",
    "A_fwd",
    "A_bwd",
    "R",
    "R_fwd",
    "R_bwd",
    "E",
    "E_fwd",
    "E_bwd",
    "B",
    "B_mean",
    "M",
)


def positioning_chart(test: PositioningTest, ax: Axes | None = None) -> Axes:
    """Return axes with the chart of a positioning test.

    Parameters
    ----------
    test : PositioningTest
        Result of `metrosep.separation.iso230_2`.
    ax : matplotlib Axes, optional
        Axes to draw into; new ones if omitted.

    Returns
    -------
    matplotlib Axes
        Error over target. Circles and a full line: mean forward; squares and a dashed line: mean
        backward; bands: two standard deviations; points: the single readings. Right: A, R, E, B, M
        with their standard uncertainties.
    """
    rotary = test.audit.get("unit") == "rad"
    coarse, coarse_name = (180.0 / math.pi, "°") if rotary else (1e3, "mm")
    fine, fine_name = (648000.0 / math.pi, "arcsec") if rotary else _positioning_scale(test)
    with house_style():
        axes = axes_or_new(ax, size=(8.4, 4.2))
        x = test.targets * coarse
        ways = (
            ("forward", test.forward, test.mean_forward, test.sd_forward, "o", "-", "estimate"),
            (
                "backward",
                test.backward,
                test.mean_backward,
                test.sd_backward,
                "s",
                DASHED,
                "after",
            ),
        )
        for name, each, mean, sd, marker, dash, colour in ways:
            if each is None:
                continue
            tone = COLOURS[colour]
            label = f"{name}: mean, ± 2 s"
            draw_band(axes, x, mean * fine, 2 * sd * fine, tone, alpha=0.16)
            for run in each.T:
                axes.plot(x, run * fine, ".", color=tone, markersize=2.6, alpha=0.55)
            axes.plot(
                x,
                mean * fine,
                marker=marker,
                linestyle=dash,
                color=tone,
                ms=4.5,
                lw=1.5,
                label=label,
            )
        axes.axhline(0.0, color=COLOURS["line"], linewidth=0.7, zorder=1.5)
        axes.set(
            xlabel=f"target / {coarse_name}", ylabel=f"error (reached − target) / {fine_name}"
        )
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, borderaxespad=0.2)
        axes.text(
            1.02,
            1.0,
            _box(test, fine, fine_name),
            transform=axes.transAxes,
            va="top",
            family="DejaVu Sans Mono",
            fontsize=7.8,
            color=COLOURS["text"],
        )
    return axes


def _positioning_scale(test: PositioningTest) -> tuple[float, str]:
    drawn = [e for e in (test.forward, test.backward) if e is not None]
    largest = max(float(np.nanmax(np.abs(e))) for e in drawn)
    return (1e6, "µm") if largest >= 1e-6 else (1e9, "nm")


def _box(test: PositioningTest, fine: float, unit: str) -> str:
    lines = [f"{'ISO 230-2':<10}{unit:>7}{'u':>7}"]
    for symbol in _SYMBOLS:
        if symbol in test:
            q = test[symbol]
            u = "" if q.u is None else f"{q.u * fine:.2f}"
            lines.append(f"{symbol:<10}{q.value * fine:>7.2f}{u:>7}")
    low, high = test.R_interval
    lines += [
        "",
        "R of many runs",
        f"{'estimate':<10}{test.R_unbiased * fine:>7.2f}",
        f"{100 * test.confidence:g} %: {low * fine:.2f} … {high * fine:.2f}",
    ]
    return "\n".join(lines)
