"""From tolerance to corrected program, on the part of slow-tool-servo and on others."""

from __future__ import annotations

import numpy as np
import pytest

from metrosep.errors import DataError, TooFewSamplesError
from metrosep.forms import Expression, SineGrid
from metrosep.process._follow_result import FollowUpMap
from metrosep.process.budget import Contribution
from metrosep.process.jobs import TurningJob
from metrosep.process.predictions import pv_quantities
from metrosep.process.tool_settings import ToolSetting

NM = 1e-9
STRAIGHT = 0.02e-9
"""m: straight lines between samples of the log 2.4 um apart, A (k h)^2 / 8 with A = 6 nm."""
GRID = SineGrid(amplitude=50e-9, wavelength=100e-6)
SMALL = TurningJob(GRID, 150e-6, 3e-6, rpm=20)


def test_plan_holds_its_tolerance_and_says_how_long_it_takes():
    plan = SMALL.plan(2 * NM)
    again = plan.path.error_map(GRID, sub_points=16)
    assert again.peak_to_valley() <= 2.02 * NM
    assert plan.minutes == pytest.approx(150 / 3 / 20, abs=1e-9)  # turns over rpm
    slow = TurningJob(GRID, 150e-6, 3e-6, rpm=20, block_time=0.1)
    assert slow.time(plan.path).seconds == pytest.approx(0.1 * plan.n_points, abs=1e-6)


def test_causes_are_evaluated_at_the_same_points_and_add():
    path = SMALL.path(step=np.deg2rad(4))
    tool = ToolSetting(dx=1e-6, dR=50e-6, u_dx=0.1e-6, u_dR=0.0)

    found = SMALL.predict(path, tool=tool)

    expected = tool.error(GRID, found.x[1:-1], found.y[1:-1])
    np.testing.assert_allclose(found.maps["tool setting"][1:-1], expected, atol=1e-18)
    program = path.error_map(GRID)
    np.testing.assert_array_equal(found.maps["program"], program.z)
    total = found.budget.combine("pointwise").pv
    assert total == pytest.approx(np.nanmax(found.total) - np.nanmin(found.total), abs=1e-18)
    assert total < found.budget.combine("sum").pv


def test_tool_uncertainty_reaches_the_budget():
    # P-V of dx on the map is 2 pi * 2 A / lambda per direction of the steepest slope: linear in dx
    path = SMALL.path(step=np.deg2rad(5))
    known = SMALL.predict(path, tool=ToolSetting(dx=1e-6, u_dx=0.1e-6))
    tool = known.budget.contributions[0]
    assert tool.u == pytest.approx(0.1 * tool.pv, abs=0.002 * tool.pv)
    assert SMALL.predict(path, tool=ToolSetting(dx=1e-6)).budget.contributions[0].u is None


def test_uncertain_dy_widens_the_core_that_is_left_out():
    found = SMALL.predict(SMALL.path(step=np.deg2rad(5)), tool=ToolSetting(dy=1e-6, u_dy=0.5e-6))
    tool = found.budget.contributions[0]
    assert 0.3 * tool.pv < tool.u < 0.7 * tool.pv


def test_the_core_of_dy_is_not_cut():
    found = SMALL.predict(SMALL.path(step=np.deg2rad(5)), tool=ToolSetting(dy=5e-6))
    inside = found.rho < 5e-6
    assert np.isnan(found.maps["tool setting"][inside]).all()
    assert not np.isnan(found.maps["tool setting"][found.rho > 5.1e-6]).any()
    assert any("not cut" in m for m in found.messages)


def test_removed_freedoms_are_gone_from_each_map():
    tilted = Expression("1e-3*x + 2e-3*y + A*cos(k*x)", A=20e-9, k=2 * np.pi / 80e-6)
    job = TurningJob(tilted, 150e-6, 3e-6, rpm=20)
    path = job.path(step=np.deg2rad(5))
    raw = job.predict(path, tool=ToolSetting(dx=2e-6))
    level = job.predict(path, tool=ToolSetting(dx=2e-6), removed=("piston", "tilt"))
    z = level.maps["tool setting"]
    good = ~np.isnan(z)
    w = level.rho[good]
    for column in (np.ones(good.sum()), level.x[good], level.y[good]):
        assert abs((w * column * z[good]).sum()) < 1e-10 * (w * np.abs(column * z[good])).sum()
    assert raw.budget.combine("sum").pv != pytest.approx(level.budget.combine("sum").pv, abs=NM)


def logged(job, amplitude, *, turn=0.0, outer=1.0):
    """Return a log along the spiral: an error of one wave in each direction, known everywhere."""
    t = np.linspace(0, 1, 20_001)
    u = 2 * np.pi * job.radius / job.feed * (1 - t)
    rho, theta = job.feed * u / (2 * np.pi), u[0] - u + turn
    z = amplitude * np.cos(2 * np.pi * rho * np.cos(theta) / 100e-6)
    return FollowUpMap(
        rho[rho <= outer * job.radius],
        theta[rho <= outer * job.radius],
        z[rho <= outer * job.radius],
    )


def test_a_log_lands_where_it_was_cut():
    log = logged(SMALL, 6 * NM)
    found = SMALL.predict(SMALL.path(step=np.deg2rad(4)), follow_up=log)
    expected = 6 * NM * np.cos(2 * np.pi * found.x / 100e-6)
    np.testing.assert_allclose(found.maps["follow-up"], expected, atol=STRAIGHT)


def test_a_log_of_another_spiral_is_refused():
    path = SMALL.path(step=np.deg2rad(4))
    with pytest.raises(DataError, match=r"leaves the programmed spiral by up to 90\.0 deg"):
        SMALL.predict(path, follow_up=logged(SMALL, NM, turn=np.pi / 2))
    other = TurningJob(GRID, 150e-6, 3e-6, rpm=20, sense="clockwise")
    with pytest.raises(DataError, match="sense of rotation"):
        other.predict(other.path(step=np.deg2rad(4)), follow_up=logged(SMALL, NM))


def test_a_short_log_leaves_the_rest_unknown():
    found = SMALL.predict(SMALL.path(step=np.deg2rad(4)), follow_up=logged(SMALL, NM, outer=0.5))
    assert np.isnan(found.maps["follow-up"][found.rho > 76e-6]).all()
    assert any("the log covers 50" in m for m in found.messages)


def test_bare_follow_up_joins_as_a_pv():
    found = SMALL.predict(
        SMALL.path(step=np.deg2rad(4)), tool=ToolSetting(dx=1e-6), follow_up=5 * NM
    )
    assert found.budget.without_map == ("follow-up",)
    names = pv_quantities(found.budget)
    assert names["follow-up.pv"].value == 5 * NM
    assert "pointwise" not in names


def test_compensated_program_cancels_and_a_flipped_sign_doubles():
    path = SMALL.path(step=np.deg2rad(4))
    tool, log = ToolSetting(dx=-1.5e-6, dy=1e-6, dR=30e-6), logged(SMALL, 6 * NM)

    program = SMALL.compensated(path, tool=tool, follow_up=log)

    points = path.points(GRID)
    far = points.rho > 20e-6
    far &= points.rho < 149e-6
    error = tool.error(GRID, points.x[far], points.y[far])
    error = error + 6 * NM * np.cos(2 * np.pi * points.x[far] / 100e-6)
    left, doubled = error + program.change[far], error - program.change[far]
    # the commanded point lands 1.8 um away, where the error differs by its slope: second order
    assert np.ptp(left) < 0.12 * np.ptp(error)
    assert np.ptp(doubled) > 1.9 * np.ptp(error)


def test_compensation_of_the_log_takes_a_share():
    path = SMALL.path(step=np.deg2rad(4))
    half = SMALL.compensated(path, follow_up=logged(SMALL, 6 * NM), gain=0.5)
    inside = half.rho <= 150e-6
    expected = -3 * NM * np.cos(2 * np.pi * half.rho * np.cos(half.azimuth) / 100e-6)
    np.testing.assert_allclose(half.change[inside], expected[inside], atol=STRAIGHT)
    assert list(half.to_frame()) == ["rho_um", "azimuth_deg", "z_nominal_nm", "z_command_nm"]
    assert any("3 of" in m and "not changed" in m for m in half.messages)  # the lead-in


@pytest.mark.parametrize(
    ("call", "error", "match"),
    [
        (lambda: TurningJob("grid", 1e-3, 1e-6, rpm=20), DataError, "str"),
        (lambda: TurningJob(GRID, -1e-3, 1e-6, rpm=20), DataError, "radius"),
        (lambda: TurningJob(GRID, 1e-3, 1e-6, rpm=0), DataError, "rpm"),
        (lambda: TurningJob(GRID, 1e-3, 1e-6, rpm=20, block_time=-1), DataError, "block_time"),
        (lambda: SMALL.predict("path"), DataError, "must be a SpiralPath"),
        (
            lambda: SMALL.predict(TurningJob(GRID, 1e-4, 3e-6, rpm=20).path(step=0.1)),
            DataError,
            "the job has",
        ),
        (lambda: SMALL.predict(SMALL.path(step=0.1), removed=("power",)), DataError, "removed"),
        (lambda: SMALL.compensated(SMALL.path(step=0.1)), DataError, "give the tool setting"),
        (
            lambda: SMALL.compensated(SMALL.path(step=0.1), tool=ToolSetting(dx=1e-6), gain=2.0),
            DataError,
            "gain",
        ),
        (
            lambda: SMALL.predict(
                SMALL.path(step=0.1), follow_up=FollowUpMap([1.0, 1.0], [0.0, 0.0], [0.0, 0.0])
            ),
            TooFewSamplesError,
            "no samples",
        ),
        (
            lambda: SMALL.predict(
                SMALL.path(step=0.1), others=[Contribution("x", map=[0.0, 1.0])]
            ),
            DataError,
            "shapes differ",
        ),
    ],
)
def test_bad_input(call, error, match):
    with pytest.raises(error, match=match):
        call()
