"""`exact_correction`: the correction that is looked up at p but acts at p + c."""

import numpy as np
import pytest

from metrosep.compensation import exact_correction
from metrosep.errors import MetrosepError, NotConvergedError, TableError

PM = 1e-12
SETTLED = 2e-13
"""The fixed point is promised to 0.1 pm; rounding of 50 mm positions is far below."""


@pytest.mark.parametrize("a", [1e-3, -1e-3, 0.05, -0.05, 0.3, -0.3])
def test_linear_error_has_a_closed_form(a):
    p = np.linspace(-20e-3, 30e-3, 11)

    c = exact_correction(lambda x: a * x, p)

    np.testing.assert_allclose(c, -a * p / (1.0 + a), atol=SETTLED, rtol=0)


def test_constant_error_is_negated():
    c = exact_correction(lambda x: np.full(x.shape, 2e-6), np.array([0.0, 1e-3]))

    np.testing.assert_allclose(c, [-2e-6, -2e-6], atol=SETTLED, rtol=0)


def test_sign_is_minus_the_error_at_a_planted_bump(lopsided):
    p = np.linspace(0.0, 50e-3, 501)

    c = exact_correction(lopsided, p)

    i = int(np.argmin(c))
    assert c[i] == pytest.approx(-3e-6, rel=0.15, abs=0.0)
    assert p[i] == pytest.approx(12e-3, abs=0.6e-3)


def test_residual_of_the_plain_negative_is_error_times_slope():
    """Controllers notes, section 0: 6.2 um with slope 6e-4 leaves some nanometres."""
    amplitude, period = 3.1e-6, 2 * np.pi * 3.1e-6 / 6e-4
    p = np.linspace(0.0, 3 * period, 3001)

    def error(x):
        return amplitude + amplitude * np.sin(2 * np.pi * x / period)

    def slope(x):
        return 6e-4 * np.cos(2 * np.pi * x / period)

    left = error(p - error(p)) - error(p)

    assert np.abs(left).max() == pytest.approx(
        np.abs(error(p) * slope(p)).max(), rel=2e-3, abs=0.0
    )  # second order: e^2 e''/2
    assert 1e-9 < np.abs(left).max() < 6e-9


def test_exact_inverse_leaves_nothing():
    amplitude, period = 3.1e-6, 2 * np.pi * 3.1e-6 / 6e-4
    p = np.linspace(0.0, 3 * period, 3001)

    def error(x):
        return amplitude + amplitude * np.sin(2 * np.pi * x / period)

    c = exact_correction(error, p)

    np.testing.assert_allclose(error(p + c) + c, 0.0, atol=SETTLED, rtol=0)


def test_wrong_sign_doubles(lopsided):
    p = np.linspace(0.0, 50e-3, 501)

    c = exact_correction(lopsided, p)

    assert np.ptp(lopsided(p - c) - c) == pytest.approx(2 * np.ptp(lopsided(p)), rel=1e-2, abs=0.0)


@pytest.mark.parametrize("a", [-1.5, 1.5, 40.0])
def test_steep_error_is_refused_with_a_hint_at_units(a):
    with pytest.raises(TableError, match=r"turn back.*units"):
        exact_correction(lambda x: a * x, np.linspace(1e-3, 30e-3, 11))


def test_error_that_jumps_is_not_settled():
    def error(x):
        return np.where(x > 5e-6, 10e-6, -1e-6)

    with pytest.raises((NotConvergedError, TableError)):
        exact_correction(error, np.array([5e-6, 50e-3]))


def test_error_that_is_nowhere_known_is_refused():
    with pytest.raises(MetrosepError, match="not finite"):
        exact_correction(lambda x: np.full(x.shape, np.nan), np.linspace(0.0, 1e-2, 5))


def test_input_is_not_changed():
    p = np.linspace(0.0, 1e-2, 5)
    kept = p.copy()

    exact_correction(lambda x: 0.01 * x, p)

    np.testing.assert_array_equal(p, kept)
