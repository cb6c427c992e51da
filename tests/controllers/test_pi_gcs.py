"""PI wave tables: a hand-written file, a generator played in the test, what is refused."""

import json
import math
import os
from pathlib import Path

import numpy as np
import pytest
from contracts.dialect import DialectContract
from hypothesis import given, settings, strategies as st

from metrosep import Profile, controllers
from metrosep.compensation import CompensationTable
from metrosep.controllers.base import load_sidecar
from metrosep.controllers.options import checked_options
from metrosep.controllers.waves import PiGcs
from metrosep.errors import CorruptFileError, DataError, LimitError, TableError

NOWHERE = Path(os.devnull)
ROUNDING = 1e-15
"""Values of 10 um in double: 2e-21 m; times um and sums of a few: far below."""
QUANTUM = 0.5e-12
"""Six decimals of um: half a picometre."""

HAND = """WAV 1 X PNT 1 3 0 1.234567 -0.5
WAV 1 & PNT 4 2 0.000002 1.5
WSL 2 1
WTR 2 100 0
WOS 2 2
WGC 2 1
WGO 2 1
"""
"""1 mm/s, 100 periods of 50 us a point: a point every 5 um."""
HAND_OPTIONS = {
    "polarity": 1, "travel": 5e-6, "offset": 2e-6, "speed": 1e-3, "servo_time": 50e-6, "start": 0.0,
    "direction": 1,
}  # fmt: skip

PASS = {
    "polarity": 1,
    "travel": "15 um",
    "speed": "60 mm/min",
    "rate": 200,
    "memory": 262144,
    "start": 0.0,
}


@pytest.fixture(scope="session")
def one_way(bump, measured):
    return CompensationTable.from_error(
        measured, positions=np.linspace(0, 50e-3, 501), axis="X", compensates="Z"
    )


def encode(table, **options):
    if options.get("motion") != "turn":
        options = {"start": 0.0, **options}
    dialect = PiGcs()
    return dialect.encode(table, **checked_options(options, dialect.options, "pi-gcs"))


def play(data, *, speed, start, servo=50e-6):
    """A wave generator written from the manual: servo tick by servo tick, no library code."""
    points, offset, rate, interpolation, cycles = [], 0.0, 1, 0, 1
    for line in data.decode().splitlines():
        words = line.split()
        if words[0] == "WAV":
            if words[2] == "X":
                points = []
            points += [float(w) for w in words[6:]]
        elif words[0] == "WTR":
            rate, interpolation = int(words[2]), int(words[3])
        elif words[0] == "WOS":
            offset = float(words[2])
        elif words[0] == "WGC":
            cycles = int(words[2])
    ticks = np.arange(len(points) * rate)
    if cycles == 1:
        ticks = ticks[: (len(points) - 1) * rate + 1]
    out = []
    for tick in ticks:
        i, part = divmod(int(tick), rate)
        value = points[i]
        if interpolation:
            following = points[(i + 1) % len(points)]
            value += (following - value) * part / rate
        out.append(offset + value)
    return start + speed * servo * ticks, np.array(out) * 1e-6


# -- the hand-written file --------------------------------------------------------------------


def test_hand_written_file_is_read():
    table = PiGcs().decode(HAND.encode(), NOWHERE, **HAND_OPTIONS)

    assert table.positions == pytest.approx(np.arange(5) * 5e-6, abs=1e-15)
    wanted = [0, 1.234567e-6, -0.5e-6, 2e-12, 1.5e-6]
    assert table.forward == pytest.approx(np.array(wanted), abs=ROUNDING)
    assert table.reverse is None


def test_hand_written_file_is_written_byte_for_byte():
    table = CompensationTable(
        np.arange(5) * 5e-6, [0, 1.234567e-6, -0.5e-6, 2e-12, 1.5e-6], None, "X", "Z", 0.0
    )

    made = encode(
        table, polarity=1, travel=5e-6, offset=2e-6, speed=1e-3, rate=100, generator=2,
        interpolation=0, bunch=3,
    )  # fmt: skip

    assert made.data.decode() == HAND


def test_opposed_piezo_turns_the_sign_of_the_points_only():
    table = CompensationTable(np.arange(3) * 5e-6, [0, 1e-6, -2e-6], None, "X", "Z", 0.0)
    common = {"travel": 10e-6, "offset": 4e-6, "speed": 1e-3, "rate": 100, "start": 0.0}

    made = encode(table, polarity=-1, **common).data.decode().splitlines()

    assert made[0] == "WAV 1 X PNT 1 3 0 -1 2"
    assert made[3] == "WOS 1 4"
    back = PiGcs().decode(("\n".join(made) + "\n").encode(), NOWHERE, polarity=-1, **common)
    assert back.forward == pytest.approx(table.forward, abs=ROUNDING)


def test_no_value_is_written_with_an_exponent():
    table = CompensationTable(np.arange(3) * 5e-6, [1e-12, -3e-12, 1e-6], None, "X", "Z", 0.0)

    text = encode(table, polarity=1, travel=1e-5, speed=1e-3, rate=100).data.decode()

    assert text.splitlines()[0] == "WAV 1 X PNT 1 3 0.000001 -0.000003 1"
    assert "e" not in text.lower()


# -- played as the generator plays it ----------------------------------------------------------


@pytest.mark.parametrize("interpolation", [0, 1])
@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("polarity", [1, -1])
def test_played_wave_removes_the_error(bump, one_way, interpolation, direction, polarity):
    start = 0.0 if direction > 0 else 50e-3
    made = encode(
        one_way, polarity=polarity, travel=15e-6, speed=1e-2, rate=20, direction=direction,
        start=start, interpolation=interpolation,
    )  # fmt: skip
    where, stage = play(made.data, speed=direction * 1e-2, start=start)

    moved = polarity * (stage - 7.5e-6)
    before, after, wrong = bump(where), bump(where) + moved, bump(where) - moved

    # a point is 10 um of travel, the steepest slope 0.9e-3 rising and falling: 9 nm each way;
    # drawn lines leave the 0.1 mm steps of the table: 3 um / (3 mm)^2 x (0.1 mm)^2 / 4 = 0.8 nm
    assert np.ptp(after) < (20e-9 if interpolation == 0 else 2e-9)
    assert np.ptp(wrong) == pytest.approx(2 * np.ptp(before), abs=0.05e-6)


@pytest.mark.parametrize("interpolation", [0, 1])
@pytest.mark.parametrize("direction", [1, -1])
def test_lookup_is_what_the_generator_puts_out(one_way, interpolation, direction):
    start = 10e-3 if direction > 0 else 40e-3
    given = {
        "polarity": 1, "travel": 15e-6, "speed": 1e-2, "rate": 5, "direction": direction,
        "start": start, "interpolation": interpolation,
    }  # fmt: skip
    made = encode(one_way, **given)
    where, stage = play(made.data, speed=direction * 1e-2, start=start)

    lookup = PiGcs().lookup(made.data, NOWHERE, **given)

    middle = direction * 0.5 * 1e-2 * 50e-6
    seen = lookup(where[:-1] + middle, direction)
    assert np.abs(seen - (stage[:-1] - 7.5e-6)).max() < ROUNDING
    assert np.abs(lookup(where, direction) - (stage - 7.5e-6)).max() < ROUNDING


def test_resampling_error_is_that_of_the_staircase(bump, one_way):
    made = encode(one_way, polarity=1, travel=15e-6, speed=1e-3, rate=2000, interpolation=0)
    fine = np.linspace(0, 49.9e-3, 400_001)
    held = -bump(np.floor(fine / 1e-4 + 1e-9) * 1e-4)

    assert made.resampling_error == pytest.approx(np.abs(held + bump(fine)).max(), abs=1e-9)


def test_before_and_after_a_pass_the_ends_are_held():
    lookup = PiGcs().lookup(HAND.encode(), NOWHERE, **HAND_OPTIONS)

    assert lookup([-1e-3, 1.0]) == pytest.approx(np.array([0.0, 1.5e-6]), abs=ROUNDING)


def test_direction_is_one_of_two():
    lookup = PiGcs().lookup(HAND.encode(), NOWHERE, **HAND_OPTIONS)

    with pytest.raises(DataError, match=r"\+1 or -1"):
        lookup(1e-6, 0)


# -- one turn ---------------------------------------------------------------------------------


def turn_table(n=721, closing=0.0):
    angle = np.linspace(0, 2 * math.pi, n)
    ripple = 1e-6 * np.cos(angle - 0.4) + 0.3e-6 * np.sin(3 * angle)
    error = ripple - ripple[0] + closing * angle / (2 * math.pi)
    return CompensationTable(angle, -error, None, "C", "Z", 0.0)


TURN = {"polarity": 1, "travel": 10e-6, "motion": "turn", "rate": 20}


def test_turn_repeats_without_a_doubled_point():
    table = turn_table()
    made = encode(table, **TURN, points=720, interpolation=0)
    lookup = PiGcs().lookup(made.data, NOWHERE, **TURN, points=720)
    angle = np.arange(720) * 2 * math.pi / 720

    assert b"PNT 711 10" in made.data
    assert b"WGC 1 0\n" in made.data
    for turns in (0, 1, -1, 1000):
        seen = lookup(angle + 1e-4 + turns * 2 * math.pi)
        assert seen == pytest.approx(table.forward[:720], abs=1e-12)
    assert made.notes["playback"]["turns_per_minute"] == pytest.approx(60 / 0.72, abs=1e-9)


def test_turn_is_read_back_closed():
    made = encode(turn_table(), **TURN, points=360)
    table = PiGcs().decode(made.data, NOWHERE, **TURN, points=360)

    assert table.positions.size == 361
    assert table.positions[-1] == pytest.approx(2 * math.pi, abs=1e-12)
    assert table.forward[-1] == table.forward[0]


def test_rotation_gives_the_points_and_must_fit():
    made = encode(turn_table(), **TURN, rotation="2 Hz")
    assert b"PNT 491 10" in made.data
    assert b"PNT 501" not in made.data

    with pytest.raises(
        DataError, match=r"run away from the spindle; turn at 2.13219616205 1/s for 469 points"
    ):
        encode(turn_table(), **TURN, rotation=2.13)
    with pytest.raises(DataError, match="needs points"):
        encode(turn_table(), **TURN)


def test_turn_that_does_not_close_is_refused():
    with pytest.raises(TableError, match="jump by 5 nm every turn"):
        encode(turn_table(closing=5e-9), **TURN, points=360)
    assert encode(turn_table(closing=5e-9), **TURN, points=360, closing="5.1 nm").data


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("start", ["0 deg", "90 deg", "-400 deg"])
def test_turn_may_start_anywhere_and_run_either_way(start, direction):
    table = turn_table()
    given = {**TURN, "points": 720, "start_angle": start, "direction": direction}
    options = checked_options(given, PiGcs.options, "pi-gcs")
    made = PiGcs().encode(table, **{**options, "interpolation": 0})
    points = [
        float(v) for x in made.data.decode().split("\n") if "PNT" in x for v in x.split()[6:]
    ]

    first = math.radians(float(start.split()[0]))
    angle = np.mod(first + direction * np.arange(720) * 2 * math.pi / 720, 2 * math.pi)
    wanted = np.interp(angle, table.positions, table.forward)
    assert np.array(points) * 1e-6 == pytest.approx(wanted, abs=1e-12)
    lookup = PiGcs().lookup(
        made.data,
        NOWHERE,
        **{k: v for k, v in options.items() if v is not None and k != "interpolation"},
    )
    assert lookup(angle + direction * 1e-4) == pytest.approx(wanted, abs=1e-12)


def test_unit_of_the_speed_gone_wrong_is_refused(one_way):
    with pytest.raises(LimitError, match="check the unit of the speed"):
        encode(one_way, polarity=1, travel=15e-6, speed=1e-12)
    with pytest.raises(LimitError, match="check the unit of the speed"):
        encode(turn_table(), **TURN, rotation=1e-9)


def test_turn_not_measured_whole_is_refused():
    angle = np.linspace(0, 6.0, 50)
    table = CompensationTable(angle, 0 * angle, None, "C", "Z", 0.0)

    with pytest.raises(TableError, match="measure the whole turn"):
        encode(table, **TURN, points=360)


# -- round trips ------------------------------------------------------------------------------


@given(
    start=st.floats(-0.2, 0.2),
    length=st.floats(1e-3, 0.1),
    seed=st.integers(0, 2**32 - 1),
    rate=st.integers(100, 3000),
    interpolation=st.sampled_from([0, 1]),
    polarity=st.sampled_from([1, -1]),
    direction=st.sampled_from([1, -1]),
)
@settings(derandomize=True, deadline=None, max_examples=40)
def test_round_trip(start, length, seed, rate, interpolation, polarity, direction):
    rng = np.random.default_rng(seed)
    p = start + length * np.linspace(0, 1, 9)
    table = CompensationTable(p, 3e-6 * rng.uniform(-1, 1, 9), None, "X", "Z", start)
    given = {
        "polarity": polarity, "travel": 15e-6, "speed": 2e-3, "rate": rate,
        "interpolation": interpolation, "direction": direction,
        "start": float(p[0] if direction > 0 else p[-1]),
    }  # fmt: skip
    made = encode(table, **given)
    lookup = PiGcs().lookup(made.data, NOWHERE, **given)
    back = PiGcs().decode(made.data, NOWHERE, **given)

    x = np.linspace(p[0], p[-1], 501)
    steepest = np.abs(np.diff(table.forward) / np.diff(p)).max()
    bound = made.quantisation + 1.01 * steepest * 2e-3 * 50e-6 * rate
    assert made.quantisation <= QUANTUM * 1.0001
    assert np.abs(lookup(x, direction) - table.correction(x)).max() <= bound
    assert np.abs(back.forward - made.carried.forward).max() <= made.quantisation + ROUNDING
    assert np.abs(back.positions - made.carried.positions).max() <= 1e-12


def test_write_read_simulate(tmp_path, one_way, measured):
    path = tmp_path / "z.gcs"

    result = controllers.write(one_way, path, "pi-gcs", verified_against=measured, **PASS)

    assert result.after_pv < 10e-9
    assert result.wrong_sign_pv > 7e-6
    table = controllers.read(path, "pi-gcs")
    x = np.linspace(0, 50e-3, 77)
    assert table.correction(x) == pytest.approx(one_way.correction(x), abs=10e-9)
    seen = controllers.simulate(path, "pi-gcs")(x)
    assert seen == pytest.approx(one_way.correction(x), abs=10e-9)
    played = load_sidecar(path)["playback"]
    assert played["points"] == 5001
    assert played["direction"] == 1
    assert played["stand_before_start_um"] == pytest.approx(7.5, abs=1e-9)
    assert json.dumps(played)


# -- bad input --------------------------------------------------------------------------------


def test_polarity_and_travel_are_never_assumed(one_way):
    with pytest.raises(DataError, match="polarity"):
        encode(one_way, travel=1e-5, speed=1e-3)
    with pytest.raises(DataError, match="travel"):
        encode(one_way, polarity=1, speed=1e-3)
    with pytest.raises(DataError, match="needs speed="):
        encode(one_way, polarity=1, travel=1e-5)


def test_two_columns_are_refused(table):
    with pytest.raises(TableError, match="one for each pass"):
        encode(table, polarity=1, travel=1e-5, speed=1e-3, rate=200)


def test_travel_is_kept(one_way):
    with pytest.raises(
        LimitError, match=r"displacement of -500 nm, the stage moves 0 \.\.\. 5 um"
    ):
        encode(one_way, polarity=1, travel=5e-6, speed=1e-3, rate=200)
    assert encode(one_way, polarity=1, travel=5e-6, offset=3.5e-6, speed=1e-3, rate=200).data


def test_memory_is_kept_and_the_rate_named(one_way):
    with pytest.raises(LimitError, match="use rate=123"):
        encode(one_way, polarity=1, travel=15e-6, speed=1e-3, memory=8192)
    made = encode(one_way, polarity=1, travel=15e-6, speed=1e-3, memory=8192, rate=123)
    assert made.data.count(b"WAV") == math.ceil((math.ceil(50e-3 / (123 * 50e-9)) + 1) / 10)


def test_start_outside_the_table_is_refused(one_way):
    with pytest.raises(TableError, match="start inside"):
        encode(one_way, polarity=1, travel=15e-6, speed=1e-3, rate=200, start=-1e-3)
    with pytest.raises(TableError, match="does not reach the end"):
        encode(one_way, polarity=1, travel=15e-6, speed=1e-3, rate=200, start=60e-3)


def test_staircase_too_coarse_is_refused(tmp_path, one_way):
    with pytest.raises(LimitError, match="misses the table"):
        controllers.write(
            one_way, tmp_path / "z.gcs", "pi-gcs", **{**PASS, "rate": 40000, "interpolation": 0}
        )


def test_jump_at_the_start_is_reported():
    table = CompensationTable([0.0, 1e-3], [2e-6, 1e-6], None, "X", "Z", 0.0)
    made = encode(table, polarity=1, travel=1e-5, speed=1e-3, rate=200)

    assert any("jumps" in f.problem and "2000 nm" in f.problem for f in made.findings)


@pytest.mark.parametrize("gone", [0, 2, 3, 4, 5, 6])
def test_file_without_a_line_is_refused(gone):
    """Without the second bunch it is a shorter wave: only the sidecar's hash knows."""
    lines = HAND.splitlines()
    del lines[gone]

    with pytest.raises(CorruptFileError):
        PiGcs().decode(("\n".join(lines) + "\n").encode(), NOWHERE, **HAND_OPTIONS)


def test_contradicting_option_is_refused():
    with pytest.raises(DataError, match="WTR says rate=100, you say rate=50"):
        PiGcs().decode(HAND.encode(), NOWHERE, **HAND_OPTIONS, rate=50)


def test_reading_without_what_the_file_cannot_say(tmp_path):
    path = tmp_path / "a.gcs"
    path.write_text(HAND)

    with pytest.raises(DataError, match="states polarity"):
        controllers.read(path, "pi-gcs")
    told = {k: v for k, v in HAND_OPTIONS.items() if k not in ("offset", "servo_time")}
    for name in told:
        with pytest.raises(DataError, match=f"states {name} "):
            controllers.read(path, "pi-gcs", **{k: v for k, v in told.items() if k != name})
    table = controllers.read(path, "pi-gcs", **{**told, "start": 7e-3, "direction": -1})
    assert table.positions == pytest.approx(7e-3 - np.arange(4, -1, -1) * 5e-6, abs=1e-15)


def test_sign_is_stated_by_the_user():
    assert PiGcs.info.sign == "stated"
    assert "polarity x (-e)" in PiGcs.info.entry


def test_integer_positions_and_inputs_are_left_alone():
    table = CompensationTable([0, 1], [0, 1e-6], None, "X", "Z", 0.0)
    before = table.forward.copy()

    encode(table, polarity=1, travel=1e-5, speed=1.0, rate=200)

    assert np.array_equal(table.forward, before)
    assert Profile([0.0, 1.0], [0.0, 1.0]).z.size == 2


# -- what was dropped, contradicted or guessed -------------------------------------------------


@pytest.mark.parametrize(("direction", "begin"), [(1, "-0.03"), (-1, "0.05")])
def test_a_pass_starts_at_the_end_of_the_table_where_it_comes_from(direction, begin):
    """start was 0 by default: of -30 ... 50 mm the first 30 mm were not played, without a word."""
    table = CompensationTable([-30e-3, 0.0, 50e-3], [1e-6, 0.0, 2e-6], None, "X", "Z", 0.0)
    given = {"polarity": 1, "travel": 15e-6, "speed": 1e-3, "rate": 2000, "direction": direction}

    chosen = encode(table, **given, start=None)
    whole = encode(table, **given, start=float(begin))
    assert chosen.data == whole.data
    assert chosen.options == {"start": pytest.approx(float(begin), abs=1e-15)}
    assert not [f for f in whole.findings if f.check == "coverage"]
    part = encode(table, **given, start=0.0)
    found = [f for f in part.findings if f.check == "coverage"]
    assert [f.level for f in found] == ["error"]
    assert "not played" in found[0].problem


def test_part_of_a_table_is_written_only_if_that_is_waived(tmp_path, one_way, measured):
    given = {**PASS, "start": "3 mm", "verified_against": measured}

    with pytest.raises(LimitError, match=r"not played.*waive='coverage'"):
        controllers.write(one_way, tmp_path / "a.gcs", "pi-gcs", **given)
    controllers.write(one_way, tmp_path / "a.gcs", "pi-gcs", waive="coverage", **given)


def test_cut_turn_is_refused_by_points_and_by_rotation(tmp_path):
    """Without its last line 350 points were taken for a turn: 0.48 um off."""
    whole = encode(turn_table(), **TURN, points=360).data.decode()
    lines = [x for x in whole.splitlines() if not x.startswith("WAV 1 & PNT 351 ")]
    path = tmp_path / "t.gcs"
    path.write_text("\n".join(lines) + "\n")
    known = {**TURN, "start_angle": 0.0, "direction": 1}

    for told in ({"points": 360}, {"rotation": 1 / 0.36}):
        with pytest.raises(DataError, match=r"holds 350 points.*360.*cut"):
            controllers.read(path, "pi-gcs", **known, **told)
    with pytest.raises(DataError, match="needs points="):
        controllers.read(path, "pi-gcs", **known)
    path.write_text(whole)
    assert controllers.read(path, "pi-gcs", **known, points=360).positions.size == 361


def test_offset_and_points_beyond_the_travel_are_refused(tmp_path):
    path = tmp_path / "a.gcs"
    told = {k: v for k, v in HAND_OPTIONS.items() if k != "servo_time"}

    for old, new, text in (
        ("WOS 2 2", "WOS 2 750", "WOS is not the offset"),
        ("1.234567", "900", "point 2 is beyond the travel"),
        ("1.5", "3.1", "point 5 is beyond the travel"),
        ("-0.5", "-2.1", "point 3 is beyond the travel"),
    ):
        path.write_text(HAND.replace(old, new))
        with pytest.raises(CorruptFileError, match=text):
            controllers.read(path, "pi-gcs", **told)
    path.write_text(HAND.replace("WOS 2 2", "WOS 2 750"))
    with pytest.raises(CorruptFileError, match="beyond the travel"):
        controllers.read(path, "pi-gcs", **{k: v for k, v in told.items() if k != "offset"})


def test_option_that_contradicts_the_sidecar_is_refused(tmp_path, one_way, measured):
    path = tmp_path / "a.gcs"
    controllers.write(one_way, path, "pi-gcs", verified_against=measured, **PASS)

    with pytest.raises(DataError, match=r"polarity=1, you say polarity=-1"):
        controllers.simulate(path, "pi-gcs", polarity=-1)


def test_motion_must_be_that_of_the_axis():
    """60 mm/min of C was 0.001 rad/s; a table of 6.28 m was played as a turn."""
    turning = turn_table()
    with pytest.raises(TableError, match="C turns, and speed= of a pass is a length"):
        encode(turning, polarity=1, travel=15e-6, speed="60 mm/min", rate=2000)
    linear = CompensationTable(turning.positions, turning.forward, None, "X", "Z", 0.0)
    with pytest.raises(TableError, match="X does not"):
        encode(linear, **TURN, points=360)


class TestPiGcs(DialectContract):
    name = "pi-gcs"
    hand = HAND
    reading = HAND_OPTIONS
    damage = (
        ("PNT 1 3", "PNT 1 4"),
        ("PNT 4 2", "PNT 5 2"),
        ("WAV 1 &", "WAV 1 X"),
        ("WAV 1 &", "WAV 2 &"),
        ("WAV 1 X", "WAV 1 +"),
        ("1.234567", "1,234567"),
        ("1.234567", "nan"),
        ("1.234567", "1_2"),
        ("WSL 2 1", "WSL 2 3"),
        ("WTR 2", "WTR 1"),
        ("WTR 2 100 0", "WTR 2 100 7"),
        ("WTR 2 100 0", "WTR 2 0 0"),
        ("WTR 2 100 0", "WTR 2 1.5 0"),
        ("WOS 2 2", "WOS 2"),
        ("WGC 2 1", "WGC 2 5"),
        ("WGC 2 1", "WGC 2 0"),
        ("WGO 2 1", "WGO 2 0"),
        ("WGO 2 1\n", "WGO 2 1\nWGO 2 1\n"),
        ("WSL 2 1", "\nWSL 2 1"),
        ("WAV", "SIN"),
        ("WAV", "WÄV"),
    )

    def may_be_cut(self, text):
        return text.endswith("WGO 2 1")
