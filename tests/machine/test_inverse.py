"""Where the axes must stand, and paths that a machine with errors follows."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.machine import correct_path, inverse_kinematics, presets

PM = 1e-12
ERRORS = {
    "Y0A": 11e-6, "Z0A": -6e-6, "B0A": 20e-6, "C0A": -15e-6, "X0C": 9e-6, "Y0C": 4e-6,
    "A0C": -13e-6, "B0C": 17e-6, "C0Y": 8e-6, "B0Z": -10e-6, "A0Z": 5e-6,
    "EXX": lambda x: 4e-6 * np.sin(9 * x), "EAX": lambda x: 2e-5 * np.cos(5 * x),
}  # fmt: skip


def trunnion():
    return presets("five_axis", pivot_height=0.08)


def path(n=60, low=-50.0, high=-8.0):
    s = np.linspace(0.0, 1.0, n)
    points = np.transpose([0.04 * np.cos(6 * s), 0.03 * np.sin(5 * s), 0.01 * s])
    A, C = np.radians(low + (high - low) * s), np.radians(20.0 + 300.0 * s)
    return trunnion().inverse(points, A=A, C=C), points


def test_positions_are_those_of_the_closed_form():
    """(X, Y, Z) = Rx(-A) [h z + Rz(-C) b], eq. 13 of machines.md, typed anew."""
    b, h = np.array([0.07, -0.03, 0.045]), 0.08
    A, C = np.radians([0.0, -50.0, 25.0]), np.radians([30.0, 200.0, 310.0])
    found = trunnion().inverse(b, A=A, C=C)
    for i in range(3):
        x, y = (
            np.cos(C[i]) * b[0] + np.sin(C[i]) * b[1],
            -np.sin(C[i]) * b[0] + np.cos(C[i]) * b[1],
        )
        z = b[2] + h
        place = x, np.cos(A[i]) * y + np.sin(A[i]) * z, -np.sin(A[i]) * y + np.cos(A[i]) * z
        assert_allclose([found[a][i] for a in "XYZ"], place, rtol=0, atol=1e-15)


def test_a_lathe_without_three_linear_axes_is_refused():
    with pytest.raises(DataError, match="do not move the tool in all three directions"):
        inverse_kinematics(presets("sts_lathe"), (0.01, 0.0, 0.0), C=0.0)
    with pytest.raises(DataError, match="axis 'C' is missing"):
        trunnion().inverse((0, 0, 0), A=0.1)
    with pytest.raises(DataError, match="'B' is not an axis"):
        trunnion().inverse((0, 0, 0), A=0.1, B=0.0, C=0.0)
    with pytest.raises(InvalidSamplesError):
        trunnion().inverse((0, 0), A=0.1, C=0.0)


def test_the_corrected_path_is_the_nominal_one_on_the_machine_with_its_errors():
    q, points = path()
    found = correct_path(trunnion(), ERRORS, q)
    actual = trunnion().transform(found.q, ERRORS, exact=True)
    assert_allclose(actual[:, :3, 3], points, rtol=0, atol=PM)
    nominal = trunnion().transform(q)
    assert_allclose(actual[:, :3, 2], nominal[:, :3, 2], rtol=0, atol=1e-12)
    assert np.linalg.norm(found.before, axis=1).min() > 1e-6


def test_the_correction_with_its_sign_flipped_makes_the_path_worse():
    q, points = path()
    found = correct_path(trunnion(), ERRORS, q)
    wrong = {a: q[a] - found.correction[a] for a in q}
    off = trunnion().transform(wrong, ERRORS, exact=True)[:, :3, 3] - points
    assert np.linalg.norm(off) > 1.5 * np.linalg.norm(found.before)


def test_at_the_singular_pose_the_table_is_not_turned():
    q, points = path(81, -20.0, 20.0)
    found = correct_path(trunnion(), ERRORS, q)
    near = np.abs(q["A"]) < np.radians(0.9)
    assert near.any()
    assert np.all(found.correction["C"][near] == 0.0)
    assert np.all(found.held["C"][near])
    assert not found.held["A"].any()
    actual = trunnion().transform(found.q, ERRORS, exact=True)[:, :3, 3]
    assert_allclose(actual, points, rtol=0, atol=PM)
    assert "C hardly turns the tool at" in found.messages[1]


def test_a_path_through_the_singular_pose_does_not_jump():
    """Over 0.01 deg of A the correction of C, up to e / sin 2 deg, changes by less than 2 % of that."""
    q, points = path(801, -4.0, 4.0)
    found = correct_path(trunnion(), ERRORS, q)
    changes = found.correction["C"]
    assert np.abs(np.diff(changes)).max() < 0.02 * np.ptp(changes)
    turned = np.abs(np.degrees(q["A"])) >= 2.0
    assert found.turn_left[turned].max() < 1e-9
    assert found.turn_left[~turned].max() > 1e-6
    actual = trunnion().transform(found.q, ERRORS, exact=True)[:, :3, 3]
    assert_allclose(actual, points, rtol=0, atol=PM)


def test_a_jump_beyond_max_step_is_refused_with_its_poses():
    q, _ = path(81, -20.0, 20.0)
    with pytest.raises(DataError, match=r"correction of C jumps by .* between poses"):
        correct_path(trunnion(), ERRORS, q, max_step="0.02 deg")


def test_a_mill_is_corrected_in_position_alone():
    rng = np.random.default_rng(2)
    q = {a: rng.uniform(0.0, 0.3, 40) for a in "XYZ"}
    errors = {"EXX": lambda x: 1e-5 * x, "C0Y": 3e-5, "EBZ": lambda z: 2e-5 * z}
    mill, tool = presets("mill_xyz"), (0.05, 0.0, -0.1)
    found = correct_path(mill, errors, q, tool=tool)
    actual = mill.transform(found.q, errors, tool=tool, exact=True)[:, :3, 3]
    assert_allclose(actual, mill.transform(q, tool=tool)[:, :3, 3], rtol=0, atol=PM)
    assert np.linalg.norm(found.turn_left) > 0.0
