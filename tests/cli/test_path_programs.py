"""``path`` on programs of lathes, and on programs that were corrected and given another name.

What the machine does comes from a small interpreter written here after the operator's manual of
system A: G90, G92 and G94 are cycles, and they stay in force until a code of their group.
"""

import math
import re
import shutil

import numpy as np
import pytest

import metrosep as ms
from metrosep.cli.main import main


@pytest.fixture
def call(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    x = np.linspace(0.0, 40e-3, 81)
    error = ms.Profile(x, 0.7e-6 * np.sin(x / 6e-3) + 0.2e-6)
    ms.write(error, tmp_path / "error.csv")

    def run(*words):
        with pytest.raises(SystemExit) as stop:
            main(["path", *map(str, words), "--error", "error.csv"])
        return stop.value.code, capsys.readouterr().err

    return run


def traced(text, *, system_a):
    """Every point (X, Z) that the tool is sent to, with the cycles of system A as cycles."""
    at, mode, points = {"X": math.nan, "Z": math.nan}, None, []
    for line in text.upper().splitlines():
        words = re.findall(r"([A-Z])([-+]?[\d.]+)", re.sub(r"\(.*?\)|;.*", "", line))
        for letter, value in words:
            if letter == "G" and int(float(value)) in (0, 1, *((90, 92, 94) if system_a else ())):
                mode = int(float(value))
        new = {k: float(v) for k, v in words if k in at}
        if not new:
            continue
        end = {**at, **new}
        if mode in (90, 92):  # in along X, cut along Z, out, back to where it began
            points += [(end["X"], at["Z"]), (end["X"], end["Z"]), (at["X"], end["Z"])]
            points += [(at["X"], at["Z"])]
        elif mode == 94:  # in along Z, face along X, out, back
            points += [(at["X"], end["Z"]), (end["X"], end["Z"]), (end["X"], at["Z"])]
            points += [(at["X"], at["Z"])]
        else:
            at = end
            points.append((at["X"], at["Z"]))
    return points


HEAD = "%\nO0042 (SHAFT)\nG21\nG8\nG0 X34.0 Z2.0\n"
CYCLES = [
    pytest.param("G90 X30.0 Z-21.5 F0.1\nX27.5\nX25.0\n", id="turning"),
    pytest.param("G94 X8.0 Z-0.5 F0.08\nZ-1.0\n", id="facing"),
    pytest.param("G92 X24.6 Z-12.0 F1.5\nX24.2\n", id="threading"),
]
TAIL = "G0 X34.0 Z5.0\nM30\n%\n"


@pytest.mark.parametrize("cycle", CYCLES)
def test_a_turning_cycle_is_not_corrected_as_a_move(call, tmp_path, cycle):
    program = HEAD + cycle + TAIL
    assert traced(program, system_a=True) != traced(program, system_a=False)
    (tmp_path / "shaft.nc").write_text(program)

    for more in ((), ("--g-system", "A")):
        code, err = call("shaft.nc", "-o", "out.nc", *more)

        assert code == 4
        assert "line 6: G9" in err
        assert "cycle" in err
        assert "system A" in err
        assert not (tmp_path / "out.nc").exists()


def test_a_cycle_in_front_of_which_nothing_is_said_is_refused_in_system_a(call, tmp_path):
    (tmp_path / "shaft.nc").write_text(HEAD + "G90\nX30.0 Z-21.5\n" + TAIL)

    code, err = call("shaft.nc", "-o", "out.nc", "--g-system", "A")

    assert code == 4
    assert "G90" in err


@pytest.mark.parametrize("code", ["G77", "G78", "G79"])
@pytest.mark.parametrize("more", [(), ("--g-system", "B"), ("--g-system", "mill")])
def test_cycles_of_system_b_are_refused(call, tmp_path, code, more):
    (tmp_path / "shaft.nc").write_text(HEAD + f"{code} X30.0 Z-21.5 F0.1\n" + TAIL)

    number, err = call("shaft.nc", "-o", "out.nc", *more)

    assert number == 4
    assert code in err


@pytest.mark.parametrize("code", ["G20", "G21", "G24"])
def test_cycles_of_system_c_are_refused(call, tmp_path, code):
    (tmp_path / "shaft.nc").write_text(HEAD + f"{code} X30.0 Z-21.5 F0.1\n" + TAIL)
    number, err = call("shaft.nc", "-o", "out.nc")
    assert number == 4
    assert code in err

    number, err = call("shaft.nc", "-o", "out.nc", "--g-system", "C")
    assert number in (2, 4)
    assert "G70 and G71" in err


@pytest.mark.parametrize("system", ["B", "mill"])
def test_absolute_moves_of_mills_and_system_b_are_corrected(call, tmp_path, system):
    program = "G21 G90\nG8\nG0 X4.0 Z2.0\nG1 X8.0 Z-1.0 F10\nG90 X12.0 Z-1.5\nG94 X20.0\nM30\n"
    (tmp_path / "a.nc").write_text(program)
    code, err = call("a.nc", "-o", "out.nc")
    assert code == 4
    assert "--g-system mill" in err

    code, err = call("a.nc", "-o", "out.nc", "--g-system", system)

    assert code == 0, err
    before = np.array(traced(program, system_a=False))
    after = np.array(traced((tmp_path / "out.nc").read_text(), system_a=False))
    # the profile is linear between samples 0.5 mm apart: 0.7 um (0.5 / 6)^2 / 8 below 1 nm
    added = -(0.7e-3 * np.sin(before[:, 0] / 6.0) + 0.2e-3)
    assert np.abs(after[:, 1] - before[:, 1] - added).max() < 1.2e-6
    assert (after[:, 0] == before[:, 0]).all()


def test_plain_g90_and_g94_stay_what_they_are(call, tmp_path):
    (tmp_path / "a.nc").write_text("G21 G90 G94\nG8\nG0 X4.0 Z2.0\nG1 X8.0 Z-1.0 F10\nM30\n")
    assert call("a.nc", "-o", "out.nc")[0] == 0


PROGRAMS = {
    "fanuc": "%\nO1234 (LENS 3)\nG21 G90\nG8\nG0 X4.0 Z2.0\nG1 X8.0 Z-1.0 F10\nM30\n%\n",
    "windows": "%\r\nO1234\r\nG21 G90\r\nG8\r\nG0 X4.0 Z2.0\r\nG1 X8.0 Z-1.0 F10\r\nM30\r\n%\r\n",
    "bare": "G21 G90\nG8\nG0 X4.0 Z2.0\nG1 X8.0 Z-1.0 F10\nM30\n",
    "semicolons": "; lens 3\nG21 G90\nG8\nG0 X4.0 Z2.0 ; above\nG1 X8.0 Z-1.0 F10\nM30\n",
}


@pytest.mark.parametrize("kind", PROGRAMS)
def test_a_corrected_program_under_another_name_is_not_corrected_twice(call, tmp_path, kind):
    (tmp_path / "a.nc").write_bytes(PROGRAMS[kind].encode())
    assert call("a.nc", "-o", "b.nc")[0] == 0
    made = (tmp_path / "b.nc").read_bytes().decode()
    line = next(v for v in made.splitlines() if "METROSEP" in v)
    shape = r"; ?METROSEP CORRECTED Z [0-9a-f]{12}"
    if kind != "semicolons":
        shape = r"\(METROSEP CORRECTED Z [0-9a-f]{12}\)"
    assert re.fullmatch(shape, line)
    number_of_program = kind in ("fanuc", "windows")
    assert made.splitlines()[2 if number_of_program else 0] == line
    assert ("\r\n" in made) == (kind == "windows")
    assert made.count("\r\n") in (0, made.count("\n"))
    elsewhere = tmp_path / "other"
    elsewhere.mkdir()
    shutil.copy(tmp_path / "b.nc", elsewhere / "renamed.tap")

    renumbered = made.replace("G0 X4.0", "N10 G0 X4.0").upper()
    (elsewhere / "edited.nc").write_bytes(renumbered.encode())
    for name in ("renamed.tap", "edited.nc"):
        code, err = call(elsewhere / name, "-o", "twice.nc")
        assert code == 2, err
        assert "holds a correction already" in err
        assert "--again" in err
        assert not (tmp_path / "twice.nc").exists()

    code, err = call(elsewhere / "renamed.tap", "-o", "twice.nc", "--again")
    assert code == 0, err
    assert (tmp_path / "twice.nc").read_text().count("METROSEP CORRECTED") == 2


def test_a_renamed_list_is_not_corrected_twice(call, tmp_path):
    (tmp_path / "plain.csv").write_text("X_mm,Z_mm\n4,1\n8,1\n")
    (tmp_path / "said.csv").write_text("# servo table 7\nX_mm,Z_mm\n4,1\n8,1\n")
    for name in ("plain", "said"):
        code, err = call(f"{name}.csv", "-o", f"{name}-b.csv", "--points")
        assert code == 0, err
        assert ("no mark" in err) == (name == "plain")
        (tmp_path / f"{name}-b.csv").rename(tmp_path / f"{name}-c.csv")

        code, err = call(f"{name}-c.csv", "-o", f"{name}-d.csv", "--points")

        assert code == 2
        assert "holds a correction already" in err
    (tmp_path / "away").mkdir()
    shutil.copy(tmp_path / "said-c.csv", tmp_path / "away" / "said.csv")
    assert call(tmp_path / "away" / "said.csv", "-o", "e.csv", "--points")[0] == 2
