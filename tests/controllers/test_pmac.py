"""Turbo PMAC, one motor: the specification's file, an interpreter of its grammar, what is refused."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from contracts.dialect import DialectContract
from hypothesis import given, settings, strategies as st

from metrosep import controllers
from metrosep.compensation import CompensationTable
from metrosep.controllers.options import checked_options
from metrosep.controllers.pmac import PMAC
from metrosep.errors import (
    CorruptFileError,
    DataError,
    LimitError,
    SignCheckFailedError,
    TableError,
)

ROUNDING = 1e-15
"""m; corrections of um in double: far below."""
COUNT = 10e-9
HALF_ENTRY = COUNT / 32
"""m; half a sixteenth of a count."""
NOWHERE = Path("/nonexistent/x.pmc")

SPEC = """DELETE GATHER
#2 DELETE COMP
#2 DEFINE COMP 8,#1D,#2,4000000
-800 -1280 -960 -320 320 640 320 0
I51=1
SAVE
"""
TOLD = {
    "count": COUNT, "source_count": COUNT, "source_sign": 1, "target_sign": 1, "motor_zero": 0.0
}  # fmt: skip
"""What the file of the specification does not say of the machine."""
SPEC_ERROR_UM = [0, 0.5, 0.8, 0.6, 0.2, -0.2, -0.4, -0.2, 0]
"""Controllers notes, section 3.1: straightness of X to Z, 10 nm a count, every 5 mm."""


def interpret(text, count, source_count=None):
    """Do what the Software Reference says, with no code of the library: counts to counts."""
    code = re.sub(r";.*", "", text).upper()
    define = re.search(r"#(\d+)\s*DEFINE COMP (\d+),#(\d+)D?,#(\d+),(\d+)\n", code)
    n, span = int(define[2]), int(define[5])
    words = code[define.end() :].split()
    entries = [int(w) for w in words[:n]]
    assert words[n:] == ["I51=1"]  # SAVE comes after the trial on the machine

    def added(position):
        counts = position / (source_count or count) % span  # rolled over into 0 ... span
        u = counts * n / span
        k = int(u)
        table = [0, *entries]
        here, there = table[k], table[min(k + 1, n)]
        return (here + (u - k) * (there - here)) / 16 * count

    return np.vectorize(added)


def encode(table, **options):
    dialect = PMAC()
    return dialect.encode(table, **checked_options(options, dialect.options, "pmac"))


def spec_table():
    return CompensationTable(
        np.arange(9) * 5e-3, -np.array(SPEC_ERROR_UM) * 1e-6, None, "X", "Z", 0.0
    )


def without_comments(data):
    return "".join(
        line + "\n" for line in data.decode("ascii").splitlines() if not line.startswith(";")
    )


def test_file_of_the_specification_is_written_to_the_byte():
    encoded = encode(spec_table(), count="10 nm", source_motor=1, target_motor=2, span="40 mm")

    assert without_comments(encoded.data) == SPEC.removesuffix("SAVE\n")
    assert encoded.quantisation <= ROUNDING
    assert encoded.resampling_error <= ROUNDING
    assert encoded.step == pytest.approx(0.625e-9, abs=1e-20)


def test_file_of_the_specification_reads_as_corrections():
    table = PMAC().decode(SPEC.encode(), NOWHERE, **TOLD)

    np.testing.assert_allclose(table.positions, np.arange(9) * 5e-3, atol=1e-12, rtol=0)
    np.testing.assert_allclose(
        table.forward, -np.array(SPEC_ERROR_UM) * 1e-6, atol=ROUNDING, rtol=0
    )
    assert table.reverse is None


def test_entry_is_minus_sixteen_errors_over_the_count():
    """The sign table: an axis 1 um too far with 10 nm a count gets -1600."""
    table = CompensationTable([0.0, 1e-3], [0.0, -1e-6], None, "X", "X", 0.0)

    text = without_comments(encode(table, count=COUNT, spacing=1e-3).data)

    assert "#1 DEFINE COMP 3,#1D,#1,300000\n-1600 -800 0\n" in text


def test_negative_travel_is_read_at_the_top():
    """-5 mm stands at span - 5 mm: the last entry but one, by the manual's roll-over."""
    p = np.array([-10.0, -5.0, 0.0, 5.0, 10.0, 15.0]) * 1e-3
    c = np.array([3.0, 1.0, 0.0, -2.0, -4.0, -7.0]) * 1e-6
    table = CompensationTable(p, c, None, "X", "X", 0.0)

    encoded = encode(table, count=COUNT, span="40 mm")

    words = without_comments(encoded.data).splitlines()[3].split()
    # 5, 10, 15 mm; 20, 25 mm lie in the gap of 15 mm ... 30 mm (= -10 mm); 30 = -10, 35 = -5, 40 = 0
    at_20, at_25 = (-7 + 10 * 1 / 3) * 1600, (-7 + 10 * 2 / 3) * 1600
    assert [int(w) for w in words] == [
        -3200,
        -6400,
        -11200,
        round(at_20),
        round(at_25),
        4800,
        1600,
        0,
    ]
    back = PMAC().decode(encoded.data, NOWHERE)
    np.testing.assert_allclose(back.positions, p, atol=1e-12, rtol=0)
    np.testing.assert_allclose(back.forward, c, atol=ROUNDING, rtol=0)


def test_lookup_rolls_over_and_ignores_the_direction():
    look = PMAC().lookup(SPEC.encode(), NOWHERE, **TOLD)

    np.testing.assert_allclose(
        look([5e-3, 45e-3, -35e-3, -5e-3, 2.5e-3, 40e-3], [1, -1, 1, -1, 1, 1]),
        [-5e-7, -5e-7, -5e-7, 2e-7, -2.5e-7, 0.0],
        atol=1e-14,
        rtol=0,
    )
    with pytest.raises(DataError, match="direction"):
        look(0.0, 2)


@pytest.mark.parametrize("shift", [0.0, -20e-3, -50e-3])
def test_planted_error_shrinks_and_the_negated_one_doubles(bump, shift):
    """Zero of the motor at the left end, inside, and at the right end of the travel."""

    def error(x):
        return bump(x - shift) - bump(-shift)

    p = np.linspace(0.0, 50e-3, 101) + shift
    table = CompensationTable.from_error(error, positions=p, axis="X", reference=0.0)
    x = np.linspace(0.0, 50e-3, 997) + shift

    left = []
    for sign in (1, -1):
        chosen = table if sign > 0 else table.negated()
        added = interpret(encode(chosen, count=COUNT).data.decode(), COUNT)(x)
        left.append(np.ptp(added + error(x + added)))

    assert left[0] < 0.03 * np.ptp(error(x))  # 2 % of curvature between entries of 0.5 mm
    assert left[1] == pytest.approx(2 * np.ptp(error(x)), rel=0.03, abs=0)


def test_lookup_is_the_interpreter(table):
    chosen = CompensationTable(table.positions, table.forward, None, "X", "X", 0.0)
    data = encode(chosen, count=COUNT).data
    x = np.linspace(-0.12, 0.12, 1001)

    np.testing.assert_allclose(
        PMAC().lookup(data, NOWHERE)(x), interpret(data.decode(), COUNT)(x), atol=1e-13, rtol=0
    )


def test_travel_off_zero_keeps_its_values_and_zero_at_zero():
    """Nothing is known at the zero of the motor: the entry there is 0 all the same."""
    p = np.array([10.0, 15.0, 20.0]) * 1e-3
    table = CompensationTable(p, np.array([2.0, 5.0, 3.0]) * 1e-6, None, "X", "X", 10e-3)
    encoded = encode(table, count=COUNT)

    seen = interpret(encoded.data.decode(), COUNT)(np.array([0.0, 10e-3, 15e-3, 20e-3]))

    np.testing.assert_allclose(seen, [0.0, 2e-6, 5e-6, 3e-6], atol=1e-13, rtol=0)
    np.testing.assert_allclose(PMAC().decode(encoded.data, NOWHERE).positions, p, atol=1e-12)


@pytest.mark.parametrize("source_sign", [1, -1])
@pytest.mark.parametrize("target_sign", [1, -1])
def test_signs_of_the_motors(source_sign, target_sign):
    """The interpreter works in counts; the axes are those of the user."""
    p = np.array([0.0, 1.0, 2.0, 3.0]) * 1e-3
    table = CompensationTable(p, np.array([0.0, 1.0, 4.0, 2.0]) * 1e-6, None, "X", "Z", 0.0)
    data = encode(
        table,
        count="1 nm",
        source_count="2 nm",
        target_motor=2,
        source_sign=source_sign,
        target_sign=target_sign,
    ).data

    motor = interpret(data.decode(), 1e-9, 2e-9)(source_sign * p)

    np.testing.assert_allclose(target_sign * motor, table.forward, atol=1e-13, rtol=0)
    np.testing.assert_allclose(PMAC().lookup(data, NOWHERE)(p), table.forward, atol=1e-13, rtol=0)
    np.testing.assert_allclose(
        PMAC().decode(data, NOWHERE).forward, table.forward, atol=1e-13, rtol=0
    )


def test_zero_of_the_motor_elsewhere():
    p = np.array([100.0, 105.0, 110.0]) * 1e-3
    table = CompensationTable(p, np.array([2.0, 0.0, -3.0]) * 1e-6, None, "X", "X", 105e-3)

    encoded = encode(table, count=COUNT, motor_zero="105 mm")

    motor = interpret(encoded.data.decode(), COUNT)(np.array([-5e-3, 0.0, 5e-3]))
    np.testing.assert_allclose(motor, [2e-6, 0.0, -3e-6], atol=1e-13, rtol=0)
    back = PMAC().decode(encoded.data, NOWHERE)
    np.testing.assert_allclose(back.positions, p, atol=1e-12, rtol=0)
    with pytest.raises(TableError, match=r"zero of the motor.*motor_zero"):
        encode(table, count=COUNT, motor_zero="110 mm")


@given(
    start=st.floats(-0.2, 0.2),
    steps=st.lists(st.floats(1e-4, 2e-2), min_size=1, max_size=25),
    even=st.booleans(),
    seed=st.integers(0, 2**32 - 1),
    size=st.floats(1e-9, 1e-4),
    count=st.floats(1e-9, 1e-6),
)
@settings(derandomize=True, deadline=None, max_examples=80)
def test_round_trip_is_within_quantisation_and_resampling(start, steps, even, seed, size, count):
    rng = np.random.default_rng(seed)
    gaps = np.full(len(steps), steps[0]) if even else np.array(steps)
    p = start + np.concatenate([[0.0], np.cumsum(gaps)])
    c = size * rng.uniform(-1, 1, p.size)
    near = 1e-3 * np.diff(p).min()  # a motor's zero so close to an end is that end
    c = c - (np.interp(0.0, p, c) if p[0] <= near and p[-1] >= -near else 0.0)
    table = CompensationTable(p, c, None, "X", "X", float(p[0]))

    encoded = encode(table, count=count, long_span=True)

    x = np.linspace(p[0], p[-1], 301)
    bound = encoded.quantisation + encoded.resampling_error + 1e-9 * size + 1e-15
    assert encoded.quantisation <= count / 32 * 1.001
    wanted = table.correction(x)
    seen = interpret(encoded.data.decode(), count)(x)
    assert np.abs(seen - wanted).max() <= bound
    back = PMAC().decode(encoded.data, NOWHERE)
    assert np.abs(back.correction(x) - wanted).max() <= bound
    assert np.abs(back.forward - encoded.carried.forward).max() <= encoded.quantisation * 1.01


def test_positions_on_a_grid_through_zero_cost_no_resampling():
    p = np.array([-7.5, -2.5, 2.5, 7.5]) * 1e-3
    table = CompensationTable(p, np.array([1.0, -1.0, 1.0, 3.0]) * 1e-6, None, "X", "X", 0.0)

    encoded = encode(table, count=COUNT)

    assert encoded.notes["spacing_m"] == pytest.approx(2.5e-3, abs=1e-12)
    assert encoded.resampling_error <= ROUNDING


def test_written_with_dry_run_and_read_without_its_sidecar(tmp_path, bump):
    table = CompensationTable.from_error(
        bump, positions=np.linspace(0.0, 50e-3, 101), axis="X", compensates="Z"
    )
    path = tmp_path / "x.pmc"

    result = controllers.write(
        table, path, "pmac", count="10 nm", target_motor=2, verified_against=bump
    )

    assert result.passed
    assert result.wrong_sign_pv > 1.9 * result.before_pv
    (tmp_path / "x.pmc.json").unlink()
    back = controllers.read(path, "pmac")
    assert (back.axis, back.compensates) == ("X", "Z")
    assert np.abs(back.forward - table.forward).max() <= HALF_ENTRY * 1.01
    with pytest.raises(SignCheckFailedError):
        controllers.write(
            table.negated(), path, "pmac", count="10 nm", target_motor=2, overwrite=True,
            verified_against=bump,
        )  # fmt: skip


def test_two_directions_are_refused(table):
    with pytest.raises(TableError, match=r"direction='forward'.*pmac-backlash.*direction='both'"):
        encode(table, count=COUNT)


def test_value_at_zero_is_refused(table):
    shifted = CompensationTable(table.positions, table.forward + 1e-6, None, "X", "X", 0.0)

    with pytest.raises(TableError, match=r"must be 0 by definition.*reference"):
        encode(shifted, count=COUNT)


@pytest.mark.parametrize(
    ("options", "error", "text"),
    [
        ({"span": "39 mm"}, TableError, "shorter than the travel"),
        ({"span": "45 mm", "spacing": "2 mm"}, TableError, "not a multiple"),
        ({"target_motor": None}, TableError, "which motor is Z"),
        ({"target_motor": 1}, TableError, "a motor moves one axis"),
        ({"count": "1e-7 nm", "source_count": COUNT}, LimitError, "24 bits"),
        ({"count": "1 nm"}, LimitError, "long_span"),
        ({"spacing": "5 nm"}, LimitError, "spacing"),
        ({"spacing": "5 pm"}, LimitError, "spacing"),
        ({"count": "-10 nm"}, DataError, "above zero"),
        ({"count": 0.0}, DataError, "above zero"),
        ({"count": "10 s"}, DataError, "count"),
        ({"count": None}, DataError, "count="),
        ({"source_motor": 33}, DataError, "source_motor"),
        ({"first": "1 mm"}, TableError, "first="),
        ({"source_sign": 2}, DataError, "source_sign"),
    ],
)
def test_bad_options(options, error, text):
    with pytest.raises(error, match=text):
        encode(spec_table(), **{"count": COUNT, "target_motor": 2, **options})


def test_one_motor_has_one_count():
    own = CompensationTable([0.0, 1e-3], [0.0, 1e-6], None, "X", "X", 0.0)

    with pytest.raises(TableError, match="source_count"):
        encode(own, count=COUNT, source_count="5 nm")
    with pytest.raises(TableError, match="target_sign"):
        encode(own, count=COUNT, target_sign=-1)
    with pytest.raises(TableError, match="a motor moves one axis"):
        encode(own, count=COUNT, target_motor=2)


def test_full_span_needs_equal_ends():
    table = CompensationTable([-1e-3, 0.0, 1e-3], [1e-6, 0.0, -1e-6], None, "X", "X", 0.0)

    with pytest.raises(TableError, match=r"ends are one place.*longer span="):
        encode(table, count=COUNT, span="2 mm")


def test_entry_of_more_than_24_bits_is_refused_with_its_place():
    table = CompensationTable([0.0, 1e-3, 2e-3], [0.0, 0.1, 0.0], None, "X", "Z", 0.0)

    with pytest.raises(LimitError, match=r"100 mm at 1 mm.*check the units"):
        encode(table, count=COUNT, target_motor=2)


def test_axis_name_cannot_smuggle_a_command():
    name = "X\nI51=0"
    with pytest.raises(TableError, match=r"plain letters|name an axis"):
        encode(CompensationTable([0.0, 1e-3], [0.0, 1e-6], None, name, name, 0.0), count=COUNT)


def test_count_that_nothing_tells_is_asked_for(tmp_path):
    path = tmp_path / "x.pmc"
    path.write_text(SPEC)

    with pytest.raises(DataError, match="count"):
        controllers.read(path, "pmac")
    for name in ("source_count", "source_sign", "target_sign", "motor_zero"):
        with pytest.raises(DataError, match=name):
            controllers.read(path, "pmac", **{k: v for k, v in TOLD.items() if k != name})
    assert controllers.read(path, "pmac", **TOLD).stroke == pytest.approx(8e-7, abs=1e-15)


def test_damaged_fact_is_refused():
    data = encode(spec_table(), count=COUNT, target_motor=2).data

    with pytest.raises(CorruptFileError, match="count"):
        PMAC().decode(data.replace(b"count = 10 nm", b"count = ten nm", 1), NOWHERE)
    with pytest.raises(CorruptFileError, match="do not fit"):
        PMAC().decode(data.replace(b"last = 40 mm", b"last = 4000 mm"), NOWHERE)


def test_motors_may_be_left_away_in_a_file():
    """The Software Reference: source and target are then the motor the table belongs to."""
    text = SPEC.replace("8,#1D,#2,", "8,")

    assert PMAC().decode(text.encode(), NOWHERE, **TOLD).positions.size == 9


def test_unlike_counts_of_source_and_target():
    """Span in counts of the source, entries in counts of the target."""
    data = encode(
        spec_table(), count="1 nm", source_count="20 nm", target_motor=2, span="40 mm"
    ).data

    assert "#2 DEFINE COMP 8,#1D,#2,2000000\n-8000 -12800" in without_comments(data)


@pytest.mark.parametrize(
    ("axis", "other", "words"),
    [
        ("C", "Z", "state source_count= too, the angle"),
        ("X", "A", "count='1 um'.*A turns"),
        ("C", "C", "count='1 um'.*C turns"),
    ],
)
def test_a_count_that_is_a_length_is_not_taken_for_an_angle(axis, other, words):
    """A count of 1 um was taken as 1 urad: 4.4 um of a spindle became 5.5 um."""
    angle = np.linspace(0.0, 2.0 * np.pi, 73)
    table = CompensationTable(angle, 2e-6 * np.sin(angle), None, axis, other, 0.0)
    target = 1 if axis == other else 2

    with pytest.raises((TableError, DataError), match=words):
        encode(table, count="1 um", target_motor=target)


def opposed(tmp_path):
    """A file of motors that both count against their axes, without its sidecar."""
    table = CompensationTable(
        np.arange(5) * 1e-3, np.array([0.0, 1.0, 4.0, 2.0, 1.0]) * 1e-6, None, "X", "Z", 0.0
    )
    path = tmp_path / "x.pmc"
    data = encode(
        table, count=COUNT, source_count="5 nm", target_motor=3, source_sign=-1, target_sign=-1,
        motor_zero=0.0,
    ).data  # fmt: skip
    path.write_bytes(data)
    return path


@pytest.mark.parametrize(
    "name", ["count", "source_count", "source_sign", "target_sign", "motor_zero"]
)
def test_comment_that_was_dropped_is_asked_for(tmp_path, name):
    """Without target_sign the table was read with the other sign: 6 um of 3."""
    path = opposed(tmp_path)
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(line for line in lines if not line.startswith(f"; {name} =")))

    with pytest.raises(DataError, match=rf"states {name} \("):
        controllers.simulate(path, "pmac")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("count", "1 nm"),
        ("source_count", "10 nm"),
        ("target_sign", 1),
        ("source_sign", 1),
        ("motor_zero", "1 mm"),
        ("target_motor", 5),
        ("source_motor", 2),
        ("owner", 1),
        ("last", "5 mm"),
    ],
)
def test_option_that_contradicts_the_file_is_refused(tmp_path, name, value):
    path = opposed(tmp_path)

    controllers.read(path, "pmac", count="10 nm", target_sign=-1, target_motor=3)
    with pytest.raises(DataError, match=rf"{name}=.*{name}="):
        controllers.read(path, "pmac", **{name: value})


def test_comments_come_before_an_edited_sidecar(tmp_path):
    path = tmp_path / "x.pmc"
    table = CompensationTable.from_error(
        lambda x: 1e-3 * x, positions=np.linspace(0, 5e-3, 6), axis="X", compensates="Z"
    )
    controllers.write(table, path, "pmac", count="10 nm", target_motor=2, waive=("uncertainty",))
    beside = tmp_path / "x.pmc.json"
    whole = beside.read_text()

    for change in ({"target_sign": -1}, {"count": 1e-9}):
        edited = json.loads(whole)
        edited["options"] |= change
        beside.write_text(json.dumps(edited))
        with pytest.raises(DataError, match="the file says"):
            controllers.read(path, "pmac")


def test_fact_stated_twice_is_refused(tmp_path):
    path = opposed(tmp_path)
    path.write_text(
        path.read_text().replace("; count = 10 nm\n", "; count = 10 nm\n; count = 1 nm\n")
    )

    with pytest.raises(CorruptFileError, match="two comments state count: 10 nm and 1 nm"):
        controllers.read(path, "pmac")


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("#3 DELETE COMP", "#5 DELETE COMP", "another table"),
        ("#3 DELETE COMP", "#3 DELETE BLCOMP", "another table"),
        ("#3 DEFINE", "#4 DEFINE", "another table"),
        (",#3,", ",#1,", "target_motor"),
        ("#1D,", "#2D,", "source_motor"),
        ("; compensates = Z", "; compensates = X", "contradict"),
        ("; axis = X\n", "", "axes is missing"),
        ("; compensates = Z\n", "", "axes is missing"),
    ],
)
def test_motors_and_axes_that_contradict_each_other_are_refused(tmp_path, old, new, text):
    path = opposed(tmp_path)
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))

    with pytest.raises((CorruptFileError, DataError), match=text):
        controllers.read(path, "pmac")


def test_both_deletes_and_the_define_of_another_owner_contradict_the_comment(tmp_path):
    path = opposed(tmp_path)
    path.write_text(path.read_text().replace("#3 DE", "#4 DE"))

    with pytest.raises(DataError, match=r"owner=4.*owner=3"):
        controllers.read(path, "pmac")


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("apart", [0.0, 1e-12, 1e-10, 2e-9, 1e-7])
def test_zero_of_the_motor_a_hair_beside_the_table_is_its_end(side, apart):
    """The entry at 1 mm became 0 instead of -300 nm."""
    p = 1e-3 + 0.5e-3 * np.arange(11)
    end = p[0] if side > 0 else p[-1]
    table = CompensationTable(p, -0.3e-6 - 2e-3 * (p - p[0]), None, "X", "Z", float(p[0]))

    with pytest.raises(TableError, match="must be 0 by definition"):
        encode(table, count=COUNT, target_motor=2, motor_zero=end - side * apart)


def test_no_advice_of_instruments_for_a_file_of_a_controller():
    with pytest.raises(CorruptFileError) as caught:
        PMAC().decode(SPEC.replace("SAVE", "SAV").encode(), NOWHERE, **TOLD)
    assert "instrument" not in str(caught.value)
    with pytest.raises(CorruptFileError) as caught:
        PMAC().decode(SPEC.replace("4000000", "0").encode(), NOWHERE, **TOLD)
    assert "instrument" not in str(caught.value)


def test_ends_are_printed_without_the_rounding_of_binary():
    table = CompensationTable([-0.009000000000000001, 0.0], [1e-6, 0.0], None, "X", "X", 0.0)

    assert b"; first = -9 mm\n" in encode(table, count=COUNT).data


class TestPMAC(DialectContract):
    name = "pmac"
    hand = SPEC
    reading = TOLD
    whole = "SAVE\n"
    damage = (
        ("320 0\n", "320\n", "7 of 8 entries"),
        ("320 0\n", "320 0 0\n", "8 entries"),
        ("320 0\n", "320 0.5\n", "of 8 entries"),
        ("320 0\n", "320 1\n", "jump"),
        ("640", "0x40", "of 8 entries"),
        ("640", "1_0", "of 8 entries"),
        ("640", "99999999", "24 bits"),
        ("I51=1\n", "", "I51"),
        ("I51=1", "I51=0", "I51"),
        ("I51=1", "I52=1", "does not belong"),
        ("SAVE", "SAV", "does not belong"),
        ("SAVE", "SAVE\n#1J+", "does not belong"),
        ("DEFINE COMP 8", "DEFINE COMP 9", "8 of 9"),
        ("DEFINE COMP 8", "DEFINE COMP 7", "7 entries"),
        ("DEFINE COMP 8", "DEFINE COMP 8.2", "DEFINE line"),
        ("DEFINE COMP", "DEFINE BLCOMP", "DEFINE line"),
        (",4000000", "", "DEFINE line"),
        ("#1D,", "#0D,", "no motor #0"),
        ("#2 DEFINE", "#33 DEFINE", "no motor #33"),
        ("4000000", "0", "not a table"),
        ("DELETE GATHER", "DELETE ALL", "DEFINE line"),
        ("#2 DEFINE", "2 DEFINE", "DEFINE line"),
        ("-800", "\u2212800", "not ASCII"),
    )
