"""Where a correction bends between two points of a path, and the points in between that it needs.

A controller moves on straight lines between points, so between two blocks the correction that acts
is the chord of c, off by up to |c''| d^2 / 8 at a distance d. Where that exceeds a tolerance the
block is split into 2, 4, 8 ... parts along the same line in X, C and Z.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

__all__ = ["MAX_PARTS", "chord_errors", "part_counts"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Lookup = Callable[[FloatArray, FloatArray], FloatArray]

MAX_PARTS = 1024
"""Most parts of one block; a path that needs more was never meant for this correction."""

_FEWEST = 4


def chord_errors(lookup: Lookup, ends: FloatArray) -> FloatArray:
    """Return how far the correction in the middle of each move is from its chord.

    Parameters
    ----------
    lookup : callable
        Correction in m from X (m) and C (rad).
    ends : ndarray, shape (4, n)
        X and C at the beginning, X and C at the end of each move.

    Returns
    -------
    ndarray, shape (n,), m
        Absolute.

    Examples
    --------
    >>> ends = np.array([[0.0], [0.0], [2.0], [0.0]])
    >>> chord_errors(lambda x, c: x**2, ends).tolist()
    [1.0]
    """
    values = _sampled(lookup, ends, 2)
    return np.asarray(np.abs(values[:, 1] - (values[:, 0] + values[:, 2]) / 2))


def part_counts(
    lookup: Lookup, ends: FloatArray, tolerance: float, pitch: float | None
) -> tuple[IntArray, FloatArray]:
    """Return into how many equal parts each move is split, and the deviation that is left.

    Parameters
    ----------
    lookup : callable
        Correction in m from X (m) and C (rad).
    ends : ndarray, shape (4, n)
        X and C at the beginning, X and C at the end of each move.
    tolerance : float, m
        Largest deviation of the correction from its chords.
    pitch : float or None, m
        Distance on the part over which the correction may bend; every move is looked at in steps
        of half of it at most, but in no more than `MAX_PARTS`.

    Returns
    -------
    parts : ndarray of int, shape (n,)
        1, 2, 4 ... `MAX_PARTS`.
    left : ndarray, shape (n,), m
        Largest deviation seen with these parts.

    Examples
    --------
    >>> ends = np.array([[0.0], [0.0], [2.0], [0.0]])
    >>> parts, left = part_counts(lambda x, c: x**2, ends, 0.1, None)
    >>> parts.tolist(), left.tolist()
    ([4], [0.0625])
    """
    n = ends.shape[1]
    parts, left = np.ones(n, dtype=np.int64), np.zeros(n)
    steps = _steps(ends, pitch)
    for size in np.unique(steps):
        chosen = np.flatnonzero(steps == size)
        for some in np.array_split(chosen, 1 + chosen.size * int(size) // 400_000):
            _split(lookup, ends[:, some], tolerance, int(size), some, parts, left)
    return parts, left


def _split(
    lookup: Lookup,
    ends: FloatArray,
    tolerance: float,
    size: int,
    where: IntArray,
    parts: IntArray,
    left: FloatArray,
) -> None:
    """Choose the fewest parts for moves that are looked at in equally many steps."""
    values = _sampled(lookup, ends, size)
    open_ = np.arange(where.size)
    count = 1
    while open_.size:
        deviation = _deviation(values[open_], count)
        parts[where[open_]] = count
        left[where[open_]] = deviation
        # not <=: a gap (NaN) is never good enough, and ends at the largest number of parts
        bad = ~(deviation <= tolerance)
        open_ = open_[bad]
        count *= 2
        if open_.size and 2 * count > size:
            if 2 * size > MAX_PARTS:
                return
            some = where[open_]
            _split(lookup, ends[:, open_], tolerance, 2 * size, some, parts, left)
            return


def _deviation(values: FloatArray, count: int) -> FloatArray:
    """Return the largest distance of samples from the chords of `count` equal parts."""
    step = (values.shape[1] - 1) // count
    low, high = values[:, :-1:step], values[:, step::step]
    share = np.arange(step) / step
    chords = low[:, :, None] + (high - low)[:, :, None] * share
    inner = values[:, :-1].reshape(chords.shape)
    return np.asarray(np.abs(inner - chords).max(axis=(1, 2)))


def _sampled(lookup: Lookup, ends: FloatArray, size: int) -> FloatArray:
    share = np.arange(size + 1) / size
    x = ends[0][:, None] + (ends[2] - ends[0])[:, None] * share
    c = ends[1][:, None] + (ends[3] - ends[1])[:, None] * share
    values = lookup(x.ravel(), c.ravel())
    return np.asarray(values, dtype=np.float64).reshape(x.shape)


def _steps(ends: FloatArray, pitch: float | None) -> IntArray:
    if pitch is None:
        return np.full(ends.shape[1], 2 * _FEWEST, dtype=np.int64)
    radius = np.maximum(np.abs(ends[0]), np.abs(ends[2]))
    turned = np.abs(np.nan_to_num(ends[3] - ends[1]))
    length = np.hypot(ends[2] - ends[0], radius * turned)
    wanted = np.clip(2.0 * length / pitch, _FEWEST, MAX_PARTS)
    return np.asarray(2 ** np.ceil(np.log2(wanted)), dtype=np.int64)
