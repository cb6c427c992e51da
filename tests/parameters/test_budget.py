"""Budgets against the worked examples of JCGM 100:2008, annex H, and its tables."""

from __future__ import annotations

import math

import numpy as np
import pytest

from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.parameters.budget import Budget, Contribution, coverage_factor, report_value
from metrosep.parameters.budget_lines import (
    alternatives_line,
    certificate_line,
    drift_line,
    lateral_scale_line,
    nonlinearity_line,
    repeatability_line,
    scale_line,
)
from metrosep.parameters.repeats import type_a

ROUNDING = 1e-12


@pytest.mark.parametrize(
    ("dof", "coverage", "printed"),
    [
        (1, 0.95, 12.71),
        (2, 0.95, 4.30),
        (10, 0.95, 2.23),
        (16, 0.99, 2.92),
        (50, 0.95, 2.01),
        (math.inf, 0.95, 1.960),
        (math.inf, 0.99, 2.576),
        (math.inf, 0.9545, 2.000),
    ],
)
def test_coverage_factors_are_those_of_table_g2(dof, coverage, printed):
    """JCGM 100, table G.2, t_p(nu)."""
    assert coverage_factor(coverage, dof) == pytest.approx(printed, abs=0.005)


def test_broken_freedom_lies_between_its_neighbours():
    """JCGM 100, G.4.1 note: interpolate or cut; one rule for every U, t((1 + p)/2; nu) as it is."""
    assert coverage_factor(0.95, 17) < coverage_factor(0.95, 16.7) < coverage_factor(0.95, 16)
    assert coverage_factor(dof=8) == pytest.approx(2.366, abs=5e-4)
    assert coverage_factor() == pytest.approx(2.0, abs=1e-8)


def end_gauge() -> Budget:
    """Lines of JCGM 100, H.1, table H.1, nm."""
    return Budget(
        [
            Contribution("standard", 25e-9, dof=18),
            Contribution("comparison", 9.7e-9, dof=25.6),
            Contribution("expansion difference", 0.58e-6, sensitivity=5e-3, dof=50),
            Contribution("temperature difference", 0.029, sensitivity=0.575e-6, dof=2),
        ]
    )


def test_the_end_gauge_of_annex_h1():
    """H.1.4 to H.1.6: u_c = 32 nm, 16 degrees of freedom, U99 = 93 nm (2.92 * 32 nm).

    The Guide cuts 16.7 to 16 there; with 16.7 itself k is 2.90 and U99 is 92 nm.
    """
    budget = end_gauge()

    assert budget.combined == pytest.approx(31.7e-9, abs=0.05e-9)
    assert math.floor(budget.dof) == 16
    assert coverage_factor(0.99, 16) == pytest.approx(2.92, abs=0.005)
    assert coverage_factor(0.99, 16) * budget.combined == pytest.approx(93e-9, abs=0.7e-9)
    assert budget.coverage_factor(0.99) == pytest.approx(2.905, abs=0.005)
    assert "16.7 degrees of freedom" in budget.report(50.000838e-3, "m", coverage=0.99)


def test_the_impedance_of_annex_h2_with_its_correlations():
    """H.2, table H.4: u(R) 0.071, u(X) 0.295, u(Z) 0.236 ohm."""
    volt, ampere, phi = 4.9990, 19.6610e-3, 1.04446
    inputs = [("V", 0.0032), ("I", 0.0095e-3), ("phi", 0.00075)]
    r = [[1, -0.36, 0.86], [-0.36, 1, -0.65], [0.86, -0.65, 1]]
    Z = volt / ampere
    R, X = Z * math.cos(phi), Z * math.sin(phi)
    sensitivities = {
        "R": ([R / volt, -R / ampere, -X], 0.071),
        "X": ([X / volt, -X / ampere, R], 0.295),
        "Z": ([Z / volt, -Z / ampere, 0.0], 0.236),
    }

    for c, printed in sensitivities.values():
        lines = [Contribution(n, u, sensitivity=s) for (n, u), s in zip(inputs, c, strict=True)]
        budget = Budget(lines, correlations=r)
        # A correlation printed as 0.86 may be 0.865: that alone moves u(R) by 1.4 %.
        assert budget.combined == pytest.approx(printed, rel=0.02, abs=0.0)
        assert budget.shares.sum() == pytest.approx(1.0, rel=ROUNDING, abs=0.0)


@pytest.mark.parametrize(
    ("distribution", "divisor"),
    [("normal", 1), ("rectangular", 3**0.5), ("triangular", 6**0.5), ("arcsine", 2**0.5)],
)
def test_divisors_turn_half_widths_into_standard_uncertainties(distribution, divisor):
    assert Contribution("a", 2.0, distribution).u == pytest.approx(
        2.0 / divisor, rel=ROUNDING, abs=0.0
    )


def test_an_expanded_uncertainty_of_a_certificate_is_divided_by_its_k():
    assert Contribution("certificate", 10e-9, divisor=2.0).u == pytest.approx(
        5e-9, rel=ROUNDING, abs=0.0
    )


def test_independent_lines_add_in_squares_with_their_shares():
    budget = Budget([Contribution("a", 3.0), Contribution("b", 2.0, sensitivity=-2.0)])

    assert budget.combined == pytest.approx(5.0, rel=ROUNDING, abs=0.0)
    assert budget.shares.tolist() == pytest.approx([0.36, 0.64], rel=1e-9, abs=0.0)
    assert math.isinf(budget.dof)
    assert budget.expanded(k=2.0) == pytest.approx(10.0, rel=ROUNDING, abs=0.0)


@pytest.mark.parametrize(("r", "expected"), [(1.0, 7.0), (0.0, 5.0), (-1.0, 1.0)])
def test_correlation_adds_or_cancels(r, expected):
    lines = [Contribution("a", 3.0), Contribution("b", 4.0)]

    assert Budget(lines, correlations=[[1, r], [r, 1]]).combined == pytest.approx(
        expected, rel=1e-9, abs=0.0
    )


def test_the_sign_of_a_sensitivity_counts_only_with_correlation():
    lines = [Contribution("a", 3.0), Contribution("b", 4.0, sensitivity=-1.0)]

    assert Budget(lines).combined == pytest.approx(5.0, rel=1e-9, abs=0.0)
    assert Budget(lines, correlations=[[1, 1], [1, 1]]).combined == pytest.approx(
        1.0, rel=1e-9, abs=0.0
    )


def test_freedom_of_correlated_lines_is_the_smallest_and_of_equal_lines_their_sum():
    lines = [Contribution("a", 1.0, dof=4), Contribution("b", 1.0, dof=9)]
    same = [Contribution("a", 1.0, dof=4), Contribution("b", 1.0, dof=4)]

    assert Budget(lines, correlations=[[1, 0.5], [0.5, 1]]).dof == 4
    assert Budget(lines, correlations=np.eye(2)).dof == pytest.approx(
        Budget(lines).dof, rel=1e-9, abs=0.0
    )
    assert Budget(same).dof == pytest.approx(8.0, rel=1e-9, abs=0.0)  # (2)^2 / (1/4 + 1/4)


def test_a_budget_agrees_with_drawing_its_lines():
    lines = [
        Contribution("a", 1.0, "rectangular"),
        Contribution("b", 2.0, "arcsine", sensitivity=0.5),
        Contribution("c", 0.4),
    ]
    rng = np.random.default_rng(1)
    n = 200_000
    drawn = rng.uniform(-1, 1, n) + np.cos(np.pi * rng.random(n)) + 0.4 * rng.standard_normal(n)

    assert Budget(lines).combined == pytest.approx(
        float(drawn.std()), rel=5 / math.sqrt(2 * n), abs=0.0
    )


@pytest.mark.parametrize("unit", [1e-9, 1e9, 1e-200])
def test_the_unit_of_a_budget_does_not_matter(unit):
    plain, r = end_gauge(), np.full((4, 4), 0.3) + 0.7 * np.eye(4)
    lines = [
        Contribution(c.name, c.value, sensitivity=c.sensitivity * unit, dof=c.dof)
        for c in plain.contributions
    ]

    assert Budget(lines).combined == pytest.approx(plain.combined * unit, rel=1e-9, abs=0.0)
    assert Budget(lines).dof == pytest.approx(plain.dof, rel=1e-9, abs=0.0)
    assert Budget(lines, correlations=r).combined == pytest.approx(
        Budget(plain.contributions, correlations=r).combined * unit, rel=1e-9, abs=0.0
    )


def test_a_budget_of_nothing_is_zero():
    budget = Budget([Contribution("a", 0.0, dof=3)])

    assert (budget.combined, budget.expanded(), budget.shares.tolist()) == (0.0, 0.0, [0.0])
    assert math.isinf(budget.dof)


def test_the_table_has_one_row_per_line_and_the_sum():
    frame = end_gauge().to_frame()

    assert list(frame.index) == [
        "standard",
        "comparison",
        "expansion difference",
        "temperature difference",
        "combined",
    ]
    assert frame.loc["temperature difference", "u"] == pytest.approx(16.675e-9, rel=1e-9, abs=0.0)
    assert frame["share"].iloc[:-1].sum() == pytest.approx(
        frame["share"].iloc[-1], rel=1e-9, abs=0.0
    )
    assert frame.loc["combined", "u"] == end_gauge().combined
    assert "standard 62 %" in repr(end_gauge())


@pytest.mark.parametrize(
    ("value", "expanded", "unit", "text"),
    [
        (107.8683e-9, 2.84e-9, "m", "(107.9 +- 2.8) nm"),
        (50.000838e-3, 93e-9, "m", "(50.000838 +- 0.000093) mm"),
        (100.021e-9, 0.0996e-9, "m", "(100.02 +- 0.10) nm"),
        (100.021e-9, 0.996e-9, "m", "(100.0 +- 1.0) nm"),
        (1234e-9, 340e-9, "m", "(1.23 +- 0.34) um"),
        (-3.0e-9, 12e-9, "m", "(-3 +- 12) nm"),
        (0.0, 3e-9, "m", "(0.0 +- 3.0) nm"),
        (2.25, 0.013, "1", "(2.250 +- 0.013)"),
        (4567.0, 123.0, "1", "(4570 +- 120)"),
        (1.0, 0.0, "V", "(1 +- 0) V"),
        (0.0, 0.0, "m", "(0 +- 0) m"),
    ],
)
def test_results_are_rounded_to_the_place_of_two_digits_of_u(value, expanded, unit, text):
    """JCGM 100, 7.2.6."""
    assert report_value(value, expanded, unit) == text


def test_extreme_magnitudes_are_printed_too():
    assert "E" not in report_value(1e300, 1e-300, "1")


def test_a_report_names_k_and_coverage():
    budget = Budget([Contribution("a", 1.4e-9)])

    assert budget.report(107.87e-9, "m") == "(107.9 +- 2.8) nm (k = 2.00, 95.45 %)"
    assert budget.to_quantity(107.87e-9, "m", "P-V", symbol="PV").u == 1.4e-9


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"value": -1.0}, "value"),
        ({"value": math.nan}, "value"),
        ({"value": 1.0, "distribution": "gauss"}, "gauss"),
        ({"value": 1.0, "divisor": 0.0}, "divisor"),
        ({"value": 1.0, "sensitivity": math.inf}, "sensitivity"),
        ({"value": 1.0, "dof": 0.0}, "degrees of freedom"),
    ],
)
def test_bad_lines_raise(options, match):
    with pytest.raises(DataError, match=match):
        Contribution("a", **options)


@pytest.mark.parametrize(
    ("names", "correlations", "match"),
    [
        ([], None, "at least one"),
        (["a", "a"], None, "must differ"),
        (["a", "b"], [[1.0]], "2 x 2"),
        (["a", "b"], [[1, 0.5], [0.4, 1]], "symmetric"),
        (["a", "b"], [[1, 1.2], [1.2, 1]], "semi-definite"),
        (["a", "b"], [[2, 0], [0, 1]], "ones"),
        (["a", "b"], [[1, math.nan], [math.nan, 1]], "finite"),
    ],
)
def test_bad_budgets_raise(names, correlations, match):
    with pytest.raises(DataError, match=match):
        Budget([Contribution(n, 1.0) for n in names], correlations=correlations)


def test_bad_coverage_and_reports_raise():
    with pytest.raises(DataError, match="between 0 and 1"):
        coverage_factor(1.0)
    with pytest.raises(DataError, match="degrees of freedom"):
        coverage_factor(0.95, 0.0)
    with pytest.raises(DataError, match="coverage factor"):
        end_gauge().expanded(k=-1.0)
    with pytest.raises(DataError, match="cannot report"):
        report_value(math.nan, 1.0, "m")


def test_ready_lines_are_the_algebra_of_their_source():
    root3 = math.sqrt(3.0)
    series = type_a([1e-9, 2e-9, 3e-9])

    assert scale_line(100e-9, 1e-3).u == pytest.approx(0.1e-9 / root3, rel=1e-9, abs=0.0)
    assert scale_line(2.0, 1e-3, degree=0).u == 0.0
    assert lateral_scale_line(0.02, 1e-3, exponent=-1).sensitivity == -0.02
    assert certificate_line("flat", 8e-9, sensitivity=0.5).u == pytest.approx(
        2e-9, rel=1e-9, abs=0.0
    )
    assert alternatives_line("cutoff", [10e-9, 13e-9, 12e-9]).u == pytest.approx(
        1.5e-9 / root3, rel=1e-9, abs=0.0
    )
    assert drift_line(-1e-9, 60.0).u == pytest.approx(60e-9 / root3, rel=1e-9, abs=0.0)
    assert nonlinearity_line(2.0, 10e-6).u == pytest.approx(200e-12 / root3, rel=1e-9, abs=0.0)
    assert repeatability_line(series).u == pytest.approx(1e-9 / root3, rel=1e-9, abs=0.0)
    assert repeatability_line(series, of_mean=False).u == pytest.approx(1e-9, rel=1e-9, abs=0.0)
    assert repeatability_line(series).dof == 2


def test_bad_ready_lines_raise():
    with pytest.raises(DataError, match="duration"):
        drift_line(1e-9, -1.0)
    with pytest.raises(DataError, match="z scale"):
        scale_line(1.0, -1e-3)
    with pytest.raises(TooFewSamplesError, match="cutoff"):
        alternatives_line("cutoff", [1.0])
    with pytest.raises(InvalidSamplesError, match="cutoff"):
        alternatives_line("cutoff", [1.0, math.nan])


@pytest.mark.parametrize(
    ("value", "expanded", "printed"),
    [
        (-1.2e-6, 3e-3, "(0.0 +- 3.0) mm"),
        (-0.0, 3e-3, "(0.0 +- 3.0) mm"),
        (-0.0, 0.0, "(0 +- 0) m"),
        (-1.2e-3, 3e-3, "(-1.2 +- 3.0) mm"),
    ],
)
def test_no_negative_zero_is_printed(value, expanded, printed):
    assert report_value(value, expanded, "m") == printed
