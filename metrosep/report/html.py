"""A result as one HTML file: no script, nothing fetched, printable; made from the document only.

Every number in it stands in the result document; this layer only formats. Same document, same
bytes.
"""

from __future__ import annotations

import base64
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from metrosep.core.atomic import atomic_write
from metrosep.report.text import span
from metrosep.report.view import view

__all__ = ["render_html", "write_html"]

_TITLES = {
    "before_after": "Error over position",
    "spectrum": "Amplitude over wavelength",
    "residual_psd": "What was separated, over frequency",
    "table_plot": "Compensation table",
    "separation_parts": "Parts of the readings",
}


def render_html(document: Mapping[str, Any]) -> str:
    """Return the report of a result.

    Parameters
    ----------
    document : mapping
        Content of a result.json; missing parts are None or absent.

    Returns
    -------
    str
        A whole HTML page.

    Raises
    ------
    DataError
        If a verdict in the document is unknown.
    """
    from importlib.resources import files

    from jinja2 import Environment, StrictUndefined

    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    source = files("metrosep.report").joinpath("templates/result.html.j2").read_text("utf-8")
    page = environment.from_string(source).render(view(document), figures=_figures(document))
    return page if page.endswith("\n") else page + "\n"


def write_html(document: Mapping[str, Any], path: str | os.PathLike[str]) -> Path:
    """Write the report of a result; the file appears whole or not at all.

    Parameters
    ----------
    document : mapping
        Content of a result.json.
    path : str or path
        File.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    WriteError
        If it cannot be written.
    DataError
        If a verdict in the document is unknown.
    """
    return atomic_write(path, render_html(document).encode("utf-8"))


def _figures(document: Mapping[str, Any]) -> list[dict[str, str]]:
    """Return the figures as images in the page: each keeps its own ids, and has a caption."""
    from metrosep.plot import drawable, figure_svg
    from metrosep.plot.summary import charts_of

    captions, titles = _captions(document), dict(_TITLES)
    for i, chart in enumerate(charts_of(document), start=1):
        titles[f"chart_{i}"] = str(chart.get("title") or "Chart")
        captions[f"chart_{i}"] = str(chart.get("caption") or "")
    return [
        {
            "name": name,
            "title": titles[name],
            "data": base64.b64encode(figure_svg(draw, document).encode("utf-8")).decode("ascii"),
            "caption": captions[name],
        }
        for name, draw in drawable(document).items()
    ]


def _captions(document: Mapping[str, Any]) -> dict[str, str]:
    """Return what each figure shows, what was removed from it, and how it was filtered."""
    estimate = document.get("estimate") or {}
    start, stop = estimate.get("start_m"), estimate.get("stop_m")
    over = "the evaluation range"
    if start is not None and stop is not None:
        over += f" {span(start, stop)}"
    return {
        "before_after": (
            "Thick: the separated error (actual − nominal) with ± 2 standard uncertainties. Thin: "
            "the mean of the runs at each feedrate, before, and after the separated error is "
            f"subtracted. Removed: the least-squares line over {over}, from every curve. Filter: "
            "none. Shaded: guard zones, which were modelled but are not evaluated."
        ),
        "spectrum": (
            "Lines: the mean run of each feedrate. What keeps its wavelength at every feedrate is "
            "geometry; what slides with the feedrate is vibration. Markers: wavelengths of the "
            "separated error, filled where they were selected. Removed: offset and line; the runs "
            "are tapered at their ends, so a line may read lower than its marker."
        ),
        "residual_psd": (
            "One-sided power spectral density in time of the readings minus the separated error, "
            "averaged over Hann segments without their mean; the line is the noise model where "
            "the method has one. Filter: none. No table removes this part."
        ),
        "table_plot": (
            "Correction c = −e that is added to the command, at its entries; joined as the "
            "controller joins them and constant outside. Filter: none."
        ),
        "separation_parts": (
            "Each part with ± 2 standard uncertainties. What the method cannot see is removed, and "
            "listed above as not seen. Gaps were not measured. Filter: none."
        ),
    }
