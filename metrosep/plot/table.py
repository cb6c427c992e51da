"""The compensation table as a controller interpolates it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from metrosep.core.errors import DataError
from metrosep.plot.style import (
    COLOURS,
    DASHED,
    DOTTED,
    axes_or_new,
    house_style,
    length_scale,
    values,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["table_plot"]


def table_plot(document: Mapping[str, Any], ax: Axes | None = None) -> Axes:
    """Return axes with the corrections of the table over position.

    Parameters
    ----------
    document : mapping
        A result (schema ``metrosep.result/1``).
    ax : matplotlib Axes, optional
        Axes to draw into; new ones if omitted.

    Returns
    -------
    matplotlib Axes
        Position in mm; correction c = -e that is added to the command, in nm, or in µm where it
        is large; one point for each entry, joined as the controller joins them.

    Raises
    ------
    DataError
        If the result holds no table.
    """
    table = document.get("table")
    if not table or not table.get("positions_m"):
        raise DataError("this result holds no compensation table: nothing to draw")
    with house_style():
        axes = axes_or_new(ax, size=(7.2, 3.2))
        x = values(table["positions_m"]) * 1e3
        forward, reverse = (values(table.get(k)) * 1e9 for k in ("forward_m", "reverse_m"))
        scale, unit = length_scale(forward, reverse)
        axes.axhline(0.0, color=COLOURS["line"], linewidth=0.7, zorder=1.5)
        both = reverse.size == 0
        axes.plot(
            x,
            forward * scale,
            color=COLOURS["estimate"],
            marker="o",
            markersize=3.2,
            linewidth=1.2,
            label="correction, both directions" if both else "correction, forward",
        )
        if not both:
            axes.plot(
                x,
                reverse * scale,
                color=COLOURS["reverse"],
                marker="s",
                markersize=3.2,
                markerfacecolor="white",
                linewidth=1.2,
                linestyle=DASHED,
                label="correction, reverse",
            )
        if table.get("reference_m") is not None:
            axes.axvline(
                table["reference_m"] * 1e3,
                color=COLOURS["after"],
                linewidth=1.0,
                linestyle=DOTTED,
                label="reference (zero correction)",
            )
        axis, target = table.get("axis") or "axis", table.get("compensates") or "axis"
        axes.set(
            xlabel=f"position of {axis} / mm", ylabel=f"correction added to {target} / {unit}"
        )
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, borderaxespad=0.3)
    return axes
