"""What a chart of bars draws."""

from __future__ import annotations

import numpy as np
import pytest

from metrosep.plot.charts import draw_bars
from metrosep.recipe.describe.charts import bar_chart


def test_bars_beside_one_another_in_a_readable_unit():
    chart = bar_chart(
        "ranking",
        ["EXX", "B0Z"],
        {"raw": [82.7e-9, np.nan], "levelled": [33e-9, 82.3e-9]},
        unit="m",
        quantity="Sq",
    )
    axes = draw_bars(chart)
    raw, levelled = axes.containers
    assert raw[0].get_height() == pytest.approx(82.7, abs=1e-9)
    assert np.isnan(raw[1].get_height())
    assert levelled[1].get_height() == pytest.approx(82.3, abs=1e-9)
    assert raw[0].get_x() < levelled[0].get_x()
    assert axes.get_ylabel() == "Sq / nm"
    assert [t.get_text() for t in axes.get_xticklabels()] == ["EXX", "B0Z"]


def test_stacked_bars_stand_on_one_another():
    chart = bar_chart(
        "budget",
        ["case 1", "case 2"],
        {"tool": [22e-9, 1.6e-9], "follow-up": [13e-9, 5e-9]},
        unit="m",
        quantity="P-V",
        stacked=True,
    )
    tool, follow = draw_bars(chart).containers
    assert follow[0].get_y() == pytest.approx(22.0, abs=1e-9)
    assert follow[0].get_x() == tool[0].get_x()


def test_uncertainty_is_drawn_at_two_u():
    chart = bar_chart("b", ["a"], {"": [10e-9]}, unit="m", quantity="P-V", u={"": [1e-9]})
    axes = draw_bars(chart)
    (bars,) = (c for c in axes.containers if hasattr(c, "errorbar"))
    (line,) = bars.errorbar.lines[2]
    low, high = line.get_segments()[0][:, 1]
    assert (low, high) == pytest.approx((8.0, 12.0), abs=1e-9)


def test_unequal_lengths_are_refused():
    with pytest.raises(ValueError, match="one value for each"):
        bar_chart("b", ["a"], {"x": [1.0, 2.0]}, unit="m", quantity="q")
