"""Flatness of a surface: minimum zone and least squares.

The reference is a plane through the valid pixels; the deviation is measured along z and positive
out of the material. Measured at right angles to the plane it is smaller by half the square of the
slope, relative: level a strongly tilted part before. The minimum zone of a map of 1e6 pixels rests
on four of them.
"""

from __future__ import annotations

import math

import numpy as np

from metrosep.core._arrays import FloatArray, IntArray
from metrosep.core.errors import DataError, DegenerateFitError, TooFewSamplesError
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.core.surface import Surface
from metrosep.parameters.form_result import FormDeviation, Reference, Support, form_table
from metrosep.parameters.minimum_zone import Optimum, optimum

__all__ = ["flatness_deviation"]


_FREEDOMS = 3
"""Height and two slopes."""

_BLOCK = 1 << 17
"""Pixels in a block of rows: 1 MB stays in the cache."""

_COLLINEAR = 1e-12
"""Smallest determinant of the position matrix, relative, of pixels that span a plane."""


def flatness_deviation(surface: Surface, *, reference: Reference = "MZ") -> FormDeviation:
    """Return the flatness deviation FLTt of a surface.

    Notes
    -----
    The minimum zone is exact. It touches four points, 3 on one side and 1 on the other or 2 and 2,
    or fewer in special positions. Seen along z, the triangle holds the single point, or the two
    segments cross: with the weights of the support both sides have the same centre of gravity, and
    their mean heights differ by the width. No plane can bring the two closer together, so the
    support proves the zone. NaN is excluded and counted. No filter is applied. O(n).

    References
    ----------
    .. [1] ISO 12781-1:2011 (parameters), ISO 1101:2017 (default reference).

    Examples
    --------
    >>> saddle = Surface([[1e-6, 0.0], [0.0, 1e-6]], dx=1e-3, dy=1e-3)
    >>> zone = flatness_deviation(saddle)
    >>> round(zone.value * 1e6, 6), zone.support.sides.tolist(), zone.is_optimal
    (1.0, [1, 1, -1, -1], True)
    """
    if reference not in ("MZ", "LS"):
        raise DataError(f"flatness has the references MZ and LS, not {reference!r}")
    grid = _Grid(surface)
    plane = grid.least_squares()
    bound = objective = math.nan
    local = grid.residual(plane)
    held: tuple[IntArray, IntArray, FloatArray]
    scale = float(np.fmax.reduce(np.abs(local), axis=None))
    if reference == "MZ" and scale > 0.0:
        found = _zone(grid, plane, scale)
        plane, bound = found.coefficients, found.bound
        local = grid.residual(plane)
        top, bottom = _range(local)
        plane[0] += 0.5 * (top + bottom)
        local -= 0.5 * (top + bottom)
        objective = top - bottom
        held = (found.indices, found.sides, found.weights)
    else:
        ends = np.array([np.nanargmax(local), np.nanargmin(local)], dtype=np.intp)
        held = (ends, np.array([1, -1], dtype=np.intp), np.array([1.0, 1.0]))
        if reference == "MZ":
            bound = objective = 0.0
    parameters = grid.parameters(plane, reference)
    step = Step("flatness", {"reference": reference, "width": "vertical"})
    return FormDeviation(
        kind="flatness",
        reference=reference,
        table=form_table(
            "flatness",
            reference,
            local[~np.isnan(local)],
            n_total=int(local.size),
            history=surface.history,
            settings={"width": "vertical"},
            notes=grid.notes(parameters),
        ),
        reference_parameters=parameters,
        residual=Surface(
            local,
            surface.dx,
            surface.dy,
            origin=surface.origin,
            metadata=surface.metadata,
            history=(*surface.history, step),
        ),
        support=grid.support(held),
        objective=objective,
        bound=bound,
    )


class _Grid:
    """The valid pixels in coordinates -1 ... 1, row by row."""

    def __init__(self, surface: Surface) -> None:
        self.surface = surface
        self.z = surface.z
        rows, columns = surface.shape
        self.valid = ~np.isnan(self.z)
        self.n_valid = int(self.valid.sum())
        if self.n_valid <= _FREEDOMS:
            raise TooFewSamplesError(
                f"flatness needs 4 valid pixels, got {self.n_valid} of {self.z.size}: three "
                "points always lie on a plane; measure more points"
            )
        self.half = (max(0.5 * (columns - 1), 0.5), max(0.5 * (rows - 1), 0.5))
        self.t = np.arange(columns) / self.half[0] - (1.0 if columns > 1 else 0.0)
        self.s = np.arange(rows) / self.half[1] - (1.0 if rows > 1 else 0.0)
        self.has_gaps = self.n_valid < self.z.size
        self.rows_in_block = max(1, _BLOCK // max(columns, 1))

    def least_squares(self) -> FloatArray:
        """Return height and slopes of the least-squares plane by moments of whole rows."""
        weight = self.valid.astype(np.float64) if self.has_gaps else np.ones(self.z.shape)
        z = np.where(self.valid, self.z, 0.0) if self.has_gaps else self.z
        in_row, in_column = weight.sum(axis=1), weight.sum(axis=0)
        t, s, n = self.t, self.s, float(self.n_valid)
        middle = (float(in_column @ t) / n, float(in_row @ s) / n)
        dt, ds = t - middle[0], s - middle[1]
        tt, ss = float(in_column @ dt**2), float(in_row @ ds**2)
        ts = float(ds @ (weight @ dt))
        determinant = tt * ss - ts * ts
        if determinant <= _COLLINEAR * n * n:
            raise DegenerateFitError(
                f"all {self.n_valid} valid pixels lie on one line: they do not define a plane; "
                "measure an area, or take a profile and its straightness"
            )
        mean = float(z.sum()) / n
        z0 = weight * (z - mean) if self.has_gaps else z - mean
        zt, zs = float(z0.sum(axis=0) @ dt), float(z0.sum(axis=1) @ ds)
        b = (ss * zt - ts * zs) / determinant
        c = (tt * zs - ts * zt) / determinant
        return np.array([mean - b * middle[0] - c * middle[1], b, c])

    def residual(self, plane: FloatArray) -> FloatArray:
        """Return z minus the plane, NaN where not measured."""
        return self._part(plane, slice(None))

    def _part(self, plane: FloatArray, rows: slice) -> FloatArray:
        left: FloatArray = self.z[rows] - (plane[0] + plane[2] * self.s[rows])[:, None]
        left -= plane[1] * self.t
        return left

    def extremes(self, plane: FloatArray) -> IntArray:
        """Return flat indices of the highest and lowest pixels, of each block of rows."""
        rows, columns = self.z.shape
        found: list[int] = []
        for start in range(0, rows, self.rows_in_block):
            part = slice(start, min(start + self.rows_in_block, rows))
            left = self._part(plane, part)
            if self.has_gaps:
                if not self.valid[part].any():
                    continue
                ends = (int(np.nanargmax(left)), int(np.nanargmin(left)))
            else:
                ends = (int(left.argmax()), int(left.argmin()))
            found += [start * columns + k for k in ends]
        return np.array(found, dtype=np.intp)

    def basis(self, indices: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return the rows (1, t, s) and the heights of some pixels."""
        j, i = np.unravel_index(indices, self.z.shape)
        return np.column_stack([np.ones(indices.size), self.t[i], self.s[j]]), self.z[j, i]

    def parameters(self, plane: FloatArray, reference: str) -> dict[str, Quantity]:
        """Return slopes and intercept at x = y = 0, or at pixel 0 where not calibrated."""
        values, slopes = float(plane[0]), {}
        axes = zip(
            "xy", (self.surface.dx, self.surface.dy), self.surface.origin, self.half, strict=True
        )
        for k, (axis, step, origin, half) in enumerate(axes, start=1):
            per_pixel = float(plane[k]) / half
            first = -1.0 if self.z.shape[2 - k] > 1 else 0.0
            values += float(plane[k]) * first
            if step is None:
                text = f"slope of the {reference} plane along {axis} per pixel, not calibrated"
                slopes[f"slope_{axis}"] = Quantity(per_pixel, "m", text)
                continue
            text = f"slope dz/d{axis} of the {reference} plane"
            slopes[f"slope_{axis}"] = Quantity(per_pixel / step, "1", text)
            values -= per_pixel / step * origin
        text = f"height of the {reference} plane at x = y = 0 (pixel 0 where not calibrated)"
        return {**slopes, "intercept": Quantity(values, "m", text)}

    def notes(self, parameters: dict[str, Quantity]) -> list[str]:
        """Return what the direction of the deviations means."""
        slopes = [q for k, q in parameters.items() if k.startswith("slope")]
        if any(q.unit != "1" for q in slopes):
            return ["lateral steps are not calibrated: deviations along z, slopes per pixel"]
        square = sum(q.value**2 for q in slopes)
        root = math.sqrt(1.0 + square)
        relative = square / (root * (1.0 + root))
        where = "deviations along z; at right angles to the plane they are"
        return [f"{where} {relative:.2g} smaller, relative"]

    def support(self, held: tuple[IntArray, IntArray, FloatArray]) -> Support:
        """Return the support with rows, columns and positions."""
        at, sides, weights = held
        j, i = np.unravel_index(at, self.z.shape)
        step_x, step_y = self.surface.dx, self.surface.dy
        x = i.astype(np.float64) if step_x is None else self.surface.origin[0] + step_x * i
        y = j.astype(np.float64) if step_y is None else self.surface.origin[1] + step_y * j
        return Support(
            np.column_stack([j, i]), np.column_stack([x, y]), self.z[j, i], sides, weights
        )


def _zone(grid: _Grid, plane: FloatArray, scale: float) -> Optimum:
    """Return the minimum zone, started from the extremes of the least-squares residual."""
    flat = np.flatnonzero(grid.valid.ravel()) if grid.has_gaps else np.arange(grid.z.size)
    seed = np.concatenate([grid.extremes(plane), flat[_spread(flat.size)]])
    return optimum(grid.basis, grid.extremes, seed, mode="zone", start=plane, scale=scale)


def _spread(n: int) -> IntArray:
    """Return about 20 positions out of n."""
    return np.unique(np.linspace(0, n - 1, min(n, 20)).astype(np.intp))


def _range(values: FloatArray) -> tuple[float, float]:
    return float(np.fmax.reduce(values, axis=None)), float(np.fmin.reduce(values, axis=None))
