"""How surely each wavelength repeats over runs of different feedrates."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.plot._bands import cell_edges
from metrosep.plot.style import COLOURS, DASHED, axes_or_new, house_style, label_decades, values

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["evidence_plot"]


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
    >>> from metrosep.separation.evidence import evidence_table
    >>> from metrosep.separation.simulate import machine_axis
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
