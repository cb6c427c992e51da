"""Weights that taper a record at both ends.

`kono_weights` is eq. 5 of the paper motion-error-fourier to the letter, with its asymmetry: it
starts at 0 and ends at ``sin^2(pi / 2N)``. `tukey_weights` is the symmetric cosine taper.

Sources: Kono et al. 2008, eq. 5; Harris 1978 for the Tukey window.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.core.numbers import between, count


def _check(n: int, n_taper: int) -> None:
    count(n, "the number of samples n of a window")
    count(n_taper, "the number of samples N of a taper", least=0)
    if n_taper < 1 or 2 * n_taper > n:
        raise DataError(
            f"the taper must have 1 <= N <= n/2 samples at each end, got N = {n_taper} for n = {n}"
        )


def kono_weights(n: int, n_taper: int) -> NDArray[np.float64]:
    """Return the weights f(i) of eq. 5, i = 1 ... n.

    Parameters
    ----------
    n : int
        Number of sampling points n_d.
    n_taper : int
        Number N of sampling points in each convergence area, ``1 <= N <= n/2``; 10 % of `n` in
        the paper.

    Returns
    -------
    ndarray, shape (n,), dimensionless
        0 at the first sample, 1 on ``N <= i <= n - N``, ``sin^2(pi / 2N)`` at the last.

    Raises
    ------
    DataError
        If n or N is not a whole number, or N is out of range.

    Notes
    -----
    It equals the periodic Tukey window ``tukey(n, 2N/n, sym=False)`` in every sample but one:
    at i = N eq. 5 says 1, Tukey ``1 - sin^2(pi / 2N)``.

    References
    ----------
    .. [1] Kono et al. 2008, eq. 5.

    Examples
    --------
    >>> kono_weights(100, 10)[[0, 9, 90, 99]].round(7).tolist()
    [0.0, 1.0, 1.0, 0.0244717]
    """
    _check(n, n_taper)
    i = np.arange(1, n + 1, dtype=np.float64)
    weights = np.ones(n)
    rise = i < n_taper
    fall = i > n - n_taper
    weights[rise] = -0.5 * np.cos(2.0 * np.pi * (i[rise] - 1.0) / (2.0 * n_taper)) + 0.5
    weights[fall] = (
        -0.5 * np.cos(2.0 * np.pi * (i[fall] - n + n_taper - 1.0) / (2.0 * n_taper) - np.pi) + 0.5
    )
    return weights


def tukey_weights(n: int, n_taper: int) -> NDArray[np.float64]:
    """Return a symmetric cosine taper that ramps over `n_taper` intervals at each end.

    Parameters
    ----------
    n : int
        Number of samples.
    n_taper : int
        Samples in each ramp, ``1 <= n_taper <= n/2``.

    Returns
    -------
    ndarray, shape (n,), dimensionless
        0 at both ends, 1 in the middle.

    Raises
    ------
    DataError
        If `n` or `n_taper` is not a whole number, or `n_taper` is out of range.

    Examples
    --------
    >>> tukey_weights(9, 2).round(3).tolist()
    [0.0, 0.5, 1.0, 1.0, 1.0, 1.0, 1.0, 0.5, 0.0]
    """
    _check(n, n_taper)
    distance = np.minimum(np.arange(n), np.arange(n)[::-1]).astype(np.float64)
    ramp = 0.5 - 0.5 * np.cos(np.pi * np.minimum(distance / n_taper, 1.0))
    return np.asarray(ramp, dtype=np.float64)


# ---- periodic windows for spectra: Hann and the cosine taper of a fraction, with their gains ----
# Periodic: the window of n samples is one period of a function of period n, so its transform has
# exact zeros. Hann's has three lines, 1/2 and twice -1/4: a wave that fits the record n times is
# read on its bin and with half its amplitude on the two beside it.
#
# Source: Harris 1978, Proc. IEEE 66(1), sections IV and V.


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
