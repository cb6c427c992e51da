"""`GridView` and the checks on views of a grid plate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, NotSeparableError, UnitError
from metrosep.separation._real_numbers import real_numbers

__all__ = ["GridView", "checked_placement", "checked_size", "parsed_views", "refuse_inseparable"]


_MOST_SITES = 31 * 31

_NAMED = {"initial": (0, (0, 0)), "rotated": (1, (0, 0)), "shifted": (0, (1, 0))}


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class GridView:
    """Readings of a grid plate in one placement.

    Parameters
    ----------
    readings : array_like, shape (n_y, n_x, 2) or (n_repeats, n_y, n_x, 2), m
        Reading minus nominal position of the mark at each site of the stage, x and y component
        along the axes of the stage; NaN where no mark is or was read.
    turns : int, optional
        Quarter turns of the plate about the centre of the lattice, from x towards y.
    shift : tuple of (int, int), pitches, optional
        Shift of the plate along x and y of the stage, after the turn.
    """

    readings: ArrayLike
    turns: int = 0
    shift: tuple[int, int] = (0, 0)

    def __repr__(self) -> str:
        return f"GridView({np.shape(self.readings)}, turns={self.turns}, shift={self.shift})"


def parsed_views(
    views: Mapping[str, ArrayLike] | Sequence[GridView],
) -> list[tuple[GridView, FloatArray]]:
    if isinstance(views, Mapping):
        unknown = [name for name in views if name not in _NAMED]
        if unknown:
            raise DataError(
                f"views are named {', '.join(_NAMED)}, got {unknown}; use GridView for others"
            )
        views = [GridView(r, _NAMED[n][0], _NAMED[n][1]) for n, r in views.items()]
    out = []
    items: list[Any] = list(views)
    for i, view in enumerate(items, start=1):
        if not isinstance(view, GridView):
            raise DataError(f"view {i} is a {type(view).__name__}; give GridView objects")
        values = np.array(real_numbers(view.readings, f"view {i}: readings"), dtype=np.float64)
        values = values[np.newaxis] if values.ndim == 3 else values
        if values.ndim != 4 or values.shape[-1] != 2 or np.isinf(values).any():
            raise DataError(
                f"view {i}: readings must have the shape (n_y, n_x, 2), x and y component, finite "
                f"or NaN; got {values.shape}"
            )
        turns, shift = checked_placement(view, i)
        out.append((GridView(view.readings, turns, shift), values))
    return out


def checked_placement(view: GridView, number: int) -> tuple[int, tuple[int, int]]:
    """Return turns and shift as whole numbers."""
    whole: list[int] = []
    given: list[Any] = []
    try:
        given = [view.turns, *view.shift]
        whole = [int(k) for k in given]
    except (TypeError, ValueError, OverflowError):
        whole = []
    if len(whole) != 3 or whole != given:
        raise DataError(
            f"view {number}: turns is a whole number of 90 degrees and shift a pair of whole "
            f"pitches (x, y), such as (1, 0); got turns={view.turns!r}, shift={view.shift!r}"
        )
    return whole[0], (whole[1], whole[2])


def checked_size(views: list[tuple[GridView, FloatArray]], pitch: float) -> tuple[int, int]:
    shapes = {values.shape[1:3] for _, values in views}
    if len(shapes) > 1:
        raise DataError(f"the views differ in shape: {sorted(shapes)}; use NaN where no mark is")
    if not shapes:
        raise NotSeparableError("there is no view; give initial, rotated and shifted")
    n_y, n_x = shapes.pop()
    if min(n_x, n_y) < 3 or n_x * n_y > _MOST_SITES:
        raise DataError(f"the lattice is {n_y} x {n_x}; it must have 3 x 3 to 961 sites")
    if (n_x - n_y) % 2 and any(v.turns % 2 for v, _ in views):
        raise DataError(
            f"a lattice of {n_y} x {n_x} does not fall onto itself when turned about its centre; "
            "use numbers of rows and columns that are both even or both odd"
        )
    for i, (_, values) in enumerate(views, start=1):
        known = np.abs(values[~np.isnan(values)])
        if known.size and known.max() > 0.5 * pitch:
            raise UnitError(
                f"view {i}: a reading of {known.max():.4g} m exceeds half the pitch of {pitch:.4g} "
                "m; give reading minus nominal position, in m"
            )
    return n_y, n_x


def refuse_inseparable(views: list[tuple[GridView, FloatArray]]) -> None:
    turns = {(v.turns - views[0][0].turns) % 4 for v, _ in views}
    placements = {(v.turns % 4, v.shift) for v, _ in views}
    missing = []
    if not turns & {1, 3}:
        missing.append("a view turned by 90 degrees")
    one_each = len(placements) < 3 and len(placements) == len({t for t, _ in placements})
    if one_each or len({s for _, s in placements}) == 1:
        missing.append("a view shifted by one pitch")
    if missing:
        raise NotSeparableError(
            f"these views cannot tell the stage from the plate: {' and '.join(missing)} is missing"
        )
