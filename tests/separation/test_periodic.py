"""Periodic error: closed forms of quadrature errors, scatter, null space, a real interferometer."""

import math

import numpy as np
import pytest
from contracts.separation import SeparationContract

from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    MetrosepError,
    NotSeparableError,
    UnitError,
)
from metrosep.separation.positions.periodic import FringeError, periodic_error

EXACT = 1e-9
"""Relative, noise-free: rounding times a condition below 1e3."""

WAVELENGTH = 632.8e-9
FRINGE = WAVELENGTH / 2
N = 400
X = np.linspace(0.3e-6, 6.5e-6, N)  # 19.6 fringes


class TestFringe(SeparationContract):
    takes_repeats = False
    has_redundancy = True

    def method(self):
        return FringeError(tuple(X.tolist()), FRINGE)

    def truth(self, rng):
        a = rng.standard_normal(2)
        return {"corrected": 1e-8 * (a[0] + a[1] * X / X[-1])}

    def errors(self, rng):
        a, p = rng.uniform(1e-9, 3e-9, 2), rng.uniform(0, 7, 2)
        t = 2 * np.pi * X / FRINGE
        return {"periodic": a[0] * np.cos(t + p[0]) + a[1] * np.cos(2 * t + p[1])}

    def readings(self, truth, errors):
        zero = np.zeros(N)
        return (truth.get("corrected", zero) + errors.get("periodic", zero))[None, :]

    def invisible(self, rng):
        wave = 5e-9 * np.cos(2 * np.pi * X / FRINGE + 1.0)
        yield {"corrected": wave}, {"periodic": -wave}

    # the suite's "one" takes the first reading of several; here there is only one
    @pytest.mark.parametrize("bad", ["empty", "flat", "inf", "text", "nothing measured"])
    def test_useless_readings_are_refused_in_words(self, bad):
        super().test_useless_readings_are_refused_in_words(bad)


def test_amplitude_and_phase_have_the_planted_sign():
    z = 3e-9 * np.cos(2 * np.pi * X / FRINGE - 0.7) + 1e-9 * np.cos(4 * np.pi * X / FRINGE + 2.0)

    result = periodic_error(X, z + 2e-3 * X, period=FRINGE)

    c = result.harmonics["periodic"]
    assert abs(c[1] - 3e-9 * np.exp(-0.7j)) < EXACT * 1e-8
    assert abs(c[2] - 1e-9 * np.exp(2.0j)) < EXACT * 1e-8
    assert np.isnan(c[0])
    np.testing.assert_allclose(result.corrected, 2e-3 * X, rtol=0.0, atol=EXACT * 1e-8)
    np.testing.assert_allclose(result.audit["amplitudes_nm"], [3.0, 1.0], rtol=1e-7, atol=0.0)


@pytest.mark.parametrize(
    ("offset", "ratio", "quadrature", "harmonic", "amplitude"),
    [
        (2e-3, 0.0, 0.0, 1, 2e-3),
        (0.0, 2e-3, 0.0, 2, 1e-3),
        (0.0, 0.0, 2e-3, 2, 1e-3),
    ],
)
def test_quadrature_errors_give_heydemanns_harmonics(
    offset, ratio, quadrature, harmonic, amplitude
):
    """Simulated quadrature signals: phase error e/R, g/2, b/2 rad, times fringe/(2 pi)."""
    phase = 2 * np.pi * X / FRINGE
    c = (1 + ratio) * np.cos(phase) + offset
    s = np.sin(phase + quadrature)
    read = np.unwrap(np.arctan2(s, c)) * FRINGE / (2 * np.pi)
    read += FRINGE * np.round((X[0] - read[0]) / FRINGE)

    result = periodic_error(X, read - X, period=FRINGE)

    found = result.audit["amplitudes_nm"][harmonic - 1]
    # second order in 2e-3
    assert found == pytest.approx(amplitude * FRINGE / (2 * np.pi) * 1e9, rel=5e-3, abs=0.0)
    other = result.audit["amplitudes_nm"][2 - harmonic]
    assert other < 5e-3 * found


def test_uncertainty_follows_white_and_coloured_noise():
    for coloured in (False, True):
        score, spread = [], []
        for seed in range(200):
            rng = np.random.default_rng(seed)
            e = rng.standard_normal(N + 30)
            if coloured:  # smooth over 4 samples: nearly all of it at long waves
                e = np.convolve(e, np.ones(4) / 2.0, "same")
            z = 1e-9 * e[15:-15] + 2e-9 * np.cos(2 * np.pi * X / FRINGE)
            result = periodic_error(X, z, period=FRINGE, harmonics=1)
            score.append(result.harmonics["periodic"][1] - 2e-9)
            spread.append(result.harmonics_u["periodic"][1])
        scatter = np.sqrt(np.mean(np.abs(score) ** 2) / 2)
        ratio = np.sqrt(np.mean(np.square(spread))) / scatter
        # the larger of two estimates lies above both; 400 values give 4 %
        assert 0.95 < ratio < 1.35


def test_steps_of_a_whole_fringe_hide_the_harmonics():
    x = FRINGE * np.arange(60)
    with pytest.raises(NotSeparableError, match="multiple"):
        periodic_error(x, np.zeros(60), period=FRINGE)
    half = FRINGE / 2 * np.arange(60)  # the second harmonic has the same value everywhere
    with pytest.raises(NotSeparableError):  # and of the first only the cosine is seen
        periodic_error(half, np.zeros(60), period=FRINGE)
    third = FRINGE / 3 * np.arange(60)  # the second is an alias of the first

    result = periodic_error(third, np.cos(2 * np.pi * third / FRINGE) * 1e-9, period=FRINGE)

    assert result.suppressed == [0, 2]
    assert np.isnan(result.harmonics["periodic"][2])
    assert any("hidden" in m for m in result.messages)


def test_a_tenth_of_a_fringe_is_a_parabola():
    x = np.linspace(0, FRINGE / 10, 100)
    with pytest.raises(NotSeparableError, match="fringes"):
        periodic_error(x, 1e-9 * np.cos(2 * np.pi * x / FRINGE), period=FRINGE, degree=3)


def test_gaps_stay_gaps_and_take_no_part():
    z = 3e-9 * np.cos(2 * np.pi * X / FRINGE - 0.7)
    gap = z.copy()
    gap[50:70] = np.nan

    result = periodic_error(X, gap, period=FRINGE)

    assert np.isnan(result.corrected[50:70]).all()
    assert np.isnan(result.u["corrected"][50:70]).all()
    np.testing.assert_allclose(result.periodic, z, rtol=0.0, atol=EXACT * 3e-9)


def test_masked_readings_take_no_part():
    z = 3e-9 * np.cos(2 * np.pi * X / FRINGE - 0.7)
    hole = np.zeros(N, dtype=bool)
    hole[50:70] = True

    result = periodic_error(X, np.ma.array(np.where(hole, 1.0, z), mask=hole), period=FRINGE)

    assert np.isnan(result.corrected[50:70]).all()
    np.testing.assert_allclose(result.periodic, z, rtol=0.0, atol=EXACT * 3e-9)


def test_settings_as_floats_and_positions_in_um():
    z = 3e-9 * np.cos(2 * np.pi * X / FRINGE - 0.7)
    whole = periodic_error(X, z, period=FRINGE, harmonics=2.0, degree=1.0)
    np.testing.assert_array_equal(whole.corrected, periodic_error(X, z, period=FRINGE).corrected)
    assert not whole.messages
    doubtful = periodic_error(1e6 * X + 0.01 * np.sin(np.arange(N)), z, period=FRINGE)
    assert any("both in m" in m for m in doubtful.messages)


@pytest.mark.parametrize("multiple", [2, 4])
def test_a_wavelength_given_for_the_fringe_is_said(multiple):
    """All harmonics are then multiples of 2 (or 4, for double pass)."""
    t = 2 * np.pi * X / FRINGE
    z = 3e-9 * np.cos(t - 0.7) + 1e-9 * np.cos(2 * t + 2.0)
    z += 0.1e-9 * np.random.default_rng(5).standard_normal(N)

    wrong = periodic_error(X, z, period=multiple * FRINGE, harmonics=multiple)
    right = periodic_error(X, z, period=FRINGE)

    assert any(f"period={FRINGE:.6g}" in m for m in wrong.messages)
    assert not any("period=" in m for m in right.messages)


@pytest.mark.parametrize(
    ("x", "z", "settings", "error"),
    [
        (X, np.zeros(3), {}, DataError),
        (X, np.full(N, np.inf), {}, InvalidSamplesError),
        (X[:5], np.zeros(5), {}, MetrosepError),
        (X, np.zeros(N), {"period": 0.0}, DataError),
        (X, np.zeros(N), {"harmonics": 0}, DataError),
        (X, np.zeros(N), {"degree": -1}, DataError),
        (X * 1e-6, np.zeros(N), {}, NotSeparableError),
        (["a"] * N, np.zeros(N), {}, InvalidSamplesError),
        (X, np.zeros(N) + 1j, {}, InvalidSamplesError),
        (X, np.zeros(N), {"period": "a"}, DataError),
        (X, np.zeros(N), {"harmonics": "a"}, DataError),
        (X, np.zeros(N), {"harmonics": 1.5}, DataError),
        (X, np.zeros(N), {"degree": None}, DataError),
        (X, np.zeros(N), {"u_reading": "a"}, DataError),
        (X, np.zeros(N), {"unit": "furlong"}, UnitError),
        (X, np.zeros(N), {"unit": "nm"}, UnitError),
    ],
)
def test_bad_input_is_refused(x, z, settings, error):
    with pytest.raises(error):
        periodic_error(x, z, **{"period": FRINGE, **settings})


def test_real_interferometer_before_and_after_heydemanns_correction(corpus):
    """nmm: radius of the quadrature signals against phase, raw and corrected by the instrument."""
    found = {}
    for name in ("raw", "Heydemann"):
        path = corpus / "nmm" / f"test01_XYZ_f_quad_Z_{name}.csv"
        phase, radius, _ = np.loadtxt(path, delimiter=",", skiprows=1, unpack=True)
        position = np.radians(phase) / (2 * np.pi) * FRINGE
        # a radial error a/R of an offset is an error of a/R rad in phase
        reading = radius / radius.mean() * FRINGE / (2 * np.pi)
        found[name] = periodic_error(position, reading, period=FRINGE, harmonics=4, degree=0)

    raw, after = (np.array(found[n].audit["amplitudes_nm"]) for n in ("raw", "Heydemann"))
    # independent: least squares with numpy gave 8.797, 0.744, 0.226, 3.639 of a radius of 498.5
    np.testing.assert_allclose(
        raw, np.array([8.797, 0.744, 0.226, 3.639]) / 498.49 * 50.3566, rtol=2e-3, atol=0.0
    )
    assert raw[0] == pytest.approx(0.889, abs=0.002)
    assert after[0] < raw[0] / 100  # offset: 0.89 nm -> 4 pm
    assert after[1] < raw[1] / 10  # amplitude and quadrature: 75 pm -> 4 pm
    assert after[3] == pytest.approx(raw[3], rel=0.01, abs=0.0)  # no ellipse has a fourth harmonic
    u = np.array(found["raw"].audit["u_amplitudes_nm"])
    assert math.isfinite(u[0])
    assert (u < raw / 10).all()
