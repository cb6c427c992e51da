"""What a table is dry-run against: a measured error as one function per run and direction."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from metrosep.core.errors import DataError
from metrosep.core.profile import Profile
from metrosep.core.quantity import Quantity
from metrosep.core.runset import Run, RunSet

__all__ = ["Against", "Curve", "Measured", "measured_error"]

FloatArray = NDArray[np.float64]
Curve = Callable[[FloatArray], FloatArray]


@runtime_checkable
class _Evaluates(Protocol):
    start: float
    stop: float

    def evaluate(self, x: FloatArray, *, direction: int | None = None) -> FloatArray: ...


Against = RunSet | Profile | _Evaluates | Curve


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """A measured error, ready to be looked up.

    Parameters
    ----------
    curves : dict
        For +1 and -1, as far as there is one: a function of position for each run, m.
    span : tuple of (float, float), m
        Positions at which all of them are known.
    knows_lost_motion : bool
        Whether the offset between the directions was measured; a profile or function that
        stands for both directions does not know it.
    u_lost_motion : float or None, m
        Its standard uncertainty where the curves do not show it by their scatter.
    """

    curves: dict[int, list[Curve]]
    span: tuple[float, float]
    knows_lost_motion: bool
    u_lost_motion: float | None = None


def measured_error(against: Against, span: tuple[float, float]) -> Measured:
    """Return a measured error as functions of position.

    Parameters
    ----------
    against : RunSet, Profile, ErrorEstimate or callable
        Error e = actual - nominal in m over position in m.
    span : tuple of (float, float), m
        Range of a callable, which does not tell its own.

    Returns
    -------
    Measured
        Missing samples are bridged inside a run, never extrapolated.

    Raises
    ------
    DataError
        If there is no valid sample, or it is something else.
    """
    if isinstance(against, RunSet):
        ends = np.array([_known(r) for r in against.runs])
        curves = {
            d: [_interpolated(r) for r in against.runs if r.direction == d]
            for d in reversed(against.directions)
        }
        return Measured(
            curves, (float(ends[:, 0].max()), float(ends[:, 1].min())), len(curves) > 1
        )
    if isinstance(against, Profile):
        curve = _interpolated(against)
        return Measured({1: [curve], -1: [curve]}, _known(against), knows_lost_motion=False)
    if isinstance(against, _Evaluates):
        return _of_estimate(against)
    if callable(against):
        return Measured({1: [against], -1: [against]}, span, knows_lost_motion=False)
    raise DataError(
        f"a table cannot be dry-run against a {type(against).__name__}; pass a RunSet, a Profile, an "
        "ErrorEstimate or a function of position"
    )


def _of_estimate(estimate: _Evaluates) -> Measured:
    lost: Quantity | None = getattr(estimate, "lost_motion", None)
    offset = 0.0 if lost is None else lost.value

    def curve(direction: int) -> Curve:
        def at(x: FloatArray) -> FloatArray:
            inside = np.clip(x, estimate.start, estimate.stop)
            shape = estimate.evaluate(inside, direction=direction)
            return shape + offset if direction < 0 else shape

        return at

    return Measured(
        {1: [curve(1)], -1: [curve(-1)]},
        (estimate.start, estimate.stop),
        knows_lost_motion=lost is not None,
        u_lost_motion=None if lost is None else lost.u,
    )


def _known(source: Run | Profile) -> tuple[float, float]:
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
