"""Machines, their curves and their controllers as strangers type them: spreadsheets, code pages, slips."""

import numpy as np
import pytest

LATHE = """\
name = "Drehmaschine Müller"
[[element]]
name = "Z"
branch = "tool"
kind = "linear"
direction = "+Z"
[[element]]
name = "X"
branch = "workpiece"
kind = "linear"
direction = "-X"
errors_of = "tool"
[[element]]
name = "C"
branch = "workpiece"
kind = "rotary"
direction = "+Z"
"""
PART = ("--form", "plane", "--radius", "10 mm")


@pytest.fixture
def lathe(tmp_path):
    (tmp_path / "lathe.toml").write_text(LATHE, encoding="utf-8-sig")
    return tmp_path / "lathe.toml"


def test_a_curve_of_a_spreadsheet_is_ranked_by_the_map_that_it_cuts(lathe, tmp_path, metrosep):
    """A facing cut: the height at radius r is the error of Z over X, so Sq is an integral over the disc."""
    x = np.linspace(0.0, 12.0, 25)
    e = 0.3 * np.sin(2 * np.pi * x / 7.0 + 0.4) + 0.02 * x**2  # um
    rows = [f"{a:.2f};{b:.5f}".replace(".", ",") for a, b in zip(x, e, strict=True)]
    text = "\r\n".join(["# Gerät: Müller", "X [mm];EZX [µm]", *rows[::-1], ""])
    (tmp_path / "ezx.csv").write_bytes(text.encode("cp1252"))
    code, out, err = metrosep(
        "rank",
        lathe,
        *PART,
        "--error",
        f"EZX=table {tmp_path / 'ezx.csv'}",
        "-o",
        tmp_path / "out",
    )
    assert code == 0, err
    (line,) = (row for row in out.splitlines() if row.startswith("EZX "))
    r = np.linspace(0.0, 10.0, 20001)
    z, w = np.interp(r, x, e), r / r.sum()
    wanted = np.sqrt(w @ (z - w @ z) ** 2)
    found = float(line.split()[5]) * {"nm": 1e-3, "um": 1.0}[line.split()[6]]
    assert found == pytest.approx(
        wanted, abs=2e-3
    )  # three digits are printed, on a grid of its own


def test_words_of_a_file_stay_words(lathe, tmp_path, metrosep):
    lathe.write_text(LATHE.replace('"tool"', '"tol"', 1), encoding="utf-8")
    code, _, err = metrosep("rank", lathe, *PART, "--error", "EXX=1 um")
    assert code == 2
    assert "is one of tool, workpiece" in err
    code, _, err = metrosep(
        "rank", "fts_lathe", *PART, "--tool", "1 mm,2 mm", "--error", "EXX=1 um"
    )
    assert "--tool is three lengths" in err


@pytest.mark.parametrize("command", ["rank", "run", "check"])
def test_toml_in_a_code_page_is_named_with_its_line(tmp_path, metrosep, command):
    file = tmp_path / "own.toml"
    file.write_bytes(("# eine Zeile\n" + LATHE).encode("cp1252"))
    more = {"rank": (*PART, "--error", "EXX=1 um"), "run": ("-o", tmp_path / "out"), "check": ()}
    code, out, err = metrosep(command, file, *more[command])
    assert code in (2, 4)
    assert "line 2 is not UTF-8; save the file in the encoding UTF-8" in out + err
    assert "codec" not in out + err


def test_the_remarks_of_a_set_up_are_read_in_their_code_page(tmp_path):
    from metrosep.io.reading_sets import read_reading_set
    from metrosep.machine import presets

    text = '# instrument = "displacement"\n# direction = "X"\n# name = "Kugel Müller"\nX_mm;Y_mm;Z_mm;reading_um\n'
    text += "".join(f"{x};0;0;{x / 100}\n".replace(".", ",") for x in (0, 50, 100, 150))
    (tmp_path / "set.txt").write_bytes(text.encode("cp1252"))
    assert read_reading_set(tmp_path / "set.txt", presets("mill_xyz")).name == "Kugel Müller"


def test_a_row_that_lacks_a_field_has_no_way_out_that_the_command_refuses(
    lathe, tmp_path, metrosep
):
    rows = [f"{x},{x},{x}\n" for x in range(6)]
    rows[2] = "2,1\n"
    (tmp_path / "x.csv").write_text("x_mm,EXX_um,EYX_um\n" + "".join(rows))
    code, _, err = metrosep("rank", lathe, *PART, "--error", f"EXX=table {tmp_path / 'x.csv'}")
    assert code == 4
    assert "line 4" in err
    assert err.strip().endswith("copy the file again, or take that line out")


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ((), 'unit of output of the control, as in --machine "output_unit=100 nm"'),
        (("--machine", "output_uni=1 um"), 'Did you mean "output_unit"?'),
        (
            ("--machine", "output_unit=1"),
            "error: mitsubishi: output_unit '1' has no unit; write it",
        ),
    ],
)
def test_facts_of_a_control_are_asked_for_with_an_example(tmp_path, metrosep, given, said):
    rows = [
        f"{x};{way};{x / 50 + (0 if way == '+' else 4)};{x / 49}"
        for way in "+-"
        for x in range(0, 301, 50)
    ]
    (tmp_path / "l.csv").write_text("target_mm;direction;e1_um;e2_um\n" + "\n".join(rows) + "\n")
    code, _, err = metrosep(
        "table", tmp_path / "l.csv", "--target", "target_mm", "--direction", "direction", "--readings",
        "e1_um,e2_um", "--axis", "X", "--deviation", "reached-minus-target", "--format", "mitsubishi", *given,
        "-o", tmp_path / "x.txt",
    )  # fmt: skip
    assert code == 2
    assert said in err
