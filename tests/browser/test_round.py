"""Roundness traces in the page: the question, the numbers, the picture about a circle."""

import numpy as np
import pytest

pytestmark = pytest.mark.browser
FULL = "document.querySelector('#status-full.done') !== null"
ROUND = "document.querySelector('.machine-round') !== null"
ASKED = "document.querySelector('dialog[open] [name=angle]') !== null"


def trace(path):
    """Two lobes of +-1.5 um about a centre 4 um off towards +y; RONt is 3 um."""
    a = np.arange(0.0, 360.0, 2.0)
    r = 4.0 * np.sin(np.radians(a)) + 1.5 * np.cos(2.0 * np.radians(a))
    path.write_text(
        "angle_deg,r_um\n" + "".join(f"{p},{v:.9f}\n" for p, v in zip(a, r, strict=True))
    )
    return path


def painted(page, angle):
    """Return how far from the middle the curve is at an angle, in parts of the middle circle."""
    return page.run(
        f"""(() => {{
          const canvas = document.querySelector('.machine-round');
          const n = canvas.width, ratio = n / 380;
          const data = canvas.getContext('2d').getImageData(0, 0, n, n).data;
          const [cx, cy, r] = [184 * ratio, 196 * ratio, 0.29 * 380 * ratio];
          const [u, v] = [Math.cos({angle}), -Math.sin({angle})];
          let best = 0, at = 0;
          for (let d = 0.3 * r; d < 1.7 * r; d += 0.25) {{
            const k = 4 * (Math.round(cy + d * v) * n + Math.round(cx + d * u));
            const blue = data[k + 3] * (data[k + 2] - data[k]);
            if (blue > best) [best, at] = [blue, d];
          }}
          return at / r;
        }})()"""
    )


def test_a_trace_is_asked_for_and_lies_about_its_circle(opened, tmp_path):
    page = opened(trace(tmp_path / "t.csv"), ready=ASKED)
    assert page.run("document.querySelector('dialog [name=angle]').value") == "angle_deg"
    assert page.run("document.querySelector('dialog [name=radius]').value") == "r_um"
    page.click("dialog button[value=yes]")
    page.wait(ROUND)
    page.wait(FULL)
    assert "RONt" in page.text("#metrics")
    assert "3.000" in page.text("#metrics")
    assert "centre 4 um off at 90 deg" in page.text("#panel-machine")
    # the outer circle, 1.5 times the middle one, is +1.5 um: the lobes are at 0 and 180 deg
    assert painted(page, 0.0) == pytest.approx(1.5, abs=0.03)
    assert painted(page, np.pi / 2.0) == pytest.approx(0.5, abs=0.03)
    assert page.errors == []


def test_a_wrong_column_brings_the_question_back_with_the_reason(opened, tmp_path):
    page = opened(trace(tmp_path / "t.csv"), ready=ASKED)
    page.run("document.querySelector('dialog [name=angle]').value = 'r_um'")
    page.click("dialog button[value=yes]")
    page.wait("document.querySelector('dialog p.ask')?.textContent.includes('an angle is needed')")
    assert page.run("document.querySelector('dialog [name=angle]').value") == "r_um"
