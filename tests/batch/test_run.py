"""A batch in this process: verdicts against truth, marks, resume, what is kept apart, refusals."""

from __future__ import annotations

import csv
import errno
import json
import os
import threading
import time
from pathlib import Path

import pytest

from metrosep.batch import run_batch, work
from metrosep.batch.run import locked
from metrosep.batch.units import write_mark
from metrosep.core.errors import DataError, ReadError, RecipeError, WriteError
from metrosep.recipe import Recipe
from metrosep.recipe.run import run_recipe

pytestmark = pytest.mark.usefixtures("without_figures")  # no test here looks at one

TRUTH = {0: "accepted", 1: "rejected", 2: "inconclusive"}


NOTHING_TO_READ = """metrosep = 1
[[step]]
op = "rank"
machine = "m.toml"
radius = "10 mm"
form = "plane"
"""


def run(recipe, folder, out, **options):
    return run_batch(recipe, folder, out=out, **{"scheduler": "serial", **options})


def stamps(out: Path) -> dict[str, tuple[int, int]]:
    """Which file each result is: done again, it would be another one."""
    return {
        str(f.relative_to(out)): (f.stat().st_ino, f.stat().st_mtime_ns)
        for f in out.glob("*/*/result.json")
    }


def statuses(report) -> dict[str, str]:
    return {r["unit"]: r["status"] for r in report.rows}


@pytest.mark.parametrize("scheduler", ["serial", "threads"])
def test_every_verdict_is_right_and_lies_where_it_belongs(recipe, inbox, tmp_path, scheduler):
    report = run(recipe, inbox, tmp_path / "qa", scheduler=scheduler, workers=2)
    assert statuses(report) == {
        f"{day}/P_{i}.{s}": TRUTH[i]
        for day in ("mo", "tu")
        for i, s in enumerate(("sdf", "x3p", "sur"))
    }
    assert report.exit_code == 1
    assert report.counts["total"] == 6
    assert report.counts["open"] == 0
    for row in report.rows:
        document = json.loads((tmp_path / "qa" / row["link"]).read_text())
        assert row["link"] == f"{row['key']}/{row['hash'][:8]}/result.json"
        assert document["schema"] == "metrosep.result/1"
        assert document["unit"]["hash"] == row["hash"]
        assert document["unit"]["name"] == row["unit"]
        assert str(tmp_path) not in json.dumps(document)
    assert not list((tmp_path / "qa").glob("**/.metrosep-*/"))


def test_the_same_name_and_content_twice_are_two_results(recipe, inbox, tmp_path):
    report = run(recipe, inbox, tmp_path / "qa")
    by_name = {r["unit"]: r for r in report.rows}
    a, b = by_name["mo/P_0.sdf"], by_name["tu/P_0.sdf"]
    assert a["input_sha256"] == b["input_sha256"]
    assert a["link"] != b["link"]


def test_a_second_run_does_nothing_again(recipe, inbox, tmp_path):
    out = tmp_path / "qa"
    first = run(recipe, inbox, out)
    before = stamps(out)
    index = (out / "index.json").read_bytes()
    second = run(recipe, inbox, out)
    assert stamps(out) == before
    assert len(before) == 6
    assert second.counts["skipped"] == 6
    assert statuses(second) == statuses(first)
    assert (out / "index.json").read_bytes() == index
    assert second.exit_code == 1


def test_fresh_does_all_again(recipe, inbox, tmp_path):
    out = tmp_path / "qa"
    run(recipe, inbox, out)
    before = stamps(out)
    report = run(recipe, inbox, out, fresh=True)
    assert report.counts["skipped"] == 0
    assert all(stamps(out)[k] != v for k, v in before.items())
    assert len(stamps(out)) == 6


def test_only_what_changed_is_done_again_and_its_former_result_is_kept_apart(
    recipe, inbox, tmp_path, parts
):
    out = tmp_path / "qa"
    run(recipe, inbox, out)
    before = stamps(out)
    parts(inbox / "mo/P_0.sdf", 14e-9, seed=5)
    report = run(recipe, inbox, out)
    assert report.counts["skipped"] == 5
    assert statuses(report)["mo/P_0.sdf"] == "rejected"
    assert {k: stamps(out)[k] for k in before} == before
    index = json.loads((out / "index.json").read_text())
    assert index["counts"]["total"] == 6
    assert index["apart"]["former_content"] == 1
    assert any("former contents" in m for m in report.messages)


def test_a_changed_recipe_keeps_its_results_apart(recipe_text, inbox, tmp_path):
    out = tmp_path / "qa"
    run(Recipe.parse(recipe_text), inbox, out)
    before = stamps(out)
    wider = Recipe.parse(recipe_text.replace('upper = "10 nm"', 'upper = "20 nm"'))
    report = run(wider, inbox, out)
    assert set(statuses(report).values()) == {"accepted"}
    assert report.counts["skipped"] == 0
    index = json.loads((out / "index.json").read_text())
    assert index["counts"]["accepted"] == 6
    assert index["counts"]["total"] == 6
    assert index["apart"]["other_recipe"] == 6
    assert any(m.startswith("6 result(s)") for m in report.messages)
    assert {k: stamps(out)[k] for k in before} == before  # the old ones are still there
    again = run(Recipe.parse(recipe_text), inbox, out)
    assert again.counts["skipped"] == 6


def test_title_and_comments_and_view_change_nothing(recipe_text, inbox, tmp_path):
    run(Recipe.parse(recipe_text), inbox, tmp_path / "qa")
    other = recipe_text.replace('"parts"', '"other"') + "# a comment\n[view]\nzoom = 2\n"
    assert run(Recipe.parse(other), inbox, tmp_path / "qa").counts["skipped"] == 6


def test_an_index_from_the_marks_alone_is_the_same(recipe, inbox, tmp_path):
    from metrosep.batch import build_index
    from metrosep.recipe.outputs import recipe_hash

    report = run(recipe, inbox, tmp_path / "qa")
    rebuilt = build_index(recipe, tmp_path / "qa", recipe_hash=recipe_hash(recipe))
    assert rebuilt == json.loads((tmp_path / "qa/index.json").read_text())
    assert rebuilt == report.document


def test_csv_has_a_line_for_each_characteristic(recipe_text, inbox, tmp_path):
    text = recipe_text + "[batch]\npattern = '(?P<part>\\w)_(?P<serial>\\d)\\.\\w+'\n"
    (inbox / "mo/Q_9.sur").write_bytes(b"DIGITAL SURF junk")
    report = run(Recipe.parse(text), inbox, tmp_path / "qa")
    with (tmp_path / "qa/index.csv").open(newline="") as handle:
        lines = list(csv.DictReader(handle))
    mine = [n for n in lines if n["file"] == "tu/P_1.x3p" and n["metric"] == "Sa"]
    assert len(mine) == 1
    assert (mine[0]["part"], mine[0]["serial"]) == ("P", "1")
    assert mine[0]["verdict"] == "reject"
    sa_tolerance = 0.05e-9  # m: sampling of a sine and 16-bit steps of .sur
    assert abs(float(mine[0]["value"]) - 14e-9) < sa_tolerance
    failed = [n for n in lines if n["file"] == "mo/Q_9.sur"]
    assert [n["status"] for n in failed] == ["failed"]
    assert failed[0]["reason"]
    assert report.exit_code == 6


def test_the_report_tells_and_writes_the_index_again(recipe, inbox, tmp_path):
    report = run(recipe, inbox, tmp_path / "qa")
    assert report.summary().startswith("6 units: 2 accepted, 2 rejected, 2 inconclusive; ")
    assert (
        report.index(tmp_path / "copy.csv").read_bytes()
        == (tmp_path / "qa/index.csv").read_bytes()
    )
    with pytest.raises(DataError, match="Unknown index format 'pptx'"):
        report.index(tmp_path / "index.pptx")


def test_a_trend_of_nothing_is_named(recipe_text, inbox, tmp_path):
    text = recipe_text + '[batch]\ntrend = ["roughness", "Sz"]\n'
    report = run(Recipe.parse(text), inbox, tmp_path / "qa")
    assert any('trend "Sz"' in m and "roughness" in m for m in report.messages)
    assert not any('trend "roughness"' in m for m in report.messages)


def test_an_index_that_cannot_be_written_is_told(recipe, inbox, tmp_path):
    (tmp_path / "qa" / "index.csv").mkdir(parents=True)
    report = run(recipe, inbox, tmp_path / "qa")
    assert any(m.startswith("index.csv was not written: ") for m in report.messages)
    assert report.exit_code == 1
    assert (tmp_path / "qa/index.json").is_file()


def test_without_limits_units_are_measured(recipe_text, inbox, tmp_path):
    text = recipe_text[: recipe_text.index("[[check]]")]
    report = run(Recipe.parse(text), inbox, tmp_path / "qa")
    assert set(statuses(report).values()) == {"measured"}
    assert report.exit_code == 0


def test_outputs_appear_beside_the_result(recipe_text, inbox, tmp_path):
    text = recipe_text + '[[output]]\nkind = "parts"\n'
    report = run(Recipe.parse(text), inbox, tmp_path / "qa")
    folder = (tmp_path / "qa" / report.rows[0]["link"]).parent
    names = {f.name for f in folder.iterdir()}
    assert "result.json" in names
    assert len(names) > 1
    assert not any(n.startswith(".") for n in names)


def test_sets_of_runs_are_units(tmp_path):
    text = """metrosep = 1
[input]
files = ["run*.csv"]
x = { column = "X", unit = "mm" }
z = { column = "Z", unit = "nm" }
[[step]]
op = "separate"
method = "mean"
"""
    for name, gain in (("s1", 10), ("s2", 20)):
        for n in (1, 2, 3):
            rows = "".join(f"{i * 0.1:.1f},{gain * (i % 7) + n}\n" for i in range(200))
            (tmp_path / "in" / name).mkdir(parents=True, exist_ok=True)
            (tmp_path / "in" / name / f"run{n}.csv").write_text("X,Z\n" + rows)
    report = run(Recipe.parse(text), tmp_path / "in", tmp_path / "qa")
    assert statuses(report) == {"s1": "measured", "s2": "measured"}
    assert run(Recipe.parse(text), tmp_path / "in", tmp_path / "qa").counts["skipped"] == 2
    (tmp_path / "in/s1/run4.csv").write_text((tmp_path / "in/s1/run3.csv").read_text())
    assert run(Recipe.parse(text), tmp_path / "in", tmp_path / "qa").counts["skipped"] == 1


# ---- what is told


def test_each_unit_is_told_in_order_with_the_time_left(recipe, inbox, tmp_path):
    events = []
    run(recipe, inbox, tmp_path / "qa", tell=events.append)
    assert [e["done"] for e in events] == [1, 2, 3, 4, 5, 6]
    assert {e["total"] for e in events} == {6}
    assert set(events[0]) == {
        "done", "total", "unit", "status", "reason", "seconds", "eta_s", "skipped",
    }  # fmt: skip
    assert events[0]["eta_s"] > 0.0
    assert events[-1]["eta_s"] == 0.0
    assert events[2]["reason"] == ("roughness 10 nm, within U of 10 nm (U 0.2 nm): inconclusive")


def test_cancel_keeps_what_is_done(recipe, inbox, tmp_path):
    events = []
    report = run(
        recipe, inbox, tmp_path / "qa", tell=events.append, cancel=lambda: len(events) >= 2
    )
    assert (report.counts["open"], len(report.rows)) == (4, 2)
    assert report.exit_code == 130
    assert "resume" in report.stopped
    later = run(recipe, inbox, tmp_path / "qa")
    assert later.counts["skipped"] == 2
    assert later.counts["total"] == 6


def test_fail_fast_stops_at_the_first_that_fails(recipe, recipe_text, inbox, tmp_path):
    (inbox / "mo/A.sdf").write_text("junk")
    report = run(recipe, inbox, tmp_path / "qa", fail_fast=True)
    assert len(report.rows) == 1
    assert report.counts["open"] == 6
    assert report.exit_code == 6
    text = recipe_text + '[batch]\non_error = "stop"\n'
    assert len(run(Recipe.parse(text), inbox, tmp_path / "q2").rows) == 1


def test_a_dry_run_writes_nothing(recipe, inbox, tmp_path):
    report = run(recipe, inbox, tmp_path / "qa", dry_run=True)
    assert not (tmp_path / "qa").exists()
    assert {r["status"] for r in report.rows} == {"to do"}
    done = run(recipe, inbox, tmp_path / "qa")
    planned = run(recipe, inbox, tmp_path / "qa", dry_run=True)
    assert [r["link"] for r in report.rows] == [r["link"] for r in done.rows]
    assert {r["status"] for r in planned.rows} == {"done before"}


def test_a_hot_folder_takes_files_when_they_are_whole(recipe, inbox, tmp_path, parts):
    events, seen = [], []
    source = (inbox / "mo/P_0.sdf").read_bytes()

    def tell(event):
        events.append(event["unit"])
        if len(events) == 6:
            threading.Thread(target=grow, daemon=True).start()

    def grow():
        with (inbox / "late.sdf").open("wb") as handle:
            for k in range(0, len(source), len(source) // 8):
                handle.write(source[k : k + len(source) // 8])
                handle.flush()
                time.sleep(0.03)
                seen.append(len(events))

    report = run(
        recipe, inbox, tmp_path / "qa", watch=0.15, tell=tell, cancel=lambda: len(events) == 7
    )
    assert events[6] == "late.sdf"
    assert set(seen) == {6}
    assert statuses(report)["late.sdf"] == "accepted"
    assert report.counts["failed"] == 0
    assert json.loads((tmp_path / "qa/index.json").read_text())["counts"]["total"] == 7


# ---- bad inputs


def test_corrupt_files_are_reported_and_not_tried_again(recipe, inbox, tmp_path):
    whole = (inbox / "mo/P_1.x3p").read_bytes()
    (inbox / "cut.x3p").write_bytes(whole[: len(whole) // 2])
    (inbox / "empty.sur").write_bytes(b"")
    (inbox / "junk.sdf").write_text("junk")
    report = run(recipe, inbox, tmp_path / "qa")
    failed = {r["unit"]: r["reason"] for r in report.rows if r["status"] == "failed"}
    assert set(failed) == {"cut.x3p", "empty.sur", "junk.sdf"}
    for name, reason in failed.items():
        assert name in reason
        assert str(tmp_path) not in reason
        assert "\n" not in reason
        assert "Traceback" not in reason
    assert report.exit_code == 6
    assert report.counts["accepted"] == 2
    again = run(recipe, inbox, tmp_path / "qa")
    assert again.counts["skipped"] == 9
    assert again.exit_code == 6


def test_a_corrupt_file_that_is_replaced_passes(recipe, inbox, tmp_path, parts):
    (inbox / "x.sdf").write_text("junk")
    assert run(recipe, inbox, tmp_path / "qa").exit_code == 6
    parts(inbox / "x.sdf", 6e-9)
    report = run(recipe, inbox, tmp_path / "qa")
    assert report.exit_code == 1
    assert json.loads((tmp_path / "qa/index.json").read_text())["counts"]["failed"] == 0


def test_a_failed_file_that_is_gone_is_not_counted(recipe, inbox, tmp_path):
    (inbox / "x.sdf").write_text("junk")
    run(recipe, inbox, tmp_path / "qa")
    (inbox / "x.sdf").unlink()
    report = run(recipe, inbox, tmp_path / "qa")
    assert report.document["counts"]["failed"] == 0
    assert report.document["apart"]["gone"] == 1


def test_a_locked_file_fails_and_is_tried_again(recipe, inbox, tmp_path, monkeypatch):
    name = str(inbox / "mo/P_0.sdf")
    real = work.input_hash

    def locked_hash(unit):
        if unit.target == name:
            raise PermissionError(errno.EACCES, "Permission denied", name)
        return real(unit)

    monkeypatch.setattr(work, "input_hash", locked_hash)
    report = run(recipe, inbox, tmp_path / "qa")
    (row,) = [r for r in report.rows if r["status"] == "failed"]
    assert row["unit"] == "mo/P_0.sdf"
    assert "Permission denied" in row["reason"]
    monkeypatch.undo()
    report = run(recipe, inbox, tmp_path / "qa")
    assert report.counts["skipped"] == 5
    assert report.counts["failed"] == 0
    assert report.document["counts"]["failed"] == 0


def test_a_file_that_vanishes_fails(recipe, inbox, tmp_path):
    def tell(event):
        (inbox / "tu/P_2.sur").unlink(missing_ok=True)

    report = run(recipe, inbox, tmp_path / "qa", tell=tell)
    (row,) = [r for r in report.rows if r["status"] == "failed"]
    assert row["unit"] == "tu/P_2.sur"
    assert "No such file" in row["reason"]


@pytest.mark.parametrize("how", ["grows", "replaced", "vanishes"])
def test_a_file_that_changes_while_it_is_read_fails(recipe, inbox, tmp_path, monkeypatch, how):
    file = inbox / "mo/P_0.sdf"
    real = run_recipe

    def meanwhile(self, inputs, **options):
        result = real(self, inputs, **options)
        if str(inputs) == str(file):
            before = file.stat()
            if how == "vanishes":
                file.unlink()
            elif how == "grows":
                with file.open("a") as handle:
                    handle.write("more")
            else:
                file.write_bytes(b"x" * before.st_size)
        return result

    monkeypatch.setattr("metrosep.recipe.run.run_recipe", meanwhile)
    report = run(recipe, inbox, tmp_path / "qa")
    (row,) = [r for r in report.rows if r["status"] == "failed"]
    assert row["unit"] == "mo/P_0.sdf"
    assert "while it was read" in row["reason"]
    assert not list((tmp_path / "qa/P_0").glob(f"{row['hash'][:8]}/result.json"))


def test_content_swapped_between_hash_and_reading_fails(
    recipe, inbox, tmp_path, monkeypatch, parts
):
    file = inbox / "mo/P_2.sur"
    own, other = file.read_bytes(), parts(tmp_path / "other.sur", 6e-9).read_bytes()
    assert len(own) == len(other)
    real = run_recipe

    def meanwhile(self, inputs, **options):
        if str(inputs) != str(file):
            return real(self, inputs, **options)
        old = file.stat()
        file.write_bytes(other)
        result = real(self, inputs, **options)
        file.write_bytes(own)
        os.utime(file, ns=(old.st_atime_ns, old.st_mtime_ns))
        return result

    monkeypatch.setattr("metrosep.recipe.run.run_recipe", meanwhile)
    report = run(recipe, inbox, tmp_path / "qa")
    (row,) = [r for r in report.rows if r["status"] == "failed"]
    assert row["unit"] == "mo/P_2.sur"
    assert "while it was read" in row["reason"]


def test_a_full_disk_stops_the_batch_and_keeps_what_is_done(recipe, inbox, tmp_path, monkeypatch):
    done = []

    def full(folder, name, document):
        if len(done) >= 2:
            raise OSError(errno.ENOSPC, "No space left on device")
        done.append(folder)
        write_mark(folder, name, document)

    monkeypatch.setattr("metrosep.batch.units.write_mark", full)
    with pytest.raises(WriteError, match=r"disk is full; 2 of 6 units are done"):
        run(recipe, inbox, tmp_path / "qa")
    monkeypatch.undo()
    assert not list((tmp_path / "qa").glob("*/*/.metrosep*"))
    report = run(recipe, inbox, tmp_path / "qa")
    assert report.counts["skipped"] == 2
    assert report.counts["failed"] == 0


def test_what_would_not_fit_the_memory_is_refused(recipe, inbox, tmp_path, monkeypatch):
    size = max(f.stat().st_size for f in inbox.glob("*/*"))
    monkeypatch.setattr("metrosep.batch.work.available_bytes", lambda: 6 * size - 1)
    report = run(recipe, inbox, tmp_path / "qa")
    refused = [r for r in report.rows if r["status"] == "refused"]
    assert {Path(r["unit"]).suffix for r in refused} == {
        f.suffix for f in inbox.glob("*/*") if f.stat().st_size == size
    }
    assert "--workers 1" in refused[0]["reason"]
    assert report.exit_code == 6
    monkeypatch.undo()
    assert run(recipe, inbox, tmp_path / "qa").counts["refused"] == 0


def test_a_bug_is_one_row_and_code_5(recipe, inbox, tmp_path, monkeypatch):
    real = run_recipe

    def buggy(self, inputs, **options):
        if "P_1" in str(inputs):
            raise ZeroDivisionError("oops")
        return real(self, inputs, **options)

    monkeypatch.setattr("metrosep.recipe.run.run_recipe", buggy)
    report = run(recipe, inbox, tmp_path / "qa")
    assert report.counts["failed"] == 2
    assert report.exit_code == 5
    assert "bug in metrosep" in next(r["reason"] for r in report.rows if r["exit_code"] == 5)


def test_a_damaged_result_is_done_again(recipe, inbox, tmp_path):
    report = run(recipe, inbox, tmp_path / "qa")
    (tmp_path / "qa" / report.rows[0]["link"]).write_text('{"schema"')
    assert run(recipe, inbox, tmp_path / "qa").counts["skipped"] == 5


def test_two_batches_do_not_share_a_folder(recipe, inbox, tmp_path):
    with locked(tmp_path / "qa"), pytest.raises(WriteError, match="another batch works"):
        run(recipe, inbox, tmp_path / "qa")
    run(recipe, inbox, tmp_path / "qa")


def test_impossible_wishes_are_refused(recipe, inbox, tmp_path):
    with pytest.raises(DataError, match="workers = 0"):
        run(recipe, inbox, tmp_path / "qa", workers=0)
    with pytest.raises(DataError, match="slurm"):
        run(recipe, inbox, tmp_path / "qa", scheduler="slurm")
    with pytest.raises(DataError, match="watch"):
        run(recipe, inbox, tmp_path / "qa", watch=0.0)
    with pytest.raises(WriteError, match="input folder itself"):
        run(recipe, inbox, inbox)
    (tmp_path / "empty").mkdir()
    with pytest.raises(ReadError, match=r"no file matches \*.sdf"):
        run(recipe, tmp_path / "empty", tmp_path / "qa")
    (tmp_path / "file").write_text("")
    with pytest.raises(WriteError, match="cannot be written"):
        run(recipe, inbox, tmp_path / "file" / "qa")
    with pytest.raises(RecipeError, match="reads no inputs"):
        run(Recipe.parse(NOTHING_TO_READ), inbox, tmp_path / "qa")


def test_the_method_of_recipes_runs_it(recipe, inbox, tmp_path):
    report = recipe.batch(inbox, out=tmp_path / "qa", scheduler="serial")
    assert report.counts["total"] == 6
