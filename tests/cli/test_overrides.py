"""``-s key=value`` of run, batch and check."""

from __future__ import annotations

import json

import numpy as np
import pytest

import metrosep as ms
from metrosep.cli.main import main
from metrosep.recipe.outputs import recipe_hash

RECIPE = """metrosep = 1
title = "lens"
[input]
files = ["*.x3p"]
[[step]]
op = "form"
form = "plane"
[[step]]
op = "parameters"
names = ["Sa"]
[[check]]
name = "roughness"
metric = "Sa"
upper = "5 nm"
U = "1 nm"
[batch]
trend = ["roughness"]
"""


@pytest.fixture
def home(tmp_path, monkeypatch):
    (tmp_path / "in").mkdir()
    y, x = np.mgrid[0:20, 0:24] * 1e-6
    for k, name in enumerate("ab"):
        z = (20 + k) * x**2 + 9.0 * y**2 + 3e-4 * x
        ms.write(ms.Surface(z, 1e-6, 1e-6), tmp_path / "in" / f"{name}.x3p")
    (tmp_path / "r.toml").write_text(RECIPE)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def call(*words):
    with pytest.raises(SystemExit) as end:
        main(list(words))
    return end.value.code


def result(folder):
    return json.loads((folder / "result.json").read_text())


def test_run_does_what_the_edited_recipe_does(home):
    sphere = ("-s", "step.form.form=sphere", "-s", "check.roughness.upper=12 nm")
    assert call("run", "r.toml", "in/a.x3p", "-o", "one", *sphere) == 0
    edited = RECIPE.replace("plane", "sphere").replace("5 nm", "12 nm")
    (home / "r.toml").write_text(edited)
    assert call("run", "r.toml", "in/a.x3p", "-o", "two") == 0
    one, two = result(home / "one"), result(home / "two")
    assert one["recipe"].pop("overrides") == [
        "step.form.form=sphere",
        "check.roughness.upper=12 nm",
    ]
    recipes = [r.pop("recipe") for r in (one, two)]
    assert one == two
    hashes = {recipe_hash(ms.Recipe.parse(r["text"])) for r in recipes}
    assert hashes == {recipe_hash(ms.Recipe.parse(edited))}
    assert 'form = "sphere"  # set by -s step.form.form=sphere' in recipes[0]["text"]
    assert recipes[1]["text"] == edited


def test_run_without_it_records_the_recipe_as_it_is(home):
    assert call("run", "r.toml", "in/a.x3p", "-o", "out") in (0, 1, 3)
    recipe = result(home / "out")["recipe"]
    assert set(recipe) == {"name", "sha256", "text"}
    assert recipe["text"] == RECIPE


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ("-s", "step.form.fom=plane"),
            'error: -s step.form.fom=plane: unknown key "fom" in step 1 (form); known: op, form, free',
        ),
        (
            ("-s", "title=x", "-s", "title=y"),
            "error: -s title=y: -s title=x sets it too; leave one of them out",
        ),
        (("-s", "step.form.tilt=plan"), "error: r.toml, -s step.form.tilt=plan: tilt = 'plan' is"),
        (
            ("-s", "check.1.upper=3 urad"),
            "error: r.toml, -s check.1.upper=3 urad: upper is an angle",
        ),
    ],
)
@pytest.mark.parametrize("verb", ["run", "batch", "check"])
def test_a_wrong_override_ends_each_of_them_with_2(home, capsys, verb, words, message):
    places = {"run": ("in/a.x3p", "-o", "out"), "batch": ("in", "-o", "out"), "check": ()}
    assert call(verb, "r.toml", *places[verb], *words) == 2
    out, err = capsys.readouterr()
    first = (out if verb == "check" else err).splitlines()[0]
    assert first.startswith(message)
    assert not (home / "out").exists()


def test_the_nearest_key_is_proposed(home, capsys):
    assert call("run", "r.toml", "in/a.x3p", "-o", "out", "-s", "step.form.fom=plane") == 2
    assert (
        capsys.readouterr()
        .err.rstrip()
        .endswith('direction, centre, enabled. Did you mean "form"?')
    )


def test_check_tells_a_wrong_override_beside_the_mistakes_of_the_recipe(home, capsys):
    (home / "r.toml").write_text(RECIPE.replace("names", "nams"))
    assert call("check", "r.toml", "-s", "step.2.enabled=no", "-s", "title=x") == 2
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("error: r.toml:10: unknown key")
    assert lines[1].startswith("error: r.toml, -s step.2.enabled=no: enabled = 'no'")
    assert call("check", "r.toml", "-s", "step.2=no") == 2
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("error: -s step.2=no: this is all of step 2")
    assert lines[1].startswith("error: r.toml:10: unknown key")
    assert call("check", "r.toml", "--json", "-s", "step.1.robust=huber") == 2
    (error,) = json.loads(capsys.readouterr().out)["errors"]
    assert error.startswith("r.toml:10: unknown key")


def test_check_accepts_a_right_one_and_refuses_it_for_data(home, capsys):
    assert call("check", "r.toml", "-s", "step.form.robust=huber") == 0
    assert capsys.readouterr().out == "r.toml: nothing wrong\n"
    assert call("check", "in/a.x3p", "-s", "title=x") == 2
    assert "-s is for recipes (.toml)" in capsys.readouterr().err


@pytest.mark.parametrize(
    "scheduler", ["serial", pytest.param("processes", marks=pytest.mark.slow)]
)
def test_batches_with_and_without_it_keep_apart_and_resume(home, scheduler):
    common = (
        "batch",
        "r.toml",
        "in",
        "-o",
        "qa",
        "--workers",
        "1",
        "--scheduler",
        scheduler,
        "-q",
    )
    sphere = (*common, "-s", "step.form.form=sphere")
    call(*common)
    call(*sphere)
    files = {f: f.stat().st_mtime_ns for f in sorted((home / "qa").glob("*/*/result.json"))}
    assert len(files) == 4
    given = [json.loads(f.read_text())["recipe"].get("overrides") for f in files]
    assert sorted(given, key=str) == [None, None, *[["step.form.form=sphere"]] * 2]
    call(*common)
    call(*sphere)
    again = {f: f.stat().st_mtime_ns for f in sorted((home / "qa").glob("*/*/result.json"))}
    assert again == files
    # by hand it is the same meaning: nothing is done again
    (home / "r.toml").write_text(RECIPE.replace("plane", "sphere"))
    call(*common)
    again = {f: f.stat().st_mtime_ns for f in sorted((home / "qa").glob("*/*/result.json"))}
    assert again == files


def test_batch_takes_keys_of_its_own_table(home):
    words = ("-s", r"batch.pattern=(?P<part>[a-z])[.]x3p", "-s", "batch.trend=Sa")
    call("batch", "r.toml", "in", "-o", "qa", "--scheduler", "serial", "-q", *words)
    assert sorted(f.name for f in (home / "qa").iterdir() if f.is_dir()) == ["a", "b"]


def test_help_names_it(capsys):
    for verb in ("run", "batch", "check"):
        assert call(verb, "--help") == 0
        assert "-s KEY=VALUE" in capsys.readouterr().out


@pytest.mark.parametrize("by_hand", [False, True])
def test_a_batch_tells_of_results_that_keep_a_former_title(home, capsys, by_hand):
    common = ("batch", "r.toml", "in", "-o", "qa", "--scheduler", "serial")
    call(*common)
    assert "former" not in capsys.readouterr().err
    new = () if by_hand else ("-s", "title=NEW")
    if by_hand:
        (home / "r.toml").write_text(RECIPE.replace('"lens"', '"NEW"'))
    told = (
        'note: 2 result(s) were done before the title was changed and keep the former one ("lens") '
        "in result.json and their reports; --fresh does them again with the new one"
    )
    for extra in ((), ("--dry-run",)):
        call(*common, *new, *extra)
        assert told in capsys.readouterr().err.splitlines()
    rows = json.loads((home / "qa" / "index.json").read_text())["rows"]
    assert [r["former_title"] for r in rows] == ["lens", "lens"]
    call(*common, *new, "--fresh")
    call(*common, *new)
    assert "former" not in capsys.readouterr().err
    titles = {result(f.parent)["title"] for f in (home / "qa").glob("*/*/result.json")}
    assert titles == {"NEW"}
    index = json.loads((home / "qa" / "index.json").read_text())
    assert not any("former_title" in r for r in index["rows"])


def test_a_batch_tells_of_a_title_that_was_taken_out(home, capsys):
    common = ("batch", "r.toml", "in", "-o", "qa", "--scheduler", "serial")
    (home / "r.toml").write_text(RECIPE.replace('title = "lens"\n', ""))
    call(*common)
    call(*common)
    assert "former" not in capsys.readouterr().err
    call(*common, "-s", "title=x")
    assert "keep the former one (none)" in capsys.readouterr().err


def test_a_value_beyond_all_measure_ends_with_2(home, capsys):
    for value in ("title=" + "7" * 5000, "step.form.fix=" + "[" * 3000):
        assert call("run", "r.toml", "in/a.x3p", "-o", "out", "-s", value) == 2
        assert "the value cannot be read" in capsys.readouterr().err
