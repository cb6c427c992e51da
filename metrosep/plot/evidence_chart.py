"""How surely each wavelength repeats over runs of different feedrates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.core.runset import RunSet
from metrosep.plot.style import (
    COLOURS,
    DASHED,
    DOTTED,
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

_SNR_FLOOR = 1e-2
"""Smallest signal-to-noise ratio that is drawn; smaller and negative ones lie on it."""


def evidence_plot(table: Any, ax: Axes | None = None, *, quantity: str = "coherence") -> Axes:
    """Return axes with the evidence of repeatability against wavelength.

    Parameters
    ----------
    table : EvidenceTable, ErrorEstimate or mapping of str to list
        What `evidence_table` returned, an estimate that holds its evidence, or the columns.
    ax : matplotlib Axes, optional
        Axes to draw into; new ones if omitted.
    quantity : {"coherence", "snr"}, optional
        What to draw.

    Returns
    -------
    matplotlib Axes
        Wavelength in mm, logarithmic. Filled: wavelengths that repeat at all feedrates (selected);
        hollow: within the noise. Dashed: the level that noise alone passes in 5 % of the cases
        (coherence), or at which the F test of one wavelength has p = 5 % (signal-to-noise ratio).
        Hatched: wavelengths that these feedrates cannot tell from vibration.

    Raises
    ------
    DataError
        If there is nothing to draw, or the quantity is unknown.

    Notes
    -----
    A signal-to-noise ratio that came out negative or below 1/100 (the estimate of the geometric
    power is free of bias, so it scatters about zero) lies on the lower edge. Selection follows the F
    test of the table with its false discovery rate, not the level that is drawn.

    Examples
    --------
    >>> from metrosep.separation.runs.evidence import evidence_table
    >>> from metrosep.separation.runs.simulate import machine_axis
    >>> evidence_plot(evidence_table(machine_axis(seed=1).runs)).get_ylabel()
    'coherence between feedrates'
    """
    if quantity not in ("coherence", "snr"):
        raise DataError(f"quantity is 'coherence' or 'snr', got {quantity!r}")
    columns = _evidence_columns(table)
    wavelength = values(columns["wavelength_mm"])
    chosen = np.array([bool(s) for s in columns["selected"]])
    blind = np.array([str(r).startswith("not separable") for r in columns["reason"]])
    y = values(columns[quantity])
    if not np.isfinite(y[~blind]).any():
        raise DataError(
            f"there is no {quantity} at any wavelength that these feedrates can tell from vibration: "
            "nothing to draw"
        )
    with house_style():
        axes = axes_or_new(ax)
        if quantity == "snr":
            y = np.maximum(y, _SNR_FLOOR)
            axes.set_yscale("log")
        _draw_evidence(axes, wavelength, np.where(blind, np.nan, y), chosen)
        label_decades(axes)
        _draw_null(axes, columns, quantity)
        edges = cell_edges(np.sort(wavelength))
        axes.set_xlim(edges[0], edges[-1])
        if quantity == "coherence":
            axes.set_ylim(-0.03, 1.05)
        _hatch(axes, np.sort(wavelength), blind[np.argsort(wavelength)], edges)
        axes.set_xlabel("wavelength / mm")
        axes.set_ylabel(
            "coherence between feedrates" if quantity == "coherence" else "signal-to-noise ratio"
        )
        axes.legend(
            loc="lower left",
            bbox_to_anchor=(0.0, 1.0, 1.0, 0.1),
            mode="expand",
            ncols=2,
            borderaxespad=0.3,
        )
    return axes


def _evidence_columns(table: Any) -> Mapping[str, Any]:
    columns = table
    for name in ("columns", "evidence_data"):
        if not isinstance(table, Mapping) and hasattr(table, name):
            columns = getattr(table, name)
    if not isinstance(columns, Mapping) or not columns.get("wavelength_mm"):
        raise DataError("this holds no evidence over wavelength: nothing to draw")
    return columns


def _draw_evidence(
    axes: Axes, wavelength: FloatArray, y: FloatArray, chosen: NDArray[np.bool_]
) -> None:
    axes.plot(wavelength, y, color=COLOURS["line"], linewidth=0.6, alpha=0.6, zorder=2)
    for keep, label, face, size in (
        (chosen, "repeats at all feedrates (selected)", COLOURS["estimate"], 6.5),
        (~chosen & np.isfinite(y), "within the noise", "white", 4.0),
    ):
        if keep.any():
            axes.plot(
                wavelength[keep],
                y[keep],
                linestyle="none",
                marker="o",
                markersize=size,
                markerfacecolor=face,
                markeredgecolor=COLOURS["estimate"],
                markeredgewidth=0.7,
                label=label,
                zorder=4,
            )


def _draw_null(axes: Axes, columns: Mapping[str, Any], quantity: str) -> None:
    """Level that noise passes in 5 %; of the ratio from p = 5 % of the F test."""
    if quantity == "coherence":
        level = float(values(columns["coherence_null"])[0])
    else:
        # F = R snr + 1, and p falls with F: between the last row above 5 % and the first below
        p, snr = values(columns["p"]), values(columns["snr"])
        known = np.isfinite(p) & np.isfinite(snr)
        above, below = snr[known & (p >= 0.05)], snr[known & (p < 0.05)]
        if above.size == 0 or below.size == 0:
            return
        level = float((above.max() + below.min()) / 2.0)
    if np.isfinite(level) and (quantity == "coherence" or level > _SNR_FLOOR):
        axes.axhline(
            level,
            color=COLOURS["after"],
            linestyle=DASHED,
            linewidth=1.3,
            label="noise alone passes this in 5 %",
            zorder=3,
        )


def _hatch(
    axes: Axes, wavelength: FloatArray, blind: NDArray[np.bool_], edges: FloatArray
) -> None:
    label = "not separable by repeatability"
    for i in np.flatnonzero(blind):
        axes.axvspan(
            edges[i],
            edges[i + 1],
            facecolor=COLOURS["zone"],
            edgecolor="#9AA5B1",
            hatch="///",
            linewidth=0.0,
            zorder=0.5,
            label=label,
        )
        label = "_"


# ---- wavelength against feedrate: geometry stays in its column, vibration slides ---------------
# A vibration of frequency f shows at the wavelength v/f, so with logarithmic axes it lies on a
# straight slanted line, while a geometric error is a vertical stripe.

_COLOUR_MAP = "Blues"
_DECADES = 1.7
"""Of amplitude, below the largest, that the colours span: 2 % of it and less is white."""

_MAX_WAVES = 4
"""Wavelengths of the geometry with a vertical line."""


def feed_map(
    source: Any,
    ax: Axes | None = None,
    *,
    lines: Sequence[float] | None = None,
    direction: str | None = None,
) -> Axes:
    """Return axes with the amplitude as colour over wavelength and feedrate.

    Parameters
    ----------
    source : RunSet, ErrorEstimate or mapping
        Runs of one direction, what `separate` returned, or a result (schema
        ``metrosep.result/1``).
    ax : matplotlib Axes, optional
        Axes to draw into; new ones if omitted.
    lines : sequence of float, Hz, optional
        Frequencies of the guide lines; looked for if omitted, `()` for none.
    direction : {"forward", "reverse"}, optional
        Which one, where the source holds both; forward if omitted.

    Returns
    -------
    matplotlib Axes
        Wavelength in mm and feedrate in mm/min, both logarithmic, one row for each feedrate;
        amplitude in nm (or µm), logarithmic. Slanted and dashed: where a vibration of the stated
        frequency falls. Dotted, with a triangle: the strongest wavelengths selected as geometry;
        triangles alone: the others (an estimate only).

    Raises
    ------
    DataError
        If there are no spectra of two or more feedrates to draw, or a frequency is not positive.

    Notes
    -----
    Colours show bands of 1/12 octave: the root of the summed squares of the amplitudes whose
    wavelength lies in the band, or the nearest amplitude where the band is narrower than the
    resolution. So a randomly excited mode has the weight of a sine of the same power.

    Without `lines`, the vibrations are the peaks of the residual's noise model, or, of runs, the
    peaks that the spectra of all feedrates share over frequency v/wavelength; a vibration that
    falls onto strong geometry at one of them is found from an estimate only. A row reaches half the
    way to its neighbours.

    Examples
    --------
    >>> from metrosep.separation.runs.simulate import machine_axis
    >>> axes = feed_map(machine_axis(seed=1).runs)
    >>> axes.get_xlabel()
    'wavelength / mm'
    """
    spectra, waves, psd = _source(source, direction)
    feeds, wavelength, amplitude = _rows(spectra)
    bands, power = in_bands(wavelength, amplitude)
    if lines is not None:
        guides = _checked(lines)
    elif psd:
        guides = lines_of_residual(psd)
    else:
        guides = shared_lines(feeds, bands, power)
    with house_style():
        axes = axes_or_new(ax, size=(7.6, 4.3))
        scale, unit = length_scale(power.ravel())
        mesh = _draw_map(axes, feeds, bands, power * scale)
        edges = cell_edges(feeds)
        _draw_waves(axes, waves)
        _draw_guides(axes, guides, edges)
        axes.set(xlabel="wavelength / mm", ylabel="feedrate / (mm/min)")
        _explain_lines(axes)
        figure = axes.get_figure()
        if figure is not None:
            bar = figure.colorbar(mesh, ax=axes, pad=0.02, extend="min")
            bar.set_label(f"amplitude in 1/{BANDS_PER_OCTAVE} octave / {unit}")
            bar.ax.yaxis.set_major_formatter("{x:g}")
            bar.outline.set_visible(False)
    return axes


def _source(
    source: Any, direction: str | None
) -> tuple[Mapping[str, Any], list[tuple[float, float]], Mapping[str, Any]]:
    """Spectra by feedrate; selected wavelengths in mm with amplitude; spectrum of the residual."""
    if direction not in (None, "forward", "reverse"):
        raise DataError(f"direction is 'forward' or 'reverse', got {direction!r}")
    if isinstance(source, RunSet):
        from metrosep.separation.runs.spectra import feed_spectra_columns

        ways = {1: "forward", -1: "reverse"}
        wanted = [d for d in source.directions if direction in (None, ways[d])]
        if not wanted:
            raise DataError(f"the runs do not go {direction}")
        return feed_spectra_columns(source.select(direction=max(wanted))), [], {}
    if isinstance(source, Mapping):
        estimate = source.get("estimate") or {}
        tables = [estimate.get(k) or {} for k in ("feed_spectra", "spectrum", "residual_psd")]
    elif hasattr(source, "feed_spectra_data"):
        tables = [source.feed_spectra_data, source.spectrum_data, source.residual_psd_data]
    else:
        raise DataError(
            f"feed_map draws a RunSet, an ErrorEstimate or a result, got {type(source).__name__}"
        )
    spectra, spectrum, psd = (_one_way(t, direction) for t in tables)
    columns = (spectrum.get(k) or [] for k in ("wavelength_mm", "amplitude_nm", "selected"))
    waves = [(w, a) for w, a, chosen in zip(*columns, strict=True) if chosen]
    return spectra, waves, psd if psd.get("frequency_hz") else {}


def _one_way(table: Mapping[str, Any], direction: str | None) -> Mapping[str, Any]:
    """Rows of one direction, where the table tells them apart."""
    ways = table.get("direction")
    if not ways:
        return table
    wanted = direction or ("forward" if "forward" in ways else "reverse")
    return {k: [v for v, w in zip(c, ways, strict=True) if w == wanted] for k, c in table.items()}


def _rows(spectra: Mapping[str, Any]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Feedrates, wavelengths (long to short) and amplitudes, one row for each feedrate."""
    speed = values(spectra.get("feed_mm_min"))
    feeds = np.unique(speed[~np.isnan(speed)])
    if feeds.size < 2:
        raise DataError(
            f"a map over feedrates needs spectra of 2 feedrates, this has {feeds.size}; with one "
            "feedrate nothing shows whether a line slides"
        )
    table = values(spectra["amplitude_nm"])
    wavelengths = values(spectra["wavelength_mm"])
    wavelength = wavelengths[speed == feeds[0]]
    amplitude = np.array([table[speed == v] for v in feeds])
    order = np.argsort(wavelength)
    return feeds, wavelength[order], amplitude[:, order]


def _checked(lines: Sequence[float]) -> list[float]:
    frequencies = [float(f) for f in lines]
    if not all(np.isfinite(f) and f > 0.0 for f in frequencies):
        raise DataError(f"lines are frequencies in Hz, positive and finite, got {list(lines)}")
    return frequencies


def _draw_map(axes: Axes, feeds: FloatArray, bands: FloatArray, power: FloatArray) -> Any:
    from matplotlib.colors import LogNorm
    from matplotlib.ticker import NullLocator

    top = float(np.nanmax(power))
    if not top > 0.0:
        raise DataError("all amplitudes are zero or not measured: nothing to draw")
    norm = LogNorm(vmin=top / 10.0**_DECADES, vmax=top, clip=True)
    edges = cell_edges(feeds)
    mesh = axes.pcolormesh(bands, edges, power, cmap=_COLOUR_MAP, norm=norm, zorder=1)
    axes.grid(visible=False)
    for edge in edges[1:-1]:
        axes.axhline(edge, color="white", linewidth=3.0, zorder=2)
    label_decades(axes)
    axes.set(xlim=(bands[0], bands[-1]), yscale="log", ylim=(edges[0], edges[-1]))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.set_yticks(list(feeds), [speed_name(float(v)).split()[0] for v in feeds])
    axes.tick_params(axis="y", length=0)
    return mesh


def _draw_guides(axes: Axes, frequencies: Sequence[float], edges: FloatArray) -> None:
    """Lines wavelength = v / f; in log-log they are straight and all of one slope."""
    low, high = axes.get_xlim()
    feeds = np.geomspace(edges[0], edges[-1], 60)
    label = "vibration slides: feedrate / frequency"
    for f in frequencies:
        wavelength = feeds / 60.0 / f
        seen = (wavelength >= low) & (wavelength <= high)
        if not seen.any():
            continue
        axes.plot(
            wavelength[seen],
            feeds[seen],
            color=COLOURS["after"],
            linestyle=DASHED,
            linewidth=1.5,
            label=label,
            zorder=3,
        )
        label = "_"
        _name(axes, f"{f:.3g} Hz", wavelength[seen][-1], feeds[seen][-1], COLOURS["after"])


def _draw_waves(axes: Axes, waves: Sequence[tuple[float, float]]) -> None:
    """Vertical lines at the strongest selected wavelengths, a triangle at each."""
    low, high = axes.get_xlim()
    inside = sorted(((w, a) for w, a in waves if low <= w <= high), key=lambda wave: -wave[1])
    foot = axes.get_ylim()[0]
    for w, _ in inside[:_MAX_WAVES]:
        axes.axvline(w, color=COLOURS["text"], linestyle=DOTTED, linewidth=1.0, zorder=2.5)
    if inside:
        axes.plot(
            [w for w, _ in inside],
            [foot] * len(inside),
            linestyle="none",
            marker="^",
            markersize=6.5,
            markerfacecolor=COLOURS["text"],
            markeredgecolor="white",
            markeredgewidth=0.6,
            clip_on=False,
            zorder=5,
            label="geometry stays at its wavelength",
        )


def _name(axes: Axes, text: str, x: float, y: float, colour: str) -> None:
    style: Any = {"ha": "center", "va": "bottom", "fontsize": 8.5, "color": colour}
    write_beside(axes, text, (x, y), (0, 3), **style)


def _explain_lines(axes: Axes) -> None:
    if axes.get_legend_handles_labels()[0]:
        axes.legend(
            loc="lower left",
            bbox_to_anchor=(0.0, 1.04, 1.0, 0.1),
            mode="expand",
            ncols=2,
            borderaxespad=0.3,
        )


# ---- private to plot: amplitudes in proportional bands, and the vibrations that slide through them ----

BANDS_PER_OCTAVE = 12
_MAX_LINES = 3

_PROMINENCE = 0.35
"""Decades of amplitude by which a vibration stands above the valleys beside it."""

_STANDS_OUT = 3.0
"""A vibration found from runs alone is this much above the median of two octaves about it."""

_APART = 0.3
"""Vibrations closer than this, relative, are one."""


def cell_edges(centres: FloatArray) -> FloatArray:
    """Edges half the way between logarithms of rising centres."""
    log = np.log(centres)
    if log.size == 1:
        return np.asarray(np.exp(log[0] + np.array([-0.1, 0.1])))
    inner = (log[1:] + log[:-1]) / 2.0
    first, last = [2.0 * log[0] - inner[0]], [2.0 * log[-1] - inner[-1]]
    return np.asarray(np.exp(np.concatenate([first, inner, last])))


def in_bands(wavelength: FloatArray, amplitude: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Edges of bands of 1/12 octave, and the amplitude in each."""
    edges = cell_edges(wavelength)
    n = max(int(np.ceil(np.log2(edges[-1] / edges[0]) * BANDS_PER_OCTAVE)), 1)
    bands = np.geomspace(edges[0], edges[-1], n + 1)
    owner = np.clip(np.searchsorted(bands, wavelength) - 1, 0, n - 1)
    nearest = np.searchsorted(edges, np.sqrt(bands[1:] * bands[:-1])) - 1
    held = np.bincount(owner, minlength=n) > 0
    rows = [
        np.where(held, np.sqrt(np.bincount(owner, row**2, minlength=n)), row[nearest])
        for row in amplitude
    ]
    return bands, np.array(rows)


def lines_of_residual(psd: Mapping[str, Any]) -> list[float]:
    """Strongest peaks of the noise model, or of the PSD where there is no model."""
    frequency = values(psd["frequency_hz"])
    model = values(psd.get("model_nm2_per_hz"))
    density = model if np.isfinite(model).any() else values(psd["psd_nm2_per_hz"])
    keep = (frequency > 0.0) & np.isfinite(density) & (density > 0.0)
    # in proportional bands a peak holds its density times its frequency
    return _peaks(frequency[keep], np.sqrt(density[keep] * frequency[keep]))


def shared_lines(feeds: FloatArray, bands: FloatArray, power: FloatArray) -> list[float]:
    """Frequencies at which every feedrate has more than the others have at that wavelength."""
    from scipy.ndimage import median_filter

    centre = np.sqrt(bands[1:] * bands[:-1])
    speed = feeds / 60.0  # mm/s
    low, high = 4.0 * speed[-1] / bands[-1], speed[0] / bands[0]
    if high <= 2.0 * low:
        return []
    frequency = np.geomspace(low, high, int(np.log2(high / low) * 2 * BANDS_PER_OCTAVE))
    excess = power - power.min(axis=0)  # what is the same at every feedrate is geometry
    excess = np.where(excess > 0.5 * power, excess, 0.0)
    padded = np.pad(excess, ((0, 0), (1, 1)), mode="edge")
    wide = np.maximum(np.maximum(padded[:, :-2], padded[:, 1:-1]), padded[:, 2:])
    rows = [np.interp(v / frequency, centre, row) for v, row in zip(speed, wide, strict=True)]
    common = np.min(rows, axis=0)
    level = np.min(
        [np.interp(v / frequency, centre, row) for v, row in zip(speed, power, strict=True)],
        axis=0,
    )
    around = median_filter(level, size=4 * BANDS_PER_OCTAVE + 1, mode="nearest")
    found = []
    for f in _peaks(frequency, np.where(common > _STANDS_OUT * around, common, 0.0)):
        fine = f * np.linspace(0.9, 1.1, 81)
        sums = [np.interp(v / fine, centre, row) for v, row in zip(speed, excess, strict=True)]
        found.append(float(fine[np.sum(sums, axis=0).argmax()]))
    return found


def _peaks(frequency: FloatArray, amplitude: FloatArray) -> list[float]:
    from scipy.signal import find_peaks

    if frequency.size < 3 or not amplitude.max() > 0.0:
        return []
    at, _ = find_peaks(
        np.log10(np.maximum(amplitude, 1e-6 * amplitude.max())),
        prominence=_PROMINENCE,
        plateau_size=1,
    )
    found: list[float] = []
    for i in sorted(at, key=lambda i: -amplitude[i]):
        if len(found) < _MAX_LINES and all(abs(np.log(frequency[i] / f)) > _APART for f in found):
            found.append(float(frequency[i]))
    return sorted(found)
