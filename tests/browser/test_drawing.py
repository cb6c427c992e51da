"""Every gesture on the map is one edit of the recipe, which means the same to `metrosep run`."""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser.conftest import FULL, STEP, N, chromium
from browser.test_work import choose, printed, settled

from metrosep.recipe.recipe import without_view_block

pytestmark = pytest.mark.browser

Opened = Callable[..., Any]
Place = tuple[float, float]

SHIFT = 8
"""As the protocol of Chromium names the key."""

PIXEL = 1.5
"""Of the screen: a drag ends within one, and the page rounds half a one."""


class Hand:
    """A hand at the map of 6 mm: places in m, as the page shows all of it."""

    def __init__(self, page: Any) -> None:
        self.page = page
        self.look()

    def look(self) -> None:
        """See where the map is: it makes room for a list that grows, and for the bar of a tool."""
        left, top, width, height = self.page.box("#map canvas")
        self.middle = (left + width / 2, top + height / 2)
        # all of the map is shown, with 24 pixels to spare: from the first to beyond the last pixel
        self.scale = N * STEP / (min(width, height) - 24)
        self.near = PIXEL * self.scale

    def at(self, x: float, y: float) -> Place:
        """Return where a place of the map is on the screen; y points up."""
        self.look()
        half = (N - 1) / 2 * STEP
        return (
            self.middle[0] + (x - half) / self.scale,
            self.middle[1] - (y - half) / self.scale,
        )

    def drag(self, a: Place, b: Place) -> None:
        (x0, y0), (x1, y1) = self.at(*a), self.at(*b)
        self.page.drag((x0, y0), (x1 - x0, y1 - y0), seconds=0.15)

    def click(self, place: Place) -> None:
        x, y = self.at(*place)
        for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
            self.page.mouse(kind, x, y)

    def recipe(self) -> str:
        """Return the text of the recipe that the page holds, without what is shown."""
        self.page.click("#recipe")
        text = str(self.page.run("document.querySelector('dialog pre').textContent"))
        self.page.run("document.querySelector('dialog').close()")
        return without_view_block(text)

    def data(self) -> dict[str, Any]:
        return tomllib.loads(self.recipe())


def metres(text: str) -> float:
    value, unit = text.split()
    assert unit == "mm"
    return float(value) * 1e-3


def point(text: str | list[str]) -> list[float]:
    return [metres(v) for v in (text.split(",") if isinstance(text, str) else text)]


MM = 1e-3
MIDDLE, RIGHT = (2.0 * MM, 2.5 * MM), (2.8 * MM, 2.5 * MM)


def a_circle(hand: Hand) -> None:
    hand.page.press("c")
    hand.drag(MIDDLE, RIGHT)


def a_ring(hand: Hand) -> None:
    hand.page.press("c")
    hand.page.press("c")
    hand.drag(MIDDLE, RIGHT)


def a_rectangle(hand: Hand) -> None:
    hand.page.press("x")
    hand.drag((1.0 * MM, 3.5 * MM), (2.2 * MM, 3.0 * MM))


def a_crop(hand: Hand) -> None:
    hand.page.press("x")
    hand.page.press("x")
    hand.drag((0.9 * MM, 5.4 * MM), (5.4 * MM, 0.8 * MM))


CORNERS = [(1.0 * MM, 1.5 * MM), (3.0 * MM, 1.2 * MM), (2.4 * MM, 3.1 * MM)]


def a_polygon(hand: Hand) -> None:
    hand.page.press("p")
    for corner in CORNERS:
        hand.click(corner)
    hand.page.press("Enter")


def a_free_shape(hand: Hand) -> None:
    hand.page.press("l")
    turn = np.linspace(0.0, 2 * np.pi, 60)
    ring = [
        hand.at(2.0 * MM + 0.7 * MM * np.cos(t), 2.5 * MM + 0.7 * MM * np.sin(t)) for t in turn
    ]
    hand.page.mouse("mouseMoved", *ring[0])
    hand.page.mouse("mousePressed", *ring[0])
    for place in ring[1:]:
        hand.page.mouse("mouseMoved", *place, held=True)
    hand.page.mouse("mouseReleased", *ring[-1])


def a_brush(hand: Hand) -> None:
    hand.page.press("b")
    hand.drag((1.5 * MM, 3.0 * MM), (2.5 * MM, 2.2 * MM))


def a_section(hand: Hand) -> None:
    hand.page.press("a")
    hand.drag((1.0 * MM, 2.0 * MM), (2.6 * MM, 4.4 * MM))


def a_round_section(hand: Hand) -> None:
    hand.page.press("g")
    hand.drag((3.0 * MM, 3.0 * MM), (5.0 * MM, 3.0 * MM))


def a_distance(hand: Hand) -> None:
    hand.page.press("d")
    hand.click(CORNERS[0])
    hand.click(CORNERS[1])
    hand.page.press("Enter")


def an_angle(hand: Hand) -> None:
    hand.page.press("d")
    for corner in CORNERS:
        hand.click(corner)


def a_circle_through_three(hand: Hand) -> None:
    hand.page.press("d")
    hand.click(CORNERS[0])
    hand.click(CORNERS[1])
    x, y = hand.at(*CORNERS[2])
    for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
        hand.page.mouse(kind, x, y, modifiers=SHIFT)


def a_step(hand: Hand) -> None:
    hand.page.press("t")
    hand.drag((1.2 * MM, 2.0 * MM), (2.4 * MM, 2.9 * MM))


def a_groove(hand: Hand) -> None:
    hand.page.press("t")
    hand.page.press("t")
    hand.drag((2.0 * MM, 1.6 * MM), (2.6 * MM, 1.6 * MM))


def the_extremes(hand: Hand) -> None:
    hand.page.press("m")
    hand.drag((2.2 * MM, 4.2 * MM), (2.9 * MM, 4.2 * MM))


GESTURES = {
    "circle": a_circle, "ring": a_ring, "rectangle": a_rectangle, "crop": a_crop, "polygon": a_polygon,
    "free-hand": a_free_shape, "brush": a_brush, "section": a_section, "round section": a_round_section,
    "distance": a_distance, "angle": an_angle, "circle3": a_circle_through_three, "step": a_step, "groove": a_groove, "extremes": the_extremes,
}  # fmt: skip


def made(hand: Hand, act: Callable[[Hand], None]) -> tuple[str, dict[str, Any]]:
    """Return the recipe before a gesture, and the only table that it added."""
    before = hand.recipe()
    settled(hand.page, lambda: act(hand))
    old, new = tomllib.loads(before), hand.data()
    added = [s for k in ("step", "section") for s in new.get(k, []) if s not in old.get(k, [])]
    assert len(added) == 1
    return before, added[0]


@pytest.mark.parametrize("name", GESTURES)
def test_a_gesture_is_one_edit_and_one_undo_restores_the_bytes(
    opened: Opened, map_file: Path, name: str
) -> None:
    hand = Hand(opened(map_file))
    before, table = made(hand, GESTURES[name])
    near = hand.near
    shape = table.get("aperture", table)

    def is_at(text: Any, place: Place) -> bool:
        return bool(np.abs(np.subtract(point(text), place)).max() <= near)

    if name in ("circle", "ring"):
        assert table["op"] == "mask"
        assert table["outside"] is False  # what is drawn is excluded
        assert shape["shape"] == name
        assert metres(shape["diameter"]) == pytest.approx(1.6 * MM, abs=2 * near)
        assert is_at(shape["centre"], MIDDLE)
    elif name == "rectangle":
        assert metres(shape["width"]) == pytest.approx(1.2 * MM, abs=2 * near)
        assert metres(shape["height"]) == pytest.approx(0.5 * MM, abs=2 * near)
        assert is_at(shape["centre"], (1.6 * MM, 3.25 * MM))
    elif name == "crop":
        assert "outside" not in table  # what lies outside is removed
        assert metres(shape["width"]) == pytest.approx(4.5 * MM, abs=2 * near)
        assert metres(shape["height"]) == pytest.approx(4.6 * MM, abs=2 * near)
        assert is_at(shape["centre"], (3.15 * MM, 3.1 * MM))
    elif name == "polygon":
        assert all(is_at(p, c) for p, c in zip(shape["points"], CORNERS, strict=True))
    elif name == "free-hand":
        x, y = np.array([point(p) for p in shape["points"]]).T
        area = 0.5 * abs(np.dot(x, np.roll(y, 1)) - np.dot(y, np.roll(x, 1)))
        assert len(x) <= 400
        # of the polygon of 59 sides that was drawn
        drawn = 0.5 * 59 * (0.7 * MM) ** 2 * np.sin(2 * np.pi / 59)
        assert area == pytest.approx(
            drawn, abs=0.01 * drawn + 2 * np.pi * 0.7 * MM * 0.5 * hand.scale
        )
    elif name == "brush":
        assert shape["shape"] == "brush"
        assert is_at(shape["points"][0], (1.5 * MM, 3.0 * MM))
        assert is_at(shape["points"][-1], (2.5 * MM, 2.2 * MM))
    elif name == "section":
        assert (shape["kind"], shape["name"]) == ("line", "line1")
        assert is_at(shape["a"], (1.0 * MM, 2.0 * MM))
        assert is_at(shape["b"], (2.6 * MM, 4.4 * MM))  # up: y grows upwards on the page
    elif name == "round section":
        assert is_at(shape["centre"], (3.0 * MM, 3.0 * MM))
        assert metres(shape["radius"]) == pytest.approx(2.0 * MM, abs=2 * near)
    elif name == "step":
        assert (shape["kind"], shape["name"]) == ("step", "step1")
        assert is_at(shape["a"], (1.2 * MM, 2.0 * MM))
        assert is_at(shape["b"], (2.4 * MM, 2.9 * MM))
        assert metres(shape["width"]) == pytest.approx(0.75 * MM, abs=2 * near)
    elif name == "groove":
        assert shape["kind"] == "groove"
        assert is_at(shape["b"], (2.6 * MM, 1.6 * MM))
    elif name == "extremes":
        assert metres(shape["radius"]) == pytest.approx(0.7 * MM, abs=2 * near)
    else:
        assert shape["kind"] == name
        assert is_at(shape["b"], CORNERS[1])
    ops = [s["op"] for s in hand.data()["step"]]
    assert ops[-1] == "parameters"  # one map is shown and judged
    hand.page.press("Escape")
    settled(hand.page, lambda: hand.page.press("z"))
    assert hand.recipe() == before
    assert hand.page.errors == []


def same_bytes(page: Any, map_file: Path) -> bytes:
    """Hold the result that the page exports against that of the command, byte for byte."""
    folder = map_file.parent
    page.press("s")
    page.fill("dialog [name=path]", str(folder / "hand.toml"))
    page.click("dialog [value=yes]")
    page.wait("document.getElementById('status-link').textContent.includes('hand.toml')")
    page.press("e")
    page.fill("dialog [name=path]", str(folder / "by-hand"))
    page.click("dialog [value=yes]")
    page.wait("document.getElementById('status-link').textContent.includes('result.json')")
    subprocess.run(
        [sys.executable, "-m", "metrosep", "run", "hand.toml", map_file.name, "-o", "by-run"],
        cwd=folder, check=True, capture_output=True, timeout=200,
    )  # fmt: skip
    ours, theirs = ((folder / d / "result.json").read_bytes() for d in ("by-hand", "by-run"))
    assert ours == theirs
    return bytes(theirs)


def test_all_gestures_together_give_the_bytes_of_metrosep_run(
    opened: Opened, map_file: Path
) -> None:
    page = opened(map_file)
    hand = Hand(page)
    for name, act in GESTURES.items():
        if name != "ring":
            settled(page, lambda act=act: act(Hand(page)))
        page.press("Escape")
    # moved by mouse and by keys, deleted by key, undone and done again
    page.click('[data-shape="section 0"]')
    settled(page, lambda: page.drag(page.middle('[data-grip="width"]'), (-24.0, -16.0)))
    page.click('[data-shape="section 1"]')
    settled(page, lambda: page.drag(page.middle('[data-grip="radius"]'), (-30.0, 0.0)))
    page.run("document.querySelector('[data-grip=\"move\"]').focus()")
    settled(page, lambda: page.press("ArrowLeft", shift=True))
    page.click('[data-shape="step 2"]')
    page.run("document.querySelector('[data-shape=\"step 2\"]').focus()")
    settled(page, lambda: page.press("Delete"))
    for _ in range(2):
        settled(page, lambda: page.click("#undo"))
    for _ in range(2):
        settled(page, lambda: page.click("#redo"))
    theirs = same_bytes(page, map_file)
    found = {e["metric"]: e["value"] for e in json.loads(theirs)["characteristics"]}
    angle = np.subtract(CORNERS[0], CORNERS[1]), np.subtract(CORNERS[2], CORNERS[1])
    cos = angle[0] @ angle[1] / np.hypot(*angle[0]) / np.hypot(*angle[1])
    assert found["section.angle1.angle"] == pytest.approx(np.arccos(cos), abs=0.01)
    assert found["section.distance1.lateral"] == pytest.approx(
        np.hypot(*angle[0]), abs=2 * hand.near
    )


def test_what_menus_choose_gives_the_bytes_of_metrosep_run(opened: Opened, map_file: Path) -> None:
    """Crop, filter and form from menus, a typed field, the order by buttons, a step switched off."""
    page = opened(map_file)

    settled(page, lambda: choose(page, "#add-step", "crop"))
    crop = Hand(page).data()["step"][1]
    assert (crop["op"], crop["aperture"]["shape"]) == ("mask", "rectangle")
    assert "outside" not in crop
    assert metres(crop["aperture"]["width"]) == metres(crop["aperture"]["height"])
    settled(page, lambda: page.click('[aria-label="Move step 2 up"]'))
    settled(page, lambda: choose(page, "#add-step", "filter"))
    settled(page, lambda: choose(page, ".editor [data-key=kind]", "spline"))
    settled(page, lambda: choose(page, "#add-step", "outliers"))
    settled(page, lambda: page.click('[aria-label="Step 3, outliers: on"]'))
    page.click('[data-step="3"] .pick')
    settled(page, lambda: page.click("[data-form=sphere]"))
    page.fill('[data-field="R"]', "200 mm")
    settled(page, lambda: page.press("Tab"))
    steps = Hand(page).data()["step"]
    assert [s["op"] for s in steps] == ["mask", "filter", "outliers", "form", "parameters"]
    assert (steps[3]["form"], steps[2]["enabled"]) == ("sphere: R=200 mm", False)
    same_bytes(page, map_file)
    assert page.errors == []


def test_the_mask_that_was_drawn_takes_out_the_pixels_inside(
    opened: Opened, map_file: Path
) -> None:
    from metrosep.io.read import read

    page = opened(map_file)
    hand = Hand(page)
    _, table = made(hand, a_circle)
    z = read(map_file).z
    y, x = np.indices(z.shape) * STEP
    cx, cy = point(table["aperture"]["centre"])
    inside = np.hypot(x - cx, y - cy) <= metres(table["aperture"]["diameter"]) / 2 * (1 + 1e-9)
    taken = int(np.count_nonzero(inside & ~np.isnan(z)))
    assert taken > 10_000
    assert f"{taken} measured heights removed" in page.run(
        "document.getElementById('messages').title"
    )


def test_handles_move_by_mouse_and_by_arrows_and_escape_puts_back(
    opened: Opened, map_file: Path
) -> None:
    page = opened(map_file)
    hand = Hand(page)
    before, table = made(hand, a_circle)
    page.press("Escape")
    hand = Hand(page)  # the list of shapes made the map lower
    page.click('[data-shape="step 1"]')
    hand = Hand(page)
    grip = '[data-grip="radius"]'
    settled(page, lambda: page.drag(page.middle(grip), (30.0, 0.0)))
    wider = hand.data()["step"][1]["aperture"]
    grown = metres(wider["diameter"]) - metres(table["aperture"]["diameter"])
    assert grown == pytest.approx(60 * hand.scale, abs=2 * hand.near)
    assert wider["centre"] == table["aperture"]["centre"]

    page.run("document.querySelector('[data-grip=\"move\"]').focus()")
    settled(page, lambda: page.press("ArrowUp", shift=True))
    assert page.run("document.activeElement.dataset.grip") == "move"
    there = hand.data()["step"][1]["aperture"]
    (x0, y0), (x1, y1) = point(wider["centre"]), point(there["centre"])
    assert x1 == pytest.approx(x0, abs=hand.near)
    assert y1 - y0 == pytest.approx(10 * hand.scale, abs=hand.near)  # up is +y

    kept = hand.recipe()
    x, y = page.middle(grip)
    page.mouse("mouseMoved", x, y)
    page.mouse("mousePressed", x, y)
    page.mouse("mouseMoved", x + 40, y, held=True)
    page.press("Escape")
    page.mouse("mouseReleased", x + 40, y)
    assert hand.recipe() == kept
    for _ in range(3):
        page.run("document.activeElement.blur()")
        settled(page, lambda: page.press("z"))
    assert hand.recipe() == before
    assert page.errors == []


def test_keep_exclude_type_and_delete(opened: Opened, map_file: Path) -> None:
    page = opened(map_file)
    hand = Hand(page)
    before, _ = made(hand, a_circle)
    page.press("Escape")
    page.click('[data-shape="step 1"]')
    settled(page, lambda: page.press("n"))
    assert hand.data()["step"][1].get("outside", True) is True
    page.fill('.draw-field [data-key="diameter"]', "1500 um")
    settled(page, lambda: page.press("Tab"))
    assert hand.data()["step"][1]["aperture"]["diameter"] == "1500 um"
    page.fill('.draw-field [data-key="diameter"]', "15")  # without a unit
    page.press("Tab")
    page.wait("document.getElementById('alerts').textContent.includes('unit')")
    assert hand.data()["step"][1]["aperture"]["diameter"] == "1500 um"
    page.run("document.querySelector('[data-shape=\"step 1\"]').focus()")
    settled(page, lambda: page.press("Delete"))
    assert tomllib.loads(before)["step"] == hand.data()["step"]


def test_a_polygon_gains_and_loses_corners(opened: Opened, map_file: Path) -> None:
    page = opened(map_file)
    hand = Hand(page)
    made(hand, a_polygon)
    page.press("Escape")
    page.click('[data-shape="step 1"]')
    hand = Hand(page)
    (ax, ay), (bx, by) = CORNERS[0], CORNERS[1]
    settled(page, lambda: hand.click(((ax + bx) / 2, (ay + by) / 2)))
    points = hand.data()["step"][1]["aperture"]["points"]
    assert len(points) == 4
    assert np.abs(np.subtract(point(points[1]), ((ax + bx) / 2, (ay + by) / 2))).max() <= hand.near
    page.run("document.querySelector('[data-grip=\"point 1\"]').focus()")
    settled(page, lambda: page.press("Delete"))
    assert len(hand.data()["step"][1]["aperture"]["points"]) == 3
    page.run("document.querySelector('[data-grip=\"point 1\"]').focus()")
    page.press("Delete")  # the last three stay
    page.wait("document.getElementById('alerts').textContent.includes('last corners')")
    assert len(hand.data()["step"][1]["aperture"]["points"]) == 3


def test_eight_sections_have_eight_colours_and_a_ninth_is_refused(
    opened: Opened, map_file: Path
) -> None:
    page = opened(map_file)
    page.press("a")
    hand = Hand(page)
    for k in range(8):
        y = (1 + 0.4 * k) * MM
        settled(page, lambda y=y: Hand(page).drag((1.0 * MM, y), (4.0 * MM, y)))
    strokes = page.run(
        "[...document.querySelectorAll('.draw-shape .over')].map((e) => getComputedStyle(e).stroke)"
    )
    assert len(set(strokes)) == 8
    hand.drag((1.0 * MM, 5.0 * MM), (4.0 * MM, 5.0 * MM))
    page.wait("document.getElementById('alerts').textContent.includes('8 sections at most')")
    assert len(hand.data()["section"]) == 8
    for s in hand.data()["section"]:
        (_, y0), (_, y1) = point(s["a"]), point(s["b"])
        assert y0 == y1


@pytest.mark.parametrize(("width", "height"), [(1366, 768), (390, 844)])
def test_the_plus_of_the_section_adds_another(
    opened: Opened, map_file: Path, width: int, height: int
) -> None:
    page = opened(map_file)
    try:
        page.show(width, height)
        for n in range(2):
            if width < 700:
                page.click('#parts [data-part="section"]')
            page.click("#section-add")
            page.wait("document.querySelector('#map').checkVisibility()")
            hand = Hand(page)
            start, end = (1.0 * MM, (2 + n) * MM), (4.0 * MM, (2 + n) * MM)
            settled(page, lambda hand=hand, start=start, end=end: hand.drag(start, end))
            lines = hand.data()["section"]
            assert len(lines) == n + 1
            assert np.abs(np.subtract(point(lines[n]["a"]), start)).max() <= hand.near
            assert np.abs(np.subtract(point(lines[n]["b"]), end)).max() <= hand.near
    finally:
        page.show(1366, 768)


def test_a_step_is_measured_in_full_resolution_and_its_peak_is_marked(
    opened: Opened, map_file: Path
) -> None:
    from metrosep.io.read import read
    from metrosep.parameters import step_between

    page = opened(map_file)
    hand = Hand(page)
    settled(page, lambda: a_step(hand))
    settled(page, lambda: the_extremes(hand))
    step, spot = hand.data()["section"]
    left = read(map_file).level()
    a, b = (tuple(point(step[k])) for k in "ab")
    found = step_between(left, a, b, width=metres(step["width"]))
    shown, half = printed(page, "section.step1.h")
    assert abs(shown - found.height) <= half
    x, y = np.indices(left.z.T.shape) * STEP
    (cx, cy), r = point(spot["centre"]), metres(spot["radius"])
    inside = np.where(np.hypot(x - cx, y - cy) <= r, left.z.T, np.nan)
    highest = np.unravel_index(np.nanargmax(inside), inside.shape)
    shown, half = printed(page, "section.spot1.peak_x")
    assert abs(shown - highest[0] * STEP) <= half
    assert page.run("document.querySelectorAll('.draw-shape polygon[points]').length") > 2
    assert page.errors == []


def test_curves_of_the_recipe_stand_beside_the_section_and_can_be_hidden(
    opened: Opened, map_file: Path
) -> None:
    page = opened(map_file)
    hand = Hand(page)
    settled(page, lambda: a_section(hand))
    settled(page, lambda: a_round_section(hand))
    settled(page, lambda: a_groove(hand))
    page.wait("document.querySelectorAll('.plot-names button').length === 3")
    names = page.run(
        "[...document.querySelectorAll('.plot-names button')].map((e) => e.textContent)"
    )
    assert names == ["line1", "round1", "groove1"]
    colours = page.run(
        "[...document.querySelectorAll('.plot-names button')].map((e) => getComputedStyle(e).borderLeftColor)"
    )
    assert len(set(colours)) == 3
    page.click(".plot-names button")
    page.wait(
        "document.querySelector('.plot-names button').getAttribute('aria-pressed') === 'false'"
    )
    assert page.errors == []


def test_a_band_is_pulled_out_of_a_line_and_damps_waves_across_it(
    opened: Opened, map_file: Path
) -> None:
    page = opened(map_file)
    hand = Hand(page)
    settled(page, lambda: a_section(hand))
    assert "width" not in hand.data()["section"][0]
    page.press("Escape")
    hand = Hand(page)
    settled(page, lambda: page.drag(page.middle('[data-grip="width"]'), (-24.0, -16.0)))
    width = metres(hand.data()["section"][0]["width"])
    assert width > 10 * STEP
    page.wait("document.getElementById('messages').title.includes('mean of')")
    page.click("#messages")
    page.wait("document.querySelector('dialog pre')?.textContent.includes('mean of')")
    assert page.errors == []


def test_the_wheel_changes_the_brush_and_copies_are_pasted_and_turned(
    opened: Opened, map_file: Path
) -> None:
    page = opened(map_file)
    hand = Hand(page)
    page.press("b")
    x, y = hand.at(1.5 * MM, 3.0 * MM)
    page.call("Input.dispatchMouseEvent", type="mouseWheel", x=x, y=y, deltaX=0, deltaY=200)
    settled(page, lambda: hand.drag((1.5 * MM, 3.0 * MM), (2.5 * MM, 2.2 * MM)))
    thick = metres(hand.data()["step"][1]["aperture"]["radius"])
    assert thick == pytest.approx(8 * hand.scale * np.exp(0.3), abs=hand.scale)
    page.press("Escape")
    settled(page, lambda: page.press("z"))
    settled(page, lambda: a_rectangle(hand))
    page.press("Escape")
    page.click('[data-shape="step 1"]')
    hand = Hand(page)
    before = hand.data()["step"][1]["aperture"]
    # a quarter of a turn: the handle of the angle from the right to above the middle
    (x0, y0), (x1, y1) = page.middle('[data-grip="turn"]'), page.middle('[data-grip="move"]')
    settled(page, lambda: page.drag((x0, y0), (x1 - x0, y1 - 60 - y0)))
    turned = hand.data()["step"][1]["aperture"]
    assert float(turned["angle"].split()[0]) == pytest.approx(90.0, abs=2.0)  # from +x to +y
    assert (turned["width"], turned["centre"]) == (before["width"], before["centre"])
    page.run("document.querySelector('[data-shape=\"step 1\"]').focus()")
    page.press("c", control=True)
    settled(page, lambda: page.press("v", control=True))
    masks = [s["aperture"] for s in hand.data()["step"] if s["op"] == "mask"]
    assert len(masks) == 2
    assert masks[0]["width"] == masks[1]["width"]
    assert masks[0]["centre"] != masks[1]["centre"]
    assert page.errors == []


@pytest.mark.parametrize("how", ["first corner", "double click"])
def test_a_polygon_is_closed_by_its_first_corner_or_a_double_click(
    opened: Opened, map_file: Path, how: str
) -> None:
    page = opened(map_file)
    hand = Hand(page)
    page.press("p")
    for corner in CORNERS:
        hand.click(corner)
    settled(page, lambda: hand.click(CORNERS[0] if how == "first corner" else CORNERS[-1]))
    points = hand.data()["step"][1]["aperture"]["points"]
    assert len(points) == 3


def test_alt_takes_the_peak_near_by_and_a_round_section_is_laid_into_the_aperture(
    opened: Opened, tmp_path: Path
) -> None:
    from metrosep import Surface
    from metrosep.io.write import write

    y, x = np.indices((N, N))
    z = 1e-12 * (x + 2.0 * y)
    for i, j in ((203, 297), (402, 351)):  # x, y of two peaks
        z[j, i] = 5e-8
    z[np.hypot(x - 310, y - 290) > 270] = np.nan
    write(Surface(z, STEP, STEP), tmp_path / "peaks.x3p")
    page = opened(tmp_path / "peaks.x3p")
    hand = Hand(page)
    page.press("d")
    for i, j in ((203, 297), (402, 351)):
        px, py = hand.at((i + 4) * STEP, (j - 3) * STEP)  # beside them
        for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
            page.mouse(kind, px, py, modifiers=1)
        page.run("new Promise((done) => setTimeout(done, 400))")
    settled(page, lambda: page.press("Enter"))
    found = hand.data()["section"][0]
    assert np.abs(np.subtract(point(found["a"]), (203 * STEP, 297 * STEP))).max() < 1e-9
    assert np.abs(np.subtract(point(found["b"]), (402 * STEP, 351 * STEP))).max() < 1e-9
    settled(page, lambda: a_round_section(Hand(page)))
    page.press("Escape")
    page.run(
        "document.querySelector('[data-shape=\"section 1\"]').getAttribute('aria-pressed') === 'true' || document.querySelector('[data-shape=\"section 1\"]').click()"
    )
    settled(page, lambda: page.click("#shapes button.small"))
    ring = hand.data()["section"][1]
    assert np.abs(np.subtract(point(ring["centre"]), (310 * STEP, 290 * STEP))).max() < STEP
    assert metres(ring["radius"]) == pytest.approx(0.98 * 270 * STEP, abs=STEP)
    assert page.errors == []


def test_escape_gives_up_what_is_being_drawn(opened: Opened, map_file: Path) -> None:
    """Also with a button that is still held: its release adds nothing."""
    page = opened(map_file)
    x, y = page.middle("#map canvas")
    for key in "cxlbagt":
        page.press(key)
        page.mouse("mouseMoved", x, y)
        page.mouse("mousePressed", x, y)
        page.mouse("mouseMoved", x + 40, y + 20, held=True)
        page.mouse("mouseMoved", x + 10, y + 60, held=True)
        page.press("Escape")
        page.mouse("mouseMoved", x + 60, y, held=True)
        page.mouse("mouseReleased", x + 60, y)
        page.press("Escape")  # the tool
    page.run("new Promise((done) => setTimeout(done, 500))")
    assert page.run("document.getElementById('undo').disabled")
    assert page.text("#alerts") == ""


def test_a_polygon_without_area_stays_open_and_red(opened: Opened, map_file: Path) -> None:
    page = opened(map_file)
    x, y = page.middle("#map canvas")
    page.press("p")
    for i in range(3):
        for kind in ("mousePressed", "mouseReleased"):
            page.mouse(kind, x + 40 * i, y + 20 * i)
    stroke = "getComputedStyle(document.querySelector('.draw-shape.draft .over')).stroke"
    usual = page.run(stroke)
    page.press("Enter")
    page.wait("document.getElementById('alerts').textContent.includes('not all on one line')")
    assert page.run(stroke) == "rgb(255, 92, 92)" != usual
    for kind in ("mousePressed", "mouseReleased"):
        page.mouse(kind, x, y + 80)
    assert page.run(stroke) == usual
    page.press("Enter")
    page.wait("document.querySelector('#shapes .draw-chip') !== null")


def test_a_polygon_that_crosses_itself_is_taken_with_a_warning(
    opened: Opened, map_file: Path
) -> None:
    """Its signed area is nothing; even-odd it excludes two triangles."""
    page = opened(map_file)
    x, y = page.middle("#map canvas")
    page.press("p")
    for dx, dy in ((-80, 40), (0, 120), (-80, 120), (0, 40)):
        for kind in ("mousePressed", "mouseReleased"):
            page.mouse(kind, x + dx, y + dy)
    page.press("Enter")
    page.wait("document.querySelector('#shapes .draw-chip') !== null")
    page.wait("document.getElementById('messages').title.includes('cross')")
    assert page.text("#alerts") == ""


SOCKETS = """window.sockets = []; const Real = WebSocket;
  window.WebSocket = class extends Real { constructor(address) { super(window.cut ? 'ws://127.0.0.1:9/' : address); window.sockets.push(this); } };"""


def test_a_shape_drawn_without_connection_is_sent_again_once(tab: Any, map_file: Path) -> None:
    with chromium.workbench(map_file) as address:
        script = tab.call("Page.addScriptToEvaluateOnNewDocument", source=SOCKETS)["identifier"]
        try:
            tab.go(address)
            tab.wait(FULL)
            tab.run("(window.cut = true, window.sockets.at(-1).close())")
            tab.wait("document.querySelector('#status-link.lost') !== null")
            x, y = tab.middle("#map canvas")
            tab.press("x")
            tab.drag((x - 40, y - 20), (60, 30))
            tab.wait("document.querySelector('.alert p') !== null")
            assert "sent again when the connection is back" in tab.text(".alert p")
            tab.run("window.cut = false")
            tab.wait("document.querySelector('#shapes .draw-chip') !== null")
            assert tab.text("#alerts") == ""
            tab.run("(window.cut = true, window.sockets.at(-1).close())")
            tab.wait("document.querySelector('#status-link.lost') !== null")
            tab.run("window.cut = false")
            tab.wait("document.querySelector('#status-link.lost') === null")
            tab.wait(FULL)
            assert tab.run("document.querySelectorAll('#shapes .draw-chip').length") == 1
        finally:
            tab.call("Page.removeScriptToEvaluateOnNewDocument", identifier=script)
            tab.go("about:blank")
