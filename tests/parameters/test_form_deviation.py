"""One function for all form deviations: what it accepts and what it returns."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from metrosep.core.errors import DataError
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.surface import Surface
from metrosep.parameters.deviation import flatness_deviation, form_deviation, roundness_deviation
from metrosep.parameters.straightness import straightness_deviation

CASES = [
    ("straightness", "MZ"),
    ("straightness", "LS"),
    ("straightness", "EP"),
    ("flatness", "MZ"),
    ("flatness", "LS"),
    ("roundness", "MZ"),
    ("roundness", "LS"),
    ("roundness", "MC"),
    ("roundness", "MI"),
]
SYMBOLS = {"straightness": "STR", "flatness": "FLT", "roundness": "RON"}


@pytest.fixture
def objects():
    rng = np.random.default_rng(6)
    history = (Step("read", {"file": "part.csv"}), Step("filter", {"cutoff_m": 8e-4}))
    return {
        "straightness": Profile(
            np.linspace(0, 1, 40), 1e-6 * rng.normal(size=40), metadata={"a": 1}, history=history
        ),
        "flatness": Surface(1e-6 * rng.normal(size=(9, 8)), dx=1e-3, dy=1e-3, history=history),
        "roundness": Profile(
            np.arange(36) * np.pi / 18, 1e-6 * rng.normal(size=36), history=history
        ),
    }


@pytest.mark.parametrize(("kind", "reference"), CASES)
def test_table_and_result_agree(objects, kind, reference):
    obj = objects[kind]
    result = form_deviation(obj, kind=kind, reference=reference)
    prefix = SYMBOLS[kind]
    assert list(result.table) == [prefix + s for s in "tpvq"]
    assert result.symbol == prefix + "t"
    total, peak, valley, rms = (result.table[prefix + s].value for s in "tpvq")
    assert result.value == total == result.quantity.value
    assert (result.unit, result.u) == ("m", None)
    assert peak + valley == pytest.approx(total, rel=1e-12, abs=0.0)
    assert 0 < rms < total
    left = result.residual.z
    assert float(np.ptp(left)) == pytest.approx(total, rel=1e-12, abs=0.0)
    assert float(left.max()) == pytest.approx(peak, rel=1e-9, abs=1e-18)
    assert float(np.sqrt(np.mean(left**2))) == pytest.approx(rms, rel=1e-9, abs=0.0)
    assert type(result.residual) is type(obj)
    assert result.residual.metadata == obj.metadata
    assert result.residual.history[:2] == obj.history
    assert result.residual.history[2].parameters["reference"] == reference
    assert "cutoff_m=0.0008" in result.table.context.chain
    json.dumps(result.to_dict())


@pytest.mark.parametrize(("kind", "reference"), CASES)
def test_reference_is_stated_in_each_definition(objects, kind, reference):
    words = {
        "MZ": "minimum zone", "LS": "least-squares", "EP": "end points",
        "MC": "minimum circumscribed", "MI": "maximum inscribed",
    }  # fmt: skip
    result = form_deviation(objects[kind], kind=kind, reference=reference)
    for quantity in result.table.values():
        assert words[reference] in quantity.definition
        assert "ISO" in quantity.definition
    assert result.table.context.settings["reference"] == reference


def test_default_is_the_minimum_zone(objects):
    for kind, obj in objects.items():
        assert form_deviation(obj, kind=kind).reference == "MZ"


@pytest.mark.parametrize("kind", list(SYMBOLS))
def test_no_reference_is_narrower_than_the_minimum_zone(objects, kind):
    least = form_deviation(objects[kind], kind=kind).value
    for other_kind, reference in CASES:
        if other_kind == kind and reference != "MZ":
            assert form_deviation(objects[kind], kind=kind, reference=reference).value > least


def test_special_cases_of_the_three_functions(objects):
    line, plane, round_ = (objects[k] for k in SYMBOLS)
    assert (
        form_deviation(line, kind="straightness", normal=True).value
        == straightness_deviation(line, normal=True).value
    )
    assert form_deviation(plane, kind="flatness").value == flatness_deviation(plane).value
    assert (
        form_deviation(round_, kind="roundness", exact=True, radius=1e-2).value
        == roundness_deviation(round_, exact=True, radius=1e-2).value
    )


def test_result_is_frozen(objects):
    result = form_deviation(objects["straightness"], kind="straightness")
    with pytest.raises(dataclasses.FrozenInstanceError):
        result.kind = "flatness"


def test_representation_says_value_and_reference(objects):
    assert "MZ, proven" in repr(form_deviation(objects["flatness"], kind="flatness"))
    least_squares = form_deviation(objects["flatness"], kind="flatness", reference="LS")
    assert "LS)" in repr(least_squares)
    assert not least_squares.is_optimal


@pytest.mark.parametrize(
    ("kind", "of", "options", "message"),
    [
        ("cylindricity", "roundness", {}, "straightness, flatness, roundness"),
        ("flatness", "straightness", {}, "needs a Surface"),
        ("straightness", "flatness", {}, "needs a Profile"),
        ("roundness", "flatness", {}, "needs a Profile"),
        ("flatness", "flatness", {"normal": True}, "no option normal"),
        ("straightness", "straightness", {"exact": True}, "no option exact"),
        ("straightness", "straightness", {"radius": 1.0}, "no option radius"),
        ("roundness", "roundness", {"normal": True}, "no option normal"),
        ("flatness", "flatness", {"reference": "EP"}, "one of MZ, LS"),
        ("straightness", "straightness", {"reference": "MC"}, "MZ, LS and EP"),
        ("roundness", "roundness", {"reference": "EP"}, "one of MZ, LS, MC, MI"),
    ],
)
def test_what_does_not_belong_is_refused(objects, kind, of, options, message):
    with pytest.raises(DataError, match=message):
        form_deviation(objects[of], kind=kind, **options)
