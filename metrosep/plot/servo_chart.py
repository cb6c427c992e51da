"""Figures of servo and stage: follow-up error, calibration, straightness runs, before and after."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.core.numbers import positive, quantity
from metrosep.core.readable import typeset
from metrosep.core.units import format_length
from metrosep.forms.base import Form
from metrosep.plot.style import (
    BAND_FACTOR,
    COLOURS,
    DASHED,
    DOTTED,
    axes_or_new,
    draw_band,
    house_style,
    length_scale,
    new_figure,
    shades,
)
from metrosep.process.setting_maps import SettingError
from metrosep.process.tool_settings import ToolSetting

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.tri import Triangulation

    from metrosep.compensation.closed_loop import LoopCut, LoopHistory, LoopResult
    from metrosep.compensation.knots import Knots
    from metrosep.core.profile import Profile
    from metrosep.process._motion import FollowUp
    from metrosep.process.dual_servo import BeforeAfter
    from metrosep.process.flexure import FlexureCalibration
    from metrosep.process.static_errors import StaticComparison
    from metrosep.process.straightness_runs import RunPolynomial


def follow_up_chart(result: FollowUp) -> Figure:
    """Draw the follow-up error over time, the acceleration below it.

    Parameters
    ----------
    result : FollowUp
        Of `follow_up`.

    Returns
    -------
    matplotlib Figure
        Error in nm with its regression; acceleration in um/s^2 on the same time.
    """
    with house_style():
        figure, (top, bottom) = _two_axes((7.2, 4.8))
        top.plot(
            result.t, result.error * 1e9, color=COLOURS["before"], lw=0.7, label="follow-up error"
        )
        fitted = (result.error - result.residual) * 1e9
        names = ", ".join(result.shares)
        top.plot(result.t, fitted, color=COLOURS["after"], lw=1.3, label=f"explained by {names}")
        top.set_ylabel("error (nm)")
        top.set_title(
            f"P-V {result.pv * 1e9:.3g} nm, RMS {result.rms * 1e9:.3g} nm, R² {result.r2:.2f}",
            loc="left",
            fontsize=9.0,
        )
        _legend_above(top, columns=1)
        bottom.plot(result.t, result.acceleration * 1e6, color=COLOURS["estimate"], lw=1.1)
        bottom.set(ylabel="acceleration (µm/s²)", xlabel="time (s)")
    return figure


def calibration_chart(result: FlexureCalibration, *, ax: Axes | None = None) -> Axes:
    """Draw displacement over voltage, up and down, with the line of the sensitivity.

    Parameters
    ----------
    result : FlexureCalibration
        Of `flexure_calibration`.
    ax : matplotlib Axes, optional
        Where to draw; a new figure if omitted.

    Returns
    -------
    matplotlib Axes
        Displacement in um over V.
    """
    with house_style():
        axes = axes_or_new(ax)
        v = result.voltage
        line = (result.intercept + result.sensitivity * v) * 1e6
        label = f"{result.line} line, {result.sensitivity * 1e6:.4g} µm/V"
        axes.plot(v, line, color=COLOURS["before"], lw=1.0, ls=DASHED, label=label)
        for curve, name, colour, mark in (
            (result.up, "up", COLOURS["estimate"], "^"),
            (result.down, "down", COLOURS["after"], "v"),
        ):
            if not np.isnan(curve).all():
                axes.plot(
                    v, curve * 1e6, color=colour, lw=1.3, marker=mark, ms=3.5,
                    markevery=max(v.size // 20, 1), label=name,
                )  # fmt: skip
        words = [
            f"{name} {100.0 * share:.2g} % FS"
            for name, share in (
                ("nonlinearity", result.nonlinearity),
                ("hysteresis", result.hysteresis),
                ("repeatability", result.repeatability),
            )
            if not np.isnan(share)
        ]
        axes.set_title(", ".join(words), loc="left", fontsize=9.0)
        axes.set(xlabel="voltage (V)", ylabel="displacement (µm)")
        axes.legend(loc="upper left")
    return axes


def static_error_chart(result: StaticComparison) -> Figure:
    """Draw both records at rest over time and their densities.

    Parameters
    ----------
    result : StaticComparison
        Of `compare_static`.

    Returns
    -------
    matplotlib Figure
        Error about its median in nm over s; density in nm/sqrt(Hz) over Hz, if there is one.
    """
    with house_style():
        figure = new_figure((7.2, 5.2))
        rows = 2 if result.frequency.size else 1
        top = figure.add_subplot(rows, 1, 1)
        for t, error, facts, name in (
            (result.t_before, result.error_before, result.before, "before"),
            (result.t_after, result.error_after, result.after, "after"),
        ):
            size = facts["PV95"].value * 1e9
            centred = (error - facts["median"].value) * 1e9
            label = f"{name}: middle 95 % in {size:.3g} nm"
            top.plot(t, centred, color=COLOURS[name], lw=0.7, label=label)
        top.set(xlabel="time (s)", ylabel="error about median (nm)")
        db = result.ratio_db
        top.set_title(f"{db.value:.1f} dB (u = {db.u:.1g} dB)", loc="left", fontsize=9.0)
        _legend_above(top, columns=1)
        if rows == 2:
            below = figure.add_subplot(2, 1, 2)
            for density, name in (
                (result.density_before, "before"),
                (result.density_after, "after"),
            ):
                root = np.sqrt(density) * 1e9
                below.loglog(result.frequency, root, color=COLOURS[name], lw=1.1)
            below.set(xlabel="frequency (Hz)", ylabel="density (nm/√Hz)")
    return figure


def straightness_chart(
    runs: Sequence[Profile], polynomial: RunPolynomial, *, ax: Axes | None = None
) -> Axes:
    """Draw straightness runs and the polynomial through them with its band.

    Parameters
    ----------
    runs : sequence of Profile
        As measured.
    polynomial : RunPolynomial
        Of `run_polynomial`.
    ax : matplotlib Axes, optional
        Where to draw; a new figure if omitted.

    Returns
    -------
    matplotlib Axes
        Readings in um over mm; the band is two standard uncertainties.

    Raises
    ------
    TooFewSamplesError
        If there is no run.
    """
    if not runs:
        raise TooFewSamplesError("there is no run to draw")
    x = np.linspace(*polynomial.domain, 401)
    y, u = polynomial.evaluate(x) * 1e6, polynomial.sd(x) * 1e6
    with house_style():
        axes = axes_or_new(ax)
        for i, (run, shade) in enumerate(
            zip(runs, shades(COLOURS["before"], len(runs)), strict=True)
        ):
            label = f"{len(runs)} runs" if i == len(runs) - 1 else None
            axes.plot(run.x * 1e3, run.z * 1e6, color=shade, lw=0.7, label=label)
        if np.isfinite(u).all():
            draw_band(axes, x * 1e3, y, BAND_FACTOR * u, COLOURS["after"], label="2 u")
        label = f"polynomial of degree {polynomial.degree} ({polynomial.quantity})"
        axes.plot(x * 1e3, y, color=COLOURS["after"], lw=1.4, label=label)
        axes.set(xlabel="position x (mm)", ylabel=f"{polynomial.quantity} (µm)")
        _legend_above(axes)
    return axes


def before_after_chart(result: BeforeAfter, *, ax: Axes | None = None) -> Axes:
    """Draw the primary profiles before and after compensation over the same region.

    Parameters
    ----------
    result : BeforeAfter
        Of `before_after`.
    ax : matplotlib Axes, optional
        Where to draw; a new figure if omitted.

    Returns
    -------
    matplotlib Axes
        Heights in um over mm, Ra and Pt in the legend.
    """
    with house_style():
        axes = axes_or_new(ax)
        for profile, facts, name in zip(
            result.profiles, (result.before, result.after), ("before", "after"), strict=True
        ):
            label = (
                f"{name}: Ra {facts['Ra'].value * 1e9:.3g} nm, Pt {facts['Pt'].value * 1e6:.3g} µm"
            )
            axes.plot(profile.x * 1e3, profile.z * 1e6, color=COLOURS[name], lw=0.8, label=label)
        axes.set(xlabel="position x (mm)", ylabel="height (µm)")
        _legend_above(axes)
    return axes


def _two_axes(size: tuple[float, float]) -> tuple[Figure, tuple[Axes, Axes]]:

    figure = new_figure(size)
    top = figure.add_subplot(2, 1, 1)
    return figure, (top, figure.add_subplot(2, 1, 2, sharex=top))


def _legend_above(axes: Axes, *, columns: int = 2) -> None:
    """Place the legend outside the data, at the top right; one column leaves room for a title."""
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=columns, borderaxespad=0.1)


# ---- what a tool setting does to the part: a profile per factor, and the map of the error ------

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
    shown = [("before" if after is not None else "", setting)]
    shown += [("after", after)] if after is not None else []
    radius = positive(radius, "radius", dimension="length")
    azimuth = quantity(azimuth, "azimuth", "angle")
    core = max(abs(tool.dy) for _, tool in shown)
    first = max(0.01 * radius, 1.001 * core)
    first = first if inner is None else quantity(inner, "inner", "length")
    if not 0.0 <= first < radius:
        raise DataError(
            f"the line from rho = {format_length(first)} to {format_length(radius)} is empty: "
            "give 0 <= inner < radius in m"
        )
    rho = np.linspace(first, radius, n)
    x, y = rho * math.cos(azimuth), rho * math.sin(azimuth)
    with house_style():
        figure = new_figure((7.2, 7.4))
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
        axes.set(
            xlim=(-1.02 * rim, 1.02 * rim),
            ylim=(-1.02 * rim, 1.02 * rim),
            xlabel=f"x / {name}",
            ylabel=f"y / {name}",
        )
        pv = typeset(f"P-V {format_length(error.peak_to_valley(), digits=3)}, nothing removed")
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
        label = typeset(
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


# ---- charts of the simulated closed loop, of its cycles, and of knots placed by error ----------

_STATES = (
    ("before", "before", "-", 1.2),
    ("wrong_sign", "reverse", DOTTED, 1.2),
    ("after", "after", "-", 1.6),
)
_NAMES = {"before": "without", "after": "with table", "wrong_sign": "sign reversed"}
_WAYS = {1: "forward", -1: "reverse"}


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
        axes.set(xlabel="position in mm", ylabel=f"actual − nominal in {unit}")
        axes.set_title(f"{_WAYS[direction]}, {result.removed} removed", fontsize=9.5, loc="left")
        _legend_below(axes, 3)
    return axes


def closed_loop_maps(result: LoopResult) -> Figure:
    """Return a figure with a face-turned part without, with, and with the reversed map.

    Parameters
    ----------
    result : LoopResult
        From `run_closed_loop` on a face machine.

    Returns
    -------
    matplotlib Figure
        Three maps over x and y in mm with one scale of colours.

    Raises
    ------
    DataError
        If the result is of an axis.
    """
    if result.places.ndim != 2:
        raise DataError("an axis is drawn by closed_loop_plot")
    (only,) = result.passes
    order = ("before", "after", "wrong_sign")
    cuts = {name: getattr(only, name) for name in order}
    scale, unit = length_scale(*(c.left * 1e9 for c in cuts.values()))
    largest = max(float(np.abs(c.left).max()) for c in cuts.values()) * 1e9 * scale or 1.0
    with house_style():
        figure = new_figure((9.0, 3.3))
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
    """Draw P-V and RMS of the part against the number of corrections.

    Parameters
    ----------
    history : LoopHistory
        Of a loop of cutting, measuring and correcting.
    ax : matplotlib Axes, optional
        Where to draw; a new figure by default.

    Returns
    -------
    matplotlib Axes
        In nm, logarithmic; what is zero is omitted.
    """
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
        axes.set(xlabel="corrections made", ylabel="left on the part in nm")
        _legend_below(axes, 4)
    return axes


def knots_plot(x: ArrayLike, c: ArrayLike, knots: Knots, ax: Axes | None = None) -> Axes:
    """Draw a curve, its polyline, and the tunnel that the polyline stays in.

    Parameters
    ----------
    x : array_like, shape (n,), m
        Positions of the curve.
    c : array_like, shape (n,), m
        Corrections at them.
    knots : Knots
        Of this curve, from `knots_for_tolerance`.
    ax : matplotlib Axes, optional
        Where to draw; a new figure by default.

    Returns
    -------
    matplotlib Axes
        Positions in mm, corrections in a unit that fits.
    """
    places = np.asarray(x, dtype=np.float64) * 1e3
    curve = np.asarray(c, dtype=np.float64) * 1e9
    scale, unit = length_scale(curve, knots.values * 1e9)
    rest = knots.residual * 1e9 * scale
    with house_style():
        axes = axes_or_new(ax)
        label = typeset(f"± {format_length(knots.residual, digits=3)}")
        draw_band(axes, places, curve * scale, rest, COLOURS["zone"], alpha=None, label=label)
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
        axes.set(xlabel="position in mm", ylabel=f"correction in {unit}")
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
    return typeset(text)


def _legend_below(axes: Axes, columns: int) -> None:
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.15), ncols=columns)
