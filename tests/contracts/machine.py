"""A simulated machine axis with known truth, written without any code of metrosep.

Units here are those of the paper: mm, um, mm/s, s. The truth is a sum of cosines; disturbances
are a sine, a sine locked to the start of each run, a randomly excited resonance (exact
discretisation of the oscillator's state equation) or two of them.
"""

import numpy as np
from scipy.linalg import expm

STANDARD = {10.0: 0.45, 5.0: 0.06, 10 / 3: 0.02, 63.0: 0.15, 31.0: 0.06, 4.6: 0.04}
LONG_ONLY = {w: a for w, a in STANDARD.items() if w > 4.0}
WITH_SHORT = {**STANDARD, 1.6: 0.08}


def resonance(rng, n, dt, frequency, damping, rms):
    """Stationary response of an oscillator to white noise, sampled."""
    w = 2 * np.pi * frequency
    step = expm(np.array([[0.0, 1.0], [-w * w, -2 * damping * w]]) * dt)
    stationary = np.diag([1.0, w * w])
    kick = np.linalg.cholesky(
        stationary - step @ stationary @ step.T + 1e-14 * np.diag([1.0, w * w])
    )
    state = np.sqrt(np.diag(stationary)) * rng.standard_normal(2)
    noise = rng.standard_normal((n, 2)) @ kick.T
    out = np.empty(n)
    for i in range(n):
        out[i] = state[0]
        state = step @ state + noise[i]
    return rms * out


class Machine:
    """Runs of an axis: lists of (x_mm, z_um, t_s, v_mm_per_s), and the truth."""

    def __init__(
        self,
        seed,
        *,
        length=45.0,
        case="modal",
        waves=None,
        feeds=(80.0, 120.0, 160.0),
        n_repeats=3,
        noise=0.02,
        lag=0.0,
        rate=1000.0,
        direction=1,
    ):
        rng = np.random.default_rng([seed, 77])
        self.length = length
        self.waves = STANDARD if waves is None else waves
        self.phase = {w: rng.uniform(0, 2 * np.pi) for w in self.waves}
        self.runs = []
        travel, low = 1.25 * length, -length / 8
        for v in feeds:
            for _ in range(n_repeats):
                n = int(travel / v * rate) + 1
                t = np.arange(n) / rate
                x = low + v * t if direction > 0 else low + travel - v * t
                z = self.truth(x - direction * v * lag)
                z = z + self._disturbance(rng, case, t, 1 / rate)
                z = z + noise * rng.standard_normal(n) + 0.05 * rng.standard_normal()
                self.runs.append((x, z, t, v))

    @staticmethod
    def _disturbance(rng, case, t, dt):
        if case == "none":
            return np.zeros(t.size)
        if case == "sine":
            return 0.3 * np.sin(2 * np.pi * 150 * t + rng.uniform(0, 2 * np.pi))
        if case == "locked":
            return 0.3 * np.sin(2 * np.pi * 150 * t)
        out = resonance(rng, t.size, dt, 150.0, 0.02, 0.212)
        if case == "floor":
            out = out + resonance(rng, t.size, dt, 12.0, 0.02, 0.071)
        return out

    def truth(self, x_mm):
        x_mm = np.asarray(x_mm, dtype=float)
        total = np.zeros_like(x_mm)
        for w, a in self.waves.items():
            total = total + a * np.cos(2 * np.pi * x_mm / w + self.phase[w])
        return total

    def grid(self, n=451):
        return np.linspace(0.0, self.length, n)

    def error_nm(self, estimate, n=451):
        """Estimate minus truth in nm over the required range, offset and slope removed."""
        x = self.grid(n)
        difference = (estimate.evaluate(x * 1e-3) * 1e6 - self.truth(x)) * 1e3
        return difference - np.polyval(np.polyfit(x, difference, 1), x)

    def rms_nm(self, estimate):
        return float(np.sqrt(np.mean(self.error_nm(estimate) ** 2)))

    def coverage(self, estimate):
        """Share of positions where the truth lies within two standard uncertainties."""
        sd = estimate.sd(self.grid() * 1e-3) * 1e9
        return float(np.mean(np.abs(self.error_nm(estimate)) <= 2 * sd))
