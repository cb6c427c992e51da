"""Hysteresis: reference values of the specification, plays written out, and stages that are not the model."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from metrosep.core.errors import (
    DataError,
    DegenerateFitError,
    InvalidSamplesError,
    LimitError,
    TooFewSamplesError,
)
from metrosep.core.recording import Recording
from metrosep.process import PrandtlIshlinskii, compare_drives, drive_table, flexure_calibration

NM, UM = 1e-9, 1e-6
STAGE = PrandtlIshlinskii([0.0, 0.6, 1.5, 3.0], np.array([1.50, 0.09, 0.05, 0.04]) * UM)
CYCLE = (0.0, 10.0, 0.0)
CORNERS = np.array([0.249, 11.749, 3.749, 8.749, 1.749]) * UM


def between(corners, n=400):
    """A course through corners, with the corners as samples."""
    parts = [np.linspace(a, b, n, endpoint=False) for a, b in itertools.pairwise(corners)]
    return np.concatenate([*parts, corners[-1:]])


def by_hand(voltage, thresholds, weights):
    """The play as a slider in a slot, one at a time, without arrays."""
    total = []
    sliders = [0.0] * len(thresholds)
    for v in voltage:
        for k, r in enumerate(thresholds):
            if v - sliders[k] > r:
                sliders[k] = v - r
            elif sliders[k] - v > r:
                sliders[k] = v + r
        total.append(sum(w * y for w, y in zip(weights, sliders, strict=True)))
    return np.array(total)


def test_the_plays_of_the_specification():
    """specs/cutting-path.md, section 8."""
    found = STAGE.displacement([0.0, 2.0, 1.0, -1.0, 3.0], history=())
    assert found / UM == pytest.approx([0, 3.151, 1.651, -1.511, 4.791], abs=1e-12)
    assert STAGE.displacement([10.0, 0.0], history=[0.0]) / UM == pytest.approx(
        [16.551, 0.249], abs=1e-12
    )
    up = STAGE.displacement(np.linspace(0, 10, 101), history=CYCLE)
    down = STAGE.displacement(np.linspace(10, 0, 101), history=(*CYCLE, 10.0))[::-1]
    width = (down - up) / UM
    assert width.max() == pytest.approx(0.418, abs=1e-9)
    assert width[[40, 46, 60]] == pytest.approx(0.418, abs=1e-9)
    assert width[39] < 0.418 > width[61]


def test_a_course_at_random_is_that_of_sliders(rng):
    course = rng.uniform(-3.0, 10.0, 200)
    expected = by_hand([0.0, 7.0, 2.0, *course], STAGE.thresholds, STAGE.weights)[3:]
    assert STAGE.displacement(course, history=[0.0, 7.0, 2.0]) == pytest.approx(
        expected, abs=1e-18
    )


def test_the_inverse_with_its_history_leaves_nothing():
    """specs/cutting-path.md, section 8; without the history it is off by 249 nm."""
    course = between(CORNERS)
    v = STAGE.voltage_for(course, history=CYCLE)
    corners = [v[k] for k in (0, 400, 800, 1200, 1600)]
    assert corners == pytest.approx([0.0, 7.1416667, 2.1063008, 5.3123984, 0.8928571], abs=5e-8)
    left = STAGE.displacement(v, history=CYCLE) - course
    assert np.abs(left).max() < 1e-9 * NM
    forgotten = STAGE.displacement(STAGE.voltage_for(course, history=()), history=CYCLE) - course
    assert np.abs(forgotten).max() / NM == pytest.approx(249, abs=1)
    with pytest.raises(TypeError, match="history"):
        STAGE.voltage_for(course)


def test_other_stages_are_inverted_too(rng):
    for _ in range(20):
        thresholds = np.concatenate([[0.0], np.sort(rng.uniform(0.1, 6.0, 9))])
        stage = PrandtlIshlinskii(
            thresholds, rng.uniform(0.0, 0.3, 10) * UM + 1e-8, rng.uniform(-1, 1) * UM
        )
        history = rng.uniform(-2.0, 10.0, 7)
        wanted = rng.uniform(0.0, 3.0, 300) * UM
        v = stage.voltage_for(wanted, history=history)
        assert np.abs(stage.displacement(v, history=history) - wanted).max() < 1e-8 * NM


def log_of(stage, corners, *, noise=0.0, n=200, seed=1, dt=1e-2, wrong=None):
    v = between(np.array(corners, dtype=float), n)
    d = by_hand(v, stage.thresholds, stage.weights)
    d = d if wrong is None else wrong(v, d)
    d = d + np.random.default_rng(seed).normal(0.0, noise, v.size) if noise else d
    return Recording(np.arange(v.size) * dt, {"voltage": v, "displacement": d})


NESTED = [0, 10, 0, 10, 0, 10, 0, 7, 2, 6, 3, 7, 0]


def calibration():
    """Curves of the steady loop, the cycle before them left out."""
    v = between(np.array([0.0, 10.0, 0.0, 10.0, 0.0]), 100)
    d = np.concatenate(
        [
            by_hand([0.0, 10.0], STAGE.thresholds, STAGE.weights)[:0],
            STAGE.displacement(v, history=CYCLE),
        ]
    )
    return flexure_calibration(
        Recording(np.arange(v.size) * 1.0, {"voltage": v, "displacement": d})
    )


def test_three_ways_to_drive_and_what_each_leaves():
    """specs/cutting-path.md, section 8 with 0a: mean curve 209.0 nm, branches of the steady loop 340.5."""
    found = compare_drives(between(CORNERS, 2000), STAGE, calibration(), history=CYCLE)
    mean = found.residual["mean curve"] / NM
    assert np.abs(mean).max() == pytest.approx(209.0, abs=0.5)
    assert np.ptp(mean) == pytest.approx(319.1, abs=0.5)
    assert np.sqrt(np.mean(mean**2)) == pytest.approx(119.0, abs=0.5)
    assert found.largest("branches") / NM == pytest.approx(340.5, abs=0.5)
    assert found.largest("prandtl-ishlinskii") < 1e-9 * NM
    assert "branches serve full strokes" in found.messages[0]
    full = compare_drives(
        between(np.array([0.3, 16.4, 0.3]) * UM), STAGE, calibration(), history=CYCLE
    )
    assert full.largest("branches") < 25 * NM  # it turns a little before the ends
    assert not full.messages
    with pytest.raises(LimitError, match="leave the calibrated stroke"):
        compare_drives([0.0, 30 * UM], STAGE, calibration(), history=CYCLE)


@pytest.mark.parametrize("spacing", [None, 0.5])
def test_a_stage_is_identified_from_loops(spacing):
    """From 2 nm of noise: 8.5 nm with a grid of 0.25 V, 9.2 with 0.5 V."""
    fit = PrandtlIshlinskii.identify(log_of(STAGE, NESTED, noise=2 * NM), spacing=spacing)
    assert fit.rms < 4 * NM
    assert fit.worst_left_out < 15 * NM
    course = between(CORNERS)
    reached = STAGE.displacement(fit.model.voltage_for(course, history=CYCLE), history=CYCLE)
    assert np.abs(reached - course).max() < 12 * NM
    assert fit.u_weights.size == fit.model.weights.size
    assert (fit.u_weights > 0).all()
    assert not fit.messages


def test_what_the_log_does_not_tell_is_said():
    full = PrandtlIshlinskii.identify(log_of(STAGE, [0, 10, 0, 10, 0], noise=NM))
    assert "full strokes only" in full.messages[0]
    assert np.isnan(full.worst_left_out)
    coarse = PrandtlIshlinskii.identify(log_of(STAGE, NESTED, noise=NM), spacing=1.0)
    assert any("are coarse" in m for m in coarse.messages)
    creeping = log_of(
        STAGE, NESTED, wrong=lambda v, d: d + 60 * NM * np.sin(np.arange(v.size) / 40)
    )
    assert PrandtlIshlinskii.identify(creeping).rms > 20 * NM
    with pytest.raises(DegenerateFitError, match="does not grow with the voltage"):
        PrandtlIshlinskii.identify(log_of(STAGE, NESTED, wrong=lambda _, d: -d))
    with pytest.raises(TooFewSamplesError, match="log more of them"):
        PrandtlIshlinskii.identify(log_of(STAGE, [0, 10, 0], n=10))


def test_sweeps_at_two_rates_that_lag_differently_are_reported():
    slow = log_of(STAGE, NESTED, noise=NM)
    v, d = slow["voltage"], slow["displacement"]
    rate = np.diff(v, prepend=v[0])
    fast = np.arange(v.size) > 800
    t = np.cumsum(np.where(fast, 1e-3, 1e-2))
    lag = d - np.where(fast, 40 * NM, 0.0) * np.sign(rate)
    found = PrandtlIshlinskii.identify(Recording(t, {"voltage": v, "displacement": lag}))
    assert any(m.startswith("rate matters: sweeps at 5 and 50 V/s") for m in found.messages)
    same = PrandtlIshlinskii.identify(Recording(t, {"voltage": v, "displacement": d}))
    assert not any("rate" in m for m in same.messages)


def test_a_drive_table_of_a_stage_with_hysteresis():
    t = np.arange(1601) * 1e-2
    words = {"quantity": "compensation", "calibration": STAGE}
    with pytest.raises(DataError, match="give history="):
        drive_table(t, between(CORNERS), **words)
    table = drive_table(t, between(CORNERS), history=CYCLE, bits=16, **words)
    assert table.is_ok
    # half a step of 16 bits of 10 V is 0.076 mV, 0.13 nm at 1.68 um/V
    assert np.abs(table.residual).max() / NM == pytest.approx(0.13, abs=0.01)
    with pytest.raises(
        LimitError, match=r"misses the displacement by up to .* the tolerance is 1 nm"
    ):
        drive_table(t, between(CORNERS), history=CYCLE, bits=8, tolerance=1 * NM, **words)
    turned = drive_table(t, -between(CORNERS), history=CYCLE, quantity="error", calibration=STAGE)
    assert turned.voltage == pytest.approx(
        drive_table(t, between(CORNERS), history=CYCLE, **words).voltage, abs=1e-12
    )


@pytest.mark.parametrize(
    ("thresholds", "weights", "error", "match"),
    [
        ([0.1, 0.2], [1, 1], DataError, "grow from 0 V"),
        ([0.0, 0.0], [1, 1], DataError, "grow from 0 V"),
        ([0.0, 0.2], [0, 1], DataError, "first weight must be above zero"),
        ([0.0, 0.2], [1, -1], DataError, "no other below"),
        ([0.0, 0.2], [1, np.nan], InvalidSamplesError, "weights is NaN"),
        ([0.0, 0.2], [1], DataError, "equally long"),
    ],
)
def test_bad_models_are_refused(thresholds, weights, error, match):
    with pytest.raises(error, match=match):
        PrandtlIshlinskii(thresholds, weights)


def test_gaps_are_refused():
    with pytest.raises(InvalidSamplesError, match="a course cannot have gaps"):
        STAGE.displacement([0.0, np.nan], history=())
    with pytest.raises(InvalidSamplesError, match="history holds NaN"):
        STAGE.displacement([0.0], history=[np.nan])


# ---- stages that are no sum of plays ---------------------------------------------------------------


def bouc_wen(v, *, bend=0.0, steps=20):
    """Displacement k V - d h of a stage, dh = a dV - b |dV| h - c dV |h|, bent by a share over 20 um; no plays."""
    h, made = 0.0, [1.6 * UM * v[0]]
    for a, b in itertools.pairwise(v):
        dv = (b - a) / steps
        for _ in range(steps):
            h += 0.45 * dv - 0.7 * abs(dv) * h + 0.25 * dv * abs(h)
        made.append(1.6 * UM * b - 0.55 * UM * h)
    made = np.array(made)
    return made - bend * made**2 / (20 * UM)


@pytest.mark.parametrize(
    ("bend", "curve"), [(0.0, {"none"}), (0.15, {"front", "behind"}), (-0.15, {"front", "behind"})]
)
def test_what_is_left_on_a_stage_of_another_kind_is_what_was_said(bend, curve, rng):
    """A stage of Bouc and Wen, driven by the voltages of the model: four times better than the mean curve."""
    v = between(np.array(NESTED, dtype=float), 150)
    noisy = bouc_wen(v, bend=bend) + rng.normal(0.0, NM, v.size)
    log = Recording(np.arange(v.size) * 0.01, {"voltage": v, "displacement": noisy})
    fit = PrandtlIshlinskii.identify(log)
    assert fit.curve in curve
    assert any("not symmetric" in m for m in fit.messages) == bool(bend)
    before = between(np.array([0.0, 10.0, 0.0, 10.0, 0.0]), 150)
    wanted = between(np.array([0.6, 10.2, 3.7, 8.1, 1.9]) * UM, 200)
    volts = fit.model.voltage_for(wanted, history=before)
    # the model's own inverse is exact, through the curve too
    again = fit.model.displacement(volts, history=before)
    assert np.abs(again - wanted).max() < 1e-6 * NM
    reached = bouc_wen(np.concatenate([before, volts]), bend=bend)[before.size :]
    off = np.abs(reached - wanted).max()
    assert off < 1.2 * fit.worst_left_out
    full = between(np.array([0.0, 10.0, 0.0, 10.0, 0.0]), 300)
    loop = {"voltage": full[600:], "displacement": bouc_wen(full, bend=bend)[600:]}
    mean = flexure_calibration(Recording(np.arange(601) * 0.01, loop)).voltage_for(wanted)
    missed = bouc_wen(np.concatenate([before, mean]), bend=bend)[before.size :] - wanted
    assert np.abs(missed).max() > 2.5 * off


@pytest.mark.parametrize("where", ["front", "behind"])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_curve_in_front_of_the_plays_or_behind_them_is_found_and_undone(where, sign, rng):
    def stage(v):
        if where == "front":
            return by_hand(v + sign * 0.02 * v * (10.0 - v), STAGE.thresholds, STAGE.weights)
        d = by_hand(v, STAGE.thresholds, STAGE.weights)
        return d + sign * 0.1 * d * (17 * UM - d) / (17 * UM)

    v = between(np.array(NESTED, dtype=float), 150)
    log = {"voltage": v, "displacement": stage(v) + rng.normal(0.0, 2 * NM, v.size)}
    fit = PrandtlIshlinskii.identify(Recording(np.arange(v.size) * 0.01, log))
    assert fit.curve == where
    before = between(np.array([0.0, 10.0, 0.0]), 150)
    wanted = between(np.array([0.5, 11.0, 3.7, 8.7, 1.8]) * UM, 200)
    volts = fit.model.voltage_for(wanted, history=before)
    reached = stage(np.concatenate([before, volts]))[before.size :]
    assert np.abs(reached - wanted).max() < 15 * NM
    plain = replace(fit.model, front=None, behind=None)
    missed = stage(np.concatenate([before, plain.voltage_for(wanted, history=before)]))
    assert np.abs(missed[before.size :] - wanted).max() > 100 * NM


def test_a_curve_that_does_not_grow_is_refused():
    for name in ("front", "behind"):
        with pytest.raises(DataError, match=f"{name} must have two rows that grow"):
            PrandtlIshlinskii(
                [0.0, 1.0], [1e-6, 1e-7], **{name: [[0.0, 1.0, 2.0], [0.0, 2.0, 1.0]]}
            )
