"""A simulated machine axis with known truth, for examples, planning and teaching.

The truth is a sum of sines; the readings add a disturbance in time, sensor noise, an offset for
each run and a delay of the reading. The tests of the separators use another simulator that shares
no code with this one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.core.provenance import Step
from metrosep.core.runset import Run, RunSet

Disturbance = Literal["none", "sine", "locked", "modal", "floor"]

KONO_WAVES: Mapping[float, float] = {
    63e-3: 0.15e-6,
    31e-3: 0.06e-6,
    10e-3: 0.45e-6,
    5e-3: 0.06e-6,
    4.6e-3: 0.04e-6,
    10e-3 / 3: 0.02e-6,
}
"""Wavelength in m to amplitude in m: a ball screw of 10 mm lead with harmonics, and guideways."""

_COLUMN_HZ, _COLUMN_DAMPING, _COLUMN_RMS = 150.0, 0.02, 0.212e-6
_ISOLATOR_HZ, _ISOLATOR_DAMPING, _ISOLATOR_RMS = 12.0, 0.02, 0.071e-6


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedAxis:
    """Runs of a simulated axis and the truth behind them.

    Parameters
    ----------
    runs : RunSet
        What was measured.
    wavelengths, amplitudes, phases : ndarray, shape (n,)
        The geometric error, m, m and rad: ``sum A cos(2 pi x / lambda + phase)``.
    start, stop : float, m
        Required range; the runs go beyond it by an eighth of its length on both sides.
    """

    runs: RunSet
    wavelengths: FloatArray
    amplitudes: FloatArray
    phases: FloatArray
    start: float
    stop: float

    def truth(self, x: ArrayLike) -> FloatArray:
        """Return the geometric error at positions.

        Parameters
        ----------
        x : array_like, shape (n,), m
            Positions.

        Returns
        -------
        ndarray, shape (n,), m
            Error, offset and line as they are.
        """
        xs = np.atleast_1d(np.asarray(x, dtype=np.float64))
        angle = 2.0 * np.pi * xs[:, None] / self.wavelengths + self.phases
        return np.asarray(np.cos(angle) @ self.amplitudes)


def machine_axis(
    *,
    seed: int,
    length: float = 45e-3,
    feeds: Sequence[float] = (0.08, 0.12, 0.16),
    n_repeats: int = 3,
    disturbance: Disturbance = "modal",
    waves: Mapping[float, float] | None = None,
    noise: float = 20e-9,
    offset: float = 50e-9,
    lag: float = 0.0,
    sampling_rate: float = 1000.0,
    start: float = 0.0,
    directions: Sequence[int] = (1,),
    lost_motion: float = 0.0,
) -> SimulatedAxis:
    """Return simulated runs of an axis with known geometric error.

    Parameters
    ----------
    seed : int
        Of the random generator; the same seed gives the same runs.
    length, start : float, m, optional
        Required range; each run covers ``start - length/8 ... start + 9 length/8``.
    feeds : sequence of float, m/s, optional
        Feedrates.
    n_repeats : int, optional
        Runs at each feedrate and direction.
    disturbance : {"none", "sine", "locked", "modal", "floor"}, optional
        150 Hz sine of 0.3 um with random phase, the same locked to the start of each run, a
        randomly excited 150 Hz mode (2 % damping, 0.212 um RMS), or that with a 12 Hz mode of
        0.071 um RMS.
    waves : mapping of float to float, m to m, optional
        Wavelength to amplitude; `KONO_WAVES` if omitted. Phases are random.
    noise : float, m, optional
        Standard deviation of the sensor.
    offset : float, m, optional
        Standard deviation of the offset of a run.
    lag : float, s, optional
        Delay of the reading.
    sampling_rate : float, Hz, optional
        Of the logger.
    directions : sequence of {1, -1}, optional
        Ways the runs go.
    lost_motion : float, m, optional
        Added to the readings of reverse runs.

    Returns
    -------
    SimulatedAxis
        Runs and truth.

    Raises
    ------
    DataError
        If the disturbance is unknown.

    Examples
    --------
    >>> machine_axis(seed=7).runs
    RunSet(9 runs, feeds 4800, 7200, 9600 mm/min, forward, common travel -5.625 ... 50.53 mm)
    """
    if disturbance not in ("none", "sine", "locked", "modal", "floor"):
        raise DataError(f"unknown disturbance {disturbance!r}")
    length = numbers.positive(length, "length", dimension="length")
    sampling_rate = numbers.positive(sampling_rate, "sampling_rate", dimension="frequency")
    start, offset, lost_motion = (
        numbers.quantity(value, name, "length")
        for value, name in ((start, "start"), (offset, "offset"), (lost_motion, "lost_motion"))
    )
    noise = numbers.not_negative(noise, "noise", dimension="length")
    lag = numbers.quantity(lag, "lag", "time")
    rng = np.random.default_rng(seed)
    table = dict(KONO_WAVES if waves is None else waves)
    wavelengths = np.array(list(table), dtype=np.float64)
    amplitudes = np.array(list(table.values()), dtype=np.float64)
    axis = SimulatedAxis(
        runs=RunSet([Run([0.0, 1.0, 2.0], [0.0, 0.0, 0.0])]),
        wavelengths=wavelengths,
        amplitudes=amplitudes,
        phases=rng.uniform(0.0, 2.0 * np.pi, wavelengths.size),
        start=start,
        stop=start + length,
    )
    low, travel = start - length / 8.0, 1.25 * length
    runs: list[Run] = []
    for feed in feeds:
        for direction in directions:
            for _ in range(n_repeats):
                n = int(np.floor(travel / feed * sampling_rate)) + 1
                t = np.arange(n) / sampling_rate
                x = low + feed * t if direction > 0 else low + travel - feed * t
                z = axis.truth(x - direction * feed * lag)
                z += _disturbance(rng, disturbance, t)
                z += noise * rng.standard_normal(n) + offset * rng.standard_normal()
                z += lost_motion if direction < 0 else 0.0
                runs.append(Run(x, z, t=t, feed=feed, run_id=str(len(runs))))
    step = Step("simulate", {"seed": seed, "disturbance": disturbance, "lag_s": lag})
    return SimulatedAxis(
        runs=RunSet(runs, history=(step,)),
        wavelengths=wavelengths,
        amplitudes=amplitudes,
        phases=axis.phases,
        start=start,
        stop=start + length,
    )


def _disturbance(rng: np.random.Generator, kind: Disturbance, t: FloatArray) -> FloatArray:
    if kind == "none":
        return np.zeros(t.size)
    if kind in ("sine", "locked"):
        phase = rng.uniform(0.0, 2.0 * np.pi) if kind == "sine" else 0.0
        return np.asarray(0.3e-6 * np.sin(2.0 * np.pi * _COLUMN_HZ * t + phase))
    mode = _random_mode(rng, t, _COLUMN_HZ, _COLUMN_DAMPING, _COLUMN_RMS)
    if kind == "floor":
        mode = mode + _random_mode(rng, t, _ISOLATOR_HZ, _ISOLATOR_DAMPING, _ISOLATOR_RMS)
    return mode


def _random_mode(
    rng: np.random.Generator, t: FloatArray, frequency: float, damping: float, rms: float
) -> FloatArray:
    """Return a randomly excited, damped oscillation: a second-order recursion on white noise."""
    from scipy.signal import lfilter

    step = float(t[1] - t[0])
    natural = 2.0 * np.pi * frequency
    radius = np.exp(-damping * natural * step)
    a1 = 2.0 * radius * np.cos(natural * np.sqrt(1.0 - damping**2) * step)
    a2 = -(radius**2)
    variance = (1.0 - a2) / ((1.0 + a2) * ((1.0 - a2) ** 2 - a1**2))
    settle = int(np.ceil(8.0 / (damping * natural * step)))
    excitation = rng.standard_normal(t.size + settle)
    response = lfilter([1.0], [1.0, -a1, -a2], excitation)[settle:]
    return np.asarray(rms * response / np.sqrt(variance))
