"""The verb path: a program corrected by a map, and what it refuses in the words of its options."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from itertools import product

import click
import numpy as np
import pytest
from controllers.program_marks import unmarked

import metrosep as ms
from metrosep.cli.errors import report_error
from metrosep.cli.paths import path
from metrosep.core.surface import Surface

PROGRAM = "%\nG21 G90\nG0 X4.0 C0.0 Z1.0\nG1 C90.0 F5\nX-4.0 C180.0 Z.5\nM30\n%\n"
HALF_MM = 0.5e-6 * (1 + 1e-6)
"""Half of the last digit of a nanometre in mm, and binary rounding."""


@pytest.fixture
def call(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "in.nc").write_text(PROGRAM)
    y, x = np.mgrid[-5e-3:5e-3:41j, -5e-3:5e-3:41j]
    ms.write(
        Surface(1e-4 * x + 3e-5 * y, dx=0.25e-3, dy=0.25e-3, origin=(-5e-3, -5e-3)),
        tmp_path / "error.x3p",
    )

    def run(*words):
        told = {}
        names = {p.name for p in path.params}
        try:
            code = path.main([str(w) for w in words], standalone_mode=False, obj=told)
        except click.UsageError as exc:
            return 2, "", exc.format_message()
        except Exception as exc:
            code = report_error(exc, verbosity=0, names=names, words=told.get("words"))
        out = capsys.readouterr()
        assert "internal error" not in out.err
        return code, out.out, out.err

    return run


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_a_pipe_is_refused_at_once(tmp_path):
    """Opening it would wait for a writer that never comes."""
    os.mkfifo(tmp_path / "in.nc")
    (tmp_path / "c.toml").write_text('C0Y = "20 urad"\n')
    words = ["path", "in.nc", "--machine", "mill_xyz", "--error", "c.toml", "-o", "o.nc"]
    done = subprocess.run(
        [sys.executable, "-m", "metrosep", *words],
        cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.returncode == 4
    assert "in.nc: is a device or a pipe; copy the program into a file first" in done.stderr


def z_words(text):
    return [float(w[1:]) for w in text.split() if w.startswith("Z")]


def test_error_of_the_map_is_subtracted(call, tmp_path):
    code, out, err = call(
        "in.nc", "--error", "error.x3p", "-o", "out.nc", "--c-sense", "+1", "--centre", "middle"
    )

    assert code == 0
    assert out == ""
    found = unmarked((tmp_path / "out.nc").read_text())
    # e = 0.4 um at (4, 0); 0.12 um at (0, 4); X -4 at 180 deg is (4, 0) again
    assert z_words(found) == pytest.approx([1 - 4e-4, 1 - 1.2e-4, 0.5 - 4e-4], abs=HALF_MM)
    assert (
        found.replace(" Z0.999880", "").replace("Z0.999600", "Z1.0").replace("Z0.499600", "Z.5")
        == PROGRAM
    )
    assert "3 of 7 blocks changed" in err
    assert "1 word inserted" in err
    assert json.loads((tmp_path / "out.nc.json").read_text())["correction"]["c_sense"] == 1


def test_sense_zero_and_json(call, tmp_path):
    code, out, _ = call(
        "in.nc", "--error", "error.x3p", "-o", "out.nc", "--c-sense", "-1", "--c-zero", "90 deg",
        "--centre", "middle", "--resolution", "0.1 nm", "--json",
    )  # fmt: skip

    assert code == 0
    assert json.loads(out)["n_changed"] == 3
    # C 0 is at 90 deg: (0, 4); C 90 turns back to 0 deg: (4, 0); X -4 at -90 deg: (0, 4)
    found = unmarked((tmp_path / "out.nc").read_text())
    assert z_words(found) == pytest.approx([1 - 1.2e-4, 1 - 4e-4, 0.5 - 1.2e-4], abs=HALF_MM)
    assert "Z0.9998800" in found


def test_the_sense_of_c_is_plus_one_and_said_where_it_is_not_given(call, tmp_path):
    words = ("--error", "error.x3p", "--centre", "middle")

    code, _, err = call("in.nc", *words, "-o", "assumed.nc")
    assert code == 0
    assert "--c-sense is not given, +1 is taken" in err
    code, _, err = call("in.nc", *words, "-o", "stated.nc", "--c-sense", "+1")
    assert "--c-sense is not given" not in err
    assert (tmp_path / "assumed.nc").read_bytes() == (tmp_path / "stated.nc").read_bytes()


def test_a_map_needs_the_right_middle(call, tmp_path):

    code, _, err = call(
        "in.nc",
        "--error",
        "error.x3p",
        "-o",
        "out.nc",
        "--c-sense",
        "+1",
        "--centre",
        "9 mm, 0 mm",
    )
    assert code == 4
    assert "in.nc: line 3" in err
    assert "from -14 to -4 mm in x and -5 to 5 mm in y of the spindle axis" in err
    assert "say --centre middle" in err
    assert "--outside zero" in err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["error.x3p", "in.nc"]


def test_splitting_and_limits(call):
    words = (
        "in.nc",
        "--error",
        "error.x3p",
        "-o",
        "out.nc",
        "--c-sense",
        "+1",
        "--centre",
        "middle",
    )
    code, _, err = call(*words, "--tolerance", "5 nm")
    assert code == 0
    assert "blocks added" in err

    code, _, err = call(*words)
    assert code == 2
    assert "--force" in err

    code, _, err = call(*words, "--force", "--stroke", "100 nm")
    assert code == 1
    assert "--stroke" in err
    assert call(*words, "--force")[0] == 0


def test_a_corrected_program_in_the_way_stays_unless_force_is_said(call, tmp_path):
    words = (
        "in.nc",
        "--error",
        "error.x3p",
        "-o",
        "out.nc",
        "--c-sense",
        "+1",
        "--centre",
        "middle",
    )
    assert call(*words)[0] == 0
    names = ("out.nc", "out.nc.json")
    first = [(tmp_path / n).read_bytes() for n in names]

    assert call(*words)[0] == 0  # the same bytes
    for other in (("--resolution", "10 nm"), ("--c-zero", "90 deg")):
        code, _, err = call(*words, *other)
        assert code == 2
        assert "--force" in err
        assert [(tmp_path / n).read_bytes() for n in names] == first
        assert not list(tmp_path.glob("out.nc.1*"))

    assert call(*words, "--c-zero", "90 deg", "--force")[0] == 0
    assert (tmp_path / "out.nc").read_bytes() != first[0]
    assert [(tmp_path / n).read_bytes() for n in ("out.nc.1", "out.nc.1.json")] == first


@pytest.mark.parametrize(
    ("program", "options", "code", "part"),
    [
        (PROGRAM.replace("G21", ""), (), 4, "--path-unit mm"),
        (PROGRAM.replace("G90", "G91"), (), 4, "line 2: G91"),
        (PROGRAM, ("--column", "X=1"), 2, "--points"),
        (PROGRAM, ("--centre", "3 mm"), 2, "two lengths"),
        (PROGRAM, ("--decimals", "0"), 2, "decimals"),
        (PROGRAM, ("--tolerance", "5"), 2, "--tolerance"),
    ],
)
def test_refusals_speak_of_options(call, tmp_path, program, options, code, part):
    (tmp_path / "in.nc").write_text(program)

    words = (
        "in.nc",
        "--error",
        "error.x3p",
        "-o",
        "out.nc",
        "--c-sense",
        "+1",
        "--centre",
        "middle",
    )
    found, _, err = call(*words, *options)

    assert found == code
    assert part in err
    assert not (tmp_path / "out.nc").exists()


def test_points(call, tmp_path):
    (tmp_path / "in.csv").write_text("t,x_mm,c,z_mm,k\n0,4.0,90,1.0,a\n")

    code, _, err = call(
        "in.csv", "--points", "--error", "error.x3p", "-o", "out.csv", "--c-sense", "+1", "--centre",
        "middle", "--column-unit", "C=deg",
    )  # fmt: skip

    assert code == 0, err
    assert (tmp_path / "out.csv").read_text() == "t,x_mm,c,z_mm,k\n0,4.0,90,0.999880,a\n"


def test_profile_needs_no_sense(call, tmp_path):
    ms.write(ms.Profile([0.0, 2e-3, 5e-3], [0.0, 4e-6, 0.0]), tmp_path / "error.csv")
    (tmp_path / "in.nc").write_text("G21 G90\nG0 X2.0 Z1.0\n")

    code, _, err = call("in.nc", "--error", "error.csv", "-o", "out.nc")

    assert code == 0, err
    assert z_words(unmarked((tmp_path / "out.nc").read_text())) == [0.996]


WORDS = ("--error", "error.x3p", "--centre", "middle")


def test_sense_may_be_written_as_1(call, tmp_path):
    assert call("in.nc", *WORDS, "-o", "a.nc", "--c-sense", "1")[0] == 0
    assert call("in.nc", *WORDS, "-o", "b.nc", "--c-sense", "+1")[0] == 0
    assert (tmp_path / "a.nc").read_bytes() == (tmp_path / "b.nc").read_bytes()


def test_a_line_break_in_the_name_is_refused(call, tmp_path):
    code, _, err = call("in.nc", *WORDS, "-o", "out\n.nc", "--c-sense", "+1")
    assert code == 2
    assert "line break" in err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["error.x3p", "in.nc"]


def test_ways_out_are_options(call, tmp_path):
    words = (*WORDS, "--c-sense", "+1")
    assert call("in.nc", *words, "-o", "out.nc")[0] == 0
    code, _, err = call("out.nc", *words, "-o", "twice.nc")
    assert code == 2
    assert "say --again if" in err
    assert call("out.nc", *words, "-o", "twice.nc", "--again")[0] == 0

    turned = PROGRAM.replace("C180.0", "C300.0")
    (tmp_path / "in.nc").write_text(turned)
    code, _, err = call("in.nc", *words, "-o", "o2.nc", "--tolerance", "1 nm")
    assert code == 4
    assert "--c-linear" in err
    (tmp_path / "in.nc").write_text(turned.replace("M30", "M428\nM30"))
    code, _, err = call("in.nc", *words, "-o", "o2.nc", "--tolerance", "1 nm", "--c-linear")
    assert code == 4
    assert "--harmless-m 428 if" in err
    code, _, err = call(
        "in.nc", *words, "-o", "o2.nc", "--tolerance", "1 nm", "--c-linear", "--harmless-m", "428"
    )
    assert code == 0, err
    code, _, err = call("in.nc", *words, "-o", "o.csv", "--points", "--c-linear")
    assert code == 2
    assert "--points" in err


def test_diameters_of_lists(call, tmp_path):
    (tmp_path / "in.csv").write_text("X_mm,C_deg,Z_mm\n8.0,0,1.0\n")
    code, _, err = call(
        "in.csv", "--points", *WORDS, "-o", "out.csv", "--c-sense", "+1", "--diameter"
    )
    assert code == 0, err
    assert (tmp_path / "out.csv").read_text() == "X_mm,C_deg,Z_mm\n8.0,0,0.999600\n"


SLOW_MAP = """
import sys, os, signal
from metrosep.controllers.gcode import paths as gcode_paths
old = gcode_paths.Rewriter.rewrite
def rewrite(self, lines):
    os.kill(os.getpid(), signal.SIGTERM)
    return old(self, lines)
gcode_paths.Rewriter.rewrite = rewrite
from metrosep.cli.paths import path
path.main(sys.argv[1:])
"""


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_sigterm_leaves_nothing(call, tmp_path):
    words = ("in.nc", *WORDS, "-o", "out.nc", "--c-sense", "+1")
    done = subprocess.run(
        [sys.executable, "-c", SLOW_MAP, *words], check=False, cwd=tmp_path, capture_output=True
    )
    assert done.returncode == 143, done.stderr
    assert sorted(p.name for p in tmp_path.iterdir()) == ["error.x3p", "in.nc"]


RN, RS = 0.5, 30.0
"""mm: radius of the nose, and of the bowl or dome that it cuts."""


def turned(kind, centre):
    """Return contacts (radius, angle), and X and Z of the tip (or centre) of the nose that cuts a sphere there."""
    r = np.arange(5.0, -1e-9, -0.1 / 24)
    c = np.arange(r.size) * 15.0
    side = {"bowl": 1.0, "dome": -1.0}[kind]
    sine, cosine = side * r / RS, np.sqrt(1 - (r / RS) ** 2)  # of the slope
    height = side * (RS - np.sqrt(RS**2 - r**2))
    z = height + RN * cosine - (0.0 if centre else RN)
    return r, c, r - RN * sine, z


def waves(x, y):
    """Return an error in mm that no turn and no mirror brings onto itself."""
    return 1e-3 * (
        np.cos(2 * np.pi * np.hypot(x, y) / 2.5 + 0.4) + 0.05 * x - 0.11 * y + 0.02 * x * y
    )


HALF = {(False, False, "bowl"), (False, True, "dome"), (True, False, "dome"), (True, True, "bowl")}
"""Of the eight combinations: each two of the three choices meet in one of these."""


@pytest.mark.parametrize(
    ("diameter", "centre", "kind"),
    [
        pytest.param(
            *each,
            id="-".join((("radius", "diameter")[each[0]], ("tip", "centre")[each[1]], each[2])),
            marks=() if each in HALF else pytest.mark.slow,
        )
        for each in product((False, True), (False, True), ("bowl", "dome"))
    ],
)
def test_the_error_is_taken_where_the_nose_touches_the_part(
    call, tmp_path, kind, centre, diameter
):
    """A map of a spreadsheet, a spiral of 1200 blocks: what stays on the part is the noise of the map's steps."""
    at = np.linspace(-5.3, 5.3, 213)
    rows = [f"{x:.3f};{y:.3f};{1e3 * waves(x, y):.5f}" for y in at[::-1] for x in at]
    text = "\r\n".join(["# Prüfling Müller", "X [mm];Y [mm];Z [µm]", *rows, ""]).replace(".", ",")
    (tmp_path / "map.csv").write_bytes(text.encode("cp1252"))
    r, c, x, z = turned(kind, centre)
    factor = 2.0 if diameter else 1.0
    lines = [f"X{factor * a:.6f} C{b:.3f} Z{h:.6f}" for a, b, h in zip(x, c, z, strict=True)]
    program = [
        "%",
        "O7",
        "G21 G90 G94",
        f"G0 X{factor * x[0]:.6f} C0.0 Z5.0",
        "G1 F20",
        *lines,
        "M30",
        "%",
    ]
    (tmp_path / "spiral.nc").write_text("\n".join(program) + "\n")
    words = ["spiral.nc", "--error", "map.csv", "--c-sense", "-1", "--c-zero", "20 deg"]
    words += ["--diameter" if diameter else "--radius", "--outside", "hold"]

    def left(*more, out):
        code, _, err = call(*words, *more, "-o", out)
        assert code == 0, err
        cut = [w for w in unmarked((tmp_path / out).read_text()).split("\n") if w.startswith("X")]
        cut = np.array([float(w.split("Z")[1]) for w in cut])
        angle = np.radians(20.0 - c)
        return waves(r * np.cos(angle), r * np.sin(angle)) + cut - z, err

    radius = RS if kind == "bowl" else -RS
    good, err = left("--nose", f"{RN} mm", "--form", f"sphere: R={radius} mm", out="good.nc")
    assert "--nose" not in err
    assert np.ptp(good) < 20e-6, "mm: bilinear between places 0.05 mm apart is 7 nm off each way"
    plain, err = left(out="plain.nc")
    assert "--nose" in err
    assert "--form" in err
    assert np.ptp(plain) > 300e-6
    for r_form, hint in ((-radius, "opposite sign fits"), (1.2 * radius, "another part")):
        form = f"sphere: R={r_form} mm"
        code, _, err = call(*words, "--nose", f"{RN} mm", "--form", form, "-o", "wrong.nc")
        assert code == 2, err
        assert "spiral.nc: half of its blocks stand more than" in err
        assert hint in err
        assert not (tmp_path / "wrong.nc").exists()


@pytest.mark.parametrize("points", [False, True], ids=["program", "list"])
def test_passes_lead_ins_and_a_former_correction_are_no_other_form(call, tmp_path, points):
    """Three passes with an allowance, each led in and out by G1, and 30 um of a correction that was made before."""
    _, c, x, z = turned("dome", centre=False)
    rows, lines = [], ["G21 G90 G94"]
    for allowance in (0.0,) if points else (0.2, 0.05, 0.0):
        lines += [f"G0 X{x[0] + 1:.6f} C0.0", f"Z{z[0] + 2:.6f}", "G1 F20"]
        lines += [f"X{x[0] + 0.5:.6f} Z{z[0] + 1:.6f}"]
        for a, b, h in zip(x[::5], c[::5], z[::5], strict=True):
            rows.append(f"{a:.6f},{b:.3f},{h + 0.03 * np.sin(3 * a):.6f}")
            lines.append(f"X{a:.6f} C{b:.3f} Z{h + allowance + 0.03 * np.sin(3 * a):.6f}")
        lines += [f"X-0.5 Z{z[-1] + 1:.6f}", "Z5.0"]
    text = ["X_mm,C_deg,Z_mm", *rows] if points else [*lines, "M30"]
    (tmp_path / "in.nc").write_text("\n".join(text) + "\n")
    words = ["in.nc", "--error", "error.x3p", "--c-sense", "+1", "--nose", f"{RN} mm"]
    words += ["--points"] if points else ["--radius", "--outside", "hold"]
    right, wrong = (["--form", f"sphere: R={s * RS} mm"] for s in (-1, 1))
    code, _, err = call(*words, *right, "-o", "out.nc")
    assert code == 2, "a path with 30 um in it bears no mark"
    assert "another part" in err
    code, _, err = call(*words, *right, "--again", "-o", "out.nc")
    assert code == 0, err
    code, _, err = call(*words, *wrong, "--again", "-o", "wrong.nc")
    assert code == 2
    assert "opposite sign fits" in err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--nose", "0.5 mm"], "--form"),
        (["--form", "sphere: R=30 mm"], "--nose"),
        (["--nose", "-0.5 mm", "--form", "sphere: R=30 mm"], "nose"),
        (["--nose", "0.5", "--form", "sphere: R=30 mm"], "no unit"),
        (["--nose", "0.5 mm", "--form", "sphere"], "no value for R"),
        (["--nose", "12 mm", "--form", "sphere: R=10 mm"], "does not fit"),
    ],
)
def test_a_nose_that_cannot_be_is_refused(call, tmp_path, words, said):
    code, out, err = call(
        "in.nc", "--error", "error.x3p", "-o", "out.nc", "--c-sense", "+1", *words
    )
    assert code in (2, 4)
    assert said in err + out
    assert not (tmp_path / "out.nc").exists()


def test_a_program_in_diameters_beyond_the_map_is_told_of_its_option(call, tmp_path):
    (tmp_path / "lathe.nc").write_text("G21 G90\nG0 X8.0 C0.0 Z1.0\nG1 C90.0 F5\nM30\n")
    words = (
        "lathe.nc",
        "--error",
        "error.x3p",
        "-o",
        "out.nc",
        "--c-sense",
        "+1",
        "--nose",
        "0 mm",
    )
    code, _, err = call(*words)
    assert code == 4
    assert "if they are diameters, say --diameter" in err
    code, _, err = call(*words, "--diameter")
    assert code == 0, err
    code, _, err = call(*words, "--radius", "--force")
    assert code == 4
    assert "diameter" not in err


def test_a_way_out_beyond_the_form_keeps_the_value_at_the_edge(call, tmp_path):
    """A sphere of 10 mm has no slope at X = 80; where no map was measured the nose touches nothing."""
    (tmp_path / "far.nc").write_text(
        "G21 G90\nG0 X80.0 C0.0 Z9.0\nX1.0\nG1 Z1.0 F5\nC90.0\nG0 Z9.0\nX80.0\nM30\n"
    )
    words = ("far.nc", "--error", "error.x3p", "--c-sense", "+1", "--radius", "--outside", "hold")
    code, _, err = call(*words, "--nose", "0.5 mm", "--form", "sphere: R=10 mm", "-o", "nose.nc")
    assert code == 0, err
    code, _, err = call(*words, "--nose", "0 mm", "-o", "points.nc")
    assert code == 0, err
    last = [unmarked((tmp_path / n).read_text()).split("\n")[-3] for n in ("nose.nc", "points.nc")]
    assert last[0] == last[1]
    assert last[0].startswith("X80.0 Z")
