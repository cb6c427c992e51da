"""Small maps stand side by side: the letters of all figures of a page are about equally large."""

import re

import numpy as np

import metrosep as ms
from metrosep.recipe import Recipe
from metrosep.report import render_html
from metrosep.report.html import figures_of, width_of

RECIPE = """metrosep = 1
[input]
files = ["*.sdf"]
[[step]]
op = "form"
form = "plane"
[[check]]
name = "flatness"
metric = "residual.pv"
upper = "10 um"
U = "10 nm"
"""


def page(tmp_path):
    y, x = np.mgrid[0:20, 0:30]
    ms.write(ms.Surface(1e-9 * (x**2 + 3 * y), 1e-3, 1e-3), tmp_path / "part.sdf")
    return Recipe.parse(RECIPE).run(tmp_path / "part.sdf").document


def test_maps_are_narrow_and_curves_are_not(tmp_path):
    document = page(tmp_path)
    text = render_html(document)
    classes = re.findall(r'<figure id="\w+"( class="narrow")?>', text)
    kinds = [chart["kind"] for chart in document["separation"]["charts"]]
    last = len(kinds) - 1 - kinds[::-1].index("maps")
    kinds.pop(last)  # the map that is left stands on the first page
    classes.pop(0)
    assert [bool(c) for c in classes] == [kind == "maps" for kind in kinds]
    assert set(kinds) == {"maps", "curves"}


def test_the_width_of_a_figure_is_that_of_its_drawing(tmp_path):
    widths = {round(width_of(f.svg) / 72.0, 6) for f in figures_of(page(tmp_path))}
    assert widths == {3.4, 7.2}  # inch: 2.5 for the map and 0.9 for its bar; a page
    assert width_of("<svg>") == float("inf")
