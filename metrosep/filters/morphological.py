"""Morphological filters of profiles (ISO 16610-41), and the same elements on surfaces.

Sign: z points out of the material and the element lies on it from above. Dilation rolls it over
the surface and records where it stands; erosion does the same from inside the material. Closing
(dilation, then erosion) is the envelope that a ball from above can reach: narrow scratches are
bridged, ridges kept. Opening is the same from below: narrow ridges are cut, scratches kept.

Elements: a disc or ball of a radius, with its true shape ``h(s) = sqrt(R^2 - s^2) - R``; or a flat
horizontal segment or square of a length.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.docs import documented
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.surface import Surface
from metrosep.filters import _arguments as arguments
from metrosep.filters._arguments import DOCS, FilterBand, Measured, Wavelength
from metrosep.filters._elements import Element, checked_element

__all__ = ["closing", "dilation", "erosion", "opening"]


@documented(**DOCS)
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

    References
    ----------
    .. [1] ISO 16610-41:2015, morphological profile filters: disk and horizontal line-segment.

    Examples
    --------
    >>> dilation(Profile([0, 1, 2, 3, 4], [0, 0, 5, 0, 0]), length=2).z.tolist()
    [0.0, 5.0, 5.0, 5.0, 0.0]
    """
    element, steps = checked_element(obj, radius, length)
    return _replaced(obj, _on_measured(obj.z, steps, element.dilate), "dilation", element)


@documented(**DOCS)
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

    References
    ----------
    .. [1] ISO 16610-41:2015, morphological profile filters: disk and horizontal line-segment.

    Examples
    --------
    >>> erosion(Profile([0, 1, 2, 3, 4], [0, 0, -5, 0, 0]), length=2).z.tolist()
    [0.0, -5.0, -5.0, -5.0, 0.0]
    """
    element, steps = checked_element(obj, radius, length)
    return _replaced(obj, -_on_measured(-obj.z, steps, element.dilate), "erosion", element)


@documented(**DOCS)
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
    $element_raises

    Notes
    -----
    ``erosion(dilation(z))``. Closing twice is closing once. The element stands over measured
    samples only, so at an end that falls with slope m a ball leaves up to ``R m^2 / 2`` over the
    last ``R m``: remove tilt first. ``closing(z) = -opening(-z)``.

    References
    ----------
    .. [1] ISO 16610-41:2015, morphological profile filters: disk and horizontal line-segment.

    Examples
    --------
    >>> x = [0, 1, 2, 3, 4, 5, 6]
    >>> closing(Profile(x, [0, 0, 5, 0, 0, -5, 0]), length=2).z.tolist()
    [0.0, 0.0, 5.0, 0.0, 0.0, 0.0, 0.0]
    """
    return _filtered(obj, radius, length, band, refilter, name="closing", sign=1.0)


@documented(**DOCS)
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
    $element_raises

    Notes
    -----
    ``dilation(erosion(z)) = -closing(-z)``; ends and gaps as in `closing`.

    References
    ----------
    .. [1] ISO 16610-41:2015, morphological profile filters: disk and horizontal line-segment.

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
