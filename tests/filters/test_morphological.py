"""Morphological filters: against loops over all pairs, closed forms, lattice laws, planted signs."""

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
from metrosep.filters import morphological
from metrosep.filters._arguments import DoubleFilterError, profile_kind
from metrosep.filters.morphological import closing, dilation, erosion, opening

UM = 1e-6
ROUNDING = 1e-14
"""Sums of two numbers of order 1 to 100."""
CANCELLED = 1e-12
"""sqrt(R^2 - s^2) - R of the loop, with R up to 1000."""


def dilate_by_pairs(z, dx, dy, radius=None, length=None):
    """Maximum over all pairs of measured pixels, from the definition."""
    y, x = np.mgrid[: z.shape[0], : z.shape[1]].astype(float)
    result = np.full(z.shape, np.nan)
    for j, i in np.argwhere(~np.isnan(z)):
        s_x, s_y = (x - i) * dx, (y - j) * dy
        if radius is None:
            inside = (2 * abs(s_x) <= length) & (2 * abs(s_y) <= length)
            h = np.zeros(z.shape)
        else:
            inside = s_x**2 + s_y**2 <= radius**2
            h = np.sqrt(np.where(inside, radius**2 - s_x**2 - s_y**2, 0.0)) - radius
        result[j, i] = np.nanmax(np.where(inside, z + h, np.nan))
    return result


@pytest.fixture
def rough():
    z = np.random.default_rng(41).standard_normal((13, 17))
    z[3:5, 6:9] = np.nan
    z[12, 0] = np.nan
    return z


@pytest.mark.parametrize("size", [{"radius": 2.5}, {"radius": 40.0}, {"length": 6.0}])
def test_surface_is_the_maximum_over_pairs(rough, size):
    surface = Surface(rough, 1.0, 1.5)

    above = dilate_by_pairs(rough, 1.0, 1.5, **size)
    closed = -dilate_by_pairs(-above, 1.0, 1.5, **size)

    assert np.nanmax(np.abs(dilation(surface, **size).z - above)) < ROUNDING
    assert np.nanmax(np.abs(closing(surface, **size).z - closed)) < ROUNDING
    assert np.array_equal(np.isnan(closing(surface, **size).z), np.isnan(rough))


@pytest.mark.parametrize("size", [{"radius": 3.0}, {"radius": 1e3}, {"length": 5.0}])
def test_profile_is_the_maximum_over_pairs(rough, size):
    z = rough.ravel()[:120]
    profile = Profile(np.arange(z.size), z)

    above = dilate_by_pairs(z[None], 1.0, 1.0, **size)
    opened = dilate_by_pairs(-dilate_by_pairs(-z[None], 1.0, 1.0, **size), 1.0, 1.0, **size)

    assert np.nanmax(np.abs(dilation(profile, **size).z - above[0])) < CANCELLED
    assert np.nanmax(np.abs(opening(profile, **size).z - opened[0])) < CANCELLED


def test_small_blocks_are_the_whole(rough, monkeypatch):
    surface = Surface(rough, 1.0, 1.0)
    whole = dilation(surface, radius=3.0).z

    for block in (1, 7, 40):
        monkeypatch.setattr(morphological, "_BLOCK", block)
        assert np.array_equal(dilation(surface, radius=3.0).z, whole, equal_nan=True)


def test_ball_on_a_sphere_is_a_larger_sphere():
    """A ball of radius r rolling on a cap of radius R has its centre on the radius R + r."""
    n, dx, dy, big, small = 161, 1 * UM, 2 * UM, 2e-3, 0.5e-3
    y, x = np.meshgrid((np.arange(81) - 40) * dy, (np.arange(n) - 80) * dx, indexing="ij")
    cap = np.sqrt(big**2 - x**2 - y**2) - big

    low = dilation(Surface(cap, dx, dy), radius=small).z

    locus = np.sqrt((big + small) ** 2 - x**2 - y**2) - (big + small)
    # the touching pixel lies at most half a step off: s^2 (1/R + 1/r) / 2
    grid = (dx**2 + dy**2) / 4 * (1 / big + 1 / small) / 2
    assert (low <= locus + 1e-16).all()
    assert np.abs(low - locus).max() < grid


def test_disc_sinks_into_a_groove_by_its_sagitta():
    """Between two shoulders 2 b apart a disc of radius R hangs R - sqrt(R^2 - b^2) deep."""
    i = np.arange(-200, 201)
    z = np.where(np.abs(i) < 40, -1.0, 0.0)  # shoulders at +-40
    radius = 2000.0

    low = closing(Profile(i, z), radius=radius)

    sagitta = radius - np.sqrt(radius**2 - 40.0**2)
    assert abs(low.z[200] + sagitta) < 1e-12
    assert np.abs(low.z[np.abs(i) >= 40]).max() < 1e-12


def test_scratch_is_bridged_and_ridge_is_kept_by_closing():
    z = np.zeros((40, 60))
    z[:, 10:13] = -2e-6  # scratch
    z[:, 30:33] = 3e-6  # ridge
    z[5, 50] = 1e-6  # one spike
    surface = Surface(z, UM, UM)

    sagitta = (20 - np.sqrt(20**2 - 2**2)) * UM * 1.001  # the ball between two shoulders
    for size, hang in (({"radius": 20 * UM}, sagitta), ({"length": 10 * UM}, 0.0)):
        above, below = closing(surface, **size).z, opening(surface, **size).z
        assert np.abs(above[:, 10:13]).max() <= hang
        assert (above[:, 30:33] == 3e-6).all()
        assert above[5, 50] == 1e-6
        assert (below[:, 10:13] == -2e-6).all()
        assert np.abs(below[:, 30:33]).max() <= hang
        assert abs(below[5, 50]) <= hang


def test_dilation_widens_peaks_and_erosion_widens_valleys():
    profile = Profile(np.arange(9), [0, 0, 0, 5, 0, -5, 0, 0, 0])

    assert dilation(profile, length=2).z.tolist() == [0, 0, 5, 5, 5, 0, 0, 0, 0]
    assert erosion(profile, length=2).z.tolist() == [0, 0, 0, 0, -5, -5, -5, 0, 0]


def test_level_plane_is_kept_and_tilt_costs_what_the_notes_say():
    x = np.arange(1001) * UM
    slope, radius = 0.05, 2e-3

    tilted = closing(Profile(x, -slope * x), radius=radius).z + slope * x

    assert np.abs(closing(Profile(x, x * 0 + 1e-6), radius=radius).z - 1e-6).max() == 0.0
    assert abs(tilted[-1] - radius * slope**2 / 2) < 0.01 * radius * slope**2
    assert np.abs(tilted[: -int(1.1 * radius * slope / UM)]).max() < 1e-10


@settings(deadline=None, max_examples=25, derandomize=True)
@given(
    st.integers(0, 99),
    st.sampled_from([{"radius": 2.0}, {"radius": 15.0}, {"length": 4.0}]),
    st.floats(-9, 0),
)
def test_lattice_laws_units_and_symmetries(seed, size, exponent):
    rng = np.random.default_rng(seed)
    z = rng.standard_normal((9, 12))
    z[rng.random(z.shape) < 0.1] = np.nan
    surface = Surface(z, 1.0, 2.0)
    above = closing(surface, **size).z

    assert (above >= z - ROUNDING)[~np.isnan(z)].all()
    twice = closing(Surface(above, 1.0, 2.0), **size).z
    assert np.nanmax(np.abs(twice - above)) < ROUNDING
    assert np.nanmax(np.abs(above + opening(Surface(-z, 1.0, 2.0), **size).z)) < ROUNDING
    chain = erosion(dilation(surface, **size), **size).z
    assert np.nanmax(np.abs(above - chain)) < ROUNDING
    turned = closing(Surface(z.T, 2.0, 1.0), **size).z
    assert np.nanmax(np.abs(turned.T - above)) < ROUNDING
    mirrored = closing(Surface(z[::-1, ::-1] + 3.0, 1.0, 2.0), **size).z
    assert np.nanmax(np.abs(mirrored[::-1, ::-1] - 3.0 - above)) < 5 * ROUNDING
    unit = 10.0**exponent
    scaled = closing(
        Surface(z * unit, unit, 2 * unit), **{name: value * unit for name, value in size.items()}
    ).z
    assert np.nanmax(np.abs(scaled / unit - above)) < 5 * ROUNDING


def test_rows_not_measured_are_rows_cut_off(rough):
    framed = np.full((20, 20), np.nan)
    framed[4:17, 1:18] = rough

    for size in ({"radius": 9.0}, {"length": 4.0}):
        low = closing(Surface(framed, 1, 1), **size).z[4:17, 1:18]
        assert np.array_equal(low, closing(Surface(rough, 1, 1), **size).z, equal_nan=True)


def test_bands_kind_origin_and_history():
    profile = Profile(np.arange(50), np.sin(np.arange(50)))
    surface = Surface(np.outer(profile.z, profile.z), 1, 1, origin=(3.0, 4.0))

    low, high = (closing(profile, radius=9, band=b) for b in ("long", "short"))

    assert np.abs(low.z + high.z - profile.z).max() < ROUNDING
    assert (high.z <= 0).all()
    assert (profile_kind(low), profile_kind(high)) == (None, "R")
    assert dict(high.history[-1].parameters) == {"radius_m": 9.0, "band": "short"}
    assert opening(surface, length=4).origin == (3.0, 4.0)
    assert dilation(surface, length=4).history[-1].parameters["length_m"] == 4.0
    with pytest.raises(DoubleFilterError):
        opening(high, radius=9)
    assert len(opening(high, radius=9, refilter=True)) == 50


@pytest.mark.parametrize(
    ("options", "error", "match"),
    [
        ({}, DataError, "give one structuring element"),
        ({"radius": 5, "length": 5}, DataError, "give one structuring element"),
        ({"radius": 0.5}, DataError, "reaches no neighbour"),
        ({"length": 1.5}, DataError, "reaches no neighbour"),
        ({"length": 100}, DataError, "longer than what was measured"),
        ({"radius": np.inf}, InvalidSamplesError, "positive and finite"),
        ({"radius": -5}, InvalidSamplesError, "positive and finite"),
        ({"radius": 5, "band": "x"}, DataError, "band is one of"),
    ],
)
def test_bad_options(options, error, match):
    with pytest.raises(error, match=match):
        closing(Profile(np.arange(20), np.zeros(20)), **options)


def test_bad_data():
    with pytest.raises(TooFewSamplesError, match="got 0 of 5"):
        dilation(Profile(np.arange(5), np.full(5, np.nan)), radius=2)
    with pytest.raises(TooFewSamplesError, match="needs 2 samples"):
        dilation(Profile([0.0], [1.0]), radius=2)
    with pytest.raises(NotUniformError):
        erosion(Profile([0, 1, 3], [1, 2, 3]), radius=2)
    with pytest.raises(DataError, match="no lateral step dx and dy"):
        closing(Surface(np.zeros((5, 5))), radius=2)


def test_one_row_and_one_measured_sample_are_fine():
    z = np.full(9, np.nan)
    z[4] = 2.0

    assert closing(Profile(np.arange(9), z), radius=3).z[4] == 2.0
    assert dilation(Surface(np.arange(9.0)[None], 1, 1), radius=3).z[0, 8] == 8.0


@pytest.mark.parametrize("filtered", [closing, opening])
def test_waviness_stays_waviness_in_both_bands(filtered):
    p = Profile(np.arange(50.0), np.zeros(50), metadata={"profile_kind": "W"})

    assert [profile_kind(filtered(p, length=4, band=b)) for b in ("long", "short")] == ["W", "W"]


@pytest.mark.parametrize("filtered", [closing, opening, dilation, erosion])
@pytest.mark.parametrize("obj", [np.zeros(300), None])
def test_what_is_no_profile_and_no_surface_is_refused(filtered, obj):
    with pytest.raises(DataError, match="needs a Profile or Surface, got"):
        filtered(obj, length=4)


@pytest.mark.parametrize("name", ["radius", "length"])
def test_size_that_is_no_number_is_refused(name):
    with pytest.raises(DataError, match=name):
        closing(Profile(np.arange(50.0), np.zeros(50)), **{name: "a"})
