"""Points of a measured map around the axis of the part."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray, as_float
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.core.middle import Axis, assumed_axis
from metrosep.core.surface import Surface
from metrosep.machine._mesh import SurfaceMesh, centred_form, checked_centre

__all__ = ["Measured", "measured_points"]


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """Heights at points of the part, and where they stood in what was given."""

    mesh: SurfaceMesh
    z: FloatArray
    place: NDArray[np.intp]
    shape: tuple[int, ...]
    n_given: int
    stride: int
    centre: tuple[float, float]
    notes: tuple[str, ...] = ()

    def on_map(self, values: FloatArray) -> FloatArray:
        """Return values of the points in the shape that was given, NaN elsewhere."""
        out = np.full(int(np.prod(self.shape)), np.nan)
        out[self.place] = values
        return out.reshape(self.shape)

    def on_thinned(self) -> tuple[NDArray[np.intp], tuple[int, int]] | None:
        """Return where the points stand in the flattened map that was kept, and its shape.

        None for scattered points: they have no neighbours.
        """
        if len(self.shape) != 2:
            return None
        rows, columns = (-(-s // self.stride) for s in self.shape)
        row, column = np.divmod(self.place, self.shape[1])
        return (row // self.stride) * columns + column // self.stride, (rows, columns)


def measured_points(
    source: Any,
    form: Any,
    *,
    radius: float | None,
    inner_radius: float,
    centre: tuple[float, float] | None,
    max_points: int,
) -> Measured:
    """Return the points that are measured, inside the radii and on the form; not the very centre."""
    x, y, z = _coordinates(source)
    centre, notes = _axis(source, form, centre)
    shape = z.shape
    stride = 1
    while np.prod([-(-s // stride) for s in shape]) > max(max_points, 1):
        stride += 1
    index = np.arange(z.size).reshape(shape)[(slice(None, None, stride),) * z.ndim].ravel()
    px, py, pz = (v.ravel()[index] for v in (x - centre[0], y - centre[1], z))
    nominal = centred_form(form, None)
    rho = np.hypot(px, py)
    inside = np.isfinite(pz) & (rho > max(float(inner_radius), 1e-12 * float(rho.max(initial=0))))
    n_given = int(np.isfinite(pz).sum())
    if radius is not None:
        if not (np.isfinite(radius) and radius > inner_radius >= 0.0):
            raise InvalidSamplesError(
                f"0 <= inner_radius < radius is needed in m, got {inner_radius} and {radius}"
            )
        inside &= rho <= radius
    height = np.full(px.shape, np.nan)
    height[inside] = nominal(px[inside], py[inside])
    slopes = [np.full(px.shape, np.nan) for _ in range(2)]
    for full, part in zip(slopes, nominal.gradient(px[inside], py[inside]), strict=True):
        full[inside] = part
    inside &= np.isfinite(height) & np.isfinite(slopes[0]) & np.isfinite(slopes[1])
    if not inside.any():
        raise TooFewSamplesError(
            "no measured point lies on the form inside the radii; check centre, radius and units (m)"
        )
    keep = np.flatnonzero(inside)
    at = [np.ascontiguousarray(v[keep]) for v in (px, py, height, *slopes)]
    mesh = SurfaceMesh(
        x=at[0],
        y=at[1],
        z=at[2],
        slope_x=at[3],
        slope_y=at[4],
        weights=np.full(keep.size, 1.0 / keep.size),
        index=keep,
        shape=(1, px.size),
        rho=np.array([float(rho[keep].max())]),
        azimuth=np.zeros(1),
        form=nominal,
    )
    return Measured(mesh, pz[keep], index[keep], shape, n_given, stride, centre, notes)


def _axis(source: Any, form: Any, centre: tuple[float, float] | None) -> Axis:
    """Return the given axis; of a map that of a nominal one of the same pixels, else its own."""
    if centre is not None or not isinstance(source, Surface):
        return Axis(checked_centre(centre))
    return assumed_axis(form if _on_same_grid(source, form) else source)


def _on_same_grid(source: Any, form: Any) -> bool:
    """Whether both are maps of the same pixels."""
    if not (isinstance(source, Surface) and isinstance(form, Surface)):
        return False
    return (source.shape, source.dx, source.dy, source.origin) == (
        form.shape,
        form.dx,
        form.dy,
        form.origin,
    )


def _coordinates(
    source: Any,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    if isinstance(source, Surface):
        if source.dx is None or source.dy is None:
            raise DataError(
                "the map has no lateral calibration (dx or dy is None): give both steps"
            )
        x = source.origin[0] + source.dx * np.arange(source.shape[1])
        y = source.origin[1] + source.dy * np.arange(source.shape[0])
        grid_x, grid_y = np.meshgrid(x, y)
        return grid_x, grid_y, source.z
    if not (isinstance(source, tuple | list) and len(source) == 3):
        raise DataError(f"the map is a Surface or a tuple (x, y, z), got {type(source).__name__}")
    try:
        x, y, z = (as_float(v) for v in source)
    except (TypeError, ValueError) as exc:
        raise InvalidSamplesError(f"x, y and z must be real numbers in m: {exc}") from None
    if not x.shape == y.shape == z.shape or z.ndim not in (1, 2):
        raise InvalidSamplesError(
            f"x, y and z must have one shape, got {x.shape}, {y.shape} and {z.shape}"
        )
    if not (np.isfinite(x).all() and np.isfinite(y).all()) or np.isinf(z).any():
        raise InvalidSamplesError("coordinates must be finite, heights finite or NaN")
    return x, y, z
