"""Knots by error: closed forms of the parabola, an exhaustive search, references, bad input."""

import itertools

import numpy as np
import pytest

from metrosep.compensation.knots import Knots, choose_knots, knots_for_tolerance, optimal_values
from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    TableError,
    TooFewSamplesError,
)

BISECTED = 3e-5  # relative end of the bisection of the tolerance, with its margin
SAMPLES = 401
# knots on the curve lie on samples: 4 intervals of 100 samples may be off by one
ON_SAMPLES = 0.025
LENGTH = 80e-3


def positions(n=SAMPLES):
    return np.linspace(0.0, LENGTH, n)


def parabola(x):
    """Bow of 8 um over the length: curvature a = 2 * 8 um / length^2."""
    return 8e-6 * (x / LENGTH) ** 2


def lopsided(x):
    """A bump at a fifth of the travel and a slow wave: no symmetry."""
    return 3e-6 * np.exp(-(((x - 0.2 * LENGTH) / 8e-3) ** 2)) + 0.4e-6 * np.sin(x / 6e-3)


def deviation(x, c, knots, values):
    """Largest deviation of the polyline, counted without library code."""
    at = np.sort(np.r_[x, knots])
    return np.abs(np.interp(at, knots, values) - np.interp(at, x, c)).max()


@pytest.mark.parametrize("n", [2, 3, 4, 6])
def test_parabola_free_values_a_h2_over_16(n):
    x = positions()
    h = LENGTH / (n - 1)
    expected = 2 * 8e-6 / LENGTH**2 * h**2 / 16
    found = choose_knots(x, parabola, n)
    # the parabola of samples 200 um apart is 1/100^2 off its own chords for n = 6
    assert found.residual == pytest.approx(expected, abs=4e-4 * expected)
    assert found.positions == pytest.approx(np.linspace(0, LENGTH, n), abs=LENGTH / SAMPLES)
    assert found.positions.size == n


@pytest.mark.parametrize("n", [2, 3, 5])
def test_parabola_on_the_curve_a_h2_over_8(n):
    x = positions()
    h = LENGTH / (n - 1)
    expected = 2 * 8e-6 / LENGTH**2 * h**2 / 8
    found = choose_knots(x, parabola(x), n, values="on curve")
    assert found.residual == pytest.approx(expected, abs=ON_SAMPLES * expected)
    assert found.values == pytest.approx(parabola(found.positions), abs=1e-15)


def test_number_of_knots_for_a_tolerance():
    x = positions(2001)
    for tolerance in (400e-9, 100e-9, 30e-9):
        # a h^2 / 16 <= tolerance, h = length / links
        links = int(np.ceil(np.sqrt(2 * 8e-6 / 16 / tolerance)))
        found = knots_for_tolerance(x, parabola, tolerance)
        assert found.positions.size == links + 1
        assert found.residual <= tolerance
        on = knots_for_tolerance(x, parabola, tolerance, values="on curve")
        assert on.residual <= tolerance * (1 + 1e-9)
        assert on.positions.size in (
            int(np.ceil(np.sqrt(2 * 8e-6 / 8 / tolerance))) + 1,
            int(np.ceil(np.sqrt(2 * 8e-6 / 8 / tolerance))) + 2,
        )


def test_polyline_is_found_again():
    knots, values = np.array([0, 13e-3, 30e-3, 80e-3]), np.array([0, 2e-6, -1e-6, 0.5e-6])
    x = np.union1d(positions(), knots)
    found = choose_knots(x, np.interp(x, knots, values), 4)
    assert found.residual < 1e-12
    # the corners are as sharp as the residual allows: 1 pm on slopes of 1e-4
    assert found.positions == pytest.approx(knots, abs=1e-7)
    assert found.values == pytest.approx(values, abs=1e-11)


def test_on_curve_against_exhaustive_search():
    x = np.linspace(0, LENGTH, 25)
    c = lopsided(x)
    best = min(
        deviation(x, c, x[[0, *inner, -1]], c[[0, *inner, -1]])
        for inner in itertools.combinations(range(1, 24), 3)
    )
    found = choose_knots(x, c, 5, values="on curve")
    assert found.residual == pytest.approx(best, abs=BISECTED * best)


def test_free_beats_every_trial_on_a_raster():
    from scipy.optimize import minimize

    x = np.linspace(0, LENGTH, 81)
    c = lopsided(x)
    found = choose_knots(x, c, 4)
    rng = np.random.default_rng(4)
    for _ in range(20):
        inner = np.sort(rng.uniform(1e-3, LENGTH - 1e-3, 2))

        def worst(p):
            knots = np.r_[0, np.sort(np.clip(p[:2], 1e-3, LENGTH - 1e-3)), LENGTH]
            if np.any(np.diff(knots) < 1e-6):
                return 1.0
            return deviation(x, c, knots, p[2:] * 1e-6) * 1e6

        start = np.r_[inner, np.interp(np.r_[0, inner, LENGTH], x, c) * 1e6]
        trial = minimize(worst, start, method="Nelder-Mead", options={"maxfev": 300})
        assert found.residual <= trial.fun * 1e-6 * (1 + BISECTED)


def test_free_knots_beat_even_ones_where_the_error_is_lopsided():
    x = positions()
    even = np.linspace(0, LENGTH, 4)
    evenly = deviation(x, lopsided(x), even, np.interp(even, x, lopsided(x)))
    found = choose_knots(x, lopsided, 4)
    assert found.residual < 0.6 * evenly
    assert found.residual == pytest.approx(
        deviation(x, lopsided(x), found.positions, found.values), abs=1e-18
    )
    assert choose_knots(x, lopsided, 4, values="on curve").residual <= evenly


def test_best_values_for_given_positions():
    x = positions()
    found = choose_knots(x, lopsided, 4)
    again = optimal_values(x, lopsided, found.positions)
    assert again.residual == pytest.approx(found.residual, abs=BISECTED * found.residual)
    h = LENGTH / 4
    even = optimal_values(x, parabola, np.linspace(0, LENGTH, 5))
    assert even.residual == pytest.approx(16e-6 / LENGTH**2 * h**2 / 16, abs=1e-11)


def test_reference_is_exactly_zero():
    x = positions()
    c = lopsided(x) - np.interp(31e-3, x, lopsided(x))
    for kind in ("free", "on curve"):
        found = choose_knots(x, c, 6, reference=31e-3, values=kind)
        assert abs(found(31e-3)) < 1e-20
        assert found.residual == pytest.approx(
            deviation(x, c, found.positions, found.values), abs=1e-15
        )
    on = choose_knots(x, c, 6, reference=31e-3, values="on curve")
    assert 31e-3 in on.positions
    assert on.values == pytest.approx(np.interp(on.positions, x, c), abs=1e-18)
    ends = choose_knots(x, lopsided(x) - lopsided(x)[0], 4, reference=0.0)
    assert ends.values[0] == 0.0
    assert ends.positions[0] == 0.0
    free = choose_knots(x, c, 6)
    assert choose_knots(x, c, 6, reference=31e-3).residual >= free.residual * (1 - BISECTED)


def test_knots_on_a_grid():
    x = positions()
    grid = np.arange(0, 81, 4) * 1e-3
    for kind in ("free", "on curve"):
        found = choose_knots(x, lopsided, 5, grid=grid, values=kind)
        assert found.positions.size == 5
        assert np.abs(found.positions[:, None] - grid).min(axis=1).max() < 1e-12
        loose = choose_knots(x, lopsided, 5, values=kind)
        assert loose.residual * (1 - ON_SAMPLES) <= found.residual <= 3 * loose.residual


@pytest.mark.parametrize("kind", ["free", "on curve"])
def test_scale_shift_and_mirror_do_not_matter(kind):
    x = positions(201)
    one = choose_knots(x, lopsided, 5, values=kind)
    scaled = choose_knots(1e3 * x, 1e6 * lopsided(x), 5, values=kind)
    assert scaled.residual == pytest.approx(1e6 * one.residual, abs=1e6 * BISECTED * one.residual)
    mirrored = choose_knots(-x[::-1], -lopsided(x)[::-1], 5, values=kind)
    assert mirrored.residual == pytest.approx(one.residual, abs=BISECTED * one.residual)
    far = choose_knots(x + 5.0, lopsided(x) + 1e-3, 5, values=kind)
    assert far.residual == pytest.approx(one.residual, abs=BISECTED * one.residual)


def test_straight_and_flat_curves():
    x = positions()
    for c in (0 * x, 3e-6 + 0 * x, 1e-4 * x):
        found = choose_knots(x, c, 4)
        assert found.positions.size == 4
        assert found.residual < 1e-18
        assert knots_for_tolerance(x, c, 1e-9).positions.size == 2


def test_two_samples_and_integers():
    found = choose_knots([0, 1], [0, 2], 3)
    assert found.positions == pytest.approx([0, 0.5, 1], abs=1e-15)
    assert found.values == pytest.approx([0, 1, 2], abs=1e-12)
    assert isinstance(found, Knots)
    assert not found.positions.flags.writeable
    assert found.audit["n_knots"] == 3


def test_step_and_noise_stay_inside():
    x = positions(201)
    noise = np.random.default_rng(1).normal(0, 10e-9, x.size)
    for c in (np.where(x > 31e-3, 1e-6, 0.0), noise):
        for tolerance in (100e-9, 12e-9):
            found = knots_for_tolerance(x, c, tolerance)
            assert np.all(np.diff(found.positions) > 0)
            assert found.residual <= tolerance


def test_inputs_are_not_changed():
    x, c = positions(), lopsided(positions())
    x0, c0 = x.copy(), c.copy()
    choose_knots(x, c, 4, reference=None)
    assert (x == x0).all()
    assert (c == c0).all()


def test_bad_input_is_refused():
    x = positions()
    c = lopsided(x)
    with pytest.raises(TooFewSamplesError, match="at least 2 knots"):
        choose_knots(x, c, 1)
    with pytest.raises(TooFewSamplesError, match="at least 2 sample"):
        choose_knots([1.0], [0.0], 2)
    with pytest.raises(InvalidSamplesError, match="rise strictly"):
        choose_knots(x[::-1], c, 4)
    with pytest.raises(DataError, match="one value a position"):
        choose_knots(x, c[:-1], 4)
    hole = c.copy()
    hole[7] = np.nan
    with pytest.raises(InvalidSamplesError, match=r"nan at 1\.4 mm"):
        choose_knots(x, hole, 4)
    with pytest.raises(InvalidSamplesError, match="infinite"):
        choose_knots(np.r_[x[:-1], np.inf], c, 4)
    with pytest.raises(InvalidSamplesError, match="nan"):
        choose_knots(x, np.ma.masked_greater(c, 1e-6), 4)
    for wrong in (2.5, "4", float("nan"), float("inf")):
        with pytest.raises(DataError, match="whole number"):
            choose_knots(x, c, wrong)
    with pytest.raises(DataError, match="below the rounding"):
        knots_for_tolerance(x, c, 1e-22)
    with pytest.raises(DataError, match="use 'free'"):
        choose_knots(x, c, 4, values="middle")
    with pytest.raises(TableError, match="subtract it first"):
        choose_knots(x, c, 4, reference=16e-3)
    with pytest.raises(TableError, match="outside"):
        choose_knots(x, c, 4, reference=0.2)
    with pytest.raises(TableError, match="the grid holds 4"):
        choose_knots(x, c, 9, grid=[10e-3, 20e-3])
    with pytest.raises(DataError, match="positive"):
        knots_for_tolerance(x, c, 0.0)
    with pytest.raises(DataError, match="positive"):
        knots_for_tolerance(x, c, float("nan"))
    with pytest.raises(TableError, match="the controller takes 4"):
        knots_for_tolerance(x, c, 1e-9, max_knots=4)
    with pytest.raises(TableError, match="must be the ends"):
        optimal_values(x, c, [0.0, 40e-3])


@pytest.mark.parametrize("twist", [0.0, 1e-17])
def test_knots_on_a_grid_are_as_good_as_the_exhaustive_search(twist):
    """Two knots are as good as four here: those that are added must not make it worse."""
    x = np.linspace(0.0, 60e-3, 61)
    c = 1e-6 * np.sin(2 * np.pi * x / 40e-3) + 2e-7 * x / 60e-3
    best = min(
        np.abs(np.interp(x, x[[0, i, j, 60]], c[[0, i, j, 60]]) - c).max()
        for i in range(1, 60)
        for j in range(i + 1, 60)
    )

    found = choose_knots(x, c, 4, grid=np.round(x, 3) + twist, values="on curve")

    assert found.positions.size == 4
    assert found.residual == pytest.approx(best, rel=1e-4, abs=0.0)
