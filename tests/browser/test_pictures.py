"""What the page draws, checked by pixel, and how it follows the hand."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.browser

GREY = [138, 138, 138]
LEAST_UPDATES = 5
"""Of the section while a handle is dragged: one that comes at the release only is drawn once or twice. How
many there are in a second depends on what else the machine does, and is measured by `make speeds`."""

Opened = Callable[..., Any]


def pixel(page: Any, canvas: str, x: float, y: float) -> list[int]:
    """Return red, green and blue of a canvas at a place of the page."""
    return page.run(
        f"(() => {{ const c = document.querySelector({json.dumps(canvas)}), b = c.getBoundingClientRect();"
        f"return [...c.getContext('2d').getImageData(Math.round({x} - b.left), Math.round({y} - b.top), 1, 1)"
        ".data].slice(0, 3); })()"
    )


def shown(page: Any, selector: str) -> None:
    """Click a step, and wait until its map is drawn."""
    page.wait("document.body.dataset.maps > 0")
    before = int(page.run("document.body.dataset.maps"))
    page.click(selector)
    page.wait(f"document.body.dataset.maps > {before}")
    page.run(
        "new Promise((done) => setTimeout(done, 300))"
    )  # the answer before it may have come first


def place(page: Any, u: float, v: float) -> tuple[float, float]:
    """Return where a part of the map lies on the page; A and B stand at 8 % and 92 % of its width."""
    ax, ay = page.middle('[aria-label="Section end A"]')
    bx, _ = page.middle('[aria-label="Section end B"]')
    width = (bx - ax) / 0.84
    return ax + (u - 0.08) * width, ay + (0.5 - v) * width


def test_asks_nobody_but_this_computer_and_has_no_errors(opened: Opened, map_file: Path) -> None:
    page = opened(map_file)
    page.wait("document.body.dataset.spectrums > 0")
    foreign = [
        r
        for r in page.requests
        if not r.startswith(("http://127.0.0.1:", "ws://127.0.0.1:", "data:"))
    ]
    assert foreign == []
    assert any(r.startswith("ws://127.0.0.1:") for r in page.requests)
    assert page.errors == []
    assert "token" not in page.run("location.href")


def test_what_is_not_measured_is_grey_and_nothing_else(opened: Opened, map_file: Path) -> None:
    page = opened(map_file)
    shown(page, '[data-step="0"] .pick')  # heights after the form
    assert "step 1" in page.text("#map-stage")
    hole = (390 / 600, 0.5 + 40 / 600)  # 40 rows above the middle: the line A-B is not in the way
    assert pixel(page, "#map canvas", *place(page, *hole)) == GREY
    assert pixel(page, "#map canvas", *place(page, 0.02, 0.98)) == GREY  # outside the circle
    for u, v in ((0.3, 0.6), (0.5, 0.8), (0.8, 0.3), (0.5, 0.2)):
        red, green, blue = pixel(page, "#map canvas", *place(page, u, v))
        assert not red == green == blue, (u, v)


def test_heights_go_from_dark_to_bright_the_right_way_up(opened: Opened, tmp_path: Path) -> None:
    import numpy as np

    from metrosep import Surface
    from metrosep.io.write import write

    z = np.tile(np.linspace(0.0, 1e-6, 64)[:, np.newaxis], (1, 64))  # rises with y
    file = tmp_path / "ramp.x3p"
    write(Surface(z, dx=1e-5, dy=1e-5), file)
    page = opened(file)
    shown(page, ".step .pick")
    assert page.text("#map-stage") == "as measured"
    bottom, top = (
        pixel(page, "#map canvas", *place(page, 0.3, 0.05)),
        pixel(page, "#map canvas", *place(page, 0.3, 0.95)),
    )
    assert sum(top) > sum(bottom) + 200  # viridis: yellow above, violet below


def test_a_gap_of_the_section_is_a_gap(opened: Opened, map_file: Path) -> None:
    page = opened(map_file)
    page.wait("document.body.dataset.sections > 0")
    ink = page.run(
        """(() => {
          const c = document.querySelector('#section canvas'), o = document.querySelector('#section .u-over');
          const b = c.getBoundingClientRect(), p = o.getBoundingClientRect(), out = [];
          const data = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;
          for (let x = 0; x < p.width; x += 1) {
            let n = 0;
            for (let y = 0; y < p.height; y += 1) {
              const i = 4 * (Math.round(p.top - b.top + y) * c.width + Math.round(p.left - b.left + x));
              if (data[i + 2] - data[i] > 90) n += 1;   // the blue of the line, not the grey of the grid
            }
            out.push(n);
          }
          return out;
        })()"""
    )
    width = len(ink)
    start, stop = ((k / 600 - 0.08) / 0.84 * width for k in (360, 420))
    inside = ink[round(start) + 4 : round(stop) - 4]
    assert len(inside) > 20
    assert sum(inside) == 0
    assert all(n > 0 for n in ink[4 : round(start) - 4])
    assert all(n > 0 for n in ink[round(stop) + 4 : -4])


def test_the_section_follows_the_pointer(opened: Opened, map_file: Path) -> None:
    page = opened(map_file)
    page.wait("document.body.dataset.sections > 0")
    before = int(page.run("document.body.dataset.sections"))
    length = page.text("#section-of")
    page.drag(page.middle('[aria-label="Section end A"]'), (120, -150), seconds=1.5)
    page.wait(f"document.querySelector('#section-of').textContent !== {json.dumps(length)}")
    assert int(page.run("document.body.dataset.sections")) - before >= LEAST_UPDATES


def test_arrows_move_an_end_by_one_pixel_and_by_ten(opened: Opened, map_file: Path) -> None:
    page = opened(map_file)
    where = '[aria-label="Section end B"]'
    page.run(f"document.querySelector({json.dumps(where)}).focus()")
    x, y = page.middle(where)
    page.press("ArrowRight")
    page.press("ArrowUp", shift=True)
    x1, y1 = page.middle(where)
    assert (x1 - x, y1 - y) == (pytest.approx(1.0, abs=0.05), pytest.approx(-10.0, abs=0.05))


def test_wheel_zooms_about_the_pointer(opened: Opened, map_file: Path) -> None:
    page = opened(map_file)
    a, b = (page.middle(f'[aria-label="Section end {k}"]') for k in "AB")
    page.call("Input.dispatchMouseEvent", type="mouseWheel", x=a[0], y=a[1], deltaX=0, deltaY=-200)
    page.wait(
        f"document.querySelector('[aria-label=\"Section end B\"]').getBoundingClientRect().left > {b[0] + 20}"
    )
    now = page.middle('[aria-label="Section end A"]')
    assert now[0] == pytest.approx(a[0], abs=0.6)  # the pointer's pixel stays, but for rounding
    assert now[1] == pytest.approx(a[1], abs=0.6)
    page.click("#fit")
    assert page.middle('[aria-label="Section end B"]')[0] == pytest.approx(b[0], abs=0.1)


def test_limits_of_the_spectrum_move_by_mouse_and_by_key(opened: Opened, map_file: Path) -> None:
    page = opened(map_file)
    page.wait("document.querySelector('#spectrum .readout').textContent.includes('RMS')")
    handle = '[aria-label="Longest wavelength of the band"]'
    start = page.run(
        f"document.querySelector({json.dumps(handle)}).getAttribute('aria-valuetext')"
    )
    x, y, width, _ = page.box(handle)
    page.drag((x + width / 2, y + 7), (60, 0))
    dragged = page.run(
        f"document.querySelector({json.dumps(handle)}).getAttribute('aria-valuetext')"
    )
    assert dragged != start
    said = page.text("#spectrum .readout")
    assert dragged in said
    page.press("ArrowRight", shift=True)
    after = page.box(handle)[0]
    assert after - x == pytest.approx(70.0, abs=1.0)
    short = '[aria-label="Shortest wavelength of the band"]'
    x, y, width, _ = page.box(short)
    page.drag((x + width / 2, y + 7), (-30, 0))
    page.mouse("mouseMoved", 5, 5)
    page.wait(f"document.querySelector('#spectrum .readout').textContent !== {json.dumps(said)}")


def test_the_colour_bar_moves_the_range(opened: Opened, map_file: Path) -> None:
    page = opened(map_file)
    before = pixel(page, "#map canvas", *place(page, 0.3, 0.6))
    x, y = page.middle('[aria-label="Upper end of the colours"]')
    page.drag((x - 8, y), (0, 150))
    page.wait("!document.querySelector('.colourbar button').disabled")
    page.wait("document.body.dataset.maps > 2")
    after = pixel(page, "#map canvas", *place(page, 0.3, 0.6))
    assert after != before
    page.click(".colourbar button")
    page.wait("document.querySelector('.colourbar button').disabled")


NM, UM = 1e-9, 1e-6
READ_OUT = 0.05 * NM
"""Four digits of some hundred nm."""


def cursor_height(page: Any, k: int) -> float:
    page.wait("document.querySelectorAll('#section .handle-upright').length === 2")
    words = str(
        page.wait(
            f"(() => {{ const t = document.querySelectorAll('#section .handle-upright')[{k}].getAttribute('aria-valuetext');"
            "return t && !t.includes('…') && t; })()"
        )
    )
    number, unit = words.split("height ")[1].replace("\u2212", "-").split("\u2009")
    return float(number) * {"nm": NM, "µm": UM, "pm": 1e-12}[unit]


def grooves(file: Path) -> list[float]:
    """Write grooves of five pixels; return the heights above their plane at 1/4 and 3/4 of A-B."""
    import numpy as np

    from metrosep import Surface
    from metrosep.io.write import write

    n = 2050  # A lies at -0.5 + 0.08 n and B at -0.5 + 0.92 n: both cursors on pixels, 594 and 1455
    i = np.arange(n)
    z = 0.1 * NM * i - 600 * NM * (i % 10 < 5)
    write(Surface(np.tile(z, (41, 1)), dx=1 * UM, dy=1 * UM), file)
    flat = z - np.polyval(np.polyfit(i, z, 1), i)
    return [float(flat[594]), float(flat[1455])]  # the one in a groove, the other beside one


@pytest.mark.parametrize("width", [320, 800, 1366])
def test_a_cursor_reads_the_same_height_in_every_window(
    opened: Opened, tab: Any, tmp_path: Path, width: int
) -> None:
    """A column of a narrow plot holds both levels: its middle is 300 nm beside them."""
    expected = grooves(tmp_path / "grooves.x3p")
    assert expected[1] - expected[0] == pytest.approx(600 * NM, abs=5 * NM)
    tab.show(width, 800)
    page = opened(tmp_path / "grooves.x3p")
    for k in (0, 1):
        assert cursor_height(page, k) == pytest.approx(expected[k], abs=READ_OUT)
    assert page.errors == []


def test_a_wider_window_draws_the_section_anew(opened: Opened, tab: Any, tmp_path: Path) -> None:
    """Columns of 390 pixels stretched over 1600 would draw each edge as a wedge."""
    grooves(tmp_path / "grooves.x3p")
    tab.show(390, 800)
    page = opened(tmp_path / "grooves.x3p")
    page.wait("document.body.dataset.sections > 0")
    before = int(page.run("document.body.dataset.sections"))
    tab.show(1600, 800)
    page.wait(f"document.body.dataset.sections > {before}", 10)
    assert page.errors == []


def test_an_angle_is_read_in_degrees_and_a_slope_in_rad(opened: Opened, tmp_path: Path) -> None:
    grooves(tmp_path / "grooves.x3p")
    (tmp_path / "r.toml").write_text(
        'metrosep = 1\n[input]\nfiles = ["grooves.x3p"]\n[[step]]\nop = "parameters"\n'
        '[[section]]\nkind = "angle"\nname = "corner"\na = "0.1 mm, 0.01 mm"\nb = "0.05 mm, 0.01 mm"\n'
        'c = "0.05 mm, 0.03 mm"\n[[section]]\nkind = "distance"\nname = "way"\na = "0.1 mm, 0.01 mm"\n'
        'b = "0.12 mm, 0.03 mm"\n'
    )
    page = opened(tmp_path / "r.toml")
    value = "document.querySelector('[data-metric=\"{}\"] td:nth-child(2)').textContent"
    assert page.run(value.format("section.corner.angle")) == "90.00\u2009°"
    assert page.run(value.format("section.way.azimuth")) == "45.00\u2009°"
    assert page.run(value.format("section.way.slope")).endswith("rad")
    assert page.errors == []
