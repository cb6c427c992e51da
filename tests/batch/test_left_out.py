"""What a batch did not do stands in its index: units not begun, folders left out, files that went."""

from __future__ import annotations

import csv
import errno
import json
import os
import time
from pathlib import Path

import pytest

from metrosep.batch import find_units, run_batch, units as output_folders
from metrosep.cli.batches import batch as command
from metrosep.cli.main import main
from metrosep.core.errors import ReadError, RecipeError
from metrosep.recipe import Recipe

pytestmark = pytest.mark.usefixtures("without_figures")  # no test here looks at one

PAGE = '[batch]\nindex = ["csv", "html"]\n'
LONGEST = 20.0  # s, until a watch that hangs is given up


def run(recipe, folder, out, **options):
    return run_batch(recipe, folder, out=out, **{"scheduler": "serial", **options})


def index_of(out: Path) -> dict:
    return json.loads((out / "index.json").read_bytes())


def lines_of(out: Path) -> list[dict[str, str]]:
    with (out / "index.csv").open(newline="", encoding="utf-8") as handle:
        return list(csv.DictReader(handle))


def close(monkeypatch, name: str) -> None:
    """Make a folder one that may not be entered: looking into it is refused, listing it too."""
    scandir, real = os.scandir, Path.stat

    def refused(path: object) -> PermissionError:
        return PermissionError(errno.EACCES, "Permission denied", str(path))

    def closed_scandir(place="."):
        if not isinstance(place, int) and Path(place).name == name:
            raise refused(place)
        return scandir(place)

    def closed_stat(self, **options):
        if self.parent.name == name:
            raise refused(self)
        return real(self, **options)

    monkeypatch.setattr(os, "scandir", closed_scandir)
    monkeypatch.setattr(Path, "stat", closed_stat)


# --- 1. a batch that was stopped


@pytest.fixture
def four(tmp_path, parts) -> Path:
    """The second of four files is damaged."""
    for name in "acd":
        parts(tmp_path / f"in/{name}.x3p", 6e-9)
    (tmp_path / "in/b.x3p").write_bytes(b"half a file")
    return tmp_path / "in"


def test_the_index_of_a_stopped_batch_says_what_is_not_begun(four, tmp_path, recipe_text):
    recipe = Recipe.parse(recipe_text + PAGE)
    report = run(recipe, four, tmp_path / "qa", fail_fast=True)
    begun = {r["unit"] for r in report.rows}
    missing = sorted({"a.x3p", "b.x3p", "c.x3p", "d.x3p"} - begun)
    assert missing
    assert report.exit_code == 6
    found = index_of(tmp_path / "qa")
    assert found["complete"] is False
    assert found["not_begun"] == {"count": len(missing), "units": missing}
    assert f"incomplete: {len(missing)} not begun" in found["notes"][0]
    page = (tmp_path / "qa/index.html").read_text("utf-8")
    assert f"<strong>Incomplete: {len(missing)} not begun" in page.split("<h2>")[0]
    assert f"{len(missing)} not begun" in report.summary()
    assert [r["file"] for r in lines_of(tmp_path / "qa") if r["status"] == "not begun"] == missing


def test_a_resumed_batch_makes_its_index_complete(four, tmp_path, recipe_text):
    recipe = Recipe.parse(recipe_text + PAGE)
    run(recipe, four, tmp_path / "qa", fail_fast=True)
    assert run(recipe, four, tmp_path / "qa").exit_code == 6
    found = index_of(tmp_path / "qa")
    assert found["complete"] is True
    assert found["not_begun"] == {"count": 0, "units": []}
    assert found["counts"]["total"] == 4
    assert "not begun" not in (tmp_path / "qa/index.html").read_text("utf-8")
    assert {r["status"] for r in lines_of(tmp_path / "qa")} == {"accepted", "failed"}


def test_results_of_before_are_told_where_a_stopped_batch_did_not_look(
    four, tmp_path, recipe_text
):
    recipe = Recipe.parse(recipe_text + PAGE)
    run(recipe, four, tmp_path / "qa")
    report = run(recipe, four, tmp_path / "qa", cancel=lambda: True)
    assert report.exit_code == 130
    found = index_of(tmp_path / "qa")
    assert found["complete"] is False
    assert found["not_begun"]["count"] == 0
    assert "4 unit(s) show the result of an earlier run" in found["notes"][0]


# --- 2, 4. what was left out


def test_a_closed_folder_is_left_out_and_no_success(tmp_path, parts, recipe_text, monkeypatch):
    parts(tmp_path / "in/a.x3p", 6e-9)
    parts(tmp_path / "in/locked/b.x3p", 6e-9)
    close(monkeypatch, "locked")
    report = run(Recipe.parse(recipe_text + PAGE), tmp_path / "in", tmp_path / "qa")
    assert [r["unit"] for r in report.rows] == ["a.x3p"]
    assert report.exit_code == 6
    (item,) = index_of(tmp_path / "qa")["left_out"]
    assert item == {
        "what": "closed",
        "why": "are folders that cannot be read",
        "count": 1,
        "names": ["locked"],
    }
    assert "locked" in (tmp_path / "qa/index.html").read_text("utf-8").split("<h2>")[0]
    assert str(tmp_path) not in (tmp_path / "qa/index.json").read_text("utf-8")


def test_a_rejected_part_does_not_hide_a_closed_folder(tmp_path, parts, recipe_text, monkeypatch):
    parts(tmp_path / "in/a.x3p", 14e-9)
    parts(tmp_path / "in/locked/b.x3p", 6e-9)
    close(monkeypatch, "locked")
    assert run(Recipe.parse(recipe_text), tmp_path / "in", tmp_path / "qa").exit_code == 6


def test_a_folder_whose_files_may_not_be_looked_at_is_closed_too(
    tmp_path, parts, recipe, monkeypatch
):
    """Mode 644: the names can be listed, and nothing can be said of them."""
    parts(tmp_path / "a.sdf", 6e-9)
    parts(tmp_path / "locked/b.sdf", 6e-9)
    scandir = os.scandir
    close(monkeypatch, "locked")
    monkeypatch.setattr(os, "scandir", scandir)
    found = find_units(recipe, tmp_path)
    assert [u.name for u in found.units] == ["a.sdf"]
    assert found.closed == ("locked",)


def test_only_closed_folders_are_named(tmp_path, parts, recipe, monkeypatch):
    parts(tmp_path / "in/locked/b.sdf", 6e-9)
    close(monkeypatch, "locked")
    with pytest.raises(ReadError, match=r"1 folder\(s\) in it cannot be read"):
        run(recipe, tmp_path / "in", tmp_path / "qa")


def test_a_closed_input_folder_is_refused(tmp_path, parts, recipe, monkeypatch):
    parts(tmp_path / "in/b.sdf", 6e-9)
    close(monkeypatch, "in")
    with pytest.raises(ReadError, match="in: the folder cannot be read"):
        find_units(recipe, tmp_path / "in")


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root reads all")
@pytest.mark.parametrize("mode", [0o000, 0o644])
def test_a_real_closed_folder_is_left_out(tmp_path, parts, recipe, mode):
    parts(tmp_path / "a.sdf", 6e-9)
    parts(tmp_path / "locked/b.sdf", 6e-9)
    (tmp_path / "locked").chmod(mode)
    try:
        assert find_units(recipe, tmp_path).closed == ("locked",)
    finally:
        (tmp_path / "locked").chmod(0o755)


def test_names_outside_the_pattern_and_output_folders_stand_in_the_index(
    tmp_path, parts, recipe_text
):
    recipe = Recipe.parse(recipe_text)
    parts(tmp_path / "in/P_1.x3p", 6e-9)
    run(recipe, tmp_path / "in", tmp_path / "in/old")
    parts(tmp_path / "in/odd name.x3p", 6e-9)
    text = recipe_text + PAGE + "pattern = '(?P<part>P_[0-9]+)[.]x3p'\n"
    report = run(Recipe.parse(text), tmp_path / "in", tmp_path / "qa")
    assert report.exit_code == 0
    found = {i["what"]: i["names"] for i in index_of(tmp_path / "qa")["left_out"]}
    assert found == {"pattern": ["odd name.x3p"], "outputs": ["old"]}
    page = (tmp_path / "qa/index.html").read_text("utf-8").split("<h2>")[0]
    assert "odd name.x3p" in page
    assert "do not fit the pattern" in page


# --- 3. a watched folder


def watched(recipe, folder, out, steps):
    """Watch; each step is carried out as soon as its condition holds, after the last it ends."""
    began, left = time.monotonic(), list(steps)

    def cancel() -> bool:
        if left and left[0][0]():
            left.pop(0)[1]()
        return not left or time.monotonic() - began > LONGEST

    report = run(recipe, folder, out, watch=0.05, cancel=cancel)
    assert not left, "the watch did not see it"
    return report


def test_a_file_deleted_under_a_watch_is_gone_as_without_it(tmp_path, parts, recipe_text):
    for name in "ab":
        parts(tmp_path / f"in/{name}.x3p", 6e-9)
    recipe, qa = Recipe.parse(recipe_text + PAGE), tmp_path / "qa"
    done = lambda: len(list(qa.glob("*/*/result.json"))) == 2  # noqa: E731
    report = watched(recipe, tmp_path / "in", qa, [(done, (tmp_path / "in/b.x3p").unlink)])
    under = index_of(qa)
    assert [r["unit"] for r in report.rows] == ["a.x3p"]
    assert (report.counts["total"], report.counts["open"]) == (1, 0)
    run(recipe, tmp_path / "in", qa)
    assert under == index_of(qa)
    assert under["apart"]["gone"] == 1


def test_a_file_replaced_at_the_end_of_a_watch_is_not_counted_by_its_old_result(
    tmp_path, parts, recipe_text
):
    for name in "ab":
        parts(tmp_path / f"in/{name}.x3p", 6e-9)
    recipe, qa = Recipe.parse(recipe_text + PAGE), tmp_path / "qa"
    done = lambda: len(list(qa.glob("*/*/result.json"))) == 2  # noqa: E731
    watched(recipe, tmp_path / "in", qa, [(done, lambda: parts(tmp_path / "in/b.x3p", 14e-9))])
    found = index_of(qa)
    assert [r["unit"] for r in found["rows"]] == ["a.x3p"]
    assert found["apart"]["former_content"] == 1
    assert found["not_begun"] == {"count": 1, "units": ["b.x3p"]}


def test_the_index_is_written_again_when_a_file_goes(tmp_path, parts, recipe_text):
    for name in "ab":
        parts(tmp_path / f"in/{name}.x3p", 6e-9)
    recipe, qa = Recipe.parse(recipe_text), tmp_path / "qa"

    def listed(n: int):
        def holds() -> bool:
            try:
                return len(index_of(qa)["rows"]) == n
            except (OSError, ValueError):
                return False

        return holds

    steps = [(listed(2), (tmp_path / "in/b.x3p").unlink), (listed(1), lambda: None)]
    assert watched(recipe, tmp_path / "in", qa, steps).counts["total"] == 1


# --- 5, 8. names and files


def odd_file(folder: Path, name: bytes, like: Path) -> Path:
    file = folder / os.fsdecode(name)
    try:
        file.write_bytes(like.read_bytes())
    except OSError:
        pytest.skip("this disk takes no such name")
    return file


def test_a_name_that_is_not_utf8_is_one_clear_failure(tmp_path, parts, recipe_text):
    good = parts(tmp_path / "in/a.x3p", 6e-9)
    file = odd_file(tmp_path / "in", b"LENS_\xff.x3p", good)
    text = recipe_text + '[[output]]\nkind = "report"\nformats = ["html"]\n' + PAGE
    recipe = Recipe.parse(text)
    report = run(recipe, tmp_path / "in", tmp_path / "qa")
    row = next(r for r in report.rows if r["status"] == "failed")
    assert row["unit"] == "LENS_\\xff.x3p"
    assert "the name is not UTF-8; rename the file" in row["reason"]
    assert (row["exit_code"], row["again"], report.exit_code) == (4, False, 6)
    assert row["unit"].encode("utf-8")
    assert run(recipe, tmp_path / "in", tmp_path / "qa").counts["skipped"] == 2
    file.rename(tmp_path / "in/LENS_b.x3p")
    assert run(recipe, tmp_path / "in", tmp_path / "qa").counts["accepted"] == 2


def test_a_folder_whose_name_is_not_utf8_fails_its_files(tmp_path, parts, recipe_text):
    good = parts(tmp_path / "in/a.x3p", 6e-9)
    folder = tmp_path / "in" / os.fsdecode(b"d\xff")
    try:
        folder.mkdir()
    except OSError:
        pytest.skip("this disk takes no such name")
    (folder / "b.x3p").write_bytes(good.read_bytes())
    report = run(Recipe.parse(recipe_text), tmp_path / "in", tmp_path / "qa")
    assert {r["unit"]: r["status"] for r in report.rows} == {
        "a.x3p": "accepted", "d\\xff/b.x3p": "failed",
    }  # fmt: skip


def test_a_file_that_became_unreadable_is_told_as_such(tmp_path, parts, recipe_text, monkeypatch):
    from metrosep.batch import work

    parts(tmp_path / "in/a.x3p", 6e-9)
    recipe = Recipe.parse(recipe_text + PAGE)
    run(recipe, tmp_path / "in", tmp_path / "qa")

    def refused(unit):
        raise PermissionError(errno.EACCES, "Permission denied", unit.target)

    monkeypatch.setattr(work, "input_hash", refused)
    report = run(recipe, tmp_path / "in", tmp_path / "qa")
    apart = index_of(tmp_path / "qa")["apart"]
    assert (apart["unreadable"], apart["former_content"]) == (1, 0)
    assert any("of files that cannot be read now" in m for m in report.messages)
    assert "1 of files that cannot be read now" in (tmp_path / "qa/index.html").read_text("utf-8")


def test_a_line_end_in_a_name_stays_on_its_line(tmp_path, parts, recipe_text, capsys):
    parts(tmp_path / "in/a\nb.x3p", 6e-9)
    (tmp_path / "in/c\n\x1b[31md.x3p").write_bytes(b"half a file")
    (tmp_path / "r.toml").write_text(recipe_text)
    args = ["batch", str(tmp_path / "r.toml"), str(tmp_path / "in"), "-o", str(tmp_path / "qa")]
    for more in (["--dry-run"], []):
        with pytest.raises(SystemExit):
            main([*args, "--scheduler", "serial", *more])
        told = capsys.readouterr().err
        assert "a\\nb.x3p" in told
        assert "c\\n\\x1b[31md.x3p" in told
        assert "\x1b" not in told
        assert not any(line.startswith(("b.x3p", "[31m")) for line in told.splitlines())


# --- 6. refused before it begins


def test_an_index_format_that_is_not_there_is_refused_before_anything_is_done(
    tmp_path, parts, recipe_text
):
    parts(tmp_path / "in/a.x3p", 6e-9)
    recipe = Recipe.parse(recipe_text + '[batch]\nindex = ["csvv"]\n', name="r.toml")
    for dry_run in (True, False):
        with pytest.raises(RecipeError, match=r"r\.toml:\d+: .*Unknown index format 'csvv'"):
            run(recipe, tmp_path / "in", tmp_path / "qa", dry_run=dry_run)
    assert not (tmp_path / "qa").exists()


GUARDED = """metrosep = 1
[input]
[[step]]
op = "parameters"
names = ["Sa"]
[[check]]
metric = "Sa"
lower = "9 nm"
upper = "12 nm"
U = "2 nm"
"""


def test_limits_that_leave_no_room_are_a_warning_of_check(tmp_path, capsys):
    (tmp_path / "r.toml").write_text(GUARDED)
    with pytest.raises(SystemExit) as ended:
        main(["check", str(tmp_path / "r.toml")])
    told = capsys.readouterr().out
    assert ended.value.code == 0
    assert "warning: r.toml:10: " in told
    assert "nothing can be accepted" in told
    assert "nothing wrong" not in told
    assert "11 nm" in told  # 9 nm + 2 nm
    assert "10 nm" in told  # 12 nm - 2 nm
    with pytest.raises(SystemExit):
        main(["check", "--json", str(tmp_path / "r.toml")])
    found = json.loads(capsys.readouterr().out)
    assert len(found["warnings"]) == 1
    assert found["errors"] == []


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('U = "2 nm"', 'U = "1.5 nm"'),  # one value is left: 10.5 nm
        ('U = "2 nm"', 'U = "2 nm"\nguard_factor = 0.5'),
        ('lower = "9 nm"\n', ""),
        ('U = "2 nm"\n', ""),
    ],
)
def test_limits_with_room_are_not_warned_of(tmp_path, capsys, old, new):
    (tmp_path / "r.toml").write_text(GUARDED.replace(old, new))
    with pytest.raises(SystemExit):
        main(["check", str(tmp_path / "r.toml")])
    assert "nothing wrong" in capsys.readouterr().out


def test_a_batch_tells_of_limits_that_leave_no_room(tmp_path, parts):
    parts(tmp_path / "in/a.x3p", 10.5e-9)
    recipe = Recipe.parse(GUARDED, name="r.toml")
    report = run(recipe, tmp_path / "in", tmp_path / "qa")
    assert report.counts["accepted"] == 0
    assert any("nothing can be accepted" in m for m in report.messages)


def test_the_help_names_the_exit_code_of_closed_folders():
    assert "folders that cannot be read" in " ".join((command.help or "").split())


# --- 2. what left_out of a pattern looks like from outside


def test_the_reader_of_locks_says_what_it_cannot_see(tmp_path, monkeypatch):
    (tmp_path / "locked").mkdir()
    close(monkeypatch, "locked")
    with pytest.raises(PermissionError):
        output_folders.is_output_folder(tmp_path / "locked")
