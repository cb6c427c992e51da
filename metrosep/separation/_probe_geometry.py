"""What an arrangement of probes sees of each harmonic: least squares, noise gain, residual.

For undulation k the readings are ``M_i = R e_i + X cos(phi_i) + Y sin(phi_i)`` with
``e_i = exp(j k t phi_i)``, t = +1 or -1 the turn. What cos and sin cannot explain of e is what
shows R: with C the covariance of the readings, V its inverse and P the projector on what V finds
orthogonal to cos and sin, ``R = (P e)* V M / (e* V P e)``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import ComplexArray, FloatArray
from metrosep.core.errors import InvalidSamplesError, NotSeparableError

__all__ = ["ProbeGeometry", "probe_geometry"]


_COLLINEAR = 1e-6
"""Smallest ratio of the singular values of (cos, sin): probes on a line see one direction."""

_NO_COUPLING = 1e-9
"""A motion that a hidden artefact harmonic moves by less than this is still observable."""


@dataclass(frozen=True, slots=True)
class ProbeGeometry:
    """Estimators of all harmonics 0 ... kmax."""

    # of complex, shape (3, kmax + 1, n): what R, X and Y are made of; NaN where not observable
    rows: ComplexArray
    # shape (3, kmax + 1): noise of R, X, Y over the root mean square noise of the probes; inf
    # where not observable
    gain: FloatArray
    # of complex, shape (kmax + 1, n, n): whitened part of the readings that no artefact and no
    # motion explains
    residual: ComplexArray
    # shape (kmax + 1,): complex degrees of freedom of that part; 0 for k = 0 and 1
    freedom: NDArray[np.int64]
    whitener: FloatArray  # shape (n, n): makes readings of unit root mean square noise white


def probe_geometry(
    angles: FloatArray, kmax: int, *, covariance: FloatArray | None, max_gain: float, turn: int
) -> ProbeGeometry:
    """Return the estimators of an arrangement; harmonics with a larger gain are not observable."""
    n = angles.size
    relative = np.eye(n) if covariance is None else covariance * (n / np.trace(covariance))
    whitener = _whitener(relative)
    motion = whitener @ np.column_stack([np.cos(angles), np.sin(angles)])
    left, size, right = np.linalg.svd(motion, full_matrices=False)
    if size[1] < _COLLINEAR * size[0]:
        raise NotSeparableError(
            "the probes stand on one line through the axis, so they see one direction of the "
            "motion only; spread the angles"
        )
    to_motion = right.T @ (left / size).T
    k = np.arange(kmax + 1)
    artefact = np.exp(1j * turn * np.outer(k, angles)) @ whitener.T
    seen = artefact - (artefact @ left) @ left.T
    size2 = np.sum(np.abs(seen) ** 2, axis=1)
    hidden = size2 * max_gain**2 < 1.0
    hidden[:2] = True
    seen[hidden] = 0.0
    size2[hidden] = 1.0
    row_r = seen.conj() / size2[:, np.newaxis]
    coupling = artefact @ to_motion.T
    rows = np.empty((3, k.size, n), dtype=np.complex128)
    rows[0] = row_r
    rows[0, hidden] = np.nan
    for part in (0, 1):
        share = coupling[:, part]
        rows[1 + part] = to_motion[part] - share[:, np.newaxis] * row_r
        rows[1 + part, hidden & (np.abs(share) > _NO_COUPLING)] = np.nan
    rows[:, :2] = np.nan
    gain = np.sqrt(np.sum(np.abs(rows) ** 2, axis=2))
    gain = np.where(np.isnan(gain), np.inf, gain)
    unit = seen / np.sqrt(size2)[:, np.newaxis]
    residual = (np.eye(n) - left @ left.T) - unit[:, :, np.newaxis] * unit[:, np.newaxis].conj()
    residual[hidden] = 0.0
    freedom = np.where(hidden, 0, n - 3).astype(np.int64)
    return ProbeGeometry(rows @ whitener, gain, residual, freedom, whitener)


def _whitener(covariance: FloatArray) -> FloatArray:
    try:
        lower = np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError as exc:
        raise InvalidSamplesError(
            "cov is not positive definite; give variances > 0 in m^2, and correlations below 1"
        ) from exc
    out: FloatArray = np.linalg.inv(lower)
    return out
