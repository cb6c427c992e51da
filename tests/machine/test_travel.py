"""Travels of axes: a pose beyond one is refused with its axis, its place and its number."""

import math

import numpy as np
import pytest

from metrosep.compensation import tables_from_machine
from metrosep.core.errors import DataError, LimitError
from metrosep.machine import Chain, Displacement, ReadingSet, calibrate, correct_path

TOML = """
name = "mill with ends"
[[element]]
name = "X"
branch = "workpiece"
kind = "linear"
direction = "-X"
errors_of = "tool"
travel_mm = [-50, 250]
[[element]]
name = "Y"
branch = "tool"
kind = "linear"
direction = "Y"
[[element]]
name = "Z"
branch = "tool"
kind = "linear"
direction = "Z"
travel_m = [-0.3, 0]
[[element]]
name = "B"
branch = "tool"
kind = "rotary"
direction = "Y"
travel_deg = [-95, 30]
"""


@pytest.fixture
def machine(tmp_path):
    file = tmp_path / "mill.toml"
    file.write_text(TOML)
    return Chain.from_toml(file)


def pose(**changed):
    return {"X": 0.1, "Y": 9.0, "Z": -0.1, "B": 0.0} | changed


def test_ends_themselves_are_reached_and_a_micrometre_beyond_is_not(machine):
    probe = Displacement(direction=(1, 0, 0))
    for x in (-0.05, 0.25, 0.15 + 0.1):
        machine.read(probe, pose(X=x), {"EXX": 1e-6})
    with pytest.raises(
        LimitError, match=r"pose 2 \(and 1 more\): X = 250.001 mm is outside .* -50 mm to 250 mm"
    ):
        machine.read(probe, pose(X=np.array([0.0, 0.250001, -0.06])), {"EXX": 1e-6})
    with pytest.raises(
        LimitError, match=r"B = 31 deg is outside the travel of B, -95 deg to 30 deg"
    ):
        machine.read(probe, pose(B=math.radians(31.0)), {"EXX": 1e-6})
    with pytest.raises(LimitError, match=r"Z = 1 mm is outside .* -300 mm to 0 m"):
        machine.read(probe, pose(Z=1e-3), {})


def test_inverse_kinematics_refuses_what_no_axis_reaches(machine):
    assert machine.inverse((0.2, 0.0, -0.1), B=0.0)["X"] == pytest.approx(0.2, abs=1e-12)
    with pytest.raises(LimitError, match="X = 300 mm"):
        machine.inverse((0.3, 0.0, -0.1), B=0.0)


def test_a_path_is_refused_where_its_correction_leaves_the_travel(machine):
    """X reads 2 um per 100 mm too far: at 250 mm the command is less, at -50 mm less too and so outside."""
    errors = {"EXX": lambda x: 2e-5 * (x + 0.1)}
    path = {"Y": 0.0, "Z": -0.1, "B": 0.0}
    correct_path(machine, errors, {"X": np.array([0.0, 0.25]), **path})
    with pytest.raises(LimitError, match=r"pose 1: X = -50.00\d+ mm"):
        correct_path(machine, errors, {"X": np.array([-0.05, 0.25]), **path})
    with pytest.raises(LimitError, match=r"pose 2: X = 251 mm"):
        correct_path(machine, errors, {"X": np.array([0.0, 0.251]), **path})


def test_readings_and_tables_beyond_the_travel_are_refused(machine):
    x = np.linspace(0.0, 0.26, 14)
    line = ReadingSet(Displacement(direction=(1, 0, 0)), pose(X=x), 1e-6 * x, unknown=("offset",))
    with pytest.raises(LimitError, match=r"pose 14: X = 260 mm"):
        calibrate(machine, [line], terms=["EXX"])
    at = {"Y": 0.0, "Z": -0.1, "B": 0.0}
    errors = {"EXX": lambda x: 1e-5 * x}
    tables_from_machine(
        machine, errors, over="X", positions=[-0.05, 0.0, 0.25], at=at, corrects=["X"]
    )
    with pytest.raises(LimitError, match="X = 260 mm"):
        tables_from_machine(
            machine, errors, over="X", positions=[0.0, 0.26], at=at, corrects=["X"]
        )


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[-50, 250]", "[250, -50]", "low end before"),
        ("[-50, 250]", "[250]", "2"),
        ("travel_deg", "travel_mm", "is an angle"),
        ("travel_mm", "travel_deg", "is a length"),
        ("travel_mm", "travel", "travel_mm"),
    ],
)
def test_a_travel_that_is_none_is_refused(tmp_path, old, new, said):
    file = tmp_path / "mill.toml"
    file.write_text(TOML.replace(old, new, 1))
    with pytest.raises(DataError, match=said):
        Chain.from_toml(file)


def test_the_description_names_the_travel(machine):
    assert "travel -50 mm to 250 mm" in machine.describe()
    assert "travel -95 deg to 30 deg" in machine.describe()
