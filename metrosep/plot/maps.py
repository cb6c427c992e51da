"""Maps of the parts of a separation side by side, on one colour scale, and what was not seen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.plot.placing import place_grid
from metrosep.plot.style import COLOURS, house_style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["separation_maps"]


_INVALID = "#B8B8B8"
_COLOUR_MAP = "RdBu_r"
_MOST_COLUMNS = 3
_WRAP_PER_MAP = 46
_PREFIXES = ((1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n"), (1e-12, "p"))


def separation_maps(
    parts: Mapping[str, ArrayLike],
    *,
    dx: float | None,
    dy: float | None,
    unit: str = "m",
    titles: Mapping[str, str] | Sequence[str] | None = None,
    null_space: Sequence[Any] = (),
    origin: tuple[float, float] = (0.0, 0.0),
    pv: Mapping[str, float | None] | None = None,
) -> Figure:
    r"""Return a figure with one map for each part, all on one colour scale.

    Parameters
    ----------
    parts : mapping of str to array_like, shape (n_y, n_x) or (n_y, n_x, 2)
        Maps in `unit`; NaN = not measured, drawn grey. A last axis of two gives an x and a y map.
    dx, dy : float or None, m
        Lateral steps; without them the axes count pixels.
    unit : str, optional
        SI unit of the values; a prefix is chosen for the colour bar.
    titles : mapping or sequence of str, optional
        Title of each part; its name if omitted.
    null_space : sequence, optional
        What was not seen, of a result: each is written below the maps.
    origin : tuple of (float, float), m, optional
        Position of the first pixel.
    pv : mapping of str to float, optional
        P-V by part, where the maps drawn are thinned out and the whole ones have another.

    Returns
    -------
    matplotlib Figure
        Row 0 of a map is at the bottom: y grows upwards.

    Raises
    ------
    DataError
        If there is no part, or one is no map.

    Notes
    -----
    The scale is symmetric about zero, so that a flipped sign is seen, and the same for all maps;
    the number in each title is the P-V of that map.

    Examples
    --------
    >>> figure = separation_maps({"A": [[0.0, 1e-9], [2e-9, float("nan")]]}, dx=1e-3, dy=1e-3)
    >>> figure.axes[0].get_title()
    'A\nP-V 2 nm'
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    maps = _flattened(parts, titles)
    known = [m[np.isfinite(m)] for _, m in maps]
    largest = max((float(np.abs(k).max()) for k in known if k.size), default=0.0)
    factor, prefix = next((p for p in _PREFIXES if largest >= p[0]), _PREFIXES[-1])
    if largest == 0.0:
        factor, prefix = 1e-9, "n"
    with house_style():
        n_columns = 2 if len(maps) == 4 else min(len(maps), _MOST_COLUMNS)
        n_rows = -(-len(maps) // n_columns)
        figure = Figure(
            figsize=(2.5 * n_columns + 0.9, 2.6 * n_rows + 0.35 + 0.3 * len(null_space)),
            layout="constrained" if null_space else None,
        )
        FigureCanvasAgg(figure)
        grid = figure.subplots(n_rows, n_columns, squeeze=False)
        image: Any = None
        for axes, (title, values) in zip(grid.flat, maps, strict=False):
            image = _draw(axes, values / factor, dx, dy, origin, largest / factor)
            words = _height(values / factor, (pv or {}).get(title), factor, prefix + unit)
            axes.set_title("\n".join(filter(None, (title, words))), fontsize=9.0)
        for axes in list(grid.flat)[len(maps) :]:
            axes.set_axis_off()
        where: dict[str, Any] = {"ax": grid, "shrink": 0.85, "aspect": 25}
        if not null_space:
            where = {"cax": figure.add_axes((0.9, 0.1, 0.05, 0.8))}
        bar = figure.colorbar(image, **where)
        bar.set_label(f"value / {prefix}{unit}")
        if not null_space:
            place_grid(figure, grid.tolist(), bar=bar.ax)
        else:
            text = "\n".join(
                fill(f"not seen: {item}", _WRAP_PER_MAP * n_columns) for item in null_space
            )
            figure.supxlabel(text, fontsize=7.5, color=COLOURS["text"], x=0.02, ha="left")
    return figure


def _flattened(
    parts: Mapping[str, ArrayLike], titles: Mapping[str, str] | Sequence[str] | None
) -> list[tuple[str, FloatArray]]:
    if not parts:
        raise DataError("there is no part to draw")
    names = list(parts)
    if titles is None:
        shown = {n: n for n in names}
    elif isinstance(titles, Mapping):
        shown = {n: titles.get(n, n) for n in names}
    else:
        if len(titles) != len(names):
            raise DataError(f"{len(titles)} titles for {len(names)} parts; give one for each")
        shown = dict(zip(names, titles, strict=True))
    out = []
    for name, values in parts.items():
        array = np.asarray(values, dtype=np.float64)
        if array.ndim == 3 and array.shape[-1] == 2:
            out += [(f"{shown[name]}, {a}", array[..., i]) for i, a in enumerate("xy")]
        elif array.ndim == 2:
            out.append((shown[name], array))
        else:
            raise DataError(f"the part {name!r} has the shape {array.shape}; it is no map")
    return out


def _height(shown: FloatArray, whole: float | None, factor: float, unit: str) -> str:
    """Return the P-V of a map in words: that of the whole one, where only some pixels are shown."""
    if whole is not None:
        return f"P-V {whole / factor:.3g} {unit}"
    known = shown[np.isfinite(shown)]
    return f"P-V {np.ptp(known):.3g} {unit}" if known.size else "not determined"


def _draw(
    axes: Any,
    values: FloatArray,
    dx: float | None,
    dy: float | None,
    origin: tuple[float, float],
    limit: float,
) -> Any:
    import matplotlib as mpl

    colours = mpl.colormaps[_COLOUR_MAP].with_extremes(bad=_INVALID)
    step_x, step_y = (dx * 1e3, dy * 1e3) if dx and dy else (1.0, 1.0)
    n_y, n_x = values.shape
    first = (origin[0] * 1e3, origin[1] * 1e3) if dx and dy else (0.0, 0.0)
    extent = (
        first[0] - 0.5 * step_x,
        first[0] + (n_x - 0.5) * step_x,
        first[1] - 0.5 * step_y,
        first[1] + (n_y - 0.5) * step_y,
    )
    limit = limit or 1.0
    image = axes.imshow(
        np.ma.masked_invalid(values),
        origin="lower",
        extent=extent,
        cmap=colours,
        vmin=-limit,
        vmax=limit,
        interpolation="nearest",
    )
    axes.grid(visible=False)
    place = "mm" if dx and dy else "pixel"
    axes.set_xlabel(f"x / {place}")
    axes.set_ylabel(f"y / {place}")
    return image
