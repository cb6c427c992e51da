"""The depth of a groove on a profile by hand: bars on the plot, each drag one edit of the recipe."""

import tomllib

import numpy as np
import pytest

pytestmark = pytest.mark.browser
UM = 1e-6
DEPTH = 0.734
FULL = "document.querySelector('#status-full.done') !== null"


def grooved(path):
    """A groove of 0.734 um over 1.15 to 1.25 mm of 3 mm, on a face that rises; nothing at the middle."""
    x = np.arange(0.0, 3.0005, 0.001)
    z = 0.05 * x - np.where(np.abs(x - 1.2) < 0.05, DEPTH, 0.0)
    path.write_text(
        "x_mm,z_um\n" + "".join(f"{a:.4f},{b:.6f}\n" for a, b in zip(x, z, strict=True))
    )
    return path


def recipe(page):
    page.click("#recipe")
    text = page.run("document.querySelector('dialog pre').textContent")
    page.run("document.querySelector('dialog').close()")
    return {key: value for key, value in tomllib.loads(text).items() if key != "view"}


def place(page, name):
    """Middle of a handle on the profile, in px of the window."""
    return page.run(
        f"""(() => {{ const box = document.querySelector('#profile [aria-label="{name} of the groove"]').getBoundingClientRect();
        return [box.left + box.width / 2, box.top + box.height / 2]; }})()"""
    )


def px_of(page, x):
    """Where a place on the profile is, in px of the window: 0 to 3 mm fill the plot."""
    return page.run(
        f"(() => {{ const box = document.querySelector('#profile .u-over').getBoundingClientRect(); return box.left + box.width * {x} / 3; }})()"
    )


def drag(page, name, to):
    x, y = place(page, name)
    page.drag((x, y), (px_of(page, to) - x, 0.0))
    page.run("new Promise((done) => setTimeout(done, 500))")
    page.wait(FULL)


def test_a_groove_is_measured_by_dragging_its_bars(opened, tmp_path):
    page = opened(grooved(tmp_path / "groove.csv"))
    before = recipe(page)
    page.run(
        """(() => { const all = document.querySelector('#add-step'); all.value = 'step_height';
        all.dispatchEvent(new Event('change')); })()"""
    )
    page.run("new Promise((done) => setTimeout(done, 500))")
    page.wait(FULL)
    step = recipe(page)["step"][-1]
    assert step == {"op": "step_height", "width": "500 um", "middle": "1.5 mm"}
    assert page.text("#alerts") == ""
    assert page.run("document.querySelectorAll('#steps .failed').length") == 0
    drag(page, "Middle", 1.2)
    drag(page, "Left edge", 1.15)
    drag(page, "Right edge", 1.25)
    step = recipe(page)["step"][-1]
    assert float(step["middle"].split()[0]) == pytest.approx(1.2, abs=0.005)
    assert float(step["width"].split()[0]) == pytest.approx(0.1, abs=0.01)
    assert "734" in page.text("#metrics")
    for _ in range(4):
        page.click("#undo")
        page.run("new Promise((done) => setTimeout(done, 300))")
    assert recipe(page) == before
    assert page.run(
        "document.querySelector('#profile [aria-label=\"Middle of the groove\"]').hidden"
    )
    assert page.errors == []
