"""What a hostile reviewer did to a batch: companions, contradictions, odd files, repeated errors."""

from __future__ import annotations

import errno
import json
import os
import threading
import time

import numpy as np
import pytest

from metrosep.batch import run_batch, work
from metrosep.batch.units import Unit, files_read
from metrosep.batch.work import WorkerDiedError, as_reason, exit_code_of, worth_another_try
from metrosep.core.errors import RecipeError
from metrosep.recipe import Recipe
from metrosep.recipe.run import run_recipe

pytestmark = pytest.mark.usefixtures("without_figures")  # no test here looks at one

MIRROR = """metrosep = 1
[input]
files = ["*.txt"]
[[step]]
op = "parameters"
names = ["Pt"]
[[check]]
metric = "Pt"
upper = "100 nm"
U = "1 nm"
"""


def run(recipe, folder, out, **options):
    return run_batch(recipe, folder, out=out, **{"scheduler": "serial", **options})


def statuses(report) -> dict[str, str]:
    return {r["unit"]: r["status"] for r in report.rows}


def indexed(report) -> dict[str, str]:
    return {r["unit"]: r["status"] for r in report.document["rows"]}


def write_mirror(folder, height, suffix=".dat"):
    """A wave of `height` as DABAM stores it: the meaning in .txt, the columns beside it."""
    folder.mkdir(exist_ok=True)
    head = {"FILE_FORMAT": 2, "FILE_HEADER_LINES": 0, "X1_FACTOR": 1.0, "Y1_FACTOR": 1.0}
    (folder / "m1.txt").write_text(json.dumps({**head, "COLUMN_INDEX_ORDINATE": 1}))
    x = np.arange(200) * 1e-3
    np.savetxt(folder / f"m1{suffix}", np.c_[x, height * np.sin(2 * np.pi * x / 0.05)])


@pytest.mark.parametrize("suffix", [".dat", ".DAT"])
def test_a_changed_second_file_of_a_pair_makes_the_unit_new(tmp_path, suffix):
    recipe = Recipe.parse(MIRROR)
    write_mirror(tmp_path / "in", 20e-9, suffix)
    assert statuses(run(recipe, tmp_path / "in", tmp_path / "qa")) == {"m1.txt": "accepted"}
    assert run(recipe, tmp_path / "in", tmp_path / "qa").counts["skipped"] == 1
    write_mirror(tmp_path / "in", 900e-9, suffix)
    assert statuses(run(recipe, tmp_path / "in", tmp_path / "qa")) == {"m1.txt": "rejected"}


def test_a_second_file_that_changes_while_it_is_read_fails_the_unit(tmp_path, monkeypatch):
    recipe = Recipe.parse(MIRROR)
    write_mirror(tmp_path / "in", 20e-9)
    measure = run_recipe

    def slow(self, *args, **options):
        found = measure(self, *args, **options)
        write_mirror(tmp_path / "in", 900.5e-9)
        return found

    monkeypatch.setattr("metrosep.recipe.run.run_recipe", slow)
    report = run(recipe, tmp_path / "in", tmp_path / "qa")
    assert statuses(report) == {"m1.txt": "failed"}
    assert "m1.dat changed while it was read" in report.rows[0]["reason"]
    assert str(tmp_path) not in report.rows[0]["reason"]


def test_the_row_of_this_run_wins_over_an_older_result(recipe_text, parts, tmp_path, monkeypatch):
    recipe = Recipe.parse(recipe_text)
    parts(tmp_path / "in/a.x3p", 6e-9)
    assert indexed(run(recipe, tmp_path / "in", tmp_path / "qa")) == {"a.x3p": "accepted"}
    with monkeypatch.context() as patch:
        patch.setattr(work, "available_bytes", lambda: 1000)
        report = run(recipe, tmp_path / "in", tmp_path / "qa", fresh=True)
    assert statuses(report) == indexed(report) == {"a.x3p": "refused"}
    assert report.document["rows"][0]["link"].endswith("failed.json")


def test_a_file_that_is_gone_is_counted_apart(recipe_text, parts, tmp_path):
    recipe = Recipe.parse(recipe_text)
    for name, sa in (("a", 6e-9), ("b", 6e-9), ("b", 14e-9)):
        parts(tmp_path / f"in/{name}.x3p", sa)
        run(recipe, tmp_path / "in", tmp_path / "qa")
    (tmp_path / "in/b.x3p").unlink()
    report = run(recipe, tmp_path / "in", tmp_path / "qa")
    assert indexed(report) == {"a.x3p": "accepted"}
    assert report.document["counts"]["total"] == 1
    assert report.document["apart"]["gone"] == 2
    assert any("are gone" in m for m in report.messages)


def test_an_interrupted_run_keeps_what_an_earlier_one_did(recipe_text, parts, tmp_path):
    recipe = Recipe.parse(recipe_text)
    for name in "ab":
        parts(tmp_path / f"in/{name}.x3p", 6e-9)
    run(recipe, tmp_path / "in", tmp_path / "qa")
    report = run(recipe, tmp_path / "in", tmp_path / "qa", cancel=lambda: True)
    assert report.rows == ()
    assert indexed(report) == {"a.x3p": "accepted", "b.x3p": "accepted"}


def test_a_watched_folder_tries_a_locked_file_again(recipe_text, parts, tmp_path, monkeypatch):
    for name in "ab":
        parts(tmp_path / f"in/{name}.x3p", 6e-9)
    real, began = work.input_hash, time.monotonic()
    tries = []

    def locked(unit):
        if unit.name == "b.x3p" and len(tries) < 2:
            tries.append(time.monotonic())
            raise PermissionError(errno.EACCES, "locked by the instrument", unit.target)
        return real(unit)

    monkeypatch.setattr(work, "input_hash", locked)
    report = run(
        Recipe.parse(recipe_text), tmp_path / "in", tmp_path / "qa", watch=0.05,
        cancel=lambda: time.monotonic() - began > 20
        or bool(list((tmp_path / "qa").glob("b/*/result.json"))),
    )  # fmt: skip
    assert statuses(report) == {"a.x3p": "accepted", "b.x3p": "accepted"}
    assert len(tries) == 2
    assert (report.counts["total"], report.counts["open"]) == (2, 0)


def test_a_worker_that_died_is_no_bug_of_metrosep():
    unit = Unit("b.x3p", "/q/b.x3p", ("/q/b.x3p",), "b")
    error = WorkerDiedError("b.x3p: the worker died twice on it (killed, or out of memory)")
    assert exit_code_of(error) == 4
    assert "bug" not in as_reason(error, unit)
    assert worth_another_try(error)


def test_a_name_that_is_not_utf8_costs_no_index(recipe_text, parts, tmp_path):
    pytest.importorskip("xlsxwriter")
    parts(tmp_path / "in/a.x3p", 6e-9)
    name = tmp_path / "in" / os.fsdecode(b"bad\xff.x3p")
    try:
        name.write_bytes((tmp_path / "in/a.x3p").read_bytes())
    except OSError:
        pytest.skip("this disk takes no such name")
    text = recipe_text + '[batch]\nindex = ["csv", "html", "xlsx"]\n'
    report = run(Recipe.parse(text), tmp_path / "in", tmp_path / "qa")
    assert statuses(report) == {"a.x3p": "accepted", "bad\\xff.x3p": "failed"}
    assert report.messages == ()
    assert "bad\\xff.x3p" in (tmp_path / "qa/index.csv").read_text("utf-8")
    assert "bad" in (tmp_path / "qa/index.html").read_text("utf-8")
    assert (tmp_path / "qa/index.xlsx").stat().st_size > 0


def test_a_writer_of_an_index_that_fails_is_a_message(recipe_text, parts, tmp_path, monkeypatch):
    from metrosep.batch import index

    def broken(_document, _path):
        raise KeyError("colour")

    monkeypatch.setattr(index, "_write_csv", broken)
    parts(tmp_path / "in/a.x3p", 6e-9)
    report = run(Recipe.parse(recipe_text), tmp_path / "in", tmp_path / "qa")
    assert report.counts["accepted"] == 1
    assert report.messages == ("index.csv was not written: KeyError: 'colour'",)


NO_U = 'U = "0.2 nm"\n'


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [(NO_U, 'U = "0.2 s"\n', "U"), ('metric = "Sa"', 'metric = "Sz"', "Sz")],
)
@pytest.mark.parametrize("scheduler", ["serial", "threads"])
def test_a_wrong_recipe_is_one_refusal(recipe_text, parts, tmp_path, old, new, words, scheduler):
    for i in range(12):
        parts(tmp_path / f"in/{i}.x3p", 6e-9)
    recipe = Recipe.parse(recipe_text.replace(old, new), name="r.toml")
    for _ in range(2):  # resumed: the same refusal
        with pytest.raises(RecipeError, match=rf"r\.toml.*{words}"):
            run(recipe, tmp_path / "in", tmp_path / "qa", scheduler=scheduler, workers=2)
        assert len(list((tmp_path / "qa").glob("*/*/failed.json"))) <= 6


def test_an_incomplete_installation_does_not_stick(recipe_text, parts, tmp_path, monkeypatch):
    from metrosep.io import registry

    parts(tmp_path / "in/a.x3p", 6e-9)
    recipe = Recipe.parse(recipe_text)
    with monkeypatch.context() as patch:
        patch.setattr(registry, "_format_folder", lambda: None)
        registry._own_descriptors.cache_clear()
        from metrosep.batch import units as companions

        companions._family.cache_clear()
        report = run(recipe, tmp_path / "in", tmp_path / "qa")
        assert statuses(report) == {"a.x3p": "failed"}
        assert "install" in report.rows[0]["reason"]
    assert statuses(run(recipe, tmp_path / "in", tmp_path / "qa")) == {"a.x3p": "accepted"}


def test_upper_and_lower_case_of_a_name_are_the_same(recipe_text, parts, tmp_path):
    parts(tmp_path / "in/P.x3p", 6e-9)
    for name in ("R.X3P", "deep/Q.x3P"):
        (tmp_path / "in" / name).parent.mkdir(exist_ok=True)
        (tmp_path / "in" / name).write_bytes((tmp_path / "in/P.x3p").read_bytes())
    report = run(Recipe.parse(recipe_text), tmp_path / "in", tmp_path / "qa")
    assert statuses(report) == dict.fromkeys(("P.x3p", "R.X3P", "deep/Q.x3P"), "accepted")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes here")
def test_a_pipe_is_named_and_not_waited_for(recipe_text, parts, tmp_path):
    parts(tmp_path / "in/a.x3p", 6e-9)
    os.mkfifo(tmp_path / "in/f.x3p")
    found = []
    thread = threading.Thread(
        target=lambda: found.append(
            run(Recipe.parse(recipe_text), tmp_path / "in", tmp_path / "qa")
        ),
        daemon=True,
    )
    thread.start()
    thread.join(20)
    assert not thread.is_alive()
    assert statuses(found[0]) == {"a.x3p": "accepted"}
    assert any("f.x3p" in m and "pipe" in m for m in found[0].messages)


SETS = """metrosep = 1
[input]
files = ["*.csv"]
x = "x [mm]"
z = "z [um]"
[[step]]
op = "separate"
method = "joint"
"""


def test_a_set_names_what_the_recipe_will_not_take(tmp_path):
    from metrosep.batch import find_units
    from metrosep.batch.units import one_file_each

    recipe = Recipe.parse(SETS)
    assert not one_file_each(recipe)
    for name in ("a.csv", "B.CSV"):
        (tmp_path / name).write_text("0,0\n")
    found = find_units(recipe, tmp_path)
    assert [len(u.files) for u in found.units] == [1]
    assert any("B.CSV" in m for m in found.messages)


@pytest.mark.parametrize("named", ["s.dsc", "s.dat", "s.DSC"])
def test_every_file_beside_a_scan_counts(tmp_path, named):
    beside = {"s.dat", "s.pos", "s.ind", "s.hed"}
    for name in {named, *beside, "t.dat", "s.png"}:
        (tmp_path / name).write_text(name)
    target = str(tmp_path / named)
    unit = Unit(named, target, (target,), "s")
    found = files_read(unit)
    assert found[0] == target
    assert {os.path.basename(f) for f in found} == beside | {named}  # noqa: PTH119
    one_file = Unit("s.png", str(tmp_path / "s.png"), (str(tmp_path / "s.png"),), "s")
    assert files_read(one_file) == one_file.files
