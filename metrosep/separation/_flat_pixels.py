"""Three flats pixel by pixel: even and odd shares of classes of angular orders."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.separation._flat_setups import FlatSetup, facing, order_design
from metrosep.separation._map_input import MapGrid
from metrosep.separation._map_orders import (
    class_share,
    coarse,
    combined,
    orders_of,
    solve_order,
    without_plane,
)
from metrosep.separation._map_variance import TurnedNoise
from metrosep.separation._map_whiteness import smoothness

_SEED = 20260727
_COARSE = 128


class FlatPixelSolver:
    """The linear operation from readings to A, B, C by sums of turned and mirrored readings."""

    def __init__(
        self, setups: Sequence[FlatSetup], n: int, flip: str, largest_gain: float
    ) -> None:
        self.setups, self.n, self.flip = setups, n, flip
        shape = (3, len(setups), n)
        self.direct, self.mirrored = np.zeros(shape), np.zeros(shape)
        self.all_direct, self.all_mirrored = np.zeros(shape), np.zeros(shape)
        self.freedom = 0.0
        even_lost: dict[int, list[int]] = {0: [], 1: [], 2: []}
        odd_lost: dict[int, list[int]] = {0: [], 1: [], 2: []}
        turns = 2.0 * np.pi * np.arange(n) / n
        sign = np.array([1.0, -1.0])
        for q in range(n // 2 + 1):
            # a turn mixes the even share e and the odd one's quadrature o' the other way round
            solved = solve_order(order_design(setups, -q, sign))
            share = class_share(q, n) / n
            self.freedom += share * (2 * len(setups) - solved.rank) / 2.0
            seen = solved.seen & (solved.gain <= largest_gain)
            for p in range(3):
                w = np.real(solved.weights[2 * p : 2 * p + 2])
                self._add(self.all_direct[p], self.all_mirrored[p], w, q * turns, share)
                kept = w * seen[2 * p : 2 * p + 2, None]
                self._add(self.direct[p], self.mirrored[p], kept, q * turns, share)
                if not seen[2 * p]:
                    even_lost[p].append(q)
                if not seen[2 * p + 1]:
                    odd_lost[p].append(q)
        self.even_lost = {p: orders_of(v, n) if v else () for p, v in even_lost.items()}
        self.odd_lost = {
            p: tuple(m for m in orders_of(v, n) if m > 0) if v else () for p, v in odd_lost.items()
        }

    @staticmethod
    def _add(
        direct: FloatArray, mirrored: FloatArray, w: FloatArray, angle: FloatArray, share: float
    ) -> None:
        w1, w2, w3, w4 = w[0, 0::2], w[0, 1::2], w[1, 0::2], w[1, 1::2]
        c, s = np.cos(angle), np.sin(angle)
        direct += share / 2.0 * (np.outer(w1 + w4, c) + np.outer(w2 - w3, s))
        mirrored += share / 2.0 * (np.outer(w1 - w4, c) + np.outer(w2 + w3, s))

    def parts(self, stack: FloatArray, grid: MapGrid) -> FloatArray:
        """Return A, B, C without what is not observable."""
        return combined(stack, grid, self.direct, self.mirrored, flip=self.flip)

    def solve(
        self, stack: FloatArray, grid: MapGrid, removed: Sequence[str]
    ) -> tuple[FloatArray, FloatArray, FloatArray, float, float]:
        """Return parts, their variance, the residual of the readings, its freedom and smoothness."""
        parts = self.parts(stack, grid)
        variance = TurnedNoise(grid, self.n, self.flip).variance(self.direct, self.mirrored)
        parts = np.stack([without_plane(z, grid, removed=removed) for z in parts])
        residual = self.residual(stack, grid, removed)
        measured = float(np.isfinite(residual).all(axis=0).sum())
        if self.n in (1, 2, 4):
            return parts, variance, residual, self.freedom * measured, 1.0
        rng = np.random.default_rng(_SEED)
        small, small_grid = coarse(stack, grid, _COARSE)
        unit = np.where(np.isfinite(small), rng.standard_normal(small.shape), np.nan)
        left = self.residual(unit, small_grid, removed)
        known = np.isfinite(left).all(axis=0)
        freedom = float((left[:, known] ** 2).sum(axis=0).mean()) if known.any() else 0.0
        return parts, variance, residual, freedom * measured, smoothness(left)

    def residual(self, stack: FloatArray, grid: MapGrid, removed: Sequence[str]) -> FloatArray:
        """Return what the model leaves of the readings."""
        least = combined(stack, grid, self.all_direct, self.all_mirrored, flip=self.flip)
        out = []
        for z, item in zip(stack, self.setups, strict=True):
            first, second = facing(least, item, grid, self.flip)
            out.append(without_plane(z - first - second, grid, removed=removed))
        return np.stack(out)
