"""Readings and parts of a separation over position or angle: the quartet, and parts with bands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.plot.style import BAND_FACTOR, COLOURS, DASHED, house_style
from metrosep.separation.contract import Separation

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["parts_plot", "reversal_quartet", "separation_parts"]


_SCALES = (
    ("m", ((1.0, "m"), (1e3, "mm"), (1e6, "µm"), (1e9, "nm"))),
    ("rad", ((1.0, "rad"), (1e3, "mrad"), (1e6, "µrad"), (1e9, "nrad"))),
)


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
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    array = np.asarray(readings, dtype=np.float64)
    if len(separation.parts) != 2:
        raise DataError(f"a quartet shows two parts, this has {', '.join(separation.parts)}")
    x, label = _abscissa(separation)
    if array.ndim not in (2, 3) or array.shape[0] != 2 or array.shape[-1] != x.size:
        raise DataError(f"readings must be (2, {x.size}) or (2, M, {x.size}), got {array.shape}")
    with house_style():
        figure = Figure(figsize=(8.0, 5.6), layout="constrained")
        FigureCanvasAgg(figure)
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


def parts_plot(separation: Separation, ax: Axes | None = None) -> Figure | Axes:
    """Return the parts of a separation over position or angle, one panel each.

    Parameters
    ----------
    separation : Separation
        Whose parts are curves.
    ax : matplotlib Axes, optional
        Axes to draw into, for a separation of one part.

    Returns
    -------
    matplotlib Figure or Axes
        A panel for each part with a band of two standard uncertainties where they are known; the
        given axes where there were some.

    Raises
    ------
    DataError
        If the parts are maps, or axes were given for several parts.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    x, label = _abscissa(separation)
    shown = {k: v for k, v in separation.parts.items() if v.shape == x.shape}
    if ax is not None and len(shown) != 1:
        raise DataError(f"one axes cannot hold {len(shown)} parts; leave out ax")
    with house_style():
        if ax is not None:
            _draw_parts([ax], separation, x)
            _label_abscissa(ax, label)
            return ax
        figure = Figure(figsize=(7.2, 0.6 + 2.1 * len(shown)), layout="constrained")
        FigureCanvasAgg(figure)
        panels = figure.subplots(len(shown), 1, sharex=True, squeeze=False)[:, 0]
        _draw_parts(list(panels), separation, x)
        _label_abscissa(panels[-1], label)
    return figure


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
        raise DataError("the parts of this separation are no curves")
    return drawn


def _draw_parts(panels: Sequence[Axes], separation: Separation, x: FloatArray) -> None:
    shown = {k: v for k, v in separation.parts.items() if v.shape == x.shape}
    groups: dict[str, list[FloatArray]] = {}
    for name, values in shown.items():
        groups.setdefault(separation.units[name], []).append(values)
    colours = (COLOURS["estimate"], COLOURS["after"], COLOURS["reverse"], COLOURS["before"])
    for i, (axes, (name, values)) in enumerate(zip(panels, shown.items(), strict=True)):
        factor, unit = _scale(groups[separation.units[name]], separation.units[name])
        colour = colours[i % len(colours)]
        half = BAND_FACTOR * separation.u[name]
        text = name.replace("_", " ")
        if np.isfinite(half).any():
            axes.fill_between(
                x,
                (values - half) * factor,
                (values + half) * factor,
                color=colour,
                alpha=0.25,
                linewidth=0.0,
            )
            text += f" ± {BAND_FACTOR:.0f} u"
        else:
            text += " (u not known)"
        axes.plot(x, values * factor, color=colour, linewidth=1.4)
        axes.axhline(0.0, color=COLOURS["line"], linewidth=0.7, linestyle=DASHED, zorder=1.5)
        axes.set_title(text, loc="left", fontsize=9.5)
        place = axes.get_subplotspec()
        if place is None or place.is_first_col():
            axes.set_ylabel(f"{'deviation' if unit.endswith('m') else 'angle'} / {unit}")


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
