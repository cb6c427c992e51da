"""Charts of the simulated closed loop, of its cycles, and of knots placed by error."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.core.units import format_length
from metrosep.plot.style import COLOURS, DASHED, DOTTED, axes_or_new, house_style, length_scale

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.tri import Triangulation

    from metrosep.compensation.closed_loop import LoopCut, LoopHistory, LoopResult
    from metrosep.compensation.knots import Knots

__all__ = ["closed_loop_maps", "closed_loop_plot", "knots_plot", "loop_history_plot"]


_STATES = (
    ("before", "before", "-", 1.2),
    ("wrong_sign", "reverse", DOTTED, 1.2),
    ("after", "after", "-", 1.6),
)
_NAMES = {"before": "without", "after": "with table", "wrong_sign": "sign reversed"}
_WAYS = {1: "forward", -1: "reverse"}
_COLOUR_MAP = "RdBu_r"


def closed_loop_plot(result: LoopResult, ax: Axes | None = None, *, direction: int = 1) -> Axes:
    """Draw what is left on the part without, with, and with the reversed table.

    Parameters
    ----------
    result : LoopResult
        From `run_closed_loop` on an axis.
    ax : matplotlib Axes, optional
        Where to draw; a new figure by default.
    direction : {1, -1}, optional
        Which pass.

    Returns
    -------
    matplotlib Axes
        Position in mm; P-V of each state in the legend.

    Raises
    ------
    DataError
        If the result is of a face-turned part, or has no such pass.
    """
    if result.places.ndim != 1:
        raise DataError("a face-turned part is drawn by closed_loop_maps")
    found = [p for p in result.passes if p.direction == direction]
    if not found:
        raise DataError(f"there is no pass in direction {direction!r}")
    cuts = {name: getattr(found[0], name) for name, *_ in _STATES}
    scale, unit = length_scale(*(c.left * 1e9 for c in cuts.values()))
    with house_style():
        axes = axes_or_new(ax)
        for name, colour, dashes, width in _STATES:
            axes.plot(
                result.places * 1e3,
                cuts[name].left * 1e9 * scale,
                color=COLOURS[colour],
                ls=dashes,
                lw=width,
                label=_label(name, cuts[name]),
            )
        axes.set_xlabel("position in mm")
        axes.set_ylabel(f"actual − nominal in {unit}")
        axes.set_title(f"{_WAYS[direction]}, {result.removed} removed", fontsize=9.5, loc="left")
        _legend_below(axes, 3)
    return axes


def closed_loop_maps(result: LoopResult) -> Figure:
    """Return a figure with a face-turned part without, with, and with the reversed map."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    if result.places.ndim != 2:
        raise DataError("an axis is drawn by closed_loop_plot")
    (only,) = result.passes
    order = ("before", "after", "wrong_sign")
    cuts = {name: getattr(only, name) for name in order}
    scale, unit = length_scale(*(c.left * 1e9 for c in cuts.values()))
    largest = max(float(np.abs(c.left).max()) for c in cuts.values()) * 1e9 * scale or 1.0
    with house_style():
        figure = Figure(figsize=(9.0, 3.3), layout="constrained")
        FigureCanvasAgg(figure)
        panels = figure.subplots(1, 3, sharex=True, sharey=True)
        mesh_of = _mesh(result.places * 1e3)
        drawn = []
        for axes, name in zip(panels, order, strict=True):
            mesh = axes.tripcolor(
                mesh_of,
                cuts[name].left * 1e9 * scale,
                shading="gouraud",
                cmap=_COLOUR_MAP,
                vmin=-largest,
                vmax=largest,
            )
            drawn.append(mesh)
            axes.set_aspect("equal")
            axes.grid(visible=False)
            axes.set_title(_label(name, cuts[name]), fontsize=9.0)
            axes.set_xlabel("x in mm")
        panels[0].set_ylabel("y in mm")
        figure.colorbar(drawn[0], ax=list(panels), label=f"actual − nominal in {unit}", shrink=0.9)
    return figure


def loop_history_plot(history: LoopHistory, ax: Axes | None = None) -> Axes:
    """Draw P-V and RMS of the part against the number of corrections."""
    cycles = np.arange(history.rms.shape[0])
    with house_style():
        axes = axes_or_new(ax)
        for i, d in enumerate(history.directions):
            colour = COLOURS["estimate" if d > 0 else "reverse"]
            for table, mark, name in ((history.pv, "o", "P-V"), (history.rms, "s", "RMS")):
                column = np.where(table[:, i] > 0.0, table[:, i], np.nan) * 1e9
                axes.plot(
                    cycles,
                    column,
                    marker=mark,
                    ms=4.5,
                    color=colour,
                    ls="-" if d > 0 else DASHED,
                    label=f"{name} {_WAYS[d]}",
                )
        axes.set_yscale("log")
        axes.set_xticks(cycles)
        axes.set_xlabel("corrections made")
        axes.set_ylabel("left on the part in nm")
        _legend_below(axes, 4)
    return axes


def knots_plot(x: ArrayLike, c: ArrayLike, knots: Knots, ax: Axes | None = None) -> Axes:
    """Draw a curve, its polyline, and the tunnel that the polyline stays in."""
    places = np.asarray(x, dtype=np.float64) * 1e3
    curve = np.asarray(c, dtype=np.float64) * 1e9
    scale, unit = length_scale(curve, knots.values * 1e9)
    rest = knots.residual * 1e9 * scale
    with house_style():
        axes = axes_or_new(ax)
        axes.fill_between(
            places,
            curve * scale - rest,
            curve * scale + rest,
            color=COLOURS["zone"],
            lw=0,
            label=f"± {format_length(knots.residual, digits=3).replace('um', 'µm')}",
        )
        axes.plot(places, curve * scale, color=COLOURS["before"], lw=1.2, label="curve")
        axes.plot(
            knots.positions * 1e3,
            knots.values * 1e9 * scale,
            color=COLOURS["after"],
            marker="o",
            ms=4.5,
            lw=1.4,
            label=f"{knots.positions.size} knots, values {knots.values_are}",
        )
        axes.set_xlabel("position in mm")
        axes.set_ylabel(f"correction in {unit}")
        _legend_below(axes, 3)
    return axes


def _mesh(places: FloatArray) -> Triangulation:
    """Return triangles between the turns of a spiral that goes inwards, those not cut masked."""
    from matplotlib.path import Path
    from matplotlib.tri import Triangulation

    mesh = Triangulation(*places.T)
    radius = np.hypot(*places.T)
    x, y = places.T
    steps = np.angle(np.exp(1j * np.diff(np.arctan2(y, x))))
    angle = np.abs(np.concatenate([[0.0], np.cumsum(steps)]))
    turn = 2.0 * np.pi * (1.0 + 1e-9)
    first = angle <= turn
    # at the centre itself the angle is lost; the point belongs to the last turn in any case
    last = angle >= angle.max() - turn
    last[-1] = True
    centres = places[mesh.triangles].mean(axis=1)
    masked = ~Path(places[first]).contains_points(centres)
    masked |= np.hypot(*centres.T) < radius[-1]
    pitch = float(radius[last][0] - radius[-1])
    if radius[-1] > pitch:
        masked |= Path(places[last]).contains_points(centres)
    if not masked.all():
        mesh.set_mask(masked)
    return mesh


def _label(name: str, cut: LoopCut) -> str:
    text = f"{_NAMES[name]}: P-V {format_length(cut.pv.value, digits=3)}"
    return text.replace("um", "µm")


def _legend_below(axes: Axes, columns: int) -> None:
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.15), ncols=columns)
