"""Drawing on a map without scale: texts in px of the full map, the numbers of `metrosep run`, the scale given later."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser.test_drawing import Hand, made
from browser.test_work import choose, settled

import metrosep as ms

pytestmark = pytest.mark.browser

Opened = Callable[..., Any]

NM = 1e-9
SHAPE = (700, 1100)
"""Rows and columns: more than a preview shows, and not as wide as high."""
ROW, COLUMN = np.mgrid[: SHAPE[0], : SHAPE[1]]


def heights() -> Any:
    z = (0.02 * COLUMN - 0.05 * ROW) * NM
    z += 30 * NM * (COLUMN >= 600) + 5 * NM * np.sin(ROW * COLUMN / 9e3)
    z[420, 260] += 900 * NM  # inside the circle that is searched
    z[400, 300] -= 700 * NM
    z[:40, :90] = np.nan
    return z


class PixelHand(Hand):
    """A hand whose places are pixels of the map."""

    def look(self) -> None:
        left, top, width, height = self.page.box("#map canvas")
        self.middle = (left + width / 2, top + height / 2)
        self.scale = max(SHAPE[1] / (width - 24), SHAPE[0] / (height - 24))
        self.near = 1.5 * self.scale

    def at(self, x: float, y: float) -> tuple[float, float]:
        self.look()
        return (
            self.middle[0] + (x - (SHAPE[1] - 1) / 2) / self.scale,
            self.middle[1] - (y - (SHAPE[0] - 1) / 2) / self.scale,
        )


@pytest.fixture
def part(tmp_path: Path) -> Path:
    ms.write(ms.Surface(heights()), tmp_path / "part.h5")
    return tmp_path / "part.h5"


def pixels(text: str | list[str]) -> list[float]:
    parts = text.split(",") if isinstance(text, str) else text
    assert all(p.strip().endswith(" px") for p in parts), text
    return [float(p.strip().removesuffix(" px")) for p in parts]


GESTURES: dict[str, tuple[str, tuple[float, float], tuple[float, float]]] = {
    "circle": ("c", (300, 400), (380, 400)),
    "rectangle": ("x", (700, 100), (900, 240)),
    "section": ("a", (200, 500), (500, 620)),
    "round section": ("g", (800, 350), (920, 350)),
    "step": ("t", (500, 300), (700, 300)),
    "extremes": ("m", (280, 410), (340, 410)),
    "distance": ("d", (150, 150), (450, 550)),
}


@pytest.mark.parametrize("name", GESTURES)
def test_a_gesture_counts_pixels_of_the_full_map(opened: Opened, part: Path, name: str) -> None:
    hand = PixelHand(opened(part))
    key, a, b = GESTURES[name]

    def act(hand: Hand) -> None:
        hand.page.press(key)
        if name == "distance":
            hand.click(a)
            hand.click(b)
            hand.page.press("Enter")
        else:
            hand.drag(a, b)

    before, table = made(hand, act)
    shape = table.get("aperture", table)
    near = hand.near
    if name == "rectangle":
        assert pixels(shape["centre"]) == pytest.approx([800, 170], abs=near)
        assert pixels(shape["width"]) == pytest.approx([200], abs=2 * near)
    elif "centre" in shape:
        assert pixels(shape["centre"]) == pytest.approx(list(a), abs=near)
        size = pixels(shape.get("diameter", shape.get("radius")))[0]
        half = size / 2 if "diameter" in shape else size
        assert half == pytest.approx(b[0] - a[0], abs=2 * near)
    else:
        assert pixels(shape["a"]) == pytest.approx(list(a), abs=near)
        assert pixels(shape["b"]) == pytest.approx(list(b), abs=near)
    settled(hand.page, lambda: hand.page.click("#undo"))
    assert hand.recipe() == before
    assert hand.page.errors == []


def test_the_page_and_the_command_line_find_the_same_and_so_does_the_map_with_its_scale(
    opened: Opened, part: Path, command_line: Any
) -> None:
    page = opened(part)
    hand = PixelHand(page)
    settled(page, lambda: (page.press("c"), hand.drag((300, 400), (380, 400))))
    page.press("Escape")
    settled(page, lambda: (page.press("g"), hand.drag((800, 350), (920, 350))))
    page.press("Escape")
    settled(page, lambda: (page.press("m"), hand.drag((560, 200), (640, 200))))
    page.press("Escape")
    text = hand.recipe()
    data = tomllib.loads(text)
    (mask,) = [s for s in data["step"] if s["op"] == "mask"]
    (x, y), (d,) = pixels(mask["aperture"]["centre"]), pixels(mask["aperture"]["diameter"])
    inside = (COLUMN - x) ** 2 + (ROW - y) ** 2 <= (d / 2) ** 2
    n = np.count_nonzero(inside & ~np.isnan(heights()))
    page.click("#messages")
    said = page.text("dialog pre")
    page.run("document.querySelector('dialog').close()")
    assert f"{n} measured heights removed" in said
    for shape in ("mask: the circle", "section round1", "section spot1"):
        assert f"{shape} counts pixels, and the file does not say whether they are square" in said

    def found(recipe: str, out: str) -> dict[str, float]:
        (part.parent / "r.toml").write_text(recipe)
        done = command_line(part.parent, "run", "r.toml", part, "-o", out)
        assert done.returncode == 0, done.stderr
        document = json.loads((part.parent / out / "result.json").read_text())
        assert any(f"{n} measured heights removed" in m for m in document["messages"])
        return {c["metric"]: c["value"] for c in document["characteristics"]}

    first = found(text, "one")
    peak = page.text('[data-metric="section.spot1.peak_x"] td:nth-child(2)')
    assert peak == f"{first['section.spot1.peak_x']:.1f}\u2009px"

    page.click("#no-scale button")
    page.wait("document.querySelector('dialog[open]') !== null")
    page.fill("dialog [name=step]", "2 um x 3 um")
    settled(page, lambda: page.click("dialog [value=yes]"))
    again = hand.recipe()
    assert tomllib.loads(again)["input"]["lateral_step"] == "2 um x 3 um"
    assert {**tomllib.loads(again), "input": data["input"]} == data  # no shape has changed
    second = found(again, "two")
    of_sections = {k: v for k, v in second.items() if k.startswith("section.")}
    noise = 1e-6 * NM  # the plane is fitted in m now
    assert of_sections == pytest.approx({k: first[k] for k in of_sections}, abs=noise)
    # the pixels are oblong: what was a circle is drawn as an ellipse, 2 wide and 3 high
    page.wait("document.querySelectorAll('.draw-shapes ellipse').length > 0")
    rx, ry = (
        page.run(f"+document.querySelector('.draw-shapes ellipse').getAttribute('{k}')")
        for k in ("rx", "ry")
    )
    assert ry / rx == pytest.approx(1.5, abs=0.01)  # of texts with two digits
    settled(page, lambda: page.click("#undo"))
    assert hand.recipe() == text
    assert page.errors == []


def test_the_title_says_which_steps_the_picture_is_of(opened: Opened, part: Path) -> None:
    """While a hand moves, a large map without scale shows the steps that are done already."""
    page = opened(part)
    page.run(
        "window.titles = []; new MutationObserver(() => window.titles.push("
        "document.getElementById('map-stage').textContent)).observe("
        "document.getElementById('map-stage'), { childList: true, characterData: true, subtree: true })"
    )
    hand = PixelHand(page)
    settled(page, lambda: (page.press("c"), hand.drag((300, 400), (380, 400))))
    titles = page.run("window.titles")
    assert "after step 1, form: step 2, mask, follows" in titles, titles
    assert titles[-1] == "after all steps"


def test_mm_typed_for_one_size_of_a_shape_in_px_is_refused(opened: Opened, part: Path) -> None:
    page = opened(part)
    hand = PixelHand(page)
    settled(page, lambda: (page.press("g"), hand.drag((800, 350), (920, 350))))
    page.press("Escape")
    choose(page, '.draw-field [data-key="radius"]', "1 mm")
    page.wait("document.getElementById('alerts').textContent.includes('in px')")
    assert "write all of them in px, as a map without scale needs, or none" in page.text("#alerts")
    settled(page, lambda: choose(page, '.draw-field [data-key="radius"]', "99 px"))
    assert tomllib.loads(hand.recipe())["section"][0]["radius"] == "99 px"
