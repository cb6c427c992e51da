"""Figures of multi-point straightness: the parts over position, and what the probes see."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.plot.style import (
    BAND_FACTOR,
    COLOURS,
    DASHED,
    DOTTED,
    axes_or_new,
    house_style,
    label_decades,
    length_scale,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from metrosep.separation.contract import Separation
    from metrosep.separation.multi_probes import MultiProbe
    from metrosep.separation.three_points import ThreePoint
    from metrosep.separation.two_points import TwoPoint

__all__ = ["probe_transfer", "straightness_parts"]


_TITLES = {
    "artefact": "artefact",
    "height": "height",
    "straightness": "straightness of the carriage",
    "pitch": "pitch of the carriage",
}
_LINES = (COLOURS["estimate"], COLOURS["after"], COLOURS["reverse"], COLOURS["before"])
_DASHES: tuple[Any, ...] = ("-", DASHED, DOTTED, (0, (6, 1.5, 1.2, 1.5)))


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
            colour, dash = _LINES[i % 4], _DASHES[i % 4]
            seen = np.where(height > floor, height, np.nan)
            axes.plot(lengths * 1e3, seen, color=colour, linestyle=dash, label=name, linewidth=1.5)
            _mark_hidden(axes, methods[name], colour, lengths, floor * 1.4**i)
        axes.set_xlim(lengths[0] * 1e3, lengths[-1] * 1e3)
        axes.set_ylim(bottom=0.7 * floor)
        axes.set_xlabel("wavelength / mm")
        axes.set_ylabel("|H|, seen of a unit wave")
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
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        figure = Figure(figsize=(7.2, 1.2 + 2.1 * n), layout="constrained")
        FigureCanvasAgg(figure)
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
        colour = _LINES[i % 4]
        if np.isfinite(half).any():
            axes.fill_between(x, y - half, y + half, color=colour, alpha=0.22, linewidth=0.0)
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
