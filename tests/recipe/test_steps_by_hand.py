"""Tables ``[[section]]`` of kind step, groove and extremes: heights that were worked out without metrosep."""

import math

import numpy as np
import pytest

import metrosep as ms
from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.parameters import step_between, step_height

UM, NM = 1e-6, 1e-9
EXACT = 1e-15
"""m: least squares of heights of 25 nm, in double precision."""

HEAD = """metrosep = 1
[input]
files = ["part.x3p"]
[[step]]
op = "parameters"
names = ["Sq"]
"""


def two_faces():
    """Return the map of the specification, C3: a tilt in both axes, a step of 25.4 nm, waves along it."""
    j, i = np.mgrid[:60, :80] * UM
    return (
        2e-4 * i - 1e-4 * j + 25.4e-9 * (i >= 39.5 * UM) + NM * np.sin(2 * np.pi * j / (11 * UM))
    )


def test_a_step_is_the_joint_fit_of_its_outer_thirds():
    # thirds of 9.5 to 69.5 um: columns 10 to 29 and 50 to 69, all rows (specification C3: 25.400000 nm,
    # where the plain difference of the means is 33.4 nm)
    surface = ms.Surface(two_faces(), UM, UM)
    found = step_between(surface, (9.5 * UM, 29.5 * UM), (69.5 * UM, 29.5 * UM), width=60 * UM)
    assert found.n_used == 2 * 20 * 60
    assert found.height == pytest.approx(25.4 * NM, abs=EXACT)
    back = step_between(surface, (69.5 * UM, 29.5 * UM), (9.5 * UM, 29.5 * UM), width=60 * UM)
    assert back.height == pytest.approx(-25.4 * NM, abs=EXACT)  # of b over a
    assert back.depth == pytest.approx(25.4 * NM, abs=EXACT)


@pytest.mark.parametrize("degrees", [0.0, 20.0, 90.0, 137.0])
def test_a_groove_in_any_direction_has_its_depth_and_sign(degrees):
    turn = math.radians(degrees)
    y, x = np.mgrid[:300, :300] * UM - 150 * UM
    along = x * math.cos(turn) + y * math.sin(turn)
    z = 3e-4 * x - 7e-4 * y - 0.734 * UM * (np.abs(along) < 20 * UM)  # cross-slope too
    surface = ms.Surface(z, UM, UM, origin=(-150 * UM, -150 * UM))
    a, b = ((s * 20 * UM * math.cos(turn), s * 20 * UM * math.sin(turn)) for s in (-1, 1))
    found = step_between(surface, a, b, width="60 um", kind="A1")
    assert found.height == pytest.approx(-0.734 * UM, abs=EXACT)
    ridge = ms.Surface(-z, UM, UM, origin=(-150 * UM, -150 * UM))
    assert step_between(ridge, a, b, width="60 um", kind="A1").height == pytest.approx(
        0.734 * UM, abs=EXACT
    )


def test_a_bow_shifts_a_groove_as_the_closed_form_says():
    # 25/18 kappa W^2 of a groove of type A1 (specification C-5), with the sums of whole pixels
    x = np.arange(2001) * 0.25 * UM
    z = np.where(np.abs(x - 250 * UM) < 50 * UM, -0.734 * UM, 0.0) + 2.0 * (x - 250 * UM) ** 2
    surface = ms.Surface(np.tile(z, (9, 1)), 0.25 * UM, 0.25 * UM)
    found = step_between(surface, (200 * UM, UM), (300 * UM, UM), width="2 um", kind="A1")
    # of the spec's 0.761819458 um, which is rounded to a pm; d is without its sign
    assert found.depth == pytest.approx(0.761819458 * UM, abs=1e-15)


def test_a_band_of_all_rows_is_the_step_of_the_recipe():
    rng = np.random.default_rng(3)
    x = np.mgrid[:80, :400][1] * UM
    z = -0.3 * UM * (np.abs(x - 200 * UM) < 40 * UM) + 1e-5 * x + NM * rng.standard_normal(x.shape)
    surface = ms.Surface(z, UM, UM)
    ours = step_between(
        surface, (160 * UM, 39.5 * UM), (240 * UM, 39.5 * UM), width="80 um", kind="A1"
    )
    theirs = step_height(surface, width="80 um", middle="200 um")
    assert ours.n_used == theirs.n_used
    assert ours.height == pytest.approx(theirs.height, abs=1e-13)  # a slope along the groove too
    # the slope along the groove is one more parameter, and the polynomials beside the model are others
    assert ours.u == pytest.approx(theirs.u, rel=0.15, abs=0.0)


def test_a_round_bottom_is_that_of_its_vertex():
    x = np.arange(-360, 361) * 0.5
    z = 0.002 * x - np.where(np.abs(x) < 60, 1.2 * (1 - (x / 60) ** 2), 0.0)
    surface = ms.Surface(np.tile(z * UM, (7, 1)), 0.5 * UM, 0.5 * UM, origin=(-180 * UM, 0.0))
    found = step_between(surface, (-60 * UM, UM), (60 * UM, UM), width="2 um", kind="A2")
    assert found.height == pytest.approx(-1.2 * UM, abs=1e-12)  # the vertex of a true parabola


def test_wrong_bands_are_refused():
    surface = ms.Surface(two_faces(), UM, UM)
    with pytest.raises(DataError, match="same point"):
        step_between(surface, (UM, UM), (UM, UM), width="5 um")
    with pytest.raises(TooFewSamplesError, match="face at b holds 0"):
        step_between(surface, (50 * UM, 30 * UM), (110 * UM, 30 * UM), width="5 um")
    with pytest.raises(TooFewSamplesError, match=r"wholly outside|face at a"):
        step_between(surface, (500 * UM, 30 * UM), (510 * UM, 30 * UM), width="5 um")


def test_a_band_of_a_few_rows_has_an_uncertainty():
    # nine rows are one block where u is estimated: of polynomials across it nothing is left
    rng = np.random.default_rng(11)
    z = np.where(np.arange(2001) > 1000, 0.1 * UM, 0.0) + NM * rng.standard_normal((9, 2001))
    for heights, a, b in (
        (z, (400 * UM, 4 * UM), (1600 * UM, 4 * UM)),
        (z.T, (4 * UM, 400 * UM), (4 * UM, 1600 * UM)),
    ):
        found = step_between(ms.Surface(heights, UM, UM), a, b, width="9 um")
        assert found.height == pytest.approx(0.1 * UM, abs=4 * found.u)
        # white noise: the variance of delta is 1/4, of which t of the outer thirds takes 12/13, so that
        # u = sigma sqrt(52 / n); the residual is looked at for more than white noise, and finds a little
        white = NM * math.sqrt(52.0 / found.n_used)
        assert 0.8 * white < found.u < 2.0 * white


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("rows", [1, 2])
def test_a_band_of_one_row_or_column_has_an_uncertainty(rows, turned):
    rng = np.random.default_rng(7)
    z = np.where(np.arange(160) >= 80, 25 * NM, 0.0) + NM * rng.standard_normal((12, 160))
    a, b, middle = (20 * UM, 5 * UM), (139 * UM, 5 * UM), 79.5 * UM
    if turned:
        z, a, b = z.T, a[::-1], b[::-1]
    found = step_between(ms.Surface(z, UM, UM), a, b, width=(rows - 0.5) * 2 * UM)
    assert found.n_used == 2 * 40 * (1 if rows == 1 else 3)
    white = NM * math.sqrt(52.0 / found.n_used)
    assert 0.7 * white < found.u < 2.5 * white
    assert found.height == pytest.approx(25 * NM, abs=4 * found.u)
    groove = np.where(np.abs(np.arange(160) * UM - middle) < 20 * UM, -25 * NM, 0.0)
    narrow = np.tile(groove, (rows, 1)) + NM * rng.standard_normal((rows, 160))
    axis = "y" if turned else "x"
    thin = ms.Surface(narrow.T if turned else narrow, UM, UM)
    other = step_height(thin, width="40 um", middle=middle, axis=axis)
    assert other.height == pytest.approx(-25 * NM, abs=4 * other.u)
    assert other.u > 0.1 * NM


def judged(tmp_path, z, text):
    ms.write(ms.Surface(z, UM, UM), tmp_path / "part.x3p")
    (tmp_path / "r.toml").write_text(HEAD + text)
    result = ms.Recipe.load(tmp_path / "r.toml").run(tmp_path / "part.x3p", out=tmp_path / "o")
    return {e["metric"]: e for e in result.document["characteristics"]}, result


STEP = """[[section]]
kind = "step"
name = "edge"
a = "9.5 um, 29.5 um"
b = "69.5 um, 29.5 um"
width = "60 um"
[[check]]
metric = "section.edge.h"
lower = "25 nm"
upper = "26 nm"
U = "0.2 nm"
"""


def test_a_step_of_a_recipe_is_judged_and_reversed_it_fails(tmp_path):
    found, result = judged(tmp_path, two_faces(), STEP)
    assert found["section.edge.h"]["value"] == pytest.approx(
        25.4 * NM, abs=1e-14
    )  # x3p holds doubles
    assert found["section.edge.h"]["verdict"] == "accept"
    assert found["section.edge.d"]["value"] == pytest.approx(25.4 * NM, abs=1e-14)
    assert "2400" not in found["section.edge.h"]["definition"]  # equal for every part
    assert any("2400 pixels" in m for m in result.document["messages"])
    turned, _ = judged(tmp_path, two_faces()[:, ::-1], STEP)
    assert turned["section.edge.h"]["value"] == pytest.approx(-25.4 * NM, abs=1e-14)
    assert turned["section.edge.h"]["verdict"] == "reject"
    assert result.verdict == "accept"


def test_the_u_of_the_fit_serves_a_check(tmp_path):
    # the waves along the edge leave u = 0.37 nm, so that U is 0.73 nm
    wide = STEP.replace('"25 nm"', '"24 nm"').replace('"26 nm"', '"27 nm"')
    found, _ = judged(tmp_path, two_faces(), wide.replace('U = "0.2 nm"', 'U = "from fit"'))
    edge = found["section.edge.h"]
    assert edge["u"] > 0
    assert edge["U"] == pytest.approx(edge["k"] * edge["u"], rel=1e-12, abs=0.0)
    assert edge["verdict"] == "accept"


@pytest.mark.parametrize("kind", ["step", "distance"])
def test_what_was_not_measured_is_inconclusive_with_a_sentence(tmp_path, kind):
    z = two_faces()
    z[:, 45:] = np.nan
    text = STEP
    if kind == "distance":
        text = (
            STEP.replace('"step"', '"distance"')
            .replace('width = "60 um"\n', "")
            .replace("edge.h", "edge.height")
        )
    found, result = judged(tmp_path, z, text)
    entry = found["section.edge.h" if kind == "step" else "section.edge.height"]
    assert entry["verdict"] == "inconclusive"
    assert result.verdict == "inconclusive"
    assert "section edge" in entry["reason"]
    assert entry["value"] is None or math.isnan(entry["value"])
    if kind == "distance":
        assert found["section.edge.lateral"]["value"] == pytest.approx(60 * UM, abs=1e-12)


def test_the_extremes_of_a_circle_are_those_of_its_pixels(tmp_path):
    rng = np.random.default_rng(8)
    z = NM * rng.standard_normal((60, 80))
    z[12, 51], z[40, 30], z[2, 2] = 9 * NM, -8 * NM, 50 * NM  # the last lies outside of the circle
    text = """[[section]]
kind = "extremes"
name = "spot"
centre = "40 um, 30 um"
radius = "25 um"
[[check]]
metric = "section.spot.Pt"
upper = "30 nm"
U = "1 nm"
"""
    found, _ = judged(tmp_path, z, text)
    spot = {k.split(".")[-1]: e["value"] for k, e in found.items() if k.startswith("section.spot")}
    assert spot["peak"] == pytest.approx(9 * NM, abs=EXACT)
    assert (spot["peak_x"], spot["peak_y"]) == pytest.approx((51 * UM, 12 * UM), abs=1e-12)
    assert (spot["valley_x"], spot["valley_y"]) == pytest.approx((30 * UM, 40 * UM), abs=1e-12)
    assert spot["Pt"] == pytest.approx(17 * NM, abs=EXACT)
    assert found["section.spot.Pt"]["verdict"] == "accept"
    z[20, 44] = np.nan
    holed, _ = judged(tmp_path, z, text)
    assert holed["section.spot.Pt"]["verdict"] == "inconclusive"
    assert holed["section.spot.peak"]["value"] == pytest.approx(9 * NM, abs=EXACT)


GROOVE = """[[section]]
kind = "groove"
name = "g"
a = "150.5 um, 9.5 um"
b = "210.5 um, 9.5 um"
width = "20 um"
{}[[check]]
metric = "section.g.d"
lower = "0.65 um"
U = "5 nm"
"""


@pytest.mark.parametrize(
    ("degree", "depth", "verdict"),
    [("", 0.75, "inconclusive"), ("degree = 2\n", 0.5, "reject")],
)
def test_bowed_faces_prevent_a_verdict_until_the_bow_is_fitted(tmp_path, degree, depth, verdict):
    # 25/18 kappa W^2 = 0.25 um onto a groove of 0.5 um: half as deep again, which the limit would accept
    x = np.arange(361) * UM - 180.5 * UM
    kappa = 0.25 * UM * 18 / 25 / (60 * UM) ** 2
    z = np.tile(-0.5 * UM * (np.abs(x) < 25 * UM) + kappa * x**2, (20, 1))
    found, result = judged(tmp_path, z, GROOVE.format(degree))
    entry = found["section.g.d"]
    # the closed form is of an integral, which the sums of 20 pixels and more meet to a thousandth
    assert entry["value"] == pytest.approx(depth * UM, abs=1e-3 * UM)
    assert entry["verdict"] == verdict
    assert ("degree = 2" in entry.get("reason", "")) == (not degree)
    assert any("section g: the faces are bowed" in m for m in result.document["messages"]) == (
        not degree
    )


@pytest.mark.parametrize(
    ("a", "b"),
    [
        ((9.5, 29.5), (69.5, 29.5)),
        ((30.5, 20.0), (90.5, 20.0)),  # beyond the rim in x
        ((9.5, 54.0), (69.5, 54.0)),  # in y
        ((-12.0, 3.0), (47.0, 44.0)),  # at a corner, turned
        ((70.0, 70.0), (20.0, -8.0)),
    ],
)
@pytest.mark.parametrize("kind", ["step", "A1"])
def test_pixels_beyond_the_map_are_counted_as_on_a_larger_map_of_gaps(a, b, kind):
    small = two_faces()
    large = np.full((460, 480), np.nan)
    large[200:260, 200:280] = small
    a, b = ((x * UM, y * UM) for x, y in (a, b))
    counts = []
    for z, origin in ((small, 0.0), (large, -200 * UM)):
        surface = ms.Surface(z, UM, UM, origin=(origin, origin))
        if kind == "A1":  # its bottom is a third of the line, its faces lie beyond
            a3 = tuple((2 * p + q) / 3 for p, q in zip(a, b, strict=True))
            b3 = tuple((p + 2 * q) / 3 for p, q in zip(a, b, strict=True))
            found = step_between(surface, a3, b3, width="21 um", kind="A1")
        else:
            found = step_between(surface, a, b, width="21 um")
        counts.append((found.n_used, found.n_missing))
    assert counts[0] == counts[1]
    assert (counts[0][1] > 0) == (a[0] != 9.5 * UM or a[1] != 29.5 * UM)


@pytest.mark.parametrize("where", ["whole", "pixel", "edge", "patch", "outside"])
def test_more_than_a_few_missing_pixels_of_a_step_prevent_a_verdict(tmp_path, where):
    z, text = two_faces(), STEP
    if where == "pixel":
        z[30, 20] = np.nan
    elif where == "patch":
        z[20:30, 12:20] = np.nan  # 80 of 2400
    elif where == "edge":
        z[:, 35:45] = np.nan  # the middle third, which is not used
    elif where == "outside":
        text = STEP.replace('width = "60 um"', 'width = "64 um"')
    found, _ = judged(tmp_path, z, text)
    entry = found["section.edge.h"]
    wanted = "accept" if where in ("whole", "pixel", "edge") else "inconclusive"
    assert entry["verdict"] == wanted
    assert entry["value"] == pytest.approx(25.4 * NM, abs=1e-11)
    assert ("% of section edge was not measured" in entry.get("reason", "")) == (
        wanted == "inconclusive"
    )
