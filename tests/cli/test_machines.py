"""Whole machines by the command line: files of readings, circular tests, untidy ones too."""

from __future__ import annotations

import json
from typing import NamedTuple

import numpy as np
import pytest

EXAMPLE = "five_axis_calibration"
TERMS = "Y0A,Z0A,B0A,C0A,X0C,Y0C,A0C,B0C,C0Y,B0Z,A0Z,EXC,EYC,EZC,EAC,EBC,ECC"


@pytest.fixture
def folder(repository):
    return repository / "examples" / EXAMPLE


@pytest.fixture
def truth(folder):
    rows = (line.split(",") for line in (folder / "truth.csv").read_text("utf-8").splitlines()[1:])
    return {name: float(value) for name, value in rows}


@pytest.fixture
def call(metrosep):
    """Run a command line: an object with code, out, err."""

    def run(*words):
        return Done(*metrosep(*words))

    return run


class Done(NamedTuple):
    code: int
    out: str
    err: str


def calibrated(call, folder, *words):
    files = [str(folder / f"ball_{n}.csv") for n in (1, 2, 3)]
    return call("calibrate", "five_axis", *files, "--pivot-height", "80 mm", *words)


def test_planted_errors_come_back_and_go_on_to_the_tables(call, folder, truth, tmp_path):
    out = tmp_path / "terms"
    done = calibrated(call, folder, "--terms", TERMS, "--json", "-o", str(out))
    assert done.code == 0, done.err
    found = json.loads(done.out)
    assert found["null"] == []
    for name, value in truth.items():
        term = found["terms"][name]
        off = term["values"][0] * 1e6 - value
        assert abs(off) < 3.0 * term["u"][0] * 1e6, name
        assert term["u"][0] * 1e6 < 1.0, name
    assert found["terms"]["EXC"]["orders"] == ["cos2", "sin2", "cos3", "sin3"]
    assert 4 <= sum(found["refused"].values()) <= 8
    again = call(
        "machine-tables", "five_axis", str(out / "constants.toml"), "--pivot-height", "80 mm",
        "--over", "X", "--span", "X=0 mm..100 mm", "--spacing", "25 mm",
        "--corrects", "Y", "--at", "Y=0 mm", "--at", "Z=0 mm", "--at", "A=0 deg", "--at", "C=0 deg",
        "-o", str(tmp_path / "tables"),
    )  # fmt: skip
    assert again.code == 0, again.err
    # the line of A leans by C0A about Z, C0Y is no matter of X: Y must follow X by -C0A
    rows = np.loadtxt(tmp_path / "tables" / "x-y.csv", delimiter=",", comments="#", skiprows=1)
    assert rows.shape[0] == 5


def test_terms_are_not_replaced_without_force(call, folder, tmp_path):
    out = tmp_path / "terms"
    words = ("--terms", "X0C,Y0C", "-o", str(out))
    assert calibrated(call, folder, *words).code == 0
    done = calibrated(call, folder, *words)
    assert done.code != 0
    assert "give --force" in done.err
    assert calibrated(call, folder, *words, "--force").code == 0


def test_a_folder_that_cannot_be_made_is_one_sentence(call, folder, tmp_path):
    (tmp_path / "file").write_text("", "utf-8")
    done = calibrated(call, folder, "--terms", "X0C", "-o", str(tmp_path / "file" / "terms"))
    assert "the folder cannot be made" in done.err
    assert "internal error" not in done.err


def test_what_three_balls_cannot_tell_is_named(call, folder):
    done = calibrated(call, folder)
    assert done.code == 0
    assert "EXX      not determined" in done.out
    assert "ECX order 1: no reading depends on it" in done.out
    scales = next(line for line in done.out.splitlines() if line.startswith("EZZ order 1, EYY"))
    assert "not separable" in scales


def test_read_prints_what_the_instrument_would_read(call, folder, tmp_path):
    errors = tmp_path / "errors.toml"
    errors.write_text('X0C = "10 um"\n', "utf-8")
    done = call(
        "read", "five_axis", str(folder / "ball_1.csv"), str(errors), "--pivot-height", "80 mm"
    )
    rows = done.out.splitlines()
    assert rows[0] == "reading_x_um,reading_y_um,reading_z_um,left_x_um,left_y_um,left_z_um"
    # the line of C stands 10 um further along X: the ball goes with it, the tool is short of it
    values = [float(v) for v in rows[1].split(",")[:3]]
    np.testing.assert_allclose(values, [-10.0, 0.0, 0.0], rtol=0, atol=1e-6)


def test_untidy_files_of_readings_are_read(call, folder, truth, tmp_path):
    """Semicolons, decimal commas, a mark of Windows, columns in another order, lengths in m and mm."""
    files = []
    for n in (1, 2, 3):
        lines = (folder / f"ball_{n}.csv").read_text("utf-8").splitlines()
        head = [line for line in lines if line.startswith("#")]
        names = lines[len(head)].split(",")
        rows = [line.split(",") for line in lines[len(head) + 1 :]]
        order = [7, 3, 5, 0, 6, 4, 2, 1]
        text = [";".join(names[i] for i in order)]
        text += [";".join(row[i].replace(".", ",") for i in order) for row in rows]
        file = tmp_path / f"kugel {n}.txt"
        file.write_bytes(b"\xef\xbb\xbf" + "\r\n".join([*head, *text, ""]).encode("utf-8"))
        files.append(str(file))
    done = call(
        "calibrate", "five_axis", *files, "--pivot-height", "80 mm", "--terms", TERMS, "--json"
    )
    assert done.code == 0, done.err
    found = json.loads(done.out)
    for name, value in truth.items():
        term = found["terms"][name]
        assert abs(term["values"][0] * 1e6 - value) < 3.0 * term["u"][0] * 1e6, name


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.replace('# instrument = "nest"\n', ""), "no instrument is named"),
        (lambda t: t.replace('"nest"', '"nets"'), "nest"),
        (lambda t: t.replace("# unknown", "# unknwon"), "key of a nest"),
        (lambda t: t.replace("C_deg", "C"), "axis C"),
        (lambda t: t.replace("A_deg", "A_mm"), "A_mm"),
        (lambda t: t.replace("C_deg", "angle_deg"), "axis C has no column"),
        (lambda t: t.replace("reading_y_um", "reading_w_um"), "reading_y_um"),
        (lambda t: t.replace("# ball = ", "# ball = ["), "not TOML"),
        (lambda t: t.replace("reading_x_um", "reading_x_mm").replace("reading_y_um", "reading_y_mm"), "readings reach"),
    ],
)  # fmt: skip
def test_a_bad_file_of_readings_is_refused_in_a_sentence(call, folder, tmp_path, change, message):
    text = change((folder / "ball_1.csv").read_text("utf-8"))
    file = tmp_path / "bad.csv"
    file.write_text(text, "utf-8")
    done = call("calibrate", "five_axis", str(file), "--pivot-height", "80 mm", "--terms", "X0C")
    assert done.code in (2, 4)
    assert len(done.err.strip().splitlines()) == 1
    assert message in done.err
    assert "internal error" not in done.err


def test_a_circle_from_a_file(call, folder, tmp_path):
    picture = tmp_path / "circle.svg"
    done = call(
        "circle", str(folder / "circle.csv"), "--radius", "100 mm", "--feed", "1500 mm/min",
        "--figure", str(picture), "--json",
    )  # fmt: skip
    assert done.code == 0, done.err
    found = json.loads(done.out)["quantities"]
    planted = {
        "C0Y": 10e-6, "servo_mismatch": 0.2e-3, "lost_motion_X": 1.4e-6, "lost_motion_Y": 0.8e-6,
        "scale_mismatch": 20e-6,
    }  # fmt: skip
    for name, value in planted.items():
        assert abs(found[name]["value"] - value) < 3.0 * found[name]["u"], name
    assert picture.read_text("utf-8").startswith("<?xml")


def test_one_sense_and_a_column_that_is_not_there(call, folder, tmp_path):
    words = ("--radius", "100 mm", "--feed", "1500 mm/min")
    done = call("circle", str(folder / "circle.csv"), *words, "--ccw", "ccw_um")
    assert "one sense alone" in done.out
    other = tmp_path / "other.csv"
    other.write_text(
        (folder / "circle.csv").read_text("utf-8").replace("ccw_um,cw_um", "a_um,b_um"), "utf-8"
    )
    done = call("circle", str(other), *words)
    assert done.code == 2
    assert "no column ccw_um or cw_um" in done.err


def test_a_preset_that_needs_a_height_says_so(call, folder):
    done = call("calibrate", "five_axis", str(folder / "ball_1.csv"))
    assert "five_axis needs the height of its table" in done.err
    done = call("calibrate", "mill_xyz", str(folder / "ball_1.csv"))
    assert done.code == 4
    assert "the machine mill_xyz has no axis A" in done.err


def test_a_wave_is_ranked_from_the_command_line(call):
    done = call(
        "rank", "sts_lathe", "--form", "plane", "--radius", "25 mm", "--removed", "piston",
        "--error", "EZX=wave 8 mm 1 um",
    )  # fmt: skip
    assert done.code == 0, done.err
    assert "703.7" in done.out
