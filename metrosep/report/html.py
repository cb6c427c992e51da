"""A result as one HTML file: no script, nothing fetched, printable; made from the document only.

Every number in it stands in the result document; this module only formats. Same document, same
bytes.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from metrosep.core.atomic import atomic_write
from metrosep.core.units import format_engineering, format_length

__all__ = ["render_html", "write_html"]

_CAPTIONS = {
    "before_after": (
        "Error over position: mean run of each feedrate before the correction, the separated error "
        "with ±2 standard uncertainties, and what is left after subtracting it. Least-squares line "
        "over the evaluation range removed, no filter; shaded: guard zones outside that range."
    ),
    "spectrum": (
        "Amplitude against wavelength. Thin lines: mean run of each feedrate, weighted at its ends; "
        "geometry stays at its wavelength, vibration slides with the feedrate. Markers: the model; "
        "filled where the wavelength repeats beyond chance."
    ),
    "residual_psd": (
        "What is left, against frequency: measured spectral density of the residual and the noise "
        "model. No table removes this."
    ),
    "table_plot": "Entries of the compensation table: correction to add to the command.",
}


@dataclass(frozen=True, slots=True)
class _Stamp:
    word: str
    symbol: str
    style: str


_STAMPS = {
    "accept": _Stamp("accepted", "✓", "good"),
    "reject": _Stamp("rejected", "✗", "bad"),
    "inconclusive": _Stamp("inconclusive", "?", "open"),
}


def render_html(document: Mapping[str, Any]) -> str:
    """Return the report of a result.

    Parameters
    ----------
    document : mapping
        Content of a result.json.

    Returns
    -------
    str
        A whole HTML page.
    """
    from importlib.resources import files

    from jinja2 import Environment, StrictUndefined

    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    environment.filters["quantity"] = _quantity
    environment.filters["length"] = _length
    source = files("metrosep.report").joinpath("templates/result.html.j2").read_text("utf-8")
    table = document.get("table")
    verification = (table or {}).get("verification")
    return environment.from_string(source).render(
        doc=document,
        stamp=_STAMPS.get(document.get("verdict") or ""),
        stamps=_STAMPS,
        figures=_figures(document),
        table=table,
        dry_run=verification if isinstance(verification, Mapping) else None,
        estimate=document["estimate"],
        selected=_selected(document["estimate"]["spectrum"]),
        span_mm=[
            1e3 * v for v in (document["estimate"]["start_m"], document["estimate"]["stop_m"])
        ],
    )


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
    """
    return atomic_write(path, render_html(document).encode("utf-8"))


def _figures(document: Mapping[str, Any]) -> list[dict[str, str]]:
    from markupsafe import Markup

    from metrosep.plot import drawable, figure_svg

    figures = []
    for name, draw in drawable(document).items():
        svg = figure_svg(draw, document)
        body = svg[svg.index("<svg") :]
        figures.append(
            {"name": name, "svg": Markup(body), "caption": _CAPTIONS.get(name, "")}  # noqa: S704
        )
    return figures


def _quantity(entry: Mapping[str, Any], key: str = "value") -> str:
    """Return one number of a characteristic with its unit."""
    value = entry.get(key)
    if value is None:
        return "–"
    digits = 2 if key in ("u", "U") else 4
    if entry["unit"] == "rad":
        return f"{value * 1e6:.{digits}g} urad"
    return format_engineering(float(value), str(entry["unit"]), digits=digits)


def _length(value: float | None, digits: int = 4) -> str:
    return "–" if value is None else format_length(float(value), digits=digits)


def _selected(spectrum: Mapping[str, list[Any]]) -> list[dict[str, Any]]:
    """Return the strongest selected wavelengths, longest first."""
    keys = ("wavelength_mm", "amplitude_nm", "sd_nm", "phase_rad", "selected")
    columns = [spectrum.get(k, []) for k in keys]
    rows = [dict(zip(keys, row, strict=True)) for row in zip(*columns, strict=True)]
    chosen = [r for r in rows if r["selected"]]
    strongest = sorted(chosen, key=lambda r: -(r["amplitude_nm"] or 0.0))[:15]
    return sorted(strongest, key=lambda r: -r["wavelength_mm"])
