"""Neutral CSV: exact round trip, its header, and what is refused."""

import csv
import json
import math
from pathlib import Path

import numpy as np
import pytest
from contracts.dialect import DialectContract
from hypothesis import given, settings, strategies as st

from metrosep import controllers
from metrosep.compensation import CompensationTable
from metrosep.controllers.neutral import Neutral
from metrosep.errors import CorruptFileError, ReadError


def test_units_and_sign_are_those_of_the_header(tmp_path):
    path = tmp_path / "x.csv"
    path.write_text(
        "position_mm,correction_forward_um,correction_reverse_um\n0,0,-0.5\n10,-2,-2.5\n"
    )

    table = controllers.read(path, "csv")

    np.testing.assert_array_equal(table.positions, [0.0, 10e-3])
    np.testing.assert_array_equal(table.forward, [0.0, -2e-6])
    np.testing.assert_array_equal(table.reverse, [-0.5e-6, -2.5e-6])


def test_what_is_written_is_read_by_plain_csv(tmp_path):
    table = CompensationTable([0.0, 7e-3], [0.0, -2.5e-6], None, "X", "Z", 0.0)
    path = tmp_path / "x.csv"

    controllers.write(table, path, "csv", allow_unverified=True)

    with path.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [float(r["position_mm"]) for r in rows] == [0.0, 7.0]
    assert [float(r["correction_forward_um"]) for r in rows] == [0.0, -2.5]
    assert "correction_reverse_um" not in rows[0]


@given(
    start=st.floats(-1.0, 1.0),
    steps=st.lists(st.floats(1e-9, 0.1), min_size=1, max_size=40),
    seed=st.integers(0, 2**32 - 1),
    size=st.floats(1e-12, 1e-3),
    split=st.booleans(),
)
@settings(derandomize=True, deadline=None, max_examples=60)
def test_round_trip_is_exact(start, steps, seed, size, split):
    rng = np.random.default_rng(seed)
    p = start + np.concatenate([[0.0], np.cumsum(steps)])
    c, r = size * rng.uniform(-1, 1, (2, p.size))
    table = CompensationTable(p, c, r if split else None, "X", "Z", float(p[0]))

    encoded = Neutral().encode(table)
    back = Neutral().decode(encoded.data, Path("x.csv"))

    assert encoded.quantisation == 0.0
    np.testing.assert_array_equal(back.positions, table.positions)
    np.testing.assert_array_equal(back.forward, table.forward)
    if split:
        np.testing.assert_array_equal(back.reverse, table.reverse)
    else:
        assert back.reverse is None


def test_axes_and_reference_come_back_from_the_sidecar(tmp_path):
    table = CompensationTable([0.0, 7e-3, 9e-3], [-1e-6, 0.0, 2e-6], None, "Y", "Z", 7e-3)

    controllers.write(table, tmp_path / "x.csv", "csv", allow_unverified=True)

    back = controllers.read(tmp_path / "x.csv", "csv")
    assert (back.axis, back.compensates, back.reference) == ("Y", "Z", 7e-3)


def test_many_points_fit(tmp_path):
    p = np.linspace(0.0, 1.0, 5001)
    table = CompensationTable(p, 1e-6 * np.sin(40 * p), None, "X", "X", 0.0)

    controllers.write(table, tmp_path / "x.csv", "csv", allow_unverified=True)

    np.testing.assert_array_equal(
        controllers.simulate(tmp_path / "x.csv", "csv")(p, 1), table.forward
    )


HEADER = "position_mm,correction_forward_um\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (HEADER + "0,0\n1,2.5", "last line has no end"),
        (HEADER + "0,0\n1,\u0661\n", "line 3"),
        (HEADER + "0,0\n1,\uff11\n", "line 3"),
        (HEADER + "0,0\n1,0x1\n", "line 3"),
        ("0,0\n1,1\n", "not a neutral table.*position_mm"),
        ("position,correction\n0,0\n1,1\n", "not a neutral table"),
        ("position_in,correction_forward_um\n0,0\n1,1\n", "not a neutral table"),
        (HEADER, "at least 2 lines"),
        (HEADER + "0,0\n", "at least 2 lines"),
        (HEADER + "0,0\n1\n", "line 3 does not hold 2 finite numbers but '1'"),
        (HEADER + "0,0\n1,2,3\n", "line 3 does not hold 2"),
        (HEADER + "0,0\n1,\n", "line 3"),
        (HEADER + "0,0\n1,nan\n", "line 3"),
        (HEADER + "0,0\n1,1_0\n", "line 3"),
        (HEADER + "0,0\n1,-inf\n", "line 3"),
        (HEADER + "0;0\n1;1\n", "line 2"),
        (HEADER + "0,0\n\n1,abc\n", "line 4"),
        (HEADER + "0,0\n2,1\n1,1\n", "line 4: position_mm does not rise"),
        (HEADER + "0,0\n\n2,1\n2,1\n", "line 5: position_mm does not rise"),
    ],
)
def test_damaged_files_are_refused_with_their_line(tmp_path, text, message):
    path = tmp_path / "x.csv"
    path.write_text(text, encoding="utf-8")

    with pytest.raises(CorruptFileError, match=message) as caught:
        controllers.read(path, "csv")
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_binary_is_refused(tmp_path):
    path = tmp_path / "x.csv"
    path.write_bytes(b"\x89PNG\r\n\x1a\n\xff\x00")

    with pytest.raises(CorruptFileError):
        controllers.read(path, "csv")


def test_empty_file_is_refused(tmp_path):
    path = tmp_path / "x.csv"
    path.write_bytes(b"")

    with pytest.raises(ReadError, match="is empty"):
        controllers.read(path, "csv")


def test_byte_order_mark_and_spaces_are_accepted(tmp_path):
    path = tmp_path / "x.csv"
    path.write_bytes("\ufeffposition_mm, correction_forward_um\r\n0, 0\r\n1, 2\r\n".encode())

    np.testing.assert_array_equal(controllers.read(path, "csv").forward, [0.0, 2e-6])


@pytest.mark.parametrize(
    ("axes", "header"),
    [
        (("C", "Z"), "position_rad,correction_forward_um,correction_reverse_um"),
        (("C", "C"), "position_rad,correction_forward_urad,correction_reverse_urad"),
        (("X", "C"), "position_mm,correction_forward_urad,correction_reverse_urad"),
        (("X", "Z"), "position_mm,correction_forward_um,correction_reverse_um"),
    ],
)
def test_columns_of_axes_that_turn_are_angles(tmp_path, axes, header):
    """90 degrees and 2 urad at C, not 1570.8 mm and 2 um."""
    at = [0.0, math.pi / 2, 3.0] if axes[0] == "C" else [0.0, 7e-3, 9e-3]
    table = CompensationTable(at, [0.0, 2e-6, -1e-6], [1e-7, 2e-6, 0.0], *axes, 0.0)
    path = tmp_path / "x.csv"

    controllers.write(table, path, "csv", allow_unverified=True)

    with path.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert ",".join(rows[0]) == header
    names = header.split(",")
    assert float(rows[1][names[0]]) == (math.pi / 2 if axes[0] == "C" else 7.0)
    assert float(rows[1][names[1]]) == 2.0
    back = controllers.read(path, "csv")
    np.testing.assert_array_equal(back.positions, table.positions)
    np.testing.assert_array_equal(back.forward, table.forward)
    np.testing.assert_array_equal(back.reverse, table.reverse)
    assert (back.axis, back.compensates) == axes
    path.with_name("x.csv.json").unlink()
    alone = controllers.read(path, "csv")
    assert (alone.axis, alone.compensates) == (("X", "X") if axes == ("X", "Z") else axes)


def test_file_of_old_with_an_axis_that_turns_reads_as_it_was_written(tmp_path):
    """Before, rad were printed times 1000 under position_mm: the same number comes back."""
    path = tmp_path / "x.csv"
    path.write_text("position_mm,correction_forward_um\n0,0\n1570.5,-2\n")
    table = {"axis": "C", "compensates": "C", "reference_m": 0.0}
    path.with_name("x.csv.json").write_text(json.dumps({"table": table}))

    back = controllers.read(path, "csv")

    assert (back.axis, back.positions[1], back.forward[1]) == ("C", 1.5705, -2e-6)


@pytest.mark.parametrize(
    "header", ["position_rad,correction_forward_um", "position_mm,correction_forward_urad"]
)
def test_sidecar_of_axes_that_do_not_turn_is_refused(tmp_path, header):
    path = tmp_path / "x.csv"
    path.write_text(header + "\n0,0\n1,-2\n")
    path.with_name("x.csv.json").write_text('{"table": {"axis": "X", "compensates": "Z"}}')

    with pytest.raises(CorruptFileError, match="does not turn"):
        controllers.read(path, "csv")


class TestNeutral(DialectContract):
    name = "csv"
