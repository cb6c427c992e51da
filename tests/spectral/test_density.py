"""Spectra: Parseval, closed-form lines, windows, bands, unequal pixels."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotUniformError,
    TooFewSamplesError,
)
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.spectral.density import (
    amplitude_spectrum,
    areal_psd,
    band_rms,
    profile_psd,
    radial_psd,
)
from metrosep.spectral.dft import Band
from metrosep.spectral.window import coherent_gain, hann_weights, noise_bandwidth, taper_weights

UM, NM = 1e-6, 1e-9
PARSEVAL = 1e-12
"""Relative; the issue's bound."""
LINE = 1e-9
"""A wave on a bin, relative to its amplitude: rounding of the transform."""


@pytest.fixture
def rng():
    return np.random.default_rng(8)


@pytest.mark.parametrize("n", [4, 5, 999, 1000])
def test_profile_integrates_to_the_variance(rng, n):
    z = rng.standard_normal(n) * NM + 5 * NM

    psd = profile_psd(Profile(np.arange(n) * 0.3 * UM, z))
    raw = profile_psd(Profile(np.arange(n) * 0.3 * UM, z), detrend=None)

    assert abs(psd.variance() / z.var() - 1) < PARSEVAL
    assert abs(raw.density.sum() * raw.frequency[1] / np.mean(z**2) - 1) < PARSEVAL
    assert psd.unit == "m^3"


@pytest.mark.parametrize("window", ["hann", 0.1, 0.7])
def test_profile_with_window_integrates_to_the_weighted_mean_square(rng, window):
    z = rng.standard_normal(501)
    w = (
        np.sin(np.pi * np.arange(501) / 501) ** 2
        if window == "hann"
        else taper_weights(501, window)
    )

    psd = profile_psd(Profile(np.arange(501.0), z), window=window, detrend=None)

    truth = np.sum((w * z) ** 2) / np.sum(w**2)
    assert abs(psd.density.sum() * psd.frequency[1] / truth - 1) < PARSEVAL


@pytest.mark.parametrize("shape", [(20, 31), (33, 16), (4, 5)])
def test_surface_integrates_to_the_variance(rng, shape):
    z = rng.standard_normal(shape) * NM
    surface = Surface(z, 0.5 * UM, 2 * UM)

    areal, radial = areal_psd(surface), radial_psd(surface)

    assert abs(areal.variance() / z.var() - 1) < PARSEVAL
    assert abs(radial.variance() / z.var() - 1) < PARSEVAL
    assert areal.density.shape == shape
    assert (areal.unit, radial.unit) == ("m^4", "m^4")
    assert radial.n_averaged.sum() >= (z.size - 1) // 2
    cells = radial.area.sum() / areal.cell
    assert round(cells) == z.size - 1


def test_white_noise_has_the_level_of_its_variance_per_bandwidth(rng):
    z = rng.standard_normal((256, 256))
    level = 1.0 * (0.5 * UM) * (2 * UM)  # variance over the area 1 / (dx dy) of the spectrum

    for window in ("none", "hann"):
        radial = radial_psd(Surface(z, 0.5 * UM, 2 * UM), window=window)
        wide = radial.n_averaged > 50
        scatter = (radial.density[wide] / level - 1) * np.sqrt(radial.n_averaged[wide])
        assert abs(radial.density @ radial.area / 1.0 - 1) < 0.03
        # neighbouring bins are dependent under Hann: 35/18 squared is the variance in two axes
        assert scatter.std() < (1.3 if window == "none" else 1.3 * 35 / 18)
    assert np.array_equal(radial.u, radial.density / np.sqrt(radial.n_averaged))


def test_radial_density_of_white_noise_with_2_pi_f_df(rng):
    """The textbook sum is right within the Nyquist circle."""
    z = rng.standard_normal((400, 400))
    radial = radial_psd(Surface(z, 1.0, 1.0))
    inside = radial.frequency < 0.49

    df = 1 / 400
    textbook = np.sum(radial.density[inside] * 2 * np.pi * radial.frequency[inside] * df)
    exact = radial.density[inside] @ radial.area[inside]

    assert abs(textbook / exact - 1) < 2e-3


def test_wave_stands_on_its_bin_in_both_axes():
    """Planted asymmetry: 6 waves in x, 2 in y, pixels 1 x 3 um."""
    n_y, n_x = 24, 40
    j, i = np.mgrid[:n_y, :n_x]
    z = NM * np.cos(2 * np.pi * (6 * i / n_x + 2 * j / n_y))

    psd = areal_psd(Surface(z, 1 * UM, 3 * UM))

    found = np.argwhere(psd.density > 0.1 * psd.density.max())
    places = {
        (round(psd.frequency_y[a] * 72e-6), round(psd.frequency_x[b] * 40e-6)) for a, b in found
    }
    assert places == {(2, 6), (-2, -6)}
    assert abs(psd.density.max() * psd.cell / (NM**2 / 4) - 1) < LINE
    wavelength = 1 / np.hypot(6 / 40e-6, 2 / 72e-6)
    assert (
        abs(band_rms(psd, Band(wavelength * 0.999, wavelength * 1.001)) / (NM / 2**0.5) - 1) < LINE
    )
    radial = radial_psd(Surface(z, 1 * UM, 3 * UM))
    peak = radial.frequency[np.argmax(radial.density)]
    assert abs(peak - 1 / wavelength) < 1 / 40e-6


def test_hann_reads_the_amplitude_s01():
    """Acceptance row S01: 50 at bin 40, 25 at 39 and 41 nm."""
    i = np.arange(4000)
    z = 50 * NM * np.cos(2 * np.pi * 40 * i / 4000 + 0.3)

    spectrum = amplitude_spectrum(Profile(i * UM, z), window="hann")

    expected = np.zeros(2001)
    expected[[39, 40, 41]] = 25 * NM, 50 * NM, 25 * NM
    assert np.abs(spectrum.amplitude - expected).max() < 50 * NM * LINE
    assert abs(spectrum.phase[40] - 0.3) < LINE
    assert abs(1 / spectrum.frequency[40] - 100 * UM) < LINE * UM


@pytest.mark.parametrize("n", [64, 65])
def test_amplitudes_at_zero_and_nyquist(n):
    i = np.arange(n)
    z = 3.0 + 2.0 * (-1.0) ** i

    spectrum = amplitude_spectrum(Profile(i, z), window="none", detrend=None)

    if n % 2 == 0:
        assert abs(spectrum.amplitude[0] - 3.0) < LINE
        assert abs(spectrum.amplitude[-1] - 2.0) < LINE
    psd = profile_psd(Profile(i, z))
    assert abs(psd.variance() / z.var() - 1) < PARSEVAL


def test_periodic_hann_gain_and_bandwidth():
    for n in (16, 101):
        w = hann_weights(n)
        assert abs(coherent_gain(w) - 0.5) < 1e-15
        assert abs(noise_bandwidth(w) - 1.5) < 1e-14
        assert np.abs(np.fft.rfft(w)[2:]).max() < 1e-13 * n
        assert np.array_equal(taper_weights(n, 1.0), w)
        assert np.array_equal(taper_weights(n, 0.0), np.ones(n))
        assert np.abs(w[1:] - w[:0:-1]).max() < 1e-15
    flat = taper_weights(1000, 0.2)
    assert (flat[100:901] == 1.0).all()
    assert flat[99] < 1.0
    assert abs(coherent_gain(flat) - 0.9) < 1e-12


def test_one_sided_bands_are_not_lost():
    """prysm's band-limited RMS takes the whole spectrum when only one limit is given."""
    x = np.arange(1000) * UM
    z = 1 * NM * np.cos(2 * np.pi * x / (10 * UM)) + 3 * NM * np.cos(2 * np.pi * x / (100 * UM))
    surface = Surface(np.broadcast_to(z, (8, 1000)), UM, UM)

    square = Surface(np.broadcast_to(z, (1000, 1000)), UM, UM)

    for psd in (profile_psd(Profile(x, z)), areal_psd(surface), radial_psd(square)):
        limits = [
            ({"longest": 50 * UM}, 1.0),
            ({"shortest": 50 * UM}, 3.0),
            ({"shortest": 5 * UM, "longest": 20 * UM}, 1.0),
            ({}, 10**0.5),
        ]
        for sides, amplitude in limits:
            assert abs(band_rms(psd, Band(**sides)) / NM * 2**0.5 - amplitude) < LINE
    ends = Band(10 * UM, 100 * UM)  # both waves lie on a limit and belong to the band
    assert abs(band_rms(profile_psd(Profile(x, z)), ends) / NM * 2**0.5 - 10**0.5) < LINE


def test_bands_add_up_to_the_variance(rng):
    profile = Profile(np.arange(500), rng.standard_normal(500))
    psd = profile_psd(profile)

    parts = [Band(longest=7.03), Band(7.03, 40.1), Band(shortest=40.1)]

    assert abs(sum(band_rms(psd, b) ** 2 for b in parts) / profile.z.var() - 1) < PARSEVAL


def test_line_and_plane_are_taken_off(rng):
    noise = rng.standard_normal((30, 40))
    y, x = np.mgrid[:30, :40]
    basis = np.stack([np.ones(1200), x.ravel(), y.ravel()], axis=1)
    residual = noise.ravel() - basis @ np.linalg.lstsq(basis, noise.ravel(), rcond=None)[0]

    areal = areal_psd(Surface(noise + 3 * x - 7 * y + 2, 1, 1), detrend="plane")
    line = profile_psd(Profile(np.arange(40), noise[0] + 5 * np.arange(40)), detrend="line")

    truth = noise[0] - np.polyval(np.polyfit(np.arange(40), noise[0], 1), np.arange(40))
    assert abs(areal.variance() / residual.var() - 1) < 1e-10
    assert abs(line.variance() / truth.var() - 1) < 1e-10


@settings(deadline=None, max_examples=20, derandomize=True)
@given(st.floats(-9, 9), st.floats(-9, 9), st.integers(0, 9))
def test_units_sign_reversal_and_transposition(height, length, seed):
    a, b = 10.0**height, 10.0**length
    z = np.random.default_rng(seed).standard_normal((10, 13))
    psd = areal_psd(Surface(z, 1.0, 2.0), window="hann")

    scaled = areal_psd(Surface(a * z, b, 2 * b), window="hann")
    turned = areal_psd(Surface(z.T, 2.0, 1.0), window="hann")
    flipped = areal_psd(Surface(-z, 1.0, 2.0), window="hann")

    top = psd.density.max()
    assert np.abs(scaled.density / (a**2 * b**2) - psd.density).max() < PARSEVAL * top
    assert np.abs(turned.density.T - psd.density).max() < PARSEVAL * top
    assert np.abs(flipped.density - psd.density).max() < PARSEVAL * top
    assert np.abs(scaled.frequency_y * b - psd.frequency_y).max() < PARSEVAL
    profile = profile_psd(Profile(np.arange(13), z[0]))
    mirrored = profile_psd(Profile(np.arange(13), z[0, ::-1]))
    assert np.abs(mirrored.density - profile.density).max() < PARSEVAL * profile.density.max()


def test_results_are_locked_and_carry_history():
    profile = Profile(np.arange(8), np.arange(8) % 3)
    psd = profile_psd(profile, window=0.5)

    assert psd.history[-1].parameters["window"] == 0.5
    with pytest.raises(ValueError, match="read-only"):
        psd.density[0] = 1.0
    assert profile_psd(Profile(np.arange(8), np.full(8, 4.0))).variance() == 0.0


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"window": "hanning"}, "window must be"),
        ({"window": 1.5}, "must be between 0 and 1"),
        ({"detrend": "plane"}, "detrend is one of mean, line"),
    ],
)
def test_bad_options(options, match):
    with pytest.raises(DataError, match=match):
        profile_psd(Profile(np.arange(8), np.zeros(8)), **options)


def test_bad_data():
    with pytest.raises(InvalidSamplesError, match=r"1 of 5 samples of the profile .* crop"):
        profile_psd(Profile(np.arange(5), [0, 1, np.nan, 0, 1]))
    with pytest.raises(InvalidSamplesError, match="25 of 25 pixels"):
        radial_psd(Surface(np.full((5, 5), np.nan), 1, 1))
    with pytest.raises(TooFewSamplesError, match="at least 4"):
        amplitude_spectrum(Profile([0, 1, 2], [0, 1, 2]))
    with pytest.raises(TooFewSamplesError, match="got shape"):
        areal_psd(Surface(np.zeros((3, 9)), 1, 1))
    with pytest.raises(NotUniformError):
        profile_psd(Profile([0, 1, 2, 4], [0, 1, 2, 3]))
    with pytest.raises(DataError, match="no lateral step"):
        areal_psd(Surface(np.zeros((5, 5)), 1))
    with pytest.raises(DataError, match="whole number from 1"):
        hann_weights(0)
    with pytest.raises(DataError, match="no wave of the data lies in"):
        band_rms(profile_psd(Profile(np.arange(8), np.arange(8))), Band(longest=1.5))


@pytest.mark.parametrize("call", [profile_psd, amplitude_spectrum])
@pytest.mark.parametrize("obj", [Surface(np.eye(9), 1.0, 1.0), np.zeros(9), None])
def test_what_is_no_profile_is_refused(call, obj) -> None:
    with pytest.raises(DataError, match=f"needs a Profile, got {type(obj).__name__}"):
        call(obj)


@pytest.mark.parametrize("call", [areal_psd, radial_psd])
@pytest.mark.parametrize("obj", [Profile(np.arange(9.0), np.zeros(9)), np.zeros((9, 9)), None])
def test_what_is_no_surface_is_refused(call, obj) -> None:
    with pytest.raises(DataError, match=f"needs a Surface, got {type(obj).__name__}"):
        call(obj)


@pytest.mark.parametrize("limits", [("a", 1), (1, "a"), (True, 2), ([1, 2], 3)])
def test_band_limits_that_are_no_numbers_are_refused(limits) -> None:
    with pytest.raises(DataError, match="wavelength of a band"):
        Band(*limits)


@pytest.mark.parametrize("n", [2.5, "a", True, 0, -1, None])
def test_window_of_no_whole_number_of_samples_is_refused(n) -> None:
    with pytest.raises(DataError, match="whole number from 1"):
        hann_weights(n)
    with pytest.raises(DataError, match="whole number from 1"):
        taper_weights(n, 0.5)


def test_taper_of_no_number_is_refused() -> None:
    with pytest.raises(DataError, match="tapered fraction"):
        taper_weights(8, "a")
