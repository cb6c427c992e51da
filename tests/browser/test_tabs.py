"""Ranking, report and comparison: what the tabs show is what the library gives."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import metrosep as ms

pytestmark = pytest.mark.browser

FULL = "document.querySelector('#status-full.done') !== null"
LONG = 120.0
"""Seconds: the figures of a report, on a busy computer."""
EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "fts_lathe"

Opened = Callable[..., Any]


def settled(page: Any, act: Callable[[], Any]) -> None:
    """Do something that edits the recipe, and wait for the full result."""
    before = page.run("document.body.dataset.full ?? ''")
    act()
    page.wait(f"document.body.dataset.full !== {json.dumps(before)}")
    page.wait(FULL)


def terms(page: Any) -> list[str]:
    """Return the terms of the ranking, from above."""
    found: list[str] = page.run(
        "[...document.querySelectorAll('.ranking tbody tr')].map((r) => r.dataset.row)"
    )
    return found


@pytest.fixture
def lathe(tmp_path: Path) -> Path:
    """The example of a fast tool servo on a lathe."""
    folder = tmp_path / "lathe"
    shutil.copytree(EXAMPLE, folder)
    return folder / "recipe.toml"


def wait_terms(page: Any, first: str) -> None:
    page.wait(f"document.querySelector('.ranking tbody tr')?.dataset.row === {json.dumps(first)}")
    page.wait("!document.querySelector('#panel-ranking .outdated')")


# ---- ranking ---------------------------------------------------------------------------------


def test_ranking_is_edited_in_place_and_undone(opened: Opened, lathe: Path) -> None:
    page = opened(lathe)
    wait_terms(page, "B0Z")
    assert terms(page)[:3] == ["B0Z", "EXX", "EYX"]
    assert "82.28\u2009nm" in page.text("[data-row=B0Z] .ranking-cell")  # papers.md 4.3: 82.3
    assert "82.0\u2009%" in page.text("[data-row=B0Z]")
    assert page.run("document.querySelector('[data-size=B0Z]').value") == "0.001 deg"
    assert "EZX" in page.text(".ranking-hidden")

    settled(page, lambda: page.click("[data-term=B0Z]"))  # off
    wait_terms(page, "EXX")
    assert "B0Z" in page.text(".ranking-hidden")
    settled(page, lambda: page.click(".ranking-hidden [data-term=B0Z]"))
    wait_terms(page, "B0Z")

    page.run("document.querySelector('[data-size=EXX]').value = ''")
    settled(page, lambda: (page.fill("[data-size=EXX]", "4 um"), page.press("Enter")))
    wait_terms(page, "EXX")
    assert "132.1\u2009nm" in page.text("[data-row=EXX] .ranking-cell")
    assert 'EXX = "4 um"' in page.run(
        "document.querySelector('#recipe').click(), document.querySelector('dialog pre').textContent"
    )
    page.press("Escape")
    page.run("document.activeElement.blur()")
    settled(page, lambda: page.press("z"))
    wait_terms(page, "B0Z")
    assert page.errors == []


def test_a_size_that_no_machine_has_is_refused_and_mended_in_place(
    opened: Opened, lathe: Path
) -> None:
    page = opened(lathe)
    wait_terms(page, "B0Z")
    page.fill("[data-size=EXX]", "20 mm")
    page.press("Enter")
    page.wait("document.querySelector('.ranking-state').textContent.includes('beyond 10 mm')")
    assert page.run("document.querySelector('#panel-ranking .outdated') !== null")
    page.fill("[data-size=EXX]", "20 um")
    page.press("Enter")
    wait_terms(page, "EXX")
    assert page.text(".ranking-state") == ""


def test_ranking_by_wavefront_is_an_edit(opened: Opened, lathe: Path) -> None:
    page = opened(lathe)
    wait_terms(page, "B0Z")
    form = page.text("[data-row=EXX] .ranking-cell")
    settled(page, lambda: page.click("#panel-ranking input[value=wavefront]"))
    page.wait("document.querySelector('#panel-ranking input[value=wavefront]').checked")
    page.wait("!document.querySelector('#panel-ranking .outdated')")
    assert page.text("[data-row=EXX] .ranking-cell") != form
    page.click("#panel-ranking [data-sort=term]")
    assert terms(page) == sorted(terms(page))


# ---- report ----------------------------------------------------------------------------------


def test_report_is_shown_without_scripts_and_written(opened: Opened, map_file: Path) -> None:
    from metrosep.io.read import read
    from metrosep.recipe.recipe import Recipe
    from metrosep.report import render_html

    page = opened(map_file)
    page.click("#tab-report")
    page.wait(
        "document.querySelector('#panel-report').dataset.of === document.body.dataset.full", LONG
    )
    frame = "document.querySelector('.report-frame')"
    assert page.run(f"{frame}.getAttribute('sandbox')") == ""
    text = page.run(
        "document.querySelector('#recipe').click(), document.querySelector('dialog pre').textContent"
    )
    page.press("Escape")
    result = Recipe.parse(text, name="bowl.toml", folder=map_file.parent).run([map_file])
    assert read(map_file).z.size == 360_000
    assert page.run(f"{frame}.srcdoc") == render_html(result.document)
    assert not page.run("document.querySelector('#report-make').disabled")

    page.click("#report-make")
    page.press("Enter")
    page.wait("document.querySelector('#status-link').textContent.startsWith('written')")
    assert (map_file.parent / "bowl_report.html").read_text("utf-8") == render_html(
        result.document
    )
    assert page.errors == []
    assert [
        r
        for r in page.requests
        if not r.startswith(("http://127.0.0.1", "ws://127.0.0.1", "data:", "about:"))
    ] == []


def test_report_is_not_made_of_an_outdated_result(opened: Opened, map_file: Path) -> None:
    page = opened(map_file)
    page.click("#tab-report")
    page.wait(
        "document.querySelector('#panel-report').dataset.of === document.body.dataset.full", LONG
    )
    page.run(
        """(() => {
          window.seen = [];
          const make = document.querySelector('#report-make');
          new MutationObserver(() => window.seen.push(make.disabled)).observe(make, { attributes: true });
        })()"""
    )
    settled(page, lambda: page.click('[aria-label="Step 1, form: on"]'))
    page.wait(
        "document.querySelector('#panel-report').dataset.of === document.body.dataset.full", LONG
    )
    assert page.run("window.seen")[0] is True
    assert not page.run("document.querySelector('#report-make').disabled")


# ---- compare ---------------------------------------------------------------------------------


def pin(page: Any, name: str) -> None:
    page.click("#compare-pin")
    page.fill("dialog input[name=label]", name)
    page.press("Enter")
    page.wait(f"document.querySelector('#compare-with').value === {json.dumps(f'pin {name}')}")


def test_pinned_result_beside_the_present_one(opened: Opened, map_file: Path) -> None:
    page = opened(map_file)
    page.click("#tab-compare")
    pin(page, "with form")
    page.wait("document.querySelector('.compare tbody tr') !== null")
    assert "the same" in page.text('.compare [data-metric="Sz"]')
    settled(page, lambda: page.click('[aria-label="Step 1, form: on"]'))
    page.wait(
        "document.querySelector('#panel-compare').dataset.of === document.body.dataset.full", LONG
    )
    page.wait("document.querySelector('.compare-picture').dataset.drawn === 'map'")
    row = page.text('.compare [data-metric="Sz"]')
    assert "U not known" in row
    assert "enabled = false" in page.text(".diff")
    assert "difference map: P-V" in page.text(".difference-title")
    drawn = page.run(
        """(() => { const c = document.querySelector('.compare-picture .map canvas');
          const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;
          const seen = new Set();
          for (let i = 0; i < d.length; i += 404) seen.add(`${d[i]},${d[i + 1]},${d[i + 2]}`);
          return seen.size; })()"""
    )
    assert drawn > 20  # a plane of many colours
    page.click("#compare-unpin")
    page.wait("document.querySelector('#compare-with').value === ''")
    assert page.errors == []


def test_two_maps_side_by_side_share_window_and_cursor(opened: Opened, map_file: Path) -> None:
    page = opened(map_file)
    page.click("#tab-compare")
    pin(page, "with form")
    settled(page, lambda: page.click('[aria-label="Step 1, form: on"]'))
    page.wait("document.querySelector('.compare-picture').dataset.drawn === 'map'", LONG)
    page.click(".compare-picture > button")
    page.wait("document.querySelector('.side-row').dataset.drawn === '2'")
    names = page.run("[...document.querySelectorAll('.side-row p')].map((e) => e.textContent)")
    assert names == ["with form", "present"]
    left, top, width, height = page.box(".side-row > div:first-child canvas")
    page.mouse("mouseMoved", left + 0.4 * width, top + 0.45 * height)
    reads = page.run(
        "[...document.querySelectorAll('.side-row .map-readout')].map((e) => e.textContent.split('   '))"
    )
    assert reads[0][:2] == reads[1][:2]  # x and y
    assert reads[0][2] != reads[1][2]  # the bowl is there in one of them alone
    assert (
        page.run("document.querySelector('.side-row > div:nth-child(2) .map-cross').hidden")
        is False
    )
    page.call("Input.dispatchMouseEvent", type="mouseWheel", x=left + 0.4 * width, y=top + 0.45 * height,
              deltaX=0, deltaY=-400)  # fmt: skip
    page.wait(
        "(([a, b]) => a && a === b)([...document.querySelectorAll('.side-row .map-ruler')].map((e) => e.textContent + e.style.width))"
    )
    page.wait("document.querySelector('.side-row .colourbar-unit').textContent.endsWith('m')")
    page.run("document.querySelector('.side-row .colourbar .handle').focus()")
    pictures = "[...document.querySelectorAll('.side-row .map canvas')].map((c) => c.toDataURL())"
    page.run(f"void (window.was = {pictures})")
    page.press("ArrowUp", shift=True)
    page.press("ArrowUp", shift=True)
    page.wait(f"{pictures}.every((one, i) => one !== window.was[i])", 20)  # one bar for both
    assert page.errors == []


def test_another_file_is_chosen_from_the_list(
    opened: Opened, map_file: Path, tmp_path: Path
) -> None:
    (tmp_path / "second.x3p").write_bytes(map_file.read_bytes())
    page = opened(map_file)
    page.click("#tab-compare")
    page.run(
        "(() => { const e = document.getElementById('compare-with'); e.value = 'files';"
        "e.dispatchEvent(new Event('change')); })()"
    )
    page.wait("document.querySelector('dialog [data-path$=\"second.x3p\"]') !== null")
    page.click('dialog [data-path$="second.x3p"]')
    assert page.run("document.querySelector('dialog input[name=path]').value").endswith(
        "second.x3p"
    )
    page.click("dialog [value=yes]")
    page.wait("document.querySelector('.compare tbody tr') !== null", LONG)
    assert "the same" in page.text('.compare [data-metric="Sz"]')
    names = page.run(
        "[...document.querySelectorAll('.compare tbody tr')].map((e) => e.dataset.metric)"
    )
    pictures = [i for i, name in enumerate(names) if name.startswith("chart.")]
    known = [i for i, name in enumerate(names) if not name.startswith("chart.")]
    assert not pictures or min(known) < min(pictures)
    assert page.errors == []


def test_a_file_that_is_followed_behind_a_comparison_leaves_nothing_to_compare(
    opened: Opened, tmp_path: Path
) -> None:
    y, x = np.mgrid[0:120, 0:160]

    def wave(name: str, step: float) -> Path:
        z = 1e-8 * np.cos(x / step) + 1e-9 * y
        return ms.write(ms.Surface(z, 2e-6, 3e-6), tmp_path / name)

    page, other = opened(wave("a.sdf", 5.0)), wave("b.sdf", 6.0)
    page.click("#tab-compare")
    page.run(
        "(() => { const s = document.querySelector('#compare-with'); s.value = 'files'; s.dispatchEvent(new Event('change')); })()"
    )
    page.wait("document.querySelector('dialog input[name=path]') !== null")
    page.fill("dialog input[name=path]", str(other))
    page.press("Enter")
    page.wait("document.querySelector('.compare-picture').dataset.drawn === 'map'", LONG)
    page.click(".compare-picture > button")
    page.wait("document.querySelector('.side-row').dataset.drawn === '2'")
    page.click("#tab-view")
    page.run(
        "(() => { const e = document.getElementById('follow'); e.value = 'file'; e.dispatchEvent(new Event('change')); })()"
    )
    page.run("new Promise((done) => setTimeout(done, 2500))")
    wave("a.sdf", 7.0)
    page.wait("document.querySelector('.compare-picture').hidden", LONG)
    page.run("new Promise((done) => setTimeout(done, 600))")
    assert page.text("#alerts") == ""
    assert page.errors == []


def runs_file(path: Path, amplitude: float) -> Path:
    """Three runs with a wave that keeps its place."""
    rng = np.random.default_rng(8)
    x = np.linspace(0.0, 40e-3, 401)
    rows = ["run,x_mm,z_um"]
    for k in range(3):
        z = amplitude * np.sin(2 * np.pi * x / 8e-3) + 2e-9 * rng.standard_normal(x.size)
        rows += [f"{k},{1e3 * a:.6g},{1e6 * b:.8g}" for a, b in zip(x, z, strict=True)]
    path.write_text("\n".join(rows) + "\n", "ascii")
    return path


def test_another_file_by_the_same_recipe_is_overlaid(opened: Opened, tmp_path: Path) -> None:
    runs_file(tmp_path / "a.csv", 1e-6)
    other = runs_file(tmp_path / "b.csv", 0.4e-6)
    recipe = tmp_path / "mean.toml"
    recipe.write_text(
        'metrosep = 1\n[input]\nfiles = ["a.csv"]\nx = "x_mm"\nz = "z_um"\nrun = "run"\n'
        '[[step]]\nop = "separate"\nmethod = "mean"\n',
        "utf-8",
    )
    page = opened(recipe)
    page.click("#tab-compare")
    page.wait("document.querySelector('#compare-with option[value=files]') !== null")
    page.run(
        "(() => { const s = document.querySelector('#compare-with'); s.value = 'files'; s.dispatchEvent(new Event('change')); })()"
    )
    page.wait("document.querySelector('dialog input[name=path]') !== null")
    page.fill("dialog input[name=path]", str(other))
    page.press("Enter")
    page.wait("document.querySelector('.compare-picture').dataset.drawn === 'curves'", LONG)
    assert "curve.error" in page.text(".compare tbody")
    assert page.text(".compare-picture").count("b.csv") == 3  # side by side, overlaid, difference
    assert "The recipes are the same." in page.text(".compare-rows")
    assert page.errors == []


# ---- machine ---------------------------------------------------------------------------------


def test_a_calibration_shows_terms_residuals_and_the_volumetric_error(
    opened: Opened, tmp_path: Path
) -> None:
    folder = tmp_path / "mill"
    shutil.copytree(EXAMPLE.parent / "five_axis_calibration", folder)
    page = opened(folder / "recipe.toml")
    page.click("#tab-machine")
    page.wait("document.querySelector('.machine-map') !== null", LONG)
    assert page.text("[data-term=B0A]").startswith("B0A")
    assert "µrad" in page.text("[data-term=B0A]")
    titles = page.run("[...document.querySelectorAll('.machine h2')].map((h) => h.textContent)")
    assert titles[0] == "Terms, actual minus nominal"
    assert "Residuals in the order of time" in titles
    # the picture has two ends of its scale, and more than one colour
    colours = page.run(
        "(() => { const c = document.querySelector('.machine-map'); const d = c.getContext('2d')"
        ".getImageData(0, 0, c.width, c.height).data; return new Set([...d].filter((_, i) => i % 4 === 1)).size; })()"
    )
    assert colours > 10
    assert page.errors == []


COLOURED = """(() => { const c = document.querySelector('.machine-round');
 const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;
 const want = getComputedStyle(document.documentElement).getPropertyValue('--feed-0').match(/\\w\\w/g).map((h) => parseInt(h, 16));
 const found = []; for (let i = 0; i < d.length; i += 4)
 if (d[i + 3] > 200 && want.every((v, k) => Math.abs(d[i + k] - v) < 30)) found.push([(i / 4) % c.width, Math.floor(i / 4 / c.width)]);
 return found; })()"""


def test_a_spindle_stands_about_a_circle_and_its_centre_is_an_edit(
    opened: Opened, tmp_path: Path
) -> None:
    folder = tmp_path / "spindle"
    folder.mkdir()
    turn = np.arange(90) * 4.0  # ten revolutions, outward by 100 nm at 90 degrees alone
    bump = 100.0 * np.exp(-(((turn - 90.0) / 12.0) ** 2))
    rows = [
        f"{a + 360.0 * k:g},{z + k % 2:.3f}"
        for k in range(10)
        for a, z in zip(turn, bump, strict=True)
    ]
    (folder / "s.csv").write_text("\n".join(["angle_deg,gap_nm", *rows]) + "\n")
    recipe = folder / "recipe.toml"
    recipe.write_text(
        'metrosep = 1\n[input]\nfiles = ["s.csv"]\nreadings = ["gap_nm"]\nangle = "angle_deg"\n'
        '[[step]]\nop = "iso230_7"\ndirection = "radial"\n'
    )
    page = opened(recipe)
    page.click("#tab-machine")
    page.wait("document.querySelector('.machine-round') !== null", LONG)
    page.wait(f"{COLOURED}.length > 100", LONG)
    places = np.array(page.run(COLOURED))
    top, bottom = places[:, 1].min(), places[:, 1].max()
    middle = page.run("document.querySelector('.machine-round').height") / 2
    assert middle - top > 1.3 * (
        bottom - middle
    )  # angles rise counter-clockwise: 90 degrees is up
    choose = (
        "(() => { const s = document.querySelector('.machine-centre select'); s.value = 'MIC';"
        " s.dispatchEvent(new Event('change')); })()"
    )
    settled(page, lambda: page.run(choose))
    page.wait("document.querySelector('.machine-centre select').value === 'MIC'", LONG)
    assert 'center = "MIC"' in page.run(
        "document.querySelector('#recipe').click(), document.querySelector('dialog pre').textContent"
    )
    page.press("Escape")
    page.run("document.activeElement.blur()")
    settled(page, lambda: page.press("z"))
    page.wait("document.querySelector('.machine-centre select').value === 'LSC'", LONG)
    assert page.errors == []
