"""Straightness of a motion: brute force over all lines, closed forms, null space, refusals."""

import copy
import itertools
import json
import pickle

import numpy as np
import pytest

from metrosep import Profile
from metrosep.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.separation.lines.iso230_straightness import straightness_iso230_1

UM = 1e-6
ROUNDING = 1e-12 * UM  # goal S20: 1e-12 of deviations of some um


def widest(residual):
    return residual.max() - residual.min()


def brute_force_zone(x, z):
    """The narrowest zone has a side through two points: try the slope of every pair."""
    slopes = [(z[j] - z[i]) / (x[j] - x[i]) for i, j in itertools.combinations(range(x.size), 2)]
    return min(widest(z - s * x) for s in slopes)


def adversarial():
    rng = np.random.default_rng(0)
    x = np.sort(rng.uniform(size=40))
    return {
        "noise": (x, UM * rng.normal(size=40)),
        "convex": (x, UM * 8 * (x - 0.3) ** 2),
        "concave and tilted": (x, UM * (400 * x - 8 * (x - 0.7) ** 2)),
        "one spike": (x, np.where(np.arange(40) == 11, 3 * UM, 0.0)),
        "end spike": (x, np.where(np.arange(40) == 39, -3 * UM, 0.0)),
        "zigzag": (x, UM * (np.arange(40) % 2)),
        "steps": (x, UM * np.floor(4 * x)),
        "random walk": (x, UM * np.cumsum(rng.normal(size=40))),
        "three points": (np.array([0.0, 0.2, 1.0]), UM * np.array([0.0, 3.0, 1.0])),
    }


@pytest.mark.parametrize("name", adversarial())
def test_minimum_zone_equals_brute_force(name):
    x, z = adversarial()[name]

    result = straightness_iso230_1(x, z)

    # The slope of the tilted case adds rounding of z itself, 4e-4 m times 1e-16.
    assert result.value == pytest.approx(brute_force_zone(x, z), abs=max(ROUNDING, 1e-18))
    assert result.deviations["MZ"].is_optimal


@pytest.mark.parametrize("name", adversarial())
def test_least_squares_and_end_points_equal_their_definitions(name):
    x, z = adversarial()[name]
    line = np.polyfit(x - x.mean(), z, 1)
    chord = z[0] + (z[-1] - z[0]) * (x - x[0]) / (x[-1] - x[0])

    values = straightness_iso230_1(x, z).values

    assert values["LS"].value == pytest.approx(
        widest(z - np.polyval(line, x - x.mean())), abs=1e-6 * ROUNDING + 1e-18
    )
    assert values["EP"].value == pytest.approx(widest(z - chord), abs=1e-18)
    assert values["MZ"].value <= min(values["LS"].value, values["EP"].value) + 1e-18


def test_parabola_has_closed_forms():
    """q x^2 over L: MZ = EP = q L^2 / 4; LS the same, as the line is parallel to the chord."""
    x = np.linspace(0.0, 2.0, 201)
    values = straightness_iso230_1(x, 5 * UM * x**2).values

    for key in ("MZ", "LS", "EP"):
        assert values[key].value == pytest.approx(5 * UM, abs=1e-17)


@pytest.mark.parametrize("reference", ["MZ", "LS", "EP"])
def test_offset_and_slope_are_the_null_space(reference):
    rng = np.random.default_rng(1)
    x = np.linspace(0.0, 0.4, 81)
    z = UM * np.cumsum(rng.normal(size=81))

    plain = straightness_iso230_1(x, z, reference=reference)
    tilted = straightness_iso230_1(x, z + 3 * UM + 50 * UM * x, reference=reference)

    assert plain.reference == reference
    assert plain.value == plain.values[reference].value
    assert tilted.value == pytest.approx(plain.value, abs=1e-18)
    assert tilted.slopes[reference].value - plain.slopes[reference].value == pytest.approx(
        50 * UM, abs=1e-15
    )


def test_residual_keeps_sign_and_gaps():
    x = np.linspace(0.0, 1.0, 11)
    z = np.where(np.arange(11) == 3, 4 * UM, 0.0)
    z[7] = np.nan

    result = straightness_iso230_1(x, z, reference="EP")

    assert result.residual[3] == pytest.approx(4 * UM, abs=1e-18)
    assert np.flatnonzero(np.isnan(result.residual)).tolist() == [7]
    assert any("1 of 11" in m for m in result.messages)


@pytest.mark.parametrize("reference", ["MZ", "LS", "EP"])
def test_uncertainty_is_that_of_repeated_measurements(reference):
    """Distinct extremes, noise far below them: u against 4000 noisy copies (sd of an sd 1.1 %)."""
    rng = np.random.default_rng(2)
    x = np.sort(rng.uniform(size=9))
    z = UM * 5 * np.sin(7 * x)
    sd = 1e-9

    u = straightness_iso230_1(x, z, reference=reference, sd=sd).u
    values = [
        straightness_iso230_1(x, z + sd * rng.normal(size=9), reference=reference).value
        for _ in range(400)
    ]

    assert u == pytest.approx(np.std(values, ddof=1), abs=0.12 * u)  # 3.4 sd of an sd of 400


def noisy_arc(rng, *, sd=5e-9, n=41):
    """A flat arc of 100 nm: many points compete for the touching ones."""
    x = np.linspace(0.0, 0.4, n)
    return x, 100e-9 * (1 - (x / 0.2 - 1) ** 2) + sd * rng.normal(size=n)


def ratios_and_bias(n_trials, truth=100e-9):
    rng = np.random.default_rng(3)
    found = [straightness_iso230_1(*noisy_arc(rng), sd=5e-9) for _ in range(n_trials)]
    out = {}
    for key in ("MZ", "LS", "EP"):
        values = np.array([f.values[key].value for f in found])
        u = np.sqrt(np.mean([f.values[key].u ** 2 for f in found]))
        bias = np.mean([f.bias[key] for f in found])
        out[key] = (u / values.std(ddof=1), bias, values.mean() - truth)
    return out


@pytest.mark.slow
def test_uncertainty_and_bias_where_touching_points_change():
    """300 trials: 4 % standard deviation of the ratio, 0.4 nm of the mean."""
    found = ratios_and_bias(300)

    for key, (ratio, stated, true) in found.items():
        assert 0.88 <= ratio <= 1.13, key
        assert true > 2e-9 or key == "EP"
        assert 0.3 * true - 0.8e-9 <= stated <= true + 0.8e-9, key


@pytest.mark.slow
def test_uncertainty_where_touching_points_change_quickly():
    ratio, bias, _ = ratios_and_bias(60)["MZ"]

    assert 0.72 <= ratio <= 1.28  # 3 sd of an sd of 60
    assert bias > 0.5e-9


def test_bias_of_the_extremes_is_said_where_it_counts():
    x, z = noisy_arc(np.random.default_rng(4))
    three = straightness_iso230_1([0, 0.1, 0.2], [0, UM, 0], sd=1e-9)

    result = straightness_iso230_1(x, z, sd=5e-9)

    assert any("MZ" in m and "too large by about" in m for m in result.messages)
    assert not any("too large" in m for m in three.messages)
    assert result.audit["bias_nm"]["MZ"] == pytest.approx(1e9 * result.bias["MZ"], abs=1e-12)
    assert straightness_iso230_1(x, z, sd=0.0).u == 0.0
    assert np.isnan(straightness_iso230_1(x, z).bias["LS"])


def test_simulation_of_the_minimum_zone_is_that_of_the_exact_one():
    """u of three points by hand: the value is (z0 + z2) / 2 - z1, so u^2 = 1.5 sd^2."""
    u = straightness_iso230_1([0.0, 1.0, 2.0], [0.0, 5 * UM, 0.0], sd=1e-9).u

    assert u == pytest.approx(1.5**0.5 * 1e-9, abs=0.08e-9)  # 3.5 sd of 1000 draws


def test_lower_case_and_masked_samples():
    x, z = np.linspace(0, 1, 11), UM * np.sin(np.arange(11.0))
    wild = z.copy()
    wild[4] = 1.0
    plain = z.copy()
    plain[4] = np.nan

    masked = straightness_iso230_1(x, np.ma.masked_greater(wild, 0.5), reference="mz")

    assert masked.reference == "MZ"
    assert masked.value == straightness_iso230_1(x, plain).value


def through_pickle(result):
    return pickle.loads(pickle.dumps(result))  # noqa: S301 - bytes of its own


@pytest.mark.parametrize("how", [copy.deepcopy, through_pickle])
def test_result_survives_copies_and_gives_json(how):
    x, z = np.linspace(0, 1, 11), UM * np.sin(np.arange(11.0))
    z[2] = np.nan
    result = straightness_iso230_1(x, z)

    again = how(result)
    text = json.dumps(result.to_dict(), allow_nan=False)

    assert json.dumps(again.to_dict(), allow_nan=False) == text
    assert again.residual == pytest.approx(result.residual, abs=0.0, nan_ok=True)
    assert result.to_dict()["values"]["MZ"]["u"] is None


def test_without_sd_there_is_no_uncertainty_and_a_message():
    result = straightness_iso230_1(Profile([0, 1, 2], [0, UM, 0]))

    assert result.u is None
    assert any("sd=" in m for m in result.messages)
    assert result.to_frame().loc["MZ", "straightness_um"] == pytest.approx(1.0, abs=1e-9)
    assert "MZ" in repr(result)


@pytest.mark.parametrize(
    ("arguments", "options", "error", "match"),
    [
        (([0, 1, 2], [0, 1, 0]), {"reference": "MC"}, DataError, "'MZ', 'LS' or 'EP'"),
        (([0, 1, 2], [0, 1, 0]), {"sd": -1.0}, DataError, "sd must be"),
        (([0, 1, 2], [0, 1, 0]), {"sd": "small"}, DataError, "sd"),
        (([0, 1, 2], [0, 1, 0]), {"seed": "a"}, DataError, "seed must be"),
        (([0, 1, 2], [0, 1, 0]), {"reference": 5}, DataError, "'MZ', 'LS' or 'EP'"),
        (([0, 1, 2], ["a", "b", "c"]), {}, InvalidSamplesError, "real numbers"),
        (([0, 1, 2],), {}, DataError, "pass z"),
        ((Profile([0, 1, 2], [0, 1, 0]), [0, 1, 0]), {}, DataError, "leave z out"),
        (([0, 1, 2], [0, 1]), {}, InvalidSamplesError, "has 2"),
        (([0, 1, 1], [0, 1, 0]), {}, InvalidSamplesError, "monotonic"),
        (([0, 1], [0, 1]), {}, TooFewSamplesError, "valid"),
        (([0, 1, 2], [0, np.nan, 0]), {}, TooFewSamplesError, "valid"),
    ],
)
def test_bad_input_is_refused_by_name(arguments, options, error, match):
    with pytest.raises(error, match=match):
        straightness_iso230_1(*arguments, **options)
