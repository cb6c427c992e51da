"""Everything by keyboard, everything with a name, every text readable in light and dark."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.browser

Opened = Callable[..., Any]
FULL = "document.querySelector('#status-full.done') !== null"
LEAST = 4.5
"""Contrast of text that WCAG 2.2 asks for (AA)."""

MOST_STOPS = 250

CONTRAST = """((least) => {
  const canvas = document.createElement('canvas').getContext('2d', { willReadFrequently: true });
  const rgba = (colour) => {
    canvas.clearRect(0, 0, 1, 1);
    canvas.fillStyle = colour;
    canvas.fillRect(0, 0, 1, 1);
    const [r, g, b, a] = canvas.getImageData(0, 0, 1, 1).data;
    return [r, g, b, a / 255];
  };
  const over = (top, below) => [0, 1, 2].map((i) => top[3] * top[i] + (1 - top[3]) * below[i]);
  const ground = (el) => {
    const layers = [];
    const drawn = getComputedStyle(el, '::after'); // a badge below the text of a handle
    if (drawn.content !== 'none' && drawn.zIndex === '-1') layers.push(rgba(drawn.backgroundColor));
    if (layers.at(-1)?.[3] === 1) return layers[0].slice(0, 3);
    for (let e = el; e; e = e.parentElement) {
      layers.push(rgba(getComputedStyle(e).backgroundColor));
      if (layers.at(-1)[3] === 1) break;
    }
    return layers.reverse().reduce((below, top) => over(top, below), [255, 255, 255]);
  };
  const light = (c) => {
    const [r, g, b] = c.map((v) => { const s = v / 255; return s <= 0.04045 ? s / 12.92 : ((s + 0.055) / 1.055) ** 2.4; });
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const bad = [];
  let seen = 0;
  const look = (el, colour, text) => {
    const below = ground(el);
    let ink = rgba(colour);
    for (let e = el; e; e = e.parentElement) ink = [...ink.slice(0, 3), ink[3] * Number(getComputedStyle(e).opacity)];
    const [a, b] = [light(over(ink, below)), light(below)].sort((x, y) => y - x);
    const ratio = (a + 0.05) / (b + 0.05);
    seen += 1;
    if (ratio < least) bad.push([text.trim().slice(0, 40), el.tagName, el.id || el.className?.baseVal || el.className, Number(ratio.toFixed(2))]);
  };
  const shown = (el) => el && el.checkVisibility({ opacityProperty: true, visibilityProperty: true })
    && el.getBoundingClientRect().width > 1 && !el.closest('.visually-hidden, :disabled, [aria-disabled=true]');
  const walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let node = walk.nextNode(); node; node = walk.nextNode()) {
    const el = node.parentElement;
    if (!node.textContent.trim() || !shown(el) || el.closest('script, style, datalist, option')) continue;
    const style = getComputedStyle(el);
    look(el, el instanceof SVGElement ? style.fill : style.color, node.textContent);
  }
  for (const el of document.querySelectorAll('input:not([type=checkbox]):not([type=radio]):not([type=file]), select, textarea')) {
    if (!shown(el)) continue;
    look(el, getComputedStyle(el).color, el.value || '(empty)');
    if (el.placeholder && !el.value) look(el, getComputedStyle(el, '::placeholder').color, el.placeholder);
  }
  return { bad, seen };
})(%s)"""

NAMED = """(() => [...document.querySelectorAll('button, input, select, textarea, a[href], [tabindex="0"], [role=slider]')]
  .filter((el) => el.checkVisibility({ visibilityProperty: true }) && !el.disabled && el.tabIndex >= 0)
  .map((el, i) => { el.dataset.stop = String(i); return el.id || el.getAttribute('aria-label') || el.textContent.trim().slice(0, 30) || el.outerHTML.slice(0, 80); }))()"""

PLACE = """(() => { const a = document.activeElement;
  return [a === document.body ? 'end' : a.dataset.stop ?? 'scroller', a.closest('#topbar, #alerts, #tabs, section[id], #status')?.id ?? '', a.type === 'radio' ? a.name : null]; })()"""

ORDER = ("topbar", "alerts", "panel-steps", "tabs", "panel-map", "panel-profile", "panel-section", "panel-spectrum",
         "panel-runs", "panel-table", "panel-ranking", "panel-machine", "panel-report", "panel-compare", "panel-folder", "panel-metrics",
         "panel-empty", "status")  # fmt: skip


def profile_file(folder: Path) -> Path:
    """A profile with a wave."""
    i = np.arange(2000)
    file = folder / "wave.csv"
    rows = np.column_stack([i * 0.01, np.cos(2 * np.pi * i / 100)])
    np.savetxt(file, rows, delimiter=",", fmt="%.6g", header="x_mm,z_um", comments="")
    return file


def example(folder: Path, repository: Path, name: str) -> Path:
    """A recipe of an example with what it reads."""
    for file in (repository / "examples" / name).iterdir():
        shutil.copy(file, folder)
    return folder / "recipe.toml"


def files(kind: str, folder: Path, repository: Path, map_file: Path) -> Path:
    if kind == "map":
        return map_file
    if kind == "profile":
        return profile_file(folder)
    return example(folder, repository, {"runs": "straightness", "method": "circle_closure"}[kind])


def unreadable(page: Any) -> list[Any]:
    found = page.run(CONTRAST % LEAST)
    assert found["seen"] > 5
    return list(found["bad"])


@pytest.mark.parametrize("kind", ["map", "profile", "runs", "method"])
def test_every_text_is_readable(
    opened: Opened, tmp_path: Path, repository: Path, map_file: Path, kind: str
) -> None:
    page = opened(files(kind, tmp_path, repository, map_file))
    bad = {}
    for scheme in ("light", "dark"):
        page.show(1366, 768, scheme)
        for tab in page.run("[...document.querySelectorAll('#tabs button')].map((b) => b.id)"):
            page.run(f"document.getElementById('{tab}').click()")
            page.run("new Promise((done) => setTimeout(done, 300))")
            if found := unreadable(page):
                bad[f"{scheme} {tab}"] = found
    assert bad == {}


def test_dialogs_alerts_and_the_empty_page_are_readable(opened: Opened, tmp_path: Path) -> None:
    page = opened(None, "document.querySelector('#colours').options.length > 0")
    bad = {}
    for scheme in ("light", "dark"):
        page.show(1366, 768, scheme)
        bad[f"{scheme} empty"] = unreadable(page)
        page.run("document.body.focus()")
        for key in ("?", "o"):
            page.press(key)
            page.wait("document.querySelector('dialog[open]') !== null")
            bad[f"{scheme} {key}"] = unreadable(page)
            if key == "o":
                page.fill("dialog [name=path]", str(tmp_path / "missing.x3p"))
                page.press("Enter")
                page.wait("document.querySelector('.alert p') !== null")
                bad[f"{scheme} alert"] = unreadable(page)
                page.run("document.querySelector('.alert button').click()")
            else:
                page.press("Escape")
            page.wait("document.querySelector('dialog') === null")
    assert {k: v for k, v in bad.items() if v} == {}


@pytest.mark.parametrize("kind", ["map", "profile", "runs", "method"])
def test_every_control_is_reached_by_tab_in_order_and_has_a_name(
    opened: Opened, tmp_path: Path, repository: Path, map_file: Path, kind: str
) -> None:
    page = opened(files(kind, tmp_path, repository, map_file))
    for tab in page.run("[...document.querySelectorAll('#tabs button')].map((b) => b.id)"):
        page.run(f"document.getElementById('{tab}').click()")
        names: list[str] | None = None
        while (now := page.run(NAMED)) != names:  # the tab may still be drawing
            names = now
            page.run("new Promise((done) => setTimeout(done, 500))")
        page.run("document.activeElement.blur()")
        page.run("document.querySelector('#open').focus()")
        reached, places, radios = [], [], set()
        for _ in range(MOST_STOPS):
            stop, place, radio = page.run(PLACE)
            if stop == "end" or (stop in reached and stop != "scroller"):
                break
            reached.append(stop)
            radios.add(radio)
            if place and (not places or places[-1] != place):
                places.append(place)
            page.press("Tab")
        left = [
            name
            for i, name in enumerate(names)
            if str(i) not in reached
            and page.run(f"document.querySelector('[data-stop=\"{i}\"]')?.name ?? ''")
            not in (radios - {None})
        ]  # of radio buttons Tab reaches the chosen one, arrows the others
        assert left == [], tab
        assert places == [p for p in ORDER if p in places], tab
        assert_named(page, tab)


ROLES = {"button", "checkbox", "radio", "textbox", "combobox", "slider", "tab", "link", "spinbutton", "listbox",
         "searchbox", "switch", "menuitem"}  # fmt: skip


def assert_named(page: Any, where: str) -> None:
    """Ask the browser itself for the names that a screen reader says."""
    nodes = page.call("Accessibility.getFullAXTree")["nodes"]
    controls = [n for n in nodes if not n.get("ignored") and role_of(n) in ROLES]
    assert len(controls) > 5
    nameless = [described(page, n) for n in controls if not name_of(n)]
    assert nameless == [], where
    pictures = [n for n in nodes if not n.get("ignored") and role_of(n) == "image"]
    assert [described(page, n) for n in pictures if not name_of(n)] == [], where


def role_of(node: dict[str, Any]) -> str:
    return str(node.get("role", {}).get("value", ""))


def name_of(node: dict[str, Any]) -> str:
    return str(node.get("name", {}).get("value", "")).strip()


def described(page: Any, node: dict[str, Any]) -> str:
    """Return the element of a node, for the message."""
    found = page.call("DOM.describeNode", backendNodeId=node["backendDOMNodeId"])["node"]
    return f"{role_of(node)}: {found['nodeName']} {found.get('attributes')}"
