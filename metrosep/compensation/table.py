"""`CompensationTable`: corrections at positions of an axis, with sign, reference and source.

Sign: the entries are the correction c = -e that is ADDED to the command (e = actual - nominal).
What a controller's file holds instead is the business of its dialect in `metrosep.controllers`.
Between entries the correction is linear, outside constant, as controllers do.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from metrosep.compensation.area_errors import (
    AxisUnits,
    column,
    ends_along,
    format_along,
    format_amount,
    format_span,
    is_rotary,
)
from metrosep.compensation.limits import (
    Corrections,
    Finding,
    Limits,
    check_limits,
    coarse_finding,
)
from metrosep.compensation.measured import Against, Folds, at_reference, source_hashes
from metrosep.compensation.polynomial import exact_correction
from metrosep.compensation.sampling import (
    Covariance,
    Direction,
    ErrorSource,
    SampledError,
    beyond_entries,
    sample_error,
    significant_lost_motion,
)
from metrosep.compensation.verification import Unknown, Verification
from metrosep.compensation.verify import Removed, judged_table
from metrosep.core._arrays import BoolArray, FloatArray
from metrosep.core.errors import DataError, TableError
from metrosep.core.numbers import choice
from metrosep.core.profile import html_table
from metrosep.core.provenance import Step, hash_bytes, history_as_dicts
from metrosep.core.public import PublicObject, shortened
from metrosep.core.runset import Run, RunSet
from metrosep.separation.positions.expansion import Expansion
from metrosep.separation.positions.pitch import (
    REFERENCE_DIRECTIONS,
    PitchErrors,
    pitch_errors_of,
)
from metrosep.separation.runs.base import ErrorEstimate

_SAME_PLACE = 1e-9
"""Of the range of the targets: places so near to each other are one."""
_SOURCE_POINTS = 10
"""Positions kept between two entries of the error that a table was made of."""

_FINER = 0.8
"""Spacing of entries over that of the targets of a list, below which they add nothing."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class CompensationTable(Corrections, PublicObject):
    """Corrections along an axis; frozen, SI.

    Parameters
    ----------
    positions : array_like, shape (n,), m
        Commanded positions, finite, strictly rising, n >= 2.
    forward : array_like, shape (n,), m
        Correction to add when moving in + direction.
    reverse : array_like or None, shape (n,), m
        The same in - direction; None if it is the same.
    axis : str
        Axis whose position is looked up, such as ``"X"``.
    compensates : str
        Axis that is corrected; the same for positioning, another for straightness.
    reference : float, m
        Position at which the forward correction is zero.
    u : array_like or None, shape (n,), m
        Standard uncertainty of the entries: of the error there minus that at the reference, with
        the covariance of an estimate.
    interpolation_error : float or None, m
        Largest deviation of the linear interpolation from the error it was made of.
    removed : {"offset", "line"}
        What is not in the table: its zero; and the line, where straightness was estimated against an
        artefact whose alignment is not known. The slope of an axis along itself is in the table.
    is_exact_inverse : bool
        Whether c(p) = -e(p + c(p)) was solved; for a cross-axis table the two are the same.
    offset_removed : float, m
        Amount subtracted to make the reference zero.
    source_sha256 : tuple of str
        Hashes of the files behind it.
    history : tuple of Step
        From the files on.
    source : RunSet or None
        The error it was made of, between the entries too, for a dry-run where no measured runs
        are at hand; one run for each direction, without time.
    made_over : tuple of (float, float) or None, m
        Evaluation range of the estimate behind it, over which its line was removed.
    covariances : mapping of int to callable, m^2
        By direction, 1 and -1 (1 alone where there is one column): covariance, shape (n, n), of what
        the table adds at positions in m, shape (n,). Empty where it is not known; a file keeps `u`
        alone.
    reference_direction : {"forward", "reverse", "middle"}
        Direction in which the reference is reached: that column is zero there.
    heat : Expansion
        Temperatures of the readings; what they explain is not in the table.
    notes : tuple of str
        What to know wherever the table is judged or written.

    Raises
    ------
    TableError
        If positions do not rise, lengths differ, or a value is not finite.
    """

    positions: FloatArray
    forward: FloatArray
    reverse: FloatArray | None
    axis: str
    compensates: str
    reference: float
    u: FloatArray | None = None
    interpolation_error: float | None = None
    removed: Removed = "offset"
    is_exact_inverse: bool = False
    offset_removed: float = 0.0
    source_sha256: tuple[str, ...] = ()
    history: tuple[Step, ...] = ()
    source: RunSet | None = None
    made_over: tuple[float, float] | None = None
    covariances: Mapping[int, Covariance] = field(default_factory=dict)
    reference_direction: str = "forward"
    heat: Expansion = field(default_factory=Expansion)
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        positions = column(self.positions, "positions")
        if positions.size < 2:
            raise TableError(f"a table needs at least 2 positions, got {positions.size}")
        if not np.isfinite(self.reference):
            raise TableError(f"reference={self.reference!r} must be a finite position")
        bad = np.flatnonzero(np.diff(positions) <= 0)
        if bad.size:
            i = int(bad[0])
            raise TableError(
                f"positions must rise strictly: entry {i} is {positions[i] * 1e3:.9g} mm, entry "
                f"{i + 1} is {positions[i + 1] * 1e3:.9g} mm; sort them and remove duplicates"
            )
        object.__setattr__(self, "positions", positions)
        for name in ("forward", "reverse", "u"):
            values = getattr(self, name)
            if values is not None:
                checked = column(values, name)
                if checked.size != positions.size:
                    raise TableError(
                        f"{name} has {checked.size} entries, there are {positions.size} positions"
                    )
                object.__setattr__(self, name, checked)
        choice(self.reference_direction, "reference_direction", REFERENCE_DIRECTIONS)
        for name in ("axis", "compensates"):
            text = str(getattr(self, name))
            if not text.strip() or not text.isprintable():
                raise TableError(f"{name} must name an axis, such as 'X'; got {text[:40]!r}")

    @property
    def is_on_axis(self) -> bool:
        """Whether the corrected axis is the one whose position is looked up."""
        return self.axis == self.compensates

    @property
    def span(self) -> tuple[float, float]:
        """First and last position in m."""
        return float(self.positions[0]), float(self.positions[-1])

    @property
    def stroke(self) -> float:
        """Largest correction, absolute, m."""
        both = self.forward if self.reverse is None else np.r_[self.forward, self.reverse]
        return float(np.abs(both).max())

    @property
    def at_reference(self) -> float:
        """What the table adds at its reference, reached as it is reached, m; zero of a good one."""
        return at_reference(self.correction, self.reference, self.reference_direction)

    @property
    def headline(self) -> str:
        """What is looked up and what is corrected, in one line."""
        what = "its own positioning" if self.is_on_axis else f"{self.compensates} over {self.axis}"
        low, high = (format_span(self.axis, v, digits=6) for v in self.span)
        line = "the line is omitted (alignment)"
        if self.removed == "offset":
            slope = float(np.polyfit(self.positions - self.positions.mean(), self.forward, 1)[0])
            line = f"slope {AxisUnits.of(self).slope(slope)} kept"
        return (
            f"{self.axis} -> {self.compensates} ({what}), {low.partition(' ')[0]} ... {high}, "
            f"{self.positions.size} entries, {line}, "
            f"zero at {format_span(self.axis, self.reference, digits=6)}"
            f"{'' if self.reference_direction == 'forward' else f' ({self.reference_direction})'}"
        )

    @classmethod
    def from_error(
        cls,
        error: ErrorSource,
        *,
        positions: ArrayLike | str | int | None = None,
        axis: str,
        compensates: str | None = None,
        direction: Direction = "auto",
        reference: float | None = None,
        reference_direction: str = "forward",
        heat: Expansion | None = None,
        reverse: ErrorSource | None = None,
        exact: bool = True,
        source_sha256: tuple[str, ...] = (),
    ) -> CompensationTable:
        """Return the table that cancels an error.

        Parameters
        ----------
        error : ErrorEstimate, PitchErrors, Profile or callable
            Error e = actual - nominal in m over position in m. `PitchErrors` bring their reference
            and temperatures with them.
        positions : array_like, str or int, optional
            Positions in m; or the spacing as text, ``"1 mm"``; or their number. For the last two
            the range is that of the estimate or profile. The targets of `PitchErrors` if omitted.
        axis : str
            Axis whose position is looked up.
        compensates : str, optional
            Axis that is corrected; `axis` itself if omitted.
        direction : {"auto", "both", "split", "forward", "reverse"}, optional
            One column for both directions, or one for each. "auto" splits where the estimate
            has both; "forward" and "reverse" use that direction's estimate for both.
        reference : float, m, optional
            Position of zero correction; 0 if it is in range, else the first position.
        reference_direction : {"forward", "reverse", "middle"}, optional
            Direction in which the reference is reached: that column is zero there.
        heat : Expansion, optional
            Temperatures of the readings of an axis along itself; what they explain is taken off.
        reverse : ErrorEstimate, Profile or callable, optional
            Error of the reverse direction where it comes from elsewhere.
        exact : bool, optional
            Solve ``c(p) = -e(p + c(p))`` for an on-axis table.
        source_sha256 : tuple of str, optional
            Hashes of the source files; taken from the history of an estimate if omitted.

        Returns
        -------
        CompensationTable
            With interpolation error and uncertainty where they are known.

        Raises
        ------
        TableError
            If the positions leave the measured range or lie in a gap of it, or the error is too
            steep to invert.
        DataError
            If `direction` is unknown or asks for what the error does not have, or a straightness is
            said to expand.
        """
        target = compensates or axis
        choice(reference_direction, "reference_direction", REFERENCE_DIRECTIONS)
        if heat is not None and target != axis:
            raise DataError(
                f"temperatures belong to the error of an axis along itself; this table corrects "
                f"{target} over {axis}: leave them out"
            )
        if isinstance(error, PitchErrors):
            reference, reference_direction = _of_list(error, axis, target, reference, heat)
            heat = None  # its slope is off already
        sampled = sample_error(
            error,
            reverse,
            direction=direction,
            positions=positions,
            reference=reference,
            axis=axis,
            on_axis=target == axis,
            reference_direction=reference_direction,
            heat=heat,
        )
        invert = exact and target == axis
        make = exact_correction if invert else (lambda e, x: -e(x))
        p, zero = sampled.positions, sampled.reference
        split = sampled.reverse is not None
        missed = beyond_entries(error, sampled, axis) if isinstance(positions, str) else ""
        lost = (
            {f"lost_motion_{'rad' if is_rotary(target) else 'm'}": significant_lost_motion(error)}
            if split
            else {}
        )
        table = cls(
            positions=p,
            forward=_zeroed(make(sampled.forward, p), p == zero, reference_direction == "forward"),
            reverse=None
            if sampled.reverse is None
            else _zeroed(make(sampled.reverse, p), p == zero, reference_direction == "reverse"),
            axis=axis,
            compensates=target,
            reference=zero,
            u=sampled.u,
            covariances=sampled.covariances,
            interpolation_error=sampled.interpolation_error,
            removed="line" if isinstance(error, ErrorEstimate) and target != axis else "offset",
            made_over=(error.start, error.stop) if isinstance(error, ErrorEstimate) else None,
            is_exact_inverse=invert,
            offset_removed=sampled.offset,
            reference_direction=reference_direction,
            heat=error.heat if isinstance(error, PitchErrors) else heat or Expansion(),
            notes=(
                *_notes(error, heat, axis, on_axis=target == axis, split=split),
                *_finer(error, p, axis),
                *([missed] if missed else []),
            ),
            source_sha256=source_sha256 or source_hashes(getattr(error, "history", ())),
            history=(
                *getattr(error, "history", ()),
                Step(
                    "table",
                    {
                        "axis": axis,
                        "compensates": target,
                        ("reference_rad" if is_rotary(axis) else "reference_m"): zero,
                        "direction": direction if reverse is None else "two sources",
                        "exact": exact,
                        **(
                            {}
                            if reference_direction == "forward"
                            else {"reference_direction": reference_direction}
                        ),
                        **lost,
                    },
                ),
            ),
        )
        *before, step = table.history
        step = Step(step.name, {**step.parameters, "entries_sha256": table._digest()})
        return replace(table, source=_source(sampled), history=(*before, step))

    def _digest(self) -> str:
        """Return the hash of the entries, by which a table changed since is known."""
        columns = (self.positions, self.forward, self.reverse)
        return hash_bytes(b"|".join(b"" if v is None else v.tobytes() for v in columns))

    def correction(self, position: ArrayLike, direction: int = 1) -> FloatArray:
        """Return the correction as a controller would interpolate it.

        Parameters
        ----------
        position : array_like, m
            Commanded positions.
        direction : {1, -1}, optional
            Direction of motion.

        Returns
        -------
        ndarray, m
            Linear between entries, constant outside.

        Raises
        ------
        DataError
            If `direction` is neither 1 nor -1.
        """
        if direction not in (1, -1):
            raise DataError(f"direction is +1 or -1, got {direction!r}")
        values = self.forward if direction > 0 or self.reverse is None else self.reverse
        p = np.atleast_1d(np.asarray(position, dtype=np.float64))
        return np.asarray(np.interp(p, self.positions, values))

    def exact_inverse(self) -> CompensationTable:
        if self.is_exact_inverse or not self.is_on_axis:
            return self

        def invert(direction: int) -> FloatArray:
            return exact_correction(lambda x: -self.correction(x, direction), self.positions)

        return replace(
            self,
            forward=invert(1),
            reverse=None if self.reverse is None else invert(-1),
            is_exact_inverse=True,
            history=(*self.history, Step("exact_inverse", {})),
        )

    def limits(self, limits: Limits | None = None, **values: float) -> tuple[Finding, ...]:
        """Return what is wrong or uncertain about the table for a machine.

        Parameters
        ----------
        limits : Limits, optional
            Of machine and controller; or give its fields as keywords.
        **values
            Fields of `Limits`.

        Returns
        -------
        tuple of Finding
            Level, problem and fix; empty if nothing is wrong.
        """
        chosen = limits or Limits(**cast("dict[str, Any]", values))
        findings = check_limits(
            self.positions, self.forward, self.reverse, chosen, on_axis=self.is_on_axis
        )
        return (*findings, *coarse_finding(self.interpolation_error, self.forward, "table"))

    def remade(self, error: ErrorEstimate | RunSet) -> CompensationTable:
        """Return the table that the same settings make of another estimate.

        Parameters
        ----------
        error : ErrorEstimate or RunSet
            Of other runs, or of fewer; runs are the cycles of a list of targets.

        Returns
        -------
        CompensationTable
            On the same positions.

        Raises
        ------
        TableError
            If its history does not say how it was made, or something was done to it since.
        """
        last = self.history[-1] if self.history else None
        if last is not None and last.name == "combine":
            raise TableError(
                "it holds another table too, and what these readings added to that is not stored"
            )
        if last is None or last.name != "table" or "direction" not in last.parameters:
            raise TableError("its history does not say how it was made of an estimate")
        stated = last.parameters
        if stated.get("entries_sha256") != self._digest():
            raise TableError("it was changed since it was made")
        source: ErrorEstimate | PitchErrors
        direction: Direction
        if isinstance(error, RunSet):
            source = pitch_errors_of(
                error,
                reference=self.reference,
                reference_direction=self.reference_direction,
                unit="rad" if is_rotary(self.axis) else "m",
                heat=self.heat,
            )
            # whether each direction has its column was settled with all cycles
            both = source.forward is not None and source.reverse is not None
            settled: Direction = "split" if both and self.reverse is not None else "both"
            direction = settled if stated["direction"] == "auto" else stated["direction"]
        else:
            source, direction = _settled(error, stated), stated["direction"]
        return type(self).from_error(
            source,
            positions=self.positions,
            axis=self.axis,
            compensates=self.compensates,
            direction=direction,
            reference=self.reference,
            reference_direction=self.reference_direction,
            heat=self.heat if self.heat.is_stated and isinstance(error, ErrorEstimate) else None,
            exact=bool(stated["exact"]),
        )

    def verify(
        self,
        against: Against,
        *,
        unknown: Unknown | None = None,
        u_slope: float | None = None,
        folds: Folds | None = None,
        travel: tuple[float | None, float | None] = (None, None),
        heat: Expansion | None = None,
    ) -> Verification:
        """Return the dry-run against a measured error, and refuse a table that makes it worse.

        Parameters
        ----------
        against : RunSet, Profile, ErrorEstimate or callable
            Measured error over position. Runs that made the table are omitted one by one: each
            is judged with the table made without it.
        unknown : {"offset", "offsets", "line"}, optional
            What the measurement cannot know, see `dry_run`.
        u_slope : float, rad, optional
            Standard uncertainty of a slope that all runs of positioning share (temperature, scale).
        folds : sequence of (indices of runs, CompensationTable), optional
            Tables made without some of the runs, where the history does not say how to make them.
        travel : tuple of (float or None, float or None), m, optional
            Where the axis is used, if the runs reach beyond that and beyond the table.
        heat : Expansion, optional
            Temperatures of these readings; those of the table if omitted.

        Returns
        -------
        Verification
            Grade, improvement and gain; P-V and RMS before, after and with the sign reversed.

        Raises
        ------
        SignCheckFailedError
            If the grade is "refused"; the other grades are returned.
        TableError
            If table and measurement do not overlap.
        """
        result = judged_table(
            self,
            lambda table: table.correction,
            against,
            unknown=unknown,
            u_slope=u_slope,
            folds=folds,
            travel=travel,
            heat=heat,
        )
        result.require(f"table {self.axis} -> {self.compensates}", only_refused=True)
        return result

    def negated(self) -> CompensationTable:
        return replace(
            self, forward=-self.forward, reverse=None if self.reverse is None else -self.reverse
        )

    def to_dict(self) -> dict[str, Any]:
        found = {
            "axis": self.axis,
            "compensates": self.compensates,
            "headline": self.headline,
            "sign": "correction c = -e is added to the command; e = actual - nominal",
            "n_points": int(self.positions.size),
            "positions_m": self.positions.tolist(),
            "forward_m": self.forward.tolist(),
            "reverse_m": None if self.reverse is None else self.reverse.tolist(),
            "u_m": None if self.u is None else self.u.tolist(),
            "reference_m": self.reference,
            "offset_removed_m": self.offset_removed,
            "stroke_m": self.stroke,
            "span_m": list(self.span),
            "interpolation": "linear, constant outside",
            "interpolation_error_m": self.interpolation_error,
            "exact_inverse": self.is_exact_inverse,
            "not_in_table": self.removed,
            "made_over_m": None if self.made_over is None else list(self.made_over),
            **(
                {}
                if self.reference_direction == "forward"
                else {"reference_direction": self.reference_direction}
            ),
            **({"heat": self.heat.to_dict()} if self.heat.is_stated else {}),
            **({"notes": list(self.notes)} if self.notes else {}),
            "source_sha256": list(self.source_sha256),
            "history": history_as_dicts(self.history),
        }
        named: dict[str, Any] = AxisUnits.of(self).named(found)
        return named

    def __repr__(self) -> str:
        ways = "both directions alike" if self.reverse is None else "forward and reverse"
        return shortened(
            f"CompensationTable({self.axis} -> {self.compensates}, {self.positions.size} points, "
            f"{ends_along(self.axis, *self.span)}, {ways}, "
            f"stroke {format_amount(self.compensates, self.stroke)}, "
            f"zero at {format_along(self.axis, self.reference)})"
        )

    def _repr_html_(self) -> str:
        """Return a small table for notebooks."""
        return html_table(
            "CompensationTable",
            {
                "axis → corrected axis": f"{self.axis} → {self.compensates}",
                "points": str(self.positions.size),
                "span": ends_along(self.axis, *self.span),
                "entries": "correction c = −e, added to the command",
                "stroke": format_amount(self.compensates, self.stroke),
                "zero at": format_along(self.axis, self.reference),
                "interpolation error": "not known"
                if self.interpolation_error is None
                else format_amount(self.compensates, self.interpolation_error),
            },
        )


def _settled(error: ErrorEstimate, stated: Mapping[str, Any]) -> ErrorEstimate:
    """Return an estimate of fewer runs whose lost motion counts where it counted with all of them.

    Two runs each way show it; the single one that is left without the others has no u.
    """
    had = next((v for k, v in stated.items() if k.startswith("lost_motion_")), None)
    lost = error.lost_motion
    if had is None or lost is None or not math.isfinite(lost.value):
        return error
    return replace(error, lost_motion=replace(lost, u=0.0) if had else None)


def _notes(
    error: ErrorSource, heat: Expansion | None, axis: str, *, on_axis: bool, split: bool
) -> tuple[str, ...]:
    """Return what was assumed of temperatures, and the lost motion that is not in the table."""
    if not isinstance(error, PitchErrors):
        told = isinstance(error, ErrorEstimate) and on_axis and not is_rotary(axis)
        set_ups = getattr(error, "audit", {}).get("set_ups")
        said = (heat or Expansion()).messages if told else ()
        return (*([str(set_ups)] if set_ups else []), *said)
    if not on_axis:
        return (
            *error.messages,
            (
                f"what the artefact itself does over one turn of {axis} (eccentricity, tilt) is in the "
                "readings and so in the table: take it off first, or measure with a reversal"
            ),
        )
    if split or not error.has_lost_motion:
        return error.messages
    lost = format_amount(axis, -(error.lost_motion or 0.0))
    return (
        *error.messages,
        f"lost motion (reverse - forward) of {lost} is not in the table: set it in the control",
    )


def _finer(error: ErrorSource, p: FloatArray, axis: str) -> tuple[str, ...]:
    """Return what to know of entries between the targets of a list."""
    if not isinstance(error, PitchErrors) or any(s.name == "cells" for s in error.history):
        return ()
    entries, targets = (float(np.median(np.diff(v))) for v in (p, error.positions))
    if entries >= _FINER * targets:
        return ()
    apart = [format_span(axis, v) for v in (entries, targets)]
    text = (
        f"entries every {apart[0]}, targets about every {apart[1]}: between the targets nothing was "
        "measured and the table is straight; measure closer, or leave the spacing out"
    )
    return (text,)


def _zeroed(values: FloatArray, at: BoolArray, is_zero: bool) -> FloatArray:
    """Return a column with an exact zero at the reference, where rounding leaves 1e-23."""
    return np.where(at, 0.0, values) if is_zero else values


def _of_list(
    error: PitchErrors, axis: str, target: str, reference: float | None, heat: Expansion | None
) -> tuple[float, str]:
    """Return reference and its direction of a list of targets, which its errors hold already."""
    if target != axis and not (is_rotary(axis) and not is_rotary(target)):
        raise DataError(
            f"a list of targets is the error of {axis} along itself, and {target} is not {axis}: "
            "say the axis that was measured"
        )
    elsewhere = reference is not None and abs(reference - error.reference) > _SAME_PLACE * float(
        np.ptp(error.positions)
    )
    if heat is not None or elsewhere:
        raise DataError(
            "reference and temperatures of a list of targets are stated to pitch_errors"
        )
    return error.reference, error.reference_direction


def _source(sampled: SampledError) -> RunSet:
    """Return the error between the first and last entry, ten positions to an interval."""
    p = sampled.positions
    fraction = np.arange(_SOURCE_POINTS) / _SOURCE_POINTS
    x = np.append((p[:-1, None] + np.diff(p)[:, None] * fraction).ravel(), p[-1])
    runs = [Run(x, sampled.forward(x), run_id="forward")]
    if sampled.reverse is not None:
        runs.append(Run(x[::-1], sampled.reverse(x)[::-1], run_id="reverse"))
    return RunSet(runs)
