"""Figures of a wavefront: its map, its Zernike terms as bars, and the image that it gives."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.plot.style import BARS, COLOURS, DASHED, axes_or_new, house_style, stated_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from metrosep.optics.image_quality import ModulationTransfer
    from metrosep.optics.wavefronts import Wavefront, ZernikeTable

_ORDERS = {"ansi": "ANSI", "noll": "Noll", "fringe": "Fringe"}


def wavefront_map(
    wavefront: Wavefront, *, ax: Axes | None = None, unit: str | None = None
) -> Axes:
    """Return the map of the optical path difference.

    Parameters
    ----------
    wavefront : Wavefront
        On rings or squares.
    ax : matplotlib Axes, optional
        Where to draw.
    unit : str, optional
        Unit of the values, such as "nm"; one in which they read well if omitted.

    Returns
    -------
    matplotlib Axes
        Titled with what was removed and the P-V.
    """
    rest = f" without {', '.join(wavefront.removed)}" if wavefront.removed else ""
    kind = "reflected" if wavefront.mode == "reflect" else f"refracted, n = {wavefront.n:.4g}"
    return disc_map(
        wavefront.x,
        wavefront.y,
        wavefront.opd,
        title=f"wavefront {kind}{rest}",
        quantity="path difference",
        ax=ax,
        unit=unit,
    )


def zernike_bars(
    tables: ZernikeTable | Mapping[str, ZernikeTable],
    *,
    leave_out: tuple[str, ...] = ("piston",),
    ax: Axes | None = None,
) -> Axes:
    """Return Zernike terms as bars, one colour for each wavefront.

    Parameters
    ----------
    tables : ZernikeTable or mapping of str to ZernikeTable
        One, or several by name, with the same terms.
    leave_out : tuple of str, optional
        Names of terms that are not drawn, such as "piston".
    ax : matplotlib Axes, optional
        Where to draw.

    Returns
    -------
    matplotlib Axes
        Lengths on the ordinate.

    Raises
    ------
    DataError
        If there is no table, or their terms differ.
    """
    from metrosep.forms.zernike import term_name

    named = dict(tables) if isinstance(tables, Mapping) else {"": tables}
    if not named:
        raise DataError("there is no table of Zernike terms to draw")
    first = next(iter(named.values()))
    if any(t.nm != first.nm or t.order != first.order for t in named.values()):
        raise DataError("the tables hold different terms; fit the same ones to each wavefront")
    labels = [term_name(n, m) for n, m in first.nm]
    shown = [i for i, label in enumerate(labels) if label not in leave_out]
    largest = max(float(np.abs(t.values()[shown]).max(initial=0.0)) for t in named.values())
    unit, symbol = readable_length(largest)
    terms = list(first.coefficients)
    with house_style():
        axes = axes_or_new(ax)
        width = 0.8 / len(named)
        for k, (name, table) in enumerate(named.items()):
            colour = COLOURS[BARS[k % len(BARS)]]
            place = np.arange(len(shown)) + (k - 0.5 * (len(named) - 1)) * width
            axes.bar(place, table.values()[shown] / unit, width, color=colour, label=name or None)
        axes.axhline(0.0, color=COLOURS["line"], linewidth=0.8)
        many = len(shown) > 16
        text = [terms[i] if many else f"{terms[i]}\n{labels[i]}" for i in shown]
        axes.set_xticks(
            range(len(shown)), text, rotation=90 if len(shown) > 6 else 0, fontsize=7.5
        )
        axes.grid(visible=False, axis="x")
        axes.set(ylabel=f"coefficient / {symbol}", xlabel=f"Zernike term, {_ORDERS[first.order]}")
        if any(named):
            axes.legend()
    return axes


def contrast_plot(
    transfers: ModulationTransfer | Mapping[str, ModulationTransfer], *, ax: Axes | None = None
) -> Axes:
    """Return modulation transfer functions against frequency over cut-off.

    Parameters
    ----------
    transfers : ModulationTransfer, or mapping of str to ModulationTransfer
        One, or several by the name that the legend shows.
    ax : matplotlib Axes, optional
        Where to draw; a new figure by default.

    Returns
    -------
    matplotlib Axes
        Contrast along x and y, and that of a full circle without error.

    Raises
    ------
    DataError
        If the mapping is empty.
    """
    named: dict[str, Any] = dict(transfers) if isinstance(transfers, Mapping) else {"": transfers}
    if not named:
        raise DataError("there is no modulation transfer function to draw")
    with house_style():
        axes = axes_or_new(ax)
        for k, (name, transfer) in enumerate(named.items()):
            colour = COLOURS[BARS[k % len(BARS)]]
            before = f"{name}, " if name else ""
            v = transfer.frequency_x / transfer.cutoff
            axes.plot(v, transfer.along_x, color=colour, label=f"{before}along x")
            v = transfer.frequency_y / transfer.cutoff
            axes.plot(
                v, transfer.along_y, color=colour, linestyle=DASHED, label=f"{before}along y"
            )
        v = np.linspace(0.0, 1.0, 101)
        ideal = next(iter(named.values()))
        axes.plot(
            v,
            ideal.ideal(v * ideal.cutoff),
            color=COLOURS["before"],
            linewidth=0.9,
            label="full circle without error",
        )
        axes.set(
            xlim=(0.0, 1.0),
            ylim=(0.0, 1.02),
            xlabel="frequency / cut-off frequency D / wavelength",
            ylabel="contrast",
        )
        axes.legend()
    return axes


# ---- A map over an aperture, on rings or on squares, in its own unit and on a scale about zero ----

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
    unit: str | None = None,
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
    unit : str, optional
        Unit of the values, such as "nm"; one in which they read well if omitted.

    Returns
    -------
    matplotlib Axes
        Equal scales along x and y.

    Raises
    ------
    DataError
        If the arrays are not maps of one shape, or nothing is known.
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
    size, symbol = readable_length(largest if limit is None else limit)
    if unit is not None:
        symbol, size = stated_unit(unit, "m")
    reach = float(max(np.ptp(place_x), np.ptp(place_y)) / 2.0)
    along, name = readable_length(reach)
    end = (largest if limit is None else limit) / size or 1.0
    with house_style():
        axes = axes_or_new(ax, size=(5.0, 4.2))
        mesh = _drawn(axes, place_x / along, place_y / along, z / size, end)
        axes.grid(visible=False)
        axes.set(aspect="equal", xlabel=f"x / {name}", ylabel=f"y / {name}")
        axes.set_title(f"{title}\nP-V {np.ptp(known) / size:.4g} {symbol}".strip(), fontsize=9.0)
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
