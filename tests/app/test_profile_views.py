"""Profiles on the screen: every spike, every gap, any window, quickly."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from metrosep.app.view_tables import Extremes, profile_view, repeat_views
from metrosep.core.errors import DataError
from metrosep.core.profile import Profile
from metrosep.core.runset import Run, RunSet

MM, UM, NM = 1e-3, 1e-6, 1e-9


def brute_force(x, z, x0, x1, columns):
    """Extremes of each column by a loop over the columns."""
    edges = np.linspace(x0, x1, columns + 1)
    rows = []
    for k in range(columns):
        inside = (x >= edges[k]) & ((x < edges[k + 1]) if k < columns - 1 else (x <= x1))
        if not inside.any():
            continue
        part = z[inside]
        valid = part[~np.isnan(part)]
        rows.append(
            (
                (x[inside][0] + x[inside][-1]) / 2,
                valid.min() if valid.size else np.nan,
                valid.max() if valid.size else np.nan,
                valid.size / part.size,
            )
        )
    return np.array(rows).T


@settings(deadline=None, derandomize=True, max_examples=60)
@given(
    st.integers(300, 9000),
    st.integers(1, 250),
    st.floats(0, 0.5),
    st.booleans(),
    st.integers(0, 2**32 - 1),
)
def test_every_column_is_that_of_a_loop(n, columns, gaps, uneven, seed):
    rng = np.random.default_rng(seed)
    steps = rng.uniform(0.5, 1.5, n) if uneven else np.ones(n)
    x, z = np.cumsum(steps), rng.normal(size=n)
    z[rng.random(n) < gaps] = np.nan
    z[n // 3 : n // 2] = np.nan
    x0, x1 = np.sort(rng.uniform(x[0], x[-1], 2))
    if np.count_nonzero((x >= x0) & (x <= x1)) <= columns:
        x0, x1 = x[0], x[-1]
    view = profile_view(Profile(x, z), window=(x0, x1), columns=columns)
    expected = brute_force(x, z, x0, x1, columns)
    for mine, theirs in zip((view.x, view.low, view.high, view.coverage), expected, strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=0, atol=1e-9)


@settings(deadline=None, derandomize=True, max_examples=60)
@given(st.integers(1, 70_000), st.integers(0, 2**32 - 1))
def test_any_range_of_samples(n, seed):
    rng = np.random.default_rng(seed)
    z = rng.normal(size=n)
    z[rng.random(n) < 0.3] = np.nan
    extremes = Extremes(Profile(np.arange(float(n)), z))
    start = rng.integers(0, n, 20)
    stop = np.minimum(n, start + 1 + rng.integers(0, n, 20))
    low, high, count = extremes.of(start, stop)
    for k in range(20):
        part = z[start[k] : stop[k]]
        valid = part[~np.isnan(part)]
        assert count[k] == valid.size
        if valid.size:
            assert (low[k], high[k]) == (valid.min(), valid.max())
        else:
            assert np.isnan([low[k], high[k]]).all()


def test_a_spike_of_one_sample_in_a_million():
    z = np.zeros(10**6)
    z[777_777], z[123_456] = 5 * UM, -4 * UM
    x = np.arange(10**6) * 10 * NM
    view = profile_view(Profile(x, z), columns=800)
    assert view.high.max() == 5 * UM
    assert view.low.min() == -4 * UM
    column = view.x[1] - view.x[0]
    assert view.x[view.high.argmax()] == pytest.approx(x[777_777], abs=column)
    assert view.x[view.low.argmin()] == pytest.approx(x[123_456], abs=column)
    assert view.is_reduced


def test_gaps_stay_gaps_and_nothing_bridges_them():
    z = np.ones(100_000)
    z[30_000:31_000] = np.nan
    z[60_000] = np.nan
    x = np.arange(100_000) * UM
    view = profile_view(Profile(x, z), columns=1000)
    gap = np.isnan(view.low)
    assert (gap == np.isnan(view.high)).all()
    inside = (view.x > 30_000 * UM) & (view.x < 31_000 * UM)
    assert gap[inside].sum() >= 9
    assert not gap[~inside].any()
    one = np.abs(view.x - 60_000 * UM).argmin()
    assert view.coverage[one] == pytest.approx(0.99, abs=1e-9)  # one of a hundred
    zoomed = profile_view(Profile(x, z), window=(59_990 * UM, 60_010 * UM))
    assert np.isnan(zoomed.low).sum() == 1


def test_missing_samples_are_a_hole_and_slow_travel_is_not():
    x = np.concatenate([np.arange(0, 500), np.arange(700, 1000)]) * UM
    profile = Profile(x, np.ones(x.size))
    for columns in (2000, 100):
        view = profile_view(profile, columns=columns)
        hole = np.flatnonzero(np.isnan(view.low))
        assert view.x[hole] == pytest.approx([599.5 * UM], abs=1e-12)
        assert view.coverage[hole] == 0.0
    assert not np.isnan(profile_view(profile, columns=1).low).any()  # parts no columns
    dense_then_coarse = np.concatenate([np.arange(100), 110 + 20 * np.arange(50)]) * UM
    for x in (dense_then_coarse, -dense_then_coarse[::-1]):
        assert Extremes(Profile(x, np.ones(150))).holes.size == 0
    accelerating = np.cumsum(np.geomspace(1, 1000, 300)) * UM
    assert Extremes(Profile(accelerating, np.ones(300))).holes.size == 0


def test_few_samples_come_one_by_one_with_a_neighbour_on_each_side():
    x = np.arange(100) * UM
    view = profile_view(Profile(x, np.arange(100.0)), window=(10.5 * UM, 20.5 * UM))
    assert view.low.tolist() == list(range(10, 22))
    assert view.high.tolist() == view.low.tolist()
    assert (view.n_samples, view.is_reduced) == (10, False)
    all_of_it = profile_view(Profile(x, np.arange(100.0)))
    assert all_of_it.low.tolist() == list(range(100))
    single = profile_view(Profile([0.5], [2.0]))
    assert (single.x.tolist(), single.high.tolist()) == ([0.5], [2.0])


def test_repeats_show_a_vibration_that_slides_and_a_bump_that_stays():
    length, feeds, hertz = 50 * MM, (10 * MM, 12 * MM, 20 * MM), 5.0
    runs = []
    for k, feed in enumerate(feeds):
        x = np.linspace(0.0, length, 20_001)
        z = 1 * UM * np.exp(-(((x - 12 * MM) / (0.5 * MM)) ** 2))
        z = z + 0.2 * UM * np.sin(2 * np.pi * hertz * x / feed)
        turned = -1 if k == 1 else 1  # one run goes back
        runs.append(Run(x[::turned], z[::turned], feed=feed, run_id=f"run {k}"))
    views = repeat_views(RunSet(runs), columns=500)
    assert [v.name for v in views] == ["run 0", "run 1", "run 2"]
    assert [v.feed for v in views] == list(feeds)
    for view, feed in zip(views, feeds, strict=True):
        assert np.abs(view.x[view.high.argmax()] - 12 * MM) < 0.6 * MM
        tail = view.x > 20 * MM
        middle = (view.high + view.low)[tail] / 2
        crossings = np.count_nonzero(np.diff(np.sign(middle)))
        wavelength = 2 * 30 * MM / crossings
        assert wavelength == pytest.approx(feed / hertz, abs=0.1 * feed / hertz)
    cached = repeat_views([Extremes(r) for r in runs], columns=500)
    assert [v.name for v in cached] == [v.name for v in views]
    np.testing.assert_array_equal(cached[1].high, views[1].high)


def test_a_reverse_run_is_turned_round_and_nothing_is_changed():
    run = Run([3.0, 2.0, 1.0, 0.0], [30.0, 20.0, 10.0, 0.0])
    view = profile_view(run)
    assert view.x.tolist() == [0.0, 1.0, 2.0, 3.0]
    assert view.high.tolist() == [0.0, 10.0, 20.0, 30.0]
    assert run.x.tolist() == [3.0, 2.0, 1.0, 0.0]
    assert not view.high.flags.writeable


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"window": (1.0, 1.0)}, "x0 < x1"),
        ({"window": (2.0, 1.0)}, "x0 < x1"),
        ({"window": (np.nan, 1.0)}, "x0 < x1"),
        ({"window": (1.0,)}, "x0 < x1"),
        ({"window": 3}, "x0 < x1"),
        ({"columns": 0}, "from 1 to 100 000"),
        ({"columns": 10**7}, "from 1 to 100 000"),
        ({"columns": True}, "from 1 to 100 000"),
    ],
)
def test_bad_wishes(options, words):
    with pytest.raises(DataError, match=words):
        profile_view(Profile([0.0, 1.0], [0.0, 0.0]), **options)


def test_no_profile_and_no_run():
    with pytest.raises(DataError, match="made of a Profile, got list"):
        profile_view([1.0, 2.0])
    with pytest.raises(DataError, match="No run"):
        repeat_views([])


def test_a_window_beside_the_profile_shows_nothing_inside_it():
    view = profile_view(Profile([0.0, 1.0], [5.0, 6.0]), window=(7.0, 8.0))
    assert view.n_samples == 0
    assert (view.x < 7.0).all()


def test_nothing_measured():
    view = profile_view(Profile(np.arange(5000.0), np.full(5000, np.nan)), columns=50)
    assert np.isnan(view.low).all()
    assert not view.coverage.any()
