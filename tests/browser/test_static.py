"""What holds of the files of the page without a browser: nothing from outside, readable contrast."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import metrosep.app

STATIC = Path(metrosep.app.__file__).parent / "static"
OWN = sorted(p for p in STATIC.iterdir() if p.suffix in (".js", ".css", ".html"))
READABLE = 4.5
"""Contrast of text after WCAG 2, level AA."""

LONGEST = 400
"""Lines of a module: a concept, of which house.md allows 700 in Python."""


def luminance(colour: str) -> float:
    parts = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(a: str, b: str) -> float:
    high, low = sorted((luminance(a), luminance(b)), reverse=True)
    return (high + 0.05) / (low + 0.05)


def schemes() -> list[dict[str, str]]:
    text = (STATIC / "style.css").read_text(encoding="utf-8")
    blocks = re.findall(r":root \{(.*?)\}", text, flags=re.DOTALL)
    assert len(blocks) == 2
    return [dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6});", block)) for block in blocks]


def test_contrast_is_that_of_black_on_white() -> None:
    assert contrast("#000000", "#ffffff") == pytest.approx(21.0, abs=1e-9)


@pytest.mark.parametrize("scheme", [0, 1], ids=["light", "dark"])
def test_text_is_readable(scheme: int) -> None:
    c = schemes()[scheme]
    pairs = [
        ("ink", "panel"),
        ("ink", "raised"),
        ("soft", "panel"),
        ("soft", "raised"),
        ("soft", "chosen"),
        ("ink", "chosen"),
    ]
    pairs += [
        ("on-accent", "accent"),
        ("good", "good-back"),
        ("bad", "bad-back"),
        ("open", "open-back"),
        ("line", "panel"),
    ]
    pairs += [("good", "panel"), ("bad", "panel"), ("open", "panel")]
    poor = {
        (a, b): round(contrast(c[a], c[b]), 2) for a, b in pairs if contrast(c[a], c[b]) < READABLE
    }
    assert poor == {}
    assert contrast(c["focus"], c["panel"]) >= 3.0  # WCAG 2, what is not a text


@pytest.mark.parametrize("file", OWN, ids=lambda p: p.name)
def test_nothing_is_fetched_from_outside(file: Path) -> None:
    text = file.read_text(encoding="utf-8").replace("http://www.w3.org/2000/svg", "")
    assert re.findall(r"https?://|//cdn|@import", text) == []


@pytest.mark.parametrize("file", [p for p in OWN if p.suffix == ".js"], ids=lambda p: p.name)
def test_modules_are_checked_short_and_do_not_ask_the_locale(file: Path) -> None:
    text = file.read_text(encoding="utf-8")
    assert text.startswith("// @ts-check\n")
    assert [w for w in ("toLocaleString", "Intl.", "innerHTML") if w in text] == []
    assert len(text.splitlines()) <= LONGEST


@pytest.mark.parametrize("name", ["map", "section", "spectrum", "density", "profile", "colourbar"])
def test_widgets_have_the_shape_of_anywidget(name: str) -> None:
    text = (STATIC / f"{name}.js").read_text(encoding="utf-8")
    assert "function render({ model, el" in text
    assert "export default { render };" in text


def test_the_vendored_library_has_its_licence() -> None:
    assert "MIT" in (STATIC / "vendor" / "LICENSE").read_text(encoding="utf-8")
    assert "1.6.32" in (STATIC / "vendor" / "uPlot.esm.js").read_text(encoding="utf-8")[:400]
