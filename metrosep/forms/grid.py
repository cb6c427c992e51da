"""A form given as a height map, interpolated by a bicubic spline."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, DegenerateFitError, TooFewSamplesError
from metrosep.core.surface import Surface
from metrosep.forms.base import Shape, checked

__all__ = ["GridForm"]


_ON_NODE = 1e-6
"""A position this close to a node, in steps, is on it: it needs no neighbour beyond."""

_RINGS = 16
"""Rings of pixels continued beyond the measured ones; the spline forgets a pixel by 0.27 a step."""

_REACH = 3
"""Pixels that make a parabola."""


@dataclass(frozen=True, eq=False, repr=False)
class GridForm(Shape):
    """A nominal height map as a form.

    Parameters
    ----------
    surface : Surface
        Heights with lateral calibration, at least 4 x 4; its coordinates (with origin) are those of
        the form. NaN where the form has no value.
    scale : float or None, optional, dimensionless
        Factor on the heights. None: not known, a fit finds it.

    Raises
    ------
    DataError
        If it is no surface, has no lateral calibration, or scale is not finite.
    TooFewSamplesError
        If it is smaller than 4 x 4, or no cell has four heights.

    Notes
    -----
    Bicubic spline through all heights, not-a-knot at the ends: exact for polynomials up to the
    third degree in x and in y, continuous to the second derivative. A point is in the domain when
    the (up to four) pixels around it are valid; other points are NaN. Beside missing pixels the
    spline needs values all the same: there the map is continued by parabolas, whose curvature the
    neighbouring cells feel as an end condition, and which show nowhere else.

    Examples
    --------
    >>> x = np.linspace(0.0, 4e-3, 5)
    >>> form = GridForm(Surface(np.tile(x**2, (5, 1)), dx=1e-3, dy=1e-3))
    >>> round(form(1.5e-3, 2e-3).item(), 12)
    2.25e-06
    >>> form(5e-3, 0.0).item()
    nan
    """

    surface: Surface
    scale: float | None = 1.0
    valid: NDArray[np.bool_] = field(init=False)
    spline: Any = field(init=False)
    size: float = field(init=False)

    name = "grid"
    units = {"scale": "1"}  # noqa: RUF012
    has_centre = False

    def __post_init__(self) -> None:
        if not isinstance(self.surface, Surface):
            raise DataError(f"a grid form is made of a Surface, got {type(self.surface).__name__}")
        if self.surface.dx is None or self.surface.dy is None:
            raise DataError(
                "the nominal map has no lateral calibration (dx or dy is None): give both steps"
            )
        rows, columns = self.surface.shape
        valid = ~np.isnan(self.surface.z)
        whole = valid[1:, 1:] & valid[1:, :-1] & valid[:-1, 1:] & valid[:-1, :-1]
        if min(rows, columns) < 4 or not whole.any():
            raise TooFewSamplesError(
                f"the nominal map has {rows} x {columns} pixels and {int(whole.sum())} cells with "
                "four heights; a grid form needs 4 x 4 pixels and one such cell"
            )
        size = float(np.ptp(self.surface.z[valid])) or 1.0
        self._set(scale=checked(self.scale, "scale"), valid=valid, size=size)
        self._set(spline=_spline(_continued(self.surface.z / size)))

    def with_parameters(self, **values: float) -> Self:
        """Return the form with another factor on its heights.

        Parameters
        ----------
        **values : float
            ``scale``.

        Returns
        -------
        GridForm
            Another one that shares the map and the spline.

        Raises
        ------
        DataError
            If a name is unknown or the value is not finite.
        """
        self._check_names(values)
        other = copy.copy(self)
        for name, value in values.items():
            object.__setattr__(other, name, checked(value, name))
        return other

    def start(self, x: FloatArray, y: FloatArray, z: FloatArray) -> Self:
        """Return the form with a factor good enough to start a fit.

        Parameters
        ----------
        x, y, z : ndarray, shape (n,), m
            Valid points in the coordinates of the map; no NaN.

        Returns
        -------
        GridForm
            By linear regression with piston and tilt over the points in the domain.

        Raises
        ------
        TooFewSamplesError
            If fewer than 4 points lie in the domain.
        DegenerateFitError
            If the map is a plane there, which a factor cannot be told from tilt.
        """
        if self.scale is not None:
            return self
        unit = self._evaluate(x, y, 0, 0)
        inside = ~np.isnan(unit)
        if int(inside.sum()) < 4:
            raise TooFewSamplesError(
                f"{int(inside.sum())} points lie on the nominal map; its scale needs at least 4"
            )
        u, v, h, w = x[inside], y[inside], unit[inside] / self.size, z[inside] / self.size
        size = float(max(np.abs(u).max(), np.abs(v).max())) or 1.0
        plane = np.stack([np.ones_like(u), u / size, v / size], axis=1)
        bent = h - plane @ np.linalg.lstsq(plane, h, rcond=1e-12)[0]
        power = float(bent @ bent)
        if power <= 1e-24 * h.size:
            raise DegenerateFitError(
                "the nominal map is a plane where it was measured: its scale is not determined"
            )
        return self.with_parameters(scale=float(bent @ w) / power)

    def _evaluate(self, x: FloatArray, y: FloatArray, along_x: int, along_y: int) -> FloatArray:
        """Return the map, or a derivative, without the factor; NaN outside the domain."""
        dx, dy = float(self.surface.dx or 0.0), float(self.surface.dy or 0.0)
        rows, columns = self.surface.shape
        u = (x.ravel() - self.surface.origin[0]) / dx
        v = (y.ravel() - self.surface.origin[1]) / dy
        inside = (u >= -_ON_NODE) & (u <= columns - 1 + _ON_NODE)
        inside &= (v >= -_ON_NODE) & (v <= rows - 1 + _ON_NODE)
        u, v = np.clip(u[inside], 0.0, columns - 1.0), np.clip(v[inside], 0.0, rows - 1.0)
        if not self.valid.all():
            j0, j1 = _around(u)
            i0, i1 = _around(v)
            good = (
                self.valid[i0, j0] & self.valid[i0, j1] & self.valid[i1, j0] & self.valid[i1, j1]
            )
            inside[inside] = good
            u, v = u[good], v[good]
        found = np.full(x.size, np.nan)
        if u.size:
            factor = self.size / dx**along_x / dy**along_y
            found[inside] = factor * self.spline.ev(v, u, dx=along_y, dy=along_x)
        return found.reshape(x.shape)

    def _height(self, x: FloatArray, y: FloatArray) -> FloatArray:
        return self._known("scale")[0] * self._evaluate(x, y, 0, 0)

    def _slopes(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        (scale,) = self._known("scale")
        return scale * self._evaluate(x, y, 1, 0), scale * self._evaluate(x, y, 0, 1)

    def _derivatives(self, x: FloatArray, y: FloatArray, names: Sequence[str]) -> list[FloatArray]:
        return [self._evaluate(x, y, 0, 0) for _ in names]


def _around(position: FloatArray) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the nodes before and after; the same one twice for a position on it."""
    before = np.floor(position + _ON_NODE).astype(np.intp)
    return before, np.ceil(position - _ON_NODE).astype(np.intp)


def _spline(z: FloatArray) -> Any:
    from scipy.interpolate import RectBivariateSpline

    return RectBivariateSpline(np.arange(z.shape[0]), np.arange(z.shape[1]), z, kx=3, ky=3, s=0)


def _continued(z: FloatArray) -> FloatArray:
    """Return z with missing pixels continued by parabolas for some rings, then by the mean."""
    rows, columns = z.shape
    if not np.isnan(z).any():
        return z
    wide = np.pad(z, _REACH, constant_values=np.nan)
    window = (slice(_REACH, _REACH + rows), slice(_REACH, _REACH + columns))
    for _ in range(_RINGS):
        known = ~np.isnan(wide)
        ring = np.zeros_like(known)
        ring[window] = ~known[window] & (
            known[2:-4, 3:-3] | known[4:-2, 3:-3] | known[3:-3, 2:-4] | known[3:-3, 4:-2]
        )
        if not ring.any():
            break
        wide[ring] = _extrapolated(wide, *np.nonzero(ring))
    filled = wide[window]
    filled[np.isnan(filled)] = float(np.nanmean(z))
    return np.ascontiguousarray(filled)


def _extrapolated(z: FloatArray, i: NDArray[np.intp], j: NDArray[np.intp]) -> FloatArray:
    """Return the mean of what the three pixels on each side give for a pixel.

    A parabola through three counts far more than a line through two, a line far more than one.
    """
    total, weight = np.zeros(i.size), np.zeros(i.size)
    for di, dj in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        first, second, third = (z[i + n * di, j + n * dj] for n in (1, 2, 3))
        for guess, trust in (
            (3.0 * (first - second) + third, 1.0),
            (2.0 * first - second, 1e-9),
            (first, 1e-18),
        ):
            good = ~np.isnan(guess)
            total[good] += trust * guess[good]
            weight[good] += trust
    return total / weight
