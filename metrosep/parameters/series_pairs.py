"""Which terms of a series of parts move together, and which say the same."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.false_discovery import benjamini_hochberg

__all__ = ["IDENTITY", "correlations"]

IDENTITY = 0.9999
"""From this size of r on two terms are one: less than 1.5 % of the scatter of one is not in the other."""

_Pairs = tuple[tuple[str, str, float], ...]


def correlations(
    columns: Mapping[str, FloatArray | None], *, fewest: int, rate: float
) -> tuple[FloatArray, _Pairs, tuple[tuple[str, ...], ...]]:
    """Return the correlation of terms about their lines, the pairs beyond chance, and what is the same."""
    names = list(columns)
    matrix = np.full((len(names), len(names)), np.nan)
    counts: dict[tuple[int, int], int] = {}
    for i, a in enumerate(columns.values()):
        matrix[i, i] = 1.0
        for j, b in enumerate(columns.values()):
            if j <= i or a is None or b is None:
                continue
            both = ~(np.isnan(a) | np.isnan(b))
            r = _about_lines(a, b, both) if int(both.sum()) >= fewest else None
            if r is not None:
                matrix[i, j] = matrix[j, i] = r
                counts[i, j] = int(both.sum())
    matrix.setflags(write=False)
    groups = _groups(matrix)
    first = {group[0] for group in groups}
    tested = [pair for pair in counts if first.issuperset(pair)]
    same = tuple(tuple(names[i] for i in g) for g in groups if len(g) > 1)
    if not tested:
        return matrix, (), same
    chance = np.array([_chance(float(matrix[p]), counts[p]) for p in tested])
    sure = benjamini_hochberg(chance, rate=rate)
    kept = sorted(
        (pair for pair, s in zip(tested, sure, strict=True) if s), key=lambda p: -abs(matrix[p])
    )
    return matrix, tuple((names[i], names[j], float(matrix[i, j])) for i, j in kept), same


def _about_lines(a: FloatArray, b: FloatArray, both: NDArray[np.bool_]) -> float | None:
    left, right = (_without_line(v, both) for v in (a, b))
    size = math.sqrt(float(left @ left)) * math.sqrt(float(right @ right))
    return None if size == 0.0 else max(-1.0, min(1.0, float(left @ right) / size))


def _chance(r: float, n: int) -> float:
    """Return the probability of so large a correlation of n parts about two lines by chance."""
    from scipy.special import stdtr

    left = 1.0 - r * r
    return 2.0 * float(stdtr(n - 3, -abs(r) * math.sqrt((n - 3) / left))) if left > 0.0 else 0.0


def _groups(matrix: FloatArray) -> list[list[int]]:
    """Return the terms, those that say the same together, in their order."""
    groups: list[list[int]] = []
    for i in range(len(matrix)):
        linked = [g for g in groups if any(abs(matrix[i, k]) >= IDENTITY for k in g)]
        groups = [g for g in groups if g not in linked]
        groups.append(sorted([i, *(k for g in linked for k in g)]))
    return sorted(groups)


def _without_line(values: FloatArray, both: NDArray[np.bool_]) -> FloatArray:
    """Return values less their line, zero where rounding is all that is left."""
    index = np.flatnonzero(both)
    v = values[index]
    x = index - index.mean()
    left = v - v.mean() - (float(x @ v) / float(x @ x)) * x
    rounding = float(np.abs(v).max()) * np.finfo(float).eps * v.size
    return np.zeros_like(left) if float(np.abs(left).max()) <= rounding else np.asarray(left)
