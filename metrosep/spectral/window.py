"""Weights that taper a record at both ends.

`kono_weights` is eq. 5 of the paper motion-error-fourier to the letter, with its asymmetry: it
starts at 0 and ends at ``sin^2(pi / 2N)``. `tukey_weights` is the symmetric cosine taper.

Sources: Kono et al. 2008, eq. 5; Harris 1978 for the Tukey window.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metrosep.core.errors import DataError
from metrosep.core.numbers import count

__all__ = ["kono_weights", "tukey_weights"]


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
