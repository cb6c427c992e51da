"""Readings of probes in a row, and of a pitch sensor, as one checked problem."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray, as_float
from metrosep.core.errors import DataError, UnitError
from metrosep.separation._line_probes import (
    MAX_POSITIONS,
    Row,
    grid_of,
)
from metrosep.separation._line_stations import Stations, stations_of, with_angle

MAX_ANGLE = 0.02
"""A pitch above 20 mrad is no straightness error of a carriage: it was given in another unit."""


@dataclass(frozen=True, slots=True, eq=False)
class Sensor:
    """Independent readings of the pitch of the carriage."""

    values: FloatArray  # shape (n,), rad: positive where the leading end raises the reading
    u: float  # rad: standard uncertainty of one value


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """All that an estimator works on."""

    row: Row  # probes
    x: FloatArray  # m: carriage positions and artefact positions
    grid: FloatArray
    stations: Stations  # readings taken together; the pitch sensor is the last one if there is one
    nuisance: FloatArray  # shape (n_sensors, p): how the carriage reaches each sensor
    zeros: FloatArray  # shape (n_sensors, q): how each unknown zero reaches each sensor

    @property
    def n_probes(self) -> int:
        """Probes without the pitch sensor."""
        return len(self.row.offsets)

    @property
    def n_sensors(self) -> int:
        """Probes, and the pitch sensor."""
        return int(self.nuisance.shape[0])


def checked_sensor(pitch: ArrayLike | None, u_pitch: float | None, n: int) -> Sensor | None:
    """Return the pitch sensor, or refuse it."""
    if pitch is None:
        if u_pitch is not None:
            raise DataError("u_pitch is given without pitch readings")
        return None
    try:
        values = as_float(pitch)
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
    row: Row, x: FloatArray, readings: FloatArray, sensor: Sensor | None, noise: float
) -> Problem:
    """Return the problem with its nuisance, zeros and weights; noise is that of one reading, m."""
    o = np.array(row.offsets)
    n_probes = o.size
    stations = stations_of(readings)
    nuisance = np.column_stack([np.ones(n_probes), o]) if row.pitch else np.ones((n_probes, 1))
    lines = nuisance if sensor is None else np.column_stack([np.ones(n_probes), o])
    zeros = np.empty((n_probes, 0)) if row.zero_known else _without_lines(lines)
    if sensor is not None:
        if not noise > 0.0:
            raise DataError(
                "probes and pitch sensor are weighted by their uncertainties: give u_reading in m, "
                "above zero, or repeats"
            )
        nuisance = np.vstack([np.column_stack([np.ones(n_probes), o]), [0.0, 1.0]])
        zeros = np.block(
            [[zeros, np.zeros((n_probes, 1))], [np.zeros((1, zeros.shape[1])), np.ones((1, 1))]]
        )
        relative = sensor.u / noise * math.sqrt(stations.most)
        stations = with_angle(stations, sensor.values, relative)
    return Problem(row, x, grid_of(row, x), stations, nuisance, zeros)


def _without_lines(lines: FloatArray) -> FloatArray:
    """Return orthonormal zeros that no offset or pitch of the carriage could be."""
    left, _, _ = np.linalg.svd(lines, full_matrices=True)
    return np.asarray(left[:, lines.shape[1] :])


def check_size(n: int, what: str) -> None:
    """Refuse designs whose covariance would not fit into memory."""
    if n > MAX_POSITIONS:
        raise DataError(
            f"{what}: {n} positions; the exact covariance takes up to {MAX_POSITIONS}: average or "
            "thin the readings, or cut the travel into parts that overlap"
        )
