"""Monte Carlo after JCGM 101: U03, closed forms, same numbers for any block size, bias."""

from __future__ import annotations

import math

import numpy as np
import pytest

from metrosep.core.errors import DataError, NotUniformError, TooFewSamplesError
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.parameters.budget import Contribution
from metrosep.parameters.noise import CorrelatedNoise, NoiseFromRepeats, WhiteNoise
from metrosep.parameters.propagation import (
    Effect,
    drift_effect,
    monte_carlo,
    nonlinearity_effect,
    scale_effect,
    shortest_interval,
)

A = 50e-9
X = np.arange(500) * 1e-6
WAVE = Profile(X, A * np.cos(2 * np.pi * np.arange(500) / 100))  # G2, first 500 points
NOISE = WhiteNoise(2e-9)
ROUNDING = 1e-12  # relative
STANDARD_ERRORS = 5.0  # of a Monte Carlo mean or deviation


def u_of_u(result) -> float:
    return result.u / math.sqrt(2 * result.draws.size)


def test_u03_peak_to_valley_of_g2_is_107_87_nm_and_the_bias_is_reported():
    """Acceptance row U03: 107.87 nm within 0.1 nm against 100 nm."""
    result = monte_carlo("PV", WAVE, noise=NOISE, draws=20_000)

    assert result.value == pytest.approx(100e-9, rel=ROUNDING, abs=0.0)
    assert result.mean == pytest.approx(107.87e-9, abs=0.1e-9)
    assert result.bias == pytest.approx(7.87e-9, abs=0.1e-9)
    assert result.u_bias == pytest.approx(result.u / math.sqrt(20_000), rel=ROUNDING, abs=0.0)
    assert result.u == pytest.approx(1.4e-9, abs=0.1e-9)  # specification, section 5
    assert result.interval[0] > result.value
    assert any("extreme" in note for note in result.notes)
    assert any("noise alone" in note for note in result.notes)


@pytest.mark.parametrize(("n", "expected"), [(100, 5.015187), (1000, 6.482872)])
def test_peak_to_valley_of_pure_noise(n, expected):
    """d2 of control charts (Tippett 1925); for 1000 twice the expected maximum, 3.241436."""
    flat = Profile(np.arange(n) * 1e-6, np.zeros(n))

    result = monte_carlo("PV", flat, noise=WhiteNoise(1e-9), draws=5000)

    assert result.mean == pytest.approx(expected * 1e-9, abs=STANDARD_ERRORS * result.u_bias)


def test_rq_inflates_by_the_noise_and_not_more():
    """Row: Rq becomes sqrt(Rq^2 + sigma^2)."""
    result = monte_carlo("Rq", WAVE, noise=NOISE, draws=5000)

    expected = math.sqrt(A**2 / 2 + (2e-9) ** 2)
    assert result.mean == pytest.approx(expected, abs=STANDARD_ERRORS * result.u_bias)
    assert result.u == pytest.approx(2e-9 / math.sqrt(500), abs=STANDARD_ERRORS * u_of_u(result))


def test_the_mean_of_white_noise_has_u_over_root_n_and_no_bias():
    result = monte_carlo("mean", WAVE, noise=NOISE, draws=5000)

    assert result.u == pytest.approx(2e-9 / math.sqrt(500), abs=STANDARD_ERRORS * u_of_u(result))
    assert abs(result.bias) < STANDARD_ERRORS * result.u_bias
    assert result.notes == ()
    assert result.interval[1] - result.interval[0] == pytest.approx(
        2 * 1.96 * result.u, rel=0.05, abs=0.0
    )


def test_correlated_noise_scatters_sq_far_more_than_white():
    z = np.add.outer(WAVE.z[:60], WAVE.z[:60])
    surface = Surface(z, 1e-6, 1e-6)

    white = monte_carlo("Sq", surface, noise=NOISE, draws=400)
    correlated = monte_carlo("Sq", surface, noise=CorrelatedNoise(2e-9, 10e-6), draws=400)

    assert correlated.u > 5.0 * white.u


@pytest.mark.parametrize("name", ["PV", "Rq", "Sku", "Ra"])
@pytest.mark.parametrize(
    "noise",
    [NOISE, CorrelatedNoise(2e-9, 5e-6), NoiseFromRepeats([WAVE, Profile(X, -WAVE.z)])],
    ids=["white", "correlated", "repeats"],
)
def test_same_seed_same_numbers_for_any_block_size(name, noise):
    def run(max_bytes: int) -> np.ndarray:
        effects = [scale_effect(1e-3), drift_effect(1e-9)]
        return monte_carlo(
            name, WAVE, noise=noise, effects=effects, draws=150, seed=7, max_bytes=max_bytes
        ).draws

    whole = run(16_000_000)

    assert np.array_equal(whole, run(1))
    assert np.array_equal(whole, run(100_000))
    other = monte_carlo(name, WAVE, noise=NOISE, draws=150, seed=8).draws
    assert not np.array_equal(whole, other)


def test_a_longer_run_begins_with_the_shorter_one():
    short = monte_carlo("PV", WAVE, noise=NOISE, draws=100).draws

    assert np.array_equal(short, monte_carlo("PV", WAVE, noise=NOISE, draws=300).draws[:100])


def test_a_function_gives_the_numbers_of_the_name():
    named = monte_carlo("PV", WAVE, noise=NOISE, draws=200)

    by_function = monte_carlo(lambda p: p.peak_to_valley(), WAVE, noise=NOISE, draws=200)

    assert np.array_equal(named.draws, by_function.draws)
    assert by_function.notes[0].startswith("the parameter is not linear")


def test_a_function_may_level_and_sees_positions():
    tilted = Profile(X, WAVE.z + 1e-3 * X)

    result = monte_carlo(lambda p: p.remove_line().rms(), tilted, noise=NOISE, draws=200)

    assert result.value == pytest.approx(WAVE.remove_line().rms(), rel=1e-6, abs=0.0)


def test_missing_points_are_like_cropped_rows_and_stay_missing():
    z = np.add.outer(WAVE.z[:20], WAVE.z[:30])
    holed = z.copy()
    holed[15:] = np.nan
    seen: list[int] = []

    def count(surface: Surface) -> float:
        seen.append(surface.n_invalid)
        return surface.rms()

    a = monte_carlo("Sq", Surface(holed, 1e-6, 1e-6), noise=NOISE, draws=1000)
    b = monte_carlo("Sq", Surface(z[:15], 1e-6, 1e-6), noise=NOISE, draws=1000)
    monte_carlo(count, Surface(holed, 1e-6, 1e-6), noise=NOISE, draws=20)

    assert a.value == pytest.approx(b.value, rel=ROUNDING, abs=0.0)
    assert a.mean == pytest.approx(b.mean, abs=STANDARD_ERRORS * math.hypot(a.u_bias, b.u_bias))
    assert a.u == pytest.approx(b.u, rel=0.2, abs=0.0)
    assert set(seen) == {5 * 30}


@pytest.mark.parametrize("unit", [1e-9, 1e9])
@pytest.mark.parametrize(("name", "degree"), [("PV", 1), ("Sq", 1), ("Sa", 1), ("Ssk", 0)])
def test_units_do_not_matter(name, degree, unit):
    skew = Profile(X, WAVE.z + 1e-9 * (np.arange(500) % 7 == 0))
    plain = monte_carlo(name, skew, noise=NOISE, draws=100)

    scaled = monte_carlo(name, Profile(X, skew.z * unit), noise=WhiteNoise(2e-9 * unit), draws=100)

    factor = unit**degree
    np.testing.assert_allclose(scaled.draws, plain.draws * factor, rtol=1e-9)


def test_centring_follows_the_family_unless_told():
    shifted = Profile(X, WAVE.z + 1e-6)

    value = {
        key: monte_carlo(name, shifted, noise=NOISE, draws=50, centre=centre).value
        for key, name, centre in [("R", "Rq", None), ("c", "Rq", True), ("S", "Sq", None)]
    }

    assert value["R"] == pytest.approx(math.hypot(1e-6, A / math.sqrt(2)), rel=1e-9, abs=0.0)
    assert value["c"] == value["S"] == pytest.approx(A / math.sqrt(2), rel=1e-9, abs=0.0)


def test_names_are_the_textbook_moments():
    """P08: G4 has Ra .18, Rq .3, Rsk 8/3, Rku 73/9 about its mean."""
    comb = Profile(np.arange(1000) * 1e-6, (np.arange(1000) % 100 < 10) * 1e-6)

    for name, expected in [("Ra", 0.18e-6), ("Rq", 0.3e-6), ("Rsk", 8 / 3), ("Rku", 73 / 9)]:
        found = monte_carlo(name, comb, noise=WhiteNoise(0.0), draws=50, centre=True)
        assert found.value == pytest.approx(expected, rel=1e-9, abs=0.0)
        assert found.u <= ROUNDING * expected
    for name, expected in [("Sp", 0.9e-6), ("Sv", 0.1e-6), ("Sz", 1e-6)]:
        found = monte_carlo(name, comb, noise=WhiteNoise(0.0), draws=50)
        assert found.value == pytest.approx(expected, rel=1e-9, abs=0.0)


# --- effects -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("distribution", "divisor"),
    [("normal", 1.0), ("rectangular", 3**0.5), ("triangular", 6**0.5), ("arcsine", 2**0.5)],
)
def test_a_scale_effect_adds_its_share_of_the_value(distribution, divisor):
    effects = [scale_effect(1e-3, distribution=distribution)]

    result = monte_carlo("PV", WAVE, effects=effects, draws=20_000)

    assert result.u == pytest.approx(100e-9 * 1e-3 / divisor, rel=0.03, abs=0.0)
    assert abs(result.bias) < STANDARD_ERRORS * result.u_bias
    if distribution != "normal":
        assert np.abs(result.draws - 100e-9).max() <= 100e-9 * 1e-3 * (1 + 1e-6)


def test_effect_distributions_have_their_shape():
    rng = np.random.default_rng(3)
    fourth = {"normal": 3.0, "rectangular": 1.8, "triangular": 2.4, "arcsine": 1.5}
    for distribution, kurtosis in fourth.items():
        drawn = Effect(Contribution("e", 1.0, distribution), lambda z: z).draw(rng, 100_000)
        assert (drawn**4).mean() / (drawn**2).mean() ** 2 == pytest.approx(
            kurtosis, rel=0.04, abs=0.0
        )
        assert drawn.mean() == pytest.approx(0.0, abs=0.02)


def test_a_line_with_few_degrees_of_freedom_is_drawn_from_student():
    drawn = Effect(Contribution("e", 1.0, dof=6), lambda z: z).draw(
        np.random.default_rng(4), 100_000
    )

    assert drawn.var() == pytest.approx(6 / 4, rel=0.05, abs=0.0)  # variance of t: dof / (dof - 2)


def test_drift_and_noise_add_in_squares_for_the_mean_slope():
    flat = Profile(X, np.zeros(500))

    def rise(p: Profile) -> float:
        x = p.x - p.x.mean()
        return float(x @ p.z / (x @ x) * (X[-1] - X[0]))

    result = monte_carlo(
        rise, flat, noise=NOISE, effects=[drift_effect(1e-9, distribution="normal")], draws=1500
    )

    by_noise = 2e-9 * math.sqrt(12 / 500)
    assert result.u == pytest.approx(math.hypot(1e-9, by_noise), rel=0.1, abs=0.0)


def test_drift_vanishes_where_a_line_is_removed():
    result = monte_carlo(
        lambda p: p.remove_line().rms(), WAVE, effects=[drift_effect(100e-9)], draws=50
    )

    assert result.u < 1e-9 * result.value


def test_a_quadratic_sensor_error_acts_as_its_algebra_says():
    ramp = Profile(X, np.linspace(-1e-6, 1e-6, 500))

    result = monte_carlo("mean", ramp, effects=[nonlinearity_effect(3e-9)], draws=5000)

    by_hand = 3e-9 / math.sqrt(3) * float((np.linspace(-1, 1, 500) ** 2).mean())
    assert result.u == pytest.approx(by_hand, rel=0.05, abs=0.0)


# --- interval and adaptive ------------------------------------------------------------------


def test_the_shortest_interval_of_a_skewed_sample_starts_at_its_end():
    drawn = -np.log(np.random.default_rng(5).random(200_000))  # exponential: 0 ... -ln(0.05)

    low, high = shortest_interval(drawn, 0.95)

    assert low == pytest.approx(0.0, abs=0.01)
    assert high == pytest.approx(-math.log(0.05), rel=0.02, abs=0.0)


def test_an_adaptive_run_stops_when_two_digits_are_stable():
    small = Profile(np.arange(4) * 1e-6, [0, 0, 0, 0])

    result = monte_carlo("mean", small, noise=WhiteNoise(6e-9), adaptive=True)

    assert result.stable is True
    assert result.draws.size % 10_000 == 0
    assert result.u == pytest.approx(3e-9, abs=0.05e-9)
    assert result.interval[1] == pytest.approx(1.959964 * 3e-9, abs=0.1e-9)


def test_an_adaptive_run_that_may_not_go_on_says_so():
    small = Profile(np.arange(4) * 1e-6, [0, 0, 0, 0])

    result = monte_carlo(
        "mean", small, noise=WhiteNoise(19e-9), adaptive=True, max_draws=20_000
    )  # u 9.5 nm: half a unit of the second digit is 0.5 % of it

    assert result.stable is False
    assert "not stable" in result.notes[0]


def test_a_result_becomes_a_quantity_and_a_line():
    result = monte_carlo("PV", WAVE, noise=NOISE, draws=200)

    assert result.to_quantity("m", "peak to valley", symbol="PV").u == result.u
    assert "200 draws" in repr(result)
    assert not result.draws.flags.writeable


def test_the_object_is_not_touched():
    before = WAVE.z.copy()

    monte_carlo("Sku", WAVE, noise=NOISE, effects=[scale_effect(0.1)], draws=20)

    assert np.array_equal(WAVE.z, before)


# --- bad input ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "error", "match"),
    [
        ({"noise": None}, DataError, "noise= or at least one effect"),
        ({"draws": 1}, TooFewSamplesError, "2 draws"),
        ({"draws": 5}, TooFewSamplesError, "resolve"),
        ({"coverage": 1.0, "draws": 10}, DataError, "coverage"),
        ({"adaptive": True, "max_draws": 10}, DataError, "max_draws"),
    ],
)
def test_bad_options_raise(options, error, match):
    with pytest.raises(error, match=match):
        monte_carlo("PV", WAVE, **{"noise": NOISE, **options})


def test_bad_evaluations_raise():
    with pytest.raises(DataError, match="not offered as"):
        monte_carlo("Rmax", WAVE, noise=NOISE)
    with pytest.raises(DataError, match="NaN"):
        monte_carlo(lambda _: math.nan, WAVE, noise=NOISE)
    with pytest.raises(DataError, match="constant"):
        monte_carlo("Ssk", Profile(X, np.ones(500)), noise=NOISE)


def test_objects_without_heights_raise():
    with pytest.raises(TooFewSamplesError, match="valid"):
        monte_carlo("PV", Profile(X, np.full(500, np.nan)), noise=NOISE)
    with pytest.raises(TooFewSamplesError, match="valid"):
        monte_carlo("PV", Profile([0.0], [1e-9]), noise=NOISE)
    with pytest.raises(NotUniformError, match="dx and dy"):
        monte_carlo("Sq", Surface(np.eye(3)), noise=CorrelatedNoise(1e-9, 1e-6))


def test_bad_effects_raise():
    with pytest.raises(DataError, match="axis 1"):
        monte_carlo("PV", WAVE, effects=[drift_effect(1e-9, axis=1)])
    bad = Effect(Contribution("mine", 1.0), lambda z: z[:-1])
    with pytest.raises(DataError, match="mine"):
        monte_carlo("PV", WAVE, effects=[bad])
    with pytest.raises(DataError, match="value"):
        scale_effect(-1.0)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"draws": 2.5}, "draws"),
        ({"draws": "a"}, "draws"),
        ({"draws": True}, "draws"),
        ({"seed": "a"}, "seed"),
        ({"seed": -1}, "seed"),
        ({"seed": 1.5}, "seed"),
        ({"noise": 2e-9}, r"noise.*WhiteNoise\(2e-09\)"),
        ({"noise": "white"}, "noise"),
        ({"effects": [2e-9]}, "effect"),
        ({"effects": 2e-9}, "effect"),
        ({"coverage": "a"}, "coverage"),
        ({"max_draws": 2.5}, "max_draws"),
        ({"max_bytes": "a"}, "max_bytes"),
    ],
)
def test_arguments_of_the_wrong_type_are_refused(options, match):
    with pytest.raises(DataError, match=match):
        monte_carlo("PV", WAVE, **{"noise": NOISE, "draws": 100, **options})


@pytest.mark.parametrize("obj", [WAVE.z, None])
def test_what_is_no_profile_and_no_surface_is_refused(obj):
    with pytest.raises(DataError, match="needs a Profile or Surface"):
        monte_carlo("PV", obj, noise=NOISE, draws=100)


def test_numbers_of_numpy_are_taken():
    one = monte_carlo("PV", WAVE, noise=NOISE, draws=np.int64(100), seed=np.uint8(0))

    assert one.draws.size == 100
