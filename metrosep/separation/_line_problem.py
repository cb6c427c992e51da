"""Readings of probes in a row, and of a pitch sensor, as one checked problem."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core.errors import DataError, UnitError
from metrosep.separation._line_probes import (
    MAX_POSITIONS,
    Row,
    grid_of,
    rows_without_carriage,
)

FloatArray = NDArray[np.float64]

MAX_ANGLE = 0.02
"""A pitch above 20 mrad is no straightness error of a carriage: it was given in another unit."""


@dataclass(frozen=True, slots=True, eq=False)
class Sensor:
    """Independent readings of the pitch of the carriage.

    Parameters
    ----------
    values : ndarray, shape (n,), rad
        Positive where the leading end raises the reading.
    u : float, rad
        Standard uncertainty of one value.
    """

    values: FloatArray
    u: float


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """All that an estimator works on.

    Parameters
    ----------
    row : Row
        Probes.
    x, grid : ndarray, m
        Carriage positions and artefact positions.
    readings : ndarray, shape (n_sensors, R, n)
        Probes, and the pitch sensor last if there is one.
    nuisance : ndarray, shape (n_sensors, p)
        How the carriage reaches each sensor.
    zeros : ndarray, shape (n_sensors, q)
        How each unknown zero reaches each sensor.
    sd : ndarray, shape (n_sensors,)
        Standard deviations relative to that of one probe.
    """

    row: Row
    x: FloatArray
    grid: FloatArray
    readings: FloatArray
    nuisance: FloatArray
    zeros: FloatArray
    sd: FloatArray

    @property
    def mean(self) -> FloatArray:
        """Mean over the repeats, NaN where none was measured."""
        count = (~np.isnan(self.readings)).sum(axis=1)
        total = np.where(np.isnan(self.readings), 0.0, self.readings).sum(axis=1)
        return np.where(count > 0, total / np.maximum(count, 1), np.nan)

    @property
    def n_probes(self) -> int:
        """Probes without the pitch sensor."""
        return len(self.row.offsets)


def checked_sensor(pitch: ArrayLike | None, u_pitch: float | None, n: int) -> Sensor | None:
    """Return the pitch sensor, or refuse it."""
    if pitch is None:
        if u_pitch is not None:
            raise DataError("u_pitch is given without pitch readings")
        return None
    try:
        values = np.array(pitch, dtype=np.float64)
    except (TypeError, ValueError):
        raise DataError("pitch must be numbers in rad") from None
    if values.shape != (n,):
        raise DataError(f"pitch has the shape {values.shape}, one angle for each of {n} positions")
    if np.isinf(values).any() or np.isnan(values).all():
        raise DataError("pitch must be finite; mark what was not measured as NaN")
    if float(np.nanmax(values) - np.nanmin(values)) > MAX_ANGLE:
        raise UnitError(
            f"pitch varies by {np.nanmax(values) - np.nanmin(values):.4g} rad; it is given in rad, "
            "not in arc seconds, degrees or urad"
        )
    if u_pitch is None or not (math.isfinite(u_pitch) and u_pitch > 0.0):
        raise DataError(
            f"pitch readings need their standard uncertainty u_pitch in rad, above zero; got {u_pitch}"
        )
    return Sensor(values, float(u_pitch))


def problem_of(
    row: Row, x: FloatArray, readings: FloatArray, sensor: Sensor | None, u_probe: float | None
) -> Problem:
    """Return the problem with its nuisance, zeros and weights."""
    o = np.array(row.offsets)
    n_probes, repeats, n = readings.shape
    nuisance = np.column_stack([np.ones(n_probes), o]) if row.pitch else np.ones((n_probes, 1))
    lines = nuisance if sensor is None else np.column_stack([np.ones(n_probes), o])
    zeros = np.empty((n_probes, 0)) if row.zero_known else _without_lines(lines)
    sd = np.ones(n_probes)
    if sensor is not None:
        if u_probe is None or not u_probe > 0.0:
            raise DataError(
                "probes and pitch sensor are weighted by their uncertainties: give u_reading in m, "
                "above zero, or repeats"
            )
        nuisance = np.vstack([np.column_stack([np.ones(n_probes), o]), [0.0, 1.0]])
        zeros = np.block(
            [[zeros, np.zeros((n_probes, 1))], [np.zeros((1, zeros.shape[1])), np.ones((1, 1))]]
        )
        sd = np.append(sd, sensor.u / u_probe)
        angle = np.broadcast_to(sensor.values, (repeats, n))
        readings = np.concatenate([readings, angle[None]])
    return Problem(row, x, grid_of(row, x), readings, nuisance, zeros, sd)


def _without_lines(lines: FloatArray) -> FloatArray:
    """Return orthonormal zeros that no offset or pitch of the carriage could be."""
    left, _, _ = np.linalg.svd(lines, full_matrices=True)
    return np.asarray(left[:, lines.shape[1] :])


def pooled_noise(readings: FloatArray, nuisance: FloatArray) -> tuple[float, float]:
    """Return the standard deviation of one reading from repeats, and its degrees of freedom.

    Straightness and pitch may differ from repeat to repeat: only what is left without them counts.
    """
    n_sensors, repeats, n = readings.shape
    if repeats < 2:
        return math.nan, 0.0
    sd = np.ones(n_sensors)
    rest = []
    for r in range(repeats):
        valid = ~np.isnan(readings).any(axis=1) & np.ones((n_sensors, n), dtype=bool)
        rows = rows_without_carriage(valid, nuisance, sd)
        rest.append(rows.of(np.where(valid, readings[:, r], np.nan)))
    y = np.array(rest)
    freedom = float(y.shape[1] * (repeats - 1))
    if freedom < 1.0:
        return math.nan, 0.0
    return math.sqrt(float(((y - y.mean(axis=0)) ** 2).sum()) / freedom), freedom


def check_size(n: int, what: str) -> None:
    """Refuse designs whose covariance would not fit into memory."""
    if n > MAX_POSITIONS:
        raise DataError(
            f"{what}: {n} positions; the exact covariance takes up to {MAX_POSITIONS}: average or "
            "thin the readings, or cut the travel into parts that overlap"
        )
