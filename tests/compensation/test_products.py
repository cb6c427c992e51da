"""Maps as two tables: exact where they are, closed forms of what stays, gauges, what is refused."""

import json

import numpy as np
import pytest

from metrosep.compensation.maps import CompensationMap
from metrosep.compensation.products import rank_one
from metrosep.errors import DataError, TableError

ROUND = 1e-19
"""Singular values of 1 um to double precision, with a margin of a thousand."""
X = np.linspace(-20e-3, 60e-3, 9)
Y = np.array([-30e-3, -10e-3, 0.0, 5e-3, 40e-3])


def f_of(x):
    return 1e-6 * np.sin(x / 15e-3) + 2e-5 * x


def g_of(y):
    return 1.0 - 40.0 * y


def made(error, **options):
    return CompensationMap.from_error(error, **{"x": X, "y": Y} | options)


def test_a_product_is_found_exactly_with_its_sign_and_gauge():
    """e = f g: the factor is 1 - 40 y over its largest, 2.2 at y = -30 mm."""
    tables = rank_one(made(lambda x, y: f_of(x) * g_of(y)))

    assert tables.second.forward == pytest.approx(g_of(Y) / 2.2, abs=1e-12)
    assert tables.first.forward == pytest.approx(-2.2 * f_of(X), abs=ROUND)
    assert tables.residual_pv < ROUND
    assert tables.share < 1e-12
    assert tables.first.axis == "X"
    assert tables.second.axis == "Y"
    assert tables.first.compensates == tables.second.compensates == "Z"
    assert tables.at_reference == pytest.approx(0.0, abs=ROUND)


def test_the_tables_are_the_map_between_the_nodes_too():
    table = made(lambda x, y: f_of(x) * g_of(y))
    tables = rank_one(table)
    rng = np.random.default_rng(2)
    x, y = rng.uniform(-30e-3, 70e-3, 300), rng.uniform(-40e-3, 50e-3, 300)
    assert tables.correction(x, y) == pytest.approx(table.correction(x, y), abs=ROUND)
    assert tables.correction(X, Y[:, None]) == pytest.approx(table.values, abs=ROUND)


def test_gauge_takes_the_largest_entry_positive():
    """The same map with the signs of both parts turned round gives the same tables."""
    one = rank_one(made(lambda x, y: f_of(x) * -g_of(y)))
    two = rank_one(made(lambda x, y: -f_of(x) * g_of(y)))
    assert one.second.forward.max() == 1.0
    assert np.abs(one.second.forward).max() == 1.0
    assert one.first.forward == pytest.approx(two.first.forward, abs=ROUND)


def test_what_stays_is_that_of_the_other_singular_values():
    """Two orthogonal parts of 3 and 1: 1 / sqrt(10) of the RMS stay."""
    a, b = (
        np.array([1.0, 1.0, 0.0, 0.0]) / np.sqrt(2),
        np.array([1.0, -1.0, 0.0, 0.0]) / np.sqrt(2),
    )
    c, d = np.array([0.0, 0.6, 0.8]), np.array([1.0, 0.0, 0.0])
    values = 3e-6 * np.outer(c, a) + 1e-6 * np.outer(d, b)
    tables = rank_one(CompensationMap(np.arange(4.0), np.arange(3.0), values))
    assert tables.share == pytest.approx(1 / np.sqrt(10), abs=1e-12)
    assert tables.residual_rms == pytest.approx(1e-6 / np.sqrt(12), abs=ROUND)
    assert tables.residual_pv == pytest.approx(2e-6 / np.sqrt(2), abs=ROUND)
    assert tables.singular_values == pytest.approx([3e-6, 1e-6, 0.0], abs=ROUND)
    assert tables.residual == pytest.approx(1e-6 * np.outer(d, b), abs=ROUND)
    assert "31.6 %" in tables.messages[0]


def test_no_product_at_all():
    """The unit matrix of order n: all singular values are 1, sqrt(1 - 1/n) of the RMS stay."""
    tables = rank_one(
        CompensationMap(np.arange(9.0), np.arange(9.0), 1e-6 * np.eye(9)), keep_zero=True
    )
    assert tables.share == pytest.approx(np.sqrt(8 / 9), abs=1e-12)


def test_a_sum_is_found_exactly_and_zero_at_the_reference():
    error = lambda x, y: f_of(x) + 3e-5 * y + 1e-3 * y * y + 7e-6  # noqa: E731
    tables = rank_one(made(error), form="sum")
    assert tables.first.forward == pytest.approx(-f_of(X), abs=ROUND)
    assert tables.second.forward == pytest.approx(-3e-5 * Y - 1e-3 * Y * Y, abs=ROUND)
    assert tables.first.forward[X == 0.0] == 0.0
    assert tables.second.forward[Y == 0.0] == 0.0
    assert tables.at_reference == 0.0
    assert tables.residual_pv < 10 * ROUND


def test_null_space_of_the_sum_is_the_twist():
    """x y with both grids centred has no sum part, and no row or column mean: all of it stays."""
    grid = np.linspace(-1.0, 1.0, 5)
    tables = rank_one(made(lambda x, y: 1e-6 * x * y, x=grid, y=grid), form="sum")
    assert tables.share == pytest.approx(1.0, abs=1e-12)
    assert np.abs(tables.first.forward).max() < ROUND
    assert rank_one(tables.map).share < 1e-12


def test_null_space_of_the_product_is_the_sum():
    """sin in x plus cos in y, orthogonal and of equal size: half of the power stays.

    With a constant k it falls forever, (k + f)(1 + g/k) = k + f + g + f g / k: at 20 times the largest
    correction f g / k stays, whose RMS is half of the product of the amplitudes.
    """
    t = np.arange(8) * np.pi / 4
    values = 1e-6 * (np.sin(t) + np.cos(t)[:, None])
    map_ = CompensationMap(t, t, values, axes=("A", "C"))
    tables = rank_one(map_, keep_zero=True)
    assert tables.share == pytest.approx(np.sqrt(0.5), abs=1e-12)
    free = rank_one(map_)
    largest = np.abs(values).max()
    assert abs(free.constant) == pytest.approx(20 * largest, abs=1e-9 * largest)
    rest = 1e-12 / abs(free.constant) / 2
    assert free.residual_rms == pytest.approx(rest, abs=0.01 * rest)
    assert rank_one(tables.map, form="sum").share == pytest.approx(
        _constrained_share(values), abs=1e-12
    )


def _constrained_share(values):
    """Least squares of f + g with f[0] = g[0] = 0 by a design matrix, without library code."""
    m, n = values.shape
    design = np.zeros((m * n, m + n - 2))
    for j in range(m):
        for i in range(n):
            if i:
                design[j * n + i, i - 1] = 1.0
            if j:
                design[j * n + i, n - 2 + j] = 1.0
    fit = design @ np.linalg.lstsq(design, values.ravel(), rcond=None)[0]
    return np.linalg.norm(values.ravel() - fit) / np.linalg.norm(values)


def test_reference_between_the_nodes_of_a_sum():
    error = lambda x, y: 1e-5 * x - 2e-5 * y  # noqa: E731
    tables = rank_one(made(error, reference=(3e-3, 17e-3)), form="sum")
    assert tables.first.correction(3e-3)[0] == pytest.approx(0.0, abs=ROUND)
    assert tables.second.correction(17e-3)[0] == pytest.approx(0.0, abs=ROUND)
    assert tables.residual_pv < 10 * ROUND


def test_what_the_product_adds_at_the_reference_is_said():
    """(f + k) (g + l) - k l at f = g = 0: the product part is not zero there."""
    tables = rank_one(made(lambda x, y: (1e-3 + x) * (1e-3 + y) * 1e-3))
    assert tables.at_reference != 0.0
    assert tables.at_reference == pytest.approx(float(tables.correction(0.0, 0.0)[0]), abs=ROUND)
    assert "zero of the machine" in tables.messages[1]


def test_the_dry_run_judges_what_is_loaded():
    tables = rank_one(made(lambda x, y: f_of(x) * g_of(y)))
    assert tables.verify().after_pv < tables.verify().before_pv / 5
    assert tables.as_map().values == pytest.approx(tables.map.values, abs=ROUND)
    assert tables.as_map().history[-1].name == "rank_one"
    grid = np.linspace(-1.0, 1.0, 5)
    twist = made(lambda x, y: 1e-6 * x * y, x=grid, y=grid)
    assert rank_one(twist, form="sum").verify().grade == "pointless"


def test_dict_says_which_one_carries_the_sign():
    tables = rank_one(made(lambda x, y: f_of(x) * g_of(y)))
    plain = json.loads(json.dumps(tables.to_dict(), allow_nan=False))
    assert "negates first only" in plain["convention"]
    assert plain["second"]["factor"] == tables.second.forward.tolist()
    assert "forward_m" not in plain["second"]
    assert "negates both" in rank_one(tables.map, form="sum").to_dict()["convention"]


def test_bad_input_is_refused():
    with pytest.raises(TableError, match="zero everywhere"):
        rank_one(CompensationMap([0, 1], [0, 1], np.zeros((2, 2))))
    with pytest.raises(DataError, match="form="):
        rank_one(made(lambda x, y: x * y), form="quotient")
    with pytest.raises(DataError, match="ndarray"):
        rank_one(np.eye(3))
    with pytest.raises(DataError, match="broadcast"):
        rank_one(made(lambda x, y: x * y)).correction([0.0, 1.0], [0.0, 1.0, 2.0])
    with pytest.raises(ValueError, match="read-only"):
        rank_one(made(lambda x, y: x * y)).residual[0, 0] = 1.0


def test_a_constant_is_free_and_reported():
    """f g is not zero where the map is: values of an independent check of the specification."""
    x, y = np.linspace(-30e-3, 50e-3, 41), np.linspace(-20e-3, 40e-3, 31)
    f = lambda x: 2e-6 * np.cos(2 * np.pi * (x - 0.007) / 0.11)  # noqa: E731
    g = lambda y: 0.6 + y / 0.05 + (y / 0.06) ** 2  # noqa: E731
    error = CompensationMap.from_error(
        lambda x, y: f(x) * g(y) - f(0.0) * g(0.0), x=x, y=y, reference=(0.0, 0.0)
    )
    kept = rank_one(error, keep_zero=True)
    assert np.ptp(error.values) == pytest.approx(6.538595e-6, abs=1e-12)
    assert kept.residual_pv == pytest.approx(2.046478e-6, abs=1e-12)
    assert kept.share == pytest.approx(0.362825, abs=1e-6)
    assert kept.constant == 0.0

    tables = rank_one(error)

    assert tables.constant == pytest.approx(-1.105348384e-6, abs=1e-9 * 6.5e-6)
    assert np.abs(tables.residual).max() < 2e-15
    assert tables.at_reference == pytest.approx(tables.constant, abs=1e-14)
    assert "the zero of the machine moves by -1.11 um" in " ".join(tables.messages)
    added = tables.second.forward[:, None] * tables.first.forward
    assert np.abs(added - error.values - tables.constant).max() < 2e-15
    assert np.abs(tables.as_map().values - added).max() < 2e-15


@pytest.mark.parametrize(("turned", "k"), [(False, 1.0), (True, -1.0)])
def test_the_constant_turns_over_with_the_map(turned, k):
    error = lambda x, y: k * (f_of(x) * g_of(y) - f_of(0.0) * g_of(0.0))  # noqa: E731
    one, two = rank_one(made(error)), rank_one(made(lambda x, y: -error(x, y)))
    assert one.constant == pytest.approx(-two.constant, abs=1e-14)
    assert one.residual_rms == pytest.approx(two.residual_rms, abs=1e-14)


def left_by_two_tables(m, k):
    """RMS of all but the first singular pair of the map plus a constant."""
    return np.sqrt((np.linalg.svd(m + k, compute_uv=False)[1:] ** 2).sum() / m.size)


def test_constant_of_a_noisy_product_leaves_the_noise():
    """Section 5 of the specification of tables: with 5 nm of noise 4.8 nm stay."""
    x, y = np.meshgrid(np.linspace(-30e-3, 50e-3, 41), np.linspace(-20e-3, 40e-3, 31))
    f = 2e-6 * np.cos(2 * np.pi * (x - 0.007) / 0.11)
    g = 0.6 + y / 0.05 + (y / 0.06) ** 2
    noise = np.random.default_rng(12).normal(0.0, 5e-9, x.shape)
    tables = rank_one(CompensationMap(x[0], y[:, 0], noise - f * g))

    # (m - 1)(n - 1) - 1 of the m n values are left
    assert tables.residual_rms == pytest.approx(4.8e-9, abs=0.15e-9)


def test_additive_map_runs_to_the_limit_of_the_constant():
    """phi falls for ever there: 45.1, 19.5 and 5.05 nm stay within 2, 5 and 20 A; a sum is exact."""
    x, y = np.meshgrid(np.linspace(-30e-3, 50e-3, 41), np.linspace(-20e-3, 40e-3, 31))
    m = 1e-6 * (np.sin(x / 0.02) + (y / 0.04) ** 2)
    a = np.abs(m).max()
    for most, stays in ((2, 45.1e-9), (5, 19.5e-9), (20, 5.05e-9)):
        rest = min(left_by_two_tables(m, k) for k in most * a * np.array([-1.0, 1.0]))
        assert rest == pytest.approx(stays, rel=2e-3, abs=0.0)
    corrections = CompensationMap(x[0], y[:, 0], m)

    tables = rank_one(corrections)

    assert abs(tables.constant) == pytest.approx(20 * a, rel=1e-9, abs=0.0)
    assert tables.residual_rms == pytest.approx(5.05e-9, abs=0.01e-9)
    assert rank_one(corrections, form="sum").residual_rms < ROUND
