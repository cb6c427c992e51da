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


@pytest.fixture
def long_index(tmp_path):
    """Long names and reasons, three values: what a phone made one letter wide."""
    rows = []
    for i in range(40):
        name = f"shift_{i % 3}/LENS_with_a_long_name_{i:04}_d0.x3p"
        entries = [
            {"metric": m, "name": m, "unit": "m", "value": 1e-8 + i * 1e-10, "upper": 1.2e-8}
            for m in ("Sq", "Sz", "residual.rms")
        ]
        status = "rejected" if i % 2 else "failed"
        reason = (
            "rough Sq 14.2 nm > 12 nm (U 0.3 nm): reject; the file ends after 512 of 4096 bytes"
        )
        rows.append({"unit": name, "status": status, "reason": reason, "hash": "0a1b2c3d4e5f",
                     "link": f"LENS_{i}/0a1b2c3d/result.json",
                     "characteristics": [] if status == "failed" else entries})  # fmt: skip
    document = {"schema": "metrosep.index/1", "title": "Lot", "rows": rows}
    return write_index(document, tmp_path / "index.html")


WIDTHS = (
    "JSON.stringify([...document.querySelectorAll('{} tbody tr td:nth-child({})')]"
    ".map(c => c.clientWidth))"
)


@pytest.mark.parametrize("width", [390, 800, 1400])
def test_names_and_reasons_can_be_read_on_a_narrow_screen(tab, long_index, width):
    tab.show(width, 844, "light")
    try:
        _open(tab, long_index)
        page, shown = json.loads(
            tab.run(
                "JSON.stringify([document.documentElement.scrollWidth,"
                " document.documentElement.clientWidth])"
            )
        )
        reasons = json.loads(tab.run(WIDTHS.format(".reasons", 3)))
        names = json.loads(tab.run(WIDTHS.format("table", 1)))
        height = tab.run("document.documentElement.scrollHeight")
    finally:
        tab.show(1400, 900, "light")

    assert page <= shown  # tables scroll in their own boxes
    assert min(reasons) >= 230
    assert min(names) >= 120
    assert height <= 12000  # 40 units, twice, with charts; it was more than twice that
