"""Curves of error motions from maps of turned parts.

The parts are drawn by machines.md, eq. 20, written down here: what a lathe leaves at radius rho and
azimuth phi, with the spindle at theta = -phi; slide and spindle errors in the machine's frame.
"""

from __future__ import annotations

import re
from functools import cache

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

import metrosep as ms
from metrosep.errors import MetrosepError
from metrosep.forms import Sphere
from metrosep.machine import identify, presets
from metrosep.machine._bases import Basis, CurveTerm

R_PART, N = 17e-3, 140
CURVES = {"EZX": 6, "EZC": 3, "EBC": 2}
_EXACT = 1e-14  # m: rounding of heights of some mm
_THREE_U = (
    3.6  # largest of some 20 normal deviates exceeds it once in 150 runs; the seeds are fixed
)


def slide_z(rho):
    """EZX: a bow and a cone; it has no symmetry about the middle of the travel."""
    u = rho / 20e-3
    return 60e-9 * u**2 - 25e-9 * u + 30e-9 * u**3


def slide_x(rho):
    return 70e-9 * (rho / 22e-3) ** 2


def axial(theta):
    return 25e-9 * np.cos(2 * theta + 0.4) + 11e-9 * np.sin(theta)


def radial(theta):
    return 30e-9 * np.sin(2 * theta + 0.3)


def tilting(theta):
    return 1.5e-6 * np.cos(2 * theta - 0.2)


def left_on_part(rho, phi, z=0.0, slope=0.0):
    """Return actual minus nominal height, machines.md eq. 20."""
    theta = -phi
    across = slide_x(rho) - radial(theta) - z * tilting(theta)
    return slide_z(rho) - axial(theta) + rho * tilting(theta) - slope * across


def ball(radius, rho):
    root = np.sqrt(radius**2 - rho**2)
    return radius - np.sign(radius) * root, np.sign(radius) * rho / root


def part(radius=None, *, white=0.0, bell=0.0, seed=0, dirt=False, n=N):
    """Return the map of a face, or of a sphere of a radius, in the machine's azimuth."""
    rng = np.random.default_rng(seed)
    x = np.linspace(-R_PART, R_PART, n)
    X, Y = np.meshgrid(x, x)
    rho, phi = np.hypot(X, Y), np.arctan2(Y, X)
    z, slope = (0.0 * rho, 0.0 * rho) if radius is None else ball(radius, rho)
    # cut out of a larger field: noise that closes on itself would be alike at opposite rims, and
    # two lobes of cos 2 phi would have 1.2 times the spread that a part has
    smooth = gaussian_filter(rng.normal(size=(n + 60, n + 60)), 6.0)[30:-30, 30:-30]
    h = z + left_on_part(rho, phi, z, slope) + white * rng.normal(size=rho.shape)
    h += bell * smooth / smooth.std() + 2e-6 * X / R_PART - 1e-6 * Y / R_PART + 5e-7
    h -= slope * 150e-9  # the tool set 150 nm too far out, in this part alone
    if dirt:
        h[20:24, 60:64] += 5e-6
    h[(rho > R_PART) | (rho < 0.5e-3)] = np.nan
    return ms.Surface(h, dx=x[1] - x[0], dy=x[1] - x[0], origin=(x[0], x[0]))


def found_of(maps, forms=None, curves=CURVES, **options):
    return identify(
        presets("sts_lathe"), maps, form=forms, curves=curves, centre=(0.0, 0.0), **options
    )


@cache
def face_found():
    return found_of(part(white=1e-9, bell=3e-9, seed=5))


def without_mean(values):
    return values - values.mean()


def test_eq_20_is_the_one_of_the_specification():
    assert left_on_part(0.0, 0.0) == pytest.approx(-25e-9 * np.cos(0.4), abs=_EXACT)


def test_curves_of_a_face_without_noise_come_back_exactly_and_with_their_signs():
    found = found_of(part())
    rho = np.linspace(1e-3, 16.5e-3, 50)
    assert without_mean(found["EZX"].evaluate(rho)) == pytest.approx(
        without_mean(slide_z(rho)), abs=1e-12
    )
    theta = np.linspace(0.0, 6.2, 40)
    assert found["EZC"].evaluate(theta) == pytest.approx(axial(theta), abs=1e-12)
    assert found["EBC"].evaluate(theta) == pytest.approx(tilting(theta), abs=1e-10)
    assert np.isnan(found["EZX"].value)
    assert not found.null


def test_a_mirrored_map_is_another_spindle():
    there = part()
    mirrored = ms.Surface(there.z[::-1], dx=there.dx, dy=there.dy, origin=there.origin)
    theta = np.linspace(0.0, 6.2, 40)
    off = found_of(mirrored)["EZC"].evaluate(theta) - axial(theta)
    assert np.abs(off).max() > 15e-9  # the azimuth of the map must be as it was cut


def test_noise_alike_over_a_length_is_learnt_and_the_curves_are_within_their_uncertainty():
    found = face_found()
    rho, theta = np.linspace(1e-3, 16.5e-3, 12), np.linspace(0.0, 6.0, 9)
    # a curve is zero in the mean over its travel; compare on the places where it was cut
    whole = np.linspace(found.bases["EZX"].low, found.bases["EZX"].high, 4001)
    zero = np.trapezoid(slide_z(whole), whole) / np.ptp(whole)
    t = (found["EZX"].evaluate(rho) - slide_z(rho) + zero) / found["EZX"].sd(rho)
    assert np.abs(t).max() < _THREE_U
    t = (found["EZC"].evaluate(theta) - axial(theta)) / found["EZC"].sd(theta)
    assert np.abs(t).max() < _THREE_U
    # white noise alone would claim far less than these 3 nm over a length cost
    assert 0.4e-9 < found["EZX"].sd(np.array([8e-3]))[0] < 3e-9
    assert found.noise["part 1"] == pytest.approx(1e-9, abs=0.1e-9)


def test_one_sphere_cannot_tell_the_slides_apart_and_says_so():
    found = found_of(part(60e-3), Sphere(R=60e-3), {"EZX": 4, "EXX": 4, "EXC": 2, "EBC": 2})
    assert np.isnan(found["EZX"].evaluate(5e-3))
    assert np.isnan(found["EXX"].evaluate(5e-3))
    assert any("EXX" in s and "EZX" in s for s in found.null)
    assert any("EXC" in s and "EBC" in s for s in found.null)
    # and so of the tool point: EZX and EXX act at each place of X, EZC was not asked for
    u = found.u_at({"X": 5e-3, "C": 0.3, "Z": 0.0})
    assert np.isinf(u[0])
    assert np.isinf(u[2])
    assert np.isfinite(face_found().u_at({"X": 5e-3, "C": 0.3, "Z": 0.0})).all()


def test_a_face_and_two_spheres_of_opposite_sign_determine_all():
    curves = {"EZX": 4, "EXX": 3, "EZC": 3, "EXC": 2, "EBC": 2}
    maps = [part(), part(60e-3), part(-45e-3)]
    found = found_of(maps, [None, Sphere(R=60e-3), Sphere(R=-45e-3)], curves)
    assert not found.null
    rho, theta = np.linspace(1e-3, 16.5e-3, 30), np.linspace(0.0, 6.2, 30)
    assert without_mean(found["EXX"].evaluate(rho)) == pytest.approx(
        without_mean(slide_x(rho)), abs=1e-10
    )
    assert found["EXC"].evaluate(theta) == pytest.approx(radial(theta), abs=1e-10)
    # its own setting of the tool: 150 nm, less the constant of EXX over the travel
    setting = found.unknowns["part 2"]["setting EXX"][0][0]
    whole = np.linspace(found.bases["EXX"].low, found.bases["EXX"].high, 4001)
    constant = np.trapezoid(slide_x(whole), whole) / np.ptp(whole)
    assert setting == pytest.approx(150e-9 + constant, abs=1e-11)


def test_the_axis_of_x_is_not_seen_on_a_face():
    found = found_of(part(), curves={"EZX": 3, "EXX": 3, "EZC": 3, "EBC": 2})
    assert np.isnan(found["EXX"].evaluate(5e-3))
    assert any("EXX: not visible" in m for m in found.messages)


def test_dirt_is_refused_and_counted():
    clean, dirty = face_found(), found_of(part(white=1e-9, bell=3e-9, seed=5, dirt=True))
    assert dirty.refused["part 1"] >= 1
    rho = np.linspace(1e-3, 16.5e-3, 12)
    assert dirty["EZX"].evaluate(rho) == pytest.approx(clean["EZX"].evaluate(rho), abs=2e-9)


def test_what_was_not_asked_for_is_named():
    found = found_of(part(white=1e-9, bell=1e-9, seed=2), curves={"EZX": 6, "EZC": 3})
    assert any("EBC" in m and "residual holds more" in m for m in found.messages)
    assert not any("residual holds" in m for m in face_found().messages)


def test_a_curve_ends_where_the_part_ends():
    found = face_found()
    assert np.isnan(found["EZX"].evaluate(19e-3))


@pytest.mark.parametrize(
    ("curves", "said"),
    [
        ({"EXC": 1}, "where the part sits"),
        ({"B0Z": 2}, "location error"),
        ({"EZX": 40}, "at most 10 orders"),
        ({"EZX": 0}, "orders of EZX"),
        ({"EQX": 2}, "EQX"),
        ({}, "curves gives"),
        ("EZX", "curves gives"),
    ],
)
def test_wrong_curves_are_refused(curves, said):
    with pytest.raises(MetrosepError, match=said):
        found_of(part(), curves=curves)


def test_several_maps_need_curves_and_a_form_each():
    with pytest.raises(MetrosepError, match="by curves only"):
        found_of([part(), part()], curves=None)
    with pytest.raises(MetrosepError, match="3 forms for 2 maps"):
        found_of([part(), part()], [None, None, None])


# ---- the slope of a bow is that of a stated line: figures of machines.md, section 7 -----------------


def bow():
    """Return z = 60 nm (x / R)^2, R = 18 mm, over x = 1 to 17.5 mm as a curve of order 2."""
    low, high = 1e-3, 17.5e-3
    half, middle = (high - low) / 2, (high + low) / 2
    c = 60e-9 / 18e-3**2
    # x = middle + half u;  u^2 = (1 + 2 P2) / 3
    coefficients = np.array([2 * c * middle * half, c * half**2 * 2 / 3])
    cov = np.diag([1e-9, 2e-9]) ** 2
    return CurveTerm(coefficients, cov, Basis("legendre", (1, 2), low, high, None))


def test_slope_of_a_bow_by_its_line():
    curve = bow()
    last = 5e-13  # half of the last digit of the specification
    assert curve.slope()[0] == pytest.approx(3.425926e-6, abs=last)
    assert curve.slope("end-points")[0] == pytest.approx(3.425926e-6, abs=last)
    # the specification has 2.879960 urad, a sum over rings: the integral is 2.7e-5 of it more
    x = np.linspace(1e-3, 17.5e-3, 400_001)
    w = 18e-3 - x
    far = x - np.sum(w * x) / np.sum(w)
    exact = np.sum(w * far * 60e-9 * (x / 18e-3) ** 2) / np.sum(w * far**2)
    assert curve.slope("area", at=18e-3)[0] == pytest.approx(exact, abs=last * 40)
    assert exact == pytest.approx(2.879960e-6, abs=1e-10)
    assert curve.slope("tangent", at=9e-3)[0] == pytest.approx(60e-9 / 18e-3, abs=last)
    assert curve.bow() == pytest.approx(12.6042e-9, abs=5e-14)
    # order 1 alone has a slope: its u over half the travel
    assert curve.slope()[1] == pytest.approx(1e-9 / 8.25e-3, abs=1e-12)


def test_a_line_that_needs_a_place_says_so():
    with pytest.raises(MetrosepError, match="at goes with"):
        bow().slope("area")
    with pytest.raises(MetrosepError, match="low before high"):
        bow().slope(span=(2e-3, 1e-3))


# ---- the same through files and recipes ------------------------------------------------------------


def as_text(surface, file):
    """Write a map as rows of x, y, z in mm and um, as an instrument exports it; gaps are left out."""
    rows = ["x_mm,y_mm,z_um"]
    x0, y0 = surface.origin
    for (i, j), z in np.ndenumerate(surface.z):
        if np.isfinite(z):
            rows.append(
                f"{(x0 + j * surface.dx) * 1e3:.6f},{(y0 + i * surface.dy) * 1e3:.6f},{z * 1e6:.7f}"
            )
    file.write_text("\n".join(rows) + "\n")


RECIPE = """metrosep = 1
[input]
files = ["face.csv", "dome.csv"]
[[step]]
op = "identify"
machine = "sts_lathe"
forms = ["plane", "sphere: R=-45 mm"]
curves = {{ EZX = {orders}, EXX = 2, EZC = 3, EXC = 2, EBC = 2 }}
centre = ["0 mm", "0 mm"]
[[output]]
kind = "parts"
"""


def test_a_recipe_reads_several_parts_and_writes_the_curves(tmp_path, monkeypatch):
    from metrosep.recipe.recipe import Recipe

    monkeypatch.chdir(tmp_path)
    as_text(part(white=1e-9, bell=2e-9, seed=4), tmp_path / "face.csv")
    as_text(part(-45e-3, white=1e-9, bell=2e-9, seed=6), tmp_path / "dome.csv")
    recipe = Recipe.parse(RECIPE.format(orders=4), name="curves", folder=tmp_path)
    recipe.run(out=tmp_path / "out")
    head, *rows = (tmp_path / "out" / "C.csv").read_text().splitlines()
    assert head == "c_deg,EXC_um,EZC_um,EBC_urad,u_EXC_um,u_EZC_um,u_EBC_urad"
    c = np.array([[float(v) for v in row.split(",")] for row in rows])
    assert c[:, 2] * 1e-6 == pytest.approx(axial(np.radians(c[:, 0])), abs=5e-9)
    assert c[:, 3] * 1e-6 == pytest.approx(tilting(np.radians(c[:, 0])), abs=3e-7)


def test_a_recipe_with_curves_of_wrong_orders_is_refused(tmp_path, monkeypatch):
    from metrosep.recipe.recipe import Recipe

    monkeypatch.chdir(tmp_path)
    as_text(part(), tmp_path / "face.csv")
    as_text(part(-45e-3), tmp_path / "dome.csv")
    with pytest.raises(MetrosepError, match="orders of EZX"):
        Recipe.parse(RECIPE.format(orders='"many"'), name="curves", folder=tmp_path).run(
            out=tmp_path / "out"
        )
    assert not (tmp_path / "out" / "C.csv").exists()


def test_orders_are_chosen_by_what_foretells_the_rest_of_the_map():
    """A cubic and two harmonics with noise alike over a length, which a curve must not follow."""
    found = found_of(part(white=1e-9, bell=3e-9, seed=5), curves=dict.fromkeys(CURVES, "auto"))
    assert found.bases["EZX"].orders == (1, 2, 3)
    assert max(found.bases["EZC"].orders) == 2
    assert max(found.bases["EBC"].orders) <= 3  # one of them by chance
    assert "models compared: EZX 3, EZC 2" in " ".join(found.messages)
    rho = np.linspace(1e-3, 16.5e-3, 9)
    off = without_mean(found["EZX"].evaluate(rho)) - without_mean(slide_z(rho))
    assert np.abs(off / found["EZX"].sd(rho)).max() < _THREE_U


def test_a_curve_that_would_be_taken_for_another_is_named():
    """A sphere: EXX of 70 nm goes into EZX by many u, and the residual holds nothing of it."""
    found = found_of(part(60e-3, white=0.3e-9, n=44), Sphere(R=60e-3), CURVES)
    rho = np.linspace(1e-3, 16.5e-3, 9)
    line = np.polynomial.polynomial.polyfit
    off = found["EZX"].evaluate(rho) - slide_z(rho)
    off -= np.polynomial.polynomial.polyval(rho, line(rho, off, 2))  # the setting, a defocus
    said = next(m for m in found.messages if "may be taken for" in m)
    assert np.abs(off / found["EZX"].sd(rho)).max() > 3.0
    assert "EXX (for EZX" in said


@pytest.mark.parametrize("height", [0.0, 8e-9])
def test_a_step_round_the_axis_is_named_with_its_radius(height):
    """A face with a step of the slide at 10 mm, up towards the rim: no order of EZX follows it."""
    face = part(white=0.5e-9, n=30, seed=3)
    at = face.origin[0] + face.dx * np.arange(30)
    z = face.z + height * (np.hypot(*np.meshgrid(at, at)) > 10e-3)
    face = ms.Surface(z, dx=face.dx, dy=face.dy, origin=face.origin)
    said = [m for m in found_of(face).messages if "what the curves leave" in m]
    assert len(said) == (height > 0.0), said
    for message in said:
        assert re.search(r"(jumps|bump)", message)
        assert 6.0 < float(re.search(r"rho = ([\d.]+) mm", message)[1]) < 14.0, message


# ---- parts that contradict each other ----------------------------------------------------------------

SPINDLE = (("EZC", axial), ("EXC", radial), ("EBC", tilting))
THREE = {"EZX": 4, "EXX": 3, "EZC": 3, "EXC": 3, "EBC": 2}


def three_parts(mend=lambda k, z: z, forms=(60e-3, -60e-3), n=60):
    """A face and two spheres with 1 nm of noise, each map changed by a function of its number."""
    maps = []
    for k, radius in enumerate((None, 60e-3, -60e-3)):
        there = part(radius, white=1e-9, seed=7 + k, n=n)
        z = np.ascontiguousarray(mend(k, there.z))
        maps.append(ms.Surface(z, dx=there.dx, dy=there.dy, origin=there.origin))
    return found_of(maps, [None, *(Sphere(R=r) for r in forms)], THREE)


def contradictions(found):
    return [m for m in found.messages if re.search("contradicts? (the others:|each other)", m)]


def furthest(found):
    """Largest miss of a curve of the spindle, over its u."""
    at = np.linspace(0.0, 6.2, 40)
    return max(
        float(np.max(np.abs(found[n].evaluate(at) - true(at)) / found[n].sd(at)))
        for n, true in SPINDLE
    )


def test_parts_that_agree_are_not_said_to_contradict():
    found = three_parts()
    assert contradictions(found) == []
    assert furthest(found) < _THREE_U


@pytest.mark.parametrize(
    ("turned", "which"),
    [
        pytest.param(lambda z: z[:, ::-1], 1, id="mirrored"),
        pytest.param(lambda z: z[:, ::-1], 2, marks=pytest.mark.slow, id="mirrored 3"),
        pytest.param(np.rot90, 1, marks=pytest.mark.slow, id="turned"),
        pytest.param(np.rot90, 2, marks=pytest.mark.slow, id="turned 3"),
    ],
)
def test_a_map_of_another_azimuth_than_the_others_is_named_and_in_u(turned, which):
    found = three_parts(lambda k, z: turned(z) if k == which else z)
    (said,) = contradictions(found)
    assert said.startswith(f"part {which + 1} contradicts the others")
    assert furthest(found) < _THREE_U
    assert max(found.refused.values()) == 0  # it is no matter of a few bins


def test_a_wrong_radius_of_one_form_is_named_and_in_u():
    found = three_parts(forms=(60.1e-3, -60e-3))
    (said,) = contradictions(found)
    assert "part 2" in said
    assert "EXX" in said
    rho = np.linspace(1e-3, 16.5e-3, 30)
    for name, true in (("EZX", slide_z), ("EXX", slide_x)):
        off = without_mean(found[name].evaluate(rho)) - without_mean(true(rho))
        assert np.max(np.abs(off / found[name].sd(rho))) < _THREE_U, name


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_six_faces_whose_spindle_changed_between_them_have_the_u_of_their_scatter(seed):
    """EZC of 20 nm more or less at 2 per revolution, drawn for each part: the mean of six is off by 8 nm."""
    rng, maps = np.random.default_rng(seed), []
    for k in range(6):
        face = part(white=1e-9, seed=20 * seed + k, n=60)
        at = face.origin[0] + face.dx * np.arange(60)
        two = np.cos(2.0 * np.arctan2(*np.meshgrid(at, at)[::-1]))
        z = face.z + 20e-9 * rng.normal() * two
        maps.append(ms.Surface(z, dx=face.dx, dy=face.dy, origin=face.origin))
    found = found_of(maps)
    (said,) = contradictions(found)
    assert "most of EZC" in said
    at = np.linspace(0.0, 6.2, 40)
    off = found["EZC"].evaluate(at) - axial(at)
    assert np.max(np.abs(off / found["EZC"].sd(at))) < _THREE_U
    assert 3e-9 < np.max(found["EZC"].sd(at)) < 25e-9


def test_one_map_given_twice_is_named():
    face = part(white=1e-9, seed=5, n=60)
    assert "part 2 is part 1 again" in found_of([face, face]).messages[0]


def test_spheres_whose_forms_were_exchanged_are_refused():
    with pytest.raises(MetrosepError, match=r"which no machine has.*forms"):
        three_parts(forms=(-60e-3, 60e-3))
