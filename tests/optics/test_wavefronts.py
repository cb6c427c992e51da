"""Wavefronts of forms and maps against the checked numbers of papers.md 4.4 and closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from metrosep import Surface
from metrosep.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.forms import Conic, Expression, Plane, SineGrid, Sphere, Toric
from metrosep.optics import wavefront

PAPER = Toric(Rb=265e-3, Rd=132.5e-3)
PRINTED = 5e-7
"""m: half of the last digit of 0.31128 mm is 5e-9; the radius 13.74 mm is known to 5 um only."""


def test_reflected_wave_of_the_paper_radius():
    table = wavefront(PAPER, radius=13.74e-3).zernike(9)
    assert table["Z4"] == pytest.approx(0.31128e-3, abs=PRINTED)
    assert table["Z5"] == pytest.approx(-0.1480e-3, abs=PRINTED)
    assert table["Z5"] / table["Z4"] == pytest.approx(-0.4755, abs=1e-4)
    for sine in ("Z1", "Z2", "Z3", "Z6", "Z7", "Z8"):
        assert abs(table[sine]) < 1e-12


def test_refracted_wave_of_the_paper_radius():
    table = wavefront(PAPER, radius=27.86e-3, mode="refract", n=1.4914).zernike(9)
    assert table["Z4"] == pytest.approx(0.31128e-3, abs=PRINTED)
    assert table["Z5"] == pytest.approx(-0.1468e-3, abs=PRINTED)
    assert table["Z5"] / table["Z4"] == pytest.approx(-0.4715, abs=1e-4)


def test_parabolic_sag_gives_the_closed_defocus_and_astigmatism():
    # z = a x^2 + b y^2: c20 = (a+b) R^2 / (4 sqrt 3), c22 = (a-b) R^2 / (2 sqrt 6); W = 2 z, flat limit
    a, b, R = 1e-6, 2e-6, 10e-3
    form = Expression("a*x**2 + b*y**2", a=a, b=b)
    table = wavefront(form, radius=R, samples=(100, 90)).zernike(6)
    assert table["Z4"] == pytest.approx(2 * (a + b) * R**2 / (4 * 3**0.5), abs=1e-15)
    assert table["Z5"] == pytest.approx(2 * (a - b) * R**2 / (2 * 6**0.5), abs=1e-15)
    assert table.residual_rms < 1e-15


def test_astigmatism_at_45_degrees_and_tilt_have_their_signs():
    form = Expression("c*x*y + t*y - s*x", c=3e-7, t=1e-9, s=2e-9)
    R = 5e-3
    table = wavefront(form, radius=R, samples=(60, 60)).zernike(6)
    assert table["Z3"] == pytest.approx(2 * 3e-7 * R**2 / (2 * 6**0.5), abs=1e-18)  # + for x y > 0
    assert table["Z1"] == pytest.approx(2 * 1e-9 * R / 2, abs=1e-18)  # tilt y
    assert table["Z2"] == pytest.approx(-2 * 2e-9 * R / 2, abs=1e-18)  # tilt x


def test_parabola_focuses_a_plane_wave_and_its_path_says_so():
    # All rays of z = rho^2 / 4f meet in the focus, after equal paths: back to the plane z = 0, where
    # the ray's line stands farther out than it met the mirror, and from there to the focus.
    f = 50e-3
    front = wavefront(Conic(R=2 * f, k=-1.0), radius=10e-3, samples=(50, 8))
    rho2 = front.x**2 + front.y**2
    z, g = rho2 / (4 * f), rho2 / (4 * f * f)
    slope = np.sqrt(g)
    x0 = np.sqrt(rho2) + z * 2 * slope / (1 - g)
    total = -front.opd + np.sqrt(x0**2 + f**2)
    np.testing.assert_allclose(total, f, rtol=1e-13)


def test_dz_is_almost_a_pure_piston_and_obliquity_the_rest():
    # papers.md 4.4, column dz at R = 20 mm: 2.015 raw, 0.011 without piston, q5 .0085, q6 -.0073 um
    radius = 20e-3
    raised = Expression(
        "d + Rb - sqrt((Rb - Rd + sqrt(Rd**2 - y**2))**2 - x**2)", d=1e-6, Rb=0.265, Rd=0.1325
    )
    change = wavefront(raised, radius=radius).minus(wavefront(PAPER, radius=radius))
    assert change.rms == pytest.approx(2.015e-6, abs=0.5e-9)
    assert change.remove(["piston"]).rms == pytest.approx(0.011e-6, abs=0.5e-9)
    table = change.zernike(6)
    assert table["Z4"] == pytest.approx(0.0085e-6, abs=0.05e-9)
    assert table["Z5"] == pytest.approx(-0.0073e-6, abs=0.05e-9)


def a_map(form, n, step, shift=(0.0, 0.0)):
    axis = (np.arange(n) - (n - 1) / 2) * step
    x, y = np.meshgrid(axis - shift[0], axis - shift[1])
    return Surface(form(x, y), step, step, origin=(float(axis[0]), float(axis[0])))


def test_a_map_gives_what_its_form_gives():
    n, step = 201, 0.1e-3
    surface = a_map(PAPER, n, step)
    table = wavefront(surface, radius=9e-3).zernike(6)
    ideal = wavefront(PAPER, radius=9e-3, grid="square", samples=180).zernike(6)
    assert table["Z4"] == pytest.approx(ideal["Z4"], abs=2e-3 * ideal["Z4"])
    assert table["Z5"] == pytest.approx(ideal["Z5"], abs=2e-3 * abs(ideal["Z5"]))


def test_known_form_makes_the_slopes_exact():
    surface = a_map(Sphere(R=30e-3), 41, 0.5e-3)
    front = wavefront(surface, radius=9e-3, form=Sphere(R=30e-3))
    good = ~np.isnan(front.opd)
    x, y, z = front.x[good], front.y[good], surface.z[good]
    g = (x**2 + y**2) / (30e-3**2 - x**2 - y**2)
    np.testing.assert_allclose(front.opd[good], 2 * z / (1 - g), rtol=1e-12, atol=1e-18)


def test_gaps_stay_gaps_and_lonely_pixels_are_named():
    z = np.full((9, 9), np.nan)
    z[:5, :5] = 1e-9
    z[8, 8] = 1e-9
    front = wavefront(Surface(z, 1e-3, 1e-3))
    assert int((~np.isnan(front.opd)).sum()) == 25
    assert front.messages == ("1 pixels have no measured neighbour in x or y and are left out",)


def test_mirrored_map_mirrors_the_tilt():
    z = np.zeros((20, 20)) + 1e-9 * np.arange(20)
    right = wavefront(Surface(z, 1e-3, 1e-3)).zernike(3)
    left = wavefront(Surface(z[:, ::-1], 1e-3, 1e-3)).zernike(3)
    assert right["Z2"] > 0
    assert left["Z2"] == pytest.approx(-right["Z2"], abs=1e-18)


def test_remove_takes_off_what_it_says():
    form = Expression("p + t*x + c*(x**2 + y**2)", p=1e-6, t=1e-5, c=1e-3)
    front = wavefront(form, radius=5e-3, samples=(80, 64))
    assert front.remove(["piston", "tilt", "defocus"]).rms < 1e-11  # what is left is obliquity
    assert front.remove(["piston", "tilt"]).rms == pytest.approx(
        2 * 1e-3 * 25e-6 / (2 * 3**0.5), abs=1e-10
    )
    assert front.remove(["tilt"]).removed == ("tilt",)


def test_results_cannot_be_changed():
    front = wavefront(Plane(), radius=1e-3, samples=(10, 12))
    with pytest.raises(ValueError, match="read-only"):
        front.opd[0, 0] = 1.0


@pytest.mark.parametrize(
    ("call", "error", "match"),
    [
        (lambda: wavefront(PAPER), DataError, "radius of its aperture"),
        (lambda: wavefront(PAPER, radius=-1e-3), DataError, "radius must be positive"),
        (lambda: wavefront(PAPER, radius=0.2), DataError, "not defined at x"),
        (lambda: wavefront(Sphere(R=10e-3), radius=9e-3), InvalidSamplesError, "64"),
        (lambda: wavefront(PAPER, radius=1e-3, inner_radius=2e-3), DataError, "inner_radius"),
        (lambda: wavefront(PAPER, radius=1e-3, grid="hex"), DataError, "grid"),
        (lambda: wavefront(PAPER, radius=1e-3, samples=5), DataError, "radii, azimuths"),
        (lambda: wavefront([[0.0]]), DataError, "list"),
        (lambda: wavefront(Surface(np.zeros((5, 5)))), DataError, "lateral"),
        (
            lambda: wavefront(Surface(np.full((5, 5), np.nan), 1.0, 1.0)),
            TooFewSamplesError,
            "0 pix",
        ),
        (lambda: wavefront(PAPER, radius=1e-3).remove(["coma"]), DataError, "removed must"),
        (lambda: wavefront(PAPER, radius=1e-3).to_surface(), DataError, "square"),
        (lambda: wavefront(PAPER, radius=1e-3).zernike(4)["Z9"], DataError, "Z9"),
    ],
)
def test_bad_input(call, error, match):
    with pytest.raises(error, match=match):
        call()


def test_increment_needs_the_same_points_and_mode():
    one = wavefront(SineGrid(amplitude=50e-9, wavelength=100e-6), radius=1e-4)
    with pytest.raises(DataError, match="different points"):
        one.minus(wavefront(Plane(), radius=2e-4))
    with pytest.raises(DataError, match="like with like"):
        one.minus(wavefront(Plane(), radius=1e-4, mode="refract", n=1.5))
