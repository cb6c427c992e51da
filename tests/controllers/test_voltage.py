"""Voltage tables: closed forms of a sensitivity, hysteresis, DAC and amplifier, what is refused."""

import json
import math
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from metrosep import Recording, controllers
from metrosep.compensation import CompensationTable
from metrosep.controllers.base import load_sidecar
from metrosep.controllers.options import checked_options
from metrosep.controllers.voltage import Voltage
from metrosep.errors import CorruptFileError, DataError, LimitError, TableError
from metrosep.process.flexure import flexure_calibration

NOWHERE = Path(os.devnull)
ROUNDING = 1e-14
"""Voltages are printed to 1 nV: 1.7e-15 m of a stage of 1.66 um/V."""
SENSITIVITY = 1.66e-6
"""Dual-servo paper: 16.6 um at 10 V."""
DAC_STEP = 10.0 / 65535 * SENSITIVITY
"""0.25 nm of 16 bits."""


def encode(table, **options):
    if options.get("over") == "time" and options.get("motion") != "turn":
        options = {"start": 0.0, **options}
    dialect = Voltage()
    return dialect.encode(table, **checked_options(options, dialect.options, "voltage"))


def up_curve(v):
    return 1.4e-6 * v + 0.026e-6 * v**2


def down_curve(v):
    """Wider by 0.4 um in the middle: hysteresis of 2.4 % of 16.6 um."""
    return up_curve(v) + 0.4e-6 * 4 * (v / 10) * (1 - v / 10)


@pytest.fixture(scope="session")
def calibration():
    v = np.linspace(0, 10, 41)
    volts = np.concatenate([v, v[::-1][1:]])
    moved = np.concatenate([up_curve(v), down_curve(v[::-1][1:])])
    return flexure_calibration(
        Recording(np.arange(volts.size) * 1.0, {"voltage": volts, "displacement": moved})
    )


@pytest.fixture(scope="session")
def one_way(measured):
    return CompensationTable.from_error(
        measured, positions=np.linspace(0, 50e-3, 501), axis="X", compensates="Z"
    )


def small(c=(0.0, 1.66e-6, -3.32e-6)):
    return CompensationTable(np.arange(len(c)) * 1e-3, c, None, "X", "Z", 0.0)


# -- closed forms of a sensitivity ------------------------------------------------------------


def test_hand_written_file():
    """V = (d_off + c) / S: 2, 3, 0 V of 1.66 um/V; steps of 1/1023 of 10.23 V fit them."""
    options = {"polarity": 1, "calibration": "1.66 um/V", "offset": "3.32 um", "v_max": 10.23}
    hand = b"position_mm,voltage_V\n0,2.000000000\n1,3.000000000\n2,0.000000000\n"

    made = encode(small(), **options, bits=10)

    assert made.data == hand
    given = {"polarity": 1, "calibration": SENSITIVITY, "offset": 3.32e-6, "v_max": 10.23}
    back = Voltage().decode(hand, NOWHERE, **given)
    assert back.forward == pytest.approx(small().forward, abs=ROUNDING)
    assert back.positions == pytest.approx(small().positions, abs=1e-15)


def test_polarity_and_a_stage_that_moves_back():
    volts = {}
    for polarity, sensitivity in ((1, 1), (-1, 1), (1, -1), (-1, -1)):
        made = encode(
            small(), polarity=polarity, calibration=sensitivity * SENSITIVITY, v_max=10.23, bits=10,
            offset=sensitivity * 8.3e-6,
        )  # fmt: skip
        lines = made.data.decode().splitlines()[1:]
        volts[polarity * sensitivity] = [float(x.split(",")[1]) for x in lines]

    assert volts[1] == pytest.approx([5, 6, 3], abs=1e-9)
    assert volts[-1] == pytest.approx([5, 4, 7], abs=1e-9)


def test_offset_is_the_middle_of_the_stroke_and_stands_in_the_sidecar_notes():
    made = encode(small(), polarity=1, calibration=SENSITIVITY)

    assert made.notes["drive"]["offset_um"] == pytest.approx(8.3, abs=1e-9)
    assert made.notes["drive"]["stroke_um"] == pytest.approx([0, 16.6], abs=1e-9)
    assert made.notes["drive"]["first_voltage_V"] == pytest.approx(5.0, abs=1e-4)


def test_step_of_the_dac_of_the_paper():
    made = encode(small(), polarity=1, calibration=SENSITIVITY)

    assert made.step == pytest.approx(0.2533e-9, abs=0.0001e-9)
    assert made.step == pytest.approx(DAC_STEP, abs=1e-18)
    assert 0 < made.quantisation <= DAC_STEP / 2 * 1.000001


def test_every_voltage_is_a_level_of_the_dac(one_way):
    text = encode(one_way, polarity=1, calibration=SENSITIVITY, bits=12).data.decode()
    volts = np.array([float(x.split(",")[1]) for x in text.splitlines()[1:]])

    levels = volts * 4095 / 10
    assert np.abs(levels - np.rint(levels)).max() < 1e-6


def test_nothing_is_clipped():
    with pytest.raises(LimitError, match=r"entry 2 at 0.002 .* displacement of -1.32 um"):
        encode(small(), polarity=1, calibration=SENSITIVITY, offset=2e-6)
    with pytest.raises(LimitError, match="entry 1"):
        encode(small(), polarity=1, calibration=SENSITIVITY, offset=15.5e-6)
    assert encode(small(), polarity=1, calibration=SENSITIVITY, offset=3.32e-6).data


# -- amplifier and stage ----------------------------------------------------------------------


def ramp():
    """1.66 um on 1 mm: 1 V; at 1 mm/s 1 V/s."""
    return CompensationTable([0.0, 1e-3, 2e-3], [0, 1.66e-6, 0], None, "X", "Z", 0.0)


def test_slew_of_the_amplifier():
    common = {"polarity": 1, "calibration": SENSITIVITY, "speed": "1 mm/s", "bits": 24}

    made = encode(ramp(), **common, slew=1.01)
    drive = made.notes["drive"]
    assert drive["largest_slew_V_per_s"] == pytest.approx(1.0, abs=1e-5)
    # a sine of 0.5 V and this slope
    assert drive["equivalent_frequency_Hz"] == pytest.approx(1 / math.pi, abs=1e-5)
    assert drive["largest_frequency_of_full_stroke_Hz"] == pytest.approx(1.01 / math.pi, abs=1e-5)
    with pytest.raises(LimitError, match=r"drive 0\.99 times as fast"):
        encode(ramp(), **common, slew=0.99)


def test_current_charges_the_piezo():
    """I = C g dV/dt: 6 uF at 15 x 1 V/s take 90 uA."""
    common = {"polarity": 1, "calibration": SENSITIVITY, "speed": 1e-3, "bits": 24, "gain": 15}

    assert encode(ramp(), **common, capacitance=6e-6, current=91e-6).data
    with pytest.raises(LimitError, match="amplifier makes"):
        encode(ramp(), **common, capacitance=6e-6, current=89e-6)
    with pytest.raises(DataError, match="belong together"):
        encode(ramp(), **common, current=1e-3)


def test_bandwidth_of_the_stage():
    common = {"polarity": 1, "calibration": SENSITIVITY, "speed": 1e-3}

    assert encode(ramp(), **common, bandwidth="0.33 Hz").data
    with pytest.raises(LimitError, match=r"stage follows to 0\.3 Hz"):
        encode(ramp(), **common, bandwidth="0.3 Hz")
    with pytest.raises(DataError, match="needs speed="):
        encode(ramp(), polarity=1, calibration=SENSITIVITY, bandwidth=1.0)


# -- hysteresis -------------------------------------------------------------------------------


@pytest.mark.parametrize(("branch", "curve"), [("up", up_curve), ("down", down_curve)])
def test_branch_is_the_monotone_inverse_of_its_curve(calibration, branch, curve):
    made = encode(small(), polarity=1, calibration=calibration, branch=branch, offset=8e-6)
    volts = np.array([float(x.split(",")[1]) for x in made.data.decode().splitlines()[1:]])

    assert curve(volts) == pytest.approx(8e-6 + small().forward, abs=0.3e-9)


def test_sweep_takes_the_branch_of_the_motion_in_either_pass(calibration):
    """Forward the stage falls, rises, falls; the return pass meets the other branches."""
    table = small((0.0, -2e-6, 1e-6, 3e-6, 0.5e-6))
    made = encode(table, polarity=1, calibration=calibration, branch="sweep", offset=8e-6)
    rows = np.array([[float(v) for v in x.split(",")] for x in made.data.decode().split()[1:]])

    assert rows.shape == (5, 3)
    wanted = 8e-6 + table.forward
    forward = [down_curve, down_curve, up_curve, up_curve, down_curve]
    # going back: 0.5 -> 3 rises, then falls to -2, then rises to 0
    reverse = [up_curve, down_curve, down_curve, up_curve, up_curve]
    for i in range(5):
        assert forward[i](rows[i, 1]) == pytest.approx(wanted[i], abs=0.3e-9)
        assert reverse[i](rows[i, 2]) == pytest.approx(wanted[i], abs=0.3e-9)
    assert np.abs(rows[:, 1] - rows[:, 2]).max() > 0.1


def test_mean_leaves_half_of_the_hysteresis(calibration):
    made = encode(small((0.0, 0.0)), polarity=1, calibration=calibration, offset=8e-6)
    volt = float(made.data.decode().splitlines()[1].split(",")[1])

    assert down_curve(volt) - 8e-6 == pytest.approx(8e-6 - up_curve(volt), abs=1e-9)
    assert down_curve(volt) - 8e-6 == pytest.approx(0.2e-6, abs=0.01e-6)


@pytest.mark.parametrize("branch", ["mean", "up", "down", "sweep"])
def test_written_voltages_read_back_as_the_table(calibration, branch, table):
    given = {"polarity": -1, "calibration": calibration, "branch": branch, "offset": 8e-6}
    made = encode(table, **given)

    back = Voltage().decode(made.data, NOWHERE, **given)

    assert back.forward == pytest.approx(table.forward, abs=made.quantisation + ROUNDING)
    assert back.reverse == pytest.approx(table.reverse, abs=made.quantisation + ROUNDING)
    assert made.quantisation < 0.2e-9


def test_stage_on_its_curve_removes_the_error(calibration, bump, one_way):
    """A stage written here follows the voltage along the mean curve; the sign is planted."""
    made = encode(one_way, polarity=-1, calibration=calibration)
    rows = np.array([[float(v) for v in x.split(",")] for x in made.data.decode().split()[1:]])
    x = np.linspace(0, 50e-3, 5001)
    v = np.interp(x, rows[:, 0] * 1e-3, rows[:, 1])
    stage = (up_curve(v) + down_curve(v)) / 2
    tool = -(stage - made.notes["drive"]["offset_um"] * 1e-6)

    # 0.1 mm steps: 0.8 nm; a cubic through 41 points of a quadratic: below 0.1 nm
    assert np.ptp(bump(x) + tool) < 3e-9
    assert np.ptp(bump(x) - tool) == pytest.approx(2 * np.ptp(bump(x)), abs=20e-9)


# -- over time --------------------------------------------------------------------------------


def test_over_time_each_entry_is_held_for_a_period(bump, one_way):
    given = {
        "polarity": 1, "calibration": SENSITIVITY, "over": "time", "speed": 1e-3, "sample_time": 10e-3,
        "start": 0.0,
    }  # fmt: skip
    made = encode(one_way, **given)
    rows = np.array([[float(v) for v in x.split(",")] for x in made.data.decode().split()[1:]])
    time = np.arange(0, 49.9, 1e-3)
    volts = rows[np.floor(time / 10e-3 + 1e-9).astype(int), 1]

    assert rows[:, 0] == pytest.approx(np.arange(5001) * 10e-3, abs=1e-9)
    tool = volts * SENSITIVITY - 8.3e-6
    assert np.ptp(bump(1e-3 * time) + tool) < 20e-9
    seen = Voltage().lookup(made.data, NOWHERE, **given)(1e-3 * time)
    assert np.abs(seen - tool).max() < ROUNDING
    back = Voltage().decode(made.data, NOWHERE, **given)
    assert np.abs(back.forward - made.carried.forward).max() <= made.quantisation + ROUNDING


def test_turn_over_time():
    angle = np.linspace(0, 2 * math.pi, 361)
    c = 1e-6 * np.sin(angle) + 0.2e-6 * (np.cos(2 * angle) - 1)
    table = CompensationTable(angle, c, None, "C", "Z", 0.0)
    given = {
        "polarity": 1,
        "calibration": SENSITIVITY,
        "over": "time",
        "motion": "turn",
        "points": 360,
    }
    made = encode(table, **given)

    lookup = Voltage().lookup(made.data, NOWHERE, **given)
    assert lookup(angle[:-1] + 2 * math.pi + 1e-4) == pytest.approx(c[:-1], abs=0.2e-9)
    with pytest.raises(TableError, match="are angles"):
        encode(table, polarity=1, calibration=SENSITIVITY)
    with pytest.raises(TableError, match="one for each pass"):
        encode(
            CompensationTable([0.0, 1.0], [0, 0], [0, 1e-6], "X", "Z", 0.0), polarity=1,
            calibration=SENSITIVITY, over="time", speed=1.0,
        )  # fmt: skip


# -- round trips ------------------------------------------------------------------------------


@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.integers(2, 20),
    bits=st.integers(12, 24),
    split=st.booleans(),
    polarity=st.sampled_from([1, -1]),
    sensitivity=st.floats(0.5e-6, 3e-6),
)
@settings(derandomize=True, deadline=None, max_examples=50)
def test_round_trip(seed, n, bits, split, polarity, sensitivity):
    rng = np.random.default_rng(seed)
    p = np.cumsum(rng.uniform(1e-5, 5e-3, n))
    forward, reverse = 2e-6 * rng.uniform(-1, 1, (2, n))
    table = CompensationTable(p, forward, reverse if split else None, "X", "Z", 0.0)
    given = {"polarity": polarity, "calibration": sensitivity, "bits": bits}
    made = encode(table, **given)
    x = np.linspace(p[0] - 1e-3, p[-1] + 1e-3, 301)
    lookup = Voltage().lookup(made.data, NOWHERE, **given)

    assert made.quantisation <= 0.5 * made.step + ROUNDING
    for way in (1, -1):
        assert np.abs(lookup(x, way) - table.correction(x, way)).max() <= made.quantisation * 1.01


def test_write_read_simulate(tmp_path, calibration, one_way, measured):
    path = tmp_path / "z.csv"

    result = controllers.write(
        one_way, path, "voltage", verified_against=measured, polarity=1, calibration=calibration
    )

    assert result.after_pv < 3e-9
    assert result.wrong_sign_pv > 7e-6
    # the sidecar holds the calibration: nothing has to be said again
    table = controllers.read(path, "voltage")
    assert table.forward == pytest.approx(one_way.forward, abs=0.2e-9)
    x = np.linspace(0, 50e-3, 99)
    seen = controllers.simulate(path, "voltage")(x)
    assert seen == pytest.approx(one_way.correction(x), abs=1e-9)
    assert load_sidecar(path)["drive"]["stroke_um"][1] == pytest.approx(16.6, abs=1e-6)
    with pytest.raises(TableError, match=r"shrink|doubles|grows"):
        controllers.write(
            one_way.negated(), tmp_path / "n.csv", "voltage", verified_against=measured, polarity=1,
            calibration=calibration,
        )  # fmt: skip


# -- bad input --------------------------------------------------------------------------------


HAND = "position_mm,voltage_V\n0,2.000000000\n1,3.000000000\n2,0.500000000\n"


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("position_mm", "position_um"),
        ("voltage_V", "voltage_mV"),
        ("1,3.0", "1;3.0"),
        ("1,3.0", "1,3,0"),
        ("1,3.0", "1,3e0"),
        ("1,3.0", "1,nan"),
        ("1,3.000000000", ""),
        ("1,3.0", "0,3.0"),
        ("1,3.0", "1,-0.1"),
        ("1,3.0", "1,10.1"),
        ("1,3.000000000\n2,0.500000000\n", ""),
        ("3.0", "3.0µ"),
    ],
)
def test_damaged_file_is_refused(old, new):
    with pytest.raises(CorruptFileError):
        Voltage().decode(HAND.replace(old, new, 1).encode(), NOWHERE, polarity=1, calibration=1e-6)


def test_missing_line_of_a_time_table_is_refused(one_way):
    given = {"polarity": 1, "calibration": SENSITIVITY, "over": "time", "speed": 1e-3}
    lines = encode(one_way, **given, sample_time=0.1).data.decode().splitlines()
    del lines[100]

    with pytest.raises(CorruptFileError, match="clock"):
        Voltage().decode(("\n".join(lines) + "\n").encode(), NOWHERE, **given)


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (0.0, "not zero"),
        (math.nan, "not zero"),
        ("1.66 um", "length per voltage"),
        (True, "give a FlexureCalibration"),
        ([1, 2], "give a FlexureCalibration"),
        ({"voltage_V": [0, 1]}, "voltage_V and mean_um"),
        ({"voltage_V": [0, 1], "mean_um": [0]}, "equal length"),
        ({"voltage_V": [1, 0], "mean_um": [0, 1]}, "rising"),
        ({"voltage_V": [0, 1], "mean_um": [0, None]}, "gaps"),
        ({"voltage_V": [0, 1, 2], "mean_um": [0, math.inf, 7]}, "mean_um .* infinite at 1 V"),
        ({"voltage_V": [0, 1], "mean_um": [0, 1], "up_um": [0, -math.inf]}, "equal|infinite"),
        ('{"voltage_V": [0, 1], "mean_um": [0]}', "equal length"),
        ('{"voltage_V": [0, 1', "no JSON"),
    ],
)
def test_what_is_no_calibration(value, words):
    with pytest.raises(DataError, match=words):
        encode(small(), polarity=1, calibration=value)


def test_facts_that_must_be_given(tmp_path):
    with pytest.raises(DataError, match="calibration"):
        encode(small(), polarity=1)
    with pytest.raises(DataError, match="polarity"):
        encode(small(), calibration=SENSITIVITY)
    with pytest.raises(DataError, match="needs a calibration with sweeps"):
        encode(small(), polarity=1, calibration=SENSITIVITY, branch="up")
    path = tmp_path / "a.csv"
    path.write_text(HAND)
    with pytest.raises(DataError, match="does not say"):
        controllers.read(path, "voltage")
    with pytest.raises(DataError, match="upper voltage"):
        encode(small(), polarity=1, calibration=SENSITIVITY, v_max=-1)


def test_stored_calibration_without_branches():
    stored = {"voltage_V": [0, 5, 10], "mean_um": [0, 8.3, 16.6]}
    given = {"polarity": 1, "calibration": stored}

    made = encode(small(), **given)

    assert Voltage().decode(made.data, NOWHERE, **given).forward == pytest.approx(
        small().forward, abs=DAC_STEP
    )
    with pytest.raises(DataError, match="no sweep up"):
        encode(small(), **given, branch="up")
    folded = {"voltage_V": [0, 4, 6, 10], "mean_um": [0, 8, 7, 16]}
    with pytest.raises(DataError, match="not monotone"):
        encode(small(), polarity=1, calibration=folded)


def test_sign_is_stated_by_the_user():
    assert Voltage.info.sign == "stated"
    assert "-e is added" in Voltage.info.entry


def test_every_cut_file_is_refused():
    for length in range(1, len(HAND)):
        if HAND[:length].endswith("\n") and HAND[:length].count("\n") > 2:
            continue  # whole lines: a shorter table, which only the sidecar tells
        with pytest.raises(CorruptFileError):
            Voltage().decode(HAND[:length].encode(), NOWHERE, polarity=1, calibration=1e-6)
    Voltage().decode(HAND.encode(), NOWHERE, polarity=1, calibration=1e-6, offset=2e-6)


def branches(n=201):
    """A rising stage of 1.66 um/V: behind while the voltage rises, ahead while it falls."""
    v = np.linspace(0.0, 10.0, n)
    lag = 0.2 * np.sin(np.pi * v / 10.0)
    return v, 1.66 * v, 1.66 * v - lag, 1.66 * v + lag


@pytest.mark.parametrize("sense", [1, -1])
def test_branches_that_are_exchanged_are_refused(one_way, sense):
    """Written as they were, 0.7 um of 4 um were left on the machine."""
    v, mean, up, down = branches()
    stored = {"voltage_V": v.tolist(), "mean_um": (sense * mean).tolist()}
    right = {**stored, "up_um": (sense * up).tolist(), "down_um": (sense * down).tolist()}
    swapped = {**stored, "up_um": (sense * down).tolist(), "down_um": (sense * up).tolist()}

    made = encode(one_way, polarity=1, calibration=right, branch="sweep")
    assert made.quantisation <= 2 * made.step
    assert not [f for f in made.findings if f.check == "quantisation"]
    with pytest.raises(DataError, match="exchanged"):
        encode(one_way, polarity=1, calibration=swapped, branch="sweep")
    encode(one_way, polarity=1, calibration=swapped, branch="mean")


def test_voltages_that_miss_by_more_than_rounding_are_reported(one_way):
    """Up and down differ by 40 nm against the sense of hysteresis, within what noise may be."""
    v, mean, _, _ = branches()
    lead = 0.015 * np.sin(np.pi * v / 10.0)
    stored = {
        "voltage_V": v.tolist(), "mean_um": mean.tolist(), "up_um": (mean + lead / 2).tolist(),
        "down_um": (mean - lead / 2).tolist(),
    }  # fmt: skip

    made = encode(one_way, polarity=1, calibration=stored, branch="sweep")

    assert made.quantisation > 2 * made.step
    assert [f.check for f in made.findings] == ["quantisation"]


def test_stored_calibration_as_text_of_the_command_line(tmp_path, one_way, measured):
    text = '{"voltage_V": [0, 5, 10], "mean_um": [0, 8.3, 16.6]}'

    made = encode(one_way, polarity=1, calibration=text)
    same = encode(one_way, polarity=1, calibration=json.loads(text))
    controllers.write(
        one_way,
        tmp_path / "z.csv",
        "voltage",
        verified_against=measured,
        polarity=1,
        calibration=text,
    )

    assert made.data == same.data
    assert controllers.read(tmp_path / "z.csv", "voltage").stroke == pytest.approx(
        one_way.stroke, abs=DAC_STEP
    )


def test_offset_is_asked_for_without_a_sidecar(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(HAND)

    with pytest.raises(DataError, match="does not say offset"):
        controllers.read(path, "voltage", polarity=1, calibration="1 um/V")
    table = controllers.read(path, "voltage", polarity=1, calibration="1 um/V", offset="2 um")
    assert table.forward == pytest.approx([0.0, 1e-6, -1.5e-6], abs=ROUNDING)


def test_pass_over_time_names_its_start(one_way):
    given = {"polarity": 1, "calibration": SENSITIVITY, "over": "time", "speed": 1e-3}

    whole = encode(one_way, **given, start=None, direction=-1, sample_time=0.1)
    assert whole.options == {"start": pytest.approx(50e-3, abs=1e-15)}
    part = encode(one_way, **given, start=20e-3, sample_time=0.1)
    assert [(f.level, f.check) for f in part.findings] == [("error", "coverage")]
    with pytest.raises(DataError, match="the file is over time"):
        Voltage().decode(
            part.data, NOWHERE, polarity=1, calibration=SENSITIVITY, over="position", start=0.0
        )


def test_axis_that_turns_is_no_pass():
    angle = np.linspace(0.0, 2.0 * math.pi, 73)
    table = CompensationTable(angle, 1e-6 * np.sin(angle), None, "C", "Z", 0.0)

    with pytest.raises(TableError, match="C turns, and speed= of a pass is a length"):
        encode(table, polarity=1, calibration=SENSITIVITY, over="time", speed=1e-3)


def test_positions_are_printed_without_the_rounding_of_binary():
    table = CompensationTable([-0.009000000000000001, 0.1 + 0.2], [0, 1e-6], None, "X", "Z", 0.0)

    lines = encode(table, polarity=1, calibration=SENSITIVITY).data.decode().splitlines()

    assert [x.split(",")[0] for x in lines[1:]] == ["-9", "300"]
