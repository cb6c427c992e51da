"""Private: a log of voltage and displacement cut into sweeps on common voltages."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, DegenerateFitError, TooFewSamplesError, UnitError
from metrosep.core.recording import Recording

_TURN = 0.02
"""A turning point is a return by this share of the voltage range; less is noise."""

_LEVELS = 101
"""Voltages of the curves where the log has no levels of its own."""

_SAME = 1e-3
"""Voltages closer than this share of the range are one level."""


def samples(log: Recording, voltage: str, displacement: str) -> tuple[FloatArray, FloatArray, int]:
    """Return voltage and displacement where both were measured, and how many were not."""
    if not isinstance(log, Recording):
        raise DataError(f"pass a Recording, got {type(log).__name__}: sweeps need their order")
    names = [_channel(log, voltage, "V"), _channel(log, displacement, "m")]
    v, d = log[names[0]], log[names[1]]
    valid = ~(np.isnan(v) | np.isnan(d))
    if valid.sum() < 3:
        raise TooFewSamplesError(
            f"a calibration needs at least 3 samples of voltage and displacement, got "
            f"{int(valid.sum())} of {v.size}"
        )
    return v[valid], d[valid], int((~valid).sum())


def _channel(log: Recording, name: str, unit: str) -> str:
    if name not in log.channels:
        fitting = [n for n in log.channels if log.units.get(n) == unit]
        if len(fitting) == 1:
            return fitting[0]
    log[name]
    if log.units.get(name, unit) != unit:
        raise UnitError(f"channel {name!r} is in {log.units[name]!r}, it must be in {unit}")
    return name


def dwells(v: FloatArray, d: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return one point for each stretch of equal voltage."""
    span = float(np.ptp(v))
    if not span > 0.0:
        raise DegenerateFitError(f"the voltage stays at {v[0]:.6g} V; sweep it up and down")
    # only exact repeats are dwells: a slow ramp must not be taken for one
    start = np.concatenate([[0], np.flatnonzero(np.diff(v) != 0.0) + 1])
    size = np.diff(np.append(start, v.size))
    return v[start], np.asarray(np.add.reduceat(d, start) / size)


def sweeps(v: FloatArray, d: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
    """Return the parts between turning points, each in the order of time."""
    threshold = _TURN * float(np.ptp(v))
    turns, direction = [0], 0
    extreme = 0
    low = high = 0
    for i in range(1, v.size):
        if direction == 0:
            low, high = (i if v[i] < v[low] else low), (i if v[i] > v[high] else high)
            if v[i] - v[low] > threshold:
                direction, extreme = 1, i
                if low:
                    turns.append(low)
            elif v[high] - v[i] > threshold:
                direction, extreme = -1, i
                if high:
                    turns.append(high)
        elif direction * (v[i] - v[extreme]) > 0.0:
            extreme = i
        elif direction * (v[extreme] - v[i]) > threshold:
            turns.append(extreme)
            direction, extreme = -direction, i
    turns.append(v.size - 1)
    parts = [slice(a, b + 1) for a, b in itertools.pairwise(turns) if b > a]
    full = 0.5 * float(np.ptp(v))
    kept = [(v[p], d[p]) for p in parts if float(np.ptp(v[p])) > full]
    if not kept:
        raise DegenerateFitError("no sweep covers half of the voltage range; sweep it whole")
    return kept


def on_common_voltages(
    runs: list[tuple[FloatArray, FloatArray]],
) -> tuple[FloatArray, FloatArray]:
    """Return the voltages that all sweeps share and one curve for each sweep."""
    low = max(float(v.min()) for v, _ in runs)
    high = min(float(v.max()) for v, _ in runs)
    if not high > low:
        raise DegenerateFitError("the sweeps share no range of voltage")
    for v, _ in runs:
        if v.size < 3:
            raise TooFewSamplesError(f"a sweep has {v.size} voltages; a curve needs at least 3")
    ordered = [_rising(v, d) for v, d in runs]
    first = ordered[0][0]
    tolerance = _SAME * (high - low)
    shared = all(
        v.size == first.size and float(np.abs(v - first).max()) <= tolerance for v, _ in ordered
    )
    # a ramp of many samples is noise from one to the next: fewer voltages, each the mean around it
    grid = first if shared and first.size <= _LEVELS else np.linspace(low, high, _LEVELS)
    return grid, np.array([_resampled(v, d, grid) for v, d in ordered])


def _rising(v: FloatArray, d: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a sweep ordered by voltage, equal voltages averaged."""
    levels, at = np.unique(v, return_inverse=True)
    return levels, np.asarray(np.bincount(at, weights=d) / np.bincount(at))


def _resampled(v: FloatArray, d: FloatArray, grid: FloatArray) -> FloatArray:
    """Return a curve on the grid; of a fine ramp the local line through what lies around."""
    if v.size < 4 * grid.size:
        return np.asarray(np.interp(grid, v, d))
    half = 0.5 * float(grid[1] - grid[0])
    result = np.empty(grid.size)
    for i, g in enumerate(grid):
        near = slice(*np.searchsorted(v, [g - half, g + half]))
        if near.stop - near.start < 3:
            result[i] = np.interp(g, v, d)
        else:
            result[i] = np.polynomial.polynomial.polyfit(v[near] - g, d[near], 1)[0]
    return result


def branches(
    curves: FloatArray, rising: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the mean up, down and of both, and the scatter between sweeps."""
    n = curves.shape[1]
    missing: FloatArray = np.full(n, np.nan)
    up = curves[rising].mean(axis=0) if rising.any() else missing
    down = curves[~rising].mean(axis=0) if not rising.all() else missing
    mean = 0.5 * (up + down)
    if rising.all() or not rising.any():
        mean = up if rising.all() else down
    squares, freedom = np.zeros(n), 0
    for own in (curves[rising], curves[~rising]):
        if len(own) > 1:
            squares += ((own - own.mean(axis=0)) ** 2).sum(axis=0)
            freedom += len(own) - 1
    return up, down, mean, np.sqrt(squares / freedom) if freedom else missing.copy()
