"""The dry-run: what a correction makes of a measured error, before a machine sees it.

The correction is applied as the controller applies it: looked up at the command and added to it.
What the measurement cannot know (its zero; the alignment of an artefact) is taken off the
measurement, never off the table, and `metrosep.compensation._acceptance` says whether the machine is
better with it than without it. A table that was made of the runs is judged run by run with the table
that is made without that run.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np

from metrosep.compensation._acceptance import (
    ROUNDING,
    Judgement,
    Reason,
    Stack,
    centre,
    graded,
    judge,
    outside_is_worse,
)
from metrosep.compensation._holes import OF_RUNS, spacing_of, without_holes
from metrosep.compensation.area_errors import LENGTHS, AxisUnits, format_amount, is_rotary
from metrosep.compensation.limits import Finding
from metrosep.compensation.measured import (
    Against,
    Folds,
    Measured,
    Row,
    at_reference,
    cooled,
    measured_error,
    own_runs,
)
from metrosep.compensation.verification import (
    DirectionResidual,
    Unknown,
    Verification,
    judge_lost_motion,
)
from metrosep.core._arrays import FloatArray, IntArray
from metrosep.core.errors import DataError, TableError
from metrosep.core.numbers import choice, not_negative
from metrosep.core.runset import RunSet
from metrosep.separation.positions.expansion import Expansion
from metrosep.separation.runs.design import COVERED

Correction = Callable[[FloatArray, int], FloatArray]
Removed = Literal["offset", "line"]

_GRID_POINTS = 401
_BETWEEN = 4
"""Compared positions from one entry to the next, at least."""

_MOST_POINTS = 20_001
_FEWEST, _MANY = 3, 5
_PREDICTED = 0.1
"""Mean square of the uncertainty over that of the corrections, below which a prediction is enough."""


def dry_run(
    correction: Correction,
    against: Against,
    *,
    span: tuple[float, float],
    on_axis: bool,
    entries: FloatArray | None = None,
    reference: float | None = None,
    reference_direction: str = "forward",
    unknown: Unknown | None = None,
    alignment_range: tuple[float, float] | None = None,
    made_it: bool = False,
    folds: Folds | None = None,
    why: str = "",
    sd: Callable[[FloatArray, int], FloatArray] | None = None,
    kind: Literal["runs", "stated", "estimate"] | None = None,
    u_slope: float | None = None,
    travel: tuple[float | None, float | None] = (None, None),
    units: AxisUnits = LENGTHS,
    is_list: bool = False,
) -> Verification:
    """Apply a correction to a measured error as a controller would, and judge it.

    Parameters
    ----------
    correction : callable
        ``(positions, direction) -> correction`` in m, the controller's lookup.
    against : RunSet, Profile, estimate or callable
        Measured error e = actual - nominal over position; a callable is known over `span`.
    span : tuple of (float, float), m
        Positions of the table; what is compared is narrowed to what was measured.
    on_axis : bool
        Whether the correction moves the axis whose position is looked up.
    entries : ndarray, m, optional
        Positions of the entries of the table.
    reference : float, m, optional
        Where the correction must be zero; not judged if omitted.
    reference_direction : {"forward", "reverse", "middle"}, optional
        Direction in which the reference is reached; the mean of both in the middle.
    unknown : {"offset", "offsets", "line"}, optional
        What the MEASUREMENT cannot know: one constant; one for each direction (the sensor was set to
        zero between them); a constant and the line. Of runs, if omitted: "offset" on-axis, where the
        slope belongs to the error, and "line" for straightness against an artefact whose alignment is
        not known.
    alignment_range : tuple of (float, float), m, optional
        Range over which the line of the table was removed; the span if omitted.
    made_it : bool, optional
        Whether the table was made of these runs.
    folds : sequence of (indices of runs, lookup), optional
        The controller's lookups of the tables made without some of them.
    why : str, optional
        Why there are no folds.
    sd : callable, optional
        Standard uncertainty of a stated error over position and direction, m.
    kind : {"runs", "stated", "estimate"}, optional
        How to take `against`, where its type does not tell.
    u_slope : float, rad, optional
        Standard uncertainty of a slope that all runs of positioning share (temperature, scale).
    travel : tuple of (float or None, float or None), m, optional
        Where the axis is used. Runs that reach beyond the table are judged there too, with what the
        controller does outside, but not beyond the travel.
    units : AxisUnits, optional
        Of texts and keys: lengths if omitted.
    is_list : bool, optional
        Whether the table is made of a list of targets.

    Returns
    -------
    Verification
        Grade, improvement, gain; before, after and with the sign reversed, for each direction.

    Raises
    ------
    TableError
        If span and measurement do not overlap, or a run has fewer than three readings there.
    DataError
        If there is no valid sample, or `against` is something else, the runs do not overlap,
        `unknown` is not one of the three, or `u_slope` is not a number from zero on.
    """
    if unknown is not None:
        choice(unknown, "unknown", get_args(Unknown))
    u_slope = None if u_slope is None else not_negative(u_slope, "u_slope")
    measured = measured_error(against, span, with_slope=on_axis, units=units)
    how = kind or measured.kind
    low, high = measured.span
    first, last = max(span[0], low), min(span[1], high)
    holes: tuple[list[str], list[str]] = ([], [])
    if how == "runs":
        measured, holes = without_holes(measured, span, (first, last), entries, units)
    if not last > first:
        raise TableError(
            f"the table covers {units.place(span[0])} ... {units.place(span[1])}, the measurement "
            f"{units.place(low)} ... {units.place(high)}: they do not overlap; check the units and "
            "the origin of the positions"
        )
    _require_readings(measured, first, last, units)
    space = unknown or _unknown(
        measured, how, has_line=not on_axis and not is_rotary(units.looked_up)
    )
    zero = 0.0
    if reference is not None:
        zero = at_reference(correction, reference, reference_direction)
    table = _Table(correction, folds, on_axis, 0.0 if abs(zero) < ROUNDING else zero)
    aligned = alignment_range or span
    grids = _positions(measured, first, last, entries)
    shape = _Shape(measured, table, space, aligned, how, units, is_list)
    stack = _stack(shape, grids, made_it=made_it, why=why, u_slope=u_slope, sd=sd or measured.sd)
    result = judge(stack)
    reasons = list(result.reasons)
    if folds:  # what is written is the table of all runs: it must not make its own runs worse
        whole = judge(
            _stack(replace(shape, table=replace(table, folds=None)), grids, made_it=True)
        )
        said = {r.text for r in reasons}
        reasons += [r for r in whole.reasons if r.grade == "refused" and r.text not in said]
    covered, warnings = _coverage(shape, span, (first, last), entries, holes)
    there = _outside(shape, stack, grids, span, travel)
    beyond, more = _beyond(there)
    warnings += more
    # what is true of the negated table too
    both = [*covered, *_alignment(shape)]
    predicted, more = _predicted(stack, how, sd or measured.sd)
    both += predicted
    reasons += [*beyond, *both]
    warnings += [*more, *result.warnings]
    if measured.parts:
        warnings.append(
            f"the travel was measured part by part: {measured.parts} runs are judged as "
            f"{len(measured.rows)} passes over it, lines of the parts fitted together"
        )
    if measured.unpaired:
        lacks = (
            "parts beside it" if measured.parts else "partner of the other direction at its feed"
        )
        warnings.append(f"run {', '.join(measured.unpaired)} has no {lacks} and is not compared")
    known_to = sd or measured.sd if how == "estimate" else None
    residuals = tuple(_residual(d, stack, known_to) for d in measured.directions)
    own = not np.array_equal(correction(grids[0], 1), correction(grids[0], -1))
    missing = tuple({1, -1} - set(measured.directions)) if own else ()
    known = measured.knows_lost_motion and space != "offsets"
    lost = judge_lost_motion(stack) if known else None
    rank = {"refused": 0, "inconclusive": 1, "pointless": 2}
    is_reversed = _is_reversed(stack, result, there, both)
    why_not = ""
    if graded(reasons) in ("refused", "pointless"):
        why_not = diagnosis(stack, result, is_reversed=is_reversed)
    return Verification(
        residuals, space, (first, last), result,
        reasons=tuple(sorted(reasons, key=lambda r: rank[r.grade])),
        findings=tuple(Finding.warning(w, "", "dry-run") for w in warnings),
        n_runs=stack.n_runs if how == "runs" else 0,
        left_out=len(folds or ()),
        is_reversed=is_reversed,
        diagnosis=why_not,
        lost_motion=lost,
        unproven=missing,
        units=units,
    )  # fmt: skip


def _require_readings(measured: Measured, first: float, last: float, units: AxisUnits) -> None:
    """Refuse a comparison at fewer than three readings of a run: a constant and a slope take two."""
    for row in measured.rows:
        for x in row.places.values():
            n = int(((x >= first) & (x <= last)).sum())
            if n < _FEWEST:
                raise TableError(
                    f"run {row.name} has {n} of its {x.size} readings between {units.place(first)} and "
                    f"{units.place(last)}, where the table is: {_FEWEST} are needed; check the units "
                    "and the origin of the positions, or measure more of them"
                )


def judged_table(
    carried: Any,
    lookup: Callable[[Any], Correction],
    against: Any,
    *,
    applied: Correction | None = None,
    unknown: Unknown | None = None,
    u_slope: float | None = None,
    folds: Folds | None = None,
    travel: tuple[float | None, float | None] = (None, None),
    heat: Expansion | None = None,
) -> Verification:
    """Return the dry-run of a table or polynomial: the one way of every command and call.

    Readings are compared at the temperature that the table holds at: with `heat`, which those that
    made it need not say again.
    """
    taken = getattr(carried, "heat", None) or Expansion()
    more: dict[str, Any] = {"unknown": unknown, "travel": travel}
    warning = ""
    if against is not None and against is getattr(carried, "source", None):
        estimated = carried.made_over is not None
        more["kind"] = "estimate" if estimated else "stated"
        if estimated and carried.u is not None:
            more["sd"] = lambda x, _: np.interp(x, carried.positions, carried.u)
    elif isinstance(against, RunSet):
        own = own_runs(carried, against, lookup, folds)
        warning = own.warning
        if taken.is_stated and heat is None and not own.made_it:
            raise DataError(
                "the table holds without thermal expansion, and the temperature of these readings is "
                'not stated: say temperature="22.4 degC" and expansion="11.5 ppm/K", or already_corrected=True'
            )
        heat = None if heat is None else heat.used_as(taken)
        against = cooled(own.runs, (heat or taken).slope, getattr(carried, "reference", 0.0))
        more |= {"made_it": own.made_it, "folds": own.folds, "why": own.why}
        if own.made_it and len(against) < _MANY and len(against.feeds) < 2:
            warning = (
                f"{len(against)} runs at one feed: a disturbance of fixed wavelength cannot be "
                "distinguished from geometry; take 5 runs or more, or another feedrate"
            )
    more["u_slope"] = (heat or taken).u_slope if u_slope is None else u_slope
    positions = getattr(carried, "positions", None)
    is_table = positions is not None
    if not is_table:  # a polynomial is fitted to the runs as they are, with their line
        more["unknown"] = unknown or ("offset" if carried.removed == "offset" else None)
    result = dry_run(
        applied or lookup(carried),
        against,
        span=carried.span if is_table else carried.domain,
        on_axis=is_table and carried.is_on_axis,
        entries=positions,
        reference=carried.reference if is_table else None,
        reference_direction=carried.reference_direction if is_table else "forward",
        alignment_range=carried.made_over,
        units=AxisUnits.of(carried),
        is_list=any(s.name == "pitch" for s in carried.history),
        **more,
    )
    said = [*([warning] if warning else []), *getattr(carried, "notes", ())]
    more_findings = (Finding.warning(text, "", "dry-run") for text in said)
    return replace(result, findings=(*result.findings, *more_findings))


def _unknown(measured: Measured, how: str, *, has_line: bool) -> Unknown:
    if how != "runs":
        return "offset" if measured.knows_lost_motion else "offsets"
    return "line" if has_line else "offset"


@dataclass(frozen=True, slots=True, eq=False)
class _Table:
    """A correction with those made without some runs; c_0 at its reference."""

    correction: Correction
    folds: Folds | None
    on_axis: bool
    zero: float

    def without(self, row: Row) -> Correction:
        """Return the lookup that a row is judged with: made without its runs."""
        for left_out, lookup in self.folds or ():
            if set(row.members) <= set(left_out):
                return lookup  # type: ignore[no-any-return]
        return self.correction


@dataclass(frozen=True, slots=True, eq=False)
class _Shape:
    measured: Measured
    table: _Table
    unknown: Unknown
    aligned: tuple[float, float]
    how: str
    units: AxisUnits
    is_list: bool


def _positions(
    measured: Measured, first: float, last: float, entries: FloatArray | None
) -> tuple[FloatArray, ...]:
    """Return the compared positions of each direction: the targets of a list, or equal steps."""
    n_entries = 0
    if entries is not None:
        n_entries = int(((entries >= first) & (entries <= last)).sum())
    n = min(max(_GRID_POINTS, _BETWEEN * (n_entries - 1) + 1), _MOST_POINTS)
    grids = []
    for d in measured.directions:
        places = [row.places.get(d, np.empty(0)) for row in measured.rows]
        # the targets of a list that every run has a reading of, or is bridged at; equal steps if the
        # runs have no list
        near = 1e-9 * (last - first)
        here = np.sort(np.concatenate(places))
        here = here[np.diff(here, prepend=-np.inf) > near]
        for row, p in zip(measured.rows, places, strict=True):
            if p.size:
                at = np.searchsorted(p, here)
                apart = np.abs(p[np.clip([at - 1, at], 0, p.size - 1)] - here).min(axis=0)
                known = apart <= near
                for a, b in row.bridged.get(d, ()):
                    known |= (here > a) & (here < b)
                here = here[known]
        inside = here[(here >= first - near) & (here <= last + near)]
        most = max(((p >= first) & (p <= last)).sum() for p in places)
        listed = _FEWEST <= inside.size < _GRID_POINTS and 2 * inside.size > most
        # where the runs go on beyond the table, its end counts between the targets beside it
        here = np.unique(np.clip(inside, first, last))
        apart = (1.0 - COVERED) * (last - first) / max(here.size - 1, 1)
        ends = [end for end in (first, last) if (np.abs(here - end) > apart).all()]
        grids.append(np.union1d(here, ends) if listed else np.linspace(first, last, n))
    return tuple(grids)


def _stack(
    shape: _Shape,
    grids: tuple[FloatArray, ...],
    *,
    levels: tuple[FloatArray, ...] | None = None,
    made_it: bool = False,
    why: str = "",
    u_slope: float | None = None,
    sd: Callable[[FloatArray, int], FloatArray] | None = None,
) -> Stack:
    """Return runs and corrections at positions of each direction, as rows.

    For positions outside the table `grids` are those, and `levels` are what to take off there.
    """
    measured, table = shape.measured, shape.table
    ways = measured.directions
    x = np.concatenate(grids)
    way = np.concatenate([np.full(g.size, float(d)) for d, g in zip(ways, grids, strict=True)])

    def each(function: Callable[[int], Correction]) -> FloatArray:
        return np.array(
            [
                np.concatenate([function(i)(g, d) for d, g in zip(ways, grids, strict=True)])
                for i in range(len(measured.rows))
            ]
        )

    def read(i: int) -> Correction:
        return lambda g, d: measured.rows[i].curves[d](g)

    def moved(i: int, sign: float) -> Correction:
        lookup = table.without(measured.rows[i])
        return lambda g, d: measured.rows[i].curves[d](g + sign * lookup(g, d) * table.on_axis)

    plain = each(read)
    c = each(lambda i: table.without(measured.rows[i]))
    after, wrong = each(lambda i: moved(i, 1.0)), each(lambda i: moved(i, -1.0))
    steps = np.array(
        [
            float((lookup(grids[0], -1) - lookup(grids[0], 1)).mean())
            for lookup in map(table.without, measured.rows)
        ]
    )
    off, mean = levels or (_known_part(shape, x, way, plain), c.mean(axis=1, keepdims=True))
    applied = c - mean
    u_known = None
    if sd is not None and shape.how != "runs":
        spread = np.concatenate([sd(g, d) for d, g in zip(ways, grids, strict=True)])
        u_known = float((np.abs(applied[0]) * spread).mean())
    return Stack(
        x, way, plain - off, after - off + applied, wrong - off - applied, applied, table.zero,
        steps * (measured.knows_lost_motion and shape.unknown != "offsets"),
        tuple(row.name for row in measured.rows),
        has_slope=shape.unknown != "line",
        is_left_out=bool(table.folds),
        made_it=made_it,
        why=why,
        is_stated=shape.how != "runs",
        u_known=u_known if u_known is None or math.isfinite(u_known) else None,
        u_slope=u_slope,
        units=shape.units,
        is_list=shape.is_list,
    )  # fmt: skip


def _known_part(shape: _Shape, x: FloatArray, way: FloatArray, m: FloatArray) -> FloatArray:
    """Return P_N m of each run, at the compared positions."""
    if shape.unknown == "offset":
        return np.asarray(m.mean(axis=1, keepdims=True) + np.zeros_like(m))
    if shape.unknown == "offsets":
        off = np.zeros_like(m)
        for d in np.unique(way):
            off[:, way == d] = m[:, way == d].mean(axis=1, keepdims=True)
        return off
    slopes = np.array([_slope(shape, row, x) for row in shape.measured.rows])[:, None]
    line = slopes * (x - x.mean())
    return np.asarray(line + (m - line).mean(axis=1, keepdims=True))


def _slope(shape: _Shape, row: Row, x: FloatArray) -> float:
    """Return the slope of a run over the range over which that of the table was removed."""
    low, high = (
        max(shape.aligned[0], shape.measured.span[0]),
        min(shape.aligned[1], shape.measured.span[1]),
    )
    near = 1e-3 * (high - low)
    ways = shape.measured.directions
    per = x.size // len(ways)
    if abs(x.min() - low) <= near and abs(x.max() - high) <= near and len(ways) == 1:
        grids = [x]
    elif abs(x.min() - low) <= near and abs(x.max() - high) <= near:
        grids = [x[:per], x[per:]]
    else:
        grids = [np.linspace(low, high, _GRID_POINTS)] * len(ways)
    p = np.concatenate(grids)
    z = np.concatenate([row.curves[d](g) for d, g in zip(ways, grids, strict=True)])
    away = p - p.mean()
    return float((away * z).sum() / (away**2).sum())


@dataclass(frozen=True, slots=True, eq=False)
class _There:
    """Where the runs reach beyond a table, m, and what they read there."""

    low: float
    high: float
    stack: Stack


def _outside(
    shape: _Shape,
    inside: Stack,
    grids: tuple[FloatArray, ...],
    span: tuple[float, float],
    travel: tuple[float | None, float | None],
) -> _There | None:
    """Return the runs beyond the table with what the controller does there; None if none reach."""
    measured = shape.measured
    low = max(measured.span[0], -math.inf if travel[0] is None else travel[0])
    high = min(measured.span[1], math.inf if travel[1] is None else travel[1])
    step = (grids[0][-1] - grids[0][0]) / (grids[0].size - 1)
    beyond = np.concatenate(
        [np.arange(span[0] - step, low, -step)[::-1], np.arange(span[1] + step, high, step)]
    )
    if shape.how != "runs" or not _FEWEST <= beyond.size <= _MOST_POINTS:
        return None
    ways = measured.directions
    # what was taken off inside, a constant or a line for each direction, goes on outside
    off, mean, start = [], np.zeros((len(measured.rows), 1)), 0
    for d, g in zip(ways, grids, strict=True):
        here = slice(start, start + g.size)
        taken = np.array([row.curves[d](g) for row in measured.rows]) - inside.known[:, here]
        c = np.array([shape.table.without(row)(g, d) for row in measured.rows])
        mean += (c - inside.applied[:, here]).mean(axis=1, keepdims=True) / len(ways)
        slope = (taken[:, -1] - taken[:, 0]) / (g[-1] - g[0])
        off.append(taken[:, :1] + slope[:, None] * (beyond - g[0]))
        start += g.size
    levels = (np.concatenate(off, axis=1), mean)
    return _There(low, high, _stack(shape, (beyond,) * len(ways), levels=levels))


def _beyond(there: _There | None) -> tuple[list[Reason], list[str]]:
    """Return whether the runs beyond the table get worse by what the controller does there."""
    worse, much = ("", False) if there is None else outside_is_worse(there.stack)
    if there is None or not worse:
        return [], []
    text = (
        f"the runs reach from {there.stack.units.place(there.low)} to {there.stack.units.place(there.high)}, beyond the "
        f"table, and what the controller does there makes it worse: {worse}; make the table as long "
        "as the travel, or state the travel that is used with travel_low= and travel_high="
    )
    return ([Reason("refused", "coverage", text)], []) if much else ([], [text])


def _predicted(
    stack: Stack, how: str, sd: Callable[[FloatArray, int], FloatArray] | None
) -> tuple[list[Reason], list[str]]:
    """Return 1.10 of an estimate without runs: enough where its own uncertainty is small."""
    if how == "stated":
        return [], ["stated, not measured: the bytes are right if the error that was stated is"]
    if how == "runs":
        return [], []
    variance = math.inf
    if sd is not None:
        spread = np.concatenate([sd(stack.x[stack.way == d], int(d)) for d in (1, -1)])
        variance = float((spread**2).mean())
    if math.isfinite(variance) and variance < _PREDICTED * float((stack.applied**2).mean()):
        return [], ["predicted, not shown: no run was omitted, verify against measured runs"]
    return [
        Reason(
            "inconclusive",
            "single",
            "no runs were given, and the uncertainty of the error is "
            f"{'not known' if not math.isfinite(variance) else 'not small against it'}: what repeats is "
            "not known; verify against the measured runs",
        )
    ], []


def _is_reversed(
    stack: Stack, result: Judgement, there: _There | None, both: list[Reason]
) -> bool:
    """Return whether the negated bytes would be accepted with at most half of the RMS left (1.8)."""
    if not result.is_reversed:
        return False
    flipped = judge(stack.negated())
    beyond = [] if there is None else _beyond(replace(there, stack=there.stack.negated()))[0]
    return graded([*flipped.reasons, *beyond, *both]) == "accepted" and flipped.rest <= 0.5


def _residual(
    direction: int, stack: Stack, known_to: Callable[[FloatArray, int], FloatArray] | None
) -> DirectionResidual:
    """Return what a direction has before and after; of an estimate, u is that of the error itself."""
    part = stack.way == direction
    before, after, wrong = (v[:, part] for v in (stack.known, stack.rest, stack.wrong))
    middle, plain, flipped = centre(after), centre(before), centre(wrong)
    return DirectionResidual(
        direction=direction,
        n_runs=len(after),
        before_pv=float(np.ptp(plain)),
        after_pv=float(np.ptp(middle)),
        wrong_sign_pv=float(np.ptp(flipped)),
        before_rms=_rms(before.mean(axis=0)),
        after_rms=_rms(after.mean(axis=0)),
        wrong_sign_rms=_rms(wrong.mean(axis=0)),
        run_before_rms=float(np.mean([_rms(run) for run in before])),
        run_after_rms=float(np.mean([_rms(run) for run in after])),
        u_after_rms=u_of_rms(after)
        if known_to is None
        else _finite(_rms(known_to(stack.x[part], direction))),
        u_before_rms=u_of_rms(before),
        u_after_pv=u_of_pv(after),
        u_before_pv=u_of_pv(before),
    )


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _rms(values: FloatArray) -> float:
    return math.sqrt(float((values**2).mean()))


def u_of_rms(runs: FloatArray) -> float | None:
    """Return the standard uncertainty of the RMS of the mean run, to first order; None for one run."""
    mean = runs.mean(axis=0)
    rms = _rms(mean)
    return _scatter(runs @ mean / mean.size / rms) if len(runs) > 1 and rms > 0.0 else None


def u_of_pv(runs: FloatArray) -> float | None:
    """Return the same of its P-V: scatter between the places where the mean is largest and smallest."""
    mean = runs.mean(axis=0)
    if len(runs) < 2:
        return None
    return _scatter(runs[:, int(mean.argmax())] - runs[:, int(mean.argmin())])


def _scatter(shares: FloatArray) -> float:
    """Return the standard uncertainty of the mean of what each run contributes."""
    return float(shares.std(ddof=1) / np.sqrt(shares.size))


# ---- the share of the table that was measured ---------------------------------------------------


def _coverage(
    shape: _Shape,
    span: tuple[float, float],
    common: tuple[float, float],
    entries: FloatArray | None,
    holes: tuple[list[str], list[str]],
) -> tuple[list[Reason], list[str]]:
    """Return 1.9: the share of the table that was measured, holes in it, and the share of the runs."""
    refused, warnings, units = [], list(holes[1]), shape.units
    length = span[1] - span[0]
    spacing = spacing_of(span, entries)
    share = (common[1] - common[0]) / length
    ranges = (
        f"the table covers {units.place(span[0])} ... {units.place(span[1])}, the measurement "
        f"{units.place(common[0])} ... {units.place(common[1])} of it"
    )
    if share < COVERED:
        refused.append(
            f"{ranges} ({100.0 * share:.3g} %): measure the whole table, or make it shorter"
        )
    elif length * (1.0 - share) > spacing * (1.0 + 1e-9):
        warnings.append(f"{ranges}: the rest is not proven")
    if shape.how == "runs":
        refused += holes[0][:1]
        whole = shape.measured.span[1] - shape.measured.span[0]
        if (common[1] - common[0]) / whole < OF_RUNS:
            warnings.append(
                f"the table covers {100.0 * (common[1] - common[0]) / whole:.3g} % of what was measured: "
                "check the origin and the unit of the positions"
            )
    return [Reason("refused", "coverage", text) for text in refused], warnings


def _alignment(shape: _Shape) -> list[Reason]:
    """Return that a line cannot be compared where the runs do not reach as far as it was removed."""
    if shape.unknown != "line":
        return []
    aligned, measured, units = shape.aligned, shape.measured, shape.units
    low, high = max(aligned[0], measured.span[0]), min(aligned[1], measured.span[1])
    if high - low >= COVERED * (aligned[1] - aligned[0]):
        return []
    return [
        Reason(
            "inconclusive",
            "inconclusive",
            f"the line of the table was removed over {units.place(aligned[0])} ... "
            f"{units.place(aligned[1])}, the runs cover {units.place(low)} ... "
            f"{units.place(high)} of it: they cannot show its tilt; measure the whole range",
        )
    ]


# ---- what is probably wrong with a table that is refused or pointless; it changes no grade ------
# Each likely mistake is undone on paper, to first order and on the mean of the runs, and the first one
# is named whose undoing leaves less than half of the RMS, and less than half of what the table leaves:
#
#     D' = -2 <a c'~> - <c'~^2> - c'_0^2,   q' = sqrt(max(E - D', 0) / E) < min(q / 2, 1 / 2)

_HALF = 0.5
_FACTORS = (
    (1000.0, "a unit: mm and um, or um and nm"),
    (25.4, "inch and mm"),
    (2.0, "diameter and radius"),
    (180.0 / math.pi, "degree and radian"),
)
_NEAR = 0.1
"""Share by which the gain may miss a factor."""

_SOME = 0.2
"""Gain above which the readings confirm a part of a table that fits in no other way."""

_SHIFTS, _FARTHEST = 200, 0.9
"""Shifts that are tried to each side, up to this share of the travel."""

_AT_ONCE = 1_000_000
"""Corrections that are looked up at a time, 8 MB."""

REVERSED = "the reversed sign would shrink it: the sign of the readings or of the table is wrong"


def half_of(rest: float, other: float) -> bool:
    """Return whether a rest is less than half of the RMS and of another rest."""
    return rest < _HALF * other and rest < _HALF


@dataclass(frozen=True, slots=True, eq=False)
class _Paper:
    """Mean run and mean correction, shape (K,), m, with what repeats and what the table adds at zero."""

    stack: Stack
    energy: float
    a: FloatArray
    c: FloatArray

    def rest(self, c: FloatArray, zero: float) -> float:
        """Return q' of another correction."""
        return float(self.rests(c[None], zero)[0])

    def rests(self, c: FloatArray, zero: float) -> FloatArray:
        """Return q' of corrections, shape (n, K)."""
        level = c - c.mean(axis=1, keepdims=True)
        left = self.energy + 2.0 * (level @ self.a) / self.a.size + (level**2).mean(axis=1)
        return np.asarray(np.sqrt(np.maximum(left + zero**2, 0.0) / self.energy))

    def ways(self) -> list[IntArray]:
        """Return the indices of each direction, positions rising."""
        x, way = self.stack.x, self.stack.way
        found = (np.flatnonzero(way == d) for d in (1.0, -1.0))
        return [i[np.argsort(x[i])] for i in found if i.size]

    def moved(self, place: FloatArray) -> FloatArray:
        """Return corrections looked up elsewhere, `place` of shape (n, K)."""
        c = np.empty(place.shape)
        for i in self.ways():
            c[:, i] = np.interp(place[:, i], self.stack.x[i], self.c[i])
        return c


def diagnosis(stack: Stack, result: Judgement, *, is_reversed: bool) -> str:
    """Return what is probably wrong with a table, one sentence."""
    if result.energy == 0.0 or not stack.applied.any():
        return ""
    paper = _Paper(stack, result.energy, stack.known.mean(axis=0), stack.applied.mean(axis=0))

    def fits(c: FloatArray, zero: float = 0.0) -> bool:
        return half_of(paper.rest(c, zero), result.rest)

    if stack.zero != 0.0 and fits(paper.c):
        return f"it would fit but for its zero, which moves the machine by {format_amount(stack.units.corrected, stack.zero)}"
    text = _factor(paper, result)
    if text:
        return text
    if is_reversed:
        return REVERSED
    ways = paper.ways()
    if len(ways) == 2 and ways[0].size == ways[1].size:
        exchanged = np.empty_like(paper.c)
        exchanged[ways[0]], exchanged[ways[1]] = paper.c[ways[1]], paper.c[ways[0]]
        if fits(exchanged):
            return "it would fit with its forward and reverse columns exchanged"
    if len(ways) == 2:
        had, asked = (float(v[ways[1]].mean() - v[ways[0]].mean()) for v in (paper.c, -paper.a))
        stepped = paper.c.copy()
        stepped[ways[1]] += asked - had
        if fits(stepped):
            amount = stack.units.amount
            return (
                f"a lost motion (reverse - forward) of {amount(had - asked)} stays: set it as the backlash of "
                "the control and measure again, or write a file that has a column for each direction"
            )
    x = stack.x
    if fits(paper.moved((x.min() + x.max() - x)[None])[0]):
        return "it would fit mirrored: its positions run the other way"
    shift = _shift(paper)
    if shift != 0.0 and fits(paper.moved((x + shift)[None])[0]):
        return f"it would fit if it were moved by {stack.units.place(-shift)}: check the origin of the positions"
    away = x - x.mean()
    has, needs = (float((v * away).mean() / (away**2).mean()) for v in (paper.c, -paper.a))
    if fits(paper.c + (needs - has) * away, 0.0):
        return (
            f"its shape fits and its slope does not: the table has {stack.units.slope(has)}, the readings "
            f"ask for {stack.units.slope(needs)}"
        )
    return _foreign(stack, result)


def _factor(paper: _Paper, result: Judgement) -> str:
    """Return by which factor of units a table is too large or too small."""
    for size, why in _FACTORS:
        for factor, word in ((size, "small"), (1.0 / size, "large")):
            near = abs(result.gain / factor - 1.0) <= _NEAR  # g times the table would fit
            if near and half_of(
                paper.rest(factor * paper.c, factor * paper.stack.zero), result.rest
            ):
                return f"it is {size:.4g} times too {word} ({why})"
    return ""


def _shift(paper: _Paper) -> float:
    """Return how far from each position the table holds what fits there, m."""
    x = paper.stack.x
    most = _FARTHEST * float(np.ptp(x))

    def best(tried: FloatArray) -> float:
        parts = np.array_split(tried, 1 + tried.size * x.size // _AT_ONCE)
        rests = [paper.rests(paper.moved(x + part[:, None]), 0.0) for part in parts]
        return float(tried[int(np.argmin(np.concatenate(rests)))])

    coarse = best(np.linspace(-most, most, 2 * _SHIFTS + 1))
    return best(coarse + np.linspace(-1.0, 1.0, 21) * most / _SHIFTS)


def _foreign(stack: Stack, result: Judgement) -> str:
    """Return what is left where no single mistake explains a table."""
    gain = result.gain
    other = (
        "it belongs to another axis, place or state, or was active while the readings were taken"
    )
    if gain > _HALF:
        return "its shape helps, its zero or a part of it does not"
    if gain > _SOME:
        return f"the readings confirm {gain:.2g} of it: {other}"
    if gain < -_SOME:
        return f"the readings run against it (gain {gain:.2g}): {other}"
    return f"neither sign shrinks it: {other}"
