"""Private to separation: from the shifts of runs, which run, feedrate or delay they are of.

A delay of the reading shifts every run by velocity times delay, so that line is taken out of the
shifts before a run, or all runs of a feedrate, are called displaced.

Source: the project's notes on separation, section 4.4.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.runset import SAME_FEED
from metrosep.core.units import format_length
from metrosep.separation.runs.sensor import LAG_PRIOR

DISPLACED = "is displaced by"
"""How a finding of a displaced run begins."""

SURE = 5.0
"""Standard uncertainties beyond which gain, shift or delay differ from those of the other runs."""

_RARE = 1e-5
"""Chance by which scatter like that of the other runs would take a run so far off."""

_TRUSTED = 4.0
"""Runs' worth of trust that u is right, beside the scatter of the runs."""

_TRIMMED, _TRIM_GROWS = 5, 1.5
"""Of so many others the one farthest off is left out; the sum of squares without it grows by this."""


@dataclass(slots=True)
class Displaced:
    """What shifts say; runs by their place in the list of shifts."""

    runs: dict[int, str] = field(default_factory=dict)  # what to say of each displaced run
    feeds: dict[str, list[int]] = field(default_factory=dict)  # sentence: runs of that feedrate
    lag: tuple[float, float] | None = None  # s: delay and its u


@dataclass(slots=True)
class _Feed:
    """One feedrate as the displaced one."""

    own: NDArray[np.bool_]
    line: tuple[float, float]  # place and delay of the others
    cost: float
    away: float
    u: float
    needed: float


def needed(u: float, others: FloatArray) -> float:
    """Return how far a run must be off, given its u and how far others are, in units of their u.

    At least 5 u. Where the others scatter more than their u says (lines of a vibration, slow
    noise), u is not a measure, and Student's distribution of their scatter is taken.
    """
    from scipy.stats import t

    size = np.sort(np.abs(others))
    kept = size[:-1] if size.size >= _TRIMMED else size  # a second bad run hides none
    freedom = _TRUSTED + max(kept.size - 1, 0)
    grows = _TRIM_GROWS if kept.size < size.size else 1.0
    scatter = math.sqrt((_TRUSTED + float(kept @ kept) * grows) / freedom)
    return u * max(SURE, float(t.isf(_RARE, freedom)) * scatter)


def scatter_of(mates: FloatArray) -> float:
    """Return by how much runs of one feedrate are off, RMS.

    A vibration at a wavelength of the error moves all of them, and no u of a single run holds it.
    """
    return math.sqrt(float(np.mean(mates**2))) if mates.size > 1 else 0.0


def find_displaced(
    velocity: FloatArray, shift: FloatArray, *, least: float, finest: float
) -> Displaced:
    """Return displaced runs, displaced feedrates and the delay.

    `velocity` in m/s is zero for runs without time; the columns of `shift` are, in m: shift, its u,
    and the u of what the run is compared with, the same for all runs of a feedrate. `least` is a
    shift that matters, `finest` what the positions resolve.
    """
    v, d = velocity, shift[:, 0]
    own_u, shared_u = np.hypot(shift[:, 1], finest), shift[:, 2]
    u = np.hypot(own_u, shared_u)
    order = np.sort(np.abs(v))
    edges = order[:-1][np.diff(order) > SAME_FEED * order[1:]] * (1.0 + 0.5 * SAME_FEED)
    feed_of = np.searchsorted(edges, np.abs(v))
    n_feeds = int(feed_of.max()) + 1
    found = Displaced()
    told = np.ones(v.size, dtype=bool)
    line, lowest = _shift_line(v, d, u, told, n_feeds > 1)
    if n_feeds >= 3:
        feeds = [_feed(v, d, own_u, shared_u, feed_of == f) for f in range(n_feeds)]
        best = min((f for f in feeds if f.own.sum() > 1), key=lambda f: f.cost, default=None)
        if (
            best is not None
            and best.cost < lowest - SURE**2
            and abs(best.away) > max(best.needed, least)
        ):
            line, told = best.line, ~best.own
            speed = float(v[best.own].mean())
            sd = math.hypot(best.u, _u_line(v, u, told, speed))
            sentence = (
                f"the runs at {abs(speed) * 6e4:.6g} mm/min are displaced by "
                f"{format_length(best.away)} (u {format_length(sd, digits=2)}) against those of the "
                "other feedrates: check where they start; the error is blurred by it and the "
                "uncertainty does not hold"
            )
            found.feeds = {sentence: np.flatnonzero(best.own).tolist()}
    rest = d - _line_at(line, v)
    places = np.arange(v.size)
    for j in np.flatnonzero(told) if v.size > 2 or n_feeds == 1 else ():
        others = told & (places != j)
        own = max(float(u[j]), scatter_of(rest[others & (feed_of == feed_of[j])]))
        if abs(rest[j]) <= max(needed(own, (rest / u)[others]), least):
            continue
        sd = math.hypot(u[j], _u_line(v, u, others, v[j])) if n_feeds > 1 else float(u[j])
        found.runs[int(j)] = (
            f"{DISPLACED} {format_length(float(rest[j]))} (u {format_length(sd, digits=2)}) against "
        )
    if v.size == 2:  # nothing says which of two is right: the second is named
        found.runs = dict(list(found.runs.items())[-1:])
    kept = told.copy()
    kept[list(found.runs)] = False
    groups = [kept & (feed_of == f) for f in range(n_feeds) if (kept & (feed_of == f)).any()]
    if len(groups) > 1:
        sd = _scatter_within(d, groups)
        group_u = [
            max(_u_together(own_u[g], shared_u[g]), sd / math.sqrt(int(g.sum()))) for g in groups
        ]
        found.lag = _delay(v, d, u, groups, group_u)
    return found


def _scatter_within(d: FloatArray, groups: list[NDArray[np.bool_]]) -> float:
    """Return the sd of shifts within their groups, pooled: runs that lie apart have it in their means."""
    freedom = sum(int(g.sum()) - 1 for g in groups)
    squares = sum(float(np.square(d[g] - d[g].mean()).sum()) for g in groups)
    return math.sqrt(squares / freedom) if freedom else 0.0


def _feed(
    v: FloatArray, d: FloatArray, own_u: FloatArray, shared_u: FloatArray, own: NDArray[np.bool_]
) -> _Feed:
    """Return what the shifts are if one feedrate is displaced."""
    u = np.hypot(own_u, shared_u)
    line, cost = _shift_line(v, d, u, ~own, True)
    rest = d - _line_at(line, v)
    away = float(np.median(rest[own]))
    cost += float(np.minimum(((rest - away)[own] / u[own]) ** 2, SURE**2).sum())
    sd = _u_together(own_u[own], shared_u[own])
    if own.sum() > 1:  # runs that start elsewhere together do not scatter
        sd = max(sd, float(np.std(d[own], ddof=1)) / math.sqrt(int(own.sum())))
    return _Feed(own, line, cost, away, sd, needed(sd, (rest - np.where(own, away, 0.0)) / u))


def _delay(
    v: FloatArray,
    d: FloatArray,
    u: FloatArray,
    groups: list[NDArray[np.bool_]],
    group_u: list[float],
) -> tuple[float, float] | None:
    """Return the delay that the feedrates show beyond chance, and its u."""
    weight = np.array(group_u) ** -2
    place = np.array([np.average(d[g], weights=u[g] ** -2) for g in groups])
    speed = np.array([v[g].mean() for g in groups])
    speed = speed - weight @ speed / weight.sum()
    information = float(weight @ speed**2)
    lag = float(weight @ (speed * place) / information)
    left = place - lag * speed
    left = (left - weight @ left / weight.sum()) * np.sqrt(weight)
    u_lag = information**-0.5 * max(1.0, math.sqrt(float(left @ left) / max(len(groups) - 2, 1)))
    return (lag, u_lag) if abs(lag) > SURE * u_lag else None


def _u_together(own: FloatArray, shared: FloatArray) -> float:
    """Return the u of a mean of shifts whose reference is the same."""
    return math.hypot(float((own**-2).sum()) ** -0.5, float(shared.mean()))


def _u_line(v: FloatArray, u: FloatArray, chosen: NDArray[np.bool_], at: float) -> float:
    """Return the u of the shift that the chosen runs, and what delays are likely, give a velocity."""
    if not chosen.any():
        return 0.0
    columns = np.column_stack([np.ones(v.size), v])[chosen] / u[chosen, None]
    information = columns.T @ columns + np.diag([0.0, LAG_PRIOR**-2])
    here = np.array([1.0, at])
    return math.sqrt(float(here @ np.linalg.solve(information, here)))


def _line_at(line: tuple[float, float], v: FloatArray) -> FloatArray:
    """Return the shifts of a delay at velocities."""
    return np.asarray(line[0] + line[1] * v)


def _shift_line(
    v: FloatArray, d: FloatArray, u: FloatArray, chosen: NDArray[np.bool_], several: bool
) -> tuple[tuple[float, float], float]:
    """Return place and delay that fit most of the chosen shifts, and the cost of what is left."""
    columns = np.column_stack([np.ones(v.size), v])[:, : 2 if several else 1]
    weight = np.where(chosen, 1.0 / u, 0.0)
    fit = np.full(columns.shape[1], np.nan)
    for _ in range(50):  # least absolute residuals: a displaced run does not pull the line
        root, before = np.sqrt(weight), fit
        fit = np.linalg.lstsq(columns * root[:, None], d * root, rcond=None)[0]
        if np.array_equal(fit, before):  # and so would all later ones be
            break
        weight = np.where(chosen, 1.0 / u / np.maximum(np.abs(d - columns @ fit) / u, 0.3), 0.0)
    # Of three single runs any two lie on a line: no delay at all may be the likelier one.
    found = []
    for line in ((float(fit[0]), float(fit[1]) if several else 0.0), _level(d[chosen], u[chosen])):
        rest = ((d - _line_at(line, v)) / u)[chosen]
        cost = float(np.minimum(rest**2, SURE**2).sum())
        # A long delay is possible, a short one likelier: it tells a displaced feed from a delay.
        cost += 2.0 * math.log1p((line[1] / LAG_PRIOR) ** 2)
        found.append((cost, line))
    cost, line = min(found)
    return line, cost


def _level(d: FloatArray, u: FloatArray) -> tuple[float, float]:
    """Return the place of most shifts, the delay being none."""
    costs = np.minimum(((d[:, None] - d) / u[:, None]) ** 2, SURE**2).sum(axis=0)
    first = float(d[int(np.argmin(costs))])
    near = np.abs(d - first) < SURE * u
    return float(np.average(d[near], weights=u[near] ** -2)), 0.0
