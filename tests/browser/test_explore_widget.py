"""The front end of `explore()` by itself, in an empty page: sizes, schemes, ends; no notebook."""

from __future__ import annotations

import base64
import itertools
import json
from typing import Any

import numpy as np
import pytest

from metrosep import Profile, Surface
from metrosep.app.notebook import Exploration, widget_module, widget_style

pytestmark = pytest.mark.browser

STEP = 20e-6

MODEL = """
window.made = (values) => {
  const heard = new Map(), sent = [];
  for (const [k, v] of Object.entries(values)) {
    if (k.endsWith("_frame")) values[k] = new DataView(Uint8Array.from(atob(v), (c) => c.charCodeAt(0)).buffer);
  }
  return {
    sent, heard,
    get: (k) => values[k],
    set(k, v) { values[k] = v; },
    on(k, f) { heard.set(k, [...(heard.get(k) ?? []), f]); },
    off(k, f) { heard.set(k, (heard.get(k) ?? []).filter((g) => g !== f)); },
    save_changes() { sent.push(JSON.stringify(values.view ?? null)); },
    tell(k) { (heard.get(`change:${k}`) ?? []).forEach((f) => f()); },
  };
};
"""


def traits(obj: Surface | Profile, **more: Any) -> dict[str, Any]:
    """Return the traits as Python sends them first."""
    shown = Exploration(obj)
    ends = shown.first_section or (None, None)
    band = shown.first_band(*ends)
    frames = {"spectrum_frame": shown.spectrum(*ends, band)}
    if shown.kind == "map":
        assert ends[0] is not None
        frames |= {"map_frame": shown.map(), "section_frame": shown.section(*ends)}
    else:
        frames["profile_frame"] = shown.profile()
    plain = {"kind": shown.kind, "colours": "viridis", "height": 480, "a": ends[0], "b": ends[1]}
    coded = {k: base64.b64encode(v).decode() for k, v in frames.items()}
    return {**plain, "band": band, "limits": None, "window": None, **coded, **more}


def bumpy() -> Surface:
    """Return a map 2 mm by 3 mm, its upper right quarter not measured."""
    y, x = np.mgrid[0:150, 0:100] * STEP
    z = 1e-9 * np.cos(2 * np.pi * x / 0.2e-3) + 1e-6 * y
    z[75:, 50:] = np.nan
    return Surface(z, dx=STEP, dy=STEP)


def placed(page: Any, given: dict[str, Any], style: str) -> None:
    """Render the widget into a new element of the page with a style."""
    page.run(MODEL)
    page.run(
        f"(async () => {{ const blob = new Blob([{json.dumps(widget_module())}], {{ type: 'text/javascript' }});"
        "window.widget = (await import(URL.createObjectURL(blob))).default;"
        f"const css = document.createElement('style'); css.textContent = {json.dumps(widget_style())};"
        "document.head.append(css); window.el = document.createElement('div');"
        f"el.style.cssText = {json.dumps(style)}; window.model = made({json.dumps(given)});"
        "window.end = widget.render({ model, el }); })()"
    )


def cursor_places(page: Any) -> list[float]:
    """Return where the two cursors of the section stand, as parts of the width of the plot."""
    got: list[float] = page.run(
        "[...el.querySelectorAll('[data-picture=section] .handle-upright')].map((h) => {"
        "const b = h.getBoundingClientRect(), o = h.parentElement.getBoundingClientRect();"
        "return (b.left + b.width / 2 - o.left) / o.width; })"
    )
    return got


CURSORS = [pytest.approx(v, abs=0.02) for v in (0.25, 0.75)]


def test_drawn_before_it_is_on_the_page(tab: Any) -> None:
    """A notebook may render into an element that has no place and no size yet."""
    placed(tab, traits(bumpy()), "width: 900px")
    assert tab.run("el.querySelector('.metrosep-explore').clientWidth") == 0
    tab.run("document.body.append(el)")
    tab.wait("el.querySelectorAll('.uplot canvas').length === 2")
    tab.wait("el.querySelector('.uplot canvas').clientWidth > 200")
    tab.run("new Promise((done) => setTimeout(done, 200))")
    assert cursor_places(tab) == CURSORS
    grey = (
        "(() => { const c = el.querySelector('.map canvas'), d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;"
        "let grey = 0, seen = 0; for (let i = 0; i < d.length; i += 4) if (d[i + 3]) { seen += 1;"
        "if (d[i] === 138 && d[i + 1] === 138 && d[i + 2] === 138) grey += 1; } return grey / seen; })()"
    )
    assert tab.run(grey) == pytest.approx(0.25, abs=0.01)
    assert tab.errors == []


def test_drawn_while_it_was_hidden(tab: Any) -> None:
    """JupyterLab hides cells that are scrolled away; frames still come."""
    placed(tab, traits(bumpy()), "width: 900px")
    tab.run("document.body.append(el)")
    tab.wait("el.querySelector('.uplot canvas')?.clientWidth > 200")
    tab.run("el.style.display = 'none'; new Promise((done) => setTimeout(done, 100))")
    tab.run("for (const k of ['section_frame', 'spectrum_frame', 'map_frame']) model.tell(k)")
    tab.show(1366, 768, "dark")
    tab.run("new Promise((done) => setTimeout(done, 100))")
    tab.run("el.style.display = ''; new Promise((done) => setTimeout(done, 200))")
    assert cursor_places(tab) == CURSORS
    ticks = "el.querySelector('[data-picture=spectrum] .readout').textContent"
    assert "RMS inside" in tab.run(ticks)
    assert tab.errors == []


def test_drawn_while_it_was_off_the_page_for_a_moment(tab: Any) -> None:
    """JupyterLab moves its cells: no change of size is ever seen, but frames come in between."""
    placed(tab, traits(bumpy()), "width: 900px")
    tab.run("document.body.append(el)")
    tab.wait("el.querySelector('.uplot canvas')?.clientWidth > 200")
    tab.run("new Promise((done) => setTimeout(done, 200))")
    tab.run(
        "(async () => { el.remove(); for (const k of ['section_frame', 'spectrum_frame']) model.tell(k);"
        "await null; await null; await null; document.body.append(el); })()"
    )
    tab.run("new Promise((done) => setTimeout(done, 200))")
    assert cursor_places(tab) == CURSORS
    assert tab.errors == []


def test_narrow_stands_under_one_another(tab: Any) -> None:
    placed(tab, traits(bumpy()), "width: 400px")
    tab.run("document.body.append(el)")
    tab.wait("el.querySelector('.metrosep-explore').classList.contains('narrow')")
    tab.run("new Promise((done) => setTimeout(done, 200))")
    boxes = tab.run(
        "[...el.querySelectorAll('.box')].map((e) => { const b = e.getBoundingClientRect();"
        "return [b.left, b.top, b.right, b.bottom]; })"
    )
    assert len({b[0] for b in boxes}) == 1
    for above, below in itertools.pairwise(boxes):
        assert above[3] <= below[1]
    assert all(b[2] - b[0] <= 400 and b[3] - b[1] > 100 for b in boxes)


def test_a_refusal_is_shown_in_its_picture_and_the_others_stay(tab: Any) -> None:
    """Ends that are equal: no section, and the map is still there."""
    given = traits(bumpy())
    shown = Exploration(bumpy())
    given["section_frame"] = base64.b64encode(shown.section((1e-3, 1e-3), (1e-3, 1e-3))).decode()
    placed(tab, given, "width: 900px")
    tab.run("document.body.append(el)")
    words = tab.wait("el.querySelector('[data-picture=section] .plot-empty').textContent")
    assert words.startswith("the section runs from (1 mm, 1 mm) to (1 mm, 1 mm): its ends must")
    assert tab.run("el.querySelector('.panel-message').hidden")
    assert tab.run("el.querySelector('[data-picture=spectrum] .plot-empty').textContent") == ""


def test_a_profile_has_its_two_plots(tab: Any) -> None:
    x = np.arange(400) * 1e-6
    z = 1e-9 * np.cos(2 * np.pi * x / 20e-6)
    z[100:120] = np.nan
    placed(tab, traits(Profile(x, z)), "width: 900px")
    tab.run("document.body.append(el)")
    tab.wait("el.querySelectorAll('.uplot canvas').length === 2")
    assert tab.run("el.querySelector('.map')") is None
    read = tab.wait("el.querySelector('[data-picture=profile] .readout').textContent")
    assert read == "0\u2009m to 399.0\u2009µm"
    assert tab.errors == []


def test_labels_of_many_decades_stand_apart(tab: Any) -> None:
    """Pure waves leave amplitudes of 1e-20 m: 12 decades on some 120 pixels."""
    x = np.arange(4000) * 1e-6
    placed(tab, traits(Profile(x, 1e-9 * np.cos(2 * np.pi * x / 20e-6))), "width: 900px")
    tab.run(
        "const put = CanvasRenderingContext2D.prototype.fillText; window.written = [];"
        "CanvasRenderingContext2D.prototype.fillText = function (text, x, y) {"
        "if (String(text).endsWith('m') && this.textAlign === 'right') written.push([y, text]); return put.call(this, text, x, y); };"
    )
    tab.run("document.body.append(el)")
    tab.wait("el.querySelector('[data-picture=spectrum] .uplot canvas')?.clientWidth > 200")
    tab.run("new Promise((done) => setTimeout(done, 200))")
    written = tab.run(
        "written.length = 0; model.tell('spectrum_frame'); new Promise((done) => setTimeout(() => done(written), 200))"
    )
    rows = sorted({y for y, _ in written})
    assert len(rows) >= 3
    assert all(b - a >= 14 for a, b in itertools.pairwise(rows))  # letters of 12 pixels


def test_its_end_takes_everything_away(tab: Any) -> None:
    placed(tab, traits(bumpy()), "width: 900px")
    tab.run("document.body.append(el)")
    tab.wait("el.querySelector('.uplot canvas')?.clientWidth > 200")
    tab.run("end()")
    assert tab.run("el.childElementCount") == 0
    left = tab.run("[...model.heard.values()].reduce((n, l) => n + l.length, 0)")
    assert left == 0
    tab.show(1000, 700, "dark")
    tab.run("new Promise((done) => setTimeout(done, 100))")
    assert tab.errors == []


def test_its_style_touches_nothing_else(tab: Any) -> None:
    tab.run("document.body.innerHTML = '<div class=\"plot\">x</div><button>y</button>'")
    look = (
        "JSON.stringify([...document.querySelectorAll('body, body > .plot, body > button')].map((e) => {"
        "const s = getComputedStyle(e); return [...s].filter((k) => !/size|perspective|transform-origin/.test(k)).map((k) => s[k]); }))"
    )
    before = tab.run(look)
    placed(tab, traits(bumpy()), "width: 900px")
    assert tab.run(look) == before
