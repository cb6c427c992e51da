"""The recipe as the only state: edits, undo, refusal of what does not fit."""

import tomllib

import pytest

from metrosep.app.documents import Edit, RecipeDocument, start_text
from metrosep.errors import DataError, RecipeError, WriteError

TEXT = """\
# measured on Monday
metrosep = 1
title = "Part 7"

[input]
files = ["part.sdf"]

[[step]]
op = "form"        # level
form = "plane"

[[step]]
op = "filter"
cutoff = "25 um"

[[step]]
op = "parameters"
"""


@pytest.fixture
def document(tmp_path):
    return RecipeDocument(TEXT, tmp_path)


def change(path, old, new):
    return Edit.from_message({"path": path, "old": old, "new": new})


def steps(document):
    return tomllib.loads(document.text)["step"]


def test_an_edit_changes_one_value_and_keeps_comments(document):
    document.edit([change(["step", 1, "cutoff"], "25 um", "80 um")])

    assert steps(document)[1]["cutoff"] == "80 um"
    assert "# measured on Monday" in document.text
    assert "# level" in document.text
    assert document.recipe.steps[1]["cutoff"] == pytest.approx(80e-6, abs=1e-18)


def test_undo_and_redo_give_the_very_text(document):
    texts = [document.text]
    for value in ("30 um", "40 um", "50 um"):
        document.edit([change(["step", 1, "cutoff"], steps(document)[1]["cutoff"], value)])
        texts.append(document.text)
    for text in reversed(texts[:-1]):
        document.undo()
        assert document.text == text
    with pytest.raises(DataError, match="nothing to undo"):
        document.undo()
    for text in texts[1:]:
        document.redo()
        assert document.text == text
    with pytest.raises(DataError, match="nothing to redo"):
        document.redo()


def test_a_step_that_cannot_be_taken_now_is_not_lost(tmp_path):
    base = tmp_path / "base.toml"
    base.write_text(TEXT)
    document = RecipeDocument(
        'metrosep = 1\nextends = "base.toml"\ntitle = "one"\n', folder=tmp_path
    )
    for old, new in (("one", "two"), ("two", "three")):
        document.edit([change(["title"], old, new)])

    def refused(move):
        base.rename(tmp_path / "away.toml")
        for _ in range(3):
            with pytest.raises(RecipeError, match="cannot be read"):
                move()
        (tmp_path / "away.toml").rename(base)

    for move, titles in ((document.undo, ("two", "one")), (document.redo, ("two", "three"))):
        for title in titles:
            refused(move)
            move()
            assert tomllib.loads(document.text)["title"] == title


def test_a_new_edit_ends_redo(document):
    document.edit([change(["title"], "Part 7", "Part 8")])
    document.undo()
    document.edit([change(["title"], "Part 7", "Part 9")])
    with pytest.raises(DataError, match="nothing to redo"):
        document.redo()


def test_two_hundred_edits_can_be_undone(document):
    for i in range(230):
        old = tomllib.loads(document.text)["title"]
        document.edit([change(["title"], old, f"Part {i + 100}")])
    for _ in range(200):
        document.undo()
    assert tomllib.loads(document.text)["title"] == "Part 129"
    with pytest.raises(DataError, match="nothing to undo"):
        document.undo()


def test_steps_are_added_switched_off_and_removed(document):
    document.edit(
        [
            change(
                ["step", 3],
                None,
                {"op": "mask", "aperture": {"shape": "circle", "diameter": "4 mm"}},
            )
        ]
    )
    document.edit([change(["step", 1, "enabled"], None, False)])
    document.edit([change(["step", 0], {"op": "form", "form": "plane"}, None)])

    assert [s["op"] for s in steps(document)] == ["filter", "parameters", "mask"]
    assert steps(document)[0]["enabled"] is False
    assert document.text.count("[[step]]") == 3


def test_two_steps_change_places_in_one_edit(document):
    first, second = steps(document)[:2]
    document.edit([change(["step", 0], first, second), change(["step", 1], second, first)], "move")

    assert [s["op"] for s in steps(document)] == ["filter", "form", "parameters"]
    assert document.undo_label == "move"
    document.undo()
    assert document.text == TEXT


def test_a_check_can_be_added_where_there_was_none(document):
    document.edit([change(["check", 0], None, {"metric": "Sa", "upper": "6 nm"})])

    assert document.recipe.checks[0]["metric"] == "Sa"


@pytest.mark.parametrize(
    ("path", "old", "new", "error"),
    [
        (["step", 1, "cutoff"], "25 um", "25", RecipeError),
        (["step", 1, "cutoff"], "25 um", "25 kg", RecipeError),
        (["step", 1, "cutof"], None, "25 um", RecipeError),
        (["step", 1, "cutoff"], "30 um", "40 um", DataError),
        (["step", 9, "cutoff"], None, "40 um", DataError),
        (["step", 5], None, {"op": "mask"}, DataError),
        (["step", "x"], None, 1, DataError),
        (["step", 1, "cutoff", "a"], None, 1, DataError),
        (["nothing"], None, None, DataError),
        (["metrosep"], 1, 2, RecipeError),
        (["title"], "Part 7", object(), DataError),
    ],
)
def test_what_does_not_fit_changes_nothing(document, path, old, new, error):
    with pytest.raises(error):
        document.edit([change(path, old, new)])
    assert document.text == TEXT
    assert document.undo_label is None


@pytest.mark.parametrize(
    "path", [None, [], "step", [1], [""], [True], [1.5], [None], ["step", -1]]
)
def test_a_path_is_keys_and_indices(path):
    with pytest.raises(DataError, match="path"):
        Edit.from_message({"path": path, "old": None, "new": 1})


def test_edits_are_all_or_none(document):
    with pytest.raises(DataError):
        document.edit([change(["title"], "Part 7", "x"), change(["title"], "Part 7", "y")])
    assert document.text == TEXT


def test_a_full_disk_loses_nothing(document, tmp_path):
    path = tmp_path / "kept.toml"
    document.save(path)

    def full(path, data):
        raise WriteError("no room")

    document.edit([change(["title"], "Part 7", "Part 8")])
    with pytest.raises(WriteError):
        document.save(path, write=full)
    assert path.read_text() == TEXT


@pytest.mark.parametrize("kind", ["map", "profile"])
def test_a_session_starts_with_a_recipe(kind, tmp_path):
    text = start_text("a 'b\" c.sdf", kind, {"unit": "um"})

    recipe = RecipeDocument(text, tmp_path).recipe
    assert recipe.input["files"] == ("a 'b\" c.sdf",) or list(recipe.input["files"]) == [
        "a 'b\" c.sdf"
    ]
    assert recipe.steps[0]["op"] == "form"
