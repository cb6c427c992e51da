"""Private: points of a measured map around the axis of the part, and the noise of what a fit leaves."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray, as_float
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.core.regions import Axis, assumed_axis
from metrosep.core.surface import Surface
from metrosep.machine._mesh import SurfaceMesh, centred_form, checked_centre, checked_radii


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
    outer, inner = checked_radii(1e300 if radius is None else radius, inner_radius)
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
    inside = np.isfinite(pz) & (rho > max(inner, 1e-12 * float(rho.max(initial=0))))
    n_given = int(np.isfinite(pz).sum())
    inside &= rho <= outer
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
    x, y, height, along, across = (
        np.ascontiguousarray(v[keep]) for v in (px, py, height, *slopes)
    )
    weights = np.full(keep.size, 1.0 / keep.size)
    furthest = np.array([float(rho[keep].max())])
    mesh = SurfaceMesh(
        x, y, height, along, across, weights, keep, (1, px.size), furthest, np.zeros(1), nominal
    )
    return Measured(mesh, pz[keep], index[keep], shape, n_given, stride, centre, notes)


def _axis(source: Any, form: Any, centre: tuple[float, float] | None) -> Axis:
    """Return the given axis; of a map that of a nominal one of the same pixels, else its own."""
    if centre is not None or not isinstance(source, Surface):
        return Axis(checked_centre(centre))
    same = isinstance(form, Surface) and all(
        getattr(source, n) == getattr(form, n) for n in ("shape", "dx", "dy", "origin")
    )
    return assumed_axis(form if same else source)


def _coordinates(source: Any) -> tuple[FloatArray, FloatArray, FloatArray]:
    if isinstance(source, Surface):
        if source.dx is None or source.dy is None:
            raise DataError("the map has no lateral calibration: give both steps")
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


# ---- what the residual of a fit to a map says about its noise: how alike points are over distance --
# The covariance of two points depends on their distance in pixels only: a sum of bells of growing
# width and of white noise, with weights that are not negative. They are fitted to the sums of products
# of the residual over distance; what the fit itself took out of the noise is accounted for.

_FEWEST = 60
"""Points that a model of their likeness needs."""

_SURE = 6.0
"""Drop of chi square that a further bell must bring."""

_STEP = 1.8
"""From the width of one bell to the next; the first is 0.7 px."""

_WIDEST = 0.3
"""Of the shorter side of the map: wider bells would be tilt and bow."""


@dataclass(frozen=True, slots=True, eq=False)
class _Grid:
    """Points in a flattened map, and a padded one on which transforms do not wrap."""

    place: NDArray[np.intp]
    shape: tuple[int, int]
    size: tuple[int, int] = field(init=False)

    def __post_init__(self) -> None:
        from scipy.fft import next_fast_len

        size = tuple(int(next_fast_len(2 * s, real=True)) for s in self.shape)
        object.__setattr__(self, "size", size)

    def waves(self, rows: FloatArray) -> NDArray[np.complex128]:
        """Return the transforms (m, ...) of rows (n, m), zero where no point is."""
        from scipy.fft import rfft2

        maps = np.zeros((rows.shape[1], self.shape[0] * self.shape[1]))
        maps[:, self.place] = rows.T
        return np.asarray(rfft2(maps.reshape(-1, *self.shape), s=self.size))

    def back(self, waves: NDArray[Any]) -> FloatArray:
        """Return the padded maps of transforms."""
        from scipy.fft import irfft2

        return np.asarray(irfft2(waves, s=self.size))

    def distances(self) -> tuple[FloatArray, FloatArray]:
        """Return the lags of the padded map along y and x in pixels."""
        y, x = (np.minimum(np.arange(s), s - np.arange(s)).astype(float) for s in self.size)
        return y, x

    def bell(self, width: float) -> FloatArray:
        """Return the transform of a bell of unit height: white noise after a Gaussian filter."""
        from scipy.fft import fft, rfft

        if width == 0.0:
            return np.ones((self.size[0], self.size[1] // 2 + 1))
        a, b = (np.exp(-((d / (2.0 * width)) ** 2)) for d in self.distances())
        return np.asarray(np.real(fft(a))[:, None] * np.real(rfft(b)))

    def quadratic(self, waves: NDArray[np.complex128], kernel: FloatArray) -> FloatArray:
        """Return the products of all pairs of maps, one of them blurred by the kernel."""
        weight = np.full(kernel.shape[1], 2.0)
        weight[0] = 1.0
        if self.size[1] % 2 == 0:
            weight[-1] = 1.0
        flat = waves.reshape(waves.shape[0], -1)
        both = np.real((flat.conj() * (kernel * weight).ravel()) @ flat.T)
        return np.asarray(0.5 * (both + both.T) / (self.size[0] * self.size[1]))


@dataclass(frozen=True, slots=True, eq=False)
class MapNoise:
    """A covariance over distance: variances of bells of widths in pixels, width 0 being white."""

    widths: tuple[float, ...]
    variances: tuple[float, ...]
    grid: _Grid

    def covariance(self, rows: FloatArray) -> FloatArray:
        """Return ``rows.T @ Gamma @ rows`` for rows (n, m) that hold a number for each point."""
        total = np.zeros((rows.shape[1], rows.shape[1]))
        waves = self.grid.waves(rows)
        for width, variance in zip(self.widths, self.variances, strict=True):
            if variance > 0.0:
                total += variance * self.grid.quadratic(waves, self.grid.bell(width))
        return total


def map_noise(
    residual: FloatArray, basis: FloatArray, place: NDArray[np.intp], shape: tuple[int, int]
) -> MapNoise:
    """Return the noise that left a residual (n,) after a fit of orthonormal columns (n, k).

    `place` says where the points stand in the flattened map of `shape`.
    """
    n, k = basis.shape
    grid = _Grid(place, shape)
    white = float(residual @ residual) / max(n - k, 1)
    if n < _FEWEST or not white > 0.0:
        return MapNoise((0.0,), (white,), grid)
    pairs = np.rint(grid.back(np.abs(grid.waves(np.ones((n, 1)))[0]) ** 2))
    bins = _bins(grid, pairs)
    own = grid.waves(residual[:, None] / np.sqrt(white))[0]
    seen = _summed(grid.back(np.abs(own) ** 2), bins)
    # of white noise; both lags of a pair hold the same product
    sd = np.sqrt(2.0 * np.maximum(_summed(pairs, bins), 1.0))
    q_waves = grid.waves(basis)
    widths = (0.0, *_ladder(shape))
    columns = [_expected(grid, w, basis, q_waves, pairs) for w in widths]
    scaled = np.column_stack([_summed(c, bins) / sd for c in columns])
    variances = _chosen(scaled, seen / sd)
    return MapNoise(widths, tuple(float(v) * white for v in variances), grid)


def _ladder(shape: tuple[int, int]) -> list[float]:
    widest = _WIDEST * min(s for s in shape if s > 1)
    widths = [0.7]
    while widths[-1] * _STEP <= widest:
        widths.append(widths[-1] * _STEP)
    return widths


def _bins(grid: _Grid, pairs: FloatArray) -> NDArray[np.intp]:
    """Return the bin of each lag by its distance; -1 beyond half of the shorter side."""
    y, x = grid.distances()
    far = np.hypot(y[:, None], x)
    top = 0.5 * min(s for s in grid.shape if s > 1)
    edges = [0.5, 1.2]
    while edges[-1] < top:
        edges.append(max(edges[-1] + 0.5, edges[-1] * 1.15))
    which = np.digitize(far, edges)
    return np.asarray(np.where((pairs > 0) & (which < len(edges)), which, -1))


def _summed(values: FloatArray, bins: NDArray[np.intp]) -> FloatArray:
    used = bins >= 0
    return np.asarray(np.bincount(bins[used], weights=values[used]), dtype=np.float64)


def _expected(
    grid: _Grid,
    width: float,
    basis: FloatArray,
    q_waves: NDArray[np.complex128],
    pairs: FloatArray,
) -> FloatArray:
    """Return the sums over lags that noise of one bell leaves after the fit.

    Of M Gamma M with M = 1 - Q Q': Gamma - Q D' - D Q' + Q G Q', D = Gamma Q, G = Q' D.
    """
    kernel = grid.bell(width)
    sums = pairs * grid.back(kernel)
    moved = grid.back(q_waves * kernel)[:, : grid.shape[0], : grid.shape[1]]
    d = moved.reshape(basis.shape[1], -1)[:, grid.place].T
    mixed = np.tensordot(basis.T @ d, q_waves, axes=1)
    both = np.sum(q_waves.conj() * (mixed - 2.0 * grid.waves(d)), axis=0)
    return np.asarray(sums + grid.back(np.real(both)))


def _chosen(columns: FloatArray, seen: FloatArray) -> FloatArray:
    """Return the fewest weights that explain the sums: white noise, then bell after bell."""
    from scipy.optimize import nnls

    used = [0]
    weights, rest = nnls(columns[:, used], seen)
    while len(used) < columns.shape[1]:
        trials = []
        for j in range(columns.shape[1]):
            if j not in used:
                found, left = nnls(columns[:, [*used, j]], seen)
                trials.append((left, j, found))
        left, j, found = min(trials, key=lambda t: t[0])
        if rest**2 - left**2 < _SURE:
            break
        used, weights, rest = [*used, j], found, left
    result = np.zeros(columns.shape[1])
    result[used] = weights
    return result
