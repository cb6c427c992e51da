"""LinuxCNC type 0: hand-made files, what the controller was seen to do, what is refused."""

import itertools
import json
import re
from pathlib import Path

import numpy as np
import pytest
from contracts.dialect import DialectContract
from hypothesis import given, settings, strategies as st

from metrosep import controllers
from metrosep.compensation import CompensationTable
from metrosep.controllers.linuxcnc import LinuxCNC
from metrosep.errors import CorruptFileError, DataError, LimitError, ReadError, TableError

ROUNDING = 1e-14
"""Positions of 20 mm in double: 3e-18; differences of them times mm: far below."""
QUANTUM = 1e-13
"""Ten decimals of mm: half a step on the position and half on the entry."""

HAND = """-10 -9.998 -9.9975
0 0 0.0005
10 9.997 9.9975
20 20.004 20.0045
"""
SEEN_UM = [
    (-20, -1, -2.5),
    (-5, 1, -1.0),
    (5, 1, 1.5),
    (10, 1, 3.0),
    (15, 1, -0.5),
    (20, 1, -4.0),
    (30, 1, -4.0),
    (15, -1, -1.0),
    (10, -1, 2.5),
    (5, -1, 1.0),
    (0, -1, -0.5),
]
"""Target mm, direction, motor-pos minus pos of the real LinuxCNC (controllers notes, section 1)."""


@pytest.fixture
def hand(tmp_path):
    path = tmp_path / "hand.comp"
    path.write_text(HAND)
    return path


@pytest.mark.parametrize(("target", "direction", "offset"), SEEN_UM)
def test_simulator_does_what_the_controller_did(hand, target, direction, offset):
    lookup = controllers.simulate(hand, linear_units="mm")

    assert lookup(target * 1e-3, direction) == pytest.approx(offset * 1e-6, abs=ROUNDING)


def test_simulator_takes_arrays(hand):
    target, direction, offset = np.array(SEEN_UM).T

    seen = controllers.simulate(hand, linear_units="mm")(target * 1e-3, direction.astype(int))

    np.testing.assert_allclose(seen, offset * 1e-6, atol=ROUNDING, rtol=0)


def test_hand_made_file_reads_as_corrections(hand):
    table = controllers.read(hand, linear_units="mm")

    np.testing.assert_allclose(table.positions, [-10e-3, 0, 10e-3, 20e-3], atol=0, rtol=1e-12)
    np.testing.assert_allclose(table.forward, [-2e-6, 0, 3e-6, -4e-6], atol=ROUNDING, rtol=0)
    np.testing.assert_allclose(
        table.reverse, [-2.5e-6, -0.5e-6, 2.5e-6, -4.5e-6], atol=ROUNDING, rtol=0
    )


def test_equal_columns_read_as_one(tmp_path):
    path = tmp_path / "x.comp"
    path.write_text("0 0.001 0.001\n10 10 10\n")

    assert controllers.read(path, linear_units="mm").reverse is None


def test_entry_is_the_position_that_is_reached(tmp_path):
    """An axis that is 2 um too far at 10 mm reaches 10.002: written by hand from the rule p + e."""
    table = CompensationTable([0.0, 10e-3], [0.0, -2e-6], [1e-6, -3e-6], "X", "X", 0.0)
    path = tmp_path / "x.comp"

    controllers.write(table, path, allow_unverified=True)

    assert path.read_bytes() == (
        b"0.0000000000 0.0000000000 -0.0010000000\n10.0000000000 10.0020000000 10.0030000000\n"
    )


def test_carriage_returns_are_accepted(tmp_path):
    path = tmp_path / "x.comp"
    path.write_bytes(HAND.replace("\n", "\r\n").encode())

    assert controllers.read(path, linear_units="mm").positions.size == 4


@given(
    start=st.floats(-0.5, 0.5),
    steps=st.lists(st.floats(1e-6, 5e-2), min_size=1, max_size=40),
    seed=st.integers(0, 2**32 - 1),
    size=st.floats(1e-12, 1e-3),
    split=st.booleans(),
)
@settings(derandomize=True, deadline=None, max_examples=60)
def test_round_trip_is_within_the_quantisation(start, steps, seed, size, split):
    rng = np.random.default_rng(seed)
    p = start + np.concatenate([[0.0], np.cumsum(steps)])
    table = CompensationTable(
        p,
        size * rng.uniform(-1, 1, p.size),
        size * rng.uniform(-1, 1, p.size) if split else None,
        "X",
        "X",
        float(p[0]),
    )
    dialect = LinuxCNC()

    encoded = dialect.encode(table)
    back = dialect.decode(encoded.data, Path("x.comp"), linear_units="mm")

    assert encoded.quantisation <= QUANTUM * 1.01 + np.spacing(4 * np.abs(p).max())
    np.testing.assert_allclose(back.positions, p, atol=QUANTUM, rtol=0)
    for direction in (1, -1):
        np.testing.assert_allclose(
            back.correction(back.positions, direction),
            table.correction(table.positions, direction),
            atol=encoded.quantisation + 1e-15,
            rtol=0,
        )


@given(exponent=st.integers(-15, 0), start=st.floats(-1, 1))
@settings(derandomize=True, deadline=None, max_examples=60)
def test_file_holds_triples_and_nothing_else(exponent, start):
    p = start + np.array([0.0, 1e-3, 2e-3])
    c = np.array([0.0, 1.0, -1.0]) * 10.0**exponent

    data = LinuxCNC().encode(CompensationTable(p, c, None, "X", "X", start)).data

    number = rb"-?[0-9]+\.[0-9]{10}"
    assert re.fullmatch(rb"(?:" + number + rb" " + number + rb" " + number + rb"\n){3}", data)


def evenly(n):
    p = np.arange(n) * 1e-3
    return CompensationTable(p, np.zeros(n), None, "X", "X", 0.0)


def test_256_points_fit(tmp_path):
    controllers.write(evenly(256), tmp_path / "x.comp", allow_unverified=True)

    assert controllers.read(tmp_path / "x.comp").positions.size == 256


def test_257_points_are_refused(tmp_path):
    with pytest.raises(LimitError, match=r"257 points.*256"):
        controllers.write(evenly(257), tmp_path / "x.comp", allow_unverified=True)
    with pytest.raises(LimitError, match="256"):
        controllers.write(evenly(257), tmp_path / "x.comp", allow_unverified=True, max_points=1000)
    assert list(tmp_path.iterdir()) == []


def test_file_of_257_lines_is_refused(tmp_path):
    path = tmp_path / "x.comp"
    path.write_text("".join(f"{i} {i} {i}\n" for i in range(257)))

    with pytest.raises(LimitError, match=r"257 lines, LinuxCNC uses the first 256"):
        controllers.read(path)


def test_cross_axis_table_is_refused(tmp_path):
    cross = CompensationTable([0.0, 1e-3], [0, 1e-9], None, "X", "Z", 0.0)

    with pytest.raises(TableError, match=r"X -> Z.*cross_axis='hal'"):
        controllers.write(cross, tmp_path / "x.comp", allow_unverified=True)


@pytest.mark.parametrize("word", ["HAL", "yes", ""])
def test_cross_axis_needs_the_very_word(tmp_path, word):
    cross = CompensationTable([0.0, 1e-3], [0, 1e-9], None, "X", "Z", 0.0)

    with pytest.raises(DataError, match=r"cross_axis.*refuse, hal"):
        controllers.write(cross, tmp_path / "x.comp", allow_unverified=True, cross_axis=word)
    assert list(tmp_path.iterdir()) == []


def test_cross_axis_by_hal_keeps_its_axes_and_says_the_wiring(tmp_path):
    cross = CompensationTable([0.0, 1e-3], [0, 1e-9], None, "X", "Z", 0.0)

    controllers.write(cross, tmp_path / "x.comp", allow_unverified=True, cross_axis="hal")

    back = controllers.read(tmp_path / "x.comp")
    assert (back.axis, back.compensates) == ("X", "Z")
    sidecar = json.loads((tmp_path / "x.comp.json").read_text())
    assert any("drive of Z" in line for line in sidecar["hal_routing"])


def test_positions_below_the_last_decimal_are_refused(tmp_path):
    close = CompensationTable([0.0, 1e-14, 1e-3], [0, 0, 0], None, "X", "X", 0.0)

    with pytest.raises(TableError, match="closer than"):
        controllers.write(close, tmp_path / "x.comp", allow_unverified=True)


SILENT = "LinuxCNC would stop reading here without a word"


@pytest.mark.parametrize(
    ("text", "line", "consequence"),
    [
        ("# my table\n0 0 0\n1 1 1\n", 1, SILENT),
        ("0 0 0\n\n1 1 1\n", 2, SILENT),
        ("0 0 0\n1, 1, 1\n", 2, SILENT),
        ("0,0,0\n1,1,1\n", 1, SILENT),
        ("0 0\n1 1\n", 1, SILENT),
        ("0 0 0\n1 1 1 1\n", 2, SILENT),
        ("0 0 0\n1 nan 1\n", 2, SILENT),
        ("0 0 0\n1 inf 1\n", 2, SILENT),
        ("0 0 0\n1 1_0 1\n", 2, SILENT),
        ("0 0 0\n1 1 1\nend\n", 3, SILENT),
        ("0 0 0\n1 1.", 2, SILENT),
        ("0 0 0\n2 2 2\n1 1 1\n", 3, "LinuxCNC would drop this line"),
        ("0 0 0\n2 2 2\n2 2 2\n", 3, "LinuxCNC would drop this line"),
    ],
)
def test_what_the_controller_would_drop_is_refused(tmp_path, text, line, consequence):
    path = tmp_path / "x.comp"
    path.write_text(text)

    with pytest.raises(CorruptFileError, match=rf"x\.comp: line {line}\b") as caught:
        controllers.read(path)
    assert " ".join(consequence.split()) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_one_line_is_no_table(tmp_path):
    path = tmp_path / "x.comp"
    path.write_text("0 0 0\n")

    with pytest.raises(CorruptFileError, match="at least 2 lines"):
        controllers.read(path)


@pytest.mark.parametrize("content", [b"", b"\n \n"])
def test_empty_file_is_refused(tmp_path, content):
    path = tmp_path / "x.comp"
    path.write_bytes(content)

    with pytest.raises(ReadError, match="is empty"):
        controllers.read(path)


@pytest.mark.parametrize(
    "content", [b"\x00\x01\x02\x03" * 50, b"\x89PNG\r\n\x1a\n", b"\xff\xfe0\x00"]
)
def test_binary_is_refused(tmp_path, content):
    path = tmp_path / "x.comp"
    path.write_bytes(content)

    with pytest.raises(CorruptFileError, match=r"x\.comp"):
        controllers.read(path)


def test_missing_file_and_folder_are_refused(tmp_path):
    with pytest.raises(ReadError, match="no such file"):
        controllers.read(tmp_path / "x.comp")
    with pytest.raises(ReadError, match="is a folder"):
        controllers.read(tmp_path)


def turning(compensates="C"):
    degree = np.pi / 180
    return CompensationTable(
        np.array([0.0, 90.0, 270.0]) * degree,
        np.array([0.0, 0.001, -0.002]) * degree,
        None,
        "C",
        compensates,
        0.0,
    )


def test_table_of_a_joint_that_turns_is_in_degrees(tmp_path):
    path = tmp_path / "c.comp"
    controllers.write(turning(), path, allow_unverified=True, joint_type="angular")

    assert path.read_text() == (
        "0.0000000000 0.0000000000 0.0000000000\n"
        "90.0000000000 89.9990000000 89.9990000000\n"
        "270.0000000000 270.0020000000 270.0020000000\n"
    )
    back = controllers.read(path)
    assert (back.axis, back.compensates) == ("C", "C")
    np.testing.assert_allclose(back.positions, turning().positions, atol=ROUNDING, rtol=0)
    np.testing.assert_allclose(back.forward, turning().forward, atol=2e-12, rtol=0)
    lookup = controllers.simulate(path)
    assert lookup(np.pi / 4) == pytest.approx(0.0005 * np.pi / 180, abs=2e-12)
    assert "TYPE = ANGULAR" in json.loads((tmp_path / "c.comp.json").read_text())["ini"]


def test_degrees_without_a_sidecar_are_read_by_the_option(tmp_path):
    path = tmp_path / "c.comp"
    path.write_text("0 0 0\n180 180.002 180.002\n")

    back = controllers.read(path, "linuxcnc", joint_type="angular")

    assert back.axis == "C"
    assert back.positions[1] == pytest.approx(np.pi, abs=1e-15)
    assert back.forward[1] == pytest.approx(-0.002 * np.pi / 180, abs=ROUNDING)
    with pytest.raises(DataError, match=r"no sidecar.*give linear_units=mm or linear_units=inch"):
        controllers.read(path, "linuxcnc")  # mm, inch or degrees: nothing tells
    assert controllers.read(path, "linuxcnc", linear_units="mm").positions[1] == 0.18
    assert controllers.read(path, linear_units="inch").positions[1] == pytest.approx(
        180 * 25.4e-3, rel=1e-15, abs=0
    )


def test_type_of_the_joint_must_fit_the_axis(tmp_path):
    path = tmp_path / "c.comp"
    with pytest.raises(DataError, match=r"axis of the table is C.*joint_type='angular'"):
        controllers.write(turning(), path, allow_unverified=True)
    with pytest.raises(DataError, match=r"axis of the table is X.*joint_type='linear'"):
        controllers.write(evenly(3), path, allow_unverified=True, joint_type="angular")
    for cross in (turning("Z"), CompensationTable([0.0, 1e-3], [0, 0], None, "X", "C", 0.0)):
        for kind in ("linear", "angular"):
            with pytest.raises(TableError, match=r"C turns.*linuxcnc-lincurve"):
                LinuxCNC().encode(cross, cross_axis="hal", joint_type=kind)
    assert list(tmp_path.iterdir()) == []
    controllers.write(turning(), path, allow_unverified=True, joint_type="angular")
    with pytest.raises(DataError, match="sidecar says axis C"):
        controllers.read(path, "linuxcnc", joint_type="linear")
    many = CompensationTable(np.arange(257) * 1e-3, np.zeros(257), None, "C", "C", 0.0)
    with pytest.raises(LimitError, match=r"spacing of at least 0\.05752 degrees"):
        LinuxCNC().encode(many, joint_type="angular")


def test_a_name_that_breaks_a_line_of_hal_is_refused():
    with pytest.raises(TableError, match="name"):
        LinuxCNC().encode(
            CompensationTable([0.0, 1e-3], [0, 0], None, "X", "Z\nsetp comp-fb-a.gain1 1", 0.0),
            cross_axis="hal",
        )


class TestLinuxCNC(DialectContract):
    name = "linuxcnc"


_INCH_M, _GRAD = 0.0254, np.pi / 200.0
HALF_UNIT = 1e-10
"""Ten decimals of a machine unit: half a digit on the position and half on the entry."""


def trim_of(text, place, direction):
    """Return nominal minus actual in machine units, as the documents of COMP_FILE_TYPE = 0 say it."""
    rows = [[float(w) for w in line.split()] for line in text.split("\n") if line]
    column = 1 if direction > 0 else 2
    if place <= rows[0][0]:
        return rows[0][0] - rows[0][column]
    for a, b in itertools.pairwise(rows):
        if place <= b[0]:
            share = (place - a[0]) / (b[0] - a[0])
            return (1.0 - share) * (a[0] - a[column]) + share * (b[0] - b[column])
    return rows[-1][0] - rows[-1][column]


@pytest.mark.parametrize("direction", [1, -1])
def test_inch_machine_gets_all_three_columns_in_inches(tmp_path, direction):
    x = np.linspace(-0.1, 0.3, 41)
    ahead = 3e-5 * x + 2e-6 * np.sin(40.0 * x)
    table = CompensationTable(x, ahead, ahead - 1.5e-6, "X", "X", 0.0, is_exact_inverse=True)
    path = tmp_path / "x.comp"

    controllers.write(table, path, allow_unverified=True, linear_units="inch")

    text = path.read_text()
    for place in np.linspace(-0.2, 0.4, 97):
        wanted = float(table.correction(place, direction)[0])
        assert (
            abs(trim_of(text, place / _INCH_M, direction) * _INCH_M - wanted) < HALF_UNIT * _INCH_M
        )
    assert json.loads((tmp_path / "x.comp.json").read_text())["options"]["linear_units"] == "inch"
    assert abs(controllers.read(path).positions - x).max() < HALF_UNIT * _INCH_M
    assert any(
        "LINEAR_UNITS = inch" in n
        for n in LinuxCNC().encode(table, linear_units="inch").notes["ini"]
    )


def test_joint_counted_in_grad_or_rad(tmp_path):
    for name, unit in (("rad", 1.0), ("grad", _GRAD)):
        path = tmp_path / f"{name}.comp"
        controllers.write(
            turning(), path, allow_unverified=True, joint_type="angular", angular_units=name
        )
        for place in np.linspace(*turning().span, 29):
            wanted = float(turning().correction(place)[0])
            assert (
                abs(trim_of(path.read_text(), place / unit, 1) * unit - wanted) < 1.01 * HALF_UNIT
            )


def test_unknown_unit_of_the_configuration_is_refused(tmp_path):
    with pytest.raises(DataError, match=r"linear_units.*inch"):
        controllers.write(evenly(3), tmp_path / "x.comp", allow_unverified=True, linear_units="ft")
