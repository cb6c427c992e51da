"""Recipes: every wrong key has a line, every quantity a unit, every result the same bytes."""

import json

import numpy as np
import pytest

from metrosep import Recipe
from metrosep.errors import (
    CorruptFileError,
    ReadError,
    RecipeError,
    SignCheckFailedError,
    UnsupportedFeatureError,
)
from metrosep.recipe.result import clean, load_document, measured_runs, stored_estimate
from metrosep.separation import ErrorEstimate, machine_axis

GOOD = """metrosep = 1
title = "test"

[input]
files = ["*.csv"]
x = { column = "x_mm", unit = "mm" }
z = "z_um"
feed = "feed_mm_min"
run = "run"

[[step]]
op = "separate"
start = "0 mm"
length = "30 mm"
method = "mean"

[[check]]
metric = "pv"
upper = "5 um"

[[output]]
kind = "table"
controller = "linuxcnc"
axis = "X"
spacing = "0.5 mm"
path = "x.comp"
compensates = "X"
machine = { travel_low = "0 mm", travel_high = "30 mm" }
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    axis = machine_axis(seed=5, length=30e-3)
    lines = ["run,feed_mm_min,x_mm,z_um"]
    for r in axis.runs:
        lines += [
            f"{r.run_id},{r.feed * 6e4:.0f},{x * 1e3:.4f},{z * 1e6:.5f}"
            for x, z in zip(r.x, r.z, strict=True)
        ]
    (folder / "runs.csv").write_text("\n".join(lines) + "\n")
    return folder


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            'op = "separate"',
            'op = "seperate"',
            r'r.toml:12: \[\[step\]\] needs op = one of "separate"',
        ),
        (
            'start = "0 mm"',
            'strat = "0 mm"',
            r'r.toml:13: unknown key "strat".*Did you mean "start"',
        ),
        (
            'length = "30 mm"',
            "length = 30",
            r"r.toml:14: length = 30: a length is written with its",
        ),
        (
            'length = "30 mm"',
            'length = "30 s"',
            r"r.toml:14: .*'s' is a time, but a length is needed",
        ),
        ('length = "30 mm"', 'length = "30"', r"r.toml:14: .*has no unit"),
        ("metrosep = 1", "metrosep = 2", "r.toml:1: metrosep = 2: this version reads recipes of"),
        ('metric = "pv"', 'metric = "Pt"', r"r.toml:18: metric = 'Pt' is not one of pv"),
        ('z = "z_um"', "", r'r.toml:4: \[input\] needs the key "z"'),
        ('axis = "X"', "axis = 1", "r.toml:24: axis = 1: a text is needed"),
        ("[[check]]", "[check]", r"write \[\[check\]\] with double brackets"),
        ('title = "test"', "title = ", "not valid TOML"),
        ('kind = "table"', 'kind = "picture"', r'r.toml:22: .*kind = one of "table", "report"'),
    ],
)
def test_wrong_recipes_name_the_line(old, new, message):
    with pytest.raises(RecipeError, match=message):
        Recipe.parse(GOOD.replace(old, new, 1), name="r.toml")


def test_missing_recipe_is_one_sentence(tmp_path):
    with pytest.raises(RecipeError, match="no such recipe"):
        Recipe.load(tmp_path / "none.toml")


def test_run_in_memory_writes_nothing(folder):
    before = sorted(folder.iterdir())

    result = Recipe.parse(GOOD).run(folder / "runs.csv")

    assert sorted(folder.iterdir()) == before
    assert result.verdict == "accept"
    assert result.document["table"]["verification"]["passed"] is True


def test_result_is_complete_and_last(folder, tmp_path):
    result = Recipe.parse(GOOD).run(folder, out=tmp_path)
    names = [f.name for f in result.files]
    document = json.loads((tmp_path / "result.json").read_text())

    assert names == ["x.comp", "x.comp.json", "result.json"]
    assert document["schema"] == "metrosep.result/1"
    assert document["inputs"][0]["name"] == "runs.csv"
    assert len(document["inputs"][0]["sha256"]) == 64
    assert document["recipe"]["text"] == GOOD
    assert document["table"]["n_points"] == 61
    assert "NaN" not in (tmp_path / "result.json").read_text()
    x = np.linspace(0, 30e-3, 50)
    back = ErrorEstimate.from_dict(document["estimate"])
    np.testing.assert_allclose(back.evaluate(x), result.estimate.evaluate(x), atol=1e-12, rtol=0)


def test_same_input_same_bytes(folder, tmp_path):
    for name in ("a", "b"):
        Recipe.parse(GOOD).run(folder, out=tmp_path / name)

    for file in ("result.json", "x.comp", "x.comp.json"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()


def test_second_run_replaces_its_own_files_only(folder, tmp_path):
    Recipe.parse(GOOD).run(folder, out=tmp_path)
    Recipe.parse(GOOD).run(folder, out=tmp_path)

    foreign = tmp_path / "other"
    foreign.mkdir()
    (foreign / "x.comp").write_text("mine")
    with pytest.raises(Exception, match="exists already"):
        Recipe.parse(GOOD).run(folder, out=foreign)
    assert (foreign / "x.comp").read_text() == "mine"


@pytest.mark.parametrize(
    ("upper", "U", "verdict"),
    [
        ("5 um", "1 um", "accept"),
        ("0.1 um", "10 nm", "reject"),
        ("1 um", "900 nm", "inconclusive"),
    ],
)
def test_three_verdicts(folder, upper, U, verdict):
    text = GOOD.replace('upper = "5 um"', f'upper = "{upper}"\nU = "{U}"')

    assert Recipe.parse(text).run(folder).verdict == verdict


def test_flipped_readings_are_not_noticed_but_a_flipped_table_is(folder, tmp_path, monkeypatch):
    """The dry-run uses the same readings; a table of the wrong sign must stop the run."""
    from metrosep.compensation import CompensationTable

    made = CompensationTable.from_error.__func__

    def flipped(cls, *args, **kwargs):
        return made(cls, *args, **kwargs).negated()

    monkeypatch.setattr(CompensationTable, "from_error", classmethod(flipped))
    with pytest.raises(SignCheckFailedError, match="the reversed sign would shrink it"):
        Recipe.parse(GOOD).run(folder, out=tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == []


def test_output_paths_stay_inside_the_folder(folder, tmp_path):
    text = GOOD.replace('path = "x.comp"', 'path = "../x.comp"')

    with pytest.raises(RecipeError, match="must be a plain file name"):
        Recipe.parse(text).run(folder, out=tmp_path / "out")
    assert not (tmp_path / "x.comp").exists()


def test_empty_folder_and_missing_inputs(tmp_path):
    with pytest.raises(ReadError, match=r"no file matches \*.csv"):
        Recipe.parse(GOOD).run(tmp_path)
    with pytest.raises(RecipeError, match="name the inputs"):
        Recipe.parse(GOOD.replace('files = ["*.csv"]\n', "")).run()


def test_batch_refuses_by_name_where_nothing_runs_it(folder, tmp_path, monkeypatch):
    monkeypatch.setattr("importlib.metadata.entry_points", lambda **_: ())
    with pytest.raises(UnsupportedFeatureError, match=r"metrosep\.runners"):
        Recipe.parse(GOOD).batch(folder, out=tmp_path)


def test_measured_runs_come_back_from_a_result(folder):
    result = Recipe.parse(GOOD).run(folder)

    runs = measured_runs(result.document)

    assert len(runs) == 9
    assert runs.common_travel[0] == pytest.approx(-3.75e-3, abs=1e-4)


def test_damaged_results_are_refused(tmp_path):
    (tmp_path / "result.json").write_text('{"schema": "other"}')
    with pytest.raises(CorruptFileError, match="not a result of metrosep"):
        load_document(tmp_path)
    (tmp_path / "result.json").write_text("{")
    with pytest.raises(CorruptFileError, match="not JSON"):
        load_document(tmp_path / "result.json")
    with pytest.raises(ReadError, match="no such file"):
        load_document(tmp_path / "none.json")


def test_json_has_no_nan():
    assert clean({"a": float("nan"), "b": (np.float64(1.5), float("inf"))}) == {
        "a": None,
        "b": [1.5, None],
    }


def test_machine_limits_need_units(folder, tmp_path):
    text = GOOD.replace("machine = { ", "machine = { stroke = 5, ")
    with pytest.raises(RecipeError, match="machine stroke = 5 needs a unit"):
        Recipe.parse(text).run(folder, out=tmp_path)

    text = text.replace("stroke = 5", 'stroke = "10 nm"')
    with pytest.raises(Exception, match="the stroke 10 nm"):
        Recipe.parse(text).run(folder, out=tmp_path)


@pytest.fixture(scope="module")
def stored(folder):
    return Recipe.parse(GOOD).run(folder).to_json()


@pytest.mark.parametrize(
    "damage",
    [
        pytest.param(lambda d: d.pop("runs"), id="no runs"),
        pytest.param(lambda d: d.update(runs=None), id="runs null"),
        pytest.param(lambda d: d.update(runs=[{"x_m": [1.0]}]), id="run incomplete"),
        pytest.param(lambda d: d.update(runs=[]), id="runs empty"),
        pytest.param(lambda d: d["runs"][0].update(z_m=[1.0, 2.0]), id="lengths differ"),
        pytest.param(lambda d: d["runs"][0].update(x_m=["a"]), id="no number"),
        pytest.param(lambda d: d["runs"][0].update(direction="reverse"), id="other direction"),
        pytest.param(lambda d: d.pop("estimate"), id="no estimate"),
        pytest.param(lambda d: d.update(estimate=None), id="estimate null"),
        pytest.param(lambda d: d["estimate"].update(start_m="x"), id="text for number"),
        pytest.param(lambda d: d["estimate"].pop("slope"), id="estimate incomplete"),
    ],
)
def test_parts_that_are_missing_in_a_result_are_named(stored, damage):
    document = json.loads(stored)
    damage(document)

    def use():
        return measured_runs(document), stored_estimate(document)

    with pytest.raises(CorruptFileError, match="run the separation again"):
        use()
