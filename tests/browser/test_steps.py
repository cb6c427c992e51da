"""Steps by hand: forms by tiles with typed fields, filters whose keys follow their kind; no grammar."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from browser.test_work import choose, settled

pytestmark = pytest.mark.browser

Opened = Callable[..., Any]


def step(page: Any, number: int) -> dict[str, Any]:
    page.click("#recipe")
    text = str(page.run("document.querySelector('dialog pre').textContent"))
    page.run("document.querySelector('dialog').close()")
    return dict(tomllib.loads(text)["step"][number])


def test_a_form_is_chosen_by_its_tile_and_its_values_are_typed(
    opened: Opened, map_file: Path
) -> None:
    page = opened(map_file)
    page.click('[data-step="0"] .pick')
    assert page.run("document.querySelectorAll('.tile').length") == 12
    assert (
        page.run("document.querySelector('[data-form=plane]').getAttribute('aria-checked')")
        == "true"
    )
    drawn = page.run(
        "new Set([...document.querySelectorAll('.tile canvas')].map((c) => c.toDataURL())).size"
    )
    assert drawn == 12  # each has a picture of its own
    settled(page, lambda: page.click("[data-form=sphere]"))
    assert step(page, 0)["form"] == "sphere"
    page.fill('[data-field="R"]', "200 mm")
    settled(page, lambda: page.press("Tab"))
    assert step(page, 0)["form"] == "sphere: R=200 mm"
    settled(page, lambda: page.click("[data-form=polynomial]"))
    assert step(page, 0)["form"] == "polynomial: degree=2"
    page.run("document.querySelector('[data-form=polynomial]').focus()")
    page.press("ArrowRight")
    settled(page, lambda: page.press("Enter"))
    assert step(page, 0)["form"] == "zernike: terms=36"
    page.click("[data-form=qforbes]")  # it needs its aperture: nothing is made yet
    assert page.run("document.activeElement.dataset.field") == "radius"
    assert step(page, 0)["form"] == "zernike: terms=36"
    page.fill('[data-field="radius"]', "3.2 mm")
    settled(page, lambda: page.press("Tab"))
    assert step(page, 0)["form"] == "qforbes: terms=5, radius=3.2 mm"
    assert page.errors == []


def test_a_wrong_unit_is_refused_in_words_and_goes_back(opened: Opened, map_file: Path) -> None:
    page = opened(map_file)
    page.click('[data-step="0"] .pick')
    settled(page, lambda: page.click("[data-form=sphere]"))
    page.fill('[data-field="R"]', "200")
    page.press("Tab")
    page.wait("document.getElementById('alerts').textContent.includes('unit')")
    assert step(page, 0)["form"] == "sphere"
    assert page.run("document.querySelector('[data-field=R]').value") == ""


def test_another_kind_of_filter_takes_the_length_over_and_drops_the_rest(
    opened: Opened, map_file: Path
) -> None:
    page = opened(map_file)

    settled(page, lambda: choose(page, "#add-step", "filter"))
    first = step(page, 1)
    assert first["op"] == "filter"
    shown = page.run(
        "[...document.querySelectorAll('.editor [data-key]')].map((e) => e.dataset.key)"
    )
    assert "radius" not in shown  # of a closing
    settled(page, lambda: choose(page, ".editor [data-key=kind]", "spline"))
    assert step(page, 1) == {"op": "filter", "kind": "spline", "cutoff": first["lambda_c"]}
    settled(page, lambda: choose(page, ".editor [data-key=kind]", "closing"))
    assert step(page, 1) == {"op": "filter", "kind": "closing", "radius": first["lambda_c"]}
    page.run("document.activeElement.blur()")
    settled(page, lambda: page.press("z"))
    assert step(page, 1)["kind"] == "spline"
    assert page.errors == []


def test_a_step_that_fails_leaves_the_map_before_it_and_says_so(
    opened: Opened, map_file: Path
) -> None:
    page = opened(map_file)
    page.wait("document.getElementById('map-stage').textContent.startsWith('after')")
    page.click('[data-step="0"] .pick')
    page.click("[data-form=sine_grid]")  # it needs its amplitude: nothing is made yet
    assert step(page, 0)["form"] != "sine-grid"
    page.press("Escape")
    settled(page, lambda: choose(page, "#add-step", "filter"))
    page.fill("[data-key=lambda_c]", "0.001 mm")
    page.press("Tab")
    page.wait("document.querySelector('.step.failed') !== null")
    page.wait("document.getElementById('map-stage').textContent.includes('failed')")
    assert page.text("#map-stage") == "after step 1, form: step 2, filter, failed"
    assert page.run("document.getElementById('map-message').hidden")
    assert page.text("#verdict") == "No verdict: step 2 failed"
    assert (
        page.run("document.querySelector('[data-metric=Sq] td:nth-child(2)').textContent") == "–"
    )
    page.click('[data-step="1"] .pick')  # all steps again: the same map
    page.wait("document.getElementById('map-stage').textContent.includes('failed')")
    assert page.errors == []
