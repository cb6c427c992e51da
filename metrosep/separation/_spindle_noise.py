"""Private helpers: what the scatter between revolutions does to the numbers of a spindle test.

The deviations of the revolutions from their mean are taken as stationary, Gaussian and independent
from revolution to revolution; their power per harmonic is estimated from the data, so noise that
is correlated over angle is counted right.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import ComplexArray, FloatArray

__all__ = [
    "NoiseEffect",
    "Spectrum",
    "noise_effect",
    "revolution_correlation",
    "spectrum_of",
    "u_of_range",
    "u_of_sd",
    "u_of_total",
]


_FALSE_SHARE = 0.01
"""Expected share of harmonics called significant that are noise (Benjamini and Hochberg)."""

_NEGLIGIBLE = 1e-6
"""Noise over real motion below which no circle is worth its time."""

_TAIL = 8.0
"""Standard deviations of noise at which its probability is rounding."""

_LEVELS = 800
_OFFSETS = 401
_LEAST_WITHIN = 0.0025
"""Least share of the variance within revolutions, so that the levels resolve it."""

_MOST_ANGLES = 256
"""Groups of like height into which the angles of the mean curve are put."""

_GUMBEL_SD = math.pi / math.sqrt(6.0)


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """Mean and scatter of the harmonics of the revolutions.

    `mean` (k = 0 .. n // 2) in amplitudes, ``sum mean_k exp(i k t)`` real part; `power` is the
    variance of the complex amplitude of one revolution, ``E |A - mean|^2``.
    """

    mean: ComplexArray
    power: FloatArray
    significant: NDArray[np.bool_]
    n_revolutions: int
    n_angles: int


def spectrum_of(table: FloatArray, first_angle: float) -> Spectrum:
    """Return harmonics of a table (m, n) without NaN, phases counted from the physical angle 0."""
    m, n = table.shape
    lines = np.fft.rfft(table, axis=1)
    lines *= 2.0 / n
    lines[:, 0] *= 0.5
    if n % 2 == 0:
        lines[:, -1] *= 0.5
    mean = lines.mean(axis=0)
    deviation = lines - mean
    power = (deviation.real**2 + deviation.imag**2).sum(axis=0) / (m - 1)
    size = mean.real**2 + mean.imag**2
    k = np.arange(mean.size)
    return Spectrum(
        mean * np.exp(-1j * k * first_angle), power, _significant(size, power, m), m, n
    )


def _significant(size: FloatArray, power: FloatArray, m: int) -> NDArray[np.bool_]:
    """F test of each harmonic on (2, 2 (m - 1)) degrees of freedom, false share limited."""
    some = power > 0.0
    ratio = np.where(size > 0.0, np.inf, 0.0)
    np.divide(m * size, power, out=ratio, where=some)
    p = (1.0 + ratio / (m - 1)) ** -(m - 1.0)
    order = np.argsort(p[1:])
    limit = _FALSE_SHARE * np.arange(1, order.size + 1) / max(order.size, 1)
    passed = np.flatnonzero(p[1:][order] <= limit)
    found = np.zeros(size.size, dtype=bool)
    if passed.size:
        found[1 + order[: passed[-1] + 1]] = True
    return found


@dataclass(frozen=True, slots=True)
class NoiseEffect:
    """Peak to valley of pure noise, its mean effect on the real curve, and the scatter there."""

    floor: float
    bias: float
    sd: float


def noise_effect(
    spectrum: Spectrum,
    kept: NDArray[np.bool_],
    width: Callable[[FloatArray], float],
    *,
    n_draws: int,
    seed: int,
) -> NoiseEffect:
    """Return what noise does to the peak-to-valley width of the mean revolution.

    `kept` are the harmonics of the curve; `width` takes it. Noise of the power found is drawn, and
    added to the curve of the significant harmonics. The floor is peak to valley without a centre.
    """
    n = spectrum.n_angles
    rng = np.random.default_rng(seed)
    noise = rng.normal(size=(n_draws, 2, kept.size))
    scale = np.sqrt(0.5 * np.where(kept, spectrum.power, 0.0) / spectrum.n_revolutions)
    curves = _curves((noise[:, 0] + 1j * noise[:, 1]) * scale, n)
    real = _curves(np.where(kept & spectrum.significant, spectrum.mean, 0.0)[None], n)[0]
    alone = np.ptp(curves, axis=1)
    if float(alone.max(initial=0.0)) <= _NEGLIGIBLE * float(np.ptp(real)):
        width = _peak_to_valley
    both = np.array([width(real + c) for c in curves])
    return NoiseEffect(
        float(alone.mean()), float(both.mean()) - width(real), float(both.std(ddof=1))
    )


def _peak_to_valley(curve: FloatArray) -> float:
    return float(curve.max() - curve.min())


def _curves(amplitudes: ComplexArray, n: int) -> FloatArray:
    lines = amplitudes * (0.5 * n)
    lines[:, 0] *= 2.0
    if n % 2 == 0:
        lines[:, -1] *= 2.0
    return np.fft.irfft(lines, n, axis=1)


def u_of_sd(spectrum: Spectrum) -> float:
    """Return the standard uncertainty of the pooled standard deviation.

    The variance is the sum over harmonics of half the power (all of it for the mean and the last
    one), each with 2 (m - 1) degrees of freedom (m - 1).
    """
    share = np.full(spectrum.power.size, 0.5)
    single = [0, -1] if spectrum.n_angles % 2 == 0 else [0]
    share[single] = 1.0
    part = share * spectrum.power
    total = float(part.sum())
    if total == 0.0:
        return 0.0
    double = np.ones(part.size)
    double[single] = 2.0
    variance = float((double * part**2).sum()) / (spectrum.n_revolutions - 1)
    return 0.5 * math.sqrt(variance / total)


def _hazard(z: float) -> float:
    """Return density over survival of the standard normal distribution."""
    if z > 30.0:
        return z + 1.0 / z
    survival = 0.5 * math.erfc(z / math.sqrt(2.0))
    return math.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi) / survival


def u_of_range(value: float, sd: float) -> float:
    """Return the standard uncertainty of the largest range over angles, from extreme values.

    The tail of a range r is that of a difference of two readings, sd sqrt 2; the largest of many is
    of Gumbel's form with the inverse hazard at r as its scale, however many are independent.
    """
    if sd == 0.0:
        return 0.0
    wide = sd * math.sqrt(2.0)
    return _GUMBEL_SD * wide / _hazard(value / wide)


def u_of_total(motion: FloatArray, spectrum: Spectrum) -> float:
    """Return the standard uncertainty of the width of all data (m, n), from extreme values.

    Highest and lowest reading each have the distribution of the largest of m n Gaussian values
    about the mean curve: an offset of each revolution, and noise of which successive values are as
    alike as its power says. Harmonics of the mean that do not repeat are noise, not curve.
    """
    m, n = motion.shape
    share = np.full(spectrum.power.size, 0.5)
    share[[0, -1] if n % 2 == 0 else [0]] = 1.0
    part = share * spectrum.power
    total = float(part.sum())
    lines = np.fft.rfft(motion.mean(axis=0))
    lines[np.flatnonzero(~spectrum.significant[2:]) + 2] = 0.0
    curve = np.fft.irfft(lines, n)
    if math.sqrt(total) <= _NEGLIGIBLE**2 * float(np.ptp(curve)):
        return math.sqrt(total)
    within = max(total - float(part[0]), _LEAST_WITHIN * total)
    step = 2.0 * math.pi / n * np.arange(1, part.size)
    alike = float((part[1:] * np.cos(step)).sum()) / within
    sd = math.sqrt(within)
    offset = math.sqrt(float(part[0])) / sd
    ends = [_variance_of_highest(c / sd, m, alike, offset) for c in (curve, -curve)]
    return sd * math.sqrt(sum(ends))


def _variance_of_highest(curve: FloatArray, m: int, alike: float, offset: float) -> float:
    """Return the variance of the highest of m revolutions ``curve + noise``, noise of sd 1.

    One revolution stays below x with probability ``exp(-sum_j g(x - curve_j))``. Independent values
    have ``g = -log Phi``. Values correlated by `alike` with the one before cross x upwards with
    probability 2 T(x, a) (T of Owen), which is Phi Q where they are independent.
    """
    from scipy.special import log_ndtr, ndtr, owens_t

    n = curve.size
    z = np.linspace(-_TAIL, _TAIL, _LEVELS)
    a = math.sqrt(max(1.0 - alike, 0.0) / max(1.0 + alike, 0.01))
    crossing = 2.0 * owens_t(z, a) / (ndtr(z) * ndtr(-z))
    g = -log_ndtr(z) * ((1.0 - 1.0 / n) * crossing + 1.0 / n)
    ordered = np.sort(curve)
    if n > _MOST_ANGLES:
        ordered = np.array([part.mean() for part in np.array_split(ordered, _MOST_ANGLES)])
    rate = np.interp(z[:, np.newaxis] + ordered[-1] - ordered, z, g).mean(axis=1) * n
    x = z * (1.0 + offset)
    shift = np.linspace(-_TAIL, _TAIL, _OFFSETS)
    weight = np.exp(-0.5 * shift * shift)
    below = np.interp(x[:, np.newaxis] - offset * shift, z, np.exp(-rate))
    steps = np.diff((below @ weight / weight.sum()) ** m, prepend=0.0)
    steps /= steps.sum()
    mean = float(steps @ x)
    return float(steps @ (x - mean) ** 2)


def revolution_correlation(deviation: FloatArray) -> float:
    """Return the correlation of successive revolutions' deviations, 0 where they do not deviate."""
    power = float((deviation * deviation).sum())
    if power == 0.0:
        return 0.0
    m = deviation.shape[0]
    return float((deviation[1:] * deviation[:-1]).sum()) / power * float(m / (m - 1))
