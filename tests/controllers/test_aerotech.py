"""Aerotech 2-D .cal: a file written by hand, an interpreter of its own, signs of encoders."""

import re
from pathlib import Path

import numpy as np
import pytest
from contracts.dialect import DialectContract
from hypothesis import given, settings, strategies as st

from metrosep import controllers
from metrosep.compensation import CompensationTable
from metrosep.compensation.maps import CompensationMap
from metrosep.controllers.aerotech import Aerotech, AerotechLine
from metrosep.errors import (
    CorruptFileError,
    DataError,
    LimitError,
    TableError,
    UnsupportedFeatureError,
)

QUANTUM = 0.5e-10
"""Half of the fourth decimal of a micrometre."""
FLOAT = 1e-15
"""Rounding of micrometres in double, in m: far below."""
NOWHERE = Path("nowhere.cal")

HAND = """;       row col out1 out2 dRow  dCol  nCols
:START2D 2   1   1    2   5.000 5.000 3
:START2D OUTAXIS3=4 POSUNIT=METRIC CORUNIT=METRIC/1000 OFFSETROW=0.000 OFFSETCOL=10.000
0 0 0.0000    0 0 -0.3000   0 0 0.4000
0 0 0.0000    0 0 -0.3000   0 0 0.4000
:END
"""
"""Example of the controllers notes, section 3.3."""

UP = Aerotech.info.example


def options(**changes):
    return {**UP, **changes}


def interpreter(text):
    """Return what the controller adds to an output axis, all along encoders in mm; from the manual.

    The index along an axis is (encoder position + offset) / sample distance; bilinear between,
    nearest edge outside. No code of the library.
    """
    lines = [s for s in (r.split(";")[0].strip() for r in text.splitlines()) if s]
    assert lines[-1] == ":END"
    _, row, col, out1, out2, d_row, d_col, n = lines[0].split()
    assert lines[1].startswith(":START2D ")
    words = dict(w.split("=") for w in lines[1].split()[1:])
    assert words["POSUNIT"] == "METRIC"
    assert words["CORUNIT"] == "METRIC/1000"
    outputs = [int(out1), int(out2)] + ([int(words["OUTAXIS3"])] if "OUTAXIS3" in words else [])
    cells = np.array([[float(w) for w in s.split()] for s in lines[2:-1]])
    cells = cells.reshape(len(cells), int(n), len(outputs)) / 1000.0

    def added(q, axis):
        """q: encoder position of every axis by number."""
        i = np.clip((q[int(row)] + float(words["OFFSETROW"])) / float(d_row), 0, len(cells) - 1)
        j = np.clip((q[int(col)] + float(words["OFFSETCOL"])) / float(d_col), 0, int(n) - 1)
        i0, j0 = min(int(i), len(cells) - 2), min(int(j), int(n) - 2)
        a, b = i - i0, j - j0
        z = cells[:, :, outputs.index(axis)]
        return (1 - a) * ((1 - b) * z[i0, j0] + b * z[i0, j0 + 1]) + a * (
            (1 - b) * z[i0 + 1, j0] + b * z[i0 + 1, j0 + 1]
        )

    return added


@pytest.fixture(scope="module")
def bumps(bump):
    """Error of Z over X and Y that no mirroring, exchange or negation leaves as it is."""
    return lambda x, y: bump(x) * (1.0 + 20.0 * y)


@pytest.fixture(scope="module")
def area(bumps):
    x = np.linspace(2e-3, 42e-3, 41)
    y = np.linspace(-5e-3, 25e-3, 16)
    return CompensationMap.from_error(bumps, x=x, y=y, reference=(2e-3, -5e-3))


def test_hand_made_file_reads_as_corrections():
    back = Aerotech().decode(HAND.encode(), NOWHERE, corrected_sign=1)

    np.testing.assert_allclose(back.x, [-10e-3, -5e-3, 0.0], atol=1e-15, rtol=0)
    np.testing.assert_allclose(back.y, [0.0, 5e-3], atol=1e-15, rtol=0)
    np.testing.assert_allclose(back.values, [[0, -0.3e-6, 0.4e-6]] * 2, atol=FLOAT, rtol=0)


def test_the_same_file_is_written():
    made = CompensationMap([-10e-3, -5e-3, 0], [0, 5e-3], [[0, -0.3e-6, 0.4e-6]] * 2)

    data = Aerotech().encode(made, **UP).data

    assert data.decode().partition("\n")[2] == HAND  # its first line is metrosep's comment


@pytest.mark.parametrize("row", [1, -1])
@pytest.mark.parametrize("column", [1, -1])
@pytest.mark.parametrize("corrected", [1, -1])
def test_error_disappears_on_a_machine_with_these_encoders(area, bumps, row, column, corrected):
    encoded = Aerotech().encode(
        area, **options(row_sign=row, column_sign=column, corrected_sign=corrected)
    )
    added = interpreter(encoded.data.decode())
    after, before = [], []
    for px, py in [(5e-3, 1e-3), (12e-3, 7e-3), (20e-3, 20e-3), (33e-3, -5e-3), (41e-3, 3.1e-3)]:
        encoders = {1: column * px * 1e3, 2: row * py * 1e3}
        moved = corrected * added(encoders, 4) * 1e-3
        wanted = bumps(px, py) - bumps(2e-3, -5e-3)
        before.append(wanted)
        after.append(wanted + moved)

    assert np.abs(before).max() > 2.5e-6
    assert np.abs(after).max() < 0.1e-6  # 3 um bump of 3 mm half width on a 1 mm grid


def test_entry_is_minus_the_sign_times_the_error():
    """1 um too far at the first corner: the entry is -1, or +1 where the encoder counts down."""
    made = CompensationMap([0, 1e-3], [0, 1e-3], [[-1e-6, 0], [0, 0]])

    up = Aerotech().encode(made, **UP).data.decode()
    down = Aerotech().encode(made, **options(corrected_sign=-1)).data.decode()

    assert "\n0 0 -1.0000   0 0 0.0000\n" in up
    assert "\n0 0 1.0000    0 0 0.0000\n" in down


def test_encoder_signs_stand_in_distances_and_offsets():
    made = CompensationMap([3e-3, 4e-3], [7e-3, 9e-3], np.zeros((2, 2)))

    text = Aerotech().encode(made, **options(column_sign=-1)).data.decode()
    along_axis = Aerotech().encode(made, **options(column_sign=-1, offset_follows="axis"))

    assert ":START2D 2   1   1    2   2.000 -1.000 2\n" in text
    assert "OFFSETROW=-7.000 OFFSETCOL=3.000\n" in text
    assert "OFFSETROW=-7.000 OFFSETCOL=-3.000\n" in along_axis.data.decode()
    back = Aerotech().decode(along_axis.data, NOWHERE)
    np.testing.assert_allclose(back.x, made.x, atol=1e-15, rtol=0)


def test_a_negative_encoder_with_an_offset_is_warned_about():
    made = CompensationMap([3e-3, 4e-3], [7e-3, 9e-3], np.zeros((2, 2)))

    assert Aerotech().encode(made, **UP).findings == ()
    (finding,) = Aerotech().encode(made, **options(column_sign=-1)).findings
    assert finding.level == "warning"
    assert "OFFSETCOL" in finding.problem
    assert "OFFSETROW" not in finding.problem


def test_axis_of_the_map_itself_uses_its_own_output(area):
    """X corrected over X and Y goes into output 1, that of the column axis; no third output."""
    made = CompensationMap(area.x, area.y, area.values, compensates="X")

    text = Aerotech().encode(made, **options(corrected_axis=1)).data.decode()

    assert "OUTAXIS3" not in text
    assert interpreter(text)({1: 12.0, 2: 7.0}, 1) < -2.5e-3
    assert interpreter(text)({1: 12.0, 2: 7.0}, 2) == 0.0
    back = Aerotech().decode(text.encode(), NOWHERE)
    np.testing.assert_allclose(back.values, area.values, atol=QUANTUM + FLOAT, rtol=0)
    assert back.compensates == "X"


def test_negated_map_doubles(area, bumps):
    place = {1: 12.0, 2: 7.0}
    error = bumps(12e-3, 7e-3) - bumps(2e-3, -5e-3)

    wrong = interpreter(Aerotech().encode(area.negated(), **UP).data.decode())

    assert error + wrong(place, 4) * 1e-3 == pytest.approx(2 * error, abs=1e-9)


def test_simulator_is_the_interpreter(area):
    encoded = Aerotech().encode(area, **options(column_sign=-1, corrected_sign=-1))
    added = interpreter(encoded.data.decode())
    lookup = Aerotech().lookup(encoded.data, NOWHERE)
    rng = np.random.default_rng(3)

    for px, py in rng.uniform(-10e-3, 50e-3, (50, 2)):
        expected = -added({1: -px * 1e3, 2: py * 1e3}, 4) * 1e-3
        assert lookup(px, py) == pytest.approx(expected, abs=FLOAT)
        assert lookup(px, py, -1) == pytest.approx(expected, abs=FLOAT)


def test_ring_of_zeros_and_corner():
    made = CompensationMap([0, 1e-3, 2e-3], [0, 2e-3], [[1e-6, 2e-6, 3e-6], [4e-6, 5e-6, 7e-6]])

    encoded = Aerotech().encode(made, **UP, zero_ring=True, subtract_corner=True)

    back = Aerotech().decode(encoded.data, NOWHERE)
    np.testing.assert_allclose(back.x, np.arange(-1, 4) * 1e-3, atol=1e-15, rtol=0)
    np.testing.assert_allclose(back.y, np.arange(-1, 3) * 2e-3, atol=1e-15, rtol=0)
    inside = np.array([[0, 1, 2], [3, 4, 6]]) * 1e-6
    np.testing.assert_allclose(back.values, np.pad(inside, 1), atol=FLOAT, rtol=0)
    assert back.border == "zero"
    again = Aerotech().encode(back, **UP, zero_ring=True)
    assert again.carried.x.size == 5  # a ring that is there already is enough


@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.integers(2, 12),
    m=st.integers(2, 8),
    size=st.floats(1e-9, 1e-4),
    signs=st.tuples(*[st.sampled_from([1, -1])] * 3),
    start=st.floats(-0.5, 0.5),
    step=st.floats(1e-5, 5e-2),
)
@settings(derandomize=True, deadline=None, max_examples=60)
def test_round_trip_is_within_the_quantisation(seed, n, m, size, signs, start, step):
    rng = np.random.default_rng(seed)
    made = CompensationMap(
        start + step * np.arange(n), -start + step * np.arange(m), size * rng.normal(size=(m, n))
    )
    row, column, corrected = signs
    given_options = options(row_sign=row, column_sign=column, corrected_sign=corrected)

    encoded = Aerotech().encode(made, **given_options)
    back = Aerotech().decode(encoded.data, NOWHERE)

    assert encoded.quantisation <= QUANTUM * (1 + 1e-6) + FLOAT
    assert re.search(rb"[0-9]e[+-]?[0-9]", encoded.data) is None
    np.testing.assert_allclose(back.values, made.values, atol=encoded.quantisation + FLOAT, rtol=0)
    np.testing.assert_allclose(back.x, made.x, atol=1e-12, rtol=0)
    np.testing.assert_allclose(back.y, made.y, atol=1e-12, rtol=0)
    px, py = made.x[0] + 0.3 * step, made.y[-1] + 5.0
    assert Aerotech().lookup(encoded.data, NOWHERE)(px, py) == pytest.approx(
        float(made.correction(px, py)[0]), abs=encoded.quantisation + size * 1e-6
    )


def test_uneven_map_is_refused_or_resampled():
    x = np.array([0.0, 1e-3, 4e-3])
    made = CompensationMap(x, [0, 1e-3], [[0, 1e-6, 0]] * 2)

    with pytest.raises(TableError, match=r"uniform positions of X.*column_spacing"):
        Aerotech().encode(made, **UP)
    fine = Aerotech().encode(made, **UP, column_spacing=1e-3)
    coarse = Aerotech().encode(made, **UP, column_spacing=2e-3)

    assert fine.resampling_error == pytest.approx(0.0, abs=FLOAT)
    # at 2 mm the hat of 1 um at 1 mm is 2/3; at 1 mm the file gives half of that instead of 1
    assert coarse.resampling_error == pytest.approx(2e-6 / 3, abs=FLOAT)
    np.testing.assert_allclose(coarse.carried.x, [0, 2e-3, 4e-3], atol=1e-15, rtol=0)


def test_too_fine_a_spacing_is_refused():
    made = CompensationMap([0, 1], [0, 1], np.zeros((2, 2)))

    with pytest.raises(LimitError, match=r"row_spacing.*check its unit"):
        Aerotech().encode(made, **UP, row_spacing=1e-7)


@pytest.mark.parametrize("missing", sorted(UP))
def test_facts_of_the_machine_are_asked_for(tmp_path, area, missing):
    rest = {k: v for k, v in UP.items() if k != missing}

    with pytest.raises(DataError, match=missing):
        controllers.write(area, tmp_path / "x.cal", "aerotech", allow_unverified=True, **rest)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"row_axis": 1}, "both 1"),
        ({"corrected_axis": 1}, "a third axis"),
        ({"corrected_axis": 2, "corrected_sign": -1}, "one axis has one encoder"),
    ],
)
def test_axis_numbers_must_not_contradict(area, changes, words):
    with pytest.raises(DataError, match=words):
        Aerotech().encode(area, **options(**changes))


def test_turning_axes_are_refused():
    made = CompensationMap([0, 1e-3], [0, 1], np.zeros((2, 2)), axes=("X", "C"))

    with pytest.raises(TableError, match="C turns"):
        Aerotech().encode(made, **UP)


def test_written_and_read_by_name(tmp_path, area):
    controllers.write(
        area, tmp_path / "x.cal", "aerotech", allow_unverified=True, **options(corrected_sign="-")
    )

    back = controllers.read(tmp_path / "x.cal", "aerotech")

    np.testing.assert_allclose(back.values, area.values, atol=QUANTUM + FLOAT, rtol=0)
    assert back.reference == area.reference
    (tmp_path / "x.cal.json").unlink()
    np.testing.assert_array_equal(
        controllers.read(tmp_path / "x.cal", "aerotech").values, back.values
    )
    with pytest.raises(DataError, match="the file says"):
        controllers.read(tmp_path / "x.cal", "aerotech", row_sign=-1)


def test_sign_that_nothing_tells_is_asked_for():
    with pytest.raises(DataError, match="corrected_sign"):
        Aerotech().decode(HAND.encode(), NOWHERE)


def test_other_units():
    third = HAND.replace("METRIC/1000", "PRIMARY/2").replace("POSUNIT=METRIC", "POSUNIT=PRIMARY")

    back = Aerotech().decode(third.encode(), NOWHERE, corrected_sign=1, primary_unit=1e-2)

    np.testing.assert_allclose(back.x, [-0.1, -0.05, 0.0], atol=1e-15, rtol=0)
    assert back.values[0, 2] == pytest.approx(0.4 * 0.5e-2, abs=FLOAT)
    with pytest.raises(DataError, match="primary_unit"):
        Aerotech().decode(third.encode(), NOWHERE, corrected_sign=1)


@pytest.mark.parametrize(
    ("old", "new", "kind", "words"),
    [
        (":END\n", "", CorruptFileError, "0 :END"),
        (":END\n", ":END\n1 2 3\n", CorruptFileError, ":END"),
        (":END\n", ":END\n" + HAND, UnsupportedFeatureError, "several tables"),
        ("5.000 5.000 3", "5.000 5.000", CorruptFileError, "line 2"),
        ("5.000 5.000 3", "5.000 0.000 3", CorruptFileError, "line 2"),
        ("5.000 5.000 3", "5.000 5.000 3.0", CorruptFileError, "line 2"),
        ("2   1   1", "2   2   1", CorruptFileError, "line 2"),
        ("2   1   1", "0   1   1", CorruptFileError, "line 2"),
        ("2   1   1", "2   x   1", CorruptFileError, "line 2"),
        ("5.000 5.000 3", "5.000 5.000 4", CorruptFileError, "line 4 is not a row of 12"),
        ("OFFSETROW=0.000 ", "", CorruptFileError, "line 3 lacks OFFSETROW"),
        ("OFFSETROW=0.000", "OFFSETROW=abc", CorruptFileError, "line 3"),
        ("OFFSETROW=0.000", "OFFSETROW=0 OFFSETROW=1", CorruptFileError, "line 3"),
        ("OFFSETROW=0.000", "OFFSET=0.000", CorruptFileError, "OFFSET"),
        ("OFFSETROW=0.000", "noise OFFSETROW=0", CorruptFileError, "KEY=VALUE"),
        ("OUTAXIS3=4", "OUTAXIS3=4.5", CorruptFileError, "OUTAXIS3"),
        ("OUTAXIS3=4 ", "", CorruptFileError, "row of 6"),
        ("POSUNIT=METRIC", "POSUNIT=ENGLISH", UnsupportedFeatureError, "ENGLISH"),
        ("METRIC/1000", "METRIC/0", UnsupportedFeatureError, "METRIC/0"),
        ("0.4000\n:END", "nan\n:END", CorruptFileError, "line 5"),
        ("0.4000\n:END", "1e-3\n:END", CorruptFileError, "line 5"),
        ("0.4000\n:END", "0,4\n:END", CorruptFileError, "line 5"),
        ("0 0 0.0000    0 0 -0.3000   0 0 0.4000\n:END", ":END", CorruptFileError, "2 rows"),
        ("0 0 0.4000\n:END", "0 1 0.4000\n:END", UnsupportedFeatureError, "2 axes at once"),
    ],
)
def test_damage_is_refused_with_its_line(old, new, kind, words):
    assert old in HAND

    with pytest.raises(kind, match=words) as caught:
        Aerotech().decode(HAND.replace(old, new, 1).encode(), NOWHERE, corrected_sign=1)
    assert "\n" not in str(caught.value)


def test_binary_is_refused():
    with pytest.raises(CorruptFileError, match="UTF-8"):
        Aerotech().decode(b"\xff\xfe\x00", NOWHERE, corrected_sign=1)


LINE = AerotechLine.info.example


def one_way(table):
    return CompensationTable(table.positions, table.forward, None, "X", "X", table.reference)


@pytest.mark.parametrize("column", [1, -1])
def test_line_is_two_equal_rows(table, bump, column):
    encoded = AerotechLine().encode(
        one_way(table), **{**LINE, "column_sign": column, "corrected_sign": column}
    )
    added = interpreter(encoded.data.decode())

    for p in (0.0, 5e-3, 12e-3, 20e-3, 50e-3):
        for other in (-100.0, 0.0, 30.0, 200.0):  # wherever the other axis is
            moved = column * added({1: column * p * 1e3, 2: other}, 1) * 1e-3
            assert bump(p) - bump(0.0) + moved == pytest.approx(0.0, abs=0.03e-6)
    back = AerotechLine().decode(encoded.data, NOWHERE)
    np.testing.assert_allclose(back.positions, table.positions, atol=1e-12, rtol=0)
    np.testing.assert_allclose(back.forward, table.forward, atol=QUANTUM + FLOAT, rtol=0)
    assert (back.axis, back.compensates) == ("X", "X")


def test_line_over_another_axis(table):
    cross = CompensationTable(table.positions, table.forward, None, "X", "Z", 0.0)

    encoded = AerotechLine().encode(cross, **{**LINE, "corrected_axis": 4, "corrected_sign": -1})

    assert b"OUTAXIS3=4" in encoded.data
    added = interpreter(encoded.data.decode())
    assert -added({1: 12.0, 2: 0.0}, 4) * 1e-3 == pytest.approx(
        table.correction(12e-3)[0], abs=1e-9
    )
    assert AerotechLine().decode(encoded.data, NOWHERE).compensates == "Z"
    with pytest.raises(DataError, match="X -> Z"):
        AerotechLine().encode(cross, **LINE)


def test_line_with_two_directions_is_refused(table):
    with pytest.raises(TableError, match="direction="):
        AerotechLine().encode(table, **LINE)


def test_line_of_a_real_area_is_refused(area):
    data = Aerotech().encode(area, **UP).data

    with pytest.raises(CorruptFileError, match="rows differ"):
        AerotechLine().decode(data, NOWHERE)


def test_line_written_verified_and_read(tmp_path, table, measured):
    checked = controllers.write(
        one_way(table), tmp_path / "x.cal", "aerotech-line", verified_against=measured, **LINE
    )

    assert checked.passed
    lookup = controllers.simulate(tmp_path / "x.cal", "aerotech-line")
    assert lookup(60e-3) == pytest.approx(table.forward[-1], abs=QUANTUM + FLOAT)


@given(seed=st.integers(0, 2**32 - 1), n=st.integers(2, 40), spacing=st.floats(1e-4, 2e-2))
@settings(derandomize=True, deadline=None, max_examples=16)
def test_line_resampled_round_trip(seed, n, spacing):
    rng = np.random.default_rng(seed)
    p = np.cumsum(rng.uniform(1e-3, 5e-3, n))
    made = CompensationTable(p, 1e-6 * rng.normal(size=n), None, "X", "X", float(p[0]))

    encoded = AerotechLine().encode(made, **LINE, spacing=spacing)

    lookup = AerotechLine().lookup(encoded.data, NOWHERE)
    q = np.linspace(p[0] - 1e-3, p[-1] + 1e-3, 777)
    off = np.abs(lookup(q) - made.correction(q)).max()
    assert off <= encoded.resampling_error + encoded.quantisation + 1e-12
    assert np.diff(encoded.carried.positions).max() <= spacing * (1 + 1e-6)


@pytest.mark.parametrize(
    "table", ["[1]", '{"axes": ["X"]}', '{"axes": ["X", "Y"], "reference_si": ["a", 0]}']
)
def test_sidecar_of_something_else_is_refused(tmp_path, table):
    path = tmp_path / "x.cal"
    path.write_text(HAND)
    (tmp_path / "x.cal.json").write_text(f'{{"table": {table}}}')

    with pytest.raises(CorruptFileError, match="not the sidecar of a map"):
        Aerotech().decode(HAND.encode(), path, corrected_sign=1)


@pytest.mark.parametrize(
    ("axis", "number"), [("X", 2), ("Y", 1), ("X", 4), ("Y", 4), ("Z", 1), ("Z", 2)]
)
def test_corrected_axis_must_be_the_number_of_the_axis_the_map_corrects(area, axis, number):
    """X runs along the columns (axis 1), Y along the rows (axis 2)."""
    made = CompensationMap(area.x, area.y, area.values, compensates=axis)

    with pytest.raises(DataError, match=rf"X, Y -> {axis}.*corrected_axis={number}"):
        Aerotech().encode(made, **options(corrected_axis=number))


def test_corrected_axis_is_that_of_the_output_and_not_of_a_comment(area):
    made = CompensationMap(area.x, area.y, area.values, compensates="Y")
    text = Aerotech().encode(made, **options(corrected_axis=2)).data.decode()
    bare = "\n".join(s for s in text.splitlines() if not s.startswith(";")) + "\n"

    back = Aerotech().decode(bare.encode(), NOWHERE, corrected_sign=1)
    assert (back.axes, back.compensates) == (("X", "Y"), "Y")
    with pytest.raises(CorruptFileError, match=r"corrects? X, but its entries act on axis 2.*Y"):
        Aerotech().decode(bare.encode(), NOWHERE, corrected_sign=1, names="X, Y, X")
    column = bare.replace(":START2D 2   1   1    2", ":START2D 2   1   2    1")
    assert Aerotech().decode(column.encode(), NOWHERE, corrected_sign=1).compensates == "X"


def test_user_and_comment_must_not_contradict(area):
    data = Aerotech().encode(area, **options(corrected_sign=-1)).data

    for told in ({"corrected_sign": 1}, {"offset_follows": "axis"}, {"corrected_axis": 3}):
        with pytest.raises(DataError, match=rf"{next(iter(told))}="):
            Aerotech().lookup(data, NOWHERE, **told)
    with pytest.raises(DataError, match="names"):
        Aerotech().decode(data, NOWHERE, names="X, Y, W")


def test_two_comments_must_not_contradict(area):
    text = Aerotech().encode(area, **options(corrected_sign=-1)).data.decode()
    later = text.replace(":END", ":END\n; metrosep: corrected_sign=1")

    with pytest.raises(CorruptFileError, match="two comments state corrected_sign"):
        Aerotech().decode(later.encode(), NOWHERE)


def test_every_changed_line_is_found_without_a_sidecar(area):
    lines = Aerotech().encode(area, **UP).data.decode().splitlines()
    attempts = []
    for i in range(2, len(lines)):
        attempts.append([*lines[:i], *lines[i + 1 :]])  # lost
        attempts.append([*lines[: i + 1], *lines[i:]])  # doubled
        attempts.append([*lines[:i], lines[i][:-2], *lines[i + 1 :]])  # cut
        if i + 1 < len(lines):
            attempts.append([*lines[:i], lines[i + 1], lines[i], *lines[i + 2 :]])  # exchanged
    attempts.append([lines[0].replace("corrected_sign=1", "corrected_sign=-1"), *lines[1:]])
    attempts.append([lines[0][:-2], *lines[1:]])

    for changed in attempts:
        with pytest.raises((CorruptFileError, UnsupportedFeatureError)):
            Aerotech().decode("\n".join(changed).encode(), NOWHERE)
    assert len(attempts) > 60
    spaced = "\r\n".join(s.replace("   ", "  ") for s in lines)  # blanks are not content
    assert Aerotech().decode(spaced.encode(), NOWHERE).values.shape == area.values.shape


NEGATIVE = HAND.replace("5.000 5.000 3", "5.000 -5.000 3")


def test_foreign_file_with_a_negative_distance_and_an_offset_is_ambiguous():
    with pytest.raises(DataError, match=r"column distance.*offset_follows="):
        Aerotech().decode(NEGATIVE.encode(), NOWHERE, corrected_sign=1)
    with pytest.raises(DataError, match="offset_follows="):
        AerotechLine().decode(NEGATIVE.encode(), NOWHERE, corrected_sign=1, names="X, Z")

    back = Aerotech().decode(
        NEGATIVE.encode(), NOWHERE, corrected_sign=1, offset_follows="encoder"
    )
    np.testing.assert_allclose(back.x, [10e-3, 15e-3, 20e-3], atol=1e-15, rtol=0)
    zero = NEGATIVE.replace("OFFSETCOL=10.000", "OFFSETCOL=0.000")
    assert Aerotech().decode(zero.encode(), NOWHERE, corrected_sign=1).x[0] == 0.0


def test_foreign_line_over_another_axis_asks_for_names():
    with pytest.raises(DataError, match=r"axis 4 is corrected over axis 1.*names="):
        AerotechLine().decode(HAND.encode(), NOWHERE, corrected_sign=1)
    back = AerotechLine().decode(HAND.encode(), NOWHERE, corrected_sign=1, names="Y, W")
    assert (back.axis, back.compensates) == ("Y", "W")
    with pytest.raises(CorruptFileError, match="act on axis 4"):
        AerotechLine().decode(HAND.encode(), NOWHERE, corrected_sign=1, names="X, X")
    with pytest.raises(DataError, match="2 names"):
        AerotechLine().decode(HAND.encode(), NOWHERE, corrected_sign=1, names="X")


HUGE = "9" * 400
LONG = "9" * 5000


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("OUTAXIS3=4", "OUTAXIS3=\N{SUPERSCRIPT TWO}"),
        ("OUTAXIS3=4", "OUTAXIS3=" + LONG),
        ("5.000 3\n", f"5.000 {HUGE}\n"),
        ("5.000 3\n", f"5.000 {LONG}\n"),
        ("5.000 5.000 3", f"{HUGE} 5.000 3"),
        ("5.000 5.000 3", f"5.000 0.{'0' * 330}1 3"),
        ("5.000 5.000 3", f"5.000 0.{'0' * 30}1 3"),
        ("METRIC/1000", "METRIC/" + HUGE),
        ("METRIC/1000", "METRIC/" + LONG),
        ("OFFSETCOL=10.000", "OFFSETCOL=" + HUGE),
        ("0.4000\n:END", f"{HUGE}\n:END"),
        ("0.4000\n:END", "\N{ARABIC-INDIC DIGIT FOUR}.0\n:END"),
        ("START2D 2 ", "START2D \N{ARABIC-INDIC DIGIT TWO} "),
    ],
)
def test_numbers_beyond_all_bounds_are_refused(old, new):
    assert old in HAND

    with pytest.raises((CorruptFileError, UnsupportedFeatureError)) as caught:
        Aerotech().decode(HAND.replace(old, new, 1).encode(), NOWHERE, corrected_sign=1)
    assert len(str(caught.value)) < 400


class TestAerotech(DialectContract):
    name = "aerotech"
    hand = HAND
    reading = (("corrected_sign", 1),)
    whole = "\n"


class TestAerotechLine(DialectContract):
    name = "aerotech-line"
