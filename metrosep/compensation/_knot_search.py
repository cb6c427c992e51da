"""Private: the search for knots, for `knots`: fewest for a tolerance, best for a number."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metrosep.compensation._tunnel import fewest_chords, fewest_links, minimax_values
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import NotConvergedError

_CANDIDATES = 600
"""Samples at which a knot on the curve may lie; more are thinned, the deviation is not."""

_BISECTIONS = 60
"""Halvings of the tolerance at most; each costs one pass over the samples."""

_CLOSE = 1e-5
"""Relative width at which the bisection of the tolerance ends."""

_PINCH = 1e-6
"""Half-width of the tunnel at the reference over the tolerance; the rest is shifted away."""

_TALL = 64.0
"""Tolerance over the height of the curve beyond which no more knots are hoped for."""

_INSIDE = 3e-6
"""Share of the tolerance kept free for that shift and for rounding."""

_DISTINCT = 1e-8
"""Samples closer than this over the range are one for the search (rounded twins)."""

NOTHING = 1e-11
"""Deviation over the height of the curve that is rounding."""

_APART = 1e-9
"""Knots closer than this over the range are one."""

_FEW = 1000
"""So many samples are searched as they are; of more, first these, then a thinned curve."""

_NEAR = 0.01
"""Relative distance of the tolerance of all samples from that of a thousand, in most cases."""

_THIN = 2e-4
"""Deviation of the thinned curve over the tolerance: the knots are so near to the best."""


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
    knots, heights = _strict(knots, heights, t, y, float(half.max()))
    places = x[0] + knots * (x[-1] - x[0])
    places[-1] = x[-1]
    return places, middle + heights * height


def _strict(
    knots: FloatArray, heights: FloatArray, t: FloatArray, y: FloatArray, half: float
) -> tuple[FloatArray, FloatArray]:
    """Return knots that rise strictly from 0 to 1; those that fall together become one."""
    knots = np.clip(knots, 0.0, 1.0)
    knots[[0, -1]] = 0.0, 1.0
    gaps = np.diff(knots)
    if (gaps > _APART).all():
        return knots, heights
    # of a pair the knot that ends the longer link stays, of a pair at an end that end
    keep = np.r_[True, gaps > _APART]
    keep[-1] = True
    late = np.flatnonzero(keep[:-1] & (knots[:-1] >= 1.0 - _APART))
    keep[late[late > 0]] = False
    merged, values = knots[keep], heights[keep]
    first = np.flatnonzero(keep)
    first[0] = np.flatnonzero(knots <= _APART)[-1]
    for trial in (values, heights[first]):
        if residual(t, y, merged, trial) <= half * (1.0 + 1e-6) + NOTHING:
            return merged, trial
    if (gaps > 0.0).all():
        return knots, heights
    raise NotConvergedError(
        "the tunnel is narrower than the rounding of the curve: use a larger tolerance"
    )


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
    nothing = NOTHING * float(np.abs(c).max())
    corners = _corners_of(x, c, values, zero)
    if corners.size <= n and residual(x, c, corners, np.interp(corners, x, c)) <= nothing:
        return corners, np.interp(corners, x, c)
    if values == "free" and x.size > _FEW:
        some = _some(x, zero)
        rough = residual(x[some], c[some], *_halved(x[some], c[some], n, values, zero))
        kept = thinned(x, c, max(_THIN * rough, nothing), zero)
        return _halved(x[kept], c[kept], n, values, zero, near=rough)
    return _halved(x, c, n, values, zero)


def _halved(
    x: FloatArray, c: FloatArray, n: int, values: str, zero: float | None, near: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Return the knots; `near` is where the tolerance is expected, which saves halvings."""
    nothing = NOTHING * float(np.abs(c).max())
    equal = np.linspace(x[0], x[-1], n)
    high = 2.0 * max(residual(x, c, equal, np.interp(equal, x, c)), nothing)
    high, low = min(high, max((1.0 + _NEAR) * near, nothing)) if near else high, 0.0
    while (best := _tried(x, c, high, n, values, zero)) is None:
        if high > _TALL * max(float(np.abs(c).max()), nothing):
            raise NotConvergedError(
                f"no polyline of {n} knots was found for the curve; ask for more knots"
            )
        low, high = high, 2.0 * high
    if near:
        below = (1.0 - _NEAR) * near
        found = _tried(x, c, below, n, values, zero)
        if found is None:
            low = max(low, below)
        else:
            best, high = found, below
    for _ in range(_BISECTIONS):
        if high - low <= _CLOSE * high or high <= nothing:
            break
        middle = 0.5 * (low + high)
        found = _tried(x, c, middle, n, values, zero)
        if found is not None:
            best = found
            high = min(middle, max(residual(x, c, *found), low))
        else:
            low = middle
    return best


def _tried(
    x: FloatArray, c: FloatArray, tolerance: float, n: int, values: str, zero: float | None
) -> tuple[FloatArray, FloatArray] | None:
    """Return at most `n` knots within a tolerance, None where more are needed or rounding stops."""
    try:
        found = fewest_knots(x, c, tolerance, values, zero)
    except NotConvergedError:
        return None
    return found if found[0].size <= n else None


def _corners_of(x: FloatArray, c: FloatArray, values: str, zero: float | None) -> FloatArray:
    """Return the samples at which the curve bends by more than rounding, and its ends."""
    share = (x[1:-1] - x[:-2]) / (x[2:] - x[:-2])
    off = np.abs(c[1:-1] - (1.0 - share) * c[:-2] - share * c[2:])
    corners = x[np.r_[True, off > 1e-13 * float(np.abs(c).max()), True]]
    return corners if zero is None or values == "free" else np.union1d(corners, [zero])


def _some(x: FloatArray, zero: float | None) -> NDArray[np.intp]:
    some = np.linspace(0, x.size - 1, _FEW).round().astype(np.intp)
    return np.union1d(some, np.flatnonzero(x == zero)) if zero is not None else np.unique(some)


def thinned(
    x: FloatArray, c: FloatArray, tolerance: float, zero: float | None
) -> NDArray[np.intp]:
    """Return samples between which the curve is straight to a tolerance; ends and reference stay."""
    kept = [0]
    x0, c0 = float(x[0]), float(c[0])
    lowest, highest = -np.inf, np.inf
    must = -1 if zero is None else int(np.flatnonzero(x == zero)[0])
    places, curve = x.tolist(), c.tolist()
    last = 0
    for i in range(1, x.size):
        d = places[i] - x0
        slope = (curve[i] - c0) / d
        if i - 1 == must > last or not lowest <= slope <= highest:
            last = i - 1
            kept.append(last)
            x0, c0 = places[last], curve[last]
            lowest, highest = -np.inf, np.inf
            d = places[i] - x0
        lowest = max(lowest, (curve[i] - tolerance - c0) / d)
        highest = min(highest, (curve[i] + tolerance - c0) / d)
    return np.array([*kept, x.size - 1], dtype=np.intp)


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
