"""Point spread and contrast against the closed forms of a circular pupil."""

from __future__ import annotations

import numpy as np
import pytest

from metrosep.errors import DataError, TooFewSamplesError
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


def test_tilt_moves_the_peak_towards_its_side():
    # W = 2 s x leads on the right; the transform puts its peak at + 2 s, once and for all this way
    x, y, path = disc(64)
    spread = point_spread(path + 2e-6 * x + 1e-6 * y, 1e-4, 1e-4, wavelength=20e-6, pad=8)
    peak, ax, ay = spread.peak
    step = spread.angle_x[1] - spread.angle_x[0]
    assert peak == pytest.approx(1.0, abs=0.02)
    assert ax == pytest.approx(2e-6 / 3.2e-3, abs=step)
    assert ay == pytest.approx(1e-6 / 3.2e-3, abs=step)


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


@pytest.mark.parametrize(
    ("call", "error", "match"),
    [
        (
            lambda: point_spread(np.zeros((4, 4)), 1.0, 1.0, wavelength=-1.0),
            DataError,
            "wavelength",
        ),
        (lambda: point_spread(np.zeros(4), 1.0, 1.0, wavelength=1.0), DataError, "map"),
        (
            lambda: point_spread(np.zeros((4, 4)), 1.0, 1.0, wavelength=1.0, pad=1),
            DataError,
            "pad",
        ),
        (
            lambda: point_spread(np.full((4, 4), np.nan), 1.0, 1.0, wavelength=1.0),
            TooFewSamplesError,
            "dark",
        ),
        (
            lambda: point_spread(np.eye(4), 1.0, 1.0, wavelength=1.0),
            TooFewSamplesError,
            "waves from pixel",
        ),
        (
            lambda: point_spread(
                np.zeros((2, 2)), 1.0, 1.0, wavelength=1.0, amplitude=np.full((2, 2), 2.0)
            ),
            DataError,
            "amplitude",
        ),
        (lambda: marechal(-1.0, wavelength=1.0), DataError, "rms"),
        (lambda: strehl_ratio([np.nan], [1.0], wavelength=1.0), TooFewSamplesError, "no point"),
    ],
)
def test_bad_input(call, error, match):
    with pytest.raises(error, match=match):
        call()
