"""Noise models for Monte Carlo: what a second measurement would add to the heights.

Each model draws fields of zero mean on the points of an object. A generator is used field by
field, so that the first k fields are the same whatever number is asked for at once.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.docs import documented
from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotUniformError,
    TooFewSamplesError,
)
from metrosep.core.numbers import choice, count, flag, not_negative, positive
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.surface import Surface
from metrosep.parameters.table import with_heights

_REACH = 6.0
"""The Gaussian ACF is 2e-16 at this many correlation lengths: the far end does not see it."""


REPEATS = """
    TooFewSamplesError
        If there are fewer than 2 repeats or fewer than 2 points valid in all.
    InvalidSamplesError
        If profiles and surfaces are mixed, or the points differ.
    """
"""What every function of repeats raises."""


class Sampling(NamedTuple):
    """Where noise is wanted."""

    shape: tuple[int, ...]  # of the heights
    # of (float or None), m: step along each axis of the array (a surface: dy, dx); None where it
    # is not known or not uniform
    steps: tuple[float | None, ...]


Target = Profile | Surface | Sampling | tuple[int, ...]


def sampling_of(target: Target) -> Sampling:
    """Return the shape and the steps of an object."""
    if isinstance(target, Profile):
        known = target.is_uniform and target.lateral_unit == "m"
        return Sampling((len(target),), (target.dx if known else None,))
    if isinstance(target, Surface):
        return Sampling(target.shape, (target.dy, target.dx))
    if isinstance(target, Sampling):
        return target
    return Sampling(tuple(target), (None,) * len(target))


class Noise(ABC):
    """Base of the models; a model of your own defines `_fields`."""

    __slots__ = ()

    def draw(self, target: Target, rng: np.random.Generator, size: int = 1) -> FloatArray:
        """Return noise fields.

        Parameters
        ----------
        target : Profile, Surface, Sampling or tuple of int
            Where; its heights are not used.
        rng : numpy.random.Generator
            Used field by field.
        size : int, optional
            Number of fields, >= 1.

        Returns
        -------
        ndarray, shape (size, ...), m
            Noise on all points, measured or not.

        Raises
        ------
        DataError
            If size < 1, or the model does not fit the target.
        NotUniformError
            If the noise is correlated and a step is not known or not uniform.
        """
        return self._fields(sampling_of(target), rng, count(size, "the number of noise fields"))

    @abstractmethod
    def _fields(self, target: Sampling, rng: np.random.Generator, size: int) -> FloatArray: ...


class StationaryNoise(Noise):
    """Base of the models whose covariance depends on the distance only."""

    __slots__ = ()

    def autocovariance(self, target: Target) -> FloatArray:
        """Return the covariance against lag, on a torus at least twice as long as the object.

        Parameters
        ----------
        target : Profile, Surface, Sampling or tuple of int
            Where.

        Returns
        -------
        ndarray, m^2
            First element: the variance; negative lags at the end, as in a DFT.

        Raises
        ------
        NotUniformError
            If the noise is correlated and a step is not known or not uniform.
        """
        eigenvalues = self._eigenvalues(sampling_of(target))
        covariance: FloatArray = np.fft.ifftn(eigenvalues).real
        return covariance

    def standard_deviation(self, target: Target) -> float:
        """Return the standard deviation of one point.

        Parameters
        ----------
        target : Profile, Surface, Sampling or tuple of int
            Where: the part of a spectrum below the Nyquist frequency depends on the step.

        Returns
        -------
        float
            In m.

        Raises
        ------
        NotUniformError
            If the noise is correlated and a step is not known or not uniform.
        """
        return math.sqrt(float(self._eigenvalues(sampling_of(target)).mean()))

    @abstractmethod
    def _eigenvalues(self, target: Sampling, *, doubled: bool = True) -> FloatArray:
        """Return the DFT of the covariance on a torus, >= 0.

        The torus is at least twice as long as the object, so that a product with the covariance
        does not wrap; for drawing it may be shorter.
        """

    def _fields(self, target: Sampling, rng: np.random.Generator, size: int) -> FloatArray:
        eigenvalues = self._eigenvalues(target, doubled=False)
        torus = eigenvalues.shape
        root = np.sqrt(eigenvalues)[..., : torus[-1] // 2 + 1]
        axes = tuple(range(len(torus)))
        crop = tuple(slice(0, n) for n in target.shape)
        fields = np.empty((size, *target.shape))
        for k in range(size):
            spectrum = np.fft.rfftn(rng.standard_normal(torus), axes=axes)
            fields[k] = np.fft.irfftn(spectrum * root, s=torus, axes=axes)[crop]
        return fields


def _known_steps(target: Sampling) -> tuple[float, ...]:
    steps = tuple(s for s in target.steps if s is not None)
    if len(steps) != len(target.shape):
        raise NotUniformError(
            "correlated noise needs a uniform, known step along each axis; resample the profile, "
            "give the surface its dx and dy, or use WhiteNoise"
        )
    return steps


def _torus_size(n: int, reach: float = 0.0, *, doubled: bool = True) -> int:
    from scipy.fft import next_fast_len

    return int(next_fast_len(max(2 * n if doubled else n, n + math.ceil(reach)), real=True))


@dataclass(frozen=True, slots=True)
class WhiteNoise(StationaryNoise):
    """Independent normal noise on every point.

    Parameters
    ----------
    sigma : float (m) or str with unit
        Standard deviation, >= 0.

    Raises
    ------
    DataError
        If sigma is negative or not finite.

    Notes
    -----
    White noise per pixel makes u(Sq) far too small for most instruments: neighbours share noise.

    Examples
    --------
    >>> WhiteNoise(2e-9).draw((3,), np.random.default_rng(1), 2).shape
    (2, 3)
    """

    sigma: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "sigma", not_negative(self.sigma, "sigma", dimension="length"))

    def standard_deviation(self, target: Target) -> float:
        return self.sigma

    def _eigenvalues(self, target: Sampling, *, doubled: bool = True) -> FloatArray:
        return np.full(tuple(_torus_size(n) for n in target.shape), self.sigma**2)

    def _fields(self, target: Sampling, rng: np.random.Generator, size: int) -> FloatArray:
        fields = rng.standard_normal((size, *target.shape))
        fields *= self.sigma
        return fields


@dataclass(frozen=True, slots=True)
class CorrelatedNoise(StationaryNoise):
    """Normal noise with a Gaussian autocorrelation, the same in all directions.

    Parameters
    ----------
    sigma : float (m) or str with unit
        Standard deviation of a point, >= 0.
    correlation_length : float (m) or str with unit
        Distance at which the autocorrelation exp(-(d / length)^2) has fallen to 1/e, > 0.

    Raises
    ------
    DataError
        If sigma is negative, the length not positive, or one of them not finite.

    Notes
    -----
    Drawn by circulant embedding on a torus that is longer than the object by 6 correlation
    lengths: its ends are not neighbours.

    References
    ----------
    .. [1] C. R. Dietrich, G. N. Newsam, SIAM J. Sci. Comput. 18 (1997) 1088.

    Examples
    --------
    >>> noise = CorrelatedNoise(2e-9, 10e-6)
    >>> x = np.arange(100) * 1e-6
    >>> noise.draw(Profile(x, 0.0 * x), np.random.default_rng(1)).shape
    (1, 100)
    """

    sigma: float
    correlation_length: float

    def __post_init__(self) -> None:
        sigma = not_negative(self.sigma, "sigma", dimension="length")
        length = positive(self.correlation_length, "correlation_length", dimension="length")
        object.__setattr__(self, "sigma", sigma)
        object.__setattr__(self, "correlation_length", length)

    def _eigenvalues(self, target: Sampling, *, doubled: bool = True) -> FloatArray:
        eigenvalues = np.array(self.sigma**2)
        for n, step in zip(target.shape, _known_steps(target), strict=True):
            reach = _REACH * self.correlation_length / step
            m = _torus_size(n, reach, doubled=doubled)
            lag = np.arange(m) * step / self.correlation_length
            turn = m * step / self.correlation_length
            # The torus sees each lag from both sides; the far one is below rounding in the crop.
            acf = np.exp(-(lag**2)) + np.exp(-((turn - lag) ** 2)) + np.exp(-((turn + lag) ** 2))
            eigenvalues = np.multiply.outer(eigenvalues, np.maximum(np.fft.fft(acf).real, 0.0))
        return eigenvalues


@dataclass(frozen=True, slots=True, eq=False)
class NoiseFromPsd(StationaryNoise):
    """Normal noise with a given power spectral density.

    Parameters
    ----------
    frequency : array_like, shape (n,), 1/m
        Spatial frequencies, >= 0, rising. For a surface: the radial frequency.
    density : array_like, shape (n,)
        For a profile the one-sided density in m^3, whose integral over frequency is the
        variance. For a surface the two-sided areal density in m^4, whose integral over the
        plane of frequencies is the variance.

    Raises
    ------
    InvalidSamplesError
        If the arrays differ in length, are empty, not finite or negative, or the frequencies do
        not rise.

    Notes
    -----
    Linear between the given frequencies, the first density below them, nothing above them. What
    lies above the Nyquist frequency of the object is omitted, not folded back.

    Examples
    --------
    >>> noise = NoiseFromPsd([0.0, 1e4], [1e-22, 1e-22])
    >>> x = np.arange(500) * 1e-6
    >>> round(float(noise.autocovariance(Profile(x, 0.0 * x)).flat[0]) * 1e18, 2)
    1.0
    """

    frequency: FloatArray
    density: FloatArray

    def __init__(self, frequency: ArrayLike, density: ArrayLike) -> None:
        f = np.array(frequency, dtype=np.float64)
        s = np.array(density, dtype=np.float64)
        if f.ndim != 1 or f.shape != s.shape or f.size == 0:
            raise InvalidSamplesError(
                f"frequency and density must be equally long lists, got shapes {f.shape} and "
                f"{s.shape}"
            )
        if not (np.isfinite(f).all() and np.isfinite(s).all()) or f[0] < 0.0 or (s < 0.0).any():
            raise InvalidSamplesError("a spectrum must be finite and must not be negative")
        if (np.diff(f) <= 0.0).any():
            raise InvalidSamplesError("the frequencies of a spectrum must rise strictly")
        f.setflags(write=False)
        s.setflags(write=False)
        object.__setattr__(self, "frequency", f)
        object.__setattr__(self, "density", s)

    def _eigenvalues(self, target: Sampling, *, doubled: bool = True) -> FloatArray:
        steps = _known_steps(target)
        if len(steps) == 1:
            return self._line(_torus_size(target.shape[0]), steps[0])
        squared = np.array(0.0)
        for n, step in zip(target.shape, steps, strict=True):
            squared = np.add.outer(squared, np.fft.fftfreq(_torus_size(n), step) ** 2)
        density = np.interp(np.sqrt(squared), self.frequency, self.density, right=0.0)
        eigenvalues: FloatArray = density / math.prod(steps)
        return eigenvalues

    def _line(self, m: int, step: float) -> FloatArray:
        """Return the power of each bin of the DFT, by integrals: the variance is exact."""
        width = 1.0 / (m * step)
        centres = np.abs(np.fft.fftfreq(m, step))
        low = np.maximum(centres - 0.5 * width, 0.0)
        high = np.minimum(centres + 0.5 * width, 0.5 / step)
        power = self._integral(high) - self._integral(low)
        both_sides = (centres == 0.0) | (centres == 0.5 / step)
        eigenvalues: FloatArray = np.maximum(np.where(both_sides, power, 0.5 * power), 0.0) * m
        return eigenvalues

    def _integral(self, f: FloatArray) -> FloatArray:
        """Return the integral of the density from 0 to f."""
        knots, density = self.frequency, self.density
        if knots[0] > 0.0:
            knots, density = np.r_[0.0, knots], np.r_[density[0], density]
        pieces = 0.5 * (density[1:] + density[:-1]) * np.diff(knots)
        whole = np.concatenate([[0.0], np.cumsum(pieces)])
        inside = np.minimum(f, knots[-1])
        i = np.maximum(np.searchsorted(knots, inside, side="right") - 1, 0)
        value = np.interp(inside, knots, density)
        total: FloatArray = whole[i] + 0.5 * (density[i] + value) * (inside - knots[i])
        return total


@documented(repeats=REPEATS)
@dataclass(frozen=True, slots=True, eq=False)
class NoiseFromRepeats(Noise):
    """Noise drawn from what repeats of the same measurement differ by.

    Parameters
    ----------
    objects : sequence of Profile or of Surface
        At least 2, on the same points. The target must have their shape.
    method : {"shift", "combine"}, optional
        ``"shift"``: the residual of one repeat, whole, with random sign and circular shift;
        for noise that is alike everywhere. ``"combine"``: sum of all residuals with normal
        weights; keeps where the noise sits (edges, drift) and allows gaps.
    remove_mean : bool, optional
        Whether the mean height of each repeat is removed first.

    Raises
    ------
    $repeats
    DataError
        If the method is not known, a point is missing and the method shifts, or `remove_mean` is
        not True or False.

    Notes
    -----
    Residuals from the mean of R repeats are scaled by sqrt(R / (R - 1)). A shift wraps round:
    one seam per axis. ``"combine"`` has the sample covariance of the repeats, of rank R - 1:
    below some ten repeats its extremes follow few patterns; it is zero where not measured.
    """

    residuals: FloatArray
    method: Literal["shift", "combine"]

    def __init__(
        self,
        objects: Sequence[Profile | Surface],
        *,
        method: Literal["shift", "combine"] = "shift",
        remove_mean: bool = True,
    ) -> None:
        choice(method, "method", ("shift", "combine"))
        remove_mean = flag(remove_mean, "remove_mean")
        stack = stack_repeats(objects)
        gaps = int(np.isnan(stack[0]).sum())
        if gaps and method == "shift":
            raise DataError(
                f"{gaps} point(s) are not valid in all repeats, and a shift would move these gaps "
                'onto measured points; crop, take method="combine", or CorrelatedNoise with the '
                "sigma and length of noise_of_repeats"
            )
        residuals = residuals_of(stack, remove_mean=remove_mean)
        residuals *= math.sqrt(len(objects) / (len(objects) - 1))
        residuals[np.isnan(residuals)] = 0.0
        residuals.setflags(write=False)
        object.__setattr__(self, "residuals", residuals)
        object.__setattr__(self, "method", method)

    def _fields(self, target: Sampling, rng: np.random.Generator, size: int) -> FloatArray:
        n_repeats, *shape = self.residuals.shape
        if tuple(shape) != target.shape:
            raise DataError(
                f"the repeats have shape {tuple(shape)}, the object {target.shape}; noise from "
                "repeats fits objects on the points of the repeats"
            )
        fields = np.zeros((size, *shape))
        if self.method == "combine":
            weights = rng.standard_normal((size, n_repeats)) / math.sqrt(n_repeats)
            spread = (-1,) + (1,) * len(shape)
            for r in range(n_repeats):
                fields += weights[:, r].reshape(spread) * self.residuals[r]
            return fields
        chances = rng.random((size, 2 + len(shape)))
        axes = tuple(range(len(shape)))
        for k, (which, sign, *turn) in enumerate(chances.tolist()):
            shifts = tuple(int(t * n) for t, n in zip(turn, shape, strict=True))
            rolled = np.roll(self.residuals[int(which * n_repeats)], shifts, axis=axes)
            fields[k] = rolled if sign < 0.5 else -rolled
        return fields


# ---- repeats on top of each other, their mean, and the noise of a point ------------------------
# Repeats are measurements of one part on the same points, each with noise of its own. Only points
# that are valid in all repeats are used.

_SAME_POSITION = 1e-6
"""Largest difference of two positions, relative to the step, that counts as the same."""


@documented(repeats=REPEATS)
def stack_repeats(objects: Sequence[Profile | Surface]) -> FloatArray:
    """Return the heights of repeats on top of each other, NaN unless valid in all.

    Parameters
    ----------
    objects : sequence of Profile or of Surface
        At least 2, on the same points.

    Returns
    -------
    ndarray, shape (n_repeats, ...), m
        Heights; a point that one repeat lacks is NaN in all.

    Raises
    ------
    $repeats
    """
    if len(objects) < 2:
        raise TooFewSamplesError(f"at least 2 repeats are needed, got {len(objects)}")
    first = objects[0]
    for k, other in enumerate(objects[1:], start=1):
        if not _same_points(first, other):
            raise InvalidSamplesError(
                f"repeat {k} is not on the points of repeat 0; bring all onto one grid first"
            )
    stack = np.stack([o.z for o in objects])
    stack[:, np.isnan(stack).any(axis=0)] = np.nan
    n_valid = int(np.isfinite(stack[0]).sum())
    if n_valid < 2:
        raise TooFewSamplesError(
            f"{n_valid} point(s) are valid in all {len(objects)} repeats, 2 are needed"
        )
    return stack


def _same_points(a: Profile | Surface, b: Profile | Surface) -> bool:
    if isinstance(a, Profile) and isinstance(b, Profile):
        if len(a) != len(b):
            return False
        step = float(np.diff(a.x).min()) if len(a) > 1 else 1.0
        return bool(np.abs(a.x - b.x).max() <= _SAME_POSITION * step)
    if isinstance(a, Surface) and isinstance(b, Surface):
        pairs = [(a.dx, b.dx, a.shape[1]), (a.dy, b.dy, a.shape[0])]
        return a.shape == b.shape and all(_same_step(p, q, n) for p, q, n in pairs)
    return False


def _same_step(a: float | None, b: float | None, n: int) -> bool:
    if a is None or b is None:
        return a is b
    return abs(a - b) * n <= _SAME_POSITION * a * max(n, 1)


@documented(repeats=REPEATS)
def mean_of_repeats(objects: Sequence[Profile | Surface]) -> Profile | Surface:
    """Return the mean profile or surface, NaN unless valid in all.

    Parameters
    ----------
    objects : sequence of Profile or of Surface
        At least 2, on the same points.

    Returns
    -------
    Profile or Surface
        With the metadata and history of the first and a step ``"mean_of_repeats"``.

    Raises
    ------
    $repeats

    Notes
    -----
    The mean of n repeats holds 1 / sqrt(n) of the noise of one.
    """
    first = objects[0]
    mean = with_heights(first, stack_repeats(objects).mean(axis=0))
    step = Step("mean_of_repeats", {"repeats": len(objects)})
    return replace(mean, history=(*first.history, step))


@dataclass(frozen=True, slots=True, eq=False)
class NoiseEstimate:
    """Noise of a single repeat.

    Parameters
    ----------
    sigma : float, m
        Standard deviation of a point, pooled over all points.
    map : ndarray, shape of the heights, m
        Standard deviation of each point over the repeats; NaN unless valid in all.
    n_repeats, n_points : int
        What it rests on.
    lengths : tuple of (float or None), samples
        Lag along each axis at which the autocorrelation of the noise has fallen to 1/e; None
        where it does not.
    n_effective : float
        Number of independent points that would scatter a mean square as much; `n_points` for
        white noise.
    """

    sigma: float
    map: FloatArray
    n_repeats: int
    n_points: int
    lengths: tuple[float | None, ...]
    n_effective: float


@documented(repeats=REPEATS)
def noise_of_repeats(
    objects: Sequence[Profile | Surface], *, remove_mean: bool = True
) -> NoiseEstimate:
    """Return the noise of a single repeat from the scatter between repeats.

    Parameters
    ----------
    objects : sequence of Profile or of Surface
        At least 2, on the same points.
    remove_mean : bool, optional
        Whether the mean height of each repeat is removed first: it is drift, not noise.

    Returns
    -------
    NoiseEstimate
        Pooled sigma, map, correlation and effective number of points.

    Raises
    ------
    $repeats
    DataError
        If `remove_mean` is not True or False.

    Notes
    -----
    sigma^2 is the sum of squared deviations from the mean of the repeats over (R - 1) n points,
    or (R - 1) (n - 1) when the means were removed. The autocorrelation runs over pairs of valid
    points, without wrapping, up to its first zero along each axis.
    """
    remove_mean = flag(remove_mean, "remove_mean")
    stack = stack_repeats(objects)
    valid = np.isfinite(stack[0])
    residuals = residuals_of(stack, remove_mean=remove_mean)
    n_repeats, n = int(stack.shape[0]), int(valid.sum())
    total = float(np.square(residuals[:, valid]).sum())
    sigma = math.sqrt(total / ((n_repeats - 1) * (n - 1 if remove_mean else n)))
    sd = np.sqrt(np.square(residuals).sum(axis=0) / (n_repeats - 1))
    acf, pairs = _pair_autocorrelation(residuals, valid)
    window = _central_window(acf)
    overlap = float((pairs[window] * np.square(acf[window])).sum())
    n_effective = min(n * n / overlap, float(n)) if overlap > 0.0 else float(n)
    lengths = tuple(_fall_length(_along(acf, axis)) for axis in range(acf.ndim))
    sd.setflags(write=False)
    return NoiseEstimate(sigma, sd, n_repeats, n, lengths, n_effective)


def residuals_of(stack: FloatArray, *, remove_mean: bool) -> FloatArray:
    """Return each repeat less the mean of all; NaN stays."""
    if remove_mean:
        valid = np.isfinite(stack[0])
        means = stack[:, valid].mean(axis=1)
        stack = stack - means.reshape(-1, *(1,) * (stack.ndim - 1))
    residuals: FloatArray = stack - stack.mean(axis=0)
    return residuals


def _pair_autocorrelation(
    residuals: FloatArray, valid: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray]:
    """Return normalised ACF and number of pairs at all lags on a torus twice as long."""
    torus = tuple(2 * n for n in valid.shape)
    axes = tuple(range(len(torus)))
    mask = np.fft.rfftn(valid.astype(float), s=torus, axes=axes)
    pairs = np.round(np.fft.irfftn(np.abs(mask) ** 2, s=torus, axes=axes))
    power = np.zeros(mask.shape)
    for field_ in residuals:
        power += np.abs(np.fft.rfftn(np.where(valid, field_, 0.0), s=torus, axes=axes)) ** 2
    sums = np.fft.irfftn(power, s=torus, axes=axes)
    acf = np.divide(sums, pairs, out=np.zeros(torus), where=pairs > 0.0)
    zero = float(acf.flat[0])
    return (acf / zero if zero > 0.0 else np.zeros(torus)), pairs


def _along(acf: FloatArray, axis: int) -> FloatArray:
    index: list[int | slice] = [0] * acf.ndim
    index[axis] = slice(0, acf.shape[axis] // 2)
    line: FloatArray = acf[tuple(index)]
    return line


def _central_window(acf: FloatArray) -> tuple[NDArray[np.intp], ...]:
    """Return the lags up to the first zero of the ACF along each axis."""
    ranges = []
    for axis in range(acf.ndim):
        line = _along(acf, axis)
        below = np.flatnonzero(line <= 0.0)
        reach = int(below[0]) if below.size else line.size
        ranges.append(np.arange(-max(reach - 1, 0), max(reach, 1)))
    return np.ix_(*ranges)


def _fall_length(line: FloatArray) -> float | None:
    below = np.flatnonzero(line <= math.exp(-1.0))
    if below.size == 0 or below[0] == 0:
        return None
    i = int(below[0])
    return float(i - (math.exp(-1.0) - line[i]) / (line[i - 1] - line[i]))
