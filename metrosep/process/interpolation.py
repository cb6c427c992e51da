"""What a controller makes of the points of a block program: lines, a C2 cubic spline, PVT; arc lengths.

Positions are arc lengths that grow strictly; the values are heights. The controller knows the
points only, so the course between them is decided here. A spline needs two end conditions, and
every function names the one that it used.
"""

from __future__ import annotations

import math
from typing import Any, Literal, Protocol, get_args

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray, frozen_float, same_length
from metrosep.core.docs import described_by
from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotConvergedError,
    TooFewSamplesError,
)
from metrosep.process._plain import length

EndCondition = Literal["not-a-knot", "natural", "clamped"]
Interpolation = Literal["linear", "spline", "pvt"]

FEWEST_KNOTS = 4
"""A cubic spline without a knot at its second point needs four."""


class Height(Protocol):
    """A surface as a function of x and y, m."""

    def __call__(self, x: Any, y: Any, /) -> Any:
        """Return heights, m."""


def knot_slopes(
    s: ArrayLike,
    z: ArrayLike,
    *,
    end: EndCondition = "not-a-knot",
    end_slopes: tuple[float, float] = (0.0, 0.0),
) -> FloatArray:
    """Return the slope dz/ds of the interpolating C2 cubic spline at its knots.

    Parameters
    ----------
    s : array_like, shape (n,), m
        Positions, strictly growing, n >= 4.
    z : array_like, shape (n,), m
        Heights there, finite.
    end : {"not-a-knot", "natural", "clamped"}, optional
        The third derivative is continuous at the second and last but one point; the second
        derivative is zero at the ends; the slope at the ends is `end_slopes`.
    end_slopes : tuple of (float, float), m/m, optional
        At the first and the last point, for "clamped".

    Returns
    -------
    ndarray, shape (n,), m/m
        With `z` they are the cubic of each interval.

    Raises
    ------
    TooFewSamplesError
        If there are fewer than 4 points.
    InvalidSamplesError
        If a value is not finite, lengths differ or positions do not grow.
    DataError
        If `end` is not known, or a slope at an end is not a finite number.

    Notes
    -----
    Continuity of the second derivative at an inner knot gives, with ``d = diff(z) / diff(s)``,
    ``h[i] s'[i-1] + 2 (h[i-1] + h[i]) s'[i] + h[i-1] s'[i+1] = 3 (h[i] d[i-1] + h[i-1] d[i])``,
    a tridiagonal system, chapter IV of [1]_. NaN is refused. O(n).

    References
    ----------
    .. [1] C. de Boor, A Practical Guide to Splines, Springer 2001, chapter IV, Eqs. (7)-(11).

    Examples
    --------
    >>> knot_slopes([1.0, 2.0, 4.0, 5.0], [1.0, 8.0, 64.0, 125.0]).round(9).tolist()
    [3.0, 12.0, 48.0, 75.0]
    """
    from scipy.linalg import solve_banded

    positions, heights = _checked(s, z)
    numbers.choice(end, "the end condition", get_args(EndCondition))
    try:
        first_slope, last_slope = end_slopes
    except (TypeError, ValueError):
        raise DataError(f"end_slopes must be two slopes, m/m, got {end_slopes!r}") from None
    slopes = [numbers.real(v, "a slope of end_slopes") for v in (first_slope, last_slope)]
    h = np.diff(positions)
    d = np.diff(heights) / h
    bands = np.zeros((3, positions.size))
    right = np.empty(positions.size)
    bands[0, 2:] = h[:-1]
    bands[1, 1:-1] = 2.0 * (h[:-1] + h[1:])
    bands[2, :-2] = h[1:]
    right[1:-1] = 3.0 * (h[1:] * d[:-1] + h[:-1] * d[1:])
    first = _end_row(end, h[0], h[1], d[0], d[1], slopes[0])
    last = _end_row(end, h[-1], h[-2], d[-1], d[-2], slopes[1])
    bands[1, 0], bands[0, 1], right[0] = first
    bands[1, -1], bands[2, -2], right[-1] = last
    solved: FloatArray = solve_banded(
        (1, 1), bands, right, overwrite_ab=True, overwrite_b=True, check_finite=False
    )
    return solved


def _end_row(
    end: str, h0: float, h1: float, d0: float, d1: float, slope: float
) -> tuple[float, float, float]:
    """Return diagonal, neighbour and right side of an end; both ends alike, seen from outside."""
    if end == "clamped":
        return 1.0, 0.0, slope
    if end == "natural":
        return 2.0, 1.0, 3.0 * d0
    total = h0 + h1
    return h1, total, ((h0 + 2.0 * total) * h1 * d0 + h0 * h0 * d1) / total


def evaluate(
    s: FloatArray, z: FloatArray, slopes: FloatArray | None, at: FloatArray
) -> FloatArray:
    """Return the interpolated height at any positions within the knots.

    Parameters
    ----------
    s, z : ndarray, shape (n,), m
        Knots, `s` strictly growing.
    slopes : ndarray, shape (n,), m/m, or None
        Of `knot_slopes`; None joins the points by lines.
    at : ndarray, shape (m,), m
        Positions from ``s[0]`` to ``s[-1]``; NaN gives NaN.

    Returns
    -------
    ndarray, shape (m,), m
        Heights; NaN outside the knots, where no block leads.

    Notes
    -----
    Cubic Hermite polynomial of each interval. Linear interpolation is Eqs. (7)-(8) of [1]_, the
    spline its Eq. (9).

    References
    ----------
    .. [1] Deterministic error compensation for slow tool servo-driven diamond turning, Eqs. (7)-(9).

    Examples
    --------
    >>> evaluate(np.array([0.0, 2.0]), np.array([0.0, 4.0]), None, np.array([0.5, 3.0])).tolist()
    [1.0, nan]
    """
    i = np.clip(np.searchsorted(s, at, side="right") - 1, 0, s.size - 2)
    h = s[i + 1] - s[i]
    t = (at - s[i]) / h
    t = np.where((at < s[0]) | (at > s[-1]), np.nan, t)
    if slopes is None:
        return z[i] + t * (z[i + 1] - z[i])
    rise = z[i + 1] - z[i]
    a, b = h * slopes[i] - rise, rise - h * slopes[i + 1]
    result: FloatArray = z[i] + t * rise + t * (1.0 - t) * (a * (1.0 - t) + b * t)
    return result


def dense_rows(
    z: FloatArray, h: FloatArray, slopes: FloatArray | None, fractions: FloatArray
) -> FloatArray:
    """Return interpolated heights at the same fractions of every interval, one row each."""
    t = fractions
    if slopes is None:
        return np.stack([z[:-1], z[1:]], axis=1) @ np.stack([1.0 - t, t])
    rise = np.diff(z)
    columns = [z[:-1], rise, h * slopes[:-1] - rise, rise - h * slopes[1:]]
    basis = np.stack([np.ones_like(t), t, t * (1.0 - t) ** 2, t * t * (1.0 - t)])
    product: FloatArray = np.stack(columns, axis=1) @ basis
    return product


def fitted_heights(
    s: ArrayLike, at: ArrayLike, wanted: ArrayLike, *, interpolation: Interpolation
) -> FloatArray:
    """Return heights of the knots whose interpolation is nearest to a course, in least squares.

    Parameters
    ----------
    s : array_like, shape (n,), m
        Knots, strictly growing; n >= 4 for the spline, n >= 2 for lines.
    at : array_like, shape (m,), m
        Positions where the course is wanted, growing, from ``s[0]`` to ``s[-1]``; some in every
        interval.
    wanted : array_like, shape (m,), m
        Heights of the course there, finite.
    interpolation : {"linear", "spline"}
        What the controller does; the spline has not-a-knot ends.

    Returns
    -------
    ndarray, shape (n,), m
        Heights for the program: the interpolation does not pass through the course there.

    Raises
    ------
    TooFewSamplesError
        If there are too few knots, or fewer positions than knots.
    InvalidSamplesError
        If a value is not finite, positions do not grow, lie outside, or leave an interval empty.
    DataError
        If the word for the interpolation is not known.

    Notes
    -----
    Splines with not-a-knot ends through n points are exactly the B-splines without knots at the
    second and last but one point; they have n coefficients. Their least-squares fit is
    banded, and its normal equations are well conditioned. The block count stays, so the same program length follows the surface more closely
    than the interpolating one. O(n + m).

    Examples
    --------
    >>> x = np.linspace(0.0, 1.0, 21)
    >>> fitted_heights([0.0, 1.0], x, x**2, interpolation="linear").round(3).tolist()
    [-0.158, 0.842]
    """
    from scipy.interpolate import BSpline
    from scipy.linalg import solveh_banded

    numbers.choice(interpolation, "interpolation", ("linear", "spline"))
    knots = _positions(s, name="s")
    x, y = _checked(at, wanted, fewest=knots.size)
    cubic = interpolation == "spline"
    if knots.size < (FEWEST_KNOTS if cubic else 2):
        raise TooFewSamplesError(
            f"the {interpolation} interpolation needs {FEWEST_KNOTS if cubic else 2} points, "
            f"got {knots.size}"
        )
    inner = knots[2:-2] if cubic else knots[1:-1]
    degree = 3 if cubic else 1
    ends = np.ones(degree + 1)
    full = np.concatenate([knots[0] * ends, inner, knots[-1] * ends])
    if x[0] < knots[0] or x[-1] > knots[-1] or not np.diff(np.searchsorted(x, knots)).all():
        raise InvalidSamplesError(
            f"the course does not determine the {knots.size} points: give positions in every "
            "interval between the first and the last point, and none outside"
        )
    basis = BSpline.design_matrix(x, full, degree)
    normal = (basis.T @ basis).todia()
    bands = np.zeros((degree + 1, knots.size))
    for row in range(degree + 1):
        bands[degree - row, row:] = normal.diagonal(row)
    right = np.asarray(basis.T @ y, dtype=np.float64)
    try:
        solution = solveh_banded(bands, right, overwrite_ab=True, check_finite=False)
    except np.linalg.LinAlgError:
        raise InvalidSamplesError(
            f"the {x.size} positions of the course do not determine the {knots.size} points; "
            "give two and more in every interval"
        ) from None
    return np.asarray(BSpline.design_matrix(knots, full, degree) @ solution, dtype=np.float64)


def _positions(values: ArrayLike, *, name: str) -> FloatArray:
    s = frozen_float(values, name=name, ndim=1, min_size=2)
    steps = np.diff(s)
    if not (steps > 0.0).all():
        i = int(np.flatnonzero(~(steps > 0.0))[0])
        raise InvalidSamplesError(
            f"positions must grow strictly: number {i} is {s[i]:.9g} m, number {i + 1} is "
            f"{s[i + 1]:.9g} m; sort them, or drop the repeated point"
        )
    return s


def _checked(
    s: ArrayLike, z: ArrayLike, *, fewest: int = FEWEST_KNOTS
) -> tuple[FloatArray, FloatArray]:
    positions = _positions(s, name="s")
    heights = frozen_float(z, name="z", ndim=1)
    same_length(s=positions, z=heights)
    if positions.size < fewest:
        raise TooFewSamplesError(f"need at least {fewest} points, got {positions.size}")
    if np.isnan(heights).any():
        i = int(np.flatnonzero(np.isnan(heights))[0])
        raise InvalidSamplesError(
            f"the height of point {i} at {positions[i]:.9g} m is NaN; a path leads through every "
            "point: give it a height, or leave the point out"
        )
    return positions, heights


# ---- arc length of the spiral ``rho = feed u / (2 pi)`` from its centre, and its inverse ----------

_TURN = 2.0 * math.pi
_NEWTON_STEPS = 12


def arc_length(u: ArrayLike, feed: float) -> FloatArray:
    """Return the arc length of the spiral from its centre.

    Parameters
    ----------
    u : array_like, any shape, rad
        Angle left to the centre; a negative one is the spiral's other half.
    feed : float, m
        Advance per revolution, > 0.

    Returns
    -------
    ndarray, as `u`, m
        Eq. (3) of [1]_, an odd function; NaN where `u` is NaN.

    Raises
    ------
    DataError
        If the feed is not positive and finite.

    Notes
    -----
    ``S = a/2 (u sqrt(u^2 + 1) + asinh u)``, ``a = feed / 2 pi``. The paper's Eq. (4) reads ``rho =
    r - f_r theta``; it prints r for theta.

    References
    ----------
    .. [1] Deterministic error compensation for slow tool servo-driven diamond turning, Eqs. (3)-(6).

    Examples
    --------
    >>> round(float(arc_length(2 * np.pi * 250, 2e-6)), 9)
    0.392700443
    """
    a = length(feed, "feed") / _TURN
    angle = np.asarray(u, dtype=np.float64)
    return np.asarray(0.5 * a * _doubled_length(angle), dtype=np.float64)


def _doubled_length(u: FloatArray) -> FloatArray:
    """Return 2 S / a. The logarithm is faster than asinh and exact enough for u >= 1."""
    root = np.sqrt(u * u + 1.0)
    if u.size and float(np.min(u)) >= 1.0:
        return u * root + np.log(u + root)
    return u * root + np.arcsinh(u)


@described_by(arc_length)
def angle_at_length(s: ArrayLike, feed: float) -> FloatArray:
    """Return the angle left to the centre at an arc length, the inverse of `arc_length`.

    Parameters
    ----------
    s : array_like, any shape, m
        Arc length from the centre, >= 0; NaN gives NaN.

    Returns
    -------
    ndarray, as `s`, rad
        Angles.

    Raises
    ------
    InvalidSamplesError
        If a length is negative or infinite.
    NotConvergedError
        If Newton's method does not end; no known input does this.

    Notes
    -----
    Newton's method from ``sqrt(2 S / a)``, at once for all lengths; the next correction is
    estimated from the last one, so that two steps do for most of a spiral.

    Examples
    --------
    >>> float(angle_at_length(arc_length(12.5, 2e-6), 2e-6).round(12))
    12.5
    """
    a = length(feed, "feed") / _TURN
    lengths = np.asarray(s, dtype=np.float64)
    wrong = ~np.isnan(lengths) & ~((lengths >= 0.0) & (lengths < np.inf))
    if wrong.any():
        raise InvalidSamplesError(
            f"arc length {lengths[wrong].flat[0]} m lies on no spiral; lengths are counted from "
            "the centre, finite and not negative"
        )
    return newton_angle(lengths * (2.0 / a))


def newton_angle(g: FloatArray, guess: FloatArray | None = None) -> FloatArray:
    """Return u with ``u sqrt(u^2 + 1) + asinh u = g``, by Newton's method."""
    if not g.size or (np.isnan(g.flat[0]) and np.isnan(g).all()):
        return g.copy()
    u = np.where(g < 1.0, 0.5 * g, np.sqrt(g)) if guess is None else guess
    for _ in range(_NEWTON_STEPS):
        slope = 2.0 * np.sqrt(u * u + 1.0)
        change = (_doubled_length(u) - g) / slope
        u = np.abs(u - change)
        # The error after the step is change^2 u / (2 (u^2 + 1)) and less.
        if float(np.nanmax(np.abs(change) / slope)) < 1e-8:
            return u
    raise NotConvergedError(
        f"no angle found for an arc length of {float(np.nanmax(g)):.6g} half pitches per radian"
    )
