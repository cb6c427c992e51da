"""The dry-run: what a correction makes of a measured error, before a machine sees it.

The correction is applied as the controller applies it: looked up at the command and added to it.
What the measurement cannot know (its zero; the alignment of an artefact) is taken off the
measurement, never off the table, and `metrosep.compensation._acceptance` says whether the machine is
better with it than without it. A table that was made of the runs is judged run by run with the table
that is made without that run.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from metrosep.compensation._acceptance import (
    ROUNDING,
    Judgement,
    Reason,
    Stack,
    centre,
    graded,
    judge,
    length_text,
    outside_is_worse,
)
from metrosep.compensation._coverage import alignment, coverage
from metrosep.compensation.folds import Folds, own_runs
from metrosep.compensation.limits import Finding
from metrosep.compensation.measured import Against, Measured, Row, measured_error
from metrosep.compensation.reversal import LostMotion, judge_lost_motion
from metrosep.core.errors import (
    InconclusiveTableError,
    PointlessTableError,
    SignCheckFailedError,
    TableError,
)
from metrosep.core.runset import RunSet
from metrosep.core.units import format_length

__all__ = [
    "Against",
    "DirectionResidual",
    "Removed",
    "Unknown",
    "Verification",
    "dry_run",
    "judged_table",
]

FloatArray = NDArray[np.float64]
Correction = Callable[[FloatArray, int], FloatArray]
Removed = Literal["offset", "line"]
Unknown = Literal["offset", "offsets", "line"]

_GRID_POINTS = 401
_BETWEEN = 4
"""Compared positions from one entry to the next, at least."""

_MOST_POINTS = 20_001
_FEWEST, _MANY = 3, 5
_SOME = 0.2
"""Gain below which a shape is called foreign, in the text only."""

_PREDICTED = 0.1
"""Mean square of the uncertainty over that of the corrections, below which a prediction is enough."""

_NAMES = {1: "forward", -1: "reverse"}
_UNKNOWN = {
    "offset": "one constant",
    "offsets": "one constant for each direction",
    "line": "one constant and the line (alignment)",
}


@dataclass(frozen=True, slots=True)
class DirectionResidual:
    """Error of one direction before and after the table.

    Parameters
    ----------
    direction : int
        +1 forward, -1 reverse.
    n_runs : int
        Runs that were compared; 1 for a curve.
    before_pv, after_pv, wrong_sign_pv : float, m
        P-V of the centre of the runs (median from three on) without, with, and with the negated
        correction. Nothing but the unknown of the measurement is taken off.
    before_rms, after_rms, wrong_sign_rms : float, m
        RMS of the mean run, the same way.
    run_before_rms, run_after_rms : float, m
        Mean RMS of the single runs, with all that does not repeat.
    u_after_rms, u_before_rms, u_after_pv, u_before_pv : float or None, m
        Standard uncertainties from the scatter of the runs, to first order; None for one run.
        Of a P-V: scatter of the runs between the two places where the mean is largest and
        smallest; that noise makes every P-V too large is not in it.
    """

    direction: int
    n_runs: int
    before_pv: float
    after_pv: float
    wrong_sign_pv: float
    before_rms: float
    after_rms: float
    wrong_sign_rms: float
    run_before_rms: float
    run_after_rms: float
    u_after_rms: float | None
    u_before_rms: float | None = None
    u_after_pv: float | None = None
    u_before_pv: float | None = None


@dataclass(frozen=True, slots=True)
class Verification:
    """Result of a dry-run.

    Parameters
    ----------
    residuals : tuple of DirectionResidual
        One for each direction.
    unknown : {"offset", "offsets", "line"}
        What the measurement cannot know and was taken off it: one constant, one for each direction,
        or a constant and the line.
    span : tuple of (float, float), m
        Positions that were compared.
    judgement : Judgement
        Improvement, gain, rest and P-V over all directions.
    reasons : tuple of Reason
        Why it is not accepted; empty if it is.
    findings : tuple of Finding
        Warnings.
    n_runs : int
        Runs, or pairs of directions; 0 where the error is stated.
    left_out : int
        Tables that were made without some of the runs; 0 where the runs did not make it.
    is_reversed : bool
        Whether the readings show that the sign is wrong.
    lost_motion : LostMotion or None
        Offset between the directions before and after; None where it was not measured.
    unproven : tuple of int
        Directions with a column of their own that no run went through.
    """

    residuals: tuple[DirectionResidual, ...]
    unknown: Unknown
    span: tuple[float, float]
    judgement: Judgement
    reasons: tuple[Reason, ...] = ()
    findings: tuple[Finding, ...] = ()
    n_runs: int = 0
    left_out: int = 0
    is_reversed: bool = False
    lost_motion: LostMotion | None = None
    unproven: tuple[int, ...] = ()

    @property
    def grade(self) -> str:
        """``"accepted"``, ``"pointless"``, ``"inconclusive"`` or ``"refused"``."""
        return graded(self.reasons)

    @property
    def passed(self) -> bool:
        """Whether the grade is accepted: the machine is better with the table than without it."""
        return not self.reasons

    @property
    def gain(self) -> float:
        """Share of the table that the readings confirm: 1 right, 0 nothing, below 0 the wrong way."""
        return self.judgement.gain

    @property
    def u_gain(self) -> float:
        """Standard uncertainty of `gain`."""
        return self.judgement.u_gain

    @property
    def improvement(self) -> float:
        """Mean square of the error without the table minus that with it, m^2."""
        return self.judgement.improvement.value

    @property
    def u_improvement(self) -> float:
        """Standard uncertainty of `improvement`, m^2."""
        return self.judgement.improvement.u

    @property
    def rest(self) -> float:
        """RMS that stays over RMS that was, of what repeats."""
        return self.judgement.rest

    @property
    def before_pv(self) -> float:
        """Largest P-V before, m."""
        return max(r.before_pv for r in self.residuals)

    @property
    def after_pv(self) -> float:
        """Largest P-V after, m."""
        return max(r.after_pv for r in self.residuals)

    @property
    def wrong_sign_pv(self) -> float:
        """Largest P-V with the sign reversed, m."""
        return max(r.wrong_sign_pv for r in self.residuals)

    @property
    def before_rms(self) -> float:
        """Largest RMS before, m."""
        return max(r.before_rms for r in self.residuals)

    @property
    def after_rms(self) -> float:
        """Largest RMS after, m."""
        return max(r.after_rms for r in self.residuals)

    @property
    def sentences(self) -> tuple[str, ...]:
        """What a person should read: what was judged on what, the numbers, the grade and why."""
        judged = (
            "judged against the stated error"
            if self.n_runs == 0
            else f"judged on {self.n_runs} run{'s' if self.n_runs > 1 else ''}"
        )
        if self.left_out == self.n_runs > 0:
            judged += ", each left out once"
        elif self.left_out:
            judged += f", left out in {self.left_out} groups"
        low, high = (v * 1e3 for v in self.span)
        j = self.judgement
        rms = math.sqrt(j.energy), math.sqrt(max(j.energy - self.improvement, 0.0))
        gain = f"gain {self.gain:.4g}"
        if 0.0 < self.u_gain < math.inf:
            gain += f" +- {self.u_gain:.2g}"
        lines = [
            f"{judged}, {low:.6g} ... {high:.6g} mm; off the readings: {_UNKNOWN[self.unknown]}",
            (
                f"RMS that repeats {length_text(rms[0])} -> {length_text(rms[1])}, P-V {length_text(j.pv_before)} -> "
                f"{length_text(j.pv_after_plain)} (noise alone {length_text(j.pv_noise)}), {gain}"
            ),
        ]
        why = "; ".join(r.text for r in self.reasons if r.grade == self.grade)
        lines.append(f"{self.grade}: {why}" if why else self.grade)
        return tuple(lines)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values with units in the keys.

        Returns
        -------
        dict
            For sidecars and reports.
        """
        j = self.judgement
        return {
            "grade": self.grade,
            "passed": self.passed,
            "reasons": [
                {"grade": r.grade, "check": r.check, "text": r.text} for r in self.reasons
            ],
            "sentences": list(self.sentences),
            "unknown": self.unknown,
            "unknown_text": _UNKNOWN[self.unknown],
            "n_runs": self.n_runs,
            "left_out": self.left_out,
            "improvement_m2": self.improvement,
            "u_improvement_m2": self.u_improvement,
            "gain": self.gain,
            "u_gain": _finite(self.u_gain),
            "rest": _finite(self.rest),
            "repeats_m2": j.energy,
            "before_pv_m": j.pv_before,
            "after_pv_m": j.pv_after_plain,
            "after_pv_without_chance_slope_m": j.pv_after,
            "noise_pv_m": j.pv_noise,
            "span_m": list(self.span),
            "definition": (
                "error as the controller would apply the table (linear between entries, constant "
                f"outside); off the measurement: {_UNKNOWN[self.unknown]}; nothing off the table, no "
                "filter"
            ),
            "residuals": [
                {
                    "direction": _NAMES[r.direction],
                    "n_runs": r.n_runs,
                    "before_pv_m": r.before_pv,
                    "after_pv_m": r.after_pv,
                    "wrong_sign_pv_m": r.wrong_sign_pv,
                    "before_rms_m": r.before_rms,
                    "after_rms_m": r.after_rms,
                    "wrong_sign_rms_m": r.wrong_sign_rms,
                    "run_before_rms_m": r.run_before_rms,
                    "run_after_rms_m": r.run_after_rms,
                    "u_after_rms_m": r.u_after_rms,
                    "u_before_rms_m": r.u_before_rms,
                    "u_after_pv_m": r.u_after_pv,
                    "u_before_pv_m": r.u_before_pv,
                }
                for r in self.residuals
            ],
            "lost_motion": None if self.lost_motion is None else self.lost_motion.to_dict(),
            "not_verified": [_NAMES[d] for d in self.unproven],
        }

    def require(
        self, what: str, *, waived: Collection[str] = (), only_refused: bool = False
    ) -> None:
        """Refuse what is not accepted.

        Parameters
        ----------
        what : str
            Name of the table for the message.
        waived : collection of str, optional
            Checks whose refusal the user accepts: "coverage", "spike", "single", "inconclusive",
            "pointless". What makes the machine worse cannot be waived.
        only_refused : bool, optional
            Whether the other grades pass.

        Raises
        ------
        SignCheckFailedError
            If it is refused.
        InconclusiveTableError
            If the readings do not show that it helps.
        PointlessTableError
            If less than 30 % of the RMS goes.
        """
        left = [r for r in self.reasons if r.check not in waived or r.check == "dry-run"]
        grade = graded(left)
        if grade == "accepted" or (only_refused and grade != "refused"):
            return
        kinds = {
            "refused": SignCheckFailedError,
            "inconclusive": InconclusiveTableError,
            "pointless": PointlessTableError,
        }
        mine = [r for r in left if r.grade == grade]
        text = "; ".join(r.text for r in mine)
        hint = f"; {self.diagnosis}" if grade == "refused" and mine[0].check == "dry-run" else ""
        checks = [r.check for r in left if r.check != "dry-run"]
        waive = f" (to write it all the same, say waive={', '.join(dict.fromkeys(checks))!r})"
        can = bool(checks) and all(r.check != "dry-run" for r in left)
        how = "the dry-run does not shrink the error: " if hint else ""
        raise kinds[grade](
            f"{what}: {grade}: {how}{text}{hint}; nothing was written{waive if can else ''}"
        )

    @property
    def diagnosis(self) -> str:
        """What is probably wrong with a table that is refused; it never changes the grade."""
        if self.is_reversed:
            return "the reversed sign would shrink it: the sign of the readings or of the table is wrong"
        if self.gain > 0.5:
            return "its shape helps, its zero or a part of it does not"
        if self.gain > _SOME:
            return (
                f"the readings confirm {self.gain:.2g} of it: it is too large (unit, diameter), tilted, "
                "shifted, or belongs to another state"
            )
        return "neither sign shrinks it: the table belongs to another axis, travel or state"


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def dry_run(
    correction: Correction,
    against: Against,
    *,
    span: tuple[float, float],
    on_axis: bool,
    entries: FloatArray | None = None,
    reference: float | None = None,
    unknown: Unknown | None = None,
    alignment_range: tuple[float, float] | None = None,
    made_it: bool = False,
    folds: Folds | None = None,
    why: str = "",
    sd: Callable[[FloatArray, int], FloatArray] | None = None,
    kind: Literal["runs", "stated", "estimate"] | None = None,
    u_slope: float | None = None,
    travel: tuple[float | None, float | None] = (None, None),
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
        Where the forward correction must be zero; not judged if omitted.
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
        Standard uncertainty of the slope of one run of positioning.
    travel : tuple of (float or None, float or None), m, optional
        Where the axis is used. Runs that reach beyond the table are judged there too, with what the
        controller does outside, but not beyond the travel.

    Returns
    -------
    Verification
        Grade, improvement, gain; before, after and with the sign reversed, for each direction.

    Raises
    ------
    TableError
        If span and measurement do not overlap.
    DataError
        If there is no valid sample, or `against` is something else.
    """
    measured = measured_error(against, span, with_slope=on_axis)
    how = kind or measured.kind
    low, high = measured.span
    first, last = max(span[0], low), min(span[1], high)
    if not last > first:
        raise TableError(
            f"the table covers {format_length(span[0])} ... {format_length(span[1])}, the measurement "
            f"{format_length(low)} ... {format_length(high)}: they do not overlap; check the units and "
            "the origin of the positions"
        )
    space = unknown or _unknown(measured, how, on_axis=on_axis)
    zero = 0.0
    if reference is not None:
        zero = float(correction(np.array([reference]), 1)[0])
    table = _Table(correction, folds, on_axis, 0.0 if abs(zero) < ROUNDING else zero)
    aligned = alignment_range or span
    grids = _positions(measured, first, last, entries)
    shape = _Shape(measured, table, space, aligned, how)
    stack = _stack(shape, grids, made_it=made_it, why=why, u_slope=u_slope, sd=sd or measured.sd)
    result = judge(stack)
    reasons = list(result.reasons)
    if folds:  # what is written is the table of all runs: it must not make its own runs worse
        whole = judge(
            _stack(replace(shape, table=replace(table, folds=None)), grids, made_it=True)
        )
        said = {r.text for r in reasons}
        reasons += [r for r in whole.reasons if r.grade == "refused" and r.text not in said]
    covered, warnings = coverage(measured, span, (first, last), entries, how)
    reasons += covered
    beyond, more = _outside(shape, stack, grids, span, travel)
    reasons += beyond
    warnings += more
    reasons += alignment(measured, space, aligned)
    predicted, more = _predicted(stack, how, sd or measured.sd)
    reasons += predicted
    warnings += [*more, *result.warnings]
    if measured.unpaired:
        warnings.append(
            f"run {', '.join(measured.unpaired)} has no partner of the other direction at its feed and "
            "is not compared"
        )
    residuals = tuple(_residual(d, stack) for d in measured.directions)
    own = not np.array_equal(correction(grids[0], 1), correction(grids[0], -1))
    missing = tuple({1, -1} - set(measured.directions)) if own else ()
    known = measured.knows_lost_motion and space != "offsets"
    lost = judge_lost_motion(stack) if known else None
    rank = {"refused": 0, "inconclusive": 1, "pointless": 2}
    return Verification(
        residuals, space, (first, last), result,
        reasons=tuple(sorted(reasons, key=lambda r: rank[r.grade])),
        findings=tuple(Finding("warning", w, "", "dry-run") for w in warnings),
        n_runs=stack.n_runs if how == "runs" else 0,
        left_out=len(folds or ()),
        is_reversed=_is_reversed(stack, result),
        lost_motion=lost,
        unproven=missing,
    )  # fmt: skip


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
) -> Verification:
    """Return the dry-run of a table or polynomial: the one way of every command and call.

    Parameters
    ----------
    carried : CompensationTable or PolynomialFit
        What is judged.
    lookup : callable
        Returns what the controller does with a table or polynomial.
    against : RunSet, Profile, estimate or callable
        Measured error. The ``source`` of the table, the error that it was made of, shows the bytes
        only.
    applied : callable, optional
        What the controller does with the very bytes of `carried`; ``lookup(carried)`` if omitted.
    unknown, u_slope, travel : optional
        As for `dry_run`.
    folds : sequence of (indices of runs, table or polynomial), optional
        What is made without some of the runs; made again from its history if omitted.

    Returns
    -------
    Verification
        Any grade.

    Raises
    ------
    TableError
        If they do not overlap.
    """
    more: dict[str, Any] = {"unknown": unknown, "u_slope": u_slope, "travel": travel}
    warning = ""
    if against is not None and against is getattr(carried, "source", None):
        estimated = carried.made_over is not None
        more["kind"] = "estimate" if estimated else "stated"
        if estimated and carried.u is not None:
            more["sd"] = lambda x, _: np.interp(x, carried.positions, carried.u)
    elif isinstance(against, RunSet):
        own = own_runs(carried, against, lookup, folds)
        against, warning = own.runs, own.warning
        more |= {"made_it": own.made_it, "folds": own.folds, "why": own.why}
        if own.made_it and len(against) < _MANY and len(against.feeds) < 2:
            warning = (
                f"{len(against)} runs at one feed: a disturbance of fixed wavelength cannot be "
                "distinguished from geometry; take 5 runs or more, or another feedrate"
            )
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
        alignment_range=carried.made_over,
        **more,
    )
    if not warning:
        return result
    return replace(result, findings=(*result.findings, Finding("warning", warning, "", "dry-run")))


def _unknown(measured: Measured, how: str, *, on_axis: bool) -> Unknown:
    if how != "runs":
        return "offset" if measured.knows_lost_motion else "offsets"
    return "offset" if on_axis else "line"


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
        here = places[0][(places[0] >= first) & (places[0] <= last)]
        listed = _FEWEST <= here.size < _GRID_POINTS and all(
            p.size == places[0].size
            and float(np.abs(p - places[0]).max()) <= 1e-9 * (last - first)
            for p in places
        )
        grids.append(here if listed else np.linspace(first, last, n))
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


def _outside(
    shape: _Shape,
    inside: Stack,
    grids: tuple[FloatArray, ...],
    span: tuple[float, float],
    travel: tuple[float | None, float | None],
) -> tuple[list[Reason], list[str]]:
    """Return whether the runs beyond the table get worse by what the controller does there."""
    measured = shape.measured
    low = max(measured.span[0], -math.inf if travel[0] is None else travel[0])
    high = min(measured.span[1], math.inf if travel[1] is None else travel[1])
    step = (grids[0][-1] - grids[0][0]) / (grids[0].size - 1)
    beyond = np.concatenate(
        [np.arange(span[0] - step, low, -step)[::-1], np.arange(span[1] + step, high, step)]
    )
    if shape.how != "runs" or not _FEWEST <= beyond.size <= _MOST_POINTS:
        return [], []
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
    there = _stack(shape, (beyond,) * len(ways), levels=(np.concatenate(off, axis=1), mean))
    worse, much = outside_is_worse(there)
    if not worse:
        return [], []
    text = (
        f"the runs reach from {format_length(low)} to {format_length(high)}, beyond the table, and "
        f"what the controller does there makes it worse: {worse}; make the table as long as the "
        "travel, or state the travel that is used (travel_low, travel_high)"
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
        return [], ["predicted, not shown: no run was left out, verify against measured runs"]
    return [
        Reason(
            "inconclusive",
            "single",
            "no runs were given, and the uncertainty of the error is "
            f"{'not known' if not math.isfinite(variance) else 'not small against it'}: what repeats is "
            "not known; verify against the measured runs",
        )
    ], []


def _is_reversed(stack: Stack, result: Judgement) -> bool:
    """Return whether the negated table would be accepted with at most half of the RMS left."""
    if not result.is_reversed:
        return False
    flipped = judge(stack.negated())
    return graded(flipped.reasons) == "accepted" and flipped.rest <= 0.5


def _residual(direction: int, stack: Stack) -> DirectionResidual:
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
        u_after_rms=_u_rms(after),
        u_before_rms=_u_rms(before),
        u_after_pv=_u_pv(after),
        u_before_pv=_u_pv(before),
    )


def _rms(values: FloatArray) -> float:
    return math.sqrt(float((values**2).mean()))


def _u_rms(runs: FloatArray) -> float | None:
    mean = runs.mean(axis=0)
    rms = _rms(mean)
    return _scatter(runs @ mean / mean.size / rms) if len(runs) > 1 and rms > 0.0 else None


def _u_pv(runs: FloatArray) -> float | None:
    mean = runs.mean(axis=0)
    if len(runs) < 2:
        return None
    return _scatter(runs[:, int(mean.argmax())] - runs[:, int(mean.argmin())])


def _scatter(shares: FloatArray) -> float:
    """Return the standard uncertainty of the mean of what each run contributes."""
    return float(shares.std(ddof=1) / np.sqrt(shares.size))
