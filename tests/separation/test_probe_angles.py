"""Probe angles against W_k, an explicit least-squares covariance and the figures of spec S13."""

import json
import math

import numpy as np
import pytest

from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotSeparableError,
    TooFewSamplesError,
    UnitError,
)
from metrosep.separation.circles.probe_angles import optimise_probe_angles, probe_gain


def covariance_gain(phi, k):
    """Square root of the variance of R in least squares, from the normal equations."""
    a = np.column_stack([np.exp(1j * k * phi), np.cos(phi), np.sin(phi)])
    return math.sqrt(np.linalg.inv(a.conj().T @ a)[0, 0].real)


def distances(phi):
    p = np.sort(np.mod(phi, 2 * math.pi))
    return np.diff(np.append(p, p[0] + 2 * math.pi))


@pytest.mark.parametrize("n", [3, 4, 6])
def test_gain_is_the_root_of_the_least_squares_variance(n):
    phi = np.random.default_rng(n).uniform(0, 2 * math.pi, n)

    gain = probe_gain(phi, 40)

    assert np.isinf(gain[:2]).all()
    for k in range(2, 41):
        assert gain[k] == pytest.approx(covariance_gain(phi, k), rel=1e-7, abs=0)


def test_gain_does_not_see_rotation_mirror_or_order():
    phi = np.deg2rad([0, 20.5, 270.5, 297])
    gain = probe_gain(phi, 30)

    for other in (np.mod(phi + 1.0, 2 * math.pi), -phi, phi[[2, 0, 3, 1]]):
        np.testing.assert_allclose(probe_gain(other, 30)[2:], gain[2:], rtol=1e-9, atol=0)


def test_search_beats_all_pairs_on_a_grid_of_three_degrees():
    kmax = 20
    best = math.inf
    k = np.arange(2, kmax + 1)
    for a in np.deg2rad(np.arange(3, 180, 3)):
        for b in np.deg2rad(np.arange(3, 360, 3)):
            det = math.sin(b - a)
            if abs(det) < 1e-6:
                continue
            c2, c3 = -math.sin(b) / det, math.sin(a) / det
            w = 1 + c2 * np.exp(1j * k * a) + c3 * np.exp(1j * k * b)
            if np.abs(w).min() > 1e-9:
                best = min(best, math.sqrt(np.mean((1 + c2**2 + c3**2) / np.abs(w) ** 2)))

    found = optimise_probe_angles(3, kmax)

    assert found.gain <= best


@pytest.mark.slow
@pytest.mark.parametrize(
    ("n", "kmax", "separation", "goal"),
    [
        (3, 50, 20, 1.30),
        (4, 50, 20, 0.80),
        (5, 50, 20, 0.62),
        (3, 200, 10, 1.6),
        (5, 200, 15, 0.63),
    ],
)
def test_goals_of_the_specification(n, kmax, separation, goal):
    found = optimise_probe_angles(n, kmax, min_separation=math.radians(separation), seed=3)

    gains = [covariance_gain(found.angles, k) for k in range(2, kmax + 1)]
    assert math.sqrt(np.mean(np.square(gains))) <= goal
    assert found.gain == pytest.approx(math.sqrt(np.mean(np.square(gains))), rel=1e-9, abs=0)
    assert max(gains) == pytest.approx(found.worst_gain, rel=1e-9, abs=0)
    assert gains[found.worst_k - 2] == pytest.approx(max(gains), rel=1e-9, abs=0)
    assert distances(found.angles).min() >= math.radians(separation) - 1e-9


@pytest.mark.slow
def test_same_seed_same_angles_and_bodies_keep_their_distance():
    options = {"min_separation": math.radians(33), "seed": 5}
    first, second = (optimise_probe_angles(4, 16, **options) for _ in range(2))

    np.testing.assert_array_equal(first.angles, second.angles)
    assert first.angles[0] == 0.0
    assert distances(first.angles).min() >= math.radians(33) - 1e-9
    assert first.gain < 1.0


def test_fixed_probes_stay_and_the_rest_is_chosen():
    fixed = np.deg2rad([10.0, 100.0])

    found = optimise_probe_angles(4, 20, fixed=fixed, min_separation=math.radians(15))

    np.testing.assert_array_equal(found.angles[:2], fixed)
    assert distances(found.angles).min() >= math.radians(15) - 1e-9
    alone = probe_gain([*fixed, *np.deg2rad([190.0, 235.0])], 20)
    assert found.gain < math.sqrt(np.mean(alone[2:] ** 2))


@pytest.mark.slow
def test_tolerance_and_worst_case_are_criteria_of_their_own():
    plain = optimise_probe_angles(3, 20)
    robust = optimise_probe_angles(3, 20, tolerance=math.radians(2.0))
    worst = optimise_probe_angles(3, 20, criterion="worst")

    assert plain.robust_gain == plain.gain
    assert robust.robust_gain > robust.gain >= plain.gain - 1e-12
    rng = np.random.default_rng(99)
    misses = math.radians(2.0) * rng.standard_normal((200, 3))

    def met(angles):
        return np.mean([np.mean(probe_gain(angles + d, 20)[2:] ** 2) for d in misses])

    assert met(robust.angles) <= 1.05 * met(plain.angles)
    assert worst.worst_gain <= plain.worst_gain


def test_result_is_plain_values_and_tables():
    found = optimise_probe_angles(3, 8, min_separation=0.3)

    document = found.to_dict()
    assert document["gain_per_k"][:2] == [None, None]
    assert document["angles_deg"] == np.rad2deg(found.angles).tolist()
    assert found.to_frame()["k"].tolist() == list(range(2, 9))
    assert "worst" in repr(found)
    assert "<table" in found._repr_html_()


@pytest.mark.parametrize(
    ("arguments", "options", "error", "words"),
    [
        ((2, 20), {}, DataError, "3 to 24"),
        ((3.5, 20), {}, DataError, "3 to 24"),
        ((3, 1), {}, DataError, "kmax"),
        ((3, 20), {"min_separation": 20}, UnitError, "deg2rad"),
        ((3, 20), {"min_separation": -0.1}, DataError, "min_separation"),
        ((3, 20), {"tolerance": math.nan}, DataError, "tolerance"),
        ((3, 20), {"resolution": 0.0}, DataError, "resolution"),
        ((3, 20), {"criterion": "mean"}, DataError, "criterion"),
        ((3, 20), {"fixed": [0, 1, 2]}, DataError, "probe_gain"),
        ((3, 20), {"fixed": [0, 45]}, UnitError, "deg2rad"),
        ((3, 20), {"fixed": [0, math.inf]}, InvalidSamplesError, "finite"),
        ((4, 20), {"fixed": [0, 0.1], "min_separation": 0.3}, NotSeparableError, "apart"),
        ((8, 20), {"min_separation": 1.0}, NotSeparableError, "no arrangement"),
    ],
)
def test_impossible_requests_are_refused(arguments, options, error, words):
    with pytest.raises(error, match=words):
        optimise_probe_angles(*arguments, **options)


def test_gain_refuses_what_is_no_arrangement():
    with pytest.raises(TooFewSamplesError):
        probe_gain([0, 1], 10)
    with pytest.raises(NotSeparableError, match="line"):
        probe_gain([0, math.pi, 0], 10)


@pytest.mark.parametrize(
    ("arguments", "options", "error", "words"),
    [
        ((math.nan, 30), {}, DataError, "number of probes"),
        ((math.inf, 30), {}, DataError, "number of probes"),
        (("3", 30), {}, DataError, "number of probes"),
        ((3, math.nan), {}, DataError, "kmax"),
        ((3, 30), {"min_separation": 2}, UnitError, "degrees"),
        ((3, 30), {"min_separation": "small"}, DataError, "min_separation"),
        ((3, 30), {"tolerance": None}, DataError, "tolerance"),
        ((3, 30), {"seed": -1}, DataError, "seed"),
        ((3, 30), {"seed": "a"}, DataError, "seed"),
    ],
)
def test_what_is_no_number_is_refused_in_words(arguments, options, error, words):
    with pytest.raises(error, match=words):
        optimise_probe_angles(*arguments, **options)


def test_result_is_json_with_numpy_settings_too():
    found = optimise_probe_angles(np.int64(4), np.int64(12), seed=np.int64(3))
    json.dumps(found.to_dict(), allow_nan=False)


@pytest.mark.slow
@pytest.mark.parametrize(("n", "kmax"), [(12, 500), (24, 500)])
def test_many_probes_and_undulations_stay_near_the_bound(n, kmax):
    """The RMS gain cannot fall below 1/sqrt(n)."""
    found = optimise_probe_angles(n, kmax)

    assert found.gain < 1.1 / math.sqrt(n)
