"""``table``, ``verify`` and ``controllers`` for every kind of carrier."""

import json
from pathlib import Path

import numpy as np
import pytest

import metrosep as ms
from metrosep.cli.main import main

COLUMNS = ("--x", "x_mm", "--z", "z_um", "--feed", "feed_mm_min", "--run", "run")

TRAVEL = ("--machine", "travel_low=0 mm", "--machine", "travel_high=45 mm")
"""The runs of the example reach beyond the travel that is used."""


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    out = tmp_path_factory.mktemp("result")
    folder = Path(__file__).parents[2] / "examples" / "straightness"
    text = (folder / "recipe.toml").read_text("utf-8")
    limits = 'length = "45 mm"\n'
    assert limits in text
    text = text.replace(limits, limits + 'shortest = "1 mm"\n')  # the folds cost a quarter
    ms.Recipe.parse(text).run(folder / "runs.csv", out=out)
    return out


@pytest.fixture
def metrosep(capsys):
    """Run a command line in this process: (code, stdout, stderr)."""

    def call(*words):
        with pytest.raises(SystemExit) as stop:
            main([str(w) for w in words])
        out = capsys.readouterr()
        assert "internal error" not in out.err
        return stop.value.code, out.out, out.err

    return call


@pytest.fixture
def error_map(tmp_path):
    """Heights in um over x, y in mm as text: +3 um at (12, 30) mm, different in x and y."""
    lines = []
    for y in np.linspace(0.0, 40.0, 21):
        for x in np.linspace(0.0, 50.0, 26):
            z = 3.0 * np.exp(-(((x - 12) / 10) ** 2) - ((y - 30) / 12) ** 2)
            lines.append(f"{x:.3f} {y:.3f} {z:.6f}")
    path = tmp_path / "bed.xyz"
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.slow
def test_a_table_for_a_controller_with_facts_of_the_machine(metrosep, result, tmp_path):
    out = tmp_path / "x.pmc"
    words = ("--axis", "X", "--compensates", "Z", "--spacing", "1 mm", "-o", out)

    code, _, err = metrosep("table", result, "--format", "pmac", *words)
    assert code == 2
    assert "--machine count=" in err
    assert not out.exists()

    machine = ("--machine", "count=10 nm", "--machine", "target_motor=2", *TRAVEL)
    code, _, err = metrosep("table", result, "--format", "pmac", *machine, *words)
    assert code == 0, err
    assert "dry-run forward" in err
    assert "DEFINE COMP" in out.read_text()


def test_an_unconfirmed_sign_needs_a_trial(metrosep, result, tmp_path):
    out = tmp_path / "cec.ini"
    words = ("--axis", "X", "--compensates", "Z", "--spacing", "1 mm", "-o", out)
    machine = ("--machine", "input_axis=AX1", "--machine", "output_axis=AX3")
    call = ("table", result, "--format", "sinumerik-cec", *machine, *TRAVEL, *words)

    code, _, err = metrosep(*call)
    assert code == 1
    assert "--sign-confirmed" in err
    assert "True" not in err
    assert not out.exists()

    code, _, err = metrosep(*call, "--trial", "2 um")
    assert code == 0, err
    assert "trial:" in err
    code, _, err = metrosep(*call, "--sign-confirmed", "--force")
    assert code == 0, err
    assert json.loads((tmp_path / "cec.ini.json").read_text())["sign_confirmed_by_user"] is True


def test_a_polynomial_for_a_plc(metrosep, result, tmp_path):
    out = tmp_path / "x.st"

    call = ("table", result, "--format", "plc-st", "--poly", "6", *TRAVEL, "-o", out)
    call += ("--machine", "actuator_sign=1")

    code, _, err = metrosep(*call)
    assert code == 1
    assert (
        "pointless: 93" in err
    )  # six powers do not follow the waves of the screw, the line apart
    assert not out.exists()

    code, _, err = metrosep(*call, "--waive", "pointless")
    assert code == 0, err
    assert "accepted with --waive pointless" in err
    assert "LREAL" in out.read_text()


def test_a_map_for_a_controller_and_back(metrosep, error_map, tmp_path):
    out = tmp_path / "bed.cal"
    signs = ("row_axis=2", "column_axis=1", "corrected_axis=4")
    signs += ("row_sign=1", "column_sign=1", "corrected_sign=-1")
    machine = [w for s in signs for w in ("--machine", s)]
    units = ("--unit", "mm,mm,um")

    code, _, err = metrosep(
        "table",
        error_map,
        *units,
        "--format",
        "aerotech",
        *machine,
        "--spacing",
        "2 mm",
        "-o",
        out,
    )
    assert code == 0, err
    assert "P-V 3000" in err or "P-V 2999" in err or "P-V 29" in err
    code, _, err = metrosep("verify", out, "--against", error_map, *units)
    assert code == 0, err

    code, _, err = metrosep(
        "verify", out, "--against", error_map, *units, "--machine", "corrected_sign=1"
    )
    assert code != 0


def test_a_map_says_what_lies_beyond_nodes_counted_from_its_zero(metrosep, tmp_path):
    """Of 3 um, 2 (1 - 0.85^2) + 15/60 = 0.805 um lie beyond X = 85 mm and Y = 45 mm, and less at the other ends."""
    rows = [
        f"{x} {y} {2 * (x / 100) ** 2 + y / 60:.9f}" for y in range(61) for x in range(0, 101, 2)
    ]
    (tmp_path / "bed.xyz").write_text("\n".join(rows) + "\n")
    words = ["table", tmp_path / "bed.xyz", "--unit", "mm,mm,um", "--format", "csv-map"]
    words += ["--spacing", "20 mm", "--out"]

    code, _, err = metrosep(*words, tmp_path / "a.csv", "--reference", "45 mm, 25 mm")
    assert code == 0, err
    assert "X = 5 mm ... 85 mm and Y = 5 mm ... 45 mm, the error is known over X = 0 mm" in err
    assert "beyond the entries up to 27% of it stays" in err
    told = json.loads((tmp_path / "a.csv.json").read_text())
    assert any("beyond the entries" in note for note in told["table"]["notes"])
    code, _, err = metrosep(*words, tmp_path / "b.csv", "--reference", "0 mm, 0 mm")
    assert code == 0, err
    assert "beyond the entries" not in err


def test_a_file_without_sidecar_needs_its_controller(metrosep, tmp_path, error_map):
    path = tmp_path / "unknown.cal"
    path.write_text("; nothing\n")

    code, _, err = metrosep("verify", path, "--against", error_map)

    assert code == 2
    assert "--format" in err


def test_controllers_tells_all_about_one(metrosep):
    code, out, _ = metrosep("controllers", "pmac")
    assert code == 0
    for word in ("count", "required", "1/16", "activation", "--format pmac"):
        assert word in out
    code, out, _ = metrosep("controllers", "pmac", "--json")
    assert json.loads(out)["controllers"][0]["options"][0]["name"] == "count"
    code, _, err = metrosep("controllers", "pmak")
    assert code == 2
    assert "pmac" in err


def test_the_axes_are_those_of_the_result(metrosep, result, tmp_path):
    """The example corrects Z over X: loaded as X over X it would spoil X."""
    call = ("table", result, "--spacing", "1 mm", "-o", tmp_path / "x.csv", "--format", "csv")

    code, _, err = metrosep(*call, "--compensates", "X")
    assert code == 2
    assert "Z over X" in err
    code, _, err = metrosep(*call, *TRAVEL)
    assert code == 0, err
    assert json.loads((tmp_path / "x.csv.json").read_text())["table"]["compensates"] == "Z"


def test_the_polynomial_is_that_of_the_result(metrosep, result, tmp_path):
    degree = json.loads((result / "result.json").read_text())["polynomial"]["degree"]
    machine = ("--machine", "actuator_sign=1", *TRAVEL)

    code, _, err = metrosep(
        "table",
        result,
        "--format",
        "plc-st",
        *machine,
        "--waive",
        "pointless",
        "-o",
        tmp_path / "p.st",
    )

    assert code == 0, err
    assert json.loads((tmp_path / "p.st.json").read_text())["table"]["degree"] == degree
