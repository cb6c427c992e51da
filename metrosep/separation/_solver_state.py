"""Private to separation: one step of the joint solver, coefficients and prior in turn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DegenerateFitError
from metrosep.separation.shrinkage import Cavity, OctavePrior, PriorWeights
from metrosep.separation.system import System

__all__ = ["INNER", "SolverState", "first_state", "iterate"]


INNER = 12
"""Rounds of coefficients and prior for one noise model."""


def _posterior(
    gram: FloatArray, right: FloatArray, precision: FloatArray
) -> tuple[FloatArray, FloatArray]:
    from scipy.linalg.lapack import dpotrf, dpotri

    matrix = gram + np.diag(precision)
    scale = 1.0 / np.sqrt(np.diag(matrix))
    factor, info = dpotrf(matrix * scale[:, None] * scale, lower=1, clean=1)
    inverse = factor
    if info == 0:
        inverse, info = dpotri(factor, lower=1)
    if info != 0:
        raise DegenerateFitError(
            "the runs do not determine the model: two runs or wavelengths are indistinguishable; "
            "ask for longer wavelengths (shortest=) or add runs"
        )
    full = np.tril(inverse) + np.tril(inverse, -1).T
    covariance = full * scale[:, None] * scale
    return covariance @ right, covariance


@dataclass(slots=True)
class SolverState:
    """Prior, posterior covariance and effective parameters between two steps."""

    prior: OctavePrior
    weights: PriorWeights
    cavity: Cavity | None = None
    covariance: FloatArray | None = None
    freedom: float = 0.0


def iterate(system: System, state: SolverState, n_inner: int, *, learn_from: int) -> None:
    """Solve for the coefficients and the prior in turn, at a given noise model."""
    gram, right = system.normal_equations()
    f, k = system.n_fixed, system.n_harmonics
    ia, ib = f + np.arange(k), f + k + np.arange(k)
    for i in range(n_inner):
        precision = np.zeros(f + 2 * k)
        precision[f:] = np.tile(1.0 / state.weights.tau2, 2)
        precision[:f] = system.fixed_precision()
        mean, covariance = _posterior(gram, right, precision)
        variance = np.diag(covariance)
        state.freedom = f + float(np.sum(2.0 - (variance[ia] + variance[ib]) / state.weights.tau2))
        if system.terms.size:
            extra = system.extra
            held = float(system.terms.precision() @ variance[extra])
            state.freedom -= held
            system.terms.learn(mean[extra], variance[extra])
        state.cavity = Cavity.from_posterior(
            (mean[ia], mean[ib]),
            (variance[ia], variance[ib], covariance[ia, ib]),
            state.weights.tau2,
        )
        state.weights = state.prior.update(state.cavity, learn=i >= learn_from)
        system.solution, state.covariance = mean, covariance


def first_state(n_harmonics: int) -> SolverState:
    """Return the state before anything was learnt: every wavelength may be as strong as the runs."""
    nothing = np.zeros(n_harmonics)
    return SolverState(
        OctavePrior(n_harmonics),
        PriorWeights(np.full(n_harmonics, 0.25), nothing, (nothing, nothing, nothing)),
    )
