"""Where a correction bends between two points of a path, and the points in between that it needs.

A controller moves on straight lines between points, so between two blocks the correction that acts
is the chord of c, off by up to ``|c''|`` d^2 / 8 at a distance d. Where that exceeds a tolerance the
block is split into 2, 4, 8 ... parts along the same line in X, C and Z.

A move is looked at on an even grid and on the same grid shifted by an irrational share of a step,
so that a correction in step with the grid is seen too: every half pixel of a map (0.05 mm where
nothing says how fast it bends) and every 5 degrees of C at most, at least in `FEWEST` steps.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray

__all__ = ["MAX_LOOKS", "MAX_PARTS", "chord_errors", "part_counts"]

IntArray = NDArray[np.int64]
Lookup = Callable[[FloatArray, FloatArray], FloatArray]

MAX_PARTS = 4096
"""Most parts of one block; a path that needs more was never meant for this correction."""

MAX_LOOKS = 1 << 15
"""Most steps in which one move is looked at; a longer one cannot be judged."""

FEWEST = 2
_SHIFT = (3.0 - 5.0**0.5) / 2.0
"""Golden section: the share of a step furthest from every fraction."""

_TURN = np.pi / 36.0
_PITCH = 0.1e-3
_AT_ONCE = 50_000
"""Samples that are held together; few, so that they stay in the cache."""


def chord_errors(lookup: Lookup, ends: FloatArray, pitch: float | None = None) -> FloatArray:
    """Return how far the correction on the way of each move is from its chord.

    Examples
    --------
    >>> ends = np.array([[0.0], [0.0], [2e-3], [0.0]])
    >>> chord_errors(lambda x, c: x**2, ends).tolist()
    [1e-06]
    """
    left = np.zeros(ends.shape[1])
    for size, some in _groups(ends, pitch):
        left[some] = _deviation(_sampled(lookup, ends[:, some], size), 1)
    left[_wanted(ends, pitch) > MAX_LOOKS] = np.inf
    return left


def part_counts(
    lookup: Lookup, ends: FloatArray, tolerance: float, pitch: float | None
) -> tuple[IntArray, FloatArray]:
    """Return into how many equal parts each move is split, and the deviation that is left.

    Examples
    --------
    >>> ends = np.array([[0.0], [0.0], [2e-3], [0.0]])
    >>> parts, left = part_counts(lambda x, c: x**2, ends, 1e-7, None)
    >>> parts.tolist(), left.round(12).tolist()
    ([4], [6.25e-08])
    """
    n = ends.shape[1]
    parts, left = np.ones(n, dtype=np.int64), np.zeros(n)
    for size, some in _groups(ends, pitch):
        _split(lookup, ends[:, some], tolerance, size, some, parts, left)
    left[_wanted(ends, pitch) > MAX_LOOKS] = np.inf
    return parts, left


def _groups(ends: FloatArray, pitch: float | None) -> list[tuple[int, IntArray]]:
    """Return moves that are looked at in equally many steps, not too many at once."""
    steps = 2 ** np.ceil(np.log2(np.clip(_wanted(ends, pitch), FEWEST, MAX_LOOKS)))
    steps = steps.astype(np.int64)
    found = []
    for size in np.unique(steps).tolist():
        chosen = np.flatnonzero(steps == size)
        found += [(size, s) for s in np.array_split(chosen, 1 + chosen.size * size // _AT_ONCE)]
    return found


def _wanted(ends: FloatArray, pitch: float | None) -> FloatArray:
    """Return how many steps each move asks for."""
    radius = np.maximum(np.abs(ends[0]), np.abs(ends[2]))
    turned = np.abs(np.nan_to_num(ends[3] - ends[1]))
    length = np.hypot(ends[2] - ends[0], radius * turned)
    return np.asarray(np.maximum(2.0 * length / (pitch or _PITCH), turned / _TURN))


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
        open_ = open_[deviation > tolerance]  # a gap (NaN) stays one in any number of parts
        count *= 2
        if count > MAX_PARTS:
            return
        if open_.size and 2 * count > size:
            for some in np.array_split(open_, 1 + open_.size * 2 * size // _AT_ONCE):
                _split(lookup, ends[:, some], tolerance, 2 * size, where[some], parts, left)
            return


def _deviation(values: FloatArray, count: int) -> FloatArray:
    """Return the largest distance of samples from the chords of `count` equal parts."""
    moves, size = values.shape[0], values.shape[1] // 2
    even, shifted = values[:, : size + 1], values[:, size + 1 :]
    step = size // count
    low, high = even[:, :-1:step, None], even[:, step::step, None]
    worst = np.zeros(moves)
    for inner, shift in ((even[:, :-1], 0.0), (shifted, _SHIFT)):
        share = (np.arange(step) + shift) / step
        away = (high - low) * share
        away += low
        away -= inner.reshape(moves, count, step)
        worst = np.maximum(worst, np.abs(away, out=away).max(axis=(1, 2)))
    return worst


def _sampled(lookup: Lookup, ends: FloatArray, size: int) -> FloatArray:
    """Return the correction on the even grid, ends included, and on the shifted one after it."""
    grid = np.arange(size + 1)
    share = np.concatenate([grid, grid[:-1] + _SHIFT]) / size
    x = ends[0][:, None] + (ends[2] - ends[0])[:, None] * share
    c = ends[1][:, None] + (ends[3] - ends[1])[:, None] * share
    values = lookup(x.ravel(), c.ravel())
    return np.asarray(values, dtype=np.float64).reshape(x.shape)
