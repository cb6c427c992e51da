"""Sphere, conic, cylinder and asphere: closed forms, ends of the domain, starting values."""

import math

import numpy as np
import pytest

from metrosep.core.errors import DataError, DegenerateFitError, TooFewSamplesError
from metrosep.forms.conic import Asphere, Conic, Cylinder, Sphere

ROUNDING = 4e-16
"""Two units in the last place."""
START = 1e-6
"""A start that is exact in theory; its iteration gains a digit a step."""


@pytest.fixture
def disc():
    """Points of a disc of radius 10 mm, asymmetric about its centre."""
    g = np.linspace(-10e-3, 10e-3, 41)
    x, y = np.meshgrid(g, g + 0.1e-3)
    keep = x * x + y * y <= 100e-6
    return x[keep], y[keep]


# closed forms


@pytest.mark.parametrize(("a", "b", "c"), [(3, 4, 5), (5, 12, 13), (8, 15, 17), (20, 21, 29)])
def test_points_of_a_circle(a, b, c):
    """On a circle of radius c, at the distance a, the sag is c - b."""
    assert Sphere(R=c)(a, 0.0).item() == pytest.approx(c - b, rel=ROUNDING, abs=0.0)
    assert Sphere(R=-c)(0.0, b).item() == pytest.approx(-(c - a), rel=ROUNDING, abs=0.0)
    assert Cylinder(R=c)(7.0, a).item() == pytest.approx(c - b, rel=ROUNDING, abs=0.0)
    assert Sphere(R=c).gradient(a, 0.0)[0].item() == pytest.approx(a / b, rel=ROUNDING, abs=0.0)


def test_k_minus_one_is_the_paraboloid():
    r = np.linspace(0.0, 5.0, 50)

    np.testing.assert_allclose(Conic(R=0.7, k=-1.0)(r), r * r / 1.4, rtol=ROUNDING, atol=0.0)


def test_k_zero_is_the_sphere(disc):
    np.testing.assert_allclose(
        Conic(R=-11e-3, k=0.0)(*disc), Sphere(R=-11e-3)(*disc), rtol=1e-14, atol=0.0
    )


@pytest.mark.parametrize("k", [-0.75, 0.5625, 3.0])
def test_rim_of_an_ellipsoid_lies_at_its_semi_axes(k):
    """Semi-axes R/(1+k) along z and R/sqrt(1+k) across."""
    R = 2.0
    across = R / math.sqrt(1.0 + k)

    z = Conic(R=R, k=k)([across * (1 - 1e-15), across * (1 + 1e-9)])

    assert z[0] == pytest.approx(
        R / (1.0 + k), rel=1e-7, abs=0.0
    )  # the root turns 1e-15 into 4e-8
    assert np.isnan(z[1])


def test_points_of_a_conic_section_fulfil_its_equation(disc):
    """r^2 - 2 R z + (1 + k) z^2 = 0 defines the conic [ISO 10110-12]."""
    for R, k in ((50e-3, -1.2), (-12e-3, 0.3), (15e-3, -0.5)):
        z = Conic(R=R, k=k)(*disc)
        left = (disc[0] ** 2 + disc[1] ** 2) - 2 * R * z + (1 + k) * z * z
        np.testing.assert_allclose(left, 0.0, rtol=0.0, atol=1e-19)  # of 1e-4 m^2


def test_nearly_flat_part_keeps_all_digits():
    """R = 1000 km over 10 mm: the sag r^2 / 2R is 50 pm; R - sqrt(R^2 - r^2) would give 0."""
    for form in (Sphere(R=1e6), Conic(R=1e6, k=0.0), Cylinder(R=1e6, angle=math.pi / 2)):
        assert form(10e-3).item() == pytest.approx(50e-12, rel=1e-15, abs=0.0)
        assert form.gradient(10e-3)[0].item() == pytest.approx(1e-8, rel=1e-15, abs=0.0)


@pytest.mark.parametrize(
    "form", [Sphere(R=-1.0), Conic(R=-1.0, k=0.0), Cylinder(-1.0, math.pi / 2)]
)
def test_equator_and_beyond(form):
    x = np.array([0.5, 1.0, 1.0 + 1e-9, 7.0])

    assert np.isnan(form(x)).tolist() == [False, False, True, True]
    assert form(1.0).item() == pytest.approx(-1.0, abs=1e-7)
    slopes = (*form.gradient(x), *form.derivatives(x, 0 * x, list(form.parameters)))
    for slope in slopes:
        assert np.isnan(slope[2:]).all()
    assert np.isfinite([s[0] for s in slopes]).all()


def test_concave_part_rises_away_from_its_vertex():
    assert Sphere(R=1.0)(0.1).item() > 0.0
    assert Conic(R=1.0, k=-3.0)(0.1).item() > 0.0
    assert Cylinder(R=1.0)(0.0, 0.1).item() > 0.0
    assert Asphere(R=1.0)(0.1).item() > 0.0


def test_axis_of_a_cylinder():
    trough = Cylinder(R=1.0, angle=0.3)

    assert trough(5 * math.cos(0.3), 5 * math.sin(0.3)).item() == pytest.approx(0.0, abs=1e-30)
    assert trough(-0.1 * math.sin(0.3), 0.1 * math.cos(0.3)).item() == pytest.approx(
        Sphere(R=1.0)(0.1).item(), rel=1e-14, abs=0.0
    )
    half = trough.with_parameters(angle=0.3 + math.pi)
    assert half(0.2, 0.1).item() == pytest.approx(trough(0.2, 0.1).item(), rel=1e-14, abs=0.0)


def test_asphere_terms():
    base = Asphere(R=2.0, k=-1.0)
    r = 0.5

    for n, form in {
        4: Asphere(2.0, -1.0, [0.3]),
        6: Asphere(2.0, -1.0, (0.0, 0.3)),
        3: Asphere(2.0, -1.0, odd=[0.3]),
        5: Asphere(2.0, -1.0, odd={5: 0.3}),
        10: Asphere(2.0, -1.0, {10: 0.3}),
    }.items():
        assert form(r).item() - base(r).item() == pytest.approx(0.3 * r**n, rel=1e-14, abs=0.0)
        assert form.parameters[f"a{n}"] == 0.3
        assert form.units[f"a{n}"] == f"m^{1 - n}"


def test_normalised_asphere_is_the_same_surface():
    plain = Asphere(50e-3, -0.4, {4: 12.0, 6: -3e4}, odd={3: 0.2})
    norm = 8e-3
    normalised = Asphere(
        50e-3,
        -0.4,
        {4: 12.0 * norm**4, 6: -3e4 * norm**6},
        odd={3: 0.2 * norm**3},
        norm_radius=norm,
    )

    assert normalised(5e-3, 2e-3).item() == pytest.approx(
        plain(5e-3, 2e-3).item(), rel=1e-15, abs=0.0
    )
    assert normalised.units["a4"] == "m"
    assert normalised.with_parameters(a4=0.0).norm_radius == norm


def test_a_drawing_in_millimetres():
    """z = r^4 1e-6 mm^-3 at r = 10 mm is 10 um; 1e-6 mm^-3 = 1e3 m^-3."""
    form = Asphere(R=1e9, coefficients={4: 1e-6 * 1e3**3})

    assert form(10e-3).item() == pytest.approx(10e-6, rel=1e-6, abs=0.0)


# starting values


@pytest.mark.parametrize("R", [10.5e-3, 15e-3, -30e-3, 0.5, -1e4])
@pytest.mark.parametrize("unit", [1.0, 1e3, 1e-6])
def test_start_of_a_sphere(disc, R, unit):
    x, y = disc
    z = Sphere(R=R)(x, y) + 2e-3 + 1e-4 * x

    form = Sphere().start(unit * x, unit * y, unit * z)

    assert form.parameters["R"] == pytest.approx(
        unit * R, rel=1e-2 if abs(R) < 0.02 else 1e-4, abs=0.0
    )
    assert np.isfinite(form(unit * x, unit * y)).all()


def test_start_of_a_conic(disc):
    x, y = disc
    z = Conic(R=-50e-3, k=-1.2)(x, y)

    assert Conic(k=-1.2).start(x, y, z).parameters["R"] == pytest.approx(
        -50e-3, rel=START, abs=0.0
    )
    free = Conic().start(x, y, z)
    assert free.parameters == {"R": pytest.approx(-50e-3, rel=0.02, abs=0.0), "k": 0.0}
    assert Conic(R=-50e-3).start(x, y, z) == Conic(R=-50e-3, k=0.0)


def test_start_of_a_conic_that_no_sphere_reaches(disc):
    x, y = disc
    z = Conic(R=2e-3, k=-3.0)(x, y)

    form = Conic().start(x, y, z)

    assert form.k == -1.0
    assert form.R > 0.0
    assert np.isfinite(form(x, y)).all()


@pytest.mark.parametrize("angle", [-1.5, -0.7, 0.0, 0.4, math.pi / 2])
@pytest.mark.parametrize("R", [-60e-3, 20e-3])
def test_start_of_a_cylinder(disc, angle, R):
    x, y = disc
    z = Cylinder(R=R, angle=angle)(x, y) + 1e-3 - 2e-4 * y

    form = Cylinder(angle=None).start(x, y, z)

    assert math.sin(form.angle - angle) == pytest.approx(0.0, abs=2e-3)
    assert form.parameters["R"] == pytest.approx(R, rel=0.01, abs=0.0)
    assert Cylinder(angle=angle).start(x, y, z).parameters["R"] == pytest.approx(
        R, rel=START, abs=0.0
    )


def test_start_of_a_cylinder_along_a_profile():
    x = np.linspace(-5e-3, 5e-3, 101)
    z = Sphere(R=30e-3)(x)

    form = Cylinder(angle=None).start(x, 0 * x, z)

    assert form.angle == pytest.approx(math.pi / 2, rel=1e-9, abs=0.0)
    assert form.parameters["R"] == pytest.approx(30e-3, rel=START, abs=0.0)
    with pytest.raises(DegenerateFitError, match="no extent across the axis"):
        Cylinder().start(x, 0 * x, z)


def test_start_of_an_asphere(disc):
    x, y = disc
    truth = Asphere(-40e-3, -0.8, {4: 5.0, 6: 1e4})

    form = Asphere(k=-0.8, coefficients={4: 5.0, 6: 1e4}).start(x, y, truth(x, y))

    assert form.parameters["R"] == pytest.approx(-40e-3, rel=START, abs=0.0)
    free = Asphere(k=None, coefficients={4: None, 6: 1e4}).start(x, y, truth(x, y))
    assert free.parameters["a4"] == 0.0
    assert free.parameters["a6"] == 1e4
    assert free.parameters["R"] == pytest.approx(-40e-3, rel=0.1, abs=0.0)


@pytest.mark.parametrize("form", [Sphere(), Conic(), Cylinder(), Cylinder(angle=None), Asphere()])
def test_start_of_what_has_no_curvature(form, disc, rng):
    x, y = disc

    for z in (np.full_like(x, 3e-3), 1e-3 * x + 2e-3 * y + 1e-3):
        flat = form.start(x, y, z).R
        assert np.isfinite(flat)
        assert abs(flat) > 1e9  # m: its sag over the part is below the rounding of the heights
    with pytest.raises(DegenerateFitError, match="all points lie at the centre"):
        form.start(np.zeros(5), np.zeros(5), np.arange(5.0))
    for n in (0, 1, 3):
        with pytest.raises(TooFewSamplesError, match=f"got {n}"):
            form.start(x[:n], y[:n], x[:n] ** 2)
    noisy = form.start(x, y, rng.normal(0.0, 1e-9, x.size))
    assert np.isfinite(noisy.R)


def test_sign_of_the_start_follows_the_data(disc):
    x, y = disc
    z = Sphere(R=1e3)(x, y)

    assert Sphere().start(x, y, z).R > 0.0
    assert Sphere().start(x, y, -z).R < 0.0


# bad input


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Sphere(R=0.0), "R must be finite and not zero, got 0"),
        (lambda: Sphere(R=np.inf), "R must be finite and not zero, got inf"),
        (lambda: Conic(R=1.0, k=np.nan), "k must be finite"),
        (lambda: Cylinder(R=1.0, angle=np.inf), "angle must be finite"),
        (lambda: Asphere(1.0, coefficients={4: np.nan}), "a4 must be finite"),
        (lambda: Asphere(1.0, coefficients={1: 1.0}), "integer from 2 to 40, got 1"),
        (lambda: Asphere(1.0, coefficients={4.5: 1.0}), "integer from 2 to 40, got 4.5"),
        (lambda: Asphere(1.0, coefficients={"4": 1.0}), "integer from 2 to 40, got '4'"),
        (lambda: Asphere(1.0, coefficients={None: 1.0}), "integer from 2 to 40, got None"),
        (lambda: Asphere(1.0, coefficients={400: 1.0}), "integer from 2 to 40, got 400"),
        (lambda: Asphere(1.0, coefficients={3: 1.0}, odd=[1.0]), "3 is given twice"),
        (lambda: Asphere(1.0, odd={4: 1.0}), "even power 4"),
        (lambda: Asphere(1.0, coefficients="abc"), "sequence of values"),
        (lambda: Asphere(1.0, norm_radius=-1.0), "norm_radius must be positive"),
    ],
)
def test_bad_values_raise(make, message):
    with pytest.raises(DataError, match=message):
        make()


@pytest.mark.parametrize("form", [Sphere(), Conic(R=1.0), Cylinder(), Asphere(1.0, 0.0, [None])])
def test_unknown_values_raise(form):
    x = np.zeros(3)

    with pytest.raises(DataError, match="no value for"):
        form(0.0)
    with pytest.raises(DataError, match="no value for"):
        form.height(x, x)
    with pytest.raises(DataError, match="no value for"):
        form.slopes(x, x)
