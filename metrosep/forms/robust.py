"""Weights that keep outliers from pulling a fit: Tukey's biweight and Huber's rule."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from metrosep.core.errors import DataError

__all__ = ["Robust", "robust_weights", "spread"]

FloatArray = NDArray[np.float64]
Robust = Literal["tukey", "huber"]

_TUNING = {"tukey": 4.685, "huber": 1.345}
"""95 % efficiency for Gaussian noise (Holland and Welsch 1977)."""

_NORMAL_MAD = 1.4826
"""Standard deviation of Gaussian noise over its median absolute deviation."""


def spread(deviation: FloatArray) -> float:
    """Return the standard deviation that Gaussian noise of this median magnitude has.

    Parameters
    ----------
    deviation : ndarray, m
        From the fit; NaN is left out.

    Returns
    -------
    float, m
        1.4826 times the median magnitude.
    """
    valid = np.abs(deviation[~np.isnan(deviation)])
    return _NORMAL_MAD * float(np.median(valid)) if valid.size else 0.0


def robust_weights(deviation: FloatArray, scale: float, rule: Robust) -> FloatArray:
    """Return the weight of each point, 0 to 1.

    Parameters
    ----------
    deviation : ndarray, m
        From the fit.
    scale : float, m
        Spread of the good points; 0 keeps only those without deviation.
    rule : {"tukey", "huber"}
        Tukey's biweight ends at zero, Huber's rule bounds the pull of a point.

    Returns
    -------
    ndarray
        Same shape; NaN where the deviation is.

    Raises
    ------
    DataError
        If the rule is unknown.
    """
    if rule not in _TUNING:
        raise DataError(f"robust must be one of {', '.join(_TUNING)}, got {rule!r}")
    limit = _TUNING[rule] * scale
    magnitude = np.abs(deviation)
    if limit == 0.0:
        return np.where(np.isnan(deviation), np.nan, (magnitude == 0.0).astype(np.float64))
    if rule == "tukey":
        inside = 1.0 - np.minimum(magnitude / limit, 1.0) ** 2
        return inside * inside
    return np.minimum(1.0, limit / np.maximum(magnitude, limit))
