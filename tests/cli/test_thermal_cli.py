"""Errors from temperatures by the command line, on a column that a simulator of its own heats."""

from __future__ import annotations

import json
import tomllib

import pytest

from metrosep.cli.main import main

COLUMNS = ("--time", "t_s", "--temperature", "bearing_degC,column_degC,room_degC")
READ = ("--reading", "EZZ_um", "--tilt", "EBX_urad")


@pytest.fixture(scope="module")
def folder(repository):
    return repository / "examples" / "thermal"


@pytest.fixture(scope="module")
def stored(folder, tmp_path_factory):
    """The thermal.json of the warm-up, fitted once: nobody writes to it."""
    out = tmp_path_factory.mktemp("thermal") / "fit"
    with pytest.raises(SystemExit) as stop:
        main(["thermal", str(folder / "warm_up.csv"), *COLUMNS, *READ, "-o", str(out)])
    assert stop.value.code == 0
    return out / "thermal.json"


def test_the_end_of_another_day_is_foretold(metrosep, folder, stored, tmp_path):
    truth = dict(r.split(",") for r in (folder / "truth.csv").read_text("utf-8").split()[1:])
    _, out, _ = metrosep(
        "thermal", str(stored), "--history", str(folder / "today.csv"), *COLUMNS, "--json",
        "-o", str(tmp_path / "today"),
    )  # fmt: skip
    found = json.loads(out)["errors"]
    for name, unit in (("EZZ", "um"), ("EBX", "urad")):
        planted = float(truth[f"{name}_{unit}"]) * 1e-6
        assert abs(found[name]["value"] - planted) < 3.0 * found[name]["u"]
        assert abs(found[name]["value"] - planted) < 0.02 * abs(planted)
    constants = tomllib.loads((tmp_path / "today" / "constants.toml").read_text("utf-8"))
    assert float(constants["EZZ"].split()[0]) < -12.0  # the nose sinks: towards -Z


def test_stated_temperatures_become_a_table(metrosep, stored, tmp_path):
    warm = ("--at", "bearing=22 degC", "--at", "column=22 degC", "--at", "room=20.5 degC")
    code, out, _ = metrosep("thermal", str(stored), *warm, "-o", str(tmp_path / "warm"))
    assert code == 0
    assert out.startswith("EZZ")
    nod = tomllib.loads((tmp_path / "warm" / "constants.toml").read_text("utf-8"))["EBX"]
    nod = float(nod.split()[0]) * 1e-6
    code, _, _ = metrosep(
        "machine-tables", "mill_xyz", str(tmp_path / "warm" / "constants.toml"), "--over", "Z",
        "--span", "Z=0 mm..200 mm", "--spacing", "100 mm", "--at", "X=0 mm", "--at", "Y=0 mm",
        "-o", str(tmp_path / "tables"),
    )  # fmt: skip
    assert code == 0
    table = next(f for f in (tmp_path / "tables").iterdir() if f.suffix == ".csv")
    rows = [r.split(",") for r in table.read_text("utf-8").splitlines() if r[0].isdecimal()]
    # a column that nods by +EBX carries the tool at height z to +X by EBX z; the correction is minus that
    assert nod > 5e-6
    assert abs(float(rows[-1][1]) * 1e-6 + nod * 0.2) < 10e-9  # um in the file, three digits


def test_temperatures_beyond_the_record_are_refused(metrosep, stored):
    hot = ("--at", "bearing=60 degC", "--at", "column=22 degC", "--at", "room=20.5 degC")
    code, _, err = metrosep("thermal", str(stored), *hot)
    assert code != 0
    assert "nothing is extrapolated" in err
    code, _, err = metrosep("thermal", str(stored), "--at", "bearing=22 degC")
    assert code != 0
    assert "'column', which is not given" in err or "'room', which is not given" in err


def test_a_recipe_makes_the_same_bytes(metrosep, folder, stored, tmp_path):
    words = ("thermal", str(folder / "warm_up.csv"), *COLUMNS, *READ)
    _, printed, _ = metrosep(*words, "--print-recipe")
    recipe = tmp_path / "thermal.toml"
    recipe.write_text(printed, "utf-8")
    assert metrosep("run", str(recipe), "-o", str(tmp_path / "again"))[0] == 0
    assert (tmp_path / "again" / "thermal.json").read_bytes() == stored.read_bytes()


def test_what_is_missing_is_said(metrosep, folder, stored, tmp_path):
    file = str(folder / "warm_up.csv")
    assert "Missing option '--temperature'" in metrosep("thermal", file, "--time", "t_s")[2]
    assert "no reading is named" in metrosep("thermal", file, *COLUMNS)[2]
    assert "--at, or a log" in metrosep("thermal", str(stored))[2]
    wrong = metrosep("thermal", file, *COLUMNS, *READ, "--term", "EZZ=EBX")[2]
    assert "EZZ is a length by its unit, and EBX is not" in wrong
    bare = tmp_path / "bare.csv"
    bare.write_text((folder / "warm_up.csv").read_text("utf-8").replace("_degC", ""), "utf-8")
    named = ("--time", "t_s", "--temperature", "bearing,column", "--reading", "EZZ_um")
    assert "declares no unit of a temperature" in metrosep("thermal", str(bare), *named)[2]
    broken = tmp_path / "broken.json"
    broken.write_text("{}", "utf-8")
    assert "fit the record again" in metrosep("thermal", str(broken), "--at", "a=20 degC")[2]


def test_two_places_make_a_table_over_the_axis(metrosep, folder, tmp_path):
    rows = (folder / "warm_up.csv").read_text("utf-8").splitlines()
    lines = ["t_s,screw_degC,near_um,far_um"]
    for row in rows[1:]:
        t, bearing, *_ = row.split(",")
        grown = float(bearing) - 20.0
        lines.append(f"{t},{bearing},{0.5 * grown:.4f},{4.5 * grown:.4f}")
    file = tmp_path / "axis.csv"
    file.write_text("\n".join(lines) + "\n", "utf-8")
    code, _, err = metrosep(
        "thermal", str(file), "--time", "t_s", "--temperature", "screw_degC", "--reading",
        "near_um,far_um", "--term", "near=EXX at 50 mm", "--term", "far=EXX at 450 mm",
        "--at", "screw=22 degC", "-o", str(tmp_path / "out"),
    )  # fmt: skip
    assert code == 0, err
    table = (tmp_path / "out" / "X.csv").read_text("utf-8").splitlines()
    first, last = ([float(v) for v in table[i].split(",")] for i in (1, -1))
    assert first[0] == 50.0
    assert abs(last[1] - first[1] - 8.0) < 0.1  # um, for 2 K
