"""Iterative learning: contraction of a known axis, a planted sign, divergence refused."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotConvergedError,
    NotUniformError,
    TooFewSamplesError,
)
from metrosep.process.learning import learn_step, low_pass

NM = 1e-9
STEP = 1e-3
T = STEP * np.arange(6000)
PATH = 1e-6 * (1 - np.cos(2 * np.pi * T)) + 0.3e-6 * np.sin(2 * np.pi * 3.0 * T) ** 3
CUTOFF = 30.0


def axis(command, rng=None, *, scale=0.8, noise=0.0):
    """First-order lag of 5 ms, a scale error and a repeating disturbance that is not symmetric."""
    pole = np.exp(-STEP / 5e-3)
    moved = lfilter([1 - pole], [1, -pole], command, zi=[pole * command[0]])[0]
    disturbance = 40 * NM * np.sin(2 * np.pi * 5 * T + 0.5) * (T > 1.0)
    fresh = 0.0 if rng is None else noise * rng.standard_normal(command.size)
    return scale * moved + disturbance + fresh


def rms(v):
    return float(np.sqrt(np.mean(v**2)))


def test_error_shrinks_and_the_opposite_sign_makes_it_grow():
    first = axis(PATH)
    step = learn_step(T, desired=PATH, command=PATH, actual=first, cutoff=CUTOFF)
    before = rms(first - PATH)
    assert rms(axis(step.command) - PATH) < 0.65 * before
    assert rms(axis(PATH - step.change) - PATH) > 1.3 * before


def test_six_runs_reach_what_the_cutoff_leaves():
    command, history, predicted, step = PATH, [], [], None
    for _ in range(6):
        actual = axis(command)
        step = learn_step(
            T,
            desired=PATH,
            command=command,
            actual=actual,
            cutoff=CUTOFF,
            gain=0.8,
            previous=step,
        )
        history.append(step.rms.value)
        predicted.append(step.predicted_rms.value)
        assert not step.contraction >= 1.0
        command = step.command
    assert history[-1] < 0.02 * history[0]
    # the prediction of the first step is the next run
    assert predicted[0] == pytest.approx(history[1], abs=0.05 * history[0])


@pytest.mark.parametrize(("scale", "gain"), [(0.8, 1.0), (1.3, 0.5), (0.5, 0.2)])
def test_contraction_of_a_pure_scale(scale, gain):
    """T = scale: |1 - gain Q T| is largest where Q is smallest among what the path excites."""
    t = STEP * np.arange(4000)
    path = 1e-6 * np.sin(2 * np.pi * 2.0 * t)
    step = learn_step(t, desired=path, command=path, actual=scale * path, cutoff=200.0, gain=gain)
    assert step.contraction == pytest.approx(abs(1 - gain * scale), abs=1e-3)
    worst = abs(1 - gain * scale) * rms((scale - 1) * path)
    assert step.predicted_rms.value == pytest.approx(worst, abs=2e-3 * rms(path))


class TestDivergence:
    def test_axis_of_the_wrong_sign(self):
        with pytest.raises(NotConvergedError, match="sign of the axis"):
            learn_step(T, desired=PATH, command=PATH, actual=-PATH, cutoff=CUTOFF)

    def test_too_much_gain_for_the_axis(self):
        actual = 2.5 * PATH
        with pytest.raises(NotConvergedError, match=r"would grow by 1\.5"):
            learn_step(T, desired=PATH, command=PATH, actual=actual, cutoff=400.0, gain=1.0)
        learn_step(T, desired=PATH, command=PATH, actual=actual, cutoff=400.0, gain=0.5)

    def test_given_transfer(self):
        """A resonance that the path does not excite is known from elsewhere."""

        def resonance(f):
            return 1 / (1 - (f / 25.0) ** 2 + 0.05j * f / 25.0)

        with pytest.raises(NotConvergedError, match="Hz would grow"):
            learn_step(
                T,
                desired=PATH,
                command=PATH,
                actual=0.99 * PATH,
                cutoff=CUTOFF,
                transfer=resonance,
            )

    def test_error_has_grown(self):
        first = learn_step(T, desired=PATH, command=PATH, actual=0.9 * PATH, cutoff=CUTOFF)
        with pytest.raises(NotConvergedError, match="has grown"):
            learn_step(
                T,
                desired=PATH,
                command=first.command,
                actual=0.85 * PATH,
                cutoff=CUTOFF,
                previous=first,
            )

    def test_second_run_shows_a_disturbance_is_no_axis(self):
        """Differences of runs: a disturbance as large as the path does not hide the axis."""
        disturbance = 0.9 * PATH + 30 * NM * np.sin(2 * np.pi * 4 * T)
        one = learn_step(
            T, desired=PATH, command=PATH, actual=0.6 * PATH + disturbance, cutoff=400.0, gain=0.4
        )
        assert one.contraction == pytest.approx(1 - 0.4 * 1.5, abs=0.01)  # misled, as said
        two = learn_step(
            T,
            desired=PATH,
            command=one.command,
            actual=0.6 * one.command + disturbance,
            cutoff=400.0,
            gain=0.4,
            previous=one,
        )
        assert two.contraction == pytest.approx(1 - 0.4 * 0.6, abs=0.01)

    def test_learnt_command_alone_is_not_judged(self):
        step = learn_step(T, desired=PATH, command=0.9 * PATH, actual=0.95 * PATH, cutoff=CUTOFF)
        assert np.isnan(step.contraction)
        assert any("previous=" in m for m in step.messages)


def test_scatter_between_runs():
    rng = np.random.default_rng(4)
    runs = np.array([axis(PATH, rng, noise=20 * NM) for _ in range(5)])
    step = learn_step(T, desired=PATH, command=PATH, actual=runs, cutoff=CUTOFF)
    assert step.audit["scatter_nm"] == pytest.approx(20.0 * 0.94, abs=0.5)  # c4 of five runs
    assert step.predicted_rms.u > 20 * NM * 0.9
    assert not any("one run" in m for m in step.messages)
    one = learn_step(T, desired=PATH, command=PATH, actual=runs[0], cutoff=CUTOFF)
    assert one.predicted_rms.u is None
    assert any("one run" in m for m in one.messages)


class TestLowPass:
    def test_half_at_the_cutoff_without_phase(self):
        t = STEP * np.arange(6001)  # the wave is zero at both ends
        z = np.sin(2 * np.pi * 10.0 * t)
        assert np.abs(low_pass(z, STEP, 10.0) - 0.5 * z).max() < 1e-9

    def test_a_line_passes(self):
        z = 3.0 + 2.0 * T
        assert np.abs(low_pass(z, STEP, 1.0) - z).max() < 1e-12


class TestBadInput:
    @pytest.mark.parametrize("gain", [0.0, -0.5, 1.01, np.nan])
    def test_gain(self, gain):
        with pytest.raises(DataError, match="gain"):
            learn_step(T, desired=PATH, command=PATH, actual=PATH, cutoff=10, gain=gain)

    @pytest.mark.parametrize("cutoff", [0.0, 501.0, np.nan])
    def test_cutoff(self, cutoff):
        with pytest.raises(DataError, match="cutoff"):
            learn_step(T, desired=PATH, command=PATH, actual=PATH, cutoff=cutoff)

    def test_gap(self):
        actual = PATH.copy()
        actual[100] = np.nan
        with pytest.raises(InvalidSamplesError, match=r"NaN at 0\.1 s"):
            learn_step(T, desired=PATH, command=PATH, actual=actual, cutoff=10)

    def test_lengths_and_time(self):
        with pytest.raises(InvalidSamplesError, match="has 5999"):
            learn_step(T, desired=PATH, command=PATH, actual=PATH[1:], cutoff=10)
        with pytest.raises(NotUniformError):
            learn_step(T**2, desired=PATH, command=PATH, actual=PATH, cutoff=10)
        with pytest.raises(TooFewSamplesError):
            learn_step([0.0], desired=[0.0], command=[0.0], actual=[0.0], cutoff=10)

    def test_perfect_axis(self):
        step = learn_step(T, desired=PATH, command=PATH, actual=PATH, cutoff=CUTOFF)
        assert np.abs(step.change).max() == 0.0

    def test_standing_axis_says_not_checked(self):
        step = learn_step(T, desired=0 * T, command=0 * T, actual=0 * T + NM, cutoff=CUTOFF)
        assert any("not checked" in m for m in step.messages)
