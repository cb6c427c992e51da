"""Knots placed where the error needs them, for carriers whose spacing is free or whose knots are few.

A controller that takes free positions (TwinCAT cross compensation) or only a few (Fanuc
straightness: 4) interpolates linearly between them. The knots here make the largest deviation of
that polyline small, with values on the curve or free; a free value halves the deviation.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray, frozen_float
from metrosep.core.docs import described_by
from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotConvergedError,
    TableError,
    TooFewSamplesError,
)
from metrosep.core.units import format_ends, format_length

Curve = ArrayLike | Callable[[FloatArray], FloatArray]
Values = Literal["free", "on curve"]
_VALUES = ("free", "on curve")


@dataclass(frozen=True, slots=True, eq=False)
class Knots:
    """A polyline that stands for a curve; frozen.

    Parameters
    ----------
    positions : ndarray, shape (n,), m
        Strictly rising, first and last at the ends of the curve.
    values : ndarray, shape (n,), m
        Of the polyline there.
    residual : float, m
        Largest deviation from the curve, which is linear between its samples; of all samples and
        knots.
    values_are : {"free", "on curve"}
        Whether the values were free or are those of the curve.
    messages : tuple of str
        What deserves attention.
    """

    positions: FloatArray
    values: FloatArray
    residual: float
    values_are: Values
    messages: tuple[str, ...] = ()

    def __call__(self, x: ArrayLike) -> FloatArray:
        """Return the polyline, constant outside."""
        at = np.asarray(x, dtype=np.float64)
        return np.asarray(np.interp(at, self.positions, self.values))

    @property
    def audit(self) -> dict[str, Any]:
        """Plain values with units in the keys, for sidecars and reports."""
        return {
            "n_knots": int(self.positions.size),
            "positions_mm": (self.positions * 1e3).tolist(),
            "values_nm": (self.values * 1e9).tolist(),
            "residual_nm": self.residual * 1e9,
            "values_are": self.values_are,
            "definition": "largest |polyline - curve|, curve linear between its samples, no filter",
        }


def choose_knots(
    x: ArrayLike,
    c: Curve,
    n: int,
    *,
    values: Values = "free",
    reference: float | None = None,
    grid: ArrayLike | None = None,
) -> Knots:
    """Return `n` knots whose polyline deviates least from a curve.

    Parameters
    ----------
    x : array_like, shape (m,), m
        Positions of the samples, strictly rising; dense against the bends of the curve.
    c : array_like, shape (m,), m, or callable
        Error or correction at `x`.
    n : int
        Number of knots, the two ends included; Fanuc straightness has 4.
    values : {"free", "on curve"}, optional
        Free values, or those of the curve.
    reference : float, m, optional
        Position where the polyline is exactly zero; the curve must be zero there.
    grid : array_like, shape (k,), m, optional
        Positions at which knots may lie; the ends of the curve belong to it in any case.

    Returns
    -------
    Knots
        Exactly `n`; where fewer would do, the others halve the longest intervals.

    Raises
    ------
    TooFewSamplesError
        If `n` or the number of samples is below 2.
    InvalidSamplesError
        If positions do not rise, or something is not a finite number.
    DataError
        If lengths differ, `n` is not a whole number or `values` is unknown.
    TableError
        If the curve is not zero at the reference, `n` exceeds what the grid holds, or 2 knots on
        the curve shall hold a reference between them.
    NotConvergedError
        If the linear program for values on a grid fails, or no polyline is found.

    Notes
    -----
    Free values: the fewest links through the tunnel curve +- tolerance are found by the greedy
    propagation of windows [1]_, and the tolerance is bisected. Both steps are exact for the curve
    that is linear between its samples, to 1e-5 of the tolerance. Values on the curve: shortest
    path over chords that stay in the tunnel [2]_, knots at samples (600 of them at most).
    Where the curve has no more corners than `n`, they are the knots, and the answer is exact.
    Of more than 1000 samples a thinned curve is searched, within 2e-4 of the tolerance, so that
    the residual is within 4e-4 of the best; what is stated is that of all samples.
    On a grid the better of two sets of positions is taken, with the best values for it by linear
    programming: near-exact.
    For a parabola of curvature a, n - 1 equal intervals h: a h^2/8 on the curve, a h^2/16 free.

    References
    ----------
    .. [1] S. Suri, A linear time algorithm for minimum link paths inside a simple polygon,
       Comput. Vision Graphics Image Process. 35 (1986) 99-110.
    .. [2] H. Imai, M. Iri, Polygonal approximations of a curve, in Computational Morphology (1988).

    Examples
    --------
    >>> import numpy as np
    >>> x = np.linspace(0.0, 1.0, 401)
    >>> k = choose_knots(x, 1e-6 * x**2, 4)
    >>> bool(abs(k.residual - 2e-6 * (1 / 3) ** 2 / 16) < 1e-10)
    True
    """
    places, curve = _samples(x, c)
    numbers.choice(values, "values", _VALUES)
    n = numbers.count(n, "the number of knots", least=0)
    if n < 2:
        raise TooFewSamplesError(f"a polyline needs at least 2 knots, got n={n}")
    places, curve, zero = _with_reference(places, curve, reference)
    if grid is not None:
        allowed = frozen_float(grid, name="grid", ndim=1)
        return _on_grid(places, curve, n, values, zero, allowed)
    if values == "on curve" and zero is not None and n < 3 and places[0] < zero < places[-1]:
        raise TableError(
            f"2 knots on the curve are its ends, but the reference {format_length(zero)} lies between "
            "them and needs a knot of its own; ask for n=3 at least, or values='free'"
        )
    knots, heights = knots_of_number(places, curve, n, values, zero)
    return _finish(places, curve, *padded(knots, heights, n), values, zero)


@described_by(choose_knots, errors=False)
def knots_for_tolerance(
    x: ArrayLike,
    c: Curve,
    tolerance: float | str,
    *,
    values: Values = "free",
    reference: float | None = None,
    max_knots: int | None = None,
) -> Knots:
    """Return the fewest knots whose polyline stays within a tolerance of a curve.

    Parameters
    ----------
    tolerance : float or str, m
        Largest deviation allowed, positive; "50 nm" works, too.
    max_knots : int, optional
        What the controller takes.

    Returns
    -------
    Knots
        Residual at most `tolerance`, to rounding.

    Raises
    ------
    TooFewSamplesError
        If there are fewer than 2 samples.
    InvalidSamplesError
        If positions do not rise or a sample is not finite.
    DataError
        If lengths differ, `values` is unknown, or the tolerance is not positive or below rounding.
    TableError
        If the curve is not zero at the reference, or more than `max_knots` are needed.

    Notes
    -----
    As for `choose_knots`, without the bisection: the greedy tunnel is optimal.

    Examples
    --------
    >>> import numpy as np
    >>> x = np.linspace(0.0, 1.0, 401)
    >>> knots_for_tolerance(x, abs(x - 0.3) * 1e-6, 1e-9).positions.size
    3
    """
    places, curve = _samples(x, c)
    numbers.choice(values, "values", _VALUES)
    tolerance = numbers.positive(tolerance, "the tolerance", dimension="length")
    least = NOTHING * float(np.abs(curve).max())
    if tolerance < least:
        raise DataError(
            f"the tolerance {tolerance:.3g} m is below the rounding of the curve, {least:.3g} m: use "
            "a larger one"
        )
    places, curve, zero = _with_reference(places, curve, reference)
    found = fewest_knots(places, curve, tolerance, values, zero)
    if max_knots is not None and found[0].size > max_knots:
        best = choose_knots(places, curve, max_knots, values=values, reference=zero)
        raise TableError(
            f"{found[0].size} knots are needed for {format_length(tolerance)}, the controller takes "
            f"{max_knots}; with those the deviation is {format_length(best.residual)}: accept it "
            "(choose_knots) or smooth the error"
        )
    return _finish(places, curve, *found, values, zero)


@described_by(choose_knots, errors=False)
def optimal_values(
    x: ArrayLike, c: Curve, positions: ArrayLike, *, reference: float | None = None
) -> Knots:
    """Return the values at given knots whose polyline deviates least from a curve.

    Parameters
    ----------
    positions : array_like, shape (n,), m
        Knots, strictly rising, first and last at the ends of `x`.

    Returns
    -------
    Knots
        Minimax values (a linear program).

    Raises
    ------
    TooFewSamplesError
        If there are fewer than 2 samples or knots.
    InvalidSamplesError
        If positions do not rise or a sample is not finite.
    DataError
        If lengths differ.
    TableError
        If the knots do not end where the samples end, or the curve is not zero at the reference.
    NotConvergedError
        If the linear program fails.
    """
    places, curve = _samples(x, c)
    knots = np.array(frozen_float(positions, name="positions", ndim=1, min_size=2))
    _check_rising(knots, "positions")
    margin = 1e-9 * (places[-1] - places[0])
    if abs(knots[0] - places[0]) > margin or abs(knots[-1] - places[-1]) > margin:
        raise TableError(
            f"the knots span {format_ends(float(knots[0]), float(knots[-1]))}, "
            f"the samples {format_ends(float(places[0]), float(places[-1]))}: "
            "the first and last knot must be the ends"
        )
    knots[0], knots[-1] = places[0], places[-1]
    places, curve, zero = _with_reference(places, curve, reference)
    return _finish(places, curve, knots, best_values(places, curve, knots, zero), "free", zero)


def _samples(x: ArrayLike, c: Curve) -> tuple[FloatArray, FloatArray]:
    places = frozen_float(x, name="x", ndim=1, min_size=2)
    _check_rising(places, "x")
    curve = frozen_float(c(places.copy()) if callable(c) else c, name="the curve", ndim=1)
    if curve.shape != places.shape:
        raise DataError(
            f"x has shape {places.shape}, the curve {curve.shape}; one value a position"
        )
    bad = np.flatnonzero(~np.isfinite(curve))
    if bad.size:
        i = int(bad[0])
        raise InvalidSamplesError(
            f"the curve is {curve[i]} at {places[i] * 1e3:.9g} mm ({bad.size} of {curve.size}): a "
            "gap is not bridged; narrow the range to what was measured"
        )
    return places, curve


def _check_rising(x: FloatArray, name: str) -> None:
    if x.ndim != 1 or x.size < 2:
        raise TooFewSamplesError(
            f"{name} needs at least 2 positions in a row, got shape {x.shape}"
        )
    if not np.isfinite(x).all():
        raise InvalidSamplesError(f"{name} holds a position that is not finite; remove it")
    bad = np.flatnonzero(np.diff(x) <= 0.0)
    if bad.size:
        i = int(bad[0])
        raise InvalidSamplesError(
            f"{name} must rise strictly: entry {i} is {x[i] * 1e3:.9g} mm, entry {i + 1} is "
            f"{x[i + 1] * 1e3:.9g} mm; sort and remove duplicates"
        )


def _with_reference(
    x: FloatArray, c: FloatArray, reference: float | None
) -> tuple[FloatArray, FloatArray, float | None]:
    """Make the reference a sample, and refuse a curve that is not zero there."""
    if reference is None:
        return x, c, None
    zero = numbers.quantity(reference, "reference", "length")
    if not x[0] <= zero <= x[-1]:
        raise TableError(
            f"the reference {format_length(zero)} lies outside {format_ends(float(x[0]), float(x[-1]))}"
        )
    value = float(np.interp(zero, x, c))
    if abs(value) > 1e-9 * float(np.abs(c).max()):
        raise TableError(
            f"the curve is {format_length(value)} at the reference {format_length(zero)}: subtract it "
            "first, the entry there must be exactly 0"
        )
    places = np.union1d(x, [zero])
    curve = np.interp(places, x, c)
    curve[places == zero] = 0.0
    return places, curve, zero


def _on_grid(
    x: FloatArray, c: FloatArray, n: int, values: Values, zero: float | None, grid: FloatArray
) -> Knots:
    """Return knots at places of a grid: the best chain of chords, or the free knots moved to it."""
    _check_rising(grid, "grid")
    grid = _snapped(grid, x)
    inside = grid[(grid > x[0]) & (grid < x[-1])]
    allowed = np.r_[x[0], inside, x[-1]]
    if n > allowed.size:
        raise TableError(
            f"{n} knots are asked for, the grid holds {allowed.size} between the ends of the curve; "
            "ask for fewer or use a finer grid"
        )
    places = np.union1d(x, allowed)
    curve = np.interp(places, x, c)
    nodes = np.asarray(np.searchsorted(places, allowed), dtype=np.intp)
    chain = chain_of_number(places, curve, n, nodes)
    if values == "on curve":
        chain = padded_on_curve(places, curve, chain, allowed, n)
        return _finish(x, c, chain, np.interp(chain, x, c), values, zero)
    free = knots_of_number(x, c, n, "free", zero)[0]
    moved = allowed[np.abs(allowed[:, None] - free[None, :]).argmin(axis=0)]
    trials = [padded_on(np.unique(k), allowed, n) for k in (chain, moved)]
    done = [_finish(x, c, k, best_values(x, c, k, zero), values, zero) for k in trials]
    return min(done, key=lambda k: k.residual)


def _snapped(grid: FloatArray, x: FloatArray) -> FloatArray:
    """Return the grid with the samples themselves where only rounding is between them."""
    nearest = x[np.clip(np.searchsorted(x, grid), 1, x.size - 1)]
    before = x[np.clip(np.searchsorted(x, grid), 1, x.size - 1) - 1]
    nearest = np.where(grid - before < nearest - grid, before, nearest)
    same = np.abs(nearest - grid) <= 1e-9 * (x[-1] - x[0])
    return np.unique(np.where(same, nearest, grid))


def _finish(
    x: FloatArray,
    c: FloatArray,
    knots: FloatArray,
    values: FloatArray,
    values_are: Values,
    zero: float | None,
) -> Knots:
    messages: list[str] = []
    if zero is not None:
        values = values - np.interp(zero, knots, values)
        near = np.abs(knots - zero) <= 1e-9 * (x[-1] - x[0])
        knots, values = np.where(near, zero, knots), np.where(near, 0.0, values)
        if not near.any():
            messages.append(
                f"no knot lies at the reference {format_length(zero)}: the polyline passes zero there"
            )
    positions, heights = np.array(knots), np.array(values)
    positions.setflags(write=False)
    heights.setflags(write=False)
    return Knots(
        positions, heights, residual(x, c, positions, heights), values_are, tuple(messages)
    )


# ---- the search for knots: fewest for a tolerance, best for a number ----------------------------

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
        some = np.linspace(0, x.size - 1, _FEW).round().astype(np.intp)
        some = np.union1d(some, [] if zero is None else np.flatnonzero(x == zero)).astype(np.intp)
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
    """Return the values at knots whose polyline deviates least from samples at most."""
    height = float(np.abs(c).max()) or 1.0
    start, length = float(x[0]), float(x[-1] - x[0])
    where = None if zero is None else (zero - start) / length
    best = minimax_values((x - start) / length, c / height, (knots - start) / length, where)
    return best * height


def residual(x: FloatArray, c: FloatArray, knots: FloatArray, values: FloatArray) -> float:
    """Return the largest distance of samples, joined by lines, from the polyline of knots."""
    at = np.union1d(x, knots)
    return float(np.abs(np.interp(at, knots, values) - np.interp(at, x, c)).max())


# ---- private: polylines with the fewest links inside a tunnel around a curve; best values at knots ----
# Lines are points (value, slope) of a plane; each sample of the tunnel cuts the polygon of the lines
# that still pass by two half-planes. Where nothing is left, the line that got farthest is a link,
# and the next one starts anywhere on the rest of that link (a window).

Point = tuple[float, float]
Polygon = list[Point]

_FAR = 100.0
"""Start of the search: values and slopes so many times the height and the steepest tunnel."""

_ON_BOUND = 1e-11
"""Distance from a bound, over the height of the tunnel, that counts as contact."""


def fewest_links(
    x: FloatArray, low: FloatArray, high: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return knots of a polyline with free values between two bounds, fewest links.

    The bounds are linear between the samples. Units: x and values of order 1.
    """
    lines: list[tuple[float, float, float]] = []  # x0, value there, slope
    start_high = start_low = reached = 0
    extra: tuple[float, float, bool] | None = None  # place, bound, is it the lower one
    while True:
        line, failed, up = _longest(x, low, high, start_low, start_high, extra)
        if failed is not None and failed <= reached:
            raise NotConvergedError(
                "the tunnel is narrower than the rounding of the curve: use a larger tolerance"
            )
        reached = failed or reached
        lines.append(line)
        if failed is None:
            return _corners(x, lines)
        x0, v0, s0 = line
        bound, other = (low, high) if up else (high, low)
        gap = bound - (v0 + s0 * (x - x0))
        # between the samples before and at the failure the link leaves the tunnel
        share = gap[failed - 1] / (gap[failed - 1] - gap[failed])
        leave = x[failed - 1] + min(max(float(share), 0.0), 1.0) * (x[failed] - x[failed - 1])
        contact = _contact(x, other, line, start_high if up else start_low, failed)
        extra = (float(leave), v0 + s0 * (float(leave) - x0), up)
        start_low, start_high = (failed, contact) if up else (contact, failed)


def _contact(
    x: FloatArray, bound: FloatArray, line: tuple[float, float, float], first: int, failed: int
) -> int:
    """Return the last sample before the failure at which a link touches the other bound."""
    x0, v0, s0 = line
    if first >= failed:
        return failed - 1
    room = np.abs(bound[first:failed] - (v0 + s0 * (x[first:failed] - x0)))
    near = np.flatnonzero(room <= room.min() + _ON_BOUND)
    return first + int(near[-1])


def _longest(
    x: FloatArray,
    low: FloatArray,
    high: FloatArray,
    start_low: int,
    start_high: int,
    extra: tuple[float, float, bool] | None,
) -> tuple[tuple[float, float, float], int | None, bool]:
    """Return the line that gets farthest, the sample at which it fails, and whether it was too low."""
    first = min(start_low, start_high)
    x0 = float(x[first])
    polygon = _everything(x, low, high, x0)
    if extra is not None:
        place, value, is_low = extra
        polygon = _cut(polygon, place - x0, value, 1.0 if is_low else -1.0)
    away = (x[first:] - x0).tolist()
    lows, highs = low[first:].tolist(), high[first:].tolist()
    for k, (d, lowest, highest) in enumerate(zip(away, lows, highs, strict=True), start=first):
        reach = [v + s * d for v, s in polygon]
        most, least = max(reach), min(reach)
        if k >= start_low and most < lowest:
            v, s = polygon[reach.index(most)]
            return (x0, v, s), k, True
        if k >= start_high and least > highest:
            v, s = polygon[reach.index(least)]
            return (x0, v, s), k, False
        if k >= start_low and least < lowest:
            polygon = _cut(polygon, d, lowest, 1.0)
        if k >= start_high and most > highest:
            polygon = _cut(polygon, d, highest, -1.0)
    v = sum(p[0] for p in polygon) / len(polygon)
    s = sum(p[1] for p in polygon) / len(polygon)
    return (x0, v, s), None, False


def _everything(x: FloatArray, low: FloatArray, high: FloatArray, x0: float) -> Polygon:
    height = float(np.ptp(np.r_[low, high]))
    middle = float(np.mean(low))
    steep = _FAR * max(height / float(np.diff(x).min()), 1e-300)
    tall = _FAR * height + steep * float(x[-1] - x0)
    return [
        (middle - tall, -steep),
        (middle + tall, -steep),
        (middle + tall, steep),
        (middle - tall, steep),
    ]


def _cut(polygon: Polygon, d: float, bound: float, sign: float) -> Polygon:
    """Return the part of a convex polygon where ``sign (v + s d - bound) >= 0``."""
    distance = [sign * (v + s * d - bound) for v, s in polygon]
    if max(distance) < 0.0:  # by rounding: the two bounds meet in the last vertex
        return [polygon[distance.index(max(distance))]]
    kept: Polygon = []
    for i, point in enumerate(polygon):
        here, before = distance[i], distance[i - 1]
        if (here >= 0.0) != (before >= 0.0):
            t = before / (before - here)
            old = polygon[i - 1]
            kept.append((old[0] + t * (point[0] - old[0]), old[1] + t * (point[1] - old[1])))
        if here >= 0.0:
            kept.append(point)
    return kept


def _corners(
    x: FloatArray, lines: list[tuple[float, float, float]]
) -> tuple[FloatArray, FloatArray]:
    places, values = [float(x[0])], []
    x0, v0, s0 = lines[0]
    values.append(v0 + s0 * (float(x[0]) - x0))
    for (xa, va, sa), (xb, vb, sb) in itertools.pairwise(lines):
        at = (vb - va + sa * xa - sb * xb) / (sa - sb)
        places.append(at)
        values.append(va + sa * (at - xa))
    x0, v0, s0 = lines[-1]
    places.append(float(x[-1]))
    values.append(v0 + s0 * (float(x[-1]) - x0))
    return np.array(places), np.array(values)


def fewest_chords(
    x: FloatArray, c: FloatArray, tolerance: float, nodes: NDArray[np.intp]
) -> FloatArray:
    """Return the positions of the fewest knots on the curve whose chords stay within a tolerance.

    `nodes` are the samples at which a knot may lie, first and last sample among them.
    """
    far = nodes.size
    links = np.full(far, far, dtype=np.intp)
    came = np.zeros(far, dtype=np.intp)
    links[0] = 0
    for i in range(far - 1):
        if links[i] == far:
            continue
        d = x[nodes[i] + 1 :] - x[nodes[i]]
        rise = c[nodes[i] + 1 :] - c[nodes[i]]
        upper = np.minimum.accumulate((rise + tolerance) / d)
        lower = np.maximum.accumulate((rise - tolerance) / d)
        ends = nodes[i + 1 :] - nodes[i] - 1
        slope = rise[ends] / d[ends]
        passes = (slope <= upper[ends]) & (slope >= lower[ends])
        better = i + 1 + np.flatnonzero(passes & (links[i + 1 :] > links[i] + 1))
        links[better], came[better] = links[i] + 1, i
    path = [far - 1]
    while path[-1] > 0:
        path.append(int(came[path[-1]]))
    if x.size and links[-1] == far:
        raise NotConvergedError(
            f"no chain of chords on the allowed knots stays within {tolerance:.3g} m; add knots to "
            "the grid"
        )
    return np.asarray(x[nodes[path[::-1]]])


def minimax_values(
    x: FloatArray, c: FloatArray, knots: FloatArray, zero: float | None
) -> FloatArray:
    """Return values at knots with the smallest largest deviation; values of order 1, x rising."""
    from scipy.optimize import linprog
    from scipy.sparse import coo_matrix, hstack, vstack

    # at knots between samples the deviation can be largest too
    places = np.union1d(x, knots)
    wanted = np.interp(places, x, c)
    hats = _hats(places, knots)
    ones = coo_matrix(np.ones((places.size, 1)))
    matrix = vstack([hstack([hats, -ones]), hstack([-hats, -ones])]).tocsr()
    equal, right = None, None
    if zero is not None:
        row = _hats(np.array([zero]), knots)
        equal, right = hstack([row, coo_matrix((1, 1))]).tocsr(), np.zeros(1)
    result = linprog(
        np.r_[np.zeros(knots.size), 1.0],
        A_ub=matrix,
        b_ub=np.r_[wanted, -wanted],
        A_eq=equal,
        b_eq=right,
        bounds=[(None, None)] * knots.size + [(0.0, None)],
        method="highs",
    )
    if not result.success or result.x is None:
        raise NotConvergedError(f"the linear program for the values failed: {result.message}")
    return np.asarray(result.x[:-1], dtype=np.float64)


def _hats(places: FloatArray, knots: FloatArray):  # type: ignore[no-untyped-def]
    """Return the matrix of the linear interpolation between knots, sparse."""
    from scipy.sparse import coo_matrix

    left = np.clip(np.searchsorted(knots, places, side="right") - 1, 0, knots.size - 2)
    share = (places - knots[left]) / (knots[left + 1] - knots[left])
    rows = np.arange(places.size)
    return coo_matrix(
        (np.r_[1.0 - share, share], (np.r_[rows, rows], np.r_[left, left + 1])),
        shape=(places.size, knots.size),
    )
