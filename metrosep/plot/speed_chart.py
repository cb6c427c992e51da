"""Chart of spindle values against speed, with fits, confidence bands and critical speeds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from metrosep.plot.harmonics import readable_unit
from metrosep.plot.style import BAND_FACTOR, COLOURS, DASHED, DOTTED, axes_or_new, house_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from metrosep.separation.speed_sweep import SpeedSweep

__all__ = ["speed_plot"]

_MARKS = ("o", "s", "^", "D")
_COLOURS = ("estimate", "after", "reverse", "before")


def speed_plot(
    sweep: SpeedSweep, ax: Axes | None = None, *, symbols: Sequence[str] | None = None
) -> Axes:
    """Draw values against speed with their fits and 95 % intervals.

    Parameters
    ----------
    sweep : SpeedSweep
        From `fit_speed_sweep`.
    ax : matplotlib Axes, optional
        Where to draw; a new figure by default.
    symbols : sequence of str, optional
        Which values; all by default.

    Returns
    -------
    matplotlib Axes
        Speed in rev/min.
    """
    names = list(sweep.fits) if symbols is None else list(symbols)
    largest = max((float(sweep[n].values.max()) for n in names), default=0.0)
    scale, unit = readable_unit(largest, sweep[names[0]].unit if names else "m")
    fine = np.linspace(float(sweep.speed[0]), float(sweep.speed[-1]), 300)
    with house_style():
        axes = axes_or_new(ax)
        for i, name in enumerate(names):
            fit = sweep[name]
            colour = COLOURS[_COLOURS[i % len(_COLOURS)]]
            axes.errorbar(
                60.0 * sweep.speed,
                fit.values * scale,
                yerr=BAND_FACTOR * np.nan_to_num(fit.u) * scale,
                fmt=_MARKS[i % len(_MARKS)],
                ms=4.5,
                color=colour,
                elinewidth=1.0,
                capsize=2.0,
                label=name.replace("_", " "),
            )
            line, half = fit.evaluate(fine), fit.half_width(fine)
            axes.plot(60.0 * fine, line * scale, color=colour, lw=1.4, ls=DASHED if i else "-")
            axes.fill_between(
                60.0 * fine,
                (line - half) * scale,
                (line + half) * scale,
                color=colour,
                alpha=0.15,
                lw=0,
            )
        axes.set_ylim(bottom=0.0)
        _critical(axes, sweep)
        axes.set_xlabel("speed in rev/min")
        axes.set_ylabel(f"error motion in {unit}")
        axes.legend(
            loc="upper center",
            bbox_to_anchor=(0.5, -0.15),
            ncols=4,
            title="bars ± 2 u, bands 95 %",
            title_fontsize=8.5,
        )
    return axes


def _critical(axes: Axes, sweep: SpeedSweep) -> None:
    """Mark the speeds whose orders meet the natural frequency."""
    for k, speed in sweep.critical.items():
        if sweep.speed[0] <= speed <= sweep.speed[-1]:
            axes.axvline(60.0 * speed, color=COLOURS["line"], lw=0.9, ls=DOTTED)
            axes.annotate(
                f"k={k}",
                (60.0 * speed, 1.0),
                xycoords=("data", "axes fraction"),
                xytext=(3, -2),
                textcoords="offset points",
                ha="left",
                va="bottom",
                fontsize=8,
            )
