"""An edge that is not the programmed one: foreign reference values, and crests drawn point by point."""

import math

import numpy as np
import pytest

from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    LimitError,
    TooFewSamplesError,
    UnitError,
)
from metrosep.forms import Expression, Sphere, Toric
from metrosep.process import (
    EdgeProfile,
    RoundNose,
    ToolSetting,
    cusp_heights,
    edge_error,
    rake_error,
    tip_path,
)

NM, UM = 1e-9, 1e-6
R = 0.6e-3
TORUS = Toric(Rb=110e-3, Rd=70e-3)
AT = 9e-3 * math.cos(0.5), 9e-3 * math.sin(0.5)
WAYS = [(0.0, "counterclockwise"), (-30.0, "counterclockwise"), (-30.0, "clockwise")]
ANGLES = np.radians(np.linspace(-60.0, 60.0, 961))


def nose(degrees, **options):
    return RoundNose(R, math.radians(degrees), **options)


def waves(angle, size=40 * NM, period=15.0, phase=0.5):
    return size * np.cos(2 * np.pi * angle / math.radians(period) + phase)


@pytest.mark.parametrize(
    ("setting", "expected"),
    [
        ({"dR": 5e-6}, (-21.54589, -25.14480, -24.58414)),
        ({"dx": 1e-6}, (-92.93227, -92.92842, -92.93595)),
        ({"dy": 1e-6}, (-19.78703, -19.80512, -19.76974)),
        ({"dx": 1e-6, "dy": -2e-6, "dR": 5e-6}, (-74.93466, -78.49314, -78.01135)),
    ],
)
def test_a_tool_that_is_not_set_as_programmed(setting, expected):
    """specs/cutting-path.md, table 5.4, foreign code."""
    found = [
        edge_error(TORUS, *AT, nose=nose(g), setting=ToolSetting(**setting), sense=s).item() / NM
        for g, s in WAYS
    ]
    assert found == pytest.approx(expected, abs=1e-4)


def test_waviness_yaw_and_a_wrong_rake():
    """specs/cutting-path.md, table 5.4."""
    wavy = EdgeProfile(ANGLES, waves(ANGLES))
    found = [edge_error(TORUS, *AT, nose=nose(g, edge=wavy), sense=s).item() / NM for g, s in WAYS]
    assert found == pytest.approx(
        (36.59152, 34.40742, 35.03328), abs=1e-3
    )  # the table of the wave
    turned = [
        edge_error(TORUS, *AT, nose=nose(g), actual=nose(g, yaw=math.radians(0.5)), sense=s).item()
        for g, s in WAYS
    ]
    assert np.array(turned) / NM == pytest.approx((-9.39811, -9.54380, -12.07145), abs=1e-4)
    raked = [
        edge_error(TORUS, *AT, nose=nose(-30), actual=nose(-29.8), sense=s).item() / NM
        for _, s in WAYS[1:]
    ]
    assert raked == pytest.approx((6.29424, 5.61722), abs=1e-4)


def test_the_radius_of_a_certificate_is_that_of_the_view_along_the_cut():
    """specs/cutting-path.md, section 2: 408 nm between the two readings of one certificate."""
    plane = Expression("0.06*x+0.03*y")
    view = nose(-30, radius_in="projection")
    found = [
        tip_path(form, X, phi, nose=view, sense=s).z.item() / UM
        for form, X, phi in ((TORUS, 9e-3, 0.5), (plane, 4e-3, 1.1))
        for s in ("counterclockwise", "clockwise")
    ]
    assert found == pytest.approx(
        (420.009598588, 419.949669301, 216.660958476, 216.701088977), abs=1e-6
    )
    assert view.tip_radius == R
    assert nose(-30).tip_radius == pytest.approx(R / math.cos(math.radians(30)), abs=1e-15)


@pytest.mark.parametrize("period", [15.0, 4.0, 1.0])
def test_the_crests_of_a_wavy_edge_cut(period):
    """A wave of 1 degree is hollow between its crests, tighter than the surface: only they cut."""
    wavy = EdgeProfile(ANGLES, waves(ANGLES, 30 * NM, period, 0.3))
    bowl = Sphere(R=-7e-3)
    at = np.array([1.3e-3, 2.2e-3])
    found = edge_error(bowl, at, nose=nose(0, edge=wavy))
    psi = np.linspace(-0.7, 0.7, 2_000_001)
    radius = R + wavy.at(psi)
    for rho, e in zip(at, found, strict=True):
        X = rho - radius * np.sin(psi)
        # the path of the plain circle on a dome is a circle
        tip = np.sqrt((7e-3 + R) ** 2 - X**2) - 7e-3 - R
        assert e == pytest.approx(
            (tip + R - radius * np.cos(psi)).min() - bowl(rho).item(), abs=1e-13
        )


def test_swivel_moves_the_waviness_along_the_edge():
    beta = math.radians(7.0)
    wavy = EdgeProfile(ANGLES, waves(ANGLES))
    moved = EdgeProfile(ANGLES, waves(ANGLES + beta))
    swung, same = (
        edge_error(TORUS, *AT, nose=nose(0, edge=e, swivel=b), sense="clockwise")
        for e, b in ((wavy, beta), (moved, 0.0))
    )
    assert swung.item() == pytest.approx(same.item(), abs=1e-3 * NM)
    assert nose(0, window=(-0.5, 0.6), swivel=0.1).limits == pytest.approx((-0.6, 0.5), abs=1e-12)
    with pytest.raises(DataError, match="swivel and rake together"):
        nose(5, swivel=0.1)


def test_a_rake_error_is_an_edge_error():
    """Two algorithms: contact to mark by Newton's method, and the minimum along the edge."""
    form = Expression("3e-6*(sin(2*pi*x/7e-4)+cos(2*pi*y/7e-4))")
    x, y = np.array([1.1e-3, -0.7e-3, 2.0e-3]), np.array([0.4e-3, 1.9e-3, -1.3e-3])
    for sense in ("counterclockwise", "clockwise"):
        one = rake_error(form, x, y, nose=nose(-20), sense=sense)
        other = edge_error(form, x, y, nose=nose(0), actual=nose(-20), sense=sense)
        assert other == pytest.approx(one, abs=1e-4 * NM)


@pytest.mark.parametrize("sense", ["counterclockwise", "clockwise"])
@pytest.mark.parametrize("degrees", [0.0, -30.0, 12.0])
@pytest.mark.parametrize(
    ("form", "rho", "theta"),
    [
        (Sphere(R=35e-3), 8e-3, 0.7), (TORUS, 9e-3, 0.5),
        (Expression("3e-6*(sin(2*pi*x/7e-4)+cos(2*pi*y/7e-4))"), 2.03e-3, 1.1),
        (Expression("25e-3-sqrt((25e-3)**2-x**2)"), 6e-3, 0.8),
        (Expression("0.06*x+0.03*y"), 4e-3, 1.1),
    ],
)  # fmt: skip
def test_the_own_tool_cuts_the_surface(form, rho, theta, degrees, sense):
    tool = nose(degrees)
    e = edge_error(
        form, rho * math.cos(theta), rho * math.sin(theta), nose=tool, actual=tool, sense=sense
    )
    assert abs(e.item()) < 1e-5 * NM


def test_cusps_follow_the_curvature_of_the_section():
    """specs/cutting-path.md, 6.1; f^2/(8 R) is 5.208 nm for the spheres."""
    x, y = 5.05e-3 * math.cos(0.73), 5.05e-3 * math.sin(0.73)
    at = {"feed": 20e-6, "sense": "counterclockwise"}
    found = [
        cusp_heights(TORUS, x, y, nose=nose(0), **at),
        cusp_heights(TORUS, x, y, nose=nose(-30), **at),
        cusp_heights(TORUS, x, y, nose=nose(-30), feed=20e-6, sense="clockwise"),
        cusp_heights(TORUS, x, y, nose=nose(0), servo="XZ", **at),
        *(
            cusp_heights(Sphere(R=r), 0.705e-3, nose=nose(0), feed=5e-6, servo=s)
            for r in (2e-3, -2e-3)
            for s in ("Z", "XZ")
        ),
    ]
    expected = (84.3260, 72.6857, 73.7675, 83.1766, 9.0789, 4.4487, 4.8887, 8.2618)
    assert np.ravel(found) / NM == pytest.approx(expected, rel=1e-4, abs=0.0)
    assert np.isnan(cusp_heights(Sphere(R=0.5e-3), 0.1e-3, nose=nose(0), feed=5e-6))


def test_a_certificate_loses_its_circle_and_keeps_its_side():
    angle = np.radians(np.linspace(-50, 50, 201))
    ripple = 20 * NM * np.sin(40 * angle)
    plotted = 300 * NM + 500 * NM * np.sin(angle) - 200 * NM * np.cos(angle) + ripple
    out = EdgeProfile.from_certificate(angle, plotted, rises="outwards")
    assert out.removed["dx"] == pytest.approx(500 * NM, abs=2 * NM)  # a ripple is not orthogonal
    assert np.abs(out.deviation - ripple).max() < 3 * NM
    assert "least-squares circle was taken off the certificate: dR" in out.messages[0]
    turned = EdgeProfile.from_certificate(angle, plotted, rises="inwards")
    assert turned.removed["dx"] == pytest.approx(-out.removed["dx"], abs=1e-15)
    assert turned.deviation == pytest.approx(out.deviation[::-1], abs=1e-15)
    with pytest.raises(DataError, match="rises is one of outwards, inwards"):
        EdgeProfile.from_certificate(angle, plotted, rises="right")


@pytest.mark.parametrize(
    ("angle", "deviation", "error", "match"),
    [
        ([0, 1, 2], [0, 0, 0], TooFewSamplesError, "4 points"),
        ([0, 1, 1, 2], [0, 0, 0, 0], InvalidSamplesError, "grow strictly"),
        ([-40, -20, 0, 20], [0, 0, 0, 0], UnitError, "radians"),
        ([-0.4, -0.2, 0, 0.2], [0, 0, 40, 0], DataError, "in metres"),
        ([-0.4, -0.2, 0, 0.2], [0, np.nan, 0, 0], InvalidSamplesError, "no value may be NaN"),
        ([-0.4, -0.2, 0, 0.2], [0, 0], DataError, "equally long"),
    ],
)
def test_bad_profiles_are_refused(angle, deviation, error, match):
    with pytest.raises(error, match=match):
        EdgeProfile(angle, deviation)


def test_what_an_edge_needs_and_where_it_ends():
    with pytest.raises(DataError, match="rake of -30 degrees cuts differently both ways"):
        edge_error(TORUS, *AT, nose=nose(-30))
    with pytest.raises(DataError, match="yaw of 1 degrees cuts differently"):
        tip_path(TORUS, 9e-3, 0.5, nose=nose(0, yaw=math.radians(1)))
    with pytest.raises(DataError, match="1 um off the axis cuts differently"):
        edge_error(TORUS, *AT, nose=nose(0), setting=ToolSetting(dy=1e-6))
    with pytest.raises(LimitError, match="would cut beyond its window at rho = 9 mm"):
        edge_error(TORUS, *AT, nose=nose(0), actual=nose(0, window=math.radians(8)))
    with pytest.raises(LimitError, match="from -4 to 5 degrees"):
        tip_path(TORUS, 9e-3, 0.5, nose=nose(0, window=tuple(np.radians([-4.0, 5.0]))))
    one_sided = nose(0, window=tuple(np.radians([-4.0, 50.0])))
    assert tip_path(TORUS, 9e-3, 0.5, nose=one_sided).psi.item() == pytest.approx(
        0.0932478743, abs=1e-10
    )
    with pytest.raises(DataError, match="does not hold the tip"):
        nose(0, window=(0.1, 0.2))
    core = edge_error(
        TORUS, [0.5e-6, 5e-6], nose=nose(0), setting=ToolSetting(dy=1e-6), sense="clockwise"
    )
    assert np.isnan(core).tolist() == [True, False]
