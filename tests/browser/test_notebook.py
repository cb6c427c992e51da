"""The widget of `explore()` in JupyterLab and in marimo, driven by a headless Chromium.

Skipped where jupyterlab or marimo is missing. They are looked for in the interpreter that runs the
tests, or in the one that METROSEP_NOTEBOOK_PYTHON names; metrosep must be installed there too.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import secrets
import socket
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

pytestmark = [pytest.mark.browser, pytest.mark.timeout(300)]

PYTHON = os.environ.get("METROSEP_NOTEBOOK_PYTHON") or sys.executable
NEEDS = {"jupyterlab": ("jupyterlab", "ipykernel"), "marimo": ("marimo",)}
WIDE, HIGH = 1366, 1200

HOLE = (3.6e-3, 4.2e-3, 2.5e-3, 3.5e-3)
"""Not measured, as x from and to, y from and to, m."""

END_A = '[aria-label="Section end A"]'
GREY = [138, 138, 138]
ONE_PIXEL = 1.5
"""Where the hand lets go is known to a CSS pixel; half a pixel more for rounding on both sides."""

PAGE = Path(__file__).resolve().parents[2] / "docs" / "how-to" / "explore-in-a-notebook.md"
EXAMPLE = PAGE.read_text(encoding="utf-8").partition("```python\n")[2].partition("```")[0]
"""The map above, as the documentation has it."""

STATE = (
    "import json; state = lambda: 'STATE' + json.dumps({'a': w.a, 'b': w.b, 'band': w.band, "
    "'length': w.section.x[-1], 'missing': w.section.n_invalid}) + 'END'"
)

MARIMO = f"""\
# /// script
# [tool.marimo.display]
# theme = "system"
# ///
import marimo
app = marimo.App(width="full")

@app.cell
def _():
    import marimo as mo
{textwrap.indent(EXAMPLE, "    ")}
    {STATE}
    shown = mo.ui.anywidget(w)
    shown
    return mo, shown, state, w

@app.cell
def _(mo, shown, state):
    shown.value
    mo.md(state())
    return

@app.cell
def _(mo, w):
    mo.ui.button(label="set a", on_click=lambda _: setattr(w, "a", (1e-3, 5e-3)))
    return
"""

DEEP = (
    "(function all(r, s) { const found = [...r.querySelectorAll(s)];"
    "for (const e of r.querySelectorAll('*')) if (e.shadowRoot) found.push(...all(e.shadowRoot, s));"
    "return found; })"
)
"""Elements of a selector, also those within shadow roots."""


class Notebook:
    """An open notebook that shows the widget."""

    def __init__(self, page: Any, name: str) -> None:
        self.page, self.name = page, name

    def all(self, selector: str) -> str:
        """Return the expression of all elements of a selector."""
        return f"{DEEP}(document, {json.dumps(selector)})"

    def one(self, selector: str, then: str) -> Any:
        """Return what an expression in `e` gives for the first element of a selector."""
        return self.page.run(f"((e) => {then})({self.all(selector)}[0])")

    def middle(self, selector: str) -> tuple[float, float]:
        """Return the middle of an element on the screen."""
        box = "(() => { const b = e.getBoundingClientRect(); return [b.left + b.width / 2, b.top + b.height / 2]; })()"
        x, y = self.one(selector, box)
        return x, y

    def pixel(self, x: float, y: float) -> list[int]:
        """Return red, green and blue of the canvas of the map at a place of the screen."""
        got: list[int] = self.one(
            ".map canvas",
            "(() => { const b = e.getBoundingClientRect(); return [...e.getContext('2d').getImageData("
            f"Math.round({x} - b.left), Math.round({y} - b.top), 1, 1).data].slice(0, 3); }})()",
        )
        return got

    def inked(self, picture: str) -> list[bool]:
        """Return for each column of a plot within its axes whether it has pixels of the line."""
        got: list[bool] = self.one(
            f'[data-picture="{picture}"] .uplot canvas',
            "(() => { const o = e.parentElement.querySelector('.u-over'), k = e.width / e.clientWidth;"
            "const [l, t, w, h] = [o.offsetLeft, o.offsetTop, o.clientWidth, o.clientHeight].map((v) => Math.round(v * k));"
            "const d = e.getContext('2d').getImageData(l, t, w, h).data, found = new Array(w).fill(false);"
            "const probe = document.createElement('i'); probe.style.color = 'var(--line)'; e.parentElement.append(probe);"
            "const ink = getComputedStyle(probe).color.match(/[0-9]+/g).map(Number); probe.remove();"
            "for (let i = 0; i < w * h; i += 1) if ([0, 1, 2].every((c) => Math.abs(d[4 * i + c] - ink[c]) < 6)"
            " && d[4 * i + 3] > 200) found[i % w] = true; return found; })()",
        )
        return got

    def state(self, until: Callable[[dict[str, Any]], bool] = lambda _: True) -> dict[str, Any]:
        """Return what Python knows, once it is so."""
        end = time.monotonic() + 15
        while True:
            if self.name == "jupyterlab":
                self.type("print(state())")
            text = self.page.run(
                "[...document.querySelectorAll('.jp-OutputArea-output, .markdown, marimo-mime-renderer, .output')]"
                ".map((e) => e.textContent).join('\\n')"
            )
            found = text.rpartition("STATE")[2].partition("END")[0]
            got: dict[str, Any] = {}
            try:
                got = json.loads(found or "{}")
            except ValueError:
                raise AssertionError(f"Python said {text[-2000:]}") from None
            if (found and until(got)) or time.monotonic() > end:
                return got
            time.sleep(0.2)

    def type(self, code: str) -> None:
        """Run a line in a new cell of JupyterLab."""
        page = self.page
        cells = "document.querySelectorAll('.jp-CodeCell').length"
        before = page.run(cells)
        last = (
            "[...document.querySelectorAll('.jp-CodeCell')].at(-1)?.querySelector('.cm-content')"
        )
        page.wait(f"{last} && {last}.textContent.trim() === ''")  # its editor may come later
        page.wait(
            f"({last}.focus({{ preventScroll: true }}), {last}.contains(document.activeElement))"
        )
        page.call("Input.insertText", text=code)
        page.wait(f"{last}.textContent === {json.dumps(code)}")
        page.press("Enter", shift=True)
        page.wait(f"{cells} > {before}")
        page.wait(
            "document.querySelector('.jp-Notebook-ExecutionIndicator')?.dataset.status === 'idle'"
        )
        page.run(f"{self.all('.metrosep-explore')}[0].scrollIntoView({{ block: 'center' }})")

    def picture(self, name: str) -> None:
        """Keep what is seen in the folder that METROSEP_PICTURES names, if it does."""
        if folder := os.environ.get("METROSEP_PICTURES"):
            Path(folder, f"{self.name}-{name}.png").write_bytes(self.page.picture())

    def set_a(self) -> None:
        """Let Python set a to x = 1 mm, y = 5 mm."""
        if self.name == "jupyterlab":
            self.type("w.a = (1e-3, 5e-3)")
        else:
            self.page.run(
                f"{self.all('button')}.find((e) => e.textContent.includes('set a')).click()"
            )


# ---- servers ----------------------------------------------------------------------------------


def has(name: str) -> str:
    """Return what the notebook lacks, empty if nothing."""
    code = "import importlib, sys; [importlib.import_module(m) for m in sys.argv[1:]]"
    modules = (*NEEDS[name], "anywidget", "metrosep")
    done = subprocess.run(
        [PYTHON, "-c", code, *modules], capture_output=True, text=True, check=False
    )
    return done.stderr.strip().rpartition("\n")[2]


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


@contextlib.contextmanager
def served(name: str, folder: Path) -> Iterator[str]:
    """Start a notebook server that asks nobody and leaves nothing; give the address."""
    port, token = free_port(), secrets.token_hex(16)
    local = {
        key: str(folder / key)
        for key in (
            "JUPYTER_CONFIG_DIR", "JUPYTER_DATA_DIR", "JUPYTER_RUNTIME_DIR", "IPYTHONDIR",
            "XDG_CONFIG_HOME", "XDG_STATE_HOME", "XDG_CACHE_HOME", "XDG_DATA_HOME",
        )
    }  # fmt: skip
    if name == "jupyterlab":
        settings = folder / "settings"
        settings.mkdir()
        overrides = {
            "@jupyterlab/apputils-extension:notification": {
                "fetchNews": "false",
                "checkForUpdates": False,
            },
            "@jupyterlab/apputils-extension:themes": {"adaptive-theme": True},
        }
        (settings / "overrides.json").write_text(json.dumps(overrides))
        cell = {
            "cell_type": "code",
            "id": "a",
            "execution_count": None,
            "metadata": {},
            "outputs": [],
        }
        kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
        book = {
            "cells": [{**cell, "source": EXAMPLE.rstrip()}],
            "metadata": {"kernelspec": kernel},
            "nbformat": 4,
            "nbformat_minor": 5,
        }
        (folder / "book.ipynb").write_text(json.dumps(book))
        command = [
            "jupyterlab", "--no-browser", "--ip=127.0.0.1", f"--port={port}", "--allow-root",
            "--ServerApp.port_retries=0", f"--IdentityProvider.token={token}",
            f"--ServerApp.root_dir={folder}", f"--LabApp.app_settings_dir={settings}",
        ]  # fmt: skip
        address = f"http://127.0.0.1:{port}/doc/tree/book.ipynb?token={token}"
    else:
        (folder / "book.py").write_text(MARIMO)
        command = [
            "marimo", "run", "book.py", "--headless", "--no-token", "--host=127.0.0.1",
            f"--port={port}",
        ]  # fmt: skip
        address = f"http://127.0.0.1:{port}/"
    log = folder / "log"
    with log.open("w") as told:
        process = subprocess.Popen(
            [PYTHON, "-m", *command],
            cwd=folder,
            env={**os.environ, **local, "OMP_NUM_THREADS": "1"},
            stdout=told,
            stderr=subprocess.STDOUT,
        )
    try:
        end = time.monotonic() + 60
        while True:
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 5):
                break
            if process.poll() is not None or time.monotonic() > end:
                raise RuntimeError(f"{name} did not start:\n{log.read_text()}")
            time.sleep(0.2)
        yield address
    finally:
        process.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(timeout=20)
        if process.poll() is None:
            process.kill()
            process.wait()


@pytest.fixture(scope="module")
def driver() -> ModuleType:
    found = sys.modules["metrosep_chromium"]  # of conftest.py
    if found.find_chromium() is None:
        pytest.skip("no Chromium is installed")
    return found


@pytest.fixture(scope="module", params=["jupyterlab", "marimo"])
def book(
    request: pytest.FixtureRequest, driver: Any, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Notebook]:
    """An open notebook whose widget is drawn."""
    name = request.param
    if missing := has(name):
        pytest.skip(f"{name}: {missing} (METROSEP_NOTEBOOK_PYTHON names another interpreter)")
    with served(name, tmp_path_factory.mktemp(name)) as address, driver.browser() as page:
        page.show(WIDE, HIGH)
        page.go(address)
        shown = Notebook(page, name)
        if name == "jupyterlab":
            page.wait("document.querySelector('.jp-CodeCell .cm-content') !== null", 60)
            ready = "document.querySelector('.jp-Notebook-ExecutionIndicator')?.dataset.status === 'idle'"
            page.wait(ready, 60)
            for _ in range(20):  # keys that come before the editor is ready are lost
                page.click(".jp-CodeCell .cm-content")
                page.press("Enter", shift=True)
                time.sleep(1.0)
                if page.text(".jp-InputPrompt") != "[ ]:":
                    break
        widget = f"{shown.all('.metrosep-explore')}[0]?.dataset"
        page.wait(f"{widget}?.maps > 0 && {widget}.sections > 0 && {widget}.spectrums > 0", 60)
        time.sleep(1.0)  # the finer picture
        shown.picture("start")
        if name == "jupyterlab":
            shown.type(STATE)
        yield shown


@pytest.fixture
def fresh(book: Notebook) -> Notebook:
    """The notebook with the light scheme and the widget in view."""
    book.page.show(WIDE, HIGH)
    book.one(".metrosep-explore", "e.scrollIntoView({ block: 'center' })")
    return book


def rim(book: Notebook) -> tuple[float, float, float]:
    """Return where x = 0 and y = 0 lie on the screen, and CSS pixels per m, by the handles."""
    places, words = [], []
    for name in "AB":
        handle = f'[aria-label="Section end {name}"]'
        places.append(book.middle(handle))
        text = book.one(handle, "e.getAttribute('aria-valuetext')")
        found = re.findall(r"([0-9.]+)\u2009(mm|µm)", text)
        words.append([float(v) * {"mm": 1e-3, "µm": 1e-6}[unit] for v, unit in found])
    (ax, ay), (bx, _) = places
    scale = (bx - ax) / (words[1][0] - words[0][0])
    return ax - words[0][0] * scale, ay + words[0][1] * scale, scale


# ---- tests ------------------------------------------------------------------------------------


def test_all_pictures_are_drawn(fresh: Notebook) -> None:
    assert fresh.page.run(f"{fresh.all('.metrosep-explore .uplot')}.length") == 2
    messages = f"{fresh.all('.plot-empty, .panel-message')}.filter((e) => !e.hidden).map((e) => e.textContent).join('')"
    assert fresh.page.run(messages) == ""
    width = fresh.one(".metrosep-explore", "e.clientWidth")
    height = fresh.one(".metrosep-explore", "e.clientHeight")
    assert (width > 640, height) == (True, 480)
    for picture in ("section", "spectrum"):
        assert sum(fresh.inked(picture)) > 100, picture
    assert "P-V" in fresh.one('[data-picture="section"] .readout', "e.textContent")
    assert "RMS inside" in fresh.one('[data-picture="spectrum"] .readout', "e.textContent")


def test_asks_nobody_but_this_computer_and_has_no_errors(fresh: Notebook) -> None:
    own = ("http://127.0.0.1:", "ws://127.0.0.1:", "data:", "blob:http://127.0.0.1:")
    assert [r for r in fresh.page.requests if not r.startswith(own)] == []
    assert any(r.startswith("ws://127.0.0.1:") for r in fresh.page.requests)
    assert fresh.page.errors == []


def test_what_was_not_measured_is_grey_and_a_gap(fresh: Notebook) -> None:
    x0, y0, scale = rim(fresh)
    for x, y in ((3.62e-3, 2.6e-3), (4.17e-3, 2.6e-3), (3.9e-3, 3.4e-3)):
        assert fresh.pixel(x0 + x * scale, y0 - y * scale) == GREY, (x, y)
    for x, y in ((3.5e-3, 2.8e-3), (4.3e-3, 2.8e-3), (3.9e-3, 2.4e-3), (3.9e-3, 3.6e-3)):
        assert fresh.pixel(x0 + x * scale, y0 - y * scale) != GREY, (x, y)
    state, inked = fresh.state(), fresh.inked("section")
    assert (
        state["missing"] == 31
    )  # between 30 pixels and their neighbours: a lies half a pixel off
    part = [(v - state["a"][0]) / state["length"] * len(inked) for v in HOLE[:2]]
    first, last = round(part[0]) + 2, round(part[1]) - 3
    cursor = {round(k * len(inked)) + d for k in (0.25, 0.75) for d in range(-2, 3)}
    assert last - first > 20
    assert not any(inked[i] for i in {*range(first, last)} - cursor)
    outside = {*range(3, first - 6), *range(last + 6, len(inked) - 3)} - cursor
    assert all(inked[i] for i in outside)


def test_a_dragged_end_moves_the_section_in_python(fresh: Notebook) -> None:
    _, _, scale = rim(fresh)
    before = fresh.state()
    by = (60.0, 90.0)  # right and down: x grows, y falls
    draws = int(fresh.one(".metrosep-explore", "e.dataset.sections"))
    fresh.page.drag(fresh.middle(END_A), by, seconds=0.6)
    want = (before["a"][0] + by[0] / scale, before["a"][1] - by[1] / scale)
    near = ONE_PIXEL / scale
    state = fresh.state(lambda s: all(abs(s["a"][k] - want[k]) < near for k in (0, 1)))
    assert state["a"] == [pytest.approx(v, abs=near) for v in want]
    assert state["b"] == before["b"]
    long = sum((p - q) ** 2 for p, q in zip(state["a"], state["b"], strict=True)) ** 0.5
    assert state["length"] == pytest.approx(long, abs=1e-12)
    assert int(fresh.one(".metrosep-explore", "e.dataset.sections")) > draws + 3  # it followed
    title = f"{fresh.all('[data-picture=section]')}[0].parentElement.textContent"
    fresh.page.wait(f"{title}.includes('{1e3 * long:.3f}\u2009mm')", 5)


def test_a_limit_of_the_band_is_moved_by_keys(fresh: Notebook) -> None:
    before = fresh.state()["band"]
    fresh.one('[aria-label="Longest wavelength of the band"]', "e.focus()")
    for _ in range(5):
        fresh.page.press("ArrowRight")
    time.sleep(0.3)
    after = fresh.state(lambda s: s["band"][1] > before[1])["band"]
    assert after[0] == before[0]
    assert after[1] > before[1]


def test_python_moves_the_handle(fresh: Notebook) -> None:
    fresh.set_a()
    words = f"{fresh.all(END_A)}[0].getAttribute('aria-valuetext')"
    fresh.page.wait(f"{words} === 'x 1.000\u2009mm, y 5.000\u2009mm'", 10)
    (ax, ay), (bx, by) = (fresh.middle(f'[aria-label="Section end {n}"]') for n in "AB")
    x0, y0, scale = rim(fresh)
    b = fresh.state()["b"]
    assert (x0 + b[0] * scale, y0 - b[1] * scale) == (
        pytest.approx(bx, abs=ONE_PIXEL),
        pytest.approx(by, abs=ONE_PIXEL),
    )
    assert by - ay == pytest.approx((5e-3 - b[1]) * scale, abs=ONE_PIXEL)
    assert ax < bx


def luminance(colour: str) -> float:
    """Return the relative luminance of a colour that a style gives."""
    parts = [int(v) / 255 for v in colour.removeprefix("rgb(").removesuffix(")").split(",")[:3]]
    lit = [v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4 for v in parts]
    return 0.2126 * lit[0] + 0.7152 * lit[1] + 0.0722 * lit[2]


def contrast(book: Notebook) -> tuple[float, float]:
    """Return the luminance of a panel, and the contrast of its words."""
    words = luminance(book.one('[data-picture="section"] .readout', "getComputedStyle(e).color"))
    panel = luminance(book.one(".metrosep-explore .box", "getComputedStyle(e).backgroundColor"))
    low, high = sorted((words, panel))
    return panel, (high + 0.05) / (low + 0.05)


def cursors(book: Notebook) -> list[float]:
    """Return where the cursors of the section stand, as parts of the width of the plot."""
    got: list[float] = book.one(
        '[data-picture="section"] .u-over',
        "[...e.querySelectorAll('.handle-upright')].map((h) => { const b = h.getBoundingClientRect(),"
        "o = e.getBoundingClientRect(); return (b.left + b.width / 2 - o.left) / o.width; })",
    )
    return got


def test_dark_and_light(fresh: Notebook) -> None:
    """The widget follows the notebook; 4.5 is the least contrast that WCAG 2 allows."""
    widget = f"{fresh.all('.metrosep-explore')}[0].dataset.scheme"
    for scheme, is_dark in (("dark", True), ("light", False)):
        fresh.page.show(WIDE, HIGH, scheme)
        fresh.page.wait(f"{widget} === '{scheme}'")
        time.sleep(0.3)
        panel, ratio = contrast(fresh)
        assert (panel < 0.2) is is_dark
        assert ratio > 4.5
        assert sum(fresh.inked("section")) > 100  # in the ink of the scheme
        x0, y0, scale = rim(fresh)
        assert fresh.pixel(x0 + 3.9e-3 * scale, y0 - 3.4e-3 * scale) == GREY
        assert cursors(fresh) == [pytest.approx(v, abs=0.02) for v in (0.25, 0.75)]
        fresh.picture(scheme)
