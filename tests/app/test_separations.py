"""What the page exports is what the command line writes, byte for byte; each part made once."""

import json
import shutil
import tomllib

import numpy as np
import pytest

import metrosep as ms
from metrosep.app.documents import Edit, Places
from metrosep.app.export_answers import export
from metrosep.app.metrics_answers import metrics
from metrosep.app.separations import MethodResults, Separations
from metrosep.app.sessions import Session
from metrosep.errors import DataError, MetrosepError, WriteError
from metrosep.recipe import Recipe
from metrosep.recipe.pipeline import CancelledError

VIBRATION = 2 * 0.05e-6
"""Twice the amplitude of what differs from run to run, m: no more of it can be left."""

FEEDS = (4800, 4800, 6000, 7200)


def never():
    return False


def nobody(news):
    """Hear nothing."""


def runs(path):
    """The error sin(2 pi x/10 mm) um over 20 mm, a vibration of 50 Hz with another phase each run."""
    rows = ["run,feed_mm_min,t_ms,x_mm,z_um"]
    for run, feed in enumerate(FEEDS):
        for t in np.arange(0, 20 / (feed / 60e3), 1.0):
            x = feed / 60e3 * t
            z = np.sin(2 * np.pi * x / 10) + 0.05 * np.sin(2 * np.pi * 0.05 * t + run)
            rows.append(f"{run},{feed},{t:g},{x:.6g},{z:.6g}")
    path.write_text("\n".join(rows) + "\n")
    return path


COLUMNS = {"x": "x_mm", "z": "z_um", "feed": "feed_mm_min", "time": "t_ms", "run": "run"}


def opened(folder, kind, repository):
    session = Session(Places([folder]))
    if kind == "map":
        y, x = np.mgrid[0:40, 0:50] * 1e-3
        ms.write(ms.Surface(1e-4 * x + 1e-6 * np.cos(300 * y), 1e-3, 1e-3), folder / "p.x3p")
        session.open(str(folder / "p.x3p"))
    elif kind == "profile":
        i = np.arange(400)
        table = "\n".join(f"{0.01 * k:.6g},{np.cos(k):.6g}" for k in i)
        (folder / "p.csv").write_text(f"x,z\n{table}\n")
        reading = {"x": "x", "x_unit": "mm", "z": "z", "z_unit": "um"}
        session.open(str(folder / "p.csv"), reading)
    elif kind == "runs":
        session.open(str(runs(folder / "a.csv")), COLUMNS)
    else:
        example, recipe = EXAMPLES[kind].split("/")
        for file in (repository / "examples" / example).iterdir():
            shutil.copy(file, folder)
        session.open(str(folder / recipe))
    return session


EXAMPLES = {
    "files": "spheres/positions.toml",
    "one file": "circle_closure/recipe.toml",
    "nothing": "fts_lathe/recipe.toml",
}
KINDS = ("map", "profile", "runs", "files", "one file", "nothing")


def written(session, what, path, **more):
    return export(session, {"what": what, "path": path, **more}, never, nobody)[0]


def from_shell(folder, recipe, session):
    files = None if session.document.recipe.reads_nothing else list(session.opened.files)
    Recipe.load(folder / recipe).run(files, out=folder / "shell")
    return (folder / "shell" / "result.json").read_bytes()


@pytest.mark.parametrize("kind", KINDS)
def test_the_saved_recipe_gives_the_same_bytes(tmp_path, kind, repository):
    session = opened(tmp_path, kind, repository)
    title = tomllib.loads(session.document.text).get("title")
    session.edit([Edit(("title",), title, "by hand")])
    written(session, "recipe", "by-hand.toml")
    before = written(session, "result", "page")["verdict"]

    first = (tmp_path / "page" / "result.json").read_bytes()
    assert first == from_shell(tmp_path, "by-hand.toml", session)
    document = json.loads(first)
    assert document["recipe"]["name"] == "by-hand.toml"
    assert document["verdict"] == before


@pytest.mark.parametrize("kind", ["map", "runs", "one file"])
def test_what_is_seen_changes_no_number(tmp_path, kind, repository):
    session = opened(tmp_path, kind, repository)
    written(session, "result", "plain")
    session.edit([Edit(("view", "colours"), None, "cividis")])
    assert session.state()["view"] == {"colours": "cividis"}
    written(session, "result", "seen")

    plain, seen = (
        json.loads((tmp_path / name / "result.json").read_text()) for name in ("plain", "seen")
    )
    for document in (plain, seen):
        document["recipe"].pop("text"), document["recipe"].pop("sha256")
    assert plain == seen


def test_the_page_shows_the_numbers_of_the_result(tmp_path, repository):
    session = opened(tmp_path, "runs", repository)
    limit = {"metric": "pv", "upper": "3 um", "U": "10 nm"}
    session.edit([Edit(("check", 0), None, limit)])
    shown, _ = metrics(session, {"level": "full"}, never, nobody)
    verdict = written(session, "result", "page")["verdict"]

    document = json.loads((tmp_path / "page" / "result.json").read_text())
    (pv,) = (c for c in document["characteristics"] if c["metric"] == "pv")
    (row,) = (r for r in shown["rows"] if r["symbol"] == "pv")
    assert (row["value"], shown["verdict"]) == (pv["value"], verdict)
    x = np.linspace(0.0, 20.0, 2001)
    planted = np.sin(2 * np.pi * x / 10)
    planted -= np.polyval(np.polyfit(x, planted, 1), x)  # a line is not an error of straightness
    assert row["value"] == pytest.approx(np.ptp(planted) * 1e-6, abs=VIBRATION)


def test_a_preview_has_no_numbers_of_runs(tmp_path, repository):
    session = opened(tmp_path, "runs", repository)
    header, _ = metrics(session, {"level": "drag"}, never, nobody)
    assert (header["is_preview"], header["rows"], header["verdict"]) == (True, [], None)


def test_nothing_is_written_over_unasked(tmp_path, repository):
    session = opened(tmp_path, "map", repository)
    (tmp_path / "mine.toml").write_text("mine")
    with pytest.raises(DataError, match="exists already"):
        written(session, "recipe", "mine.toml")
    assert (tmp_path / "mine.toml").read_text() == "mine"
    written(session, "recipe", "mine.toml", overwrite=True)
    assert "[[step]]" in (tmp_path / "mine.toml").read_text()
    with pytest.raises(WriteError, match="folder"):
        written(session, "result", "../elsewhere")
    with pytest.raises(MetrosepError, match="pdf"):
        written(session, "pdf", "a.pdf")


# ---- each part once ----------------------------------------------------------------------------


@pytest.fixture
def counted(tmp_path):
    calls = []

    def read(recipe, files):
        from metrosep.recipe.run import read_inputs

        calls.append(files)
        return read_inputs(recipe, files)

    return Separations([runs(tmp_path / "a.csv")], read), calls


def recipe(method="mean", **keys):
    extra = "".join(f'{k} = "{v}"\n' for k, v in keys.items())
    columns = "".join(f'{k} = "{v}"\n' for k, v in COLUMNS.items())
    return Recipe.parse(
        f'metrosep = 1\n[input]\n{columns}[[step]]\nop = "separate"\nmethod = "{method}"\n{extra}'
    )


def test_runs_are_read_once_and_the_same_separation_is_remembered(counted):
    separations, calls = counted
    first = separations.estimate(recipe())
    assert separations.estimate(recipe()) is first
    other = separations.estimate(recipe(start="2 mm", length="15 mm"))
    assert other is not first
    assert separations.estimate(recipe()) is first
    assert len(calls) == 1
    assert separations.result(recipe()).estimate is first


def test_cancelling_stops_before_it_begins(counted):
    separations, _ = counted
    with pytest.raises(CancelledError):
        separations.estimate(recipe(), lambda: True)


def test_a_separation_that_fails_is_not_remembered(counted):
    separations, _ = counted
    for _ in range(2):
        with pytest.raises(MetrosepError):
            separations.estimate(recipe(start="500 mm", length="15 mm"))
    assert separations.estimate(recipe()) is not None


def test_a_recipe_of_no_method_is_refused():
    with pytest.raises(DataError, match="not a recipe of a named method"):
        MethodResults(()).result(recipe())
