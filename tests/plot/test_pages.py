"""Plain pages: as many as the lines need, long lines broken, formulas not taken for such."""

import re

import pytest

from metrosep.plot.pages import plain_pages


def _n_pages(data):
    return len(re.findall(rb"/Type /Page\b(?!s)", data))


@pytest.mark.parametrize(("n", "pages"), [(1, 1), (55, 1), (56, 2), (400, 8)])
def test_as_many_pages_as_the_lines_need(n, pages):
    """55 lines of 0.0155 fill the page from 0.94 down to 0.08."""
    assert _n_pages(plain_pages({}, [("text", "a line")] * n, {}, "foot")) == pages


def test_a_long_line_is_broken():
    assert _n_pages(plain_pages({}, [("text", "word " * 96 * 30)], {}, "foot")) > 2


@pytest.mark.parametrize("text", ["$x$", "$", "\\frac", "{", "%s", "Ω ü"])
def test_a_text_is_no_formula(text):
    styles = ("title", "head", "text", "mono")

    made = plain_pages({}, [(style, text) for style in styles], {}, text)

    assert made == plain_pages({}, [(style, text) for style in styles], {}, text)
