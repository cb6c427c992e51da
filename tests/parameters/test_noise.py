"""Noise models: variance, autocorrelation, independence of ends and of block size; repeats."""

from __future__ import annotations

import math

import numpy as np
import pytest

from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotUniformError,
    TooFewSamplesError,
)
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.parameters.noise import (
    CorrelatedNoise,
    NoiseFromPsd,
    NoiseFromRepeats,
    Sampling,
    WhiteNoise,
    mean_of_repeats,
    noise_of_repeats,
    stack_repeats,
)
from metrosep.parameters.repeats import from_repeats, noise_free_rms, type_a

SIGMA = 2e-9
DRAWS = 4000
SCATTER = 5.0 / math.sqrt(DRAWS)  # five standard errors of a correlation from DRAWS fields
ROUNDING = 1e-12  # relative, of sums of some thousand terms


def line(n: int = 64, step: float = 1e-6, z: float = 0.0) -> Profile:
    return Profile(np.arange(n) * step, np.full(n, z))


def correlation(fields: np.ndarray, a: tuple[int, ...], b: tuple[int, ...]) -> float:
    return float((fields[(slice(None), *a)] * fields[(slice(None), *b)]).mean()) / SIGMA**2


def test_white_noise_has_its_variance_and_no_correlation():
    fields = WhiteNoise(SIGMA).draw(line(), np.random.default_rng(1), DRAWS)

    assert fields.shape == (DRAWS, 64)
    assert correlation(fields, (5,), (5,)) == pytest.approx(1.0, abs=2 * SCATTER)
    assert correlation(fields, (5,), (6,)) == pytest.approx(0.0, abs=SCATTER)
    assert fields.mean() == pytest.approx(0.0, abs=5 * SIGMA / math.sqrt(fields.size))


@pytest.mark.parametrize("lag", [0, 2, 5, 10, 63])
def test_correlated_noise_follows_the_gaussian_acf_and_the_ends_are_strangers(lag):
    fields = CorrelatedNoise(SIGMA, 5e-6).draw(line(), np.random.default_rng(2), DRAWS)

    expected = math.exp(-((lag / 5.0) ** 2))

    assert correlation(fields, (0,), (lag,)) == pytest.approx(expected, abs=1.5 * SCATTER)


def test_areal_correlation_is_the_same_in_metres_along_both_axes():
    surface = Surface(np.zeros((12, 20)), dx=1e-6, dy=2e-6)

    fields = CorrelatedNoise(SIGMA, 5e-6).draw(surface, np.random.default_rng(3), DRAWS)

    along_x, along_y = (correlation(fields, (3, 3), p) for p in ((3, 7), (5, 3)))
    assert along_x == pytest.approx(math.exp(-16.0 / 25.0), abs=SCATTER)
    assert along_y == pytest.approx(math.exp(-16.0 / 25.0), abs=SCATTER)
    assert correlation(fields, (0, 0), (11, 19)) == pytest.approx(0.0, abs=SCATTER)


@pytest.mark.parametrize("length", [0.2e-6, 5e-6, 60e-6, 1e-3])
def test_autocovariance_of_correlated_noise_is_exact_for_any_length(length):
    covariance = CorrelatedNoise(SIGMA, length).autocovariance(line())[:64]

    expected = SIGMA**2 * np.exp(-((np.arange(64) * 1e-6 / length) ** 2))

    np.testing.assert_allclose(covariance, expected, rtol=0, atol=ROUNDING * SIGMA**2)


def test_white_autocovariance_is_an_impulse():
    covariance = WhiteNoise(SIGMA).autocovariance(Sampling((7, 9), (None, None)))

    assert covariance.flat[0] == pytest.approx(SIGMA**2, rel=ROUNDING, abs=0.0)
    assert np.abs(covariance.flat[1:]).max() < ROUNDING * SIGMA**2


def test_noise_from_psd_integrates_to_the_variance_and_has_the_transform_as_acf():
    top, density = 1e5, 4e-23  # a band 0 ... 0.1 / um of a profile of step 1 um: sigma 2 nm
    noise = NoiseFromPsd([0.0, top], [density, density])

    covariance = noise.autocovariance(line(512))

    lags = np.arange(100) * 1e-6
    assert covariance[0] == pytest.approx(density * top, rel=ROUNDING, abs=0.0)
    # The torus has 1024 points, so its ACF is that of a comb of frequencies: 1 % near its end.
    np.testing.assert_allclose(
        covariance[:100], density * top * np.sinc(2 * top * lags), rtol=0, atol=0.01 * SIGMA**2
    )
    fields = noise.draw(line(512), np.random.default_rng(4), 500)
    assert float(np.square(fields).mean()) == pytest.approx(density * top, rel=0.02, abs=0.0)


def test_a_falling_spectrum_keeps_its_variance_with_few_points():
    noise = NoiseFromPsd([1e3, 2e3, 5e3], [3e-22, 1e-22, 0.0])

    variance = noise.autocovariance(line(50, 2e-6)).flat[0]

    by_hand = 3e-22 * 1e3 + 0.5 * 4e-22 * 1e3 + 0.5 * 1e-22 * 3e3
    assert variance == pytest.approx(by_hand, rel=ROUNDING, abs=0.0)


def test_areal_psd_integrates_over_the_plane():
    top, density = 1e5, 1e-28  # a disc of radius 0.1 / um: pi top^2 density
    noise = NoiseFromPsd([0.0, top], [density, density])

    variance = noise.autocovariance(Surface(np.zeros((128, 128)), dx=1e-6, dy=1e-6)).flat[0]

    assert variance == pytest.approx(
        math.pi * top**2 * density, rel=0.01, abs=0.0
    )  # 256 cells across


@pytest.mark.parametrize(
    "noise",
    [
        WhiteNoise(SIGMA),
        CorrelatedNoise(SIGMA, 5e-6),
        NoiseFromPsd([0.0, 1e5], [4e-23, 1e-23]),
        NoiseFromRepeats([line(z=1e-9), Profile(line().x, np.arange(64) * 1e-10)]),
        NoiseFromRepeats([line(), Profile(line().x, np.arange(64) * 1e-10)], method="combine"),
    ],
    ids=["white", "correlated", "psd", "shift", "combine"],
)
def test_fields_do_not_depend_on_how_many_are_drawn_at_once(noise):
    whole = noise.draw(line(), np.random.default_rng(5), 7)
    rng = np.random.default_rng(5)
    parts = np.concatenate([noise.draw(line(), rng, k) for k in (1, 4, 2)])

    assert np.array_equal(whole, parts)


# --- repeats -------------------------------------------------------------------------------


def repeats(n: int, points: int = 2000, *, sigma: float = SIGMA, seed: int = 6) -> list[Profile]:
    rng = np.random.default_rng(seed)
    x = np.arange(points) * 1e-6
    truth = 10e-9 * np.cos(2 * np.pi * np.arange(points) / 100)
    return [Profile(x, truth + sigma * rng.standard_normal(points)) for _ in range(n)]


@pytest.mark.parametrize("method", ["shift", "combine"])
@pytest.mark.parametrize("count", [2, 5])
def test_noise_from_repeats_has_the_variance_of_one_repeat(method, count):
    noise = NoiseFromRepeats(repeats(count), method=method)

    fields = noise.draw((2000,), np.random.default_rng(7), 1000)

    spread = 0.15 if method == "combine" and count == 2 else 0.04  # one pattern, one weight
    assert float(fields.std()) == pytest.approx(SIGMA, rel=spread, abs=0.0)


def test_combined_noise_stays_where_it_was():
    rng = np.random.default_rng(8)
    x = np.arange(400) * 1e-6
    objects = [
        Profile(x, np.where(np.arange(400) < 200, 1e-9 * rng.standard_normal(400), 0.0))
        for _ in range(6)
    ]

    noise = NoiseFromRepeats(objects, method="combine", remove_mean=False)
    fields = noise.draw((400,), np.random.default_rng(9), 500)

    assert np.abs(fields[:, 200:]).max() == 0.0
    assert float(fields[:, :200].std()) == pytest.approx(1e-9, rel=0.1, abs=0.0)


def test_noise_of_repeats_gives_sigma_and_white_effective_number():
    estimate = noise_of_repeats(repeats(5))

    assert estimate.sigma == pytest.approx(SIGMA, rel=5 / math.sqrt(2 * 4 * 2000), abs=0.0)
    assert estimate.map.shape == (2000,)
    assert estimate.n_effective == pytest.approx(2000, rel=0.05, abs=0.0)
    assert estimate.lengths[0] is not None
    assert estimate.lengths[0] < 1.0


def test_noise_of_repeats_finds_the_correlation_length_per_axis():
    surface = Surface(np.zeros((120, 150)), dx=1e-6, dy=2e-6)
    fields = CorrelatedNoise(SIGMA, 6e-6).draw(surface, np.random.default_rng(10), 4)

    estimate = noise_of_repeats([Surface(f, 1e-6, 2e-6) for f in fields])

    assert estimate.lengths == pytest.approx((3.0, 6.0), rel=0.1, abs=0.0)
    independent = 120 * 150 / (math.pi / 2 * 18.0)  # sum of exp(-2 d^2/l^2) over all lags
    assert estimate.n_effective == pytest.approx(independent, rel=0.15, abs=0.0)


def test_a_shift_of_a_whole_repeat_is_drift_and_not_noise():
    a = repeats(2)
    shifted = Profile(a[1].x, a[1].z + 1e-6)

    assert noise_of_repeats([a[0], shifted]).sigma == pytest.approx(
        noise_of_repeats(a).sigma, rel=1e-9, abs=0.0
    )
    assert noise_of_repeats([a[0], shifted], remove_mean=False).sigma > 100 * SIGMA


def test_only_points_valid_in_all_repeats_count():
    a, b = repeats(2)
    z = a.z.copy()
    z[100:300] = np.nan
    holed = Profile(a.x, z)
    cropped = [Profile(o.x[300:], o.z[300:]) for o in (a, b)]
    beginning = np.r_[np.full(300, np.nan), b.z[300:]]

    estimate = noise_of_repeats([holed, Profile(b.x, beginning)])

    assert estimate.n_points == 1700
    assert np.isnan(estimate.map[:300]).all()
    assert estimate.sigma == pytest.approx(noise_of_repeats(cropped).sigma, rel=ROUNDING, abs=0.0)
    assert noise_free_rms([holed, Profile(b.x, beginning)]).rms == pytest.approx(
        noise_free_rms(cropped).rms, rel=ROUNDING, abs=0.0
    )


def test_type_a_of_a_textbook_series():
    """Values 1 ... 5: s^2 = 2.5, u = s / sqrt 5 (JCGM 100, 4.2)."""
    result = type_a([1, 2, 3, 4, 5])

    assert (result.mean, result.dof) == (3.0, 4)
    assert result.s == pytest.approx(math.sqrt(2.5), rel=ROUNDING, abs=0.0)
    assert result.u == pytest.approx(math.sqrt(0.5), rel=ROUNDING, abs=0.0)
    assert result.coverage_factor(0.95) == pytest.approx(2.776, abs=5e-4)  # Student, 4
    assert result.to_quantity("m", "Rq").u == result.u


def test_u_of_the_mean_shrinks_with_the_root_of_the_repeats():
    values = np.random.default_rng(11).standard_normal(4000)

    assert type_a(values).u == pytest.approx(type_a(values[:1000]).u / 2.0, rel=0.1, abs=0.0)


def test_from_repeats_shows_what_averaging_removes():
    objects = repeats(8)

    result = from_repeats(objects, "Rq")

    truth = 10e-9 / math.sqrt(2.0)
    assert result.type_a.mean == pytest.approx(math.hypot(truth, SIGMA), rel=0.01, abs=0.0)
    assert result.value_of_mean == pytest.approx(
        math.hypot(truth, SIGMA / math.sqrt(8)), rel=0.01, abs=0.0
    )
    assert result.inflation == pytest.approx(
        result.type_a.mean - result.value_of_mean, rel=1e-9, abs=0.0
    )
    by_function = from_repeats(objects, lambda p: float(np.sqrt(np.square(p.z).mean())))
    np.testing.assert_allclose(by_function.values, result.values, rtol=ROUNDING)


def test_the_mean_of_repeats_keeps_positions_and_says_so():
    mean = mean_of_repeats(repeats(3))

    assert mean.history[-1].name == "mean_of_repeats"
    assert mean.z[7] == pytest.approx(np.mean([o.z[7] for o in repeats(3)]), rel=ROUNDING, abs=0.0)


@pytest.mark.parametrize("sigma", [1e-9, 5e-9])
def test_noise_free_rms_of_two_repeats_is_unbiased_with_a_true_uncertainty(sigma):
    truth = 10e-9 / math.sqrt(2.0)

    found = [noise_free_rms(repeats(2, 500, sigma=sigma, seed=s)) for s in range(200)]

    values = np.array([f.rms for f in found])
    claimed = math.sqrt(np.mean([f.u**2 for f in found]))
    assert values.mean() == pytest.approx(truth, abs=4 * values.std() / math.sqrt(200))
    assert np.mean([f.raw for f in found]) == pytest.approx(
        math.hypot(truth, sigma), rel=0.01, abs=0.0
    )
    assert claimed == pytest.approx(values.std(), rel=0.2, abs=0.0)  # 200 of one freedom


def test_noise_free_rms_of_noise_alone_is_zero_within_its_uncertainty():
    rng = np.random.default_rng(12)
    found = [
        noise_free_rms([Profile(line(900).x, SIGMA * rng.standard_normal(900)) for _ in range(3)])
        for _ in range(150)
    ]

    squares = np.array([f.mean_square for f in found])
    claimed = math.sqrt(np.mean([f.u_mean_square**2 for f in found]))
    assert abs(squares.mean()) < 4 * squares.std() / math.sqrt(150)
    assert squares.std() <= claimed * 1.1
    assert claimed < 2.0 * squares.std()
    assert min(f.rms for f in found) == 0.0


@pytest.mark.parametrize("factor", [1e-9, 1e9])
def test_repeat_results_do_not_depend_on_the_unit(factor):
    objects = repeats(3)
    scaled = [Profile(o.x, o.z * factor) for o in objects]

    a, b = noise_free_rms(objects), noise_free_rms(scaled)

    assert b.rms == pytest.approx(a.rms * factor, rel=ROUNDING, abs=0.0)
    assert b.u == pytest.approx(a.u * factor, rel=1e-9, abs=0.0)
    assert noise_of_repeats(scaled).sigma == pytest.approx(
        noise_of_repeats(objects).sigma * factor, rel=1e-9, abs=0.0
    )


def test_equal_repeats_have_no_noise_and_the_plain_rms():
    one = repeats(1)[0]

    result = noise_free_rms([one, one])

    assert result.rms == pytest.approx(float(one.z.std()), rel=1e-9, abs=0.0)
    assert (result.u, result.sigma) == (0.0, 0.0)


# --- bad input -----------------------------------------------------------------------------


@pytest.mark.parametrize("sigma", [-1.0, math.nan, math.inf])
def test_an_impossible_sigma_raises(sigma):
    with pytest.raises(DataError, match="sigma must be"):
        WhiteNoise(sigma)
    with pytest.raises(DataError, match="sigma must be"):
        CorrelatedNoise(sigma, 1e-6)


def test_a_correlation_length_must_be_positive():
    with pytest.raises(DataError, match="correlation_length must be"):
        CorrelatedNoise(1e-9, 0.0)


def test_correlated_noise_needs_uniform_known_steps():
    rng = np.random.default_rng(0)
    with pytest.raises(NotUniformError, match="resample"):
        CorrelatedNoise(1e-9, 1e-6).draw(Profile([0, 1e-6, 5e-6], [0, 0, 0]), rng)
    with pytest.raises(NotUniformError, match="dx and dy"):
        CorrelatedNoise(1e-9, 1e-6).draw(Surface(np.zeros((3, 3)), dx=1e-6), rng)
    with pytest.raises(DataError, match="a whole number from 1"):
        WhiteNoise(1e-9).draw((3,), rng, 0)


@pytest.mark.parametrize(
    ("frequency", "density", "match"),
    [
        ([], [], "equally long"),
        ([1.0, 2.0], [1.0], "equally long"),
        ([2.0, 1.0], [1.0, 1.0], "rise"),
        ([1.0, 2.0], [1.0, -1.0], "negative"),
        ([1.0, math.nan], [1.0, 1.0], "finite"),
    ],
)
def test_a_bad_spectrum_raises(frequency, density, match):
    with pytest.raises(InvalidSamplesError, match=match):
        NoiseFromPsd(frequency, density)


def test_repeats_that_do_not_match_raise():
    a = line()
    with pytest.raises(TooFewSamplesError, match="2 repeats"):
        stack_repeats([a])
    with pytest.raises(InvalidSamplesError, match="repeat 1"):
        stack_repeats([a, line(63)])
    with pytest.raises(InvalidSamplesError, match="repeat 1"):
        stack_repeats([a, Surface(np.zeros((8, 8)))])
    with pytest.raises(InvalidSamplesError, match="repeat 1"):
        stack_repeats([Surface(np.zeros((8, 8)), 1e-6), Surface(np.zeros((8, 8)), 2e-6)])
    with pytest.raises(TooFewSamplesError, match="0 point"):
        stack_repeats([a, Profile(a.x, np.full(64, np.nan))])


def test_type_a_of_one_or_of_nan_raises():
    with pytest.raises(TooFewSamplesError, match="at least 2"):
        type_a([1.0])
    with pytest.raises(InvalidSamplesError, match="repeat 1"):
        type_a([1.0, math.nan])
    with pytest.raises(InvalidSamplesError, match="list"):
        type_a([[1.0, 2.0]])


def test_shifting_gaps_is_refused_and_combining_them_is_not():
    z = np.zeros(64)
    z[3] = np.nan
    objects = [line(), Profile(line().x, z)]
    with pytest.raises(DataError, match="combine"):
        NoiseFromRepeats(objects)
    with pytest.raises(DataError, match="method"):
        NoiseFromRepeats(objects, method="block")
    fields = NoiseFromRepeats(objects, method="combine").draw((64,), np.random.default_rng(0))
    assert np.isfinite(fields).all()
    with pytest.raises(DataError, match="shape"):
        NoiseFromRepeats(objects, method="combine").draw((63,), np.random.default_rng(0))


def test_an_unknown_name_or_a_nan_result_raises():
    with pytest.raises(DataError, match="not one of"):
        from_repeats(repeats(2), "Rmax")
    with pytest.raises(DataError, match="NaN"):
        from_repeats(repeats(2), lambda _: math.nan)
