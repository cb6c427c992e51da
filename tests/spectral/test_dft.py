"""Fourier sums at exact wavelengths."""

import numpy as np
import pytest

from metrosep.errors import DataError
from metrosep.spectral import fourier_basis, fourier_coefficients

PM = 1e-12


def test_uniform_grid_agrees_with_the_fast_fourier_transform(rng):
    n, period = 256, 64e-3
    z = rng.standard_normal(n) * 1e-6
    x = 5e-3 + np.arange(n) * period / n

    ours = fourier_coefficients(x, z, origin=5e-3, period=period, n_harmonics=40)

    reference = 2.0 / n * np.fft.rfft(z)[1:41].conj()
    np.testing.assert_allclose(ours, reference, atol=PM * 1e-3, rtol=0)


def test_planted_cosine_and_sine_come_back_with_their_signs():
    x = np.arange(1000) * 45e-6
    z = 3e-7 * np.cos(2 * np.pi * 4 * x / 45e-3) - 2e-7 * np.sin(2 * np.pi * 4 * x / 45e-3)

    c = fourier_coefficients(x, z, origin=0.0, period=45e-3, n_harmonics=6)

    assert c[3].real == pytest.approx(3e-7, abs=PM)
    assert c[3].imag == pytest.approx(-2e-7, abs=PM)
    assert np.abs(np.delete(c, 3)).max() < PM


def test_wavelength_does_not_depend_on_the_pitch():
    """Three feedrates, one 10 mm wave: the same coefficient at k = 7 of 70 mm."""
    amplitudes = []
    for pitch in (0.08e-3, 0.12e-3, 0.16e-3):
        x = np.arange(0.0, 70e-3, pitch)
        z = 1e-6 * np.cos(2 * np.pi * x / 10e-3 + 0.4)
        c = fourier_coefficients(x, z, origin=0.0, period=70e-3, n_harmonics=17)
        amplitudes.append(c[6])

    np.testing.assert_allclose(amplitudes, amplitudes[0], atol=5e-9, rtol=0)


def test_basis_and_coefficients_use_the_same_convention(rng):
    x = np.arange(400) * 0.1e-3
    c = rng.standard_normal(5) + 1j * rng.standard_normal(5)
    z = fourier_basis(x, origin=1e-3, period=40e-3, n_harmonics=5) @ np.r_[c.real, c.imag]

    back = fourier_coefficients(x, z, origin=1e-3, period=40e-3, n_harmonics=5)

    np.testing.assert_allclose(back, c, atol=1e-12, rtol=0)


def test_nan_raises():
    with pytest.raises(DataError, match="NaN"):
        fourier_coefficients([0, 1, 2], [0, np.nan, 0], origin=0, period=3, n_harmonics=1)


@pytest.mark.parametrize("n_harmonics", [0, 1, 15, 16, 17, 75, 400])
def test_basis_of_many_harmonics_is_that_of_each(n_harmonics):
    rng = np.random.default_rng(4)
    x = rng.uniform(-0.3, 0.7, 40)

    basis = fourier_basis(x, origin=0.1, period=0.35, n_harmonics=n_harmonics)

    each = [2 * np.pi * k * (x - 0.1) / 0.35 for k in range(1, n_harmonics + 1)]
    expected = np.array([np.cos(p) for p in each] + [np.sin(p) for p in each]).T
    # rounding of phases up to 2 pi 400 * 2
    np.testing.assert_allclose(basis, expected.reshape(basis.shape), rtol=0, atol=5e-12)
