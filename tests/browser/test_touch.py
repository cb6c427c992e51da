"""By finger in a narrow window: shapes are drawn, handles moved, two fingers zoom, the view in 3-D turns."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from browser.test_drawing import MIDDLE, MM, RIGHT, Hand, metres, point
from browser.test_work import settled

pytestmark = pytest.mark.browser

Opened = Callable[..., Any]
Place = tuple[float, float]


@pytest.fixture
def page(opened: Opened, tab: Any, map_file: Path) -> Iterator[Any]:
    tab.show(390, 844)
    tab.call("Emulation.setTouchEmulationEnabled", enabled=True, maxTouchPoints=2)
    yield opened(map_file)
    tab.call("Emulation.setTouchEmulationEnabled", enabled=False)


def touch(page: Any, *paths: list[Place]) -> None:
    """Move fingers along paths of equal length, all at a time."""

    def send(kind: str, k: int | None) -> None:
        places = (
            []
            if k is None
            else [{"x": p[k][0], "y": p[k][1], "id": i} for i, p in enumerate(paths)]
        )
        page.call("Input.dispatchTouchEvent", type=kind, touchPoints=places)

    send("touchStart", 0)
    for k in range(1, len(paths[0])):
        send("touchMove", k)
    send("touchEnd", None)


def line(a: Place, b: Place, n: int = 8) -> list[Place]:
    return [(a[0] + k / n * (b[0] - a[0]), a[1] + k / n * (b[1] - a[1])) for k in range(n + 1)]


def drawn(hand: Hand) -> dict[str, Any]:
    return dict(next(s["aperture"] for s in hand.data()["step"] if s["op"] == "mask"))


def test_a_circle_is_drawn_and_moved_by_finger(page: Any) -> None:
    page.click(".draw-bar button")  # circle
    page.run("document.querySelector('#map').scrollIntoView({block: 'center'})")
    hand = Hand(page)
    settled(page, lambda: touch(page, line(hand.at(*MIDDLE), hand.at(*RIGHT))))
    shape = drawn(hand)
    assert metres(shape["diameter"]) == pytest.approx(1.6 * MM, abs=3 * hand.near)
    page.press("Escape")
    page.click('[data-shape="step 1"]')
    page.run("document.querySelector('#map').scrollIntoView({block: 'center'})")
    hand = Hand(page)
    x, y = page.middle('[data-grip="move"]')
    settled(page, lambda: touch(page, line((x, y), (x + 30, y - 20))))
    moved = point(drawn(hand)["centre"])
    before = point(shape["centre"])
    assert moved[0] - before[0] == pytest.approx(30 * hand.scale, abs=3 * hand.near)
    assert moved[1] - before[1] == pytest.approx(20 * hand.scale, abs=3 * hand.near)  # y points up
    assert page.run("document.documentElement.scrollWidth <= innerWidth")
    assert page.errors == []


def test_the_view_in_three_dimensions_turns_by_finger(page: Any) -> None:
    page.click("#relief-on")
    page.wait("Number(document.querySelector('#relief canvas')?.dataset.frames) > 0")
    page.run("document.querySelector('#relief').scrollIntoView({block: 'center'})")
    angles = "document.querySelector('#relief canvas').dataset.angles"
    before = [float(v) for v in page.run(angles).split()]
    x, y = page.middle("#relief canvas")
    touch(page, line((x, y), (x + 50, y + 15)))
    page.wait(f"{angles} !== {' '.join(f'{v:.3f}' for v in before)!r}")
    after = [float(v) for v in page.run(angles).split()]
    assert after[0] > before[0]
    assert after[1] > before[1]


def test_two_fingers_zoom_about_their_middle_and_one_pans(page: Any) -> None:
    """The last here: after two fingers Chromium sends no touch when touch is switched on again."""
    page.run("document.querySelector('#map').scrollIntoView({block: 'center'})")
    seen: Callable[[], Any] = lambda: page.run("window.seen")  # noqa: E731
    page.run(
        "document.getElementById('map').addEventListener('projected', (e) => { window.seen = e.detail; })"
    )
    x, y = page.middle("#map canvas")
    touch(page, line((x, y), (x + 6, y)))
    first = seen()
    touch(page, line((x - 30, y + 40), (x - 60, y + 40)), line((x + 30, y + 40), (x + 60, y + 40)))
    zoomed = seen()
    # the first of eight moves only says where the fingers are
    assert first["scale"] / zoomed["scale"] == pytest.approx(2.0, rel=0.15, abs=0.0)
    held = (first["centre"][1] - zoomed["centre"][1]) / 40
    assert held == pytest.approx(first["scale"] - zoomed["scale"], rel=0.05, abs=0.0)
    assert zoomed["centre"][0] == pytest.approx(first["centre"][0], abs=3 * first["scale"])
    touch(page, line((x, y), (x + 40, y + 10)))
    panned = seen()
    assert panned["scale"] == zoomed["scale"]
    assert zoomed["centre"][0] - panned["centre"][0] == pytest.approx(
        40 * zoomed["scale"], rel=0.02, abs=0.0
    )
    assert panned["centre"][1] - zoomed["centre"][1] == pytest.approx(
        10 * zoomed["scale"], rel=0.02, abs=0.0
    )
