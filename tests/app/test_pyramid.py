"""The mean pyramid: means over valid pixels, coverage, exact places, odd sizes."""

from __future__ import annotations

import numpy as np
import pytest

from metrosep.app.pyramid import MapPyramid, build_pyramid
from metrosep.core.errors import DataError
from metrosep.core.surface import Surface

MM, UM, NM = 1e-3, 1e-6, 1e-9

SUM_ROUNDING = 1e-12
"""Sums of some thousand heights of about 1 round by some 1e-15 each."""

BUDGET_S = 0.6
"""Stated for a 4096 x 4096 map; twice the time measured on a shared machine."""


def brute_force(z: np.ndarray, fy: int, fx: int) -> tuple[np.ndarray, np.ndarray]:
    """Mean and valid share of blocks, by two loops over the cells."""
    ny, nx = -(-z.shape[0] // fy), -(-z.shape[1] // fx)
    mean, share = np.full((ny, nx), np.nan), np.zeros((ny, nx))
    for i in range(ny):
        for j in range(nx):
            block = z[i * fy : (i + 1) * fy, j * fx : (j + 1) * fx]
            valid = block[np.isfinite(block)]
            share[i, j] = valid.size / block.size
            if valid.size:
                mean[i, j] = valid.mean()
    return mean, share


def gapped(shape: tuple[int, int], seed: int = 3, share: float = 0.4) -> np.ndarray:
    rng = np.random.default_rng(seed)
    z = rng.normal(size=shape)
    z[rng.random(shape) < share] = np.nan
    return z


@pytest.mark.parametrize("shape", [(8, 8), (7, 13), (1, 9), (9, 1), (1, 1), (131, 67), (130, 5)])
@pytest.mark.parametrize("share", [0.0, 0.4])
def test_every_level_is_the_mean_of_its_valid_pixels(shape, share):
    z = gapped(shape, share=share)
    pyramid = build_pyramid(Surface(z, 1e-6, 1e-6))
    assert pyramid.levels[-1].z.shape == (1, 1)
    for level in pyramid.levels:
        mean, part = brute_force(z, *level.factor)
        np.testing.assert_allclose(level.z, mean, rtol=0, atol=SUM_ROUNDING)
        np.testing.assert_allclose(level.coverage(), part, rtol=0, atol=SUM_ROUNDING)
        shown = np.where(part >= 0.5, mean, np.nan)
        np.testing.assert_allclose(level.shown(), shown, rtol=0, atol=SUM_ROUNDING)
    assert pyramid.n_invalid == np.isnan(z).sum()


def test_a_mean_of_means_would_be_another_number():
    z = np.full((4, 4), np.nan)
    z[0, 0], z[2:, :] = 9.0, 1.0
    pyramid = build_pyramid(Surface(z, 1.0, 1.0))
    assert pyramid.levels[2].z[0, 0] == pytest.approx(17.0 / 9.0, abs=SUM_ROUNDING)


@pytest.mark.parametrize("shape", [(64, 64), (37, 53), (5, 130)])
def test_cells_lie_where_their_pixels_lie(shape):
    dx, dy, origin = 3 * UM, 4 * UM, (-2 * MM, 7 * MM)
    row, column = np.mgrid[: shape[0], : shape[1]]
    x, y = origin[0] + dx * column, origin[1] + dy * row
    pyramid = build_pyramid(Surface(2 * x - 5 * y, dx, dy, origin=origin))
    for level in pyramid.levels:  # the mean of a plane over a cell is the plane at its centre
        plane = 2 * level.x[np.newaxis, :] - 5 * level.y[:, np.newaxis]
        np.testing.assert_allclose(level.z, plane, rtol=0, atol=1e-15)
    x0, y0, x1, y1 = pyramid.window
    assert (x0, y0) == pytest.approx((origin[0] - dx / 2, origin[1] - dy / 2), abs=1e-15)
    assert (x1 - x0, y1 - y0) == pytest.approx((shape[1] * dx, shape[0] * dy), abs=1e-15)


def test_the_measured_region_does_not_grow():
    z = np.full((64, 64), np.nan)
    z[:, :33] = 1.0  # the edge lies inside a cell at every level
    pyramid = build_pyramid(Surface(z, 1.0, 1.0))
    for level in pyramid.levels[1:5]:
        width = np.count_nonzero(~np.isnan(level.shown()), axis=1) * level.factor[1]
        assert np.abs(width - 33).max() <= level.factor[1] / 2
    naive = np.count_nonzero(~np.isnan(pyramid.levels[4].z[0])) * 16
    assert naive == 48  # what any valid child would have made of 33


def test_pixels_that_are_not_square_are_first_made_nearly_square():
    z = gapped((40, 4))
    pyramid = build_pyramid(Surface(z, dx=8.0, dy=1.0))
    assert [v.factor for v in pyramid.levels[:5]] == [(1, 1), (2, 1), (4, 1), (8, 1), (16, 2)]


def test_the_level_nearest_to_a_screen_pixel():
    pyramid = build_pyramid(Surface(np.zeros((64, 64)), 1.0, 1.0))
    scales = [0.1, 1.0, 1.4, 1.5, 2.0, 2.8, 2.9, 4.0, 1e9]
    assert [pyramid.level_for(s) for s in scales] == [0, 0, 0, 1, 1, 1, 2, 2, 6]
    for bad in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(DataError, match="scale of a picture"):
            pyramid.level_for(bad)


def test_a_map_of_one_row_is_halved_along_it():
    for shape in ((1, 4096), (2, 4096)):
        pyramid = build_pyramid(Surface(np.zeros(shape), 1.0, 1.0))
        assert pyramid.levels[pyramid.level_for(64.0)].factor[1] == 64


def test_uncalibrated_maps_count_pixels():
    for steps in ((None, None), (1e-6, None), (None, 1e-6)):
        pyramid = build_pyramid(Surface(np.zeros((3, 5)), *steps, origin=(1.0, 2.0)))
        assert pyramid.unit == "px"
        assert pyramid.window == (-0.5, -0.5, 4.5, 2.5)


def test_ranges_of_heights():
    rng = np.random.default_rng(5)
    z = rng.uniform(-1.0, 1.0, (1000, 900))
    z[rng.random(z.shape) < 0.3] = np.nan
    z[7, 8], z[500, 600] = 50.0, -70.0
    pyramid = build_pyramid(Surface(z, 1e-6, 1e-6))
    assert pyramid.extremes == (-70.0, 50.0)
    low, high = pyramid.robust_range
    # uniform heights: quantiles at 0.2 % lie at -+0.996; 0.002 is ten of their standard deviations
    assert (low, high) == pytest.approx((-0.996, 0.996), abs=2e-3)


def test_one_valid_pixel_in_a_large_map_and_none():
    z = np.full((700, 700), np.nan)
    empty = build_pyramid(Surface(z, 1.0, 1.0))
    assert (empty.extremes, empty.robust_range, empty.n_invalid) == (None, None, z.size)
    z[3, 4] = 2.5
    one = build_pyramid(Surface(z, 1.0, 1.0))
    assert one.extremes == one.robust_range == (2.5, 2.5)


def test_a_few_pixels_on_a_level_map_are_not_out_of_range():
    z = np.zeros((300, 300))
    z[7, 9] = -3e-6
    assert build_pyramid(Surface(z, 1.0, 1.0)).robust_range == (-3e-6, 0.0)


def test_the_map_is_kept_and_nothing_can_be_changed():
    surface = Surface(gapped((20, 30)), 1.0, 1.0)
    pyramid = build_pyramid(surface)
    assert pyramid.levels[0].z is surface.z
    for level in pyramid.levels:
        for array in (level.z, level.x, level.y):
            assert not array.flags.writeable
    shown = pyramid.levels[0].shown()
    shown[:] = 0.0  # a copy
    assert np.isnan(surface.z).any()


def test_memory_of_a_large_map():
    z = np.random.default_rng(0).normal(size=(1024, 1024)).astype(np.float32)
    z[:300] = np.nan
    z[np.random.default_rng(1).random(z.shape) < 0.01] = np.nan
    surface = Surface(z, 1e-6, 1e-6)
    pyramid = build_pyramid(surface)
    extra = sum(v.z.nbytes + v.count.nbytes for v in pyramid.levels[1:])
    assert extra < 0.51 * surface.z.nbytes
    assert isinstance(pyramid, MapPyramid)


def test_only_a_surface():
    with pytest.raises(DataError, match="built of a Surface, got ndarray"):
        build_pyramid(np.zeros((3, 3)))
