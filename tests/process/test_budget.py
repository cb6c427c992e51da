"""Budgets: the four cases of slow-tool-servo, and maps that add or cancel."""

from __future__ import annotations

import numpy as np
import pytest

from metrosep.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.process.budget import Contribution, ErrorBudget

NM = 1e-9
DIGIT = 0.05e-9
"""Half of the last printed digit of the table in papers.md 1.8."""


@pytest.mark.parametrize(
    ("tool", "program", "follow", "total", "rss", "shares"),
    [
        (22.0, 7.6, 13.0, 42.6, 26.7, (52, 18, 31)),
        (1.57, 7.6, 13.0, 22.2, 15.1, (7, 34, 59)),
        (1.57, 1.07, 13.0, 15.6, 13.1, (10, 7, 83)),
        (1.57, 1.07, 5.0, 7.6, 5.3, (21, 14, 66)),
    ],
)
def test_the_four_cases_of_the_paper(tool, program, follow, total, rss, shares):
    budget = ErrorBudget(
        [("tool", tool * NM), ("program", program * NM), ("follow-up", follow * NM)]
    )

    assert budget.combine("sum").pv == pytest.approx(total * NM, abs=DIGIT)
    assert budget.combine("rss").pv == pytest.approx(rss * NM, abs=DIGIT)
    percent = [100 * v for v in budget.shares.values()]
    # the page prints whole per cents, one of them rounded the other way (65.45 as 66)
    assert percent == pytest.approx(shares, abs=0.6)


def test_maps_add_pointwise_and_may_cancel():
    theta = np.linspace(0, 2 * np.pi, 721)
    one, two = 5 * NM * np.cos(theta), -5 * NM * np.cos(theta)
    third = 5 * NM * np.sin(theta)
    both = ErrorBudget([Contribution("a", map=one), Contribution("b", map=two)])
    across = ErrorBudget([Contribution("a", map=one), Contribution("c", map=third)])

    assert both.combine("pointwise").pv == pytest.approx(0.0, abs=1e-24)
    assert both.combine("sum").pv == pytest.approx(20 * NM, abs=1e-15)
    # cos + sin has the amplitude sqrt 2: here the root sum of squares is right
    assert across.combine("pointwise").pv == pytest.approx(10 * 2**0.5 * NM, abs=1e-13)
    assert across.combine("rss").pv == pytest.approx(10 * 2**0.5 * NM, abs=1e-15)


def test_variance_shares_show_what_takes_from_the_rest():
    x = np.linspace(-1, 1, 1001)
    budget = ErrorBudget([Contribution("big", map=3 * NM * x), Contribution("small", map=-NM * x)])
    assert budget.variance_shares == pytest.approx({"big": 1.5, "small": -0.5}, abs=1e-12)


def test_monte_carlo_scales_each_cause_within_its_uncertainty():
    x = np.linspace(-1, 1, 501)
    budget = ErrorBudget(
        [
            Contribution("a", map=5 * NM * x, u=1 * NM),
            Contribution("b", map=2 * NM * x, u=0.5 * NM),
        ]
    )
    total = budget.combine("monte-carlo", draws=40_000, seed=1)
    spread = np.hypot(1, 0.5) * NM  # maps of one shape: P-Vs add, and so do their variances
    assert total.pv == pytest.approx(14 * NM, abs=0.03 * NM)
    assert total.u == pytest.approx(spread, abs=0.02 * NM)
    low, high = total.interval
    assert (low, high) == pytest.approx(
        (14 * NM - 1.96 * spread, 14 * NM + 1.96 * spread), abs=0.05 * NM
    )
    assert budget.combine("pointwise").u == pytest.approx(spread, abs=0.06 * NM)
    assert budget.combine("sum").u == pytest.approx(spread, abs=1e-15)


def test_rss_uncertainty_is_the_derivative():
    a, b, ua = 3 * NM, 4 * NM, 0.2 * NM
    total = ErrorBudget([Contribution("a", a, u=ua), ("b", b)]).combine("rss")
    assert total.pv == pytest.approx(5 * NM, abs=1e-20)
    assert total.u == pytest.approx(a / 5e-9 * ua, abs=1e-20)


def test_points_that_a_map_misses_count_in_none():
    budget = ErrorBudget(
        [
            Contribution("a", map=[[0.0, 1 * NM], [np.nan, 9 * NM]]),
            Contribution("b", map=[[0.0, 1 * NM], [5 * NM, np.nan]]),
        ]
    )
    assert budget.combine("pointwise").pv == pytest.approx(2 * NM, abs=1e-20)


def test_a_bare_pv_has_no_shape():
    budget = ErrorBudget([Contribution("tool", map=[0.0, 1 * NM]), ("follow-up", 13 * NM)])
    for way in ("pointwise", "monte-carlo"):
        with pytest.raises(DataError, match="follow-up is a P-V only"):
            budget.combine(way)
    assert set(budget.totals()) == {"sum", "rss"}
    with pytest.raises(DataError, match="follow-up"):
        _ = budget.variance_shares


def test_table_holds_predicted_beside_measured():
    budget = ErrorBudget([("tool", 1.57 * NM), ("program", 1.07 * NM)])
    frame = budget.to_frame(measured=8 * NM)
    assert list(frame["item"]) == ["tool", "program", "total, sum", "total, rss", "measured"]
    assert frame["pv_nm"].iloc[-1] == pytest.approx(8.0, abs=1e-12)
    assert budget.to_dict()["totals"]["sum"]["u_nm"] is None


def test_uncertainty_is_not_invented():
    assert np.isnan(ErrorBudget([("a", 1 * NM)]).combine("sum").u)


@pytest.mark.parametrize(
    ("call", "error", "match"),
    [
        (lambda: ErrorBudget([]), DataError, "at least one"),
        (lambda: ErrorBudget([("a", 1.0), ("a", 2.0)]), DataError, "twice"),
        (lambda: ErrorBudget([("a", -1.0)]), DataError, "from 0 on"),
        (lambda: ErrorBudget([("a", np.nan)]), DataError, "got nan"),
        (lambda: Contribution("a"), DataError, "needs a map or a P-V"),
        (lambda: Contribution("a", 2e-9, map=[0.0, 1e-9]), DataError, "give one of the two"),
        (lambda: Contribution("a", map=[0.0, np.inf]), InvalidSamplesError, "infinite"),
        (lambda: Contribution("a", map=[np.nan]), TooFewSamplesError, "no value"),
        (
            lambda: ErrorBudget(
                [Contribution("a", map=[0.0, 1.0]), Contribution("b", map=[0.0, 1.0, 2.0])]
            ),
            DataError,
            "shapes differ",
        ),
        (lambda: ErrorBudget([("a", 1.0)]).combine("max"), DataError, "way must be"),
        (
            lambda: ErrorBudget([Contribution("a", map=[0.0, 1.0])]).combine(
                "monte-carlo", draws=3
            ),
            TooFewSamplesError,
            "100 draws",
        ),
    ],
)
def test_bad_input(call, error, match):
    with pytest.raises(error, match=match):
        call()
