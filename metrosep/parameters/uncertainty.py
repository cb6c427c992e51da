"""Closed forms for the influence of noise on parameters: bias and standard uncertainty.

Exact, or exact to first order, where a Monte Carlo would need thousands of maps; the tests compare
the two. Noise is normal, of zero mean and stationary: white, or with a known autocorrelation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.core.numbers import choice, flag
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.parameters.noise import StationaryNoise, WhiteNoise, sampling_of
from metrosep.parameters.table import (
    MEAN_ABSOLUTE,
    MEAN_SQUARE,
    is_centred,
    valid_heights,
)

_END = 40.0
"""Half-width of the integral in sigma; the normal density is zero to float there."""

_NODES = 16_001
"""Nodes of the trapezoidal rule, which converges beyond any power for such integrands."""


def expected_range(n: int) -> float:
    """Return the expected peak-to-valley of n independent normal values of sigma 1.

    Parameters
    ----------
    n : int
        Number of values, >= 2.

    Returns
    -------
    float
        d2 of control charts: 1.128 for 2, 5.02, 6.48, 7.70 sigma for 100, 1000, 10 000.

    Raises
    ------
    TooFewSamplesError
        If n < 2.

    Notes
    -----
    Integral of 1 - F^n - (1 - F)^n over the real line, F the normal distribution. Noise alone of
    sigma has this P-V times sigma; noise that neighbours share has less.

    References
    ----------
    .. [1] L. H. C. Tippett, Biometrika 17 (1925) 364.

    Examples
    --------
    >>> [round(expected_range(n), 3) for n in (2, 100, 1000, 10_000)]
    [1.128, 5.015, 6.483, 7.703]
    """
    from scipy.special import log_ndtr

    if n < 2:
        raise TooFewSamplesError(f"a range needs at least 2 values, got {n}")
    t = np.linspace(-_END, _END, _NODES)
    with np.errstate(under="ignore"):
        outside = np.exp(n * log_ndtr(t)) + np.exp(n * log_ndtr(-t))
    return float((1.0 - outside).sum() * (t[1] - t[0]))


@dataclass(frozen=True, slots=True)
class NoiseInfluence:
    """What noise does to a parameter.

    Parameters
    ----------
    value : float
        Of the heights as they are.
    expected : float
        Expectation with this noise added.
    u : float
        Standard uncertainty from the noise.
    """

    value: float
    expected: float
    u: float

    @property
    def bias(self) -> float:
        """Expectation less value."""
        return self.expected - self.value


class _Covariance:
    """Products with the covariance matrix of the valid points, by FFT on the torus."""

    def __init__(self, noise: StationaryNoise, obj: Profile | Surface) -> None:
        self.z, self.mask = valid_heights(obj)
        self.n = int(self.z.size)
        target = sampling_of(obj)
        self.variance = noise.standard_deviation(target) ** 2
        self.white = isinstance(noise, WhiteNoise)
        self.covariance = None if self.white else noise.autocovariance(target)

    def apply(self, w: FloatArray, *, power: int = 1) -> FloatArray:
        """Return the matrix, or the matrix of its squared elements, times w."""
        if self.covariance is None:
            return np.asarray(self.variance**power * w)
        kernel = np.fft.rfftn(self.covariance**power)
        torus = self.covariance.shape
        axes = tuple(range(len(torus)))
        field = np.zeros(self.mask.shape)
        field[self.mask] = w
        product = np.fft.irfftn(
            np.fft.rfftn(field, s=torus, axes=axes) * kernel, s=torus, axes=axes
        )
        crop = tuple(slice(0, k) for k in self.mask.shape)
        return np.asarray(product[crop][self.mask])

    def quadratic(self, w: FloatArray, *, power: int = 1) -> float:
        return max(float(w @ self.apply(w, power=power)), 0.0)


def effective_number(
    noise: StationaryNoise, obj: Profile | Surface, *, of: Literal["mean", "square"] = "mean"
) -> float:
    """Return the number of independent points that would scatter alike.

    Parameters
    ----------
    noise : StationaryNoise
        Correlated or white.
    obj : Profile or Surface
        Valid points count.
    of : {"mean", "square"}, optional
        For the mean height, n^2 / sum r_ij, or for the mean square of the noise,
        n^2 / sum r_ij^2, with r_ij the correlation of two points.

    Returns
    -------
    float
        n for white noise, less if neighbours share noise, more (even infinite) if they oppose.

    Raises
    ------
    TooFewSamplesError
        If fewer than 2 heights are valid.
    NotUniformError
        If the noise is correlated and a step is not known or not uniform.
    DataError
        If the noise is zero everywhere, or `of` is not known.

    Examples
    --------
    >>> from metrosep.parameters.noise import CorrelatedNoise
    >>> x = np.arange(1000) * 1e-6
    >>> noise = CorrelatedNoise(2e-9, 10e-6)
    >>> [round(effective_number(noise, Profile(x, 0 * x), of=k)) for k in ("mean", "square")]
    [57, 80]
    """
    choice(of, "of", ("mean", "square"))
    c = _Covariance(noise, obj)
    if c.variance == 0.0:
        raise DataError("noise of zero has no effective number of points")
    power = 1 if of == "mean" else 2
    overlap = c.quadratic(np.ones(c.n), power=power)
    return c.n**2 * c.variance**power / overlap if overlap > 0.0 else math.inf


def linear_uncertainty(
    weights: ArrayLike, obj: Profile | Surface, noise: StationaryNoise
) -> float:
    """Return the standard uncertainty of a weighted sum of the heights.

    Parameters
    ----------
    weights : array_like, shape of the heights
        One per point; those of points that were not measured must be 0 or NaN.
    obj : Profile or Surface
        Where.
    noise : StationaryNoise
        Noise of the heights.

    Returns
    -------
    float
        sqrt(w' C w), exact.

    Raises
    ------
    InvalidSamplesError
        If the weights have another shape, are not finite on valid points, or weigh a missing one.
    TooFewSamplesError
        If fewer than 2 heights are valid.
    NotUniformError
        If the noise is correlated and a step is not known or not uniform.
    """
    c = _Covariance(noise, obj)
    w = np.array(weights, dtype=np.float64)
    if w.shape != obj.z.shape or not np.isfinite(w[c.mask]).all():
        raise InvalidSamplesError(
            f"weights need the shape of the heights {obj.z.shape} and finite values, got {w.shape}"
        )
    if np.nan_to_num(w[~c.mask]).any():
        raise InvalidSamplesError("a weight falls on a point that was not measured")
    return math.sqrt(c.quadratic(w[c.mask]))


def scale_uncertainty(value: float, u_relative: float, *, degree: float = 1.0) -> float:
    """Return the uncertainty that a common scale factor gives to a parameter.

    Parameters
    ----------
    value : float
        The parameter.
    u_relative : float
        Standard uncertainty of the factor, 100 ppm = 1e-4, >= 0.
    degree : float, optional
        Power with which the parameter follows the scale: 1 for P-V, Ra, Sq; 0 for Rsk; 2 for Sdr
        and Spc-like squares of slopes.

    Returns
    -------
    float
        Magnitude of degree times value, times u_relative; first order.

    Raises
    ------
    DataError
        If a number is not finite or the uncertainty is negative.

    Examples
    --------
    >>> scale_uncertainty(100e-9, 1e-3)
    1e-10
    """
    if not (math.isfinite(value) and math.isfinite(degree)):
        raise DataError(f"value and degree must be finite, got {value} and {degree}")
    if not (math.isfinite(u_relative) and u_relative >= 0.0):
        raise DataError(f"a relative uncertainty must be finite and >= 0, got {u_relative}")
    return abs(degree * value) * u_relative


def noise_influence(
    name: str, obj: Profile | Surface, noise: StationaryNoise, *, centre: bool | None = None
) -> NoiseInfluence:
    """Return bias and uncertainty of a parameter by noise, in closed form.

    Parameters
    ----------
    name : str
        "Pq", "Rq", "Wq", "Sq", "RMS"; "Pa", "Ra", "Wa", "Sa"; "mean"; "slope" (of the
        least-squares line of a profile). Whole length, no sections.
    obj : Profile or Surface
        Form removed and filtered.
    noise : StationaryNoise
        White or correlated noise of the heights.
    centre : bool, optional
        Whether the mean height is removed. By default for areal parameters and RMS, not for P, R
        and W.

    Returns
    -------
    NoiseInfluence
        Value, expectation, u.

    Raises
    ------
    DataError
        If the parameter has no closed form: use `monte_carlo`; or `centre` is not True, False or
        None.
    TooFewSamplesError
        If fewer than 2 heights are valid.
    NotUniformError
        If the noise is correlated and a step is not known or not uniform.

    Notes
    -----
    With C the covariance of the points and n their number, the mean square has the expectation
    q^2 + sigma^2 and the variance 4 z'Cz / n^2 + 2 tr(C^2) / n^2, both exact (with the terms of the
    mean, if that is removed); its root is taken to second order. For the mean absolute value,
    the expectation of each point is that of a folded normal distribution, exact; the variance
    is exact for white noise. Else it takes the linear part exactly and gives all higher
    parts the correlation r^2, which does not make it too small. Mean and slope are linear.

    References
    ----------
    .. [1] F. C. Leone et al., Technometrics 3 (1961) 543, folded normal distribution.

    Examples
    --------
    >>> x = np.arange(500) * 1e-6
    >>> wave = Profile(x, 50e-9 * np.cos(2 * np.pi * x / 100e-6))
    >>> result = noise_influence("Rq", wave, WhiteNoise(2e-9))
    >>> [f"{1e9 * v:.4f}" for v in (result.value, result.bias, result.u)]
    ['35.3553', '0.0564', '0.0894']
    """
    centre = centre if centre is None else flag(centre, "centre")
    c = _Covariance(noise, obj)
    if name == "slope":
        return _slope(c, obj)
    if name == "mean":
        u = math.sqrt(c.quadratic(np.full(c.n, 1.0 / c.n)))
        return NoiseInfluence(float(c.z.mean()), float(c.z.mean()), u)
    if name in MEAN_SQUARE:
        return _mean_square(c, is_centred(name, centre))
    if name in MEAN_ABSOLUTE:
        return _mean_absolute(c, is_centred(name, centre))
    raise DataError(f"{name} has no closed form here; use monte_carlo")


def _slope(c: _Covariance, obj: Profile | Surface) -> NoiseInfluence:
    if not isinstance(obj, Profile):
        raise DataError("slope is that of a profile; give weights to linear_uncertainty")
    x = obj.x[c.mask] - obj.x[c.mask].mean()
    w = x / float(x @ x)
    return NoiseInfluence(float(w @ c.z), float(w @ c.z), math.sqrt(c.quadratic(w)))


def _mean_square(c: _Covariance, centred: bool) -> NoiseInfluence:
    n, ones = c.n, np.ones(c.n)
    z = c.z - c.z.mean() if centred else c.z
    q2 = float(np.square(z).mean())
    added = c.variance
    squares = c.quadratic(ones, power=2)
    if centred:
        row = c.apply(ones)
        whole = float(row.sum())
        added -= whole / n**2
        squares += (whole / n) ** 2 - 2.0 * float(row @ row) / n
    variance = (4.0 * c.quadratic(z) + 2.0 * max(squares, 0.0)) / n**2
    expected2 = q2 + max(added, 0.0)
    if expected2 == 0.0:
        return NoiseInfluence(0.0, 0.0, 0.0)
    root = math.sqrt(expected2)
    expected = root - variance / (8.0 * expected2 * root)
    return NoiseInfluence(math.sqrt(q2), expected, math.sqrt(variance) / (2.0 * root))


def _mean_absolute(c: _Covariance, centred: bool) -> NoiseInfluence:
    from scipy.special import erf

    n = c.n
    z = c.z - c.z.mean() if centred else c.z
    value = float(np.abs(z).mean())
    variance = c.variance
    if centred:
        variance -= c.quadratic(np.full(n, 1.0 / n))
    if variance <= 0.0:
        return NoiseInfluence(value, value, 0.0)
    sigma = math.sqrt(variance)
    t = np.minimum(np.abs(z) / sigma, _END) * np.sign(z)
    sign = erf(t / math.sqrt(2.0))
    tail = math.sqrt(2.0 / math.pi) * np.exp(-0.5 * t * t)
    excess = sigma * (tail - np.abs(t) * (1.0 - np.abs(sign)))
    rest = variance + np.square(sigma * t) - np.square(sigma * (np.abs(t) + excess / sigma))
    rest = np.sqrt(np.maximum(rest - variance * np.square(sign), 0.0))
    w = sign - sign.mean() if centred else sign
    total = c.quadratic(w) + c.quadratic(rest, power=2) / c.variance**2
    return NoiseInfluence(value, value + float(excess.mean()), math.sqrt(total) / n)
