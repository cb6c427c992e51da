"""Point spread and contrast against the closed forms of a circular pupil."""

from __future__ import annotations

import numpy as np
import pytest

from metrosep import Surface
from metrosep.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.forms import Expression, Plane, Zernike
from metrosep.optics import marechal, point_spread, strehl_ratio, wavefront

LIGHT = 633e-9


def disc(n):
    axis = (np.arange(n) - (n - 1) / 2) / (n / 2)
    x, y = np.meshgrid(axis, axis)
    return x, y, np.where(np.hypot(x, y) <= 1, 0.0, np.nan)


def test_airy_pattern_of_a_full_circle():
    from scipy.special import j1

    front = wavefront(Plane(), radius=10e-3)
    spread = front.point_spread(LIGHT, samples=256, pad=8)
    assert spread.strehl == pytest.approx(1.0, abs=1e-12)
    v = np.pi * spread.diameter * spread.angle_x / LIGHT
    v[v == 0] = 1e-9
    row = spread.intensity[spread.intensity.shape[0] // 2]
    near = np.abs(v) < 10
    # a staircase rim of 256 pixels: its area is within 0.2 % of the circle
    np.testing.assert_allclose(row[near], (2 * j1(v[near]) / v[near]) ** 2, atol=4e-3)


def test_contrast_of_a_full_circle():
    transfer = wavefront(Plane(), radius=5e-3).point_spread(LIGHT, pad=2).modulation_transfer()
    assert transfer.cutoff == pytest.approx(10e-3 / LIGHT, abs=1e-6 * transfer.cutoff)
    ideal = transfer.ideal(transfer.frequency_x)
    np.testing.assert_allclose(transfer.along_x, ideal, atol=4e-3)  # the staircase rim
    np.testing.assert_allclose(transfer.along_y, ideal, atol=4e-3)


def test_defocus_has_the_strehl_of_its_closed_form():
    # W = w rho^2: S = (sin(pi w / l) / (pi w / l))^2 (Born & Wolf 8.8)
    for waves in (0.1, 0.25, 0.5, 0.9):
        form = Expression("w*(x**2 + y**2)/R**2", w=0.5 * waves * LIGHT, R=20e-3)
        front = wavefront(form, radius=20e-3)
        assert front.strehl(LIGHT) == pytest.approx(np.sinc(waves) ** 2, abs=1e-5)


def test_small_errors_follow_marechal():
    coma = Zernike([8], coefficients=[LIGHT / 40 / 2], radius=10.001e-3)
    front = wavefront(coma, radius=10e-3)
    assert front.strehl(LIGHT, removed=["piston"]) == pytest.approx(
        marechal(LIGHT / 40, wavelength=LIGHT), abs=1e-4
    )
    assert marechal(LIGHT / 14, wavelength=LIGHT) == pytest.approx(0.8175, abs=1e-4)


def leaving_ray(p, q, mode, n, side):
    """Return the direction of the ray that leaves a plane of slopes p, q: mirror law, Snell's law."""
    normal = np.array([-p, -q, 1.0]) / np.sqrt(1 + p * p + q * q)
    d = np.array([0.0, 0.0, 1.0 if (mode, side) == ("refract", "inside") else -1.0])
    if mode == "reflect":
        return d - 2 * (d @ normal) * normal
    ratio = n if side == "inside" else 1 / n
    facing = normal if d @ normal < 0 else -normal
    cos_in = -(d @ facing)
    return ratio * d + (ratio * cos_in - np.sqrt(1 - ratio**2 * (1 - cos_in**2))) * facing


MODES = [("reflect", None, "inside"), ("refract", 1.5, "inside"), ("refract", 1.5, "outside")]


@pytest.mark.parametrize(("mode", "n", "side"), MODES)
@pytest.mark.parametrize("as_map", [True, False])
def test_tilt_moves_the_image_where_the_ray_goes(mode, n, side, as_map):
    p, q, radius = 150e-6, -60e-6, 3.2e-3
    if as_map:
        axis = (np.arange(64) - 31.5) * 1e-4
        x, y = np.meshgrid(axis, axis)
        z = np.where(np.hypot(x, y) <= radius, p * x + q * y, np.nan)
        front = wavefront(Surface(z, 1e-4, 1e-4), mode=mode, n=n, side=side)
    else:  # rings, traced anew on squares
        front = wavefront(
            Expression("p*x + q*y", p=p, q=q), radius=radius, mode=mode, n=n, side=side
        )

    spread = front.point_spread(LIGHT, removed=(), samples=64, pad=16)

    ray = leaving_ray(p, q, mode, n, side)
    half = 0.5 * (spread.angle_x[1] - spread.angle_x[0]) * (1 + 1e-6)  # the field is sampled
    assert abs(ray[0]) > 8 * half
    assert spread.peak[1] == pytest.approx(ray[0], abs=half)
    assert spread.peak[2] == pytest.approx(ray[1], abs=half)


@pytest.mark.parametrize(("mode", "n", "side"), MODES)
def test_coma_flares_to_the_side_of_its_rays(mode, n, side):
    R = 5e-3
    peak = 0.7 * LIGHT / (2 if mode == "reflect" else 0.5)  # 0.7 waves of coma in every mode
    form = Expression("a*(3*(x**2+y**2)/R**2 - 2)*x/R", a=peak, R=R)
    axis = (np.arange(64) - 31.5) * R / 32
    x, y = np.meshgrid(axis, axis)
    inside = np.hypot(x, y) <= R
    slopes = np.stack([g[inside] for g in form.gradient(x, y)], axis=1)
    rays = np.array([leaving_ray(p, q, mode, n, side)[0] for p, q in slopes])
    flare = np.sign(((rays - rays.mean()) ** 3).mean())

    front = wavefront(form, radius=R, mode=mode, n=n, side=side, grid="square", samples=64)
    spread = front.point_spread(LIGHT, pad=8)

    # the tail of geometrical rays reaches to one side, beyond the core of Airy
    across = spread.intensity.sum(axis=0)
    tail = np.abs(spread.angle_x) > 1.22 * LIGHT / (2 * R)
    right, left = (across[tail & (s * spread.angle_x > 0)].sum() for s in (1, -1))
    assert flare * (right - left) > 0.2 * (right + left)  # the far tails of diffraction are even


def test_the_low_level_path_is_a_lag():
    # a lag that grows with x: e^(ikL) has its wave vector towards + x (Goodman 3.10)
    x, y, path = disc(64)
    spread = point_spread(path + 2e-6 * x - 1e-6 * y, 1e-4, 1e-4, wavelength=20e-6, pad=8)
    peak, ax, ay = spread.peak
    step = spread.angle_x[1] - spread.angle_x[0]
    assert peak == pytest.approx(1.0, abs=0.02)
    assert ax == pytest.approx(2e-6 / 3.2e-3, abs=step)
    assert ay == pytest.approx(-1e-6 / 3.2e-3, abs=step)


def test_inside_the_glass_the_image_and_its_cutoff_scale_with_the_index():
    air, glass = (
        wavefront(Plane(), radius=5e-3, mode="refract", n=1.5, side=side).point_spread(
            LIGHT, pad=2
        )
        for side in ("inside", "outside")
    )
    np.testing.assert_allclose(glass.angle_x, air.angle_x / 1.5, rtol=1e-15)
    cutoff = glass.modulation_transfer().cutoff
    assert cutoff == pytest.approx(1.5 * air.modulation_transfer().cutoff, abs=1e-6)
    transfer = glass.modulation_transfer()
    np.testing.assert_allclose(transfer.along_x, transfer.ideal(transfer.frequency_x), atol=4e-3)


def test_peak_of_the_spread_is_the_strehl_ratio():
    rng = np.random.default_rng(1)
    _, _, path = disc(32)
    path = path + 20e-9 * rng.standard_normal(path.shape)
    spread = point_spread(path, 1e-3, 1e-3, wavelength=LIGHT)
    weights = np.isfinite(path).astype(float)
    assert spread.strehl == pytest.approx(strehl_ratio(path, weights, wavelength=LIGHT), abs=1e-12)


def test_energy_is_kept():
    _, _, path = disc(32)
    pad = 4
    spread = point_spread(path, 1e-3, 1e-3, wavelength=LIGHT, pad=pad)
    n = np.isfinite(path).sum()
    assert spread.intensity.sum() == pytest.approx((pad * 32) ** 2 / n, abs=1e-8)  # Parseval


def test_marechal_is_as_good_as_it_says():
    # defocus, the worst of the low terms: S = sinc(w)^2 at rms = w / sqrt(12) waves
    for waves in np.linspace(0.01, 0.38, 20):
        exact = np.sinc(waves) ** 2
        assert exact > 0.6
        rough = marechal(waves * LIGHT / 12**0.5, wavelength=LIGHT)
        assert rough == pytest.approx(exact, abs=0.02)
    rough = marechal(0.443 * LIGHT / 12**0.5, wavelength=LIGHT)
    assert rough - np.sinc(0.443) ** 2 == pytest.approx(0.024, abs=0.001)
    assert marechal(1e300, wavelength=LIGHT) == 0.0


def test_strehl_of_unequal_areas():
    # two parts, half a wave apart: |a - b|^2 / (a + b)^2
    assert strehl_ratio([0, LIGHT / 2], [3, 1], wavelength=LIGHT) == pytest.approx(0.25, abs=1e-15)
    assert strehl_ratio([0.0, np.nan], [3, 1], wavelength=LIGHT) == 1.0
    assert strehl_ratio([0.0, 0.0], [1e308, 1e308], wavelength=LIGHT) == 1.0


def test_masked_points_are_dark():
    path = np.ma.masked_invalid(disc(16)[2])
    assert point_spread(path, 1e-3, 1e-3, wavelength=LIGHT).strehl == pytest.approx(1.0, abs=1e-12)
    light = np.where(np.isnan(path.filled(np.nan)), np.nan, 1.0)  # not known where the path is not
    spread = point_spread(path, 1e-3, 1e-3, wavelength=LIGHT, amplitude=light)
    assert spread.strehl == pytest.approx(1.0, abs=1e-12)


def test_results_cannot_be_changed():
    spread = point_spread(np.zeros((4, 4)), 1e-3, 1e-3, wavelength=LIGHT)
    for array in (spread.intensity, spread.angle_x, spread.modulation_transfer().along_y):
        with pytest.raises(ValueError, match="read-only"):
            array.flat[0] = 1.0


@pytest.mark.parametrize(
    "wrong", [633, 0.633, 1e-9, 0.0, -1.0, np.nan, np.inf, "633e-9", None, True]
)
def test_a_wavelength_that_is_not_one_of_light_is_refused(wrong):
    front = wavefront(Plane(), radius=1e-3, samples=(10, 12))
    for call in (
        lambda: front.strehl(wrong),
        lambda: front.point_spread(wrong, samples=16),
        lambda: marechal(1e-9, wavelength=wrong),
        lambda: strehl_ratio([0.0], [1.0], wavelength=wrong),
        lambda: point_spread(np.zeros((4, 4)), 1e-3, 1e-3, wavelength=wrong),
    ):
        with pytest.raises(DataError, match=r"wavelength"):
            call()


def spread_of(path, **options):
    return point_spread(path, 1e-3, 1e-3, **{"wavelength": LIGHT, **options})


def strehl_of(path, weights):
    return strehl_ratio(path, weights, wavelength=LIGHT)


ZERO = np.zeros((4, 4))


BAD = [
    (lambda: spread_of(np.zeros(4)), InvalidSamplesError, "map"),
    (lambda: spread_of(np.zeros((0, 4))), InvalidSamplesError, "map"),
    (lambda: spread_of(ZERO + np.inf), InvalidSamplesError, r"infinite at index \(0, 0\)"),
    (lambda: spread_of(ZERO + 1j), InvalidSamplesError, "real"),
    (lambda: spread_of([[None, 0.0]]), InvalidSamplesError, "real"),
    (lambda: spread_of(ZERO > 0), InvalidSamplesError, "real"),
    (lambda: spread_of(ZERO.astype("M8[s]")), InvalidSamplesError, "real"),
    (lambda: point_spread(ZERO, "1", 1e-3, wavelength=LIGHT), DataError, "dx"),
    (lambda: point_spread(ZERO, 1e-3, 0.0, wavelength=LIGHT), DataError, "dy must be positive"),
    *(
        (lambda wrong=wrong: spread_of(ZERO, pad=wrong), DataError, "pad must be a whole")
        for wrong in (1, 2.5, np.nan, np.inf, None, "4", True)
    ),
    (lambda: spread_of(ZERO, pad=10**6), DataError, "smaller pad"),
    (lambda: spread_of(ZERO, index=0.0), DataError, "index"),
    (lambda: spread_of(np.full((4, 4), np.nan)), TooFewSamplesError, "dark"),
    (lambda: spread_of(np.eye(4) * LIGHT), TooFewSamplesError, "waves from pixel"),
    (lambda: spread_of(ZERO, amplitude=ZERO + 2.0), InvalidSamplesError, "amplitude"),
    (lambda: spread_of(ZERO, amplitude=ZERO * np.nan), InvalidSamplesError, "amplitude"),
    (lambda: spread_of(ZERO, amplitude=ZERO[0]), InvalidSamplesError, "amplitude"),
    (lambda: spread_of(ZERO).modulation_transfer().ideal(np.inf), InvalidSamplesError, "freq"),
    (lambda: marechal(-1.0, wavelength=LIGHT), DataError, "rms"),
    (lambda: marechal(np.inf, wavelength=LIGHT), DataError, "rms"),
    (lambda: marechal("1", wavelength=LIGHT), DataError, "rms"),
    (lambda: strehl_of([np.nan], [1.0]), TooFewSamplesError, "no point"),
    (lambda: strehl_of([0.0], [0.0]), TooFewSamplesError, "no point"),
    (lambda: strehl_of([0.0, np.inf], [1, 1]), InvalidSamplesError, r"infinite at index \(1,\)"),
    (lambda: strehl_of([0, 1e-7], [1, -1]), InvalidSamplesError, r"-1.0 at index \(1,\)"),
    (lambda: strehl_of([0, 1e-7], [1, np.nan]), InvalidSamplesError, "never NaN"),
    (lambda: strehl_of([0, 1e-7], [1]), InvalidSamplesError, "one shape"),
    (lambda: strehl_of([0, 1j], [1, 1]), InvalidSamplesError, "opd must hold real"),
    (lambda: strehl_of([[0], [1, 2]], [1, 1]), InvalidSamplesError, "opd must hold real"),
    (lambda: strehl_of([0.0], ["1"]), InvalidSamplesError, "weights must hold real"),
]


@pytest.mark.parametrize(("call", "error", "match"), BAD, ids=[str(i) for i in range(len(BAD))])
def test_bad_input(call, error, match):
    with pytest.raises(error, match=match):
        call()
