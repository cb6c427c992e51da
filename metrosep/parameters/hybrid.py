"""Hybrid parameters: local gradient of a profile by the 7-point formula.

The formula is exact for polynomials up to degree 6. It needs three valid neighbours on both
sides; where one is missing there is no gradient, and nothing is filled.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError

__all__ = ["local_gradient", "root_mean_square_gradient", "valid_gradient"]

_STENCIL = 7


def local_gradient(heights: ArrayLike, *, dx: float) -> FloatArray:
    """Return dz/dx at the samples with three valid neighbours on both sides.

    References
    ----------
    .. [1] ISO 4287:1997, 3.2.6 (recalled).

    Examples
    --------
    >>> local_gradient([0, 1, 2, 3, 4, 5, 6], dx=2.0)[3]
    np.float64(0.5)
    """
    z = np.asarray(heights, dtype=np.float64)
    if not (np.isfinite(dx) and dx > 0.0):
        raise DataError(f"the step dx must be finite and positive, got {dx}")
    if z.ndim != 1 or np.isinf(z).any():
        raise InvalidSamplesError("heights for a gradient must be one row without infinite values")
    gradient = np.full(z.size, np.nan)
    if z.size >= _STENCIL:
        near = 45.0 * (z[4:-2] - z[2:-4])
        far = -9.0 * (z[5:-1] - z[1:-5]) + (z[6:] - z[:-6])
        complete = ~np.isnan(z[3:-3])
        gradient[3:-3] = np.where(complete, (near + far) / (60.0 * dx), np.nan)
    return gradient


def root_mean_square_gradient(heights: ArrayLike, *, dx: float) -> float:
    """Return dq, the root mean square of the local gradient.

    References
    ----------
    .. [1] ISO 4287:1997, 4.4.1 (recalled).

    Examples
    --------
    >>> root_mean_square_gradient([0, 1, 2, 3, 4, 5, 6], dx=2.0)
    0.5
    """
    return float(np.sqrt(np.mean(valid_gradient(heights, dx=dx) ** 2)))


def valid_gradient(heights: ArrayLike, *, dx: float) -> FloatArray:
    """Return the local gradients that exist."""
    gradient = local_gradient(heights, dx=dx)
    found: FloatArray = gradient[~np.isnan(gradient)]
    if found.size == 0:
        raise TooFewSamplesError(
            f"the gradient needs {_STENCIL} consecutive valid samples and there are none; use a "
            "longer profile or a smaller step"
        )
    return found
