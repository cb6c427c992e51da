"""Knots placed where the error needs them, for carriers whose spacing is free or whose knots are few.

A controller that takes free positions (TwinCAT cross compensation) or only a few (Fanuc
straightness: 4) interpolates linearly between them. The knots here make the largest deviation of
that polyline small, with values on the curve or free; a free value halves the deviation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from metrosep.compensation._knot_search import (
    NOTHING,
    best_values,
    chain_of_number,
    fewest_knots,
    knots_of_number,
    padded,
    padded_on,
    padded_on_curve,
    residual,
)
from metrosep.core import numbers
from metrosep.core._arrays import FloatArray, frozen_float
from metrosep.core.docs import described_by
from metrosep.core.errors import DataError, InvalidSamplesError, TableError, TooFewSamplesError
from metrosep.core.units import format_length

__all__ = ["Curve", "Knots", "choose_knots", "knots_for_tolerance", "optimal_values"]

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
            f"the knots span {format_length(float(knots[0]))} ... {format_length(float(knots[-1]))}, "
            f"the samples {format_length(float(places[0]))} ... {format_length(float(places[-1]))}: "
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
            f"the reference {format_length(zero)} lies outside {format_length(float(x[0]))} ... "
            f"{format_length(float(x[-1]))}"
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
