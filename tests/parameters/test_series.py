"""A series of parts: control limits by hand and as published, drift with its uncertainty, correlation."""

import math
import warnings

import numpy as np
import pytest

from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.parameters import part_series

ROUNDING = 1e-12
"""Of sums of a few numbers of order one."""

# NIST/SEMATECH e-Handbook 6.3.2.2: flow rates of ten batches, mean range 1.8778, limits 45.82 and 55.80
NIST = [49.6, 47.6, 49.9, 51.3, 47.8, 51.2, 52.6, 52.4, 53.6, 52.1]


def one(values, **options):
    return part_series({"a": values}, **options).terms[0]


def test_published_limits():
    term = one(NIST)
    assert abs(term.mean - 50.81) <= 5e-3
    assert abs(np.mean(np.abs(np.diff(NIST))) - 1.8778) <= 5e-5
    assert (
        abs(term.upper - 55.8041) <= 2e-3
    )  # 50.81 + 3 x 1.8778 / 1.128, 1.128 being 2 / sqrt(pi) rounded
    assert abs(term.lower - 45.8159) <= 2e-3
    assert abs(term.range_upper - 3.267 * 1.8778) <= 2e-4


def test_slope_and_its_uncertainty_by_hand():
    # values 0 1 0 1 4 at x = -2..2: slope 0.8, remainders by hand
    term = one([0.0, 1.0, 0.0, 1.0, 4.0])
    x, v = np.arange(-2.0, 3.0), np.array([0.0, 1.0, 0.0, 1.0, 4.0])
    left = v - 1.2 - 0.8 * x
    assert abs(term.slope - 0.8) <= ROUNDING
    assert abs(term.u_slope - math.sqrt((left @ left) / 3 / 10)) <= ROUNDING
    assert abs(term.drift - 3.2) <= ROUNDING


def test_drift_has_the_sign_of_the_change():
    rng = np.random.default_rng(2)
    noise = rng.standard_normal((2, 40))
    found = part_series(
        {"up": np.arange(40) * 0.5 + noise[0], "down": -np.arange(40) * 0.5 + noise[1]}
    )
    assert [t.drift > 0 for t in found.terms] == [True, False]
    assert all(t.drifts for t in found.terms)
    assert abs(found.terms[0].drift - 19.5) <= 4 * found.terms[0].u_drift


def test_false_discoveries_stay_rare():
    rng = np.random.default_rng(4)
    false = 0
    for _ in range(120):
        found = part_series({f"t{i}": rng.standard_normal(25) for i in range(12)})
        false += bool(found.drifting) or bool(found.correlated)
    # each of the two lists is empty but for 5 % of the batches: 10 % of 120, four sigma above
    assert false <= 12 + 4 * math.sqrt(12 * 0.9)


def test_two_drifts_alone_are_no_correlation():
    rng = np.random.default_rng(5)
    i = np.arange(60)
    found = part_series(
        {"a": 1.0 * i + rng.standard_normal(60), "b": -2.0 * i + rng.standard_normal(60)}
    )
    assert not found.correlated
    assert abs(found.correlation[0, 1]) < 0.4


def test_planted_correlation_with_its_sign():
    rng = np.random.default_rng(6)
    common = rng.standard_normal(50)
    table = {
        "a": common + 0.3 * rng.standard_normal(50),
        "b": -common + 0.3 * rng.standard_normal(50),
        "c": rng.standard_normal(50),
    }
    found = part_series(table)
    assert [c[:2] for c in found.correlated] == [("a", "b")]
    assert found.correlated[0][2] < -0.8
    left = [v - np.polyval(np.polyfit(np.arange(50), v, 1), np.arange(50)) for v in table.values()]
    assert np.abs(found.correlation - np.corrcoef(left)).max() <= 1e-10


def test_null_space_offset_scale_and_line():
    rng = np.random.default_rng(7)
    a, b = rng.standard_normal((2, 30))
    plain = part_series({"a": a, "b": b})
    moved = part_series({"a": 3.0 * a + 100.0, "b": b + 0.2 * np.arange(30)})
    assert abs(moved.correlation[0, 1] - plain.correlation[0, 1]) <= 1e-10
    assert abs(moved.terms[0].slope - 3.0 * plain.terms[0].slope) <= 1e-12
    assert abs(moved.terms[1].slope - plain.terms[1].slope - 0.2) <= 1e-12
    assert abs(moved.terms[1].u_slope - plain.terms[1].u_slope) <= 1e-12


def test_beyond_and_runs():
    values = np.tile([0.0, 1.0], 15)
    values[20] = 9.0
    assert one(values).beyond == (20,)
    shifted = np.r_[np.tile([0.0, 0.2], 8), np.tile([1.0, 1.2], 8)]
    assert one(shifted).runs == (8, 9, 10, 11, 12, 13, 14, 15, *range(24, 32))


def test_missing_parts_keep_their_place():
    v = 0.5 * np.arange(20.0)
    v[[3, 11]] = np.nan
    term = one(v)
    assert abs(term.slope - 0.5) <= ROUNDING
    assert term.drifts
    assert abs(term.range_upper - 3.267 * 0.5) <= 1e-12  # a range across a gap would be 1


def test_constant_and_exact_lines():
    assert not one(np.full(10, 3.3)).drifts
    assert one(np.arange(10) * 1e-9 + 5.0).drifts
    found = part_series({"a": np.full(10, 1.0), "b": np.arange(10.0)})
    assert math.isnan(found.correlation[0, 1])


def test_terms_of_too_few_parts_are_named():
    v = np.full(12, np.nan)
    v[:3] = 1.0
    found = part_series({"few": v, "all": np.arange(12.0)})
    assert [t.name for t in found.terms] == ["all"]
    assert "few: only 3 parts" in found.messages[0]


@pytest.mark.parametrize(
    ("table", "error", "words"),
    [
        ({}, DataError, "no term"),
        ({"a": [1.0] * 4}, TooFewSamplesError, "4 parts"),
        ({"a": [1.0] * 6, "b": [1.0] * 7}, InvalidSamplesError, "b has shape"),
        ({"a": [1.0, 2.0, math.inf, 3.0, 4.0, 5.0]}, InvalidSamplesError, "part 3"),
        ({"a": [math.nan] * 8}, TooFewSamplesError, "no term"),
    ],
)
def test_bad_tables(table, error, words):
    with pytest.raises(error, match=words):
        part_series(table)


def test_bad_rate():
    with pytest.raises(DataError):
        part_series({"a": range(9)}, rate=0.0)


@pytest.mark.parametrize("n", [5, 8, 40, 400])
@pytest.mark.parametrize("factor", [1.0, -1.0, 3.0, -2.0])
def test_terms_that_are_multiples_of_one_another_say_the_same_without_a_warning(n, factor):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for seed in range(10):
            v = np.random.default_rng(seed).standard_normal(n)
            found = part_series({"a": v, "b": factor * v})
            assert abs(found.correlation[0, 1] - np.sign(factor)) <= 1e-12
            assert (found.same, found.correlated) == ((("a", "b"),), ())
