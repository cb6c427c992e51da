"""Probes in a row on one carriage: geometry, checks, and the rows in which the carriage cancels.

Probe j reads ``m_j(i) = f(x_i + o_j) + z_i + o_j t_i + e_j``: artefact f, straightness z and pitch t
of the carriage at x_i, zero e_j of the probe. All count positive where they raise the reading.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotUniformError,
    TooFewSamplesError,
    UnitError,
)
from metrosep.core.numbers import positive
from metrosep.core.units import format_length

if TYPE_CHECKING:
    from scipy.sparse import csr_array


GRID_RTOL = 1e-3
"""Steps of a slide scatter: an offset within this share of a step is a multiple of it, and so are
positions within it equidistant."""

RATIO_RTOL = 1e-6
"""The ratios of offsets must be whole within this share of a step. Between distances that differ a
tilt of the artefact reads like a zero error: 10 and 10.01 mm under 100 urad are 1 nm."""

MAX_POSITIONS = 4000
"""The full covariance is a dense matrix; more positions than this are refused."""


@dataclass(frozen=True, slots=True)
class Row:
    """Probes in a row."""

    offsets: tuple[float, ...]  # m: where the probes sit along the carriage, rising
    # m: spacing of the artefact grid and, unless positions are given, of the carriage positions
    step: float
    pitch: bool  # whether the pitch of the carriage is a free unknown at each position
    zero_known: bool = False  # whether the readings are already without the zeros of the probes

    @property
    def shifts(self) -> tuple[int, ...] | None:
        """Offsets from the first probe in steps; None where one is not a multiple of the step."""
        ratio = (np.array(self.offsets) - self.offsets[0]) / self.step
        whole = np.round(ratio)
        if np.abs(ratio - whole).max() > GRID_RTOL or whole[-1] < 1.0:
            return None
        if np.abs(ratio - whole * (ratio[-1] / whole[-1])).max() > RATIO_RTOL:
            return None
        return tuple(int(v) for v in whole)

    @property
    def span(self) -> int:
        """Steps of the artefact grid that the row of probes covers, rounded up."""
        ratio = (self.offsets[-1] - self.offsets[0]) / self.step
        return math.ceil(ratio - GRID_RTOL)

    @property
    def grid_period(self) -> int:
        """Largest number of steps that divides all spacings; 0 where they are not multiples."""
        shifts = self.shifts
        return 0 if shifts is None else math.gcd(*shifts)

    @property
    def weights(self) -> FloatArray:
        """Return the combination of readings that cancels the carriage, normalised to spec form.

        For two probes ``m2 - m1``, for three ``m1 - (1 + d1/d2) m2 + (d1/d2) m3``.
        """
        o = np.array(self.offsets)
        if not self.pitch:
            return np.array([-1.0, 1.0])
        r = float(o[1] - o[0]) / float(o[2] - o[1])
        return np.array([1.0, -(1.0 + r), r])


def checked_row(
    offsets: ArrayLike, step: float | None, *, what: str, pitch: bool, zero_known: bool = False
) -> Row:
    """Return the row of probes, or refuse it."""
    try:
        o = np.array(offsets, dtype=np.float64).ravel()
    except (TypeError, ValueError):
        raise DataError(f"{what}: the distances of the probes must be numbers in m") from None
    if o.size < 2 or not np.isfinite(o).all() or (np.diff(o) <= 0.0).any():
        raise DataError(
            f"{what}: probes must sit at rising, finite offsets in m (distances above zero), got "
            f"{o.tolist()}; order the readings from the trailing to the leading probe (rising x)"
        )
    step = positive(step, f"{what}: the step between carriage positions", dimension="length")
    if float(np.ptp(o)) > 100.0:
        raise UnitError(
            f"{what}: the probes span {float(np.ptp(o)):g} m; distances are given in m, not in mm"
        )
    if float(np.ptp(o)) < step * (1.0 - GRID_RTOL):
        raise DataError(
            f"{what}: the probes span {format_length(float(np.ptp(o)))}, less than the step of "
            f"{format_length(step)}: no place is read by two probes; move in steps of at most "
            "the distance of the probes"
        )
    return Row(tuple(o.tolist()), step, pitch, zero_known)


def positions(x: ArrayLike | None, step: float | None, n: int, what: str) -> FloatArray:
    """Return n rising carriage positions, of equal steps where only the step is known."""
    if x is None:
        if step is None:
            raise DataError(f"{what} needs the positions x or the step between them, in m")
        return np.arange(n, dtype=np.float64) * float(step)
    try:
        at = np.array(x, dtype=np.float64)
    except (TypeError, ValueError):
        raise InvalidSamplesError(f"{what}: positions x must be numbers in m") from None
    if at.shape != (n,):
        raise InvalidSamplesError(f"{what}: {at.size} positions x for {n} readings of each probe")
    if not np.isfinite(at).all() or (np.diff(at) <= 0.0).any():
        raise InvalidSamplesError(
            f"{what}: positions x must be finite and rise; for a run in -x turn round x and all "
            "readings together"
        )
    return at


def uniform_step(x: FloatArray, what: str) -> float:
    """Return the one step of positions, or refuse them."""
    if x.size < 2:
        raise TooFewSamplesError(f"{what} needs at least 2 positions, got {x.size}")
    step = float(x[-1] - x[0]) / (x.size - 1)
    worst = float(np.abs(np.diff(x) - step).max())
    if worst > GRID_RTOL * step:
        raise NotUniformError(
            f"{what}: the steps between positions differ by up to {format_length(worst)} from "
            f"{format_length(step)}; use method='least_squares' with a step, or resample"
        )
    return step


def grid_of(row: Row, x: FloatArray) -> FloatArray:
    """Return the positions of the artefact that the probes reach, a multiple of steps apart."""
    start = x[0] + row.offsets[0]
    reach = float(x[-1] - x[0] + row.offsets[-1] - row.offsets[0]) / row.step
    return np.asarray(start + row.step * np.arange(math.ceil(reach - 1e-3) + 1))


def interpolation(grid: FloatArray, at: FloatArray) -> csr_array:
    """Return the matrix that takes values on a uniform grid to values at other positions.

    Exact selection where the positions lie on the grid, else the interpolating spline of degree
    5 (of the highest degree that few samples allow).
    """
    from scipy.interpolate import make_interp_spline
    from scipy.sparse import csr_array

    step = (grid[-1] - grid[0]) / (grid.size - 1)
    index = (at - grid[0]) / step
    near = np.round(index).astype(np.intp)
    if np.abs(index - near).max() <= RATIO_RTOL:
        ones = np.ones(at.size)
        return csr_array((ones, (np.arange(at.size), near)), shape=(at.size, grid.size))
    degree = max(d for d in (1, 3, 5) if d < grid.size)
    spline = make_interp_spline(np.arange(grid.size), np.eye(grid.size), k=degree)
    dense = np.array(spline(np.clip(index, 0.0, grid.size - 1.0)))
    dense[np.abs(dense) < 1e-15] = 0.0
    return csr_array(dense)


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Whitened combinations of readings in which the carriage has cancelled."""

    # sparse array, shape (n_rows, n_sensors n_stations): orthonormal rows; readings in units of
    # their standard deviations go in
    weights: Any
    # shape (n_sensors, n_stations): standard deviations that whitened them, relative to that of a
    # probe
    sd: FloatArray

    def of(self, readings: FloatArray) -> FloatArray:
        """Return the combinations of readings, shape (n_sensors, n_stations)."""
        clean = np.where(np.isnan(readings), 0.0, readings) / self.sd
        return np.asarray(self.weights @ clean.ravel())

    @property
    def touched(self) -> NDArray[np.bool_]:
        """Which reading takes part in a row, shape (n_sensors, n_stations)."""
        columns = np.zeros(self.sd.size, dtype=bool)
        columns[self.weights.indices[self.weights.data != 0.0]] = True
        return columns.reshape(self.sd.shape)


def rows_without_carriage(valid: NDArray[np.bool_], nuisance: FloatArray, sd: FloatArray) -> Rows:
    """Return the combinations of the valid readings at each station that do not see the carriage."""
    from scipy.sparse import csr_array

    n_sensors, n = valid.shape
    kind, group = kinds_of(valid, sd)
    found = [complement(nuisance, sd[:, i], valid[:, i]) for i in kind]
    count = np.array([q.shape[0] for q in found], dtype=np.intp)[group] if n else np.empty(0, int)
    first = np.concatenate([[0], np.cumsum(count)]).astype(np.intp)
    r_index: list[NDArray[np.intp]] = []
    c_index: list[NDArray[np.intp]] = []
    data: list[FloatArray] = []
    for g, q in enumerate(found):
        at = np.flatnonzero(group == g)
        for k in range(q.shape[0]):
            for s in np.flatnonzero(q[k]):
                r_index.append(first[at] + k)
                c_index.append(s * n + at)
                data.append(np.full(at.size, q[k, s]))
    shape = (int(first[-1]), n_sensors * n)
    if not data:
        return Rows(csr_array(shape), sd)
    parts = (np.concatenate(data), (np.concatenate(r_index), np.concatenate(c_index)))
    return Rows(csr_array(parts, shape=shape), sd)


def kinds_of(
    valid: NDArray[np.bool_], sd: FloatArray
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return one station of each kind (same sensors, same weights), and the kind of each."""
    both = np.vstack([valid, np.where(valid, sd, 0.0)]).T
    _, kind, group = np.unique(both, axis=0, return_index=True, return_inverse=True)
    return kind, group.ravel()


def complement(nuisance: FloatArray, sd: FloatArray, used: NDArray[np.bool_]) -> FloatArray:
    """Return orthonormal rows over the sensors in use that are orthogonal to the nuisance."""
    n = nuisance.shape[0]
    if not used.any():
        return np.empty((0, n))
    scaled = nuisance[used] / sd[used, None]
    left, size, _ = np.linalg.svd(scaled, full_matrices=True)
    rank = int((size > 1e-12 * max(float(size.max()), 1e-300)).sum())
    out = np.zeros((int(used.sum()) - rank, n))
    out[:, used] = left[:, rank:].T
    return out
