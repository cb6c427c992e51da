"""Spectra: the error over wavelength for each feedrate, and the residual over frequency.

A geometric error keeps its wavelength at every feedrate; a vibration keeps its frequency, so its
line slides along the wavelength axis with the feedrate. The first figure shows that to the eye.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core.errors import DataError
from metrosep.plot.accepted import takes_documents
from metrosep.plot.style import (
    COLOURS,
    DASHED,
    axes_or_new,
    house_style,
    label_decades,
    length_scale,
    speed_name,
    values,
    write_beside,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_FEED_COLOURS = ("#009E73", "#E69F00", "#CC79A7", "#56B4E9", "#7A7A7A", "#000000")
_MARKERS = {"": ("o", 6.5), "forward": ("o", 8.0), "reverse": ("s", 4.5)}

_MAX_PEAKS = 3
_PEAK_PROMINENCE_DECADES = 0.7
"""A peak is labelled if it stands this many decades of PSD above the valleys beside it."""


@takes_documents
def spectrum(document: Mapping[str, Any], ax: Axes | None = None) -> Axes:
    """Return axes with the amplitude over wavelength: every feedrate, and what was selected.

    Parameters
    ----------
    document : mapping
        A result (schema ``metrosep.result/1``).
    ax : matplotlib Axes, optional
        Axes to draw into; new ones if omitted.

    Returns
    -------
    matplotlib Axes
        Wavelength in mm (logarithmic); amplitude in nm, or in µm where it is large. Thin: the
        readings of each feedrate. Filled: wavelengths that belong to the estimate. Hollow: those
        that were rejected.

    Raises
    ------
    DataError
        If the result holds no spectra.
    """
    estimate = document.get("estimate") or {}
    feeds = _columns(estimate.get("feed_spectra"), "feed_mm_min")
    lines = _columns(estimate.get("spectrum"), "wavelength_mm")
    if not feeds and not lines:
        raise DataError("this result holds no spectra over wavelength: nothing to draw")
    with house_style():
        axes = axes_or_new(ax)
        amplitudes = [values(c["amplitude_nm"]) for c in (feeds, lines) if c]
        scale, unit = length_scale(*amplitudes)
        if feeds:
            _draw_feed_spectra(axes, feeds, scale)
        if lines:
            _draw_selection(axes, lines, scale)
        label_decades(axes)
        axes.set_ylim(bottom=-0.02 * axes.get_ylim()[1])
        axes.set(xlabel="wavelength / mm", ylabel=f"amplitude / {unit}")
        axes.legend(
            loc="lower left",
            bbox_to_anchor=(0.0, 1.0, 1.0, 0.1),
            mode="expand",
            ncols=3,
            borderaxespad=0.3,
        )
    return axes


def _columns(table: Mapping[str, Any] | None, key: str) -> Mapping[str, Any]:
    return table if table and table.get(key) else {}


def _ways(table: Mapping[str, Any]) -> list[tuple[str, NDArray[np.bool_]]]:
    """Direction and the rows that belong to it; one nameless way where none is told apart."""
    rows = table.get("direction")
    if not rows:
        n = len(next(iter(table.values())))
        return [("", np.ones(n, dtype=np.bool_))]
    return [(way, np.array([r == way for r in rows])) for way in sorted(set(rows))]


def _draw_feed_spectra(axes: Axes, feeds: Mapping[str, Any], scale: float) -> None:
    wavelength, amplitude = values(feeds["wavelength_mm"]), values(feeds["amplitude_nm"]) * scale
    speed = values(feeds["feed_mm_min"])
    ways = _ways(feeds)
    for i, v in enumerate(np.unique(speed)):
        at_speed = np.isnan(speed) if np.isnan(v) else speed == v
        label = f"readings, {speed_name(None if np.isnan(v) else float(v))}"
        for _, rows in ways:
            keep = rows & at_speed
            colour = _FEED_COLOURS[i % len(_FEED_COLOURS)]
            axes.plot(wavelength[keep], amplitude[keep], color=colour, linewidth=0.9, label=label)
            label = "_"


def _draw_selection(axes: Axes, lines: Mapping[str, Any], scale: float) -> None:
    wavelength, amplitude = values(lines["wavelength_mm"]), values(lines["amplitude_nm"]) * scale
    chosen = np.array([bool(s) for s in lines["selected"]])
    for way, rows in _ways(lines):
        colour = COLOURS["reverse" if way == "reverse" else "estimate"]
        marker, size = _MARKERS.get(way, _MARKERS[""])
        suffix = f", {way}" if way else ""
        for keep, label, face, part in (
            (rows & chosen, f"selected{suffix}", colour, 1.0),
            (rows & ~chosen, f"not selected{suffix}", "none", 0.35),
        ):
            if keep.any():
                axes.plot(
                    wavelength[keep],
                    amplitude[keep],
                    linestyle="none",
                    marker=marker,
                    markersize=size * part,
                    markerfacecolor=face,
                    markeredgecolor=colour if face == "none" else "white",
                    markeredgewidth=0.6,
                    label=label,
                    zorder=3 if face == "none" else 4,
                )


@takes_documents
def residual_psd(document: Mapping[str, Any], ax: Axes | None = None) -> Axes:
    """Return axes with the power spectral density of what was separated from the error.

    Parameters
    ----------
    document : mapping
        A result (schema ``metrosep.result/1``).
    ax : matplotlib Axes, optional
        Axes to draw into; new ones if omitted.

    Returns
    -------
    matplotlib Axes
        Frequency in Hz, one-sided PSD in nm²/Hz, both logarithmic; measured, and the noise model
        where there is one; the strongest peaks carry their frequency.

    Raises
    ------
    DataError
        If the result holds no residual PSD.
    """
    table = _columns((document.get("estimate") or {}).get("residual_psd"), "frequency_hz")
    if not table:
        raise DataError("this result holds no PSD of the residual: nothing to draw")
    with house_style():
        axes = axes_or_new(ax)
        frequency = values(table["frequency_hz"])
        ways = _ways(table)
        for way, rows in ways:
            _draw_psd(axes, table, rows, way)
        label_decades(axes)
        axes.set_yscale("log")
        axes.margins(y=0.12)
        axes.set(
            xlim=(float(frequency[frequency > 0].min()), float(frequency.max())),
            xlabel="frequency / Hz",
            ylabel="PSD of the residual / (nm²/Hz)",
        )
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, borderaxespad=0.3)
        for f, level in _peaks(table, ways[0][1]):
            style: Any = {"ha": "center", "fontsize": 8.5, "color": COLOURS["text"]}
            write_beside(axes, f"{f:.3g} Hz", (f, level), (0, 5), **style)
    return axes


def _draw_psd(axes: Axes, table: Mapping[str, Any], rows: NDArray[np.bool_], way: str) -> None:
    frequency = values(table["frequency_hz"])
    rows = rows & (frequency > 0.0)
    suffix = f", {way}" if way else ""
    colour = COLOURS["reverse" if way == "reverse" else "estimate"]
    measured = values(table["psd_nm2_per_hz"])
    axes.plot(
        frequency[rows], measured[rows], color=colour, linewidth=0.9, label=f"measured{suffix}"
    )
    model = values(table.get("model_nm2_per_hz"))
    if model.size == frequency.size and np.isfinite(model[rows]).any():
        axes.plot(
            frequency[rows],
            model[rows],
            color=COLOURS["after"],
            linestyle="-" if way != "reverse" else DASHED,
            linewidth=1.6,
            label=f"noise model{suffix}",
        )


def _peaks(table: Mapping[str, Any], rows: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Frequency of the strongest peaks of the measured PSD, and the height to label them at."""
    from scipy.signal import find_peaks

    frequency, psd = values(table["frequency_hz"])[rows], values(table["psd_nm2_per_hz"])[rows]
    keep = (frequency > 0.0) & np.isfinite(psd) & (psd > 0.0)
    if keep.sum() < 3:
        return []
    model = values(table.get("model_nm2_per_hz"))
    top = np.fmax(psd, model[rows]) if model.size == rows.size else psd
    frequency, psd, top = frequency[keep], psd[keep], top[keep]
    at, _ = find_peaks(np.log10(psd), prominence=_PEAK_PROMINENCE_DECADES)
    strongest = sorted(at, key=lambda i: -psd[i])[:_MAX_PEAKS]
    return [(float(frequency[i]), float(top[max(i - 1, 0) : i + 2].max())) for i in strongest]
