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
    with pytest.raises(DataError, match="values is one of free"):
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


ROUNDED = 1e-9  # what rounding leaves of a height of 1


def test_two_knots_on_the_curve_cannot_hold_a_reference_between_them():
    x = np.linspace(0.0, 1.0, 11)
    c = 1e-6 * (x**2 - 0.25)

    with pytest.raises(TableError, match="n=3 at least"):
        choose_knots(x, c, 2, values="on curve", reference=0.5)
    free = choose_knots(x, c, 2, reference=0.5)
    assert abs(free(0.5)) < 1e-20
    on = choose_knots(x, c, 3, values="on curve", reference=0.5)
    assert 0.5 in on.positions


@pytest.mark.parametrize("kind", ["free", "on curve"])
@pytest.mark.parametrize("n", [3, 4, 7])
def test_an_exact_answer_with_a_reference_is_found(n, kind):
    found = choose_knots([0, 0.15, 0.3], [1e-6, 0, 1e-6], n, reference=0.15, values=kind)

    assert found.positions.size == n
    assert found(np.array([0.0, 0.06, 0.15, 0.3])) == pytest.approx(
        [1e-6, 6e-7, 0, 1e-6], abs=1e-21
    )


@pytest.mark.parametrize("kind", ["free", "on curve"])
@pytest.mark.parametrize("n", [3, 5, 8, 12])
@pytest.mark.parametrize("seed", [0, 6, 12, 13])
def test_a_polyline_between_the_samples_of_a_v_is_exact(seed, n, kind):
    x = np.sort(np.random.default_rng(seed).uniform(0, 0.3, 27))
    x = np.union1d(x, [0.05]) if n == 3 else x
    c = 1e-6 * np.abs(x - 0.05)

    found = choose_knots(x, c, n, values=kind)

    assert found.positions.size == n
    assert found.residual < ROUNDED * np.ptp(c)
    assert (np.diff(found.positions) > 0).all()
    assert deviation(x, c, found.positions, found.values) < ROUNDED * np.ptp(c)


# 14 samples of a V whose search ended with two knots in one place
V14 = [-0.25887667, -0.20, -0.162, -0.1001, -0.07, -0.02494025, 0.0181, 0.05, 0.0917]
V14 += [0.1409, 0.2, 0.24886349, 0.3001, 0.3997509]


@pytest.mark.parametrize("noise", [0.0, 1e-15, 1e-13, 1e-12, 1e-11, 1e-10, 1e-8])
@pytest.mark.parametrize("n", [3, 4, 6, 8])
def test_knots_rise_strictly_however_little_is_left(n, noise):
    for seed in range(12):
        rng = np.random.default_rng(seed)
        x = np.array(V14) + rng.uniform(-5e-3, 5e-3, 14)
        c = 1e-7 * (np.abs(x - 0.05) + noise * rng.normal(size=14))
        found = choose_knots(x, c, n)
        assert found.positions.size == n
        assert (np.diff(found.positions) > 0).all()
        # the polyline through the samples next to the corner is as near as the noise
        if n >= 4:
            assert found.residual < 1e-7 * (8 * noise + ROUNDED)


@pytest.mark.slow
@pytest.mark.parametrize("reference", [None, 0.2])
def test_many_samples_are_as_good_as_few(reference):
    """exp(3 x) in um: equal residuals a h^2 / 16 make 16 r links^2 the square of the mean of sqrt(a)."""
    x = np.linspace(0, 1, 20_001)
    c = 1e-6 * (np.exp(3 * x) - np.exp(0.6))
    found = choose_knots(x, c, 40, reference=reference)

    expected = (3e-3 * (np.exp(1.5) - 1) / 1.5) ** 2 / 16 / 39**2
    # the polyline passes the reference exactly, where it would be off by the residual
    room = 0.003 if reference is None else 0.06
    assert found.residual == pytest.approx(expected, rel=room, abs=0.0)
    assert found.residual == pytest.approx(
        deviation(x, c, found.positions, found.values), rel=0, abs=1e-15
    )
    few = choose_knots(x[::25], c[::25], 40, reference=reference)
    # 801 samples are off the curve by a h^2 / 8 = 35 pm
    assert abs(found.residual - few.residual) < 0.07e-9


def test_thousands_of_samples_with_noise_are_searched_to_their_tolerance():
    x = np.linspace(0, 1, 2_001)
    c = 1e-6 * (np.sin(7 * x) + 0.05 * np.random.default_rng(8).normal(size=x.size))

    found = choose_knots(x, c, 6)

    assert found.residual == pytest.approx(
        deviation(x, c, found.positions, found.values), rel=0, abs=1e-15
    )
    # optimal: the greedy tunnel needs more knots for a little less
    assert knots_for_tolerance(x, c, found.residual * (1 - 5e-4)).positions.size > 6
    assert knots_for_tolerance(x, c, found.residual * (1 + 1e-5)).positions.size <= 6


def test_a_thinned_curve_stays_within_its_tolerance():
    from metrosep.compensation.knots import thinned

    rng = np.random.default_rng(3)
    x = np.sort(rng.uniform(0, 1, 3000))
    for c in (np.sin(9 * x), np.cumsum(rng.normal(size=x.size)), np.abs(x - x[777])):
        for tolerance in (1e-12, 1e-3, 0.3, 50.0):
            kept = thinned(x, c, tolerance, float(x[777]))
            assert kept[0] == 0
            assert kept[-1] == x.size - 1
            assert 777 in kept
            assert (np.diff(kept) > 0).all()
            assert np.abs(np.interp(x, x[kept], c[kept]) - c).max() <= tolerance * (1 + 1e-9)
    assert thinned(x, np.abs(x - x[777]), 1e-12, None).tolist() == [0, 777, 2999]


def test_knots_do_not_fall_together_at_the_end():
    """The samples of a V for which the first two knots once were one."""
    x = np.array(
        [
            -0.25887666810584703,
            -0.2452602688796026,
            -0.24494459479016256,
            -0.20192204366113126,
            -0.15111705110041485,
            -0.0977671684735279,
            -0.024940246665278554,
            0.09797608557950044,
            0.30263973763150015,
            0.33979401807969795,
            0.3711308564568811,
            0.39362359610744685,
            0.3950819471391727,
            0.3997509015893778,
        ]
    )
    c = 1e-08 * np.abs(x - 0.05)

    found = choose_knots(x, c, 8)

    assert (np.diff(found.positions) > 1e-3).all()
    assert found.residual < ROUNDED * np.ptp(c)
