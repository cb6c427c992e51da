"""Runs over one another, the separated error, what is left: planted errors, gaps, both directions."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from metrosep.app.run_answers import (
    feed_words,
    level_runs,
    separated_view,
    shown_range,
)
from metrosep.core.errors import DataError
from metrosep.core.runset import Run, RunSet
from metrosep.recipe.result import plot_data
from metrosep.separation import separate
from metrosep.separation.runs.design import mean_runs

MM, NM, PM = 1e-3, 1e-9, 1e-12

ROUNDING = 1e-3 * PM
"""Lines of some um over some hundred samples round by some 1e-16 of them."""

LAST_DIGIT = 1e-5 * PM

MODEL = 5 * NM
"""Kono's window and the mean of few runs leave some nm of 300 nm planted without noise."""

START, LENGTH = 5 * MM, 40 * MM


def bump(x: np.ndarray) -> np.ndarray:
    """One-sided: +300 nm at 12 mm. A mirrored or flipped picture shows it elsewhere."""
    return np.asarray(300 * NM * np.exp(-(((x - 12 * MM) / (4 * MM)) ** 2)))


def run(feed: float, *, way: int = 1, slope: float = 0.0, level: float = 0.0, name: str = "r"):
    x = np.linspace(0.0, 50 * MM, 501)[::way]
    return Run(x, bump(x) + slope * x + level, feed=feed, run_id=name)


def both_ways() -> RunSet:
    """Reverse runs carry twice the bump and lie 200 nm higher."""
    rng = np.random.default_rng(4)  # far from the bump no reading equals another to the last digit
    forward = [run(f, name=f"f{i}") for i, f in enumerate((0.08, 0.08, 0.12))]
    reverse = [run(f, way=-1, name=f"b{i}") for i, f in enumerate((0.08, 0.12))]
    reverse = [
        Run(
            r.x,
            2 * bump(r.x) + 200 * NM + LAST_DIGIT * rng.standard_normal(len(r)),
            feed=r.feed,
            run_id=r.run_id,
        )
        for r in reverse
    ]
    return RunSet([*forward, *reverse])


FLAT_ENDS = ("b0", "b1")
"""Behind the bump these runs without noise read 200 nm exactly, as at the limit of a sensor."""


def fitted_line(x: np.ndarray, z: np.ndarray, low: float, high: float) -> np.ndarray:
    inner = (x >= low) & (x <= high)
    design = np.stack([np.ones(inner.sum()), x[inner]], axis=1)
    level, slope = np.linalg.lstsq(design, z[inner], rcond=None)[0]
    return np.asarray(level + slope * x)


# ---- runs over one another -------------------------------------------------------------------


def test_each_run_loses_the_line_over_the_range_and_nothing_else():
    tilted = run(0.08, slope=1e-4, level=7e-6)

    found = level_runs(RunSet([tilted]), (START, START + LENGTH))

    want = tilted.z - fitted_line(tilted.x, tilted.z, START, START + LENGTH)
    assert np.abs(found.runs[0].z - want).max() < ROUNDING
    line = fitted_line(tilted.x, tilted.z, START, START + LENGTH)
    slope = (line[-1] - line[0]) / (tilted.x[-1] - tilted.x[0])
    assert abs(found.slopes[0] - slope) < 1e-6 * 1e-4
    assert "5 ... 45 mm" in found.message
    assert np.abs(tilted.z - (bump(tilted.x) + 1e-4 * tilted.x + 7e-6)).max() < ROUNDING


def test_a_reverse_run_stands_where_it_was_measured():
    views = level_runs(RunSet([run(0.08, way=-1)]), (START, START + LENGTH)).views(columns=100)

    assert abs(views[0].x[np.nanargmax(views[0].high)] - 12 * MM) < 0.6 * MM


def test_a_gap_stays_a_gap_and_does_not_move_the_line():
    whole = run(0.08, slope=1e-4)
    z = whole.z.copy()
    lost = (whole.x > 20 * MM) & (whole.x < 25 * MM)
    z[lost] = np.nan

    found = level_runs(RunSet([Run(whole.x, z, feed=0.08, run_id="gap")]), (0.0, 50 * MM))
    view = found.views(columns=50)[0]

    inside = (view.x > 20.6 * MM) & (view.x < 24.4 * MM)
    assert inside.sum() >= 3
    assert np.isnan(view.low[inside]).all()
    assert np.isnan(view.high[inside]).all()
    assert not np.isnan(view.low[~((view.x > 19 * MM) & (view.x < 26 * MM))]).any()


def test_samples_that_are_not_there_are_a_gap_too():
    whole = run(0.08)
    keep = (whole.x < 20 * MM) | (whole.x > 25 * MM)
    short = Run(whole.x[keep], whole.z[keep], run_id="hole")

    view = level_runs(RunSet([short]), (0.0, 50 * MM)).views(columns=50)[0]

    assert np.isnan(view.low[(view.x > 20 * MM) & (view.x < 25 * MM)]).all()


def test_a_run_without_readings_in_the_range_says_so():
    x = np.linspace(0.0, 50 * MM, 501)
    z = np.where(x < 10 * MM, 1e-4 * x, np.nan)

    found = level_runs(RunSet([Run(x, z, run_id="short")]), (20 * MM, 40 * MM))

    assert "short" in found.message
    assert np.nanmax(np.abs(found.runs[0].z)) < ROUNDING


def test_one_spike_shows_at_any_width():
    spiked = run(0.08)
    z = spiked.z.copy()
    z[333] += 5e-6

    view = level_runs(RunSet([Run(spiked.x, z, run_id="s")]), (0.0, 50 * MM)).views(columns=20)[0]

    assert view.high.max() > 4.5e-6


def test_the_range_is_that_of_the_separation_or_says_why_not():
    runs = RunSet([run(0.08)])
    assert shown_range(runs, START, LENGTH) == ((START, START + LENGTH), "")
    assert shown_range(runs, None, None)[0] == (0.0, 50 * MM)
    over, why = shown_range(runs, 0.0, 80 * MM)
    assert over == (0.0, 50 * MM)
    assert "not covered" in why


def test_the_range_is_that_of_its_method_where_not_all_runs_reach():
    long, short = run(0.08), run(0.12)
    short = Run(short.x[short.x < 30 * MM], short.z[short.x < 30 * MM], feed=0.12)
    runs = RunSet([long, short])

    assert shown_range(runs, START, 40 * MM, method="joint")[1] == ""
    assert "not covered by every run" in shown_range(runs, START, 40 * MM, method="kono")[1]


# ---- the separated error ---------------------------------------------------------------------


def test_the_separated_error_has_its_sign_and_place():
    estimate = separate(RunSet([run(0.08), run(0.12)]), method="mean", start=START, length=LENGTH)

    view = separated_view(estimate, direction=1, columns=200)

    top = np.nanargmax(view.high)
    want = bump(view.x) - fitted_line(view.x, bump(view.x), START, START + LENGTH)
    assert abs(view.x[top] - 12 * MM) < 0.3 * MM
    assert np.nanmax(np.abs((view.low + view.high) / 2 - want)) < MODEL
    flipped = np.nanmax(np.abs(-(view.low + view.high) / 2 - want))
    assert flipped > 100 * NM


def test_the_band_is_two_standard_uncertainties():
    estimate = separate(
        RunSet([run(0.08, name="a"), run(0.08, name="b")]),
        method="mean", start=START, length=LENGTH,
    )  # fmt: skip
    part = estimate.directions_data[1]
    constant = replace(part.uncertainty, z=np.full(part.uncertainty.x.size, 11 * NM))
    estimate = replace(estimate, directions_data={1: replace(part, uncertainty=constant)})

    view = separated_view(estimate, direction=1, window=(6 * MM, 40 * MM), columns=100)

    assert np.abs(view.band_high - view.high - 22 * NM).max() < ROUNDING
    assert np.abs(view.low - view.band_low - 22 * NM).max() < ROUNDING


def test_a_spike_of_a_sampled_error_shows_at_any_width():
    spiked = run(0.08)
    z = spiked.z.copy()
    z[333] += 5e-6
    runs = RunSet([Run(spiked.x, z, feed=0.08, run_id=n) for n in "ab"])

    estimate = separate(runs, method="mean", start=0.0, length=50 * MM)
    view = separated_view(estimate, direction=1, columns=3)

    assert np.nanmax(view.high) > 4.5e-6


def test_each_direction_has_its_own_error():
    estimate = separate(both_ways(), accept=FLAT_ENDS, method="mean", start=START, length=LENGTH)

    heights = {
        d: np.nanmax(separated_view(estimate, direction=d, columns=200).high) for d in (1, -1)
    }

    assert abs(heights[-1] - 2 * heights[1]) < MODEL
    with pytest.raises(DataError, match="no direction 0"):
        separated_view(estimate, direction=0)


def test_wrong_windows_and_columns_are_refused():
    estimate = separate(RunSet([run(0.08)]), method="mean")
    for window in ((1.0, 1.0), (2.0, 1.0), (0.0, math.nan), "ab", (1, 2, 3)):
        with pytest.raises(DataError, match="window"):
            separated_view(estimate, direction=1, window=window)
    for columns in (0, -1, 2.5, True, 10**6):
        with pytest.raises(DataError, match="columns"):
            separated_view(estimate, direction=1, columns=columns)


# ---- before and after ------------------------------------------------------------------------


def test_after_is_before_less_the_error_of_the_direction():
    runs = both_ways()
    estimate = separate(runs, accept=FLAT_ENDS, method="mean", start=START, length=LENGTH)

    found = mean_runs(runs, estimate)

    assert [(m.direction, round(m.feed * 6e4), m.n_runs) for m in found] == [
        (1, 4800, 2), (1, 7200, 1), (-1, 4800, 1), (-1, 7200, 1),
    ]  # fmt: skip
    for one in found:
        inner = (one.x >= START) & (one.x <= START + LENGTH)
        assert np.abs(one.after[inner]).max() < MODEL
        assert np.abs(one.before[inner]).max() > 150 * NM
        assert np.abs(one.before + estimate.evaluate(one.x, direction=one.direction)).max() > 1e-7


def test_before_and_after_are_the_curves_of_the_report():
    runs = both_ways()
    estimate = separate(runs, accept=FLAT_ENDS, method="mean", start=START, length=LENGTH)

    found = {(m.direction, round(m.feed * 6e4)): m for m in mean_runs(runs, estimate)}

    for entry in plot_data(runs, estimate)["feeds"]:
        way = 1 if entry["direction"] == "forward" else -1
        mine = found[way, round(entry["feed_mm_min"])]
        for name in ("before", "after"):
            theirs = np.array(entry[f"{name}_nm"], dtype=float) * NM
            ours = getattr(mine, name)
            assert abs(np.nanmax(theirs) - np.nanmax(ours)) < ROUNDING
            assert abs(np.nanmin(theirs) - np.nanmin(ours)) < ROUNDING


def test_where_one_run_has_a_gap_the_mean_is_that_of_the_others():
    whole = run(0.08)
    z = whole.z.copy()
    z[200:250] = np.nan
    runs = RunSet([whole, Run(whole.x, z, feed=0.08, run_id="gap")])
    estimate = separate(runs, method="mean", start=START, length=LENGTH)

    one = mean_runs(runs, estimate)[0]

    lost = (one.x >= whole.x[200]) & (one.x <= whole.x[249])
    assert lost.any()
    assert not np.isnan(one.before).any()
    assert np.abs(one.before - one.after - estimate.evaluate(one.x)).max() < ROUNDING

    both = RunSet([Run(whole.x, z, feed=0.08, run_id=n) for n in "ab"])
    one = mean_runs(both, estimate)[0]
    assert np.isnan(one.before[lost]).all()
    assert not np.isnan(one.before[~lost]).any()


def test_runs_without_a_feedrate_are_one_mean():
    x = np.linspace(0.0, 50 * MM, 501)
    runs = RunSet([Run(x, bump(x), run_id=n) for n in "ab"])
    estimate = separate(runs, method="mean", start=START, length=LENGTH)

    (one,) = mean_runs(runs, estimate)

    assert one.feed is None
    assert one.n_runs == 2
    assert feed_words(one.feed) == "feed not known"
