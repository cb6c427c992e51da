"""Axes that are placed by arithmetic: nothing is cut or covered, and light ticks look as the usual ones."""

import io

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imread

from metrosep.plot import figure_png, figure_svg
from metrosep.plot.charts import draw_chart
from metrosep.plot.maps import separation_maps
from metrosep.plot.placing import text_width, widest_number
from metrosep.plot.style import house_style, lighten

DPI = 100.0
PIXEL = 1.0 / DPI  # inch; matplotlib rounds boxes of text up to whole pixels
MISSED = 0.01  # of the ink of ticks, numbers and grid: rounding of what is half a pixel

Z = np.outer(np.linspace(-1.0, 3.0, 40), np.linspace(0.0, 1.0, 60)) * 1e-6
MAPS = {
    "one": {"": Z},
    "strip": {"a long strip": np.tile(Z[:12], (1, 5))},
    "tall": {"tall": np.tile(Z.T[:, :10], (5, 1))},
    "two": {"first": Z, "second": -3.0 * Z},
    "four": dict.fromkeys("ABCD", Z),
    "five": dict.fromkeys("ABCDE", Z),
}


def curves(n_panels, *, scale=1.0, unit="m"):
    x = np.linspace(-3e-3, 40e-3, 50)
    return {
        "kind": "curves",
        "title": "asymmetric",
        "x": {"name": "position", "unit": "m"},
        "panels": [
            {
                "title": f"panel {i}",
                "unit": unit,
                "curves": [{"label": "", "x": x.tolist(), "y": (scale * (x + i * x**2)).tolist()}],
            }
            for i in range(n_panels)
        ],
    }


def figures():
    for name, parts in MAPS.items():
        yield (
            name,
            lambda parts=parts: separation_maps(parts, dx=1e-4, dy=1e-4, origin=(-0.01, 2.0)),
        )
    for n in (1, 2, 3):
        yield f"curves {n}", lambda n=n: draw_chart(curves(n, scale=1e-5))
    yield "wide numbers", lambda: draw_chart(curves(2, scale=1e4))
    yield "nothing", lambda: draw_chart(curves(1, scale=0.0))


FIGURES = dict(figures())


def raster(figure, *, light):
    with house_style():
        if light:
            lighten(figure)
        stream = io.BytesIO()
        figure.savefig(stream, format="png", dpi=DPI)
    return imread(io.BytesIO(stream.getvalue()))[..., :3]


@pytest.mark.parametrize("name", FIGURES)
def test_nothing_is_cut_and_no_label_lies_on_the_numbers(name):
    figure = FIGURES[name]()
    with house_style():
        FigureCanvasAgg(figure).draw()
    for axes in (a for a in figure.axes if a.axison):
        box = axes.get_tightbbox()
        low, high = box.get_points()
        assert low.min() >= -1.0, f"{name}: cut at the left or below"
        assert (high <= figure.bbox.size + 1.0).all(), f"{name}: cut at the right or above"
        for axis in (axes.xaxis, axes.yaxis):
            if not axis.get_label_text():
                continue
            label = axis.label.get_window_extent()
            for number in axis.get_ticklabels():
                if number.get_text() and number.get_visible():
                    assert not label.shrunk(0.99, 0.99).overlaps(number.get_window_extent()), name


@pytest.mark.parametrize("name", FIGURES)
def test_axes_of_one_figure_do_not_cover_each_other(name):
    figure = FIGURES[name]()
    with house_style():
        FigureCanvasAgg(figure).draw()
    boxes = [a.get_tightbbox() for a in figure.axes if a.axison]
    for i, box in enumerate(boxes):
        assert not any(box.shrunk(0.99, 0.99).overlaps(other) for other in boxes[i + 1 :]), name


def without_ticks(figure):
    """Take what `lighten` replaces away; of panels with a common axis, of all."""
    for axes in figure.axes:
        axes.grid(visible=False)
        axes.tick_params(length=0.0, labelbottom=False, labelleft=False, labelright=False)
    return figure


@pytest.mark.parametrize("name", FIGURES)
def test_light_ticks_look_as_those_of_matplotlib(name):
    usual = raster(FIGURES[name](), light=False)
    light = raster(FIGURES[name](), light=True)
    bare = raster(without_ticks(FIGURES[name]()), light=False)
    missed = np.abs(usual - light).max(axis=2).sum()
    assert missed < MISSED * np.abs(usual - bare).max(axis=2).sum(), name


def test_the_width_of_numbers_is_that_of_matplotlib():
    with house_style():
        figure = Figure(figsize=(5.0, 3.0), dpi=DPI)
        FigureCanvasAgg(figure)
        axes = figure.add_axes((0.2, 0.2, 0.7, 0.7))
        axes.plot([0.0, 1.0], [-1234.5, 17.25])
        wide = widest_number(axes.yaxis)
        box = axes.yaxis.get_tightbbox()
        start = axes.get_window_extent().x0
    assert wide == pytest.approx((start - box.x0) / DPI, abs=1.5 * PIXEL)


def test_the_width_of_a_text_grows_with_its_letters():
    assert text_width("88", 9.0) == pytest.approx(2.0 * text_width("8", 9.0), abs=PIXEL)
    assert text_width("", 9.0) == 0.0


def test_panels_keep_the_numbers_of_their_common_axis():
    """Their ticks are one object: the first panel must not take the numbers of the last."""
    figure = FIGURES["curves 3"]()
    with house_style():
        lighten(figure)
        FigureCanvasAgg(figure).draw()
    numbers = [[t.get_text() for t in axes.texts] for axes in figure.axes]
    assert {"0", "10", "20", "30", "40"} <= set(numbers[-1])
    assert not {"10", "20", "30"} <= set(numbers[0])


def test_a_figure_that_was_not_placed_stays_as_it_is():
    figure = Figure()
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.plot([0.0, 1.0], [0.0, 2.0])
    before = list(axes.get_yticks())
    lighten(figure)
    assert list(axes.get_yticks()) == before
    assert not axes.texts


def test_an_offset_beside_the_numbers_is_not_lost():
    with house_style():
        figure = separation_maps({"far": Z}, dx=1e-4, dy=1e-4, origin=(0.0, 1e4))
        lighten(figure)
        FigureCanvasAgg(figure).draw()
    assert figure.axes[0].yaxis.get_offset_text().get_text() != ""
    assert len(figure.axes[0].get_yticks()) > 1


def test_logarithmic_axes_stay_as_they_are():
    chart = curves(1)
    chart["panels"][0]["curves"][0]["x"] = np.geomspace(1e-5, 1e-1, 50).tolist()
    chart["x"]["log"] = True
    with house_style():
        figure = draw_chart(chart)
        lighten(figure)
        FigureCanvasAgg(figure).draw()
    assert len(figure.axes[0].get_xticks()) > 3


def test_the_same_chart_gives_the_same_bytes():
    svg = [figure_svg(draw_chart, curves(2)) for _ in range(2)]
    png = [figure_png(draw_chart, curves(2)) for _ in range(2)]
    assert svg[0] == svg[1]
    assert png[0] == png[1]
