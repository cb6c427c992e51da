"""axe-core finds nothing serious on any page: light, dark, high contrast, telephone, wide, 200 %."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from browser.test_access import files
from browser.test_operator import RECIPE, mode, operator_page, put, scan

pytestmark = pytest.mark.browser

Opened = Callable[..., Any]
SIZES = {
    "light": (1366, 768, "light"),
    "dark": (1366, 768, "dark"),
    "telephone": (390, 844, "light"),
    "wide": (2560, 1440, "dark"),
    "200 %": (683, 384, "light"),
}
RUN = """(async () => {
  const found = await axe.run(document, { resultTypes: ['violations'],
    runOnly: ['wcag2a', 'wcag2aa', 'wcag21a', 'wcag21aa', 'wcag22aa', 'best-practice'] });
  return found.violations.filter((v) => ['serious', 'critical', 'moderate'].includes(v.impact))
    .map((v) => `${v.id}: ${v.nodes.slice(0, 3).map((n) => n.html.slice(0, 120)).join(' | ')}`);
})()"""
QUIET = "new Promise((done) => setTimeout(done, 400))"


@pytest.fixture(scope="module")
def axe() -> str:
    """The script of axe-core; `make test-browser` installs it."""
    home = Path(__file__).resolve().parents[2] / os.environ.get("CLIENTS", ".clients")
    file = Path(os.environ.get("METROSEP_AXE", home / "axe_playwright_python" / "axe.min.js"))
    if not file.is_file():
        pytest.skip("axe-core is not installed")
    return file.read_text(encoding="utf-8")


def looked(page: Any, script: str) -> dict[str, list[str]]:
    """Return what is found in each size, and in high contrast."""
    if not page.run("'axe' in window"):
        page.run(f"(0, eval)({json.dumps(script)}), true")
    bad: dict[str, list[str]] = {}
    for name, (width, height, scheme) in SIZES.items():
        page.show(width, height, scheme)
        page.run(QUIET)
        if found := page.run(RUN):
            bad[name] = found
    page.show(1366, 768)
    high = [{"name": "forced-colors", "value": "active"}]
    page.call("Emulation.setEmulatedMedia", features=high)
    page.run(QUIET)
    if found := page.run(RUN):
        bad["high contrast"] = found
    page.show(1366, 768)
    return bad


@pytest.mark.parametrize("kind", ["map", "profile", "runs", "method"])
def test_every_tab(
    opened: Opened, tmp_path: Path, repository: Path, map_file: Path, axe: str, kind: str
) -> None:
    page = opened(files(kind, tmp_path, repository, map_file))
    bad = {}
    for tab in page.run("[...document.querySelectorAll('#tabs button')].map((b) => b.id)"):
        page.run(f"document.getElementById('{tab}').click()")
        page.run("new Promise((done) => setTimeout(done, 1200))")
        if found := looked(page, axe):
            bad[tab] = found
    assert bad == {}


def test_what_is_drawn_three_dimensions_dialogs_and_alerts(
    opened: Opened, map_file: Path, axe: str
) -> None:
    page = opened(map_file)
    page.press("x")
    x, y = page.middle("#map canvas")
    page.drag((x - 40, y - 20), (60, 30))
    page.wait("document.querySelector('#shapes .draw-chip') !== null")
    page.press("Escape")
    page.press("p")
    page.mouse("mousePressed", x, y)
    page.mouse("mouseReleased", x, y)
    page.press("Enter")
    page.wait("document.querySelector('.alert p') !== null")
    bad = {"drawn, with an alert": looked(page, axe)}
    page.press("Escape")
    page.press("v")
    bad["3-D"] = looked(page, axe)
    for value in ("heights", "waves2d", "polar"):
        page.run(
            f"(() => {{ const s = document.querySelector('#lower'); s.value = '{value}'; s.dispatchEvent(new Event('change')); }})()"
        )
        bad[value] = looked(page, axe)
    for key in ("?", "o"):
        page.run("document.activeElement.blur()")
        page.press(key)
        page.wait("document.querySelector('dialog[open]') !== null")
        bad[key] = looked(page, axe)
        page.press("Escape")
        page.wait("document.querySelector('dialog') === null")
    assert {k: v for k, v in bad.items() if v} == {}


def test_the_empty_page(opened: Opened, axe: str) -> None:
    page = opened(None, "document.querySelector('#colours').options.length > 0")
    assert looked(page, axe) == {}


def test_the_page_of_the_operator(tab: Any, tmp_path: Path, axe: str) -> None:
    for name in ("in", "out"):
        (tmp_path / name).mkdir()
    (tmp_path / "flat.toml").write_text(RECIPE)
    bad = {}
    with operator_page(tmp_path) as address:
        tab.go(address)
        mode(tab, "name")
        bad["name"] = looked(tab, axe)
        scan(tab, "A. Weber")
        mode(tab, "serial")
        bad["serial"] = looked(tab, axe)
        put(tmp_path, "m.x3p", 180e-9)
        tab.wait("document.getElementById('file').textContent.includes('m.x3p')")
        tab.run("document.getElementById('serial').focus()")
        scan(tab, "B01")
        mode(tab, "reason")
        bad["reason"] = looked(tab, axe)
        tab.run("document.getElementById('reason').value = 'scratch'")
        tab.click("#reason-form button")
        mode(tab, "part")
        bad["part"] = looked(tab, axe)
        tab.go("about:blank")
    assert {k: v for k, v in bad.items() if v} == {}
