"""Periodic windows for spectra: Hann and the cosine taper of a fraction, with their gains.

Periodic: the window of n samples is one period of a function of period n, so its transform has
exact zeros. Hann's has three lines, 1/2 and twice -1/4: a wave that fits the record n times is
read on its bin and with half its amplitude on the two beside it.

Source: Harris 1978, Proc. IEEE 66(1), sections IV and V.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.numbers import between, count

__all__ = ["coherent_gain", "hann_weights", "noise_bandwidth", "taper_weights"]


def hann_weights(n: int) -> FloatArray:
    """Return the periodic Hann window ``sin^2(pi i / n)``, i = 0 ... n - 1.

    Parameters
    ----------
    n : int
        Number of samples, >= 1.

    Returns
    -------
    ndarray, shape (n,), dimensionless
        0 at the first sample, 1 in the middle of an even n.

    Raises
    ------
    DataError
        If n is not a whole number from 1.

    Examples
    --------
    >>> hann_weights(4).round(12).tolist()
    [0.0, 0.5, 1.0, 0.5]
    """
    return taper_weights(n, 1.0)


def taper_weights(n: int, fraction: float) -> FloatArray:
    """Return the periodic cosine taper (Tukey) of which a fraction ramps.

    Parameters
    ----------
    n : int
        Number of samples, >= 1.
    fraction : float, dimensionless
        Share of the record in both ramps together: 0 is not a window, 1 is Hann.

    Returns
    -------
    ndarray, shape (n,), dimensionless
        Between 0 and 1.

    Raises
    ------
    DataError
        If n is not a whole number from 1 or the fraction is outside 0 ... 1.

    Notes
    -----
    The symmetric taper of `metrosep.spectral.tukey_weights` counts samples per ramp instead.

    References
    ----------
    .. [1] Harris 1978, eq. 38.

    Examples
    --------
    >>> taper_weights(8, 0.5).round(12).tolist()
    [0.0, 0.5, 1.0, 1.0, 1.0, 1.0, 1.0, 0.5]
    """
    n = count(n, "the number of samples n of a window")
    between(fraction, "the tapered fraction", 0.0, 1.0)
    if fraction == 0.0:
        return np.ones(n)
    i = np.arange(n)
    ramp = np.minimum(np.minimum(i, n - i) / (0.5 * fraction * n), 1.0)
    return np.asarray(np.sin(0.5 * np.pi * ramp) ** 2)


def coherent_gain(weights: ArrayLike) -> float:
    """Return the mean of a window: what is left of the amplitude of a wave on a bin.

    Parameters
    ----------
    weights : array_like, shape (n,), dimensionless
        The window.

    Returns
    -------
    float, dimensionless
        1/2 for the periodic Hann window.

    Examples
    --------
    >>> coherent_gain(hann_weights(100))
    0.5
    """
    return float(np.mean(np.asarray(weights, dtype=np.float64)))


def noise_bandwidth(weights: ArrayLike) -> float:
    """Return the equivalent noise bandwidth of a window in bins.

    Parameters
    ----------
    weights : array_like, shape (n,), dimensionless
        The window, not zero everywhere.

    Returns
    -------
    float, bins
        ``n sum w^2 / (sum w)^2``; 1.5 for the periodic Hann window.

    Examples
    --------
    >>> round(noise_bandwidth(hann_weights(100)), 12)
    1.5
    """
    w = np.asarray(weights, dtype=np.float64)
    return float(w.size * (w @ w) / w.sum() ** 2)
