"""Private helpers: the least squares of Legendre terms, or of sums of them, over a map."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DegenerateFitError
from metrosep.forms._moment_sums import (
    Grid,
    Sums,
    inverse_of,
    normal_matrix,
    residual_sums,
)

__all__ = ["GridSolution", "Span", "Terms", "solve_grid"]

Terms = tuple[tuple[int, int], ...]

_SAMPLE = 4096
"""Pixels of the coarse map that gives a first polynomial, or 64 for each term of it."""

_CLOSE = 1e-6
"""Share of the sum of squares that must remain for one pass to be enough."""

_SMALL = 1e-24
"""Of the form's sum of squares: a change that small is rounding."""

_OF_RESIDUAL = 1e-16
"""Of the sum of squares left: what may still be missing from the fit."""

_MOST_PASSES = 5
"""Of refinement; one is the rule only where there was no start from a coarse map."""


class Span:
    """What is fitted to a map: Legendre terms, or sums of them."""

    def __init__(self, degree: int, terms: Terms, functions: FloatArray | None = None) -> None:
        self.degree, self.terms, self.functions = degree, terms, functions
        self._i, self._j = np.array(terms).T
        self.n = len(terms) if functions is None else len(functions)
        self.constant = _constant(functions, self.n)
        self.constant.setflags(write=False)

    def normal(self, sums: Sums) -> FloatArray:
        """Return the normal matrix, shape (n, n)."""
        i, j = self._i, self._j
        normal: FloatArray = normal_matrix(sums.weights, self.degree)[i, j][:, i, j]
        return normal if self.functions is None else self.functions @ normal @ self.functions.T

    def right(self, sums: Sums) -> FloatArray:
        """Return the right-hand side of the normal equations, shape (n,)."""
        heights: FloatArray = sums.heights[self._i, self._j]
        return heights if self.functions is None else self.functions @ heights

    def table(self, a: FloatArray) -> FloatArray:
        """Return coefficients as those of Legendre terms, shape (degree + 1, degree + 1)."""
        c = np.zeros((self.degree + 1, self.degree + 1))
        c[self._i, self._j] = a if self.functions is None else a @ self.functions
        return c


def _constant(functions: FloatArray | None, n: int) -> FloatArray:
    """Return what makes a height of 1; zeros where what is fitted holds no constant."""
    out = np.zeros(n)
    if functions is None:
        out[0] = 1.0
        return out
    alone = (functions[:, 0] != 0.0) & (np.count_nonzero(functions, axis=1) == 1)
    out[alone] = 1.0 / functions[alone, 0]
    return out


class GridSolution(NamedTuple):
    """What `solve_grid` finds: coefficients of what is fitted, the same in Legendre terms, ..."""

    coefficients: FloatArray
    legendre: FloatArray
    inverse: FloatArray
    residual_sum: float
    n_valid: int


def solve_grid(
    grid: Grid,
    span: Span,
    *,
    refine: bool = True,
    what: str = "the terms",
    enough: Callable[[int, int], None] | None = None,
) -> GridSolution:
    """Return the least squares of Legendre terms, or of sums of them, over a map."""

    def improved(
        a: FloatArray, sums: Sums, inverse: FloatArray
    ) -> tuple[FloatArray, FloatArray, float]:
        """Return the fit plus the fit to the residual it left, and the squares left then."""
        right = span.right(sums)
        change = inverse @ right
        return a + change, span.table(a + change), sums.squares - float(change @ right)

    few = grid.every(max(int(np.sqrt(grid.z.size / max(_SAMPLE, 64 * span.n))), 1))
    heights = few.z[few.valid()]
    a = span.constant * _middle(heights)
    c = span.table(a)
    if refine and few.z.size < grid.z.size and heights.size >= 10 * len(span.terms):
        sums = residual_sums(few, c, span.degree)
        with suppress(DegenerateFitError):
            a, c, _ = improved(a, sums, inverse_of(span.normal(sums), what)[0])
    sums = residual_sums(grid, c, span.degree)
    if enough is not None:
        enough(sums.n_valid, span.n)
    normal = span.normal(sums)
    inverse, condition = inverse_of(normal, what)
    a, c, squares = improved(a, sums, inverse)
    for _ in range(_MOST_PASSES if refine else 0):
        gain, form = sums.squares - squares, float(a @ normal @ a)
        missing = gain * (condition * np.finfo(float).eps) ** 2
        is_exact = missing <= max(_SMALL * form, _OF_RESIDUAL * squares)
        if is_exact and (squares > _CLOSE * sums.squares or gain <= _SMALL * form):
            break
        sums = residual_sums(grid, c, span.degree, with_weights=False)
        a, c, squares = improved(a, sums, inverse)
    return GridSolution(a, c, inverse, squares, sums.n_valid)


def _middle(heights: FloatArray) -> float:
    """Return the median of nine heights: a start that one outlier does not carry off."""
    few = sorted(heights[heights.size // 18 :: heights.size // 9 + 1].tolist())
    middle = few[len(few) // 2] if few else 0.0
    return middle if math.isfinite(middle) else 0.0
