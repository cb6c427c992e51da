"""``metrosep batch``: exit codes, what goes where, and words for what is wrong."""

from __future__ import annotations

import json
import shlex

import numpy as np
import pytest
from contracts.recipes import mean_of_runs

import metrosep as ms
from metrosep.cli.batches import _duration
from metrosep.cli.main import main

RECIPE = """metrosep = 1
[input]
files = ["*.x3p"]
[[step]]
op = "parameters"
names = ["PV"]
[[check]]
metric = "PV"
upper = "{upper}"
U = "1 nm"
"""
PV = 100e-9  # m


@pytest.fixture
def home(tmp_path, monkeypatch):
    wave = np.zeros((20, 20))
    wave[3, 4] = PV
    for name in ("a", "b"):
        (tmp_path / "in").mkdir(exist_ok=True)
        ms.write(ms.Surface(wave, 1e-6, 1e-6), tmp_path / "in" / f"{name}.x3p")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def call(home, *words, upper="200 nm"):
    (home / "r.toml").write_text(RECIPE.format(upper=upper))
    with pytest.raises(SystemExit) as end:
        main(
            [
                "batch",
                "r.toml",
                "in",
                "-o",
                "qa",
                *(words if "--scheduler" in words else ("--scheduler", "serial", *words)),
            ]
        )
    return end.value.code


@pytest.mark.parametrize(
    ("upper", "bad", "code"),
    [
        ("200 nm", False, 0),
        ("50 nm", False, 1),
        ("100 nm", False, 3),
        ("200 nm", True, 6),
        ("50 nm", True, 6),
    ],
)
def test_exit_codes(home, upper, bad, code):
    if bad:
        (home / "in/c.x3p").write_bytes(b"junk")
    assert call(home, upper=upper) == code
    assert call(home, upper=upper) == code  # resumed: the same answer


def test_one_line_for_each_file_and_nothing_on_standard_output(home, capsys):
    (home / "in/c.x3p").write_bytes(b"junk")
    call(home)
    out, err = capsys.readouterr()
    lines = err.splitlines()
    assert out == ""
    assert lines[0] == "metrosep: 1/3 accepted a.x3p"
    assert lines[2].startswith("metrosep: 3/3 failed c.x3p: ")
    assert lines[3].startswith("3 units: 2 accepted, 1 failed; ")
    assert lines[4].startswith("index    ")


def test_quiet_is_silent(home, capsys):
    assert call(home, "-q") == 0
    assert capsys.readouterr() == ("", "")


def test_json_is_one_object(home, capsys):
    assert call(home, "--json", upper="50 nm") == 1
    found = json.loads(capsys.readouterr().out)
    assert found["counts"]["rejected"] == 2
    assert found["exit_code"] == 1
    assert [r["unit"] for r in found["rows"]] == ["a.x3p", "b.x3p"]
    (pv,) = [c for c in found["rows"][0]["characteristics"] if c["metric"] == "PV"]
    tolerance = 1e-15  # m: floats of .x3p
    assert abs(pv["value"] - PV) < tolerance


def test_fresh_and_resume(home, capsys):
    call(home)
    call(home)
    assert "(2 done before)" in capsys.readouterr().err
    call(home, "--fresh")
    assert "done before" not in capsys.readouterr().err


TABLE = (
    mean_of_runs("*.csv")
    + """[[output]]
kind = "table"
controller = "csv"
axis = "X"
compensates = "Z"
spacing = "{spacing}"
path = "z.txt"
waive = ["active"]
"""
)


def test_a_table_of_a_batch_is_replaced_by_fresh_alone(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "in").mkdir()
    rng = np.random.default_rng(3)
    rows = ["run,x_mm,z_um"]
    for run in range(4):
        x = np.linspace(0.0, 50.0, 201)
        z = np.sin(x / 4.0) + 2e-3 * rng.standard_normal(x.size)
        rows += [f"{run},{a:.4f},{b:.6f}" for a, b in zip(x, z, strict=True)]
    (tmp_path / "in" / "one.csv").write_text("\n".join(rows) + "\n")

    def batch(spacing, *words):
        (tmp_path / "r.toml").write_text(TABLE.format(spacing=spacing))
        with pytest.raises(SystemExit) as end:
            main(["batch", "r.toml", "in", "-o", "qa", "--scheduler", "serial", *words])
        return end.value.code, capsys.readouterr().err

    assert batch("1 mm")[0] == 0
    (table,) = (tmp_path / "qa").rglob("z.txt")
    beside = table.with_name("z.txt.json")
    held = table.read_bytes(), beside.read_bytes()

    assert batch("2 mm")[0] == 0  # what is made otherwise lies in another folder
    assert (table.read_bytes(), beside.read_bytes()) == held
    assert len(list((tmp_path / "qa").rglob("z.txt"))) == 2

    table.write_bytes(held[0] + b"# tried on the machine\n")
    held = table.read_bytes(), beside.read_bytes()
    (table.parent / "result.json").unlink()
    code, err = batch("1 mm")
    assert code != 0
    assert (table.read_bytes(), beside.read_bytes()) == held
    assert not list(table.parent.glob("z.txt.1*"))
    assert "--fresh" in err + (tmp_path / "qa" / "index.csv").read_text()

    code, err = batch("1 mm", "--fresh")
    assert code == 0, err
    assert table.read_bytes() != held[0]
    kept = table.with_name("z.txt.1"), table.with_name("z.txt.1.json")
    assert tuple(f.read_bytes() for f in kept) == held


def test_dry_run_lists(home, capsys):
    assert call(home, "--dry-run") == 0
    err = capsys.readouterr().err
    assert "to do        a.x3p -> a/" in err
    assert not (home / "qa").exists()


@pytest.mark.parametrize(
    ("words", "code", "text"),
    [
        (["--scheduler", "slurm"], 2, "scheduler 'slurm' is not known"),
        (["--workers", "0"], 2, "workers = 0"),
        (["--every", "3"], 2, "--every needs --watch"),
        (["--watch", "--every", "-1"], 2, "watch must be positive"),
    ],
)
def test_wrong_options(home, capsys, words, code, text):
    assert call(home, *words) == code
    err = capsys.readouterr().err
    assert text in err
    assert "Traceback" not in err


def test_a_folder_without_inputs_is_unreadable(home, capsys):
    (home / "r.toml").write_text(RECIPE.format(upper="1 nm"))
    (home / "empty").mkdir()
    with pytest.raises(SystemExit) as end:
        main(["batch", "r.toml", "empty", "-o", "qa"])
    assert end.value.code == 4
    assert "no file matches *.x3p" in capsys.readouterr().err


def test_on_a_terminal_there_is_a_bar(home, capsys, monkeypatch):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    monkeypatch.setitem(__import__("sys").modules, "rich.console", None)  # not installed
    (home / "in/c.x3p").write_bytes(b"junk")
    call(home)
    err = capsys.readouterr().err
    assert "\r\033[K1/3 units" in err
    assert "failed c.x3p" in err


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (0.4, "0 s"),
        (59.4, "59 s"),
        (61, "1 min 01 s"),
        (3599.7, "1 h 00 min"),
        (7260, "2 h 01 min"),
    ],
)
def test_durations(seconds, words):
    assert _duration(seconds) == words


@pytest.mark.parametrize(("upper", "bad"), [("50 nm", False), ("100 nm", False), ("50 nm", True)])
def test_exit_zero_is_for_what_became_of_the_units(home, upper, bad):
    if bad:
        (home / "in/c.x3p").write_bytes(b"junk")
    assert call(home, "--exit-zero", upper=upper) == 0


def test_exit_zero_hides_no_wrong_recipe(home, capsys):
    assert call(home, "--exit-zero", upper="50 kg") == 2


def test_the_recipe_that_measure_prints_measures_a_folder_as_its_last_line_says(home, capsys):
    def said(*words):
        with pytest.raises(SystemExit) as end:
            main([str(w) for w in words])
        return end.value.code, capsys.readouterr()

    words = ("in/a.x3p", "--params", "PV", "--upper", "PV=200 nm", "--U", "PV=1 nm")
    code, printed = said("measure", *words, "--print-recipe")
    assert code == 0
    (home / "qa.toml").write_text(printed.out)
    next_one = printed.err.splitlines()[-1].removeprefix("next: metrosep ")
    typed = shlex.split(next_one.replace("RECIPE", "qa.toml").replace("FOLDER", "in"))
    code, found = said(*typed, "--scheduler", "serial")
    assert code == 0, found.err
    assert len(list((home / "qa").rglob("result.json"))) == 2
    code, found = said("batch", "qa.toml", "in", "-o", "again")
    assert code == 4
    assert "-s 'input.files=[\"*.x3p\"]'" in found.err


def test_one_number_for_several_reports_is_named_with_the_cure(home, capsys):
    call(home, "--dry-run", "--report", "number=2026-7")
    assert '"2026-7-{file}"' in capsys.readouterr().err
    call(home, "--dry-run", "--report", "number=2026-7-{file}")
    assert "is the same for" not in capsys.readouterr().err


@pytest.mark.parametrize(("installed", "best"), [(object(), "xlsx"), (None, "csv")])
def test_the_last_line_names_a_format_that_can_be_written_here(
    home, capsys, monkeypatch, installed, best
):
    monkeypatch.setattr("metrosep.cli.batches.find_spec", lambda _name: installed)
    call(home)
    assert f"--format {best} -o reports" in capsys.readouterr().err.splitlines()[-1]
