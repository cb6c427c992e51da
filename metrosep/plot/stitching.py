"""Figures of a stitching: where the sub-apertures lay, how they fit, what they give."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.plot.maps import separation_maps
from metrosep.plot.style import (
    BAND_FACTOR,
    COLOURS,
    axes_or_new,
    house_style,
    length_scale,
    shades,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from metrosep.separation.contract import Separation

__all__ = ["overlap_mismatch", "stitch_layout", "stitched_surface"]


_MOST_NUMBERS = 12


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
        axes.set_xlabel("sub-aperture")
        axes.set_ylabel("sub-aperture")
        bar = axes.figure.colorbar(image, ax=axes, shrink=0.9)
        bar.set_label(f"RMS mismatch per reading / {unit}")
        axes.set_title("mismatch in the overlaps")
    return axes


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
        axes.fill_between(
            x, (z - half) * factor, (z + half) * factor, color=light, lw=0, label="± 2 u"
        )
        axes.plot(x, z * factor, color=COLOURS["estimate"], lw=1.0, label="stitched")
        axes.set_xlabel("x / mm")
        axes.set_ylabel(f"height / {unit}")
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
