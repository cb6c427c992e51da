"""Gain sweep: limits from Routh and from the exact delay; roots and simulation agree."""

from __future__ import annotations

import numpy as np
import pytest

from metrosep.core.errors import DataError
from metrosep.process.drive import stability_limits, sweep_gains
from metrosep.process.servo import Gains, ServoModel

M, KI, KD = 0.009, 1e4, 1.5
FRACTION = 1e-6
"""Relative error of a limit through a Pade fraction of order 8 at w tau < 2."""


def exact_limits(tau, ki=KI, kd=KD):
    """Kp with a root on the imaginary axis: -j M w^3 exp(j w tau) - kd w^2 + j w kp + ki = 0."""
    w = np.linspace(1.0, 0.9 * np.pi / tau, 400_001)
    real = M * w**3 * np.sin(w * tau) - kd * w**2 + ki
    at = np.flatnonzero(np.sign(real[1:]) != np.sign(real[:-1]))
    found = []
    for i in at:
        a, b = w[i], w[i + 1]
        for _ in range(60):
            c = 0.5 * (a + b)
            f = [M * v**3 * np.sin(v * tau) - kd * v**2 + ki for v in (a, c)]
            a, b = (c, b) if f[0] * f[1] > 0 else (a, c)
        found.append(M * a**2 * np.cos(a * tau))
    return sorted(k for k in found if k > 0)


def test_limit_without_delay_is_routh():
    """papers.md 1.7: Kp (Kd + c) > M Ki."""
    ((low, high),) = stability_limits(
        ServoModel(M, damping=0.3), Gains(1, KI, KD), "kp", low=0, high=1000
    )
    assert low == pytest.approx(M * KI / (KD + 0.3), abs=1e-8)
    assert high == 1000.0
    ((none, top),) = stability_limits(ServoModel(M), Gains(100, 0, KD), "ki", low=0, high=50000)
    assert top == pytest.approx(100 * KD / M, abs=1e-5)
    assert none == 0.0


@pytest.mark.parametrize("tau", [0.004, 0.0045, 0.005])
def test_limits_with_delay_are_exact(tau):
    ((low, high),) = stability_limits(
        ServoModel(M, delay=tau), Gains(1, KI, KD), "kp", low=1, high=500
    )
    want = exact_limits(tau)
    assert (low, high) == pytest.approx((want[0], want[-1]), abs=FRACTION * high)


def test_roots_and_simulation_agree():
    sweep = sweep_gains(
        ServoModel(M, delay=0.004), kp=[50, 66, 75, 150, 230, 260, 400], ki=KI, kd=KD
    )
    assert sweep.stable.tolist() == [False, False, True, True, True, False, False]
    words = [row["simulation"] for row in sweep.rows]
    for word, stable in zip(words, sweep.stable, strict=True):
        assert word in ("marginal", "stable" if stable else "diverges")
    assert words.count("marginal") <= 2
    assert not any("differently" in m for m in sweep.messages)


def test_improvement_is_a_ratio():
    t = 3.0 * np.arange(3000) / 3000
    k, phi = 2 * np.pi / 100e-6, 2 * np.pi * t / 3.0
    z = 50e-9 * (np.sin(k * 1e-4 * np.cos(phi)) + np.cos(k * 1e-4 * np.sin(phi)))
    reference = Gains(100, 7000, 1.2)
    sweep = sweep_gains(
        ServoModel(M),
        kp=[100, 180],
        ki=[7000, 10000],
        kd=[1.2, 1.5],
        t=t,
        command=z,
        reference=reference,
        simulate=False,
    )
    by_gains = {(r["kp"], r["ki"], r["kd"]): r["improvement"] for r in sweep.rows}
    assert by_gains[100, 7000, 1.2] == pytest.approx(1.0, abs=1e-12)
    assert by_gains[180, 10000, 1.5] == pytest.approx(1.45, abs=0.005)
    assert sweep.best.ki == 10000
    assert "measure a log" in sweep.messages[0]
    assert len(sweep.to_frame()) == 8


def test_nothing_stable():
    sweep = sweep_gains(ServoModel(M), kp=[10, 20], ki=KI, kd=KD, simulate=False)
    assert sweep.best is None
    assert "no setting of the sweep is stable" in sweep.messages


class TestBadInput:
    def test_too_many(self):
        with pytest.raises(DataError, match="more than"):
            sweep_gains(ServoModel(M), kp=np.arange(1, 200), ki=np.arange(200), kd=KD)

    def test_half_a_motion(self):
        with pytest.raises(DataError, match="together"):
            sweep_gains(ServoModel(M), kp=1, ki=1, kd=1, t=[0, 1, 2, 3])

    def test_gain(self):
        with pytest.raises(DataError, match="kp"):
            sweep_gains(ServoModel(M), kp=[0.0], ki=1, kd=1)

    def test_limits(self):
        for bad in ({"vary": "m", "low": 0, "high": 1}, {"vary": "kp", "low": 2, "high": 1}):
            with pytest.raises(DataError):
                stability_limits(ServoModel(M), Gains(1, 1, 1), **bad)
