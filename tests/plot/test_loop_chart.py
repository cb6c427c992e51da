"""Charts of the closed loop: what is drawn is what the result says."""

import numpy as np
import pytest

from metrosep.compensation.closed_loop import iterate_loop, run_closed_loop
from metrosep.compensation.knots import choose_knots
from metrosep.compensation.loop_machines import AxisMachine, FaceMachine
from metrosep.core.errors import DataError
from metrosep.plot.servo_chart import (
    closed_loop_maps,
    closed_loop_plot,
    knots_plot,
    loop_history_plot,
)


def bump(x, direction=1):
    return 3e-6 * np.exp(-(((x - 30e-3) / 9e-3) ** 2))


def face_error(x, y):
    return 1.5e-6 * np.exp(-(((x - 8e-3) ** 2 + y**2) / 36e-6))


@pytest.fixture(scope="module")
def axis():
    return AxisMachine(bump, (0.0, 0.1), on_axis=False, n_points=201)


def test_three_states_over_position(axis):
    result = run_closed_loop(axis, lambda x, d: -0.9 * bump(x))
    axes = closed_loop_plot(result)
    lines = {line.get_label().split(":")[0]: line for line in axes.get_lines()}
    assert set(lines) == {"without", "with table", "sign reversed"}
    assert lines["without"].get_xdata() == pytest.approx(result.places * 1e3, abs=1e-12)
    # drawn in um: the reversed sign leaves 1.9 times 3 um
    assert np.ptp(lines["sign reversed"].get_ydata()) == pytest.approx(5.7, abs=1e-3)
    assert "P-V 300 nm" in lines["with table"].get_label()
    assert "µm" in axes.get_ylabel()
    assert closed_loop_plot(result, axes, direction=-1) is axes


def test_maps_share_one_scale():
    face = FaceMachine(face_error, 20e-3, revolutions=8, points_per_turn=48)
    result = run_closed_loop(face, lambda x, y: -0.8 * face_error(x, y))
    figure = closed_loop_maps(result)
    panels = [a for a in figure.axes if a.get_xlabel() == "x in mm"]
    assert len(panels) == 3
    assert len({a.collections[0].get_clim() for a in panels}) == 1
    assert panels[0].get_title().startswith("without")
    drawn = panels[1].collections[0].get_array()
    assert np.ptp(drawn) == pytest.approx(result.passes[0].after.pv.value * 1e6, abs=1e-9)


def test_history_is_logarithmic(axis):
    history = iterate_loop(axis, 3, gain=0.5)
    axes = loop_history_plot(history)
    assert axes.get_yscale() == "log"
    first = axes.get_lines()[0].get_ydata()
    assert first[:-1] / first[1:] == pytest.approx([2.0] * 3, abs=1e-6)
    assert len(axes.get_lines()) == 4


def test_zeros_are_gaps_in_the_history(axis):
    history = iterate_loop(axis, 1)
    ydata = loop_history_plot(history).get_lines()[0].get_ydata()
    assert ydata[0] > 0
    assert not np.any(ydata == 0.0)


def test_knots_and_their_tunnel():
    x = np.linspace(0, 0.1, 201)
    knots = choose_knots(x, bump(x), 5)
    axes = knots_plot(x, bump(x), knots)
    line = axes.get_lines()[1]
    assert line.get_xdata() == pytest.approx(knots.positions * 1e3, abs=1e-12)
    assert "5 knots" in line.get_label()


def test_wrong_chart_is_refused(axis):
    result = run_closed_loop(axis, lambda x, d: -bump(x))
    with pytest.raises(DataError, match="closed_loop_plot"):
        closed_loop_maps(result)
    with pytest.raises(DataError, match="direction 0"):
        closed_loop_plot(result, direction=0)
    face = run_closed_loop(FaceMachine(face_error, 1e-2), lambda x, y: -face_error(x, y))
    with pytest.raises(DataError, match="closed_loop_maps"):
        closed_loop_plot(face)


def drawn_triangles(figure):
    """Corners of what is painted in the first map, mm, shape (n, 3, 2)."""
    panel = next(a for a in figure.axes if a.get_xlabel() == "x in mm")
    mesh = panel.collections[0]
    triangles = mesh._triangulation
    corners = np.stack([triangles.x, triangles.y], axis=-1)
    return corners[triangles.get_masked_triangles()]


def covered(triangles):
    """Their area, mm^2."""
    (ax, ay), (bx, by), (cx, cy) = (triangles[:, i].T for i in range(3))
    return 0.5 * np.abs((bx - ax) * (cy - ay) - (cx - ax) * (by - ay)).sum()


@pytest.mark.parametrize("inner_mm", [0.0, 0.4, 8.0])
def test_what_was_not_cut_is_not_painted(inner_mm):
    face = FaceMachine(
        face_error, 20e-3, inner_radius=inner_mm * 1e-3, revolutions=12, points_per_turn=72
    )
    result = run_closed_loop(face, lambda x, y: -0.8 * face_error(x, y))
    figure = closed_loop_maps(result)

    triangles = drawn_triangles(figure)
    radii = np.hypot(*triangles.mean(axis=1).T)
    pitch = (20.0 - inner_mm) / 12
    assert radii.min() >= inner_mm
    # between the first and the last turn of the spiral, each half a pitch from its circle
    outer, inner = 20.0 - pitch / 2, inner_mm + pitch / 2 if inner_mm > pitch else 0.0
    assert covered(triangles) == pytest.approx(np.pi * (outer**2 - inner**2), rel=0, abs=9.0)
