"""The lower picture: material ratio, waves in all directions whose ring makes a filter, round sections."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser.test_drawing import Hand, a_round_section, metres, same_bytes
from browser.test_work import settled

pytestmark = pytest.mark.browser

Opened = Callable[..., Any]


def choose(page: Any, which: str) -> None:
    page.run(
        f"(() => {{ const e = document.getElementById('lower'); e.value = '{which}';"
        "e.dispatchEvent(new Event('change')); })()"
    )


def test_handles_of_the_material_ratio_read_exact_shares(opened: Opened, map_file: Path) -> None:
    from metrosep.io.read import read

    page = opened(map_file)
    choose(page, "heights")
    page.wait("document.querySelector('#heights .readout').textContent.includes('between them')")
    page.wait("!document.querySelector('#heights .readout').textContent.includes('≈')")
    page.run("document.querySelector('#heights .handle').focus()")
    before = page.text("#heights .readout")
    for _ in range(5):
        page.press("ArrowRight", shift=True)
    page.wait(f"document.querySelector('#heights .readout').textContent !== {before!r}")
    text = page.text("#heights .readout")
    left = read(map_file).level().z
    known = left[~np.isnan(left)] - np.nanmean(left)
    level, _, share = text.split("   ")[0].removeprefix("c1 ").partition(": ")
    number, unit = level.replace("\u2212", "-").split("\u2009")
    height = float(number) * {"nm": 1e-9, "µm": 1e-6}[unit]
    # the number that stands beside a height is of that height, also while a handle is ahead
    expected = np.mean(known >= height)
    assert float(share.split("\u2009")[0]) / 100 == pytest.approx(expected, abs=2e-3)
    assert page.errors == []


def test_a_ring_of_waves_becomes_a_filter(opened: Opened, map_file: Path) -> None:
    page = opened(map_file)
    choose(page, "waves2d")
    page.wait("document.querySelector('#waves2d .readout').textContent.includes('ring')")
    page.run("document.querySelector('#waves2d .handle').focus()")
    before = page.text("#waves2d .readout")
    page.press("ArrowLeft", shift=True)
    page.wait(f"document.querySelector('#waves2d .readout').textContent !== {before!r}")
    settled(page, lambda: page.click("#waves2d .fourier-bar button"))
    step = Hand(page).data()["step"][1]
    assert step["op"] == "filter"
    assert 0 < metres(step["lambda_s"]) < metres(step["lambda_c"])
    settled(page, lambda: page.click("#undo"))
    settled(page, lambda: page.click("#waves2d .fourier-bar button:nth-child(2)"))
    assert Hand(page).data()["step"][1] == {**step, "band": "stop"}
    assert page.text(".fourier-how").startswith("Hann window, plane removed")
    white = page.run(
        "(() => { const c = document.querySelector('#waves2d canvas'), x = c.getContext('2d');"
        "const many = (...at) => { const d = x.getImageData(...at).data; let n = 0;"
        "for (let i = 0; i < d.length; i += 4) n += d[i] > 240 && d[i + 1] > 240 && d[i + 2] > 240; return n; };"
        "return [many(0, c.height - 14, c.width, 14), many(0, 0, 40, c.height)]; })()"
    )
    assert min(white) > 15  # numbers at the foot and at the left
    same_bytes(page, map_file)
    assert page.errors == []


def test_a_round_section_stands_about_a_circle_and_the_choice_is_kept(
    opened: Opened, map_file: Path
) -> None:
    page = opened(map_file)
    choose(page, "polar")
    settled(page, lambda: a_round_section(Hand(page)))
    page.wait("document.querySelector('#polar .readout').textContent.includes('round1: radius')")
    drawn = page.run(
        "(() => { const c = document.querySelector('#polar canvas');"
        "const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;"
        "return d.filter((_, i) => i % 4 === 3 && d[i] > 0).length; })()"
    )
    assert drawn > 500
    page.click("#recipe")
    page.wait("document.querySelector('dialog pre') !== null")
    page.press("Escape")
    page.wait("document.querySelector('dialog') === null")
    assert page.errors == []
