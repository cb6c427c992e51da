"""Pictures of maps read at a glance: limits from the data, one odd pixel stays, the histogram shows the distribution.

The expected numbers of both maps were computed by a separate program (numpy only) and its check.
"""

import re
from base64 import b64decode
from io import BytesIO

import numpy as np
import pytest
from PIL import Image

import metrosep as ms
from metrosep.recipe import Recipe
from metrosep.recipe.describe.charts import decimated, display_limits, map_chart
from metrosep.recipe.describe.describe_machine import _on_squares
from metrosep.recipe.describe.describe_measure import height_classes
from metrosep.report import render_html

NM = 1e-9
DIGITS = 6e-9
"""Relative to 1 nm: half of the last printed digit of the expected values (9 digits)."""


DRAWN = True
"""The pages are looked at."""


def first_map():
    """A wavy map with one pixel 1.2 um high and a hole at a rim."""
    j, i = np.mgrid[0:480, 0:640]
    z = 3 * NM * np.sin(2 * np.pi * i / 64) * np.cos(2 * np.pi * j / 96)
    z[313, 427] += 1.2e-6
    z[10:20, 600:640] = np.nan
    return z


def second_map():
    """A tilted map, step 2 um, with one pixel 90 nm low and a missing corner."""
    j, i = np.mgrid[0:300, 0:420]
    z = 0.75e-3 + 1.5e-4 * 2e-6 * i
    z = z + 4 * NM * np.sin(2 * np.pi * i / 70) + 2 * NM * np.cos(2 * np.pi * j / 50)
    z[211, 97] -= 90 * NM
    z[:30, :42] = np.nan
    return z


def levelled(z):
    """Return a map without its least-squares plane."""
    j, i = np.mgrid[0 : z.shape[0], 0 : z.shape[1]]
    basis = np.column_stack([np.ones(z.size), i.ravel() / 100.0, j.ravel() / 100.0])
    known = np.isfinite(z.ravel())
    found = np.linalg.lstsq(basis[known], z.ravel()[known] - np.nanmean(z), rcond=None)[0]
    return z - np.nanmean(z) - (basis @ found).reshape(z.shape)


def test_limits_leave_out_what_would_hide_the_rest():
    z = first_map()
    low, high, below, above = display_limits(z - np.nanmean(z))
    assert low == pytest.approx(-2.99041794 * NM, abs=DIGITS * NM)
    assert high == pytest.approx(2.98069042 * NM, abs=DIGITS * NM)
    assert np.nanmean(z) == pytest.approx(4.86376e-12, abs=5e-18)
    assert (below, above) == (300, 301)


def test_a_tilted_map_is_not_clipped_but_its_residual_is():
    z = second_map()
    assert np.nanmean(z) == pytest.approx(750.063405e-6, abs=5e-13)
    low, high, below, above = display_limits(z - np.nanmean(z))
    assert (low / NM, high / NM) == pytest.approx((-121.298367, 63.936558), abs=1e-5)
    assert (below, above) == (0, 0)
    low, high, below, above = display_limits(levelled(z))
    assert (low / NM, high / NM) == pytest.approx((-6.332584, 6.361551), abs=1e-5)
    assert (below, above) == (125, 125)


def test_the_odd_pixel_is_drawn_exactly_and_no_other_one():
    z = first_map()
    shown = decimated(z, 3)
    assert shown.shape == (160, 214)
    assert np.nanmax(shown) == np.nanmax(z)
    assert np.nanmax(np.where(shown == np.nanmax(z), np.nan, shown)) < 3.1 * NM
    assert shown[313 // 3, 427 // 3] == np.nanmax(z)


def test_blocks_at_the_rim_count_their_own_pixels_and_holes_stay():
    z = np.arange(25.0).reshape(5, 5)
    z[0:2, 0:2] = np.nan
    shown = decimated(z, 2)
    assert np.isnan(shown[0, 0])
    assert shown[2, 2] == z[4, 4]
    assert shown[1, 1] == pytest.approx(z[2:4, 2:4].mean(), abs=0.0)


@pytest.mark.parametrize(
    ("z", "low", "high", "classes", "outside"),
    [
        (first_map() - np.nanmean(first_map()), -3.28897336, 3.27924584, 101, (0, 1)),
        (levelled(second_map()), -6.967291, 6.996257, 71, (1, 0)),
    ],
)
def test_the_histogram_shows_the_distribution(z, low, high, classes, outside):
    known = z[np.isfinite(z)]
    edges = height_classes(known)
    assert (edges[0] / NM, edges[-1] / NM) == pytest.approx((low, high), abs=1e-5)
    assert edges.size - 1 == classes
    assert ((known < edges[0]).sum(), (known > edges[-1]).sum()) == outside


def test_a_chart_of_heights_has_no_zero_and_one_of_errors_has():
    z = second_map()
    raw = map_chart("raw", {"": z}, dx=2e-6, dy=2e-6, unit="m", measured=True, side=256)
    low, high = raw["limits"]
    assert -low != high
    assert "Mean 750.1 um subtracted" in raw["caption"]
    assert raw["pv"][""] == pytest.approx(185.235e-9, abs=1e-12)
    left = map_chart("left", {"": levelled(z)}, dx=2e-6, dy=2e-6, unit="m", side=256)
    assert left["limits"][0] == -left["limits"][1]
    assert "125 pixels below, 125 above the scale" in left["caption"]
    assert min(v for row in left["parts"][""] for v in row if v is not None) < -85 * NM


def test_a_chart_of_magnitudes_uses_its_whole_scale():
    z = np.linspace(11.0, 15.0, 41 * 41).reshape(41, 41) * 1e-6
    made = map_chart("size", {"": z}, dx=1e-3, dy=1e-3, unit="m", magnitude=True)
    assert made["limits"] == pytest.approx([11e-6, 15e-6], rel=1e-9, abs=0.0)
    assert made["signed"] is False
    assert "subtracted" not in made["caption"]


def test_the_report_of_a_map_with_a_defect_shows_it(tmp_path):
    z = second_map()
    ms.write(ms.Surface(z, 2e-6, 2e-6), tmp_path / "part.sdf")
    text = 'metrosep = 1\n[input]\n[[step]]\nop = "form"\nform = "plane"\n'
    charts = Recipe.parse(text).run(tmp_path / "part.sdf").document["separation"]["charts"]
    assert [c["signed"] for c in charts if c["kind"] == "maps"] == [False, True]
    sections = next(c for c in charts if c["title"] == "Sections")
    assert any("farthest pixel" in p["title"] for p in sections["panels"])
    lowest = min(v for p in sections["panels"] for v in p["curves"][0]["y"] if v is not None)
    assert lowest < -85 * NM
    histogram = next(c for c in charts if c["title"] == "Distribution of heights")
    assert "1 height below" in histogram["caption"]
    share = histogram["panels"][1]["curves"][0]["y"]
    assert share[0] > 0.999
    assert share[-1] == pytest.approx(0.0, abs=1e-3)


def test_a_defect_of_one_pixel_is_in_the_picture_that_is_printed(tmp_path):
    """The page embeds the map with every pixel that is drawn; it was thinned out again to 195."""
    j, i = np.mgrid[0:482, 0:642]
    z = 3 * NM * np.sin(2 * np.pi * i / 64) * np.cos(2 * np.pi * j / 96)
    z[240, 416] += (
        1.2e-6  # where the waves are zero; its block is the middle row, however the picture is turned
    )
    ms.write(ms.Surface(z, 1e-6, 1e-6), tmp_path / "part.h5")
    text = 'metrosep = 1\n[input]\n[[step]]\nop = "parameters"\nnames = ["Sq"]\n'
    page = render_html(Recipe.parse(text).run(tmp_path / "part.h5").document)

    svgs = [b64decode(s).decode() for s in re.findall(r"svg\+xml;base64,([\w+/=]+)", page)]
    pngs = re.findall(r"data:image/png;base64,\s*([\w+/=\s]+)", "".join(svgs))
    pictures = [np.asarray(Image.open(BytesIO(b64decode(p))).convert("RGB")) for p in pngs]
    (drawn,) = (p for p in pictures if p.shape[1] > 256)
    assert drawn.shape == (241, 321, 3)  # blocks of 2 x 2: 512 pixels or fewer
    brightest = drawn[120, 208].astype(int)
    around = np.delete(drawn[118:123, 206:211].reshape(-1, 3), 12, axis=0).astype(int)
    assert (np.abs(around - brightest).sum(axis=1) > 100).all()


def test_pixels_of_a_map_on_rings_are_the_nearest_ring_and_spoke():
    """Uneven rings, the first spoke off the x axis; each point tells its ring and its spoke."""
    radii, first = np.array([2.0, 2.5, 4.0, 7.0, 7.3]), 0.1
    spokes = first + 2 * np.pi * np.arange(12) / 12
    rho, azimuth = np.meshgrid(radii, spokes, indexing="ij")
    told = 100.0 * np.arange(5)[:, None] + np.arange(12)

    drawn, step = _on_squares(rho, azimuth, told)

    side = len(drawn)
    assert step == pytest.approx(2 * 7.3 / (side - 1), abs=1e-12)
    for j, i in np.ndindex(*(n // 7 for n in drawn.shape)):
        x, y = (7 * k * step - 7.3 for k in (i, j))
        r = float(np.hypot(x, y))
        if not 2.0 <= r <= 7.3:
            assert np.isnan(drawn[7 * j, 7 * i])
            continue
        ring, spoke = divmod(drawn[7 * j, 7 * i], 100.0)
        assert abs(radii[int(ring)] - r) == pytest.approx(np.abs(radii - r).min(), abs=1e-12)
        away = np.angle(np.exp(1j * (np.arctan2(y, x) - spokes[int(spoke)])))
        assert abs(away) <= np.pi / 12 + 1e-9
