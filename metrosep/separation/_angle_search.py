"""Search of probe angles: the gain from power sums, exchange over a grid, descent in fine steps.

With ``S_m = sum_i exp(j m phi_i)`` the squared length of what cos and sin leave of exp(j k phi) is
``n - (n (|S_{k-1}|^2 + |S_{k+1}|^2) - 2 Re(conj(S_{k-1} S_2) S_{k+1})) / (n^2 - |S_2|^2)``, so one
probe is exchanged by one addition to the sums.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import ComplexArray, FloatArray

__all__ = ["best_angles", "gain_table", "separations"]

Criterion = Literal["rms", "worst"]

_WORK = 8e7
"""Complex additions of the grid search: one or two seconds on one core."""

_BLOCK = 16384
"""Complex numbers of a block of places."""

_STARTS = 100
_FEWEST = 3
"""Starts where each is dear: with many probes all good arrangements are nearly alike."""

_SWEEPS = 4
_FINALISTS = 8
_TINY = 1e-9
_COLLINEAR = 1e-6
"""Share of n^2 below which the probes stand on one line and see one direction only."""


def gain_table(angles: FloatArray, kmax: int) -> FloatArray:
    """Return gains (kmax - 1, ...) of k = 2 ... kmax for angles (n, ...)."""
    m = np.arange(kmax + 2).reshape(-1, *([1] * angles.ndim))
    return _gain(np.exp(1j * m * angles).sum(axis=1), angles.shape[0])


def separations(angles: FloatArray) -> float:
    """Return the smallest distance round the circle between two angles, in rad."""
    ordered = np.sort(np.mod(angles, 2.0 * np.pi))
    return float(
        min([b - a for a, b in pairwise(ordered)] + [2 * np.pi + ordered[0] - ordered[-1]])
    )


def best_angles(
    n: int,
    kmax: int,
    *,
    fixed: FloatArray,
    min_separation: float,
    resolution: float,
    draws: FloatArray,
    criterion: Criterion,
    rng: np.random.Generator,
) -> tuple[FloatArray, int] | None:
    """Return the best angles found and the number of starts; None where nothing fits.

    The draws (n_draws, n) are errors of the angles over which the gain is averaged.
    """
    size = 360 * (2 if kmax <= 100 else 4)
    grid = 2.0 * np.pi * np.arange(size) / size
    table = np.exp(1j * np.outer(np.arange(kmax + 2), grid))
    n_free = n - fixed.size
    work = n_free * _SWEEPS * table.size
    starts = min(max(_FEWEST, int(_WORK / work)), _STARTS)
    thin = math.ceil(_FEWEST * work / _WORK)
    found: list[tuple[float, FloatArray]] = []
    if n * min_separation > 2.0 * np.pi + _TINY:
        return None
    for _ in range(starts):
        start = _random_start(n, fixed, grid, min_separation, rng)
        if start is None:
            return None
        found.append(_exchange(start, fixed.size, grid, table, min_separation, criterion, thin))
    found.sort(key=lambda item: item[0])

    def score(angles: FloatArray) -> float:
        rows = angles[:, np.newaxis] + draws.T if draws.size else angles[:, np.newaxis]
        gain = gain_table(rows, kmax)
        if criterion == "worst":
            return float(gain.max(axis=0).mean())
        return math.sqrt(float(np.mean(gain**2)))

    polished = [
        _descend(angles, fixed.size, score, resolution, grid[1], min_separation)
        for _, angles in _distinct(found)
    ]
    return min(polished, key=lambda item: item[0])[1], starts


def _gain(sums: ComplexArray, n: int) -> FloatArray:
    square = sums.real**2 + sums.imag**2
    product = sums[1:-2].conj() * sums[3:]
    second = sums[2]
    cross = 2.0 * (product.real * second.real + product.imag * second.imag)
    power = n * (square[1:-2] + square[3:])
    spread = n**2 - square[2]
    left = n - (power - cross) / np.maximum(spread, _TINY)
    left = np.where(spread > _COLLINEAR * n**2, left, 0.0)
    out: FloatArray = 1.0 / np.sqrt(np.maximum(left, _TINY))
    return out


def _random_start(
    n: int,
    fixed: FloatArray,
    grid: FloatArray,
    min_separation: float,
    rng: np.random.Generator,
) -> FloatArray | None:
    """Return angles drawn one by one where there is room left; None after some dead ends."""
    for attempt in range(50):
        angles = fixed.copy()
        while angles.size < n:
            room = grid[_allowed(grid, angles, min_separation)]
            if room.size == 0:
                break
            # later attempts pack tightly, which fits whenever anything does on a free circle
            pick = room[0] if attempt >= 40 else rng.choice(room)
            angles = np.append(angles, pick)
        if angles.size == n:
            return angles
    return None


def _allowed(grid: FloatArray, others: FloatArray, min_separation: float) -> NDArray[np.bool_]:
    distance = np.abs((grid[:, np.newaxis] - others + np.pi) % (2.0 * np.pi) - np.pi)
    out: NDArray[np.bool_] = np.all(distance >= min_separation - 1e-9, axis=1)
    return out


def _exchange(
    angles: FloatArray,
    n_fixed: int,
    grid: FloatArray,
    table: ComplexArray,
    min_separation: float,
    criterion: Criterion,
    thin: int,
) -> tuple[float, FloatArray]:
    """Move one probe after the other to the best place of the grid until none wants to move.

    Where the grid is dear, each probe tries every `thin`-th place only, from another first one.
    """
    n = angles.size
    m = np.arange(table.shape[0])
    best = math.inf
    for _ in range(_SWEEPS):
        before = best
        for i in range(n_fixed, n):
            others = np.delete(angles, i)
            places = np.flatnonzero(_allowed(grid, others, min_separation))
            if places.size > thin:
                places = places[i % thin :: thin]
            if places.size == 0:
                continue
            rest = np.exp(1j * np.outer(m, others)).sum(axis=1)
            scores = _scores(rest, table, places, n, criterion)
            j = int(np.argmin(scores))
            if scores[j] < best:
                best = float(scores[j])
                angles = angles.copy()
                angles[i] = grid[places[j]]
        if best >= before * (1.0 - 1e-6):
            break
    return best, angles


def _scores(
    rest: ComplexArray, table: ComplexArray, places: NDArray[np.intp], n: int, criterion: Criterion
) -> FloatArray:
    """Return the score with one more probe at each place, in blocks that stay in the cache."""
    width = max(1, _BLOCK // rest.size)
    out = np.empty(places.size)
    for i in range(0, places.size, width):
        some = slice(i, i + width)
        gain = _gain(rest[:, np.newaxis] + table[:, places[some]], n)
        if criterion == "worst":
            out[some] = gain.max(axis=0)
        else:
            out[some] = np.sqrt(np.mean(gain**2, axis=0))
    return out


def _distinct(found: list[tuple[float, FloatArray]]) -> list[tuple[float, FloatArray]]:
    out: list[tuple[float, FloatArray]] = []
    for value, angles in found:
        if all(abs(value - other) > 1e-6 for other, _ in out):
            out.append((value, angles))
        if len(out) == _FINALISTS:
            break
    return out


def _descend(
    angles: FloatArray,
    n_fixed: int,
    score: Callable[[FloatArray], float],
    resolution: float,
    coarse: float,
    min_separation: float,
) -> tuple[float, FloatArray]:
    """Move free probes by steps of `resolution` as long as the score falls."""
    best = score(angles)
    steps = max(1, round(coarse / resolution))
    while steps >= 1:
        moved = False
        for i in range(n_fixed, angles.size):
            for sign in (1.0, -1.0):
                trial = angles.copy()
                trial[i] += sign * steps * resolution
                if separations(trial) < min_separation - 1e-9:
                    continue
                value = score(trial)
                if value < best * (1.0 - 1e-9):
                    best, angles, moved = value, trial, True
        if not moved:
            steps //= 2
    return best, angles
