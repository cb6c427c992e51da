"""Private to separation: the joint solution as a curve with its uncertainty, line removed."""

from __future__ import annotations

import math

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.quantity import Quantity
from metrosep.separation.curves import LINE_POINTS, FourierCurve, SampledCurve
from metrosep.separation.solver import Solution
from metrosep.spectral.dft import fourier_basis

__all__ = ["joint_curves"]


def joint_curves(
    solution: Solution, evaluation: tuple[float, float], travel: tuple[float, float]
) -> tuple[FourierCurve, SampledCurve, Quantity, float]:
    """Return curve, uncertainty, slope and level; the line over the evaluation range is taken out."""
    k = solution.n_harmonics
    step = solution.period / max(k, 8) / 8.0
    n_grid = int(np.clip(np.ceil((travel[1] - travel[0]) / step), 200, 4000)) + 1
    grid = np.linspace(travel[0], travel[1], n_grid)
    inner = np.linspace(evaluation[0], evaluation[1], LINE_POINTS)

    def functions(x: FloatArray) -> FloatArray:
        waves = fourier_basis(x, origin=solution.origin, period=solution.period, n_harmonics=k)
        return np.column_stack([x - solution.centre, waves])

    mid, half = np.mean(evaluation), (evaluation[1] - evaluation[0]) / 2.0
    line = np.column_stack([np.ones(inner.size), (inner - mid) / half])
    to_line = np.linalg.lstsq(line, functions(inner), rcond=None)[0]
    projected = functions(grid) - np.column_stack([np.ones(n_grid), (grid - mid) / half]) @ to_line
    variance = np.einsum("ij,jk,ik->i", projected, solution.covariance, projected)
    offset, slope_half = to_line @ solution.coefficients
    slope_variance = float(to_line[1] @ solution.covariance @ to_line[1]) / half**2
    slope = float(slope_half / half)
    rest = solution.coefficients[0] - slope
    curve = FourierCurve(
        origin=solution.origin,
        period=solution.period,
        cosine=solution.coefficients[1 : k + 1].copy(),
        sine=solution.coefficients[k + 1 :].copy(),
        offset=float(
            rest * (solution.origin - solution.centre) - offset + slope * (mid - solution.centre)
        ),
        slope=float(rest),
        travel=travel,
    )
    alignment = Quantity(
        slope,
        "rad",
        "slope of the least-squares line over the evaluation range (alignment of artefact and "
        "axis, or squareness); removed from the estimate",
        u=math.sqrt(max(slope_variance, 0.0)),
    )
    return curve, SampledCurve(grid, np.sqrt(np.maximum(variance, 0.0))), alignment, float(offset)
