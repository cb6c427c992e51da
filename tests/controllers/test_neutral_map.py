"""Neutral map: a hand-written file, orientation and sign, what is refused."""

import csv
import hashlib
import math
import os
from pathlib import Path

import numpy as np
import pytest
from contracts.dialect import DialectContract
from hypothesis import given, settings, strategies as st

from metrosep import controllers
from metrosep.compensation.maps import CompensationMap
from metrosep.controllers.base import sidecar_path
from metrosep.controllers.neutral import NeutralMap
from metrosep.errors import CorruptFileError, ReadError, TableError

NOWHERE = Path(os.devnull)

HAND = """x_mm,y_mm,correction_um
-10,0,0
0,0,-1.5
25.4,0,0.000001
-10,5,2
0,5,0
25.4,5,-0.25
"""
X, Y = [-10e-3, 0.0, 25.4e-3], [0.0, 5e-3]
VALUES = [[0.0, -1.5e-6, 1e-12], [2e-6, 0.0, -0.25e-6]]


def hand_map():
    return CompensationMap(X, Y, VALUES)


def bumps(x, y):
    """+3 um at (12, 40) mm and -1 um at (20, 10) mm: neither mirror nor exchange keeps it."""
    return 3e-6 * np.exp(-(((x - 12e-3) / 8e-3) ** 2 + ((y - 40e-3) / 6e-3) ** 2)) - 1e-6 * np.exp(
        -(((x - 20e-3) / 6e-3) ** 2 + ((y - 10e-3) / 9e-3) ** 2)
    )


def test_hand_written_file_is_written_byte_for_byte():
    assert NeutralMap().encode(hand_map()).data.decode() == HAND


def test_hand_written_file_is_read():
    found = NeutralMap().decode(HAND.encode(), NOWHERE)

    assert found.x.tolist() == X
    assert found.y.tolist() == Y
    assert found.values.tolist() == VALUES
    assert found.axes == ("X", "Y")
    assert found.compensates == "Z"


def test_entry_is_the_correction_and_not_the_error():
    """Applied by hand: nodes of the file added to the error at its nodes leave nothing."""
    x, y = np.linspace(0, 30e-3, 7), np.linspace(0, 60e-3, 9)
    made = NeutralMap().encode(CompensationMap.from_error(bumps, x=x, y=y))

    left, wrong = [], []
    for row in csv.DictReader(made.data.decode().splitlines()):
        e = bumps(float(row["x_mm"]) * 1e-3, float(row["y_mm"]) * 1e-3) - bumps(0.0, 0.0)
        c = float(row["correction_um"]) * 1e-6
        left.append(e + c)
        wrong.append(e - c)
    assert np.abs(left).max() < 1e-18
    assert np.ptp(wrong) > 5e-6


def test_axis_that_turns_is_in_rad():
    angles = [0.0, math.pi / 3, 2 * math.pi]
    made = NeutralMap().encode(
        CompensationMap([0.0, 1e-3], angles, np.zeros((3, 2)), ("X", "C"), "Z")
    )

    assert made.data.startswith(b"x_mm,c_rad,correction_um\n0,0,0\n1,0,0\n0,1.0471975511965976,")
    of_old = made.data.replace(b"c_rad", b"y_rad")
    for data in (made.data, of_old):
        found = NeutralMap().decode(data, NOWHERE)
        assert found.y.tolist() == angles
        assert found.axes == ("X", "C")


def test_columns_are_called_after_the_axes(tmp_path):
    path = tmp_path / "m.csv"
    table = CompensationMap([-0.5, 0.0, 0.5], [0.0, 1.0], VALUES, ("A", "C"), "X")

    controllers.write(table, path, "csv-map", allow_unverified=True)

    assert path.read_text().startswith("a_rad,c_rad,correction_um\n-0.5,0,0\n0,0,-1.5\n")
    assert controllers.read(path, "csv-map").axes == ("A", "C")
    sidecar_path(path).unlink()
    assert controllers.read(path, "csv-map").axes == ("A", "C")
    path.write_text(path.read_text().replace("a_rad,c_rad", "c_rad,a_rad"))
    assert controllers.read(path, "csv-map").axes == ("C", "A")
    sidecar_path(path).write_text('{"table": {"axes": ["A", "C"]}}')
    with pytest.raises(CorruptFileError, match="columns are of C and A, its sidecar says A and C"):
        controllers.read(path, "csv-map")


@pytest.mark.parametrize("header", ["a_mm,c_rad", "x_rad,b_rad", "x_mm,z_rad"])
def test_an_axis_in_the_unit_of_another_kind_is_refused(header):
    with pytest.raises(CorruptFileError, match="an axis that turns is in rad"):
        NeutralMap().decode(HAND.replace("x_mm,y_mm", header).encode(), NOWHERE)


def test_axes_whose_names_make_no_columns_are_in_the_sidecar(tmp_path):
    axes = ("joint 0", "joint 1")
    path = tmp_path / "joints.csv"
    controllers.write(CompensationMap(X, Y, VALUES, axes), path, "csv-map", allow_unverified=True)
    assert path.read_text() == HAND
    assert controllers.read(path, "csv-map").axes == axes


def test_y_before_x_is_in_the_names_of_the_columns(tmp_path):
    """What other programs read: the first column is Y; without its sidecar the map is the same."""
    path = tmp_path / "yx.csv"
    made = CompensationMap(X, Y, VALUES, ("Y", "X"))
    controllers.write(made, path, "csv-map", allow_unverified=True)
    assert path.read_text() == HAND.replace("x_mm,y_mm", "y_mm,x_mm")
    for _ in range(2):
        back = controllers.read(path, "csv-map")
        assert back.axes == ("Y", "X")
        np.testing.assert_array_equal(back.values, VALUES)
        path.with_name("yx.csv.json").unlink(missing_ok=True)
    old = tmp_path / "old.csv"  # as metrosep wrote it before: the sidecar names the axes
    controllers.write(made, old, "csv-map", allow_unverified=True)
    beside = old.with_name("old.csv.json")
    hashed = hashlib.sha256(old.read_bytes()).hexdigest()
    old.write_text(HAND)
    new = hashlib.sha256(old.read_bytes()).hexdigest()
    beside.write_text(beside.read_text().replace(hashed, new))
    assert controllers.read(old, "csv-map").axes == ("Y", "X")
    controllers.write(made, path, "csv-map", allow_unverified=True, overwrite=True)
    beside = path.with_name("yx.csv.json")  # that does not agree with the exchanged columns
    text = beside.read_text()
    beside.write_text(text.replace('"Y"', '"Q"').replace('"X"', '"Y"').replace('"Q"', '"X"'))
    with pytest.raises(ReadError, match="columns are of Y and X, its sidecar says X and Y"):
        controllers.read(path, "csv-map")


@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.integers(2, 9),
    m=st.integers(2, 9),
    size=st.floats(1e-12, 1e-3),
)
@settings(derandomize=True, deadline=None, max_examples=50)
def test_round_trip_is_exact(seed, n, m, size):
    rng = np.random.default_rng(seed)
    x = rng.uniform(-1, 1) + np.cumsum(rng.uniform(1e-6, 1e-1, n))
    y = rng.uniform(-1, 1) + np.cumsum(rng.uniform(1e-6, 1e-1, m))
    table = CompensationMap(x, y, size * rng.uniform(-1, 1, (m, n)))
    data = NeutralMap().encode(table).data

    back = NeutralMap().decode(data, NOWHERE)

    assert np.array_equal(back.x, table.x)
    assert np.array_equal(back.y, table.y)
    assert np.array_equal(back.values, table.values)
    lookup = NeutralMap().lookup(data, NOWHERE)
    px, py = rng.uniform(-3, 3, (2, 50))
    assert np.array_equal(lookup(px, py), table.correction(px, py))
    assert np.array_equal(lookup(px, py, -1), table.correction(px, py))


def test_sidecar_tells_axes_and_reference(tmp_path):
    path = tmp_path / "m.csv"
    table = CompensationMap(X, Y, VALUES, ("U", "V"), "W", (0.0, 5e-3), removed="plane")

    controllers.write(table, path, "csv-map", allow_unverified=True)

    found = controllers.read(path, "csv-map")
    assert (found.axes, found.compensates) == (("U", "V"), "W")
    assert (found.reference, found.removed) == ((0.0, 5e-3), "plane")
    assert controllers.simulate(path, "csv-map")(0.0, 0.0) == -1.5e-6


def test_sidecar_of_something_else_is_refused(tmp_path):
    path = tmp_path / "m.csv"
    path.write_text(HAND)
    for text in ('{"table": {"axes": "XY"}}', '{"table": [1]}', '{"table": {"axes": ["C", "Y"]}}'):
        sidecar_path(path).write_text(text)
        with pytest.raises(CorruptFileError, match="sidecar"):
            controllers.read(path, "csv-map")


def test_a_table_over_one_axis_is_refused(tmp_path, table):
    with pytest.raises(TableError, match="CompensationMap"):
        controllers.write(table, tmp_path / "m.csv", "csv-map", allow_unverified=True)


@pytest.mark.parametrize("gone", range(7))
def test_file_without_a_line_is_refused(gone):
    lines = HAND.splitlines()
    del lines[gone]

    with pytest.raises(CorruptFileError):
        NeutralMap().decode("\n".join(lines).encode(), NOWHERE)


def test_falling_positions_are_refused():
    with pytest.raises(CorruptFileError, match="y does not rise"):
        NeutralMap().decode(HAND.replace(",5,", ",-5,").encode(), NOWHERE)


def test_binary_and_latin_text_are_refused():
    with pytest.raises(CorruptFileError, match=r"not UTF-8 text|not CSV text"):
        NeutralMap().decode(b"\xff\xfe\x00x", NOWHERE)


def test_sign_is_by_definition():
    assert NeutralMap.info.sign == "confirmed"
    assert "c = -e" in NeutralMap.info.entry


def test_corrected_axis_that_turns_is_in_urad(tmp_path):
    made = CompensationMap(X, Y, VALUES, compensates="C")
    path = tmp_path / "m.csv"

    controllers.write(made, path, "csv-map", allow_unverified=True)

    assert path.read_text() == HAND.replace("correction_um", "correction_urad")
    assert controllers.read(path, "csv-map").compensates == "C"
    sidecar = sidecar_path(path)
    sidecar.write_text(sidecar.read_text().replace('"compensates": "C"', '"compensates": "Z"'))
    with pytest.raises(CorruptFileError, match="does not turn"):
        controllers.read(path, "csv-map")
    sidecar.unlink()
    alone = controllers.read(path, "csv-map")
    assert alone.compensates == "C"
    assert alone.values.tolist() == VALUES


def test_file_of_old_with_a_corrected_axis_that_turns_reads_as_it_was_written(tmp_path):
    path = tmp_path / "m.csv"
    path.write_text(HAND)
    sidecar_path(path).write_text('{"table": {"axes": ["X", "Y"], "compensates": "C"}}')

    found = controllers.read(path, "csv-map")

    assert (found.compensates, found.values.tolist()) == ("C", VALUES)


class TestNeutralMap(DialectContract):
    name = "csv-map"
    hand = HAND
    damage = (
        ("x_mm", "x_um"),
        ("correction_um", "error_um"),
        ("0,0,-1.5", "0,0,nan"),
        ("0,0,-1.5", "0,0,1_5"),
        ("0,0,-1.5", "0,0,-1,5"),
        ("0,0,-1.5", "0,0"),
        ("0,0,-1.5", "0,0,1e999"),
        ("0,0,-1.5", "0,0,\u0661"),
        ("25.4,5,-0.25\n", "25.4,5,-0.25"),
        ("25.4,5,-0.25\n", "25.4,5,-0.2"),
        ("0,0,-1.5", "0,0.1,-1.5"),
        ("0,0,-1.5", "-10,0,-1.5"),
        ("25.4,5", "25.5,5"),
        ("25.4,5,-0.25\n", "25.4,5,-0.25\n25.4,5,-0.25\n"),
        ("correction_um", "correction_µm"),
    )

    def may_be_cut(self, text):
        """Whole rows of the grid: a smaller map, which only the sidecar knows."""
        return text.endswith("\n")
