"""Amplitude against wavelength: closed forms, gaps, moving limits, tables of separations."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from metrosep.app.spectrum_views import (
    estimate_view,
    profile_spectrum,
    spectrum_view,
)
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.core.profile import Profile
from metrosep.core.runset import Run, RunSet
from metrosep.separation import separate
from metrosep.spectral import Band

MM, UM, NM, PM = 1e-3, 1e-6, 1e-9, 1e-12

ROUNDING = 1e-6 * PM
"""Transforms of some thousand samples of some 100 nm round by 1e-16 of them times a few."""

N, STEP = 4000, 1 * UM
WAVES = ((4, 300 * NM), (40, 50 * NM), (400, 20 * NM))
"""Waves in the record, and their amplitudes."""


def three_waves() -> Profile:
    i = np.arange(N)
    z = sum(a * np.cos(2 * np.pi * k * i / N + k) for k, a in WAVES)
    return Profile(i * STEP + 7 * MM, np.asarray(z))


def rms_of(*amplitudes: float) -> float:
    return math.sqrt(sum(a * a / 2 for a in amplitudes))


def test_each_wave_reads_its_amplitude_at_its_wavelength():
    view = spectrum_view(profile_spectrum(three_waves(), detrend=None), columns=100_000)
    assert (np.diff(view.wavelength) < 0).all()
    for k, amplitude in WAVES:
        at = np.argmin(np.abs(view.wavelength - N * STEP / k))
        assert view.wavelength[at] == pytest.approx(N * STEP / k, abs=1e-15)
        assert view.amplitude[at] == pytest.approx(amplitude, abs=ROUNDING)
        assert view.amplitude[at + 1] == pytest.approx(amplitude / 2, abs=ROUNDING)
        assert view.amplitude[at + 3] == pytest.approx(0.0, abs=ROUNDING)


@pytest.mark.parametrize(
    ("band", "inside", "outside"),
    [
        (Band(50 * UM, 500 * UM), (50 * NM,), (300 * NM, 20 * NM)),
        (Band(shortest=50 * UM), (300 * NM, 50 * NM), (20 * NM,)),
        (Band(longest=50 * UM), (20 * NM,), (300 * NM, 50 * NM)),
        (Band(), (300 * NM, 50 * NM, 20 * NM), ()),
        (Band(2 * UM, 5 * UM), (), (300 * NM, 50 * NM, 20 * NM)),
        (Band(1.0, 2.0), (), (300 * NM, 50 * NM, 20 * NM)),
    ],
)
def test_the_rms_inside_and_outside_is_that_of_the_waves_there(band, inside, outside):
    found = profile_spectrum(three_waves(), detrend=None).band_rms(band)
    assert found == pytest.approx((rms_of(*inside), rms_of(*outside)), abs=ROUNDING)


def test_a_wave_on_a_limit_is_inside():
    spectrum = profile_spectrum(three_waves(), detrend=None)
    on = N * STEP / 40
    # the bins beside it, half the amplitude each, are outside: 1 - 1/3 of the power is inside
    below, above = N * STEP / 42, N * STEP / 38
    for band in (Band(on, above), Band(below, on)):
        inside, _ = spectrum.band_rms(band)
        share = (1 + 0.25) / 1.5
        assert inside == pytest.approx(50 * NM * math.sqrt(share / 2), abs=ROUNDING)


@settings(deadline=None, derandomize=True, max_examples=60)
@given(st.integers(4, 700), st.floats(0, 2), st.floats(0, 2), st.integers(0, 2**32 - 1))
def test_inside_and_outside_add_up_to_the_weighted_mean_square(n, a, b, seed):
    z = np.random.default_rng(seed).normal(size=n)
    spectrum = profile_spectrum(Profile(np.arange(n) * 0.01, z), detrend=None)
    weights = np.sin(np.pi * np.arange(n) / n) ** 4  # the square of periodic Hann
    expected = (weights * z**2).sum() / weights.sum()
    low, high = sorted((10.0**-a, 10.0**-b))
    for band in (Band(), Band(low, high * 1.01)):
        inside, outside = spectrum.band_rms(band)
        assert inside**2 + outside**2 == pytest.approx(expected, abs=1e-12 * expected + 1e-15)


def test_a_line_is_taken_off_by_default_and_mean_and_nothing_on_demand():
    i = np.arange(N)
    tilted = Profile(i * STEP, 2 * UM + 1e-3 * i * STEP)
    assert profile_spectrum(tilted).band_rms(Band())[0] == pytest.approx(0.0, abs=ROUNDING)
    assert profile_spectrum(tilted, detrend="mean").band_rms(Band())[0] > 100 * NM
    level = profile_spectrum(Profile(i * STEP, np.full(N, 2 * UM)), detrend=None)
    inside, outside = level.band_rms(Band())
    # Hann puts 2/3 of the power of a constant into bin 0, which is in no band
    assert (inside, outside) == pytest.approx(
        (2 * UM * math.sqrt(1 / 3), 2 * UM * math.sqrt(2 / 3)), abs=ROUNDING * 100
    )


def test_the_longest_part_without_a_gap_or_a_refusal_in_words():
    i = np.arange(5000)
    z = 80 * NM * np.cos(2 * np.pi * i / 100)
    z[1000:1010], z[4111] = np.nan, np.nan
    z[1010] = 80 * NM
    profile = Profile(i * STEP, z)
    spectrum = profile_spectrum(profile)
    assert (spectrum.start, spectrum.stop) == pytest.approx((1010 * UM, 4110 * UM), abs=1e-15)
    assert spectrum.n_samples == 3101
    assert spectrum.share_used == pytest.approx(3100 / 4999, abs=1e-12)
    assert "longest part without a gap: 1.01 mm ... 4.11 mm, 62.0 %" in spectrum.messages[0]
    assert spectrum_view(spectrum).messages == spectrum.messages
    with pytest.raises(InvalidSamplesError, match="11 of 5000 samples were not measured"):
        profile_spectrum(profile, gaps="refuse")
    assert profile_spectrum(three_waves(), gaps="refuse").messages == ()


def test_a_hole_in_the_positions_ends_the_part_too():
    keep = np.r_[0:1000, 1300:5000]
    profile = Profile(keep * STEP, np.cos(keep / 9.0))
    spectrum = profile_spectrum(profile)
    assert spectrum.start == pytest.approx(1300 * UM, abs=1e-15)
    assert len(spectrum.messages) == 1  # and it is not resampled across the hole
    with pytest.raises(InvalidSamplesError, match="1 steps are holes, the first at 999 um"):
        profile_spectrum(profile, gaps="refuse")


def test_uneven_positions_are_resampled_and_that_is_said():
    rng = np.random.default_rng(8)
    x = np.sort(np.arange(N) + rng.uniform(-0.3, 0.3, N)) * STEP
    x[0], x[-1] = 0.0, (N - 1) * STEP
    profile = Profile(x, 100 * NM * np.cos(2 * np.pi * x / (N * STEP / 20)))
    spectrum = profile_spectrum(profile, detrend=None)
    assert "positions are not even" in spectrum.messages[0]
    assert "resampled on straight lines every 1 um" in spectrum.messages[0]
    # a wave of 200 samples: chords lose (pi/200)^2 / 2 = 1.2e-4 at most
    assert spectrum.amplitude.max() == pytest.approx(100 * NM, abs=2e-4 * 100 * NM)
    assert spectrum.amplitude.argmax() == 20


def test_peaks_survive_the_reduction_to_columns():
    n = 200_000
    i = np.arange(n)
    z = 1e-9 * np.random.default_rng(1).normal(size=n)
    z += 5 * NM * np.cos(2 * np.pi * 31_415 * i / n)
    spectrum = profile_spectrum(Profile(i * STEP, z))
    view = spectrum_view(spectrum, columns=500)
    assert view.wavelength.size <= 500
    top = view.amplitude.argmax()
    assert view.amplitude[top] == spectrum.amplitude.max()
    assert view.wavelength[top] == pytest.approx(n * STEP / 31_415, abs=1e-15)
    # by a loop: each point is the greatest of the bins between its neighbours' columns
    shown = np.rint(n * STEP / view.wavelength).astype(int)
    assert (np.diff(shown) > 0).all()
    for k in range(1, shown.size - 1):
        between = spectrum.amplitude[shown[k - 1] + 1 : shown[k + 1]]
        beside = max(spectrum.amplitude[shown[k - 1]], spectrum.amplitude[shown[k + 1]])
        assert between.max() <= max(spectrum.amplitude[shown[k]], beside)
    flags = view.in_band.astype(bool)
    assert flags.all()
    part = spectrum_view(spectrum, band=Band(10 * UM, 1 * MM), columns=500)
    expected = (part.wavelength >= 10 * UM * (1 - 1e-9)) & (part.wavelength <= MM * (1 + 1e-9))
    np.testing.assert_array_equal(part.in_band.astype(bool), expected)


def test_bad_input():
    with pytest.raises(TooFewSamplesError, match="has 3 of 3 samples"):
        profile_spectrum(Profile([0.0, 1.0, 2.0], [0.0, 1.0, 0.0]))
    with pytest.raises(TooFewSamplesError, match="has 1 of 1 samples"):
        profile_spectrum(Profile([0.0], [0.0]))
    with pytest.raises(TooFewSamplesError, match="none of the 5 samples"):
        profile_spectrum(Profile(np.arange(5.0), np.full(5, np.nan)))
    with pytest.raises(TooFewSamplesError, match="has 1 of 5 samples"):
        profile_spectrum(Profile(np.arange(5.0), [np.nan, 1.0, np.nan, np.nan, 2.0]))
    with pytest.raises(DataError, match="of a Profile, got ndarray"):
        profile_spectrum(np.zeros(9))
    with pytest.raises(DataError, match='"longest" or "refuse"'):
        profile_spectrum(three_waves(), gaps="fill")
    with pytest.raises(DataError, match="detrend"):
        profile_spectrum(three_waves(), detrend="cubic")
    spectrum = profile_spectrum(three_waves())
    with pytest.raises(DataError, match="a Band of wavelengths, got tuple"):
        spectrum_view(spectrum, band=(1e-3, 2e-3))
    with pytest.raises(DataError, match="columns"):
        spectrum_view(spectrum, columns=0)
    with pytest.raises(DataError, match="a transform is needed"):
        spectrum_view(three_waves())
    with pytest.raises(DataError, match="ErrorEstimate is needed"):
        estimate_view(spectrum)


LENGTH = 100 * MM


def straightness_runs(*, both_ways: bool = False) -> RunSet:
    """Runs with 400 nm at 50 mm that repeats, and a vibration that slides with the feed."""
    rng = np.random.default_rng(11)
    runs = []
    for k, feed in enumerate((10 * MM, 13 * MM, 17 * MM, 23 * MM) * (2 if both_ways else 1)):
        turned = -1 if k >= 4 else 1
        x = np.linspace(0.0, LENGTH, 2001)
        error = 400 * NM * np.cos(2 * np.pi * x / (50 * MM))
        if turned < 0:
            error = error / 2
        z = error + 60 * NM * np.sin(2 * np.pi * 4.0 * x / feed) + rng.normal(0, 20 * NM, x.size)
        runs.append(Run(x[::turned], z[::turned], feed=feed, run_id=f"r{k}"))
    return RunSet(runs)


@pytest.fixture(scope="module")
def estimate():
    return separate(straightness_runs(), method="kono")


def test_the_table_of_a_separation(estimate):
    planted = {
        "wavelength_mm": [10.0, 50.0, 25.0, 5.0],
        "amplitude_nm": [5.0, 400.0, 30.0, 7.0],
        "sd_nm": [1.0, 10.0, 20.0, math.nan],
        "selected": [False, True, False, True],
    }
    view = estimate_view(replace(estimate, spectrum_data=planted), band=Band(10 * MM, 25 * MM))
    assert view.wavelength == pytest.approx(np.array([50, 25, 10, 5]) * MM, abs=1e-15)
    assert view.amplitude == pytest.approx(np.array([400, 30, 5, 7]) * NM, abs=ROUNDING)
    assert view.selected.tolist() == [1, 0, 0, 1]
    assert view.in_band.tolist() == [0, 1, 1, 0]
    low, high = np.array([380, 0, 3, np.nan]) * NM, np.array([420, 70, 7, np.nan]) * NM
    np.testing.assert_allclose(view.low, low, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(view.high, high, rtol=0, atol=ROUNDING)
    # nothing selected lies in the band: what was rejected does not count
    assert view.inside == 0.0
    assert view.outside == pytest.approx(rms_of(400 * NM, 7 * NM), abs=ROUNDING)


def test_where_no_scatter_is_known_there_is_no_repeatability_band(estimate):
    view = estimate_view(estimate)  # Kono's rule with one run for each feedrate
    assert np.isnan(estimate.spectrum_data["sd_nm"]).all()
    assert view.low is None
    assert view.high is None


def test_the_band_of_a_separation_counts_what_was_selected(estimate):
    amplitude = np.array(estimate.spectrum_data["amplitude_nm"]) * NM
    wavelength = np.array(estimate.spectrum_data["wavelength_mm"]) * MM
    chosen = np.array(estimate.spectrum_data["selected"])
    band = Band(20 * MM, 80 * MM)
    view = estimate_view(estimate, band=band)
    within = (wavelength >= 20 * MM) & (wavelength <= 80 * MM)
    assert view.in_band.sum() == within.sum()
    assert view.inside == pytest.approx(rms_of(*amplitude[chosen & within]), abs=ROUNDING)
    assert view.outside == pytest.approx(rms_of(*amplitude[chosen & ~within]), abs=ROUNDING)
    assert view.inside > view.outside


def test_both_directions_are_told_apart():
    both = separate(straightness_runs(both_ways=True), method="kono")
    forward, reverse = (estimate_view(both, direction=d) for d in (1, -1))
    default = estimate_view(both)
    assert "forward shown" in default.messages[0]
    np.testing.assert_array_equal(default.amplitude, forward.amplitude)
    assert reverse.amplitude.max() == pytest.approx(forward.amplitude.max() / 2, abs=20 * NM)
    with pytest.raises(DataError, match="direction is"):
        estimate_view(both, direction=2)


def test_no_spectrum_and_no_such_direction(estimate):
    mean = separate(straightness_runs(), method="mean")
    with pytest.raises(DataError, match='"mean" tells no wavelengths apart'):
        estimate_view(mean)
    with pytest.raises(DataError, match="no reverse direction of its own"):
        estimate_view(estimate, direction=-1)


# ---- the density that a step psd compares with its limit -----------------------------------------


def test_a_density_bears_its_limit_and_the_bands_of_the_verdict():
    """A white profile of 3 nm: 2 sigma^2 dx in all bands; the limit A / f^2 is crossed once."""
    from metrosep.app.spectrum_views import density_frame
    from metrosep.parameters.psd_limits import judge_psd, psd_limit
    from metrosep.spectral.masked import masked_psd

    rng, dx = np.random.default_rng(2), 1e-6
    profile = Profile(np.arange(20_000) * dx, 3e-9 * rng.standard_normal(20_000))
    flat = 2 * 9e-18 * dx / 1e-21  # nm^2 mm
    limit = f"A = {flat:.6g} nm^2 mm, B = 0 from 10 um to 1 mm"
    header, arrays = density_frame(judge_psd(masked_psd(profile), psd_limit(limit)))
    inside = (arrays["wavelength"] >= 10e-6) & (arrays["wavelength"] <= 1e-3)
    np.testing.assert_array_equal(np.isfinite(arrays["limit"]), inside)
    np.testing.assert_allclose(arrays["limit"][inside], flat, rtol=1e-5, atol=0.0)
    assert np.mean(arrays["mean"][inside]) == pytest.approx(flat, rel=0.05, abs=0.0)
    assert header["unit"] == "nm^2 mm"
    assert header["direction"] == "x"
    lows = [b["low"] for b in header["bands"]]
    assert lows == sorted(lows, reverse=True)
    assert header["bands"][0]["high"] == pytest.approx(1e-3, rel=1e-9, abs=0.0)

    steep = (
        f"A = {flat * 20**2:.6g} nm^2 mm, B = 2 from 10 um to 1 mm"  # crossed at 20 per mm: 50 um
    )
    header, arrays = density_frame(judge_psd(masked_psd(profile), psd_limit(steep)))
    verdicts = {b["low"]: b["verdict"] for b in header["bands"]}
    assert all(v == "accept" for low, v in verdicts.items() if low > 70e-6)
    assert all(v == "reject" for low, v in verdicts.items() if low < 30e-6)
    assert header["verdict"] == "reject"
