"""Taking points out of a map or profile: outside an aperture, and outliers. Nothing is filled."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.core.middle import measured_middle
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.surface import Surface
from metrosep.core.units import format_length

__all__ = ["Measured", "check_sizes", "masked", "middle_of", "without_points"]

Flags = NDArray[np.bool_]
Measured = Surface | Profile

_ROUNDING = 1e-9
"""Relative: a point on the rim of an aperture is inside."""


def masked(
    obj: Measured, aperture: Mapping[str, Any], *, outside: bool = True
) -> tuple[Measured, dict[str, Any]]:
    """Return an object without what lies outside (or inside) an aperture."""
    shape = str(aperture.get("shape", "circle"))
    check_sizes(shape, aperture, is_profile=isinstance(obj, Profile))
    x, y = _positions(obj)
    asked = aperture.get("centre", "fit")
    centre = middle_of(obj) if isinstance(asked, str) else _given(asked, obj)
    inside = _inside(shape, aperture, x - centre[0], y - centre[1])
    if isinstance(obj, Profile):
        inside = inside[0]
    out = ~inside if outside else inside
    taken = int(np.count_nonzero(out & ~np.isnan(obj.z)))
    facts: dict[str, Any] = {
        "shape": shape,
        **{f"{k}_m": float(aperture[k]) for k in _ALL_SIZES if k in aperture},
        "centre_m": list(centre),
        "outside": outside,
        "taken_out": taken,
    }
    result = without_points(obj, out, Step("mask", facts))
    left = obj.z.size - result.n_invalid
    if left == 0:
        raise TooFewSamplesError(
            f"the {shape} about {_place(centre)} leaves nothing of what was measured; the data "
            f"span {_span(x)} in x" + ("" if isinstance(obj, Profile) else f", {_span(y)} in y")
        )
    return result, {"taken_out": taken, "left": left, "centre_m": list(centre)}


def without_points(obj: Measured, out: Flags, step: Step) -> Measured:
    """Return an object with NaN where a mask says so."""
    z = np.where(out, np.nan, obj.z)
    history = (*obj.history, step)
    if isinstance(obj, Profile):
        return Profile(obj.x, z, metadata=obj.metadata, history=history)
    return Surface(z, obj.dx, obj.dy, origin=obj.origin, metadata=obj.metadata, history=history)


def middle_of(obj: Measured) -> tuple[float, float]:
    """Return the middle of what was measured.

    Notes
    -----
    All chords of a disc, a ring or a rectangle have their middle on its axis. The median forgives
    stray points, dropouts and a rim that is cut off on one side over less than half of the rows.
    """
    x, y = _positions(obj)
    if obj.n_invalid == obj.z.size:
        raise TooFewSamplesError("no sample was measured (all are NaN): there is no middle")
    return measured_middle(np.atleast_2d(obj.z), x.ravel(), y.ravel())


def _positions(obj: Measured) -> tuple[FloatArray, FloatArray]:
    """Return x as a row and y as a column."""
    if isinstance(obj, Profile):
        return obj.x[None, :], np.zeros((1, 1))
    if obj.dx is None or obj.dy is None:
        raise DataError(
            "the map has no lateral calibration, and an aperture is a length: read it with "
            'lateral_step = "1 um" in [input]'
        )
    rows, columns = obj.shape
    x: FloatArray = obj.origin[0] + obj.dx * np.arange(columns, dtype=np.float64)
    y: FloatArray = obj.origin[1] + obj.dy * np.arange(rows, dtype=np.float64)
    return x[None, :], y[:, None]


_SIZES = {
    "circle": ("diameter",),
    "ring": ("diameter", "inner_diameter"),
    "rectangle": ("width", "height"),
}


_ALL_SIZES = ("diameter", "inner_diameter", "width", "height")


def check_sizes(shape: str, aperture: Mapping[str, Any], *, is_profile: bool) -> None:
    """Refuse an aperture without its sizes."""
    if shape not in _SIZES:
        raise DataError(f"shape = {shape!r} is not one of {', '.join(_SIZES)}")
    needed = [k for k in _SIZES[shape] if not (is_profile and k == "height")]
    missing = [k for k in needed if aperture.get(k) is None]
    if missing:
        raise DataError(f'a {shape} needs {", ".join(missing)}, such as {missing[0]} = "10 mm"')
    stray = [k for k in aperture if k in _ALL_SIZES and k not in needed]
    if stray:
        kind = f"a {shape} on a profile" if is_profile else f"a {shape}"
        raise DataError(f"{kind} has no {', '.join(stray)}; it has {', '.join(needed)}")
    for key in needed:
        if not (np.isfinite(aperture[key]) and aperture[key] > 0.0):
            raise DataError(f"{key} of the aperture must be more than zero, got {aperture[key]} m")
    if shape == "ring" and not aperture["inner_diameter"] < aperture["diameter"]:
        raise DataError(
            f"inner_diameter = {format_length(aperture['inner_diameter'])} of the ring must be "
            f"smaller than diameter = {format_length(aperture['diameter'])}"
        )


def _given(centre: Any, obj: Measured) -> tuple[float, float]:
    values = tuple(float(v) for v in centre)
    if isinstance(obj, Profile):
        if len(values) > 2 or any(v != 0.0 for v in values[1:]):
            raise DataError('the centre on a profile is one position: centre = ["5 mm"]')
        return values[0], 0.0
    if len(values) != 2:
        raise DataError('the centre on a map has x and y: centre = ["5 mm", "5 mm"], or "fit"')
    return values[0], values[1]


def _inside(shape: str, aperture: Mapping[str, Any], x: FloatArray, y: FloatArray) -> Flags:
    if shape == "rectangle":
        within = np.abs(x) <= 0.5 * aperture["width"] * (1.0 + _ROUNDING)
        if "height" in aperture:
            within = within & (np.abs(y) <= 0.5 * aperture["height"] * (1.0 + _ROUNDING))
        return np.asarray(within & np.ones(y.shape, dtype=bool))
    squared = x**2 + y**2
    within = squared <= (0.5 * aperture["diameter"] * (1.0 + _ROUNDING)) ** 2
    if shape == "ring":
        within &= squared >= (0.5 * aperture["inner_diameter"] * (1.0 - _ROUNDING)) ** 2
    return np.asarray(within)


def _place(centre: tuple[float, float]) -> str:
    return f"({format_length(centre[0])}, {format_length(centre[1])})"


def _span(values: FloatArray) -> str:
    return f"{format_length(float(values.min()))} to {format_length(float(values.max()))}"
