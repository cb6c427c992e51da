"""What a recipe names: only plain files of a sensible size, in the workbench only opened folders."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import metrosep as ms
from metrosep.app.documents import Edit, Places
from metrosep.app.sessions import Session

FOREIGN = "a text of somebody else"
RECIPE = """metrosep = 1
extends = "{extends}"
[input]
files = ["part.x3p"]
[[step]]
op = "parameters"
names = ["Sa"]
"""
RANKING = """metrosep = 1
[[step]]
op = "rank"
machine = "{machine}"
form = "sphere: R=10 mm"
radius = "1 mm"
errors = {{ EXX = "1 um" }}
"""


@pytest.fixture
def folders(tmp_path):
    """A folder that is opened, with a map, and one that is not, with a foreign file."""
    inside, outside = tmp_path / "opened", tmp_path / "private"
    inside.mkdir()
    outside.mkdir()
    ms.write(ms.Surface(np.eye(4) * 1e-9, 1e-6, 1e-6), inside / "part.x3p")
    (outside / "secret.toml").write_text(f'title = "{FOREIGN}"\n')
    return inside, outside


def places_to_name(kind, inside, outside):
    """Return what a hostile recipe may write to reach a file that was not opened."""
    if kind == "link":
        (inside / "link.toml").symlink_to(outside / "secret.toml")
        return "link.toml"
    return {"whole": str(outside / "secret.toml"), "up": "../private/secret.toml"}[kind]


@pytest.mark.parametrize("kind", ["whole", "up", "link"])
@pytest.mark.parametrize("text", [RECIPE, RANKING], ids=["extends", "machine"])
def test_workbench_refuses_a_recipe_that_names_a_file_outside(folders, kind, text):
    inside, outside = folders
    name = places_to_name(kind, inside, outside)
    (inside / "r.toml").write_text(text.format(extends=name, machine=name))

    with pytest.raises(
        ms.errors.RecipeError, match="outside the folders that were opened"
    ) as caught:
        Session(Places([inside])).open("r.toml")

    assert FOREIGN not in str(caught.value)


@pytest.mark.parametrize("kind", ["whole", "up", "link"])
def test_an_edit_in_the_workbench_cannot_reach_outside_either(folders, kind):
    inside, outside = folders
    name = places_to_name(kind, inside, outside)
    session = Session(Places([inside]))
    session.open("part.x3p")

    with pytest.raises(ms.errors.RecipeError, match="outside the folders that were opened"):
        session.edit([Edit(("extends",), None, name)])

    assert FOREIGN not in session.state()["recipe"]


def test_a_recipe_inside_may_build_on_one_beside_it(folders):
    inside, _ = folders
    (inside / "base.toml").write_text('title = "ours"\n')
    (inside / "r.toml").write_text(RECIPE.format(extends="base.toml"))
    session = Session(Places([inside]))

    session.open("r.toml")

    assert session.state()["title"] == "ours"


@pytest.mark.skipif(sys.platform == "win32", reason="no devices and pipes with names")
@pytest.mark.parametrize("what", ["/dev/zero", "pipe", "large"])
@pytest.mark.parametrize("text", [RECIPE, RANKING], ids=["extends", "machine"])
@pytest.mark.parametrize("command", ["check", "run"])
def test_devices_pipes_and_huge_files_end_in_one_sentence(folders, what, text, command):
    inside, _ = folders
    name = what
    if what == "pipe":
        name = "pipe.toml"
        os.mkfifo(inside / name)
    elif what == "large":
        name = "large.toml"
        (inside / name).write_bytes(b"#" * (2**24 + 1))
    (inside / "r.toml").write_text(text.format(extends=name, machine=name))
    started = [sys.executable, "-m", "metrosep"]
    started += (
        ["check", "r.toml"] if command == "check" else ["run", "r.toml", "part.x3p", "-o", "o"]
    )

    done = subprocess.run(
        started, cwd=inside, capture_output=True, text=True, timeout=30, check=False
    )

    said = done.stdout + done.stderr
    assert done.returncode == 2, said
    assert "device or a pipe" in said or "larger than" in said
    assert "Traceback" not in said


@pytest.mark.skipif(sys.platform == "win32", reason="no pipes with names")
@pytest.mark.timeout(20)  # no writer ever comes: reading it would wait for ever
def test_workbench_refuses_a_pipe(folders):
    inside, _ = folders
    os.mkfifo(inside / "pipe.toml")
    (inside / "r.toml").write_text(RECIPE.format(extends="pipe.toml"))

    with pytest.raises(ms.errors.RecipeError, match="device or a pipe"):
        Session(Places([inside])).open("r.toml")


def test_no_text_of_a_foreign_file_gets_into_a_result(folders):
    """The whole way: what the workbench exports of a hostile recipe does not exist."""
    inside, outside = folders
    (inside / "r.toml").write_text(RECIPE.format(extends=outside / "secret.toml"))
    session = Session(Places([inside]))
    with pytest.raises(ms.errors.RecipeError):
        session.open("r.toml")

    assert session.state()["recipe"] is None
    assert FOREIGN not in json.dumps(session.state())


def test_work_in_the_workbench_leaves_no_file_beside_the_data(folders):
    inside, _ = folders
    before = sorted(p.name for p in inside.iterdir())
    session = Session(Places([inside]))
    session.open("part.x3p")
    session.edit([Edit(("title",), "part", "mine")])
    session.close()

    assert sorted(p.name for p in inside.iterdir()) == before
    again = Session(Places([inside]))
    again.open("part.x3p")
    assert again.state()["title"] == "mine"


def test_files_of_one_name_in_two_folders_have_sessions_of_their_own(folders, tmp_path):
    inside, _ = folders
    other = tmp_path / "other"
    other.mkdir()
    (other / "part.x3p").write_bytes((inside / "part.x3p").read_bytes())
    for folder in (inside, other):
        session = Session(Places([folder]))
        session.open("part.x3p")
        assert session.state()["title"] == "part"
        session.edit([Edit(("title",), "part", folder.name)])
        session.close()


def test_a_session_that_an_older_version_left_beside_the_file_is_named(folders):
    inside, _ = folders
    (inside / "part.x3p.session.toml").write_text(RECIPE.replace('extends = "{extends}"\n', ""))
    session = Session(Places([inside]))
    session.open("part.x3p")

    assert any("part.x3p.session.toml" in m for m in session.state()["messages"])
    Path(inside / "part.x3p.session.toml").unlink()
