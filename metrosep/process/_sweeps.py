"""Private: a log of voltage and displacement cut into sweeps on common voltages."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, DegenerateFitError, TooFewSamplesError, UnitError
from metrosep.core.recording import Recording

_TURN = 0.02
"""A turning point is a return by this share of the voltage range; less is noise."""

_WHOLE = 0.95
"""Share of the voltage range from which a sweep counts as whole."""

_NAMED = 4
"""Parts that a message names one by one."""

_LEVELS = 101
"""Voltages of the curves where the log has no levels of its own."""

_JUMP = 9.0
"""Times the usual step, about six standard deviations of noise: more is a jump to another level."""

_DRIFT = 0.1
"""Of all jumps: a log that moves by more of it between them is a ramp."""

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


def require_span(v: FloatArray) -> None:
    """Refuse a voltage that stays."""
    if not float(np.ptp(v)) > 0.0:
        raise DegenerateFitError(f"the voltage stays at {v[0]:.6g} V; sweep it up and down")


def dwells(v: FloatArray, d: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return one point for each stretch of equal voltage."""
    # only exact repeats are dwells: a slow ramp must not be taken for one
    start = np.concatenate([[0], np.flatnonzero(np.diff(v) != 0.0) + 1])
    size = np.diff(np.append(start, v.size))
    return v[start], np.asarray(np.add.reduceat(d, start) / size)


def levels(v: FloatArray, d: FloatArray) -> tuple[FloatArray, FloatArray, int]:
    """Return one point for each dwell of a noisy voltage, and how many samples lie between dwells.

    A log is stairs where it jumps, stays for at least three samples and hardly drifts between the
    jumps; everything else is returned as it is.
    """
    steps = np.abs(np.diff(v))
    least = max(_JUMP * float(np.median(steps)), _SAME * float(np.ptp(v)))
    edges = np.concatenate([[0], np.flatnonzero(steps > least) + 1, [v.size]])
    sizes = np.diff(edges)
    usual = float(np.median(np.repeat(sizes, sizes)))  # of the stretch that a sample lies in
    parts = [slice(a, b) for a, b in itertools.pairwise(edges) if b - a >= max(2.0, 0.25 * usual)]
    if len(parts) < 3 or usual < 3.0:
        return v, d, 0
    drift = sum(
        abs(
            float(
                v[(p.start + p.stop) // 2 : p.stop].mean()
                - v[p.start : (p.start + p.stop) // 2].mean()
            )
        )
        for p in parts
    )
    points = [(float(v[p].mean()), float(d[p].mean()), p.stop - p.start) for p in parts]
    if drift > _DRIFT * sum(abs(b[0] - a[0]) for a, b in itertools.pairwise(points)):
        return v, d, 0
    merged = points[:1]
    for level, place, size in points[1:]:
        before = merged[-1]
        if abs(level - before[0]) > least:
            merged.append((level, place, size))
            continue
        n = before[2] + size
        merged[-1] = (
            (before[0] * before[2] + level * size) / n, (before[1] * before[2] + place * size) / n, n
        )  # fmt: skip
    at, got, used = (np.array(column) for column in zip(*merged, strict=True))
    return at, got, int(v.size - used.sum())


@dataclass(frozen=True, slots=True)
class Sweeps:
    """Sweeps that are compared, each in the order of time, and what became of the others."""

    runs: list[tuple[FloatArray, FloatArray]]
    jumps: tuple[float, ...]
    left_out: int
    messages: tuple[str, ...]


def sweeps(v: FloatArray, d: FloatArray) -> Sweeps:
    """Return the sweeps of the whole range; halves of one are joined, other parts left out.

    Where a direction has no whole sweep its longest parts stand in, and the range is theirs.
    """
    whole = (float(v.min()), float(v.max()))
    span = whole[1] - whole[0]
    parts = [(v[p], d[p]) for p in _between_turns(v)]
    runs: list[tuple[int, tuple[FloatArray, FloatArray]]] = []
    messages: list[str] = []
    jumps: list[float] = []
    lost: list[str] = []
    for rising in (True, False):
        own = [(i, p) for i, p in enumerate(parts) if (p[0][-1] > p[0][0]) == rising]
        used = [(i, p) for i, p in own if float(np.ptp(p[0])) >= _WHOLE * span]
        halves = own and own[0][0] == 0 and own[-1][0] == len(parts) - 1 and len(own) > 1
        taken = {i for i, _ in used}
        if not used and halves and _cover(own[-1][1], own[0][1], span):
            joined, jump = _joined(own[-1][1], own[0][1])
            used, taken = [(own[0][0], joined)], {own[0][0], own[-1][0]}
            jumps.append(jump)
            messages.append(
                f"the first and the last half of the sweep {_way(rising)} are joined at "
                f"{own[0][1][0][0]:.4g} V, where they differ by {abs(jump) * 1e9:.3g} nm"
            )
        elif not used:
            used = [(i, p) for i, p in own if float(np.ptp(p[0])) > 0.5 * span]
            taken = {i for i, _ in used}
        lost += [f"{_way(rising)} {_ends(p[0])}" for i, p in own if i not in taken]
        runs += used
    if not runs:
        raise DegenerateFitError("no sweep covers half of the voltage range; sweep it whole")
    if lost:
        messages.append(
            f"{len(lost)} part{'s' * (len(lost) > 1)} of a sweep left out, the range is "
            f"{whole[0]:.4g} ... {whole[1]:.4g} V: {', '.join(lost[:_NAMED])}"
            + (" and more" if len(lost) > _NAMED else "")
        )
    runs.sort(key=lambda item: item[0])
    return Sweeps([r for _, r in runs], tuple(jumps), len(lost), tuple(messages))


def _way(rising: bool) -> str:
    return "up" if rising else "down"


def _ends(v: FloatArray) -> str:
    return f"{v[0]:.4g} ... {v[-1]:.4g} V"


def _between_turns(v: FloatArray) -> list[slice]:
    """Return the stretches between turning points; a turning point belongs to both."""
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
    return [slice(a, b + 1) for a, b in itertools.pairwise(turns) if b > a]


Run = tuple[FloatArray, FloatArray]


def _cover(last: Run, first: Run, span: float) -> bool:
    """Return whether the last part of a log goes on to where the first began, and all is swept."""
    both = np.concatenate([last[0], first[0]])
    way = 1.0 if first[0][-1] > first[0][0] else -1.0
    gap = way * float(first[0][0] - last[0][-1])
    return float(np.ptp(both)) >= _WHOLE * span and gap <= (1.0 - _WHOLE) * span


def _joined(last: Run, first: Run) -> tuple[Run, float]:
    """Return the two parts of a sweep as one, and by how much the first lies above the last."""
    way = 1.0 if first[0][-1] > first[0][0] else -1.0
    start = float(first[0][0])
    order = np.argsort(last[0], kind="stable")
    below = float(np.interp(start, last[0][order], last[1][order]))
    missing = way * (start - float(last[0][-1]))
    if missing > 0.0:
        slope = float(first[1][-1] - first[1][0]) / float(first[0][-1] - first[0][0])
        below += slope * way * missing
    before = way * (last[0] - start) < 0.0
    run = tuple(np.concatenate([a[before], b]) for a, b in zip(last, first, strict=True))
    return (run[0], run[1]), float(first[1][0]) - below


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
    if shared and first.size <= _LEVELS:
        grid = np.mean([v for v, _ in ordered], axis=0)
    else:
        grid = np.linspace(low, high, _LEVELS)
    return grid, np.array([_resampled(v, d, grid) for v, d in ordered])


def _rising(v: FloatArray, d: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a sweep ordered by voltage, equal voltages averaged."""
    levels, at = np.unique(v, return_inverse=True)
    return levels, np.asarray(np.bincount(at, weights=d) / np.bincount(at))


def _resampled(v: FloatArray, d: FloatArray, grid: FloatArray) -> FloatArray:
    """Return a curve on the grid; of a fine ramp the local line through what lies around."""
    if v.size < 4 * grid.size:
        return _between(grid, v, d)
    half = 0.5 * float(grid[1] - grid[0])
    cells = [slice(*np.searchsorted(v, [g - half, g + half])) for g in grid]
    filled = [c for c in cells if c.stop > c.start]
    # voltages that crowd on a spot of a cell tell no slope: straight lines between their means
    means = (np.array([x[c].mean() for c in filled]) for x in (v, d))
    result = _between(grid, *means)
    for i, (g, near) in enumerate(zip(grid, cells, strict=True)):
        if near.stop - near.start >= 3 and float(v[near.stop - 1] - v[near.start]) > half:
            result[i] = np.polynomial.polynomial.polyfit(v[near] - g, d[near], 1)[0]
    return result


def _between(at: FloatArray, v: FloatArray, d: FloatArray) -> FloatArray:
    """Return a curve by straight lines; the first and the last one go on where a level is missed."""
    result = np.interp(at, v, d)
    for out, i, j in ((at < v[0], 0, 1), (at > v[-1], -1, -2)):
        if out.any() and v.size > 1:
            slope = float(d[i] - d[j]) / float(v[i] - v[j])
            result[out] = d[i] + slope * (at[out] - v[i])
    return np.asarray(result)


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
