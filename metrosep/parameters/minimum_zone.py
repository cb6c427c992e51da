"""Narrowest zone or tightest reference over many points: an exact linear program by exchange.

A reference that is linear in its coefficients, ``f_i = A_i c`` with ``A_i[0] = 1`` (line, plane,
limacon), lies in the middle of the narrowest zone when it solves

    minimise e  subject to  -e <= z_i - A_i c <= e          ("zone")

The tightest reference from outside minimises c[0] subject to ``A_i c >= z_i`` ("outer"), the one
from inside maximises c[0] subject to ``A_i c <= z_i`` ("inner"). Only a few points matter, so a
small program over a working set is solved (HiGHS), the points it violates most are added, and so
on until none is violated. The solution is then found again from its supporting points by a linear
system, to rounding. The multipliers of these points give a bound that nobody can beat: where the
bound equals what was achieved, the support is a proof of the optimum.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from metrosep.core._arrays import FloatArray, IntArray
from metrosep.core.errors import DegenerateFitError, NotConvergedError

__all__ = ["Mode", "Optimum", "chunk_extremes", "optimum"]

Mode = Literal["zone", "outer", "inner"]

_MAX_EXCHANGES = 200
"""Programs at most; five to ten are usual."""

_FEASIBLE = 4e-15
"""Violation that counts as rounding, relative to the largest deviation."""

_ACTIVE = 1e-9
"""Multiplier above which a point supports the solution; they sum to about 1."""


@dataclass(frozen=True, slots=True)
class Optimum:
    """Solution of a zone or a one-sided reference."""

    coefficients: FloatArray  # shape (k,): of the basis, in the unit of z
    objective: float  # full width of the zone, or c[0] of a one-sided reference, unit of z
    # what no reference can beat, from `weights` alone: lower for "zone" and "outer", upper for
    # "inner"
    bound: float
    indices: IntArray  # shape (m,): supporting points and +1 (upper side) or -1 (lower side)
    sides: IntArray
    # shape (m,): multipliers, positive. They sum to 1 on each side, and ``sum(side weight A) = 0``
    # (zone) or ``sum(weight A) = (1, 0, ...)`` (one side)
    weights: FloatArray


def chunk_extremes(residual: FloatArray, n_chunks: int = 32) -> IntArray:
    """Return where a residual is largest and smallest in each of some equal parts."""
    n = residual.size
    n_chunks = min(n_chunks, n)
    length = n // n_chunks
    whole = residual[: length * n_chunks].reshape(n_chunks, length)
    start = np.arange(n_chunks) * length
    found = [whole.argmax(axis=1) + start, whole.argmin(axis=1) + start]
    rest = residual[length * n_chunks :]
    if rest.size:
        found.append(np.array([rest.argmax(), rest.argmin()]) + length * n_chunks)
    return np.concatenate(found)


def optimum(
    rows: Callable[[IntArray], tuple[FloatArray, FloatArray]],
    extremes: Callable[[FloatArray], IntArray],
    seed: Sequence[int] | IntArray,
    *,
    mode: Mode,
    start: FloatArray,
    scale: float,
) -> Optimum:
    """Return the narrowest zone or the tightest one-sided reference over all points."""
    working = np.unique(np.asarray(seed, dtype=np.intp))
    shift = np.zeros_like(start)
    for _ in range(_MAX_EXCHANGES):
        matrix, heights = rows(working)
        residual = (heights - matrix @ start) / scale
        cost, g, h, owner, side = _program(matrix, residual, mode)
        u, active, y = _solve(cost, g, h)
        shift = u[: start.size]
        candidates = np.unique(extremes(start + scale * shift))
        new = np.setdiff1d(candidates, working)
        if new.size:
            matrix_new, heights_new = rows(new)
            left = (heights_new - matrix_new @ start) / scale - matrix_new @ shift
            e = u[-1] if mode == "zone" else 0.0
            excess = {"zone": np.abs(left) - e, "outer": left, "inner": -left}[mode]
            rounding = _FEASIBLE * (1.0 + float(np.abs(heights_new).max()) / scale)
            new = new[excess > rounding]
        if not new.size:
            break
        working = np.concatenate([working, new])
    else:
        raise NotConvergedError(
            f"the minimum zone was not found in {_MAX_EXCHANGES} exchanges; report these data"
        )
    factor = {"zone": 2.0, "outer": 1.0, "inner": -1.0}[mode]
    base = 0.0 if mode == "zone" else float(start[0])
    weights = y * (2.0 if mode == "zone" else 1.0)
    return Optimum(
        coefficients=start + scale * shift,
        objective=base + scale * float(factor * (cost @ u)),
        bound=base + scale * float(factor * (y @ h[active])),
        indices=working[owner[active]],
        sides=side[active],
        weights=weights,
    )


def _program(
    matrix: FloatArray, residual: FloatArray, mode: Mode
) -> tuple[FloatArray, FloatArray, FloatArray, IntArray, IntArray]:
    """Minimise cost u subject to g u >= h; owner and side of each row."""
    n, k = matrix.shape
    index = np.arange(n)
    plus, minus = np.ones(n, dtype=np.intp), -np.ones(n, dtype=np.intp)
    if mode == "outer":
        return np.eye(k)[0], matrix, residual, index, plus
    if mode == "inner":
        return -np.eye(k)[0], -matrix, -residual, index, minus
    one = np.ones((n, 1))
    g = np.vstack([np.hstack([matrix, one]), np.hstack([-matrix, one])])
    h = np.concatenate([residual, -residual])
    return np.eye(k + 1)[k], g, h, np.tile(index, 2), np.concatenate([plus, minus])


def _solve(
    cost: FloatArray, g: FloatArray, h: FloatArray
) -> tuple[FloatArray, IntArray, FloatArray]:
    """Return the vertex, its active rows and their multipliers, refined to rounding."""
    from scipy.optimize import linprog

    u = np.zeros(cost.size)
    zoom = 1.0
    active = np.zeros(0, dtype=np.intp)
    y = np.zeros(0)
    for _ in range(4):
        solved = linprog(cost, -g, -(h - g @ u) * zoom, bounds=(None, None), method="highs-ds")
        if solved.status != 0 or solved.x is None:
            raise DegenerateFitError(
                f"the points do not bound the reference ({solved.message.strip()}); measure "
                "more points, spread over the whole feature"
            )
        u = u + solved.x / zoom
        multipliers = -np.asarray(solved.ineqlin.marginals)
        active = np.flatnonzero(multipliers > _ACTIVE)
        y = _multipliers(g[active], cost, multipliers[active])
        # The active rows hold with equality: this removes the tolerance of the solver.
        vertex = u + np.linalg.lstsq(g[active], h[active] - g[active] @ u, rcond=None)[0]
        violated = float((h - g @ vertex).max())
        if violated <= 10.0 * _FEASIBLE:
            return vertex, active, y
        zoom *= min(1e6, 1.0 / violated)
    return u, active, y


def _multipliers(g: FloatArray, cost: FloatArray, near: FloatArray) -> FloatArray:
    """Return multipliers with g^T y = cost to rounding, close to those of the solver."""
    y = near + np.linalg.lstsq(g.T, cost - g.T @ near, rcond=None)[0]
    return y if (y >= 0.0).all() else near
