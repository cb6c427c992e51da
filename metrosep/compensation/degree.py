"""Which degree a polynomial needs: AICc or F-test, with the drift of each run kept apart.

Every degree is tried as one polynomial common to all runs; each run may differ from it by its own
offset and slope (drift), so that drift is not taken for shape, nor noise for shape n times over.
The samples of a run are not independent: how many there are follows from the lag-one correlation
r of the residual of the highest degree, n (1 - r)/(1 + r), and is the same for every degree, as a
comparison of likelihoods demands.
"""

from __future__ import annotations

import itertools
import math
import operator
from typing import SupportsIndex

import numpy as np
from numpy.polynomial import legendre

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, DegenerateFitError, TooFewSamplesError

__all__ = ["choose_degree", "fit_legendre", "to_unit"]

Curves = list[tuple[FloatArray, FloatArray]]

MAX_DEGREE = 60
_MAX_AUTO_DEGREE = 12
_SIGNIFICANT = 0.01
_ROUNDING = 1e-14
"""Residual, relative to the data, below which there is nothing but rounding."""


def to_unit(x: FloatArray, domain: tuple[float, float]) -> FloatArray:
    """Return positions scaled so that the domain is -1 ... 1."""
    return np.asarray((2.0 * x - domain[0] - domain[1]) / (domain[1] - domain[0]))


def fit_legendre(
    x: FloatArray, z: FloatArray, domain: tuple[float, float], degree: int
) -> FloatArray:
    """Return the least-squares coefficients in Legendre polynomials of the scaled position."""
    if x.size < degree + 2:
        raise TooFewSamplesError(
            f"a polynomial of degree {degree} needs {degree + 2} samples, got {x.size}"
        )
    return _solve(_basis(to_unit(x, domain), degree), z, degree)


def _basis(u: FloatArray, degree: int) -> FloatArray:
    return np.asarray(legendre.legvander(u, degree), dtype=np.float64)


def _solve(basis: FloatArray, z: FloatArray, degree: int) -> FloatArray:
    scale = float(np.abs(z).max()) or 1.0
    solution, _, rank, _ = np.linalg.lstsq(basis, z / scale, rcond=None)
    if rank < basis.shape[1]:
        raise DegenerateFitError(
            f"degree {degree} is not determined by these positions (rank {rank} of "
            f"{basis.shape[1]}); lower the degree"
        )
    return np.asarray(solution * scale)


def choose_degree(
    curves: Curves,
    domain: tuple[float, float],
    degree: SupportsIndex | str,
    max_degree: int,
) -> tuple[int, list[dict[str, float]], str]:
    """Return a degree, the scores of all that were tried, and who chose it."""
    if isinstance(degree, SupportsIndex) and not isinstance(degree, bool):
        wanted = operator.index(degree)
        if not 0 <= wanted <= MAX_DEGREE:
            raise DataError(f"degree must be 0 to {MAX_DEGREE}, got {wanted}")
        return wanted, [], "user"
    if degree not in ("aicc", "f-test"):
        raise DataError(f"degree={degree!r}; use a number, 'aicc' or 'f-test'")
    if not 0 <= max_degree <= _MAX_AUTO_DEGREE:
        raise DataError(
            f"max_degree must be 0 to {_MAX_AUTO_DEGREE}, got {max_degree}; a higher degree is "
            "stated, not chosen"
        )
    scores = _scores(curves, domain, min(max_degree, min(x.size for x, _ in curves) // 3))
    if degree == "aicc":
        return int(np.argmin([s["aicc"] for s in scores])), scores, "AICc"
    significant = [d for d, s in enumerate(scores) if s.get("p_of_f_test", 1.0) < _SIGNIFICANT]
    return max(significant, default=0), scores, "F-test, 1 %"


def _scores(curves: Curves, domain: tuple[float, float], top: int) -> list[dict[str, float]]:
    rests = [_residuals(curves, domain, d) for d in range(top + 1)]
    n = sum(x.size for x, _ in curves)
    # two samples of every further run are spent on its own offset and slope
    spent = 2.0 * (len(curves) - 1)
    m = max(sum(_independent(r) for r in rests[-1]) - spent, top + 4.0)
    largest = max(float(np.abs(z).max()) for _, z in curves)
    floor = (_ROUNDING * largest) ** 2 * n + 1e-300
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


def _residuals(curves: Curves, domain: tuple[float, float], degree: int) -> list[FloatArray]:
    """Return what one common polynomial leaves, each run with its own offset and slope beside.

    The offsets and slopes of the runs sum to zero, so that the common part keeps its own.
    """
    if len(curves) == 1:
        ((x, z),) = curves
        basis = _basis(to_unit(x, domain), degree)
        return [z - basis @ fit_legendre(x, z, domain, degree)]
    last = len(curves) - 1
    blocks = []
    for i, (x, _) in enumerate(curves):
        u = to_unit(x, domain)
        line = _basis(u, 1)
        own: FloatArray = np.zeros((x.size, last, 2))
        if i < last:
            own[:, i] = line
        else:
            own[:] = -line[:, None, :]
        blocks.append(np.hstack([_basis(u, degree), own.reshape(x.size, -1)]))
    basis, z = np.vstack(blocks), np.concatenate([z for _, z in curves])
    rest = z - basis @ _solve(basis, z, degree)
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
