"""Errors of a spiral tool path: maps, a line through the centre, P-V against the count of points."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.plot.style import (
    COLOURS,
    DASHED,
    axes_or_new,
    house_style,
    label_decades,
    new_figure,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from metrosep.process.path_errors import PathErrorMap
    from metrosep.process.path_points import CountCurve

_INVALID = "#B8B8B8"
_MOST_COLUMNS = 4
_STYLES = {
    ("CA", "linear"): (COLOURS["estimate"], DASHED, "o"),
    ("CA", "spline"): (COLOURS["estimate"], "solid", "o"),
    ("CAL", "linear"): (COLOURS["after"], DASHED, "s"),
    ("CAL", "spline"): (COLOURS["after"], "solid", "s"),
}


def path_error_figure(maps: Sequence[PathErrorMap], *, n_pixels: int = 301) -> Figure:
    """Return a figure with one map for each path, all on one colour scale.

    Parameters
    ----------
    maps : sequence of PathErrorMap
        Of `SpiralPath.error_map`.
    n_pixels : int, optional
        Rows and columns of each map.

    Returns
    -------
    matplotlib Figure
        Each title names the path and the P-V of all samples; grey is not cut.

    Raises
    ------
    DataError
        If there is no map.

    References
    ----------
    .. [1] Deterministic error compensation for slow tool servo-driven diamond turning, Figs. 9
       and 10, here as path minus ideal.
    """
    if not len(maps):
        raise DataError("there is no map to draw; give the error map of a path")
    surfaces = [m.to_surface(n_pixels) for m in maps]
    limit = max(float(np.nanmax(np.abs(s.z), initial=0.0)) for s in surfaces) * 1e9 or 1.0
    with house_style():
        columns = 2 if len(maps) == 4 else min(len(maps), _MOST_COLUMNS)
        rows = -(-len(maps) // columns)
        figure = new_figure((2.9 * columns + 0.9, 3.0 * rows + 0.2))
        grid = figure.subplots(rows, columns, squeeze=False)
        images = [
            _draw(axes, made, surface.z * 1e9, limit)
            for axes, made, surface in zip(grid.flat, maps, surfaces, strict=False)
        ]
        for axes in list(grid.flat)[len(maps) :]:
            axes.set_axis_off()
        figure.colorbar(images[0], ax=grid, shrink=0.85, aspect=25).set_label("path - ideal / nm")
    return figure


def _draw(axes: Any, made: PathErrorMap, z: FloatArray, limit: float) -> Any:
    import matplotlib as mpl

    edge = made.path.radius * 1e6
    half = edge / (z.shape[0] - 1)
    image = axes.imshow(
        np.ma.masked_invalid(z),
        origin="lower",
        extent=(-edge - half, edge + half, -edge - half, edge + half),
        cmap=mpl.colormaps["RdBu_r"].with_extremes(bad=_INVALID),
        vmin=-limit,
        vmax=limit,
        interpolation="nearest",
    )
    axes.grid(visible=False)
    axes.set_title(f"{_name(made)}\nP-V {made.peak_to_valley() * 1e9:.3g} nm", fontsize=9.0)
    axes.set(xlabel="x / µm", ylabel="y / µm")
    return image


def _name(made: PathErrorMap) -> str:
    path = made.path
    step = (
        f"{math.degrees(path.step):.4g}°"
        if path.distribution == "CA"
        else f"{path.step * 1e6:.4g} µm"
    )
    return f"{path.distribution} {step}, {path.n_points} points, {path.interpolation}"


def path_error_line(made: PathErrorMap, *, azimuth: float = 0.0, ax: Axes | None = None) -> Axes:
    """Draw the error where the turns cross a line through the centre.

    Parameters
    ----------
    made : PathErrorMap
        Of `SpiralPath.error_map`.
    azimuth : float, rad, optional
        Direction of the positive half of the line on the part.
    ax : matplotlib Axes, optional
        Axes to draw into.

    Returns
    -------
    matplotlib Axes
        Position along the line in µm, error in nm.

    Notes
    -----
    With CA the line through the start crosses the points themselves, where there is no error:
    choose half a step beside.
    """
    right, left = made.line(azimuth), made.line(azimuth + math.pi)
    with house_style():
        axes = axes_or_new(ax)
        position = np.concatenate([-left.x[::-1], right.x]) * 1e6
        error = np.concatenate([left.z[::-1], right.z]) * 1e9
        axes.plot(position, error, color=COLOURS["estimate"], linewidth=1.0)
        axes.set(
            xlabel=f"position along the line at {math.degrees(azimuth):.4g}° / µm",
            ylabel="path - ideal / nm",
        )
        axes.set_title(f"{_name(made)}: P-V {np.ptp(error):.3g} nm on this line", fontsize=9.5)
    return axes


def path_error_counts(
    curves: Iterable[CountCurve], *, tolerance: float | None = None, ax: Axes | None = None
) -> Axes:
    """Draw P-V against the count of points, one curve for each way to set and join them.

    Parameters
    ----------
    curves : iterable of CountCurve
        Of `errors_by_count`.
    tolerance : float, m, optional
        Drawn as a horizontal line.
    ax : matplotlib Axes, optional
        Axes to draw into.

    Returns
    -------
    matplotlib Axes
        Both axes are logarithmic.

    Raises
    ------
    DataError
        If there is no curve.

    References
    ----------
    .. [1] Deterministic error compensation for slow tool servo-driven diamond turning, Fig. 11.
    """
    drawn = list(curves)
    if not drawn:
        raise DataError("there is no curve to draw; see errors_by_count")
    with house_style():
        axes = axes_or_new(ax)
        for curve in drawn:
            colour, line, marker = _STYLES[curve.distribution, curve.interpolation]
            axes.plot(
                curve.n_points,
                curve.peak_to_valley * 1e9,
                color=colour,
                linestyle=line,
                marker=marker,
                markersize=4.0,
                linewidth=1.4,
                label=f"{curve.distribution}, {curve.interpolation}",
            )
        if tolerance is not None:
            axes.axhline(
                tolerance * 1e9,
                color=COLOURS["line"],
                linewidth=1.0,
                label=f"tolerance {tolerance * 1e9:.3g} nm",
            )
        label_decades(axes)
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter(lambda v, _: f"{v:g}")
        axes.set(xlabel="points (intervals)", ylabel="P-V of path - ideal / nm")
        axes.legend()
    return axes
