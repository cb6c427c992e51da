"""Capability and control limits: closed forms, a published example, and what is refused."""

import math

import numpy as np
import pytest

from metrosep.core.errors import DataError
from metrosep.parameters.gauge import capability_of, control_limits

ROUNDING = 1e-12
PRINTED = 0.005  # half of the last printed digit
ROUNDED = 0.006  # the book goes on with its rounded Cp and tabled quantiles


def _sample(n, mean, sd):
    """Values with exactly this mean and standard deviation (n - 1)."""
    z = np.sin(np.arange(n) * 1.7)
    z = (z - z.mean()) / z.std(ddof=1)
    return list(mean + sd * z)


def test_published_intervals_of_cp():
    """Montgomery, Introduction to Statistical Quality Control, interval of Cp: limits 38 and 62,
    n = 20, s = 1.75: Cp = 2.29, 95 % from 1.57 to 3.01."""
    found = capability_of(_sample(20, 50.0, 1.75), lower=38.0, upper=62.0)

    assert found.cp == pytest.approx(2.29, abs=PRINTED)
    assert found.cp_low == pytest.approx(1.57, abs=ROUNDED)
    assert found.cp_high == pytest.approx(3.01, abs=ROUNDED)


def test_the_interval_of_cp_by_tabled_quantiles():
    """chi2 of 29 degrees of freedom: 16.047 and 45.722 in every table."""
    found = capability_of(_sample(30, 0.0, 1.0), lower=-4.5, upper=4.5)

    assert found.cp == pytest.approx(1.5, abs=ROUNDING)
    assert found.cp_low == pytest.approx(1.5 * math.sqrt(16.047 / 29), abs=1e-4)
    assert found.cp_high == pytest.approx(1.5 * math.sqrt(45.722 / 29), abs=1e-4)


def test_the_interval_of_cpk_of_bissell():
    """Cpk = 1.33 with n = 20: half width 1.96 * 1.33 * sqrt(1 / (9 * 20 * 1.33^2) + 1 / 38) = 0.447."""
    found = capability_of(_sample(20, 0.0, 1.0), upper=3.99)

    assert found.cpk == pytest.approx(1.33, abs=ROUNDING)
    assert found.cpk_low == pytest.approx(0.883, abs=0.0005)
    assert found.cpk_high == pytest.approx(1.777, abs=0.0005)
    assert (found.cp, found.cp_low, found.cp_high) == (None, None, None)


@pytest.mark.parametrize(("mean", "cpk"), [(1.0, 2.0 / 3.0), (-1.0, 4.0 / 3.0), (4.0, -1.0 / 3.0)])
def test_cpk_is_of_the_nearer_limit(mean, cpk):
    """Limits -8 and 3: the upper one is nearer from -2.5 on."""
    found = capability_of(_sample(25, mean, 1.0), lower=-8.0, upper=3.0)

    assert found.cpk == pytest.approx(cpk, abs=ROUNDING)
    assert found.cpk_low < found.cpk < found.cpk_high


def test_a_lower_limit_alone():
    found = capability_of(_sample(25, 1.0, 0.5), lower=-2.0)

    assert found.cpk == pytest.approx(2.0, abs=ROUNDING)


def test_the_interval_covers_as_often_as_it_says():
    """2000 samples of 30 of a normal process with Cp = 1 and Cpk = 2/3: 95 % with sd 0.5 %."""
    rng = np.random.default_rng(5)
    covered = np.zeros(2)
    for _ in range(2000):
        found = capability_of(list(rng.standard_normal(30) + 1.0), lower=-3.0, upper=3.0)
        covered += [
            found.cp_low <= 1.0 <= found.cp_high,
            found.cpk_low <= 2.0 / 3.0 <= found.cpk_high,
        ]

    assert covered / 2000 == pytest.approx(0.95, abs=0.02)


@pytest.mark.parametrize(
    ("values", "limits"),
    [
        (_sample(19, 0.0, 1.0), {"upper": 3.0}),
        ([*_sample(19, 0.0, 1.0), None, math.nan, math.inf], {"upper": 3.0}),
        (_sample(30, 0.0, 1.0), {}),
        ([0.1 + 0.2] * 30, {"upper": 3.0}),
        ([], {"upper": 3.0}),
    ],
)
def test_without_enough_of_anything_there_is_no_index(values, limits):
    assert capability_of(values, **limits) is None


def test_gaps_do_not_count():
    values = _sample(25, 1.0, 0.5)

    assert capability_of([None, *values, math.nan], lower=0.0) == capability_of(values, lower=0.0)


@pytest.mark.parametrize("limits", [(3.0, -3.0), (1.0, 1.0), (math.nan, 1.0), (0.0, math.inf)])
def test_limits_out_of_order_are_refused(limits):
    with pytest.raises(DataError, match="not in order"):
        capability_of(_sample(25, 0.0, 1.0), lower=limits[0], upper=limits[1])


def test_control_limits_by_hand():
    """Ranges 2, 1, 3: mean 2; values 1, 3, 2, 5: mean 2.75; 2.75 -+ 2.66 * 2; 3.267 * 2."""
    found = control_limits([1.0, 3.0, 2.0, 5.0])

    assert found.mean == pytest.approx(2.75, abs=ROUNDING)
    assert found.lower == pytest.approx(-2.57, abs=ROUNDING)
    assert found.upper == pytest.approx(8.07, abs=ROUNDING)
    assert found.mean_range == pytest.approx(2.0, abs=ROUNDING)
    assert found.upper_range == pytest.approx(6.534, abs=ROUNDING)


def test_the_constants_are_those_of_normal_ranges():
    """The mean range of two normal values is 1.128 sd: the limits are at three sd."""
    values = np.random.default_rng(1).standard_normal(200_000)

    found = control_limits(list(values))

    assert found.upper == pytest.approx(3.0, abs=0.02)
    assert found.upper_range == pytest.approx(3.267 * 2.0 / math.sqrt(math.pi), abs=0.02)


def test_a_gap_has_no_range_to_either_side():
    assert control_limits([1.0, None, 9.0, 10.0]).mean_range == pytest.approx(1.0, abs=ROUNDING)


@pytest.mark.parametrize("values", [[], [1.0], [1.0, None, 2.0], [None, math.nan]])
def test_without_neighbours_there_are_no_control_limits(values):
    assert control_limits(values) is None
