"""Private: what a tool setting, its uncertainty, a position and a region may be."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray, as_float, frozen_float
from metrosep.core.errors import DataError, InvalidSamplesError, UnitError
from metrosep.core.units import format_length
from metrosep.process._setting_model import FACTORS
from metrosep.process.setting_maps import DEFAULT_RADIUS, checked_region, plausible_length

LARGEST_NOSE = 0.1
"""m: no round nose of a turning tool is larger; from here on a number is in mm."""
LARGEST_SETTING = {"dx": 1e-3, "dy": 1e-3, "dR": 10e-3}
"""m: more than this is a number in um or mm that lost its unit."""


def checked_setting(value: object, name: str) -> float:
    try:
        number = real_number(value)
    except (TypeError, ValueError):
        raise DataError(f"{name} must be a number in m, got {value!r}") from None
    if not math.isfinite(number):
        raise DataError(f"{name} must be finite, got {number}")
    if abs(number) > LARGEST_SETTING[name]:
        raise UnitError(
            f"{name} = {number:g} m is no tool setting (limit {format_length(LARGEST_SETTING[name])}): "
            f"values are in metres, so {number:g} um is {number * 1e-6:g}"
        )
    return number


def checked_uncertainty(value: object, name: str) -> float | None:
    if value is None:
        return None
    try:
        number = real_number(value)
    except (TypeError, ValueError):
        raise DataError(f"{name} must be a number in m, got {value!r}") from None
    if math.isnan(number) or number < 0.0:
        raise DataError(f"{name} must be zero or more, got {number}")
    if math.isfinite(number) and number > 10e-3:
        raise UnitError(
            f"{name} = {number:g} m is no uncertainty of a tool setting: values are in metres, so "
            f"{number:g} um is {number * 1e-6:g}"
        )
    return number


def checked_covariance(cov: ArrayLike) -> FloatArray:
    array = real_array(cov, "cov")
    if array.shape != (3, 3):
        raise InvalidSamplesError(f"cov must be 3 x 3 for (dx, dy, dR), got shape {array.shape}")
    diagonal = np.diag(array)
    if np.isnan(array).any() or (diagonal < 0.0).any():
        raise DataError("cov holds NaN or a negative variance; a covariance has neither")
    if np.isfinite(array).all():
        scale = np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
        unit = array / np.outer(scale, scale)
        if np.abs(unit - unit.T).max() > 1e-9 or np.linalg.eigvalsh(unit).min() < -1e-9:
            raise DataError("cov is not symmetric and positive: it is no covariance")
        return frozen_float(array, name="cov", ndim=2)
    array.setflags(write=False)
    return array


def checked_factors(factors: Sequence[str]) -> None:
    for name in factors:
        if name not in FACTORS:
            raise DataError(f"a factor of the setting is dx, dy or dR, got {name!r}")


def real_array(values: object, name: str) -> FloatArray:
    """Return a float64 copy; refuse what holds no real numbers."""
    try:
        return as_float(values)
    except (TypeError, ValueError) as exc:
        raise InvalidSamplesError(
            f"{name} must hold real numbers, got {type(values).__name__}: {exc}"
        ) from None


def positive_length(value: object, name: str, largest: float) -> float | None:
    """Return a length in m, > 0 and below `largest`; None stays."""
    if value is None:
        return None
    try:
        number = real_number(value)
    except (TypeError, ValueError):
        raise DataError(f"{name} must be a number in m, got {value!r}") from None
    if not (math.isfinite(number) and number > 0.0):
        raise DataError(f"{name} must be positive and finite, in m, got {value}")
    if number >= largest:
        raise UnitError(
            f"{name} = {number:g} m is not plausible: lengths are in metres, so {number:g} um is "
            f"{number * 1e-6:g}"
        )
    return number


def real_number(value: Any) -> float:
    """Return a float; flags and complex numbers are a TypeError."""
    if isinstance(value, bool | np.bool_):
        raise TypeError("a flag is no number")
    return float(value)


def positions(x: ArrayLike, y: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return x and y on the workpiece, finite and of one shape."""
    found = {"x": finite_positions(x, "x"), "y": finite_positions(y, "y")}
    for name, array in found.items():
        plausible_length(float(np.abs(array).max(initial=0.0)), name)
    try:
        xs, ys = np.broadcast_arrays(found["x"], found["y"])
    except ValueError:
        raise InvalidSamplesError(
            f"x of shape {found['x'].shape} and y of shape {found['y'].shape} do not broadcast: give "
            "one y for each x, or one for all"
        ) from None
    return xs, ys


def finite_positions(values: ArrayLike, name: str) -> FloatArray:
    """Return a float64 copy without NaN and infinities."""
    array = real_array(values, name)
    bad = np.flatnonzero(~np.isfinite(array))
    if bad.size:
        raise InvalidSamplesError(
            f"{name} is {array.ravel()[bad[0]]} at point {int(bad[0])}: leave the point out"
        )
    return array


def map_extent(
    radius: float | None, region: tuple[float, float] | None
) -> tuple[float, float, tuple[str, ...]]:
    if region is not None:
        if radius is not None:
            raise DataError("give either a radius or a region, not both")
        inner, outer = checked_region(region)
        return inner, outer, ()
    if radius is None:
        said = f"no radius was given: the map reaches to {format_length(DEFAULT_RADIUS)}"
        return 0.0, DEFAULT_RADIUS, (said,)
    inner, outer = checked_region((0.0, radius))
    return inner, outer, ()
