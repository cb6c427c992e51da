"""The tip path against closed forms, foreign reference values, and an edge of many points."""

import math

import numpy as np
import pytest

from metrosep.core.errors import DataError, InvalidSamplesError, LimitError, UnitError
from metrosep.forms import Expression, SineGrid, Sphere, Toric
from metrosep.process import RoundNose, tip_path
from metrosep.process.tips import Edge, TipSurface, tips, tips_along

NM, UM, MM = 1e-9, 1e-6, 1e-3
R = 0.6e-3
BALL = Sphere(R=35e-3)
TORUS = Toric(Rb=110e-3, Rd=70e-3)
WAVES = Expression("3e-6*(sin(2*pi*x/7e-4)+cos(2*pi*y/7e-4))")
PLANE = Expression("0.06*x+0.03*y")
TROUGH = Expression("25e-3-sqrt((25e-3)**2-x**2)")
WAYS = {
    (0.0, None): 0, (-30.0, "counterclockwise"): 1, (-30.0, "clockwise"): 2,
    (5.0, "counterclockwise"): 3, (5.0, "clockwise"): 4,
}  # fmt: skip


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize(
    ("form", "X", "phi", "expected"),
    [
        (BALL, 8e-3, 0.7, (943.162133878, 945.698499875, 945.698499875, 943.224996994, 943.224996994)),
        (TORUS, 9e-3, 0.5, (419.979272588, 420.417526205, 420.348277457, 419.984680495, 419.993795350)),
        (WAVES, 2.03e-3, 1.1, (0.180120528, 0.183207926, 0.182788652, 0.180163989, 0.180217548)),
        (PLANE, 4e-3, 1.1, (216.680562914, 216.792691271, 216.838996337, 216.686952468, 216.680851317)),
        (TROUGH, 6e-3, 0.8, (356.190593864, 356.521808878, 357.224142589, 356.253246260, 356.161385963)),
    ],
)  # fmt: skip
def test_tips_are_those_of_the_table(form, X, phi, expected, way):
    """specs/cutting-path.md, 5.1: made by foreign code with a bracket and a fixed point."""
    rake, sense = way
    found = tip_path(form, X, phi, nose=RoundNose(R, math.radians(rake)), sense=sense)
    assert found.z.item() / UM == pytest.approx(expected[WAYS[way]], abs=1e-6)


def test_contacts_are_those_of_the_table():
    found = tip_path(
        TORUS, 9e-3, 0.5, nose=RoundNose(R, math.radians(-30)), sense="counterclockwise"
    )
    assert found.psi.item() == pytest.approx(0.1089305174, abs=1e-10)
    assert found.rho.item() / MM == pytest.approx(9.065229306, abs=1e-9)
    assert found.theta.item() == pytest.approx(0.5001961472, abs=1e-10)


def test_closed_forms_of_plane_sphere_and_circular_sections():
    x = np.linspace(0.5e-3, 9e-3, 7)
    g, sign = math.radians(-30), -1.0
    raked, way = RoundNose(R, g), "clockwise"

    # a plane, with its slopes along machine x and y
    phi = np.linspace(0.0, 6.0, 7)
    sx, sy = 0.06 * np.cos(phi) + 0.03 * np.sin(phi), 0.03 * np.cos(phi) - 0.06 * np.sin(phi)
    c = math.cos(g) + sign * sy * math.sin(g)
    plane = sx * x + R * (np.hypot(sx, c) - c)
    np.testing.assert_allclose(
        tip_path(PLANE, x, phi, nose=raked, sense=way).z, plane, rtol=0, atol=1e-15
    )

    # a hollow sphere: X^2 + h^2 - 2 R h cos g = Rs^2 - 2 R sqrt(Rs^2 - h^2 sin^2 g), Z = Rs - h
    h = 35e-3 - tip_path(BALL, x, phi, nose=raked, sense=way).z
    left = x**2 + h**2 - 2 * R * h * math.cos(g)
    right = 35e-3**2 - 2 * R * np.sqrt(35e-3**2 - h**2 * math.sin(g) ** 2)
    np.testing.assert_allclose(left, right, rtol=1e-14, atol=0)

    # circular sections, no rake: a circle within a circle
    for form, at, r in ((TROUGH, 0.0, 25e-3), (TORUS, 0.0, 110e-3), (TORUS, math.pi / 2, 70e-3)):
        circle = r - R - np.sqrt((r - R) ** 2 - x**2)
        found = tip_path(form, x, at, nose=RoundNose(R)).z
        np.testing.assert_allclose(found, circle, rtol=0, atol=1e-15)


HALF_STEP = 2e-13
"""m: (1/R + 5000 /m of the crests) (6 nm)^2 / 2, half a step of the edge below."""
CREST = Expression("2e-6*exp(-(x-3e-3)**2/(2*(2e-5)**2)) + 1e-2*x - 3e-7*cos(2*pi*y/3e-4)")


@pytest.mark.parametrize("way", list(WAYS)[:3])
@pytest.mark.parametrize("form", [WAVES, CREST, SineGrid(amplitude=0.4e-6, wavelength=60e-6)])
def test_the_edge_of_many_points_touches_everywhere_and_cuts_nowhere(form, way, rng):
    """Crest of 20 um beside a nose of 600 um: the contact jumps to it from far away."""
    rake, sense = math.radians(way[0]), way[1]
    sign = -1.0 if sense == "clockwise" else 1.0
    x, phi = rng.uniform(2e-3, 4e-3, 40), rng.uniform(-0.3, 0.3, 40)
    found = tip_path(form, x, phi, nose=RoundNose(R, rake), sense=sense)
    psi = np.linspace(-0.6, 0.6, 60001)  # 12 nm apart
    up = R * (1 - np.cos(psi))
    for k in range(x.size):
        along, across = x[k] + R * np.sin(psi), -sign * up * math.sin(rake)
        c, s = math.cos(phi[k]), math.sin(phi[k])
        air = (
            found.z[k] + up * math.cos(rake) - form(along * c - across * s, along * s + across * c)
        )
        assert abs(air.min()) < HALF_STEP
    if form is CREST:
        assert np.abs(found.rho - x).max() > 20e-6  # elsewhere R times the slope, 6 um


def test_the_gradient_of_the_tips_is_that_of_their_heights():
    for rake, sense in WAYS:
        tips = TipSurface(TORUS, Edge.of(RoundNose(R, math.radians(rake)), sense))
        x, y, h = np.array([3e-3, -2e-3]), np.array([1e-3, 4e-3]), 1e-6
        along_x, along_y = tips.gradient(x, y)
        assert along_x == pytest.approx((tips(x + h, y) - tips(x - h, y)) / (2 * h), abs=1e-8)
        assert along_y == pytest.approx((tips(x, y + h) - tips(x, y - h)) / (2 * h), abs=1e-8)


@pytest.mark.parametrize("form", [WAVES, CREST, TORUS])
def test_contacts_along_a_course_are_those_of_every_place_alone(form):
    """Also where the contact jumps to a crest, and beyond the window of the nose: the edge is searched there."""
    phi = np.linspace(-0.3, 0.3, 700)
    x = 2.9e-3 - 1e-4 * (phi + 0.3)
    nose = RoundNose(R, math.radians(-30), window=math.radians(20))
    edge = Edge.of(nose, "clockwise")
    alone, along = (f(form, x, phi, edge, strict=False) for f in (tips, tips_along))
    assert (along.contacts == alone.contacts).all()
    for name, close in (("z", 1e-16), ("rho", 1e-11), ("theta", 1e-8), ("along_x", 1e-8)):
        wanted = getattr(alone, name)
        np.testing.assert_allclose(getattr(along, name), wanted, rtol=0, atol=close)
    assert along.messages == alone.messages


def test_what_the_path_cannot_do_is_said_or_refused():
    nose = RoundNose(R)
    before, beyond = (tip_path(PLANE, 10e-6, phi, nose=nose) for phi in (0.0, np.pi))
    shift = R * 0.06 / math.hypot(1, 0.06)
    assert before.rho.item() == pytest.approx(10e-6 + shift, abs=1e-12)
    assert beyond.rho.item() == pytest.approx(10e-6 - shift, abs=1e-12)
    assert not before.messages
    assert "runs backwards" in beyond.messages[0]
    rim = Sphere(R=5e-3)
    # the ball within the bowl touches at 5 / 4.5 of its own radius, the bowl ends at 5 mm
    on, off = (tip_path(rim, x, 0.0, nose=RoundNose(0.5e-3)) for x in (4.4e-3, 4.6e-3))
    assert on.rho.item() == pytest.approx(4.4e-3 / 0.9, abs=1e-12)
    assert not on.messages
    assert "touches the border of the sphere: air was assumed" in off.messages[0]
    with pytest.raises(InvalidSamplesError, match="no height below the tip at X = 6 mm"):
        tip_path(rim, 6e-3, 0.0, nose=RoundNose(0.5e-3))
    with pytest.raises(LimitError, match="sharp window from -5 to 5 degrees at 1 tips"):
        tip_path(BALL, 8e-3, 0.0, nose=RoundNose(R, window=math.radians(10)))
    loose = tip_path(
        BALL, [1e-3, 8e-3], 0.0, nose=RoundNose(R, window=math.radians(10)), strict=False
    )
    assert np.isnan(loose.z).tolist() == [False, True]
    with pytest.raises(DataError, match='sense="counterclockwise" or sense="clockwise"'):
        tip_path(BALL, 8e-3, 0.0, nose=RoundNose(R, -0.5))
    with pytest.raises(DataError, match="sense is one of counterclockwise"):
        tip_path(BALL, 8e-3, 0.0, nose=nose, sense="left")
    with pytest.raises(DataError, match="must be a RoundNose"):
        tip_path(BALL, 8e-3, 0.0, nose=R)
    with pytest.raises(InvalidSamplesError, match="X is nan"):
        tip_path(BALL, [np.nan], 0.0, nose=nose)
    with pytest.raises(InvalidSamplesError, match="do not broadcast"):
        tip_path(BALL, [1e-3, 2e-3], [0.0, 1.0, 2.0], nose=nose)
    with pytest.raises(UnitError):
        tip_path(BALL, 8.0, 0.0, nose=nose)
