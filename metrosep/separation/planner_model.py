"""What a set of runs tells about one wavelength: long-record formula and exact finite record.

A wave ``a cos(2 pi x / L) + b sin(...)`` read at the speed v is a tone of f = v / wavelength. With
a disturbance of one-sided density S a run of duration T adds ``T / S(f)`` to the information on a
and on b (Kay 1993, long records). It is exact only where S hardly changes within 1 / T. A resonance
narrower than that spreads over 1 / T: its true effect is smaller at the peak, and the offset of
each run costs a little. `finite_variance` does the generalised least squares without approximation.
"""

from __future__ import annotations

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.separation.noise_density import TimeDensity

__all__ = ["finite_variance", "run_information"]


_SAMPLES_PER_WAVE = 5.0
"""Samples per wave of the shortest wavelength in the simulated record."""

_MOST_SAMPLES = 1500
"""Longest record that is solved exactly; a longer one has more than 300 waves."""

_N_FREQUENCIES = 2**17
"""Lines that make the autocovariance from the density."""


def run_information(
    density: TimeDensity, feeds: FloatArray, wavelengths: FloatArray, length: float
) -> FloatArray:
    """Return the information of one run at each feed on each wavelength, long-record formula."""
    v = np.asarray(feeds, dtype=np.float64)[:, np.newaxis]
    s = density(v / wavelengths)
    information: FloatArray = np.where(np.isnan(s), 0.0, length / v / np.where(s > 0.0, s, 1.0))
    return information


def finite_variance(
    density: TimeDensity, feeds: FloatArray, wavelengths: FloatArray, length: float
) -> FloatArray:
    """Return the variance of the amplitude coefficients by generalised least squares."""
    shortest = float(wavelengths.min())
    n = int(np.ceil(_SAMPLES_PER_WAVE * length / shortest)) + 1
    if n > _MOST_SAMPLES:
        return np.full(wavelengths.shape, np.nan)
    total = np.zeros((wavelengths.size, 2, 2))
    with one_blas_thread():
        for v, count in zip(*np.unique(feeds, return_counts=True), strict=True):
            used = v / wavelengths <= density.highest
            if used.any():
                total[used] += count * _one_run(density, float(v), wavelengths[used], length)
    trace = total[:, 0, 0] + total[:, 1, 1]
    determinant = total[:, 0, 0] * total[:, 1, 1] - total[:, 0, 1] ** 2
    known = determinant > 1e-12 * trace**2
    out = np.full(wavelengths.shape, np.nan)
    out[known] = 0.5 * trace[known] / determinant[known]
    return out


def _one_run(
    density: TimeDensity, feed: float, wavelengths: FloatArray, length: float
) -> FloatArray:
    """Information matrices (k, 2, 2) of one run, its offset eliminated."""
    from scipy.linalg import cho_factor, cho_solve, toeplitz

    duration = length / feed
    top = min(0.5 * _SAMPLES_PER_WAVE * feed / float(wavelengths.min()), density.highest)
    n = max(int(2.0 * top * duration + 1e-9), 4)
    step = duration / n  # n samples stand for the whole duration
    times = (np.arange(n) - 0.5 * (n - 1)) * step
    covariance = _autocovariance(density, min(0.5 / step, density.highest), step, n)
    factor = cho_factor(toeplitz(covariance), check_finite=False)
    phase = 2.0 * np.pi * feed / wavelengths[:, np.newaxis] * times
    waves = np.stack([np.cos(phase), np.sin(phase)], axis=1)  # (k, 2, n)
    columns = np.concatenate([waves.reshape(-1, n), np.ones((1, n))])
    white = cho_solve(factor, columns.T, check_finite=False)  # (n, 2 k + 1)
    solved = white[:, :-1].T.reshape(waves.shape)
    matrix = np.einsum("kin,kjn->kij", waves, solved)
    with_offset = solved.sum(axis=2)
    removed = with_offset[:, :, np.newaxis] * with_offset[:, np.newaxis, :] / white[:, -1].sum()
    information: FloatArray = matrix - removed
    return information


def _autocovariance(density: TimeDensity, top: float, step: float, n: int) -> FloatArray:
    """Covariance at the first n lags of noise with this density up to `top` = 1 / (2 step)."""
    frequency = (np.arange(_N_FREQUENCIES) + 0.5) * (0.5 / step / _N_FREQUENCIES)
    power = density(np.minimum(frequency, top)) * (0.5 / step / _N_FREQUENCIES)
    # sum_j P_j cos(pi (j + 1/2) k / N): half-way lines keep the zero frequency out
    turn = np.exp(0.5j * np.pi * np.arange(n) / _N_FREQUENCIES)
    spectrum = np.fft.fft(power, 2 * _N_FREQUENCIES)[:n].conj()
    covariance: FloatArray = (spectrum * turn).real
    return covariance
