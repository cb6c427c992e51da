"""Repeats on top of each other, their mean, and the noise of a point.

Repeats are measurements of one part on the same points, each with noise of its own. Only points
that are valid in all repeats are used.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import InvalidSamplesError, TooFewSamplesError
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.surface import Surface
from metrosep.parameters._flags import true_or_false
from metrosep.parameters._named import with_heights

__all__ = ["NoiseEstimate", "mean_of_repeats", "noise_of_repeats", "stack_repeats"]


_SAME_POSITION = 1e-6
"""Largest difference of two positions, relative to the step, that counts as the same."""


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
    TooFewSamplesError
        If there are fewer than 2 repeats or fewer than 2 points valid in all.
    InvalidSamplesError
        If profiles and surfaces are mixed, or the points differ.
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
    TooFewSamplesError
        If there are fewer than 2 repeats or fewer than 2 points valid in all.
    InvalidSamplesError
        If profiles and surfaces are mixed, or the points differ.

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


def noise_of_repeats(
    objects: Sequence[Profile | Surface], *, remove_mean: bool = True
) -> NoiseEstimate:
    """Return the noise of a single repeat from the scatter between repeats.

    Parameters
    ----------
    objects : sequence of Profile or of Surface
        At least 2, on the same points.
    remove_mean : bool, optional
        Whether the mean height of each repeat is taken out first: it is drift, not noise.

    Returns
    -------
    NoiseEstimate
        Pooled sigma, map, correlation and effective number of points.

    Raises
    ------
    TooFewSamplesError
        If there are fewer than 2 repeats or fewer than 2 points valid in all.
    InvalidSamplesError
        If profiles and surfaces are mixed, or the points differ.
    DataError
        If `remove_mean` is not True or False.

    Notes
    -----
    sigma^2 is the sum of squared deviations from the mean of the repeats over (R - 1) n points,
    or (R - 1) (n - 1) when the means were removed. The autocorrelation runs over pairs of valid
    points, without wrapping, up to its first zero along each axis.
    """
    remove_mean = true_or_false(remove_mean, "remove_mean")
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
