"""Reports made again from what a batch kept are the bytes that the batch wrote."""

import pytest

from metrosep.batch import run_batch
from metrosep.cli.main import main
from metrosep.recipe import Recipe
from metrosep.recipe.run import run_recipe

FORMATS = ("html", "xlsx", "csv", "dfq", "parquet", "pdf")
GROUPS = r"""
[batch]
pattern = '(?P<shift>[a-z]+)/(?P<part>[A-Z])_(?P<serial>\d+)\.[a-z0-9]+'
key = ["part", "serial", "shift"]
"""


def outputs(formats):
    listed = ", ".join(f'"{f}"' for f in formats)
    return f'[[output]]\nkind = "report"\nformats = [{listed}]\n'


@pytest.mark.slow
def test_reports_of_a_batch_are_the_same_bytes_again(recipe_text, inbox, tmp_path, capsys):
    pytest.importorskip("typst")
    recipe = Recipe.parse(recipe_text + outputs(FORMATS) + GROUPS)
    report = run_batch(recipe, inbox, out=tmp_path / "qa", scheduler="serial")
    row = next(r for r in report.rows if r["status"] == "accepted")
    folder = (tmp_path / "qa" / row["link"]).parent

    with pytest.raises(SystemExit) as end:
        main(["report", str(folder), "--format", ",".join(FORMATS), "-o", str(tmp_path / "r")])

    assert end.value.code == 0, capsys.readouterr().err
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert f"{row['unit']}</td>" in page
    assert "Serial" in page
    for name in FORMATS:
        first, again = (p / f"report.{name}" for p in (folder, tmp_path / "r"))
        assert first.read_bytes() == again.read_bytes(), name


RUNS = """metrosep = 1
[input]
files = ["run*.csv"]
x = { column = "X", unit = "mm" }
z = { column = "Z", unit = "nm" }
[[step]]
op = "separate"
method = "mean"
"""


@pytest.fixture
def sets(tmp_path):
    """Two sets of three runs: a separation takes another way through the recipe than a map."""
    for name, gain in (("s1", 10), ("s2", 20)):
        for n in (1, 2, 3):
            rows = "".join(f"{i * 0.1:.1f},{gain * (i % 7) + n}\n" for i in range(200))
            (tmp_path / "in" / name).mkdir(parents=True, exist_ok=True)
            (tmp_path / "in" / name / f"run{n}.csv").write_text("X,Z\n" + rows)
    return tmp_path / "in"


@pytest.mark.parametrize("formats", [("html", "csv")])
def test_reports_of_sets_of_runs_too(sets, tmp_path, capsys, formats):
    report = run_batch(
        Recipe.parse(RUNS + outputs(formats)), sets, out=tmp_path / "qa", scheduler="serial"
    )
    folder = (tmp_path / "qa" / report.rows[1]["link"]).parent

    with pytest.raises(SystemExit) as end:
        main(["report", str(folder), "--format", ",".join(formats), "-o", str(tmp_path / "r")])

    assert end.value.code == 0, capsys.readouterr().err
    for name in formats:
        first, again = (p / f"report.{name}" for p in (folder, tmp_path / "r"))
        assert first.read_bytes() == again.read_bytes(), name


@pytest.mark.parametrize("out", [None, "o"])
def test_more_of_the_document_is_in_the_result(sets, tmp_path, out):
    place = None if out is None else tmp_path / out
    more = {"unit": {"name": "x"}}

    done = run_recipe(Recipe.parse(RUNS), sets / "s1", out=place, progress=None, more=more)

    assert done.document["unit"] == {"name": "x"}


def test_a_batch_that_is_resumed_does_not_keep_the_fields_of_another_report(
    recipe_text, inbox, tmp_path
):
    def persons(name):
        recipe = Recipe.parse(recipe_text, report=[f"persons.measured={name}"])
        report = run_batch(recipe, inbox, out=tmp_path / "qa", scheduler="serial")
        row = next(r for r in report.rows if r["status"] == "accepted")
        kept = (tmp_path / "qa" / row["link"]).read_text(encoding="utf-8")
        return row["skipped"], [n for n in ("Ann", "Eve") if n in kept]

    assert persons("Ann") == (False, ["Ann"])
    assert persons("Ann") == (True, ["Ann"])
    assert persons("Eve") == (False, ["Eve"])
