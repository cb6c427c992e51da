"""The dry-run: what a correction makes of a measured error, before a machine sees it.

The correction is applied as the controller applies it: looked up at the command and added to it.
Of the readings of several runs the mean over the runs of one direction is corrected, because no
table can remove what does not repeat; single runs are reported beside it. From every curve the
offset is removed (a run has no absolute zero), and its line where the table was made from an
estimate without alignment; the offset between the directions is judged apart (lost motion).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from metrosep.compensation.measured import Against, Curve, measured_error
from metrosep.compensation.reversal import LostMotion, judge_lost_motion
from metrosep.core.errors import SignCheckFailedError, TableError
from metrosep.core.units import format_length

__all__ = ["Against", "DirectionResidual", "Removed", "Verification", "dry_run"]

FloatArray = NDArray[np.float64]
Correction = Callable[[FloatArray, int], FloatArray]
Removed = Literal["offset", "line"]

_GRID_POINTS = 2001
_NAMES = {1: "forward", -1: "reverse"}


@dataclass(frozen=True, slots=True)
class DirectionResidual:
    """Error of one direction before and after the table.

    Parameters
    ----------
    direction : int
        +1 forward, -1 reverse.
    n_runs : int
        Runs that were averaged; 1 for a curve.
    before_pv, after_pv, wrong_sign_pv : float, m
        P-V of the mean curve without, with, and with the negated correction.
    before_rms, after_rms, wrong_sign_rms : float, m
        The same as RMS.
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

    @property
    def passed(self) -> bool:
        """Whether both P-V and RMS shrink."""
        return self.after_pv < self.before_pv and self.after_rms < self.before_rms


@dataclass(frozen=True, slots=True)
class Verification:
    """Result of a dry-run.

    Parameters
    ----------
    residuals : tuple of DirectionResidual
        One for each direction.
    removed : {"offset", "line"}
        What was taken from each curve.
    span : tuple of (float, float), m
        Positions that were compared.
    lost_motion : LostMotion or None
        Offset between the directions before and after; None where it was not measured.
    unproven : tuple of int
        Directions with a column of their own that no run went through.
    """

    residuals: tuple[DirectionResidual, ...]
    removed: Removed
    span: tuple[float, float]
    lost_motion: LostMotion | None = None
    unproven: tuple[int, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether the error shrinks in every direction and lost motion does not grow."""
        grows = self.lost_motion is not None and not self.lost_motion.passed
        return all(r.passed for r in self.residuals) and not grows

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

    def to_dict(self) -> dict[str, Any]:
        """Return plain values with units in the keys.

        Returns
        -------
        dict
            For sidecars and reports.
        """
        return {
            "passed": self.passed,
            "removed": self.removed,
            "span_m": list(self.span),
            "definition": (
                "mean of the runs of one direction, as the controller would apply the table "
                "(linear between entries, constant outside), no filter"
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

    def require(self, what: str) -> None:
        """Refuse when the error does not shrink.

        Parameters
        ----------
        what : str
            Name of the table for the message.

        Raises
        ------
        SignCheckFailedError
            If P-V or RMS does not shrink in some direction, or lost motion grows.
        """
        for r in self.residuals:
            if not r.passed:
                hint = (
                    "the reversed sign would shrink it: the sign of the readings or of the table "
                    "is wrong"
                    if r.wrong_sign_rms < r.before_rms
                    else "neither sign shrinks it: the table belongs to another axis, travel or state"
                )
                raise SignCheckFailedError(
                    f"{what}: the dry-run does not shrink the {_NAMES[r.direction]} error: P-V "
                    f"{format_length(r.before_pv)} -> {format_length(r.after_pv)}, RMS "
                    f"{format_length(r.before_rms)} -> {format_length(r.after_rms)}; {hint}; nothing "
                    "was written"
                )
        lost = self.lost_motion
        if lost is not None and not lost.passed:
            raise SignCheckFailedError(
                f"{what}: the dry-run makes the lost motion (reverse minus forward) larger: "
                f"{format_length(lost.before)} -> {format_length(lost.after)}, with the reversed sign "
                f"{format_length(lost.wrong_sign)}; check the sign of the reverse column, or verify "
                "with runs between which the sensor was not set to zero; nothing was written"
            )


def dry_run(
    correction: Correction,
    against: Against,
    *,
    span: tuple[float, float],
    on_axis: bool,
    removed: Removed = "offset",
) -> Verification:
    """Apply a correction to a measured error as a controller would.

    Parameters
    ----------
    correction : callable
        ``(positions, direction) -> correction`` in m, the controller's lookup.
    against : RunSet, Profile, estimate or callable
        Measured error e = actual - nominal over position; a callable is known over `span`.
    span : tuple of (float, float), m
        Positions to compare; narrowed to what was measured.
    on_axis : bool
        Whether the correction moves the axis whose position is looked up.
    removed : {"offset", "line"}, optional
        What is taken from each curve before P-V and RMS.

    Returns
    -------
    Verification
        Before, after and with the sign reversed, for each direction.

    Raises
    ------
    TableError
        If span and measurement do not overlap.
    DataError
        If there is no valid sample, or `against` is something else.
    """
    measured = measured_error(against, span)
    low, high = measured.span
    first, last = max(span[0], low), min(span[1], high)
    if not last > first:
        raise TableError(
            f"the table covers {format_length(span[0])} ... {format_length(span[1])}, the measurement "
            f"{format_length(low)} ... {format_length(high)}: they do not overlap; check the units and "
            "the origin of the positions"
        )
    grid = np.linspace(first, last, _GRID_POINTS)
    applied = {
        d: _apply(members, grid, correction(grid, d), on_axis=on_axis)
        for d, members in measured.curves.items()
    }
    residuals = tuple(_residual(d, three, grid, removed) for d, three in applied.items())
    forward, reverse = correction(grid, 1), correction(grid, -1)
    lost = None
    if measured.knows_lost_motion:
        means = [{d: three[i].mean(axis=1) for d, three in applied.items()} for i in range(3)]
        lost = judge_lost_motion(
            *means,
            step=float(np.mean(reverse - forward)),
            u=measured.u_lost_motion,
            residual_rms=max(r.after_rms for r in residuals),
        )
    missing = () if np.array_equal(forward, reverse) else tuple({1, -1} - set(applied))
    return Verification(residuals, removed, (first, last), lost, missing)


def _apply(
    members: list[Curve], grid: FloatArray, c: FloatArray, *, on_axis: bool
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the runs without, with and with the negated correction, shape (runs, positions)."""
    return (
        np.array([f(grid) for f in members]),
        np.array([f(grid + c * on_axis) + c for f in members]),
        np.array([f(grid - c * on_axis) - c for f in members]),
    )


def _residual(
    direction: int,
    applied: tuple[FloatArray, FloatArray, FloatArray],
    grid: FloatArray,
    removed: Removed,
) -> DirectionResidual:
    before, after, wrong = (
        np.array([_leveled(run, grid, removed) for run in runs]) for runs in applied
    )
    mean, plain, flipped = after.mean(axis=0), before.mean(axis=0), wrong.mean(axis=0)
    return DirectionResidual(
        direction=direction,
        n_runs=len(after),
        before_pv=float(np.ptp(plain)),
        after_pv=float(np.ptp(mean)),
        wrong_sign_pv=float(np.ptp(flipped)),
        before_rms=float(plain.std()),
        after_rms=float(mean.std()),
        wrong_sign_rms=float(flipped.std()),
        run_before_rms=float(before.std(axis=1).mean()),
        run_after_rms=float(after.std(axis=1).mean()),
        u_after_rms=_u_rms(after),
        u_before_rms=_u_rms(before),
        u_after_pv=_u_pv(after),
        u_before_pv=_u_pv(before),
    )


def _u_rms(runs: FloatArray) -> float | None:
    mean = runs.mean(axis=0)
    rms = float(mean.std())
    return _scatter(runs @ mean / mean.size / rms) if len(runs) > 1 and rms > 0.0 else None


def _u_pv(runs: FloatArray) -> float | None:
    mean = runs.mean(axis=0)
    if len(runs) < 2:
        return None
    return _scatter(runs[:, int(mean.argmax())] - runs[:, int(mean.argmin())])


def _scatter(shares: FloatArray) -> float:
    """Return the standard uncertainty of the mean of what each run contributes."""
    return float(shares.std(ddof=1) / np.sqrt(shares.size))


def _leveled(values: FloatArray, grid: FloatArray, removed: Removed) -> FloatArray:
    if removed == "line":
        half = (grid - grid.mean()) / np.ptp(grid)
        return np.asarray(values - np.polyval(np.polyfit(half, values, 1), half))
    return np.asarray(values - values.mean())
