"""Presets: the files load, and every planted error moves the tool the way it must."""

from __future__ import annotations

import numpy as np
import pytest

from metrosep.core.errors import DataError
from metrosep.machine.chains import preset_table, presets

TINY = 1e-18  # m; rounding of products of 1e-6 and 0.1 m
SMALL = 1e-6

CHAINS = {
    "fts_lathe": ({"radius": 0.02}, {"C": 0.0, "X": 0.005, "FTS": 1e-3, "Z": 0.0}, 25),
    "sts_lathe": ({}, {"C": 0.0, "X": 0.015, "Z": 1e-3}, 21),
    "mill_xyz": ({}, {"X": 0.1, "Y": 0.2, "Z": 0.3}, 21),
    "five_axis": ({"pivot_height": 0.05}, {"X": 0.1, "Y": 0.2, "Z": 0.3, "A": 0.0, "C": 0.0}, 41),
}


def moved(name, errors, **changes):
    parameters, q, _ = CHAINS[name]
    return presets(name, **parameters).volumetric_error({**q, **changes}, errors)


def test_the_list_holds_what_is_shipped():
    assert presets() == tuple(sorted(CHAINS))


@pytest.mark.parametrize("name", CHAINS)
def test_number_of_terms_and_names(name):
    parameters, q, n = CHAINS[name]
    chain = presets(name, **parameters)
    assert len(chain.terms) == n
    assert chain.name == name
    assert chain.description
    assert set(chain.axes) == set(q)


@pytest.mark.parametrize("name", CHAINS)
def test_axes_move_the_tool_in_their_own_direction(name):
    parameters, q, _ = CHAINS[name]
    chain = presets(name, **parameters)
    start = chain.transform(q)[:3, 3]
    for axis in set("XYZ") & set(q):
        step = chain.transform({**q, axis: q[axis] + 1e-3})[:3, 3] - start
        expected = 1e-3 * np.eye(3)["XYZ".index(axis)]
        if name == "fts_lathe" and axis == "X":
            expected = -expected  # the paper's x runs towards the centre
        assert np.abs(step - expected).max() < 1e-15, axis


@pytest.mark.parametrize("name", CHAINS)
def test_straightness_and_position_errors_of_slides_move_the_tool(name):
    _, q, _ = CHAINS[name]
    for axis in set("XYZ") & set(q):
        for k, direction in enumerate("XYZ"):
            got = moved(name, {f"E{direction}{axis}": SMALL})
            assert np.abs(got - SMALL * np.eye(3)[k]).max() < TINY, (axis, direction)


# Planted squareness: the travel of the second axis leans; expected shift of the tool by hand.
@pytest.mark.parametrize(
    ("name", "term", "expected"),
    [
        ("fts_lathe", "B0Z", (0, 0, -0.005)),  # -x eta, eq 1
        ("sts_lathe", "B0Z", (0, 0, 0.015)),  # the same slope outwards
        ("mill_xyz", "C0Y", (-0.2, 0, 0)),  # +y leans to -x
        ("mill_xyz", "A0Z", (0, -0.3, 0)),  # +z leans to -y
        ("mill_xyz", "B0Z", (0.3, 0, 0)),  # +z leans to +x
        ("five_axis", "C0Y", (-0.2, 0, 0)),
        ("five_axis", "A0Z", (0, -0.3, 0)),
        ("five_axis", "B0Z", (0.3, 0, 0)),
    ],
)
def test_squareness(name, term, expected):
    assert np.abs(moved(name, {term: SMALL}) - SMALL * np.array(expected)).max() < TINY


def test_squareness_of_both_lathes_is_one_slope():
    # fts: tool at R - x, sts: tool at x. Same B0Z, same tilt of a faced surface.
    fts = [moved("fts_lathe", {"B0Z": SMALL}, X=0.02 - rho)[2] for rho in (0.004, 0.014)]
    sts = [moved("sts_lathe", {"B0Z": SMALL}, X=rho)[2] for rho in (0.004, 0.014)]
    assert fts[1] - fts[0] == pytest.approx(0.01e-6, abs=TINY)
    assert sts[1] - sts[0] == pytest.approx(0.01e-6, abs=TINY)


def test_angles_of_the_mill_act_over_the_lever_of_the_tool():
    # Tool 0.3 m above the table's frame at Z = 0.3; roll of the table about X, read at the tool.
    assert np.abs(moved("mill_xyz", {"EAX": SMALL}) - [0, -0.3e-6, 0.2e-6]).max() < TINY
    # Z carries the tool point itself: no lever without a tool offset.
    assert np.abs(moved("mill_xyz", {"EBZ": SMALL})).max() < TINY


@pytest.mark.parametrize("choice", ["co-rotating", "fixed"])
def test_spindles_of_the_lathes_agree(choice):
    fts = presets("fts_lathe", radius=0.02, spindle_errors=choice)
    sts = presets("sts_lathe", spindle_errors=choice)
    for term in ("EXC", "EYC", "EZC", "EAC", "EBC", "ECC"):
        for theta in (0.0, 0.4, 2.0):
            one = fts.volumetric_error({"C": theta, "X": 0.005, "FTS": 1e-3}, {term: SMALL})
            two = sts.volumetric_error({"C": theta, "X": 0.015, "Z": 1e-3}, {term: SMALL})
            assert np.abs(one - two).max() < TINY, (term, theta)


def test_a_positive_rotary_axis_turns_the_tool_about_the_positive_axis():
    chain = presets("five_axis", pivot_height=0.0)
    q = {"X": 0.1, "Y": 0.2, "Z": 0.3, "A": 0.0, "C": 0.0}
    start = chain.transform(q)[:3, 3]
    for axis, direction in (("A", (1, 0, 0)), ("C", (0, 0, 1))):
        step = chain.transform({**q, axis: 1e-7})[:3, 3] - start
        assert np.abs(step - 1e-7 * np.cross(direction, start)).max() < 1e-13
        # an angular positioning error does the same as the motion it adds to
        error = chain.volumetric_error(q, {f"E{axis}{axis}": 1e-7})
        assert np.abs(error - 1e-7 * np.cross(direction, start)).max() < TINY


def test_pivot_height_is_the_lever_of_a():
    chain = presets("five_axis", pivot_height=0.05)
    q = {"X": 0.0, "Y": 0.0, "Z": 0.05, "A": 0.3, "C": 0.0}
    point = chain.transform({**q, "A": 0.0})[:3, 3]
    assert np.abs(point).max() < 1e-15  # tool in the datum of the table
    turned = chain.transform(q)[:3, 3]
    expected = [0.0, -0.05 * np.sin(0.3), 0.05 * (np.cos(0.3) - 1.0)]
    assert np.abs(turned - expected).max() < 1e-15


def test_offset_of_a_rotary_axis_turns_with_the_workpiece():
    # C axis and table displaced by +X0C: the tool stands at -X0C in the workpiece, and half a turn
    # later at +X0C.
    still = moved("five_axis", {"X0C": SMALL}, C=0.0)
    half = moved("five_axis", {"X0C": SMALL}, C=np.pi)
    assert np.abs(still - [-SMALL, 0, 0]).max() < TINY
    assert np.abs(half - [SMALL, 0, 0]).max() < TINY


def test_leaning_spindle_axis_of_the_lathe_cuts_a_cone():
    # The spindle axis leans to +x (B0C): what is cut at radius rho lies too high by B0C rho.
    for rho in (0.005, 0.015):
        heights = [moved("sts_lathe", {"B0C": SMALL}, C=c, X=rho, Z=0.0)[2] for c in (0, 1, 4)]
        assert np.abs(np.array(heights) - SMALL * rho).max() < TINY


def test_tables_are_new_each_time():
    table = preset_table("mill_xyz")
    table["element"].clear()
    assert len(preset_table("mill_xyz")["element"]) == 3


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("fts", {}, "there are five_axis, fts_lathe"),
        ("fts_lathe", {}, "'radius' is missing"),
        ("fts_lathe", {"radius": -0.02}, "must be positive and finite, got -0.02 m"),
        (
            "fts_lathe",
            {"radius": np.nan},
            "radius of fts_lathe must be a finite number in m, got nan",
        ),
        ("fts_lathe", {"radius": 0.02, "height": 1.0}, "no parameter 'height'; it has radius"),
        ("mill_xyz", {"radius": 0.02}, "no parameter 'radius'; it has none"),
        ("fts_lathe", {"radius": 0.02, "spindle_errors": "turning"}, "co-rotating, fixed"),
        ("mill_xyz", {"spindle_errors": "fixed"}, "no spindle errors"),
    ],
)
def test_bad_presets(name, options, message):
    with pytest.raises(DataError, match=message):
        presets(name, **options)


# Of the lathe with the paper's x, that runs along -X, the error of the position is -EXX.
AGAINST = {("fts_lathe", "X")}


@pytest.mark.parametrize("name", CHAINS)
def test_positioning_errors_are_those_of_the_positions_but_for_one(name):
    parameters, _, _ = CHAINS[name]
    chain = presets(name, **parameters)
    rng = np.random.default_rng(4)
    q = {axis: 0.3 * rng.normal() for axis in chain.axes}
    tool = (0.01, 0.02, -0.07)  # off every axis, so that no column vanishes
    step = 1e-6
    for e in chain.elements:
        letter = ("XYZ" if e.kind == "linear" else "ABC")[int(np.argmax(np.abs(e.direction)))]
        column = chain.jacobian(q, tool=tool, terms=[f"E{letter}{e.name}"])[:, 0]
        ahead, behind = (
            chain.transform({**q, e.name: q[e.name] + s}, tool=tool)[:3, 3] for s in (step, -step)
        )
        moved = (ahead - behind) / (2 * step)
        ratio = float(moved @ column / (column @ column))
        expected = -1.0 if (name, e.name) in AGAINST else 1.0
        assert ratio == pytest.approx(expected, abs=1e-8), e.name  # central difference
        assert np.abs(moved - expected * column).max() < 1e-8


def test_an_fts_lathe_whose_x_runs_too_far():
    chain = presets("fts_lathe", radius=0.02)
    q = {"C": 0.0, "X": 0.005, "FTS": 0.0}
    far = chain.transform({**q, "X": 0.005 + 1e-6})[:3, 3] - chain.transform(q)[:3, 3]
    assert np.abs(chain.volumetric_error(q, {"EXX": -1e-6}) - far).max() < TINY
    assert "EXX = -1 um" in presets.__doc__
