"""From readings to a controller's file: every route gives the same bytes, and keeps what was there.

The readings are written here as text, from a formula; what the file does is looked up here, as the
controller's manual says, without our simulator.
"""

import json
import shutil

import numpy as np
import pytest

UM = 1e-6
COLUMNS = ("--x", "x_mm", "--z", "z_um", "--feed", "feed_mm_min", "--run", "run")
AXES = ("--axis", "X", "--compensates", "X", "--spacing", "1.5 mm")
LOST_UM = 1.37
"""Reverse minus forward of the machine below."""


def error_um(x_mm):
    return 1.9 * np.sin(2 * np.pi * x_mm / 31.0 + 0.4) + 0.6 * np.cos(2 * np.pi * x_mm / 13.0)


def write_runs(path, *, samples=801, lost=LOST_UM, seed=5, feeds=(310, 470, 730), gain=1.0):
    """Two passes each way at three feedrates, 0 ... 60 mm, 20 nm of noise."""
    rng = np.random.default_rng(seed)
    rows = ["x_mm,z_um,feed_mm_min,run"]
    number = 0
    for feed in feeds:
        for way in (1, -1, 1, -1):
            x = np.linspace(0.0, 60.0, samples)[::way]
            z = gain * error_um(x) + (lost if way < 0 else 0.0) + rng.normal(0, 0.02, x.size)
            rows += [f"{a:.6f},{b:.6f},{feed},{number}" for a, b in zip(x, z, strict=True)]
            number += 1
    path.write_text("\n".join(rows) + "\n")
    return path


def looked_up(path, x_mm, way):
    """What LinuxCNC adds to the command, by its manual: nominal minus the column, linear between."""
    nominal, forward, reverse = np.loadtxt(path).T
    return np.interp(x_mm, nominal, nominal - (forward if way > 0 else reverse))


@pytest.mark.parametrize("samples", [301, 2600])
def test_separate_with_table_and_table_of_its_result_give_the_same_bytes(
    metrosep, tmp_path, samples
):
    runs = write_runs(tmp_path / "runs.csv", samples=samples)
    a, b, c = tmp_path / "a.comp", tmp_path / "b.comp", tmp_path / "inside" / "c.comp"

    for call in (
        ("separate", runs, *COLUMNS, "--table", f"linuxcnc={a}", *AXES),
        ("separate", runs, *COLUMNS, "-o", tmp_path / "result"),
        ("table", tmp_path / "result", "-o", b, *AXES),
        ("separate", runs, *COLUMNS, "-o", c.parent, "--table", "linuxcnc=c.comp", *AXES),
        ("table", c.parent, "-o", tmp_path / "d.comp", *AXES),
    ):
        code, _, err = metrosep(*call)
        assert code == 0, err

    files = [a, b, c, tmp_path / "d.comp"]
    assert len({f.read_bytes() for f in files}) == 1
    assert len({f.with_name(f.name + ".json").read_bytes() for f in files}) == 1
    x = np.linspace(2.0, 58.0, 57)
    added = 1e3 * np.array([looked_up(b, x, 1), looked_up(b, x, -1)])
    left = added + [error_um(x), error_um(x) + LOST_UM]
    line = np.polyval(np.polyfit(x, left.mean(axis=0), 1), x)  # of both ways together
    assert np.abs(left - line).max() < 0.06  # linear between entries: 1.5^2 / 8 times the bend


def test_a_result_holds_the_runs_as_they_were_measured(metrosep, tmp_path):
    runs = write_runs(tmp_path / "runs.csv", samples=2600)
    assert metrosep("separate", runs, *COLUMNS, "-o", tmp_path / "out")[0] == 0

    stored = json.loads((tmp_path / "out" / "result.json").read_text())["runs"]

    assert len(stored) == 12
    for i, run in enumerate(stored):
        way = (1, -1)[i % 2]
        assert run["direction"] == ("forward", "reverse")[i % 2]
        assert len(run["x_m"]) <= 2001
        assert sum(run["n"]) == 2600
        true = (error_um(np.array(run["x_m"]) * 1e3) + (LOST_UM if way < 0 else 0)) * UM
        away = np.array(run["z_m"]) - true
        assert abs(away.mean()) < 0.005 * UM  # not levelled
    assert len(json.dumps(stored, indent=1)) < 12 / 10 * 1.5e6


def test_a_result_of_an_older_version_names_the_command_that_makes_it_again(metrosep, tmp_path):
    runs = write_runs(tmp_path / "runs.csv", samples=301)
    out = tmp_path / "out"
    assert metrosep("separate", runs, *COLUMNS, "-o", out)[0] == 0
    document = json.loads((out / "result.json").read_text())
    del document["runs"]
    (out / "result.json").write_text(json.dumps(document))

    code, _, err = metrosep("table", out, "-o", tmp_path / "x.comp", *AXES)

    assert code == 4
    assert "run the separation again" in err
    assert not (tmp_path / "x.comp").exists()


@pytest.mark.parametrize("route", ["beside", "inside", "recipe", "table"])
def test_a_rerun_leaves_the_table_that_a_machine_may_use(metrosep, tmp_path, route):
    first = write_runs(tmp_path / "one.csv", samples=301)
    other = write_runs(tmp_path / "two.csv", samples=301, seed=8)
    out = tmp_path / "out"
    table = tmp_path / "x.comp" if route in ("beside", "table") else out / "x.comp"

    def again(runs, *more):
        if route == "beside":
            words = ("separate", runs, *COLUMNS, "--table", f"linuxcnc={table}", *AXES)
        elif route == "inside":
            words = ("separate", runs, *COLUMNS, "-o", out, "--table", "linuxcnc=x.comp", *AXES)
        elif route == "recipe":
            recipe = tmp_path / "recipe.toml"
            recipe.write_text(
                'metrosep = 1\n[input]\nx = "x_mm"\nz = "z_um"\nfeed = "feed_mm_min"\nrun = "run"\n'
                '[[step]]\nop = "separate"\n[[output]]\nkind = "table"\ncontroller = "linuxcnc"\n'
                'axis = "X"\ncompensates = "X"\nspacing = "1.5 mm"\npath = "x.comp"\n'
                'waive = ["active"]\n'
            )
            words = ("run", recipe, runs, "-o", out)
        else:
            shutil.rmtree(tmp_path / "result", ignore_errors=True)
            metrosep("separate", runs, *COLUMNS, "-o", tmp_path / "result")
            words = ("table", tmp_path / "result", "-o", table, *AXES)
        waive = () if route == "recipe" else ("--waive", "active")
        return metrosep(*words, *waive, *more)

    code, _, err = again(first)
    assert code == 0, err
    sidecar = table.with_name("x.comp.json")
    held, beside = table.read_bytes(), sidecar.read_bytes()
    code, _, err = again(first)  # the same bytes: nothing is replaced
    assert code == 0, err
    result = out / "result.json"
    before = result.read_bytes() if result.exists() else None

    code, _, err = again(other)

    assert code == 2
    assert "exists already" in err
    assert "--force" in err
    assert (table.read_bytes(), sidecar.read_bytes()) == (held, beside)
    assert before is None or result.read_bytes() == before
    assert not list(table.parent.glob("x.comp.1*"))

    code, _, err = again(other, "--force")

    assert code == 0, err
    assert table.read_bytes() != held
    assert table.with_name("x.comp.1").read_bytes() == held
    assert table.with_name("x.comp.1.json").read_bytes() == beside
