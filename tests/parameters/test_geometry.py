"""Cylindricity, run-out, parallelism and their kin: values of other code, rigid motions, brute force."""

import numpy as np
import pytest

from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.forms import Sphere
from metrosep.parameters import (
    DatumAxis,
    DatumPlane,
    axis_zone,
    coaxiality,
    cylindricity,
    datum_axis,
    datum_plane,
    parallelism,
    perpendicularity,
    run_out,
    surface_profile,
)

MM, UM = 1e-3, 1e-6
Z_AXIS = DatumAxis(np.zeros(3), np.array([0.0, 0.0, 1.0]), "given")
TURN = np.linalg.qr(np.random.default_rng(5).standard_normal((3, 3)))[0]
TURN[:, 0] *= np.linalg.det(TURN)
SHIFT = np.array([0.3, -0.2, 0.1])


def moved(points):
    return points @ TURN.T + SHIFT


def cylinder():
    """24 angles x 7 heights: oval, conical, trefoil at the ends; its axis shifted and tilted."""
    th, z = np.meshgrid(2 * np.pi * np.arange(24) / 24, np.linspace(-15, 15, 7))
    th, z = th.ravel(), z.ravel()
    r = 12 + 0.003 * np.cos(2 * th) + 0.002 * z / 15 + 0.0015 * np.cos(3 * th) * (z / 15) ** 2
    x, y = r * np.cos(th) + 0.01 + 0.0004 * z, r * np.sin(th) - 0.02 + 0.0002 * z
    return np.stack([x, y, z], axis=1) * MM, np.round(z).astype(int)


def faces():
    """A wavy top and a bowl-shaped datum face below material, both tilted."""
    X, Y = (v.ravel() for v in np.meshgrid(np.linspace(0, 40, 9), np.linspace(0, 30, 7)))
    top = 20 + 2e-4 * X - 1e-4 * Y
    top += 0.002 * np.cos(2 * np.pi * X / 40) * np.cos(2 * np.pi * Y / 30)
    datum = 1e-4 * X + 5e-5 * Y + 0.0015 * ((X / 40) ** 2 + (Y / 30) ** 2 - 1)
    return [np.stack([X, Y, z], axis=1) * MM for z in (top, datum)]


@pytest.mark.parametrize(("reference", "value"), [("LS", 12.1574647), ("MZ", 10.0100729)])
def test_cylindricity_in_any_frame(reference, value):
    points, _ = cylinder()
    found = cylindricity(points, direction=[0, 0, 1], reference=reference)
    assert found.value == pytest.approx(value * UM, rel=1e-8, abs=0.0)
    turned = cylindricity(moved(points), direction=TURN[:, 2] + 0.02, reference=reference)
    assert turned.value == pytest.approx(value * UM, rel=1e-7, abs=0.0)
    if reference == "MZ":
        assert found.support.size >= 5  # four freedoms of the axis, and the width


def test_run_out_and_coaxiality_about_a_given_axis():
    points, sections = cylinder()
    assert run_out(points, Z_AXIS).value == pytest.approx(53.8576171 * UM, rel=1e-8, abs=0.0)
    circular = run_out(points, Z_AXIS, sections=sections)
    assert circular.value == pytest.approx(46.5795197 * UM, rel=1e-8, abs=0.0)
    assert np.unique(sections[circular.support]).size == 1
    found = coaxiality(points, sections, Z_AXIS)
    assert found.value == pytest.approx(46.6904701 * UM, rel=1e-8, abs=0.0)

    own = datum_axis(points, direction=[0, 0, 1])
    assert own.direction[:2] / own.direction[2] == pytest.approx([4e-4, 2e-4], rel=0.02, abs=0.0)
    assert run_out(points, own).value == pytest.approx(12.1574647 * UM, rel=1e-8, abs=0.0)
    axis = DatumAxis(moved(np.zeros((1, 3)))[0], TURN[:, 2], "given")
    assert run_out(moved(points), axis).value == pytest.approx(53.8576171 * UM, rel=1e-7, abs=0.0)


def test_parallelism_to_a_plane_that_touches_from_outside():
    top, bottom = faces()
    datum = datum_plane(bottom, outward=[0, 0, -1])
    assert datum.slopes == pytest.approx((1.375e-4, 1.0e-4), rel=1e-9, abs=0.0)
    assert (bottom @ datum.normal).max() <= datum.offset + 1e-15  # outside, and touching
    found = parallelism(top, datum)
    assert found.value == pytest.approx(11.25 * UM, rel=1e-7, abs=0.0)
    assert "tangent" in found.to_quantity().definition

    turned = datum_plane(moved(bottom), outward=-TURN[:, 2])
    assert parallelism(moved(top), turned).value == pytest.approx(11.25 * UM, rel=1e-6, abs=0.0)
    least = datum_plane(bottom, outward=[0, 0, -1], association="LS")
    assert least.offset < datum.offset  # through the middle of the bowl, not outside


def test_perpendicularity_turns_about_the_datum_only():
    """A face that is turned by 1 mrad about the datum's normal and leans by 0.2 mrad out of it."""
    y, z = (v.ravel() for v in np.meshgrid(np.linspace(0, 40, 21), np.linspace(0, 30, 16)))
    x = 1e-3 * y + 2e-4 * z
    face = np.stack([x, y, z], axis=1) * MM
    datum = DatumPlane(np.array([0.0, 0.0, 1.0]), 0.0, "given")
    found = perpendicularity(face, datum, normal=[1, 0.1, 0])
    assert found.value == pytest.approx(2e-4 * 30 * MM, rel=1e-5, abs=0.0)
    plane = DatumPlane(TURN[:, 2], 0.0, "given")
    turned = perpendicularity(moved(face), plane, normal=TURN[:, 0])
    assert turned.value == pytest.approx(found.value, rel=1e-7, abs=0.0)


def test_axis_in_the_smallest_cylinder_of_a_direction():
    s = np.linspace(0, 0.1, 11)
    centres = np.stack([1e-4 * s, -2e-4 * s, s], axis=1)
    found = axis_zone(centres, [0, 0, 1])
    assert found.value == pytest.approx(0.1 * np.hypot(1e-4, 2e-4), rel=1e-9, abs=0.0)
    assert axis_zone(centres, centres[-1] - centres[0]).value < 1e-15


def test_surface_profile_of_a_sphere():
    X, Y = np.meshgrid(np.linspace(-8, 8, 33), np.linspace(-8, 8, 33))
    inside = X**2 + Y**2 <= 64
    z = 50 - np.sqrt(2500 - X**2 - Y**2) + 0.001 * np.cos(2 * np.pi * X / 16) + 0.0004
    points = np.stack([X[inside], Y[inside], z[inside]], axis=1) * MM
    nominal = Sphere(R=50 * MM)

    found = surface_profile(points, nominal)
    free = surface_profile(points, nominal, datum=False)

    assert found.value == pytest.approx(2.8 * UM, rel=1e-6, abs=0.0)
    assert free.value < 0.592270 * UM + 1.4 * UM  # a shift alone balances both ends
    shifted = points + np.array([2e-6, -3e-6, 1e-6])
    again = surface_profile(shifted, nominal, datum=False)
    assert again.value == pytest.approx(free.value, rel=1e-6, abs=0.0)
    assert surface_profile(shifted, nominal).value > found.value


def test_the_minimax_fit_is_the_best_of_many():
    """No small motion of the fitted points makes the largest distance smaller."""
    rng = np.random.default_rng(2)
    X, Y = rng.uniform(-8, 8, (2, 60)) * MM
    z = Sphere(R=50 * MM).height(X, Y) + 1e-6 * rng.standard_normal(60)
    points = np.stack([X, Y, z], axis=1)
    best = surface_profile(points, Sphere(R=50 * MM), datum=False).value
    for shift in rng.standard_normal((200, 3)) * 3e-6:
        assert surface_profile(points + shift, Sphere(R=50 * MM)).value >= best * (1 - 1e-9)


@pytest.mark.parametrize("what", ["line", "surface"])
def test_where_the_part_lies_does_not_change_its_deviation(what):
    """A sphere that was measured millimetres off is moved and turned back; a linear turn stretches it."""
    s = np.linspace(-6, 6, 13 if what == "surface" else 81)
    X, Y = (v.ravel() for v in np.meshgrid(s, s if what == "surface" else [0.0]))
    z = 20 - np.sqrt(400 - X**2 - Y**2) + 0.001 * np.cos(1.1 * X + 0.4) + 0.0004 * (X > 3)
    points = np.stack([X, Y, z], axis=1) * MM
    nominal = Sphere(R=20 * MM)
    here = surface_profile(points, nominal, datum=False, what=what).value

    for off in (1.0, 5.0):
        there = surface_profile(
            points + np.array([off * MM, 0, 0]), nominal, datum=False, what=what
        ).value
        assert there == pytest.approx(here, rel=1e-9, abs=0.0)


def test_a_line_stays_in_its_plane():
    """A circle of 19.9 mm fits a sphere of 20 mm beside its vertex, but it is not its profile."""
    x = np.linspace(-6, 6, 41) * MM
    points = np.stack([x, 0 * x, 19.9 * MM - np.sqrt((19.9 * MM) ** 2 - x**2)], axis=1)

    found = surface_profile(
        points + np.array([0, MM, 0]), Sphere(R=20 * MM), datum=False, what="line"
    )

    # in the plane y = 1 mm the sphere shows a circle of 19.975 mm
    assert found.value > 1.5 * UM


def test_what_cannot_be_evaluated_is_refused():
    points, sections = cylinder()
    with pytest.raises(TooFewSamplesError, match="6 measured points"):
        cylindricity(points[:5], direction=[0, 0, 1])
    with pytest.raises(InvalidSamplesError, match=r"\(n, 3\)"):
        cylindricity(points[:, :2], direction=[0, 0, 1])
    with pytest.raises(DataError, match="direction"):
        cylindricity(points, direction=[0, 0, 0])
    with pytest.raises(DataError, match="reference"):
        cylindricity(points, direction=[0, 0, 1], reference="MC")
    with pytest.raises(InvalidSamplesError, match="labels"):
        run_out(points, Z_AXIS, sections=sections[:-1])
    with pytest.raises(TooFewSamplesError, match="section 15"):
        coaxiality(points[:-22], sections[:-22], Z_AXIS)
    with pytest.raises(DataError, match="not given"):
        surface_profile(points, Sphere())
    with pytest.raises(DataError, match="nearly parallel"):
        perpendicularity(points, DatumPlane(np.array([0, 0, 1.0]), 0.0, "given"), normal=[0, 0, 1])


@pytest.mark.parametrize(
    "judged",
    [
        lambda p: cylindricity(p, direction=(0, 0, 1)),
        lambda p: cylindricity(p, direction=(0, 0, 1), reference="LS"),
        lambda p: surface_profile(p, Sphere(R=0.05), datum=True),
        lambda p: parallelism(p, DatumPlane(np.array([0.0, 0.0, 1.0]), 0.0, "given")),
        lambda p: perpendicularity(
            p, DatumPlane(np.array([0.0, 0.0, 1.0]), 0.0, "given"), normal=(1, 0, 0)
        ),
        lambda p: axis_zone(p, (0, 0, 1)),
        lambda p: run_out(p, Z_AXIS),
        lambda p: run_out(p, Z_AXIS, sections=np.hypot(p[:, 0], p[:, 1]) > 0.012),
    ],
    ids=["MZ", "LS", "surface", "parallel", "square", "axis", "total", "circular"],
)
def test_support_counts_the_points_as_they_were_given(judged):
    points = cylinder()[0]
    points[41] *= (1.002, 1.002, 1.0)
    gaps = np.insert(points, [0, 3, 6, 90], np.nan, axis=0)
    whole, found = judged(points), judged(gaps)
    assert found.value == whole.value
    np.testing.assert_array_equal(gaps[found.support], points[whole.support])
