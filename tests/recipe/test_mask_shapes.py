"""Regions of a mask: pixel counts that were computed without metrosep, rims, and wrong input."""

import numpy as np
import pytest

import metrosep as ms
from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.recipe.pipeline import run_steps
from metrosep.recipe.pipeline_checks import StepError

UM = 1e-6
GRID = (200, 300)
"""Rows and columns; 2 um along x and 1 um along y, so that the axes cannot be mixed up."""

COUNTS = {
    "circle": (
        {"shape": "circle", "diameter": "150 um", "centre": ["300 um", "90 um"]}, 8841,
    ),
    "rectangle, turned": (
        {"shape": "rectangle", "width": "200 um", "height": "60 um",
         "centre": ["250 um", "100 um"], "angle": "20 deg"}, 6003,
    ),
    "polygon": (
        {"shape": "polygon", "points": [
            "60.5 um, 20.25 um", "420.5 um, 10.25 um", "500.5 um, 150.25 um", "260.5 um, 80.25 um",
            "100.5 um, 180.25 um"]}, 20320,
    ),
    "bow tie": (
        {"shape": "polygon", "points": [
            "50.3 um, 50.4 um", "150.3 um, 150.4 um", "50.3 um, 150.4 um", "150.3 um, 50.4 um"]}, 2500,
    ),
    "brush": (
        {"shape": "brush", "radius": "12 um", "points": ["100 um, 50 um", "300 um, 120 um"]}, 2771,
    ),
}  # fmt: skip
"""From the specification of the workbench, made with numpy alone."""


def flat(origin=(0.0, 0.0)):
    return ms.Surface(np.zeros(GRID), 2 * UM, 1 * UM, origin=origin)


def masked(surface, aperture, *, outside=True):
    return run_steps(surface, [{"op": "mask", "aperture": aperture, "outside": outside}])[-1]


def kept(stage):
    return ~np.isnan(stage.obj.z)


@pytest.mark.parametrize(("aperture", "count"), COUNTS.values(), ids=COUNTS)
def test_so_many_pixels_are_inside(aperture, count):
    inside = masked(flat(), aperture)

    assert kept(inside).sum() == count
    assert inside.audit["left"] == count
    rest = masked(flat(), aperture, outside=False)
    np.testing.assert_array_equal(kept(inside), ~kept(rest))


def crossings(points, x, y):
    """Return whether a point is inside, edge by edge, by hand."""
    odd = False
    for (x1, y1), (x2, y2) in zip(points, [*points[1:], points[0]], strict=True):
        if (y1 <= y < y2 or y2 <= y < y1) and x < x1 + (y - y1) * (x2 - x1) / (y2 - y1):
            odd = not odd
    return odd


def test_a_polygon_agrees_with_a_count_of_crossings_point_by_point():
    rng = np.random.default_rng(11)
    points = [tuple(p) for p in rng.uniform(0.0, 40.0, (9, 2)) * UM]  # crosses itself
    surface = ms.Surface(np.zeros((45, 23)), 2 * UM, 1 * UM, origin=(-3 * UM, -2 * UM))

    found = kept(masked(surface, {"shape": "polygon", "points": points}))

    expected = [
        [crossings(points, -3 * UM + 2 * UM * i, -2 * UM + UM * j) for i in range(23)]
        for j in range(45)
    ]
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("turn", [1, -1])
def test_neighbouring_polygons_share_no_pixel_and_leave_none_out(turn):
    # corners and edges lie on pixels, which is where a rim could count twice
    left = ["0 um, 0 um", "100 um, 0 um", "60 um, 50 um", "100 um, 100 um", "0 um, 100 um"]
    right = ["100 um, 0 um", "200 um, 0 um", "200 um, 100 um", "100 um, 100 um", "60 um, 50 um"]
    both = ["0 um, 0 um", "200 um, 0 um", "200 um, 100 um", "0 um, 100 um"]

    parts = [
        kept(masked(flat(), {"shape": "polygon", "points": p[::turn]}))
        for p in (left, right, both)
    ]

    assert not (parts[0] & parts[1]).any()
    np.testing.assert_array_equal(parts[0] | parts[1], parts[2])


def test_a_rectangle_turns_from_x_to_y():
    bar = {
        "shape": "rectangle",
        "width": "100 um",
        "height": "3 um",
        "centre": ["200 um", "90 um"],
    }

    found = kept(masked(flat(), {**bar, "angle": "30 deg"}))

    j, i = np.nonzero(found)
    assert found[90 + 20, 100 + 17]  # 35 um, 20 um: along 30 degrees
    assert np.polyfit(2.0 * i, j, 1)[0] == pytest.approx(np.tan(np.pi / 6), abs=0.02)  # in pixels


def test_a_brush_of_one_point_is_a_circle():
    dot = masked(flat(), {"shape": "brush", "radius": "12 um", "points": ["100 um, 50 um"]})
    disc = masked(flat(), {"shape": "circle", "diameter": "24 um", "centre": ["100 um", "50 um"]})
    np.testing.assert_array_equal(kept(dot), kept(disc))


def test_the_origin_moves_what_is_drawn():
    polygon = COUNTS["polygon"][0]
    moved = flat(origin=(40 * UM, 0.0))
    here, there = kept(masked(flat(), polygon)), kept(masked(moved, polygon))
    np.testing.assert_array_equal(here[:, 20:], there[:, :-20])


def test_the_message_says_what_was_drawn_and_that_it_crosses_itself():
    tie, polygon = (masked(flat(), COUNTS[k][0]).messages for k in ("bow tie", "polygon"))
    assert "polygon of 4 points" in tie[0]
    assert "crosses itself" in tie[1]
    assert len(polygon) == 1


@pytest.mark.parametrize(
    ("aperture", "match"),
    [
        ({"shape": "polygon"}, "needs points"),
        ({"shape": "polygon", "points": ["0 um, 0 um", "9 um, 0 um"]}, "3 points or more"),
        ({"shape": "polygon", "points": ["0 um, 0 um", "9 um, 9 um", "5 um, 5 um"]}, "one line"),
        ({"shape": "polygon", "points": ["0 um", "9 um", "5 um"]}, "x and y"),
        ({"shape": "polygon", "points": ["0, 0", "9, 9", "5, 1"]}, "unit"),
        ({"shape": "polygon", "points": ["0 um, 0 um, 0 um", "1 um, 2 um"]}, "x and y"),
        ({"shape": "brush", "points": ["0 um, 0 um"]}, "needs radius"),
        ({"shape": "brush", "radius": "0 um", "points": ["0 um, 0 um"]}, "positive"),
        ({"shape": "brush", "radius": "1 um", "points": []}, "list of positions"),
        ({"shape": "circle", "diameter": "1 um", "angle": "5 deg"}, "has no angle"),
        ({"shape": "brush", "radius": "1 um", "points": ["0 um, 0 um"], "centre": "fit"}, "centre"),
    ],
)  # fmt: skip
def test_a_region_that_is_none_is_refused_before_anything_is_read(aperture, match):
    with pytest.raises(StepError, match=match):
        masked(flat(), aperture)


def test_a_polygon_beside_the_map_leaves_nothing_and_says_where_the_data_are():
    far = ["1 mm, 1 mm", "2 mm, 1 mm", "2 mm, 2 mm"]
    with pytest.raises(
        TooFewSamplesError, match=r"polygon of 3 points leaves nothing.*0 to 598 um in x"
    ):
        masked(flat(), {"shape": "polygon", "points": far})


def test_a_profile_takes_no_polygon():
    profile = ms.Profile(np.arange(9) * UM, np.zeros(9))
    with pytest.raises(DataError, match="drawn on a map"):
        masked(profile, COUNTS["polygon"][0])
