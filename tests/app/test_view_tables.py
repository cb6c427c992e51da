"""What is shown is kept in [view]: no edit, no other numbers; another file by the same recipe."""

import datetime as dt

import numpy as np
import pytest

import metrosep as ms
from metrosep.app.documents import Places
from metrosep.app.server import Answers
from metrosep.app.sessions import Session
from metrosep.app.view_tables import shown_view, view_of, with_view
from metrosep.app.wire import pack
from metrosep.core.errors import DataError
from metrosep.recipe.outputs import recipe_hash
from metrosep.recipe.recipe import Recipe, without_view_block

VIEW = {"tab": "report", "section_mm": [[0.1, 0.2], [1.5, 0.2]], "band_mm": [0.1, 2.0]}


def part(path, height):
    z = height * np.exp(-(((np.arange(50) - 20) / 8.0) ** 2))[None, :] * np.ones((40, 1))
    ms.write(ms.Surface(z, 1e-4, 1e-4), path)
    return path


@pytest.fixture
def answers(tmp_path):
    session = Session(Places([tmp_path]))
    answers = Answers(session)
    answers.answer({"k": "open", "path": str(part(tmp_path / "a.x3p", 1e-6))})
    return answers


def test_view_is_no_edit_and_survives_undo(answers):
    session = answers.session
    before = session.state()
    answers.answer({"k": "view", "view": VIEW})
    after = session.state()
    assert after["view"] == VIEW
    assert not after["can_undo"]
    assert after["hash"] == before["hash"]
    answers.answer({"k": "edit", "path": ["title"], "old": "a", "new": "b"})
    answers.answer({"k": "undo"})
    assert session.state()["view"] == VIEW
    assert session.state()["title"] == "a"


def test_view_changes_no_number_and_no_recipe_hash(answers):
    text = answers.session.state()["recipe"]
    shown = with_view(text, VIEW)
    assert view_of(shown) == VIEW
    assert recipe_hash(Recipe.parse(shown)) == recipe_hash(Recipe.parse(text))
    assert without_view_block(shown) == without_view_block(text)
    assert without_view_block(with_view(shown, {"tab": "map"})) == without_view_block(text)


def test_view_does_not_stand_in_the_result(answers, tmp_path):
    plain = Recipe.parse(answers.session.state()["recipe"], folder=tmp_path).run(
        out=tmp_path / "1"
    )
    shown = with_view(answers.session.state()["recipe"], VIEW)
    Recipe.parse(shown, folder=tmp_path).run(out=tmp_path / "2")
    one, two = ((tmp_path / k / "result.json").read_bytes() for k in ("1", "2"))
    assert one == two
    assert plain.document["recipe"]["text"] == answers.session.state()["recipe"]


def test_a_view_within_a_text_or_between_tables():
    text = 'metrosep = 1\ntitle = """\n[view]\n"""\n[view] # x\ntab = "a"\n\n[input]\nfiles = []\n'
    left = without_view_block(text)
    assert left == 'metrosep = 1\ntitle = """\n[view]\n"""\n[input]\nfiles = []\n'


def test_comments_and_later_tables_stay():
    text = 'metrosep = 1  # first\n[view]\ntab = "a"\n[input]\nfiles = ["x"] # these\n'
    changed = with_view(text, {"tab": "b"})
    assert "# first" in changed
    assert "# these" in changed
    assert changed.index("[input]") < changed.index("[view]")


@pytest.mark.parametrize(
    "view",
    [
        {"colour": "viridis"},
        {"tab": 3},
        {"tab": "a\nb"},
        {"band_mm": [2.0, 1.0]},
        {"band_px": [2.0, 1.0]},
        {"band_mm": [-2.0, 1.0]},
        {"band_mm": [1.0, 10**400]},
        {"section_mm": [[0.0, 1.0], [0.0, 1.0]]},
        {"section_mm": [[0, 1], [float("nan"), 1]]},
        {"hill_shade": "yes"},
        ["tab"],
    ],
)
def test_what_is_no_view_is_refused(answers, view):
    with pytest.raises(DataError, match="view"):
        answers.answer({"k": "view", "view": view})


def test_another_file_by_the_same_recipe(answers, tmp_path):
    check = {"metric": "Sz", "upper": "1.5 um", "U": "10 nm"}
    answers.answer({"k": "edit", "path": ["check", 0], "old": None, "new": check})
    part(tmp_path / "b.x3p", 2e-6)
    answers.answer({"k": "open", "path": "b.x3p", "keep_recipe": True})
    state = answers.session.state()
    assert state["checks"] == [check]
    assert 'files = ["b.x3p"]' in state["recipe"]
    header, _ = answers.answer({"k": "metrics", "level": "full"})
    alone = Recipe.parse(state["recipe"], folder=tmp_path).run()
    assert header["verdict"] == alone.verdict
    values = {c["metric"]: c["value"] for c in alone.document["characteristics"]}
    assert {r["symbol"]: r["value"] for r in header["rows"]}["Sz"] == values["Sz"]


def test_recipe_of_a_map_is_not_for_runs_nor_for_recipes(answers, tmp_path):
    rows = [f"{k},{0.01 * i},{(i + k) % 7}" for k in range(3) for i in range(60)]
    (tmp_path / "runs.csv").write_text("\n".join(["run,x_mm,z_um", *rows]) + "\n")
    reading = {"x": "x_mm", "z": "z_um", "run": "run"}
    with pytest.raises(DataError, match="runs"):
        answers.answer({"k": "open", "path": "runs.csv", "reading": reading, "keep_recipe": True})
    (tmp_path / "r.toml").write_text(answers.session.state()["recipe"])
    with pytest.raises(DataError, match="by itself"):
        answers.answer({"k": "open", "path": "r.toml", "keep_recipe": True})
    assert answers.session.state()["files"] == [str(tmp_path / "a.x3p")]


BY_HAND = {
    "section_mm = [1, 2]": "section_mm",
    "section_mm = [[0, 0]]": "section_mm",
    "section_mm = [[1, 2], [1, 2]]": "section_mm",
    "section_mm = [[nan, 2], [1, 2]]": "section_mm",
    'section_mm = "x"': "section_mm",
    "section_px = [[1], [2]]": "section_px",
    'band_mm = ["a", 1]': "band_mm",
    "band_mm = [1]": "band_mm",
    "band_mm = [2, -1]": "band_mm",
    "band_mm = [0, 1]": "band_mm",
    "band_mm = [1, inf]": "band_mm",
    "tab = 2026-11-22": "tab",
    "hill_shade = 1": "hill_shade",
    "made = 2026-11-22T03:00:00": "made",
}


@pytest.mark.parametrize("line", BY_HAND)
def test_what_was_written_by_hand_and_does_not_fit_is_not_shown(line):
    good = 'colours = "gray"\nband_mm = [1, 2]\n' if "band" not in line else 'colours = "gray"\n'
    held = view_of(f"metrosep = 1\n[view]\n{good}{line}\n")
    shown = shown_view(held)
    assert BY_HAND[line] in held
    assert BY_HAND[line] not in shown
    assert shown == {k: v for k, v in held.items() if k != BY_HAND[line]}


def test_what_fits_is_shown_and_what_is_no_table_is_none():
    assert shown_view(VIEW) == VIEW
    assert shown_view(5) == {}
    assert shown_view({"made": {"at": dt.date(2026, 11, 22)}}) == {}
    assert view_of("metrosep = 1\nview = 5\n") == {}


@pytest.mark.parametrize("line", BY_HAND)
def test_a_session_shows_only_what_fits(tmp_path, line):
    part(tmp_path / "a.x3p", 1e-6)
    recipe = tmp_path / "r.toml"
    recipe.write_text(
        'metrosep = 1\n[input]\nfiles = ["a.x3p"]\n[[step]]\nop = "form"\nform = "plane"\n'
        f'[[step]]\nop = "parameters"\n[view]\n{line}\n'
    )
    session = Session(Places([tmp_path]))
    session.open([str(recipe)])
    state = session.state()
    assert state["view"] == {}
    pack(state)


def test_an_array_over_several_lines_is_taken_out_whole():
    text = (
        "metrosep = 1\n[view]\nsection_mm = [\n  [0, 0],\n  [1, 1],\n]\n"
        "[input]\nfiles = [\n  'a',\n]\n"
    )
    assert without_view_block(text) == "metrosep = 1\n[input]\nfiles = [\n  'a',\n]\n"
