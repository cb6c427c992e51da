"""Figures of servo and stage: drawn data in their units, bands, labels."""

from __future__ import annotations

import numpy as np
import pytest

from metrosep.core.errors import TooFewSamplesError
from metrosep.core.profile import Profile
from metrosep.core.recording import Recording
from metrosep.plot.servo_chart import (
    before_after_chart,
    calibration_chart,
    follow_up_chart,
    static_error_chart,
    straightness_chart,
)
from metrosep.process.dual_servo import before_after
from metrosep.process.flexure import flexure_calibration
from metrosep.process.follow_ups import follow_up
from metrosep.process.static_errors import compare_static
from metrosep.process.straightness_runs import run_polynomial

RNG = np.random.default_rng(0)


def follow():
    t = np.arange(4000) / 1000.0
    z = 50e-9 * (np.sin(2 * np.pi * 2.1 * t) + 0.3 * np.sin(2 * np.pi * 5.3 * t))
    w1, w2 = 2 * np.pi * 2.1, 2 * np.pi * 5.3
    a = -50e-9 * (w1**2 * np.sin(w1 * t) + 0.3 * w2**2 * np.sin(w2 * t))
    actual = z - 7.5e-4 * a + 0.3e-9 * RNG.standard_normal(t.size)
    return follow_up(Recording(t, {"command": z, "actual": actual}))


def calibration():
    v = np.concatenate([np.linspace(0, 10, 21), np.linspace(10, 0, 21)])
    way = np.where(np.arange(42) < 21, -1, 1)
    d = 1.66e-6 * v + 0.4e-6 * way * v * (10 - v) / 25
    return flexure_calibration(Recording(np.arange(42), {"voltage": v, "displacement": d}))


def slide_runs():
    x = np.linspace(0, 40e-3, 401)
    y = 0.3389e-6 + 0.48246e-3 * x - 6.05e-3 * x**2
    return [
        Profile(x, y + 60e-9 * RNG.standard_normal(401) + 200e-9 * RNG.standard_normal())
        for _ in range(4)
    ]


def pair():
    x = np.arange(8000) * 0.5e-6
    wave = 75e-9 * np.sin(2 * np.pi * x / 20e-6)
    return before_after(
        Profile(x, wave + 0.6e-6 * (2 * x / x[-1] - 1) ** 2),
        Profile(x, 0.1 * wave),
        lambda_c=0.25e-3,
    )


def test_follow_up():
    r = follow()
    top, bottom = follow_up_chart(r).axes
    assert top.lines[0].get_ydata()[100] == pytest.approx(r.error[100] * 1e9, abs=1e-9)
    fitted = top.lines[1].get_ydata()
    assert fitted[100] == pytest.approx((r.error - r.residual)[100] * 1e9, abs=1e-9)
    assert bottom.lines[0].get_ydata()[100] == pytest.approx(r.acceleration[100] * 1e6, abs=1e-9)
    assert r.r2 > 0.99
    assert (top.get_ylabel(), bottom.get_xlabel()) == ("error (nm)", "time (s)")
    assert "µm/s²" in bottom.get_ylabel()


def test_calibration():
    c = calibration()
    axes = calibration_chart(c)
    up, down = axes.lines[1], axes.lines[2]
    assert (up.get_label(), down.get_label()) == ("up", "down")
    assert down.get_ydata()[10] - up.get_ydata()[10] == pytest.approx(0.8, abs=1e-9)
    assert "1.66 µm/V" in axes.lines[0].get_label()
    assert "hysteresis 4.8 % FS" in axes.get_title(loc="left")


def test_calibration_of_one_direction_draws_no_other():
    v = np.linspace(0, 10, 21)
    c = flexure_calibration(Recording(np.arange(21), {"voltage": v, "displacement": 1e-6 * v}))
    assert [line.get_label() for line in calibration_chart(c).lines][1:] == ["up"]


def test_static():
    c = compare_static(
        50e-9 * RNG.standard_normal(4000) + 1e-6, 5e-9 * RNG.standard_normal(4000), step=1e-3
    )
    top, below = static_error_chart(c).axes
    assert abs(np.median(top.lines[0].get_ydata())) < 1e-6
    assert np.std(top.lines[0].get_ydata()) == pytest.approx(50.0, abs=2.0)
    assert below.lines[0].get_ydata()[5] == pytest.approx(
        np.sqrt(c.density_before[5]) * 1e9, abs=1e-9
    )
    assert "dB" in top.get_title(loc="left")


def test_straightness():
    runs = slide_runs()
    p = run_polynomial(runs, quantity="compensation", degree=2)
    axes = straightness_chart(runs, p)
    assert len(axes.lines) == 5
    curve = axes.lines[-1]
    assert curve.get_xdata()[-1] == pytest.approx(40.0, abs=1e-9)
    assert curve.get_ydata()[200] == pytest.approx(p.evaluate(20e-3)[0] * 1e6, abs=1e-9)
    band = axes.collections[0].get_paths()[0].vertices
    assert band[:, 1].max() > curve.get_ydata().max()
    assert axes.get_ylabel() == "compensation (µm)"
    with pytest.raises(TooFewSamplesError):
        straightness_chart([], p)


def test_before_after():
    r = pair()
    axes = before_after_chart(r)
    assert axes.lines[0].get_ydata()[7] == pytest.approx(r.profiles[0].z[7] * 1e6, abs=1e-12)
    assert "Ra 47" in axes.lines[0].get_label()
    assert axes.get_xlabel() == "position x (mm)"
