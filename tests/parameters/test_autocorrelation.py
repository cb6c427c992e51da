"""Sal, Str and Std against autocorrelations in closed form, and planted directions."""

import math

import numpy as np
import pytest

from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.parameters.autocorrelation import (
    Autocorrelation,
    autocorrelation,
    central_lobe,
    texture_direction,
)

UM = 1e-6
EXACT = 1e-9
"""Rounding of the FFT."""
CUBIC = 2e-5
"""Cubic interpolation of a lobe of ten pixels, and its end between two grid lines."""
LAG_ESTIMATE = 5e-2
"""A finite map gives an estimate of its autocorrelation (row A10 of the specification)."""
RATIO_ESTIMATE = 3e-2
"""As above, for Str."""
DEGREE = math.radians(1.0)
"""Smoothing and quantised frequencies at 15 periods on the map."""


def sine_grid(n=500):
    c = np.cos(2 * np.pi * np.arange(n) / 100)
    return 0.05 * UM * (c[None, :] + c[:, None])


def lobe_of(function, shape=(60, 60), dx=1.0, dy=1.0):
    """Evaluate a known autocorrelation on the lags and look for its lobe."""
    y, x = np.mgrid[: shape[0] + 1, -shape[1] : shape[1] + 1] * 1.0
    return central_lobe(Autocorrelation(function(x * dx, y * dy), dx, dy))


def direct(z):
    """Sum the pairs one lag at a time."""
    d = z - np.nanmean(z)
    n_y, n_x = z.shape
    out = np.empty((n_y // 2 + 1, 2 * (n_x // 2) + 1))
    for j in range(out.shape[0]):
        for i in range(-(n_x // 2), n_x // 2 + 1):
            a = d[: n_y - j, max(0, -i) : n_x - max(0, i)]
            b = d[j:, max(0, i) : n_x - max(0, -i)]
            out[j, i + n_x // 2] = np.nanmean(a * b)
    return out / np.nanmean(d**2)


def test_equals_the_sum_over_pairs_with_and_without_holes(rng):
    z = rng.normal(size=(17, 22)).cumsum(axis=1)
    assert autocorrelation(z, 1.0, 1.0).values == pytest.approx(direct(z), abs=EXACT)
    z[3:6, 4:9] = np.nan
    z[12, 1] = np.nan
    assert autocorrelation(z, 1.0, 1.0).values == pytest.approx(direct(z), abs=EXACT)


def test_sine_grid():
    lobe = central_lobe(autocorrelation(sine_grid(), UM, UM))
    sal = math.sqrt(2) * math.acos(0.2) / (2 * math.pi) * 100 * UM
    assert lobe.shortest == pytest.approx(sal, rel=LAG_ESTIMATE, abs=0.0)
    assert lobe.aspect_ratio == pytest.approx(0.87462, rel=RATIO_ESTIMATE, abs=0.0)
    assert lobe.direction_shortest == pytest.approx(math.pi / 4, abs=3 * DEGREE)


def test_lobe_of_the_exact_sine_grid_function():
    k = 2 * np.pi / 100
    lobe = lobe_of(lambda x, y: (np.cos(k * x) + np.cos(k * y)) / 2)
    assert lobe.shortest == pytest.approx(math.sqrt(2) * math.acos(0.2) / k, rel=CUBIC, abs=0.0)
    assert lobe.longest == pytest.approx(math.acos(-0.6) / k, rel=CUBIC, abs=0.0)


@pytest.mark.parametrize("angle", [0.0, 20.0, 90.0, 117.0])
def test_lobe_of_a_turned_ellipse_is_not_off_by_a_factor_of_two(angle):
    c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    lobe = lobe_of(
        lambda x, y: np.exp(-(((x * c + y * s) / 30) ** 2) - ((y * c - x * s) / 6) ** 2)
    )
    assert lobe.shortest == pytest.approx(6 * math.sqrt(math.log(5)), rel=5e-4, abs=0.0)
    assert lobe.longest == pytest.approx(30 * math.sqrt(math.log(5)), rel=5e-4, abs=0.0)
    assert lobe.aspect_ratio == pytest.approx(0.2, rel=1e-3, abs=0.0)
    turn = lobe.direction_longest - math.radians(angle)
    assert abs(math.remainder(turn, math.pi)) < DEGREE
    assert abs(
        math.remainder(turn - (lobe.direction_shortest - math.radians(angle + 90)), math.pi)
    ) < (4 * DEGREE)


def test_steps_of_unequal_length():
    lobe = lobe_of(lambda x, y: np.exp(-(x**2 + y**2) / 20**2), dx=1.0, dy=2.5)
    assert lobe.shortest == pytest.approx(20 * math.sqrt(math.log(5)), rel=1e-4, abs=0.0)
    assert lobe.aspect_ratio == pytest.approx(1.0, rel=1e-4, abs=0.0)


def test_only_lags_in_sight_of_zero_belong_to_the_lobe():
    # A hook: from the disc a finger runs out along x, then up; its tip hides behind a gap.
    def hook(x, y):
        near = np.hypot(x, y) < 10.5
        finger = (abs(y) < 2.5) & (abs(x) < 30.5)
        tip = (abs(abs(x) - 29) < 2.5) & (abs(y) < 40.5)
        return np.where(near | finger | tip, 0.9, 0.0)

    lobe = lobe_of(hook)
    assert lobe.longest < 33.0
    assert lobe.shortest == pytest.approx(10.5, abs=0.6)


def test_a_second_lobe_within_three_pixels_does_not_hide_the_end():
    # Fine waves: the autocorrelation rises above 0.2 again 1.5 pixels behind its first fall. A
    # straight line between the pixels at 1 (0.291) and 2 (0.072) gives 1.42 pixels.
    def waves(x, y):
        lobes = np.exp(-((x / 0.9) ** 2)) + 0.5 * np.exp(-(((np.abs(x) - 3.0) / 0.7) ** 2))
        return lobes * np.exp(-((y / 20.0) ** 2))

    fall = 1.14255  # exp(-(x / 0.9)^2) = 0.2 - 0.5 exp(-((x - 3) / 0.7)^2)
    assert waves(fall, 0.0) == pytest.approx(0.2, abs=1e-5)
    assert lobe_of(waves).shortest == pytest.approx(fall, rel=0.05, abs=0.0)


def test_lobe_that_reaches_the_largest_lag_has_no_longest():
    x = np.arange(200.0)
    grooves = np.tile(np.cos(2 * np.pi * x / 25), (100, 1))
    lobe = central_lobe(autocorrelation(grooves, UM, UM))
    assert lobe.longest is None
    assert lobe.aspect_ratio is None
    assert lobe.shortest == pytest.approx(
        math.acos(0.2) / (2 * math.pi) * 25 * UM, rel=LAG_ESTIMATE, abs=0.0
    )


@pytest.mark.parametrize("degrees", [18.3, 33.0, 45.0, 70.0])
def test_a_thin_thread_across_the_grid_is_followed_to_the_largest_lag(degrees):
    """Its pixels touch at corners only in places; a real map (bcrf) had Str 0.126 of the first of them."""
    a = math.radians(degrees)

    lobe = lobe_of(lambda x, y: np.exp(-(((y * math.cos(a) - x * math.sin(a)) / 0.45) ** 2)))

    assert lobe.longest is None


def test_a_lobe_that_reaches_the_largest_lag_round_a_corner_has_a_longest():
    def hook(x, y):
        near = np.hypot(x, y) < 10.5
        finger = (abs(y) < 2.5) & (abs(x) < 30.5)
        return np.where(near | finger | (abs(abs(x) - 28) < 2.5), 0.9, 0.0)

    assert lobe_of(hook).longest == pytest.approx(30.8, abs=0.6)


def test_a_lobe_larger_than_the_map_is_refused():
    tilt = np.tile(np.cos(np.linspace(0, 0.5, 64)), (64, 1))
    with pytest.raises(DataError, match="too small for its texture"):
        lobe_of(lambda x, y: np.exp(-(x**2 + y**2) / 500**2))
    assert central_lobe(autocorrelation(tilt, 1.0, 1.0)).longest is None


def test_filtered_noise_has_the_autocorrelation_of_its_filter(rng):
    from scipy.ndimage import gaussian_filter

    z = gaussian_filter(rng.normal(size=(600, 600)), (9.0, 3.0), mode="wrap")
    lobe = central_lobe(autocorrelation(z, UM, UM))
    assert lobe.shortest == pytest.approx(
        2 * 3 * math.sqrt(math.log(5)) * UM, rel=LAG_ESTIMATE, abs=0.0
    )
    assert lobe.aspect_ratio == pytest.approx(1 / 3, rel=2 * LAG_ESTIMATE, abs=0.0)
    assert abs(math.remainder(texture_direction(autocorrelation(z, UM, UM)), math.pi)) < 2 * DEGREE


@pytest.mark.parametrize("angle", [0.0, 12.0, 30.0, 90.0, 135.0, 171.0])
@pytest.mark.parametrize("dy", [1.0, 2.0])
def test_direction_of_a_planted_wave(angle, dy):
    a = math.radians(angle)
    y, x = np.mgrid[:300, :400] * 1.0
    wave = np.cos(2 * np.pi / 20 * (x * math.cos(a) + y * dy * math.sin(a)) + 0.4)
    found = texture_direction(autocorrelation(wave, 1.0, dy))
    assert 0.0 <= found < math.pi
    assert abs(math.remainder(found - a, math.pi)) < DEGREE
    mirrored = texture_direction(autocorrelation(wave[:, ::-1], 1.0, dy))
    assert abs(math.remainder(mirrored + a, math.pi)) < DEGREE
    transposed = texture_direction(autocorrelation(wave.T, dy, 1.0))
    assert abs(math.remainder(transposed - (math.pi / 2 - a), math.pi)) < DEGREE
    wave[50:120, 80:200] = np.nan
    holed = texture_direction(autocorrelation(wave, 1.0, dy))
    assert abs(math.remainder(holed - a, math.pi)) < DEGREE


LARGEST = {
    "power": {8: 3.5, 10: 2.6, 12.8: 1.8, 16: 0.65, 20: 0.15, 32: 0.08},
    "amplitude": {8: 5.6, 10: 5.5, 12.8: 2.1, 16: 1.3, 20: 0.6, 32: 0.21},
}


@pytest.mark.parametrize(
    ("of", "waves", "largest"),
    [(of, *row) for of, rows in LARGEST.items() for row in rows.items()],
)
def test_error_of_the_direction_falls_with_the_waves_on_the_map(rng, of, waves, largest):
    """The table of docs/parameters/std.md, with some room for other directions."""
    y, x = np.mgrid[:256, :256] * 2 * np.pi * waves / 256
    errors = []
    for angle in rng.uniform(0, 180, 24):
        t = math.radians(angle)
        z = np.cos(x * math.cos(t) + y * math.sin(t) + rng.uniform(0, 2 * np.pi))
        try:
            found = math.degrees(texture_direction(autocorrelation(z, UM, UM), of=of))
        except DataError:
            assert waves <= 10  # the maximum splits
            continue
        errors.append(abs(math.remainder(found - angle, 180)))
    assert max(errors) < largest
    assert len(errors) >= 18


@pytest.mark.parametrize("crossed", [True, False])
def test_no_direction_where_none_dominates(rng, crossed):
    z = sine_grid() if crossed else rng.normal(size=(200, 200))
    with pytest.raises(DataError, match="no direction dominates"):
        texture_direction(autocorrelation(z, UM, UM))


def test_unit_offset_and_nan_rows_change_nothing(rng):
    from scipy.ndimage import gaussian_filter

    z = gaussian_filter(rng.normal(size=(120, 150)), (5.0, 3.0))
    first = central_lobe(autocorrelation(z, 1.0, 2.0))
    scaled = central_lobe(autocorrelation(-1e-9 * z + 1.0, 1e-6, 2e-6))
    assert scaled.shortest == pytest.approx(first.shortest * 1e-6, rel=1e-6, abs=0.0)
    assert scaled.longest == pytest.approx(first.longest * 1e-6, rel=1e-6, abs=0.0)
    padded = np.full((140, 150), np.nan)
    padded[11:131] = z
    again = central_lobe(autocorrelation(padded, 1.0, 2.0))
    assert (again.shortest, again.longest) == pytest.approx(
        (first.shortest, first.longest), rel=EXACT, abs=0.0
    )


def test_bad_input_is_named():
    with pytest.raises(TooFewSamplesError, match="8 x 8"):
        autocorrelation(np.zeros((3, 20)), 1.0, 1.0)
    with pytest.raises(InvalidSamplesError, match="no pixel"):
        autocorrelation(np.full((9, 9), np.nan), 1.0, 1.0)
    with pytest.raises(InvalidSamplesError, match="dx must be positive"):
        autocorrelation(np.zeros((9, 9)), -1.0, 1.0)
    with pytest.raises(DataError, match="equal"):
        autocorrelation(np.full((9, 9), 0.1), 1.0, 1.0)
    with pytest.raises(DataError, match="threshold"):
        central_lobe(autocorrelation(np.arange(81).reshape(9, 9), 1.0, 1.0), threshold=1.0)
