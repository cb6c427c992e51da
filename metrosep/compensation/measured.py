"""What a table is dry-run against: a measured error as one row for each run, or pair of directions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np

from metrosep.compensation.area_errors import LENGTHS, AxisUnits
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.core.profile import Profile
from metrosep.core.quantity import Quantity
from metrosep.core.runset import Run, RunSet
from metrosep.separation.positions.pitch import REFERENCE_DIRECTIONS

__all__ = [
    "Against",
    "Curve",
    "Measured",
    "Row",
    "at_reference",
    "cooled",
    "estimate_slope",
    "measured_error",
    "paired",
]

Curve = Callable[[FloatArray], FloatArray]


@runtime_checkable
class _Evaluates(Protocol):
    start: float
    stop: float

    def evaluate(self, x: FloatArray, *, direction: int | None = None) -> FloatArray: ...

    def sd(self, x: FloatArray, *, direction: int | None = None) -> FloatArray: ...


Against = RunSet | Profile | _Evaluates | Curve


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """One run, or the two directions of one cycle, which share their zero."""

    name: str  # for messages
    members: tuple[int, ...]  # which runs of the set it is
    curves: dict[int, Curve]  # for +1 and -1, as far as there is one: the error in m over position
    # positions that were measured, rising, m; empty for a function
    places: dict[int, FloatArray] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """A measured error, ready to be looked up."""

    rows: tuple[Row, ...]  # all with the same directions
    span: tuple[float, float]  # of (float, float), m: positions at which all of them are known
    # {"runs", "stated", "estimate"}: readings; an error that somebody states; or one with a
    # standard uncertainty of its own
    kind: Literal["runs", "stated", "estimate"]
    knows_lost_motion: bool  # whether the offset between the directions was measured
    # standard uncertainty in m over position and direction, of an estimate
    sd: Callable[[FloatArray, int], FloatArray] | None = None
    # runs without a partner of the other direction, which are not compared
    unpaired: tuple[str, ...] = ()

    @property
    def directions(self) -> tuple[int, ...]:
        """Those of every row, forward first."""
        return tuple(d for d in (1, -1) if d in self.rows[0].curves)


def measured_error(
    against: Against,
    span: tuple[float, float],
    *,
    with_slope: bool = False,
    units: AxisUnits = LENGTHS,
) -> Measured:
    """Return a measured error as functions of position."""
    if isinstance(against, RunSet):
        return _of_runs(against, units)
    if isinstance(against, Profile):
        x, curve = _interpolated(against)
        row = Row("profile", (), {1: curve, -1: curve}, {1: x, -1: x})
        return Measured((row,), (float(x[0]), float(x[-1])), "stated", knows_lost_motion=False)
    if isinstance(against, _Evaluates):
        return _of_estimate(against, with_slope=with_slope)
    if callable(against):
        row = Row("function", (), {1: against, -1: against})
        return Measured((row,), span, "stated", knows_lost_motion=False)
    raise DataError(
        f"a table cannot be dry-run against a {type(against).__name__}; pass a RunSet, a Profile, an "
        "ErrorEstimate or a function of position"
    )


def paired(runs: RunSet) -> tuple[list[tuple[int, ...]], list[int]]:
    """Return which runs make a row each, and those that are left over."""
    if len(runs.directions) == 1:
        return [(i,) for i in range(len(runs))], []
    index = {id(run): i for i, run in enumerate(runs)}
    groups = [members for _, members in runs.by_feed()]
    groups.append(tuple(r for r in runs if r.feed is None))
    pairs: list[tuple[int, ...]] = []
    left: list[int] = []
    for members in groups:
        ways = [[index[id(r)] for r in members if r.direction == d] for d in (1, -1)]
        pairs += zip(sorted(ways[0]), sorted(ways[1]), strict=False)
        n = min(map(len, ways))
        left += [i for way in ways for i in sorted(way)[n:]]
    if not pairs:  # each direction at feeds of its own
        ways = [[i for i, r in enumerate(runs) if r.direction == d] for d in (1, -1)]
        pairs = list(zip(*ways, strict=False))
        left = sorted(set(range(len(runs))) - {i for pair in pairs for i in pair})
    return sorted(pairs), sorted(left)


def _of_runs(runs: RunSet, units: AxisUnits) -> Measured:
    pairs, left = paired(runs)
    rows = []
    for members in pairs:
        curves, places = {}, {}
        for i in members:
            places[runs[i].direction], curves[runs[i].direction] = _interpolated(runs[i])
        name = " and ".join(_name(runs[i], i) for i in members)
        rows.append(Row(name, members, curves, places))
    names = [row.name for row in rows for _ in row.places]
    ends = np.array([(x[0], x[-1]) for row in rows for x in row.places.values()])
    low, high = float(ends[:, 0].max()), float(ends[:, 1].min())
    if not high > low:
        raise DataError(
            f"the runs do not overlap: run {names[int(ends[:, 0].argmax())]} begins at "
            f"{units.place(low)}, run {names[int(ends[:, 1].argmin())]} ends at "
            f"{units.place(high)}; leave out the runs of another part of the travel"
        )
    return Measured(
        tuple(rows),
        (low, high),
        "runs",
        knows_lost_motion=len(runs.directions) > 1,
        unpaired=tuple(_name(runs[i], i) for i in left),
    )


def _name(run: Run, i: int) -> str:
    return repr(run.run_id) if run.run_id else str(i + 1)


def _of_estimate(estimate: _Evaluates, *, with_slope: bool) -> Measured:
    lost: Quantity | None = getattr(estimate, "lost_motion", None)
    known = lost is not None and bool(np.isfinite(lost.value))
    offset = lost.value if lost is not None and known else 0.0
    slopes = {d: estimate_slope(estimate, d) if with_slope else 0.0 for d in (1, -1)}
    middle = 0.5 * (estimate.start + estimate.stop)

    def curve(direction: int) -> Curve:
        def at(x: FloatArray) -> FloatArray:
            inside = np.clip(x, estimate.start, estimate.stop)
            line = slopes[direction] * (inside - middle)
            shape = estimate.evaluate(inside, direction=direction) + line
            return shape + offset if direction < 0 else shape

        return at

    def sd(x: FloatArray, direction: int) -> FloatArray:
        return estimate.sd(np.clip(x, estimate.start, estimate.stop), direction=direction)

    row = Row("estimate", (), {1: curve(1), -1: curve(-1)})
    return Measured((row,), (estimate.start, estimate.stop), "estimate", known, sd)


def at_reference(
    lookup: Callable[[FloatArray, int], FloatArray], reference: float, way: str
) -> float:
    """Return what is looked up at a reference as it is reached: the mean of its directions."""
    place = np.array([reference])
    return float(np.mean([lookup(place, d)[0] for d in REFERENCE_DIRECTIONS[way]]))


def cooled(runs: RunSet, slope: float, reference: float) -> RunSet:
    """Return readings without the slope that thermal expansion explains."""
    if slope == 0.0:
        return runs
    without = [
        Run(r.x, r.z - slope * (r.x - reference), t=r.t, feed=r.feed, run_id=r.run_id)
        for r in runs
    ]
    return RunSet(without, metadata=runs.metadata, history=runs.history)


def estimate_slope(estimate: Any, direction: int | None = None) -> float:
    """Return the slope that an estimate has removed; it is part of the error of an axis along itself."""
    own = getattr(estimate, "slope_of", None)
    slope: Quantity | None = getattr(estimate, "slope", None) if own is None else own(direction)
    if slope is None or not np.isfinite(slope.value):
        raise DataError(
            "the estimate does not state the slope that it removed, which is part of the error of an "
            "axis along itself: separate again"
        )
    return float(slope.value)


def _interpolated(source: Run | Profile) -> tuple[FloatArray, Curve]:
    """Return the positions that were measured, rising, and the curve through them."""
    valid = ~np.isnan(source.z)
    if not valid.any():
        raise DataError("there is no valid sample to dry-run the table against")
    order = np.argsort(source.x[valid])
    x, z = source.x[valid][order], source.z[valid][order]
    return x, lambda p: np.asarray(np.interp(p, x, z))
