"""Figures of a feed plan: predicted sd over wavelength, and the density with the plan's feeds."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.plot.style import COLOURS, DASHED, DOTTED, axes_or_new, house_style, shades
from metrosep.separation.planner_result import FeedPlan

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["plan_density", "plan_sd"]


_LINES = 2001
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
            ("sd_even_feeds_nm", "evenly spread feeds", COLOURS["after"], DASHED),
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
        axes.set_xscale("log")
        axes.set_yscale("log")
        _plain_ticks(axes)
        axes.set_xlabel("wavelength / mm")
        axes.set_ylabel("sd of an amplitude coefficient / nm")
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
    f = np.geomspace(low, min(high, plan.density.highest), _LINES)
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
            axes.annotate(
                f"{wave * 1e3:.3g} mm",
                (float(at.max()), height),
                xytext=(7, 0),
                textcoords="offset points",
                va="center",
                fontsize=8.0,
            )
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlim(low, high * 1.3)
        axes.set_ylim(float(np.nanmin(s)) * 0.7, top * 3.0 * 2.6 ** len(chosen))
        _plain_ticks(axes, which="x")
        axes.set_xlabel("frequency / Hz")
        axes.set_ylabel("density / (nm²/Hz)")
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
