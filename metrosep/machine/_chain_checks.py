"""Private: what a chain must be: closed, with unique names, no axis twice by accident."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.machine import _poses as ps
from metrosep.machine.elements import BRANCHES, Element, located_axis

_PARALLEL = 1e-6  # rad; axes of one kind closer than this are the same axis


def refuse_twice(names: Sequence[str], what: str) -> None:
    """Refuse a name that is used twice."""
    twice = sorted({n for n in names if names.count(n) > 1})
    if twice:
        raise DataError(f"{what} {twice[0]!r} is used twice in the chain; names are unique")


def refuse_strange_names(elements: Sequence[Element]) -> None:
    """Refuse location errors and ``parallel_to`` that name no axis of the chain."""
    kinds = {e.name: e.kind for e in elements if e.kind != "fixed"}
    known = ", ".join(kinds)
    for e in elements:
        for term in e.location_errors:
            axis = located_axis(term)
            if axis not in kinds:
                raise DataError(
                    f"location error {term!r} of {e.name!r}: the chain has no axis {axis!r}; "
                    f"its axes are {known}"
                )
        if e.parallel_to is None:
            continue
        if kinds.get(e.parallel_to) != e.kind:
            found = kinds.get(e.parallel_to, "no axis of the chain")
            raise DataError(
                f"{e.name!r} ({e.kind}) has parallel_to = {e.parallel_to!r}, which is {found}; "
                f"it names an axis of the same kind, its axes are {known}"
            )


def refuse_parallel(elements: Sequence[Element]) -> None:
    """Refuse two axes along one direction with all axes at zero, unless they say so."""
    directions = _directions_at_home(elements)
    groups = _declared_groups(elements)
    moving = [e for e in elements if e.kind != "fixed"]
    for i, one in enumerate(moving):
        for two in moving[i + 1 :]:
            if one.kind != two.kind or groups[one.name] == groups[two.name]:
                continue
            along = directions[one.name]
            if np.linalg.norm(np.cross(along, directions[two.name])) < _PARALLEL:
                text = ", ".join(f"{c:.6g}" for c in along + 0.0)
                raise DataError(
                    f"axes {one.name!r} and {two.name!r} are both {one.kind} along ({text}) of the "
                    f"bed; if that is meant, write parallel_to = {one.name!r} in {two.name!r}"
                )


def _directions_at_home(elements: Sequence[Element]) -> dict[str, FloatArray]:
    """Return the directions of the axes in the bed: only fixed parts turn anything at home."""
    turned = {branch: np.eye(3) for branch in BRANCHES}
    found = {}
    for e in elements:
        found[e.name] = turned[e.branch] @ np.array(e.direction)
        if e.kind == "fixed":
            turned[e.branch] = turned[e.branch] @ np.array(
                ps.rotation(e.direction, float(e.angle))
            )
    return found


def _declared_groups(elements: Sequence[Element]) -> dict[str, str]:
    """Return a name for each set of axes that repeat one another, however the chain says it."""
    group = {e.name: e.name for e in elements}
    for e in elements:
        if e.parallel_to is not None:
            old, new = group[e.name], group[e.parallel_to]
            group = {name: new if g == old else g for name, g in group.items()}
    return group
