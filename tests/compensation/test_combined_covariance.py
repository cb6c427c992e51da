"""Two tables in one are as uncertain as draws of their errors show, which are made with numpy alone.

The machine's error is known; each draw adds an error to it before a table is made with np.interp,
measures again with that table active, makes the second table and looks both up.
"""

from dataclasses import replace

import numpy as np
import pytest
from contracts.estimates import (
    DRAWS,
    LENGTH,
    NM,
    OF_DRAWS,
    X,
    an_estimate,
    known,
    some_covariance,
    waves,
)

from metrosep.compensation import CompensationMap, CompensationTable, combine_tables
from metrosep.separation.covariance import CovarianceModes

OLD = np.linspace(0.0, LENGTH, 31)
NEW = np.linspace(12e-3, 30e-3, 7)
ZERO = 15e-3
LEFT_OUT = 0.6 * NM
"""Stored modes lack 1e-4 of the variance: of a difference of errors of 40 nm sqrt(2e-4) of that."""
NODES = 0.03
"""Share that the straight lines between the 241 nodes of a covariance cost, where waves are long."""


def drawn(basis_of, coefficients, x, seed):
    """Errors at positions, (n, DRAWS), m, of a covariance of coefficients."""
    root = np.linalg.cholesky(
        coefficients + 1e-12 * np.trace(coefficients) * np.eye(len(coefficients))
    )
    return basis_of(x) @ root @ np.random.default_rng(seed).normal(size=(len(root), DRAWS))


def lookup(p, entries, values):
    return np.array([np.interp(p, entries, v) for v in values.T]).T


def spread_of_both(first, second, at):
    """Standard deviation of what both tables add at positions; `first(x)`, `second(x)`: drawn errors."""
    old = -(first(OLD) - first(np.array([ZERO])))
    seen = lookup(NEW, OLD, old) + second(NEW)  # the true error cancels in the spread
    zero = lookup(np.array([ZERO]), OLD, old) + second(np.array([ZERO]))
    new = -(seen - zero)
    return (lookup(at, NEW, new) + lookup(at, OLD, old)).std(axis=1)


def table_of(estimate, positions):
    return CompensationTable.from_error(
        estimate, axis="X", compensates="Z", positions=positions, reference=ZERO
    )


def alike(size):
    """Basis and covariance of an error that is nearly the same at all positions, m."""
    return (
        lambda x: np.column_stack([np.ones(x.size), 0.1 * np.cos(7 * x / LENGTH)])
    ), size**2 * np.eye(2)


def opposite(size):
    """Of one that has the other sign at the other end."""
    return (
        lambda x: np.column_stack([np.tanh((x - 21e-3) / 2e-3), 0.1 * np.cos(7 * x / LENGTH)])
    ), size**2 * np.eye(2)


def many(_):
    return (lambda x: waves(x, n=12)), some_covariance(24)


def estimate_of(kind, size):
    basis, c = kind(size)
    values = basis(X)
    u = np.sqrt(np.einsum("ij,jk,ik->i", values, c, values))
    return an_estimate(u, CovarianceModes.of(X, values, c)), basis, c


@pytest.mark.parametrize("old", [alike, opposite, many])
@pytest.mark.parametrize("new", [alike, opposite, many])
def test_u_of_both_tables_is_that_of_draws(old, new):
    first, basis, c = estimate_of(old, 40 * NM)
    second, basis2, c2 = estimate_of(new, 15 * NM)
    together = combine_tables(table_of(first, OLD), table_of(second, NEW))
    at = together.positions

    def one(x):
        return drawn(basis, c, x, 3)

    def two(x):
        return drawn(basis2, c2, x, 4)

    expected = spread_of_both(one, two, at)
    far = np.abs(at - ZERO) > 1e-6
    np.testing.assert_allclose(
        together.u[far], expected[far], rtol=OF_DRAWS + NODES, atol=LEFT_OUT
    )
    assert (together.u[~far] == 0.0).all()


def test_the_diagonal_would_be_clearly_wrong_beyond_the_new_table():
    """40 nm common to the whole old table are in no difference of it; of opposite sign they double."""
    second, _, _ = estimate_of(many, 0.0)
    new = table_of(second, NEW)
    at_end = 0  # 0 mm, while the new table begins at 12 mm
    for kind, low, high in ((alike, 0.0, 0.3), (opposite, 0.0, 0.3)):
        first, _, _ = estimate_of(kind, 40 * NM)
        own = combine_tables(table_of(first, OLD), new).u[at_end]
        independent = np.hypot(new.u[0], np.hypot(*first.sd([0.0, 12e-3])))
        assert low < own / independent < high
    # and where the sign changes between the end of the new table and the place: twice, not sqrt 2
    first, _, _ = estimate_of(opposite, 40 * NM)
    only_left = table_of(second, np.linspace(12e-3, 15e-3, 4))
    own = combine_tables(table_of(first, OLD), only_left).u[-1]
    independent = np.hypot(only_left.u[-1], np.hypot(*first.sd([LENGTH, 15e-3])))
    assert 1.3 < own / independent < 1.45


def test_between_entries_of_opposite_errors_little_is_left():
    """tanh changes its sign between 20 and 22 mm: at 21 mm the straight line is sure."""
    first, _, _ = estimate_of(many, 0.0)
    second, _, _ = estimate_of(opposite, 40 * NM)
    new = CompensationTable.from_error(
        second, axis="X", compensates="Z", positions=[12e-3, 18e-3, 24e-3, 30e-3], reference=12e-3
    )
    old = CompensationTable.from_error(
        first, axis="X", compensates="Z", positions=[12e-3, 21e-3, 30e-3], reference=12e-3
    )
    together = combine_tables(old, new)

    middle = together.u[together.positions == 21e-3]
    interpolated = np.interp(21e-3, new.positions, new.u)
    # from the zero at -1: the error at 21 mm is 0 - (-1) = 1 of 40 nm; entries say 0.1 and 1.9
    assert middle == pytest.approx(40 * NM, rel=0.1, abs=0.0)
    assert middle <= interpolated * (1.0 + 1e-12)


def test_three_tables_in_a_row_keep_the_covariance():
    estimates = [estimate_of(kind, 20 * NM)[0] for kind in (alike, opposite, many)]
    places = (OLD, np.linspace(6e-3, 36e-3, 11), NEW)
    first, second, third = (table_of(e, p) for e, p in zip(estimates, places, strict=True))
    one = combine_tables(combine_tables(first, second), third)
    p = one.positions
    errors = [
        drawn(
            *kind(20 * NM), np.append(np.unique(np.concatenate([p, NEW, places[1]])), ZERO), seed
        )
        for kind, seed in ((alike, 1), (opposite, 2), (many, 3))
    ]
    x = np.unique(np.concatenate([p, NEW, places[1]]))

    def at(error, where):
        return lookup(where, x, error[:-1]) - error[-1]

    added = -at(errors[0], OLD)
    table = lookup(p, OLD, added)
    for error, own in zip(errors[1:], places[1:], strict=True):
        seen = lookup(own, p, table) - lookup(np.array([ZERO]), p, table) + at(error, own)
        table = table + lookup(p, own, -seen)
    far = np.abs(p - ZERO) > 1e-6
    np.testing.assert_allclose(
        one.u[far], table.std(axis=1)[far], rtol=OF_DRAWS + NODES, atol=LEFT_OUT
    )


def test_the_slope_of_an_axis_along_itself_is_in_the_covariance():
    estimate = known()[0]
    slope = replace(estimate.slope, u=2e-6)
    estimate = replace(estimate, slope=slope)
    options = {"axis": "X", "compensates": "X", "reference": ZERO}
    inner = OLD[1:-1]  # the exact inverse looks a little beside its entries
    old = CompensationTable.from_error(estimate, positions=inner, **options)
    new = CompensationTable.from_error(estimate, positions=NEW, **options)
    u = combine_tables(old, new).u

    end = estimate.u_of_difference(inner[-1:], 30e-3)[0]
    from_end = np.hypot(end, 2e-6 * (inner[-1] - 30e-3))
    assert u[-1] == pytest.approx(np.hypot(new.u[-1], from_end), rel=1e-3, abs=0.0)


def test_tables_of_files_give_the_upper_bound_and_unknown_stays_unknown():
    p, q = np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0])
    old = CompensationTable(p, p * 0.0, None, "X", "Z", 0.0, u=[0.0, 3e-9, 5e-9])
    new = CompensationTable(q, q * 0.0, None, "X", "Z", 0.0, u=[0.0, 6e-9])

    assert combine_tables(old, new).u == pytest.approx([0.0, 6e-9, 10e-9], rel=1e-12, abs=0.0)
    assert combine_tables(replace(old, u=None), new).u is None
    assert combine_tables(old, replace(new, u=None)).u is None


def test_maps_give_the_upper_bound_beyond_the_new_one():
    x = np.array([0.0, 10e-3, 20e-3])
    flat = np.zeros((3, 3))
    old = CompensationMap.from_error(
        lambda a, b: 0 * a * b, x=x, y=x, compensates="Z", u=flat + 3 * NM
    )
    new = CompensationMap.from_error(
        lambda a, b: 0 * a * b, x=x[:2], y=x[:2], compensates="Z", u=flat[:2, :2] + 8 * NM
    )
    u = combine_tables(old, new).u

    np.testing.assert_allclose(u[:2, :2], 8 * NM, rtol=1e-12)
    np.testing.assert_allclose(u[2], 10 * NM, rtol=1e-12)
    np.testing.assert_allclose(u[:, 2], 10 * NM, rtol=1e-12)
    assert combine_tables(replace(old, u=None), new).u is None
