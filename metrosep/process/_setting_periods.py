"""Private: whether the map belongs to another period of the form than the first fit took.

A periodic form one period on is the same form, but the setting shows where the spindle axis is. The
first fit goes to the nearest period; its neighbours are tried by their linear solution on a sample,
and by a whole fit where they promise more or another setting.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import MetrosepError, NotConvergedError
from metrosep.core.units import format_length
from metrosep.forms.points import Points
from metrosep.process._setting_equations import (
    FACTORS,
    Settled,
    Task,
    chosen,
    equations,
    modelled,
    neighbours_of_scattered,
    outside,
    settle,
    solve,
)

_SAMPLE = 4000
_PARTS = 4
"""Of a period, in the coarse grid of shifts."""
_FORM_LEFT = 0.3
"""Correlation of the residuals of neighbours in the sample, where noise leaves none."""
_FARTHEST = 4
"""Periods tried to each side where the nearest do not explain the map."""
_MOST_MOVES = 4
_SURE = 9.0
"""Of chi-square: a period that fits worse by less cannot be told from the best."""
_OTHER = 2.0
"""Standard uncertainties by which a setting is another one."""


@dataclass(frozen=True, slots=True)
class Guess:
    """What a neighbouring period promises from its linear solution on the sample."""

    shifted: Mapping[str, float]  # mapping of str to float: the shifts to start from
    square: float  # m^2: mean squared residual it would leave
    setting: FloatArray  # shape (3,), m: the setting it would give


def settle_in_period(task: Task, start: Mapping[str, float]) -> tuple[Settled, tuple[str, ...]]:
    """Return the fit in the period that explains the map best, and what stays doubtful."""
    found, failed = None, None
    try:
        found = settle(task, start)
    except NotConvergedError as error:
        failed = error
    if found is None or _is_unexplained(task, found):
        shifted = _coarse_start(task, start)
        if found is None and shifted is None and failed is not None:
            raise failed
        found = _better(task, found, shifted)
    return _in_best_period(task, found)


def _better(task: Task, found: Settled | None, shifted: Mapping[str, float] | None) -> Settled:
    """Return the better of a fit and that from another start."""
    if found is None:
        return settle(task, shifted or {})
    try:
        other = settle(task, shifted or found.values)
    except MetrosepError:
        return found
    return min(found, other, key=_left_over)


def _is_unexplained(task: Task, found: Settled) -> bool:
    """Return whether form is left in the residual of a periodic form, as a wrong phase leaves."""
    if task.form.period is None or not {"shift_x", "shift_y"} & set(task.names):
        return False
    x, y, z = task.points.sample(_SAMPLE)
    inside = found.region.holds(x, y)
    off = z[inside] - modelled(task.form, x[inside], y[inside], found.values)[0]
    return neighbours_of_scattered(x[inside], y[inside], off) > _FORM_LEFT


def _coarse_start(task: Task, start: Mapping[str, float]) -> dict[str, float] | None:
    """Return the start with the shift of a coarse grid over one period that promises most."""
    names = [n for n in ("shift_x", "shift_y") if n in task.names]
    if task.form.period is None or not names:
        return None
    few = _thinned(task)
    best: tuple[float, dict[str, float] | None] = (math.inf, None)
    shares = np.arange(-_PARTS // 2 + 1, _PARTS // 2 + 1) / _PARTS
    for i, j in itertools.product(shares, shares):
        moved = {"shift_x": i * task.form.period[0], "shift_y": j * task.form.period[1]}
        if any(v and n not in names for n, v in moved.items()):
            continue
        values = {n: v + moved.get(n, 0.0) for n, v in start.items()}
        try:
            sums, choice = chosen(few, values, outside(few.wanted, values))
        except MetrosepError:
            continue
        step, _ = solve(sums, choice)
        left = (sums.square - float(step @ sums.right[choice.rows])) / sums.n
        if left < best[0]:
            best = left, values
    return best[1]


def _thinned(task: Task) -> Task:
    x, y, z = task.points.sample(_SAMPLE)
    points = Points(x, y, z[None, :], task.points.centre, is_scattered=True)
    return replace(task, points=points)


def _in_best_period(task: Task, found: Settled) -> tuple[Settled, tuple[str, ...]]:
    """Return the best of a fit and those one or more periods on, and what stays doubtful."""
    free = [n for n in ("shift_x", "shift_y") if n in found.choice.used]
    if task.form.period is None or not free:
        return found, ()
    few = _thinned(task)
    first = found
    rivals: list[Settled] = []
    for _ in range(_MOST_MOVES):
        far = _FARTHEST if _is_unexplained(task, found) else 1
        guesses = _worth_trying(few, found, free, far)
        tried = (_fitted(task, found, guess) for guess in guesses)
        ranked = sorted([found, *(t for t in tried if t is not None)], key=_left_over)
        rivals = ranked[1:]
        if ranked[0] is found:
            break
        found = ranked[0]
    said = []
    if found is not first:
        said.append(
            f"another period of the {task.form.name} than the nearest explains the map: the part "
            f"is taken to be shifted by {_shift(found)} instead of {_shift(first)}"
        )
    said.extend(_doubt(task, found, rival) for rival in rivals if _rivals(found, rival))
    return found, tuple(said)


def _left_over(found: Settled) -> float:
    return found.sums.mean_square


def _worth_trying(few: Task, found: Settled, free: Sequence[str], far: int) -> list[Guess]:
    """Return the neighbours that may fit better, or as well with another setting, best first."""
    here = _guess(few, found, found.values)
    if here is None:
        return []
    u = _u(found)
    worth = []
    for shifted in _neighbours(few, found, free, far):
        there = _guess(few, found, shifted)
        if there is None:
            continue
        worse = few.points.z.size * (there.square / here.square - 1.0) if here.square else math.inf
        other = bool((np.abs(there.setting - here.setting) > _OTHER * u).any())
        if worse < -_SURE or (worse < _SURE and other):
            worth.append(there)
    return sorted(worth, key=lambda guess: guess.square)[:3]


def _neighbours(
    few: Task, found: Settled, free: Sequence[str], far: int
) -> Iterator[dict[str, float]]:
    """Yield the values some periods on, as far as the map reaches."""
    assert few.form.period is not None  # noqa: S101 - asked before
    period = dict(zip(("shift_x", "shift_y"), few.form.period, strict=True))
    steps = {}
    for name, length in period.items():
        most = min(far, max(1, math.ceil(few.extent / length))) if name in free else 0
        steps[name] = range(-most, most + 1)
    for i in steps["shift_x"]:
        for j in steps["shift_y"]:
            if i or j:
                moved = {"shift_x": i * period["shift_x"], "shift_y": j * period["shift_y"]}
                yield {n: v + moved.get(n, 0.0) for n, v in found.values.items()}


def _guess(few: Task, found: Settled, values: Mapping[str, float]) -> Guess | None:
    """Return what the linear solution from some values leaves; None where it has none."""
    try:
        sums = equations(few.points, few.form, values, outside(few.wanted, values))
        if sums.n <= 2 * len(found.choice.used):
            return None
        step, _ = solve(sums, found.choice)
    except (MetrosepError, np.linalg.LinAlgError):
        return None
    left = max(sums.square - float(step @ sums.right[found.choice.rows]), 0.0)
    moved = dict(zip(found.choice.used, step.tolist(), strict=True))
    setting = np.array([values[n] + moved.get(n, 0.0) for n in FACTORS])
    return Guess(values, left / sums.n, setting)


def _fitted(task: Task, found: Settled, guess: Guess) -> Settled | None:
    """Return the whole fit from a guess; None where it fails or gives up what was free."""
    try:
        there = settle(task, guess.shifted)
    except MetrosepError:
        return None
    return there if set(found.choice.used) <= set(there.choice.used) else None


def _u(found: Settled) -> FloatArray:
    """Return the standard uncertainties of the three factors; infinite where not determined."""
    _, inverse = solve(found.sums, found.choice)
    u = np.sqrt(np.diag(inverse) * found.sums.mean_square)
    known = dict(zip(found.choice.used, u.tolist(), strict=True))
    return np.array([known.get(n, math.inf) for n in FACTORS])


def _rivals(found: Settled, rival: Settled) -> bool:
    """Return whether another period fits as well and gives another setting."""
    worse = found.sums.n * (rival.sums.mean_square / found.sums.mean_square - 1.0)
    gap = np.array([rival.values[n] - found.values[n] for n in FACTORS])
    return worse < _SURE and bool((np.abs(gap) > _OTHER * _u(found)).any())


def _doubt(task: Task, found: Settled, rival: Settled) -> str:
    given = ", ".join(f"{n} = {format_length(rival.values[n])}" for n in FACTORS)
    return (
        f"another period of the {task.form.name} fits as well: a part shifted by {_shift(rival)} "
        f"instead of {_shift(found)} gives {given}; measure where the spindle axis is on the map"
    )


def _shift(found: Settled) -> str:
    parts = (format_length(found.values[n]) for n in ("shift_x", "shift_y"))
    return f"({', '.join(parts)})"
