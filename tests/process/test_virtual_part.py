"""The virtual part against foreign reference cuts, and against an envelope in another frame."""

import math

import numpy as np
import pytest

from metrosep.core.errors import DataError
from metrosep.forms import Expression, Sphere, Toric
from metrosep.process import (
    EdgeProfile,
    FollowUpMap,
    RoundNose,
    ToolSetting,
    TurningJob,
    TurningProgram,
    edge_error,
    gouge_check,
    tip_path,
    virtual_cut,
)

NM, UM, MM = 1e-9, 1e-6, 1e-3
R = 0.6e-3
TORUS = Toric(Rb=110e-3, Rd=70e-3)
WAVES = Expression("3e-6*(sin(2*pi*x/7e-4)+cos(2*pi*y/7e-4))")
SET = ToolSetting(dx=0.3e-6, dy=-0.2e-6, dR=3e-6)
PLACES = np.array([[1.0, 0.3], [1.5, -2.0], [2.0, 1.4], [2.5, 3.0]])


def spiral(
    form, nose, sense, *, outer=3e-3, feed=10e-6, per_turn=120, first=-10, inner=0.6e-3, **words
):
    """Tips at constant angle, from `first` turns before `outer` on."""
    turns = (outer - inner) / feed - first
    T = 2 * np.pi * (first + np.arange(round(turns * per_turn)) / per_turn)
    X = outer - feed * T / (2 * np.pi)
    azimuth = -T if sense == "clockwise" else T
    Z = tip_path(form, X, azimuth, nose=nose, sense=sense).z
    return TurningProgram(X, azimuth, Z, (T - T[0]) / (2 * np.pi), "tip", **words)


@pytest.mark.parametrize(
    ("form", "degrees", "sense", "spline", "linear", "off"),
    [
        (TORUS, 0, "counterclockwise", (18.9207, 19.1247, 18.8578, 0.8123),
         (20.0800, 17.5190, 13.6737, 9.7462), (13.6193, 10.2436, 10.6399, -7.7338)),
        (TORUS, -30, "counterclockwise", (10.8144, 6.0498, 5.0216, 0.9351),
         (11.9785, 4.4314, -0.1491, 9.8722), (6.2666, -1.5476, -5.9136, -6.5229)),
        (TORUS, -30, "clockwise", (6.1819, 0.3614, 2.3480, 0.3730),
         (7.3487, -1.2410, -2.7976, 9.3263), (2.1041, -5.2999, -6.0425, -7.3126)),
        (WAVES, 0, "counterclockwise", (6.6659, 5.0301, 1.7873, 14.7513),
         (59.4603, -64.0157, -0.1067, 389.5285), (9.6827, 11.1592, 1.2772, 7.2471)),
        (WAVES, -30, "clockwise", (10.2810, 9.2041, 14.5443, 19.7556),
         (63.1474, -61.1307, 11.4039, 396.0224), (13.0061, 12.3716, 11.7759, 13.0749)),
    ],
)  # fmt: skip
def test_reference_cuts(form, degrees, sense, spline, linear, off):
    """specs/cutting-path.md, table 6.3, foreign code."""
    nose = RoundNose(R, math.radians(degrees))
    rho, theta = PLACES[:, 0] * MM, PLACES[:, 1]
    x, y = rho * np.cos(theta), rho * np.sin(theta)
    made = {w: spiral(form, nose, sense, interpolation=w) for w in ("spline", "linear")}
    for words, setting, expected in (
        ("spline", None, spline),
        ("linear", None, linear),
        ("spline", SET, off),
    ):
        found = virtual_cut(made[words], nose, x, y, form=form, setting=setting)
        assert found.error / NM == pytest.approx(expected, abs=1e-3)


# ---- an envelope in another frame, without our code: the part lies still, the tool goes round -----


class Brute:
    """The edge as complex numbers x + i y that turn with the tool; every turn is asked by Newton's method."""

    def __init__(self, t, X, phi, Z, R, rake, way, yaw=0.0, kind="cubic", off=(0.0, 0.0)):
        from scipy.interpolate import make_interp_spline

        degree = 3 if kind == "cubic" else 1
        self.axes = [make_interp_spline(t, v, k=degree) for v in (X, phi, Z)]
        self.ends, self.R, self.rake, self.way, self.yaw, self.off = (
            (t[0], t[-1]),
            R,
            rake,
            way,
            yaw,
            off,
        )

    def edge(self, psi):
        """Points of the tilted round edge: the face leans by the rake about x, then turns by the yaw."""
        along, up = self.R * np.sin(psi), self.R - self.R * np.cos(psi)
        flat = along - 1j * self.way * up * math.sin(self.rake)
        return flat * np.exp(1j * self.yaw) + complex(*self.off), up * math.cos(self.rake)

    def place(self, t, psi):
        X, phi, _ = (a(t) for a in self.axes)
        return (X + self.edge(psi)[0]) * np.exp(1j * phi)

    def height(self, target, times):
        """The lowest passage of the edge over a place of the part, from many starts in time."""
        t, psi = times.copy(), np.zeros(times.size)
        psi = np.arcsin(np.clip((abs(target) - self.axes[0](t)) / self.R, -0.99, 0.99))
        for _ in range(40):
            miss = self.place(t, psi) - target
            h, k = 1e-7, 1e-7
            by_t = (self.place(t + h, psi) - self.place(t - h, psi)) / (2 * h)
            by_psi = (self.place(t, psi + k) - self.place(t, psi - k)) / (2 * k)
            det = by_t.real * by_psi.imag - by_t.imag * by_psi.real
            dt = (miss.real * by_psi.imag - miss.imag * by_psi.real) / det
            dpsi = (by_t.real * miss.imag - by_t.imag * miss.real) / det
            t, psi = t - np.clip(dt, -0.05, 0.05), psi - np.clip(dpsi, -0.2, 0.2)
        good = (np.abs(self.place(t, psi) - target) < 1e-13) & (np.abs(psi) < 1.5)
        good &= (t > self.ends[0]) & (t < self.ends[1])
        return (self.axes[2](t) + self.edge(psi)[1])[good].min()


SADDLE = Expression("0.4*x**2-0.25*y**2+0.15*x*y+2e-7*sin(2*pi*x/9e-4)*cos(2*pi*(x+2*y)/1.3e-3)")


@pytest.mark.parametrize(
    ("form", "R_", "degrees", "yaw", "sense", "kind"),
    [
        (WAVES, 0.4e-3, 0.0, 0.0, "clockwise", "linear"),
        (TORUS, 0.8e-3, 7.0, 0.0, "counterclockwise", "spline"),
        (SADDLE, 0.5e-3, -25.0, 0.0, "clockwise", "spline"),
        (SADDLE, 0.5e-3, -25.0, 3.0, "counterclockwise", "spline"),
        (Sphere(R=-9e-3), 1.2e-3, 12.0, -2.0, "clockwise", "linear"),
    ],
)
def test_an_envelope_in_the_frame_of_the_part_agrees(form, R_, degrees, yaw, sense, kind, rng):
    nose = RoundNose(R_, math.radians(degrees), yaw=math.radians(yaw))
    made = spiral(
        form,
        nose,
        sense,
        outer=1.4e-3,
        feed=14e-6,
        per_turn=90,
        first=-8,
        inner=0.3e-3,
        interpolation=kind,
    )
    way = 1.0 if sense == "counterclockwise" else -1.0
    off = (0.4e-6, -0.7e-6)
    other = Brute(
        made.t, made.X, made.azimuth, made.Z, R_, math.radians(degrees), way, math.radians(yaw),
        "cubic" if kind == "spline" else "linear", off,
    )  # fmt: skip
    rho, theta = rng.uniform(0.55e-3, 1.2e-3, 12), rng.uniform(-3.0, 3.0, 12)
    found = virtual_cut(
        made,
        nose,
        rho * np.cos(theta),
        rho * np.sin(theta),
        form=form,
        setting=ToolSetting(dx=off[0], dy=off[1]),
    )
    for k in range(rho.size):
        # every turn, at the time when its azimuth is that of the place
        first = way * (theta[k] - made.azimuth[0]) / (2 * np.pi)
        times = (
            (np.arange(math.ceil(-first), math.floor(made.turns - first)) + first)
            * made.duration
            / made.turns
        )
        assert other.height(rho[k] * np.exp(1j * theta[k]), times) == pytest.approx(
            found.z[k], abs=1e-3 * NM
        )
    assert np.ptp(found.error) > 1 * NM  # cusps and the setting


def test_a_wrong_way_of_c_cuts_a_mirrored_part_and_the_check_sees_it():
    """The same words run by a machine whose C turns the other way: X and Z as they are, -azimuth."""
    nose = RoundNose(R)
    right = spiral(SADDLE, nose, "clockwise", outer=1.2e-3, inner=0.4e-3)
    wrong = TurningProgram(right.X, -right.azimuth, right.Z, right.t, "tip")
    rho, theta = np.meshgrid(np.linspace(0.7e-3, 1.0e-3, 12), np.linspace(0.0, 6.2, 24))
    x, y = rho * np.cos(theta), rho * np.sin(theta)
    good, bad = (virtual_cut(p, nose, x, y, form=SADDLE) for p in (right, wrong))
    mirrored = virtual_cut(wrong, nose, x, -y)
    assert mirrored.z == pytest.approx(good.z, abs=1e-15)
    assert good.peak_to_valley < 40 * NM
    assert bad.peak_to_valley > 200 * NM


def test_turns_infinitely_close_leave_the_error_of_the_edge():
    """Two ways to one number: the minimum along the edge, and the minimum over the turns."""
    rake = math.radians(-30)
    made_for, cuts = RoundNose(R), RoundNose(R, rake)
    program = spiral(
        TORUS,
        made_for,
        "clockwise",
        outer=8.97e-3,
        feed=0.4e-6,
        per_turn=180,
        first=0,
        inner=8.9e-3,
    )
    x, y = 9e-3 * math.cos(0.5), 9e-3 * math.sin(0.5)
    found = virtual_cut(program, cuts, x, y, form=TORUS).error.item()
    expected = edge_error(TORUS, x, y, nose=made_for, actual=cuts, sense="clockwise").item()
    assert found == pytest.approx(expected, abs=0.05 * NM)  # 0.03 nm of cusps
    assert expected / NM == pytest.approx(-364.11742, abs=1e-4)


def test_a_wavy_edge_and_a_window_cut_as_they_are():
    angle = np.radians(np.linspace(-60, 60, 481))
    wavy = RoundNose(
        R, edge=EdgeProfile(angle, 30 * NM * np.cos(2 * np.pi * angle / math.radians(1.0)))
    )
    program = spiral(WAVES, RoundNose(R), "clockwise", outer=1.2e-3, inner=0.3e-3)
    x = np.linspace(0.6e-3, 0.9e-3, 400)
    found = virtual_cut(program, wavy, x, form=WAVES)
    assert not found.messages
    # all turns and all of the edge in the plane y = 0, point by point
    psi = np.linspace(-0.2, 0.2, 400001)
    radius = R + wavy.edge.at(psi)
    k = np.arange(0, len(program), 120)
    ex, ez = radius * np.sin(psi), R - radius * np.cos(psi)
    for n in (11, 200, 377):
        lows = [
            program.Z[i] + np.interp(x[n] - program.X[i], ex, ez, left=np.inf, right=np.inf)
            for i in k
        ]
        assert min(lows) == pytest.approx(found.z[n], abs=1e-3 * NM)
    narrow = RoundNose(R, window=(-0.01, 0.5))
    sharp = virtual_cut(program, narrow, x, form=WAVES)
    assert sharp.psi.min() >= -0.01
    assert (
        sharp.z - virtual_cut(program, RoundNose(R), x).z
    ).max() > 1 * NM  # the dull part leaves material


def test_places_that_no_turn_decides_are_not_measured_and_counted():
    program = spiral(TORUS, RoundNose(R), "clockwise", first=0, inner=2e-3)
    found = virtual_cut(program, RoundNose(R), [0.5e-3, 1.99e-3, 2.5e-3, 3.3e-3], form=TORUS)
    assert np.isnan(found.z).tolist() == [True, True, False, True]
    assert found.messages[0].startswith("3 of 4 places have no height")
    with pytest.raises(DataError, match="cuts none of these places: it runs from X = 3 to 2 mm"):
        virtual_cut(program, RoundNose(R), 20e-3)
    with pytest.raises(DataError, match="must be a TurningProgram"):
        virtual_cut("part.nc", RoundNose(R), 1e-3)


def test_the_centre_of_a_tilted_plane_is_cut_from_beyond_the_axis():
    """Within R s0 of the axis contacts lie beyond it at some azimuths: there the edge runs backwards."""
    tilted = Expression("0.06*x+0.03*y")
    nose = RoundNose(R)
    turn = 2 * np.pi * np.arange(-10, 60, 1 / 240)
    X = 60e-6 - 1e-6 * turn / (2 * np.pi)
    program = TurningProgram(X, turn, tip_path(tilted, X, turn, nose=nose).z, turn + 100, "tip")
    rho = np.linspace(3e-6, 50e-6, 48)
    at = math.atan2(0.03, 0.06) + 0.1
    found = virtual_cut(program, nose, rho * np.cos(at), rho * np.sin(at), form=tilted)
    assert "beyond the axis, where it runs backwards" in found.messages[-1]
    assert np.nanmax(np.abs(found.error)) < 0.3 * NM  # cusps of 1 um


def test_an_outward_spiral_cuts_the_same_part():
    inward = spiral(WAVES, RoundNose(R), "clockwise", outer=1.2e-3, inner=0.4e-3)
    outward = TurningProgram(inward.X[::-1], inward.azimuth[::-1], inward.Z[::-1], inward.t, "tip")
    x, y = np.linspace(0.6e-3, 0.9e-3, 50), np.linspace(-0.3e-3, 0.3e-3, 50)
    one, other = (virtual_cut(p, RoundNose(R), x, y) for p in (inward, outward))
    assert outward.sense == "counterclockwise"
    assert other.z == pytest.approx(one.z, abs=1e-14)


# ---- grooves at random: none may be gouged, none missed ----------------------------------------


def grooves(count, seed):
    """Ring and straight grooves, with or without a slope, half of them too narrow for the nose."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        R_ = rng.uniform(0.1e-3, 1e-3)
        sigma = R_ * np.exp(rng.uniform(math.log(0.05), math.log(0.5)))
        bottom = R_ * rng.choice([rng.uniform(0.3, 0.95), rng.uniform(1.05, 3.0)])
        depth, at = sigma**2 / bottom, rng.uniform(1.5e-3, 4e-3)
        across = rng.choice(["r", "x"])
        bowl, ripple = rng.uniform(-2.0, 2.0), rng.uniform(0, 3e-8)
        form = Expression(
            f"-{depth}*exp(-({across}-{at})**2/(2*{sigma}**2)) + {ripple}*sin(2*pi*y/7e-4)+ {bowl}*(x*x+y*y)*0.5"
        )
        yield form, R_, sigma, at, across


def check_grooves(count, seed):
    gouging = 0
    for form, R_, sigma, at, across in grooves(count, seed):
        nose = RoundNose(R_)
        phi = 0.0 if across == "x" else 0.7
        reach = 1.2 * R_
        line = np.linspace(max(at - 4 * reach, 1e-5), at + 4 * reach, 24001)
        section = form(line * math.cos(phi), line * math.sin(phi))
        slope = np.gradient(section, line)
        # a circle that touches anywhere in the groove, and how far it reaches into the section beside
        deepest = 0.0
        for k in np.flatnonzero(np.abs(line - at) < 2.5 * sigma)[::199]:
            cx = line[k] - R_ * slope[k] / math.hypot(1, slope[k])
            cz = section[k] + R_ / math.hypot(1, slope[k])
            near = np.abs(line - cx) < 0.999 * R_
            deepest = max(
                deepest,
                float((section[near] - cz + np.sqrt(R_**2 - (line[near] - cx) ** 2)).max()),
            )
        X = at + R_ * np.linspace(-0.4, 0.4, 30)
        made = tip_path(form, X, np.full(30, phi), nose=nose)
        psi = np.linspace(-1.2, 1.2, 6001)
        for x, z in zip(X[::5], made.z[::5], strict=True):
            along = x + R_ * np.sin(psi)
            air = z + R_ * (1 - np.cos(psi)) - form(along * math.cos(phi), along * math.sin(phi))
            assert air.min() > -1e-13  # cuts nothing of the surface
            assert air.min() < (4e-4 * R_) ** 2 * (1 / R_ + 2 / sigma)  # half a step of the edge
        found = gouge_check(form, nose, region=(max(at - 2 * R_, 1e-5), at + 2 * R_), n_theta=12)
        if deepest > 1 * NM:
            gouging += 1
            assert not found.ok, (form, R_)
    return gouging


def test_no_gouge_of_twelve_grooves_is_missed():
    assert check_grooves(12, 1) == 5


@pytest.mark.slow
def test_no_gouge_of_a_thousand_grooves_is_missed():
    assert check_grooves(1000, 2) > 300


def test_few_places_on_a_part_of_many_turns_are_all_cut(rng):
    """Cusps of a flat in closed form: places half a part apart ask turns near them, not of the whole part."""
    feed, outer = 4e-6, 16e-3
    turn = 2 * np.pi * np.arange(0, 3900, 1 / 8)
    X = outer - feed * turn / (2 * np.pi)
    program = TurningProgram(X, turn, 0.0 * turn, turn, "tip", "linear")
    rho, theta = rng.uniform(0.7e-3, 15.3e-3, 400), rng.uniform(-np.pi, np.pi, 400)
    found = virtual_cut(program, RoundNose(0.2e-3), rho * np.cos(theta), rho * np.sin(theta))
    away = np.mod((outer - rho - feed * np.mod(theta, 2 * np.pi) / (2 * np.pi)), feed)
    away = np.minimum(away, feed - away)
    assert found.z == pytest.approx(0.2e-3 - np.sqrt(0.2e-3**2 - away**2), abs=1e-6 * NM)


@pytest.mark.parametrize("waves", [False, True])
def test_both_axes_make_up_for_the_tool_as_it_is_set(waves, rng):
    """Servo XZ with dx, dy, dR: the envelope in the other frame leaves cusps only; a flipped sign leaves more."""
    nose = RoundNose(0.5e-3, math.radians(-20))
    if waves:
        psi = np.radians(np.linspace(-60, 60, 81))
        nose = RoundNose(
            0.5e-3, math.radians(-20), edge=EdgeProfile(psi, 30e-9 * np.cos(18 * psi + 0.4))
        )
    job = TurningJob(SADDLE, 1.2e-3, 8e-6, rpm=60, core=0.9e-3, nose=nose, sense="clockwise")
    path = job.path(step=2 * np.pi / 90)
    setting = ToolSetting(dx=1.5e-6, dy=-2e-6, dR=4e-6)
    rho, theta = rng.uniform(0.98e-3, 1.12e-3, 8), rng.uniform(-3.0, 3.0, 8)
    x, y = rho * np.cos(theta), rho * np.sin(theta)
    left = {}
    for way in (1.0, -1.0):
        tool = ToolSetting(*(way * setting.values).tolist())
        made = job.compensated(path, tool=tool, servo="XZ")
        found = virtual_cut(made, nose, x, y, form=SADDLE, setting=setting)
        left[way] = found.error
        assert np.array_equal(made.nominal, job.program(path, servo="XZ").Z)
        if waves:
            continue
        other = Brute(
            made.t, made.X, made.azimuth, made.Z, 0.5e-3 + 4e-6, math.radians(-20), -1.0,
            off=(1.5e-6, -2e-6),
        )  # fmt: skip
        for k in range(rho.size):
            first = -(theta[k] - made.azimuth[0]) / (2 * np.pi)
            turns = np.arange(math.ceil(-first), math.floor(made.turns - first)) + first
            z = other.height(
                rho[k] * np.exp(1j * theta[k]), made.t[0] + turns * made.duration / made.turns
            )
            assert z == pytest.approx(found.z[k], abs=1e-3 * NM)
    cusp = 8e-6**2 / (8 * 0.5e-3)
    assert left[1.0].min() > -0.05 * NM  # 90 points a turn
    assert left[1.0].max() < (1.1 if not waves else 2.0) * cusp
    assert np.ptp(left[-1.0]) > 20 * NM


@pytest.mark.parametrize("joined", ["linear", "spline"])
def test_a_plan_for_both_axes_holds_its_tolerance_where_one_for_z_alone_does_not_count(joined):
    """Between the points of servo XZ, X bends too: the envelope of a fine path against that of the plan."""
    nose = RoundNose(0.5e-3, math.radians(-20))
    job = TurningJob(WAVES, 1.2e-3, 10e-6, rpm=60, core=1.1e-3, nose=nose, sense="clockwise")
    plan = job.plan(3e-9, interpolation=joined, servo="XZ")
    made = job.program(plan, servo="XZ")
    knots = made.t[plan.path.lead_in :]
    t = np.concatenate([knots[:-1] + s * np.diff(knots) for s in (0.3, 0.5, 0.7)])
    X, azimuth, Z = made.at(t)
    off = Z - tip_path(WAVES, X, azimuth, nose=nose, sense="clockwise").z
    assert 2e-9 < np.ptp(np.append(off, 0.0)) <= 3e-9
    assert plan.points.peak_to_valley <= 3e-9
    with pytest.raises(DataError, match="least-squares"):
        job.program(job.path(step=0.05, knots="least-squares"), servo="XZ")


class OnSpindle(Brute):
    """The same, the part on a spindle that moves and tilts, the tool on a slide that is not straight."""

    def __init__(self, *args, shift, tilt, slide):
        super().__init__(*args)
        self.shift, self.tilt, self.slide = shift, tilt, slide

    def solid(self, t, psi):
        """A point of the edge in the machine, then in the part that stands where the spindle holds it."""
        X, phi, Z = (a(t) for a in self.axes)
        flat, up = self.edge(psi)
        across, lift = self.slide(X)
        x, y, z = X + flat.real, flat.imag + across, Z + up + lift
        c = -phi  # C turns the workpiece counter-clockwise
        ex, ey, ez = self.shift(c)
        b = self.tilt(c)
        x, y, z = x - ex, y - ey, z - ez
        # the spindle leans by b about y: seen from it the tool is turned back
        x, z = math.cos(b) * x - math.sin(b) * z, math.sin(b) * x + math.cos(b) * z
        return (x + 1j * y) * np.exp(1j * phi), z

    def place(self, t, psi):
        if np.ndim(t):
            made = [self.solid(a, b) for a, b in zip(t, psi, strict=True)]
            return np.array([m[0] for m in made])
        return self.solid(t, psi)[0]

    def lowest(self, target, times):
        t, psi = (
            times.copy(),
            np.arcsin(np.clip((abs(target) - self.axes[0](times)) / self.R, -0.9, 0.9)),
        )
        for _ in range(12):
            miss = self.place(t, psi) - target
            h = 1e-7
            by_t = (self.place(t + h, psi) - self.place(t - h, psi)) / (2 * h)
            by_psi = (self.place(t, psi + h) - self.place(t, psi - h)) / (2 * h)
            det = by_t.real * by_psi.imag - by_t.imag * by_psi.real
            t = t - (miss.real * by_psi.imag - miss.imag * by_psi.real) / det
            psi = psi - (by_t.real * miss.imag - by_t.imag * miss.real) / det
        good = np.abs(self.place(t, psi) - target) < 1e-12
        return min(self.solid(a, b)[1] for a, b in zip(t[good], psi[good], strict=True))


@pytest.mark.parametrize("rake", [0.0, -20.0])
def test_terms_of_a_machine_are_cut_as_spindle_and_slide_move(rake, rng):
    """EXC, EYC, EZC, EBC and EYX, EZX at once, each with its own shape and sign."""
    from metrosep.machine import CallableTerm, ErrorSet, PolynomialTerm, presets
    from metrosep.process import cut_budget, machine_deviations

    shift = lambda c: (  # noqa: E731
        0.4e-6 * math.cos(c + 0.3) + 0.1e-6 * math.sin(2 * c),
        -0.3e-6 * math.sin(3 * c + 1.0),
        25e-9 * math.cos(2 * c) + 10e-9 * math.sin(c),
    )
    tilt = lambda c: 6e-6 * math.cos(c - 0.8)  # noqa: E731
    slide = lambda x: (1e-3 * (x - 1e-3) + 0.5e-6, 2e-5 * (x - 1e-3))  # noqa: E731
    each = lambda f: CallableTerm(np.vectorize(f))  # noqa: E731
    errors = {
        "EXC": each(lambda c: shift(c)[0]), "EYC": each(lambda c: shift(c)[1]),
        "EZC": each(lambda c: shift(c)[2]), "EBC": each(tilt),
        "EYX": each(lambda x: slide(x)[0]), "EZX": each(lambda x: slide(x)[1]),
    }  # fmt: skip
    nose = RoundNose(0.5e-3, math.radians(rake))
    form = Expression("9*x**2+14*y**2+3*x*y+6e-3*x")
    job = TurningJob(form, 1.2e-3, 8e-6, rpm=60, core=0.95e-3, nose=nose, sense="clockwise")
    made = job.program(job.path(step=2 * np.pi / 90))
    rho, theta = rng.uniform(1.0e-3, 1.12e-3, 6), rng.uniform(-3.0, 3.0, 6)
    x, y = rho * np.cos(theta), rho * np.sin(theta)
    deviations = machine_deviations(made, presets("sts_lathe", spindle_errors="fixed"), errors)
    found = cut_budget(made, nose, x, y, form=form, deviation=deviations)
    assert [c.name for c in found.budget.contributions] == ["program", *errors]
    assert min(np.ptp(c.map) for c in found.budget.contributions[1:]) > 1 * NM
    assert found.disagreement < 0.01 * np.abs(found.total).max()
    other = OnSpindle(
        made.t, made.X, made.azimuth, made.Z, 0.5e-3, math.radians(rake), -1.0,
        shift=shift, tilt=tilt, slide=slide,
    )  # fmt: skip
    for k in range(rho.size):
        first = -(theta[k] - made.azimuth[0]) / (2 * np.pi)
        turns = np.arange(math.ceil(-first), math.floor(made.turns - first)) + first
        times = made.t[0] + turns * made.duration / made.turns
        near = np.abs(other.axes[0](times) - rho[k] + 0.5e-3 * math.sin(found.full.psi[k])) < 60e-6
        z = other.lowest(rho[k] * np.exp(1j * theta[k]), times[near])
        # the edge turns with the tilt, by 0.1 mm times 6 urad
        assert found.full.z[k] == pytest.approx(z, abs=0.8 * NM)
    # an uncertainty of a term is a mode of its map: of a slide known to 0.2 um and 1 um per 10 mm
    known = ErrorSet(
        {"EYX": PolynomialTerm([0.5e-6], covariance=[[4e-14]]), "EXC": 0.1e-6}, u={"EXC": 0.3e-6}
    )
    moves = machine_deviations(made, presets("sts_lathe", spindle_errors="fixed"), known)
    slid = cut_budget(made, nose, x, y, form=form, deviation=moves).budget.contributions[1:]
    sY = (28 * y + 3 * x) * np.cos(theta) - (18 * x + 3 * y + 6e-3) * np.sin(theta)
    np.testing.assert_allclose(slid[0].modes[0], -sY * 0.2e-6, rtol=0, atol=0.1 * NM)
    assert slid[1].modes[0] == pytest.approx(3.0 * slid[1].map, abs=1e-15)
    assert slid[1].u > 0.3 * slid[1].pv
    wrong = {"C": made.azimuth, "X": made.X, "Z": made.Z}
    with pytest.raises(DataError, match="opposite ways: c_positive"):
        machine_deviations(made, presets("sts_lathe"), errors, positions=wrong)


def test_a_log_of_both_axes_is_made_up_for_in_both(rng):
    """The machine does its errors again: X and Z of the course are off by them, and cusps only are left."""
    nose = RoundNose(0.5e-3, math.radians(-20))
    bowl = Expression("9*x**2+14*y**2+3*x*y+6e-3*x")
    job = TurningJob(bowl, 1.2e-3, 8e-6, rpm=60, core=0.9e-3, nose=nose, sense="clockwise")
    path = job.path(step=2 * np.pi / 90)
    turned = np.arange(0.0, 2 * np.pi * 37.6, 0.02)
    rho, off = 1.2e-3 - 8e-6 * turned / (2 * np.pi), {}
    off["X"] = lambda a: 1.2e-6 * np.cos(a + 0.3) + 0.4e-6 * np.sin(2 * a)
    off["Z"] = lambda a: 30e-9 * np.sin(a - 0.5) + 8e-9
    x_log, z_log = (FollowUpMap(rho, -turned, off[a](turned)) for a in "XZ")
    rho, theta = rng.uniform(0.98e-3, 1.12e-3, 30), rng.uniform(-3.0, 3.0, 30)
    x, y = rho * np.cos(theta), rho * np.sin(theta)

    def left(program, ways=(1.0, 1.0)):
        a = 2 * np.pi * (1.2e-3 - job.program(path).X) / 8e-6  # of the moment, by the plain spiral
        X, Z = (getattr(program, n) + w * off[n](a) for n, w in zip("XZ", ways, strict=True))
        course = TurningProgram(X, program.azimuth, Z, program.t, "tip", program.interpolation)
        return virtual_cut(course, nose, x, y, form=bowl).error

    plain = job.program(path, servo="XZ")
    z_only, both = (
        job.compensated(path, follow_up=z_log, follow_up_x=o, servo="XZ") for o in (None, x_log)
    )
    clean = left(plain, (0.0, 0.0))
    np.testing.assert_allclose(left(both), clean, rtol=0, atol=0.02 * NM)  # lines between samples
    assert np.ptp(left(z_only) - clean) > 10 * NM
    assert np.ptp(left(both, (-1.0, 1.0)) - clean) > 1.8 * np.ptp(left(z_only) - clean)
    # what X does acts by the slope there
    made = job.predict(path, follow_up=z_log, follow_up_x=x_log, servo="XZ")
    found = made.maps["follow-up of X"]
    c, s = np.cos(made.azimuth), np.sin(made.azimuth)
    slope = c * (18 * made.x + 3 * made.y + 6e-3) + s * (28 * made.y + 3 * made.x)
    wanted = -slope * off["X"](2 * np.pi * (1.2e-3 - made.rho) / 8e-6)
    np.testing.assert_allclose(found, wanted, rtol=0, atol=0.01 * NM)
    with pytest.raises(DataError, match='with servo "Z" X follows nothing'):
        job.compensated(path, follow_up_x=x_log)
