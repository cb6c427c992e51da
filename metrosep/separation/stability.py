"""Allan deviation: how long averaging pays before drift takes over."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray, frozen_float
from metrosep.core.errors import InvalidSamplesError, TooFewSamplesError

__all__ = ["allan_deviation"]


def allan_deviation(
    t: ArrayLike, z: ArrayLike, *, n_times: int = 30
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return averaging times, overlapping Allan deviation of a reading, and its uncertainty.

    Parameters
    ----------
    t : array_like, shape (n,), s
        Equally spaced times, n >= 4.
    z : array_like, shape (n,)
        Readings without gaps.
    n_times : int, optional
        About how many averaging times, spread over the logarithm.

    Returns
    -------
    tuple of (ndarray, ndarray, ndarray)
        tau in s; deviation in the unit of z; standard uncertainty (about ``dev / sqrt(2 n / m)``
        with n / m independent averages).

    Raises
    ------
    InvalidSamplesError
        If times are not equally spaced, lengths differ, or a reading is missing.
    TooFewSamplesError
        If there are fewer than 4 readings.

    Notes
    -----
    ``dev(tau)^2 = mean (zbar(t + tau) - zbar(t))^2 / 2`` with means over tau. White noise falls as
    ``sd sqrt(dt / tau)``; a linear drift rises as ``rate tau / sqrt 2``. The minimum is the longest
    averaging that pays.

    References
    ----------
    .. [1] D. W. Allan, Proc. IEEE 54 (1966) 221, two-sample variance.

    Examples
    --------
    >>> import numpy as np
    >>> tau, dev, _ = allan_deviation(np.arange(64.0), 1e-9 * np.arange(64.0))
    >>> bool(abs(dev[0] - 1e-9 / 2**0.5) < 1e-20)
    True
    """
    times = frozen_float(t, name="t", ndim=1)
    values = frozen_float(z, name="z", ndim=1)
    if times.size != values.size:
        raise InvalidSamplesError(f"t has {times.size} times, z has {values.size} readings")
    n = times.size
    if n < 4:
        raise TooFewSamplesError(f"an Allan deviation needs 4 readings, got {n}")
    if np.isnan(values).any():
        raise InvalidSamplesError(
            f"{int(np.isnan(values).sum())} readings are NaN: evaluate a stretch without gaps"
        )
    steps = np.diff(times)
    dt = float(times[-1] - times[0]) / (n - 1)
    if not (steps > 0.0).all() or float(np.abs(steps - dt).max()) > 1e-3 * dt:
        raise InvalidSamplesError("times are not equally spaced; resample the readings first")
    m = np.unique(np.round(np.geomspace(1, n // 3, max(int(n_times), 1))).astype(np.intp))
    total = np.concatenate([[0.0], np.cumsum(values - values.mean())])
    deviation = np.empty(m.size)
    for i, k in enumerate(m):
        means = (total[k:] - total[:-k]) / k
        second = means[k:] - means[:-k]
        deviation[i] = math.sqrt(float(second @ second) / second.size / 2.0)
    independent = np.maximum(n / m - 1.0, 1.0)
    return np.asarray(m * dt, dtype=np.float64), deviation, deviation / np.sqrt(2.0 * independent)
