"""Sections at full resolution: where they run, what a gap does to them, their numbers."""

from __future__ import annotations

import numpy as np
import pytest

from metrosep.app.view_tables import section_view
from metrosep.core.errors import DataError
from metrosep.core.sections import section_profile
from metrosep.core.surface import Surface

MM, UM = 1e-3, 1e-6
ORIGIN = (2 * MM, -5 * MM)
STEP = 0.1 * MM
SHAPE = (520, 300)

ROUNDING = 1e-15
"""Heights of some um read with weights that round by 1e-10 (indices up to 500, 16 digits)."""


def grid() -> tuple[np.ndarray, np.ndarray]:
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]]
    return ORIGIN[0] + STEP * column, ORIGIN[1] + STEP * row


def bumped(height: float = 3 * UM) -> Surface:
    """A cone, base radius 1 mm, at x = 12 mm, y = 30 mm of a map that is not square."""
    x, y = grid()
    r = np.hypot(x - 12 * MM, y - 30 * MM)
    return Surface(height * np.maximum(0.0, 1.0 - r / MM), STEP, STEP, origin=ORIGIN)


def test_along_x_and_along_y_the_summit_comes_where_it_was_planted():
    along_x = section_profile(bumped(), (4 * MM, 30 * MM), (24 * MM, 30 * MM))
    along_y = section_profile(bumped(), (12 * MM, 0.0), (12 * MM, 40 * MM))
    assert along_x.x[np.argmax(along_x.z)] == pytest.approx(8 * MM, abs=1e-12)
    assert along_y.x[np.argmax(along_y.z)] == pytest.approx(30 * MM, abs=1e-12)
    assert along_x.z.max() == pytest.approx(3 * UM, abs=ROUNDING)
    back = section_profile(bumped(), (24 * MM, 30 * MM), (4 * MM, 30 * MM))
    np.testing.assert_allclose(back.z, along_x.z[::-1], rtol=0, atol=ROUNDING)
    beside = section_view(bumped(), (12 * MM, 0.0), (12 * MM, 28.8 * MM))
    assert beside.pv == 0.0


def test_a_plane_and_a_saddle_are_exact_on_a_slanting_line():
    x, y = grid()
    dy = 2 * STEP  # pixels that are not square
    y = ORIGIN[1] + 2 * (y - ORIGIN[1])
    z = 3e-3 * x - 5e-3 * y + 0.7 * (x - ORIGIN[0]) * y  # bilinear in each cell
    surface = Surface(z, STEP, dy, origin=ORIGIN)
    a, b = np.array([3.03 * MM, 90 * MM]), np.array([29.9 * MM, 3.3 * MM])
    cut = section_profile(surface, a, b)
    length = np.hypot(*(b - a))
    assert cut.x[-1] == pytest.approx(length, abs=1e-15)
    assert cut.dx <= STEP * (1 + 1e-9)
    px, py = (a + cut.x[:, None] / length * (b - a)).T
    expected = 3e-3 * px - 5e-3 * py + 0.7 * (px - ORIGIN[0]) * py
    np.testing.assert_allclose(cut.z, expected, rtol=0, atol=1e-13)


def test_at_pixels_it_reads_the_pixels():
    z = np.random.default_rng(4).normal(size=(5, 9))
    surface = Surface(z, 0.1, 0.3, origin=(1.7, -0.4))
    for method in ("bilinear", "nearest"):
        row = section_profile(surface, (1.7, 0.2), (2.5, 0.2), method=method)
        np.testing.assert_allclose(row.z, z[2], rtol=0, atol=1e-7)
        column = section_profile(surface, (2.0, -0.4), (2.0, 0.8), method=method)
        np.testing.assert_allclose(column.z[::3], z[:, 3], rtol=0, atol=1e-7)


def test_one_invalid_neighbour_is_enough_for_a_gap_and_only_those_with_weight_count():
    z = np.zeros((5, 7))
    z[2, 3] = np.nan
    surface = Surface(z, 1.0, 1.0)
    slanting = section_profile(surface, (0.25, 1.5), (5.75, 1.5))
    inside = (slanting.x + 0.25 > 2) & (slanting.x + 0.25 < 4)
    np.testing.assert_array_equal(np.isnan(slanting.z), inside)
    on_a_row = section_profile(surface, (0.0, 1.0), (6.0, 1.0))  # the gap is in the next row
    assert on_a_row.n_invalid == 0
    near = section_profile(surface, (0.0, 2.2), (6.0, 2.2), method="nearest")
    assert np.flatnonzero(np.isnan(near.z)).tolist() == [3]


def test_outside_the_map_nothing_is_measured():
    surface = Surface(np.ones((4, 4)), 1.0, 1.0)
    cut = section_profile(surface, (-2.0, 1.0), (5.0, 1.0))
    assert np.flatnonzero(~np.isnan(cut.z)).tolist() == [2, 3, 4, 5]
    fine = section_profile(surface, (-0.5, 1.0), (3.5, 1.0), method="nearest")
    assert fine.n_invalid == 0  # a pixel reaches half a step beyond its centre
    away = section_view(surface, (10.0, 10.0), (12.0, 12.0))
    assert np.isnan([away.pv, away.sq]).all()
    assert away.share_valid == 0.0
    assert np.isnan(away.low).all()


@pytest.mark.parametrize("columns", [3, 40, 1000])
def test_a_cursor_reads_the_map_whatever_the_columns_of_the_picture(columns):
    """A wall of 3 um: the middle of a wide column would lie half way up it."""
    x, _ = grid()
    z = np.where(x < 12 * MM, 0.0, 3 * UM) + 1e-6 * x
    z[300] = np.nan
    surface = Surface(z, STEP, STEP, origin=ORIGIN)
    a, b = (2 * MM, 0.0), (22 * MM, 0.0)
    cut = section_view(surface, a, b, columns=columns, cursors=[0.25, 0.505, 0.5])
    expected = {0.25: 7e-9, 0.505: 12.1e-9 + 3 * UM, 0.5: 12e-9 + 3 * UM}
    assert {t: pytest.approx(v, abs=ROUNDING) for t, v in expected.items()} == cut.heights
    gap = section_view(surface, (2 * MM, 25 * MM), (22 * MM, 25 * MM), cursors=[0.25])
    assert np.isnan(gap.heights[0.25])


@pytest.mark.parametrize("cursors", [[1.5], [-0.1], ["a"], 0.5, [True], [float("nan")], [0.1] * 9])
def test_a_cursor_is_a_part_of_the_length(cursors):
    with pytest.raises(DataError, match="parts of the length from 0 to 1"):
        section_view(bumped(), (4 * MM, 30 * MM), (24 * MM, 30 * MM), cursors=cursors)


def test_numbers_of_a_sine():
    n, amplitude = 400, 5 * UM
    column = np.arange(n)
    z = np.tile(amplitude * np.sin(2 * np.pi * column / 40), (3, 1))
    z[:, 360:] = np.nan  # one wave of ten is not measured
    view = section_view(Surface(z, STEP, STEP), (0.0, STEP), ((n - 1) * STEP, STEP), columns=50)
    assert view.pv == pytest.approx(2 * amplitude, abs=ROUNDING)
    assert view.sq == pytest.approx(amplitude / np.sqrt(2), abs=ROUNDING)
    assert view.share_valid == pytest.approx(0.9, abs=1e-12)
    assert view.n_samples == n
    assert view.length == pytest.approx(399 * STEP, abs=1e-15)


def test_columns_hold_every_spike_and_the_gaps():
    z = np.zeros((3, 4000))
    z[1, 1234], z[1, 2345], z[1, 3000:3100] = 7.0, -6.0, np.nan
    surface = Surface(z, 1.0, 1.0)
    view = section_view(surface, (0.0, 1.0), (3999.0, 1.0), columns=100)
    assert view.low.size == view.high.size == view.distance.size == 100
    assert np.nanargmax(view.high) == 1234 // 40
    assert np.nanargmin(view.low) == 2345 // 40
    assert np.nanmax(view.high) == 7.0
    assert np.flatnonzero(np.isnan(view.low)).tolist() == [75, 76]
    np.testing.assert_allclose(view.distance, 19.5 + 40 * np.arange(100), rtol=0, atol=1e-9)
    fine = section_view(surface, (0.0, 1.0), (9.0, 1.0), columns=500)
    assert fine.distance.tolist() == pytest.approx(list(range(10)), abs=1e-12)


def test_bilinear_reading_averages_noise_as_stated():
    noise = np.random.default_rng(7).normal(size=(1500, 1500))
    surface = Surface(noise, 1.0, 1.0)
    ends = (0.3, 0.7), (1490.0, 1203.0)
    slanting = section_view(surface, *ends, method="bilinear")
    nearest = section_view(surface, *ends, method="nearest")
    # mean of (1 - u)^2 + u^2 over u is 2/3 in each direction; about 1500 samples, 4 sigma = 0.08
    assert slanting.sq == pytest.approx(2 / 3, abs=0.06)
    assert nearest.sq == pytest.approx(1.0, abs=0.08)


def test_uncalibrated_maps_are_cut_in_pixels():
    z = np.arange(12.0).reshape(3, 4)
    view = section_view(Surface(z, None, 1e-6, origin=(5.0, 5.0)), (0, 0), (0, 2))
    assert view.unit == "px"
    assert view.high.tolist() == [0.0, 4.0, 8.0]


@pytest.mark.parametrize(
    ("a", "b", "options", "words"),
    [
        ((0, 0), (0, 0), {}, "must differ"),
        ((0, np.nan), (1, 1), {}, "two positions|finite number"),
        ((0, 0, 0), (1, 1), {}, "two positions|finite number"),
        (None, (1, 1), {}, "two positions|finite number"),
        ((0, 0), (1e9, 0), {}, "check their unit"),
        ((0, 0), (1e308, -1e308), {}, "check their unit"),
        ((0, 0), (1, 1), {"columns": 0}, "columns must be"),
        ((0, 0), (1, 1), {"columns": 2.5}, "columns must be"),
        ((0, 0), (1, 1), {"method": "cubic"}, '"bilinear" or "nearest"'),
    ],
)
def test_bad_sections(a, b, options, words):
    with pytest.raises(DataError, match=words):
        section_view(Surface(np.zeros((3, 3)), 1.0, 1.0), a, b, **options)
    with pytest.raises(DataError, match="through a Surface"):
        section_view(np.zeros((3, 3)), (0, 0), (1, 1))


@pytest.mark.parametrize("degrees", [17.0, 30.0, 45.0])
@pytest.mark.parametrize("wavelength", [3.0, 3.5, 4.3, 5.0, 6.0, 10.0])
def test_a_slanting_section_keeps_the_rms_of_short_waves(wavelength, degrees):
    """A wave along x: the section has its RMS, amplitude / sqrt(2), however it is turned."""
    i = np.arange(700)
    surface = Surface(np.tile(np.sin(2 * np.pi * i / wavelength + 0.4), (700, 1)), 1.0, 1.0)
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))

    line = section_profile(surface, (20.0, 20.0), (20.0 + 650.0 * c, 20.0 + 650.0 * s))

    assert line.z.std() == pytest.approx(np.sqrt(0.5), rel=0.01, abs=0.0)


@pytest.mark.parametrize(
    ("wavelength", "phase", "ends", "kept"),
    [
        (5.2, 0.7, ((20, 20), (280, 150)), 0.995318),
        (3.1, 0.2, ((15, 30), (370, 260)), 1.004858),
    ],
)
def test_amplitudes_are_those_of_an_independent_reading(wavelength, phase, ends, kept):
    """Numbers of a plane and Lanczos-4 that were computed elsewhere (people.md, C-2)."""
    wave = np.sin(2 * np.pi * np.arange(400) / wavelength + phase)
    line = section_profile(Surface(np.tile(wave, (300, 1)), 1.0, 1.0), *ends)
    x = ends[0][0] + (ends[1][0] - ends[0][0]) * line.x / line.x[-1]
    w = 2 * np.pi * x / wavelength + phase

    found = np.linalg.lstsq(np.c_[np.sin(w), np.cos(w)], line.z, rcond=None)[0][0]

    assert found == pytest.approx(kept, abs=1e-6)


def test_beside_a_gap_the_section_is_bilinear_and_says_how_much():
    z = np.tile(np.sin(np.arange(60) / 2.0), (60, 1))
    z[28:33, 28:33] = np.nan  # beside a single one it is not
    line = section_profile(Surface(z, 1.0, 1.0), (10.3, 10.2), (50.3, 50.2))

    assert np.isnan(line.z).sum() >= 1
    assert 0.0 < line.history[-1].parameters["bilinear_share"] < 0.5


def test_mirrored_map_and_mirrored_line_give_the_same_section():
    z = np.random.default_rng(3).normal(size=(50, 70))
    surface, mirrored = Surface(z, 1.0, 1.0), Surface(z[::-1, ::-1].copy(), 1.0, 1.0)

    line = section_profile(surface, (5.2, 7.9), (61.3, 40.4))
    other = section_profile(mirrored, (69 - 5.2, 49 - 7.9), (69 - 61.3, 49 - 40.4))

    np.testing.assert_allclose(other.z, line.z, rtol=0, atol=1e-12)
