"""Outputs appear together or not at all, and several tables are all accounted for."""

import json

import pytest

from metrosep import Recipe
from metrosep.errors import RecipeError, TableError, WriteError
from metrosep.recipe.outputs import staged
from metrosep.separation import machine_axis

GOOD = """metrosep = 1
[input]
x = "x_mm"
z = "z_um"
feed = "feed_mm_min"
run = "run"
[[step]]
op = "separate"
method = "mean"
start = "0 mm"
length = "30 mm"
[[output]]
kind = "table"
controller = "linuxcnc"
axis = "X"
spacing = "0.5 mm"
path = "x.comp"
compensates = "X"
machine = { travel_low = "0 mm", travel_high = "30 mm" }
[[output]]
kind = "report"
"""


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    path = tmp_path_factory.mktemp("runs") / "runs.csv"
    lines = ["run,feed_mm_min,x_mm,z_um"]
    for r in machine_axis(seed=5, length=30e-3).runs:
        lines += [
            f"{r.run_id},{r.feed * 6e4:.0f},{x * 1e3:.4f},{z * 1e6:.5f}"
            for x, z in zip(r.x, r.z, strict=True)
        ]
    path.write_text("\n".join(lines) + "\n")
    return path


def test_a_failing_report_leaves_nothing(runs, tmp_path, monkeypatch):
    def full(document, path):
        path.write_bytes(b"<html>half")
        raise WriteError(f"{path}: cannot be written (No space left on device)")

    monkeypatch.setattr("metrosep.report.html.write_html", full)
    with pytest.raises(WriteError, match="cannot be written") as caught:
        Recipe.parse(GOOD).run(runs, out=tmp_path / "out")

    assert str(caught.value).startswith(str(tmp_path / "out" / "report.html"))
    assert list(tmp_path.iterdir()) == []


def test_a_failing_second_run_leaves_the_first_whole(runs, tmp_path, monkeypatch):
    Recipe.parse(GOOD).run(runs, out=tmp_path)
    before = {f.name: f.read_bytes() for f in tmp_path.iterdir()}

    def interrupted(document, path):
        raise KeyboardInterrupt

    monkeypatch.setattr("metrosep.report.html.write_html", interrupted)
    with pytest.raises(KeyboardInterrupt):
        Recipe.parse(GOOD.replace("0.5 mm", "1 mm")).run(runs, out=tmp_path, overwrite=True)

    assert {f.name: f.read_bytes() for f in tmp_path.iterdir()} == before
    assert set(before) == {"x.comp", "x.comp.json", "report.html", "result.json"}


def test_a_check_without_uncertainty_leaves_no_table(runs, tmp_path):
    text = GOOD + '[[check]]\nmetric = "residual_rms"\nupper = "1 um"\n'

    with pytest.raises(RecipeError, match=r"r.toml:23: .*residual_rms.* state it"):
        Recipe.parse(text, name="r.toml").run(runs, out=tmp_path / "out")

    assert not (tmp_path / "out").exists()


def test_an_old_result_is_gone_when_its_folder_is_only_half_renewed(tmp_path, monkeypatch):
    (tmp_path / "result.json").write_text("old")
    (tmp_path / "x.comp").mkdir()  # cannot be replaced by a file

    def renew():
        with staged(tmp_path) as stage:
            (stage / "x.comp").write_text("new")
            (stage / "result.json").write_text("new")

    with pytest.raises(WriteError, match=r"x\.comp: cannot be replaced"):
        renew()

    assert [f.name for f in tmp_path.iterdir()] == ["x.comp"]


def test_every_table_is_in_the_document(runs, tmp_path):
    other = '[[output]]\nkind = "table"\ncontroller = "csv"\naxis = "X"\ncompensates = "X"\nspacing = "1 mm"\npath = "y.csv"\nmachine = { travel_low = "0 mm", travel_high = "30 mm" }\n'

    result = Recipe.parse(GOOD + other).run(runs, out=tmp_path)
    document = json.loads((tmp_path / "result.json").read_text())

    assert document["table"]["path"] == "x.comp"
    assert [t["path"] for t in document["more_tables"]] == ["y.csv"]
    assert "2 tables were made (x.comp, y.csv)" in document["messages"][-1]
    assert [f.name for f in result.files] == [
        "x.comp", "x.comp.json", "y.csv", "y.csv.json", "report.html", "result.json",
    ]  # fmt: skip
    assert all(f.is_file() for f in result.files)


def test_limits_are_judged_on_the_worst_table(runs):
    coarse = '[[output]]\nkind = "table"\ncontroller = "csv"\naxis = "X"\ncompensates = "X"\nspacing = "2.5 mm"\npath = "y.csv"\nmachine = { travel_low = "0 mm", travel_high = "30 mm" }\n'

    def after(text):
        document = Recipe.parse(text).run(runs).document
        return next(c["value"] for c in document["characteristics"] if c["metric"] == "after_rms")

    alone = after(GOOD.replace('"0.5 mm"', '"2.5 mm"'))
    assert after(GOOD + coarse) == pytest.approx(alone, abs=1e-15)  # the last digits of two files
    assert after(GOOD + coarse) > 1.1 * after(GOOD)


def test_a_spacing_of_atoms_is_refused_at_once(runs):
    with pytest.raises(TableError, match=r"3e\+07 entries, at most 100000.*coarser"):
        Recipe.parse(GOOD.replace('"0.5 mm"', '"1 nm"')).run(runs)


def test_files_are_named_relative_as_the_folder_was(runs, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    result = Recipe.parse(GOOD).run(runs, out="out")

    assert [str(f) for f in result.files][-1] == "out/result.json"
    assert all(not f.is_absolute() for f in result.files)
