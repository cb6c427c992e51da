"""What instruments read: numbers of machines.md (bodies and lines in space), and lines drawn here."""

from __future__ import annotations

import numpy as np
import pytest
from numpy import cos, pi, sin
from numpy.testing import assert_allclose

from metrosep.core.errors import DataError, InvalidSamplesError, UnitError
from metrosep.machine import (
    Angle,
    Ballbar,
    Chain,
    Displacement,
    Element,
    Length,
    Nest,
    at_functional_point,
    presets,
)

PRINTED = 0.51e-12
"""m or rad: half of the last digit of the table, um with six decimals."""
SECOND = 1e-9
"""m: products of two errors of 20 um or urad and levers below 0.2 m, which first order leaves out."""
ROUNDING = 1e-17

MILL_ERRORS = {
    "EXX": lambda x: 8e-6 * x / 0.5,
    "EYX": lambda x: 1.2e-6 * sin(2 * pi * x / 0.5),
    "EZX": lambda x: 3e-6 * sin(pi * x / 0.5),
    "EAX": lambda x: -9e-6 * (x / 0.5) ** 2,
    "EBX": lambda x: 14e-6 * (sin(pi * x / 0.5 + 0.7) - sin(0.7)),
    "ECX": lambda x: 5e-6 * sin(2 * pi * x / 0.5),
    "EAY": lambda y: 6e-6 * y / 0.4,
    "EBY": lambda y: -4e-6 * (y / 0.4) ** 2,
    "ECY": lambda y: 7e-6 * sin(pi * y / 0.4),
    "EAZ": lambda z: 3e-6 * z / 0.3,
    "EBZ": lambda z: -8e-6 * z / 0.3,
    "ECZ": lambda z: 2e-6 * (z / 0.3) ** 2,
    "C0Y": 12e-6,
    "B0Z": -7e-6,
    "A0Z": 9e-6,
}
LOCATIONS = {
    "Y0A": 11e-6, "Z0A": -6e-6, "B0A": 20e-6, "C0A": -15e-6, "X0C": 9e-6, "Y0C": 4e-6,
    "A0C": -13e-6, "B0C": 17e-6, "C0Y": 8e-6, "B0Z": -10e-6, "A0Z": 5e-6,
}  # fmt: skip
BALL = (0.07, -0.03, 0.045)
PIVOT = 0.08


def at(x, y, z):
    return {"X": x, "Y": y, "Z": z}


def trunnion(ball=BALL):
    """Positions at which the nest stands at the ball, by drawing: C about the table, A about X."""
    A, C = np.radians([0.0, -50.0, 25.0]), np.radians([30.0, 200.0, 310.0])
    points = []
    for a, c in zip(A, C, strict=True):
        on_table = turned((0, 0, 1), -c, np.array(ball)) + np.array([0, 0, PIVOT])
        points.append(turned((1, 0, 0), -a, on_table))
    x, y, z = np.transpose(points)
    return {"X": x, "Y": y, "Z": z, "A": A, "C": C}


def turned(axis, angle, v):
    k = np.asarray(axis, dtype=float)
    k = k / np.linalg.norm(k)
    return v * cos(angle) + np.cross(k, v) * sin(angle) + k * (k @ v) * (1 - cos(angle))


@pytest.mark.parametrize(
    ("place", "tool", "error"),
    [
        ((0.13, 0, 0), (0, 0, 0), (2.080000, 1.197632, 2.186906)),
        ((0.13, 0.21, 0.17), (0, 0, 0), (-2.022058, -0.764440, 2.059142)),
        ((0.37, 0.05, 0.28), (0.04, -0.03, -0.11), (3.147289, -2.722069, 2.578499)),
    ],
)
def test_an_indicator_reads_the_error_along_its_direction(place, tool, error):
    mill = presets("mill_xyz")
    found = [
        mill.read(Displacement(direction=e), at(*place), MILL_ERRORS, tool=tool) for e in np.eye(3)
    ]
    assert_allclose(found, np.array(error) * 1e-6, rtol=0, atol=PRINTED)


def test_levels_read_the_turn_of_the_tool_against_the_work():
    q, tool = at(0.37, 0.05, 0.28), (0.04, -0.03, -0.11)
    found = [
        presets("mill_xyz").read(Angle(direction=e), q, MILL_ERRORS, tool=tool) for e in np.eye(3)
    ]
    assert_allclose(
        found, np.array([-1.378400, -14.916534, -0.569127]) * 1e-6, rtol=0, atol=PRINTED
    )


def test_a_level_on_the_tool_alone_does_not_see_the_table():
    mill, q = presets("mill_xyz"), at(0.37, 0.05, 0.28)
    alone = mill.read(Angle(direction=(0, 1, 0), end="bed"), q, MILL_ERRORS)
    assert_allclose(alone, -8e-6 * 0.28 / 0.3, rtol=0, atol=ROUNDING)
    both = mill.read(Angle(direction=(0, 1, 0)), q, MILL_ERRORS)
    assert abs(both - alone) > 1e-6


def test_a_ballbar_reads_the_change_of_its_length():
    a = np.radians([20, 110, 200, 290])
    q = at(0.25 + 0.1 * cos(a), 0.2 + 0.1 * sin(a), 0.1)
    found = presets("mill_xyz").read(Ballbar(ball=(0.25, 0.2, 0.1)), q, MILL_ERRORS)
    expected = np.array([1.616426, -0.199411, 0.489655, 2.121956]) * 1e-6
    assert_allclose(found, expected, rtol=0, atol=PRINTED)


def test_a_tracer_reads_lengths_from_its_station():
    q = at(np.array([0.1, 0.45]), np.array([0.3, 0.1]), np.array([0.05, 0.25]))
    tracer = Length(station=(-0.4, -0.2, 0.9), dead_path=0.02)
    tool = (0.04, -0.03, -0.11)
    mill = presets("mill_xyz")
    found = mill.read(tracer, q, MILL_ERRORS, tool=tool)
    assert_allclose(found, np.array([-2.207713, 1.363633]) * 1e-6, rtol=0, atol=PRINTED)
    whole = mill.read(tracer, q, MILL_ERRORS, tool=tool, total=True)
    away = np.transpose([q["X"] + 0.44, q["Y"] + 0.17, q["Z"] - 1.01])
    assert_allclose(whole, np.linalg.norm(away, axis=1) + 0.02 + found, rtol=0, atol=1e-15)


def test_a_nest_reads_the_location_errors_of_a_trunnion_table():
    expected = [
        (-12.112442, -15.525673, 6.895256),
        (-11.941871, -15.177536, 1.206292),
        (-14.659116, -13.952614, 10.749151),
    ]
    found = presets("five_axis", pivot_height=PIVOT).read(Nest(), trunnion(), LOCATIONS)
    # the positions of the table are printed to a nanometre; times 20 urad that is nothing
    assert_allclose(found, np.array(expected) * 1e-6, rtol=0, atol=PRINTED)


def test_a_nest_reads_motions_of_the_rotary_table_in_machine_directions():
    errors = {
        "EXC": lambda c: 4e-6 * cos(3 * c),
        "EZC": lambda c: 1e-6 * sin(2 * c),
        "EBC": lambda c: 6e-6 * cos(2 * c),
    }
    expected = [
        (0.135000, 0, 0.729160),
        (-1.793168, -0.687879, 0.577199),
        (-3.510987, -0.386266, -0.828351),
    ]
    machine = presets("five_axis", pivot_height=PIVOT)
    found = machine.read(Nest(), trunnion(), errors)
    assert_allclose(found, np.array(expected) * 1e-6, rtol=0, atol=PRINTED)
    other = machine.read(Nest(senses="workpiece"), trunnion(), errors)
    assert_allclose(other, -found, rtol=0, atol=0)


def test_lines_in_space_give_what_the_nest_reads():
    """A ball turned about two lines that stand wrong, a spindle on travels that are not square."""
    n = LOCATIONS
    q = trunnion()
    read = presets("five_axis", pivot_height=PIVOT).read(Nest(), q, n)
    exact = presets("five_axis", pivot_height=PIVOT).read(Nest(), q, n, exact=True)
    for i in range(3):
        c_line = np.array([n["X0C"], n["Y0C"], PIVOT]), np.array([n["B0C"], -n["A0C"], 1.0])
        a_line = np.array([0.0, n["Y0A"], n["Z0A"]]), np.array([1.0, n["C0A"], -n["B0A"]])
        centre = np.add(BALL, (0.0, 0.0, PIVOT))
        # the table goes with the line of C: where the ball is at C = 0 moves with it
        off = np.array([n["X0C"], n["Y0C"], 0.0]) + np.cross([n["A0C"], n["B0C"], 0.0], BALL)
        centre = c_line[0] + turned(c_line[1], -q["C"][i], centre + off - c_line[0])
        turn_a = np.array([0.0, n["B0A"], n["C0A"]])
        centre = centre + np.array([0.0, n["Y0A"], n["Z0A"]]) + np.cross(turn_a, centre)
        centre = a_line[0] + turned(a_line[1], -q["A"][i], centre - a_line[0])
        centre = centre - q["Y"][i] * np.array([-n["C0Y"], 1.0, 0.0])
        tool = np.array([q["X"][i], 0.0, 0.0]) + q["Z"][i] * np.array([n["B0Z"], -n["A0Z"], 1.0])
        assert_allclose(read[i], tool - centre, rtol=0, atol=SECOND)
        assert_allclose(exact[i], tool - centre, rtol=0, atol=SECOND)


def test_a_mirrored_direction_reads_the_opposite():
    mill, q = presets("mill_xyz"), at(0.3, 0.1, 0.2)
    one = mill.read(Displacement(direction=(0, 0, 1)), q, MILL_ERRORS)
    other = mill.read(Displacement(direction=(0, 0, -1)), q, MILL_ERRORS)
    assert one != 0.0
    assert_allclose(other, -one, rtol=0, atol=0)


def test_turns_are_what_the_tool_point_does_further_out():
    machine = presets("five_axis", pivot_height=PIVOT)
    rng = np.random.default_rng(4)
    q = {a: rng.normal(size=7) for a in machine.axes}
    turns = machine.turn_jacobian(q)
    here = machine.jacobian(q, tool=(0.1, 0.2, -0.3))
    pose = machine.transform(q)
    for i in range(3):
        arm = np.zeros(3)
        arm[i] = 0.5
        there = machine.jacobian(q, tool=np.array([0.1, 0.2, -0.3]) + arm)
        reach = pose[..., :3, :3] @ arm
        expected = np.cross(np.moveaxis(turns, -1, -2), reach[:, None, :])
        assert_allclose(np.moveaxis(there - here, -1, -2), expected, rtol=0, atol=1e-14)


# ---- change of line ------------------------------------------------------------------------------


OPTICS = (0.31, 0.05, 0.08)


def curves_at(x):
    raw = {
        0.1: (1.727948, 2.168677, 0.785362),
        0.25: (4.135099, 0.180000, 2.786175),
        0.4: (5.836026, -0.252492, 0.573400),
    }
    functional = {
        0.1: (1.600000, 1.141268, 1.763356),
        0.25: (4.0, 0.0, 3.0),
        0.4: (6.4, -1.141268, 1.763356),
    }
    return np.array([raw[v] for v in x]) * 1e-6, np.array([functional[v] for v in x]) * 1e-6


def test_optics_on_the_table_are_carried_to_the_functional_point():
    x = np.array([0.1, 0.25, 0.4])
    raw, functional = curves_at(x)
    places = np.append(0.0, x)  # with home, where angles are zero
    angles = {n: MILL_ERRORS[n](places) for n in ("EAX", "EBX", "ECX")}
    values = {f"E{d}X": np.append(0.0, raw[:, i]) for i, d in enumerate("XYZ")}
    found = at_functional_point("X", places, values, angles, point=OPTICS, fixed_to="workpiece")
    got = np.transpose([found[f"E{d}X"][1:] for d in "XYZ"])
    assert_allclose(got, functional, rtol=0, atol=1.1e-12)


def test_a_probe_on_the_tool_side_keeps_its_lever():
    x = np.array([0.0, 0.2])
    found = at_functional_point(
        "X", x, {"EZX": [0.0, 0.0]}, {"EAX": [0.0, 1e-5], "EBX": [0.0, 0.0]},
        point=(0.0, 0.3, 0.0), fixed_to="tool",
    )  # fmt: skip
    assert_allclose(found["EZX"], [0.0, -3e-6], rtol=0, atol=ROUNDING)


def test_the_squareness_moves_with_the_line():
    x = np.linspace(0.0, 0.5, 501)
    slopes = []
    for z in (0.0, 0.1, 0.2):
        raw = MILL_ERRORS["EYX"](x) - z * MILL_ERRORS["EAX"](x)
        slopes.append(np.polyfit(x, raw, 1)[0])
    assert_allclose(np.array(slopes) * 1e6, [-4.556228, -2.756228, -0.956228], rtol=0, atol=2e-6)
    raw = MILL_ERRORS["EYX"](x) - 0.2 * MILL_ERRORS["EAX"](x)
    found = at_functional_point(
        "X", x, {"EYX": raw}, {"EAX": MILL_ERRORS["EAX"](x)}, point=(0, 0, 0.2), fixed_to="tool"
    )
    assert_allclose(np.polyfit(x, found["EYX"], 1)[0] * 1e6, slopes[0] * 1e6, rtol=0, atol=1e-9)


def test_angles_are_taken_from_home():
    x = np.array([0.0, 0.1])
    found = at_functional_point(
        "X", x, {"EYX": [0.0, 0.0]}, {"EAX": [7e-6, 9e-6]}, point=(0, 0, 0.5), fixed_to="tool"
    )
    assert_allclose(found["EYX"], [0.0, 1e-6], rtol=0, atol=ROUNDING)
    assert "EAX is 7 urad at home" in found.messages[0]


def test_a_straightness_without_the_angle_of_its_lever_is_refused_by_name():
    with pytest.raises(DataError, match=r"EYX was read 200 mm away in Z: EAX is needed"):
        at_functional_point(
            "X", [0.0, 0.1], {"EYX": [0.0, 0.0]}, point=(0, 0, 0.2), fixed_to="tool"
        )
    alone = at_functional_point(
        "X", [0.0, 0.1], {"EYX": [0.0, 1e-6]}, point=(0, 0, 0), fixed_to="tool"
    )
    assert alone["EYX"].tolist() == [0.0, 1e-6]


def test_what_the_point_travels_with_is_never_guessed():
    with pytest.raises(DataError, match="fixed_to"):
        at_functional_point("X", [0.0], {"EYX": [0.0]}, point=(0, 0, 0), fixed_to="table")


def test_the_share_of_the_lever_is_in_the_uncertainty():
    found = at_functional_point(
        "X", [0.0, 0.1], {"EYX": [0.0, 0.0]}, {"EAX": [0.0, 0.0]}, point=(0, 0, 0.3),
        fixed_to="tool", u={"EYX": 10e-9, "EAX": 0.1e-6},
    )  # fmt: skip
    assert_allclose(found.u["EYX"], np.hypot(10e-9, 30e-9), rtol=1e-12, atol=0)
    assert_allclose(found.u_of_lever["EYX"], 30e-9, rtol=1e-12, atol=0)


# ---- bad input -----------------------------------------------------------------------------------


def test_bad_instruments_are_refused_in_a_sentence():
    with pytest.raises(DataError, match="unit vector"):
        Displacement(direction=(0, 0, 2))
    with pytest.raises(InvalidSamplesError, match="three finite numbers"):
        Ballbar(ball=(0, 1))
    with pytest.raises(UnitError, match="lengths are in m"):
        Length(station=(300, 0, 0))
    with pytest.raises(DataError, match="senses"):
        Nest(senses="table")
    chain = Chain([Element("X", "tool", "linear", (1, 0, 0)), Element("C", "workpiece", "rotary")])
    with pytest.raises(DataError, match="stands on its other end"):
        chain.read(Ballbar(ball=(0.1, 0, 0)), {"X": 0.1, "C": 0.0}, {"EXX": 1e-6})
    with pytest.raises(DataError, match="instrument"):
        chain.read("ballbar", {"X": 0.1, "C": 0.0}, {"EXX": 1e-6})
    with pytest.raises(DataError, match="EXQ"):
        chain.read(Displacement(direction=(1, 0, 0)), {"X": 0.1, "C": 0.0}, {"EXQ": 1e-6})


def test_a_position_that_is_nan_reads_nan():
    found = presets("mill_xyz").read(
        Displacement(direction=(1, 0, 0)), at([0.1, np.nan], 0, 0), {"EXX": 1e-6}
    )
    assert found[0] == 1e-6
    assert np.isnan(found[1])
