"""The budget on the cut surface against the full cut, and a measured part that tells its tool."""

import math
from dataclasses import replace

import numpy as np
import pytest

from metrosep.core.errors import DataError, DegenerateFitError, InvalidSamplesError
from metrosep.core.surface import Surface
from metrosep.forms import Expression, Sphere, Toric
from metrosep.process import (
    Contribution,
    EdgeProfile,
    ErrorBudget,
    PathDeviation,
    RoundNose,
    ToolSetting,
    TurningJob,
    TurningProgram,
    cut_budget,
    fit_causes,
    identify_edge,
    tip_path,
    virtual_cut,
)

NM, UM = 1e-9, 1e-6
R = 0.6e-3
TORUS = Toric(Rb=110e-3, Rd=70e-3)
SKEW = Expression("0.4*x**2-0.25*y**2+0.15*x*y+2e-4*x+3e-7*sin(2*pi*y/9e-4)")
STEEP = Expression("9*x**2+14*y**2+3*x*y+6e-3*x+2e-6*sin(2*pi*y/9e-4)")
ANGLES = np.radians(np.linspace(-50, 50, 401))
WAVY = EdgeProfile(ANGLES, 20 * NM * np.cos(2 * np.pi * ANGLES / math.radians(11.0) + 0.4))


def places(rng, low, high, n=60):
    rho, theta = np.sqrt(rng.uniform(low**2, high**2, n)), rng.uniform(-3.1, 3.1, n)
    return rho * np.cos(theta), rho * np.sin(theta)


def program(
    form, nose, *, interpolation, sense="clockwise", per_turn=120, radius=2.2e-3, core=1.4e-3
):
    job = TurningJob(form, radius, 10e-6, rpm=60, core=core, sense=sense, nose=nose)
    return job.program(job.path(step=2 * np.pi / per_turn, interpolation=interpolation))


@pytest.mark.parametrize("degrees", [0.0, -30.0])
def test_the_sum_of_the_causes_is_the_full_cut(degrees, rng):
    """specs/cutting-path.md, section 10: below 0.004 nm of 43 nm on the torus."""
    nose = RoundNose(R, math.radians(degrees), edge=WAVY)
    made = program(TORUS, RoundNose(R, math.radians(degrees)), interpolation="linear")
    x, y = places(rng, 1.5e-3, 2.1e-3)
    setting = ToolSetting(dx=0.3 * UM, dy=-0.2 * UM, dR=3 * UM)
    found = cut_budget(made, nose, x, y, form=TORUS, setting=setting)
    assert [c.name for c in found.budget.contributions] == ["program", "tool", "tool setting"]
    assert np.ptp(found.total) > 10 * NM
    # a wavy edge has other cusps than a round one, in the middle of a crest
    assert found.disagreement < 0.2 * NM
    plain = cut_budget(
        made, RoundNose(R, math.radians(degrees)), x, y, form=TORUS, setting=setting
    )
    assert plain.disagreement < 0.12 * NM  # the cusps of a larger radius are 0.5 % lower
    assert not plain.messages
    assert found.cusp / NM == pytest.approx(18, abs=7)
    assert found.full.error - found.cusps == pytest.approx(
        found.total, abs=4 * NM
    )  # cusps that moved


def test_a_deviation_of_the_axes_acts_at_the_contact(rng):
    """Equation (22): 1e-5 rad of C is 0.0009 nm off of 0.202 nm; X, C and Z at once, each its sign."""
    nose = RoundNose(R, math.radians(-30))
    made = program(STEEP, nose, interpolation="spline")
    t = np.linspace(made.t[0], made.t[-1], 6001)
    x, y = places(rng, 1.5e-3, 2.1e-3)
    zero, still = 0 * t, virtual_cut(made, nose, x, y, form=STEEP)
    for column, size in (("X", 20 * NM), ("azimuth", 5e-5), ("Z", 5 * NM)):
        swing = dict.fromkeys(("X", "azimuth", "Z"), zero) | {column: size + 0 * t}
        found = cut_budget(made, nose, x, y, form=STEEP, deviation=PathDeviation(t, **swing))
        acts = found.budget.contributions[-1].map
        # cusps that move by 20 nm change by up to 0.17 nm
        assert found.full.error - still.error == pytest.approx(acts, abs=0.25 * NM)
        assert np.abs(acts).max() > 1 * NM
        assert found.disagreement < 0.02 * NM
    # a tip that stands 20 nm further out, where the surface rises outwards, cuts deeper
    out = cut_budget(
        made, nose, [2e-3], form=STEEP, deviation=PathDeviation(t, 20 * NM + zero, zero, zero)
    )
    assert STEEP.gradient(2e-3)[0] > 0
    assert out.budget.contributions[-1].map.item() < 0


def test_the_uncertainty_of_the_setting_becomes_modes(rng):
    nose = RoundNose(R)
    made = program(TORUS, nose, interpolation="spline")
    setting = ToolSetting(dx=0.3 * UM, u_dx=0.1 * UM, u_dy=0.0, u_dR=0.0)
    cause = cut_budget(
        made, nose, *places(rng, 1.5e-3, 2.1e-3), form=TORUS, setting=setting
    ).budget.contributions[-1]
    assert cause.modes.shape == (1, 60)
    assert cause.u == pytest.approx(cause.pv / 3, rel=0.05, abs=0.0)


def test_a_factor_that_is_not_determined_is_named(rng):
    made = program(TORUS, RoundNose(R), interpolation="linear")
    x, y = places(rng, 1.5e-3, 2.1e-3, 12)
    setting = ToolSetting(dx=0.3 * UM, u_dx=0.1 * UM, u_dy=0.0, u_dR=math.inf)
    found = cut_budget(made, RoundNose(R), x, y, form=TORUS, setting=setting)
    assert found.messages[-1].startswith("dR is not determined (its u is infinite)")
    assert found.budget.contributions[-1].modes.shape == (1, 12)


def test_a_cut_that_contradicts_the_sum_is_said(rng):
    """A setting of 60 um is no small error: the contacts of the causes move."""
    nose = RoundNose(R)
    made = program(SKEW, nose, interpolation="spline")
    t = np.array([made.t[0], made.t[-1]])
    big = PathDeviation(t, np.array([30 * UM, 30 * UM]), np.zeros(2), np.zeros(2))
    found = cut_budget(made, nose, *places(rng, 1.5e-3, 2.0e-3), form=SKEW, deviation=big)
    assert found.disagreement > 1 * NM
    assert "trust the cut" in found.messages[-1]


def part(form, made, nose, setting, *, noise=1 * NM, tilt=2e-6):
    """A measured map of the part, with noise, piston and tilt, made by the virtual cut."""
    n = 61
    axis = np.linspace(-2.1e-3, 2.1e-3, n)
    x, y = np.meshgrid(axis, axis)
    rho = np.hypot(x, y)
    inside = (rho > 1.55e-3) & (rho < 2.05e-3)
    z = np.full(x.shape, np.nan)
    z[inside] = virtual_cut(made, nose, x[inside], y[inside], setting=setting).z
    z += np.random.default_rng(3).normal(0, noise, z.shape) + 0.5e-6 + tilt * x - 0.7 * tilt * y
    step = float(axis[1] - axis[0])
    return Surface(z, dx=step, dy=step, origin=(-2.1e-3, -2.1e-3))


def test_a_measured_part_tells_its_setting_and_the_next_part_is_better(rng):
    """Cut, measure, identify, make the path for the tool as it is, cut again; the sign turned over is worse."""
    nose, sense = RoundNose(R, math.radians(-20)), "clockwise"
    truth = ToolSetting(dx=2.3 * UM, dy=-1.7 * UM, dR=9 * UM)
    made = program(STEEP, nose, interpolation="spline")
    measured = part(STEEP, made, nose, truth)
    found = identify_edge(measured, STEEP, nose=nose, sense=sense)
    for name in ("dx", "dy", "dR"):
        assert abs(found.values[name] - getattr(truth, name)) < 4 * found.u[name]
        assert found.u[name] < 0.4 * abs(getattr(truth, name))
    assert found.values["tilt_x"] == pytest.approx(2e-6, abs=4 * found.u["tilt_x"])
    assert found.explained > 0.9
    x, y = places(rng, 1.6e-3, 2.0e-3, 400)
    job = TurningJob(STEEP, 2.2e-3, 10e-6, rpm=60, core=1.4e-3, sense=sense, nose=nose)
    path = job.path(step=2 * np.pi / 120)
    swings = {}
    for name, way in (("as it was", 0.0), ("made up for", 1.0), ("turned over", -1.0)):
        off = ToolSetting(**{n: way * found.values[n] for n in ("dx", "dy", "dR")})
        again = job.compensated(path, tool=off)
        swings[name] = (
            virtual_cut(again, nose, x, y, form=STEEP, setting=truth).peak_to_valley / NM
        )
    assert swings["made up for"] < 25  # cusps of 21 nm
    assert swings["as it was"] > 3 * swings["made up for"]
    assert swings["turned over"] > 1.5 * swings["as it was"]


def test_a_yaw_that_nobody_knew_of_is_found():
    nose = RoundNose(R, math.radians(-20))
    turned = RoundNose(R, math.radians(-20), yaw=math.radians(2.0))
    made = program(STEEP, nose, interpolation="spline")
    found = identify_edge(
        part(STEEP, made, turned, None, noise=0.2 * NM), STEEP, nose=nose, sense="clockwise",
        free=("piston", "tilt_x", "tilt_y", "dx", "dy", "dR", "yaw"),
    )  # fmt: skip
    assert found.values["yaw"] == pytest.approx(math.radians(2.0), abs=5 * found.u["yaw"])
    assert math.degrees(found.u["yaw"]) < 0.5
    assert found.nose.yaw == found.values["yaw"]


def test_what_cannot_be_told_is_refused_or_said():
    nose = RoundNose(R)
    made = program(SKEW, nose, interpolation="spline")
    measured = part(SKEW, made, nose, None)
    with pytest.raises(DataError, match="dy and yaw are free: give sense"):
        identify_edge(measured, SKEW, nose=nose)
    with pytest.raises(DataError, match="free must name values of the tool"):
        identify_edge(measured, SKEW, nose=nose, free=("piston",))
    with pytest.raises(DataError, match="free is one of"):
        identify_edge(measured, SKEW, nose=nose, free=("defocus",))
    bowl = Sphere(R=35e-3)
    round_ = part(bowl, program(bowl, nose, interpolation="spline"), nose, None)
    with pytest.raises(DegenerateFitError, match="dy changes nothing on this part"):
        identify_edge(round_, bowl, nose=nose, sense="clockwise")
    with pytest.raises(DegenerateFitError, match="does not tell all of piston, dR, dx apart"):
        identify_edge(measured, Expression("3e-2*r"), nose=nose, free=("piston", "dR", "dx"))
    with pytest.raises(InvalidSamplesError, match="must grow"):
        PathDeviation([0.0, 0.0], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0])
    points = TurningProgram(made.X, made.azimuth, made.Z, made.t, "cut points")
    with pytest.raises(DataError, match="cut points"):
        cut_budget(points, nose, 1.8e-3, form=SKEW)


def test_program_maps_are_the_interpolation_at_the_contact(rng):
    """Linear blocks: full cut minus equation (22) is 0.0002 nm rms, 0.017 nm at most, of 13.8 nm."""
    nose = RoundNose(R)
    made = program(TORUS, nose, interpolation="linear", radius=3e-3, core=1.4e-3)
    x, y = places(rng, 1.6e-3, 2.8e-3, 300)
    found = cut_budget(made, nose, x, y, form=TORUS)
    close = np.linspace(0, 2 * np.pi, 40 * 120)
    dense = program(TORUS, nose, interpolation="spline", per_turn=960, radius=3e-3, core=1.4e-3)
    cusps = virtual_cut(dense, nose, x, y, form=TORUS).error
    left = found.full.error - cusps - found.budget.contributions[0].map
    assert np.sqrt(np.mean(left**2)) < 0.003 * NM
    assert np.ptp(found.budget.contributions[0].map) > 12 * NM
    del close
    tip = tip_path(TORUS, 2e-3, 0.3, nose=nose)
    assert tip.contacts.item() == 1


def test_the_axis_of_a_part_may_lie_anywhere_on_its_map():
    """The same map with another origin: its centre given, or in the middle of a map without one."""
    nose = RoundNose(R)
    made = program(SKEW, nose, interpolation="linear", per_turn=60, radius=2.15e-3, core=1.5e-3)
    there = part(SKEW, made, nose, ToolSetting(dx=2.3 * UM))
    words = {"nose": nose, "free": ("piston", "tilt_x", "tilt_y", "dx"), "region": (1.6e-3, 2e-3)}
    wanted = identify_edge(there, SKEW, **words).values["dx"]
    for origin, centre in (((0.0, 0.0), None), ((1e-3, -5e-3), (3.1e-3, -2.9e-3))):
        moved = Surface(there.z, dx=there.dx, dy=there.dy, origin=origin)
        found = identify_edge(moved, SKEW, centre=centre, **words)
        assert found.values["dx"] == pytest.approx(wanted, abs=1e-11)
    with pytest.raises(DataError, match="no point in the ring"):
        identify_edge(moved, SKEW, **words)


def test_causes_that_leave_one_map_are_named(rng):
    """X off by 1 um all along and a setting dx of 1 um: no part tells them apart."""
    nose = RoundNose(R)
    made = program(SKEW, nose, interpolation="linear")
    x, y = places(rng, 1.5e-3, 2.1e-3)
    t, flat = made.t[[0, -1]], np.zeros(2)
    moves = {
        "slide": PathDeviation(t, flat + 1 * UM, flat, flat),
        "waves": PathDeviation(made.t, 0 * made.t, 0 * made.t, 9 * NM * np.sin(3 * made.azimuth)),
    }
    found = cut_budget(
        made, nose, x, y, form=SKEW, setting=ToolSetting(dx=1 * UM), deviation=moves
    )
    names = [c.name for c in found.budget.contributions]
    assert names == ["program", "tool setting", "slide", "waves"]
    same = replace(
        found,
        budget=ErrorBudget(
            [
                *found.budget.contributions[:3],
                Contribution("twin", map=found.budget.contributions[2].map),
            ]
        ),
    )
    with pytest.raises(DegenerateFitError, match="slide and twin leave the same map"):
        fit_causes(same, found.full.error, x, y)
    with pytest.raises(DataError, match="a deviation is named tool, as another cause is"):
        cut_budget(made, nose, x, y, form=SKEW, deviation={"tool": moves["slide"]})
    with pytest.raises(DataError, match="must be a PathDeviation, or several"):
        cut_budget(made, nose, x, y, form=SKEW, deviation=[moves["slide"]])
