"""Crossing-the-line segmentation: sines, notches, thresholds, gaps."""

import numpy as np
import pytest

from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.parameters._profile_rows import profile_elements

UM = 1e-6
CROSSING = 1e-9  # relative; linear interpolation between symmetric neighbours is exact


def sine(n=4000, period=100, phase=0.0, amplitude=1.0):
    i = np.arange(n)
    return i * UM, amplitude * np.cos(2 * np.pi * i / period + phase)


def test_spacing_of_a_sine_is_its_period():
    elements = profile_elements(*sine(), min_height=0.2)

    assert len(elements) == 39
    assert elements.mean_spacing == pytest.approx(100 * UM, rel=CROSSING, abs=0.0)
    assert elements.mean_height == pytest.approx(2.0, rel=CROSSING, abs=0.0)
    assert elements.start[0] == pytest.approx(
        25 * UM, rel=CROSSING, abs=0.0
    )  # the cosine goes down there


def test_crossings_lie_between_samples():
    x, z = sine(period=20 * np.sqrt(2))

    elements = profile_elements(x, z, min_height=0.2)

    assert elements.mean_spacing == pytest.approx(20 * np.sqrt(2) * UM, rel=1e-4, abs=0.0)


def test_first_element_starts_at_the_first_crossing_up_or_down():
    x, z = sine(phase=0.1)

    down = profile_elements(x, z, min_height=0.2)
    up = profile_elements(x, -z, min_height=0.2)

    assert np.array_equal(down.start, up.start)


def test_both_directions_of_pairs():
    x = np.arange(9) * UM
    z = np.array([-1.0, 1, -1, -1, -1, 1, 1, -1, 1])  # crossings 0.5 1.5 4.5 6.5 7.5

    first = profile_elements(x, z, min_height=0.0)
    both = profile_elements(x, z, min_height=0.0, pairs="both")

    assert first.spacing == pytest.approx(np.array([4, 3]) * UM, rel=1e-9, abs=0.0)
    assert both.spacing == pytest.approx(np.array([4, 5, 3]) * UM, rel=1e-9, abs=0.0)


def test_both_pairs_do_not_know_the_direction_of_x(rng):
    z = np.convolve(rng.standard_normal(3000), np.ones(9), mode="valid")
    x = np.arange(z.size) * UM

    one = profile_elements(x, z, min_height=0.5, pairs="both")
    other = profile_elements(x, z[::-1], min_height=0.5, pairs="both")

    # no portion is dropped between two crossings of the same pair when the threshold is low
    assert len(one) == len(other)
    assert one.mean_height == pytest.approx(other.mean_height, rel=1e-12, abs=0.0)


def test_low_portions_join_their_neighbours():
    x = np.arange(8) * UM
    z = np.array([-1.0, 1, 1, -0.05, 1, 1, -1, 1])

    assert len(profile_elements(x, z, min_height=0.0)) == 2
    merged = profile_elements(x, z, min_height=0.1)
    assert merged.spacing == pytest.approx([(6.5 - 0.5) * UM], rel=1e-9, abs=0.0)
    assert merged.height == pytest.approx([2.0], rel=1e-9, abs=0.0)


def test_valleys_have_a_threshold_of_their_own():
    x = np.arange(8) * UM
    z = np.array([-1.0, 1, 1, -0.05, 1, 1, -1, 1])

    assert len(profile_elements(x, z, min_height=0.1, min_depth=0.01)) == 2


def test_narrow_portions_join_their_neighbours():
    x = np.arange(11) * UM
    z = np.array([-1.0, -1, 1, 1, -1, 1, 1, -1, -1, 1, 1])

    all_of_them = profile_elements(x, z, min_height=0.1)
    wide = profile_elements(x, z, min_height=0.1, min_width=1.2 * UM)

    assert all_of_them.spacing == pytest.approx(np.array([3, 4]) * UM, rel=1e-9, abs=0.0)
    assert wide.spacing == pytest.approx([7 * UM], rel=1e-9, abs=0.0)


def test_small_portion_at_the_end_gives_no_crossing():
    x = np.arange(8) * UM
    z = np.array([-0.05, 1.0, 1, -1, -1, 1, 1, -1])

    every = profile_elements(x, z, min_height=0.0)
    high = profile_elements(x, z, min_height=0.1)

    assert every.start == pytest.approx([0.05 / 1.05 * UM], rel=1e-9, abs=0.0)
    assert high.start == pytest.approx([2.5 * UM], rel=1e-9, abs=0.0)


def test_what_an_end_cuts_low_takes_no_crossing_from_its_neighbour():
    x = np.arange(8) * UM
    z = np.array([-0.05, 1.0, 1, -1, -1, 1, 1, -0.05])  # crossings 1/21, 2.5, 4.5, 7 - 1/21

    both = profile_elements(x, z, min_height=0.1, pairs="both")

    assert both.start == pytest.approx(np.array([1 / 21, 2.5]) * UM, rel=1e-9, abs=0.0)
    assert both.spacing == pytest.approx((4.5 - 1 / 21) * UM * np.ones(2), rel=1e-9, abs=0.0)


def test_zeros_cross_in_their_middle():
    x = np.arange(9) * UM
    z = np.array([-1.0, 0, 0, 0, 1, 0, -1, 0, 1])

    elements = profile_elements(x, z, min_height=0.1)

    assert elements.start == pytest.approx([2 * UM], rel=1e-9, abs=0.0)
    assert elements.spacing == pytest.approx([5 * UM], rel=1e-9, abs=0.0)


def test_touching_zero_is_no_crossing():
    z = np.array([-1.0, 1, 0, 1, -1, 1])

    assert len(profile_elements(np.arange(6.0), z, min_height=0.1)) == 1


def test_gap_is_not_bridged():
    x, z = sine()
    z[1000:1400] = np.nan

    elements = profile_elements(x, z, min_height=0.2)

    assert elements.spacing == pytest.approx(
        np.full(len(elements), 100 * UM), rel=CROSSING, abs=0.0
    )
    assert len(elements) == 9 + 25  # crossings 25..975 and 1425..3975 (1400 begins at a peak)
    assert not ((elements.start < 1400 * UM) & (elements.start > 900 * UM)).any()


def test_missing_ends_are_cropped_ends():
    x, z = sine(phase=0.3)
    holed = z.copy()
    holed[:137] = holed[3500:] = np.nan

    one = profile_elements(x, holed, min_height=0.2)
    other = profile_elements(x[137:3500], z[137:3500], min_height=0.2)

    assert np.array_equal(one.start, other.start)
    assert np.array_equal(one.spacing, other.spacing)


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e6])
def test_height_unit_does_not_matter(scale):
    x, z = sine(phase=0.3)

    one = profile_elements(x, z, min_height=0.2)
    other = profile_elements(x, z * scale, min_height=0.2 * scale)

    assert other.spacing == pytest.approx(one.spacing, rel=CROSSING, abs=0.0)
    assert other.height == pytest.approx(one.height * scale, rel=CROSSING, abs=0.0)


@pytest.mark.parametrize("z", [np.zeros(50), np.ones(50), np.full(50, np.nan), np.arange(50.0)])
def test_no_crossing_no_element(z):
    elements = profile_elements(np.arange(50.0), z, min_height=0.0)

    assert len(elements) == 0
    assert np.isnan(elements.mean_spacing)
    assert np.isnan(elements.mean_height)


def test_bad_arguments_raise():
    x, z = sine(n=50)
    with pytest.raises(DataError, match="min_height"):
        profile_elements(x, z, min_height=-1.0)
    with pytest.raises(DataError, match="min_width"):
        profile_elements(x, z, min_height=0.0, min_width=np.nan)
    with pytest.raises(DataError, match="pairs"):
        profile_elements(x, z, min_height=0.0, pairs="second")
    with pytest.raises(InvalidSamplesError, match="one length"):
        profile_elements(x[:-1], z, min_height=0.0)
    with pytest.raises(InvalidSamplesError, match="rise"):
        profile_elements(x[::-1], z, min_height=0.0)
