"""Steps on previews and on full data: near one another, each computed once, P-V only from full."""

import numpy as np
import pytest

from metrosep import Profile, Surface
from metrosep.app.evaluations import Evaluations
from metrosep.app.sessions import is_extreme
from metrosep.errors import DataError
from metrosep.recipe.pipeline import checked_step

UM, MM = 1e-6, 1e-3


def sphere_map(n_y=700, n_x=900, origin=(0.0, 0.0)):
    """A cap of R = 50 mm about the middle, a bump of +0.5 um at (6, 2) mm, 10 um pixels."""
    x, y = np.meshgrid(np.arange(n_x) * 10 * UM, np.arange(n_y) * 10 * UM)
    r2 = (x - x.max() / 2) ** 2 + (y - y.max() / 2) ** 2
    z = np.sqrt((50 * MM) ** 2 - r2) - 50 * MM
    z += 0.5 * UM * np.exp(-((x - 6 * MM) ** 2 + (y - 2 * MM) ** 2) / (0.3 * MM) ** 2)
    return Surface(z, 10 * UM, 10 * UM, origin=origin)


def steps(*raw):
    return [checked_step(s) for s in raw]


SPHERE = steps({"op": "form", "form": "sphere: R=-50 mm"}, {"op": "parameters", "names": ["Sq"]})


@pytest.mark.parametrize("origin", [(0.0, 0.0), (-6.495 * MM, -5.995 * MM)])
@pytest.mark.parametrize("level", ["drag", "idle"])
def test_a_preview_fits_the_same_form(origin, level):
    """It once fitted about the corner of the map: 11 times the residual, a tilt that is not there."""
    made = Evaluations(sphere_map(1200, 1300, origin=origin))
    full, coarse = made.outcome(SPHERE, "full"), made.outcome(SPHERE, level)

    assert not full.is_preview
    assert coarse.is_preview
    fine, rough = (o.stages[-1].found["Sq"].value for o in (full, coarse))
    assert rough == pytest.approx(fine, rel=0.02, abs=0.0)
    assert fine < 0.1 * UM  # the cap is gone, the bump is left


def test_a_preview_lies_where_the_map_lies():
    made = Evaluations(sphere_map())
    outcome = made.outcome(SPHERE, "drag")
    obj = outcome.after(0)
    row, column = np.unravel_index(np.nanargmax(obj.z), obj.z.shape)
    x = column * obj.dx + obj.origin[0] + outcome.shift[0]
    y = row * obj.dy + obj.origin[1] + outcome.shift[1]

    assert x == pytest.approx(6 * MM, abs=obj.dx)
    assert y == pytest.approx(2 * MM, abs=obj.dy)
    assert outcome.shift[0] == pytest.approx((obj.dx - 10 * UM) / 2, abs=1e-12)


def test_a_change_keeps_what_came_before():
    made = Evaluations(sphere_map())
    first = made.outcome(SPHERE, "full")
    changed = [SPHERE[0], *steps({"op": "parameters", "names": ["Sa"]})]
    second = made.outcome(changed, "full")

    assert second.stages[0] is first.stages[0]
    assert set(second.stages[1].found) == {"Sa"}
    assert made.outcome(SPHERE, "full").stages[0] is first.stages[0]


def test_a_step_that_fails_keeps_those_before_it_and_the_map_before_it_is_shown():
    bad = [SPHERE[0], *steps({"op": "form", "form": "sine-grid"}), SPHERE[1]]
    made = Evaluations(sphere_map())
    outcome = made.outcome(bad, "full")

    assert outcome.failed == 1
    for stage in (0, 1, 2, -1):
        assert outcome.after(stage) is outcome.stages[0].obj
    assert outcome.after(-2) is made.obj


def test_pixels_behind_a_filter_that_cuts_the_rim_off_fail_here_too():
    cut = {"op": "filter", "cutoff": "80 um", "end": "cut"}
    circle = {"shape": "circle", "diameter": "60 px", "centre": ["300 px", "200 px"]}
    mask = {"op": "mask", "aperture": circle}
    made = Evaluations(sphere_map())
    for level in ("idle", "full"):
        outcome = made.outcome(steps(cut, mask), level)
        assert outcome.failed == 1
        assert "px are pixels of the map as it was read, and step 1 (filter)" in str(outcome.error)
        assert made.outcome(steps(mask, cut), level).error is None


def test_small_data_have_no_preview():
    for obj in (Surface(np.zeros((50, 60)), UM, UM), Profile(np.arange(9.0), np.zeros(9))):
        assert Evaluations(obj).source("drag") == (obj, False)


def test_a_level_is_one_of_three():
    with pytest.raises(DataError, match="drag, idle or full"):
        Evaluations(sphere_map()).outcome(SPHERE, "best")


@pytest.mark.parametrize(
    ("symbol", "waits"),
    [("Sz", True), ("PV", True), ("residual.pv", True), ("Rt", True), ("Pz", True), ("Sz#2", True),
     ("Sq", False), ("Sa", False), ("Rq", False), ("R", False), ("residual.rms", False)],
)  # fmt: skip
def test_single_points_wait_for_all_data(symbol, waits):
    assert is_extreme(symbol) is waits


def test_a_map_without_lateral_steps_has_no_preview():
    # a section in pixels of a coarse copy would be another section
    evaluations = Evaluations(Surface(np.zeros((900, 900))))
    for level in ("drag", "idle"):
        obj, is_preview = evaluations.source(level)
        assert obj is evaluations.obj
        assert not is_preview


def test_a_large_map_without_scale_shows_at_once_what_is_known_and_then_the_truth():
    """Its coarse copy would have other pixels: the hand sees the steps that were carried out already."""
    row, column = np.mgrid[:500, :600]
    surface = Surface((3.0 * column - 2.0 * row) * 1e-9)
    made = Evaluations(surface)
    plane, mask = (
        {"op": "form", "form": "plane"},
        {
            "op": "mask",
            "aperture": {"shape": "circle", "diameter": "90 px", "centre": ["70 px", "200 px"]},
        },
    )

    first = made.outcome([plane], "drag")
    assert first.is_preview
    assert first.after(-1) is surface
    assert first.after(0) is surface  # not "there is no step 1"
    full = made.outcome([plane], "full")
    assert not full.is_preview
    assert full.after(-1).peak_to_valley() == 0.0
    assert made.outcome([plane], "drag").after(-1) is full.after(-1)
    assert not made.outcome([plane], "drag").is_preview
    drawn = made.outcome([plane, mask], "drag")
    assert drawn.is_preview
    assert drawn.after(-1) is full.after(-1)
    n = made.outcome([plane, mask], "full").after(-1).n_invalid
    assert n == np.count_nonzero((column - 70) ** 2 + (row - 200) ** 2 > 45**2)
