"""Sections of a map against numbers that were computed without metrosep, and closed forms."""

import numpy as np
import pytest

import metrosep as ms
from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.core.sections import (
    angle_at,
    circle_section,
    circle_through,
    distance,
    harmonics,
    height_at,
    section_profile,
)

MM, UM, NM = 1e-3, 1e-6, 1e-9
READ = 1e-5
"""Relative: numbers that go through an interpolation (specification, part 7)."""
EXACT = 1e-6
"""Relative: numbers that do not; they are printed with nine digits."""


def wave(length, phase, shape=(300, 400)):
    i = np.arange(shape[1])
    return ms.Surface(np.tile(np.sin(2 * np.pi * i / length + phase), (shape[0], 1)), 1.0, 1.0)


@pytest.mark.parametrize(
    ("length", "phase", "a", "b", "amplitude", "by_bilinear"),
    [
        (5.2, 0.7, (20, 20), (280, 150), 0.995318, 0.88410),
        (3.1, 0.2, (15, 30), (370, 260), 1.004858, 0.70193),
    ],
)
def test_an_oblique_section_keeps_short_waves(length, phase, a, b, amplitude, by_bilinear):
    for method, expected in (("lanczos", amplitude), ("bilinear", by_bilinear)):
        cut = section_profile(wave(length, phase), a, b, method=method)
        i = a[0] + cut.x * (b[0] - a[0]) / np.hypot(b[0] - a[0], b[1] - a[1])
        basis = np.stack([np.sin(2 * np.pi * i / length), np.cos(2 * np.pi * i / length)], axis=1)
        found = np.hypot(*np.linalg.lstsq(basis, cut.z, rcond=None)[0])
        assert found == pytest.approx(expected, abs=5 * READ)  # printed with five to six digits


STEP_HEIGHT = 600 * NM
TEXTURE = 5 * NM
"""Half of the P-V of the texture on both faces: what lies between pixels is of its size."""


def stepped(degrees, texture=0.0):
    """Return a face 600 nm above another, their edge turned, a wave of three pixels and a bit on both."""
    j, i = np.mgrid[:120, :120].astype(float)
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    z = STEP_HEIGHT * ((i - 59.7) * c + (j - 60.4) * s > 0.0)
    return ms.Surface(z + texture * np.sin(2 * np.pi * (i + 0.3 * j) / 3.3), 1.0, 1.0)


@pytest.mark.parametrize("degrees", [0.0, 90.0, 180.0, 31.0, 135.0])
def test_a_section_across_a_step_is_as_high_as_the_step_wherever_it_runs(degrees):
    for y in (60.0, 60.5, 61.3):  # on a row of pixels, between two, beside one
        for a, b in (
            ((10.5, y), (109.5, y)),
            ((y, 10.3), (y, 109.3)),
            ((20.2, y), (99.1, y + 31.0)),
        ):
            z = section_profile(stepped(degrees), a, b).z
            assert z.max() <= STEP_HEIGHT + 1e-9 * NM  # rounding; sinc and plane overshoot by 9 %
            assert z.min() >= -1e-9 * NM
            rough = section_profile(stepped(degrees, TEXTURE), a, b).z
            # a wave bends by twice its amplitude at most, along x and along y
            assert rough.max() <= STEP_HEIGHT + 5 * TEXTURE
            assert rough.min() >= -5 * TEXTURE


def test_a_round_section_and_a_height_do_not_overshoot_at_a_step():
    step = stepped(31.0)
    ring = circle_section(step, (60.2, 59.9), 40.0).z
    assert np.ptp(ring) == pytest.approx(STEP_HEIGHT, abs=1e-9 * NM)
    beside = [height_at(step, (x, 60.5)) for x in np.arange(50.0, 70.0, 0.25)]
    assert 0.0 <= min(beside) < max(beside) <= STEP_HEIGHT + 1e-9 * NM


def test_a_pixel_that_stands_out_does_not_ring():
    z = np.zeros((40, 40))
    z[20, 20] = STEP_HEIGHT
    cut = section_profile(ms.Surface(z, 1.0, 1.0), (5.0, 20.5), (35.0, 20.5)).z
    assert cut.min() == pytest.approx(0.0, abs=1e-9 * NM)
    assert cut.max() == pytest.approx(STEP_HEIGHT / 2, abs=1e-9 * NM)


@pytest.mark.parametrize("length", [3.0, 3.5, 4.0, 5.2, 8.0, 20.0, 100.0])
def test_a_wave_in_any_direction_is_read_between_the_pixels_as_it_is(length):
    """The reading of people.md, C-2, written out anew: what is held back at a step is not at a wave."""
    for degrees in (0.0, 17.0, 45.0, 70.0):
        k = (
            2
            * np.pi
            / length
            * np.array([np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))])
        )
        j, i = np.mgrid[:60, :60].astype(float)
        z = np.cos(k[0] * i + k[1] * j + 0.4)
        at = [(20.3, 30.2), (25.5, 25.5), (31.0, 28.7), (33.9, 35.0), (28.6, 33.1)]
        for x, y in at:
            expected = _plane_and_lanczos(z, x, y)
            # heights of a wave of amplitude 1 m, through weights that add up to 1
            assert height_at(ms.Surface(z, 1.0, 1.0), (x, y)) == pytest.approx(expected, abs=1e-9)


def _plane_and_lanczos(z, x, y):
    i, j = np.arange(int(x) - 3, int(x) + 5), np.arange(int(y) - 3, int(y) + 5)
    X, Y = (v.ravel() for v in np.meshgrid(i - x, j - y))
    basis = np.stack([np.ones_like(X), X, Y, X * Y], axis=1)
    patch = z[np.ix_(j, i)].ravel()
    found = np.linalg.lstsq(basis, patch, rcond=None)[0]
    a, b = (np.sinc(v) * np.sinc(v / 4) for v in (j - y, i - x))
    weights = np.outer(a / a.sum(), b / b.sum()).ravel()
    return found[0] + weights @ (patch - basis @ found)


def test_a_band_damps_the_waves_across_it_by_the_closed_form():
    j = np.arange(80.0)
    surface = ms.Surface(
        np.tile(np.cos(2 * np.pi * (j - 40.0) / 17.0)[:, None], (1, 60)), 1.0, 1.0
    )

    for width in (10.0, 11.9):  # n = 2 floor(w / 2s) + 1 = 11 of both
        cut = section_profile(surface, (10.0, 40.0), (50.0, 40.0), width=width)
        np.testing.assert_allclose(cut.z, 0.442877, rtol=0.0, atol=EXACT)
    one = section_profile(surface, (10.0, 40.0), (50.0, 40.0), width=1.9)
    np.testing.assert_array_equal(one.z, 1.0)


def test_a_band_takes_lines_in_pairs_and_half_of_them_at_least():
    z = np.arange(20.0)[:, None] + np.zeros((1, 30))
    z[:8, 12] = np.nan  # line -2 of 5: its image 2 goes too, and 3 of 5 remain
    z[:9, 20] = np.nan  # lines -2 and -1: the middle alone remains
    z[9, 22] = np.nan  # the middle: two pairs remain
    cut = section_profile(ms.Surface(z, 1.0, 1.0), (5.0, 9.0), (25.0, 9.0), width=4.0)

    expected = np.full(21, 9.0)
    expected[20 - 5] = np.nan
    np.testing.assert_allclose(cut.z, expected, rtol=0.0, atol=1e-12)
    note = cut.history[-1].parameters
    assert note["lines"] == 5
    assert note["lines_share"] == pytest.approx((18 * 5 + 3 + 4) / 20 / 5, abs=1e-12)


@pytest.mark.parametrize("method", ["lanczos", "bilinear"])
@pytest.mark.parametrize("where", ["gap on the left", "gap on the right", "rim"])
def test_a_band_beside_a_gap_or_the_rim_leaves_a_tilted_plane_as_it_is(method, where):
    y, x = np.mgrid[:60, :80] * UM
    z = 0.4e-3 * x - 1e-3 * y  # 1 mrad across the section: 1 nm from line to line
    a, b = (10 * UM, 20 * UM), (60 * UM, 20 * UM)
    if where == "rim":
        a, b = (10 * UM, 7 * UM), (60 * UM, 7 * UM)  # three of 21 lines lie outside
    else:
        rows = slice(28, 36) if where == "gap on the left" else slice(5, 13)
        z[rows, 30:50] = np.nan  # lines 8 to 10 of one side
    cut = section_profile(ms.Surface(z, UM, UM), a, b, width=20 * UM, method=method)
    plane = 0.4e-3 * (a[0] + cut.x) - 1e-3 * a[1]
    # rounding; the mean of the 18 lines of one side would lie 1.5 nm beside it
    np.testing.assert_allclose(cut.z, plane, rtol=0.0, atol=1e-6 * NM)
    share = 15 / 21 if where == "rim" else (31 + 20 * 15 / 21) / 51
    assert cut.history[-1].parameters["lines_share"] == pytest.approx(share, abs=1e-12)


@pytest.mark.parametrize("steps", [(None, None), (1 * UM, None), (None, 1 * UM)])
def test_a_map_without_both_lateral_steps_has_no_section(steps):
    surface = ms.Surface(np.arange(900.0).reshape(30, 30) * NM, *steps)
    for call in (
        lambda: surface.section((1, 1), (20, 20)),
        lambda: surface.section((1, 1), (20, 20), width="5 um"),
        lambda: surface.circle_section((10, 10), 5),
    ):
        with pytest.raises(DataError, match=r"write it in pixels, .* or give lateral_step ="):
            call()
    with pytest.raises(DataError, match="width is given in a unit of length"):
        section_profile(surface, (1, 1), (20, 20), width="5 um")


def ring_of(surface):
    return circle_section(surface, (150.0, 140.0), 100.0)


def tilted(third=3 * NM):
    j, i = np.mgrid[:300, :320].astype(float)
    theta = np.arctan2(j - 140.0, i - 150.0)
    return ms.Surface(2 * NM * i - 1 * NM * j + third * np.cos(3 * theta), 1.0, 1.0)


def test_a_round_section_and_its_harmonics():
    ring = ring_of(tilted())

    assert len(ring) == 629
    amplitude, phase = harmonics(ring, [1, 3])
    assert amplitude[0] == pytest.approx(223.606797 * NM, abs=223.6 * NM * EXACT)
    assert np.degrees(phase[0]) == pytest.approx(26.565051, abs=1e-5)
    assert amplitude[1] == pytest.approx(3.000005 * NM, abs=3 * NM * EXACT)


def test_a_round_section_runs_from_x_to_y_and_does_not_close():
    ring = ring_of(tilted(third=0.0))
    quarter = np.interp(100.0 * np.pi / 2, ring.x, ring.z)
    assert ring.z[0] == pytest.approx((2 * 250 - 140) * NM, abs=1e-4 * NM)
    assert quarter == pytest.approx((2 * 150 - 240) * NM, abs=0.01 * NM)  # between two samples
    assert ring.x[-1] == pytest.approx(2 * np.pi * 100 * 628 / 629, abs=1e-9)


def test_harmonics_of_a_circle_with_a_gap_are_refused():
    z = tilted().z.copy()
    z[140, 250] = np.nan
    with pytest.raises(TooFewSamplesError, match="gaps"):
        harmonics(ring_of(ms.Surface(z, 1.0, 1.0)), [1])


A, B, C = (1.2 * MM, -0.4 * MM, 3.1 * UM), (2.05 * MM, 0.37 * MM, -0.8 * UM), (0.6 * MM, 0.9 * MM)


def test_distances():
    found = distance(A, B)
    assert found.lateral == pytest.approx(1.14690889 * MM, abs=1e-8 * MM)
    assert found.distance == pytest.approx(1.14691552 * MM, abs=1e-8 * MM)
    assert np.degrees(found.azimuth) == pytest.approx(42.1728754, abs=1e-7)
    assert found.slope == pytest.approx(-3.40043137e-3, abs=1e-11)
    assert found.height == pytest.approx(-3.9 * UM, abs=1e-15)
    back = distance(B, A)
    assert back.slope == -found.slope
    assert np.degrees(back.azimuth) == pytest.approx(42.1728754 - 180.0, abs=1e-7)


def test_an_angle_and_a_circle_of_three_points():
    assert np.degrees(angle_at(A, B, C)) == pytest.approx(62.2511049, abs=1e-7)
    assert angle_at(C, B, A) == angle_at(A, B, C)
    centre, diameter = circle_through(A, B, C)
    assert centre == pytest.approx((1.24196554 * MM, 0.407830249 * MM), abs=1e-8 * MM)
    assert diameter == pytest.approx(1.61783907 * MM, abs=1e-8 * MM)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: distance((1.0, 1.0, 0.0), (1.0, 1.0, 5.0)), "on one another"),
        (lambda: angle_at((0.0, 0.0), (1.0, 1.0), (1.0, 1.0)), "three points"),
        (lambda: circle_through((0.0, 0.0), (1.0, 1.0), (3.0, 3.0)), "one line"),
        (lambda: circle_section(tilted(), (0.0, 0.0), 0.0), "positive"),
        (lambda: circle_section(tilted(), (0.0, 0.0), 1e9), "10000000 samples"),
        (lambda: section_profile(tilted(), (1, 1), (1, 1)), "its ends must differ"),
        (lambda: section_profile(tilted(), (1, 1), (9, 1), width=-1.0), "width"),
        (lambda: section_profile(tilted(), (1, 1), (9, 1), width=1e7), "lines"),
    ],
)
def test_what_is_no_section_is_refused(call, words):
    with pytest.raises(DataError, match=words):
        call()


def test_lengths_with_units_and_a_height():
    surface = ms.Surface(
        np.arange(12.0) * NM + np.zeros((9, 1)), "2 um", "1 um", origin=(0.0, 5 * UM)
    )
    cut = section_profile(surface, ("2 um", "7 um"), ("20 um", "7 um"), width="2 um")
    assert cut.z[0] == pytest.approx(1 * NM, abs=1e-18)
    assert cut.z[-1] == pytest.approx(10 * NM, abs=1e-18)
    assert height_at(surface, ("5 um", "7.5 um")) == pytest.approx(2.5 * NM, abs=1e-18)
    assert np.isnan(height_at(surface, ("5 um", "4 um")))


@pytest.mark.parametrize("angle", [45.0, 30.0, 17.0])
@pytest.mark.parametrize("wavelength", [4.3, 6.0])
def test_dropouts_beside_a_line_take_no_amplitude_from_short_waves(angle, wavelength):
    """2 % single dropouts leave few points whose 64 pixels were all measured: bilinear ones lost 12 %."""
    lost = np.random.default_rng(8).random((200, 200)) < 0.02
    z = np.broadcast_to(np.sin(2 * np.pi / wavelength * np.arange(200.0)), lost.shape)
    holed = ms.Surface(np.where(lost, np.nan, z), 1.0, 1.0)
    c, s = np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))
    line = ((20.0, 20.0), (20.0 + 140.0 * c, 20.0 + 140.0 * s))
    found = holed.section(*line)
    seen = ~np.isnan(found.z)
    true = np.sin(2 * np.pi / wavelength * (20.0 + c * found.x))[seen]
    amplitude = found.z[seen] @ true / (true @ true)
    assert amplitude == pytest.approx(1.0, abs=0.01)  # 2 % is asked for
    assert np.sqrt(np.mean((found.z[seen] - true) ** 2)) < 0.011 * np.sqrt(0.5)
    # none of the gaps is filled
    assert (seen == ~np.isnan(holed.section(*line, method="bilinear").z)).all()


def test_beside_a_large_hole_nothing_is_predicted():
    z = np.random.default_rng(9).standard_normal((60, 60))
    z[20:40, 30:34] = np.nan
    line = ((2.0, 20.0), (57.0, 41.0))
    found, plain = (
        ms.Surface(z, 1.0, 1.0).section(*line, method=method) for method in ("lanczos", "bilinear")
    )
    beside = np.abs(found.x * 55.0 / np.hypot(55.0, 21.0) + 2.0 - 31.5) < 3.0
    assert (np.isnan(found.z) == np.isnan(plain.z)).all()
    np.testing.assert_array_equal(found.z[beside], plain.z[beside])
