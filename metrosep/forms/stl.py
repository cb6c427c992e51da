"""A form given as a mesh of triangles, such as the STL file of a designed part.

The height at a point is where a vertical ray from above meets the mesh first. Facets are flat: a
mesh deviates from a smooth design by up to ``edge^2 / (8 R)``, 1.25 um for edges of 1 mm and
R = 100 mm, and the gradient jumps from facet to facet. A height map (`GridForm`) or a formula is
better where it can be had.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray, IntArray
from metrosep.core.errors import (
    DataError,
    DegenerateFitError,
    InvalidSamplesError,
    TooFewSamplesError,
)
from metrosep.core.surface import Surface
from metrosep.forms.base import Shape, checked

_EDGE = 1e-9
"""A point this far outside an edge, as part of the triangle, is on it: no gaps between facets."""

_BESIDE = 1e-3
"""Of the length of an edge: a crack narrower than that is rounding, not a hole."""

_ENTRIES = 32
"""Most entries of the search grid, per triangle."""


@dataclass(frozen=True, eq=False, repr=False)
class MeshForm(Shape):
    """The upper side of a mesh of triangles; made by `from_triangles`.

    Parameters
    ----------
    corners : ndarray, shape (n, 3, 3), m
        Triangle, corner, coordinate.

    Raises
    ------
    DataError
        If the shape is not (n, 3, 3).
    TooFewSamplesError
        If there is no triangle, or all stand upright and none is seen from above.
    InvalidSamplesError
        If a coordinate is not finite.

    Notes
    -----
    It has no parameters. Where triangles lie above each other the highest counts. NaN where a
    vertical ray meets no triangle.
    """

    corners: FloatArray
    inverse: FloatArray = field(init=False)
    planes: FloatArray = field(init=False)
    low: FloatArray = field(init=False)
    step: FloatArray = field(init=False)
    n_bins: tuple[int, int] = field(init=False)
    starts: IntArray = field(init=False)
    members: IntArray = field(init=False)

    name = "mesh"
    has_centre = False

    def __post_init__(self) -> None:
        corners = _checked(self.corners)
        first = corners[:, 0]
        p, q = corners[:, 1] - first, corners[:, 2] - first
        area = p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]
        reach = np.abs(np.stack([p[:, :2], q[:, :2]])).max(axis=(0, 2))
        seen = np.abs(area) > 1e-12 * reach**2
        if not seen.any():
            raise TooFewSamplesError(
                f"all {area.size} triangles stand upright or have no area: none is seen from above"
            )
        corners, p, q, area = corners[seen], p[seen], q[seen], area[seen]
        inverse = np.stack([q[:, 1], -q[:, 0], -p[:, 1], p[:, 0]], axis=1) / area[:, None]
        gx = (p[:, 2] * q[:, 1] - q[:, 2] * p[:, 1]) / area
        gy = (q[:, 2] * p[:, 0] - p[:, 2] * q[:, 0]) / area
        self._set(corners=corners, inverse=inverse, planes=np.stack([gx, gy], axis=1))
        low, step, n_bins, starts, members = _binned(corners[:, :, :2])
        self._set(low=low, step=step, n_bins=n_bins, starts=starts, members=members)

    def _top(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, IntArray]:
        """Return the height at points, and the triangle that gives it, -1 for none."""
        px, py = x.ravel(), y.ravel()
        z, facet = np.full(px.size, np.nan), np.full(px.size, -1, dtype=np.intp)
        within = np.zeros(px.size, dtype=bool)
        u, v = (px - self.low[0]) / self.step[0], (py - self.low[1]) / self.step[1]
        nx, ny = self.n_bins
        at = np.flatnonzero((u >= -_EDGE) & (v >= -_EDGE) & (u <= nx + _EDGE) & (v <= ny + _EDGE))
        column = np.clip(u[at].astype(np.intp), 0, nx - 1)
        bins = np.clip(v[at].astype(np.intp), 0, ny - 1) * nx + column
        entry, last = self.starts[bins], self.starts[bins + 1]
        while True:
            more = entry < last
            at, entry, last = at[more], entry[more], last[more]
            if at.size == 0:
                return z.reshape(x.shape), facet.reshape(x.shape)
            t = self.members[entry]
            a, b = px[at] - self.corners[t, 0, 0], py[at] - self.corners[t, 0, 1]
            inv = self.inverse[t]
            s1, s2 = inv[:, 0] * a + inv[:, 1] * b, inv[:, 2] * a + inv[:, 3] * b
            height = self.corners[t, 0, 2] + self.planes[t, 0] * a + self.planes[t, 1] * b
            hit = (s1 >= -_EDGE) & (s2 >= -_EDGE) & (s1 + s2 <= 1.0 + _EDGE)
            # beyond its edge a triangle counts where no other is: its plane lies above a convex edge
            inner = (s1 >= 0.0) & (s2 >= 0.0) & (s1 + s2 <= 1.0)
            known = within[at]
            hit &= (inner & ~known) | ((inner == known) & ~(height <= z[at]))
            z[at[hit]], facet[at[hit]], within[at[hit]] = height[hit], t[hit], inner[hit]
            entry = entry + 1

    def height(self, x: FloatArray, y: FloatArray) -> FloatArray:
        return self._top(x, y)[0]

    @cached_property
    def border(self) -> tuple[FloatArray, FloatArray]:
        """Places where the mesh ends as seen from above, within its outline too, shape (n,), m.

        They are the middles of edges that one triangle has, or at which triangles fold, and beside which a
        vertical ray meets none.
        """
        corners = self.corners
        _, named = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
        named = named.reshape(-1, 3)
        ends = np.concatenate([named[:, [0, 1]], named[:, [1, 2]], named[:, [2, 0]]])
        first, second = (
            np.concatenate([corners[:, k] for k in order]) for order in ((0, 1, 2), (1, 2, 0))
        )
        p, q = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        up = np.tile(np.sign(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]), 3)
        _, at, of, n = np.unique(
            np.sort(ends, axis=1),
            axis=0,
            return_index=True,
            return_inverse=True,
            return_counts=True,
        )
        ends_here = at[(n == 1) | (np.abs(np.bincount(of.ravel(), weights=up)) < n)]
        a, b = first[ends_here, :2], second[ends_here, :2]
        middle, across = 0.5 * (a + b), _BESIDE * (b - a) @ np.array([[0.0, 1.0], [-1.0, 0.0]])
        empty = [np.isnan(self.height(*(middle + side * across).T)) for side in (1.0, -1.0)]
        x, y = middle[empty[0] | empty[1]].T
        return np.ascontiguousarray(x), np.ascontiguousarray(y)

    def slopes(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        _, facet = self._top(x, y)
        slopes = np.where(facet[..., None] >= 0, self.planes[facet], np.nan)
        return np.ascontiguousarray(slopes[..., 0]), np.ascontiguousarray(slopes[..., 1])

    def _derivatives(self, x: FloatArray, y: FloatArray, names: Sequence[str]) -> list[FloatArray]:
        return []


def from_triangles(vertices: ArrayLike) -> MeshForm:
    """Return a form whose height is the upper side of a mesh.

    Parameters
    ----------
    vertices : array_like, shape (n, 3, 3), m
        Triangle, corner, coordinate (x, y, z); z up out of the material. Corners in any order.

    Returns
    -------
    MeshForm
        Heights by linear interpolation in each facet, gradient constant in each.

    Raises
    ------
    DataError
        If the shape is not (n, 3, 3).
    TooFewSamplesError
        If there is no triangle, or all stand upright.
    InvalidSamplesError
        If a coordinate is not finite.

    Examples
    --------
    >>> form = from_triangles([[[0, 0, 0], [1, 0, 2], [0, 1, 4]]])
    >>> form(0.25, 0.25).item()
    1.5
    >>> [g.item() for g in form.gradient(0.25, 0.25)]
    [2.0, 4.0]
    """
    return MeshForm(np.asarray(vertices, dtype=np.float64))


def _checked(corners: FloatArray) -> FloatArray:
    if corners.ndim != 3 or corners.shape[1:] != (3, 3):
        raise DataError(
            f"a mesh has the shape (n, 3, 3): triangle, corner, coordinate; got {corners.shape}"
        )
    if corners.shape[0] == 0:
        raise TooFewSamplesError("the mesh has no triangle; export the part again, as a mesh")
    bad = np.flatnonzero(~np.isfinite(corners).all(axis=(1, 2)))
    if bad.size:
        raise InvalidSamplesError(
            f"triangle {bad[0]} has a coordinate that is not finite ({bad.size} such triangles)"
        )
    return corners


def _binned(
    flat: FloatArray,
) -> tuple[FloatArray, FloatArray, tuple[int, int], IntArray, IntArray]:
    """Return a search grid: corner, step, numbers, first entry of each bin, and the entries."""
    n = flat.shape[0]
    least, most = flat.min(axis=1), flat.max(axis=1)
    low, size = least.min(axis=0), np.ptp(flat.reshape(-1, 2), axis=0)
    across = float(np.sqrt(size[0] * size[1] / n))
    while True:
        nx, ny = (int(np.clip(s / across, 1, 4096)) for s in size)
        step = size / (nx, ny)
        # one millionth of a bin wider, so that rounding loses no triangle
        first = np.clip(((least - low) / step - 1e-6).astype(np.intp), 0, (nx - 1, ny - 1))
        last = np.clip(((most - low) / step + 1e-6).astype(np.intp), 0, (nx - 1, ny - 1))
        wide, high = (last - first + 1).T
        total = int((wide * high).sum())
        if total <= _ENTRIES * n or nx * ny == 1:
            break
        across *= 2.0
    member = np.repeat(np.arange(n), wide * high)
    within = np.arange(total) - np.repeat(np.cumsum(wide * high) - wide * high, wide * high)
    column = first[member, 0] + within % wide[member]
    row = first[member, 1] + within // wide[member]
    order = np.argsort(row * nx + column, kind="stable")
    counts = np.bincount(row * nx + column, minlength=nx * ny)
    return low, step, (nx, ny), np.concatenate([[0], np.cumsum(counts)]), member[order]


# ---- A form given as a height map, interpolated by a bicubic spline ----------------------------

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
        If it is not a surface, has no lateral calibration, or scale is not finite.
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
            raise DataError("the nominal map has no lateral calibration: give both steps")
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
        # Another one that shares the map and the spline.
        self._check_names(values)
        other = copy.copy(self)
        for name, value in values.items():
            object.__setattr__(other, name, checked(value, name))
        return other

    def holes(self) -> list[tuple[FloatArray, FloatArray]]:
        """Return the missing pixels that measured ones surround; without those that reach the border.

        Returns
        -------
        list of tuple of ndarray, m
            x and y of the pixels, hole by hole.
        """
        if self.valid.all():
            return []
        from scipy.ndimage import label

        # air lies around the map; pixels that meet at a corner leave no height between them either
        which, _ = label(np.pad(~self.valid, 1, constant_values=True), np.ones((3, 3)))
        row, column = np.nonzero((which != which[0, 0]) & (which > 0))
        x0, y0 = self.surface.origin
        x, y = (
            x0 + (column - 1) * float(self.surface.dx or 0),
            y0 + (row - 1) * float(self.surface.dy or 0),
        )
        of = which[row, column]
        return [(x[of == k], y[of == k]) for k in np.unique(of)]

    def start(self, x: FloatArray, y: FloatArray, z: FloatArray) -> Self:
        # By linear regression with piston and tilt over the points in the domain.
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

    def height(self, x: FloatArray, y: FloatArray) -> FloatArray:
        return self._known("scale")[0] * self._evaluate(x, y, 0, 0)

    def slopes(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
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
