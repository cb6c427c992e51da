"""Charts of a result document: what is drawn is what the chart says, from plain values alone."""

import itertools
import json
import math

import numpy as np
import pytest
from matplotlib.figure import Figure

from metrosep.core.errors import DataError
from metrosep.plot.charts import CHART_KINDS, draw_chart
from metrosep.plot.summary import charts_of, drawable
from metrosep.recipe.describe.charts import (
    curve,
    curve_chart,
    harmonic_chart,
    map_chart,
    panel,
    plain,
    thin,
)
from metrosep.recipe.describe.describe_tests import positions_of, spindle_of
from metrosep.separation import iso230_2, iso230_7


def stored(chart):
    """As the chart comes back from a file."""
    return json.loads(json.dumps(chart, allow_nan=False))


X = np.linspace(0.0, 0.2, 50)
Y = 3e-7 * np.sin(40 * X)


def test_curves_in_readable_units_with_band_and_gap():
    y = Y.copy()
    y[20] = np.nan
    chart = curve_chart(
        "t", ("position", "m"), [panel("first", "m", [curve("", X, y, u=np.full(50, 2e-9))])]
    )
    figure = draw_chart(stored(chart))
    assert isinstance(figure, Figure)
    axes = figure.axes[0]
    line = axes.lines[0]
    np.testing.assert_allclose(line.get_xdata(), X * 1e3, rtol=1e-6)
    np.testing.assert_allclose(line.get_ydata(), y * 1e9, rtol=1e-5)
    assert math.isnan(line.get_ydata()[20])
    assert axes.get_ylabel() == "nm"
    assert figure.axes[-1].get_xlabel() == "position / mm"
    assert len(axes.collections) == 1


def test_angles_are_drawn_in_degrees_and_times_in_minutes():
    for unit, x, label in (("rad", [0.0, np.pi], "a / °"), ("s", [0.0, 600.0], "a / min")):
        figure = draw_chart(
            curve_chart("t", ("a", unit), [panel("", "m", [curve("", x, [0, 1])])])
        )
        assert figure.axes[-1].get_xlabel() == label
    assert figure.axes[0].lines[0].get_xdata()[-1] == pytest.approx(10.0, abs=1e-12)


def test_thinning_hides_no_extreme():
    x = np.arange(100_000.0)
    y = np.sin(x / 50)
    y[77_777] = 40.0
    y[12_345] = -30.0
    y[50_001] = np.nan
    kept = thin(x, y[None])
    assert kept.size <= 2_200
    assert {77_777, 12_345, 50_001, 0, 99_999} <= set(kept.tolist())
    chart = curve_chart("t", ("x", "m"), [panel("", "m", [curve("", x, y)])])
    assert "Of 100000 samples" in chart["caption"]
    assert thin(x[:100], y[None, :100]).size == 100


def test_bars_and_the_hatched_ones():
    chart = harmonic_chart(
        "h", [1, 2, 3], [np.nan, 3e-9, 1e-9], u=[np.nan, 1e-10, 1e-10], suppressed=[1, 9], unit="m"
    )
    assert chart["suppressed"] == [1]
    axes = draw_chart(stored(chart))
    heights = [p.get_height() for p in axes.patches]
    assert pytest.approx(3.0, abs=1e-9) in heights
    assert any(p.get_hatch() for p in axes.patches)


def test_maps_are_decimated_and_say_so():
    z = np.arange(600.0 * 500.0).reshape(600, 500) * 1e-12
    z[:3] = np.nan
    chart = map_chart("m", {"part": z}, dx=1e-3, dy=1e-3, unit="m")
    shown = np.array(chart["parts"]["part"], dtype=float)
    assert max(shown.shape) <= 256
    assert chart["step"] == 3
    np.testing.assert_allclose(shown[5, 7], z[15:18, 21:24].mean(), rtol=1e-3)
    assert "Drawn at 1/3 of the resolution" in chart["caption"]
    figure = draw_chart(stored(chart))
    image = figure.axes[0].images[0]
    # the first block reaches from -0.5 to 2.5 pixels
    assert image.get_extent()[1] == pytest.approx(shown.shape[1] * 3.0 - 0.5, abs=1e-9)
    small = map_chart("m", {"part": z[:20, :20]}, dx=1e-3, dy=1e-3, unit="m")
    assert small["step"] == 1
    assert "Every" not in small["caption"]


def test_positions_as_the_standard_draws_them():
    rng = np.random.default_rng(1)
    targets = np.array([0.0, 0.11, 0.19, 0.31])
    up = targets[:, None] + 1e-6 * rng.standard_normal((4, 5))
    test = iso230_2(targets, up, up - 4e-6)
    axes = draw_chart(stored(positions_of(test).charts[0]))
    lines = {tuple(np.round(line.get_ydata(), 4)) for line in axes.lines}
    assert tuple(np.round(test.mean_forward * 1e6, 4)) in lines
    assert tuple(np.round(test.mean_backward * 1e6, 4)) in lines
    text = axes.texts[0].get_text()
    assert f"{test['B'].value * 1e6:.2f}" in text


def test_polar_chart_keeps_the_extremes_of_all_revolutions():
    rng = np.random.default_rng(2)
    t = 2 * np.pi * np.arange(1500) / 1500
    m = 20e-9 * np.cos(2 * t) + 1e-9 * rng.standard_normal((150, 1500))
    m[101, 777] += 30e-9
    result = iso230_7(m)
    chart = stored(spindle_of(result).charts[0])
    assert chart["n_revolutions"] == 150
    rows = np.array(chart["motion"])
    assert rows.shape[0] < 80
    assert rows.shape[1] < 1200
    assert rows.max() == pytest.approx(result.motion.max(), rel=1e-3, abs=0.0)
    assert "Every revolution in 3" in chart["caption"]
    axes = draw_chart(chart)
    labels = [t.get_text() for t in axes.get_legend().get_texts()]
    assert any("asynchronous" in text for text in labels)


def test_unknown_and_damaged_charts_are_refused():
    with pytest.raises(DataError, match="kind 'pie'"):
        draw_chart({"kind": "pie"})
    for kind in CHART_KINDS:
        with pytest.raises(DataError, match="damaged"):
            draw_chart({"kind": kind, "title": "t"})


def test_charts_of_separation_and_plan_are_drawable():
    chart = curve_chart("t", ("position", "m"), [panel("", "m", [curve("", X, Y)])])
    document = {"separation": {"charts": [chart]}, "plan": {"charts": [chart]}}
    assert len(charts_of(document)) == 2
    drawn = drawable(document)
    assert list(drawn) == ["chart_1", "chart_2"]
    assert isinstance(drawn["chart_2"](document), Figure)


def test_plain_values_hold_no_nan():
    assert plain([[1.23456789e-9, np.nan], [np.inf, 0.0]]) == [[1.23457e-9, None], [None, 0.0]]


def test_a_run_keeps_its_colour_in_every_panel_and_no_two_share_one():
    from metrosep.recipe.describe.charts import curve, curve_chart, panel

    x, y = [0.0, 1.0], [0.0, 1e-6]
    runs = [curve(f"run {k}", x, y) for k in range(5)]
    upper = panel("runs", "m", [*runs, curve("polynomial", x, y)])
    figure = draw_chart(curve_chart("t", ("position", "m"), [upper, panel("rest", "m", runs)]))

    first, second = (
        {line.get_label(): line.get_color() for line in axes.get_lines() if len(line.get_xdata())}
        for axes in figure.axes
    )
    named = [f"run {k}" for k in range(5)]
    assert [first[n] for n in named] == [second[n] for n in named]
    assert len({first[n] for n in [*named, "polynomial"]}) == 6


def test_legend_stands_beside_the_curves():
    from metrosep.recipe.describe.charts import curve, curve_chart, panel

    x, y = [0.0, 1.0], [0.0, 1e-6]
    for count in (2, 6):
        lines = [curve(f"measured run {k}", x, y) for k in range(count)]
        figure = draw_chart(curve_chart("t", ("position", "m"), [panel("all of it", "m", lines)]))
        figure.canvas.draw()
        (axes,) = figure.axes
        legend = axes.get_legend().get_window_extent()
        assert not axes.get_window_extent().shrunk(0.99, 0.99).overlaps(legend)


def test_limits_of_a_drive_are_dashed():
    from metrosep.recipe.describe.charts import curve, curve_chart, panel

    x = [0.0, 1.0]
    lines = [curve("voltage", x, [1.0, 2.0]), curve("limit, upper: 10 V", x, [10.0, 10.0])]
    figure = draw_chart(curve_chart("t", ("position", "m"), [panel("v", "V", lines)]))
    drawn = {line.get_label(): line for line in figure.axes[0].get_lines()}
    assert drawn["limit, upper: 10 V"].is_dashed()
    assert not drawn["voltage"].is_dashed()


def test_title_of_a_map_has_the_pv_of_all_its_pixels():
    """One high pixel that is not among those drawn must show in the P-V."""
    from metrosep.recipe.describe.charts import map_chart

    z = np.zeros((600, 600))
    z[1, 1] = 7e-9
    chart = map_chart("t", {"a": z}, dx=1e-3, dy=1e-3, unit="m")
    stated = map_chart("t", {"a": z[::5, ::5]}, dx=1e-3, dy=1e-3, unit="m", pv={"a": 7e-9})

    assert chart["step"] == 3
    for each in (chart, stated):
        assert draw_chart(each).axes[0].get_title().startswith("a\nP-V 7 nm")


@pytest.mark.parametrize("n", [1, 2, 4])
@pytest.mark.parametrize("scale", [1.0, 3e-9, 7e5])
@pytest.mark.parametrize("far", [0.2, 9.87654])
def test_nothing_of_a_panel_leaves_the_figure_or_meets_its_neighbour(n, scale, far):
    x = np.linspace(0.0, far, 60)
    labels = ("share of heights", "normal distribution of the same spread")
    panels = [
        panel(f"along x, section {i}", "V" if scale > 1 else "m", [
            curve(name, x, scale * np.sin(4 * x + i)) for name in labels[: 1 + i % 2]
        ])
        for i in range(n)
    ]  # fmt: skip
    figure = draw_chart(stored(curve_chart("t", ("position", "m"), panels)))
    figure.canvas.draw()
    boxes = [axes.get_tightbbox() for axes in figure.axes]
    page, slack = (
        figure.bbox,
        2.0,
    )  # pixels of 1/100 inch: an outline is wider than its letters say
    for box in boxes:
        assert box.x0 >= page.x0 - slack
        assert box.y0 >= page.y0 - slack
        assert box.x1 <= page.x1 + slack
        assert box.y1 <= page.y1 + slack
    for above, below in itertools.pairwise(boxes):
        assert above.y0 >= below.y1 - slack
    assert boxes[0].x0 < 0.3 * figure.dpi  # no room is wasted at the left
