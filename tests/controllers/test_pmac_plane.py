"""Turbo PMAC, two motors: crossing of spans, order of entries, roll-over, an interpreter."""

import re
from pathlib import Path

import numpy as np
import pytest
from contracts.dialect import DialectContract
from hypothesis import given, settings, strategies as st

from metrosep import controllers
from metrosep.compensation.maps import CompensationMap
from metrosep.controllers.options import checked_options
from metrosep.controllers.pmac_plane import PMACPlane
from metrosep.errors import CorruptFileError, DataError, LimitError, TableError

ROUNDING = 1e-15
"""m; corrections of um in double: far below."""
COUNT = 10e-9
NOWHERE = Path("/nonexistent/x.pmc")

HAND = """; by hand from the grammar: 2 rows of 3 columns, X 0, 10, 20, 30 mm, Y 0, 20, 40 mm
DELETE GATHER
#3 DELETE COMP
#3 DEFINE COMP 2.3,#1D,#2D,#3,3000000,4000000
1600 -800 0
320 640 960 320
0 1600 -800 0
I51=1
SAVE
"""
TOLD = {
    "count": COUNT, "x_count": COUNT, "y_count": COUNT, "x_sign": 1, "y_sign": 1, "target_sign": 1,
    "x_zero": 0.0, "y_zero": 0.0,
}  # fmt: skip
"""What that file does not say of the machine."""
HAND_UM = [[0.0, 1.0, -0.5, 0.0], [0.2, 0.4, 0.6, 0.2], [0.0, 1.0, -0.5, 0.0]]
"""Corrections in um at 10 nm a count: 1600 sixteenths are 1 um; rows Y, columns X."""


def interpret(text, count, row_count=None, column_count=None):
    """Do what the Software Reference says, with no code of the library; positions of motors in m."""
    code = re.sub(r";.*", "", text).upper()
    define = re.search(r"DEFINE COMP (\d+)\.(\d+),#(\d+)D?,#(\d+)D?,#(\d+),(\d+),(\d+)\n", code)
    rows, columns = int(define[1]), int(define[2])
    row_span, column_span = int(define[6]), int(define[7])
    words = code[define.end() :].split()
    n = (rows + 1) * (columns + 1) - 1
    assert words[n:] == ["I51=1"]  # SAVE comes after the trial on the machine
    stream = [0, *map(int, words[:n])]

    def entry(row, column):
        return stream[row * (columns + 1) + column]

    def added(row_motor, column_motor):
        across = row_motor / (row_count or count) % row_span * columns / row_span
        down = column_motor / (column_count or count) % column_span * rows / column_span
        j, i = int(across), int(down)
        f, g = across - j, down - i
        j1, i1 = min(j + 1, columns), min(i + 1, rows)
        top = entry(i, j) * (1 - f) + entry(i, j1) * f
        bottom = entry(i1, j) * (1 - f) + entry(i1, j1) * f
        return (top * (1 - g) + bottom * g) / 16 * count

    return np.vectorize(added)


def encode(table, **options):
    dialect = PMACPlane()
    return dialect.encode(table, **checked_options(options, dialect.options, "pmac-plane"))


def without_comments(data):
    return "".join(
        line + "\n" for line in data.decode("ascii").splitlines() if not line.startswith(";")
    )


def hand_map():
    return CompensationMap(
        np.arange(4) * 10e-3, np.arange(3) * 20e-3, np.array(HAND_UM) * 1e-6, ("X", "Y"), "Z"
    )


def test_hand_made_file_is_written_to_the_byte():
    encoded = encode(hand_map(), count="10 nm", x_span="30 mm", y_span="40 mm")

    assert without_comments(encoded.data) == HAND.partition("\n")[2].removesuffix("SAVE\n")
    assert encoded.quantisation <= ROUNDING
    assert encoded.resampling_error <= ROUNDING


def test_hand_made_file_reads_as_corrections():
    table = PMACPlane().decode(HAND.encode(), NOWHERE, **TOLD)

    np.testing.assert_allclose(table.x, np.arange(4) * 10e-3, atol=1e-12, rtol=0)
    np.testing.assert_allclose(table.y, np.arange(3) * 20e-3, atol=1e-12, rtol=0)
    np.testing.assert_allclose(table.values, np.array(HAND_UM) * 1e-6, atol=ROUNDING, rtol=0)


@pytest.mark.parametrize(
    ("x_mm", "y_mm", "um"),
    [
        (10, 0, 1.0),  # first entry: one column spacing of the row motor
        (0, 20, 0.2),  # first entry of row 1: the row motor at zero
        (20, 20, 0.6),
        (15, 0, 0.25),
        (10, 10, 0.7),
        (-10, 20, 0.6),  # read at the top: 20 mm
        (20, -20, 0.6),
        (50, 60, 0.6),
    ],
)
def test_lookup_by_hand(x_mm, y_mm, um):
    look = PMACPlane().lookup(HAND.encode(), NOWHERE, **TOLD)

    for direction in (1, -1):
        seen = look(x_mm * 1e-3, y_mm * 1e-3, direction)
        assert seen == pytest.approx(um * 1e-6, abs=1e-14)


def test_lookup_refuses_a_third_direction():
    look = PMACPlane().lookup(HAND.encode(), NOWHERE, **TOLD)

    with pytest.raises(DataError, match="direction"):
        look(0.0, 0.0, 0)


def error(x, y):
    """A bump at X 12 mm, Y 40 mm, and a tilt that tells X from Y."""
    at = 3e-6 * np.exp(-(((x - 12e-3) / 8e-3) ** 2) - ((y - 40e-3) / 15e-3) ** 2)
    return at + 2e-5 * x - 1e-5 * y


@pytest.mark.parametrize("shift", [(0.0, 0.0), (-20e-3, -50e-3), (-30e-3, -70e-3)])
@pytest.mark.parametrize(("x_sign", "y_sign", "target_sign"), [(1, 1, 1), (-1, 1, -1), (1, -1, 1)])
def test_planted_error_shrinks_and_the_negated_one_doubles(shift, x_sign, y_sign, target_sign):
    def moved(x, y):
        return error(x - shift[0], y - shift[1])

    zero = moved(0.0, 0.0)
    table = CompensationMap.from_error(
        lambda x, y: moved(x, y) - zero,
        x=np.linspace(0, 30e-3, 16) + shift[0],
        y=np.linspace(0, 70e-3, 15) + shift[1],
        reference=(0.0, 0.0),
    )
    x, y = np.meshgrid(np.linspace(0, 30e-3, 41) + shift[0], np.linspace(0, 70e-3, 43) + shift[1])
    left = []
    for sign in (1, -1):
        data = encode(
            table if sign > 0 else table.negated(), count="1 nm", x_count="20 nm",
            y_count="50 nm", x_sign=x_sign, y_sign=y_sign, target_sign=target_sign,
        ).data  # fmt: skip
        motor = interpret(data.decode(), 1e-9, 20e-9, 50e-9)
        added = target_sign * motor(x_sign * x, y_sign * y)
        left.append(np.ptp(moved(x, y) + added))
        np.testing.assert_allclose(
            PMACPlane().lookup(data, NOWHERE)(x, y), added, atol=1e-13, rtol=0
        )
        back = PMACPlane().decode(data, NOWHERE)
        np.testing.assert_allclose(back.correction(x, y), added, atol=1e-12, rtol=0)

    before = np.ptp(moved(x, y))
    assert left[0] < 0.08 * before  # the bump between nodes of 2 mm and 5 mm
    assert left[1] == pytest.approx(2 * before, rel=0.08, abs=0)


@given(
    origin=st.tuples(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1)),
    gaps=st.tuples(
        st.lists(st.floats(1e-3, 2e-2), min_size=1, max_size=6),
        st.lists(st.floats(1e-3, 2e-2), min_size=1, max_size=6),
    ),
    seed=st.integers(0, 2**32 - 1),
    size=st.floats(1e-9, 1e-5),
)
@settings(derandomize=True, deadline=None, max_examples=25)
def test_round_trip_is_within_quantisation_and_resampling(origin, gaps, seed, size):
    rng = np.random.default_rng(seed)
    x, y = (o + np.concatenate([[0.0], np.cumsum(g)]) for o, g in zip(origin, gaps, strict=True))
    rough = CompensationMap(x, y, size * rng.uniform(-1, 1, (y.size, x.size)))
    # a motor's zero within a thousandth of a step of an end is that end
    near = [1e-3 * np.diff(a).min() for a in (x, y)]
    inside = all(a[0] <= d and a[-1] >= -d for a, d in zip((x, y), near, strict=True))
    offset = float(rough.correction(0.0, 0.0).item()) if inside else 0.0
    table = CompensationMap(x, y, rough.values - offset)

    encoded = encode(table, count="1 nm", x_count="20 nm", y_count="20 nm")

    px, py = rng.uniform(x[0], x[-1], 200), rng.uniform(y[0], y[-1], 200)
    bound = encoded.quantisation + encoded.resampling_error + 1e-7 * size + 1e-15
    assert encoded.quantisation <= 1e-9 / 32 * 1.001
    seen = interpret(encoded.data.decode(), 1e-9, 20e-9, 20e-9)(px, py)
    assert np.abs(seen - table.correction(px, py)).max() <= bound
    back = PMACPlane().decode(encoded.data, NOWHERE)
    assert np.abs(back.values - encoded.carried.values).max() <= encoded.quantisation * 1.01


def test_map_that_corrects_one_of_its_axes():
    own = CompensationMap([0.0, 1e-3], [0.0, 1e-3], [[0.0, 1e-6], [2e-6, 3e-6]], ("X", "Y"), "Y")

    text = without_comments(encode(own, count=COUNT).data)

    assert "#2 DEFINE COMP 3.3,#1D,#2D,#2,300000,300000\n" in text
    with pytest.raises(TableError, match="one; leave y_count"):
        encode(own, count=COUNT, y_count="5 nm")
    with pytest.raises(TableError, match="a motor moves one axis"):
        encode(own, count=COUNT, target_motor=1)


def test_written_with_dry_run_and_read_without_its_sidecar(tmp_path):
    table = CompensationMap.from_error(
        error, x=np.linspace(0, 30e-3, 31), y=np.linspace(0, 70e-3, 36), axes=("X", "V")
    )
    path = tmp_path / "x.pmc"

    result = controllers.write(table, path, "pmac-plane", count="10 nm", verified_against=error)

    assert result.passed
    assert result.wrong_sign_pv > 1.8 * result.before_pv
    assert controllers.read(path, "pmac-plane").reference == table.reference
    (tmp_path / "x.pmc.json").unlink()
    back = controllers.read(path, "pmac-plane")
    assert (back.axes, back.compensates) == (("X", "V"), "Z")
    assert np.abs(back.values - table.values).max() <= COUNT / 32 * 1.01


def test_value_where_both_motors_are_zero_is_refused():
    shifted = CompensationMap([-1.0, 1.0], [-1.0, 1.0], np.full((2, 2), 1e-6))

    with pytest.raises(TableError, match=r"must be 0 by definition.*reference.*x_zero"):
        encode(shifted, count=COUNT, x_count="1 um", y_count="1 um")


def test_travel_that_fills_a_span_needs_equal_ends():
    with pytest.raises(TableError, match="ends are one place"):
        encode(
            CompensationMap([0.0, 1e-3], [0.0, 1e-3], [[0.0, 1e-6], [0.0, 1e-6]]), count=COUNT,
            x_span="1 mm",
        )  # fmt: skip


@pytest.mark.parametrize(
    ("options", "kind", "text"),
    [
        ({"x_span": "29 mm"}, TableError, "X: the span 29 mm is shorter"),
        ({"y_span": "39 mm"}, TableError, "Y: the span 39 mm is shorter"),
        ({"y_motor": 1}, TableError, "both axes of the map are motor #1"),
        ({"target_motor": 2}, TableError, "a motor moves one axis"),
        ({"count": "1 nm"}, LimitError, "long_span"),
        ({"count": None}, DataError, "count="),
        ({"count": "1e-7 nm", "x_count": COUNT, "y_count": COUNT}, LimitError, r"at X .*, Y "),
        ({"y_first": "1 mm"}, TableError, "y_first="),
    ],
)
def test_bad_options(options, kind, text):
    with pytest.raises(kind, match=text):
        encode(hand_map(), **{"count": COUNT, **options})


@pytest.mark.parametrize(
    ("axes", "other", "options", "words"),
    [
        (("X", "C"), "Z", {"count": COUNT}, "state y_count= too, the angle"),
        (("X", "Y"), "C", {"count": "0.0001 deg"}, "state x_count= too, the length"),
        (("X", "C"), "Z", {"count": "10 nm", "y_count": "10 nm"}, "y_count='10 nm'.*C turns"),
    ],
)
def test_a_count_is_not_taken_for_the_other_kind(axes, other, options, words):
    turning = CompensationMap([0.0, 1.0], [0.0, 1.0], np.zeros((2, 2)), axes, other)

    with pytest.raises((TableError, DataError), match=words):
        encode(turning, **options)


def opposed():
    return encode(hand_map(), count=COUNT, x_sign=-1, y_sign=-1, target_sign=-1).data


@pytest.mark.parametrize("name", [n for n in TOLD if n != "count"])
def test_comment_that_was_dropped_is_asked_for(name):
    lines = opposed().splitlines(keepends=True)
    data = b"".join(line for line in lines if not line.startswith(f"; {name} =".encode()))

    with pytest.raises(DataError, match=rf"states {name} \("):
        PMACPlane().lookup(data, NOWHERE)


@pytest.mark.parametrize(
    ("name", "value"), [("count", 1e-9), ("x_sign", 1), ("target_sign", 1), ("target_motor", 5)]
)
def test_option_that_contradicts_the_file_is_refused(name, value):
    with pytest.raises(DataError, match=rf"{name}=.*{name}="):
        PMACPlane().decode(opposed(), NOWHERE, **{name: value})


def test_delete_of_another_motor_and_doubled_facts_are_refused():
    data = opposed()

    with pytest.raises(CorruptFileError, match="another table"):
        PMACPlane().decode(data.replace(b"#3 DELETE", b"#5 DELETE"), NOWHERE)
    with pytest.raises(CorruptFileError, match="two comments state x_sign"):
        PMACPlane().decode(b"; x_sign = 1\n" + data, NOWHERE)


def test_zero_of_the_motors_a_hair_beside_the_map_is_its_corner():
    x, y = 1e-3 + np.arange(4) * 10e-3, np.arange(3) * 20e-3
    table = CompensationMap(x, y, np.array(HAND_UM) * 1e-6 - 0.3e-6, ("X", "Y"), "Z")

    with pytest.raises(TableError, match="must be 0 by definition"):
        encode(table, count=COUNT, x_zero=1e-3 - 1e-10)


class TestPMACPlane(DialectContract):
    name = "pmac-plane"
    hand = HAND
    reading = TOLD
    whole = "SAVE\n"
    damage = (
        ("2.3,", "3.2,", "differs from the first"),
        ("2.3,", "2.4,", "of 14 entries"),
        ("2.3,", "2,", "DEFINE line"),
        ("2.3,", "0.3,", "entries"),
        ("960 320\n", "960 300\n", "differs from the first"),
        ("960 320\n", "960\n", "of 11 entries"),
        ("-800 0\n320", "-800 10\n320", "differs from the first"),
        ("0 1600 -800 0\nI51", "0 1600 -900 0\nI51", "differs from the first"),
        ("I51=1", "I51=0", "I51"),
        (",4000000", "", "DEFINE line"),
        ("3000000", "2", "not a table"),
    )
