"""A map over an aperture, on rings or on squares, in its own unit and on a scale about zero."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.plot.style import axes_or_new, house_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["disc_map", "readable_length"]


_UNITS = ((1.0, "m"), (1e-3, "mm"), (1e-6, "µm"), (1e-9, "nm"), (1e-12, "pm"))


def readable_length(largest: float) -> tuple[float, str]:
    """Return the unit in which the largest of some lengths reads well.

    Examples
    --------
    >>> readable_length(3.2e-8), readable_length(1.5e-6)[1]
    ((1e-09, 'nm'), 'nm')
    """
    if not largest > 0.0:
        return 1e-9, "nm"
    return next((u for u in _UNITS if largest >= 2.0 * u[0]), _UNITS[-1])


def disc_map(
    x: ArrayLike,
    y: ArrayLike,
    values: ArrayLike,
    *,
    title: str = "",
    quantity: str = "error",
    limit: float | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Return a map of lengths over an aperture, with a scale that is symmetric about zero.

    Parameters
    ----------
    x, y : array_like, shape (n, m), m
        Positions: rings by azimuths, or rows by columns.
    values : array_like, shape (n, m), m
        What is drawn; NaN stays blank.
    title : str, optional
        Its P-V is added.
    quantity : str, optional
        Name beside the colours.
    limit : float, m, optional
        End of the colour scale; the largest magnitude if omitted.
    ax : matplotlib Axes, optional
        Where to draw.

    Returns
    -------
    matplotlib Axes
        Equal scales along x and y.

    Raises
    ------
    DataError
        If the arrays are no maps of one shape, or nothing is known.
    """
    place_x, place_y, z = (np.asarray(v, dtype=np.float64) for v in (x, y, values))
    if z.ndim != 2 or not place_x.shape == place_y.shape == z.shape:
        raise DataError(
            f"x, y and values must be maps of one shape, got {place_x.shape}, {place_y.shape} and "
            f"{z.shape}"
        )
    known = z[np.isfinite(z)]
    if not known.size:
        raise DataError("there is nothing to draw: all values are NaN")
    largest = float(np.abs(known).max())
    unit, symbol = readable_length(largest if limit is None else limit)
    reach = float(max(np.ptp(place_x), np.ptp(place_y)) / 2.0)
    along, name = readable_length(reach)
    end = (largest if limit is None else limit) / unit or 1.0
    with house_style():
        axes = axes_or_new(ax, size=(5.0, 4.2))
        mesh = _drawn(axes, place_x / along, place_y / along, z / unit, end)
        axes.grid(visible=False)
        axes.set_aspect("equal")
        axes.set_xlabel(f"x / {name}")
        axes.set_ylabel(f"y / {name}")
        axes.set_title(f"{title}\nP-V {np.ptp(known) / unit:.4g} {symbol}".strip(), fontsize=9.0)
        bar = axes.figure.colorbar(mesh, ax=axes, shrink=0.85, aspect=22)
        bar.set_label(f"{quantity} / {symbol}")
    return axes


def _drawn(axes: Axes, x: FloatArray, y: FloatArray, z: FloatArray, end: float) -> Any:
    options: dict[str, Any] = {"cmap": "RdBu_r", "vmin": -end, "vmax": end}
    on_rings = np.ptp(np.hypot(x, y), axis=1).max() < 1e-9 * float(np.abs(x).max() or 1.0)
    if on_rings:  # close the circle: the first azimuth once more
        x, y, z = (np.concatenate([v, v[:, :1]], axis=1) for v in (x, y, z))
    masked = np.ma.masked_invalid(z)
    return axes.pcolormesh(
        x, y, masked, shading="gouraud" if on_rings else "nearest", rasterized=True, **options
    )
