"""Tables ``[[section]]`` of a recipe: their numbers, what a check makes of them, and wrong input."""

import json

import numpy as np
import pytest

import metrosep as ms
from metrosep.core.errors import RecipeError, TooFewSamplesError

UM, NM = 1e-6, 1e-9
STEP = 10 * UM
READ = 1e-5
"""Relative, of what is interpolated between pixels."""

HEAD = """metrosep = 1
[input]
files = ["part.x3p"]
[[step]]
op = "parameters"
names = ["Sq"]
"""
SECTIONS = """[[section]]
kind = "line"
name = "across"
a = "0.2 mm, 0.5 mm"
b = "1.8 mm, 0.5 mm"
width = "50 um"
[[section]]
kind = "circle"
name = "rim"
centre = "1 mm, 0.8 mm"
radius = "0.6 mm"
harmonics = [1, 3]
[[section]]
kind = "distance"
name = "holes"
a = ["0.4 mm", "0.3 mm"]
b = ["1.4 mm", "0.9 mm"]
[[section]]
kind = "angle"
name = "corner"
a = "1.2 mm, 0.4 mm"
b = "0.4 mm, 0.4 mm"
c = "0.8 mm, 0.8 mm"
[[section]]
kind = "circle3"
name = "bore"
a = "1 mm, 0.2 mm"
b = "1.5 mm, 0.7 mm"
c = "1 mm, 1.2 mm"
"""


def heights():
    """Return a tilted map; the tilts differ and have opposite signs."""
    y, x = np.mgrid[:160, :200] * STEP
    return 3e-4 * x - 1e-4 * y


@pytest.fixture
def folder(tmp_path):
    ms.write(ms.Surface(heights(), STEP, STEP), tmp_path / "part.x3p")
    return tmp_path


def values(folder, text=HEAD + SECTIONS):
    (folder / "r.toml").write_text(text)
    result = ms.Recipe.load(folder / "r.toml").run(folder / "part.x3p")
    return {e["metric"]: e for e in result.document["characteristics"]}, result.document


def test_the_numbers_of_all_kinds(folder):
    found, document = values(folder)

    def of(name):
        return found[f"section.{name}"]["value"]

    assert of("across.Pt") == pytest.approx(3e-4 * 1.6e-3, abs=480 * NM * READ)
    assert of("rim.Pt") == pytest.approx(2 * 0.6e-3 * np.hypot(3e-4, 1e-4), abs=1 * NM)
    assert of("rim.harmonic_1") == pytest.approx(
        0.6e-3 * np.hypot(3e-4, 1e-4), abs=190 * NM * READ
    )
    assert of("rim.harmonic_3") == pytest.approx(0.0, abs=190 * NM * READ)
    dz = 3e-4 * 1e-3 - 1e-4 * 0.6e-3
    assert of("holes.height") == pytest.approx(dz, abs=240 * NM * READ)  # b lies higher
    assert of("holes.lateral") == pytest.approx(np.hypot(1e-3, 0.6e-3), abs=1e-15)
    assert of("holes.azimuth") == pytest.approx(np.arctan2(0.6, 1.0), abs=1e-12)
    assert of("holes.slope") == pytest.approx(np.arctan2(dz, np.hypot(1e-3, 0.6e-3)), abs=1e-9)
    assert of("corner.angle") == pytest.approx(np.pi / 4, abs=1e-12)
    assert of("bore.diameter") == pytest.approx(1e-3, abs=1e-15)
    assert of("bore.x") == pytest.approx(1e-3, abs=1e-15)
    assert of("bore.y") == pytest.approx(0.7e-3, abs=1e-15)
    assert found["section.corner.angle"]["unit"] == "rad"
    charts = [c["title"] for c in document["separation"]["charts"]]
    assert "Section across" in charts
    assert "Section rim" in charts
    assert any("mean of 5 lines across 50 um" in m for m in document["messages"])


CHECK = '[[check]]\nmetric = "{}"\nupper = "{}"\nU = "1 nm"\n'


@pytest.fixture
def run(command_line, folder):
    def of(text, command):
        (folder / "r.toml").write_text(text)
        return command_line(folder, *command)

    return of


@pytest.mark.parametrize(("upper", "code"), [("500 nm", 0), ("400 nm", 1)])
def test_a_check_judges_a_section_from_the_command_line(folder, run, upper, code):
    text = HEAD + SECTIONS + CHECK.format("section.across.Pt", upper)
    done = run(text, ["run", "r.toml", "part.x3p", "-o", "out"])
    assert done.returncode == code, done.stderr
    document = json.loads((folder / "out" / "result.json").read_text())
    named = [s["name"] for s in document["separation"]["sections"]]
    assert named == ["across", "rim", "holes", "corner", "bore"]


@pytest.mark.parametrize(
    ("metric", "upper", "said"),
    [
        ("section.acros.Pt", "1 um", 'did you mean "section.across.Pt"'),
        ("section.rim.harmonic_2", "1 um", "made by no step"),
        ("section.corner.angle", "1 um", "is a length"),
    ],
)
def test_check_refuses_what_no_section_makes(run, metric, upper, said):
    done = run(HEAD + SECTIONS + CHECK.format(metric, upper), ["check", "r.toml"])
    assert done.returncode == 2
    assert said in done.stdout + done.stderr


def test_a_section_is_set_from_the_command_line(folder):
    (folder / "r.toml").write_text(HEAD + SECTIONS)
    recipe = ms.Recipe.load(folder / "r.toml", overrides=["section.rim.radius=0.3 mm"])
    assert recipe.sections[1]["radius"] == 0.3e-3


LINE = '[[section]]\nkind = "line"\nname = "{}"\na = "{}"\nb = "{}"\n'


@pytest.mark.parametrize(
    ("text", "line", "match"),
    [
        (LINE.format("s", "1 mm, 1 mm", "1 mm, 1 mm"), 11, "same point"),
        (LINE.format("a b", "0 mm, 0 mm", "1 mm, 1 mm"), 9, "begin with a letter"),
        (LINE.format("s", "0 mm, 0", "1 mm, 1 mm"), 10, "unit"),
        (LINE.format("s", "0 mm", "1 mm, 1 mm"), 10, "x and y"),
        (LINE.format("s", "0 mm, 0 mm", "1 mm, 1 mm") * 2, 14, "two sections"),
        ('[[section]]\nkind = "spiral"\nname = "s"\n', 8, "line"),
        ('[[section]]\nkind = "circle"\nname = "s"\ncentre = "0 mm, 0 mm"\n', 7, "radius"),
        (
            LINE.format("s", "0 mm, 0 mm", "1 mm, 1 mm").replace("line", "circle3")
            + 'c = "2 mm, 2 mm"\n', 11, "one line",
        ),
    ],
)  # fmt: skip
def test_what_is_no_section_is_refused_with_its_line(text, line, match):
    with pytest.raises(RecipeError, match=match) as caught:
        ms.Recipe.parse(HEAD + text)
    assert caught.value.line == line


def test_sections_go_with_maps_only(folder):
    runs = 'metrosep = 1\n[input]\nx = "x"\nz = "z"\n[[step]]\nop = "separate"\n'
    with pytest.raises(RecipeError, match="goes with steps that measure"):
        ms.Recipe.parse(runs + LINE.format("s", "0 mm, 0 mm", "1 mm, 1 mm"))
    x = np.arange(200) * 1e-5
    ms.write(ms.Profile(x, 1e-9 * np.sin(x * 1e4)), folder / "line.csv")
    text = HEAD.replace('"Sq"', '"Pq"').replace("part.x3p", "line.csv")
    recipe = ms.Recipe.parse(text + LINE.format("s", "0 mm, 0 mm", "1 mm, 1 mm"))
    with pytest.raises(RecipeError, match="this is a profile"):
        recipe.run(folder / "line.csv")


def test_a_section_beside_the_map_is_an_error_and_one_partly_on_it_says_the_share(folder):
    with pytest.raises(TooFewSamplesError, match=r"r\.toml:9: .*wholly outside"):
        values(folder, HEAD + LINE.format("s", "5 mm, 5 mm", "6 mm, 6 mm"))
    found, document = values(folder, HEAD + LINE.format("s", "1 mm, 1 mm", "3 mm, 1 mm"))
    assert any("section s: 50.2 %" in m for m in document["messages"])
    assert found["section.s.Pt"]["value"] == pytest.approx(3e-4 * 0.99e-3, abs=0.1 * NM)


@pytest.mark.parametrize("upper", ["1 mm", "1 nm"])
@pytest.mark.parametrize("metric", ["Pt", "Pq"])
def test_no_check_of_a_section_that_was_measured_in_part_is_decided(folder, run, metric, upper):
    mostly_beside = LINE.format("s", "1.9 mm, 1 mm", "9 mm, 1 mm")
    text = HEAD + mostly_beside + CHECK.format(f"section.s.{metric}", upper)
    done = run(text, ["run", "r.toml", "part.x3p", "-o", "out"])
    assert done.returncode == 3, done.stderr
    document = json.loads((folder / "out" / "result.json").read_text())
    (entry,) = [e for e in document["characteristics"] if e["verdict"] is not None]
    assert entry["verdict"] == document["verdict"] == "inconclusive"
    assert "98.6 % of section s was not measured" in entry["reason"]
    assert "98.6 % of section s was not measured" in done.stdout + done.stderr


def test_one_gap_makes_a_circle_inconclusive_and_no_other_section(folder):
    z = heights()
    z[80, 160] = np.nan  # where the circle begins: 1.6 mm, 0.8 mm
    ms.write(ms.Surface(z, STEP, STEP), folder / "part.x3p")
    checks = "".join(CHECK.format(f"section.{s}.Pt", "1 mm") for s in ("rim", "across"))
    found, document = values(folder, HEAD + SECTIONS.replace("harmonics = [1, 3]\n", "") + checks)
    assert found["section.rim.Pt"]["verdict"] == document["verdict"] == "inconclusive"
    assert "section rim" in found["section.rim.Pt"]["reason"]
    assert found["section.across.Pt"]["verdict"] == "accept"
    assert "reason" not in found["section.across.Pt"]


def test_a_gap_in_a_circle_with_harmonics_is_of_the_data(folder, run):
    z = heights()
    z[80, 160] = np.nan
    ms.write(ms.Surface(z, STEP, STEP), folder / "part.x3p")
    done = run(HEAD + SECTIONS, ["run", "r.toml", "part.x3p", "-o", "out"])
    assert done.returncode == 4, done.stderr
    assert "r.toml:15: the circle has gaps" in done.stderr


def test_a_distance_over_a_hole_keeps_what_is_known_in_the_plane(folder):
    z = heights()
    z[25:35, 35:45] = np.nan
    ms.write(ms.Surface(z, STEP, STEP), folder / "part.x3p")
    found, document = values(folder)
    assert (
        found["section.holes.height"]["value"] is None
    )  # a check of it is inconclusive, not refused
    assert found["section.holes.lateral"]["value"] is not None
    assert any("height at a was not measured" in m for m in document["messages"])


def test_the_same_from_python():
    surface = ms.Surface(heights(), STEP, STEP)
    cut = surface.section(("0.2 mm", "0.5 mm"), ("1.8 mm", "0.5 mm"), width="50 um")
    assert np.ptp(cut.z) == pytest.approx(3e-4 * 1.6e-3, abs=480 * NM * READ)
    assert len(surface.circle_section(("1 mm", "0.8 mm"), "0.6 mm")) == 377
    kept = surface.mask("polygon", points=["0 mm, 0 mm", "1 mm, 0 mm", "1 mm, 0.5 mm"])
    assert kept.n_invalid < kept.z.size
    rest = surface.mask("polygon", outside=False, points=[(0.0, 0.0), (1e-3, 0.0), (1e-3, 0.5e-3)])
    np.testing.assert_array_equal(np.isnan(kept.z), ~np.isnan(rest.z))
