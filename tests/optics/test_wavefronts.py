"""Wavefronts of forms and maps against the checked numbers of papers.md 4.4 and closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from metrosep import Surface
from metrosep.errors import (
    DataError,
    DegenerateFitError,
    InvalidSamplesError,
    TooFewSamplesError,
)
from metrosep.forms import Conic, Expression, Plane, SineGrid, Sphere, Toric
from metrosep.optics import Wavefront, wavefront

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
    front = wavefront(Surface(z, 1e-3, 1e-3), centre=(4e-3, 4e-3))
    assert int((~np.isnan(front.opd)).sum()) == 25
    assert "1 pixels have no measured neighbour in x or y and are omitted" in front.messages


def test_a_margin_that_was_not_measured_moves_no_axis():
    part = a_map(Sphere(R=30e-3), 41, 0.5e-3)
    z = np.where(
        np.isnan(part.z) | (np.add.outer(*2 * [(np.arange(41) - 20) ** 2]) > 390), np.nan, part.z
    )
    padded = np.pad(z, ((0, 0), (17, 2)), constant_values=np.nan)

    alone = wavefront(Surface(z, 0.5e-3, 0.5e-3), radius=9e-3).zernike(9)
    beside = wavefront(Surface(padded, 0.5e-3, 0.5e-3), radius=9e-3).zernike(9)

    for term in ("Z1", "Z2", "Z3", "Z4", "Z5", "Z6", "Z7", "Z8"):
        assert beside[term] == pytest.approx(alone[term], rel=1e-9, abs=1e-15)


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


def ring(form, outer=10e-3, inner=8e-3):
    return wavefront(form, radius=outer, inner_radius=inner, samples=(40, 90))


def test_removing_defocus_alone_leaves_the_piston_of_an_annulus():
    # Z4 has a mean over an annulus: fitted alone it would eat the piston
    lifted = ring(Expression("c + 0*x", c=1e-6))
    assert lifted.remove(["defocus"]).rms == pytest.approx(2e-6, abs=1e-18)
    both = ring(Expression("c + t*x + a*(x**2 + y**2)", c=1e-6, t=1e-7, a=1e-6))
    flat = ring(Expression("c + t*x", c=1e-6, t=1e-7))
    # a (x^2 + y^2) = a R^2 (Z4 / (2 sqrt 3) + 1 / 2): what stays is its part of the piston
    left = both.remove(["defocus"]).opd - flat.opd
    np.testing.assert_allclose(left, 2 * 1e-6 * 1e-4 / 2, rtol=0, atol=1e-16)


def test_removing_tilt_alone_leaves_the_piston_of_a_part_of_a_disc():
    z = np.where(np.arange(40) >= 30, 1e-6, np.nan) * np.ones((40, 1))
    front = wavefront(Surface(z, 1e-3, 1e-3))
    assert front.remove(["tilt"]).rms == pytest.approx(2e-6, abs=1e-18)
    assert front.remove(["tilt_x"]).rms == pytest.approx(2e-6, abs=1e-18)
    assert front.remove("piston").rms == pytest.approx(0.0, abs=1e-18)


def test_piston_alone_is_the_mean():
    z = 1e-9 * np.arange(20.0) * np.ones((10, 1))
    z[:, :8] = np.nan  # the mean stands beside the axis
    front = wavefront(Surface(z, 1e-3, 1e-3))
    left = front.remove(["piston"])
    assert np.nanmean(left.opd) == pytest.approx(0.0, abs=1e-20)
    assert front.remove(["piston", "piston"]).removed == ("piston",)
    assert left.remove("piston").removed == ("piston", "piston")  # what was done


def test_what_is_removed_is_exact_for_large_waves():
    form = Expression("a*(x**2 + y**2) + c", a=1.0, c=1e-3)
    front = wavefront(form, radius=10e-3, samples=(60, 90))
    exact = front.opd - front.zernike([0, 1, 2, 4])["Z4"] * 3**0.5 * (
        2 * (front.x**2 + front.y**2) / 10e-3**2 - 1
    )
    np.testing.assert_allclose(front.remove("defocus").opd, exact, rtol=0, atol=1e-17)


def test_increment_compares_side_and_what_was_removed():
    def made(**options):
        return wavefront(PAPER, radius=5e-3, samples=(20, 24), **options)

    inside, outside = (made(mode="refract", n=1.5, side=side) for side in ("inside", "outside"))
    with pytest.raises(DataError, match=r"from the inside.*from the outside.*like with like"):
        inside.minus(outside)
    with pytest.raises(DataError, match="piston"):
        made().minus(made().remove(["piston"]))
    a, b = made().remove(["piston", "tilt"]), made().remove(["tilt", "piston"])
    assert a.minus(b).rms == pytest.approx(0.0, abs=1e-18)
    assert a.minus(b).removed == ("piston", "tilt")
    with pytest.raises(DataError, match="Wavefront, got ndarray"):
        a.minus(b.opd)


def test_increment_keeps_the_messages_of_both_and_needs_common_points():
    z = np.zeros((8, 8))
    left, right = z.copy(), z.copy()
    left[:, 4:], right[:, :4] = np.nan, np.nan
    one, other, whole = (
        wavefront(Surface(v, 1e-3, 1e-3), centre=(3.5e-3, 3.5e-3), radius=6e-3)
        for v in (left, right, z)
    )
    assert whole.minus(one).messages == one.messages
    assert len(one.messages) == 1
    assert int((~np.isnan(whole.minus(one).opd)).sum()) == 32
    with pytest.raises(TooFewSamplesError, match="no point"):
        one.minus(other)


def test_a_table_that_leaves_no_freedom_says_so():
    opd = np.array([[0.0, 1e-9], [2e-9, np.nan]])
    front = by_hand(opd=opd, messages=("as it was",))
    table = front.zernike(3)  # a plane through three points: 1 nm along x and 2 nm along y
    assert table["Z2"] == pytest.approx(1e-9, abs=1e-20)  # rms 2 nm / 2 at the rim of 2 mm
    assert table["Z1"] == pytest.approx(2e-9, abs=1e-20)
    assert np.isnan(list(table.u.values())).all()
    assert table.messages == ("as it was", "3 terms of 3 points leave no uncertainty to tell")
    assert table.to_dict()["messages"] == list(table.messages)
    assert np.isfinite(list(by_hand().zernike(3).u.values())).all()


def test_a_smaller_disc_says_what_it_leaves_out():
    front = wavefront(PAPER, radius=10e-3, samples=(20, 24))
    table = front.zernike(9, radius=5e-3)
    ideal = wavefront(PAPER, radius=5e-3, samples=(10, 24)).zernike(9)
    assert table["Z4"] == pytest.approx(ideal["Z4"], abs=1e-16)
    assert table.messages == ("240 of 480 points lie outside the disc of the terms, radius 5 mm",)


def test_image_of_an_annulus_straight_from_its_form():
    front = ring(Plane())
    spread = front.point_spread(633e-9, samples=64)
    assert spread.strehl == pytest.approx(1.0, abs=1e-12)
    assert front.audit["inner_radius_mm"] == pytest.approx(8.0, abs=1e-12)


def test_the_mean_of_two_waves_made_by_hand():
    axis = np.linspace(-1e-3, 1e-3, 9)
    x, y = np.meshgrid(axis, axis)
    front = Wavefront(
        x, y, 1e-9 * x / 1e-3, np.ones_like(x), 1.5e-3, (0.25e-3, 0.25e-3), "reflect"
    )
    assert front.zernike(3)["Z2"] == pytest.approx(0.75e-9, abs=1e-20)  # 1.5 nm at the rim
    assert front.side == "inside"


def by_hand(**other):
    x, y = np.meshgrid([0.0, 1e-3], [0.0, 1e-3])
    given = {"x": x, "y": y, "opd": 0 * x, "weights": 0 * x + 1, "radius": 2e-3}
    return Wavefront(**{**given, "steps": (1e-3, 1e-3), "mode": "reflect", **other})


def test_results_cannot_be_changed():
    front = wavefront(Plane(), radius=1e-3, samples=(10, 12))
    with pytest.raises(ValueError, match="read-only"):
        front.opd[0, 0] = 1.0


HERE = wavefront(PAPER, radius=1e-3, samples=(20, 24))
GOOD = np.zeros((2, 2))

BAD = [
    (lambda: wavefront(PAPER), DataError, "radius of its aperture"),
    (lambda: wavefront(PAPER, radius=-1e-3), DataError, "radius must be positive"),
    (lambda: wavefront(PAPER, radius=0.2), DataError, "not defined at x"),
    (lambda: wavefront(Toric(Rd=0.1), radius=1e-3), DataError, "Rb"),
    (lambda: wavefront(Sphere(R=10e-3), radius=9e-3), InvalidSamplesError, "64"),
    (lambda: wavefront(PAPER, radius=1e-3, inner_radius=2e-3), DataError, "inner_radius"),
    (lambda: wavefront(PAPER, radius=1e-3, grid="hex"), DataError, "grid"),
    (lambda: wavefront(PAPER, radius=1e-3, samples=5), DataError, "radii, azimuths"),
    (lambda: wavefront(PAPER, radius=1e-3, mode="refract", n="1.5"), DataError, "n must be"),
    (lambda: wavefront([[0.0]]), DataError, "list"),
    (lambda: wavefront(Surface(np.zeros((5, 5)))), DataError, "lateral"),
    (lambda: wavefront(Surface(np.full((5, 5), np.nan), 1.0, 1.0)), TooFewSamplesError, "0 pix"),
    (lambda: wavefront(Surface(np.zeros((1, 9)), 1.0, 1.0)), TooFewSamplesError, "0 pix"),
    *(
        (lambda wrong=wrong: HERE.remove(wrong), DataError, "removed is one of")
        for wrong in (["coma"], "coma", 5, None, [5], [["piston"]], True)
    ),
    *(
        (lambda wrong=wrong: HERE.zernike(wrong), DataError, "whole number|terms is a number")
        for wrong in ([1.5], "4", ["4"], None, True, 2.5, [True], [None], np.nan)
    ),
    (lambda: HERE.zernike(0), DataError, "at least one"),
    (lambda: HERE.zernike([]), DataError, "at least one"),
    (lambda: HERE.zernike([-1]), DataError, "from 0"),
    (lambda: HERE.zernike([0], order="noll"), DataError, "from 1"),
    (lambda: HERE.zernike(4, order="ANSI"), DataError, "order"),
    (lambda: HERE.zernike(4, order=["ansi"]), DataError, "order"),
    *(
        (lambda wrong=wrong: HERE.zernike(4, radius=wrong), DataError, "radius")
        for wrong in (0.0, -1e-3, np.nan, "1", True)
    ),
    (lambda: HERE.zernike(4, radius=1e-6), DegenerateFitError, "0 valid points"),
    (HERE.to_surface, DataError, "square"),
    (lambda: HERE.remove("piston").point_spread(633e-9), DataError, "square"),
    (lambda: HERE.zernike(4)["Z9"], DataError, "Z9"),
    (lambda: by_hand(opd=np.zeros(3)), InvalidSamplesError, "one shape"),
    (lambda: by_hand(opd=GOOD + np.inf), InvalidSamplesError, "opd is infinite"),
    (lambda: by_hand(x=["a"]), InvalidSamplesError, "x must hold real"),
    (lambda: by_hand(x=GOOD + np.nan), InvalidSamplesError, "x and y"),
    (lambda: by_hand(opd=GOOD + np.nan), TooFewSamplesError, "no point"),
    (lambda: by_hand(weights=GOOD), TooFewSamplesError, "no point"),
    (lambda: by_hand(weights=GOOD - 1), InvalidSamplesError, "weights"),
    (lambda: by_hand(weights=GOOD * np.nan), InvalidSamplesError, "weights"),
    (lambda: by_hand(mode="absorb"), DataError, "mode"),
    (lambda: by_hand(mode="refract"), DataError, "refractive index"),
    (lambda: by_hand(side="left"), DataError, "side"),
    (lambda: by_hand(radius=0.0), DataError, "radius"),
    (lambda: by_hand(steps=(1e-3, 0.0)), DataError, "step"),
    (lambda: by_hand(steps=1e-3), DataError, "steps"),
]


@pytest.mark.parametrize(("call", "error", "match"), BAD, ids=[str(i) for i in range(len(BAD))])
def test_bad_input(call, error, match):
    with pytest.raises(error, match=match):
        call()


def test_increment_needs_the_same_points_and_mode():
    one = wavefront(SineGrid(amplitude=50e-9, wavelength=100e-6), radius=1e-4)
    with pytest.raises(DataError, match="different points"):
        one.minus(wavefront(Plane(), radius=2e-4))
    with pytest.raises(DataError, match="like with like"):
        one.minus(wavefront(Plane(), radius=1e-4, mode="refract", n=1.5))
