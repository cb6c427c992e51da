"""Which figures a result can show, and the two that say most in one picture."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.compensation.area_errors import is_rotary, numbers_of
from metrosep.core._arrays import FloatArray, is_turn
from metrosep.core.errors import DataError
from metrosep.plot.accepted import takes_documents, takes_separations
from metrosep.plot.charts import draw_chart
from metrosep.plot.left_out import left_out_plot, was_predicted
from metrosep.plot.polar import draw_round, stacked
from metrosep.plot.spectra import residual_psd, spectrum
from metrosep.plot.style import (
    BAND_FACTOR,
    COLOURS,
    DASHED,
    DOTTED,
    LINES,
    axes_or_new,
    draw_band,
    house_style,
    length_scale,
    new_figure,
    shades,
    speed_name,
    stated_unit,
    values,
)
from metrosep.separation.contract import Separation

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@takes_documents
def drawable(document: Mapping[str, Any]) -> dict[str, Callable[..., Axes | Figure]]:
    """Return the drawing functions that have something to draw, by name.

    Parameters
    ----------
    document : mapping
        A result (schema ``metrosep.result/1``).

    Returns
    -------
    dict of str to callable
        Any of ``before_after``, ``spectrum``, ``residual_psd``, ``left_out_plot``,
        ``table_plot``, ``separation_parts``, ``chart_1``, ``chart_2`` ..., in this order.
    """
    estimate = document.get("estimate") or {}
    separation = document.get("separation") or {}
    has: dict[Callable[..., Axes | Figure], Any] = {
        before_after: (document.get("plots") or {}).get("x_mm"),
        spectrum: (estimate.get("feed_spectra") or {}).get("feed_mm_min")
        or (estimate.get("spectrum") or {}).get("wavelength_mm"),
        residual_psd: (estimate.get("residual_psd") or {}).get("frequency_hz"),
        left_out_plot: was_predicted(estimate),
        table_plot: (numbers_of(document.get("table")) or {}).get("positions_m"),
        separation_parts: separation.get("parts")
        and len(separation.get("coordinates") or ()) == 1,
    }
    found = {draw.__name__: draw for draw, present in has.items() if present}
    for i, _ in enumerate(charts_of(document)):
        found[f"chart_{i + 1}"] = partial(_chart, number=i)
    return found


@takes_documents
def charts_of(document: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return the charts that a result describes, of its separation and of its plan.

    Parameters
    ----------
    document : mapping
        A result (schema ``metrosep.result/1``).

    Returns
    -------
    list of mapping
        In the order in which a report shows them.
    """
    return [
        chart
        for part in ("separation", "plan")
        for chart in (document.get(part) or {}).get("charts") or []
    ]


def _chart(document: Mapping[str, Any], *, number: int) -> Axes | Figure:
    return draw_chart(charts_of(document)[number])


@takes_documents
def overview(document: Mapping[str, Any]) -> Figure:
    """Return one figure with the error before and after over the spectrum.

    Parameters
    ----------
    document : mapping
        A result (schema ``metrosep.result/1``).

    Returns
    -------
    matplotlib Figure
        Two panels, or one where the result holds no spectra.

    Raises
    ------
    DataError
        If the result holds no curves over position.
    """
    with house_style():
        two = "spectrum" in drawable(document)
        figure = new_figure((8.0, 7.2 if two else 4.2))
        before_after(document, figure.add_subplot(2 if two else 1, 1, 1))
        if two:
            spectrum(document, figure.add_subplot(2, 1, 2))
    return figure


# ---- the error over position: estimate with its band, and each feedrate before and after -------


@takes_documents
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
        axes.set(xlabel="position / mm", ylabel=f"error (actual − nominal) / {unit}")
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
        draw_band(axes, x, error, half, colour, zorder=3)
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


# ---- readings and parts of a separation over position or angle: the quartet, and parts with bands ----

_SCALES = (
    ("m", ((1.0, "m"), (1e3, "mm"), (1e6, "µm"), (1e9, "nm"))),
    ("rad", ((1.0, "rad"), (1e3, "mrad"), (1e6, "µrad"), (1e9, "nrad"))),
)


@takes_separations
def reversal_quartet(
    separation: Separation, readings: ArrayLike, *, names: Sequence[str] = ("m1", "m2")
) -> Figure:
    """Return four panels: both readings above, both parts below, on common scales.

    Parameters
    ----------
    separation : Separation
        Of a reversal, with two parts.
    readings : array_like, shape (2, n) or (2, M, n), m
        What was separated.
    names : sequence of str, optional
        Of the readings.

    Returns
    -------
    matplotlib Figure
        Readings share one height scale, without their mean; parts share another, with a band of
        two standard uncertainties.

    Raises
    ------
    DataError
        If the separation does not have two parts, or the readings another length.
    """
    array = np.asarray(readings, dtype=np.float64)
    if len(separation.parts) != 2:
        raise DataError(f"a quartet shows two parts, this has {', '.join(separation.parts)}")
    x, label = _abscissa(separation)
    if array.ndim not in (2, 3) or array.shape[0] != 2 or array.shape[-1] != x.size:
        raise DataError(f"readings must be (2, {x.size}) or (2, M, {x.size}), got {array.shape}")
    with house_style():
        figure = new_figure((8.0, 5.6))
        grid = figure.subplots(2, 2, sharex=True, sharey="row")
        repeats = array if array.ndim == 3 else array[:, None]
        centred = repeats - np.nanmean(repeats, axis=2, keepdims=True)
        factor, unit = _scale([centred], "m")
        for axes, curves, name in zip(grid[0], centred, names, strict=True):
            for curve in curves:
                axes.plot(x, curve * factor, color=COLOURS["before"], linewidth=0.8)
            axes.set_title(f"reading {name}", loc="left", fontsize=9.5)
        grid[0][0].set_ylabel(f"reading / {unit}")
        _draw_parts(list(grid[1]), separation, x)
        for axes in grid[1]:
            _label_abscissa(axes, label)
    return figure


@takes_separations
def parts_plot(
    separation: Separation, ax: Axes | None = None, *, unit: str | None = None
) -> Figure | Axes:
    """Return the parts of a separation over position or angle, one panel each.

    Parameters
    ----------
    separation : Separation
        Whose parts are curves.
    ax : matplotlib Axes, optional
        Axes to draw into, for a separation of one part.
    unit : str, optional
        Unit of the values, such as "nm"; one in which they read well if omitted.

    Returns
    -------
    matplotlib Figure or Axes
        A panel for each part with a band of two standard uncertainties where they are known, over a whole
        turn with the part about a circle beside it; the given axes where there were some.

    Raises
    ------
    DataError
        If the parts are maps, or axes were given for several parts.
    """
    x, label = _abscissa(separation)
    shown = {k: v for k, v in separation.parts.items() if v.shape == x.shape}
    if ax is not None and len(shown) != 1:
        raise DataError(f"one axes cannot hold {len(shown)} parts; leave out ax")
    with house_style():
        if ax is not None:
            _draw_parts([ax], separation, x, unit)
            _label_abscissa(ax, label)
            return ax
        turns = label.startswith("angle") and is_turn(np.radians(x))
        figure = new_figure((7.2, 0.6 + (2.6 if turns else 2.1) * len(shown)))
        panels, places = stacked(figure, len(shown), len(shown) if turns else 0)
        printed = _draw_parts(panels, separation, x, unit)
        if turns:
            _draw_about(places, separation, shown, x, printed)
        _label_abscissa(panels[-1], label)
    return figure


def _draw_about(
    places: Sequence[Axes],
    separation: Separation,
    shown: Mapping[str, FloatArray],
    x: FloatArray,
    printed: Sequence[tuple[float, str]],
) -> None:
    """Draw each part about a circle, those of one unit enlarged alike."""
    most: dict[str, float] = {}
    for name, drawn in shown.items():
        size = float(np.nanmax(np.abs(drawn))) if np.isfinite(drawn).any() else 0.0
        most[separation.units[name]] = max(most.get(separation.units[name], 0.0), size)
    for i, (axes, (name, drawn)) in enumerate(zip(places, shown.items(), strict=True)):
        colour, largest = COLOURS[LINES[i % len(LINES)]], most[separation.units[name]]
        draw_round(axes, [("", np.radians(x), drawn)], [colour], printed[i], largest=largest)


@takes_documents
def separation_parts(document: Mapping[str, Any]) -> Figure:
    """Return the parts of a stored separation, as `parts_plot` draws them.

    Parameters
    ----------
    document : mapping
        A result (schema ``metrosep.result/1``) of a named separation.

    Returns
    -------
    matplotlib Figure
        One panel for each part.

    Raises
    ------
    DataError
        If the result holds no separation of curves.
    """
    from matplotlib.figure import Figure

    separation = document.get("separation")
    if not separation:
        raise DataError("this result holds no separation: nothing to draw")
    drawn = parts_plot(Separation.from_dict(separation))
    if not isinstance(drawn, Figure):
        raise DataError("the parts of this separation are not curves")
    return drawn


def _draw_parts(
    panels: Sequence[Axes], separation: Separation, x: FloatArray, stated: str | None = None
) -> list[tuple[float, str]]:
    """Draw each part over the positions; return factor and unit of each panel."""
    printed = []
    shown = {k: v for k, v in separation.parts.items() if v.shape == x.shape}
    groups: dict[str, list[FloatArray]] = {}
    for name, drawn in shown.items():
        groups.setdefault(separation.units[name], []).append(drawn)
    for i, (axes, (name, drawn)) in enumerate(zip(panels, shown.items(), strict=True)):
        factor, unit = _scale(groups[separation.units[name]], separation.units[name])
        if stated is not None:
            unit, size = stated_unit(stated, separation.units[name])
            factor = 1.0 / size
        printed.append((factor, unit))
        colour = COLOURS[LINES[i % len(LINES)]]
        half = BAND_FACTOR * separation.u[name]
        text = name.replace("_", " ")
        if np.isfinite(half).any():
            draw_band(axes, x, drawn * factor, half * factor, colour)
            text += f" ± {BAND_FACTOR:.0f} u"
        else:
            text += " (u not known)"
        axes.plot(x, drawn * factor, color=colour, linewidth=1.4)
        axes.axhline(0.0, color=COLOURS["line"], linewidth=0.7, linestyle=DASHED, zorder=1.5)
        axes.set_title(text, loc="left", fontsize=9.5)
        place = axes.get_subplotspec()
        if place is None or place.is_first_col():
            axes.set_ylabel(
                f"{'deviation' if separation.units[name].endswith('m') else 'angle'} / {unit}"
            )
    return printed


def _abscissa(separation: Separation) -> tuple[FloatArray, str]:
    coordinates: Mapping[str, FloatArray] = separation.coordinates
    if len(coordinates) != 1:
        raise DataError("the parts are maps; use separation_maps")
    ((name, positions),) = coordinates.items()
    if name == "angle":
        return np.degrees(positions), "angle / °"
    return positions * 1e3, "position / mm"


def _label_abscissa(axes: Axes, label: str) -> None:
    axes.set_xlabel(label)
    if label.startswith("angle"):
        from matplotlib.ticker import MultipleLocator

        axes.xaxis.set_major_locator(MultipleLocator(90.0))


def _scale(curves: Sequence[FloatArray], unit: str) -> tuple[float, str]:
    """Return factor and name of the unit in which the largest value reads well."""
    sizes = [float(np.nanmax(np.abs(c))) for c in curves if np.isfinite(c).any()]
    largest = max(sizes, default=0.0)
    for base, steps in _SCALES:
        if base == unit:
            for factor, name in steps:
                if largest * factor >= 2.0:
                    return factor, name
            return steps[-1] if largest > 0.0 else steps[2]
    return 1.0, unit


# ---- the compensation table as a controller interpolates it ------------------------------------


@takes_documents
def table_plot(
    document: Mapping[str, Any], ax: Axes | None = None, *, unit: str | None = None
) -> Axes:
    """Return axes with the corrections of the table over position.

    Parameters
    ----------
    document : mapping
        A result (schema ``metrosep.result/1``).
    ax : matplotlib Axes, optional
        Axes to draw into; new ones if omitted.
    unit : str, optional
        Unit of the values, such as "nm"; one in which they read well if omitted.

    Returns
    -------
    matplotlib Axes
        Position in mm, or in degrees; correction c = -e that is added to the command, in nm, or in µm
        where it is large, or in µrad; one point for each entry, joined as the controller joins them.

    Raises
    ------
    DataError
        If the result holds no table.
    """
    table = numbers_of(document.get("table"))
    if not table or not table.get("positions_m"):
        raise DataError("this result holds no compensation table: nothing to draw")
    with house_style():
        axes = axes_or_new(ax, size=(7.2, 3.2))
        turns = [is_rotary(str(table.get(k) or "X")) for k in ("axis", "compensates")]
        place, where = (180.0 / np.pi, "deg") if turns[0] else (1e3, "mm")
        x = values(table["positions_m"]) * place
        forward, reverse = (values(table.get(k)) * 1e9 for k in ("forward_m", "reverse_m"))
        scale, name = (1e-3, "µrad") if turns[1] else length_scale(forward, reverse)
        if unit is not None:
            name, factor = stated_unit(unit, "rad" if turns[1] else "m")
            scale = 1e-9 / factor
        axes.axhline(0.0, color=COLOURS["line"], linewidth=0.7, zorder=1.5)
        both = reverse.size == 0
        axes.plot(
            x,
            forward * scale,
            color=COLOURS["estimate"],
            marker="o",
            markersize=3.2,
            linewidth=1.2,
            label="correction, both directions" if both else "correction, forward",
        )
        if not both:
            axes.plot(
                x,
                reverse * scale,
                color=COLOURS["reverse"],
                marker="s",
                markersize=3.2,
                markerfacecolor="white",
                linewidth=1.2,
                linestyle=DASHED,
                label="correction, reverse",
            )
        if table.get("reference_m") is not None:
            axes.axvline(
                table["reference_m"] * place,
                color=COLOURS["after"],
                linewidth=1.0,
                linestyle=DOTTED,
                label="reference (zero correction)",
            )
        axis, target = table.get("axis") or "axis", table.get("compensates") or "axis"
        axes.set(
            xlabel=f"position of {axis} / {where}", ylabel=f"correction added to {target} / {name}"
        )
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, borderaxespad=0.3)
    return axes
