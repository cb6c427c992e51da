"""The spline filter: against dense matrices, closed-form gains, exact trends, gaps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from metrosep.core.errors import (
    DataError,
    DegenerateFitError,
    InvalidSamplesError,
    NotConvergedError,
    NotUniformError,
    TooFewSamplesError,
)
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.filters._arguments import DoubleFilterError, profile_kind
from metrosep.filters.spline import spline

UM = 1e-6
DENSE = 1e-11
"""Against a dense solution of a small system: its own rounding, relative to heights of order 1."""
LINE = 1e-10
"""The issue's bound for a straight line, relative to its height."""
GAP = 1e-8
"""Areal gaps: the iteration stops at a residual of 1e-10."""


def stiffness(step, cutoff):
    return 1.0 / (2.0 * np.sin(np.pi * step / cutoff))


def operator(n, k, tension=0.0, closed=False):
    """Dense A = I + b k^2 P + (1 - b) k^4 Q of ISO 16610-22, written from its definition."""
    eye = np.eye(n)
    first = np.roll(eye, -1, axis=0) - eye if closed else np.diff(eye, axis=0)
    second = (
        np.roll(eye, -1, axis=0) - 2 * eye + np.roll(eye, 1, axis=0)
        if closed
        else np.diff(eye, 2, axis=0)
    )
    return eye + tension * k**2 * first.T @ first + (1 - tension) * k**4 * second.T @ second


def wave(length, n=2001, dx=0.5 * UM):
    x = np.arange(n) * dx
    return Profile(x, 1e-6 * np.cos(2 * np.pi * x / length))


def projected_gain(before, after):
    """Least-squares amplitude of the wave in the middle half, relative to the input."""
    middle = slice(len(before) // 4, 3 * len(before) // 4)
    z, w = before.z[middle], after.z[middle]
    return float(z @ w / (z @ z))


@pytest.mark.parametrize(
    ("wavelength", "printed", "run"),
    [(160 * UM, 16 / 17, 0.94117), (80 * UM, 0.5, 0.5), (40 * UM, 1 / 17, 0.058866)],
)
def test_gain_of_the_acceptance_table_f06(wavelength, printed, run):
    before = wave(wavelength)

    gain = projected_gain(before, spline(before, cutoff=80 * UM))

    assert abs(gain - printed) < 1e-4
    assert abs(gain - run) < 1e-5


@pytest.mark.parametrize("tension", [0.0, 0.625242, 0.9])
@pytest.mark.parametrize("n_waves", [1, 5, 12, 60])
def test_closed_gain_is_the_formula(n_waves, tension):
    n, dx, cutoff = 600, 1 * UM, 50 * UM
    x = np.arange(n) * dx
    z = np.cos(2 * np.pi * n_waves * np.arange(n) / n + 0.4)

    w = spline(Profile(x, z), cutoff=cutoff, end="closed", tension=tension).z

    r = np.sin(np.pi * n_waves / n) / np.sin(np.pi * dx / cutoff)
    gain = 1 / (1 + tension * r**2 + (1 - tension) * r**4)
    assert np.abs(w - gain * z).max() < DENSE


@pytest.mark.parametrize("tension", [0.0, 0.3, 0.8])
@pytest.mark.parametrize("end", ["natural", "closed"])
def test_profile_is_the_dense_solution(rng, end, tension):
    n, cutoff = 60, 17.0 * UM
    z = rng.standard_normal(n)
    z -= np.polyval(np.polyfit(np.arange(n), z, 1), np.arange(n))

    w = spline(Profile(np.arange(n) * UM, z), cutoff=cutoff, end=end, tension=tension).z

    a = operator(n, stiffness(UM, cutoff), tension, closed=end == "closed")
    assert np.abs(w - np.linalg.solve(a, z)).max() < DENSE


@pytest.mark.parametrize("end", ["natural", "closed"])
def test_profile_with_gaps_is_the_dense_weighted_solution(rng, end):
    n, cutoff = 60, 17.0 * UM
    z = rng.standard_normal(n)
    z[[4, 20, 21, 22, 23, 24, 25, 40]] = np.nan
    weight = (~np.isnan(z)).astype(float)

    low = spline(Profile(np.arange(n) * UM, z), cutoff=cutoff, end=end, fill=True)

    a = operator(n, stiffness(UM, cutoff), closed=end == "closed")
    truth = np.linalg.solve(a - np.eye(n) + np.diag(weight), np.nan_to_num(z))
    assert np.abs(low.z - truth).max() < GAP


@pytest.mark.parametrize("end", ["natural", "closed"])
@pytest.mark.parametrize("gaps", [False, True])
def test_surface_is_the_dense_tensor_product(rng, end, gaps):
    shape, dx, dy = (12, 15), 2 * UM, 3 * UM
    z = rng.standard_normal(shape)
    if gaps:
        z[3:6, 4:9] = np.nan
        z[8, 0] = np.nan

    low = spline(Surface(z, dx, dy), nesting_index=(11 * UM, 19 * UM), end=end, fill=True)

    closed = end == "closed"
    a = np.kron(
        operator(12, stiffness(dy, 19 * UM), closed=closed),
        operator(15, stiffness(dx, 11 * UM), closed=closed),
    )
    weight = (~np.isnan(z)).astype(float).ravel()
    truth = np.linalg.solve(a - np.eye(180) + np.diag(weight), np.nan_to_num(z).ravel())
    assert np.abs(low.z.ravel() - truth).max() < GAP


@pytest.mark.parametrize("samples_per_cutoff", [10, 1000, 20_000])
def test_line_is_kept_at_any_sampling(samples_per_cutoff):
    x = np.linspace(0.0, 1e-2, 3 * samples_per_cutoff)
    line = Profile(x, 3e-3 * x - 1e-4)

    low = spline(line, cutoff=samples_per_cutoff * line.dx)

    assert np.abs(low.z - line.z).max() < LINE * 1e-4


def test_dense_sampling_keeps_its_digits():
    """The plain normal equations are wrong by 0.3 % here; a coarse grid is the reference."""
    coarse, fine = (np.linspace(0.0, 1.0, n) for n in (2001, 100_001))
    shape = np.polynomial.Polynomial([0.1, -1.0, 2.0, 3.0, -4.0])

    low = spline(Profile(fine, shape(fine)), cutoff=0.2).z[::50]
    reference = spline(Profile(coarse, shape(coarse)), cutoff=0.2).z

    assert np.abs(low - reference).max() < 1e-3 * np.ptp(reference)


def test_bilinear_surface_is_kept_with_and_without_gaps():
    y, x = np.mgrid[:40, :50] * UM
    z = 1e-3 * x - 2e-3 * y + 7.0 * x * y + 1e-7
    holes = z.copy()
    holes[5:9, 30:50] = np.nan
    holes[20, 20] = np.nan

    for heights in (z, holes):
        low = spline(Surface(heights, UM, UM), nesting_index=15 * UM, fill=True)
        assert np.abs(low.z - z).max() < GAP * np.ptp(z)


def test_gap_stays_nan_unless_filled():
    z = wave(160 * UM).z.copy()
    z[:3] = z[700:720] = z[-1] = np.nan
    profile = Profile(wave(160 * UM).x, z)

    plain = spline(profile, cutoff=80 * UM)
    filled = spline(profile, cutoff=80 * UM, fill=True)

    assert np.array_equal(np.isnan(plain.z), np.isnan(z))
    assert np.isnan(filled.z).sum() == 4  # never beyond the ends
    assert np.abs(filled.z[650:770] - 0.94117 * wave(160 * UM).z[650:770]).max() < 2e-8


def test_rows_not_measured_are_rows_cut_off(rng):
    z = rng.standard_normal((30, 40))
    framed = np.full((36, 45), np.nan)
    framed[2:32, 5:] = z

    low = spline(Surface(framed, UM, 2 * UM), nesting_index=12 * UM)
    cropped = spline(Surface(z, UM, 2 * UM), nesting_index=12 * UM)

    assert np.array_equal(low.z[2:32, 5:], cropped.z)
    assert np.isnan(low.z).sum() == np.isnan(framed).sum()


def test_bands_add_up_and_carry_kind_origin_and_history():
    profile = wave(80 * UM)
    surface = Surface(np.outer(profile.z[:40], np.ones(30)), UM, UM, origin=(1.0, 2.0))

    low, high = (spline(profile, cutoff=80 * UM, band=b) for b in ("long", "short"))
    areal = spline(surface, nesting_index=10 * UM, band="short")

    assert np.abs(low.z + high.z - profile.z).max() < 1e-20
    assert (profile_kind(low), profile_kind(high)) == (None, "R")
    assert high.history[-1].name == "spline"
    assert high.history[-1].parameters["cutoff_m"] == 80 * UM
    assert areal.origin == (1.0, 2.0)
    assert areal.history[-1].parameters["nesting_index_y_m"] == 10 * UM


@settings(deadline=None, max_examples=15, derandomize=True)
@given(st.floats(-9, 9), st.floats(-9, 9), st.integers(0, 5))
def test_units_reversal_and_transposition(height, length, seed):
    heights, lengths = 10.0**height, 10.0**length
    z = np.random.default_rng(seed).standard_normal((9, 14))
    z[3, 5] = np.nan
    low = spline(Surface(z, 1.0, 2.0), nesting_index=(6.0, 8.0)).z

    scaled = spline(
        Surface(heights * z, lengths, 2 * lengths), nesting_index=(6 * lengths, 8 * lengths)
    ).z
    turned = spline(Surface(z.T, 2.0, 1.0), nesting_index=(8.0, 6.0)).z
    mirrored = spline(Surface(z[:, ::-1], 1.0, 2.0), nesting_index=(6.0, 8.0)).z

    assert np.nanmax(np.abs(scaled / heights - low)) < GAP
    assert np.nanmax(np.abs(turned.T - low)) < GAP
    assert np.nanmax(np.abs(mirrored[:, ::-1] - low)) < GAP


def test_integers_are_taken_as_metres():
    low = spline(Profile(np.arange(10), np.arange(10)), cutoff=4)

    assert np.abs(low.z - np.arange(10)).max() < LINE


@pytest.mark.parametrize(
    ("options", "error", "match"),
    [
        ({"nesting_index": 8e-5}, DataError, "a profile takes cutoff="),
        ({}, DataError, "needs cutoff="),
        ({"cutoff": 0.9e-6}, DataError, "does not exceed the sampling limit"),
        ({"cutoff": 1.1e-3}, DataError, "longer than what was measured"),
        ({"cutoff": -1e-6}, InvalidSamplesError, "positive and finite"),
        ({"cutoff": np.inf}, InvalidSamplesError, "positive and finite"),
        ({"cutoff": "0.8"}, DataError, "cutoff"),
        ({"cutoff": 8e-5, "band": "middle"}, DataError, "band is one of"),
        ({"cutoff": 8e-5, "end": "mirror"}, DataError, "end is one of"),
        ({"cutoff": 8e-5, "tension": 1.1}, DataError, "tension must be between"),
    ],
)
def test_bad_options_of_a_profile(options, error, match):
    with pytest.raises(error, match=match):
        spline(wave(80 * UM), **options)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"cutoff": 5e-6}, "a surface takes nesting_index="),
        ({}, "needs nesting_index="),
        ({"nesting_index": (5e-6, 6e-6, 7e-6)}, "a pair"),
        ({"nesting_index": (5e-6, 1e-3)}, "nesting_index in y .* longer"),
    ],
)
def test_bad_options_of_a_surface(options, match):
    with pytest.raises(DataError, match=match):
        spline(Surface(np.zeros((20, 20)), UM, UM), **options)


def test_bad_data():
    x = np.arange(20) * UM
    with pytest.raises(TooFewSamplesError, match="at least 3 measured samples, got 0"):
        spline(Profile(x, np.full(20, np.nan)), cutoff=5 * UM)
    with pytest.raises(TooFewSamplesError, match="got 1"):
        spline(Profile([0.0], [0.0]), cutoff=5 * UM)
    with pytest.raises(NotUniformError):
        spline(Profile(x**2, x), cutoff=5 * UM)
    with pytest.raises(DataError, match="no lateral step dy"):
        spline(Surface(np.zeros((20, 20)), UM), nesting_index=5 * UM)
    with pytest.raises(TooFewSamplesError, match="3 measured rows"):
        spline(Surface(np.zeros((2, 20)), UM, UM), nesting_index=5 * UM)
    with pytest.raises(DegenerateFitError, match="samples per cut-off"):
        spline(Profile(np.arange(1_200_001), np.zeros(1_200_001)), cutoff=1.1e6)


def test_pixels_on_a_cross_do_not_determine_a_surface():
    z = np.full((11, 11), np.nan)
    z[5] = z[:, 5] = 0.0
    with pytest.raises(DegenerateFitError, match="do not determine"):
        spline(Surface(z, UM, UM), nesting_index=5 * UM)


def test_too_few_iterations_are_told(rng):
    z = rng.standard_normal((20, 20))
    z[5:15, 5:15] = np.nan
    with pytest.raises(NotConvergedError, match="in 2 iterations"):
        spline(Surface(z, UM, UM), nesting_index=5 * UM, max_iterations=2)


def test_roughness_is_not_filtered_again():
    rough = spline(wave(80 * UM), cutoff=80 * UM, band="short")
    with pytest.raises(DoubleFilterError, match="refilter=True"):
        spline(rough, cutoff=80 * UM)
    assert len(spline(rough, cutoff=80 * UM, refilter=True)) == len(rough)


@pytest.fixture
def rng():
    return np.random.default_rng(16610)


def test_closed_profile_that_repeats_its_first_sample_is_refused():
    t = np.linspace(0.0, 2.0 * np.pi, 721)
    with pytest.raises(InvalidSamplesError, match="drop the last sample"):
        spline(Profile(t, np.cos(t)), cutoff=0.4, end="closed")
    assert len(spline(Profile(t[:-1], np.cos(t[:-1])), cutoff=0.4, end="closed")) == 720
    assert len(spline(Profile(t, np.cos(t)), cutoff=0.4)) == 721


def test_waviness_stays_waviness_in_both_bands():
    p = Profile(np.arange(300) * UM, np.zeros(300), metadata={"profile_kind": "W"})

    assert [profile_kind(spline(p, cutoff=50 * UM, band=b)) for b in ("long", "short")] == [
        "W"
    ] * 2


def test_surface_is_not_filtered_short_twice():
    s = Surface(np.random.default_rng(12).normal(size=(40, 40)), UM, UM)
    rough = spline(s, nesting_index=20 * UM, band="short")

    with pytest.raises(DoubleFilterError, match="spline"):
        spline(rough, nesting_index=20 * UM, band="short")
    again = spline(rough, nesting_index=20 * UM, band="short", refilter=True)
    assert np.abs(again.z).sum() < np.abs(rough.z).sum()  # too small: why it is refused
    assert spline(rough, nesting_index=5 * UM).shape == (40, 40)


@pytest.mark.parametrize("obj", [np.zeros(300), None])
def test_what_is_no_profile_and_no_surface_is_refused(obj):
    with pytest.raises(DataError, match="needs a Profile or Surface, got"):
        spline(obj, cutoff=50 * UM)


@pytest.mark.parametrize("options", [{"tension": "a"}, {"max_iterations": 2.5}])
def test_options_that_are_no_numbers_are_refused(options):
    with pytest.raises(DataError, match=next(iter(options))):
        spline(Profile(np.arange(300) * UM, np.zeros(300)), cutoff=50 * UM, **options)
