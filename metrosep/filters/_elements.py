"""Private: structuring elements, and the maximum of heights under them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.core.numbers import positive
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.core.units import format_length
from metrosep.filters import _arguments as arguments

_BLOCK = 32_768
"""Samples worked on at once: they stay in the cache while the element passes over them."""

_ON_LIMIT = 1e-9
"""A sample this close to the rim of an element, relative, belongs to it."""


@dataclass(frozen=True, slots=True)
class Element:
    """A ball (radius in m) or a flat segment or square (length in m)."""

    radius: float | None
    length: float | None

    def dilate(self, z: FloatArray, steps: tuple[float, ...], depth: float) -> FloatArray:
        """Return the largest ``z(x - s) + h(s)``; not measured is -inf and never wins.

        Parts of the ball deeper than `depth`, the range of the heights, can touch nothing.
        """
        if self.radius is None:
            assert self.length is not None  # noqa: S101 - for the type checker
            return _flat_maximum(z, steps, self.length)
        return _ball_maximum(z, steps, self.radius, depth)

    def named(self) -> dict[str, float]:
        """Return the size for the history."""
        if self.radius is not None:
            return {"radius_m": self.radius}
        return {"length_m": float(self.length or 0.0)}


def checked_element(
    obj: Profile | Surface, radius: arguments.Wavelength, length: arguments.Wavelength
) -> tuple[Element, tuple[float, ...]]:
    """Return the element that was asked for and the steps of the grid, in the order of the array."""
    arguments.check_object(obj)
    if (radius is None) == (length is None):
        raise DataError(
            "give one structuring element: radius= of a disc or ball, or length= of a flat "
            f"segment or square, in m; got radius={radius}, length={length}"
        )
    arguments.require_valid(obj.z, 1, "a morphological filter")
    if isinstance(obj, Profile):
        if len(obj) < 2:
            raise TooFewSamplesError("a morphological filter needs 2 samples, got 1")
        steps: tuple[float, ...] = (arguments.profile_step(obj),)
    else:
        steps = arguments.surface_steps(obj)
    name = "length" if radius is None else "radius"
    size = positive(length if radius is None else radius, name, dimension="length")
    # unlike a cut-off, a segment of just two steps is of use: it reaches a neighbour on each side
    smallest = max(steps) * (2.0 if radius is None else 1.0)
    if size < smallest * (1.0 - _ON_LIMIT):
        raise DataError(
            f"{name} {format_length(size)} reaches no neighbour on this grid: it must be at least "
            f"{format_length(smallest)}; is the unit m?"
        )
    if radius is None:
        inside = arguments.measured_box(obj.z)
        longest = min(s * (b.stop - b.start) for s, b in zip(steps, inside, strict=True))
        arguments.check_not_longer(size, name, longest)
    return Element(None if radius is None else size, size if radius is None else None), steps


def _ball_maximum(
    z: FloatArray, steps: tuple[float, ...], radius: float, depth: float
) -> FloatArray:
    sunk = min(depth, radius)
    reach = math.sqrt(sunk * (2.0 * radius - sunk)) * (1.0 + _ON_LIMIT)
    plane = z[np.newaxis] if z.ndim == 1 else z
    spacing = (1.0, *steps) if z.ndim == 1 else steps
    halves = [
        min(int(reach / s), n - 1) if n > 1 else 0
        for s, n in zip(spacing, plane.shape, strict=True)
    ]
    s_y, s_x = (np.arange(-h, h + 1) * s for h, s in zip(halves, spacing, strict=True))
    square = s_y[:, np.newaxis] ** 2 + s_x**2
    inside = square <= reach**2
    root = np.sqrt(np.maximum(radius**2 - square, 0.0))
    drop = -square / (root + radius)  # sqrt(R^2 - s^2) - R without cancellation
    padded = np.pad(plane, [(h, h) for h in halves], constant_values=-np.inf)
    result = np.empty_like(plane)
    rows, columns = plane.shape
    wide = min(columns, _BLOCK)
    high = max(1, _BLOCK // wide)
    for top in range(0, rows, high):
        for left in range(0, columns, wide):
            block = result[top : top + high, left : left + wide]
            block[...] = -np.inf
            trial = np.empty_like(block)
            for a, b in np.argwhere(inside):
                part = padded[
                    top + a : top + a + block.shape[0], left + b : left + b + block.shape[1]
                ]
                np.add(part, drop[a, b], out=trial)
                np.maximum(block, trial, out=block)
    return result.reshape(z.shape)


def _flat_maximum(z: FloatArray, steps: tuple[float, ...], length: float) -> FloatArray:
    from scipy.ndimage import maximum_filter1d

    result = z
    for axis, step in enumerate(steps):
        half = int(length / (2.0 * step) * (1.0 + _ON_LIMIT))
        result = maximum_filter1d(result, 2 * half + 1, axis=axis, mode="constant", cval=-np.inf)
    return np.asarray(result)
