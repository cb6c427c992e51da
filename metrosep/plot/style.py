"""How every figure looks, and the figure as bytes: one style, one set of colours, no global state.

matplotlib is imported inside the functions; figures are made without pyplot, so nothing is kept
open and nothing of the caller's matplotlib changes. Values come from a result as JSON gives them:
``None`` is "not measured" and stays a gap.
"""

from __future__ import annotations

import contextlib
import io
import re
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING, Any, Literal
from weakref import WeakSet

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.readable import typeset
from metrosep.core.units import parse_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Document = Mapping[str, Any]
Draw = Callable[[Document], "Axes | Figure"]

COLOURS: Mapping[str, str] = {
    "estimate": "#0072B2",
    "reverse": "#8C3B7A",
    "after": "#D55E00",
    "before": "#5A5A5A",
    "zone": "#E8EDF2",
    "text": "#1A1A1A",
    "line": "#555555",
}
"""After Okabe and Ito: told apart with any colour vision; more than one line of a colour goes by lightness."""

BARS = ("estimate", "after", "before", "reverse")
LINES = ("estimate", "after", "reverse", "before")
"""Colours in the order in which bars and lines get them."""

DASHED: Any = (0, (5, 1.6))
DOTTED: Any = (0, (1.2, 1.2))

BAND_FACTOR = 2.0
"""The band drawn is this many standard uncertainties wide on each side."""

_FIGURE_SIZE = (7.2, 3.9)
_STYLE: Mapping[str, Any] = {
    "svg.hashsalt": "metrosep",
    "svg.fonttype": "path",
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.labelsize": 9.5,
    "axes.edgecolor": "#555555",
    "axes.labelcolor": "#1A1A1A",
    "axes.titley": 1.0,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#D8D8D8",
    "grid.linewidth": 0.6,
    "xtick.color": "#333333",
    "ytick.color": "#333333",
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "legend.handlelength": 2.6,
    "lines.solid_capstyle": "round",
    "path.simplify": False,
}


@contextmanager
def house_style() -> Iterator[None]:
    """Set the style of all figures for a ``with`` block, whatever the user's own settings are.

    Yields
    ------
    None
        The previous settings return at the end of the block.

    Notes
    -----
    The settings of matplotlib belong to the process, so one thread at a time draws.
    """
    import matplotlib as mpl

    with _LOCK:
        if _inside[0]:  # of another block: nothing to set again
            yield
            return
        parameters: Any = mpl.rcParams
        before = {k: v for k, v in parameters.copy().items() if not k.startswith(_NO_STYLE)}
        _inside[0] = True
        try:
            dict.update(parameters, _settings())
            yield
        finally:
            _inside[0] = False
            dict.update(parameters, before)


_LOCK = threading.RLock()
_inside = [False]
_NO_STYLE = (
    "backend", "interactive", "toolbar", "timezone", "date.epoch", "docstring", "savefig.directory",
    "tk.", "webagg.",
)  # fmt: skip
"""Beginnings of settings that say how matplotlib works, not how a figure looks: left alone."""


@cache
def _settings() -> Mapping[str, Any]:
    """Return all settings of the style; they are checked once."""
    import matplotlib as mpl
    import matplotlib.style

    with matplotlib.style.context(["default", dict(_STYLE)]):
        parameters: Any = mpl.rcParams.copy()
    return {k: v for k, v in parameters.items() if not k.startswith(_NO_STYLE)}


def axes_or_new(ax: Axes | None, *, size: tuple[float, float] = _FIGURE_SIZE) -> Axes:
    """Return the given axes, or axes in a new figure that no window manager knows.

    Parameters
    ----------
    ax : matplotlib Axes or None
        Axes to draw into.
    size : tuple of (float, float), inch, optional
        Width and height of a new figure.

    Returns
    -------
    matplotlib Axes
        Where to draw.
    """
    return new_figure(size).add_subplot() if ax is None else ax


def new_figure(
    size: tuple[float, float], *, layout: Literal["constrained"] | None = "constrained"
) -> Figure:
    """Return an empty figure, width and height in inches, that no window manager knows."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout=layout)
    FigureCanvasAgg(figure)
    return figure


def known_to_pyplot(made: Any) -> Any:
    """Return axes or a figure; pyplot knows it where the caller works with pyplot or in a notebook.

    So a notebook shows it, and ``plt.show()`` and ``plt.savefig()`` find it, as they do pictures of other packages.
    """
    if "matplotlib.pyplot" not in sys.modules and "IPython" not in sys.modules:
        return made
    import matplotlib.pyplot as plt

    figure = made if hasattr(made, "savefig") else made.figure
    # before matplotlib 3.11 a figure could not be handed over
    with contextlib.suppress(AttributeError, TypeError, ValueError):
        if getattr(figure.canvas, "manager", None) is None:
            plt.figure(figure)
    return made


def values(column: Sequence[float | None] | None) -> FloatArray:
    """Return a column of a result as numbers, ``None`` as NaN."""
    return np.array([np.nan if v is None else v for v in column or ()], dtype=np.float64)


def length_scale(*columns_nm: FloatArray) -> tuple[float, str]:
    """Return the factor from nm and the name of the unit in which the largest value reads well.

    Examples
    --------
    >>> length_scale(np.array([-5000.0, np.nan]))
    (0.001, 'µm')
    """
    sizes = [float(np.nanmax(np.abs(c))) for c in columns_nm if np.isfinite(c).any()]
    return (1e-3, "µm") if max(sizes, default=0.0) >= 2000.0 else (1.0, "nm")


DIMENSIONS = {"m": "length", "rad": "angle", "V": "voltage", "s": "time"}
"""By SI unit."""


def stated_unit(unit: str, base: str) -> tuple[str, float]:
    """Return the name at an axis, and the value in SI, of a unit that a caller states for values in `base`.

    Examples
    --------
    >>> stated_unit("um", "m")
    ('µm', 1e-06)
    """
    factor = parse_unit(unit, dimension=DIMENSIONS.get(base)).factor
    return typeset(unit), factor


UNITS: Mapping[str, Sequence[tuple[float, str]]] = {
    "m": ((1.0, "m"), (1e3, "mm"), (1e6, "µm"), (1e9, "nm"), (1e12, "pm")),
    "rad": ((1.0, "rad"), (1e3, "mrad"), (1e6, "µrad"), (1e9, "nrad")),
    "s": ((1.0 / 3600.0, "h"), (1.0 / 60.0, "min"), (1.0, "s"), (1e3, "ms")),
}
"""Factor and name of the units of a quantity in SI, the coarsest first."""


def scale_of(unit: str, largest: float, *, least: float = 2.0) -> tuple[float, str]:
    """Return factor and name of the coarsest unit in which a value is `least` or more."""
    steps = UNITS.get(unit)
    if steps is None:
        return 1.0, "" if unit == "1" else unit
    return next((s for s in steps if largest * s[0] >= least), steps[-1])


def draw_band(
    axes: Axes,
    x: FloatArray,
    middle: FloatArray,
    half: FloatArray | float,
    colour: Any,
    **style: Any,
) -> None:
    """Fill half a width on each side of a curve, lightly unless the style says otherwise."""
    style = {"alpha": 0.25, "linewidth": 0.0, **style}
    axes.fill_between(x, middle - half, middle + half, color=colour, **style)


def write_beside(
    axes: Axes, text: str, at: tuple[float, float], offset: tuple[float, float], **style: Any
) -> None:
    """Write a text some points away from a place."""
    style = {"fontsize": 8.0, **style}
    axes.annotate(text, at, xytext=offset, textcoords="offset points", **style)


def shades(colour: str, n: int) -> list[tuple[float, float, float]]:
    """Return a colour and lighter ones of it, the lightest first."""
    from matplotlib.colors import to_rgb

    red, green, blue = to_rgb(colour)
    whiteness = [0.62 * (n - 1 - i) / max(n - 1, 1) for i in range(n)]
    return [
        (red + (1 - red) * w, green + (1 - green) * w, blue + (1 - blue) * w) for w in whiteness
    ]


def speed_name(feed_mm_min: float | None) -> str:
    """Return the name of a feedrate in a legend.

    Examples
    --------
    >>> speed_name(4800.0)
    '4800 mm/min'
    """
    return "feedrate not known" if feed_mm_min is None else f"{feed_mm_min:.6g} mm/min"


def label_decades(axes: Axes) -> None:
    """Label a logarithmic x axis at 1, 2 and 5 of each decade, without powers of ten.

    Parameters
    ----------
    axes : matplotlib Axes
        Whose x axis becomes logarithmic.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())


_DROPS_PIXELS = "image-rendering:crisp-edges;image-rendering:pixelated"


def figure_svg(
    draw: Draw, document: Document, *, finish: Callable[[Any], None] | None = None
) -> str:
    """Return a figure as SVG text; the same document gives the same bytes.

    Parameters
    ----------
    draw : callable
        One of the drawing functions of `metrosep.plot`.
    document : mapping
        A result.
    finish : callable, optional
        Changes the figure before it is written, such as the language of its words.

    Returns
    -------
    str
        SVG with the letters as outlines, so that it looks the same everywhere.
    """
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    with house_style():
        figure = _figure_of(draw(document))
        lighten(figure)
        if finish is not None:
            finish(figure)
        stream = io.StringIO()
        undated = {"Date": None, "Creator": None, "Type": None, "Format": None}
        # not savefig, which draws everything once more before
        canvas: Any = FigureCanvasSVG(figure)
        canvas.print_svg(stream, metadata=undated)
    # a screen with fewer pixels than a map shows means of them; "pixelated" would drop some
    return stream.getvalue().replace(_DROPS_PIXELS, "image-rendering:auto")


_FONTS = (
    "DejaVu Sans", "Noto Sans CJK", "Noto Sans SC", "Noto Sans JP", "Source Han Sans", "Microsoft YaHei",
    "SimHei", "Yu Gothic", "Meiryo", "MS Gothic", "PingFang", "Hiragino Sans", "WenQuanYi", "IPAexGothic",
    "Droid Sans Fallback",
)  # fmt: skip
"""Beginnings of the names of fonts, the most wanted first; those after the first have Chinese and Japanese letters."""


@cache
def font_with(letters: str) -> str | None:
    """Return the name of an installed font that has all letters; None if there is none."""
    from matplotlib import font_manager
    from matplotlib.ft2font import FT2Font

    known = font_manager.fontManager
    if not any(
        f.name.startswith(_FONTS[1:]) for f in known.ttflist
    ):  # installed after the list was made
        held = {f.fname for f in known.ttflist}
        for path in sorted({*font_manager.findSystemFonts()} - held):
            with contextlib.suppress(Exception):  # a font that cannot be read is none to draw with
                known.addfont(path)
    wanted = {ord(c) for c in letters if not c.isspace()}
    plain = [
        f for f in known.ttflist if f.style == "normal" and str(f.weight) in ("400", "normal")
    ]
    for start in _FONTS:
        for font in sorted((f for f in plain if f.name.startswith(start)), key=lambda f: f.fname):
            if wanted <= FT2Font(font.fname).get_charmap().keys():
                return str(font.name)
    return None


def localise(
    figure: Figure, *, words: Mapping[str, str], decimal: str, font: str | None = None
) -> None:
    """Put the words of a figure into another language, the longest phrase first, its decimal sign and font."""
    from matplotlib.text import Text

    longest_first = sorted(words, key=lambda phrase: -len(phrase))
    phrases = re.compile("|".join(rf"\b{re.escape(w)}(?!\w)" for w in longest_first))

    def said(text: str) -> str:
        text = phrases.sub(lambda found: words[found[0]], text) if words else text
        return re.sub(r"(?<=\d)\.(?=\d)", decimal, text)

    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            for formatter in (axis.get_major_formatter(), axis.get_minor_formatter()):
                formatter.format_ticks = _then(said, formatter.format_ticks)  # type: ignore[assignment, method-assign]
    for item in figure.findobj(Text):
        item.set_text(said(item.get_text()))
        if font is not None:
            item.set_fontfamily(["DejaVu Sans", font])


def _then(
    said: Callable[[str], str], ticks: Callable[[Any], list[str]]
) -> Callable[[Any], list[str]]:
    return lambda places: [said(label) for label in ticks(places)]


def figure_png(draw: Draw, document: Document, *, dpi: float = 200.0) -> bytes:
    """Return a figure as the bytes of a PNG file.

    Parameters
    ----------
    draw : callable
        One of the drawing functions of `metrosep.plot`.
    document : mapping
        A result.
    dpi : float, 1/inch, optional
        Resolution.

    Returns
    -------
    bytes
        PNG without a date.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    with house_style():
        figure = _figure_of(draw(document))
        lighten(figure)
        FigureCanvasAgg(figure)
        stream = io.BytesIO()
        figure.savefig(stream, format="png", dpi=dpi, metadata={"Software": None})
    return stream.getvalue()


def _figure_of(drawn: Axes | Figure) -> Figure:
    from matplotlib.figure import Figure

    if isinstance(drawn, Figure):
        return drawn
    figure = drawn.get_figure(root=True)
    if figure is None:
        raise ValueError("the axes belong to no figure")
    return figure


# ---- numbers, ticks and grid of a finished figure as a few artists instead of dozens -----------
# matplotlib makes three lines and two texts for every tick, drawn or not, which is most of the time of a
# small figure. In a figure that becomes bytes now, and will not be zoomed, one line with markers holds
# all ticks of an axis, and one collection its grid; what is seen is the same.

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
