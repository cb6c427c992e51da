"""Least squares of an N-position test: by pixels and classes of orders, or on circles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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
from metrosep.separation._map_whiteness import smoothness
from metrosep.separation._polar_maps import solve_polar
from metrosep.separation.map_turning import turned

FloatArray = NDArray[np.float64]

_SEED = 20260727


@dataclass(frozen=True, slots=True)
class RotationSolution:
    """Maps of one evaluation.

    Parameters
    ----------
    parts : ndarray, shape (3, n_y, n_x)
        Instrument, part at angle 0, sum of both that is not separable.
    residual : ndarray, shape (S, n_y, n_x)
        What the model leaves of each reading.
    freedom : float
        Degrees of freedom of the residual.
    variance : ndarray, shape (3,)
        Of each part for white noise of variance 1.
    smoothness : float
        RMS over steps between neighbours (`smoothness`) that the residual of white noise has.
    """

    parts: FloatArray
    residual: FloatArray
    freedom: float
    variance: FloatArray
    smoothness: float = 1.0


class RotationSolver:
    """The linear operation from readings to parts for one set of angles.

    Parameters
    ----------
    angles : ndarray, shape (S,), rad
        Turns of the part.
    largest_gain : float
        Orders whose noise would grow by more are not separated.
    """

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

    def parts(self, stack: FloatArray, grid: MapGrid) -> tuple[FloatArray, FloatArray | None]:
        """Return instrument, part and inseparable sum, and their variance where it is known.

        Parameters
        ----------
        stack : ndarray, shape (S, n_y, n_x)
            Readings.
        grid : MapGrid
            Steps and centre.

        Returns
        -------
        parts : ndarray, shape (3, n_y, n_x)
            NaN where readings are missing.
        variance : ndarray, shape (3,), or None
            For white noise of variance 1; None on circles.
        """
        parts, variance = self._parts_in_first(stack, grid)
        return self._turned_back(parts, variance, grid)

    def _parts_in_first(
        self, stack: FloatArray, grid: MapGrid
    ) -> tuple[FloatArray, FloatArray | None]:
        if self.weights is not None:
            return combined(stack, grid, self.weights)
        return solve_polar(stack, self.angles, grid, self.largest_gain)[0], None

    def _turned_back(
        self, parts: FloatArray, variance: FloatArray | None, grid: MapGrid
    ) -> tuple[FloatArray, FloatArray | None]:
        if self.first == 0.0:
            return parts, variance
        back, share = turned(parts[1:2], -self.first, grid)
        if variance is not None:
            variance = variance * np.array([1.0, share, 1.0])
        return np.stack([parts[0], back[0], parts[2]]), variance

    def solve(
        self, stack: FloatArray, grid: MapGrid, *, removed: Sequence[str] = RIGID
    ) -> RotationSolution:
        """Return the parts of readings with what is left of each reading.

        Parameters
        ----------
        stack : ndarray, shape (S, n_y, n_x)
            Readings.
        grid : MapGrid
            Steps and centre.
        removed : sequence of str, optional
            Of ``"piston"``, ``"tilt"``, ``"power"``.

        Returns
        -------
        RotationSolution
            Maps and freedom.
        """
        parts, residual, variance, exact = self._once(stack, grid, removed)
        if not np.isfinite(residual).any():
            return RotationSolution(parts, residual, 0.0, np.full(3, np.nan))
        if exact and variance is not None:
            freedom = self.freedom * float(np.isfinite(residual).all(axis=0).sum())
            return RotationSolution(parts, residual, freedom, variance)
        # interpolation smooths noise: the same operations on noise of variance 1 say by how much
        rng = np.random.default_rng(_SEED)
        small, small_grid = coarse(stack, grid, 128)
        unit = np.where(np.isfinite(small), rng.standard_normal(small.shape), np.nan)
        noise, left, _, _ = self._once(unit, small_grid, removed)
        known = np.isfinite(left).all(axis=0)
        if not known.any():
            return RotationSolution(parts, residual, 0.0, np.full(3, np.nan))
        variance = (noise[:, known] ** 2).mean(axis=1)
        freedom = float((left[:, known] ** 2).sum(axis=0).mean())
        n_pixels = float(np.isfinite(residual).all(axis=0).sum())
        return RotationSolution(parts, residual, freedom * n_pixels, variance, smoothness(left))

    def _once(
        self, stack: FloatArray, grid: MapGrid, removed: Sequence[str]
    ) -> tuple[FloatArray, FloatArray, FloatArray | None, bool]:
        parts, variance = self._parts_in_first(stack, grid)
        parts = np.stack([without_plane(z, grid, removed=removed) for z in parts])
        residual, exact = [], True
        for z, angle in zip(stack, self.angles, strict=True):
            moved, share = turned(parts[1:2], float(angle), grid)
            exact = exact and share == 1.0
            rest = z - parts[0] - moved[0] - parts[2]
            residual.append(without_plane(rest, grid, removed=removed))
        parts, variance = self._turned_back(parts, variance, grid)
        return parts, np.stack(residual), variance, exact


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
    hidden = []
    for m in range(LISTED_ORDERS + 1):
        turn = np.exp(-1j * m * angles)
        solved = solve_order(np.stack([np.ones_like(turn), turn], axis=1))
        if not solved.seen.all() or solved.gain.max() > largest_gain:
            hidden.append(m)
    return tuple(hidden)
