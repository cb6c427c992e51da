"""Orthogonal mixed method: W_k of the specification, an artefact written as sums of cosines."""

import math

import numpy as np
import pytest
from contracts.separation import SeparationContract

from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.core.profile import Profile
from metrosep.separation.circles.mixed import OrthogonalMixed, mixed_transfer, orthogonal_mixed

N, KMAX, RADIUS = 120, 20, 0.05


def angles_of(n):
    return 2 * math.pi * np.arange(n) / n


def random_waves(rng, first=2):
    return [
        (k, 1e-7 / k * rng.standard_normal(), rng.uniform(0, 2 * math.pi))
        for k in range(first, KMAX + 1)
    ]


def height(w, angle):
    return sum(a * np.cos(k * angle + p) for k, a, p in w)


def rise(w, angle):
    return sum(-k * a * np.sin(k * angle + p) for k, a, p in w)


class _Mixed(SeparationContract):
    turn = 1

    def method(self):
        return OrthogonalMixed(KMAX, RADIUS, u_slope=self.sd, turn=self.turn)

    def truth(self, rng):
        return {"artefact": height(random_waves(rng), angles_of(N))}

    def errors(self, rng):
        return {"x": height(random_waves(rng), angles_of(N))}

    def readings(self, truth, errors):
        theta = angles_of(N)
        x = np.asarray(errors.get("x", np.zeros(N)))
        r = np.asarray(truth.get("artefact", np.zeros(N)))
        # harmonics by sums over samples, their derivative a quarter turn on
        rising = np.zeros(N)
        for k in range(1, N // 2):
            a, b = 2 / N * (r * np.cos(k * theta)).sum(), 2 / N * (r * np.sin(k * theta)).sum()
            seen = k * (theta + self.turn * math.pi / 2)
            rising += self.turn * k * (b * np.cos(seen) - a * np.sin(seen))
        return np.array([r + x, (rising - x) / RADIUS])

    def invisible(self, rng):
        theta = angles_of(N)
        a, b = rng.standard_normal(2) * 1e-6
        once = a * np.cos(theta) + b * np.sin(theta)
        yield {"artefact": once}, {"x": -once}


class TestMixed(_Mixed):
    pass


class TestMixedOtherTurn(_Mixed):
    turn = -1


def test_transfer_has_the_sizes_of_the_specification():
    w = np.abs(mixed_transfer(40))

    for k in range(41):
        expected = math.sqrt(1 + k * k) if k % 2 == 0 else (k + 1 if k % 4 == 3 else k - 1)
        assert w[k] == pytest.approx(expected, abs=1e-13)


def test_circle_that_moves_shows_the_slope_probe_minus_x_over_radius():
    """Geometry, not algebra: a circle of radius R moved by x, slope of rho(alpha) at 90 degrees."""
    x, step = 2e-6, 1e-5

    def rho(alpha):
        return x * math.cos(alpha) + math.sqrt(RADIUS**2 - (x * math.sin(alpha)) ** 2)

    quarter = math.pi / 2
    slope = (rho(quarter + step) - rho(quarter - step)) / (2 * step * RADIUS)

    read = OrthogonalMixed(5, RADIUS).simulate({}, {"x": np.full(16, x)})

    assert slope == pytest.approx(-x / RADIUS, rel=1e-3, abs=0)
    np.testing.assert_allclose(read[1], slope, rtol=1e-3, atol=0)


def test_bump_is_seen_rising_before_it_falls():
    """Turn +1: the bump at artefact angle 60 deg passes the slope probe (90 deg) at theta -30."""
    theta = angles_of(360)
    r = np.exp(8 * (np.cos(theta - math.radians(60)) - 1)) * 1e-9

    slope = OrthogonalMixed(20, RADIUS).simulate({"artefact": r}, {})[1]

    assert slope[330 - 20] > 0 > slope[330 + 20]
    assert abs(slope[330]) < 1e-3 * slope.max()


def test_monte_carlo_scatter_falls_with_k():
    rng = np.random.default_rng(2)
    s, su, trials = 1e-9, 4e-8, 400
    method = OrthogonalMixed(KMAX, RADIUS, u_slope=su)
    noise = np.array([s, su])[:, None]
    runs = [method.separate(noise * rng.standard_normal((2, N))) for _ in range(trials)]
    c = np.array([r.harmonics["artefact"] for r in runs])[:, 2:]
    scatter = np.sqrt((c.real.var(axis=0) + c.imag.var(axis=0)) / 2)

    stated = method.separate(np.zeros((2, N)), u_reading=s).harmonics_u["artefact"][2:]

    # one value: 1/sqrt(800) of itself twice over is 2.5 %; the median of 19 is within 3 %
    assert np.median(scatter / stated) == pytest.approx(1.0, abs=0.03)
    k = np.arange(2, KMAX + 1)
    w = np.abs(1 + 1j * k * np.exp(0.5j * np.pi * k))
    np.testing.assert_allclose(
        stated, math.sqrt(s**2 + (RADIUS * su) ** 2) * math.sqrt(2 / N) / w, rtol=1e-9, atol=0
    )


def test_type_b_of_angle_and_radius_is_the_change_they_make():
    rng = np.random.default_rng(3)
    r, x, y = random_waves(rng), random_waves(rng), random_waves(rng)
    theta, d = angles_of(N), 1e-5

    def read(miss=0.0, radius=RADIUS, y=()):
        phi = math.pi / 2 + miss
        slope = rise(r, theta + phi) - height(x, theta) * math.sin(phi)
        if y:
            slope = slope + height(y, theta) * math.cos(phi)
        return np.array([height(r, theta) + height(x, theta), slope / radius])

    method = OrthogonalMixed(KMAX, RADIUS)
    base = method.separate(read()).artefact
    by_angle = (method.separate(read(miss=d)).artefact - base) / d
    by_y = (method.separate(read(miss=d, y=y)).artefact - base) / d - by_angle
    by_radius = (method.separate(read(radius=RADIUS * (1 + d))).artefact - base) / d

    angle = OrthogonalMixed(KMAX, RADIUS, u_slope=0.0, u_angle=1e-3)
    scale = OrthogonalMixed(KMAX, RADIUS, u_slope=0.0, u_radius=2e-3 * RADIUS)
    u_scale = scale.separate(read(), u_reading=0.0).u["artefact"]
    u_angle = angle.separate(read(), u_reading=0.0).u["artefact"]

    np.testing.assert_allclose(u_scale, 2e-3 * np.abs(by_radius), rtol=1e-3, atol=1e-14)
    # the motion across is taken as large as x: equal in root mean square, not in every sample
    assert math.sqrt(np.mean(u_angle**2)) > 1e-3 * math.sqrt(np.mean(by_angle**2))
    ratio = np.std(height(x, theta)) / np.std(height(y, theta))
    excess = math.sqrt(np.mean(u_angle**2 - (1e-3 * by_angle) ** 2))
    assert excess == pytest.approx(1e-3 * ratio * np.std(by_y), rel=0.5, abs=0)


def test_revolutions_make_the_uncertainty_of_the_mean():
    rng = np.random.default_rng(8)
    s, turns = np.array([1e-9, 3e-8])[:, None, None], 40
    m = s * rng.standard_normal((2, turns, N))

    found = orthogonal_mixed(m[0], m[1], KMAX, radius=RADIUS)

    stated = orthogonal_mixed(
        m[0], m[1], KMAX, radius=RADIUS, u_reading=1e-9, u_slope=3e-8
    ).harmonics_u["artefact"][2:]
    ratio = found.harmonics_u["artefact"][2:] / stated
    # 78 degrees of freedom each, 19 harmonics: 8 % and 2 %
    assert math.sqrt(np.mean(ratio**2)) == pytest.approx(1.0, abs=0.06)
    assert found.noise.value == pytest.approx(1e-9, rel=0.05, abs=0)


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"radius": 0.0}, DataError, "radius"),
        ({"u_reading": 1e-9}, DataError, "u_slope"),
        ({"u_angle": 5.0}, DataError, "deg2rad"),
        ({"u_angle": -1.0}, DataError, "u_angle"),
        ({"u_radius": 1.0}, DataError, "u_radius"),
        ({"turn": 2}, DataError, "turn"),
        ({"kmax": 60}, TooFewSamplesError, "kmax"),
        ({"kmax": 0}, DataError, "kmax"),
    ],
)
def test_impossible_settings_are_refused(options, error, words):
    options = {"kmax": KMAX, "radius": RADIUS, **options}
    with pytest.raises(error, match=words):
        orthogonal_mixed(np.ones(N), np.ones(N), options.pop("kmax"), **options)


def test_unequal_lengths_are_refused():
    with pytest.raises(InvalidSamplesError):
        orthogonal_mixed(np.ones(N), np.ones(N - 1), KMAX, radius=RADIUS)


def test_start_angle_and_profiles():
    rng = np.random.default_rng(3)
    r, x = random_waves(rng), random_waves(rng)
    theta = 1.1 + angles_of(N)
    d = height(r, theta) + height(x, theta)
    s = (rise(r, theta + math.pi / 2) - height(x, theta)) / RADIUS

    for found in (
        orthogonal_mixed(Profile(theta, d), Profile(theta, s), KMAX, radius=RADIUS),
        orthogonal_mixed(d, s, KMAX, radius=RADIUS, angle=theta),
    ):
        np.testing.assert_allclose(found.coordinates["angle"], theta, rtol=0, atol=1e-12)
        np.testing.assert_allclose(found.artefact, height(r, theta), rtol=0, atol=1e-15)
        for k, a, p in r:
            expected = a * np.exp(1j * p)
            assert abs(found.harmonics["artefact"][k] - expected) < 1e-17
    with pytest.raises(DataError, match="reading 2 differ"):
        orthogonal_mixed(Profile(theta, d), Profile(theta + 0.1, s), KMAX, radius=RADIUS)


def test_drift_of_the_level_is_no_noise_of_a_reading():
    rng = np.random.default_rng(4)
    d = np.arange(8)[:, None] * 1e-6 + 1e-9 * rng.standard_normal((8, N))
    s = 1e-8 * rng.standard_normal((8, N))

    found = orthogonal_mixed(d, s, KMAX, radius=RADIUS)

    # 117 * 7 degrees of freedom: 2.5 %
    assert found.noise.value == pytest.approx(1e-9, rel=0.1, abs=0)


def test_other_units_are_doubted():
    one = np.cos(2 * angles_of(N))
    for d, s, words in ((one, one * 1e-6, "5 um"), (one * 1e-6, one, "5 urad")):
        found = orthogonal_mixed(d, s, KMAX, radius=RADIUS)
        assert sum(words in text for text in found.messages) == 1
    with pytest.raises(DataError, match="mm"):
        orthogonal_mixed(one, one, KMAX, radius=20)
    for bad in ({"u_slope": "x"}, {"u_angle": None}, {"u_radius": [1.0]}, {"radius": None}):
        with pytest.raises(DataError, match=next(iter(bad))):
            orthogonal_mixed(one, one, KMAX, **{"radius": RADIUS, **bad})


def test_correct_takes_repeated_revolutions():
    m = np.random.default_rng(1).standard_normal((2, 3, N)) * 1e-9
    assert OrthogonalMixed(KMAX, RADIUS).correct(m).shape == m.shape
