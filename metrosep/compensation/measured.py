"""What a table is dry-run against: a measured error as one row for each run, or pair of directions."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np

from metrosep.compensation.area_errors import LENGTHS, AxisUnits
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError, MetrosepError, TableError
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.core.runset import Run, RunSet
from metrosep.core.units import format_ends, format_length
from metrosep.separation.positions.pitch import REFERENCE_DIRECTIONS
from metrosep.separation.runs.base import ErrorEstimate
from metrosep.separation.runs.design import (
    COVERED,
    lines_of_runs,
    on_common_grid,
    thin_parts,
    travel_of,
)

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
    # holes, from and to in m, in which it takes the shape of the others
    bridged: dict[int, tuple[tuple[float, float], ...]] = field(default_factory=dict)


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
    parts: int = 0  # runs that were joined to rows, where the travel was measured part by part

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
        against.require_metres()
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


def _paired(runs: RunSet) -> tuple[list[tuple[int, ...]], list[int]]:
    """Return which runs make a row each, and those that are left over."""
    if _is_in_parts(runs) and (passes := _passes(runs))[0]:
        return passes
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


def _is_in_parts(runs: RunSet) -> bool:
    """Return whether the travel was measured part by part: no run covers it, and no place is in all."""
    low, high = runs.full_travel
    longest = max(float(np.ptp(r.x)) for r in runs)
    return longest < COVERED * (high - low) and travel_of(runs) == (low, high)


def _passes(runs: RunSet) -> tuple[list[tuple[int, ...]], list[int]]:
    """Return runs of parts that cover the travel together, each run once, and those left over."""
    low, high = runs.full_travel
    margin = (1.0 - COVERED) / 2.0 * (high - low)
    chains: dict[int, list[tuple[int, ...]]] = {}
    for d in runs.directions:
        free = [i for i, r in enumerate(runs) if r.direction == d]
        chains[d] = []
        while True:
            chain, reached = [], low + margin
            while reached < high - margin:
                # the one that begins first of those that carry on: what overlaps most
                carries = [
                    i
                    for i in free
                    if i not in chain and runs[i].x.min() < reached < runs[i].x.max()
                ]
                if not carries:
                    break
                chain.append(min(carries, key=lambda i: (float(runs[i].x.min()), i)))
                reached = float(runs[chain[-1]].x.max())
            if reached < high - margin:
                break
            chains[d].append(tuple(chain))
            free = [i for i in free if i not in chain]
    found = [sum(some, ()) for some in zip(*chains.values(), strict=False)]
    used = {i for members in found for i in members}
    return found, [i for i in range(len(runs)) if i not in used]


def _joined_parts(runs: RunSet) -> tuple[FloatArray, Curve]:
    """Return one pass over the travel: the mean of its parts, their lines fitted together."""
    grid, table, _ = on_common_grid(runs, *runs.full_travel)
    middle, half = 0.5 * (grid[0] + grid[-1]), 0.5 * (grid[-1] - grid[0])
    line = np.column_stack([np.ones(grid.size), (grid - middle) / half])
    lines, _ = lines_of_runs(runs, table, line, np.ones(grid.size, dtype=np.bool_))
    # their mean is not determined by the parts: it stays in what was measured
    level = table - (lines - lines.mean(axis=0)) @ line.T
    seen = ~np.isnan(level).all(axis=0)
    x, z = grid[seen], np.nanmean(level[:, seen], axis=0)
    return x, lambda p: np.asarray(np.interp(p, x, z))


def _of_runs(runs: RunSet, units: AxisUnits) -> Measured:
    pairs, left = _paired(runs)
    in_parts = _is_in_parts(runs) and max(map(len, pairs)) > len(runs.directions)
    rows = []
    for members in pairs:
        curves, places = {}, {}
        for d in runs.directions:
            some = [runs[i] for i in members if runs[i].direction == d]
            places[d], curves[d] = (
                _joined_parts(RunSet(some))
                if in_parts and len(some) > 1
                else _interpolated(some[0])
            )
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
        parts=sum(map(len, pairs)) if in_parts else 0,
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


# ---- leave one run out --------------------------------------------------------------------------
# Leave one run out: what a table would be without each of the runs that made it.
#
# A table that is judged on its own runs is judged with the noise that it holds, so it always seems to
# help. Run k is therefore judged with the table made without it, by the same method and settings; the
# steps of its history say how it was made.

Folds = Sequence[tuple[Sequence[int], Any]]
"""Indices of the runs that were left out, and what is made (or looked up) without them."""

_MOST_FITS = 5
"""A joint estimate takes about a second: more than these fits are not made for a verification."""

_KEPT = 4
"""Sets of folds that are remembered: several tables of one result, or one that is being shaped."""

_MADE: dict[Any, list[tuple[tuple[int, ...], ErrorEstimate]]] = {}


def made_of(
    history: Sequence[Step], runs: RunSet
) -> tuple[Literal["all", "none", "file"], list[int]]:
    """Return whether runs made a table, and which of them did not."""
    stated = {h for s in history for h in s.parameters.get("runs_sha256", ())}
    mine = [str(r.metadata.get("cells_of_sha256", r.sha256)) for r in runs]
    others = [i for i, h in enumerate(mine) if h not in stated]
    if stated and stated == set(mine):
        return "all", []
    if stated and len(others) == len(mine):
        return (
            "file" if set(source_hashes(history)) & set(source_hashes(runs.history)) else "none"
        ), others
    if stated:
        return ("none" if others else "file"), others
    return (
        "all" if set(source_hashes(history)) & set(source_hashes(runs.history)) else "none"
    ), others


def used_runs(history: Sequence[Step], runs: RunSet) -> RunSet:
    """Return the runs without those that a separation omitted (``exclude=``)."""
    out = {h for s in history for h in s.parameters.get("left_out_sha256", ())}
    kept = [r for r in runs if r.metadata.get("cells_of_sha256", r.sha256) not in out]
    if not kept or len(kept) == len(runs):
        return runs
    return RunSet(kept, metadata=runs.metadata, history=runs.history)


def source_hashes(history: Sequence[Step]) -> tuple[str, ...]:
    """Return the hashes of the files that a history begins with."""
    found: list[str] = []
    for step in history:
        value = step.parameters.get("sha256", ())
        found.extend([value] if isinstance(value, str) else map(str, value))
    return tuple(found)


def _groups(runs: RunSet, most: int | None) -> list[tuple[int, ...]]:
    """Return which runs are left out together: pairs of directions, and round robin above `most`."""
    rows, left = _paired(runs)
    rows = [*rows, *((i,) for i in left)]
    if most is None or len(rows) <= most:
        return rows
    return [tuple(sorted(i for row in rows[k::most] for i in row)) for k in range(most)]


def fold_estimates(
    runs: RunSet, history: Sequence[Step], span: tuple[float, float]
) -> list[tuple[tuple[int, ...], ErrorEstimate]]:
    """Return the estimates made without each run, as the history of one from all runs says."""
    step = next((s for s in reversed(history) if s.name == "separate"), None)
    if step is None:
        raise TableError("its history does not say how it was made")
    most = _MOST_FITS if step.parameters.get("method") == "joint" else None
    groups = _groups(runs, most)
    if len(groups) < 2:
        raise TableError("one run made it: nothing is left without it")
    key = (
        tuple((r.sha256, r.feed, None if r.t is None else r.t.tobytes()) for r in runs),
        repr(sorted(step.parameters.items())),
        span,
    )
    if key not in _MADE:
        while len(_MADE) >= _KEPT:
            _MADE.pop(next(iter(_MADE)))
        _MADE[key] = [(out, _without(runs, out, step.parameters, span)) for out in groups]
    return _MADE[key]


def _alone(runs: RunSet, out: tuple[int, ...], span: tuple[float, float]) -> str:
    """Return what only runs that are left out reach of a range, and what all share; empty where others do."""
    near = 1e-6 * (span[1] - span[0])
    rest = RunSet([r for i, r in enumerate(runs) if i not in out])
    holes = [p for p in thin_parts(rest, span[0] + near, span[1] - near) if p[2] == 0]
    if not holes:
        return ""
    names = ", ".join(runs[i].run_id for i in out)
    text = f"without run {names} no run reaches {format_ends(*holes[0][:2])}"
    try:
        low, high = runs.common_travel
    except InvalidSamplesError:  # measured part by part
        return f"{text}: measure there again"
    step = 10.0 ** math.floor(math.log10(high - low) - 3.0)  # four digits, rounded to inside
    first = math.ceil(max(low, span[0]) / step - 1e-6) * step
    length = math.floor((min(high, span[1]) - first) / step + 1e-6) * step
    return (
        f"{text}; all runs share {format_ends(low, high)}: separate with start={format_length(first)!r} "
        f"and length={format_length(length)!r}"
    )


def _without(
    runs: RunSet, out: tuple[int, ...], stated: Mapping[str, Any], span: tuple[float, float]
) -> ErrorEstimate:
    from metrosep.separation.runs.entry import separate_runs

    kept = [i for i in range(len(runs)) if i not in out]
    rest = RunSet([runs[i] for i in kept], metadata=runs.metadata, history=runs.history)
    options = {k: v for k, v in stated.items() if not k.endswith("_sha256") and k != "exclude"}
    options["accept"] = "suspect"  # a run was settled once, with all the others beside it
    start, length = options.pop("start_m", None), options.pop("length_m", None)
    if options["method"] != "kono":  # its range depends on its window
        start, length = span[0], span[1] - span[0]
    if options.get("probes") is not None:
        options["probes"] = [options["probes"][i] for i in kept]
    if options["method"] == "joint" and rest.feeds:
        wanted = options.get("min_feeds", 2)
        options["min_feeds"] = min(wanted, len(rest.feeds))
    # What is wrong with a run was said once, with all the others beside it.
    try:
        return separate_runs(
            rest,
            options.pop("method"),
            length,
            start,
            options.pop("shortest_m", None),
            options.pop("lag_s", 0.0),
            exclude=None,
            accept=options.pop("accept"),
            options=options,
            compare=False,
        )
    except InvalidSamplesError as exc:
        raise TableError(_alone(runs, out, span) or str(exc)) from None


def folds_of(carried: Any, runs: RunSet) -> list[tuple[tuple[int, ...], Any]]:
    """Return what a table or polynomial would be without each of the runs that made it."""
    if any(s.name == "separate" for s in carried.history):
        return [
            (out, carried.remade(estimate))
            for out, estimate in fold_estimates(runs, carried.history, carried.made_over)
        ]
    groups = _groups(runs, None)
    if len(groups) < 2:
        raise TableError("one run made it: nothing is left without it")
    kept = ([r for i, r in enumerate(runs) if i not in out] for out in groups)
    return [(out, carried.remade(RunSet(rest))) for out, rest in zip(groups, kept, strict=True)]


@dataclass(frozen=True, slots=True, eq=False)
class Own:
    """Readings that a table is judged with, and whether they made it."""

    runs: RunSet  # those that are compared
    made_it: bool  # whether the table was made of them
    # of (tuple of int, object) or None: what the controller does with the table made without some
    # of them; None where not known
    folds: Folds | None = None
    why: str = ""  # why a table that was made of them cannot be made without them
    warning: str = ""  # what else to know


def own_runs(
    carried: Any, runs: RunSet, lookup: Callable[[Any], Any], folds: Folds | None = None
) -> Own:
    """Return how runs are to be used to judge a table, with the folds of those that made it."""
    used = used_runs(carried.history, runs)
    if len(used) < len(runs):
        n = len(runs) - len(used)
        own = own_runs(carried, used, lookup, folds)
        excluded = (
            f"{n} of the runs were omitted from the separation (exclude=) and are not judged with"
        )
        return replace(own, warning="; ".join(w for w in (excluded, own.warning) if w))
    if folds is None:
        kind, others = made_of(carried.history, runs)
        if kind == "none":
            if len(others) in (0, len(runs)):
                return Own(runs, made_it=False)
            alone = RunSet([runs[i] for i in others], metadata=runs.metadata, history=runs.history)
            left = len(runs) - len(others)
            return Own(
                alone, made_it=False, warning=f"{left} of the runs made it and are not used"
            )
        if kind == "file":
            return Own(
                runs,
                made_it=True,
                why="the file is one that made it, but its rows were read in another way than for the table: "
                "name the same columns and options as then",
            )
    if folds is None and any("cells_of_sha256" in r.metadata for r in runs):
        why = runs.metadata.get("no_folds")
        return Own(
            runs,
            made_it=True,
            why=why or "the result holds means of cells of the runs and no folds",
        )
    try:
        made = folds_of(carried, runs) if folds is None else folds
        return Own(runs, made_it=True, folds=tuple((tuple(o), lookup(t)) for o, t in made))
    except MetrosepError as exc:
        return Own(runs, made_it=True, why=str(exc))
