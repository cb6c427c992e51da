"""What a recipe names: only plain files of a sensible size, in the workbench only opened folders."""

import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
import tomlkit

import metrosep as ms
from metrosep.app.documents import Edit, Places
from metrosep.app.export_answers import run_folder
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


@pytest.mark.parametrize("name", ["a\\u0000.toml", "a" * 5000, "~no/../\\u0000"])
@pytest.mark.parametrize("text", [RECIPE, RANKING], ids=["extends", "machine"])
def test_names_that_no_file_can_have_are_refused_in_one_sentence(folders, name, text):
    inside, _ = folders
    (inside / "r.toml").write_text(text.format(extends=name, machine=name))
    with pytest.raises(ms.errors.RecipeError, match=r"r\.toml:\d+: "):
        ms.Recipe.load(inside / "r.toml")


@pytest.mark.parametrize("name", ["a\\u0000.x3p", "a" * 5000, "**.x3p", ""])
def test_patterns_of_inputs_that_cannot_be_are_refused_in_one_sentence(folders, name):
    inside, _ = folders
    text = RECIPE.replace('extends = "{extends}"\n', "").replace("part.x3p", name)
    (inside / "r.toml").write_text(text)
    with pytest.raises(ms.errors.ReadError, match=r"no file matches|not a name of files"):
        ms.Recipe.load(inside / "r.toml").run()


@pytest.mark.skipif(sys.platform == "win32", reason="links need a right there")
@pytest.mark.parametrize("name", ["part.report.toml", "part.x3p.report.toml", "part.hed"])
def test_a_link_beside_the_file_that_leads_outside_is_not_read(folders, name):
    """What is read with a file without being named: the head of its report, of its format."""
    inside, outside = folders
    (outside / "secret.toml").write_text(f'number = "{FOREIGN}"\n')
    (inside / name).symlink_to(outside / "secret.toml")
    (inside / "r.toml").write_text(RECIPE.replace('extends = "{extends}"\n', ""))
    for opened in ("part.x3p", "r.toml"):
        with pytest.raises(ms.errors.ReadError, match="leads out of the folders"):
            Session(Places([inside])).open(opened)
    Session(Places([inside, outside])).open("part.x3p")  # opened too: then it may be read


@pytest.mark.skipif(sys.platform == "win32", reason="links need a right there")
@pytest.mark.parametrize("name", ["other.x3p", "part.report.toml", "deep/part.report.toml"])
def test_a_folder_is_not_run_through_links_that_lead_outside(folders, name):
    inside, outside = folders
    session = Session(Places([inside]))
    session.open("part.x3p")
    (inside / name).parent.mkdir(exist_ok=True)
    (inside / name).symlink_to(outside / "secret.toml")
    message = {"folder": str(inside), "out": str(inside / "qa"), "scheduler": "serial"}
    with pytest.raises(ms.errors.ReadError, match="leads out of the folders"):
        run_folder(session, message, lambda: False, lambda _: None)
    assert not (inside / "qa").exists()


LOOKED = """
import os, sys
from pathlib import Path
inside, outside, seen = Path(sys.argv[1]), sys.argv[2], []
def hook(event, args):
    if event in ("open", "os.listdir", "os.scandir") and isinstance(args[0], str | bytes | os.PathLike):
        path = os.path.realpath(os.fsdecode(args[0]))
        if path.startswith(outside):
            seen.append((event, path))
sys.addaudithook(hook)
import metrosep as ms
from metrosep.app.documents import Places
from metrosep.app.export_answers import full_result
from metrosep.app.sessions import Session
ended = 0
for recipe in sorted(inside.glob("hostile_*.toml")):
    session = Session(Places([inside]))
    try:
        session.open(recipe.name)
        full_result(session, lambda: False, lambda _: None)
    except ms.errors.MetrosepError:
        ended += 1
    finally:
        session.close()
print(ended, seen)
"""


EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def hostile(folder, names):
    """Write whole recipes with a name in each key that takes a file; return how many."""
    from metrosep.core.methods import METHODS

    made, left = (
        [],
        {(op, k) for op, m in METHODS.items() for k, f in m.fields.items() if f.kind == "file"},
    )
    for recipe in sorted(EXAMPLES.glob("*/*.toml")):
        text = recipe.read_text(encoding="utf-8")
        step = (tomllib.loads(text).get("step") or [{}])[0]
        for op, key in sorted(left):
            if step.get("op") == op:
                left.remove((op, key))
                made.append((text, ("step", 0, key), "NAME"))
        if step.get("op") in ("rank", "cut_budget") and isinstance(step.get("errors"), dict):
            made.append((text, ("step", 0, "errors", next(iter(step["errors"]))), "table NAME"))
    assert left == set()  # an example of each
    plain = (EXAMPLES / "measured_part" / "recipe.toml").read_text(encoding="utf-8")
    made += [
        (plain, ("input", "files"), ["NAME"]),
        (plain, ("report",), {"template": "NAME"}),
        (plain, ("extends",), "NAME"),
    ]
    table = (EXAMPLES / "carriers" / "recipe.toml").read_text(encoding="utf-8")
    made.append((table, ("output", 0, "active"), "NAME"))
    count = 0
    for text, path, value in made:
        for name in names:
            held = tomlkit.parse(text)
            there = held
            for key in path[:-1]:
                there = there[key]
            there[path[-1]] = json.loads(json.dumps(value).replace("NAME", name))
            (folder / f"hostile_{count:03}.toml").write_text(tomlkit.dumps(held), encoding="utf-8")
            count += 1
    return count


@pytest.mark.skipif(sys.platform == "win32", reason="links need a right there")
def test_no_recipe_opens_or_lists_what_lies_outside(folders, tmp_path):
    """Every key that names a file, eight spellings: an audit hook sees all that Python opens."""
    inside, outside = folders
    for name in ("secret.csv", "secret.x3p"):
        (outside / name).write_bytes((inside / "part.x3p").read_bytes())
    (inside / "link").symlink_to(outside)
    (inside / "one.toml").symlink_to(outside / "secret.toml")
    (inside / "two.toml").symlink_to("one.toml")
    names = [
        str(outside / "secret.toml"),
        str(outside / "*"),
        "../private/secret.toml",
        "../private/*",
    ]
    names += [
        "./x/../../private/secret.csv",
        "link/secret.x3p",
        "link/*.csv",
        "one.toml",
        "two.toml",
    ]
    n = hostile(inside, names)
    before = {p.name for p in inside.iterdir()}
    done = subprocess.run(
        [sys.executable, "-c", LOOKED, str(inside), str(outside)],
        capture_output=True, text=True, timeout=120, check=False,
        env={**os.environ, "XDG_STATE_HOME": str(tmp_path / "state")},
    )  # fmt: skip

    assert done.stdout == f"{n} []\n", done.stderr
    assert n > 150
    assert {p.name for p in inside.iterdir()} == before


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
