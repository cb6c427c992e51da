"""What a tool setting does to the part: a profile per factor, and the map of the error."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.core.units import format_length
from metrosep.forms.base import Form
from metrosep.plot.style import COLOURS, DASHED, axes_or_new, house_style, length_scale
from metrosep.process.setting_maps import SettingError
from metrosep.process.tool_settings import ToolSetting

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["setting_map", "setting_profiles"]


_INVALID = "#B8B8B8"
_COLOUR_MAP = "RdBu_r"
_FACTORS = ("dx", "dy", "dR")


def setting_profiles(
    setting: ToolSetting,
    form: Form,
    *,
    after: ToolSetting | None = None,
    radius: float = 500e-6,
    inner: float | None = None,
    azimuth: float = 0.0,
    exact: bool = True,
    n: int = 2001,
) -> Figure:
    """Return a figure with the error along one radius: dx, dy, dR and all together, one below another.

    Parameters
    ----------
    setting : ToolSetting
        The errors of the tool.
    form : Form
        The nominal surface, with the spindle axis at its origin.
    after : ToolSetting, optional
        A better setting, drawn over the first.
    radius : float, m, optional
        Where the lines end.
    inner : float, m, optional
        Where they begin; a hundredth of the radius, or outside the cores of dy, if omitted.
    azimuth : float, rad, optional
        Of the line on the workpiece.
    exact : bool, optional
        Whether the exact model is drawn, not the paper's sum.
    n : int, optional
        Points of each line.

    Returns
    -------
    matplotlib Figure
        Four panels, each with its own scale and its P-V.

    Raises
    ------
    DataError
        If the range of radii is empty, or the surface is not defined on the line.
    InvalidSamplesError
        If the line begins in the uncut core.
    NotConvergedError
        If dR exceeds what the curvature of the surface allows.

    Notes
    -----
    After Fig. 12 of Deterministic error compensation for slow tool servo-driven diamond turning.
    The scales differ: dR is a fiftieth of dx there.

    Examples
    --------
    >>> from metrosep.forms import SineGrid
    >>> grid = SineGrid(amplitude=50e-9, wavelength=100e-6)
    >>> len(setting_profiles(ToolSetting(-3.5e-6, -3.5e-6, 100e-6), grid).axes)
    4
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    shown = [("before" if after is not None else "", setting)]
    shown += [("after", after)] if after is not None else []
    core = max(abs(tool.dy) for _, tool in shown)
    first = max(0.01 * radius, 1.001 * core) if inner is None else float(inner)
    if not 0.0 <= first < radius:
        raise DataError(
            f"the line from rho = {format_length(first)} to {format_length(radius)} is empty: "
            "give 0 <= inner < radius in m"
        )
    rho = np.linspace(first, radius, n)
    x, y = rho * math.cos(azimuth), rho * math.sin(azimuth)
    with house_style():
        figure = Figure(figsize=(7.2, 7.4), layout="constrained")
        FigureCanvasAgg(figure)
        panels = figure.subplots(4, 1, sharex=True)
        for axes, factor in zip(panels, (*_FACTORS, None), strict=True):
            lines = [
                (name, tool, tool.error(form, x, y, exact=exact, factor=factor))  # type: ignore[arg-type]
                for name, tool in shown
            ]
            _panel(axes, rho, lines, factor)
        panels[-1].set_xlabel(f"radius on the part / µm, at azimuth {math.degrees(azimuth):.4g}°")
        figure.supylabel("error = actual − nominal / nm", fontsize=9.5)
    return figure


def setting_map(error: SettingError, *, ax: Axes | None = None, title: str = "") -> Axes:
    """Return axes with the map of the error that a tool setting leaves.

    Parameters
    ----------
    error : SettingError
        Of `ToolSetting.error_map`.
    ax : matplotlib Axes, optional
        Where to draw; a new figure if omitted.
    title : str, optional
        Above the map, before the P-V.

    Returns
    -------
    matplotlib Axes
        Scale symmetric about zero; grey = not cut or not defined.

    Raises
    ------
    DataError
        If no point of the map has an error.

    Examples
    --------
    >>> from metrosep.forms import SineGrid
    >>> grid = SineGrid(amplitude=50e-9, wavelength=100e-6)
    >>> error = ToolSetting(dx=1e-6).error_map(grid, radius=500e-6, n_rho=51, n_theta=72)
    >>> setting_map(error).get_xlabel()
    'x / µm'
    """
    import matplotlib as mpl
    from matplotlib.patches import Circle

    valid = ~np.isnan(error.z)
    if not valid.any():
        raise DataError("no point of the map has an error: there is nothing to draw")
    rho, theta, z = _closed(error)
    factor, unit = length_scale(z[~np.isnan(z)] * 1e9)
    place, name = (1e3, "mm") if float(error.rho[valid].max()) >= 2e-3 else (1e6, "µm")
    limit = float(np.nanmax(np.abs(z))) * 1e9 * factor or 1.0
    with house_style():
        axes = axes_or_new(ax, size=(5.6, 4.6))
        rim = float(error.rho[valid].max()) * place
        axes.add_patch(Circle((0.0, 0.0), rim, facecolor=_INVALID, edgecolor="none", zorder=0))
        image = axes.pcolormesh(
            rho * np.cos(theta) * place,
            rho * np.sin(theta) * place,
            np.ma.masked_invalid(z * 1e9 * factor),
            cmap=mpl.colormaps[_COLOUR_MAP],
            vmin=-limit,
            vmax=limit,
            shading="nearest" if error.mesh == "square" else "gouraud",
            rasterized=True,
        )
        axes.set_aspect("equal")
        axes.grid(visible=False)
        axes.set_xlim(-1.02 * rim, 1.02 * rim)
        axes.set_ylim(-1.02 * rim, 1.02 * rim)
        axes.set_xlabel(f"x / {name}")
        axes.set_ylabel(f"y / {name}")
        pv = f"P-V {format_length(error.peak_to_valley(), digits=3)}, nothing removed"
        axes.set_title(f"{title}\n{pv}" if title else pv, fontsize=9.5)
        figure = axes.get_figure()
        if figure is not None:
            bar = figure.colorbar(image, ax=axes, shrink=0.9)
            bar.set_label(f"error = actual − nominal / {unit}")
    return axes


def _panel(
    axes: Axes,
    rho: FloatArray,
    lines: list[tuple[str, ToolSetting, FloatArray]],
    factor: str | None,
) -> None:
    styles = [("before", "-"), ("after", "-")] if len(lines) > 1 else [("estimate", "-")]
    for (name, tool, e), (colour, style) in zip(lines, styles, strict=True):
        value = "" if factor is None else f"{factor} = {format_length(getattr(tool, factor))}, "
        label = (
            f"{name + ': ' if name else ''}{value}P-V {format_length(float(np.ptp(e)), digits=3)}"
        )
        axes.plot(rho * 1e6, e * 1e9, color=COLOURS[colour], linestyle=style, lw=1.3, label=label)
    axes.axhline(0.0, color=COLOURS["line"], lw=0.7, linestyle=DASHED, zorder=1)
    axes.set_title("all three together" if factor is None else factor, fontsize=9.0, loc="left")
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.99), ncols=2, borderaxespad=0.0)
    axes.margins(x=0.01)


def _closed(error: SettingError) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the mesh with its first azimuth again at the end, where it goes all the way round."""
    if error.mesh == "square":
        return error.rho, error.theta, error.z
    return tuple(  # type: ignore[return-value]
        np.concatenate([a, a[:, :1]], axis=1) for a in (error.rho, error.theta, error.z)
    )
