"""Which figures a result can show, and the two that say most in one picture."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

from metrosep.plot.charts import draw_chart
from metrosep.plot.error import before_after
from metrosep.plot.separation import separation_parts
from metrosep.plot.spectra import residual_psd, spectrum
from metrosep.plot.style import house_style
from metrosep.plot.table import table_plot

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["charts_of", "drawable", "overview"]


def drawable(document: Mapping[str, Any]) -> dict[str, Callable[..., Axes | Figure]]:
    """Return the drawing functions that have something to draw, by name.

    Parameters
    ----------
    document : mapping
        A result (schema ``metrosep.result/1``).

    Returns
    -------
    dict of str to callable
        Any of ``before_after``, ``spectrum``, ``residual_psd``, ``table_plot``,
        ``separation_parts``, ``chart_1``, ``chart_2`` ..., in this order.
    """
    estimate = document.get("estimate") or {}
    separation = document.get("separation") or {}
    has: dict[Callable[..., Axes | Figure], Any] = {
        before_after: (document.get("plots") or {}).get("x_mm"),
        spectrum: (estimate.get("feed_spectra") or {}).get("feed_mm_min")
        or (estimate.get("spectrum") or {}).get("wavelength_mm"),
        residual_psd: (estimate.get("residual_psd") or {}).get("frequency_hz"),
        table_plot: (document.get("table") or {}).get("positions_m"),
        separation_parts: separation.get("parts")
        and len(separation.get("coordinates") or ()) == 1,
    }
    found = {draw.__name__: draw for draw, present in has.items() if present}
    for i, _ in enumerate(charts_of(document)):
        found[f"chart_{i + 1}"] = partial(_chart, number=i)
    return found


def charts_of(document: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return the charts that a result describes, of its separation and of its plan.

    Parameters
    ----------
    document : mapping
        A result (schema ``metrosep.result/1``).

    Returns
    -------
    list of mapping
        In the order in which a report shows them.
    """
    return [
        chart
        for part in ("separation", "plan")
        for chart in (document.get(part) or {}).get("charts") or []
    ]


def _chart(document: Mapping[str, Any], *, number: int) -> Axes | Figure:
    return draw_chart(charts_of(document)[number])


def overview(document: Mapping[str, Any]) -> Figure:
    """Return one figure with the error before and after over the spectrum.

    Parameters
    ----------
    document : mapping
        A result (schema ``metrosep.result/1``).

    Returns
    -------
    matplotlib Figure
        Two panels, or one where the result holds no spectra.

    Raises
    ------
    DataError
        If the result holds no curves over position.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with house_style():
        two = "spectrum" in drawable(document)
        figure = Figure(figsize=(8.0, 7.2 if two else 4.2), layout="constrained")
        FigureCanvasAgg(figure)
        before_after(document, figure.add_subplot(2 if two else 1, 1, 1))
        if two:
            spectrum(document, figure.add_subplot(2, 1, 2))
    return figure
