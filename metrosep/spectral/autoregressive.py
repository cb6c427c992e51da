"""Autoregressive models of noise in time: fit, order choice, whitening filter, spectrum.

``n_i = sum_j a_j n_{i-j} + w_i`` with white ``w`` of variance s^2. A vibration of a machine is a
narrow resonance, so a handful of coefficients whiten it. NaN marks samples that were not
measured: windows that touch one are left out, never bridged.

Source: covariance method of linear prediction; AICc of Hurvich and Tsai 1989.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import TooFewSamplesError

_RIDGE = 1e-12
"""Relative ridge on the normal matrix: a noise-free residual must not make it singular."""


@dataclass(frozen=True, slots=True)
class AutoregressiveModel:
    """Coefficients and innovation variance of an autoregressive process.

    Parameters
    ----------
    coefficients : ndarray, shape (p,)
        ``a_1 ... a_p``; empty for white noise.
    variance : float
        Variance of the innovation, squared unit of the data.
    time_step : float, s
        Sampling interval.
    """

    coefficients: FloatArray
    variance: float
    time_step: float

    @property
    def order(self) -> int:
        """Number p of coefficients."""
        return int(self.coefficients.size)

    def psd(self, frequency: ArrayLike) -> FloatArray:
        """Return the one-sided power spectral density.

        Parameters
        ----------
        frequency : array_like, Hz
            Up to half the sampling rate.

        Returns
        -------
        ndarray
            ``2 s^2 dt / |1 - sum a_j exp(-2 pi i f j dt)|^2`` in squared unit per Hz.
        """
        f = np.atleast_1d(np.asarray(frequency, dtype=np.float64))
        turn = np.exp(-2j * np.pi * f * self.time_step)  # one exponential, the others by Horner
        transfer = 1.0 - turn * np.polyval(self.coefficients[::-1], turn)
        return np.asarray(2.0 * self.variance * self.time_step / np.abs(transfer) ** 2)


def whiten(data: FloatArray, coefficients: FloatArray) -> FloatArray:
    """Return rows ``p ... n-1`` of the data filtered by ``1 - sum a_j B^j``.

    Parameters
    ----------
    data : ndarray, shape (n,) or (n, columns)
        Samples in the order of time.
    coefficients : ndarray, shape (p,)
        Of the model; none returns the data as they are.

    Returns
    -------
    ndarray, shape (n - p,) or (n - p, columns)
        Whitened rows.
    """
    p = coefficients.size
    n = data.shape[0]
    out = data[p:].copy()
    for j in range(1, p + 1):
        out -= coefficients[j - 1] * data[p - j : n - j]
    return out


def _lag_products(residuals: Sequence[FloatArray], order: int) -> tuple[FloatArray, int]:
    products = np.zeros((order + 1, order + 1))
    n_rows = 0
    for residual in residuals:
        if residual.size <= order:
            continue
        windows = np.lib.stride_tricks.sliding_window_view(residual, order + 1)[:, ::-1]
        windows = windows[~np.isnan(windows).any(axis=1)]
        products += windows.T @ windows
        n_rows += windows.shape[0]
    return products, n_rows


def fit_autoregressive(
    residuals: Sequence[FloatArray], *, orders: Sequence[int], time_step: float
) -> tuple[AutoregressiveModel, int, dict[int, float]]:
    """Fit one model to several records and choose its order by AICc.

    Parameters
    ----------
    residuals : sequence of ndarray, shape (n_r,)
        Records of the same process, same sampling interval; NaN = not measured.
    orders : sequence of int
        Candidate orders; all are judged on the same rows.
    time_step : float, s
        Sampling interval.

    Returns
    -------
    model : AutoregressiveModel
        With the order of least AICc and the maximum-likelihood variance.
    n_rows : int
        Rows that were used.
    aicc : dict of int to float
        Criterion of every candidate.

    Raises
    ------
    TooFewSamplesError
        If too few complete windows are left for the smallest order.
    """
    usable = sorted(set(orders))
    while True:
        products, n_rows = _lag_products(residuals, usable[-1])
        if n_rows >= 4 * (usable[-1] + 2):
            break
        if len(usable) == 1:
            raise TooFewSamplesError(
                f"a noise model of order {usable[0]} needs {4 * (usable[0] + 2)} unbroken windows, "
                f"got {n_rows}; take longer runs or close the gaps in the record"
            )
        usable.pop()
    best: tuple[float, FloatArray, float] | None = None
    aicc: dict[int, float] = {}
    for p in usable:
        normal = products[1 : p + 1, 1 : p + 1]
        right = products[1 : p + 1, 0]
        ridge = _RIDGE * max(float(np.trace(products)) / products.shape[0], 1e-300)
        a = np.linalg.solve(normal + ridge * np.eye(p), right) if p else np.empty(0)
        variance = max(float(products[0, 0] - a @ right) / n_rows, 1e-300)
        k = p + 1
        aicc[p] = n_rows * np.log(variance) + 2.0 * k + 2.0 * k * (k + 1) / (n_rows - k - 1)
        if best is None or aicc[p] < best[0]:
            best = (aicc[p], a, variance)
    assert best is not None  # noqa: S101  (usable is never empty)
    return AutoregressiveModel(best[1], best[2], time_step), n_rows, aicc
