"""The recipe on a folder, from the page: progress, index, stop."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import metrosep as ms

pytestmark = pytest.mark.browser

Opened = Callable[..., Any]


def part(path: Path, amplitude: float) -> Path:
    z = amplitude / 2 * np.cos(2 * np.pi * np.arange(60) / 8)[None, :] * np.ones((50, 1))
    ms.write(ms.Surface(z, 1e-4, 1e-4), path)
    return path


def test_folder_is_run_and_its_index_shown(opened: Opened, tmp_path: Path) -> None:
    for name, amplitude in (("good", 0.5e-6), ("bad", 2e-6), ("first", 0.4e-6)):
        part(tmp_path / f"{name}.x3p", amplitude)
    (tmp_path / "torn.x3p").write_bytes((tmp_path / "good.x3p").read_bytes()[:300])
    recipe = tmp_path / "limits.toml"
    recipe.write_text(
        'metrosep = 1\n[input]\nfiles = ["first.x3p"]\n[[step]]\nop = "form"\nform = "plane"\n'
        '[[step]]\nop = "parameters"\nnames = ["Sz", "Sq"]\n'
        '[[check]]\nmetric = "Sz"\nupper = "1 um"\nU = "10 nm"\n'
    )
    page = opened(recipe)
    page.click("#tab-folder")
    page.wait("document.querySelector('#folder-pattern')?.value === '*.x3p'")
    page.click("#folder-start")
    page.wait("document.querySelectorAll('#panel-folder tbody tr').length === 4")
    rows = page.run(
        "[...document.querySelectorAll('#panel-folder tbody tr')].map((r) => [...r.cells].map((c) => c.textContent))"
    )
    assert [row[1] for row in rows] == ["torn.x3p", "bad.x3p", "first.x3p", "good.x3p"]
    assert [row[0].split()[1] for row in rows] == ["failed", "rejected", "accepted", "accepted"]
    stored = json.loads((tmp_path / "results" / "index.json").read_text())
    assert stored["counts"]["rejected"] == 1
    bad = next(r for r in stored["rows"] if r["unit"] == "bad.x3p")
    value = next(c["value"] for c in bad["characteristics"] if c["metric"] == "Sz")
    shown = float(rows[1][2].split()[0])
    assert abs(shown - value * 1e6) <= 5e-4  # four digits of 2 um
    assert "4 units" in page.text(".folder-words")
