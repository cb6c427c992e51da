"""Toric and biconic: sections, Eq. (12) of the paper, saddles, domain, starting values."""

import numpy as np
import pytest

from metrosep.core.errors import DataError, DegenerateFitError, TooFewSamplesError
from metrosep.forms.conic import Conic, Sphere
from metrosep.forms.toric import Biconic, Toric

ROUNDING = 1e-15
RB, RD = 265e-3, 132.5e-3
"""Of Micromachines 11 (2020) 331, Eq. (12)."""


@pytest.fixture
def disc():
    """Points of a disc of radius 20 mm."""
    g = np.linspace(-20e-3, 20e-3, 41)
    x, y = np.meshgrid(g, g)
    keep = x * x + y * y <= 400e-6
    return x[keep], y[keep]


def test_sections_on_the_axes_are_circles():
    t = np.linspace(-20e-3, 20e-3, 41)
    form = Toric(Rb=RB, Rd=RD)

    np.testing.assert_allclose(form(t, 0.0), Sphere(R=RB)(t), rtol=ROUNDING, atol=0.0)
    np.testing.assert_allclose(form(0.0, t), Sphere(R=RD)(t), rtol=ROUNDING, atol=0.0)


def test_equation_12_in_polar_coordinates(disc):
    """z = Rb - sqrt((Rb - Rd + sqrt(Rd^2 - rho^2 sin^2))^2 - rho^2 cos^2), as printed."""
    rho, theta = np.hypot(*disc), np.arctan2(disc[1], disc[0])
    inner = RB - RD + np.sqrt(RD**2 - rho**2 * np.sin(theta) ** 2)

    printed = RB - np.sqrt(inner**2 - rho**2 * np.cos(theta) ** 2)

    assert np.abs(Toric(Rb=RB, Rd=RD)(*disc) - printed).max() < 1e-16  # m: its cancellation


def test_points_lie_on_the_torus(disc):
    """Distance from the circle of radius Rb - Rd about the axis is Rd everywhere."""
    x, y = disc
    for Rb, Rd in ((RB, RD), (90e-3, 120e-3)):
        z = Toric(Rb=Rb, Rd=Rd)(x, y)
        from_axis = np.hypot(x, Rb - z)
        distance = np.hypot(from_axis - (Rb - Rd), y)
        np.testing.assert_allclose(distance, Rd, rtol=2e-15, atol=0.0)


def test_equal_radii_are_the_sphere(disc):
    np.testing.assert_allclose(
        Toric(Rb=-0.1, Rd=-0.1)(*disc), Sphere(R=-0.1)(*disc), rtol=1e-14, atol=0.0
    )


def test_opposite_signs_are_a_saddle():
    form = Toric(Rb=0.2, Rd=-0.1)

    assert form(1e-2, 0.0).item() == pytest.approx(
        Sphere(R=0.2)(1e-2).item(), rel=ROUNDING, abs=0.0
    )
    assert form(0.0, 1e-2).item() == pytest.approx(
        Sphere(R=-0.1)(1e-2).item(), rel=ROUNDING, abs=0.0
    )


def test_flipped_radii_flip_the_form(disc):
    np.testing.assert_array_equal(Toric(Rb=-RB, Rd=-RD)(*disc), -Toric(Rb=RB, Rd=RD)(*disc))


def test_exchange_of_axes_is_another_surface():
    """A torus is not symmetric in its radii: they differ from the fourth order on."""
    a = Toric(Rb=RB, Rd=RD)(14e-3, 14e-3).item()
    b = Toric(Rb=RD, Rd=RB)(14e-3, 14e-3).item()

    assert 1e-9 < abs(a - b) < 1e-5


def test_nearly_flat_toric_keeps_all_digits():
    assert Toric(Rb=1e6, Rd=2e6)(1e-2, 0.0).item() == pytest.approx(50e-12, rel=1e-15, abs=0.0)
    assert Toric(Rb=1e6, Rd=2e6)(0.0, 1e-2).item() == pytest.approx(25e-12, rel=1e-15, abs=0.0)


def test_domain_of_the_toric():
    form = Toric(Rb=1.0, Rd=3.0)

    z = form([0.9, 1.1, 0.9, 0.0, 0.0], [0.0, 0.0, 1.5, 2.9, 3.1])

    assert np.isnan(z).tolist() == [
        False,
        True,
        True,
        True,
        True,
    ]  # 2.9: the tube crosses the axis


def test_biconic_sections_are_conics():
    t = np.linspace(-20e-3, 20e-3, 41)
    form = Biconic(Rx=60e-3, Ry=-45e-3, kx=-2.2, ky=0.7)

    np.testing.assert_allclose(form(t, 0.0), Conic(R=60e-3, k=-2.2)(t), rtol=ROUNDING, atol=0.0)
    np.testing.assert_allclose(form(0.0, t), Conic(R=-45e-3, k=0.7)(t), rtol=ROUNDING, atol=0.0)


def test_biconic_of_equal_sections_is_the_conic(disc):
    np.testing.assert_allclose(
        Biconic(Rx=0.1, Ry=0.1, kx=-0.3, ky=-0.3)(*disc),
        Conic(R=0.1, k=-0.3)(*disc),
        rtol=4 * ROUNDING,
        atol=0.0,
    )


def test_transpose_exchanges_the_axes_of_a_biconic(disc):
    x, y = disc
    form, other = Biconic(0.06, -0.05, -0.2, 0.7), Biconic(-0.05, 0.06, 0.7, -0.2)

    np.testing.assert_allclose(form(x, y), other(y, x), rtol=1e-13, atol=1e-18)
    np.testing.assert_allclose(
        form.gradient(x, y)[0], other.gradient(y, x)[1], rtol=1e-13, atol=1e-16
    )


@pytest.mark.parametrize(("Rb", "Rd"), [(RB, RD), (-30e-3, -40e-3), (50e-3, -25e-3)])
def test_start_of_a_toric(disc, Rb, Rd):
    x, y = disc
    z = Toric(Rb=Rb, Rd=Rd)(x, y) + 1e-3 - 1e-4 * x

    form = Toric().start(x, y, z)

    assert form.parameters == {
        "Rb": pytest.approx(Rb, rel=0.35, abs=0.0),
        "Rd": pytest.approx(Rd, rel=0.35, abs=0.0),
    }
    assert np.isfinite(form(x, y)).all()
    assert Toric(Rb=Rb).start(x, y, z).parameters["Rb"] == Rb


@pytest.mark.parametrize("k", [-3.0, -1.0, 0.0])
def test_start_of_a_biconic(disc, k):
    x, y = disc
    truth = Biconic(Rx=25e-3, Ry=-40e-3, kx=k, ky=k)
    z = truth(x, y)

    form = Biconic().start(x, y, z)

    assert form.parameters["Rx"] == pytest.approx(25e-3, rel=0.35, abs=0.0)
    assert form.parameters["Ry"] == pytest.approx(-40e-3, rel=0.35, abs=0.0)
    assert np.isfinite(form(x, y)).all()
    assert truth.start(x, y, z) == truth


def test_start_of_a_biconic_that_is_steep(disc):
    x, y = disc
    z = Biconic(Rx=3e-3, Ry=4e-3, kx=-2.0, ky=-2.0)(x, y)

    form = Biconic().start(x, y, z)

    assert (form.kx, form.ky) == (-1.0, -1.0)
    assert np.isfinite(form(x, y)).all()
    inside = Biconic(kx=0.5, ky=0.5).start(x, y, z)
    assert np.isfinite(inside(x, y)).all()


def test_a_flat_direction_gets_a_large_finite_radius(disc):
    x, y = disc

    form = Toric().start(x, y, Sphere(R=50e-3)(x, 0 * y))

    assert form.parameters["Rb"] == pytest.approx(50e-3, rel=0.1, abs=0.0)
    assert 100.0 < abs(form.Rd) < np.inf


@pytest.mark.parametrize("form", [Toric(), Biconic()])
def test_start_without_curvature_is_flat(form, disc):
    x, y = disc

    for z in (np.full_like(x, 1e-3), 1e-3 * x):
        radii = [v for k, v in form.start(x, y, z).parameters.items() if k.startswith("R")]
        assert all(np.isfinite(R) and abs(R) > 1e9 for R in radii)
    with pytest.raises(DegenerateFitError, match="fewer than 3 positions along y"):
        form.start(x, 0 * y, x * x)
    with pytest.raises(TooFewSamplesError, match="got 3"):
        form.start(x[:3], y[:3], x[:3] ** 2)


def test_bad_values_raise():
    with pytest.raises(DataError, match="Rd must be finite and not zero"):
        Toric(Rb=1.0, Rd=0.0)
    with pytest.raises(DataError, match="Ry must be finite and not zero"):
        Biconic(Rx=1.0, Ry=np.inf)
    with pytest.raises(DataError, match="no value for Rd"):
        Toric(Rb=1.0)(0.0)


def test_heights_and_derivatives_of_the_specification():
    """Numbers worked out with 40 digits, without metrosep: mm of height, m^2 and m of derivatives."""
    digits = {"rel": 1e-10}  # as many as are printed
    toric = Toric(Rb=RB, Rd=RD)(12e-3, 9e-3)
    assert toric == pytest.approx(0.578165887188e-3, **digits, abs=0.0)
    conic, at = Conic(R=40e-3, k=-0.7), (np.array([6e-3]), np.array([8e-3]))
    assert conic(*at)[0] == pytest.approx(1.2559149589403e-3, **digits, abs=0.0)
    by_R, by_k = (v[0] for v in conic.derivatives(*at, ("R", "k")))
    assert -by_R * 40e-3**2 == pytest.approx(5.07142946674e-5, **digits, abs=0.0)  # by c = 1/R
    assert by_k == pytest.approx(1.99040129078e-5, **digits, abs=0.0)
    biconic, at = Biconic(60e-3, -90e-3, 0.5, -1.2), (np.array([7e-3]), np.array([4e-3]))
    assert biconic(*at)[0] == pytest.approx(0.32105960196e-3, **digits, abs=0.0)
    found = [v[0] for v in biconic.derivatives(*at, ("Rx", "Ry", "kx", "ky"))]
    found[0] *= -(60e-3**2)
    found[1] *= -(90e-3**2)
    wanted = (2.48235276e-5, 8.04624405e-6, 1.10917820e-6, 1.60969171e-7)
    assert found == pytest.approx(wanted, rel=1e-8, abs=0.0)
