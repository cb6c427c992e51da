"""The valid points of a profile, a map or a list, in blocks: a map never becomes a list of points."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray, Heights, frozen_float, position, same_length
from metrosep.core.errors import DataError, Example, InvalidSamplesError, TooFewSamplesError
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step, freeze_mapping
from metrosep.core.regions import assumed_axis
from metrosep.core.surface import Surface

_BLOCK = 1 << 14
"""Points in a block: its columns stay in the cache of a core."""

SAMPLE = 20_000
"""Points that find the place, or the trimmed start, before all points polish it."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PointSet(Heights):
    """Heights at scattered positions, such as the list of a coordinate measuring machine.

    Parameters
    ----------
    x, y : array_like, shape (n,), m
        Positions in any order; one may occur more than once.
    z : array_like, shape (n,), m
        Heights; NaN where not measured.
    metadata : mapping, optional
        What the file said.
    history : tuple of Step, optional
        Where it came from.

    Raises
    ------
    InvalidSamplesError
        If the lengths differ, or a position is not finite.
    TooFewSamplesError
        If there is no point.

    Examples
    --------
    >>> PointSet([0, 1e-3, 1e-3], [0, 0, 2e-3], [0, 1e-6, 2e-6])
    PointSet(3 points)
    """

    x: FloatArray
    y: FloatArray
    z: FloatArray
    metadata: Mapping[str, Any] = field(default_factory=dict)
    history: tuple[Step, ...] = ()

    def __init__(
        self,
        x: ArrayLike,
        y: ArrayLike,
        z: ArrayLike,
        *,
        metadata: Mapping[str, Any] | None = None,
        history: tuple[Step, ...] = (),
    ) -> None:
        arrays = {n: frozen_float(v, name=n, ndim=1) for n, v in (("x", x), ("y", y), ("z", z))}
        same_length(**arrays)
        for name in ("x", "y"):
            bad = np.flatnonzero(np.isnan(arrays[name]))
            if bad.size:
                raise InvalidSamplesError(
                    f"position {name} is NaN at point {int(bad[0])}; drop the point"
                )
        for name, array in arrays.items():
            object.__setattr__(self, name, array)
        object.__setattr__(self, "metadata", freeze_mapping(metadata))
        object.__setattr__(self, "history", tuple(history))

    def __repr__(self) -> str:
        return f"PointSet({self.z.size} points)"


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """Positions and heights of a measurement, from an assumed centre."""

    # shape (n_x,) and (n_y,), m: positions of columns and rows from the centre; one row for a
    # profile. With scattered points both have one value per point
    x: FloatArray
    y: FloatArray
    # shape (n_y, n_x), m: heights; NaN where not measured. One row of scattered points
    z: FloatArray
    centre: tuple[float, float]  # of (float, float), m: in the coordinates of the object
    # whether positions are those of single points, not of rows and columns
    is_scattered: bool = False
    notes: tuple[str, ...] = ()  # where the centre was taken, if nothing but the data says so
    _counted: list[int] = field(default_factory=list, init=False, repr=False)

    @property
    def n_valid(self) -> int:
        """Number of points that were measured; counted when first asked for."""
        if not self._counted:
            self._counted.append(
                sum(int(np.count_nonzero(part == part)) for part in self._parts())
            )
        return self._counted[0]

    @property
    def is_empty(self) -> bool:
        """Whether nothing was measured."""
        return not any(bool((part == part).any()) for part in self._parts())

    def _parts(self) -> Iterator[FloatArray]:
        """Yield the heights in parts that stay in the cache; NaN differs from itself."""
        for rows in self.rows():
            for columns in self.columns():
                yield self.z[rows, columns]

    @property
    def largest(self) -> float:
        """Largest magnitude of the heights, m."""
        low, high = (float(f.reduce(self.z, axis=None)) for f in (np.fmin, np.fmax))
        return max(abs(low), abs(high))

    @property
    def is_uniform(self) -> bool:
        """Whether columns, and rows if there are several, stand at equal steps, to 1e-6."""
        if self.is_scattered or self.x.size < 2:
            return False
        axes = (self.x, self.y) if self.y.size > 1 else (self.x,)
        steps = [np.diff(axis) for axis in axes]
        return all(bool(np.ptp(s) <= 1e-6 * abs(float(s.mean()))) for s in steps)

    def rows(self) -> Iterator[slice]:
        """Yield slices of whole rows, about 16 000 points each."""
        step, rows = max(1, _BLOCK // self.x.size), self.z.shape[0]
        for start in range(0, rows, step):
            yield slice(start, min(start + step, rows))

    def columns(self) -> Iterator[slice]:
        """Yield slices of columns: a profile is one row and is cut along x."""
        step = self.x.size if self.z.shape[0] > 1 else _BLOCK
        for start in range(0, self.x.size, step):
            yield slice(start, min(start + step, self.x.size))

    def blocks(self) -> Iterator[tuple[slice, slice, FloatArray, FloatArray, FloatArray]]:
        """Yield rows, columns, x, y and z of each block, the arrays two-dimensional."""
        for rows in self.rows():
            for columns in self.columns():
                x = np.broadcast_to(
                    self.x[columns], (rows.stop - rows.start, self.x[columns].size)
                )
                y = self.y[None, columns]
                if not self.is_scattered:
                    y = np.broadcast_to(self.y[rows, None], x.shape)
                yield rows, columns, x, y, self.z[rows, columns]

    def over_blocks(
        self, of: Callable[[FloatArray, FloatArray, FloatArray], FloatArray]
    ) -> FloatArray:
        """Return a function of all points, block by block."""
        values = np.empty(self.z.shape)
        for rows, columns, x, y, z in self.blocks():
            values[rows, columns] = of(x, y, z)
        return values

    def valid_blocks(self) -> Iterator[tuple[FloatArray, FloatArray, FloatArray]]:
        """Yield x, y and z of the valid points of each block, one-dimensional."""
        for _, _, x, y, z in self.blocks():
            bad = np.isnan(z)
            if bad.any():
                good = ~bad
                yield x[good], y[good], z[good]
            else:
                yield x.ravel(), y.ravel(), z.ravel()

    def sample(self, n: int = SAMPLE) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return all valid points, or about `n` of them drawn at random with a fixed seed."""
        total = self.n_valid
        if total <= n:
            parts = list(self.valid_blocks())
            return (
                np.concatenate([p[0] for p in parts]),
                np.concatenate([p[1] for p in parts]),
                np.concatenate([p[2] for p in parts]),
            )
        rng = np.random.default_rng(20080415)
        flat = rng.integers(0, self.z.size, size=int(n * self.z.size / total) + 1)
        flat.sort()
        flat = flat[np.flatnonzero(np.diff(flat, prepend=-1))]  # each once
        row, column = np.unravel_index(flat, self.z.shape)
        z = self.z[row, column]
        good = ~np.isnan(z)
        y = self.y[column[good]] if self.is_scattered else self.y[row[good]]
        return self.x[column[good]], y, z[good]

    @property
    def radius(self) -> float:
        """Half the larger extent, m."""
        return float(max(np.ptp(self.x), np.ptp(self.y)) / 2.0)


def require_scale(surface: Surface) -> tuple[float, float]:
    """Return both lateral steps of a map that a form is fitted to, m; refuse a map without."""
    if surface.dx is None or surface.dy is None:
        raise DataError(
            "the surface has no lateral calibration, and a form needs one: read the file with "
            "lateral_step=...; only a plane or a polynomial can be taken off without one"
        ).hinting(lateral_step=Example("3 um"))
    return surface.dx, surface.dy


def points_of(
    obj: Surface | Profile | PointSet, *, centre: tuple[float, float] | None, middle: bool
) -> Points:
    """Return the points of an object, measured from a centre."""
    centre = None if centre is None else position(centre, "centre")
    if isinstance(obj, Profile):
        obj.require_metres()
        x0 = 0.0 if centre is None else float(centre[0])
        points = Points(obj.x - x0, np.zeros(1), obj.z[None, :], (x0, 0.0))
    elif isinstance(obj, Surface):
        dx, dy = require_scale(obj)
        rows, columns = obj.shape
        x: FloatArray = obj.origin[0] + dx * np.arange(columns, dtype=np.float64)
        y: FloatArray = obj.origin[1] + dy * np.arange(rows, dtype=np.float64)
        if centre is None and middle:
            (x0, y0), notes = assumed_axis(obj)
        else:
            (x0, y0), notes = centre or (0.0, 0.0), ()
        points = Points(x - x0, y - y0, obj.z, (x0, y0), notes=notes)
    elif isinstance(obj, PointSet):
        x0, y0 = (0.0, 0.0) if centre is None else (float(centre[0]), float(centre[1]))
        points = Points(obj.x - x0, obj.y - y0, obj.z[None, :], (x0, y0), is_scattered=True)
    else:
        raise DataError(
            f"a form is fitted to a Surface, a Profile or a PointSet, got {type(obj).__name__}"
        )
    if points.is_empty:
        raise TooFewSamplesError("no sample was measured (all are NaN): nothing can be fitted")
    return points
