"""Least squares of an N-position test: by pixels and classes of orders, or on circles."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from metrosep.core._arrays import ComplexArray, FloatArray
from metrosep.core.errors import DataError
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
from metrosep.separation.map_turning import interpolated, turned

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


# ---- rotations by any angles: maps on circles, one least-squares system for each angular order ----


def polar_grid(grid: MapGrid) -> tuple[FloatArray, int]:
    """Return radii at the pitch of the pixels and a number of angles that is as dense at the rim."""
    from scipy.fft import next_fast_len

    step = min(grid.dx, grid.dy)
    largest = math.hypot(np.abs(grid.x).max(), np.abs(grid.y).max())
    radii = np.asarray((np.arange(math.ceil(largest / step)) + 0.5) * step, dtype=np.float64)
    return radii, 2 * int(next_fast_len(math.ceil(1.3 * math.pi * radii[-1] / step)))


def to_polar(stack: FloatArray, grid: MapGrid) -> FloatArray:
    """Return maps over (radius, angle)."""
    radii, n = polar_grid(grid)
    angle = 2.0 * np.pi * np.arange(n) / n
    columns = (radii[:, None] * np.cos(angle) + grid.centre[0]) / grid.dx
    rows = (radii[:, None] * np.sin(angle) + grid.centre[1]) / grid.dy
    found, _ = interpolated(stack, rows.ravel(), columns.ravel())
    return found.reshape(stack.shape[0], radii.size, n)


def from_polar(polar: FloatArray, grid: MapGrid) -> FloatArray:
    """Return maps over rows and columns from those over (radius, angle)."""
    n = polar.shape[2]
    inner = np.roll(polar[:, :3][:, ::-1], n // 2, axis=2)  # through the centre to the other side
    whole = np.concatenate([inner, polar], axis=1)
    whole = np.concatenate([whole[:, :, -3:], whole, whole[:, :, :4]], axis=2)
    step = min(grid.dx, grid.dy)
    radius = np.hypot(grid.x, grid.y[:, None]) / step - 0.5 + 3.0
    angle = np.mod(np.arctan2(grid.y[:, None], grid.x), 2.0 * np.pi) * n / (2.0 * np.pi) + 3.0
    found, _ = interpolated(whole, radius.ravel(), angle.ravel())
    return found.reshape(polar.shape[0], *grid.shape)


def solve_polar(
    stack: FloatArray, angles: FloatArray, grid: MapGrid, largest_gain: float
) -> tuple[FloatArray, tuple[int, ...]]:
    """Return instrument, part and the sum that is not separable, order by order."""
    polar = to_polar(stack, grid)
    whole = np.isfinite(polar).all(axis=(0, 2))
    if whole.sum() < 6:
        raise DataError(
            "no six circles about the centre were measured completely in all maps, which angles "
            "that are not multiples of one step need: state centre=, or use equal steps"
        )
    n = polar.shape[2]
    weights, hidden = order_weights(tuple(np.asarray(angles).tolist()), n // 2, largest_gain)
    out = np.full((3, whole.size, n), np.nan)
    out[:, whole] = _parts_on_circles(polar[None, :, whole], weights)[0]
    return from_polar(out, grid), hidden


def noise_on_circles(
    trials: FloatArray, angles: FloatArray, grid: MapGrid, largest_gain: float
) -> FloatArray:
    """Return the parts of many sets of readings without gaps."""
    t, s = trials.shape[:2]
    polar = to_polar(trials.reshape(t * s, *grid.shape), grid)
    n = polar.shape[2]
    weights, _ = order_weights(tuple(np.asarray(angles).tolist()), n // 2, largest_gain)
    whole = np.isfinite(polar).all(axis=(0, 2))
    out = np.full((t, 3, whole.size, n), np.nan)
    out[:, :, whole] = _parts_on_circles(polar[:, whole].reshape(t, s, -1, n), weights)
    return from_polar(out.reshape(t * 3, -1, n), grid).reshape(t, 3, *grid.shape)


def _parts_on_circles(circles: FloatArray, weights: ComplexArray) -> FloatArray:
    """Return the three parts of circles, shape (T, S, n_r, n_angles)."""
    series = np.fft.rfft(circles, axis=3)
    found = np.einsum("mps,tsrm->tprm", weights, series, optimize=True)
    return np.asarray(np.fft.irfft(found, n=circles.shape[3], axis=3))


@lru_cache(maxsize=16)
def order_weights(
    angles: tuple[float, ...], highest: int, largest_gain: float
) -> tuple[ComplexArray, tuple[int, ...]]:
    """Return what each reading counts in instrument, part and inseparable sum, order by order."""
    weights = np.zeros((highest + 1, 3, len(angles)), dtype=np.complex128)
    hidden = []
    for m in range(highest + 1):
        turn = np.exp(-1j * m * np.array(angles))
        solved = solve_order(np.stack([np.ones_like(turn), turn], axis=1))
        if solved.seen.all() and solved.gain.max() <= largest_gain:
            weights[m, :2] = solved.weights
        else:
            weights[m, 2] = 1.0 / len(angles)
            hidden.append(m)
    weights.setflags(write=False)
    return weights, tuple(hidden)
