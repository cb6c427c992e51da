"""Output folders of batches: no inputs of another one, and each for the inputs of one folder."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from metrosep.batch import find_units, run_batch
from metrosep.core.errors import ReadError, WriteError
from metrosep.recipe import Recipe

pytestmark = pytest.mark.usefixtures("without_figures")  # no test here looks at one

WRITES = '[[output]]\nkind = "parts"\n'


def run(recipe, folder, out, **options):
    return run_batch(recipe, folder, out=out, scheduler="serial", **options)


def names(found):
    return [u.name for u in found.units]


@pytest.fixture
def writing(recipe_text):
    """A recipe that writes files which fit its own patterns' kind: metrosep's own .h5."""
    text = recipe_text.replace('"*.sur"]', '"*.sur", "*.h5", "*.csv"]') + WRITES
    return Recipe.parse(text)


# ---- what an earlier batch wrote is not an input


def test_the_results_of_an_earlier_batch_inside_the_folder_are_left_out_and_told(
    writing, inbox, tmp_path
):
    run(writing, inbox, inbox / "old/qa")
    written = [f for f in (inbox / "old/qa").glob("*/*/*") if f.suffix in (".h5", ".csv")]
    assert written, "the recipe must write what it would read"
    report = run(writing, inbox, tmp_path / "qa")
    assert report.counts["total"] == 6
    (told,) = [m for m in report.messages if "output folders of batches" in m]
    n = sum(1 for f in (inbox / "old/qa").rglob("*") if f.is_file() and f.name[0] != ".")
    assert told.startswith(f"1 below {inbox} ")
    assert f"({n} files)" in told
    assert told.endswith("old/qa")


@pytest.mark.parametrize("kept", ["lock", "index", "marks"])
def test_it_is_known_by_any_of_what_it_holds(writing, inbox, tmp_path, kept):
    run(writing, inbox, tmp_path / "first")
    copy = inbox / "copy"
    shutil.copytree(tmp_path / "first", copy)
    for file in [*copy.glob(".metrosep*")] if kept != "lock" else [copy / "index.json"]:
        file.unlink()
    if kept == "marks":
        (copy / "index.json").unlink()
        (copy / "index.csv").unlink()
    found = find_units(writing, inbox)
    assert len(found.units) == 6
    assert any("output folders of batches" in m for m in found.messages)


def test_an_index_of_something_else_and_folders_of_eight_digits_are_inputs(recipe, inbox, parts):
    (inbox / "index.json").write_text('{"schema": "my.index/1"}')
    parts(inbox / "20260101/P_9.sdf", 6e-9)
    (inbox / "20260101/result.json").write_text('{"unit": {"name": "of my own program"}}')
    found = find_units(recipe, inbox)
    assert "20260101/P_9.sdf" in names(found)
    assert found.messages == ()


def test_an_output_folder_as_input_is_refused(writing, inbox, tmp_path):
    run(writing, inbox, tmp_path / "qa")
    with pytest.raises(ReadError, match=r"output folder of a batch.*measured files"):
        run(writing, tmp_path / "qa", tmp_path / "again")
    assert not (tmp_path / "again").exists()


def test_inputs_below_their_output_folder_stay_inputs(recipe, inbox, tmp_path):
    assert run(recipe, inbox, tmp_path).counts["total"] == 6
    assert run(recipe, inbox, tmp_path).counts["skipped"] == 6


def test_a_folder_with_nothing_else_says_so(writing, inbox, tmp_path):
    run(writing, inbox, tmp_path / "day/qa")
    with pytest.raises(ReadError, match="1 output folder"):
        run(writing, tmp_path / "day", tmp_path / "again")


# ---- one output folder, one input folder


@pytest.fixture
def other(tmp_path, parts):
    """Another folder with two of the same names, of other parts."""
    folder = tmp_path / "other"
    parts(folder / "mo/P_0.sdf", 14e-9)
    parts(folder / "mo/P_1.x3p", 6e-9)
    return folder


def everything(folder: Path) -> dict[str, bytes]:
    return {str(f.relative_to(folder)): f.read_bytes() for f in folder.rglob("*") if f.is_file()}


@pytest.mark.parametrize("dry_run", [False, True])
def test_the_output_folder_of_another_folder_is_refused(recipe, inbox, other, tmp_path, dry_run):
    run(recipe, inbox, tmp_path / "qa")
    before = everything(tmp_path / "qa")
    with pytest.raises(WriteError, match=rf"{inbox}.*its own output folder") as told:
        run(recipe, other, tmp_path / "qa", dry_run=dry_run)
    assert str(tmp_path / "qa") in str(told.value)
    assert everything(tmp_path / "qa") == before


def test_a_part_of_the_folder_is_another_folder(recipe, inbox, tmp_path):
    run(recipe, inbox / "mo", tmp_path / "qa")
    with pytest.raises(WriteError, match="its own output folder"):
        run(recipe, inbox, tmp_path / "qa")


def test_the_same_folder_by_another_way_is_the_same(recipe, inbox, tmp_path, monkeypatch):
    run(recipe, inbox, tmp_path / "qa")
    (tmp_path / "link").symlink_to(inbox)
    assert run(recipe, tmp_path / "link", tmp_path / "qa").counts["skipped"] == 6
    monkeypatch.chdir(tmp_path)
    assert run(recipe, "inbox", "qa").counts["skipped"] == 6


def test_both_moved_together_are_the_same(recipe, inbox, tmp_path):
    run(recipe, inbox, tmp_path / "qa")
    (tmp_path / "archive").mkdir()
    for name in ("inbox", "qa"):
        shutil.copytree(tmp_path / name, tmp_path / "archive" / name)
    report = run(recipe, tmp_path / "archive/inbox", tmp_path / "archive/qa")
    assert report.counts["skipped"] == 6
    assert not any("before" in m for m in report.messages)


def test_a_folder_that_was_renamed_goes_on_and_is_told(recipe, inbox, tmp_path):
    run(recipe, inbox, tmp_path / "qa")
    inbox.rename(tmp_path / "lot 12")
    report = run(recipe, tmp_path / "lot 12", tmp_path / "qa")
    assert report.counts["skipped"] == 6
    assert any("inbox" in m and "not there any more" in m for m in report.messages)
    again = run(recipe, tmp_path / "lot 12", tmp_path / "qa")
    assert not any("not there any more" in m for m in again.messages)


def test_no_result_and_no_index_names_the_folder(recipe, inbox, tmp_path):
    report = run(recipe, inbox, tmp_path / "qa")
    text = json.dumps(report.document)
    assert "inbox" not in text
    assert (tmp_path / "qa/.metrosep-batch.source").is_file()


def test_a_damaged_record_is_refused(recipe, inbox, tmp_path):
    run(recipe, inbox, tmp_path / "qa")
    (tmp_path / "qa/.metrosep-batch.source").write_text('{"inputs"')
    with pytest.raises(WriteError, match=r"metrosep-batch.source.*damaged"):
        run(recipe, inbox, tmp_path / "qa")
