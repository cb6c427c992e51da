"""The covariance of an estimate: modes, storage, P-V. The truth is plain numpy on a dense grid."""

import json
from dataclasses import replace

import numpy as np
import pytest
from contracts.estimates import (
    DRAWS,
    LENGTH,
    NM,
    OF_DRAWS,
    X,
    an_estimate,
    known,
    some_covariance,
    waves,
)

from metrosep import Run, RunSet
from metrosep.errors import DataError
from metrosep.separation import ErrorEstimate, machine_axis, separate
from metrosep.separation.covariance import CovarianceModes
from metrosep.separation.runs.base import SampledCurve

pytestmark = pytest.mark.usefixtures("separations_once")


def test_modes_hold_a_known_covariance():
    estimate, whole = known()

    found = estimate.covariance(X[::10])

    # Modes below 1e-4 of the variance are left to close neighbours, straight lines between nodes
    # cost (2 pi h / wavelength)^2 / 8 = 0.7 % of the shortest wave of 5 mm, which is small.
    assert np.abs(found - whole[::10, ::10]).max() < 2e-3 * whole.max()
    np.testing.assert_allclose(np.diag(found), estimate.sd(X[::10]) ** 2, rtol=1e-12, atol=0)
    assert (found == found.T).all()
    assert np.linalg.eigvalsh(found).min() > -1e-12 * np.trace(found)


def test_waves_shorter_than_the_nodes_become_nothing_long():
    """A wave of 0.1 mm on nodes of 0.19 mm: the mean over the travel must not inherit it."""
    x = np.linspace(0.0, LENGTH, 9001)
    wave = NM * np.column_stack([np.sin(2 * np.pi * x / 1e-4), np.cos(2 * np.pi * x / 1e-4)])
    modes = CovarianceModes.of(x, wave)
    at = np.linspace(0.0, LENGTH, 1000)

    found = modes.covariance(at, np.full(at.size, NM))

    mean = np.full(at.size, 1 / at.size)
    # The truth is below 1e-3 nm; independent stretches of a node give 1 nm / sqrt(240) = 0.065.
    assert np.sqrt(mean @ found @ mean) < 0.08 * NM
    # ... and it does not depend on how many positions the mean is taken over.
    few = found[::4, ::4].mean()
    assert np.sqrt(few) == pytest.approx(np.sqrt(found.mean()), rel=0.15, abs=0.0)


def test_what_is_added_without_form_neither_cancels_nor_averages():
    estimate, _ = known()
    part = estimate.directions_data[1]
    u = np.hypot(part.uncertainty.z, 30 * NM)
    more = replace(estimate, directions_data={1: replace(part, uncertainty=SampledCurve(X, u))})
    x = np.array([5e-3, 12e-3])

    added = more.covariance(x) - estimate.covariance(x)

    np.testing.assert_allclose(np.diag(added), (30 * NM) ** 2, rtol=1e-6, atol=0)
    # Only the shrinkage of modes that stood above u by rounding: less than 1e-3 of the variance.
    assert abs(added[0, 1]) < 1e-3 * part.uncertainty(x).max() ** 2


@pytest.mark.parametrize("method", ["joint", "kono", "mean"])
def test_every_method_states_a_covariance_that_is_stored(method):
    axis = machine_axis(seed=1)
    options = {"shortest": 4e-3} if method == "kono" else {}
    estimate = separate(axis.runs, method=method, start=0.0, length=LENGTH, **options)
    x = np.linspace(0.0, LENGTH, 77)

    found = estimate.covariance(x)
    text = json.dumps(estimate.to_dict(), allow_nan=False)
    back = ErrorEstimate.from_dict(json.loads(text))

    np.testing.assert_allclose(np.sqrt(np.diag(found)), estimate.sd(x), rtol=1e-12, atol=0)
    assert np.linalg.eigvalsh(found).min() > -1e-12 * np.trace(found)
    assert (back.covariance(x) == found).all()
    assert back.peak_to_valley() == estimate.peak_to_valley()
    stored = json.dumps(estimate.to_dict()["directions"]["1"]["covariance"], separators=",:")
    assert len(stored) < 100_000


def test_mean_states_the_covariance_of_the_mean_of_its_runs():
    """Runs that differ by one slow wave each: their mean is known like that wave, not like noise."""
    x = np.linspace(0.0, 60e-3, 601)
    size = np.array([-30.0, 10.0, 40.0, -20.0]) * NM
    wave = np.cos(2 * np.pi * x / 20e-3)  # whole waves, even: it holds no line
    runs = RunSet([Run(x, s * wave, feed=0.08 + 0.01 * i) for i, s in enumerate(size)])

    estimate = separate(runs, method="mean")
    at = np.array([20e-3, 30e-3, 40e-3])  # crests: +1, -1, +1 of the wave
    found = estimate.covariance(at)

    expected = size.std(ddof=1) ** 2 / 4  # of the mean of four
    # The ends of the travel count half in the package's line: 1 % of a wave.
    sign = np.array([1.0, -1.0, 1.0])
    np.testing.assert_allclose(found, expected * np.outer(sign, sign), rtol=0.02, atol=0)
    correlation = found / np.sqrt(np.outer(np.diag(found), np.diag(found)))
    np.testing.assert_allclose(correlation, np.outer(sign, sign), rtol=0, atol=1e-3)


def test_two_directions_are_independent():
    axis = machine_axis(seed=3, directions=(1, -1), n_repeats=2)
    estimate = separate(axis.runs, method="mean", start=0.0, length=LENGTH)
    x = np.linspace(0.0, LENGTH, 40)

    both = [estimate.covariance(x, direction=d) for d in (1, -1)]

    np.testing.assert_allclose(estimate.covariance(x), (both[0] + both[1]) / 4, rtol=1e-12, atol=0)
    np.testing.assert_allclose(
        np.diag(estimate.covariance(x)), estimate.sd(x) ** 2, rtol=1e-12, atol=0
    )


def test_old_results_and_single_runs_say_why_there_is_none():
    axis = machine_axis(seed=1, disturbance="none")
    data = separate(axis.runs, method="mean").to_dict()
    for part in data["directions"].values():
        del part["covariance"]
    old = ErrorEstimate.from_dict(data)
    one = separate(RunSet([axis.runs[0]]), method="mean")

    assert not old.has_covariance
    with pytest.raises(DataError, match="stored without its covariance; separate the runs again"):
        old.covariance([0.01])
    with pytest.raises(DataError, match="one run tells no uncertainty"):
        one.covariance([0.01])
    assert "as independent" in old.peak_to_valley().definition
    assert np.isfinite(old.peak_to_valley().u)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("steps", None),
        ("steps", [[1, 2], [3]]),
        ("steps", []),
        ("steps", "abc"),
        ("steps", [[10**9] * 9] * 5),
        ("scale_m", [1.0]),
        ("scale_m", [float("nan")] * 9),
        ("travel_m", [1.0, 0.0]),
        ("travel_m", 3),
    ],
)
def test_a_damaged_covariance_is_refused(key, value):
    data = separate(machine_axis(seed=1).runs, method="mean").to_dict()
    (part,) = data["directions"].values()
    part["covariance"][key] = value

    with pytest.raises(DataError, match="covariance is damaged"):
        ErrorEstimate.from_dict(data)


def test_positions_outside_and_gaps_are_not_known():
    estimate, _ = known()

    found = estimate.covariance([-1.0, 10e-3, np.nan])

    assert np.isnan(found[0]).all()
    assert np.isnan(found[:, 2]).all()
    assert found[1, 1] > 0
    with pytest.raises(DataError, match="direction is"):
        estimate.covariance([0.01], direction=2)


# ---- P-V ---------------------------------------------------------------------------------------


def test_an_offset_adds_nothing_to_the_peak_to_valley():
    u = np.full(X.size, 50 * NM)
    estimate = an_estimate(u, CovarianceModes.of(X, u[:, None]))

    pv = estimate.peak_to_valley()

    assert pv.u < 1e-6 * 50 * NM  # rounding of the stored steps
    assert "covariance" in pv.definition


def test_an_opposite_error_at_the_extremes_counts_twice():
    shape = np.sin(2 * np.pi * X / 21e-3)
    estimate = an_estimate(
        np.abs(10 * NM * shape), CovarianceModes.of(X, 10 * NM * shape[:, None])
    )

    assert estimate.peak_to_valley().u == pytest.approx(20 * NM, rel=1e-3, abs=0.0)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_peak_to_valley_against_draws(seed):
    """Extremes that stand out: the P-V of estimate plus drawn error scatters by u."""
    error = 100 * NM * np.sin(2 * np.pi * X / 60e-3)
    estimate, _ = known(error=error, seed=seed)
    root = waves(X) @ np.linalg.cholesky(some_covariance(24, seed))
    rng = np.random.default_rng(10 + seed)
    drawn = error[:, None] + root @ rng.normal(size=(24, DRAWS))

    found = np.ptp(drawn, axis=0)
    u = estimate.peak_to_valley().u

    assert found.std() == pytest.approx(
        u, rel=OF_DRAWS + 0.05, abs=0.0
    )  # 0.05: the extremes move a little


def test_peak_to_valley_where_there_is_no_error_is_too_large_not_too_small():
    """The weak case that the docstring states: many places compete to be the extremes."""
    error = np.zeros(X.size)
    estimate, _ = known(error=1e-3 * NM * np.sin(2 * np.pi * X / 21e-3))
    root = waves(X) @ np.linalg.cholesky(some_covariance(24))
    drawn = error[:, None] + root @ np.random.default_rng(5).normal(size=(24, DRAWS))

    pv = estimate.peak_to_valley()
    assert np.ptp(drawn, axis=0).std() < 1.3 * pv.u
    assert np.ptp(drawn, axis=0).mean() > pv.value + pv.u


def test_a_profile_carries_the_uncertainty():
    estimate, whole = known()

    profile = estimate.to_profile(n_points=121).crop(10e-3, 20e-3)

    carried = profile.metadata["standard_uncertainty"]
    assert np.interp(12e-3, carried["x_m"], carried["u_m"]) == pytest.approx(
        np.interp(12e-3, X, np.sqrt(np.diag(whole))), rel=0.02, abs=0.0
    )
