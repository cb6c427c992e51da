"""Points of a surface with their areas: a polar mesh, or the pixels of a map."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.core.middle import assumed_axis
from metrosep.core.surface import Surface
from metrosep.core.units import format_length
from metrosep.forms.grid import GridForm

__all__ = ["N_AZIMUTH", "N_RHO", "SurfaceMesh", "centred_form", "polar_mesh"]


N_RHO, N_AZIMUTH = 300, 720

_FEWEST = 16
"""Points: fewer do not show the shape of a map."""

_AT_EDGE = 1e-9
"""Of the radius: a part this near to the edge of its form, where the slope is infinite, is on it."""


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceMesh:
    """Points of the nominal surface, measured from the axis of the part.

    Parameters
    ----------
    x, y, z, slope_x, slope_y : ndarray, shape (n,)
        Position in m and slopes; only points at which the surface is defined.
    weights : ndarray, shape (n,)
        Area of each point seen along z, sum 1.
    index : ndarray of int, shape (n,)
        Place of each point in the whole mesh.
    shape : tuple of (int, int)
        Of the whole mesh: radii and azimuths.
    rho, azimuth : ndarray
        Radii and azimuths of the whole mesh.
    form : callable
        ``form(x, y)`` and ``form.gradient(x, y)`` from the axis of the part.
    """

    x: FloatArray
    y: FloatArray
    z: FloatArray
    slope_x: FloatArray
    slope_y: FloatArray
    weights: FloatArray
    index: NDArray[np.intp]
    shape: tuple[int, int]
    rho: FloatArray
    azimuth: FloatArray
    form: Any

    @property
    def n_missing(self) -> int:
        """Points of the mesh at which the surface is not defined."""
        return self.shape[0] * self.shape[1] - self.index.size

    def whole(self, values: FloatArray) -> FloatArray:
        """Return values of the points on the whole mesh, NaN where there is no surface."""
        out = np.full((self.shape[0] * self.shape[1], *values.shape[1:]), np.nan)
        out[self.index] = values
        return out.reshape((*self.shape, *values.shape[1:]))


class _Moved:
    """A form seen from another centre."""

    def __init__(self, form: Any, centre: tuple[float, float]) -> None:
        self._form, self._centre = form, centre

    def __call__(self, x: FloatArray, y: FloatArray) -> FloatArray:
        return np.asarray(self._form(x + self._centre[0], y + self._centre[1]), dtype=np.float64)

    def gradient(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return dz/dx and dz/dy."""
        along_x, along_y = self._form.gradient(x + self._centre[0], y + self._centre[1])
        return np.asarray(along_x, dtype=np.float64), np.asarray(along_y, dtype=np.float64)


def centred_form(surface: Any, centre: tuple[float, float] | None) -> Any:
    """Return height and gradient of a form or map, measured from the axis of the part.

    Without a centre a form counts from its own origin, and a map from the middle of what was
    measured if its origin was not declared (it is 0, 0), else from its coordinates' zero.
    """
    form = surface
    if isinstance(surface, Surface):
        form = GridForm(surface)
        centre = assumed_axis(surface).position if centre is None else centre
    if not callable(form) or not callable(getattr(form, "gradient", None)):
        raise DataError(
            "the nominal surface must be a form of metrosep.forms (with a gradient) or a Surface, "
            f"got {type(surface).__name__}"
        )
    return _Moved(form, checked_centre(centre))


def checked_centre(centre: tuple[float, float] | None) -> tuple[float, float]:
    """Return a centre as two finite numbers; zero if None."""
    try:
        x, y = (0.0, 0.0) if centre is None else (float(v) for v in centre)
    except (TypeError, ValueError):
        x = y = math.nan
    if not (math.isfinite(x) and math.isfinite(y)):
        raise DataError(f"centre is a pair of finite positions (x, y) in m, got {centre!r}")
    return x, y


def polar_mesh(
    surface: Any,
    *,
    radius: float,
    inner_radius: float = 0.0,
    n_rho: int = N_RHO,
    n_azimuth: int = N_AZIMUTH,
    centre: tuple[float, float] | None = None,
) -> SurfaceMesh:
    """Return midpoint radii and azimuths from 0 with their areas; points without surface left out.

    Azimuths begin at 0, so that a symmetric surface is met symmetrically.
    """
    outer, inner = _radii(radius, inner_radius)
    n_rho, n_azimuth = _count(n_rho, "n_rho", 2), _count(n_azimuth, "n_azimuth", 4)
    if n_rho * n_azimuth < _FEWEST:
        raise TooFewSamplesError(
            f"a mesh of {n_rho} x {n_azimuth} points is too coarse to rank on"
        )
    form = centred_form(surface, centre)
    rho = inner + (np.arange(n_rho) + 0.5) / n_rho * (outer - inner)
    azimuth = 2.0 * np.pi * np.arange(n_azimuth) / n_azimuth
    x = (rho[:, None] * np.cos(azimuth)).ravel()
    y = (rho[:, None] * np.sin(azimuth)).ravel()
    z = form(x, y)
    slope_x, slope_y = form.gradient(x, y)
    found = np.isfinite(z) & np.isfinite(slope_x) & np.isfinite(slope_y)
    index = np.flatnonzero(found)
    if index.size < _FEWEST:
        raise TooFewSamplesError(
            f"the surface is defined at {index.size} of {x.size} points between the radii {inner} "
            f"and {outer} m; give the radius of the part in m, and a surface that covers it"
        )
    if not isinstance(surface, Surface):
        _refuse_beyond(form, surface, outer, azimuth)
    area = np.repeat(rho, n_azimuth)[index]
    at = [np.ascontiguousarray(v[index]) for v in (x, y, z, slope_x, slope_y)]
    mesh = SurfaceMesh(
        x=at[0],
        y=at[1],
        z=at[2],
        slope_x=at[3],
        slope_y=at[4],
        weights=area / area.sum(),
        index=index,
        shape=(n_rho, n_azimuth),
        rho=rho,
        azimuth=azimuth,
        form=form,
    )
    for name in ("x", "y", "z", "slope_x", "slope_y", "weights", "index", "rho", "azimuth"):
        getattr(mesh, name).setflags(write=False)
    return mesh


def _refuse_beyond(form: Any, given: Any, outer: float, azimuth: FloatArray) -> None:
    """Refuse a part that reaches to or beyond the edge of its form."""

    def lost(rho: FloatArray) -> NDArray[np.bool_]:
        x, y = rho * np.cos(azimuth), rho * np.sin(azimuth)
        with np.errstate(all="ignore"):
            return np.asarray(~np.isfinite([form(x, y), *form.gradient(x, y)]).all(axis=0))

    far = np.full(azimuth.shape, outer * (1.0 + _AT_EDGE))
    beyond = lost(far)
    if not beyond.any():
        return
    near = np.full(azimuth.shape, _AT_EDGE * outer)
    while np.max(far - near) > _AT_EDGE * outer:
        middle = 0.5 * (near + far)
        off = lost(middle)
        near, far = np.where(off, near, middle), np.where(off, middle, far)
    edge = format_length(float(near[beyond].min()))
    raise DataError(
        f"the form {given!r} ends at a radius of {edge} from the axis of the part, and the part "
        f"has {format_length(outer)}: give a smaller radius, or the form of the part"
    )


def _radii(radius: Any, inner_radius: Any) -> tuple[float, float]:
    is_text = isinstance(radius, str) or isinstance(inner_radius, str)
    try:
        outer, inner = (float(v) for v in ("text" if is_text else radius, inner_radius))
    except (TypeError, ValueError):
        raise DataError(f"radii are numbers in m, got {radius!r} and {inner_radius!r}") from None
    if not (math.isfinite(outer) and math.isfinite(inner) and 0.0 <= inner < outer):
        raise InvalidSamplesError(
            f"the part lies between inner_radius = {inner} m and radius = {outer} m; "
            "0 <= inner_radius < radius is needed"
        )
    return outer, inner


def _count(value: int, name: str, least: int) -> int:
    if isinstance(value, bool) or int(value) != value or value < least:
        raise TooFewSamplesError(f"{name} is a whole number of at least {least}, got {value!r}")
    return int(value)
