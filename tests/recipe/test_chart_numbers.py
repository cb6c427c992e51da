"""Numbers of charts and documents: rounded all at once as one by one, and nothing but JSON knows."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from metrosep.recipe.describe.charts import plain
from metrosep.recipe.result import clean


def one_by_one(value, digits):
    return [
        None if not math.isfinite(v) else float(f"{v:.{digits}g}") for v in value.ravel().tolist()
    ]


@pytest.mark.parametrize("digits", [4, 6])
@pytest.mark.parametrize("exponent", range(-30, 13, 3))
def test_maps_are_rounded_as_the_numbers_one_by_one(digits, exponent):
    values = np.random.default_rng(exponent + 40).standard_normal((40, 41)) * 10.0**exponent
    values[3, 4], values[5, 5], values[5, 6], values[6, 6] = np.nan, np.inf, -np.inf, 0.0
    found = plain(values, digits=digits)
    assert [len(row) for row in found] == [41] * 40
    assert [v for row in found for v in row] == one_by_one(values, digits)
    json.dumps(found, allow_nan=False)


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (1.2345678e-9, 1.23457e-9),
        (math.nan, None),
        (0.0, 0.0),
        (123456789.0, 123457000.0),
        (5e-324, 5e-324),
        ([], []),
        ([[]], [[]]),
        ([1, 2], [1.0, 2.0]),
        ([math.nan], [None]),
    ],
)
def test_single_numbers_and_empty_lists(value, expected):
    assert plain(value) == expected


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        ([1.0, math.nan, 2.0], [1.0, None, 2.0]),
        ([math.inf, -math.inf], [None, None]),
        ([1e308, 1e308], [1e308, 1e308]),  # their sum is not a float
        ((1.0, 2, "x"), [1.0, 2, "x"]),
        ([True, 1.0], [True, 1.0]),
        ([np.float64(1.5), np.float64("nan")], [1.5, None]),
        ([], []),
        ({"a": (math.nan,)}, {"a": [None]}),
    ],
)
def test_documents_hold_what_json_knows(value, expected):
    found = clean(value)
    assert found == expected
    json.dumps(found, allow_nan=False)
