"""Drift over time with its ranges, and the Allan deviation of a reading."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.plot.style import COLOURS, DASHED, DOTTED, axes_or_new, house_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from metrosep.separation.drift import DriftTest

__all__ = ["allan_plot", "drift_chart"]


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
        Result of `metrosep.separation.drift.iso230_3_drift`.
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
        axes.set_xlabel(f"time / {time_unit}")
        axes.set_ylabel(f"drift / {unit}")
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
        As `metrosep.separation.drift.allan_deviation` gives it.
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
        axes.set_xscale("log")
        axes.set_yscale("log")
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
        axes.set_xlabel("averaging time / s")
        axes.set_ylabel(f"Allan deviation / {unit}")
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, borderaxespad=0.2)
    return axes
