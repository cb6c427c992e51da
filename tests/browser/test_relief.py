"""The map in three dimensions: what is drawn, what is not, and what happens without graphics."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.browser

Opened = Callable[..., Any]
STEP, N = 10e-6, 200
CANVAS = "document.querySelector('#relief canvas')"
COLOUR = f"""((u, v) => {{ const c = {CANVAS}, g = c.getContext('webgl2'), p = new Uint8Array(4);
g.readPixels(Math.round(c.width / 2 + u), Math.round(c.height / 2 + v), 1, 1, g.RGBA, g.UNSIGNED_BYTE, p);
return [...p]; }})"""
SUM = f"""(() => {{ const c = {CANVAS}, g = c.getContext('webgl2'), p = new Uint8Array(4 * c.width * c.height);
g.readPixels(0, 0, c.width, c.height, g.RGBA, g.UNSIGNED_BYTE, p); let n = 0, h = 0;
for (let i = 0; i < p.length; i += 4) {{ n += p[i + 3] > 0; h = (h * 31 + p[i] + 7 * p[i + 1]) % 1e9; }}
return [n, h]; }})()"""
"""How many pixels are drawn, and a number that another picture does not have."""


@pytest.fixture
def plate(tmp_path: Path) -> Path:
    """A gentle slope with a hole of 20 x 20 pixels up and left of the middle."""
    from metrosep import Surface
    from metrosep.io.write import write

    y, x = np.mgrid[:N, :N] * STEP
    z = 50e-6 + 20e-9 * np.sin(x / 2e-4) + 10e-9 * np.cos(y / 1e-4)
    z[150:170, 30:50] = np.nan
    write(Surface(z, STEP, STEP), tmp_path / "plate.x3p")
    return tmp_path / "plate.x3p"


def turned(page: Any, key: str, times: int) -> None:
    """Press a key, and wait until the picture of the last one rests."""
    for _ in range(times):
        page.press(key)
    before = page.run(f"{CANVAS}.dataset.frames")
    page.wait(f"{CANVAS}.dataset.frames !== '{before}'")
    page.run("new Promise((done) => setTimeout(done, 500))")


def relief_of(opened: Opened, file: Path) -> Any:
    page = opened(file)
    page.press("v")
    page.wait(f"{CANVAS}?.dataset.frames > 0")
    page.run(f"{CANVAS}.focus()")
    return page


def test_a_hole_shows_the_background_where_it_lies(opened: Opened, plate: Path) -> None:
    page = relief_of(opened, plate)
    turned(page, "ArrowUp", 17)  # from above: elevation 0.75 + 17 x 0.05, at most a right angle
    turned(page, "ArrowRight", 12)  # azimuth from -0.6 to 0: x to the right, y up
    half = page.run(f"Math.min({CANVAS}.width, {CANVAS}.height) / 2 * 0.68")

    def colour(column: float, row: float) -> list[int]:
        u, v = ((k - (N - 1) / 2) / ((N - 1) / 2) * half for k in (column, row))
        return list(page.run(f"{COLOUR}({u}, {v})"))

    assert colour(40, 160)[3] == 0  # the hole
    assert colour(160, 160)[3] == 255  # its mirror images are drawn
    assert colour(40, 40)[3] == 255
    assert colour(53, 160)[3] == 255  # beside it
    assert colour(205, 100)[3] == 0  # beyond the map


WHITE = f"""(() => {{ const c = {CANVAS}, g = c.getContext('webgl2'), p = new Uint8Array(4 * c.width * c.height);
g.readPixels(0, 0, c.width, c.height, g.RGBA, g.UNSIGNED_BYTE, p); let n = 0;
for (let i = 0; i < p.length; i += 4) n += p[i] === 255 && p[i + 1] === 255 && p[i + 2] === 255; return n; }})()"""


def test_the_line_from_a_to_b_and_a_groove_lie_on_the_surface(opened: Opened, plate: Path) -> None:
    recipe = plate.parent / "r.toml"
    text = 'metrosep = 1\n[input]\nfiles = ["plate.x3p"]\n[[step]]\nop = "parameters"\n'
    recipe.write_text(text)
    line = relief_of(opened, recipe).run(WHITE)
    assert line > 100  # A-B, though no section is in the recipe
    groove = (
        '[[section]]\nkind = "groove"\nname = "g"\na = "0.9 mm, 1.5 mm"\nb = "1.1 mm, 1.5 mm"\n'
    )
    recipe.write_text(text + groove + 'width = "0.1 mm"\n')
    page = relief_of(opened, recipe)
    assert page.run(WHITE) > line + 100
    assert page.errors == []


def test_the_height_scale_has_a_slider_that_follows_the_keys(opened: Opened, plate: Path) -> None:
    page = relief_of(opened, plate)
    before = page.text("#relief .readout")
    page.run(
        "(() => { const e = document.getElementById('relief-height'); e.value = 4; e.dispatchEvent(new Event('input')); })()"
    )
    page.wait(f"document.querySelector('#relief .readout').textContent !== {before!r}")

    def scale(text: str) -> float:
        number = text.removeprefix("z × ").split(" ")[0].replace("\u2009", "")
        return float(number.removesuffix("k")) * (1e3 if number.endswith("k") else 1.0)

    assert scale(page.text("#relief .readout")) == pytest.approx(
        1.25**4 * scale(before), rel=0.01, abs=0.0
    )
    turned(page, "PageDown", 2)
    assert page.run("document.getElementById('relief-height').value") == "2"
    assert page.errors == []


def test_turning_and_stretching_change_the_picture(opened: Opened, plate: Path) -> None:
    page = relief_of(opened, plate)
    seen = [page.run(SUM)]
    for key in ("ArrowRight", "ArrowUp", "PageUp", "+"):
        turned(page, key, 3)
        seen.append(page.run(SUM))
    assert len({h for _, h in seen}) == len(seen)
    assert all(n > 5000 for n, _ in seen)
    factor = page.text("#relief .readout")
    turned(page, "PageUp", 2)
    assert page.text("#relief .readout") != factor  # the height scale is said
    page.run(f"{CANVAS}.dispatchEvent(new Event('dblclick'))")
    page.wait(f"{CANVAS}.dataset.angles === '-0.600 0.750'")
    page.run("new Promise((done) => setTimeout(done, 500))")
    assert page.run(SUM) == seen[0]
    assert page.errors == []


def test_lost_graphics_come_back(opened: Opened, plate: Path) -> None:
    page = relief_of(opened, plate)
    before = page.run(SUM)
    page.run(f"window.lost = {CANVAS}.getContext('webgl2').getExtension('WEBGL_lose_context')")
    page.run("window.lost.loseContext()")
    page.wait("document.querySelector('#relief .plot-empty').textContent.includes('lost')")
    page.run("window.lost.restoreContext()")
    page.wait("document.querySelector('#relief .plot-empty').textContent === ''")
    page.run("new Promise((done) => setTimeout(done, 600))")
    assert page.run(SUM) == before


def test_without_webgl2_a_sentence_stands_there_and_the_rest_goes_on(
    opened: Opened, plate: Path
) -> None:
    page = opened(plate)
    page.run(
        "HTMLCanvasElement.prototype.getContext = ((old) => function (kind, ...more) {"
        "return kind === 'webgl2' ? null : old.call(this, kind, ...more); })"
        "(HTMLCanvasElement.prototype.getContext)"
    )
    page.press("v")
    page.wait("document.querySelector('#relief .plot-empty').textContent.includes('no WebGL2')")
    page.press("v")
    page.press("c")
    assert page.run("!document.getElementById('map').hidden")
    assert page.errors == []


def test_the_page_is_small_and_asks_nobody_else(opened: Opened, plate: Path) -> None:
    import metrosep.app

    static = Path(metrosep.app.__file__).parent / "static"
    page = relief_of(opened, plate)
    files = [p for p in static.rglob("*") if p.is_file()]
    assert sum(p.stat().st_size for p in files) < 1_000_000
    assert (static / "relief.js").stat().st_size <= 30_000
    new = ("relief", "drawing", "drawing_parts", "shapes")
    assert sum((static / f"{n}.js").stat().st_size for n in new) <= 200_000
    outside = [r for r in page.requests if "//127.0.0.1:" not in r and not r.startswith("about:")]
    assert [r for r in outside if not r.startswith(("data:", "blob:"))] == []


def test_light_is_turned_by_slider_and_keys_and_the_picture_has_its_axes(
    opened: Opened, plate: Path
) -> None:
    page = relief_of(opened, plate)
    pixels = (
        "(() => { const c = document.querySelector('#relief canvas'); const g = c.getContext('webgl2');"
        "const d = new Uint8Array(4 * c.width * c.height); g.readPixels(0, 0, c.width, c.height, g.RGBA,"
        "g.UNSIGNED_BYTE, d); let s = 0; for (let i = 0; i < d.length; i += 4) s += d[i + 1]; return s; })()"
    )
    frames = f"Number({CANVAS}.dataset.frames)"
    at_rest = page.run(pixels)
    slider = "document.getElementById('relief-light')"
    before = page.run(frames)
    page.run(f"({slider}.value = '310', {slider}.dispatchEvent(new Event('input')))")
    page.wait(f"{frames} > {before} && {pixels} !== {at_rest}")
    page.run(f"{CANVAS}.focus()")
    page.press("[")
    page.wait(f"{slider}.value === '325'")
    page.press("Home")
    page.wait(f"{slider}.value === '130'")
    page.run(
        "URL.createObjectURL = (blob) => { createImageBitmap(blob).then((b) => { const c ="
        "document.createElement('canvas'); [c.width, c.height] = [b.width, b.height]; const p ="
        "c.getContext('2d'); p.drawImage(b, 0, 0); window.saved = [b.width, b.height,"
        "p.getImageData(0, 0, 1, 1).data[3]]; }); return 'data:,'; }"
    )
    page.click("#relief-save")
    width, height, alpha = page.wait("window.saved")
    assert width == page.run("document.getElementById('relief').clientWidth")
    assert alpha == 255  # a ground of its own: dark axes stay readable in a report
    assert height > 100
    assert page.errors == []
