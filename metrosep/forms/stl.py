"""A form given as a mesh of triangles, such as the STL file of a designed part.

The height at a point is where a vertical ray from above meets the mesh first. Facets are flat: a
mesh deviates from a smooth design by up to ``edge^2 / (8 R)``, 1.25 um for edges of 1 mm and
R = 100 mm, and the gradient jumps from facet to facet. A height map (`GridForm`) or a formula is
better where it can be had.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray, IntArray
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.forms.base import Shape

__all__ = ["MeshForm", "from_triangles"]


_EDGE = 1e-9
"""A point this far outside an edge, as part of the triangle, is on it: no gaps between facets."""

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

    def _height(self, x: FloatArray, y: FloatArray) -> FloatArray:
        return self._top(x, y)[0]

    def _slopes(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
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
        raise TooFewSamplesError("the mesh has no triangle")
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
