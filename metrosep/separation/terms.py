r"""Private to separation: columns of the joint model beside offsets, slope and Fourier basis.

Drift of a run: :math:`\bar d u + \sum_j \delta_{rj} u^j`, u time from the middle of the run over
half the longest run, each power without its mean; the :math:`\delta_{rj}` of the runs are drawn
from :math:`N(0, \sigma_j^2)`, the variance being learnt, and the common rate :math:`\bar d` is
free where feedrates differ. A common bow is not: it would take the long waves of the geometry. Lines: cosine and sine in time, one pair for each run or one for all.
Waves that grow with the feedrate: cosine and sine in position times (v - v0)/v0.

Heights are dimensionless as in `metrosep.separation.system`; frequencies are in Hz.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.separation.design import PreparedRun

__all__ = ["Terms"]


_FLAT = 1e-6
"""Prior precision of coefficients that are left free: their sd is a thousand times the readings."""

_WAVE_PRECISION = 1.0
"""Of waves that grow with the feedrate: at twice the mean feed they may double the readings."""

_LEAST_VARIANCE = 1e-10
"""Variance of the drifts at which they are taken to be zero."""


class Terms:
    """Extra columns of a system, in this order: drift, lines, feed-dependent waves."""

    def __init__(
        self, runs: Sequence[PreparedRun], *, drift: int, locked: bool, several_feeds: bool
    ) -> None:
        self.runs, self.drift, self.locked = runs, drift, locked
        self.half_time = max(float(np.ptp(r.t)) for r in runs) / 2.0
        self.common_drift = several_feeds and drift > 0
        self.drift_variance = np.ones(drift)
        self.frequencies: list[float] = []
        self.wavenumbers: FloatArray = np.empty(0)
        self.origin = 0.0
        speeds = np.array([abs(r.velocity) for r in runs])
        self.reference = float(speeds.mean())
        self.relative_speed = speeds / self.reference - 1.0

    @property
    def n_drift(self) -> int:
        """Columns of the drift: those of the runs, degree by degree, then the common rate."""
        return self.drift * len(self.runs) + int(self.common_drift)

    @property
    def n_per_line(self) -> int:
        """Columns of one line."""
        return 2 if self.locked else 2 * len(self.runs)

    @property
    def size(self) -> int:
        """Number of columns."""
        return self.n_drift + self.n_per_line * len(self.frequencies) + 2 * self.wavenumbers.size

    def columns(self, index: int) -> FloatArray:
        """Return the columns of one run."""
        run = self.runs[index]
        out = np.zeros((run.x.size, self.size))
        n = len(self.runs)
        for j in range(self.drift):
            out[:, j * n + index] = self.drift_shape(index, j + 1)
        if self.common_drift:
            out[:, self.drift * n] = self.drift_shape(index, 1)
        for i, frequency in enumerate(self.frequencies):
            first = self.line_start(i) + (0 if self.locked else 2 * index)
            out[:, first : first + 2] = self.line_pair(index, frequency)
        if self.wavenumbers.size:
            out[:, -2 * self.wavenumbers.size :] = self.relative_speed[index] * self.waves(index)
        return out

    def drift_shape(self, index: int, degree: int) -> FloatArray:
        """Return the drift of a degree over one run."""
        t = self.runs[index].t
        u = (t - 0.5 * (t[0] + t[-1])) / self.half_time
        return np.asarray(u if degree == 1 else u**2 - float(np.mean(u**2)))

    def line_start(self, line: int) -> int:
        """Return the first column of a line."""
        return self.n_drift + line * self.n_per_line

    def line_time(self, index: int) -> FloatArray:
        """Return the time from which the phase of a line counts: start, or middle if free."""
        t = self.runs[index].t
        if not self.locked:
            return np.asarray(t - 0.5 * (t[0] + t[-1]))
        run = self.runs[index]
        return np.asarray(t - t[0] + 0.5 * (run.block - 1) * run.time_step / run.block)

    def line_pair(self, index: int, frequency: float) -> FloatArray:
        """Return cosine and sine of a line in one run, averaged as its samples are."""
        run = self.runs[index]
        phase = 2.0 * np.pi * frequency * self.line_time(index)
        pair = np.column_stack([np.cos(phase), np.sin(phase)])
        return np.asarray(_block_gain(run, frequency) * pair)

    def line_change(self, index: int, line: int, coefficients: FloatArray) -> FloatArray:
        """Return the derivative of a line with its frequency."""
        first = self.line_start(line) + (0 if self.locked else 2 * index)
        a, b = coefficients[first : first + 2]
        cosine, sine = self.line_pair(index, self.frequencies[line]).T
        return np.asarray(2.0 * np.pi * self.line_time(index) * (b * cosine - a * sine))

    def waves(self, index: int) -> FloatArray:
        """Return cosines and sines in position of the waves that depend on the feedrate."""
        run = self.runs[index]
        phase = 2.0 * np.pi * np.outer(run.x - self.origin, self.wavenumbers)
        gain = np.sinc(np.tile(self.wavenumbers, 2) * run.block_length)
        return np.asarray(np.hstack([np.cos(phase), np.sin(phase)]) * gain)

    def precision(self) -> FloatArray:
        """Return the prior precision of every column."""
        out = np.full(self.size, _FLAT)
        n = len(self.runs)
        for j in range(self.drift):
            out[j * n : (j + 1) * n] = 1.0 / self.drift_variance[j]
        if self.wavenumbers.size:
            out[-2 * self.wavenumbers.size :] = _WAVE_PRECISION
        return out

    def learn(self, mean: FloatArray, variance: FloatArray) -> None:
        """Update the variance of the drifts among the runs (one step of expectation-maximisation)."""
        n = len(self.runs)
        for j in range(self.drift):
            own = slice(j * n, (j + 1) * n)
            new = float(np.mean(mean[own] ** 2 + variance[own]))
            self.drift_variance[j] = max(new, _LEAST_VARIANCE)


def _block_gain(run: PreparedRun, frequency: float) -> float:
    """Return what averaging samples in blocks leaves of a line."""
    step = run.time_step / run.block
    low = np.sin(np.pi * frequency * step)
    return float(np.sin(np.pi * frequency * run.time_step) / (run.block * low)) if low else 1.0
