"""The nose: contact and rake error against a drawn ellipse, gouge and clearance against geometry."""

import math

import numpy as np
import pytest

from metrosep.core.errors import DataError, InvalidSamplesError, LimitError, UnitError
from metrosep.forms import SineGrid, Sphere
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
    assert np.abs(e - same).max() < 1e-4 * NM
    assert np.abs(rake_error(GRID, line, nose=RoundNose(1e-3))).max() == 0.0


def test_rake_error_of_a_steep_sphere_follows_its_curvature():
    """Brute force: circle path by the lowest centre, then the envelope of the ellipse."""
    R, nose = -5e-3, RoundNose(0.5e-3, rake=math.radians(40))
    form = Sphere(R=R)
    at = np.array([0.3e-3, 1.1e-3, 2.4e-3])
    s = np.linspace(-1e-3, 3.9e-3, 60001)
    z = form(s)
    path = np.linspace(-0.5e-3, 3.5e-3, 1601)
    tip = np.array(
        [(z[n] + np.sqrt(nose.radius**2 - (s[n] - p) ** 2)).max() - nose.radius
         for p in path for n in [np.abs(s - p) < nose.radius]]
    )  # fmt: skip
    b = nose.radius * math.cos(nose.rake)
    cut = []
    for x in at:
        n = np.abs(path - x) < nose.radius
        cut.append((tip[n] + b - b * np.sqrt(1 - ((path[n] - x) / nose.radius) ** 2)).min())
    brute = np.array(cut) - form(at)
    found = rake_error(form, at, nose=nose)
    assert np.abs(brute).max() > 10 * UM
    assert np.abs(found - brute).max() < 5 * NM
    # the vertex is one plane; there the second-order radius is exact too
    assert abs(rake_error(form, 0.0, nose=nose).item()) < 1e-12


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
        ({"radius": 0.0}, DataError, "must be > 0, got 0.0 m"),
        ({"radius": -1e-3}, DataError, "must be > 0"),
        ({"radius": 1.0}, UnitError, "1 mm is 0.001"),
        ({"radius": np.nan}, InvalidSamplesError, "radius must be finite"),
        ({"radius": "1 mm"}, DataError, "radius must be a number"),
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
    with pytest.raises(DataError, match="travel must be"):
        clearance_check(GRID, RoundNose(1e-3, clearance=0.1), travel="up")
    with pytest.raises(InvalidSamplesError, match="slope is nan"):
        RAKED.error([0.1, np.nan])
