"""Servo model: Routh, roots against the exact delay, steady state against simulation, ratios."""

from __future__ import annotations

import numpy as np
import pytest

from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotUniformError,
    TooFewSamplesError,
)
from metrosep.process.servo import Gains, ServoModel, error_ratio, retuned_error

NM = 1e-9
M, KI, KD = 0.009, 1e4, 1.5
BEFORE, AFTER = Gains(100, 7000, 1.2), Gains(180, 1e4, 1.5)
TWO = 2e-4
"""Relative; force and command run linearly within a step."""


def sine_grid(rho, n=6000):
    t = 3.0 * np.arange(n) / n
    k, phi = 2 * np.pi / 100e-6, 2 * np.pi * t / 3.0
    return t, 50e-9 * (np.sin(k * rho * np.cos(phi)) + np.cos(k * rho * np.sin(phi)))


def exact_limits(tau, ki=KI, kd=KD, mass=M):
    """Kp at which a root lies on the imaginary axis, the delay exact: no fraction, no roots.

    -j M w^3 exp(j w tau) - kd w^2 + j w kp + ki = 0; the real part gives w, the imaginary kp.
    """
    w = np.linspace(1.0, 0.9 * np.pi / tau, 2_000_001)
    real = mass * w**3 * np.sin(w * tau) - kd * w**2 + ki
    at = np.flatnonzero(np.sign(real[1:]) != np.sign(real[:-1]))
    return sorted(float(mass * w[i] ** 2 * np.cos(w[i] * tau)) for i in at)


class TestStability:
    def test_row_22(self):
        """papers.md section 5, row 22: Routh's limit Kp = M Ki/Kd = 60."""
        axis = ServoModel(M)
        for kp, stable in ((59, False), (61, True)):
            g = Gains(kp, KI, KD)
            assert axis.is_stable(g) is stable
            assert axis.routh_holds(g) is stable

    def test_damping_moves_the_limit(self):
        axis = ServoModel(M, damping=0.5)
        limit = M * KI / (KD + 0.5)
        assert not axis.is_stable(Gains(limit * 0.999, KI, KD))
        assert axis.is_stable(Gains(limit * 1.001, KI, KD))

    @pytest.mark.parametrize(("tau", "low", "high"), [(0.004, 70, 243), (0.005, 73, 172)])
    def test_window_with_delay(self, tau, low, high):
        """papers.md 1.7: M = 0.009, tau = 4 ms: 70..243; 5 ms: 73..172."""
        axis = ServoModel(M, delay=tau)
        stable = [kp for kp in range(40, 300) if axis.is_stable(Gains(kp, KI, KD))]
        assert (stable[0], stable[-1]) == (low, high)
        exact = [k for k in exact_limits(tau) if k > 0]
        assert low - 1 < exact[0] < low
        assert high < exact[-1] < high + 1

    def test_poles_of_a_known_polynomial(self):
        """M s^3 + kd s^2 + kp s + ki = 0.5 (s+1)(s+2)(s+3) = 0.5 s^3 + 3 s^2 + 5.5 s + 3."""
        poles = ServoModel(0.5).roots(Gains(5.5, 3.0, 3.0))
        assert np.sort(poles.real) == pytest.approx([-3, -2, -1], abs=1e-9)
        assert np.abs(poles.imag).max() < 1e-9

    def test_without_integral_part(self):
        """0.5 s^2 + 3 s + 4 = 0.5 (s+2)(s+4); no pole at zero is left."""
        poles = ServoModel(0.5).roots(Gains(4.0, 0.0, 3.0))
        assert np.sort(poles.real) == pytest.approx([-4, -2], abs=1e-9)


class TestResponse:
    @pytest.mark.parametrize("tau", [0.0, 0.004, 0.0041234])
    def test_steady_state_equals_simulation(self, tau):
        t, z = sine_grid(250e-6)
        axis = ServoModel(M, delay=tau)
        lines = np.fft.rfft(z) * axis.response(BEFORE, np.fft.rfftfreq(z.size, t[1]))
        steady = np.fft.irfft(lines, z.size) / np.ptp(z)
        long = axis.simulate(BEFORE, t[1] * np.arange(2 * t.size), np.tile(z, 2))
        scale = np.abs(steady).max()
        assert np.abs(long[t.size :] - steady).max() < 1e-3 * scale
        assert np.abs(long[t.size :] + steady).max() > scale  # the sign is not free

    def test_low_frequency_law(self):
        """PID without damping: error -> -(M/Ki) jerk (actual behind where jerk is positive)."""
        f = 0.05
        s = 2j * np.pi * f
        got = ServoModel(M).response(BEFORE, [f])[0]
        assert abs(got / (-(M / BEFORE.ki) * s**3) - 1) < 0.01

    def test_complete_feedforward_leaves_nothing(self):
        got = ServoModel(M).response(Gains(100, 7000, 1.2, feedforward=M), [1.0, 5.0, 20.0])
        assert np.abs(got).max() < 1e-15

    def test_ratio_of_the_paper(self):
        """papers.md 1.7: (100, 7000, 1.2) -> (180, 10000, 1.5) improves by 1.45, a ratio only."""
        t, z = sine_grid(100e-6)
        ratio = error_ratio(ServoModel(M, delay=0.004), BEFORE, AFTER, t=t, command=z)
        assert ratio == pytest.approx(1.45, abs=0.005)
        back = error_ratio(ServoModel(M, delay=0.004), AFTER, BEFORE, t=t, command=z)
        assert ratio * back == pytest.approx(1.0, abs=1e-12)

    def test_simulation_is_relative(self):
        t, z = sine_grid(250e-6, 3000)
        axis = ServoModel(M)
        one, hundred = axis.simulate(BEFORE, t, z), axis.simulate(BEFORE, t, 100 * z)
        assert np.abs(one - hundred).max() < 1e-9

    def test_divergence_is_seen(self):
        t, z = sine_grid(250e-6, 20000)
        error = ServoModel(M, delay=0.004).simulate(Gains(400, KI, KD), t, z)
        assert np.abs(error[-10:]).min() > 100 or np.isinf(error[-1])


class TestRetuned:
    def test_of_a_simulated_log(self):
        """The log of one setting, retuned, is the log of the other; disturbance included."""
        t, z = sine_grid(250e-6)
        axis = ServoModel(M, damping=0.2, delay=0.003)
        f = np.fft.rfftfreq(z.size, t[1])
        s = 2j * np.pi * f[1:]
        disturbance = 1e-7 * np.fft.rfft(np.sin(2 * np.pi * 7.0 * t + 0.4))[1:]

        def logged(g):
            plant = np.exp(-0.003 * s) / (M * s**2 + 0.2 * s)
            c = g.kp + g.ki / s + g.kd * s
            lines = np.zeros(f.size, complex)
            forward = g.feedforward * s**2
            own = np.fft.rfft(z)[1:]
            lines[1:] = (-(1 - forward * plant) * own + plant * disturbance) / (1 + c * plant)
            return np.fft.irfft(lines, z.size)

        after = Gains(150, 9000, 1.4, feedforward=0.004)
        got = retuned_error(axis, BEFORE, after, t=t, command=z, error=logged(BEFORE))
        want = logged(after)
        assert np.abs(got - want).max() < TWO * np.ptp(want)
        assert np.ptp(logged(BEFORE)) > 1.2 * np.ptp(want)

    def test_same_gains_change_nothing(self):
        t, z = sine_grid(250e-6)
        fe = np.random.default_rng(0).standard_normal(z.size) * NM + 3 * NM
        got = retuned_error(ServoModel(M), BEFORE, BEFORE, t=t, command=z, error=fe)
        assert np.abs(got - fe).max() < 1e-12 * NM


class TestBadInput:
    @pytest.mark.parametrize(
        "bad", [{"kp": 0.0}, {"kp": np.nan}, {"ki": -1.0}, {"kd": np.inf}, {"feedforward": np.nan}]
    )
    def test_gains(self, bad):
        with pytest.raises(DataError):
            Gains(**{"kp": 1.0, "ki": 1.0, "kd": 1.0, **bad})

    @pytest.mark.parametrize("bad", [{"mass": 0.0}, {"delay": -1.0}, {"damping": np.nan}])
    def test_model(self, bad):
        with pytest.raises(DataError):
            ServoModel(**{"mass": 1.0, **bad})

    def test_unstable_setting_named(self):
        t, z = sine_grid(100e-6, 300)
        with pytest.raises(DataError, match="after is unstable"):
            error_ratio(ServoModel(M), BEFORE, Gains(59, KI, KD), t=t, command=z)

    def test_motion(self):
        axis = ServoModel(M)
        with pytest.raises(NotUniformError):
            axis.simulate(BEFORE, [0.0, 1.0, 3.0, 4.0], [0.0, 1.0, 2.0, 3.0])
        with pytest.raises(TooFewSamplesError):
            axis.simulate(BEFORE, [0.0], [0.0])
        with pytest.raises(InvalidSamplesError, match="index 2"):
            axis.simulate(BEFORE, np.arange(5), [0.0, 1.0, np.nan, 0.0, 0.0])
        with pytest.raises(InvalidSamplesError):
            axis.simulate(BEFORE, np.arange(5), np.arange(4))
        with pytest.raises(DataError, match="does not move"):
            axis.simulate(BEFORE, np.arange(5), np.ones(5))
        with pytest.raises(DataError, match="whole periods"):
            retuned_error(
                axis, BEFORE, AFTER, t=np.arange(9), command=np.arange(9), error=np.zeros(9)
            )
        with pytest.raises(DataError, match="order"):
            axis.roots(BEFORE, order=0)
