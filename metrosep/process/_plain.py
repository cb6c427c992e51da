"""Private: what results share: arrays that cannot be changed, plain values, lengths in metres, even time."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray, as_float, frozen_float
from metrosep.core.errors import (
    InvalidSamplesError,
    NotUniformError,
    TooFewSamplesError,
    UnitError,
)
from metrosep.core.provenance import freeze_mapping
from metrosep.core.quantity import Quantity
from metrosep.core.units import format_length

_UNIFORM = 1e-3
"""Largest deviation of a step from the mean one, relative, of a time that counts as uniform."""


class Frozen:
    """A result: its arrays of numbers are read-only and finite or NaN, its mappings read-only."""

    __slots__ = ()

    def __post_init__(self) -> None:
        for field in fields(self):  # type: ignore[arg-type]  # of the dataclass that it is
            value = getattr(self, field.name)
            if value is not None and str(field.type).startswith("FloatArray"):
                value = frozen_float(value, name=field.name, ndim=np.ndim(value), min_size=0)
            elif isinstance(value, np.ndarray):
                value.setflags(write=False)
            elif isinstance(value, dict):
                value = freeze_mapping(value)
            object.__setattr__(self, field.name, value)


def frozen(values: Any) -> FloatArray:
    """Return an array that was just made, read-only from now on."""
    array = np.asarray(values, dtype=np.float64)
    array.setflags(write=False)
    return array


def known(value: float | None) -> float | None:
    """Return a number, None where it is NaN: an audit holds no NaN."""
    return None if value is None or math.isnan(value) else float(value)


def plain(value: Any) -> Any:
    """Return lists, dicts, numbers and texts; NaN and infinity become None."""
    if isinstance(value, Quantity):
        return plain(value.to_dict())
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    return value if not isinstance(value, float) or math.isfinite(value) else None


def not_above(number: float, name: str, largest: float) -> float:
    """Return a length that can be in metres; a larger one lost its unit."""
    if abs(number) > largest:
        raise UnitError(
            f"{name} = {number:g} m is not plausible (limit {format_length(largest)}): lengths are in "
            f"metres, so {number:g} mm is {number * 1e-3:g} and {number:g} um is {number * 1e-6:g}"
        )
    return number


def length(value: Any, name: str, largest: float = math.inf) -> float:
    """Return a length above zero in m, of a number or a text with its unit."""
    return not_above(numbers.positive(value, name, dimension="length"), name, largest)


def optional_length(value: Any, name: str, largest: float) -> float | None:
    """Return a length above zero in m; None stays."""
    return None if value is None else length(value, name, largest)


def real_array(values: object, name: str) -> FloatArray:
    """Return a float64 copy; refuse what holds no real numbers."""
    try:
        return as_float(values)
    except (TypeError, ValueError) as exc:
        raise InvalidSamplesError(
            f"{name} must hold real numbers, got {type(values).__name__}: {exc}"
        ) from None


def finite_positions(values: ArrayLike, name: str) -> FloatArray:
    """Return a float64 copy without NaN and infinities."""
    array = real_array(values, name)
    bad = np.flatnonzero(~np.isfinite(array))
    if bad.size:
        raise InvalidSamplesError(
            f"{name} is {array.ravel()[bad[0]]} at point {int(bad[0])}: leave the point out"
        )
    return array


def same_places(**given: FloatArray) -> list[FloatArray]:
    """Return arrays of positions in one shape."""
    try:
        return list(np.broadcast_arrays(*given.values()))
    except ValueError:
        shapes = " and ".join(f"{name} of shape {a.shape}" for name, a in given.items())
        raise InvalidSamplesError(
            f"{shapes} do not broadcast: give one of the second for each of the first, or one for all"
        ) from None


def complete(values: ArrayLike, name: str, why: str, ndim: int = 1) -> FloatArray:
    """Return samples of which none is missing."""
    array = frozen_float(values, name=name, ndim=ndim)
    if np.isnan(array).any():
        i = int(np.argwhere(np.isnan(array))[0][-1])
        raise InvalidSamplesError(f"{name} is NaN at index {i}; {why}")
    return array


def uniform_time(times: FloatArray, least: int, what: str) -> float:
    """Return the step of a time that is uniform."""
    if times.size < least:
        raise TooFewSamplesError(f"{what} needs at least {least} samples, got {times.size}")
    step = float(times[-1] - times[0]) / (times.size - 1)
    if not (step > 0.0 and float(np.abs(np.diff(times) / step - 1.0).max()) <= _UNIFORM):
        raise NotUniformError("time t must be uniform and increasing; resample the log first")
    return step
