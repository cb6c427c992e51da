"""Units of a folder: which files, which names, what is left out, and no way out of the folder."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from metrosep.batch import find_units
from metrosep.batch.units import safe_name
from metrosep.core.errors import ReadError, RecipeError
from metrosep.recipe import Recipe

MEASURE = """metrosep = 1
[input]
files = ["*.xyz"]
[[step]]
op = "form"
form = "plane"
"""
RUNS = """metrosep = 1
[input]
files = ["run*.csv"]
x = { column = "X", unit = "mm" }
z = { column = "Z", unit = "nm" }
[[step]]
op = "separate"
"""


def touch(folder: Path, *names: str) -> Path:
    for name in names:
        target = folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(name)
    return folder


def units(text: str, folder: Path, **options):
    return find_units(Recipe.parse(text), folder, **options)


def test_each_file_of_the_pattern_is_a_unit_in_subfolders_too(tmp_path):
    touch(tmp_path, "a.xyz", "b.csv", "deep/er/c.xyz", ".hidden.xyz", ".git/d.xyz")
    found = units(MEASURE, tmp_path)
    assert [u.name for u in found.units] == ["a.xyz", "deep/er/c.xyz"]
    assert [u.key for u in found.units] == ["a", "c"]
    assert found.units[1].files == (str(tmp_path / "deep/er/c.xyz"),)
    assert found.left_out == ()


def test_the_pattern_names_units_and_what_does_not_fit_is_told(tmp_path):
    text = MEASURE + (
        "[batch]\npattern = '(?P<part>[A-Z]+)_(?P<serial>\\d+)\\.xyz'\nkey = ['serial', 'part']\n"
    )
    touch(tmp_path, "AB_12.xyz", "AB_x.xyz", "other.csv")
    found = units(text, tmp_path)
    assert [(u.key, dict(u.groups)) for u in found.units] == [
        ("12_AB", {"part": "AB", "serial": "12"})
    ]
    assert found.left_out == ("AB_x.xyz",)
    assert "AB_x.xyz" in found.messages[0]


def test_a_pattern_alone_looks_at_every_file(tmp_path):
    text = MEASURE.replace('files = ["*.xyz"]', "") + "[batch]\npattern = '(?P<n>.*)\\.sdf'\n"
    touch(tmp_path, "1.sdf", "2.xyz")
    found = units(text, tmp_path)
    assert [u.name for u in found.units] == ["1.sdf"]
    assert found.left_out == ("2.xyz",)


def test_a_pattern_may_fit_the_path_below_the_folder(tmp_path):
    text = MEASURE + "[batch]\npattern = '(?P<day>\\w+)/(?P<part>\\w+)\\.xyz'\n"
    touch(tmp_path, "monday/p.xyz", "tuesday/p.xyz")
    assert [u.key for u in units(text, tmp_path).units] == ["monday_p", "tuesday_p"]


def test_the_same_name_in_two_folders_is_two_units(tmp_path):
    touch(tmp_path, "m/p.xyz", "t/p.xyz")
    found = units(MEASURE, tmp_path).units
    assert len({u.name for u in found}) == 2


def test_repeated_runs_of_a_folder_are_one_unit(tmp_path):
    touch(tmp_path, "s1/run1.csv", "s1/run2.csv", "s2/run1.csv", "s2/notes.csv", "s3/x.txt")
    found = units(RUNS, tmp_path).units
    assert [(u.name, len(u.files)) for u in found] == [("s1", 2), ("s2", 1)]
    assert found[0].target == str(tmp_path / "s1")


def test_the_folder_itself_may_be_a_set(tmp_path):
    folder = touch(tmp_path / "in box", "run1.csv")
    (unit,) = units(RUNS, folder).units
    assert (unit.name, unit.key) == (".", "in_box")


def test_the_output_folder_is_no_input(tmp_path):
    touch(tmp_path, "a.xyz", "qa/a/12345678/part.xyz")
    found = units(MEASURE, tmp_path, out=tmp_path / "qa")
    assert [u.name for u in found.units] == ["a.xyz"]


def test_links_to_folders_are_left_out_and_told(tmp_path):
    folder = touch(tmp_path / "in", "a.xyz")
    (folder / "again").symlink_to(folder)  # a loop
    found = units(MEASURE, folder)
    assert [u.name for u in found.units] == ["a.xyz"]
    assert "again" in found.messages[0]


def test_a_closed_subfolder_is_told_and_the_rest_goes_on(tmp_path, monkeypatch):
    touch(tmp_path, "a.xyz", "closed/b.xyz")
    real = os.scandir

    def scandir(place):
        if Path(place).name == "closed":
            raise PermissionError(13, "Permission denied", str(place))
        return real(place)

    monkeypatch.setattr(os, "scandir", scandir)
    found = units(MEASURE, tmp_path)
    assert [u.name for u in found.units] == ["a.xyz"]
    assert found.messages == (
        f"1 below {tmp_path} are folders that cannot be read and are omitted: closed",
    )


def test_without_files_and_pattern_known_formats_count(tmp_path):
    touch(tmp_path, "a.x3p", "b.SDF", "readme.md", "recipe.toml", "result.json")
    text = MEASURE.replace('files = ["*.xyz"]', "")
    assert [u.name for u in units(text, tmp_path).units] == ["a.x3p", "b.SDF"]


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("../../etc/passwd", "_.._etc_passwd"),
        ("..", "_"),
        ("", "_"),
        ("a/b\\c:d*e", "a_b_c_d_e"),
        ("CON", "_CON"),
        ("nul.txt", "_nul.txt"),
        ("äöü µm", "äöü_µm"),
        ("x" * 300, "x" * 80),
        ("tail..", "tail"),
        ("a\nb\0c", "a_b_c"),
    ],
)
def test_names_are_safe(text, name):
    assert safe_name(text) == name


def test_groups_cannot_lead_out(tmp_path):
    text = MEASURE + "[batch]\npattern = '(?P<p>.*)\\.xyz'\n"
    touch(tmp_path, "..%2f..xyz", "...xyz")
    for unit in units(text, tmp_path).units:
        assert "/" not in unit.key
        assert unit.key.strip(".")


def test_what_is_no_folder_is_refused(tmp_path):
    touch(tmp_path, "a.xyz")
    with pytest.raises(ReadError, match="is a file"):
        units(MEASURE, tmp_path / "a.xyz")
    with pytest.raises(ReadError, match="does not exist"):
        units(MEASURE, tmp_path / "nowhere")


def test_whole_paths_are_refused(tmp_path):
    with pytest.raises(RecipeError, match=r"recipe.toml:3: .*whole path"):
        units(MEASURE.replace("*.xyz", "/data/a.xyz"), tmp_path)


def test_files_that_hold_runs_of_their_own_are_units_of_their_own(tmp_path):
    """Two sets of five runs in one folder were pooled as ten; files of one run each stay together."""

    def runs(name, n):
        rows = [f"{i},{x},{0.1 * x * i}" for i in range(n) for x in range(9)]
        (tmp_path / name).write_text("\n".join(["run,x_mm,z_um", *rows]) + "\n")

    for name, n in (("one.csv", 5), ("two.csv", 5), ("a.csv", 1), ("b.csv", 1)):
        runs(name, n)
    silent = 'metrosep = 1\n[input]\n[[step]]\nop = "separate"\n'
    named = silent.replace("[input]", '[input]\nx = "x_mm"\nz = "z_um"\nrun = "run"')

    for text in (silent, named):
        found = {u.name: [Path(f).name for f in u.files] for u in units(text, tmp_path).units}
        assert found == {".": ["a.csv", "b.csv"], "one.csv": ["one.csv"], "two.csv": ["two.csv"]}
        (together,) = units(text + '[batch]\neach = "folder"\n', tmp_path).units
        assert len(together.files) == 4


def test_one_file_for_each_feedrate_is_one_set(tmp_path):
    def runs(name, feed):
        rows = [f"{i},{x},{0.1 * x * i},{feed}" for i in range(3) for x in range(9)]
        (tmp_path / name).write_text("\n".join(["run,x_mm,z_um,feed_mm_min", *rows]) + "\n")

    text = 'metrosep = 1\n[input]\n[[step]]\nop = "separate"\n'
    for name, feed in (("slow.csv", 1000), ("fast.csv", 3000)):
        runs(name, feed)
    (together,) = units(text, tmp_path).units
    assert len(together.files) == 2
    runs("again.csv", 3030)  # a second set, 1 % from the same feedrate
    assert len(units(text, tmp_path).units) == 3
