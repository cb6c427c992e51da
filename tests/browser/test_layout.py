"""The windows of the page: bars do not move the map, splits are dragged, moved by keys and remembered."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from browser.test_access import profile_file
from browser.test_narrow import CUT
from browser.test_runs import EXAMPLE
from browser.test_zoom import RUNS, turn

pytestmark = pytest.mark.browser

Opened = Callable[..., Any]
BOX = "(() => { const b = document.querySelector('%s').getBoundingClientRect(); return [b.left, b.top, b.width, b.height]; })()"
SPLITS = {
    "left": ((40.0, 0.0), "steps", 2),
    "middle": ((-60.0, 0.0), "map", 2),
    "right": ((0.0, 50.0), "section", 3),
    "lower": ((0.0, -70.0), "steps", 3),
}
"""Each split, with a drag that it allows, and the width or height of a window that takes it."""


def where(page: Any, what: str = "#map") -> list[float]:
    return list(page.run(BOX % what))


@pytest.mark.parametrize(("width", "height"), [(1366, 768), (1024, 700), (390, 844)])
def test_no_bar_moves_the_map_under_the_hand(
    opened: Opened, map_file: Path, width: int, height: int
) -> None:
    """A tool, a shape, its values, a refusal, the view in 3-D: the map stays where it is."""
    page = opened(map_file)
    page.show(width, height)
    page.run("new Promise((done) => setTimeout(done, 300))")
    page.run("scrollTo(0, 0)")
    whole, moved = where(page), {}

    def look(what: str) -> None:
        page.run("scrollTo(0, 0)")
        if (now := where(page)) != whole:
            moved[what] = now

    for key in "ccxxpttnnamgdb":
        page.press(key)
        look(key)
    page.press("x")
    x, y = page.middle("#map canvas")
    page.drag((x - 40, y - 20), (60, 30))
    page.wait("document.querySelector('#shapes .draw-chip') !== null")
    look("a shape")
    page.press("Escape")
    if page.run("document.querySelector('#shapes .draw-field') === null"):
        page.click("#shapes .draw-chip")
    page.wait("document.querySelectorAll('#shapes .draw-field').length >= 4")
    look("its values")
    page.press("p")
    page.mouse("mousePressed", x, y)
    page.mouse("mouseReleased", x, y)
    page.press("Enter")  # a polygon of one corner
    page.wait("document.querySelector('.alert p') !== null")
    look("a refusal")
    page.run("document.querySelector('.alert button').click()")
    page.press("Escape")
    page.press("v")
    page.wait("!document.getElementById('relief').hidden")
    if (relief := where(page, "#relief")) != whole:
        moved["3-D"] = relief
    page.press("v")
    look("after 3-D")
    assert moved == {}
    assert page.errors == []


def shares(page: Any) -> dict[str, list[float]]:
    """Return the boxes of the windows."""
    names = ("steps", "map", "section", "spectrum", "metrics")
    return {name: where(page, f"#panel-{name}") for name in names}


def test_splits_are_dragged_moved_by_keys_and_remembered(opened: Opened, map_file: Path) -> None:
    page = opened(map_file)
    first = shares(page)
    try:
        near, now = pytest.approx, first
        for name, (by, window, side) in SPLITS.items():
            before = now[window][side]
            page.drag(page.middle(f"[data-split={name}]"), by)
            now = shares(page)
            assert now[window][side] - before == near(sum(by), abs=1.0), name
        assert now["spectrum"][1] - first["spectrum"][1] == near(50.0, abs=1.5)
        assert now["metrics"][1] - first["metrics"][1] == near(-70.0, abs=1.5)
        edges = {one: now[one][0] + now[one][2] for one in ("steps", "map")}
        assert now["map"][0] - edges["steps"] == near(6.0, abs=0.5)  # the gap stays
        assert now["section"][0] - edges["map"] == near(6.0, abs=0.5)
        page.wait("document.querySelector('#map canvas').width >= 300")  # drawn anew

        page.run("document.querySelector('[data-split=middle]').focus()")
        said = "Number(document.activeElement.getAttribute('aria-valuenow'))"
        before = page.run(said)
        page.press("ArrowRight")
        page.press("ArrowRight", shift=True)
        assert page.run(said) > before
        moved = where(page, "#panel-map")
        assert moved[2] - now["map"][2] == near(110.0, abs=2.5)  # 10 px, with Shift 100
        page.press("End")
        assert where(page, "#panel-section")[2] >= 150.0  # no window vanishes
        page.press("Home")
        assert where(page, "#panel-map")[2] >= 150.0
        assert page.run(said) == page.run(said.replace("now", "min"))

        again = opened(map_file.rename(map_file.with_name("other.x3p")))
        assert where(again, "#panel-map")[2] == near(where(page, "#panel-map")[2], abs=1.0)
        assert where(again, "#panel-section")[3] == near(now["section"][3], abs=1.5)
        for name in SPLITS:
            again.run(
                f"document.querySelector('[data-split={name}]').dispatchEvent("
                "new MouseEvent('dblclick', { bubbles: true }))"
            )
        assert {k: near(v, abs=1.0) for k, v in first.items()} == shares(again)
    finally:
        page.run(
            "document.querySelectorAll('[data-split]').forEach((e) => e.dispatchEvent(new MouseEvent('dblclick')))"
        )
    assert page.errors == []


def test_a_narrow_page_keeps_its_parts_whatever_was_dragged(
    opened: Opened, map_file: Path
) -> None:
    page = opened(map_file)
    try:
        for key in ("Home", "End"):
            for name in SPLITS:
                page.run(f"document.querySelector('[data-split={name}]').focus()")
                page.press(key)
            page.run("new Promise((done) => setTimeout(done, 200))")
            assert page.run(CUT) == [], key
        for width, height in [(1200, 700), (1024, 700), (700, 600), (683, 384), (320, 640)]:
            page.show(width, height)
            page.run("new Promise((done) => setTimeout(done, 100))")
            assert page.run("document.documentElement.scrollWidth <= innerWidth"), width
            assert where(page, "#map")[2] >= 100.0, width
    finally:
        page.show(1366, 768)
        page.run(
            "document.querySelectorAll('[data-split]').forEach((e) => e.dispatchEvent(new MouseEvent('dblclick')))"
        )
    assert page.errors == []


@pytest.mark.parametrize("width", [1200, 1280, 1366, 1500])
def test_one_long_message_does_not_make_the_page_scroll_sideways(
    opened: Opened, map_file: Path, width: int
) -> None:
    """The foot line shows a single message whole where there is room, and cuts it elsewhere."""
    page = opened(map_file)
    page.show(width, 768)
    page.run(
        "(() => { const e = document.getElementById('messages'); e.hidden = false;"
        "e.textContent = 'the map is read at 1/4 of its resolution, '.repeat(12); })()"
    )
    page.run("new Promise((done) => setTimeout(done, 200))")
    assert page.run("document.documentElement.scrollWidth") <= width
    assert page.run("document.getElementById('help').getBoundingClientRect().right") <= width
    assert page.run("document.getElementById('messages').getBoundingClientRect().width") > 100
    assert page.errors == []


def test_the_way_back_holds_cursors_panels_and_splits(opened: Opened, map_file: Path) -> None:
    page = opened(map_file)
    rest = 0.8  # s: a state is kept when it has rested

    def alt(key: str) -> None:
        page.run("document.activeElement.blur()")
        page.press(key, alt=True)

    cursor = "document.querySelector('[aria-label=\"Cursor 1 of the section\"]').title"
    lower = "document.getElementById('lower').value"
    width = "Math.round(document.getElementById('panel-map').getBoundingClientRect().width)"
    relief = "document.getElementById('relief').hidden"
    try:
        time.sleep(rest)
        start = [page.run(one) for one in (cursor, lower, width, relief)]
        page.drag(page.middle('[aria-label="Cursor 1 of the section"]'), (40.0, 0.0))
        time.sleep(rest)
        page.run(
            "(() => { const s = document.querySelector('#lower'); s.value = 'heights'; s.dispatchEvent(new Event('change')); })()"
        )
        time.sleep(rest)
        page.drag(page.middle("[data-split=middle]"), (-80.0, 0.0))
        time.sleep(rest)
        page.press("v")
        time.sleep(rest)
        end = [page.run(one) for one in (cursor, lower, width, relief)]
        assert all(a != b for a, b in zip(start, end, strict=True))
        alt("ArrowLeft")
        page.wait(relief)
        assert page.run(width) == end[2]
        alt("ArrowLeft")
        page.wait(f"{width} === {start[2]}")
        assert page.run(lower) == "heights"
        alt("ArrowLeft")
        page.wait(f"{lower} === 'line'")
        assert page.run(cursor) == end[0]
        alt("ArrowLeft")
        page.wait(f"{cursor} === {start[0]!r}")
        for _ in range(4):
            alt("ArrowRight")
        page.wait(f"!{relief}")
        assert [page.run(one) for one in (cursor, lower, width, relief)] == end
        assert page.run("document.getElementById('undo').disabled")
    finally:
        page.run(
            "document.querySelectorAll('[data-split]').forEach((e) => e.dispatchEvent(new MouseEvent('dblclick')))"
        )
    assert page.errors == []


def test_the_way_back_of_runs_holds_zoom_curves_and_tab(opened: Opened, tmp_path: Path) -> None:
    for name in ("recipe.toml", "runs_y.csv"):
        shutil.copy(EXAMPLE / name, tmp_path / name)
    page = opened(tmp_path / "recipe.toml", RUNS)

    def alt(key: str) -> None:
        page.run("document.activeElement.blur()")
        page.press(key, alt=True)

    zoomed = "document.querySelector('#run-curves .readout').textContent.includes('double click')"
    shown = "document.querySelector('#panel-runs input[type=radio]:checked').value"
    time.sleep(0.8)
    first = page.run(shown)
    turn(page, "#run-curves", 0.5)
    page.wait(zoomed)
    time.sleep(0.8)
    page.run("document.querySelector('#panel-runs input[type=radio]:not(:checked)').click()")
    second = page.run(shown)
    time.sleep(0.8)
    page.click("#tab-report")
    time.sleep(0.8)
    alt("ArrowLeft")
    page.wait("document.body.dataset.tab === 'runs'")
    assert page.run(shown) == second != first
    alt("ArrowLeft")
    page.wait(f"{shown} === {first!r}")
    assert page.run(zoomed)
    alt("ArrowLeft")
    page.wait(f"!({zoomed})")
    for _ in range(3):
        alt("ArrowRight")
    page.wait("document.body.dataset.tab === 'report'")
    assert page.errors == []


def test_the_way_back_of_a_profile_holds_which_one_is_shown(
    opened: Opened, tmp_path: Path
) -> None:
    page = opened(profile_file(tmp_path))
    time.sleep(0.8)
    page.run("document.querySelector('input[name=shown][value=measured]').click()")
    time.sleep(0.8)
    page.run("document.activeElement.blur()")
    page.press("ArrowLeft", alt=True)
    page.wait("document.querySelector('input[name=shown][value=residual]').checked")
    page.press("ArrowRight", alt=True)
    page.wait("document.querySelector('input[name=shown][value=measured]').checked")
    assert page.errors == []


def test_the_colour_bar_lies_below_a_map_that_is_narrow(opened: Opened, map_file: Path) -> None:
    page = opened(map_file)
    for width, is_below in [(1366, False), (1024, False), (720, True), (700, True)]:
        page.show(width, 700)
        page.run("new Promise((done) => setTimeout(done, 200))")
        left, top, wide, high = where(page)
        bar = where(page, "#colourbar")
        assert (bar[1] >= top + high - 1.0) == is_below, width
        assert (bar[0] >= left + wide - 1.0) != is_below, width
        assert (
            page.run("document.querySelector('#colourbar').classList.contains('flat')") == is_below
        )
