"""NV200 waveforms: a hand-written file, the buffer played in the test, what is refused."""

import math
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from metrosep import controllers
from metrosep.compensation import CompensationTable
from metrosep.controllers.options import checked_options
from metrosep.controllers.waves import MAX_POINTS, NV200
from metrosep.errors import CorruptFileError, DataError, LimitError, TableError

NOWHERE = Path(os.devnull)
ROUNDING = 1e-15
"""Values of 10 um in double: 2e-21 m."""
QUANTUM = 0.5e-12
"""Six decimals of um: half a picometre."""

HAND = """gparb,0,2
gparb,1,3.234567
gparb,2,1.5
gparb,3,2.000002
gsarb,0
gearb,3
goarb,0
gcarb,1
gtarb,100
grun,1
"""
HAND_OPTIONS = {
    "polarity": 1,
    "travel": 5e-6,
    "offset": 2e-6,
    "speed": 1e-3,
    "start": 0.0,
    "direction": 1,
}


@pytest.fixture(scope="session")
def one_way(measured):
    return CompensationTable.from_error(
        measured, positions=np.linspace(0, 50e-3, 501), axis="X", compensates="Z"
    )


def encode(table, **options):
    if options.get("motion") != "turn":
        options = {"start": 0.0, **options}
    dialect = NV200()
    return dialect.encode(table, **checked_options(options, dialect.options, "nv200"))


def play(data, cycles=1):
    """The amplifier, from its manual: each point is held gtarb x 50 us; no library code."""
    buffer, numbers = {}, {}
    for line in data.decode().split():
        name, *rest = line.split(",")
        if name == "gparb":
            buffer[int(rest[0])] = float(rest[1])
        else:
            numbers[name] = int(rest[0])
    order = range(numbers["gsarb"], numbers["gearb"] + 1)
    held = [buffer[i] for _ in range(cycles) for i in order]
    return numbers["gtarb"] * 50e-6, np.array(held) * 1e-6


def test_hand_written_file_is_read_and_written():
    table = NV200().decode(HAND.encode(), NOWHERE, **HAND_OPTIONS)
    wanted = np.array([0, 1.234567e-6, -0.5e-6, 2e-12])

    assert table.positions == pytest.approx(np.arange(4) * 5e-6, abs=1e-15)
    assert table.forward == pytest.approx(wanted, abs=ROUNDING)
    made = encode(
        CompensationTable(np.arange(4) * 5e-6, wanted, None, "X", "Z", 0.0),
        **HAND_OPTIONS,
        rate=100,
    )
    assert made.data.decode() == HAND


@pytest.mark.parametrize("polarity", [1, -1])
@pytest.mark.parametrize("direction", [1, -1])
def test_played_wave_removes_the_error(bump, one_way, polarity, direction):
    start = 0.0 if direction > 0 else 50e-3
    made = encode(
        one_way, polarity=polarity, travel=15e-6, speed=1e-3, rate=1000, direction=direction,
        start=start,
    )  # fmt: skip
    dwell, held = play(made.data)
    time = np.arange(0, 49.9, 1e-3)
    where = start + direction * 1e-3 * time
    moved = polarity * (held[np.floor(time / dwell + 1e-9).astype(int)] - 7.5e-6)

    # a point is 50 um of travel, the steepest slope 0.9e-3: 45 nm each way of 4 um
    assert np.ptp(bump(where) + moved) < 0.1e-6
    assert np.ptp(bump(where) - moved) == pytest.approx(2 * np.ptp(bump(where)), abs=0.1e-6)


def test_turn_is_endless_and_closes():
    angle = np.linspace(0, 2 * math.pi, 361)
    c = 1e-6 * np.sin(angle) + 0.2e-6 * (np.cos(2 * angle) - 1)
    table = CompensationTable(angle, c, None, "C", "Z", 0.0)
    given = {"polarity": 1, "travel": 10e-6, "motion": "turn", "rate": 20, "points": 360}
    made = encode(table, **given)
    dwell, held = play(made.data, cycles=3)

    assert b"gcarb,0\n" in made.data
    assert dwell == pytest.approx(1e-3, abs=1e-15)
    lookup = NV200().lookup(made.data, NOWHERE, **given)
    place = np.arange(3 * 360) * 2 * math.pi / 360 + 1e-4
    assert lookup(place) == pytest.approx(held - 5e-6, abs=ROUNDING)
    assert NV200().decode(made.data, NOWHERE, **given).forward == pytest.approx(c, abs=2e-12)


@given(seed=st.integers(0, 2**32 - 1), n=st.integers(2, 12), polarity=st.sampled_from([1, -1]))
@settings(derandomize=True, deadline=None, max_examples=40)
def test_round_trip(seed, n, polarity):
    rng = np.random.default_rng(seed)
    p = np.cumsum(rng.uniform(1e-3, 5e-3, n))
    table = CompensationTable(p, 3e-6 * rng.uniform(-1, 1, n), None, "X", "Z", 0.0)
    given = {
        "polarity": polarity, "travel": 10e-6, "speed": 1e-3, "rate": 1500, "start": float(p[0]),
    }  # fmt: skip
    made = encode(table, **given)
    lookup = NV200().lookup(made.data, NOWHERE, **given)
    x = np.linspace(p[0], p[-1], 301)
    steepest = np.abs(np.diff(table.forward) / np.diff(p)).max()

    assert made.quantisation <= QUANTUM * 1.0001
    worst = np.abs(lookup(x) - table.correction(x)).max()
    assert worst <= made.quantisation + 1.01 * steepest * 75e-6
    assert worst <= made.resampling_error + made.quantisation + 1e-12


def test_write_read_simulate(tmp_path, one_way, measured):
    path = tmp_path / "z.txt"
    given = {"polarity": 1, "travel": "15 um", "speed": "60 mm/min", "rate": 1000, "start": 0.0}

    result = controllers.write(one_way, path, "nv200", verified_against=measured, **given)

    assert result.after_pv < 0.1e-6
    x = np.linspace(0, 50e-3, 1001)
    c = one_way.correction(x)
    assert controllers.read(path, "nv200").correction(x) == pytest.approx(c, abs=0.05e-6)
    assert controllers.simulate(path, "nv200")(x) == pytest.approx(c, abs=0.05e-6)
    with pytest.raises(TableError, match=r"shrink|doubles|grows"):
        controllers.write(
            one_way.negated(), tmp_path / "n.txt", "nv200", verified_against=measured, **given
        )


def test_limits_of_the_buffer(one_way):
    common = {"polarity": 1, "travel": 15e-6, "speed": 1e-3}
    with pytest.raises(LimitError, match="1024; use rate=977"):
        encode(one_way, **common, rate=100)
    assert encode(one_way, **common, rate=978).data.count(b"gparb") == MAX_POINTS
    with pytest.raises(LimitError, match="65535"):
        encode(one_way, **common, rate=65536)
    with pytest.raises(LimitError, match="needs a displacement"):
        encode(one_way, polarity=1, travel=5e-6, speed=1e-3, rate=1000)


def test_two_columns_are_refused(table):
    with pytest.raises(TableError, match="one for each pass"):
        encode(table, polarity=1, travel=15e-6, speed=1e-3, rate=1000)


@pytest.mark.parametrize("gone", range(10))
def test_file_without_a_line_is_refused(gone):
    lines = HAND.splitlines()
    del lines[gone]

    with pytest.raises(CorruptFileError):
        NV200().decode(("\n".join(lines) + "\n").encode(), NOWHERE, **HAND_OPTIONS)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("gparb,1,", "gparb,2,"),
        ("3.234567", "3,234567"),
        ("3.234567", "3.2e0"),
        ("gearb,3", "gearb,4"),
        ("gsarb,0", "gsarb,1"),
        ("goarb,0", "goarb,2"),
        ("gcarb,1", "gcarb,0"),
        ("gtarb,100", "gtarb,0"),
        ("gtarb,100", "gtarb,70000"),
        ("grun,1", "grun,0"),
        ("grun,1\n", "grun,1\ngrun,1\n"),
        ("grun", "grün"),
    ],
)
def test_damaged_file_is_refused(old, new):
    with pytest.raises(CorruptFileError):
        NV200().decode(HAND.replace(old, new, 1).encode(), NOWHERE, **HAND_OPTIONS)


def test_what_the_file_cannot_say_is_asked(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text(HAND)

    with pytest.raises(DataError, match="does not say polarity"):
        controllers.read(path, "nv200")
    with pytest.raises(DataError, match="does not say travel"):
        controllers.read(path, "nv200", polarity=1)
    with pytest.raises(DataError, match="gtarb says rate=100"):
        controllers.read(path, "nv200", rate=5, **HAND_OPTIONS)


def test_sign_is_stated_by_the_user():
    assert NV200.info.sign == "stated"
    assert "d_off + polarity x (-e)" in NV200.info.entry


def test_nothing_is_guessed_without_a_sidecar(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text(HAND)

    for name in HAND_OPTIONS:
        with pytest.raises(DataError, match=f"does not say {name} "):
            controllers.read(path, "nv200", **{k: v for k, v in HAND_OPTIONS.items() if k != name})
    assert controllers.read(path, "nv200", **HAND_OPTIONS).positions.size == 4


@pytest.mark.parametrize("value", ["93.2", "5.1", "-0.1"])
def test_point_beyond_the_travel_is_refused(value):
    with pytest.raises(CorruptFileError, match="point 1 is beyond the travel"):
        NV200().decode(HAND.replace("3.234567", value).encode(), NOWHERE, **HAND_OPTIONS)


def test_cut_turn_is_refused(tmp_path):
    angle = np.linspace(0, 2 * math.pi, 361)
    table = CompensationTable(angle, 1e-6 * np.sin(angle), None, "C", "Z", 0.0)
    given = {"polarity": 1, "travel": 10e-6, "offset": 5e-6, "motion": "turn", "points": 360}
    text = encode(table, **given, rate=20).data.decode()
    cut = "".join(x for x in text.splitlines(True) if "gparb,359," not in x)
    path = tmp_path / "t.txt"
    path.write_text(cut.replace("gearb,359", "gearb,358"))

    with pytest.raises(DataError, match="holds 359 points"):
        controllers.read(path, "nv200", **given, start_angle=0.0, direction=1)


def test_buffer_is_declared_and_longer_tables_are_sampled(tmp_path, measured):
    assert NV200.info.max_points == 1024
    long = CompensationTable.from_error(
        measured, positions=np.linspace(0, 50e-3, 3001), axis="X", compensates="Z"
    )
    path = tmp_path / "a.txt"

    controllers.write(
        long, path, "nv200", polarity=1, travel="15 um", speed="60 mm/min", rate=1000, start=0.0
    )

    assert path.read_text().count("gparb") == 1001


def test_part_of_a_table_is_an_error(one_way):
    made = encode(one_way, polarity=1, travel=15e-6, speed=1e-3, rate=1000, start=8e-3)

    assert [(f.level, f.check) for f in made.findings] == [("error", "coverage")]
