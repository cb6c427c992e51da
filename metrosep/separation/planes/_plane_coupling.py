"""Coupling of x and y in maps of a plane: what f(x) + g(y) leaves, tested against the noise."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import NotSeparableError, TooFewSamplesError
from metrosep.core.quantity import Quantity
from metrosep.separation._readings import positive

__all__ = ["Interaction", "coupling", "two_way"]


_DEGREE = 2
"""Degrees in x and in y of the smooth coupling that a single map is tested for."""


@dataclass(frozen=True, slots=True)
class Interaction:
    """How much of a map is neither f(x) nor g(y), and whether that is more than noise.

    Parameters
    ----------
    share : float
        Part of the variance of the map about its plane that the sum model does not describe,
        0 to 1, noise included.
    rms : float, m
        RMS of the coupling, the expected share of the noise taken off; 0 where noise explains all.
    f, p : float
        F statistic and the probability of a larger one without coupling.
    dof : tuple of (float, float)
        Degrees of freedom of coupling and noise.
    noise_from : str
        ``"repeats"``, ``"u_reading"``, or ``"residual of smooth terms"`` where only smooth
        coupling is tested, because one map cannot tell rough coupling from noise.
    """

    share: float
    rms: float
    f: float
    p: float
    dof: tuple[float, float]
    noise_from: str


def two_way(z: FloatArray, count: NDArray[np.int64]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Rows' and columns' effects by weighted least squares, and the inverse of the normal matrix."""
    n_y = z.shape[0]
    weights = count.astype(np.float64)
    matrix = np.block(
        [[np.diag(weights.sum(axis=1)), weights], [weights.T, np.diag(weights.sum(axis=0))]]
    )
    filled = np.where(count > 0, z, 0.0) * weights
    right = np.concatenate([filled.sum(axis=1), filled.sum(axis=0)])
    values, vectors = np.linalg.eigh(matrix)
    free = values < 1e-9 * values[-1]
    if free.sum() > 1:
        raise NotSeparableError(
            f"the measured points fall into {int(free.sum())} groups that share no row or column; "
            "measure lines that cross them"
        )
    inverse = (vectors[:, ~free] / values[~free]) @ vectors[:, ~free].T
    solution = inverse @ right
    return solution[:n_y], solution[n_y:], inverse


def coupling(
    stack: FloatArray,
    mean: FloatArray,
    count: NDArray[np.int64],
    residual: FloatArray,
    u_reading: float | None,
) -> tuple[Interaction, Quantity]:
    from scipy import stats

    measured = count > 0
    weights = count[measured].astype(np.float64)
    left = residual[measured]
    squares = float(weights @ left**2)
    dof = int(measured.sum()) - sum(mean.shape) + 1
    if dof < 1:
        raise TooFewSamplesError(
            "every measured point is used up by f and g; measure more crossings of rows and columns"
        )
    spare = int(count.sum() - measured.sum())
    share = squares / max(_about_plane(mean, count), np.finfo(float).tiny)
    if spare:
        source, noise_dof = "repeats", float(spare)
        variance = float(np.nansum((stack - mean) ** 2)) / spare
    elif u_reading is not None:
        variance = positive(u_reading, "u_reading", "m") ** 2
        source, noise_dof = "u_reading", math.inf
    else:
        source = "residual of smooth terms"
        squares_smooth, n_smooth = _smooth_coupling(mean, measured, left)
        noise_dof = float(dof - n_smooth)
        if noise_dof < 1:
            raise TooFewSamplesError(
                "one small map cannot tell coupling from noise; give repeats or u_reading"
            )
        variance = max(squares - squares_smooth, 0.0) / noise_dof
        squares, dof = squares_smooth, n_smooth
    f = squares / dof / variance if variance > 0.0 else (math.inf if squares > 0.0 else 0.0)
    law = stats.f if math.isfinite(noise_dof) else None
    p = float(law.sf(f, dof, noise_dof)) if law else float(stats.chi2.sf(f * dof, dof))
    rms = math.sqrt(max(squares - dof * variance, 0.0) / float(weights.sum()))
    u_noise = math.sqrt(variance / (2.0 * noise_dof)) if math.isfinite(noise_dof) else None
    noise = Quantity(
        math.sqrt(variance), "m", f"standard deviation of one reading, from {source}",
        u=u_noise, symbol="s",
    )  # fmt: skip
    return Interaction(share, rms, f, p, (float(dof), noise_dof), source), noise


def _about_plane(mean: FloatArray, count: NDArray[np.int64]) -> float:
    rows, columns = np.nonzero(count)
    root = np.sqrt(count[rows, columns])
    basis = np.column_stack([np.ones(rows.size), rows, columns]) * root[:, np.newaxis]
    z = mean[rows, columns] * root
    rest = z - basis @ np.linalg.lstsq(basis, z, rcond=None)[0]
    return float(rest @ rest)


def _smooth_coupling(
    mean: FloatArray, measured: NDArray[np.bool_], left: FloatArray
) -> tuple[float, int]:
    """Sum of squares that products of low polynomials take out of the residual, and their number."""
    from numpy.polynomial import legendre

    rows, columns = np.nonzero(measured)
    n_y, n_x = mean.shape
    p_y = legendre.legvander(2.0 * np.arange(n_y) / (n_y - 1) - 1.0, _DEGREE)[:, 1:]
    p_x = legendre.legvander(2.0 * np.arange(n_x) / (n_x - 1) - 1.0, _DEGREE)[:, 1:]
    terms = []
    for i in range(_DEGREE):
        for j in range(_DEGREE):
            product = np.where(measured, np.outer(p_y[:, i], p_x[:, j]), np.nan)
            g, f, _ = two_way(product, measured.astype(np.int64))
            terms.append((product - g[:, np.newaxis] - f)[rows, columns])
    basis, sizes, _ = np.linalg.svd(np.column_stack(terms), full_matrices=False)
    kept = sizes > 1e-9 * sizes[0]
    taken = basis[:, kept].T @ left
    return float(taken @ taken), int(kept.sum())
