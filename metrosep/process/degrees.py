"""Which degree a polynomial through several runs needs: AICc or F-test, drift of each run kept apart.

Every degree is tried as one polynomial common to all runs; each run may differ from it by its own
offset and slope (drift), so that drift is not taken for shape, nor noise for shape n times over.
The samples of a run are not independent: how many there are follows from the lag-one correlation
r of the residual of the highest degree, n (1 - r)/(1 + r), and is the same for every degree, as a
comparison of likelihoods demands.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.polynomial import legendre

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DegenerateFitError

__all__ = [
    "MOST_TRIED", "Curves", "basis_of", "best_degree", "degree_scores", "left_by", "solve", "to_unit",
]  # fmt: skip

Curves = list[tuple[FloatArray, FloatArray]]
"""Positions and values of each run."""

MOST_TRIED = 12
"""A higher degree is stated, not chosen."""
_SIGNIFICANT = 0.01


def to_unit(x: FloatArray, domain: tuple[float, float]) -> FloatArray:
    """Return positions scaled so that the domain is -1 ... 1."""
    return np.asarray((2.0 * x - domain[0] - domain[1]) / (domain[1] - domain[0]))


def basis_of(u: FloatArray, degree: int) -> FloatArray:
    """Return Legendre polynomials up to a degree, one a column."""
    return np.asarray(legendre.legvander(u, degree), dtype=np.float64)


def solve(basis: FloatArray, z: FloatArray, degree: int) -> FloatArray:
    """Return least-squares coefficients; refuse positions that do not determine them."""
    scale = float(np.abs(z).max()) or 1.0
    solution, _, rank, _ = np.linalg.lstsq(basis, z / scale, rcond=None)
    if rank < basis.shape[1]:
        raise DegenerateFitError(
            f"degree {degree} is not determined by these positions (rank {rank} of "
            f"{basis.shape[1]}); lower the degree"
        )
    return np.asarray(solution * scale)


def best_degree(scores: list[dict[str, float]], rule: str) -> int:
    """Return the degree of the smallest AICc, or the highest one that an F-test at 1 % asks for."""
    if rule == "aicc":
        return int(np.argmin([s["aicc"] for s in scores]))
    significant = [d for d, s in enumerate(scores) if s.get("p_of_f_test", 1.0) < _SIGNIFICANT]
    return max(significant, default=0)


def degree_scores(
    curves: Curves, domain: tuple[float, float], most: int, *, rounding: float
) -> list[dict[str, float]]:
    """Return the scores of each degree; `rounding`: residual over data that is nothing but rounding."""
    top = min(most, min(x.size for x, _ in curves) // 3)
    rests = [left_by(curves, domain, d) for d in range(top + 1)]
    n = sum(x.size for x, _ in curves)
    # two samples of every further run are spent on its own offset and slope
    spent = 2.0 * (len(curves) - 1)
    m = max(sum(_independent(r) for r in rests[-1]) - spent, top + 4.0)
    largest = max(float(np.abs(z).max()) for _, z in curves)
    floor = (rounding * largest) ** 2 * n + 1e-300
    squares = [max(sum(float(r @ r) for r in rest), floor) for rest in rests]
    scores: list[dict[str, float]] = []
    for d, square in enumerate(squares):
        k = d + 2
        penalty = 2.0 * k + 2.0 * k * (k + 1) / max(m - k - 1.0, 1.0)
        scores.append(
            {
                "degree": d,
                "aicc": m * math.log(square / squares[0]) + penalty,
                "residual_rms_m": math.sqrt(square / n),
                "independent_samples": m,
            }
        )
    for d, (low, high) in enumerate(itertools.pairwise(squares), start=1):
        scores[d]["p_of_f_test"] = _f_test(low - high, high, m - d - 1.0)
    return scores


def left_by(curves: Curves, domain: tuple[float, float], degree: int) -> list[FloatArray]:
    """Return what one common polynomial leaves, each run with its own offset and slope beside.

    The offsets and slopes of the runs sum to zero, so that the common part keeps its own.
    """
    last = len(curves) - 1
    blocks = []
    for i, (x, _) in enumerate(curves):
        u = to_unit(x, domain)
        line = basis_of(u, 1)
        own: FloatArray = np.zeros((x.size, last, 2))
        if i < last:
            own[:, i] = line
        else:
            own[:] = -line[:, None, :]
        blocks.append(np.hstack([basis_of(u, degree), own.reshape(x.size, -1)]))
    basis, z = np.vstack(blocks), np.concatenate([z for _, z in curves])
    rest = z - basis @ solve(basis, z, degree)
    return np.split(rest, np.cumsum([x.size for x, _ in curves])[:-1])


def _independent(rest: FloatArray) -> float:
    norm = float(rest @ rest)
    r = max(float(rest[1:] @ rest[:-1]) / norm, 0.0) if norm > 0.0 else 0.0
    return rest.size * (1.0 - r) / (1.0 + r)


def _f_test(gain: float, rest: float, freedom: float) -> float:
    from scipy.special import fdtrc

    if freedom < 1.0:
        return 1.0
    return float(fdtrc(1.0, freedom, max(gain, 0.0) / rest * freedom))
