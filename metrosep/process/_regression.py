"""Private: linear regression whose residuals are not independent, with honest uncertainty."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DegenerateFitError, TooFewSamplesError
from metrosep.process._long_run import long_run

_CONDITION = 1e-9
"""Smallest singular value of the scaled design, relative, below which terms are one."""


@dataclass(frozen=True, slots=True)
class Regression:
    """Coefficients, covariance, residual and over how many samples the residual is correlated."""

    coefficients: FloatArray
    cov: FloatArray
    residual: FloatArray
    bandwidth: int
    inflation: float


def regress(
    basis: FloatArray,
    y: FloatArray,
    segments: NDArray[np.intp],
    *,
    at: NDArray[np.intp] | None = None,
) -> Regression:
    """Return least squares with a covariance that knows how the residuals hang together.

    `segments` numbers the stretches without a gap, `at` places the samples on the time grid; a
    gap counts as one sample where that is not known. Residuals that look less than independent are
    not believed, and noise that is larger where a term is large widens that term.
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
    back = vt.T / s
    coefficients = back @ (u.T @ y)
    residual = y - design @ coefficients
    place = np.arange(n) + segments if at is None else at
    found = long_run(u, residual, place)
    cov = back @ found.cov @ back.T
    power = float(residual @ residual) / (n - k)
    white = back @ back.T * power
    inflation = 1.0
    if power > 0.0:
        scores = u * residual[:, None]
        uneven = back @ (scores.T @ scores) @ back.T / power
        least = np.diag(white)
        wider = np.sqrt(np.maximum(np.diag(uneven) / np.diag(back @ back.T), 1.0))
        wider = wider * np.sqrt(np.maximum(least / np.maximum(np.diag(cov), 1e-300), 1.0))
        cov = cov * np.outer(wider, wider)
        inflation = float(np.sqrt(np.max(np.diag(cov) / least)))
    return Regression(
        coefficients / scale,
        cov / np.outer(scale, scale),
        residual,
        math.ceil(found.samples),
        inflation,
    )
