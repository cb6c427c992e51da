"""Private to separation: score tests of what the fit left out: a square of the feed, a lag."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.separation._unknowns import Lag
from metrosep.separation.system import System, whitened
from metrosep.spectral.autoregressive import AutoregressiveModel

__all__ = ["lag_score", "square_of_feed_score", "whitened_rows"]


def square_of_feed_score(
    system: System, covariance: FloatArray, *, kind: str
) -> tuple[float, int] | None:
    """Return the score test of a part that grows with the square of the feedrate."""
    rel = system.terms.relative_speed
    score, own, cross = _score(
        system, lambda i: _columns(system, i, kind) * (rel[i] ** 2 - float(np.mean(rel**2)))
    )
    information = own - cross.T @ covariance @ cross
    values, vectors = np.linalg.eigh(information)
    seen = values > 1e-6 * float(np.diag(own).max())
    if not seen.any():
        return None
    along = vectors[:, seen].T @ score
    return float(np.sum(along**2 / values[seen])), int(seen.sum())


def lag_score(system: System, covariance: FloatArray) -> tuple[float, float, FloatArray] | None:
    """Return the lag beside the one at hand, its u, and the change of the solution with it.

    With g the score and I the information that the other unknowns leave: lag = g/I, u = 1/sqrt(I),
    chi-square of 1 degree (lag/u)^2; the solution changes by - C b for each second, b the cross
    information.
    """
    column = Lag().column
    score, own, cross = _score(system, lambda i: column(system, i, system.basis(i))[:, None])
    along = covariance @ cross[:, 0]
    information = float(own[0, 0] - cross[:, 0] @ along)
    if information <= 1e-9 * float(own[0, 0]):
        return None
    return float(score[0]) / information, information**-0.5, -along


def _score(
    system: System, columns_of: Callable[[int], FloatArray]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return score, own and cross information of extra columns at the solution."""
    n, q = system.n_fixed + 2 * system.n_harmonics, columns_of(0).shape[1]
    score, own, cross = np.zeros(q), np.zeros((q, q)), np.zeros((n, q))
    for group, model in zip(system.groups, system.noise, strict=True):
        for i in group:
            rows, extra, rest, variance = whitened_rows(system, i, model, columns_of(i))
            variance *= system.sharing[0]
            score += extra.T @ rest / variance
            own += extra.T @ extra / variance
            cross += rows.T @ extra / variance
    return score, own, cross


def _columns(system: System, index: int, kind: str) -> FloatArray:
    if kind == "waves":
        return system.terms.waves(index)
    curve = system.basis(index) @ system.solution[system.n_fixed :]
    return np.asarray(curve[:, None])


def whitened_rows(
    system: System, index: int, model: AutoregressiveModel, columns: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Return whitened design, extra columns, residual and variance of a row."""
    design = np.hstack([system.design(index), columns])
    n = design.shape[1]
    variance = model.variance
    if system.weights is None:
        rows, values = whitened(design, system.z[index], model.coefficients)
    else:
        marks = system.weights.marks(index)
        rows, values = whitened(np.hstack([design, marks]), system.z[index], model.coefficients)
        rows, values = system.weights.apply(index, rows, values, n)
        variance /= system.weights.information(index)
    first = n - columns.shape[1]
    return rows[:, :first], rows[:, first:], values - rows[:, :first] @ system.solution, variance
