"""Figures of servo and stage: follow-up error, calibration, straightness runs, before and after."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from metrosep.core.errors import TooFewSamplesError
from metrosep.plot.style import BAND_FACTOR, COLOURS, DASHED, axes_or_new, house_style, shades

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from metrosep.core.profile import Profile
    from metrosep.process.dual_servo import BeforeAfter
    from metrosep.process.flexure import FlexureCalibration
    from metrosep.process.follow_ups import FollowUp
    from metrosep.process.static_errors import StaticComparison
    from metrosep.process.straightness_runs import RunPolynomial

__all__ = [
    "before_after_chart",
    "calibration_chart",
    "follow_up_chart",
    "static_error_chart",
    "straightness_chart",
]


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
        bottom.set_ylabel("acceleration (µm/s²)")
        bottom.set_xlabel("time (s)")
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
        axes.set_xlabel("voltage (V)")
        axes.set_ylabel("displacement (µm)")
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
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with house_style():
        figure = Figure(figsize=(7.2, 5.2), layout="constrained")
        FigureCanvasAgg(figure)
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
        top.set_xlabel("time (s)")
        top.set_ylabel("error about median (nm)")
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
            below.set_xlabel("frequency (Hz)")
            below.set_ylabel("density (nm/√Hz)")
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
            axes.fill_between(
                x * 1e3, y - BAND_FACTOR * u, y + BAND_FACTOR * u,
                color=COLOURS["after"], alpha=0.25, lw=0.0, label="2 u",
            )  # fmt: skip
        label = f"polynomial of degree {polynomial.degree} ({polynomial.quantity})"
        axes.plot(x * 1e3, y, color=COLOURS["after"], lw=1.4, label=label)
        axes.set_xlabel("position x (mm)")
        axes.set_ylabel(f"{polynomial.quantity} (µm)")
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
        axes.set_xlabel("position x (mm)")
        axes.set_ylabel("height (µm)")
        _legend_above(axes)
    return axes


def _two_axes(size: tuple[float, float]) -> tuple[Figure, tuple[Axes, Axes]]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    top = figure.add_subplot(2, 1, 1)
    return figure, (top, figure.add_subplot(2, 1, 2, sharex=top))


def _legend_above(axes: Axes, *, columns: int = 2) -> None:
    """Place the legend outside the data, at the top right; one column leaves room for a title."""
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=columns, borderaxespad=0.1)
