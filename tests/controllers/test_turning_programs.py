"""Program files of turned freeforms: what the machine does, asked of the bytes without our reader."""

import json
import math
import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from metrosep.controllers.gcode import turning
from metrosep.controllers.gcode.lathe import LatheAxes, rounding_error
from metrosep.controllers.gcode.turning import check_program, write_program
from metrosep.controllers.gcode.turning_reader import read_program
from metrosep.core.errors import (
    CorruptFileError,
    DataError,
    LimitError,
    ReadError,
    TableError,
    WriteError,
)
from metrosep.forms import Expression, Toric
from metrosep.process import RoundNose, TurningJob, TurningProgram, tip_path, virtual_cut

NM, UM = 1e-9, 1e-6
R = 0.6e-3
TORUS = Toric(Rb=110e-3, Rd=70e-3)
SKEW = Expression("0.4*x**2-0.25*y**2+0.15*x*y+2e-4*x+3e-7*sin(2*pi*y/9e-4)")
NGC = LatheAxes("workpiece ccw", inverse_time="1/min")
RAKED = RoundNose(R, math.radians(-30))


def job(form=SKEW, nose=None, sense="clockwise", radius=1.2e-3, core=1.1e-3, rpm=60.0):
    return TurningJob(
        form, radius, 10e-6, rpm=rpm, core=core, sense=sense, nose=nose or RoundNose(R)
    )


@cache
def made(per_turn=120, interpolation="linear", **words):
    own = job(**words)
    return own.program(own.path(step=2 * np.pi / per_turn, interpolation=interpolation))


def blocks(path):
    """X, C, Z, F of each block as a machine reads them: plain splitting, no library code."""
    rows = []
    for line in path.read_text().splitlines():
        words = dict(re.findall(r"([XCZF])([-+.0-9e]+)", re.sub(r"\(.*?\)", "", line)))
        if "X" in words:
            rows.append([float(words[k]) for k in "XCZF"])
    return np.array(rows).T


@pytest.mark.parametrize("side", ["+X", "-X"])
@pytest.mark.parametrize("c_positive", ["workpiece ccw", "tool ccw"])
@pytest.mark.parametrize("sense", ["clockwise", "counterclockwise"])
@pytest.mark.parametrize("zero", [0.0, 0.3])
def test_the_part_turns_under_the_tool_as_the_machine_does_it(
    tmp_path, side, c_positive, sense, zero
):
    """The place of the part under the tool: turn the part by C, or the tool by C about the part."""
    axes = LatheAxes(c_positive, side, zero, inverse_time="s")
    program = made(sense=sense)
    write_program(program, tmp_path / "part.nc", axes, nose=RoundNose(R), form=SKEW)
    X, C, Z, _ = blocks(tmp_path / "part.nc")
    assert (X > 0).all() == (side == "+X")
    tool = X * 1e-3 + 0j  # where the tool stands in the room; its X is negative on the other side
    c = np.radians(C)
    if (
        c_positive == "workpiece ccw"
    ):  # a mark on the part at the angle a stands at a + c in the room
        under = tool * np.exp(-1j * c)
    else:
        under = tool * np.exp(1j * c)
    under *= np.exp(1j * zero)
    wanted = program.X * np.exp(1j * program.azimuth)
    assert np.abs(under - wanted).max() < 1 * NM
    assert pytest.approx(program.Z, abs=0.05 * NM + 1e-15) == Z * 1e-3
    back = read_program(tmp_path / "part.nc", axes)
    assert back.sense == sense
    head = (tmp_path / "part.nc").read_text()
    rises = C[-1] > C[0]
    assert f"{sense} seen from +Z, C {'rises' if rises else 'falls'}" in head
    assert rises == ((sense == "counterclockwise") == (c_positive == "tool ccw"))


@pytest.mark.parametrize(
    ("unit", "words"), [("1/min", 7200.0), ("s", 0.00833333333), ("1/s", 120.0)]
)
def test_inverse_time_is_three_things(tmp_path, unit, words):
    """specs/cutting-path.md, section 9: a block of 8.3333 ms."""
    axes = LatheAxes("workpiece ccw", inverse_time=unit)
    program = made()
    write_program(program, tmp_path / "part.nc", axes, nose=RoundNose(R), form=SKEW)
    F = blocks(tmp_path / "part.nc")[3]
    assert F[1:] == pytest.approx(words, rel=1e-8, abs=0.0)
    lines = (tmp_path / "part.nc").read_text().splitlines()
    assert "G93 G61" in lines
    assert all("F" in line for line in lines if line.startswith("X"))
    assert read_program(tmp_path / "part.nc", axes).rpm == pytest.approx(60.0, abs=1e-5)
    with pytest.raises(DataError, match="G93 is three different things"):
        write_program(
            program, tmp_path / "other.nc", LatheAxes("tool ccw"), nose=RoundNose(R), form=SKEW
        )


def test_g94_counts_along_x_and_z_only(tmp_path):
    """specs/cutting-path.md, section 9: torus at X 2.5 mm, 10 um feed, 120 blocks: 0.672 to 6.229 mm/min."""
    own = job(TORUS, radius=2.505e-3, core=2.495e-3)
    program = own.program(own.path(step=2 * np.pi / 120, interpolation="linear"))
    axes = LatheAxes("workpiece ccw", feed="G94")
    write_program(program, tmp_path / "part.nc", axes, nose=RoundNose(R), form=TORUS, verify=False)
    F = blocks(tmp_path / "part.nc")[3][1:]
    # one turn around 2.5 mm; the turn is not exactly at it
    assert (F.min(), F.max()) == pytest.approx((0.672, 6.229), rel=0.02, abs=0.0)
    degrees = LatheAxes("workpiece ccw", feed="G94 deg")
    write_program(
        program, tmp_path / "deg.nc", degrees, nose=RoundNose(R), form=TORUS, verify=False
    )
    assert blocks(tmp_path / "deg.nc")[3][1:] == pytest.approx(360 * 60, rel=1e-8, abs=0.0)
    for name, way, close in (("part.nc", axes, 0.02), ("deg.nc", degrees, 1e-6)):
        assert read_program(tmp_path / name, way).rpm == pytest.approx(60.0, rel=close, abs=0.0)


def test_a_tolerance_that_nothing_would_hold_is_refused(tmp_path):
    words = {"nose": RoundNose(R), "form": SKEW}
    with pytest.raises(DataError, match="none is cut with verify=False or of cut points"):
        write_program(made(), tmp_path / "p.nc", NGC, tolerance=1e-9, verify=False, **words)
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_lost_its_last_turns_is_not_kept(tmp_path, monkeypatch):
    """The part is cut where the file cuts: what it leaves out is seen by its number of points."""
    all_rows = turning._in_rows
    monkeypatch.setattr(turning, "_in_rows", lambda *c: all_rows(*(v[: -v.size // 3] for v in c)))
    with pytest.raises(TableError, match=r"of \d+ points read back"):
        write_program(made(), tmp_path / "p.nc", NGC, nose=RoundNose(R), form=SKEW)
    assert list(tmp_path.iterdir()) == []


@cache
def spiral(sense="clockwise", per_turn=127):
    T = 2 * np.pi * np.arange(-10 * per_turn, 140 * per_turn) / per_turn
    X, azimuth = 3e-3 - 10e-6 * T / (2 * np.pi), -T if sense == "clockwise" else T
    Z = tip_path(TORUS, X, azimuth, nose=RAKED, sense=sense).z
    return TurningProgram(X, azimuth, Z, (T - T[0]) / (2 * np.pi), "tip")


def test_a_file_read_back_cuts_what_the_program_does_and_lines_do_not(tmp_path):
    """specs/cutting-path.md, section 9: torus, -30 clockwise, rho 1.7 to 2.8 mm, 127 points a turn."""
    program, axes = (
        spiral(),
        LatheAxes("workpiece ccw", inverse_time="1/min", spline_word="CSPLINE"),
    )
    written = write_program(program, tmp_path / "part.mpf", axes, nose=RAKED, form=TORUS)
    assert written.check.difference < written.check.rounding
    text = (tmp_path / "part.mpf").read_text()
    back = read_program(tmp_path / "part.mpf", axes)
    (tmp_path / "lines.nc").write_text(text.replace("CSPLINE BAUTO EAUTO\n", ""))
    lines = read_program(tmp_path / "lines.nc", axes)
    assert (back.interpolation, lines.interpolation) == ("spline", "linear")
    rng = np.random.default_rng(5)
    rho, theta = np.sqrt(rng.uniform(1.7e-3**2, 2.8e-3**2, 30000)), rng.uniform(-3.1, 3.1, 30000)
    at = rho * np.cos(theta), rho * np.sin(theta)
    found = {
        name: virtual_cut(p, RAKED, *at, form=TORUS).error / NM
        for name, p in (("planned", program), ("spline", back), ("lines", lines))
    }
    for name, low, high in (("planned", -0.003, 18.261), ("spline", -0.066, 18.309)):
        assert found[name].min() == pytest.approx(low, abs=0.02)
        assert found[name].max() == pytest.approx(high, abs=0.06)
    # lines: the second harmonic of the tip path, 46.018 um at 5.9 mm (table 6.2), is cut short in the
    # middle of blocks by A (1 - cos w/2), down to -12.4 nm at the rim
    shrunk = 46.018e3 * (2.772 / 5.9) ** 2 * (1 - math.cos(2 * math.pi / 127))
    assert found["lines"].min() == pytest.approx(-shrunk, abs=0.4)
    assert found["lines"].max() == pytest.approx(
        18.3 + shrunk, abs=1.7
    )  # with a cusp, rarely both
    change = found["spline"] - found["planned"]
    assert np.abs(change).max() == pytest.approx(0.071, abs=0.012)
    assert math.sqrt(np.mean(change**2)) == pytest.approx(0.028, abs=0.002)


@pytest.mark.parametrize(
    ("digits", "largest", "rms"),
    [
        ((6, 4, 7), 0.076, 0.028),
        ((6, 3, 7), 0.196, 0.055),
        ((6, 2, 7), 1.81, 0.43),
        ((5, 4, 6), 0.740, 0.281),
    ],
)
def test_what_digits_cost(tmp_path, digits, largest, rms):
    """specs/cutting-path.md, section 9; the bound holds, and is no more than 3.5 times what is seen."""
    x, c, z = digits
    axes = LatheAxes("tool ccw", x_decimals=x, c_decimals=c, z_decimals=z)
    program = spiral()
    write_program(
        program, tmp_path / "p.csv", axes, nose=RAKED, form=TORUS, kind="points", verify=False
    )
    rng = np.random.default_rng(6)
    rho, theta = np.sqrt(rng.uniform(1.7e-3**2, 2.8e-3**2, 3000)), rng.uniform(-3.1, 3.1, 3000)
    at = rho * np.cos(theta), rho * np.sin(theta)
    one, other = (
        virtual_cut(p, RAKED, *at).z / NM
        for p in (program, read_program(tmp_path / "p.csv", axes))
    )
    assert math.sqrt(np.mean((one - other) ** 2)) == pytest.approx(rms, rel=0.08, abs=0.0)
    assert np.abs(one - other).max() == pytest.approx(largest, rel=0.25, abs=0.0)
    bound = rounding_error(axes, TORUS, 2.8e-3) / NM
    assert np.abs(one - other).max() < bound < 3.5 * largest


def test_pvt_blocks_are_whole_milliseconds_or_refused(tmp_path):
    """A PMAC rounds the time of a block: 8.3333 ms becomes 8, 4 % fast."""
    pvt = made(interpolation="pvt")
    words = {"nose": RoundNose(R), "form": SKEW, "kind": "pmac"}
    with pytest.raises(
        LimitError, match=r"lasts 8\.3333\d* ms, which is not a whole number of 1 ms.* by 4 %"
    ):
        write_program(pvt, tmp_path / "p.pmc", NGC, velocity_time=1.0, **words)
    with pytest.raises(DataError, match="per Ix90: give velocity_time"):
        write_program(pvt, tmp_path / "p.pmc", NGC, **words)
    whole = made(per_turn=125, interpolation="pvt")
    axes = LatheAxes("workpiece ccw", "-X", 0.2, x_words="diameter", inverse_time="s")
    for per in (1.0, 60.0):
        target = tmp_path / f"p{per:.0f}.pmc"
        written = write_program(whole, target, axes, velocity_time=per, **words)
        assert written.check.interpolation == "pvt"
        assert "PVT8\n" in target.read_text()
        rows = [
            re.split("[ :]", line)
            for line in target.read_text().splitlines()
            if line.startswith("X")
        ]
        vz = np.array([float(r[5]) for r in rows])
        # the velocity is that of the course: differences of the written positions agree to some percent
        z = np.array([float(r[4][1:]) for r in rows])
        rough = (z[2:] - z[:-2]) / 16e-3 * per
        assert np.abs(vz[1:-1] - rough).max() < 0.05 * np.abs(vz).max()
        back = read_program(target, axes, velocity_time=per)
        assert back.velocities == pytest.approx(whole.velocities, rel=1e-5, abs=1e-9)
    with pytest.raises(DataError, match="G-code has no velocities"):
        write_program(whole, tmp_path / "p.nc", NGC, nose=RoundNose(R), form=SKEW)


@pytest.mark.parametrize("interpolation", ["linear", "spline", "pvt"])
def test_lists_of_points_keep_what_joins_them(tmp_path, interpolation):
    axes = LatheAxes(
        "tool ccw", x_words="diameter", unit="inch", c_wraps=True, x_decimals=8, z_decimals=9
    )
    program = made(interpolation=interpolation)
    written = write_program(
        program, tmp_path / "p.csv", axes, nose=RoundNose(R), form=SKEW, kind="points"
    )
    assert written.check.interpolation == interpolation
    assert written.check.difference < 0.1 * NM
    c = [
        float(line.split(",")[3 if interpolation == "pvt" else 2])
        for line in (tmp_path / "p.csv").read_text().splitlines()
        if line[0] in "0123456789"
    ]
    assert 0.0 <= min(c) <= max(c) < 360.0
    if interpolation == "linear":
        text = (tmp_path / "p.csv").read_text().replace("# interpolation linear\n", "")
        (tmp_path / "silent.csv").write_text(text)
        with pytest.raises(DataError, match="does not say how the control joins them"):
            read_program(tmp_path / "silent.csv", axes)
        assert (
            read_program(tmp_path / "silent.csv", axes, interpolation="spline").interpolation
            == "spline"
        )


def test_a_spline_is_not_written_as_lines(tmp_path):
    words = {"nose": RoundNose(R), "form": SKEW}
    with pytest.raises(DataError, match="planned for a spline, and G1 is a line"):
        write_program(made(interpolation="spline"), tmp_path / "p.nc", NGC, **words)
    own = LatheAxes("workpiece ccw", inverse_time="1/min", spline_word="CSPLINE")
    with pytest.raises(DataError, match="CSPLINE would join its points by a spline"):
        write_program(made(), tmp_path / "p.nc", own, **words)
    assert not list(tmp_path.iterdir())


def test_a_file_that_misses_its_tolerance_is_not_written(tmp_path):
    with pytest.raises(
        LimitError, match="P-V without cusps, the tolerance is 1 nm; nothing was written"
    ):
        write_program(
            made(40), tmp_path / "p.nc", NGC, nose=RoundNose(R), form=SKEW, tolerance=1 * NM
        )
    coarse = LatheAxes("workpiece ccw", inverse_time="1/min", z_decimals=3)
    words = {"nose": RoundNose(R), "form": SKEW}
    wide = made(core=0.9e-3)
    with pytest.raises(
        LimitError, match=r"its digits explain 625 nm .*; nothing was written: write more"
    ):
        write_program(wide, tmp_path / "r.nc", coarse, **words)
    assert list(tmp_path.iterdir()) == []
    rough = write_program(wide, tmp_path / "r.nc", coarse, tolerance=3 * UM, **words)
    assert rough.check.difference > 100 * NM  # a last digit of 1 um, said by the tolerance
    assert rough.check.rounding > rough.check.difference
    said = json.loads((tmp_path / "r.nc.json").read_text())["virtual_part"]
    assert said["digits_may_cost_nm"] > said["file_against_program_nm"] > 100


@pytest.mark.parametrize(
    ("hole", "said"),
    [("file", "cuts nothing at 3 of 20800 places"), ("program", "that the program leaves uncut")],
)
def test_places_that_the_file_does_not_cut_are_no_pass(tmp_path, monkeypatch, hole, said):
    """A NaN compares false with everything: it must not look like a part that is right."""
    planned = made()
    real = turning.virtual_cut

    def holed(program, *args, **words):
        part = real(program, *args, **words)
        if (program is planned) == (hole == "program"):
            z, error = part.z.copy(), part.error.copy()
            z[:3], error[:3] = np.nan, np.nan
            part = replace(part, z=z, error=error)
        return part

    monkeypatch.setattr(turning, "virtual_cut", holed)
    with pytest.raises(LimitError, match=said):
        write_program(planned, tmp_path / "h.nc", NGC, nose=RoundNose(R), form=SKEW)
    assert list(tmp_path.iterdir()) == []


def test_files_are_whole_and_not_overwritten_unasked(tmp_path):
    words = {"nose": RoundNose(R), "form": SKEW}
    program = made()
    write_program(program, tmp_path / "p.nc", NGC, **words)
    before = (tmp_path / "p.nc").read_bytes()
    write_program(program, tmp_path / "p.nc", NGC, **words)  # the same bytes stay
    other = LatheAxes("tool ccw", inverse_time="1/min")
    with pytest.raises(WriteError, match="exists already"):
        write_program(program, tmp_path / "p.nc", other, **words)
    assert (tmp_path / "p.nc").read_bytes() == before
    write_program(program, tmp_path / "p.nc", other, overwrite=True, **words)
    assert (tmp_path / "p.nc.1").read_bytes() == before


def test_cut_points_are_written_on_demand_only_and_marked(tmp_path):
    bare = TurningJob(SKEW, 1.2e-3, 10e-6, rpm=60, core=0.9e-3)
    program = bare.program(bare.path(step=0.05, interpolation="linear"), cut_points=True)
    words = {"nose": RoundNose(R), "form": SKEW}
    with pytest.raises(DataError, match="program of cut points"):
        write_program(program, tmp_path / "p.nc", NGC, **words)
    with pytest.raises(DataError, match="none is cut with verify=False or of cut points"):
        write_program(program, tmp_path / "p.nc", NGC, cut_points=True, tolerance="5 nm", **words)
    assert not (tmp_path / "p.nc").exists()
    assert write_program(program, tmp_path / "p.nc", NGC, cut_points=True, **words).check is None
    back = read_program(tmp_path / "p.nc", NGC)
    assert back.quantity == "cut points"
    write_program(program, tmp_path / "q.nc", NGC, cut_points=True, nose=None, form=SKEW)
    assert "(tool not known)" in (tmp_path / "q.nc").read_text().splitlines()
    tips = {**words, "nose": None}
    with pytest.raises(DataError, match="needs the nose of the tool"):
        write_program(made(), tmp_path / "t.nc", NGC, **tips)
    with pytest.raises(DataError, match="no tool runs it"):
        check_program(back, RoundNose(R), SKEW)


GOOD = "(quantity tip)\nG90 G21\nG93 G1 X3 C0 Z0 F6\nX2.9 C-3 Z0.1 F7200\nN4 X2.8 C-6 Z0.1 F7200 (cut)\nX2.7 C-9 Z0.1 F7200\nM30\n"


def test_a_foreign_program_is_read_as_it_stands(tmp_path):
    (tmp_path / "p.nc").write_text(
        GOOD.replace("G93 G1", "% \nG93 G1 ; first\n").replace("X2.7 C-9 Z0.1 F7200", "C-9 F3600")
    )
    found = read_program(tmp_path / "p.nc", NGC)
    assert pytest.approx([3e-3, 2.9e-3, 2.8e-3, 2.8e-3], abs=1e-18) == found.X
    assert found.azimuth == pytest.approx(np.radians([0, 3, 6, 9]), abs=1e-15)
    assert np.diff(found.t) == pytest.approx([1 / 120, 1 / 120, 1 / 60], abs=1e-12)
    assert found.interpolation == "linear"


@pytest.mark.parametrize(
    ("old", "new", "error", "match"),
    [
        ("(quantity tip)\n", "", DataError, "nothing says whether these are places of the tip"),
        ("C-6", "C-2", DataError, "C turns back or stands still at block 2"),
        ("C-3 Z0.1 F7200", "C-3 Z0.1", DataError, "line 4: a block under G93 has no F word"),
        ("G93 ", "", DataError, "line 3: neither G93 nor G94"),
        ("G93", "G95", DataError, "line 3: G95 is not understood"),
        ("G21", "G20", DataError, "line 3: the program is in inch, the machine in mm"),
        ("C-6", "C-6 A1", DataError, "line 5: A1 is not understood"),
        ("C-6", "C-6 C-7", DataError, "line 5: C is there twice"),
        ("Z0.1 F7200 (cut)", "Z#1 F7200", DataError, "line 5: Z is not understood"),
        ("Z0.1 F7200 (cut)", "Z0.1 #1=2", CorruptFileError, "line 5: ' #1=2' is not a word"),
        ("X2.7", "G2 X2.7", DataError, "line 6: G2 is not understood"),
        ("X2.7 C", "CSPLINE\nX2.7 C", DataError, "lines and splines follow one another"),
        ("M30\n", "M30\nX2 C-12 Z0 F1\n", DataError, "line 8: words after the end"),
        ("G1 X3 C0 Z0 F6", "G1 X3 C0 F6", DataError, "line 3: Z is not known yet"),
        ("G93 G1 X3", "G93 X3", DataError, "axis words before G1"),
        ("F7200\nM30", "F0\nM30", DataError, "F of block 3 is 0"),
        ("X2.7", "X2.7\u2212", CorruptFileError, "is not ASCII"),
    ],
)
def test_a_strict_reader_names_the_line(tmp_path, old, new, error, match):
    assert old in GOOD
    (tmp_path / "p.nc").write_text(GOOD.replace(old, new), encoding="utf-8")
    with pytest.raises(error, match=match):
        read_program(tmp_path / "p.nc", NGC)


def test_a_point_list_that_is_damaged_is_refused(tmp_path):
    good = "# quantity tip\n# interpolation linear\nt_s,X_mm,C_deg,Z_mm\n0,3,0,0\n1,2,-9,0\n2,1,-18,0\n"
    for old, new, error, match in (
        ("X_mm", "X_inch", DataError, "columns t_s,X_inch"),
        ("1,2,-9,0", "1,2,-9", CorruptFileError, "line 5: 4 numbers are needed"),
        ("1,2,-9,0", "1,2,-9,n/a", CorruptFileError, "a field that is not a number"),
        ("1,2,-9,0", "1,2,-9,nan", CorruptFileError, "4 numbers are needed"),
        ("1,2,-9,0", "0,2,-9,0", DataError, "block 1 is reached at 0 s"),
    ):
        (tmp_path / "p.csv").write_text(good.replace(old, new))
        with pytest.raises(error, match=match):
            read_program(tmp_path / "p.csv", NGC)
    with pytest.raises(ReadError, match="cannot be read"):
        read_program(tmp_path / "none.nc", NGC)


def test_the_sense_of_c_has_no_default():
    with pytest.raises(TypeError, match="c_positive"):
        LatheAxes()
    with pytest.raises(DataError, match='"workpiece ccw" or "tool ccw"'):
        LatheAxes("ccw")


def test_a_wrong_sense_of_c_is_seen_on_a_skew_part(tmp_path):
    """The file is written for a machine whose C turns the other way than it does."""
    write_program(made(), tmp_path / "p.nc", NGC, nose=RoundNose(R), form=SKEW)
    wrong = read_program(tmp_path / "p.nc", LatheAxes("tool ccw", inverse_time="1/min"))
    assert check_program(wrong, RoundNose(R), SKEW).form_error > 100 * NM
    right = read_program(tmp_path / "p.nc", NGC)
    assert check_program(right, RoundNose(R), SKEW).form_error < 20 * NM


def test_blocks_too_slow_for_inverse_time_of_linuxcnc_are_named(tmp_path):
    """LinuxCNC lets no block of G93 go slower than 0.1 mm/min along X, Y, Z (seen in its interpreter)."""
    flat = Expression("0*x")
    turn = np.linspace(0.0, 6 * np.pi, 91)
    program = TurningProgram(2e-3 - 1e-6 * turn / (2 * np.pi), turn, 0 * turn, turn / (2 * np.pi), "tip", "linear")  # fmt: skip
    words = {"nose": RoundNose(R), "form": flat, "verify": False}

    slow = write_program(program, tmp_path / "a.nc", replace(NGC, x_decimals=8), **words)

    # 1 um a turn of 1 s is 0.06 mm/min, all 90 blocks the same
    (message,) = [m for m in slow.messages if "LinuxCNC" in m]
    assert message.startswith("90 of 90 blocks move X and Z slower than 0.1 mm/min")
    assert "up to 1.67 times too fast" in message
    assert message in json.loads(slow.sidecar.read_text())["messages"]
    other = write_program(program, tmp_path / "b.nc", LatheAxes("workpiece ccw", inverse_time="s"), **words)  # fmt: skip
    assert not [m for m in other.messages if "LinuxCNC" in m]


@pytest.mark.parametrize("sense", ["clockwise", "counterclockwise"])
def test_a_ring_of_four_turns_is_judged_in_both_senses(tmp_path, sense):
    """No other turn lies beside the first and the last one."""
    form = Expression("0.4*x**2-0.25*y**2+0.15*x*y+2e-4*x")
    nose = RoundNose(0.6e-3)
    job = TurningJob(form, 1.2e-3, 10e-6, rpm=60, core=1.16e-3, sense=sense, nose=nose)
    program = job.program(job.path(step=math.pi / 60, interpolation="linear"))

    made = write_program(
        program,
        tmp_path / "p.ngc",
        LatheAxes("workpiece ccw", "+X", 0.3, feed="G94"),
        nose=nose,
        form=form,
    )

    assert 0.0 < made.check.form_error < made.check.part.peak_to_valley


def test_one_bump_and_one_wrong_point_of_a_large_part_are_found():
    """A hundred places at random see neither; every block is looked at, whatever their number is."""
    form = Expression("9*x**2+14*y**2+3*x*y")
    nose = RoundNose(0.4e-3, math.radians(-15))
    turn = 2 * np.pi * np.arange(0, 36, 1 / 400)
    X = 5.7e-3 - 20e-6 * turn / (2 * np.pi)
    Z = tip_path(form, X, -turn, nose=nose, sense="clockwise").z
    made = TurningProgram(X, -turn, Z, turn, "tip", "spline")
    # a bump of 30 nm that the path does not know is cut away
    for a, b in ((-3.1e-3, 4.3e-3), (4.9e-3, -2.2e-3)):
        bump = Expression(
            f"9*x**2+14*y**2+3*x*y+3e-8*exp(-((x-({a}))**2+(y-({b}))**2)/(2*9e-5**2))"
        )
        found = check_program(made, nose, bump, places=100)
        assert found.form_error == pytest.approx(
            30 * NM, abs=1 * NM
        )  # turns 20 um apart, a third of a block
        assert found.course == pytest.approx(30 * NM, abs=1 * NM)
    # a point that stands 2 nm too high between turns is seen against the plan only
    wrong = Z.copy()
    wrong[7321] += 2 * NM
    other = TurningProgram(X, -turn, wrong, turn, "tip", "spline")
    found = check_program(other, nose, form, planned=made, places=100)
    assert found.difference == pytest.approx(2 * NM, abs=0.01 * NM)
    assert "too high from point 7321 on (X = 5.334 mm, azimuth 251.1 degrees)" in " ".join(
        found.messages
    )
    moved = X.copy()
    moved[7321] += 50 * NM  # at its contact a slope of some percent
    found = check_program(
        TurningProgram(moved, -turn, Z, turn, "tip", "spline"),
        nose,
        form,
        planned=made,
        places=100,
    )
    rho, theta = X[7321], -turn[7321]
    x, y = rho * np.cos(theta), rho * np.sin(theta)
    slope = (18 * x + 3 * y) * np.cos(theta) + (28 * y + 3 * x) * np.sin(theta)
    assert found.difference == pytest.approx(abs(slope) * 50 * NM, rel=0.1, abs=0.0)


@pytest.mark.slow
def test_a_file_of_many_blocks_is_read_in_little_memory(tmp_path):
    """A block keeps its four numbers; lists of Python kept 500 bytes."""
    import tracemalloc

    n = 60_000
    target = tmp_path / "many.nc"
    with target.open("w", encoding="ascii", newline="\n") as out:
        out.write("(quantity tip)\nG90 G21\nG93 G61\n")
        for k in range(n):
            out.write(f"G1 X{5 - 1e-5 * k:.6f} C{0.1 * k:.4f} Z{1e-6 * (k % 7):.7f} F600\n")
        out.write("M30\n")
    tracemalloc.start()
    found = read_program(target, LatheAxes("tool ccw", inverse_time="1/min"))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(found) == n
    assert found.duration == pytest.approx(0.1 * (n - 1), abs=1e-6)
    assert peak < 100 * n


def test_a_program_that_was_cut_short_is_named(tmp_path):
    whole = (
        "G21 G90 G93\nG1 X5.0 C0.0 Z0.0 F60\nX4.9 C90.0 Z0.01 F60\nX4.8 C180.0 Z0.02 F60\nM30\n"
    )
    axes = NGC
    file = tmp_path / "part.ngc"
    file.write_text(whole)
    assert read_program(file, axes, quantity="tip").X.size == 3

    # within a line, and within its last word: F6 is a word, too; a file of our own has its M30
    block = whole.rindex("F60")
    mark = "(METROSEP TURNING PROGRAM)\n"
    for kept, why in (
        (whole[: block + 2], "line 4 .*may have lost digits"),
        (whole[: block - 1].replace("G93", "G94"), "line 4 .*without the F of the block"),
        (whole[: block - 1].replace(" F", "F"), "G93 has no F"),
        (mark + whole.replace("M30\n", ""), "line 5 without the M30 that metrosep wrote"),
    ):
        file.write_text(kept)
        with pytest.raises((CorruptFileError, DataError), match=why):
            read_program(file, axes, quantity="tip")


def test_without_a_line_end_the_last_number_is_whole_only_where_it_stood_before(tmp_path):
    """Z0.225 that was cut to Z0.22 has as many decimals as the Z0.12 of the block before it."""
    head = "G21 G90 G94\nG1 F600 X10. C0. Z0.\n"
    file = tmp_path / "part.nc"
    file.write_text(head + "F600 X9.9 C30. Z0.12\nF600 X9.8 C60. Z0.22")
    with pytest.raises(CorruptFileError, match=r"may have lost digits.*close it with a line end"):
        read_program(file, NGC, quantity="tip")
    file.write_text(head + "X9.9 C30. Z0.12 F600\nX9.8 C60. Z0.225 F600")
    assert read_program(file, NGC, quantity="tip").Z[-1] == pytest.approx(2.25e-4, abs=1e-12)


@pytest.mark.parametrize("end", ["M2\n", "M99\n", "%\n", "M17\n", "RET\n", "M30", ""])
def test_a_program_of_others_ends_as_it_likes(tmp_path, end):
    file = tmp_path / "part.nc"
    file.write_text("%\n" + GOOD.replace("M30\n", end))
    found = read_program(file, NGC)
    assert len(found) == 4
    said = " ".join(found.messages)
    assert ("ends at line 7 without M30, M2, M99 or %, at X 2.7 Z 0.1" in said) is (not end)
