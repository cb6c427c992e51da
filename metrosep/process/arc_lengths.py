"""Arc length of the spiral ``rho = feed u / (2 pi)`` from its centre, and its inverse."""

from __future__ import annotations

import contextlib
import math
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError, NotConvergedError

__all__ = ["angle_at_length", "arc_length"]


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
    a = checked_positive(feed, "feed") / _TURN
    angle = np.asarray(u, dtype=np.float64)
    return np.asarray(0.5 * a * _doubled_length(angle), dtype=np.float64)


def _doubled_length(u: FloatArray) -> FloatArray:
    """Return 2 S / a. The logarithm is faster than asinh and exact enough for u >= 1."""
    root = np.sqrt(u * u + 1.0)
    if u.size and float(np.min(u)) >= 1.0:
        return u * root + np.log(u + root)
    return u * root + np.arcsinh(u)


def angle_at_length(s: ArrayLike, feed: float) -> FloatArray:
    """Return the angle left to the centre at an arc length, the inverse of `arc_length`.

    Parameters
    ----------
    s : array_like, any shape, m
        Arc length from the centre, >= 0; NaN gives NaN.
    feed : float, m
        Advance per revolution, > 0.

    Returns
    -------
    ndarray, as `s`, rad
        Angles.

    Raises
    ------
    DataError
        If the feed is not positive and finite.
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
    a = checked_positive(feed, "feed") / _TURN
    length = np.asarray(s, dtype=np.float64)
    wrong = ~np.isnan(length) & ~((length >= 0.0) & (length < np.inf))
    if wrong.any():
        raise InvalidSamplesError(
            f"arc length {length[wrong].flat[0]} m lies on no spiral; lengths are counted from "
            "the centre, finite and not negative"
        )
    return newton_angle(length * (2.0 / a))


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


def checked_positive(value: object, name: str, *, unit: str = " m") -> float:
    """Return a positive finite number, or raise DataError; `unit` is for the message."""
    number = checked_finite(value, name)
    if number <= 0.0:
        raise DataError(f"{name} must be positive, got {number}{unit}")
    return number


def checked_finite(value: object, name: str) -> float:
    """Return a finite number, or raise DataError; text and truth values are none."""
    number = None
    if not isinstance(value, str | bytes | bool | np.bool_):
        with contextlib.suppress(TypeError, ValueError):
            number = float(cast(Any, value))
    if number is None:
        raise DataError(f"{name} must be a number in SI, got {value!r}")
    if not math.isfinite(number):
        raise DataError(f"{name} must be finite, got {number}")
    return number


def checked_count(value: object, name: str, *, least: int) -> int:
    """Return a whole number of `least` or more, or raise DataError."""
    number = checked_finite(value, name)
    if number != math.floor(number) or number < least:
        raise DataError(f"{name} must be a whole number of {least} or more, got {value}")
    return int(number)
