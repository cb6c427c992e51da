"""Chip thickness and cusps of a round nose: what feed, depth and nose radius leave and load.

All lengths in m; arrays broadcast. After Deterministic error compensation for slow tool
servo-driven diamond turning, Eq. (1).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.docs import described_by
from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.core.units import format_length
from metrosep.process._plain import not_above, real_array

_LARGEST = {"R": 0.1, "f": 1e-2, "a": 1e-2}
"""m: a nose radius, feed per revolution or depth from here on is a number in um or mm."""


def max_chip_thickness(R: ArrayLike, f: ArrayLike, a: ArrayLike) -> float | FloatArray:
    """Return the largest thickness of the uncut chip of a round nose.

    Parameters
    ----------
    R : array_like, m
        Nose radius, > 0.
    f : array_like, m
        Feed per revolution, >= 0.
    a : array_like, m
        Depth of cut, 0 <= a <= R.

    Returns
    -------
    float or ndarray, m
        A float for plain numbers.

    Raises
    ------
    DataError
        If a value is out of its range, or the nose cannot reach the depth (a > R).
    InvalidSamplesError
        If a value is not finite, or the shapes do not broadcast.
    UnitError
        If a value is too large to be in metres.

    Notes
    -----
    ``R - sqrt(R^2 + f^2 - 2 f sqrt(2 R a - a^2))``, Eq. (1) of [1]_, as long as the feed is at most
    the half width of the cut ``sqrt(2 R a - a^2)``. Beyond it the deepest point of the nose meets
    uncut material and the thickness is the depth a itself, where Eq. (1) would fall again: this
    leaves the paper. The difference of the roots is formed without cancellation.

    References
    ----------
    .. [1] Deterministic error compensation for slow tool servo-driven diamond turning, Eq. (1).

    Examples
    --------
    >>> round(max_chip_thickness(1e-3, 2e-6, 2.2e-6) * 1e9, 3)
    130.601
    """
    radius, feed, depth = _checked(R=R, f=f, a=a)
    half_width = np.sqrt(depth * (2.0 * radius - depth))
    # Eq. (1), multiplied by the sum of both roots
    drop = feed * (2.0 * half_width - feed)
    under = np.maximum(radius * radius - drop, 0.0)
    thickness = np.where(feed <= half_width, drop / (radius + np.sqrt(under)), depth)
    return _plain(thickness)


@described_by(max_chip_thickness)
def approximate_chip_thickness(R: ArrayLike, f: ArrayLike, a: ArrayLike) -> float | FloatArray:
    """Return the chip thickness for a feed and a depth much smaller than the nose.

    Parameters
    ----------
    f : array_like, m
        Feed per revolution, >= 0, at most ``sqrt(2 R a)``.

    Returns
    -------
    float or ndarray, m
        ``f sqrt(2 a / R) - f^2 / (2 R)``.

    Raises
    ------
    DataError
        As of `max_chip_thickness`, or the feed is wider than half the cut.

    Examples
    --------
    >>> round(approximate_chip_thickness(1e-3, 2e-6, 2.2e-6) * 1e9, 2)
    130.66
    """
    radius, feed, depth = _checked(R=R, f=f, a=a)
    wide = np.flatnonzero(feed > np.sqrt(2.0 * radius * depth))
    if wide.size:
        raise DataError(
            f"the feed {format_length(float(feed.ravel()[wide[0]]))} is wider than half the cut, "
            "where the approximation means nothing: use max_chip_thickness"
        )
    return _plain(feed * np.sqrt(2.0 * depth / radius) - feed * feed / (2.0 * radius))


def cusp_height(R: ArrayLike, f: ArrayLike, *, exact: bool = False) -> float | FloatArray:
    """Return the height of the ridges that a round nose leaves on a flat.

    Parameters
    ----------
    R : array_like, m
        Nose radius, > 0.
    f : array_like, m
        Feed per revolution, 0 <= f <= 2 R.
    exact : bool, optional
        Whether ``R - sqrt(R^2 - f^2 / 4)`` is taken instead of ``f^2 / (8 R)``.

    Returns
    -------
    float or ndarray, m
        Valley to ridge, for a perfect edge without side flow.

    Raises
    ------
    DataError
        As of `max_chip_thickness`, or the feed is wider than the nose.

    Examples
    --------
    >>> round(cusp_height(1e-3, 2e-6) * 1e9, 6)
    0.5
    """
    radius, feed = _checked(R=R, f=f)
    _narrow(radius, feed)
    if not exact:
        return _plain(feed * feed / (8.0 * radius))
    square = 0.25 * feed * feed
    return _plain(square / (radius + np.sqrt(radius * radius - square)))


@described_by(cusp_height)
def cusp_ra(R: ArrayLike, f: ArrayLike) -> float | FloatArray:
    """Return Ra of the ideal ridges of a round nose on a flat.

    Returns
    -------
    float or ndarray, m
        ``f^2 / (18 sqrt(3) R)``: mean deviation of parabolic ridges, no filter.

    Examples
    --------
    >>> round(cusp_ra(1e-3, 2e-6) * 1e9, 3)
    0.128
    """
    radius, feed = _checked(R=R, f=f)
    _narrow(radius, feed)
    return _plain(feed * feed / (18.0 * math.sqrt(3.0) * radius))


def _narrow(radius: FloatArray, feed: FloatArray) -> None:
    wide = np.flatnonzero(feed > 2.0 * radius)
    if wide.size:
        raise DataError(
            f"the feed {format_length(float(feed.ravel()[wide[0]]))} is wider than the nose "
            f"({format_length(2.0 * float(radius.ravel()[wide[0]]))}): material stays uncut"
        )


def _checked(**given: ArrayLike) -> list[FloatArray]:
    """Return arrays that broadcast, in range and plausible as metres."""
    arrays = {}
    for name, value in given.items():
        array = real_array(
            numbers.quantity(value, name, "length") if isinstance(value, str) else value, name
        )
        bad = array[~np.isfinite(array)]
        if bad.size:
            raise InvalidSamplesError(f"{name} is {float(bad[0])}: a finite length in m is needed")
        least = array[array <= 0.0] if name == "R" else array[array < 0.0]
        if least.size:
            bound = "> 0" if name == "R" else ">= 0"
            raise DataError(f"{name} must be {bound}, got {float(least[0])} m")
        not_above(float(array.max(initial=0.0)), name, _LARGEST[name])
        arrays[name] = array
    try:
        shaped = dict(zip(arrays, np.broadcast_arrays(*arrays.values()), strict=True))
    except ValueError:
        shapes = ", ".join(f"{n} {v.shape}" for n, v in arrays.items())
        raise InvalidSamplesError(f"the shapes do not broadcast: {shapes}") from None
    if "a" in shaped:
        deep = np.flatnonzero(shaped["a"] > shaped["R"])
        if deep.size:
            raise DataError(
                f"the depth {format_length(float(shaped['a'].ravel()[deep[0]]))} is more than the "
                f"nose radius {format_length(float(shaped['R'].ravel()[deep[0]]))}: the round nose "
                "does not reach that deep"
            )
    return list(shaped.values())


def _plain(values: FloatArray) -> float | FloatArray:
    return float(values) if np.ndim(values) == 0 else np.asarray(values, dtype=np.float64)
