"""A document as text: byte for byte what json.dumps gives."""

from __future__ import annotations

import json

import numpy as np
import pytest

from metrosep.recipe.describe.charts import plain
from metrosep.recipe.result import document_text


def plainly(document):
    return json.dumps(document, sort_keys=True, allow_nan=False, separators=(",", ":"))


def holed(shape, scale, *, seed=0):
    values = scale * np.random.default_rng(seed).standard_normal(shape)
    values.flat[::7] = np.nan
    return values


DOCUMENTS = {
    "a map with holes": {"z": plain(holed((90, 70), 1e-8), digits=4), "a": 1, "é": "µm\n"},
    "whole maps of many scales": {
        str(s): plain(s * np.random.default_rng(3).standard_normal((64, 64)), digits=4)
        for s in (1e-25, 1e-18, 1e-9, 1e-3, 1.0, 1e3, 1e5, 1e17)
    },
    "many digits": {"z": np.random.default_rng(4).standard_normal(3000).tolist()},
    "zeros of both signs": {"z": [0.0, -0.0, 5.0, -5e-324, 1e308] * 400},
    "whole numbers and floats": {"z": list(range(400)) + [1.5] * 400, "y": [1.0, 2] * 300},
    "truth and none": {"z": [True, None, 1.0] * 200, "y": [None] * 500, "x": [[]] * 300},
    "ragged rows": {"z": [[1e-9] * 300, [2e-9] * 299, [], [None]]},
    "rows of none": {"z": [[None] * 40] * 40},
    "nested": {"a": [{"b": [[1.25e-9, None] * 200] * 3, "c": ({"d": (1.5,) * 300},)}]},
    "a text like a mark": {"z": [1.5] * 300, "a": "\0numbers 0\0", "b": "numbers 1"},
    "empty": {},
}


@pytest.mark.parametrize("name", DOCUMENTS)
def test_the_bytes_are_those_of_json(name):
    assert document_text(DOCUMENTS[name]) == plainly(DOCUMENTS[name])


def test_each_number_of_four_digits_is_written_as_python_writes_it():
    mantissa = np.arange(1, 10_000)
    for k in (-30, -22, -12, -9, -4, 0, 1, 5, 15):
        numbers = [float(f"{m}e{k}") for m in mantissa.tolist()]
        document = {"z": numbers + [-v for v in numbers]}
        assert document_text(document) == plainly(document)


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -float("inf")])
def test_what_json_does_not_know_is_refused(bad):
    for place in ([1.5] * 300 + [bad], [[1.5] * 300, [bad] * 300], [bad]):
        with pytest.raises(ValueError, match="not JSON compliant"):
            document_text({"z": place})
