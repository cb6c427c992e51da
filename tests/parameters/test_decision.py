"""Verdicts after ISO 14253-1, at the edges of the guard band in exact decimals."""

import math
from decimal import Decimal

import numpy as np
import pytest

from metrosep.core.errors import DataError
from metrosep.parameters.decision import decide, worst

NM = 1e-9
APART = 1e-12
"""Relative distance from an edge that is more than rounding."""


@pytest.mark.parametrize("unit", [1.0, NM, 1e-6, 25.4e-3, 3.7e5])
@pytest.mark.parametrize(
    ("value", "limit", "U", "factor", "edge"),
    [
        ("9.7", "10", "0.3", "1", "accept"),
        ("10.3", "10", "0.3", "1", "reject"),
        ("9.4", "10", "0.3", "2", "accept"),
        ("10.6", "10", "0.3", "2", "reject"),
        ("8.35", "10", "1", "1.65", "accept"),
        ("9.17", "10", "1", "0.83", "accept"),
        ("10.83", "10", "1", "0.83", "reject"),
        ("0.9", "1", "0.1", "1", "accept"),
        ("1.1", "1", "0.1", "1", "reject"),
        ("0.7", "1", "0.3", "1", "accept"),
        ("-0.1", "0", "0.1", "1", "accept"),
        ("0.1", "0", "0.1", "1", "reject"),
        ("10", "10", "0", "1", "accept"),
        ("10", "10", "3", "0", "accept"),
    ],
)
def test_the_edges_belong_to_accept_and_reject(value, limit, U, factor, edge, unit):
    v, at, u, g = (float(Decimal(t)) for t in (value, limit, U, factor))
    scaled = [x * unit for x in (v, at, u)]
    above = decide(scaled[0], upper=scaled[1], U=scaled[2], guard_factor=g)
    below = decide(-scaled[0], lower=-scaled[1], U=scaled[2], guard_factor=g)
    assert (above, below) == (edge, edge)
    # beside the edge, by more than rounding and less than anything measured
    aside = APART * max(abs(x) for x in scaled)
    aside = aside if edge == "accept" else -aside
    other = "reject" if u * g == 0.0 else "inconclusive"
    assert decide(scaled[0] + aside, upper=scaled[1], U=scaled[2], guard_factor=g) == other
    assert decide(-scaled[0] - aside, lower=-scaled[1], U=scaled[2], guard_factor=g) == other


def test_random_decimals_are_judged_as_exact_arithmetic_does():
    rng = np.random.default_rng(3)
    for _ in range(500):
        limit, U = (Decimal(int(k)) / 100 for k in rng.integers(1, 2000, 2))
        factor = Decimal(int(rng.integers(0, 300))) / 100
        value = limit + Decimal(int(rng.integers(-1, 2))) * factor * U
        guard = factor * U
        truth = "accept" if value <= limit - guard else "inconclusive"
        truth = "reject" if truth != "accept" and value >= limit + guard else truth
        found = decide(
            float(value) * NM, upper=float(limit) * NM, U=float(U) * NM, guard_factor=float(factor)
        )
        assert found == truth, (value, limit, U, factor)


def test_two_limits():
    both = {"lower": -1.0, "upper": 3.0, "U": 0.5}
    values = (-1.5, -1.0, -0.5, 1.0, 2.5, 3.0, 3.5)
    words = ["reject", "inconclusive", "accept", "accept", "accept", "inconclusive", "reject"]
    assert [decide(v, **both) for v in values] == words
    assert decide(0.0, lower=-1.0, upper=1.0, U=2.0) == "inconclusive"  # wider than the zone


def test_what_is_not_a_number_and_what_is_infinite():
    assert decide(math.nan, upper=1.0, U=0.1) == "inconclusive"
    assert decide(math.inf, upper=1.0, U=0.1) == "reject"
    assert decide(-math.inf, lower=1.0, U=0.1) == "reject"
    assert decide(1.0, upper=2.0, U=1e300, guard_factor=1e300) == "inconclusive"


@pytest.mark.parametrize(
    "options",
    [
        {"U": 0.1},
        {"U": -0.1, "upper": 1.0},
        {"U": math.nan, "upper": 1.0},
        {"U": 0.1, "upper": 1.0, "lower": 2.0},
        {"U": 0.1, "upper": 1.0, "guard_factor": -1.0},
    ],
)
def test_bad_limits_are_refused(options):
    with pytest.raises(DataError):
        decide(0.0, **options)


def test_the_worst_verdict_counts():
    assert worst(["accept", "inconclusive", "reject"]) == "reject"
    assert worst(["accept", "inconclusive"]) == "inconclusive"
    assert worst([]) is None
