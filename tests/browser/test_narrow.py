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
SMALL = """[...document.querySelectorAll('#topbar button, #tabs button, #parts button, #tools button, .panel > header button')]
.filter((e) => e.offsetWidth && (e.offsetWidth < 24 || e.offsetHeight < 24)).map((e) => e.id || e.textContent)"""


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
