"""Bars over harmonics: amplitudes with uncertainty, suppressed harmonics hatched and without bar."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core.errors import DataError
from metrosep.plot.style import COLOURS, axes_or_new, house_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["harmonic_bars", "readable_unit"]


_UNITS = {
    "m": ((1e-6, 1e6, "µm"), (1e-9, 1e9, "nm"), (0.0, 1e12, "pm")),
    "rad": ((1e-6, 1e6, "µrad"), (1e-9, 1e9, "nrad"), (0.0, 1e12, "prad")),
}


def readable_unit(largest: float, unit: str) -> tuple[float, str]:
    """Return factor and name of the unit in which the largest value reads well.

    Examples
    --------
    >>> readable_unit(2.5e-8, "m")
    (1000000000.0, 'nm')
    """
    for least, factor, name in _UNITS.get(unit, ()):
        if largest >= 2.0 * least:
            return factor, name
    return 1.0, unit


def harmonic_bars(
    k: ArrayLike,
    amplitude: ArrayLike,
    u: ArrayLike | None = None,
    suppressed: Collection[int] = (),
    unit: str = "m",
    ax: Axes | None = None,
    *,
    limit: int | None = 60,
    label: str = "amplitude",
) -> Axes:
    """Draw amplitudes over undulations per revolution.

    Parameters
    ----------
    k : array_like of int, shape (h,)
        Undulations per revolution.
    amplitude : array_like, shape (h,)
        In `unit`; NaN draws nothing.
    u : array_like, shape (h,), optional
        Standard uncertainty; whiskers of two of them on each side.
    suppressed : collection of int, optional
        Harmonics that the method cannot see or has removed: a hatched strip instead of a bar.
    unit : str, optional
        ``"m"`` or ``"rad"``, drawn in nm, µrad and so on.
    ax : matplotlib Axes, optional
        Where to draw; a new figure by default.
    limit : int, optional
        Highest k drawn; ``None`` for all.
    label : str, optional
        Of the vertical axis, without unit.

    Returns
    -------
    matplotlib Axes
        With the bars.

    Raises
    ------
    DataError
        If lengths differ.
    """
    orders = np.asarray(k, dtype=np.intp)
    sizes = np.asarray(amplitude, dtype=np.float64)
    spread = np.full(sizes.shape, np.nan) if u is None else np.asarray(u, dtype=np.float64)
    if orders.ndim != 1 or sizes.shape != orders.shape or spread.shape != orders.shape:
        raise DataError(
            f"k, amplitude and u must be equally long: {orders.shape}, {sizes.shape}, {spread.shape}"
        )
    keep = orders <= (orders.max(initial=0) if limit is None else limit)
    orders, sizes, spread = orders[keep], sizes[keep], spread[keep]
    hidden = np.isin(orders, list(suppressed))
    shown = ~hidden & ~np.isnan(sizes)
    tops = sizes[shown] + 2.0 * np.nan_to_num(spread[shown])
    largest = float(tops.max(initial=0.0))
    scale, name = readable_unit(largest, unit)
    with house_style():
        axes = axes_or_new(ax)
        height = 1.12 * largest * scale or 1.0
        if hidden.any():
            axes.bar(
                orders[hidden],
                height,
                width=0.9,
                fc="none",
                ec="#9A9A9A",
                lw=0.0,
                hatch="////",
                label="not seen or removed",
            )
        axes.bar(orders[shown], sizes[shown] * scale, width=0.72, color=COLOURS["estimate"])
        if np.isfinite(spread[shown]).any():
            axes.errorbar(
                orders[shown],
                sizes[shown] * scale,
                yerr=2.0 * spread[shown] * scale,
                fmt="none",
                ecolor=COLOURS["text"],
                elinewidth=0.9,
                capsize=1.5,
                label="± 2 standard uncertainties",
            )
        _dress(axes, orders, height, f"{label} in {name}")
    return axes


def _dress(axes: Axes, orders: NDArray[np.intp], height: float, label: str) -> None:
    from matplotlib.ticker import MaxNLocator

    axes.set_xlabel("undulations per revolution k")
    axes.set_ylabel(label)
    axes.set_ylim(0.0, height)
    if orders.size:
        axes.set_xlim(float(orders.min()) - 0.7, float(orders.max()) + 0.7)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, steps=[1, 2, 5, 10]))
    axes.grid(axis="x", visible=False)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="upper right")
