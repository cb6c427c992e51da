"""Mitsubishi increments: the manual's two formulas walked by hand, drift, range, what is refused."""

from pathlib import Path

import numpy as np
import pytest
from contracts.dialect import DialectContract
from hypothesis import given, settings, strategies as st

from metrosep import controllers
from metrosep.compensation import CompensationTable
from metrosep.controllers.mitsubishi import Mitsubishi
from metrosep.controllers.options import checked_options
from metrosep.errors import (
    CorruptFileError,
    DataError,
    LimitError,
    TableError,
    WriteError,
)

ROUNDING = 1e-15
"""Sums of 128 doubles of 10 um."""

HAND = """\
; MITSUBISHI MACHINE ERROR COMPENSATION, INCREMENTAL, OUTPUT UNIT 0.001 MM, REFERENCE 0 MM, MADE BY METROSEP
#4001 X
#4002 X
#4003 4102
#4004 4101
#4005 4104
#4006 1
#4007 10
#4101 4
#4102 -6
#4103 -4
#4104 2
; END
"""
TRAVEL_MM = {10: 10.002, 20: 20.001, -10: -10.003, -20: -20.001}
"""Where the axis really is; entries of HAND worked out from these with the manual's formulas:
+10: (10 - 10.002) x 2 = -0.004; +20: (10 - 9.999) x 2 = +0.002;
-10: (10 + (-10.003)) x 2 = -0.006; -20: (10 + (-9.998)) x 2 = +0.004."""


def encode(table, **given):
    known = checked_options({"output_unit": 1e-6, **given}, Mitsubishi.options, "mitsubishi")
    return Mitsubishi().encode(table, **known)


def decode(data, **given):
    return Mitsubishi().decode(data, Path("absent.txt"), **given)


def real_travel(data, *, unit_um):
    """Walk outward from the reference and undo the manual's formulas: e (um) at each point (mm)."""
    word = dict(line[1:].split() for line in data.decode().splitlines() if line[0] == "#")
    base = min(int(n) for n in word) - 1
    ref, first, last, scale = (int(word[str(base + i)]) for i in (3, 4, 5, 6))
    step_um = float(word[str(base + 7)]) * 1e3
    error = {0.0: 0.0}
    here = 0.0
    for k in range(1, last - ref + 1):
        travel = step_um - int(word[str(ref + k)]) * scale * unit_um / 2
        here += travel - step_um
        error[k * step_um / 1e3] = here
    here = 0.0
    for k in range(1, ref - first + 2):
        travel = int(word[str(ref + 1 - k)]) * scale * unit_um / 2 - step_um
        here += travel + step_um
        error[-k * step_um / 1e3] = here
    places = sorted(error)
    return np.array(places), np.array([error[p] for p in places])


def error_table():
    x = np.array([-20, -10, 0, 10, 20]) * 1e-3
    e = np.array([TRAVEL_MM.get(round(p * 1e3), 0.0) - p * 1e3 for p in x]) * 1e-3
    e[2] = 0.0
    return CompensationTable(x, -e, None, "X", "X", 0.0)


@pytest.fixture
def one_way(measured):
    return CompensationTable.from_error(
        measured, positions=np.arange(0, 51) * 1e-3, axis="X", source_sha256=("ab" * 32,)
    )


def test_manual_formulas_by_hand_byte_for_byte():
    assert encode(error_table()).data.decode() == HAND


def test_lists_of_earlier_versions_are_read():
    old = HAND.replace(", MADE BY METROSEP", "")
    assert old != HAND
    assert np.array_equal(decode(old.encode()).forward, decode(HAND.encode()).forward)


def test_hand_made_list_reads_as_corrections():
    table = decode(HAND.encode())

    np.testing.assert_allclose(
        table.positions, np.array([-20, -10, 0, 10, 20]) * 1e-3, atol=1e-15, rtol=0
    )
    np.testing.assert_allclose(
        table.forward, np.array([1, 3, 0, -2, -1]) * 1e-6, atol=ROUNDING, rtol=0
    )


def test_walk_of_the_manual_finds_the_travel_again():
    places, error = real_travel(HAND.encode(), unit_um=1.0)

    np.testing.assert_allclose(places, [-20, -10, 0, 10, 20], atol=0, rtol=0)
    np.testing.assert_allclose(error, [-1, -3, 0, 2, 1], atol=1e-9, rtol=0)


@pytest.mark.parametrize(("mm", "um"), [(-30, 1), (-15, 2), (5, -1), (20, -1), (99, -1)])
def test_lookup_is_linear_and_constant_outside(tmp_path, mm, um):
    path = tmp_path / "x.txt"
    path.write_text(HAND)

    seen = controllers.simulate(path, "mitsubishi")(mm * 1e-3)

    assert seen == pytest.approx(um * 1e-6, abs=ROUNDING)


@pytest.mark.parametrize("side", [1, -1])
def test_entries_of_less_than_half_a_step_do_not_drift(side):
    """128 sections of 0.4 of half an output unit."""
    x = np.sort(side * np.arange(129)) * 1e-3
    table = CompensationTable(
        x, 0.2e-6 * np.arange(129) - (25.6e-6 if side < 0 else 0), None, "X", "X", 0.0
    )

    back = decode(encode(table).data)

    assert np.abs(back.forward - table.forward).max() <= 0.25e-6 + ROUNDING
    far = back.forward[-1] if side > 0 else back.forward[0]
    assert far == pytest.approx(side * 25.5e-6, abs=ROUNDING)


@given(
    n=st.integers(2, 60),
    below=st.integers(0, 59),
    seed=st.integers(0, 2**32 - 1),
    unit=st.sampled_from([1e-8, 1e-7, 1e-6]),
    scale=st.integers(1, 3),
    set_number=st.integers(1, 10),
)
@settings(derandomize=True, deadline=None, max_examples=80)
def test_round_trip_is_within_the_quantisation(n, below, seed, unit, scale, set_number):
    rng = np.random.default_rng(seed)
    below = min(below, n - 1)
    x = np.arange(-below, n - below) * 2e-3
    c = np.cumsum(rng.uniform(-3, 3, n)) * unit
    table = CompensationTable(x, c - c[below], None, "X", "X", 0.0)

    encoded = encode(table, output_unit=unit, scale=scale, set_number=set_number)

    assert encoded.quantisation <= unit * scale / 4 + ROUNDING
    places, error = real_travel(encoded.data, unit_um=unit * 1e6)
    np.testing.assert_allclose(places, x * 1e3, atol=1e-9, rtol=0)
    margin = encoded.quantisation + ROUNDING
    np.testing.assert_allclose(-error * 1e-6, table.forward, atol=margin, rtol=0)
    np.testing.assert_allclose(decode(encoded.data).forward, table.forward, atol=margin, rtol=0)


def test_planted_error_shrinks_and_the_negated_table_doubles_it(bump, one_way):
    x = np.linspace(0, 50, 401)
    error = bump(x * 1e-3) - bump(0.0)
    left = {}
    for name, table in (("right", one_way), ("wrong", one_way.negated())):
        places, stated = real_travel(encode(table, output_unit=1e-7).data, unit_um=0.1)
        c = -np.interp(x, places, stated) * 1e-6
        left[name] = np.abs(bump(x * 1e-3 + c) - bump(0.0) + c).max()

    assert np.abs(error).max() > 2.9e-6
    assert left["right"] < 0.1e-6  # chords of 1 mm over a bump 3 mm wide: 84 nm
    assert left["wrong"] > 1.9 * np.abs(error).max()


def test_write_read(tmp_path, one_way, measured):
    path = tmp_path / "x.txt"

    done = controllers.write(
        one_way, path, "mitsubishi", verified_against=measured, output_unit="100 nm"
    )

    assert done.after_pv < 0.06 * done.before_pv
    assert done.wrong_sign_pv > 1.9 * done.before_pv
    back = controllers.read(path, "mitsubishi")
    assert np.abs(back.forward - one_way.forward).max() <= 0.25e-7 + ROUNDING
    with pytest.raises(WriteError, match="exists already"):
        controllers.write(one_way, path, "mitsubishi", output_unit="100 nm")


def test_output_unit_is_asked_for(tmp_path, one_way):
    with pytest.raises(DataError, match="output_unit"):
        controllers.write(one_way, tmp_path / "x.txt", "mitsubishi")


def test_two_directions_are_refused(table):
    with pytest.raises(TableError, match=r"direction='both'.*#2011"):
        encode(table)


def test_cross_axis_needs_a_word():
    cross = CompensationTable([0.0, 1e-3], [0, 1e-6], None, "X", "Z", 0.0)

    with pytest.raises(TableError, match=r"X -> Z.*cross_axis='tried'"):
        encode(cross)
    back = decode(encode(cross, cross_axis="tried").data)
    assert (back.axis, back.compensates) == ("X", "Z")


@pytest.mark.parametrize("name", ["x", "stage", "X1 2", "\u03b1"])
def test_axis_name_that_no_control_has_is_refused(name):
    with pytest.raises(TableError, match="not a Mitsubishi axis"):
        encode(CompensationTable([0.0, 1e-3], [0, 0], None, name, name, 0.0))


@pytest.mark.parametrize(
    ("um", "entry"), [(63.5, "#4101 127"), (-64.0, "#4101 -128"), (64.0, None), (-64.5, None)]
)
def test_range_of_an_increment(um, entry):
    table = CompensationTable([-1e-3, 0.0, 1e-3], [-um * 1e-6, 0, 0], None, "X", "X", 0.0)

    if entry:
        assert entry in encode(table).data.decode()
    else:
        with pytest.raises(LimitError, match=r"between -1 and 0 mm leaves -128 \.\.\. 127"):
            encode(table)


def test_correction_at_the_reference_is_refused():
    with pytest.raises(TableError, match="exactly 0"):
        encode(CompensationTable([0.0, 1e-3], [1e-6, 0.0], None, "X", "X", 0.0))


def test_numbers_beyond_the_ends_are_refused():
    for number in (4101, 5123):
        with pytest.raises(LimitError, match="reference_number"):
            encode(error_table(), reference_number=number)


def test_too_many_points_are_refused():
    x = np.arange(1026) * 1e-3

    with pytest.raises(LimitError, match=r"1026 points.*takes 1025"):
        encode(CompensationTable(x, np.zeros(1026), None, "X", "X", 0.0))


def test_list_without_facts_needs_them():
    bare = HAND.split("\n", 1)[1].encode()

    with pytest.raises(DataError, match="output_unit"):
        decode(bare)
    assert decode(bare, output_unit=1e-6, reference_position=0.0).forward[1] == pytest.approx(
        3e-6, abs=ROUNDING
    )
    with pytest.raises(CorruptFileError, match="another set"):
        decode(HAND.encode(), set_number=2)


def test_axis_that_turns_is_refused():
    with pytest.raises(TableError, match="axis A turns"):
        encode(CompensationTable([0.0, 1e-3], [0, 0], None, "A", "A", 0.0))


@pytest.mark.parametrize(
    "mm", [0.1, 0.2, 0.5, 1.1, 2.5, 3.5, 7, 10, 12.5, 14, 20, 25, 28, 30, 50, 0.007, 1.234]
)
def test_every_ordinary_interval_is_written(tmp_path, mm):
    """In double 14000 * 1e-6 * 1e3 is 14.000000000000002: the file says 14."""
    h = mm * 1e-3
    x = np.arange(-5, 20) * h
    table = CompensationTable(x, 1e-6 * np.sin(x / h / 3), None, "X", "X", 0.0)

    encoded = encode(table, output_unit=1e-7)

    assert f"#4007 {mm:g}\n" in encoded.data.decode()
    assert np.abs(decode(encoded.data).positions - x).max() < 1e-12


@pytest.mark.parametrize(
    "option",
    [
        {"output_unit": 1e-5},
        {"reference_position": 1e-3},
        {"scale": 2},
        {"reference_number": 4101},
    ],
)
def test_option_that_contradicts_the_file_is_refused(option):
    (name,) = option
    with pytest.raises(DataError, match=rf"the file says {name}=.*you say"):
        decode(HAND.encode(), **option)


def test_interval_beyond_the_table_is_refused():
    with pytest.raises(LimitError, match=r"larger than the table, which spans 40 mm"):
        encode(error_table(), interval=0.1)


@pytest.mark.parametrize(("x", "c"), [(1e5, 1e-6), (1e-3, 1e6), (1e-3, 1e300)])
def test_numbers_that_no_line_holds_are_refused_with_their_entry(x, c):
    with pytest.raises(LimitError, match=r"of entry 1 exceeds") as caught:
        encode(CompensationTable([0.0, x], [0, c], None, "X", "X", 0.0))
    assert len(str(caught.value)) < 200


def test_sidecar_of_other_axes_is_refused(tmp_path):
    path = tmp_path / "x.txt"
    path.write_text(HAND)
    path.with_name("x.txt.json").write_text('{"table": {"axis": "Y", "compensates": "Y"}}')

    with pytest.raises(DataError, match="the file says the axes="):
        controllers.read(path, "mitsubishi")


class TestMitsubishi(DialectContract):
    name = "mitsubishi"
    hand = HAND
    lines = (
        "",
        "#4001",
        "#4199 1",
        "#4102 1.5",
        "#4102 128",
        "; hi",
        "#4007 1e1",
        "4102 1",
    )
    damage = (
        ("#4006 1\n", "#4006 0\n"),
        ("#4007 10\n", "#4007 0\n"),
        ("#4007 10\n", "#4007 -1\n"),
        ("#4003 4102\n", "#4003 4105\n"),
        ("#4005 4104\n", "#4005 4103\n"),
        ("#4004 4101\n", "#4014 4101\n"),
        ("#4002 X\n", "#4002 xx\n"),
        ("#4101 4\n", "#4101 4\n#4101 4\n"),
    )
