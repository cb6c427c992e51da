"""Budgets: the four cases of slow-tool-servo, and maps that add or cancel."""

from __future__ import annotations

import numpy as np
import pytest

from metrosep.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.process import predictions as budget_module
from metrosep.process.follow_ups import drawn_pv
from metrosep.process.predictions import Contribution, ErrorBudget

NM = 1e-9
ONE = [Contribution("a", map=[0.0, 1.0])]
DIGIT = 0.05e-9
"""Half of the last printed digit of the table in papers.md 1.8."""
OF_DRAWS = 0.03
"""Relative scatter of a mean or standard deviation of 4000 draws of a folded normal, 2 sigma."""
HALF_MEAN, HALF_SD = (2 / np.pi) ** 0.5, (1 - 2 / np.pi) ** 0.5
"""Mean and standard deviation of |xi|, xi standard normal."""


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


def test_a_mode_of_unknown_sign_folds_the_pv_at_zero():
    # map xi u m with m of P-V 2: P-V is 2 u |xi|, a half normal
    x = np.linspace(-1, 1, 201)
    tool = Contribution("tool", map=0 * x, modes=[x], cov=[[(3 * NM) ** 2]])
    assert tool.pv == 0.0
    assert tool.expected == pytest.approx(6 * NM * HALF_MEAN, rel=0, abs=OF_DRAWS * 6 * NM)
    assert tool.u == pytest.approx(6 * NM * HALF_SD, abs=OF_DRAWS * 6 * NM)
    low, high = tool.interval
    assert low == pytest.approx(0.0313 * 6 * NM, abs=0.02 * 6 * NM)
    assert high == pytest.approx(2.2414 * 6 * NM, abs=0.1 * 6 * NM)
    totals = ErrorBudget([tool]).totals()
    for way in ("pointwise", "monte-carlo", "sum", "rss"):
        assert totals[way].u == pytest.approx(6 * NM * HALF_SD, abs=0.5 * 6 * NM), way
        assert totals[way].expected == pytest.approx(6 * NM * HALF_MEAN, abs=0.35 * 6 * NM), way
    assert totals["pointwise"].interval == pytest.approx((low, high), abs=0.1 * 6 * NM)
    assert any("tool" in m and "expected" in m for m in ErrorBudget([tool]).messages)


def test_correlated_modes_cancel():
    x = np.linspace(-1, 1, 201)
    cov = np.array([[1.0, -1.0], [-1.0, 1.0]]) * (2 * NM) ** 2
    same = Contribution("a", map=9 * NM * x, modes=[x, x], cov=cov)
    other = Contribution("b", map=9 * NM * x, modes=[x, -x], cov=cov)
    assert same.u == pytest.approx(0.0, abs=1e-4 * NM)
    # the factor of the map varies by 4 nm, its P-V by 8 nm, folded where it is negative
    signed = 18 * NM + 8 * NM * np.random.default_rng(1).standard_normal(100_000)
    assert other.u == pytest.approx(np.abs(signed).std(), abs=0.3 * NM)
    assert other.expected == pytest.approx(np.abs(signed).mean(), abs=0.3 * NM)


@pytest.mark.parametrize("still", [0.0, 0.3, 3.0])
def test_draws_look_at_every_point_that_can_be_extreme(still):
    rng = np.random.default_rng(7)
    t = np.linspace(0, 40, 4001)
    modes = np.array([np.sin(t) * np.cos(t / 9), np.cos(t) * np.sin(t / 7), np.exp(-t)])
    base = still * np.sin(3 * t) * t / 40
    xi = rng.standard_normal((500, 3))
    found = drawn_pv(base, modes, xi)
    np.testing.assert_allclose(found, np.ptp(base + xi @ modes, axis=1), rtol=1e-13)
    lonely = np.ptp(base + 0 * modes[0])
    assert drawn_pv(base, 0 * modes, xi) == pytest.approx(np.full(500, lonely), abs=1e-15)


def test_one_uncertain_cause_among_maps_without_u():
    x = np.linspace(-1, 1, 501)
    tool = Contribution("tool", map=0 * x, modes=[x], cov=[[NM**2]])
    program = Contribution("program", map=10 * NM * x)
    total = ErrorBudget([tool, program]).combine("monte-carlo")
    assert total.u == pytest.approx(2 * NM, abs=OF_DRAWS * 2 * NM)  # no fold: 10 sigma away
    assert total.pv == pytest.approx(20 * NM, abs=0.1 * NM)
    assert total.expected == pytest.approx(20 * NM, abs=0.1 * NM)


def test_rss_of_a_pv_of_zero_keeps_its_uncertainty():
    alone = ErrorBudget([("a", 0.0, 1 * NM)]).combine("rss")
    assert alone.u == pytest.approx(1 * NM, abs=1e-15)
    both = ErrorBudget([("a", 0.0, 1 * NM), ("b", 0.0, 2 * NM)]).combine("rss")
    assert 0.5 * 5**0.5 * NM < both.u <= 5**0.5 * NM
    beside = ErrorBudget([("a", 0.0, 1 * NM), ("b", 10 * NM)]).combine("rss")
    assert beside.u == pytest.approx(0.1 * NM, abs=0.05 * NM)


def test_a_map_of_zero_has_no_shape_for_its_u():
    budget = ErrorBudget([Contribution("a", map=[0.0, 0.0], u=1 * NM)])
    assert budget.combine("pointwise").u == pytest.approx(1 * NM, abs=1e-15)
    assert budget.combine("monte-carlo").u == pytest.approx(1 * NM, abs=1e-15)
    assert any("'a'" in m and "modes" in m for m in budget.messages)


def test_area_weights_split_the_mean_square():
    one, two = np.array([1.0, -1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0, -1.0])
    maps = [Contribution("a", map=one), Contribution("b", map=two)]
    assert ErrorBudget(maps).variance_shares == pytest.approx({"a": 0.5, "b": 0.5}, abs=1e-12)
    wide = ErrorBudget(maps, weights=[3.0, 3.0, 1.0, 1.0])
    assert wide.variance_shares == pytest.approx({"a": 0.75, "b": 0.25}, abs=1e-12)


def test_points_without_a_value_are_counted_aloud():
    budget = ErrorBudget(
        [
            Contribution("a", map=[0.0, 5 * NM, np.nan, 1 * NM]),
            Contribution("b", map=[0.0, np.nan, 1 * NM, 2 * NM]),
        ]
    )
    said = " ".join(budget.messages)
    assert "2 of 4 points" in said
    assert "'a' 1" in said
    assert "'b' 1" in said
    assert budget.combine("pointwise").messages == budget.messages
    assert not ErrorBudget([("a", NM)]).messages


def test_draws_are_made_once_and_only_where_something_is_uncertain(monkeypatch):
    calls = []
    true = budget_module.drawn_pv

    def counted(*arguments):
        calls.append(1)
        return true(*arguments)

    monkeypatch.setattr(budget_module, "drawn_pv", counted)
    x = np.linspace(-1, 1, 101)
    sure = ErrorBudget([Contribution("a", map=x), Contribution("b", map=x**2)])
    total = sure.combine("monte-carlo")
    assert not calls
    assert total.pv == sure.combine("pointwise").pv
    assert np.isnan(total.u)
    assert total.interval == (total.pv, total.pv)
    unsure = ErrorBudget([Contribution("a", map=x, u=0.1), Contribution("b", map=x**2)])
    unsure.to_frame()
    unsure.to_dict()
    unsure.totals()
    assert len(calls) == 1


def test_a_third_item_is_the_uncertainty():
    assert ErrorBudget([("a", 1 * NM, 0.5 * NM)]).combine("sum").u == pytest.approx(
        0.5 * NM, abs=1e-20
    )


def test_tables_hold_expected_value_and_interval():
    x = np.linspace(-1, 1, 101)
    budget = ErrorBudget([Contribution("tool", map=0 * x, modes=[x], cov=[[NM**2]])])
    frame = budget.to_frame().set_index("item")
    assert frame.loc["tool", "expected_nm"] == pytest.approx(2 * HALF_MEAN, abs=0.06)
    assert frame.loc["total, monte-carlo", "high_nm"] > frame.loc["tool", "low_nm"]
    plain = budget.to_dict()
    assert plain["contributions"][0]["expected_nm"] == pytest.approx(2 * HALF_MEAN, abs=0.06)
    assert len(plain["totals"]["pointwise"]["interval_nm"]) == 2
    assert plain["totals"]["sum"]["interval_nm"] is None
    assert plain["messages"]


def test_uncertainty_is_not_invented():
    assert np.isnan(ErrorBudget([("a", 1 * NM)]).combine("sum").u)


@pytest.mark.parametrize(
    ("call", "error", "match"),
    [
        (lambda: ErrorBudget([]), DataError, "at least one"),
        (lambda: ErrorBudget([("a", 1.0), ("a", 2.0)]), DataError, "twice"),
        (lambda: ErrorBudget([("a", -1.0)]), DataError, "zero or more"),
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
        (lambda: ErrorBudget([("a", 1.0)]).combine("max"), DataError, "way is one of"),
        (lambda: ErrorBudget([("a", None)]), DataError, "'a' needs a map"),
        (lambda: ErrorBudget(5), DataError, "sequence .* got int"),
        (lambda: ErrorBudget({"a": 1.0}), DataError, "sequence .* got dict"),
        (lambda: ErrorBudget("ab"), DataError, "sequence .* got str"),
        (lambda: ErrorBudget(["ab"]), DataError, "contribution 0 .* got 'ab'"),
        (lambda: ErrorBudget([None]), DataError, "contribution 0 .* got None"),
        (lambda: ErrorBudget([("a", 1.0, 0.1, 0.2)]), DataError, "got .*0.2"),
        (lambda: ErrorBudget(ONE, weights=[1.0]), DataError, "shape .1,., the maps .2"),
        (lambda: ErrorBudget(ONE, weights=[1.0, -1.0]), DataError, "from 0 on, and not all 0"),
        (lambda: ErrorBudget(ONE, weights="a"), DataError, "weights must hold real numbers"),
        (lambda: ErrorBudget([("a", 1.0)], weights=[1.0]), DataError, "maps None"),
        (
            lambda: ErrorBudget(ONE).combine("monte-carlo", draws=150.5),
            DataError,
            "draws must be a whole",
        ),
        (
            lambda: ErrorBudget(ONE).combine("monte-carlo", draws=10**9),
            DataError,
            "draws must be a whole number from 1 to 1000000",
        ),
        (lambda: ErrorBudget(ONE).combine("pointwise", seed=-1), DataError, "seed .* got -1"),
        (lambda: ErrorBudget(ONE).totals(seed=None), DataError, "seed .* got None"),
        (lambda: Contribution("a", 1.0, modes=[[1.0]], cov=[[1.0]]), DataError, "need the map"),
        (lambda: Contribution("a", map=[0.0, 1.0], modes=[[1.0, 0.0]]), DataError, "both"),
        (
            lambda: Contribution("a", map=[0.0, 1.0], modes=[[1.0]], cov=[[1.0]]),
            DataError,
            "shape",
        ),
        (
            lambda: Contribution("a", map=[0.0, 1.0], modes=[[1.0, 0.0]], cov=[[1.0, 0.0]]),
            DataError,
            "covariance .* got the shape .1, 2",
        ),
        (
            lambda: Contribution("a", map=[0.0, 1.0], modes=[[1.0, 0.0]], cov=[[-1.0]]),
            DataError,
            "not symmetric and positive",
        ),
        (
            lambda: Contribution("a", map=[0.0, 1.0], modes=[[1.0, 0.0]], cov=[[np.inf]]),
            DataError,
            "must be finite",
        ),
        (
            lambda: Contribution("a", map=[0.0, 1.0], modes=[[np.inf, 0.0]], cov=[[1.0]]),
            InvalidSamplesError,
            "a mode of",
        ),
        (
            lambda: Contribution("a", map=[0.0, 1.0], u=1.0, modes=[[1.0, 0.0]], cov=[[1.0]]),
            DataError,
            "has u and modes",
        ),
        (
            lambda: Contribution("a", map=[0.0, np.nan], modes=[[np.nan, 1.0]], cov=[[1.0]]),
            TooFewSamplesError,
            "no point",
        ),
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
