"""The list of files of the dialog Open: by keyboard alone, and by mouse."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser.test_work import printed, settled

from metrosep import Surface
from metrosep.io.write import write

pytestmark = pytest.mark.browser

Opened = Callable[..., Any]
LISTED = "document.querySelectorAll('.files-list [role=option]').length"


@pytest.fixture
def folder(map_file: Path) -> Path:
    write(
        Surface(np.arange(4000.0).reshape(40, 100) * 1e-9, 1e-6, 1e-6),
        map_file.parent / "tilt.x3p",
    )
    (map_file.parent / "below").mkdir()
    return map_file.parent


def test_a_file_is_found_by_name_shown_and_opened_by_keyboard(
    opened: Opened, map_file: Path, folder: Path
) -> None:
    page = opened(map_file)
    page.press("o")
    page.wait(f"{LISTED} >= 3")
    kinds = page.run(
        "Object.fromEntries([...document.querySelectorAll('.files-list [role=option]')].map((e) => [e.children[0].textContent, e.children[1].textContent]))"
    )
    assert kinds["tilt.x3p"] == "x3p"
    assert kinds["below/"] == ""
    page.run("document.querySelector('.files-bar input').focus()")
    page.call("Input.insertText", text="til")
    page.wait(f"{LISTED} === 1")
    page.press("ArrowDown")
    page.press("ArrowDown")
    page.wait("document.querySelector('.files-shown img').naturalWidth > 0")
    assert "map, 100 × 40" in page.text(".files-shown p")
    page.press("Enter")
    page.wait("document.getElementById('title').textContent === 'tilt.x3p'")
    assert page.errors == []


def test_two_files_are_chosen_by_mouse_and_a_folder_is_entered(
    opened: Opened, map_file: Path, folder: Path
) -> None:
    page = opened(map_file)
    page.press("o")
    page.wait(f"{LISTED} >= 3")
    page.click('.files-list [data-path$="bowl.x3p"]')
    x, y = page.middle('.files-list [data-path$="tilt.x3p"]')
    for kind in ("mousePressed", "mouseReleased"):
        page.mouse(kind, x, y, modifiers=2)
    value = page.run("document.querySelector('dialog [name=path]').value")
    assert value == f'"{folder / "bowl.x3p"}"; "{folder / "tilt.x3p"}"'
    page.click('.files-list [data-path$="below"]')
    page.wait(f"{LISTED} === 1")  # the way up
    assert page.run("document.querySelector('.files-bar select').value").endswith("below")
    page.press("Escape")
    page.wait("document.querySelector('dialog') === null")
    assert page.errors == []


def test_the_newest_file_of_a_folder_and_a_file_written_again_are_followed(
    opened: Opened, map_file: Path
) -> None:
    page = opened(map_file)
    done = "document.querySelector('#status-full.done') !== null"

    def follow(what: str) -> None:
        page.run(
            f"(() => {{ const e = document.getElementById('follow'); e.value = '{what}';"
            "e.dispatchEvent(new Event('change')); })()"
        )
        page.run("new Promise((go) => setTimeout(go, 1500))")

    page.click('[data-step="0"] .pick')
    settled(page, lambda: page.click("[data-form=sphere]"))
    follow("folder")
    rng = np.random.default_rng(4)
    z = 1e-6 * rng.standard_normal((40, 60))
    write(Surface(z, 1e-6, 1e-6), map_file.parent / "next.x3p")
    page.wait("document.getElementById('title').textContent === 'next.x3p'")
    page.wait(done)
    assert "sphere" in page.text('[data-step="0"] .pick')  # the present steps
    assert page.run("document.getElementById('follow').value") == "folder"  # it goes on
    before = page.text('[data-metric="Sq"] td:nth-child(2)')
    follow("file")
    write(Surface(50 * z, 1e-6, 1e-6), map_file.parent / "next.x3p")
    page.wait(
        f"document.querySelector('[data-metric=Sq] td:nth-child(2)').textContent !== {before!r}"
    )
    page.wait(done)
    shown, half = printed(page, "Sq")
    # a sphere takes little of noise: fifty times the first
    assert shown == pytest.approx(50e-6, abs=3e-6)
    assert half > 0
    assert page.errors == []


def rows_of(n: int, scale: float) -> str:
    """Return a profile of one wave as text; the last line ends where the file is whole."""
    x = np.arange(n) * 0.01
    z = scale * np.sin(2 * np.pi * x / 0.5)
    lines = [f"{a:.3f},{b:.6f}" for a, b in zip(x, z, strict=True)]
    return "\n".join(["x_mm,z_um", *lines]) + "\n"


def test_a_followed_file_that_is_half_written_cut_or_replaced_ends_with_its_own_numbers(
    opened: Opened, tmp_path: Path
) -> None:
    """Written slowly, in pieces that end within a line; truncated; moved over by another one."""
    file, told = tmp_path / "slow.csv", "document.getElementById('alerts').textContent"
    file.write_text(rows_of(400, 1.0))
    page = opened(file)

    def shows(scale: float) -> None:
        """Wait for RMS and P-V of a wave of this amplitude, with nothing left of what was said before."""
        wanted, shown = scale * 1e-6 / np.sqrt(2), np.nan
        for _ in range(200):
            if page.run("document.querySelector('#status-full.done') !== null"):
                shown, half = printed(page, "Pq")
                if abs(shown - wanted) <= 2 * half + 0.02 * wanted:
                    break
            page.run("new Promise((go) => setTimeout(go, 100))")
        said = page.run(f"[document.querySelector('dialog')?.textContent, {told}]")
        assert shown == pytest.approx(wanted, abs=0.02 * wanted), said
        assert page.run("document.querySelector('dialog') === null")
        assert page.run(told) == ""

    shows(1.0)
    page.run(
        "(() => { const e = document.getElementById('follow'); e.value = 'file';"
        "e.dispatchEvent(new Event('change')); })()"
    )
    page.run("new Promise((go) => setTimeout(go, 1500))")
    whole = rows_of(400, 3.0)
    cuts = [0, 4, 10, len(whole) // 2 + 3, len(whole) - 9]
    for old, new in itertools.pairwise([*cuts, len(whole)]):
        with file.open("w" if old == 0 else "a") as stream:
            stream.write(whole[old:new])
        page.run("new Promise((go) => setTimeout(go, 3200))")  # it rests long enough to be opened
    shows(3.0)
    file.write_text("")  # a program that begins anew
    page.run("new Promise((go) => setTimeout(go, 3200))")
    other = tmp_path / "other.tmp"
    other.write_text(rows_of(400, 7.0))
    other.replace(file)
    shows(7.0)
    file.unlink()
    page.run("new Promise((go) => setTimeout(go, 2500))")
    file.write_text(rows_of(400, 2.0))
    shows(2.0)
    assert page.run("document.getElementById('follow').value") == "file"
    assert page.errors == []
