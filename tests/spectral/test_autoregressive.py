"""Noise models: known coefficients, known spectrum, gaps."""

import numpy as np
import pytest
from scipy.signal import lfilter

from metrosep.errors import TooFewSamplesError
from metrosep.spectral import AutoregressiveModel, fit_autoregressive, pooled_periodogram, whiten

ROUNDING = 1e-12


def resonance(rng, n, a=(1.6, -0.9)):
    return lfilter([1.0], [1.0, -a[0], -a[1]], rng.standard_normal(n + 500))[500:]


def test_known_coefficients_are_found(rng):
    records = [resonance(rng, 4000) for _ in range(4)]

    model, n_rows, _ = fit_autoregressive(records, orders=[2], time_step=1e-3)

    assert n_rows == 4 * 3998
    np.testing.assert_allclose(model.coefficients, [1.6, -0.9], atol=0.02, rtol=0)
    assert model.variance == pytest.approx(1.0, abs=0.05)


def test_aicc_picks_the_planted_order_class(rng):
    records = [resonance(rng, 3000) for _ in range(3)]

    model, _, aicc = fit_autoregressive(records, orders=[1, 2, 4, 8, 16], time_step=1e-3)

    assert model.order in (2, 4)
    assert aicc[1] > aicc[2]


def test_whitening_inverts_the_recursion(rng):
    noise = rng.standard_normal(50)
    a = np.array([0.5, -0.2, 0.1])
    series = lfilter([1.0], np.r_[1.0, -a], noise)

    np.testing.assert_allclose(whiten(series, a), noise[3:], atol=ROUNDING, rtol=0)


def test_model_spectrum_integrates_to_the_variance_and_peaks_at_the_resonance():
    a = np.array([1.6, -0.9])
    model = AutoregressiveModel(a, 1.0, 1e-3)
    f = np.linspace(0, 500, 200_001)
    variance = (1 - a[1]) / ((1 + a[1]) * ((1 - a[1]) ** 2 - a[0] ** 2))

    assert np.trapezoid(model.psd(f), f) == pytest.approx(variance, rel=1e-4, abs=0.0)
    expected = np.arccos(a[0] * (1 - a[1]) / (-4 * a[1])) / (2 * np.pi) * 1000
    assert f[model.psd(f).argmax()] == pytest.approx(expected, abs=0.1)


def test_windows_that_touch_a_gap_are_left_out(rng):
    record = resonance(rng, 5000)
    with_gap = record.copy()
    with_gap[1000:1200] = np.nan

    model, n_rows, _ = fit_autoregressive([with_gap], orders=[2], time_step=1e-3)

    assert n_rows == 5000 - 2 - 200 - 2
    np.testing.assert_allclose(model.coefficients, [1.6, -0.9], atol=0.03, rtol=0)


def test_too_short_raises():
    with pytest.raises(TooFewSamplesError, match="unbroken windows"):
        fit_autoregressive([np.zeros(10)], orders=[4], time_step=1e-3)


def test_periodogram_of_white_noise_integrates_to_its_variance(rng):
    records = [3.0 * rng.standard_normal(4096) for _ in range(8)]

    f, density = pooled_periodogram(records, time_step=1e-3)

    assert density.sum() * (f[1] - f[0]) == pytest.approx(9.0, rel=0.03, abs=0.0)


def test_periodogram_finds_a_planted_line():
    t = np.arange(4096) * 1e-3

    f, density = pooled_periodogram([np.sin(2 * np.pi * 150 * t)], time_step=1e-3)

    assert f[density.argmax()] == pytest.approx(150, abs=1.0)
    assert density.sum() * (f[1] - f[0]) == pytest.approx(0.5, rel=0.01, abs=0.0)
