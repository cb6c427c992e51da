"""Narrow windows: nothing scrolls sideways, the map takes the width, each part is reached."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from browser.test_runs import EXAMPLE

pytestmark = pytest.mark.browser

Opened = Callable[..., Any]
NARROW = [(390, 844), (683, 384), (320, 640)]
"""A telephone; 1366 x 768 at 200 %; the narrowest that WCAG 1.4.10 asks for."""

SEEN = "((id) => { const b = document.getElementById(id).getBoundingClientRect(); return b.width * b.height > 0; })"
SMALL = """((least) => [...document.querySelectorAll('button, input, select, textarea, a[href], summary, [tabindex="0"], [role=slider]')]
  .filter((e) => e.checkVisibility({ visibilityProperty: true, opacityProperty: true }) && !e.closest('.visually-hidden'))
  .filter((e) => [e, ...(e.labels ?? [])].filter((one) => one === e || one.contains(e)).map((one) => one.getBoundingClientRect())
    .every((b) => b.width > 0 && (b.width < least || b.height < least)))
  .map((e) => e.id || e.getAttribute('aria-label') || e.textContent.slice(0, 30) || e.outerHTML.slice(0, 80)))(23.5)"""
"""Targets below 24 px, rounding apart; of a box its label counts, which may be pressed too."""

CUT = """[...document.querySelectorAll('body *')].filter((e) => e.checkVisibility({ visibilityProperty: true, opacityProperty: true })
    && !e.closest('.visually-hidden, svg, canvas, select, option, textarea, input, #messages')
    && [...e.childNodes].some((n) => n.nodeType === Node.TEXT_NODE && n.textContent.trim()))
  .filter((e) => ['hidden', 'clip'].includes(getComputedStyle(e).overflowX)
    && (e.scrollWidth > e.clientWidth + 1 || (e.clientHeight > 0 && e.scrollHeight > e.clientHeight + 2)))
  .map((e) => `${e.id || e.className}: ${e.textContent.slice(0, 60)}`)"""
"""Text that its own element cuts; the button of the messages opens all of them."""


@pytest.mark.parametrize(("width", "height"), NARROW)
def test_one_column_with_tabs_at_its_foot(
    opened: Opened, map_file: Path, width: int, height: int
) -> None:
    page = opened(map_file)
    page.show(width, height)
    for part, ids in {
        "picture": ["map"],
        "section": ["section", "spectrum"],
        "steps": ["steps"],
        "numbers": ["metrics"],
    }.items():
        page.click(f"#parts [data-part={part}]")
        seen = {
            i
            for i in ("map", "section", "spectrum", "steps", "metrics")
            if page.run(f"{SEEN}('{i}')")
        }
        assert seen == set(ids)
        assert page.run(f"{SEEN}('verdict')")  # the verdict stays in sight
        assert page.run("document.documentElement.scrollWidth <= innerWidth")
        assert page.run(SMALL) == []
    page.click("#parts [data-part=picture]")
    page.wait(f"document.getElementById('map').clientWidth >= {0.9 * width}")
    for tab in ("report", "compare", "folder"):
        page.click(f"#tab-{tab}")
        assert page.run("document.documentElement.scrollWidth <= innerWidth"), tab
    assert page.errors == []


@pytest.mark.parametrize("name", ["five_axis_calibration", "fts_lathe", "straightness", "map"])
def test_no_text_is_cut_and_every_target_is_24_px(
    opened: Opened, tmp_path: Path, repository: Path, map_file: Path, name: str
) -> None:
    """In every tab, from a telephone to a wide screen."""
    if name == "map":
        page = opened(map_file)
        page.click("#relief-on")
    else:
        shutil.copytree(repository / "examples" / name, tmp_path / "x")
        page = opened(
            tmp_path / "x" / "recipe.toml", "document.querySelector('[data-step]') !== null"
        )
    bad = {}
    for tab in page.run("[...document.querySelectorAll('#tabs button')].map((b) => b.id)"):
        page.show(1366, 768)
        page.click(f"#{tab}")
        page.run("new Promise((done) => setTimeout(done, 1500))")
        for width, height in [*NARROW, (768, 1024), (1280, 800), (2560, 1440)]:
            page.show(width, height)
            for part in ("section", "steps", "numbers", "picture"):
                if width >= 1200 and part != "picture":
                    continue
                page.run(f"document.querySelector('#parts [data-part={part}]').click()")
                page.run("new Promise((done) => setTimeout(done, 60))")
                found = [page.run(SMALL), page.run(CUT)]
                if any(found) or page.run("document.documentElement.scrollWidth > innerWidth"):
                    bad[f"{tab} {part} {width}"] = found
    assert bad == {}
    assert page.errors == []


def test_the_picture_beside_one_panel(opened: Opened, map_file: Path) -> None:
    page = opened(map_file)
    page.show(1024, 700)
    assert page.run(f"{SEEN}('map') && {SEEN}('steps') && !{SEEN}('metrics')")
    page.click("#parts [data-part=numbers]")
    assert page.run(f"{SEEN}('map') && !{SEEN}('steps') && {SEEN}('metrics')")
    page.run("document.querySelector('#parts [data-part=numbers]').focus()")
    page.press("ArrowLeft")
    assert page.run("document.body.dataset.part") == "steps"
    page.show(1366, 768)  # wide: all of it, whatever was chosen
    assert page.run(f"{SEEN}('map') && {SEEN}('section') && {SEEN}('steps') && {SEEN}('metrics')")


def test_drawing_works_in_one_column(opened: Opened, map_file: Path) -> None:
    page = opened(map_file)
    page.show(390, 844)
    page.run("new Promise((done) => setTimeout(done, 400))")
    upper, px = "#colourbar [aria-label^=Upper]", "Number({}.getAttribute('aria-valuenow'))"
    px = px.format(f"document.querySelector('{upper}')")
    *_, wide, high = page.box("#colourbar")
    assert wide > 4 * high  # the bar lies flat below the map, low values left
    before = page.run(px)
    page.drag(page.middle(upper), (-40.0, 0.0))
    assert page.run(px) == pytest.approx(before - 40.0, abs=2.0)
    page.press("ArrowRight", shift=True)
    assert page.run(px) == pytest.approx(before - 30.0, abs=2.0)
    assert page.run(px) > page.run(px.replace("Upper", "Lower"))
    page.click("#tools [data-tool=circle]")
    x, y = page.middle("#map canvas")
    page.drag((x - 40, y), (30, 0))
    page.wait("document.querySelector('#shapes .draw-chip') !== null")
    assert page.run("document.documentElement.scrollWidth <= innerWidth")


@pytest.mark.parametrize("width", [390, 320])
def test_the_open_dialog_fits_a_telephone(opened: Opened, map_file: Path, width: int) -> None:
    page = opened(map_file)
    page.show(width, 844)
    page.click("#open")
    page.wait("document.querySelector('dialog[open] .files-list [role=option]') !== null")
    assert page.run(
        "(() => { const d = document.querySelector('dialog[open]'); return d.scrollWidth <= d.clientWidth; })()"
    )
    box = page.run(
        "(() => { const b = document.getElementById('keep-recipe').getBoundingClientRect(); return [b.left, b.width]; })()"
    )
    assert box[0] > 0
    assert box[1] > 8
    page.press("Escape")
    assert page.errors == []


def test_high_contrast_shows_what_is_chosen_and_what_moves(opened: Opened, map_file: Path) -> None:
    page = opened(map_file)
    page.call(
        "Emulation.setEmulatedMedia", features=[{"name": "forced-colors", "value": "active"}]
    )
    back = (
        "((q, part) => getComputedStyle(document.querySelector(q), part ?? null).backgroundColor)"
    )
    page.wait("matchMedia('(forced-colors: active)').matches")
    page.run(
        "document.body.append(Object.assign(document.createElement('p'), "
        "{ id: 'highlight', style: 'background: Highlight; forced-color-adjust: none' }))"
    )
    assert page.run(f"{back}('#tabs [aria-selected=true]') === {back}('#highlight')")
    assert page.run(f"{back}('#tabs [aria-selected=false]') !== {back}('#highlight')")
    line = f"{back}('.handle-upright', '::before')"
    assert page.run(
        f"document.querySelector('.handle-upright') !== null && {line} !== {back}('body')"
    )
    assert page.errors == []


def test_runs_and_the_form_of_a_table_fit_a_telephone(opened: Opened, tmp_path: Path) -> None:
    for file in EXAMPLE.iterdir():
        if file.is_file():
            shutil.copy(file, tmp_path)
    page = opened(tmp_path / "recipe.toml")
    page.show(390, 844)
    cut = page.run(
        "[...document.querySelectorAll('#panel-runs > header :is(button, select, label)')].filter((e) => "
        "e.checkVisibility() && e.getBoundingClientRect().right > innerWidth).map((e) => e.textContent)"
    )
    assert cut == []
    page.wait("document.querySelector('.runs-lower canvas').getBoundingClientRect().height > 100")
    page.click("#tab-table")
    page.wait(
        "document.querySelector('.table-form input[type=text], .table-form select') !== null"
    )
    slim = page.run(
        "[...document.querySelectorAll('.table-form :is(label, input:not([type=checkbox]), select, .soft)')]"
        ".filter((e) => e.checkVisibility() && e.getBoundingClientRect().width < 100).map((e) => e.outerHTML)"
    )
    assert slim == []
    assert page.run("document.documentElement.scrollWidth <= innerWidth")
    assert page.errors == []


def test_a_tab_that_is_tapped_on_a_telephone_is_seen_whatever_part_was_chosen(
    opened: Opened, map_file: Path
) -> None:
    page = opened(map_file)
    page.show(390, 844)
    for part in ("section", "steps", "numbers"):
        page.click(f"#parts [data-part={part}]")
        page.click("#tab-compare")
        assert page.run(f"{SEEN}('panel-compare')"), part
        assert not page.run(
            "document.querySelector('#parts [data-part=section]').checkVisibility()"
        )
        page.click("#tab-view")
        assert page.run(f"{SEEN}('map')")


def test_a_sentence_that_comes_covers_neither_the_tabs_nor_undo(
    opened: Opened, map_file: Path
) -> None:
    page = opened(map_file)
    page.run("document.querySelector('#tools [data-tool=section]').click()")
    left, top, width, height = page.box("#map canvas")
    page.drag((left + 0.4 * width, top + 0.4 * height), (0.2 * width, 0.1 * height))
    page.wait("document.querySelector('.draw-field [data-key=a]') !== null")
    page.run(
        "(() => { const e = document.querySelector('.draw-field [data-key=a]'); e.value = 'abc';"
        "e.dispatchEvent(new Event('change')); })()"
    )
    page.wait("document.querySelector('#alerts .alert') !== null")
    for there in ("#undo", "#tab-report", "#panel-steps header", "#metrics"):
        x, y = page.middle(there)
        at = f"document.elementFromPoint({x}, {y})"
        assert page.run(f"{at}.closest('#alerts') === null"), there
