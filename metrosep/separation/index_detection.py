"""Index pulses in an analogue or TTL channel: threshold, hysteresis, edges between samples."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray, frozen_float
from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.separation._real_numbers import real_numbers

__all__ = ["index_pulses"]


_DEFAULT_HYSTERESIS = 0.2
"""Part of the range of the channel."""


def index_pulses(
    channel: ArrayLike,
    /,
    *,
    threshold: float | None = None,
    hysteresis: float | None = None,
    edge: Literal["rising", "falling"] = "rising",
) -> FloatArray:
    """Return where a once-per-revolution channel crosses its threshold, in sample numbers.

    Parameters
    ----------
    channel : array_like, shape (n_samples,), any unit
        Voltage of the index: TTL, proximity sensor, optical mark.
    threshold : float, unit of the channel, optional
        Level of the edge; the middle of the range by default.
    hysteresis : float, unit of the channel, optional
        The channel must pass the threshold by half of it on both sides; 20 % of the range by
        default, so that noise on a slow edge counts once.
    edge : {"rising", "falling"}, optional
        Which edge marks angle 0. The two are a pulse width apart: use one throughout.

    Returns
    -------
    ndarray, shape (n_pulses,), sample numbers with fractions
        Crossing of the line through the samples on both sides of the threshold.

    Raises
    ------
    InvalidSamplesError
        If the channel is not real, holds NaN, is constant, or never crosses.
    DataError
        If an option is not usable.

    Notes
    -----
    An edge that rises within one sample is placed in the middle of it: rectangular
    distribution, standard uncertainty 0.29 samples, or 2 pi 0.29 / (samples per revolution) rad.

    Examples
    --------
    >>> index_pulses([0, 0, 5, 5, 0, 0, 0, 5, 5]).tolist()
    [1.5, 6.5]
    """
    values = frozen_float(
        real_numbers(channel, "the index channel"), name="the index channel", ndim=1, min_size=2
    )
    if edge not in ("rising", "falling"):
        raise DataError(f"edge is 'rising' or 'falling', got {edge!r}")
    if np.isnan(values).any():
        first = int(np.flatnonzero(np.isnan(values))[0])
        raise InvalidSamplesError(f"the index channel is NaN at sample {first}")
    low, high = float(values.min()), float(values.max())
    if low == high:
        raise InvalidSamplesError(f"the index channel is {low:g} throughout: no pulse")
    level = 0.5 * (low + high) if threshold is None else float(threshold)
    gap = _DEFAULT_HYSTERESIS * (high - low) if hysteresis is None else float(hysteresis)
    if not (math.isfinite(gap) and gap >= 0.0):
        raise DataError(f"hysteresis must not be negative, got {gap}")
    if not (low <= level - 0.5 * gap and level + 0.5 * gap <= high):
        raise InvalidSamplesError(
            f"the index channel runs from {low:g} to {high:g} and never crosses {level:g} with a "
            f"hysteresis of {gap:g}: set threshold="
        )
    sign = 1.0 if edge == "rising" else -1.0
    return _crossings(sign * (values - level), 0.5 * gap)


def _crossings(v: FloatArray, half: float) -> FloatArray:
    """Return upward crossings of zero that go from -half to +half."""
    state = np.where(v >= half, 1, np.where(v <= -half, -1, 0)) if half else np.where(v > 0, 1, -1)
    last = np.maximum.accumulate(np.where(state != 0, np.arange(v.size), 0))
    settled = state[last]
    tops = np.flatnonzero((settled[1:] == 1) & (settled[:-1] == -1)) + 1
    below = np.maximum.accumulate(np.where(v <= 0.0, np.arange(v.size), 0))
    before = below[tops]
    rise = v[before + 1] - v[before]
    return np.asarray(before - v[before] / rise, dtype=np.float64)
