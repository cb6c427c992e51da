"""Groove depth of ISO 5436-1: values worked out by other code, planted asymmetries, drawn scatter."""

import numpy as np
import pytest

from metrosep import Profile, Surface
from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.parameters import step_height

UM = 1e-6


def groove(shift=0.0):
    """Flat bottom with sloped edges, 1 um deep, on a tilt with a wave, in um."""
    x = np.arange(-300, 301) * 0.5
    f = np.clip((np.abs(x - shift) - 42) / 8, 0, 1)
    z = 0.002 * x + 0.3 - (1 - f) + 0.01 * np.sin(2 * np.pi * x / 23 + 0.4)
    return x, z


def test_flat_bottom():
    x, z = groove()
    found = step_height(Profile(x * UM, z * UM), width="100 um")
    assert found.n_used == 335
    assert found.height == pytest.approx(-1.00094578 * UM, rel=1e-8, abs=0.0)
    assert found.depth == -found.height
    assert found.slope == pytest.approx(0.002, rel=0.01, abs=0.0)
    assert found.to_quantity().symbol == "d"
    # The wave of 10 nm moves the bottom by its mean over 33 um.
    assert abs(found.depth - UM) < 3 * found.u


def test_round_bottom():
    x = np.arange(-360, 361) * 0.5
    z = 0.002 * x + 0.01 * np.sin(2 * np.pi * x / 23 + 0.4)
    z -= np.where(np.abs(x) < 60, 1.2 * (1 - (x / 60) ** 2), 0.0)
    found = step_height(Profile(x * UM, z * UM), width=120 * UM, kind="A2")
    assert found.height == pytest.approx(-1.19982290 * UM, rel=1e-8, abs=0.0)
    assert abs(found.depth - 1.2 * UM) < 3 * found.u


def test_ridges_are_positive_and_the_middle_moves_with_the_groove():
    x, z = groove()
    ridge = step_height(Profile(x * UM, -z * UM), width=100 * UM)
    assert ridge.height == pytest.approx(1.00094578 * UM, rel=1e-8, abs=0.0)
    moved = step_height(Profile((x + 1e4) * UM, z * UM), width=100 * UM, middle="10 mm")
    assert moved.height == pytest.approx(-1.00094578 * UM, rel=1e-6, abs=0.0)
    wrong = step_height(Profile(x * UM, z * UM), width=100 * UM, middle=40 * UM)
    assert abs(wrong.height + UM) > 0.01 * UM


def test_a_map_is_cut_across_the_groove():
    x, z = groove()
    rows = np.tile(z, (40, 1)) * UM
    rows[5, 300] = np.nan
    surface = Surface(rows, 0.5 * UM, 2 * UM, origin=(x[0] * UM, 0.0))
    turned = Surface(rows.T, 2 * UM, 0.5 * UM, origin=(0.0, x[0] * UM))
    along_x = step_height(surface, width=100 * UM)
    along_y = step_height(turned, width=100 * UM, axis="y")
    assert along_x.height == pytest.approx(-1.00094578 * UM, rel=1e-5, abs=0.0)
    assert along_y.height == pytest.approx(along_x.height, rel=1e-12, abs=0.0)


def test_u_is_the_scatter_of_noisy_grooves():
    x = np.arange(-300, 301) * 0.5
    clean = np.where(np.abs(x) < 46, -1.0, 0.0)
    found = []
    for seed in range(60):
        noise = np.convolve(
            np.random.default_rng(seed).standard_normal(620), np.ones(20) / 20, "valid"
        )
        found.append(step_height(Profile(x * UM, (clean + 0.02 * noise) * UM), width=100 * UM))
    pull = np.array([(f.height + UM) / f.u for f in found])
    assert 0.5 < np.sqrt(np.mean(pull**2)) < 1.6


def test_what_is_no_groove_is_refused():
    x, z = groove()
    profile = Profile(x * UM, z * UM)
    with pytest.raises(TooFewSamplesError, match="left face of the groove holds 0"):
        step_height(profile, width=100 * UM, middle=-149 * UM)
    with pytest.raises(TooFewSamplesError, match="bottom"):
        step_height(profile, width=100 * UM, middle=1.0)
    with pytest.raises(DataError, match="width"):
        step_height(profile, width=-1.0)
    with pytest.raises(DataError, match="kind"):
        step_height(profile, width=100 * UM, kind="A3")
    with pytest.raises(DataError, match="lateral_step"):
        step_height(Surface(np.zeros((9, 9))), width=100 * UM)


def made_groove(more):
    """The groove of 0.734 um of the specification, on a tilt, and what is added to it (m)."""
    x = np.arange(0, 500.25, 0.25) * UM
    z = (
        np.where(np.abs(x - 250 * UM) < 50 * UM, -0.734 * UM, 0.0)
        + 1.5e-3 * (x - 250 * UM)
        + 40e-9
    )
    return Profile(x, z + more(x))


def test_a_bow_of_the_faces_shifts_the_depth_by_its_closed_form_and_degree_2_removes_it():
    bowed = made_groove(lambda x: 2.0 * (x - 250 * UM) ** 2)
    straight = step_height(bowed, width="100 um", middle="250 um")
    assert straight.n_used == 267 + 133 + 267
    assert straight.height == pytest.approx(-0.761819458 * UM, abs=1e-15)
    # 25/18 kappa W^2 of a continuous groove, the samples shift it by 0.2 %
    assert straight.bow == pytest.approx(-25 / 18 * 2.0 * (100 * UM) ** 2, abs=1e-10)
    assert any("degree = 2" in m for m in straight.messages)
    curved = step_height(bowed, width="100 um", middle="250 um", degree=2)
    assert curved.height == pytest.approx(-0.734 * UM, abs=1e-15)
    assert (curved.bow, curved.messages) == (0.0, ())


def test_a_wave_is_no_bow():
    found = step_height(
        made_groove(lambda x: 2e-9 * np.sin(2 * np.pi * x / (7 * UM))),
        width="100 um",
        middle="250 um",
    )
    assert found.height == pytest.approx(-0.734064466 * UM, abs=1e-15)
    assert found.messages == ()


def test_a_round_bottom_between_bowed_faces_keeps_its_depth():
    x = np.arange(-720, 721) * 0.25 * UM
    z = 3.0 * x**2 - np.where(np.abs(x) < 60 * UM, 1.2 * UM * (1 - (x / (60 * UM)) ** 2), 0.0)
    found = step_height(Profile(x, z), width="120 um", kind="A2", degree=2)
    assert found.height == pytest.approx(-1.2 * UM, abs=1e-14)


def stairs():
    """Columns from 40 on are 25.4 nm higher, on a tilt in both directions, with a wave along y."""
    j, i = np.mgrid[0:60, 0:80]
    z = 2e-10 * i - 1e-10 * j + 25.4e-9 * (i >= 40) + 1e-9 * np.sin(2 * np.pi * j / 11)
    return Surface(z, UM, UM), (i >= 50) & (i <= 69), (i >= 10) & (i <= 29)


def test_two_regions_are_compared_on_one_plane():
    surface, upper, lower = stairs()
    found = step_height(surface, upper=upper, lower=lower)
    assert found.height == pytest.approx(25.4e-9, abs=1e-18)
    # the difference of the two means is what the tilt adds as well
    assert np.mean(surface.z[upper]) - np.mean(surface.z[lower]) == pytest.approx(
        33.4e-9, abs=1e-18
    )
    assert found.slope == pytest.approx(np.hypot(2e-4, 1e-4), abs=1e-6)
    assert step_height(surface, upper=lower, lower=upper).height == pytest.approx(
        -25.4e-9, abs=1e-18
    )
    assert surface.step_height(upper=upper, lower=lower).height == found.height
    # white noise of that size would give 0.10 nm; the wave hangs together along x
    assert found.u > 0.104289871e-9


def test_regions_have_the_words_of_an_aperture_and_stand_where_the_map_says():
    surface, upper, lower = stairs()
    moved = Surface(surface.z, UM, UM, origin=(1e-3, -2e-3))
    frame = {"shape": "rectangle", "width": "20 um", "height": "60 um"}
    found = step_height(
        moved,
        upper={**frame, "centre": ("1.0595 mm", "-1.9705 mm")},
        lower={**frame, "centre": "1.0195 mm, -1.9705 mm"},
    )
    assert found.height == pytest.approx(25.4e-9, abs=1e-18)
    assert found.n_used == np.count_nonzero(upper | lower)


def test_a_bowl_under_two_regions_is_taken_out_by_degree_2():
    surface, upper, lower = stairs()
    upper[:, 42:50] = True  # of equal widths, a bowl would not matter
    j, i = np.mgrid[0:60, 0:80] * UM
    bowl = Surface(surface.z + 5.0 * (i - 30 * UM) ** 2 + 2.0 * i * j, UM, UM)
    assert abs(step_height(bowl, upper=upper, lower=lower).height - 25.4e-9) > 1e-10
    found = step_height(bowl, upper=upper, lower=lower, degree=2)
    assert found.height == pytest.approx(25.4e-9, abs=1e-9)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({}, "width of a groove, or two regions"),
        ({"width": "9 um", "upper": np.ones((60, 80), bool)}, "width of a groove, or two regions"),
        ({"upper": np.ones((60, 80), bool)}, "upper and lower"),
        ({"upper": np.ones((3, 3), bool), "lower": np.ones((60, 80), bool)}, r"shape \(60, 80\)"),
        ({"upper": np.ones((60, 80), bool), "lower": np.ones((60, 80), bool)}, "overlap"),
        ({"upper": {"shape": "circle", "diameter": "9 um"}, "lower": np.ones((60, 80), bool)}, "its centre"),
        ({"width": "9 um", "degree": 3}, "degree of the faces is 1 or 2"),
        ({"width": "9 um", "degree": True}, "degree of the faces is 1 or 2"),
    ],
)  # fmt: skip
def test_what_is_missing_or_twice_is_refused(options, says):
    with pytest.raises(DataError, match=says):
        step_height(stairs()[0], **options)


def test_a_region_that_was_not_measured_is_named():
    surface, upper, lower = stairs()
    z = surface.z.copy()
    z[lower] = np.nan
    with pytest.raises(TooFewSamplesError, match="region lower holds 0 valid pixels"):
        step_height(Surface(z, UM, UM), upper=upper, lower=lower)


def test_regions_through_the_recipe(tmp_path):
    from metrosep import write
    from metrosep.core.errors import RecipeError
    from metrosep.recipe import Recipe

    write(stairs()[0], tmp_path / "step.x3p")
    frame = 'shape = "rectangle", width = "20 um", height = "60 um", centre = '
    text = f"""metrosep = 1
[input]
files = ["step.x3p"]
[[step]]
op = "step_height"
upper = {{ {frame} ["59.5 um", "29.5 um"] }}
lower = {{ {frame} ["19.5 um", "29.5 um"] }}
[[check]]
metric = "h"
lower = "25 nm"
upper = "26 nm"
U = "from fit"
"""
    document = Recipe.parse(text, folder=tmp_path).run().document
    (height,) = (c for c in document["characteristics"] if c["symbol"] == "h")
    assert height["value"] == pytest.approx(25.4e-9, abs=1e-17)
    assert document["verdict"] == "accept"
    for wrong, other in (("upper", "lower"), ("lower", "upper")):
        lines = [line for line in text.splitlines() if not line.startswith(f"{wrong} = {{")]
        with pytest.raises(RecipeError, match=f'needs the key "{wrong}" beside {other}'):
            Recipe.parse("\n".join(lines), folder=tmp_path)
    with pytest.raises(RecipeError, match="one of them"):
        Recipe.parse(text.replace("upper = {", 'width = "9 um"\nupper = {'), folder=tmp_path)
