"""Private: from a start to the tool setting of the smallest residual, in damped steps.

The sums of `_setting_equations` are solved again and again. A step that does not make the residual
smaller is shortened along what the points show least (Levenberg and Marquardt), because there the
valley is curved: a shift of a smooth part is a tilt to the first order.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from metrosep.core.errors import DegenerateFitError, NotConvergedError, TooFewSamplesError
from metrosep.core.units import format_length
from metrosep.forms.base import Form
from metrosep.forms.points import Points
from metrosep.process._setting_equations import (
    FREEDOMS,
    Choice,
    Equations,
    Region,
    choose,
    equations,
    levelled,
    solve,
)
from metrosep.process._setting_model import FACTORS

_MOST_STEPS = 60
_MOST_DAMPINGS = 11
_SETTLED = ((15, 1e-3), (30, 1e-2), (60, 0.1))
"""Steps, and the share of its standard uncertainty that no freedom may still move by then.

A pixel that crosses the apex at the axis makes the valley rough, far below the uncertainty."""
_ROUNDING = 1e-16
"""m: steps below this are rounding of the heights."""
_FEW = 2e-3
_SINGLE = 4.0
"""Residual of a single point, in units of the RMS."""
_TILTED = {"shift_x": "tilt_x", "shift_y": "tilt_y"}
"""What a shift of a smooth part is to the first order."""
_CANCELLED = 1e-6
"""Share of a sum of squares below which its rounding shows: it is summed anew."""
_MOST_CHOICES = 5
_AROUND_CENTRE = 3.0
"""Radii below this many times hypot(dx, dy) are left out: the centre is cut twice or not at all."""


@dataclass(frozen=True, slots=True)
class Task:
    """What is fitted to what."""

    points: Points  # measured heights
    form: Form  # the nominal surface
    names: Sequence[str]  # freedoms wanted
    wanted: tuple[float, float]  # of (float, float), m: inner and outer radius that may be used
    noise: float | None  # m: stated standard deviation of one height
    extent: float  # m: largest distance from the axis


@dataclass(frozen=True, slots=True)
class Settled:
    """Where the steps ended."""

    values: Mapping[str, float]  # mapping of str to float: of all freedoms
    region: Region  # which points were used
    sums: Equations  # at the values
    choice: Choice  # freedoms that were solved for
    steps: int  # that it took


def settle(task: Task, start: Mapping[str, float]) -> Settled:
    """Return the least-squares values from a start; what the points do not determine stays there.

    Where the steps do not settle and a shift is less well known than the centre that is left out
    around the apex, that shift is held too.
    """
    found, said = _settled(task, start)
    if said is None:
        return found
    _, inverse = solve(found.sums, found.choice)
    u = dict(
        zip(found.choice.used, np.sqrt(np.diag(inverse) * found.sums.mean_square), strict=True)
    )
    apex = _AROUND_CENTRE * math.hypot(found.values["dx"], found.values["dy"])
    loose = [n for n in _TILTED if n in u and u[n] > apex]
    if not loose:
        raise NotConvergedError(said)
    names = [n for n in task.names if n not in loose]
    found, said = _settled(replace(task, names=names), start)
    if said is not None:
        raise NotConvergedError(said)
    held = {**found.choice.given_up, **{n: (_TILTED[n],) for n in loose}}
    return replace(found, choice=Choice(found.choice.used, held))


def _settled(task: Task, start: Mapping[str, float]) -> tuple[Settled, str | None]:
    """Return where the steps end, and what failed.

    What is determined depends on the values (an apex at the centre shows a shift), so the choice is
    made anew at each solution until it stays.
    """
    values = dict(start)
    region = outside(task.wanted, values)
    sums, choice = chosen(task, values, region)
    values, sums, steps, _ = _settle(task, values, region, choice, sums, n_settle=1)
    said: str | None = None
    failed = 0
    for _ in range(_MOST_CHOICES):
        region = outside(task.wanted, values)
        sums, choice = chosen(task, values, region)
        if any(values[n] != start[n] for n in choice.given_up):
            values |= {n: start[n] for n in choice.given_up}
            sums = equations(task.points, task.form, values, region)
        values, sums, more, said = _settle(
            task, values, region, choice, sums, n_settle=_MOST_STEPS
        )
        steps += more
        failed += said is not None
        if failed > 1:
            break
        again = choose(sums, task.names, noise=_level(task, sums, choice), extent=task.extent)
        grown = outside(task.wanted, values).inner > region.inner * (1.0 + 1e-3)
        if said is None and not grown and again.used == choice.used:
            break
    return Settled(values, region, sums, choice, steps), said


def chosen(task: Task, values: Mapping[str, float], region: Region) -> tuple[Equations, Choice]:
    """Return the sums and the freedoms they determine; refuse what determines no setting."""
    sums = equations(task.points, task.form, values, region)
    names, form = task.names, task.form
    if sums.n <= len(names) and region.inner > task.wanted[0]:
        raise NotConvergedError(
            f"the setting runs away to {_shown(values)}, where {sums.n} points of the map are left "
            "outside the centre that such a tool spoils: the map may be of another surface or "
            "mirrored; check form and centre, free less, or give start="
        )
    if sums.n <= len(names):
        raise TooFewSamplesError(
            f"{sums.n} measured points lie within rho = {format_length(region.inner)} ... "
            f"{format_length(region.outer) if math.isfinite(region.outer) else 'the rim'} and on the "
            f"{form.name}, and {len(names)} freedoms need more; check centre and region"
        )
    level = _level(task, sums, choose(sums, names, noise=0.0, extent=task.extent))
    choice = choose(sums, names, noise=level, extent=task.extent)
    wanted = [n for n in FACTORS if n in names]
    if wanted and not any(n in choice.used for n in wanted):
        raise DegenerateFitError(
            f"{', '.join(wanted)} leave no trace of their own on this {form.name} over the "
            "measured points: no tool setting can be found; measure a larger or steeper "
            "part, and check the unit of the heights"
        )
    return sums, choice


def outside(wanted: tuple[float, float], values: Mapping[str, float]) -> Region:
    """Return the region without the centre that is cut twice or not at all."""
    inner = _AROUND_CENTRE * math.hypot(values["dx"], values["dy"])
    return Region(max(wanted[0], inner), wanted[1], values["shift_x"], values["shift_y"])


def _level(task: Task, sums: Equations, choice: Choice) -> float:
    """Return the stated noise, or the RMS that a linear solution would leave, m."""
    if task.noise is not None:
        return task.noise
    step, _ = solve(sums, choice)
    left = sums.square - float(step @ sums.right[choice.rows])
    return math.sqrt(max(left, 0.0) / sums.n)


def _settle(
    task: Task,
    start: Mapping[str, float],
    region: Region,
    choice: Choice,
    sums: Equations,
    *,
    n_settle: int,
) -> tuple[dict[str, float], Equations, int, str | None]:
    """Return values and sums after at most `n_settle` damped steps, their number, and what failed."""
    values, damping = dict(start), 0.0
    for count in range(1, n_settle + 1):
        left = _left(sums, choice)
        last = left <= next(share for most, share in _SETTLED if count <= most)
        for _ in range(_MOST_DAMPINGS):
            step, _ = solve(sums, choice, damping=damping)
            tried = dict(values)
            for name, change in zip(choice.used, step.tolist(), strict=True):
                tried[name] += change
            tried, new = _tried(task, tried, region, choice)
            if new.n > len(choice.used) and new.mean_square <= _allowed(sums, new):
                break
            if last:
                return values, sums, count, None
            damping = max(10.0 * damping, 1e-8)
        else:
            if left <= _SETTLED[-1][1]:
                return values, sums, count, None
            return (
                values,
                sums,
                count,
                (
                    f"no step of the setting makes the residual of {format_length(math.sqrt(sums.mean_square))} "
                    f"RMS smaller, at {_shown(values)}: the map may be of another surface or mirrored; "
                    "check form and centre, or give start="
                ),
            )
        values, sums = tried, new
        damping = 0.1 * damping if damping > 1e-9 else 0.0
        if last:
            return values, sums, count, None
    return (
        values,
        sums,
        n_settle,
        (
            f"the setting still moves after {n_settle} steps (now {_shown(values)}): the map may be of "
            "another surface or mirrored; check form and centre, free less, or give start="
        ),
    )


def _allowed(sums: Equations, new: Equations) -> float:
    """Return the mean square that a step may leave, m^2.

    No more than before; where a few points came in from the uncut core or went there, no more than
    they can make of it, because nothing else compares sums over different points.
    """
    changed = abs(new.n - sums.n)
    few = changed if changed <= _FEW * sums.n else 0
    return sums.mean_square * (1.0 + 1e-12 + _SINGLE**2 * few / sums.n)


def _left(sums: Equations, choice: Choice) -> float:
    """Return how far the full step goes in standard uncertainties; 0 where it is rounding."""
    step, _ = solve(sums, choice)
    moved = math.sqrt(max(float(step @ sums.right[choice.rows]), 0.0))
    if moved <= _ROUNDING * math.sqrt(sums.n):
        return 0.0
    return moved / math.sqrt(sums.mean_square) if sums.mean_square > 0.0 else math.inf


def _tried(
    task: Task, values: dict[str, float], region: Region, choice: Choice
) -> tuple[dict[str, float], Equations]:
    """Return the values with the best piston and tilts, and the sums; none where no part is cut so.

    Levelling straightens the valley: a shift changes the piston by its square.
    """
    try:
        sums = equations(task.points, task.form, values, region)
        if sums.n <= len(choice.used):
            return values, sums
        left, change = levelled(sums, choice)
        values = {n: v + change.get(n, 0.0) for n, v in values.items()}
        if left.square < _CANCELLED * sums.square:
            left = equations(task.points, task.form, values, region)
    except NotConvergedError:
        size = len(FREEDOMS)
        return values, Equations(np.zeros((size, size)), np.zeros(size), math.inf, 0, 0)
    return values, left


def _shown(values: Mapping[str, float]) -> str:
    return ", ".join(f"{n} = {format_length(values[n])}" for n in ("dx", "dy", "dR"))
