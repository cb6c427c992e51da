"""Maps by classes of angular orders: which can be told apart, and sums of turned and mirrored maps.

Turns by multiples of 2 pi/N leave the angular orders m with the same remainder q = m mod N together
(class q), so a separation is one small system of equations for each class. Its solution, put back
together, is a sum of the readings, turned by multiples of 2 pi/N and mirrored, with fixed weights.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import ComplexArray, FloatArray
from metrosep.separation._map_input import MapGrid
from metrosep.separation.map_turning import quarters_by_index, turned

MOST_POSITIONS = 24
"""Largest N of turns by 2 pi/N that is worked pixel by pixel; beyond, polar or Zernike methods."""

LISTED_ORDERS = 60
"""Angular orders up to this one are listed where they are not observable."""

RIGID = ("piston", "tilt")
"""What alignment decides in each reading, unless the caller says otherwise."""

_ANGLE_TOLERANCE = 1e-6
_RANK_TOLERANCE = 1e-9
_USED = 1e-14


@dataclass(frozen=True, slots=True)
class Solved:
    """Least squares of one class or one order."""

    # of complex, shape (unknowns, readings): pseudo-inverse of the design: the least of all
    # solutions
    weights: ComplexArray
    seen: NDArray[np.bool_]  # shape (unknowns,): which unknowns are determined
    rank: int  # of the design
    # shape (unknowns,): standard deviation of each unknown for that of one reading
    gain: FloatArray


def solve_order(design: FloatArray | ComplexArray) -> Solved:
    """Return the least-squares solution of one design and what it determines."""
    u, s, vh = np.linalg.svd(np.asarray(design, dtype=np.complex128), full_matrices=True)
    floor = _RANK_TOLERANCE * (s[0] if s.size and s[0] > 0 else 1.0)
    rank = int((s > floor).sum())
    weights = (vh[:rank].conj().T / s[:rank]) @ u[:, :rank].conj().T
    hidden = np.sqrt((np.abs(vh[rank:]) ** 2).sum(axis=0))
    return Solved(weights, hidden < 1e-6, rank, np.sqrt((np.abs(weights) ** 2).sum(axis=1)))


def coarse(stack: FloatArray, grid: MapGrid, pixels: int) -> tuple[FloatArray, MapGrid]:
    """Return every k-th pixel of maps, symmetrically about the middle."""
    ny, nx = grid.shape
    k = max(1, max(ny, nx) // pixels)
    first_y, first_x = (ny - 1) % k // 2, (nx - 1) % k // 2
    small = stack[:, first_y::k, first_x::k]
    centre = (grid.centre[0] - first_x * grid.dx, grid.centre[1] - first_y * grid.dy)
    shape = (int(small.shape[1]), int(small.shape[2]))
    return small, MapGrid(shape, grid.dx * k, grid.dy * k, centre, grid.calibrated)


def common_step(angles: FloatArray) -> int | None:
    """Return the least N of which all angles are multiples of 2 pi/N."""
    for n in range(1, MOST_POSITIONS + 1):
        steps = angles * n / (2.0 * np.pi)
        if np.max(np.abs(steps - np.round(steps))) * 2.0 * np.pi / n < _ANGLE_TOLERANCE:
            return n
    return None


def class_share(q: int, n: int) -> float:
    """Return 1 for the classes 0 and N/2, which are real, and 2 for pairs q and N - q."""
    return 1.0 if q == 0 or 2 * q == n else 2.0


def orders_of(classes: Iterable[int], n: int, *, highest: int = LISTED_ORDERS) -> tuple[int, ...]:
    """Return the angular orders of classes q and N - q."""
    wanted = {q % n for q in classes} | {-q % n for q in classes}
    return tuple(m for m in range(highest + 1) if m % n in wanted)


def combined(
    stack: FloatArray,
    grid: MapGrid,
    direct: FloatArray,
    mirrored: FloatArray | None = None,
    *,
    flip: str = "x",
    offset: float = 0.0,
) -> FloatArray:
    """Return sums of turned and mirrored readings."""
    n_out, _, n = direct.shape
    out = np.zeros((n_out, *grid.shape))
    # R(k) after a mirror is a mirror after R(-k): both are summed first, and turned once
    back = None if mirrored is None else mirrored[:, :, -np.arange(n) % n]
    flipped = None if mirrored is None else np.ascontiguousarray(mirror(stack, flip))
    for rest, steps in _by_rest(n, quarters_by_index(grid)):
        weights = [direct[:, :, k] for k, _ in steps]
        weights += [] if back is None else [back[:, :, k] for k, _ in steps]
        squares = (np.stack(weights) ** 2).sum(axis=(0, 2))
        used = np.flatnonzero(squares > _USED**2)
        if used.size == 0:
            continue
        sums = np.zeros((used.size, *grid.shape))
        for k, quarters in steps:
            for i, p in enumerate(used):
                one = _weighted(stack, direct[p, :, k])
                if back is not None and flipped is not None:
                    one += _weighted(flipped, back[p, :, k])
                sums[i] += np.rot90(one, -quarters)
        out[used] += turned(sums, rest + offset, grid)[0]
    return out


def _by_rest(n: int, quarters: bool) -> list[tuple[float, list[tuple[int, int]]]]:
    """Return angles to interpolate by, each with its steps k and their quarter turns by index."""
    found: dict[int, list[tuple[int, int]]] = {}
    for k in range(n):
        turns, rest = divmod(4 * k, n) if quarters else (0, 4 * k)
        found.setdefault(rest, []).append((k, turns))
    return [(np.pi / 2.0 * rest / n, steps) for rest, steps in found.items()]


def mirror(z: FloatArray, flip: str) -> FloatArray:
    """Return a map (or a stack) with x or y reversed about the middle."""
    return z[..., ::-1] if flip == "x" else z[..., ::-1, :]


def _weighted(stack: FloatArray, weights: FloatArray) -> FloatArray:
    out = np.zeros(stack.shape[1:])
    for z, w in zip(stack, weights, strict=True):
        if abs(w) > _USED:
            out += w * z
    return out


def without_plane(
    z: FloatArray,
    grid: MapGrid,
    *,
    removed: Sequence[str] = RIGID,
    mask: NDArray[np.bool_] | None = None,
) -> FloatArray:
    """Return a map minus its least-squares piston, tilt or power."""
    valid = np.isfinite(z) if mask is None else mask & np.isfinite(z)
    if valid.sum() < 6:
        return np.full(z.shape, np.nan)
    x = grid.x / max(np.abs(grid.x).max(), np.abs(grid.y).max())
    y = grid.y / max(np.abs(grid.x).max(), np.abs(grid.y).max())
    columns = [np.ones(z.shape)] if "piston" in removed else []
    if "tilt" in removed:
        columns += [np.broadcast_to(x, z.shape), np.broadcast_to(y[:, None], z.shape)]
    if "power" in removed:
        columns.append(x**2 + y[:, None] ** 2)
    if not columns:
        return z.copy()
    chosen = np.stack([c[valid] for c in columns])
    found = np.linalg.lstsq(chosen @ chosen.T, chosen @ z[valid], rcond=None)[0]
    rest = z.copy()
    for c, column in zip(found, columns, strict=True):
        rest -= c * column
    return rest
