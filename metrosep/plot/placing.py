"""Places of axes and labels from the widths of their numbers, without drawing anything.

The constrained layout of matplotlib draws every number several times to measure it, which takes longer
than the picture itself. Where the parts of a figure are known, arithmetic does.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from metrosep.plot.style import mark_placed, setting

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_POINT = 1.0 / 72.0  # inch

LINE = 1.2
"""Height of a line of text, in its size."""

_GAP = 4.0 * _POINT
"""Between numbers and the label beside them."""

_LEFT, _RIGHT, _BELOW, _ABOVE, _BETWEEN = 0.05, 0.2, 0.46, 0.27, 0.37  # inch
"""Room at the left of all and for half a number at the right; for numbers and label below, for a title
of one line above, and for it between panels."""

_MOST_TICKS = 5
"""Of one side of a map; each costs a millisecond."""

_BESIDE, _BAR, _BAR_GAP, _BAR_LEAST = 0.1, 0.1, 0.06, 1.5  # inch
"""Room at the right of a map; width of a colour bar, room at its left, and its least height."""


def widest_number(axis: Any) -> float:
    """Return the room that the numbers of an axis take, with their ticks."""
    low, high = sorted(axis.get_view_interval())
    slack = 1e-9 * (high - low)
    places = [v for v in axis.get_majorticklocs() if low - slack <= v <= high + slack]
    size = _size("ytick.labelsize")
    words = axis.get_major_formatter().format_ticks(places)
    widest = max((text_width(text, size) for text in words), default=0.0)
    ticks = setting("ytick.major.size") + setting("ytick.major.pad")
    return float(widest + ticks * _POINT)


@lru_cache(maxsize=4096)
def text_width(text: str, size: float) -> float:
    """Return the width of a text in the font of the house style."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import text_to_path

    font = FontProperties(family="DejaVu Sans", size=size)
    width, _, _ = text_to_path.get_text_width_height_descent(text, font, ismath=False)
    return float(width) * _POINT


def place_stack(figure: Figure, grid: Sequence[Axes]) -> None:
    """Place panels one above the other with room for the widest numbers at their left."""
    width, height = figure.get_size_inches()
    below, above = _BELOW / height, 1.0 - _ABOVE / height
    n, gap = len(grid), _BETWEEN / height
    each = (above - below - (n - 1) * gap) / n
    bottoms = [above - (i + 1) * each - i * gap for i in range(n)]

    def put(left: float) -> None:
        for axes, bottom in zip(grid, bottoms, strict=True):
            axes.set_position((left, bottom, 1.0 - _RIGHT / width - left, each))

    put(0.1)
    wide = max(widest_number(axes.yaxis) for axes in grid)
    label = _label_height(grid[0].yaxis)
    put((_LEFT + label + _GAP + wide) / width)
    for axes in grid:
        _put_labels(axes, figure, wide)
    mark_placed(figure)


def place_grid(figure: Figure, rows: Sequence[Sequence[Axes]], *, bar: Axes | None = None) -> None:
    """Place axes of one size in rows and columns, and a colour bar at their right."""
    width, height = (float(v) for v in figure.get_size_inches())
    n_rows, n_columns = len(rows), len(rows[0])
    drawn = [axes for row in rows for axes in row if axes.axison]
    titles = [axes.title for axes in drawn]
    sizes = [
        float(t.get_fontsize()) * (t.get_text().count("\n") + 1) for t in titles if t.get_text()
    ]
    above = (LINE * max(sizes, default=0.0) + setting("axes.titlepad")) * _POINT + _LEFT
    below = _numbers_height() + _GAP + _label_height(drawn[0].xaxis) + _LEFT
    tall = height / n_rows - above - below
    right = 0.0
    if bar is not None:
        _put(bar, figure, (0.0, below, _BAR, tall))
        bar.yaxis.set_major_locator(_locator(_MOST_TICKS + 3))
        right = _BAR_GAP + _BAR + widest_number(bar.yaxis) + _GAP
        right += _label_height(bar.yaxis) + _LEFT
    for axes in drawn:
        _put(axes, figure, (0.0, below, width / n_columns - 1.0, tall))
        _few_ticks(axes)
    wide = max(widest_number(axes.yaxis) for axes in drawn)
    left = _LEFT + _label_height(drawn[0].yaxis) + _GAP + wide
    each = (width - right) / n_columns - left - _BESIDE
    for i, row in enumerate(rows):
        for j, axes in enumerate(row):
            start = j * (left + each + _BESIDE) + left
            _put(axes, figure, (start, (n_rows - 1 - i) * height / n_rows + below, each, tall))
    for axes in drawn:
        _few_ticks(axes)
        _put_labels(axes, figure, widest_number(axes.yaxis))
    if bar is not None:
        _put_bar(bar, figure, drawn, width - right + _BAR_GAP)
    mark_placed(figure)


def _few_ticks(axes: Axes) -> None:
    """Let axes shrink to their aspect, and have no more ticks than small axes need."""
    axes.apply_aspect()
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(_locator(max(1, min(_MOST_TICKS, int(axis.get_tick_space())))))


def _locator(n: int) -> Any:
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(n, steps=(1, 2, 2.5, 5, 10))


def _put_bar(bar: Axes, figure: Figure, drawn: Sequence[Axes], start: float) -> None:
    """Place a colour bar beside axes, as tall as they are, but no shorter than its numbers need."""
    height = float(figure.get_size_inches()[1])
    boxes = [axes.get_position() for axes in drawn]
    low, high = min(b.y0 for b in boxes) * height, max(b.y1 for b in boxes) * height
    tall, middle = max(high - low, min(_BAR_LEAST, 0.8 * height)), 0.5 * (low + high)
    _put(bar, figure, (start, middle - 0.5 * tall, _BAR, tall))
    axis = bar.yaxis
    axis.set_label_coords(1.0 + (widest_number(axis) + _GAP) / _BAR, 0.5)


def _put(axes: Axes, figure: Figure, box: tuple[float, float, float, float]) -> None:
    """Place axes: left, bottom, width and height in inches."""
    width, height = figure.get_size_inches()
    x, y, w, h = box
    axes.set_position((x / width, y / height, w / width, h / height))


def _put_labels(axes: Axes, figure: Figure, wide: float) -> None:
    """Put the labels where the numbers end, so that nothing is measured when they are drawn."""
    box = axes.get_position()
    width, height = (float(v) for v in figure.get_size_inches())
    axes.yaxis.set_label_coords(-(wide + _GAP) / (box.width * width), 0.5)
    axes.xaxis.set_label_coords(0.5, -(_numbers_height() + _GAP) / (box.height * height))


def _numbers_height() -> float:
    """Return the room that the numbers below axes take, with their ticks, inch."""
    ticks = setting("xtick.major.size") + setting("xtick.major.pad")
    return float(ticks + _size("xtick.labelsize")) * _POINT


def _label_height(axis: Any) -> float:
    """Return the height of the label of an axis, inch; 0 where there is none."""
    text = axis.get_label_text()
    lines = text.count("\n") + 1 if text else 0
    return float(axis.label.get_fontsize() * LINE * lines) * _POINT


def _size(name: str) -> float:
    """Return a size of the style that may be a word, point."""
    from matplotlib.font_manager import FontProperties

    return float(FontProperties(size=setting(name)).get_size_in_points())
