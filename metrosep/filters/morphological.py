"""Morphological filters of profiles (ISO 16610-41), and the same elements on surfaces.

Sign: z points out of the material and the element lies on it from above. Dilation rolls it over
the surface and records where it stands; erosion does the same from inside the material. Closing
(dilation, then erosion) is the envelope that a ball from above can reach: narrow scratches are
bridged, ridges kept. Opening is the same from below: narrow ridges are cut, scratches kept.

Elements: a disc or ball of a radius, with its true shape ``h(s) = sqrt(R^2 - s^2) - R``; or a flat
horizontal segment or square of a length.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.docs import documented
from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.core.numbers import positive
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.surface import Surface
from metrosep.core.units import format_length
from metrosep.filters import _arguments as arguments
from metrosep.filters._arguments import DOCS, FilterBand, Measured, Wavelength

_DOCS = {
    **DOCS,
    "standard": """
        References
        ----------
        .. [1] ISO 16610-41:2015, morphological profile filters: disk and horizontal line-segment.
        """,
    "passed": """
        refilter : bool, optional
            Filter a profile that is a roughness profile already.

        Returns
        -------
        Profile or Surface
            Same grid, NaN where not measured. A profile of the short band is of kind R
            (of a W profile W).

        Raises
        ------
        DataError
            If not exactly one of `radius` and `length` is given, it is too small or too large for the
            grid, `band` is unknown, or the surface has no lateral step.
        DoubleFilterError
            If the profile is a roughness profile and `refilter` is false.
        """,
}
"""What several of them say."""


@documented(**_DOCS)
def dilation(obj: Measured, *, radius: Wavelength = None, length: Wavelength = None) -> Measured:
    """Return the heights of an element that lies on the surface from above.

    Parameters
    ----------
    $obj
    $element

    Returns
    -------
    Profile or Surface
        ``max z(x - s) + h(s)`` at each measured x, the lowest point of the element; the centre of
        a ball lies `radius` higher. Same grid, NaN where not measured.

    Raises
    ------
    DataError
        If not exactly one of `radius` and `length` is given, it is too small or too large for the
        grid, or the surface has no lateral step.
    $element_raises

    Notes
    -----
    The element is cut at the ends and at samples that were not measured: they take no part in the
    maximum, and no height is invented for them. ``dilation(z) = -erosion(-z)``.

    $standard

    Examples
    --------
    >>> dilation(Profile([0, 1, 2, 3, 4], [0, 0, 5, 0, 0]), length=2).z.tolist()
    [0.0, 5.0, 5.0, 5.0, 0.0]
    """
    element, steps = checked_element(obj, radius, length)
    return _replaced(obj, _on_measured(obj.z, steps, element.dilate), "dilation", element)


@documented(**_DOCS)
def erosion(obj: Measured, *, radius: Wavelength = None, length: Wavelength = None) -> Measured:
    """Return the heights of an element that lies on the surface from inside the material.

    Parameters
    ----------
    $obj
    $element

    Returns
    -------
    Profile or Surface
        ``min z(x - s) - h(s)`` at each measured x. Same grid, NaN where not measured.

    Raises
    ------
    DataError
        If not exactly one of `radius` and `length` is given, it is too small or too large for the
        grid, or the surface has no lateral step.
    $element_raises

    Notes
    -----
    Ends and gaps as in `dilation`.

    $standard

    Examples
    --------
    >>> erosion(Profile([0, 1, 2, 3, 4], [0, 0, -5, 0, 0]), length=2).z.tolist()
    [0.0, -5.0, -5.0, -5.0, 0.0]
    """
    element, steps = checked_element(obj, radius, length)
    return _replaced(obj, -_on_measured(-obj.z, steps, element.dilate), "erosion", element)


@documented(**_DOCS)
def closing(
    obj: Measured,
    *,
    radius: Wavelength = None,
    length: Wavelength = None,
    band: FilterBand = "long",
    refilter: bool = False,
) -> Measured:
    """Return the envelope that an element from above can touch, or what lies below it.

    Parameters
    ----------
    $obj
    $element
    band : {"long", "short"}, optional
        The envelope e >= z, or z - e.
    $passed
    $element_raises

    Notes
    -----
    ``erosion(dilation(z))``. Closing twice is closing once. The element stands over measured
    samples only, so at an end that falls with slope m a ball leaves up to ``R m^2 / 2`` over the
    last ``R m``: remove tilt first. ``closing(z) = -opening(-z)``.

    $standard

    Examples
    --------
    >>> x = [0, 1, 2, 3, 4, 5, 6]
    >>> closing(Profile(x, [0, 0, 5, 0, 0, -5, 0]), length=2).z.tolist()
    [0.0, 0.0, 5.0, 0.0, 0.0, 0.0, 0.0]
    """
    return _filtered(obj, radius, length, band, refilter, name="closing", sign=1.0)


@documented(**_DOCS)
def opening(
    obj: Measured,
    *,
    radius: Wavelength = None,
    length: Wavelength = None,
    band: FilterBand = "long",
    refilter: bool = False,
) -> Measured:
    """Return the envelope that an element from inside the material can touch, or what lies above.

    Parameters
    ----------
    $obj
    $element
    band : {"long", "short"}, optional
        The envelope e <= z, or z - e.
    $passed
    $element_raises

    Notes
    -----
    ``dilation(erosion(z)) = -closing(-z)``; ends and gaps as in `closing`.

    $standard

    Examples
    --------
    >>> x = [0, 1, 2, 3, 4, 5, 6]
    >>> opening(Profile(x, [0, 0, 5, 0, 0, -5, 0]), length=2).z.tolist()
    [0.0, 0.0, 0.0, 0.0, 0.0, -5.0, -5.0]
    """
    return _filtered(obj, radius, length, band, refilter, name="opening", sign=-1.0)


def _filtered(
    obj: Measured,
    radius: Wavelength,
    length: Wavelength,
    band: FilterBand,
    refilter: bool,
    *,
    name: Literal["closing", "opening"],
    sign: float,
) -> Measured:
    arguments.check_object(obj)
    arguments.check_band(band)
    if isinstance(obj, Profile):
        arguments.check_single_filtering(obj, refilter)
    element, steps = checked_element(obj, radius, length)

    def close(z: FloatArray, steps: tuple[float, ...], depth: float) -> FloatArray:
        upper = element.dilate(z, steps, depth)
        upper[np.isneginf(z)] = np.inf
        return np.maximum(-element.dilate(-upper, steps, depth), z)  # never below, by rounding

    low = sign * _on_measured(sign * obj.z, steps, close)
    step = Step(name, {**element.named(), "band": band})
    return arguments.finish(obj, low, band=band, step=step)


def _on_measured(
    z: FloatArray,
    steps: tuple[float, ...],
    operate: Callable[[FloatArray, tuple[float, ...], float], FloatArray],
) -> FloatArray:
    """Return an operation on z with -inf where nothing was measured, and NaN there afterwards."""
    missing = np.isnan(z)
    result = operate(np.where(missing, -np.inf, z), steps, float(np.ptp(z[~missing])))
    result[missing] = np.nan
    return result


def _replaced(obj: Measured, z: FloatArray, name: str, element: Element) -> Measured:
    history = (*obj.history, Step(name, element.named()))
    if isinstance(obj, Profile):
        return Profile(obj.x, z, metadata=obj.metadata, history=history)  # type: ignore[return-value]
    return Surface(z, obj.dx, obj.dy, origin=obj.origin, metadata=obj.metadata, history=history)  # type: ignore[return-value]


# ---- private: structuring elements, and the maximum of heights under them ----------------------

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
        steps: tuple[float, ...] = (obj.dx,)
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
