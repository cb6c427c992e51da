"""Programs that look right and would be corrected wrongly: where the text does not tell the place."""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
import signal
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from controllers.program_marks import unmarked

from metrosep.compensation.maps import CompensationMap
from metrosep.compensation.table import CompensationTable
from metrosep.controllers.gcode.corrections import error_correction
from metrosep.controllers.gcode.lists import rewrite_points
from metrosep.controllers.gcode.paths import rewrite_path
from metrosep.core.atomic import atomic_write
from metrosep.core.errors import (
    CorruptFileError,
    DataError,
    InvalidSamplesError,
    LimitError,
    MetrosepError,
    UnsupportedFeatureError,
    WriteError,
)
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface

HEAD = "G21 G90 G8\n"
START = HEAD + "G0 X8. C0. Z5.\n"
HALF_NM = 0.5e-9 * (1 + 1e-6)
"""Half of the last digit in mm with 6 digits, as m; the share is binary rounding."""


def tilt() -> Surface:
    """0.1 um a mm along x, 0.03 um a mm along y: C and its sense show."""
    y, x = np.mgrid[-10e-3:10e-3:41j, -10e-3:10e-3:41j]
    return Surface(1e-4 * x + 3e-5 * y, dx=0.5e-3, dy=0.5e-3, origin=(-10e-3, -10e-3))


def constant(amount):
    return lambda x, c: amount + 0.0 * x


_ONE_US = re.compile(r"line [67]: the block takes 0\.001 ms")


class Folder:
    def __init__(self, path: Path) -> None:
        self.path = path

    def rewrite(self, text, correction=None, **options):
        (self.path / "in.nc").write_bytes(text if isinstance(text, bytes) else text.encode())
        options.setdefault("overwrite", True)
        made = correction or error_correction(tilt())
        result = rewrite_path(self.path / "in.nc", self.path / "out.nc", made, **options)
        return unmarked((self.path / "out.nc").read_bytes().decode("latin-1")), result

    def refused(self, text, correction=None, **options):
        with pytest.raises(MetrosepError) as caught:
            self.rewrite(text, correction, **options)
        assert [p.name for p in self.path.iterdir()] == ["in.nc"]
        return caught.value


@pytest.fixture
def folder(tmp_path):
    return Folder(tmp_path)


# --- a second program in the file ------------------------------------------------------------------


@pytest.mark.parametrize("top", ["", "%\n"])
@pytest.mark.parametrize("behind", ["%\n", "%\n%\n"])
def test_the_tape_behind_a_tape_is_refused(folder, top, behind):
    """A control may skip what stands above the first %, and load what follows it: the program that has no correction."""
    body = f"{START}G1 Z.1 F10\nM30\n"
    error = folder.refused(f"{top}{body}{behind}O2\n{body}%\n")

    assert "behind the end of the program" in str(error)


@pytest.mark.parametrize("end", ["M30", "M2", "N90 M02"])
def test_moves_behind_the_end_are_refused_and_never_left_as_they_are(folder, end):
    error = folder.refused(
        f"{START}G1 Z.1 F10\n{end}\nO2 (the second)\nG0 X4. C90.\nG1 Z.2 F10\nM30\n"
    )

    assert isinstance(error, UnsupportedFeatureError)
    assert "line 6: X4.: it stands behind the end of the program" in str(error)


@pytest.mark.parametrize(
    "rest",
    [
        "%\nX4. too low, said Karl\n",
        "%\n%\nO0003\n",
        "(X4.)\n",
        "O0002\n",
        "written on a Friday\n",
        "\n",
    ],
)
def test_what_moves_nothing_behind_the_end_stays(folder, rest):
    text, _ = folder.rewrite(f"{START}G1 Z.1 F10\nM30\n{rest}")

    assert text.endswith(f"M30\n{rest}")


# --- places that the text does not tell ---------------------------------------------------------


@pytest.mark.parametrize("away", ["G28 Z0", "G30 Z0", "G53 G0 Z0", "T2 M6", "T0202", "G28 X0 Z0"])
def test_after_a_home_move_or_tool_change_no_old_z_is_written(folder, away):
    text, _ = folder.rewrite(f"{START}{away}\nG0 X4. C90.\nG1 Z.1 F10\nM30\n")

    # at X 4, C 90: y = 4 mm, e = 0.12 um
    assert text == HEAD + (f"G0 X8. C0. Z4.999200\n{away}\nG0 X4. C90.\nG1 Z0.099880 F10\nM30\n")


@pytest.mark.parametrize(
    ("away", "letter"), [("G28 X0", "X"), ("T2 M6", "X"), ("M3 S100", "C"), ("M19", "C")]
)
def test_cutting_where_the_place_was_lost_is_refused(folder, away, letter):
    error = folder.refused(f"{START}{away}\nG1 Z0. F10\nM30\n")

    assert isinstance(error, UnsupportedFeatureError)
    assert f"line 4: a feed move: no {letter} word" in str(error)


def test_the_place_is_lost_across_pieces_of_a_file_too(folder, monkeypatch):
    from metrosep.controllers.gcode import columns as gcode_columns

    program = START + "(" + "a" * 60 + ")\nG28 Z0\n(" + "b" * 60 + ")\nG0 X4. C90.\nG1 Z.1 F10\n"
    whole, _ = folder.rewrite(program)
    for size in (17, 31, 47):
        monkeypatch.setattr(gcode_columns, "_BYTES", size)
        assert folder.rewrite(program)[0] == whole
    assert "G0 X4. C90.\n" in whole


def test_a_turning_spindle_has_no_angle(folder):
    body = "G1 X-8. Z.1 F10\nM30\n"
    error = folder.refused(HEAD + "M3 S1000\nG0 X8. C0. Z5.\n" + body)
    assert "line 2: M3 or M4: the spindle turns" in str(error)
    # a driven tool: C moves, so it is not the part that M3 turns
    folder.rewrite(HEAD + "M3 S1000\nG0 X8. C0. Z5.\nG1 C90. F10\n")
    # a profile does not depend on C
    profile = error_correction(Profile([-10e-3, 10e-3], [0.0, 1e-6]))
    folder.rewrite(START + "M3 S1000\n" + body, profile)


@pytest.mark.parametrize(
    "block",
    ["L100", "M17", "M198 P5", "D2", "M61 Q1", "M428", "M100", "M60", "P1", "Q1", "E5", "M3.5"],
)
def test_words_that_may_call_or_shift_are_refused(folder, block):
    error = folder.refused(START + "G1 Z0. F10\n" + block + "\nX4.\n")

    assert isinstance(error, UnsupportedFeatureError)
    assert f"line 4: {block.split()[0]}: " in str(error)


@pytest.mark.parametrize(
    "block", ["G4 P1", "M66 P1 L0", "M62 P1", "M68 E0 Q5", "M8", "G96 D2000 S100"]
)
def test_words_beside_their_code_are_fine(folder, block):
    folder.rewrite(START + "G1 Z0. F10\n" + block + "\nX4.\n")


def test_a_harmless_m_code_can_be_named(folder):
    program = START + "G1 Z0. F10\nM428\nX4.\n"
    assert "harmless_m=[428]" in str(folder.refused(program))
    assert "M428" in folder.rewrite(program, harmless_m=[428])[0]


@pytest.mark.parametrize("block", ["/M30", "/M2", "/M3", "/M5", "/F5", "/T2", "N5 /M30"])
def test_a_switch_on_the_machine_may_not_decide(folder, block):
    assert "switch on the machine" in str(folder.refused(START + block + "\nG1 X4. Z.1 F10\n"))


def test_f_in_g4_is_no_feed(folder):
    assert "a time on some controllers" in str(folder.refused(START + "G4 F2\nG1 X4. F10\n"))


# --- maps, tables, senses -----------------------------------------------------------------------


def square_map(**options):
    x = np.linspace(-5e-3, 5e-3, 5)
    return CompensationMap(x, x, np.tile(1e-3 * x, (5, 1)), **options)


def test_a_map_of_corrections_is_not_held_beyond_its_edge_unasked(folder):
    error = folder.refused(START, square_map())
    assert isinstance(error, InvalidSamplesError)
    assert "X = 8 mm, C = 0 deg is beyond the map" in str(error)

    assert folder.rewrite(START, square_map(), outside="hold")[0].endswith("Z5.005000\n")
    assert folder.rewrite(START, square_map(), outside="zero")[0].endswith("Z5.\n")
    inside = HEAD + "G0 X5. C180. Z5.\n"
    assert folder.rewrite(inside, square_map())[0].endswith("Z4.995000\n")


def test_a_map_that_corrects_another_axis_is_refused(folder):
    assert "corrects X" in str(folder.refused(START, square_map(compensates="X")))


def test_a_map_over_x_and_c_goes_round(folder):
    c = np.linspace(0.0, 2 * np.pi, 13)
    values = 1e-6 * np.sin(c)[:, None] * np.ones(3)
    turn = CompensationMap([0.0, 5e-3, 10e-3], c, values, axes=("X", "C"))
    found = []
    for angle in (90, 450, -270, -90, 630):
        text, _ = folder.rewrite(f"{HEAD}G0 X8. C{angle}. Z1.0\n", turn)
        found.append(text.split("Z")[1])
    assert found == ["1.001000\n"] * 3 + ["0.999000\n"] * 2

    half = CompensationMap([0.0, 10e-3], c[:7], values[:7, :2], axes=("X", "C"))
    assert folder.rewrite(f"{HEAD}G0 X8. C450. Z1.0\n", half)[0].endswith("Z1.001000\n")
    assert folder.rewrite(f"{HEAD}G0 X8. C360. Z1.0\n", half)[0].endswith("Z1.0\n")
    with pytest.raises(InvalidSamplesError, match="beyond the map"):
        folder.rewrite(f"{HEAD}G0 X8. C270. Z1.0\n", half)

    degrees = CompensationMap([0.0, 10e-3], np.rad2deg(c), values[:, :2], axes=("X", "C"))
    with pytest.raises(DataError, match="in degrees"):
        folder.rewrite(START, degrees)


@pytest.mark.parametrize("options", [{"c_sense": -1}, {"c_sense": 7}, {"c_zero": 1.0}])
@pytest.mark.parametrize(
    "made",
    [
        error_correction(tilt()),
        constant(1e-6),
        CompensationTable.from_error(
            lambda x: 1e-4 * x, positions=[-9e-3, 9e-3], axis="X", compensates="Z"
        ),
    ],
    ids=["error", "function", "table"],
)
def test_a_sense_that_would_be_ignored_is_refused(folder, made, options):
    assert "c_sense and c_zero are for a map" in str(folder.refused(START, made, **options))


def test_sense_of_a_map_is_obeyed_and_checked(folder):
    program = HEAD + "G0 X4. C60. Z1.0\n"
    found = [
        folder.rewrite(program, square_map(), c_sense=s, c_zero=math.radians(30))[1].correction[0]
        for s in (1, -1)
    ]
    assert found[0] == pytest.approx(0.0, abs=1e-15)
    assert found[1] == pytest.approx(1e-3 * 4e-3 * math.cos(math.radians(-30)), abs=1e-12)
    with pytest.raises(DataError, match="c_sense is 7"):
        folder.rewrite(program, square_map(), c_sense=7)


def test_a_shift_along_the_normal_is_not_cut_to_its_z(folder):
    made = error_correction(tilt(), slope=lambda x, c: np.ones(x.size), move_x=True)
    assert "axes=('Z', 'X')" in str(folder.refused(START, made))
    (folder.path / "p.csv").write_text("X_mm,C_deg,Z_mm\n4,0,1\n")
    with pytest.raises(DataError, match="lists get Z alone"):
        rewrite_points(folder.path / "p.csv", folder.path / "q.csv", made)


def test_unmeasured_ends_of_a_profile_are_beyond_it_and_gaps_are_not(folder):
    x = np.linspace(-5e-3, 5e-3, 11)
    z = np.array(2e-4 * x)
    z[0] = np.nan
    z[6] = np.nan  # 1 mm
    made = error_correction(Profile(x, z))
    program = HEAD + "G0 X-4.5 Z1.0\n"
    assert "beyond the map" in str(folder.refused(program, made))
    assert folder.rewrite(program, made, outside="hold")[0].endswith("Z1.000800\n")
    with pytest.raises(InvalidSamplesError, match="not measured"):
        folder.rewrite(HEAD + "G0 X1.2 Z1.0\n", made, outside="hold")


# --- between the points -------------------------------------------------------------------------


@pytest.mark.parametrize("lobes", [1, 2, 4, 8, 36, 72])
def test_a_full_turn_in_one_block_is_not_straight(folder, lobes):
    # a sine has zeros at both ends, in the middle and at every even fraction of the turn
    text = START + "G1 Z0. F10\nC360.\n"
    _, result = folder.rewrite(text, lambda x, c: 1e-6 * np.sin(lobes * c))
    # seen at 72 or more places of a turn, on two grids
    assert result.chord_error > 0.5e-6
    assert result.chord_error <= 1e-6 + 1e-15
    assert "5 deg" in result.audit["chord_looked_at"]


def test_a_tolerance_is_met_at_places_of_the_test_s_own(folder):
    tolerance = 5e-9
    c = lambda x, c: 1e-6 * np.cos(4 * c)  # noqa: E731
    text, result = folder.rewrite(
        START + "G1 Z0. F10\nC720.\n", c, tolerance=tolerance, c_rollover=False
    )
    points = np.array(
        [
            [float(re.search(rf"{a}([-\d.]+)", line)[1]) for a in "CZ"]
            for line in text.splitlines()[3:]
            if "C" in line
        ]
    )
    angle = np.linspace(points[0, 0], 720.0, 20011)
    z = np.interp(angle, points[:, 0], points[:, 1]) * 1e-3
    assert np.abs(z - c(0, np.deg2rad(angle))).max() <= tolerance + 2 * HALF_NM
    assert result.chord_error <= tolerance


def test_a_tolerance_that_cannot_be_met_is_refused_with_the_number(folder):
    step = lambda x, c: 1e-6 * (x > 3.0001e-3)  # noqa: E731
    error = folder.refused(START + "G1 Z0. F10\nX-8.\n", step, tolerance=5e-9)
    assert isinstance(error, LimitError)
    assert re.search(
        r"line 4: in 4096 parts .* \d+ nm off its chords, the tolerance is 5 nm", str(error)
    )

    error = folder.refused(START + "G1 Z0. F10\nC184320.\n", tolerance=50e-9, c_rollover=False)
    assert "too long to be looked at" in str(error)


@pytest.mark.parametrize("tolerance", [None, 1e-7])
@pytest.mark.parametrize("outside", ["refuse", "zero", "hold"])
def test_a_gap_that_the_path_crosses_between_two_points_is_refused(folder, tolerance, outside):
    z = np.array(tilt().z)
    z[18:23, 18:23] = np.nan
    surface = Surface(z, dx=0.5e-3, dy=0.5e-3, origin=(-10e-3, -10e-3))
    error = folder.refused(
        START + "G1 Z0. F10\nX-8.\n",
        error_correction(surface),
        tolerance=tolerance,
        outside=outside,
    )
    assert isinstance(error, InvalidSamplesError)
    assert "line 4: between its ends the move crosses" in str(error)


def test_a_path_that_leaves_the_map_between_two_points_is_refused(folder):
    z = np.array(tilt().z)
    z[30:, 30:] = np.nan  # a corner that the arc of C 0 to 90 goes through
    made = error_correction(Surface(z, dx=0.5e-3, dy=0.5e-3, origin=(-10e-3, -10e-3)))
    program = HEAD + "G0 X8. C0. Z1.\nG1 Z0. F10\nC90.\n"
    assert "or leaves the map" in str(folder.refused(program, made))
    # rapid moves are not in contact with the part
    folder.rewrite(program.replace("C90.", "G0 C90."), made)
    folder.rewrite(program, made, outside="hold")


def test_the_way_over_the_roll_over_is_not_guessed(folder):
    program = HEAD + "G0 X8. C359. Z5.\nG1 Z0. F10\nC1.\n"
    fine = {"tolerance": 1e-11}
    error = folder.refused(program, **fine)
    assert isinstance(error, UnsupportedFeatureError)
    assert "line 4: a block to be split that moves C by 358 deg" in str(error)
    assert "c_rollover=True" in str(error)

    short, result = folder.rewrite(program, c_rollover=True, **fine)
    angles = [float(a) for a in re.findall(r"C([\d.]+)", short)]
    assert result.n_added > 0
    for a, b in pairwise(angles):
        assert 0.0 <= (b - a) % 360.0 <= 1.01  # onwards, in small steps
    assert max(angles) <= 360.0
    long, result = folder.rewrite(program, c_rollover=False, **fine)
    angles = [float(a) for a in re.findall(r"C([\d.]+)", long)]
    assert all(a >= b for a, b in pairwise(angles))

    _, result = folder.rewrite(program)
    assert any("say c_rollover" in m for m in result.messages)


def test_the_step_at_the_border_is_told(folder):
    surface = Surface([[0.0, 2e-6, 4e-6]] * 3, dx=1e-3, dy=1e-3, origin=(0.0, -1e-3))
    program = HEAD + "G0 X1. C0. Z1.\nG1 X2. F1\nX2.1\nX2.5\n"
    _, result = folder.rewrite(program, error_correction(surface), outside="zero")

    told = [m for m in result.messages if "step" in m]
    assert len(told) == 1
    assert told[0].startswith("line 4: outside='zero' makes a step of 4 ")
    assert "100 µm" in told[0] or "100 um" in told[0]
    assert "steeper than 1 um per mm" in told[0]
    _, held = folder.rewrite(program, error_correction(surface), outside="hold")
    assert not any("step" in m for m in held.messages)


# --- words and numbers --------------------------------------------------------------------------


def test_f_in_a_block_of_its_own_counts(folder):
    program = HEAD + "G94\nG0 X8. C0. Z5.\nG1 Z0. F10\nF60000\nX7.999\nX7.998\n"
    error = folder.refused(program, blocks_per_s=100.0)
    assert isinstance(error, LimitError)
    assert _ONE_US.search(str(error))
    _, result = folder.rewrite(program)
    assert result.shortest_block == pytest.approx(60 * 0.001 / 60000, abs=1e-12)
    _, result = folder.rewrite(program.replace("F60000", "N7 F6.0"))
    assert result.shortest_block == pytest.approx(60 * 0.001 / 6, abs=1e-9)


def test_x_keeps_its_digits_and_comments_keep_theirs(folder):
    made = error_correction(tilt(), slope=lambda x, c: np.ones(x.size), move_x=True)
    text, _ = folder.rewrite(
        HEAD + "G0 X8.123456789 C0. Z5.\nG1 Z0. F10\nC20. ; go X7\nX7.123456789 (X1)\n",
        made,
        axes=("Z", "X"),
    )
    lines = text.splitlines()
    # c_x = e sin 45 deg = e / sqrt 2, e = 1e-4 X
    assert re.match(r"G0 X8\.\d{9} C0", lines[1])
    wanted = 8.123456789 * (1 + 1e-4 * math.sqrt(0.5))
    assert float(lines[1].split()[1][1:]) == pytest.approx(wanted, abs=1e-9 + 1e-12)
    assert lines[3].endswith("; go X7")
    assert re.match(r"C20\. Z\S+ X8\.\d{9} ;", lines[3])
    assert re.match(r"X7\.\d{9} Z\S+ \(X1\)", lines[4])


@pytest.mark.parametrize(
    ("body", "part"),
    [
        ("G1 Z0.1" + "1" * 400 + " F10\n", "digits after the point"),
        ("G1 Z1" + "0" * 300 + ". F10\n", "beyond the travel of any machine"),
        ("G1 X1" + "0" * 400 + ". F10\n", "beyond the travel of any machine"),
    ],
)
def test_numbers_without_sense_are_refused_with_line(folder, body, part):
    error = folder.refused(START + body)
    assert isinstance(error, DataError)
    assert "line 3" in str(error)
    assert part in str(error)


def test_decimals_are_a_whole_number(folder):
    assert "whole number" in str(folder.refused(START, decimals=5.5))


@pytest.mark.parametrize("before", [0, pytest.param((1 << 21) - 300, marks=pytest.mark.slow)])
def test_one_rule_for_the_length_of_a_block(folder, before):
    pad = "X3.100000\n" * (before // 10)
    long = "X3.(" + "a" * 4200 + ")\n"
    error = folder.refused(START + "G1 Z0. F10\n" + pad + long + "X2.\n")
    assert isinstance(error, CorruptFileError)
    assert f"line {4 + before // 10}: the block is longer than 4096" in str(error)
    folder.rewrite(START + "G1 Z0. F10\n" + pad + long.replace("a" * 200, "") + "X2.\n")


def test_a_byte_order_mark_is_named(folder):
    error = folder.refused(b"\xef\xbb\xbf" + START.encode())
    assert isinstance(error, CorruptFileError)
    assert "byte order mark" in str(error)


def test_what_follows_the_closing_percent_is_not_carried_out(folder):
    text, _ = folder.rewrite("%\n" + START + "%\nhello notes, G91\n")
    assert text == "%\n" + HEAD + "G0 X8. C0. Z4.999200\n%\nhello notes, G91\n"


# --- files --------------------------------------------------------------------------------------


def test_a_correction_is_not_added_twice_unasked(folder):
    folder.rewrite(START, constant(1e-6))
    once, twice = folder.path / "out.nc", folder.path / "twice.nc"
    with pytest.raises(DataError, match=r"holds a correction already.*\(in\.nc\).*again"):
        rewrite_path(once, twice, constant(1e-6))
    assert not twice.exists()
    rewrite_path(once, twice, constant(1e-6), again=True)
    assert "Z5.002000" in twice.read_text()

    once.write_text(once.read_text().replace("Z5.001000", "Z5.001001"))
    with pytest.raises(DataError, match="changed since"):
        rewrite_path(once, twice, constant(1e-6), overwrite=True)
    (folder.path / "out.nc.json").write_text('{"schema": "something else"}')
    with pytest.raises(DataError, match="METROSEP CORRECTED Z"):
        rewrite_path(once, twice, constant(1e-6), overwrite=True)
    once.write_text(unmarked(once.read_text()))
    rewrite_path(once, twice, constant(1e-6), overwrite=True)


def test_a_list_is_not_corrected_twice_unasked(tmp_path):
    (tmp_path / "a.csv").write_text("X_mm,C_deg,Z_mm\n4,0,1\n")
    rewrite_points(tmp_path / "a.csv", tmp_path / "b.csv", constant(1e-6))
    with pytest.raises(DataError, match="holds a correction already"):
        rewrite_points(tmp_path / "b.csv", tmp_path / "c.csv", constant(1e-6))
    rewrite_points(tmp_path / "b.csv", tmp_path / "c.csv", constant(1e-6), again=True)
    assert (tmp_path / "c.csv").read_text().endswith("1.002000\n")


@pytest.mark.parametrize("kind", ["nc", "csv"])
@pytest.mark.parametrize("old", [True, False])
def test_file_and_sidecar_fit_when_the_disk_gives_up_between_them(
    tmp_path, monkeypatch, kind, old
):
    source, target = tmp_path / f"a.{kind}", tmp_path / f"b.{kind}"
    source.write_text(START if kind == "nc" else "X_mm,C_deg,Z_mm\n4,0,1\n")
    rewrite = rewrite_path if kind == "nc" else rewrite_points
    if old:
        rewrite(source, target, constant(1e-6))
    replace = Path.replace

    def full(self, to):
        if Path(to).name == target.name:
            raise OSError(28, "No space left on device")
        return replace(self, to)

    monkeypatch.setattr(Path, "replace", full)
    with pytest.raises(WriteError):
        rewrite(source, target, constant(7e-6), overwrite=True)
    names = sorted(p.name for p in tmp_path.iterdir())
    if not old:
        assert names == [source.name]
        return
    assert names == [source.name, target.name, target.name + ".json"]
    said = json.loads((tmp_path / f"b.{kind}.json").read_text())
    assert said["file_sha256"] == hashlib.sha256(target.read_bytes()).hexdigest()


CUT = """
import os, sys
from pathlib import Path
from metrosep.core.atomic import atomic_stream
with atomic_stream(sys.argv[1]) as out:
    out.write(b"half")
    out.flush()
    os.kill(os.getpid(), int(sys.argv[2]))
"""


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_what_a_killed_run_leaves_the_next_one_removes(tmp_path):
    target = tmp_path / "out[1].nc"
    done = subprocess.run(
        [sys.executable, "-c", CUT, target, str(int(signal.SIGKILL))], check=False
    )
    assert done.returncode == -signal.SIGKILL
    assert len(list(tmp_path.glob(".out*.tmp"))) == 1
    other = tmp_path / ".other.nc.abcdef-1-2.tmp"
    other.write_bytes(b"")
    # a run that is still at work keeps its own
    host = next(tmp_path.glob(".out*.tmp")).name.rsplit(".", 2)[1].split("-")[0]
    mine = tmp_path / f".out[1].nc.{host}-{os.getpid():x}-00.tmp"
    mine.write_bytes(b"")

    atomic_write(target, b"whole")

    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(
        [target.name, other.name, mine.name]
    )
    assert target.read_bytes() == b"whole"
