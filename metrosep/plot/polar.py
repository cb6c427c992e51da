"""Polar chart of a spindle test: total, synchronous and asynchronous motion about the centre.

Drawn on plain axes with equal scales, so that the chart fits beside others. The base circle carries
no meaning: motion is added to it with the magnification that the division tells.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.plot.style import COLOURS, DASHED, DOTTED, axes_or_new, house_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from metrosep.machine import CircleTest
    from metrosep.separation.circles.spindle_result import SpindleMotion

_INNER = 2.2
"""Base circle in units of the largest motion: the chart keeps a hole."""

_ORDER = ("synchronous", "asynchronous", "total")

_MOST_LINES = 200
"""Revolutions drawn one by one; beyond, every second, third, ..."""


def polar_plot(
    result: SpindleMotion, ax: Axes | None = None, *, division: float | None = None
) -> Axes:
    """Draw all revolutions, their band, the synchronous motion and its two circles.

    Parameters
    ----------
    result : SpindleMotion
        From `iso230_7`.
    ax : matplotlib Axes, optional
        Where to draw; a new figure by default.
    division : float, m or rad, optional
        Distance of the grid circles (the magnification); a round number by default.

    Returns
    -------
    matplotlib Axes
        With the chart; radial lengths in the unit that the text names.
    """
    with house_style():
        axes = axes_or_new(ax, size=(6.4, 6.9))
        largest = float(np.abs(result.motion).max())
        scale, unit = readable_unit(largest, result.unit)
        size = largest * scale or 1.0
        step = _round_step(size) if division is None else division * scale
        base = step * math.ceil(_INNER * size / step)
        outer = base + step * math.ceil(size / step)
        _grid(axes, base, step, outer)
        angle = np.append(result.angle, result.angle[0])
        _revolutions(axes, result, angle, base, scale)
        curve = base + scale * _closed(result.synchronous_motion)
        axes.plot(
            curve * np.cos(angle),
            curve * np.sin(angle),
            color=COLOURS["after"],
            lw=1.8,
            label=f"synchronous {_text(result.synchronous.value, scale, unit)}",
            zorder=4,
        )
        for limit in (result.synchronous_motion.max(), result.synchronous_motion.min()):
            _circle(axes, base + scale * float(limit), color=COLOURS["text"], ls=DASHED, lw=0.9)
        arm = 0.06 * outer
        for x, y in (([-arm, arm], [0, 0]), ([0, 0], [-arm, arm])):
            axes.plot(x, y, color=COLOURS["text"], lw=1.2)
        axes.annotate(
            result.center, (0, 0), xytext=(4, 4), textcoords="offset points", fontsize=8.5
        )
        _dress(axes, result, outer, f"division {step:.4g} {unit}")
    return axes


def circle_chart(test: CircleTest, ax: Axes | None = None) -> Axes:
    """Draw both runs of a circular test about their common centre, and the fitted errors.

    Parameters
    ----------
    test : CircleTest
        From `metrosep.machine.circle_test`.
    ax : matplotlib Axes, optional
        Where to draw; a new figure by default.

    Returns
    -------
    matplotlib Axes
        Deviations of the radius on a circle without meaning; outwards is a larger radius.
    """
    with house_style():
        axes = axes_or_new(ax, size=(6.4, 6.9))
        largest = max(float(np.nanmax(np.abs(r))) for r in test.measured.values())
        scale, unit = readable_unit(largest, "m")
        step = _round_step(largest * scale or 1.0)
        base = step * math.ceil(_INNER * (largest * scale or 1.0) / step)
        outer = base + step * math.ceil((largest * scale or 1.0) / step)
        _grid(axes, base, step, outer)
        order = np.argsort(test.angle)
        angle = _closed(test.angle[order])
        for sense, colour in (("ccw", "estimate"), ("cw", "reverse")):
            if sense not in test.measured:
                continue
            text = f"{sense}: G {_text(test.G[sense].value, scale, unit)}"
            read = test.measured[sense]
            for values, style in (
                (read, {"lw": 1.4, "label": text}),
                (read - test.residual[sense], {"lw": 0.9, "ls": DASHED, "color": COLOURS["text"]}),
            ):
                radius = base + scale * _closed(values[order])
                line = {"color": COLOURS[colour], "zorder": 4, **style}
                axes.plot(radius * np.cos(angle), radius * np.sin(angle), **line)
        one, two = test.plane[0], test.plane[1]
        for name, x, y in ((f"+{one}", 1.22, 0.0), (f"+{two}", 0.0, 1.22)):
            axes.text(x * outer, y * outer, name, ha="center", va="center", weight="bold")
        axes.set(xlim=(-1.3 * outer, 1.3 * outer), ylim=(-1.3 * outer, 1.3 * outer))
        axes.set_aspect("equal")
        axes.axis("off")
        axes.set_title(
            f"circle {test.plane}, division {step:.4g} {unit}; dashed: fitted errors", y=0.98
        )
        axes.legend(loc="lower center", bbox_to_anchor=(0.5, -0.02), ncols=2)
    return axes


def stacked(figure: Figure, n: int, turns: int) -> tuple[list[Axes], list[Axes]]:
    """Return n panels below each other, and places beside the first of them for pictures about a circle."""
    cells = figure.add_gridspec(n, 2 if turns else 1, width_ratios=[1.55, 1.0] if turns else [1.0])
    panels = [figure.add_subplot(cells[0, 0])]
    panels += [figure.add_subplot(cells[i, 0], sharex=panels[0]) for i in range(1, n)]
    for axes in panels[:-1]:
        axes.tick_params(labelbottom=False)
    return panels, [figure.add_subplot(cells[i, 1]) for i in range(turns)]


def draw_round(
    axes: Axes,
    curves: Sequence[tuple[str, FloatArray, FloatArray]],
    colours: Sequence[str],
    printed: tuple[float, str],
    *,
    largest: float,
) -> None:
    """Draw curves over a turn (label, rad, values) about a circle, one alone between its two circles.

    A gap of ten usual steps stays open. Values up to `largest` are enlarged alike in all pictures.
    """
    scale, unit = printed
    size = largest * scale or 1.0
    step = _round_step(size)
    base = step * math.ceil(_INNER * size / step)
    outer = base + step * math.ceil(size / step)
    _grid(axes, base, step, outer)
    for (label, angle, values), colour in zip(curves, colours, strict=True):
        order = np.argsort(np.mod(angle, 2.0 * np.pi), kind="stable")
        turn = np.append(
            np.mod(angle, 2.0 * np.pi)[order], np.mod(angle, 2.0 * np.pi)[order][0] + 2.0 * np.pi
        )
        steps = np.diff(turn)
        gaps = np.flatnonzero(steps > _GAP * np.median(steps)) + 1
        turn = np.insert(turn, gaps, np.nan)
        radius = np.insert(base + scale * _closed(values[order]), gaps, np.nan)
        axes.plot(
            radius * np.cos(turn),
            radius * np.sin(turn),
            color=colour,
            lw=1.3,
            zorder=4,
            label=label or None,
        )
        if len(curves) == 1 and np.isfinite(values).any():
            for end in (np.nanmin(values), np.nanmax(values)):
                _circle(axes, base + scale * float(end), color=COLOURS["line"], ls=DASHED, lw=0.8)
    axes.set(xlim=(-1.25 * outer, 1.25 * outer), ylim=(-1.25 * outer, 1.25 * outer))
    axes.set_aspect("equal")
    axes.axis("off")
    axes.set_title(f"division {step:.4g} {unit}", fontsize=8.5)


_GAP = 10.0
"""Usual steps: a gap so wide in a turn was not measured."""


def _round_step(size: float) -> float:
    """Return 1, 2 or 5 times a power of ten: two to four divisions for the motion."""
    rough = size / 2.0
    decade = 10.0 ** math.floor(math.log10(rough))
    return max(f * decade for f in (1.0, 2.0, 5.0) if f * decade <= rough * (1.0 + 1e-12))


def _text(value: float, scale: float, unit: str) -> str:
    return f"{value * scale:.3g} {unit}"


def _closed(curve: FloatArray) -> FloatArray:
    return np.append(curve, curve[..., :1], axis=-1)


def _circle(axes: Axes, radius: float, *, color: str, ls: object, lw: float) -> None:
    from matplotlib.patches import Circle

    axes.add_patch(Circle((0.0, 0.0), radius, fill=False, ec=color, ls=ls, lw=lw, zorder=3))


def _grid(axes: Axes, base: float, step: float, outer: float) -> None:
    count = round(outer / step)
    first = round(base / step) - (count - round(base / step))
    for i in range(max(first, 1), count + 1):
        is_base = i == round(base / step)
        colour = COLOURS["line"] if is_base else "#D8D8D8"
        _circle(axes, i * step, color=colour, ls=DOTTED if is_base else "solid", lw=0.7)
    for degrees in range(0, 360, 30):
        c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
        inner = max(first, 1) * step
        axes.plot(
            [inner * c, outer * c], [inner * s, outer * s], color="#D8D8D8", lw=0.6, zorder=1
        )
        axes.text(
            1.07 * outer * c, 1.07 * outer * s, f"{degrees}°", ha="center", va="center", fontsize=8
        )


def _revolutions(
    axes: Axes, result: SpindleMotion, angle: FloatArray, base: float, scale: float
) -> None:
    from matplotlib.collections import LineCollection

    motion = result.motion
    low, high = (
        base + scale * _closed(motion.min(axis=0)),
        base + scale * _closed(motion.max(axis=0)),
    )
    axes.fill(
        np.concatenate([high * np.cos(angle), (low * np.cos(angle))[::-1]]),
        np.concatenate([high * np.sin(angle), (low * np.sin(angle))[::-1]]),
        color=COLOURS["estimate"],
        alpha=0.18,
        lw=0,
        zorder=2,
        label=f"total {_text(result.total.value, *_pair(scale, result))}",
    )
    some = motion[:: math.ceil(motion.shape[0] / _MOST_LINES)]
    radius = base + scale * _closed(some)
    lines = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
    axes.add_collection(
        LineCollection(
            list(lines), colors=COLOURS["estimate"], linewidths=0.25, alpha=0.5, zorder=2
        )
    )
    j = int(np.argmax(result.asynchronous_range))
    at = [low[j], high[j]]
    axes.plot(
        np.multiply(at, math.cos(angle[j])),
        np.multiply(at, math.sin(angle[j])),
        color=COLOURS["reverse"],
        lw=2.4,
        solid_capstyle="butt",
        zorder=5,
        label=f"asynchronous {_text(result.asynchronous.value, *_pair(scale, result))}",
    )


def _pair(scale: float, result: SpindleMotion) -> tuple[float, str]:
    return scale, readable_unit(float(np.abs(result.motion).max()), result.unit)[1]


def _dress(axes: Axes, result: SpindleMotion, outer: float, division: str) -> None:
    axes.set(
        aspect="equal", xlim=(-1.16 * outer, 1.16 * outer), ylim=(-1.32 * outer, 1.36 * outer)
    )
    axes.set_axis_off()
    axes.text(
        0.0,
        1.34 * outer,
        f"{result.direction} error motion, {result.sensitive} sensitive direction, "
        f"{result.n_revolutions} revolutions\n{division}; dashed: circles of the synchronous value",
        ha="center",
        va="top",
        fontsize=9.5,
    )
    handles, labels = axes.get_legend_handles_labels()
    order = sorted(range(len(labels)), key=lambda i: _ORDER.index(labels[i].split()[0]))
    axes.legend(
        [handles[i] for i in order],
        [labels[i] for i in order],
        loc="lower center",
        ncols=3,
        columnspacing=1.4,
    )


# ---- bars over harmonics: amplitudes with uncertainty, suppressed harmonics hatched and without bar ----

_UNITS = {
    "m": ((1e-6, 1e6, "µm"), (1e-9, 1e9, "nm"), (0.0, 1e12, "pm")),
    "rad": ((1e-6, 1e6, "µrad"), (1e-9, 1e9, "nrad"), (0.0, 1e12, "prad")),
}


def readable_unit(largest: float, unit: str) -> tuple[float, str]:
    """Return factor and name of the unit in which the largest value reads well.

    Examples
    --------
    >>> readable_unit(2.5e-8, "m")
    (1000000000.0, 'nm')
    """
    for least, factor, name in _UNITS.get(unit, ()):
        if largest >= 2.0 * least:
            return factor, name
    return 1.0, unit


def harmonic_bars(
    k: ArrayLike,
    amplitude: ArrayLike,
    u: ArrayLike | None = None,
    suppressed: Collection[int] = (),
    unit: str = "m",
    ax: Axes | None = None,
    *,
    limit: int | None = 60,
    label: str = "amplitude",
) -> Axes:
    """Draw amplitudes over undulations per revolution.

    Parameters
    ----------
    k : array_like of int, shape (h,)
        Undulations per revolution.
    amplitude : array_like, shape (h,)
        In `unit`; NaN draws nothing.
    u : array_like, shape (h,), optional
        Standard uncertainty; whiskers of two of them on each side.
    suppressed : collection of int, optional
        Harmonics that the method cannot see or has removed: a hatched strip instead of a bar.
    unit : str, optional
        ``"m"`` or ``"rad"``, drawn in nm, µrad and so on.
    ax : matplotlib Axes, optional
        Where to draw; a new figure by default.
    limit : int, optional
        Highest k drawn; ``None`` for all.
    label : str, optional
        Of the vertical axis, without unit.

    Returns
    -------
    matplotlib Axes
        With the bars.

    Raises
    ------
    DataError
        If lengths differ.
    """
    orders = np.asarray(k, dtype=np.intp)
    sizes = np.asarray(amplitude, dtype=np.float64)
    spread = np.full(sizes.shape, np.nan) if u is None else np.asarray(u, dtype=np.float64)
    if orders.ndim != 1 or sizes.shape != orders.shape or spread.shape != orders.shape:
        raise DataError(
            f"k, amplitude and u must be equally long: {orders.shape}, {sizes.shape}, {spread.shape}"
        )
    keep = orders <= (orders.max(initial=0) if limit is None else limit)
    orders, sizes, spread = orders[keep], sizes[keep], spread[keep]
    hidden = np.isin(orders, list(suppressed))
    shown = ~hidden & ~np.isnan(sizes)
    tops = sizes[shown] + 2.0 * np.nan_to_num(spread[shown])
    largest = float(tops.max(initial=0.0))
    scale, name = readable_unit(largest, unit)
    with house_style():
        axes = axes_or_new(ax)
        height = 1.12 * largest * scale or 1.0
        if hidden.any():
            axes.bar(
                orders[hidden],
                height,
                width=0.9,
                fc="none",
                ec="#9A9A9A",
                lw=0.0,
                hatch="////",
                label="not seen or removed",
            )
        axes.bar(orders[shown], sizes[shown] * scale, width=0.72, color=COLOURS["estimate"])
        if np.isfinite(spread[shown]).any():
            axes.errorbar(
                orders[shown],
                sizes[shown] * scale,
                yerr=2.0 * spread[shown] * scale,
                fmt="none",
                ecolor=COLOURS["text"],
                elinewidth=0.9,
                capsize=1.5,
                label="± 2 standard uncertainties",
            )
        _harmonics_dress(axes, orders, height, f"{label} in {name}")
    return axes


def _harmonics_dress(axes: Axes, orders: NDArray[np.intp], height: float, label: str) -> None:
    from matplotlib.ticker import MaxNLocator

    axes.set(xlabel="undulations per revolution k", ylabel=label, ylim=(0.0, height))
    if orders.size:
        axes.set_xlim(float(orders.min()) - 0.7, float(orders.max()) + 0.7)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, steps=[1, 2, 5, 10]))
    axes.grid(axis="x", visible=False)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="upper right")
