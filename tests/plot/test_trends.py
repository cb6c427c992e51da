"""The chart of individuals draws its values, its gaps and its limits."""

import numpy as np
import pytest

from metrosep.core.errors import DataError
from metrosep.plot.series_chart import trend_chart


@pytest.fixture
def figure():
    return trend_chart(
        [1.0, 2.0, None, 9.0],
        name="Sq",
        unit="nm",
        control=(3.0, 0.0, 6.0),
        ranges=(1.0, 3.267),
        limits=(None, 8.0),
    )


def test_values_and_ranges_are_drawn_with_their_gaps(figure):
    upper, lower = figure.axes

    assert np.array_equal(upper.lines[0].get_ydata(), [1.0, 2.0, np.nan, 9.0], equal_nan=True)
    steps = lower.lines[0].get_ydata()
    assert np.array_equal(steps, [np.nan, 1.0, np.nan, np.nan], equal_nan=True)
    assert upper.get_ylabel() == "Sq / nm"


def test_only_what_is_beyond_a_control_limit_is_marked(figure):
    marked = figure.axes[0].lines[1]

    assert list(marked.get_xdata()) == [4]
    assert list(marked.get_ydata()) == [9.0]


def test_lines_lie_at_mean_control_limits_and_limit(figure):
    levels = [line.get_ydata()[0] for line in figure.axes[0].lines[2:]]

    assert levels == [3.0, 0.0, 6.0, 8.0]
    texts = [t.get_text() for t in figure.axes[0].get_legend().get_texts()]
    assert texts == ["mean", "control limits", "limit of the check"]


@pytest.mark.parametrize("limits", [(1.0, None), (1.0, 2.0)])
def test_the_limit_of_the_check_is_named_once(limits):
    figure = trend_chart([1.0, 1.5], name="q", unit="", limits=limits)

    texts = [t.get_text() for t in figure.axes[0].get_legend().get_texts()]
    assert texts == ["limit of the check"]
    assert figure.axes[0].get_ylabel() == "q"


@pytest.mark.parametrize("values", [[], [None], [float("nan")]])
def test_without_a_value_there_is_nothing_to_draw(values):
    with pytest.raises(DataError, match="no value"):
        trend_chart(values, name="q", unit="m")
