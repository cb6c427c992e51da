"""Files that are asked for: nothing that is open is written over, nothing is made of other files."""

import os
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest

import metrosep as ms
from metrosep.app.documents import Edit, Places
from metrosep.app.export_answers import export, report
from metrosep.app.opening import autosave_path
from metrosep.app.sessions import Session
from metrosep.core.errors import DataError, ReadError, WriteError
from metrosep.recipe.result import load_document

RECIPE = (
    'metrosep = 1\n# of the customer\n[input]\nfiles = ["part.x3p"]\n[[step]]\nop = "form"\n'
    'form = "plane"\n[[step]]\nop = "parameters"\n'
)


def part(path, factor=1.0):
    z = factor * np.random.default_rng(1).normal(size=(40, 50)) * 1e-7
    ms.write(ms.Surface(z, 1e-6, 1e-6), path)
    return path


def opened(folder, *paths):
    session = Session(Places([folder]))
    session.open([str(p) for p in paths])
    return session


def ask(session, function=export, **message):
    header, _ = function(session, message, lambda: False, lambda news: None)
    return header


@pytest.fixture
def session(tmp_path):
    return opened(tmp_path, part(tmp_path / "part.x3p"))


def test_a_recipe_is_saved_onto_no_measurement_beside(session, tmp_path):
    other = part(tmp_path / "other.x3p", 2.0)
    before = other.read_bytes()
    with pytest.raises(DataError, match=r"other.x3p: the name of a recipe ends in .toml"):
        ask(session, what="recipe", path="other.x3p", overwrite=True)
    assert other.read_bytes() == before


def test_a_pipe_is_called_no_missing_file(tmp_path):
    os.mkfifo(tmp_path / "pipe.x3p")
    with pytest.raises(ReadError, match="not a regular file"):
        Places([tmp_path]).readable("pipe.x3p")


# ---- what is open stays as it is ---------------------------------------------------------------


def test_the_measurement_is_never_written_over(session, tmp_path):
    before = (tmp_path / "part.x3p").read_bytes()
    os.link(tmp_path / "part.x3p", tmp_path / "link.x3p")
    for name in ("part.x3p", "link.x3p"):
        with pytest.raises(WriteError, match=rf"{name}.*measurement that is open"):
            ask(session, what="recipe", path=name, overwrite=True)
        with pytest.raises(WriteError, match="measurement that is open"):
            ask(session, report, write=name, format="html", overwrite=True)
    assert (tmp_path / "part.x3p").read_bytes() == before
    assert (tmp_path / "link.x3p").read_bytes() == before


def test_nor_the_kept_session(tmp_path, monkeypatch):
    """Also where the user opened the folder in which sessions are kept."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.setenv("LOCALAPPDATA", str(tmp_path))
    part(tmp_path / "part.x3p")
    session = opened(tmp_path, tmp_path / "part.x3p")
    session.edit([Edit(("title",), "part", "mine")])
    name = str(autosave_path(tmp_path / "part.x3p"))
    before = (tmp_path / name).read_bytes()
    for function, message in (
        (export, {"what": "recipe", "path": name}),
        (report, {"write": name, "format": "html"}),
    ):
        with pytest.raises(WriteError, match="session that is kept"):
            ask(session, function, **message, overwrite=True)
    assert (tmp_path / name).read_bytes() == before


def test_the_recipe_that_is_open_takes_the_recipe_and_nothing_else(tmp_path):
    part(tmp_path / "part.x3p")
    (tmp_path / "r.toml").write_text(RECIPE)
    session = opened(tmp_path, tmp_path / "r.toml")
    session.edit([Edit(("title",), None, "mine")])
    with pytest.raises(WriteError, match="recipe that is open"):
        ask(session, report, write="r.toml", format="html", overwrite=True)
    with pytest.raises(DataError, match="exists already"):
        ask(session, what="recipe", path="r.toml")
    ask(session, what="recipe", path="r.toml", overwrite=True)
    assert tomllib.loads((tmp_path / "r.toml").read_text())["title"] == "mine"
    session.edit([Edit(("title",), "mine", "and more")])
    again = opened(tmp_path, tmp_path / "r.toml")
    assert again.document.recipe.title == "and more"  # the session is of the recipe as saved


def test_a_recipe_that_other_hands_changed_is_not_written_over(tmp_path):
    part(tmp_path / "part.x3p")
    (tmp_path / "r.toml").write_text(RECIPE)
    session = opened(tmp_path, tmp_path / "r.toml")
    (tmp_path / "r.toml").write_text(RECIPE + "# by hand\n")
    with pytest.raises(WriteError, match=r"r\.toml changed since it was opened"):
        ask(session, what="recipe", path="r.toml", overwrite=True)
    assert "# by hand" in (tmp_path / "r.toml").read_text()


def test_a_result_does_not_replace_the_measurement_by_an_output_of_its_name(tmp_path):
    before = part(tmp_path / "part.x3p").read_bytes()
    text = (
        RECIPE + '[[output]]\nkind = "map"\nfrom = "result"\nformat = "x3p"\npath = "part.x3p"\n'
    )
    try:
        ms.Recipe.parse(text)
    except ms.errors.RecipeError:
        text = RECIPE + '[[output]]\nkind = "report"\npath = "part.x3p"\n'
    (tmp_path / "r.toml").write_text(text)
    with pytest.raises(WriteError, match="measurement that is open"):
        ask(opened(tmp_path, tmp_path / "r.toml"), what="result", path=".")
    assert (tmp_path / "part.x3p").read_bytes() == before


@pytest.mark.parametrize("content", ["precious", '{"schema": "other/1"}', "[1]", "\udcff"])
def test_a_foreign_result_stays(session, tmp_path, content):
    (tmp_path / "res").mkdir()
    there = tmp_path / "res" / "result.json"
    there.write_bytes(content.encode("utf-8", "surrogateescape"))
    with pytest.raises(WriteError, match=r"res.*result\.json.*not of metrosep"):
        ask(session, what="result", path="res")
    assert there.read_bytes() == content.encode("utf-8", "surrogateescape")


def test_an_older_result_of_metrosep_is_replaced(session, tmp_path):
    ask(session, what="result", path="res")
    session.edit([Edit(("title",), "part", "newer")])
    ask(session, what="result", path="res")
    assert load_document(tmp_path / "res")["title"] == "newer"


# ---- files that changed meanwhile --------------------------------------------------------------


def test_a_file_that_changed_gives_no_result_until_it_is_opened_again(session, tmp_path):
    ask(session, report)
    stat = (tmp_path / "part.x3p").stat()
    part(tmp_path / "part.x3p", 5.0)
    os.utime(tmp_path / "part.x3p", ns=(stat.st_atime_ns, stat.st_mtime_ns))  # the digest tells
    with pytest.raises(WriteError, match=r"part\.x3p changed since it was opened; open it again"):
        ask(session, what="result", path="res")
    with pytest.raises(WriteError, match="changed since"):
        ask(session, report, write="r.html", format="html")
    assert not (tmp_path / "res").exists()
    assert not (tmp_path / "r.html").exists()
    ask(session, what="recipe", path="r.toml")  # it says nothing of the values
    session.open(str(tmp_path / "part.x3p"))
    assert ask(session, what="result", path="res")["files"]


def test_a_copy_with_the_same_content_is_the_same_file(session, tmp_path):
    shutil.copyfile(tmp_path / "part.x3p", tmp_path / "copy")
    (tmp_path / "copy").replace(tmp_path / "part.x3p")
    assert ask(session, what="result", path="res")["files"]


def test_runs_that_changed_or_went_are_told(tmp_path):
    x = np.arange(200.0)
    for name in ("a.csv", "b.csv"):
        rows = "\n".join(f"{v},{np.cos(v / 9)}" for v in x)
        (tmp_path / name).write_text(f"x_mm,z_um\n{rows}\n")
    session = Session(Places([tmp_path]))
    session.open(
        [str(tmp_path / n) for n in ("a.csv", "b.csv")],
        {"x": "x_mm", "z": "z_um", "feed": "7200 mm/min"},
    )
    (tmp_path / "b.csv").write_text((tmp_path / "b.csv").read_text() + "200,0\n")
    with pytest.raises(WriteError, match=r"b\.csv changed"):
        ask(session, what="result", path="res")
    session.open(
        [str(tmp_path / n) for n in ("a.csv", "b.csv")],
        {"x": "x_mm", "z": "z_um", "feed": "7200 mm/min"},
    )
    (tmp_path / "a.csv").unlink()
    with pytest.raises(WriteError, match=r"a\.csv changed"):
        ask(session, what="result", path="res")


# ---- dropped files -----------------------------------------------------------------------------


def test_what_is_made_of_a_dropped_file_outlives_the_session(tmp_path):
    home = tmp_path / "home"
    home.mkdir()
    session = Session(Places([home]))
    dropped = part(session.places.upload("part.x3p"))
    session.open(str(dropped))
    assert session.state()["target"] == str(home)
    for function, message in (
        (export, {"what": "recipe", "path": str(dropped.with_name("r.toml"))}),
        (export, {"what": "result", "path": str(dropped.with_name("res"))}),
        (report, {"write": str(dropped.with_name("r.html")), "format": "html"}),
    ):
        with pytest.raises(WriteError, match=r"dropped files.*home"):
            ask(session, function, **message)
    ask(session, what="recipe", path=str(home / "r.toml"))
    written = [*ask(session, what="result", path=str(home / "res"))["files"]]
    written += ask(session, report, write=str(home / "r.html"), format="html")["files"]
    session.close()
    assert all(Path(f).exists() for f in written)
    part(home / "part.x3p")  # put beside its recipe, which names no folder that is gone
    assert ms.Recipe.load(home / "r.toml").run(out=home / "again").files


def test_what_lies_in_a_folder_has_its_results_beside_it(session, tmp_path):
    assert session.state()["target"] == str(tmp_path)


# ---- the recipe in another folder --------------------------------------------------------------


@pytest.mark.parametrize("sub", ["sub", "su[b]", "deep/er"])
def test_a_recipe_in_another_folder_finds_its_file(tmp_path, sub):
    part(tmp_path / "part.x3p")
    (tmp_path / "r.toml").write_text(RECIPE)
    session = opened(tmp_path, tmp_path / "r.toml")
    (tmp_path / sub).mkdir(parents=True)
    ask(session, what="recipe", path=f"{sub}/r.toml")
    saved = tmp_path / sub / "r.toml"
    assert "# of the customer" in saved.read_text()
    assert str(tmp_path) not in saved.read_text()
    there, here = ms.Recipe.load(saved).run(), ms.Recipe.load(tmp_path / "r.toml").run()
    assert there.document["characteristics"] == here.document["characteristics"]
    assert list(session.document.recipe.input["files"]) == ["part.x3p"]


def test_and_one_that_is_saved_above_or_elsewhere(tmp_path):
    (tmp_path / "a[1]").mkdir()
    (tmp_path / "b").mkdir()
    part(tmp_path / "a[1]" / "part.x3p")
    session = opened(tmp_path, tmp_path / "a[1]" / "part.x3p")
    for name in ("up.toml", "b/side.toml"):
        ask(session, what="recipe", path=name)
        assert ms.Recipe.load(tmp_path / name).run().document["characteristics"]
    apart = Session(Places([tmp_path / "b", tmp_path / "a[1]"]))
    apart.open(str(tmp_path / "a[1]" / "part.x3p"))
    ask(apart, what="recipe", path=str(tmp_path / "b" / "whole.toml"))
    stored = tomllib.loads((tmp_path / "b" / "whole.toml").read_text())["input"]["files"]
    assert stored == [str(tmp_path / "a[1]" / "part.x3p")]
    assert ms.Recipe.load(tmp_path / "b" / "whole.toml").run().document["characteristics"]


def test_a_recipe_that_builds_on_another_stays_beside_it(tmp_path):
    part(tmp_path / "part.x3p")
    (tmp_path / "base.toml").write_text(RECIPE)
    (tmp_path / "r.toml").write_text('metrosep = 1\nextends = "base.toml"\n')
    (tmp_path / "sub").mkdir()
    session = opened(tmp_path, tmp_path / "r.toml")
    with pytest.raises(DataError, match=r"base\.toml.*same folder"):
        ask(session, what="recipe", path="sub/r.toml")
