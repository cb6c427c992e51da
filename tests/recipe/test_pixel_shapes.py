"""Shapes in px: the same pixels on a map without scale, with one, and with pixels that are not square."""

import json

import numpy as np
import pytest

import metrosep as ms
from metrosep.core.errors import DataError, MetrosepError, RecipeError
from metrosep.recipe.pipeline import run_steps

NM, UM = 1e-9, 1e-6
SHAPE = (41, 67)
"""Rows and columns of the map; nothing about it is symmetric."""
STEPS = {"none": (None, None), "square": (3 * UM, 3 * UM), "oblong": (2 * UM, 5 * UM)}
READ = 1e-5
"""Relative, of heights between pixels."""
EXACT = 1e-18
"""m: rounding of heights of some nm."""


def heights():
    """Return a map that rises along x, falls along y, with a step at column 30, a spike, a pit and a gap."""
    j, i = np.mgrid[: SHAPE[0], : SHAPE[1]]
    z = (0.7 * i - 0.3 * j + 25.0 * (i >= 30)) * NM
    z[11, 52] += 400 * NM
    z[29, 47] -= 300 * NM
    z[:3, :5] = np.nan
    return z


@pytest.fixture(params=STEPS)
def part(request, tmp_path):
    dx, dy = STEPS[request.param]
    origin = (0.0, 0.0) if dx is None else (7e-3, -4e-3)
    ms.write(ms.Surface(heights(), dx, dy, origin=origin), tmp_path / "part.h5")
    return tmp_path


HEAD = 'metrosep = 1\n[input]\nfiles = ["part.h5"]\n'
SIZE = '[[step]]\nop = "parameters"\nnames = ["PV"]\n'


def measured(part, text, command_line):
    """Return the document that the command line writes."""
    (part / "r.toml").write_text(HEAD + text)
    done = command_line(part, "run", "r.toml", "part.h5", "-o", "out")
    assert done.returncode in (0, 1), done.stderr
    return json.loads((part / "out" / "result.json").read_text())


ROW, COLUMN = np.mgrid[: SHAPE[0], : SHAPE[1]]
TURN = np.radians(20.0)
U, V = (
    (COLUMN - 33) * np.cos(TURN) + (ROW - 18) * np.sin(TURN),
    (ROW - 18) * np.cos(TURN) - (COLUMN - 33) * np.sin(TURN),
)
MASKS = {
    "circle": (
        'shape = "circle", diameter = "21 px", centre = ["40 px", "13 px"]',
        (COLUMN - 40) ** 2 + (ROW - 13) ** 2 <= 10.5**2,
    ),
    "ring": (
        'shape = "ring", diameter = "30 pixels", inner_diameter = "9 px", centre = ["31 px", "22 px"]',
        ((COLUMN - 31) ** 2 + (ROW - 22) ** 2 <= 15**2)
        & ((COLUMN - 31) ** 2 + (ROW - 22) ** 2 >= 4.5**2),
    ),
    "rectangle": (
        'shape = "rectangle", width = "25.5 px", height = "8.5 px", centre = ["33 px", "18 px"], angle = "20 deg"',
        (np.abs(U) <= 12.75) & (np.abs(V) <= 4.25),
    ),
    "polygon": (
        'shape = "polygon", points = ["10.5 px, 4.5 px", "50.5 px, 4.5 px", "50.5 px, 30.5 px"]',
        (ROW > 4.5) & (ROW < 30.5) & (COLUMN < 50.5) & ((COLUMN - 10.5) * 26 > (ROW - 4.5) * 40),
    ),
    "brush": (
        'shape = "brush", radius = "3.5 px", points = ["20 px, 35 px", "60 px, 35 px"]',
        (np.abs(ROW - 35) <= 3.5)
        & (np.hypot(np.maximum(abs(COLUMN - 40) - 20, 0), ROW - 35) <= 3.5),
    ),
}


@pytest.mark.parametrize("shape", MASKS)
@pytest.mark.parametrize("outside", [True, False])
def test_a_mask_takes_the_pixels_that_were_counted_by_hand(part, command_line, shape, outside):
    typed, inside = MASKS[shape]
    step = f'[[step]]\nop = "mask"\naperture = {{ {typed} }}\noutside = {str(outside).lower()}\n'
    document = measured(part, step + SIZE, command_line)

    kept = heights()[inside if outside else ~inside]
    (value,) = [c["value"] for c in document["characteristics"] if c["metric"] == "PV"]
    assert value == pytest.approx(np.nanmax(kept) - np.nanmin(kept), abs=EXACT)
    n = np.count_nonzero(~np.isnan(kept))
    assert any(m.startswith("mask") and f"removed, {n} left" in m for m in document["messages"])


def test_in_python_too(part):
    surface = ms.read(part / "part.h5")
    left = surface.mask("circle", diameter="21 px", centre=("40 px", "13 px"), outside=False)
    np.testing.assert_array_equal(np.isnan(left.z), np.isnan(heights()) | MASKS["circle"][1])


SECTIONS = """[[section]]
kind = "line"
name = "across"
a = "10 px, 20 px"
b = "27 px, 20 px"
[[section]]
kind = "line"
name = "band"
a = "6 px, 20 px"
b = "6 px, 35 px"
width = "5 px"
[[section]]
kind = "circle"
name = "round"
centre = "14 px, 24 px"
radius = "7 px"
harmonics = [1]
[[section]]
kind = "distance"
name = "long"
a = "12 px, 30 px"
b = "24 px, 25 px"
[[section]]
kind = "angle"
name = "corner"
a = "20 px, 10 px"
b = "10 px, 10 px"
c = "20 px, 20 px"
[[section]]
kind = "circle3"
name = "bore"
a = "5 px, 10 px"
b = "9 px, 14 px"
c = "13 px, 10 px"
[[section]]
kind = "step"
name = "edge"
a = "20.5 px, 20 px"
b = "38.5 px, 20 px"
width = "9 px"
[[section]]
kind = "extremes"
name = "spot"
centre = "50 px, 20 px"
radius = "12 px"
"""


def test_sections_read_the_same_pixels_whatever_the_scale_is(part, command_line):
    document = measured(part, SIZE + SECTIONS, command_line)
    found = {c["metric"][8:]: c for c in document["characteristics"] if c["metric"][0] == "s"}

    def of(name, unit):
        assert found[name]["unit"] == unit
        return found[name]["value"]

    assert of("across.Pt", "m") == pytest.approx(17 * 0.7 * NM, abs=EXACT)
    assert of("band.Pt", "m") == pytest.approx(15 * 0.3 * NM, abs=EXACT)
    assert of("round.harmonic_1", "m") == pytest.approx(7 * np.hypot(0.7, 0.3) * NM, abs=READ * NM)
    assert of("long.lateral", "px") == pytest.approx(13.0, abs=1e-12)
    assert of("long.azimuth", "rad") == pytest.approx(np.arctan2(-5, 12), abs=1e-12)
    assert of("long.height", "m") == pytest.approx((12 * 0.7 + 5 * 0.3) * NM, abs=READ * NM)
    assert not {"long.distance", "long.slope"} & found.keys()  # px and m make no length together
    assert of("corner.angle", "rad") == pytest.approx(np.pi / 4, abs=1e-12)
    assert [of(f"bore.{k}", "px") for k in ("diameter", "x", "y")] == pytest.approx(
        [8, 9, 10], abs=1e-12
    )
    assert of("edge.h", "m") == pytest.approx(25 * NM, abs=READ * NM)
    assert [of(f"spot.peak_{k}", "px") for k in "xy"] == [52.0, 11.0]
    assert [of(f"spot.valley_{k}", "px") for k in "xy"] == [47.0, 29.0]
    assert of("spot.peak", "m") == pytest.approx(heights()[11, 52], abs=EXACT)
    assert document["separation"]["sections"][0]["a"] == ["10 px", "20 px"]


ROUND = {"none": "does not say whether they are square", "square": "", "oblong": "2 um by 5 um"}


def test_what_is_round_warns_that_pixels_may_not_be_square(part, command_line, request):
    kind = next(k for k in STEPS if f"[{k}" in request.node.name)
    away = 'shape = "circle", diameter = "5 px", centre = ["61 px", "36 px"]'
    step = f'[[step]]\nop = "mask"\noutside = false\naperture = {{ {away} }}\n'
    document = measured(part, step + SIZE + SECTIONS, command_line)
    said = [m for m in document["messages"] if "counts pixels" in m]
    if kind == "square":
        assert said == []
        return
    assert all(ROUND[kind] in m for m in said)
    of = {m.split(" counts")[0] for m in said}
    assert of == {
        "mask: the circle",
        *(f"section {n}" for n in ("round", "long", "corner", "bore", "spot")),
    }  # neither a line nor a step


def test_regions_and_grooves_in_px(part, command_line):
    step = (
        '[[step]]\nop = "step_height"\n'
        'upper = { shape = "rectangle", width = "10 px", height = "20 px", centre = ["38 px", "20 px"] }\n'
        'lower = { shape = "rectangle", width = "10 px", height = "20 px", centre = ["15 px", "20 px"] }\n'
    )
    document = measured(part, step, command_line)
    (value,) = [c["value"] for c in document["characteristics"] if c["metric"] == "h"]
    assert value == pytest.approx(25 * NM, abs=READ * NM)
    ridge = (
        0.7 * COLUMN - 0.3 * ROW + 12 * (np.abs(ROW - 20) <= 3)
    ) * NM  # along x: its middle is row 20
    surface = ms.Surface(ridge, *STEPS["none"])
    found = surface.step_height(width="8 px", middle="20 px", axis="y")
    assert found.height == pytest.approx(12 * NM, abs=READ * NM)


def test_a_line_in_px_has_the_length_of_its_pixels_where_they_are_known(part):
    surface = ms.read(part / "part.h5")
    line = surface.section(("10 px", "5 px"), ("22 px", "21 px"))
    dx, dy = surface.dx or 1.0, surface.dy or 1.0
    assert line.x[-1] == pytest.approx(np.hypot(12 * dx, 16 * dy), abs=1e-12 * dx)
    ring = surface.circle_section(("14 px", "24 px"), "7 px")
    t = np.linspace(0.0, 2 * np.pi, 200_001)
    whole = np.hypot(7 * dx * np.diff(np.cos(t)), 7 * dy * np.diff(np.sin(t))).sum()
    last = ring.x[-1] - ring.x[-2]
    # equal angles: only of a circle are the last arc and the missing one alike
    assert ring.x[-1] + last == pytest.approx(whole, abs=0.05 * whole / ring.x.size)


def test_a_limit_in_px_judges_and_one_in_mm_is_refused(part, command_line):
    check = '[[check]]\nmetric = "section.long.lateral"\nupper = "{}"\nU = "0.1 px"\n'
    for upper, verdict in (("13.5 px", "accept"), ("12 px", "reject")):
        document = measured(part, SIZE + SECTIONS + check.format(upper), command_line)
        assert document["verdict"] == verdict
    (part / "r.toml").write_text(HEAD + SIZE + SECTIONS + check.format("1 mm"))
    done = command_line(part, "run", "r.toml", "part.h5", "-o", "out")
    assert done.returncode == 2
    assert (
        'upper is a length, but section.long.lateral is in px; write it with its unit, such as upper = "120 px"'
        in done.stderr
    )


UNKNOWN = (
    "is given in a unit of length, and the file does not say how large a pixel of the map is: write it in "
    'pixels, such as {}, or give lateral_step = "3 um" where the file is read'
)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            '[[step]]\nop = "mask"\naperture = { shape = "circle", diameter = "1 mm" }\n' + SIZE,
            "diameter of the aperture " + UNKNOWN.format('diameter = "120 px"'),
        ),
        (
            SIZE
            + '[[section]]\nkind = "line"\nname = "one"\na = "1 mm, 1 mm"\nb = "2 mm, 1 mm"\n',
            'section "one" ' + UNKNOWN.format('a = "120 px, 30 px"'),
        ),
    ],
)
def test_mm_on_a_map_without_scale_names_both_ways_out(tmp_path, command_line, text, said):
    ms.write(ms.Surface(heights()), tmp_path / "part.h5")
    (tmp_path / "r.toml").write_text(HEAD + text)
    done = command_line(tmp_path, "run", "r.toml", "part.h5", "-o", "out")
    assert done.returncode == 2
    assert said in " ".join(done.stderr.split())


MIXED = {
    "mask": '[[step]]\nop = "mask"\naperture = { shape = "circle", diameter = "20 px", centre = ["1 mm", "1 mm"] }\n',
    "section": '[[section]]\nkind = "distance"\nname = "d"\na = "1 mm, 1 mm"\nb = "20 px, 10 px"\n',
    "groove": '[[step]]\nop = "step_height"\nwidth = "20 px"\nmiddle = "1 mm"\n',
}


@pytest.mark.parametrize("kind", MIXED)
def test_px_and_mm_in_one_shape_are_refused_before_data_are_read(kind):
    with pytest.raises(
        RecipeError, match="write all of them in px, as a map without scale needs, or none"
    ):
        ms.Recipe.parse(HEAD + SIZE + MIXED[kind])


def test_px_of_a_form_a_filter_or_a_profile_are_refused(tmp_path):
    for text in (
        '[[step]]\nop = "filter"\nlambda_c = "20 px"\n',
        '[[step]]\nop = "form"\nform = "plane"\ncentre = ["20 px", "3 px"]\n',
    ):
        with pytest.raises(
            RecipeError, match="counts pixels of a map, as only what is drawn on it may"
        ):
            ms.Recipe.parse(HEAD + text)
    profile = ms.Profile(np.arange(90) * UM, np.zeros(90))
    with pytest.raises(DataError, match="px are pixels of a map, and this is a profile"):
        profile.mask("rectangle", width="20 px", centre=["40 px"])
    with pytest.raises(DataError, match="px are pixels of a map, and this is a profile"):
        profile.step_height(width="20 px", middle="40 px")


def test_px_keep_their_unit_in_every_record_of_what_was_done(part, command_line):
    """A number in a result or a history is in SI: a width of 20 px was one of 20 m there."""
    step = '[[step]]\nop = "step_height"\nwidth = "20 px"\nmiddle = "30 px"\n'
    document = measured(part, step, command_line)
    done = next(s for s in document["provenance"] if s["step"] == "step_height")
    assert done["parameters"] == {"width": "20 px", "middle": "30 px"}
    stage = run_steps(
        ms.Surface(heights()), [{"op": "step_height", "width": "20 px", "middle": "30 px"}]
    )
    assert stage[0].history[0].parameters == {"width": "20 px", "middle": "30 px"}


def test_pixels_behind_a_filter_that_cuts_the_rim_off_are_refused():
    cut = '[[step]]\nop = "filter"\ncutoff = "20 um"\nend = "cut"\n'
    mask = f'[[step]]\nop = "mask"\naperture = {{ {MASKS["circle"][0]} }}\n'
    from metrosep.recipe.pipeline_run import measure_object
    from metrosep.recipe.preflight import limit_errors

    surface = ms.Surface(heights(), 4 * UM, 5 * UM)

    def errors(*parts):
        recipe = ms.Recipe.parse(HEAD + "".join(parts))
        try:
            measure_object(recipe, surface)
        except MetrosepError as exc:
            return [str(exc), *map(str, limit_errors(recipe))]
        return list(map(str, limit_errors(recipe)))

    assert errors(mask, cut, SIZE) == []
    off = cut + "enabled = false\n"
    assert errors(off, mask, SIZE) == []
    for text in ((cut, mask, SIZE), (cut, SIZE, SECTIONS)):
        one, two, *_ = errors(*text)  # of Python, of `metrosep run` and `check`
        assert one.split(": ")[0] == two.split(": ")[0]  # file and line
        for said in (one, two):
            assert "px are pixels of the map as it was read, and step 1 (filter) cuts" in said


def test_a_plane_is_removed_over_pixels_and_says_nothing_of_its_inclination(
    tmp_path, command_line
):
    rng = np.random.default_rng(3)
    z = (4.0 * COLUMN - 9.0 * ROW + rng.standard_normal(SHAPE)) * NM
    z[5:9, 50:] = np.nan
    ms.write(ms.Surface(z), tmp_path / "part.h5")
    form = '[[step]]\nop = "form"\nform = "plane"\n[[step]]\nop = "parameters"\nnames = ["Sq"]\n'
    document = measured(tmp_path, form, command_line)

    known = ~np.isnan(z)
    basis = np.stack([np.ones(known.sum()), COLUMN[known], ROW[known]], axis=1)
    left = z[known] - basis @ np.linalg.lstsq(basis, z[known], rcond=None)[0]
    found = {c["metric"]: c["value"] for c in document["characteristics"]}
    assert found["Sq"] == pytest.approx(left.std(), abs=EXACT)
    assert found.keys() == {"Sq", "residual.pv", "residual.rms"}  # no tilt in rad
    assert any("its inclination is not known" in m for m in document["messages"])
    assert not any("No form removal" in m for m in document["messages"])
    done = command_line(tmp_path, "form", "part.h5", "--residual", "left.h5")
    assert done.returncode == 0, done.stderr
    assert "inclination is not known" in done.stdout
    assert np.nanmax(np.abs(ms.read(tmp_path / "left.h5").z[known] - left)) <= EXACT
    done = command_line(tmp_path, "form", "part.h5", "--json")
    summary = json.loads(done.stdout)
    assert summary["rms_nm"] == pytest.approx(left.std() / NM, abs=EXACT / NM)
    assert (summary["parameters"], summary["over"]) == ({}, "px")
    done = command_line(tmp_path, "form", "part.h5", "--form", "sphere: R=50 mm")
    assert done.returncode == 2
    assert "only a plane or a polynomial can be taken off without one" in done.stderr
    assert "--lateral-step" in done.stderr


POLYNOMIALS = ("plane", "polynomial: degree=3", "polynomial: degree=2, basis=legendre")


@pytest.mark.parametrize("form", POLYNOMIALS)
def test_what_a_plane_or_a_polynomial_leaves_is_that_of_the_scaled_map(form):
    rng = np.random.default_rng(4)
    z = (4.0 * COLUMN - 9.0 * ROW + 1e-2 * ROW * COLUMN + rng.standard_normal(SHAPE)) * NM
    z[5:9, 50:] = np.nan
    plain, scaled = ms.Surface(z), ms.Surface(z, 2 * UM, 3 * UM)
    for removed in (lambda s: s.remove_form(form), lambda s: ms.forms.remove(s, form)):
        left = removed(plain)
        assert (left.dx, left.dy) == (None, None)
        assert np.nanmax(np.abs(left.z - removed(scaled).z)) <= EXACT
        step = left.history[-1]
        assert step.parameters["over"] == "px"
        assert not {"c_1_0", "tilt_x"} & set(step.parameters)  # no value per metre
    assert np.nanmax(np.abs(plain.level().z - scaled.level().z)) <= EXACT


@pytest.mark.parametrize(
    ("form", "options", "said"),
    [
        ("sphere: R=1 m", {}, "only a plane or a polynomial can be taken off without one"),
        ("plane", {"direction": "normal"}, 'take "vertical"'),
        ("plane", {"centre": (1e-3, 0.0)}, "centre is a length, and the file does not say"),
        ("polynomial: degree=2", {"tilt": "rotation"}, 'take tilt "plane"'),
        (
            "polynomial: degree=2",
            {"fixed": {"c_2_0": 3.0}},
            "c_2_0 is fixed at a value other than",
        ),
    ],
)
def test_a_form_that_needs_a_scale_says_so_where_there_is_none(form, options, said):
    with pytest.raises(DataError, match=said):
        ms.Surface(7.0 * NM * ROW + 0.0 * COLUMN).remove_form(form, **options)


def test_an_angle_is_not_held_where_pixels_have_no_size(tmp_path, command_line):
    """1 urad was taken off as 1 um per pixel; an angle of zero is one whatever the size is."""
    z = 7.0 * NM * ROW + 0.0 * COLUMN
    ms.write(ms.Surface(z), tmp_path / "part.h5")
    text = (
        HEAD
        + '[[step]]\nop = "form"\nform = "plane"\nfix = {{ tilt_x = "{}" }}\n'
        + '[[step]]\nop = "parameters"\nnames = ["Sz"]\n'
    )
    (tmp_path / "r.toml").write_text(text.format("1 urad"))
    done = command_line(tmp_path, "run", "r.toml", "part.h5", "-o", "out")
    assert done.returncode == 2
    assert "tilt_x is fixed at an angle other than zero, and the file does not say" in " ".join(
        done.stderr.split()
    )

    (tmp_path / "r.toml").write_text(text.format("0 rad"))
    done = command_line(tmp_path, "run", "r.toml", "part.h5", "-o", "out")
    assert done.returncode == 0, done.stderr
    assert "Sz: 0 m" in done.stdout + done.stderr
