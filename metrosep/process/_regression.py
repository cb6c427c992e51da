"""Private: linear regression whose residuals are not independent, with honest uncertainty."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrosep.core.errors import DegenerateFitError, TooFewSamplesError

FloatArray = NDArray[np.float64]

_CONDITION = 1e-9
"""Smallest singular value of the scaled design, relative, below which terms are one."""


@dataclass(frozen=True, slots=True)
class Regression:
    """Coefficients, covariance, residual and how many independent samples it is worth."""

    coefficients: FloatArray
    cov: FloatArray
    residual: FloatArray
    bandwidth: int
    inflation: float


def regress(basis: FloatArray, y: FloatArray, segments: NDArray[np.intp]) -> Regression:
    """Return least squares with the Newey-West covariance, residuals prewhitened by one lag.

    `segments` numbers the stretches without a gap; products are never taken across a gap. The
    bandwidth is the rule of Andrews for a first-order process.
    """
    n, k = basis.shape
    if n < 2 * k + 4:
        raise TooFewSamplesError(f"{k} terms need at least {2 * k + 4} samples, got {n}")
    scale = np.linalg.norm(basis, axis=0)
    if (scale == 0.0).any():
        raise DegenerateFitError("a term of the regression is zero throughout; the axis stands")
    design = basis / scale
    u, s, vt = np.linalg.svd(design, full_matrices=False)
    if s[-1] < _CONDITION * s[0]:
        raise DegenerateFitError(
            "the terms of the regression cannot be told apart in this motion; leave one out or "
            "log a motion of more than one frequency"
        )
    coefficients = vt.T @ ((u.T @ y) / s)
    residual = y - design @ coefficients
    bread = vt.T / s
    cov, bandwidth = _long_run(design * residual[:, None], residual, segments)
    cov = bread @ (bread.T @ cov @ bread) @ bread.T * n / (n - k)
    white = bread @ bread.T * float(residual @ residual) / (n - k)
    inflation = float(np.sqrt(np.max(np.diag(cov) / np.maximum(np.diag(white), 1e-300))))
    # residuals that look less than independent are not believed
    if inflation < 1.0:
        cov = cov / max(inflation, 1e-3) ** 2 if inflation > 0.0 else white
        inflation = 1.0
    return Regression(
        coefficients / scale, cov / np.outer(scale, scale), residual, bandwidth, inflation
    )


def _long_run(
    scores: FloatArray, residual: FloatArray, segments: NDArray[np.intp]
) -> tuple[FloatArray, int]:
    """Return the sum of the covariances of the scores over all lags, and the bandwidth."""
    same = segments[1:] == segments[:-1]
    power = float(residual @ residual)
    lag = float(residual[1:][same] @ residual[:-1][same]) / power if power > 0.0 else 0.0
    lag = min(max(lag, 0.0), 0.995)
    white = scores[1:][same] - lag * scores[:-1][same]
    parts = segments[1:][same]
    gamma = white.T @ white
    left = _rest_correlation(white, parts)
    bandwidth = min(left, max(white.shape[0] // 4, 1))
    total = gamma.copy()
    for h in range(1, bandwidth + 1):
        together = parts[h:] == parts[:-h]
        part = white[h:][together].T @ white[:-h][together]
        total += (1.0 - h / (bandwidth + 1.0)) * (part + part.T)
    return total / (1.0 - lag) ** 2, bandwidth


def _rest_correlation(white: FloatArray, parts: NDArray[np.intp]) -> int:
    """Return the bandwidth of Andrews (Bartlett) for what prewhitening left."""
    together = parts[1:] == parts[:-1]
    above = below = 0.0
    for column in white.T:
        power = float(column @ column)
        if power <= 0.0:
            continue
        r = float(column[1:][together] @ column[:-1][together]) / power
        r = min(max(r, -0.97), 0.97)
        above += 4.0 * r**2 / (1 - r) ** 6 / (1 + r) ** 2
        below += 1.0 / (1 - r) ** 4
    rule = 1.1447 * (above / max(below, 1e-300) * white.shape[0]) ** (1.0 / 3.0)
    return int(max(math.ceil(rule), math.ceil(4.0 * (white.shape[0] / 100.0) ** (2.0 / 9.0))))
