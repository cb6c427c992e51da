"""Maps: slopes at rims and gaps, where heights count from, and where the axis is."""

from __future__ import annotations

import numpy as np
import pytest

from metrosep import Surface
from metrosep.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.forms import Expression, Plane, Sphere, Toric, Zernike
from metrosep.optics import path_difference, wavefront

NM = 1e-9


def grid(n, step):
    axis = (np.arange(n) - (n - 1) / 2) * step
    return np.meshgrid(axis, axis)


def masked(form, n, step, keep, offset=0.0):
    """Return a map of a form, its origin declared, NaN where `keep` is false."""
    x, y = grid(n, step)
    return Surface(
        np.where(keep(x, y), form(x, y) + offset, np.nan),
        step,
        step,
        origin=(float(x[0, 0]), float(y[0, 0])),
    )


def within(outer, inner=0.0):
    return lambda x, y: (np.hypot(x, y) <= outer) & (np.hypot(x, y) >= inner)


def sphere_error(front, R):
    """Return found minus exact path of a mirror z = R - sqrt(R^2 - rho^2), where there is one."""
    rho2 = front.x**2 + front.y**2
    g = rho2 / (R**2 - rho2)
    error = front.opd - 2 * (R - np.sqrt(R**2 - rho2)) / (1 - g)
    return error[~np.isnan(error)]


def test_slopes_at_the_rim_are_of_second_order():
    # sphere R = 50 mm, 10 mm aperture radius, 50 um steps: first-order rim slopes were 0.66 um off
    R, step = 50e-3, 50e-6
    front = wavefront(masked(Sphere(R=R), 405, step, within(10e-3)))
    # three-point rule: h^2/3 z''' = h^2 rho/R^3, and W_p = 4 z p: 4 (1 mm) (0.2) (7e-8) = 0.2 nm
    assert np.abs(sphere_error(front, R)).max() < 0.25 * NM
    assert front.messages == ("4 pixels have no measured neighbour in x or y and are omitted",)


def test_rim_slopes_of_a_parabola_are_exact_even_if_lopsided():
    a, b, c, t = 0.9, 0.4, -0.7, 0.03
    x, y = np.meshgrid(np.arange(7) * 1e-3, np.arange(5) * 0.5e-3)
    z = a * x**2 + b * y**2 + c * x * y + t * x
    z[0, 0] = z[4, 2] = z[2, 4] = np.nan
    front = wavefront(Surface(z, 1e-3, 0.5e-3), centre=(0.0, 0.0))
    expected = path_difference(z, 2 * a * x + c * y + t, 2 * b * y + c * x)
    error = np.abs(front.opd - expected)[~np.isnan(front.opd)]
    assert error.size == 32
    # runs of two: column 4 above and below its hole, row 2 right of its, row 4 left of its
    assert (error < 1e-16).sum() == 32 - 8
    assert any(m.startswith("8 pixels have a single") for m in front.messages)


def test_a_single_neighbour_is_counted_with_the_size_of_its_error():
    # z = x^2 / 2R; a run of two pixels at x = 3h, 4h: slope 3.5 h/R instead of 3 h/R and 4 h/R
    R, h = 0.1, 1e-3
    x, _ = np.meshgrid(np.arange(9) * h, np.arange(3) * h)
    z = x**2 / (2 * R)
    z[1] = np.nan
    z[1, 3:5] = x[1, 3:5] ** 2 / (2 * R)
    front = wavefront(Surface(z, h, h), centre=(0.0, 0.0))
    exact = 2 * z / (1 - (x / R) ** 2)
    worst = np.nanmax(np.abs(front.opd - exact))
    (note,) = [m for m in front.messages if "single" in m]
    assert note.startswith("2 pixels have a single measured neighbour")
    said = float(note.split("about ")[1].split(" nm")[0]) * NM
    # linear in the slope, rounded to two digits: 4 z p dp against the path itself
    assert said == pytest.approx(worst, abs=0.15 * worst)


def test_where_no_row_shows_a_curvature_the_size_is_unknown():
    z = np.full((6, 6), np.nan)
    z[1:3, 1:3] = 1e-6
    z[4:, 4:] = 2e-6
    front = wavefront(Surface(z, 1e-3, 1e-3))
    (note,) = [m for m in front.messages if "single" in m]
    assert note.startswith("8 pixels")
    assert "cannot tell" in note


def test_slopes_with_a_form_have_no_doubt_of_their_own():
    z = Sphere(R=0.1)(*grid(9, 1e-3))
    z[3] = z[6] = np.nan  # a pair of rows between the gaps
    surface = Surface(z, 1e-3, 1e-3, origin=(-4e-3, -4e-3))
    assert any("single" in m for m in wavefront(surface).messages)
    front = wavefront(surface, form=Sphere(R=0.1))
    assert not any("single" in m for m in front.messages)
    assert np.abs(sphere_error(front, 0.1)).max() < 1e-15


def test_an_offset_of_a_curved_map_is_named_and_can_be_declared():
    # bowl R = 0.2, 6 mm radius, 1 mm too high: W = 2 c / (1 - g) has 2 c g of defocus,
    # c20 = 2 c (rim / R)^2 / (2 sqrt 3) = 520 nm in the flat limit
    R, rim, c = 0.2, 6e-3, 1e-3
    bowl = Expression("(x**2 + y**2) / (2*R)", R=R)
    at_zero = wavefront(masked(bowl, 121, 1e-4, within(rim)))
    lifted = wavefront(masked(bowl, 121, 1e-4, within(rim), offset=c))
    declared = wavefront(masked(bowl, 121, 1e-4, within(rim), offset=c), vertex_height=c)

    shift = lifted.zernike(9)["Z4"] - at_zero.zernike(9)["Z4"]
    assert shift == pytest.approx(2 * c * (rim / R) ** 2 / (2 * 3**0.5), abs=5 * NM)
    assert not [m for m in at_zero.messages if "vertex" in m]
    (note,) = [m for m in lifted.messages if "vertex" in m]
    assert "about 1000 um above" in note
    assert "vertex_height=0.001" in note
    # 2 c g at the rim, 1800 nm, and a little of 1 / (1 - g)
    assert float(note.split("up to ")[1].split(" nm")[0]) == pytest.approx(1800, abs=15)
    np.testing.assert_allclose(declared.opd, at_zero.opd, rtol=0, atol=1e-17)
    assert declared.audit["vertex_height_mm"] == pytest.approx(1.0, abs=1e-15)
    assert not [m for m in declared.messages if "vertex" in m]


@pytest.mark.parametrize(("mode", "n"), [("reflect", None), ("refract", 1.5)])
def test_a_height_below_the_vertex_is_named_in_every_mode(mode, n):
    surface = masked(Sphere(R=0.1), 61, 2e-4, within(6e-3), offset=-20e-6)
    (note,) = [m for m in wavefront(surface, mode=mode, n=n).messages if "vertex" in m]
    assert "about 20 um below" in note
    assert "vertex_height=-2e-05" in note


def test_the_height_on_the_axis_is_found_with_a_form_over_a_hole():
    surface = masked(Sphere(R=0.1), 121, 1e-4, within(6e-3, 3e-3), offset=5e-6)
    (note,) = [m for m in wavefront(surface, form=Sphere(R=0.1)).messages if "vertex" in m]
    assert "about 5 um above" in note
    (note,) = [m for m in wavefront(surface).messages if "vertex" in m]
    assert note.startswith("nothing was measured on the axis")


def test_roughness_on_a_flat_says_nothing_of_a_vertex():
    z = 5 * NM * np.random.default_rng(4).normal(size=(64, 64)) + 1e-6
    assert len(wavefront(Surface(z, 1e-4, 1e-4)).messages) == 1  # of the axis only


def test_the_axis_taken_is_told_and_in_the_audit():
    z = np.zeros((5, 9))
    (note,) = wavefront(Surface(z, 1e-3, 2e-3)).messages
    assert "x = 4 mm, y = 4 mm" in note
    assert "centre=(0, 0)" in note
    declared = wavefront(Surface(z, 1e-3, 2e-3), centre=(1e-3, 2e-3))
    assert not [m for m in declared.messages if "origin" in m]
    assert declared.audit["centre_mm"] == pytest.approx((1.0, 2.0), abs=1e-12)
    moved = wavefront(Surface(z, 1e-3, 2e-3, origin=(-4e-3, -4e-3)))
    assert moved.messages == ()
    assert moved.audit["centre_mm"] == (0.0, 0.0)


def test_an_axis_beside_the_map_needs_a_radius():
    surface = masked(Sphere(R=0.5), 41, 1e-3, within(1.0))
    with pytest.raises(DataError, match=r"x = 1000 mm.*beside the map.*-20 to 20 mm"):
        wavefront(surface, centre=(1.0, 1e-3))
    with pytest.raises(DataError, match="beside the map"):
        wavefront(surface, centre=(0.0, -20.6e-3))  # more than half a pixel out
    assert wavefront(surface, centre=(20.4e-3, 0.0)).audit["n_points"] == 41 * 41
    part = wavefront(surface, centre=(-60e-3, 0.0), radius=80e-3)  # an off-axis part
    (note,) = [m for m in part.messages if "cover" in m]
    assert "cover 8.1 % of the aperture of radius 80 mm" in note  # 1608 mm^2 of pi 80^2


def test_a_strip_and_a_wrong_radius_are_told():
    strip = Surface(np.zeros((4, 60)), 1e-3, 1e-3)
    # the farthest of 240 pixels of 1 mm^2 stands at hypot(29.5, 1.5) mm
    assert any("cover 8.8 %" in m for m in wavefront(strip).messages)
    square = Surface(np.zeros((40, 40)), 1e-3, 1e-3)
    assert not any("cover" in m for m in wavefront(square).messages)
    assert any("cover" in m for m in wavefront(square, radius=50e-3).messages)


def test_pixels_off_the_form_are_counted():
    disc = Zernike([0], coefficients=[0.0], radius=10.2e-3)  # NaN outside
    surface = masked(Plane(), 41, 1e-3, within(1.0))
    x, y = grid(41, 1e-3)
    off = int((within(12e-3)(x, y) & ~within(10.2e-3)(x, y)).sum())
    front = wavefront(surface, form=disc, radius=12e-3)
    assert front.messages[0] == f"{off} measured pixels lie where the form is not defined: omitted"
    assert front.audit["n_points"] == within(10.2e-3)(x, y).sum()


def test_counts_are_of_the_aperture_only():
    z = np.full((9, 9), np.nan)
    z[:5, :5] = 1e-9
    z[8, 8] = 1e-9
    surface = Surface(z, 1e-3, 1e-3, origin=(-2e-3, -2e-3))
    assert any(m.startswith("1 pixels have no") for m in wavefront(surface, radius=9e-3).messages)
    assert wavefront(surface, radius=3e-3).messages == ()


MAP = Surface(np.zeros((20, 20)), 1e-3, 1e-3, origin=(-9.5e-3, -9.5e-3))
TORIC = Toric(Rb=265e-3, Rd=132.5e-3)

BAD = [
    *(
        (MAP, {"centre": wrong}, DataError, "centre")
        for wrong in ((0,), "ab", 3, (0, 0, 0), ("a", 0), (np.nan, 0), (0, np.inf), (True, 0))
    ),
    *(
        (part, {"radius": wrong}, DataError, "radius")
        for wrong in ("1", np.nan, np.inf, 0, -1e-3, True, 1j)
        for part in (MAP, TORIC)
    ),
    *(
        (part, {"radius": 5e-3, "inner_radius": wrong}, DataError, "inner_radius")
        for wrong in ("1", None, np.nan, -1e-3, 5e-3)
        for part in (MAP, TORIC)
    ),
    (MAP, {"form": 3}, DataError, "form must be an ideal form.*int"),
    (MAP, {"vertex_height": "1"}, DataError, "vertex_height"),
    (MAP, {"vertex_height": np.nan}, DataError, "vertex_height"),
    (MAP, {"grid": "hex"}, DataError, "grid"),
    (MAP, {"samples": 5}, DataError, "drop samples"),
    (MAP, {"radius": 1e-9}, TooFewSamplesError, "0 pixels"),
    (TORIC, {"radius": 5e-3, "centre": (0, 0)}, DataError, "belong to a measured map"),
    (TORIC, {"radius": 5e-3, "vertex_height": 1e-6}, DataError, "belong to a measured map"),
    (TORIC, {"radius": 5e-3, "grid": ["polar"]}, DataError, "grid"),
    *(
        (TORIC, {"radius": 5e-3, "samples": wrong}, DataError, "polar grid")
        for wrong in (5, (3, 3.5), (2, 9), (3, 3, 3), "ab", (None, 9), (True, 9))
    ),
    *(
        (TORIC, {"radius": 5e-3, "grid": "square", "samples": wrong}, DataError, "square grid")
        for wrong in (7, 9.5, True, (9, 9), "64")
    ),
]


@pytest.mark.parametrize(
    ("part", "options", "error", "match"), BAD, ids=[str(i) for i in range(len(BAD))]
)
def test_bad_input(part, options, error, match):
    with pytest.raises(error, match=match):
        wavefront(part, **options)


@pytest.mark.parametrize("fill", [1e300, -1.7e308, 3.4e38])
def test_a_fill_value_is_named(fill):
    z = np.zeros((6, 6))
    z[2, 3] = fill
    with pytest.raises(InvalidSamplesError, match=r"row 2, column 3.*NaN"):
        wavefront(Surface(z, 1e-3, 1e-3))


def test_whole_numbers_of_any_kind_count_samples():
    a = wavefront(TORIC, radius=5e-3, samples=[np.int64(10), 12])
    assert a.opd.shape == (10, 12)
    assert wavefront(TORIC, radius=5e-3, grid="square", samples=np.int32(16)).opd.shape == (16, 16)
