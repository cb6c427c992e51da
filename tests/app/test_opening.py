"""Opening: what each kind of file becomes, and that a kept session comes back or is refused."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

import metrosep as ms
from metrosep.app.asking import Ask
from metrosep.app.documents import Edit, Places
from metrosep.app.opening import autosave_path, open_files
from metrosep.app.server import Answers
from metrosep.app.sessions import Session
from metrosep.errors import DataError, MetrosepError, ReadError, RecipeError

SOON = 10.0
N = 200


def written(path, text):
    path.write_text(text)
    return path


def csv(path, head, *columns):
    rows = "\n".join(",".join(f"{v:.6g}" for v in row) for row in zip(*columns, strict=True))
    return written(path, f"{head}\n{rows}\n" if head else f"{rows}\n")


def runs(path, head="run,feed_mm_min,t_ms,x_mm,z_um"):
    """Four runs over 20 mm: the error sin(2 pi x/10 mm) um, and a line that differs."""
    rows = []
    for run, feed in enumerate((4800, 4800, 6000, 7200)):
        t = np.arange(0, 20 / (feed / 60e3), 1.0)  # ms
        x = feed / 60e3 * t
        z = np.sin(2 * np.pi * x / 10) + 0.01 * run * x + 0.05 * np.sin(2 * np.pi * 0.05 * t + run)
        rows += [np.column_stack([np.full_like(x, run), np.full_like(x, feed), t, x, z])]
    return csv(path, head, *np.concatenate(rows).T)


def part(path):
    y, x = np.mgrid[0:40, 0:50] * 1e-3
    ms.write(ms.Surface(1e-4 * x + 1e-6 * np.cos(300 * y), 1e-3, 1e-3), path)
    return path


def opened(folder, *paths, **reading):
    return open_files(Places([folder]), [str(p) for p in paths], reading)


def session_of(folder, *paths, **reading):
    made = Session(Places([folder]))
    made.open([str(p) for p in paths], reading)
    return made


def edited(session, path, old, new):
    session.edit([Edit(tuple(path), old, new)])
    assert session.keeper.wait(SOON)


# ---- what a file becomes -----------------------------------------------------------------------


def test_a_map_and_a_profile(tmp_path):
    assert opened(tmp_path, part(tmp_path / "a.x3p")).kind == "map"
    i = np.arange(N)
    one = opened(tmp_path, csv(tmp_path / "a.csv", "x_mm,z_um", i, np.cos(i)))
    assert one.kind == "profile"
    assert one.material.obj.x[1] == pytest.approx(1e-3, abs=1e-15)


def test_position_and_height_have_a_unit_each(tmp_path):
    """One unit for both once made positions in mm to um."""
    i = np.arange(N)
    file = csv(tmp_path / "a.csv", "", i * 0.01, np.cos(i))
    with pytest.raises(Ask, match="unit") as asked:
        opened(tmp_path, file)
    names = [f["name"] for f in asked.value.fields]
    assert names[:4] == ["x", "x_unit", "z", "z_unit"]
    assert [f["value"] for f in asked.value.fields[:4]] == ["column1", "", "column2", ""]
    one = opened(tmp_path, file, x="column1", x_unit="mm", z="column2", z_unit="nm")

    assert one.kind == "profile"
    assert one.material.obj.x[1] == pytest.approx(10e-6, abs=1e-15)
    assert one.material.obj.z[0] == pytest.approx(1e-9, abs=1e-18)
    assert one.document.recipe.input["x"]["unit"] == "mm"


def test_a_unit_against_the_header_is_refused(tmp_path):
    i = np.arange(N)
    file = csv(tmp_path / "a.csv", "x_mm,z_um", i, np.cos(i))
    with pytest.raises(MetrosepError, match="x_mm"):
        opened(tmp_path, file, x="x_mm", x_unit="um", z="z_um")


def test_a_unit_without_its_column_is_refused(tmp_path):
    with pytest.raises(DataError, match="x_unit"):
        opened(tmp_path, runs(tmp_path / "a.csv"), x_unit="mm")


def test_many_columns_are_asked_for_with_guesses(tmp_path):
    file = runs(tmp_path / "a.csv")
    with pytest.raises(Ask, match="which column is what") as asked:
        opened(tmp_path, file)

    guessed = {f["name"]: f["value"] for f in asked.value.fields if f["value"]}
    assert guessed == {
        "x": "x_mm", "z": "z_um", "feed": "feed_mm_min", "run": "run", "time": "t_ms",
    }  # fmt: skip
    assert opened(tmp_path, file, **guessed).kind == "runs"


def test_x_and_z_alone_are_one_profile(tmp_path):
    i = np.arange(N)
    file = csv(tmp_path / "a.csv", "t_ms,x_mm,z_um,temp", i, i, np.cos(i), i)
    one = opened(tmp_path, file, x="x_mm", z="z_um")
    assert one.kind == "profile"
    assert (one.document.recipe.input["x"], one.document.recipe.input["z"]) == ("x_mm", "z_um")
    timed = opened(tmp_path, file, x="x_mm", z="z_um", time="t_ms")
    assert timed.kind == "profile"
    assert any("time" in m for m in timed.messages)


def test_a_voltage_with_its_sensitivity_is_a_profile(tmp_path):
    i = np.arange(N)
    file = csv(tmp_path / "a.csv", "x_mm,probe_V,other_V", i, np.cos(i), i)
    one = opened(tmp_path, file, x="x_mm", z="probe_V", scale="-2 um/V")
    assert one.kind == "profile"
    assert one.material.obj.z[0] == pytest.approx(-2e-6, abs=1e-15)


def test_one_column_is_asked_for_its_step(tmp_path):
    file = csv(tmp_path / "a.csv", "z_um", np.cos(np.arange(N)))
    with pytest.raises(Ask) as asked:
        opened(tmp_path, file)
    assert asked.value.name == "lateral_step"
    one = opened(tmp_path, file, lateral_step="10 um")
    assert one.material.obj.x[1] == pytest.approx(10e-6, abs=1e-15)


# ---- several files -----------------------------------------------------------------------------


def _set(folder, n=3):
    whole = runs(folder / "all.csv").read_text().splitlines()
    files = []
    for run in range(n):
        rows = [r for r in whole[1:] if r.startswith(f"{run},")]
        files.append(written(folder / f"r{run}.csv", "\n".join([whole[0], *rows])))
    return files


COLUMNS = {"x": "x_mm", "z": "z_um", "feed": "feed_mm_min", "time": "t_ms"}


def test_several_files_are_one_set_in_the_order_of_their_names(tmp_path):
    files = _set(tmp_path)
    with pytest.raises(Ask, match="one set"):
        opened(tmp_path, *files)
    one = opened(tmp_path, *files[::-1], **COLUMNS)

    assert one.kind == "runs"
    assert [f.name for f in one.files] == ["r0.csv", "r1.csv", "r2.csv"]
    assert len(one.material.runs(one.document.recipe).runs) == 3


def test_a_set_with_other_columns_or_a_map_is_refused(tmp_path):
    files = _set(tmp_path)
    files[1].write_text(files[1].read_text().replace("z_um", "gap_um"))
    with pytest.raises(MetrosepError, match=r"r1\.csv.*z_um"):
        opened(tmp_path, *files, **COLUMNS)
    with pytest.raises(DataError, match=r"p\.x3p.*by itself"):
        opened(tmp_path, files[0], part(tmp_path / "p.x3p"))


def test_a_set_lies_in_one_folder(tmp_path):
    files = _set(tmp_path)
    (tmp_path / "more").mkdir()
    moved = files[1].rename(tmp_path / "more" / "r1.csv")
    with pytest.raises(DataError, match="one folder"):
        opened(tmp_path, files[0], moved, **COLUMNS)


def test_headers_without_units_get_them(tmp_path):
    file = runs(tmp_path / "a.csv", "run,F,t,x,z")
    one = opened(
        tmp_path,
        file,
        x="x",
        x_unit="mm",
        z="z",
        z_unit="um",
        feed="F:mm/min",
        time="t:ms",
        run="run",
    )
    found = one.material.runs(one.document.recipe).runs
    assert len(found) == 4
    assert found[3].feed == pytest.approx(0.12, abs=1e-12)


@pytest.mark.parametrize("name", ["short.lvm", "multi_time_column.lvm"])
def test_a_recording_asks_for_its_channels(tmp_path, corpus, name):
    file = tmp_path / name
    file.write_bytes((corpus / "lvm" / name).read_bytes())
    with pytest.raises(Ask) as asked:
        opened(tmp_path, file)
    assert asked.value.name == "columns"
    assert "t_s" in asked.value.fields[0]["choices"]


# ---- recipes -----------------------------------------------------------------------------------

MAP = 'metrosep = 1\n[input]\nfiles = ["{}"]\n[[step]]\nop = "form"\nform = "plane"\n'
SEPARATE = (
    'metrosep = 1\n[input]\nfiles = ["{}"]\nx = "x_mm"\nz = "z_um"\nfeed = "feed_mm_min"\nrun = "run"\n'
    'time = "t_ms"\n[[step]]\nop = "separate"\nmethod = "mean"\n'
)


def recipe_of(folder, kind, repository):
    """Write a recipe of a kind with what it reads."""
    import shutil

    if kind == "map":
        part(folder / "p.x3p")
        return written(folder / "r.toml", MAP.format("p.x3p"))
    if kind == "runs":
        runs(folder / "a.csv")
        return written(folder / "r.toml", SEPARATE.format("a.csv"))
    source = (
        repository / "examples" / {"method": "circle_closure", "nothing": "slow_tool_servo"}[kind]
    )
    for file in source.iterdir():
        shutil.copy(file, folder)
    return folder / "recipe.toml"


KINDS = {"map": "map", "runs": "runs", "method": "method", "nothing": "method"}


@pytest.mark.parametrize("kind", KINDS)
def test_a_recipe_of_every_kind_opens_and_its_session_comes_back(tmp_path, repository, kind):
    file = recipe_of(tmp_path, kind, repository)
    before = file.read_text()
    first = session_of(tmp_path, file)
    assert first.kind == KINDS[kind]
    old = tomllib.loads(before).get("title")
    edited(first, ["title"], old, "changed by hand")
    again = session_of(tmp_path, file)

    assert again.document.recipe.title == "changed by hand"
    assert any("taken up again" in m for m in again.state()["messages"])
    assert file.read_text() == before


def test_a_recipe_that_was_changed_elsewhere_since_is_not_replaced_by_its_session(
    tmp_path, repository
):
    import os

    file = recipe_of(tmp_path, "map", repository)
    edited(session_of(tmp_path, file), ["title"], None, "of the page")
    file.write_text('title = "of the editor"\n' + file.read_text())
    later = autosave_path(file).stat().st_mtime + 5
    os.utime(file, (later, later))
    session = session_of(tmp_path, file)
    assert session.document.recipe.title == "of the editor"
    assert any("changed after" in m for m in session.state()["messages"])
    edited(session, ["title"], "of the editor", "new")
    aside = Path(f"{autosave_path(file)}.old")
    assert "of the page" in aside.read_text()  # nothing is lost


def test_an_older_recipe_copied_over_it_is_not_replaced_by_its_session(tmp_path, repository):
    """The time of a file says nothing: a copy may keep the time of its origin."""
    import os

    file = recipe_of(tmp_path, "map", repository)
    edited(session_of(tmp_path, file), ["title"], None, "of the page")
    file.write_text('title = "of a colleague"\n' + file.read_text())
    os.utime(file, (1e9, 1e9))
    session = session_of(tmp_path, file)
    assert session.document.recipe.title == "of a colleague"
    assert any("changed after" in m for m in session.state()["messages"])
    edited(session, ["title"], "of a colleague", "new")
    aside = Path(f"{autosave_path(file)}.old")
    assert "of the page" in aside.read_text()
    assert session_of(tmp_path, file).document.recipe.title == "new"


def test_a_change_by_hand_while_the_recipe_is_open_is_not_lost(tmp_path, repository):
    file = recipe_of(tmp_path, "map", repository)
    session = session_of(tmp_path, file)
    file.write_text('title = "by hand"\n' + file.read_text())
    edited(session, ["step", 0, "form"], "plane", "polynomial: degree=2")
    again = session_of(tmp_path, file)
    assert again.document.recipe.title == "by hand"
    assert any("put aside" in m for m in again.state()["messages"])


@pytest.mark.parametrize("end", ["\n", "", "\n\n", "\n# note"])
@pytest.mark.parametrize("line", ["\n", "\r\n"])
def test_of_which_recipe_a_session_is_stands_not_in_its_text(tmp_path, repository, end, line):
    file = recipe_of(tmp_path, "map", repository)
    file.write_bytes((file.read_text().rstrip("\n") + end).replace("\n", line).encode())
    session = session_of(tmp_path, file)
    edited(session, ["title"], None, "mine")
    kept = autosave_path(file).read_text()
    assert "# of r.toml sha256 " in kept.splitlines()[-1]
    again = session_of(tmp_path, file)
    assert again.document.text == session.document.text
    assert "sha256" not in again.document.text
    edited(again, ["title"], "mine", "again")
    assert autosave_path(file).read_text().count("# of r.toml sha256") == 1


def test_a_session_without_that_line_is_taken_up_by_its_time(tmp_path, repository):
    import os

    file = recipe_of(tmp_path, "map", repository)
    autosave_path(file).write_text('title = "older version"\n' + file.read_text())
    os.utime(file, (1e9, 1e9))
    assert session_of(tmp_path, file).document.recipe.title == "older version"


def test_two_sessions_of_one_file_are_both_kept(tmp_path):
    file = part(tmp_path / "p.x3p")
    one, two = session_of(tmp_path, file), session_of(tmp_path, file)
    edited(one, ["title"], "p", "one")
    edited(two, ["title"], "p", "two")
    edited(one, ["title"], "one", "one more")
    kept = autosave_path(file)
    assert "one more" in kept.read_text()
    assert '"two"' in kept.with_name(f"{kept.name}.other-1").read_text()
    assert any("other-1" in m for m in two.state()["messages"])
    assert not any("other-1" in m for m in one.state()["messages"])


def test_a_file_whose_session_is_not_on_the_disk_is_not_opened_over_it(tmp_path):
    from metrosep.app.sessions import Keeper
    from metrosep.core.errors import WriteError

    full = [True]

    def write(path, content):
        if full[0]:
            raise WriteError("the disk is full")
        path.write_bytes(content)

    file = str(part(tmp_path / "p.x3p"))
    session = Session(Places([tmp_path]), keeper=Keeper(write, again=1000))
    session.open(file)
    edited(session, ["title"], "p", "an hour of work")
    with pytest.raises(DataError, match="make room"):
        session.open(file)
    assert session.document.recipe.title == "an hour of work"
    full[0] = False
    session.open(file)
    assert session.document.recipe.title == "an hour of work"


def test_what_the_user_answers_stands_in_the_recipe(tmp_path):
    i = np.arange(N)
    csv(tmp_path / "a.csv", "x,z", i, np.cos(i))
    file = written(
        tmp_path / "r.toml", MAP.format("a.csv").replace("plane", "polynomial: degree=1")
    )
    with pytest.raises(Ask):
        opened(tmp_path, file)
    one = opened(tmp_path, file, x="x", x_unit="mm", z="z", z_unit="um")
    assert one.kind == "profile"
    assert one.document.recipe.input["z"] == {"column": "z", "unit": "um"}


def test_a_recipe_with_its_file_dropped_together(tmp_path, repository):
    file = recipe_of(tmp_path, "map", repository)
    one = opened(tmp_path, tmp_path / "p.x3p", file)
    assert (one.kind, one.home.name, one.messages) == ("map", "r.toml", ())
    two = opened(tmp_path, part(tmp_path / "other.x3p"), file)
    assert any("other.x3p" in m for m in two.messages)
    written(tmp_path / "s.toml", file.read_text())
    with pytest.raises(DataError, match="one recipe"):
        opened(tmp_path, file, tmp_path / "s.toml")


@pytest.mark.parametrize(
    ("text", "error", "words"),
    [
        ("[[step", RecipeError, r"r\.toml"),
        (MAP.format("missing.x3p"), ReadError, r"missing\.x3p"),
        (MAP.format("../../secret.x3p"), MetrosepError, "secret"),
        (
            'metrosep = 1\n[input]\n[[step]]\nop = "form"\nform = "plane"\n',
            ReadError,
            "names no file",
        ),
    ],
)
def test_a_wrong_recipe_is_refused(tmp_path, text, error, words):
    with pytest.raises(error, match=words):
        opened(tmp_path, written(tmp_path / "r.toml", text))


# ---- kept sessions -----------------------------------------------------------------------------


def _kind_of_file(folder, kind):
    if kind == "map":
        return [part(folder / "p.x3p")], {}
    if kind == "profile":
        i = np.arange(N)
        file = csv(folder / "p.csv", "x,z,temp", i, np.cos(i), i)
        return [file], {"x": "x", "x_unit": "mm", "z": "z", "z_unit": "um"}
    if kind == "one file of runs":
        return [runs(folder / "a.csv")], {**COLUMNS, "run": "run"}
    return _set(folder), COLUMNS


@pytest.mark.parametrize("kind", ["map", "profile", "one file of runs", "set"])
def test_a_session_of_every_kind_comes_back_without_asking(tmp_path, kind):
    files, reading = _kind_of_file(tmp_path, kind)
    first = session_of(tmp_path, *files, **reading)
    edited(first, ["title"], first.document.recipe.title, "changed by hand")
    again = session_of(tmp_path, *files[::-1])

    assert (again.kind, again.document.text) == (first.kind, first.document.text)
    assert any("taken up again" in m for m in again.state()["messages"])


@pytest.mark.parametrize("kind", ["map", "recipe"])
def test_undo_and_redo_go_on_where_a_server_ended(tmp_path, kind):
    file = part(tmp_path / "p.x3p")
    if kind == "recipe":
        file = written(tmp_path / "r.toml", MAP.format("p.x3p"))
    first = session_of(tmp_path, file)
    texts = [first.document.text]
    for name in ("one", "two # \u00b5m", "three"):
        edited(first, ["title"], first.document.recipe.title or None, name)
        texts.append(first.document.text)
    first.undo()
    again = session_of(tmp_path, file)
    assert again.document.text == texts[2]
    assert (again.state()["can_undo"], again.state()["can_redo"]) == (True, True)
    again.redo()
    assert again.document.text == texts[3]
    for text in texts[2::-1]:
        again.undo()
        assert again.document.text == text
    assert again.state()["can_undo"] is False
    assert tomllib.loads(first.opened.kept.read_text("utf-8"))["metrosep"] == 1


@pytest.mark.parametrize("damage", ["cut", "not base64", "not zlib", "a number", "deep"])
def test_a_history_that_cannot_be_read_costs_nothing_else(tmp_path, damage):
    import base64
    import zlib

    file = part(tmp_path / "p.x3p")
    first = session_of(tmp_path, file)
    edited(first, ["title"], first.document.recipe.title, "changed by hand")
    kept = first.opened.kept
    text, _, history = kept.read_text("utf-8").rpartition("# undo ")
    packed = {
        "cut": history.strip()[: len(history) // 8 * 4],
        "not base64": "AAAAA",
        "not zlib": "AAAA",
        "a number": base64.b64encode(zlib.compress(b"7")).decode(),
        "deep": base64.b64encode(zlib.compress(b"[" * 200_000)).decode(),
    }[damage]
    kept.write_text(f"{text}# undo {packed}\n", "utf-8")
    again = session_of(tmp_path, file)
    assert again.document.text == first.document.text
    assert again.state()["can_undo"] is False


def test_each_set_and_each_file_has_its_own_session(tmp_path):
    files = _set(tmp_path)
    for chosen in (files, files[:2]):
        session = session_of(tmp_path, *chosen, **COLUMNS)
        edited(session, ["title"], "r0", f"{len(chosen)} runs")
    for chosen in (files, files[:2]):
        assert session_of(tmp_path, *chosen).document.recipe.title == f"{len(chosen)} runs"
    with pytest.raises(Ask):
        opened(tmp_path, files[0])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("metrosep = 1\n[[step", "is not used"),
        (MAP.format("other.x3p"), "of other files"),
        (MAP.format("p.x3p").replace("[input]", '[input]\nchannel = "nothing"'), "is not used"),
        ("\udcff", "is not used"),
    ],
)
def test_a_session_that_does_not_fit_is_told_and_put_aside(tmp_path, text, words):
    file = part(tmp_path / "p.x3p")
    kept = autosave_path(file)
    kept.write_bytes(text.encode("utf-8", "surrogateescape"))
    session = session_of(tmp_path, file)
    assert session.kind == "map"
    assert any(words in m for m in session.state()["messages"])
    edited(session, ["title"], "p", "mine")
    assert kept.with_name(f"{kept.name}.old").read_bytes() == text.encode(
        "utf-8", "surrogateescape"
    )
    assert session_of(tmp_path, file).document.recipe.title == "mine"


# ---- edits of [input] --------------------------------------------------------------------------


def test_another_column_is_read_and_undone(tmp_path):
    i = np.arange(N)
    file = csv(tmp_path / "p.csv", "x_mm,a_um,b_um", i, np.zeros(N), np.cos(i))
    session = session_of(tmp_path, file, x="x_mm", z="a_um")
    edited(session, ["input", "z"], "a_um", "b_um")
    assert session.evaluations.obj.z[0] == pytest.approx(1e-6, abs=1e-18)
    session.undo()
    assert session.evaluations.obj.z[0] == 0.0
    session.redo()
    assert session.evaluations.obj.z[0] == pytest.approx(1e-6, abs=1e-18)


def test_a_column_that_is_not_there_is_refused_and_the_history_stays(tmp_path):
    i = np.arange(N)
    file = csv(tmp_path / "p.csv", "x_mm,a_um,b_um", i, np.zeros(N), np.cos(i))
    session = session_of(tmp_path, file, x="x_mm", z="a_um")
    edited(session, ["title"], "p", "one")
    edited(session, ["title"], "one", "two")
    session.undo()
    before = session.state()
    with pytest.raises(MetrosepError, match="c_um"):
        session.edit([Edit(("input", "z"), "a_um", "c_um")])

    assert session.state() == before
    session.redo()
    assert session.document.recipe.title == "two"


def test_another_column_of_runs_is_read(tmp_path):
    file = runs(tmp_path / "a.csv")
    session = session_of(tmp_path, file, **COLUMNS, run="run")
    with pytest.raises(MetrosepError, match="nothing"):
        session.edit([Edit(("input", "run"), "run", "nothing")])
    edited(session, ["input", "time"], "t_ms", None)
    assert "time" not in session.document.recipe.input


def test_the_files_are_chosen_by_opening(tmp_path):
    part(tmp_path / "b.x3p")
    session = session_of(tmp_path, part(tmp_path / "a.x3p"))
    with pytest.raises(DataError, match="open the other files"):
        session.edit([Edit(("input", "files", 0), "a.x3p", "b.x3p")])


# ---- what cannot be opened ---------------------------------------------------------------------


def test_too_large_for_the_memory_is_said(tmp_path):
    def read(file, **options):
        raise MemoryError

    with pytest.raises(ReadError, match=r"a\.x3p: too large for the memory"):
        open_files(Places([tmp_path]), [str(part(tmp_path / "a.x3p"))], read=read)


def test_an_option_that_is_none_is_refused(tmp_path):
    with pytest.raises(DataError, match="colour"):
        opened(tmp_path, part(tmp_path / "a.x3p"), colour="blue")
    with pytest.raises(DataError, match="name a file"):
        opened(tmp_path)


def test_what_failed_to_open_leaves_what_is_open(tmp_path):
    session = session_of(tmp_path, part(tmp_path / "a.x3p"))
    before = session.state()
    written(tmp_path / "b.x3p", "PK nonsense")
    with pytest.raises(MetrosepError, match=r"b\.x3p"):
        session.open(str(tmp_path / "b.x3p"))
    assert session.state() == before


# ---- roundness traces --------------------------------------------------------------------------


def answers_of(folder, name, lines):
    (folder / name).write_text("\n".join(lines) + "\n")
    return Answers(Session(Places([folder])))


def test_a_trace_opens_by_what_the_question_proposes(tmp_path):
    """Two lobes of 1.5 um about a centre 4 um off: RONt 3 um."""
    a = np.radians(np.arange(0.0, 360.0, 2.0))
    rows = 4.0 * np.sin(a) + 1.5 * np.cos(2.0 * a)
    lines = [
        "angle_deg,r_um",
        *(f"{np.degrees(p):.3f},{r:.9f}" for p, r in zip(a, rows, strict=True)),
    ]
    answers = answers_of(tmp_path, "t.csv", lines)
    with pytest.raises(Ask) as asked:
        answers.answer({"k": "open", "path": "t.csv"})
    given = {f["name"]: f["value"] for f in asked.value.fields}
    session = answers.answer({"k": "open", "path": "t.csv", "reading": given})[0]["session"]
    assert (session["kind"], session["op"]) == ("method", "roundness")
    rows = {r["symbol"]: r for r in answers.answer({"k": "metrics", "level": "full"})[0]["rows"]}
    assert rows["RONt"]["value"] == pytest.approx(3e-6, abs=1e-9)


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ({"angle": "r_um", "radius": "angle_deg"}, "an angle is needed"),
        ({"angle": "angle_deg"}, "the radius of the trace is not named"),
        ({"angle": "angle_deg", "radius": "r_um", "x": "r_um"}, "not both"),
    ],
)
def test_a_wrong_answer_about_a_trace_comes_back_with_its_reason(tmp_path, given, why):
    lines = ["angle_deg,r_um", *(f"{k},{k % 7}" for k in range(0, 360, 5))]
    answers = answers_of(tmp_path, "t.csv", lines)
    with pytest.raises(Ask, match=why) as asked:
        answers.answer({"k": "open", "path": "t.csv", "reading": given})
    assert {f["name"]: f["value"] for f in asked.value.fields}["angle"] == given["angle"]


def refused(answers, given, *names):
    """The question that comes back, and what stands in its fields."""
    with pytest.raises(Ask) as asked:
        answers.answer({"k": "open", "paths": list(names), "reading": given})
    return str(asked.value), {f["name"]: f["value"] for f in asked.value.fields if f["value"]}


def test_a_wrong_unit_of_a_trace_is_put_right_in_its_own_field(tmp_path):
    lines = ["Winkel;dev:R", *(f"{k};{k % 7}" for k in range(0, 360, 5))]
    answers = answers_of(tmp_path, "t.csv", lines)
    given = {"angle": "Winkel", "angle_unit": "rad", "radius": "dev:R", "radius_unit": "um"}
    why, fields = refused(answers, given, "t.csv")
    assert "turns" in why
    assert fields == given
    again = {**fields, "angle_unit": "deg"}
    session = answers.answer({"k": "open", "path": "t.csv", "reading": again})[0]["session"]
    assert session["input"]["angle"] == "Winkel:deg"


def test_a_missing_unit_is_asked_for_without_a_call_of_python(tmp_path):
    lines = ["Winkel;dev:R", *(f"{k};{k % 7}" for k in range(0, 360, 5))]
    answers = answers_of(tmp_path, "t.csv", lines)
    given = {"angle": "Winkel", "radius": "dev:R", "radius_unit": "um"}
    why, fields = refused(answers, given, "t.csv")
    assert "declares no unit" in why
    assert "=" not in why
    assert fields == given


def test_a_wrong_unit_of_runs_comes_back_with_what_was_given(tmp_path):
    for name in ("a.csv", "b.csv"):
        answers = answers_of(tmp_path, name, ["p,q,n", *(f"{k},{k % 7},1" for k in range(200))])
    why, fields = refused(answers, {"x": "p", "x_unit": "um", "z": "q"}, "a.csv", "b.csv")
    assert "'q'" in why
    assert "=" not in why
    assert fields == {"x": "p", "x_unit": "um", "z": "q"}


@pytest.mark.parametrize("step", ["2 um, 3 um, 4 um", "2 um, 0 um", "2 um x"])
def test_a_wrong_lateral_step_brings_the_question_back(tmp_path, step):
    rows = [",".join(str((3 * i + j) % 11) for j in range(12)) for i in range(9)]
    answers = answers_of(tmp_path, "m.csv", rows)
    given = {"unit": "um", "lateral_step": step, "row_order": "top row first"}
    why, fields = refused(answers, given, "m.csv")
    assert "step" in why
    assert fields == given


def test_a_worksheet_of_a_talyrond_asks_for_its_unit_only(tmp_path, corpus):
    data = (corpus / "round" / "talyrond_profile.xlsx").read_bytes()
    (tmp_path / "t.xlsx").write_bytes(data)
    answers = Answers(Session(Places([tmp_path])))
    with pytest.raises(Ask) as asked:
        answers.answer({"k": "open", "path": "t.xlsx"})
    given = {f["name"]: f["value"] for f in asked.value.fields}
    assert set(given) == {"angle", "angle_unit", "radius", "radius_unit", "height"}
    with pytest.raises(Ask, match="unit"):
        answers.answer({"k": "open", "path": "t.xlsx", "reading": given})
    given["radius_unit"] = "um"
    session = answers.answer({"k": "open", "path": "t.xlsx", "reading": given})[0]["session"]
    assert session["op"] == "roundness"


def test_a_profile_has_the_ends_of_its_file_though_columns_hold_several_samples(tmp_path):
    lines = ["x_mm,z_um", *(f"{0.001 * k:.3f},{k % 5}" for k in range(3001))]
    answers = answers_of(tmp_path, "p.csv", lines)
    answers.answer({"k": "open", "path": "p.csv"})
    header, arrays = answers.answer({"k": "profile", "series": ["residual"], "columns": 100})
    assert header["extent"] == pytest.approx([0.0, 3e-3], abs=1e-15)
    assert arrays["residual_x"][0] > 5e-6  # the middle of its samples
