"""Least squares of an N-position test: by pixels and classes of orders, or on circles."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.separation._map_input import MapGrid
from metrosep.separation._map_orders import (
    LISTED_ORDERS,
    RIGID,
    class_share,
    coarse,
    combined,
    common_step,
    orders_of,
    solve_order,
    without_plane,
)
from metrosep.separation._map_variance import TurnedNoise
from metrosep.separation._map_whiteness import smoothness
from metrosep.separation._polar_maps import noise_on_circles, order_weights, solve_polar
from metrosep.separation.map_turning import turned

_SEED = 20260727
_INNER = 44
_RINGS = 14
_TRIALS = 150
_AT_ONCE = 30


@dataclass(frozen=True, slots=True)
class RotationSolution:
    """Maps of one evaluation."""

    # shape (3, n_y, n_x): instrument, part at angle 0, sum of both that is not separable
    parts: FloatArray
    residual: FloatArray  # shape (S, n_y, n_x): what the model leaves of each reading
    freedom: float  # degrees of freedom of the residual
    # shape (3, n_y, n_x): of each part for white noise of variance 1, pixel by pixel
    variance: FloatArray
    # RMS over steps between neighbours (`smoothness`) that the residual of white noise has
    smoothness: float = 1.0


class RotationSolver:
    """The linear operation from readings to parts for one set of angles."""

    def __init__(self, angles: FloatArray, largest_gain: float) -> None:
        self.largest_gain = largest_gain
        self.n, self.first = common_step(angles), 0.0
        relative = common_step(angles - angles[0])
        if relative is not None and (self.n is None or relative < self.n):
            # the part is found as it lies in the first reading, and turned back at the end
            self.n, self.first = relative, float(angles[0])
        self.angles = angles - self.first
        angles = self.angles
        self.weights: FloatArray | None = None
        self.freedom = 0.0
        if self.n is not None:
            self.weights, lost, self.freedom = _pixel_weights(angles, self.n, largest_gain)
            self.hidden = orders_of(lost, self.n)
        else:
            self.hidden = _hidden_orders(angles, largest_gain)

    def parts(self, stack: FloatArray, grid: MapGrid) -> FloatArray:
        """Return instrument, part at angle 0 and inseparable sum."""
        return self._at_zero(self._parts_in_first(stack, grid), stack, grid)

    def _parts_in_first(self, stack: FloatArray, grid: MapGrid) -> FloatArray:
        """Return the parts, the turned one as it lies in the first reading."""
        if self.weights is not None:
            return combined(stack, grid, self.weights)
        return solve_polar(stack, self.angles, grid, self.largest_gain)[0]

    def _at_zero(self, parts: FloatArray, stack: FloatArray, grid: MapGrid) -> FloatArray:
        if self.weights is None or self.first == 0.0:
            return parts
        back = combined(stack, grid, self.weights[1:2], offset=-self.first)
        return np.stack([parts[0], back[0], parts[2]])

    def solve(
        self, stack: FloatArray, grid: MapGrid, *, removed: Sequence[str] = RIGID
    ) -> RotationSolution:
        """Return the parts of readings with what is left of each reading."""
        parts, residual, exact = self._once(stack, grid, removed)
        if not np.isfinite(residual).any():
            return RotationSolution(parts, residual, 0.0, np.full(parts.shape, np.nan))
        n_pixels = float(np.isfinite(residual).all(axis=0).sum())
        if exact and self.weights is not None:
            variance = self._variance(self.weights, grid)
            return RotationSolution(parts, residual, self.freedom * n_pixels, variance)
        # interpolation smooths noise: the same operations on noise of variance 1 say by how much
        rng = np.random.default_rng(_SEED)
        small, small_grid = coarse(stack, grid, 128)
        unit = np.where(np.isfinite(small), rng.standard_normal(small.shape), np.nan)
        left = self._once(unit, small_grid, removed)[1]
        known = np.isfinite(left).all(axis=0)
        if not known.any():
            return RotationSolution(parts, residual, 0.0, np.full(parts.shape, np.nan))
        freedom = float((left[:, known] ** 2).sum(axis=0).mean())
        if self.weights is not None:
            variance = self._variance(self.weights, grid)
        else:
            variance = self._variance_on_circles(grid)
        return RotationSolution(parts, residual, freedom * n_pixels, variance, smoothness(left))

    def _variance(self, weights: FloatArray, grid: MapGrid) -> FloatArray:
        n = weights.shape[2]
        variance = TurnedNoise(grid, n).variance(weights)
        if self.first != 0.0:
            variance[1] = TurnedNoise(grid, n, offset=-self.first).variance(weights[1:2])[0]
        return variance

    def _variance_on_circles(self, grid: MapGrid) -> FloatArray:
        """Return the variance by radius: a small circle shows few orders, a large one many."""
        step = min(grid.dx, grid.dy)
        fractions = tuple(
            round(c / d % 1.0, 6) for c, d in zip(grid.centre, (grid.dx, grid.dy), strict=True)
        )
        angles = tuple(self.angles.tolist())
        radii, near = _variance_near_axis(
            angles, self.largest_gain, fractions, (grid.dx / step, grid.dy / step)
        )
        place = np.hypot(grid.x, grid.y[:, None]) / step
        outer = np.arange(_RINGS, math.ceil(place.max()) + 2.0)
        law = _share_of_orders(self.angles, self.largest_gain, np.concatenate([radii, outer]))
        joined = slice(radii.size // 2, radii.size)
        profile = law * (near[:, joined].mean(axis=1) / law[:, joined].mean(axis=1))[:, None]
        profile[:, : radii.size] = near
        return np.stack([np.interp(place, np.concatenate([radii, outer]), p) for p in profile])

    def _once(
        self, stack: FloatArray, grid: MapGrid, removed: Sequence[str]
    ) -> tuple[FloatArray, FloatArray, bool]:
        parts = self._parts_in_first(stack, grid)
        parts = np.stack([without_plane(z, grid, removed=removed) for z in parts])
        residual, exact = [], True
        for z, angle in zip(stack, self.angles, strict=True):
            moved, share = turned(parts[1:2], float(angle), grid)
            exact = exact and share == 1.0
            rest = z - parts[0] - moved[0] - parts[2]
            residual.append(without_plane(rest, grid, removed=removed))
        at_zero = self._at_zero(parts, stack, grid)
        if at_zero is not parts:
            at_zero[1] = without_plane(at_zero[1], grid, removed=removed)
        return at_zero, np.stack(residual), exact


@lru_cache(maxsize=32)
def _variance_near_axis(
    angles: tuple[float, ...],
    largest_gain: float,
    fractions: tuple[float, ...],
    steps: tuple[float, float],
) -> tuple[FloatArray, FloatArray]:
    """Return radii, in steps, and the variance of the three parts there, by trials with noise."""
    rng = np.random.default_rng(_SEED)
    centre = tuple((_INNER // 2 + f) * d for f, d in zip(fractions, steps, strict=True))
    field = MapGrid((_INNER + 1, _INNER + 1), *steps, (centre[0], centre[1]), False)
    radius = np.hypot(field.x, field.y[:, None]).ravel()
    ring = np.minimum(2.0 * radius, 2 * _RINGS).astype(np.intp)
    sums = np.zeros((3, 2 * _RINGS + 1))
    for _ in range(_TRIALS // _AT_ONCE):
        noise = rng.standard_normal((_AT_ONCE, len(angles), *field.shape))
        squares = (
            np.nan_to_num(noise_on_circles(noise, np.array(angles), field, largest_gain)) ** 2
        )
        sums += [np.bincount(ring, z.ravel()) for z in squares.sum(axis=0)]
    count = np.bincount(ring)[:-1]
    filled = count > 0
    radii = np.bincount(ring, radius)[:-1][filled] / count[filled]
    found = sums[:, :-1][:, filled] / (count[filled] * _TRIALS)
    for values in (radii, found):
        values.setflags(write=False)
    return radii, found


def _share_of_orders(angles: FloatArray, largest_gain: float, radii: FloatArray) -> FloatArray:
    """Return the variance at radii, in steps, where white noise has equal orders up to pi r."""
    highest = math.ceil(math.pi * radii.max())
    weights, _ = order_weights(tuple(angles.tolist()), highest, largest_gain)
    squares = (np.abs(weights) ** 2).sum(axis=2).T
    squares[:, 1:] *= 2.0
    top = math.pi * radii
    sums = np.stack([np.interp(top, np.arange(highest + 1), row.cumsum()) for row in squares])
    return np.asarray(np.maximum(sums / (2.0 * top + 1.0), np.finfo(float).tiny))


def _pixel_weights(
    angles: FloatArray, n: int, largest_gain: float
) -> tuple[FloatArray, list[int], float]:
    """Return weights (3, S, N), the classes that are not separable, freedoms for each pixel."""
    s = angles.size
    weights = np.zeros((3, s, n))
    turns = 2.0 * np.pi * np.arange(n) / n
    lost, freedom = [], 0.0
    for q in range(n // 2 + 1):
        share = class_share(q, n) / n
        turn = np.exp(-1j * q * angles)
        solved = solve_order(np.stack([np.ones_like(turn), turn], axis=1))
        back = np.exp(1j * q * turns)
        freedom += share * (s - solved.rank)
        if solved.seen.all() and solved.gain.max() <= largest_gain:
            for p in range(2):
                weights[p] += share * np.real(np.outer(solved.weights[p], back))
        else:
            lost.append(q)
            weights[2] += share * np.real(np.outer(np.full(s, 1.0 / s), back))
    return weights, lost, freedom


def _hidden_orders(angles: FloatArray, largest_gain: float) -> tuple[int, ...]:
    weights = order_weights(tuple(angles.tolist()), LISTED_ORDERS, largest_gain)
    return weights[1]
