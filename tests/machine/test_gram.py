"""Gram matrix: closed forms, expectation against drawn maps, groups, bad input."""

import numpy as np
import pytest

from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.machine.alignment import alignment_space
from metrosep.machine.gram import (
    aligned_gram,
    correlations,
    expected_mean_square,
    groups_alike,
    shares,
)

ROUNDING = 1e-12
"""Sums of products in float64, relative to their size."""


def line(n=1001):
    """Points of -1..1 with equal weights, and the space of a line removed."""
    x = np.linspace(-1.0, 1.0, n)
    return x, alignment_space(["piston", "tilt_x"], np.column_stack([np.ones(n), x]), np.ones(n))


def test_matrix_equals_products_of_maps_made_by_hand():
    x, space = line(3001)
    rng = np.random.default_rng(1)
    maps = rng.standard_normal((x.size, 5)) + x[:, None]
    left = maps - np.column_stack([np.polyval(np.polyfit(x, m, 1), x) for m in maps.T])

    g = aligned_gram(maps, space)

    assert np.abs(g.raw - maps.T @ maps / x.size).max() < ROUNDING
    assert np.abs(g.matrix - left.T @ left / x.size).max() < ROUNDING
    assert np.abs(g.highest - left.max(axis=0)).max() < ROUNDING
    assert np.abs(g.lowest - left.min(axis=0)).max() < ROUNDING
    assert np.abs(g.highest_raw - maps.max(axis=0)).max() == 0.0
    assert g.amounts[1] == pytest.approx([np.polyfit(x, m, 1)[0] for m in maps.T], abs=1e-10)


def test_what_alignment_takes_whole_is_exactly_zero_even_beside_large_maps():
    x, space = line()

    g = aligned_gram(np.column_stack([np.full(x.size, 1e6), 5.0 - 3.0 * x, x**2]), space)

    assert g.is_removed.tolist() == [True, True, False]
    assert (g.matrix[:2] == 0.0).all()
    assert (g.highest[:2] == 0.0).all()
    assert g.raw[0, 0] == pytest.approx(1e12, abs=1.0)


def test_a_small_rest_beside_a_large_line_is_kept():
    """1e-6 of a parabola on a line: projecting maps keeps it to 1e-9, subtracting matrices not."""
    x, space = line()
    pure = aligned_gram(1e-6 * x[:, None] ** 2, space)
    g = aligned_gram((x + 1e-6 * x**2)[:, None], space)
    assert g.matrix[0, 0] / pure.matrix[0, 0] == pytest.approx(1.0, abs=1e-8)


def test_expectation_and_shares_equal_those_of_drawn_maps():
    x, space = line(201)
    maps = np.column_stack([x**2, x**3, np.cos(5 * x)])
    g = aligned_gram(maps, space)
    mean, root = np.array([0.5, -1.0, 0.2]), np.array([[1.0, 0, 0], [0.8, 0.6, 0], [0, 0.3, 0.2]])
    rng = np.random.default_rng(3)
    q = mean + rng.standard_normal((200_000, 3)) @ root.T

    drawn = np.mean(np.sum((q @ space.remove(maps).T) ** 2, axis=1) / x.size)

    expected = expected_mean_square(g.matrix, root @ root.T, mean)
    assert drawn / expected == pytest.approx(1.0, abs=0.01)  # 200 000 draws: 0.3 % standard error
    parts = shares(g.matrix, root @ root.T)
    assert parts.sum() == pytest.approx(1.0, abs=ROUNDING)


def test_shares_of_independent_terms_are_their_own_squares():
    G = np.array([[4.0, 1.9, 0.0], [1.9, 1.0, 0.0], [0.0, 0.0, 9.0]])
    assert shares(G, [1.0, 4.0, 0.0]).tolist() == [0.5, 0.5, 0.0]
    assert np.isnan(shares(G, [0.0, 0.0, 0.0])).all()


def test_correlated_errors_that_cancel_have_no_expectation():
    G = np.ones((2, 2))  # two terms with one map
    assert expected_mean_square(G, [[1.0, -1.0], [-1.0, 1.0]]) == 0.0
    assert expected_mean_square(G, [[1.0, 1.0], [1.0, 1.0]]) == 4.0


def test_groups_are_alike_in_either_sign_and_chains_join():
    r = np.eye(5)
    r[0, 2] = r[2, 0] = -0.95
    r[2, 3] = r[3, 2] = 0.93
    scale = np.array([1e-9, 1.0, 1e3, 2.0, 0.0])
    G = r * np.outer(scale, scale)

    assert groups_alike(G, list("abcde")) == (("a", "c", "d"),)
    assert groups_alike(G, list("abcde"), threshold=0.96) == ()
    assert np.isnan(correlations(G)[4]).all()
    assert correlations(G)[0, 2] == pytest.approx(-0.95, abs=ROUNDING)


def test_bad_input_is_refused():
    _, space = line(11)
    with pytest.raises(InvalidSamplesError, match="11 points"):
        aligned_gram(np.ones((10, 2)), space)
    for bad in (np.nan, np.inf, -np.inf):
        maps = np.ones((11, 2))
        maps[3, 1] = bad
        with pytest.raises(InvalidSamplesError, match="rows 0 to 10"):
            aligned_gram(maps, space)
    with pytest.raises(InvalidSamplesError, match="square"):
        shares(np.ones((2, 3)), [1, 1])
    with pytest.raises(InvalidSamplesError, match="symmetric"):
        shares([[1.0, 0.5], [0.0, 1.0]], [1, 1])
    with pytest.raises(InvalidSamplesError, match="2 finite variances"):
        shares(np.eye(2), [1.0, np.nan])
    with pytest.raises(InvalidSamplesError, match="below zero"):
        shares(np.eye(2), [1.0, -1.0])
    with pytest.raises(InvalidSamplesError, match="negative eigenvalue"):
        expected_mean_square(np.eye(2), [[1.0, 2.0], [2.0, 1.0]])
    with pytest.raises(InvalidSamplesError, match="finite amounts"):
        expected_mean_square(np.eye(2), [1.0, 1.0], [1.0])
    with pytest.raises(DataError, match="threshold"):
        groups_alike(np.eye(2), ["a", "b"], threshold=1.0)
    with pytest.raises(DataError, match="3 names"):
        groups_alike(np.eye(2), ["a", "b", "c"])
