"""Decision rules: U01 and its neighbours, each rule on both sides of each limit."""

from __future__ import annotations

import math

import numpy as np
import pytest

from metrosep.core.errors import DataError
from metrosep.parameters.decision import conformance_probability, decide, guard_factor, judge

U_C = 0.25  # of acceptance row U01: limit 10, u_c 0.25
G95 = 1.6448536269514722 * U_C  # 95 % point of the normal distribution, printed tables
TABLE = 1e-6  # printed digits of the normal distribution below


def test_guard_factor_of_14253_accepts_9_55_and_not_9_60():
    """Row U01: limit of acceptance 9.5888."""
    factor = guard_factor(0.95)

    assert decide(9.55, upper=10.0, U=2 * U_C, guard_factor=factor) == "accept"
    assert decide(9.60, upper=10.0, U=2 * U_C, guard_factor=factor) == "inconclusive"
    assert 10.0 - factor * 2 * U_C == pytest.approx(9.5888, abs=5e-5)
    assert 10.0 - factor * 2 * U_C == pytest.approx(10.0 - G95, abs=TABLE)


@pytest.mark.parametrize(
    ("probability", "sides", "expected"),
    [(0.95, 1, 1.644854), (0.95, 2, 1.959964), (0.99, 1, 2.326348), (0.975, 1, 1.959964)],
)
def test_guard_factor_is_the_normal_quantile(probability, sides, expected):
    factor = guard_factor(probability, coverage_factor=2.0, sides=sides)

    assert factor == pytest.approx(expected / 2.0, abs=TABLE)
    assert guard_factor(probability, coverage_factor=3.0, sides=sides) == pytest.approx(
        factor * 2.0 / 3.0, rel=1e-9, abs=0.0
    )


@pytest.mark.parametrize(
    ("value", "verdict"),
    [
        (9.55, "accept"),
        (10 - G95 - 1e-9, "accept"),
        (10 - G95 + 1e-9, "inconclusive"),
        (10.0, "inconclusive"),
        (10 + G95 - 1e-9, "inconclusive"),
        (10 + G95 + 1e-9, "reject"),
    ],
)
def test_14253_upper_limit(value, verdict):
    assert judge(value, u=U_C, upper=10.0).verdict == verdict
    assert judge(-value, u=U_C, lower=-10.0).verdict == verdict


@pytest.mark.parametrize(
    ("value", "verdict"),
    [
        (8.0 - G95 - 1e-9, "reject"),
        (8.0, "inconclusive"),
        (8.0 + G95 - 1e-9, "inconclusive"),
        (8.0 + G95 + 1e-9, "accept"),
        (12.0 - G95 - 1e-9, "accept"),
        (12.0 - G95 + 1e-9, "inconclusive"),
        (12.0 + G95 + 1e-9, "reject"),
    ],
)
def test_14253_two_limits(value, verdict):
    assert judge(value, u=U_C, lower=8.0, upper=12.0).verdict == verdict


@pytest.mark.parametrize(
    ("value", "verdict"),
    [
        (9.4999, "accept"),
        (9.5001, "inconclusive"),
        (10.4999, "inconclusive"),
        (10.5001, "reject"),
        (8.4999, "inconclusive"),
        (8.5001, "accept"),
        (7.4999, "reject"),
    ],
)
def test_ilac_g8_guard_is_u(value, verdict):
    assert judge(value, u=U_C, lower=8.0, upper=10.0, rule="ilac-g8").verdict == verdict


@pytest.mark.parametrize(
    ("value", "verdict"),
    [(5.9999, "reject"), (6.0, "accept"), (10.0, "accept"), (10.0001, "reject")],
)
def test_simple_acceptance_with_an_uncertainty_ratio_of_4(value, verdict):
    assert judge(value, u=U_C, lower=6.0, upper=10.0, rule="simple").verdict == verdict


@pytest.mark.parametrize("value", [5.0, 8.0, 11.0])
def test_simple_acceptance_with_a_poor_ratio_decides_nothing(value):
    result = judge(value, u=U_C * 1.001, lower=6.0, upper=10.0, rule="simple")

    assert result.verdict == "inconclusive"
    assert "ratio 4, at least 4" in result.sentence


def test_simple_acceptance_of_one_limit_needs_a_tolerance():
    with pytest.raises(DataError, match="tolerance="):
        judge(9.0, u=U_C, upper=10.0, rule="simple")

    assert judge(9.0, u=U_C, upper=10.0, rule="simple", tolerance=10.0).verdict == "accept"
    assert judge(10.1, u=U_C, upper=10.0, rule="simple", tolerance=10.0).verdict == "reject"


def test_pfa_rule_of_one_limit_is_its_quantile():
    g = 1.959964 * U_C

    accepted, open_, rejected = (
        judge(v, u=U_C, upper=10.0, rule="pfa", pfa=0.025)
        for v in (10 - g - TABLE, 10 - g + TABLE, 10 + g + TABLE)
    )

    assert (accepted.verdict, open_.verdict, rejected.verdict) == (
        "accept",
        "inconclusive",
        "reject",
    )
    assert accepted.acceptance[1] == pytest.approx(10 - g, abs=TABLE)


@pytest.mark.parametrize("width", [4.2, 5.0, 8.0, 20.0])
def test_pfa_rule_of_two_limits_holds_the_sum_of_both_risks(width):
    """With limits 4.2 u apart, one-sided guards would let the risk grow to twice the figure."""
    low, high = 3.0, 3.0 + width * U_C
    middle = judge(0.5 * (low + high), u=U_C, lower=low, upper=high, rule="pfa", pfa=0.05)
    start, end = middle.acceptance

    for edge, inwards in ((start, 1e-6), (end, -1e-6)):
        inside = judge(edge + inwards, u=U_C, lower=low, upper=high, rule="pfa", pfa=0.05)
        outside = judge(edge - inwards, u=U_C, lower=low, upper=high, rule="pfa", pfa=0.05)
        assert (inside.verdict, outside.verdict) == ("accept", "inconclusive")
        assert inside.probability == pytest.approx(0.95, abs=1e-4)
    assert middle.verdict == "accept"
    assert judge(high + 3 * U_C, u=U_C, lower=low, upper=high, rule="pfa").verdict == "reject"
    assert judge(low - 3 * U_C, u=U_C, lower=low, upper=high, rule="pfa").verdict == "reject"


@pytest.mark.parametrize("rule", ["iso14253-1", "ilac-g8", "pfa"])
def test_limits_too_close_accept_nothing_and_say_so(rule):
    result = judge(10.0, u=U_C, lower=9.9, upper=10.1, rule=rule)

    assert result.verdict == "inconclusive"
    assert math.isnan(result.acceptance[0])
    assert "nothing can be accepted" in result.sentence


@pytest.mark.parametrize(
    ("a", "b", "expected"),
    [
        (-1, 1, 0.682689492),
        (-2, 2, 0.954499736),
        (-math.inf, 1.644853627, 0.95),
        (6, 7, 9.853e-10),
    ],
)
def test_conformance_probability_is_that_of_the_normal_table(a, b, expected):
    found = conformance_probability(5.0, 0.1, lower=5 + 0.1 * a, upper=5 + 0.1 * b)

    assert found == pytest.approx(expected, rel=1e-3 if expected < 1e-6 else 1e-8, abs=0.0)


def test_conformance_probability_agrees_with_drawing():
    drawn = 9.8 + U_C * np.random.default_rng(1).standard_normal(200_000)

    share = float(((drawn >= 9.5) & (drawn <= 10.0)).mean())

    found = conformance_probability(9.8, U_C, lower=9.5, upper=10.0)
    assert found == pytest.approx(share, abs=5 * 0.5 / math.sqrt(200_000))


def test_mirror_and_far_tails_keep_their_digits():
    far = conformance_probability(20.0, 1.0, lower=8.0, upper=10.0)

    assert far == pytest.approx(
        7.61985302416e-24, rel=1e-9, abs=0.0
    )  # tail at 10, 0.5 erfc(10/sqrt 2)
    assert conformance_probability(-20.0, 1.0, lower=-10.0, upper=-8.0) == far


def test_no_uncertainty_is_a_plain_comparison():
    assert conformance_probability(10.0, 0.0, upper=10.0) == 1.0
    assert conformance_probability(10.1, 0.0, upper=10.0) == 0.0
    for rule in ("iso14253-1", "ilac-g8", "pfa"):
        assert judge(10.0, u=0.0, upper=10.0, rule=rule).verdict == "accept"
        assert judge(10.1, u=0.0, upper=10.0, rule=rule).verdict == "reject"


def test_nan_is_inconclusive_under_every_rule():
    for rule in ("iso14253-1", "ilac-g8", "pfa", "simple"):
        result = judge(math.nan, u=U_C, lower=5.0, upper=10.0, rule=rule)
        assert result.verdict == "inconclusive"
        assert math.isnan(result.probability)


def test_a_decision_shows_margins_probability_and_rule():
    result = judge(9.60, u=U_C, lower=2.0, upper=10.0)

    assert result.margins == pytest.approx((7.6, 0.4), rel=1e-9, abs=0.0)
    assert result.margin == pytest.approx(0.4, rel=1e-9, abs=0.0)
    assert judge(10.5, u=U_C, upper=10.0).margin == pytest.approx(-0.5, rel=1e-9, abs=0.0)
    assert result.acceptance == pytest.approx((2 + G95, 10 - G95), rel=1e-9, abs=0.0)
    assert result.probability == pytest.approx(0.945201, abs=TABLE)
    assert str(result).startswith("inconclusive: ISO 14253-1, proven at 95 %")


@pytest.mark.parametrize("unit", [1e-9, 1e6])
@pytest.mark.parametrize("rule", ["iso14253-1", "ilac-g8", "pfa", "simple"])
@pytest.mark.parametrize("value", [7.9, 8.45, 9.0, 9.55, 9.7, 10.6])
def test_the_unit_does_not_change_a_verdict(value, rule, unit):
    plain = judge(value, u=U_C, lower=8.0, upper=10.0, rule=rule)
    scaled = judge(value * unit, u=U_C * unit, lower=8.0 * unit, upper=10.0 * unit, rule=rule)

    assert scaled.verdict == plain.verdict
    assert scaled.probability == pytest.approx(plain.probability, rel=1e-9, abs=0.0)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"u": 0.1}, "lower or an upper"),
        ({"u": 0.1, "lower": 2.0, "upper": 1.0}, "not in order"),
        ({"u": 0.1, "upper": math.nan}, "not in order"),
        ({"u": -0.1, "upper": 1.0}, "standard uncertainty"),
        ({"u": math.nan, "upper": 1.0}, "standard uncertainty"),
        ({"u": 0.1, "upper": 1.0, "rule": "iso"}, "not one of"),
        ({"u": 0.1, "upper": 1.0, "probability": 0.4}, "0.5 and 1"),
        ({"u": 0.1, "upper": 1.0, "probability": 1.0}, "0.5 and 1"),
        ({"u": 0.1, "upper": 1.0, "rule": "pfa", "pfa": 0.5}, "pfa"),
        ({"u": 0.1, "upper": 1.0, "rule": "ilac-g8", "coverage_factor": 0.0}, "coverage factor"),
        ({"u": 0.1, "lower": 0.0, "upper": 1.0, "rule": "simple", "min_tur": 0.0}, "ratio"),
    ],
)
def test_bad_rules_raise(options, match):
    with pytest.raises(DataError, match=match):
        judge(0.5, **options)


def test_bad_guard_factors_raise():
    with pytest.raises(DataError, match="sides"):
        guard_factor(0.95, sides=3)
    with pytest.raises(DataError, match="coverage factor"):
        guard_factor(0.95, coverage_factor=-2.0)


@pytest.mark.parametrize(
    ("value", "options", "match"),
    [
        ("1", {}, "value"),
        (None, {}, "value"),
        (1.0, {"U": "a"}, "U"),
        (1.0, {"upper": "a"}, "upper"),
        (1.0, {"lower": "a"}, "lower"),
        (1.0, {"guard_factor": None}, "guard_factor"),
    ],
)
def test_decision_on_what_is_no_number_is_refused(value, options, match):
    with pytest.raises(DataError, match=match):
        decide(value, **{"upper": 2.0, "U": 0.1, **options})


def test_value_that_is_not_measured_stays_inconclusive():
    assert decide(math.nan, upper=2.0, U=0.1) == "inconclusive"
