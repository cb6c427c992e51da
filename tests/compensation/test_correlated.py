"""Tables and polynomials of an estimate have the uncertainty that draws from its covariance show.

The draws and the least squares are numpy's own; the estimate is built by hand from a covariance
that is known.
"""

import numpy as np
import pytest

from metrosep import Run, RunSet
from metrosep.compensation import CompensationTable, fit_polynomial
from metrosep.core.quantity import Quantity
from metrosep.separation import DirectionEstimate, ErrorEstimate
from metrosep.separation.covariance import CovarianceModes
from metrosep.separation.runs.base import SampledCurve

NM = 1e-9
GRID = np.linspace(-20e-3, 30e-3, 501)
DRAWS = 20_000
CHANCE = 4.0 / np.sqrt(2.0 * DRAWS)
"""Four standard deviations of a standard deviation over the draws."""

CUT = 2e-3
"""What cutting the modes at 1e-4 of the trace and straight lines between positions move."""

N = 9
_K = np.arange(N)
BASIS = np.cos(2 * np.pi * _K * (GRID[:, None] + 20e-3) / 65e-3 + 0.7 * _K)
"""The first column is constant: an offset-like mode."""

HALF = np.random.default_rng(1).standard_normal((N, N)) * 3 * NM / (1.0 + _K)
ERRORS = np.random.default_rng(2).standard_normal((DRAWS, N)) @ HALF.T @ BASIS.T


def direction(modes=True, scale=1.0, basis=BASIS, half=HALF):
    z = 200 * NM * np.sin(2 * np.pi * GRID / 30e-3)
    sd = scale * np.sqrt(np.sum((basis @ half) ** 2, axis=1))
    made = CovarianceModes.of(GRID, basis, scale**2 * half @ half.T) if modes else None
    return DirectionEstimate(SampledCurve(GRID, z), SampledCurve(GRID, sd), modes=made)


def estimate(parts, slope_u=0.0):
    empty = {}
    return ErrorEstimate(
        "joint", GRID[0], GRID[-1], (GRID[0], GRID[-1]), parts,
        Quantity(0.0, "rad", "slope", u=slope_u), empty, empty, empty, NM,
    )  # fmt: skip


@pytest.mark.parametrize("degree", [0, 2, 5])
def test_polynomial_of_an_estimate(degree):
    found = estimate({0: direction()})
    fit = fit_polynomial(found, degree=degree)
    x = np.linspace(GRID[0], GRID[-1], 401)
    scaled = (2 * x - GRID[0] - GRID[-1]) / (GRID[-1] - GRID[0])
    columns = np.polynomial.legendre.legvander(scaled, degree)
    drawn = np.array([np.interp(x, GRID, e) for e in ERRORS[:4000]])
    coefficients = np.linalg.lstsq(columns, drawn.T, rcond=None)[0]
    chance = 4.0 / np.sqrt(2.0 * 4000)

    np.testing.assert_allclose(
        np.sqrt(np.diag(fit.cov)), coefficients.std(axis=1), rtol=chance + CUT, atol=0
    )
    np.testing.assert_allclose(
        fit.sd(x[::40]), (columns @ coefficients).std(axis=1)[::40], rtol=chance + CUT, atol=0
    )
    assert fit.cov_source == "covariance of the estimate"
    assert fit.to_dict()["u_greatest_m"] == pytest.approx(fit.sd(x).max(), rel=1e-9, abs=0)


def test_polynomial_of_an_estimate_without_covariance_says_what_it_takes():
    fit = fit_polynomial(estimate({0: direction(modes=False)}), degree=2)

    assert "stored without its covariance" in fit.cov_source


@pytest.mark.parametrize("reference", [None, -20e-3, 12.3e-3])
def test_table_is_as_certain_as_the_difference_to_its_zero(reference):
    table = CompensationTable.from_error(
        estimate({0: direction()}),
        positions="5 mm", axis="X", compensates="Z", reference=reference,
    )  # fmt: skip
    zero = 0.0 if reference is None else reference
    at = np.array([np.interp(np.append(table.positions, zero), GRID, e) for e in ERRORS])
    drawn = (at[:, :-1] - at[:, -1:]).std(axis=0)

    # 0.005 nm: near the zero, where the modes are straight lines between positions
    np.testing.assert_allclose(table.u, drawn, rtol=CHANCE + CUT, atol=5e-3 * NM)
    if reference != 12.3e-3:
        assert table.u[table.positions == zero].tolist() == [0.0]


def test_an_offset_of_the_whole_curve_is_not_in_a_table():
    half = np.zeros((N, N))
    half[0, 0] = 50 * NM
    found = estimate({0: direction(half=half)})

    table = CompensationTable.from_error(found, positions="5 mm", axis="X", compensates="Z")

    assert found.sd([0.0])[0] == pytest.approx(50 * NM, rel=1e-9, abs=0)
    # square root of the rounding of the stored modes
    assert table.u.max() < 50 * NM * 1e-3


def test_the_reverse_column_has_the_zero_of_the_forward_runs():
    # Reverse runs are 3 times as uncertain, and independent of the forward runs.
    found = estimate({1: direction(), -1: direction(scale=3.0)})
    table = CompensationTable.from_error(found, positions="5 mm", axis="X", compensates="Z")
    forward = np.array([np.interp(0.0, GRID, e) for e in ERRORS])
    other = 3.0 * np.random.default_rng(3).permutation(ERRORS)
    reverse = np.array([np.interp(table.positions, GRID, e) for e in other])

    drawn = (reverse - forward[:, None]).std(axis=0)

    np.testing.assert_allclose(table.u, drawn, rtol=CHANCE + CUT + 0.01, atol=0)


def test_the_slope_of_an_axis_along_itself_adds_from_the_zero_on():
    half = np.zeros((N, N))
    half[0, 0] = 50 * NM
    found = estimate({0: direction(half=half)}, slope_u=2e-6)

    table = CompensationTable.from_error(found, positions="10 mm", axis="X")

    np.testing.assert_allclose(table.u, 2e-6 * np.abs(table.positions), rtol=1e-3, atol=0.05 * NM)


def test_a_table_of_an_older_estimate_keeps_the_band():
    found = estimate({0: direction(modes=False)})

    table = CompensationTable.from_error(found, positions="5 mm", axis="X", compensates="Z")

    np.testing.assert_allclose(table.u, found.sd(table.positions), rtol=1e-12, atol=0)


def test_offsets_of_runs_are_not_in_the_greatest_u():
    # Each run starts anew: 1 um of offset, and a slope that scatters by a known amount.
    x = np.linspace(0.0, 50e-3, 501)
    offsets = 1e-6 * np.array([3.0, -2.0, 7.0, 0.0])
    slopes = 1e-6 * np.array([1.0, 2.0, 4.0, -3.0])
    runs = RunSet(
        [Run(x, o + s * (x - 25e-3), feed=0.01) for o, s in zip(offsets, slopes, strict=True)]
    )

    fit = fit_polynomial(runs, degree=1)

    # at both ends, half the travel from the mean
    expected = slopes.std(ddof=1) / np.sqrt(4) * 25e-3
    assert fit.to_dict()["u_greatest_m"] == pytest.approx(expected, rel=1e-9, abs=0)
    assert fit.sd([25e-3])[0] == pytest.approx(offsets.std(ddof=1) / np.sqrt(4), rel=1e-9, abs=0)
