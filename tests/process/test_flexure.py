"""Flexure calibration: the paper's arithmetic, planted hysteresis, inverse, bad sweeps."""

from __future__ import annotations

import itertools
import json

import numpy as np
import pytest

from metrosep.core.errors import (
    DataError,
    DegenerateFitError,
    InvalidSamplesError,
    LimitError,
    TooFewSamplesError,
    UnitError,
)
from metrosep.core.recording import Recording
from metrosep.process.flexure import flexure_calibration

UM, NM = 1e-6, 1e-9
UP = np.linspace(0.0, 10.0, 21)
FS = 16.6 * UM


def sweeps(n=1, *, bow=0.0, loop=0.0, noise=0.0, seed=0):
    """Up and down n times: line, bow of the mean curve, loop open by `loop` in the middle."""
    rng = np.random.default_rng(seed)
    v, d = [], []
    for _ in range(n):
        for sign, levels in ((-1, UP), (1, UP[::-1])):
            shape = 4 * levels * (10 - levels) / 100
            v.append(levels)
            d.append(
                1.66 * UM * levels
                + (bow + 0.5 * sign * loop) * shape
                + noise * rng.standard_normal(21)
            )
    v, d = np.concatenate(v), np.concatenate(d)
    return Recording(np.arange(v.size), {"voltage": v, "displacement": d}, units={"voltage": "V"})


def test_row_24():
    """papers.md section 5, row 24: 10 V, 16.6 um -> 1.66 um/V, nonlinearity 0."""
    c = flexure_calibration(sweeps())
    assert c.sensitivity == pytest.approx(1.66 * UM, abs=1e-9 * UM)
    assert c.full_scale == pytest.approx(FS, abs=1e-9 * UM)
    for share in (c.nonlinearity, c.hysteresis, c.intercept / UM):
        assert share == pytest.approx(0.0, abs=1e-9)
    assert np.isnan(c.repeatability)
    assert any("repeatability is not known" in m for m in c.messages)


def test_planted_bow_and_loop():
    """Bow 0.4 um: 2.41 % FS from the end-point line; loop 1 um: 6.02 % FS."""
    c = flexure_calibration(sweeps(bow=0.4 * UM, loop=1.0 * UM))
    assert c.nonlinearity == pytest.approx(0.4 / 16.6, abs=1e-12)
    assert c.hysteresis == pytest.approx(1.0 / 16.6, abs=1e-12)
    assert c.audit["hysteresis_percent_fs"] == pytest.approx(6.0241, abs=1e-4)
    assert (c.down - c.up)[10] == pytest.approx(1.0 * UM, abs=1e-12 * UM)  # down reads higher
    assert any("hysteresis" in m for m in c.messages)


def test_least_squares_line_of_a_bow():
    """A parabola 4 b u (1-u) lies 2b/3 above its chord: a line through the middle of it.

    On 21 equal steps sum(shape)/21 = (2/3)(1 - 1/(21^2))(...); taken from numpy's polyfit.
    """
    c = flexure_calibration(sweeps(bow=0.4 * UM), line="least-squares")
    shape = 0.4 * UM * 4 * UP * (10 - UP) / 100
    slope, height = np.polyfit(UP, 1.66 * UM * UP + shape, 1)
    assert c.sensitivity == pytest.approx(slope, abs=1e-12 * UM)
    assert c.intercept == pytest.approx(height, abs=1e-12 * UM)
    assert c.nonlinearity < 0.4 / 16.6


def test_repeatability_and_uncertainty():
    found, stated, slopes, u = [], [], [], []
    for seed in range(40):
        c = flexure_calibration(sweeps(5, noise=20 * NM, seed=seed))
        found.append(np.sqrt(np.mean(c.scatter**2)))
        slopes.append(c.sensitivity)
        u.append(c.quantities["sensitivity"].u)
        stated.append(c.repeatability * c.full_scale)
    assert np.mean(found) == pytest.approx(20 * NM, abs=0.6 * NM)
    assert np.mean(stated) > 20 * NM  # the largest of 21 voltages
    # sd of 40 values is known to 11 %
    assert np.sqrt(np.mean(np.square(u))) / np.std(slopes) == pytest.approx(1.0, abs=0.35)


def test_dwells_are_averaged():
    v = np.repeat(np.concatenate([UP, UP[-2::-1]]), 50)
    d = 1.66 * UM * v + 20 * NM * np.random.default_rng(0).standard_normal(v.size)
    c = flexure_calibration(Recording(np.arange(v.size), {"voltage": v, "displacement": d}))
    assert c.voltage.size == 21
    assert np.abs(c.mean - 1.66 * UM * c.voltage).max() < 20 * NM / np.sqrt(50) * 4


STEPS = np.concatenate([np.arange(11.0), np.arange(10.0)[::-1]])


class TestNoisyDwells:
    """The voltage is read back with noise: a dwell is still one voltage."""

    @pytest.mark.parametrize("readback", [1e-4, 1e-3, 5e-3, 20e-3])
    def test_curve(self, readback):
        """20 nm over 200 samples: 1.4 nm a level, 3 sweeps; readback adds 1.66 nm/mV/sqrt(200)."""
        rng = np.random.default_rng(1)
        v = np.repeat(np.tile(STEPS, 2), 200)
        d = 1.66 * UM * v + 20 * NM * rng.standard_normal(v.size)
        v = v + readback * rng.standard_normal(v.size)
        c = flexure_calibration(Recording(np.arange(v.size), {"voltage": v, "displacement": d}))
        assert c.voltage.size == 11
        sd = np.hypot(20 * NM, 1.66 * UM * readback) / np.sqrt(200)
        for curve in (c.up, c.down):
            assert np.abs(curve - 1.66 * UM * c.voltage).max() < 4 * sd
        assert c.hysteresis < 6 * sd / FS

    def test_small_stage_stays_monotone(self):
        """1.66 um at 10 V, 21 levels of 60 samples, 2 mV readback, 5 nm sensor."""
        rng = np.random.default_rng(2)
        level = np.repeat(np.concatenate([UP, UP[-2::-1]]), 60)
        v = level + 2e-3 * rng.standard_normal(level.size)
        d = 0.166 * UM * level + 5 * NM * rng.standard_normal(level.size)
        c = flexure_calibration(Recording(np.arange(v.size), {"voltage": v, "displacement": d}))
        assert np.abs(c.mean - 0.166 * UM * c.voltage).max() < 4 * 0.5 * NM

    def test_samples_on_the_way_are_counted(self):
        """Five samples of slewing between dwells of 50, where the stage has not followed yet."""
        rng = np.random.default_rng(3)
        v, d = [], []
        for a, b in itertools.pairwise(STEPS):
            way = a + (b - a) * np.arange(1, 6) / 6
            v += [np.full(50, a), way]
            d += [np.full(50, 1.66 * UM * a), 1.66 * UM * (way - 0.5 * (b - a))]
        v, d = np.concatenate([*v, np.full(50, STEPS[-1])]), np.concatenate([*d, np.zeros(50)])
        v = v + 1e-3 * rng.standard_normal(v.size)
        c = flexure_calibration(Recording(np.arange(v.size), {"voltage": v, "displacement": d}))
        assert c.audit["samples_between_levels"] == 100
        assert c.voltage.size == 11
        assert np.abs(c.mean - 1.66 * UM * c.voltage).max() < 1 * NM

    def test_slow_stairs_without_jumps(self):
        """Levels reached by smooth ways: no jump tells them apart, no slope is read in a dwell."""
        rng = np.random.default_rng(4)
        way = (1 - np.cos(np.pi * np.arange(400) / 400)) / 2
        level = np.concatenate(
            [
                np.concatenate([np.full(200, a), a + (b - a) * way])
                for a, b in itertools.pairwise(STEPS)
            ]
        )
        v = level + 1e-3 * rng.standard_normal(level.size)
        d = 1.66 * UM * level + 20 * NM * rng.standard_normal(level.size)
        c = flexure_calibration(Recording(np.arange(v.size), {"voltage": v, "displacement": d}))
        assert np.abs(c.mean - 1.66 * UM * c.voltage).max() < 20 * NM

    def test_a_ramp_with_lost_samples_is_no_stairs(self):
        rng = np.random.default_rng(5)
        v = np.concatenate([np.linspace(0, 10, 3000), np.linspace(10, 0, 3000)])
        keep = np.ones(v.size, bool)
        for a in (400, 900, 2000, 3500, 5000):
            keep[a : a + 60] = False
        v = v[keep]
        bow = 0.4 * UM * 4 * v * (10 - v) / 100
        d = 1.66 * UM * v + bow + 5 * NM * rng.standard_normal(v.size)
        c = flexure_calibration(Recording(np.arange(v.size), {"voltage": v, "displacement": d}))
        assert c.voltage.size == 101
        assert c.nonlinearity == pytest.approx(0.4 / 16.6, abs=1e-3)


def test_noisy_ramp_of_many_samples():
    """Voltage as measured: noisy, ten thousand values; the sweeps are still two."""
    rng = np.random.default_rng(1)
    v = np.concatenate([np.linspace(0, 10, 5000), np.linspace(10, 0, 5000)])
    v = v + 2e-3 * rng.standard_normal(v.size)
    d = 1.66 * UM * v + 5 * NM * rng.standard_normal(v.size)
    c = flexure_calibration(Recording(np.arange(v.size), {"voltage": v, "displacement": d}))
    assert (c.audit["sweeps_up"], c.audit["sweeps_down"]) == (1, 1)
    assert c.sensitivity == pytest.approx(1.66 * UM, abs=1e-3 * UM)
    assert c.nonlinearity < 1e-3


def path(*corners, step=0.1):
    """Voltages from corner to corner in equal steps, corners once."""
    v = [np.array([float(corners[0])])]
    for a, b in itertools.pairwise(corners):
        n = round(abs(b - a) / step)
        v.append(a + (b - a) * np.arange(1, n + 1) / n)
    return np.concatenate(v)


def stage_log(v, *, low=0.0, loop=0.8 * UM):
    """1.66 um/V; the rising branch lies loop/2 below, the falling as much above, in the middle."""
    rising = np.concatenate([[v[1] > v[0]], np.diff(v) > 0])
    share = (v - low) / 10.0
    d = 1.66 * UM * (v - low) + np.where(rising, -0.5, 0.5) * loop * 4 * share * (1 - share)
    return Recording(np.arange(v.size), {"voltage": v, "displacement": d})


class TestLogsThatStartInsideTheStroke:
    """A calibration is of the whole stroke, or says of which part."""

    @pytest.mark.parametrize("start", [2.0, 4.0, 4.9, 5.0, 7.0])
    def test_full_sweeps_count_and_parts_are_left_out(self, start):
        c = flexure_calibration(stage_log(path(start, 10, 0, 10, 0)))
        assert c.full_scale == pytest.approx(FS, abs=1e-9 * UM)
        assert c.hysteresis == pytest.approx(0.8 / 16.6, abs=1e-9)
        assert (c.audit["sweeps_up"], c.audit["sweeps_down"]) == (1, 2)
        (left,) = [m for m in c.messages if "omitted" in m]
        assert f"up {start:g} ... 10 V" in left

    @pytest.mark.parametrize("start", [2.0, 4.0, 5.0, 8.0])
    def test_a_closed_loop_from_within_is_joined(self, start):
        c = flexure_calibration(stage_log(path(start, 10, 0, start)))
        assert c.audit["range_V"] == (0.0, 10.0)
        assert c.full_scale == pytest.approx(FS, abs=1e-9 * UM)
        assert c.hysteresis == pytest.approx(0.8 / 16.6, abs=1e-9)
        assert (c.audit["sweeps_up"], c.audit["sweeps_down"]) == (1, 1)
        assert any(f"joined at {start:g} V" in m for m in c.messages)
        assert not any("one direction" in m for m in c.messages)

    def test_a_closed_loop_that_starts_downwards(self):
        c = flexure_calibration(stage_log(path(5, 0, 10, 5)))
        assert c.hysteresis == pytest.approx(0.8 / 16.6, abs=1e-9)
        assert (c.audit["sweeps_up"], c.audit["sweeps_down"]) == (1, 1)

    def test_bipolar(self):
        c = flexure_calibration(stage_log(path(0, 5, -5, 0), low=-5.0))
        assert c.audit["range_V"] == (-5.0, 5.0)
        assert c.full_scale == pytest.approx(FS, abs=1e-9 * UM)
        assert c.hysteresis == pytest.approx(0.8 / 16.6, abs=1e-9)

    def test_the_jump_of_a_join_is_told(self):
        """The stage crept by 50 nm between the first half sweep and the last."""
        log = stage_log(path(5, 10, 0, 5))
        d = log["displacement"].copy()
        d[:51] += 50 * NM
        c = flexure_calibration(Recording(log.t, {"voltage": log["voltage"], "displacement": d}))
        assert any("50 nm" in m for m in c.messages)
        assert c.audit["join_jump_nm"] == pytest.approx((50.0,), abs=1e-6)

    def test_a_shorter_range_is_told(self):
        """4-10-0: nothing rises from 0 to 4 V, the two directions share 4 ... 10 V."""
        c = flexure_calibration(stage_log(path(4, 10, 0)))
        assert c.audit["range_V"] == pytest.approx((4.0, 10.0), abs=1e-12)
        assert any("4 ... 10 V of the 0 ... 10 V" in m for m in c.messages)

    def test_a_short_sweep_is_told(self):
        """7-10-0: less than half a sweep up; the curve is the falling one."""
        c = flexure_calibration(stage_log(path(7, 10, 0)))
        assert np.isnan(c.hysteresis)
        assert any("up 7 ... 10 V" in m and "omitted" in m for m in c.messages)

    def test_growing_loops(self):
        c = flexure_calibration(stage_log(path(0, 4, 0, 8, 0, 10, 0)))
        assert c.full_scale == pytest.approx(FS, abs=1e-9 * UM)
        assert (c.audit["sweeps_up"], c.audit["sweeps_down"]) == (1, 1)
        assert any("omitted" in m and "0 ... 8 V" in m for m in c.messages)


class TestInverse:
    @pytest.mark.parametrize("sign", [1, -1])
    @pytest.mark.parametrize("direction", ["mean", "up", "down"])
    def test_there_and_back(self, direction, sign):
        log = sweeps(bow=1.5 * UM, loop=2 * UM)
        log = Recording(
            log.t, {"voltage": log["voltage"], "displacement": sign * log["displacement"]}
        )
        c = flexure_calibration(log)
        want = sign * np.linspace(0.0, FS, 400)
        v = c.voltage_for(want, direction=direction)
        assert sign * c.sensitivity > 0
        assert (np.diff(v) > 0).all()
        assert np.abs(c.evaluate(v, direction=direction) - want).max() < 1e-12 * FS

    def test_nan_stays(self):
        v = flexure_calibration(sweeps()).voltage_for([UM, np.nan])
        assert np.isnan(v[1])
        assert v[0] == pytest.approx(1 / 1.66, abs=1e-12)

    def test_stroke_exceeded(self):
        c = flexure_calibration(sweeps())
        with pytest.raises(LimitError, match=r"1\.7e-05 m"):
            c.voltage_for([1 * UM, 17 * UM])
        with pytest.raises(LimitError, match=r"10\.1 V"):
            c.evaluate(10.1)

    def test_uncertainty(self):
        c = flexure_calibration(sweeps(4, loop=0.6 * UM, noise=5 * NM), resolution=5 * NM)
        assert c.u_displacement() == pytest.approx(0.3 * UM / np.sqrt(3), abs=5 * NM)
        assert c.u_displacement(direction="up") < 15 * NM


class TestBadInput:
    def test_not_monotone_names_the_voltage(self):
        log = sweeps()
        d = log["displacement"].copy()
        d[log["voltage"] == 6.0] = 3 * UM
        with pytest.raises(InvalidSamplesError, match="not monotone at 6 V"):
            flexure_calibration(Recording(log.t, {"voltage": log["voltage"], "displacement": d}))

    def test_saturation(self):
        log = sweeps()
        d = np.minimum(log["displacement"], 12 * UM)
        with pytest.raises(InvalidSamplesError, match="not monotone at 8 V"):
            flexure_calibration(Recording(log.t, {"voltage": log["voltage"], "displacement": d}))

    def test_constant_voltage(self):
        log = Recording(np.arange(9), {"voltage": np.ones(9), "displacement": np.arange(9.0)})
        with pytest.raises(DegenerateFitError, match="stays at 1 V"):
            flexure_calibration(log)

    def test_few_and_nan(self):
        with pytest.raises(TooFewSamplesError):
            flexure_calibration(Recording([0.0], {"voltage": [1.0], "displacement": [0.0]}))
        log = sweeps()
        d = log["displacement"].copy()
        d[[3, 30]] = np.nan
        c = flexure_calibration(Recording(log.t, {"voltage": log["voltage"], "displacement": d}))
        assert c.audit["samples_not_measured"] == 2
        assert c.sensitivity == pytest.approx(1.66 * UM, abs=1e-9 * UM)

    def test_units_and_names(self):
        log = sweeps()
        with pytest.raises(UnitError, match="mV"):
            flexure_calibration(Recording(log.t, log.channels, units={"voltage": "mV"}))
        with pytest.raises(DataError, match="gap"):
            flexure_calibration(log, displacement="gap")
        renamed = Recording(
            log.t, {"a": log["voltage"], "b": log["displacement"]}, units={"a": "V", "b": "m"}
        )
        assert flexure_calibration(renamed).sensitivity == pytest.approx(1.66 * UM, abs=1e-9 * UM)

    def test_options(self):
        for bad in ({"line": "best"}, {"resolution": -1.0}):
            with pytest.raises(DataError):
                flexure_calibration(sweeps(), **bad)

    def test_one_direction(self):
        log = Recording(np.arange(21), {"voltage": UP, "displacement": 1.66 * UM * UP})
        c = flexure_calibration(log)
        assert np.isnan(c.hysteresis)
        assert any("one direction" in m for m in c.messages)
        json.dumps(dict(c.audit), allow_nan=False)  # no NaN
        assert c.audit["hysteresis_percent_fs"] is None
        with pytest.raises(DataError, match="no sweep down"):
            c.voltage_for([UM], direction="down")
