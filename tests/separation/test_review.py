"""Defects found by a review: each test failed before its mend."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotSeparableError,
    UnitError,
)
from metrosep.core.runset import Run, RunSet
from metrosep.separation import machine_axis, separate
from metrosep.separation.runs.design import prepare_runs
from metrosep.spectral.dft import fourier_basis, fourier_coefficients, fourier_sum

PM = 1e-12
"""Rounding of heights of a micrometre after sums of thousands of terms."""

NM = 1e-9


def test_both_directions_are_evaluated_over_the_range_that_was_asked_for():
    axis = machine_axis(seed=13, disturbance="none", directions=(1, -1), n_repeats=1)
    runs = RunSet(
        [
            r if r.direction > 0 else Run(r.x[:-40], r.z[:-40], t=r.t[:-40], feed=r.feed)
            for r in axis.runs
        ]
    )

    estimate = separate(runs, method="mean", length=30e-3)

    assert estimate.stop - estimate.start == pytest.approx(30e-3, abs=PM)
    x = np.linspace(estimate.start, estimate.stop, 4001)
    for direction in (1, -1):
        slope = np.polyfit(x, estimate.evaluate(x, direction=direction), 1)[0]
        assert abs(slope) * 30e-3 < PM


@pytest.mark.slow
def test_the_alignment_slope_does_not_coarsen_the_prior():
    axis = machine_axis(seed=7, n_repeats=1)
    tilted = RunSet([Run(r.x, r.z + 0.1 * r.x, t=r.t, feed=r.feed) for r in axis.runs])
    x = np.linspace(axis.start, axis.stop, 301)
    options = {"start": axis.start, "length": axis.stop - axis.start}

    level, steep = separate(axis.runs, **options), separate(tilted, **options)

    assert np.abs(steep.evaluate(x) - level.evaluate(x)).max() < 0.1 * NM
    assert steep.slope.value - level.slope.value == pytest.approx(0.1, abs=1e-9)


def test_kono_on_single_runs_says_that_the_uncertainty_is_not_known():
    axis = machine_axis(seed=1, n_repeats=1, disturbance="none")

    estimate = separate(axis.runs, method="kono", shortest=4e-3)

    assert any("one run" in m for m in estimate.messages)
    assert "not known" in repr(estimate)


def test_kono_without_feeds_can_be_stored():
    axis = machine_axis(seed=1, n_repeats=1, disturbance="none")
    runs = RunSet([Run(r.x, r.z) for r in axis.runs])

    stored = separate(runs, method="kono", shortest=4e-3).to_dict()

    json.dumps(stored, allow_nan=False)


def test_a_set_without_common_travel_can_be_printed():
    x = np.linspace(0.0, 10e-3, 50)

    runs = RunSet([Run(x, x * 0.0), Run(x + 1.0, x * 0.0)])

    assert "common travel none" in repr(runs)
    assert "none" in runs._repr_html_()


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ({"lag": "often"}, DataError),
        ({"lag": None}, DataError),
        ({"start": math.nan}, InvalidSamplesError),
        ({"false_discovery_rate": 5}, DataError),
        ({"method": "kono", "shortest": 0.0}, UnitError),
        ({"method": "kono", "shortest": math.nan}, InvalidSamplesError),
        ({"method": "kono", "modelling_length": 0.0}, DataError),
        ({"method": "kono", "modelling_length": math.nan}, DataError),
        ({"method": "kono", "feed": math.nan}, DataError),
        ({"method": "mean", "feed": 0.0}, DataError),
    ],
)
def test_an_option_that_cannot_be_meant_is_refused(options, error):
    runs = machine_axis(seed=1, n_repeats=1).runs

    with pytest.raises(error):
        separate(runs, **options)


def test_a_list_of_runs_and_a_bare_run_are_refused_with_advice():
    runs = machine_axis(seed=1, n_repeats=1).runs

    with pytest.raises(DataError, match="RunSet"):
        separate(list(runs))
    with pytest.raises(InvalidSamplesError, match="RunSet"):
        RunSet(runs[0])


def test_the_direction_that_has_one_feed_only_is_named():
    runs = machine_axis(seed=1, n_repeats=1, directions=(1, -1)).runs
    lopsided = RunSet([r for r in runs if r.direction < 0 or r.feed < 0.1])

    with pytest.raises(NotSeparableError, match="forward runs have 1 feedrate"):
        separate(lopsided)


@pytest.mark.slow
def test_feeds_that_hardly_differ_are_reported():
    near = separate(machine_axis(seed=1, feeds=(0.12, 0.1236), n_repeats=2).runs)
    apart = separate(machine_axis(seed=1, feeds=(0.12, 0.16), n_repeats=2).runs)

    assert any("feedrates differ by" in m for m in near.messages)
    assert not any("feedrates differ by" in m for m in apart.messages)


def test_a_lag_without_geometry_is_not_stated_as_a_fact():
    axis = machine_axis(seed=8, waves={10e-3: 0.0}, n_repeats=3)

    estimate = separate(axis.runs, lag="fit")

    assert any("not determined" in m for m in estimate.messages)
    assert not any(m.startswith("readings lag") for m in estimate.messages)


@pytest.mark.slow
def test_a_stated_shortest_wavelength_that_the_data_cannot_hold_is_reported():
    """One run has fewer readings than unknowns of so short waves; two runs have enough."""
    one = machine_axis(seed=1, feeds=(0.12,), n_repeats=1)
    two = machine_axis(seed=1, feeds=(0.12, 0.16), n_repeats=1)

    few = separate(one.runs, shortest=0.31e-3, min_feeds=1)
    enough = separate(two.runs, shortest=0.45e-3)

    assert few.audit["shortest_wavelength_mm"] > 0.31
    assert any("too few samples" in m for m in few.messages)
    assert enough.audit["shortest_wavelength_mm"] < 0.45
    assert not any("too few samples" in m for m in enough.messages)


def _rms_error(axis, runs):
    x = np.linspace(axis.start, axis.stop, 501)
    estimate = separate(runs, start=axis.start, length=axis.stop - axis.start, shortest=1e-3)
    error = estimate.evaluate(x) - axis.truth(x)
    error -= np.polyval(np.polyfit(x, error, 1), x)
    assert not any("another phase in each run" in m for m in estimate.messages)  # none slips
    return float(np.sqrt(np.mean(error**2)))


def _scattered(axis, share, seed):
    rng = np.random.default_rng(seed)
    return RunSet(
        [
            Run(r.x, np.where(rng.random(r.x.size) < share, np.nan, r.z), t=r.t, feed=r.feed)
            for r in axis.runs
        ]
    )


@pytest.mark.parametrize("share", [0.05, 0.15, 0.3])
def test_scattered_samples_that_were_not_measured_cost_their_share(share):
    """White noise alone; 0.15 of the samples gave four times the error and six waves that slip."""
    axis = machine_axis(seed=7, disturbance="none")

    # Of 1 - share the readings the error is 1/sqrt(1 - share); 1.5 nm may move by a third by chance.
    whole = _rms_error(axis, axis.runs)
    assert _rms_error(axis, _scattered(axis, share, 0)) < 1.35 * whole / math.sqrt(1.0 - share)


@pytest.mark.parametrize("rate", [5000.0, 10_000.0])
def test_fast_runs_of_one_clock_share_one_noise_model(rate):
    """At 10 kHz each feedrate had an interval of its own: 63 nm in a band of 18 where a wave slipped."""
    runs = machine_axis(seed=1, sampling_rate=rate, n_repeats=1).runs
    part = Run(runs[0].x[:900], runs[0].z[:900], t=runs[0].t[:900], feed=runs[0].feed)
    slower = machine_axis(seed=2, sampling_rate=1000.0, feeds=(0.08,), n_repeats=1).runs[0]

    prepared = prepare_runs(RunSet([*runs, part, slower]))

    steps = [p.time_step for p in prepared]
    assert max(steps[:-1]) - min(steps[:-1]) < 1e-9 * steps[0]  # one clock, another rounding
    assert steps[0] <= 1e-3 * (1.0 + 1e-9)
    assert steps[0] > 1.0 / rate  # averaged, as far as the fastest bears it
    assert steps[-1] == pytest.approx(1e-3 * round(steps[-1] * 1e3), abs=1e-12)  # another clock
    assert prepared[0].x.size >= 800  # of the slowest feed, over the whole travel


@pytest.mark.parametrize("share", [0.03, 0.3])
def test_fast_readings_that_were_not_measured_cost_their_share(share):
    """Readings are averaged in blocks of 8: a block with one missing reading was none, 3 nm became 40."""
    axis = machine_axis(seed=20, sampling_rate=8000.0, feeds=(0.08, 0.16), n_repeats=2)

    whole = _rms_error(axis, axis.runs)
    assert _rms_error(axis, _scattered(axis, share, 1)) < 1.35 * whole / math.sqrt(1.0 - share)


def test_readings_of_which_every_third_was_measured_are_used():
    axis = machine_axis(seed=20, sampling_rate=8000.0, feeds=(0.08, 0.16), n_repeats=2)
    runs = RunSet(
        [
            Run(r.x, np.where(np.arange(r.x.size) % 3 == 0, r.z, np.nan), t=r.t, feed=r.feed)
            for r in axis.runs
        ]
    )

    assert _rms_error(axis, runs) < 2.0 * _rms_error(axis, axis.runs)  # sqrt(3) by the count


def test_fourier_sums_in_blocks_equal_the_whole():
    rng = np.random.default_rng(3)
    x = np.sort(rng.uniform(0.0, 0.05, 9001))
    z, both = rng.standard_normal(9001), rng.standard_normal(1000)
    basis = fourier_basis(x, origin=1e-3, period=0.05, n_harmonics=500)
    cell = np.abs(np.gradient(x)) / np.abs(np.gradient(x)).sum()

    whole = 2.0 * (z * cell) @ basis
    got = fourier_coefficients(x, z, origin=1e-3, period=0.05, n_harmonics=500)

    np.testing.assert_allclose(np.concatenate([got.real, got.imag]), whole, rtol=0.0, atol=1e-13)
    series = fourier_sum(x, both, origin=1e-3, period=0.05)
    np.testing.assert_allclose(series, basis @ both, rtol=0.0, atol=1e-10)


@pytest.mark.slow
def test_fast_sampling_does_not_hide_slow_modes(contract_machine, as_runset):
    """48 coefficients at 8 kHz span 6 ms and could not tell a 12 Hz mode from geometry."""
    scores = {}
    for rate in (1000.0, 8000.0):
        machine = contract_machine.Machine(4, case="floor", rate=rate)
        estimate = separate(
            as_runset(machine), start=0.0, length=machine.length * 1e-3, shortest=1e-3
        )
        scores[rate] = machine.rms_nm(estimate)

    assert scores[8000.0] < 1.3 * scores[1000.0]


def test_a_long_lag_is_found(contract_machine, as_runset):
    machine = contract_machine.Machine(5, lag=30e-3)
    estimate = separate(
        as_runset(machine), start=0.0, length=machine.length * 1e-3, shortest=1e-3, lag="fit"
    )

    assert estimate.lag == pytest.approx(30e-3, abs=4.0 * estimate.lag_sd)


def test_numpy_scalars_are_numbers_and_the_history_is_json():
    axis = machine_axis(seed=2, disturbance="none", n_repeats=1)

    estimate = separate(
        axis.runs, start=np.float32(0.0), length=np.float32(0.045), lag=np.float64(0.0)
    )

    assert json.loads(json.dumps(estimate.to_dict()))["method"] == "joint"
