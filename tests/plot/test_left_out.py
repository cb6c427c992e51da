"""The strips of the runs: each run minus what the others predict, its fault where it is."""

import json

import numpy as np
import pytest

from metrosep import Run, RunSet
from metrosep.core.errors import DataError
from metrosep.plot import left_out_plot
from metrosep.separation import ErrorEstimate, separate

ODD, MOVED_MM = 4, 0.5


def error(x):
    return 300.0 * np.cos(2 * np.pi * x / 9.0) + 80.0 * np.sin(2 * np.pi * x / 31.0)


@pytest.fixture(scope="module")
def estimate():
    """Nine runs, mm and nm by hand; the fifth shows the error of the place x - 0.5 mm."""
    rng = np.random.default_rng(3)
    runs = []
    for i, v in enumerate((40.0, 40.0, 40.0, 70.0, 70.0, 70.0, 110.0, 110.0, 110.0)):
        t = np.arange(int(50.0 / v * 400.0)) / 400.0
        x = v * t
        z = error(x - (MOVED_MM if i == ODD else 0.0)) + rng.normal(0.0, 10.0, x.size)
        runs.append(Run(x * 1e-3, z * 1e-9, t=t, run_id=f"r{i}"))
    return separate(RunSet(runs), start=1e-3, length=47e-3)


def test_each_run_has_a_strip_and_the_displaced_one_says_so(estimate):
    figure = left_out_plot(estimate)
    titles = [axes.get_title(loc="left") for axes in figure.axes]

    assert [t.split(",")[0] for t in titles] == [f"run r{i}" for i in range(9)]
    assert [i for i, t in enumerate(titles) if "displaced" in t] == [ODD]
    sizes = [float(np.nanstd(axes.lines[1].get_ydata())) for axes in figure.axes]
    assert sizes[ODD] > 5.0 * max(s for i, s in enumerate(sizes) if i != ODD)
    assert "position / mm" in figure.axes[-1].get_xlabel()


def test_the_strip_of_a_displaced_run_has_the_sign_of_its_shift(estimate):
    """Readings of x - d minus the error are - d g'(x) for a small d."""
    strip = left_out_plot(estimate).axes[ODD].lines[1]
    x, rest = strip.get_xdata(), strip.get_ydata()
    expected = error(x - MOVED_MM) - error(x)
    assert np.corrcoef(rest, expected)[0, 1] > 0.95


def test_a_stored_result_draws_the_same(estimate):
    stored = json.loads(json.dumps({"estimate": estimate.to_dict()}))
    again = left_out_plot(stored), left_out_plot(ErrorEstimate.from_dict(stored["estimate"]))
    first = left_out_plot(estimate)
    for figure in again:
        for one, other in zip(first.axes, figure.axes, strict=True):
            assert one.get_title(loc="left") == other.get_title(loc="left")
            np.testing.assert_array_equal(one.lines[1].get_ydata(), other.lines[1].get_ydata())


def test_what_predicts_nothing_is_refused(estimate):
    mean = separate(
        RunSet(
            [
                Run(np.linspace(0, 0.05, 99), np.random.default_rng(i).normal(0, 1e-8, 99))
                for i in range(3)
            ]
        ),
        method="mean",
    )
    with pytest.raises(DataError, match="no run was predicted"):
        left_out_plot(mean)
    with pytest.raises(DataError, match="ErrorEstimate or a result"):
        left_out_plot(3.0)
