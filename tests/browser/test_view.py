"""What is shown comes back with the file; a result of the folder opens with the same recipe."""

from __future__ import annotations

import json
import time
import tomllib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser.conftest import FULL
from browser.test_folder import part

from metrosep.app.opening import autosave_path

pytestmark = pytest.mark.browser

Opened = Callable[..., Any]


def test_view_comes_back(opened: Opened, map_file: Path) -> None:
    page = opened(map_file)
    page.run("document.getElementById('colours').value = 'cividis'")
    page.run("document.getElementById('colours').dispatchEvent(new Event('change'))")
    page.drag(page.middle(".handle-point"), (60.0, 40.0))
    page.click("#tab-report")
    session = autosave_path(map_file)
    end = time.monotonic() + 20.0
    while not (session.is_file() and "report" in session.read_text()):
        assert time.monotonic() < end, "the view was not kept"
        time.sleep(0.1)
    view = tomllib.loads(session.read_text())["view"]
    assert view["tab"] == "report"
    assert view["colours"] == "cividis"
    assert page.run("document.getElementById('undo').disabled")
    again = opened(map_file, "document.querySelector('#tab-report[aria-selected=true]') !== null")
    assert again.run("document.getElementById('colours').value") == "cividis"
    assert tomllib.loads(session.read_text())["view"] == view


def test_a_file_of_the_folder_opens_with_the_recipe(opened: Opened, tmp_path: Path) -> None:
    for name, amplitude in (("bad", 2e-6), ("first", 0.4e-6)):
        part(tmp_path / f"{name}.x3p", amplitude)
    recipe = tmp_path / "limits.toml"
    recipe.write_text(
        'metrosep = 1\n[input]\nfiles = ["first.x3p"]\n[[step]]\nop = "form"\nform = "plane"\n'
        '[[step]]\nop = "parameters"\nnames = ["Sz"]\n'
        '[[check]]\nmetric = "Sz"\nupper = "1 um"\nU = "10 nm"\n'
    )
    page = opened(recipe)
    assert "Accepted" in page.text("#verdict")
    page.click("#tab-folder")
    page.click("#folder-start")
    page.wait("document.querySelectorAll('#panel-folder tbody tr').length === 2")
    page.click("#panel-folder tbody tr .link")
    page.wait("document.getElementById('title').textContent === 'bad.x3p'")
    page.wait("document.querySelector('#verdict.reject') !== null")


def waited_for(what: Callable[[], bool], words: str) -> None:
    """Wait until something on the disk holds."""
    end = time.monotonic() + 20.0
    while not what():
        assert time.monotonic() < end, words
        time.sleep(0.1)


def chosen(page: Any, session: Path, tab: str) -> None:
    """Choose a tab, and wait until the view that names it is kept."""
    page.click(f"#tab-{tab}")
    waited_for(
        lambda: session.is_file() and f'tab = "{tab}"' in session.read_text(),
        f"the view of {tab} was not kept",
    )


def reported(page: Any) -> str:
    """Return the report once it stands in its frame: it is of the present recipe."""
    page.wait("Boolean(document.querySelector('#panel-report').dataset.of)")
    return str(page.run("document.querySelector('#panel-report iframe').srcdoc"))


REPORTABLE = (
    'metrosep = 1\n[input]\nfiles = ["bowl.x3p"]\n[[step]]\nop = "form"\nform = "plane"\n'
    '[[step]]\nop = "parameters"\nnames = ["Sq", "Sz"]\n'
)


def test_the_report_appears_after_the_view_was_stored(opened: Opened, map_file: Path) -> None:
    recipe = map_file.with_name("bowl.toml")
    recipe.write_text(REPORTABLE)
    page = opened(recipe)
    session = autosave_path(recipe)
    chosen(page, session, "report")
    assert "Sz" in reported(page)
    chosen(page, session, "view")
    chosen(page, session, "report")
    assert "Sz" in reported(page)
    assert page.text("#alerts") == ""
    again = opened(recipe, "document.querySelector('#tab-report[aria-selected=true]') !== null")
    assert "Sz" in reported(again)  # begun in the report: its recipe has [view]
    assert "there is no report" not in again.text("#panel-report")


def test_the_table_is_written_after_the_view_was_stored(opened: Opened, tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    x = np.linspace(0.0, 50.0, 501)
    rows = ["run,x_mm,z_um"]
    for run in range(4):
        z = 2.0 * np.exp(-(((x - 15.0) / 4.0) ** 2)) + 2e-3 * rng.standard_normal(x.size)
        rows += [f"{run},{a:.6f},{b:.6f}" for a, b in zip(x, z, strict=True)]
    (tmp_path / "runs.csv").write_text("\n".join(rows) + "\n")
    recipe = tmp_path / "slide.toml"
    recipe.write_text(
        'metrosep = 1\n[input]\nfiles = ["runs.csv"]\nx = "x_mm"\nz = "z_um"\nrun = "run"\n'
        '[[step]]\nop = "separate"\nmethod = "mean"\n[[output]]\nkind = "table"\n'
        'controller = "csv"\naxis = "X"\ncompensates = "Z"\nspacing = "0.5 mm"\npath = "slide.txt"\n'
    )
    page = opened(recipe)
    session = autosave_path(recipe)
    chosen(page, session, "report")
    assert len(reported(page)) > 200
    chosen(page, session, "table")
    page.wait("document.querySelector('#table-export')?.disabled === false")
    assert "[view]" in session.read_text()
    page.click("#table-export")
    page.wait("document.querySelector('dialog [name=path]') !== null")
    page.click("dialog [value=yes]")
    waited_for((tmp_path / "slide.txt").is_file, f"no table: {page.text('#panel-table')[:300]}")
    values = [line.split(",") for line in (tmp_path / "slide.txt").read_text().splitlines()]
    assert len([row for row in values if row[0][:1].isdigit()]) == 101
    assert page.text("#alerts") == ""


BY_HAND = {
    "section of numbers": "section_mm = [1, 2]",
    "equal ends": "section_mm = [[1, 1], [1, 1]]",
    "one limit": "band_mm = [1]",
    "a date": "made = 2026-11-22\n[view.more]\nat = 03:00:00",
}


@pytest.mark.parametrize("line", BY_HAND.values(), ids=BY_HAND)
def test_a_view_written_by_hand_does_not_stop_the_page(
    opened: Opened, map_file: Path, line: str
) -> None:
    recipe = map_file.with_name("bowl.toml")
    recipe.write_text(f'{REPORTABLE}[view]\ncolours = "cividis"\n{line}\n')
    page = opened(recipe)
    page.wait("Number(document.body.dataset.sections) > 0")
    page.wait("Number(document.body.dataset.spectrums) > 0")
    page.wait("document.querySelector('#spectrum').innerText.includes('RMS inside')")
    assert page.text("#section-of") != ""
    assert page.text("#alerts") == ""
    assert page.run("document.getElementById('colours').value") == "cividis"  # what fits holds


def test_numbers_that_round_to_nothing_have_no_sign(opened: Opened, map_file: Path) -> None:
    page = opened(map_file)
    with_u = "import('/static/metrics.js').then((m) => m.withU({})[0])"
    assert page.run(with_u.format("-1e-9, 30e-6, 'rad'")) == "0\u2009µrad"
    assert page.run(with_u.format("1e-9, 30e-6, 'rad'")) == "0\u2009µrad"
    assert page.run(with_u.format("-12e-6, 30e-6, 'rad'")) == "\u221212\u2009µrad"
    assert page.run(with_u.format("-1.23456e-6, 30e-9, 'm'")) == "\u22121.235\u2009µm"


LINES = [
    ("a.csv; b.csv", "", ["a.csv", "b.csv"]),
    ('"a; b.csv"; c.csv', "", ["a; b.csv", "c.csv"]),
    ('"a;b.csv"', "", ["a;b.csv"]),
    ("a;b.csv", "a;b.csv", ["a;b.csv"]),  # what was offered is one file
    ('say "hi".csv', "", ['say "hi".csv']),
    ("a.csv;", "", ["a.csv"]),
    (" ; ", "", []),
]


def test_paths_of_a_line(opened: Opened, map_file: Path) -> None:
    page = opened(map_file, "document.getElementById('title') !== null")
    for text, offered, paths in LINES:
        script = f"m.pathsOf({json.dumps(text)}, {json.dumps(offered)})"
        assert page.run(f"import('/static/dialogs.js').then((m) => {script})") == paths, text


def test_a_matrix_with_a_semicolon_in_its_name_is_opened(opened: Opened, map_file: Path) -> None:
    z = np.random.default_rng(4).normal(size=(20, 30))
    file = map_file.with_name("part; left.txt")
    file.write_text("\n".join(" ".join(f"{v:.5f}" for v in row) for row in z) + "\n")
    page = opened(map_file)
    page.click("#open")
    page.wait("document.querySelector('dialog [name=path]') !== null")
    page.fill("dialog [name=path]", f'"{file}"')
    page.click("dialog [value=yes]")
    page.wait("document.querySelector('dialog [name=lateral_step]') !== null")
    page.fill("dialog [name=unit]", "um")
    page.fill("dialog [name=lateral_step]", "3 um")
    page.click("dialog [value=yes]")
    page.wait("document.getElementById('title').textContent === 'part; left.txt'")
    assert page.run("document.body.dataset.kind") == "map"
    assert page.text("#alerts") == ""


def test_alt_arrows_go_back_through_what_was_looked_at_and_leave_the_recipe(
    opened: Opened, map_file: Path
) -> None:
    page = opened(map_file)
    recipe = (
        "document.querySelectorAll('[data-step]').length + document.getElementById('undo').title"
    )
    rest = 0.8  # s: a state is kept when it has rested

    def alt(key: str) -> None:
        page.run("document.activeElement.blur()")
        page.press(key, alt=True)

    time.sleep(rest)
    ruler = "document.querySelector('.map-ruler').textContent + document.querySelector('.map-ruler').style.width"
    whole, before = page.run(ruler), page.run(recipe)
    x, y = page.middle("#map canvas")
    page.call("Input.dispatchMouseEvent", type="mouseWheel", x=x, y=y, deltaX=0, deltaY=-300)
    page.wait(f"({ruler}) !== {whole!r}")
    near = page.run(ruler)
    time.sleep(rest)
    page.click('[data-step="0"] .pick')
    page.wait("document.getElementById('map-stage').textContent.includes('step 1')")
    time.sleep(rest)
    page.click("#tab-report")
    time.sleep(rest)
    alt("ArrowLeft")
    page.wait("document.body.dataset.tab === 'view'")
    alt("ArrowLeft")
    page.wait("document.getElementById('map-stage').textContent === 'after all steps'")
    assert page.run(ruler) == near
    alt("ArrowLeft")
    page.wait(f"({ruler}) === {whole!r}")
    for _ in range(3):
        alt("ArrowRight")
    page.wait("document.body.dataset.tab === 'report'")
    assert page.run(recipe) == before
    assert page.errors == []


def test_a_map_without_scale_reads_in_px_and_gets_its_scale_by_a_known_length(
    opened: Opened, tmp_path: Path
) -> None:
    from metrosep import Surface
    from metrosep.io.write import write

    y, x = np.mgrid[0:120, 0:200]
    write(Surface(20e-9 * np.cos(x / 3.0) + 1e-9 * y), tmp_path / "px.h5")
    page = opened(tmp_path / "px.h5")
    page.wait("document.getElementById('spectrum').textContent.includes('px to')")
    length = "document.getElementById('section-of').textContent"
    page.wait(f"{length}.includes('168.0')")
    assert page.run(
        "!/[0-9.]\\u2009[nµmk]?m/.test(document.getElementById('section-of').textContent)"
    )
    page.run(
        "(() => { const s = document.querySelector('#lower'); s.value = 'waves2d'; s.dispatchEvent(new Event('change')); })()"
    )
    page.wait(
        "/ring .*px to .*px +peak λ .*px/.test(document.querySelector('#waves2d .readout').textContent)"
    )
    assert page.run("document.querySelector('#waves2d .fourier-bar').hidden")  # a filter waits
    page.click("#no-scale button")
    page.wait("document.querySelector('dialog[open]') !== null")
    page.fill("dialog [name=known]", "0.504 mm")
    page.click("dialog [value=yes]")
    page.wait(FULL)
    page.wait(f"{length}.includes('504.0\\u2009µm')")
    assert page.run("document.getElementById('no-scale').hidden")
    page.click("#undo")
    page.wait(f"{length}.includes('168.0\\u2009px')")
    assert page.errors == []


def test_inches_and_colours_are_preferred_for_every_file_and_start(
    opened: Opened, map_file: Path
) -> None:
    """Another start has another port; the numbers are those of the metric page over 25.4 mm."""
    page = opened(map_file)
    row = "document.querySelector('[data-metric=PV] td:nth-child(2)').textContent"
    metric = float(page.run(row).removesuffix("\u2009µm"))

    def choose(which: str, value: str) -> None:
        with suppress(RuntimeError):  # the page is loaded anew
            page.run(
                f"(() => {{ const e = document.getElementById('{which}'); e.value = '{value}';"
                "e.dispatchEvent(new Event('change')); })()"
            )

    try:
        choose("colours", "cividis")
        choose("lengths", "inch")
        page.wait(f"document.querySelector('[data-metric=PV]') && {row}.endsWith('µin')")
        page.wait("document.querySelector('#status-full.done') !== null")
        inches = page.run(row)
        assert float(inches.removesuffix("\u2009µin")) == pytest.approx(
            metric / 25.4e-3, rel=1e-3, abs=0.0
        )
        assert page.text("#colourbar").startswith("µin")
        ticks = page.run(
            "[...document.querySelectorAll('.colourbar-labels span')].map((e) => e.textContent)"
        )
        assert all(float(t.replace("\u2212", "-")) % 50 == 0 for t in ticks)  # round in inches
        assert "in" in page.text("#section-of")
        page.run("new Promise((done) => setTimeout(done, 1200))")  # the view is kept
        page = opened(map_file.rename(map_file.with_name("other.x3p")))
        assert page.run(row) == inches
        assert page.run("document.getElementById('colours').value") == "cividis"
    finally:
        choose("colours", "viridis")
        choose("lengths", "metric")
        page.wait(f"document.querySelector('[data-metric=PV]') && {row}.endsWith('µm')")
    assert page.errors == []
