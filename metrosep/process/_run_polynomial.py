"""Private: one polynomial through several runs, each with its own drift.

The polynomial fits of `metrosep.compensation` lie above this layer and may not be used here; this
one differs in that a drift line per run is estimated beside the common polynomial when the degree
is chosen, and in that plain powers of x leave it, as a lathe's controller takes them.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.polynomial import polynomial as power

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, DegenerateFitError, TooFewSamplesError

Runs = list[tuple[FloatArray, FloatArray]]

_SIGNIFICANT = 0.01
_ROUNDING = 1e-13


def fit_run(x: FloatArray, z: FloatArray, degree: int) -> FloatArray:
    """Return least-squares coefficients of powers of x, lowest first."""
    centre, scale = 0.5 * float(x[0] + x[-1]), 0.5 * float(x[-1] - x[0])
    return to_powers(fit_scaled(x, z, degree, centre, scale), centre, scale)


def fit_scaled(
    x: FloatArray, z: FloatArray, degree: int, centre: float, scale: float
) -> FloatArray:
    """Return least-squares coefficients of powers of (x - centre)/scale, lowest first."""
    if x.size < degree + 2:
        raise TooFewSamplesError(
            f"degree {degree} needs {degree + 2} samples in a run, got {x.size}"
        )
    basis = power.polyvander((x - centre) / scale, degree)
    size = float(np.abs(z).max()) or 1.0
    own, _, rank, _ = np.linalg.lstsq(basis, z / size, rcond=None)
    if rank <= degree:
        raise DegenerateFitError(
            f"degree {degree} is not determined by {x.size} positions; lower the degree"
        )
    return np.asarray(own * size, dtype=np.float64)


def power_matrix(degree: int, centre: float, scale: float) -> FloatArray:
    """Return the matrix (degree + 1, degree + 1) from scaled coefficients to powers of x."""
    return np.column_stack([to_powers(e, centre, scale) for e in np.eye(degree + 1)])


def to_powers(own: FloatArray, centre: float, scale: float) -> FloatArray:
    """Return the coefficients of x from those of (x - centre)/scale."""
    total = np.zeros(1)
    for c in own[::-1]:
        total = power.polyadd(power.polymul(total, [-centre / scale, 1.0 / scale]), [c])
    result = np.zeros(own.size)
    result[: min(total.size, own.size)] = total[: own.size]
    return result


def choose(runs: Runs, rule: str, top: int) -> tuple[int, list[dict[str, float]]]:
    """Return the degree by AICc or F-test, and the scores of all; drift per run is no shape."""
    if rule not in ("aicc", "f-test"):
        raise DataError(f"degree={rule!r}; use a number, 'aicc' or 'f-test'")
    if not 1 <= top <= 12:
        raise DataError(f"max_degree={top}; choose among 1 to 12, a higher degree is stated")
    top = min(top, min(x.size for x, _ in runs) // 3)
    rests = [residuals(runs, d) for d in range(top + 1)]
    n = sum(x.size for x, _ in runs)
    spent = 2.0 * (len(runs) - 1)
    # the samples of a run are not independent: count them by the correlation of neighbours
    m = max(sum(_independent(r) for r in rests[-1]) - spent, top + 4.0)
    size = max(float(np.abs(z).max()) for _, z in runs)
    floor = n * (_ROUNDING * size) ** 2 + 1e-300
    squares = [max(sum(float(r @ r) for r in rest), floor) for rest in rests]
    scores: list[dict[str, float]] = []
    for d, square in enumerate(squares):
        k = d + 2
        scores.append(
            {
                "degree": d,
                "aicc": m * math.log(square / squares[0])
                + 2 * k
                + 2 * k * (k + 1) / max(m - k - 1, 1),
                "residual_rms_nm": math.sqrt(square / n) * 1e9,
                "independent_samples": m,
            }
        )
    for d, (before, after) in enumerate(itertools.pairwise(squares), start=1):
        scores[d]["p_of_f_test"] = _f_test(before - after, after, m - d - 1.0)
    if rule == "aicc":
        return int(np.argmin([s["aicc"] for s in scores])), scores
    kept = [d for d, s in enumerate(scores) if s.get("p_of_f_test", 1.0) < _SIGNIFICANT]
    return max(kept, default=0), scores


def residuals(runs: Runs, degree: int) -> list[FloatArray]:
    """Return what one polynomial leaves, every run but the mean with its own offset and slope."""
    low = min(float(x[0]) for x, _ in runs)
    high = max(float(x[-1]) for x, _ in runs)
    blocks, last = [], len(runs) - 1
    for i, (x, _) in enumerate(runs):
        u = (2.0 * x - low - high) / (high - low)
        own = np.zeros((x.size, last, 2))
        if i < last:
            own[:, i] = power.polyvander(u, 1)
        else:
            own[:] = -power.polyvander(u, 1)[:, None, :]
        blocks.append(np.hstack([power.polyvander(u, degree), own.reshape(x.size, -1)]))
    basis, z = np.vstack(blocks), np.concatenate([z for _, z in runs])
    rest = z - basis @ np.linalg.lstsq(basis, z, rcond=None)[0]
    return np.split(rest, np.cumsum([x.size for x, _ in runs])[:-1])


def _independent(rest: FloatArray) -> float:
    norm = float(rest @ rest)
    r = max(float(rest[1:] @ rest[:-1]) / norm, 0.0) if norm > 0.0 else 0.0
    return rest.size * (1.0 - r) / (1.0 + r)


def _f_test(gain: float, rest: float, freedom: float) -> float:
    from scipy.special import fdtrc

    if freedom < 1.0:
        return 1.0
    return float(fdtrc(1.0, freedom, max(gain, 0.0) / rest * freedom))
