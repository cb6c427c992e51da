"""What the figures of multi-probe separations draw: numbers, hatches, units."""

import math

import numpy as np
import pytest

from metrosep.core.errors import DataError
from metrosep.plot.multipoint import probe_gain_chart, probe_layout, probe_residuals
from metrosep.separation.circles.probe_angles import ProbeAngles, probe_gain
from metrosep.separation.circles.probe_check import check_probes
from metrosep.separation.circles.probes import multiprobe
from metrosep.separation.circles.steps import multistep
from metrosep.separation.contract import Separation

THETA = 2 * math.pi * np.arange(128) / 128


def wave(angle):
    return 5e-8 * np.cos(3 * angle + 0.3) + 2e-8 * np.cos(5 * angle)


def separated(degrees, kmax=20):
    phi = np.deg2rad(degrees)
    m = [wave(THETA + p) + 1e-8 * np.sin(2 * THETA) * np.sin(p) for p in phi]
    return multiprobe(m, phi, kmax, u_reading=2e-9)


def chosen(degrees, kmax):
    gain = probe_gain(np.deg2rad(degrees), kmax)
    return ProbeAngles(np.deg2rad(degrees), 1.0, gain, 2, 1.0)


def test_gain_bars_are_the_gain_and_suppressed_ones_are_hatched():
    axes = probe_gain_chart(separated([0, 45, 135]))

    bars = {round(b.get_x() + b.get_width() / 2): b for b in axes.patches}
    assert sorted(bars) == list(range(2, 21))
    gain = probe_gain(np.deg2rad([0, 45, 135]), 20)
    for k, bar in bars.items():
        if k in (7, 9, 15, 17):
            assert bar.get_hatch()
        else:
            assert not bar.get_hatch()
            assert bar.get_height() == pytest.approx(min(gain[k], 10.0), rel=1e-9, abs=0)
    assert "k" in axes.get_xlabel()
    assert [t.get_text() for t in axes.get_legend().get_texts()] == [
        "0° / 45° / 135°",
        "suppressed",
    ]


def test_a_second_arrangement_is_a_line():
    axes = probe_gain_chart(chosen([0, 27, 60], 30), compare=chosen([0, 99.84, 202.5], 30))

    line = next(x for x in axes.lines if len(x.get_xdata()) > 2)
    np.testing.assert_allclose(
        line.get_ydata(), probe_gain(np.deg2rad([0, 99.84, 202.5]), 30)[2:], rtol=1e-9, atol=0
    )


def test_layout_says_where_each_probe_stands():
    axes = probe_layout(chosen([0, 90, 210], 10))

    labels = [t for t in axes.texts if t.get_gid() == "probe"]
    assert [t.get_text() for t in labels] == ["0\n0°", "1\n90°", "2\n210°"]
    assert labels[1].get_position()[1] > 1.0 > abs(labels[1].get_position()[0])
    assert labels[2].get_position()[0] < 0 > labels[2].get_position()[1]


def test_steps_are_drawn_too():
    result = multistep([wave(THETA + p * math.pi / 3) for p in range(6)], steps=6, kmax=20)

    axes = probe_gain_chart(result)

    hatched = [round(b.get_x() + b.get_width() / 2) for b in axes.patches if b.get_hatch()]
    assert hatched == [6, 12, 18]


def test_residuals_carry_the_finding():
    rng = np.random.default_rng(0)
    phi = np.deg2rad([0, 20.5, 270.5, 297])
    m = np.array([wave(THETA + p) for p in phi]) + 1e-10 * rng.standard_normal((4, 128))
    check = check_probes(m, phi + np.deg2rad([0, 0, 1.0, 0]), 8, u_reading=1e-10)

    axes = probe_residuals(check)

    heights = {round(b.get_x() + b.get_width() / 2): b.get_height() for b in axes.patches}
    assert sorted(heights) == list(range(2, 9))
    assert heights[3] == pytest.approx(check.chi2_per_k[3], rel=1e-12, abs=0)
    assert "probe 2" in axes.get_title(loc="left")


def test_what_has_no_gain_is_refused():
    line = Separation("other", {"a": [0.0]}, {"a": [0.0]}, {"a": "m"}, {"x": [0.0]}, ())
    with pytest.raises(DataError, match="no noise gain"):
        probe_gain_chart(line)
