"""The figures of Lighthouse that hold for a page of this computer: weight, shifts, letters, requests, errors."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from browser.conftest import FULL, chromium

pytestmark = pytest.mark.browser

Opened = Callable[..., Any]
SHIFTS = """window.shifts = []; new PerformanceObserver((list) => { for (const one of list.getEntries())
  if (!one.hadRecentInput) window.shifts.push(one.value); }).observe({ type: 'layout-shift', buffered: true });"""
LETTERS = """(() => { const count = {}; const walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let node = walk.nextNode(); node; node = walk.nextNode()) {
    const el = node.parentElement, text = node.textContent.trim();
    if (!text || !el.checkVisibility() || el.closest('option, script, style')) continue;
    const size = parseFloat(getComputedStyle(el).fontSize); count[size] = (count[size] ?? 0) + text.length; }
  return count; })()"""
LOADED = """performance.getEntriesByType('resource').map((one) => [one.name, one.encodedBodySize, one.responseStatus])"""


def test_a_map_opens_light_still_and_readable(tab: Any, map_file: Path) -> None:
    with chromium.workbench(map_file) as address:
        script = tab.call("Page.addScriptToEvaluateOnNewDocument", source=SHIFTS)["identifier"]
        try:
            tab.go(address)
            tab.wait(FULL)
            tab.run("new Promise((done) => setTimeout(done, 500))")
            shifts = tab.run("window.shifts")
            letters = {float(k): v for k, v in tab.run(LETTERS).items()}
            loaded = tab.run(LOADED)
            head = tab.run(
                "[document.doctype?.name, document.documentElement.lang, document.title,"
                "document.querySelector('meta[name=viewport]').content, document.querySelectorAll('*').length]"
            )
            policy, size = tab.run(
                "fetch('/').then(async (r) => [r.headers.get('content-security-policy'), (await r.text()).length])"
            )
        finally:
            tab.call("Page.removeScriptToEvaluateOnNewDocument", identifier=script)
            tab.go("about:blank")
    assert sum(shifts) < 0.1  # what is there does not jump: the limit of "good"
    assert min(letters) >= 11.0
    assert sum(n for s, n in letters.items() if s >= 12.0) > 0.95 * sum(letters.values())
    assert head[:2] == ["html", "en"]
    assert "bowl.x3p" in head[2]
    assert head[3] == "width=device-width, initial-scale=1"  # it may be zoomed
    assert head[4] < 1500
    assert len(loaded) > 20
    assert [name for name, _, status in loaded if status != 200] == []
    assert [n for n, *_ in loaded if not n.startswith((address.partition("/?")[0], "data:"))] == []
    assert size + sum(n for _, n, _ in loaded) < 1_000_000
    assert "default-src 'none'" in policy
    assert tab.errors == [], json.dumps(tab.errors)
