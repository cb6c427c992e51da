"""Robust Gaussian regression: against least squares at each point, closed-form gains, outliers, gaps."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from metrosep.core.errors import (
    DataError,
    DegenerateFitError,
    NotConvergedError,
    TooFewSamplesError,
)
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.filters import robust
from metrosep.filters._arguments import DoubleFilterError, profile_kind
from metrosep.filters.robust import regression_constant, robust_gaussian

UM = 1e-6
EXACT = 1e-13
"""A polynomial of the degree of the regression, relative to its height: rounding only."""
DIRECT = 1e-8
"""Against least squares at each point: the window is cut at 5e-13 and tolerance is 1e-11."""
ON_NODES = 3e-3
"""Of the standard deviation: a cubic spline through nodes a tenth of the cut-off apart."""
GAIN = 1e-6
"""Against a closed-form gain: the sampled Gaussian and the cut window."""


def regress_at_each_point(z, positions, widths, order, weights):
    """Weighted least squares at each point; positions (n, axes), widths = a Lc per axis."""
    exponents = [
        e
        for e in itertools.product(range(order + 1), repeat=positions.shape[1])
        if sum(e) <= order
    ]
    exponents.sort(key=sum)
    t = (positions[None] - positions[:, None]) / widths  # [i, j]: from point i to sample j
    kernel = weights * np.exp(-np.pi * (t**2).sum(axis=2))
    basis = np.stack([np.prod(t**e, axis=2) for e in exponents], axis=2)
    matrix = np.einsum("ij,ija,ijb->iab", kernel, basis, basis, optimize=True)
    right = np.einsum("ij,ija,j->ia", kernel, basis, z, optimize=True)
    return np.linalg.solve(matrix, right[..., None])[:, 0, 0]


def robust_at_each_point(z, positions, widths, order, iterations=60):
    """Iterate after ISO 16610-31 without any safeguard; z flat, NaN = weight 0."""
    valid = ~np.isnan(z)
    heights = np.where(valid, z, 0.0)
    weights = valid.astype(float)
    for _ in range(iterations):
        low = regress_at_each_point(heights, positions, widths, order, weights)
        r = np.abs(heights - low)
        c = 4.4478 * np.median(r[valid])
        weights = valid * np.where(r < c, (1 - (r / c) ** 2) ** 2, 0.0)
    return np.where(valid, low, np.nan)


@pytest.mark.parametrize("order", [0, 1, 2])
def test_profile_is_least_squares_at_each_point(order):
    rng = np.random.default_rng(order)
    x = np.arange(70.0)
    z = np.sin(x / 9) + 0.3 * rng.standard_normal(70)
    z[[10, 40]] += 8.0
    z[25:31] = np.nan

    low = robust_gaussian(
        Profile(x, z), cutoff=20.0, order=order, tolerance=1e-11, max_iterations=500
    )

    a = {0: 0.4697186393, 1: 0.4697186393, 2: 0.7309134281}[order]
    truth = robust_at_each_point(z, x[:, None], a * 20.0, order)
    assert np.array_equal(np.isnan(low.z), np.isnan(z))
    assert np.nanmax(np.abs(low.z - truth)) < DIRECT


@pytest.mark.parametrize("order", [0, 1, 2])
def test_surface_is_least_squares_at_each_point(order):
    rng = np.random.default_rng(order)
    z = 0.3 * rng.standard_normal((8, 11))
    z[3, 4] += 5.0
    z[5:7, 6:9] = np.nan
    y, x = np.mgrid[:8, :11].astype(float)
    y *= 2.0

    low = robust_gaussian(
        Surface(z, 1.0, 2.0),
        nesting_index=(7.0, 10.0),
        order=order,
        tolerance=1e-11,
        max_iterations=900,
    )

    widths = regression_constant(order) * np.array([7.0, 10.0])
    positions = np.stack([x.ravel(), y.ravel()], axis=1)
    truth = robust_at_each_point(z.ravel(), positions, widths, order, iterations=100)
    assert np.nanmax(np.abs(low.z.ravel() - truth)) < DIRECT


def test_constants_make_one_half():
    u1, u2 = (np.pi * regression_constant(p) ** 2 for p in (1, 2))

    assert abs(np.exp(-u1) - 0.5) < 1e-15
    assert abs((1 + u2) * np.exp(-u2) - 0.5) < 1e-15
    assert regression_constant(0) == regression_constant(1)
    assert abs(regression_constant(2) - 0.7309134) < 5e-8  # the specification's digits


@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize("ratio", [0.5, 1.0, 2.0])
def test_linear_gain_in_the_interior(order, ratio):
    x = np.arange(4001) * 0.5 * UM
    z = np.cos(2 * np.pi * (x - x[2000]) / (80 * UM * ratio))

    low = robust_gaussian(Profile(x, z), cutoff=80 * UM, order=order, robust=False)

    u = np.pi * regression_constant(order) ** 2 / ratio**2
    gain = np.exp(-u) * (1 + u if order == 2 else 1)
    assert abs(low.z[2000] - gain) < GAIN


def test_areal_gain_of_order_2_is_one_half_along_an_axis():
    x = np.arange(201) * UM
    z = np.broadcast_to(np.cos(2 * np.pi * (x - x[100]) / (30 * UM)), (151, 201))

    low = robust_gaussian(Surface(z, UM, UM), nesting_index=30 * UM, robust=False, exact=True)
    nodes = robust_gaussian(Surface(z, UM, UM), nesting_index=30 * UM, robust=False)

    assert abs(low.z[75, 100] - 0.5) < GAIN
    assert np.abs(nodes.z - low.z).max() < ON_NODES


def test_areal_reference_values():
    """Heights worked out by a program of its own, and by a weighted regression at one pixel."""
    y, x = np.mgrid[0:64, 0:64].astype(float)
    z = 3 * np.sin(2 * np.pi * x / 50) + 0.5 * np.cos(2 * np.pi * y / 9) + 0.02 * x
    z[20:24, 30:33] -= 40.0
    z[40, 10] += 25.0
    z[5:7, 50:60] = np.nan
    expected = {
        (32, 32): -1.35834962,
        (0, 0): 0.41630020,
        (22, 31): -1.09572783,
        (63, 63): 4.75866803,
    }

    for exact, limit in ((True, 1e-5), (False, 2e-3)):
        low = robust_gaussian(Surface(z, 1.0, 1.0), nesting_index=20.0, order=1, exact=exact)
        assert np.isnan(low.z[6, 55])
        assert max(abs(low.z[at] - value) for at, value in expected.items()) < limit
        assert abs(low.history[-1].parameters["c_m"] - 1.39911058) < limit


@pytest.mark.parametrize("order", [0, 1, 2])
def test_nodes_are_the_pixels_to_a_thousandth(order):
    """A disc with holes and patches, steps and cut-offs that differ in x and y, nothing symmetric."""
    rng = np.random.default_rng(order)
    y, x = np.mgrid[0:180, 0:260].astype(float)
    z = 2 * np.sin(x / 31 + 1) * np.cos(y / 23) + 0.2 * rng.standard_normal(x.shape)
    z[60:70, 150:160] -= 15.0
    z[(x - 120) ** 2 + (1.3 * y - 110) ** 2 > 105**2] = np.nan
    z[100:104, 90:99] = np.nan
    surface = Surface(z, 1.0, 2.0)

    nodes, pixels = (
        robust_gaussian(surface, nesting_index=(40.0, 60.0), order=order, exact=exact).z
        for exact in (False, True)
    )

    assert np.array_equal(np.isnan(nodes), np.isnan(pixels))
    assert np.nanmax(np.abs(nodes - pixels)) < ON_NODES * np.nanstd(pixels)


def test_an_island_without_support_is_treated_as_before():
    """One pixel far from all others carries no plane: every pixel is then worked out on its own."""
    z = np.random.default_rng(1).standard_normal((120, 150))
    z[:, 40:] = np.nan
    z[100, 140] = 1.0

    low = robust_gaussian(Surface(z, 1.0, 1.0), nesting_index=30.0, unsupported="nan")
    exact = robust_gaussian(
        Surface(z, 1.0, 1.0), nesting_index=30.0, unsupported="nan", exact=True
    )

    assert np.array_equal(low.z, exact.z, equal_nan=True)
    assert np.isnan(low.z[100, 140])


@pytest.mark.parametrize("robust", [True, False])
def test_order_2_keeps_parabolas_to_the_ends(robust):
    x = np.linspace(-1e-3, 1e-3, 1001)
    y = np.linspace(-1e-3, 1e-3, 61)[:, None]
    profile = Profile(x, 3.0 * x**2 - 0.01 * x + 1e-6)
    xs = x[::20]
    surface = Surface(3.0 * xs**2 - 2.0 * y**2 + xs * y, xs[1] - xs[0], float(y[1, 0] - y[0, 0]))

    low = robust_gaussian(profile, cutoff=0.25e-3, robust=robust)
    areal = robust_gaussian(surface, nesting_index=0.4e-3, robust=robust)

    assert np.abs(low.z - profile.z).max() < EXACT * np.ptp(profile.z)
    assert np.abs(areal.z - surface.z).max() < EXACT * np.ptp(surface.z)


@pytest.mark.parametrize("order", [0, 1])
def test_lower_orders_lose_the_curvature_the_specification_says(order):
    x = np.linspace(-1e-3, 1e-3, 2001)
    coefficient, cutoff = 3.0, 0.25e-3

    low = robust_gaussian(Profile(x, coefficient * x**2), cutoff=cutoff, order=order, robust=False)

    # the variance of the kernel: a^2 / (2 pi) = 0.0351 in units of the cut-off squared
    variance = regression_constant(order) ** 2 / (2 * np.pi)
    assert abs(variance - 0.0351) < 5e-5
    lost = low.z[1000] / (cutoff**2 * coefficient)
    assert abs(lost - variance) < 1e-6


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("order", [0, 1, 2])
def test_line_stays_on_the_plateau(order, sign):
    i = np.arange(3000)
    z = 1e-4 * i * UM + 1e-8 * np.sin(2 * np.pi * i / 20)
    plateau = 1e-4 * i * UM
    z[i % 500 < 60] += sign * 5e-6
    profile = Profile(i * UM, z)

    robust = robust_gaussian(profile, cutoff=800 * UM, order=order)
    linear = robust_gaussian(profile, cutoff=800 * UM, order=order, robust=False)

    inner = slice(900, 2100) if order == 0 else slice(None)
    assert np.abs(robust.z - plateau)[inner].max() < 3e-9
    assert np.abs(linear.z - plateau)[inner].max() > 3e-7


def test_exact_plateau_with_median_zero():
    i = np.arange(1000)
    z = np.where(i % 200 < 20, -5e-6, 0.0)

    low = robust_gaussian(Profile(i * UM, z), cutoff=250 * UM)

    assert np.abs(low.z).max() < 5e-6 * EXACT


def test_constant_and_zero_surfaces_are_kept():
    for level in (0.0, 3e-6):
        low = robust_gaussian(Surface(np.full((20, 20), level), UM, UM), nesting_index=8 * UM)
        assert np.abs(low.z - level).max() < 1e-18


def test_strips_are_the_whole(monkeypatch):
    z = np.random.default_rng(3).standard_normal((400, 30))
    surface = Surface(z, UM, UM)
    whole = robust_gaussian(surface, nesting_index=12 * UM, robust=False).z

    monkeypatch.setattr(robust, "_MEMORY", 1.0)
    strips = robust_gaussian(surface, nesting_index=12 * UM, robust=False).z

    assert np.abs(strips - whole).max() < 1e-12


def test_rows_not_measured_are_rows_cut_off():
    z = np.random.default_rng(4).standard_normal((30, 40))
    framed = np.full((36, 45), np.nan)
    framed[2:32, 5:] = z

    low = robust_gaussian(Surface(framed, UM, 2 * UM), nesting_index=14 * UM)
    cropped = robust_gaussian(Surface(z, UM, 2 * UM), nesting_index=14 * UM)

    assert np.array_equal(low.z[2:32, 5:], cropped.z)


@settings(deadline=None, max_examples=8, derandomize=True)
@given(st.floats(-9, 9), st.floats(-9, 9), st.integers(0, 5), st.sampled_from([0, 1, 2]))
def test_units_sign_shift_reversal_and_transposition(height, length, seed, order):
    heights, lengths = 10.0**height, 10.0**length
    z = np.random.default_rng(seed).standard_normal((10, 12))
    z[3, 5] = np.nan

    def filtered(data, dx, dy, index):
        surface = Surface(data, dx, dy)
        return robust_gaussian(
            surface, nesting_index=index, order=order, tolerance=1e-9, max_iterations=900
        ).z

    low = filtered(z, 1.0, 2.0, (6.0, 10.0))
    scaled = filtered(heights * z, lengths, 2 * lengths, (6 * lengths, 10 * lengths))
    turned = filtered(z.T, 2.0, 1.0, (10.0, 6.0))
    mirrored = filtered(-z[:, ::-1] + 7.0, 1.0, 2.0, (6.0, 10.0))

    for other in (scaled / heights, turned.T, 7.0 - mirrored[:, ::-1]):
        assert np.nanmax(np.abs(other - low)) < 1e-6


def test_bands_kind_and_history():
    rng = np.random.default_rng(5)
    profile = Profile(np.arange(300), rng.standard_normal(300))

    low, high = (robust_gaussian(profile, cutoff=50, order=1, band=b) for b in ("long", "short"))

    assert np.abs(low.z + high.z - profile.z).max() < 1e-15
    assert (profile_kind(low), profile_kind(high)) == (None, "R")
    facts = high.history[-1].parameters
    assert facts["order"] == 1
    assert facts["n_unsupported"] == 0
    assert facts["c_m"] == pytest.approx(3.0, rel=0.2, abs=0.0)  # three sigma of the noise
    with pytest.raises(DoubleFilterError):
        robust_gaussian(high, cutoff=50)
    assert len(robust_gaussian(high, cutoff=50, refilter=True)) == 300


def test_feature_wider_than_the_cutoff_is_refused_or_marked():
    z = np.random.default_rng(6).standard_normal(1000)
    z[450:700] *= 1e4  # a torn patch, wider than the window
    profile = Profile(np.arange(1000), z)

    with pytest.raises(DegenerateFitError, match=r"undefined at .* wider than the cut-off"):
        robust_gaussian(profile, cutoff=60, order=1)
    low = robust_gaussian(profile, cutoff=60, order=1, unsupported="nan")

    lost = np.isnan(low.z)
    assert lost.sum() == low.history[-1].parameters["n_unsupported"] > 0
    assert lost[575]
    assert not lost[:440].any()


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"cutoff": 30, "order": 3}, "order must be a whole number"),
        ({"cutoff": 30, "unsupported": "drop"}, "unsupported is one of"),
        ({"cutoff": 30, "tolerance": 0.0}, "tolerance must be positive"),
        ({"nesting_index": 30}, "a profile takes cutoff="),
        ({"cutoff": 1.5}, "does not exceed the sampling limit"),
        ({"cutoff": 1000}, "longer than what was measured"),
        ({"cutoff": 30, "band": "mid"}, "band is one of"),
    ],
)
def test_bad_options(options, match):
    with pytest.raises(DataError, match=match):
        robust_gaussian(Profile(np.arange(100), np.zeros(100)), **options)


def test_bad_data():
    with pytest.raises(TooFewSamplesError, match="got 0 of 9"):
        robust_gaussian(Profile(np.arange(9), np.full(9, np.nan)), cutoff=4)
    z = np.full((9, 9), np.nan)
    z[0, :2] = z[8, 7] = z[4, 4] = z[5, 2] = 0.0
    with pytest.raises(TooFewSamplesError, match="at least 6 measured samples, got 5"):
        robust_gaussian(Surface(z, 1, 1), nesting_index=4)
    z[2, 2] = 0.0
    with pytest.raises(DegenerateFitError):
        robust_gaussian(Surface(z, 1, 1), nesting_index=2.1, order=2)


def test_too_few_iterations_are_told():
    z = np.random.default_rng(7).standard_normal(200)
    with pytest.raises(NotConvergedError, match="in 2 iterations"):
        robust_gaussian(Profile(np.arange(200), z), cutoff=50, max_iterations=2)


def test_waviness_stays_waviness_in_both_bands():
    z = np.random.default_rng(1).normal(size=300)
    p = Profile(np.arange(300.0), z, metadata={"profile_kind": "W"})

    kinds = [profile_kind(robust_gaussian(p, cutoff=50, band=b)) for b in ("long", "short")]
    assert kinds == ["W", "W"]


def test_surface_is_not_filtered_short_twice():
    s = Surface(np.random.default_rng(12).normal(size=(40, 40)), 1.0, 1.0)
    rough = robust_gaussian(s, nesting_index=20, band="short")

    with pytest.raises(DoubleFilterError, match="robust_gaussian"):
        robust_gaussian(rough, nesting_index=20, band="short")
    again = robust_gaussian(rough, nesting_index=20, band="short", refilter=True)
    assert again.shape == (40, 40)


@pytest.mark.parametrize("obj", [np.zeros(300), None])
def test_what_is_no_profile_and_no_surface_is_refused(obj):
    with pytest.raises(DataError, match="needs a Profile or Surface, got"):
        robust_gaussian(obj, cutoff=50)


@pytest.mark.parametrize("options", [{"tolerance": "a"}, {"max_iterations": 2.5}])
def test_options_that_are_no_numbers_are_refused(options):
    with pytest.raises(DataError, match=next(iter(options))):
        robust_gaussian(Profile(np.arange(300.0), np.zeros(300)), cutoff=50, **options)
