"""A table that runs over its travel, a probe that reads it, and a logger: repeated runs in time.

Written without library code. Lengths in mm, readings in nm, times in s, as a person at the machine
writes them; `Reading` carries those units in its names.

What happens, in the order of the machine:

1. the table moves at constant feed, forward or back; its place at time t is start + v t;
2. the true error at that place, a wave that slips (another phase in each run) and vibration add up
   to the motion between probe and artefact, computed at a FINE step of time;
3. the sensor follows that motion as a first-order low-pass and late by a pure delay: both are done
   to the motion IN TIME, before it is sampled; no coefficient of a wave is ever rotated;
4. the logger takes every m-th value, together with the place of the table at that very instant,
   adds its own white noise, drift and offset, rounds to its step and stops at its limit.

A late reading taken at place x therefore shows the error of the place x - v d.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

__all__ = ["BASE_WAVES", "COLUMN", "Machine", "Mode", "Reading", "oscillator", "simulate"]

MARGIN_MM = 14.0
"""Truth beyond both ends of the travel: the sensor has read it before the record starts."""

SHORTEST_MM = 0.3
"""Shortest wave of a rough truth: a probe of some tenths of a mm averages what is shorter."""

BASE_WAVES = ((12.0, 300.0), (6.0, 80.0), (4.0, 40.0), (80.0, 150.0), (37.0, 80.0), (5.3, 30.0))
"""(wavelength in mm, amplitude in nm); the phases belong to the set."""


@dataclass(frozen=True)
class Mode:
    """A mass on a spring, driven by white noise."""

    hz: float
    damping: float
    rms_nm: float


COLUMN = Mode(150.0, 0.02, 200.0)


@dataclass(frozen=True)
class Machine:
    """What stands in the shop; a set of runs is this and one integer."""

    travel_mm: float = 56.0
    feeds_mm_s: tuple[float, ...] = (80.0, 120.0, 160.0)
    repeats: int = 3
    rate_hz: float = 1000.0
    both_ways: bool = False
    unequal_mm: float = 0.0  # start and end of each run differ by up to this
    # truth
    waves: tuple[tuple[float, float], ...] = BASE_WAVES
    slope_of_psd: float = 0.0  # p of a truth whose power density falls as 1/f^p; 0: none
    rough_rms_nm: float = 0.0
    mirror: str = ""  # "071": a measured mirror of the corpus as truth
    mirror_rms_nm: float = 0.0
    step_nm: float = 0.0  # in the middle of the judged range, over 0.5 mm
    bump_nm: float = 0.0  # Gaussian of 1 mm standard deviation
    # what moves
    modes: tuple[Mode, ...] = (COLUMN,)
    slip: tuple[tuple[float, float], ...] = ()  # (wavelength mm, amplitude nm), phase of each run
    slip_scatter: float = 0.0  # of its amplitude from run to run, relative; inf: normal numbers
    # sensor and logger
    delay_s: float = 0.0
    low_pass_hz: float = 0.0
    filters_vibration: bool = True  # False: vibration enters behind the sensor's filter
    white_nm: float = 20.0
    offset_nm: float = 50.0
    drift_nm_s: float = 0.0  # each run its own rate, normal
    quantum_nm: float = 0.0
    limit_nm: float = math.inf
    spike_share: float = 0.0
    spike_nm: float = 2000.0
    gap_samples: int = 0  # NaN in every third run, one gap each
    dropouts: float = 0.0  # share of the readings of all runs that are NaN, each by itself
    displaced_mm: float = 0.0  # each run its own, normal: the encoder starts so much off
    clock_jitter: float = 0.0  # share of a sample, even within +- it; on the stamps only

    def runs_per_direction(self) -> int:
        return len(self.feeds_mm_s) * self.repeats


@dataclass(frozen=True)
class Reading:
    """One run as the logger wrote it."""

    name: str
    x_mm: np.ndarray
    z_nm: np.ndarray
    t_s: np.ndarray
    feed_mm_s: float
    direction: int


@dataclass(frozen=True)
class Measured:
    """A set and what only the simulator knows."""

    machine: Machine
    seed: int
    runs: list[Reading]
    truths: dict[int, Callable[[np.ndarray], np.ndarray]] = field(repr=False)  # nm at mm


def oscillator(rng, mode, step_s, n):
    """n values of the displacement of the oscillator, exact at its sampling instants.

    x'' + 2 D w x' + w^2 x = white noise. The state (x, v) is stationary with variances r^2 and
    (w r)^2; its eigenvector coordinates are autoregressive of order one.
    """
    w = 2.0 * math.pi * mode.hz
    matrix = np.array([[0.0, 1.0], [-w * w, -2.0 * mode.damping * w]])
    values, vectors = np.linalg.eig(matrix.astype(complex))
    into = np.linalg.inv(vectors)
    stationary = np.diag([mode.rms_nm**2, (w * mode.rms_nm) ** 2])
    forward = (vectors @ np.diag(np.exp(values * step_s)) @ into).real
    lost = stationary - forward @ stationary @ forward.T
    # the two states have very different units: scale before the factor
    scale = np.sqrt(np.diag(stationary))
    size, turn = np.linalg.eigh(lost / np.outer(scale, scale))
    root = scale[:, None] * turn * np.sqrt(np.clip(size, 0.0, None))
    kicks = into @ (root @ rng.standard_normal((2, n)))
    begin = into @ (scale * rng.standard_normal(2))
    found = np.zeros(n, dtype=complex)
    for i in range(2):
        pole = np.exp(values[i] * step_s)
        state, _ = lfilter([1.0], [1.0, -pole], kicks[i], zi=np.array([pole * begin[i]]))
        found += vectors[0, i] * state
    return found.real


def low_passed(motion, step_s, hz):
    """First-order low-pass of a signal that is straight between its samples."""
    ratio = 1.0 / (2.0 * math.pi * hz * step_s)  # time constant over step
    a = math.exp(-1.0 / ratio)
    b_now, b_before = 1.0 - ratio * (1.0 - a), ratio * (1.0 - a) - a
    start = np.array([motion[0] - b_now * motion[0]])  # at rest on the first value
    return lfilter([b_now, b_before], [1.0, -a], motion, zi=start)[0]


# ---- the truth -------------------------------------------------------------------------------------


def corpus_folder():
    import os

    default = Path(__file__).resolve().parents[3].parent / "shared" / "corpus"
    return Path(os.environ.get("METROSEP_CORPUS", default))


MIRRORS = {
    # name: header lines, columns of place and value, is it a slope (urad), factor on the places
    "071": (6, (0, 1), True, 1.0),  # ESRF, 968 mm at 0.105 mm, slope
    "010": (1, (0, 1), False, 0.2),  # LCLS, 444 mm at 1.02 mm, height in nm; laid over 89 mm
    "001": (4, (0, 1), True, 0.125),  # ESRF, 1200 mm at 1 mm, slope; laid over 150 mm
}
"""Mirrors that were measured on a coarse grid are laid over a shorter length, so that their grid
is finer than what the runs resolve; heights are scaled to the RMS that the row states."""


def mirror_profile(name):
    """Places in mm and heights in nm of a whole mirror."""
    skip, columns, slope, squeeze = MIRRORS[name]
    lines = (corpus_folder() / "dabam" / f"dabam-{name}.dat").read_text("latin-1").splitlines()
    rows = [line.split() for line in lines[skip:] if len(line.split()) >= 2]
    x, z = np.array([[float(row[c]) for c in columns] for row in rows]).T
    if slope:  # urad mm = nm
        z = np.concatenate([[0.0], np.cumsum(np.diff(x) * (z[1:] + z[:-1]) / 2.0)])
    return (x - x[0]) * squeeze, z


def _line_free(x, z):
    return z - np.polynomial.Polynomial.fit(x, z, 1)(x)


def _truth(machine, rng):
    """The error in nm as a function of the place in mm, defined beyond the travel."""
    waves = [(2.0 * math.pi / w, a, rng.uniform(0.0, 2.0 * math.pi)) for w, a in machine.waves]
    low, high = -MARGIN_MM, machine.travel_mm + MARGIN_MM
    inside = np.linspace(0.0, machine.travel_mm, 2001)
    rough = mirror = None
    if machine.slope_of_psd:
        period = math.sqrt(19.0) * (high - low)
        k = np.arange(1, int(period / SHORTEST_MM) + 1)
        a, b = rng.standard_normal((2, k.size)) * k ** (-machine.slope_of_psd / 2.0)
        grid = np.arange(low, high + 0.04, 0.02)  # 15 points in the shortest wave: 1e-5 by spline
        angle = 2.0 * math.pi * np.outer(grid / period, k)
        rough = CubicSpline(grid, np.cos(angle) @ a + np.sin(angle) @ b)
        factor = machine.rough_rms_nm / np.std(_line_free(inside, rough(inside)))
        rough = CubicSpline(grid, rough(grid) * factor)
    if machine.mirror:
        x, z = mirror_profile(machine.mirror)
        first = rng.uniform(0.0, x[-1] - (high - low))
        spline = CubicSpline(x - first + low, z)
        line = np.polynomial.Polynomial.fit(inside, spline(inside), 1)
        factor = machine.mirror_rms_nm / np.std(spline(inside) - line(inside))

        def mirror(at):
            return factor * (spline(at) - line(at))

    place = machine.travel_mm * rng.uniform(0.3, 0.5)

    def truth(at):
        at = np.asarray(at, dtype=float)
        z = np.zeros(at.shape)
        for k, a, phase in waves:
            z += a * np.cos(k * at + phase)
        for part in (rough, mirror):
            if part is not None:
                z += part(at)
        if machine.step_nm:
            z += machine.step_nm / 2.0 * np.tanh((at - place) / 0.25)
        if machine.bump_nm:
            z += machine.bump_nm * np.exp(-((at - place) ** 2) / 2.0)
        return z

    return truth


# ---- the runs --------------------------------------------------------------------------------------


def _fine_factor(machine):
    """Fine steps in one sample: the delay must be a whole number of them."""
    if not (machine.delay_s or machine.low_pass_hz):
        return 1
    for m in (20, 25, 40, 50):
        steps = machine.delay_s * machine.rate_hz * m
        if abs(steps - round(steps)) < 1e-9:
            return m
    raise ValueError(f"a delay of {machine.delay_s} s is no whole number of fine steps")


def _one_run(machine, name, feed, way, ends, truth, rng):
    dt = 1.0 / machine.rate_hz
    fine = _fine_factor(machine)
    h = dt / fine
    tau = 1.0 / (2.0 * math.pi * machine.low_pass_hz) if machine.low_pass_hz else 0.0
    before = math.ceil((machine.delay_s + 12.0 * tau) / h)  # e^-12: at rest to 1e-5
    steps = (ends[1] - ends[0]) / feed * machine.rate_hz
    # the last reading of the way back lies at the start or up to a pitch beyond it: both ways cover 0
    n = 1 + (int(steps + 1e-9) if way > 0 else math.ceil(steps - 1e-9))
    late = round(machine.delay_s / h)
    at = (np.arange(-before, (n - 1) * fine + 1)) * h
    begin = ends[0] if way > 0 else ends[1]
    where = begin + way * feed * at
    motion = truth(where)
    for wavelength, amplitude in machine.slip:
        phase = rng.uniform(0.0, 2.0 * math.pi)
        size = amplitude
        if math.isinf(machine.slip_scatter):
            size *= math.sqrt(rng.exponential())
        elif machine.slip_scatter:
            size *= 1.0 + machine.slip_scatter * rng.standard_normal()
        motion = motion + size * np.cos(2.0 * math.pi * where / wavelength + phase)
    shaken = sum((oscillator(rng, mode, h, at.size) for mode in machine.modes), np.zeros(at.size))
    if machine.filters_vibration:
        motion, shaken = motion + shaken, np.zeros(at.size)
    if machine.low_pass_hz:
        motion = low_passed(motion, h, machine.low_pass_hz)
    taken = before + fine * np.arange(n)
    z = motion[taken - late] + shaken[taken]
    t = np.arange(n) * dt
    z = z + machine.white_nm * rng.standard_normal(n) + machine.offset_nm * rng.standard_normal()
    z = z + machine.drift_nm_s * rng.standard_normal() * t
    if machine.spike_share:
        hit = rng.random(n) < machine.spike_share
        z[hit] += (
            machine.spike_nm * rng.choice([-1.0, 1.0], hit.sum()) * rng.uniform(1, 2, hit.sum())
        )
    if machine.quantum_nm:
        z = machine.quantum_nm * np.round(z / machine.quantum_nm)
    z = np.clip(z, -machine.limit_nm, machine.limit_nm)
    stamps = t + machine.clock_jitter * dt * rng.uniform(-1.0, 1.0, n)
    off = machine.displaced_mm * rng.standard_normal()
    return Reading(name, where[taken] + off, z, stamps, feed, way)


def simulate(machine: Machine, seed: int) -> Measured:
    """A set of runs; everything random comes from the seed."""
    truth = _truth(machine, np.random.default_rng([seed, 1]))
    truths = {1: truth}
    if machine.both_ways:  # the way back: lost motion and other balls under load
        other = np.random.default_rng([seed, 2])
        phase = other.uniform(0.0, 2.0 * math.pi)
        truths[-1] = lambda at: (
            truth(at) + 60.0 * np.cos(2 * math.pi * np.asarray(at) / 9.1 + phase)
        )
    runs = []
    ends = np.random.default_rng([seed, 3])
    for feed in machine.feeds_mm_s:
        for repeat in range(machine.repeats):
            for way, error in truths.items():
                i = len(runs)
                cut = machine.unequal_mm * ends.uniform(0.0, 1.0, 2)
                if i < len(truths):  # one run of each way covers everything
                    cut = np.zeros(2)
                reach = (cut[0], machine.travel_mm - cut[1])
                rng = np.random.default_rng([seed, 4, i])
                letter = "" if way > 0 else "b"
                name = f"{feed:g}-{repeat + 1}{letter}"
                reading = _one_run(machine, name, feed, way, reach, error, rng)
                if machine.gap_samples and i % 3 == 1:
                    first = int(rng.uniform(0.1, 0.8) * reading.z_nm.size)
                    reading.z_nm[first : first + machine.gap_samples] = np.nan
                if machine.dropouts:
                    reading.z_nm[rng.random(reading.z_nm.size) < machine.dropouts] = np.nan
                runs.append(reading)
    return Measured(machine, seed, runs, truths)
