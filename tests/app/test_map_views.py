"""Pictures of a map: which pixel shows which height, orientation, gaps, ranges, shading."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from metrosep.app.map_views import map_view
from metrosep.app.pyramid import build_pyramid
from metrosep.core.errors import DataError
from metrosep.core.surface import Surface

MM, UM = 1e-3, 1e-6
ORIGIN = (2 * MM, -5 * MM)
STEP = 0.1 * MM
SHAPE = (520, 300)
"""Rows (y) and columns (x): 30 mm wide, 52 mm high."""

HALF_A_PIXEL = 0.5 * STEP + 1e-12
BUDGET_S = 0.03
"""Stated for 512 x 512 from a 4096 x 4096 map."""


def bumped() -> Surface:
    """A level map with +3 um in a 0.5 mm square at x = 12 mm, y = 30 mm, and a gap below it."""
    z = np.zeros(SHAPE)
    x = ORIGIN[0] + STEP * np.arange(SHAPE[1])
    y = ORIGIN[1] + STEP * np.arange(SHAPE[0])
    row, column = np.abs(y - 30 * MM) < 0.26 * MM, np.abs(x - 12 * MM) < 0.26 * MM
    z[np.ix_(row, column)] = 3 * UM
    z[np.ix_(np.abs(y - 20 * MM) < 1 * MM, np.abs(x - 12 * MM) < 1 * MM)] = np.nan
    return Surface(z, STEP, STEP, origin=ORIGIN)


def place(view, rows, columns):
    """World coordinates of screen pixels, by the stated convention: row 0 on top is y1."""
    x0, _, _, y1 = view.window
    return x0 + (np.asarray(columns) + 0.5) * view.scale, y1 - (
        np.asarray(rows) + 0.5
    ) * view.scale


PYRAMID = build_pyramid(bumped())


@pytest.mark.parametrize("pixels", [(300, 520), (512, 512), (200, 777), (640, 100)])
def test_the_bump_stands_where_it_was_planted(pixels):
    view = map_view(PYRAMID, pixels=pixels, level="full", limits=(-3 * UM, 3 * UM))
    assert view.index.shape == pixels[::-1]
    rows, columns = np.nonzero(view.index > 128)
    x, y = place(view, rows, columns)
    tolerance = HALF_A_PIXEL + view.scale + STEP * (2**view.level - 1)
    assert x.mean() == pytest.approx(12 * MM, abs=tolerance)
    assert y.mean() == pytest.approx(30 * MM, abs=tolerance)


def test_one_to_one_every_pixel_is_shown_y_up():
    surface = bumped()
    view = map_view(PYRAMID, pixels=SHAPE[::-1], level="full", limits=(-1.1e-6, 3e-6))
    assert (view.level, view.is_preview, view.unit) == (0, False, "m")
    expected = 1 + np.rint(254 * np.clip((surface.z[::-1] + 1.1e-6) / 4.1e-6, 0, 1))
    np.testing.assert_array_equal(view.index, np.where(np.isnan(surface.z[::-1]), 0, expected))
    top = np.nonzero((view.index == 255).any(axis=1))[0].mean()
    gap = np.nonzero((view.index == 0).any(axis=1))[0].mean()
    assert top < gap  # y = 30 mm is above y = 20 mm
    # 30 mm: row 350 of 520 from below, 169 from above; columns 98 ... 102
    assert view.index[169, 100] == 255
    assert view.window == pytest.approx(PYRAMID.window, abs=1e-15)


def test_a_window_zooms_to_what_it_says():
    view = map_view(PYRAMID, window=(11 * MM, 29 * MM, 13 * MM, 31 * MM), pixels=(400, 400))
    rows, columns = np.nonzero(view.index == view.index.max())
    x, y = place(view, rows, columns)
    assert (x.min(), x.max()) == pytest.approx((11.75 * MM, 12.25 * MM), abs=view.scale)
    assert (y.min(), y.max()) == pytest.approx((29.75 * MM, 30.25 * MM), abs=view.scale)
    assert not view.is_preview
    assert view.coverage == 1.0


def test_screen_pixels_are_square_and_the_window_only_grows():
    asked = (3 * MM, 0.0, 5 * MM, 40 * MM)
    view = map_view(PYRAMID, window=asked, pixels=(300, 200))
    x0, y0, x1, y1 = view.window
    assert (x1 - x0) / 300 == pytest.approx((y1 - y0) / 200, abs=1e-15)
    assert (y0, y1) == pytest.approx((0.0, 40 * MM), abs=1e-15)
    assert (x0 + x1) / 2 == pytest.approx(4 * MM, abs=1e-15)
    outside = place(view, [0], np.arange(300))[0] < PYRAMID.window[0]
    assert outside.any()
    assert (view.index[:, outside] == 0).all()


def test_pixels_that_are_not_square_keep_their_shape():
    z = np.zeros((40, 80))
    z[10:20, 20:40] = 1.0  # 20 columns of 1 um, 10 rows of 4 um: 20 um wide, 40 um high
    view = map_view(build_pyramid(Surface(z, 1 * UM, 4 * UM)), pixels=(320, 640), level="full")
    rows, columns = np.nonzero(view.index == 255)
    assert np.ptp(columns) + 1 == pytest.approx(20 * UM / view.scale, abs=1.0)
    assert np.ptp(rows) + 1 == pytest.approx(40 * UM / view.scale, abs=1.0)


def test_rows_beyond_the_map_are_not_measured():
    view = map_view(PYRAMID, pixels=(400, 100), window=(2 * MM, -10 * MM, 42 * MM, 0.0))
    rows, columns = np.nonzero(view.index)
    x, y = place(view, rows, columns)
    x0, y0, x1, _ = PYRAMID.window
    assert (y.min() - y0, x.min() - x0) == pytest.approx((0.0, 0.0), abs=1.1 * view.scale)
    assert x.max() == pytest.approx(x1, abs=1.1 * view.scale)
    assert (view.index[place(view, np.arange(100), [0])[1] < y0 - 1e-9] == 0).all()


def test_coarse_views_of_pixels_that_are_not_square():
    z = np.zeros((400, 100))
    z[240:280, 20:40] = 1.0  # x 80 to 160 um, y 240 to 280 um
    view = map_view(build_pyramid(Surface(z, 4 * UM, 1 * UM)), pixels=(50, 50))
    assert view.level > 2
    x, y = place(view, *np.nonzero(view.index == 255))
    assert (x.min(), x.max()) == pytest.approx((80 * UM, 160 * UM), abs=1.6 * view.scale)
    assert (y.min(), y.max()) == pytest.approx((240 * UM, 280 * UM), abs=1.6 * view.scale)


def test_a_gap_is_a_gap_and_a_coarse_view_does_not_close_it():
    for side in (512, 260, 130):
        view = map_view(PYRAMID, pixels=(side, side), level="full", limits=(-UM, UM))
        inside = place(view, np.arange(side), np.arange(side))
        row = int(np.argmin(np.abs(inside[1] - 20 * MM)))
        column = int(np.argmin(np.abs(inside[0] - 12 * MM)))
        assert view.index[row, column] == 0
    z = np.zeros((512, 512))
    z[:, 256:] = np.nan
    z[:, 300] = 1.0  # a thread of valid pixels does not make the cells around it valid
    view = map_view(build_pyramid(Surface(z, UM, UM)), pixels=(64, 64))
    assert (view.index[:, :32] > 0).all()
    assert (view.index[:, 32:] == 0).all()


def test_the_ladder_cuts_the_longer_side():
    sizes = {k: map_view(PYRAMID, pixels=(2000, 1500), level=k) for k in ("drag", "idle", "full")}
    assert sizes["drag"].index.shape == (384, 512)
    assert sizes["idle"].index.shape == (768, 1024)
    assert sizes["full"].index.shape == (1500, 2000)
    assert sizes["drag"].is_preview


@settings(deadline=None, derandomize=True, max_examples=40)
@given(st.floats(-9, 3), st.floats(-1, 1), st.integers(0, 2**32 - 1))
def test_an_index_tells_the_height_to_half_a_step(exponent, shift, seed):
    size = 10.0**exponent
    z = size * (np.random.default_rng(seed).uniform(-1, 1, (9, 11)) + shift)
    view = map_view(build_pyramid(Surface(z, UM, UM)), pixels=(11, 9))
    low, high = view.range
    back = low + (view.index.astype(float) - 1) / 254 * (high - low)
    clipped = np.clip(z[::-1], low, high)
    assert np.abs(back - clipped).max() <= (high - low) / 254 / 2 * (1 + 1e-9)
    assert (view.index > 0).all()


def test_the_range_stays_while_the_window_moves():
    one = map_view(PYRAMID, window=(3 * MM, 0, 8 * MM, 5 * MM))
    assert one.range == map_view(PYRAMID).range == PYRAMID.robust_range


def test_level_maps_and_empty_maps():
    flat = map_view(
        build_pyramid(Surface(np.full((5, 5), 2.0), UM, UM)), pixels=(5, 5), shade=True
    )
    assert flat.range == (2.0, 2.0)
    assert (flat.index == 128).all()
    assert (flat.shade[1:-1, 1:-1] == 128).all()
    empty = map_view(build_pyramid(Surface(np.full((5, 5), np.nan), UM, UM)), shade=True)
    assert empty.range is None
    assert not empty.index.any()
    assert not empty.shade.any()
    assert empty.coverage == 0.0
    away = map_view(PYRAMID, window=(1.0, 1.0, 2.0, 2.0))
    assert not away.index.any()
    assert away.coverage == 0.0


def test_light_from_the_upper_left_and_no_shade_where_the_slope_is_unknown():
    n = 101
    y, x = np.mgrid[-1 : 1 : n * 1j, -1 : 1 : n * 1j]
    z = np.exp(-4 * (x**2 + y**2))
    z[70:75, 20:25] = np.nan
    view = map_view(build_pyramid(Surface(z, UM, UM)), pixels=(n, n), shade=True)
    upper_left, lower_right = view.shade[35:45, 35:45], view.shade[56:66, 56:66]
    assert upper_left.min() > 128 > lower_right.max()
    assert view.shade[50, 50] == pytest.approx(128, abs=1)  # the summit is level
    gap = view.index == 0
    assert (view.shade[gap] == 0).all()
    ring = np.zeros_like(gap)
    ring[n - 76, 20:25] = True  # row above the gap: its lower neighbour is not measured
    assert (view.shade[ring] == 0).all()
    assert (view.index[ring] > 0).all()
    pit = map_view(build_pyramid(Surface(-z, UM, UM)), pixels=(n, n), shade=True)
    assert pit.shade[40, 40] < 128 < pit.shade[61, 61]  # a pit is lit on its far side


def test_coverage_is_the_valid_share():
    z = np.zeros((64, 64))
    z[:16] = np.nan
    pyramid = build_pyramid(Surface(z, UM, UM))
    for side in (64, 16, 5):
        assert map_view(pyramid, pixels=(side, side)).coverage == pytest.approx(0.75, abs=1e-12)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"window": (0, 0, 0, 1)}, "x0 < x1"),
        ({"window": (0, 0, np.nan, 1)}, "4 finite numbers"),
        ({"window": (0, 0, 1)}, "4 finite numbers"),
        ({"window": "abcd"}, "4 finite numbers"),
        ({"window": (-1.7e308, 0, 1.7e308, 1)}, "too large or too small"),
        ({"pixels": (0, 5)}, "1 to 16384"),
        ({"pixels": (5.5, 5)}, "1 to 16384"),
        ({"pixels": (10**9, 5)}, "1 to 16384"),
        ({"pixels": (5,)}, "1 to 16384"),
        ({"limits": (1e-6, 1e-6)}, "lower to the higher"),
        ({"limits": (2, np.inf)}, "2 finite numbers"),
        ({"limits": (-1.7e308, 1.7e308)}, "lower to the higher"),
        ({"level": "best"}, '"drag", "idle" or "full"'),
    ],
)
def test_bad_wishes(options, words):
    with pytest.raises(DataError, match=words):
        map_view(PYRAMID, **options)
