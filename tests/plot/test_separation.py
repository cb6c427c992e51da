"""Figures of separations: what is drawn is what was separated, in the units of the labels."""

import numpy as np
import pytest

from metrosep.core.errors import DataError
from metrosep.plot.summary import parts_plot, reversal_quartet
from metrosep.separation.circles.roundness_reversal import donaldson, face_reversal
from metrosep.separation.lines.reversals import straightedge_reversal

N = 72
ANGLE = 2 * np.pi * np.arange(N) / N
BALL, SPINDLE = 50e-9 * np.cos(3 * ANGLE), 20e-9 * np.sin(2 * ANGLE)


def lines(axes):
    return [line for line in axes.get_lines() if len(line.get_xdata()) == N]


def test_quartet_shows_readings_and_parts():
    readings = np.stack([BALL + SPINDLE, BALL - SPINDLE])
    result = donaldson(*readings, u_reading=2e-9)

    figure = reversal_quartet(result, readings)
    m1, m2, ball, spindle = figure.axes

    np.testing.assert_allclose(lines(m1)[0].get_ydata(), readings[0] * 1e9, atol=1e-9)
    np.testing.assert_allclose(lines(m2)[0].get_ydata(), readings[1] * 1e9, atol=1e-9)
    np.testing.assert_allclose(lines(ball)[0].get_ydata(), BALL * 1e9, atol=1e-9)
    np.testing.assert_allclose(lines(spindle)[0].get_ydata(), SPINDLE * 1e9, atol=1e-9)
    np.testing.assert_allclose(lines(ball)[0].get_xdata(), np.degrees(ANGLE), atol=1e-9)
    assert m1.get_ylabel() == "reading / nm"
    assert ball.get_ylabel() == "deviation / nm"
    assert spindle.get_xlabel() == "angle / °"
    band = ball.collections[0].get_paths()[0].vertices
    assert band[:, 1].max() == pytest.approx(50 + 2 * result.u["artefact"][0] * 1e9, abs=1e-6)


def test_parts_of_different_units_have_their_own_labels():
    tilt = 1e-6 * np.sin(2 * ANGLE)
    result = face_reversal(BALL + 0.02 * tilt, BALL - 0.02 * tilt, 0.0 * BALL, 0.02)

    panels = parts_plot(result).axes

    labels = {a.get_title(loc="left").split(" (")[0]: a.get_ylabel() for a in panels}
    assert labels["artefact"] == "deviation / nm"
    assert labels["tilt"] == "angle / nrad"
    assert "u not known" in panels[0].get_title(loc="left")


def test_positions_are_in_mm():
    x = np.linspace(0.0, 0.3, N)
    figure = parts_plot(straightedge_reversal(BALL, BALL, x=x))

    assert figure.axes[-1].get_xlabel() == "position / mm"
    np.testing.assert_allclose(lines(figure.axes[0])[0].get_xdata(), x * 1e3, atol=1e-9)


def test_wrong_readings_and_axes_are_refused():
    from matplotlib.figure import Figure

    result = donaldson(BALL, BALL)
    with pytest.raises(DataError, match="got"):
        reversal_quartet(result, BALL)
    with pytest.raises(DataError, match="leave out ax"):
        parts_plot(result, Figure().add_subplot())
