"""Chip thickness and cusps: the paper's table, a drawn chip, brute-force ridges, refusals."""

import numpy as np
import pytest

from metrosep.core.errors import DataError, InvalidSamplesError, UnitError
from metrosep.process.chip import (
    approximate_chip_thickness,
    cusp_height,
    cusp_ra,
    max_chip_thickness,
)

NM = 1e-9


@pytest.mark.parametrize(
    ("R", "a", "expected"),
    [
        (1e-3, 2.0e-6, 124.436), (1e-3, 2.1e-6, 127.555), (1e-3, 2.2e-6, 130.601),
        (2e-3, 2.0e-6, 88.422), (2e-3, 2.1e-6, 90.630), (2e-3, 2.2e-6, 92.785),
    ],
)  # fmt: skip
def test_the_table_of_the_paper(R, a, expected):
    assert max_chip_thickness(R, 2e-6, a) / NM == pytest.approx(expected, abs=0.001)
    # the spec: within 0.1 nm
    assert approximate_chip_thickness(R, 2e-6, a) / NM == pytest.approx(expected, abs=0.1)


def test_row_1_to_its_digits_and_as_a_float():
    found = max_chip_thickness(1e-3, 2e-6, 2.2e-6)
    assert isinstance(found, float)
    assert found / NM == pytest.approx(130.6005, abs=0.0002)


def drawn_chip(R, f, a):
    """Thickness along rays from the nose centre, between the nose and what was there before."""
    ray = np.linspace(-np.pi / 2, np.pi / 2, 400001)
    direction = np.stack([np.sin(ray), -np.cos(ray)])
    free = np.where(direction[1] < 0, (a - R) / np.minimum(direction[1], -1e-12), np.inf)
    # the pass before stood f to the right: leave its circle
    b = f * direction[0]
    before = b + np.sqrt(np.maximum(b * b - f * f + R * R, 0))
    thickness = R - np.maximum(np.minimum(before, np.inf), 0)
    in_metal = np.minimum(thickness, R - free)
    return max(in_metal.max(), 0.0)


@pytest.mark.parametrize(
    ("R", "f", "a"),
    [(1e-3, 2e-6, 2.2e-6), (1e-3, 50e-6, 2e-6), (0.2e-3, 30e-6, 5e-6), (1e-3, 100e-6, 2e-6)],
)
def test_thickness_is_that_of_a_drawn_chip_also_for_wide_feeds(R, f, a):
    assert max_chip_thickness(R, f, a) == pytest.approx(drawn_chip(R, f, a), rel=2e-4, abs=0)


def test_limits_and_arrays():
    assert max_chip_thickness(1e-3, 0.0, 2e-6) == 0.0
    assert max_chip_thickness(1e-3, 2e-6, 0.0) == 0.0
    half = np.sqrt(2e-6 * (2e-3 - 2e-6))
    assert max_chip_thickness(1e-3, half, 2e-6) == pytest.approx(2e-6, abs=1e-15)
    found = max_chip_thickness([[1e-3], [2e-3]], 2e-6, [2e-6, 2.1e-6, 2.2e-6])
    assert found.shape == (2, 3)
    assert found[1, 2] / NM == pytest.approx(92.785, abs=0.001)
    # no cancellation: ten times less feed at a big nose still has its digits
    assert max_chip_thickness(0.05, 1e-9, 1e-7) == pytest.approx(1e-9 * 2e-3, rel=1e-3, abs=0)


def test_cusps_are_those_of_repeated_arcs():
    R, f = 50e-6, 20e-6
    x = np.linspace(-f / 2, f / 2, 200001)
    z = R - np.sqrt(R**2 - x**2)
    assert cusp_height(R, f, exact=True) == pytest.approx(np.ptp(z), rel=1e-12, abs=0)
    assert cusp_height(R, f) == pytest.approx(np.ptp(z), rel=0.02, abs=0)
    ra = np.abs(z - z.mean()).mean()
    assert cusp_ra(R, f) == pytest.approx(ra, rel=0.02, abs=0)
    x = np.linspace(-1e-6, 1e-6, 200001)
    z = x**2 / 2e-3
    assert cusp_ra(1e-3, 2e-6) == pytest.approx(np.abs(z - z.mean()).mean(), rel=1e-4, abs=0)


def test_cusps_of_the_paper():
    assert cusp_height(1e-3, 2e-6) / NM == pytest.approx(0.5, abs=1e-9)
    assert cusp_height([1e-3, 2e-3], 2e-6)[1] / NM == pytest.approx(0.25, abs=1e-9)
    assert cusp_ra(1e-3, 2e-6) / NM == pytest.approx(0.128, abs=0.0005)


@pytest.mark.parametrize(
    ("args", "error", "match"),
    [
        ((0.0, 2e-6, 2e-6), DataError, "R must be > 0"),
        ((-1e-3, 2e-6, 2e-6), DataError, "R must be > 0, got -0.001"),
        ((1.0, 2e-6, 2e-6), UnitError, "R = 1 m .* 1 mm is 0.001"),
        ((1e-3, 2.0, 2e-6), UnitError, "f = 2 m"),
        ((1e-3, 2e-6, 2.2), UnitError, "a = 2.2 m"),
        ((1e-3, -2e-6, 2e-6), DataError, "f must be >= 0"),
        ((1e-3, 2e-6, 2e-3), DataError, "depth 2 mm is more than the nose radius 1 mm"),
        ((1e-3, np.nan, 2e-6), InvalidSamplesError, "f is nan"),
        ((1e-3, np.inf, 2e-6), InvalidSamplesError, "f is inf"),
        ((1e-3, "2", 2e-6), UnitError, "f '2' has no unit"),
        ((1e-3, [1e-6, 2e-6], [1e-6, 2e-6, 3e-6]), InvalidSamplesError, "broadcast"),
    ],
)
def test_bad_input_is_named(args, error, match):
    with pytest.raises(error, match=match):
        max_chip_thickness(*args)


def test_feeds_wider_than_the_nose_are_refused():
    with pytest.raises(DataError, match="wider than the nose"):
        cusp_height(10e-6, 30e-6)
    with pytest.raises(DataError, match="wider than the nose"):
        cusp_ra(10e-6, 30e-6)
    with pytest.raises(DataError, match="wider than half the cut"):
        approximate_chip_thickness(1e-3, 100e-6, 2e-6)
