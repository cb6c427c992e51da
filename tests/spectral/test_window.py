"""Windows against eq. 5 written out and against scipy."""

import math

import numpy as np
import pytest
from scipy.signal.windows import tukey

from metrosep.errors import DataError
from metrosep.spectral import kono_weights, tukey_weights

EXACT = 0.0
ROUNDING = 1e-15


def eq5(i, n_d, N):
    """Eq. 5 of motion-error-fourier, one sample, i from 1."""
    if 1 <= i < N:
        return -0.5 * math.cos(2 * math.pi * (i - 1) / (2 * N)) + 0.5
    if N <= i <= n_d - N:
        return 1.0
    return -0.5 * math.cos(2 * math.pi * (i - n_d + N - 1) / (2 * N) - math.pi) + 0.5


@pytest.mark.parametrize(
    ("n", "taper"), [(100, 10), (704, 70), (583, 58), (21, 3), (8, 4), (2, 1)]
)
def test_kono_weights_are_eq5_in_every_sample(n, taper):
    literal = np.array([eq5(i, n, taper) for i in range(1, n + 1)])

    assert np.abs(kono_weights(n, taper) - literal).max() <= ROUNDING


def test_kono_weights_published_samples():
    weights = kono_weights(100, 10)

    assert weights[0] == EXACT
    assert weights[9] == 1.0
    assert weights[90] == pytest.approx(1.0, abs=ROUNDING)
    assert weights[99] == pytest.approx(0.0244717, abs=5e-8)


def test_kono_weights_start_at_zero_and_end_above_it():
    weights = kono_weights(300, 30)

    assert weights[0] == 0.0
    assert weights[-1] == pytest.approx(math.sin(math.pi / 60) ** 2, abs=ROUNDING)


def test_kono_weights_are_the_periodic_tukey_but_for_one_sample():
    n, taper = 583, 58
    difference = np.abs(kono_weights(n, taper) - tukey(n, 2 * taper / n, sym=False))

    assert np.flatnonzero(difference > 1e-12).tolist() == [taper - 1]
    assert difference.max() == pytest.approx(7.33e-4, abs=5e-7)


def test_mean_and_mean_square_weight_of_ten_percent():
    weights = kono_weights(583, 58)

    assert weights.mean() == pytest.approx(0.9005, abs=5e-5)
    assert (weights**2).mean() == pytest.approx(0.8756, abs=5e-5)


def test_tukey_is_symmetric_and_kono_is_not():
    assert np.array_equal(tukey_weights(50, 7), tukey_weights(50, 7)[::-1])
    assert not np.array_equal(kono_weights(50, 7), kono_weights(50, 7)[::-1])


@pytest.mark.parametrize(("n", "taper"), [(10, 6), (10, 0), (0, 1)])
def test_taper_out_of_range_raises(n, taper):
    with pytest.raises(DataError, match=r"taper|samples"):
        kono_weights(n, taper)


@pytest.mark.parametrize("weights", [kono_weights, tukey_weights])
@pytest.mark.parametrize("sizes", [(100, 2.5), (100.5, 2), ("a", 2), (100, "a"), (100, True)])
def test_numbers_of_samples_that_are_not_whole_are_refused(weights, sizes):
    with pytest.raises(DataError, match="whole number"):
        weights(*sizes)
