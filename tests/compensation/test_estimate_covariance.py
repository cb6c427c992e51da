"""Tables and polynomials of an estimate state the u that draws from its covariance show."""

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

from metrosep.compensation import CompensationTable, fit_polynomial
from metrosep.separation.covariance import CovarianceModes

P = np.linspace(0.0, LENGTH, 46)


def drawn_at(x, seed=3):
    """Errors of the estimate `known()` at positions, (n, DRAWS), m."""
    root = waves(x) @ np.linalg.cholesky(some_covariance(24))
    return root @ np.random.default_rng(seed).normal(size=(24, DRAWS))


def table_of(estimate, **more):
    return CompensationTable.from_error(estimate, axis="X", compensates="Z", positions=P, **more)


@pytest.mark.parametrize("zero", [0.0, 17e-3, 30e-3])
def test_entries_of_a_table_are_as_uncertain_as_their_difference_from_the_zero(zero):
    estimate, _ = known()
    table = table_of(estimate, reference=zero)

    error = drawn_at(np.append(P, zero))
    expected = (error[:-1] - error[-1]).std(axis=1)

    at = zero == P
    np.testing.assert_allclose(table.u[~at], expected[~at], rtol=OF_DRAWS + 0.03)
    assert (table.u[at] == 0.0).all()


def test_an_error_common_to_all_positions_is_in_no_entry():
    u = np.full(X.size, 50 * NM)
    table = table_of(an_estimate(u, CovarianceModes.of(X, u[:, None])))

    assert table.u.max() < 1e-6 * 50 * NM


def test_a_table_of_an_old_result_keeps_the_band_of_the_positions():
    estimate, _ = known()
    part = replace(estimate.directions_data[1], modes=None)
    old = replace(estimate, directions_data={1: part})

    np.testing.assert_array_equal(table_of(old).u, estimate.sd(P))


def test_many_entries_need_no_square_of_them():
    """30 000 entries: a matrix of all would take 7 GB."""
    estimate, _ = known()
    table = CompensationTable.from_error(
        estimate, axis="X", compensates="Z", positions=np.linspace(0.0, LENGTH, 30_000)
    )

    assert np.interp(P[1:], table.positions, table.u) == pytest.approx(
        table_of(estimate).u[1:], rel=1e-3, abs=0.0
    )


@pytest.mark.parametrize("degree", [1, 3, 6])
def test_polynomial_coefficients_scatter_as_stated(degree):
    estimate, _ = known()
    fit = fit_polynomial(estimate, degree=degree)
    x = np.linspace(0.0, LENGTH, 401)
    mm = x / 1e-3

    # Not by Legendre, and in mm: plain powers of x / 45 mm fitted to every draw.
    scaled = mm / 45.0
    powers = np.vander(scaled, degree + 1, increasing=True)
    drawn = np.linalg.lstsq(powers, drawn_at(x), rcond=None)[0]

    in_si = drawn.std(axis=1) / LENGTH ** np.arange(degree + 1)
    np.testing.assert_allclose(fit.u_coefficients, in_si, rtol=OF_DRAWS + 0.03)
    expected = (powers @ drawn).std(axis=1)
    np.testing.assert_allclose(fit.sd(x), expected, rtol=OF_DRAWS + 0.03)
    assert fit.cov_source == "covariance of the estimate"
    assert fit.to_dict()["u_coefficients_si"] == fit.u_coefficients.tolist()


def test_an_offset_of_all_positions_is_in_the_constant_alone():
    u = np.full(X.size, 50 * NM)
    fit = fit_polynomial(an_estimate(u, CovarianceModes.of(X, u[:, None])), degree=3)

    assert fit.u_coefficients[0] == pytest.approx(50 * NM, rel=1e-3, abs=0.0)
    curved = fit.u_coefficients[1:] * LENGTH ** np.arange(1, 4)
    assert curved.max() < 1e-4 * 50 * NM


def test_without_a_covariance_a_polynomial_has_no_u_of_coefficients():
    fit = replace(fit_polynomial(known()[0], degree=2), cov=None)

    assert fit.u_coefficients is None
    assert fit.to_dict()["u_coefficients_si"] is None
