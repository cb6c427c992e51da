"""Plain pages of text and figures in one PDF, where no typesetter is installed."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, cast

from metrosep.plot.style import house_style
from metrosep.plot.summary import drawable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SIZE = (8.27, 11.69)
"""A4, in inches."""

_LEFT, _TOP, _BOTTOM = 0.09, 0.94, 0.08
_STEP = 0.0155
_LETTERS = 96
_STYLES: Mapping[str, Mapping[str, Any]] = {
    "title": {"fontsize": 14.0, "fontweight": "bold"},
    "head": {"fontsize": 10.0, "fontweight": "bold"},
    "text": {"fontsize": 8.0},
    "mono": {"fontsize": 7.5, "family": "DejaVu Sans Mono"},
}


def plain_pages(
    document: Mapping[str, Any],
    lines: Sequence[tuple[str, str]],
    captions: Mapping[str, str],
    footer: str,
) -> bytes:
    """Return a PDF: pages of text, then a page for each figure of a result."""
    from matplotlib.backends.backend_pdf import PdfPages
    from matplotlib.figure import Figure

    stream = io.BytesIO()
    undated = {"CreationDate": None, "Creator": "metrosep", "Producer": "matplotlib"}
    pages = list(_broken(lines))
    figures = list(drawable(document).items())
    total = len(pages) + len(figures)
    with house_style(), PdfPages(stream, metadata=undated) as book:
        for number, page in enumerate(pages, start=1):
            book.savefig(_text_page(page, f"{footer}, page {number} / {total}"))
        for number, (name, draw) in enumerate(figures, start=len(pages) + 1):
            drawn = draw(document)
            whole = drawn if isinstance(drawn, Figure) else drawn.get_figure(root=True)
            figure = cast("Figure", whole)
            foot = f"{footer}, page {number} / {total}"
            note = "\n".join(
                textwrap.wrap(f"Figure {number - len(pages)}. {captions.get(name, '')}", 100)
            )
            figure.text(0.02, -0.02, f"{_safe(note)}\n\n{_safe(foot)}", fontsize=7.0, va="top")
            book.savefig(figure, bbox_inches="tight", pad_inches=0.4)
    return stream.getvalue()


def _broken(lines: Sequence[tuple[str, str]]) -> Iterator[list[tuple[str, str]]]:
    """Give the lines of each page."""
    room = int((_TOP - _BOTTOM) / _STEP)
    page: list[tuple[str, str]] = []
    for style, text in lines:
        width = int(_LETTERS * 8.0 / float(_STYLES[style]["fontsize"]))
        pieces = textwrap.wrap(text, width, subsequent_indent="  ") or [""]
        for piece in pieces:
            page.append((style, piece))
            if len(page) == room:
                yield page
                page = []
    if page:
        yield page


def _text_page(lines: Sequence[tuple[str, str]], foot: str) -> Figure:
    from matplotlib.figure import Figure

    figure = Figure(figsize=_SIZE)
    for i, (style, text) in enumerate(lines):
        figure.text(_LEFT, _TOP - i * _STEP, _safe(text), va="top", **_STYLES[style])
    figure.text(_LEFT, 0.04, _safe(foot), fontsize=6.5, color="#57606b")
    return figure


def _safe(text: str) -> str:
    """Return a text that matplotlib does not take for a formula."""
    return text.replace("$", r"\$")
