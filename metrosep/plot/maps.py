"""Maps of the parts of a separation side by side, on one colour scale, and what was not seen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.core.numbers import positive
from metrosep.core.readable import digits_of, readable_unit, typeset
from metrosep.plot.accepted import takes_separations
from metrosep.plot.placing import place_grid
from metrosep.plot.style import (
    BAND_FACTOR,
    COLOURS,
    axes_or_new,
    draw_band,
    house_style,
    length_scale,
    new_figure,
    shades,
    stated_unit,
)
from metrosep.separation.contract import Separation, Unobservable

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_INVALID = "#B8B8B8"
_COLOUR_MAP, _COLOURS_OF_HEIGHTS = "RdBu_r", "viridis"
_MOST_COLUMNS = 3
_WRAP_PER_MAP = 46
_PREFIXES = ((1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n"), (1e-12, "p"))


def separation_maps(
    parts: Mapping[str, ArrayLike],
    *,
    dx: float | None,
    dy: float | None,
    unit: str = "m",
    shown_in: str | None = None,
    titles: Mapping[str, str] | Sequence[str] | None = None,
    null_space: Sequence[Any] = (),
    origin: tuple[float, float] = (0.0, 0.0),
    pv: Mapping[str, float | None] | None = None,
    limits: Sequence[float] | None = None,
    outside: Sequence[int] = (0, 0),
    signed: bool = True,
    quantity: str = "value",
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
    shown_in : str, optional
        Unit at the colour bar, such as "nm", where the choice is not left to the values.
    titles : mapping or sequence of str, optional
        Title of each part; its name if omitted.
    null_space : sequence, optional
        What was not seen, of a result: each is written below the maps.
    origin : tuple of (float, float), m, optional
        Position of the first pixel.
    pv : mapping of str to float, optional
        P-V by part, where the maps drawn are thinned out and the whole ones have another.
    limits : sequence of (float, float), optional
        Values at the ends of the scale; plus and minus the largest value if omitted.
    outside : sequence of (int, int), optional
        How many values lie below and above; the ends of the colour bar are pointed where there are some.
    signed : bool, optional
        Whether zero has a meaning (a residual, a difference, an error).
    quantity : str, optional
        What the values are, at the colour bar.

    Returns
    -------
    matplotlib Figure
        Row 0 of a map is at the bottom: y grows upwards.

    Raises
    ------
    DataError
        If there is no part, or one is not a map.

    Notes
    -----
    The scale is the same for all maps; the number in each title is the P-V of that map. Where zero has
    a meaning the scale is symmetric about it, so that a flipped sign is seen.

    Examples
    --------
    >>> figure = separation_maps({"A": [[0.0, 1e-9], [2e-9, float("nan")]]}, dx=1e-3, dy=1e-3)
    >>> figure.axes[0].get_title()
    'A\nP-V 2 nm'
    """
    dx, dy = (
        None if v is None else positive(v, name, dimension="length")
        for v, name in ((dx, "dx"), (dy, "dy"))
    )
    maps = _flattened(parts, titles)
    known = [m[np.isfinite(m)] for _, m in maps]
    largest = max((float(np.abs(k).max()) for k in known if k.size), default=0.0)
    low, high = (-largest, largest) if limits is None else limits
    largest = max(abs(low), abs(high))
    factor, prefix = next((p for p in _PREFIXES if largest >= p[0]), _PREFIXES[-1])
    if largest == 0.0:
        factor, prefix = 1e-9, "n"
    name = f"{prefix}{unit}"
    if shown_in is not None:
        name, factor = stated_unit(shown_in, unit)
    with house_style():
        n_columns = 2 if len(maps) == 4 else min(len(maps), _MOST_COLUMNS)
        n_rows = -(-len(maps) // n_columns)
        size = (2.5 * n_columns + 0.9, 2.6 * n_rows + 0.35 + 0.3 * len(null_space))
        figure = new_figure(size, layout="constrained" if null_space else None)
        grid = figure.subplots(n_rows, n_columns, squeeze=False)
        image: Any = None
        for axes, (title, values) in zip(grid.flat, maps, strict=False):
            image = draw_map(
                axes, values / factor, dx, dy, origin, (low / factor, high / factor), signed=signed
            )
            words = _height(values, (pv or {}).get(title), unit)
            axes.set_title(typeset("\n".join(filter(None, (title, words)))), fontsize=9.0)
        for axes in list(grid.flat)[len(maps) :]:
            axes.set_axis_off()
        where: dict[str, Any] = {"ax": grid, "shrink": 0.85, "aspect": 25}
        if not null_space:
            where = {"cax": figure.add_axes((0.9, 0.1, 0.05, 0.8))}
        ends = {(True, True): "both", (True, False): "min", (False, True): "max"}
        pointed = ends.get((outside[0] > 0, outside[1] > 0), "neither")
        bar = figure.colorbar(image, extend=pointed, **where)
        bar.set_label(f"{quantity} / {name}")
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
            raise DataError(f"the part {name!r} has the shape {array.shape}; it is not a map")
    return out


def _height(shown: FloatArray, whole: float | None, unit: str) -> str:
    """Return the P-V of a map with a prefix of its own: of the whole one, where only some pixels are shown."""
    known = shown[np.isfinite(shown)]
    height = whole if whole is not None else float(np.ptp(known)) if known.size else None
    if height is None:
        return "not determined"
    name, factor = readable_unit([height], unit)
    return f"P-V {digits_of(height / factor)} {name.replace('u', 'µ', 1) if name[:1] == 'u' else name}"


_ENLARGED = 128
"""Pixels along a side up to which a picture is enlarged; a larger one is embedded with every pixel."""


def draw_map(
    axes: Any,
    values: FloatArray,
    dx: float | None,
    dy: float | None,
    origin: tuple[float, float],
    limits: tuple[float, float],
    *,
    signed: bool = True,
) -> Any:
    """Draw one map with its lower left pixel at `origin` and return the image."""
    import matplotlib as mpl

    name = _COLOUR_MAP if signed else _COLOURS_OF_HEIGHTS
    colours = mpl.colormaps[name].with_extremes(bad=_INVALID)
    step_x, step_y = (dx * 1e3, dy * 1e3) if dx and dy else (1.0, 1.0)
    n_y, n_x = values.shape
    first = (origin[0] * 1e3, origin[1] * 1e3) if dx and dy else (0.0, 0.0)
    extent = (
        first[0] - 0.5 * step_x,
        first[0] + (n_x - 0.5) * step_x,
        first[1] - 0.5 * step_y,
        first[1] + (n_y - 0.5) * step_y,
    )
    low, high = limits if limits[0] < limits[1] else (-1.0, 1.0)
    image = axes.imshow(
        np.ma.masked_invalid(values),
        origin="lower",
        extent=extent,
        cmap=colours,
        vmin=low,
        vmax=high,
        interpolation="none" if max(n_x, n_y) > _ENLARGED else "nearest",
    )
    axes.grid(visible=False)
    place = "mm" if dx and dy else "pixel"
    axes.set(xlabel=f"x / {place}", ylabel=f"y / {place}")
    return image


# ---- maps of a three-flat, rotation, shift or ball test, with what was not seen said once below ----

_PIXELS = "positions x and y are in pixels"


@takes_separations
def flat_maps(
    result: Separation, *, parts: Sequence[str] | None = None, uncertainty: bool = False
) -> Figure:
    """Return a figure of the maps of a result, with its null space below.

    Parameters
    ----------
    result : Separation
        Of `three_flat`, `rotation_average`, `shift_rotation`, `ball_average` or `three_positions`.
    parts : sequence of str, optional
        Which maps; all that hold a measured pixel if omitted.
    uncertainty : bool, optional
        Whether standard uncertainties are drawn instead.

    Returns
    -------
    matplotlib Figure
        One colour scale for all maps; grey = not determined.

    Raises
    ------
    DataError
        If a part is unknown, or the result holds no maps.

    Examples
    --------
    >>> import numpy as np
    >>> from metrosep.separation.maps.flats import three_flat
    >>> z = 1e-9 * np.outer(np.arange(9.0), np.ones(9)) ** 2
    >>> len(flat_maps(three_flat(z, z, z), parts=["even_A"]).axes)
    2
    """
    shape = (result.coordinates["y"].size, result.coordinates["x"].size) \
        if {"x", "y"} <= set(result.coordinates) else ()  # fmt: skip
    source = result.u if uncertainty else result.parts
    maps = {k: v for k, v in source.items() if v.shape == shape}
    if parts is None:
        chosen = [k for k, v in maps.items() if np.isfinite(v).any()]
    else:
        chosen = list(parts)
    for name in chosen:
        if name not in maps:
            raise DataError(f"the result has no map {name!r}; it has {', '.join(maps) or 'none'}")
    if not chosen:
        raise DataError("the result holds no map with a measured pixel")
    steps: list[float | None] = [None, None]
    if not any(_PIXELS in m for m in result.messages):
        steps = [float(np.diff(result.coordinates[k][:2])[0]) for k in ("x", "y")]
    titles = {k: f"u({k})" for k in chosen} if uncertainty else None
    return separation_maps(
        {k: maps[k] for k in chosen},
        dx=steps[0],
        dy=steps[1],
        titles=titles,
        null_space=_merged(result.null_space),
    )


def _merged(items: Sequence[Unobservable]) -> list[Unobservable]:
    """Return the null space with parts that lack the same for the same reason joined."""
    groups: dict[tuple[str, tuple[int | float | str, ...], str], list[str]] = {}
    for item in items:
        groups.setdefault((item.kind, item.indices, item.reason), []).append(item.part)
    return [
        Unobservable(", ".join(names), kind, indices, reason)  # type: ignore[arg-type]
        for (kind, indices, reason), names in groups.items()
    ]


# ---- figures of a stitching: where the sub-apertures lay, how they fit, what they give ---------

_MOST_NUMBERS = 12


@takes_separations
def stitch_layout(result: Separation, ax: Axes | None = None) -> Axes:
    """Draw the outline of each sub-aperture, numbered; those that do not fit stand out.

    Parameters
    ----------
    result : Separation
        Of `stitch`.
    ax : matplotlib Axes, optional
        Where to draw; a new figure if omitted.

    Returns
    -------
    matplotlib Axes
        One closed line for each sub-aperture.

    Raises
    ------
    DataError
        If the result is of another method.
    """
    from matplotlib.ticker import MaxNLocator

    audit = _audit(result)
    with house_style():
        axes = axes_or_new(ax, size=(5.6, 4.4))
        outlines = _outlines(audit)
        line = outlines[0].shape[1] == 1
        bad = {i for pair in audit["outlying_pairs"] for i in pair}
        counted = {i: sum(i in pair for pair in audit["outlying_pairs"]) for i in bad}
        worst = max(counted.values(), default=0)
        for k, outline in enumerate(outlines, start=1):
            wrong = counted.get(k, 0) == worst > 0
            colour = COLOURS["after"] if wrong else COLOURS["estimate"]
            style: dict[str, Any] = {
                "color": colour,
                "lw": 2.0 if wrong else 1.1,
                "label": f"sub-aperture {k}",
            }
            if line:
                axes.plot(outline[:, 0], [k, k], solid_capstyle="butt", **style)
                continue
            axes.plot(outline[:, 0], outline[:, 1], **style)
            axes.fill(outline[:, 0], outline[:, 1], color=colour, alpha=0.08, lw=0)
            middle = outline[:-1].mean(axis=0)
            x, y = middle + 0.8 * (outline[3] - middle)
            label = axes.text(x, y, str(k), ha="center", va="center", color=colour, fontsize=9.0)
            label.set_bbox({"fc": "white", "ec": "none", "pad": 1.0, "alpha": 0.85})
        axes.set_xlabel("x / mm")
        if line:
            axes.set_ylabel("profile")
            axes.yaxis.set_major_locator(MaxNLocator(integer=True))
            axes.invert_yaxis()
        else:
            axes.set_ylabel("y / mm")
            axes.set_aspect("equal", adjustable="datalim")
        title = f"{len(outlines)} sub-apertures, {len(audit['overlaps'])} overlaps"
        axes.set_title(title + (f", {len(audit['outlying_pairs'])} do not fit" if bad else ""))
    return axes


@takes_separations
def overlap_mismatch(result: Separation, ax: Axes | None = None) -> Axes:
    """Draw the RMS mismatch of each pair of sub-apertures as a matrix.

    Parameters
    ----------
    result : Separation
        Of `stitch`.
    ax : matplotlib Axes, optional
        Where to draw; a new figure if omitted.

    Returns
    -------
    matplotlib Axes
        Symmetric matrix in nm; pairs without overlap are blank, outliers framed.

    Raises
    ------
    DataError
        If the result is of another method.
    """
    import matplotlib as mpl
    from matplotlib.patches import Rectangle

    audit = _audit(result)
    n = int(audit["n_sub_apertures"])
    matrix = np.full((n, n), np.nan)
    for o in audit["overlaps"]:
        i, j = (k - 1 for k in o["pair"])
        matrix[i, j] = matrix[j, i] = o["residual_nm"]
    factor, unit = length_scale(matrix)
    with house_style():
        axes = axes_or_new(ax, size=(5.0, 4.2))
        colours = mpl.colormaps["cividis_r"].with_extremes(bad="white")
        top = float(np.nanmax(matrix)) * factor
        image = axes.imshow(
            np.ma.masked_invalid(matrix * factor), cmap=colours, vmin=0.0, vmax=top or 1.0
        )
        axes.grid(visible=False)
        if n <= _MOST_NUMBERS:
            for i, j in np.argwhere(np.isfinite(matrix)):
                value = matrix[i, j] * factor
                dark = value > 0.55 * top
                axes.text(
                    j,
                    i,
                    f"{value:.3g}",
                    ha="center",
                    va="center",
                    fontsize=7.0,
                    color="white" if dark else COLOURS["text"],
                )
        for i, j in audit["outlying_pairs"]:
            for a, b in ((i, j), (j, i)):
                axes.add_patch(
                    Rectangle((b - 1.5, a - 1.5), 1, 1, fill=False, ec=COLOURS["after"], lw=2.0)
                )
        step = max(1, n // 12)
        ticks = np.arange(0, n, step)
        axes.set_xticks(ticks, [str(t + 1) for t in ticks])
        axes.set_yticks(ticks, [str(t + 1) for t in ticks])
        axes.set(xlabel="sub-aperture", ylabel="sub-aperture")
        bar = axes.figure.colorbar(image, ax=axes, shrink=0.9)
        bar.set_label(f"RMS mismatch per reading / {unit}")
        axes.set_title("mismatch in the overlaps")
    return axes


@takes_separations
def stitched_surface(result: Separation, ax: Axes | None = None) -> Axes | Figure:
    """Draw what was stitched: maps on one colour scale, or a profile with its band.

    Parameters
    ----------
    result : Separation
        Of `stitch`.
    ax : matplotlib Axes, optional
        Where to draw a profile; maps make their own figure.

    Returns
    -------
    matplotlib Axes or Figure
        Profile: band of two standard uncertainties. Maps: surface, reference where fitted, and
        what was not seen.

    Raises
    ------
    DataError
        If the result is of another method.
    """
    audit = _audit(result)
    if result.parts["surface"].ndim == 2:
        dx, dy = (1e-3 * s for s in audit["step_mm"])
        parts = {k: result.parts[k] for k in ("surface", "reference") if k in result.parts}
        return separation_maps(parts, dx=dx, dy=dy, null_space=_not_seen(result))
    x = result.coordinates["x"] * 1e3
    z, u = (d["surface"] * 1e9 for d in (result.parts, result.u))
    factor, unit = length_scale(z)
    with house_style():
        axes = axes_or_new(ax)
        half = BAND_FACTOR * u
        light = shades(COLOURS["estimate"], 3)[0]
        draw_band(axes, x, z * factor, half * factor, light, alpha=None, label="± 2 u")
        axes.plot(x, z * factor, color=COLOURS["estimate"], lw=1.0, label="stitched")
        axes.set(xlabel="x / mm", ylabel=f"height / {unit}")
        axes.legend(loc="best")
    return axes


def _not_seen(result: Separation) -> list[str]:
    """Return one short line for the whole and one for what both parts exchange."""
    names = ("piston", "tilt", "power")
    rigid = [names[int(i)] for i in result.null_space[0].indices]
    out = [", ".join(rigid) + " of the whole"]
    terms = [
        str(i)
        for item in result.null_space
        if item.kind == "term" and item.part == "surface"
        for i in item.indices
    ]
    if terms:
        out.append("surface against reference: " + ", ".join(terms))
    return out


def _audit(result: Separation) -> Any:
    if result.method != "stitch":
        raise DataError(f"this is a result of {result.method}; a result of stitch is needed")
    return result.audit


def _outlines(audit: Any) -> list[FloatArray]:
    """Return the closed outline of each sub-aperture in mm; two ends of profiles."""
    dx, dy = audit["step_mm"]
    out = []
    for corner, shape, turn in zip(
        audit["positions_mm"], audit["shapes"], audit["rotations_rad"], strict=True
    ):
        w, h = (shape[1] - 1) * dx, (shape[0] - 1) * dy
        if len(corner) == 1:
            out.append(np.array([[corner[0]], [corner[0] + w]]))
            continue
        local = np.array([(-w, -h), (w, -h), (w, h), (-w, h), (-w, -h)]) / 2.0
        c, s = np.cos(turn), np.sin(turn)
        turned = local @ np.array([[c, s], [-s, c]])
        out.append(turned + np.array(corner) + np.array([w, h]) / 2.0)
    return out
