"""A result as one HTML file: no script, nothing fetched, printable; made from the document only.

Every number in it stands in the result document; this layer only formats. Same document, same
bytes.
"""

from __future__ import annotations

import base64
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from functools import cache, partial
from typing import TYPE_CHECKING, Any, NamedTuple

from markupsafe import Markup

from metrosep.core.readable import typeset
from metrosep.report.certificate import (
    languages_of,
    picture_words,
    printed,
    said,
    texts_of,
)
from metrosep.report.text import document_writer, one_line, span
from metrosep.report.view import view

if TYPE_CHECKING:
    from jinja2 import Template


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
    texts = view(document)
    shown = texts["c"]
    first, figures = split_main(_figures(document), document)
    name = f"{shown['kind']} {shown['number']}".strip() if shown["number"] else shown["kind"]
    foot = " · ".join(t for t in (name, shown["t"]["draft"] if shown["draft"] else "",
                                  shown["look"].get("footer", "")) if t)  # fmt: skip
    page = page_template("result").render(
        texts,
        figures=figures,
        main=first[0] if first else None,
        page_text=Markup(_css_text(foot)),  # noqa: S704  (escaped for CSS)
        page_word=Markup(_css_text(shown["t"]["page"])),  # noqa: S704
    )
    return page if page.endswith("\n") else page + "\n"


def _css_text(text: str) -> str:
    r"""Return a text as a string of CSS that cannot end before its end.

    Examples
    --------
    >>> _css_text('a"</style>')
    '"a\\22 \\3c \\2f style\\3e "'
    """
    safe = (c if c.isalnum() or c in " .,-·" else f"\\{ord(c):x} " for c in one_line(text))
    return f'"{"".join(safe)}"'


def main_figure(names: Mapping[str, str]) -> str | None:
    """Return which figure stands on the first page, of names with the kind of each: what was judged."""
    for wanted in ("before_after", "separation_parts"):
        if wanted in names:
            return wanted
    maps = [name for name, kind in names.items() if kind == "maps"]
    others = [name for name, kind in names.items() if kind != "bars"]
    return next(iter(maps[-1:] or others[:1] or [*names]), None)


def kinds_of(document: Mapping[str, Any], names: Iterable[str]) -> dict[str, str]:
    """Return the kind of each figure of a report: of a chart its own, else its name."""
    from metrosep.plot.summary import charts_of

    kinds = {f"chart_{i}": str(c.get("kind")) for i, c in enumerate(charts_of(document), 1)}
    return {name: kinds.get(name, name) for name in names}


def split_main(figures: Sequence[Any], document: Mapping[str, Any]) -> list[list[Any]]:
    """Return the figure of the first page, if there is one, and the others in their order."""
    names = [f.name if isinstance(f, Drawing) else f["name"] for f in figures]
    chosen = main_figure(kinds_of(document, names))
    at = names.index(chosen) if chosen in names else len(names)
    return [[*figures[at : at + 1]], [*figures[:at], *figures[at + 1 :]]]


@cache
def page_template(name: str) -> Template:
    """Return the template of a page, made once in each process: that takes longer than a small page."""
    from importlib.resources import files

    from jinja2 import Environment, StrictUndefined

    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    source = files("metrosep.report").joinpath(f"templates/{name}.html.j2").read_text("utf-8")
    return environment.from_string(source)


write_html = document_writer(
    "write_html", render_html, "the report of a result",
    DataError="If a verdict in the document is unknown.",
)  # fmt: skip


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


# ---- the figures of a result with titles and captions, as every report shows them --------------


class Drawing(NamedTuple):
    """One figure of a report."""

    # its short name, its title, and what it shows, what was removed and how it was filtered
    name: str
    title: str
    caption: str
    svg: str  # the picture


def figures_of(document: Mapping[str, Any]) -> list[Drawing]:
    """Return the figures of a result."""
    from metrosep.plot import drawable, figure_svg
    from metrosep.plot.style import localise

    words = captions_of(document)
    language = languages_of(document)[0]
    words_of, font = picture_words(language)
    decimal = printed("0.0", language)[1:-1]
    finish = partial(localise, words=words_of, decimal=decimal, font=font)
    return [
        Drawing(
            name,
            *words[name],
            figure_svg(draw, document, finish=finish if language != "en" else None),
        )
        for name, draw in drawable(document).items()
    ]


def width_of(svg: str) -> float:
    """Return the width of a figure."""
    found = re.search(r'viewBox="0 0 ([\d.]+) [\d.]+"', svg[:4096])
    return float(found.group(1)) if found else math.inf


_NARROW = 300.0
"""Points: a figure of less is not as wide as a page, but half of it."""


def is_narrow(svg: str) -> bool:
    """Return whether two such figures stand side by side, so that the letters of all are of one size."""
    return width_of(svg) < _NARROW


def captions_of(document: Mapping[str, Any]) -> dict[str, tuple[str, str]]:
    """Return titles and captions of the figures that a result may have."""
    from metrosep.plot.summary import charts_of

    t, spoken = texts_of(languages_of(document)), partial(said, language=languages_of(document)[0])
    found = {name: (t[f"fig_{name}"], spoken(text)) for name, text in _captions(document).items()}
    for i, chart in enumerate(charts_of(document), start=1):
        title = str(chart.get("title") or "Chart")
        caption = spoken(typeset(str(chart.get("caption") or "")))
        found[f"chart_{i}"] = (spoken(title), caption)
    return found


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
        "left_out_plot": (
            "Readings of each run minus what the other runs predict of them, averaged over 1/60 of the "
            "travel, offset removed; all on one scale. Misfit: chi-square per degree of freedom, 1 where "
            "the noise explains the strip. Marked: what was found. Filter: none."
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
