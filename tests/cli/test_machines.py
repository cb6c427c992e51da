"""Whole machines by the command line: files of readings, circular tests, untidy ones too."""

from __future__ import annotations

import json
import re
import shlex
from importlib.resources import files
from pathlib import Path
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
    sheets = [str(folder / f"ball_{n}.csv") for n in (1, 2, 3)]
    return call("calibrate", "five_axis", *sheets, "--pivot-height", "80 mm", *words)


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
    curve = found["terms"]["EXC"]
    assert curve["orders"][: curve["fitted"]] == ["cos2", "sin2", "cos3", "sin3"]
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
    assert "is a file, not a folder; choose another" in done.err
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
    assert "ball_1.csv calls unknown (ball)" in done.err
    # the line of C stands 10 um further along X: the ball goes with it, the tool is short of it
    values = [float(v) for v in rows[1].split(",")[:3]]
    np.testing.assert_allclose(values, [-10.0, 0.0, 0.0], rtol=0, atol=1e-6)


def test_the_last_line_of_a_calibration_runs_as_it_is_printed(call, folder, tmp_path, monkeypatch):
    """A mill of which two set-ups read X and Y: each other axis has its place in the line."""
    monkeypatch.chdir(tmp_path)
    there = folder.parent / "mill_instruments"
    sets = [str(there / f"{name}.csv") for name in ("laser_linear", "level")]
    done = call("calibrate", "mill_xyz", *sets, "-o", "terms")
    last = done.err.splitlines()[-1]
    assert last.startswith("next: metrosep machine-tables mill_xyz terms --over X ")
    made = call(*shlex.split(last.removeprefix("next: metrosep ")))
    assert made.code == 0, made.err
    assert (tmp_path / "tables" / "x-x.csv").is_file()


def test_a_line_that_stands_beside_its_place_is_an_offset_and_needs_no_table(
    call, folder, tmp_path, monkeypatch
):
    """X0C shifts the table alike at every A and C; Y0C only as long as A does not turn."""
    monkeypatch.chdir(tmp_path)
    words = ("--pivot-height", "80 mm")
    done = calibrated(call, folder, "--terms", "X0C", "-o", "of_x")
    assert done.err.splitlines()[-1].startswith("note: no table is needed")
    done = calibrated(call, folder, "--terms", "X0C,Y0C", "-o", "terms")
    last = done.err.splitlines()[-1]
    assert "--over A,C " in last
    assert call(*shlex.split(last.removeprefix("next: metrosep "))).code == 0
    (tmp_path / "of_x" / "constants.toml").write_text('X0C = "10 um"\n', "utf-8")
    refused = call(
        "machine-tables", "five_axis", "of_x/constants.toml", *words, "--over", "C",
        "--spacing", "36 deg", "--span", "C=0 deg..360 deg", "-o", "none",
        *(w for a in ("X=0 mm", "Y=0 mm", "Z=0 mm", "A=0 deg") for w in ("--at", a)),
    )  # fmt: skip
    assert refused.code == 2
    assert "(error X -10 um)" in refused.err  # the table is at +10 um, the tool is short of it
    assert "offset of X in the control" in refused.err


def test_the_last_line_proposes_tables_over_what_was_read(call, folder, tmp_path, monkeypatch):
    """A was read from -90 to 30 deg: its location errors alone do not say so; its zero is a node."""
    monkeypatch.chdir(tmp_path)
    sets = [str(folder / f"ball_{i}.csv") for i in (1, 2, 3)]
    done = call(
        "calibrate", "five_axis", *sets, "--pivot-height", "80 mm",
        "--terms", "Y0A,Z0A,B0A,C0A,X0C,Y0C,A0C,B0C,C0Y,B0Z,A0Z,EXC,EZC", "-o", "terms",
    )  # fmt: skip
    last = done.err.splitlines()[-1]
    assert '--over A,C --spacing "A=10 deg,C=36 deg" --span "A=-90 deg..30 deg"' in last
    made = call(*shlex.split(last.removeprefix("next: metrosep ")))
    assert made.code == 0, made.err
    assert "not a node" not in made.err
    assert "at the reference" not in made.err


def test_the_last_line_stays_in_the_travels_of_the_machine(call, folder, tmp_path, monkeypatch):
    """A Z that does not reach its zero, and a C that goes round within -185 to 185 deg."""
    monkeypatch.chdir(tmp_path)
    preset = files("metrosep.machine").joinpath("presets_data")
    mill = preset.joinpath("mill_xyz.toml").read_text("utf-8")
    Path("low.toml").write_text(
        mill.replace('direction = "+Z"', 'direction = "+Z"\ntravel_mm = [-400, -100]'), "utf-8"
    )
    laser = (folder.parent / "mill_instruments" / "laser_linear.csv").read_text("utf-8")
    Path("laser.csv").write_text(laser.replace('Z = "0 mm"', 'Z = "-200 mm"'), "utf-8")
    done = call("calibrate", "low.toml", "laser.csv", "--terms", "EXX", "-o", "of_x")
    assert done.code == 0, done.err
    last = done.err.splitlines()[-1]
    assert '--at "Z=-200 mm"' in last
    assert call(*shlex.split(last.removeprefix("next: metrosep "))).code == 0

    five = preset.joinpath("five_axis.toml").read_text("utf-8").split("[[element]]")
    five[0] = five[0].partition("[parameters")[0]
    five[-1] = five[-1].replace('"pivot_height"', "0.08")
    five[-1] = five[-1].replace('direction = "-Z"', 'direction = "-Z"\ntravel_deg = [-185, 185]')
    Path("round.toml").write_text("[[element]]".join(five), "utf-8")
    sets = []
    for n in (1, 2, 3):
        head, *rows = re.split(r"(?m)^(?=[-\d])", (folder / f"ball_{n}.csv").read_text("utf-8"))
        at = head.splitlines()[-1].split(",").index("C_deg")
        turned = [r.split(",") for r in rows]
        turned = [[*r[:at], f"{(float(r[at]) + 180) % 360 - 180:g}", *r[at + 1 :]] for r in turned]
        sets.append(f"turned_{n}.csv")
        Path(sets[-1]).write_text(head + "".join(",".join(r) for r in turned), "utf-8")
    done = call("calibrate", "round.toml", *sets, "--terms", "X0C,Y0C,Y0A,Z0A", "-o", "c")
    assert done.code == 0, done.err
    last = done.err.splitlines()[-1]
    assert '--span "C=-180 deg..180 deg"' in last
    made = call(
        *shlex.split(last.removeprefix("next: metrosep ").replace("-o tables", "-o round"))
    )
    assert made.code == 0, made.err


def test_an_angle_alone_acts_through_the_arm_of_the_tool(call, folder, tmp_path, monkeypatch):
    """A level on Y finds EAY: at the end of the tool branch with Z = 0 it moves nothing, below that it does."""
    monkeypatch.chdir(tmp_path)
    level = str(folder.parent / "mill_instruments" / "level.csv")
    done = call("calibrate", "mill_xyz", level, "--terms", "EAY", "--degree", "Y=3", "-o", "terms")
    last = done.err.splitlines()[-1]
    assert "no table is needed" not in done.err
    assert "EAY acts through the arm" in last
    line = shlex.split(re.search(r"metrosep (machine-tables .*-o tables)", last)[1])
    made = call(*line)
    assert made.code == 0, made.err
    where = line.index("--tool")
    refused = call(*line[:where], *line[where + 2 : -1], "none")
    assert refused.code == 2
    assert "acts through an arm" in refused.err
    # the tool tip stands 150 mm below: an angle about X moves it along Y by -(-0.15) times the angle
    rows = [r.split(",") for r in Path("terms/Y.csv").read_text("utf-8").splitlines()]
    at = next(i for i, name in enumerate(rows[0]) if name.startswith("EAY"))
    angle = {float(r[0]): float(r[at]) for r in rows[1:]}
    table = [r.split(",") for r in Path("tables/y-y.csv").read_text("utf-8").splitlines()]
    _, first, *_, last_row = table
    change = float(last_row[1]) - float(first[1])
    error = 0.150 * (angle[float(last_row[0])] - angle[float(first[0])])
    assert change == pytest.approx(-error, abs=1e-3)  # um: a nanometre


def test_readings_that_determine_nothing_say_so(call, folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    laser = str(folder.parent / "mill_instruments" / "laser_linear.csv")  # along X: blind to roll
    done = call("calibrate", "mill_xyz", laser, "--terms", "EAX", "-o", "terms")
    assert done.code == 0, done.err
    assert "determine no term" in done.err.splitlines()[-1]


def test_untidy_files_of_readings_are_read(call, folder, truth, tmp_path):
    """Semicolons, decimal commas, a mark of Windows, columns in another order, lengths in m and mm."""
    sheets = []
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
        sheets.append(str(file))
    done = call(
        "calibrate", "five_axis", *sheets, "--pivot-height", "80 mm", "--terms", TERMS, "--json"
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
        (lambda t: t.replace("reading_x_um", "reading_x"), "with its unit, such as reading_x_um"),
        (lambda t: t.replace("X_mm", "X"), "(axis X) declares no unit that is known; name it with its unit, such as X_mm"),
        (lambda t: t.replace("A_deg", "A [furlong]"), "such as A_deg"),
        (lambda t: t.replace('"nest"', '"nets"'), "nest"),
        (lambda t: t.replace('"nest"', '"laser"'), "did you mean displacement (linear or straightness optics)"),
        (lambda t: t.replace('"nest"', '"Dial indicator"'), "did you mean displacement, with the direction"),
        (lambda t: t.replace('"nest"', '"spirit level"'), "did you mean angle"),
        (lambda t: t.replace('"nest"', '"double-ballbar"'), "did you mean ballbar?"),
        (lambda t: t.replace('"nest"', '"R-test"'), "did you mean nest?"),
        (lambda t: t.replace("# unknown", "# unknwon"), "key of a nest"),
        (lambda t: t.replace("C_deg", "C"), "axis C"),
        (lambda t: t.replace("A_deg", "A_mm"), "A_mm"),
        (lambda t: t.replace("C_deg", "angle_deg"), "axis C has no column"),
        (lambda t: t.replace("C_deg", "turn").replace("Z_mm", "lift"),
         'axis Z, C has no column and no place, and each needs one. The file has X_mm, Y_mm, lift, A_deg, turn,'),
        (lambda t: t.replace("C_deg", "turn").replace("Z_mm", "lift"), '# at = { Z = "0 mm", C = "0 deg" }'),
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
    assert done.code == 4
    assert "has no columns of a circular test" in done.err
    assert "a_um, b_um" in done.err


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


def test_a_recipe_makes_the_same_bytes(call, folder, tmp_path):
    one, two = tmp_path / "call", tmp_path / "recipe"
    words = ("--terms", "Y0A,Z0A,X0C,Y0C", "--degree", "C=2", "--home", "X=0 mm")
    printed = calibrated(call, folder, *words, "--print-recipe")
    assert calibrated(call, folder, *words, "-o", str(one)).code == 0
    recipe = tmp_path / "calibrate.toml"
    recipe.write_text(printed.out, "utf-8")
    assert call("run", str(recipe), "-o", str(two)).code == 0
    written = {"constants.toml", "calibration.json", "report.html", "parts-residuals.csv"}
    assert written < {f.name for f in one.iterdir()}
    for name in sorted(written - {"report.html"}):
        assert (one / name).read_bytes() == (two / name).read_bytes()
    report = (two / "report.html").read_text("utf-8")
    assert "Location errors: displacements" in report
    assert "Residuals in the order of time" in report


def test_the_report_names_what_is_not_determined(call, folder, tmp_path):
    assert calibrated(call, folder, "-o", str(tmp_path / "out")).code == 0
    report = (tmp_path / "out" / "report.html").read_text("utf-8")
    assert "not separable" in report
    assert "Volumetric error" in report


def test_the_report_of_a_circle_keeps_capitals_and_the_unit_of_its_feed(call, folder, tmp_path):
    words = ("circle", str(folder / "circle.csv"), "--radius", "100 mm", "--feed", "1500 mm/min")
    call(*words, "-o", str(tmp_path / "out"))
    assert json.loads((tmp_path / "out" / "result.json").read_text("utf-8"))["title"] == (
        "Circular test of two axes after ISO 230-4"
    )
    page = (tmp_path / "out" / "report.html").read_text("utf-8")
    assert "feed mm" not in page
    assert ">1500 mm/min<" in page


def test_a_circle_by_a_recipe(call, folder, tmp_path):
    words = ("circle", str(folder / "circle.csv"), "--radius", "100 mm", "--feed", "1500 mm/min")
    recipe = tmp_path / "circle.toml"
    recipe.write_text(call(*words, "--print-recipe").out, "utf-8")
    one, two = tmp_path / "one", tmp_path / "two"
    assert call(*words, "-o", str(one)).code == 0
    assert call("run", str(recipe), "-o", str(two)).code == 0
    assert (one / "parts.csv").read_bytes() == (two / "parts.csv").read_bytes()
    checked = (
        recipe.read_text("utf-8")
        + '\n[[check]]\nmetric = "C0Y"\nlower = "5 urad"\nupper = "15 urad"\n'
    )
    recipe.write_text(checked, "utf-8")
    assert "accept" in call("run", str(recipe), "-o", str(tmp_path / "three")).err


def log_of(*, header=True, numbered=False, overrun=False):
    """A servo log of a circle in both senses: commanded positions, and the reading of a bar.

    Two slides that are late, loose and not square, as bodies: no formula of a circular test.
    """
    rng = np.random.default_rng(4)
    radius, feed = 0.1, 1.5 / 60.0
    lines, n = [], 0
    for sense in (1.0, -1.0):
        w = sense * feed / radius
        t = np.linspace(0.05, 0.05 + 2.2 * np.pi / abs(w), 7000)  # a turn and a tenth
        x = radius * np.cos(w * (t - 0.7e-3)) + 0.7e-6 * np.sign(np.sin(w * t)) * sense
        y = radius * np.sin(w * (t - 0.5e-3)) - 0.4e-6 * np.sign(np.cos(w * t)) * sense
        r = np.hypot(x - 10e-6 * y + 8e-6, y - 3e-6) - radius + 0.1e-6 * rng.normal(size=t.size)
        for place, reading in zip(w * t, r, strict=True):
            tag = f"{n} " if numbered else ""
            at = f"{40.0 + 100.0 * np.cos(place):.6f} {-15.0 + 100.0 * np.sin(place):.6f}"
            lines.append(f"{tag}{at} {reading * 1e6:.6f} ")
            n += 1
        lines += [lines[-1]] * 300  # it dwells
        if overrun:
            lines.append("overrun")
    return "\n".join((["x_mm y_mm reading_um"] if header else []) + lines) + "\n"


@pytest.mark.parametrize("how", ["header", "halsampler"])
def test_a_log_of_positions_is_a_circular_test(call, tmp_path, how):
    words = ("--radius", "100 mm", "--feed", "1500 mm/min", "--json")
    file = tmp_path / "circle.log"
    if how == "header":
        file.write_text(log_of(), "utf-8")
        done = call("circle", str(file), *words)
    else:
        file.write_text(log_of(header=False, numbered=True, overrun=True), "utf-8")
        named = ("--x", "2:mm", "--y", "3:mm", "--reading", "4:um")
        done = call("circle", str(file), *named, *words)
    found = json.loads(done.out)["quantities"]
    planted = {
        "C0Y": 10e-6,
        "lost_motion_X": 1.4e-6,
        "lost_motion_Y": 0.8e-6,
        "servo_mismatch": 0.2e-3,
    }
    for name, value in planted.items():
        assert abs(found[name]["value"] - value) < max(4.0 * found[name]["u"], 1e-3 * value), name
    assert found["C0Y"]["u"] < 0.2e-6


def test_senses_one_after_the_other_in_one_column(call, folder, tmp_path):
    words = ("--radius", "100 mm", "--feed", "1500 mm/min", "--json")
    plain = json.loads(call("circle", str(folder / "circle.csv"), *words).out)["quantities"]
    rows = [r.split(",") for r in (folder / "circle.csv").read_text("utf-8").splitlines()[1:]]
    lines = ['"Winkel (°)";"Radial deviation [µm]"']
    lines += [f"{r[0]};{r[1]}".replace(".", ",") for r in rows]
    lines += [f"{r[0]};{r[2]}".replace(".", ",") for r in rows[::-1]]
    file = tmp_path / "beide.csv"
    file.write_text("\n".join(lines) + "\n", "cp1252")
    found = json.loads(call("circle", str(file), *words).out)["quantities"]
    assert found == plain


def test_the_encoders_alone_are_a_circular_test(call, tmp_path):
    a = np.linspace(0.0, 2 * np.pi, 4001)
    lines = ["X [mm];Y [mm]"]
    for sense in (1, -1):
        x, y = 150 * np.cos(sense * a), 150 * np.sin(sense * a)
        x = x - 20e-6 * y  # the second axis leans by 20 urad towards -x
        lines += [f"{u:.7f};{v:.7f}" for u, v in zip(x, y, strict=True)]
    file = tmp_path / "grid.csv"
    file.write_text("\n".join(lines) + "\n", "utf-8")
    done = call("circle", str(file), "--radius", "150 mm", "--feed", "1000 mm/min", "--json")
    found = json.loads(done.out)["quantities"]
    assert abs(found["C0Y"]["value"] - 20e-6) < 0.05e-6
    wrong = call("circle", str(file), "--radius", "100 mm", "--feed", "1000 mm/min")
    assert "circle of 150 mm, the programmed radius is 100 mm" in wrong.err


@pytest.mark.parametrize(
    ("plane", "term", "sign"),
    [("XY", "C0Y", 1), ("YZ", "A0Z", 1), ("XZ", "B0Z", -1), ("ZX", "B0Z", -1)],
)
@pytest.mark.parametrize("columns", ["XYZ", "ZYX", "plane"])
def test_the_plane_says_which_positions_of_a_log_run(call, tmp_path, plane, term, sign, columns):
    """Encoders of all axes: the second of the plane leans by 20 urad towards the first one's minus."""
    a = np.concatenate([np.linspace(0.0, 2 * np.pi, 2001), np.linspace(2 * np.pi, 0.0, 2001)])
    second = 150 * np.sin(a)
    at = dict.fromkeys("XYZ", np.full(a.size, 31.0))
    at |= {plane[0]: 40 + 150 * np.cos(a) - 20e-6 * second, plane[1]: -60 + second}
    names = sorted(plane) if columns == "plane" else columns
    rows = np.column_stack([at[n] for n in names])
    file = tmp_path / "log.csv"
    np.savetxt(
        file,
        rows,
        fmt="%.7f",
        delimiter=";",
        header=";".join(f"{n} [mm]" for n in names),
        comments="",
    )
    words = (str(file), "--radius", "150 mm", "--feed", "1000 mm/min")
    done = call("circle", *words, "--plane", plane, "--json")
    assert done.code == 0, done.err
    found = json.loads(done.out)["quantities"]
    assert found[term]["value"] == pytest.approx(sign * 20e-6, abs=0.05e-6)
    assert abs(found["scale_mismatch"]["value"]) < 0.1e-6
    if columns == "plane" and plane != "XY":
        asked = call("circle", *words)
        assert asked.code == 4
        assert f"--plane {''.join(names)}" in asked.err


def log_of_axes(file, axes, plane, *, angle=False):
    """Write encoders of some axes: the circle runs in `plane`, its second axis leans by 20 urad to minus."""
    a = np.concatenate([np.linspace(0.0, 2 * np.pi, 721), np.linspace(2 * np.pi, 0.0, 721)])
    second = 150 * np.sin(a)
    at = dict.fromkeys("XYZ", np.full(a.size, 31.0))
    at |= {plane[0]: 40 + 150 * np.cos(a) - 20e-6 * second, plane[1]: -60 + second}
    rows, names = [at[n] for n in axes], [f"{n} [mm]" for n in axes]
    if angle:
        rows, names = [np.degrees(a), *rows, 3.0 + a], ["angle [deg]", *names, "reading [um]"]
    head = ";".join(names)
    np.savetxt(file, np.column_stack(rows), fmt="%.7f", delimiter=";", header=head, comments="")
    return str(file), "--radius", "150 mm", "--feed", "1000 mm/min"


@pytest.mark.parametrize("values", ["ccw", "reading"])
def test_positions_beside_an_angle_ask_for_no_plane(call, tmp_path, values):
    file = tmp_path / "log.csv"
    words = log_of_axes(file, "XZ", "XZ", angle=True)
    rows = file.read_text("utf-8").replace("reading", values).splitlines()[:722]  # one turn
    found = []
    for kept in (slice(0, 4), slice(0, 4, 3)):  # with the positions and without
        file.write_text("\n".join(";".join(r.split(";")[kept]) for r in rows), "utf-8")
        done = call("circle", *words, "--uncalibrated", "--json")
        assert done.code == 0, done.err
        found.append(json.loads(done.out)["quantities"])
    assert found[0] == found[1]


@pytest.mark.parametrize(
    ("axes", "plane", "right"), [("XY", "ZX", "XY"), ("XY", "YZ", "XY"), ("YZ", "XZ", "YZ")]
)
def test_a_log_of_other_axes_than_those_of_the_plane_is_refused(
    call, tmp_path, axes, plane, right
):
    words = log_of_axes(tmp_path / "log.csv", axes, axes)
    done = call("circle", *words, "--plane", plane)
    assert done.code == 4
    assert f"positions of {axes[0]} and {axes[1]}, and the plane is {plane}" in done.err
    assert f"give --plane {right}, or name the columns with --x and --y" in done.err
    named = ("--x", f"{axes[0]} [mm]", "--y", f"{axes[1]} [mm]")
    assert call("circle", *words, "--plane", plane, *named).code == 0


@pytest.mark.parametrize("named", ["x", "y"])
@pytest.mark.parametrize("plane", ["XZ", "ZX"])
def test_one_named_column_leaves_the_other_to_the_plane(call, tmp_path, plane, named):
    words = log_of_axes(tmp_path / "log.csv", "XYZ", plane)
    column = f"{plane['xy'.index(named)]} [mm]"
    done = call("circle", *words, "--plane", plane, f"--{named}", column, "--json")
    assert done.code == 0, done.err
    found = json.loads(done.out)["quantities"]
    assert found["B0Z"]["value"] == pytest.approx(-20e-6, abs=0.05e-6)  # counts of 0.1 nm
    alone = log_of_axes(tmp_path / "xy.csv", "XY", "XY")
    done = call("circle", *alone, "--plane", "XZ", "--x", "X [mm]")
    assert done.code == 4
    assert "and the plane is XZ" in done.err


def test_columns_that_both_may_be_the_angle_are_asked_for(call, folder, tmp_path):
    text = (folder / "circle.csv").read_text("utf-8").replace("cw_um\n", "cw_um,Winkel_deg\n")
    rows = text.splitlines()
    file = tmp_path / "two.csv"
    file.write_text("\n".join([rows[0], *(f"{r},{r.split(',')[0]}" for r in rows[1:])]), "utf-8")
    done = call("circle", str(file), "--radius", "100 mm", "--feed", "1500 mm/min")
    assert "may both be the angle" in done.err
    done = call(
        "circle", str(file), "--radius", "100 mm", "--feed", "1500 mm/min", "--angle", "angle_deg"
    )
    assert done.code == 0


def test_diagonals_from_files_give_squareness(call, tmp_path):
    """Ways of X, Y and Z as lines in space; the laser looks along the nominal diagonal, 0.1 mrad off."""
    span = np.array([0.5, 0.4, 0.3])
    ways = np.array([[1.0, 0, 0], [-12e-6, 1, 0], [-7e-6, -9e-6, 1]])  # C0Y 12, B0Z -7, A0Z 9
    files = []
    for n, flips in enumerate([(1, 1, 1), (-1, 1, 1), (1, -1, 1), (1, 1, -1)]):
        way = np.array(flips) * span
        places = np.where(way > 0, 0.0, span) + np.linspace(0, 1, 11)[:, None] * way
        u = way / np.linalg.norm(way)
        beam = u + 1e-4 * np.cross(u, [0.6, 0.0, 0.8])
        actual = (places - places[0]) @ ways
        read = actual @ (beam / np.linalg.norm(beam)) - (places - places[0]) @ u
        head = [
            '# instrument = "displacement"',
            f"# direction = [{', '.join(f'{v * 1e3:g}' for v in way)}]",
            '# unknown = ["offset", "beam"]',
            f'# name = "diagonal {n}"',
            "X_mm,Y_mm,Z_mm,reading_um",
        ]
        rows = [
            ",".join(f"{v:.4f}" for v in (*p * 1e3, r * 1e6))
            for p, r in zip(places, read, strict=True)
        ]
        files.append(tmp_path / f"d{n}.csv")
        files[-1].write_text("\n".join([*head, *rows]) + "\n", "utf-8")
    words = ("--terms", "C0Y,B0Z,A0Z,EXX,EYY,EZZ", "--degree", "X=1", "--degree", "Y=1")
    done = call("calibrate", "mill_xyz", *map(str, files), *words, "--degree", "Z=1", "--json")
    found = json.loads(done.out)
    for name, value in {"C0Y": 12.0, "B0Z": -7.0, "A0Z": 9.0}.items():
        assert abs(found["terms"][name]["values"][0] * 1e6 - value) < 0.1
    assert found["terms"]["EXX"]["values"] is None  # scales are never from diagonals
    assert any("EXX order 1" in n for n in found["null"])


@pytest.mark.parametrize("text", ['u_C0Y = "1 urad"', 'C0Y = "1 urad"\nu_C0Y = "1 um"'])
def test_an_uncertainty_without_its_constant_or_of_another_kind_is_refused(call, tmp_path, text):
    (tmp_path / "c.toml").write_text(text + "\n")
    done = call(
        "machine-tables", "mill_xyz", str(tmp_path / "c.toml"), "--over", "X",
        "--span", "X=0 mm..100 mm", "--spacing", "25 mm", "-o", str(tmp_path / "out"),
    )  # fmt: skip
    assert done.code != 0
    assert "C0Y" in done.err


def line_of(file, direction, axis, ends, u):
    """Write nine places of one axis, and no readings."""
    at = ", ".join(f'{a} = "0 mm"' for a in "XYZ" if a != axis)
    head = f'# instrument = "displacement"\n# direction = "{direction}"\n# u = "{u} um"\n'
    head += f'# unknown = ["offset"]\n# at = {{ {at} }}\n# name = "{file.stem}"\n{axis}_mm\n'
    file.write_text(head + "".join(f"{v}\n" for v in np.linspace(*ends, 9)), "utf-8")
    return str(file)


def test_the_set_up_to_read_next(call, tmp_path):
    fine = line_of(tmp_path / "fine.csv", "X", "X", (0, 200), 0.2)
    wide = line_of(tmp_path / "wide.csv", "X", "X", (0, 400), 0.2)
    idle = line_of(tmp_path / "idle.csv", "Y", "X", (0, 400), 0.1)
    words = ["--terms", "EXX", "--degree", "X=1", "--candidate", fine, "--candidate", idle]
    done = call("calibrate", "mill_xyz", *words, "--candidate", wide, "--json")
    assert done.code == 0, done.err
    plan = json.loads(done.out)["plan"]
    assert [p["set"] for p in plan] == ["wide", "fine", "idle"]
    # E_x = 2 c x / L with c of 5 um: the offset takes the mean of each line; 5 places of the travel
    information, box = 1.0 / 5e-6**2, np.mean((2.0 * np.linspace(0.0, 1.0, 5)) ** 2)
    for found, length in zip(plan, (0.4, 0.2, None), strict=True):
        if length is not None:
            shape = 2.0 * np.linspace(0.0, length, 9) / 0.4
            information += np.sum((shape - shape.mean()) ** 2) / 0.2e-6**2
        assert found["u_rms_m"] == pytest.approx(np.sqrt(box / information), rel=1e-9, abs=0.0)
    refused = call("calibrate", "mill_xyz", *words, "-o", str(tmp_path / "out"))
    assert refused.code == 2
    assert "--candidate lists set-ups and finds no terms: take -o out" in refused.err
    assert call("calibrate", "mill_xyz").code == 2
