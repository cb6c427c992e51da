"""Chart of a positioning test after ISO 230-2: both directions with their bands, and the values."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from metrosep.plot.style import COLOURS, DASHED, axes_or_new, house_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from metrosep.separation.positioning_result import PositioningTest

__all__ = ["positioning_chart"]


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
    fine, fine_name = (648000.0 / math.pi, "arcsec") if rotary else _scale(test)
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
            axes.fill_between(
                x, (mean - 2 * sd) * fine, (mean + 2 * sd) * fine, color=tone, alpha=0.16, lw=0
            )
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
        axes.set_xlabel(f"target / {coarse_name}")
        axes.set_ylabel(f"error (reached − target) / {fine_name}")
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


def _scale(test: PositioningTest) -> tuple[float, str]:
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
