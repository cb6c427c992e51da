"""Runs: order in time, feeds, directions, contradictions."""

import numpy as np
import pytest

from metrosep import Profile, Run, RunSet
from metrosep.errors import DataError, InvalidSamplesError, TooFewSamplesError

ROUNDING = 1e-12
X = np.linspace(0, 10e-3, 101)


def test_time_follows_from_feed_and_step():
    run = Run(X, np.zeros(101), feed=0.05)

    assert run.t[-1] == pytest.approx(10e-3 / 0.05, rel=ROUNDING, abs=0.0)
    assert run.sampling_rate == pytest.approx(500.0, rel=ROUNDING, abs=0.0)


def test_feed_follows_from_time():
    assert Run(X, np.zeros(101), t=np.arange(101) * 1e-3).feed == pytest.approx(
        0.1, rel=ROUNDING, abs=0.0
    )


def test_neither_gives_neither():
    run = Run(X, np.zeros(101))

    assert run.t is None
    assert run.feed is None
    assert run.sampling_rate is None


def test_feed_in_the_wrong_unit_is_noticed():
    """7200 mm/min typed as 7200 mm/s."""
    with pytest.raises(DataError, match=r"stated feed is 432000 mm/min, but positions .* 6000 mm"):
        Run(X, np.zeros(101), t=np.arange(101) * 1e-3, feed=7.2)


def test_reverse_run_keeps_its_order():
    z = np.zeros(101)
    z[0] = 1e-9
    run = Run(X[::-1], z, feed=0.1)

    assert run.direction == -1
    assert run.z[0] == 1e-9
    assert run.x[0] == X[-1]
    assert run.to_profile().z[-1] == 1e-9


def test_turning_encoder_is_named_with_place():
    x = X.copy()
    x[50] = x[49] - 1e-6

    with pytest.raises(
        InvalidSamplesError, match=r"'r1': the encoder is not monotonic, x\[49\] = 4.900000 mm"
    ):
        Run(x, np.zeros(101), run_id="r1")


@pytest.mark.parametrize("feed", [0.0, -0.1, np.nan])
def test_feed_must_be_positive(feed):
    with pytest.raises(InvalidSamplesError, match="feed"):
        Run(X, np.zeros(101), feed=feed)


def test_feeds_within_two_percent_are_one():
    runs = RunSet(Run(X, np.zeros(101), feed=f) for f in (0.08, 0.0805, 0.12, 0.0795))

    assert runs.feeds == pytest.approx((0.08, 0.12), rel=1e-3, abs=0.0)
    assert [len(group) for _, group in runs.by_feed()] == [3, 1]


def test_select_by_direction_and_feed():
    runs = RunSet(
        [
            Run(X, np.zeros(101), feed=0.1, run_id="a"),
            Run(X[::-1], np.zeros(101), feed=0.1, run_id="b"),
            Run(X, np.zeros(101), feed=0.2, run_id="c"),
        ]
    )

    assert [r.run_id for r in runs.select(direction=-1)] == ["b"]
    assert [r.run_id for r in runs.select(feed=0.2)] == ["c"]
    with pytest.raises(TooFewSamplesError, match=r"feeds 6000, 12000 mm/min"):
        runs.select(feed=0.3)


def test_travels():
    runs = RunSet([Run(X, np.zeros(101)), Run(X + 2e-3, np.zeros(101))])

    assert runs.common_travel == pytest.approx((2e-3, 10e-3), rel=ROUNDING, abs=0.0)
    assert runs.full_travel == pytest.approx((0.0, 12e-3), rel=ROUNDING, abs=0.0)
    with pytest.raises(InvalidSamplesError, match="no travel in common"):
        _ = RunSet([Run(X, np.zeros(101)), Run(X + 1.0, np.zeros(101))]).common_travel


def test_profiles_become_runs_and_other_things_do_not():
    assert RunSet([Profile(X, np.zeros(101))])[0].direction == 1
    with pytest.raises(InvalidSamplesError, match="element 0 of a RunSet is a int"):
        RunSet([3])
    with pytest.raises(TooFewSamplesError, match="at least one run"):
        RunSet([])


def test_run_that_was_never_measured_is_refused():
    with pytest.raises(InvalidSamplesError, match="'dead' holds no valid sample"):
        RunSet([Run(X, np.full(101, np.nan), run_id="dead")])


def test_repr_says_what_is_there():
    runs = RunSet([Run(X, np.zeros(101), feed=0.08), Run(X[::-1], np.zeros(101), feed=0.08)])

    assert repr(runs) == (
        "RunSet(2 runs, feeds 4800 mm/min, forward and reverse, common travel 0 ... 10 mm)"
    )
