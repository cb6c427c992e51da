"""Figures of a feed plan: what is drawn is what the plan says."""

import numpy as np
import pytest

from metrosep.core.errors import DataError
from metrosep.plot.charts import plan_density, plan_sd
from metrosep.separation.runs.planner import plan_feedrates, predicted_sd


def isolator(f):
    return 1e-18 + 6e-15 / (1 + ((f - 12) / 0.25) ** 2)


@pytest.fixture(scope="module")
def plan():
    return plan_feedrates(isolator, [20e-3, 10e-3, 5e-3], 0.08, 0.16, 4, length=60e-3)


def line(axes, word):
    return next(c for c in axes.get_lines() if word in str(c.get_label()))


def test_sd_curves_are_those_of_the_table(plan):
    axes = plan_sd(plan)

    for word, column in (
        ("this plan", "sd_nm"),
        ("all at 7200", "sd_one_feed_nm"),
        ("geometric", "sd_geometric_feeds_nm"),
    ):
        drawn = line(axes, word)
        assert drawn.get_xdata().tolist() == [5.0, 10.0, 20.0]
        assert drawn.get_ydata().tolist() == plan.columns[column][::-1].tolist()
    assert axes.get_xlabel() == "wavelength / mm"
    assert axes.get_ylabel().endswith("/ nm")


def test_marks_sit_at_feed_over_wavelength(plan):
    axes = plan_density(plan, wavelengths=(10e-3,))

    marks = sorted(float(c.get_xdata()[0]) for c in axes.get_lines() if c.get_marker() == "v")
    assert marks == pytest.approx(np.unique(plan.feeds) / 10e-3, rel=1e-12, abs=0.0)
    s = line(axes, "disturbance")
    assert np.asarray(s.get_ydata()) == pytest.approx(
        isolator(np.asarray(s.get_xdata())) * 1e18, rel=1e-9, abs=0.0
    )
    assert axes.get_xlabel() == "frequency / Hz"
    assert "nm²/Hz" in axes.get_ylabel()


def test_given_axes_are_used(plan):
    axes = plan_sd(plan)

    assert plan_density(plan, axes) is axes


def test_too_many_wavelengths_are_refused(plan):
    with pytest.raises(DataError, match="up to 4"):
        plan_density(plan, wavelengths=(1e-3, 2e-3, 3e-3, 4e-3, 5e-3))


def test_unknown_sd_is_refused():
    blind = predicted_sd(([1.0, 5.0], [1e-18, 1e-18]), [0.1, 0.2], [1e-3, 2e-3, 3e-3], 10e-3)

    with pytest.raises(DataError, match="nothing to draw"):
        plan_sd(blind)
