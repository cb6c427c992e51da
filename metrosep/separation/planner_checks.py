"""Checks on what a user of the planner types: speeds and lengths in SI, and hints where not."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, TooFewSamplesError, UnitError
from metrosep.separation._real_numbers import real_numbers

__all__ = ["LONG_WAVE", "checked_feeds", "checked_wavelengths", "positive"]


_FASTEST = 5.0
"""m/s (300 m/min); no feed drive of a machine tool is faster."""

LONG_WAVE = 2.0
"""m; longer waves are doubted: mm typed for m look so."""

_LONGEST = 100.0
"""m; no machine axis is longer."""

_N_IN_RANGE = 121


def positive(value: Any, name: str, unit: str, *, zero: bool = False) -> float:
    """Return a number that is positive and finite."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise DataError(f"{name} must be a number in {unit}, got {value!r}") from None
    if not math.isfinite(number) or number < 0.0 or (number == 0.0 and not zero):
        raise DataError(f"{name} is {number} {unit}; it must be positive and finite")
    return number


def checked_feeds(values: ArrayLike, name: str) -> FloatArray:
    """Return feeds as numbers, refusing what cannot be m/s."""
    feeds = _numbers(values, name)
    if not (np.isfinite(feeds) & (feeds > 0.0)).all():
        raise DataError(f"{name} must be positive and finite speeds in m/s, got {feeds.tolist()}")
    if feeds.size and feeds.max() > _FASTEST:
        raise UnitError(
            f"{name}: {feeds.max():.6g} m/s is faster than any feed drive; speeds are in m/s "
            f"({feeds.max():.6g} mm/s is {feeds.max() / 1e3:.4g} m/s, {feeds.max():.6g} mm/min is "
            f"{feeds.max() / 6e4:.4g} m/s)"
        )
    return feeds


def checked_wavelengths(
    values: ArrayLike, *, travel_is_known: bool = False
) -> tuple[FloatArray, bool]:
    """Return the wavelengths, rising, and whether they came from a range."""
    waves = _numbers(values, "wavelengths")
    if not waves.size:
        raise TooFewSamplesError("wavelengths is empty; give the waves that matter in m")
    if not (np.isfinite(waves) & (waves > 0.0)).all():
        raise DataError(f"wavelengths must be positive and finite, in m, got {waves.tolist()}")
    if waves.max() > (_LONGEST if travel_is_known else LONG_WAVE):
        raise UnitError(
            f"a wavelength of {waves.max():.6g} m is longer than the travel of most machines; "
            f"wavelengths are in m ({waves.max():.6g} mm is {waves.max() / 1e3:.4g}); give length "
            "where the travel is that long"
        )
    if isinstance(values, tuple) and waves.size == 2 and waves[0] != waves[1]:
        grid: FloatArray = np.geomspace(waves.min(), waves.max(), _N_IN_RANGE)
        grid[0], grid[-1] = waves.min(), waves.max()
        return grid, True
    return waves, False


def _numbers(values: ArrayLike, name: str) -> FloatArray:
    return np.array(real_numbers(values, name), dtype=np.float64).ravel()
