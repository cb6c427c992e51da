"""Whether values over parts differ at all, or by the rounding of their own computation only.

What a fit takes away is zero but for rounding: the piston of a map that was levelled is 1e-24 m beside
heights of 1e-8 m. Rounding is deterministic, so it may well rise from part to part; a test against
its own scatter would call that a drift.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from metrosep.core._arrays import FloatArray

__all__ = ["RELATIVE_FLOOR", "constant", "floors", "term_floors"]

RELATIVE_FLOOR = 1e-12
"""Of the largest value. A float rounds to 1.1e-16 of itself; a sum of n heights one by one, or normal
equations of condition n, lose n times that: 1e4 leaves a floor of 1e-12."""

_MOST = {"m": 1e-15, "rad": 1e-15}
"""Of a floor from other terms, in m and rad: a radius of 1 km beside roughness does not make 1 nm a
rounding, and nothing here measures 1 fm."""


def floors(sizes: Iterable[tuple[str, float]]) -> dict[str, float]:
    """Return the spread up to which values of a unit are the same, by unit."""
    largest: dict[str, float] = {}
    for unit, value in sizes:
        if unit in _MOST and math.isfinite(value):
            largest[unit] = max(largest.get(unit, 0.0), abs(value))
    return {u: min(RELATIVE_FLOOR * size, _MOST[u]) for u, size in largest.items()}


def constant(values: Sequence[float] | FloatArray, floor: float = 0.0) -> bool:
    """Return whether values are the same to within rounding.

    Examples
    --------
    >>> constant([1e-24, -3e-24], 2e-20), constant([1e-9, 1.001e-9], 2e-20)
    (True, False)
    """
    known = np.asarray(values, dtype=np.float64)
    known = known[np.isfinite(known)]
    if known.size == 0:
        return True
    least, most = float(known.min()), float(known.max())
    return most - least <= max(floor, RELATIVE_FLOOR * max(abs(least), abs(most)))


def term_floors(
    table: Mapping[str, FloatArray], units: Mapping[str, str], sizes: Mapping[str, float] | None
) -> dict[str, float]:
    """Return the floor of each term of a table."""
    of = {k: units.get(k, "m") for k in table}
    found = floors(
        [*((of[k], float(x)) for k, v in table.items() for x in v), *(sizes or {}).items()]
    )
    return {k: found.get(u, 0.0) for k, u in of.items()}
