"""Numbers, ticks and grid of a finished figure as a few artists instead of dozens.

matplotlib makes three lines and two texts for every tick, drawn or not, which is most of the time of a
small figure. In a figure that becomes bytes now, and will not be zoomed, one line with markers holds
all ticks of an axis, and one collection its grid; what is seen is the same.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any
from weakref import WeakSet

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["lighten", "mark_placed", "setting"]

_PLACED: WeakSet[Any] = WeakSet()


def setting(name: str) -> Any:
    """Return a setting of the style that holds now."""
    import matplotlib as mpl

    parameters: Any = mpl.rcParams
    return parameters[name]


def mark_placed(figure: Figure) -> None:
    """Say that the labels of a figure have their places, and do not move with its numbers."""
    _PLACED.add(figure)


def lighten(figure: Figure) -> None:
    """Replace ticks, numbers and grid of the linear axes of a placed figure by light ones.

    Notes
    -----
    Axes with minor ticks, an offset beside their numbers or a scale of another kind stay as they are.
    """
    from matplotlib.ticker import NullLocator

    if figure not in _PLACED:
        return
    replaced = [
        getattr(axes, f"{name}axis")
        for axes in figure.axes
        for name in ("x", "y")
        if axes.axison and _replace(axes, name)
    ]
    for axis in replaced:  # not before all are read: panels share the ticks of their common axis
        axis.set_major_locator(NullLocator())


def _replace(axes: Axes, name: str) -> bool:
    """Draw ticks, numbers and grid of an axis; return whether that was possible."""
    from matplotlib.ticker import ScalarFormatter

    axis: Any = getattr(axes, f"{name}axis")
    formatter = axis.get_major_formatter()
    plain = type(formatter) is ScalarFormatter and axis.get_scale() == "linear"
    if not (plain and axis.get_visible() and not axis.get_minorticklocs().size):
        return False
    low, high = sorted(axis.get_view_interval())
    slack = 1e-9 * (high - low)
    places = [float(v) for v in axis.get_majorticklocs() if low - slack <= v <= high + slack]
    texts = formatter.format_ticks(places)
    if formatter.get_offset():
        return False
    shown = axis.get_tick_params(which="major")
    _grid(axes, name, places, shown)
    for side, text in (("bottom", 1), ("top", 2)) if name == "x" else (("left", 1), ("right", 2)):
        if shown.get(side):
            _ticks(axes, name, side, places)
        if shown.get(f"label{side}"):
            _numbers(axes, name, text, places, texts)
    return True


def _grid(axes: Axes, name: str, places: list[float], shown: dict[str, Any]) -> None:
    from matplotlib.collections import LineCollection

    if not shown.get("gridOn"):
        return
    lines = [[(v, 0.0), (v, 1.0)] if name == "x" else [(0.0, v), (1.0, v)] for v in places]
    axes.add_artist(
        LineCollection(
            lines,
            colors=setting("grid.color"),
            linewidths=setting("grid.linewidth"),
            linestyles=setting("grid.linestyle"),
            transform=_along(axes, name),
            zorder=_BELOW,
        )
    )


_BELOW = 0.5
"""Where matplotlib draws an axis that is below the curves."""


def _ticks(axes: Axes, name: str, side: str, places: list[float]) -> None:
    from matplotlib.lines import Line2D

    at = [1.0 if side in ("top", "right") else 0.0] * len(places)
    markers: Any = {"bottom": 3, "top": 2, "left": 0, "right": 1}  # TICKDOWN, -UP, -LEFT, -RIGHT
    x, y = (places, at) if name == "x" else (at, places)
    axes.add_artist(
        Line2D(
            x,
            y,
            linestyle="none",
            marker=markers[side],
            markersize=setting(f"{name}tick.major.size"),
            markeredgewidth=setting(f"{name}tick.major.width"),
            color=setting(f"{name}tick.color"),
            transform=_along(axes, name),
            clip_on=False,
            zorder=_BELOW,
        )
    )


def _numbers(axes: Axes, name: str, text: int, places: list[float], texts: list[str]) -> None:
    pad = setting(f"{name}tick.major.size") + setting(f"{name}tick.major.pad")
    transform, va, ha = getattr(axes, f"get_{name}axis_text{text}_transform")(pad)
    at = float(text - 1)
    size = setting(f"{name}tick.labelsize")
    colour = setting(f"{name}tick.color")
    for place, word in zip(places, texts, strict=True):
        x, y = (place, at) if name == "x" else (at, place)
        axes.text(
            x, y, word, transform=transform, va=va, ha=ha, fontsize=size, color=colour,
            zorder=_BELOW,
        )  # fmt: skip


def _along(axes: Axes, name: str) -> Any:
    """Return the transform of values along an axis, and of shares of the axes across it."""
    return getattr(axes, f"get_{name}axis_transform")(which="grid")
