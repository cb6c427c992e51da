"""SINUMERIK ENC_COMP: a file written by hand, an interpreter of its own, what is refused."""

import re
from pathlib import Path

import numpy as np
import pytest
from contracts.dialect import DialectContract
from hypothesis import given, settings, strategies as st

from metrosep import controllers
from metrosep.compensation import CompensationTable
from metrosep.controllers.sinumerik import SinumerikEnc
from metrosep.errors import (
    CorruptFileError,
    DataError,
    LimitError,
    SignCheckFailedError,
    TableError,
    UnsupportedFeatureError,
)

QUANTUM = 0.5e-12
"""Half of the ninth decimal of a millimetre, in m."""
FLOAT = 1e-15
"""Rounding of millimetres in double, in m."""
BETWEEN = 21e-9
"""h^2 max|e''|/8 of the bump: (0.5 mm)^2/8 * 2 * 3 um/(3 mm)^2 = 20.8 nm."""
NOWHERE = Path("nowhere.INI")
X1 = {"machine_axis": "X1"}

HAND = """%_N_AX_EEC_INI
CHANDATA(1)
$AA_ENC_COMP[0,0,X1]=0.0
$AA_ENC_COMP[0,1,X1]=0.003
$AA_ENC_COMP[0,2,X1]=0.0
$AA_ENC_COMP_STEP[0,X1]=5.0
$AA_ENC_COMP_MIN[0,X1]=0.0
$AA_ENC_COMP_MAX[0,X1]=10.0
$AA_ENC_COMP_IS_MODULO[0,X1]=0
M17
"""
"""Example of the controllers notes, section 3.4."""


@pytest.fixture(scope="module")
def both(bump):
    """Table for both directions, zero at the reference point 0."""
    return CompensationTable.from_error(bump, positions=np.linspace(0.0, 50e-3, 101), axis="X")


def interpreter(text, system=0, axis="X1"):
    """Return where the axis stands when it is commanded to p (mm), from the manual; no library.

    The value is added to the actual value: the loop closes on position + value = command, to the
    small first order at which the value is looked up at the command.
    """
    assign = dict(re.findall(r"^(\$\S+)=(\S+)$", text, re.MULTILINE))
    low = float(assign[f"$AA_ENC_COMP_MIN[{system},{axis}]"])
    high = float(assign[f"$AA_ENC_COMP_MAX[{system},{axis}]"])
    step = float(assign[f"$AA_ENC_COMP_STEP[{system},{axis}]"])
    n = round((high - low) / step) + 1
    values = [float(assign[f"$AA_ENC_COMP[{system},{i},{axis}]"]) for i in range(n)]

    def stands_at(p):
        if assign[f"$AA_ENC_COMP_IS_MODULO[{system},{axis}]"] == "1":
            p_in = low + (p - low) % (high - low)
        else:
            p_in = min(max(p, low), high)
        i = min(int((p_in - low) / step), n - 2)
        share = (p_in - low) / step - i
        return p - ((1 - share) * values[i] + share * values[i + 1])

    return stands_at


def test_hand_made_file_reads_as_corrections():
    back = SinumerikEnc().decode(HAND.encode(), NOWHERE)

    np.testing.assert_allclose(back.positions, [0, 5e-3, 10e-3], atol=FLOAT, rtol=0)
    np.testing.assert_allclose(back.forward, [0, -3e-6, 0], atol=FLOAT, rtol=0)
    assert back.reverse is None


def test_the_same_file_is_written():
    """The axis is 3 um too far at 5 mm: the entry is +0.003, that of the error itself."""
    made = CompensationTable([0, 5e-3, 10e-3], [0, -3e-6, 0], None, "X", "X", 0.0)

    text = SinumerikEnc().encode(made, **X1).data.decode()

    assert "".join(s for s in text.splitlines(True) if not s.startswith(";")) == HAND
    assert "\n; metrosep: turns=0 axis=X check=" in text


def test_positive_entry_moves_the_axis_in_negative_direction():
    assert interpreter(HAND)(5.0) == pytest.approx(4.997, abs=1e-12)
    assert SinumerikEnc().lookup(HAND.encode(), NOWHERE)(5e-3) == pytest.approx(-3e-6, abs=FLOAT)


def test_error_disappears_and_a_negated_table_doubles_it(both, bump):
    good = interpreter(SinumerikEnc().encode(both, **X1).data.decode())
    wrong = interpreter(SinumerikEnc().encode(both.negated(), **X1).data.decode())

    for p in (3e-3, 11.2e-3, 12e-3, 20e-3, 31e-3):
        zero = bump(0.0)
        actual = good(p * 1e3) * 1e-3
        assert actual + bump(actual) - zero - p == pytest.approx(0.0, abs=BETWEEN)
    doubled = wrong(12.0) * 1e-3
    assert doubled + bump(doubled) - bump(0.0) - 12e-3 == pytest.approx(6e-6, abs=0.05e-6)


def test_simulator_is_the_interpreter(both):
    data = SinumerikEnc().encode(both, **X1).data
    lookup, stands_at = SinumerikEnc().lookup(data, NOWHERE), interpreter(data.decode())

    for p in np.random.default_rng(1).uniform(-20e-3, 70e-3, 60):
        assert lookup(p) == pytest.approx(stands_at(p * 1e3) * 1e-3 - p, abs=FLOAT)
        assert lookup(p, -1) == lookup(p, 1)


def test_modulo_repeats():
    p = np.radians(np.arange(0.0, 361.0, 60.0))
    c = -np.radians([0.0, 0.01, 0.02, 0.005, -0.01, 0.003, 0.0])
    made = CompensationTable(p, c, None, "C", "C", 0.0)

    encoded = SinumerikEnc().encode(made, machine_axis="C1", turns=True, modulo=True)

    text = encoded.data.decode()
    assert "$AA_ENC_COMP[0,2,C1]=0.02\n" in text
    assert "$AA_ENC_COMP_STEP[0,C1]=60.0\n" in text
    assert "$AA_ENC_COMP_MAX[0,C1]=360.0\n" in text
    lookup = SinumerikEnc().lookup(encoded.data, NOWHERE, turns=True)
    for turn in (-2, 0, 3):
        assert lookup(np.radians(90.0 + 360.0 * turn)) == pytest.approx(
            -np.radians(0.0150), abs=1e-12
        )
    stands_at = interpreter(text, axis="C1")
    assert stands_at(450.0) == pytest.approx(450.0 - 0.015, abs=1e-9)
    assert SinumerikEnc().decode(encoded.data, NOWHERE, turns=True).axis == "C"


def test_modulo_with_a_step_is_refused():
    made = CompensationTable([0, 1, 2], [0, 1e-6, 2e-6], None, "C", "C", 0.0)

    with pytest.raises(TableError, match="repeats"):
        SinumerikEnc().encode(made, **X1, turns=True, modulo=True)


def test_turning_axis_must_be_said():
    made = CompensationTable([0, 1, 2], [0, 1e-6, 0], None, "C", "C", 0.0)

    with pytest.raises(DataError, match="turns=False"):
        SinumerikEnc().encode(made, **X1)


def test_reference_point_must_have_no_correction(both):
    shifted = CompensationTable(
        both.positions, both.forward + 0.25e-6, None, "X", "X", both.reference
    )

    with pytest.raises(TableError, match=r"X = 0 mm is 250 nm.*reference="):
        SinumerikEnc().encode(shifted, **X1)
    with pytest.raises(TableError, match="12 mm is"):
        SinumerikEnc().encode(both, **X1, reference_point=12e-3)


def test_reference_point_outside_takes_the_held_end():
    made = CompensationTable([10e-3, 20e-3], [0.0, 1e-6], None, "X", "X", 10e-3)

    SinumerikEnc().encode(made, **X1, reference_point=-5e-3)
    with pytest.raises(TableError, match="jump"):
        SinumerikEnc().encode(made, **X1, reference_point=25e-3)


def test_limit_of_points(both):
    assert SinumerikEnc().encode(both, **X1, points_limit=101).notes["MD38000_at_least"] == 101
    with pytest.raises(LimitError, match=r"101 entries.*holds 100.*0.5051 mm"):
        SinumerikEnc().encode(both, **X1, points_limit=100)
    assert SinumerikEnc().encode(both, **X1, points_limit=51, spacing=1e-3).resampling_error > 0


def test_two_directions_are_refused(table):
    with pytest.raises(TableError, match=r"direction=.*BACKLASH.*sinumerik-cec"):
        SinumerikEnc().encode(table, **X1)


def test_other_axis_is_refused():
    cross = CompensationTable([0, 1e-3], [0, 1e-9], None, "X", "Z", 0.0)

    with pytest.raises(TableError, match="sinumerik-cec"):
        SinumerikEnc().encode(cross, **X1)


@pytest.mark.parametrize("name", ["1X", "X 1", "X,1", "X]", "Ä"])
def test_axis_must_have_a_name(both, name):
    with pytest.raises(DataError, match="machine_axis"):
        SinumerikEnc().encode(both, machine_axis=name)


def test_uneven_table_is_refused_or_resampled():
    made = CompensationTable([0, 1e-3, 4e-3], [0, -1e-6, 0], None, "X", "X", 0.0)

    with pytest.raises(TableError, match="spacing="):
        SinumerikEnc().encode(made, **X1)
    assert SinumerikEnc().encode(made, **X1, spacing=1e-3).resampling_error < FLOAT


@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.integers(2, 60),
    start=st.floats(-2, 2),
    step=st.floats(1e-5, 0.1),
    size=st.floats(1e-10, 1e-3),
)
@settings(derandomize=True, deadline=None, max_examples=60)
def test_round_trip_is_within_the_quantisation(seed, n, start, step, size):
    rng = np.random.default_rng(seed)
    c = size * rng.normal(size=n)
    c[0] = 0.0
    p = start + step * np.arange(n)
    made = CompensationTable(p, c, None, "X", "X", float(p[0]))

    encoded = SinumerikEnc().encode(made, **X1, measuring_system=1)
    back = SinumerikEnc().decode(encoded.data, NOWHERE)

    assert encoded.quantisation <= QUANTUM * 1.0001 + size * 1e-14
    assert re.search(rb"[0-9][eE]", encoded.data.partition(b"CHANDATA")[2]) is None
    np.testing.assert_allclose(back.positions, p, atol=1e-12, rtol=0)
    q = rng.uniform(p[0] - step, p[-1] + step, 200)
    np.testing.assert_allclose(
        SinumerikEnc().lookup(encoded.data, NOWHERE)(q),
        made.correction(q),
        atol=encoded.quantisation + 1e-12 * np.abs(np.diff(c)).max() / step + FLOAT,
        rtol=0,
    )


def test_written_verified_and_read(tmp_path, both, measured):
    path = tmp_path / "AX_EEC.INI"

    result = controllers.write(both, path, "sinumerik-enc", verified_against=measured, **X1)

    assert result.passed
    back = controllers.read(path, "sinumerik-enc")
    np.testing.assert_allclose(back.forward, both.forward, atol=QUANTUM + FLOAT, rtol=0)
    with pytest.raises(DataError, match="machine_axis"):
        controllers.write(both, tmp_path / "y.INI", "sinumerik-enc", allow_unverified=True)
    with pytest.raises(SignCheckFailedError):
        controllers.write(
            both.negated(), tmp_path / "z.INI", "sinumerik-enc", verified_against=measured, **X1
        )
    assert not (tmp_path / "z.INI").exists()


def test_one_of_several_tables_is_chosen():
    body = HAND.removesuffix("M17\n")
    second = body.split("CHANDATA(1)\n")[1].replace("X1", "Z1").replace("0.003", "0.007")
    data = (body + second + "M17\n").encode()

    with pytest.raises(UnsupportedFeatureError, match="Z1"):
        SinumerikEnc().decode(data, NOWHERE)
    back = SinumerikEnc().decode(data, NOWHERE, machine_axis="Z1")
    assert back.forward[1] == pytest.approx(-7e-6, abs=FLOAT)
    with pytest.raises(DataError, match=r"no table.*X1 encoder 0, Z1 encoder 0"):
        SinumerikEnc().decode(data, NOWHERE, machine_axis="Y1")


def test_comments_blanks_and_spaces_are_read():
    text = HAND.replace("=0.003", " = 0.003 ; 2nd value: +3 um").replace("M17", "\n;end\nM17")

    assert SinumerikEnc().decode(text.replace("\n", "\r\n").encode(), NOWHERE).forward[1] < 0


def test_repeating_file_with_a_step_is_refused():
    text = HAND.replace("MODULO[0,X1]=0", "MODULO[0,X1]=1").replace("[0,2,X1]=0.0", "[0,2,X1]=0.1")

    with pytest.raises(CorruptFileError, match="repeats"):
        SinumerikEnc().decode(text.encode(), NOWHERE)


def turning_table(degrees, peak=100.0):
    """Error of 3e-5 rad at `peak` degrees of C, zero at both ends."""
    p = np.radians(degrees)
    e = 3e-5 * np.exp(-(((p - np.radians(peak)) / np.radians(8.0)) ** 2))
    e[0] = e[-1] = 0.0
    return CompensationTable(p, -e, None, "C", "C", float(p[0]), is_exact_inverse=True)


@pytest.mark.parametrize(
    ("last", "fits"),
    [(350.0, False), (360.0, True), (180.0, True), (720.0, False), (200.0, False)],
)
def test_repeating_turning_axis_repeats_after_a_turn(last, fits):
    made = turning_table(np.arange(0.0, last + 1.0, 2.0))
    turns = {"machine_axis": "C1", "turns": True, "modulo": True}

    if not fits:
        with pytest.raises(TableError, match=rf"after {last:g} deg.*append the position 360 deg"):
            SinumerikEnc().encode(made, **turns)
        return
    lookup = SinumerikEnc().lookup(SinumerikEnc().encode(made, **turns).data, NOWHERE)
    for k in (0, 1, -3):
        assert lookup(np.radians(100.0 + 360.0 * k)) == pytest.approx(-3e-5, abs=1e-11)


def test_ends_that_are_equal_but_for_rounding_are_printed_equal():
    """0.9 pm apart, and half an entry of 1 pm between them: 0 and 0.000000001 mm if rounded alone."""
    c = np.array([0.0, 1e-6, 2e-6, 1e-6, 5e-7, 9e-13])
    made = CompensationTable(np.linspace(0, 50e-3, 6), c, None, "X", "X", 0.0)

    encoded = SinumerikEnc().encode(made, **X1, modulo=True)

    back = SinumerikEnc().decode(encoded.data, NOWHERE)
    assert back.forward[0] == back.forward[-1]
    assert encoded.quantisation == pytest.approx(9e-13, abs=1e-16)


def test_reference_point_is_judged_by_what_the_file_carries():
    """Zero at 20 mm in the table; with entries each 0.7 mm it is between two that are not zero."""
    made = CompensationTable.from_error(
        lambda x: 3e-6 * (1 - np.cos(2 * np.pi * np.asarray(x) / 20e-3)),
        positions=np.linspace(0.0, 50e-3, 501),
        axis="X",
        exact=False,
    )
    assert abs(made.correction(20e-3)[0]) < FLOAT

    with pytest.raises(TableError, match=r"X = 20 mm is -.* nm in the file.*with reference="):
        SinumerikEnc().encode(made, **X1, reference_point="20 mm", spacing="0.7 mm")
    kept = SinumerikEnc().encode(made, **X1, reference_point=20e-3, spacing="0.5 mm")
    assert abs(SinumerikEnc().lookup(kept.data, NOWHERE)(20e-3)) <= QUANTUM


def test_reference_point_of_a_repeating_table_is_folded():
    made = turning_table(np.arange(0.0, 361.0, 2.0))
    turns = {"machine_axis": "C1", "turns": True, "modulo": True}

    with pytest.raises(TableError, match=r"C = 460 deg is -30 urad"):
        SinumerikEnc().encode(made, **turns, reference_point="460 deg")
    assert SinumerikEnc().encode(made, **turns, reference_point="-360 deg")


@pytest.mark.parametrize("axis", ["X1", "AX4", "C1"])
def test_degrees_stay_degrees_without_a_sidecar(axis):
    made = turning_table(np.arange(0.0, 361.0, 2.0))
    straight = CompensationTable([0, 1e-3], [0, -1e-6], None, "Y", "Y", 0.0)

    data = SinumerikEnc().encode(made, machine_axis=axis, turns=True).data
    back = SinumerikEnc().decode(data, NOWHERE)
    assert (back.axis, back.positions[-1]) == ("C", pytest.approx(2 * np.pi, abs=1e-12))
    with pytest.raises(DataError, match="turns=False"):
        SinumerikEnc().decode(data, NOWHERE, turns=False)
    data = SinumerikEnc().encode(straight, machine_axis=axis).data
    back = SinumerikEnc().decode(data, NOWHERE)
    assert (back.axis, back.positions[-1]) == ("Y", pytest.approx(1e-3, abs=1e-15))


def test_foreign_file_is_read_by_its_axis_or_refused():
    def read(name, **told):
        return SinumerikEnc().decode(HAND.replace("X1", name).encode(), NOWHERE, **told)

    assert (read("Z1").axis, read("Z1").positions[-1]) == ("Z", pytest.approx(10e-3, abs=1e-15))
    assert (read("B2").axis, read("B2").positions[-1]) == (
        "B",
        pytest.approx(np.radians(10.0), abs=1e-15),
    )
    with pytest.raises(DataError, match=r"AX3 is in mm or in degrees.*turns=True or turns=False"):
        read("AX3")
    assert read("AX3", turns=True).axis == "C"
    assert read("AX3", turns=False).axis == "X"


def test_lengths_and_angles_of_options():
    p = np.radians(np.r_[0.0:100.0:7.0, 100.0:351.0:2.0, 360.0])
    made = CompensationTable(p, 1e-6 * np.sin(p), None, "C", "C", 0.0)
    turns = {"machine_axis": "C1", "turns": True}

    encoded = SinumerikEnc().encode(made, **turns, spacing="2 deg")
    assert b"STEP[0,C1]=2.0\n" in encoded.data
    with pytest.raises(DataError, match=r"spacing='20 mm'.*C turns"):
        SinumerikEnc().encode(made, **turns, spacing="20 mm")
    with pytest.raises(TableError, match=r"these lie 2 deg to 10 deg apart"):
        SinumerikEnc().encode(made, **turns)
    with pytest.raises(LimitError, match=r"holds 200.*at least 1.809 deg"):
        SinumerikEnc().encode(made, **turns, spacing="1 deg", points_limit=200)
    straight = CompensationTable([0, 1e-3, 4e-3], [0, -1e-6, 0], None, "X", "X", 0.0)
    with pytest.raises(DataError, match=r"spacing='2 deg'.*X does not turn"):
        SinumerikEnc().encode(straight, **X1, spacing="2 deg")


@pytest.mark.parametrize(
    "value", ["2", "2 s", "0 mm", "-1 deg", "nan mm", True, [1], 0.0, 10**400]
)
def test_spacing_that_is_no_length_is_refused_by_name(both, tmp_path, value):
    with pytest.raises(DataError, match="spacing"):
        controllers.write(both, tmp_path / "x.INI", "sinumerik-enc", spacing=value, **X1)
    assert list(tmp_path.iterdir()) == []


def test_positions_uneven_by_a_tenth_of_a_nanometre_say_so():
    p = np.linspace(0.0, 50e-3, 51)
    p[7] += 1e-10

    with pytest.raises(TableError, match=r"0.9999999 mm to 1.0000001 mm apart \(200 pm between"):
        SinumerikEnc().encode(CompensationTable(p, 0 * p, None, "X", "X", 0.0), **X1)


def test_every_changed_line_is_found_without_a_sidecar(both):
    lines = SinumerikEnc().encode(both, **X1).data.decode().splitlines()
    for i in (*range(3, len(lines), 7), len(lines) - 2):
        for changed in (lines[i][:-2], lines[i] + "1", ""):
            data = "\n".join([*lines[:i], changed, *lines[i + 1 :]]).encode()
            with pytest.raises(CorruptFileError):
                SinumerikEnc().decode(data, NOWHERE)


def test_sidecar_of_a_table_across_axes_is_refused(tmp_path):
    path = tmp_path / "x.INI"
    (tmp_path / "x.INI.json").write_text('{"table": {"axis": "Y", "compensates": "Z"}}')

    with pytest.raises(CorruptFileError, match="states that it corrects Z over Y"):
        SinumerikEnc().decode(HAND.encode(), path)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("MAX[0,X1]=10.0", "MAX[0,X1]=5000000000.0"),
        ("MAX[0,X1]=10.0", "MAX[0,X1]=" + "9" * 400),
        ("MAX[0,X1]=10.0", "MAX[0,X1]=" + "9" * 5000),
        ("STEP[0,X1]=5.0", "STEP[0,X1]=0.000000005"),
        ("STEP[0,X1]=5.0", f"STEP[0,X1]=0.{'0' * 308}1"),
        ("[0,1,X1]", f"[0,{'1' * 5000},X1]"),
        ("=0.003", "=" + "9" * 400),
    ],
)
def test_numbers_beyond_all_bounds_are_refused(old, new):
    assert old in HAND

    with pytest.raises(CorruptFileError) as caught:
        SinumerikEnc().decode(HAND.replace(old, new, 1).encode(), NOWHERE)
    assert len(str(caught.value)) < 400


class TestSinumerikEnc(DialectContract):
    name = "sinumerik-enc"
    hand = HAND
    whole = "\n"
    damage = (
        ("%_N_AX_EEC_INI\n", "", "not a compensation file"),
        ("CHANDATA(1)\n", "", "not a compensation file"),
        ("M17\n", "", "cut short"),
        ("M17\n", "M30\n", "M17"),
        ("$AA_ENC_COMP[0,1,X1]=0.003\n", "", "0 ... 2"),
        ("[0,1,X1]=0.003", "[0,2,X1]=0.003", "line 5 sets .* again, after line 4"),
        ("=0.003\n", "=0.003\n$AA_ENC_COMP[0,01,X1]=0.001\n", "line 5 sets what line 4 sets"),
        ("[0,1,X1]=0.003", "[0,3,X1]=0.003", "0 ... 2"),
        ("[0,1,X1]", "[0.1,X1]", "line 4.*commas"),
        ("[0,1,X1]", "[0,1]", "line 4"),
        ("[0,1,X1]", "[2,1,X1]", "encoder 2"),
        ("=0.003", "=0,003", "line 4 holds no number"),
        ("=0.003", "=3e-3", "line 4 holds no number"),
        ("=0.003", "=nan", "line 4 holds no number"),
        ("=0.003", "", "line 4 is not"),
        ("=0.003", "=", "line 4 is not"),
        ("$AA_ENC_COMP[0,1", "$AA_ENC_COMB[0,1", "line 4.*not part"),
        ("$AA_ENC_COMP[0,1", "G1 X5", "line 4 is not"),
        ("STEP[0,X1]=5.0", "STEP[0,X1]=0", "positive"),
        ("STEP[0,X1]=5.0", "STEP[0,X1]=-5.0", "positive"),
        ("STEP[0,X1]=5.0", "STEP[0,X1]=4.0", "multiple of STEP"),
        ("STEP[0,X1]=5.0", "STEP[0,X1]=2.5", "0 ... 4"),
        ("$AA_ENC_COMP_STEP[0,X1]=5.0\n", "", "no STEP"),
        ("$AA_ENC_COMP_MIN[0,X1]=0.0\n", "", "no MIN"),
        ("MIN[0,X1]=0.0", "MIN[0,X1]=20.0", "MAX above MIN"),
        ("$AA_ENC_COMP_MAX[0,X1]=10.0\n", "", "no MAX"),
        ("$AA_ENC_COMP_IS_MODULO[0,X1]=0\n", "", "no IS_MODULO"),
        ("MODULO[0,X1]=0", "MODULO[0,X1]=2", "IS_MODULO is 0 or 1"),
        ("0,2,X1]=0.0", "0,2,X1]=µ", "not ASCII"),
    )
