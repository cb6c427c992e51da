"""Rewritten tool paths: signs, words, modal state, refusals, files."""

from __future__ import annotations

import hashlib
import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from controllers.program_marks import unmarked

from metrosep.compensation.table import CompensationTable
from metrosep.controllers.gcode.corrections import error_correction, nose_correction
from metrosep.controllers.gcode.paths import rewrite_path
from metrosep.core.errors import (
    CorruptFileError,
    DataError,
    InvalidSamplesError,
    LimitError,
    MetrosepError,
    ReadError,
    UnitError,
    UnsupportedFeatureError,
    WriteError,
)
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface

HEAD = "G21 G90\n"
HALF_NM = 0.5e-9 * (1 + 1e-6)
"""Half of the last digit in mm with 6 digits, as m; the share is binary rounding."""
BINARY_M = 1e-17
"""Rounding of positions of some 10 mm in double precision, as corrections of a um see it."""


def moves(text: str) -> np.ndarray:
    """X, C, Z after each moving block, nan before the first: a parser of its own."""
    at = {"X": math.nan, "C": math.nan, "Z": math.nan}
    found = []
    for line in text.splitlines():
        bare = re.sub(r"\([^)]*\)|;.*", "", line).upper()
        words = re.findall(r"([XCZ])\s*([-+.\d]+)", bare)
        for letter, number in words:
            at[letter] = float(number)
        if words:
            found.append([at["X"], at["C"], at["Z"]])
    return np.array(found)


def without_z(text: str) -> str:
    return re.sub(r" ?Z[-+.\d]+", "", text)


class Folder:
    def __init__(self, path: Path) -> None:
        self.path = path

    def rewrite(self, text: str, correction: object, **options):
        source = self.path / "in.nc"
        source.write_bytes(text.encode("latin-1"))
        result = rewrite_path(source, self.path / "out.nc", correction, **options)
        return unmarked((self.path / "out.nc").read_bytes().decode("latin-1")), result

    def refused(self, text: str, correction: object = None, **options):
        with pytest.raises(MetrosepError) as caught:
            self.rewrite(text, correction or (lambda x, c: 1e-6 + 0 * x), **options)
        assert [p.name for p in self.path.iterdir()] == ["in.nc"]
        return caught.value


@pytest.fixture
def folder(tmp_path):
    return Folder(tmp_path)


def constant(amount: float):
    return lambda x, c: amount + 0.0 * x


# --- sign ------------------------------------------------------------------------------------


def quadrant_map() -> Surface:
    """An error that is different in all four quadrants and rises outwards: (0, 0) on the axis."""
    y, x = np.mgrid[-10e-3:10e-3:41j, -10e-3:10e-3:41j]
    return Surface(1e-4 * x + 3e-5 * y, dx=0.5e-3, dy=0.5e-3, origin=(-10e-3, -10e-3))


@pytest.mark.parametrize(
    ("c_deg", "sense", "zero_deg", "x", "y"),
    [
        (0, 1, 0, 8, 0),
        (90, 1, 0, 0, 8),
        (90, -1, 0, 0, -8),
        (180, 1, 0, -8, 0),
        (30, 1, 60, 0, 8),
        (30, -1, 60, 8 * math.cos(math.pi / 6), 4),
        (450, 1, 0, 0, 8),
        (-270, 1, 0, 0, 8),
    ],
)
def test_error_of_the_part_is_subtracted_where_the_tool_is(folder, c_deg, sense, zero_deg, x, y):
    correction = error_correction(quadrant_map(), c_sense=sense, c_zero=math.radians(zero_deg))

    text, _ = folder.rewrite(HEAD + f"G0 X8.0 C{c_deg:.1f} Z1.0\n", correction)

    error_m = 1e-4 * x * 1e-3 + 3e-5 * y * 1e-3
    assert (moves(text)[0, 2] - 1.0) * 1e-3 == pytest.approx(-error_m, abs=HALF_NM + 1e-15)


def test_a_bump_is_cut_lower_on_its_own_side_only(folder):
    profile = Profile([-10e-3, -5e-3, 0.0, 5e-3, 10e-3], [0.0, 0.0, 0.0, 2e-6, 0.0])

    text, _ = folder.rewrite(
        HEAD + "G0 X5.0 Z1.0\nG1 X-5.0 F10\nG1 X2.5\n", error_correction(profile)
    )

    assert text == HEAD + "G0 X5.0 Z0.998000\nG1 X-5.0 Z1.000000 F10\nG1 X2.5 Z0.999000\n"


def test_applied_path_removes_the_error_and_flipped_it_doubles(folder):
    surface = quadrant_map()
    turns = "".join(f"X{8 - i * 0.05:.4f} C{i * 12.5:.3f} Z{0.01 * i:.4f}\n" for i in range(120))
    text, _ = folder.rewrite(HEAD + "G93 G1 F60\n" + turns, error_correction(surface))
    before, after = moves(HEAD + turns), moves(text)

    x, c = before[:, 0] * 1e-3, np.deg2rad(before[:, 1])
    error = 1e-4 * x * np.cos(c) + 3e-5 * x * np.sin(c)
    left = error + (after - before)[:, 2] * 1e-3

    assert np.ptp(error) > 1e-6
    assert np.abs(left).max() <= HALF_NM + 1e-15
    assert np.ptp(error - (after - before)[:, 2] * 1e-3) == pytest.approx(
        2 * np.ptp(error), abs=4 * HALF_NM
    )


def test_map_and_table_of_corrections_are_added_as_they_are(folder):
    class Area:
        def correction(self, x, y):
            return 1e-4 * np.asarray(x) - 2e-4 * np.asarray(y)

    text, _ = folder.rewrite(HEAD + "G0 X5.0 C90.0 Z1.0\n", Area(), c_sense=-1)
    assert moves(text)[0, 2] == pytest.approx(1.001, abs=1e-9)  # y = -5 mm

    table = CompensationTable.from_error(
        lambda x: 1e-4 * x, positions=[0.0, 5e-3, 10e-3], axis="X", compensates="Z"
    )
    text, _ = folder.rewrite(HEAD + "G0 X5.0 Z1.0\n", table, overwrite=True)
    assert moves(text)[0, 2] == pytest.approx(1.0 - 5e-4, abs=1e-9)


@pytest.mark.parametrize("slope", [1.0, -1.0, 0.0, 0.3])
def test_normal_error_with_z_alone_moves_the_surface_by_it(folder, slope):
    e = 2e-6
    made = nose_correction(lambda x, c: e + 0 * x, lambda x, c: slope + 0 * x)
    text, _ = folder.rewrite(HEAD + "G0 X5.0 C0.0 Z1.0\n", made)
    dz = (moves(text)[0, 2] - 1.0) * 1e-3

    # a line of that slope, moved along z, is away from the old one by dz cos t
    assert dz * math.cos(math.atan(slope)) == pytest.approx(-e, abs=HALF_NM)


@pytest.mark.parametrize("slope", [1.0, -1.0, 0.3])
def test_normal_error_with_x_and_z_is_a_shift_along_the_normal(folder, slope):
    e = 2e-6
    made = nose_correction(lambda x, c: e + 0 * x, lambda x, c: slope + 0 * x, move_x=True)
    text, _ = folder.rewrite(HEAD + "G0 X5.0 C0.0 Z1.0\n", made, axes=("Z", "X"))
    shift = (moves(text)[0] - [5.0, 0.0, 1.0])[[0, 2]] * 1e-3

    normal = np.array([-slope, 1.0]) / math.hypot(slope, 1.0)
    np.testing.assert_allclose(shift, -e * normal, rtol=0, atol=HALF_NM)


# --- words -----------------------------------------------------------------------------------


def test_every_other_byte_stays(folder):
    head = "%\r\nO1000\r\n(part 7: X5 Z3)\r\nG21 G90 G40 G94 (mm)\r\nT0101\r\nM3 S100\r\n"
    body = (
        "n10 g0 x10.0 c0.0 z5. ; approach Z9\r\nN20G1Z.5F10.\r\n\r\nN30\tX9.50\tC+370.5 M8\r\n"
        "/M7\r\nN40 X 9.4 C-1 (keep X1)\r\nZ +0.25 F 5\r\nM9\r\nM30\r\n%\r\nafter X1 # the end"
    )

    text, result = folder.rewrite(head + body, constant(1e-6))

    assert text == head + (
        "n10 g0 x10.0 c0.0 z5.001000 ; approach Z9\r\nN20G1Z0.501000F10.\r\n\r\n"
        "N30\tX9.50\tC+370.5 M8\r\n/M7\r\nN40 X 9.4 C-1 (keep X1)\r\nZ +0.251000 F 5\r\n"
        "M9\r\nM30\r\n%\r\nafter X1 # the end"
    )
    assert (result.n_changed, result.n_inserted, result.n_blocks) == (3, 0, 17)


def test_a_word_is_inserted_in_the_manner_of_its_block_and_only_where_z_changes(folder):
    c = lambda x, c: np.where(x > 5e-3, 1e-6, 2e-6)  # noqa: E731
    body = "G0X9.0C0.0Z1.0\nG1 X8.0 C1.0 F10 (a)\nx4.0c2.0f11\nC3.0\nZ1.0\nX3.0\tF7\n"

    text, result = folder.rewrite(HEAD + body, c)

    assert text == HEAD + (
        "G0X9.0C0.0Z1.001000\nG1 X8.0 C1.0 F10 (a)\nx4.0c2.0z1.002000f11\nC3.0\nZ1.002000\n"
        "X3.0\tF7\n"
    )
    assert result.n_inserted == 1


def test_z_alone_is_corrected_at_the_x_and_c_in_force(folder):
    text, _ = folder.rewrite(
        HEAD + "G0 X4.0 C90.0 Z1.0\nG1 Z0.5 F1\n", lambda x, c: x * 1e-3 * np.sin(c)
    )

    assert moves(text)[:, 2].tolist() == [1.004, 0.504]


def test_rapid_moves_before_the_position_is_known_stay(folder):
    text, result = folder.rewrite(
        HEAD + "G28\nG53 G0 Z0\nG0 Z50.0\nG0 X4.0 C0.0\nG1 Z1.0 F1\nG28\nM30\n", constant(1e-6)
    )

    assert text.splitlines()[3:6] == ["G0 Z50.0", "G0 X4.0 C0.0 Z50.001000", "G1 Z1.001000 F1"]
    assert any("1 rapid moves before the position" in m for m in result.messages)


def test_diameter_halves_x_for_the_lookup_and_leaves_the_word(folder):
    c = lambda x, c: 1e-4 * x  # noqa: E731
    for head, options in (("G21 G90 G7\n", {}), (HEAD, {"diameter": True})):
        text, _ = folder.rewrite(head + "G0 X10.0 C0.0 Z1.0\n", c, overwrite=True, **options)
        assert text.endswith("X10.0 C0.0 Z1.000500\n")
    text, _ = folder.rewrite("G21 G90 G8\nG0 X10.0 C0.0 Z1.0\n", c, overwrite=True)
    assert text.endswith("X10.0 C0.0 Z1.001000\n")


def test_diameter_words_move_by_twice_the_shift(folder):
    made = nose_correction(lambda x, c: 2e-6 + 0 * x, lambda x, c: 1 + 0 * x, move_x=True)
    text, _ = folder.rewrite("G21 G90 G7\nG0 X10.0 C0.0 Z1.0\n", made, axes=("Z", "X"))

    shift = moves(text)[0] - [10.0, 0.0, 1.0]
    assert shift[0] == pytest.approx(2 * 2e-3 * math.sqrt(0.5), abs=5e-7)
    assert shift[2] == pytest.approx(-2e-3 * math.sqrt(0.5), abs=5e-7)


def test_inches_are_inches_and_get_the_digits_of_a_nanometre(folder):
    text, result = folder.rewrite(
        "G20 G90\nG0 X0.5 C0.0 Z1.0\n", lambda x, c: np.where(x == 12.7e-3, 25.4e-6, 0.0)
    )

    assert text.endswith("Z1.00100000\n")
    assert result.quantisation == pytest.approx(25.4e-11, abs=1e-20)


def test_digits_of_the_path_and_of_the_argument(folder):
    program = HEAD + "G0 X1.0 C0.0 Z1.00000001\n"
    text, _ = folder.rewrite(program, constant(1e-9))
    assert text.endswith("Z1.00000101\n")

    text, _ = folder.rewrite(program, constant(1e-9), decimals=9, overwrite=True)
    assert text.endswith("Z1.000001010\n")

    text, _ = folder.rewrite(
        HEAD + "G0 X1.0 C0.0 Z1.0\n", constant(1e-9), resolution=1e-10, overwrite=True
    )
    assert text.endswith("Z1.0000010\n")


def test_too_few_digits_are_refused_with_line(folder):
    error = folder.refused(HEAD + "G0 X1.0 C0.0 Z1.0001\n", decimals=3)

    assert isinstance(error, DataError)
    assert "line 2" in str(error)
    assert "4 or more" in str(error)


# --- splitting -------------------------------------------------------------------------------


def test_blocks_are_split_where_the_correction_bends(folder):
    tolerance = 20e-9
    c = lambda x, _c: 1e-6 * np.sin(x / 1e-3)  # noqa: E731
    program = HEAD + "G0 X0.0 C0.0 Z1.0\nN5 G93 G1 X8.0 C40.0 Z2.0 F6 (cut)\n"

    text, result = folder.rewrite(program, c, tolerance=tolerance)
    found = moves(text)

    assert result.n_added == found.shape[0] - 2 > 20
    assert found[-1, :2].tolist() == [8.0, 40.0]
    assert "N5 G93 G1 X" in text
    assert text.count("N5") == 1
    assert text.count("(cut)") == 1
    share = found[1:, 0] / 8.0
    np.testing.assert_allclose(found[1:, 1], 40 * share, rtol=0, atol=1e-5)
    np.testing.assert_allclose(
        found[1:, 2], 1 + share + 1e3 * c(found[1:, 0] * 1e-3, 0), rtol=0, atol=1.5e-6
    )
    # the machine moves on chords: between the points it must be within the tolerance
    x = np.linspace(0, 8, 4001)
    z = np.interp(x, found[:, 0], found[:, 2]) - (1 + x / 8)
    assert np.abs(z * 1e-3 - c(x * 1e-3, 0)).max() <= tolerance + 2e-9
    assert result.chord_error <= tolerance


def test_inverse_time_of_the_parts_adds_up_to_the_whole(folder):
    c = lambda x, _c: 1e-6 * np.sin(x / 1e-3)  # noqa: E731
    text, result = folder.rewrite(
        HEAD + "G0 X0.0 C0.0 Z1.0\nG93 G1 X8.0 C40.0 Z2.0 F6\n", c, tolerance=20e-9
    )

    feeds = [float(f) for f in re.findall(r"F([\d.]+)", text)]
    assert len(feeds) == result.n_added + 1
    assert sum(60 / f for f in feeds) == pytest.approx(60 / 6, abs=1e-6)


def test_feed_per_minute_is_left_to_the_parts(folder):
    c = lambda x, _c: 1e-6 * np.sin(x / 1e-3)  # noqa: E731
    text, _ = folder.rewrite(
        HEAD + "G0 X0.0 C0.0 Z1.0\nG94 G1 X8.0 F6\nX0.0\n", c, tolerance=20e-9
    )

    assert re.findall(r"F[\d.]+", text) == ["F6"]
    assert moves(text)[-1, 0] == 0.0


def test_straight_corrections_split_nothing(folder):
    text, result = folder.rewrite(
        HEAD + "G0 X0.0 C0.0 Z1.0\nG1 X8.0 F6\n", lambda x, c: 1e-4 * x, tolerance=1e-12
    )

    assert result.n_added == 0
    assert text.count("\n") == 3


def test_a_narrow_bump_of_a_map_between_two_far_points_is_seen(folder):
    z = np.zeros((3, 401))
    z[:, 137] = 1e-6
    surface = Surface(z, dx=0.05e-3, dy=1e-3, origin=(0.0, -1e-3))
    _, result = folder.rewrite(
        HEAD + "G0 X20.0 C0.0 Z1.0\nG1 X0.0 F1\n", error_correction(surface), tolerance=100e-9
    )

    assert result.n_added > 100


def test_a_block_that_does_more_than_move_is_not_split(folder):
    error = folder.refused(
        HEAD + "G0 X0.0 C0.0 Z1.0\nG1 X8.0 F6 M8\n",
        lambda x, c: 1e-6 * np.sin(x / 1e-3),
        tolerance=1e-9,
    )

    assert "line 3: M8" in str(error)


def test_bending_between_points_is_told_without_a_tolerance(folder):
    _, result = folder.rewrite(
        HEAD + "G0 X0.0 C0.0 Z1.0\nG1 X8.0 F6\n", lambda x, c: 1e-6 * np.sin(x / 1e-3)
    )

    assert any("give a tolerance" in m for m in result.messages)


# --- refusals --------------------------------------------------------------------------------

START = HEAD + "G0 X1.0 C0.0 Z1.0\nG1 X2.0 F1\n"


@pytest.mark.parametrize(
    ("block", "part"),
    [
        ("G2 X1 Z1 R5", "G2: an arc"),
        ("G03 X1.0 Z1.0 I0.5", "arc"),
        ("G41 X1.0", "G41: cutter compensation"),
        ("G42", "G42: cutter compensation"),
        ("G43 H1", "tool length"),
        ("G43 H1 Z5.0", "tool length"),
        ("G49", "tool length"),
        ("G68 X0 R30", "rotated|corner"),
        ("G91", "G91: incremental"),
        ("G92 X0", "G92"),
        ("G52 X1.0", "G52"),
        ("G10 L2 P1 X0", "G10"),
        ("G55", "coordinates change"),
        ("G59.1", "coordinates change"),
        ("G5.2 X1", "spline"),
        ("G5 X1 I0 J1 P1 Q1", "spline|arc"),
        ("G81 Z-1 R1", "cycle|corner"),
        ("G76 P1", "G76: a canned cycle"),
        ("G33 Z-1 K1", "thread|arc"),
        ("M98 P1000", "M98: a subprogram"),
        ("M99", "subprogram"),
        ("O100", "O-word"),
        ("O100 sub", "sub"),
        ("#1 = 5", "#1"),
        ("X[1+1]", r"\["),
        ("IF [#1 EQ 1] GOTO 10", "IF"),
        ("WHILE [1]", "WHILE"),
        ("G7", "radius and diameter"),
        ("G20", "in mm"),
        ("U0.1", "incremental X and Z"),
        ("Y1.0", "X and C only"),
        ("A10.0", "X and C only"),
        ("X1.0 X2.0", "twice"),
        ("G4 X1.0", "time on some"),
        ("/X1.0", "switch on the machine"),
        ("T0202", "tool change"),
        ("G112", "G112: nobody can say"),
        ("G112\n", "G112: nobody can say"),
        ("G04.5", "G4.5"),
        ("Q5 K2", "arc|nobody can say"),
        ("X1.0 J2", "arc"),
        ("G28\nX1.0", "leaves the path"),
        ("G80\nX1.0", "no G0 or G1"),
    ],
)
def test_what_moves_the_path_is_refused_with_line_reason_and_way_out(folder, block, part):
    error = folder.refused(START + block + "\nX3.0\n")

    assert isinstance(error, UnsupportedFeatureError)
    assert re.search(rf"in\.nc: line [45]: .*(?:{part}).*; \w", str(error)), str(error)


def test_offsets_before_the_first_move_are_fine(folder):
    text, _ = folder.rewrite(
        "G21 G90 G17 G40 G49 G80 G64 P0.001\nG54\nT1 M6\nG43 H1\nG97 S100 M3\nG0 X1.0 C0.0 Z1.0\n",
        constant(1e-6),
    )
    assert text.endswith("Z1.001000\n")


def test_unknown_unit_is_refused_and_can_be_given(folder):
    error = folder.refused("G90\nG0 X1.0 C0.0 Z1.0\n")
    assert "line 2" in str(error)
    assert "G21" in str(error)

    text, result = folder.rewrite("G90\nG0 X1.0 C0.0 Z1.0\n", constant(1e-6), unit="mm")
    assert text.endswith("Z1.001000\n")
    assert any("states no unit" in m for m in result.messages)


def test_given_unit_against_the_program_is_refused(folder):
    assert "G21" in str(folder.refused(START, unit="inch"))
    with pytest.raises(UnitError, match="unit is 'm'"):
        folder.rewrite(START, constant(0.0), unit="m")


def test_feed_move_without_c_is_refused_but_not_for_a_profile(folder):
    program = HEAD + "G0 X1.0 Z1.0\nG1 X2.0 F1\n"
    error = folder.refused(program)
    assert "line 3" in str(error)
    assert "C word" in str(error)

    profile = Profile([0.0, 5e-3], [0.0, 5e-6])
    text, _ = folder.rewrite(program, error_correction(profile))
    assert moves(text)[:, 2].tolist() == [0.999, 0.998]


@pytest.mark.parametrize(("outside", "expected"), [("zero", [0.99, 1.0]), ("hold", [0.99, 0.98])])
def test_beyond_the_map_is_refused_unless_said(folder, outside, expected):
    surface = Surface([[0.0, 1e-5, 2e-5]] * 3, dx=1e-3, dy=1e-3, origin=(0.0, -1e-3))
    program = HEAD + "G0 X1.0 C0.0 Z1.0\nG1 X3.0 F1\n"

    error = folder.refused(program, error_correction(surface))
    assert isinstance(error, InvalidSamplesError)
    assert "line 3: X = 3 mm, C = 0 deg is beyond the map" in str(error)

    text, result = folder.rewrite(program, error_correction(surface), outside=outside)
    assert moves(text)[:, 2].tolist() == expected
    assert any("1 moves lie beyond the map" in m for m in result.messages)


@pytest.mark.parametrize("outside", ["refuse", "zero", "hold"])
def test_gaps_in_the_map_are_always_refused(folder, outside):
    z = np.zeros((7, 7))
    z[3, 4] = np.nan
    surface = Surface(z, dx=1e-3, dy=1e-3, origin=(-3e-3, -3e-3))

    error = folder.refused(
        HEAD + "G0 X0.0 C0.0 Z1.0\nG1 X0.5 F1\n", error_correction(surface), outside=outside
    )

    assert isinstance(error, InvalidSamplesError)
    assert "line 3" in str(error)
    assert "not measured" in str(error)


@pytest.mark.parametrize("outside", ["refuse", "zero", "hold"])
def test_around_a_round_part_is_beyond_the_map_and_not_a_gap(folder, outside):
    y, x = np.mgrid[-5e-3:5e-3:21j, -5e-3:5e-3:21j]
    z = np.where(np.hypot(x, y) <= 4.6e-3, 2e-4 * x, np.nan)
    surface = Surface(z, dx=0.5e-3, dy=0.5e-3, origin=(-5e-3, -5e-3))
    program = HEAD + "G0 X4.9 C0.0 Z1.0\nG1 X4.5 F1\n"

    if outside == "refuse":
        assert "line 2: X = 4.9 mm, C = 0 deg is beyond the map" in str(
            folder.refused(program, error_correction(surface))
        )
        return
    text, result = folder.rewrite(program, error_correction(surface), outside=outside)
    first = {"zero": 1.0, "hold": 1 - 0.9e-3}[outside]
    assert moves(text)[:, 2].tolist() == [first, 1 - 0.9e-3]
    assert result.audit["n_beyond_map"] == 1


def test_a_gap_beside_a_measured_point_of_full_weight_does_not_matter(folder):
    z = np.full((3, 3), 1e-6)
    z[2, 2] = np.nan
    surface = Surface(z, dx=1e-3, dy=1e-3, origin=(-1e-3, -1e-3))
    text, _ = folder.rewrite(HEAD + "G0 X1.0 C0.0 Z1.0\n", error_correction(surface))

    assert text.endswith("Z0.999000\n")


def test_map_in_the_wrong_unit_meets_the_stroke_limit(folder):
    error = folder.refused(START, constant(1e-3))
    assert isinstance(error, LimitError)
    assert "1000 um" in str(error)

    text, _ = folder.rewrite(START, constant(1e-3), stroke=2e-3)
    assert moves(text)[0, 2] == 2.0


def test_block_rate(folder):
    program = HEAD + "G93 G1 X1.0 C0.0 Z1.0 F60\nX2.0 F6000\n"
    _, result = folder.rewrite(program, constant(1e-6), blocks_per_s=100.0)
    assert result.shortest_block == pytest.approx(0.01, abs=1e-12)
    for path in folder.path.glob("out*"):
        path.unlink()

    error = folder.refused(program, blocks_per_s=99.0)
    assert isinstance(error, LimitError)
    assert "line 3" in str(error)

    _, result = folder.rewrite(HEAD + "G94 G0 X1.0 C0.0 Z1.0\nG1 X4.0 Z5.0 F300\n", constant(1e-6))
    assert result.shortest_block == pytest.approx(60 * 5 / 300, abs=1e-12)


@pytest.mark.parametrize(
    ("block", "words"),
    [
        ("G05 P10000", "G5 P10000"),
        ("G05.1 Q1", "G5.1 Q1"),
        ("CYCLE832(0.01,1)", "CYCLE832"),
        ("COMPCAD", "COMPCAD"),
        ("G64 P0.001", "G64 P0.001"),
        ("G8 P1", "G8 P"),
    ],
)
def test_smoothing_is_told(folder, block, words):
    _, result = folder.rewrite(START + block + "\nX3.0\n", constant(1e-6))

    found = [m for m in result.messages if words in m]
    assert len(found) == 1
    assert found[0].startswith("line 4")
    assert "1/10 of the correction" in found[0]


def test_turning_in_feed_per_minute_is_told(folder):
    _, result = folder.rewrite(
        HEAD + "G94 G0 X1.0 C0.0 Z1.0\nG1 X1.001 C90.0 F1\n", lambda x, c: 2e-6 * np.sin(c)
    )
    assert any("inverse time" in m for m in result.messages)


def test_whole_numbers_are_told(folder):
    _, result = folder.rewrite(HEAD + "G0 X10 C0 Z1.0\n", constant(1e-6))
    assert any("10 has no decimal point" in m for m in result.messages)


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("", DataError),
        ("(nothing)\nM30\n", DataError),
        ("\x89PNG\r\n\x1a\n\x00\x00", CorruptFileError),
        ("x" * 10_000, CorruptFileError),
        (HEAD + "X1.0\n", UnsupportedFeatureError),
        ("hello world\n", CorruptFileError),
    ],
)
def test_what_is_no_program_is_refused(folder, text, kind):
    assert isinstance(folder.refused(text), kind)


@pytest.mark.parametrize(
    "options",
    [
        {"axes": ("Y",)},
        {"axes": ()},
        {"axes": ("Z", "X")},
        {"outside": "ignore"},
        {"decimals": 0},
        {"decimals": 12},
        {"resolution": 0.0},
        {"resolution": math.nan},
        {"tolerance": -1e-9},
        {"stroke": math.inf},
        {"blocks_per_s": 0.0},
        {"outside": "hold"},
    ],
)
def test_wrong_arguments_are_refused(folder, options):
    assert isinstance(folder.refused(START, **options), DataError)


@pytest.mark.parametrize(
    "thing",
    [
        Surface(np.zeros((3, 3)), dx=1e-3, dy=1e-3),
        Profile([0.0, 1.0], [0.0, 1.0]),
        3.0,
        "map.x3p",
        CompensationTable.from_error(lambda x: 0 * x, positions=[0.0, 1.0], axis="X"),
        lambda x, c: np.zeros(7),
    ],
)
def test_errors_and_other_things_are_no_corrections(folder, thing):
    assert isinstance(folder.refused(START, thing), DataError)


def test_direction_dependent_table_is_refused(folder):
    table = CompensationTable.from_error(
        lambda x: 0 * x,
        reverse=lambda x: 1e-6 + 0 * x,
        positions=[0.0, 1.0],
        axis="X",
        compensates="Z",
        direction="split",
    )
    assert "each direction" in str(folder.refused(START, table))


@pytest.mark.parametrize(
    ("error", "options", "part"),
    [
        (Surface(np.zeros((3, 3))), {}, "lateral step"),
        (Surface(np.full((3, 3), np.nan), dx=1.0, dy=1.0), {}, "no measured value"),
        (Surface(np.zeros((1, 3)), dx=1.0, dy=1.0), {}, "2 x 2"),
        (Surface(np.zeros((3, 3)), dx=1.0, dy=1.0), {"c_sense": 0}, "c_sense"),
        (Surface(np.zeros((3, 3)), dx=1.0, dy=1.0), {"c_zero": math.nan}, "c_zero"),
        (Surface(np.zeros((3, 3)), dx=1.0, dy=1.0), {"move_x": True}, "slope"),
        (Profile([0.0, 1.0], [0.0, math.nan]), {}, "two measured"),
        (5.0, {}, "not a map"),
    ],
)
def test_unusable_errors_are_refused(error, options, part):
    with pytest.raises(DataError, match=part):
        error_correction(error, **options)


# --- files -----------------------------------------------------------------------------------


def test_sidecar_says_what_the_program_cannot(folder):
    surface = quadrant_map()
    _, result = folder.rewrite(START, error_correction(surface, c_sense=-1, c_zero=0.5))

    found = json.loads((folder.path / "out.nc.json").read_text())
    source = (folder.path / "in.nc").read_bytes()
    assert found == result.audit
    assert found["source_sha256"] == hashlib.sha256(source).hexdigest() == result.sha256_source
    written = (folder.path / "out.nc").read_bytes()
    assert found["file_sha256"] == hashlib.sha256(written).hexdigest()
    assert found["correction"]["c_sense"] == -1
    assert found["correction"]["c_zero_rad"] == 0.5
    assert re.fullmatch("[0-9a-f]{64}", found["correction"]["sha256"])
    assert "c = -e is added" in found["sign"]
    assert found["n_changed"] == result.n_changed == 2


def test_existing_files_are_not_replaced_unasked(folder):
    folder.rewrite(START, constant(1e-6))
    before = {p.name: p.read_bytes() for p in folder.path.iterdir()}

    with pytest.raises(WriteError, match="exists already"):
        folder.rewrite(START, constant(2e-6))
    assert {p.name: p.read_bytes() for p in folder.path.iterdir()} == before

    with pytest.raises(UnsupportedFeatureError):
        folder.rewrite(START + "G91\n", constant(2e-6), overwrite=True)
    assert (folder.path / "out.nc").read_bytes() == before["out.nc"]
    assert (folder.path / "out.nc.json").read_bytes() == before["out.nc.json"]

    text, _ = folder.rewrite(START, constant(2e-6), overwrite=True)
    assert "Z1.002000" in text


def test_program_is_never_replaced_by_itself(tmp_path):
    source = tmp_path / "in.nc"
    source.write_text(START)
    link = tmp_path / "link.nc"
    link.symlink_to(source)

    for target in (source, link, tmp_path / "." / "in.nc"):
        with pytest.raises(WriteError, match="the source itself"):
            rewrite_path(source, target, constant(1e-6), overwrite=True)
    assert source.read_text() == START


def test_missing_program_and_folder(tmp_path):
    with pytest.raises(ReadError, match="cannot be read"):
        rewrite_path(tmp_path / "no.nc", tmp_path / "out.nc", constant(0.0))
    with pytest.raises(ReadError, match="is a folder"):
        rewrite_path(tmp_path, tmp_path / "out.nc", constant(0.0))
    (tmp_path / "in.nc").write_text(START)
    with pytest.raises(WriteError, match="does not exist"):
        rewrite_path(tmp_path / "in.nc", tmp_path / "no" / "out.nc", constant(0.0))


def test_late_refusal_in_a_long_program_leaves_nothing(folder):
    long = "".join(
        f"N{i} X{1 + i * 1e-5:.5f} C{i:.1f} Z1.0\n" for i in range(80_000)
    )  # two pieces: 2.3 MB
    error = folder.refused(START + long + "G91\n")

    assert f"line {80_000 + 4}: G91" in str(error)


def test_long_programs_are_the_same_whatever_the_pieces(folder, monkeypatch):
    from metrosep.controllers.gcode import columns as gcode_columns

    body = "".join(
        f"N{i} X{9 - i * 1e-3:.3f} C{i * 7.5:.1f}" + (" Z1.0" if i % 3 else "") + "\r\n"
        for i in range(2000)
    )
    c = lambda x, c: 1e-6 * np.sin(3 * c) * np.cos(x / 1e-3)  # noqa: E731
    whole, _ = folder.rewrite(START + body, c)
    monkeypatch.setattr(gcode_columns, "_BYTES", 997)
    cut, result = folder.rewrite(START + body, c, overwrite=True)

    assert cut == whole
    assert result.n_blocks == 2003
    assert result.n_inserted > 600


def test_zero_correction_copies_the_program(folder):
    text, result = folder.rewrite(START, constant(0.0))

    assert text == START
    assert result.n_changed == 0
    assert result.sha256_source == result.sha256_target
    assert any("no block changed" in m for m in result.messages)
