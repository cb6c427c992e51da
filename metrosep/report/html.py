"""A result as one HTML file: no script, nothing fetched, printable; made from the document only.

Every number in it stands in the result document; this layer only formats. Same document, same
bytes.
"""

from __future__ import annotations

import base64
import os
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from metrosep.core.atomic import atomic_write
from metrosep.report.figures import figures_of, is_narrow
from metrosep.report.view import view

if TYPE_CHECKING:
    from jinja2 import Template

__all__ = ["render_html", "write_html"]


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
    page = _template().render(view(document), figures=_figures(document))
    return page if page.endswith("\n") else page + "\n"


@cache
def _template() -> Template:
    """Return the template, made once in each process."""
    from importlib.resources import files

    from jinja2 import Environment, StrictUndefined

    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    source = files("metrosep.report").joinpath("templates/result.html.j2").read_text("utf-8")
    return environment.from_string(source)


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


def _figures(document: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the figures as images in the page: each keeps its own ids, and has a caption.

    Narrow ones stand side by side, so that the letters of all are about equally large.
    """
    return [
        {
            "name": f.name,
            "title": f.title,
            "data": base64.b64encode(f.svg.encode("utf-8")).decode("ascii"),
            "caption": f.caption,
            "narrow": is_narrow(f.svg),
        }
        for f in figures_of(document)
    ]
