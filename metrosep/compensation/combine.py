"""A table that was active while its successor was measured, and the successor, as one table.

With the old table active the machine goes to ``p + c_old(p) + e(p + c_old(p))``: the new measurement
sees ``e2(p) = c_old(p) + e(p + c_old(p))``, and the new corrections solve ``c_new(p) = -e2(p +
c_new(p))``. Put together, a command p becomes ``p + c_new(p)``, and that is where the old table is
looked up:

    c(p) = c_new(p) + c_old(p + c_new(p)),    which gives  c(p) = -e(p + c(p)).

Where another axis is corrected, the position looked up does not move: ``c = c_new + c_old``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, overload

import numpy as np

from metrosep.compensation.area_errors import ErrorMap, bilinear, format_position
from metrosep.compensation.maps import CompensationMap
from metrosep.compensation.measured import at_reference
from metrosep.compensation.sampling import (
    Covariance,
    JoinedCovariance,
    RestOfOld,
    variance,
)
from metrosep.compensation.table import CompensationTable
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, TableError
from metrosep.core.provenance import Step
from metrosep.core.runset import Run, RunSet

Table = CompensationTable | CompensationMap
Lookup = Callable[[FloatArray], FloatArray]

_SAME = 1e-9
"""Positions closer than this, relative to the span, are one."""

_SETTLED = 1e-13
"""A tenth of a picometre."""

_HOMED = {
    "forward": "forward",
    "reverse": "in reverse",
    "middle": "in the mean of both directions",
}

_STEPS = 40
"""Of the fixed point ``p = x - c_old(p)``; slopes of 1e-3 need five."""


@overload
def combine_tables(old: CompensationTable, new: CompensationTable) -> CompensationTable: ...
@overload
def combine_tables(old: CompensationMap, new: CompensationMap) -> CompensationMap: ...
def combine_tables(old: Table, new: Table) -> Table:
    """Return the one table that does what a new table does on top of the one that was active.

    Parameters
    ----------
    old : CompensationTable or CompensationMap
        What was active in the controller during the measurement behind `new`.
    new : CompensationTable or CompensationMap
        What that measurement gave, of the same kind, axes and reference. Where one has a column for each direction and the
        other has not, that one acts alike in both.

    Returns
    -------
    CompensationTable or CompensationMap
        To be loaded INSTEAD of `old`, on the positions of both. At the entries of `new` its
        uncertainty is that of `new`: what was wrong with `old` is in the new measurement. Between and
        beyond them what `new` leaves of the errors of `old` is added. None where `new` states no u,
        or `old` none and reaches farther.

    Raises
    ------
    DataError
        If one is a table and the other a map, or either is something else.
    TableError
        If axes or reference differ, or nothing of the two overlaps.

    Notes
    -----
    If `new` was measured with `old` switched off, load `new` as it is: combined, the error would be
    corrected twice. On-axis the bends of `old` come to lie where the corrected command meets them,
    nanometres beside its positions; what keeping its positions costs is in
    ``interpolation_error``. Tables made of estimates know the covariance of their entries, and u
    takes it: between entries of `new`, and for the errors of `old`, of which
    ``d(p) - (d looked up as in new)`` is left. Tables of files do not, and maps neither: there u of
    `new` is interpolated, an upper bound; beyond `new` the u of `old` here and at its end are added,
    another one; and between its entries the errors of `old` are taken as straight.
    Outside its own positions each of the two is held, as the controller
    does. ``removed`` is that of `new`: what the old table lacks, the new measurement has seen.

    References
    ----------
    .. [1] controllers notes, section 8, check 10.

    Examples
    --------
    >>> import numpy as np
    >>> p = np.array([0.0, 0.1])
    >>> old = CompensationTable(p, [0.0, -9e-6], None, "X", "Z", 0.0)
    >>> new = CompensationTable(p, [0.0, -1e-6], None, "X", "Z", 0.0)
    >>> combine_tables(old, new).forward.round(12).tolist()
    [0.0, -1e-05]
    """
    if isinstance(old, CompensationTable) and isinstance(new, CompensationTable):
        return _tables(old, new)
    if isinstance(old, CompensationMap) and isinstance(new, CompensationMap):
        return _maps(old, new)
    raise DataError(
        f"a {type(old).__name__} and a {type(new).__name__} cannot be combined: give two tables or "
        "two maps"
    )


def _tables(old: CompensationTable, new: CompensationTable) -> CompensationTable:
    _refuse_other_axes((old.axis,), (new.axis,), old.compensates, new.compensates)
    _refuse_other_reference((old.axis,), (old.reference,), (new.reference,), _reach(old.positions))
    _refuse_apart(old.axis, old.span, new.span)
    _refuse_other_homing(old, new)
    if (old.reverse is None) != (new.reverse is None):
        old, new = _split(old), _split(new)
    positions = _union(old.positions, new.positions)
    at = 1.0 if old.is_on_axis else 0.0

    def total(direction: int) -> Lookup:
        def lookup(p: FloatArray) -> FloatArray:
            c = new.correction(p, direction)
            return np.asarray(c + old.correction(p + at * c, direction))

        return lookup

    ways = (1,) if new.reverse is None else (1, -1)
    columns = {d: total(d)(positions) for d in ways}
    # what is zero at the reference is so exactly; the column of the other direction is not zero there
    for d, c in columns.items():
        columns[d] = np.where((positions == new.reference) & (np.abs(c) < _SETTLED), 0.0, c)
    missed = 0.0  # by straight pieces of the sum, which bends where p + c_new meets old
    for d in ways if old.is_on_axis else ():
        bends = _solved(partial(new.correction, direction=d), old.positions)
        off = total(d)(bends) - np.interp(bends, positions, columns[d])
        missed = max(missed, float(np.abs(off).max()))
    return replace(
        new,
        positions=positions,
        forward=columns[1],
        reverse=columns.get(-1),
        u=_u_of_tables(old, new, positions),
        covariances=_joined(old, new),
        interpolation_error=_plus(new.interpolation_error, missed),
        source=_source(old, new),
        **_common(old, new),
    )


def _split(table: CompensationTable) -> CompensationTable:
    """Return a table with a column for each direction, alike where it had one."""
    if table.reverse is not None:
        return table
    same = {d: table.covariances[1] for d in (1, -1) if 1 in table.covariances}
    return replace(table, reverse=table.forward, covariances=same)


def _u_of_tables(
    old: CompensationTable, new: CompensationTable, positions: FloatArray
) -> FloatArray | None:
    """Return the uncertainty of the sum, of the less certain direction; see `entry_covariance`."""
    inside = np.clip(positions, *new.span)
    beyond = positions != inside
    if new.u is None or (old.u is None and beyond.any()):
        return None
    bound = np.interp(inside, new.positions, new.u) ** 2
    squares = np.array([variance(c, positions) for c in new.covariances.values()] or [bound])
    if old.u is None:
        return np.asarray(np.sqrt(squares.max(axis=0)))
    if old.covariances:
        rests = [RestOfOld(c, new.positions) for c in old.covariances.values()]
        return np.asarray(
            np.sqrt(np.max(squares + [variance(r, positions) for r in rests], axis=0))
        )
    there, end = (np.interp(x, old.positions, old.u) for x in (positions, inside))
    return np.asarray(np.sqrt(squares.max(axis=0) + np.where(beyond, there + end, 0.0) ** 2))


def _joined(old: CompensationTable, new: CompensationTable) -> dict[int, Covariance]:
    """Return the covariance of the sum by direction; empty where that of one is not known."""
    if new.u is None or old.u is None or set(old.covariances) != set(new.covariances):
        return {}
    return {
        d: JoinedCovariance(RestOfOld(old.covariances[d], new.positions), c)
        for d, c in new.covariances.items()
    }


def _source(old: CompensationTable, new: CompensationTable) -> RunSet | None:
    """Return the error without any table: ``e = e2(p) - c_old(p)`` at ``p + c_old(p)``."""
    if new.source is None:
        return None
    runs = []
    for run in new.source.runs:
        c = old.correction(run.x, run.direction)
        moved = run.x + c if old.is_on_axis else run.x
        runs.append(Run(moved, run.z - c, run_id=run.run_id))
    return RunSet(runs)


def _maps(old: CompensationMap, new: CompensationMap) -> CompensationMap:
    _refuse_other_axes(old.axes, new.axes, old.compensates, new.compensates)
    for axis, mine, theirs in zip(old.axes, old.span, new.span, strict=True):
        _refuse_apart(axis, mine, theirs)
    reach = max(_reach(old.x), _reach(old.y))
    _refuse_other_reference(old.axes, old.reference, new.reference, reach)
    x, y = _union(old.x, new.x), _union(old.y, new.y)
    values = _sum_of(old, new, x, y)
    here = (y == new.reference[1])[:, None] & (x == new.reference[0])
    values = np.where(here, 0.0, values)
    missed = 0.0
    if old.is_on_axis:
        bend_x, bend_y = _map_bends(old, new)
        missed = float(
            np.abs(
                _sum_of(old, new, bend_x, bend_y, grid=False)
                - bilinear(x, y, values, bend_x, bend_y)
            ).max()
        )
    same_ring = old.border == new.border and old.span == new.span
    return replace(
        new,
        x=x,
        y=y,
        values=values,
        u=_u_of_maps(old, new, x, y),
        interpolation_error=_plus(new.interpolation_error, missed),
        border=new.border if same_ring else None,
        source=_map_source(old, new),
        **_common(old, new),
    )


def _u_of_maps(
    old: CompensationMap, new: CompensationMap, x: FloatArray, y: FloatArray
) -> FloatArray | None:
    """Return the upper bound of the uncertainty of the sum."""
    (low_x, high_x), (low_y, high_y) = new.span
    in_x, in_y = np.clip(x, low_x, high_x), np.clip(y, low_y, high_y)
    beyond = (in_x != x) | (in_y != y)[:, None]
    if new.u is None or (old.u is None and beyond.any()):
        return None
    u = bilinear(new.x, new.y, new.u, in_x, in_y[:, None])
    if old.u is None or not beyond.any():
        return u
    there = bilinear(old.x, old.y, old.u, x, y[:, None])
    end = bilinear(old.x, old.y, old.u, in_x, in_y[:, None])
    return np.asarray(np.hypot(u, np.where(beyond, there + end, 0.0)))


def _sum_of(
    old: CompensationMap, new: CompensationMap, x: FloatArray, y: FloatArray, *, grid: bool = True
) -> FloatArray:
    px, py = np.meshgrid(x, y) if grid else (x, y)
    c = new.correction(px, py)
    along_x, along_y = (c if old.compensates == a else 0.0 for a in old.axes)
    return np.asarray(c + old.correction(px + along_x, py + along_y))


def _map_bends(old: CompensationMap, new: CompensationMap) -> tuple[FloatArray, FloatArray]:
    """Return the places whose corrected commands are the nodes of the old map."""
    px, py = (p.ravel() for p in np.meshgrid(old.x, old.y))
    if old.compensates == old.axes[0]:
        return _solved(lambda p: new.correction(p, py), px), py
    return px, _solved(lambda p: new.correction(px, p), py)


def _map_source(old: CompensationMap, new: CompensationMap) -> ErrorMap | None:
    """Return the error without any map, on the places of the new measurement."""
    if new.source is None:
        return None
    seen = new.source
    x, y = np.meshgrid(seen.x, seen.y)
    px, py = x, y
    if old.compensates == old.axes[0]:
        px = _solved(lambda p: old.correction(p, y), x)
    elif old.compensates == old.axes[1]:
        py = _solved(lambda p: old.correction(x, p), y)
    return ErrorMap(seen.x, seen.y, seen(px, py) - old.correction(px, py), seen.history)


def _solved(correction: Lookup, target: FloatArray) -> FloatArray:
    """Return p with ``p + c(p) = target``."""
    p = target
    for _ in range(_STEPS):
        before, p = p, target - correction(p)
        if float(np.abs(p - before).max()) < _SETTLED:
            break
    return np.asarray(p)


def _union(one: FloatArray, two: FloatArray) -> FloatArray:
    """Return the positions of both; those of `two` that differ from one by rounding are left out."""
    same = _SAME * max(_reach(one), _reach(two))
    i = np.clip(np.searchsorted(one, two), 1, one.size - 1)
    away = np.minimum(np.abs(two - one[i - 1]), np.abs(two - one[i]))
    return np.asarray(np.sort(np.concatenate([one, two[away > same]])))


def _reach(positions: FloatArray) -> float:
    return float(positions[-1] - positions[0])


def _plus(one: float | None, more: float) -> float | None:
    return None if one is None else one + more


def _common(old: Table, new: Table) -> dict[str, Any]:
    spans = {"old_span_si": _plain(old.span), "new_span_si": _plain(new.span)}
    step = Step("combine", {"rule": "c_new(p) + c_old(p + c_new(p))", **spans})
    return {
        "offset_removed": old.offset_removed + new.offset_removed,
        "source_sha256": tuple(dict.fromkeys((*old.source_sha256, *new.source_sha256))),
        "history": (*old.history, *new.history, step),
    }


def _plain(span: Any) -> list[Any]:
    return [_plain(s) if isinstance(s, tuple) else s for s in span]


def _refuse_other_axes(
    old: tuple[str, ...], new: tuple[str, ...], old_target: str, new_target: str
) -> None:
    if old != new or old_target != new_target:
        raise TableError(
            f"the old table is {', '.join(old)} -> {old_target}, the new one {', '.join(new)} -> "
            f"{new_target}: only tables of the same axes, in the same order, add up; keep both in "
            "the controller if it can hold them"
        )


def _refuse_other_reference(
    axes: tuple[str, ...], old: tuple[float, ...], new: tuple[float, ...], reach: float
) -> None:
    for axis, one, two in zip(axes, old, new, strict=True):
        if abs(one - two) > _SAME * reach:
            raise TableError(
                f"the old table is zero at {format_position(axis, one)}, the new one at "
                f"{format_position(axis, two)}: together they would move the zero of the machine; make "
                "the new one with the reference of the old"
            )


def _refuse_other_homing(old: CompensationTable, new: CompensationTable) -> None:
    """Refuse a new table whose reference is reached from a side where the old one is not zero."""
    if old.reference_direction == new.reference_direction or not old.is_on_axis:
        return
    if abs(at_reference(old.correction, new.reference, new.reference_direction)) > _SETTLED:
        raise TableError(
            f"the old table is zero at {format_position(old.axis, old.reference)} as it is reached "
            f"{_HOMED[old.reference_direction]}, the new one as it is reached "
            f"{_HOMED[new.reference_direction]}: together they would move the zero of the machine; make "
            f'the new one with reference_direction="{old.reference_direction}"'
        )


def _refuse_apart(axis: str, old: tuple[float, float], new: tuple[float, float]) -> None:
    if new[0] >= old[1] or old[0] >= new[1]:
        raise TableError(
            f"the old table covers {format_position(axis, old[0])} ... "
            f"{format_position(axis, old[1])}, the new one {format_position(axis, new[0])} ... "
            f"{format_position(axis, new[1])}: they do not overlap; check units and origin"
        )
