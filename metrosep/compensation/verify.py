"""The dry-run: what a correction makes of a measured error, before a machine sees it.

The correction is applied as the controller applies it: looked up at the command and added to it.
Of the readings of several runs the mean over the runs of one direction is corrected, because no
table can remove what does not repeat; single runs are reported beside it. From every curve the
offset is removed (a run has no absolute zero), and its line where the table was made from an
estimate without alignment.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from metrosep.core.errors import DataError, SignCheckFailedError, TableError
from metrosep.core.profile import Profile
from metrosep.core.runset import Run, RunSet
from metrosep.core.units import format_length

__all__ = ["DirectionResidual", "Verification", "dry_run"]

FloatArray = NDArray[np.float64]
Correction = Callable[[FloatArray, int], FloatArray]
Removed = Literal["offset", "line"]

_GRID_POINTS = 2001
_NAMES = {1: "forward", -1: "reverse"}


class _Evaluates(Protocol):
    start: float
    stop: float

    def evaluate(self, x: FloatArray, *, direction: int | None = None) -> FloatArray: ...


Against = RunSet | Profile | _Evaluates


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
    u_after_rms : float or None, m
        Standard uncertainty of `after_rms` from the scatter of the runs, to first order; None
        for one run.
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
    """

    residuals: tuple[DirectionResidual, ...]
    removed: Removed
    span: tuple[float, float]

    @property
    def passed(self) -> bool:
        """Whether the error shrinks in every direction."""
        return all(r.passed for r in self.residuals)

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
                }
                for r in self.residuals
            ],
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
            If P-V or RMS does not shrink in some direction.
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
    against : RunSet, Profile or an estimate
        Measured error e = actual - nominal over position.
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
    """
    curves, low, high = _curves(against)
    first, last = max(span[0], low), min(span[1], high)
    if not last > first:
        raise TableError(
            f"the table covers {format_length(span[0])} ... {format_length(span[1])}, the measurement "
            f"{format_length(low)} ... {format_length(high)}: they do not overlap; check the units and "
            "the origin of the positions"
        )
    grid = np.linspace(first, last, _GRID_POINTS)
    residuals = tuple(
        _direction_residual(d, members, grid, correction, on_axis=on_axis, removed=removed)
        for d, members in curves.items()
    )
    return Verification(residuals, removed, (first, last))


Curve = Callable[[FloatArray], FloatArray]


def _curves(against: Against) -> tuple[Mapping[int, list[Curve]], float, float]:
    if isinstance(against, RunSet):
        ends = np.array([_measured(r) for r in against.runs])
        return (
            {
                d: [_interpolated(r) for r in against.runs if r.direction == d]
                for d in reversed(against.directions)
            },
            float(ends[:, 0].max()),
            float(ends[:, 1].min()),
        )
    if isinstance(against, Profile):
        curve = _interpolated(against)
        return {1: [curve], -1: [curve]}, *_measured(against)
    return (
        {d: [_of_estimate(against, d)] for d in (1, -1)},
        against.start,
        against.stop,
    )


def _of_estimate(estimate: _Evaluates, direction: int) -> Curve:
    def curve(x: FloatArray) -> FloatArray:
        inside = np.clip(x, estimate.start, estimate.stop)
        return estimate.evaluate(inside, direction=direction)

    return curve


def _measured(source: Run | Profile) -> tuple[float, float]:
    """First and last position that was measured: what is not is not compared."""
    x = source.x[~np.isnan(source.z)]
    if x.size == 0:
        raise DataError("there is no valid sample to dry-run the table against")
    return float(x.min()), float(x.max())


def _interpolated(source: Run | Profile) -> Curve:
    valid = ~np.isnan(source.z)
    order = np.argsort(source.x[valid])
    x, z = source.x[valid][order], source.z[valid][order]
    return lambda p: np.interp(p, x, z)


def _direction_residual(
    direction: int,
    members: list[Curve],
    grid: FloatArray,
    correction: Correction,
    *,
    on_axis: bool,
    removed: Removed,
) -> DirectionResidual:
    c = correction(grid, direction)
    before = np.array([_leveled(f(grid), grid, removed) for f in members])
    after = np.array([_leveled(f(grid + c * on_axis) + c, grid, removed) for f in members])
    wrong = np.array([_leveled(f(grid - c * on_axis) - c, grid, removed) for f in members])
    n = len(members)
    mean = after.mean(axis=0)
    rms = float(mean.std())
    return DirectionResidual(
        direction=direction,
        n_runs=n,
        before_pv=float(np.ptp(before.mean(axis=0))),
        after_pv=float(np.ptp(mean)),
        wrong_sign_pv=float(np.ptp(wrong.mean(axis=0))),
        before_rms=float(before.mean(axis=0).std()),
        after_rms=rms,
        wrong_sign_rms=float(wrong.mean(axis=0).std()),
        run_before_rms=float(before.std(axis=1).mean()),
        run_after_rms=float(after.std(axis=1).mean()),
        u_after_rms=_scatter(after @ mean / mean.size / rms) if n > 1 and rms > 0.0 else None,
    )


def _scatter(shares: FloatArray) -> float:
    """Return the standard uncertainty of a mean: each run's share in the RMS of the mean curve."""
    return float(shares.std(ddof=1) / np.sqrt(shares.size))


def _leveled(values: FloatArray, grid: FloatArray, removed: Removed) -> FloatArray:
    if removed == "line":
        half = (grid - grid.mean()) / np.ptp(grid)
        return np.asarray(values - np.polyval(np.polyfit(half, values, 1), half))
    return np.asarray(values - values.mean())
