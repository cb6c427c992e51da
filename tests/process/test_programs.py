"""Programs in time: what joins their points, what the axes must do, and both servo modes."""

import json
import math
import re

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from metrosep.controllers import LatheAxes, check_program, write_program
from metrosep.core.errors import DataError, InvalidSamplesError, LimitError, TooFewSamplesError
from metrosep.core.surface import Surface
from metrosep.forms import Expression, GridForm, SineGrid, Sphere, Toric
from metrosep.forms.stl import from_triangles
from metrosep.process import (
    AxisLimits,
    RoundNose,
    ToolSetting,
    TurningJob,
    TurningProgram,
    axis_motion,
    cusp_heights,
    sine_path_error,
    tip_path,
    virtual_cut,
)

NM, UM, MM = 1e-9, 1e-6, 1e-3
R = 0.6e-3
TORUS = Toric(Rb=110e-3, Rd=70e-3)
WAVES = Expression("3e-6*(sin(2*pi*x/7e-4)+cos(2*pi*y/7e-4))")


def turn(form, X, n, interpolation, *, nose, turns=3, per_turn_s=1.0):
    """Turns at constant X, with velocities from the slopes or from central differences."""
    angle = 2 * np.pi * np.arange(turns * n + 1) / n
    made = tip_path(form, np.full(angle.size, X), angle, nose=nose) if nose else None
    z = form(X * np.cos(angle), X * np.sin(angle)) if made is None else made.z
    t = per_turn_s * angle / (2 * np.pi)
    words, velocities = interpolation, None
    if interpolation.startswith("pvt"):
        words = "pvt"
        if made is None:
            gx, gy = form.gradient(X * np.cos(angle), X * np.sin(angle))
            rate = X * (gy * np.cos(angle) - gx * np.sin(angle))
        else:
            rate = (X + R * np.sin(made.psi)) * made.along_y
        if interpolation == "pvt differences":
            rate = np.gradient(z, angle)
        speed = 2 * np.pi / per_turn_s
        velocities = np.stack([0 * t, speed + 0 * t, rate * speed])
    return TurningProgram(np.full(angle.size, X), angle, z, t, "tip", words, velocities)


def between(program, form, X, nose):
    """P-V of the course minus what it should be, over the middle turn."""
    t = np.linspace(1.0, 2.0, 7201)
    x, azimuth, z = program.at(t)
    ideal = (
        tip_path(form, x, azimuth, nose=nose).z
        if nose
        else form(X * np.cos(azimuth), X * np.sin(azimuth))
    )
    return np.ptp(z - ideal)


@pytest.mark.parametrize(
    ("n", "interpolation", "expected"),
    [
        (45, "linear", (881.52, 894.07)), (45, "spline", (1.4618, 1.4828)),
        (45, "pvt", (1.4317, 1.4522)), (45, "pvt differences", (32.29, 32.75)),
        (90, "linear", (220.65, 223.80)), (90, "spline", (0.0900, 0.0913)),
        (90, "pvt", (0.0896, 0.0909)), (90, "pvt differences", (3.980, 4.039)),
        (180, "linear", (55.21, 56.00)), (180, "pvt differences", (0.496, 0.503)),
    ],
)  # fmt: skip
def test_interpolation_between_blocks(n, interpolation, expected):
    """specs/cutting-path.md, table 6.2: cut points and tip path, one turn of a torus at 5.9 mm."""
    X = 5.9e-3
    found = [
        between(turn(TORUS, X, n, interpolation, nose=nose), TORUS, X, nose) / NM
        for nose in (None, RoundNose(R))
    ]
    assert found == pytest.approx(expected, rel=5e-3, abs=0.0)


def test_the_closed_form_of_pvt_is_that_of_a_hermite_polynomial():
    """Midpoint of the Hermite polynomial of a crest; for small blocks A w^4 / 192 P-V."""
    A, wave = 50e-9, 100e-6
    for step in (5e-6, 25e-6):
        w = 2 * math.pi * step / wave
        k = w / step
        mid = A * math.cos(w / 2) + step * (A * k * math.sin(w / 2) * 2) / 8
        assert sine_path_error(A, wave, step, interpolation="pvt") == pytest.approx(
            2 * abs(A - mid), abs=1e-20
        )
    small = sine_path_error(A, wave, 1e-6, interpolation="pvt")
    assert small == pytest.approx(A * (2 * math.pi / 100) ** 4 / 192, rel=1e-3, abs=0.0)


def test_a_pvt_path_takes_the_true_velocity_and_plans_like_a_spline():
    job = TurningJob(
        TORUS, 3e-3, 10e-6, rpm=60, core=2.95e-3, nose=RoundNose(R), sense="clockwise"
    )
    program = job.program(job.path(step=2 * np.pi / 60, interpolation="pvt"))
    t = program.t[7:-7]
    h = 1e-3 * (program.t[1] - program.t[0])
    ends = [tip_path(TORUS, *program.at(t + s)[:2], nose=RoundNose(R)).z for s in (h, -h)]
    rate = (ends[0] - ends[1]) / (2 * h)
    assert program.velocities[2, 7:-7] == pytest.approx(rate, abs=1e-3 * np.abs(rate).max())
    assert program.velocities[0] == pytest.approx(-10e-6, abs=1e-15)  # a feed in a second
    assert program.velocities[1] == pytest.approx(-2 * np.pi, abs=1e-12)
    linear, pvt = (job.plan(20 * NM, interpolation=w).n_points for w in ("linear", "pvt"))
    assert pvt < 0.3 * linear


def test_the_velocity_acceleration_and_jerk_of_an_axis():
    """specs/cutting-path.md, 6.2: sine grid at 2.03 mm and 60 rpm, with and without the nose."""
    limits = {"Z": AxisLimits(acceleration=0.5, jerk=100.0)}
    for nose, expected in (
        (RoundNose(R), (0.442233e-3, 41.7787e-3, 4.57580)),
        (None, (0.439043e-3, 41.0680e-3, 4.51545)),
    ):
        found = axis_motion(turn(WAVES, 2.03e-3, 7200, "spline", nose=nose), limits)
        largest = [found.largest["Z"][k] for k in ("velocity", "acceleration", "jerk")]
        # the free end of the spline is off by 1.8e-4 in its first block
        assert largest == pytest.approx(expected, rel=2e-4, abs=0.0)
        if nose is not None:
            assert found.rpm_max == pytest.approx(167.75, abs=0.01)
            assert found.binding == "jerk of Z"
            only = axis_motion(
                turn(WAVES, 2.03e-3, 7200, "spline", nose=nose),
                {"Z": AxisLimits(acceleration=0.5)},
            )
            assert only.rpm_max == pytest.approx(207.57, abs=0.03)
            assert found.is_ok


def test_an_axis_that_is_too_slow_is_named_with_its_place_and_the_speed_that_holds():
    program = turn(WAVES, 2.03e-3, 720, "spline", nose=RoundNose(R))
    found = axis_motion(program, {"Z": AxisLimits(velocity=0.2e-3)})
    assert not found.is_ok
    assert found.exceeded[0].startswith("velocity of Z is 0.0004422 m/s in block ")
    with pytest.raises(LimitError, match=r"27\.1\d rpm instead of 60 would keep it"):
        found.require()
    slow = TurningProgram(
        program.X, program.azimuth, program.Z, program.t * 60 / found.rpm_max, "tip"
    )
    assert axis_motion(slow, {"Z": AxisLimits(velocity=0.2e-3)}).is_ok
    short = axis_motion(program, block_time=2e-3)
    assert short.rpm_max == pytest.approx(60 * (1 / 720) / 2e-3, abs=1e-9)
    assert "the control needs 2 ms" in short.exceeded[0]
    cornered = axis_motion(turn(WAVES, 2.03e-3, 90, "linear", nose=RoundNose(R)))
    assert "the velocity jumps there" in cornered.messages[0]
    with pytest.raises(DataError, match="an axis of the limits is one of X, C, Z"):
        axis_motion(program, {"Y": AxisLimits()})


def test_contacts_on_a_circle_move_x():
    """specs/cutting-path.md, section 3: sine grid, contacts at 2.03 mm, 60 rpm."""
    from metrosep.process.cutting.servos import contact_path
    from metrosep.process.tips import Edge

    angle = 2 * np.pi * np.arange(3 * 7200 + 1) / 7200
    X, azimuth, Z, said = contact_path(
        WAVES, np.full(angle.size, 2.03e-3), angle, Edge.of(RoundNose(R), None)
    )
    program = TurningProgram(X, azimuth, Z, angle / (2 * np.pi), "tip")
    found = axis_motion(program).largest["X"]
    assert np.ptp(X) / UM == pytest.approx(40.6011, abs=1e-3)
    assert found["velocity"] * 1e3 == pytest.approx(1.55402, rel=1e-4, abs=0.0)
    assert found["acceleration"] * 1e3 == pytest.approx(126.719, rel=1e-4, abs=0.0)
    assert said[0].startswith("X leaves the spiral by 40.6")


@pytest.mark.parametrize(
    ("degrees", "yaw", "sense"),
    [
        (0.0, 0.0, "clockwise"),
        (-30.0, 0.0, "counterclockwise"),
        (-30.0, 0.0, "clockwise"),
        (10.0, 2.0, "clockwise"),
    ],
)
def test_both_servo_modes_touch_and_the_contacts_lie_where_they_should(degrees, yaw, sense):
    nose = RoundNose(R, math.radians(degrees), yaw=math.radians(yaw))
    job = TurningJob(WAVES, 2e-3, 10e-6, rpm=60, core=1.9e-3, nose=nose, sense=sense)
    path = job.path(step=2 * np.pi / 48)
    z_only, both = (job.program(path, servo=s) for s in ("Z", "XZ"))
    assert np.array_equal(z_only.X[path.lead_in :], path.rho)
    made = tip_path(WAVES, both.X, both.azimuth, nose=nose, sense=sense)
    assert made.z == pytest.approx(both.Z, abs=1e-14)
    spiral = path.points(WAVES)
    assert made.rho == pytest.approx(spiral.rho, abs=1e-12)
    assert np.remainder(made.theta - spiral.azimuth + 1, 2 * np.pi) == pytest.approx(1.0, abs=1e-9)
    assert both.quantity == "tip"
    assert both.sense == z_only.sense == sense


def test_cusps_of_both_servo_modes_in_the_virtual_part():
    """specs/cutting-path.md, 6.1: spheres of 2 mm, R 0.6 mm, feed 5 um, at 0.705 mm."""
    for r, servo, expected in (
        (2e-3, "Z", 9.0976),
        (2e-3, "XZ", 4.4549),
        (-2e-3, "Z", 4.8940),
        (-2e-3, "XZ", 8.2736),
    ):
        job = TurningJob(Sphere(R=r), 1e-3, 5e-6, rpm=60, core=0.3e-3, nose=RoundNose(R))
        program = job.program(job.path(step=2 * np.pi / 8), servo=servo)
        x = np.linspace(0.7e-3, 0.71e-3, 2001)
        found = virtual_cut(program, RoundNose(R), x, form=Sphere(R=r))
        at = x[int(np.argmax(found.error))]
        closed = cusp_heights(Sphere(R=r), at, nose=RoundNose(R), feed=5e-6, servo=servo)
        assert found.peak_to_valley == pytest.approx(closed.item(), rel=3e-3, abs=0.0)
        # which of two cusps is meant is not said: they differ by 0.4 %
        assert found.peak_to_valley / NM == pytest.approx(expected, rel=5e-3, abs=0.0)


def test_a_contact_on_the_axis_cannot_be_reached_with_both_servos():
    tilted = Expression("0.06*x+0.03*y")
    job = TurningJob(tilted, 0.2e-3, 10e-6, rpm=60, nose=RoundNose(R))
    with pytest.raises(
        LimitError, match=r"for contacts within 3\d\.?\d* um of it, where the edge runs backwards"
    ):
        job.program(job.path(step=2 * np.pi / 90), servo="XZ")
    cored = TurningJob(tilted, 0.2e-3, 10e-6, rpm=60, core=0.05e-3, nose=RoundNose(R))
    assert cored.program(cored.path(step=2 * np.pi / 90), servo="XZ").X.min() > 0.0


def test_a_job_without_a_nose_makes_no_program_unless_it_is_asked_for_points():
    job = TurningJob(SineGrid(amplitude=3e-6, wavelength=0.7e-3), 2e-3, 10e-6, rpm=60, core=1.9e-3)
    path = job.path(step=0.1)
    with pytest.raises(
        DataError,
        match=r"cut points: these are points of the surface, no tip path.* cut_points=True",
    ):
        job.program(path)
    marked = job.program(path, cut_points=True)
    assert marked.quantity == "cut points"
    with pytest.raises(DataError, match="no tool runs it as it stands"):
        virtual_cut(marked, RoundNose(R), 1.95e-3)


def test_the_time_of_a_program_is_that_of_the_spindle_or_of_the_control():
    job = TurningJob(TORUS, 3e-3, 10e-6, rpm=60, core=2.9e-3, nose=RoundNose(R))
    path = job.path(step=2 * np.pi / 100)
    assert job.program(path).rpm == pytest.approx(60.0, abs=1e-9)
    slow = TurningJob(TORUS, 3e-3, 10e-6, rpm=60, core=2.9e-3, nose=RoundNose(R), block_time=20e-3)
    assert slow.program(slow.path(step=2 * np.pi / 100)).rpm == pytest.approx(30.0, abs=1e-9)


def program(**other):
    angle = np.linspace(0.0, 6.0, 7)
    words = {
        "X": 1e-3 - 1e-5 * angle,
        "azimuth": angle,
        "Z": 0 * angle,
        "t": angle + 1.0,
        "quantity": "tip",
    }
    return TurningProgram(**{**words, **other})


@pytest.mark.parametrize(
    ("other", "error", "match"),
    [
        (
            {"azimuth": [0, 1, 2, 1.5, 3, 4, 5]},
            DataError,
            "C turns back or stands still at block 3",
        ),
        ({"azimuth": [0, 1, 2, 2, 3, 4, 5]}, DataError, "stands still at block 3"),
        (
            {"t": [0, 1, 2, 2, 3, 4, 5]},
            InvalidSamplesError,
            "block 3 is reached at 2 s, not after block 2",
        ),
        ({"Z": [0, 1, np.nan, 2, 3, 4, 5]}, InvalidSamplesError, "Z of block 2 is nan"),
        ({"Z": [0.0, 1.0]}, DataError, "equally long"),
        ({"quantity": "points"}, DataError, "quantity is one of cut points, tip"),
        ({"interpolation": "circle"}, DataError, "interpolation is one of linear, spline, pvt"),
        ({"interpolation": "pvt"}, DataError, "needs the velocities"),
        ({"velocities": np.zeros((2, 7))}, DataError, r"must be \(3, 7\)"),
        (
            {"X": [1.0], "azimuth": [0.0], "Z": [0.0], "t": [0.0]},
            TooFewSamplesError,
            "needs 4 points",
        ),
    ],
)
def test_bad_programs_are_refused(other, error, match):
    with pytest.raises(error, match=match):
        program(**other)


def test_a_program_that_goes_backwards_is_clockwise():
    assert program().sense == "counterclockwise"
    assert program(azimuth=-np.linspace(0.0, 6.0, 7)).sense == "clockwise"
    assert np.isnan(program().at([0.5])[0]).all()


@pytest.mark.parametrize("setting", [None, ToolSetting(dx=1.3 * UM, dy=-0.8 * UM, dR=5 * UM)])
@pytest.mark.parametrize("sense", ["clockwise", "counterclockwise"])
def test_pvt_velocities_of_a_program_that_makes_up_for_the_tool_are_those_of_the_envelope(
    sense, setting
):
    """Z(t) = max over the edge of form - edge, written here; its rate by a difference of 2e-5 s."""
    rake, R_ = math.radians(-30), 0.4e-3
    grid = Expression("2e-7*sin(2*pi*x/2e-4)*cos(2*pi*y/2e-4)+3*x**2+1e-3*y")
    job = TurningJob(
        grid, 0.5e-3, 4e-6, rpm=20, core=0.485e-3, sense=sense, nose=RoundNose(R_, rake)
    )
    path = job.path(
        step=2 * np.pi / 60, interpolation="pvt"
    )  # 6 points a wave: differences are poor
    made = job.compensated(path, tool=setting)
    dx, dy, dR = (0.0, 0.0, 0.0) if setting is None else setting.values
    way = 1.0 if sense == "counterclockwise" else -1.0
    psi = np.linspace(-0.25, 0.25, 400_001)
    u = (R_ + dR) * np.sin(psi)
    w = (R_ + dR) * (1.0 - np.cos(psi))
    ex, ey, ez = u + dx, -way * w * math.sin(rake) + dy, w * math.cos(rake)

    def height(t):
        X = made.X[0] - 4e-6 * (t - made.t[0]) / 3.0  # 20 rpm: a turn in 3 s
        phi = made.azimuth[0] + way * 2 * math.pi * (t - made.t[0]) / 3.0
        px = (X + ex) * math.cos(phi) - ey * math.sin(phi)
        py = (X + ex) * math.sin(phi) + ey * math.cos(phi)
        return float((grid(px, py) - ez).max())

    for i in (1, 17, 40, 58, 100):
        h = 1e-5
        rate = (height(made.t[i] + h) - height(made.t[i] - h)) / (2 * h)
        # the file has 1e-10 m/s as its last digit; a spline through the points is off by 1e-8
        assert made.velocities[2, i] == pytest.approx(rate, abs=3e-10)
        assert made.Z[i] == pytest.approx(height(made.t[i]), abs=0.01 * NM)


SMALL = 0.3e-3
"""m, radius of the nose of these programs."""
BUMP = Expression("5*x**2+8*y**2+1e-7*exp(-((x-1.165e-3)**2+y**2)/(2*(6e-6)**2))")


def envelope(X, azimuth, Z, rho, theta):
    """Lowest passage of a round nose without rake over places: it stays in the meridian plane.

    X and Z are lines over the azimuth between the blocks, or a course so dense that it does not matter.
    """
    order = np.argsort(azimuth)
    X, azimuth, Z = X[order], azimuth[order], Z[order]
    lowest = np.full(rho.shape, np.inf)
    for k in range(math.floor(azimuth[0] / (2 * np.pi)), math.ceil(azimuth[-1] / (2 * np.pi)) + 1):
        at = theta + 2 * np.pi * k
        on = (at >= azimuth[0]) & (at <= azimuth[-1])
        x, z = np.interp(at, azimuth, X), np.interp(at, azimuth, Z)
        beside = rho - x
        on &= np.abs(beside) < SMALL
        z = np.where(on, z + SMALL - np.sqrt(np.where(on, SMALL**2 - beside**2, 1.0)), np.inf)
        lowest = np.minimum(lowest, z)
    return lowest


def tip_by_hand(form, X, azimuth):
    """Z = max over the edge of form - edge, by samples and a parabola through the three best."""
    psi = np.linspace(-0.1, 0.1, 401)
    u, w = SMALL * np.sin(psi), SMALL * (1 - np.cos(psi))
    z = np.empty(X.size)
    for first in range(0, X.size, 2000):
        part = slice(first, first + 2000)
        c, s = np.cos(azimuth[part])[:, None], np.sin(azimuth[part])[:, None]
        at = (X[part, None] + u) * c, (X[part, None] + u) * s
        f = form(*at) - w
        i = np.arange(f.shape[0]), np.argmax(f, axis=1)
        a, b, d = f[i[0], i[1] - 1], f[i], f[i[0], i[1] + 1]
        z[part] = b + (a - d) ** 2 / (8 * (2 * b - a - d))
    return z


def course_of(file):
    """X, azimuth and Z of a clockwise program, split by hand."""
    rows = re.findall(r"X([\d.]+) C(-?[\d.]+) Z(-?[\d.]+)", file.read_text())
    X, C, Z = np.array(rows, dtype=float).T
    return X * MM, -np.radians(C), Z * MM


@pytest.mark.parametrize(
    "interpolation", [pytest.param("linear", marks=pytest.mark.slow), "spline"]
)
def test_the_fewest_points_hold_their_tolerance_on_the_part_cut_from_the_bytes(
    tmp_path, interpolation
):
    """A bump of 6 um: the file is split by hand and cut by an envelope of the test."""
    tolerance, core = 2 * NM, 1.104e-3
    job = TurningJob(BUMP, 1.2e-3, 8e-6, rpm=60, core=core, nose=RoundNose(SMALL), sense="clockwise")  # fmt: skip
    program = job.program(job.plan(tolerance, interpolation=interpolation).path)
    axes = LatheAxes(
        "workpiece ccw", inverse_time="1/min", x_decimals=9, c_decimals=8, z_decimals=10,
        spline_word="CSPLINE" if interpolation == "spline" else None,
    )  # fmt: skip
    file = tmp_path / "p.nc"
    write_program(program, file, axes, nose=RoundNose(SMALL), form=BUMP, verify=False)
    course = course_of(file)
    if interpolation == "spline":
        dense = np.linspace(course[1][0], course[1][-1], 12 * course[0].size)
        through = (CubicSpline(-course[1], v)(-dense) for v in (course[0], course[2]))
        course = next(through), dense, next(through)
    x, y = np.meshgrid(1.165e-3 + np.linspace(-25e-6, 25e-6, 91), np.linspace(-25e-6, 25e-6, 91))
    rho, theta = np.hypot(x, y).ravel(), np.arctan2(y, x).ravel()
    u = 2 * np.pi * np.arange(12)[:, None] + np.linspace(-0.03, 0.03, 301)
    u = u[u >= 0.0]
    exact = 1.2e-3 - 8e-6 * u / (2 * np.pi), -u

    left = envelope(*course, rho, theta) - envelope(*exact, tip_by_hand(BUMP, *exact), rho, theta)

    assert 0.7 * tolerance < np.ptp(left) <= tolerance


def test_turns_that_cut_away_what_their_neighbours_leave_save_points():
    """Turns 1 um apart, points of one beside those of the next: an envelope of the test holds the tolerance."""
    tolerance, core = 40 * NM, 1.155e-3
    grid = Expression("3e-6*(sin(2*pi*x/7e-4)+cos(2*pi*y/7e-4))")
    job = TurningJob(grid, 1.2e-3, 1e-6, rpm=60, core=core, nose=RoundNose(SMALL), sense="clockwise")  # fmt: skip
    plan = job.plan(tolerance, interpolation="spline")
    program = job.program(plan)
    rng = np.random.default_rng(6)
    # everywhere, and closely where the free end of the spline before the rim digs into the part
    rho, theta = rng.uniform(core, 1.2e-3, 2000), rng.uniform(-np.pi, np.pi, 2000)
    rho = np.append(rho, rng.uniform(1.19e-3, 1.194e-3, 2000))
    theta = np.append(theta, rng.uniform(-0.1, 0.4, 2000))
    wave = 2 * np.pi / 7e-4
    slope = 3e-6 * wave * np.cos(wave * rho * np.cos(theta)) * np.cos(theta)
    slope -= 3e-6 * wave * np.sin(wave * rho * np.sin(theta)) * np.sin(theta)
    tip = rho - SMALL * slope / np.hypot(1.0, slope)  # of the turn that touches a place
    on = (tip > core) & (tip < 1.2e-3)  # places that a turn touches
    rho, theta = rho[on], theta[on]
    through = (CubicSpline(program.t, v) for v in (program.X, program.azimuth, program.Z))
    t = np.linspace(program.t[0], program.t[-1], 40 * len(program))
    left = envelope(*(f(t) for f in through), rho, theta)
    left -= grid(rho * np.cos(theta), rho * np.sin(theta))
    cusp = 0.6 * NM  # (1 um)^2 / (8 * 0.3 mm), and a little for the hollows
    assert 0.7 * tolerance < np.ptp(left) <= tolerance + cusp
    # the tip itself is off by more between its points
    assert job.predict(plan).budget.contributions[0].pv > 1.1 * tolerance


@pytest.mark.parametrize("servo", ["Z", "XZ"])
@pytest.mark.parametrize(
    ("text", "ring"), [("-14*x**2-9*y**2+0.02*x", 50), ("6*x**2+9*y**2", 0)], ids=["dome", "bowl"]
)
def test_the_part_is_cut_up_to_its_rim(tmp_path, servo, text, ring):
    """The bytes are split by hand and cut by an envelope of the test, up to the rim at every azimuth."""
    form, feed, nose = Expression(text), 6e-6, RoundNose(SMALL)
    job = TurningJob(form, 1.2e-3, feed, rpm=60, core=1.14e-3, nose=nose, sense="clockwise")
    axes = LatheAxes(
        "workpiece ccw", inverse_time="1/min", x_decimals=9, c_decimals=8, z_decimals=10,
        spline_word="CSPLINE",
    )  # fmt: skip
    rng = np.random.default_rng(1)
    rho, theta = rng.uniform(1.18e-3, 1.2e-3, 3000), rng.uniform(-np.pi, np.pi, 3000)
    rho[:500] = 1.2e-3
    left = {}
    for lead_in in (None, 3):
        program = job.program(
            job.path(step=np.radians(3), lead_in=lead_in, servo=servo), servo=servo
        )
        file = tmp_path / f"{lead_in}.nc"
        write_program(program, file, axes, nose=nose, form=form, verify=False)
        X, azimuth, Z = course_of(file)
        dense = np.linspace(azimuth[0], azimuth[-1], 40 * X.size)
        course = CubicSpline(-azimuth, X)(-dense), dense, CubicSpline(-azimuth, Z)(-dense)
        left[lead_in] = envelope(*course, rho, theta) - form(
            rho * np.cos(theta), rho * np.sin(theta)
        )
    cusp = feed**2 / (8 * SMALL)
    assert left[None].min() > -0.1 * NM
    assert left[None].max() < 1.02 * cusp
    # with three points before it: at the rim a turn is missing on its outer side
    if ring or servo == "XZ":  # the nose reaches the rim of a bowl from inside
        assert left[3].max() > max(ring * NM, 2 * cusp)
    if servo == "Z":
        said = " ".join(job.program(job.path(step=np.radians(3), lead_in=3)).messages)
        assert ("the flank of the nose alone cuts" in said) == bool(ring)


def test_a_tool_that_stands_further_in_is_given_the_points_that_cut_the_rim():
    """The tool is cut where it stands: 8 um in at a feed of 6 um, the first turn misses the rim."""
    form, feed, setting = Expression("6*x**2-9*y**2+0.02*x"), 6e-6, ToolSetting(dx=-8e-6)
    job = TurningJob(form, 1.2e-3, feed, rpm=60, core=1.17e-3, nose=RoundNose(SMALL))
    theta = np.linspace(-np.pi, np.pi, 2001)
    rim = np.full(theta.size, 1.2e-3)
    cusp, left, lead_in = feed**2 / (8 * SMALL), [], None
    for _ in range(2):
        program = job.compensated(job.path(step=np.radians(3), lead_in=lead_in), tool=setting)
        t = np.linspace(program.t[0], program.t[-1], 40 * len(program))
        X, azimuth, Z = (
            CubicSpline(program.t, v)(t) for v in (program.X, program.azimuth, program.Z)
        )
        cut = envelope(X - 8e-6, azimuth, Z, rim, theta)
        left.append((cut - form(rim * np.cos(theta), rim * np.sin(theta))).max())
        said = re.findall(r"leaves more than between turns; give lead_in = (\d+)", " ".join(program.messages))  # fmt: skip
        lead_in = int(said[0]) if said else None
    assert left[0] > 1.5 * cusp
    assert left[1] < 1.02 * cusp
    assert lead_in is None  # said once


def disc_of(form, whole, reach):
    """A map of 25 um whose pixels beyond a radius were not measured."""
    y, x = np.mgrid[-60:61, -60:61] * 25e-6
    z = np.where(np.hypot(x, y) <= reach, form(x, y), np.nan)[60 - whole : 61 + whole, 60 - whole : 61 + whole]  # fmt: skip
    return GridForm(Surface(z, dx=25e-6, dy=25e-6, origin=(-whole * 25e-6, -whole * 25e-6)))


@pytest.mark.parametrize("servo", ["Z", "XZ"])
@pytest.mark.parametrize("bend", [9.0, -9.0], ids=["bowl", "dome"])
def test_a_map_that_ends_at_the_rim_is_cut_up_to_it_or_refused_with_the_way_out(servo, bend):
    form = Expression(f"{bend}*x**2+0.6*{bend}*y**2+0.01*x")
    words = {"core": 0.93e-3, "nose": RoundNose(SMALL), "sense": "clockwise"}

    def made(grid, **of_path):
        job = TurningJob(grid, 1e-3, 10e-6, rpm=60, **words)
        return job.program(job.path(step=np.radians(3), servo=servo, **of_path), servo=servo)

    # pixels of a disc end within its circle, most of the rim has none
    with pytest.raises(InvalidSamplesError, match=r"% of the circle of 1.* take a smaller radius, give a form"):  # fmt: skip
        made(disc_of(form, 60, 1e-3))
    touches = disc_of(form, 40, 9.0)  # the border of the map touches the rim
    if servo == "XZ":  # contacts begin outside it
        with pytest.raises(InvalidSamplesError, match=r"circle of 1\.015 mm .* give a form"):
            made(touches)
        with pytest.raises(InvalidSamplesError, match=r"contacts of servo XZ, the first at rho = 1\.01.*servo=\"Z\""):  # fmt: skip
            made(touches, lead_in=130)
    whole = disc_of(form, 60, 1.1e-3) if servo == "XZ" else touches
    program = made(whole)
    said = " ".join(program.messages)
    assert ("air was assumed" in said) == (servo == "Z")
    t = np.linspace(program.t[0], program.t[-1], 40 * len(program))
    course = [CubicSpline(program.t, v)(t) for v in (program.X, program.azimuth, program.Z)]
    rng = np.random.default_rng(2)
    rho, theta = rng.uniform(0.98e-3, 1e-3, 2000), rng.uniform(-np.pi, np.pi, 2000)
    rho[:500] = 1e-3
    left = envelope(*course, rho, theta) - form(rho * np.cos(theta), rho * np.sin(theta))
    assert left.min() > -0.1 * NM
    assert left.max() < 1.02 * (10e-6) ** 2 / (8 * SMALL)


RIPPLES = Expression("5*x**2+8*y**2+4e-7*sin(2*pi*y/1.5e-4)")


@pytest.mark.parametrize(("form", "degrees"), [(RIPPLES, 0.5), (BUMP, 0.5)], ids=["waves", "bump"])
def test_what_a_file_is_off_without_cusps_is_what_its_blocks_leave(tmp_path, form, degrees):
    """Cusps of 34 and 42 nm hide chords of 19 nm where the largest cusp is taken off the P-V.

    The truth is an envelope of the test along the words of the file, beside that of the exact tip.
    """
    core = 1.136e-3
    job = TurningJob(form, 1.2e-3, 8e-6, rpm=60, core=core, nose=RoundNose(SMALL), sense="clockwise")  # fmt: skip
    program = job.program(job.path(step=np.radians(degrees), interpolation="linear"))
    axes = LatheAxes("workpiece ccw", inverse_time="1/min", x_decimals=9, c_decimals=8, z_decimals=10)  # fmt: skip
    words = {"nose": RoundNose(SMALL), "form": form}
    file = tmp_path / "p.nc"
    found = write_program(program, file, axes, **words).check
    rng = np.random.default_rng(3)
    rho = np.sqrt(rng.uniform((core + 9e-6) ** 2, (1.2e-3 - 9e-6) ** 2, 30_000))
    theta = rng.uniform(-np.pi, np.pi, rho.size)
    rho[:8000] = 1.165e-3 + rng.uniform(-15e-6, 15e-6, 8000)
    theta[:8000] = rng.uniform(-0.02, 0.02, 8000)
    u = np.linspace(0.0, 16 * np.pi, 40_000)
    u = np.sort(np.append(u, 2 * np.pi * np.arange(8)[:, None] + np.linspace(0, 0.03, 200)))
    u = np.unique(np.append(u, 2 * np.pi * np.arange(1, 9)[:, None] - np.linspace(0, 0.03, 200)))
    exact = 1.2e-3 - 8e-6 * u / (2 * np.pi), -u
    left = envelope(*course_of(file), rho, theta)
    left -= envelope(*exact, tip_by_hand(form, *exact), rho, theta)
    off = float(np.ptp(left))

    assert found.form_error == pytest.approx(
        off, rel=0.06, abs=0.0
    )  # places at random on either side
    assert found.peak_to_valley - found.cusp < 0.7 * off
    stated = json.loads((tmp_path / "p.nc.json").read_text())["virtual_part"]["without_cusps_nm"]
    assert stated == pytest.approx(found.form_error / NM, abs=1e-4)
    with pytest.raises(LimitError, match=r"off by .* P-V without cusps, the tolerance is"):
        write_program(program, tmp_path / "q.nc", axes, tolerance=0.9 * off, **words)
    assert not (tmp_path / "q.nc").exists()
    write_program(program, tmp_path / "q.nc", axes, tolerance=1.06 * off, **words)


def test_what_a_nose_leaves_of_a_hollow_is_no_cusp():
    """A groove of 200 nm with a radius of 45 um at its bottom, below a nose of 0.3 mm that rides over it."""
    groove = Expression("5*x**2+5*y**2-2e-7*exp(-(sqrt(x**2+y**2)-2e-4)**2/(2*(3e-6)**2))")
    u = np.arange(0.0, 32 * np.pi, np.radians(1.0))
    X = 0.26e-3 - 8e-6 * u / (2 * np.pi)
    program = TurningProgram(X, -u, tip_by_hand(groove, X, -u), u / (2 * np.pi), "tip", "linear")

    found = check_program(program, RoundNose(SMALL), groove)

    assert found.form_error > 150 * NM
    assert any("does not fit the surface" in m for m in found.messages)


def contacts_on_a_spiral(bend, waves, per_turn=180, first=1.5e-3, turns=20.3, feed=10e-6, way=1):
    """X, azimuth, Z of the small nose without rake, its contacts on a spiral; and the height, numpy alone."""

    def height(x, y):
        return 0.5 * bend * (x * x + 0.6 * y * y) + waves * np.sin(2 * np.pi * x / 9e-4)

    angle = 2 * np.pi * np.arange(round(turns * per_turn)) / per_turn
    rho, theta = first - feed * angle / (2 * np.pi), way * angle
    c, s = np.cos(theta), np.sin(theta)
    gx = bend * rho * c + waves * 2 * np.pi / 9e-4 * np.cos(2 * np.pi * rho * c / 9e-4)
    rise = c * gx + s * 0.6 * bend * rho * s
    psi = np.arctan(rise)
    return (
        rho - SMALL * np.sin(psi),
        theta,
        height(rho * c, rho * s) - SMALL * (1 - np.cos(psi)),
        height,
    )


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize("bend", [300.0, -300.0], ids=["bowl", "dome"])
def test_the_advance_of_a_turn_is_that_of_places_a_turn_apart_not_of_the_ends(bend, way):
    """X swings by more than it advances: its ends say 7.7 and 12.8 um a turn, tips are 9.4 and 10.6 um apart."""
    X, azimuth, Z, height = contacts_on_a_spiral(bend, 4e-6, way=way)
    program = TurningProgram(X, azimuth, Z, np.arange(X.size) / 180.0, "tip")
    apart = X[:-180] - X[180:]  # the same azimuth, a turn later
    of_ends = (X[0] - X[-1]) / program.turns
    assert abs(of_ends / apart.mean() - 1) > 0.05
    assert program.feed == pytest.approx(apart.mean(), rel=3e-3, abs=0.0)
    at = slice(200, 3000)
    larger = np.fmax(apart[20:-180], apart[200:])
    assert program.advance_at(azimuth[at][: larger.size]) == pytest.approx(larger[: X[at].size], abs=1e-12)  # fmt: skip
    # cusps along a radius: the lowest of the circles of all turns there
    form = Expression(f"0.5*({bend})*(x**2+0.6*y**2)+4e-6*sin(2*pi*x/9e-4)")
    found = check_program(program, RoundNose(SMALL), form, places=2000, region=(1.33e-3, 1.46e-3))
    highest = 0.0
    for k in range(0, 180, 4):
        x, z = X[k::180], Z[k::180]
        rho = np.linspace(1.34e-3, 1.45e-3, 8001)
        u = rho[:, None] - x
        cut = (z + SMALL - np.sqrt(SMALL**2 - u**2)).min(axis=1)
        c, s = np.cos(azimuth[k]), np.sin(azimuth[k])
        left = cut - height(rho * c, rho * s)
        highest = max(highest, left.max())
    assert found.cusp == pytest.approx(highest, rel=0.03, abs=0.0)


def test_a_spline_that_swings_beyond_its_points_leaves_the_travel_there():
    """A tilted plane with its crest between two of 9 points a turn: the spline tops them, as scipy draws it."""
    words = {"core": 1.98e-3, "nose": RoundNose(R), "sense": "clockwise"}

    def made(z_travel=None, interpolation="spline"):
        job = TurningJob(Expression("0.05*x"), 2e-3, 10e-6, rpm=60, z_travel=z_travel, **words)
        return job.program(
            job.path(step=np.pi / 4.5, start=np.pi / 9, interpolation=interpolation)
        )

    free = made()
    course = CubicSpline(free.t, free.Z)(np.linspace(free.t[0], free.t[-1], 1000 * len(free)))
    over = float(course.max() - free.Z.max())
    assert over > 1 * UM
    low = float(course.min()) - 1 * UM
    end = float(free.Z.max()) + 0.2 * over
    with pytest.raises(LimitError, match=r"Z goes .* above its travel") as found:
        made((low, end))
    size, unit = re.search(r"goes ([\d.]+) (um|nm) above", str(found.value)).groups()
    assert float(size) * {"um": UM, "nm": NM}[unit] == pytest.approx(0.8 * over, rel=1e-3, abs=0.0)
    made((low, float(course.max()) + 1 * NM))
    made((low, end), "linear")


def test_what_stands_outside_the_rim_keeps_the_nose_off_the_part():
    """A wall from 1.03 mm on, higher on one side: what stays at the rim by circles rolled along a radius."""

    def wall(x, y):
        r = np.hypot(x, y)
        return 20e-6 * (1 + 0.2 * x / r) * (1 + np.tanh((r - 1.03e-3) / 6e-6)) + 4 * r**2

    text = "20e-6*(1+0.2*x/r)*(1+tanh((r-1.03e-3)/6e-6))+4*r**2"

    def job(radius, formula=text):
        return TurningJob(
            Expression(formula), radius, 10e-6, rpm=60, core=0.8e-3, nose=RoundNose(SMALL)
        )

    def made(radius, formula=text):
        own = job(radius, formula)
        return own.program(own.path(step=np.radians(4)))

    with pytest.raises(LimitError, match="outside the rim") as found:
        made(1e-3)
    psi = np.linspace(-1.2, 1.2, 24001)
    left = []
    for X in 1e-3 - np.linspace(-0.3e-3, 0.299e-3, 3001):  # the highest side, azimuth 0
        tip = (wall(X + SMALL * np.sin(psi), 0.0) - SMALL * (1 - np.cos(psi))).max()
        left.append(tip + SMALL - math.sqrt(SMALL**2 - (1e-3 - X) ** 2) - wall(1e-3, 0.0))
    size = float(re.search(r"leaves up to ([\d.]+) um at the rim", str(found.value))[1]) * UM
    assert size == pytest.approx(min(left), rel=2e-3, abs=0.0)
    at = float(re.search(r"azimuth ([\d.]+) degrees", str(found.value))[1])
    assert min(at, 360 - at) < 5
    made(0.85e-3)  # the nose does not reach the wall from there
    post = text.replace("(r-1.03e-3)", "(0.77e-3-r)")
    with pytest.raises(LimitError, match=r"in the core.*larger core"):
        made(1e-3, post)
    made(1e-3, post.replace("0.77e-3", "0.6e-3"))
    # further out, or lower than the bowl rises under the nose: the nose passes it
    made(1e-3, text.replace("1.03e-3", "1.2e-3"))
    made(1e-3, text.replace("20e-6*(1+0.2*x/r)*(1+tanh((r-1.03e-3)/6e-6))", "1e-6*(1+tanh((r-1.03e-3)/30e-6))"))  # fmt: skip


@pytest.mark.parametrize("radius", [1.99e-3, 2e-3])
def test_a_hemisphere_is_cut_up_to_where_the_edge_leaves_it(radius):
    """A dome of 2 mm, by circles along a radius: what stays, across the surface, is that of turns so far apart."""
    job = TurningJob(Sphere(R=-2e-3), radius, 10e-6, rpm=60, core=radius - 60e-6, nose=RoundNose(SMALL))  # fmt: skip
    program = job.program(job.path(step=np.radians(4)))
    assert program.X[0] <= 2e-3 + SMALL  # where the edge leaves the sphere
    assert program.X[0] > 2e-3 + SMALL - (15e-6 if radius == 2e-3 else 10e-6)
    k = int(program.lead_in) % 90
    x, z = program.X[k::90], program.Z[k::90]
    # the tip on the sphere of both radii, azimuth by azimuth the same
    assert np.abs(np.hypot(x, z + 2e-3 + SMALL) - 2e-3 - SMALL).max() < 1e-12
    rho = np.linspace(x[-1] / (2e-3 + SMALL) * 2e-3 + 20e-6, 1.985e-3, 4001)
    cut = (z + SMALL - np.sqrt(np.clip(SMALL**2 - (rho[:, None] - x) ** 2, 0, None)) + np.where(np.abs(rho[:, None] - x) < SMALL, 0, 1)).min(axis=1)  # fmt: skip
    off = np.hypot(rho, cut + 2e-3) - 2e-3  # across the surface
    psi = np.arcsin(np.clip(rho / 2e-3, 0, 1))
    apart = 2e-3 * 10e-6 / ((2e-3 + SMALL) * np.cos(psi))
    assert off.min() > -1e-13
    assert (off < 1.3 * apart**2 / 8 * (1 / SMALL + 1 / 2e-3) + 1e-12).all()


@pytest.mark.parametrize("hole", [True, False])
@pytest.mark.parametrize("walls", [True, False])
def test_a_hole_in_a_mesh_is_no_air(hole, walls):
    """A nose of 0.2 mm would plunge 69 um into a hole of 0.24 mm; with walls and floor it is a pocket."""
    step = 1e-4
    at = np.arange(-22, 23)
    triangles = []
    for i in at[:-1]:
        for j in at[:-1]:
            x, y = np.meshgrid([i * step, (i + 1) * step], [j * step, (j + 1) * step])
            is_hole = hole and abs(i - 9) < 1.5 and abs(j) < 1.5
            if is_hole and not walls:
                continue
            z = 1e-6 * np.cos(2 * np.pi * x / 4e-3) - (0.0 if not is_hole else 1e-6)
            p = np.stack([x, y, z], axis=-1)
            triangles += [[p[0, 0], p[0, 1], p[1, 0]], [p[1, 0], p[0, 1], p[1, 1]]]
    mesh = from_triangles(np.array(triangles))

    def job():
        return TurningJob(mesh, 1.8e-3, 20e-6, rpm=60, nose=RoundNose(0.2e-3))

    if not hole or walls:
        assert job().radius == pytest.approx(1.8e-3, abs=0.0)
        return
    with pytest.raises(InvalidSamplesError, match=r"the mesh ends, or has a hole, at rho = 8\d\d"):
        job()
