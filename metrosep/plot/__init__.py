"""Figures of a result: error over position, spectra, residual, table; as Axes, SVG or PNG."""

from __future__ import annotations

from metrosep.plot.error import before_after
from metrosep.plot.overview import drawable, overview
from metrosep.plot.spectra import residual_psd, spectrum
from metrosep.plot.style import figure_png, figure_svg
from metrosep.plot.table import table_plot

__all__ = [
    "before_after",
    "drawable",
    "figure_png",
    "figure_svg",
    "overview",
    "residual_psd",
    "spectrum",
    "table_plot",
]
