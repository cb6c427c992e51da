"""Closed forms of the influence of noise, against algebra, tables and Monte Carlo."""

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
from metrosep.parameters.noise import CorrelatedNoise, NoiseFromPsd, WhiteNoise
from metrosep.parameters.propagation import monte_carlo
from metrosep.parameters.uncertainty import (
    effective_number,
    expected_range,
    linear_uncertainty,
    noise_influence,
    scale_uncertainty,
)

N = 400
X = np.arange(N) * 1e-6
A = 10e-9
WAVE = Profile(X, A * np.cos(2 * np.pi * np.arange(N) / 100 + 0.3))
FLAT = Profile(X, np.zeros(N))
WHITE = WhiteNoise(3e-9)
SHARED = CorrelatedNoise(3e-9, 4e-6)
ROUNDING = 1e-10  # relative, of FFTs of some thousand points
STANDARD_ERRORS = 5.0


def dense(noise, obj) -> np.ndarray:
    """Return the covariance matrix of the valid points of a profile, element by element."""
    lag = np.abs(np.subtract.outer(np.arange(len(obj)), np.arange(len(obj))))
    valid = ~np.isnan(obj.z)
    return noise.autocovariance(obj)[lag][np.ix_(valid, valid)]


@pytest.mark.parametrize(
    ("n", "tabulated"),
    [(2, 1.128379), (5, 2.325929), (10, 3.077505), (25, 3.930629), (100, 5.015187)],
)
def test_expected_range_is_d2_of_the_control_chart_tables(n, tabulated):
    """d2 as printed in ISO 7870-2 and Tippett 1925; 2 / sqrt(pi) for n = 2."""
    assert expected_range(n) == pytest.approx(tabulated, abs=5e-6)


@pytest.mark.parametrize(("n", "drawn"), [(100, 5.02), (1000, 6.48), (10_000, 7.70)])
def test_expected_range_is_that_of_drawn_noise(n, drawn):
    found = np.random.default_rng(1).standard_normal((300, n))
    spread = found.max(axis=1) - found.min(axis=1)

    assert expected_range(n) == pytest.approx(drawn, abs=0.005)
    assert expected_range(n) == pytest.approx(
        float(spread.mean()), abs=STANDARD_ERRORS * float(spread.std()) / math.sqrt(300)
    )


def test_expected_range_of_two_is_exact_and_grows_without_end():
    assert expected_range(2) == pytest.approx(2 / math.sqrt(math.pi), rel=1e-12, abs=0.0)
    assert expected_range(3) == pytest.approx(3 / math.sqrt(math.pi), rel=1e-12, abs=0.0)
    big = [expected_range(10**k) for k in (6, 9, 15)]
    assert big == sorted(big)
    # Asymptote of the largest of n values (Cramer): sqrt(2 L) - (ln L + ln 4 pi - 2 g) / (8 L)^.5
    L = math.log(1e15)
    edge = math.sqrt(2 * L) - (math.log(L) + math.log(4 * math.pi) - 2 * 0.577216) / math.sqrt(
        8 * L
    )
    assert big[-1] == pytest.approx(2 * edge, rel=0.01, abs=0.0)


@pytest.mark.parametrize("name", ["Rq", "RMS", "Sq", "Ra", "Sa"])
@pytest.mark.parametrize("obj", [WAVE, FLAT], ids=["wave", "flat"])
@pytest.mark.parametrize("noise", [WHITE, SHARED], ids=["white", "correlated"])
def test_closed_forms_agree_with_monte_carlo(name, obj, noise):
    drawn = monte_carlo(name, obj, noise=noise, draws=3000)

    closed = noise_influence(name, obj, noise)

    assert closed.value == pytest.approx(drawn.value, rel=ROUNDING, abs=0.0)
    assert closed.expected == pytest.approx(drawn.mean, abs=STANDARD_ERRORS * drawn.u_bias)
    u_of_u = drawn.u / math.sqrt(2 * drawn.draws.size)
    slack = 0.03 * drawn.u if name in ("Ra", "Sa") and noise is SHARED else 0.0  # r^2 bound
    assert closed.u == pytest.approx(drawn.u, abs=STANDARD_ERRORS * u_of_u + slack)


@pytest.mark.parametrize("name", ["Sq", "Sa"])
@pytest.mark.parametrize("height", [0.0, 50e-9])
def test_the_removed_mean_is_accounted_for_where_noise_is_long(name, height):
    """A comb, 10 % of it high: its mean carries much of the long noise, which centring removes."""
    comb = Profile(X, height * (np.arange(N) % 100 < 10))
    long = CorrelatedNoise(3e-9, 60e-6)
    drawn = monte_carlo(name, comb, noise=long, draws=4000)

    closed = noise_influence(name, comb, long)

    u_of_u = drawn.u / math.sqrt(2 * drawn.draws.size)
    # Few independent points: the third order of a root, and of the r^2 bound, is not small.
    slack = 0.1 * drawn.u if height == 0.0 else 0.02 * drawn.u
    assert closed.expected == pytest.approx(drawn.mean, abs=5 * drawn.u_bias + 0.1 * slack)
    assert closed.u == pytest.approx(drawn.u, abs=STANDARD_ERRORS * u_of_u + slack)


def test_the_variance_of_the_mean_square_is_the_matrix_formula():
    """4 z'Cz / n^2 + 2 tr((PC)^2) / n^2 with the centring P, element by element."""
    C = dense(SHARED, WAVE)
    P = np.eye(N) - 1.0 / N
    z = P @ WAVE.z
    variance = (4 * z @ C @ z + 2 * np.trace(P @ C @ P @ C)) / N**2
    expected2 = float(z @ z + np.trace(P @ C)) / N

    result = noise_influence("Sq", WAVE, SHARED)

    assert result.u == pytest.approx(math.sqrt(variance / expected2) / 2, rel=ROUNDING, abs=0.0)
    assert result.expected == pytest.approx(
        math.sqrt(expected2) - variance / (8 * expected2**1.5), rel=ROUNDING, abs=0.0
    )


@pytest.mark.parametrize("noise", [WHITE, SHARED], ids=["white", "correlated"])
def test_mean_and_slope_are_the_matrix_product(noise):
    holed = Profile(X, np.where((np.arange(N) > 50) & (np.arange(N) < 90), np.nan, WAVE.z))
    C = dense(noise, holed)
    x = X[~np.isnan(holed.z)]
    x = x - x.mean()

    mean, slope = (noise_influence(k, holed, noise) for k in ("mean", "slope"))

    assert mean.u == pytest.approx(math.sqrt(C.sum()) / x.size, rel=ROUNDING, abs=0.0)
    assert slope.u == pytest.approx(math.sqrt(x @ C @ x) / float(x @ x), rel=ROUNDING, abs=0.0)
    assert mean.bias == slope.bias == 0.0
    assert slope.value == pytest.approx(
        np.polyfit(x, holed.z[~np.isnan(holed.z)], 1)[0], rel=1e-6, abs=0.0
    )


def test_white_noise_formulas_by_hand():
    sigma = 3e-9
    q = A / math.sqrt(2)

    rq, mean, slope = (noise_influence(k, WAVE, WHITE) for k in ("Rq", "mean", "slope"))

    whole = math.hypot(q, sigma)
    by_hand = math.sqrt(4 * sigma**2 * q**2 / N + 2 * sigma**4 / N) / (2 * whole)
    assert rq.u == pytest.approx(by_hand, rel=ROUNDING, abs=0.0)
    assert rq.expected == pytest.approx(whole - by_hand**2 / (2 * whole), rel=ROUNDING, abs=0.0)
    assert mean.u == pytest.approx(sigma / math.sqrt(N), rel=ROUNDING, abs=0.0)
    assert slope.u == pytest.approx(
        sigma * math.sqrt(12 / (N * (N**2 - 1))) / 1e-6, rel=1e-9, abs=0.0
    )


def test_ra_of_noise_alone_is_the_half_normal_mean():
    result = noise_influence("Ra", FLAT, WHITE)

    assert result.expected == pytest.approx(3e-9 * math.sqrt(2 / math.pi), rel=1e-9, abs=0.0)
    assert result.u == pytest.approx(3e-9 * math.sqrt((1 - 2 / math.pi) / N), rel=1e-9, abs=0.0)


def test_ra_far_above_the_noise_is_linear():
    square = Profile(X, np.where(np.arange(N) % 2 == 0, 1e-6, -1e-6))

    result = noise_influence("Ra", square, WHITE)

    assert result.bias == pytest.approx(0.0, abs=1e-9 * 3e-9)
    assert result.u == pytest.approx(3e-9 / math.sqrt(N), rel=1e-6, abs=0.0)


def test_correlation_raises_u_of_the_mean_by_the_root_of_the_effective_number():
    for of, expected in (("mean", math.sqrt(math.pi) * 4), ("square", math.sqrt(math.pi / 2) * 4)):
        points = effective_number(SHARED, FLAT, of=of)
        # Integral of r, or r^2, over all lags; the ends of 400 points see half of it.
        assert points == pytest.approx(N / expected, rel=0.02, abs=0.0)
    assert effective_number(WHITE, FLAT) == pytest.approx(N, rel=ROUNDING, abs=0.0)
    u = noise_influence("mean", WAVE, SHARED).u
    assert u == pytest.approx(
        3e-9 / math.sqrt(effective_number(SHARED, FLAT)), rel=ROUNDING, abs=0.0
    )


def test_effective_number_of_a_map_is_the_product_of_its_lines():
    surface = Surface(np.zeros((60, 80)), dx=1e-6, dy=2e-6)

    whole = effective_number(SHARED, surface, of="square")

    rows = effective_number(SHARED, Profile(np.arange(60) * 2e-6, np.zeros(60)), of="square")
    columns = effective_number(SHARED, Profile(np.arange(80) * 1e-6, np.zeros(80)), of="square")
    assert whole == pytest.approx(rows * columns, rel=1e-9, abs=0.0)


def test_noise_without_low_frequencies_leaves_the_mean_alone():
    high_pass = NoiseFromPsd([0.0, 1e5, 1.1e5, 4e5], [0.0, 0.0, 1e-23, 1e-23])

    assert effective_number(high_pass, FLAT) > 10 * N


@pytest.mark.parametrize("name", ["Sq", "Sa"])
def test_missing_rows_are_cropped_rows(name):
    z = np.add.outer(WAVE.z[:40], WAVE.z[:50])
    holed = z.copy()
    holed[30:] = np.nan

    a = noise_influence(name, Surface(holed, 1e-6, 1e-6), SHARED)
    b = noise_influence(name, Surface(z[:30], 1e-6, 1e-6), SHARED)

    for key in ("value", "expected", "u"):
        assert getattr(a, key) == pytest.approx(getattr(b, key), rel=ROUNDING, abs=0.0)


@pytest.mark.parametrize("name", ["Sq", "Sa", "Rq", "Ra", "mean"])
def test_transpose_flip_and_unit(name):
    z = np.add.outer(WAVE.z[:40], 2 * WAVE.z[:50])
    base = noise_influence(name, Surface(z, 1e-6, 2e-6), SHARED)
    turned = noise_influence(name, Surface(z.T, 2e-6, 1e-6), SHARED)
    flipped = noise_influence(name, Surface(-z[:, ::-1], 1e-6, 2e-6), SHARED)
    scaled = noise_influence(name, Surface(z * 1e-9, 1e-6, 2e-6), CorrelatedNoise(3e-18, 4e-6))

    assert turned.u == pytest.approx(base.u, rel=1e-9, abs=0.0)
    assert flipped.u == pytest.approx(base.u, rel=1e-9, abs=0.0)
    assert flipped.bias == pytest.approx(base.bias, rel=1e-6, abs=1e-20)
    assert scaled.u == pytest.approx(base.u * 1e-9, rel=1e-9, abs=0.0)
    assert scaled.expected == pytest.approx(base.expected * 1e-9, rel=1e-9, abs=0.0)


def test_without_noise_nothing_moves():
    for name in ("Rq", "Ra", "Sq", "Sa", "mean", "slope"):
        result = noise_influence(name, WAVE, WhiteNoise(0.0))
        assert result.bias == pytest.approx(0.0, abs=1e-12 * A)
        assert result.u == 0.0
    assert noise_influence("Sq", FLAT, WhiteNoise(0.0)).expected == 0.0


def test_a_weighted_sum_is_exact_and_ignores_missing_points():
    z = WAVE.z.copy()
    z[:10] = np.nan
    holed = Profile(X, z)
    w = np.where(np.isnan(z), np.nan, np.sin(np.arange(N)))

    found = linear_uncertainty(w, holed, SHARED)

    by_hand = math.sqrt(w[10:] @ dense(SHARED, holed) @ w[10:])
    assert found == pytest.approx(by_hand, rel=ROUNDING, abs=0.0)


def test_scale_follows_the_degree():
    assert scale_uncertainty(-2e-6, 50e-6) == pytest.approx(1e-10, rel=1e-9, abs=0.0)
    assert scale_uncertainty(3.0, 1e-3, degree=0) == 0.0
    assert scale_uncertainty(3.0, 1e-3, degree=2) == pytest.approx(6e-3, rel=1e-9, abs=0.0)


def test_white_noise_needs_no_uniform_steps_and_correlated_noise_does():
    uneven = Profile([0, 1e-6, 3e-6, 4e-6], [0, 1e-9, 0, 1e-9])

    assert noise_influence("mean", uneven, WHITE).u == pytest.approx(1.5e-9, rel=1e-9, abs=0.0)
    with pytest.raises(NotUniformError, match="resample"):
        noise_influence("mean", uneven, SHARED)


def test_bad_input_raises():
    with pytest.raises(TooFewSamplesError, match="2 values"):
        expected_range(1)
    with pytest.raises(DataError, match="monte_carlo"):
        noise_influence("PV", WAVE, WHITE)
    with pytest.raises(DataError, match="profile"):
        noise_influence("slope", Surface(np.eye(3)), WHITE)
    with pytest.raises(TooFewSamplesError, match="valid"):
        noise_influence("Rq", Profile(X, np.full(N, np.nan)), WHITE)
    with pytest.raises(DataError, match="zero"):
        effective_number(WhiteNoise(0.0), WAVE)
    with pytest.raises(DataError, match="square"):
        effective_number(WHITE, WAVE, of="cube")
    with pytest.raises(DataError, match="relative"):
        scale_uncertainty(1.0, -1e-3)
    with pytest.raises(DataError, match="finite"):
        scale_uncertainty(math.nan, 1e-3)
    with pytest.raises(InvalidSamplesError, match="shape"):
        linear_uncertainty([1.0], WAVE, WHITE)
    holed = Profile([0, 1, 2], [0.0, math.nan, 0.0])
    with pytest.raises(InvalidSamplesError, match="not measured"):
        linear_uncertainty([1, 1, 1], holed, WHITE)
