"""From tolerance to corrected program, on the part of slow-tool-servo and on others."""

from __future__ import annotations

import numpy as np
import pytest

from metrosep.core.profile import Profile
from metrosep.errors import (
    DataError,
    InvalidSamplesError,
    LimitError,
    TooFewSamplesError,
    UnitError,
)
from metrosep.forms import Conic, Expression, SineGrid, Sphere, Toric
from metrosep.process._motion import FollowUpMap
from metrosep.process.jobs import TurningJob
from metrosep.process.nose import RoundNose
from metrosep.process.path_points import SpiralPath
from metrosep.process.predictions import Contribution, pv_quantities
from metrosep.process.tool_settings import ToolSetting, identify_setting

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
    inside = half.X <= 150e-6
    expected = -3 * NM * np.cos(2 * np.pi * half.X * np.cos(half.azimuth) / 100e-6)
    np.testing.assert_allclose(half.change[inside], expected[inside], atol=STRAIGHT)
    columns = ["cut_point_rho_um", "azimuth_deg"]
    columns += ["cut_point_z_nominal_nm", "cut_point_z_command_nm"]
    assert list(half.to_frame()) == columns
    assert any("3 of" in m and "first or last value" in m for m in half.messages)  # the lead-in
    np.testing.assert_array_equal(half.change[:3], half.change[3])


def pv_of_drawn_dx(job, path, dx, u, draws=400):
    """Return mean and standard deviation of the P-V of a tool at dx +- u, by cutting each draw."""
    rho, phi = path.error_map(GRID).rho[:-1:5], path.error_map(GRID).theta[:-1:5]
    rng = np.random.default_rng(11)
    k = 2 * np.pi / 100e-6

    def grid(r):
        return 50e-9 * (np.sin(k * r * np.cos(phi)) + np.cos(k * r * np.sin(phi)))

    found = [np.ptp(grid(rho - d) - grid(rho)) for d in dx + u * rng.standard_normal(draws)]
    return np.mean(found), np.std(found)


@pytest.mark.parametrize("dx", [0.0, 20e-9, 1e-6])
def test_the_pv_of_an_uncertain_setting_is_that_of_cut_draws(dx):
    path = SMALL.path(step=np.deg2rad(5))
    mean, sd = pv_of_drawn_dx(SMALL, path, dx, 50e-9)
    found = SMALL.predict(path, tool=ToolSetting(dx=dx, u_dx=50e-9))
    tool = found.budget.contributions[0]
    scatter = 3 * sd / 20  # three standard errors of 400 draws
    assert tool.expected == pytest.approx(mean, abs=scatter)
    assert tool.u == pytest.approx(sd, abs=scatter)
    assert tool.interval[0] < mean < tool.interval[1]
    totals = found.budget.totals()
    for way in ("pointwise", "monte-carlo", "sum", "rss"):
        assert totals[way].u > 0.5 * sd, way
    said = any("is expected within its uncertainty" in m for m in found.messages)
    assert said == (dx < 50e-9)


def test_the_covariance_of_a_setting_counts():
    # dx and dy of equal sign share the P-V of a map that both widen: their covariance counts
    path = SMALL.path(step=np.deg2rad(5))
    u = 50e-9
    alone = SMALL.predict(path, tool=ToolSetting(dx=1e-6, u_dx=u)).budget.contributions[0]
    both = np.array([[1.0, 0.9, 0], [0.9, 1.0, 0], [0, 0, 0]]) * u**2
    tool = SMALL.predict(path, tool=ToolSetting(dx=1e-6, dy=1e-6, cov=both))
    apart = SMALL.predict(path, tool=ToolSetting(dx=1e-6, dy=1e-6, u_dx=u, u_dy=u, u_dR=0.0))
    assert alone.modes.shape == (1, len(alone.map))
    assert tool.budget.contributions[0].u > 1.2 * apart.budget.contributions[0].u


def test_removed_freedoms_are_gone_from_the_uncertainty():
    dome = Expression("-c*(x**2+y**2) + d*x", c=100.0, d=1e-2)
    job = TurningJob(dome, 150e-6, 3e-6, rpm=20)
    path = job.path(step=np.deg2rad(5))
    tool = ToolSetting(dx=1e-6, u_dx=0.1e-6)
    for removed in ((), ("piston", "tilt")):
        c = job.predict(path, tool=tool, removed=removed).budget.contributions[0]
        good = ~np.isnan(c.modes[0])
        # the dome -c r^2 + d r cos at r = rho - dx: its derivative by dx is 2 c r - d cos
        rho, phi = path.error_map(dome).rho[good], path.error_map(dome).theta[good]
        mode = 2 * 100.0 * (rho - 1e-6) - 1e-2 * np.cos(phi)
        if removed:
            basis = np.stack([np.ones_like(rho), rho * np.cos(phi), rho * np.sin(phi)])
            fit = np.linalg.solve((basis * rho) @ basis.T, (basis * rho) @ mode)
            mode = mode - fit @ basis
        np.testing.assert_allclose(c.modes[0][good], mode, atol=1e-7)
        assert c.u == pytest.approx(0.1e-6 * np.ptp(mode), abs=0.05 * 0.1e-6 * np.ptp(mode))


def test_what_the_setting_does_not_know_is_said():
    path = SMALL.path(step=np.deg2rad(5))
    unset = ToolSetting(dx=1e-6, u_dx=5e-9, u_dy=np.inf, u_dR=0.0)
    found = SMALL.predict(path, tool=unset)
    assert found.budget.contributions[0].u is None
    assert any("dy is not determined" in m and "no u" in m for m in found.messages)
    half = SMALL.predict(path, tool=ToolSetting(dx=1e-6, dR=1e-6, u_dx=5e-9))
    assert any("uncertainty of dR is not known" in m for m in half.messages)
    # on a part of revolution dy leaves no trace: the others are counted
    ball = TurningJob(Conic(R=5e-3, k=0.0), 90e-6, 4e-6, rpm=20)
    path = ball.path(step=0.07)
    turned = ball.predict(path, tool=unset)
    alone = ball.predict(path, tool=ToolSetting(dx=1e-6, u_dx=5e-9))
    assert turned.budget.contributions[0].u == pytest.approx(
        alone.budget.contributions[0].u, abs=1e-6 * NM
    )
    assert any("no effect on this form" in m for m in turned.messages)


def test_messages_of_an_identified_setting_are_handed_on():
    x = np.arange(20e-6, 140e-6, 1e-6)
    fitted = identify_setting(Profile(x, GRID(x)), GRID).setting
    assert fitted.messages  # a one-sided profile says nothing of dy
    path = SMALL.path(step=np.deg2rad(5))
    for made in (SMALL.predict(path, tool=fitted), SMALL.compensated(path, tool=fitted)):
        assert {f"tool setting: {m}" for m in fitted.messages} <= set(made.messages)


def log_of(job, error, *, keep=None, quantum=0.0, turn=0.0, noise=0.0, sense=1, every=0.02):
    """Return a log along the spiral in the order of time, its azimuth wrapped as an encoder does."""
    travelled = np.arange(0.0, 2 * np.pi * job.radius / job.feed, every)
    rho = job.radius - job.feed * travelled / (2 * np.pi)
    phi = sense * travelled
    z = error(rho * np.cos(phi), rho * np.sin(phi))
    if keep is not None:
        z = np.where(keep(travelled / (2 * np.pi)), z, np.nan)
    rho = np.abs(rho + noise * np.random.default_rng(3).standard_normal(rho.size))
    if quantum:
        rho = np.round(rho / quantum) * quantum
    return FollowUpMap(rho, np.mod(phi + turn, 2 * np.pi), z)


def wavy(x, y):
    """Return a follow-up error without any symmetry."""
    return 4 * NM * np.sin(2 * np.pi * (x + 0.4 * y) / 60e-6) + 3 * NM * y / 150e-6 + 2 * NM


LINES = 0.06e-9
"""m: straight lines between samples 3 um apart at the rim, A (k h)^2 / 8 with A = 4 nm."""


def test_a_hole_of_the_log_is_not_filled():
    log = log_of(SMALL, wavy, keep=lambda turn: (turn < 15) | (turn > 25))
    found = SMALL.predict(SMALL.path(step=np.deg2rad(4)), follow_up=log)
    z, turn = found.maps["follow-up"], (150e-6 - found.rho) / 3e-6
    assert np.isnan(z[(turn > 15.01) & (turn < 24.99)]).all()
    known = (turn < 14.99) | (turn > 25.01)
    known &= turn < 49.99
    np.testing.assert_allclose(z[known], wavy(found.x, found.y)[known], atol=LINES)
    said = " ".join(found.messages)
    assert "hole" in said
    assert "10 turns at rho = 105 um to 75 um" in said
    assert "covers 80.0 %" in said
    assert "'follow-up'" in said  # the budget counts the points


def test_single_lost_samples_are_bridged():
    lost = np.random.default_rng(5).random(100_000) < 0.05
    log = log_of(SMALL, wavy, keep=lambda turn: ~lost[: turn.size])
    found = SMALL.predict(SMALL.path(step=np.deg2rad(4)), follow_up=log)
    z = found.maps["follow-up"]
    good = ~np.isnan(z)
    assert good.mean() > 0.98  # three in a row, one of 400, are left out
    np.testing.assert_allclose(z[good], wavy(found.x, found.y)[good], atol=4 * LINES)


@pytest.mark.parametrize("sense", ["counterclockwise", "clockwise"])
@pytest.mark.parametrize(("quantum", "noise"), [(0.1e-6, 0.0), (1e-6, 0.0), (0.0, 0.5e-6)])
def test_a_coarse_radius_tells_the_turn_and_no_more(sense, quantum, noise):
    # 1 um is a third of the feed, 0.5 um RMS a sixth: single samples are on a wrong turn by radius
    job = TurningJob(GRID, 150e-6, 3e-6, rpm=20, sense=sense)
    sign = 1 if sense == "counterclockwise" else -1
    log = log_of(job, wavy, quantum=quantum, noise=noise, sense=sign)
    program = job.compensated(job.path(step=np.deg2rad(4)), follow_up=log)
    on_part = slice(program.lead_in, -1)
    x, y = program.X * np.cos(program.azimuth), program.X * np.sin(program.azimuth)
    left = (wavy(x, y) + program.change)[on_part]
    assert np.ptp(left) < 2 * LINES
    assert np.ptp(wavy(x, y)) > 12 * NM


def test_radii_that_do_not_tell_the_turn_are_refused():
    path = SMALL.path(step=np.deg2rad(4))
    with pytest.raises(DataError, match="do not tell on which turn"):
        SMALL.predict(path, follow_up=log_of(SMALL, wavy, noise=1.5e-6))


def test_a_systematic_azimuth_is_reported():
    path = SMALL.path(step=np.deg2rad(4))
    found = SMALL.predict(path, follow_up=log_of(SMALL, wavy, turn=0.4))
    assert any("disagree by 22.9 deg" in m for m in found.messages)
    c, s = np.cos(0.4), np.sin(0.4)  # the log says it lies 0.4 rad on: the map is turned by it
    turned = wavy(c * found.x + s * found.y, c * found.y - s * found.x)
    good = ~np.isnan(found.maps["follow-up"])
    good &= found.rho > 10e-6
    np.testing.assert_allclose(found.maps["follow-up"][good], turned[good], atol=0.2 * NM)
    quiet = SMALL.predict(path, follow_up=log_of(SMALL, wavy))
    assert not any("disagree" in m for m in quiet.messages)


def test_a_constant_error_leaves_no_step_for_the_spline():
    path = SMALL.path(step=np.deg2rad(4))
    program = SMALL.compensated(path, follow_up=log_of(SMALL, lambda x, y: 20 * NM + 0 * x))
    np.testing.assert_allclose(program.change, -20 * NM, atol=1e-18)
    assert program.lead_in == 3


@pytest.mark.parametrize(
    ("keep", "match"),
    [
        (lambda turn: turn > 12, "starts 12 turns after the rim"),
        (lambda turn: turn < 40, r"ends 10 turns before the last point"),
        (lambda turn: (turn < 15) | (turn > 25), "a hole of 10 turns"),
    ],
)
def test_a_log_that_leaves_much_out_corrects_nothing(keep, match):
    path = SMALL.path(step=np.deg2rad(4))
    with pytest.raises(DataError, match=match):
        SMALL.compensated(path, follow_up=log_of(SMALL, wavy, keep=keep))


def test_a_short_hole_is_bridged_aloud():
    path = SMALL.path(step=np.deg2rad(4))
    log = log_of(SMALL, wavy, keep=lambda turn: (turn < 40) | (turn > 40.1))
    program = SMALL.compensated(path, follow_up=log)
    assert any("1 hole(s) of the log, up to 36" in m for m in program.messages)
    assert np.isfinite(program.Z).all()


def test_budget_of_a_job_weighs_by_area():
    found = SMALL.predict(SMALL.path(step=np.deg2rad(5)), tool=ToolSetting(dx=1e-6))
    np.testing.assert_array_equal(found.budget.weights, found.rho)
    even = SMALL.path(step=2e-6, distribution="CAL")
    assert (SMALL.predict(even).budget.weights == 1.0).all()


@pytest.mark.parametrize(
    ("call", "error", "match"),
    [
        (lambda: TurningJob("grid", 1e-3, 1e-6, rpm=20), DataError, "str"),
        (lambda: TurningJob(GRID, -1e-3, 1e-6, rpm=20), DataError, "radius"),
        (lambda: TurningJob(GRID, 1e-3, 1e-6, rpm=0), DataError, "rpm"),
        (lambda: TurningJob(GRID, 1e-3, 1e-6, rpm=20, block_time=-1), DataError, "block_time"),
        (lambda: TurningJob(GRID, "5e-4", 1e-6, rpm=20), UnitError, "radius .* has no unit"),
        (lambda: TurningJob(GRID, 500.0, 1e-6, rpm=20), UnitError, "radius = 500 m"),
        (
            lambda: TurningJob(GRID, 1e-3, 1e-6, rpm=20, block_time=None),
            DataError,
            "block_time must be a number",
        ),
        (
            lambda: TurningJob(GRID, 1e-3, 1e-6, rpm=20, sense="left"),
            DataError,
            "sense is one of",
        ),
        (lambda: TurningJob(GRID, 1e-3, 1e-6, rpm=20, core=2e-3), DataError, "core must lie"),
        (lambda: SMALL.path(step=0.1, foo=1), DataError, "no option 'foo'"),
        (lambda: SMALL.path(step=0.1, core=1e-6), DataError, "core is that of the job"),
        (lambda: SMALL.plan(1e-9, feed=1e-6), DataError, "feed is that of the job"),
        (lambda: SMALL.plan(1.0), UnitError, "tolerance"),
        (lambda: SMALL.time("path"), DataError, "path must be a SpiralPath .* got str"),
        (
            lambda: SMALL.predict(SpiralPath(150e-6, 3e-6, step=0.1, core=50e-6)),
            DataError,
            "core 5e-05 m, the job has 0 m",
        ),
        (
            lambda: SMALL.predict(SMALL.path(step=0.1), tool=(1e-6, 0, 0)),
            DataError,
            "tool must be a ToolSetting",
        ),
        (
            lambda: SMALL.predict(SMALL.path(step=0.1), follow_up="log"),
            DataError,
            "P-V of 'follow-up' 'log' is not a number",
        ),
        (
            lambda: SMALL.predict(SMALL.path(step=0.1), follow_up=-1e-9),
            DataError,
            "zero or more",
        ),
        (lambda: SMALL.predict(SMALL.path(step=0.1), others=5), DataError, "others must be"),
        (
            lambda: SMALL.predict(SMALL.path(step=0.1), others=[5]),
            DataError,
            "must be a Contribution",
        ),
        (lambda: SMALL.predict(SMALL.path(step=0.1), removed=5), DataError, "got 5"),
        (
            lambda: SMALL.compensated(SMALL.path(step=0.1), follow_up=1e-9),
            DataError,
            "has no shape",
        ),
        (
            lambda: SMALL.compensated(SMALL.path(step=0.1), tool=ToolSetting(dx=1e-6), gain=None),
            DataError,
            "gain must be a number",
        ),
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


# the nose: what the edge of the tool really cuts when its tip is sent to the points of a program

BOWL = Toric(Rb=110e-3, Rd=70e-3)
PER_TURN = 60
CUSP = (
    4e-6**2 / (8 * 0.5e-3) * 1.02
)  # feed^2 / 8R of turns 4 um apart, the bowl's curvature beside


def bowl_job(**options):
    return TurningJob(BOWL, 3e-3, 4e-6, rpm=60, core=2.9e-3, **options)


def cut_by_a_circle(program, R, rays=(0, 7, 15, 41)):
    """Return cut minus wanted where a circle of radius R, its tip on every point, runs over rays."""
    found = []
    for ray in rays:
        on = slice(program.lead_in + ray, None, PER_TURN)  # one azimuth, a feed apart
        x, z, phi = program.X[on], program.Z[on], program.azimuth[on][0]
        rho = np.linspace(2.935e-3, 3.015e-3, 4001)
        cut = np.min(z + R - np.sqrt(R**2 - (rho[:, None] - x) ** 2), axis=1)
        found.append(cut - BOWL(rho * np.cos(phi), rho * np.sin(phi)))
    return np.concatenate(found)


def over_the_surface(program, R, rake=0.0, sign=1.0, dx=0.0, dy=0.0):
    """Return how far above the surface the lowest of 20001 points of the edge is, tip by tip."""
    psi = np.linspace(-0.3, 0.3, 20001)
    up = R * (1 - np.cos(psi))
    found = []
    for x, phi, z in zip(program.X, program.azimuth, program.Z, strict=True):
        across = dy - sign * up * np.sin(rake)
        along = x + dx + R * np.sin(psi)
        px, py = (
            along * np.cos(phi) - across * np.sin(phi),
            along * np.sin(phi) + across * np.cos(phi),
        )
        found.append((z + up * np.cos(rake) - BOWL(px, py)).min())
    return np.array(found)


EDGE_POINTS = 0.6e-3 * (0.3 / 20000) ** 2
"""m: R dpsi^2 / 2 over half a step of the edge's points, times four."""


def test_a_job_with_a_nose_sends_the_tip_where_a_circle_cuts_the_surface():
    job = bowl_job(nose=RoundNose(0.5e-3))
    program = job.compensated(job.path(step=2 * np.pi / PER_TURN))

    error = cut_by_a_circle(program, 0.5e-3)
    assert program.quantity == "tip"
    assert error.min() > -1e-12
    assert error.max() < CUSP
    assert [c.split("_")[0] for c in program.to_frame()] == ["tip", "azimuth", "tip", "tip"]
    assert not any("cut points" in m for m in program.messages)


def test_points_of_the_surface_say_that_they_are_no_tip_path_and_how_deep_a_nose_would_cut():
    job = bowl_job()
    path = job.path(step=2 * np.pi / PER_TURN)
    program = job.compensated(path, tool=ToolSetting(dx=1e-12))

    deep = -cut_by_a_circle(program, 0.5e-3).min()
    assert deep > 400 * NM  # this is what was written in silence
    assert program.quantity == "cut points"
    first = program.messages[0]
    assert first == job.predict(path).messages[0]
    assert first.startswith("cut points: these are points of the surface, no tip path")
    said = float(first.split("up to about ")[1].split(" nm")[0])
    assert said == pytest.approx(deep / NM, rel=0.05, abs=0.0)
    assert all("cut_point" in c or "azimuth" in c for c in program.to_frame())
    assert program.audit["quantity"] == "cut points"


@pytest.mark.parametrize(
    ("rake", "sense"),
    [(0.0, None), (-30.0, "counterclockwise"), (-30.0, "clockwise"), (10.0, "clockwise")],
)
@pytest.mark.parametrize("setting", [(0.0, 0.0, 0.0), (2e-6, -3e-6, 20e-6)])
def test_every_tip_touches_the_surface_with_the_edge_as_it_is_set(rake, sense, setting):
    dx, dy, dR = setting
    rake = np.deg2rad(rake)
    if dy and sense is None:
        blind = bowl_job(nose=RoundNose(0.6e-3))
        with pytest.raises(DataError, match="off the axis cuts differently both ways"):
            blind.compensated(blind.path(step=2 * np.pi / 17), tool=ToolSetting(dy=dy))
        sense = "counterclockwise"
    job = bowl_job(nose=RoundNose(0.6e-3, rake), sense=sense)
    path = job.path(step=2 * np.pi / 17)

    program = job.compensated(path, tool=ToolSetting(dx=dx, dy=dy, dR=dR))

    sign = -1.0 if sense == "clockwise" else 1.0
    above = over_the_surface(program, 0.6e-3 + dR, rake, sign, dx, dy)
    assert np.abs(above).max() < EDGE_POINTS
    if dR:
        plain = job.compensated(path)
        deep = over_the_surface(plain, 0.6e-3 + dR, rake, sign, dx, dy)
        assert deep.min() < -60 * NM  # the setting matters here


def test_blocks_between_tips_leave_what_the_tip_path_leaves():
    """specs/cutting-path.md, 6.2: one turn at 5.9 mm, 90 straight lines, 220.65 -> 223.80 nm."""
    job = {
        nose: TurningJob(BOWL, 5.9001e-3, 1e-8, rpm=60, core=5.89999e-3, nose=nose)
        for nose in (None, RoundNose(0.6e-3))
    }
    found = [
        j.predict(j.path(step=2 * np.pi / 90, interpolation="linear")).budget.contributions[0].pv
        for j in job.values()
    ]
    # the turn shrinks by 0.1 um, as small a feed as the spiral takes
    assert found == pytest.approx([220.65 * NM, 223.80 * NM], rel=1e-3, abs=0.0)


def test_a_nose_that_the_surface_does_not_let_in_makes_no_program():
    grooved = Expression("-8e-7*exp(-(r-2.95e-3)**2/(2*(6e-6)**2))")  # 45 um at the bottom
    job = TurningJob(grooved, 3e-3, 4e-6, rpm=60, core=2.9e-3, nose=RoundNose(0.1e-3))
    path = job.path(step=0.5)
    with pytest.raises(
        LimitError, match=r"gouges: .* concave radius 45 um .* leaves up to 152\.1 nm"
    ):
        job.compensated(path)
    assert any("not in the budget: the nose gouges" in m for m in job.predict(path).messages)


def test_a_nose_with_rake_needs_the_way_of_the_tool():
    with pytest.raises(DataError, match=r'sense="counterclockwise" or sense="clockwise"'):
        bowl_job(nose=RoundNose(0.6e-3, np.deg2rad(-30)))
    assert bowl_job(nose=RoundNose(0.6e-3)).sense is None
    with pytest.raises(DataError, match="RoundNose"):
        bowl_job(nose=0.6e-3)
    blunt = bowl_job(nose=RoundNose(0.6e-3, window=np.deg2rad(2)))
    with pytest.raises(LimitError, match="beyond its sharp window from -1 to 1 degrees"):
        blunt.compensated(blunt.path(step=0.5))


def test_a_dome_whose_rim_the_nose_misses_is_said():
    dome = TurningJob(Sphere(R=-20e-3), 3e-3, 4e-6, rpm=60, core=2.9e-3, nose=RoundNose(0.6e-3))
    # the contact lies R sin(psi) nearer to the axis: 20 / 20.6 times X, at the end of the first turn
    late = dome.compensated(dome.path(step=0.5, lead_in=3))
    assert any("touches the part up to rho = 2.91 mm only" in m for m in late.messages)
    assert dome.before_the_rim() == pytest.approx(3e-3 * 0.6 / 20 + 6e-6, rel=1e-9, abs=0.0)
    whole = dome.compensated(dome.path(step=0.5))
    assert any("the tip begins 97.08 um outside the rim" in m for m in whole.messages)
    assert not any("the flank of the nose" in m for m in whole.messages)


def test_a_bowl_needs_no_run_before_the_rim():
    bowl = TurningJob(Sphere(R=35e-3), 2e-3, 10e-6, rpm=60, core=1.9e-3, nose=RoundNose(0.5e-3))
    assert bowl.before_the_rim() == 0.0  # the contact lies 2 mm * 0.5 / 34.5 outside the tip
    far = bowl.program(bowl.path(step=0.5, lead_in=60))
    said = [m for m in far.messages if "outside the rim" in m]
    assert said
    assert "touches up to rho = 2.07" in said[0]  # X = 2.048 mm times 35 / 34.5
    assert "stays too high" not in said[0]
    assert not any("outside the rim" in m for m in bowl.program(bowl.path(step=0.5)).messages)


def test_a_hemisphere_is_cut_by_default_and_a_lead_in_beyond_it_is_named():
    half = TurningJob(Sphere(R=-2e-3), 1.99e-3, 40e-6, rpm=60, core=1.5e-3, nose=RoundNose(0.5e-3))
    with pytest.raises(InvalidSamplesError, match="smaller lead_in such as 3") as told:
        half.program(half.path(step=0.5, lead_in=half.path(step=0.5).lead_in + 10))
    azimuth = float(str(told.value).split("azimuth ")[1].split(" degrees")[0])
    assert 0.0 <= azimuth < 360.0
    half.program(half.path(step=0.5))
    half.program(half.path(step=0.5, lead_in=3))


def test_a_plan_for_a_nose_holds_its_tolerance_on_the_tip_path():
    """Hollows of 127 um beside a nose of 80 um: the tip path is bent 2.7 times as much as they are."""
    grid = SineGrid(amplitude=2e-6, wavelength=100e-6)
    job = TurningJob(grid, 60e-6, 3e-6, rpm=20, core=20e-6, nose=RoundNose(80e-6))
    plain = TurningJob(grid, 60e-6, 3e-6, rpm=20, core=20e-6).plan(50 * NM)
    plan = job.plan(50 * NM)
    assert plan.n_points > 1.1 * plain.n_points
    for path, holds in ((plan.path, True), (plain.path, False)):
        assert (job.predict(path).budget.contributions[0].pv <= 50 * NM) is holds
