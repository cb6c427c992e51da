"""The nose: contact and rake error against a drawn ellipse, gouge and clearance against geometry."""

import math

import numpy as np
import pytest

from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    LimitError,
    NotConvergedError,
    UnitError,
)
from metrosep.forms import Expression, SineGrid, Sphere, Toric
from metrosep.forms.stl import from_triangles
from metrosep.process.nose import RoundNose, rake_error
from metrosep.process.nose_checks import clearance_check, gouge_check, window_check
from metrosep.process.tool_settings import ToolSetting

NM, UM = 1e-9, 1e-6
A, WAVE = 50e-9, 100e-6
K = 2 * np.pi / WAVE
GRID = SineGrid(amplitude=A, wavelength=WAVE)
RAKED = RoundNose(1e-3, rake=math.radians(-30))


def drawn_edge(R, rake, n=2_000_001):
    """The round edge in its own plane, tilted about the tip, seen along the cut."""
    angle = np.linspace(-1.4, 1.4, n)
    x, up = R * np.sin(angle), R * (1 - np.cos(angle))
    return x, up * math.cos(rake)


def test_the_tip_radius_of_a_raked_nose():
    assert RAKED.tip_radius * 1e3 == pytest.approx(1.1547, abs=5e-5)
    assert RAKED.dR / UM == pytest.approx(155, abs=0.5)
    x, z = drawn_edge(1e-3, math.radians(-30))
    near = np.abs(x) < 20e-6
    curvature = 2 * np.polynomial.polynomial.polyfit(x[near] * 1e3, z[near] * 1e3, 4)[2]
    assert 1 / curvature == pytest.approx(RAKED.tip_radius * 1e3, rel=1e-3, abs=0)


@pytest.mark.parametrize("slope", [-0.9, -0.02, 0.3, 1.5])
@pytest.mark.parametrize("degrees", [-30.0, 0.0, 25.0])
def test_contact_and_error_are_those_of_the_drawn_edge(slope, degrees):
    """Lower the edge onto a plane; the error is how much lower it rests than the circle does."""
    rake = math.radians(degrees)
    nose = RoundNose(1e-3, rake=rake)
    x, z = drawn_edge(1e-3, rake)
    lowest = np.argmin(z - slope * x)
    found_x, found_z = nose.contact(slope)
    # the drawn points are 1.4 nm apart
    assert found_x == pytest.approx(x[lowest], abs=2 * NM)
    assert found_z == pytest.approx(z[lowest], abs=4 * NM)

    circle = drawn_edge(1e-3, 0.0)
    rest = (z - slope * x).min() - (circle[1] - slope * circle[0]).min()
    assert nose.error(slope) == pytest.approx(rest, abs=0.01 * NM)


def test_rake_error_of_the_paper_and_as_a_radius_error():
    line = np.linspace(0, 500e-6, 5001)
    e = rake_error(GRID, line, nose=RAKED)
    assert np.ptp(e) / NM == pytest.approx(0.76, abs=0.005)
    same = ToolSetting(dR=RAKED.dR).error(GRID, line)
    # nearer to the axis the tilted edge, 2.5 nm out of its plane, reaches over it
    assert np.abs(e - same)[line > 1 * UM].max() < 1e-4 * NM
    assert np.abs(e - same).max() < 0.01 * NM
    assert np.abs(rake_error(GRID, line, nose=RoundNose(1e-3))).max() == 0.0


def cut_with_rake(tip, rho, theta, R, rake, sign):
    """Brute force: lower the tilted edge of 401 points onto a point, over the path of a circle.

    The edge passes over the point at each of its own points: there X and azimuth of the tip follow
    from the position of the point of the edge, which leaves the plane of the axis by w sin(rake).
    """
    low, high = -1.0, 1.0
    for _ in range(3):  # all of it, then twice about the lowest
        psi = np.linspace(low, high, 401)
        up = R * (1 - np.cos(psi))
        across = -sign * up * math.sin(rake)
        along = np.sqrt(rho**2 - across**2)
        heights = tip(along - R * np.sin(psi), theta - np.arctan2(across, along))
        heights = heights + up * math.cos(rake)
        k = int(heights.argmin())
        low, high = psi[max(k - 3, 0)], psi[min(k + 3, 400)]
    return heights.min()


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_rake_error_of_a_steep_dome_follows_its_curvature(sign):
    """The path of a circle on a convex sphere is a circle in closed form."""
    Rs, nose = 5e-3, RoundNose(0.5e-3, rake=math.radians(40))
    form = Sphere(R=-Rs)
    at = np.array([0.3e-3, 1.1e-3, 2.4e-3])

    def tip(x, _):
        return np.sqrt((Rs + nose.radius) ** 2 - x**2) - Rs - nose.radius

    brute = np.array([cut_with_rake(tip, x, 0.0, nose.radius, nose.rake, sign) for x in at])
    brute -= form(at)
    found = rake_error(form, at, nose=nose)  # both ways cut the same: no sense is asked for
    assert np.abs(brute).max() > 10 * UM
    assert np.abs(found - brute).max() < 0.001 * NM
    # the vertex is one plane; there the second-order radius is exact too
    assert abs(rake_error(form, 0.0, nose=nose).item()) < 1e-12


TORIC = Toric(Rb=265e-3, Rd=132.5e-3)
"""The part of the paper on optical performance."""


@pytest.mark.parametrize("sense", ["counterclockwise", "clockwise"])
@pytest.mark.parametrize("degrees", [-30.0, 5.0])
@pytest.mark.parametrize("place", [(17e-3, 0.6), (11e-3, 2.5)])
def test_rake_error_of_the_toric_is_that_of_the_drawn_edge(place, degrees, sense):
    """Both the path of the circle and the cut by brute force; in-plane ellipses miss 160 nm."""
    R, rake = 1e-3, math.radians(degrees)
    rho, theta = place

    def tip(x, phi):
        """The highest circle of 801 points above the surface, then again about the highest."""
        low, high = np.full(x.shape, -0.3), np.full(x.shape, 0.3)
        for _ in range(2):
            psi = np.linspace(low, high, 401)
            along = x + R * np.sin(psi)
            heights = TORIC(along * np.cos(phi), along * np.sin(phi)) - R * (1 - np.cos(psi))
            k = np.clip(heights.argmax(axis=0), 2, 398)
            low, high = (psi[k + j, np.arange(x.size)] for j in (-2, 2))
        return heights.max(axis=0)

    sign = 1.0 if sense == "counterclockwise" else -1.0
    x, y = rho * math.cos(theta), rho * math.sin(theta)
    brute = cut_with_rake(tip, rho, theta, R, rake, sign) - TORIC(x, y)
    found = rake_error(TORIC, x, y, nose=RoundNose(R, rake), sense=sense)
    # points of the circle: R (0.0015 / 200 rad)^2 / 2
    assert abs(found.item() - brute.item()) < 0.001 * NM


@pytest.mark.parametrize(
    ("form", "rho", "theta", "R", "expected"),
    [
        (Sphere(R=35e-3), 8e-3, 0.7, 0.6e-3, (-2437.12876, -2437.12876, -60.68879, -60.68879)),
        (Toric(Rb=110e-3, Rd=70e-3), 9e-3, 0.5, 0.6e-3, (-431.63602, -364.11742, -5.36916, -14.31407)),
        (Expression("3e-6*(sin(2*pi*x/7e-4)+cos(2*pi*y/7e-4))"), 2.03e-3, 1.1, 0.6e-3,
         (-2.58906, -2.26536, -0.03863, -0.08253)),
        (Expression("25e-3-sqrt((25e-3)**2-x**2)"), 6e-3, 0.8, 0.6e-3,
         (-327.13563, -995.27206, -60.56598, 27.99925)),
        (Expression("0.06*x+0.03*y"), 4e-3, 1.1, 0.6e-3, (-112.15544, -158.40292, -6.38945, -0.28849)),
        (TORIC, 17e-3, 0.6, 1e-3, (-626.18611, -483.22477, -4.25457, -23.17136)),
    ],
)  # fmt: skip
def test_rake_errors_are_those_of_the_table(form, rho, theta, R, expected):
    """specs/cutting-path.md, 5.3, foreign code; rake -30 and +5 degrees, both senses."""
    x, y = rho * math.cos(theta), rho * math.sin(theta)
    found = [
        rake_error(form, x, y, nose=RoundNose(R, math.radians(g)), sense=s).item() / NM
        for g in (-30.0, 5.0) for s in ("counterclockwise", "clockwise")
    ]  # fmt: skip
    assert found == pytest.approx(expected, abs=1e-4)


def test_a_rake_that_cuts_differently_both_ways_asks_for_the_way():
    with pytest.raises(DataError, match=r'up to 143 nm here: give sense="counterclockwise" or'):
        rake_error(TORIC, 17e-3 * math.cos(0.6), 17e-3 * math.sin(0.6), nose=RAKED)
    with pytest.raises(DataError, match="sense is one of counterclockwise"):
        rake_error(TORIC, 1e-3, nose=RAKED, sense="up")
    with pytest.raises(NotConvergedError, match="does not fit the curvature"):
        rake_error(Sphere(R=0.9e-3), 0.2e-3, nose=RAKED)


def touches(form, R, at, reach):
    """How far a circle that touches at a point reaches into the rest of the section."""
    (slope,) = np.atleast_1d(form.gradient(at)[0])
    norm = math.hypot(1, slope)
    cx, cz = at - R * slope / norm, float(form(at)) + R / norm
    x = np.linspace(cx - reach, cx + reach, 40001)
    arc = cz - np.sqrt(R**2 - (x - cx) ** 2)
    return float((form(x) - arc).max())


def test_gouge_is_found_where_a_drawn_nose_really_gouges():
    form = SineGrid(amplitude=0.2e-6, wavelength=100e-6, amplitude_y=0.0)
    smallest = 1 / (0.2e-6 * K**2)
    for factor, fits in ((0.98, True), (1.02, False)):
        nose = RoundNose(smallest * factor)
        found = gouge_check(form, nose, radius=200e-6, n_rho=801, n_theta=8)
        assert found.ok is fits
        assert found.worst == pytest.approx(smallest, rel=1e-4, abs=0)
        deepest = max(touches(form, nose.radius, x, 60e-6) for x in (73e-6, 75e-6, 80e-6))
        assert (deepest > 1e-13) is not fits
    # the hollow of the sine is at 75 um (mod 100), on the x axis
    assert math.remainder(found.rho * math.cos(found.theta) - 75e-6, WAVE) == pytest.approx(
        0, abs=0.5 * UM
    )
    assert "gouges" in found.messages[0]
    assert found.n_bad > 0
    with pytest.raises(LimitError, match=r"concave radius .* at rho"):
        found.require()


def test_gouge_of_the_paper_grid_and_of_rake_and_of_a_dome():
    found = gouge_check(GRID, RoundNose(1e-3), radius=500e-6)
    assert found.ok
    assert found.worst * 1e3 == pytest.approx(1e3 / (A * K**2), rel=1e-3, abs=0)
    found.require()
    almost = RoundNose(4.8e-3)
    assert gouge_check(GRID, almost, radius=500e-6).ok
    assert not gouge_check(GRID, RoundNose(4.8e-3, rake=0.5), radius=500e-6).ok
    dome = gouge_check(Sphere(R=-1e-3), RoundNose(5e-3), radius=0.5e-3)
    assert dome.ok
    assert dome.worst == math.inf


def test_gouge_of_a_hollow_sphere_is_its_radius():
    for R, fits in ((0.9e-3, False), (1.1e-3, True)):
        found = gouge_check(Sphere(R=R), RoundNose(1e-3), radius=0.4e-3, n_rho=50, n_theta=4)
        assert found.ok is fits
        assert found.worst == pytest.approx(R, rel=1e-6, abs=0)


def closed_by_a_circle(form, R, rho, reach, n=4001):
    """How high a circle that cuts nothing of a section stays above a point of it: brute force."""
    centre = rho + np.linspace(-0.9 * R, 0.9 * R, n)
    lowest = []
    for x in centre:
        u = np.linspace(-0.95 * R, 0.95 * R, n)
        lowest.append((form(x + u) - R + np.sqrt(R**2 - u**2)).max())
    return (np.array(lowest) + R - np.sqrt(R**2 - (rho - centre) ** 2)).min() - form(rho)


@pytest.mark.parametrize(
    ("R", "sigma", "where"),
    [
        (0.1e-3, 6e-6, 7e-3),
        (0.2e-3, 10.6e-6, 3.32171e-3),
        (0.5e-3, 25e-6, 5.00719e-3),
        (1e-3, 50e-6, 7e-3),
    ],
)
def test_a_narrow_groove_does_not_slip_through_the_mesh(R, sigma, where):
    """A ring of sigma down to R / 20 on a part of 8 mm; its bottom has a radius of 0.45 R."""
    bottom = 0.45 * R
    form = Expression(f"-{sigma**2 / bottom}*exp(-(r-{where})**2/(2*{sigma}**2))")
    found = gouge_check(form, RoundNose(R), radius=8e-3)
    assert not found.ok
    assert found.worst == pytest.approx(bottom, rel=1e-4, abs=0.0)
    assert found.rho == pytest.approx(where, abs=1e-8)
    assert found.left == pytest.approx(
        closed_by_a_circle(form, R, where, sigma), rel=5e-3, abs=0.0
    )
    assert gouge_check(form, RoundNose(0.98 * bottom), radius=8e-3).ok
    if (R, sigma) == (0.1e-3, 6e-6):
        same = Expression("-8e-7*exp(-(r-7e-3)**2/(2*(6e-6)**2))")  # specs/cutting-path.md, 7
        assert gouge_check(same, RoundNose(R), radius=8e-3).left / NM == pytest.approx(
            152.1244, rel=5e-3, abs=0.0
        )


@pytest.mark.parametrize("radius", [0.5e-3, 5e-3, 50e-3])
def test_the_size_of_the_part_does_not_decide_whether_a_nose_fits(radius):
    """Sine of 25 um: radius of 79 um in its hollows, whatever lies around them."""
    form = SineGrid(amplitude=0.2e-6, wavelength=25e-6, amplitude_y=0.0)
    bottom = 1 / (0.2e-6 * (2 * np.pi / 25e-6) ** 2)
    region = (radius - 0.2e-3, radius)
    assert not gouge_check(form, RoundNose(0.2e-3), region=region).ok
    assert not gouge_check(form, RoundNose(1.01 * bottom), region=region).ok
    assert gouge_check(form, RoundNose(0.99 * bottom), region=region).ok


def test_a_kink_is_a_hollow_of_no_radius():
    """Two planes that meet at 20 mrad: a circle stays R (1/cos 10 mrad - 1) above the line."""
    form = Expression("1e-2*abs(r-4.00012e-3)")
    found = gouge_check(form, RoundNose(1e-3), radius=8e-3)
    assert not found.ok
    assert "concave radius 0 (a kink)" in found.messages[0]
    assert found.left == pytest.approx(1e-3 * (math.hypot(1, 1e-2) - 1), rel=1e-3, abs=0.0)
    roof = Expression("-1e-2*abs(r-4e-3)")  # a ridge, and a pit on the axis
    assert gouge_check(roof, RoundNose(1e-3), region=(1e-3, 8e-3)).ok
    assert gouge_check(roof, RoundNose(1e-3), radius=8e-3).rho == pytest.approx(0.0, abs=1e-9)


def test_a_mesh_coarser_than_the_form_passes_nothing():
    form = SineGrid(amplitude=0.01e-6, wavelength=25e-6)
    coarse = gouge_check(form, RoundNose(0.2e-3), radius=5e-3, n_rho=101)
    assert not coarse.ok
    assert "not judged: the radial step of the mesh, 50 um" in coarse.messages[0]
    fine = gouge_check(form, RoundNose(0.2e-3), radius=5e-3)
    assert fine.ok
    assert fine.step <= 25e-6 / 8
    blind = gouge_check(Expression("1e-9*x"), RoundNose(0.2e-3), radius=5e-3)
    assert any("narrower than 2.5 um along rho" in m for m in blind.messages)


def test_the_window_counts_on_the_nose_not_on_the_slope():
    """A rake of -30 degrees lets a slope of 13.2 degrees touch at 15.2: asin(8/35) on a sphere."""
    bowl, raked = Sphere(R=35e-3), math.radians(-30)
    slope = math.asin(8 / 35)
    found = window_check(bowl, RoundNose(0.6e-3, raked, window=math.radians(28)), radius=8e-3)
    assert not found.ok
    assert found.worst == pytest.approx(math.atan(math.tan(slope) / math.cos(raked)), abs=1e-9)
    assert window_check(bowl, RoundNose(0.6e-3, window=math.radians(28)), radius=8e-3).ok


def test_clearance_names_value_and_place_and_depends_on_the_direction():
    """A ramp: it falls only on the half where the tool goes down."""
    form = SineGrid(amplitude=1e-3, wavelength=100e-3, amplitude_y=0.0)
    nose = RoundNose(1e-3, clearance=math.radians(3.0))
    found = clearance_check(form, nose, radius=1e-3, travel="both")
    steepest = math.atan(1e-3 * 2 * np.pi / 100e-3)
    assert found.worst == pytest.approx(steepest, rel=1e-3, abs=0)
    assert not found.ok
    with pytest.raises(LimitError, match=r"flank rubs .* 3\.59\d degrees at rho = .*3 degrees"):
        found.require()

    # z grows with x: with growing azimuth the tool goes down where y > 0
    down = clearance_check(form, nose, radius=1e-3, travel="growing")
    assert math.sin(down.theta) > 0.9
    up = clearance_check(form, nose, radius=1e-3, travel="falling")
    assert math.sin(up.theta) < -0.9
    assert clearance_check(form, RoundNose(1e-3, clearance=0.07), radius=1e-3).ok


def test_clearance_does_not_see_radial_slopes_and_the_window_does():
    bowl = Sphere(R=5e-3)
    nose = RoundNose(0.2e-3, clearance=1e-6, window=math.radians(60))
    assert clearance_check(bowl, nose, radius=3e-3).ok
    found = window_check(bowl, nose, radius=3e-3)
    assert not found.ok
    assert found.worst == pytest.approx(math.asin(0.6), abs=1e-9)
    assert found.rho == pytest.approx(3e-3, abs=1e-12)
    assert window_check(bowl, nose, radius=2.4e-3).ok


def test_points_off_the_surface_are_said():
    found = gouge_check(Sphere(R=5e-3), RoundNose(1e-3), radius=6e-3)
    assert any("not judged" in m for m in found.messages)
    with pytest.raises(DataError, match="anywhere"):
        gouge_check(Sphere(R=5e-3), RoundNose(1e-3), region=(6e-3, 7e-3))
    with pytest.raises(DataError, match="not defined at rho = 6 mm"):
        rake_error(Sphere(R=5e-3), 6e-3, nose=RAKED)


@pytest.mark.parametrize(
    ("arguments", "error", "match"),
    [
        ({"radius": 0.0}, DataError, "positive and finite, got 0.0 m"),
        ({"radius": -1e-3}, DataError, "must be positive"),
        ({"radius": 1.0}, UnitError, "1 mm is 0.001"),
        ({"radius": np.nan}, InvalidSamplesError, "radius must be positive and finite"),
        ({"radius": "1"}, UnitError, "radius '1' has no unit"),
        ({"radius": 1e-3, "rake": -30.0}, UnitError, "30 degrees is -0.5236"),
        ({"radius": 1e-3, "rake": 1.55}, DataError, "rake must lie within"),
        ({"radius": 1e-3, "clearance": 10.0}, UnitError, "radians"),
        ({"radius": 1e-3, "clearance": 0.0}, DataError, "clearance must lie within 0"),
        ({"radius": 1e-3, "window": -1.0}, DataError, "window must lie within 0"),
    ],
)
def test_bad_noses_are_refused(arguments, error, match):
    with pytest.raises(error, match=match):
        RoundNose(**arguments)


def test_missing_angles_and_wrong_directions_are_refused():
    with pytest.raises(DataError, match="no clearance angle"):
        clearance_check(GRID, RoundNose(1e-3))
    with pytest.raises(DataError, match="no window"):
        window_check(GRID, RoundNose(1e-3))
    with pytest.raises(DataError, match="travel is one of"):
        clearance_check(GRID, RoundNose(1e-3, clearance=0.1), travel="up")
    with pytest.raises(InvalidSamplesError, match="slope is nan"):
        RAKED.error([0.1, np.nan])


@pytest.mark.parametrize("radius", [50e-6, 120e-6])
def test_no_nose_gouges_a_convex_mesh(radius):
    """A dome of triangles from a drawing: each edge bends away from the tool."""
    x = np.linspace(-2e-3, 2e-3, 41)
    X, Y = np.meshgrid(x, x)
    P = np.stack([X, Y, -(X**2 + Y**2) / 0.1], axis=-1)
    a, b, c, d = P[:-1, :-1], P[:-1, 1:], P[1:, :-1], P[1:, 1:]
    triangles = [np.stack(t, axis=2).reshape(-1, 3, 3) for t in ((a, b, d), (a, d, c))]
    dome = from_triangles(np.concatenate(triangles))
    assert gouge_check(dome, RoundNose(radius), radius=1.25e-3).ok
