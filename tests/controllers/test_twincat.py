"""TwinCAT ST table: a hand-written list, a small ST reader of its own, what is refused."""

import re
from pathlib import Path

import numpy as np
import pytest
from contracts.dialect import DialectContract
from hypothesis import given, settings, strategies as st

from metrosep import controllers
from metrosep.compensation import CompensationTable
from metrosep.controllers.options import checked_options
from metrosep.controllers.twincat import TwinCAT
from metrosep.errors import (
    CorruptFileError,
    DataError,
    LimitError,
    TableError,
    WriteError,
)

ROUNDING = 1e-15
"""Millimetres to metres in double."""
QUANTUM = 0.5e-12
"""Half of the ninth decimal of a mm."""

HAND = """\
(* metrosep: correction -e in mm, additive to the set position *)
VAR_GLOBAL
  CompTable : ARRAY[1..3] OF ST_PositionCompensationTableElement := [
    (Position := -10.000000000, Compensation := 0.001500000),
    (Position := 0.000000000, Compensation := 0.000000000),
    (Position := 10.000000000, Compensation := -0.002000000)
  ];
  CompTableParameter : ST_PositionCompensationTableParameter := (MinPosition := -10.000000000, \
MaxPosition := 10.000000000, NoOfTableElements := 3);
END_VAR
"""
"""Axis that is 2 um too far at +10 mm and 1.5 um short at -10 mm."""


def encode(table, **given):
    return TwinCAT().encode(table, **checked_options(given, TwinCAT.options, "twincat"))


def decode(data, **given):
    return TwinCAT().decode(data, Path("absent.txt"), **given)


def motor(text, position_mm):
    """Set position with the compensation added (mm), from the elements as any ST reader sees them."""
    body = re.sub(r"\(\*.*?\*\)", "", text, flags=re.DOTALL)
    elements = re.findall(r"Position\s*:=\s*(\S+?),\s*Compensation\s*:=\s*(\S+?)\)", body)
    size = int(re.search(r"ARRAY\[1\.\.(\d+)\]", body)[1])
    low, high, n = re.search(
        r"MinPosition := (\S+), MaxPosition := (\S+), NoOfTableElements := (\d+)", body
    ).groups()
    assert size == int(n) == len(elements)
    step = (float(high) - float(low)) / (size - 1)
    at = min(max((position_mm - float(low)) / step, 0.0), size - 1.0)
    i = min(int(at), size - 2)
    a, b = float(elements[i][1]), float(elements[i + 1][1])
    return position_mm + a + (at - i) * (b - a)


@pytest.fixture
def one_way(measured):
    return CompensationTable.from_error(
        measured, positions=101, axis="X", source_sha256=("ab" * 32,)
    )


def test_hand_written_list_byte_for_byte():
    table = CompensationTable([-10e-3, 0, 10e-3], [1.5e-6, 0, -2e-6], None, "X", "X", 0.0)

    assert encode(table).data.decode() == HAND


def test_hand_written_list_reads_as_corrections():
    table = decode(HAND.encode())

    np.testing.assert_allclose(table.positions, [-10e-3, 0, 10e-3], atol=0, rtol=1e-15)
    np.testing.assert_allclose(table.forward, [1.5e-6, 0, -2e-6], atol=ROUNDING, rtol=0)


def test_carriage_returns_blanks_and_comments_are_taken():
    text = HAND.replace("\n", "\r\n").replace("  ];", "\r\n  (* end of elements *)\r\n];")

    assert decode(text.encode()).positions.size == 3


@pytest.mark.parametrize(
    ("mm", "um"), [(-99, 1.5), (-5, 0.75), (0, 0), (5, -1), (10, -2), (50, -2)]
)
def test_lookup(tmp_path, mm, um):
    path = tmp_path / "x.txt"
    path.write_text(HAND)

    for direction in (1, -1):
        seen = controllers.simulate(path, "twincat")(mm * 1e-3, direction)
        assert seen == pytest.approx(um * 1e-6, abs=ROUNDING)
    assert motor(HAND, mm) == pytest.approx(mm + um * 1e-3, abs=1e-12)


@given(
    n=st.integers(2, 40),
    start=st.floats(-0.5, 0.5),
    step=st.floats(1e-5, 1e-2),
    seed=st.integers(0, 2**32 - 1),
    size=st.floats(1e-12, 1e-4),
)
@settings(derandomize=True, deadline=None, max_examples=60)
def test_round_trip_is_within_the_quantisation(n, start, step, seed, size):
    rng = np.random.default_rng(seed)
    x = start + step * np.arange(n)
    table = CompensationTable(x, size * rng.uniform(-1, 1, n), None, "X", "X", start)

    encoded = encode(table)

    assert encoded.quantisation <= QUANTUM * 1.001
    text = encoded.data.decode()
    assert "e" not in re.sub("[^-+0-9.e]", "", "".join(re.findall(r":= \S+", text)))
    at = rng.uniform(x[0] - step, x[-1] + step, 30)
    seen = np.array([motor(text, p * 1e3) - p * 1e3 for p in at]) * 1e-3
    slope = 2 * size / step * 2e-12  # positions are rounded too
    np.testing.assert_allclose(
        seen, table.correction(at), atol=QUANTUM * 1.001 + slope + 1e-15, rtol=0
    )
    np.testing.assert_allclose(
        decode(encoded.data).correction(at),
        table.correction(at),
        atol=QUANTUM * 1.001 + slope,
        rtol=0,
    )


def test_planted_error_shrinks_and_the_negated_table_doubles_it(bump, one_way):
    x = np.linspace(0, 50, 401)
    left = {}
    for name, table in (("right", one_way), ("wrong", one_way.negated())):
        text = encode(table).data.decode()
        at = np.array([motor(text, p) for p in x]) * 1e-3
        left[name] = np.ptp(at + bump(at) - x * 1e-3)

    before = np.ptp(bump(x * 1e-3))
    assert left["right"] < 0.06 * before  # chords of 0.5 mm over bumps 2 and 3 mm wide
    assert left["wrong"] > 1.9 * before


def test_write_read(tmp_path, one_way, measured):
    path = tmp_path / "x.TcGVL.txt"

    done = controllers.write(one_way, path, "twincat", verified_against=measured)

    assert done.after_pv < 0.02 * done.before_pv
    back = controllers.read(path, "twincat")
    assert np.abs(back.forward - one_way.forward).max() <= QUANTUM * 1.001
    assert back.axis == "X"
    with pytest.raises(WriteError, match="exists already"):
        controllers.write(one_way, path, "twincat")


def test_table_shorter_than_the_travel_is_refused(tmp_path, one_way):
    with pytest.raises(LimitError, match="corrections cover"):
        controllers.write(one_way, tmp_path / "x.txt", "twincat", travel_high="60 mm")


def test_two_directions_are_refused(table):
    with pytest.raises(TableError, match="direction='both'"):
        encode(table)


@pytest.mark.parametrize(
    "name", ["1st", "a b", "a;", "\u00e4x", "x" * 61, "END_VAR", "if", "a__b", "Table_"]
)
def test_name_that_is_no_identifier_is_refused(name):
    table = CompensationTable([0.0, 1e-3], [0, 0], None, "X", "X", 0.0)

    with pytest.raises((TableError, DataError)):
        encode(table, name=name)


def test_name_is_written_and_checked():
    table = CompensationTable([0.0, 1e-3], [0, 0], None, "X", "X", 0.0)

    data = encode(table, name="AxisX").data

    assert decode(data, name="AxisX").positions.size == 2
    with pytest.raises(CorruptFileError, match="another variable"):
        decode(data, name="AxisY")


def test_uneven_positions_are_resampled_and_the_cost_is_told():
    x = np.array([0.0, 1.0, 4.0]) * 1e-3
    table = CompensationTable(x, [0, 1e-6, 0], None, "X", "X", 0.0)

    encoded = encode(table, interval="2 mm")

    assert encoded.resampling_error == pytest.approx(1e-6 - 1e-6 / 3, abs=ROUNDING)
    fine = encode(table)
    assert (fine.carried.positions.size, fine.resampling_error) == (5, 0.0)


def test_positions_below_the_last_decimal_are_refused():
    close = CompensationTable([0.0, 1e-13, 2e-13], [0, 0, 0], None, "X", "X", 0.0)

    with pytest.raises(TableError, match="closer than"):
        encode(close)


def test_spacing_in_the_wrong_unit_is_refused(one_way):
    with pytest.raises(LimitError, match="takes 100000"):
        encode(one_way, interval=1e-8)


def test_binary_is_refused():
    for content in (b"\x89PNG\r\n\x1a\n", b"\xff\xfe0\x00", b"\x00" * 40 + b"\n"):
        with pytest.raises(CorruptFileError):
            decode(content)


def test_table_of_another_axis_is_refused(tmp_path):
    """The function block takes one Axis: X -> Z would shift X by what Z needs."""
    cross = CompensationTable([0.0, 1e-3], [0, 1e-6], None, "X", "Z", 0.0)

    with pytest.raises(TableError, match=r"X -> Z.*would move X instead of Z.*'isg-cross'"):
        encode(cross)
    path = tmp_path / "x.txt"
    path.write_text(HAND)
    path.with_name("x.txt.json").write_text('{"table": {"axis": "X", "compensates": "Z"}}')
    with pytest.raises(CorruptFileError, match="X -> Z"):
        controllers.read(path, "twincat")


def test_interval_beyond_the_table_is_refused():
    table = CompensationTable([0.0, 1e-3, 2e-3], [0, 1e-6, 0], None, "X", "X", 0.0)

    for interval in (3e-3, 10.0):
        with pytest.raises(LimitError, match=r"larger than the table, which spans 2 mm.*units"):
            encode(table, interval=interval)
    with pytest.raises(DataError, match="interval"):
        encode(table, interval="60000 m")


@pytest.mark.parametrize(("x", "c"), [(1e6, 1e-6), (1e-3, 1e6), (1e-3, 1e300)])
def test_numbers_that_no_line_holds_are_refused_with_their_entry(x, c):
    with pytest.raises(LimitError, match=r"of entry 1 exceeds") as caught:
        encode(CompensationTable([0.0, x], [0, c], None, "X", "X", 0.0))
    assert len(str(caught.value)) < 200


class TestTwinCAT(DialectContract):
    name = "twincat"
    hand = HAND
    kept = (0,)
    lines = (
        "",
        "hello",
        "(Position := 5.0, Compensation := nan)",
        "(Position := 5.0, Compensation := 1e-3),",
        "(Position := 3.000000000, Compensation := 0.000000000),",
    )
    damage = (
        ("ARRAY[1..3]", "ARRAY[1..4]"),
        ("NoOfTableElements := 3", "NoOfTableElements := 2"),
        ("MinPosition := -10", "MinPosition := -11"),
        ("MaxPosition := 10", "MaxPosition := 11"),
        ("0.000000000),", "0.000000000)"),
        ("-0.002000000)", "-0.002000000),"),
        ("Position := -10", "Position := 10"),
        ("0.001500000", "0,001500000"),
    )


def test_parameters_of_the_other_direction_are_refused():
    """The direction stands in them: exchanged they turn forward and reverse."""
    p, c = [-10e-3, 0.0, 10e-3], np.array([1.5e-6, 0.0, -2e-6])
    table = CompensationTable(p, c, 2.0 * c, "X", "X", 0.0)
    text = encode(table, bidirectional=True).data.decode("ascii")
    decode(text.encode("ascii"))
    swapped = re.sub(
        r"CompTable(Reverse)?Parameter",
        lambda m: "CompTableParameter" if m[1] else "CompTableReverseParameter",
        text,
    )
    with pytest.raises(CorruptFileError, match="its own parameters"):
        decode(swapped.encode("ascii"))
