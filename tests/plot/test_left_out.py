"""The strips of the runs: each run minus what the others predict, its fault where it is."""

import json

import numpy as np
import pytest

from metrosep import Run, RunSet
from metrosep.core.errors import DataError
from metrosep.plot import left_out_plot
from metrosep.plot.left_out import lag_words, run_rows, short_names
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


# ---- the table of the runs ----------------------------------------------------------------------


def test_each_run_has_a_row_with_the_numbers_of_the_estimate(estimate):
    rows = run_rows(estimate)
    table = estimate.runs

    assert [r["run"] for r in rows] == [f"r{i}" for i in range(9)]
    for i, row in enumerate(rows):
        assert row["gain"] == table["predicted_gain"][i]
        assert row["u_shift_mm"] == table["u_predicted_shift_mm"][i]
        assert row["misfit"] == table["misfit"][i]
        assert row["predicted"]
        assert row["direction"] == "forward"
    assert [i for i, r in enumerate(rows) if r["finding"]] == [ODD]
    # the run shows the error of the place x - 0.5 mm: it is displaced by + 0.5 mm
    assert rows[ODD]["shift_mm"] > 0.3
    strip = np.array(rows[ODD]["strip_nm"], dtype=float)
    x = np.array(rows[ODD]["x_mm"])
    assert np.corrcoef(strip, error(x - MOVED_MM) - error(x))[0, 1] > 0.95


def test_the_rows_of_a_stored_result_are_the_same(estimate):
    stored = json.loads(json.dumps({"estimate": estimate.to_dict()}))
    assert run_rows(stored) == run_rows(estimate)
    assert lag_words(stored) == lag_words(estimate)


def two_ways(delay_s, **options):
    """Runs both ways at three feeds whose readings are late, by hand; reverse names repeat."""
    rng = np.random.default_rng(5)
    runs = []
    for way in (1, -1):
        for i, v in enumerate((40.0, 70.0, 110.0)):
            t = np.arange(int(50.0 / v * 1000.0)) / 1000.0
            x = v * t if way > 0 else 50.0 - v * t
            z = error(x - way * v * delay_s) + rng.normal(0.0, 10.0, x.size)
            runs.append(Run(x * 1e-3, z * 1e-9, t=t, run_id=f"r{i}"))
    return separate(RunSet(runs), start=1e-3, length=47e-3, **options)


def test_both_directions_have_rows_of_their_own_and_the_delay_its_sign():
    """2 ms late: what was at x - v d is read at x, both ways."""
    estimate = two_ways(2e-3)
    rows = run_rows(estimate)

    assert [r["direction"] for r in rows] == ["forward"] * 3 + ["reverse"] * 3
    assert all(len(r["strip_nm"]) == 60 for r in rows)
    assert rows[0]["strip_nm"] != rows[3]["strip_nm"]
    words = dict(lag_words(estimate))
    assert set(words) == {"forward", "reverse"}
    for phrase in words.values():
        shown = float(phrase.split("show ")[1].split(" ms")[0])
        assert shown == pytest.approx(2.0, abs=0.3)
        assert "corrected: " in phrase


def test_a_stated_delay_is_told_from_what_the_readings_show():
    ((_, phrase), *_) = lag_words(two_ways(2e-3, lag=0.0))

    assert "beside what was stated" in phrase
    assert "corrected: 0 ms" in phrase


def test_other_methods_have_rows_without_a_prediction_and_no_delay():
    runs = [
        Run(
            np.linspace(0, 0.05, 99),
            1e-7 * np.sin(np.linspace(0, 40, 99)),
            feed=0.1,
            run_id=f"{i}",
        )
        for i in range(3)
    ]
    noise = np.random.default_rng(1).normal(0, 1e-9, (3, 99))
    runs = [Run(r.x, r.z + n, feed=0.1, run_id=r.run_id) for r, n in zip(runs, noise, strict=True)]
    estimate = separate(RunSet(runs), method="mean")

    assert lag_words(estimate) == []
    for row in run_rows(estimate):
        assert row["misfit"] is None
        assert row["strip_nm"] is None
        assert not row["predicted"]
        assert row["gain"] == pytest.approx(1.0, abs=0.1)


LONG = "2026-11-23 spindle off, table at {} mm/s, pass {} of 3 (operator Müller-Lüdenscheidt)"


@pytest.mark.parametrize(
    "names",
    [[LONG.format(v, k) for v in (80, 120) for k in (1, 2, 3)],
     ["a" * 60 + "1", "a" * 60 + "2"],
     ["x" * 50 + f"{i}" + "y" * 50 for i in range(12)],
     ["short", "z" * 99],
     ["same " * 12, "same " * 12 + "but one"],
     ["", "w" * 40],
     ["one alone with a name that is far too long for a column"]],
)  # fmt: skip
def test_short_names_fit_and_differ_where_the_names_do(names):
    short = short_names(names)

    assert max(map(len, short)) <= 30
    assert len(set(short)) == len(set(names))
    assert short_names(["a", "b"]) == ["a", "b"]


def test_a_strip_of_a_long_name_and_a_long_finding_stays_in_its_figure(estimate):
    stored = json.loads(json.dumps({"estimate": estimate.to_dict()}))
    stored["estimate"]["runs"]["finding"][ODD] = "is displaced, and more that nobody can read " * 5
    names = [LONG.format(80, i) for i in range(9)]
    stored["estimate"]["runs"]["run"] = names
    stored["estimate"]["terms"]["leave_one_out"]["run"] = names
    figure = left_out_plot(stored)
    figure.canvas.draw()

    right = figure.bbox.x1
    for axes in figure.axes:
        box = axes._left_title.get_window_extent()
        assert box.x1 <= right
        assert len(axes.get_yticks()) == 3
