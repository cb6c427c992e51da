"""A link that leads out of the opened folders and is laid after a file was opened is never read."""

import json
import os
import sys

import numpy as np
import pytest
import tomlkit

import metrosep as ms
from metrosep.app.documents import Places
from metrosep.app.server import Answers
from metrosep.app.sessions import Session
from metrosep.machine.chains import preset_table

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="links need a right there")

FOREIGN = "a text of somebody else"
RANKING = """metrosep = 1
[[step]]
op = "rank"
machine = "machine.toml"
form = "sphere: R=10 mm"
radius = "1 mm"
errors = { EXX = "1 um" }
"""
MAP = np.outer(np.hanning(12), np.hanning(12)) * 1e-6
OTHER = 7.0 * MAP + 1e-6


@pytest.fixture
def folders(tmp_path):
    inside, outside = tmp_path / "opened", tmp_path / "private"
    inside.mkdir()
    outside.mkdir()
    return inside, outside


def answers_for(folder, name):
    session = Session(Places([folder]))
    session.open(name)
    return Answers(session)


def replaced(file, by):
    """Put a link in the place of a file, as somebody else may at any time."""
    if file.is_dir():
        file.rename(file.with_name(f"{file.name}.away"))
    else:
        file.unlink(missing_ok=True)
    file.symlink_to(by)


def asked(answers, **message):
    """Return all that an answer says, its arrays too."""
    header, arrays = answers.answer(message)
    return json.dumps(header, default=str) + "".join(str(a.tolist()) for a in arrays.values())


def edit(key, old, new):
    return {"k": "edit", "edits": [{"path": ["input", key], "old": old, "new": new}]}


def written(file, z=MAP):
    ms.write(ms.Surface(z, 1e-6, 1e-6), file)
    return file


REFUSED = r"leads? out of the folders|outside the folders"


def text_map(file, z):
    np.savetxt(file, z * 1e6)
    return file


@pytest.mark.parametrize("name", ["part.report.toml", "part.x3p.report.toml"])
def test_the_head_of_a_report(folders, name):
    inside, outside = folders
    written(inside / "part.x3p")
    (outside / "secret.toml").write_text(f'number = "{FOREIGN}"\n')
    answers = answers_for(inside, "part.x3p")
    assert FOREIGN not in asked(answers, k="report")
    replaced(inside / name, outside / "secret.toml")
    with pytest.raises(ms.errors.MetrosepError, match=REFUSED) as caught:
        asked(answers, k="report")
    assert FOREIGN not in str(caught.value)


@pytest.mark.parametrize("what", ["file", "folder"])
def test_a_map_that_is_read_again_or_followed(folders, what):
    inside, outside = folders
    deep = inside / "deep"
    deep.mkdir()
    text_map(deep / "part.txt", MAP)
    text_map(outside / "part.txt", OTHER)
    session = Session(Places([inside]))
    session.open("deep/part.txt", {"unit": "um", "lateral_step": "1 um"})
    answers = Answers(session)
    before = asked(answers, k="heights", level="full")
    replaced(
        deep / "part.txt" if what == "file" else deep,
        outside / "part.txt" if what == "file" else outside,
    )
    stamp = (outside / "part.txt").stat()
    with pytest.raises(ms.errors.MetrosepError, match=REFUSED):
        asked(answers, **edit("unit", "um", "nm"))
    followed = {"k": "latest", "of": "file"}
    said = answers.answer(followed)[0]
    assert said["path"] is None
    assert str(stamp.st_size) not in json.dumps(said)
    if what == "folder":
        with pytest.raises(ms.errors.MetrosepError, match=REFUSED):
            asked(answers, k="latest", of="folder")
    with pytest.raises(ms.errors.MetrosepError, match=REFUSED):
        session.open("deep/part.txt", keep_recipe=True)
    with pytest.raises(ms.errors.MetrosepError):
        asked(answers, k="export", path=str(inside / "result.json"))
    assert not (inside / "result.json").exists()
    assert asked(answers, k="heights", level="full") == before  # what was read stays


def test_runs_that_are_read_again(folders):
    inside, outside = folders
    rows = ["run,x_mm,z_um,w_um"]
    rows += [f"{k},{x},{0.1 * x + k},{x}" for k in range(3) for x in range(20)]
    for folder in folders:
        (folder / "runs.csv").write_text("\n".join(rows) + "\n")
    session = Session(Places([inside]))
    session.open("runs.csv", {"x": "x_mm", "z": "z_um", "run": "run"})
    replaced(inside / "runs.csv", outside / "runs.csv")
    with pytest.raises(ms.errors.MetrosepError, match=REFUSED):
        asked(Answers(session), **edit("z", "z_um", "w_um"))


def test_the_machine_of_a_ranking(folders):
    inside, outside = folders
    for folder in folders:
        text = tomlkit.dumps(preset_table("fts_lathe"))
        (folder / "machine.toml").write_text(text, encoding="utf-8")
    (inside / "rank.toml").write_text(RANKING)
    answers = answers_for(inside, "rank.toml")
    replaced(inside / "machine.toml", outside / "machine.toml")
    with pytest.raises(ms.errors.MetrosepError, match=REFUSED):
        asked(answers, k="ranking")


def test_a_file_that_another_process_reads(folders):
    """HDF5 is read by a process of its own."""
    inside, outside = folders
    written(inside / "part.h5")
    written(outside / "part.h5", OTHER)
    answers = answers_for(inside, "part.h5")
    replaced(inside / "part.h5", outside / "part.h5")
    with pytest.raises(ms.errors.MetrosepError, match=REFUSED):
        asked(answers, **edit("channel", None, "height"))


@pytest.mark.parametrize("scheduler", ["serial", "threads", "processes"])
def test_a_folder_that_is_run(folders, scheduler, monkeypatch):
    """The link is laid after the folder was looked through."""
    inside, outside = folders
    written(inside / "a.x3p")
    answers = answers_for(inside, "a.x3p")
    written(outside / "secret.x3p", OTHER)

    def looked_through(places, files):
        list(files)
        if not (inside / "b.x3p").is_symlink():
            (inside / "b.x3p").symlink_to(outside / "secret.x3p")

    monkeypatch.setattr(Places, "require_own", looked_through)
    answers.answer({"k": "run_folder", "folder": str(inside), "out": str(inside / "qa"),
                    "scheduler": scheduler, "workers": 1})  # fmt: skip
    results = [json.loads(f.read_text()) for f in (inside / "qa").rglob("result.json")]
    assert len(results) == 1  # that of a.x3p


@pytest.mark.timeout(20)  # no writer ever comes: reading it would wait for ever
def test_a_pipe_in_the_place_of_a_file(folders):
    inside, _ = folders
    text_map(inside / "part.txt", MAP)
    session = Session(Places([inside]))
    session.open("part.txt", {"unit": "um", "lateral_step": "1 um"})
    (inside / "part.txt").unlink()
    os.mkfifo(inside / "part.txt")
    with pytest.raises(ms.errors.MetrosepError, match="device or a pipe"):
        asked(Answers(session), **edit("unit", "um", "nm"))


def test_links_that_stay_inside_are_followed(folders):
    inside, _ = folders
    text_map(inside / "part.txt", MAP)
    text_map(inside / "new.txt", OTHER)
    session = Session(Places([inside]))
    session.open("part.txt", {"unit": "um", "lateral_step": "1 um"})
    replaced(inside / "part.txt", inside / "new.txt")
    asked(Answers(session), **edit("unit", "um", "nm"))
    assert session.evaluations.obj.z.max() == pytest.approx(OTHER.max() / 1e3, abs=1e-15)


def test_reading_outside_of_a_workbench_is_not_bound(folders):
    """The rule belongs to requests: a script in the same process reads what it names."""
    inside, outside = folders
    written(outside / "part.x3p", OTHER)
    replaced(inside / "part.x3p", outside / "part.x3p")
    Session(Places([inside]))
    assert ms.read(inside / "part.x3p").z.max() == pytest.approx(OTHER.max(), abs=1e-15)
