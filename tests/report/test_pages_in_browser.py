"""The pages in headless Chromium: nothing is asked for, the tables sort by mouse and keyboard."""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path

import pytest

from metrosep.report.html import write_html
from metrosep.report.index import write_index

pytestmark = pytest.mark.browser
DRIVER = Path(__file__).resolve().parents[2] / "tools" / "chromium.py"
UNITS = (
    "JSON.stringify([...[...document.querySelectorAll('table')].at(-1).tBodies[0].rows]"
    ".map(r => r.cells[0].textContent))"
)
HEAD = "[...document.querySelectorAll('table')].at(-1).tHead.rows[0].cells[{}]"


@pytest.fixture(scope="module")
def tab():
    spec = importlib.util.spec_from_file_location("metrosep_chromium_pages", DRIVER)
    driver = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = driver
    spec.loader.exec_module(driver)
    if driver.find_chromium() is None:
        pytest.skip("no Chromium is installed")
    with driver.browser() as page:
        yield page


@pytest.fixture
def index(tmp_path):
    """Values 10, 9, none, 100 nm: as texts they would sort otherwise."""
    rows = []
    for i, value in enumerate((10e-9, 9e-9, None, 100e-9)):
        entry = {"metric": "Sq", "name": "Sq", "unit": "m", "value": value, "verdict": None}
        status = "failed" if value is None else "measured"
        rows.append({"unit": f"u{i}", "status": status, "characteristics": [entry]})
    document = {"schema": "metrosep.index/1", "title": "<b>Lot</b>", "rows": rows}
    return write_index(document, tmp_path / "index.html")


def _open(tab, file):
    tab.requests.clear()
    tab.errors.clear()
    tab.go(file.as_uri())
    tab.wait("document.readyState === 'complete'")


def test_a_click_and_a_key_sort_the_units(tab, index):
    _open(tab, index)
    column = HEAD.format(2)

    assert json.loads(tab.run(UNITS)) == ["u0", "u1", "u2", "u3"]
    tab.run(f"{column}.click()")
    assert json.loads(tab.run(UNITS)) == ["u1", "u0", "u3", "u2"]
    assert tab.run(f"{column}.getAttribute('aria-sort')") == "ascending"
    tab.run(f"{column}.focus()")
    tab.run(f"{column}.dispatchEvent(new KeyboardEvent('keydown', {{key: 'Enter'}}))")
    assert json.loads(tab.run(UNITS)) == ["u3", "u0", "u1", "u2"]
    assert tab.errors == []


def test_the_pages_ask_for_nothing(tab, index, document, tmp_path):
    for file in (index, write_html(document, tmp_path / "report.html")):
        _open(tab, file)

        asked = [r for r in tab.requests if not str(r).startswith(("file:", "data:"))]
        assert asked == []
        assert tab.errors == []
        assert tab.run("[...document.images].every(i => i.naturalWidth > 0)") is True
