"""Private: the search for knots, for `knots`: fewest for a tolerance, best for a number."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metrosep.compensation._tunnel import fewest_chords, fewest_links, minimax_values
from metrosep.core.errors import NotConvergedError

FloatArray = NDArray[np.float64]

_CANDIDATES = 600
"""Samples at which a knot on the curve may lie; more are thinned, the deviation is not."""

_BISECTIONS = 60
"""Halvings of the tolerance at most; each costs one pass over the samples."""

_CLOSE = 1e-5
"""Relative width at which the bisection of the tolerance ends."""

_PINCH = 1e-6
"""Half-width of the tunnel at the reference over the tolerance; the rest is shifted away."""

_INSIDE = 3e-6
"""Share of the tolerance kept free for that shift and for rounding."""

_DISTINCT = 1e-8
"""Samples closer than this over the range are one for the search (rounded twins)."""

NOTHING = 1e-11
"""Deviation over the height of the curve that is rounding."""


def fewest_knots(
    x: FloatArray, c: FloatArray, tolerance: float, values: str, zero: float | None
) -> tuple[FloatArray, FloatArray]:
    """Return the fewest knots for a tolerance."""
    if values == "on curve":
        return _chords(x, c, tolerance, zero)
    height = max(float(np.ptp(c)), tolerance)
    middle = float(c[0])
    t, y = (x - x[0]) / (x[-1] - x[0]), (c - middle) / height
    half = np.full(x.size, tolerance / height * (1.0 - _INSIDE))
    if zero is not None:
        half[x == zero] *= _PINCH
    keep = np.r_[True, np.diff(t[:-1]) > _DISTINCT, True] | (x == zero)
    knots, heights = fewest_links(t[keep], (y - half)[keep], (y + half)[keep])
    places = x[0] + np.clip(knots, 0.0, 1.0) * (x[-1] - x[0])
    places[-1] = x[-1]
    return places, middle + heights * height


def _chords(
    x: FloatArray, c: FloatArray, tolerance: float, zero: float | None
) -> tuple[FloatArray, FloatArray]:
    """Return the fewest knots on the curve, the reference one of them."""
    parts = [slice(0, x.size)]
    if zero is not None and x[0] < zero < x[-1]:
        i = int(np.flatnonzero(x == zero)[0])
        parts = [slice(0, i + 1), slice(i, x.size)]
    found = [fewest_chords(x[p], c[p], tolerance, _candidates(x[p])) for p in parts]
    places = np.unique(np.concatenate(found))
    return places, np.interp(places, x, c)


def _candidates(x: FloatArray) -> NDArray[np.intp]:
    """Return the samples at which a knot may lie: all, or evenly thinned in number."""
    return np.unique(np.linspace(0, x.size - 1, min(x.size, _CANDIDATES)).round().astype(np.intp))


def knots_of_number(
    x: FloatArray, c: FloatArray, n: int, values: str, zero: float | None
) -> tuple[FloatArray, FloatArray]:
    """Return at most `n` knots with the smallest tolerance, found by halving it."""
    equal = np.linspace(x[0], x[-1], n)
    high = 2.0 * residual(x, c, equal, np.interp(equal, x, c))
    if high <= NOTHING * float(np.abs(c).max()):
        return equal, np.interp(equal, x, c)
    while (best := fewest_knots(x, c, high, values, zero))[0].size > n:
        high *= 2.0
    low = 0.0
    for _ in range(_BISECTIONS):
        if high - low <= _CLOSE * high or high <= NOTHING * float(np.abs(c).max()):
            break
        middle = 0.5 * (low + high)
        found = fewest_knots(x, c, middle, values, zero)
        if found[0].size <= n:
            best = found
            high = min(middle, max(residual(x, c, *found), low))
        else:
            low = middle
    return best


def chain_of_number(x: FloatArray, c: FloatArray, n: int, nodes: NDArray[np.intp]) -> FloatArray:
    """Return at most `n` of the nodes whose chords deviate least."""
    high = 2.0 * float(np.ptp(c)) or 1.0
    low, best = 0.0, x[[0, -1]]
    for _ in range(_BISECTIONS):
        if high - low <= _CLOSE * high:
            break
        middle = 0.5 * (low + high)
        try:
            found = fewest_chords(x, c, middle, nodes)
        except NotConvergedError:
            found = x
        if found.size <= n:
            best, high = found, middle
        else:
            low = middle
    return best


def padded(knots: FloatArray, values: FloatArray, n: int) -> tuple[FloatArray, FloatArray]:
    """Halve the longest intervals until there are `n` knots; the polyline stays as it is."""
    places = knots
    while places.size < n:
        i = int(np.diff(places).argmax())
        places = np.insert(places, i + 1, 0.5 * (places[i] + places[i + 1]))
    return places, np.interp(places, knots, values)


def padded_on(knots: FloatArray, allowed: FloatArray, n: int) -> FloatArray:
    """Add the places of the grid that lie farthest from a knot until there are `n`."""
    while knots.size < n:
        distance = np.abs(allowed[:, None] - knots[None, :]).min(axis=1)
        knots = np.union1d(knots, [allowed[int(distance.argmax())]])
    return knots


def padded_on_curve(
    x: FloatArray, c: FloatArray, knots: FloatArray, allowed: FloatArray, n: int
) -> FloatArray:
    """Add the place of the grid that costs least until there are `n`.

    A knot on the curve can make a chain worse that was best with fewer.
    """
    while knots.size < n:
        left = np.setdiff1d(allowed, knots)
        trials = [np.union1d(knots, [place]) for place in left]
        deviations = [float(np.abs(np.interp(x, t, np.interp(t, x, c)) - c).max()) for t in trials]
        knots = trials[int(np.argmin(deviations))]
    return knots


def best_values(x: FloatArray, c: FloatArray, knots: FloatArray, zero: float | None) -> FloatArray:
    height = float(np.abs(c).max()) or 1.0
    start, length = float(x[0]), float(x[-1] - x[0])
    where = None if zero is None else (zero - start) / length
    best = minimax_values((x - start) / length, c / height, (knots - start) / length, where)
    return best * height


def residual(x: FloatArray, c: FloatArray, knots: FloatArray, values: FloatArray) -> float:
    at = np.union1d(x, knots)
    return float(np.abs(np.interp(at, knots, values) - np.interp(at, x, c)).max())
