"""Named separations from a recipe: same numbers as the call, verdicts, parts, refusals with lines."""

import csv
import json

import numpy as np
import pytest

import metrosep as ms
from metrosep.core.errors import InvalidSamplesError, MetrosepError, RecipeError
from metrosep.core.methods import METHODS
from metrosep.recipe.result import load_document
from metrosep.separation import donaldson
from metrosep.separation.contract import Separation

N = 36
ANGLE = 2 * np.pi * np.arange(N) / N
BALL, SPINDLE = 50.0 * np.cos(3 * ANGLE + 0.3), 20.0 * np.sin(2 * ANGLE)

RECIPE = """metrosep = 1
[input]
readings = ["m1_nm", "m2_nm"]
angle = "angle_deg"
[[step]]
op = "donaldson"
u_reading = "1 nm"
u_index = "0.1 deg"
"""

TEXT_NM = 1e-6
"""Readings are written with 6 decimals of a nm."""


@pytest.fixture
def readings(tmp_path):
    file = tmp_path / "m.csv"
    rows = [
        f"{np.degrees(a):.9f},{b + s:.6f},{b - s:.6f}"
        for a, b, s in zip(ANGLE, BALL, SPINDLE, strict=True)
    ]
    file.write_text("\n".join(["angle_deg,m1_nm,m2_nm", *rows]) + "\n", "ascii")
    return file


def test_recipe_gives_what_the_call_gives(readings):
    result = ms.Recipe.parse(RECIPE).run(readings)

    called = donaldson(
        (BALL + SPINDLE) * 1e-9,
        (BALL - SPINDLE) * 1e-9,
        u_reading=1e-9,
        u_index=np.radians(0.1),
    )
    for part in ("artefact", "spindle"):
        np.testing.assert_allclose(
            result.produced.parts[part], called.parts[part], rtol=0.0, atol=TEXT_NM * 1e-9
        )
        np.testing.assert_allclose(result.produced.u[part], called.u[part], rtol=1e-6)
    assert result.document["verdict"] is None
    assert result.document["inputs"][0]["name"] == "m.csv"


def test_document_is_readable_again_and_holds_the_parts(readings, tmp_path):
    text = RECIPE + '[[output]]\nkind = "parts"\n[[output]]\nkind = "report"\n'
    result = ms.Recipe.parse(text).run(readings, out=tmp_path / "out")

    assert [f.name for f in result.files] == ["parts.csv", "report.html", "result.json"]
    document = load_document(tmp_path / "out")
    again = Separation.from_dict(document["separation"])
    np.testing.assert_array_equal(again.spindle, result.produced.spindle)
    with (tmp_path / "out" / "parts.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert float(rows[5]["spindle_m"]) == result.produced.spindle[5]
    assert float(rows[5]["angle_rad"]) == pytest.approx(ANGLE[5], abs=1e-12)
    page = (tmp_path / "out" / "report.html").read_text("utf-8")
    assert "eccentricity" in page
    assert "Parts of the readings" in page


@pytest.mark.parametrize(
    ("limit", "verdict"), [("50 nm", "accept"), ("30 nm", "reject"), ("40.5 nm", "inconclusive")]
)
def test_limits_are_judged_with_the_uncertainty(readings, limit, verdict):
    check = f'[[check]]\nmetric = "spindle.pv"\nupper = "{limit}"\n'
    result = ms.Recipe.parse(RECIPE + check).run(readings)

    assert result.verdict == verdict
    pv = next(c for c in result.document["characteristics"] if c["metric"] == "spindle.pv")
    assert pv["value"] == pytest.approx(np.ptp(SPINDLE) * 1e-9, abs=TEXT_NM * 1e-9)
    assert pv["U"] == pytest.approx(2 * pv["u"], abs=1e-18)


def test_unknown_uncertainty_must_be_stated(readings):
    text = RECIPE.replace('u_reading = "1 nm"\n', "")
    check = '[[check]]\nmetric = "spindle.pv"\nupper = "50 nm"\n'
    result = ms.Recipe.parse(text + check).run(readings)
    assert result.verdict == "inconclusive"
    assert any("state it: U" in str(c.get("reason")) for c in result.document["characteristics"])

    assert ms.Recipe.parse(text + check + 'U = "5 nm"\n').run(readings).verdict == "accept"


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (('op = "donaldson"', 'op = "donaldsen"'), "donaldson"),
        (('u_index = "0.1 deg"', 'u_index = "0.1 mm"'), ":8.*angle"),
        (('u_index = "0.1 deg"', 'u_indx = "0.1 deg"'), "u_index"),
        (('u_index = "0.1 deg"', "u_index = 0.1"), "unit in quotes"),
        (('angle = "angle_deg"', 'z = "m1_nm"'), 'unknown key "z"'),
        (('readings = ["m1_nm", "m2_nm"]', ""), "readings"),
        (('angle = "angle_deg"', 'x = "angle_deg"'), ':4: unknown key "x".*known:.*angle'),
    ],
)
def test_wrong_recipes_are_refused_with_their_line(change, match):
    with pytest.raises(RecipeError, match=match):
        ms.Recipe.parse(RECIPE.replace(*change))


def test_two_separations_and_unknown_metrics_are_refused(readings):
    with pytest.raises(RecipeError, match="exactly one"):
        ms.Recipe.parse(RECIPE + '[[step]]\nop = "donaldson"\n')
    check = '[[check]]\nmetric = "spindel.pv"\nupper = "50 nm"\n'
    with pytest.raises(RecipeError, match=r"spindle\.pv"):
        ms.Recipe.parse(RECIPE + check).run(readings)


def test_nothing_is_left_of_a_run_that_fails(readings, tmp_path):
    text = RECIPE.replace('"m1_nm", "m2_nm"', '"m1_nm"') + '[[output]]\nkind = "parts"\n'
    with pytest.raises(InvalidSamplesError, match="2 readings are needed"):
        ms.Recipe.parse(text).run(readings, out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_more_readings_than_the_method_has_are_refused(readings):
    text = RECIPE.replace('"m1_nm", "m2_nm"', '"m1_nm", "m2_nm", "m1_nm"')
    with pytest.raises(InvalidSamplesError, match="2 readings are read"):
        ms.Recipe.parse(text).run(readings)


def test_angles_are_demanded_and_must_close_the_turn(readings, tmp_path):
    with pytest.raises(MetrosepError, match="name its column"):
        ms.Recipe.parse(RECIPE.replace('angle = "angle_deg"\n', "")).run(readings)
    half = tmp_path / "half.csv"
    half.write_text("\n".join(readings.read_text().splitlines()[: N // 2]) + "\n", "ascii")
    with pytest.raises(InvalidSamplesError, match="one revolution"):
        ms.Recipe.parse(RECIPE).run(half)


def test_every_method_says_what_it_is_and_has_a_step():
    for name, method in METHODS.items():
        assert len(method.what) > 20, name
        assert method.fields["op"].required, name


def test_same_input_same_bytes(readings, tmp_path):
    for folder in ("a", "b"):
        ms.Recipe.parse(RECIPE).run(readings, out=tmp_path / folder)
    first, second = ((tmp_path / f / "result.json").read_bytes() for f in ("a", "b"))
    assert first == second
    json.loads(first)


def test_angle_of_the_first_sample_is_that_of_the_file(tmp_path):
    """A file that starts at 30 degrees: phase and parts are over the angles of the file."""
    start = np.radians(30.0)
    file = tmp_path / "late.csv"
    rows = [
        f"{np.degrees(a):.9f},{50 * np.cos(3 * a):.6f},{50 * np.cos(3 * a):.6f}"
        for a in ANGLE + start
    ]
    file.write_text("\n".join(["angle_deg,m1_nm,m2_nm", *rows]) + "\n", "ascii")

    found = ms.Recipe.parse(RECIPE).run(file).produced

    assert found.coordinates["angle"][0] == pytest.approx(start, abs=1e-9)
    assert abs(found.harmonics["artefact"][3] - 50e-9) < 1e-14


def test_limit_without_a_unit_names_the_units_of_a_limit():
    check = '[[check]]\nmetric = "spindle.pv"\nupper = "120"\n'
    with pytest.raises(RecipeError, match='such as "120 nm"'):
        ms.Recipe.parse(RECIPE + check)


def test_an_error_is_not_taken_from_another_separation(readings, tmp_path):
    from metrosep.core.errors import DataError
    from metrosep.recipe.result import stored_estimate

    ms.Recipe.parse(RECIPE).run(readings, out=tmp_path / "out")
    with pytest.raises(DataError, match="result of donaldson"):
        stored_estimate(load_document(tmp_path / "out"))
