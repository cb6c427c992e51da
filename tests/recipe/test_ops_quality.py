"""Gauge studies and series of parts by recipe."""

import json

import numpy as np
import pytest

from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.parameters import gauge_study
from metrosep.recipe.recipe import Recipe
from metrosep.report import render_html

ROUNDING = 1e-15
"""Of readings in metres written with full digits."""

GAUGE = """metrosep = 1
[input]
files = ["study.csv"]
part = "part"
condition = "day"
value = "sz_nm"
[[step]]
op = "gauge_study"
tolerance = "500 nm"
[[check]]
metric = "share_of_tolerance"
upper = 0.3
U = 0.05
"""


def write_study(folder, readings, order=None):
    lines = [
        f"P{i},D{j},{readings[i, j, t]:.17g}"
        for i in range(readings.shape[0])
        for j in range(readings.shape[1])
        for t in range(readings.shape[2])
    ]
    if order is not None:
        lines = [lines[k] for k in order]
    (folder / "study.csv").write_text("\n".join(["part,day,sz_nm", *lines]) + "\n")


@pytest.fixture
def readings():
    rng = np.random.default_rng(21)
    parts = 90 * rng.standard_normal((8, 1, 1)) + 20 * rng.standard_normal((1, 3, 1))
    return 300 + parts + 6 * rng.standard_normal((8, 3, 2))


def test_recipe_gives_the_study_of_the_library(tmp_path, readings):
    write_study(tmp_path, readings)
    result = Recipe.parse(GAUGE, folder=tmp_path).run(out=tmp_path / "out")
    expected = gauge_study(readings * 1e-9, tolerance=500e-9)
    found = {c["metric"]: c for c in result.document["characteristics"]}
    for name in ("repeatability", "reproducibility", "gauge", "parts", "total"):
        assert abs(found[name]["value"] - getattr(expected, name).value) <= ROUNDING
        assert found[name]["unit"] == "m"
    assert abs(found["share_of_tolerance"]["value"] - expected.share_of_tolerance) <= 1e-9
    assert result.verdict in ("accept", "inconclusive", "reject")
    stored = json.loads((tmp_path / "out" / "result.json").read_text())
    assert stored["separation"]["anova"]["source"][0] == "parts"
    assert "Gauge study" in render_html(stored)


def test_rows_may_stand_in_any_order(tmp_path, readings):
    write_study(tmp_path, readings, np.random.default_rng(0).permutation(48))
    produced = Recipe.parse(GAUGE, folder=tmp_path).run().produced
    expected = gauge_study(readings * 1e-9)
    assert abs(produced.gauge.value - expected.gauge.value) <= ROUNDING


@pytest.mark.parametrize(
    ("left_out", "words"),
    [(1, "has 1 readings"), (2, "has no reading")],
)
def test_missing_readings_are_named(tmp_path, readings, left_out, words):
    write_study(tmp_path, readings)
    file = tmp_path / "study.csv"
    lines = file.read_text().splitlines()
    file.write_text("\n".join(lines[:-left_out]) + "\n")
    with pytest.raises(InvalidSamplesError, match=words):
        Recipe.parse(GAUGE, folder=tmp_path).run()


SERIES = """metrosep = 1
[input]
files = ["parts.csv"]
terms = ["z8_nm", "z9_nm"]
[[step]]
op = "part_series"
[[check]]
metric = "drift.z8"
upper = "10 nm"
"""


def test_series_by_recipe(tmp_path):
    rng = np.random.default_rng(2)
    n = 30
    z8, z9 = 1.5 * np.arange(n) + 3 * rng.standard_normal(n), 3 * rng.standard_normal(n)
    rows = [f"{i},{a:.9g},{b:.9g}" for i, (a, b) in enumerate(zip(z8, z9, strict=True))]
    (tmp_path / "parts.csv").write_text("\n".join(["part,z8_nm,z9_nm", *rows]) + "\n")
    result = Recipe.parse(SERIES, folder=tmp_path).run(out=tmp_path / "out")
    found = {c["metric"]: c for c in result.document["characteristics"]}
    slope = np.polyfit(np.arange(n), z8, 1)[0]
    assert abs(found["drift.z8"]["value"] - 29 * slope * 1e-9) <= 1e-15
    assert result.verdict == "reject"
    assert found["drifting"]["value"] == 1
    assert "Series of parts" in render_html(result.document)


def test_a_term_twice_is_refused(tmp_path):
    (tmp_path / "parts.csv").write_text("a_nm\n" + "1\n" * 9)
    text = SERIES.replace('["z8_nm", "z9_nm"]', '["a_nm", "a_nm"]').replace("drift.z8", "drift.a")
    with pytest.raises(DataError, match="twice"):
        Recipe.parse(text, folder=tmp_path).run()


def test_a_term_that_is_the_same_in_all_parts_is_accepted_and_an_identity_is_named(tmp_path):
    z9 = 3 * np.random.default_rng(2).standard_normal(30)
    rows = [f"{i},5,{b:.9g},{2 * b:.9g}" for i, b in enumerate(z9)]
    (tmp_path / "parts.csv").write_text("\n".join(["part,z8_nm,z9_nm,s_nm", *rows]) + "\n")
    text = SERIES.replace('"z9_nm"]', '"z9_nm", "s_nm"]')
    result = Recipe.parse(text, folder=tmp_path).run(out=tmp_path / "out")
    found = {c["metric"]: c for c in result.document["characteristics"]}
    assert result.verdict == "accept"
    assert found["drift.z8"]["value"] == 0.0
    assert found["drift.z8"]["definition"].endswith("the same in all parts to within rounding")
    assert result.document["separation"]["same"] == [["z9", "s"]]
    assert found["correlated"]["value"] == 0
    assert "Series of parts" in render_html(result.document)
