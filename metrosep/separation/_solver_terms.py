"""Private to separation: lines, waves and unknowns that the options add to the joint fit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrosep.separation._solver_state import INNER, SolverState, iterate
from metrosep.separation._unknowns import Frequency, Gain, Lag, Unknown
from metrosep.separation.lines import FoundLine, find_line, nearest_power
from metrosep.separation.options import JointOptions
from metrosep.separation.system import System

__all__ = [
    "choose_waves",
    "find_lines",
    "fit_unknowns",
    "place_lines",
    "state_terms",
    "wanted_unknowns",
]

_MAX_LINES = 6
"""Most lines that are looked for."""

_GAIN_PRIOR = 1.0
"""Standard deviation of a weak prior on the excess of a gain."""

_GAIN_STEP, _GAIN_DONE = 0.2, 1e-5


def state_terms(system: System, options: JointOptions) -> None:
    """Give the system the waves that the user stated."""
    system.terms.origin = system.origin
    waves = options.following_waves
    stated = options.following == "waves" and not isinstance(waves, int)
    system.set_terms(
        frequencies=(),
        wavenumbers=1.0 / np.array(waves) if stated else np.empty(0),
    )


def place_lines(system: System, stated: Sequence[float]) -> None:
    """Move stated lines to the nearest power, before a noise model can take them for noise."""
    residuals = system.residuals()
    if system.weights is not None:
        residuals = system.weights.clean(residuals, system.groups, system.noise)
    placed = [nearest_power(residuals, system.terms, f) for f in stated]
    system.set_terms(frequencies=placed, wavenumbers=system.terms.wavenumbers)


def find_lines(
    system: System, state: SolverState, options: JointOptions, orders: Sequence[int]
) -> list[FoundLine]:
    """Add lines one by one as long as the next one passes its test."""
    found: list[FoundLine] = []
    while options.lines == "auto" and len(found) < _MAX_LINES:
        residuals = system.residuals()
        if system.weights is not None:
            residuals = system.weights.clean(residuals, system.groups, system.noise)
        line = find_line(residuals, system.groups, system.terms, orders, level=options.false_alarm)
        if line is None:
            break
        found.append(line)
        system.set_terms(
            frequencies=[f.frequency for f in found], wavenumbers=system.terms.wavenumbers
        )
        iterate(system, state, 3, learn_from=0)
        system.update_noise(state.freedom, orders)
        iterate(system, state, INNER, learn_from=0)
    return found


def choose_waves(
    system: System, state: SolverState, options: JointOptions, orders: Sequence[int]
) -> None:
    """Let the strongest wavelengths of the geometry depend on the feedrate."""
    n = options.following_waves
    if options.following != "waves" or not isinstance(n, int):
        return
    a, b = np.split(system.solution[system.n_fixed :], 2)
    power = np.concatenate([[0.0], a**2 + b**2, [0.0]])
    peaks = [
        k
        for k in range(1, a.size + 1)
        if power[k] > 0.0 and power[k] >= power[k - 1] and power[k] > power[k + 1]
    ]
    chosen = sorted(peaks, key=lambda k: -power[k])[:n]
    around = [np.arange(k - 1, k + 2) for k in sorted(chosen)]
    centres = [float(power[w] @ w / power[w].sum()) for w in around]
    system.set_terms(
        frequencies=system.terms.frequencies, wavenumbers=np.array(centres) / system.period
    )
    system.update_noise(state.freedom, orders)
    iterate(system, state, INNER, learn_from=0)


def wanted_unknowns(system: System, options: JointOptions, fit_lag: bool) -> list[Unknown]:
    """Return the unknowns that the options ask for, the lag first."""
    unknowns: list[Unknown] = [Lag()] if fit_lag else []
    cell = 1.0 / max(float(np.ptp(r.t)) for r in system.runs)
    unknowns += [
        Frequency(0.5 * cell, 0.05 * cell, 1e-5 * cell, line=i)
        for i in range(len(system.terms.frequencies))
    ]
    gain = (_GAIN_PRIOR, _GAIN_STEP, _GAIN_DONE)
    if options.following == "scale":
        unknowns.append(Gain(*gain, lever=system.terms.relative_speed, name="following"))
    if options.probe_gain == "fit":
        names = [r.probe for r in system.runs]
        for probe in list(dict.fromkeys(names))[1:]:
            lever = np.array([float(n == probe) for n in names])
            unknowns.append(Gain(*gain, lever=lever, with_slope=True, name=probe))
    return unknowns


def fit_unknowns(
    system: System,
    state: SolverState,
    unknowns: Sequence[Unknown],
    orders: Sequence[int],
    *,
    n_max: int = 40,
) -> None:
    """Gauss-Newton: solve with the derivatives as columns, shift, repeat."""
    if not unknowns:
        return
    system.add_unknowns(unknowns)
    first = system.extra.stop
    for i in range(n_max):
        iterate(system, state, 3, learn_from=0)
        steps = []
        for j, unknown in enumerate(unknowns):
            step = float(system.solution[first + j]) * unknown.prior_sd
            step = float(np.clip(step, -unknown.largest_step, unknown.largest_step))
            unknown.shift(system, step)
            system.solution[first + j] = 0.0
            steps.append(abs(step) / unknown.done)
        if i < 4:
            system.update_noise(state.freedom, orders)
        if max(steps) < 1.0:
            break
    iterate(system, state, 3, learn_from=0)
    assert state.covariance is not None  # noqa: S101  (set by iterate)
    for j, unknown in enumerate(unknowns):
        unknown.sd = float(np.sqrt(state.covariance[first + j, first + j])) * unknown.prior_sd
