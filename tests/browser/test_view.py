"""What is shown comes back with the file; a result of the folder opens with the same recipe."""

from __future__ import annotations

import time
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from browser.test_folder import part

pytestmark = pytest.mark.browser

Opened = Callable[..., Any]


def test_view_comes_back(opened: Opened, map_file: Path) -> None:
    page = opened(map_file)
    page.run("document.getElementById('colours').value = 'cividis'")
    page.run("document.getElementById('colours').dispatchEvent(new Event('change'))")
    page.drag(page.middle(".handle-point"), (60.0, 40.0))
    page.click("#tab-report")
    session = map_file.with_name(f"{map_file.name}.session.toml")
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
