"""Spindle figures show the numbers of the result, in the unit that they name."""

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from matplotlib.patches import Circle

from metrosep.core.errors import DataError
from metrosep.plot.multipoint import speed_plot
from metrosep.plot.polar import harmonic_bars, polar_plot, readable_unit
from metrosep.separation.circles.speed_sweep import fit_speed_sweep
from metrosep.separation.circles.spindle import iso230_7

NM = 1e-9
EXACT = 1e-9  # in the unit of the axis


@pytest.fixture(scope="module")
def result():
    t = np.arange(120) * 2 * np.pi / 120
    s = 30 * NM * np.cos(2 * t + 0.4) + 12 * NM * np.sin(5 * t)
    rng = np.random.default_rng(0)
    return iso230_7(s + 2e-6 * np.cos(t) + rng.normal(0, 2 * NM, (25, 120)))


def line(axes, start):
    (found,) = [x for x in axes.lines if str(x.get_label()).startswith(start)]
    return np.array(found.get_xdata()), np.array(found.get_ydata())


def dashed_circles(axes):
    return sorted(
        p.radius
        for p in axes.patches
        if isinstance(p, Circle) and p.get_linestyle() not in ("-", "solid", ":")
    )


def test_polar_synchronous_curve_and_its_circles(result):
    axes = polar_plot(result)

    x, y = line(axes, "synchronous")
    radius = np.hypot(x, y)
    base = radius[0] - 1e9 * result.synchronous_motion[0]
    np.testing.assert_allclose(
        radius[:-1] - base, 1e9 * result.synchronous_motion, rtol=0, atol=EXACT
    )
    np.testing.assert_allclose(np.unwrap(np.arctan2(y, x))[:-1], result.angle, rtol=0, atol=EXACT)
    circles = [r for r in dashed_circles(axes) if abs(r - base) > EXACT]
    assert abs(circles[-1] - circles[0] - 1e9 * result.synchronous.value) < EXACT
    assert "nm" in line_label(axes, "synchronous")
    assert axes.get_aspect() == 1.0


def line_label(axes, start):
    (found,) = [t for t in axes.get_legend().get_texts() if t.get_text().startswith(start)]
    return found.get_text()


def test_polar_revolutions_band_and_range(result):
    axes = polar_plot(result)

    (lines,) = [c for c in axes.collections if isinstance(c, LineCollection)]
    assert len(lines.get_segments()) == 25
    x, y = line(axes, "asynchronous")
    length = np.hypot(np.diff(x), np.diff(y))[0]
    assert abs(length - 1e9 * result.asynchronous.value) < EXACT
    (band,) = [p for p in axes.patches if str(p.get_label()).startswith("total")]
    radius = np.hypot(*band.get_xy().T)
    assert abs(np.ptp(radius) - 1e9 * result.total.value) < EXACT


def test_polar_division_and_text(result):
    axes = polar_plot(result, division=25e-9)

    said = " ".join(t.get_text() for t in axes.texts)
    assert "division 25 nm" in said
    assert "25 revolutions" in said
    assert "LSC" in said
    grid = sorted(
        p.radius
        for p in axes.patches
        if isinstance(p, Circle) and p.get_linestyle() in ("-", "solid")
    )
    assert min(np.diff(grid)) == pytest.approx(25.0, abs=EXACT)


def test_polar_of_tilt_and_of_nothing():
    t = np.arange(120) * 2 * np.pi / 120
    upper = np.tile(50 * NM * np.cos(2 * t), (20, 1))
    tilt = iso230_7(np.stack([upper, 0 * upper]), direction="tilt", distance=0.01)

    assert "µrad" in line_label(polar_plot(tilt), "synchronous")
    assert polar_plot(iso230_7(np.zeros((20, 60)))).get_figure() is not None


def test_bars_have_the_height_of_the_amplitudes():
    axes = harmonic_bars(
        [1, 2, 3, 4], [9e-6, 20 * NM, np.nan, 5 * NM], [1e-9] * 4, suppressed=(1,)
    )

    hatched = [p for p in axes.patches if p.get_hatch()]
    plain = [p for p in axes.patches if not p.get_hatch()]
    assert [round(p.get_x() + p.get_width() / 2) for p in hatched] == [1]
    assert [round(p.get_x() + p.get_width() / 2) for p in plain] == [2, 4]
    np.testing.assert_allclose([p.get_height() for p in plain], [20, 5], rtol=0, atol=EXACT)
    assert axes.get_ylabel() == "amplitude in nm"
    (whiskers,) = [c for c in axes.collections if isinstance(c, LineCollection)]
    np.testing.assert_allclose(
        [np.ptp(s[:, 1]) for s in whiskers.get_segments()], [4.0, 4.0], rtol=0, atol=EXACT
    )


def test_bars_end_at_the_limit():
    axes = harmonic_bars(np.arange(1, 101), np.full(100, 1e-6), limit=10)
    assert len(axes.patches) == 10
    assert len(harmonic_bars([], [], unit="rad").patches) == 0
    with pytest.raises(DataError, match="equally long"):
        harmonic_bars([1, 2], [1.0])


@pytest.mark.parametrize(
    ("largest", "unit", "name"),
    [
        (3e-6, "m", "µm"),
        (1e-6, "m", "nm"),
        (1e-9, "m", "pm"),
        (1e-8, "rad", "nrad"),
        (5.0, "V", "V"),
    ],
)
def test_units_read_well(largest, unit, name):
    assert readable_unit(largest, unit)[1] == name


def test_speed_chart_shows_values_fit_and_critical_speeds():
    speed = np.arange(10.0, 101.0, 10.0)
    y = 20 * NM + 3e-12 * speed**2
    y[5] += NM
    sweep = fit_speed_sweep(speed, {"synchronous": y}, natural_frequency=180.0)

    axes = speed_plot(sweep)

    points = axes.lines[0]
    np.testing.assert_allclose(points.get_xdata(), 60 * speed, rtol=0, atol=EXACT)
    np.testing.assert_allclose(points.get_ydata(), 1e9 * y, rtol=0, atol=EXACT)
    (fit,) = [x for x in axes.lines if len(x.get_xdata()) == 300]
    np.testing.assert_allclose(
        fit.get_ydata(),
        1e9 * sweep["synchronous"].evaluate(np.array(fit.get_xdata()) / 60),
        rtol=0,
        atol=1e-6,
    )
    said = [t.get_text() for t in axes.texts]
    assert said == ["k=2", "k=3", "k=4", "k=5", "k=6"]
    assert axes.get_xlabel() == "speed in rev/min"
    assert axes.get_ylabel() == "error motion in nm"


def test_given_axes_are_used(result):
    axes = polar_plot(result)
    figure = axes.get_figure()
    other = figure.add_subplot(2, 1, 2)
    assert harmonic_bars([1], [1e-9], ax=other) is other
