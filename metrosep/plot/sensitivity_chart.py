"""Figures of a ranking of error terms: bars for several alignments, maps of terms, what is left."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.plot.style import (
    COLOURS,
    axes_or_new,
    house_style,
    length_scale,
    new_figure,
    stated_unit,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from metrosep.machine.sensitivity import SensitivityTable

_DECADES = 4
_MOST_TABLES = 4
_BAR_COLOURS = (COLOURS["before"], COLOURS["estimate"], COLOURS["after"], COLOURS["reverse"])


def sensitivity_bars(
    tables: SensitivityTable | Mapping[str, SensitivityTable],
    ax: Axes | None = None,
    *,
    unit: str | None = None,
) -> Axes:
    """Draw Sq of each term as a bar, one row of bars for each alignment, the largest on top.

    Parameters
    ----------
    tables : SensitivityTable or mapping of str to SensitivityTable
        Rankings of the same terms by name, such as raw, levelled and defocused; at most four. The
        last one orders the terms.
    ax : matplotlib Axes, optional
        Where to draw; a new figure if omitted.
    unit : str, optional
        Unit of the values, such as "nm"; one in which they read well if omitted.

    Returns
    -------
    matplotlib Axes
        Logarithmic, four decades. A term of which nothing is left has a 0 in place of a bar; terms
        of a group of the last table carry its number.

    Raises
    ------
    DataError
        If there is no table, more than four, or they rank different terms.
    """
    from matplotlib.ticker import NullLocator

    named = dict(tables) if isinstance(tables, Mapping) else {_label(tables): tables}
    if not 1 <= len(named) <= _MOST_TABLES:
        raise DataError(f"a chart holds 1 to {_MOST_TABLES} rankings, got {len(named)}")
    last = list(named.values())[-1]
    if any(set(t.names) != set(last.names) for t in named.values()):
        raise DataError("the rankings hold different terms; rank the same errors in each")
    columns = {k: np.array([t.sq[t.names.index(n)] for n in last.order]) for k, t in named.items()}
    factor, name = length_scale(*(1e9 * c for c in columns.values()))
    if unit is not None:
        name, size = stated_unit(unit, "m")
        factor = 1e-9 / size
    top = factor * 1e9 * max(float(c.max()) for c in columns.values()) or 1.0
    floor = top * 10.0**-_DECADES
    place = np.arange(len(last.order), dtype=np.float64)
    height = 0.8 / len(named)
    with house_style():
        axes = axes_or_new(ax, size=(7.2, 1.4 + 0.26 * max(1.0, len(named) / 2) * place.size))
        for k, (label, column) in enumerate(columns.items()):
            values = factor * 1e9 * column
            at = place + (k - 0.5 * (len(named) - 1)) * height
            shown = np.where(values > floor, values, np.nan)
            colour = _BAR_COLOURS[k]
            axes.barh(at, shown, height=0.92 * height, color=colour, label=label, log=True)
            for y, v in zip(at, values, strict=True):
                if v <= floor:
                    text = "0" if v == 0.0 else f"{v:.1g}"
                    axes.text(1.15 * floor, y, text, va="center", fontsize=6.5, color=colour)
        group = {n: f" ({i})" for i, g in enumerate(last.groups, start=1) for n in g}
        axes.set_yticks(place, [n + group.get(n, "") for n in last.order])
        axes.invert_yaxis()
        axes.yaxis.set_minor_locator(NullLocator())
        axes.set_xlim(floor, 2.0 * top)
        axes.grid(visible=False, axis="y")
        kind = "optical path" if last.response == "wavefront" else f"{last.direction} deviation"
        axes.set(xlabel=f"Sq of the {kind} / {name}", ylabel="error term")
        if len(named) > 1:
            axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=len(named))
        else:
            axes.set_title(next(iter(named)))
    return axes


def sensitivity_maps(
    table: SensitivityTable,
    terms: Sequence[str] | None = None,
    *,
    aligned: bool = True,
    columns: int = 4,
) -> Figure:
    """Draw what each term does to the part at its magnitude, each map on a scale of its own.

    Parameters
    ----------
    table : SensitivityTable
        Of `metrosep.machine.rank`.
    terms : sequence of str, optional
        Terms in this order; the first eight that leave something if omitted.
    aligned : bool, optional
        Whether the removed freedoms are removed.
    columns : int, optional
        Maps in a row, at least 1.

    Returns
    -------
    matplotlib Figure
        Colours are symmetric about zero; the title holds the P-V of each map.

    Raises
    ------
    DataError
        If a term was not ranked, none leaves anything, or columns is below 1.
    """
    if columns < 1:
        raise DataError(f"columns must be at least 1, got {columns}")
    if terms is None:
        chosen = [n for n in table.order if n not in table.unobservable or not aligned][:8]
    else:
        chosen = list(terms)
    unknown = [n for n in chosen if n not in table.names]
    if unknown or not chosen:
        raise DataError(
            f"{', '.join(unknown)} was not ranked; there are {', '.join(table.names)}"
            if unknown
            else "no term leaves anything on the aligned part: there is no map to draw"
        )
    maps = table.unit_maps(aligned=aligned)
    mesh = table.maker.mesh
    rho = _edges(mesh.rho)
    step = 2.0 * np.pi / mesh.azimuth.size
    azimuth = np.append(mesh.azimuth, 2.0 * np.pi) - 0.5 * step
    x, y = 1e3 * rho[:, None] * np.cos(azimuth), 1e3 * rho[:, None] * np.sin(azimuth)
    rows = -(-len(chosen) // columns)
    wide = min(columns, len(chosen))
    with house_style():
        figure = new_figure((0.5 + 2.6 * wide, 0.4 + 2.5 * rows))
        grid = figure.subplots(rows, wide, squeeze=False, sharex=True, sharey=True)
        for axes, name in zip(grid.ravel(), chosen, strict=False):
            i = table.names.index(name)
            _one_map(axes, x, y, 1e9 * maps[:, :, i] * table.magnitudes[i], name)
        for axes in grid.ravel()[len(chosen) :]:
            axes.set_visible(False)
        for axes in grid[:, 0]:
            axes.set_ylabel("y / mm")
        for k in range(wide):
            lowest = [r for r in range(rows) if r * wide + k < len(chosen)][-1]
            grid[lowest, k].set_xlabel("x / mm")
            grid[lowest, k].tick_params(labelbottom=True)
    return figure


def sensitivity_pareto(table: SensitivityTable, ax: Axes | None = None) -> Axes:
    """Draw the Sq that is left when terms are compensated one after the other, best first.

    Parameters
    ----------
    table : SensitivityTable
        Of `metrosep.machine.rank`.
    ax : matplotlib Axes, optional
        Where to draw; a new figure if omitted.

    Returns
    -------
    matplotlib Axes
        One point for each step; groups go together.
    """
    steps = [s for k, s in enumerate(table.pareto()) if k == 0 or s.names]
    most = next((k for k, s in enumerate(steps) if s.sq <= 1e-3 * steps[0].sq), len(steps) - 1)
    steps = steps[: most + 1]
    sq = 1e9 * np.array([s.sq for s in steps])
    factor, unit = length_scale(sq)
    with house_style():
        axes = axes_or_new(ax)
        place = np.arange(sq.size)
        axes.plot(place, factor * sq, color=COLOURS["estimate"], marker="o", lw=1.6)
        labels = ["nothing", *("+ " + "\n".join(s.names) for s in steps[1:])]
        axes.set_xticks(place, labels)
        axes.set(
            ylim=(0.0, 1.08 * factor * float(sq.max()) or 1.0),
            xlabel="compensated, one after the other",
            ylabel=f"expected Sq that is left / {unit}",
        )
    return axes


def _one_map(axes: Axes, x: FloatArray, y: FloatArray, values_nm: FloatArray, name: str) -> None:
    factor, unit = length_scale(values_nm)
    values = factor * values_nm
    largest = float(np.nanmax(np.abs(values))) or 1.0
    image = axes.pcolormesh(
        x, y, values, cmap="RdBu_r", vmin=-largest, vmax=largest, rasterized=True
    )
    axes.set_aspect("equal")
    axes.grid(visible=False)
    pv = float(np.nanmax(values) - np.nanmin(values))
    axes.set_title(f"{name}, P-V {pv:.3g} {unit}", fontsize=9.0)
    bar = axes.figure.colorbar(image, ax=axes, shrink=0.8)
    bar.set_label(unit)


def _edges(rho: FloatArray) -> FloatArray:
    half = 0.5 * (rho[1] - rho[0])
    return np.append(rho - half, rho[-1] + half)


def _label(table: SensitivityTable) -> str:
    return f"removed: {', '.join(table.removed) or 'nothing'}"
