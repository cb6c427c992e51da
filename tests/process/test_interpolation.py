"""What a controller makes of points: slopes of the spline against closed forms and scipy."""

import math

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.process.interpolation import dense_rows, evaluate, fitted_heights, knot_slopes
from metrosep.process.path_errors import estimated_points, sine_path_error, sine_path_step

ROUNDING = 1e-12
"""Of numbers near one in double precision, with some ten operations."""

S = np.array([0.0, 1.0, 1.5, 3.0, 3.2, 5.0, 6.0])


def wave(s):
    return np.sin(s) + 0.1 * s**2


def cubic(s):
    return 2.0 + 3.0 * s - s**2 + 0.25 * s**3


def test_not_a_knot_reproduces_a_cubic():
    slopes = knot_slopes(S, cubic(S))

    at = np.linspace(0.0, 6.0, 61)
    assert np.abs(slopes - (3.0 - 2.0 * S + 0.75 * S**2)).max() < 10 * ROUNDING
    assert np.abs(evaluate(S, cubic(S), slopes, at) - cubic(at)).max() < 100 * ROUNDING


@pytest.mark.parametrize("end", ["not-a-knot", "natural", "clamped"])
def test_each_end_condition_equals_another_implementation(end):
    z = wave(S)
    given = (0.7, -0.4)
    peer = CubicSpline(S, z, bc_type=((1, given[0]), (1, given[1])) if end == "clamped" else end)

    slopes = knot_slopes(S, z, end=end, end_slopes=given)

    assert np.abs(slopes - peer(S, 1)).max() < 10 * ROUNDING
    at = np.linspace(0.0, 6.0, 61)
    assert np.abs(evaluate(S, z, slopes, at) - peer(at)).max() < 10 * ROUNDING


@pytest.mark.parametrize("spline", [False, True])
def test_dense_rows_equal_point_by_point(spline):
    z = wave(S)
    slopes = knot_slopes(S, z) if spline else None
    fractions = np.array([0.0, 0.3, 0.9])

    rows = dense_rows(z, np.diff(S), slopes, fractions)

    at = S[:-1, None] + np.diff(S)[:, None] * fractions
    peer = CubicSpline(S, z)(at) if spline else np.interp(at, S, z)
    assert np.abs(rows - peer).max() < 10 * ROUNDING
    assert np.abs(evaluate(S, z, slopes, at.ravel()) - peer.ravel()).max() < 10 * ROUNDING


def test_nothing_is_said_outside_of_the_knots():
    z = evaluate(S, wave(S), None, np.array([-0.1, 0.0, 6.0, 6.1, np.nan]))

    assert np.isnan(z).tolist() == [True, False, False, True, True]


@pytest.mark.parametrize("interpolation", ["linear", "spline"])
def test_fitted_heights_are_the_minimum(interpolation):
    at = np.linspace(0.0, 6.0, 121)
    wanted = np.sin(2.0 * at)

    def course(z):
        slopes = knot_slopes(S, z) if interpolation == "spline" else None
        return evaluate(S, z, slopes, at)

    heights = fitted_heights(S, at, wanted, interpolation=interpolation)

    residual = course(heights) - wanted
    for i in range(S.size):
        moved = course(heights + 1e-3 * (np.arange(S.size) == i)) - course(heights)
        assert abs(float(moved @ residual)) < 1e-9  # orthogonal: 1e-3 times rounding of a solve
    assert residual @ residual < 0.9 * np.sum((course(np.sin(2.0 * S)) - wanted) ** 2)


def test_fitted_heights_of_a_cubic_lie_on_it():
    at = np.linspace(0.0, 6.0, 121)

    heights = fitted_heights(S, at, cubic(at), interpolation="spline")

    assert np.abs(heights - cubic(S)).max() < 1000 * ROUNDING


def test_input_is_not_changed():
    s, z = S.copy(), wave(S)
    kept = z.copy()
    knot_slopes(s, z)
    assert (s == S).all()
    assert (z == kept).all()


@pytest.mark.parametrize(
    ("s", "z", "error", "match"),
    [
        ([0, 1, 2], [0, 1, 2], TooFewSamplesError, "at least 4"),
        ([0, 1, 1, 2], [0, 1, 2, 3], InvalidSamplesError, "grow strictly: number 1"),
        ([0, 1, 2, 3], [0, math.nan, 2, 3], InvalidSamplesError, "point 1"),
        ([0, 1, math.nan, 3], [0, 1, 2, 3], InvalidSamplesError, "grow"),
        ([0, 1, 2, 3], [0, 1, 2], InvalidSamplesError, "equally long"),
        ([0, 1, 2, 3], [0, math.inf, 2, 3], InvalidSamplesError, "infinite"),
    ],
)
def test_refuses_points(s, z, error, match):
    with pytest.raises(error, match=match):
        knot_slopes(s, z)


def test_refuses_words_and_empty_intervals():
    x = np.linspace(0.0, 1.0, 30)
    with pytest.raises(DataError, match="linear, spline, got 'nurbs'"):
        fitted_heights(x[::5], x, x, interpolation="nurbs")
    with pytest.raises(DataError, match="end_slopes"):
        knot_slopes(x, x, end="clamped", end_slopes=None)
    with pytest.raises(DataError, match="end_slopes"):
        knot_slopes(x, x, end="clamped", end_slopes=(0.0, math.nan))
    with pytest.raises(DataError, match="end condition"):
        knot_slopes(S, wave(S), end="periodic")
    at = np.linspace(0.0, 1.0, 20)
    with pytest.raises(InvalidSamplesError, match="every interval"):
        fitted_heights(S, at, at, interpolation="linear")
    with pytest.raises(TooFewSamplesError, match="needs 4"):
        fitted_heights([0.0, 1.0, 2.0], at, at, interpolation="spline")


@pytest.mark.parametrize("step", [5e-6, 17.45e-6, 40e-6])
@pytest.mark.parametrize("interpolation", ["linear", "spline"])
def test_error_of_a_sine_equals_simulation(step, interpolation):
    s = np.arange(0.0, 40_000e-6, step)
    at = s[s.size // 4] + np.arange(0.0, 15_000e-6, step / 20)
    z = 50e-9 * np.sin(2 * np.pi * s / 100e-6)
    made = np.interp(at, s, z) if interpolation == "linear" else CubicSpline(s, z)(at)
    simulated = np.ptp(made - 50e-9 * np.sin(2 * np.pi * at / 100e-6))

    closed = sine_path_error(50e-9, 100e-6, step, interpolation=interpolation)

    # Simulated phases are discrete; the planned value is the bound over all of them.
    assert simulated <= closed * (1.0 + 1e-6)
    assert simulated > 0.94 * closed
    back = sine_path_step(50e-9, 100e-6, closed, interpolation=interpolation)
    assert back == pytest.approx(step, abs=1e-12)


def test_series_of_the_closed_forms():
    w = 2.0 * np.pi * 2e-6 / 100e-6
    linear = sine_path_error(50e-9, 100e-6, 2e-6, interpolation="linear")
    spline = sine_path_error(50e-9, 100e-6, 2e-6, interpolation="spline")
    # The next terms of the series are w^2 / 48 and about w^2 / 4 of the first.
    assert linear == pytest.approx(2 * 50e-9 * w**2 / 8, abs=linear * w**2 / 40)
    assert spline == pytest.approx(2 * 50e-9 * w**4 / 384, abs=spline * w**2 / 3)


def test_planned_counts_of_the_paper():
    # The search without a free end finds 38,746 and 176,082; the specification 176,000.
    assert estimated_points(
        50e-9, 100e-6, 500e-6, 2e-6, 1e-9, interpolation="linear"
    ) == pytest.approx(176_000, abs=0.02 * 176_000)
    with pytest.raises(DataError, match="half the wavelength"):
        sine_path_error(50e-9, 100e-6, 60e-6, interpolation="linear")
    with pytest.raises(DataError, match="distribution"):
        estimated_points(50e-9, 100e-6, 500e-6, 2e-6, 1e-9, distribution="spiral")
    with pytest.raises(DataError, match="one of linear, spline"):
        sine_path_error(50e-9, 100e-6, 6e-6, interpolation="nurbs")
