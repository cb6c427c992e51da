"""`ErrorEstimate`: directions, lost motion, storage, refusals."""

import json

import numpy as np
import pytest

from metrosep import Run, RunSet
from metrosep.errors import (
    DataError,
    InvalidSamplesError,
    NotSeparableError,
    TooFewSamplesError,
)
from metrosep.separation import ErrorEstimate, machine_axis, separate as separate_runs

pytestmark = pytest.mark.usefixtures("separations_once")

SHORTEST = 1.5e-3
"""The shortest wave of the simulated axis is 3.3 mm; the harmonics below cost most of the time of a joint estimate."""


def separate(runs, **options):
    """Separate; a joint estimate goes down to SHORTEST unless the test says otherwise."""
    if options.get("method", "joint") == "joint":
        options = {"shortest": SHORTEST} | options
    return separate_runs(runs, **options)


PM = 1e-12


@pytest.fixture(scope="module")
def both_ways():
    return machine_axis(seed=3, directions=(1, -1), n_repeats=2, lost_motion=0.4e-6, offset=5e-9)


@pytest.mark.parametrize("method", ["joint", "kono", "mean"])
def test_every_method_returns_the_contract(method):
    axis = machine_axis(seed=1)
    options = {"shortest": 4e-3} if method == "kono" else {}

    estimate = separate(axis.runs, method=method, start=axis.start, length=45e-3, **options)
    x = np.linspace(0, 45e-3, 4001)

    assert estimate.method == method
    assert estimate.evaluate(x).shape == (4001,)
    assert (estimate.sd(x) > 0).all()
    assert np.polyfit(x, estimate.evaluate(x), 1)[0] == pytest.approx(0.0, abs=3e-9)
    assert np.isnan(estimate.evaluate([-1.0, 1.0])).all()
    assert list(estimate.spectrum.columns)[:3] == ["wavelength_mm", "amplitude_nm", "phase_rad"]
    assert set(estimate.feed_spectra["feed_mm_min"].round()) == {4800.0, 7200.0, 9600.0}
    assert estimate.history[-1].name == "separate"


@pytest.mark.parametrize("method", ["joint", "kono", "mean"])
def test_storage_is_exact(method):
    axis = machine_axis(seed=2)
    estimate = separate(
        axis.runs, method=method, **({"shortest": 4e-3} if method == "kono" else {})
    )
    x = np.linspace(*estimate.fit_range, 333)

    text = json.dumps(estimate.to_dict(), allow_nan=False)
    back = ErrorEstimate.from_dict(json.loads(text))

    np.testing.assert_allclose(back.evaluate(x), estimate.evaluate(x), atol=PM, rtol=0)
    np.testing.assert_allclose(back.sd(x), estimate.sd(x), atol=PM, rtol=0)
    assert back.messages == estimate.messages
    assert back.spectrum.equals(estimate.spectrum)


def test_damaged_storage_is_refused():
    axis = machine_axis(seed=2, disturbance="none")
    data = separate(axis.runs, method="mean").to_dict()
    del data["directions"]

    with pytest.raises(DataError, match="not a stored estimate"):
        ErrorEstimate.from_dict(data)


def test_directions_are_estimated_apart(both_ways):
    estimate = separate(both_ways.runs, start=0.0, length=45e-3)
    x = np.linspace(0, 45e-3, 200)

    assert estimate.directions == (-1, 1)
    forward = estimate.evaluate(x, direction=1)
    reverse = estimate.evaluate(x, direction=-1)
    np.testing.assert_allclose(estimate.evaluate(x), (forward + reverse) / 2, atol=PM, rtol=0)
    assert not np.array_equal(forward, reverse)
    truth = both_ways.truth(x)
    truth -= np.polyval(np.polyfit(x, truth, 1), x)
    for part in (forward, reverse):
        assert np.sqrt(np.mean((part - truth) ** 2)) < 15e-9


def test_direction_dependent_error_is_not_mixed():
    """A bump that only the reverse runs show."""
    rng = np.random.default_rng(8)
    runs = []
    for v in (0.08, 0.12):
        for way in (1, -1):
            t = np.arange(int(50e-3 / v * 1000)) * 1e-3
            x = v * t if way > 0 else 50e-3 - v * t
            z = 5e-9 * rng.standard_normal(t.size)
            if way < 0:
                z += 1e-6 * np.exp(-(((x - 15e-3) / 3e-3) ** 2))
            runs.append(Run(x, z, t=t, feed=v))

    estimate = separate(RunSet(runs))

    def bump(direction):
        at = estimate.evaluate([15e-3, 40e-3], direction=direction)
        return at[0] - at[1]

    assert bump(-1) == pytest.approx(1e-6, rel=0.2, abs=0.0)
    assert abs(bump(1)) < 0.02e-6


def test_lost_motion_has_its_sign(both_ways):
    estimate = separate(both_ways.runs, start=0.0, length=45e-3)

    assert estimate.lost_motion.value == pytest.approx(0.4e-6, abs=5 * estimate.lost_motion.u)
    assert estimate.lost_motion.u < 0.05e-6


def test_one_direction_has_no_lost_motion():
    assert separate(machine_axis(seed=1).runs, method="mean").lost_motion is None


def test_reverse_runs_give_the_same_error(contract_machine, as_runset):
    """Mirrored data must not come out mirrored."""
    machine = contract_machine.Machine(12, direction=-1)

    estimate = separate(as_runset(machine), start=0.0, length=45e-3)

    assert estimate.directions == (-1,)
    assert machine.rms_nm(estimate) < 9.0


def test_different_travel_is_refused_until_the_range_is_stated():
    axis = machine_axis(seed=1)
    long, short = axis.runs[0], axis.runs[8]
    keep = short.x < 40e-3
    runs = RunSet([long, axis.runs[4], Run(short.x[keep], short.z[keep], feed=short.feed)])

    with pytest.raises(InvalidSamplesError, match=r"different travels.*state start and length"):
        separate(runs)
    assert separate(runs, start=0.0, length=35e-3).stop == pytest.approx(35e-3, rel=1e-9, abs=0.0)


def unequal_runs():
    """Six runs at two feedrates over 50 mm; four start at 8 mm, one ends at 41 mm; error in nm."""
    rng = np.random.default_rng(12)

    def error(mm):
        return 180.0 * np.sin(2.0 * np.pi * mm / 17.0 + 0.3) + 70.0 * np.cos(
            2.0 * np.pi * mm / 7.3
        )

    runs = []
    reach = [(0.0, 50.0), (8.0, 50.0), (8.0, 41.0), (0.0, 50.0), (8.0, 50.0), (8.0, 50.0)]
    for feed, (low, high) in zip((60.0, 60.0, 60.0, 110.0, 110.0, 110.0), reach, strict=True):
        mm = np.arange(low, high, feed / 250.0)
        nm = error(mm) + rng.normal(0.0, 12.0, mm.size) + rng.normal(0.0, 300.0)
        t = (mm - low) / feed
        runs.append(Run(mm * 1e-3, nm * 1e-9, t=t, feed=feed * 1e-3, run_id=f"{len(runs) + 1}"))
    return RunSet(runs), error


def test_a_stated_range_that_some_runs_do_not_reach_has_a_band_that_holds():
    runs, error = unequal_runs()

    estimate = separate(runs, start=0.0, length=49.5e-3)

    mm = np.linspace(0.5, 49.0, 195)
    rest = estimate.evaluate(mm * 1e-3) * 1e9 - error(mm)
    rest -= np.polyval(np.polyfit(mm, rest, 1), mm)
    sd = estimate.sd(mm * 1e-3) * 1e9
    assert np.mean(np.abs(rest) < 2.0 * sd) > 0.85  # 5 % point of a set: the acceptance table
    assert np.sqrt(np.mean(rest**2)) < 6.0  # 12 nm of six runs, waves of 60 samples and more
    assert np.all(np.abs(rest[mm < 8.0]) < 3.5 * sd[mm < 8.0])  # a joint 99.9 % of a few waves
    said = [m for m in estimate.messages if "not all runs reach" in m]
    assert len(said) == 1
    assert "is covered by 2 of 6" in said[0]
    with pytest.raises(InvalidSamplesError, match="not covered by every run"):
        separate(runs, method="kono", start=0.0, length=49.5e-3)


def test_a_part_that_one_feedrate_or_no_run_covers_is_named():
    runs, _ = unequal_runs()

    alone = separate(RunSet([*runs[:3], *runs[4:]]), start=0.0, length=49.0e-3)
    assert any("one feedrate alone cannot tell" in m for m in alone.messages)
    # A feedrate that is measured is never the same to the last digit: 60.0 and 60.3 mm/s are one.
    twin = Run(runs[0].x, runs[0].z, t=runs[0].t * 60.0 / 60.3, feed=60.3e-3, run_id="7")
    alone = separate(RunSet([*runs[:3], *runs[4:], twin]), start=0.0, length=49.0e-3, accept="7")
    assert any("one feedrate alone cannot tell" in m for m in alone.messages)

    short = [
        Run(r.x[r.x < 20e-3], r.z[r.x < 20e-3], t=r.t[r.x < 20e-3], feed=r.feed) for r in runs
    ]
    rest = [Run(r.x[r.x > 24e-3], r.z[r.x > 24e-3], t=r.t[r.x > 24e-3], feed=r.feed) for r in runs]
    with pytest.raises(InvalidSamplesError, match=r"no run covers 19\.\d+ \.\.\. 24\.\d+ mm"):
        separate(RunSet([*short[:3], *rest[3:]]), start=8.5e-3, length=40e-3)
    with pytest.raises(
        InvalidSamplesError, match=r"not covered by the runs: they reach 0 \.\.\. 49"
    ):
        separate(runs, start=0.0, length=60e-3)


def test_range_outside_the_travel_is_refused():
    axis = machine_axis(seed=1)

    with pytest.raises(InvalidSamplesError, match="not covered by the runs: they reach"):
        separate(axis.runs, start=0.0, length=60e-3)
    with pytest.raises(InvalidSamplesError, match="not covered by every run"):
        separate(axis.runs, method="kono", start=0.0, length=60e-3)


def test_length_in_millimetres_is_refused():
    with pytest.raises(InvalidSamplesError, match="not covered"):
        separate(machine_axis(seed=1).runs, start=0.0, length=45.0)


def test_runs_without_time_are_refused_by_joint_and_taken_by_mean():
    rng = np.random.default_rng(1)
    x = np.linspace(0, 0.05, 300)
    runs = RunSet(Run(x, 1e-8 * rng.standard_normal(300)) for _ in range(3))

    with pytest.raises(NotSeparableError, match="no feedrate"):
        separate(runs)
    assert np.isfinite(separate(runs, method="mean").evaluate([0.02])).all()


def test_short_runs_are_refused():
    runs = RunSet(Run(np.linspace(0, 1e-2, 20), np.zeros(20), feed=v) for v in (0.05, 0.1))

    with pytest.raises(TooFewSamplesError, match="at least 32"):
        separate(runs)


def test_unknown_method_is_refused():
    with pytest.raises(DataError, match="unknown method 'kalman'"):
        separate(machine_axis(seed=1).runs, method="kalman")


def test_lag_for_a_method_in_space_is_refused():
    with pytest.raises(DataError, match="has no lag"):
        separate(machine_axis(seed=1).runs, method="mean", lag=1e-3)


def test_peak_to_valley_states_definition_and_uncertainty():
    estimate = separate(machine_axis(seed=1).runs, start=0.0, length=45e-3)
    pv = estimate.peak_to_valley()

    assert pv.value == pytest.approx(1.2e-6, abs=0.4e-6)
    assert 0 < pv.u < 0.05e-6
    assert "line" in pv.definition


def test_mean_of_identical_runs_is_that_run():
    x = np.linspace(0, 0.05, 501)
    z = 1e-6 * np.sin(2 * np.pi * x / 10e-3)
    z -= np.polyval(np.polyfit(x, z, 1), x)
    runs = RunSet(Run(x, z + 3e-6 * i, feed=0.1) for i in range(3))

    estimate = separate(runs, method="mean")

    dense = np.linspace(0, 0.05, 4001)
    expected = np.interp(dense, x, z)
    expected -= np.polyval(np.polyfit(dense, expected, 1), dense)
    np.testing.assert_allclose(estimate.evaluate(dense), expected, atol=PM, rtol=0)
    np.testing.assert_allclose(estimate.sd(x), 0.0, atol=PM, rtol=0)


def test_mean_uncertainty_is_sigma_over_root_n():
    rng = np.random.default_rng(4)
    x = np.linspace(0, 0.05, 2001)
    runs = RunSet(Run(x, 1e-8 * rng.standard_normal(2001), feed=0.1) for _ in range(16))

    sd = separate(runs, method="mean").sd(x[100:-100])

    assert np.sqrt(np.mean(sd**2)) == pytest.approx(1e-8 / 4, rel=0.03, abs=0.0)


def test_mean_leaves_a_common_gap_open():
    x = np.linspace(0, 0.05, 501)
    z = np.where((x > 20e-3) & (x < 25e-3), np.nan, 1e-8 * np.sin(x * 1e3))
    estimate = separate(RunSet([Run(x, z, feed=0.1), Run(x, z, feed=0.2)]), method="mean")

    assert np.isnan(estimate.evaluate([22e-3])[0])
    assert np.isfinite(estimate.evaluate([10e-3])[0])


def test_lost_motion_is_that_of_the_middle_where_the_directions_differ_in_slope():
    # the reverse runs lie 500 nm higher at 10 mm and 4 um/m more at every position beyond
    rng = np.random.default_rng(4)
    x = np.arange(0.0, 50e-3, 20e-6)

    def run(k, sign):
        place = x[::sign]
        z = 400e-9 * np.cos(2 * np.pi * place / 20e-3) + 2e-9 * rng.standard_normal(x.size)
        if sign < 0:
            z = z + 500e-9 + 4e-6 * (place - 10e-3)
        return Run(place, z, t=np.arange(x.size) * 1e-3, feed=0.02, run_id=f"{k}{sign}")

    runs = RunSet([run(k, sign) for k in range(3) for sign in (1, -1)])
    estimate = separate(runs, method="mean")
    middle = 0.5 * (estimate.start + estimate.stop)
    planted = 500e-9 + 4e-6 * (middle - 10e-3)
    # the wave does not end where it began, so its line is not quite that of the wave alone
    assert estimate.lost_motion.value == pytest.approx(planted, abs=1e-9)
