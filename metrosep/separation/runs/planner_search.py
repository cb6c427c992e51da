"""Search for the feeds that make the worst-known wavelength as well known as possible.

Maximise ``min_k sum_r J_k(v_r)``, J_k divided by the weight of its wave. The relaxed problem (shares of candidates instead of whole runs)
is a linear programme; its value bounds every plan from above. Whole runs come from rounding it,
from a greedy start and from an even spread, each improved by exchanging one run at a time and then
by moving feeds between the candidates. No random numbers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray

__all__ = ["Limits", "best_feeds", "information_bound"]

Information = Callable[[FloatArray], FloatArray]

_CANDIDATES = 181
_SWEEPS = 60
_FINE = 15
_GAIN = 1e-9
"""Smallest relative gain that counts as one."""


@dataclass(frozen=True, slots=True)
class Limits:
    """What a plan must keep."""

    v_min: float  # m/s: speeds
    v_max: float
    ratio: float  # > 1: two feeds are either equal or at least this ratio apart
    length: float  # m: travel of a run, for its duration
    max_time: float  # s: of all new runs together; infinity if free

    def allowed(self, feeds: FloatArray, fixed: FloatArray) -> bool:
        """Return whether a list of new feeds keeps every limit."""
        if float(np.sum(self.length / feeds)) > self.max_time * (1.0 + 1e-12):
            return False
        every = np.concatenate([feeds, fixed])
        distinct = np.unique(every)
        if distinct.size < 2 or distinct[-1] < distinct[0] * self.ratio * (1.0 - 1e-12):
            return False
        gaps = distinct[1:] / distinct[:-1]
        close = gaps < self.ratio * (1.0 - 1e-12)
        new = np.isin(distinct, feeds)
        return not bool((close & (new[1:] | new[:-1])).any())

    def candidates(self) -> FloatArray:
        """Return feeds on a logarithmic grid, both limits included."""
        grid: FloatArray = np.geomspace(self.v_min, self.v_max, _CANDIDATES)
        grid[0], grid[-1] = self.v_min, self.v_max
        return grid


def information_bound(
    table: FloatArray, feeds: FloatArray, fixed: FloatArray, n_runs: int, limits: Limits
) -> tuple[float, FloatArray]:
    """Return the largest information any plan can have on its worst wavelength, and its shares."""
    from scipy.optimize import linprog

    scale = float(np.median(table[table > 0.0])) if (table > 0.0).any() else 1.0
    size, k = table.shape
    upper = np.hstack([-table.T / scale, np.ones((k, 1))])
    right = fixed / scale
    if np.isfinite(limits.max_time):
        row = np.append(limits.length / feeds / limits.max_time, 0.0)
        upper, right = np.vstack([upper, row]), np.append(right, 1.0)
    cost = np.zeros(size + 1)
    cost[-1] = -1.0
    equal = np.append(np.ones(size), 0.0)[np.newaxis]
    done = linprog(cost, upper, right, equal, [float(n_runs)], bounds=(0.0, None), method="highs")
    if done.x is None:
        return float("nan"), np.full(size, n_runs / size)
    return float(done.x[-1] * scale), np.asarray(done.x[:-1])


def best_feeds(
    information: Information, n_runs: int, limits: Limits, fixed: FloatArray
) -> tuple[FloatArray, float]:
    """Return the feeds of the best plan found and the bound on every plan."""
    candidates = limits.candidates()
    table = information(candidates)
    done = information(fixed).sum(axis=0) if fixed.size else np.zeros(table.shape[1])
    bound, shares = information_bound(table, candidates, done, n_runs, limits)
    best: tuple[float, FloatArray] = (-np.inf, np.empty(0))
    for start in _starts(table, candidates, shares, done, n_runs, limits, fixed):
        if not limits.allowed(start, fixed):
            continue
        feeds = _exchanged(start, candidates, table, information, done, limits, fixed)
        feeds = _refined(feeds, information, done, limits, fixed, candidates[1] / candidates[0])
        score = _score(information(feeds).sum(axis=0) + done)
        if score > best[0] * (1.0 + _GAIN) or not best[1].size:
            best = (score, np.sort(feeds))
    return best[1], bound


def _score(total: FloatArray) -> float:
    """Smallest information; a little of the mean lets a plan climb out of equal minima."""
    low = float(total.min())
    return low + 1e-6 * float(total.mean())


def _starts(
    table: FloatArray,
    candidates: FloatArray,
    shares: FloatArray,
    done: FloatArray,
    n_runs: int,
    limits: Limits,
    fixed: FloatArray,
) -> list[FloatArray]:
    quantiles = (np.arange(n_runs) + 0.5) * (shares.sum() / n_runs)
    rounded = candidates[
        np.minimum(np.searchsorted(np.cumsum(shares), quantiles), candidates.size - 1)
    ]
    greedy: list[float] = []
    total = done.copy()
    for _ in range(n_runs):
        pick = int(np.argmax([_score(total + row) for row in table]))
        greedy.append(float(candidates[pick]))
        total = total + table[pick]
    starts = [_spaced(f, limits, fixed) for f in (rounded, np.sort(greedy))]
    room = int(np.floor(np.log(limits.v_max / limits.v_min) / np.log(limits.ratio) + 1e-9)) + 1
    most = min(room, n_runs)
    for groups in sorted({*range(1, min(most, 5) + 1), most}):  # equal ratios, the finest too
        ladder = np.geomspace(limits.v_min, limits.v_max, groups) if groups > 1 else [limits.v_max]
        starts.append(np.sort(np.resize(ladder, n_runs)))
    fastest = limits.v_max * np.ones(n_runs)
    slower = fastest.copy()
    slower[0] = limits.v_max / limits.ratio
    return [*starts, slower, fastest]


def _spaced(feeds: FloatArray, limits: Limits, fixed: FloatArray) -> FloatArray:
    """Pull feeds that are too close to each other together; part them if all have become one."""
    out = np.sort(feeds).copy()
    anchor = out[0]
    for i, v in enumerate(out):
        if v < anchor * limits.ratio:
            out[i] = anchor
        else:
            anchor = v
    if np.unique(np.concatenate([out, fixed])).size < 2:
        out[-1] = (
            out[-1] * limits.ratio
            if out[-1] * limits.ratio <= limits.v_max
            else out[-1] / limits.ratio
        )
    return np.clip(out, limits.v_min, limits.v_max)


def _exchanged(
    feeds: FloatArray,
    candidates: FloatArray,
    table: FloatArray,
    information: Information,
    done: FloatArray,
    limits: Limits,
    fixed: FloatArray,
) -> FloatArray:
    """Replace one run at a time, or all runs of one feed, by the candidate that gains most."""
    feeds = feeds.copy()
    rows = information(feeds)
    for _ in range(_SWEEPS):
        before = _score(rows.sum(axis=0) + done)
        for moved in _moves(feeds):
            rest = rows.sum(axis=0) - rows[moved].sum(axis=0) + done
            total = rest + moved.sum() * table
            scores = total.min(axis=1) + 1e-6 * total.mean(axis=1)
            current = _score(rows.sum(axis=0) + done)
            for pick in np.argsort(-scores, kind="stable"):
                if scores[pick] <= current * (1.0 + _GAIN):
                    break
                trial = np.where(moved, candidates[pick], feeds)
                if limits.allowed(trial, fixed):
                    feeds, rows = trial, np.where(moved[:, np.newaxis], table[pick], rows)
                    break
        if _score(rows.sum(axis=0) + done) <= before * (1.0 + _GAIN):
            break
    return feeds


def _moves(feeds: FloatArray) -> list[NDArray[np.bool_]]:
    """One run of each distinct feed, and all runs of each distinct feed."""
    moves: list[NDArray[np.bool_]] = []
    for v in np.unique(feeds):
        group = feeds == v
        one = np.zeros_like(group)
        one[int(np.flatnonzero(group)[0])] = True
        moves += [one] if group.sum() == 1 else [one, group]
    return moves


def _refined(
    feeds: FloatArray,
    information: Information,
    done: FloatArray,
    limits: Limits,
    fixed: FloatArray,
    reach: float,
) -> FloatArray:
    """Move each distinct feed between its neighbouring candidates, three times finer each."""
    width = np.log(reach)
    for _ in range(4):
        for v in np.unique(feeds):
            group = feeds == v
            rest = information(feeds[~group]).sum(axis=0) + done if (~group).any() else done
            fine = np.clip(
                v * np.exp(np.linspace(-width, width, _FINE)), limits.v_min, limits.v_max
            )
            total = rest + group.sum() * information(fine)
            scores = total.min(axis=1) + 1e-6 * total.mean(axis=1)
            current = _score(information(feeds).sum(axis=0) + done)
            for pick in np.argsort(-scores, kind="stable"):
                if scores[pick] <= current * (1.0 + _GAIN):
                    break
                trial = np.where(group, fine[pick], feeds)
                if limits.allowed(trial, fixed):
                    feeds = trial
                    break
        width /= 4.0
    return feeds
