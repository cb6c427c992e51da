"""Runs by hand: handles that are one edit each, numbers of the library, gaps that stay open."""

from __future__ import annotations

import json
import re
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.browser

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "motion_error_fourier"
DONE = "document.body.dataset.runs && document.querySelector('#status-full.done') !== null"
PREFIXES = {"p": 1e-12, "n": 1e-9, "µ": 1e-6, "m": 1e-3, "": 1.0}

Opened = Callable[..., Any]


@pytest.fixture
def recipe(tmp_path: Path) -> Path:
    """Kono's recipe of the example, its shortest wavelength stated, six runs at three feedrates."""
    for name in ("recipe.toml", "runs_y.csv"):
        shutil.copy(EXAMPLE / name, tmp_path / name)
    return tmp_path / "recipe.toml"


def text_of(page: Any) -> str:
    """Return the recipe as the page has it."""
    page.click("#recipe")
    text = str(page.wait("document.querySelector('dialog[open] pre')?.textContent"))
    page.press("Escape")
    page.wait("document.querySelector('dialog[open]') === null")
    return text


def separated(page: Any, act: Callable[[], Any]) -> None:
    """Do something that edits the recipe, and wait until it has been separated anew."""
    before = page.run("document.body.dataset.runs")
    act()
    page.wait(f"document.body.dataset.runs !== {json.dumps(before)}")
    page.wait(DONE)


def changed_lines(before: str, after: str) -> list[str]:
    """Return the lines of a recipe that are new, comments off."""
    old = set(before.splitlines())
    return [line.split("#")[0].strip() for line in after.splitlines() if line not in old]


def undo(page: Any) -> None:
    page.run("document.activeElement.blur()")
    separated(page, lambda: page.press("z"))


def printed(page: Any, metric: str) -> tuple[float, float]:
    """Return a value of the table in m, and half of its last digit."""
    text = page.text(f'[data-metric="{metric}"] td:nth-child(2)')
    found = re.fullmatch(r"(\d+)(?:\.(\d+))?\u2009([pnµm]?)m", text)
    assert found, text
    whole, decimals, prefix = found.groups()
    factor = PREFIXES[prefix]
    return float(f"{whole}.{decimals or 0}") * factor, 0.5 * 10.0 ** -len(
        decimals or ""
    ) * factor * (1 + 1e-9)


def test_the_numbers_are_those_of_the_library_to_the_printed_digit(
    opened: Opened, recipe: Path
) -> None:
    from metrosep.recipe import Recipe

    want = Recipe.load(recipe).run(None)
    page = opened(recipe, DONE)

    for metric, value in (
        ("pv", want.estimate.peak_to_valley().value),
        ("residual_rms", want.estimate.residual_rms),
    ):
        shown, half = printed(page, metric)
        assert abs(shown - value) <= half, metric
    assert f"m = {want.estimate.audit['m']} waves" in page.text("#runs-words")
    assert "4800 mm/min" in page.text(".runs-legend")
    assert "travel that all runs share" in page.text("#runs-part")
    assert page.errors == []


def test_the_shortest_wavelength_by_mouse_is_one_edit(opened: Opened, recipe: Path) -> None:
    page = opened(recipe, DONE)
    before, done = text_of(page), page.run("document.body.dataset.runs")
    x, y = page.middle("#run-waves [data-handle=shortest]")
    page.mouse("mouseMoved", x, y)
    page.mouse("mousePressed", x, y)
    for k in range(1, 61):
        page.mouse("mouseMoved", x + k, y, held=True)

    held = page.text("#run-waves .readout")
    time.sleep(0.4)  # longer than any delay of the page
    assert page.run("document.body.dataset.runs") == done  # nothing is computed while it moves
    assert page.run("document.querySelector('#undo').disabled")
    separated(page, lambda: page.mouse("mouseReleased", x + 60, y))

    (line,) = changed_lines(before, text_of(page))
    found = re.fullmatch(r'shortest = "([\d.]+) mm"', line)
    assert found, line
    shown = re.search(r"([\d.]+)\u2009mm", held)
    assert shown, held
    assert 4.0 < float(found[1]) < 10.0
    assert abs(float(found[1]) - float(shown[1])) < 0.02 * float(found[1])
    undo(page)
    assert text_of(page) == before
    assert page.errors == []


def test_the_shortest_wavelength_by_keys_is_one_edit(opened: Opened, recipe: Path) -> None:
    page = opened(recipe, DONE)
    before = text_of(page)
    page.run("document.querySelector('#run-waves [data-handle=shortest]').focus()")

    def walk() -> None:
        for _ in range(4):
            page.press("ArrowRight", shift=True)

    separated(page, walk)
    (line,) = changed_lines(before, text_of(page))
    assert float(line.split('"')[1].split()[0]) > 4.0
    undo(page)
    assert text_of(page) == before


def test_the_old_curves_stay_greyed_until_the_new_ones_come(opened: Opened, recipe: Path) -> None:
    page = opened(recipe, DONE)
    page.click("#panel-runs input[value=separated]")
    page.run(
        """(() => {
          window.seen = [];
          const look = () => window.seen.push([
            document.querySelector('#run-curves').classList.contains('stale'),
            document.querySelector('#run-curves .plot-busy').textContent,
            document.querySelector('#run-waves').classList.contains('stale'),
          ]);
          new MutationObserver(look).observe(document.querySelector('#panel-runs'),
            { subtree: true, childList: true, attributes: true });
        })()"""
    )

    def one_step() -> None:
        page.run("document.querySelector('#run-waves [data-handle=shortest]').focus()")
        page.press("ArrowRight", shift=True)

    separated(page, one_step)
    seen = page.run("window.seen")
    assert [True, "computing…", True] in seen
    page.wait("!document.querySelector('#run-curves').classList.contains('stale')")
    assert page.text("#run-curves .plot-busy") == ""


def test_a_threshold_is_moved_and_m_is_shown(opened: Opened, recipe: Path) -> None:
    page = opened(recipe, DONE)
    separated(page, lambda: page.click("#runs-automatic"))
    before = text_of(page)
    assert "shortest" not in [line.split(" =")[0] for line in before.splitlines()]
    m = page.text("#runs-words").split(" waves")[0]
    page.run(
        """(() => { const s = document.querySelector('#runs-statistic'); s.value = '1';
          s.dispatchEvent(new Event('change')); })()"""
    )
    page.run("document.querySelector('#run-evidence [data-handle=threshold]').focus()")

    def up() -> None:
        for _ in range(3):
            page.press("ArrowUp", shift=True)

    separated(page, up)
    (line,) = changed_lines(before, text_of(page))
    key, value = line.split(" = ")
    assert key == "p_t"
    assert 1e-8 < float(value) < 1e-6  # up is more, in m
    assert page.text("#runs-words").split(" waves")[0] != m
    start = page.middle("#run-evidence [data-handle=threshold]")
    separated(page, lambda: page.drag(start, (0.0, 30.0)))
    (line,) = changed_lines(before, text_of(page))
    assert float(line.split(" = ")[1]) < float(value)  # down is less
    undo(page)
    undo(page)
    assert text_of(page) == before


def test_a_threshold_that_nothing_passes_is_told_and_taken_back(
    opened: Opened, recipe: Path
) -> None:
    page = opened(recipe, DONE)
    separated(page, lambda: page.click("#runs-automatic"))
    page.run(
        """(() => { const s = document.querySelector('#runs-statistic'); s.value = '1';
          s.dispatchEvent(new Event('change')); })()"""
    )
    start = page.middle("#run-evidence [data-handle=threshold]")
    page.drag(start, (0.0, -400.0))
    page.wait("!document.querySelector('.runs-message').hidden")
    assert "no wavelength has sigma" in page.text(".runs-message")
    assert page.text("#run-waves .plot-busy") == "not separated"
    page.run("document.activeElement.blur()")
    page.press("z")
    page.wait(DONE)
    assert page.run("document.querySelector('.runs-message').hidden")
    assert page.text("#run-waves .plot-busy") == ""


def test_the_range_is_one_edit_of_two_keys(opened: Opened, recipe: Path) -> None:
    # without its table (and the check of it), which is refused where it ends inside the travel and would make that worse
    recipe.write_text(recipe.read_text("utf-8").split("[[check]]")[0], "utf-8")
    page = opened(recipe, DONE)
    before = text_of(page)
    start = page.middle("#run-curves [data-handle=start]")

    separated(page, lambda: page.drag(start, (100.0, 0.0)))
    lines = dict(line.split(" = ") for line in changed_lines(before, text_of(page)))
    assert set(lines) == {"start", "length"}
    begin, length = (float(lines[k].strip('"').split()[0]) for k in ("start", "length"))
    assert begin > 2.0
    assert begin + length == pytest.approx(70.0, abs=1e-9)  # the end stays where it was
    undo(page)
    assert text_of(page) == before
    page.run("document.querySelector('#run-curves [data-handle=stop]').focus()")
    separated(page, lambda: page.press("ArrowLeft", shift=True))
    (line,) = changed_lines(before, text_of(page))
    assert line.startswith('length = "6')


def test_a_gap_is_not_drawn_over(opened: Opened, tmp_path: Path) -> None:
    x = np.linspace(0.0, 50.0, 2001)
    lost = (x > 20.0) & (x < 30.0)
    z = 200 * np.sin(x)
    rows = [f"a,{a:.4f},{'' if n else f'{b:.3f}'}" for a, b, n in zip(x, z, lost, strict=True)]
    (tmp_path / "runs.csv").write_text("run,x_mm,z_nm\n" + "\n".join(rows) + "\n")
    file = tmp_path / "gap.toml"
    file.write_text(
        'metrosep = 1\n[input]\nfiles = ["runs.csv"]\nx = "x_mm"\nz = "z_nm"\nrun = "run"\n'
        '[[step]]\nop = "separate"\nmethod = "mean"\nstart = "0 mm"\nlength = "20 mm"\n'
    )
    page = opened(file, DONE)

    # pixels of the line colour, column by column of the frame
    columns = page.run(
        """(() => {
          const c = document.querySelector('#run-curves canvas');
          const over = document.querySelector('#run-curves .u-over').getBoundingClientRect();
          const box = c.getBoundingClientRect(), k = c.width / box.width;
          const [x0, y0] = [(over.left - box.left) * k, (over.top - box.top) * k];
          const [w, h] = [Math.round(over.width * k), Math.round(over.height * k)];
          const data = c.getContext('2d').getImageData(Math.round(x0), Math.round(y0), w, h).data;
          const out = new Array(w).fill(0);
          for (let y = 0; y < h; y += 1) for (let x = 0; x < w; x += 1) {
            const i = 4 * (y * w + x);
            if (data[i + 3] > 50 && data[i + 2] - data[i] > 35) out[x] += 1;
          }
          return out;
        })()"""
    )
    place = np.linspace(0.0, 50.0, len(columns))
    drawn = np.array(columns) > 0
    assert not drawn[(place > 20.3) & (place < 29.7)].any()
    assert drawn[(place > 1.0) & (place < 19.5)].mean() > 0.95
    assert drawn[(place > 30.5) & (place < 49.0)].mean() > 0.95


def test_a_refused_table_leaves_numbers_and_curves(opened: Opened, recipe: Path) -> None:
    """The range begins 10 mm later: outside the table the controller would make it worse."""
    whole = recipe.read_text()
    short = whole.replace('start = "0 mm"', 'start = "10 mm"').replace("70 mm", "50 mm", 1)
    recipe.write_text(short)
    page = opened(recipe, DONE)

    assert printed(page, "pv")[0] > 0.5e-6
    assert "No verdict" in page.text("#verdict")
    assert "the corrections cover 10 ... 60 mm" in page.text("#verdict")
    assert 'waive = ["coverage"]' in page.text("#verdict")
    assert "='" not in page.text("#verdict")  # a key of the recipe, not an argument of Python
    page.click("#panel-runs input[value=separated]")
    assert "separated error" in page.text(".runs-legend")
    assert page.run("document.querySelector('.runs-message').hidden")
    page.click("#tab-table")
    page.wait("document.querySelector('.table-findings') !== null")
    assert "the corrections cover 10 ... 60 mm" in page.text(".table-findings")
    assert page.errors == []


def test_nothing_comes_from_outside(opened: Opened, recipe: Path) -> None:
    page = opened(recipe, DONE)
    for mode in ("separated", "change", "repeats"):
        page.click(f"#panel-runs input[value={mode}]")
    outside = [
        r for r in page.requests if not re.match(r"(https?|ws)://127\.0\.0\.1|data:|about:", r)
    ]
    assert outside == []
    assert page.errors == []


def test_the_editor_shows_the_keys_of_the_chosen_method_first(
    opened: Opened, recipe: Path
) -> None:
    page = opened(recipe, DONE)
    page.click('[data-step="0"] .pick')
    shown = """[...document.querySelectorAll('.editor > [data-key]')].map((e) => e.dataset.key)"""
    folded = """[...document.querySelectorAll('.editor details [data-key]')].map((e) => e.dataset.key)"""

    first, rest = page.run(shown), page.run(folded)
    assert {"method", "start", "length", "shortest", "sigma_t", "p_t", "rule", "feed"} <= set(
        first
    )
    assert {"min_feeds", "drift", "lines", "lag", "robust"} <= set(rest)
    words = page.run("document.querySelector('.editor [data-key=p_t]').title")
    assert words.startswith("kono only: a wavelength counts where its mean")
    page.run(
        """(() => { const s = document.querySelector('.editor [data-key=method]'); s.value = 'mean';
          s.dispatchEvent(new Event('change')); })()"""
    )
    page.wait(f"!({shown}).includes('sigma_t')")
    assert {"method", "start", "length", "feed"} <= set(page.run(shown))
    assert "sigma_t" in page.run(folded)


def test_runs_of_different_travel_get_a_range_by_hand(opened: Opened, tmp_path: Path) -> None:
    rows = ["run,x_mm,z_nm,feed_mm_min"]
    for name, low, high in (("a", 0.0, 50.0), ("b", 8.0, 58.0)):
        x = np.linspace(low, high, 501)
        rows += [f"{name},{v:.3f},{100 * np.sin(v):.3f},6000" for v in x]
    (tmp_path / "runs.csv").write_text("\n".join(rows) + "\n")
    file = tmp_path / "uneven.toml"
    file.write_text(
        'metrosep = 1\n[input]\nfiles = ["runs.csv"]\nx = "x_mm"\nz = "z_nm"\nrun = "run"\n'
        'feed = { column = "feed_mm_min", unit = "mm/min" }\n'
        '[[step]]\nop = "separate"\nmethod = "mean"\n'
    )
    refused = "document.querySelector('.runs-message')?.textContent.includes('different travels')"
    page = opened(file, refused)

    page.run("document.querySelector('#run-curves [data-handle=start]').focus()")
    page.press("ArrowRight", shift=True)
    page.wait("document.body.dataset.runs")
    lines = dict(
        line.split(" = ")
        for line in text_of(page).splitlines()
        if line.startswith(("start", "len"))
    )
    start, length = (float(lines[k].strip('"').split()[0]) for k in ("start", "length"))
    assert start >= 8.0
    assert start + length <= 50.0 + 1e-6
    assert start + length > 49.0
    assert page.run("document.querySelector('.runs-message').hidden")


def joint_runs(folder: Path) -> Path:
    """Nine runs with long names, one of them moved by 0.9 mm, one name hostile; a joint recipe."""
    rng = np.random.default_rng(4)
    rows = ["x_mm,z_um,t_s,run"]
    for number, feed in enumerate((80.0,) * 3 + (120.0,) * 3 + (160.0,) * 3):
        t = np.arange(0.0, 56.0 / feed, 2e-3)
        x = feed * t
        at = x - (0.9 if number == 4 else 0.0)
        z = 0.2 * np.cos(2 * np.pi * at / 12) + 0.1 * np.sin(2 * np.pi * at / 6.3)
        z = z + 0.02 * rng.standard_normal(x.size)
        name = f"2026-11-23 spindle off, table at {feed:g} mm/s, pass {number} (<img src=x onerror=document.title=1>)"
        rows += [f'{a:.6f},{b:.6f},{c:.6f},"{name}"' for a, b, c in zip(x, z, t, strict=True)]
    (folder / "runs.csv").write_text("\n".join(rows) + "\n")
    (folder / "recipe.toml").write_text(
        'metrosep = 1\n[input]\nfiles = ["runs.csv"]\nx = { column = "x_mm", unit = "mm" }\n'
        'z = { column = "z_um", unit = "um" }\ntime = { column = "t_s", unit = "s" }\nrun = "run"\n'
        '[[step]]\nop = "separate"\nshortest = "4 mm"\n'
    )
    return folder / "recipe.toml"


def test_what_was_found_is_a_table_with_a_row_and_a_strip_for_each_run(
    opened: Opened, tmp_path: Path
) -> None:
    page = opened(joint_runs(tmp_path), DONE)
    page.click("input[name=runs-shown][value=found]")
    page.wait("document.querySelectorAll('#runs-found tbody tr:not(.said)').length === 9")

    assert page.run("document.querySelectorAll('#runs-found td.strip svg path.line').length") == 9
    assert (
        page.run(
            "[...document.querySelectorAll('#runs-found tbody tr')].findIndex(r => r.classList.contains('odd'))"
        )
        == 4
    )
    assert "is displaced" in page.text("#runs-found tr.said td")
    assert page.text("#runs-found p").startswith("Delay of the reading")
    assert page.run("document.querySelector('#runs-found img')") is None
    assert page.run(
        "document.querySelector('#runs-found').scrollWidth <= document.querySelector('#runs-found').clientWidth"
    )
    page.click("input[name=runs-shown][value=repeats]")
    assert page.run("document.querySelector('#runs-found').hidden")
    assert page.run("!document.querySelector('#run-curves').hidden")


def test_what_refuses_runs_is_said_once_and_the_verdict_is_short(
    opened: Opened, tmp_path: Path
) -> None:
    z = np.sin(np.arange(120) / 6.0) + 0.05 * np.random.default_rng(8).standard_normal((2, 120))
    rows = [f"{x},{50 * z[run, x]:.3f},{run + 1},600" for run in (0, 1) for x in range(120)]
    (tmp_path / "runs.csv").write_text("x_mm,z_nm,run,feed_mm_min\n" + "\n".join(rows) + "\n")
    (tmp_path / "r.toml").write_text(
        'metrosep = 1\n[input]\nfiles = ["runs.csv"]\nx = "x_mm"\nz = "z_nm"\nrun = "run"\nfeed = "feed_mm_min"\n'
        '[[step]]\nop = "separate"\nmethod = "joint"\n[[check]]\nmetric = "pv"\nupper = "1 um"\n'
    )
    refused = "/failed/.test(document.querySelector('#status-full').textContent)"
    page = opened(tmp_path / "r.toml", refused)
    whole = "look alike at one feedrate"
    page.wait(f"document.querySelector('#panel-runs').textContent.includes('{whole}')")
    short = "No verdict: the forward runs have 1 feedrate (600 mm/min), the separation needs 2"
    assert page.text("#verdict") == short
    assert page.text("#alerts") == ""
