"""Curves over a whole turn stand about a circle, too: at their angle, outwards where they are positive, gaps open."""

import numpy as np
import pytest

from metrosep.plot.charts import draw_chart
from metrosep.plot.summary import parts_plot
from metrosep.recipe.describe.charts import curve, curve_chart, panel
from metrosep.separation import donaldson

N = 180
ANGLE = 2 * np.pi * np.arange(N) / N
STEP = 2 * np.pi / N
BUMP = np.radians(120.0)
ROUNDED = 1e-5
"""Relative: charts are kept with six digits."""


def bump(size):
    """Return a rise at 120 degrees, of nothing else."""
    return size * np.exp(-0.5 * ((ANGLE - BUMP) / 0.1) ** 2)


def traced(axes):
    """Return angle and radius of the line that is drawn about the circle."""
    line = max(axes.lines, key=lambda one: len(one.get_xdata()))
    x, y = (np.asarray(v, dtype=float) for v in line.get_data())
    return np.mod(np.arctan2(y, x), 2 * np.pi), np.hypot(x, y)


def test_the_parts_of_a_reversal_stand_about_a_circle():
    ball, spindle = bump(30e-9), 20e-9 * np.cos(2 * ANGLE)
    found = donaldson(ball + spindle, ball - spindle)
    figure = parts_plot(found)

    assert len(figure.axes) == 2 * len(found.parts)
    beside = {
        a.get_title(loc="left").split(" ")[0]: b
        for a, b in zip(figure.axes[:2], figure.axes[2:], strict=True)
    }
    angle, radius = traced(beside["artefact"])
    assert angle[np.nanargmax(radius)] == pytest.approx(BUMP, abs=STEP)
    assert np.nanmax(radius) - np.nanmin(radius) == pytest.approx(
        np.ptp(found.artefact) * 1e9, abs=ROUNDED * 30
    )
    assert len(beside["artefact"].patches) > 2  # its two circles, dashed


def chart(angle, z, **turned):
    line = curve("", angle, z)
    return curve_chart("Trace", ("angle", "rad"), [panel("ring", "m", [line])]) | turned


def test_a_stored_chart_of_a_turn_does_the_same_and_leaves_a_gap_open():
    z = bump(2e-6)
    away = np.degrees(ANGLE)
    keep = (away < 200) | (away > 260)
    figure = draw_chart(chart(ANGLE[keep], z[keep], closed=True, each=True))

    straight, about = figure.axes
    angle, radius = traced(about)
    assert angle[np.nanargmax(radius)] == pytest.approx(BUMP, abs=STEP)
    assert np.nanmax(radius) - np.nanmin(radius) == pytest.approx(2.0, abs=2 * ROUNDED)  # um
    assert np.isnan(radius).sum() == 1  # no line across the gap
    assert straight.get_xlabel() == "angle / °"


def test_what_is_no_whole_turn_has_no_circle():
    assert len(draw_chart(chart(ANGLE[:90], bump(1e-6)[:90])).axes) == 1
