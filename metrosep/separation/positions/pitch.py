"""Errors of an axis along itself for a pitch table: slope kept, zero at the reference, held at 20 degC."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray, is_turn_apart
from metrosep.core.errors import DataError
from metrosep.core.numbers import choice, quantity
from metrosep.core.provenance import Step
from metrosep.core.runset import Run, RunSet
from metrosep.separation.positions.expansion import Expansion

REFERENCE_DIRECTIONS = {"forward": (1,), "reverse": (-1,), "middle": (1, -1)}
"""How an axis is homed, and the directions whose mean is zero there."""
_SAME_PLACE = 1e-9
"""Of the range of the targets: a reference so near to one is that one."""
_SAME_STEP = 1e-3
"""Of a step: targets so equally far apart hide what repeats with them."""
EQUAL_STEPS = (
    "the targets stand at equal steps: an error that repeats with them, such as that of a screw of this "
    "pitch, is not seen; add a random part to each target"
)
_BY_CHANCE = 1e-3
"""Share of sound lists whose two ends of a turn are taken for two places."""
_SPLIT = 2.0
"""Lost motion goes into the table if it exceeds so many standard uncertainties of its mean."""


@dataclass(frozen=True, repr=False)
class PitchErrors:
    """Errors of an axis at its targets, zero at the reference; frozen, SI.

    Parameters
    ----------
    positions : ndarray, shape (m,), m or rad
        Targets, rising.
    forward, reverse : ndarray or None, shape (m,), m or rad
        Mean error actual - nominal of each direction; one zero for both.
    reference : float, m or rad
        Where the error of the reference direction is zero.
    zero_removed : float, m or rad
        What was taken off both directions for that.
    reference_direction : {"forward", "reverse", "middle"}
        Direction in which the reference is reached.
    heat : Expansion
        Temperatures and coefficients that were stated; what they explain is not in the errors.
    u_forward, u_reverse : ndarray or None, shape (m,), m or rad
        Standard uncertainty, from the cycles, of the mean of a direction minus that of the
        reference; None of one cycle.
    lost_motion, u_lost_motion : float or None, m or rad
        Mean of forward - reverse over the targets, and its standard uncertainty from the cycles;
        None in one direction, or of one cycle.
    messages : tuple of str
        What was assumed, and what is not known.
    history : tuple of Step
        From the file on.
    is_closed : bool
        Whether first and last target are one place, a turn apart, with the mean of their readings.
    """

    positions: FloatArray
    forward: FloatArray | None
    reverse: FloatArray | None
    reference: float
    zero_removed: float
    reference_direction: str = "forward"
    heat: Expansion = field(default_factory=Expansion)
    u_forward: FloatArray | None = None
    u_reverse: FloatArray | None = None
    lost_motion: float | None = None
    u_lost_motion: float | None = None
    messages: tuple[str, ...] = ()
    history: tuple[Step, ...] = ()
    is_closed: bool = False

    @property
    def expansion_removed(self) -> float:
        """Slope taken off as expansion, m/m; 0 if none was stated."""
        return self.heat.slope

    @property
    def u_slope(self) -> float | None:
        """Standard uncertainty of that slope, m/m; None if no temperature was stated."""
        return self.heat.u_slope

    @property
    def has_lost_motion(self) -> bool:
        """Whether the lost motion exceeds two standard uncertainties, so that a table has two columns."""
        if self.lost_motion is None or self.u_lost_motion is None:
            return False
        return abs(self.lost_motion) > _SPLIT * self.u_lost_motion

    @property
    def slope(self) -> float:
        """Slope of the least-squares line through the errors of both directions, m/m."""
        ways = [v for v in (self.forward, self.reverse) if v is not None]
        return float(np.polyfit(np.tile(self.positions, len(ways)), np.concatenate(ways), 1)[0])

    def curve(self, direction: int = 1) -> Callable[[ArrayLike], FloatArray]:
        """Return the error of a direction as a function, linear between targets and held beyond them.

        A turn that is closed goes on beyond them.

        Parameters
        ----------
        direction : {1, -1, 0}, optional
            0 is the mean of both, for a control with one column.

        Returns
        -------
        callable
            Error in m over position in m, for `CompensationTable.from_error`.

        Raises
        ------
        DataError
            If that direction was not measured.
        """
        columns = {1: (self.forward,), -1: (self.reverse,), 0: (self.forward, self.reverse)}
        if direction not in columns:
            raise DataError(f"direction is +1, -1 or 0 (the mean of both), got {direction!r}")
        found = [v for v in columns[direction] if v is not None]
        if len(found) < len(columns[direction]):
            raise DataError(
                f"direction {direction:+d} was not measured: take the direction that was, or measure "
                "both in one cycle"
            )
        values = np.mean(found, axis=0)

        def error(position: ArrayLike) -> FloatArray:
            p = np.asarray(position, float)
            if self.is_closed:
                p = self.positions[0] + np.mod(p - self.positions[0], math.tau)
            return np.asarray(np.interp(p, self.positions, values))

        return error

    def u(self, direction: int = 1) -> FloatArray | None:
        """Return the standard uncertainty of a direction at the targets, the expansion included.

        Parameters
        ----------
        direction : {1, -1, 0}, optional
            0 is the greater of both.

        Returns
        -------
        ndarray, shape (m,), m or rad, or None
            sqrt(u_cycles^2 + (p - p_ref)^2 u(slope)^2); None where one cycle shows no scatter and
            no temperature is stated.
        """
        columns = {1: [self.u_forward], -1: [self.u_reverse], 0: [self.u_forward, self.u_reverse]}
        known = [v for v in columns[direction] if v is not None]
        if not known and self.u_slope is None:
            return None
        shape = np.max(known, axis=0) if known else 0.0
        away = (self.positions - self.reference) * (self.u_slope or 0.0)
        return np.asarray(np.hypot(shape, away))

    def __repr__(self) -> str:
        ways = " and ".join(n for n in ("forward", "reverse") if getattr(self, n) is not None)
        return f"<PitchErrors: {self.positions.size} targets, {ways}, slope {self.slope:.6g}>"


def pitch_errors(
    targets: ArrayLike,
    forward: ArrayLike | None,
    reverse: ArrayLike | None = None,
    *,
    values: str = "reached",
    deviation: str = "reached-minus-target",
    reference: float = 0.0,
    reference_direction: str = "forward",
    unit: str = "m",
    heat: Expansion | None = None,
    **stated: Any,
) -> PitchErrors:
    """Return the errors of an axis along itself, as a pitch table needs them.

    Parameters
    ----------
    targets : array_like, shape (m,), m or rad
        Target positions in any order, each once; m >= 3.
    forward, reverse : array_like, shape (m, n), m or rad, or None
        Readings of each direction, one column per cycle; NaN where not measured. One may be None.
    values : {"reached", "deviation"}, optional
        What the readings are.
    deviation : {"reached-minus-target", "target-minus-reached"}, optional
        Sense of deviations.
    reference : float, m or rad, optional
        Position at which the error is zero: the home position, within the targets.
    reference_direction : {"forward", "reverse", "middle"}, optional
        Direction in which the reference is reached.
    unit : {"m", "rad"}, optional
        Linear or rotary axis; a rotary axis takes no expansion.
    heat : Expansion, optional
        Temperatures and coefficients of axis and instrument.
    **stated
        Instead of `heat`, its fields: ``expansion="11.5 ppm/K", temperature="22.4 degC"``.

    Returns
    -------
    PitchErrors
        Slope kept, zero at the reference.

    Raises
    ------
    DataError
        If targets or readings do not fit, the reference lies outside the targets, or a rotary axis
        is said to expand.

    Examples
    --------
    >>> found = pitch_errors([0.0, 0.1, 0.2], [[0.0], [2e-6], [4e-6]], values="deviation",
    ...                      expansion="10 ppm/K", temperature="21 degC")
    >>> (found.forward * 1e6).round(9).tolist()
    [0.0, 1.0, 2.0]
    """
    choice(values, "values", ("reached", "deviation"))
    choice(deviation, "deviation", ("reached-minus-target", "target-minus-reached"))
    choice(reference_direction, "reference_direction", REFERENCE_DIRECTIONS)
    choice(unit, "unit", ("m", "rad"))
    p = np.asarray(targets, dtype=np.float64)
    if p.ndim != 1 or p.size < 3 or not np.isfinite(p).all():
        raise DataError(
            f"targets must be at least 3 finite positions in one list, got shape {p.shape}: fewer do "
            "not show an error between them"
        )
    order = np.argsort(p, kind="stable")
    p = p[order]
    twice = np.flatnonzero(np.diff(p) == 0)
    if twice.size:
        raise DataError(
            f"the target {_shown(p[twice[0]], unit)} occurs more than once: give its readings as further "
            "columns (cycles) of one target"
        )
    sign = 1.0 if deviation == "reached-minus-target" or values == "reached" else -1.0
    off = p if values == "reached" else np.zeros(p.size)
    cycles = {
        name: None if v is None else sign * (_readings(v, name, p.size)[order] - off[:, None])
        for name, v in (("forward", forward), ("reverse", reverse))
    }
    means = {n: None if v is None else _mean(v, p, n, unit) for n, v in cycles.items()}
    step = float(np.median(np.diff(p)))
    for name, mean in means.items():
        if mean is not None and values == "reached" and np.abs(mean + p).max() < 0.01 * step:
            raise DataError(
                f"the {name} readings all lie within 1 % of a step of 0: they are deviations, not "
                'positions reached; say values="deviation"'
            )
    heat = heat or Expansion(**stated)
    if heat.is_stated and unit == "rad":
        raise DataError("a rotary axis has no expansion: leave temperatures and coefficients out")
    zero = quantity(reference, "reference", "length" if unit == "m" else "angle")
    nearest = float(p[np.argmin(np.abs(p - zero))])
    if abs(nearest - zero) <= _SAME_PLACE * (p[-1] - p[0]):  # 2.74 mm typed and 2.74 mm read
        zero = nearest
    if not p[0] <= zero <= p[-1]:
        raise DataError(
            f"the reference {_shown(zero, unit)} lies outside the targets {_shown(p[0], unit)} ... "
            f"{_shown(p[-1], unit)}: the error there is not known; state the home position, or measure "
            "there"
        )
    apart = {n: m[-1] - m[0] for n, m in means.items() if m is not None}
    is_closed = unit == "rad" and is_turn_apart(p[0], p[-1]) and _closed(cycles, means)
    errors = {n: None if v is None else v - heat.slope * (p - zero) for n, v in means.items()}
    names = {1: "forward", -1: "reverse"}
    wanted = [names[d] for d in REFERENCE_DIRECTIONS[reference_direction]]
    if any(errors[n] is None for n in wanted):
        raise DataError(
            f"reference_direction={reference_direction!r} needs readings of {' and '.join(wanted)}; "
            "take the direction that was measured"
        )
    offset = float(np.mean([np.interp(zero, p, errors[n]) for n in wanted]))  # type: ignore[arg-type]
    said = heat.messages if unit == "m" else ()
    if is_closed and any(apart.values()):
        said = (
            (
                f"{math.degrees(p[0]):.9g} and {math.degrees(p[-1]):.9g} deg are one place: their readings, "
                "which differ by no more than their scatter, are averaged"
            ),
        )
    if np.ptp(np.diff(p)) <= _SAME_STEP * step:
        said = (*said, EQUAL_STEPS)
    wanted_cycles = [cycles[n] for n in wanted]
    lost, u_lost, messages = _lost_motion(cycles["forward"], cycles["reverse"])
    return PitchErrors(
        p,
        *_zeroed(errors, offset),
        reference=zero,
        zero_removed=offset,
        reference_direction=reference_direction,
        heat=heat,
        u_forward=_scatter(cycles["forward"], wanted_cycles, p, zero),
        u_reverse=_scatter(cycles["reverse"], wanted_cycles, p, zero),
        lost_motion=lost,
        u_lost_motion=u_lost,
        messages=(*said, *messages),
        is_closed=is_closed,
    )


def _shown(position: float, unit: str) -> str:
    """Return a position as a person reads it."""
    return f"{position * 1e3:.9g} mm" if unit == "m" else f"{math.degrees(position):.9g} deg"


def _zeroed(
    errors: dict[str, FloatArray | None], offset: float
) -> tuple[FloatArray | None, FloatArray | None]:
    """Return the errors of both directions less one zero."""
    up, down = errors["forward"], errors["reverse"]
    return None if up is None else up - offset, None if down is None else down - offset


def _readings(values: ArrayLike, name: str, m: int) -> FloatArray:
    """Return the cycles as columns."""
    found = np.asarray(values, dtype=np.float64)
    found = found[:, None] if found.ndim == 1 else found
    if found.ndim != 2 or found.shape[0] != m or found.shape[1] < 1 or np.isinf(found).any():
        raise DataError(
            f"{name} must hold a finite row for each of the {m} targets and a column for each cycle, "
            f"got shape {found.shape}"
        )
    return found


def _mean(cycles: FloatArray, p: FloatArray, name: str, unit: str) -> FloatArray:
    """Return the mean of the cycles, refused where a target has none."""
    empty = np.flatnonzero(np.isnan(cycles).all(axis=1))
    if empty.size:
        raise DataError(
            f"the target {_shown(p[empty[0]], unit)} has no {name} reading: leave the target out of both "
            "directions, or measure it"
        )
    return np.asarray(np.nanmean(cycles, axis=1))


def _closed(cycles: Mapping[str, FloatArray | None], means: dict[str, FloatArray | None]) -> bool:
    """Give both ends of a turn the mean of their readings, unless they differ by more than scatter does."""
    from scipy.stats import t as student

    ways = {n: (m, c) for n, m in means.items() if m is not None and (c := cycles[n]) is not None}
    for mean, readings in ways.values():
        step = float(mean[-1] - mean[0])
        apart = readings - np.nanmean(readings, axis=0)  # less what a whole cycle shares
        counts = (~np.isnan(apart)).sum(axis=1)
        freedom = int((counts - 1).sum()) - (readings.shape[1] - 1)
        if step != 0.0 and freedom < 1:
            return False
        if step != 0.0:
            left = np.nansum((apart - np.nanmean(apart, axis=1)[:, None]) ** 2)
            u = math.sqrt(left / freedom * (1.0 / counts[0] + 1.0 / counts[-1]))
            if abs(step) > float(student.ppf(1.0 - 0.5 * _BY_CHANCE, freedom)) * u:
                return False
    for name, (mean, _) in ways.items():
        end = 0.5 * (mean[0] + mean[-1])
        means[name] = np.r_[end, mean[1:-1], end]
    return True


def _scatter(
    cycles: FloatArray | None, zeros: list[FloatArray | None], p: FloatArray, zero: float
) -> FloatArray | None:
    """Return the standard uncertainty of the mean minus the zero of the same cycles; NaN: by the rest."""
    n = min(0 if v is None else v.shape[1] for v in (cycles, *zeros))
    if n < 2 or cycles is None:
        return None
    at_zero = np.mean(
        [[np.interp(zero, p, column) for column in v[:, :n].T] for v in zeros if v is not None],
        axis=0,
    )
    apart = cycles[:, :n] - at_zero
    counts = (~np.isnan(apart)).sum(axis=1)
    usual = float(np.sqrt(np.nanmean(np.nanvar(apart[counts > 1], axis=1, ddof=1))))
    spread = np.full(p.size, usual)
    spread[counts > 1] = np.nanstd(apart[counts > 1], axis=1, ddof=1)
    return np.asarray(spread / np.sqrt(np.maximum(counts, 1)))


def _lost_motion(
    up: FloatArray | None, down: FloatArray | None
) -> tuple[float | None, float | None, tuple[str, ...]]:
    """Return mean and u of forward - reverse, the cycles being what repeats."""
    if up is None or down is None:
        return None, None, ("one direction: lost motion is not known",)
    lost = float(np.mean(np.nanmean(up, axis=1) - np.nanmean(down, axis=1)))
    n = min(up.shape[1], down.shape[1])
    each = np.array(
        [np.mean(d[~np.isnan(d)]) for d in (up[:, :n] - down[:, :n]).T if not np.isnan(d).all()]
    )
    if each.size < 2:
        return lost, None, ("one cycle: whether the lost motion repeats is not known",)
    return lost, float(each.std(ddof=1) / math.sqrt(each.size)), ()


# ---- the cycles of a positioning test as runs, which a result stores and a dry-run judges with --


def cycle_runs(
    targets: ArrayLike,
    forward: ArrayLike | None,
    reverse: ArrayLike | None = None,
    *,
    unit: str = "m",
    history: Sequence[Step] = (),
) -> RunSet:
    """Return deviations actual - target (m, n), one column per cycle, as runs over the targets.

    There is one run for each cycle and direction; the unit, m or rad, stays in their metadata.
    """
    p = np.asarray(targets, dtype=np.float64)
    order = np.argsort(p, kind="stable")
    runs = []
    for name, values, step in (("forward", forward, 1), ("reverse", reverse, -1)):
        if values is None:
            continue
        cycles = _readings(values, name, p.size)[order]
        runs += [
            Run(p[order][::step], column[::step], run_id=f"{name} {k}")
            for k, column in enumerate(cycles.T, start=1)
            if not np.isnan(column).all()
        ]
    return RunSet(runs, metadata={"unit": unit}, history=tuple(history))


_FEWEST_IN_CELL = 4
"""Samples of a cell from which its line is fitted; fewer are joined by straight lines."""
_SLACK = 0.1
"""Of a cell: a run that ends so little before its last place holds that place."""
_SAME_STOP = 0.01
"""Of the step of indexed positions: readings so near each other are of one position."""


def celled_runs(runs: RunSet, step: float) -> RunSet:
    """Return runs of an axis that turns as cycles: continuous ones at the multiples of a step, rad.

    Readings are those of the line through the samples of a cell; the places lie in all runs. Readings
    further apart than a step were taken at indexed positions: these are the places, and nothing is
    put between them.
    """
    if indexed := _indexed(runs, step):
        return indexed
    low = max(float(r.x.min()) for r in runs) - _SLACK * step
    high = min(float(r.x.max()) for r in runs) + _SLACK * step
    first, last = math.ceil(low / step), math.floor(high / step)
    places: FloatArray = step * np.arange(first, last + 1, dtype=np.float64)
    if places.size < 3:
        raise DataError(
            f"the runs share {_shown(low, 'rad')} ... {_shown(high, 'rad')}, fewer than three steps of "
            f"{_shown(step, 'rad')}: take a finer spacing, or leave out the run of another place"
        )
    made = []
    for run in runs:
        at = places if run.direction > 0 else places[::-1]
        known = ~np.isnan(run.z)
        order = np.argsort(run.x[known])
        x, z = run.x[known][order], run.z[known][order]
        made.append(Run(at, _at_places(x, z, at, step), run_id=run.run_id))
    told = Step("cells", {"step_rad": step})
    return RunSet(made, metadata=runs.metadata, history=(*runs.history, told))


def _indexed(runs: RunSet, step: float) -> RunSet | None:
    """Return runs at the positions that each direction has readings of; None if read all along."""
    usual = min(float(np.median(np.abs(np.diff(r.x)))) for r in runs)
    if usual <= step * (1.0 + _SAME_PLACE):
        return None
    near = _SAME_STOP * usual
    stops = np.sort(np.concatenate([r.x for r in runs]))
    starts = np.flatnonzero(np.diff(stops, prepend=-np.inf) > near)
    places = np.array([float(np.median(part)) for part in np.split(stops, starts[1:])])
    even = step * np.round(places / step)  # 29.9999 deg read is the target 30 deg
    places = np.where(np.abs(places - even) <= near, even, places)
    rows = np.full((len(runs), places.size), np.nan)
    for row, run in zip(rows, runs, strict=True):
        row[np.abs(run.x[:, None] - places).argmin(axis=1)] = run.z
    seen = [~np.isnan(rows[[r.direction == d for r in runs]]).all(axis=0) for d in runs.directions]
    kept = np.logical_and.reduce(seen)
    if kept.sum() < 3:
        raise DataError(
            f"only {int(kept.sum())} positions were read in each direction: three are needed; read all "
            "runs at the same positions"
        )
    made = [
        Run(places[kept][:: r.direction], row[kept][:: r.direction], run_id=r.run_id)
        for r, row in zip(runs, rows, strict=True)
    ]
    told = Step("indexed", {"step_rad": step})
    return RunSet(made, metadata=runs.metadata, history=(*runs.history, told))


def require_read(cycles: RunSet, spacing: float) -> None:
    """Refuse a spacing in rad whose entries fall between the indexed positions of cycles."""
    if any(s.name == "cells" for s in cycles.history):
        return
    x = np.sort(cycles[0].x)
    steps = np.diff(x)
    near = _SAME_STOP * float(steps.min())

    def fits(width: float) -> bool:
        n = math.floor((x[-1] - x[0]) / width * (1.0 + _SAME_PLACE))
        entries = x[0] + width * np.arange(n + 1)
        return n >= 1 and float(np.abs(entries[:, None] - x).min(axis=1).max()) <= near

    if fits(spacing):
        return
    found = [float(v - x[0]) for v in x[1:] if fits(float(v - x[0]))]
    usual = next((v for v in found if v <= 0.5 * (x[-1] - x[0])), None)
    way = (
        f"take the spacing {math.degrees(usual):.4g} deg or a multiple"
        if usual is not None
        else "read at equal steps, or all along"
    )
    some = ", ".join(f"{math.degrees(v):.4g}" for v in x[:4])
    raise DataError(
        f"the {x.size} positions that were read are {some}{', ...' if x.size > 5 else ','} "
        f"{math.degrees(x[-1]):.4g} deg, and a table with a spacing of {_shown(spacing, 'rad')} has "
        f"entries between them, where nothing was read: {way}"
    )


def _at_places(x: FloatArray, z: FloatArray, at: FloatArray, step: float) -> FloatArray:
    """Return readings at places: of the line through a cell, NaN where nothing is near."""
    first, last = np.searchsorted(x, at - 0.5 * step), np.searchsorted(x, at + 0.5 * step)
    found = np.full(at.size, np.nan)
    for i, (a, b) in enumerate(zip(first, last, strict=True)):
        if b - a >= _FEWEST_IN_CELL:
            found[i] = np.polyfit(x[a:b] - at[i], z[a:b], 1)[1]  # of the line, at the place
        elif x.size and np.abs(x - at[i]).min() <= step:
            found[i] = np.interp(at[i], x, z)
    return found


def require_unit(runs: RunSet, unit: str) -> None:
    """Refuse readings of an axis that turns for one that does not, and the other way round."""
    found = runs.metadata.get("unit", unit)
    if found != unit:
        has, asks = ("angles", "moves along") if found == "rad" else ("lengths", "turns")
        raise DataError(
            f"the readings are {has}, and the axis {asks}: name the axis that was measured (X, Y, Z, U, "
            "V, W move along, A, B, C turn)"
        )


def pitch_errors_of(runs: RunSet, **options: Any) -> PitchErrors:
    """Return what `pitch_errors` finds, with its options, of cycles that are runs over the targets.

    Readings are deviations actual - target; the metadata of the runs may name the unit.
    """
    require_unit(runs, options.get("unit", "m"))
    first = np.sort(runs[0].x)
    near = _SAME_PLACE * float(np.ptp(first))
    columns: dict[int, list[FloatArray]] = {1: [], -1: []}
    for run in runs:
        order = np.argsort(run.x)
        if run.x.size != first.size or float(np.abs(run.x[order] - first).max()) > near:
            raise DataError(
                f"{run.run_id or 'a cycle'} has other targets than {runs[0].run_id or 'the first'}: "
                "give the cycles of one test"
            )
        columns[run.direction].append(run.z[order])
    up, down = (np.column_stack(columns[d]) if columns[d] else None for d in (1, -1))
    found = pitch_errors(first, up, down, values="deviation", **options)
    if any(
        step.name == "cells" for step in runs.history
    ):  # read all along, not at the targets alone
        found = replace(found, messages=tuple(m for m in found.messages if m != EQUAL_STEPS))
    made = {"runs_sha256": tuple(r.sha256 for r in runs), **found.heat.to_dict()}
    return replace(found, history=(*runs.history, Step("pitch", made)))
