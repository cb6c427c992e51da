"""Rules over several values: the worked table of the specification, and binomial chances."""

import itertools
import math
from functools import cache

import numpy as np
import pytest

from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.parameters import judge_values

TWELVE = [0.71, 0.78, 0.66, 0.83, 0.74, 0.69, 0.81, 0.92, 0.75, 0.70, 0.77, 0.73]


@pytest.mark.parametrize(
    ("limit", "outside", "verdicts"),
    [
        (0.80, 3, ("reject", "reject", "accept")),
        (0.85, 1, ("accept", "reject", "accept")),
        (0.90, 1, ("accept", "reject", "accept")),
        (0.95, 0, ("accept", "accept", "accept")),
    ],
)
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_worked_table(limit, outside, verdicts, side):
    """For an upper limit, and turned over for a lower one."""
    values = [side * v for v in TWELVE]
    limits = {"upper": limit} if side > 0 else {"lower": -limit}
    found = [judge_values(values, rule=r, **limits) for r in ("16%", "max", "median")]

    assert tuple(f.verdict for f in found) == verdicts
    assert {f.n_outside for f in found} == {outside}


def test_stages_stop_at_the_first_that_decides():
    three = judge_values(TWELVE, upper=0.80, rule="16%", sequential=True)
    one = judge_values(TWELVE, upper=1.1, rule="16%", sequential=True)
    six = judge_values([0.9, *TWELVE], upper=0.8, rule="16%", sequential=True)

    assert (three.verdict, three.values) == ("accept", (0.71, 0.78, 0.66))
    assert (one.verdict, one.values) == ("accept", (0.71,))
    # 0.9 of the first three; 0.9 and 0.83 of six; 0.9, 0.83, 0.81, 0.92 of twelve
    assert (six.verdict, len(six.values)) == ("reject", 12)
    short = judge_values([0.9, 0.7, 0.7, 0.7], upper=0.8, rule="16%", sequential=True)
    assert (short.verdict, short.values) == ("inconclusive", (0.9, 0.7, 0.7, 0.7))
    assert "measure 2 more" in short.sentence


@pytest.mark.parametrize(
    ("share", "stages", "one_in_six", "largest"),
    [
        (0.05, 0.991404, 0.980432, 0.773781),
        (0.10, 0.947988, 0.889130, 0.590490),
        (0.16, 0.847175, 0.701004, 0.418212),
        (0.25, 0.642089, 0.390675, 0.237305),
        (0.40, 0.320922, 0.083443, 0.077760),
    ],
)
def test_chances_of_acceptance(share, stages, one_in_six, largest):
    """Every pattern of values inside and outside, weighted by its chance."""

    def chance(n, rule, sequential=False):
        return sum(
            math.prod(share if b else 1 - share for b in bad)
            for bad in accepted(n, rule, sequential=sequential)
        )

    assert chance(12, "16%", sequential=True) == pytest.approx(stages, abs=5e-7)
    assert chance(12, "16%") == pytest.approx(one_in_six, abs=5e-7)
    assert chance(5, "max") == pytest.approx(largest, abs=5e-7)


@cache
def accepted(n, rule, *, sequential):
    """Patterns that are accepted: the limit is 1, a value 0.9 or 1.1."""
    return [
        bad
        for bad in itertools.product([False, True], repeat=n)
        if judge_values(
            [1.1 if b else 0.9 for b in bad], upper=1.0, rule=rule, sequential=sequential
        ).verdict
        == "accept"
    ]


def staged(values, limit):
    """ISO 4288 written down anew: verdict, and how many values were looked at."""
    if values[0] <= 0.7 * limit:
        return "accept", 1
    above = list(itertools.accumulate(int(v > limit) for v in values))
    for seen, allowed in ((3, 0), (6, 1), (12, 2)):
        hopeless = next((k + 1 for k, n in enumerate(above[:seen]) if n > 2), None)
        if hopeless is not None:
            return "reject", None  # the stage may be finished or not
        if len(values) < seen:
            return "inconclusive", len(values)
        if above[seen - 1] <= allowed:
            return "accept", seen
    return "reject", 12


@pytest.mark.parametrize("n", [1, 2, 3, 5, 6, 7, 11, 12])
def test_stages_of_every_sequence(n):
    """All sequences of low, good and bad values; of the longest ones 2000 drawn."""
    kinds = (0.65, 0.95, 1.05)
    rng = np.random.default_rng(n)
    drawn = rng.choice(kinds, (2000, n), p=(0.1, 0.6, 0.3))
    for values in itertools.product(kinds, repeat=n) if n < 8 else drawn.tolist():
        verdict, used = staged(values, 1.0)
        found = judge_values(values, upper=1.0, rule="16%", sequential=True)
        assert found.verdict == verdict, values
        assert used is None or len(found.values) == used, values


def test_each_limit_is_a_requirement_of_its_own():
    """One of six above and one below: at each limit one in six."""
    six = [0.5, 1.0, 1.0, 1.0, 1.0, 1.5]
    both = {"lower": 0.8, "upper": 1.2}
    assert judge_values(six, rule="16%", **both).verdict == "accept"
    assert judge_values([0.5, 0.5, *six[2:]], rule="16%", **both).verdict == "reject"
    assert judge_values(six, rule="max", **both).verdict == "reject"
    stages = judge_values(six, rule="16%", sequential=True, **both)
    # the upper limit is settled by three values, the lower one by six
    assert (stages.verdict, len(stages.values), stages.n_outside) == ("accept", 6, 1)
    assert "lower limit" in stages.sentence
    assert "upper limit" in stages.sentence
    near = judge_values([1.0] * 5 + [1.15], rule="16%", U=0.1, **both)
    assert near.verdict == "accept"  # one may be beyond


def test_guard_band_makes_a_count_inconclusive():
    for rule in ("max", "16%", "median"):
        near = judge_values([0.96] * 6, upper=1.0, rule=rule, U=0.1)
        assert near.verdict == "inconclusive"
        assert judge_values([0.89] * 6, upper=1.0, rule=rule, U=0.1).verdict == "accept"
        assert judge_values([1.12] * 6, upper=1.0, rule=rule, U=0.1).verdict == "reject"
        assert judge_values([0.96] * 6, upper=1.0, rule=rule, U=0.1, guard_factor=0.2).verdict == (
            "accept"
        )


@pytest.mark.parametrize("limit", [0.2, 0.4, 0.8, 1.6, 3.2, 6.3, 12.5])
@pytest.mark.parametrize("unit", [1.0, 1e-6, 1e-9])
def test_a_first_value_of_seventy_per_cent_ends_the_stages(limit, unit):
    """0.56 um of 0.8 um is 70 %, whatever 0.7 * 0.8 is in binary; 0.57 um is more."""
    seventy = round(0.7 * limit, 6)
    at, beyond = (
        judge_values([v * unit], upper=limit * unit, rule="16%", sequential=True)
        for v in (seventy, seventy + 0.01)
    )
    assert (at.verdict, beyond.verdict) == ("accept", "inconclusive")


def test_seventy_per_cent_of_a_limit_below_zero_accepts_nothing():
    """Rsk = -0.4 is above its upper limit of -0.5, though it is below 0.7 * -0.5."""
    above = judge_values([-0.4], upper=-0.5, rule="16%", sequential=True)
    assert (above.verdict, above.n_outside) == ("inconclusive", 1)
    below = judge_values([-0.6, -0.7, -0.8], upper=-0.5, rule="16%", sequential=True)
    assert (below.verdict, len(below.values)) == ("accept", 3)
    # with its guard band a limit of 0.1 ends at -0.4, and -0.35 is not proven to be below
    near = judge_values([-0.35], upper=0.1, U=0.5, rule="16%", sequential=True)
    assert near.verdict == "inconclusive"


@pytest.mark.parametrize("unit", [1.0, 1e-6, 1e-9])
def test_one_value_is_judged_as_without_a_rule(unit):
    """Hand-made values of two digits about hand-made limits: also on the edges of the guard band."""
    for limit, U, k in itertools.product(
        (0.35, 0.8, 1.6, 6.3), (0.0, 0.01, 0.02, 0.1), range(-12, 13)
    ):
        value = round(limit + 0.01 * k, 2)
        guard = round(100 * U)  # in hundredths, as k
        truth = "accept" if k <= -guard else "reject" if k >= guard else "inconclusive"
        for side, sign in (("upper", 1), ("lower", -1)):
            v, t = (value, limit) if sign > 0 else (-value, -limit)
            for rule in ("max", "16%", "median"):
                found = judge_values([v * unit], U=U * unit, rule=rule, **{side: t * unit})
                assert found.verdict == truth, (limit, U, value, side, rule)


def test_few_values_say_that_the_rule_is_the_maximum_rule():
    found = judge_values(TWELVE[:5], upper=0.80, rule="16%")

    assert (found.verdict, found.n_allowed) == ("reject", 0)
    assert "is the maximum rule" in found.sentence


def test_what_cannot_be_judged_is_refused():
    with pytest.raises(TooFewSamplesError, match="at least one value"):
        judge_values([], upper=1.0)
    with pytest.raises(DataError, match="limit"):
        judge_values(TWELVE)
    with pytest.raises(DataError, match="rule"):
        judge_values(TWELVE, upper=1.0, rule="16 %")
    with pytest.raises(DataError, match="belongs to the 16 % rule"):
        judge_values(TWELVE, upper=1.0, rule="max", sequential=True)
    with pytest.raises(DataError, match="finite"):
        judge_values([0.7, np.nan], upper=1.0)
