"""Figures of multi-point straightness: the parts over position, and what the probes see."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.plot.accepted import takes_separations
from metrosep.plot.polar import readable_unit
from metrosep.plot.style import (
    BAND_FACTOR,
    COLOURS,
    DASHED,
    DOTTED,
    LINES,
    axes_or_new,
    draw_band,
    house_style,
    label_decades,
    length_scale,
    new_figure,
    write_beside,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from metrosep.separation.circles.probe_angles import ProbeAngles
    from metrosep.separation.circles.probe_check import ProbeCheck
    from metrosep.separation.circles.speed_sweep import SpeedSweep
    from metrosep.separation.contract import Separation
    from metrosep.separation.lines.three_points import MultiProbe, ThreePoint, TwoPoint

_TITLES = {
    "artefact": "artefact",
    "height": "height",
    "straightness": "straightness of the carriage",
    "pitch": "pitch of the carriage",
}
_DASHES: tuple[Any, ...] = ("-", DASHED, DOTTED, (0, (6, 1.5, 1.2, 1.5)))


@takes_separations
def straightness_parts(
    result: Separation | Mapping[str, Separation], *, figure: Figure | None = None
) -> Figure:
    """Return a figure with each part of a separation over position.

    Parameters
    ----------
    result : Separation or mapping of str to Separation
        Of `two_point`, `three_point`, `multi_probe_straightness` or `integrate_slopes`; several are
        compared under their names.
    figure : matplotlib Figure, optional
        Empty figure to draw into; a new one if omitted.

    Returns
    -------
    matplotlib Figure
        One axes for each part: position in mm; lengths in nm or µm, pitch in µrad; band of two
        standard uncertainties where they are known. What is not determined is a gap.

    Raises
    ------
    DataError
        If a result has no parts over position.
    """
    results = dict(result) if isinstance(result, Mapping) else {"": result}
    names = [n for n in _TITLES if any(n in r.parts for r in results.values())]
    if not names:
        raise DataError("no result holds artefact, straightness or height over position")
    with house_style():
        panels = _panels(figure, len(names))
        for axes, name in zip(panels, names, strict=True):
            _draw_part(axes, name, results)
        panels[-1].set_xlabel("position / mm")
        handles, labels = panels[0].get_legend_handles_labels()
        if handles:
            panels[0].legend(
                handles,
                labels,
                loc="lower left",
                bbox_to_anchor=(0.0, 1.0),
                ncols=min(len(labels), 3),
                borderaxespad=0.3,
            )
    drawn = panels[0].get_figure(root=True)
    assert drawn is not None  # noqa: S101  (panels were made in a figure)
    return drawn


def probe_transfer(
    methods: Mapping[str, TwoPoint | ThreePoint | MultiProbe],
    wavelengths: ArrayLike,
    ax: Axes | None = None,
) -> Axes:
    """Return axes with what probes see of a wave over its wavelength.

    Parameters
    ----------
    methods : mapping of str to TwoPoint, ThreePoint or MultiProbe
        Set-ups and how they are called in the legend.
    wavelengths : array_like, shape (k,), m
        Above zero.
    ax : matplotlib Axes, optional
        Axes to draw into; new ones if omitted.

    Returns
    -------
    matplotlib Axes
        Wavelength in mm, both axes logarithmic; ``|H|``. Marks on the lower edge: wavelengths of at
        least two steps that are not seen at all.

    Raises
    ------
    DataError
        If there is no set-up, or a wavelength is not above zero.
    """
    lengths = np.sort(np.asarray(wavelengths, dtype=np.float64).ravel())
    if not methods or lengths.size < 2 or not (lengths > 0.0).all():
        raise DataError("probe_transfer needs a set-up and at least two wavelengths above zero")
    with house_style():
        axes = axes_or_new(ax)
        label_decades(axes)
        axes.set_yscale("log")
        curves = {name: method.transfer(lengths) for name, method in methods.items()}
        floor = 0.3 * min(_smallest_shown(h) for h in curves.values())
        for i, (name, height) in enumerate(curves.items()):
            colour, dash = COLOURS[LINES[i % len(LINES)]], _DASHES[i % 4]
            seen = np.where(height > floor, height, np.nan)
            axes.plot(lengths * 1e3, seen, color=colour, linestyle=dash, label=name, linewidth=1.5)
            _mark_hidden(axes, methods[name], colour, lengths, floor * 1.4**i)
        axes.set_xlim(lengths[0] * 1e3, lengths[-1] * 1e3)
        axes.set_ylim(bottom=0.7 * floor)
        axes.set(xlabel="wavelength / mm", ylabel="|H|, seen of a unit wave")
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, borderaxespad=0.3)
    return axes


def _smallest_shown(height: FloatArray) -> float:
    """Return the level that nine tenths of a curve reach: zeros would stretch the axis for ever."""
    return float(max(np.quantile(height, 0.1), 1e-9 * height.max()))


def _mark_hidden(axes: Axes, method: Any, colour: str, lengths: FloatArray, level: float) -> None:
    lost = [float(w) for i in method.null_space() if i.kind == "wavelength" for w in i.indices]
    inside = [w * 1e3 for w in lost if lengths[0] <= w <= lengths[-1]]
    if inside:
        axes.plot(
            inside,
            np.full(len(inside), level),
            color=colour,
            marker="x",
            markersize=6.0,
            linestyle="none",
            clip_on=False,
            label="_",
        )


def _panels(figure: Figure | None, n: int) -> Sequence[Axes]:
    if figure is None:
        figure = new_figure((7.2, 1.2 + 2.1 * n))
    axes = figure.subplots(n, 1, sharex=True, squeeze=False)
    return [axes[i, 0] for i in range(n)]


def _draw_part(axes: Axes, name: str, results: Mapping[str, Separation]) -> None:
    shown = {k: r for k, r in results.items() if name in r.parts}
    if name == "pitch":
        scale, unit = 1e6, "µrad"
    else:
        factor, unit = length_scale(*(r.parts[name] * 1e9 for r in shown.values()))
        scale = factor * 1e9
    for i, (label, result) in enumerate(results.items()):
        if label not in shown:
            continue
        key = "x" if name in ("artefact", "height") else "carriage_x"
        x, y = result.coordinates[key] * 1e3, result.parts[name] * scale
        half = BAND_FACTOR * result.u[name] * scale
        colour = COLOURS[LINES[i % len(LINES)]]
        if np.isfinite(half).any():
            draw_band(axes, x, y, half, colour, alpha=0.22)
        text = f"{label} ± {BAND_FACTOR:.0f} u" if np.isfinite(half).any() else label
        axes.plot(
            x,
            y,
            color=colour,
            linestyle=_DASHES[i % 4],
            linewidth=1.5,
            label=text if label else "_",
        )
    axes.axhline(0.0, color=COLOURS["line"], linewidth=0.7, zorder=1.5)
    axes.set_ylabel(f"{_TITLES[name]} / {unit}".replace(" of the carriage", ""))


# ---- figures of multi-probe and multi-step set-ups: what an arrangement sees, and where probes disagree ----

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
        beside: Any = {"xycoords": ("axes fraction", "data"), "annotation_clip": False}
        write_beside(axes, "1/√n", (1.0, limit), (3, 0), va="center", **beside)
        axes.set(yscale="log", ylim=(0.8 * limit, 1.25 * _CEILING))
        axes.set_yticks([0.5, 1.0, 2.0, 5.0, 10.0], ["0.5", "1", "2", "5", "≥ 10"])
        axes.minorticks_off()
        axes.set(
            xlim=(1.0, k[-1] + 1.0),
            xlabel="undulations per revolution k",
            ylabel="noise gain of the artefact",
        )
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
        axes.set(xlim=(-2.0, 2.0), ylim=(-2.0, 2.0), aspect="equal")
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
        axes.set(
            yscale="log", xlabel="undulations per revolution k", ylabel="χ² / degrees of freedom"
        )
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


# ---- chart of spindle values against speed, with fits, confidence bands and critical speeds ----

_MARKS = ("o", "s", "^", "D")


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
            colour = COLOURS[LINES[i % len(LINES)]]
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
            draw_band(axes, 60.0 * fine, line * scale, half * scale, colour, alpha=0.15)
        axes.set_ylim(bottom=0.0)
        _critical(axes, sweep)
        axes.set(xlabel="speed in rev/min", ylabel=f"error motion in {unit}")
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
            top: Any = {"xycoords": ("data", "axes fraction"), "ha": "left", "va": "bottom"}
            write_beside(axes, f"k={k}", (60.0 * speed, 1.0), (3, -2), **top)
