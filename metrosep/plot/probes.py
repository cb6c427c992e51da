"""Figures of multi-probe and multi-step set-ups: what an arrangement sees, and where probes disagree."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.plot.style import COLOURS, DASHED, DOTTED, axes_or_new, house_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from metrosep.separation.contract import Separation
    from metrosep.separation.probe_angles import ProbeAngles
    from metrosep.separation.probe_check import ProbeCheck

__all__ = ["probe_gain_chart", "probe_layout", "probe_residuals"]


_CEILING = 10.0
"""Gains above are drawn at the ceiling and hatched: nobody uses such a harmonic."""


def probe_gain_chart(
    result: ProbeAngles | Separation, *, compare: Any = None, ax: Axes | None = None
) -> Axes:
    """Draw the noise gain against undulation, suppressed ones hatched.

    Parameters
    ----------
    result : ProbeAngles or Separation
        Of `optimise_probe_angles`, or of `multiprobe` or `multistep` (its audit holds the gain).
    compare : ProbeAngles or Separation, optional
        Another arrangement, drawn as a line.
    ax : matplotlib Axes, optional
        Where to draw; a new figure if omitted.

    Returns
    -------
    matplotlib Axes
        Gain over k from 2; the limit ``1/sqrt(n)`` dotted.

    Raises
    ------
    DataError
        If the result has no gain.
    """
    angles, gain = _gain_of(result)
    k = np.arange(2, gain.size)
    shown = np.minimum(gain[2:], _CEILING)
    hidden = ~np.isfinite(gain[2:])
    with house_style():
        axes = axes_or_new(ax)
        axes.bar(
            k[~hidden], shown[~hidden], width=0.72, color=COLOURS["estimate"], label=_name(angles)
        )
        if hidden.any():
            axes.bar(
                k[hidden],
                np.full(int(hidden.sum()), _CEILING),
                width=0.72,
                facecolor="none",
                edgecolor=COLOURS["before"],
                hatch="////",
                linewidth=0.6,
                label="suppressed",
            )
        if compare is not None:
            others, second = _gain_of(compare)
            line = np.where(np.isfinite(second[2:]), np.minimum(second[2:], _CEILING), np.nan)
            axes.plot(
                np.arange(2, second.size),
                line,
                color=COLOURS["after"],
                linestyle=DASHED,
                linewidth=1.3,
                label=_name(others),
            )
        limit = 1.0 / math.sqrt(len(angles))
        axes.axhline(limit, color=COLOURS["text"], linestyle=DOTTED, linewidth=1.2)
        axes.annotate(
            "1/√n",
            (1.0, limit),
            xycoords=("axes fraction", "data"),
            xytext=(3, 0),
            textcoords="offset points",
            va="center",
            fontsize=8.0,
            annotation_clip=False,
        )
        axes.set_yscale("log")
        axes.set_ylim(0.8 * limit, 1.25 * _CEILING)
        axes.set_yticks([0.5, 1.0, 2.0, 5.0, 10.0], ["0.5", "1", "2", "5", "≥ 10"])
        axes.minorticks_off()
        axes.set_xlim(1.0, k[-1] + 1.0)
        axes.set_xlabel("undulations per revolution k")
        axes.set_ylabel("noise gain of the artefact")
        axes.grid(visible=False, axis="x")
        axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    return axes


def probe_layout(result: ProbeAngles | Separation, *, ax: Axes | None = None) -> Axes:
    """Draw where the probes stand round the artefact, numbered from 0 as the rows of readings.

    Parameters
    ----------
    result : ProbeAngles or Separation
        With probe angles.
    ax : matplotlib Axes, optional
        Where to draw; a new figure if omitted.

    Returns
    -------
    matplotlib Axes
        +X to the right, +Y up, angles counter-clockwise.

    Raises
    ------
    DataError
        If the result has no probe angles.
    """
    angles, _ = _gain_of(result)
    with house_style():
        axes = axes_or_new(ax, size=(4.0, 4.0))
        around = np.linspace(0.0, 2.0 * np.pi, 361)
        axes.fill(
            np.cos(around), np.sin(around), facecolor=COLOURS["zone"], edgecolor=COLOURS["line"]
        )
        for i, angle in enumerate(angles):
            direction = np.array([math.cos(angle), math.sin(angle)])
            start = 1.45 * direction
            axes.annotate(
                "",
                xy=tuple(1.02 * direction),
                xytext=tuple(start),
                arrowprops={"arrowstyle": "-|>", "color": COLOURS["after"], "linewidth": 1.6},
            )
            axes.text(
                float(1.66 * direction[0]),
                float(1.66 * direction[1]),
                f"{i}\n{math.degrees(angle):.4g}°",
                ha="center",
                va="center",
                fontsize=8.0,
                gid="probe",
            )
        axes.plot([0.0, 0.45], [0.0, 0.0], color=COLOURS["text"], linewidth=1.0)
        axes.plot([0.0, 0.0], [0.0, 0.45], color=COLOURS["text"], linewidth=1.0)
        axes.text(0.5, 0.0, "+X", va="center", fontsize=8.0)
        axes.text(0.0, 0.52, "+Y", ha="center", fontsize=8.0)
        axes.set_xlim(-2.0, 2.0)
        axes.set_ylim(-2.0, 2.0)
        axes.set_aspect("equal")
        axes.set_axis_off()
    return axes


def probe_residuals(result: ProbeCheck, *, ax: Axes | None = None) -> Axes:
    """Draw by how much more than three probes disagree, undulation by undulation.

    Parameters
    ----------
    result : ProbeCheck
        Of `check_probes`.
    ax : matplotlib Axes, optional
        Where to draw; a new figure if omitted.

    Returns
    -------
    matplotlib Axes
        Chi-square over its expectation; 1 is noise alone.
    """
    share = result.chi2_per_k
    k = np.arange(share.size)
    known = np.isfinite(share)
    with house_style():
        axes = axes_or_new(ax)
        axes.bar(k[known], np.maximum(share[known], 1e-2), width=0.72, color=COLOURS["estimate"])
        axes.axhline(1.0, color=COLOURS["text"], linestyle=DOTTED, linewidth=1.2)
        axes.set_yscale("log")
        axes.set_xlabel("undulations per revolution k")
        axes.set_ylabel("χ² / degrees of freedom")
        axes.set_title(result.message, fontsize=9.0, loc="left")
        axes.grid(visible=False, axis="x")
    return axes


def _gain_of(result: Any) -> tuple[tuple[float, ...], FloatArray]:
    """Return the angles and the gain from k = 0; inf where suppressed."""
    if hasattr(result, "gain_per_k"):
        return tuple(result.angles.tolist()), np.asarray(result.gain_per_k, dtype=np.float64)
    audit = getattr(result, "audit", {})
    if "gain" not in audit or "angles_deg" not in audit:
        raise DataError(
            "this result has no noise gain per undulation; give one of optimise_probe_angles, "
            "multiprobe or multistep"
        )
    gain = np.array([math.inf if g is None else g for g in audit["gain"]], dtype=np.float64)
    return tuple(math.radians(a) for a in audit["angles_deg"]), gain


def _name(angles: tuple[float, ...]) -> str:
    if len(angles) > 6:
        return f"{len(angles)} positions"
    return " / ".join(f"{math.degrees(a):.4g}°" for a in angles)
