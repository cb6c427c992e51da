"""What the plots have in common: the wheel zooms about the pointer, and what is pointed at is told."""

from __future__ import annotations

import math
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
RUNS = "document.body.dataset.runs && document.querySelector('#status-full.done') !== null"
TURN = 200.0
FACTOR = math.exp(-0.0015 * TURN)
"""Of the length that is shown, by one turn of the wheel."""

PIXELS = 0.01
"""Part of the length: a pixel column or two, and the last printed digit."""

Opened = Callable[..., Any]


def lengths(text: str) -> list[float]:
    """Return the lengths of a readout, mm."""
    scale = {"n": 1e-6, "µ": 1e-3, "m": 1.0, "": 1e3}
    found = re.findall("(\u2212?[0-9.]+)\u2009([nµm]?)m", text)
    return [float(v.replace("\u2212", "-")) * scale[prefix] for v, prefix in found]


def turn(page: Any, plot: str, part: float) -> None:
    """Turn the wheel over a part of the width of a plot, and move the pointer away."""
    left, top, width, height = page.box(f"{plot} .u-over")
    x, y = left + part * width, top + height / 2
    page.call("Input.dispatchMouseEvent", type="mouseWheel", x=x, y=y, deltaX=0, deltaY=-TURN)
    page.mouse("mouseMoved", x, y)
    page.mouse("mouseMoved", 5, 5)


def twice(page: Any, plot: str) -> None:
    """Click twice into a plot."""
    x, y = page.middle(f"{plot} .u-over")
    page.mouse("mouseMoved", x, y)
    for clicks in (1, 2):
        for kind in ("mousePressed", "mouseReleased"):
            page.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left",
                      buttons=int(kind == "mousePressed"), clickCount=clicks)  # fmt: skip
    page.mouse("mouseMoved", 5, 5)


@pytest.fixture
def line(tmp_path: Path) -> Path:
    """A profile of 10 mm with 501 samples and a gap from 3 to 4 mm."""
    from metrosep import Profile
    from metrosep.io.write import write

    x = np.linspace(0.0, 10e-3, 501)
    z = 1e-6 * np.sin(2 * np.pi * x / 2e-3)
    z[(x > 3e-3) & (x < 4e-3)] = np.nan
    file = tmp_path / "line.x3p"
    write(Profile(x, z), file)
    return file


def test_the_wheel_zooms_a_profile_about_the_pointer(opened: Opened, line: Path) -> None:
    page = opened(line)
    read = "document.querySelector('#profile .readout').textContent"
    page.wait(f"{read}.includes(' to ')")
    assert "double click" not in page.run(read)
    turn(page, "#profile", 0.25)
    page.wait(f"{read}.includes('double click or F: all')")
    start, stop = lengths(page.run(read))
    # the pointer's place stays: 2.5 mm
    assert start == pytest.approx(2.5 - 2.5 * FACTOR, abs=10 * PIXELS)
    assert stop == pytest.approx(2.5 + 7.5 * FACTOR, abs=10 * PIXELS)
    twice(page, "#profile")
    page.wait(f"{read} && !{read}.includes('double click')")
    assert lengths(page.run(read)) == pytest.approx([0.0, 10.0], abs=10 * PIXELS)
    assert page.errors == []


def test_a_profile_tells_height_and_gap_at_the_pointer(opened: Opened, line: Path) -> None:
    page = opened(line)
    read = "document.querySelector('#profile .readout').textContent"
    page.wait(f"{read}.includes(' to ')")
    left, top, width, height = page.box("#profile .u-over")
    page.mouse("mouseMoved", left + 0.35 * width, top + height / 2)
    page.wait(f"{read}.endsWith(': not measured')")
    page.mouse("mouseMoved", left + 0.6 * width, top + height / 2)
    page.wait(f"{read}.startsWith('x ') && {read}.endsWith('m') && !{read}.includes('not')")
    page.mouse("mouseMoved", 5, 5)
    page.wait(f"{read}.includes(' to ')")
    assert page.errors == []


def test_the_wheel_zooms_runs_about_the_pointer(opened: Opened, tmp_path: Path) -> None:
    for name in ("recipe.toml", "runs_y.csv"):
        shutil.copy(EXAMPLE / name, tmp_path / name)
    page = opened(tmp_path / "recipe.toml", RUNS)
    read = "document.querySelector('#run-curves .readout').textContent"
    left, top, width, height = page.box("#run-curves .u-over")

    def places() -> tuple[float, float]:
        """Return where two places of the plot lie, mm."""
        found = []
        for part in (0.25, 0.75):
            page.mouse("mouseMoved", left + part * width, top + height / 2)
            found.append(lengths(page.wait(f"{read}.startsWith('x ') && {read}"))[0])
            page.mouse("mouseMoved", 5, 5)
            page.wait(f"{read}.startsWith('range ')")
        return found[0], found[1]

    def come_to(want: tuple[float, float]) -> None:
        """Wait until the places lie there: the curves of the new part come a moment later."""
        deadline = time.monotonic() + 10.0
        close = pytest.approx(want, abs=whole * PIXELS)
        while (now := places()) != close and time.monotonic() < deadline:
            time.sleep(0.1)
        assert now == close

    a, b = places()
    at, whole = (a + b) / 2, 2 * (b - a)
    assert "double click" not in page.run(read)
    turn(page, "#run-curves", 0.5)
    page.wait(f"{read}.includes('(double click: all)')")
    come_to((at - whole / 4 * FACTOR, at + whole / 4 * FACTOR))
    twice(page, "#run-curves")
    page.wait(f"{read}.startsWith('range ') && !{read}.includes('double click')")
    come_to((a, b))
    assert page.errors == []


def test_a_report_that_is_there_is_written_over_when_told(opened: Opened, map_file: Path) -> None:
    file = map_file.parent / "bowl_report.html"
    page = opened(map_file)
    page.click("#tab-report")
    done = "document.querySelector('#panel-report').dataset.of === document.body.dataset.full"
    page.wait(done, 120.0)
    link = "document.querySelector('#status-link').textContent"
    asked = "document.querySelector('dialog[open] h2')?.textContent === 'Overwrite?'"

    def make() -> None:
        page.click("#report-make")
        page.press("Enter")

    file.write_text("somebody's own")
    make()
    page.wait(asked)
    page.press("Escape")
    page.wait("document.querySelector('dialog[open]') === null")
    assert file.read_text() == "somebody's own"
    assert not page.run(link).startswith("written")
    make()
    page.wait(asked)
    page.click("dialog[open] button.main")
    page.wait(f"{link}.startsWith('written')")
    assert file.read_text("utf-8").startswith("<!")
    assert page.errors == []
